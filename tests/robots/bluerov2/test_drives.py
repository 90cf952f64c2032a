"""GUIDED flown in closed loop: the stand-in's autopilot, stepped by hand, with the truth for an estimate."""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import pytest

from dream.geometry import SE2, wrap_angle
from dream.robots.bluerov2.drives import Guided
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.helm import GUIDED
from dream.robots.bluerov2.sticks import Joystick, forward_right_down
from dream.sim.worlds import make_world
from dream.types import BodyVelocity

BEAT = 0.04
LATE = 2
"""Beats that a command is under way."""


@dataclass
class Wire:
    """Takes what the drive commands."""

    sent: list[BodyVelocity] = field(default_factory=list)

    def operator_alive(self) -> None: ...

    def command(self, order: BodyVelocity, expires: float) -> None:
        self.sent.append(order)


def fix_of(standin: StandIn) -> Fix:
    state = standin.tank.state
    return Fix(
        time=standin.tank.time,
        T_world_base=standin.T_world_base,
        velocity=np.array(state.velocity_world),
        angular_velocity=np.array(standin.tank.imu.angular_velocity),
        velocity_sigma=0.01,
        position_sigma=0.01,
        imu_age=0.0,
        depth_age=0.0,
        dvl_age=0.0,
        heading_age=0.0,
        altitude=0.6,
        seabed=float(standin.T_world_base.translation[2]) - 0.6,
    )


@pytest.mark.parametrize(("turn", "advance"), [(0.0, 0.2), (0.26, 0.2), (2.0, 0.7)])
def test_a_move_in_guided_ends_at_its_goal_and_does_not_pass_it(turn: float, advance: float) -> None:
    with StandIn(make_world("pool/arc", 1), seed=1) as standin:
        sub = standin.ardusub
        sub.fix = True
        sub.parameters.change("FS_PILOT_INPUT", 0)
        standin.step(1.0)
        assert sub.set_mode(GUIDED)
        assert sub.arm()
        wire = Wire()
        drive = Guided(wire, Joystick.of({"FRAME_CONFIG": 2.0}))  # type: ignore[arg-type]
        drive.begin(fix_of(standin))
        under_way = deque([BodyVelocity(0.0, 0.0, 0.0, 0.0)] * LATE)
        start, z = standin.T_world_base.se2, float(standin.T_world_base.translation[2])
        yaw = start.yaw + turn
        turned = SE2(start.x, start.y, yaw)
        goal = SE2(start.x + advance * math.cos(yaw), start.y + advance * math.sin(yaw), yaw)
        passed = 0.0
        for towards, seconds in ((turned, 5.0), (goal, 8.0)):
            for _ in range(round(seconds / BEAT)):
                drive.steer(fix_of(standin), towards, z, BEAT, 1.0, 0.0)
                under_way.append(wire.sent[-1])
                north, east, down, clockwise = ned(under_way.popleft(), sub.helm.yaw)
                sub.helm.follow((north, east, -down), turn=clockwise)
                standin.step(BEAT)
                here = standin.T_world_base.se2
                ahead = (here.x - goal.x) * math.cos(yaw) + (here.y - goal.y) * math.sin(yaw)
                passed = max(passed, ahead)
        here = standin.T_world_base.se2
        assert here.distance(goal) < 0.03
        assert abs(wrap_angle(here.yaw - goal.yaw)) < math.radians(2.5)
        assert passed < 0.02
        assert abs(float(standin.T_world_base.translation[2]) - z) < 0.05


def ned(velocity: BodyVelocity, yaw: float) -> tuple[float, float, float, float]:
    """As the autopilot turns a velocity of BODY_NED by its heading; the rate of turn is left as it is."""
    ahead, right, down, clockwise = forward_right_down(velocity)
    c, s = math.cos(yaw), math.sin(yaw)
    return c * ahead - s * right, s * ahead + c * right, down, clockwise
