"""A robot that moves exactly on the lattice of the protocol and stops at contact."""

from __future__ import annotations

import math

import numpy as np

from dream.geometry import SE2, SE3, wrap_angle
from dream.perception import Perception
from dream.protocol import SurveyProtocol
from dream.robots.camera import SimulatedCamera
from dream.sim.render import Renderer
from dream.sim.solids import Solids, Sweep
from dream.sim.vehicle import BLUEROV2_HEAVY
from dream.sim.world import World
from dream.types import Arrival, Observation, Setpoint
from dream.vehicle import PowerModel

SPEED = 0.5
"""Metres a second on the clock of a run."""
TURN_RATE = 0.5
"""Radians a second on the clock of a run."""

_UNDER_WAY, _ON_THE_SPOT = (
    PowerModel().under_way(BLUEROV2_HEAVY.typical, BLUEROV2_HEAVY.thrusters, speed) for speed in (SPEED, 0.0)
)
"""Watts of a BlueROV2 Heavy at that speed, and while it turns on the spot."""


class Teleport:
    """Jumps to where it is sent, as far as the straight way there is free of contact.

    What it does: turns, then follows the segment to the setpoint at the protocol's altitude above
    the bare seabed, or in space straight to its height. At a contact it counts a collision and stays on the
    last lattice position of the segment that is free. Poses are the truth; so are depth and labels, but for
    the errors that the protocol declares. Noise is drawn anew with every move, also one that goes nowhere.

    Assumes: setpoints on the protocol's lattice.
    """

    def __init__(
        self,
        world: World,
        protocol: SurveyProtocol,
        start: SE2 | None = None,
        *,
        renderer: Renderer | None = None,
        solids: Solids | None = None,
        fineness: int = 1,
        perception: Perception | None = None,
    ) -> None:
        """Put the robot into the world, at its first start pose unless told otherwise.

        Args:
            world: Where.
            protocol: By which rules it looks and moves.
            start: Snapped to the lattice.
            renderer: Of this world, where one is made already.
            solids: Of this world, where they are made already.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
            perception: Tells labels and depth under a protocol of sight; the network that comes with DREAM
                unless given.
        """
        pose = world.starts[0] if start is None else start
        if not world.bounds.contains(pose.x, pose.y):
            raise ValueError(f"start: expected a pose inside {world.bounds}, got ({pose.x}, {pose.y})")
        self._world = world
        self._protocol = protocol
        self._solids = solids or Solids(world)
        self._pose = protocol.snap(pose)
        self._camera = SimulatedCamera(world, protocol, self._pose, renderer, fineness, perception)
        self._z = launch_height(world, protocol, self._pose) - self._camera.errors.height
        self._tilt = protocol.camera_pitch
        self._moves = 0
        self._time = 0.0
        self._drawn = 0.0
        if not self._is_free(self._pose, self._z):
            raise ValueError(f"start: ({self._pose.x}, {self._pose.y}) touches the world. See `dream draw`")

    def observe(self) -> Observation:
        """One frame from the present pose; the same again until it moves."""
        T_world_base = self._T_world_base()
        drawn = self._drawn / 3600.0
        return self._camera.observe(self._time, self._moves, T_world_base, T_world_base, self._tilt, drawn)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Turn, then advance and climb; at contact, stop. The camera tilts on the way."""
        start, z, off = self._pose, self._z, self._camera.errors.height
        goal = SE2(setpoint.x, setpoint.y, setpoint.yaw)
        # Where it is sent is a height as it believes it.
        height = None if setpoint.z is None else setpoint.z - off
        sweep = self._sweep(goal, height)
        collided = sweep.contact
        contact = None
        if collided:
            up = z if height is None else z + sweep.free * (height - z)
            x, y = (a + sweep.free * (b - a) for a, b in ((start.x, goal.x), (start.y, goal.y)))
            contact = x, y, up + off
        end, height = self._last_free_node(goal, height, sweep.free) if collided else (goal, height)
        travelled = start.distance(end) if height is None else math.hypot(start.distance(end), height - z)
        swims, turns = travelled / SPEED, abs(wrap_angle(goal.yaw - start.yaw)) / TURN_RATE
        self._time += swims + turns
        self._drawn += swims * _UNDER_WAY + turns * _ON_THE_SPOT
        self._pose = end
        self._z = launch_height(self._world, self._protocol, end) if height is None else height
        self._tilt = self._tilt if setpoint.tilt is None else setpoint.tilt
        self._moves += 1
        # Where the mission's heights are off, what is told of the pose is not the truth.
        truth = self._T_world_base() if off else None
        return Arrival(end, collided, travelled, sweep.clearance, truth=truth, contact=contact)

    def _sweep(self, goal: SE2, z: float | None) -> Sweep:
        """How the way to a goal goes; to its altitude over ground where no height is given."""
        if z is None:
            return self._solids.sweep(self._pose, goal, self._protocol)
        start = self._pose
        return self._solids.sweep_through((start.x, start.y, self._z), (goal.x, goal.y, z), self._protocol)

    def _last_free_node(self, goal: SE2, z: float | None, free: float) -> tuple[SE2, float | None]:
        start, spacing = self._pose, self._protocol.lattice
        rise = 0.0 if z is None else z - self._z
        nodes = max(1, round(math.hypot(start.distance(goal), rise) / spacing))
        for k in range(math.floor(free * nodes), 0, -1):
            along = k / nodes
            node = self._protocol.snap(
                SE2(start.x + along * (goal.x - start.x), start.y + along * (goal.y - start.y), goal.yaw)
            )
            height = None if z is None else self._z + along * rise
            if self._is_free(node, height):
                return node, height
        return SE2(start.x, start.y, goal.yaw), None if z is None else self._z

    def _is_free(self, pose: SE2, z: float | None) -> bool:
        """Does the body touch nothing there? At its altitude over ground where no height is given."""
        if self._protocol.space is None or z is None:
            return self._solids.clearance(pose.x, pose.y, self._protocol) > 0.0
        return bool(self._solids.free_at(np.array([[pose.x, pose.y, z]]), self._protocol)[0])

    def _T_world_base(self) -> SE3:
        return SE3.level(self._pose.x, self._pose.y, self._z, self._pose.yaw)


def launch_height(world: World, protocol: SurveyProtocol, pose: SE2) -> float:
    """World z at the protocol's altitude above the bare seabed; in space the lattice's next height above.

    Args:
        world: Where.
        protocol: By which rules.
        pose: Above which place.
    """
    return protocol.launch_height(float(world.terrain.height(pose.x, pose.y)))
