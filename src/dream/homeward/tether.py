"""The tether that a vehicle drags from where it was launched."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dream.control import guard
from dream.geometry import SE2
from dream.homeward.budget import SLACK
from dream.homeward.pace import DEVIATIONS
from dream.homeward.strands import Strand, Strands, StrandWater
from dream.homeward.ways import Place, after, move_to, node_of, places, way_home
from dream.mapping.leash import Leash, flat_water
from dream.types import Balance, Decision, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

Affords = Callable[[list[Decision]], bool]
"""Is there enough for some moves?"""

MOST_TURNS = 1.0
"""Turns that it may be wound through, all its bends together: with friction μ the pull at its end grows by
exp(2π μ) with each (the capstan equation)."""
SLACK_TURNS = 0.1
"""Of them that are kept back: what bends it is known to a cell of the map only."""
CLOSED = 1.0
"""Metres around a place to which no way leads that are closed at most; never where the vehicle is."""
AGAIN = 1.0
"""Metres within which it is led to the same place once more."""
BESIDE = 1.0
"""Metres from the trail to which the way back along it keeps."""
PIECES = (1, 2, 4, 8, 16)
"""Into which the trail is cut one after the other, until a way back is found along which all of the tether
comes in: where a trail passes itself, a way along the whole of it leaves out a loop."""
ROUGH = 0.5
"""Metres by which what planners are told falls short of it: it is no finer than the cells of the map."""
HOME = 1.0
"""Metres of tether that are out at most when the vehicle is back where it was launched."""


def water_in(occupancy: OccupancyMap) -> StrandWater:
    """What a map knows to be free; the same to all who ask until it changes.

    Under a planar protocol it is alike at all heights: nothing can slide over what is solid, or catch on it.
    """

    def find() -> StrandWater:
        if occupancy.volume is not None:
            return StrandWater.of(occupancy.volume.free_water())
        bounds = occupancy.bounds
        free = flat_water(occupancy.traversable, (bounds.x_min, bounds.y_min), occupancy.protocol.cell)
        return StrandWater(free, free)

    return occupancy.answer("water", find)


@dataclass(frozen=True, slots=True)
class _Back:
    """A way back."""

    moves: list[Decision]
    lies: list[Strands]
    """How the tether may lie after each."""
    over: float
    """How far it is beyond its limits at most, as a share of them."""
    short: int
    """Moves for which there is not enough; 0 where there is for all."""
    out: float
    """Metres that stay out at its end."""

    @property
    def cost(self) -> tuple[float, int, float]:
        return self.over, self.short, self.out

    @property
    def comes_in(self) -> bool:
        """All of it, however it lies, within its limits."""
        return not (self.over or self.out)


@dataclass(slots=True, eq=False)
class TetherKeeper:
    """Keeps a mission from going farther than its tether, and from winding it around what stands there."""

    metres: float
    anchor: Place
    lies: Strands = field(init=False)
    """How it may lie."""
    trail: Strand = field(init=False)
    """Where it came along, but for what it went to and straight back; up to where it was last sure how it
    lies, the shortest way on which all of it would have come in: one of the body, at the side of the tether,
    which itself passes where the body does not fit."""
    sigma: float = 0.0
    """Metres by which the position may err."""
    plan: list[tuple[SE2, float, Decision]] = field(default_factory=list)
    """The way that it is on: from where each move leads. Ways found anew at every step may differ, and lead
    to and fro."""
    led: list[Place] = field(default_factory=list)
    """Places to which it was led by another way than was asked for."""
    closed: list[tuple[Place, float]] = field(default_factory=list)
    """Places that were asked for, to which no way leads that it allows, or that are asked for once more; and
    metres around them that are closed to planners."""
    _goal: Place | None = None
    """Where that ends."""
    _water: StrandWater | None = None
    _moved: dict[tuple[Strands, Place], Strands] = field(default_factory=dict)
    """How it may lie once it was moved to a place, in that water: many of the ways that are looked for begin
    alike."""
    _backs: dict[tuple[Strands, SE2, float, Strand], _Back | None] = field(default_factory=dict)
    """Ways back from where it lies so, after such a trail, in that water."""

    def __post_init__(self) -> None:
        self.take_in()

    @property
    def leash(self) -> Leash:
        """How far planners may go with it."""
        return Leash(self.anchor, (1.0 - SLACK) * self.metres - ROUGH, tuple(self.closed))

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
        self.lies = self.lies.to(place, water_in(occupancy))
        self.trail = self.trail.then(place, 0.5 * occupancy.protocol.lattice)
        planned = self.plan[0][2] if self.plan else None
        self.plan = self.plan[1:] if planned == replace(move, reasoning=Reasoning(), waited=0.0) else []

    def way_on(
        self, goals: tuple[Place, ...], seen: Observation, occupancy: OccupancyMap, affords: Affords
    ) -> list[Decision] | None:
        """The rest of the way that it is on, while that leads to one of some goals, its next move is free and
        there is enough for it; else another, which it is on then. None where none is known."""
        rest = [move for _, _, move in self.plan]
        if not (self._goal in goals and self._is_on_plan(seen, occupancy) and affords(rest)):
            self.plan = []
            for goal in goals:
                way = self.way(self.lies, seen.pose, seen.z, occupancy, goal, affords)
                if way is None:
                    continue
                pose, z, self._goal = seen.pose, seen.z, goal
                for move in way:
                    self.plan.append((pose, z, move))
                    pose, z = after(pose, z, move, occupancy)
                return way
            return None
        return rest

    def _is_on_plan(self, seen: Observation, occupancy: OccupancyMap) -> bool:
        if not self.plan:
            return False
        (pose, z, move), protocol = self.plan[0], occupancy.protocol
        near = protocol.snap(seen.pose) == protocol.snap(pose) and abs(seen.z - z) < 0.5 * protocol.lattice
        return near and guard(move, seen.pose, occupancy, protocol, seen.z).decision == move

    def balances(self, tether: Strands) -> tuple[Balance, Balance]:
        """How it stands with a tether: what is out, and what bends it."""
        return (
            Balance("tether", "m", self.metres, tether.length, self.margin),
            Balance("winding", "turns", MOST_TURNS, tether.turns, SLACK_TURNS),
        )

    def along(
        self, moves: list[Decision], tether: Strands, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> Iterator[Strands]:
        """How it may lie after each of some moves.

        Args:
            moves: To be made.
            tether: Before them.
            pose: Likewise.
            z: Likewise.
            occupancy: What is known.
        """
        water = self._known(occupancy)
        for move in moves:
            pose, z = after(pose, z, move, occupancy)
            if move.advance > 0.0 or move.climb != 0.0:
                place = self.place(pose, z, occupancy)
                if (tether, place) not in self._moved:
                    self._moved[tether, place] = tether.to(place, water)
                tether = self._moved[tether, place]
            yield tether

    def over(self, tether: Strands, before: Strands, *, back: bool = False) -> float:
        """How far it is beyond its limits, as a share of them; 0 where it is not.

        What was too much before may be as much. The way back may use what is kept back.
        """
        most = 0.0
        for now, then in zip(self.balances(tether), self.balances(before), strict=True):
            limit = max(now.left if back else now.left - now.margin, then.way + 1e-6)
            most = max(most, (now.way - limit) / now.left)
        return most

    def way(
        self,
        tether: Strands,
        pose: SE2,
        z: float,
        occupancy: OccupancyMap,
        goal: Place,
        affords: Affords = lambda moves: True,
    ) -> list[Decision] | None:
        """The moves of a way that the tether allows; None where none is known.

        To the anchor it leads back along the tether, so that nothing of it stays out. To any other place it
        leads back along it as far as needed, and on from there.

        Args:
            tether: How it lies.
            pose: From where: here, or one move on.
            z: At which height.
            occupancy: What is known.
            goal: Where to.
            affords: Is there enough for some moves? To the anchor, a way for which there is not is the last.
        """
        if goal != self.anchor:
            trail = self.trail.then(self.place(pose, z, occupancy))
            if (on := self._way_on(tether, pose, z, occupancy, goal, trail)) is not None:
                return on
        back = self._way_back(tether, pose, z, occupancy, affords)
        if back is None or goal == self.anchor:
            return None if back is None else back.moves
        for k, lies in enumerate(back.lies):
            if self.over(lies, tether, back=True):
                break
            pose, z = after(pose, z, back.moves[k], occupancy)
            trail = self._trail(back.moves[k + 1 :], pose, z, occupancy)
            if (on := self._way_on(lies, pose, z, occupancy, goal, trail)) is not None:
                return [*back.moves[: k + 1], *on]
        return None

    def comes_in(self, tether: Strands, pose: SE2, z: float, occupancy: OccupancyMap) -> bool:
        """Is a way back known on which all of it comes in, however it lies, within its limits?"""
        back = self._way_back(tether, pose, z, occupancy)
        return back is not None and back.comes_in

    def move_back(self, seen: Observation, occupancy: OccupancyMap) -> Decision | None:
        """The next move back as it came; None at the start, and where that is free no more."""
        return next(self.moves_back(self.trail, seen.pose, seen.z, occupancy), None)

    def may_be_in(self, pose: SE2, z: float, occupancy: OccupancyMap) -> bool:
        """Is the vehicle back where nothing of the tether need be out?"""
        protocol, (x, y, up) = occupancy.protocol, self.anchor
        there = node_of(pose, z, protocol) == node_of(SE2(x, y, 0.0), up, protocol)
        return there and min(one.length for one in self.lies.ways) <= HOME

    def take_in(self) -> None:
        """Nothing of it is out any more: whoever tends it has taken in what was."""
        self.lies, self.trail = Strands.at(self.anchor), Strand.at(self.anchor)

    def close(self, place: Place, here: Place, occupancy: OccupancyMap) -> bool:
        """Let planners no more go near a place that was asked for from here.

        Returns:
            False where that would close where the vehicle is, or a place that it came along.
        """
        protocol = occupancy.protocol
        # Under a planar protocol the body keeps off what is closed, in space its middle does.
        off = (
            0.5 * protocol.lattice
            if protocol.space
            else protocol.body_radius + math.sqrt(2.0) * protocol.cell
        )
        came = [*self.trail.points.tolist(), here]
        radius = min(CLOSED, 0.6 * math.dist(place, here), *(math.dist(place, one) - off for one in came))
        if radius > 0.0:
            self.closed.append((place, radius))
        return radius > 0.0

    def times_led(self, place: Place) -> int:
        """How often it was led to a place, this time with them: it might be led to and fro for ever."""
        self.led.append(place)
        return sum(math.dist(place, other) <= AGAIN for other in self.led)

    def _way_on(
        self, tether: Strands, pose: SE2, z: float, occupancy: OccupancyMap, goal: Place, trail: Strand
    ) -> list[Decision] | None:
        """The shortest way, where the tether allows it and a way back from its end; after such a trail."""
        moves, lies = way_home(pose, z, occupancy, goal), tether
        if moves is None:
            return None
        for lies in self.along(moves, tether, pose, z, occupancy):
            if self.over(lies, tether):
                return None
        for x, y, up in places(pose, self.place(pose, z, occupancy)[2], moves, occupancy):
            trail = trail.then((x, y, up), 0.5 * occupancy.protocol.lattice)
        for move in moves:
            pose, z = after(pose, z, move, occupancy)
        back = self._way_back(lies, pose, z, occupancy, trail=trail)
        return moves if back is not None and back.comes_in else None

    def _way_back(
        self,
        tether: Strands,
        pose: SE2,
        z: float,
        occupancy: OccupancyMap,
        affords: Affords = lambda moves: True,
        trail: Strand | None = None,
    ) -> _Back | None:
        """A way on which nothing of it stays out; where none is known, that on which it is the least beyond
        its limits, and of those where the least stays out.

        The way leads beside the tether, or beside a trail, that of the mission and on to there unless given;
        from here it is the trail from then on, where it is known for sure how the tether lies on it.
        """
        self._known(occupancy)
        asked = tether, pose, z, trail or self.trail
        if asked not in self._backs:
            self._backs[asked] = self._find_back(*asked, occupancy, lambda moves: True)
        back = self._backs[asked]
        if back is not None and not affords(back.moves):
            back = self._find_back(*asked, occupancy, affords)
        sure = back is not None and all(len(lies.ways) == 1 for lies in (tether, *back.lies))
        if back is not None and tether is self.lies and back.comes_in and sure:
            self.trail = self._trail(back.moves, pose, z, occupancy)
        return back

    def _trail(self, back: list[Decision], pose: SE2, z: float, occupancy: OccupancyMap) -> Strand:
        """To where a way back leads from, the other way round."""
        here = self.place(pose, z, occupancy)
        return Strand(np.array([self.anchor, *places(pose, here[2], back, occupancy)[::-1], here]))

    def _known(self, occupancy: OccupancyMap) -> StrandWater:
        """Where it may lie; what was found out in other water is forgotten."""
        water = water_in(occupancy)
        if self._water is not water:
            self._water, self._moved, self._backs = water, {}, {}
        return water

    def _find_back(
        self,
        tether: Strands,
        pose: SE2,
        z: float,
        trail: Strand,
        occupancy: OccupancyMap,
        affords: Affords,
    ) -> _Back | None:
        trail = trail.then(self.place(pose, z, occupancy))
        # One after the other, each looked for only where those before leave some of it out.
        ways = [
            partial(self._way_along, tether.ways[0], 1),
            partial(self._way_along, tether.ways[-1], 1),
            *(partial(self._way_along, trail, pieces) for pieces in PIECES),
            partial(self._as_it_came, trail),
            partial(way_home, home=self.anchor),
        ]
        best: _Back | None = None
        looked_at: list[list[Decision]] = []
        for way in ways:
            moves = way(pose, z, occupancy)
            if moves is None or moves in looked_at:
                continue
            looked_at.append(moves)
            over, along = 0.0, list[Strands]()
            for lies in self.along(moves, tether, pose, z, occupancy):
                over = max(over, self.over(lies, tether, back=True))
                along.append(lies)
                if best is not None and over > best.over:
                    break
            out = max([tether, *along][-1].length - HOME, 0.0)
            back = _Back(moves, along, over, 0 if affords(moves) else len(moves), out)
            if best is None or back.cost < best.cost:
                best = back
            if not any(best.cost):
                break
        return best

    def _way_along(
        self, string: Strand, pieces: int, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> list[Decision] | None:
        """The shortest way beside each of some pieces of a string, from its end to the anchor."""
        moves: list[Decision] = []
        for k, piece in reversed(list(enumerate(string.pieces(pieces)))):
            x, y, up = piece.points[0].tolist()
            beside = partial(piece.beside, water=water_in(occupancy).free, reach=BESIDE)
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
        moves = list(self.moves_back(trail, pose, z, occupancy))
        return None if None in moves else [move for move in moves if move is not None]

    def moves_back(
        self, trail: Strand, pose: SE2, z: float, occupancy: OccupancyMap
    ) -> Iterator[Decision | None]:
        """The moves back along a trail, place by place; None, the last, where no move leads on."""
        protocol = occupancy.protocol
        for x, y, up in trail.points[::-1].tolist():
            node, turned = node_of(SE2(x, y, 0.0), up, protocol), 0
            while node_of(pose, z, protocol) != node:
                move = move_to(node, pose, z, protocol) if turned < protocol.headings else None
                if move is None or guard(move, pose, occupancy, protocol, z).decision != move:
                    yield None
                    return
                yield move
                pose, z = after(pose, z, move, occupancy)
                turned += 1
