"""Answers by rule: the title of the schema says what is wanted, the pictures what to answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy import ndimage

from dream.names import look_up
from dream.standin import eyes, offered, reading, sight, views
from dream.standin.chat import Asked, Json, asked
from dream.standin.climbing import climb_and_tilt, in_space_too
from dream.standin.eyes import Chart
from dream.standin.ground import Ground, Ints, sees, understand, understand_in_space
from dream.standin.marks import read_marks
from dream.standin.sight import Bool, Floats, UnreadableError
from dream.standin.upright import Upright
from dream.standin.views import CameraView
from dream.standin.way import UNREACHED, Moves, Ways, ways

HALF_VIEW = math.radians(38.0)
"""To each side of the heading: a little less than the camera sees."""
NEAREST, FARTHEST = 0.27, 0.85
"""Reaches of the camera between which a point is looked at."""
ENOUGH = 14.0
"""Points: a place that shows more is not better for it."""
PATIENCE, WEARY, LEAST_WORTH = 5, 0.6, 0.1
"""A point that stayed white though it was passed at so many places is worth less with each further one."""
MOST_OPEN, MOST_WHITE = 120, 200
"""Points that are considered, evenly taken from all."""
SIDE_GLANCE = 0.1
"""Worth of a white point while a region is open, in open points."""
AROUND_MARK = 0.35
"""Reaches of the camera around a mark within which it is judged."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that the pictures of a question show."""

    chart: Chart
    ground: Ground
    view: CameraView | None
    """None where the pictures of the camera were not sent."""
    upright: Upright | None = None
    """None where the vehicle keeps its height."""


def answer(request: Json) -> Json:
    """The fields of the reply to a request.

    Args:
        request: Of OpenAI's chat completions.

    Raises:
        UnreadableError: Something in the pictures cannot be read, or does not fit the text.
        ValueError: There is no rule for such a schema.
    """
    question = asked(request)
    return look_up(RULES, question.title, "rule for the schema")(question)


def see(question: Asked) -> Scene:
    """What the pictures of a question show, checked against each other and against the text."""
    picture, *_ = views.needed(question.pictures, "map")
    climbs = "climb_m" in question.schema.get("properties", {})
    in_space = climbs or offered.OF_SPACE in question.text
    chart = eyes.read_map(picture, eyes.INSPECTING if in_space else eyes.PLANAR)
    _check_text(question, chart)
    view = None
    if {"depth", "labels"} & set(question.pictures):
        shown = views.needed(question.pictures, "camera", "depth", "labels")
        view = views.read_views(*shown, in_space=in_space)
        green = np.isin(
            chart.cells, (sight.TARGET, sight.SOLID_TARGET, sight.INSPECTED, sight.SOLID_INSPECTED)
        )
        if view.near_target > 0.02 and not green.any():
            raise UnreadableError(
                f"[labels], [map]: expected what is near and green on both, "
                f"got {100.0 * view.near_target:.0f} % of the labels and nothing of the map"
            )
    if not in_space:
        return Scene(chart, understand(chart), view)
    level, upright = in_space_too(question, chart) if climbs else (None, None)
    return Scene(chart, understand_in_space(chart, level), view, upright)


def _check_text(question: Asked, chart: Chart) -> None:
    """Raise an `UnreadableError` where the text says other figures than the picture of the map."""
    for what, pattern, read, off in (
        ("pixels of a metre", r"a metre is ([\d.]+) pixels", chart.per_metre, 0.02 * chart.per_metre),
        ("x", r"robot is at x = (-?[\d.]+(?:e-?\d+)?) m", chart.x, 4.0 / chart.per_metre),
        ("y", r"robot is at x = \S+ m, y = (-?[\d.]+(?:e-?\d+)?) m", chart.y, 4.0 / chart.per_metre),
    ):
        said = question.number(pattern)
        if said is not None and abs(said - read) > off:
            raise UnreadableError(f"[map]: expected {what} {said:g} as the text says, got {read:.2f}")
    bearing = question.number(r"heads towards ([\d.]+) degrees")
    if bearing is not None:
        off = math.remainder(math.radians(bearing) - chart.yaw, 2.0 * math.pi)
        if abs(off) > math.radians(6.0):
            raise UnreadableError(
                f"[map]: expected the heading {bearing:.0f} degrees as the text says, "
                f"got {math.degrees(chart.yaw) % 360.0:.0f}"
            )


# ---------------------------------------------------------------------------------------------- an action


def action(question: Asked) -> Json:
    """The next move, without reasons."""
    return _act(question)[0]


def reasoned_action(question: Asked) -> Json:
    """The next move, with the six steps that lead to it."""
    move, scene, goal = _act(question)
    return {**_reasons(scene, goal, _in_words(move)), **move}


def moves_of(question: Asked) -> Moves:
    """The moves that a schema allows."""
    steps = sorted(float(step) for step in question.choices("step_m") if step > 0)
    if not steps:
        raise UnreadableError(f"{question.title}: expected some step_m above 0, got none")
    return Moves(tuple(sorted({0.0, *map(float, question.choices("turn_deg"))})), tuple(steps))


def as_fields(moves: Moves, turn: int, advance: float) -> Json:
    """A move as the fields of a reply; the turn in headings, positive to the left."""
    degrees = abs(turn) * 360.0 / moves.headings
    return {
        "direction": "forward" if turn == 0 else "left" if turn > 0 else "right",
        "turn_deg": int(degrees) if degrees == int(degrees) else degrees,
        "step_m": int(advance) if advance == int(advance) else advance,
        "done": False,
    }


def _act(question: Asked) -> tuple[Json, Scene, Floats | None]:
    """The next move, what was seen, and the world x and y that it leads to; None where nothing is left."""
    scene = see(question)
    chart, ground, moves = scene.chart, scene.ground, moves_of(question)
    barred: list[tuple[int, float]] = []
    if "That was not safe" in question.text:
        heading = round(chart.yaw / (2.0 * math.pi) * moves.headings) % moves.headings
        barred = [(heading, advance) for advance in moves.advances]
    found = ways(ground, moves, barred)
    refused = "Done was said" in question.text
    goal = _best_view(ground, found, np.argwhere(ground.open), np.argwhere(ground.hiding), refused=refused)
    if goal is None:
        stay = {"direction": "forward", "turn_deg": 0, "step_m": 0, "done": True}
        return stay | _upwards(question, scene, 0, 0.0), scene, None
    turn, advance = found.first(goal)
    move = as_fields(moves, turn, advance) | _upwards(question, scene, turn, advance)
    return move, scene, np.array([found.x[goal[2]], found.y[goal[1]]])


def _upwards(question: Asked, scene: Scene, turn: int, advance: float) -> Json:
    """The climb and the tilt of a move; nothing where the vehicle keeps its height."""
    if scene.upright is None:
        return {}
    return climb_and_tilt(question, scene.upright, ahead=advance if turn == 0 else None if advance else 0.0)


def _thinned(cells: Ints, most: int) -> Ints:
    return cells[:: max(1, math.ceil(len(cells) / most))]


def _thinned_by(points: Floats, apart: float) -> Floats:
    """One of all points that lie in the same square of that side, in metres."""
    _, first = np.unique(np.floor(points / apart), axis=0, return_index=True)
    return points[first]


def _best_view(
    ground: Ground, found: Ways, open_cells: Ints, white_cells: Ints, *, refused: bool
) -> tuple[int, int, int] | None:
    """Heading, iy and ix of the pose that shows most for its steps; None where none shows anything."""
    for cells, weights, dread in _wishes(ground, open_cells, white_cells):
        worth = _worth(ground, found, ground.middle(cells), weights, refused=refused)
        score = np.minimum(worth, ENOUGH) / (found.steps + 1.0) ** dread
        score[(found.steps == UNREACHED) | (found.steps == 0)] = 0.0
        best = int(score.argmax())
        if score.flat[best] > 0.0:
            heading, iy, ix = np.unravel_index(best, score.shape)
            return int(heading), int(iy), int(ix)
    return None


def _wishes(ground: Ground, open_cells: Ints, white_cells: Ints) -> list[tuple[Ints, Floats, float]]:
    """What to look at, what a point of it is worth, and the power of the steps by which that is divided.

    First comes what is open, then what is white: there the near is worth more, for it would be passed by.
    """
    some_open, some_white = _thinned(open_cells, MOST_OPEN), _thinned(white_cells, MOST_WHITE)
    wishes = []
    if len(some_open):
        both = np.concatenate([some_open, some_white])
        worth = np.repeat([1.0, SIDE_GLANCE], [len(some_open), len(some_white)])
        wishes.append((both, worth, 1.0))
    if len(some_white):
        wishes.append((some_white, np.ones(len(some_white)), 2.0))
    return wishes


def _worth(ground: Ground, found: Ways, points: Floats, weights: Floats, *, refused: bool) -> Floats:
    """(headings, ny, nx): the summed weights of the points that are seen from there.

    Only what has the first point's kind counts as a reason to go: white beside open regions is extra.
    """
    first = weights == weights.max()
    reach, headings = ground.chart.reach, found.moves.headings
    nearest, farthest, half = (0.17, 0.97, 0.77) if refused else (NEAREST, FARTHEST, HALF_VIEW)
    trail = _thinned_by(ground.middle(np.argwhere(ground.chart.trail)), 0.125 * reach)
    seen_from = sees(ground, trail, points, nearest=nearest * reach, farthest=farthest * reach).sum(axis=0)
    weights = weights * WEARY ** np.maximum(seen_from - PATIENCE, 0)
    iy, ix = np.nonzero(found.steps.min(axis=0) < UNREACHED)
    kept = ((iy - found.here[0]) % 2 == 0) & ((ix - found.here[1]) % 2 == 0)
    iy, ix = iy[kept], ix[kept]
    places = np.stack([found.x[ix], found.y[iy]], axis=1)
    clear = sees(ground, places, points, nearest=nearest * reach, farthest=farthest * reach)
    at, of = np.nonzero(clear)
    toward = np.arctan2(points[of, 1] - places[at, 1], points[of, 0] - places[at, 0])
    here = (iy[at] == found.here[0]) & (ix[at] == found.here[1])
    off = np.abs(np.angle(np.exp(1j * (toward - ground.chart.yaw))))
    # What is in view and stays white is hidden by something that the map does not show.
    hidden = np.zeros(len(points), np.bool_)
    hidden[of[here & (off < half)]] = True
    kept = ~hidden[of]
    if len(trail):
        # Where it was already it need not go again; but it may turn there, unless that was of no use.
        passed = np.hypot(*(places[:, None] - trail[None]).transpose(2, 0, 1)).min(axis=1) < 0.075 * reach
        kept &= ~passed[at] | (here & (not hidden.any()))
    at, of, toward = at[kept], of[kept], toward[kept]
    main = (first[of]) & (weights[of] > LEAST_WORTH)
    worth = np.zeros(found.steps.shape)
    for heading in range(headings):
        angle = 2.0 * math.pi * heading / headings
        seen = np.abs(np.angle(np.exp(1j * (toward - angle)))) < half
        total = np.bincount(at[seen], weights[of[seen]], len(iy))
        reason = np.bincount(at[seen & main], minlength=len(iy))
        worth[heading, iy, ix] = np.where(reason > 0, total, 0.0)
    return worth


# ------------------------------------------------------------------------------------------------ a ranking


def ranked_places(question: Asked) -> Json:
    """The numbered places in order: green beside white first, then white, the near before the far."""
    wanted = sorted(int(number) for number in question.choices("ranking"))
    scene = see(question)
    chart, ground = scene.chart, scene.ground
    numbers = [number for number, _, _ in chart.marks]
    if numbers != wanted:
        raise UnreadableError(f"[map]: expected the marks {wanted}, which the schema names, got {numbers}")
    if "camera" in question.pictures:
        _check_camera_marks(question, wanted)
    if offered.OF_SPACE in question.text:
        worth = offered.worth_in_space(question, chart)
        return _ranking(scene, worth, sorted(worth, key=lambda number: (-worth[number], number)))
    radius = AROUND_MARK * chart.reach
    values = {
        number: _Value(
            _share(ground, ground.open, x, y, radius),
            _share(ground, ground.white, x, y, radius),
            math.hypot(x - chart.x, y - chart.y) / chart.reach,
        )
        for number, x, y in chart.marks
    }
    ranking = sorted(values, key=lambda number: (not values[number].open, -values[number].worth, number))
    return _ranking(scene, {number: value.worth for number, value in values.items()}, ranking)


def _ranking(scene: Scene, worth: Mapping[int, float], ranking: list[int]) -> Json:
    """The fields of a reply.

    Args:
        scene: What was seen.
        worth: Of each place by its number; higher is better.
        ranking: The numbers in order.
    """
    chart, ground = scene.chart, scene.ground
    lead = worth[ranking[0]] - worth[ranking[1]] if len(ranking) > 1 else 1.0
    _, x, y = next(mark for mark in chart.marks if mark[0] == ranking[0])
    words = f"I would visit them in the order {', '.join(map(str, ranking))}."
    return {
        **_reasons(scene, np.array([x, y]), words),
        "ranking": ranking,
        "confidence": round(min(1.0, 0.5 + max(lead, 0.0)), 3),
        "mission_complete": not (ground.open.any() or ground.hiding.any()),
    }


def _check_camera_marks(question: Asked, wanted: list[int]) -> None:
    picture, *_ = views.needed(question.pictures, "camera")
    views.check_camera(picture)
    strange = {disc.number for disc in read_marks(picture, "camera")} - set(wanted)
    if strange:
        raise UnreadableError(
            f"[camera]: expected only marks of the map, {wanted}, got {sorted(strange)}, too"
        )


@dataclass(frozen=True, slots=True)
class _Value:
    """What lies around a mark: parts of it, 0 to 1, and its distance in reaches."""

    open: float
    white: float
    distance: float

    @property
    def worth(self) -> float:
        """Higher is better."""
        return 3.0 * self.open + self.white - 0.15 * self.distance


def _share(ground: Ground, layer: Bool, x: float, y: float, radius: float) -> float:
    """Part of the cells around a point that a layer holds, 0 to 1."""
    row, col = ground.chart.place(x, y)
    rows, cols = np.ogrid[: layer.shape[0], : layer.shape[1]]
    near = np.hypot(rows + 0.5 - row, cols + 0.5 - col) * ground.chart.cell <= radius
    return float(layer[near].mean()) if near.any() else 0.0


# ------------------------------------------------------------------------------------------------ in words


def _in_words(move: Json) -> str:
    if move["done"]:
        return "Done."
    turn = (
        "Keep the heading"
        if move["turn_deg"] == 0
        else f"Turn {move['turn_deg']} degrees {move['direction']}"
    )
    words = f"{turn}, then go {move['step_m']} m forward." if move["step_m"] else f"{turn}."
    if "climb_m" in move:
        words = f"{words[:-1]}, {move['climb_m']} m up, the camera {move['tilt_deg']} degrees down."
    return words


def _figure(metres: float) -> str:
    """To a decimetre; adding 0.0 turns -0.0 into 0.0."""
    return f"{round(metres, 1) + 0.0:.1f}"


def _reasons(scene: Scene, goal: Floats | None, last: str) -> dict[str, str]:
    """The six steps, with figures from the pictures."""
    chart, ground = scene.chart, scene.ground
    square = chart.cell**2
    _, regions = ndimage.label(ground.green, np.ones((3, 3)))
    green, white = (float(np.count_nonzero(layer)) * square for layer in (ground.green, ground.white))
    open_cells = ground.middle(np.argwhere(ground.open))
    here = np.array([chart.x, chart.y])
    if len(open_cells):
        x, y = open_cells[np.hypot(*(open_cells - here).T).argmin()]
        area = f"The nearest boundary that is open is at ({_figure(x)}, {_figure(y)})."
    else:
        area = "No green touches white."
    room = float(ground.look(ground.away, chart.x, chart.y, 0.0))
    stands = (
        f"The nearest black is {room:.1f} m away." if math.isfinite(room) else "Nothing black is on the map."
    )
    if scene.view is not None:
        stands += f" Ahead, {scene.view.free:.1f} m are free, and {100.0 * scene.view.target:.0f} % is green."
    return {
        "distribution": f"I see {green:.1f} square metres of green in {regions} groups, {white:.0f} white.",
        "target_area": f"The robot is at ({_figure(chart.x)}, {_figure(chart.y)}). {area}",
        "completion": f"{len(open_cells)} white cells lie beside green."
        + ("" if ground.hiding.any() else " No white is large enough to hide a group."),
        "next_target": "Nothing that is left can be looked at."
        if goal is None
        else f"Next I want to look from ({_figure(goal[0])}, {_figure(goal[1])}).",
        "safety": stands,
        "action": last,
    }


RULES: Mapping[str, Callable[[Asked], Json]] = MappingProxyType(
    {
        "ReasonedAction": reasoned_action,
        "Action": action,
        "RankedPlaces": ranked_places,
        "Choice": reading.choice,
        "Orders": reading.orders,
    }
)
"""What is done for which schema, by its title."""
