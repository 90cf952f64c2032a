"""The robot: it waits, holds, gives up and says so, on a bridge and an eye that are ours."""

import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.errors import MissionAborted
from dream.geometry import SE2, SE3, Camera
from dream.perception import FlatFloor, Perceived, Perception, Shells, View
from dream.perception.lighting import RUNNING
from dream.protocol import DREAM_V2_TRUE, POOL_V1
from dream.robots.bluerov2 import rov
from dream.robots.bluerov2.bridge import FINE, Stance, Standing
from dream.robots.bluerov2.devices import LiveEye
from dream.robots.bluerov2.mavlink import Refused
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.rov import BlueRov2, Manners
from dream.robots.bluerov2.standin.rig import Rig
from dream.robots.bluerov2.telemetry import Telemetry
from dream.sim.worlds import make_world
from dream.types import BoolArray, Float32Array, Label, Setpoint, UInt8Array
from tests.robots.bluerov2 import rigged
from tests.robots.bluerov2.test_bridge import fix_at

GOAL = Setpoint(0.3, 0.0, 0.0, 0.6)


@dataclass(frozen=True)
class Shot:
    time: float
    rgb: UInt8Array = field(default_factory=lambda: np.zeros((240, 320, 3), np.uint8))


@dataclass
class Scene:
    """Bridge, navigator, eye and perception of a vehicle of steady speed; sleeping passes time."""

    now: float = 10.0
    speed: float = 0.1
    fix: Fix = field(default_factory=fix_at)
    standing: Standing = FINE
    goals: list[SE2] = field(default_factory=list)
    heights: list[float | None] = field(default_factory=list)
    renewed: list[float] = field(default_factory=list)
    blind: bool = False
    frozen: bool = False
    will: str = "go"
    asked_after: float = 0.0
    sure: float = 0.75
    depth: float = 1.0
    light: int = 90
    each: object = None
    over: str = ""

    def robot(self, monkeypatch: pytest.MonkeyPatch, **options: object) -> BlueRov2:
        monkeypatch.setattr(time, "sleep", self.sleep)
        return BlueRov2(
            self,  # type: ignore[arg-type]
            self,  # type: ignore[arg-type]
            self,
            Perception(self, self),
            POOL_V1,
            lambda: self.now,
            frozen=lambda: self.frozen,
            waits=lambda: self.will != "go",
            holds=lambda: self.will == "hold",
            **options,  # type: ignore[arg-type]
        )

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        x, _, z = self.fix.T_world_base.translation.tolist()
        if self.goals and self.standing.stance is Stance.GO:
            height = self.heights[-1]
            ahead, up = self.goals[-1].x - x, 0.0 if height is None else height - z
            steps = [math.copysign(min(abs(gap), self.speed * seconds), gap) for gap in (ahead, up)]
            speeds = [self.speed if abs(gap) > 1e-9 else 0.0 for gap in (ahead, up)]
            pose = SE3.level(x + steps[0], 0.0, z + steps[1], 0.0)
            self.fix = fix_at(T_world_base=pose, velocity=np.array([speeds[0], 0.0, speeds[1]]))
        if callable(self.each):
            self.each()

    def go(self, goal: SE2, altitude: float | None, z: float | None = None) -> None:
        assert altitude == (0.6 if z is None else None)
        self.goals.append(goal)
        self.heights.append(z)

    def renew(self, seconds: float = 0.5) -> None:
        self.renewed.append(self.now + seconds)

    def at(self, time: float) -> SE3:
        return self.fix.T_world_base

    def newest(self, after: float, timeout: float) -> Shot | None:
        self.asked_after = after
        return None if self.blind else Shot(after + 0.1)

    def view(self, picture: object, camera: Camera) -> tuple[UInt8Array, BoolArray]:
        seen = np.ones((camera.height, camera.width), np.bool_)
        seen[:, :10] = False
        return np.full((camera.height, camera.width, 3), self.light, np.uint8), seen

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        shape = rgb.shape[:2]
        return np.full(shape, Label.SEABED, np.uint8), np.full(shape, self.sure, np.float32)

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        assert view.altitude == pytest.approx(0.6)
        return np.full(labels.shape, self.depth, np.float32), np.ones(labels.shape, np.float32)


def test_it_arrives_and_looks_after_that(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    robot = scene.robot(monkeypatch)
    arrival = robot.go_to(GOAL)
    assert arrival.pose.distance(SE2(0.3, 0.0, 0.0)) <= Manners().near
    assert arrival.distance == pytest.approx(arrival.pose.x, abs=1e-9)
    assert (arrival.note, arrival.collided, arrival.truth) == ("", False, None)
    arrived = scene.now
    observation = robot.observe()
    assert scene.asked_after == arrived
    assert observation.time > arrived
    # What the lens did not see is no depth.
    assert np.isnan(observation.depth[:, :10]).all()
    assert np.isfinite(observation.depth[:, 10:]).all()


def test_beams_of_the_dvl_go_with_the_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, beams, views = Scene(), np.ones((4, 3)), []

    class Seeing(Perception):
        def perceive(self, rgb: UInt8Array, view: View, seen: BoolArray | None = None) -> Perceived:
            views.append(view)
            return super().perceive(rgb, view, seen)

    monkeypatch.setattr("tests.robots.bluerov2.test_rov.Perception", Seeing)
    scene.robot(monkeypatch, beams=lambda: beams).observe()
    scene.robot(monkeypatch).observe()
    assert [view.beams for view in views] == [beams, None]


def test_how_sure_it_is_goes_with_what_it_saw(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    robot = scene.robot(monkeypatch)
    for sure, counts in ((0.75, True), (0.3, True), (0.0, False)):
        scene.sure = sure
        observation = robot.observe()
        assert observation.confidence is not None
        np.testing.assert_allclose(observation.confidence[:, 10:], sure)
        # What the lens did not see is nothing to be sure of.
        assert (observation.confidence[:, :10] == 0.0).all()
        assert np.isfinite(observation.depth[:, 10:]).all() == counts
    assert [account.confidence for account in robot.accounts] == pytest.approx([0.75, 0.3, 0.0])
    assert robot.accounts[-1].lost == 240 * 310


@pytest.mark.parametrize(
    ("said", "trouble"),
    [
        ({}, ""),
        ({"battery": 0.21, "sagged": 14.4}, ""),
        ({"battery": 0.2}, "the battery has 20% left"),
        # It has recovered since, but did not last under the load of a move.
        ({"voltage": 15.2, "sagged": 14.3}, "the battery is at 14.3 V"),
        ({"battery": 0.1, "sagged": 14.3}, "the battery has 10% left"),
    ],
)
def test_a_battery_that_is_low_is_trouble(
    said: dict[str, Any], trouble: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = Telemetry(0.0, **said)
    robot = Scene().robot(monkeypatch, vehicle=lambda: vehicle, homing_voltage=14.4)
    assert robot.observe().trouble == trouble


def test_it_shows_that_the_mission_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    robot = scene.robot(monkeypatch)
    robot.go_to(GOAL)
    assert max(np.diff([until - 0.5 for until in scene.renewed[:-1]])) <= 0.5
    assert scene.renewed[-1] - scene.now <= rov.SOON
    # The planner may think for longer than looking takes.
    robot.observe()
    assert scene.renewed[-1] == pytest.approx(scene.now + Manners().thinking)


def test_a_dive_that_is_over_is_an_aborted_mission(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()

    def leak() -> None:
        if scene.now > 11.0:
            scene.standing = Standing(Stance.OVER, "water in the hull")

    scene.each = leak
    with pytest.raises(MissionAborted, match="water in the hull"):
        scene.robot(monkeypatch).go_to(GOAL)
    assert scene.now < 11.1


def test_where_somebody_leaves_it_the_move_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(speed=0.15, standing=Standing(Stance.YIELD, "the pilot has the sticks"))
    # The pilot rests on the goal itself for a while: that is no arrival. Then it is taken far away.
    scene.fix = fix_at(GOAL.x)

    def free() -> None:
        if 50.0 < scene.now < 100.0:
            scene.fix = fix_at(-1.5)
        elif scene.now >= 100.0:
            scene.standing = Standing(Stance.GO)

    scene.each = free
    arrival = scene.robot(monkeypatch).go_to(GOAL)
    # Nobody has looked whether the way from there to the goal is free.
    assert 100.0 <= scene.now < 100.5
    assert arrival.pose.distance(SE2(-1.5, 0.0, 0.0)) < 0.05
    assert scene.goals[-1].distance(arrival.pose) < 0.05
    assert "the pilot has the sticks" in arrival.note
    assert "moved aside" in arrival.note


def test_a_dive_that_is_over_ends_the_mission_whoever_has_the_vehicle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(standing=Standing(Stance.YIELD, "somebody else drives"))
    scene.each = lambda: setattr(scene, "over", "ended by the operator") if scene.now > 12.0 else None
    with pytest.raises(MissionAborted, match="ended by the operator"):
        scene.robot(monkeypatch).go_to(GOAL)
    assert scene.now < 12.1


def test_it_waits_while_it_may_not_move_and_notes_why(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(standing=Standing(Stance.YIELD, "somebody else drives"))

    def free() -> None:
        if scene.now > 100.0:
            scene.standing = Standing(Stance.GO)

    scene.each = free
    arrival = scene.robot(monkeypatch).go_to(GOAL)
    assert scene.now > 100.0
    assert arrival.pose.distance(SE2(0.3, 0.0, 0.0)) <= Manners().near
    assert arrival.note == "somebody else drives"


def test_a_move_that_does_not_end_is_broken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(speed=0.0)
    arrival = scene.robot(monkeypatch).go_to(GOAL)
    assert "too long" in arrival.note
    assert scene.now < 10.0 + Manners().room + 10.0


def test_the_operator_pauses_and_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()

    def rule() -> None:
        if 11.0 < scene.now < 20.0:
            scene.will = "hold"
        elif scene.now >= 20.0:
            scene.will = "go"

    scene.each = rule
    robot = scene.robot(monkeypatch)
    robot.go_to(GOAL)
    assert scene.now > 20.0
    here = scene.goals[1]
    assert 0.05 < here.x < 0.15
    assert scene.goals[2] == SE2(0.3, 0.0, 0.0)

    before = len(scene.goals)
    scene.will = "pause"
    scene.each = lambda: setattr(scene, "will", "go") if scene.now > 60.0 else None
    robot.go_to(Setpoint(0.0, 0.0, 0.0, 0.6))
    assert scene.now > 60.0
    assert len(scene.goals) == before + 1


UP = Setpoint(0.0, 0.0, 0.0, None, -0.4)


def test_at_a_height_it_arrives_when_it_rests_there(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    arrival = scene.robot(monkeypatch).go_to(UP)
    assert scene.fix.T_world_base.translation[2] == pytest.approx(-0.4)
    assert scene.now - 10.0 == pytest.approx(0.5 / scene.speed + Manners().stay, abs=0.1)
    assert arrival.distance == pytest.approx(0.5)
    assert (scene.goals, scene.heights) == ([SE2(0.0, 0.0, 0.0)], [-0.4])


def test_it_is_held_at_the_height_that_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()

    def rule() -> None:
        scene.will = "hold" if 11.0 < scene.now < 20.0 else "go"

    scene.each = rule
    scene.robot(monkeypatch).go_to(UP)
    first, held, last = scene.heights
    assert (first, last) == (-0.4, -0.4)
    assert held == pytest.approx(-0.8, abs=0.02)


@dataclass
class Servo:
    """A mount that goes up to 30° either way; says where it looks, unless it is silent."""

    silent: bool = False
    looks: float = 0.0
    why: type[Exception] = TimeoutError

    @property
    def telemetry(self) -> Telemetry:
        return Telemetry(0.0, camera_tilt=math.nan if self.silent else self.looks)

    def tilt_camera(self, up: float) -> float:
        self.looks = max(-0.5, min(up, 0.5)) + 0.01
        if self.silent or abs(self.looks - up) > 0.05:
            raise self.why("camera tilt: it stays elsewhere")
        return self.looks


def tilted(down: float) -> Setpoint:
    return Setpoint(0.0, 0.0, 0.0, None, -0.9, down)


@pytest.mark.parametrize("why", [TimeoutError, Refused, ValueError])
def test_the_camera_looks_where_its_mount_says(monkeypatch: pytest.MonkeyPatch, why: type[Exception]) -> None:
    scene, servo = Scene(), Servo(why=why)
    at = SE3(POOL_V1.T_base_camera.rotation, np.array([0.2, 0.0, 0.1]))
    robot = scene.robot(monkeypatch, mount=servo, T_base_camera=at)
    assert robot.observe().tilt == pytest.approx(POOL_V1.camera_pitch)
    assert robot.go_to(tilted(0.4)).note == ""
    for _ in range(2):
        seen = robot.observe()
        assert seen.tilt == pytest.approx(0.39)
        assert seen.T_base_camera.translation.tolist() == [0.2, 0.0, 0.1]
        robot.go_to(replace(tilted(0.0), tilt=None))
    # It is looked through as it is where it does not get there.
    assert robot.go_to(tilted(0.8)).note == "camera tilt: it stays elsewhere"
    assert robot.observe().tilt == pytest.approx(0.49)


@pytest.mark.parametrize(("mount", "why"), [(None, "that tilts it"), (Servo(silent=True), "that says where")])
def test_without_a_mount_that_tilts_and_tells_there_is_no_tilting(
    monkeypatch: pytest.MonkeyPatch, mount: Servo | None, why: str
) -> None:
    robot = Scene().robot(monkeypatch, mount=mount)
    with pytest.raises(MissionAborted, match=f"camera: expected a mount {why}"):
        robot.go_to(tilted(0.4))


def test_a_move_in_space_is_straight_and_ends_there(tmp_path: Path) -> None:
    """Of the vehicle in the water, by the bytes of MAVLink and the lines of the A50."""
    world, protocol = make_world("flat/empty", 1), DREAM_V2_TRUE
    with Rig(tmp_path, world, protocol, pictures=2.0, width=80) as rig:
        rig.ready()
        bridge = rig.begin()
        robot = BlueRov2(
            bridge,
            rig.navigator,
            LiveEye(rig.devices.camera, None),
            Perception(Shells(), FlatFloor()),
            protocol,
            rig.now,
            frozen=lambda: False,
            mount=rig.link,
            truth=rig.truth,
            threads=rig.clock,
        )
        start, z = rig.start, protocol.launch_height(bridge.fix.seabed)
        robot.go_to(Setpoint(start.x, start.y, start.yaw, None, z))
        begun, way = rig.truth()[0].translation, rigged.truth_at(rig)
        ahead = np.array([math.cos(start.yaw), math.sin(start.yaw), 1.0])
        x, y, z = (float(value) for value in np.array([start.x, start.y, z]) + ahead)
        arrival = robot.go_to(Setpoint(x, y, start.yaw, None, z, math.radians(45.0)))
        seen, ended = robot.observe(), rig.truth()[0].translation
    assert (arrival.note, arrival.collided) == ("", False)
    assert arrival.distance == pytest.approx(math.sqrt(2.0), abs=0.3)
    np.testing.assert_allclose(ended, [x, y, z], atol=0.15)
    flown = np.array([pose.translation for _, pose in way]) - begun
    line = ahead / math.sqrt(2.0)
    assert np.linalg.norm(flown - np.outer(flown @ line, line), axis=1).max() < 0.2
    assert math.degrees(seen.tilt) == pytest.approx(45.0, abs=0.1)
    assert seen.z == pytest.approx(z, abs=0.1)


def test_without_pictures_it_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(blind=True)
    with pytest.raises(MissionAborted, match="camera: expected a frame"):
        scene.robot(monkeypatch).observe()


def test_with_a_frozen_camera_it_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    robot = scene.robot(monkeypatch)
    robot.observe()
    scene.frozen = True
    with pytest.raises(MissionAborted, match=r"^camera: .* change while the vehicle moves, .* frozen\?"):
        robot.observe()
    assert len(robot.picture_ages) == 1


def test_a_dark_camera_is_trouble_and_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    robot = scene.robot(monkeypatch)
    assert np.isfinite(robot.observe().depth).any()
    scene.light, troubles = 0, []
    for _ in range(RUNNING):
        robot.go_to(GOAL)
        seen = robot.observe()
        troubles.append(seen.trouble)
        assert np.isnan(seen.depth).all()
    assert troubles == [""] * (RUNNING - 1) + ["the camera is dark: from the first pictures on"]


def test_contacts_of_a_stand_in_are_those_of_the_move(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, contacts = Scene(), iter([2, 3, 3])
    pose = SE3.level(0.31, 0.0, -0.9, 0.0)
    robot = scene.robot(monkeypatch, truth=lambda: (pose, next(contacts)))
    first, second = robot.go_to(GOAL), robot.go_to(GOAL)
    assert first.collided
    assert first.truth is pose
    assert not second.collided


def test_manners_are_checked() -> None:
    with pytest.raises(ValueError, match="near: expected a number above 0"):
        Manners(near=0.0)
