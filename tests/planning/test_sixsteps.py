"""The six steps on real maps: what they expect, what they say, when they stop."""

from __future__ import annotations

import math
import re

import numpy as np

from dream.evaluation.runner import simulate
from dream.geometry import Bounds
from dream.mapping import OccupancyMap, view
from dream.planning import SixSteps
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Step
from tests.mapping.analytic import map_with


def test_with_nothing_known_every_cell_is_as_likely_as_the_prior() -> None:
    occupancy = OccupancyMap(Bounds(-10.0, -10.0, 10.0, 10.0), DREAM_V1)
    planner = SixSteps(prior=0.03)
    np.testing.assert_allclose(planner.expectation(occupancy), 0.03, rtol=1e-5)


def test_targets_make_their_surroundings_likely_and_empty_ground_unlikely() -> None:
    explored, target = np.zeros((96, 96), np.bool_), np.zeros((96, 96), np.bool_)
    explored[:, :48] = True
    target[40:56, 36:48] = True
    planner = SixSteps()
    expected = planner.expectation(map_with(explored=explored, target=target))
    beside_target, beside_sand, far_away = expected[48, 50], expected[8, 50], expected[48, 90]
    assert (expected[explored] == 0.0).all()
    assert beside_target > 5.0 * planner.prior
    assert beside_sand < 0.5 * planner.prior
    assert abs(far_away - planner.prior) < 1e-3


def test_every_step_after_the_look_around_fills_all_six_fields(short_mission: list[Step]) -> None:
    for step in short_mission[4:]:
        reasoning = step.decision.reasoning
        for name in ("distribution", "target_area", "completion", "next_target", "safety", "action"):
            sentence = getattr(reasoning, name)
            assert sentence.endswith("."), f"{name}: {sentence!r}"


def test_its_words_about_the_move_are_the_move(short_mission: list[Step]) -> None:
    for step in short_mission[4:]:
        said, decision = step.decision.reasoning.action.lower(), step.decision
        assert ("left" in said) == (0.0 < decision.turn < 3.1)
        assert ("right" in said) == (decision.turn < 0.0)
        assert (f"advance {decision.advance:g} m" in said) == (decision.advance > 0.0)


def test_its_moves_are_never_changed_by_the_guard(short_mission: list[Step]) -> None:
    assert not any(step.guarded.note for step in short_mission)


def test_its_words_about_what_to_expect_and_to_keep_clear_of_are_true(string_reef: World) -> None:
    checked = 0
    for step in simulate(string_reef, SixSteps(), DREAM_V1, max_steps=16):
        if step.index < 5:
            before = step.occupancy.copy()
            continue
        said, here = step.decision.reasoning, step.observation.pose
        if match := re.search(
            r"view from \((\S+), (\S+)\) towards (\d+)°.* (\S+) more target", said.next_target
        ):
            x, y, degrees, cells = map(float, match.groups())
            visible = view(before, x, y, math.radians(90.0 - degrees)) & ~before.explored
            promised = SixSteps().expectation(before)[visible].sum()
            assert math.isclose(promised, cells, abs_tol=0.06)
            checked += 1
        if match := re.search(r"body (\S+) m or more", said.safety):
            rows, cols = np.nonzero(before.solid)
            solids = np.stack(before.center_of(rows, cols), axis=-1)
            gap = np.abs(solids - [here.x, here.y]) - DREAM_V1.cell / 2.0
            nearest = np.hypot(*np.maximum(gap, 0.0).T).min() - DREAM_V1.body_radius
            assert nearest >= float(match.group(1)) - 1e-6
            checked += 1
        before = step.occupancy.copy()
    assert checked >= 12
