"""How depths scatter, as a level seabed shows it, and what averaging leaves of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from dream.geometry import Camera, camera_mount
from dream.perception.scatter import ONE_SURFACE, SCATTERS, SLOPE, Scatter, scatter_of, steadied
from dream.types import Float32Array, Label, UInt8Array

CAMERA = Camera.from_fov(320, 240, 1.57)


@dataclass
class Seen:
    depth: Float32Array
    labels: UInt8Array


def seabed(scatter: float, seed: int = 1, camera: Camera = CAMERA) -> Seen:
    """Level ground, from 2 m above it; water where it is too far."""
    turn = camera_mount(0.4).rotation
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    fall = turn[2, 1] * v[:, None] + turn[2, 2] + np.zeros((1, camera.width))
    depth = np.where(fall < -0.1, -2.0 / np.minimum(fall, -0.1), np.nan)
    labels = np.where(np.isfinite(depth), Label.SEABED, Label.WATER).astype(np.uint8)
    depth += scatter * depth**2 * np.random.default_rng(seed).standard_normal(depth.shape)
    return Seen(depth.astype(np.float32), labels)


@pytest.mark.parametrize("scatter", [0.0, 0.001, 0.002, 0.005])
def test_the_frames_themselves_show_how_depths_scatter(scatter: float) -> None:
    assert scatter_of([seabed(scatter)]) == pytest.approx(scatter, rel=0.05, abs=2e-6)


def test_one_frame_that_scatters_otherwise_does_not_decide() -> None:
    frames = [seabed(0.002, 1), seabed(0.02, 2), seabed(0.002, 3)]
    assert scatter_of(frames) == pytest.approx(0.002, rel=0.05)


def test_frames_without_seabed_tell_nothing() -> None:
    nothing = Seen(seabed(0.01).depth, np.full((240, 320), Label.TARGET, np.uint8))
    scatter = Scatter()
    scatter.add(nothing)
    assert scatter.value == 0.0
    scatter.add(seabed(0.002))
    assert scatter.value == pytest.approx(0.002, rel=0.05)


def test_no_return_may_also_be_0_or_without_end() -> None:
    seen = seabed(0.002)
    seen.depth[::7, ::5], seen.depth[::5, ::7] = 0.0, np.inf
    seen.depth[:60] = np.inf
    assert scatter_of([seen]) == pytest.approx(0.002, rel=0.1)
    depth, averaged = steadied(seen, 2, 0.002)
    gone = ~((seen.depth > 0.0) & np.isfinite(seen.depth))
    assert np.isnan(depth[gone]).all()
    assert np.isfinite(depth[~gone]).all()
    assert (averaged[gone] == 0).all()


def test_depths_that_hardly_scatter_are_left_alone() -> None:
    seen = seabed(SCATTERS)
    depth, averaged = steadied(seen, 2, SCATTERS)
    assert depth is seen.depth
    assert (averaged == 1).all()


def test_a_plane_stays_where_it_is_and_scatters_a_fifth() -> None:
    true, noisy = seabed(0.0), seabed(0.002)
    inner = np.s_[120:-2, 2:-2]
    assert steadied(true, 2, 0.002)[0][inner] == pytest.approx(true.depth[inner], rel=1e-4)
    depth, averaged = steadied(noisy, 2, 0.002)
    before = (1.0 / noisy.depth - 1.0 / true.depth)[inner]
    after = (1.0 / depth - 1.0 / true.depth)[inner]
    assert after.std() == pytest.approx(before.std() / 5.0, rel=0.1)
    assert abs(after.mean()) < 1e-5
    assert averaged[inner].mean() > 24.0
    assert (np.isnan(depth) == np.isnan(noisy.depth)).all()


def test_no_mean_goes_across_an_edge_or_a_label() -> None:
    seen = seabed(0.0, camera=Camera.from_fov(20, 20, 1.0))
    seen.depth[:], seen.labels[:] = 4.0, Label.SEABED
    seen.depth[:, 10:] = 6.0
    seen.labels[10:] = Label.TARGET
    depth, averaged = steadied(seen, 2, 0.002)
    assert depth == pytest.approx(seen.depth)
    assert averaged[9, 9] == averaged[10, 10] == 9
    assert averaged[5, 5] == 25


def test_averaging_agrees_with_a_slow_twin() -> None:
    rng = np.random.default_rng(7)
    depth = rng.uniform(2.0, 2.1, (24, 32)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    labels = rng.integers(1, 3, depth.shape).astype(np.uint8)
    found, averaged = steadied(Seen(depth, labels), 1, 0.002)
    apart = ONE_SURFACE * math.sqrt(2.0) * 0.002 + SLOPE
    cut = 0
    for (v, u), z in np.ndenumerate(depth):
        if np.isnan(z):
            assert np.isnan(found[v, u])
            continue
        around = np.s_[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
        inverse = 1.0 / depth[around].astype(np.float64)
        alike = (labels[around] == labels[v, u]) & (np.abs(inverse - 1.0 / float(z)) <= apart)
        cut += np.isfinite(inverse).sum() - alike.sum()
        assert averaged[v, u] == alike.sum()
        assert found[v, u] == pytest.approx(1.0 / inverse[alike].mean(), rel=1e-6)
    assert cut > 500
