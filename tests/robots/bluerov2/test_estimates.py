"""A dive's estimate made again from its log, by every estimator."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.estimation import Mounting, Timeline
from dream.geometry import SE2, SE3
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from dream.robots.bluerov2.devices import _plain
from dream.robots.bluerov2.estimates import Estimated, Tracks, estimates
from dream.robots.bluerov2.log import DiveLog
from dream.robots.bluerov2.navigation import ESTIMATORS, Instruments, mounting_of
from dream.robots.bluerov2.reports import Strange, attitude_of

SPEED, TURN, BIAS, DEPTH = 0.3, 0.1, np.array([0.01, -0.02, 0.05]), -2.0
SECONDS = 6.0


def true_pose(time: float) -> SE3:
    """On a circle, at an even speed."""
    yaw, radius = TURN * time, SPEED / TURN
    return SE3.level(radius * math.sin(yaw), radius * (1.0 - math.cos(yaw)), DEPTH, yaw)


def heard(bias: np.ndarray[Any, Any]) -> Iterator[Imu | Measurement]:
    """What sensors without noise say of it, but for the gyroscopes' bias; the compass is heard only once."""
    turn = np.array([0.0, 0.0, TURN])
    mounting = Instruments().mounting
    flow = np.array([SPEED, 0.0, 0.0]) + np.cross(turn, mounting.T_base_dvl.translation)
    for k in range(1, round(50 * SECONDS) + 1):
        now = k / 50.0
        yield Imu(now, turn + bias, np.array([0.0, SPEED * TURN, 9.81]))
        if k % 10 == 0:
            yield Dvl(now, flow, np.eye(3) * 1e-4, 1.0, True)
        if k % 5 == 0:
            yield Depth(now, DEPTH, 0.01)
        if k == 25:
            yield Heading(now, TURN * now, 0.01)


def dived(
    folder: Path, name: str = "inekf", *, again: bool = False, mounting: Mounting | None = None
) -> Path:
    """The log of a dive that was flown with an estimator, as `Devices` and `Navigator` leave it."""
    estimator: Any = Instruments(name, mounting or Instruments().mounting).filter
    began = estimator.begin(0.0, true_pose(0.0), np.array([SPEED, 0.0, 0.0]))
    knows = hasattr(began, "gyro_bias")
    if knows:
        began = replace(began, gyro_bias=BIAS)
    with DiveLog(folder, epoch_ns=10**18) as log:
        if mounting is not None:
            seats = {
                "dvl": mounting.T_base_dvl.translation.tolist(),
                "gauge": list(mounting.pressure_sensor),
            }
            log.tap(0.0, "mounting", False, seats)
        if again:
            # An alignment that came to nothing, a metre away.
            astray = replace(began, position=began.position + 1.0)
            log.tap(0.0, "begun", False, _plain(astray))
        log.tap(0.0, "begun", False, _plain(began))
        timeline: Timeline[Any] = Timeline(estimator, began)
        for message in heard(BIAS if knows else np.zeros(3)):
            log.tap(message.time, "measurement", False, message)
            timeline.take(message)
            if isinstance(message, Depth):
                log.tap(timeline.state.time, "estimate", False, timeline.state)
    assert (log.problem, log.lost) == ("", {})
    return log.path


def tracked(path: Path, names: tuple[str, ...] = ESTIMATORS) -> Tracks:
    tracks = Tracks()
    for estimated in estimates(path, names):
        tracks.add(estimated)
    return tracks


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_estimator_of_the_dive_says_the_same_again(name: str, tmp_path: Path) -> None:
    made = list(estimates(dived(tmp_path, name), (name,)))
    assert len(made) == round(10 * SECONDS)
    # An EKF begins from the quaternion of its own state, which may round otherwise.
    close = 1e-12 if name == "ekf" else 0.0
    for one in made:
        assert np.abs(one.again[name].translation - one.logged.translation).max() <= close


def test_instruments_that_sit_elsewhere_do_so_again(tmp_path: Path) -> None:
    mounting = mounting_of((0.1, -0.2, -0.3), (0.2, 0.1, 0.05))
    made = list(estimates(dived(tmp_path, mounting=mounting), ("inekf",)))
    assert max(np.abs(one.again["inekf"].translation - one.logged.translation).max() for one in made) == 0.0


def test_a_log_with_a_mounting_that_is_none_is_refused(tmp_path: Path) -> None:
    with DiveLog(tmp_path, epoch_ns=10**18) as log:
        log.tap(0.0, "mounting", False, {"dvl": [-150.0, 0.0, -100.0], "gauge": [0.0, 0.0, 0.0]})
    with pytest.raises(ValueError, match="/mounting: expected where the instruments sit"):
        list(estimates(log.path))


@pytest.mark.parametrize("flown_with", ["inekf", "dead-reckoning"])
def test_every_estimator_follows_the_motion(flown_with: str, tmp_path: Path) -> None:
    """Whether the log holds samples with the bias or, as of an estimator that knows of none, without."""
    tracks = tracked(dived(tmp_path, flown_with))
    truth = [(time, true_pose(time).se2) for time in np.linspace(0.5, SECONDS, 20)]
    for name in ESTIMATORS:
        far = tracks.from_truth(name, truth)
        assert far is not None
        assert far.most < 0.03, name
        assert far.heading < math.radians(1.0), name
        assert tracks.from_logged(name).most < 0.05, name


def test_only_the_last_beginning_counts(tmp_path: Path) -> None:
    once, twice = tmp_path / "once", tmp_path / "twice"
    for folder in (once, twice):
        folder.mkdir()
    one, other = tracked(dived(once)), tracked(dived(twice, again=True))
    for name in ESTIMATORS:
        assert one.from_logged(name) == other.from_logged(name)


def test_tracks_are_apart_by_what_they_are_moved() -> None:
    tracks = Tracks()
    for k, by in enumerate((0.0, 3.0, 4.0)):
        there = SE3.level(float(k), 0.0, -1.0, math.pi - 0.01)
        moved = SE3.level(float(k), by, -5.0, 0.01 - math.pi)
        tracks.add(Estimated(float(k), there, {"ekf": moved}))
    far = tracks.from_logged("ekf")
    assert astuple(far) == pytest.approx((math.sqrt(25.0 / 3.0), 4.0, 4.0, 0.02))
    half = tracks.from_truth("ekf", [(0.5, SE2(0.5, 0.0, math.pi)), (9.0, SE2(0.0, 0.0, 0.0))])
    assert half is not None
    assert (half.rmse, half.end) == pytest.approx((1.5, 1.5))
    assert tracks.from_truth("ekf", [(9.0, SE2(0.0, 0.0, 0.0))]) is None


def test_between_two_estimates_the_heading_goes_the_short_way() -> None:
    tracks = Tracks()
    for time, yaw in ((0.0, math.pi - 0.1), (1.0, 0.1 - math.pi)):
        pose = SE3.level(0.0, 0.0, -1.0, yaw)
        tracks.add(Estimated(time, pose, {"ekf": pose}))
    far = tracks.from_truth("ekf", [(0.75, SE2(0.0, 0.0, 0.05 - math.pi))])
    assert far is not None
    assert far.heading == pytest.approx(0.0, abs=1e-9)


def test_a_log_without_a_beginning_is_refused(tmp_path: Path) -> None:
    with DiveLog(tmp_path, epoch_ns=0) as log:
        for message in heard(BIAS):
            log.tap(message.time, "measurement", False, message)
    with pytest.raises(ValueError, match="expected where the estimate of the dive began"):
        list(estimates(log.path))
    torn = tmp_path / "torn"
    torn.mkdir()
    with DiveLog(torn, epoch_ns=0) as log:
        log.tap(0.0, "begun", False, {"time": 0.0, "position": [0, 0]})
    with pytest.raises(ValueError, match="expected the state of an estimator"):
        list(estimates(log.path))


@pytest.mark.parametrize("wxyz", [(0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (0.7, 0.7, 0.0, 0.2)])
def test_a_beginning_whose_quaternion_is_none_is_refused(
    wxyz: tuple[float, float, float, float], tmp_path: Path
) -> None:
    begun = {"time": 0.0, "wxyz": wxyz, "velocity": [0.0, 0.0, 0.0], "position": [0.0, 0.0, -1.0]}
    with DiveLog(tmp_path, epoch_ns=0) as log:
        log.tap(0.0, "begun", False, begun)
    with pytest.raises(ValueError, match=r"/begun: expected .*quaternion of length 1, got"):
        list(estimates(log.path))


@pytest.mark.parametrize("wxyz", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0), (1.0, 0.0, 1.0, 0.0)])
def test_an_attitude_whose_quaternion_is_none_is_strange(wxyz: tuple[float, float, float, float]) -> None:
    message = mav.MAVLink_attitude_quaternion_message(0, *wxyz, 0.0, 0.0, 0.0)
    with pytest.raises(Strange, match="length 1"):
        attitude_of(message)


def test_measurements_that_the_log_has_lost_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    begun = _plain(Instruments().filter.begin(0.0, true_pose(0.0)))
    for lost, told in (({"measurement": 7}, "7 measurements are missing"), ({"camera": 7}, "")):
        caplog.clear()
        folder = tmp_path / next(iter(lost))
        folder.mkdir()
        with DiveLog(folder, epoch_ns=0) as log:
            log.tap(0.0, "begun", False, begun)
            log._lost.update(lost)
            log.tap(0.1, "measurement", False, next(heard(BIAS)))
        assert list(estimates(log.path)) == []
        assert told in caplog.text
        assert bool(told) is bool(caplog.text)
