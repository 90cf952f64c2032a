"""Force, turn rate and velocity in `base` → what ArduSub takes for them, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from dream.types import BodyVelocity
from dream.vehicle import VECTORED, VECTORED_6DOF, Thrusters

Float64Array = npt.NDArray[np.float64]

FRAMES = {1: VECTORED, 2: VECTORED_6DOF}
"""FRAME_CONFIG and what it stands for; of the others DREAM knows no thrusters."""
NEUTRAL_PWM = 1500
HALF_PWM = 400
"""Microseconds from neutral to the end of a channel."""
THROTTLE_DEAD_ZONE_PWM = 30
"""RC3_DZ, which ArduSub sets itself."""
FULL_YAW_CD = 4500.0
"""What a yaw channel at its end reads, in hundredths of a degree."""
FASTEST = 2.0
"""m/s. More than a BlueROV2 can swim is a mistake."""
FASTEST_TURN = math.pi
"""rad/s, likewise."""

BODY_NED = 8
"""MAV_FRAME: forward, right, down, turned by the heading only."""
VELOCITY_AND_YAW_RATE = 0x5C7
"""Type mask: position, acceleration and yaw are not meant."""


@dataclass(frozen=True, slots=True)
class Sticks:
    """MANUAL_CONTROL, as it goes out. Neutral by default: z has its middle at 500."""

    x: int = 0
    """−1000 to 1000, ahead."""
    y: int = 0
    """−1000 to 1000, to the right."""
    z: int = 500
    """0 to 1000, up."""
    r: int = 0
    """−1000 to 1000, clockwise seen from above."""

    def __post_init__(self) -> None:
        for name, low in (("x", -1000), ("y", -1000), ("z", 0), ("r", -1000)):
            value = getattr(self, name)
            if not isinstance(value, int) or not low <= value <= 1000:
                raise ValueError(f"sticks.{name}: expected a whole number from {low} to 1000, got {value!r}")


NEUTRAL = Sticks()


STILL = BodyVelocity(0.0, 0.0, 0.0, 0.0)


def forward_right_down(velocity: BodyVelocity) -> tuple[float, float, float, float]:
    """vx, vy, vz and yaw_rate of SET_POSITION_TARGET_LOCAL_NED in the frame BODY_NED, in m/s and rad/s.

    Raises:
        ValueError: That is faster than a BlueROV2 can be, or no number.
    """
    if not math.hypot(velocity.surge, velocity.sway, velocity.heave) <= FASTEST:
        raise ValueError(f"velocity: expected at most {FASTEST} m/s, got {velocity}")
    if not abs(velocity.yaw_rate) <= FASTEST_TURN:
        raise ValueError(f"velocity: expected at most π rad/s of yaw rate, got {velocity}")
    return velocity.surge, 0.0 - velocity.sway, 0.0 - velocity.heave, 0.0 - velocity.yaw_rate


@dataclass(frozen=True, slots=True)
class Joystick:
    """What ArduSub makes of MANUAL_CONTROL, and the sticks for what one wants.

    What it does: sticks become channels of 1500 + 0.4·gain·stick µs; that of z is
    1500 + 0.8·gain·throttle gain·(z − 500). x and y go straight to the horizontal thrusters in all modes. In
    ALT_HOLD r asks for a turn rate, linear beyond its dead zone, at which 0 means: hold the heading; and z
    for a rate of climb, likewise.
    Reference: ArduSub 4.7, `joystick.cpp`, `mode_althold.cpp`, `Attitude.cpp`, `AP_Motors6DOF.cpp`, and its
    parameters' documentation. Against its own simulation: r = 300 for 3 s gives 48° here, 42° there, where
    the vehicle first has to get going.
    Assumes: channels from 1100 to 1900 µs with 1500 as the middle, frames VECTORED and VECTORED_6DOF, every
    thruster's direction set right by MOT_n_DIRECTION.
    Fails when: the autopilot's own turning and levelling use the thrusters up: forces are then less.
    """

    thrusters: Thrusters = VECTORED
    gain: float = 0.5
    """JS_GAIN_DEFAULT, or what the vehicle reports as PilotGain: buttons change it."""
    throttle_gain: float = 1.0
    """JS_THR_GAIN."""
    yaw_p: float = 3.375
    """ACRO_YAW_P: degrees a second for a degree of stick."""
    yaw_dead_zone_pwm: int = 40
    """RC4_DZ. It shrinks with the gain (ArduSub 4.1 and later)."""
    climb: float = 5.0
    """PILOT_SPEED_UP, in m/s."""
    sink: float = 5.0
    """PILOT_SPEED_DN, in m/s."""
    throttle_dead_zone: int = 100
    """THR_DZ, of the 1000 that the channel has. It shrinks with the gain as well (`Attitude.cpp`)."""

    def __post_init__(self) -> None:
        limits = {
            "gain": (0.1, 1.0),
            "throttle_gain": (0.5, 4.0),
            "yaw_p": (0.1, 20.0),
            "yaw_dead_zone_pwm": (0, 200),
            "climb": (0.1, 10.0),
            "sink": (0.1, 10.0),
            "throttle_dead_zone": (0, 300),
        }
        for name, (low, high) in limits.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {getattr(self, name)}")
        horizontal = np.asarray(self.thrusters.directions[:4], np.float64)
        if self.thrusters.count < 4 or not np.allclose(np.sign(horizontal), _SIGNS):
            raise ValueError(
                "thrusters: expected front right, front left, rear right, rear left first, as in VECTORED, "
                f"got directions {self.thrusters.directions}"
            )

    @staticmethod
    def of(parameters: Mapping[str, float], *, gain: float | None = None) -> Joystick:
        """As a vehicle with these parameters has it; what is not among them keeps its default.

        Args:
            parameters: ArduSub's names and values, in its units.
            gain: What the vehicle reports as PilotGain, if it does.

        Raises:
            ValueError: FRAME_CONFIG is neither VECTORED nor VECTORED_6DOF, or something is out of its range.
        """
        default = Joystick()
        number = int(parameters.get("FRAME_CONFIG", 1))
        if number not in FRAMES:
            raise ValueError(
                f"FRAME_CONFIG: expected 1 (VECTORED) or 2 (VECTORED_6DOF), got {number}. "
                "Is this a BlueROV2? See the vehicle setup page of BlueOS"
            )
        climb = parameters.get("PILOT_SPEED_UP", 100.0 * default.climb) / 100.0
        sink = parameters.get("PILOT_SPEED_DN", 0.0) / 100.0
        return replace(
            default,
            thrusters=FRAMES[number],
            gain=parameters.get("JS_GAIN_DEFAULT", default.gain) if gain is None else gain,
            throttle_gain=parameters.get("JS_THR_GAIN", default.throttle_gain),
            yaw_p=parameters.get("ACRO_YAW_P", default.yaw_p),
            yaw_dead_zone_pwm=int(parameters.get("RC4_DZ", default.yaw_dead_zone_pwm)),
            climb=climb,
            sink=sink if sink > 0.0 else climb,
            throttle_dead_zone=int(parameters.get("THR_DZ", default.throttle_dead_zone)),
        )

    def sticks(self, ahead: float, left: float, *, turn_rate: float = 0.0, climb_rate: float = 0.0) -> Sticks:
        """Sticks for a force, a turn rate and a rate of climb in ALT_HOLD.

        What is more than the sticks reach is made less: a force with its direction kept.

        Args:
            ahead: Newtons in `base`.
            left: Newtons in `base`.
            turn_rate: rad/s, counter-clockwise; 0 holds the heading.
            climb_rate: m/s up; 0 holds the depth.

        Raises:
            ValueError: Something is not finite.
        """
        _finite(ahead=ahead, left=left, turn_rate=turn_rate, climb_rate=climb_rate)
        x, y = self._horizontal(ahead, left)
        return Sticks(x, y, self._z(climb_rate), self._r(turn_rate))

    def manual(self, ahead: float, left: float, moment: float) -> Sticks:
        """Sticks for a force and a moment in MANUAL, where r goes straight to the thrusters, too.

        Four thrusters make three sticks, and push harder ahead than astern, so that force and moment together
        are met within some per cent; what is more than the sticks reach is made less, all in proportion.

        Args:
            ahead: Newtons in `base`.
            left: Newtons in `base`.
            moment: N m about the vertical, counter-clockwise.

        Raises:
            ValueError: Something is not finite.
        """
        _finite(ahead=ahead, left=left, moment=moment)
        wrench = np.array([ahead, left, moment], np.float64)
        allocation = self.thrusters.allocation[np.ix_([0, 1, 5], range(4))]
        forces = np.linalg.pinv(allocation) @ wrench
        strongest = self.thrusters.forces([-1.0, 1.0])
        room = np.where(forces < 0.0, forces / strongest[0], forces / strongest[1]).max()
        shares = _MIX.T @ self.thrusters.commands(forces / max(1.0, room)) / 4.0
        shares /= max(1.0, np.abs(_MIX @ shares).max(), np.abs(shares).max() / self.gain)
        x, y, r = (round(1000.0 * float(share) / self.gain) for share in shares)
        return Sticks(x, -y, 500, -r)

    def force(self, sticks: Sticks) -> tuple[float, float]:
        """Newtons ahead and to the left that sticks give, when the autopilot does not turn meanwhile."""
        ahead, left, _ = self.wrench(replace(sticks, r=0))
        return ahead, left

    def wrench(self, sticks: Sticks) -> tuple[float, float, float]:
        """Newtons ahead and to the left, and N m counter-clockwise, that sticks give in MANUAL."""
        shares = self.gain / 1000.0 * np.array([sticks.x, -sticks.y, -sticks.r], np.float64)
        forces = self.thrusters.forces(_MIX @ shares)
        ahead, left, moment = self.thrusters.allocation[np.ix_([0, 1, 5], range(4))] @ forces
        return float(ahead), float(left), float(moment)

    def turn_rate(self, sticks: Sticks) -> float:
        """rad/s counter-clockwise that sticks ask for in ALT_HOLD; 0 holds the heading."""
        offset = 0.4 * self.gain * sticks.r
        beyond = max(0.0, abs(offset) - self._yaw_dead_zone)
        rate_deg = self.yaw_p * FULL_YAW_CD / 100.0 * beyond / (HALF_PWM - self._yaw_dead_zone)
        return -math.copysign(math.radians(rate_deg), offset) if beyond else 0.0

    def climb_rate(self, sticks: Sticks) -> float:
        """m/s up that sticks ask for in ALT_HOLD; 0 holds the depth."""
        pwm = NEUTRAL_PWM + 0.8 * self.gain * self.throttle_gain * (sticks.z - 500)
        low, high = self._throttle_band
        reading = min(1000.0, max(0.0, _throttle_reading(pwm)))
        if reading > high:
            return self.climb * (reading - high) / (1000.0 - high)
        return self.sink * (reading - low) / low if reading < low else 0.0

    @property
    def _yaw_dead_zone(self) -> int:
        return int(self.yaw_dead_zone_pwm * self.gain)

    @property
    def _throttle_band(self) -> tuple[float, float]:
        middle, dead = float(int(_throttle_reading(NEUTRAL_PWM))), self.throttle_dead_zone * self.gain
        return middle - dead, middle + dead

    def _horizontal(self, ahead: float, left: float) -> tuple[int, int]:
        """x and y: thrusters sit in pairs on the two diagonals, and each pair hears one sum of x and y."""
        commands, pairs = _pair(self.thrusters)
        force = np.array([ahead + left, ahead - left]) / math.sqrt(2.0)
        force *= min(1.0, pairs[-1] / max(pairs[-1], np.abs(force).max()))

        def shares(part: float) -> Float64Array:
            p, q = np.sign(force) * np.interp(part * np.abs(force), pairs, commands)
            return 0.5 * np.array([p + q, p - q])

        part = 1.0
        if np.abs(shares(part)).max() > self.gain:
            reach, beyond = 0.0, 1.0
            for _ in range(30):
                part = 0.5 * (reach + beyond)
                reach, beyond = (part, beyond) if np.abs(shares(part)).max() <= self.gain else (reach, part)
            part = reach
        x, y = (round(1000.0 * float(share) / self.gain) for share in shares(part))
        return x, -y

    def _r(self, turn_rate: float) -> int:
        if turn_rate == 0.0:
            return 0
        share = abs(math.degrees(turn_rate)) * 100.0 / (self.yaw_p * FULL_YAW_CD)
        offset = self._yaw_dead_zone + share * (HALF_PWM - self._yaw_dead_zone)
        return round(-math.copysign(min(1000.0, offset / (0.4 * self.gain)), turn_rate))

    def _z(self, climb_rate: float) -> int:
        if climb_rate == 0.0:
            return 500
        low, high = self._throttle_band
        if climb_rate > 0.0:
            reading = high + climb_rate / self.climb * (1000.0 - high)
        else:
            reading = low + climb_rate / self.sink * low
        pwm = NEUTRAL_PWM - HALF_PWM + THROTTLE_DEAD_ZONE_PWM
        pwm_wanted = pwm + reading / 1000.0 * (2 * HALF_PWM - THROTTLE_DEAD_ZONE_PWM)
        offset = (pwm_wanted - NEUTRAL_PWM) / (0.8 * self.gain * self.throttle_gain)
        return round(min(1000.0, max(0.0, 500.0 + offset)))


_SIGNS = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]], np.float64)
"""Directions of front right, front left, rear right and rear left; 0 is the vertical."""
_MIX = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float64)
"""(4, 3) what ahead, left and counter-clockwise each add to a thruster's command. ArduSub counts its commands
and two of these axes the other way round, and gets the same."""


@lru_cache(maxsize=8)
def _pair(thrusters: Thrusters) -> tuple[Float64Array, Float64Array]:
    """Commands from the end of the dead band to 1, and the force of a pair, one ahead and one astern."""
    commands = np.linspace(0.0, 1.0, 4001)
    forces = thrusters.forces(commands) - thrusters.forces(-commands)
    first = int(np.searchsorted(forces, 0.0, side="right")) - 1
    return commands[first:], forces[first:]


def _throttle_reading(pwm: float) -> float:
    start = NEUTRAL_PWM - HALF_PWM + THROTTLE_DEAD_ZONE_PWM
    return 1000.0 * (pwm - start) / (2 * HALF_PWM - THROTTLE_DEAD_ZONE_PWM)


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise ValueError(f"{name}: expected a finite number, got {value}. Is the estimate alive?")
