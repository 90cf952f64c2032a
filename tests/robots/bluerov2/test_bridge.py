"""The bridge: nothing that should stop the vehicle leaves a command alive."""

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE2, SE3, Bounds
from dream.robots.bluerov2.bridge import LEASE, LOW, Bridge, Craft, Stance, Standing
from dream.robots.bluerov2.limits import SAG, LastResort, Limits
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.standin.lockstep import LockStep

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
    """Each once, however often it was asked for."""
    said: list[Standing] = field(default_factory=list)
    dim: str = ""
    """What is wrong with the camera."""
    effort: float = 0.0

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
        self.sent.append(("resort", math.nan))
        if self.resorts[-1:] != [how]:
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
    "altitude": (lambda s: setattr(s, "fix", fix_at(altitude_problem="it is stuck")), "it is stuck"),
    "no altitude": (lambda s: setattr(s, "fix", fix_at(altitude_age=5.2)), "no altitude of the DVL"),
    "never an altitude": (lambda s: setattr(s, "fix", fix_at(altitude_age=math.inf)), "no altitude"),
    "heartbeat": (lambda s: setattr(s, "reports", replace(WELL, link_age=4.0)), "heartbeat"),
    "operator": (lambda s: s.bridge.renew_operator(0.0), "operator"),
    "heading": (lambda s: setattr(s, "fix", fix_at(heading_age=1.1)), "no heading"),
    "no heading ever": (lambda s: setattr(s, "fix", fix_at(heading_age=math.inf)), "no heading"),
    "own depth": (
        lambda s: setattr(s, "reports", replace(WELL, own_depth_age=1.1)),
        "autopilot does not tell its depth",
    ),
    "no own depth ever": (
        lambda s: setattr(s, "reports", replace(WELL, own_depth_age=math.inf)),
        "autopilot does not tell its depth",
    ),
    "status": (lambda s: setattr(s, "reports", replace(WELL, status_age=5.5)), "nothing of battery and leak"),
    "vague for a tank": (lambda s: setattr(s, "fix", fix_at(position_sigma=0.41)), "does not know"),
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
    # It is gone on with, by nobody else, and the dive is over even if the trouble goes.
    scene.fix, scene.reports = fix_at(), WELL
    scene.bridge.renew_operator(100.0)
    assert set(scene.beats(7.0)) == {"resort"}
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


def test_without_bottom_track_and_so_without_an_altitude_it_goes_on_slowly_at_its_depth() -> None:
    scene = under_way()
    for age, target in ((0.9, -0.9), (8.0, -1.1)):
        scene.fix = fix_at(
            dvl_age=age, altitude_age=age, T_world_base=SE3.level(0.0, 0.0, -1.1, 0.0), altitude=math.nan
        )
        assert set(scene.beats(0.2)) == {"steer"}
        assert scene.goals[-1][1] == pytest.approx(target)
    assert scene.bridge.standing.stance is Stance.SLOW
    # The height of a seabed that is not known is not gone to either.
    scene.fix = fix_at(seabed=math.nan, T_world_base=SE3.level(0.0, 0.0, -1.1, 0.0))
    assert set(scene.beats(0.2)) == {"steer"}
    assert scene.goals[-1][1] == pytest.approx(-1.1)


def test_an_altitude_that_cannot_be_is_worse_than_none() -> None:
    scene = under_way()
    scene.fix = fix_at(dvl_age=2.0, altitude_age=2.0, altitude_problem="it is stuck")
    assert set(scene.beats(0.2)) == {"neutral"}
    assert scene.bridge.standing == Standing(Stance.NEUTRAL, "it is stuck")


def test_too_near_the_floor_for_a_second_the_dive_is_over() -> None:
    scene = under_way()
    # Not for a moment, and not by reports that say nothing.
    for low in (0.1, math.nan, 0.1):
        scene.fix = fix_at(altitude=low)
        assert set(scene.beats(0.4 * LOW)) == {"steer"}
        if math.isnan(low):
            scene.fix = fix_at(altitude=0.2)
            scene.beats(0.1)
    scene.fix = fix_at(altitude=math.nan)
    assert set(scene.beats(2.0 * LOW)) == {"steer"}
    scene.fix = fix_at(altitude=0.12)
    assert scene.beats(0.2)[-1] == "resort"
    assert scene.bridge.standing == Standing(Stance.OVER, "0.1 m above the floor, 0.2 m are needed")


def test_how_near_is_the_operators_to_say() -> None:
    scene = Scene(limits=Limits(area=AREA, altitude=0.05))
    scene.bridge.go(GOAL, 0.6)
    scene.fix = fix_at(altitude=0.06)
    assert set(scene.beats(3.0 * LOW)) == {"steer"}
    with pytest.raises(ValueError, match="altitude: expected 0 or more"):
        Limits(area=AREA, altitude=-0.1)


LIMITS: dict[str, tuple[Callable[[Scene], None], str]] = {
    "area": (lambda s: setattr(s, "fix", fix_at(2.6)), "0.6 m outside the area"),
    "depth": (lambda s: setattr(s, "reports", replace(WELL, depth=11.0)), "11.0 m deep"),
    "voltage": (lambda s: setattr(s, "reports", replace(WELL, voltage=13.2)), "13.2 V"),
    "altitude": (lambda s: setattr(s, "fix", fix_at(altitude=0.1)), "0.1 m above the floor"),
    "leak": (lambda s: setattr(s, "reports", replace(WELL, leak=True)), "water in the hull"),
    "time": (lambda s: setattr(s, "now", s.now + 3700.0), "60 minutes"),
    "disarmed": (lambda s: setattr(s, "reports", replace(WELL, lost="it was disarmed")), "disarmed"),
    "operator": (lambda s: s.bridge.end("ended by the operator"), "ended by the operator"),
    "failsafe": (lambda s: setattr(s, "reports", replace(WELL, surfacing="a failsafe")), "a failsafe"),
    "drift": (
        lambda s: setattr(s, "fix", fix_at(drifts=-0.36)),
        "climbed -0.4 m more by the one than by the",
    ),
}


@pytest.mark.parametrize("name", LIMITS)
def test_beyond_a_limit_the_dive_is_over_and_the_last_resort_begins_at_once(name: str) -> None:
    scene = under_way()
    cause, reason = LIMITS[name]
    cause(scene)
    lasts = {"voltage": SAG, "altitude": LOW}.get(name, 0.0)
    if lasts:
        assert set(scene.beats(lasts - 0.04)) == {"steer"}
    # Who disarmed it may arm it again: nothing is begun with that one.
    after = {"neutral"} if name == "disarmed" else {"resort"}
    # The beat that sees it tells it to stay, and is the first of the last resort.
    sent = [what for what in scene.beats(0.2) if what != "steer"]
    assert sent[0] == "neutral"
    assert set(sent[1:]) == after
    assert scene.bridge.standing.stance is Stance.OVER
    assert reason in scene.bridge.standing.reason
    # A battery that recovers without its load, or a fence that a current carries it back through: still over.
    scene.fix, scene.reports = fix_at(), WELL
    assert set(scene.beats(7.0)) == after
    assert scene.resorts == ([] if name == "disarmed" else [LastResort.SURFACE])
    assert reason in scene.bridge.standing.reason


def test_one_that_was_disarmed_by_somebody_is_never_begun_with_whatever_else_is_wrong() -> None:
    scene = under_way()
    scene.reports = replace(WELL, lost="it was disarmed", leak=True, link_age=9.0, depth=11.0)
    assert set(scene.beats(7.0)) == {"neutral"}
    scene.reports, scene.fix = WELL, fix_at(imu_age=9.0)
    scene.bridge.end("ended by the operator")
    assert set(scene.beats(7.0)) == {"neutral"}
    assert scene.resorts == []
    assert scene.bridge.standing.stance is Stance.OVER


def test_what_stays_as_far_apart_as_it_was_is_no_trouble() -> None:
    # The autopilot has a zero of its own, and is not heard for a while; and a tank may be 4 m across.
    scene = Scene(reports=replace(WELL, own_depth=3.9))
    scene.bridge.go(GOAL, 0.6)
    for own, depth in ((3.9, 0.9), (math.nan, 1.4), (4.19, 0.9), (3.61, 0.9), (3.9, math.nan)):
        scene.reports = replace(WELL, own_depth=own, depth=depth)
        scene.fix = fix_at(heading_age=0.9, drifts=0.34, position_sigma=0.39)
        assert set(scene.beats(3.0)) == {"steer"}


def test_another_source_of_its_own_depth_has_another_zero_and_nothing_parts() -> None:
    scene = Scene(reports=replace(WELL, own_depth=0.7, own_depth_from="LOCAL_POSITION_NED"))
    scene.bridge.go(GOAL, 0.6)
    for own, source in ((0.7, "LOCAL_POSITION_NED"), (-48.3, "GLOBAL_POSITION_INT")) * 3:
        scene.reports = replace(WELL, own_depth=own, own_depth_from=source)
        assert set(scene.beats(2.0)) == {"steer"}
    # Of the one that counts now, they part as ever.
    scene.reports = replace(scene.reports, own_depth=-48.3 + 0.31)
    assert set(scene.beats(0.9)) == {"steer"}
    assert scene.beats(0.2)[-1] == "resort"
    assert "-47.99 m by the autopilot" in scene.bridge.over


@pytest.mark.parametrize("apart", [-0.31, 0.31])
def test_depths_that_part_end_the_dive_after_a_second(apart: float) -> None:
    scene = Scene(reports=replace(WELL, own_depth=0.7))
    scene.bridge.go(GOAL, 0.6)
    scene.beats(1.0)
    scene.reports = replace(WELL, own_depth=0.7 + apart)
    assert set(scene.beats(0.9)) == {"steer"}
    assert scene.beats(0.2)[-1] == "resort"
    assert f"0.90 m by the pressure, {0.7 + apart:.2f} m by the autopilot" in scene.bridge.over


@pytest.mark.parametrize(
    "in_the_hull",
    [lambda depth: 0.0, lambda depth: 0.1 * depth, lambda depth: 0.2 - 0.3 * depth],
    ids=["sealed", "soft", "cooling"],
)
def test_a_barometer_within_the_hull_ends_the_dive_on_its_way_down(
    in_the_hull: Callable[[float], float],
) -> None:
    # At the surface it agrees with the one outside.
    scene = Scene(reports=replace(WELL, own_depth=0.05, depth=in_the_hull(0.05)))
    scene.bridge.go(GOAL, 0.6)
    depth = 0.05
    while not scene.bridge.over and depth < 2.0:
        assert set(scene.beats(0.2)) <= {"steer", "neutral", "resort"}
        depth += 0.03
        scene.reports = replace(WELL, own_depth=depth, depth=in_the_hull(depth))
    assert depth < 0.7
    assert "the depths part" in scene.bridge.over


def test_an_estimate_that_flies_ends_the_dive_after_a_second() -> None:
    scene = under_way()
    scene.fix = fix_at(T_world_base=SE3.level(0.0, 0.0, 0.31, 0.0))
    assert set(scene.beats(0.9)) == {"steer"}
    assert scene.beats(0.3)[-1] == "resort"
    assert scene.bridge.over == "the estimate is 0.3 m above the surface"


def test_why_inertial_samples_are_too_old_is_told() -> None:
    silent, late = fix_at(imu_age=0.3), fix_at(imu_age=1.4)
    for fix, craft, said in (
        (silent, replace(WELL, imu_heard=0.3), "no inertial samples, or no depth"),
        (late, replace(WELL, imu_heard=0.01), "inertial samples come 1.4 s late: a slow link"),
        (late, replace(WELL, imu_heard=0.01, slipped="its clock was set"), "its clock was set"),
        # That its clock was set does not matter while there is nothing to date.
        (silent, replace(WELL, imu_heard=0.3, slipped="its clock was set"), "no inertial samples"),
        (fix_at(depth_age=3.0), WELL, "no inertial samples, or no depth"),
    ):
        scene = under_way()
        scene.fix, scene.reports = fix, craft
        assert set(scene.beats(0.2)) == {"neutral"}
        assert said in scene.bridge.standing.reason


def test_one_that_presses_is_stopped_within_three_seconds() -> None:
    scene = under_way()
    scene.effort = 1.0
    sent = scene.beats(3.0 + 0.08)
    assert sent[sent.index("neutral") :] == ["neutral", *["resort"] * (len(sent) - sent.index("neutral") - 1)]
    assert set(sent[: round(2.5 * 25)]) == {"steer"}
    assert scene.bridge.over.startswith("it presses")
    assert "0.50 m and 0° from its goal" in scene.bridge.over


def test_time_in_which_nothing_is_asked_of_it_is_no_pressing() -> None:
    scene = under_way()
    scene.effort = 1.0
    for _ in range(5):
        assert "neutral" not in scene.beats(2.0)
        scene.fix = fix_at(imu_age=0.3)
        assert set(scene.beats(1.0)) == {"neutral"}
        scene.fix = fix_at()
    # Nor is that before there is a goal.
    idle = Scene(effort=1.0)
    assert set(idle.beats(5.0)) == {"neutral"}
    idle.bridge.go(GOAL, 0.6)
    assert set(idle.beats(2.5)) == {"steer"}


def test_who_disarmed_it_may_arm_it_again_and_is_left_it() -> None:
    scene = under_way()
    scene.reports = replace(WELL, lost="it was disarmed")
    scene.beats(7.0)
    scene.reports = replace(WELL, taken="armed, which nobody here asked for")
    assert set(scene.beats(7.0)) == {"release"}
    assert scene.resorts == []
    assert scene.bridge.over == "it was disarmed"


def test_closing_sends_neutral_but_into_no_way_home() -> None:
    scene = under_way()
    scene.bridge.close()
    assert scene.sent[-1][0] == "neutral"
    scene.bridge.end("ended by the operator")
    scene.beats(6.0)
    scene.sent.clear()
    scene.bridge.close()
    assert scene.sent == []


def test_what_is_over_is_left_to_who_has_taken_it() -> None:
    scene = under_way()
    scene.reports = replace(WELL, taken="another ground station sends as 255")
    scene.beats(1.0)
    scene.bridge.end("ended by the operator")
    assert set(scene.beats(20.0)) == {"release"}
    assert not scene.resorts
    assert scene.bridge.over == "ended by the operator"
    # Once they let go of it, it comes home.
    scene.reports = WELL
    assert set(scene.beats(1.0)[1:]) == {"resort"}
    assert scene.bridge.standing == Standing(Stance.OVER, "ended by the operator")


def test_a_device_that_is_about_to_fail_ends_the_dive() -> None:
    scene = Scene()
    said = ""
    scene.bridge = Bridge(scene, scene, scene.limits, lambda: scene.now, failing=lambda: said)  # type: ignore[arg-type]
    scene.bridge.go(GOAL, 0.6)
    assert set(scene.beats(1.0)) == {"steer"}
    said = "the DVL is too hot"
    assert scene.beats(0.08) == ["neutral", "resort", "resort"]
    said = ""
    assert set(scene.beats(0.2)) == {"resort"}
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
    assert scene.beats(0.2)[-1] == "resort"
    assert "0.9 m deep, 0.7 m are allowed" in scene.bridge.standing.reason


def at(x: float, z: float) -> Fix:
    return fix_at(T_world_base=SE3.level(x, 0.0, z, 0.0))


def test_to_a_height_it_climbs_as_it_comes_nearer_whatever_the_floor() -> None:
    scene = under_way()
    scene.bridge.go(GOAL, None, -0.4)
    asked = []
    for x, z in ((0.0, -0.9), (0.1, -0.8), (0.3, -0.7), (0.2, -0.7), (0.46, -0.5), (0.6, -0.4)):
        # A wreck under it lifts the floor of the DVL.
        scene.fix = replace(at(x, z), seabed=-1.5 + x, altitude=0.5)
        assert set(scene.beats(0.04)) == {"steer"}
        asked.append(scene.goals[-1][1])
    # Pushed back, it does not sink again; within 5 cm over ground it is to be there.
    assert asked == pytest.approx([-0.9, -0.8, -0.6, -0.6, -0.4, -0.4])
    # Straight down, where no altitude is believed.
    scene.fix = replace(at(0.5, -0.4), altitude_age=3.0)
    scene.bridge.go(GOAL, None, -0.9)
    scene.beats(0.04)
    assert scene.goals[-1][1] == pytest.approx(-0.9)


def test_a_height_has_the_limit_of_depth_and_one_of_the_two_is_given() -> None:
    scene = Scene(limits=Limits(area=AREA, depth=0.7))
    for altitude, z in ((None, None), (0.6, -0.5), (None, math.nan)):
        with pytest.raises(ValueError, match="goal: expected either an altitude or a height"):
            scene.bridge.go(GOAL, altitude, z)
    scene.bridge.go(GOAL, None, -0.75)
    assert set(scene.beats(0.2)) == {"steer"}
    scene.bridge.go(GOAL, None, -0.85)
    assert scene.beats(0.2)[-1] == "resort"
    assert "the goal is 0.8 m deep, 0.7 m are allowed" in scene.bridge.standing.reason


def on_its_thread(scene: Scene, clock: LockStep, **options: Any) -> Bridge:
    """The bridge of a scene, on a thread and a clock that both are simulated."""
    scene.bridge = Bridge(scene, scene, scene.limits, clock, threads=clock, **options)  # type: ignore[arg-type]
    return scene.bridge


def test_on_its_thread_a_new_goal_does_not_wait_for_the_next_beat() -> None:
    clock, scene = LockStep(), Scene()
    # A beat takes ten seconds at this rate.
    bridge = on_its_thread(scene, clock, rate=0.1)
    bridge.start()
    for k in range(3):
        clock.sleep(0.5)
        bridge.renew(60.0)
        bridge.go(replace(GOAL, x=0.1 * k), 0.6)
    clock.sleep(0.5)
    bridge.close()
    assert bridge.lags == [0.0, 0.0, 0.0]
    assert [goal.x for goal, _, _ in scene.goals] == pytest.approx([0.0, 0.1, 0.2])
    assert scene.sent[-1][0] == "neutral"


def test_a_beat_that_fails_ends_the_dive_with_neutral_and_the_last_resort() -> None:
    clock, scene = LockStep(), Scene()
    bridge = on_its_thread(scene, clock)
    bridge.go(GOAL, 0.6)

    def broken(*_: object) -> None:
        raise RuntimeError("no such thing")

    scene.steer = broken  # type: ignore[assignment, method-assign]
    bridge.start()
    clock.sleep(0.1)
    bridge.close()
    assert bridge.standing.stance is Stance.OVER
    assert "no such thing" in bridge.standing.reason
    assert [what for what, _ in scene.sent if what != "begin"][:2] == ["neutral", "resort"]
    assert scene.sent[-1][0] == "resort"


def test_beats_that_all_fail_are_told_once_come_no_faster_and_end_in_the_last_resort(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock, scene = LockStep(), Scene()
    bridge = on_its_thread(scene, clock)

    def broken() -> Fix:
        raise ValueError("messages were lost")

    scene.update = broken  # type: ignore[method-assign]
    scene.sent.clear()
    bridge.start()
    clock.sleep(1.0)
    bridge.close()
    # Whoever waits for the vehicle learns of it.
    assert bridge.standing == Standing(Stance.OVER, "bridge: ValueError: messages were lost")
    assert bridge.over == "bridge: ValueError: messages were lost"
    assert scene.resorts == [LastResort.SURFACE]
    told = [what for what, _ in scene.sent]
    # One thing a beat, and both at the first.
    assert told == ["neutral", *["resort"] * (len(told) - 1)]
    assert len(told) == pytest.approx(25 + 1, abs=1)
    assert sum("a beat failed" in record.message for record in caplog.records) == 1


def test_the_loop_outlives_also_what_fails_while_it_stops_the_vehicle() -> None:
    clock, scene = LockStep(), Scene(limits=Limits(area=AREA, patience=0.3))

    def gone(standing: Standing) -> None:
        raise BrokenPipeError("nobody listens")

    bridge = on_its_thread(scene, clock, said=gone)
    scene.fix = fix_at(imu_age=0.3)
    bridge.start()
    clock.sleep(1.0)
    bridge.close()
    assert scene.resorts == [LastResort.SURFACE]


def test_the_last_resort_needs_no_neutral_and_is_tried_until_it_begins_and_gone_on_with() -> None:
    clock, scene = LockStep(), Scene()
    tries: list[float] = []

    def stuck() -> None:
        raise OSError("no route to the vehicle")

    def resort(how: LastResort) -> None:
        tries.append(clock())
        if clock() < 0.6:
            raise OSError("no route to the vehicle")
        scene.resorts.append(how)

    scene.neutral, scene.resort = stuck, resort  # type: ignore[method-assign]
    bridge = on_its_thread(scene, clock)
    scene.fix = fix_at(imu_age=0.3)
    bridge.start()
    clock.sleep(1.0)
    with contextlib.suppress(OSError):
        bridge.close()
    assert set(scene.resorts) == {LastResort.SURFACE}
    # Where it cannot be told to stay, there is no use in waiting.
    assert min(tries) <= 0.1
    assert np.diff(np.unique(tries)).max() < 0.05
    assert max(tries) > 0.9
    assert bridge.standing.stance is Stance.OVER
