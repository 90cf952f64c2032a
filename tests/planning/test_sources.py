"""Sources of belief: each may be left out, and what each adds is its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from dream.evaluation.runner import simulate
from dream.geometry import SE2, Bounds
from dream.learning.rollouts import Colourless
from dream.mapping import OccupancyMap, view
from dream.mapping.prior import Prior
from dream.planning import Belief
from dream.planning.belief import BeliefPilot
from dream.planning.pose_views import Listed
from dream.planning.sources import (
    AllGround,
    BeliefSource,
    ForetoldTargets,
    HiddenGroups,
    HintedTargets,
    HullSurface,
    TargetsBeside,
    TargetsToTraverse,
)
from dream.planning.sources.hull import best_rate
from dream.planning.travel import careful_travel
from dream.protocol import DREAM_V1, protocol_named
from dream.types import Mission, Observation
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import SIDE, all_but, observed_at, situation_of, source_of
from tests.planning.test_belief import WRECK

MISSION = Mission(DREAM_V1, AREA, DREAM_V1.cap)
IN_A_TANK = Mission(protocol_named("pool-v1"), Bounds(-3.0, -3.0, 3.0, 3.0), 100)
NOWHERE = np.zeros((SIDE, SIDE), np.bool_)
SURVEYED = Prior(AREA, DREAM_V1.cell, NOWHERE.astype(np.float32), NOWHERE, years=1.0)


@dataclass(frozen=True, slots=True)
class Without(Belief):
    left_out: type[BeliefSource] = BeliefSource

    def sources(self, mission: Mission) -> list[BeliefSource]:
        sources = Belief.sources(self, mission)
        return [source for source in sources if not isinstance(source, self.left_out)]


@pytest.fixture(scope="module")
def beside_a_wreck() -> tuple[Observation, OccupancyMap, BeliefPilot]:
    pilots: list[BeliefPilot] = []

    class Kept:
        def begin(self, mission: Mission) -> BeliefPilot:
            pilots.append(Belief().in_plane(mission))
            return pilots[-1]

    *_, last = simulate(WRECK, Kept(), DREAM_V1, max_steps=6, renderer=Colourless(WRECK))
    return last.observation, last.occupancy, pilots[-1]


@pytest.mark.parametrize("kind", [TargetsBeside, HiddenGroups, HullSurface])
def test_any_source_may_be_left_out(
    kind: type[BeliefSource], beside_a_wreck: tuple[Observation, OccupancyMap, BeliefPilot]
) -> None:
    observation, occupancy, _ = beside_a_wreck
    pilot = Without(left_out=kind).in_plane(Mission(DREAM_V1, occupancy.bounds, DREAM_V1.cap))
    assert source_of(pilot, kind) is None
    thought = pilot.consider(observation, occupancy)
    said, expected = thought.reasoning, thought.expected
    assert ("of the hull" in said.completion.lower()) == (kind is not HullSurface)
    assert ("If it stopped now" in said.completion) == (kind is not HiddenGroups)
    assert expected.hiding.any() == (kind is not HiddenGroups)
    assert expected.beside.any() == (kind is not TargetsBeside)
    assert pilot.act(thought, thought.plan).reasoning.action


@pytest.mark.parametrize(
    ("kind", "options", "mission", "word"),
    [
        (HintedTargets, {}, MISSION, ""),
        (ForetoldTargets, {}, replace(MISSION, prior=SURVEYED), "The survey"),
        (TargetsToTraverse, {}, IN_A_TANK, "can be by known ways"),
        (AllGround, {"certify": True}, MISSION, "all must be"),
    ],
)
def test_so_may_those_that_only_some_missions_have(
    kind: type[BeliefSource], options: dict[str, Any], mission: Mission, word: str
) -> None:
    empty = OccupancyMap(mission.bounds, mission.protocol)
    said, has = [], []
    for planner in (Belief(**options), Without(left_out=kind, **options)):
        pilot = planner.in_plane(mission)
        has.append(source_of(pilot, kind) is not None)
        expected = pilot.expect(situation_of(pilot, observed_at(0.0, 0.0, 0.0), empty))
        reasoning, _ = pilot._explain(expected, situation_of(pilot, observed_at(0.0, 0.0, 0.0), empty))
        said.append(f"{reasoning.distribution} {reasoning.completion} {expected.calibration}")
    assert has == [True, False]
    assert said[0] != said[1]
    assert word in said[0]
    assert not word or word not in said[1]


def test_without_any_source_nothing_is_expected_and_the_map_alone_decides() -> None:
    pilot = Without().in_plane(MISSION)
    assert pilot.sources == []
    occupancy = map_with(explored=all_but(np.s_[:, 56:]))
    thought = pilot.consider(observed_at(-6.0, 0.0, 0.0), occupancy)
    assert not thought.expected.beside.any()
    assert thought.expected.risk == 0.0
    assert not pilot.act(thought, thought.plan).done, "ground is left that the rule wants seen"


def test_while_a_hull_brings_enough_little_else_is_searched_for_and_the_risk_knows_of_no_hull(
    beside_a_wreck: tuple[Observation, OccupancyMap, BeliefPilot], monkeypatch: pytest.MonkeyPatch
) -> None:
    observation, occupancy, pilot = beside_a_wreck
    situation = situation_of(pilot, observation, occupancy)
    source = source_of(pilot, HullSurface)
    assert source is not None
    expected = pilot.expect(situation)
    expected.accepted = 0.0
    rate = best_rate(source.listed(expected, situation), situation.travel)
    assert rate > 0.0
    plain = HiddenGroups.expect
    without = pilot.expect(situation)
    plain(next(one for one in pilot.sources if isinstance(one, HiddenGroups)), without, situation)
    assert without.risk == expected.risk

    def searching(*, looked_over: bool, least: float) -> float:
        monkeypatch.setattr(source, "least", least)
        expected.looked_over = looked_over
        return float(pilot.prospect(expected, situation).hiding.sum())

    all_of_it = searching(looked_over=False, least=1.01 * rate)
    assert all_of_it > 0.0
    little = searching(looked_over=False, least=0.99 * rate)
    assert little == pytest.approx(source.alone * all_of_it, rel=1e-5)
    assert searching(looked_over=True, least=0.99 * rate) == all_of_it, "nothing more is wanted of the hull"
    expected.accepted = 1.0
    assert searching(looked_over=False, least=1.01 * rate) == 0.0, "the risk is accepted"


def test_the_best_rate_of_a_hull_is_that_of_the_best_view_for_its_distance() -> None:
    travel = careful_travel(SE2(-3.0, 2.0, 0.0), map_with(explored=all_but()))
    rng, headings = np.random.default_rng(3), DREAM_V1.headings
    nodes = rng.choice(np.flatnonzero(travel.reached), 12, replace=False)
    nodes[0] = travel.lattice.node_of(travel.start)  # No step leads to where it stands.
    counts = rng.integers(0, 4, 12 * headings)
    expected: Any = rng.uniform(0.0, 1.0, 30)
    counts[travel.lattice.heading_of(travel.start)] = 3
    elements = rng.integers(0, 30, int(counts.sum()))
    expected[elements[: int(counts[:headings].sum())]] = 50.0
    starts = np.concatenate([[0], np.cumsum(counts)])
    listed = Listed(expected, expected, np.zeros((30, 2)), nodes, starts, elements)
    best = 0.0
    for n, node in enumerate(nodes):
        for heading in range(headings):
            k, steps = n * headings + heading, travel.steps[travel.lattice.pose_at(node, heading)]
            if steps > 0:
                best = max(best, expected[elements[starts[k] : starts[k + 1]]].sum() / steps)
    assert best_rate(listed, travel) == pytest.approx(best)
    assert best_rate(None, travel) == 0.0


def test_a_plan_for_what_only_the_map_promises_has_no_weight_and_counts_its_cells() -> None:
    pilot = Without().in_plane(MISSION)
    occupancy = map_with(explored=all_but(np.s_[:, 56:]))
    plan = pilot.consider(observed_at(-6.0, 0.0, 0.0), occupancy).plan
    assert plan is not None
    there = pilot.pose_views.lattice.world(plan.path[-1])
    shown = view(occupancy, there.x, there.y, there.yaw) & ~occupancy.observed
    assert plan.cells == pytest.approx(np.count_nonzero(shown), rel=0.1)
    assert (plan.rate, plan.later, plan.targets, plan.patches) == (0.0, 0.0, 0.0, 0.0)


def test_targets_beside_known_ones_weigh_their_square_metres_times_how_eager_it_is() -> None:
    target = ~all_but(np.s_[44:52, 44:52])
    occupancy = map_with(explored=all_but(np.s_[:, 50:]), target=target)
    pilot = Belief().in_plane(MISSION)
    situation = situation_of(pilot, observed_at(-6.0, 0.0, 0.0), occupancy)
    source = source_of(pilot, TargetsBeside)
    assert source is not None
    prospect = pilot.prospect(pilot.expect(situation), situation)
    beside = float(prospect.targets.sum())
    assert 0.0 < beside < DREAM_V1.cell**2 * np.count_nonzero(~occupancy.observed)
    # Ground from which none are expected has hardly any weight.
    assert float(prospect.ground.sum()) == pytest.approx(source.eager * beside, rel=1e-3)


def test_where_nothing_was_seen_and_no_group_can_hide_open_ground_weighs_what_a_search_of_it_would() -> None:
    pilot = Without(left_out=HiddenGroups).in_plane(MISSION)
    occupancy = map_with(explored=all_but(np.s_[:, 56:]))
    situation = situation_of(pilot, observed_at(-6.0, 0.0, 0.0), occupancy)
    source = source_of(pilot, TargetsBeside)
    assert source is not None
    open_ground = DREAM_V1.cell**2 * len(situation.completion.open_cells)
    assert open_ground > 0.0
    weight = float(pilot.prospect(pilot.expect(situation), situation).ground.sum())
    assert weight == pytest.approx(source.search * open_ground, rel=1e-3)


def test_what_is_left_of_a_hull_is_a_share_of_what_was_found_and_is_expected(
    beside_a_wreck: tuple[Observation, OccupancyMap, BeliefPilot],
) -> None:
    observation, occupancy, pilot = beside_a_wreck
    source = source_of(pilot, HullSurface)
    assert source is not None
    expected = pilot.expect(situation_of(pilot, observation, occupancy))
    left = float(expected.hull.sum())
    assert left > 0.0
    assert 0.0 < expected.hull_left < 1.0
    assert left / expected.hull_left == pytest.approx(source.hull.found + left)
    assert expected.looked_over == (expected.hull_left <= source.accepted)
