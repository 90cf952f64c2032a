from __future__ import annotations

import math

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
