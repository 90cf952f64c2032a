"""Moves of the plane made in three dimensions: through known water, over ground seen from above."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dream.mapping import within
from dream.planning.space.looks import nearest_tilt
from dream.planning.space.overlooked import Overlooked
from dream.planning.space.ways import ways_in
from dream.planning.travel import careful_standoff, careful_travel
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision, Float32Array, IntArray, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.volume import Surface

HEIGHT = 0.5
"""Height above ground at which it is searched, as a share of how far labels are trusted: from there all of it
within reach shows at a useful angle, and less of it hides behind other parts."""
HOLE = 0.5
"""Metres: holes in ground that was searched are not gone back for up to that radius."""
LEFT = 0.01
"""Share of the ground that may lie in larger holes when the search ends."""
AROUND = 1.0
"""Metres a side of the square in which labels decide whether there are targets."""
TOLD = 0.05
"""Share of its votes from which on there are: where individuals stand apart most of each cell is seabed. In
murky water four of five individuals lie on ground that is told so, and an eighth of bare ground is."""
GROUP = 2.0
"""Times the area of the least group, below which a piece of ground that is told so is doubted."""
DOUBTED = 0.25
"""Weight of what is doubted in what is to be looked at next: most of it are labels that are wrong."""
STANDS = 4
"""Eighths of the compass out of which cells of what stands up are to be looked at."""
SEARCHED = 0.03
"""Share of its individuals that may have been overlooked in a cell for it to count as searched."""
MISSED = 0.015
"""Share of all of them that may be expected to be missed when the search ends."""
AHEAD = 3.0
"""Metres of water ahead that are to be known for the camera to look down."""
ENOUGH = "Hardly any ground that can be seen is left: done."
ROOM = 16
"""Places that the vehicle must be able to get to in the plane to plan there."""


@dataclass(slots=True)
class InWater:
    """What a pilot of the plane needs to search the ground in three dimensions.

    What it does: gives it the map from above over which it plans, in which labels are trusted as far as
    `SurveyProtocol.trusted` says, straight, so that over ground it is less; and makes its moves in water that
    is known to be free, at the altitude of the search, the camera tilted down while the water ahead is known.
    """

    mission: Mission
    protocol: SurveyProtocol = field(init=False)
    """With the reach over ground."""
    height: float = field(init=False)
    """Metres above ground at which it is searched."""
    overlooked: Overlooked = field(init=False)
    """The looks at the ground."""
    told: BoolArray = field(init=False)
    """(rows, cols) where labels tell that there are targets."""
    doubted: BoolArray = field(init=False)
    """(rows, cols) where they do, but on a piece of ground that is smaller than `GROUP` says."""
    looked: BoolArray = field(init=False)
    """(rows, cols) what was looked at."""
    left: Float32Array = field(init=False)
    """(rows, cols) share of the individuals in each cell that is expected not to be inspected."""

    def __post_init__(self) -> None:
        self.overlooked = Overlooked(self.mission)
        self.left = self.overlooked.share
        self.told, self.doubted, self.looked = (np.zeros(self.left.shape, np.bool_) for _ in range(3))
        whole = self.mission.protocol
        assert whole.space is not None
        self.height = max(HEIGHT * whole.trusted, whole.space.lowest + whole.lattice)
        # On the lattice of heights it may be so much higher.
        above = self.height + whole.lattice
        self.protocol = replace(whole, reach=math.sqrt(max(whole.trusted**2 - above**2, whole.cell**2)))

    @property
    def in_plane(self) -> Mission:
        """The mission to a pilot of the plane."""
        return replace(self.mission, protocol=self.protocol)

    def take(self, observation: Observation, occupancy: OccupancyMap) -> None:
        """Add a frame, which the map holds already."""
        from scipy.ndimage import uniform_filter

        assert occupancy.volume is not None
        self.overlooked.take(observation)
        surface = occupancy.volume.surface()
        inside, cells = _cells_of(surface, occupancy)
        voxels = np.maximum(np.bincount(cells, minlength=occupancy.seen.size), 1)
        share = np.bincount(cells, surface.target[inside], occupancy.seen.size) / voxels
        width = round(AROUND / self.protocol.cell)
        target, seen = (
            uniform_filter(part.astype(np.float32), width, mode="constant")
            for part in (np.where(occupancy.seen, share.reshape(occupancy.shape), 0.0), occupancy.seen)
        )
        self.told = np.asarray(occupancy.seen & (target >= TOLD * np.maximum(seen, 1e-6)))
        self.doubted = self._doubted(occupancy.seen)
        # Estimated depths err by more than most things stand up, and leave holes in the map.
        if observation.error is not None:
            self.looked, self.left = occupancy.seen | (self.overlooked.parts > 0), self.overlooked.share
            return
        # What stands up shows no side that nobody looked at.
        sides = np.where(occupancy.solid, np.maximum(1.0 - self.overlooked.parts / STANDS, 0.0), 0.0)
        left = np.maximum(self.overlooked.share, sides)
        self.looked, self.left = occupancy.seen, np.where(occupancy.seen, left, 1.0).astype(np.float32)

    def _doubted(self, ground: BoolArray) -> BoolArray:
        """Pieces of the ground seen so far that are told to be target and small, beside one that is not.

        A piece that may go on where nothing was seen has no size yet. Where the least group is no wider than
        a piece of wrong labels, sizes tell nothing.
        """
        from scipy.ndimage import binary_dilation, label

        lasting, radius = self.protocol.lasting, self.protocol.group_radius
        if lasting is None or 2.0 * radius <= lasting.blob[1]:
            return np.zeros_like(self.told)
        around = np.ones((3, 3), np.bool_)
        pieces, _ = label(self.told, around)
        small = np.bincount(pieces.reshape(-1)) < GROUP * math.pi * (radius / self.protocol.cell) ** 2
        small[0] = True  # What is not told.
        if small.all():
            return np.zeros_like(self.told)
        small[pieces[binary_dilation(~ground, around)]] = False
        return np.asarray(self.told & small[pieces])

    def from_above(self, occupancy: OccupancyMap) -> OccupancyMap:
        """The map to a pilot of the plane, to be read until the map changes."""
        unseen = np.where(self.searched(occupancy), np.float32(0.0), self.left)
        unseen[self.doubted] *= DOUBTED
        return occupancy.counting(unseen, self.protocol.reach, self.passed_over(occupancy))

    def enough(self, hiding: BoolArray, occupancy: OccupancyMap) -> bool:
        """May the search end: is so little ground unseen, and are so few individuals expected to be missed?

        Args:
            hiding: Middles of discs of the radius `HOLE` in which nothing was searched.
            occupancy: The map itself.
        """
        return self.share_in_holes(hiding, occupancy) <= LEFT and self.missed(occupancy) <= MISSED

    def ended(self, decision: Decision, hiding: BoolArray, occupancy: OccupancyMap) -> Decision:
        """A decision to be done that says what is left; see `enough`."""
        holes, missed = self.share_in_holes(hiding, occupancy), self.missed(occupancy)
        words = (
            f"{holes:.1%} of the ground that can be seen lies in holes wider than {2.0 * HOLE:g} m, and "
            f"{missed:.1%} of all individuals are expected to be missed."
        )
        return replace(decision, reasoning=replace(decision.reasoning, completion=words))

    def share_in_holes(self, hiding: BoolArray, occupancy: OccupancyMap) -> float:
        """Share of the ground that can be seen, was not, and lies in holes; see `enough`."""
        left = within(hiding, HOLE, self.protocol.cell) & ~occupancy.observed & ~self.looked
        return np.count_nonzero(left) / max(1, int(np.count_nonzero(occupancy.to_see)))

    def missed(self, occupancy: OccupancyMap) -> float:
        """Expected share of all individuals that was not inspected, as far as labels tell where they are.

        Ground that was never seen is taken for what the nearest is that was.
        """
        from scipy.ndimage import distance_transform_edt

        if not occupancy.seen.any():
            return 1.0
        nearest = distance_transform_edt(~occupancy.seen, return_distances=False, return_indices=True)
        counted = occupancy.to_see & self.told[tuple(nearest)]
        return float(self.left[counted].mean()) if counted.any() else 0.0

    def passed_over(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) what stands up, but so low that the vehicle passes over it at the search's height."""
        assert occupancy.volume is not None
        assert self.protocol.space is not None
        surface = occupancy.volume.surface()
        inside, cells = _cells_of(surface, occupancy)
        top = np.full(occupancy.shape, -np.inf)
        # By one number a cell it takes a tenth of the time.
        np.maximum.at(top.reshape(-1), cells, surface.middles[inside, 2])
        highest = occupancy.ground + self.height - self.protocol.space.lowest
        return np.asarray(occupancy.solid & (top + 0.5 * occupancy.volume.cell <= highest))

    def searched(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) ground that was looked at, and where targets are told, hardly overlooked."""
        looked = occupancy.seen | self.looked
        return np.asarray(looked & ((self.left <= SEARCHED) | ~self.told))

    def into_the_open(self, observation: Observation, occupancy: OccupancyMap) -> Decision | None:
        """The way from above or beside what stands up to where a vehicle at its altitude can move on.

        None where it can from here, and where no such way is known.

        Args:
            observation: From here.
            occupancy: See `from_above`.
        """
        assert occupancy.volume is not None
        if np.count_nonzero(careful_travel(observation.pose, occupancy).reached) >= ROOM:
            return None
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

    def moved(self, decision: Decision, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """A move of the plane through water that is known to be free, towards the altitude of the search.

        Where it leads through none at any height, the way round in three dimensions; where there is none,
        a look upwards into it, since the image ends there.
        """
        assert occupancy.volume is not None
        protocol, volume, pose = self.mission.protocol, occupancy.volume, observation.pose
        x, y, _ = _end(decision, observation, protocol)
        ground = float(occupancy.ground[occupancy.cell_of(x, y)])
        wanted = protocol.launch_height(ground + self.height - protocol.altitude) - observation.z
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


def _cells_of(surface: Surface, occupancy: OccupancyMap) -> tuple[BoolArray, IntArray]:
    """(n,) which voxels lie over cells of the map, and of those (m,) which cell, numbered row by row."""
    x, y = surface.middles[:, :2].T
    inside = occupancy.contains(x, y)
    return inside, np.ravel_multi_index(occupancy.cell_of(x[inside], y[inside]), occupancy.shape)


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
