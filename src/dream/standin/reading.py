"""Questions about the map, and orders in plain words: answered from what is written and drawn."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import ndimage

from dream.standin import eyes, sight, views
from dream.standin.chat import Asked, Json
from dream.standin.eyes import Chart
from dream.standin.sight import Bool, UnreadableError

COMPASS = ("east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")
AROUND = 3.0
"""Metres around a mark in which white ground is counted."""
GAP = 2.0
"""Metres of a gap that parts two regions."""
NEIGHBOURS = np.ones((3, 3), np.bool_)


def choice(question: Asked) -> Json:
    """The answer to a question of `dream probe`, and what decided it."""
    picture, *_ = views.needed(question.pictures, "map")
    chart, offered = eyes.read_map(picture), question.choices("answer")
    for pattern, rule in _KINDS:
        if found := re.search(pattern, question.text):
            reason, answer = rule(chart, found)
            if answer not in offered:
                raise UnreadableError(f"[map]: expected one of {', '.join(map(str, offered))}, got {answer}")
            return {"reason": reason, "answer": answer}
    raise UnreadableError(f"text: expected a question of a known kind, got {question.text[-200:]!r}")


# ----------------------------------------------------------------------------------------- kinds of questions


def _nearest(chart: Chart, _: re.Match[str]) -> tuple[str, str]:
    away = {number: math.hypot(x - chart.x, y - chart.y) for number, x, y in chart.marks}
    number = min(away, key=lambda mark: away[mark])
    return f"Mark {number} is {away[number]:.1f} m from the robot.", str(number)


def _unexplored(chart: Chart, _: re.Match[str]) -> tuple[str, str]:
    white = chart.cells == sight.UNKNOWN
    area = {n: np.count_nonzero(white & (_away(chart, x, y) <= AROUND)) for n, x, y in chart.marks}
    number = max(area, key=lambda mark: area[mark])
    return f"Around mark {number} there are {area[number] * chart.cell**2:.1f} m2 of white.", str(number)


def _boundary(chart: Chart, _: re.Match[str]) -> tuple[str, str]:
    edge = _touching(chart)
    away = {n: float(_away(chart, x, y)[edge].min(initial=math.inf)) for n, x, y in chart.marks}
    number = min(away, key=lambda mark: away[mark])
    return f"Green touches white {away[number]:.1f} m from mark {number}.", str(number)


def _blocked(chart: Chart, _: re.Match[str]) -> tuple[str, str]:
    black = {}
    for number, x, y in chart.marks:
        along = np.linspace(0.0, 1.0, 2 + int(8.0 * math.hypot(x - chart.x, y - chart.y)))
        cells = [_at(chart, chart.x + k * (x - chart.x), chart.y + k * (y - chart.y)) for k in along.tolist()]
        black[number] = sum(cell in (sight.SOLID, sight.SOLID_TARGET) for cell in cells)
    number = max(black, key=lambda mark: black[mark])
    return f"The line to mark {number} crosses black.", str(number)


def _heading(chart: Chart, _: re.Match[str]) -> tuple[str, str]:
    name = COMPASS[round(chart.yaw / (0.25 * math.pi)) % 8]
    return f"The arrow points at {math.degrees(chart.yaw) % 360.0:.0f} degrees.", name


def _enclosed(chart: Chart, found: re.Match[str]) -> tuple[str, str]:
    x, y = next((x, y) for number, x, y in chart.marks if number == int(found[1]))
    green = _green(chart)
    closed = ndimage.distance_transform_edt(~green) * chart.cell < 0.5 * GAP
    parts, _ = ndimage.label(closed, NEIGHBOURS)
    away = np.where(green, _away(chart, x, y), np.inf)
    region = parts[np.unravel_index(int(away.argmin()), away.shape)]
    cells = int(np.count_nonzero(_touching(chart) & (parts == region)))
    return f"{cells} green cells of that region touch white.", "no" if cells else "yes"


def _point(chart: Chart, found: re.Match[str]) -> tuple[str, str]:
    cell = _at(chart, float(found[1]), float(found[2]))
    names = {sight.UNKNOWN: "unexplored", sight.EXPLORED: "explored", sight.TARGET: "target"}
    return "I looked there.", names.get(cell, "solid")


def _explored(chart: Chart, _: re.Match[str]) -> tuple[str, str]:
    share = float((chart.cells != sight.UNKNOWN).mean())
    bands = ("less than 20 %", "20 to 40 %", "40 to 60 %", "more than 60 %")
    return f"{share:.0%} of the map is not white.", bands[min(int(5.0 * share), 3)]


_KINDS: tuple[tuple[str, Callable[[Chart, re.Match[str]], tuple[str, str]]], ...] = (
    (r"Which mark is nearest to the robot", _nearest),
    (r"Which mark has the most white ground", _unexplored),
    (r"Which mark has a place within 2 m of it where green touches white", _boundary),
    (r"To which mark is the straight line from the robot blocked", _blocked),
    (r"Towards which point of the compass", _heading),
    (r"nearest to mark (\d+) fully enclosed", _enclosed),
    (r"at the point x = (-?[\d.]+) m, y = (-?[\d.]+) m", _point),
    (r"How much of the whole area is explored", _explored),
)


def _away(chart: Chart, x: float, y: float) -> sight.Floats:
    """(rows, cols) metres from a point in the world."""
    row, col = chart.place(x, y)
    rows, cols = np.ogrid[: chart.cells.shape[0], : chart.cells.shape[1]]
    return np.asarray(np.hypot(rows + 0.5 - row, cols + 0.5 - col) * chart.cell)


def _at(chart: Chart, x: float, y: float) -> int:
    row, col = chart.place(x, y)
    rows, cols = chart.cells.shape
    return int(chart.cells[min(max(math.floor(row), 0), rows - 1), min(max(math.floor(col), 0), cols - 1)])


def _green(chart: Chart) -> Bool:
    return np.asarray((chart.cells == sight.TARGET) | (chart.cells == sight.SOLID_TARGET))


def _touching(chart: Chart) -> Bool:
    """(rows, cols) green beside white."""
    white = chart.cells == sight.UNKNOWN
    return np.asarray(_green(chart) & ndimage.binary_dilation(white, NEIGHBOURS))


# ----------------------------------------------------------------------------------------------------- orders


SIDES = ("northeast", "northwest", "southeast", "southwest", "north", "south", "east", "west")
FINDS = r"\b(?:find|look for|locate|search(?: for)?)\b"
MAPS = r"\b(?:map|survey|inspect|cover|see|explore)\b"
TARGETS = {"wreck": r"\b(?:ship)?wrecks?\b", "oysters": r"\b(?:oyster|reef)s?\b(?: reefs?\b)?"}
STEPS = r",? ?\b(?:in )?at most (\d+) steps(?: in all)?"
SPAN = r"(-?\d+(?:\.\d+)?)(?: m)? to (-?\d+(?:\.\d+)?)(?: m)?"
BOX = rf"\bx ?=? ?{SPAN},?(?: and)?(?: from)? y ?=? ?{SPAN}\b"
PARTS = rf",?(?: and)? then |; |(?:,| and|, and) (?={FINDS}|{MAPS})"
"""What parts one leg from the next."""
FILLER = frozenset(
    (
        *("a", "all", "an", "and", "any", "anything", "area", "around", "box", "everything", "from"),
        *("half", "in", "is", "it", "its", "of", "on", "only", "part", "please", "quarter"),
        *("side", "survey", "target", "targets", "that", "the", "then", "there", "to", "what", "whatever"),
        *("whole", "with"),
    )
)
"""Words that say nothing by themselves."""
MOST_LEFT_OUT = 500


def orders(question: Asked) -> Json:
    """Orders by the words that stand in the text: what, where, in which order and how long.

    What it knows no phrase for is left out, and said to be.
    """
    quoted = re.search(r'^The operator says, in JSON:\n(".*")$', question.text, re.MULTILINE)
    if not quoted:
        raise UnreadableError("text: expected the operator's words in quotation marks, got none")
    words = str(json.loads(quoted[1])).lower()
    limit = re.search(STEPS, words)
    legs: list[dict[str, Any]] = []
    left_out: list[str] = []
    for part in re.split(PARTS, re.sub(STEPS, "", words, count=1)):
        leg, rest = _leg(part, len(legs))
        left_out += rest
        legs += leg
    unknown = "; ".join(left_out)
    return {
        "legs": legs or _leg("map", 0)[0],
        "max_steps": int(limit[1]) if limit else None,
        "left_out": unknown if len(unknown) <= MOST_LEFT_OUT else f"{unknown[:MOST_LEFT_OUT]} ...",
    }


def _leg(part: str, before: int) -> tuple[list[Json], list[str]]:
    """The leg that a part of the words orders, none where nothing in it is known; and what is not in that.

    Args:
        part: In small letters.
        before: Legs that were ordered before it.
    """
    task = next((name for name, verb in (("find", FINDS), ("map", MAPS)) if re.search(verb, part)), None)
    target = next((name for name, noun in TARGETS.items() if re.search(noun, part)), None)
    box = re.search(BOX, part)
    side = None if box else next((side for side in SIDES if side in part), None)
    earlier = before if side and before and re.search(r"\bits\b", part) else None
    used = [FINDS if task == "find" else MAPS, BOX, *([TARGETS[target]] if target else [])]
    rest = part
    for phrase in used:
        rest = re.sub(phrase, ",", rest)
    if side:
        rest = re.sub(rf"{side}(ern)?\b", ",", rest, count=1)
    left_out = [_unfilled(clause) for clause in re.split(r"[,;!?]|\.(?!\d)", rest)]
    found = [clause for clause in left_out if clause]
    if not (task or target or box or side):
        return [], found
    leg = {
        "task": task or "map",
        "target": target or "any",
        "area": "box" if box else "side" if side else "everywhere",
        "box": _box(box) if box else None,
        "side": side,
        "of_leg": earlier,
    }
    return [leg], found


def _box(found: re.Match[str]) -> Json:
    (x_min, x_max), (y_min, y_max) = (sorted(map(float, found.groups()[k : k + 2])) for k in (0, 2))
    return {"x_min_m": x_min, "y_min_m": y_min, "x_max_m": x_max, "y_max_m": y_max}


def _unfilled(clause: str) -> str:
    """Without the words that say nothing at its ends."""
    words = clause.split()
    while words and words[0] in FILLER:
        del words[0]
    while words and words[-1] in FILLER:
        del words[-1]
    return " ".join(words)
