"""What the vehicle's sensors report → where it is, at any moment of the last seconds."""

from __future__ import annotations

import math
import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from dream.estimation import Cipg, DeadReckoning, Ekf, InEkf, InertialErrors, Mounting, Start, Timeline
from dream.geometry import SE2, SE3, wrap_angle
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement

Float64Array = npt.NDArray[np.float64]

KEPT = 3.0
"""Seconds of poses that can be asked for: a picture is not older than that."""
MOST_WAITING = 4096
"""Messages that wait to be taken in; a loop that is so far behind is dead."""
STILL_RATE = math.radians(2.0)
"""rad/s by which the gyroscopes may scatter in a vehicle that is held still."""
SEABED_TIME = 2.0
"""Seconds over which the height of the seabed is smoothed: what lies on it hardly lifts the vehicle."""


class State(Protocol):
    """What any estimator's state tells."""

    @property
    def time(self) -> float: ...  # noqa: D102
    @property
    def pose(self) -> SE3: ...  # noqa: D102
    @property
    def velocity(self) -> Float64Array: ...  # noqa: D102
    @property
    def angular_velocity(self) -> Float64Array: ...  # noqa: D102


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """Where the vehicle is and how it moves, and how far that can be relied on."""

    time: float
    """Seconds since the dive began."""
    T_world_base: SE3
    velocity: Float64Array
    """(3,) m/s over ground, in the world."""
    angular_velocity: Float64Array
    """(3,) rad/s, in `base`."""
    velocity_sigma: float
    """m/s of its least certain axis; 0 of an estimator that does not say."""
    position_sigma: float
    """Metres of its less certain horizontal axis; 0 likewise."""
    imu_age: float
    """Seconds since the last inertial sample; inf where there never was one."""
    depth_age: float
    dvl_age: float
    """Since the last velocity with bottom lock."""
    heading_age: float
    altitude: float
    """Metres above the seabed by the DVL's last report; NaN where none came back."""
    seabed: float
    """Metres: height of the seabed below the vehicle, smoothed; NaN where it was never measured."""

    @property
    def pose(self) -> SE3:
        """`T_world_base`, by the name that estimators' states have for it."""
        return self.T_world_base


class NotReady(ValueError):  # noqa: N818 - it says what is.
    """The sensors do not allow to begin; the message says which, and why."""


DVL_AT, GAUGE_AT = (-0.15, 0.0, -0.1), (-0.2, 0.0, 0.0)
"""Metres from the autopilot, forward, left and up, of the DVL and of the pressure sensor."""
ABOARD = 1.0
"""Metres from the autopilot beyond which nothing sits on a BlueROV2."""


def mounting_of(
    dvl: tuple[float, float, float] = DVL_AT, gauge: tuple[float, float, float] = GAUGE_AT
) -> Mounting:
    """Where the instruments sit, metres from the autopilot: forward, left, up. The DVL looks as `base` does.

    Raises:
        ValueError: That is not on the vehicle.
    """
    for name, place in (("dvl", dvl), ("gauge", gauge)):
        check_aboard(name, place)
    return Mounting(SE3.level(*dvl, 0.0), gauge)


def check_aboard(name: str, place: tuple[float, float, float]) -> None:
    """Raise a ValueError unless a place, metres from the autopilot, is on the vehicle."""
    if not (len(place) == 3 and all(abs(value) <= ABOARD for value in place)):
        raise ValueError(
            f"{name}: expected metres from the autopilot, forward, left and up, within {ABOARD:g} m, "
            f"got {place}. Are they millimetres?"
        )


@dataclass(frozen=True, slots=True)
class Instruments:
    """Which estimator reads which instruments, and where they sit."""

    estimator: str = "inekf"
    """`inekf`, `ekf`, `cipg` or `dead-reckoning`."""
    mounting: Mounting = field(default_factory=mounting_of)
    imu: InertialErrors = field(default_factory=lambda: InertialErrors(rate=50.0))
    """At the rate of the link, not of the unit."""
    start: Start = field(
        default_factory=lambda: Start(
            tilt=math.radians(2.0), yaw=math.radians(1.0), velocity=0.05, gyro_bias=math.radians(0.1)
        )
    )

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise ValueError(f"estimator: expected one of {', '.join(ESTIMATORS)}, got {self.estimator!r}")

    @property
    def filter(self) -> InEkf | Ekf | Cipg | DeadReckoning:
        """The estimator, knowing all of it."""
        if self.estimator == "cipg":
            return Cipg(mounting=self.mounting)
        if self.estimator == "dead-reckoning":
            return DeadReckoning(mounting=self.mounting)
        kind = InEkf if self.estimator == "inekf" else Ekf
        return kind(imu=self.imu, mounting=self.mounting, start=self.start)


ESTIMATORS = ("inekf", "ekf", "cipg", "dead-reckoning")


class Navigator:
    """Carries an estimate along with messages that come in on other threads.

    What it does: `deliver` may be called from any thread and only queues; whoever steers calls `update`,
    which takes in what has come and says where the vehicle is. At the launch the vehicle lies still at a pose
    that the operator states: from that come roll and pitch, the gyroscopes' biases, and what the compass
    reads too much in the frame of the map.

    Assumes: one thread calls `align` and `update`; times on one clock.
    """

    def __init__(
        self,
        instruments: Instruments,
        now: Callable[[], float],
        *,
        took: Callable[[Imu | Measurement], None] | None = None,
        began: Callable[[State], None] | None = None,
    ) -> None:
        """Ready to hear; not aligned yet.

        Args:
            instruments: Which estimator reads which instruments.
            now: The dive's clock.
            took: Told of each message as the estimator is given it, in that order.
            began: Told of the state that the estimator begins with. With both, the estimate can be made
                again.
        """
        self._took, self._told_begin = took, began
        self._instruments = instruments
        self._now = now
        self._waiting: deque[Imu | Measurement] = deque(maxlen=MOST_WAITING)
        self._lock = threading.Lock()
        self._timeline: Timeline[Any] | None = None
        self._last = dict.fromkeys((Imu, Dvl, Depth, Heading), -math.inf)
        self._heading_zero = 0.0
        self._bias = np.zeros(3)
        self._altitude = self._seabed = math.nan
        self._seabed_time = -math.inf
        self._past: deque[tuple[float, SE3]] = deque()
        self._overrun = False
        self.refused: dict[str, int] = {}
        """Messages that the estimate did not take, by source and reason."""

    def deliver(self, message: Imu | Measurement) -> None:
        """Take a message to the queue. Where nobody takes them in for long, `update` will say so."""
        with self._lock:
            self._overrun |= len(self._waiting) == MOST_WAITING
            self._waiting.append(message)

    def align(self, start: SE2, messages: list[Imu | Measurement] | None = None) -> None:
        """Begin at a pose of the map where the vehicle has been lying still, by what came in until now.

        Args:
            start: Where it lies, by the operator's word.
            messages: What the sensors said in the seconds before; what is queued, if not given.

        Raises:
            NotReady: A sensor is silent, or the vehicle does not lie still.
        """
        heard = self._drained() if messages is None else messages
        samples = [m for m in heard if isinstance(m, Imu)]
        depths = [m for m in heard if isinstance(m, Depth)]
        headings = [m for m in heard if isinstance(m, Heading)]
        locks = [m for m in heard if isinstance(m, Dvl) and m.valid]
        for name, said in (("inertial samples", samples), ("depths", depths), ("headings", headings)):
            if len(said) < 5:
                raise NotReady(
                    f"navigation: expected {name} from the autopilot, got {len(said)}. Is the link up?"
                )
        if len(locks) < 3:
            raise NotReady(
                f"navigation: expected a DVL with bottom lock, got {len(locks)} valid velocities. "
                "Is it in the water, and high enough above the floor?"
            )
        rates = np.array([sample.angular_velocity for sample in samples])
        forces = np.array([sample.specific_force for sample in samples])
        scatter = float(rates.std(axis=0).max())
        if not scatter <= STILL_RATE:
            raise NotReady(
                f"navigation: expected a vehicle that lies still, got turn rates that scatter by "
                f"{math.degrees(scatter):.1f}°/s. Hold it, and try again"
            )
        force, bias = forces.mean(axis=0), rates.mean(axis=0)
        if not 0.8 * 9.81 < float(np.linalg.norm(force)) < 1.2 * 9.81:
            raise NotReady(
                f"navigation: expected a specific force near 9.8 m/s², got {np.linalg.norm(force):.2f}"
            )
        self._heading_zero = _mean_angle(np.array([m.yaw for m in headings]) - start.yaw)
        rotation = _attitude(force, start.yaw)
        lever = rotation @ np.asarray(self._instruments.mounting.pressure_sensor)
        z = float(np.mean([m.z for m in depths])) - float(lever[2])
        begun = samples[-1].time
        velocity = np.mean([self._over_ground(m, rotation) for m in locks[-5:]], axis=0)
        estimator = self._instruments.filter
        state = estimator.begin(begun, SE3(rotation, np.array([start.x, start.y, z])), velocity)
        if hasattr(state, "gyro_bias"):
            state = replace(state, gyro_bias=bias)
        else:
            # An estimator that knows of no bias is given samples without.
            self._bias = bias
        self._timeline = Timeline(estimator, state)
        if self._told_begin is not None:
            self._told_begin(state)
        self._past.clear()
        # What waits was heard before, or will be missed by a few hundredths of a second.
        self._drained()
        self._overrun = False
        for message in heard:
            self._note(message)

    def update(self) -> Fix:
        """Take in all that waits, and say where the vehicle is.

        Raises:
            NotReady: It was never aligned, or messages were lost since.
        """
        if self._timeline is None:
            raise NotReady("navigation: expected align() before, got none")
        if self._overrun:
            raise NotReady(
                f"navigation: expected messages to be taken in, got {MOST_WAITING} that wait; others are lost"
            )
        for message in self._drained():
            self._note(message)
            if isinstance(message, Heading):
                message = replace(message, yaw=wrap_angle(message.yaw - self._heading_zero))
            elif isinstance(message, Imu):
                message = replace(message, angular_velocity=message.angular_velocity - self._bias)
            if self._took is not None:
                self._took(message)
            outcome = self._timeline.take(message)
            if not outcome.verdict.taken:
                key = f"{outcome.source}: {outcome.verdict}"
                self.refused[key] = self.refused.get(key, 0) + 1
        state, now = self._timeline.state, self._now()
        if self._past and self._past[-1][0] >= state.time:
            self._past.pop()
        self._past.append((state.time, state.pose))
        while self._past and self._past[0][0] < state.time - KEPT:
            self._past.popleft()
        ages = {kind: now - last for kind, last in self._last.items()}
        covariance = getattr(state, "position_covariance", None)
        return Fix(
            time=state.time,
            T_world_base=state.pose,
            velocity=np.asarray(state.velocity, np.float64),
            angular_velocity=np.asarray(state.angular_velocity, np.float64),
            velocity_sigma=_velocity_sigma(state),
            position_sigma=0.0 if covariance is None else _sigma(covariance[:2, :2]),
            imu_age=ages[Imu],
            depth_age=ages[Depth],
            dvl_age=ages[Dvl],
            heading_age=ages[Heading],
            altitude=self._altitude,
            seabed=self._seabed,
        )

    def at(self, time: float) -> SE3:
        """`T_world_base` at a time of the last seconds: the estimate nearest to it, carried on evenly.

        Raises:
            NotReady: It is older than what is kept.
        """
        past = list(self._past)
        if not past or time < past[0][0] - 0.1:
            raise NotReady(f"navigation: expected a time within the last {KEPT:g} s, got one before")
        k = min(max(bisect_left(past, time, key=lambda entry: entry[0]), 1), len(past) - 1)
        if len(past) == 1 or time >= past[-1][0]:
            return past[-1][1]
        (before, a), (after, b) = past[k - 1], past[k]
        share = (time - before) / (after - before)
        turn = wrap_angle(b.yaw - a.yaw)
        # Roll and pitch hardly change between two updates: those of the nearer are taken.
        near = a if share < 0.5 else b
        missing = share * turn if near is a else (share - 1.0) * turn
        rotation = SE3.level(0.0, 0.0, 0.0, missing).rotation @ near.rotation
        return SE3(rotation, (1.0 - share) * a.translation + share * b.translation)

    def _drained(self) -> list[Imu | Measurement]:
        with self._lock:
            messages = list(self._waiting)
            self._waiting.clear()
        return messages

    def _note(self, message: Imu | Measurement) -> None:
        """When each sensor was last heard, and how deep the seabed lies."""
        if isinstance(message, Dvl):
            self._note_altitude(message)
            if not message.valid:
                return
        self._last[type(message)] = max(self._last[type(message)], message.time)

    def _note_altitude(self, dvl: Dvl) -> None:
        self._altitude = dvl.altitude
        if not (math.isfinite(dvl.altitude) and dvl.valid and self._timeline is not None):
            return
        pose = self._timeline.state.pose
        sonar = pose @ np.asarray(self._instruments.mounting.T_base_dvl.translation)
        seabed = float(sonar[2]) - dvl.altitude
        if math.isnan(self._seabed):
            self._seabed = seabed
        share = min(max(dvl.time - self._seabed_time, 0.0) / SEABED_TIME, 1.0)
        self._seabed += share * (seabed - self._seabed)
        self._seabed_time = max(dvl.time, self._seabed_time)

    def _over_ground(self, dvl: Dvl, rotation: Float64Array) -> Float64Array:
        mounting = self._instruments.mounting.T_base_dvl
        return np.asarray(rotation @ (mounting.rotation @ dvl.velocity), np.float64)


def _attitude(force: Float64Array, yaw: float) -> Float64Array:
    """(3, 3) `R_world_base` of a vehicle at rest: roll and pitch from the specific force (3,), in `base`."""
    x, y, z = force / np.linalg.norm(force)
    roll, pitch = math.atan2(y, z), math.asin(-x)
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    tilt = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
    return np.asarray(SE3.level(0.0, 0.0, 0.0, yaw).rotation @ tilt, np.float64)


def _mean_angle(angles: Float64Array) -> float:
    return math.atan2(float(np.sin(angles).mean()), float(np.cos(angles).mean()))


def _sigma(covariance: Float64Array) -> float:
    """Of the least certain axis."""
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


def _velocity_sigma(state: Any) -> float:
    covariance = getattr(state, "velocity_covariance", None)
    return 0.0 if covariance is None else _sigma(covariance)
