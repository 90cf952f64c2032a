"""What the vehicle's sensors report → where it is, at any moment of the last seconds."""

from __future__ import annotations

import logging
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
from dream.robots.bluerov2.seabed import Seabed

logger = logging.getLogger(__name__)

Float64Array = npt.NDArray[np.float64]

KEPT = 3.0
"""Seconds of poses that can be asked for: a picture is not older than that."""
MOST_WAITING = 4096
"""Messages that wait to be taken in; a loop that is so far behind is dead."""
GAUGE_DRIFTS = 0.35
"""Metres that gauge and DVL may have climbed differently within `CLIMBED`."""
CLIMBED = 15.0
"""Seconds over which that is forgotten again: both err a little all the time."""
LEVELLED = 0.5
"""Seconds over which the force that the accelerometers feel is smoothed, to tell by it how it is tilted."""
PING_GAP = 0.6
"""Seconds between two velocities of the DVL over which a climb is reckoned."""
HEADING_JUMP, HEADING_MISSED = math.radians(1.5), 0.2
"""Radians that a heading may change between two reports beyond what the gyroscopes felt, and radians more for
each second in between."""
SAME_VELOCITIES = 3
"""Velocities of the DVL that may be the same to the last bit, one after the other."""
GYRO_GAP = 0.2
"""Seconds between two inertial samples in which it may have turned by anything."""
HEADING_STUCK = 0.5
"""Seconds for which a heading may stay the same to the last bit."""
STILL_RATE = math.radians(2.0)
"""rad/s by which the gyroscopes may scatter in a vehicle that is held still."""


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
    """Metres of the DVL above the seabed by its last report; NaN where that has none, or is not believed."""
    seabed: float
    """Metres: height of the seabed below the vehicle, smoothed; NaN where it is not known."""
    drifts: float = 0.0
    """Metres that it climbed by its gauge of late, less those by the DVL's velocities."""
    altitude_age: float = 0.0
    """Seconds since the last altitude that is believed; inf where none was."""
    altitude_problem: str = ""
    """Why altitudes are not believed, in words that stay the same while it lasts; empty where they are."""

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
    imu: InertialErrors = field(
        default_factory=lambda: InertialErrors(gyro_noise=2e-3, accelerometer_noise=2e-2, rate=50.0)
    )
    """As the link carries it: a sample in 20 ms, to a milliradian a second and a thousandth of g. What the
    thrusters do between two samples is noise, some thirty times that of the unit: a heading is held by short
    pushes."""
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
        self._seabed = Seabed()
        self._past: deque[tuple[float, SE3]] = deque()
        self._overrun = False
        self._heading: tuple[float, float] = (-math.inf, math.nan)
        """When the heading was last heard, and what it was by the autopilot."""
        self._heading_stuck_since = math.inf
        self._felt = 0.0
        """Radians that the gyroscopes felt it turn since then."""
        self._imu_time = math.nan
        self._velocity: tuple[Float64Array, int] = (np.full(3, math.nan), 0)
        """The DVL's last valid one, and how often it was said."""
        self._force = np.full(3, math.nan)
        """m/s² in `base`, smoothed."""
        self._drifts = 0.0
        self._gauge = math.nan
        """Metres of height that the gauge last told."""
        self._climb: tuple[float, float, float] | None = None
        """When the DVL last told a climb, which, in m/s, and the gauge's height then."""
        self.new_zeros: list[tuple[float, float]] = []
        """When the heading jumped though the vehicle did not turn, and by how many radians."""
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
            if isinstance(message, Dvl):
                self._sound(message)

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
            if isinstance(message, Dvl):
                if self._same_velocity(message):
                    self._refuse("dvl: the same to the last bit")
                    continue
                self._sound(message)
                self._note_climb(message)
            elif isinstance(message, Depth):
                self._gauge = message.z
            elif isinstance(message, Heading):
                if self._same_heading(message):
                    self._refuse("heading: the same to the last bit")
                    continue
                message = replace(message, yaw=wrap_angle(message.yaw - self._heading_zero))
            else:
                self._feel(message)
                message = replace(message, angular_velocity=message.angular_velocity - self._bias)
            if self._took is not None:
                self._took(message)
            outcome = self._timeline.take(message)
            if outcome.verdict.taken:
                self._note(message)
            else:
                self._refuse(f"{outcome.source}: {outcome.verdict}")
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
            altitude=self._seabed.altitude,
            seabed=self._seabed.height,
            altitude_age=self._seabed.age(now),
            altitude_problem=self._seabed.problem,
            drifts=self._drifts,
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

    def _refuse(self, why: str) -> None:
        self.refused[why] = self.refused.get(why, 0) + 1

    def _note(self, message: Imu | Measurement) -> None:
        """When each sensor last told something that the estimate took."""
        if isinstance(message, Dvl) and not message.valid:
            return
        self._last[type(message)] = max(self._last[type(message)], message.time)

    def _feel(self, imu: Imu) -> None:
        """How far the gyroscopes felt it turn; not a number where samples are missing."""
        assert self._timeline is not None
        dt = imu.time - self._imu_time
        if dt > GYRO_GAP:
            self._felt = math.nan
        elif dt > 0.0:
            bias = np.asarray(getattr(self._timeline.state, "gyro_bias", self._bias))
            self._felt += float(imu.angular_velocity[2] - bias[2]) * dt
        if np.isfinite(imu.specific_force).all():
            share = -math.expm1(-dt / LEVELLED) if dt > 0.0 else 0.0
            known = np.isfinite(self._force).all()
            self._force = (
                self._force + share * (imu.specific_force - self._force) if known else imu.specific_force
            )
        self._imu_time = imu.time

    def _same_heading(self, heading: Heading) -> bool:
        """Does the autopilot repeat itself? And a jump that the gyroscopes did not feel is a new zero.

        An autopilot that learns the declination turns its heading by that at once, and nobody is turned.
        """
        before, yaw = self._heading
        if heading.yaw == yaw:
            self._heading_stuck_since = min(self._heading_stuck_since, before)
            return heading.time - self._heading_stuck_since > HEADING_STUCK
        self._heading_stuck_since = math.inf
        jump = wrap_angle(heading.yaw - yaw - self._felt)
        if abs(jump) > HEADING_JUMP + HEADING_MISSED * (heading.time - before):
            self._heading_zero = wrap_angle(self._heading_zero + jump)
            self.new_zeros.append((heading.time, jump))
            logger.warning(
                "heading: a jump of %+.1f° that the gyroscopes did not feel is a new zero", math.degrees(jump)
            )
        self._heading, self._felt = (heading.time, heading.yaw), 0.0
        return False

    def _same_velocity(self, dvl: Dvl) -> bool:
        """Does the DVL repeat itself?"""
        velocity, said = self._velocity
        if not dvl.valid:
            return False
        self._velocity = dvl.velocity, said + 1 if np.array_equal(dvl.velocity, velocity) else 1
        return self._velocity[1] > SAME_VELOCITIES

    def _note_climb(self, dvl: Dvl) -> None:
        """How far it climbed since the last ping, by the DVL.

        Tilted as the accelerometers feel it: an estimate that is given both leans until they agree.
        """
        if not (dvl.valid and np.isfinite(self._force).all()):
            self._climb = None
            return
        rate = float(self._over_ground(dvl, _attitude(self._force, 0.0))[2])
        if self._climb is not None and 0.0 < dvl.time - self._climb[0] < PING_GAP:
            dt, gauge = dvl.time - self._climb[0], self._gauge - self._climb[2]
            apart = gauge - 0.5 * dt * (rate + self._climb[1])
            self._drifts = (self._drifts + apart) * math.exp(-dt / CLIMBED)
        self._climb = (dvl.time, rate, self._gauge) if math.isfinite(self._gauge) else None

    def _sound(self, dvl: Dvl) -> None:
        """How deep the seabed lies."""
        T_world_base = self._base_at(dvl.time)
        if T_world_base is not None:
            self._seabed.take(dvl, T_world_base @ self._instruments.mounting.T_base_dvl)

    def _base_at(self, time: float) -> SE3 | None:
        """Where the vehicle was at a time until now; None where that is not known any more."""
        if self._timeline is None:
            return None
        if not self._past or time >= self._past[-1][0]:
            newest: SE3 = self._timeline.state.pose
            return newest
        return self.at(time) if time >= self._past[0][0] else None

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
