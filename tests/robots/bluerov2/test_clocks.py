from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dream.robots.bluerov2.clocks import DeviceClock

seeds = st.integers(0, 2**32 - 1)


def way(rng: np.random.Generator, count: int) -> np.ndarray:
    """Delays of a network: 2 ms at the least, often 10 more, at times 200."""
    return 0.002 + rng.exponential(0.01, count) + (rng.random(count) < 0.02) * 0.2


def dive(
    seed: int, drift: float = 0.0, offset: float = 1234.5, count: int = 1500, step: float = 0.05
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, stamp and arrival of messages in the order they arrive."""
    rng = np.random.default_rng(seed)
    truth = step * np.arange(count)
    stamp = offset + (1.0 + drift) * truth
    arrival = truth + way(rng, count)
    order = np.argsort(arrival, kind="stable")
    return truth[order], stamp[order], arrival[order]


@given(seeds, st.floats(-100e-6, 100e-6))
def test_a_stamp_is_never_mapped_early_nor_to_the_future_and_hardly_late(seed: int, drift: float) -> None:
    clock = DeviceClock(window=10.0)
    truth, stamp, arrival = dive(seed, drift, count=400)
    mapped = np.array([clock.time(s, a) for s, a in zip(stamp, arrival, strict=True)])
    assert (mapped >= truth - 1e-9).all()
    assert (mapped <= arrival).all()
    # After a window: the least delay of 200 messages, and what the bound was let out by meanwhile.
    assert (mapped - truth)[200:].max() < 0.002 + 0.002 + 2 * 100e-6 * 10.0
    assert clock.jumps == 0


def test_a_clock_that_drifts_by_50_ppm_for_an_hour_is_followed() -> None:
    clock = DeviceClock()
    truth, stamp, arrival = dive(7, 50e-6, count=7200, step=0.5)
    mapped = np.array([clock.time(s, a) for s, a in zip(stamp, arrival, strict=True)])
    assert np.ptp(arrival - stamp) > 0.15  # an offset held fixed would be wrong by as much
    assert np.abs(mapped - truth)[100:].max() < 0.012


@pytest.mark.parametrize("step", [-1234.0, -3.0, 3.0, 1e9])
def test_a_clock_that_is_set_is_followed_from_the_next_stamp_on(step: float) -> None:
    clock = DeviceClock()
    truth, stamp, arrival = dive(1)
    stamp = stamp + step * (truth > 40.0)
    mapped = np.array([clock.time(s, a) for s, a in zip(stamp, arrival, strict=True)])
    late = mapped - truth
    assert late.min() > -1e-6
    assert clock.jumps >= 1
    assert np.abs(late[(truth > 41.0)]).max() < 0.02
    assert (mapped <= arrival).all()


def test_a_reboot_does_not_map_the_first_stamp_to_before_it() -> None:
    clock = DeviceClock()
    for k in range(100):
        clock.time(500.0 + k, 100.0 + k)
    assert clock.time(0.1, 203.0) == pytest.approx(203.0)
    assert clock.jumps == 1


def test_a_burst_of_held_up_messages_is_no_jump() -> None:
    clock = DeviceClock()
    for k in range(200):
        clock.time(0.05 * k, 0.05 * k + 0.004)
    held = [clock.time(10.0 + 0.05 * k, 12.0 + 0.001 * k) for k in range(40)]
    assert np.allclose(held, 10.004 + 0.05 * np.arange(40), atol=1e-3)
    assert clock.jumps == 0


def test_a_device_that_stands_still_for_long_is_a_jump_at_last() -> None:
    clock = DeviceClock()
    for k in range(200):
        clock.time(0.05 * k, 0.05 * k + 0.004)
    # It slept for 2 s: from here on all its stamps lie that much behind, and none ever comes straight.
    mapped = [clock.time(10.0 + 0.05 * k, 12.0 + 0.05 * k + 0.004) for k in range(200)]
    assert clock.jumps == 1
    assert mapped[-1] == pytest.approx(12.0 + 0.05 * 199 + 0.004, abs=1e-6)


@given(seeds)
def test_messages_that_overtake_each_other_keep_their_order_of_stamps(seed: int) -> None:
    clock = DeviceClock()
    truth, stamp, arrival = dive(seed, count=300)
    assume((np.diff(stamp) < 0.0).any())
    mapped = np.array([clock.time(s, a) for s, a in zip(stamp, arrival, strict=True)])
    settled = mapped[100:][np.argsort(truth[100:])]
    assert (np.diff(settled) > 0.0).all()


@given(seeds, st.floats(0.0, 0.05), st.floats(0.0, 0.05))
def test_a_round_trip_bounds_the_error_by_half_of_itself(seed: int, there: float, back: float) -> None:
    clock = DeviceClock()
    rng = np.random.default_rng(seed)
    for k in range(50):
        truth = 0.1 * k
        if k % 10 == 0:
            clock.round_trip(truth - there, 77.0 + truth, truth + back)
        late = 0.03 + rng.exponential(0.01)
        mapped = clock.time(77.0 + truth, truth + late)
        assert mapped <= truth + late
        assert abs(mapped - truth) <= 0.5 * (there + min(back, late)) + 2 * 100e-6 * 5.0 + 1e-9


def test_without_round_trips_a_constant_way_goes_unseen_and_with_them_half_of_it_does() -> None:
    one, two = DeviceClock(), DeviceClock()
    two.round_trip(0.0, 100.02, 0.04)
    assert one.time(100.02, 0.06) == pytest.approx(0.06)
    assert two.time(100.02, 0.06) == pytest.approx(0.02, abs=1e-5)


def test_bounds_are_forgotten_after_the_window() -> None:
    clock = DeviceClock(window=10.0)
    clock.time(0.0, 0.0)
    for k in range(1, 30):
        clock.time(float(k), k + 0.1)
    assert clock.time(30.0, 30.1) == pytest.approx(30.1)


def test_the_jitter_is_what_most_stamps_are_late_by() -> None:
    clock = DeviceClock()
    assert math.isnan(clock.jitter)
    for k in range(100):
        clock.time(float(k) / 20, k / 20 + (0.03 if k % 4 == 3 else 0.0))
    assert clock.jitter == pytest.approx(0.03, abs=1e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_time_is_refused(bad: float) -> None:
    clock = DeviceClock()
    with pytest.raises(ValueError, match="finite"):
        clock.time(bad, 0.0)
    with pytest.raises(ValueError, match="finite"):
        clock.time(0.0, bad)
    with pytest.raises(ValueError, match="round trip"):
        clock.round_trip(bad, 0.0, 1.0)
    with pytest.raises(ValueError, match="round trip"):
        clock.round_trip(1.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["window", "drift", "jump"])
def test_parameters_are_checked(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        DeviceClock(**{name: 0.0})


ways = st.floats(0.0, 0.09)
"""Seconds that half of a round trip takes, on a link that is not slow."""


@given(
    st.floats(0.3, 30.0),
    st.sampled_from([-1.0, 1.0]),
    st.lists(st.tuples(ways, ways), min_size=2, max_size=20),
    st.floats(-100e-6, 100e-6),
    st.floats(0.0, 0.9),
    seeds,
)
def test_a_clock_that_is_set_by_03_s_is_told_at_the_next_round_trip(
    slip: float,
    side: float,
    trips: list[tuple[float, float]],
    drift: float,
    before: float,
    seed: int,
) -> None:
    clock, rng = DeviceClock(), np.random.default_rng(seed)

    def ask(at: float, there: float, back: float, set_by: float) -> float:
        clock.round_trip(at, 77.0 + (1.0 + drift) * (at + there) + set_by, at + there + back)
        return at + there + back

    for k, (there, back) in enumerate(trips[:-1]):
        for late in sorted(rng.exponential(0.01, 10)):
            clock.time(77.0 + (1.0 + drift) * (k - 0.1), k - 0.1 + late)
        ask(float(k), there, back, 0.0)
    assert (clock.jumps, clock.slipped) == (0, 0.0)
    received = ask(len(trips) - before, *trips[-1], side * slip)
    assert clock.jumps == 1
    error = 0.5 * (sum(trips[-1]) + sum(trips[-2])) + 1e-3
    assert clock.slipped == pytest.approx(side * slip, abs=error)
    # From then on stamps are mapped as the new clock has them.
    stamp = 77.0 + (1.0 + drift) * received + side * slip
    assert clock.time(stamp, received + 0.01) == pytest.approx(received, abs=0.5 * sum(trips[-1]) + 0.011)


@given(
    st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.1, 20.0)), max_size=30),
    st.floats(-100e-6, 100e-6),
    seeds,
)
def test_neither_jitter_nor_a_slow_link_is_taken_for_a_clock_that_was_set(
    trips: list[tuple[float, float, float]], drift: float, seed: int
) -> None:
    clock, rng, truth = DeviceClock(), np.random.default_rng(seed), 0.0
    came: list[tuple[float, Callable[[], object]]] = []

    def stamp(at: float) -> float:
        return 77.0 + (1.0 + drift) * at

    for there, back, pause in trips:
        begins, truth = truth, truth + pause
        # Answers take up to two seconds; stamps come faster, but not evenly.
        for at in np.arange(begins, truth, 0.1):
            arrives = float(at + 0.45 * rng.random() ** 4)
            came.append((arrives, partial(clock.time, stamp(float(at)), arrives)))
        asked, answered = begins + there, begins + there + back
        came.append((answered, partial(clock.round_trip, begins, stamp(asked), answered)))
    for _, take in sorted(came, key=lambda entry: entry[0]):
        take()
    assert (clock.jumps, clock.slipped) == (0, 0.0)


@pytest.mark.parametrize("step", [-3.0, 3.0])
def test_a_first_round_trip_tells_a_clock_that_was_set_since_its_stamps(step: float) -> None:
    clock = DeviceClock()
    for k in range(20):
        clock.time(50.0 + 0.05 * k, 0.05 * k + 0.01)
    clock.round_trip(1.1, 51.12 + step, 1.2)
    assert clock.jumps == 1
    assert clock.time(51.2 + step, 1.21) == pytest.approx(1.2, abs=0.06)


def test_how_far_a_clock_may_slip_unseen_is_what_both_round_trips_leave_open() -> None:
    for slip, seen in ((0.24, False), (0.26, True)):
        clock = DeviceClock()
        clock.round_trip(0.0, 10.1, 0.1)  # read at its very end
        clock.round_trip(1.0, 11.0 + slip, 1.1)  # and at its very beginning
        assert (clock.jumps == 1) == seen
