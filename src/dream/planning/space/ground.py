"""The search of the ground in three dimensions: as in the plane, at a height that the water allows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dream.planning.space.looks import nearest_tilt
from dream.planning.space.ways import ways_in
from dream.planning.travel import careful_standoff, careful_travel
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

HIGHER = 1.5
"""Metres above the protocol's altitude at which the ground is searched: from there all of it within reach
shows at a useful angle, and less of it hides behind other parts."""
LEFT = 0.01
"""Share of the ground in which the middle of a hole may lie, of the least radius that is gone back for."""
AROUND = 1.0
"""Metres a side of the square in which labels decide whether there are targets."""
TOLD = 0.2
"""Share of it from which on there are: on a reef two or three cells of five are told to be target."""
SIDES = 2
"""Eighths of the compass out of which ground with targets is to be inspected: they hide one another."""
AHEAD = 3.0
"""Metres of water ahead that are to be known for the camera to look down."""
ENOUGH = "Hardly any ground that can be seen is left: done."
ROOM = 16
"""Places that the vehicle must be able to get to in the plane to plan there."""


class PilotInPlane(Protocol):
    """`belief` at one altitude, as it is needed here."""

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Any:
        """Its thought: the situation, and a plan or none."""
        ...

    def act(self, thought: Any, plan: Any) -> Decision:
        """The first move of a plan; done without one."""
        ...


@dataclass(slots=True)
class GroundSearch:
    """`belief` of the plane on the view from above, from higher up.

    What it does: labels are trusted as far as `SurveyProtocol.trusted` says, straight; over ground that is
    less, and so far the planar pilot plans for. Where targets are told, ground counts as seen once it was
    inspected out of two eighths of the compass: until then the pilot expects targets there and comes again,
    but gives it up like other ground. It climbs or descends to its altitude where the water on the way is
    known to be free, and looks down, where targets hide one another least, while the water ahead of it is.

    Assumes: that what the camera shows ahead it shows looking down too, since plans know one tilt only.
    """

    mission: Mission
    in_plane: Callable[[Mission], PilotInPlane]
    """Makes the pilot that plans."""
    pilot: PilotInPlane = field(init=False)
    protocol: SurveyProtocol = field(init=False)
    """With the reach over ground."""

    def __post_init__(self) -> None:
        whole = self.mission.protocol
        self.protocol = replace(
            whole, reach=math.sqrt(max(whole.trusted**2 - (whole.altitude + HIGHER) ** 2, whole.cell**2))
        )
        mission = replace(self.mission, protocol=self.protocol)
        self.pilot = self.in_plane(mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move; done where the risk that something was missed is accepted."""
        near = occupancy.counting(self._searched(occupancy), self.protocol.reach)
        if np.count_nonzero(careful_travel(observation.pose, near).reached) < ROOM:
            out = self._into_the_open(observation, near)
            if out is not None:
                return out
        thought = self.pilot.consider(observation, near)
        if np.count_nonzero(thought.expected.hiding) <= LEFT * np.count_nonzero(near.to_see):
            thought = replace(thought, plan=None, why=ENOUGH)
        decision = self.pilot.act(thought, thought.plan)
        if decision.done:
            return decision
        return replace(self._in_water(decision, observation, occupancy), reasoning=decision.reasoning)

    def _searched(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) what was seen of the ground, and where targets are told, inspected as `SIDES` asks."""
        from scipy.ndimage import uniform_filter

        assert occupancy.volume is not None
        surface = occupancy.volume.surface()
        x, y = surface.middles[:, :2].T
        inside = occupancy.contains(x, y)
        bearings = np.zeros(occupancy.shape, np.uint8)
        np.bitwise_or.at(bearings, occupancy.cell_of(x[inside], y[inside]), surface.bearings[inside])
        width = round(AROUND / self.protocol.cell)
        told = uniform_filter(occupancy.target.astype(np.float32), width, mode="nearest") >= TOLD
        return np.asarray(occupancy.seen & (~told | (np.bitwise_count(bearings) >= SIDES)))

    def _in_water(self, decision: Decision, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """A move of the plane through water that is known to be free, towards the altitude of the search.

        Where it leads through none at any height, the way round in three dimensions; where there is none,
        a look upwards into it, since the image ends there.
        """
        assert occupancy.volume is not None
        protocol, volume, pose = self.mission.protocol, occupancy.volume, observation.pose
        x, y, _ = _end(decision, observation, protocol)
        ground = float(occupancy.ground[occupancy.cell_of(x, y)])
        wanted = protocol.launch_height(ground + HIGHER) - observation.z
        moves = [replace(decision, climb=climb) for climb in protocol.climbs]
        ends = np.array([_end(move, observation, protocol) for move in moves])
        starts = np.broadcast_to([pose.x, pose.y, observation.z], ends.shape)
        clear = volume.room(starts, ends).clear
        # What is below the search's own altitude is gone to only where there is no other way.
        away = [abs(wanted - move.climb) for move in moves]
        for k in sorted(range(len(moves)), key=lambda k: (away[k], abs(moves[k].climb))):
            if clear[k]:
                to = pose.yaw + moves[k].turn
                ahead = ends[k] + AHEAD * np.array([math.cos(to), math.sin(to), 0.0])
                known = volume.room(ends[k, None], ahead[None]).clear[0]
                tilt = max(protocol.tilts) if known else protocol.camera_pitch
                return replace(moves[k], tilt=self._tilt(observation, tilt))
        ways = ways_in(volume, self.mission.bounds, protocol)
        goal = np.hypot(ways.positions[..., 0] - x, ways.positions[..., 1] - y) <= protocol.lattice
        path = ways.to(pose, observation.z, goal, np.ones(protocol.headings, np.bool_))
        if path:
            return replace(path[0], tilt=self._tilt(observation, protocol.camera_pitch))
        return Decision(decision.turn, tilt=self._tilt(observation, min(protocol.tilts)))

    def _tilt(self, observation: Observation, wanted: float) -> float | None:
        """A tilt, or None where the camera has it."""
        protocol = self.mission.protocol
        return None if protocol.tilts[nearest_tilt(protocol, observation)] == wanted else wanted

    def _into_the_open(self, observation: Observation, occupancy: OccupancyMap) -> Decision | None:
        """The way from above or beside what stands up to where a vehicle at its altitude can move on."""
        assert occupancy.volume is not None
        ways = ways_in(occupancy.volume, self.mission.bounds, self.mission.protocol)
        at = ways.positions[0, :, :, :2].reshape(-1, 2)
        inside = occupancy.contains(*at.T)
        cells = occupancy.cell_of(*at[inside].T)
        is_open = np.zeros(len(at), np.bool_)
        standoff = self.protocol.body_radius + careful_standoff(self.protocol)
        is_open[inside] = (occupancy.distance_to_solid[cells] >= standoff) & occupancy.observed[cells]
        goal = np.broadcast_to(is_open.reshape(ways.shape[1:]), ways.shape)
        path = ways.to(observation.pose, observation.z, goal, np.ones(self.protocol.headings, np.bool_))
        if not path:
            return None
        why = Reasoning(action="Out of what stands around, to where the ground can be searched.")
        return replace(path[0], reasoning=why)


def _end(move: Decision, observation: Observation, protocol: SurveyProtocol) -> tuple[float, float, float]:
    """Where a move leads, metres in the world: what does not move is not put on the lattice."""
    pose, spacing = observation.pose, protocol.lattice
    x, y, z = pose.x, pose.y, observation.z
    if move.advance > 0.0:
        at, heading = protocol.snap(pose), protocol.heading_index(pose.yaw + move.turn)
        east, north = protocol.offset(heading, move.advance)
        x, y = at.x + east * spacing, at.y + north * spacing
    if move.advance > 0.0 or move.climb != 0.0:
        z = round(z / spacing) * spacing + move.climb
    return x, y, z
