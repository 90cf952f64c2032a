"""Trials score as the benchmark does, without its colours."""

from __future__ import annotations

import numpy as np
import pytest

from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.evaluation.suites import Case
from dream.learning.curriculum import summary
from dream.learning.rollouts import Colourless, Taught
from dream.learning.trials import Outcome, Trial, fly, try_out
from dream.protocol import DREAM_V1
from dream.sim.render import Renderer
from dream.sim.world import World
from tests.learning.engines import Inline

STEPS = 9
TRIAL = Trial("teacher", Taught(), Case("reef/string", 1, start=2), STEPS)


def test_a_trial_scores_as_the_benchmark_does(string_reef: World) -> None:
    scorer, metres = Scorer(string_reef, DREAM_V1), 0.0
    for step in simulate(string_reef, Taught(), DREAM_V1, start=2, max_steps=STEPS):
        coverage = scorer.add(step)
        metres += step.arrival.distance
    outcome = fly(TRIAL)
    assert outcome.share == pytest.approx(coverage.instances)
    assert outcome.share > 0.0
    assert outcome.distance == pytest.approx(metres)
    assert outcome.seen == round(outcome.share * scorer.summary()["countable"])


def test_without_colours_depth_and_labels_are_the_same(string_reef: World) -> None:
    start = string_reef.starts[0]
    height = float(string_reef.terrain.height(start.x, start.y)) + DREAM_V1.altitude
    T_world_camera = type(DREAM_V1.T_base_camera).level(start.x, start.y, height, start.yaw)
    T_world_camera = T_world_camera @ DREAM_V1.T_base_camera
    plain, full = (r(string_reef).render(DREAM_V1.camera, T_world_camera) for r in (Colourless, Renderer))
    assert np.array_equal(plain.depth, full.depth, equal_nan=True)
    assert np.array_equal(plain.labels, full.labels)
    assert not plain.rgb.any()


def test_every_trial_is_flown_once_and_those_of_a_world_together() -> None:
    cases = [Case("flat/empty", 1), Case("flat/empty", 2)]
    trials = [Trial(name, Taught(), case, 4) for name in ("a", "b") for case in cases]
    engine = Inline()
    outcomes = list(try_out(trials, engine))
    assert [trial for trial, _ in outcomes] == [trials[0], trials[2], trials[1], trials[3]]
    assert all(outcome.share == 0.0 and outcome.seen == 0 for _, outcome in outcomes)


def test_a_summary_counts_targets_over_all_metres() -> None:
    found = summary([Outcome(10, 0.5, 5.0), Outcome(50, 1.0, 15.0)])
    assert found == {"share": 0.75, "targets_per_metre": 3.0, "metres": 10.0}
