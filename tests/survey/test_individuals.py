"""Individuals in a picture of the ground made by hand, where each is known."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import Bounds
from dream.protocol import DREAM_V1
from dream.survey import individuals
from dream.survey.calibration import SHARP
from dream.survey.ground import Frame, Ground
from dream.types import Label

CELL, SIDE = 0.025, 6.0


def mounds(middles: npt.ArrayLike, across: npt.ArrayLike, slope: float = 0.0) -> Ground:
    """Hemispheres on a plane, seen from everywhere."""
    count = round(SIDE / CELL)
    at = (np.arange(count) + 0.5) * CELL
    x, y = np.broadcast_to(at, (count, count)), np.broadcast_to(at[:, None], (count, count))
    height, share = -10.0 + slope * x, np.zeros((count, count))
    for (mx, my), width in zip(np.reshape(middles, (-1, 2)), np.reshape(across, -1), strict=True):
        up = 0.25 * width**2 - (x - mx) ** 2 - (y - my) ** 2
        share[up > 0.0] = 1.0
        height = np.maximum(
            height, np.where(up > 0.0, -10.0 + slope * mx + np.sqrt(np.maximum(up, 0.0)), -99.0)
        )
    nearest = np.full((count, count), 3.0, np.float32)
    top = np.where(share > 0.0, height, -np.inf)
    return Ground(
        Bounds(0.0, 0.0, SIDE, SIDE),
        CELL,
        height.astype(np.float32),
        share.astype(np.float32),
        nearest,
        top.astype(np.float32),
        np.ones((24, 24), np.uint16),
        0.0,
    )


def spread_out(seed: int, gap: float) -> npt.NDArray[np.float64]:
    """As many places as fit, at least so far from each other."""
    places: list[npt.NDArray[np.float64]] = []
    for place in np.random.default_rng(seed).uniform(0.5, SIDE - 0.5, (400, 2)):
        if all(np.hypot(*(place - other)) >= gap for other in places):
            places.append(place)
    return np.array(places)


@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_clumps_that_stand_alone_are_found_each_once_where_they_are_and_as_large(slope: float) -> None:
    middles = spread_out(1, 0.4)
    across = np.random.default_rng(2).uniform(0.15, 0.3, len(middles))
    found = individuals.peaks(mounds(middles, across, slope))
    assert len(found) == len(middles) > 50
    away = np.hypot(*(found.position[:, None, :2] - middles[None]).transpose(2, 0, 1))
    assert away.min(axis=1).max() < 0.05
    assert found.lone.all()
    which = away.argmin(axis=1)
    assert sorted(which) == list(range(len(middles)))
    assert np.abs(found.across - across[which]).max() < 1.5 * CELL
    assert found.position[:, 2] == pytest.approx(
        -10.0 + slope * middles[which, 0] + 0.5 * across[which], abs=0.02
    )


def test_clumps_that_touch_are_told_apart_by_relief_and_are_not_alone() -> None:
    middles = spread_out(3, 0.17)
    found = individuals.peaks(mounds(middles, np.full(len(middles), 0.22)))
    assert len(found) == pytest.approx(len(middles), rel=0.05)
    assert not found.lone.all()


def test_a_mound_of_bare_ground_is_no_individual() -> None:
    bare = mounds([[3.0, 3.0]], [0.25])
    bare.share[:] = 0.0
    assert len(individuals.peaks(bare)) == 0


def test_the_ground_between_the_shells_is_not_raised_by_them() -> None:
    drawn = mounds(spread_out(4, 0.3), np.full(len(spread_out(4, 0.3)), 0.25), slope=0.1)
    at = (np.arange(drawn.height.shape[1]) + 0.5) * CELL
    assert np.abs(individuals.bare_ground(drawn) - (-10.0 + 0.1 * at)[None, :])[20:-20, 20:-20].max() < 0.02


def test_each_look_is_counted_as_a_slow_twin_counts_it() -> None:
    rng = np.random.default_rng(5)
    depth = rng.uniform(1.0, 6.0, (30, 40)).astype(np.float32)
    labels = rng.integers(0, 4, (30, 40)).astype(np.uint8)
    lens, origin = np.array([30.0, 31.0, 20.0, 15.0]), np.array([0.5, -0.2, -8.0])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    frame = Frame(depth, labels, lens, np.ascontiguousarray(turn), origin)
    position = origin + (rng.uniform(-1.0, 1.0, (300, 3)) * (3.0, 2.0, 0.0) + (0.0, 0.0, 4.0)) @ turn.T
    none = np.zeros(300)
    peaks = individuals.Peaks(position, none, none, none, np.zeros(300, np.bool_), none)
    hits, looks = individuals.recognised(peaks, [frame, frame], DREAM_V1)
    for n, point in enumerate(position):
        right, down, z = (point - origin) @ turn
        u, v = int(np.floor(lens[0] * right / z + lens[2])), int(np.floor(lens[1] * down / z + lens[3]))
        looked = 1 <= u < 39 and 1 <= v < 29 and np.hypot(*(point - origin)[:2]) <= DREAM_V1.reach
        looked = bool(looked and depth[v, u] >= z - individuals.HIDDEN)
        hit = looked and np.count_nonzero(labels[v - 1 : v + 2, u - 1 : u + 2] == Label.TARGET) >= 3
        assert (looks[n], hits[n]) == (2 * looked, 2 * hit)
    assert looks.any()
    assert (hits < looks).any()


def test_confidence_grows_with_hits_and_falls_with_looks_in_vain() -> None:
    hits, looks = np.array([1, 2, 1, 1, 0]), np.array([1, 2, 2, 6, 6])
    on_reef, off = (individuals.confidence(hits, looks, np.full(5, here)) for here in (True, False))
    assert on_reef[1] > on_reef[0] > on_reef[2] > on_reef[3] > on_reef[4]
    assert (off < on_reef).all()
    # A false target that one frame of six showed.
    assert off[3] < 0.1


def test_the_capture_model_is_log_linear_and_bounded() -> None:
    cover, near = np.array([0.2, 0.5, 0.9]), np.array([3.0, 3.0, 5.0])
    peaks = individuals.Peaks(np.zeros((3, 3)), cover, near, near, near > 9.0, near)
    model = replace(SHARP, capture=(1.0, 2.0, -0.1, -0.5))

    def log(size: float | None) -> np.ndarray:
        return np.asarray(np.log(individuals.stands_for(peaks, size, model)))

    assert log(None) == pytest.approx([0.4, 1.0, 1.6])
    assert log(individuals.TYPICAL * np.exp(0.2)) == pytest.approx([0.3, 0.9, 1.5])
    # Beyond what it was found on it stays as it is.
    assert log(9.0) == pytest.approx(log(None) - 0.5 * individuals.LARGER)
    assert individuals.stands_for(peaks, None, SHARP)[2] <= np.exp(2.5)


def test_the_stature_of_shell_is_its_height_above_the_ground_between() -> None:
    """A hemisphere is two thirds of its radius high on average, wherever the ground slopes to."""
    middles = spread_out(3, 0.8)
    found = individuals.peaks(mounds(middles, np.full(len(middles), 0.3), 0.1))
    assert np.median(found.stature) == pytest.approx(2.0 / 3.0 * 0.15, rel=0.1)
