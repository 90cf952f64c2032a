"""The tether that a vehicle drags from where it was launched."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dream.control import guard
from dream.geometry import SE2, FloatArray
from dream.homeward.budget import SLACK
from dream.homeward.pace import DEVIATIONS
from dream.homeward.ways import Place, after, move_to, node_of, places, way_home
from dream.mapping.leash import Leash, flat_water
from dream.types import Balance, BoolArray, Decision, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping._kernels.strings import FreeWater

MOST_TURNS = 1.0
"""Turns that it may be wound through, all its bends together: with friction μ the pull at its end grows by
exp(2π μ) with each (the capstan equation)."""
SLACK_TURNS = 0.1
"""Of them that are kept back: what bends it is known to a cell of the map only."""
BEND = 0.25
"""Metres: what bends it aside by less is no bend, but the map's cells."""
BESIDE = 1.0
"""Metres from the trail to which the way back along it keeps."""
PIECES = (1, 2, 4, 8, 16)
"""Into which the trail is cut one after the other, until a way back is found along which all of the tether
comes in: where a trail passes itself, a way along the whole of it leaves out a loop."""
ROUGH = 0.5
"""Metres by which what planners are told falls short of it: it is no finer than the cells of the map."""
HOME = 1.0
"""Metres of tether that are out at most when the vehicle is back where it was launched."""


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """A tether as it lies when it is pulled taut: a polygon from its anchor to the vehicle.

    What it does: its end goes with the vehicle, and it is pulled taut by cutting its corners, through water
    that is known to be free alone. So it stays on that side of everything on which the vehicle swam, and
    in the plane it is no shorter than the taut string through what is really free.
    Assumes: a tether that neither sinks nor drifts; water that is known to be free is.
    Fails when: a string lies over something in three dimensions: the tether may slip off it to another side
    than the string. One that catches on what is finer than a box of water is taken for shorter than it is.
    """

    points: FloatArray
    """(n, 3) x, y and z of its vertices, metres in the world: from the anchor to the vehicle."""

    @classmethod
    def at(cls, anchor: Place) -> Strand:
        """Nothing of it is out."""
        return cls(np.array([anchor]))

    def to(self, place: Place, water: FreeWater) -> Strand:
        """Once the vehicle has moved straight to a place."""
        from dream.mapping._kernels.strings import tighten

        return Strand(tighten(water, np.vstack([self.points, place])))

    def then(self, place: Place) -> Strand:
        """With a place more, not pulled taut."""
        return Strand(np.vstack([self.points, place]))

    @property
    def length(self) -> float:
        """Metres that are out."""
        points = self.points.tolist()
        return math.fsum(map(math.dist, points, points[1:]))

    @property
    def turns(self) -> float:
        """Turns of all its bends together, to either side."""
        along = np.diff(_simplified(self.points), axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        cosines = (along[:-1] * along[1:]).sum(axis=1)
        return float(np.arccos(np.clip(cosines, -1.0, 1.0)).sum() / (2.0 * math.pi))

    def pieces(self, count: int) -> list[Strand]:
        """So many that are alike long, from the anchor on."""
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(self.points, axis=0), axis=1).cumsum()])
        cuts = np.linspace(0.0, along[-1], count + 1)
        ends = np.stack([np.interp(cuts, along, axis) for axis in self.points.T], axis=1)
        return [
            Strand(np.vstack([ends[k], self.points[(along > cuts[k]) & (along < cuts[k + 1])], ends[k + 1]]))
            for k in range(count)
        ]

    def beside(self, points: FloatArray, water: FreeWater, reach: float) -> BoolArray:
        """Which of (n, 3) points lie so many metres beside it, with free water in between."""
        from dream.mapping._kernels.strings import beside

        return np.asarray(beside(water, self.points, points, reach))


def _simplified(points: FloatArray) -> FloatArray:
    """The vertices that a polygon needs to stay within `BEND` of all (Douglas and Peucker, 1973)."""
    first, last = points[0], points[-1]
    along = last - first
    square = float(along @ along)
    share = np.clip((points - first) @ along / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    aside = np.linalg.norm(points - first - share[:, None] * along, axis=1)
    k = int(aside.argmax())
    if aside[k] > BEND:
        return np.concatenate([_simplified(points[: k + 1])[:-1], _simplified(points[k:])])
    return points[[0, -1]] if square > 0.0 else points[:1]


def free_water(occupancy: OccupancyMap) -> FreeWater:
    """What a map knows to be free, at all heights alike under a planar protocol; the same to all who ask
    until it changes."""

    def find() -> FreeWater:
        if occupancy.volume is not None:
            return occupancy.volume.free_water()
        bounds = occupancy.bounds
        return flat_water(occupancy.traversable, (bounds.x_min, bounds.y_min), occupancy.protocol.cell)

    return occupancy.answer("free water", find)


@dataclass(slots=True, eq=False)
class TetherKeeper:
    """Keeps a mission from going farther than its tether, and from winding it around what stands there."""

    metres: float
    anchor: Place
    strand: Strand = field(init=False)
    """How it lies."""
    trail: Strand = field(init=False)
    """The last way on which all of it would have come in, and the way from there: one of the body, at
    the side of the tether, which itself passes where the body does not fit."""
    sigma: float = 0.0
    """Metres by which the position may err."""
    plan: list[tuple[SE2, float, Decision]] = field(default_factory=list)
    """The way that it is on: from where each move leads. Ways found anew at every step may differ, and lead
    to and fro."""
    _goal: Place | None = None
    """Where that ends."""

    def __post_init__(self) -> None:
        self.strand = self.trail = Strand.at(self.anchor)

    @property
    def leash(self) -> Leash:
        """How far planners may go with it."""
        return Leash(self.anchor, (1.0 - SLACK) * self.metres - ROUGH)

    @property
    def margin(self) -> float:
        """Metres that are kept back."""
        return SLACK * self.metres + DEVIATIONS * self.sigma

    def place(self, pose: SE2, z: float, occupancy: OccupancyMap) -> Place:
        """Where the tether's end is; under a planar protocol it lies level."""
        return pose.x, pose.y, z if occupancy.protocol.space is not None else self.anchor[2]

    def went(self, move: Decision, seen: Observation, sigma: float, occupancy: OccupancyMap) -> None:
        """The vehicle has made a move, straight to where it is."""
        self.sigma = sigma
        place = self.place(seen.pose, seen.z, occupancy)
        self.strand = self.strand.to(place, free_water(occupancy))
        self.trail = self.trail.then(place)
        planned = self.plan[0][2] if self.plan else None
        self.plan = self.plan[1:] if planned == replace(move, reasoning=Reasoning(), waited=0.0) else []

    def way_on(
        self, goals: tuple[Place, ...], seen: Observation, occupancy: OccupancyMap
    ) -> list[Decision] | None:
        """The rest of the way that it is on, while that leads to one of some goals and its next move is free;
        else another, which it is on then. None where none is known."""
        if not (self._goal in goals and self._is_on_plan(seen, occupancy)):
            self.plan = []
            for goal in goals:
                way = self.way(self.strand, seen.pose, seen.z, occupancy, goal)
                if way is None:
                    continue
                pose, z, self._goal = seen.pose, seen.z, goal
                for move in way:
                    self.plan.append((pose, z, move))
                    pose, z = after(pose, z, move, occupancy)
                return way
            return None
        return [move for _, _, move in self.plan]

    def _is_on_plan(self, seen: Observation, occupancy: OccupancyMap) -> bool:
        if not self.plan:
            return False
        (pose, z, move), protocol = self.plan[0], occupancy.protocol
        near = protocol.snap(seen.pose) == protocol.snap(pose) and abs(seen.z - z) < 0.5 * protocol.lattice
        return near and guard(move, seen.pose, occupancy, protocol, seen.z).decision == move

    def balances(self, strand: Strand) -> tuple[Balance, Balance]:
        """How it stands with a strand: what is out, and what bends it."""
        return (
            Balance("tether", "m", self.metres, strand.length, self.margin),
            Balance("winding", "turns", MOST_TURNS, strand.turns, SLACK_TURNS),
        )

    def along(
        self, moves: list[Decision], strand: Strand, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> list[Strand] | None:
        """How it lies after each of some moves; None where one of them would make it too long, or wind it too
        far. What is too much already may not become more.

        Args:
            moves: To be made.
            strand: Before them.
            pose: Likewise.
            z: Likewise.
            occupancy: What is known.
        """
        most = [max(one.left - one.margin, one.way + 1e-6) for one in self.balances(strand)]
        water, lies = free_water(occupancy), []
        for move in moves:
            pose, z = after(pose, z, move, occupancy)
            if move.advance > 0.0 or move.climb != 0.0:
                strand = strand.to(self.place(pose, z, occupancy), water)
            if strand.length > most[0] or strand.turns > most[1]:
                return None
            lies.append(strand)
        return lies

    def way(
        self, strand: Strand, pose: SE2, z: float, occupancy: OccupancyMap, goal: Place
    ) -> list[Decision] | None:
        """The moves of a way that the tether allows; None where none is known.

        To the anchor it leads back along the tether, so that nothing of it stays out. To any other place it
        leads back along it as far as needed, and on from there.

        Args:
            strand: How it lies.
            pose: From where: here, or one move on.
            z: At which height.
            occupancy: What is known.
            goal: Where to.
        """
        if goal == self.anchor:
            back = self._way_back(strand, pose, z, occupancy)
            return None if back is None else back[0]
        if (on := self._way_on(strand, pose, z, occupancy, goal)) is not None:
            return on
        moves, lies = self._way_back(strand, pose, z, occupancy) or ([], [])
        for k, strand in enumerate(lies):
            pose, z = after(pose, z, moves[k], occupancy)
            if (on := self._way_on(strand, pose, z, occupancy, goal)) is not None:
                return [*moves[: k + 1], *on]
        return None

    def _way_on(
        self, strand: Strand, pose: SE2, z: float, occupancy: OccupancyMap, goal: Place
    ) -> list[Decision] | None:
        """The shortest way, where the tether allows it."""
        moves = way_home(pose, z, occupancy, goal)
        allowed = moves is not None and self.along(moves, strand, pose, z, occupancy) is not None
        return moves if allowed else None

    def _way_back(
        self, strand: Strand, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> tuple[list[Decision], list[Strand]] | None:
        """A way on which nothing of it stays out; where none is known, the shortest that it allows. And how
        the tether lies after each move.

        The way leads beside the tether, or beside the trail; from here it is the trail from then on.
        """
        here = self.place(pose, z, occupancy)
        trail = self.trail.then(here)
        # One after the other, each looked for only where those before lead nowhere.
        ways = [
            partial(self._way_along, strand, 1),
            *(partial(self._way_along, trail, pieces) for pieces in PIECES),
            partial(self._as_it_came, trail),
        ]
        for way in ways:
            moves = way(pose, z, occupancy)
            lies = None if moves is None else self.along(moves, strand, pose, z, occupancy)
            if moves is not None and lies is not None and [strand, *lies][-1].length <= HOME:
                if strand is self.strand:
                    ahead = places(pose, here[2], moves, occupancy)
                    self.trail = Strand(np.array([self.anchor, *ahead[::-1], here]))
                return moves, lies
        moves = way_home(pose, z, occupancy, self.anchor)
        lies = None if moves is None else self.along(moves, strand, pose, z, occupancy)
        return None if moves is None or lies is None else (moves, lies)

    def _way_along(
        self, string: Strand, pieces: int, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> list[Decision] | None:
        """The shortest way beside each of some pieces of a string, from its end to the anchor."""
        moves: list[Decision] = []
        for k, piece in reversed(list(enumerate(string.pieces(pieces)))):
            x, y, up = piece.points[0].tolist()
            beside = partial(piece.beside, water=free_water(occupancy), reach=BESIDE)
            more = way_home(pose, z, occupancy, (x, y, up), beside, near=BESIDE if k else 0.0)
            if more is None:
                return None
            for move in more:
                pose, z = after(pose, z, move, occupancy)
            moves += more
        return moves

    def _as_it_came(
        self, trail: Strand, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> list[Decision] | None:
        """Along a trail, place by place."""
        protocol, moves = occupancy.protocol, list[Decision]()
        for x, y, up in trail.points[::-1].tolist():
            node, turned = node_of(SE2(x, y, 0.0), up, protocol), 0
            while node_of(pose, z, protocol) != node:
                move = move_to(node, pose, z, protocol) if turned < protocol.headings else None
                if move is None or guard(move, pose, occupancy, protocol, z).decision != move:
                    return None
                moves.append(move)
                pose, z = after(pose, z, move, occupancy)
                turned += 1
        return moves
