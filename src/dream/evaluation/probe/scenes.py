"""Maps to ask about: of simulated worlds, from little to much explored, with places to go to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from dream.evaluation.probe.reading import WHITE, Ground, Regions
from dream.geometry import SE2, SE3, wrap_angle
from dream.mapping import OccupancyMap
from dream.planning.travel import Travel, careful_travel
from dream.protocol import DREAM_V1
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.world import World
from dream.sim.worlds import make_world

FloatArray = npt.NDArray[np.float64]

WORLDS = (
    *(("reef/patch", 13), ("wreck/3", 12), ("reef/mixed", 15), ("reef/K", 14)),
    *(("reef/string", 13), ("wreck/2", 11), ("reef/patch", 12), ("reef/fringing", 13)),
)
"""Names and seeds; no suite holds them."""
STAGES = (0.0, 0.26, 0.46, 0.66)
"""Shares of the area that are explored when a map is kept; the first is that of one look around."""
MOST_LEGS = 80
"""Ways that are gone in a world before the last stages are given up."""
LEG = 8
"""Steps of a way at most."""
LOOK_EVERY = 2
"""Steps of a way between two looks; at its end the robot looks to both sides, too."""
VIEW = 6.0
"""Metres: a way ends where much is white in the square of this half side, the likelier the more."""
BUSY = 4.0
"""Ways go to places that are so near to targets, in metres, three times as often as elsewhere."""
EDGE = 0.75
"""Metres from the side of the map within which no mark is set: its disc would be moved."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A map as it was at one time, and the robot that made it."""

    name: str
    """World, seed and stage."""
    occupancy: OccupancyMap
    pose: SE2
    trail: FloatArray
    """(N, 2) metres in the world, the robot's own place last."""
    ground: Ground
    """What the map shows."""
    travel: Travel
    """The ways from the robot."""
    places: FloatArray
    """(P, 2) metres in the world, where a mark may be set."""

    @cached_property
    def regions(self) -> Regions:
        """The target regions that the map shows."""
        return Regions.of(self.ground)

    def way(self, place: npt.ArrayLike) -> FloatArray:
        """(N, 2) metres in the world, a way of fewest steps from the robot to one of the places."""
        x, y = np.asarray(place, np.float64).tolist()
        lattice = self.travel.lattice
        return lattice.position(self.travel.path_to_node(lattice.node(x, y)))


def scenes(world: str, seed: int) -> list[Scene]:
    """The maps of a robot that roams a world, one for each stage that it reaches."""
    return list(_Roaming(make_world(world, seed)).scenes())


@dataclass(slots=True)
class _Roaming:
    """A robot that looks around, and then goes again and again to where something is left to be seen."""

    world: World
    renderer: Renderer = field(init=False)
    solids: Solids = field(init=False)
    occupancy: OccupancyMap = field(init=False)
    pose: SE2 = field(init=False)
    trail: list[tuple[float, float]] = field(init=False)
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.renderer, self.solids = Renderer(self.world), Solids(self.world)
        self.occupancy = OccupancyMap(self.world.bounds, DREAM_V1)
        self.pose = DREAM_V1.snap(self.world.starts[0])
        self.trail = [(self.pose.x, self.pose.y)]
        self.rng = np.random.default_rng(self.world.seed)
        self.occupancy.clear_launch(self.pose.x, self.pose.y)

    def scenes(self) -> Iterator[Scene]:
        for quarter in range(4):
            self._look(0.5 * math.pi * quarter)
        stages = list(STAGES)
        for _ in range(MOST_LEGS):
            travel = careful_travel(self.pose, self.occupancy)
            ground = Ground.of(self.occupancy)
            if ground.explored_share >= stages[0]:
                stages.pop(0)
                yield self._scene(ground, travel, len(STAGES) - len(stages))
            if not stages or not self._go(ground, travel):
                return

    def _go(self, ground: Ground, travel: Travel) -> bool:
        """Go to a place from which much is left to be seen; false where there is none."""
        from scipy.ndimage import uniform_filter

        nodes = np.flatnonzero(travel.nearest > 0)
        at = travel.lattice.positions[nodes]
        white = (ground.cells == WHITE).astype(np.float64)
        size = 2 * round(VIEW / ground.cell) + 1
        wanted = uniform_filter(white, size, mode="constant")[ground.index(at)] ** 2
        wanted *= np.where(ground.distance_at(ground.target, at) <= BUSY, 3.0, 1.0)
        steps = travel.nearest[nodes]
        wanted[steps > LEG] *= 0.01
        if not wanted.sum() > 0.0:
            return False
        goal = int(self.rng.choice(len(at), p=wanted / wanted.sum()))
        path = travel.path_to_node(int(nodes[goal]))
        for step, pose in enumerate(path[1:], start=1):
            there = travel.lattice.world(pose)
            if not self.solids.free([[there.x, there.y]], DREAM_V1)[0]:
                break
            self.pose = replace(there, yaw=wrap_angle(there.yaw))
            if self.trail[-1] != (there.x, there.y):
                self.trail.append((there.x, there.y))
            if step % LOOK_EVERY == 0:
                self._look()
        for turn in (-0.5, 0.5):
            self._look(turn * math.pi)
        self._look()
        return True

    def _look(self, turn: float = 0.0) -> None:
        """Map what is seen in a direction, radians to the left of where the robot heads."""
        x, y = self.pose.x, self.pose.y
        height = float(self.world.terrain.height(x, y)) + DREAM_V1.altitude
        T_world_camera = SE3.level(x, y, height, self.pose.yaw + turn) @ DREAM_V1.T_base_camera
        seen = self.renderer.measure(DREAM_V1.camera, T_world_camera)
        self.occupancy.integrate(seen.depth, seen.labels, DREAM_V1.camera, T_world_camera)

    def _scene(self, ground: Ground, travel: Travel, stage: int) -> Scene:
        places = travel.lattice.positions[travel.reached]
        row, col = self.occupancy.cell_of(*places.T)
        inside = self.occupancy.distance_to_bounds[row, col] >= EDGE
        return Scene(
            f"{self.world.name} {self.world.seed}, stage {stage} of {len(STAGES)}",
            self.occupancy.copy(),
            self.pose,
            np.array(self.trail, np.float64),
            ground,
            travel,
            places[inside],
        )
