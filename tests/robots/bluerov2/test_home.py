"""The way home: whatever a vehicle does not obey, it comes up and is disarmed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.geometry import SE2, SE3, Bounds
from dream.robots.bluerov2.bridge import Bridge, Stance
from dream.robots.bluerov2.drives import AltHold
from dream.robots.bluerov2.home import DEAF, EVERY, LEAVING, SHALLOW, SILENT, SURE, UNHEARD, WayHome
from dream.robots.bluerov2.limits import SAG, LastResort, Limits
from dream.robots.bluerov2.mavlink import LIFELINE, Link
from dream.robots.bluerov2.motion import Order
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.sticks import Joystick, Sticks
from dream.vehicle import VECTORED_6DOF
from tests.robots.bluerov2.diver import ASCENT, Diver, afloat
from tests.robots.bluerov2.test_bridge import fix_at
from tests.robots.bluerov2.test_mavlink import is_neutral

LIMITS = Limits(Bounds(-2.0, -2.0, 2.0, 2.0))
FOR_EVER = 10**9
MOVES = ("MANUAL_CONTROL", "COMMAND_LONG")


@dataclass
class Scene:
    """A vehicle 3 m down, armed in ALT_HOLD by a link, and its way home."""

    diver: Diver
    link: Link
    home: WayHome
    steered: bool = False
    """Has a person the sticks?"""
    truth: Any = None
    """In the place of a navigator."""

    @property
    def clock(self) -> LockStep:
        return self.diver.clock

    def comes_home(self, how: LastResort = LastResort.SURFACE, within: float = 60.0) -> float:
        """Seconds until it is there; infinite where it is not within so many."""
        began = self.clock()
        self.home.begin(how)
        while not self.home.there and self.clock() - began < within:
            self.clock.sleep(EVERY)
        return self.clock() - began if self.home.there else math.inf

    def deepest_since(self, time: float) -> float:
        return max(depth for t, depth, _, _ in self.diver.history if t >= time)


@contextmanager
def at_sea(mode: str = "ALT_HOLD", **options: Any) -> Iterator[Scene]:
    diver = Diver(LockStep(), **options)
    refuses, diver.refuses = diver.refuses, Counter()
    deaf, diver.deaf = diver.deaf, lambda message: False
    with afloat(diver, mode) as link:
        diver.refuses, diver.deaf = refuses, deaf
        scene = Scene(diver, link, None)  # type: ignore[arg-type]
        scene.home = WayHome(link, LIMITS, diver.clock, person=lambda: scene.steered, threads=diver.clock)
        yield scene
        scene.home.close()


# Whatever it does not obey


def test_it_comes_up_by_surface_and_is_disarmed_at_the_top() -> None:
    with at_sea() as scene:
        took = scene.comes_home()
        assert took < (3.0 - SHALLOW) / ASCENT + 1.0
        assert scene.diver.depth < SHALLOW
        assert not scene.diver.armed
        assert scene.home.troubles == []
        # Asked until its heartbeat showed it, and not again.
        assert max(scene.diver.asked(mode="SURFACE")) < 1.0 + scene.clock() - took


@dataclass(frozen=True)
class Fault:
    """What a vehicle does not obey, and what is said of it."""

    trouble: str
    within: float
    """Seconds that it may take all the same, from 3 m."""
    mode: str = "ALT_HOLD"
    """That it flew in."""
    options: dict[str, Any] = field(default_factory=dict)


def to_commands(message: Any) -> bool:
    return bool(message.get_type() == "COMMAND_LONG")


FAULTS = {
    "SURFACE is refused": Fault(
        "No way", 10.0, options={"refuses": Counter(SURFACE=FOR_EVER), "why": "No way"}
    ),
    "SURFACE does not lift it": Fault(
        "SURFACE: expected it to rise", 14.0, options={"lifts": frozenset({"ALT_HOLD"})}
    ),
    "nor do sticks in ALT_HOLD": Fault(
        "sticks in ALT_HOLD: expected it to rise", 16.0, options={"lifts": frozenset({"MANUAL"})}
    ),
    "SURFACE and ALT_HOLD are refused": Fault(
        "DO_SET_MODE",
        12.0,
        mode="GUIDED",
        options={"refuses": Counter(SURFACE=FOR_EVER, ALT_HOLD=FOR_EVER)},
    ),
    "it does not tell its own depth": Fault(
        "DO_SET_MODE",
        10.0,
        options={"refuses": Counter(SURFACE=FOR_EVER), "tells_own": False},
    ),
    "it tells no depth at all": Fault(
        "got nan m", 14.0, options={"tells_own": False, "tells_depth": False, "lifts": frozenset({"MANUAL"})}
    ),
    "disarming is refused five times": Fault(
        "COMPONENT_ARM_DISARM", 13.0, options={"refuses": Counter(disarm=5)}
    ),
    "nothing lifts it": Fault("sticks in MANUAL: expected", 14.0, options={"lifts": frozenset()}),
}
"""Each alone, and by the times above it is not merely disarmed in the end."""


@pytest.mark.parametrize("name", FAULTS)
def test_whatever_it_does_not_obey_it_comes_up_and_is_disarmed(name: str) -> None:
    fault = FAULTS[name]
    with at_sea(fault.mode, **fault.options) as scene:
        began = scene.clock()
        assert scene.comes_home() < fault.within
        assert not scene.diver.armed
        assert any(fault.trouble in trouble for trouble in scene.home.troubles)
        assert scene.deepest_since(began) < 3.0 + 0.05
        if name not in ("nothing lifts it", "it tells no depth at all"):
            assert scene.diver.depth < SHALLOW


def test_commands_that_are_lost_for_four_seconds_delay_it_by_no_more() -> None:
    with at_sea() as scene:
        lost_until = scene.clock() + 4.0
        scene.diver.deaf = lambda message: to_commands(message) and scene.clock() < lost_until
        assert scene.comes_home() < (3.0 - SHALLOW) / ASCENT + 1.0 + 4.0
        assert scene.diver.depth < SHALLOW


def without_commands(scene: Scene) -> list[float]:
    """From now on no command reaches it; when disarming was tried."""
    tried: list[float] = []

    def lost(message: Any) -> bool:
        if to_commands(message) and message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            tried.append(scene.clock())
        return to_commands(message)

    scene.diver.deaf = lost
    return tried


def test_without_any_command_it_comes_up_by_sticks_and_disarming_is_tried_for_ever() -> None:
    with at_sea() as scene:
        tried = without_commands(scene)
        began = scene.clock()
        assert scene.comes_home(within=180.0) == math.inf
        up = min(t for t, depth, _, _ in scene.diver.history if t > began and depth < SHALLOW)
        assert up - began < 13.0
        # It stays there meanwhile, and whenever commands come through it is there soon.
        assert scene.deepest_since(up) < SHALLOW
        pauses = [b - a for a, b in pairwise(tried)]
        assert max(pauses) < SILENT + 1.0
        assert sum(pause > 1.0 for pause in pauses) <= 180.0 / (DEAF + SILENT)
        scene.diver.deaf = lambda message: False
        assert scene.comes_home(within=SILENT + 1.0) < SILENT + 1.0
        assert not scene.diver.armed


def test_one_that_cannot_be_disarmed_is_not_spoken_to_until_its_failsafe_has_done_it() -> None:
    with at_sea(failsafe=3.0) as scene:
        without_commands(scene)
        began = scene.clock()
        assert scene.comes_home(within=60.0) < 13.0 + DEAF + LIFELINE + 3.0 + 2.0
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW
        # Not before: sticks kept coming for as long as disarming was tried.
        disarmed = min(t for t, _, _, armed in scene.diver.history if not armed)
        up = min(t for t, depth, _, _ in scene.diver.history if t > began and depth < SHALLOW)
        assert disarmed - up > DEAF
        assert any("left to its failsafe" in trouble for trouble in scene.home.troubles)


@pytest.mark.rare
def test_one_that_comes_up_too_slowly_is_disarmed_and_where_that_is_refused_it_begins_again() -> None:
    with at_sea(depth=60.0, refuses=Counter(disarm=1)) as scene:
        began = scene.clock()
        assert scene.comes_home(within=1.1 * LEAVING) == math.inf
        (refused,) = scene.diver.asked(disarm=True)
        assert refused - began == pytest.approx(LEAVING, abs=0.2)
        # It goes on to rise.
        before = scene.diver.depth
        scene.clock.sleep(8.0)
        assert scene.diver.depth < before - 1.0
        assert scene.comes_home(within=LEAVING) < LEAVING
        assert not scene.diver.armed


def test_at_the_surface_already_it_is_disarmed_at_once() -> None:
    with at_sea(depth=0.3) as scene:
        assert scene.comes_home() <= 0.5
        assert scene.diver.asked(mode="SURFACE") == []


@pytest.mark.parametrize("placed", [False, True])
@pytest.mark.parametrize("zero", [0.0, 1.5, -49.0])
def test_wherever_the_autopilot_has_its_zero_it_is_up_where_the_water_ends(zero: float, placed: bool) -> None:
    with at_sea(zero=zero, placed=placed) as scene:
        assert scene.home.depth == pytest.approx(3.0, abs=0.1)
        took = scene.comes_home()
        assert took < (3.0 - SHALLOW) / ASCENT + 1.0
        assert scene.diver.depth < SHALLOW


@pytest.mark.parametrize("stuck", [{"gauge_stuck": 0.2}, {"own_stuck": -0.2}])
def test_one_reading_that_is_stuck_near_the_surface_has_nobody_disarmed_below(
    stuck: dict[str, float],
) -> None:
    with at_sea() as scene:
        for name, value in stuck.items():
            setattr(scene.diver, name, value)
        scene.comes_home()
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW


@pytest.mark.parametrize("placed", [False, True])
def test_a_source_of_its_own_depth_with_another_zero_is_none_to_go_by(placed: bool) -> None:
    # By the other it would be 49 m too high, or too deep.
    with at_sea(placed=placed) as scene:
        scene.comes_home(within=2.0)
        scene.diver.placed = not placed
        assert scene.comes_home() < (3.0 - SHALLOW) / ASCENT + 2.0
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW


def test_a_surface_that_turns_into_alt_hold_at_the_top_is_no_other_hand() -> None:
    # It was zeroed by an air pressure that is none: it is up, and does not know it.
    with at_sea(depth=1.0, gauge_zero=-0.4, refuses=Counter(disarm=2)) as scene:
        scene.comes_home()
        # Where it is asked for a second time, up there, it ends before any heartbeat shows it.
        manual = min(t for t, _, mode, _ in scene.diver.history if mode == "MANUAL")
        again = max(scene.diver.asked(mode="SURFACE"))
        assert again > manual
        assert {mode for t, _, mode, _ in scene.diver.history if again < t < again + 2.0} == {"ALT_HOLD"}
        assert scene.link.yielding == ""
        assert not scene.diver.armed


@pytest.mark.rare
@settings(max_examples=30)
@given(
    lifts=st.sets(st.sampled_from(["SURFACE", "ALT_HOLD", "MANUAL"])),
    refuses=st.dictionaries(st.sampled_from(["SURFACE", "ALT_HOLD", "MANUAL"]), st.integers(0, 20)),
    disarms=st.integers(0, 5),
    deaf_for=st.floats(0.0, 12.0),
    tells=st.tuples(st.booleans(), st.booleans()),
    mode=st.sampled_from(["ALT_HOLD", "GUIDED"]),
)
def test_no_mixture_of_faults_keeps_it_armed_for_ever(
    lifts: set[str],
    refuses: dict[str, int],
    disarms: int,
    deaf_for: float,
    tells: tuple[bool, bool],
    mode: str,
) -> None:
    refusing = Counter({**refuses, "disarm": disarms})
    options = {"lifts": frozenset(lifts), "refuses": refusing, "tells_own": tells[0], "tells_depth": tells[1]}
    with at_sea(mode, **options) as scene:
        began = scene.clock()
        scene.diver.deaf = lambda message: to_commands(message) and scene.clock() < began + deaf_for
        assert scene.comes_home(within=200.0) < 200.0
        assert not scene.diver.armed
        assert scene.deepest_since(began) < 3.0 + 0.05


# Holding


def test_one_that_is_to_hold_does_so_until_somebody_ends_it() -> None:
    with at_sea("GUIDED") as scene:
        depth = scene.diver.depth
        assert scene.comes_home(LastResort.HOLD, within=60.0) == math.inf
        assert (scene.diver.mode, scene.diver.armed) == ("ALT_HOLD", True)
        assert scene.diver.depth == pytest.approx(depth, abs=0.05)
        assert len(scene.diver.asked(mode="ALT_HOLD")) <= 3
        assert scene.diver.asked(disarm=True) == []


def spring(scene: Scene) -> None:
    scene.diver.leak = True


def fall(scene: Scene) -> None:
    scene.diver.volts = 13.9


def surface(scene: Scene) -> None:
    scene.diver.mode, scene.diver.critical = "SURFACE", True


@pytest.mark.parametrize(
    ("cause", "patience"),
    [(spring, 1.5), (fall, SAG + 1.0), (surface, 1.0)],
    ids=["a leak", "a flat battery", "its own failsafe"],
)
def test_one_that_holds_comes_up_before_water_or_a_flat_battery_end_it(
    cause: Callable[[Scene], None], patience: float
) -> None:
    with at_sea() as scene:
        scene.comes_home(LastResort.HOLD, within=20.0)
        cause(scene)
        began = scene.clock()
        assert scene.comes_home(LastResort.HOLD) < patience + (3.0 - SHALLOW) / ASCENT + 1.0
        left = min(t for t, _, mode, _ in scene.diver.history if t >= began and mode == "SURFACE")
        assert left - began < patience
        assert scene.diver.depth < SHALLOW
        assert not scene.diver.armed
        # Nothing has it go back to holding on its way.
        assert "ALT_HOLD" not in {mode for t, _, mode, _ in scene.diver.history if t > left}


@pytest.mark.parametrize("volts", [math.nan, 13.9])
def test_one_that_holds_rides_out_a_battery_that_sags_or_does_not_tell(volts: float) -> None:
    with at_sea(volts=0.0 if math.isnan(volts) else volts) as scene:
        # It has gone on for long before there is a way home, and sags just as that begins.
        scene.clock.sleep(10.0)
        for _ in range(6):
            scene.home.begin(LastResort.HOLD)
            scene.clock.sleep(0.6 * SAG)
            if not math.isnan(volts):
                scene.diver.volts = 16.0
                scene.clock.sleep(4.0)
                scene.diver.volts = volts
        assert (scene.diver.mode, scene.diver.armed) == ("ALT_HOLD", True)
        assert scene.home.how is LastResort.HOLD


def test_one_that_holds_may_be_told_to_surface_and_not_the_other_way_round() -> None:
    with at_sea() as scene:
        scene.home.begin(LastResort.HOLD)
        scene.clock.sleep(1.0)
        scene.home.begin(LastResort.SURFACE)
        scene.clock.sleep(1.0)
        scene.home.begin(LastResort.HOLD)
        assert scene.comes_home(LastResort.HOLD) < 12.0
        assert scene.diver.depth < SHALLOW


def test_one_that_is_to_be_disarmed_is_so_at_once() -> None:
    with at_sea() as scene:
        assert scene.comes_home(LastResort.DISARM) < 0.5
        assert not scene.diver.armed
        assert scene.diver.asked(mode="SURFACE") == []


# Whose it is


def test_one_that_is_disarmed_already_is_left_so() -> None:
    with at_sea() as scene:
        scene.link.disarm()
        scene.diver.sent.clear()
        assert scene.comes_home() == 0.0
        scene.clock.sleep(1.0)
        assert not [m for kind in MOVES for m in scene.diver.heard(kind)]


def rival(scene: Scene) -> None:
    scene.diver.say(dialect.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0), system=255, component=191)


def other_mode(scene: Scene) -> None:
    scene.diver.mode = "STABILIZE"


@pytest.mark.parametrize("cause", [rival, other_mode])
@pytest.mark.parametrize("how", [LastResort.SURFACE, LastResort.HOLD])
def test_one_that_somebody_else_takes_is_theirs_from_then_on(
    how: LastResort, cause: Callable[[Scene], None]
) -> None:
    with at_sea() as scene:
        scene.comes_home(how, within=2.0)
        cause(scene)
        scene.clock.sleep(0.5)
        assert scene.home.there
        taken = scene.clock()
        scene.home.begin(how)
        scene.clock.sleep(5.0)
        assert not [m for kind in MOVES for m in scene.diver.heard(kind, since=taken)]
        assert scene.diver.armed


def test_who_has_the_sticks_brings_it_home_for_as_long_as_it_takes() -> None:
    with at_sea() as scene:
        scene.steered = True
        scene.home.begin(LastResort.SURFACE)
        began = scene.clock()
        while scene.clock() < began + LEAVING + 20.0:
            scene.link.pilot(Sticks(y=-300), scene.clock() + 0.4)
            scene.clock.sleep(0.2)
        assert scene.diver.heard("COMMAND_LONG") == []
        assert {m.y for m in scene.diver.heard("MANUAL_CONTROL", since=began + 0.5)} == {-300}
        assert scene.diver.armed
        # They let go, still down there: it comes up by the gentlest means, as if it had just set out.
        scene.steered = False
        let_go = scene.clock()
        assert scene.comes_home() < (3.0 - SHALLOW) / ASCENT + 1.0
        assert scene.diver.asked(mode="SURFACE")
        assert min(scene.diver.asked(disarm=True)) > let_go + 5.0
        assert scene.home.troubles == []


# Silence


def test_a_vehicle_that_is_silent_for_less_than_ten_seconds_is_not_taken_for_one_that_does_not_obey() -> None:
    with at_sea(depth=6.0) as scene:
        scene.comes_home(within=2.0)
        scene.diver.mute = True
        scene.clock.sleep(UNHEARD - 2.0)
        scene.diver.mute = False
        # It heard us all the time, and came up: nothing of what was believed then pulls it down again.
        before = scene.diver.depth
        assert scene.comes_home() < 20.0
        assert scene.home.troubles == []
        assert before < 6.0 - (UNHEARD - 1.0) * ASCENT
        assert {mode for t, _, mode, _ in scene.diver.history if t > 3.0} <= {"SURFACE", "ALT_HOLD"}


def test_one_that_was_cut_off_comes_up_once_it_is_heard_again() -> None:
    with at_sea() as scene:
        scene.diver.mute, scene.diver.deaf = True, lambda message: True
        scene.comes_home(within=8.0)
        scene.diver.mute, scene.diver.deaf = False, lambda message: False
        assert scene.comes_home() < 12.0
        assert scene.diver.depth < SHALLOW


def test_one_that_stays_silent_is_left_to_its_own_failsafe() -> None:
    with at_sea() as scene:
        scene.comes_home(within=1.0)
        scene.diver.mute = True
        scene.clock.sleep(UNHEARD + LIFELINE + 1.0)
        assert scene.home.unheard
        quiet = scene.clock()
        scene.clock.sleep(20.0)
        # Neither sticks nor heartbeats: both would keep its failsafes from acting.
        assert [m for t, m in scene.diver.sent if t >= quiet] == []
        assert not scene.home.there


def test_closing_leaves_it_as_it_is() -> None:
    with at_sea() as scene:
        scene.comes_home(within=2.0)
        scene.home.close()
        closed = scene.clock()
        scene.clock.sleep(5.0)
        assert scene.diver.heard("COMMAND_LONG", since=closed) == []
        assert scene.diver.armed


def test_a_way_that_meets_what_nobody_thought_of_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    with at_sea() as scene:

        def broken(order: Order, expires: float) -> float:
            raise ZeroDivisionError("nobody thought of this")

        scene.link.command = broken  # type: ignore[method-assign]
        assert scene.comes_home() < 60.0
        assert not scene.diver.armed
    assert "nobody thought of this" in caplog.text


# Ctrl-C


def finished(scene: Scene, *presses: float) -> tuple[float, list[str]]:
    """Seconds after which `finish` returns where Ctrl-C comes at these times, and what is told."""
    clock, began, told = scene.clock, scene.clock(), list[str]()

    def operator() -> None:
        for press in presses:
            clock.sleep(began + press - clock())
            clock.interrupt()

    clock.start(operator, "operator")
    scene.home.finish(told.append)
    return clock() - began, told


@pytest.mark.parametrize("presses", [(), (2.0,), (2.0, 2.0 + SURE + 0.5), (0.5, 6.0)])
def test_no_single_ctrl_c_leaves_a_vehicle_that_is_on_its_way_up(presses: tuple[float, ...]) -> None:
    with at_sea() as scene:
        took, told = finished(scene, *presses)
        assert scene.home.there
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW
        assert took < (3.0 - SHALLOW) / ASCENT + 1.0
        assert told[0] == "it comes to the surface"
        assert told[1:] == [f"it is on its way up: Ctrl-C again within {SURE:g} s leaves it as it is"] * len(
            presses
        )


@pytest.mark.parametrize("presses", [(1.0, 1.0 + SURE - 0.2), (1.0, 1.1), (1.0, 6.5, 7.5)])
def test_a_second_ctrl_c_soon_after_leaves_it_as_it_is(presses: tuple[float, ...]) -> None:
    with at_sea() as scene:
        took, told = finished(scene, *presses)
        assert took == pytest.approx(presses[-1], abs=2.0 * EVERY)
        assert told[-1] == "the vehicle is left as it is: interrupted"
        assert scene.diver.armed
        left = scene.clock()
        scene.clock.sleep(5.0)
        assert scene.diver.heard("COMMAND_LONG", since=left) == []


def test_one_that_holds_is_left_by_a_single_ctrl_c() -> None:
    with at_sea() as scene:
        scene.home._limits = replace(LIMITS, last_resort=LastResort.HOLD)
        took, told = finished(scene, 2.0)
        assert took == pytest.approx(2.0, abs=2.0 * EVERY)
        assert told[-1] == "the vehicle is left as it is: interrupted"
        assert (scene.diver.mode, scene.diver.armed) == ("ALT_HOLD", True)


def test_one_that_is_there_is_not_waited_for() -> None:
    with at_sea() as scene:
        scene.link.disarm()
        assert finished(scene) == (0.0, [])


# With the bridge that sends it home


@contextmanager
def bridged(scene: Scene, *, pilot: Any = None) -> Iterator[Bridge]:
    """A bridge on its thread that holds the vehicle to a goal, its own depth known by the truth."""

    class Truth:
        lost = ""
        imu_age = 0.02

        def update(self) -> Fix:
            if self.lost:
                raise ValueError(self.lost)
            diver = scene.diver
            pose = SE3.level(0.0, 0.0, -diver.depth, 0.0)
            return fix_at(time=scene.clock(), T_world_base=pose, imu_age=self.imu_age)

    scene.truth = Truth()
    drive = AltHold(scene.link, Joystick(thrusters=VECTORED_6DOF), scene.home)
    bridge = Bridge(scene.truth, drive, LIMITS, scene.clock, pilot=pilot, threads=scene.clock)
    # The goal is as deep as it is.
    bridge.go(SE2(0.5, 0.0, 0.0), 1.5 - scene.diver.depth)
    bridge.renew(1e9)
    bridge.start()
    scene.clock.sleep(1.0)
    assert bridge.standing.stance is Stance.GO
    try:
        yield bridge
    finally:
        bridge.close()


def end(scene: Scene, bridge: Bridge) -> None:
    bridge.end("a wire came loose")


def lose(scene: Scene, bridge: Bridge) -> None:
    scene.truth.lost = "messages were lost"


def blind(scene: Scene, bridge: Bridge) -> None:
    scene.truth.imu_age = 1.0


@pytest.mark.parametrize(
    ("cause", "said", "patience"),
    [
        (end, "a wire came loose", 0.0),
        (lose, "messages were lost", 0.0),
        (blind, "no inertial samples", LIMITS.patience),
    ],
)
def test_a_dive_that_is_over_comes_home_at_once_and_one_in_trouble_stays_for_its_patience(
    cause: Callable[[Scene, Bridge], None], said: str, patience: float
) -> None:
    with at_sea() as scene, bridged(scene) as bridge:
        cause(scene, bridge)
        over, depth = scene.clock(), scene.diver.depth
        if patience:
            scene.clock.sleep(patience - 0.2)
            assert (scene.diver.mode, scene.home.how) == ("ALT_HOLD", None)
            assert scene.diver.depth == pytest.approx(depth, abs=0.02)
            assert all(map(is_neutral, scene.diver.heard("MANUAL_CONTROL", over + 0.1)))
            scene.clock.sleep(0.2)
        scene.clock.sleep(0.3)
        assert scene.diver.mode == "SURFACE"
        scene.clock.sleep((3.0 - SHALLOW) / ASCENT + 1.0)
        assert scene.home.there
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW
        # Bridge and way home do not answer each other on the way.
        assert all(map(is_neutral, scene.diver.heard("MANUAL_CONTROL", over + 0.1)))
        assert said in bridge.over


def test_a_failsafe_of_the_vehicle_ends_the_dive_and_is_helped_on_its_way() -> None:
    with at_sea() as scene, bridged(scene) as bridge:
        surface(scene)
        scene.clock.sleep(1.0)
        assert bridge.over.startswith("a failsafe of the vehicle brings it up")
        scene.clock.sleep((3.0 - SHALLOW) / ASCENT + 2.0)
        assert scene.home.there
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW
        assert scene.link.yielding == ""
        assert "ALT_HOLD" not in {mode for t, _, mode, _ in scene.diver.history if t > scene.clock() - 8.0}


def test_after_the_last_resort_a_person_may_still_steer_and_is_brought_home_after() -> None:
    class Pilot:
        has = gone = False
        ended = ""

    pilot = Pilot()
    with at_sea(depth=8.0) as scene, bridged(scene, pilot=pilot) as bridge:
        bridge.end("a wire came loose")
        scene.clock.sleep(3.0)
        assert scene.diver.mode == "SURFACE"
        pilot.has = scene.steered = True
        began = scene.clock()
        while scene.clock() < began + 10.0:
            scene.link.pilot(Sticks(y=-300), scene.clock() + 0.4)
            scene.clock.sleep(0.2)
        assert bridge.standing.stance is Stance.YIELD
        assert {m.y for m in scene.diver.heard("MANUAL_CONTROL", began + 0.2)} == {-300}
        pilot.has = scene.steered = False
        scene.clock.sleep(8.0 / ASCENT)
        assert not scene.diver.armed
        assert scene.diver.depth < SHALLOW
        assert bridge.over == "a wire came loose"
