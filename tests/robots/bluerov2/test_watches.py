"""The watches: what presses or parts is told in time, and what is honest never."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dream.control._kernels import approach
from dream.geometry import SE2, SE3
from dream.robots.bluerov2.drives import GENTLE
from dream.robots.bluerov2.watches import EASING, HARD, NEARER, OFF, OFF_YAW, PRESSED, Parted, Pressing
from tests.robots.bluerov2.test_bridge import fix_at

BEAT = 0.04
SIDES = st.sampled_from([-1.0, 1.0])
GOAL = SE2(0.4, -0.7, 2.0)
DEEP = -1.5

Metres = Callable[[float], float]
"""Of seconds."""


def never(time: float) -> float:
    """Nothing is off."""
    return 0.0


def told(
    seconds: float,
    *,
    away: Metres = never,
    turned: Metres = never,
    height: Metres = lambda time: DEEP,
    z: Metres = lambda time: DEEP,
    effort: Metres = lambda time: 1.0,
    bearing: float = 0.3,
    watch: Pressing | None = None,
) -> tuple[float, str]:
    """When a vehicle is told to work for nothing, and in which words; infinite where it is not.

    Args:
        seconds: How long it is watched.
        away: Metres from its goal.
        turned: Radians, likewise.
        height: Metres in the world.
        z: Where that is wanted.
        effort: Of its thrusters.
        bearing: Radians, from the goal to where it is.
        watch: Going on.
    """
    watch = watch or Pressing()
    for k in range(round(seconds / BEAT) + 1):
        now = BEAT * k
        x, y = GOAL.x + away(now) * math.cos(bearing), GOAL.y + away(now) * math.sin(bearing)
        fix = fix_at(time=now, T_world_base=SE3.level(x, y, height(now), GOAL.yaw + turned(now)))
        if words := watch(now, fix, GOAL, z(now), effort(now)):
            return now, words
    return math.inf, ""


def wobbling(amount: float, seed: int) -> Metres:
    """Something that goes to and fro by so much, at three tones of a seed."""
    tones = [(0.3 + (seed * k) % 7, (seed % (13 * k)) * 0.7) for k in (1, 2, 3)]
    return lambda time: amount * sum(math.sin(w * time + phase) for w, phase in tones) / 3.0


def trapezoid(way: float, speed: float, acceleration: float) -> Metres:
    """What is left of a way, as the reference goes it."""
    left, v, course = way, 0.0, [way]
    while left > 1e-9 and len(course) < 5000:
        v = approach(left, v, speed, acceleration, BEAT)
        left -= v * BEAT
        course.append(left)
    return lambda time: course[min(round(time / BEAT), len(course) - 1)]


# Readings that part


@given(
    st.floats(0.05, 5.0),
    st.floats(-400.0, 400.0),
    st.lists(st.tuples(st.floats(-0.999, 0.999), st.floats(-50.0, 50.0)), max_size=60),
)
def test_readings_that_stay_as_far_apart_as_they_were_never_part(
    limit: float, apart: float, readings: list[tuple[float, float]]
) -> None:
    parted = Parted(limit)
    assert not parted(0.0, apart, 0.0)
    for k, (share, level) in enumerate(readings):
        assert not parted(k + 1.0, level + apart + 0.99 * share * limit, level)


@given(
    st.floats(0.05, 5.0),
    st.floats(0.1, 3.0),
    st.floats(1.01, 100.0),
    SIDES,
    st.floats(-10.0, 10.0),
    st.booleans(),
)
def test_readings_that_part_are_told_once_that_has_lasted_whoever_drifts_and_whatever_their_zero(
    limit: float, patience: float, share: float, side: float, zero: float, swapped: bool
) -> None:
    parted = Parted(limit, patience)
    since = math.inf
    for k in range(400):
        now = 0.02 * k
        pair = zero + (side * share * limit if now >= 2.0 else 0.0), 0.0
        if parted(now, *(pair[::-1] if swapped else pair)):
            since = now
            break
    assert since == pytest.approx(2.0 + patience, abs=0.021)


@given(st.floats(0.1, 0.9), st.integers(1, 5))
def test_readings_that_part_for_a_moment_or_are_not_known_are_not_told(share: float, times: int) -> None:
    for other in (0.0, math.nan):
        parted, now = Parted(0.3, 1.0), 0.0
        assert not parted(now, math.nan, 0.0)
        for one in [0.0, *[9.0, other] * times]:
            for _ in range(round(share / 0.02)):
                now += 0.02
                assert not parted(now, one, 0.0)


# Work that leads nowhere: honest vehicles


@given(
    st.floats(0.0, 0.99),
    st.floats(-0.99, 0.99),
    st.floats(-0.99, 0.99),
    st.integers(0, 10**6),
    st.floats(0.0, 1.0),
)
def test_who_holds_its_place_within_ten_centimetres_presses_on_nothing_however_hard_it_works(
    away: float, turned: float, lifted: float, seed: int, least: float
) -> None:
    shake = wobbling(1.0, seed)
    time, _ = told(
        12.0,
        away=lambda t: OFF * abs(away * shake(t)),
        turned=lambda t: OFF_YAW * turned * shake(t + 9.0),
        height=lambda t: DEEP + OFF * lifted * shake(t + 99.0),
        effort=lambda t: least + (1.0 - least) * abs(shake(t + 3.0)),
    )
    assert time == math.inf


@given(
    st.one_of(st.just(0.14), st.floats(0.02, 0.3)),
    SIDES,
    st.floats(-0.4, 0.4),
    st.floats(0.0, 1.0),
    st.integers(0, 10**6),
)
def test_a_depth_that_moves_away_and_is_followed_behind_its_time_is_followed(
    speed: float, side: float, lag: float, effort: float, seed: int
) -> None:
    # A target that a vehicle is ahead of, and that it does not turn back to, is another thing.
    assume(lag * side >= 0.0 or abs(lag) < OFF - 0.003)
    noise = wobbling(0.003, seed)
    time, _ = told(
        15.0,
        z=lambda t: DEEP + side * speed * t,
        height=lambda t: DEEP + side * speed * t - lag + noise(t),
        effort=lambda t: effort,
    )
    assert time == math.inf


@settings(max_examples=30)
@given(
    st.floats(0.0, 2.0),
    st.floats(-math.pi, math.pi),
    st.floats(-1.0, 1.0),
    st.floats(0.05, 0.25),
    st.floats(0.1, 0.8),
    st.floats(0.03, 0.3),
    st.integers(0, 10**6),
)
def test_an_honest_move_is_none_however_hard_it_is(
    way: float, turn: float, climb: float, speed: float, rate: float, climbs: float, seed: int
) -> None:
    going = trapezoid(way, speed, GENTLE.acceleration)
    turning = trapezoid(abs(turn), rate, GENTLE.turn_acceleration)
    rising = trapezoid(abs(climb), climbs, 0.2)
    noise = wobbling(0.003, seed)
    time, _ = told(
        20.0,
        away=lambda t: abs(going(t) + noise(t)),
        turned=lambda t: math.copysign(turning(t), turn) + noise(t + 5.0),
        height=lambda t: DEEP - math.copysign(rising(t), climb) + noise(t + 50.0),
    )
    assert time == math.inf


def test_one_that_comes_nearer_by_a_centimetre_and_a_half_a_second_is_honest() -> None:
    assert told(20.0, away=lambda t: 0.5 - 0.015 * t)[0] == math.inf
    assert told(20.0, height=lambda t: DEEP - 0.5 + 0.015 * t)[0] == math.inf
    # By less than a centimetre it is not.
    assert told(20.0, away=lambda t: 0.5 - 0.009 * t)[0] < math.inf
    assert told(20.0, height=lambda t: DEEP - 0.5 + 0.009 * t)[0] < math.inf


@given(st.floats(0.0, 0.97 * HARD), st.floats(0.11, 2.0))
def test_one_that_hardly_works_presses_on_nothing(effort: float, away: float) -> None:
    assert told(10.0, away=lambda t: away, effort=lambda t: effort)[0] == math.inf


# Work that leads nowhere: those that press


@given(st.floats(1.1 * HARD, 1.0), st.floats(0.12, 2.0), st.integers(0, 10**6))
def test_pressing_is_told_as_soon_as_its_smoothed_effort_has_lasted(
    effort: float, away: float, seed: int
) -> None:
    shake = wobbling(0.4 * NEARER, seed)
    begins = 1.0
    time, words = told(
        10.0,
        away=lambda t: away + shake(t) if t >= begins else 0.0,
        effort=lambda t: effort if t >= begins else 0.0,
    )
    hard = EASING * math.log(effort / (effort - HARD))
    assert time - begins == pytest.approx(hard + PRESSED, abs=2.0 * BEAT)
    assert words.startswith("it presses")
    if effort == 1.0:
        assert time - begins <= 3.0 + BEAT


@given(
    st.floats(0.15, 1.5),
    st.floats(0.05, 0.25),
    st.floats(0.3, 3.0),
    st.floats(0.11, 1.0),
    st.integers(0, 10**6),
)
def test_who_runs_into_a_wall_on_its_way_is_told_within_three_seconds(
    way: float, speed: float, rebound: float, stops: float, seed: int
) -> None:
    shake = wobbling(0.4 * NEARER, seed)
    touches = way / speed

    def away(time: float) -> float:
        return stops + (way - speed * time if time < touches else abs(shake(time)))

    # It works at ease on its way, and hard from where it stands.
    time, words = told(
        touches + 5.0,
        away=away,
        effort=lambda t: 0.5 if t < touches else min(0.5 + rebound * (t - touches), 1.0),
    )
    hard_after = 0.5 / rebound
    assert touches < time <= touches + hard_after + 3.0 + BEAT
    assert words.startswith("it presses")


@given(st.floats(1.05 * OFF_YAW, math.pi), SIDES, st.integers(0, 10**6))
def test_one_that_cannot_turn_is_told_within_three_seconds(turned: float, side: float, seed: int) -> None:
    shake = wobbling(0.4 * math.radians(2.0), seed)
    begins = 1.0
    time, words = told(
        5.0,
        turned=lambda t: side * min(turned + abs(shake(t)), math.pi) if t >= begins else 0.0,
        effort=lambda t: 1.0 if t >= begins else 0.0,
    )
    assert begins + PRESSED <= time <= begins + 3.0 + BEAT
    assert words.startswith("it presses")


@given(st.floats(0.12, 2.0), SIDES, st.floats(0.0, 0.3), st.floats(0.0, 1.0), st.integers(0, 10**6))
def test_a_depth_that_does_not_follow_is_told_however_little_it_works(
    off: float, side: float, speed: float, effort: float, seed: int
) -> None:
    shake = wobbling(0.4 * NEARER, seed)
    begins = 1.0

    def z(time: float) -> float:
        """Where it is wanted: it jumps, and then moves away."""
        return DEEP if time < begins else DEEP + side * (off + speed * (time - begins))

    time, words = told(5.0, z=z, height=lambda t: DEEP + shake(t), effort=lambda t: effort)
    assert time - begins == pytest.approx(PRESSED, abs=2.0 * BEAT)
    assert words.startswith("its depth does not follow")


@given(st.floats(0.02, 0.5), SIDES)
def test_one_that_goes_the_other_way_is_told(speed: float, side: float) -> None:
    time, words = told(20.0, height=lambda t: DEEP + side * speed * t)
    assert time == pytest.approx(OFF / speed + PRESSED, abs=2.0 * BEAT)
    assert words.startswith("its depth does not follow")


def test_words_say_how_hard_how_long_and_how_far() -> None:
    assert told(5.0, away=lambda t: 0.25, turned=lambda t: -0.5)[1] == (
        "it presses: 100% of its thrust for 2.7 s, 0.25 m and 29° from its goal, and comes no nearer"
    )
    assert told(5.0, height=lambda t: DEEP + 0.2, effort=never)[1] == (
        "its depth does not follow: 1.30 m for 2.7 s, 1.50 m are wanted"
    )


def test_a_new_goal_and_a_time_in_which_nothing_is_asked_begin_anew() -> None:
    watch = Pressing()
    for _ in range(5):
        assert told(0.9 * PRESSED, away=lambda t: 0.5, watch=watch)[0] == math.inf
        watch.forget()
    # A goal every second.
    watch = Pressing()
    for k in range(round(10.0 / BEAT)):
        goal = SE2(1.0 + k // 25, 0.0, 0.0)
        assert not watch(BEAT * k, fix_at(time=BEAT * k), goal, -0.9, 1.0)
