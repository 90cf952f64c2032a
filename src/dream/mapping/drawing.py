"""Map → picture: what a person, or a model that sees, is shown."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import SurveyProtocol

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

    from dream.mapping.occupancy import OccupancyMap

Color = tuple[int, int, int]
Point = tuple[float, float]
Drawer = Callable[["ImageDraw.ImageDraw", Callable[[Point], Point]], None]
"""Draws on a mask, whose pixel of a point on the map the second argument gives."""

UNKNOWN: Color = (255, 255, 255)
EXPLORED: Color = (127, 127, 127)
TARGET: Color = (0, 200, 0)
TRAVERSED: Color = (0, 165, 110)
"""A target that was traversed, where the protocol asks for that: a bluish green, nearest to a target's."""
SOLID: Color = (0, 0, 0)
SOLID_TARGET: Color = (0, 95, 0)
"""A wreck's wall: target, and yet not to be run into."""
INSPECTED: Color = (150, 90, 230)
"""A target whose surface is inspected, under a protocol that moves in space."""
SOLID_INSPECTED: Color = (80, 30, 140)
"""One of those that is solid, too."""
FREE: Color = (190, 215, 240)
"""Water that is known to be free, where it is drawn."""
VEHICLE: Color = (0, 70, 255)
TRAIL: Color = (0, 150, 255)
MARK: Color = (255, 201, 14)
OUTLINE: Color = (200, 0, 160)
"""Around an area that has to be seen."""
WAY_HOME: Color = (214, 60, 16)
"""Along the way home."""
DOTS = 0.8
"""Metres from one dot of it to the next."""
GRID_LINE: Color = (90, 90, 120)
INK: Color = (40, 40, 40)
PAPER: Color = (244, 244, 240)

SCALE = 4
"""Pixels per cell, unless others are asked for."""
GRID = 5.0
"""Metres between the lines of the grid, where the area is large enough for some."""
DISC = 9
"""Radius of a mark's disc, pixels."""
TAIL = 0.75
"""How far the arrow of the vehicle reaches back, as a share of how far it reaches ahead."""
DIGIT = 14
"""Height of its number, pixels."""
FINER = 3
"""Lines are drawn so many times larger and scaled down, which makes them smooth."""


@dataclass(frozen=True, slots=True)
class Palette:
    """The colours of a map, and their names in its legend."""

    unknown: Color
    explored: Color
    target: Color
    traversed: Color
    solid: Color
    solid_target: Color
    crossed: Color
    """Known to be free, with its floor not seen: the launch was there, or a level ray passed through."""
    clear_view: bool
    """Whether targets and solids keep their colours in the vehicle's field of view."""
    inspected: tuple[Color, Color] | None = None
    """A target that is inspected, and one that is solid, too; None where they are not told apart."""

    def legend(self, protocol: SurveyProtocol) -> tuple[tuple[Color, str], ...]:
        """What the colours mean under a protocol."""
        if self.inspected is not None:
            return (
                (self.unknown, "unknown"),
                (self.explored, "explored"),
                (self.target, "target"),
                (self.solid_target, "target, solid"),
                (self.inspected[0], "inspected"),
                (self.inspected[1], "inspected, solid"),
                (self.solid, "solid"),
                (VEHICLE, "vehicle"),
            )
        names = [(self.unknown, "unknown")]
        if self.crossed != self.unknown:
            names.append((self.crossed, "free"))
        names += [(self.explored, "explored"), (self.target, "target")]
        if protocol.traversal is not None:
            names.append((self.traversed, "traversed"))
        return (*names, (self.solid, "solid"), (self.solid_target, "both"), (VEHICLE, "vehicle"))


FOR_MODELS = Palette(
    UNKNOWN, EXPLORED, TARGET, TRAVERSED, SOLID, SOLID_TARGET, crossed=UNKNOWN, clear_view=False
)
"""The picture that models are asked about. It stays as it is: answers are recorded with its bytes."""
FOR_MODELS_IN_SPACE = replace(FOR_MODELS, inspected=(INSPECTED, SOLID_INSPECTED))
"""The same for a map with a volume, which says what is inspected."""
FOR_PEOPLE = Palette(
    unknown=UNKNOWN,
    explored=(198, 200, 203),
    target=(0, 130, 75),
    traversed=(0, 88, 150),
    solid=(20, 20, 24),
    solid_target=(222, 128, 0),
    crossed=(230, 237, 246),
    clear_view=True,
)
"""The pictures of a run. Each two that lie side by side differ in lightness too, not in hue alone."""


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """A numbered place on the map, and the way there."""

    number: int
    path: npt.NDArray[np.float64]
    """(N, 2) metres in the world; the mark is drawn at the last."""
    note: str = ""
    """Written beside its disc."""


def draw_map(
    occupancy: OccupancyMap,
    pose: SE2 | None = None,
    trail: npt.ArrayLike = (),
    marks: Sequence[Mark] = (),
    *,
    home: npt.ArrayLike | None = None,
    scale: int = SCALE,
    palette: Palette = FOR_MODELS,
) -> Image.Image:
    """A picture of the map, north up, with a grid in metres, a scale bar and a legend.

    Cells keep the exact colours of the palette, save under the thin lines; the vehicle, its field of view out
    to the reach, and where it came from are blue; marks are yellow, with a thin line along the way there. A
    thin line in magenta is around the area that has to be seen, where that is not everything; only then it is
    in the legend, too.

    Args:
        occupancy: What is known; only read.
        pose: The vehicle; nothing is drawn for it without one.
        trail: (N, 2) positions in the world, oldest first; or (N, 3) with headings, which are not used.
        marks: Drawn over everything else, the first uppermost.
        home: (N, 2) positions in the world of the way home, from the vehicle on: a row of red dots.
        scale: Pixels per cell.
        palette: `FOR_MODELS` or `FOR_PEOPLE`.

    Returns:
        An RGB image. Its size depends on the map's shape and the scale alone.
    """
    legend = palette.legend(occupancy.protocol)
    if home is not None:
        legend = (*legend, (WAY_HOME, "way home"))
    return draw_cells(
        occupancy,
        _paint(occupancy, palette),
        legend,
        pose,
        trail,
        marks,
        home=home,
        scale=scale,
        palette=palette,
    )


def draw_cells(
    occupancy: OccupancyMap,
    colors: npt.NDArray[np.uint8],
    legend: tuple[tuple[Color, str], ...],
    pose: SE2 | None = None,
    trail: npt.ArrayLike = (),
    marks: Sequence[Mark] = (),
    *,
    home: npt.ArrayLike | None = None,
    scale: int = SCALE,
    palette: Palette = FOR_MODELS,
) -> Image.Image:
    """The same picture with colours of one's own in its cells.

    Args:
        occupancy: Whose area is drawn.
        colors: (rows, cols, 3) uint8, rows from the south.
        legend: What the colours mean.
        pose: See `draw_map`, as of the others.
        trail: Likewise.
        marks: Likewise.
        home: Likewise.
        scale: Likewise.
        palette: Says how the vehicle's field of view is drawn.
    """
    from PIL import Image

    if scale < 1:
        raise ValueError(f"scale: expected at least 1 pixel per cell, got {scale}")
    points = np.asarray(trail, np.float64)
    points = points.reshape(0, 2) if points.size == 0 else points
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"trail: expected (N, 2) metres, got {points.shape}")
    sheet = _Sheet(occupancy.bounds, occupancy.protocol, scale)
    area = occupancy.area
    if area is not None:
        legend = (*legend, (OUTLINE, "area"))
    picture = _blank(sheet, legend).copy()
    cells = Image.fromarray(colors[::-1].repeat(scale, 0).repeat(scale, 1))
    picture.paste(cells, (sheet.left, sheet.top))
    if pose is not None and palette.clear_view:
        _draw_view(picture, sheet, pose)
        found = (occupancy.target | occupancy.solid)[::-1].repeat(scale, 0).repeat(scale, 1)
        picture.paste(cells, (sheet.left, sheet.top), Image.fromarray(found))
    _draw_grid(picture, sheet)
    if area is not None:
        _draw_outline(picture, sheet, area)
    _draw_trail(picture, sheet, points[:, :2])
    if home is not None:
        _draw_dots(picture, sheet, np.asarray(home, np.float64).reshape(-1, 2))
    for mark in reversed(marks):
        _draw_way(picture, sheet, mark)
    if pose is not None:
        if not palette.clear_view:
            _draw_view(picture, sheet, pose)
        _draw_vehicle(picture, sheet, pose)
    for mark, at in list(zip(marks, _apart(sheet, marks, pose), strict=True))[::-1]:
        if mark.note:
            _draw_note(picture, sheet, at, mark.note)
        draw_disc(picture, at, mark.number)
    return picture


def draw_areas(
    bounds: Bounds,
    protocol: SurveyProtocol,
    areas: Sequence[Bounds | None],
    lines: Sequence[str],
    *,
    scale: int = 4,
) -> Image.Image:
    """A picture of areas before anything is known of the ground: outlines with numbers, and what they mean.

    Args:
        bounds: The survey area.
        protocol: Its cells give the scale.
        areas: By number, from 1; one whose place is not known yet is None, and not drawn.
        lines: Sentences that stand below; too long ones go on in the next line.
        scale: Pixels per cell.

    Returns:
        An RGB image.
    """
    from PIL import Image, ImageDraw, ImageFont

    sheet = _Sheet(bounds, protocol, scale)
    upper = _blank(sheet, ((OUTLINE, "has to be seen"),))
    letter, font = sheet.letter, ImageFont.load_default(sheet.letter)
    width = upper.width - 2 * sheet.left
    rows = [row for line in lines for row in _wrapped(line, lambda text: font.getlength(text) <= width)]
    picture = Image.new("RGB", (upper.width, upper.height + round((1.5 * len(rows) + 0.5) * letter)), PAPER)
    picture.paste(upper)
    picture.paste(UNKNOWN, (sheet.left, sheet.top, sheet.left + sheet.width, sheet.bottom))
    _draw_grid(picture, sheet)
    numbers: dict[Bounds, list[str]] = {}
    for number, area in enumerate(areas, start=1):
        if area is not None:
            numbers.setdefault(area, []).append(str(number))
    pen = ImageDraw.Draw(picture)
    for area, names in numbers.items():
        _draw_outline(picture, sheet, area)
        column, row = sheet.at(area.x_min, area.y_max)
        corner = (sheet.left + column + 0.6 * letter, sheet.top + row + 0.5 * letter)
        large = ImageFont.load_default(1.6 * letter)
        pen.text(corner, ", ".join(names), fill=OUTLINE, font=large, stroke_width=2, stroke_fill=UNKNOWN)
    for number, text in enumerate(rows):
        pen.text((sheet.left, upper.height + 1.5 * number * letter), text, fill=INK, font=font)
    return picture


def _wrapped(text: str, fits: Callable[[str], bool]) -> list[str]:
    """Lines of whole words; those after the first stand in a little."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if lines[-1] and not fits(longer):
            lines.append(f"    {word}")
        else:
            lines[-1] = longer
    return lines


def draw_disc(picture: Image.Image, center: tuple[float, float], number: int) -> None:
    """A numbered disc on any picture.

    Args:
        picture: Changed.
        center: Column and row, pixels.
        number: Of one or two digits.
    """
    from PIL import Image, ImageDraw, ImageFont

    half = DISC + 2
    column, row = math.floor(center[0]), math.floor(center[1])
    mask = Image.new("L", (2 * half * FINER, 2 * half * FINER), 0)
    middle = half * FINER
    for radius, color in ((DISC + 1, INK), (DISC, MARK)):
        mask.paste(0, (0, 0, *mask.size))
        r = radius * FINER
        ImageDraw.Draw(mask).ellipse((middle - r, middle - r, middle + r, middle + r), fill=255)
        picture.paste(color, (column - half, row - half), mask.reduce(FINER))
    pen = ImageDraw.Draw(picture)
    pen.fontmode = "1"
    pen.text((column, row), str(number), fill=INK, font=ImageFont.load_default(DIGIT), anchor="mm")


@dataclass(frozen=True, slots=True)
class Inset:
    """Where the map lies on its picture, for a page that writes axes and legend itself. Pixels, metres."""

    left: int
    top: int
    width: int
    height: int
    picture: tuple[int, int]
    """Width and height of all."""
    across: tuple[tuple[float, float], ...]
    """The lines of the grid from west to east: metres, and the share of the width that is left of it."""
    down: tuple[tuple[float, float], ...]
    """Those from north to south: metres, and the share of the height that is above it."""


def inset(bounds: Bounds, protocol: SurveyProtocol, *, scale: int = SCALE) -> Inset:
    """Where `draw_map` draws the map itself."""
    sheet = _Sheet(bounds, protocol, scale)
    return Inset(
        sheet.left,
        sheet.top,
        sheet.width,
        sheet.height,
        sheet.size,
        tuple((x, sheet.at(x, 0.0)[0] / sheet.width) for x in sheet.ticks(bounds.x_min, bounds.x_max)),
        tuple((y, sheet.at(0.0, y)[1] / sheet.height) for y in sheet.ticks(bounds.y_min, bounds.y_max)[::-1]),
    )


def grid_spacing(bounds: Bounds) -> float:
    """Metres between the lines."""
    side = min(bounds.width, bounds.depth)
    return GRID if side >= 2.0 * GRID else 0.5 if side < 5.0 else 1.0


@dataclass(frozen=True, slots=True)
class _Sheet:
    """Where things are on the picture, in pixels."""

    bounds: Bounds
    protocol: SurveyProtocol
    scale: int

    @property
    def per_metre(self) -> float:
        return self.scale / self.protocol.cell

    @property
    def width(self) -> int:
        return round(self.bounds.width * self.per_metre)

    @property
    def height(self) -> int:
        return round(self.bounds.depth * self.per_metre)

    @property
    def letter(self) -> int:
        """Height of the writing; margins are multiples of it."""
        return max(11, round(min(self.width, self.height) / 55))

    @property
    def left(self) -> int:
        return 3 * self.letter

    @property
    def top(self) -> int:
        return self.letter

    @property
    def bottom(self) -> int:
        return self.top + self.height

    @property
    def size(self) -> tuple[int, int]:
        legend = 46 * self.letter
        return max(self.left + self.width, legend) + self.letter, self.bottom + 5 * self.letter

    @property
    def grid(self) -> float:
        return grid_spacing(self.bounds)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Pixels from the upper left corner of the map."""
        return (x - self.bounds.x_min) * self.per_metre, (self.bounds.y_max - y) * self.per_metre

    def ticks(self, low: float, high: float) -> list[float]:
        """Multiples of the grid's spacing in an interval."""
        first, last = math.ceil(low / self.grid - 1e-9), math.floor(high / self.grid + 1e-9)
        return [k * self.grid for k in range(first, last + 1)]


def _paint(occupancy: OccupancyMap, palette: Palette) -> npt.NDArray[np.uint8]:
    colors = np.full((*occupancy.shape, 3), palette.unknown, np.uint8)
    colors[occupancy.crossed] = palette.crossed
    colors[occupancy.seen] = palette.explored
    colors[occupancy.target] = palette.target
    colors[occupancy.target & occupancy.traversed] = palette.traversed
    colors[occupancy.solid] = palette.solid
    colors[occupancy.solid & occupancy.target] = palette.solid_target
    if palette.inspected is not None:
        done = _inspected(occupancy)
        colors[done & occupancy.target] = palette.inspected[0]
        colors[done & occupancy.target & occupancy.solid] = palette.inspected[1]
    return colors


def _inspected(occupancy: OccupancyMap) -> npt.NDArray[np.bool_]:
    """(rows, cols) where at least half of the target surface of a column is inspected."""
    assert occupancy.volume is not None
    surface, shape = occupancy.volume.surface(), occupancy.shape
    corner = occupancy.bounds.x_min, occupancy.bounds.y_min
    at = np.floor((surface.middles[:, :2] - corner) / occupancy.protocol.cell).astype(np.int64)
    kept = (surface.target > 0.5) & ((at >= 0) & (at < shape[::-1])).all(axis=1)
    cell, area, sides = at[kept, 1] * shape[1] + at[kept, 0], surface.area[kept], surface.sides[kept]
    whole, done = (np.bincount(cell, area * weight, shape[0] * shape[1]) for weight in (1.0, sides != 0))
    return np.asarray(((whole > 0.0) & (done >= 0.5 * whole)).reshape(shape))


def _draw_grid(picture: Image.Image, sheet: _Sheet) -> None:
    from PIL import Image

    mask = np.zeros((sheet.height, sheet.width), np.uint8)
    across = [round(sheet.at(x, 0.0)[0]) for x in sheet.ticks(sheet.bounds.x_min, sheet.bounds.x_max)]
    down = [round(sheet.at(0.0, y)[1]) for y in sheet.ticks(sheet.bounds.y_min, sheet.bounds.y_max)]
    mask[:, [x for x in across if 0 < x < sheet.width]] = 70
    mask[[y for y in down if 0 < y < sheet.height]] = 70
    picture.paste(GRID_LINE, (sheet.left, sheet.top), Image.fromarray(mask))


def _draw_outline(picture: Image.Image, sheet: _Sheet, area: Bounds) -> None:
    corners = [(area.x_min, area.y_min), (area.x_max, area.y_min), (area.x_max, area.y_max)]
    way = [sheet.at(x, y) for x, y in (*corners, (area.x_min, area.y_max))]

    def draw(pen: ImageDraw.ImageDraw, at: Callable[[Point], Point]) -> None:
        pen.line([at(corner) for corner in (*way, *way[:2])], fill=255, width=3 * FINER, joint="curve")

    _paste(picture, sheet, way, OUTLINE, draw)


def _draw_trail(picture: Image.Image, sheet: _Sheet, points: npt.NDArray[np.float64]) -> None:
    way = [sheet.at(x, y) for x, y in points]

    def draw(pen: ImageDraw.ImageDraw, at: Callable[[Point], Point]) -> None:
        places = [at(point) for point in way]
        if len(places) > 1:
            pen.line(places, fill=255, width=2 * FINER, joint="curve")
        dot = 1.7 * FINER
        for x, y in places:
            pen.ellipse((x - dot, y - dot, x + dot, y + dot), fill=255)

    if way:
        _paste(picture, sheet, way, TRAIL, draw)


def _draw_dots(picture: Image.Image, sheet: _Sheet, points: npt.NDArray[np.float64]) -> None:
    """At even distances along a way."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    every = np.arange(DOTS, along[-1] + 0.5 * DOTS, DOTS)
    x, y = (np.interp(every, along, axis) for axis in points.T)
    dots = [sheet.at(*place) for place in zip(x.tolist(), y.tolist(), strict=True)]

    def draw(pen: ImageDraw.ImageDraw, at: Callable[[Point], Point]) -> None:
        dot = 1.9 * FINER
        for x, y in map(at, dots):
            pen.ellipse((x - dot, y - dot, x + dot, y + dot), fill=255)

    if dots:
        _paste(picture, sheet, dots, WAY_HOME, draw)


def _draw_way(picture: Image.Image, sheet: _Sheet, mark: Mark) -> None:
    way = [sheet.at(x, y) for x, y in mark.path]

    def draw(pen: ImageDraw.ImageDraw, at: Callable[[Point], Point]) -> None:
        pen.line([at(point) for point in way], fill=255, width=2 * FINER, joint="curve")

    if len(way) > 1:
        _paste(picture, sheet, way, MARK, draw)


def _draw_note(picture: Image.Image, sheet: _Sheet, disc: Point, note: str) -> None:
    """Beside a disc: to the right of it, or to the left where the map ends."""
    from PIL import ImageDraw, ImageFont

    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(DIGIT)
    pen.fontmode = "1"
    column, row = math.floor(disc[0]), math.floor(disc[1])
    width = math.ceil(pen.textlength(note, font=font))
    fits = column + DISC + width + 6 <= sheet.left + sheet.width
    left = column + DISC if fits else column - DISC - width - 6
    pen.rectangle((left, row - DISC + 1, left + width + 6, row + DISC - 1), fill=PAPER, outline=INK)
    pen.text((left + 4, row), note, fill=INK, font=font, anchor="lm")


def _apart(sheet: _Sheet, marks: Sequence[Mark], pose: SE2 | None) -> list[Point]:
    """Where the discs of marks stand; of those with a note, one that would hide another is below it.

    Such are places above each other, which their notes tell apart.
    """
    placed: list[Point] = []
    for mark in marks:
        column, row = _on_picture(sheet, mark, pose)
        while mark.note and any(math.dist((column, row), other) < 2 * DISC for other in placed):
            row += 2 * DISC + 4
        placed.append((column, row))
    return placed


def _on_picture(sheet: _Sheet, mark: Mark, pose: SE2 | None) -> Point:
    """Where its disc stands, pixels of the picture: on the map, and behind a vehicle that it would hide."""
    column, row = sheet.at(*mark.path[-1])
    edge = DISC + 1
    if pose is not None and math.dist(sheet.at(pose.x, pose.y), (column, row)) < DISC:
        away = TAIL * _half_arrow(sheet) + edge / sheet.per_metre
        column, row = sheet.at(pose.x - away * math.cos(pose.yaw), pose.y - away * math.sin(pose.yaw))
    return (
        sheet.left + min(max(column, edge), sheet.width - edge),
        sheet.top + min(max(row, edge), sheet.height - edge),
    )


def _half_arrow(sheet: _Sheet) -> float:
    """Metres from the vehicle to the tip of its arrow."""
    return 0.125 * sheet.protocol.reach


def _view(sheet: _Sheet, pose: SE2) -> list[Point]:
    """Corners of the field of view out to the reach."""
    reach, half = sheet.protocol.reach, 0.5 * sheet.protocol.camera.horizontal_fov
    arc = [pose.yaw + half * along for along in np.linspace(-1.0, 1.0, 33)]
    tips = [sheet.at(pose.x + reach * math.cos(a), pose.y + reach * math.sin(a)) for a in arc]
    return [sheet.at(pose.x, pose.y), *tips]


def _filled(corners: Sequence[Point], opacity: int) -> Drawer:
    return lambda pen, at: pen.polygon([at(corner) for corner in corners], fill=opacity)


def _draw_view(picture: Image.Image, sheet: _Sheet, pose: SE2) -> None:
    cone = _view(sheet, pose)
    _paste(picture, sheet, cone, VEHICLE, _filled(cone, 34))


def _draw_vehicle(picture: Image.Image, sheet: _Sheet, pose: SE2) -> None:
    cone = _view(sheet, pose)
    shape = ((1.0, 0.0), (-TAIL, 0.7), (-0.4, 0.0), (-TAIL, -0.7))
    c, s = _half_arrow(sheet) * math.cos(pose.yaw), _half_arrow(sheet) * math.sin(pose.yaw)
    arrow = [sheet.at(pose.x + c * a - s * b, pose.y + s * a + c * b) for a, b in shape]

    def outlined(corners: Sequence[Point], width: int) -> Drawer:
        return lambda pen, at: pen.line(
            [at(corner) for corner in (*corners, *corners[:2])], fill=255, width=width * FINER, joint="curve"
        )

    _paste(picture, sheet, cone, VEHICLE, outlined(cone, 2))
    _paste(picture, sheet, arrow, UNKNOWN, outlined(arrow, 3))
    _paste(picture, sheet, arrow, VEHICLE, _filled(arrow, 255))


def _paste(picture: Image.Image, sheet: _Sheet, points: Sequence[Point], color: Color, draw: Drawer) -> None:
    """Smooth drawing in one colour inside the map, around some points only."""
    from PIL import Image, ImageDraw

    margin = 6
    left, top = (max(math.floor(min(axis)) - margin, 0) for axis in zip(*points, strict=True))
    right, bottom = (math.ceil(max(axis)) + margin for axis in zip(*points, strict=True))
    width, height = min(right, sheet.width) - left, min(bottom, sheet.height) - top
    if width <= 0 or height <= 0:
        return
    mask = Image.new("L", (width * FINER, height * FINER), 0)
    draw(ImageDraw.Draw(mask), lambda point: ((point[0] - left) * FINER, (point[1] - top) * FINER))
    picture.paste(color, (sheet.left + left, sheet.top + top), mask.reduce(FINER))


@lru_cache(maxsize=4)
def _blank(sheet: _Sheet, legend: tuple[tuple[Color, str], ...]) -> Image.Image:
    """The paper, with all that does not change during a survey."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("RGB", sheet.size, PAPER)
    draw = ImageDraw.Draw(picture)
    letter, left, bottom = sheet.letter, sheet.left, sheet.bottom
    font = ImageFont.load_default(letter)

    def write(position: tuple[float, float], text: str, anchor: str) -> None:
        draw.text(position, text, fill=INK, font=font, anchor=anchor)

    draw.rectangle((left - 2, sheet.top - 2, left + sheet.width + 1, bottom + 1), outline=INK, width=2)
    for x in sheet.ticks(sheet.bounds.x_min, sheet.bounds.x_max):
        write((left + sheet.at(x, 0.0)[0], bottom + 0.35 * letter), f"{x:g}", "mt")
    for y in sheet.ticks(sheet.bounds.y_min, sheet.bounds.y_max):
        write((left - 0.5 * letter, sheet.top + sheet.at(0.0, y)[1]), f"{y:g}", "rm")

    row = bottom + 3.2 * letter
    bar = left + sheet.grid * sheet.per_metre
    draw.line([(left, row), (bar, row)], fill=INK, width=2)
    for end in (left, bar):
        draw.line([(end, row - 0.35 * letter), (end, row + 0.35 * letter)], fill=INK, width=2)
    write((bar + 0.5 * letter, row), f"{sheet.grid:g} m", "lm")

    north = bar + 5.2 * letter
    tip = [(north, row - 1.1 * letter), (north - 0.5 * letter, row + 0.8 * letter)]
    tip += [(north, row + 0.35 * letter), (north + 0.5 * letter, row + 0.8 * letter)]
    draw.polygon(tip, fill=INK)
    write((north + 0.8 * letter, row), "N", "lm")

    first = place = north + 3.2 * letter
    for color, name in legend:
        width = 1.3 * letter + draw.textlength(name, font=font)
        if place > first and place + width > picture.width - 0.5 * letter:  # Beside a long scale bar.
            place, row = first, row + 1.25 * letter
        box: Any = (place, row - 0.45 * letter, place + 0.9 * letter, row + 0.45 * letter)
        draw.rectangle(box, fill=color, outline=INK)
        write((place + 1.3 * letter, row), name, "lm")
        place += width + 1.1 * letter
    return picture
