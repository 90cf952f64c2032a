"""The bridge: nothing that should stop the vehicle leaves a command alive."""

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from dream.geometry import SE2, SE3, Bounds
from dream.robots.bluerov2.bridge import LEASE, SAG, Bridge, Craft, LastResort, Limits, Stance, Standing
from dream.robots.bluerov2.navigation import Fix
from tests.robots.bluerov2.waiting import until

AREA = Bounds(-2.0, -2.0, 2.0, 2.0)
GOAL = SE2(0.5, 0.0, 0.0)
WELL = Craft(armed=True, link_age=0.1, voltage=15.8, depth=0.9)


def fix_at(x: float = 0.0, **changes: object) -> Fix:
    fix = Fix(
        time=0.0,
        T_world_base=SE3.level(x, 0.0, -0.9, 0.0),
        velocity=np.zeros(3),
        angular_velocity=np.zeros(3),
        velocity_sigma=0.01,
        position_sigma=0.01,
        imu_age=0.02,
        depth_age=0.1,
        dvl_age=0.1,
        heading_age=0.1,
        altitude=0.6,
        seabed=-1.5,
    )
    return replace(fix, **changes)  # type: ignore[arg-type]


@dataclass
class Scene:
    """A bridge whose clock, sensors and vehicle are ours."""

    limits: Limits = field(default_factory=lambda: Limits(area=AREA))
    now: float = 100.0
    fix: Fix = field(default_factory=fix_at)
    reports: Craft = WELL
    sent: list[tuple[str, float]] = field(default_factory=list)
    """What the drive was asked for, and until when a command lives."""
    goals: list[tuple[SE2, float, float]] = field(default_factory=list)
    resorts: list[LastResort] = field(default_factory=list)
    said: list[Standing] = field(default_factory=list)
    dim: str = ""
    """What is wrong with the camera."""

    def __post_init__(self) -> None:
        self.bridge = Bridge(
            self,  # type: ignore[arg-type]
            self,
            self.limits,
            lambda: self.now,
            said=self.said.append,
            sight=lambda fix: self.dim,
        )

    def update(self) -> Fix:
        return self.fix

    def begin(self, fix: Fix) -> None:
        self.sent.append(("begin", math.nan))

    def steer(self, fix: Fix, goal: SE2, z: float, dt: float, pace: float, expires: float) -> None:
        self.sent.append(("steer", expires))
        self.goals.append((goal, z, pace))

    def neutral(self) -> None:
        self.sent.append(("neutral", math.nan))

    def release(self) -> None:
        self.sent.append(("release", math.nan))

    def resort(self, how: LastResort) -> None:
        self.resorts.append(how)

    def craft(self) -> Craft:
        return self.reports

    def beats(self, seconds: float, alive: bool = True) -> list[str]:
        """Beat for a while, with a mission that lives or not; returns what was sent in it."""
        before = len(self.sent)
        for _ in range(round(seconds * 25)):
            self.now += 0.04
            if alive:
                self.bridge.renew()
            self.bridge.beat()
        return [what for what, _ in self.sent[before:]]


def under_way() -> Scene:
    scene = Scene()
    scene.bridge.renew()
    scene.bridge.go(GOAL, 0.6)
    assert set(scene.beats(1.0)) == {"steer"}
    return scene


def test_it_steers_to_the_goal_above_the_seabed() -> None:
    scene = under_way()
    goal, z, pace = scene.goals[-1]
    assert (goal, pace) == (GOAL, 1.0)
    assert z == pytest.approx(-0.9)
    assert scene.bridge.standing == Standing(Stance.GO)
    assert scene.bridge.goal == GOAL


def test_before_there_is_a_goal_it_is_neutral() -> None:
    scene = Scene()
    assert set(scene.beats(0.2)) == {"neutral"}


def test_no_command_outlives_the_lease_nor_the_mission() -> None:
    scene = under_way()
    scene.sent.clear()
    last = scene.now
    assert "steer" in scene.beats(2.0, alive=False)
    lives_until = max(expires for what, expires in scene.sent if what == "steer")
    assert lives_until <= last + LEASE + 1e-9
    assert scene.bridge.standing.stance is Stance.NEUTRAL
    assert "mission" in scene.bridge.standing.reason


def test_a_camera_that_shows_nothing_is_told_at_the_next_beat_and_slows_it_down() -> None:
    scene = under_way()
    scene.dim = "camera: no pictures come"
    assert set(scene.beats(1.0)) == {"steer"}
    assert scene.said[-1] == Standing(Stance.SLOW, "camera: no pictures come")
    # Told once, not at every beat.
    assert len(scene.said) == 1
    assert scene.goals[-1][2] < 1.0
    # What is worse is told before.
    scene.fix = fix_at(imu_age=0.3)
    assert set(scene.beats(0.2)) == {"neutral"}
    assert "inertial" in scene.bridge.standing.reason
    scene.fix, scene.dim = fix_at(), ""
    scene.beats(0.2)
    assert scene.bridge.standing == Standing(Stance.GO)


TROUBLES: dict[str, tuple[Callable[[Scene], None], str]] = {
    "imu": (lambda s: setattr(s, "fix", fix_at(imu_age=0.3)), "inertial"),
    "depth": (lambda s: setattr(s, "fix", fix_at(depth_age=3.0)), "depth"),
    "dvl": (lambda s: setattr(s, "fix", fix_at(dvl_age=11.0)), "bottom track"),
    "diverged": (lambda s: setattr(s, "fix", fix_at(position_sigma=9.0)), "does not know"),
    "not a number": (lambda s: setattr(s, "fix", fix_at(velocity_sigma=math.nan)), "does not know"),
    "heartbeat": (lambda s: setattr(s, "reports", replace(WELL, link_age=4.0)), "heartbeat"),
    "operator": (lambda s: s.bridge.renew_operator(0.0), "operator"),
}


@pytest.mark.parametrize("name", TROUBLES)
def test_trouble_is_neutral_at_the_next_beat_and_then_the_last_resort(name: str) -> None:
    scene = under_way()
    cause, reason = TROUBLES[name]
    cause(scene)
    scene.now += 1e-3
    assert set(scene.beats(1.0)) == {"neutral"}
    assert reason in scene.bridge.standing.reason
    assert not scene.resorts
    scene.beats(scene.limits.patience)
    assert scene.resorts == [LastResort.SURFACE]
    # It is taken once, and the dive is over even if the trouble goes.
    scene.fix, scene.reports = fix_at(), WELL
    scene.bridge.renew_operator(100.0)
    assert set(scene.beats(7.0)) == {"neutral"}
    assert scene.resorts == [LastResort.SURFACE]
    assert scene.bridge.standing.stance is Stance.OVER
    assert reason in scene.bridge.standing.reason


def test_trouble_that_passes_is_forgiven_and_it_begins_anew_where_it_is() -> None:
    scene = under_way()
    scene.fix = fix_at(imu_age=0.3)
    scene.beats(2.0)
    scene.fix = fix_at(0.3)
    assert scene.beats(0.2)[:2] == ["begin", "steer"]
    assert not scene.resorts
    assert [standing.stance for standing in scene.said] == [Stance.NEUTRAL, Stance.GO]


def test_without_bottom_track_it_goes_slowly_and_says_so() -> None:
    scene = under_way()
    scene.fix = fix_at(dvl_age=2.0)
    assert set(scene.beats(0.2)) == {"steer"}
    assert scene.goals[-1][2] < 1.0
    assert scene.bridge.standing == Standing(Stance.SLOW, "no bottom track for a while")


def test_to_somebody_else_it_yields_for_as_long_as_it_takes() -> None:
    scene = under_way()
    scene.reports = replace(WELL, taken="another ground station sends as 255")
    assert set(scene.beats(20.0)) == {"release"}
    assert not scene.resorts
    assert scene.bridge.standing.stance is Stance.YIELD
    scene.reports = WELL
    assert scene.beats(0.2)[:2] == ["begin", "steer"]


LIMITS: dict[str, tuple[Callable[[Scene], None], str]] = {
    "area": (lambda s: setattr(s, "fix", fix_at(2.6)), "0.6 m outside the area"),
    "depth": (lambda s: setattr(s, "reports", replace(WELL, depth=11.0)), "11.0 m deep"),
    "voltage": (lambda s: setattr(s, "reports", replace(WELL, voltage=13.2)), "13.2 V"),
    "leak": (lambda s: setattr(s, "reports", replace(WELL, leak=True)), "water in the hull"),
    "time": (lambda s: setattr(s, "now", s.now + 3700.0), "60 minutes"),
    "disarmed": (lambda s: setattr(s, "reports", replace(WELL, lost="it was disarmed")), "disarmed"),
    "operator": (lambda s: s.bridge.end("ended by the operator"), "ended by the operator"),
}


@pytest.mark.parametrize("name", LIMITS)
def test_beyond_a_limit_the_dive_is_over(name: str) -> None:
    scene = under_way()
    cause, reason = LIMITS[name]
    cause(scene)
    if name == "voltage":
        scene.beats(SAG)
    assert set(scene.beats(0.2)[1:]) == {"neutral"}
    assert scene.bridge.standing.stance is Stance.OVER
    assert reason in scene.bridge.standing.reason
    # A battery that recovers without its load, or a fence that a current carries it back through: still over.
    scene.fix, scene.reports = fix_at(), WELL
    assert set(scene.beats(6.0)) == {"neutral"}
    assert scene.resorts == ([] if name == "disarmed" else [LastResort.SURFACE])


def test_what_is_over_is_left_to_who_takes_it() -> None:
    scene = under_way()
    scene.bridge.end("ended by the operator")
    scene.beats(1.0)
    scene.reports = replace(WELL, taken="another ground station sends as 255")
    assert set(scene.beats(20.0)) == {"release"}
    assert not scene.resorts
    scene.reports = WELL
    assert set(scene.beats(1.0)) == {"neutral"}
    assert scene.bridge.standing == Standing(Stance.OVER, "ended by the operator")


def test_a_device_that_is_about_to_fail_ends_the_dive() -> None:
    scene = Scene()
    said = ""
    scene.bridge = Bridge(scene, scene, scene.limits, lambda: scene.now, failing=lambda: said)  # type: ignore[arg-type]
    scene.bridge.go(GOAL, 0.6)
    assert set(scene.beats(1.0)) == {"steer"}
    said = "the DVL is too hot"
    assert set(scene.beats(0.2)) == {"neutral"}
    said = ""
    assert set(scene.beats(0.2)) == {"neutral"}
    assert scene.bridge.standing == Standing(Stance.OVER, "the DVL is too hot")


def test_a_voltage_that_sags_for_a_moment_ends_nothing() -> None:
    scene = under_way()
    for _ in range(3):
        scene.reports = replace(WELL, voltage=13.2)
        assert set(scene.beats(0.7 * SAG)) == {"steer"}
        scene.reports = replace(WELL, voltage=math.nan)
        assert set(scene.beats(0.1)) == {"steer"}


def test_the_fence_has_a_margin_and_the_depth_of_a_goal_its_limit() -> None:
    scene = Scene(limits=Limits(area=AREA, depth=0.7))
    scene.fix = fix_at(2.4)
    scene.bridge.go(GOAL, 0.8)
    assert set(scene.beats(0.2)) == {"steer"}
    assert scene.goals[-1][1] == pytest.approx(-0.7)
    # A survey that is deeper than allowed is none.
    scene.bridge.go(GOAL, 0.6)
    assert scene.beats(0.2)[-1] == "neutral"
    assert "0.9 m deep, 0.7 m are allowed" in scene.bridge.standing.reason


def test_on_its_thread_a_new_goal_does_not_wait_for_the_next_beat() -> None:
    began = time.monotonic()
    scene = Scene()
    scene.bridge = Bridge(scene, scene, scene.limits, lambda: time.monotonic() - began, rate=0.1)  # type: ignore[arg-type]
    scene.bridge.start()
    try:
        for k in range(3):
            scene.bridge.renew(60.0)
            scene.bridge.go(replace(GOAL, x=0.1 * k), 0.6)
            deadline = time.monotonic() + 5.0
            while len(scene.bridge.lags) <= k and time.monotonic() < deadline:
                time.sleep(0.005)
    finally:
        scene.bridge.close()
    # A beat takes ten seconds at this rate.
    assert len(scene.bridge.lags) == 3
    assert scene.sent[-1][0] == "neutral"


def test_a_beat_that_fails_ends_the_dive_in_neutral() -> None:
    began = time.monotonic()
    scene = Scene()
    scene.bridge = Bridge(scene, scene, scene.limits, lambda: time.monotonic() - began)  # type: ignore[arg-type]
    scene.bridge.go(GOAL, 0.6)

    def broken(*_: object) -> None:
        raise RuntimeError("no such thing")

    scene.steer = broken  # type: ignore[assignment, method-assign]
    scene.bridge.start()
    try:
        assert until(lambda: scene.bridge.standing.stance is Stance.OVER)
    finally:
        scene.bridge.close()
    assert "no such thing" in scene.bridge.standing.reason
    assert scene.sent[-1][0] == "neutral"


def test_beats_that_all_fail_are_told_once_come_no_faster_and_end_in_the_last_resort(
    caplog: pytest.LogCaptureFixture,
) -> None:
    began = time.monotonic()
    scene = Scene(limits=Limits(area=AREA, patience=0.3))
    scene.bridge = Bridge(scene, scene, scene.limits, lambda: time.monotonic() - began)  # type: ignore[arg-type]

    def broken() -> Fix:
        raise ValueError("messages were lost")

    scene.update = broken  # type: ignore[method-assign]
    scene.bridge.start()
    try:
        assert until(lambda: scene.resorts)
        time.sleep(0.2)
        took, beats = time.monotonic() - began, len(scene.sent)
    finally:
        scene.bridge.close()
    # Whoever waits for the vehicle learns of it.
    assert scene.bridge.standing == Standing(Stance.OVER, "bridge: ValueError: messages were lost")
    assert scene.bridge.over == "bridge: ValueError: messages were lost"
    assert scene.resorts == [LastResort.SURFACE]
    assert {what for what, _ in scene.sent} == {"begin", "neutral"}
    assert beats <= 25.0 * took + 3
    assert sum("a beat failed" in record.message for record in caplog.records) == 1


def test_the_loop_outlives_also_what_fails_while_it_stops_the_vehicle() -> None:
    began = time.monotonic()
    scene = Scene(limits=Limits(area=AREA, patience=0.3))

    def gone(standing: Standing) -> None:
        raise BrokenPipeError("nobody listens")

    scene.bridge = Bridge(scene, scene, scene.limits, lambda: time.monotonic() - began, said=gone)  # type: ignore[arg-type]
    scene.fix = fix_at(imu_age=0.3)
    scene.bridge.start()
    try:
        assert until(lambda: scene.resorts)
    finally:
        scene.bridge.close()
    assert scene.resorts == [LastResort.SURFACE]


def test_the_last_resort_needs_no_neutral_and_is_tried_until_it_begins() -> None:
    began = time.monotonic()
    scene = Scene(limits=Limits(area=AREA, patience=0.3))
    tries: list[float] = []

    def stuck() -> None:
        raise OSError("no route to the vehicle")

    def resort(how: LastResort) -> None:
        tries.append(time.monotonic())
        if len(tries) < 3:
            raise OSError("no route to the vehicle")
        scene.resorts.append(how)

    scene.neutral, scene.resort = stuck, resort  # type: ignore[method-assign]
    scene.bridge = Bridge(scene, scene, scene.limits, lambda: time.monotonic() - began)  # type: ignore[arg-type]
    scene.fix = fix_at(imu_age=0.3)
    scene.bridge.start()
    try:
        assert until(lambda: scene.resorts)
        time.sleep(0.2)
    finally:
        with contextlib.suppress(OSError):
            scene.bridge.close()
    assert scene.resorts == [LastResort.SURFACE]
    assert len(tries) == 3
