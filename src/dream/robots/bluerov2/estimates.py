"""A dive's log → where the vehicle was, by any estimator, on the very measurements of then.

What the paper did with its dives: C-IPG beside the InEKF, on one and the same motion.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.estimation import Mounting, Timeline
from dream.geometry import SE2, SE3, UNTRUE, wrap_angle
from dream.measurements import Imu
from dream.robots.bluerov2.log import doubting, read_log
from dream.robots.bluerov2.messages import read_measurement
from dream.robots.bluerov2.navigation import ESTIMATORS, Instruments, mounting_of

logger = logging.getLogger(__name__)

Float64Array = npt.NDArray[np.float64]

TOPICS = ("/mounting", "/begun", "/measurements", "/estimate", "/log")


@dataclass(frozen=True, slots=True, eq=False)
class Begun:
    """What an estimate began with, whichever estimator's it was."""

    time: float
    T_world_base: SE3
    velocity: Float64Array
    """(3,) m/s over ground, in the world."""
    gyro_bias: Float64Array
    """(3,) rad/s, of the samples in the log; zero where they were logged without it."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """Where the vehicle was at one time."""

    time: float
    logged: SE3
    """`T_world_base` as it was reckoned during the dive."""
    again: Mapping[str, SE3]
    """The same by each estimator."""


@dataclass(frozen=True, slots=True)
class Apart:
    """How far two tracks are apart, horizontally."""

    rmse: float
    """Metres."""
    most: float
    end: float
    heading: float
    """Radians, rms."""


def estimates(path: Path, estimators: Sequence[str] = ESTIMATORS) -> Iterator[Estimated]:
    """Make a dive's estimate again, wherever one was logged.

    Instruments sit where the log says, and where `navigation` has them in one that does not.
    An estimator that knows of no gyro bias is given samples without the one that the dive began with, as
    `Navigator` gives them. Where the estimate of the dive began anew, so do they.

    Args:
        path: Of `log.mcap`.
        estimators: Of `navigation.ESTIMATORS`.

    Yields:
        In the order of the log. The estimator that the dive was flown with says the same again.

    Raises:
        FileNotFoundError: There is no log.
        ValueError: It is no log of a dive, or one whose estimate never began.
    """
    timelines: dict[str, Timeline[Any]] = {}
    bias = np.zeros(3)
    unbiased: set[str] = set()
    mounting = mounting_of()
    for logged in read_log(path, TOPICS):
        with doubting(logged):
            if logged.topic == "/mounting":
                mounting = _mounting(logged.message.data)
            elif logged.topic == "/begun":
                begun = _begun(logged.message.data)
                timelines, unbiased, bias = {}, set(), begun.gyro_bias
                for name in estimators:
                    estimator: Any = Instruments(name, mounting).filter
                    state = estimator.begin(begun.time, begun.T_world_base, begun.velocity)
                    if hasattr(state, "gyro_bias"):
                        state = replace(state, gyro_bias=bias)
                    else:
                        unbiased.add(name)
                    timelines[name] = Timeline(estimator, state)
            elif logged.topic == "/measurements":
                message = read_measurement(logged.message.data)
                for name, timeline in timelines.items():
                    if name in unbiased and isinstance(message, Imu):
                        plain = replace(message, angular_velocity=message.angular_velocity - bias)
                        timeline.take(plain)
                    else:
                        timeline.take(message)
            elif logged.topic == "/estimate" and timelines:
                again = {name: timeline.state.pose for name, timeline in timelines.items()}
                try:
                    pose = _pose(logged.message.pose.pose)
                except ValueError as error:
                    raise ValueError(f"{path}: /estimate at {logged.time:.3f} s: {error}") from error
                yield Estimated(logged.time, pose, again)
            elif logged.topic == "/log":
                _tell_lost(path, logged.message.data)
    if not timelines:
        raise ValueError(f"{path}: expected where the estimate of the dive began, got no /begun in it")


class Tracks:
    """Collects estimates, and says how far they are apart."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._places: dict[str, list[tuple[float, float, float]]] = {}
        self._logged: list[tuple[float, float, float]] = []

    def __len__(self) -> int:
        return len(self._times)

    def add(self, estimated: Estimated) -> None:
        """Take in one more."""
        self._times.append(estimated.time)
        self._logged.append(_place(estimated.logged))
        for name, pose in estimated.again.items():
            self._places.setdefault(name, []).append(_place(pose))

    def from_logged(self, name: str) -> Apart:
        """An estimator's track beside that of the dive."""
        return _apart(np.array(self._places[name]), np.array(self._logged))

    def from_truth(self, name: str, truth: Sequence[tuple[float, SE2]]) -> Apart | None:
        """An estimator's track beside what was true at some times; None where none of them is covered.

        Between two estimates it is carried on evenly.
        """
        times = np.array(self._times)
        known = [(time, pose) for time, pose in truth if times[0] <= time <= times[-1]]
        if not known:
            return None
        places = np.array(self._places[name])
        at = np.array([time for time, _ in known])
        order = np.argsort(times, kind="stable")
        columns = (places[order, 0], places[order, 1], np.unwrap(places[order, 2]))
        there = np.column_stack([np.interp(at, times[order], column) for column in columns])
        return _apart(there, np.array([(pose.x, pose.y, pose.yaw) for _, pose in known]))


def _apart(one: Float64Array, other: Float64Array) -> Apart:
    """Of two tracks (n, 3) of x, y and heading."""
    distance = np.hypot(*(one - other)[:, :2].T)
    turned = np.array([wrap_angle(angle) for angle in (one - other)[:, 2]])
    return Apart(
        rmse=math.sqrt(float((distance**2).mean())),
        most=float(distance.max()),
        end=float(distance[-1]),
        heading=math.sqrt(float((turned**2).mean())),
    )


def _place(pose: SE3) -> tuple[float, float, float]:
    x, y, _ = pose.translation.tolist()
    return x, y, pose.yaw


def _mounting(text: str) -> Mounting:
    """Where the instruments of the dive sat, as `Devices` logged it."""
    try:
        said = json.loads(text)["said"]
        return mounting_of(tuple(said["dvl"]), tuple(said["gauge"]))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"/mounting: expected where the instruments sit, got {text[:80]!r} ({error})"
        ) from error


def _begun(text: str) -> Begun:
    """The state that `Devices` logged, of any estimator."""
    try:
        said = json.loads(text)["said"]
        numbers = {name: np.asarray(said[name], np.float64) for name in _OF_A_STATE if name in said}
        rotation = _rotation(*numbers["wxyz"]) if "wxyz" in numbers else numbers["rotation"]
        velocity = numbers["velocity"] if "velocity" in numbers else rotation @ numbers["own_velocity"]
        bias = numbers.get("gyro_bias", np.zeros(3))
        if not all(a.shape == (3,) and np.isfinite(a).all() for a in (velocity, bias)):
            raise ValueError("velocity and bias have to be three numbers")
        return Begun(float(numbers["time"]), SE3(rotation, numbers["position"]), velocity, bias)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"/begun: expected the state of an estimator, got {text[:80]!r} ({error})"
        ) from error


_OF_A_STATE = ("time", "rotation", "wxyz", "velocity", "own_velocity", "position", "gyro_bias")


def _pose(said: Any) -> SE3:
    """Of `geometry_msgs/Pose`."""
    at, turned = said.position, said.orientation
    return SE3(_rotation(turned.w, turned.x, turned.y, turned.z), np.array([at.x, at.y, at.z]))


def _rotation(w: float, x: float, y: float, z: float) -> Float64Array:
    """(3, 3) of a unit quaternion; any other is refused: the formula takes zeros for no turn at all."""
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(length - 1.0) <= UNTRUE:
        raise ValueError(f"orientation: expected a quaternion of length 1, got {length:.6g}")
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _tell_lost(path: Path, text: str) -> None:
    """Warn of measurements that the log says it has lost: the estimate cannot be the same without them."""
    try:
        lost = json.loads(text)["lost"].get("measurement", 0)
    except (AttributeError, KeyError, TypeError, ValueError):
        return
    if lost:
        logger.warning("%s: %s measurements are missing in it, so that estimates differ", path, lost)
