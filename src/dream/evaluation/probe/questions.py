"""The questions of `dream probe`: about a map, with answers that are right by a clear margin."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from dream.evaluation.probe import reading
from dream.evaluation.probe.reading import FloatArray, Ground
from dream.evaluation.probe.scenes import WORLDS, Scene, scenes
from dream.geometry import SE2
from dream.planning.vlm import pictures, prompts
from dream.planning.vlm.asking import Question
from dream.planning.vlm.reply import ChosenAnswer, choice_reply
from dream.types import Mission

QUESTIONS = 200
"""All there are."""
FEWEST_MARKS, MOST_MARKS = 5, 9
APART = 2.5
"""Metres between marks, and between a mark and the robot."""
LOOKED_AT = 400
"""Places of a scene, drawn at random, among which marks are looked for."""
TRIES = 30
"""Places that are tried for the mark that is asked for, in a scene."""
BARE = {"mark": 1.2, "line": 0.4, "robot": 2.0}
"""Metres between a point that is asked for and what is drawn over the cells."""

Marks = Mapping[int, tuple[float, float]]
"""World x and y of each mark by its number."""


@dataclass(frozen=True, slots=True, eq=False)
class MapQuestion:
    """A question about a map, and the right answer."""

    number: int
    """From 1."""
    kind: str
    """A key of `KINDS`."""
    scene: str
    """Of which map."""
    text: str
    choices: tuple[str, ...]
    answer: str
    """The right one."""
    picture: bytes
    """PNG."""
    ground: Ground
    """What the map shows."""
    pose: SE2
    """The robot."""
    marks: Marks
    instructions: str
    prompt: str
    """Name and version."""

    @property
    def chance(self) -> float:
        """Of the right answer where one is drawn blindly."""
        return 1.0 / len(self.choices)

    @property
    def asked(self) -> Question[ChosenAnswer]:
        """As a model is asked."""
        return Question(
            self.prompt,
            self.instructions,
            f"{self.text}\nAnswer with one of: {', '.join(self.choices)}.",
            {"map": self.picture},
            choice_reply(self.choices),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Draft:
    """A question that was found in a scene, before it is drawn."""

    text: str
    pose: SE2
    marks: FloatArray
    """(m, 2) in the order of their numbers."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What is asked for."""

    title: str
    """In tables."""
    choices: tuple[str, ...]
    """Empty where the marks are."""
    draft: Callable[[Scene, str, int, np.random.Generator], _Draft | None]
    """A question about a scene with that answer and that many marks; None where it has none."""


def make_questions(count: int = QUESTIONS, own: prompts.Own = prompts.PACKAGED) -> Iterator[MapQuestion]:
    """The first `count` questions; the same ones each time, and as many of every kind as may be.

    Args:
        count: How many.
        own: Prompts to take in the place of the package's, by name.

    Raises:
        ValueError: There are not so many.
    """
    if not 1 <= count <= QUESTIONS:
        raise ValueError(f"questions: expected 1 to {QUESTIONS}, got {count}")
    known = cache(scenes)
    kinds = list(KINDS)
    for number in range(1, count + 1):
        turn, which = divmod(number - 1, len(kinds))
        yield _make(number, kinds[which], turn, known, own)


def _make(
    number: int,
    kind: str,
    turn: int,
    known: Callable[[str, int], list[Scene]],
    own: prompts.Own,
) -> MapQuestion:
    """Question `turn` of a kind, from the world whose turn it is, or from another that has one."""
    asked, which = KINDS[kind], list(KINDS).index(kind)
    marks = FEWEST_MARKS + turn % (MOST_MARKS - FEWEST_MARKS + 1)
    choices = asked.choices or tuple(str(k) for k in range(1, marks + 1))
    # Every answer is right equally often, as nearly as that goes; for marks also among as many marks.
    nth = turn + turn // len(WORLDS) if asked.choices else turn // 5 + 5 * which + 2
    wanted = choices[nth % len(choices)]
    first = turn % len(WORLDS)
    others = np.random.default_rng(number).permutation(np.delete(np.arange(len(WORLDS)), first))
    for world, seed in (WORLDS[k] for k in (first, *others.tolist())):
        maps = known(world, seed)
        for k in range(len(maps)):
            stage = (turn // len(WORLDS) + which + k) % len(maps)
            rng = np.random.default_rng([number, seed, stage])
            draft = asked.draft(maps[stage], wanted, marks, rng)
            if draft is not None:
                return _drawn(number, kind, maps[stage], draft, choices, wanted, own)
    raise RuntimeError(f"no map has a question of the kind {kind} with the answer {wanted}")


def _drawn(
    number: int,
    kind: str,
    scene: Scene,
    draft: _Draft,
    choices: tuple[str, ...],
    answer: str,
    own: prompts.Own,
) -> MapQuestion:
    from dream.mapping.drawing import Mark

    occupancy = scene.occupancy
    marks = [Mark(k, scene.way(at)) for k, at in enumerate(draft.marks, start=1)]
    picture = pictures.png(pictures.map_picture(occupancy, draft.pose, scene.trail, marks))
    instructions, prompt = prompts.instructions(
        "probe",
        Mission(occupancy.protocol, occupancy.bounds, occupancy.protocol.cap),
        occupancy,
        own,
    )
    return MapQuestion(
        number,
        kind,
        scene.name,
        draft.text,
        choices,
        answer,
        picture,
        scene.ground,
        draft.pose,
        {k: (float(x), float(y)) for k, (x, y) in enumerate(draft.marks, start=1)},
        instructions,
        prompt,
    )


# ----------------------------------------------------------------------------------------- the kinds


def _contest(
    text: str,
    measure: Callable[[Ground, SE2, FloatArray], reading.Contest],
    scene: Scene,
    wanted: str,
    count: int,
    rng: np.random.Generator,
) -> _Draft | None:
    """Marks of which the wanted one wins."""
    places = _some(scene, rng)
    contest = measure(scene.ground, scene.pose, places)
    for first in rng.permutation(np.flatnonzero(contest.may_win))[:TRIES]:
        rivals = contest.rivals(first)
        # Those that could be taken for it come first, about half of the time.
        order = rng.random(len(places)) - 0.5 * contest.tempting
        others = _spread(places, first, np.flatnonzero(rivals)[np.argsort(order[rivals])], count - 1)
        if len(others) == count - 1:
            number = int(wanted)
            losers = rng.permutation(np.array(others, np.intp))
            return _Draft(text, scene.pose, places[np.insert(losers, number - 1, first)])
    return None


def _some(scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Places that are not too near to the robot."""
    away = np.hypot(*(scene.places - (scene.pose.x, scene.pose.y)).T)
    return rng.permutation(scene.places[away >= APART])[:LOOKED_AT]


def _spread(places: FloatArray, first: int | None, pool: npt.ArrayLike, count: int) -> list[int]:
    """The first places of a pool that lie apart from each other and from the first; `count` at most."""
    taken = [] if first is None else [first]
    chosen: list[int] = []
    for k in np.asarray(pool, np.intp).tolist():
        if len(chosen) == count:
            break
        if all(math.hypot(*(places[k] - places[other])) >= APART for other in taken):
            taken.append(k)
            chosen.append(k)
    return chosen


def _any_marks(scene: Scene, count: int, rng: np.random.Generator) -> FloatArray | None:
    places = _some(scene, rng)
    chosen = _spread(places, None, np.arange(len(places)), count)
    return places[chosen] if len(chosen) == count else None


def _heading(scene: Scene, wanted: str, count: int, rng: np.random.Generator) -> _Draft | None:
    marks = _any_marks(scene, count, rng)
    if marks is None:
        return None
    off = rng.uniform(-reading.OFF_COURSE, reading.OFF_COURSE)
    yaw = math.remainder(0.25 * math.pi * reading.COMPASS.index(wanted) + off, 2.0 * math.pi)
    return _Draft(
        "Towards which point of the compass does the robot head?", replace(scene.pose, yaw=yaw), marks
    )


def _enclosed(scene: Scene, wanted: str, count: int, rng: np.random.Generator) -> _Draft | None:
    places = _some(scene, rng)
    answers = scene.regions.nearest_enclosed(places)
    fitting = [k for k, answer in enumerate(answers) if answer == wanted]
    for first in rng.permutation(np.array(fitting, np.intp))[:TRIES].tolist():
        others = _spread(places, first, np.arange(len(places)), count - 1)
        if len(others) == count - 1:
            chosen = rng.permutation([first, *others])
            number = int(np.flatnonzero(chosen == first)[0]) + 1
            text = (
                f"Is the target region nearest to mark {number} fully enclosed, so that none of its green "
                f"touches white? Green with gaps of less than {reading.GAP:g} m is one region."
            )
            return _Draft(text, scene.pose, places[chosen])
    return None


def _thing(scene: Scene, wanted: str, count: int, rng: np.random.Generator) -> _Draft | None:
    from scipy.spatial import cKDTree

    marks = _any_marks(scene, count, rng)
    if marks is None:
        return None
    colors = dict(
        zip(reading.THINGS, (reading.GREEN, reading.GRAY, reading.WHITE, reading.BLACK), strict=True)
    )
    middles = scene.ground.centers(scene.ground.cells == colors[wanted])
    points = rng.permutation(np.unique(np.round(2.0 * middles) / 2.0, axis=0))
    lines = np.concatenate([_dense(line) for line in (scene.trail, *map(scene.way, marks))])
    bare = cKDTree(lines).query(points)[0] >= BARE["line"]
    bare &= cKDTree(marks).query(points)[0] >= BARE["mark"]
    bare &= np.hypot(*(points - (scene.pose.x, scene.pose.y)).T) >= BARE["robot"]
    for x, y in points[bare][: 10 * TRIES]:
        if reading.thing(scene.ground, x, y) == wanted:
            text = f"What is at the point x = {x:g} m, y = {y:g} m of the map?"
            return _Draft(text, scene.pose, marks)
    return None


def _dense(line: FloatArray) -> FloatArray:
    """(N, 2) points every 0.1 m along a line."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.linspace(0.0, along[-1], max(1, math.ceil(along[-1] / 0.1)) + 1)
    return np.stack([np.interp(at, along, axis) for axis in line.T], axis=-1)


def _band(scene: Scene, wanted: str, count: int, rng: np.random.Generator) -> _Draft | None:
    marks = _any_marks(scene, count, rng)
    if marks is None or reading.band(scene.ground) != wanted:
        return None
    return _Draft("How much of the whole area is explored, that is, not white?", scene.pose, marks)


KINDS: Mapping[str, Kind] = {
    "nearest": Kind(
        "nearest mark",
        (),
        partial(_contest, "Which mark is nearest to the robot, in a straight line?", reading.nearest),
    ),
    "unexplored": Kind(
        "most unexplored ground",
        (),
        partial(
            _contest,
            f"Which mark has the most white ground within {reading.AROUND:g} m of it?",
            reading.whitest,
        ),
    ),
    "boundary": Kind(
        "open boundary",
        (),
        partial(
            _contest,
            f"Which mark has a place within {reading.BESIDE:g} m of it where green touches white?",
            reading.open_ended,
        ),
    ),
    "blocked": Kind(
        "blocked way",
        (),
        partial(
            _contest,
            "To which mark is the straight line from the robot blocked by black or dark green?",
            reading.shut_off,
        ),
    ),
    "heading": Kind("heading", reading.COMPASS, _heading),
    "enclosed": Kind("enclosed region", reading.YES_NO, _enclosed),
    "point": Kind("what is at a point", reading.THINGS, _thing),
    "explored": Kind("share explored", reading.BANDS, _band),
}
"""Every kind by its name, in the order in which they take turns."""
