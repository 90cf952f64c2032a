"""The drives: what goes out on the wire, and what is left of it when all has to stop."""

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from dream.geometry import SE2, SE3
from dream.robots.bluerov2 import drives
from dream.robots.bluerov2.bridge import LastResort
from dream.robots.bluerov2.drives import CARROT, GENTLE, HIGHEST, SLEEPS, WAKES, AltHold, Guided
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.sticks import Joystick, Sticks
from dream.sim.worlds import make_world
from dream.types import BodyVelocity
from dream.vehicle import VECTORED_6DOF
from tests.robots.bluerov2.standin.ground import Ground
from tests.robots.bluerov2.test_bridge import fix_at

Array = npt.NDArray[np.float64]

DT = 0.04


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


def test_where_it_stays_a_force_that_is_not_worth_it_is_left_out() -> None:
    drive = alt_hold(Wire())
    stands, moves = SimpleNamespace(memory=np.zeros(14)), SimpleNamespace(memory=np.full(14, 0.01))

    def rests(force: float, helm: SimpleNamespace = stands) -> bool:
        drive._rests = drive._may_rest(helm, force)  # type: ignore[arg-type]
        return drive._rests

    between = 0.5 * (SLEEPS + WAKES)
    assert not rests(between)
    assert rests(0.9 * SLEEPS)
    # It does not wake for what it did not go to sleep at.
    assert rests(between)
    assert not rests(1.1 * WAKES)
    assert not rests(between)
    # On its way it pushes as little as it has to.
    assert rests(0.9 * SLEEPS)
    assert not rests(0.9 * SLEEPS, moves)


def held(seconds: float, noise: float, seed: int = 1) -> tuple[Array, Array]:
    """Sticks x and y (n, 2), and metres from the goal by belief (n,), of a vehicle that is to stay.

    Over the stand-in's own MAVLink, beat by beat; the estimate is the truth of a beat ago, with a velocity
    that errs by `noise` m/s for 0.3 s alike, and a place that errs by what that adds up to.
    """
    ground = Ground(make_world("pool/arc", 1))
    ground.under_way(2)
    wire, rng, tank = Wire(), np.random.default_rng(seed), ground.tank
    drive = AltHold(wire, Joystick(thrusters=VECTORED_6DOF))  # type: ignore[arg-type]
    goal, place, turned = tank.T_world_base.se2, tank.T_world_base.translation, tank.T_world_base.rotation
    off_velocity, off = np.zeros(3), np.zeros(3)
    stays = math.exp(-DT / 0.3)
    fixes: list[Fix] = []
    sticks, apart = [], []
    for k in range(round(seconds / DT)):
        for _ in range(4):
            tank.advance(ground.sub.commands)
            ground.sub.beat()
        if k % 12 == 0:
            ground.beat()
        pose = tank.T_world_base
        velocity = (pose.translation - place) / DT
        rate = Rotation.from_matrix(turned.T @ pose.rotation).as_rotvec() / DT
        place, turned = pose.translation, pose.rotation
        off_velocity = stays * off_velocity + math.sqrt(1.0 - stays**2) * noise * rng.standard_normal(3)
        off = off + DT * off_velocity
        believed = SE3(pose.rotation, pose.translation + off)
        fixes.append(
            fix_at(
                time=k * DT,
                T_world_base=believed,
                velocity=velocity + off_velocity,
                angular_velocity=rate,
            )
        )
        if k == 0:
            drive.begin(fixes[0])
            continue
        drive.steer(fixes[k - 1], goal, float(place[2]), DT, 1.0, 0.4)
        order = wire.sent[-1][0]
        assert isinstance(order, Sticks)
        ground.stick(order.x, order.y, 500, order.r)
        sticks.append((order.x, order.y))
        apart.append(believed.se2.distance(goal))
    return np.array(sticks, np.float64), np.array(apart)


def test_a_vehicle_that_stays_does_not_turn_its_thrusters_to_and_fro_and_keeps_its_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Against the same without: the test can fail."""

    def chattering(sticks: Array) -> tuple[float, float]:
        """Reversals a second, and the share of the time that it pushes."""
        calm = sticks[round(4.0 / DT) :]
        reversals = (np.sign(calm[1:]) * np.sign(calm[:-1]) < 0.0).sum() / (len(calm) * DT)
        return float(reversals), float(calm.any(axis=1).mean())

    sticks, apart = held(24.0, 0.002)
    reversals, pushes = chattering(sticks)
    monkeypatch.setattr(drives, "WAKES", 0.0)
    monkeypatch.setattr(drives, "SLEEPS", 0.0)
    always, close = held(24.0, 0.002)
    reversals_always, pushes_always = chattering(always)
    assert pushes_always > 0.95
    assert reversals_always > 3.0
    assert pushes < 0.65
    assert reversals < 0.4 * reversals_always
    assert math.sqrt(float((apart**2).mean())) < 0.005
    assert math.sqrt(float((close**2).mean())) < 0.005


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
