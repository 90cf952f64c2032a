"""The planners that ask a model at every step, against a server on this machine."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream.course import Planner
from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.geometry import Bounds
from dream.mapping.drawing import EXPLORED, SOLID, TARGET, UNKNOWN
from dream.planning import Belief
from dream.planning.vlm import Dream, Vanilla
from dream.planning.vlm.reply import STEPS
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import LOOK_AROUND, Asked, Decision, Mission, Step
from tests.model_server import Response, Server, error, says, serving
from tests.sim.arenas import arena

SIX = {step: f"My {step}." for step in STEPS}


def acting(direction: str, turn_deg: float, step_m: float, done: bool = False) -> dict[str, Any]:
    return {"direction": direction, "turn_deg": turn_deg, "step_m": step_m, "done": done}


def saying(*actions: dict[str, Any], six: bool = True) -> list[Response]:
    return [says(json.dumps({**(SIX if six else {}), **action})) for action in actions]


def fly(server: Server, world: World, steps: int, planner: type[Dream | Vanilla] = Dream) -> list[Step]:
    asking = planner(**server.options, timeout=5.0)
    return list(simulate(world, asking, DREAM_V1, max_steps=LOOK_AROUND + steps))[1 + LOOK_AROUND :]


def picture(png: bytes) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_what_the_model_says_is_what_is_decided(string_reef: World) -> None:
    script = saying(acting("left", 90, 0), acting("right", 30, 2), acting("forward", 0, 1))
    with serving(*script) as server:
        steps = fly(server, string_reef, 3)
    assert [(round(math.degrees(s.decision.turn)), s.decision.advance) for s in steps] == [
        (90, 0.0),
        (-30, 2.0),
        (0, 1.0),
    ]
    assert steps[0].decision.reasoning.safety == "My safety."
    for step in steps:
        (exchange,) = step.decision.exchanges
        assert (exchange.fallback, exchange.outcome) == ("", "followed")
        assert exchange.prompt == "dream 1, legend 1, oysters 1"
        assert step.decision.waited == 12.0


def test_the_ablation_gives_an_action_without_reasons(string_reef: World) -> None:
    with serving(*saying(acting("left", 90, 0), six=False)) as server:
        (step,) = fly(server, string_reef, 1, Vanilla)
        (request,) = server.asked
    assert step.decision.exchanges[0].prompt == "vanilla 1, legend 1"
    assert step.decision.reasoning.action == "Turn left by 90°."
    assert "distribution" not in request.schema["properties"]


def test_it_is_shown_the_camera_depth_labels_and_the_map(string_reef: World) -> None:
    with serving(*saying(acting("left", 90, 0), acting("forward", 0, 0))) as server:
        first, second = fly(server, string_reef, 2)
    shown = second.decision.exchanges[0].pictures
    assert list(shown) == ["camera", "depth", "labels", "map"]
    seen = first.observation
    camera, depth, labels = (picture(shown[name]) for name in ("camera", "depth", "labels"))
    assert camera.shape == depth.shape == labels.shape == (480, 640, 3)
    np.testing.assert_array_equal(camera, seen.rgb)
    near = np.nan_to_num(seen.depth, nan=12.0) / 12.0
    np.testing.assert_allclose(depth[::2, ::2, 0], 255.0 * np.clip(1.0 - near, 0.0, 1.0), atol=0.51)
    for label, color in ((1, EXPLORED), (2, TARGET), (3, SOLID)):
        np.testing.assert_array_equal((labels[::2, ::2] == color).all(axis=2), seen.labels == label)
    colors = {tuple(pixel) for pixel in picture(shown["map"])[::4, ::4].reshape(-1, 3).tolist()}
    assert {UNKNOWN, EXPLORED, TARGET} <= colors


@pytest.mark.rare
def test_a_blocked_move_and_a_done_that_is_refused_are_told(string_reef: World) -> None:
    script = saying(
        acting("forward", 0, 0, done=True), *[acting("forward", 0, 2)] * 5, acting("forward", 0, 0)
    )
    with serving(*script) as server:
        steps = fly(server, string_reef, 7)
        told = [request.question for request in server.asked]
    assert steps[0].open_region
    assert f"Done was said, and the map does not agree: {steps[0].open_region}." in told[1]
    blocked = next(k for k, step in enumerate(steps) if step.guarded.note)
    assert f"went only {steps[blocked].arrival.distance:.1f} m" in told[blocked + 1]
    assert not any(step.arrival.collided for step in steps)
    assert f"{LOOK_AROUND} steps are done; 7 are left" in told[0]


def test_without_an_answer_the_offline_planner_decides_that_step(string_reef: World) -> None:
    def alone() -> list[Decision]:
        return [step.decision for step in simulate(string_reef, Belief(), DREAM_V1, max_steps=9)][4:]

    with serving(error(418)) as server:
        steps = fly(server, string_reef, 6)
    for step, decision in zip(steps, alone(), strict=True):
        assert (step.decision.turn, step.decision.advance) == (decision.turn, decision.advance)
        assert step.decision.reasoning == decision.reasoning
        assert step.decision.exchanges[0].fallback == "server: HTTP 418: denied to key ..."
        assert step.decision.exchanges[0].outcome == ""


@pytest.mark.rare
def test_a_mission_without_any_answer_is_no_success_of_who_was_to_decide() -> None:
    small = replace(arena(), bounds=Bounds(-6.0, -6.0, 6.0, 6.0))

    def summary(planner: Planner) -> dict[str, Any]:
        scorer = Scorer(small, DREAM_V1)
        for step in simulate(small, planner, DREAM_V1):
            scorer.add(step)
        return scorer.summary()

    alone = summary(Belief())
    with serving(error(418)) as server:
        silent = summary(Vanilla(**server.options, timeout=5.0))
    assert silent["steps"] == alone["steps"]
    assert (alone["success"], silent["success"]) == (True, False)


def test_what_earlier_legs_spent_counts_towards_the_budget(string_reef: World) -> None:
    first, *_ = simulate(string_reef, Belief(), DREAM_V1, max_steps=1)
    with serving(*saying(acting("left", 90, 0))) as server:
        asking = Dream(**server.options, timeout=5.0, max_calls=3)
        mission = Mission(DREAM_V1, string_reef.bounds, 200, asked=Asked(calls=2))
        pilot = asking.begin(mission)
        said = [pilot.decide(first.observation, first.occupancy).exchanges[0].fallback for _ in range(2)]
    assert said == ["", "budget: all 3 calls are made"]
    assert len(server.asked) == 1


@pytest.mark.rare
def test_the_offline_planner_stands_ready_wherever_the_model_went(string_reef: World) -> None:
    script = saying(acting("left", 90, 2), acting("forward", 0, 2), acting("right", 60, 1))
    with serving(*script, error(418)) as server:
        steps = fly(server, string_reef, 12)
    assert [bool(step.decision.exchanges[0].fallback) for step in steps] == [False] * 3 + [True] * 9
    assert not any(step.guarded.note for step in steps[3:])
    assert sum(step.arrival.distance for step in steps[3:]) > 5.0


@pytest.mark.rare
@pytest.mark.parametrize("planner", [Dream, Vanilla])
def test_the_same_replies_give_the_same_mission(planner: type[Dream | Vanilla], string_reef: World) -> None:
    flights = []
    for _ in range(2):
        script = saying(acting("left", 30, 2), acting("right", 60, 1), six=planner is Dream)
        with serving(*script) as server:
            steps = fly(server, string_reef, 4, planner)
        flights.append([(s.decision.turn, s.decision.advance, s.arrival.pose) for s in steps])
        last = [step.decision.exchanges[0].pictures for step in steps]
    assert flights[0] == flights[1]
    assert all(len(pictures) == 4 for pictures in last)
