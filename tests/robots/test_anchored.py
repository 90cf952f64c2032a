"""A robot that holds on to the ground it has seen, around one that moves exactly and believes otherwise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE2, SE3, wrap_angle
from dream.mapping.alignment import Float64Array, Matching
from dream.protocol import DREAM_V1
from dream.robots.anchored import Anchored, Anchoring
from dream.types import Arrival, Observation, Setpoint
from tests.mapping.analytic import CAMERA, SEABED, Disc, Pillar, render

COARSE = CAMERA.scaled(0.5)
RGB = np.zeros((COARSE.height, COARSE.width, 3), np.uint8)
LAUNCH = SE2(0.0, 0.0, 0.0)
ROUND = [(k % 8 * math.pi / 4.0, 1.5) for k in range(24)]
"""Three times round an eighth-cornered way, 12 m long."""
AROUND = [
    Disc(2.0 + r * math.cos(a), 2.0 + r * math.sin(a), size)
    for r, a, size in [
        (3.5, 0.1, 0.3),
        (4.2, 0.9, 0.4),
        (3.8, 1.7, 0.25),
        (5.0, 2.4, 0.5),
        (4.1, 3.0, 0.3),
        (3.6, 3.9, 0.35),
        (4.8, 4.5, 0.4),
        (4.0, 5.1, 0.25),
        (5.2, 5.7, 0.45),
        (6.3, 0.5, 0.4),
        (6.5, 1.9, 0.4),
        (6.1, 3.5, 0.5),
        (6.6, 4.9, 0.4),
    ]
]


@dataclass
class Believing:
    """Moves exactly, from the origin, and believes in what a function makes of the truth."""

    belief: Callable[[SE2, float], SE2]
    """Of the true pose and the metres that lie behind it."""
    things: Sequence[Disc | Pillar] = ()
    truth: SE2 = LAUNCH
    way: float = 0.0
    sent: Setpoint | None = None

    def observe(self) -> Observation:
        T = level(self.truth)
        depth, labels = render(T @ DREAM_V1.T_base_camera, *self.things, camera=COARSE)
        believed = level(self.belief(self.truth, self.way))
        return Observation(self.way, RGB, depth, labels, COARSE, believed, DREAM_V1.T_base_camera)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """As far as it believes to have to, in its own axes."""
        self.sent = setpoint
        here = self.belief(self.truth, self.way)
        step = level(here).inverse @ level(SE2(setpoint.x, setpoint.y, setpoint.yaw))
        self.truth = (level(self.truth) @ step).se2
        length = math.hypot(setpoint.x - here.x, setpoint.y - here.y)
        self.way += length
        there = self.belief(self.truth, self.way)
        return Arrival(there, collided=False, distance=length, clearance=1.0, truth=level(self.truth))


def level(pose: SE2) -> SE3:
    return SE3.level(pose.x, pose.y, SEABED + DREAM_V1.altitude, pose.yaw)


def exact(truth: SE2, way: float) -> SE2:
    return truth


def drifting(truth: SE2, way: float) -> SE2:
    """A metre in a hundred, to the east."""
    return SE2(truth.x + 0.01 * way, truth.y, truth.yaw)


def errors(robot: Believing, anchored: Anchored) -> list[float]:
    """Metres between where it is and where it believes to be, after each move of three rounds."""
    off = []
    anchored.observe()
    x, y = 0.0, 0.0
    for bearing, length in ROUND:
        x, y = x + length * math.cos(bearing), y + length * math.sin(bearing)
        arrival = anchored.go_to(Setpoint(x, y, bearing, DREAM_V1.altitude))
        off.append(arrival.pose.distance(robot.truth))
    return off


@dataclass(frozen=True)
class Flown:
    """Three rounds by a robot that holds on to what it has seen."""

    robot: Believing
    anchored: Anchored
    off: list[float]


def flown(belief: Callable[[SE2, float], SE2]) -> Flown:
    robot = Believing(belief, AROUND)
    anchored = Anchored(robot, DREAM_V1, Anchoring(age=6.0))
    return Flown(robot, anchored, errors(robot, anchored))


@pytest.fixture(scope="module")
def with_a_drift() -> Flown:
    return flown(drifting)


@pytest.fixture(scope="module")
def without_an_error() -> Flown:
    return flown(exact)


def test_a_drift_does_not_grow_where_the_ground_is_seen_again(with_a_drift: Flown) -> None:
    robot, off = with_a_drift.robot, with_a_drift.off
    assert drifting(robot.truth, robot.way).distance(robot.truth) > 0.3
    assert off[-1] < 0.15
    assert max(off) < 0.2


def test_it_ends_where_it_was_sent_in_the_map() -> None:
    robot = Believing(drifting, AROUND)
    anchored = Anchored(robot, DREAM_V1, Anchoring(age=6.0, settle=0.01))
    anchored.observe()
    x, y, corrected = 0.0, 0.0, 0
    for bearing, length in ROUND:
        x, y = x + length * math.cos(bearing), y + length * math.sin(bearing)
        arrival = anchored.go_to(Setpoint(x, y, bearing, DREAM_V1.altitude))
        corrected += anchored.alignment is not None
        assert arrival.pose.distance(anchored.observe().pose) < 1e-9
        assert arrival.pose.distance(SE2(x, y, bearing)) < 0.04
        assert arrival.distance > 1.0
    assert corrected > 5


def test_a_true_pose_stays_true(without_an_error: Flown) -> None:
    assert max(without_an_error.off) < 0.06


def test_over_bare_ground_it_believes_the_robot() -> None:
    robot = Believing(drifting)
    anchored = Anchored(robot, DREAM_V1)
    errors(robot, anchored)
    believed = drifting(robot.truth, robot.way)
    assert anchored.observe().pose.distance(believed) < 1e-9
    np.testing.assert_allclose(anchored.T_map_odom.translation, 0.0, atol=1e-12)
    assert anchored.alignment is None


def test_frames_of_just_now_do_not_correct() -> None:
    robot = Believing(drifting, AROUND)
    anchored = Anchored(robot, DREAM_V1, Anchoring(age=1e6))
    errors(robot, anchored)
    assert anchored.observe().pose.distance(drifting(robot.truth, robot.way)) < 1e-9


def test_what_it_tells_and_what_it_sends_are_in_frames_that_fit(with_a_drift: Flown) -> None:
    flight = deepcopy(with_a_drift)  # It flies on.
    robot, anchored = flight.robot, flight.anchored
    shift = anchored.T_map_odom
    assert np.hypot(*shift.translation[:2]) > 0.1
    assert shift.translation[2] == 0.0
    told = anchored.observe()
    np.testing.assert_allclose(
        told.T_world_base.translation, (shift @ robot.observe().T_world_base).translation
    )
    goal = SE2(told.pose.x + 0.5, told.pose.y - 0.25, 1.0)
    anchored.go_to(Setpoint(goal.x, goal.y, goal.yaw, DREAM_V1.altitude))
    assert robot.sent is not None
    sent = (shift @ level(SE2(robot.sent.x, robot.sent.y, robot.sent.yaw))).se2
    assert sent.distance(goal) < 1e-9
    assert sent.yaw == pytest.approx(goal.yaw)
    assert robot.sent.altitude == DREAM_V1.altitude


def test_height_and_tilt_are_handed_on_as_they_are() -> None:
    robot = Believing(exact)
    Anchored(robot, DREAM_V1).go_to(Setpoint(0.5, 0.0, 0.0, None, -1.5, 0.3))
    assert robot.sent is not None
    assert (robot.sent.altitude, robot.sent.z, robot.sent.tilt) == (None, -1.5, 0.3)


def test_a_heading_is_corrected_for_its_frame_and_forgotten() -> None:
    def turned(truth: SE2, way: float) -> SE2:
        return truth if way < 12.0 else SE2(truth.x, truth.y, truth.yaw + 0.02)

    robot = Believing(turned, AROUND)
    anchored = Anchored(robot, DREAM_V1, Anchoring(age=6.0))
    errors(robot, anchored)
    assert anchored.alignment is not None
    assert abs(wrap_angle(anchored.observe().pose.yaw - robot.truth.yaw)) < 0.01
    assert anchored.T_map_odom.yaw < -0.01
    robot.things = ()
    there = anchored.observe().pose
    after = anchored.go_to(Setpoint(there.x, there.y, there.yaw, DREAM_V1.altitude))
    assert anchored.T_map_odom.yaw == pytest.approx(0.0, abs=1e-9)
    assert after.pose.distance(there) < 1e-6


def test_a_jump_that_no_drift_explains_is_not_believed() -> None:
    def jumping(truth: SE2, way: float) -> SE2:
        return truth if way < 24.0 else SE2(truth.x + 0.45, truth.y, truth.yaw)

    robot = Believing(jumping, AROUND)
    anchored = Anchored(robot, DREAM_V1, Anchoring(age=6.0, drift=0.001))
    errors(robot, anchored)
    assert anchored.alignment is None
    wide = replace(Anchoring(age=6.0), drift=0.1, matching=Matching(window=0.75))
    robot = Believing(jumping, AROUND)
    assert errors(robot, Anchored(robot, DREAM_V1, wide))[-1] < 0.1


def test_it_is_less_sure_the_farther_it_went_and_surer_by_what_it_sees_again(
    without_an_error: Flown,
) -> None:
    blind = Anchored(Believing(exact), DREAM_V1)
    errors(Believing(exact), blind)
    sigmas = [math.sqrt(anchored.covariance[0, 0]) for anchored in (blind, without_an_error.anchored)]
    assert sigmas[0] > 0.1
    assert sigmas[1] < 0.5 * sigmas[0]


@pytest.mark.rare
def test_what_it_tells_of_its_error_holds_for_robots_that_err_so() -> None:
    """Many draws of a drift, a heading and a scale that `Anchoring` names: two sigma hold 9 of 10."""
    held = []
    for seed in range(12):
        rng, model = np.random.default_rng(seed), Anchoring(age=6.0)
        turn, long = model.launch_heading * rng.standard_normal(), 1.0 + model.scale * rng.standard_normal()
        walk = np.cumsum(model.drift * rng.standard_normal((60, 2)), axis=0)

        def erring(
            truth: SE2,
            way: float,
            turn: float = turn,
            long: float = long,
            walk: Float64Array = walk,
        ) -> SE2:
            c, s = long * math.cos(turn), long * math.sin(turn)
            x, y = c * truth.x - s * truth.y, s * truth.x + c * truth.y
            return SE2(x + walk[int(way), 0], y + walk[int(way), 1], truth.yaw + turn)

        robot = Believing(erring, AROUND)
        anchored = Anchored(robot, DREAM_V1, model)
        anchored.observe()
        x, y = 0.0, 0.0
        for bearing, length in ROUND:
            x, y = x + length * math.cos(bearing), y + length * math.sin(bearing)
            arrival = anchored.go_to(Setpoint(x, y, bearing, DREAM_V1.altitude))
            assert arrival.sigma == anchored.sigma
            held.append(arrival.pose.distance(robot.truth) <= 2.0 * arrival.sigma)
    assert 0.9 <= np.mean(held) <= 0.99


def test_frames_that_err_take_no_error_away() -> None:
    """The filter comes to trust the map ever more; what it tells stays above what the map had."""
    robot = Believing(exact, AROUND)
    anchored = Anchored(robot, DREAM_V1, Anchoring(age=6.0, drift=0.1))
    told = []
    anchored.observe()
    x, y = 0.0, 0.0
    for bearing, length in ROUND:
        x, y = x + length * math.cos(bearing), y + length * math.sin(bearing)
        told.append(anchored.go_to(Setpoint(x, y, bearing, DREAM_V1.altitude)).sigma)
    first = told[3]
    assert anchored.alignment is not None
    assert told[-1] > 0.7 * first
    assert math.sqrt(anchored.covariance[0, 0]) < 0.5 * told[-1]


@pytest.mark.parametrize(
    "name", ["drift", "heading", "launch", "launch_heading", "scale", "gate", "age", "settle"]
)
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_what_says_nothing_of_an_error_is_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        replace(Anchoring(), **{name: value})


@pytest.mark.parametrize(
    "wrong",
    [
        *({name: 0.0} for name in ("window", "turn", "step", "cell", "floor", "trust", "leverage", "sigma")),
        *({name: -1.0} for name in ("min_overlap", "rival")),
        {"step": 0.6},
        {"turn_step": 0.1},
    ],
)
def test_a_matching_that_cannot_match_is_refused_by_name(wrong: dict[str, float]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        Matching(**wrong)
