"""The tether that a vehicle drags from where it was launched."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dream.control import guard
from dream.geometry import SE2, FloatArray
from dream.homeward.budget import SLACK
from dream.homeward.pace import DEVIATIONS
from dream.homeward.ways import Place, after, way_home
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
"""Metres from the tether to which the way back along it keeps."""
MOST_PULLED = 100
"""Poses from which every move is tried to find a way back on which the tether changes no side of anything."""
EAGER = 1.5
"""Steps that one step's length of tether counts for in that search: above 1 it finds a way sooner, that may
be a little longer."""
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
    Fails when: a string that lies over something in three dimensions could slip off it. It is taken for
    longer than it is then.
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

    @property
    def length(self) -> float:
        """Metres that are out."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def turns(self) -> float:
        """Turns of all its bends together, to either side."""
        along = np.diff(_simplified(self.points), axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        cosines = (along[:-1] * along[1:]).sum(axis=1)
        return float(np.arccos(np.clip(cosines, -1.0, 1.0)).sum() / (2.0 * math.pi))

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
    strand: Strand
    sigma: float = 0.0
    """Metres by which the position may err."""
    plan: list[tuple[SE2, float, Decision]] = field(default_factory=list)
    """The way that it is on: from where each move leads. Ways found anew at every step may differ, and lead
    to and fro."""
    _goal: Place | None = None
    """Where that ends."""

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
        self.strand = self.strand.to(self.place(seen.pose, seen.z, occupancy), free_water(occupancy))
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
            pose: From where.
            z: At which height.
            occupancy: What is known.
            goal: Where to.
        """
        back = self._way_back(strand, pose, z, occupancy)
        if goal == self.anchor:
            return back
        lies = [strand]
        if back:
            lies += self.along(back, strand, pose, z, occupancy) or []
        for k, there in enumerate(lies):
            on = way_home(pose, z, occupancy, goal)
            if on is not None and self.along(on, there, pose, z, occupancy) is not None:
                return [*(back or [])[:k], *on]
            if back and k < len(back):
                pose, z = after(pose, z, back[k], occupancy)
        return None

    def _way_back(
        self, strand: Strand, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> list[Decision] | None:
        """Along the tether; where nothing leads along it, the shortest way that it allows."""
        beside = partial(strand.beside, water=free_water(occupancy), reach=BESIDE)
        moves = way_home(pose, z, occupancy, self.anchor, beside)
        lies = None if moves is None else self.along(moves, strand, pose, z, occupancy)
        if lies is not None and [strand, *lies][-1].length <= HOME:
            return moves
        # The way may pass on the other side of something thin.
        moves = self._pulled(strand, pose, z, occupancy)
        if moves is None:
            moves = way_home(pose, z, occupancy, self.anchor)
        if moves is None or self.along(moves, strand, pose, z, occupancy) is None:
            return None
        return moves

    def _pulled(self, strand: Strand, pose: SE2, z: float, occupancy: OccupancyMap) -> list[Decision] | None:
        """Moves until nothing is out: a search by steps made and what is out (weighted A*).

        Its length is the distance to the anchor on the universal cover of the free water: where the tether
        lies otherwise, the vehicle is at another place, and no side of anything is ever changed.
        Reference: Kim, Bhattacharya and Kumar, Path Planning for a Tethered Mobile Robot, 2014.
        """
        protocol, water = occupancy.protocol, free_water(occupancy)
        moves = [
            Decision(turn, advance, climb=climb)
            for turn in protocol.turn_angles
            for advance in (0.0, *protocol.advances)
            for climb in protocol.climbs
            if turn != 0.0 or advance > 0.0 or climb != 0.0
        ]
        queue: list[tuple[float, int, SE2, float, Strand, list[Decision]]]
        queue, reached, count = [(0.0, 0, pose, z, strand, [])], set(), 0
        for _ in range(MOST_PULLED):
            if not queue:
                return None
            _, _, pose, z, strand, made = heapq.heappop(queue)
            at_anchor = protocol.snap(pose) == protocol.snap(SE2(*self.anchor[:2], pose.yaw))
            if at_anchor and strand.length <= HOME:
                return made
            for move in moves:
                to, height = after(pose, z, move, occupancy)
                there = protocol.snap(to), round(height / protocol.lattice)
                if guard(move, pose, occupancy, protocol, z).decision != move:
                    continue
                moved = strand.to(self.place(to, height, occupancy), water)
                if (*there, round(moved.length)) not in reached:
                    reached.add((*there, round(moved.length)))
                    count += 1
                    cost = len(made) + 1 + EAGER * moved.length / max(protocol.advances)
                    heapq.heappush(queue, (cost, count, to, height, moved, [*made, move]))
        return None
