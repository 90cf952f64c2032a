"""The drives: what goes out on the wire, and what is left of it when all has to stop."""

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from dream.geometry import SE2
from dream.robots.bluerov2.bridge import LastResort
from dream.robots.bluerov2.drives import CARROT, GENTLE, HIGHEST, AltHold, Guided
from dream.robots.bluerov2.sticks import Joystick, Sticks
from dream.types import BodyVelocity
from dream.vehicle import VECTORED_6DOF
from tests.robots.bluerov2.test_bridge import fix_at


@dataclass
class Wire:
    """A link that only remembers."""

    age: float = 0.1
    own_altitude: float = -0.4
    """Half a metre above what our own reckoning has: the autopilot has its zero elsewhere."""
    sent: list[tuple[Sticks | BodyVelocity, float]] = field(default_factory=list)
    depths: list[float] = field(default_factory=list)
    stops: int = 0
    modes: list[str] = field(default_factory=list)
    refuses: bool = False
    armed_by_other: str = ""
    yielding: str = ""

    @property
    def telemetry(self) -> SimpleNamespace:
        return SimpleNamespace(
            own_altitude=self.own_altitude,
            own_altitude_age=self.age,
            armed=True,
            heartbeat_age=0.1,
            voltage=15.0,
            depth=0.9,
            leak=False,
            reboots=0,
        )

    def command(self, order: Sticks | BodyVelocity, expires: float) -> None:
        self.sent.append((order, expires))

    def depth_target(self, z: float) -> None:
        if self.refuses:
            raise RuntimeError("not in ALT_HOLD")
        self.depths.append(z)

    def stop(self) -> None:
        self.stops += 1

    def operator_alive(self) -> None:
        pass

    def set_mode(self, name: str) -> None:
        self.modes.append(name)


def alt_hold(wire: Wire) -> AltHold:
    drive = AltHold(wire, Joystick(thrusters=VECTORED_6DOF))  # type: ignore[arg-type]
    drive.begin(fix_at())
    return drive


def steer(drive: AltHold | Guided, z: float, *, goal: SE2 | None = None, beats: int = 1) -> None:
    for k in range(beats):
        drive.steer(fix_at(time=0.04 * k), goal or SE2(0.0, 0.0, 0.0), z, 0.04, 1.0, 0.4)


def test_a_depth_target_is_never_far_away_and_in_the_autopilots_own_reckoning() -> None:
    wire = Wire()
    steer(alt_hold(wire), -9.4)  # The vehicle is at -0.9 m.
    assert wire.depths == [pytest.approx(-0.4 - CARROT)]
    wire.depths.clear()
    steer(alt_hold(wire), -1.0)
    assert wire.depths == [pytest.approx(-0.5)]


def test_where_all_has_to_stop_it_stays_at_the_depth_that_it_has() -> None:
    wire = Wire()
    drive = alt_hold(wire)
    steer(drive, -9.4)
    drive.neutral()
    assert wire.depths[-1] == pytest.approx(-0.4)
    assert wire.stops == 1
    # It is said once: the autopilot holds it.
    drive.neutral()
    assert len(wire.depths) == 2
    assert wire.stops == 2


def test_no_target_is_above_the_surface_nor_sent_blindly() -> None:
    wire = Wire(own_altitude=-0.1)
    steer(alt_hold(wire), 0.5)
    assert wire.depths == [HIGHEST]
    blind = Wire(own_altitude=math.nan)
    drive = alt_hold(blind)
    steer(drive, -1.0)
    drive.neutral()
    assert blind.depths == []
    old = Wire(age=2.0)
    steer(alt_hold(old), -1.0)
    assert old.depths == []
    refused = Wire(refuses=True)
    steer(alt_hold(refused), -1.0)
    assert len(refused.sent) == 1


def test_it_pushes_towards_its_goal_within_its_time() -> None:
    wire = Wire()
    drive = alt_hold(wire)
    steer(drive, -0.9, goal=SE2(1.0, 0.0, 0.0), beats=10)
    sticks, expires = wire.sent[-1]
    assert isinstance(sticks, Sticks)
    assert sticks.x > 100
    assert abs(sticks.y) < 50
    assert sticks.z == 500
    assert expires == 0.4
    wire.sent.clear()
    turning = alt_hold(wire)
    steer(turning, -0.9, goal=SE2(0.0, 0.0, 1.0), beats=10)
    # To the left is counter-clockwise; the stick counts the other way.
    assert wire.sent[-1][0].r < -50  # type: ignore[union-attr]


def test_by_velocities_it_goes_no_faster_than_it_may() -> None:
    wire = Wire()
    drive = Guided(wire, Joystick(thrusters=VECTORED_6DOF))  # type: ignore[arg-type]
    drive.begin(fix_at())
    steer(drive, -0.9, goal=SE2(3.0, 4.0, 0.0))
    velocity = wire.sent[-1][0]
    assert isinstance(velocity, BodyVelocity)
    assert math.hypot(velocity.surge, velocity.sway) == pytest.approx(GENTLE.speed)
    assert velocity.sway / velocity.surge == pytest.approx(4.0 / 3.0)
    assert velocity.heave == pytest.approx(0.0)


def test_what_the_vehicle_says_is_passed_on() -> None:
    wire = Wire(yielding="another station")
    craft = alt_hold(wire).craft()
    assert (craft.taken, craft.lost, craft.voltage) == ("another station", "", 15.0)


@pytest.mark.parametrize("how, mode", [(LastResort.SURFACE, "SURFACE"), (LastResort.HOLD, "ALT_HOLD")])
def test_the_last_resort_is_asked_for_without_waiting(how: LastResort, mode: str) -> None:
    wire = Wire()
    drive = alt_hold(wire)
    drive.resort(how)
    assert drive._resorting is not None
    drive._resorting.join(5.0)
    assert wire.modes == [mode]
