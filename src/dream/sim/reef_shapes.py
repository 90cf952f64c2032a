"""Where a reef grows: every family of reefs as a list of strokes.

Fringing reefs follow the shore, string reefs wind across the bed, patch reefs are blobs apart from
each other, mixed ones are some of each; the letters L, S, O, K and E fill most of the arena. Widths
and lengths follow the literature on intertidal and subtidal eastern-oyster reefs: strings and
fringes 3-5 m wide, patches 3-10 m across, a few metres of bare bed between neighbours. The bounds that
a family is asked to fill have their middle at the origin.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dream.geometry import Bounds
from dream.sim.sampling import Float64Array, between, direction, uniform, uniforms

PIECE = 6.5
"""Metres of a stroke that make one group; long strokes are cut into pieces about as long."""
PATCH = 5.0
"""Metres: strokes shorter than this are single patches."""
MARGIN = 3.0
"""Least metres between a stroke's edge and the bounds."""


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """A stretch of reef, drawn with a brush."""

    line: Float64Array
    """(K, 2) metres: the centre line; one that ends where it begins is a ring. K ≥ 2."""
    half_width: float
    """Metres, on average."""

    @property
    def length(self) -> float:
        """Metres along the centre line."""
        return float(self._steps.sum())

    @property
    def pieces(self) -> int:
        """Number of groups that the stroke is cut into, about `PIECE` metres each."""
        return max(1, round((self.length + self.half_width) / PIECE))

    @property
    def _steps(self) -> Float64Array:
        delta = np.diff(self.line, axis=0)
        return np.asarray(np.sqrt((delta * delta).sum(axis=1)))

    def nearest(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Distance to the centre line, and how far along it in [0, 1], of points of equal shape."""
        steps = self._steps
        begun = np.concatenate([[0.0], np.cumsum(steps)])
        best = np.full(np.shape(x), np.inf)
        along = np.zeros(np.shape(x))
        for k, step in enumerate(steps):
            (ax, ay), (bx, by) = self.line[k], self.line[k + 1]
            ux, uy = (bx - ax) / step, (by - ay) / step
            t = np.clip((x - ax) * ux + (y - ay) * uy, 0.0, step)
            dx, dy = x - ax - t * ux, y - ay - t * uy
            square = dx * dx + dy * dy
            nearer = square < best
            best = np.where(nearer, square, best)
            along = np.where(nearer, begun[k] + t, along)
        return np.sqrt(best), along / begun[-1]


def strings(bounds: Bounds, rng: np.random.Generator) -> list[Stroke]:
    """One to three winding strings, 15-32 m long."""
    strokes: list[Stroke] = []
    count = between(rng, 1, 3)
    for _ in range(count):
        long = (24.0, 32.0) if count == 1 else (15.0, 28.0)
        _add(strokes, _string(bounds, uniform(rng, *long), strokes, rng))
    return strokes


def patches(bounds: Bounds, rng: np.random.Generator) -> list[Stroke]:
    """Four to seven blobs, spread over the arena."""
    strokes: list[Stroke] = []
    for _ in range(between(rng, 4, 7)):
        _add(strokes, _patch(bounds, strokes, rng))
    return strokes


def fringes(bounds: Bounds, rng: np.random.Generator) -> list[Stroke]:
    """A wavy band a few metres inside one side, or inside two sides that meet; sometimes broken once."""
    quarter = between(rng, 0, 3)
    # As before it is turned: by an odd number of quarters, the sides change places.
    sides = (bounds.width, bounds.depth) if quarter % 2 == 0 else (bounds.depth, bounds.width)
    east, north = 0.5 * np.array(sides) - uniform(rng, 5.0, 7.0)
    if rng.random() < 0.5:
        reach = uniform(rng, 0.75, 0.98)
        corners = np.array([[-reach * east, north], [reach * east, north]])
    else:
        first, second = uniforms(rng, 0.2, 0.9, 2)
        corners = np.array(
            [[(1.0 - 2.0 * first) * east, north], [east, north], [east, (1.0 - 2.0 * second) * north]]
        )
    line = _wavy(_rounded(corners, 4.0), uniform(rng, 0.7, 1.5), rng)
    width = uniform(rng, 1.75, 2.3)
    line = _turned(line, quarter)
    if rng.random() < 0.5:
        return [Stroke(line, width)]
    cut = int(len(line) * uniform(rng, 0.35, 0.65))
    # Edges fade half a metre wide, so this leaves two to five metres of bare bed.
    gap = math.ceil(width + uniform(rng, 1.0, 2.5))
    return [Stroke(line[: cut - gap], width), Stroke(line[cut + gap :], width)]


def mixed(bounds: Bounds, rng: np.random.Generator) -> list[Stroke]:
    """One or two strings with two to four patches; a fringe as well in one seed of three."""
    strokes = fringes(bounds, rng) if rng.random() < 0.33 else []
    for _ in range(between(rng, 1, 2)):
        _add(strokes, _string(bounds, uniform(rng, 13.0, 20.0), strokes, rng))
    for _ in range(between(rng, 2, 4)):
        _add(strokes, _patch(bounds, strokes, rng))
    return strokes


def _arc(x: float, y: float, rx: float, ry: float, begin: float, end: float) -> list[tuple[float, float]]:
    """Points of an ellipse; angles in degrees."""
    count = math.ceil(abs(end - begin) / 15.0)
    points = (direction(math.radians(begin + (end - begin) * k / count)) for k in range(count + 1))
    return [(x + rx * float(c), y + ry * float(s)) for c, s in points]


LETTERS: Mapping[str, tuple[list[tuple[float, float]], ...]] = {
    "L": ([(-0.75, 1.0), (-0.75, -1.0), (0.8, -1.0)],),
    "S": (_arc(0.0, 0.5, 0.72, 0.5, 20.0, 270.0) + _arc(0.0, -0.5, 0.72, 0.5, 90.0, -160.0)[1:],),
    "O": (_arc(0.0, 0.0, 0.8, 1.0, 0.0, 360.0),),
    "K": ([(-0.7, 1.0), (-0.7, -1.0)], [(0.75, 1.0), (-0.7, 0.0), (0.8, -1.0)]),
    "E": ([(0.7, 1.0), (-0.7, 1.0), (-0.7, -1.0), (0.7, -1.0)], [(-0.7, 0.0), (0.55, 0.0)]),
}
"""Centre lines in a box from −1 to 1, in the order they are written."""


def letter(which: str, bounds: Bounds, rng: np.random.Generator) -> list[Stroke]:
    """A letter with strokes about 3 m wide that fills most of the arena; turned, mirrored and shifted."""
    half = 0.5 * min(bounds.width, bounds.depth)
    mirror = 1.0 if rng.random() < 0.5 else -1.0
    c, s = direction(between(rng, 0, 3) * 0.5 * math.pi + uniform(rng, -0.25, 0.25))
    size = (half - MARGIN - 2.0) * uniform(rng, 0.72, 0.84)
    lines = [size * np.array(points) * (mirror, 1.0) for points in LETTERS[which]]
    lines = [
        np.stack([c * line[:, 0] - s * line[:, 1], s * line[:, 0] + c * line[:, 1]], 1) for line in lines
    ]
    everything = np.concatenate(lines)
    room = half - MARGIN - 2.2
    low, high = -room - everything.min(axis=0), room - everything.max(axis=0)
    share = uniforms(rng, 0.0, 1.0, 2)
    # Where the turned letter is larger than its room it is shrunk about its middle instead of shifted.
    shift = np.where(high > low, low + share * (high - low), 0.5 * (low + high))
    shrink = min(1.0, float((2.0 * room / np.ptp(everything, axis=0)).min()))
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    wobble = uniform(rng, 0.2, 0.5)
    return [
        Stroke(
            _wavy(_rounded((line - middle) * shrink + middle + shift, 1.5), wobble, rng),
            uniform(rng, 1.6, 1.85),
        )
        for line in lines
    ]


def _add(strokes: list[Stroke], stroke: Stroke | None) -> None:
    if stroke is not None:
        strokes.append(stroke)


def _string(bounds: Bounds, length: float, others: list[Stroke], rng: np.random.Generator) -> Stroke | None:
    """A curve of random curvature, or None where no room is left beside the others."""
    width = uniform(rng, 1.65, 2.3)
    room = 0.5 * np.array([bounds.width, bounds.depth]) - MARGIN - width
    count = round(length)
    for _ in range(300):
        turns = np.cumsum(uniforms(rng, -0.13, 0.13, count))
        turns = np.clip(turns - turns.mean() + uniform(rng, -0.06, 0.06), -0.28, 0.28)
        heading = uniform(rng, 0.0, 2.0 * math.pi)
        begin = -room + (room + room) * rng.random(2)
        steps = np.stack([direction(float(angle)) for angle in heading + np.cumsum(turns)])
        line = np.concatenate([begin[None], begin + np.cumsum(steps, axis=0)])
        if (np.abs(line) <= room).all() and _apart(Stroke(line, width), others, 3.0) and _simple(line, width):
            return Stroke(line, width)
    return None


def _patch(bounds: Bounds, others: list[Stroke], rng: np.random.Generator) -> Stroke | None:
    """A round or longish blob as far from the others as a few tries find, or None."""
    width = uniform(rng, 1.8, 3.4)
    long = uniform(rng, 0.3, 1.0) if rng.random() < 0.5 else uniform(rng, 1.5, 4.5)
    best, best_room = None, 3.0
    for _ in range(12):
        room = 0.5 * np.array([bounds.width, bounds.depth]) - MARGIN - width - 0.5 * long
        middle = -room + (room + room) * rng.random(2)
        along = 0.5 * long * direction(uniform(rng, 0.0, math.pi))
        stroke = Stroke(np.stack([middle - along, middle, middle + along]), width)
        free = min((_gap(stroke, other) for other in others), default=10.0)
        # A place with ten metres around it is as good as any: patches spread, but not on a grid.
        if min(free, 10.0) > best_room:
            best, best_room = stroke, min(free, 10.0)
    return best


def _gap(a: Stroke, b: Stroke) -> float:
    """Metres of bare bed between two strokes."""
    distance, _ = b.nearest(a.line[:, 0], a.line[:, 1])
    return float(distance.min()) - a.half_width - b.half_width


def _apart(stroke: Stroke, others: list[Stroke], gap: float) -> bool:
    return all(_gap(stroke, other) >= gap for other in others)


def _simple(line: Float64Array, width: float) -> bool:
    """Does the line, at 1 m steps, keep off its own earlier course?"""
    far = math.ceil(4.0 * width)
    for k in range(far, len(line)):
        delta = line[: k - far + 1] - line[k]
        if (delta * delta).sum(axis=1).min() < np.square(2.0 * width + 2.0):
            return False
    return True


def _rounded(corners: Float64Array, radius: float) -> Float64Array:
    """The line through the corners, at about 1 m steps, its corners cut off and smoothed."""
    points = corners
    for _ in range(3):
        cut = [points[0]]
        for a, b in itertools.pairwise(points):
            step = float(np.sqrt(np.square(b - a).sum()))
            share = min(0.25, radius / step)
            cut += [a + share * (b - a), b - share * (b - a)]
        points = np.array([*cut, points[-1]])
    pieces = [points[:1]]
    for a, b in itertools.pairwise(points):
        count = max(1, round(float(np.sqrt(np.square(b - a).sum()))))
        pieces.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    line = np.concatenate(pieces)
    steps = np.concatenate([[True], np.square(line[1:] - line[:-1]).sum(axis=1) > 1e-6])
    return np.asarray(line[steps])


def _wavy(line: Float64Array, amplitude: float, rng: np.random.Generator) -> Float64Array:
    """The line displaced sideways by smooth random waves 8 m long; a ring stays closed."""
    closed = bool((np.abs(line[0] - line[-1]) < 1e-6).all())
    count = len(line)
    knots = uniforms(rng, -1.0, 1.0, count // 4 + 4)
    position = np.arange(count) / 4.0
    first = position.astype(np.intp)
    t = position - first
    t = t * t * (3.0 - 2.0 * t)
    offset = amplitude * (knots[first] * (1.0 - t) + knots[first + 1] * t)
    if closed:
        fade = np.minimum(1.0, np.minimum(np.arange(count), count - 1 - np.arange(count)) / 6.0)
        offset = offset * fade
    tangent = np.gradient(line, axis=0)
    tangent /= np.sqrt((tangent * tangent).sum(axis=1, keepdims=True))
    return np.asarray(line + offset[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], 1))


def _turned(line: Float64Array, quarters: int) -> Float64Array:
    """Turned by quarter turns about the origin."""
    x, y = line[:, 0], line[:, 1]
    return np.stack([(x, y), (-y, x), (-x, -y), (y, -x)][quarters], axis=1)
