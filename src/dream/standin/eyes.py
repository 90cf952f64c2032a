"""What the pictures show: read from their pixels, with nothing but the colours that the prompt names."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

Point = tuple[float, float]
FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
UInt8Array = npt.NDArray[np.uint8]

WHITE, GRAY, GREEN, BLACK, DARK_GREEN = range(5)
"""What a cell can be: unexplored, explored, target, solid, both."""
COLORS = np.array([(255, 255, 255), (127, 127, 127), (0, 200, 0), (0, 0, 0), (0, 95, 0)], float)
LINED, ROBOT, MARKED, NOTHING = 8, 100, 101, 255
"""What else a colour may say; see `_known`."""
BLUE, YELLOW, INK = (0, 70, 255), (255, 201, 14), (40, 40, 40)
WATER = (60, 110, 190)
LINE, LINE_SHARE = np.array((90, 90, 120), float), 70 / 255
"""The grid, and how strongly it is drawn."""
VIEW_SHARE = 34 / 255
"""How strongly the blue of the camera's sector is laid over the map."""
TOLERANCE = 6
"""Of a colour, in each channel."""
UNREADABLE = 0.12
"""Share of the map that may be hidden under lines and marks."""
DISC, DIGIT = 9, 14
"""Radius of a mark and height of its number, pixels."""
ARROW = ((1.0, 0.0), (-0.75, 0.7), (-0.4, 0.0), (-0.75, -0.7))
"""Corners of the vehicle's arrow; its position is the origin, and it points along the first axis."""
CELLS_A_LINE = 20
"""Cells between two lines of the grid."""
MOST_LABELS = 40
"""Grid spacings between the world's origin and the first line, at most."""
MOST_PIXELS = 1 << 23


class Unreadable(ValueError):  # noqa: N818 - it says what was wrong with a picture.
    """A picture does not show what it should."""


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """What the map shows. Positions are in metres east and north of its lower left corner."""

    cells: UInt8Array
    """(rows, cols) what is there; row 0 is the southernmost."""
    cell: float
    """Side of a cell, metres."""
    position: tuple[float, float]
    """Of the vehicle."""
    heading: float
    """Radians, 0 = east, positive to the left."""
    marks: dict[int, tuple[float, float]]
    """By number."""
    origin: tuple[float, float]
    """World x and y of the lower left corner, by the numbers along the edges."""

    def at(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of a position, the nearest one on the map."""
        rows, cols = self.cells.shape
        return min(max(int(y / self.cell), 0), rows - 1), min(max(int(x / self.cell), 0), cols - 1)


def open_picture(png: bytes, name: str) -> UInt8Array:
    """(H, W, 3) of a PNG file."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
            if image.width * image.height > MOST_PIXELS:
                raise Unreadable(f"{name}: {image.width} x {image.height} pixels are too many")
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise Unreadable(f"{name}: no PNG") from error


def read_map(picture: UInt8Array, pixels: float, grid: float) -> Map:
    """The map.

    Args:
        picture: (H, W, 3).
        pixels: Of a metre, as the text says.
        grid: Metres between the lines, as the text says.
    """
    top, bottom, left, right = _frame(picture)
    inside = picture[top:bottom, left:right]
    _check_legend(picture[bottom:])
    said = _said(inside)
    down, across = _lines(said, 0), _lines(said, 1)
    for found, what in ((down, "down"), (across, "across")):
        gaps = np.diff(found)
        if len(gaps) == 0 or np.abs(gaps - grid * pixels).max() > 1.5:
            raise Unreadable(f"map: lines {what} every {gaps} pixels, and not every {grid * pixels:g}")
    classes = _classes(said)
    x, y, heading = _vehicle(said)
    height = inside.shape[0]
    marks = {
        number: (column / pixels, (height - row) / pixels)
        for number, (column, row) in _discs(inside, said).items()
    }
    side = grid * pixels / CELLS_A_LINE
    rows = (np.arange(int(height / side)) + 0.5) * side
    cols = (np.arange(int(inside.shape[1] / side)) + 0.5) * side
    cells = classes[::-1][np.ix_(rows.astype(int), cols.astype(int))]
    origin = _origin(picture, (top, bottom, left, right), down, across, pixels, grid)
    return Map(cells, side / pixels, (x / pixels, (height - y) / pixels), heading, marks, origin)


def _frame(picture: UInt8Array) -> tuple[int, int, int, int]:
    """Rows and columns of the map within its dark frame: first and past."""
    dark = np.asarray((np.abs(picture.astype(int) - INK) <= TOLERANCE).all(axis=2))

    def longest(lines: BoolArray) -> npt.NDArray[np.intp]:
        """Those with an unbroken dark stretch of half the picture."""
        need = lines.shape[1] // 2
        run = np.zeros(len(lines), int)
        best = np.zeros(len(lines), int)
        for k in range(lines.shape[1]):
            run = np.where(lines[:, k], run + 1, 0)
            best = np.maximum(best, run)
        return np.flatnonzero(best >= need)

    rows, cols = longest(dark), longest(dark.T)
    for found, what in ((rows, "rows"), (cols, "columns")):
        if len(found) != 4 or found[1] - found[0] != 1 or found[3] - found[2] != 1:
            raise Unreadable(
                f"map: no frame of four dark lines, two and two, but dark {what} {found.tolist()}"
            )
    return int(rows[1]) + 1, int(rows[2]), int(cols[1]) + 1, int(cols[2])


def _check_legend(below: UInt8Array) -> None:
    """Below the map each colour stands in a box of its own."""
    for color in (*COLORS, BLUE):
        hit = (np.abs(below.astype(float) - color) <= 1.0).all(axis=2)
        if hit.sum() < 30:
            raise Unreadable(f"map: the legend has no box of the colour {tuple(int(c) for c in color)}")


@cache
def _known() -> UInt8Array:
    """(2^24,) what each colour says: what a cell is, plus `LINED` under a line; or `ROBOT` or `MARKED`."""
    known = np.full(1 << 24, NOTHING, np.uint8)
    blue = np.array(BLUE, float)
    for kind, color in enumerate(COLORS):
        lined = color * (1 - LINE_SHARE) + LINE * LINE_SHARE
        for drawn, says in ((color, kind), (lined, kind + LINED)):
            for shown in (drawn, drawn * (1 - VIEW_SHARE) + blue * VIEW_SHARE):
                known[_codes_near(shown)] = says
    known[_codes_near(blue)] = ROBOT
    known[_codes_near(np.array(YELLOW, float))] = MARKED
    return known


def _codes_near(color: FloatArray) -> npt.NDArray[np.intp]:
    spans = [np.arange(max(round(c) - TOLERANCE, 0), min(round(c) + TOLERANCE, 255) + 1) for c in color]
    red, green, blue = np.meshgrid(*spans, indexing="ij")
    return np.asarray((red << 16 | green << 8 | blue).ravel().astype(np.intp))


def _said(picture: UInt8Array) -> UInt8Array:
    """(H, W) what the colour of each pixel says; see `_known`."""
    red, green, blue = (picture[..., k].astype(np.intp) for k in range(3))
    return np.asarray(_known()[red << 16 | green << 8 | blue])


def _lines(said: UInt8Array, axis: int) -> FloatArray:
    """Where lines of the grid run, pixels: rows for axis 0, columns for axis 1."""
    lined = (said >= LINED) & (said < LINED + len(COLORS))
    return np.flatnonzero(lined.mean(axis=1 - axis) > 0.5).astype(float)


def _classes(said: UInt8Array) -> UInt8Array:
    """(H, W) what each pixel is; under lines and marks, what is nearest to it."""
    from scipy.ndimage import distance_transform_edt

    hidden = said > LINED + len(COLORS)
    if hidden.mean() > UNREADABLE:
        raise Unreadable(f"map: {hidden.mean():.0%} of it has colours that are none of a map's")
    nearest = distance_transform_edt(hidden, return_distances=False, return_indices=True)
    return np.asarray(said[tuple(nearest)] % LINED)


def _vehicle(said: UInt8Array) -> tuple[float, float, float]:
    """Column and row of the vehicle, and where it points."""
    from scipy.ndimage import binary_opening, label

    # Thin lines are as blue; a white edge parts them from the arrow.
    thick = binary_opening(said == ROBOT, np.ones((5, 5), bool))
    if not thick.any():
        raise Unreadable("map: no blue arrow")
    parts, _ = label(said == ROBOT)
    rows, cols = np.nonzero(parts == np.bincount(parts[thick]).argmax())
    heading = _heading(cols - cols.mean(), rows.mean() - rows)
    area, middle = _arrow()
    behind = middle * math.sqrt(len(rows) / area)
    x = cols.mean() + 0.5 - behind * math.cos(heading)
    y = rows.mean() + 0.5 + behind * math.sin(heading)
    return float(x), float(y), heading


def _heading(x: FloatArray, y: FloatArray) -> float:
    """Where an arrow points whose pixels lie there around its middle: its tip is the corner apart."""
    angles, away = np.arctan2(y, x), np.hypot(x, y)
    corners: list[float] = []
    for _ in range(3):
        far = away >= 0.93 * away.max()
        # Of several pixels as far, those around the farthest.
        beside = far & (np.cos(angles - angles[away.argmax()]) > 0.9)
        corner = math.atan2(y[beside].mean(), x[beside].mean())
        corners.append(corner)
        away = np.where(np.cos(angles - corner) > math.cos(0.7), 0.0, away)
    gaps = [math.cos(corners[k - 2] - corners[k - 1]) for k in range(3)]
    tip = corners[int(np.argmax(gaps))]
    others = [corner for corner in corners if corner != tip]
    east = math.cos(tip) - sum(map(math.cos, others))
    north = math.sin(tip) - sum(map(math.sin, others))
    return math.atan2(north, east)


@cache
def _arrow() -> tuple[float, float]:
    """Of the arrow in its own measure: its area, and where its middle lies on its axis."""
    x, y = np.array(ARROW).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return float(abs(cross.sum()) / 2.0), float(((x + np.roll(x, -1)) * cross).sum() / (3.0 * cross.sum()))


# ---------------------------------------------------------------------------------------------- numbers


def _discs(inside: UInt8Array, said: UInt8Array) -> dict[int, tuple[float, float]]:
    """Column and row of each numbered disc."""
    from scipy.signal import fftconvolve

    yellow = (said == MARKED).astype(np.float32)
    if yellow.sum() < 50:
        return {}
    span = np.arange(-DISC, DISC + 1)
    disc = (np.hypot(*np.meshgrid(span, span)) <= DISC).astype(np.float32)
    share = fftconvolve(yellow, disc, mode="same") / disc.sum()
    found: dict[int, tuple[float, float]] = {}
    while share.max() > 0.55:
        row, col = (int(k) for k in np.unravel_index(int(share.argmax()), share.shape))
        number = _number(inside, row, col)
        if number in found:
            raise Unreadable(f"map: two marks have the number {number}")
        found[number] = (col, row)
        share[max(row - 2 * DISC, 0) : row + 2 * DISC + 1, max(col - 2 * DISC, 0) : col + 2 * DISC + 1] = 0.0
    return found


def _number(picture: UInt8Array, row: int, col: int) -> int:
    """The number in a disc."""
    half = DISC - 3
    best: list[tuple[float, int]] = []
    for number in range(1, 10):
        shape = _digit(number)
        misses = []
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                r, c = row + i, col + j
                patch = picture[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1]
                if patch.shape[:2] != shape.shape:
                    continue
                dark = (np.abs(patch.astype(int) - INK) <= 60).all(axis=2)
                misses.append(float((dark != shape).sum()) / shape.sum())
        best.append((min(misses, default=9.0), number))
    best.sort()
    if best[0][0] > 0.2 or best[1][0] - best[0][0] < 0.15:
        raise Unreadable(f"map: a mark at column {col}, row {row} has no number that can be read")
    return best[0][1]


@cache
def _digit(number: int) -> BoolArray:
    """How a number looks in its disc."""
    from PIL import Image, ImageDraw, ImageFont

    half = DISC - 3
    image = Image.new("L", (64, 64), 0)
    pen = ImageDraw.Draw(image)
    pen.fontmode = "1"
    pen.text((32, 32), str(number), fill=255, font=ImageFont.load_default(DIGIT), anchor="mm")
    return np.asarray(image)[32 - half : 33 + half, 32 - half : 33 + half] > 127


@lru_cache(maxsize=64)
def _first_label(
    strip: bytes, shape: tuple[int, int], places: tuple[Point, ...], letter: int, grid: float, anchor: str
) -> float:
    """What is written at the first of some places, where each next one is a grid spacing more.

    Args:
        strip: Dark pixels of a part of the picture, a byte each.
        shape: Its rows and columns.
        places: Column and row of each label's anchor.
        letter: Height of the writing, pixels.
        grid: Metres from label to label.
        anchor: See Pillow.
    """
    from PIL import Image, ImageDraw, ImageFont

    seen = np.frombuffer(strip, np.bool_).reshape(shape)
    font = ImageFont.load_default(letter)
    misses = []
    for first in range(-MOST_LABELS, MOST_LABELS + 1):
        image = Image.new("L", shape[::-1], 0)
        pen = ImageDraw.Draw(image)
        for k, place in enumerate(places):
            pen.text(place, f"{(first + k) * grid:g}", fill=255, font=font, anchor=anchor)
        written = np.asarray(image) > 127
        misses.append(float((written != seen).sum()) / max(written.sum(), 1))
    order = np.argsort(misses)
    if misses[order[0]] > 0.35 or misses[order[1]] - misses[order[0]] < 0.05:
        raise Unreadable("map: the numbers along the edges cannot be read")
    return (int(order[0]) - MOST_LABELS) * grid


def _origin(
    picture: UInt8Array,
    frame: tuple[int, int, int, int],
    down: FloatArray,
    across: FloatArray,
    pixels: float,
    grid: float,
) -> tuple[float, float]:
    """World x and y of the lower left corner."""
    top, bottom, left, right = frame
    letter = round(left / 3)
    dark = np.asarray((picture.astype(int) < 140).all(axis=2))
    below = dark[bottom + 2 : bottom + 2 + 2 * letter]
    beside = dark[: bottom + letter, : left - 2]
    # A number stands also where a line would run along the frame. Rows grow downwards, numbers upwards.
    columns = _with_edges(across, grid * pixels, right - left)
    rows = _with_edges(down, grid * pixels, bottom - top)[::-1]
    eastwards = tuple((left + column, 0.35 * letter - 2) for column in columns)
    x = _first_label(below.tobytes(), below.shape, eastwards, letter, grid, "mt")
    upwards = tuple((left - 0.5 * letter, top + row) for row in rows)
    y = _first_label(beside.tobytes(), beside.shape, upwards, letter, grid, "rm")
    return x - columns[0] / pixels, y - (bottom - top - rows[0]) / pixels


def _with_edges(lines: FloatArray, spacing: float, length: int) -> list[float]:
    """Where lines run, and where one would run along the edge."""
    all_lines = [lines[0] - spacing, *lines, lines[-1] + spacing]
    return [line for line in all_lines if -1.0 <= line <= length + 1.0]


# ------------------------------------------------------------------------------------- the camera's pictures


def check_camera(picture: UInt8Array) -> None:
    """A photograph: neither gray nor of few colours."""
    if len(np.unique(picture[::4, ::4].reshape(-1, 3), axis=0)) < 100:
        raise Unreadable("camera: too few colours for a photograph")
    if (picture.max(axis=2) - picture.min(axis=2)).mean() < 4.0:
        raise Unreadable("camera: it has no colour")


def check_depth(picture: UInt8Array) -> None:
    """Gray, and brighter below, where the ground is near."""
    if (picture != picture[..., :1]).any():
        raise Unreadable("depth: it is not gray")
    half = len(picture) // 2
    if picture[half:].mean() <= picture[:half].mean():
        raise Unreadable("depth: the ground below is not nearer than what is above")


def check_labels(picture: UInt8Array) -> None:
    """Of the colours that the text names, and no others."""
    known = [*COLORS[[GRAY, GREEN, BLACK]], WATER]
    hit = np.zeros(picture.shape[:2], bool)
    for color in known:
        hit |= (np.abs(picture.astype(int) - np.asarray(color, int)) <= 1).all(axis=2)
    if not hit.all():
        raise Unreadable(f"labels: {1 - hit.mean():.1%} of it has colours that are no label's")
