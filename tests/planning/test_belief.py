"""The default planner in worlds and on maps made by hand: where it goes, when it stops, what it says."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.control import guard, setpoint
from dream.evaluation.runner import simulate
from dream.geometry import SE2, Bounds
from dream.learning.rollouts import Colourless
from dream.mapping import (
    OccupancyMap,
    check_completion,
    could_hide,
    hiding_places,
    reachable,
    view,
    visible_weight,
)
from dream.mapping.hull import PATCH, Hull
from dream.mapping.prior import Prior
from dream.planning import Belief, sentences
from dream.planning.belief import BeliefPilot, Thought
from dream.planning.distribution import GLIMPSED, OBSERVED, Groups, expectation
from dream.planning.failed_views import GIVEN_UP
from dream.planning.lookahead import LookAhead, Plan, Prospect
from dream.planning.sources import HintedTargets, HullSurface
from dream.planning.sources.source import MOST_VISITS
from dream.planning.travel import careful_travel, nearest_open
from dream.protocol import DREAM_V1, protocol_named
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import BoolArray, Decision, Mission, Observation, Step
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import SIDE, all_but, observed_at, situation_of, source_of
from tests.sim.arenas import FLOOR, arena, placed

MISSION = Mission(DREAM_V1, AREA, DREAM_V1.cap)
SLIT = np.s_[70:72, 20:22]
"""Four cells that no observation ever shows."""
WITHHELD = np.s_[30:60, 60:90]
"""A box that no observation ever shows."""
NOTHING = np.zeros((SIDE, SIDE), np.bool_)


# -------------------------------------------------------------------------------------------------- worlds


def _ring(x: float, y: float, radius: float, count: int) -> list[tuple[float, float, float]]:
    angles = 2.0 * math.pi / count * np.arange(count)
    return [(x + radius * math.cos(a), y + radius * math.sin(a), FLOOR) for a in angles]


def _clumps(x: float, y: float, spread: float, count: int) -> list[tuple[float, float, float]]:
    places = np.random.default_rng(0).normal((x, y), spread, (count, 2))
    return [(float(east), float(north), FLOOR) for east, north in places]


SHELLS, BLOCK = (0.3, 0.3, 0.15), (1.2, 1.2, 4.0)
REEF = arena(
    placed(0, [(5.0, 3.0, FLOOR), (-6.0, -2.0, FLOOR)], (1.5, 1.5, 3.0)),
    placed(0, _clumps(5.0, -4.0, 1.2, 40), SHELLS),
)
WRECK = replace(
    arena(targets=placed(0, [(5.0, 0.0, FLOOR)], (2.0, 4.0, 2.2))),
    hull=np.ones(1, np.bool_),
    starts=(SE2(-6.0, 0.0, 0.0),),
)
WORLDS = {
    "empty": replace(arena(), bounds=Bounds(-8.0, -8.0, 8.0, 8.0)),
    "walled in": arena(placed(0, _ring(0.0, 0.0, 4.0, 27), BLOCK)),
    "out of reach": arena(
        placed(0, _ring(6.0, 0.0, 3.0, 11), BLOCK), placed(0, _clumps(6.0, 0.0, 0.5, 9), SHELLS)
    ),
    "reef": REEF,
    "wreck": WRECK,
}


@dataclass
class Flown:
    """A mission, and what its pilot was given before each decision."""

    planner: Belief
    steps: list[Step] = field(default_factory=list)
    asked: list[tuple[Observation, OccupancyMap, Decision]] = field(default_factory=list)
    pilots: list[BeliefPilot] = field(default_factory=list)

    def begin(self, mission: Mission) -> Flown:
        self.pilots.append(self.planner.in_plane(mission))
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        decision = self.pilots[-1].decide(observation, occupancy)
        self.asked.append((observation, occupancy.copy(), decision))
        return decision

    @property
    def last(self) -> Step:
        return self.steps[-1]


def _fly(world: World, planner: Belief | None = None, max_steps: int | None = None) -> Flown:
    flown = Flown(planner or Belief())
    # Nobody here looks at colours.
    flown.steps = list(simulate(world, flown, DREAM_V1, max_steps=max_steps, renderer=Colourless(world)))
    return flown


AWAY = SE2(-8.0, 7.0, 0.0)
"""From there it does not see all of the reef at once."""


@cache
def _mission(name: str, start: SE2 | None = None) -> Flown:
    """In one of the worlds, with the default parameters, from the world's start unless told; flown once."""
    return _fly(WORLDS[name] if start is None else replace(WORLDS[name], starts=(start,)))


@pytest.fixture(scope="module", params=list(WORLDS))
def flown(request: pytest.FixtureRequest) -> Flown:
    return _mission(request.param)


@pytest.fixture(scope="module")
def over_the_reef() -> Flown:
    return _mission("reef", AWAY)


# ------------------------------------------------------------------------------------------------ missions


@pytest.mark.few(3)
def test_a_mission_ends_by_itself_and_says_why(flown: Flown) -> None:
    assert flown.last.ended == "done"
    assert flown.last.index < DREAM_V1.cap
    why = flown.last.decision.reasoning
    assert "done" in why.action
    risk, accepted, *hull = map(float, re.findall(r"([\d.]+)%", why.completion))
    assert risk <= accepted == 0.2
    if hull:
        expected, enough = hull
        assert expected <= enough
    assert not why.next_target, "there is none"


def test_it_never_touches_anything_and_the_guard_has_nothing_to_change(flown: Flown) -> None:
    assert not any(step.arrival.collided for step in flown.steps)
    assert not any(step.guarded.note for step in flown.steps)


def test_it_never_stands_still_but_to_be_done(flown: Flown) -> None:
    assert not any(decision.stops and not decision.done for _, _, decision in flown.asked)


def test_the_same_world_gets_the_same_decisions_word_for_word() -> None:
    first, second = (
        [decision for *_, decision in flown.asked]
        for flown in (_mission("out of reach"), _fly(WORLDS["out of reach"], max_steps=25))
    )
    assert first[: len(second)] == second
    assert len(second) > 10


def test_where_there_is_nothing_all_ground_is_seen_before_it_ends() -> None:
    flown = _mission("empty")
    assert flown.last.occupancy.observed.all()
    assert check_completion(flown.last.occupancy, flown.last.observation.pose).complete
    assert "No target has been seen" in flown.last.decision.reasoning.distribution


@pytest.mark.slow
@pytest.mark.rare
def test_an_empty_world_of_full_size_is_seen_to_the_last_cell_within_the_cap() -> None:
    world = make_world("flat/empty", 1)
    assert (world.bounds.width, world.bounds.depth) == (40.0, 40.0)
    *_, last = simulate(world, Belief(), DREAM_V1, renderer=Colourless(world))
    assert last.ended == "done"
    assert last.index < DREAM_V1.cap
    assert check_completion(last.occupancy, last.observation.pose).complete
    assert last.occupancy.observed.all()


def test_walled_in_it_ends_when_all_that_can_be_seen_from_inside_was_looked_at() -> None:
    flown = _mission("walled in")
    x, y = np.array([(p.observation.pose.x, p.observation.pose.y) for p in flown.steps]).T
    assert np.hypot(x, y).max() < 4.0, "it never left"
    assert "Nothing is left" in flown.last.decision.reasoning.action
    assert flown.last.occupancy.observed.mean() < 0.3


def test_targets_that_it_sees_but_cannot_get_to_do_not_hold_it() -> None:
    flown = _mission("out of reach")
    occupancy, pose = flown.last.occupancy, flown.last.observation.pose
    row, col = np.nonzero(occupancy.target)
    targets = np.stack(occupancy.center_of(row, col), axis=1)
    assert len(targets) >= 4
    away = np.hypot(*(targets[:, None] - reachable(occupancy, pose)[None]).transpose(2, 0, 1)).min()
    assert away > 1.0, "it cannot get there"
    assert not check_completion(occupancy, pose).open_region


# ------------------------------------------------------------------------------------------- maps that change


@dataclass
class Toy:
    """A vehicle on a map: a view shows what the map says that it shows."""

    pose: SE2
    explored: BoolArray
    solid: BoolArray = field(default_factory=NOTHING.copy)
    target: BoolArray = field(default_factory=NOTHING.copy)
    never: BoolArray = field(default_factory=NOTHING.copy)
    """Cells that no view shows, whatever the map says."""

    @property
    def map(self) -> OccupancyMap:
        return map_with(solid=self.solid, explored=self.explored | self.solid, target=self.target)

    def step(self, pilot: BeliefPilot) -> Decision:
        """Decide, let the guard look at it, go there and look."""
        occupancy, here = self.map, self.pose
        self.explored = self.explored | (view(occupancy, here.x, here.y, here.yaw) & ~self.never)
        occupancy = self.map
        decision = pilot.decide(observed_at(here.x, here.y, here.yaw), occupancy)
        assert not guard(decision, here, occupancy, DREAM_V1).note
        end = setpoint(here, decision, DREAM_V1)
        self.pose = DREAM_V1.snap(SE2(end.x, end.y, end.yaw))
        return decision

    def fly(self, pilot: BeliefPilot, change: Callable[[int], None], most: int) -> int:
        """Steps until it is done; `change` may change the map before each."""
        for step in range(most):
            change(step)
            if self.step(pilot).done:
                return step
        raise AssertionError(f"not done after {most} steps")


def _half_known() -> BoolArray:
    return all_but(np.s_[:, 56:])


def test_ground_that_becomes_solid_under_way_is_gone_round() -> None:
    toy = Toy(SE2(-6.0, 0.0, 0.0), _half_known())

    def change(step: int) -> None:
        if step == 3:
            toy.solid[20:76, 60:62] = True  # Across the way east.
            x, y = toy.pose.x, toy.pose.y
            row, col = toy.map.cell_of(x, y)
            assert not toy.solid[row - 4 : row + 5, col - 4 : col + 5].any()
        if step == 12:
            toy.solid[:20, 60:62] = True
        if step == 20:
            toy.solid[:] = False
            toy.solid[60:64, 20:40] = True

    steps = toy.fly(Belief().in_plane(MISSION), change, 120)
    assert steps > 12
    assert toy.explored[40:56, 70:90].all(), "it saw what lay behind"


def test_a_false_target_is_looked_round_and_forgotten_when_it_goes() -> None:
    toy = Toy(SE2(-6.0, 0.0, 0.0), _half_known())

    def change(step: int) -> None:
        toy.target[46:49, 54:56] = 4 <= step < 12

    steps = toy.fly(Belief(certify=True).in_plane(MISSION), change, 120)
    assert steps > 12
    assert not check_completion(toy.map, toy.pose).open_region


def test_new_ground_after_done_is_looked_at() -> None:
    toy = Toy(SE2(-6.0, 0.0, 0.0), all_but())
    pilot = Belief().in_plane(MISSION)
    assert toy.step(pilot).done
    toy.explored = _half_known()
    decision = toy.step(pilot)
    assert not decision.done
    toy.fly(pilot, lambda _: None, 120)
    assert toy.explored.all()


# ---------------------------------------------------------------------------------------- refusals, watchdog


@pytest.mark.parametrize("sway", [0.0, 0.03])
def test_a_refused_done_raises_its_patience_and_only_that_does(sway: float) -> None:
    """Also where the vehicle swims, so that it stays only about where it was."""
    pilot = Belief().in_plane(MISSION)
    before = pilot.failed.patience
    complete = map_with(explored=all_but())
    for refused in range(4):
        observation = observed_at(3.0 + sway * (refused % 2), -4.0, sway)
        assert pilot.decide(observation, complete).done
        assert pilot.failed.patience == before + refused
    assert not pilot.decide(observation, map_with(explored=_half_known())).done
    assert pilot.failed.patience == before + 4
    pilot.decide(observation, map_with(explored=_half_known()))
    assert pilot.failed.patience == before + 4


@pytest.mark.rare
def test_ground_that_never_shows_is_given_up_then_tried_again_when_refused() -> None:
    never = ~all_but(SLIT)
    toy = Toy(SE2(-3.0, 2.0, 0.0), ~never, never=never)
    pilot = Belief().in_plane(MISSION)
    claims = [toy.step(pilot).done for _ in range(30)]
    assert not claims[0], "the map promises that the slit can be seen"
    first = claims.index(True)
    assert not all(claims[first:]), "once refused it looks again"
    assert sum(claims) >= 2, "and gives up again"


def _visited_in_vain(planner: Belief, most: int) -> tuple[bool, int]:
    """With a box that never shows: is it done within so many steps, and how often was it at one pose?"""
    toy = Toy(SE2(-3.0, 2.0, 0.0), all_but(WITHHELD), never=~all_but(WITHHELD))
    pilot, visits = planner.in_plane(MISSION), Counter[SE2]()
    for _ in range(most):
        visits[toy.pose] += 1
        if toy.step(pilot).done:
            return True, max(visits.values())
    return False, max(visits.values())


def test_ground_that_never_shows_brings_it_to_no_pose_more_often_than_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _visited_in_vain(Belief(), 40) == (True, MOST_VISITS)
    monkeypatch.setattr(BeliefPilot, "_visits", lambda *_: 1)
    done, visits = _visited_in_vain(Belief(), 40)
    assert not done
    assert visits > 2 * MOST_VISITS, "nothing else stops it"


@pytest.mark.rare
def test_what_only_the_map_still_promises_brings_it_to_no_pose_more_often_than_twice_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As where the look-ahead has nothing to go for, and no number of looks in vain is enough."""
    monkeypatch.setattr(LookAhead, "plan", lambda *_: None)
    assert _visited_in_vain(Belief(patience=100), 60) == (True, 2 * MOST_VISITS)
    monkeypatch.setattr(BeliefPilot, "_visits", lambda *_: 1)
    done, visits = _visited_in_vain(Belief(patience=100), 60)
    assert not done
    assert visits > 3 * MOST_VISITS


@pytest.mark.parametrize("patience", [Belief().patience, 100])
def test_it_says_how_much_ground_it_gave_up_and_counts_for_searched(patience: int) -> None:
    """Looked at in vain often enough; or, where no number of looks is, given up with what it headed for."""
    toy = Toy(SE2(-3.0, 2.0, 0.0), all_but(WITHHELD), never=~all_but(WITHHELD))
    pilot = Belief(patience=patience).in_plane(MISSION)
    areas = []
    for _ in range(40):
        dropped = np.count_nonzero(pilot.failed.count >= GIVEN_UP)
        decision = toy.step(pilot)
        area = DREAM_V1.cell**2 * np.count_nonzero(~toy.map.observed & (pilot.failed.count >= patience))
        said = re.search(r"accepted\. (\S+) m² that never came into view", decision.reasoning.completion)
        if np.count_nonzero(pilot.failed.count >= GIVEN_UP) == dropped:
            # What is dropped after that was said is told in the next step.
            assert (said is not None) == (area > 0.0)
            if said:
                assert float(said[1]) == pytest.approx(area, abs=0.051)
                areas.append(area)
        if decision.done:
            break
    assert decision.done
    assert (len(set(areas)) > 2) == (patience == 3)
    assert f"; {area:.1f} m² that never came into view were given up: done" in decision.reasoning.action
    assert area == DREAM_V1.cell**2 * NOTHING[WITHHELD].size


def test_neither_ground_outside_the_area_nor_what_was_seen_is_among_what_it_gave_up() -> None:
    occupancy = map_with(explored=_half_known())
    occupancy.restrict(Bounds(-12.0, -12.0, 12.0, -4.0))
    pilot, observation = Belief().in_plane(MISSION), observed_at(-6.0, -6.0, math.pi)
    assert "given up" not in pilot.decide(observation, occupancy).reasoning.completion
    assert occupancy.observed[:32, 48:56].all()
    pilot.failed.count[:, 48:72] = pilot.failed.patience
    said = pilot.decide(observation, occupancy).reasoning.completion
    assert said.endswith(" 32.0 m² that never came into view were given up and are not counted.")


@pytest.mark.parametrize(
    "name",
    [
        "empty",
        "reef",
        "wreck",
    ],
)
def test_asked_the_same_for_ever_it_does_not_answer_the_same_for_ever(name: str) -> None:
    """As when the vehicle does not move, whatever it is told."""
    planner, world = Belief(), replace(WORLDS[name], starts=(SE2(-5.0, 5.0, 0.0),))
    *_, last = simulate(world, planner, DREAM_V1, max_steps=5, renderer=Colourless(world))
    pilot = planner.in_plane(Mission(DREAM_V1, world.bounds, DREAM_V1.cap))
    aims: Counter[str] = Counter()
    for _ in range(40):
        decision = pilot.decide(last.observation, last.occupancy)
        if decision.done:
            return
        aims[decision.reasoning.next_target.split(", and may show")[0]] += 1
    assert max(aims.values()) <= 4 * MOST_VISITS, "its aim changes again and again"


def test_what_it_gives_up_of_a_hull_is_not_hoped_for_again_from_there() -> None:
    flown = _fly(WRECK, max_steps=16)
    pilot, (observation, occupancy, _) = flown.pilots[-1], flown.asked[-1]
    situation, source = situation_of(pilot, observation, occupancy), source_of(pilot, HullSurface)
    assert source is not None
    expected = pilot.expect(situation)

    def shown() -> tuple[list[int], list[int]]:
        listed = source.listed(expected, situation)
        assert listed is not None
        return listed.nodes.tolist(), np.diff(listed.starts).tolist()

    nodes, before = shown()
    most = int(np.argmax(before))
    node, heading = divmod(most, DREAM_V1.headings)
    lattice = situation.travel.lattice
    pose = lattice.pose_at(nodes[node], heading)
    pilot._give_up(Plan([pose, pose], rate=1.0, later=0.0), occupancy)
    again, after = shown()
    assert again == nodes
    assert before[most] > 0
    assert after[most] == 0
    assert all(later <= earlier for earlier, later in zip(before, after, strict=True))
    # Two places on one side of an element, 22.5° by a quarter of the reach, lie nearer together.
    positions = lattice.positions[nodes]
    apart = np.hypot(*(positions - positions[node]).T) > 4.0
    others = [k for k in range(len(before)) if apart[k // DREAM_V1.headings]]
    assert sum(before[k] for k in others) > 100
    assert [after[k] for k in others] == [before[k] for k in others], "from elsewhere it may show"


# ------------------------------------------------------------------------------------------ certify, risk


def _could_still_be_seen(step: Step) -> float:
    """Cells not observed that the best view of any pose within reach would show."""
    unobserved = (~step.occupancy.observed).astype(np.float32)
    places = reachable(step.occupancy, step.observation.pose)
    return float(visible_weight(step.occupancy, places, unobserved).max(initial=0.0))


def test_certify_ends_an_empty_world_only_when_nothing_is_left_to_see() -> None:
    flown = _fly(WORLDS["empty"], Belief(certify=True))
    assert flown.last.ended == "done"
    assert _could_still_be_seen(flown.last) == 0.0


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("start", [AWAY, *REEF.starts])
def test_certify_sees_all_that_the_default_leaves(start: SE2) -> None:
    by_default = _mission("reef", None if start in REEF.starts else start)
    certified = _fly(replace(REEF, starts=(start,)), Belief(certify=True))
    assert certified.last.ended == "done"
    assert certified.last.index < DREAM_V1.cap
    assert not any(step.arrival.collided for step in certified.steps)
    last, before = certified.last, by_default.last.occupancy.observed
    assert last.occupancy.observed.sum() >= before.sum()
    assert last.occupancy.observed.mean() > 0.98
    # What the map still promises was looked at in vain.
    pilot = certified.pilots[-1]
    for x, y in reachable(last.occupancy, last.observation.pose)[::7]:
        for heading in range(DREAM_V1.headings):
            promised = view(last.occupancy, x, y, heading * DREAM_V1.heading_step) & ~last.occupancy.observed
            assert (pilot.failed.count[promised] >= Belief().patience).all()


def _with_a_reef(*unknown: tuple[slice, slice]) -> OccupancyMap:
    """All is explored but some boxes, with an enclosed region of targets in the west."""
    target = NOTHING.copy()
    target[60:64, 8:12] = True
    return map_with(explored=all_but(*unknown), target=target)


def test_certify_says_what_is_left_to_see_and_no_probability() -> None:
    observation = observed_at(3.0, -4.0, 0.0)
    said = Belief(certify=True).in_plane(MISSION).decide(observation, _with_a_reef(SLIT)).reasoning.completion
    assert f"{NOTHING[SLIT].size * DREAM_V1.cell**2:.1f} m² that can be seen were not yet" in said
    assert "probability" not in said


def test_in_a_narrow_arena_it_does_not_end_beside_the_first_group() -> None:
    """Narrower than the groups that it searches for are wide."""
    shells = placed(0, _clumps(0.0, -16.0, 0.8, 20), SHELLS)
    start = SE2(0.0, -12.0, math.pi / 2)
    world = replace(arena(targets=shells), bounds=Bounds(-3.0, -20.0, 3.0, 20.0), starts=(start,))
    flown = _fly(world, Belief(glimpse=1.0))
    assert flown.last.ended == "done"
    assert flown.last.occupancy.observed.mean() > 0.7
    early = flown.asked[1][2].reasoning.completion
    assert "with a probability of 0.0%" not in early


def test_certify_is_not_done_while_a_single_cell_can_be_seen() -> None:
    observation = observed_at(3.0, -4.0, 0.0)
    for unknown, by_default, certified in (((SLIT,), True, False), ((), True, True)):
        occupancy = _with_a_reef(*unknown)
        assert check_completion(occupancy, observation.pose).complete
        for planner, done in ((Belief(), by_default), (Belief(certify=True), certified)):
            assert planner.in_plane(MISSION).decide(observation, occupancy).done == done


def _behind_a_wall() -> OccupancyMap:
    """The same reef, and a wall across the arena east of which nothing is known."""
    reef, solid = _with_a_reef(), NOTHING.copy()
    solid[:, 40:42] = True
    return map_with(solid=solid, explored=all_but(np.s_[:, 41:]), target=reef.target)


def test_ground_that_cannot_be_seen_is_no_risk() -> None:
    observation = observed_at(-6.0, -4.0, 0.0)
    decision = Belief(risk=0.0).in_plane(MISSION).decide(observation, _behind_a_wall())
    assert could_hide(_behind_a_wall(), Belief().size, NOTHING).sum() > 1000
    assert decision.done
    assert "with a probability below 0.01%; up to 0.00% is accepted" in decision.reasoning.completion
    assert "and no further patch in ground not searched" in decision.reasoning.distribution


def test_hints_that_no_place_can_see_do_not_keep_it_going() -> None:
    observation = observed_at(-6.0, -4.0, 0.0)
    for beyond, done in ((np.s_[:, 50:70, 60:80], True), (np.s_[:, 50:70, 20:30], False)):
        pilot = Belief(risk=0.5).in_plane(MISSION)
        source = source_of(pilot, HintedTargets)
        assert source is not None
        source.hints._pixels[beyond] = 10
        unseen = map_with(
            solid=_behind_a_wall().solid,
            explored=_behind_a_wall().explored & all_but(beyond[1:]),
            target=_behind_a_wall().target,
        )
        assert pilot.decide(observation, unseen).done == done


def test_the_risk_knows_what_was_glimpsed(over_the_reef: Flown) -> None:
    planner, less = over_the_reef.planner, 0
    size, square = planner.size * DREAM_V1.group_radius, DREAM_V1.cell**2
    for observation, occupancy, _ in over_the_reef.asked[::3]:
        pilot = planner.in_plane(MISSION)
        said = pilot.decide(observation, occupancy).reasoning.completion
        completion = check_completion(occupancy, observation.pose)
        hiding = could_hide(occupancy, size, NOTHING)
        if completion.complete:
            hiding &= hiding_places(occupancy, observation.pose, size)
        source = source_of(pilot, HintedTargets)
        assert source is not None
        evidence = source.hints.evidence(occupancy)
        hidden = float(evidence.unnoticed(size, DREAM_V1.cell)[hiding].sum()) * square
        groups = Groups(planner.groups, planner.searched)
        groups = groups.after(len(completion.regions), AREA.width * AREA.depth - hidden)
        assert f"with a probability of {GLIMPSED.calibrated(groups.risk(hidden)):.2%};" in said
        less += hidden < hiding.sum() * square
    assert less


def test_in_a_tank_and_with_a_survey_no_hints_are_taken() -> None:
    tank = Mission(protocol_named("pool-v1"), Bounds(-3.0, -3.0, 3.0, 3.0), 100)
    told = np.zeros((SIDE, SIDE), np.float32)
    survey = replace(MISSION, prior=Prior(AREA, DREAM_V1.cell, told, NOTHING, years=1.0))
    for mission in (tank, survey):
        pilot = Belief().in_plane(mission)
        assert source_of(pilot, HintedTargets) is None
        empty = OccupancyMap(mission.bounds, mission.protocol)
        assert pilot.expect(situation_of(pilot, observed_at(0.0, 0.0, 0.0), empty)).calibration is OBSERVED


def test_while_a_region_is_open_no_group_is_expected_farther_than_any_view_reaches() -> None:
    occupancy, observation = _behind_a_wall(), observed_at(-6.0, -4.0, 0.0)
    explored = occupancy.explored.copy()
    explored[58:66, 4:7] = False
    opened = map_with(solid=occupancy.solid, explored=explored, target=occupancy.target)
    assert not check_completion(opened, observation.pose).complete
    planner = Belief()
    said = planner.in_plane(MISSION).decide(observation, opened).reasoning.distribution
    match = re.search(r"and (\S+) patches on average", said)
    assert match
    everywhere = could_hide(opened, planner.size, NOTHING).sum() * DREAM_V1.cell**2
    most = Groups(planner.groups, planner.searched).after(1, AREA.width * AREA.depth).intensity * everywhere
    assert float(match[1]) < 0.3 * most


def test_ground_looked_at_in_vain_often_enough_is_no_risk() -> None:
    pilot, observation = Belief(risk=0.0).in_plane(MISSION), observed_at(-6.0, 0.0, 0.0)
    occupancy = map_with(explored=_half_known())
    assert not pilot.decide(observation, occupancy).done
    pilot.failed.count[~occupancy.observed] = pilot.failed.patience + 2
    decision = pilot.decide(observation, occupancy)
    assert "with a probability below 0.01%;" in decision.reasoning.completion
    assert decision.done


@pytest.mark.rare
def test_who_is_done_at_some_risk_is_done_at_any_greater_one() -> None:
    risks = (0.0, 0.002, 0.01, 0.05, 0.2, 0.5, 1.0)
    verdicts = []
    for observation, occupancy, _ in _fly(REEF, Belief(risk=0.0)).asked[::4]:
        done = [Belief(risk=risk).in_plane(MISSION).decide(observation, occupancy).done for risk in risks]
        assert done == sorted(done), "never done at a risk and not at a greater one"
        verdicts += done
    assert any(verdicts)
    assert not all(verdicts)


def test_a_smaller_risk_sees_at_least_as_much() -> None:
    world = replace(REEF, starts=(AWAY,))
    careless, usual, careful = (_fly(world, Belief(risk=risk)).last for risk in (1.0, 0.002, 0.0))
    assert careless.index <= usual.index <= careful.index
    assert careless.occupancy.observed.sum() < careful.occupancy.observed.sum()


# -------------------------------------------------------------------------------------------------- hulls


@pytest.mark.parametrize("wrong", [{"width": 1.5}, {"horizon": 2.5}, {"patience": 0}, {"size": 0.0}])
def test_a_parameter_that_makes_no_sense_is_named(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=f"^{name}: expected .*, got {wrong[name]:g}"):
        Belief(**wrong)


def _hull(pilot: BeliefPilot) -> Hull:
    source = source_of(pilot, HullSurface)
    assert source is not None
    return source.hull


def test_on_a_reef_no_hull_is_believed_in(over_the_reef: Flown) -> None:
    (pilot,) = over_the_reef.pilots
    occupancy = over_the_reef.last.occupancy
    assert occupancy.target.any()
    assert not (occupancy.target & occupancy.solid).any()
    assert not pilot.expect(situation_of(pilot, over_the_reef.last.observation, occupancy)).hull.any()


@pytest.mark.rare
def test_on_a_wreck_what_is_left_of_the_hull_keeps_it_going() -> None:
    thorough, hasty = (_fly(WRECK, Belief(hull_left=left)) for left in (0.0, 1.0))
    assert thorough.last.index > hasty.last.index
    assert _hull(thorough.pilots[-1]).found > _hull(hasty.pilots[-1]).found > 0.0
    assert thorough.last.ended == hasty.last.ended == "done"


def test_with_all_else_seen_it_goes_to_the_side_of_a_hull_that_it_has_not_seen() -> None:
    """A crate of target seen from the west; the ground round it is known, its other sides are not."""
    first = _fly(WRECK, max_steps=6)
    observation, occupancy, _ = first.asked[-1]
    explored = np.ones((SIDE, SIDE), np.bool_)
    known = map_with(solid=occupancy.solid, explored=explored, target=occupancy.target)
    pilot = first.pilots[-1]
    assert check_completion(known, observation.pose).complete
    left = _hull(pilot).middles[pilot.expect(situation_of(pilot, observation, known)).hull > 0.0]
    assert len(left)
    decision = pilot.decide(observation, known)
    assert not decision.done
    (patches,) = _numbers(r"(\S+) pieces of hull", decision)
    assert 0.0 < patches <= _hull(pilot).unseen + 0.05  # As it is rounded.
    unbelieving = Belief(hull_left=1.0).in_plane(MISSION)
    assert unbelieving.decide(observation, known).done


# ------------------------------------------------------------------------------------------------ sentences


def _numbers(pattern: str, decision: Decision) -> list[float]:
    """Numbers of the sentence about the next target."""
    match = re.search(pattern, decision.reasoning.next_target)
    assert match, decision.reasoning.next_target
    return [float(group) for group in match.groups()]


def test_it_says_how_much_is_explored_and_how_much_of_it_is_target(flown: Flown) -> None:
    for _, occupancy, decision in flown.asked:
        said = decision.reasoning.distribution
        assert f"{occupancy.explored.mean():.0%} of the area is explored" in said
        area = re.search(r"Targets cover (\S+) m²", said)
        assert (area is not None) == bool(occupancy.target.any())
        if area:
            assert float(area[1]) == pytest.approx(occupancy.target.sum() * DREAM_V1.cell**2, abs=0.051)


def test_it_says_which_regions_are_enclosed_and_which_is_worked_on(flown: Flown) -> None:
    worked_on = 0
    for observation, occupancy, decision in flown.asked[::3]:
        completion = check_completion(occupancy, observation.pose)
        closed = sum(region.enclosed for region in completion.regions)
        said = decision.reasoning
        count = len(completion.regions)
        known = {
            0: "No region of targets is known",
            1: f"The one region of targets is {'' if closed else 'not yet '}enclosed",
        }
        some = f"{'All' if closed == count else f'{closed} of'} {count} regions of targets are enclosed"
        assert said.completion.startswith(known.get(count, some))
        match = re.search(r"around \((\S+), (\S+)\), with (\d+) unknown cell", said.target_area)
        assert (match is None) == completion.complete or not completion.regions
        if match:
            region = nearest_open(completion, careful_travel(observation.pose, occupancy), occupancy)
            assert region is not None
            assert int(match[3]) == len(region.open_cells)
            assert (float(match[1]), float(match[2])) == pytest.approx(region.centroid, abs=0.051)
            worked_on += 1
    assert worked_on or not flown.last.occupancy.target.any() or len(flown.asked) < 6


def test_it_says_what_it_expects_beside_targets() -> None:
    planner, some = Belief(glimpse=1.0), 0
    evidence = planner.kernel * DREAM_V1.group_radius
    for observation, occupancy, decision in _fly(REEF, planner).asked[::2]:
        match = re.search(r"Still expected: (\S+) m² of targets beside", decision.reasoning.distribution)
        assert match
        regions = check_completion(occupancy, observation.pose).regions
        expected = np.zeros(occupancy.shape)
        if regions:
            everywhere = ~occupancy.observed
            expected += expectation(occupancy, evidence, planner.prior, planner.prior_weight, everywhere)
            targets = np.argwhere(occupancy.target)
            for row, col in np.argwhere(expected > 0.0):
                if np.hypot(*(targets - (row, col)).T).min() * DREAM_V1.cell > 2.0 * evidence:
                    expected[row, col] = 0.0
            for row, col in np.concatenate([region.open_cells for region in regions]):
                far = np.hypot(*(targets - (row, col)).T).min() * DREAM_V1.cell > 2.0 * evidence
                expected[row, col] = max(expected[row, col], planner.search if far else planner.open_edge)
        assert float(match[1]) == pytest.approx(expected.sum() * DREAM_V1.cell**2, abs=0.051)
        some += float(match[1]) > 0.0
    assert some


def test_it_says_the_risk_and_the_groups_that_its_model_gives(over_the_reef: Flown) -> None:
    """Asked afresh, with nothing looked at in vain; every place in this arena may come into view."""
    planner, risks = Belief(glimpse=1.0), set()
    prior = Groups(planner.groups, planner.searched)
    for observation, occupancy, _ in over_the_reef.asked[::3]:
        said = planner.in_plane(MISSION).decide(observation, occupancy).reasoning
        completion = check_completion(occupancy, observation.pose)
        hiding = could_hide(occupancy, planner.size * DREAM_V1.group_radius, NOTHING)
        if completion.complete:
            hiding &= hiding_places(occupancy, observation.pose, planner.size * DREAM_V1.group_radius)
        hidden, whole = hiding.sum() * DREAM_V1.cell**2, AREA.width * AREA.depth
        groups = prior.after(len(completion.regions), whole - hidden)
        risk = OBSERVED.calibrated(groups.risk(hidden))
        assert f"with a probability of {risk:.2%}; up to {planner.risk:.2%} is accepted" in said.completion
        expected = groups.intensity * hidden
        told = f"{expected:.2f} patches on average" if expected >= 0.005 else "no further patch"
        assert f"and {told} in ground not searched" in said.distribution
        risks.add(round(risk, 2))
    assert len(risks) > 2


def test_it_says_what_it_expects_of_a_hull_and_what_it_would_accept(over_the_reef: Flown) -> None:
    flown = _fly(WRECK, max_steps=12)
    pilot, (observation, occupancy, decision) = flown.pilots[-1], flown.asked[-1]
    expected = pilot.expect(situation_of(pilot, observation, occupancy))
    area, share = PATCH**2 * float(expected.hull.sum()), expected.hull_left
    assert not decision.done
    assert share > 0.005
    sentence = f" Of the hull {area:.1f} m² more are to be expected, {share:.1%} of it; 0.5% is accepted."
    assert decision.reasoning.completion.endswith(sentence)
    certified = Belief(certify=True).in_plane(MISSION).decide(observation, occupancy).reasoning.completion
    assert "0.5% is accepted" in certified
    assert not any("hull" in decision.reasoning.completion for _, _, decision in over_the_reef.asked)


def test_it_says_how_many_steps_lead_where_and_what_they_show() -> None:
    travel = careful_travel(SE2(-3.0, 2.0, 0.0), map_with(explored=all_but()))
    there = SE2(-1.0, 2.0, 0.0), SE2(-1.0, 2.0, math.pi / 2)
    path = [travel.start, *map(travel.lattice.pose, there)]
    said = sentences.plan(Plan(path, 1.0, later=7.4, targets=1.23, cleared=45.6, patches=7.89), travel)
    assert said == (
        "The next 2 steps lead to (-1.0, 2.0), looking towards 0°, and may show 1.2 m² of targets and "
        "7.9 pieces of hull and 46 m² on which the middle of a patch could lie. "
        "What is left then takes about 7 more."
    )
    single = sentences.plan(Plan(path[:2], 0.0, 0.0, cells=12.0), travel)
    assert single == (
        "The next step leads to (-1.0, 2.0), looking towards 90°, "
        "and may show 12 of the cells that are still to be seen."
    )
    assert "may show" not in sentences.plan(Plan(path, 1.0, 0.2), travel)


@dataclass
class Explained:
    """Flies as it decides, and keeps what each plan shows by the views of its poses, one after the other."""

    planner: Belief
    hull: bool
    """There is one in the world."""
    pilot: BeliefPilot = field(init=False)
    plans: list[tuple[Plan, Decision, tuple[float, float, float]]] = field(default_factory=list)
    """With square metres of targets, of middles of groups, and patches."""

    def begin(self, mission: Mission) -> Explained:
        self.pilot = self.planner.in_plane(mission)
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        thought = self.pilot.consider(observation, occupancy)
        decision = self.pilot.act(thought, thought.plan)
        if thought.plan is not None and thought.plan.choice is not None:
            prospect = self.pilot.prospect(thought.expected, thought.situation)
            shows = self._shows(thought, thought.plan, prospect, occupancy)
            self.plans.append((thought.plan, decision, shows))
        return decision

    def _shows(
        self, thought: Thought, plan: Plan, prospect: Prospect, occupancy: OccupancyMap
    ) -> tuple[float, float, float]:
        assert plan.choice is not None
        ground, middles, elements = NOTHING.copy(), NOTHING.copy(), set[int]()
        lattice = thought.travel.lattice
        for pose in plan.path[-1:] if plan.choice.straight else plan.path[1:]:
            shown, noticed = self.pilot.pose_views.shown(pose)
            ground, middles = ground | shown, middles | noticed
            if (listed := prospect.listed) is not None:
                for k in np.flatnonzero(listed.nodes == lattice.node_of(pose)):
                    first, past = listed.starts[k * DREAM_V1.headings + lattice.heading_of(pose) :][:2]
                    elements.update(listed.elements[first:past].tolist())
        ground &= ~occupancy.observed & (self.pilot.failed.count < self.pilot.failed.patience)
        square, expected = DREAM_V1.cell**2, thought.expected
        return (
            square * float(expected.beside[ground].sum()),
            # Of ground that is not worth a search it says nothing.
            square * float(np.count_nonzero(expected.hiding & middles)) * bool(prospect.hiding.any()),
            float(expected.hull[sorted(elements)].sum()),
        )


@pytest.fixture(scope="module", params=["reef", "wreck"])
def explained(request: pytest.FixtureRequest) -> Explained:
    """Short flights; that over the reef begins where it does not see all of it at once."""
    world = WORLDS[request.param]
    if request.param == "reef":
        world = replace(world, starts=(AWAY,))
    flight = Explained(Belief(), hull=bool(world.hull.any()))
    assert list(simulate(world, flight, DREAM_V1, max_steps=24, renderer=Colourless(world)))
    return flight


def test_what_a_plan_promises_is_what_the_views_along_its_way_would_show(explained: Explained) -> None:
    for plan, _, shows in explained.plans:
        assert (plan.targets, plan.cleared, plan.patches) == pytest.approx(shows, rel=1e-3, abs=1e-3)
    targets, cleared, patches = np.sum([shows for *_, shows in explained.plans], axis=0)
    assert targets > 10.0
    assert cleared > 100.0
    assert (patches > 10.0) == explained.hull


def test_it_says_why_it_goes_there_and_that_is_how_it_chose(explained: Explained) -> None:
    assert explained.plans
    for plan, decision, _ in explained.plans:
        between = plan.choice
        assert between is not None
        assert between.jump == explained.planner.jump
        assert decision.reasoning.next_target.endswith(sentences.choice(between))
        assert plan.rate == (between.view if between.straight else between.rate)
        assert (between.rate < between.jump * between.view) == between.straight


def test_on_a_walk_over_targets_or_round_what_a_survey_foretells_it_says_that() -> None:
    tank = make_world("pool/arc", 1)
    walks = 0
    for step in simulate(tank, Belief(), protocol_named(tank.protocol), max_steps=8):
        said = step.decision.reasoning.next_target
        assert said.endswith(sentences.WALK) == ("and traverse" in said)
        walks += "and traverse" in said
    assert walks
    told = NOTHING.astype(np.float32)
    told[40:52, 70:80] = 0.99
    surveyed = replace(MISSION, prior=Prior(AREA, DREAM_V1.cell, told, NOTHING, years=1.0))
    occupancy, observation = map_with(explored=_half_known()), observed_at(-6.0, 0.0, 0.0)
    for mission, round_it in ((surveyed, True), (MISSION, False)):
        said = Belief().in_plane(mission).decide(observation, occupancy).reasoning.next_target
        assert said.endswith(sentences.ROUND) == round_it


def test_whoever_takes_another_plan_is_given_no_reasons_for_this_one() -> None:
    pilot, observation = Belief().in_plane(MISSION), observed_at(-6.0, 0.0, 0.0)
    occupancy = map_with(explored=_half_known())
    thought = pilot.consider(observation, occupancy)
    assert thought.plan is not None
    own = pilot.act(thought, thought.plan).reasoning.next_target
    other = pilot.act(thought, replace(thought.plan, later=0.0)).reasoning.next_target
    assert thought.why in own
    assert own != thought.why
    assert thought.why
    assert thought.why not in other


def test_the_cells_that_it_says_are_still_to_be_seen_are_those_of_the_view_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From afar, and where the look-ahead has nothing to go for: a slit that never shows."""
    monkeypatch.setattr(LookAhead, "plan", lambda *_: None)
    toy, steps = Toy(SE2(9.0, -9.0, 0.0), all_but(SLIT), never=~all_but(SLIT)), []
    pilot = Belief().in_plane(MISSION)
    for _ in range(30):
        decision = toy.step(pilot)
        if decision.done:
            break
        said = decision.reasoning.next_target
        x, y, degrees, cells = _numbers(
            r"to \((\S+), (\S+)\), looking towards (\d+)°, and may show (\d+) of the cells", decision
        )
        promised = view(toy.map, x, y, math.radians(90.0 - degrees)) & ~toy.map.observed
        assert cells == np.count_nonzero(promised) > 0
        assert said.endswith(sentences.LEFTOVER)
        steps.append("The next step" in said)
    assert decision.done
    assert {True, False} == set(steps)


def test_the_way_that_it_announces_begins_with_its_move_and_can_be_gone(flown: Flown) -> None:
    longest = max(DREAM_V1.advances) + DREAM_V1.lattice
    for observation, occupancy, decision in flown.asked:
        if decision.done:
            continue
        match = re.search(r"The next (?:(\d+) steps|step) lead", decision.reasoning.next_target)
        assert match
        steps = int(match[1] or 1)
        x, y, degrees = _numbers(r"to \((\S+), (\S+)\), looking towards (\d+)°", decision)
        end = setpoint(observation.pose, decision, DREAM_V1)
        assert math.hypot(x - end.x, y - end.y) <= (steps - 1) * longest + 0.05
        assert occupancy.bounds.contains(x, y)
        if steps == 1:
            assert (x, y) == pytest.approx((end.x, end.y), abs=0.05)
            assert degrees == pytest.approx(math.degrees(math.pi / 2.0 - end.yaw) % 360.0)


def test_its_words_about_the_move_are_the_move(flown: Flown) -> None:
    for _, _, decision in flown.asked:
        if decision.done:
            continue
        said = decision.reasoning.action.lower()
        half_turn = abs(abs(decision.turn) - math.pi) < 1e-6
        assert ("turn round" in said) == half_turn
        assert ("left" in said) == (decision.turn > 0.0 and not half_turn)
        assert ("right" in said) == (decision.turn < 0.0 and not half_turn)
        turned = re.search(r"by (\d+)°", said)
        if turned:
            assert float(turned[1]) == pytest.approx(abs(math.degrees(decision.turn)))
        assert (f"advance {decision.advance:g} m" in said) == (decision.advance > 0.0)


def test_it_keeps_as_clear_of_solids_as_it_says(flown: Flown) -> None:
    for observation, occupancy, decision in flown.asked:
        said = decision.reasoning.safety
        if decision.done:
            continue
        assert "crosses only ground known to be free" in said
        match = re.search(r"keeps the body (\S+) m or more from solids", said)
        solids = np.stack(occupancy.center_of(*np.nonzero(occupancy.solid)), axis=-1)
        assert ("nothing solid has been seen" in said) == (len(solids) == 0)
        if not match:
            continue
        start, end = observation.pose, setpoint(observation.pose, decision, DREAM_V1)
        way = np.linspace([start.x, start.y], [end.x, end.y], 9)
        gap = np.maximum(np.abs(solids[None] - way[:, None]) - DREAM_V1.cell / 2.0, 0.0)
        assert np.hypot(gap[..., 0], gap[..., 1]).min() - DREAM_V1.body_radius >= float(match[1]) - 1e-6


def test_its_page_has_every_option() -> None:
    page = (Path(__file__).parents[2] / "docs/planner.md").read_text(encoding="utf-8")
    table = set(
        re.findall(r"`--([a-z-]+)`", page[page.index("| option |") : page.index("## 1 Distribution")])
    )
    assert table == {option.name.replace("_", "-") for option in fields(Belief)}
