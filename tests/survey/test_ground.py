"""All frames on one grid: the kernels against slow twins, and what scatters."""

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import SE3, Bounds, Camera, camera_mount
from dream.protocol import DREAM_V1
from dream.survey import ground
from dream.survey.ground import Frame
from dream.types import Label, Observation

CAMERA = Camera.from_fov(64, 48, 1.5)
BOUNDS = Bounds(-4.0, -4.0, 6.0, 4.0)
T_WORLD_BASE = SE3.level(-2.0, 0.5, -8.0, 0.2)


def level_view(
    scatter: float = 0.0, labels: npt.NDArray[np.uint8] | None = None, camera: Camera = CAMERA
) -> Observation:
    """The seabed at z = −10, seen from 2 m above it."""
    T = T_WORLD_BASE @ camera_mount(0.4)
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    fall = T.rotation[2, 0] * u[None, :] + T.rotation[2, 1] * v[:, None] + T.rotation[2, 2]
    depth = np.where(fall < -0.02, -2.0 / np.where(fall < -0.02, fall, -1.0), np.nan)
    depth = np.where(depth < 20.0, depth, np.nan)
    depth += scatter * depth**2 * np.random.default_rng(1).standard_normal(depth.shape)
    if labels is None:
        labels = np.where(np.isfinite(depth), Label.SEABED, Label.WATER).astype(np.uint8)
    rgb = np.zeros((camera.height, camera.width, 3), np.uint8)
    return Observation(0.0, rgb, depth.astype(np.float32), labels, camera, T_WORLD_BASE, camera_mount(0.4))


def mixed() -> Observation:
    labels = np.random.default_rng(2).integers(0, 4, (48, 64)).astype(np.uint8)
    return level_view(0.01, labels)


def test_the_sums_of_a_frame_are_those_of_its_points() -> None:
    seen = mixed()
    drawn = ground.fuse([Frame.of(seen)], BOUNDS, DREAM_V1, 0.0)
    points = seen.camera.back_project(seen.depth, seen.T_world_camera)
    rows, cols = drawn.height.shape
    weight, height, share = (np.zeros((rows, cols)) for _ in range(3))
    nearest, top = np.full((rows, cols), np.inf), np.full((rows, cols), -np.inf)
    times = np.zeros((32, 40), np.int64)
    x, y, _ = seen.T_world_camera.translation
    for (v, u), z in np.ndenumerate(seen.depth):
        px, py, pz = points[v, u]
        label = seen.labels[v, u]
        if not (0.1 <= z <= 20.0):
            continue
        row, col = int((py + 4.0) // drawn.cell), int((px + 4.0) // drawn.cell)
        if not (0 <= row < rows and 0 <= col < cols):
            continue
        if label == Label.TARGET:
            top[row, col] = max(top[row, col], pz)
        if np.hypot(px - x, py - y) > DREAM_V1.reach:
            continue
        times[row // 10, col // 10] = 1
        if label not in (Label.SEABED, Label.TARGET):
            continue
        w = float(z) ** -4
        weight[row, col] += w
        height[row, col] += w * pz
        nearest[row, col] = min(nearest[row, col], z)
        if label == Label.TARGET:
            share[row, col] += w
    seen_cells = weight > 0.0
    assert seen_cells.sum() > 300
    assert (drawn.seen == seen_cells).all()
    assert drawn.height[seen_cells] == pytest.approx(height[seen_cells] / weight[seen_cells], abs=1e-4)
    assert drawn.share[seen_cells] == pytest.approx(share[seen_cells] / weight[seen_cells], abs=1e-5)
    assert drawn.nearest[seen_cells] == pytest.approx(nearest[seen_cells])
    assert drawn.top == pytest.approx(top, abs=1e-4)
    assert (drawn.times == times).all()


def test_a_level_seabed_is_level_and_the_nearer_of_two_views_decides() -> None:
    near = Frame.of(level_view())
    drawn = ground.fuse([near], BOUNDS, DREAM_V1, 0.0)
    assert np.abs(drawn.height[drawn.seen] + 10.0).max() < 1e-3
    wrong = np.full_like(near.labels, Label.TARGET)
    far = Frame(near.depth, wrong, near.lens, near.rotation, near.origin - (3.0, 0.0, 0.0))
    both = ground.fuse([near, far], BOUNDS, DREAM_V1, 0.0)
    twice = drawn.seen & (both.nearest < 4.0)
    assert np.median(both.share[twice]) < 0.3


def test_cells_divide_the_cells_of_the_map_also_where_the_area_is_large() -> None:
    frame = Frame.of(level_view())
    for side in (10.0, 60.0, 200.0):
        drawn = ground.fuse([frame], Bounds(-4.0, -4.0, side - 4.0, side - 4.0), DREAM_V1, 0.0)
        times = DREAM_V1.cell / drawn.cell
        assert times == pytest.approx(round(times))
        assert drawn.height.size <= 2 * ground.MOST_CELLS
        assert drawn.times.shape == (round(side / 0.25), round(side / 0.25))


def test_smoothing_keeps_a_plane_and_takes_two_thirds_of_the_noise() -> None:
    plane, noisy = level_view().depth, level_view(0.002).depth
    inner = np.s_[30:-2, 2:-2]
    assert ground.smoothed(plane)[inner] == pytest.approx(plane[inner], rel=1e-5)
    before = (1.0 / noisy - 1.0 / plane)[inner].std()
    after = (1.0 / ground.smoothed(noisy) - 1.0 / plane)[inner].std()
    assert after == pytest.approx(before / 3.0, rel=0.15)
    assert (np.isnan(ground.smoothed(noisy)) == np.isnan(noisy)).all()


def test_a_large_image_is_thinned_and_still_true() -> None:
    camera = Camera.from_fov(800, 600, 1.5)
    frame = Frame.of(level_view(camera=camera))
    assert frame.depth.size <= ground.MOST_PIXELS
    drawn = ground.fuse([frame], BOUNDS, DREAM_V1, 0.0)
    assert np.abs(drawn.height[drawn.seen] + 10.0).max() < 1e-3


def test_what_is_cut_out_lies_where_it_lay() -> None:
    drawn = ground.fuse([Frame.of(level_view())], BOUNDS, DREAM_V1, 0.0)
    assert drawn.around_target(1.0) is drawn
    drawn.share[200, 120] = 1.0
    part = drawn.around_target(0.5)
    (row,), (col,) = np.nonzero(part.share)
    x, y = part.centres(np.array([row]), np.array([col]))
    assert (x[0], y[0]) == pytest.approx((-4.0 + 120.5 * drawn.cell, -4.0 + 200.5 * drawn.cell))
    assert part.height.shape == (41, 41)
