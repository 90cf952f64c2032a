"""Sticks → pulse widths → commands: ArduSub's joystick law and its mixing tables.

Axes are ArduSub's, forward-right-down: roll and yaw clockwise, pitch nose up, and beside them throttle up,
forward and lateral to the right, all in [−1, 1]. Pulse widths are microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]

NEUTRAL_PWM, HALF_PWM = 1500, 400
"""Microseconds: no thrust, and how far full thrust is from that."""

VECTORED_MIX = (
    (0.0, 0.0, 1.0, 0.0, -1.0, 1.0),
    (0.0, 0.0, -1.0, 0.0, -1.0, -1.0),
    (0.0, 0.0, -1.0, 0.0, 1.0, 1.0),
    (0.0, 0.0, 1.0, 0.0, 1.0, -1.0),
    (1.0, 0.0, 0.0, -1.0, 0.0, 0.0),
    (-1.0, 0.0, 0.0, -1.0, 0.0, 0.0),
)
"""Roll, pitch, yaw, throttle, forward and lateral of each motor of the frame VECTORED (FRAME_CONFIG 1)."""
VECTORED_6DOF_MIX = (
    *VECTORED_MIX[:4],
    (1.0, -1.0, 0.0, -1.0, 0.0, 0.0),
    (-1.0, -1.0, 0.0, -1.0, 0.0, 0.0),
    (1.0, 1.0, 0.0, -1.0, 0.0, 0.0),
    (-1.0, 1.0, 0.0, -1.0, 0.0, 0.0),
)
"""The same of VECTORED_6DOF (FRAME_CONFIG 2), the Heavy."""
FRAMES = {1: ("VECTORED", VECTORED_MIX), 2: ("VECTORED_6DOF", VECTORED_6DOF_MIX)}
"""Name and table by FRAME_CONFIG."""


@dataclass(frozen=True, slots=True)
class Channels:
    """What the pilot asks for, as pulse widths of the input channels."""

    pitch: int = NEUTRAL_PWM
    roll: int = NEUTRAL_PWM
    throttle: int = NEUTRAL_PWM
    yaw: int = NEUTRAL_PWM
    forward: int = NEUTRAL_PWM
    lateral: int = NEUTRAL_PWM

    @staticmethod
    def of(x: int, y: int, z: int, r: int, *, gain: float, throttle_gain: float) -> Channels:
        """From MANUAL_CONTROL: x, y and r in [−1000, 1000], z in [0, 1000] with 500 in the middle.

        1500 + 0.4 gain x, for the throttle 1500 + 0.8 gain JS_THR_GAIN (z − 500); from 1100 to 1900.
        """
        turn, climb = 0.4 * gain, 0.8 * gain * throttle_gain
        return Channels(
            throttle=_pulse(climb * (z - 500)),
            yaw=_pulse(turn * r),
            forward=_pulse(turn * x),
            lateral=_pulse(turn * y),
        )

    def tilted(self, s: int, t: int) -> Channels:
        """With the extension axes of MANUAL_CONTROL, pitch s and roll t: microseconds, whatever the gain."""
        return replace(self, pitch=_pulse(s), roll=_pulse(t))


def _pulse(away: float) -> int:
    # Cut towards zero, as an integer conversion does.
    return int(min(max(NEUTRAL_PWM + away, NEUTRAL_PWM - HALF_PWM), NEUTRAL_PWM + HALF_PWM))


def share(pwm: int) -> float:
    """In [−1, 1]: a stick's pulse width from the middle."""
    return min(max((pwm - NEUTRAL_PWM) / HALF_PWM, -1.0), 1.0)


def mixed(axes: npt.ArrayLike, table: Float64Array, directions: Float64Array) -> list[int]:
    """Pulse widths of the motors for (roll, pitch, yaw, throttle, forward, lateral), in [−1, 1].

    With eight motors, what turns and lifts (roll, pitch, throttle) and what moves on a plane (yaw, forward,
    lateral) are each scaled down together where they exceed full thrust; with six, each motor is cut.
    """
    wanted = np.clip(np.asarray(axes, np.float64), -1.0, 1.0)
    lift = table[:, [0, 1, 3]] @ wanted[[0, 1, 3]]
    plane = table[:, [2, 4, 5]] @ wanted[[2, 4, 5]]
    if len(table) == 8:
        lift /= max(float(np.abs(lift).max()), 1.0)
        plane /= max(float(np.abs(plane).max()), 1.0)
    thrust = np.clip(lift + plane, -1.0, 1.0)
    pulses = np.rint(NEUTRAL_PWM + HALF_PWM * directions * thrust).astype(int)
    return [int(pulse) for pulse in pulses]


def commands(pulses: list[int]) -> Float64Array:
    """Commands of `dream.vehicle.Thrusters` for pulse widths.

    The propellers sit such that with all MOT_n_DIRECTION at 1 a longer pulse pulls each thruster against the
    direction that `Thrusters` calls positive: that is what makes the mixing tables push the right way.
    """
    return np.array([-(pulse - NEUTRAL_PWM) / HALF_PWM for pulse in pulses])
