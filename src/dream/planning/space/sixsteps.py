"""The paper's six reasoning steps, carried out on the volume."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from dream.mapping.structures import clearance, structures
from dream.planning.space import words
from dream.planning.space.looks import edges, gains, shown
from dream.planning.space.ways import KnownWays, ways_in
from dream.types import Decision, IntArray, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.volume import Surface, Volume
    from dream.planning.far_hints import FarHints

FloatArray = npt.NDArray[np.floating[Any]]

COLUMN = 1.0
"""Metres a side of the columns in which ground is searched."""
APART = 2.0
"""Metres between parts of what is left that are told apart."""
FAILED = 3
"""Frames that should have shown something and did not, after which it is given up."""
MANY = 400
"""Places looked from at once, the soonest reached first."""
POINTS = 500
"""Of each kind of what is left so many are looked up at most, each for its neighbours too."""
NEAR = 6
"""Steps within which others than the chosen look are looked for."""
LEAST_RATE = 1e-6
"""A look that shows less a step shows nothing."""
TARGET, EDGE, GROUND = 0, 1, 2
"""Kinds of what is left: target not inspected, unknown beside it, ground from which nothing returned."""


@dataclass(frozen=True, slots=True, eq=False)
class ToInspect:
    """What is left to look at."""

    points: FloatArray
    """(n, 3) metres in the world."""
    normals: FloatArray
    """(n, 3) of length 1."""
    area: FloatArray
    """(n,) square metres."""
    kind: IntArray
    """(n,) `TARGET`, `EDGE` or `GROUND`."""

    def __len__(self) -> int:
        return len(self.points)

    def of(self, kind: int) -> float:
        """Square metres of one kind."""
        return float(self.area[self.kind == kind].sum())

    def only(self, kept: npt.NDArray[Any]) -> ToInspect:
        """Some of it."""
        return ToInspect(self.points[kept], self.normals[kept], self.area[kept], self.kind[kept])


@dataclass(frozen=True, slots=True)
class SpaceView:
    """A place, a heading and a tilt, and what they are worth."""

    node: tuple[int, int, int]
    heading: int
    tilt: int
    steps: int
    rate: float
    """Weight that it shows for each step there."""


@dataclass(frozen=True, slots=True, eq=False)
class SpaceThought:
    """What the pilot holds of the situation, and the look that it would take."""

    observation: Observation
    ways: KnownWays
    surface: Surface
    left: ToInspect
    """All that is left."""
    thin: ToInspect
    """Some of it, for all."""
    thin_weights: FloatArray
    """(n,) what it is worth to look at each of `thin`."""
    steps: IntArray
    """(levels, rows, cols, headings) to get there; −1 where no way leads."""
    reasoning: Reasoning
    """The first three steps."""
    view: SpaceView | None
    """The look; None where the mission should end."""


class Weighs(Protocol):
    """Of the parameters of `SixSteps`, those that count in space."""

    @property
    def kernel(self) -> float:
        """How far ground counts as beside a target, as a multiple of half the group radius."""
        ...

    @property
    def prior(self) -> float:
        """Worth of a square metre of ground far from all targets."""
        ...

    @property
    def prior_weight(self) -> float:
        """Worth of one beside a target."""
        ...

    @property
    def focus(self) -> float:
        """Weight of the nearest part of target that is left."""
        ...

    @property
    def patience(self) -> float:
        """The chosen look is given up for one that is this many times better."""
        ...

    def hints(self, mission: Mission) -> FarHints | None:
        """What is to learn from pictures beyond the reach; None where no hints are taken."""
        ...


@dataclass(slots=True)
class SpacePilot:
    """One mission of `SixSteps` under a protocol that moves in space."""

    planner: Weighs
    mission: Mission
    failed: dict[int, int] = field(default_factory=dict)
    """Frames that should have shown what lies in a voxel and did not, by the voxel."""
    chosen: SpaceView | None = None
    hints: FarHints | None = field(init=False)

    def __post_init__(self) -> None:
        self.hints = self.planner.hints(self.mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The first move of the way to the look that shows most for its steps; done when none shows any."""
        thought = self.consider(observation, occupancy)
        return self.act(thought, thought.view)

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> SpaceThought:
        """Take in what is new, and choose the look that shows most for its steps."""
        assert occupancy.volume is not None
        volume, protocol = occupancy.volume, self.mission.protocol
        ways, surface, known = (
            ways_in(volume, self.mission.bounds, protocol),
            volume.surface(),
            structures(volume),
        )
        here = _place(observation)
        if self.hints is not None:
            self.hints.add(observation, occupancy)
        left = self._left(ways, volume, surface, observation)
        # 1 Distribution: what is known of targets, and how high they stand.
        is_target = surface.target > 0.5
        area = float(surface.area[is_target].sum())
        inspected = float(surface.area[is_target & (surface.sides != 0)].sum())
        reasoning = Reasoning(
            distribution=words.distribution(area, inspected, known),
            completion=words.completion(left.of(TARGET), left.of(EDGE), left.of(GROUND)),
        )
        # 2 Target area: the nearest part of what is left of targets. 3 Completion: what is left in all.
        part = nearest_part(left, here)
        if part.any():
            x, y, z = left.points[part].mean(axis=0).tolist()
            height = z - _ground(surface, np.array([[x, y]]), z)[0]
            reasoning = replace(
                reasoning, target_area=words.target_area(x, y, height, float(left.area[part].sum()))
            )
        else:
            reasoning = replace(reasoning, target_area="None: no target that is known has anything left.")
        # 4 Next target: the look that shows most of it for each step.
        weights = self._weights(left, surface, occupancy) * np.where(part, self.planner.focus, 1.0)
        thin, thin_weights = _thinned(left, weights)
        steps = ways.steps(observation.pose, observation.z)
        self.chosen = self._best(ways, steps, thin, thin_weights, observation)
        return SpaceThought(
            observation, ways, surface, left, thin, thin_weights, steps, reasoning, self.chosen
        )

    def act(self, thought: SpaceThought, view: SpaceView | None) -> Decision:
        """The first move of the way to a look; done without one."""
        protocol, ways, observation = self.mission.protocol, thought.ways, thought.observation
        if view is None:
            why = "Nothing is left that any known way leads to a look at: done."
            return Decision(done=True, reasoning=replace(thought.reasoning, action=why))
        # 5 Safety is in the ways, whose moves the guard lets pass. 6 Action: the first of them.
        move = self._move(ways, view, observation)
        yaw, tilt = view.heading * protocol.heading_step, protocol.tilts[view.tilt]
        at = tuple(ways.positions[view.node].tolist())
        target, _, ground = self.shows(thought, view)
        return replace(
            move,
            reasoning=replace(
                thought.reasoning,
                next_target=words.next_target(at, yaw, tilt, view.steps, target, ground),
                safety=words.safety(*self._room(thought.surface, move, observation)),
                action=words.action(move.turn, move.advance, move.climb, move.tilt),
            ),
        )

    def shows(self, thought: SpaceThought, view: SpaceView) -> tuple[float, float, float]:
        """Square metres of target, of unknown beside it, and of ground that are left and a look shows."""
        protocol, left = self.mission.protocol, thought.left
        yaw, tilt = view.heading * protocol.heading_step, protocol.tilts[view.tilt]
        at = tuple(thought.ways.positions[view.node].tolist())
        seen = left.only(shown(thought.ways, at, yaw, tilt, left.points, left.normals))
        return seen.of(TARGET), seen.of(EDGE), seen.of(GROUND)

    def views(self, thought: SpaceThought, most: int, apart: float) -> list[SpaceView]:
        """The looks with the greatest rates from places that are apart, the chosen one first.

        Args:
            thought: Of this moment.
            most: How many.
            apart: Metres between any two at least.
        """
        own = thought.view
        if own is None:
            return []
        ways, found = thought.ways, [own]
        soonest = _soonest(thought.steps)
        nodes = _spread(ways, np.where(soonest <= NEAR, soonest, -1))
        nodes = nodes[:: max(1, math.ceil(len(nodes) / MANY))]
        worth = self._rated(ways, nodes, thought.thin, thought.thin_weights)
        rates, taken = self._rates(nodes, worth, thought.steps, thought.observation)
        rated = []
        for n, of_node in enumerate(rates):
            heading, tilt = (int(k) for k in np.unravel_index(int(of_node.argmax()), of_node.shape))
            if of_node[heading, tilt] > LEAST_RATE:
                level, row, col = nodes[n].tolist()
                there, rate = int(taken[n, heading, tilt]), float(of_node[heading, tilt])
                rated.append(SpaceView((level, row, col), heading, tilt, there, rate))
        positions = ways.positions
        for one in sorted(rated, key=lambda view: -round(view.rate, 6)):
            if len(found) == most:
                break
            at = positions[one.node]
            if all(np.linalg.norm(positions[other.node] - at) > apart for other in found):
                found.append(one)
        return found

    # ------------------------------------------------------------------------------------------------------

    def _left(self, ways: KnownWays, volume: Volume, surface: Surface, observation: Observation) -> ToInspect:
        """All that is left, without what frames kept failing to show."""
        target = surface.target > 0.5
        open_target = target & (surface.sides == 0)
        beside, _ = edges(ways, surface.middles[target])
        ground = self._ground_left(surface, observation)
        points = np.concatenate([surface.middles[open_target], beside, ground])
        count = [int(open_target.sum()), len(beside), len(ground)]
        # What is unknown shows from all sides, as far as is known.
        here = np.array([observation.pose.x, observation.pose.y, observation.z])
        towards = _unit(here - beside)
        up = np.tile([0.0, 0.0, 1.0], (len(ground), 1))
        left = ToInspect(
            points,
            np.concatenate([surface.normals[open_target], towards, up]),
            np.concatenate(
                [surface.area[open_target], np.full(count[1], volume.cell**2), np.full(count[2], COLUMN**2)]
            ),
            np.repeat([TARGET, EDGE, GROUND], count),
        )
        keys = _keys(points, volume.cell)
        pose = observation.pose
        in_view = shown(
            ways, (pose.x, pose.y, observation.z), pose.yaw, observation.tilt, points, left.normals
        )
        for key in keys[in_view].tolist():
            self.failed[key] = self.failed.get(key, 0) + 1
        given_up = np.array([key for key, times in self.failed.items() if times >= FAILED], np.int64)
        return left.only(~np.isin(keys, given_up))

    def _ground_left(self, surface: Surface, observation: Observation) -> FloatArray:
        """(n, 3) middles of columns of the area from which nothing returned within reach."""
        box = self.mission.to_see
        east, north = np.arange(box.x_min, box.x_max, COLUMN), np.arange(box.y_min, box.y_max, COLUMN)
        returned = np.zeros((len(north), len(east)), np.bool_)
        cols = np.floor((surface.middles[surface.seen, 0] - box.x_min) / COLUMN).astype(int)
        rows = np.floor((surface.middles[surface.seen, 1] - box.y_min) / COLUMN).astype(int)
        inside = (cols >= 0) & (cols < len(east)) & (rows >= 0) & (rows < len(north))
        returned[rows[inside], cols[inside]] = True
        rows, cols = np.nonzero(~returned)
        places = np.column_stack([east[cols] + 0.5 * COLUMN, north[rows] + 0.5 * COLUMN])
        lowest = _ground(surface, places, observation.z - self.mission.protocol.altitude)
        return np.column_stack([places, lowest])

    def _weights(self, left: ToInspect, surface: Surface, occupancy: OccupancyMap) -> FloatArray:
        """(n,) what it is worth to look at each: ground less, and less still far from all targets.

        Ground that is hinted at is worth as much of a target as hints came true.
        """
        from scipy.spatial import cKDTree

        planner, protocol = self.planner, self.mission.protocol
        worth = np.where(left.kind == GROUND, planner.prior, 1.0)
        targets = surface.middles[surface.target > 0.5, :2]
        if len(targets):
            away, _ = cKDTree(targets).query(left.points[:, :2])
            near = away <= 2.0 * planner.kernel * protocol.group_radius
            worth[near & (left.kind == GROUND)] = planner.prior_weight
        if self.hints is not None:
            x, y = left.points[:, :2].T
            hinted = (left.kind == GROUND) & occupancy.contains(x, y)
            hinted[hinted] = self.hints.hints(occupancy)[occupancy.cell_of(x[hinted], y[hinted])]
            worth[hinted] = np.maximum(worth[hinted], self.hints.precision)
        return np.asarray(worth * left.area)

    def _best(
        self, ways: KnownWays, steps: IntArray, left: ToInspect, weights: FloatArray, observation: Observation
    ) -> SpaceView | None:
        """The look with the greatest rate; the one chosen before where it is nearly as good."""
        soonest = _soonest(steps)
        nodes = _spread(ways, soonest)
        best, most = None, 0.0
        for begin in range(0, len(nodes), MANY):
            some = nodes[begin : begin + MANY]
            # Later ones take longer: they would have to show twice as much as any before.
            if best is not None and 2.0 * most / max(int(soonest[tuple(some[0])]), 1) < best.rate:
                break
            worth = self._rated(ways, some, left, weights)
            most = max(most, float(worth.max(initial=0.0)))
            best = self._better(best, some, worth, steps, observation)
        if best is None:
            return None
        before = self.chosen
        if before is not None and before.node != ways.node(*_place(observation)):
            again = np.array([before.node])
            worth = self._rated(ways, again, left, weights)
            kept = np.zeros_like(worth)
            kept[0, before.heading, before.tilt] = worth[0, before.heading, before.tilt]
            old = self._better(None, again, kept, steps, observation)
            # Rounded, so that a tie is a tie on every machine.
            if old is not None and round(old.rate, 6) * self.planner.patience >= round(best.rate, 6):
                return old
        return best

    def _rated(self, ways: KnownWays, nodes: IntArray, left: ToInspect, weights: FloatArray) -> FloatArray:
        """(n, headings, tilts) what looks from nodes (n, 3) show."""
        cameras = (nodes + np.array(ways.first))[:, ::-1] * self.mission.protocol.lattice
        low, high = (
            cameras.min(axis=0) - self.mission.protocol.reach,
            cameras.max(axis=0) + self.mission.protocol.reach,
        )
        near = ((left.points >= low) & (left.points <= high)).all(axis=1)
        return gains(ways, cameras, left.points[near], left.normals[near], weights[near])

    def _better(
        self,
        best: SpaceView | None,
        nodes: IntArray,
        worth: FloatArray,
        steps: IntArray,
        observation: Observation,
    ) -> SpaceView | None:
        rates, taken = self._rates(nodes, worth, steps, observation)
        n, heading, tilt = np.unravel_index(int(rates.argmax()), rates.shape)
        rate = float(rates[n, heading, tilt])
        if rate <= LEAST_RATE or (best is not None and rate <= best.rate):
            return best
        level, row, col = nodes[n].tolist()
        return SpaceView((level, row, col), int(heading), int(tilt), int(taken[n, heading, tilt]), rate)

    def _rates(
        self, nodes: IntArray, worth: FloatArray, steps: IntArray, observation: Observation
    ) -> tuple[FloatArray, FloatArray]:
        """(n, headings, tilts) what looks are worth for each step there, and these steps."""
        there = steps[tuple(nodes.T)].astype(np.float64)
        there[there < 0] = np.inf
        # To tilt the camera where it is takes a step; to look again as it looks shows nothing.
        tilts = np.array(self.mission.protocol.tilts)
        same = np.abs(tilts - observation.tilt) < 1e-3
        taken = np.where(there[:, :, None] == 0.0, np.where(same, np.inf, 1.0), there[:, :, None])
        return np.round(worth / taken, 9), taken

    def _move(self, ways: KnownWays, view: SpaceView, observation: Observation) -> Decision:
        protocol = self.mission.protocol
        goal = np.zeros(ways.shape, np.bool_)
        goal[view.node] = True
        path = ways.to(observation.pose, observation.z, goal, np.arange(protocol.headings) == view.heading)
        tilt = protocol.tilts[view.tilt] if path is not None and len(path) <= 1 else protocol.camera_pitch
        move = path[0] if path else Decision()
        return replace(move, tilt=tilt if abs(tilt - observation.tilt) > 1e-3 else None)

    def _room(self, surface: Surface, move: Decision, observation: Observation) -> tuple[float, float, float]:
        """Metres to what lies below, to what is solid above, and to the surface, after a move."""
        yaw = observation.pose.yaw + move.turn
        x, y = (
            observation.pose.x + move.advance * math.cos(yaw),
            observation.pose.y + move.advance * math.sin(yaw),
        )
        z = observation.z + move.climb
        return *clearance(surface, (x, y, z), self.mission.protocol.body_radius), -z


def nearest_part(left: ToInspect, here: tuple[float, float, float]) -> npt.NDArray[np.bool_]:
    """(n,) those of target, or unknown beside it, that hang together and lie nearest to a position."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    found = np.zeros(len(left), np.bool_)
    targets = np.flatnonzero(left.kind != GROUND)
    if not len(targets):
        return found
    # Cubes instead of points, so that what hangs together is soon told.
    cubes, cube_of = np.unique(np.floor(left.points[targets] / APART), axis=0, return_inverse=True)
    _, number = connected_components(
        cKDTree(cubes).sparse_distance_matrix(cKDTree(cubes), math.sqrt(3.0) + 0.01)
    )
    nearest = int(np.linalg.norm(left.points[targets] - np.array(here), axis=1).round(6).argmin())
    cube_of = cube_of.ravel()
    found[targets[number[cube_of] == number[cube_of[nearest]]]] = True
    return found


def _ground(surface: Surface, places: FloatArray, otherwise: float) -> FloatArray:
    """(n,) world z of the lowest surface around the nearest column that has any, for places (n, 2)."""
    from scipy.spatial import cKDTree

    if not len(surface.middles):
        return np.full(len(places), otherwise)
    columns, column_of = np.unique(np.floor(surface.middles[:, :2] / COLUMN), axis=0, return_inverse=True)
    lowest = np.full(len(columns), np.inf)
    np.minimum.at(lowest, column_of.ravel(), surface.middles[:, 2])
    _, nearest = cKDTree((columns + 0.5) * COLUMN).query(places)
    return np.asarray(lowest[nearest])


def _soonest(steps: IntArray) -> IntArray:
    """(levels, rows, cols) steps with whatever heading; −1 where no way leads."""
    never = np.iinfo(np.int32).max
    soonest = np.where(steps >= 0, steps, never).min(axis=-1)
    soonest[soonest == never] = -1
    return np.asarray(soonest)


def _spread(ways: KnownWays, soonest: IntArray) -> IntArray:
    """(n, 3) nodes to look from, the soonest reached first: every second near by, every fourth far off."""
    nodes = np.argwhere(soonest >= 0)
    steps = soonest[tuple(nodes.T)]
    over_ground = np.where(steps <= 1, 1, np.where(steps <= 6, 2, 4))
    # Levels are few: every second everywhere.
    apart = np.column_stack([np.minimum(over_ground, 2), over_ground, over_ground])
    kept = ((nodes + np.array(ways.first)) % apart == 0).all(axis=1)
    nodes, steps = nodes[kept], steps[kept]
    return np.asarray(nodes[np.argsort(steps, kind="stable")])


def _thinned(left: ToInspect, weights: FloatArray) -> tuple[ToInspect, FloatArray]:
    """Every n-th of each kind in the order of the volume, with the weight of n."""
    kept, heavier = np.zeros(len(left), np.bool_), np.array(weights)
    for kind in (TARGET, EDGE, GROUND):
        those = np.flatnonzero(left.kind == kind)
        stride = max(1, math.ceil(len(those) / POINTS))
        kept[those[::stride]] = True
        heavier[those] *= stride
    return left.only(kept), heavier[kept]


def _keys(points: FloatArray, side: float) -> IntArray:
    """(n,) one number for each voxel."""
    level, row, col = np.floor(points[:, ::-1] / side).astype(np.int64).T + (1 << 20)
    return np.asarray((level << 42) | (row << 21) | col)


def _place(observation: Observation) -> tuple[float, float, float]:
    return observation.pose.x, observation.pose.y, observation.z


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))
