"""A robot that moves exactly on the lattice of the protocol and stops at contact."""

from __future__ import annotations

import math

from dream.geometry import SE2, SE3, wrap_angle
from dream.protocol import SurveyProtocol
from dream.robots.camera import SimulatedCamera
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.world import World
from dream.types import Arrival, Observation, Setpoint

SPEED = 0.5
"""Metres a second on the clock of a run."""
TURN_RATE = 0.5
"""Radians a second on the clock of a run."""


class Teleport:
    """Jumps to where it is sent, as far as the straight way there is free of contact.

    What it does: turns, then follows the segment to the setpoint at the protocol's altitude above
    the bare seabed. At a contact it counts a collision and stays on the last lattice position of the
    segment that is free. Poses are the truth; so are depth and labels, but for the noise that the
    protocol declares. That is drawn anew with every move, also one that goes nowhere.

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
    ) -> None:
        """Put the robot into the world, at its first start pose unless told otherwise.

        Args:
            world: Where.
            protocol: By which rules it looks and moves.
            start: Snapped to the lattice.
            renderer: Of this world, where one is made already.
            solids: Of this world, where they are made already.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
        """
        pose = world.starts[0] if start is None else start
        if not world.bounds.contains(pose.x, pose.y):
            raise ValueError(f"start: expected a pose inside {world.bounds}, got ({pose.x}, {pose.y})")
        self._world = world
        self._protocol = protocol
        self._solids = solids or Solids(world)
        self._pose = protocol.snap(pose)
        self._camera = SimulatedCamera(world, protocol, self._pose, renderer, fineness)
        self._moves = 0
        self._time = 0.0
        if self._solids.clearance(self._pose.x, self._pose.y, protocol) <= 0.0:
            raise ValueError(f"start: ({self._pose.x}, {self._pose.y}) touches the world. See `dream draw`")

    def observe(self) -> Observation:
        """One frame from the present pose; the same again until it moves."""
        T_world_base = self._T_world_base()
        return self._camera.observe(self._time, self._moves, T_world_base, T_world_base)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Turn, then advance; at contact, stop."""
        start = self._pose
        goal = SE2(setpoint.x, setpoint.y, setpoint.yaw)
        sweep = self._solids.sweep(start, goal, self._protocol)
        collided = sweep.contact
        end = self._last_free_node(start, goal, sweep.free) if collided else goal
        travelled = start.distance(end)
        self._time += travelled / SPEED + abs(wrap_angle(goal.yaw - start.yaw)) / TURN_RATE
        self._pose = end
        self._moves += 1
        return Arrival(end, collided, travelled, sweep.clearance)

    def _last_free_node(self, start: SE2, goal: SE2, free: float) -> SE2:
        length = start.distance(goal)
        nodes = max(1, round(length / self._protocol.lattice))
        for k in range(math.floor(free * nodes), 0, -1):
            along = k / nodes
            node = self._protocol.snap(
                SE2(start.x + along * (goal.x - start.x), start.y + along * (goal.y - start.y), goal.yaw)
            )
            if self._solids.clearance(node.x, node.y, self._protocol) > 0.0:
                return node
        return SE2(start.x, start.y, goal.yaw)

    def _T_world_base(self) -> SE3:
        seabed = float(self._world.terrain.height(self._pose.x, self._pose.y))
        return SE3.level(self._pose.x, self._pose.y, seabed + self._protocol.altitude, self._pose.yaw)
