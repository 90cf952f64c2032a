"""Volume → picture: vertical slices, and a view from the side and above."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.mapping.drawing import GRID_LINE, INK, PAPER, TRAIL, VEHICLE, Color

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

    from dream.mapping.volume import Surface, Volume

Float64Array = npt.NDArray[np.float64]
Place = tuple[float, float, float]

UNKNOWN: Color = (255, 255, 255)
FREE: Color = (214, 230, 245)
SOLID: Color = (110, 112, 118)
TO_INSPECT: Color = (230, 140, 10)
INSPECTED: Color = (0, 120, 110)
LEGEND: tuple[tuple[Color, str], ...] = (
    (SOLID, "solid"),
    (TO_INSPECT, "target, not inspected"),
    (INSPECTED, "target, inspected"),
)
LETTER = 13
"""Height of letters, pixels."""
EDGE = 34
"""Pixels around a picture, for figures and legend."""
LIGHT = np.array([-0.35, -0.5, 0.8]) / np.linalg.norm([-0.35, -0.5, 0.8])
"""Where light comes from; what looks away from it is darker."""


def draw_slice(
    volume: Volume,
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    vehicle: Place | None = None,
    scale: int = 24,
) -> Image.Image:
    """What is known in the vertical plane between two places, seen from the right of the way between them.

    Args:
        volume: What is known; only read.
        start: World x and y of the left edge.
        end: Of the right edge.
        vehicle: Where it is; drawn where it is beside the plane, too.
        scale: Pixels a metre.

    Returns:
        An RGB image: metres along the plane below, depth under water on the left.

    Raises:
        ValueError: Start and end are one place, or nothing is known.
    """
    from PIL import Image, ImageDraw

    from dream.mapping import volume as states

    if volume.box is None:
        raise ValueError("volume: expected one in which something is known, got an empty one")
    length = math.dist(start, end)
    if not length > 0.0:
        raise ValueError(f"slice: expected two places, got {start} twice")
    low, high = float(volume.box[0, 2]), min(float(volume.box[1, 2]), 0.0)
    cols, rows = round(length * scale), round((high - low) * scale)
    along = (np.arange(cols) + 0.5) / cols
    x, y = (a + along * (b - a) for a, b in zip(start, end, strict=True))
    z = high - (np.arange(rows) + 0.5) / scale
    points = np.column_stack([np.tile(x, rows), np.tile(y, rows), np.repeat(z, cols)])
    state = volume.state(points)
    colors = np.array([UNKNOWN, FREE, SOLID], np.uint8)[state]
    solid = state == states.SOLID
    target = solid.copy()
    target[solid] = volume.target(points[solid]) > 0.5
    colors[target] = TO_INSPECT
    colors[target & _inspected(volume, points)] = INSPECTED

    picture = Image.new("RGB", (cols + 2 * EDGE, rows + 2 * EDGE + 2 * LETTER), PAPER)
    picture.paste(Image.fromarray(colors.reshape(rows, cols, 3)), (EDGE, EDGE))
    pen = ImageDraw.Draw(picture)
    bottom = EDGE + rows
    for metre in range(0, math.floor(length) + 1, 5 if length > 12 else 1):
        column = EDGE + metre * scale
        pen.line((column, bottom, column, bottom + 4), fill=INK)
        _write(pen, (column, bottom + 6), f"{metre} m" if metre == 0 else f"{metre}", "ma")
    for depth in range(math.ceil(-high), math.floor(-low) + 1):
        row = EDGE + (high + depth) * scale
        pen.line((EDGE - 4, row, EDGE, row), fill=INK)
        _write(pen, (EDGE - 6, row), f"{depth}", "rm")
    _write(pen, (4, 4), "metres under water", "la")
    if vehicle is not None:
        way = np.subtract(end, start) / length
        beside = float(np.subtract(vehicle[:2], start) @ way)
        _draw_vehicle(pen, EDGE + beside * scale, EDGE + (high - vehicle[2]) * scale)
    _draw_legend(pen, EDGE, bottom + EDGE - 6, ((UNKNOWN, "unknown"), (FREE, "free"), *LEGEND))
    return picture


def draw_oblique(
    volume: Volume,
    *,
    bearing: float = math.radians(60.0),
    elevation: float = math.radians(35.0),
    path: npt.ArrayLike = (),
    size: tuple[int, int] = (960, 640),
) -> Image.Image:
    """What is mapped as solid, seen from the side and above without perspective.

    Args:
        volume: What is known; only read.
        bearing: Radians, of the horizontal way that one looks along, 0 towards east.
        elevation: Radians, that one looks down.
        path: (N, 3) of the vehicle, metres in the world, oldest first; it is drawn where nothing hides it
            and where something does, and the vehicle at its end.
        size: Width and height, pixels.

    Returns:
        An RGB image.

    Raises:
        ValueError: Nothing solid is known.
    """
    from PIL import Image, ImageDraw

    surface = volume.surface()
    if not len(surface.middles):
        raise ValueError("volume: expected one in which something solid is known, got none")
    way = np.asarray(path, np.float64).reshape(-1, 3)
    view = _View.of(np.concatenate([surface.middles, way]), bearing, elevation, size)
    pixels = _splatted(view, surface, volume.cell, size)
    picture = Image.new("RGB", (size[0], size[1] + 2 * LETTER), PAPER)
    picture.paste(Image.fromarray(pixels))
    pen = ImageDraw.Draw(picture)
    if len(way):
        at = view.on_picture(way)[:, :2]
        if len(at) > 1:
            pen.line([tuple(p) for p in at.tolist()], fill=TRAIL, width=2)
        _draw_vehicle(pen, *at[-1].tolist())
    bar = 5.0 * view.scale
    pen.line((12, 18, 12 + bar, 18), fill=INK, width=2)
    _write(pen, (16 + bar, 18), "5 m", "lm")
    _draw_legend(pen, 12, size[1] + LETTER, LEGEND)
    return picture


class _View:
    """Where points of the world lie on a picture without perspective."""

    def __init__(self, axes: Float64Array, origin: Float64Array, scale: float) -> None:
        self.axes, self.origin, self.scale = axes, origin, scale

    @staticmethod
    def of(points: Float64Array, bearing: float, elevation: float, size: tuple[int, int]) -> _View:
        """That shows all points."""
        ahead = np.array([math.cos(bearing), math.sin(bearing), 0.0])
        right = np.array([math.sin(bearing), -math.cos(bearing), 0.0])
        up = math.cos(elevation) * np.array([0.0, 0.0, 1.0]) + math.sin(elevation) * ahead
        deep = math.cos(elevation) * ahead - math.sin(elevation) * np.array([0.0, 0.0, 1.0])
        axes = np.stack([right, -up, deep])
        seen = points @ axes.T
        low, high = seen.min(axis=0)[:2], seen.max(axis=0)[:2]
        scale = min((np.array(size) - 2 * EDGE) / np.maximum(high - low, 1.0))
        middle = 0.5 * (low + high)
        origin = np.array([0.5 * size[0], 0.5 * size[1]]) - scale * middle
        return _View(axes, np.append(origin, 0.0), float(scale))

    def on_picture(self, points: Float64Array) -> Float64Array:
        """(N, 3) column, row, and depth into the picture in metres, of points (N, 3)."""
        return np.asarray(points @ self.axes.T * [self.scale, self.scale, 1.0] + self.origin)


def _splatted(view: _View, surface: Surface, cell: float, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """(H, W, 3) the voxels of a surface as squares, the farthest first."""
    target, inspected = surface.target > 0.5, surface.sides > 0
    base = np.where(target[:, None], np.where(inspected[:, None], INSPECTED, TO_INSPECT), SOLID)
    bright = 0.72 + 0.38 * np.clip(surface.normals @ LIGHT, -0.6, 1.0)
    colors = np.clip(base * bright[:, None], 0, 255).astype(np.uint8)
    at = view.on_picture(surface.middles)
    order = np.argsort(-at[:, 2], kind="stable")
    # A cube looks as wide as its diagonal at most.
    half = max(1, math.ceil(0.62 * cell * view.scale))
    shift = np.arange(-half, half + 1)
    cols = np.rint(at[order, 0]).astype(int)[:, None, None] + shift[None, None, :]
    rows = np.rint(at[order, 1]).astype(int)[:, None, None] + shift[None, :, None]
    cols, rows = np.broadcast_arrays(cols, rows)
    inside = (cols >= 0) & (cols < size[0]) & (rows >= 0) & (rows < size[1])
    pixels = np.full((size[1], size[0], 3), PAPER, np.uint8)
    whose = np.broadcast_to(order[:, None, None], cols.shape)
    # Of several at one pixel the last one stays, which is the nearest.
    pixels[rows[inside], cols[inside]] = colors[whose[inside]]
    return pixels


def _inspected(volume: Volume, points: Float64Array) -> npt.NDArray[np.bool_]:
    """(N,) whether points lie in voxels of surface that were inspected."""
    surface = volume.surface()
    done = surface.sides > 0
    names = np.floor(surface.middles[done] / volume.cell).astype(np.int64)
    wanted = np.floor(points / volume.cell).astype(np.int64)
    return np.asarray(np.isin(_number(wanted), _number(names)))


def _number(cells: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """(N,) one number for each cell (N, 3), as far as pictures go."""
    x, y, z = (cells + (1 << 20)).T
    return np.asarray((x << 42) | (y << 21) | z)


def _draw_vehicle(pen: ImageDraw.ImageDraw, column: float, row: float) -> None:
    pen.ellipse((column - 6, row - 6, column + 6, row + 6), fill=VEHICLE, outline=UNKNOWN, width=2)


def _draw_legend(
    pen: ImageDraw.ImageDraw, left: float, row: float, names: tuple[tuple[Color, str], ...]
) -> None:
    from PIL import ImageFont

    font = ImageFont.load_default(LETTER)
    for color, name in (*names, (VEHICLE, "vehicle")):
        pen.rectangle((left, row - 5, left + 10, row + 5), fill=color, outline=GRID_LINE)
        _write(pen, (left + 15, row), name, "lm")
        left += 32 + font.getlength(name)


def _write(pen: ImageDraw.ImageDraw, at: tuple[float, float], text: str, anchor: str) -> None:
    from PIL import ImageFont

    pen.text(at, text, fill=INK, font=ImageFont.load_default(LETTER), anchor=anchor)
