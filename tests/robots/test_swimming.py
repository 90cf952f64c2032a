"""What swims, as it is written down and read again."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from dream.commands.swim import Swim
from dream.control.autopilot import Autopilot
from dream.estimation import Start
from dream.evaluation.runner import simulate
from dream.geometry import SE3
from dream.planning import RandomWalk
from dream.protocol import DREAM_V1, DREAM_V1_NAV
from dream.robots import Anchored, Anchoring, Motion, Simulated, Swimming
from dream.robots.swimming import read_swimming
from dream.sim.sensors import DVL_A50_PERFORMANCE, Outage
from dream.sim.vehicle import BLUEROV2
from dream.sim.world import World

CHOSEN = Swim(vehicle="bluerov2", current=0.2, gust=0.0, dvl="performance", dvl_losses=0.1, anchoring=False)


def test_the_options_choose_what_they_say() -> None:
    swimming = CHOSEN.chosen(DREAM_V1_NAV)
    assert swimming is not None
    assert (swimming.motion.vehicle, swimming.motion.dvl) == (BLUEROV2, DVL_A50_PERFORMANCE)
    assert (swimming.motion.current, swimming.motion.gust) == (0.2, 0.0)
    assert swimming.motion.dvl_bursts.share == 0.1
    assert swimming.anchoring is None
    assert Swim().chosen(DREAM_V1_NAV) == Swimming()


def test_where_nothing_swims_nothing_can_be_chosen() -> None:
    assert Swim().chosen(DREAM_V1) is None
    with pytest.raises(ValueError, match=r"--vehicle.*expected a protocol.*got dream-v1\. Say --protocol"):
        CHOSEN.chosen(DREAM_V1)


@pytest.mark.parametrize(
    "swimming",
    [
        Swimming(),
        CHOSEN.chosen(DREAM_V1_NAV),
        Swimming(
            Motion(outages=(Outage("imu", 3.0), Outage("dvl", 1.0, 2.0)), autopilot=Autopilot(speed=0.3))
        ),
        Swimming(anchoring=Anchoring(age=20.0)),
    ],
)
def test_what_is_written_down_is_read_again_as_it_was(swimming: Swimming) -> None:
    text = json.dumps(asdict(swimming), allow_nan=False)
    assert read_swimming(json.loads(text)) == swimming


@pytest.mark.parametrize(
    ("change", "complaint"),
    [({"current": -1.0}, "swimming: motion"), ({"vehicle": 3}, "swimming: motion.vehicle")],
)
def test_what_cannot_be_is_refused_by_name(change: dict[str, Any], complaint: str) -> None:
    values = asdict(Swimming())
    values["motion"] |= change
    with pytest.raises(ValueError, match=complaint):
        read_swimming(values)


def test_with_and_without_holding_on_to_the_ground(empty_world: World) -> None:
    start = empty_world.starts[0]
    assert isinstance(Swimming().launch(empty_world, DREAM_V1_NAV, start), Anchored)
    assert isinstance(Swimming(anchoring=None).launch(empty_world, DREAM_V1_NAV, start), Simulated)


def test_a_mission_flies_what_was_chosen(empty_world: World) -> None:
    def ends(swimming: Swimming | None) -> list[float]:
        steps = simulate(empty_world, RandomWalk(), DREAM_V1_NAV, max_steps=3, swimming=swimming)
        return [step.observation.pose.x for step in steps]

    still = Swimming(replace(Motion(), current=0.0))
    assert ends(None) == ends(Swimming())
    assert ends(still) != ends(None)
    with pytest.raises(ValueError, match="swimming: expected a protocol by which a vehicle swims"):
        simulate(empty_world, RandomWalk(), DREAM_V1, swimming=still)


def test_a_start_errs_by_what_it_says_in_the_frame_of_the_vehicle() -> None:
    start, rng = Start(tilt=0.02, yaw=0.01, velocity=0.3, position=0.1), np.random.default_rng(0)
    T = SE3.level(3.0, -2.0, -5.0, 1.1)
    errors = []
    for _ in range(2000):
        pose, velocity = start.draw(T, rng)
        off = T.inverse @ pose
        turn = [off.rotation[2, 1], off.rotation[0, 2], off.rotation[1, 0]]
        errors.append([*turn, *(T.rotation.T @ velocity), *off.translation])
    expected = [0.02, 0.02, 0.01, 0.3, 0.3, 0.3, 0.1, 0.1, 0.1]
    np.testing.assert_allclose(np.std(errors, axis=0), expected, rtol=0.06)


def test_the_filter_is_not_told_the_truth_at_the_launch(empty_world: World) -> None:
    robot = Simulated(empty_world, DREAM_V1_NAV)
    gap = robot.truth.inverse @ robot.estimate.pose
    assert 1e-4 < np.linalg.norm(gap.translation) < 0.04
    assert 1e-4 < np.arccos((np.trace(gap.rotation) - 1.0) / 2.0) < 0.06
