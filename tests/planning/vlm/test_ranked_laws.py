"""Laws of the questions of `Ranked`: all that is said of places agrees, and turns with the world."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.evaluation.runner import simulate
from dream.geometry import SE2, Bounds
from dream.lattice import Pose, lattice_of
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.planning import Belief
from dream.planning.belief import BeliefPilot, Thought
from dream.planning.lookahead import Plan, Prospect
from dream.planning.sources import Expected, Situation
from dream.planning.viewpoints import Viewpoints
from dream.planning.vlm import Ranked, offline
from dream.planning.vlm.asking import Question
from dream.planning.vlm.places import APART, Place, places
from dream.planning.vlm.ranking_question import ranking_question
from dream.planning.vlm.reply import Ranking
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.standin import rules, sight
from dream.standin.chat import Asked, asked
from dream.standin.eyes import read_map
from dream.standin.marks import read_marks
from dream.types import LOOK_AROUND, Decision, Mission, Observation
from tests.mapping.analytic import AREA, empty_map
from tests.model_server import Server, ranking, serving
from tests.planning.flights import SIDE, observed_at
from tests.sim.arenas import FLOOR, arena, placed
from tests.standin.sheets import request

LATTICE = lattice_of(AREA, DREAM_V1)
HEADINGS = DREAM_V1.headings

# ----------------------------------------------------------------------------- what is asked during flights


@dataclass(frozen=True)
class Sent:
    """A question as the server got it, and what was known when it was asked."""

    pose: SE2
    occupancy: OccupancyMap
    asked: Asked
    own: tuple[float, float] | None
    """x and y of the offline planner's own place; None where it would end the mission."""

    @property
    def schema(self) -> list[int]:
        return sorted(self.asked.choices("ranking"))

    @property
    def table(self) -> dict[int, tuple[float, float, int, int]]:
        """x, y, steps and heading by number, from the text."""
        row = r"^\| (\d+) \| \((\S+), (\S+)\) \| (\d+) \| (\d+) degrees \("
        rows = re.findall(row, self.asked.text, re.MULTILINE)
        degrees = 360.0 / HEADINGS
        return {
            int(number): (float(x), float(y), int(steps), round(float(yaw) / degrees) % HEADINGS)
            for number, x, y, steps, yaw in rows
        }

    @property
    def drawn(self) -> dict[int, tuple[float, float]]:
        """x and y by number, from the pixels of the map."""
        chart = read_map(sight.decode(self.asked.pictures["map"], "map"))
        return {number: (x, y) for number, x, y in chart.marks}

    @property
    def points(self) -> set[tuple[float, float]]:
        return {(x, y) for x, y, _, _ in self.table.values()}


@dataclass
class Listening:
    """`Ranked`, and all that it asked."""

    planner: Ranked
    server: Server
    listed: list[list[Place]]
    pilot: Any = None
    sent: list[list[Sent]] = field(default_factory=list)
    """The votes of each question."""

    def begin(self, mission: Mission) -> Listening:
        self.pilot = self.planner.begin(mission)
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        before, known = len(self.server.asked), occupancy.copy()
        decision: Decision = self.pilot.decide(observation, occupancy)
        if requests := self.server.asked[before:]:
            x, y = self.listed[-1][0].path[-1]
            own = float(x), float(y)
            self.sent.append(
                [Sent(observation.pose, known, asked(request.body), own) for request in requests]
            )
        return decision


WRECK = replace(
    arena(targets=placed(0, [(5.0, 0.0, FLOOR)], (2.0, 4.0, 2.2))),
    hull=np.ones(1, np.bool_),
    starts=(SE2(-6.0, 0.0, 0.0),),
)


HIDDEN, BEHIND = 9 / 32, 0.75 + 10 / 32
"""Metres from the vehicle within which a place's disc would cover it, and how far behind it stands then: nine
pixels, and the tail of the arrow and ten."""


@pytest.fixture(scope="module")
def questions(string_reef: World) -> list[list[Sent]]:
    """All that was asked while a model was followed often and far, on a reef and around a wreck."""
    often = {"margin": 20.0, "weight": 50.0, "allowance": 10.0, "latency": 0.0, "timeout": 5.0}
    sent = []
    with pytest.MonkeyPatch.context() as patch, serving(ranking(_last_first)) as server:
        listed: list[list[Place]] = []

        def listening(*args: Any) -> list[Place]:
            listed.append(places(*args))
            return listed[-1]

        patch.setattr(offline, "places", listening)
        for world, steps, votes in ((string_reef, 8, 1), (WRECK, 5, 3)):
            asking = Ranked(**server.options, votes=votes, **often)  # type: ignore[arg-type]
            flight = Listening(asking, server, listed)
            for _ in simulate(world, flight, DREAM_V1, max_steps=LOOK_AROUND + steps):
                pass
            sent += flight.sent
    return sent


def _last_first(numbers: list[int]) -> list[int]:
    return sorted(numbers, reverse=True)


@pytest.mark.rare
def test_schema_table_and_pixels_of_the_map_name_the_same_places(questions: list[list[Sent]]) -> None:
    assert len(questions) >= 3
    for votes in questions:
        for sent in votes:
            _check_agreement(sent)


def _check_agreement(sent: Sent) -> None:
    table, drawn = sent.table, sent.drawn
    assert sent.schema == list(range(1, 1 + len(sent.schema)))
    assert sorted(table) == sorted(drawn) == sent.schema
    assert len(sent.points) == len(table)
    for number, (x, y, _, _) in table.items():
        # A pixel of these maps is a fifth of a cell at most. A disc that would hide the vehicle is behind it.
        pose, pixel = sent.pose, 0.2 * DREAM_V1.cell
        if math.dist((x, y), (pose.x, pose.y)) < HIDDEN:
            x, y = pose.x - BEHIND * math.cos(pose.yaw), pose.y - BEHIND * math.sin(pose.yaw)
            pixel *= 2.0
        assert math.dist((x, y), drawn[number]) < pixel


@pytest.mark.rare
def test_a_numbered_place_is_one_that_moves_over_known_ground_lead_to(questions: list[list[Sent]]) -> None:
    """But for the offline planner's own: it may end where only what is seen on the way shows free ground."""
    for votes in questions:
        for sent in votes:
            own = {number for number, (x, y, _, _) in sent.table.items() if (x, y) == sent.own}
            assert len(own) == 1
            assert _feasible(sent) | own == set(sent.schema)


def _feasible(sent: Sent) -> set[int]:
    """The numbers that the vehicle can get to, looking that way, in no more steps than the table says."""
    reached = _reached(sent.pose, sent.occupancy)
    return {
        number
        for number, (x, y, steps, heading) in sent.table.items()
        if reached.get((round(x / DREAM_V1.lattice), round(y / DREAM_V1.lattice), heading), 999) <= steps
    }


def _reached(pose: SE2, occupancy: OccupancyMap) -> dict[tuple[int, int, int], int]:
    """Fewest steps to each x, y (nodes) and heading by moves that the guard lets pass: a slow search."""
    spacing, starts = DREAM_V1.lattice, lattice_of(occupancy.bounds, DREAM_V1).positions
    nodes = [(round(x / spacing), round(y / spacing)) for x, y in starts.tolist()]
    free = {}
    for heading in range(HEADINGS):
        for advance in DREAM_V1.advances:
            offset = DREAM_V1.offset(heading, advance)
            passes = occupancy.passable(starts, starts + spacing * np.array(offset))
            free[heading, offset] = {
                node for node, passed in zip(nodes, passes.tolist(), strict=True) if passed
            }
    here = round(pose.x / spacing), round(pose.y / spacing), DREAM_V1.heading_index(pose.yaw)
    steps, layer = {here: 0}, [here]
    while layer:
        after = []
        for x, y, before in layer:
            for turn in DREAM_V1.turns:
                heading = (before + turn) % HEADINGS
                ends = [(x, y, heading)]
                for advance in DREAM_V1.advances:
                    east, north = DREAM_V1.offset(heading, advance)
                    if (x, y) in free[heading, (east, north)]:
                        ends.append((x + east, y + north, heading))
                for end in ends:
                    if end not in steps:
                        steps[end] = steps[x, y, before] + 1
                        after.append(end)
        layer = after
    return steps


@pytest.mark.rare
def test_votes_have_the_same_places_under_other_numbers(questions: list[list[Sent]]) -> None:
    several = [votes for votes in questions if len(votes) > 1]
    assert several
    for votes in several:
        assert len({frozenset(sent.points) for sent in votes}) == 1
        assert len({tuple(sorted(sent.drawn.items())) for sent in votes}) > 1


def test_numbers_in_the_cameras_picture_are_numbers_of_the_map(questions: list[list[Sent]]) -> None:
    shown = 0
    for votes in questions:
        for sent in votes:
            discs = read_marks(sight.decode(sent.asked.pictures["camera"], "camera"), "camera")
            assert {disc.number for disc in discs} <= set(sent.schema)
            shown += len(discs)
    assert shown


# ----------------------------------------------------------------------------------- turned and mirrored maps


@dataclass(frozen=True)
class Turned:
    """So many quarter turns to the left, about the middle of `AREA`, of the world or of its mirror image.

    In the mirror east and west change places.
    """

    quarters: int = 0
    mirrored: bool = False

    def cells(self, layer: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Rows grow with y: that way round it is a turn to the left."""
        return np.rot90(layer[:, ::-1] if self.mirrored else layer, -self.quarters)

    def pose(self, pose: Pose) -> Pose:
        """On the lattice."""
        here = LATTICE.world(pose)
        yaw = math.pi - here.yaw if self.mirrored else here.yaw
        return LATTICE.pose(SE2(*self.point(here.x, here.y), yaw + 0.5 * math.pi * self.quarters))

    def plan(self, plan: Plan) -> Plan:
        return replace(plan, path=[self.pose(pose) for pose in plan.path])

    def point(self, x: float, y: float) -> tuple[float, float]:
        if self.mirrored:
            x = -x
        for _ in range(self.quarters):
            x, y = -y, x
        return x, y


TIE = 3e-6
"""Between rates; they are rounded to 1e-6."""
SEEDS = range(4)
AS_IT_IS = Turned()
QUARTERS = [Turned(quarters) for quarters in (1, 2, 3)]
MIRRORED = [Turned(quarters, mirrored=True) for quarters in (0, 1)]


@dataclass(slots=True)
class Uneven(BeliefPilot):
    """To whom no two tiles are worth the same, so that what is as good as another thing is so nowhere.

    Which of two equal ones comes first is a matter of their order, and that does not turn with the world.
    """

    turned: Turned = AS_IT_IS

    def prospect(self, expected: Expected, scene: Situation) -> Prospect:
        prospect = BeliefPilot.prospect(self, expected, scene)
        # There is a row and a column of tiles more than lie between the nodes.
        side = math.isqrt(self.pose_views.tiles)
        factor = np.ones((side, side), np.float32)
        factor[:-1, :-1] += self.turned.cells(0.02 * np.random.default_rng(1).random((side - 1, side - 1)))
        worth = factor.ravel()
        return replace(prospect, ground=prospect.ground * worth, hiding=prospect.hiding * worth)


@dataclass(frozen=True, eq=False)
class Held:
    """A situation, and what the offline planner thinks of it."""

    occupancy: OccupancyMap
    observation: Observation
    pilot: Uneven
    thought: Thought

    @property
    def prospect(self) -> Prospect:
        return self.pilot.prospect(self.thought.expected, self.thought.situation)

    @property
    def views(self) -> Viewpoints:
        return self.pilot.planner.look_ahead.viewpoints(self.prospect, self.thought.travel)

    def places(self, plan: Plan | None) -> list[Place]:
        """Where the offline planner would do that."""
        return places(self.pilot, replace(self.thought, plan=plan))

    def closed(self, place: Place) -> set[tuple[float, float]]:
        """The middles of the regions that it closes."""
        return {self.thought.completion.regions[number - 1].centroid for number in place.closes}


@cache
def held(seed: int, solids: bool, turned: Turned = AS_IT_IS) -> Held:
    """A map made by hand, and the vehicle in its middle.

    A node is a corner of four cells, of which the guard asks the upper right one. So that all four say the
    same, the ground that can be crossed is a rectangle with its sides half a tile from the nodes, and so are
    boxes on it, wide and far apart.
    """
    rng = np.random.default_rng(seed)
    solid, target, explored, crossed = (np.zeros((SIDE, SIDE), np.bool_) for _ in range(4))
    low, high = 2 * rng.integers(3, 10, 2) + 1, SIDE - 1 - 2 * rng.integers(3, 10, 2)
    crossed[low[0] : high[0], low[1] : high[1]] = True
    for _ in range(8):
        (row, col), (deep, wide) = rng.integers(0, SIDE - 20, 2), rng.integers(10, 36, 2)
        explored[row : row + deep, col : col + wide] = True
    rows, cols = np.mgrid[:SIDE, :SIDE]
    for _ in range(4):
        row, col = rng.integers(8, SIDE - 8, 2)
        target |= np.hypot(rows - row, cols - col) < rng.uniform(2.0, 6.0)
    for _ in range(6 if solids else 0):
        (row, col), (deep, wide) = 12 * rng.integers(0, 8, 2) + 1, 2 * rng.integers(2, 4, 2)
        # Not where the vehicle is.
        solid[row : row + deep, col : col + wide] = not (36 <= row < 60 and 36 <= col < 60)
    occupancy = empty_map()
    seen = flags.EXPLORED * (explored | solid) + flags.CROSSED * crossed
    for name, cells in (
        ("log_odds", 20 * solid),
        ("flags", seen),
        ("votes", 0x30 * (target & explored & ~solid)),
    ):
        occupancy._write(name, (0, 0), turned.cells(cells))
    start = LATTICE.pose_at(LATTICE.node(0.0, 0.0), seed % HEADINGS)
    there = LATTICE.world(turned.pose(start))
    camera = np.random.default_rng(seed).integers(20, 200, (240, 320, 3)).astype(np.uint8)
    observation = replace(observed_at(there.x, there.y, there.yaw), rgb=camera)
    pilot = Uneven(Belief(), Mission(DREAM_V1, AREA, DREAM_V1.cap), Belief().look_ahead, turned=turned)
    return Held(occupancy, observation, pilot, pilot.consider(observation, occupancy))


def settled(situation: Held, plan: Plan | None, found: list[Place]) -> int:
    """How many of the places come before the first choice between two that are equally good.

    On the way each is checked to be the best view that is far enough from those before it.
    """
    views = situation.views
    at, rates = views.positions, views.rates
    taken = [LATTICE.position(pose) for pose in ([] if plan is None else plan.path)]
    for k, place in enumerate(found):
        if plan is not None and k == 0:
            continue
        free = np.ones(len(at), np.bool_)
        for other in taken:
            free &= np.hypot(*(at - other).T) >= APART * DREAM_V1.reach
        best = np.argwhere(free[:, None] & (rates >= rates[free].max() - TIE))
        if len(best) > 1:
            return k
        node, heading = best[0]
        assert place.pose == LATTICE.pose_at(views.nodes[node], int(heading))
        taken.append(at[node])
    return len(found)


def _rates(situation: Held, turned: Turned) -> dict[Pose, float]:
    """Of every view, by where the turn takes its pose."""
    views = situation.views
    return {
        turned.pose(LATTICE.pose_at(node, heading)): rate
        for node, rates in zip(views.nodes.tolist(), views.rates.tolist(), strict=True)
        for heading, rate in enumerate(rates)
    }


TURNED = [(seed, True, turned) for seed in SEEDS for turned in QUARTERS]
"""Seed, whether something stands there, and how it is turned."""
# Rays lie between the bearings to which tiles are taken: those on a diagonal fall to the one on the left, in
# the mirror too. So what boxes hide is no mirror image.
IN_THE_MIRROR = [(seed, False, turned) for seed in SEEDS for turned in MIRRORED]


@pytest.mark.few(4)
@pytest.mark.parametrize(("seed", "solids", "turned"), TURNED + IN_THE_MIRROR)
def test_steps_and_views_turn_with_the_world(seed: int, solids: bool, turned: Turned) -> None:
    first, other = held(seed, solids), held(seed, solids, turned)
    steps = first.thought.travel.steps
    poses = np.flatnonzero(steps >= 0)
    there = np.array([turned.pose(pose) for pose in poses.tolist()])
    assert len(poses) == np.count_nonzero(other.thought.travel.steps >= 0) > 1000
    np.testing.assert_array_equal(steps[poses], other.thought.travel.steps[there])
    rates, image = _rates(first, turned), _rates(other, AS_IT_IS)
    assert rates.keys() == image.keys()
    np.testing.assert_allclose([rates[pose] for pose in image], list(image.values()), atol=1e-5)


@pytest.mark.parametrize("ending", [False, True])
@pytest.mark.parametrize(("seed", "solids", "turned"), TURNED)
def test_the_places_turn_with_the_world(seed: int, solids: bool, turned: Turned, ending: bool) -> None:
    """Given where the offline planner would go: its search keeps one sequence for each two by two nodes,
    and these pairs, counted from the south-west, do not turn with the world."""
    first, other, plan, plan_there = _both(seed, solids, turned, ending)
    here, there = first.places(plan), other.places(plan_there)
    count = settled(first, plan, here)
    assert len(here) == len(there)
    assert count == settled(other, plan_there, there) >= 5
    for place, image in zip(here[:count], there[:count], strict=True):
        assert image.plan.path == [turned.pose(pose) for pose in place.plan.path]
        np.testing.assert_allclose(image.path, [turned.point(x, y) for x, y in place.path], atol=1e-9)
        assert math.remainder(image.yaw - LATTICE.world(image.pose).yaw, 2.0 * math.pi) == pytest.approx(0.0)
        assert _figures(image.plan) == pytest.approx(_figures(place.plan), abs=1e-3)
        assert image.loss == pytest.approx(place.loss, abs=1e-3)
        assert _rounded(other.closed(image)) == _rounded({turned.point(*at) for at in first.closed(place)})


@pytest.mark.parametrize("ending", [False, True])
@pytest.mark.parametrize(("seed", "solids", "turned"), IN_THE_MIRROR)
def test_the_places_are_mirrored_with_the_world(
    seed: int, solids: bool, turned: Turned, ending: bool
) -> None:
    """The ends and the steps; of several shortest ways there the first turn to the left is taken, and in the
    mirror again. The mirror image of a way is worth there what the way is worth here."""
    first, other, plan, plan_there = _both(seed, solids, turned, ending)
    here, there = first.places(plan), other.places(plan_there)
    count = settled(first, plan, here)
    assert count == settled(other, plan_there, there) >= 5
    assert [place.pose for place in there[:count]] == [turned.pose(place.pose) for place in here[:count]]
    assert [place.steps for place in there[:count]] == [place.steps for place in here[:count]]
    ways = [[turned.pose(pose) for pose in place.plan.path] for place in here]
    images = other.pilot.planner.look_ahead.judge(other.prospect, other.thought.travel, ways)
    for place, image in zip(here, images, strict=True):
        assert _figures(image.plan) == pytest.approx(_figures(place.plan), abs=1e-3)
        if plan is not None:
            assert max(images[0].value - image.value, 0.0) == pytest.approx(place.loss, abs=1e-3)


def _both(
    seed: int, solids: bool, turned: Turned, ending: bool
) -> tuple[Held, Held, Plan | None, Plan | None]:
    """The world and its image, and the same plan in both."""
    first, other = held(seed, solids), held(seed, solids, turned)
    plan = first.thought.plan
    assert plan is not None
    return first, other, None if ending else plan, None if ending else turned.plan(plan)


def _figures(plan: Plan) -> tuple[float, ...]:
    return plan.targets, plan.cleared, plan.patches, plan.rate, plan.later


def _rounded(points: set[tuple[float, float]]) -> set[tuple[float, float]]:
    return {(round(x, 6) + 0.0, round(y, 6) + 0.0) for x, y in points}


# ---------------------------------------------------------------------------------- what is read off the map


def _question(situation: Held, numbered: dict[int, Place]) -> Question[Ranking]:
    """As `RankedPilot` asks it."""
    mission, thought = situation.pilot.mission, situation.thought
    return ranking_question(mission, situation.observation, situation.occupancy, thought, [], numbered)


def _ranked(question: Question[Ranking]) -> dict[str, Any]:
    """What the stand-in answers, by the pictures."""
    reply: dict[str, Any] = rules.answer(request(question.reply, question.pictures, question.text))
    question.reply.model_validate(reply)
    return reply


@pytest.mark.rare
@pytest.mark.parametrize(("seed", "area"), [(0, None), (1, None), (2, Bounds(-6.0, -6.0, 6.0, 6.0))])
def test_at_the_end_every_place_is_feasible_and_so_it_is_where_a_part_is_to_be_seen(
    seed: int, area: Bounds | None
) -> None:
    first = held(seed, True)
    occupancy = first.occupancy.copy()
    occupancy.restrict(area)
    pilot = Uneven(Belief(), replace(first.pilot.mission, area=area), Belief().look_ahead)
    thought = pilot.consider(first.observation, occupancy)
    ending = Held(occupancy, first.observation, pilot, replace(thought, plan=None))
    question = _question(ending, dict(enumerate(ending.places(None), start=1)))
    assert "would be left unseen" in question.text
    pose = first.observation.pose
    sent = Sent(pose, occupancy, asked(request(question.reply, question.pictures, question.text)), None)
    assert len(sent.schema) >= 3
    _check_agreement(sent)
    assert _feasible(sent) == set(sent.schema)


@cache
def _read(
    seed: int, solids: bool, turned: Turned
) -> tuple[dict[str, Any], list[int], dict[int, tuple[int, int]]]:
    """The answer to the question about the settled places of the world as it is, turned.

    And its ranking, and where in the camera's picture each is, both by the places' order instead of numbers:
    those are others each time.
    """
    first = held(seed, solids)
    plan = first.thought.plan
    found = first.places(plan)
    found = found[: settled(first, plan, found)]
    rng = np.random.default_rng([seed, turned.quarters, turned.mirrored])
    numbers = (1 + rng.permutation(len(found))).tolist()
    images = [
        replace(
            place,
            plan=turned.plan(place.plan),
            path=np.array([turned.point(x, y) for x, y in place.path]),
            yaw=LATTICE.world(turned.pose(place.pose)).yaw,
        )
        for place in found
    ]
    question = _question(held(seed, solids, turned), dict(zip(numbers, images, strict=True)))
    reply = _ranked(question)
    discs = read_marks(sight.decode(question.pictures["camera"], "camera"), "camera")
    in_view = {numbers.index(disc.number): (disc.column, disc.row) for disc in discs}
    return reply, [numbers.index(number) for number in reply["ranking"]], in_view


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("seed", "solids", "turned"), [*TURNED[::4], (0, False, MIRRORED[0]), (1, False, MIRRORED[1])]
)
def test_the_stand_ins_ranking_turns_with_the_world(seed: int, solids: bool, turned: Turned) -> None:
    """But for the order of places of almost the same worth: it guesses the cells under discs and arrow."""
    reply, order, in_view = _read(seed, solids, AS_IT_IS)
    image, order_there, in_view_there = _read(seed, solids, turned)
    assert order_there == order
    assert len(order) >= 5
    assert image["confidence"] == pytest.approx(reply["confidence"], abs=0.02)
    assert image["mission_complete"] == reply["mission_complete"]
    if not turned.mirrored:
        # The camera turns with the vehicle.
        assert in_view_there == in_view
