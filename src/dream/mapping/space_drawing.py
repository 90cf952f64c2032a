"""Volume → picture: upright and level slices, and a view from the side and above."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.mapping import drawing
from dream.mapping.drawing import GRID_LINE, INK, PAPER, TRAIL, VEHICLE, Color

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

    from dream.mapping.occupancy import OccupancyMap
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


class Colors(NamedTuple):
    """Of a slice."""

    unknown: Color
    free: Color
    solid: Color
    to_inspect: Color
    inspected: Color

    @property
    def legend(self) -> tuple[tuple[Color, str], ...]:
        """What they mean."""
        return (
            (self.unknown, "unknown"),
            (self.free, "free"),
            (self.solid, "solid"),
            (self.to_inspect, "target"),
            (self.inspected, "inspected"),
        )


FOR_PEOPLE = Colors(UNKNOWN, FREE, SOLID, TO_INSPECT, INSPECTED)
FOR_MODELS = Colors(drawing.UNKNOWN, drawing.FREE, drawing.SOLID, drawing.TARGET, drawing.INSPECTED)
"""Those of the map that a model is shown."""


@dataclass(frozen=True, slots=True)
class Beholder:
    """The vehicle in an upright slice: a body and what its camera sees. Metres and radians."""

    position: Place
    radius: float
    height: float
    tilt: float
    """Pitch of the camera, downwards."""
    half_view: float
    """Angle from the middle of the picture to its upper edge."""
    reach: float


IN_LEVEL = Colors(drawing.UNKNOWN, drawing.FREE, drawing.SOLID, drawing.SOLID_TARGET, drawing.SOLID_INSPECTED)
"""Of a level slice: what is solid is drawn as on the map."""
LEVEL_LEGEND = (*IN_LEVEL.legend, (VEHICLE, "vehicle"))
LETTER = 13
"""Height of letters, pixels."""
EDGE = 34
"""Pixels around a picture, for figures and legend."""
LEAST_WIDTH = 420
"""Pixels across a slice at least, so that its legend has room."""
FAINT = 70
"""Opacity of the lines of a slice, of 255."""
LIGHT = np.array([-0.35, -0.5, 0.8]) / np.linalg.norm([-0.35, -0.5, 0.8])
"""Where light comes from; what looks away from it is darker."""


def draw_slice(
    volume: Volume,
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    vehicle: Beholder | None = None,
    scale: int = 24,
    colors: Colors = FOR_PEOPLE,
) -> Image.Image:
    """What is known in the vertical plane between two places, seen from the right of the way between them.

    Args:
        volume: What is known; only read.
        start: World x and y of the left edge.
        end: Of the right edge.
        vehicle: Drawn where it is beside the plane, too, as if it looked along it; figures count from it.
        scale: Pixels a metre.
        colors: `FOR_PEOPLE` or `FOR_MODELS`.

    Returns:
        An RGB image: metres along the plane below, depth under water on the left, lines a metre apart.

    Raises:
        ValueError: Start and end are one place, or nothing is known.
    """
    from PIL import Image, ImageDraw

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
    pixels = _colored(volume, points, volume.state(points), colors)
    picture = Image.new("RGB", (max(cols, LEAST_WIDTH) + 2 * EDGE, rows + 2 * EDGE + 2 * LETTER), PAPER)
    picture.paste(Image.fromarray(pixels.reshape(rows, cols, 3)), (EDGE, EDGE))
    pen = ImageDraw.Draw(picture)
    bottom, ahead = EDGE + rows, 0.0
    pen.rectangle((EDGE - 1, EDGE - 1, EDGE + cols, bottom), outline=INK)
    if vehicle is not None:
        way = np.subtract(end, start) / length
        ahead = float(np.subtract(vehicle.position[:2], start) @ way)
    faint = Image.new("L", (cols, rows), 0)
    lines = ImageDraw.Draw(faint)
    for metre in range(math.ceil(-ahead - 1e-9), math.floor(length - ahead + 1e-9) + 1):
        column = round((metre + ahead) * scale)
        lines.line((column, 0, column, rows), fill=FAINT)
        pen.line((EDGE + column, bottom, EDGE + column, bottom + 4), fill=INK)
        _write(pen, (EDGE + column, bottom + 6), f"{metre}", "ma")
    for depth in range(math.ceil(-high), math.floor(-low) + 1):
        row = round((high + depth) * scale)
        lines.line((0, row, cols, row), fill=FAINT)
        pen.line((EDGE - 4, EDGE + row, EDGE - 1, EDGE + row), fill=INK)
        _write(pen, (EDGE - 6, EDGE + row), f"{depth}", "rm")
    picture.paste(GRID_LINE, (EDGE, EDGE), faint)
    _write(pen, (4, 4), "metres under water", "la")
    if vehicle is not None:
        _write(pen, (EDGE + cols, bottom + 6 + LETTER + 3), "metres ahead of the vehicle", "ra")
        _draw_beholder(
            picture, vehicle, (EDGE + ahead * scale, EDGE + (high - vehicle.position[2]) * scale), scale
        )
    _draw_legend(pen, EDGE, bottom + EDGE + LETTER, colors.legend)
    return picture


def draw_level(
    occupancy: OccupancyMap,
    pose: SE2,
    z: float,
    trail: npt.ArrayLike = (),
    *,
    scale: int = drawing.SCALE,
) -> Image.Image:
    """What is known of the water at the height of the vehicle's body, on the same sheet as the map.

    A cell has the worst that the body would touch in it: target or solid, else unknown, else free.

    Args:
        occupancy: With a volume; only read.
        pose: Of the vehicle.
        z: Its height in the world.
        trail: See `draw_map`.
        scale: Pixels per cell.

    Returns:
        An RGB image in the colours of `FOR_MODELS_IN_SPACE`, water that is free in those of `FREE`.
    """
    from dream.mapping import volume as states

    assert occupancy.volume is not None
    volume, cell = occupancy.volume, occupancy.protocol.cell
    half = 0.5 * occupancy.protocol.body_height + states.MARGIN
    # A voxel that it touches counts, as the guard has it.
    first, last = math.floor((z - half) / volume.cell - 1e-9), math.floor((z + half) / volume.cell + 1e-9)
    rows, cols = np.indices(occupancy.shape)
    east, north = (
        low + (along.ravel() + 0.5) * cell
        for low, along in ((occupancy.bounds.x_min, cols), (occupancy.bounds.y_min, rows))
    )
    pixels = np.full((east.size, 3), drawing.FREE, np.uint8)
    worst = np.full(east.size, states.FREE, np.uint8)
    for level in range(first, last + 1):
        points = np.column_stack([east, north, np.full(east.size, (level + 0.5) * volume.cell)])
        state = volume.state(points)
        worse = (worst != states.SOLID) & (
            (state == states.SOLID) | (worst == states.FREE) & (state != states.FREE)
        )
        worst[worse] = state[worse]
        pixels[worse] = _colored(volume, points[worse], state[worse], IN_LEVEL)
    return drawing.draw_cells(
        occupancy, pixels.reshape(*occupancy.shape, 3), LEVEL_LEGEND, pose, trail, scale=scale
    )


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


def _colored(
    volume: Volume, points: Float64Array, state: npt.NDArray[np.uint8], colors: Colors
) -> npt.NDArray[np.uint8]:
    """(N, 3) the colours of points (N, 3) that are in such states."""
    from dream.mapping import volume as states

    pixels = np.array([colors.unknown, colors.free, colors.solid], np.uint8)[state]
    solid = state == states.SOLID
    target = solid.copy()
    target[solid] = volume.target(points[solid]) > 0.5
    pixels[target] = colors.to_inspect
    pixels[target & _inspected(volume, points)] = colors.inspected
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


def _draw_beholder(picture: Image.Image, vehicle: Beholder, at: tuple[float, float], scale: int) -> None:
    """Its body, and the edges of what its camera sees, out to the reach."""
    from PIL import Image, ImageDraw

    mask = Image.new("L", picture.size, 0)
    pen = ImageDraw.Draw(mask)
    column, row = at
    reach = vehicle.reach * scale
    for angle in (vehicle.tilt - vehicle.half_view, vehicle.tilt + vehicle.half_view):
        end = column + reach * math.cos(angle), row + reach * math.sin(angle)
        pen.line((column, row, *end), fill=255)
    # Within the slice: margins are for figures.
    inside = Image.new("L", picture.size, 0)
    inside.paste(
        mask.crop((EDGE, EDGE, picture.width - EDGE, picture.height - EDGE - 2 * LETTER)), (EDGE, EDGE)
    )
    picture.paste(VEHICLE, (0, 0), inside)
    wide, high = vehicle.radius * scale, 0.5 * vehicle.height * scale
    ImageDraw.Draw(picture).rectangle(
        (column - wide, row - high, column + wide, row + high), fill=VEHICLE, outline=UNKNOWN, width=2
    )


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
