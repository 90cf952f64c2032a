"""What the stand-in answers: rules over what it read from the pictures."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.standin import eyes
from dream.standin.eyes import BLACK, DARK_GREEN, GRAY, GREEN, WHITE, Map, Unreadable

Point = tuple[float, float]
FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

KEEP_OFF = 0.9
"""Metres that it keeps from black."""
BESIDE = 1.0
"""Metres from green within which white is open."""
GROUP = 1.4
"""Radius of white ground that could hide a group, metres."""
NEAR, FAR = 1.8, 7.0
"""Metres between which the camera shows the ground well."""
LEG = 3.0
"""Metres of a way that are looked ahead."""
LEAST = 1.0
"""Square metres that are worth a look; white beside green counts five times."""
BEARINGS = 72
STEPS = ("distribution", "target_area", "completion", "next_target", "safety", "action")


@dataclass(frozen=True, slots=True)
class Asked:
    """A question as it came over the wire."""

    text: str
    """All of it, instructions included."""
    pictures: Mapping[str, bytes]
    """By the names in the text."""
    schema: Mapping[str, Any]


def answer(asked: Asked) -> dict[str, Any]:
    """What fits the schema, by what the pictures show.

    Raises:
        Unreadable: A picture is missing, or does not show what it should.
        ValueError: The schema is none that it knows.
    """
    fields = set(asked.schema.get("properties", {}))
    for known, rule in RULES.items():
        if known <= fields:
            return {name: value for name, value in rule(asked).items() if name in fields}
    raise ValueError(f"schema: expected one of the known ones, got fields {', '.join(sorted(fields))}")


# ------------------------------------------------------------------------------------------- what is seen


def _map(asked: Asked) -> Map:
    pixels = re.search(r"a metre is ([\d.]+) pixels", asked.text)
    grid = re.search(r"lines are ([\d.]+) m apart", asked.text)
    if not pixels or not grid:
        raise Unreadable("text: it does not say how large a metre is")
    if "map" not in asked.pictures:
        raise Unreadable("map: there is none")
    return eyes.read_map(eyes.open_picture(asked.pictures["map"], "map"), float(pixels[1]), float(grid[1]))


def _check_camera(asked: Asked) -> None:
    """The camera's three pictures are what their names say."""
    shown = {}
    for name in ("camera", "depth", "labels"):
        if name not in asked.pictures:
            raise Unreadable(f"{name}: there is none")
        shown[name] = eyes.open_picture(asked.pictures[name], name)
    if len({picture.shape for picture in shown.values()}) > 1:
        raise Unreadable("camera, depth, labels: not of one size")
    eyes.check_depth(shown["depth"])
    eyes.check_labels(shown["labels"])
    eyes.check_camera(shown["camera"])


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """The map, and what follows from it."""

    map: Map
    passable: BoolArray
    open: BoolArray
    """White beside green."""
    hiding: BoolArray
    """White that is the middle of a place where a group could be."""
    walls: BoolArray


def _view(seen: Map) -> _View:
    from scipy.ndimage import distance_transform_edt

    cells, cell = seen.cells, seen.cell
    walls = (cells == BLACK) | (cells == DARK_GREEN)
    white, green = cells == WHITE, (cells == GREEN) | (cells == DARK_GREEN)

    def away(what: BoolArray) -> FloatArray:
        if not what.any():
            return np.full(cells.shape, np.inf)
        return np.asarray(distance_transform_edt(~what, cell))

    row, col = np.indices(cells.shape)[:2]
    rows, cols = np.asarray(row), np.asarray(col)
    robot = np.hypot((cols + 0.5) * cell - seen.position[0], (rows + 0.5) * cell - seen.position[1])
    room = away(walls)
    here = seen.at(*seen.position)
    # Who is nearer to a wall already may leave along it, not towards it.
    keep_off = np.where(robot <= NEAR, min(KEEP_OFF, room[here] - 0.5 * cell), KEEP_OFF)
    passable = ((cells == GRAY) | (cells == GREEN) | (robot <= NEAR)) & ~walls & (room >= keep_off)
    passable[here] = True
    edge = np.minimum.reduce([rows, cols, rows[::-1], cols[:, ::-1]]) * cell
    return _View(
        seen,
        passable,
        white & (away(green) <= BESIDE),
        white & (away(~white) >= GROUP) & (edge >= GROUP),
        walls,
    )


# ---------------------------------------------------------------------------------------------- an action


def _action(asked: Asked) -> dict[str, Any]:
    """Look from here at what is open, or go to where more of it would show for the way there."""
    _check_camera(asked)
    seen = _map(asked)
    view, fields = _view(seen), asked.schema["properties"]
    turns = sorted({sign * float(turn) for turn in fields["turn_deg"]["enum"] for sign in (-1.0, 1.0)})
    lengths = [float(length) for length in fields["step_m"]["enum"]]
    goal = _best(view)
    if goal is None:
        told = _told(view, "Nothing is left that a way leads to.", "Done.")
        return {**told, "direction": "forward", "turn_deg": 0, "step_m": 0, "done": True}
    bearing, room = _towards(view, goal)
    turn = min(turns, key=lambda t: (abs(math.remainder(bearing - t, 360.0)), t))
    heading = seen.heading + math.radians(turn)
    step = max(s for s in lengths if s == 0.0 or (s <= room + 0.3 and _free(view, heading, s)))
    if turn == 0.0 and step == 0.0:
        turn = 180.0  # To stand still shows nothing new.
    direction = "forward" if turn == 0.0 else "left" if turn > 0.0 else "right"
    x, y = _middle(view, goal.place)
    place = f"White ground is to be seen from ({x + seen.origin[0]:.1f}, {y + seen.origin[1]:.1f})."
    told = _told(view, place, f"Turn by {turn:.0f} degrees, go {step:g} m.")
    return {**told, "direction": direction, "turn_deg": abs(turn), "step_m": step, "done": False}


@dataclass(frozen=True, slots=True)
class _Goal:
    """Where to stand, and where to look from there."""

    place: tuple[int, int]
    heading: float
    way: FloatArray


def _best(view: _View) -> _Goal | None:
    """The place and heading that would show most that is open, for the way there."""
    way = _ways(view)
    here = view.map.at(*view.map.position)
    rows, cols = np.nonzero(np.isfinite(way))
    some = (rows % 4 == 0) & (cols % 4 == 0)
    places = [here, *zip(rows[some].tolist(), cols[some].tolist(), strict=True)]
    worth = np.where(view.open, 5.0, np.where(view.hiding, 1.0, 0.0))
    # What is in view now and still white does not show from anywhere near.
    worth[_looked_at(view)] = 0.0
    best: tuple[float, _Goal] | None = None
    for place in places:
        shown = _shown(view, worth, place)
        k = int(shown.argmax())
        heading = 2.0 * math.pi * k / len(shown)
        turned = abs(math.remainder(heading - view.map.heading, 2.0 * math.pi)) if place == here else 1.0
        rate = float(shown[k]) / (1.0 + 0.5 * way[place] + 0.5 * turned)
        if shown[k] >= LEAST and (best is None or rate > best[0] + 1e-9):
            best = rate, _Goal(place, heading, way)
    return None if best is None else best[1]


def _shown(view: _View, worth: FloatArray, place: tuple[int, int]) -> FloatArray:
    """(BEARINGS,) what a look from a cell towards each bearing would show: rays end at walls."""
    cell = view.map.cell
    away = np.arange(NEAR, FAR, cell)
    angles = 2.0 * math.pi * np.arange(BEARINGS) / BEARINGS
    rows = place[0] + np.rint(np.outer(np.sin(angles), away) / cell).astype(int)
    cols = place[1] + np.rint(np.outer(np.cos(angles), away) / cell).astype(int)
    inside = (rows >= 0) & (rows < worth.shape[0]) & (cols >= 0) & (cols < worth.shape[1])
    rows, cols = np.where(inside, rows, 0), np.where(inside, cols, 0)
    clear = np.logical_and.accumulate(inside & ~view.walls[rows, cols], axis=1)
    # Far samples stand for more ground than near ones.
    rays = (np.where(clear, worth[rows, cols], 0.0) * away).sum(axis=1) * cell * 2.0 * math.pi / BEARINGS
    half = BEARINGS // 8
    return np.asarray(sum(np.roll(rays, k) for k in range(-half, half + 1)))


def _towards(view: _View, goal: _Goal) -> tuple[float, float]:
    """Degrees to turn, and metres that may be gone then."""
    here = view.map.at(*view.map.position)
    if goal.place == here:
        return math.degrees(goal.heading - view.map.heading), 0.0
    x, y = _first_leg(view, goal)
    east, north = x - view.map.position[0], y - view.map.position[1]
    return math.degrees(math.atan2(north, east) - view.map.heading), math.hypot(east, north)


def _told(view: _View, next_target: str, action: str) -> dict[str, str]:
    """The six steps, with what was read."""
    cells = view.map.cells
    green = int(((cells == GREEN) | (cells == DARK_GREEN)).sum())
    area = green * view.map.cell**2
    explored = float((cells != WHITE).mean())
    return {
        "distribution": f"I see {area:.1f} square metres of green; {explored:.0%} of the map is not white.",
        "target_area": "The green that touches white." if view.open.any() else "None.",
        "completion": f"{int(view.open.sum())} white cells are beside green.",
        "next_target": next_target,
        "safety": f"I keep {KEEP_OFF:g} m from black.",
        "action": action,
    }


def _centers(view: _View) -> tuple[FloatArray, FloatArray]:
    """East and north of every cell."""
    rows, cols = np.indices(view.map.cells.shape)
    return np.asarray((cols + 0.5) * view.map.cell), np.asarray((rows + 0.5) * view.map.cell)


def _looked_at(view: _View) -> BoolArray:
    """In the camera's sector now: what is still white there will not show from here."""
    x, y = _centers(view)
    east, north = x - view.map.position[0], y - view.map.position[1]
    away = np.hypot(east, north)
    ahead = east * math.cos(view.map.heading) + north * math.sin(view.map.heading)
    return np.asarray((away <= FAR + 1.0) & (ahead >= away * math.cos(math.radians(50.0))))


def _ways(view: _View) -> FloatArray:
    """(rows, cols) metres to each passable cell, a diagonal as long as a side; inf where no way leads."""
    from scipy.ndimage import binary_dilation

    way = np.full(view.passable.shape, np.inf)
    front = np.zeros(view.passable.shape, bool)
    front[view.map.at(*view.map.position)] = True
    gone = 0.0
    while front.any():
        way[front] = gone
        gone += view.map.cell
        front = binary_dilation(front, np.ones((3, 3), bool)) & view.passable & np.isinf(way)
    return way


def _first_leg(view: _View, goal: _Goal) -> Point:
    """A place on the way to which a straight line leads."""
    place = goal.place
    while goal.way[place] > LEG or not _passes(view, *view.map.position, *_middle(view, place)):
        nearer = min(_around(place, goal.way.shape), key=lambda at: goal.way[at])
        if goal.way[nearer] >= goal.way[place]:
            break
        place = nearer
    return _middle(view, place)


def _around(place: tuple[int, int], shape: tuple[int, ...]) -> list[tuple[int, int]]:
    rows = range(max(place[0] - 1, 0), min(place[0] + 2, shape[0]))
    return [(r, c) for r in rows for c in range(max(place[1] - 1, 0), min(place[1] + 2, shape[1]))]


def _middle(view: _View, place: tuple[int, int]) -> Point:
    return (place[1] + 0.5) * view.map.cell, (place[0] + 0.5) * view.map.cell


def _free(view: _View, heading: float, length: float) -> bool:
    x, y = view.map.position
    return _passes(view, x, y, x + length * math.cos(heading), y + length * math.sin(heading))


def _passes(view: _View, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Is the straight way between two positions passable?"""
    return all(view.passable[place] for place in _along(view.map, x, y, to_x, to_y)[1:])


def _along(seen: Map, x: float, y: float, to_x: float, to_y: float) -> list[tuple[int, int]]:
    count = max(2, math.ceil(math.hypot(to_x - x, to_y - y) / (0.5 * seen.cell)))
    shares = np.linspace(0.0, 1.0, count)
    return [seen.at(x + float(k) * (to_x - x), y + float(k) * (to_y - y)) for k in shares]


# ---------------------------------------------------------------------------------------------- a ranking


def _ranking(asked: Asked) -> dict[str, Any]:
    """Marks with the most open green around them first, then those with the most white, near before far."""
    seen = _map(asked)
    if "camera" not in asked.pictures:
        raise Unreadable("camera: there is none")
    eyes.check_camera(eyes.open_picture(asked.pictures["camera"], "camera"))
    items = asked.schema["properties"]["ranking"]["items"]
    numbers = set(items["enum"] if "enum" in items else [items["const"]])
    if set(seen.marks) != numbers:
        raise Unreadable(f"map: marks {sorted(seen.marks)}, but {sorted(numbers)} are asked for")
    view = _view(seen)
    x, y = _centers(view)

    def worth(number: int) -> float:
        at = seen.marks[number]
        around = np.hypot(x - at[0], y - at[1]) <= FAR
        shown = 5.0 * (view.open & around).sum() + ((seen.cells == WHITE) & around).sum()
        return float(shown) / (4.0 + math.hypot(at[0] - seen.position[0], at[1] - seen.position[1]))

    order = sorted(numbers, key=lambda number: (-round(worth(number), 6), number))
    told = _told(
        view, f"Place {order[0]}: there is most to be seen.", f"First {', then '.join(map(str, order))}."
    )
    complete = not view.open.any() and not view.hiding.any()
    return {**told, "ranking": order, "confidence": 0.8, "mission_complete": complete}


RULES: Mapping[frozenset[str], Callable[[Asked], dict[str, Any]]] = {
    frozenset({"direction", "turn_deg", "step_m", "done"}): _action,
    frozenset({"ranking", "confidence", "mission_complete"}): _ranking,
}
"""By the fields that a schema must have."""
