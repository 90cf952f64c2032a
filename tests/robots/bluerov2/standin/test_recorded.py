"""The stand-in beside a real ArduSub that was given the same orders at the same times in the same tank.

What the real one did is in `tests/recorded/ardusub`; `tests/hardware/record.py` wrote it.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from dream.robots.bluerov2.standin.ardusub import ArduSub, Send
from dream.robots.bluerov2.standin.parameters import NEXT
from dream.robots.bluerov2.standin.tank import Conditions, Tank
from dream.sim.worlds import make_world
from tests.hardware.manoeuvres import FAR, RUNS, Trace
from tests.hardware.sitl import SETUPS, at

Float64Array = npt.NDArray[np.float64]

DECLINATION = {True: math.radians(19.7), False: math.radians(-3.4)}
"""Radians far away and at home, as the real one's compass had it."""
BESIDE = ("stock", "origin", "lake", "low", "gps", "gps-lake")


@functools.cache
def real(name: str) -> Trace:
    return Trace.load(RUNS[name].path)


@functools.cache
def ours(name: str) -> Trace:
    run = RUNS[name]
    far = run.home == FAR
    parameters = at(FAR) if far and run.setup == "origin" else SETUPS[run.setup]

    def make(tank: Tank, send: Send) -> ArduSub:
        sub = ArduSub(tank, send, firmware=NEXT, booted=0.0)
        for parameter, value in parameters.items():
            sub.parameters.change(parameter, value)
        sub.fix = run.setup.startswith("gps")
        return sub

    conditions = Conditions(
        depth_zero=-run.depth,
        declination=DECLINATION[far],
        altitude=50.0 if run.setup == "gps-lake" else 0.0,
    )
    return run.fly(make_world("pool/arc", 1), make, conditions)


def both(name: str) -> tuple[Trace, Trace]:
    return real(name), ours(name)


def apart(name: str, column: str, *, since: float = 25.0) -> Float64Array:
    """By how much the truth of both differs, in a column; angles unwrapped."""
    a, b = both(name)
    count = min(len(a.truth), len(b.truth))
    off = np.unwrap(a[column][:count]) - np.unwrap(b[column][:count])
    return off[a["time"][:count] >= since]


def rms(values: Float64Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def heard(trace: Trace, message: str, field: str, when: float) -> float:
    """The newest value of a field at a time."""
    rows = trace.told[message]
    return float(trace.said(message, field)[np.searchsorted(rows[:, 0], when + 1e-6) - 1])


def words(trace: Trace, since: float) -> list[str]:
    """What was said, without what was done."""
    return [text for when, text in trace.events if when >= since and not text.startswith(">")]


# ---------------------------------------------------------------------------------------- heights
@pytest.mark.few(4)
@pytest.mark.parametrize("setup", BESIDE)
@pytest.mark.parametrize(
    ("message", "field", "unit"),
    [
        ("VFR_HUD", "alt", 1.0),
        ("GLOBAL_POSITION_INT", "alt", 1e-3),
        ("GLOBAL_POSITION_INT", "relative_alt", 1e-3),
        ("AHRS2", "altitude", 1.0),
    ],
)
def test_heights_are_what_the_real_one_calls_them(setup: str, message: str, field: str, unit: float) -> None:
    """Before arming, armed, and deeper."""
    a, b = both(f"{setup}-altitudes")
    for when in (24.0, 30.0, 40.0, 43.0, 49.0):
        theirs, mine = unit * heard(a, message, field, when), unit * heard(b, message, field, when)
        assert mine == pytest.approx(theirs, abs=0.09), f"{when} s"


def test_what_it_calls_heights_without_and_with_an_origin() -> None:
    """The numbers themselves: 0.25 m under water at the boot, 0.6 m deeper at the end."""
    for trace in both("stock-altitudes"):
        assert set(trace.said("VFR_HUD", "alt")) == {0.0}
        assert heard(trace, "GLOBAL_POSITION_INT", "relative_alt", 49.0) == pytest.approx(-620.0, abs=60.0)
    for trace in both("lake-altitudes"):
        assert heard(trace, "VFR_HUD", "alt", 24.0) == 0.0
        assert heard(trace, "VFR_HUD", "alt", 49.0) == pytest.approx(49.38, abs=0.06)
        assert heard(trace, "GLOBAL_POSITION_INT", "relative_alt", 49.0) == pytest.approx(-620.0, abs=60.0)
    # Where it has a position and by that a home, its height above that is one above the sea.
    for trace in both("gps-lake-altitudes"):
        assert heard(trace, "GLOBAL_POSITION_INT", "relative_alt", 49.0) == pytest.approx(49_120.0, abs=60.0)
        assert heard(trace, "LOCAL_POSITION_NED", "z", 49.0) == pytest.approx(0.62, abs=0.06)


def test_there_is_a_local_position_only_where_there_is_a_position() -> None:
    for setup in BESIDE:
        for trace in both(f"{setup}-altitudes"):
            assert ("LOCAL_POSITION_NED" in trace.told) == setup.startswith("gps")
    flags = [int(trace.said("EKF_STATUS_REPORT", "flags")[-1]) for trace in both("stock-altitudes")]
    assert flags == [167, 167]
    flags = [int(trace.said("EKF_STATUS_REPORT", "flags")[-1]) for trace in both("gps-altitudes")]
    assert flags == [831, 831]


# ---------------------------------------------------------------------------------------- depth
@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("name", "most"),
    [("stock-depths", 0.035), ("stock-launch", 0.02), ("stock-rest", 0.015), ("stock-moves", 0.03)],
)
def test_it_is_as_deep_as_the_real_one(name: str, most: float) -> None:
    """Root of the mean square, metres: steps, the throttle, coming off the surface, rest, moving about."""
    assert rms(apart(name, "up")) < most
    assert np.abs(apart(name, "up")).max() < 2.5 * most


def test_a_depth_step_overshoots_and_falls_short_as_the_real_one_does() -> None:
    for trace in both("stock-depths"):
        start = trace.at("depth target", 1)
        step = trace.during(start, start + 8.0)
        down = step["up"][0] - step["up"]
        assert 0.26 < down.max() < 0.32
        assert 0.20 < down[-1] < 0.27


def test_little_throttle_does_little() -> None:
    """z = 650 for 2 s."""
    climbed = []
    for trace in both("stock-depths"):
        start = trace.at("sticks 0 0 650")
        climbed.append(np.ptp(trace.during(start, start + 5.0)["up"]))
    assert climbed[0] == pytest.approx(0.12, abs=0.03)
    assert climbed[1] == pytest.approx(climbed[0], abs=0.04)


@pytest.mark.rare
def test_a_depth_target_is_cut_to_what_it_could_stop_for() -> None:
    """From 0.08 m to 1 m: it goes 0.55 m, and stays there."""
    for trace in both("stock-surfacing"):
        errors = trace.told["NAV_CONTROLLER_OUTPUT"]
        assert errors[:, 1].min() == pytest.approx(-0.55, abs=0.03)
        end = trace.at("command 176 1 9")
        assert heard(trace, "GLOBAL_POSITION_INT", "relative_alt", end) == pytest.approx(-630.0, abs=40.0)


def test_armed_at_its_surface_it_goes_a_tenth_of_a_metre_down() -> None:
    for trace in both("stock-launch"):
        low = heard(trace, "GLOBAL_POSITION_INT", "relative_alt", 40.0)
        assert low == pytest.approx(-95.0, abs=15.0)
        still = trace.during(25.6, 25.9)
        # Its motors run half a second after it is armed.
        assert (still.pulses == 1500).all()


def test_surface_is_left_in_the_same_time_and_at_once_where_it_is_up() -> None:
    for trace in both("stock-surfacing"):
        taken = []
        for nth in range(3):
            start = trace.at("command 176 1 9", nth)
            over = next(when for when, text in trace.events if when > start and text == "mode 2 armed")
            taken.append(over - start)
        assert taken[0] == pytest.approx(1.5, abs=0.3)
        assert taken[1] < 0.05
        assert taken[2] == pytest.approx(0.9, abs=0.3)
    assert rms(apart("stock-surfacing", "up")) < 0.05


# ---------------------------------------------------------------------------------------- yaw
@pytest.mark.rare
def test_it_turns_as_far_and_as_late_as_the_real_one() -> None:
    """Degrees that sticks of several sizes and lengths turn it by, at most, and when half of that is done."""
    turned: list[list[float]] = []
    late: list[list[float]] = []
    for trace in both("stock-turns"):
        turned.append([])
        late.append([])
        for nth in (0, 1, 5, 7):
            start = trace.at("> sticks", nth)
            part = trace.during(start, start + 3.5)
            yaw = np.degrees(np.unwrap(part["yaw"]))
            away = np.abs(yaw - yaw[0])
            turned[-1].append(away.max())
            late[-1].append(part["time"][np.argmax(away > 5.0)])
    np.testing.assert_allclose(turned[1], turned[0], rtol=0.2)
    np.testing.assert_allclose(late[1], late[0], atol=0.15)
    assert late[0][0] > 0.4
    assert rms(np.degrees(apart("stock-turns", "yaw"))) < 5.0


def test_let_go_of_it_hunts_as_the_real_one_does() -> None:
    """Peak to peak in the five seconds after turns."""
    for trace in both("stock-turns"):
        hunted = []
        for nth in (0, 1, 2, 3):
            start = trace.at("> neutral", nth) + 1.5
            hunted.append(np.degrees(np.ptp(np.unwrap(trace.during(start, start + 3.5)["yaw"]))))
        assert 4.0 < np.mean(hunted) < 12.0


def test_at_rest_it_stays_within_a_degree() -> None:
    for trace in both("stock-rest"):
        assert np.degrees(np.ptp(trace.during(30.0, 85.0)["yaw"])) < 1.0


@pytest.mark.rare
def test_a_guided_turn_is_integrated_into_a_heading() -> None:
    for trace in both("gps-guided"):
        start = trace.at("velocity 0 0 0 0.4")
        yaw = np.degrees(np.unwrap(trace.during(start, start + 8.0)["yaw"]))
        assert yaw[40] - yaw[0] == pytest.approx(np.degrees(1.6) - 3.0, abs=7.0)
        assert np.mean(yaw[-20:]) - yaw[0] == pytest.approx(np.degrees(1.6), abs=6.0)
    assert rms(np.degrees(apart("gps-guided", "yaw", since=45.0))) < 5.0
    assert rms(apart("gps-guided", "up", since=45.0)) < 0.03


# ---------------------------------------------------------------------------------------- true north
def error(trace: Trace) -> Float64Array:
    """(n, 2) times, and degrees by which ATTITUDE.yaw is off the truth."""
    rows = trace.told["ATTITUDE"]
    true = np.interp(rows[:, 0], trace["time"], np.unwrap(trace["yaw"]))
    off = (rows[:, 1] - true + math.pi) % (2.0 * math.pi) - math.pi
    return np.stack([rows[:, 0], np.degrees(off)], axis=1)


@pytest.mark.rare
@pytest.mark.parametrize("name", ["far-origin-altitudes", "far-stock-origins", "origin-altitudes"])
def test_its_heading_goes_from_magnetic_to_true_as_the_real_ones_does(name: str) -> None:
    a, b = map(error, both(name))
    theirs = np.interp(b[:, 0], a[:, 0], a[:, 1])
    known = (b[:, 0] > 22.0) & (b[:, 0] < 43.0)
    assert rms((theirs - b[:, 1])[known]) < 1.5
    if name.startswith("far"):
        assert b[known, 1].min() == pytest.approx(-19.7, abs=1.5)
        assert b[known, 1].max() > -5.0


def test_where_it_first_dives_its_heading_leaps() -> None:
    """Half a metre below where it was armed; in all set-ups, by what it was wrong."""
    for trace in both("far-origin-altitudes"):
        leap = trace.at("in-flight yaw alignment complete")
        assert leap == pytest.approx(43.6, abs=0.5)
        off = error(trace)
        before, after = (np.interp(leap + dt, off[:, 0], off[:, 1]) for dt in (-0.3, 0.3))
        assert after - before == pytest.approx(-3.5, abs=1.5)
        # It turns, for it holds the heading that it had.
        swung = trace.during(27.0, 34.0)["yaw"]
        assert np.degrees(swung[-1] - swung[0]) == pytest.approx(-20.3, abs=2.0)
    assert sum("in-flight" in text for _, text in ours("stock-rest").events) == 0


# ---------------------------------------------------------------------------------------- words
def test_it_refuses_in_the_same_words_and_order() -> None:
    """COMMAND_ACK first, then why; and the armed state only with the next heartbeat."""
    a, b = (words(trace, 25.0) for trace in both("stock-refusals"))
    # The real one has a word about the battery before anybody asks.
    assert b == [text for text in a if "PreArm" not in text]


def test_arming_with_an_origin_says_so() -> None:
    for trace in both("origin-altitudes"):
        said = words(trace, 26.0)
        assert said[0] == "ack 400 0"
        assert {"text 6 Arming motors", "text 6 EKF3 IMU0 origin set", "text 6 Using backup location"} <= set(
            said
        )


def test_a_lost_pilot_and_silence_are_acted_on_at_the_same_time() -> None:
    a, b = ([when for when, text in trace.events if "Disarming" in text] for trace in both("stock-losses"))
    np.testing.assert_allclose(b, a, atol=0.2)
