"""Places in three dimensions: what their table says of them, checked against the map; what they are worth."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from dream.standin.chat import Asked
from dream.standin.eyes import Chart
from dream.standin.ground import Ints
from dream.standin.marks import DIGIT, RADIUS, Disc
from dream.standin.sight import INK, MARK, Bool, UInt8, UnreadableError, is_color

OF_SPACE = "| number | position | depth, m |"
"""How the table of places in three dimensions begins."""
_ROW = re.compile(
    r"^\| (\d+) \| \((\S+), (\S+)\) \| (\S+) \| (\d+) \| [^|]+ \| [^|]+ \| (\S+) \| (\S+) \| (\S+) \|$",
    re.MULTILINE,
)
UNKNOWN, GROUND = 0.5, 0.1
"""Worth of a square metre that is unknown beside target, and of one of ground, in those of target."""
ASIDE = 3.0
"""Metres by which a disc may stand beside its place, where it would hide the vehicle or another disc."""
LEGIBLE = 0.6
"""Share of the ink of a depth that must be seen beside its disc."""


def worth_in_space(question: Asked, chart: Chart) -> Mapping[int, float]:
    """What each place shows for each step, by its number; higher is better.

    Raises:
        UnreadableError: The table names other places than the map, or other depths.
    """
    rows = {int(row[0]): tuple(float(cell) for cell in row[1:]) for row in _ROW.findall(question.text)}
    if sorted(rows) != [number for number, _, _ in chart.marks]:
        raise UnreadableError(
            f"[map]: expected the places of the table, {sorted(rows)}, got {[m[0] for m in chart.marks]}"
        )
    for (number, x, y), disc in zip(chart.marks, chart.discs, strict=True):
        east, north, depth = rows[number][:3]
        off = math.hypot(x - east, y - north)
        others = [(row[0], row[1]) for other, row in rows.items() if other != number]
        hides = any(math.hypot(x - east, y - north) < 1.5 for x, y in (*others, (chart.x, chart.y)))
        if off > (ASIDE if hides else 0.0) + (RADIUS + 2) / chart.per_metre:
            raise UnreadableError(
                f"[map]: expected place {number} at ({east:g}, {north:g}) as the table says, "
                f"got ({x:.1f}, {y:.1f})"
            )
        if not _reads(chart.ground, disc, f"{depth:g} m", chart.discs):
            raise UnreadableError(f"[map]: expected {depth:g} m beside the disc of place {number}")
    return {
        number: (target + UNKNOWN * unknown + GROUND * ground) / max(steps, 1.0)
        for number, (_, _, _, steps, target, unknown, ground) in rows.items()
    }


def _reads(ground: UInt8, disc: Disc, text: str, discs: tuple[Disc, ...]) -> bool:
    """Does that stand beside a disc, to its right or left, as far as other discs leave it to be seen?"""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(DIGIT)
    wide = math.ceil(font.getlength(text))
    picture = Image.new("L", (wide + 8, 2 * RADIUS), 0)
    pen = ImageDraw.Draw(picture)
    pen.fontmode = "1"
    pen.text((4, RADIUS), text, fill=255, font=font, anchor="lm")
    written = np.asarray(picture) > 0
    ink, yellow = is_color(ground, INK), is_color(ground, MARK)
    covered = 0
    sides = disc.column + RADIUS, disc.column - RADIUS - wide - 6
    lefts = [side + shift for side in sides for shift in (-1, 0, 1)]
    for left in lefts:
        rows, cols = np.nonzero(written)
        rows, cols = rows + disc.row - RADIUS, cols + left
        inside = (rows >= 0) & (rows < ink.shape[0]) & (cols >= 0) & (cols < ink.shape[1])
        rows, cols = rows[inside], cols[inside]
        hidden = yellow[rows, cols] | _under(rows, cols, disc, discs)
        open_ink = ink[rows, cols][~hidden]
        if len(open_ink) < 0.5 * len(rows):
            covered += 1
        elif len(open_ink) and open_ink.mean() >= LEGIBLE and not _more(ink, written, disc, left):
            return True
    # Where other discs cover both sides there is nothing to be read.
    return covered == len(lefts)


def _more(ink: Bool, written: Bool, disc: Disc, left: int) -> bool:
    """Is there much ink within the plate besides what is written?"""
    part = ink[
        max(disc.row - RADIUS + 3, 0) : disc.row + RADIUS - 3, max(left + 2, 0) : left + written.shape[1] - 2
    ]
    mine = written[3 : 2 * RADIUS - 3, 2:-2]
    if part.shape != mine.shape:
        return False
    return bool((part & ~mine).sum() > 0.4 * max(int(mine.sum()), 1))


def _under(rows: Ints, cols: Ints, disc: Disc, discs: tuple[Disc, ...]) -> Bool:
    """(N,) which pixels other discs cover."""
    covered = np.zeros(rows.shape[0], np.bool_)
    for other in discs:
        if other is not disc:
            covered |= (rows - other.row) ** 2 + (cols - other.column) ** 2 <= (RADIUS + 2) ** 2
    return covered
