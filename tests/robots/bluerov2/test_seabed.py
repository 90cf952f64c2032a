"""The seabed's height: what is ground is believed, on any ground, and what cannot be ground is named."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from dream.geometry import SE3
from dream.measurements import Dvl
from dream.robots.bluerov2.seabed import FARTHER, GAP, LASTING, NEARER, SMOOTHED, Seabed
from tests.robots.bluerov2.tracks import Ground, Track, flat, relief, slope, step, tank

RATE = 10.0
"""Echoes a second, where nothing else is said."""
FOUND = 3.0
"""Seconds within which what can be seen has to be told."""


def say(
    seabed: Seabed,
    times: Iterable[float],
    altitude: Callable[[float], float],
    z: Callable[[float], float] = lambda time: -1.0,
    x: Callable[[float], float] = lambda time: 0.0,
    *,
    climb: float = 0.0,
    valid: bool = True,
) -> None:
    """Let a level vehicle hear echoes at those times."""
    for time in times:
        dvl = Dvl(time, np.array([0.0, 0.0, climb]), 1e-5 * np.eye(3), altitude(time), valid)
        seabed.take(dvl, SE3.level(x(time), 0.0, z(time), 0.0))


def span(begin: float, end: float, rate: float = RATE) -> list[float]:
    return [begin + k / rate for k in range(round((end - begin) * rate))]


def hovering(altitude: float = 1.0, until: float = 5.0) -> Seabed:
    seabed = Seabed()
    say(seabed, span(0.0, until), lambda time: altitude)
    return seabed


# What is believed


def test_before_any_echo_and_until_a_few_agree_nothing_is_known() -> None:
    seabed = Seabed()
    assert (seabed.problem, seabed.age(3.0)) == ("", math.inf)
    assert math.isnan(seabed.height)
    say(seabed, span(0.0, LASTING), lambda time: 1.0)
    assert math.isnan(seabed.height)
    say(seabed, [LASTING], lambda time: 1.0)
    assert seabed.height == -2.0
    assert seabed.altitude == 1.0
    assert seabed.age(2.5) == 2.0


def test_at_the_start_that_is_believed_on_which_most_agree() -> None:
    seabed = Seabed()
    say(seabed, span(0.0, 1.0), lambda time: 9.0 if round(10.0 * time) in (0, 4, 8) else 1.0)
    assert seabed.height == -2.0


def test_a_height_is_smoothed_by_the_share_of_two_seconds_that_passed() -> None:
    seabed = hovering()
    expected = -2.0
    for time in span(5.0, 8.0):
        say(seabed, [time], lambda _: 1.1)
        expected += (0.1 if time > 5.0 else 5.0 - 4.9) / SMOOTHED * (-2.1 - expected)
    assert seabed.height == pytest.approx(expected)


def test_a_single_echo_that_is_far_off_changes_nothing() -> None:
    seabed = hovering()
    for wrong in (10.0, 2.0, 0.3):
        say(seabed, [seabed._heard[-1].time + 0.1], lambda _, wrong=wrong: wrong)  # type: ignore[misc]
        assert math.isnan(seabed.altitude)
        assert seabed.height == -2.0
        say(seabed, span(seabed._heard[-1].time + 0.1, seabed._heard[-1].time + 5.0), lambda _: 1.0)
    assert (seabed.altitude, seabed.problem) == (1.0, "")


def test_nearer_ground_is_taken_once_it_lasts_and_farther_ground_later() -> None:
    def taken(rise: float) -> float:
        seabed = hovering(3.0)
        for time in span(5.0, 12.0):
            # Past an edge at 0.25 m/s.
            say(seabed, [time], lambda _: 3.0 - rise, x=lambda time: 0.25 * (time - 5.0))
            if abs(seabed.height - (-4.0 + rise)) < 0.01:
                assert seabed.problem == ""
                return time - 5.0
        return math.inf

    assert LASTING <= taken(2.0) <= NEARER[0]
    assert NEARER[0] < taken(-2.0) <= FARTHER[0]


def test_as_far_as_the_vehicle_moves_the_ground_may_rise() -> None:
    for moves, believed in ((1.0, True), (0.0, False)):
        seabed = hovering(3.0)
        # Uphill at 45°, half a metre from each echo to the next; or without moving, which is no ground.
        for time in (5.0, 5.5, 6.0, 6.5, 7.0):
            say(seabed, [time], lambda t: 3.5 - (t - 4.5), x=lambda t: moves * (t - 4.5))  # noqa: B023
            assert (not math.isnan(seabed.altitude)) is (believed or time == 5.0)


def test_after_a_while_without_echoes_one_alone_is_not_believed() -> None:
    seabed = hovering()
    begin = 5.0 + GAP + 0.5
    say(seabed, [begin], lambda _: 1.0)
    assert math.isnan(seabed.altitude)
    assert seabed.age(begin) == pytest.approx(1.6)
    say(seabed, span(begin + 0.1, begin + 1.0), lambda _: 1.0)
    assert seabed.altitude == 1.0
    assert seabed.age(begin + 1.0) == pytest.approx(0.1)


def test_what_is_not_valid_or_older_says_nothing() -> None:
    seabed = hovering()
    say(seabed, [5.0], lambda _: 1.0, valid=False)
    assert math.isnan(seabed.altitude)
    say(seabed, [5.1], lambda _: math.nan)
    assert math.isnan(seabed.altitude)
    assert seabed.age(5.1) == pytest.approx(0.2)
    say(seabed, [5.2], lambda _: 1.0)
    assert seabed.altitude == 1.0
    say(seabed, [4.0], lambda _: 1.05)
    assert seabed.age(5.2) == 0.0
    assert seabed.height == -2.0


def test_the_floor_is_where_a_leaning_dvl_looks() -> None:
    seabed, lean = Seabed(), 0.3
    c, s = math.cos(lean), math.sin(lean)
    pose = SE3(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), np.array([0.0, 0.0, -1.0]))
    for time in span(0.0, 1.0):
        seabed.take(Dvl(time, np.zeros(3), np.eye(3), 2.0, True), pose)
    assert seabed.height == pytest.approx(-1.0 - 2.0 * c)


# Honest tracks


def honest(kind: str, seed: int) -> Track:
    rng = np.random.default_rng(seed)
    grounds: dict[str, tuple[Ground, tuple[float, ...], float]] = {
        "flat": (flat(), (0.6,), -0.5),
        "30°": (slope(30.0, rng.uniform(-3.0, 3.0)), (2.0, 0.8), math.nan),
        "45°": (slope(45.0, rng.uniform(-3.0, 3.0)), (1.5,), math.nan),
        "up a wall": (step(2.0), (2.5, 3.0), math.nan),
        "down a wall": (step(-2.0), (2.5, 3.0), math.nan),
        "waves": (relief(rng), (2.0, 1.0, 3.0), -0.5),
        "low waves": (relief(rng, 0.6), (0.6, 1.2), -0.5),
        "beside walls": (tank(), (0.6, 1.0, 0.45), -0.15),
    }
    ground, altitudes, start = grounds[kind]
    walls = kind == "beside walls"
    return Track(
        ground,
        rng,
        speed=0.0 if walls else float(rng.choice([0.1, 0.25, 0.5])),
        altitudes=altitudes,
        every=6.0 if walls else 9.0,
        start=start,
        noise=rng.uniform(0.01, 0.02),
        lost=rng.uniform(0.005, 0.04),
        late=rng.uniform(0.0, 0.1),
        straight=kind in ("up a wall", "down a wall"),
        place=(float(rng.uniform(-1.5, 1.5)), -1.45) if walls else (-2.0, 0.0),
    )


@pytest.mark.few(3)
@pytest.mark.parametrize("kind", ["flat", "30°", "45°", "up a wall", "down a wall", "waves", "low waves"])
@pytest.mark.parametrize("seed", [1, 2])
def test_on_real_ground_nothing_is_wrong_and_its_height_is_known(kind: str, seed: int) -> None:
    track = honest(kind, seed)
    off = [
        abs(seabed.height - track.height_of_ground())
        for seabed in track.run(27.0)
        if seabed.age(track.time) < 0.2
    ]
    assert track.alarms == []
    assert len(off) > 400
    # Beams reach out, and smoothing comes behind on steep ground.
    assert np.median(off) < {"flat": 0.02}.get(kind, 1.0)


@pytest.mark.parametrize("seed", range(4))
def test_beside_the_walls_of_a_tank_nothing_is_wrong_either(seed: int) -> None:
    track = honest("beside walls", seed)
    track.yaw = track._course = float(track.rng.uniform(-3.0, 3.0))
    assert track.fly(18.0).alarms == []


def test_hovering_at_one_altitude_to_the_last_bit_is_not_stuck() -> None:
    seabed = hovering(1.0, 60.0)
    assert (seabed.problem, seabed.height) == ("", -2.0)


def test_following_a_slope_at_one_altitude_is_not_stuck() -> None:
    rng = np.random.default_rng(3)
    seabed = Seabed()
    times = span(0.0, 20.0)
    say(
        seabed,
        times,
        lambda t: 1.0 + 0.01 * rng.standard_normal(),
        z=lambda t: -9.0 + 0.15 * t,
        x=lambda t: 0.26 * t,
        climb=0.15,
    )
    assert seabed.problem == ""
    assert seabed.age(times[-1]) < 0.5


def test_a_stone_below_a_vehicle_that_sinks_is_no_altitude_that_is_scaled() -> None:
    seabed = Seabed()
    for begin in range(20):
        # As much above the floor as the vehicle sinks meanwhile.
        rise = 0.3 if begin % 10 >= 5 else 0.0
        say(
            seabed,
            span(begin, begin + 1.0),
            lambda t, rise=rise: 9.0 - rise - 0.1 * t,  # type: ignore[misc]
            z=lambda t: -1.0 - 0.1 * t,
            climb=-0.1,
        )
        assert seabed.problem == ""


def test_beams_on_a_wall_that_sink_with_the_vehicle_are_no_altitude_that_is_stuck() -> None:
    """Two of four: as it sinks by 0.1 m, 3 cm farther from the wall, they go as much farther to it."""
    rng = np.random.default_rng(3)
    seabed = Seabed()
    say(
        seabed,
        span(0.0, 16.0),
        lambda t: 3.0 + 0.005 * rng.standard_normal(),
        z=lambda t: -1.0 - 0.1 * t,
        x=lambda t: 0.03 * t,
        climb=-0.1,
    )
    assert seabed.problem == ""


# What cannot be


def stuck(at: float) -> Callable[[float, float, float], float]:
    return lambda time, altitude, z: at


def times(factor: float) -> Callable[[float, float, float], float]:
    return lambda time, altitude, z: factor * altitude


def after(
    begin: float, fault: Callable[[float, float, float], float]
) -> Callable[[float, float, float], float]:
    return lambda time, altitude, z: fault(time, altitude, z) if time >= begin else altitude


def detectable(track: Track, since: float) -> float:
    """When the height had changed by 0.2 m since then; inf where it never did."""
    begun = next(z for time, z in track.heights if time >= since)
    changed = (time for time, z in track.heights if time >= since and abs(z - begun) >= 0.2)
    return next(changed, math.inf)


@pytest.mark.parametrize(
    ("fault", "height", "altitude", "words"),
    [
        (stuck(5.0), -2.0, 0.6, "is stuck at 5.0 m"),
        (stuck(0.1), -4.0, 2.0, "is stuck at 0.1 m"),
        (times(2.0), -2.0, 0.6, "times as much as the depth"),
        (times(2.0), -4.0, 1.0, "times as much as the depth"),
        (times(10.0), -2.0, 0.6, "times as much as the depth"),
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_wrong_altitude_is_found_on_the_first_way_down(
    fault: Callable[[float, float, float], float], height: float, altitude: float, words: str, seed: int
) -> None:
    track = Track(
        flat(height),
        np.random.default_rng(seed),
        speed=0.0,
        altitudes=(altitude,),
        start=-0.5,
        fault=fault,
        outages=0.0,
    )
    assert track.found(20.0) < math.inf
    assert words in track.seabed.problem
    assert track.time <= detectable(track, 0.0) + FOUND
    # It neither lies on the floor nor is it at the surface.
    assert track.z > height + altitude - 0.1


@pytest.mark.parametrize("speed", [0.0, 0.25], ids=["hovers", "moves"])
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (stuck(5.0), ("jumped from 0.6 to 5.0 m over one place", "is stuck at 5.0 m")),
        (stuck(0.1), ("jumped from 0.6 to 0.1 m over one place", "is stuck at 0.1 m")),
        (times(2.0), ("times as much as the depth",)),
        (times(10.0), ("over one place", "times as much as the depth")),
    ],
)
def test_an_altitude_that_becomes_wrong_is_found(
    fault: Callable[[float, float, float], float], words: tuple[str, ...], speed: float
) -> None:
    track = Track(
        flat(-2.0),
        np.random.default_rng(2),
        speed=speed,
        altitudes=(0.6,),
        start=-1.4,
        fault=after(16.0, fault),
        outages=0.0,
    )
    track.fly(16.0)
    assert track.alarms == []
    assert track.found(10.0) < math.inf
    assert any(word in track.seabed.problem for word in words)
    assert track.time <= detectable(track, 16.0) + FOUND
    assert track.z > -2.0 + 0.3


def test_outliers_are_left_out_at_once_and_told_where_they_are_many() -> None:
    luck = np.random.default_rng(4)
    track = Track(
        flat(-2.0),
        np.random.default_rng(1),
        altitudes=(0.6,),
        start=-1.4,
        fault=after(10.0, lambda time, altitude, z: altitude * (10.0 if luck.random() < 0.3 else 1.0)),
        outages=0.0,
    )
    track.fly(10.0)
    assert track.found(10.0) <= 2.0 * FOUND
    assert "jumps to and fro between 0.6 and" in track.seabed.problem
    track.fly(5.0)
    assert min(z for _, z in track.heights) > -1.45


@pytest.mark.parametrize("factor", [2.0, 10.0])
def test_few_outliers_are_left_out_and_that_is_all(factor: float) -> None:
    luck = np.random.default_rng(4)
    track = Track(
        flat(-2.0),
        np.random.default_rng(1),
        altitudes=(0.6,),
        start=-1.4,
        fault=lambda time, altitude, z: altitude * (factor if luck.random() < 0.05 else 1.0),
    )
    assert track.fly(30.0).alarms == []
    assert min(z for _, z in track.heights) > -1.5


@pytest.mark.parametrize("speed", [0.0, 0.25])
def test_a_false_bottom_that_comes_and_goes_is_told(speed: float) -> None:
    luck = np.random.default_rng(4)
    track = Track(
        flat(-4.0),
        np.random.default_rng(1),
        speed=speed,
        start=-2.0,
        fault=after(10.0, lambda time, altitude, z: altitude - (1.5 if luck.random() < 0.5 else 0.0)),
        outages=0.0,
    )
    track.fly(10.0)
    assert track.found(10.0) <= FOUND
    assert "jump" in track.seabed.problem
    # Until it is over for a while.
    track.fault = lambda time, altitude, z: altitude
    track.fly(6.0)
    assert track.seabed.problem == ""
    assert track.seabed.height == pytest.approx(-4.0, abs=0.05)


def test_a_step_below_a_vehicle_that_stays_is_none_until_it_goes_or_the_vehicle_does() -> None:
    for healed in (True, False):
        seabed = hovering(1.0)
        say(seabed, span(5.0, 8.0), lambda _: 4.0)
        assert seabed.problem == "the DVL's altitude jumped from 1.0 to 4.0 m over one place"
        assert math.isnan(seabed.height)
        assert math.isnan(seabed.altitude)
        assert seabed.age(8.0) == pytest.approx(3.1)
        if healed:
            say(seabed, span(8.0, 9.5), lambda _: 1.0)
            assert (seabed.problem, seabed.height) == ("", -2.0)
        else:
            say(seabed, span(8.0, 9.5), lambda _: 4.0, x=lambda t: 0.2 * (t - 8.0))
            assert (seabed.problem, seabed.height) == ("", -5.0)


def test_an_altitude_that_is_equal_to_the_last_bit_all_the_way_is_stuck() -> None:
    rng = np.random.default_rng(3)
    for sways, problem in ((0.0, ""), (0.01, "the DVL's altitude is stuck at 1.0 m")):
        seabed = Seabed()
        say(
            seabed,
            span(0.0, 8.0),
            lambda t: 1.0,
            z=lambda t, sways=sways: -1.0 + sways * rng.standard_normal(),  # type: ignore[misc]
            x=lambda t: 0.2 * t,
        )
        assert seabed.problem == problem


def test_a_problem_keeps_its_words_while_it_lasts_and_goes_once_both_change_alike_again() -> None:
    seabed = Seabed()
    say(seabed, span(0.0, 3.0), lambda t: 4.0, z=lambda t: -1.0 - 0.1 * t, climb=-0.1)
    problem = seabed.problem
    assert problem == "the DVL's altitude is stuck at 4.0 m"
    # Deeper still, wrong by something else, and then at rest.
    say(seabed, span(3.0, 6.0), lambda t: 4.0 - 0.2 * (t - 3.0), z=lambda t: -1.0 - 0.1 * t, climb=-0.1)
    say(seabed, span(6.0, 20.0), lambda t: 3.4, z=lambda t: -1.6)
    assert seabed.problem == problem
    assert seabed.age(20.0) > 17.0
    say(seabed, span(20.0, 26.0), lambda t: 3.4 - 0.1 * (t - 20.0), z=lambda t: -1.6 - 0.1 * (t - 20.0))
    assert seabed.problem == ""
    assert seabed.height == pytest.approx(-5.0, abs=0.01)
    assert seabed.age(26.0) < 0.2


@pytest.mark.parametrize("climb, words", [(0.0, "the depth changes"), (-0.1, "is stuck at 2.0 m")])
def test_where_the_dvl_does_not_move_it_is_the_depth_that_is_wrong(climb: float, words: str) -> None:
    rng = np.random.default_rng(3)
    seabed = Seabed()
    say(
        seabed,
        span(0.0, 8.0),
        lambda t: 2.0 + 0.01 * rng.standard_normal(),
        z=lambda t: -1.0 - 0.1 * t,
        climb=climb,
    )
    assert words in seabed.problem
