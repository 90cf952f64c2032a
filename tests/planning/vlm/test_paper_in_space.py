"""The planners that ask a model at every step, where the vehicle moves in space."""

from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream.evaluation.runner import simulate
from dream.geometry import SE3
from dream.mapping import OccupancyMap
from dream.mapping.drawing import FREE
from dream.planning import SixSteps
from dream.planning.vlm import Dream, Vanilla, pictures
from dream.planning.vlm.heights import heights
from dream.standin import eyes, sight
from dream.types import LOOK_AROUND, Decision, Label, Step
from tests.mapping.test_space_drawing import faced
from tests.model_server import Response, Server, error, says, serving
from tests.planning.flights import observed_at
from tests.planning.vlm.in_space import PROTOCOL, flown, mission, reef
from tests.planning.vlm.test_paper import SIX


def acting(turn_deg: float = 0, step_m: float = 0, climb_m: float = 0, tilt_deg: float = 20) -> Response:
    action = {"turn_deg": abs(turn_deg), "step_m": step_m, "climb_m": climb_m, "tilt_deg": tilt_deg}
    direction = "forward" if turn_deg == 0 else "left" if turn_deg > 0 else "right"
    return says(json.dumps({**SIX, **action, "direction": direction, "done": False}))


def fly(server: Server, steps: int, **options: Any) -> list[Step]:
    asking = Dream(**server.options, **{"timeout": 5.0, **options})
    return list(simulate(reef(), asking, PROTOCOL, max_steps=LOOK_AROUND + steps))[1 + LOOK_AROUND :]


@pytest.fixture(scope="module")
def led() -> tuple[list[Step], list[str]]:
    """Steps that a model decided, some of which are not safe, and what it was told."""
    up = acting(0, 0, 1, 45)
    with serving(acting(90, 0, 0, 45), up, up, up, acting(-30, 2, -0.5, 20)) as server:
        steps = fly(server, 5)
        return steps, [request.question for request in server.asked]


@pytest.mark.rare
def test_what_the_model_says_of_climb_and_tilt_is_what_is_decided(led: tuple[list[Step], list[str]]) -> None:
    steps, _ = led
    said = [
        (round(math.degrees(d.turn)), d.advance, d.climb, round(math.degrees(d.tilt or 0.0)))
        for d in (step.decision for step in steps)
    ]
    assert said == [(90, 0.0, 0.0, 45), *[(0, 0.0, 1.0, 45)] * 3, (-30, 2.0, -0.5, 20)]
    for step in steps:
        (exchange,) = step.decision.exchanges
        assert (exchange.fallback, exchange.outcome) == ("", "followed")
        assert exchange.prompt.endswith(", space 1, steering 1")
    assert not any(step.arrival.collided for step in steps)


def test_what_the_guard_left_of_a_climb_is_told_with_the_height(led: tuple[list[Step], list[str]]) -> None:
    steps, told = led
    shortened = 0
    for before, step, question in zip(steps, steps[1:], told[2:], strict=False):
        up = step.observation.z - before.observation.z
        went = abs(step.decision.climb - up) < 0.1 and step.arrival.distance >= step.decision.advance - 0.5
        assert ("That was not safe all the way" in question) == (not went)
        shortened += not went
        if not went and up:
            assert f"{abs(up):.1f} m {'up' if up > 0.0 else 'down'}." in question
    assert shortened
    assert "The last action was: climb 1 m, turn the camera 45° down." in told[2]


def test_it_is_told_how_deep_it_is_and_where_its_camera_looks(led: tuple[list[Step], list[str]]) -> None:
    steps, told = led
    for before, question in zip(steps, told[1:], strict=False):
        (deep, down) = re.findall(r"It is (\S+) m under water, .*; its camera looks (\d+)°", question)[0]
        assert float(deep) == pytest.approx(-before.observation.z, abs=0.06)
        assert float(down) == pytest.approx(abs(math.degrees(before.observation.tilt)), abs=0.6)


def test_it_is_shown_two_cuts_besides_that_change_with_the_volume(
    led: tuple[list[Step], list[str]],
) -> None:
    steps, _ = led
    first, second = (step.decision.exchanges[0].pictures for step in steps[:2])
    assert list(first) == ["camera", "depth", "labels", "map", "level", "slice"]
    for name in ("level", "slice"):
        assert first[name] != second[name]
        colors = np.asarray(Image.open(io.BytesIO(first[name])).convert("RGB")).reshape(-1, 3)
        assert (colors == FREE).all(axis=1).mean() > 0.01


def test_the_map_says_what_is_inspected() -> None:
    observation, occupancy = flown()

    def violet(known: OccupancyMap) -> int:
        here = [(observation.pose.x, observation.pose.y)]
        picture = np.asarray(pictures.map_picture(known, observation.pose, here))
        cells = eyes.read_map(picture, eyes.INSPECTING).cells
        return int(np.isin(cells, (sight.INSPECTED, sight.SOLID_INSPECTED)).sum())

    forgotten = occupancy.copy()
    assert forgotten.volume is not None
    forgotten.volume._bricks.sides[:] = 0
    forgotten.volume.revision += 1
    assert violet(occupancy) >= 4
    assert violet(forgotten) == 0


def test_without_an_answer_the_offline_planner_decides_that_step() -> None:
    alone = list(simulate(reef(), SixSteps(), PROTOCOL, max_steps=LOOK_AROUND + 2))[1 + LOOK_AROUND :]
    for script in (error(418), says("{}"), acting(0, 0, 0.7), acting(0, 0, 0, 30)):
        with serving(script) as server:
            steps = fly(server, 2)
        for step, other in zip(steps, alone, strict=True):
            mine, theirs = (
                (d.turn, d.advance, d.climb, d.tilt, d.reasoning) for d in (step.decision, other.decision)
            )
            assert mine == theirs
            assert step.decision.exchanges[0].fallback
            assert step.decision.exchanges[0].outcome == ""


def test_an_answer_that_is_too_late_does_not_count() -> None:
    observation, occupancy = flown()
    with serving(replace(acting(0, 0, 1), late=2.0)) as server:
        pilot = Dream(**server.options, timeout=0.3).begin(mission())
        decision = pilot.decide(observation, occupancy)
    assert decision.exchanges[0].fallback.startswith("timeout")
    assert decision.reasoning == SixSteps().begin(mission()).decide(observation, occupancy).reasoning


def test_the_ablation_says_its_action_with_the_climb() -> None:
    observation, occupancy = flown()
    with serving(says(json.dumps({**json.loads(_said(acting(90, 1, 0.5, 45))), "done": False}))) as server:
        decision: Decision = (
            Vanilla(**server.options, timeout=5.0).begin(mission()).decide(observation, occupancy)
        )
    assert (
        decision.reasoning.action == "Turn left by 90°, advance 1 m, climb 0.5 m, turn the camera 45° down."
    )


def _said(response: Response) -> str:
    """The action alone, as the ablation's schema wants it."""
    content = json.loads(json.loads(response.body)["choices"][0]["message"]["content"])
    return json.dumps({name: value for name, value in content.items() if name not in SIX})


# ------------------------------------------------------------------------------------------------- in words


def test_a_wall_is_told_with_its_side_and_depth_and_what_was_inspected_is_not_left() -> None:
    here = replace(observed_at(0.0, 0.0, 0.0), T_world_base=SE3.level(0.0, 0.0, -5.0, 0.0))
    far = "\n".join(heights(faced(Label.TARGET, 9.0), here, 0.35))
    assert "It is 5.0 m under water" in far
    assert "0% of it inspected" in far
    (x, depth, faces) = re.findall(
        r"around \((\S+), \S+\), (\S+) m under water, \S+ m² that face (.*?)[;.]", far
    )[0]
    assert float(x) == pytest.approx(9.1, abs=0.5)
    assert abs(float(depth) - 5.0) < 8.0
    assert faces == "west"
    near = "\n".join(heights(faced(Label.TARGET, 4.0), here, 0.35))
    share = int(re.findall(r"(\d+)% of it inspected", near)[0])
    assert share > 50
    none = heights(faced(Label.OBSTACLE), here, 0.35)
    assert none[1:] == ["No target has been seen yet."]
