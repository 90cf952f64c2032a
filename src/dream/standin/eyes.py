"""What the picture of the map shows: its frame and scale, its cells, the vehicle, the numbered marks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dream.standin import sight
from dream.standin.lettering import darkness, first_number, likeness, written
from dream.standin.marks import OUTER, RADIUS, Disc, read_marks
from dream.standin.sight import Bool, Floats, UInt8, UnreadableError

SPACINGS = (5.0, 1.0, 0.5)
"""Metres that the lines of a grid may be apart, which the scale bar says."""
MOST_CELL = 16
"""Pixels along a cell, at most."""
ARROW = ((1.0, 0.0), (-0.75, 0.7), (-0.4, 0.0), (-0.75, -0.7))
"""Corners of the vehicle: ahead and to the left, in lengths of its front part."""
ARROW_AREA = 0.98
"""Of that shape, in squares of the same length."""
EDGE = 3
"""Pixels of white around the arrow."""
SMOOTH = 0.5
"""Pixels at the edge of a shape that are not of its full colour."""
COARSE = 5
"""Every so many pixels are enough to find where a search begins."""
LEAST_ARROW = 0.75
"""Overlap of the arrow, and of the sector in view, with what is seen of them."""
LEAST_COVERED = 0.5
"""The same where ways or discs are drawn over the arrow."""


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """A map as it was read. Rows count from the north, columns from the west."""

    cells: UInt8
    """(rows, cols): what each cell is, one of `sight.UNKNOWN` and those after it."""
    cell: float
    """Metres along a cell."""
    west: float
    """Metres, world x of the left edge."""
    north: float
    """Metres, world y of the upper edge."""
    per_metre: float
    """Pixels."""
    x: float
    """Of the vehicle, metres."""
    y: float
    yaw: float
    """Radians from east to the left."""
    reach: float
    """Metres out to which the camera is trusted: the arrow is as long as an eighth of it."""
    trail: Bool
    """(rows, cols): where the vehicle came from."""
    marks: tuple[tuple[int, float, float], ...]
    """Number and world x and y of each place, by number."""
    discs: tuple[Disc, ...]
    """The same on the picture of the cells, whose upper left corner is its origin."""
    ground: UInt8
    """(H, W, 3) that picture."""

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Row and column of a point, as fractions."""
        return (self.north - y) / self.cell, (x - self.west) / self.cell


PLANAR = (sight.EXPLORED, sight.TARGET, sight.SOLID, sight.SOLID_TARGET)
"""What may be seen of cells on a map in the plane, in that order in its legend."""
INSPECTING = (*PLANAR, sight.INSPECTED, sight.SOLID_INSPECTED)
"""Likewise on one that says what is inspected."""
LEVEL = (sight.FREE, sight.SOLID, sight.SOLID_TARGET, sight.SOLID_INSPECTED)
"""Likewise on a level cut."""


def read_map(picture: UInt8, kinds: tuple[int, ...] = PLANAR, name: str = "map") -> Chart:
    """All that the picture of a map shows.

    Args:
        picture: (H, W, 3) uint8.
        kinds: `PLANAR`, `INSPECTING` or `LEVEL`.
        name: Of the picture, for the error.

    Raises:
        UnreadableError: Something that belongs on a map is missing, hidden or of a colour that means nothing.
    """
    try:
        return _read_map(picture, kinds)
    except UnreadableError as error:
        raise UnreadableError(str(error).replace("[map]", f"[{name}]")) from error


def _read_map(picture: UInt8, kinds: tuple[int, ...]) -> Chart:
    if picture.ndim != 3:
        raise UnreadableError("[map]: expected colours, got gray")
    top, left, bottom, right = _frame(picture)
    per_metre, spacing = _scale(picture, top, left, bottom)
    _check_legend(picture, bottom, kinds)
    west, north = _corner(picture, (top, left, bottom), per_metre, spacing)
    ground = picture[top:bottom, left:right]
    discs = read_marks(ground, "map")
    colors = sight.COLORS if kinds == PLANAR else sight.COLORS_IN_SPACE
    seen, tinted = sight.classes(ground, colors)
    # What another kind of picture shows is strange here.
    seen[(seen < len(colors)) & ~np.isin(seen, (sight.UNKNOWN, *kinds))] = sight.STRANGE
    column, row, yaw, size = _arrow(ground, seen, tinted, discs)
    cells, side = _cells(ground, seen, _arrow_cover(seen.shape, (column, row, yaw, size)), discs)
    trail = sight.is_color(ground, sight.TRAIL)
    rows, cols = cells.shape
    passed = np.asarray(trail[: rows * side, : cols * side].reshape(rows, side, cols, side).any(axis=(1, 3)))
    return Chart(
        cells=cells,
        cell=side / per_metre,
        west=west,
        north=north,
        per_metre=per_metre,
        x=west + column / per_metre,
        y=north - row / per_metre,
        yaw=yaw,
        reach=8.0 * size / per_metre,
        trail=passed,
        discs=discs,
        ground=ground,
        marks=tuple((d.number, west + d.column / per_metre, north - d.row / per_metre) for d in discs),
    )


# ------------------------------------------------------------------------------------------ paper and ink


def _frame(picture: UInt8) -> tuple[int, int, int, int]:
    """First row and column inside the dark border, and the ones past the last."""
    ink = sight.is_color(picture, sight.INK)
    across, down = ink.sum(axis=1), ink.sum(axis=0)
    rows = np.flatnonzero(across > 0.6 * across.max()) if across.max() > 150 else np.zeros(0, np.int64)
    columns = np.flatnonzero(down > 0.6 * down.max()) if down.max() > 150 else np.zeros(0, np.int64)
    if len(rows) != 4 or len(columns) != 4:
        raise UnreadableError(
            f"[map]: expected a border of two dark lines on each side, got {len(rows)} lines across and "
            f"{len(columns)} down. Was the picture cut off?"
        )
    top, left, bottom, right = int(rows[1]) + 1, int(columns[1]) + 1, int(rows[2]), int(columns[2])
    whole = rows[1] - rows[0] == rows[3] - rows[2] == columns[1] - columns[0] == columns[3] - columns[2] == 1
    # A letter is high what the margin above is wide; to the left there is room for three.
    if not whole or left != 3 * top or len(picture) != bottom + 5 * top or picture.shape[1] < right + top:
        raise UnreadableError("[map]: expected margins for the writing around the border. Was it cut off?")
    return top, left, bottom, right


def _scale(picture: UInt8, top: int, left: int, bottom: int) -> tuple[float, float]:
    """Pixels of a metre, and metres between the lines, by the scale bar and what is written beside it."""
    row = round(bottom + 3.2 * top)
    line = np.asarray(sight.is_color(picture[row - 2 : row + 3], sight.INK).any(axis=0))
    ends = np.flatnonzero(~line[left + 2 :])
    bar = int(ends[0]) if len(ends) else 0
    if bar < 10:
        raise UnreadableError("[map]: expected a scale bar below its left corner, got none")
    strip = darkness(picture[row - top : row + top, left + 2 + bar : left + 2 + bar + 4 * top])
    fits = {spacing: likeness(strip, written(f"{spacing:g} m", top)) for spacing in SPACINGS}
    best = max(fits, key=lambda spacing: fits[spacing])
    if fits[best] < 0.8:
        raise UnreadableError(
            f"[map]: expected a length beside the scale bar, got {fits[best]:.2f} of {best:g} m"
        )
    return bar / best, best


NAMES = ("unknown", "explored", "target", "solid", "both", "inspected", "inspected, solid", "free")
"""Of what a cell may be, in that order."""


def _check_legend(picture: UInt8, bottom: int, kinds: tuple[int, ...]) -> None:
    below = picture[bottom + 2 :]
    shown = [(NAMES[kind], sight.COLORS_IN_SPACE[kind]) for kind in kinds]
    for name, color in (*shown, ("vehicle", sight.VEHICLE)):
        if np.count_nonzero(sight.is_color(below, color)) < 16:
            raise UnreadableError(f"[map]: expected {name} as {color} in the legend, got no such square")


def _corner(
    picture: UInt8, frame: tuple[int, int, int], per_metre: float, spacing: float
) -> tuple[float, float]:
    """World x of the left edge and y of the upper edge, by the numbers along the border."""
    top, left, bottom = frame
    below = darkness(picture[bottom + 2 : bottom + 2 + round(1.3 * top)])
    beside = darkness(picture[:, : left - 2])
    # In the lower left corner the numbers of both axes touch.
    across = [(a + b) / 2.0 - left for a, b in _groups(below.max(axis=0), 0.6 * top)]
    across = [c for c in across if c > 1.2 * top]
    down = [(a + b) / 2.0 - top for a, b in _groups(beside.max(axis=1), 0.25 * top)]
    down = [c for c in down if c < bottom - top - 1.2 * top]
    step = spacing * per_metre
    west = _origin(
        [below[:, _window(left + c, 1.6 * top, below.shape[1])] for c in across], across, step, spacing, top
    )
    north = _origin(
        [beside[_window(top + c, 0.7 * top, len(beside))] for c in down], down, -step, spacing, top
    )
    return west, north


def _window(middle: float, half: float, most: int) -> slice:
    return slice(max(round(middle - half), 0), min(round(middle + half), most))


def _origin(strips: list[Floats], places: list[float], step: float, spacing: float, letter: int) -> float:
    """Metres at pixel 0, from numbers at places in pixels that rise by `spacing` every `step` pixels."""
    if len(strips) < 2:
        raise UnreadableError(f"[map]: expected numbers along the border, got {len(strips)}")
    phases = [round((place - places[0]) / step) for place in places]
    off = [abs(place - places[0] - k * step) for place, k in zip(places, phases, strict=True)]
    if max(off) > 0.35 * letter + 2.0:
        raise UnreadableError(f"[map]: expected numbers every {abs(step):g} pixels, got {places}")
    first = first_number(tuple((s.shape, s.tobytes()) for s in strips), tuple(phases), spacing, letter, "map")
    residue = float(np.median([place - k * step for place, k in zip(places, phases, strict=True)]))
    # A number's middle is a pixel off its line: areas end where a round part of a metre does.
    part = 20.0 if abs(step) > 60.0 * spacing else 10.0
    return round(part * (first - residue / step * spacing)) / part


def _groups(dark: Floats, gap: float) -> list[tuple[int, int]]:
    """First index and the one past the last of what is dark with no greater gap."""
    at = np.flatnonzero(dark)
    if not len(at):
        return []
    breaks = np.flatnonzero(np.diff(at) > gap)
    starts, ends = [0, *(breaks + 1)], [*breaks, len(at) - 1]
    return [(int(at[a]), int(at[b]) + 1) for a, b in zip(starts, ends, strict=True)]


# -------------------------------------------------------------------------------------------- the vehicle


def _arrow(
    ground: UInt8, seen: UInt8, tinted: Bool, discs: tuple[Disc, ...]
) -> tuple[float, float, float, float]:
    """Column and row of the vehicle, its yaw in radians, and the length of its front part in pixels."""
    blue = sight.is_color(ground, sight.VEHICLE)
    hidden = _hidden(ground, discs)
    # Thinner lines are the edge of the sector in view. What hides the arrow must not make it thinner.
    core = ndimage.binary_opening(blue | hidden, ndimage.generate_binary_structure(2, 1), iterations=2) & blue
    bodies, count = ndimage.label(core, np.ones((3, 3)))
    if not count:
        raise UnreadableError("[map]: expected the vehicle, a blue arrow, got none")
    # A way may cut the arrow into pieces; crumbs are where two lines meet.
    sizes = np.bincount(bodies.ravel())
    sizes[0] = 0
    core &= (8 * sizes > sizes.max())[bodies]
    rows, columns = np.nonzero(core)
    reach = 4.0 * math.sqrt(len(rows) / ARROW_AREA) + 4.0
    middle = rows.mean(), columns.mean()
    down, across = (
        slice(max(math.floor(m - reach), 0), min(math.ceil(m + reach), most))
        for m, most in zip(middle, blue.shape, strict=True)
    )
    hidden = hidden[down, across]
    known = seen[down, across] < sight.OVERLAY
    fit = _fit(
        core[down, across] & ~hidden,
        hidden,
        (known, tinted[down, across]),
        (middle[1] - across.start + 0.5, middle[0] - down.start + 0.5),
    )
    column, row, yaw, size, quality = fit
    if quality < (LEAST_COVERED if hidden.any() else LEAST_ARROW):
        raise UnreadableError(f"[map]: expected the vehicle, a blue arrow, got {quality:.2f} of its shape")
    return column + across.start, row + down.start, yaw, size


def _hidden(ground: UInt8, discs: tuple[Disc, ...]) -> Bool:
    """Where a mark or the way to one is drawn over."""
    hidden = np.zeros(ground.shape[:2], np.bool_)
    if not discs:
        return hidden
    hidden |= ndimage.maximum_filter(sight.is_color(ground, sight.MARK), 3)
    for disc in discs:
        part = (
            slice(max(disc.row - OUTER, 0), disc.row + OUTER),
            slice(max(disc.column - OUTER, 0), disc.column + OUTER),
        )
        rows, columns = np.ogrid[part]
        hidden[part] |= ((rows - disc.row) ** 2 + (columns - disc.column) ** 2 <= OUTER**2)[
            : hidden[part].shape[0], : hidden[part].shape[1]
        ]
    return hidden


def _fit(
    body: Bool, hidden: Bool, view: tuple[Bool, Bool], middle: tuple[float, float]
) -> tuple[float, float, float, float, float]:
    """Column, row, yaw and size of the arrow that fits best, and how well it does: at most 1.

    Args:
        body: Where its blue is.
        hidden: Where it cannot be seen.
        view: Where cells are seen, and where they are tinted as those in view.
        middle: Column and row of the middle of the body.
    """
    column, row = middle
    rows, columns = np.mgrid[: body.shape[0], : body.shape[1]] + 0.5
    length = math.sqrt(np.count_nonzero(body) / ARROW_AREA)
    near = ~hidden & (np.hypot(rows - row, columns - column) < 2.2 * length + 4.0)
    points, wanted = (columns[near], rows[near]), body[near]
    known, tinted = (layer[::3, ::3] for layer in view)
    around, in_view = (columns[::3, ::3][known], rows[::3, ::3][known]), tinted[known]

    def qualities(at: tuple[float, float, float, float], every: int = 1) -> tuple[float, float]:
        arrow = _in_arrow(points[0][::every], points[1][::every], at, -SMOOTH)
        sector = _in_sector(around[0][::every], around[1][::every], at)
        return _overlap(arrow, wanted[::every]), _overlap(sector, in_view[::every])

    def quality(at: tuple[float, float, float, float]) -> float:
        return sum(qualities(at))

    alone = not (hidden & ndimage.binary_dilation(body, np.ones((3, 3), np.bool_), iterations=4)).any()
    around_middle = (0.0,) if alone else (-0.35, 0.0, 0.35)
    starts = [
        (column + size * (0.05 * math.cos(yaw) + a), row + size * (b - 0.05 * math.sin(yaw)), yaw, size)
        for size in (length * factor for factor in ((1.0,) if alone else (1.0, 1.3)))
        for yaw in np.arange(24) * (math.pi / 12.0)
        for a in around_middle
        for b in around_middle
    ]
    best = max(starts, key=lambda at: sum(qualities(at, COARSE)))
    value = quality(best)
    for step in (2.0, 1.0, 0.5, 0.25):
        improved = True
        while improved:
            improved = False
            turn = step / best[3]
            for change in (
                (step, 0.0, 0.0, 0.0), (-step, 0.0, 0.0, 0.0), (0.0, step, 0.0, 0.0), (0.0, -step, 0.0, 0.0),
                (0.0, 0.0, turn, 0.0), (0.0, 0.0, -turn, 0.0), (0.0, 0.0, 0.0, step), (0.0, 0.0, 0.0, -step),
            ):  # fmt: skip
                other = best[0] + change[0], best[1] + change[1], best[2] + change[2], best[3] + change[3]
                if (found := quality(other)) > value:
                    best, value, improved = other, found, True
    return best[0], best[1], math.remainder(best[2], 2.0 * math.pi), best[3], min(qualities(best))


def _overlap(one: Bool, other: Bool) -> float:
    """From 0 to 1: what two shapes have in common."""
    both = np.count_nonzero(one & other)
    return (both + 1.0) / (np.count_nonzero(one) + np.count_nonzero(other) - both + 1.0)


def _in_sector(columns: Floats, rows: Floats, at: tuple[float, float, float, float]) -> Bool:
    """Whether points lie in the sector of a quarter turn that is seen from there."""
    column, row, yaw, _ = at
    c, s = math.cos(yaw), math.sin(yaw)
    ahead = (columns - column) * c - (rows - row) * s
    aside = np.abs((columns - column) * s + (rows - row) * c)
    within: Bool = ahead > aside
    return within


def _in_arrow(
    columns: Floats, rows: Floats, at: tuple[float, float, float, float], edge: float = 0.0
) -> Bool:
    """Whether points lie in the arrow at column, row, yaw and size, grown by an edge; pixels."""
    column, row, yaw, size = at
    c, s = math.cos(yaw), math.sin(yaw)
    ahead = (columns - column) * c - (rows - row) * s
    aside = np.abs((columns - column) * s + (rows - row) * c)
    # The sides run from the tip to the wings' ends, the back from there to the notch.
    (tip, _), (wing, out), (notch, _), _ = ARROW
    side = math.hypot(tip - wing, out)
    back = math.hypot(notch - wing, out)
    within: Bool = (aside * (tip - wing) - (size * tip - ahead) * out) / side <= edge
    within &= ((size * notch - ahead) * out - aside * (notch - wing)) / back <= edge
    within &= ahead >= size * wing - edge
    return within


def _arrow_cover(shape: tuple[int, ...], at: tuple[float, float, float, float]) -> Bool:
    """Where the arrow and its white edge are."""
    cover = np.zeros(shape, np.bool_)
    reach = math.ceil(1.2 * at[3]) + EDGE + 2
    top, left = max(math.floor(at[1]) - reach, 0), max(math.floor(at[0]) - reach, 0)
    part = cover[top : math.ceil(at[1]) + reach, left : math.ceil(at[0]) + reach]
    rows, columns = np.mgrid[: part.shape[0], : part.shape[1]] + 0.5
    part |= _in_arrow(columns + left, rows + top, at, EDGE + 2.0)
    return cover


# ---------------------------------------------------------------------------------------------- the cells


def _cells(ground: UInt8, seen: UInt8, cover: Bool, discs: tuple[Disc, ...]) -> tuple[UInt8, int]:
    """What each cell is, (rows, cols), and pixels along a cell."""
    known = (seen < sight.OVERLAY) & ~cover
    # What is drawn over the cells blends with them at its edges into colours of any kind.
    side = _side(seen, known & ~ndimage.maximum_filter((seen >= sight.OVERLAY) | cover, 3))
    rows, cols = seen.shape[0] // side, seen.shape[1] // side
    votes = np.stack(
        [
            (known & (seen == k)).reshape(rows, side, cols, side).sum(axis=(1, 3), dtype=np.int16)
            for k in range(len(sight.COLORS_IN_SPACE))
        ]
    )
    cells = votes.argmax(axis=0).astype(np.uint8)
    open_votes = votes.max(axis=0) > 0
    drawn = cover | (seen == sight.OVERLAY)
    for disc in discs:
        drawn[
            max(disc.row - RADIUS, 0) : disc.row + RADIUS, max(disc.column - RADIUS, 0) : disc.column + RADIUS
        ] = True
    near = ndimage.maximum_filter(drawn, 9).reshape(rows, side, cols, side).any(axis=(1, 3))
    strange = ~open_votes & ~near
    if strange.any():
        row, col = np.argwhere(strange)[0]
        color = tuple(int(v) for v in ground[row * side + side // 2, col * side + side // 2])
        raise UnreadableError(
            f"[map]: expected the colours of the legend, got {color} in {np.count_nonzero(strange)} cells, "
            f"first at row {row}, column {col}"
        )
    if not open_votes.any():
        raise UnreadableError("[map]: expected cells, got none that can be seen")
    if not open_votes.all():
        nearest = ndimage.distance_transform_edt(~open_votes, return_distances=False, return_indices=True)
        cells = cells[tuple(nearest)]
    return cells, side


def _side(seen: UInt8, known: Bool) -> int:
    """Pixels along a cell: the most of which all borders between colours are multiples."""
    rows, cols = seen.shape
    across = np.flatnonzero(((seen[:, 1:] != seen[:, :-1]) & known[:, 1:] & known[:, :-1]).sum(axis=0)) + 1
    down = np.flatnonzero(((seen[1:] != seen[:-1]) & known[1:] & known[:-1]).sum(axis=1)) + 1
    for side in range(MOST_CELL, 1, -1):
        if rows % side == cols % side == 0 and not (across % side).any() and not (down % side).any():
            return side
    return 1
