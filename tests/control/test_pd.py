"""The paper's tracking law, corrected."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from dream.control import Pd, _kernels
from dream.control.autopilot import Autopilot, nominal
from dream.geometry import SE2, SE3, wrap_angle
from dream.sim.vehicle import BLUEROV2_HEAVY
from dream.types import BodyVelocity, Setpoint

Array = npt.NDArray[np.float64]
HEADINGS = [math.radians(degrees) for degrees in range(-180, 180, 15)]
STILL = BodyVelocity(0.0, 0.0, 0.0, 0.0)
BEAT = 0.05
"""Seconds."""
Law = Callable[[SE2, BodyVelocity, Setpoint], BodyVelocity]


def printed(pose: SE2, velocity: BodyVelocity, setpoint: Setpoint) -> BodyVelocity:
    """The law as the paper prints it: the error is turned by the error of the heading."""
    law = Pd()
    turn = wrap_angle(setpoint.yaw - pose.yaw)
    c, s = math.cos(turn), math.sin(turn)
    east, north = setpoint.x - pose.x, setpoint.y - pose.y
    right = law.track(pose, velocity, setpoint)
    surge = law.K_p * (c * east + s * north) - law.K_d * velocity.surge
    sway = law.K_p * (-s * east + c * north) - law.K_d * velocity.sway
    return BodyVelocity(surge, sway, 0.0, right.yaw_rate)


def flown(law: Law, start: SE2, goal: Setpoint, seconds: float = 20.0) -> SE2:
    """Where a vehicle ends that does what it is told with a lag of 0.3 s."""
    x, y, yaw, now = start.x, start.y, start.yaw, np.zeros(3)
    for _ in range(round(seconds / BEAT)):
        told = law(SE2(x, y, yaw), BodyVelocity(now[0], now[1], 0.0, now[2]), goal)
        now += (np.array([told.surge, told.sway, told.yaw_rate]) - now) * BEAT / 0.3
        x += (math.cos(yaw) * now[0] - math.sin(yaw) * now[1]) * BEAT
        y += (math.sin(yaw) * now[0] + math.cos(yaw) * now[1]) * BEAT
        yaw = wrap_angle(yaw + now[2] * BEAT)
        if math.hypot(x, y) > 100.0:
            break
    return SE2(x, y, yaw)


@pytest.mark.parametrize("yaw", HEADINGS)
def test_it_reaches_its_goal_at_every_heading(yaw: float) -> None:
    goal = Setpoint(3.0, -2.0, yaw, 2.0)
    end = flown(Pd().track, SE2(0.0, 0.0, yaw), goal)
    assert end.distance(SE2(goal.x, goal.y, goal.yaw)) < 0.01
    assert abs(wrap_angle(end.yaw - yaw)) < 1e-3


@pytest.mark.parametrize("degrees", [120, 150, 180, -120])
def test_as_it_is_printed_it_drives_away_where_the_goal_looks_west(degrees: int) -> None:
    yaw = math.radians(degrees)
    end = flown(printed, SE2(0.0, 0.0, yaw), Setpoint(3.0, -2.0, yaw, 2.0))
    assert math.hypot(end.x - 3.0, end.y + 2.0) > 20.0


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi])
def test_it_is_the_law_in_matrices(yaw: float) -> None:
    law = Pd(K_p=0.7, K_d=0.1, k_psi=1.3, k_r=0.3)
    pose, goal = SE2(1.0, 2.0, yaw), Setpoint(-2.0, 2.5, wrap_angle(yaw + 0.4), 2.0)
    R = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    speed = np.array([0.2, -0.1])
    u, v = 0.7 * R.T @ np.array([goal.x - pose.x, goal.y - pose.y]) - 0.1 * speed
    told = law.track(pose, BodyVelocity(0.2, -0.1, 0.3, 0.05), goal)
    assert (told.surge, told.sway, told.heave) == pytest.approx((u, v, 0.0))
    assert told.yaw_rate == pytest.approx(1.3 * 0.4 - 0.3 * 0.05)


def flying(pose: SE2, velocity: BodyVelocity, goal: Setpoint) -> tuple[Array, Array]:
    """Of the loop that flies, about a reference at rest: what velocities lack, and what it does about it.

    Both of surge, sway, heave and yaw. What it does are accelerations of a vehicle that has no drag, and that
    nothing pushes or lifts.
    """
    gains, model = Autopilot().gains, nominal(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters)
    model = model._replace(linear=np.zeros(6), quadratic=np.zeros(6), lift=0.0)
    memory = _kernels.begin(np.array([goal.x, goal.y, -3.0]), goal.yaw, 0.0)
    at = SE3.level(pose.x, pose.y, -3.0, pose.yaw)
    R = at.rotation.astype(np.float64)
    over_ground = R @ [velocity.surge, velocity.sway, 0.0]
    rates = np.array([0.0, 0.0, velocity.yaw_rate])
    wrench, error, _ = _kernels.wrench(
        memory, (0.0, 0.0, 0.0, 0.0), R, at.translation.astype(np.float64), over_ground, rates, gains, model
    )
    return np.append(R.T @ error[:3], error[3]), (wrench / model.inertia)[[0, 1, 2, 5]]


def numbers(velocity: BodyVelocity) -> tuple[float, float, float, float]:
    return velocity.surge, velocity.sway, velocity.heave, velocity.yaw_rate


@pytest.mark.parametrize("yaw", HEADINGS)
def test_the_loop_that_flies_follows_a_reference_at_rest_by_this_law(yaw: float) -> None:
    pilot = Autopilot()
    pose, goal = SE2(1.0, 2.0, yaw), Setpoint(-2.0, 2.5, wrap_angle(yaw + 2.8), 2.0)
    moving = BodyVelocity(0.3, -0.2, 0.0, 0.4)
    # With nothing taken off, to be at a velocity; with all of it, what is lacking of that.
    asked = Pd(K_p=pilot.position, K_d=0.0, k_psi=pilot.yaw, k_r=0.0).track(pose, moving, goal)
    lacked = Pd(K_p=pilot.position, K_d=1.0, k_psi=pilot.yaw, k_r=1.0).track(pose, moving, goal)
    at_rest, _ = flying(pose, STILL, goal)
    assert at_rest == pytest.approx(numbers(asked), abs=1e-12)
    lacking, done = flying(pose, moving, goal)
    assert lacking == pytest.approx(numbers(lacked), abs=1e-12)
    # The second loop, and the rate at which what the law asks for falls while the vehicle moves.
    accelerations = (
        pilot.velocity * lacked.surge - pilot.position * moving.surge,
        pilot.velocity * lacked.sway - pilot.position * moving.sway,
        0.0,
        pilot.yaw_rate * lacked.yaw_rate - pilot.yaw * moving.yaw_rate,
    )
    assert done == pytest.approx(accelerations, abs=1e-12)


def test_of_a_reference_that_moves_the_velocity_is_added() -> None:
    assert _kernels.track(2.0, 0.3, 0.4, 1.5, 1.0) == pytest.approx(0.4 + 1.5 * 2.0 - 0.3)


def test_it_turns_the_short_way() -> None:
    told = Pd().track(SE2(0.0, 0.0, math.radians(170)), STILL, Setpoint(0.0, 0.0, math.radians(-170), 2.0))
    assert told.yaw_rate == pytest.approx(math.radians(20) * Pd().k_psi)


@pytest.mark.parametrize("gain", ["K_p", "K_d", "k_psi", "k_r"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_a_gain_that_is_none_is_refused_by_name(gain: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{gain}: expected a gain of 0 or more"):
        Pd(**{gain: value})
