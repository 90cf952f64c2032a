"""Sources of belief: each may be left out, and what each adds is its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from dream.evaluation.runner import simulate
from dream.geometry import SE2
from dream.learning.rollouts import Colourless
from dream.mapping import OccupancyMap
from dream.planning import Belief
from dream.planning.belief import BeliefPilot
from dream.planning.pose_views import Listed, PoseViews
from dream.planning.sources import (
    BeliefSource,
    HiddenGroups,
    HintedTargets,
    HullSurface,
    TargetsBeside,
)
from dream.planning.sources.hull import best_rate
from dream.planning.travel import careful_travel
from dream.protocol import DREAM_V1
from dream.types import Mission, Observation
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import all_but, observed_at, situation_of, source_of
from tests.planning.test_belief import WRECK

MISSION = Mission(DREAM_V1, AREA, DREAM_V1.cap)


@dataclass(frozen=True, slots=True)
class Without(Belief):
    left_out: type[BeliefSource] = BeliefSource

    def sources(self, mission: Mission, pose_views: PoseViews) -> list[BeliefSource]:
        sources = Belief.sources(self, mission, pose_views)
        return [source for source in sources if not isinstance(source, self.left_out)]


@pytest.fixture(scope="module")
def beside_a_wreck() -> tuple[Observation, OccupancyMap, BeliefPilot]:
    pilots: list[BeliefPilot] = []

    class Kept:
        def begin(self, mission: Mission) -> BeliefPilot:
            pilots.append(Belief().begin(mission))
            return pilots[-1]

    *_, last = simulate(WRECK, Kept(), DREAM_V1, max_steps=10, renderer=Colourless(WRECK))
    return last.observation, last.occupancy, pilots[-1]


@pytest.mark.parametrize("kind", [TargetsBeside, HiddenGroups, HullSurface, HintedTargets])
def test_any_source_may_be_left_out(
    kind: type[BeliefSource], beside_a_wreck: tuple[Observation, OccupancyMap, BeliefPilot]
) -> None:
    observation, occupancy, _ = beside_a_wreck
    pilot = Without(left_out=kind).begin(Mission(DREAM_V1, occupancy.bounds, DREAM_V1.cap))
    assert source_of(pilot, kind) is None
    thought = pilot.consider(observation, occupancy)
    said, expected = thought.reasoning, thought.expected
    assert ("of the hull" in said.completion.lower()) == (kind is not HullSurface)
    assert ("If it stopped now" in said.completion) == (kind is not HiddenGroups)
    assert expected.hiding.any() == (kind is not HiddenGroups)
    assert expected.beside.any() == (kind is not TargetsBeside)
    assert pilot.act(thought, thought.plan).reasoning.action


def test_without_any_source_nothing_is_expected_and_the_map_alone_decides() -> None:
    pilot = Without().begin(MISSION)
    assert pilot.sources == []
    occupancy = map_with(explored=all_but(np.s_[:, 56:]))
    thought = pilot.consider(observed_at(-6.0, 0.0, 0.0), occupancy)
    assert not thought.expected.beside.any()
    assert thought.expected.risk == 0.0
    assert not pilot.act(thought, thought.plan).done, "ground is left that the rule wants seen"


def test_while_a_hull_brings_enough_nothing_else_is_likely(
    beside_a_wreck: tuple[Observation, OccupancyMap, BeliefPilot], monkeypatch: pytest.MonkeyPatch
) -> None:
    observation, occupancy, pilot = beside_a_wreck
    situation = situation_of(pilot, observation, occupancy)
    source = source_of(pilot, HullSurface)
    assert source is not None
    rate = best_rate(pilot.expect(situation).hull_views, situation.travel)
    assert rate > 0.0
    monkeypatch.setattr(source, "least", 0.99 * rate)
    busy = pilot.expect(situation)
    monkeypatch.setattr(source, "least", 1.01 * rate)
    spent = pilot.expect(situation_of(pilot, observation, occupancy))
    assert busy.hidden == pytest.approx(source.alone * spent.hidden)
    assert busy.risk < spent.risk
    np.testing.assert_array_equal(busy.hull, spent.hull)
    assert busy.looked_over == spent.looked_over, "what is left of it still counts"
    searching, looking = (pilot.prospect(expected, situation).hiding for expected in (spent, busy))
    assert looking.sum() == pytest.approx(source.alone * searching.sum(), rel=1e-5)


def test_the_best_rate_of_a_hull_is_that_of_the_best_view_for_its_distance() -> None:
    travel = careful_travel(SE2(-3.0, 2.0, 0.0), map_with(explored=all_but()))
    rng, headings = np.random.default_rng(3), DREAM_V1.headings
    nodes = rng.choice(np.flatnonzero(travel.reached), 12, replace=False)
    counts = rng.integers(0, 4, 12 * headings)
    elements = rng.integers(0, 30, int(counts.sum()))
    expected: Any = rng.uniform(0.0, 1.0, 30)
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
