"""How a tether may lie in the water."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dream.geometry import FloatArray
from dream.homeward.ways import Place
from dream.types import BoolArray

if TYPE_CHECKING:
    from dream.mapping._kernels.strings import FreeWater

BEND = 0.25
"""Metres: what bends it aside by less is no bend, but the map's cells."""
SLIP = 0.1
"""Metres by which a string has to get shorter where it slides off what it lies over: less makes no other way
to lie."""
SLID = 0.005
"""Metres by which a string gets shorter where it slides at all: less is the error of pulling it taut."""
FRICTION = 0.5
"""Coefficient on what a tether lies over: more holds it where it rarely stays, less lets go what does."""
NEAR = 0.25
"""Metres within which the vehicle is where it was."""
ASIDE = 0.75
"""Metres within which two strings lie alike."""
SAMPLES = 48
"""Points by which they are compared."""
_SHARES = np.linspace(0.0, 1.0, SAMPLES)
WAYS = 8
"""In which it may lie that are kept: the longest, and the shortest."""


class StrandWater(NamedTuple):
    """Where a tether may lie."""

    free: FreeWater
    """What is known to be free."""
    clear: FreeWater
    """Of that, what is farther than a box from everything else: something finer than a box may stick out that
    far, and what is known to be free may be solid in part."""

    @property
    def level(self) -> bool:
        """Is it alike at all heights? Nothing slides over what is solid then, or catches on it."""
        return self.clear is self.free

    @classmethod
    def of(cls, free: FreeWater) -> StrandWater:
        """With what is clear of it."""
        from scipy import ndimage

        near = 1 - free.free
        for axis in range(3):
            near = ndimage.maximum_filter1d(near, 3, axis=axis, mode="constant", cval=1)
        return cls(free, free._replace(free=1 - near))


@dataclass(frozen=True, eq=False)
class Strand:
    """A tether as it may lie when it is pulled taut: a polygon from its anchor to the vehicle.

    What it does: its end goes with the vehicle, and it is pulled taut by cutting its corners, through water
    that is known to be free alone. So it stays on that side of everything on which the vehicle swam, and
    in the plane it is no shorter than the taut string through what is really free.
    """

    points: FloatArray
    """(n, 3) x, y and z of its vertices, metres in the world: from the anchor to the vehicle."""
    was: Strand | None = None
    """How it lay before the vehicle's last move, and lies again once that is taken back; None where it slid
    off something meanwhile, which it need not slide back over."""

    @classmethod
    def at(cls, anchor: Place) -> Strand:
        """Nothing of it is out."""
        return cls(np.array([anchor]))

    def to(self, place: Place, water: FreeWater) -> Strand:
        """Once the vehicle has moved straight to a place; held where it lies over something."""
        from dream.mapping._kernels.strings import tighten

        return Strand(tighten(water, np.vstack([self.points, place])))

    def slid(self, water: FreeWater, friction: float = 0.0) -> Strand:
        """Once it has slid off what it lies over, to where it is shorter nearby, against some friction."""
        from dream.mapping._kernels.strings import slide

        return Strand(slide(water, self.points, friction))

    def then(self, place: Place, near: float = 0.0) -> Strand:
        """With a place more, not pulled taut, unless that is so near the last; without the last where it is
        so near the one before."""
        count = len(self.points)
        if math.dist(self.points[-1], place) <= near:
            return self
        if count > 1 and math.dist(self.points[-2], place) < near:
            count = max(count - 2, 1)
        return Strand(np.vstack([self.points[:count], place]))

    def ends_at(self, place: Place) -> bool:
        """Is its end there?"""
        return math.dist(self.points[-1], place) < NEAR

    def taken_back(self, place: Place, water: FreeWater) -> Strand | None:
        """How it lies again at a place where the vehicle was before its last move; None where it may not."""
        from dream.mapping._kernels.strings import is_free

        if self.was is None or self.ends_at(place) or not self.was.ends_at(place):
            return None
        points = np.vstack([self.was.points[: max(len(self.was.points) - 1, 1)], place])
        return Strand(points, self.was.was) if is_free(water, points) else None

    def after_move(self, pulled: Strand, lies: Strand) -> Strand:
        """As it lies after a move, once it was pulled taut and slid; known to be as it lay before, unless it
        came off something."""
        way = math.dist(self.points[-1], lies.points[-1])
        came_off = max(pulled.length, self.length - way) - lies.length > SLID
        return replace(lies, was=None if came_off else self.was if way < NEAR else self)

    @cached_property
    def length(self) -> float:
        """Metres that are out."""
        points = self.points.tolist()
        return math.fsum(map(math.dist, points, points[1:]))

    @cached_property
    def turns(self) -> float:
        """Turns of all its bends together, to either side."""
        along = np.diff(_simplified(self.points), axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        cosines = (along[:-1] * along[1:]).sum(axis=1)
        return float(np.arccos(np.clip(cosines, -1.0, 1.0)).sum() / (2.0 * math.pi))

    @cached_property
    def sampled(self) -> FloatArray:
        """(`SAMPLES`, 3) points on it, alike far from each other."""
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(self.points, axis=0), axis=1).cumsum()])
        at = along[-1] * _SHARES
        return np.stack([np.interp(at, along, axis) for axis in self.points.T], axis=1)

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


@dataclass(frozen=True, eq=False)
class Strands:
    """All ways in which a tether may lie.

    What it does: what lies over something may stay there or slide off, which depends on friction and on what
    is finer than the map. Both are kept, as two strands, and what becomes of each. One that stays keeps a box
    away from all that is not known to be free, and is held by friction; one that slides goes where it is
    shorter nearby. Once the vehicle takes its last move back, what did not slide lies again as it did.
    Assumes: a tether that neither sinks nor drifts. Under a planar protocol it lies in one way.
    Fails when: it lies over something that the map does not show. Of more ways than `WAYS` the longest are
    kept, and the shortest.
    """

    ways: tuple[Strand, ...]
    """The longest first."""

    @classmethod
    def at(cls, anchor: Place) -> Strands:
        """Nothing of it is out."""
        return cls((Strand.at(anchor),))

    def to(self, place: Place, water: StrandWater) -> Strands:
        """Once the vehicle has moved straight to a place."""
        found: list[Strand] = []
        for strand in self.ways:
            if water.level:
                found.append(strand.to(place, water.free).slid(water.free))
                continue
            back = strand.taken_back(place, water.free)
            if back is not None:
                found.append(back)
                continue
            pulled = strand.to(place, water.free)
            slid = strand.after_move(pulled, pulled.slid(water.free))
            pulled = strand.to(place, water.clear)
            held = strand.after_move(pulled, pulled.slid(water.clear, FRICTION))
            found.append(held)
            if held.length - slid.length > SLIP:
                found.append(slid)
        found.sort(key=lambda one: -one.length)
        kept: list[Strand] = []
        for one in found:
            aside = np.array([other.sampled for other in kept]).reshape(-1, SAMPLES, 3) - one.sampled
            if ((aside**2).sum(axis=2).max(axis=1) > ASIDE**2).all():
                kept.append(one)
        return Strands(tuple(kept[: WAYS - 1] + kept[WAYS - 1 :][-1:]))

    @cached_property
    def length(self) -> float:
        """Metres that may be out at most."""
        return max(one.length for one in self.ways)

    @cached_property
    def turns(self) -> float:
        """Turns that it may be wound at most."""
        return max(one.turns for one in self.ways)


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
