"""Scores of missions whose answer is known, and the laws they keep."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.geometry import SE2, Bounds
from dream.planning import Lawnmower, SixSteps
from dream.protocol import DREAM_V1
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.types import Step


@pytest.fixture(scope="module")
def scored(string_reef: World) -> tuple[Scorer, list[Step], list[float]]:
    scorer, steps, shares = Scorer(string_reef, DREAM_V1), [], []
    for step in simulate(string_reef, Lawnmower(), DREAM_V1, max_steps=25):
        shares.append(scorer.add(step).instances)
        steps.append(step)
    return scorer, steps, shares


def test_coverage_only_grows(scored: tuple[Scorer, list[Step], list[float]]) -> None:
    _, _, shares = scored
    assert all(b >= a for a, b in pairwise(shares))
    assert 0.0 <= shares[0] <= shares[-1] <= 1.0


def test_instances_are_the_union_of_what_every_pose_sees(
    scored: tuple[Scorer, list[Step], list[float]], string_reef: World
) -> None:
    scorer, steps, _ = scored
    visibility = Visibility(string_reef, DREAM_V1)
    poses = np.array([[s.observation.pose.x, s.observation.pose.y, s.observation.pose.yaw] for s in steps])
    seen = np.asarray(visibility.seen(poses).any(axis=0))
    expected = seen[visibility.countable].mean()
    assert math.isclose(scorer.summary()["coverage"]["instances"], expected, abs_tol=1e-6)


def test_geometry_and_pixels_tell_nearly_the_same(scored: tuple[Scorer, list[Step], list[float]]) -> None:
    coverage = scored[0].summary()["coverage"]
    assert abs(coverage["instances"] - coverage["visible"]) < 0.05


def test_the_summary_counts_what_happened(scored: tuple[Scorer, list[Step], list[float]]) -> None:
    scorer, steps, shares = scored
    summary = scorer.summary()
    assert summary["steps"] == 25
    assert summary["ended"] == "cap"
    assert summary["t_stop"] is None
    assert summary["collisions"] == 0
    assert math.isclose(summary["distance_m"], sum(s.arrival.distance for s in steps), abs_tol=1e-3)
    assert summary["turns"] == sum(s.guarded.decision.turn != 0.0 for s in steps)
    assert summary["success"] is False
    first = next((k for k, share in enumerate(shares) if share >= 0.9), None)
    assert summary["t90"] == first


def test_an_empty_world_is_done_only_when_all_ground_is_explored(empty_world: World) -> None:
    small = replace(empty_world, bounds=Bounds(-9.0, -9.0, 9.0, 9.0), starts=(SE2(0.0, 0.0, 0.0),))
    scorer = Scorer(small, DREAM_V1)
    for step in simulate(small, SixSteps(), DREAM_V1):
        scorer.add(step)
    assert step.ended == "done"
    # What is left lies in the corners, where no pose that keeps the body inside the bounds sees it.
    assert step.occupancy.explored.mean() > 0.97
    assert scorer.summary()["countable"] == 0
    assert scorer.summary()["success"]


def test_the_same_flight_gives_the_same_summary(string_reef: World) -> None:
    def short(start: int) -> dict[str, object]:
        scorer = Scorer(string_reef, DREAM_V1)
        for step in simulate(string_reef, SixSteps(), DREAM_V1, start=start, max_steps=6):
            scorer.add(step)
        return {key: value for key, value in scorer.summary().items() if key != "planner_ms"}

    assert short(0) == short(0)
    assert short(0) != short(1)
