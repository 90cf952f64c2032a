"""A frozen camera is found whatever flickers in its picture, and one that lives is never taken for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest

from dream.errors import MissionAborted
from dream.geometry import SE2, SE3
from dream.perception import Perception, View
from dream.protocol import POOL_V1
from dream.robots.bluerov2.camera import Frames, LiveCamera
from dream.robots.bluerov2.devices import LiveEye
from dream.robots.bluerov2.likeness import Glance, glance
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.rov import BlueRov2
from dream.robots.bluerov2.sight import DIM, FROZEN, MOVED, SILENT, STARES, Sight
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.types import Float32Array, Label, UInt8Array
from tests.robots.bluerov2.test_bridge import fix_at
from tests.robots.bluerov2.views import (
    BEAT,
    PERIOD,
    Flight,
    Moves,
    Stream,
    Wrong,
    clocked,
    encoded,
    exposed,
    flight,
    gripping,
    lit,
    noisy,
    snowy,
    way,
)

STEPS: Moves = ((0.2, 0.0, 0.0), (0.0, 0.0, 15.0), (0.2, 0.0, 0.0), (0.0, 0.2, 0.0))
"""As a survey of the tank makes them."""
LEGS: Moves = ((1.0, 0.0, 0.0), (0.0, 0.0, 60.0), (0.5, 0.0, 0.0))
SCENES: dict[str, Callable[[], Flight]] = {
    "tank": partial(flight, "pool/arc", STEPS, speed=0.2, start=1),
    "sand": partial(flight, "reef/string", LEGS, speed=0.4),
    "murk": partial(flight, "reef/string", LEGS, speed=0.4, water="turbid", start=1),
}
"""Shells and pipes below caustics; rippled sand; the same in water in which little is seen."""


def as_it_is(rgb: UInt8Array, k: int) -> UInt8Array:
    return rgb


def exposed_and_noisy(rgb: UInt8Array, k: int) -> UInt8Array:
    return noisy(exposed(rgb, k), k)


def lit_and_noisy(rgb: UInt8Array, k: int) -> UInt8Array:
    return noisy(lit(rgb, k), k)


WRONGS: tuple[Wrong, ...] = (noisy, encoded, clocked, snowy, exposed, exposed_and_noisy)
scenes = pytest.mark.parametrize("scene", SCENES)


@pytest.mark.few(5)
@scenes
@pytest.mark.parametrize("wrong", [as_it_is, *WRONGS, lit_and_noisy, gripping])
def test_a_camera_that_lives_is_never_taken_for_a_frozen_one(scene: str, wrong: Wrong) -> None:
    assert set(SCENES[scene]().told(wrong)) == {""}


@pytest.mark.few(7)
@scenes
@pytest.mark.parametrize("wrong", WRONGS)
@pytest.mark.parametrize("since", [0.3, 1.0])
def test_a_frozen_picture_is_found_whatever_flickers_in_it(scene: str, wrong: Wrong, since: float) -> None:
    """Before it sets out, and on its way."""
    seen = SCENES[scene]()
    told = seen.frozen(since).told(wrong)
    first = told.index(FROZEN)
    assert set(told[:first]) == {""}
    assert set(told[first:]) == {FROZEN}
    # The steps of a survey end where nobody can tell, and sand two metres below says less.
    assert seen.gone(since, BEAT * first) <= (0.3 if scene == "tank" else 0.55)


def test_steps_that_are_too_short_to_tell_add_up() -> None:
    seen = flight("pool/arc", ((0.1, 0.0, 0.0),) * 4, speed=0.2, start=1)
    told = seen.frozen(0.3).told(noisy)
    first = told.index(FROZEN)
    assert seen.gone(0.3, BEAT * first) == pytest.approx(0.2, abs=0.03)
    assert set(seen.told(noisy)) == {""}


@pytest.mark.parametrize("since", [0.3, 1.8])
def test_turns_that_are_too_short_to_tell_add_up(since: float) -> None:
    """From where it froze on: at rest, and in the second turn."""
    seen = flight("pool/arc", ((0.0, 0.0, 15.0),) * 5, speed=0.2, start=1)
    told = seen.frozen(since).told(clocked)
    assert seen.gone(since, BEAT * told.index(FROZEN)) <= math.radians(46.0) / 3.0
    assert set(seen.told(clocked)) == {""}


def test_at_rest_nobody_can_tell() -> None:
    tank = SCENES["tank"]()
    wobble = [
        SE2(tank.poses[0].x + 0.01 * math.sin(0.1 * n), tank.poses[0].y, tank.poses[0].yaw)
        for n in range(500)
    ]
    for wrong in (as_it_is, noisy, clocked):
        still = Flight(wobble, tank.pictures[:1] * 200)
        assert set(still.told(wrong)) == {""}


@pytest.mark.few(3)
@pytest.mark.parametrize("wrong", [as_it_is, noisy, exposed, clocked])
def test_where_there_is_too_little_to_see_that_is_said(wrong: Wrong) -> None:
    """High above the ground in turbid water, and in the dark; where a clock is all there is to see, too."""
    water = flight("reef/string", LEGS, speed=0.4, water="turbid", height=9.5)
    dark = replace(SCENES["sand"](), pictures=[np.zeros_like(water.pictures[0])] * len(water.pictures))
    for seen in (water, water.frozen(0.3), dark):
        told = seen.told(wrong)
        assert set(told) == {"", DIM}
        assert told[-1] == DIM


def test_lights_that_go_out_and_on_again_are_told_as_what_they_are() -> None:
    sand = SCENES["sand"]()

    def dark(rgb: UInt8Array, k: int) -> UInt8Array:
        return noisy(np.zeros_like(rgb) if 10 <= k < 50 else rgb, k)

    told = sand.told(dark)
    assert told[round(4.8 / BEAT)] == DIM
    assert told[-1] == ""
    assert FROZEN not in told


def test_a_stream_that_goes_on_is_seen_again() -> None:
    told = SCENES["sand"]().frozen(0.3, 5.0).told(noisy)
    assert told[round(4.9 / BEAT)] == FROZEN
    assert set(told[round(5.2 / BEAT) :]) == {""}


def test_pictures_that_are_sent_twice_say_nothing_of_noise() -> None:
    def twice(rgb: UInt8Array, k: int) -> UInt8Array:
        return noisy(rgb, k // 2)

    murk = SCENES["murk"]()
    assert set(murk.told(twice)) == {""}
    assert murk.frozen(0.3).told(twice)[-1] == FROZEN


def test_tiles_that_look_alike_a_step_farther_on_are_no_frozen_picture() -> None:
    tiles = np.random.default_rng(1).integers(60, 180, (4, 4), np.uint8).repeat(10, 0).repeat(10, 1)
    floor = np.tile(tiles, (6, 10))[..., None].repeat(3, 2)
    poses = way(SE2(0.0, 0.0, 0.0), ((0.2, 0.0, 0.0),) * 4, speed=0.2)
    times = np.arange(round(len(poses) * BEAT / PERIOD)) * PERIOD
    # Tiles of 0.2 m, of 40 pixels: 200 pixels are a metre.
    at = [round(200.0 * poses[round(time / BEAT)].x) % 40 for time in times]
    seen = Flight(poses, [floor[:, n : n + 320] for n in at])
    assert set(seen.told()) == {""}
    assert seen.frozen(0.3).told(clocked)[-1] == FROZEN


def test_an_estimate_that_leaps_or_has_no_bottom_to_go_by_is_no_move() -> None:
    tank = SCENES["tank"]()
    rest, here = tank.pictures[:1] * 100, tank.poses[0]
    leaps = [SE2(here.x + (1.0 if n > 120 else 0.0), here.y, here.yaw) for n in range(250)]
    drifts = [SE2(here.x + 0.005 * max(n - 100, 0), here.y, here.yaw) for n in range(250)]
    assert set(Flight(leaps, rest).told(noisy)) == {""}
    assert set(Flight(drifts, rest, dvl_age=2.0).told(noisy)) == {""}
    # With a bottom the same drift is a way, and the picture that of a camera that does not see it.
    assert FROZEN in Flight(drifts, rest).told(noisy)


def test_pictures_that_come_late_are_those_of_an_earlier_place() -> None:
    """Half a metre in a second: what is shown at 0.2 m is still the place that it set out from."""
    seen = flight("pool/arc", ((0.5, 0.0, 0.0),), speed=0.5, start=1, lag=0.45)
    assert set(seen.told(noisy)) == {""}


def test_a_picture_is_looked_at_once_and_not_more_often_than_is_of_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tank, looked = SCENES["tank"](), list[UInt8Array]()

    def look(rgb: UInt8Array) -> Glance:
        looked.append(rgb)
        return glance(rgb)

    monkeypatch.setattr("dream.robots.bluerov2.sight.glance", look)
    tank.told()
    assert len(tank.pictures) - len(looked) in (0, 1)
    looked.clear()
    stream = Stream()
    sight = Sight(stream)
    for n in range(250):
        stream.show(0.02 * n, noisy(tank.pictures[0], n))
        sight(fix_at(time=0.02 * n))
    assert 50 <= len(looked) <= 63


# To the last bit


@dataclass
class Steady:
    """A camera at ten frames a second, asked at 25 Hz while the vehicle moves."""

    stream: Stream = field(default_factory=Stream)
    told: list[str] = field(default_factory=list)
    beats: int = 0

    def __post_init__(self) -> None:
        self.stream.show(0.0, SCENES["tank"]().pictures[0])

    def watched(self, sight: Sight, seconds: float, *, speed: float, x: float = 0.0, same: bool) -> float:
        for _ in range(round(seconds / BEAT)):
            self.beats += 1
            time = BEAT * self.beats
            x += BEAT * speed
            if self.beats % 3 == 0:
                rgb = self.stream.picture.rgb
                self.stream.show(time, rgb if same else noisy(rgb, self.beats, 1.0))
            self.told.append(sight(fix_at(x, time=time)))
        return x


def test_a_camera_of_which_nothing_comes_is_told_at_once() -> None:
    camera = Steady()
    sight = Sight(camera.stream)
    x = camera.watched(sight, 0.4, speed=0.2, same=False)
    camera.stream.connected = False
    assert sight(fix_at(x)) == SILENT
    assert not sight.frozen
    camera.stream.connected = True
    assert sight(fix_at(x)) == ""
    assert set(camera.told) == {""}


def test_a_camera_that_shows_the_same_to_the_last_bit_is_told_on_the_way() -> None:
    camera = Steady()
    sight = Sight(camera.stream)
    x = camera.watched(sight, 0.4, speed=0.2, same=False)
    assert set(camera.told) == {""}
    camera.told.clear()
    x = camera.watched(sight, 0.9, speed=0.2, x=x, same=True)
    # After it had moved by 4 cm, and half a second.
    first = BEAT * camera.told.index(FROZEN)
    assert first + 0.041 >= MOVED / 0.2 + STARES
    assert sight.frozen
    # It stays so while it stands, until something else is seen.
    camera.told.clear()
    camera.watched(sight, 0.5, speed=0.0, x=x, same=True)
    assert set(camera.told) == {FROZEN}
    camera.stream.show(BEAT * camera.beats + 0.1, SCENES["tank"]().pictures[-1])
    assert sight(fix_at(x)) == ""
    assert not sight.frozen


def test_a_camera_may_show_the_same_while_the_vehicle_rests_and_for_a_moment_of_its_way() -> None:
    """Pictures come late: those of rest are still shown when it has set out."""
    camera = Steady()
    sight = Sight(camera.stream)
    x = camera.watched(sight, 30.0, speed=0.001, same=True)
    camera.watched(sight, 0.5, speed=0.2, x=x, same=True)
    assert set(camera.told) == {""}


# With camera and mission


@dataclass
class Aboard:
    """Bridge, navigator and perception of a vehicle on a simulated clock, whose camera can freeze."""

    seen: Flight
    wrong: Wrong
    clock: LockStep = field(default_factory=LockStep)

    def frames(self, closed: Callable[[], bool]) -> Iterator[tuple[float, UInt8Array]]:
        for k, rgb in enumerate(self.seen.pictures):
            if closed():
                return
            self.clock.sleep(PERIOD)
            yield self.clock(), self.wrong(rgb, k)[..., ::-1]
        while not closed():
            self.clock.sleep(PERIOD)

    @property
    def fix(self) -> Fix:
        pose = self.seen.poses[min(round(self.clock() / BEAT), len(self.seen.poses) - 1)]
        return fix_at(time=self.clock(), T_world_base=SE3.level(pose.x, pose.y, -0.9, pose.yaw))

    def renew(self, seconds: float) -> None: ...

    def at(self, time: float) -> SE3:
        return SE3.level(0.0, 0.0, -0.9, 0.0)

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        return np.full(rgb.shape[:2], Label.SEABED, np.uint8), np.ones(rgb.shape[:2], np.float32)

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, *_: object) -> tuple[Float32Array, Float32Array]:
        return np.ones(labels.shape, np.float32), np.ones(labels.shape, np.float32)


@pytest.mark.parametrize("frozen", [False, True])
def test_a_mission_ends_at_its_next_look_with_a_camera_that_froze(frozen: bool) -> None:
    tank = SCENES["tank"]()
    aboard = Aboard(tank.frozen(0.3) if frozen else tank, clocked)
    clock = aboard.clock
    with LiveCamera(Frames(aboard.frames), clock, threads=clock) as camera:
        sight = Sight(camera)
        robot = BlueRov2(
            aboard,  # type: ignore[arg-type]
            aboard,  # type: ignore[arg-type]
            LiveEye(camera),
            Perception(aboard, aboard),
            POOL_V1,
            clock,
            frozen=lambda: sight.frozen,
        )
        clock.sleep(0.2)

        def beats(until: float) -> None:
            while clock() < until:
                sight(aboard.fix)
                clock.sleep(BEAT)

        beats(0.45)
        assert robot.observe().rgb.shape == (240, 320, 3)
        # The first step is over, and the next.
        beats(2.2)
        if frozen:
            with pytest.raises(MissionAborted, match=r"^camera: .* while the vehicle moves.* frozen\?"):
                robot.observe()
        else:
            robot.observe()
