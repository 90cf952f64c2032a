"""Up and down: the cuts of a question in three dimensions, and the climb and tilt that follow from them."""

from __future__ import annotations

import math

import numpy as np

from dream.standin import eyes, sight, views
from dream.standin.chat import Asked, Json
from dream.standin.eyes import Chart
from dream.standin.ground import BODY
from dream.standin.sight import UnreadableError
from dream.standin.upright import Upright, read_upright

HALF_HEIGHT = 0.3
"""Metres of the body above its middle, with some room."""
CRUISE = 2.5
"""Metres above what lies below at which it goes on where nothing is to be inspected."""
LOW = 1.25
"""Metres above what lies below that it keeps at least."""
ABOVE = 1.0
"""Metres above the middle of what is to be inspected from which it looks at it."""
NEAR, FAR = 1.5, 7.0
"""Metres ahead between which it looks for that."""
AGREE = 0.6
"""Share of the water ahead on which the two cuts must agree."""


def in_space_too(question: Asked, chart: Chart) -> tuple[Chart, Upright]:
    """The two cuts, checked against each other, the map and the text.

    Raises:
        UnreadableError: One cannot be read, or they do not show the same.
    """
    flat, tall = views.needed(question.pictures, "level", "slice")
    level, upright = eyes.read_map(flat, eyes.LEVEL, "level"), read_upright(tall)
    same = math.hypot(level.x - chart.x, level.y - chart.y) <= 4.0 / chart.per_metre
    off = abs(math.remainder(level.yaw - chart.yaw, 2.0 * math.pi))
    if level.cells.shape != chart.cells.shape or not same or off > math.radians(6.0):
        raise UnreadableError("[level], [map]: expected one sheet with the vehicle at one place, got another")
    said = question.number(r"It is (-?[\d.]+) m under water")
    if said is not None and abs(said - upright.depth) > 0.15:
        raise UnreadableError(
            f"[slice]: expected the vehicle {said:g} m under water as the text says, got {upright.depth:.1f}"
        )
    ahead = np.arange(0.5, FAR, 0.25)
    rows, cols = (
        np.floor(v).astype(np.int64)
        for v in level.place(level.x + ahead * math.cos(level.yaw), level.y + ahead * math.sin(level.yaw))  # type: ignore[arg-type]
    )
    inside = (rows >= 0) & (rows < level.cells.shape[0]) & (cols >= 0) & (cols < level.cells.shape[1])
    one = level.cells[rows[inside], cols[inside]] == sight.FREE
    over = upright.depth + np.linspace(-HALF_HEIGHT, HALF_HEIGHT, 5)[:, None]
    depth, along = np.broadcast_arrays(over, ahead[inside])
    other = (upright.look(along, depth) == sight.FREE).all(axis=0)
    if len(one) and (one == other).mean() < AGREE:
        raise UnreadableError(
            f"[level], [slice]: expected the same water ahead, got {100.0 * (one == other).mean():.0f} %"
        )
    return level, upright


def climb_and_tilt(question: Asked, upright: Upright, *, ahead: float | None) -> Json:
    """As fields of a reply.

    Args:
        question: Whose schema says which are allowed.
        upright: The upright cut.
        ahead: Metres that the move goes straight ahead; None where it goes elsewhere, which the cut does not
            show.
    """
    climbs = sorted((float(c) for c in question.choices("climb_m")), key=abs)
    tilts = sorted(float(t) for t in question.choices("tilt_deg"))
    wanted = _wanted(upright)
    best = 0.0
    if ahead is not None:
        safe = [c for c in climbs if c == 0.0 or upright.is_free(ahead, c, BODY + 0.1, HALF_HEIGHT)]
        best = min(safe, key=lambda climb: abs(upright.depth - climb - wanted))
    depth = upright.depth - best
    # It looks at what lies below some metres ahead, or at what is to be inspected there.
    middle = _middle(upright)
    down = upright.below() + best if middle is None else middle - depth
    angle = math.degrees(math.atan2(min(down, 10.0), 0.5 * (NEAR + FAR)))
    up = wanted < depth - 0.5 and best == 0.0
    tilt = tilts[0] if up and tilts[0] < 0.0 else min(tilts, key=lambda allowed: abs(allowed - angle))
    return {"climb_m": _whole(best), "tilt_deg": _whole(tilt)}


def _wanted(upright: Upright) -> float:
    """Metres under water at which it wants to be."""
    ground = upright.depth + upright.below()
    middle = _middle(upright)
    wanted = ground - CRUISE if middle is None else middle - ABOVE
    return float(min(wanted, ground - LOW)) if math.isfinite(ground) else upright.depth


def _middle(upright: Upright) -> float | None:
    """Mean depth of target ahead that is not inspected; None where the cut shows none."""
    rows, cols = np.nonzero(upright.cells == sight.TARGET)
    ahead = upright.left + (cols + 0.5) / upright.per_metre
    near = (ahead >= NEAR) & (ahead <= FAR)
    if not near.any():
        return None
    return float(upright.top + (rows[near] + 0.5).mean() / upright.per_metre)


def _whole(value: float) -> float:
    return int(value) if value == int(value) else value
