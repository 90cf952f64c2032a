"""The shortest way over free ground, in the turns and advances that are allowed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.standin.ground import STANDOFF, Ground
from dream.standin.sight import Bool, Floats

UNREACHED = np.int16(10_000)
MOST_LAYERS = 200


@dataclass(frozen=True, slots=True)
class Moves:
    """The turns and advances of a schema. Positions lie on a lattice half the shortest advance wide."""

    turns_deg: tuple[float, ...]
    """Degrees, without sign; 0 is among them."""
    advances: tuple[float, ...]
    """Metres, without 0, ascending."""

    @property
    def headings(self) -> int:
        """In a full turn."""
        return round(360.0 / math.gcd(*(round(angle) for angle in self.turns_deg), 360))

    @property
    def lattice(self) -> float:
        """Metres between positions."""
        return 0.5 * self.advances[0]

    def offset(self, heading: int, advance: float) -> tuple[int, int]:
        """Steps of the lattice to the east and to the north."""
        angle = 2.0 * math.pi * heading / self.headings
        east, north = (
            math.floor(advance * f(angle) / self.lattice + 0.5 + 1e-9) for f in (math.cos, math.sin)
        )
        return east, north

    @property
    def turns(self) -> tuple[int, ...]:
        """In headings, positive to the left."""
        steps = [round(angle * self.headings / 360.0) for angle in self.turns_deg]
        return tuple(sorted({s for step in steps for s in (step, -step)}, key=abs))


@dataclass(frozen=True, slots=True, eq=False)
class Ways:
    """How many steps it takes from the vehicle to every position and heading."""

    moves: Moves
    steps: npt.NDArray[np.int16]
    """(headings, ny, nx); `UNREACHED` where no way leads."""
    heading: int
    """Of the vehicle."""
    here: tuple[int, int]
    """Index of its position, (iy, ix)."""
    x: Floats
    """(nx,) metres."""
    y: Floats
    """(ny,) metres."""
    free: dict[tuple[int, float], Bool]
    """By heading and advance: where it may begin."""

    def first(self, goal: tuple[int, int, int]) -> tuple[int, float]:
        """Turn in headings, and advance in metres, with which a shortest way to heading, iy, ix begins."""
        heading, iy, ix = goal
        move = (0, 0.0)
        while self.steps[heading, iy, ix] > 0:
            heading, iy, ix, move = self._before(heading, iy, ix)
        return move

    def _before(self, heading: int, iy: int, ix: int) -> tuple[int, int, int, tuple[int, float]]:
        wanted = self.steps[heading, iy, ix] - 1
        for advance in (*reversed(self.moves.advances), 0.0):
            east, north = self.moves.offset(heading, advance) if advance else (0, 0)
            jy, jx = iy - north, ix - east
            if not (0 <= jy < len(self.y) and 0 <= jx < len(self.x)):
                continue
            if advance and not self.free[heading, advance][jy, jx]:
                continue
            for turn in self.moves.turns:
                before = (heading - turn) % self.moves.headings
                if self.steps[before, jy, jx] == wanted:
                    return before, jy, jx, (turn, advance)
        raise AssertionError("every position that is reached has one before it")


def ways(ground: Ground, moves: Moves, barred: Sequence[tuple[int, float]] = ()) -> Ways:
    """All shortest ways from the vehicle.

    Args:
        ground: The map.
        moves: What is allowed.
        barred: Headings and advances that the first step may not have.
    """
    chart, lattice = ground.chart, moves.lattice
    rows, cols = ground.white.shape
    first_x = chart.x - math.floor((chart.x - chart.west) / lattice) * lattice
    first_y = chart.y - math.floor((chart.y - (chart.north - rows * chart.cell)) / lattice) * lattice
    x = np.arange(first_x, chart.west + cols * chart.cell, lattice)
    y = np.arange(first_y, chart.north, lattice)
    here = round((chart.y - first_y) / lattice), round((chart.x - first_x) / lattice)
    heading = round(chart.yaw / (2.0 * math.pi) * moves.headings) % moves.headings
    free = _free(ground, moves, x, y, here)
    steps = np.full((moves.headings, len(y), len(x)), UNREACHED)
    steps[heading, here[0], here[1]] = 0
    layer = np.zeros(steps.shape, np.bool_)
    layer[heading, here[0], here[1]] = True
    for count in range(1, MOST_LAYERS):
        turned = np.zeros_like(layer)
        for turn in moves.turns:
            turned |= np.roll(layer, turn, axis=0)
        reached = turned.copy()
        for (toward, advance), allowed in free.items():
            if count == 1 and (toward, advance) in barred:
                continue
            _shift_into(reached[toward], turned[toward] & allowed, *moves.offset(toward, advance))
        layer = reached & (steps == UNREACHED)
        if not layer.any():
            break
        steps[layer] = count
    return Ways(moves, steps, heading, here, x, y, free)


def _shift_into(target: Bool, source: Bool, east: int, north: int) -> None:
    ny, nx = source.shape
    target[max(north, 0) : ny + min(north, 0), max(east, 0) : nx + min(east, 0)] |= source[
        max(-north, 0) : ny + min(-north, 0), max(-east, 0) : nx + min(-east, 0)
    ]


def _free(
    ground: Ground, moves: Moves, x: Floats, y: Floats, here: tuple[int, int]
) -> dict[tuple[int, float], Bool]:
    at_x, at_y = np.meshgrid(x, y)
    narrow = min(STANDOFF, 8.0 * moves.lattice) + 0.5 * ground.chart.cell
    roomy = (ground.room > ground.least_room) & (ground.away > narrow)
    tight = ground.room > ground.least_room
    free = {}
    for heading in range(moves.headings):
        for advance in moves.advances:
            east, north = (step * moves.lattice for step in moves.offset(heading, advance))
            pieces = max(2, math.ceil(math.hypot(east, north) / (0.5 * ground.chart.cell)))
            allowed = np.ones(at_x.shape, np.bool_)
            out = np.ones((), np.bool_)
            own_x, own_y = float(x[here[1]]), float(y[here[0]])
            for k in range(1, pieces + 1):
                along = k / pieces
                allowed &= ground.look(roomy, at_x + along * east, at_y + along * north, 0.0) > 0
                out &= ground.look(tight, own_x + along * east, own_y + along * north, 0.0) > 0
            # Where the vehicle already is too near, it may go as long as it has room for its body.
            allowed[here] |= bool(out) and ground.look(roomy, own_x, own_y, 0.0) == 0
            free[heading, advance] = allowed
    return free
