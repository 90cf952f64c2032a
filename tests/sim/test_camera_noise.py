"""The sensor that errs: how much, how often, how large, and the same each time a mission is flown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dream.geometry import SE2, SE3, Camera
from dream.protocol import DREAM_V1, DREAM_V1_NOISY, SensorNoise
from dream.sim.camera_noise import (
    noise_generator,
    noisy_depth,
    with_false_targets,
    with_missed,
    with_noise,
)
from dream.sim.render import Frame, Renderer
from dream.sim.world import Float32Array, UInt8Array, World
from dream.types import Label
from tests.sim.made import made

assert DREAM_V1_NOISY.noise is not None
NOISE = DREAM_V1_NOISY.noise
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([3.0, -2.0, 2.0]))
"""A camera that looks straight down from 2 m above a ground at z = 0."""
CAMERA = Camera.from_fov(320, 240, math.radians(90.0))
PITCH = 2.0 / CAMERA.fx
"""Metres of that ground to a pixel."""


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def sand() -> tuple[UInt8Array, Float32Array]:
    """What the camera that looks down sees: labels and depth."""
    shape = (CAMERA.height, CAMERA.width)
    return np.full(shape, Label.SEABED, np.uint8), np.full(shape, 2.0, np.float32)


def spots(width: tuple[float, float], mean: float, seed: int) -> UInt8Array:
    """Labels of that ground with false targets."""
    labels, depth = sand()
    noise = replace(NOISE, false_targets=mean, false_size=width)
    return with_false_targets(labels, depth, CAMERA, DOWN, noise, rng(seed))


def view(world: World, turn: float = 0.0) -> tuple[Frame, SE3]:
    """What is seen from a world's first start."""
    start = world.starts[0]
    z = float(world.terrain.height(start.x, start.y)) + DREAM_V1.altitude
    pose = SE3.level(start.x, start.y, z, start.yaw + turn) @ DREAM_V1.T_base_camera
    return Renderer(world).render(DREAM_V1.camera, pose), pose


def sensed(world: World, frame: Frame, pose: SE3, noise: SensorNoise, seed: int = 0) -> Frame:
    return with_noise(frame, DREAM_V1.camera, pose, noise, rng(seed), hull=world.hull)


@pytest.mark.parametrize("z", [0.5, 2.0, 5.0, 8.0, 19.0])
def test_depth_scatters_with_the_square_of_the_depth(z: float) -> None:
    count = 240 * 320
    error = noisy_depth(np.full((240, 320), z, np.float32), 0.002, rng()).astype(np.float64) - z
    sigma = 0.002 * z * z
    assert abs(error.mean()) < 4.0 * sigma / math.sqrt(count)
    assert abs(error.std() / sigma - 1.0) < 4.0 / math.sqrt(2.0 * count)
    # Normal: 4.55 % lie beyond two deviations.
    assert abs((np.abs(error) > 2.0 * sigma).mean() - 0.0455) < 4.0 * math.sqrt(0.0455 * 0.9545 / count)


def test_errors_of_neighbouring_pixels_are_not_alike() -> None:
    error = noisy_depth(np.full((240, 320), 5.0, np.float32), 0.002, rng()) - 5.0
    for a, b in ((error[:, 1:], error[:, :-1]), (error[1:], error[:-1]), (error[:120], error[120:])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.02


def test_where_nothing_returns_nothing_does() -> None:
    depth = np.array([[np.nan, 3.0], [4.0, np.nan]], np.float32)
    noisy = noisy_depth(depth, 0.002, rng())
    np.testing.assert_array_equal(np.isnan(noisy), np.isnan(depth))
    assert noisy.dtype == np.float32


def test_one_individual_in_ten_is_missed_with_all_its_pixels() -> None:
    count = 4000
    ids = np.repeat(np.arange(-1, count, dtype=np.int32), 3).reshape(3, -1)
    labels = np.where(ids >= 0, Label.TARGET, Label.OBSTACLE).astype(np.uint8)
    seabed = np.full(count, Label.SEABED, np.uint8)
    found = with_missed(labels, ids, 0.1, seabed, rng())
    assert set(np.unique(found)) == {Label.SEABED, Label.TARGET, Label.OBSTACLE}
    np.testing.assert_array_equal(found[ids < 0], labels[ids < 0])
    pixels = np.bincount(ids[(ids >= 0) & (found == Label.SEABED)], minlength=count)
    assert set(np.unique(pixels)) == {0, 3}
    assert abs((pixels == 3).mean() - 0.1) < 4.0 * math.sqrt(0.09 / count)


def test_who_is_missed_changes_from_frame_to_frame() -> None:
    ids = np.arange(4000, dtype=np.int32)[None]
    labels = np.full(ids.shape, Label.TARGET, np.uint8)
    seabed = np.full(4000, Label.SEABED, np.uint8)
    first, second = (with_missed(labels, ids, 0.1, seabed, rng(k)) == Label.SEABED for k in (0, 1))
    assert abs((first & second).mean() - 0.01) < 4.0 * math.sqrt(0.01 / 4000)


@pytest.mark.rare
@pytest.mark.parametrize(("name", "missed_as"), [("reef/string", Label.SEABED), ("wreck/1", Label.OBSTACLE)])
def test_what_is_missed_takes_the_label_of_what_it_is_part_of(name: str, missed_as: Label) -> None:
    world = made(name)
    frame, pose = max(
        (view(world, turn) for turn in range(6)), key=lambda seen: int((seen[0].ids >= 0).sum())
    )
    assert (frame.ids >= 0).any()
    found = sensed(world, frame, pose, SensorNoise(0.0, 1.0, 0.0, (0.1, 0.1)))
    assert (found.labels[frame.ids >= 0] == missed_as).all()
    np.testing.assert_array_equal(found.labels[frame.ids < 0], frame.labels[frame.ids < 0])
    np.testing.assert_array_equal(found.depth, frame.depth)


def test_false_targets_come_as_often_as_they_should() -> None:
    # Spots smaller than a pixel, so that two hardly ever meet.
    frames = 400
    counts = np.array([(spots((1e-3, 1e-3), 0.3, seed) == Label.TARGET).sum() for seed in range(frames)])
    assert abs(counts.mean() - 0.3) < 4.0 * math.sqrt(0.3 / frames)
    assert abs((counts == 0).mean() - math.exp(-0.3)) < 4.0 * math.sqrt(0.3 / frames)
    assert counts.max() > 1


@pytest.mark.parametrize("width", [0.155, 0.495])
def test_a_false_target_is_round_and_as_wide_on_the_ground_as_it_should_be(width: float) -> None:
    whole = 0
    for seed in range(200):
        rows, cols = np.nonzero(spots((width, width), 0.3, seed) == Label.TARGET)
        if not len(rows) or max(np.ptp(rows), np.ptp(cols)) > width / PITCH:
            continue  # None, or more than one.
        if {0, CAMERA.height - 1} & {*rows} or {0, CAMERA.width - 1} & {*cols}:
            continue  # Perhaps cut by the edge.
        whole += 1
        assert min(np.ptp(rows), np.ptp(cols)) * PITCH >= width - 2.0 * PITCH
        assert len(rows) * PITCH**2 == pytest.approx(0.25 * math.pi * width**2, rel=0.04)
    assert whole > 15


def test_widths_are_spread_evenly_over_their_range() -> None:
    least, most = NOISE.false_size
    areas = np.array([(spots((least, most), 0.1, seed) == Label.TARGET).sum() for seed in range(1500)])
    widths = np.sqrt(areas[areas > 0] * 4.0 / math.pi) * PITCH
    # A few are cut by the edge of the image, or are two in one frame.
    for share in (0.25, 0.5, 0.75):
        assert abs(np.quantile(widths, share) - (least + share * (most - least))) < 0.05


def test_false_targets_lie_anywhere_on_the_seabed_and_nowhere_else() -> None:
    labels, depth = sand()
    labels[:, 100:200] = Label.OBSTACLE
    labels[:40], depth[:40] = Label.WATER, np.nan
    noise = replace(NOISE, false_targets=20.0)
    hits = np.zeros(labels.shape, int)
    for seed in range(15):
        found = with_false_targets(labels, depth, CAMERA, DOWN, noise, rng(seed))
        changed = found != labels
        assert (found[changed] == Label.TARGET).all()
        hits += changed
    assert not hits[labels != Label.SEABED].any()
    left, right = hits[40:, :100].sum(), hits[40:, 200:].sum()
    assert right / left == pytest.approx(1.2, rel=0.3)


def test_without_any_seabed_in_view_there_is_nothing_to_take_for_a_target() -> None:
    labels = np.full((CAMERA.height, CAMERA.width), Label.WATER, np.uint8)
    depth = np.full(labels.shape, np.nan, np.float32)
    noise = replace(NOISE, false_targets=50.0)
    np.testing.assert_array_equal(with_false_targets(labels, depth, CAMERA, DOWN, noise, rng()), labels)


def test_a_sensor_without_errors_gives_the_truth() -> None:
    world = made("reef/string")
    frame, pose = view(world)
    found = sensed(world, frame, pose, SensorNoise(0.0, 0.0, 0.0, (0.1, 0.1)))
    for name in ("rgb", "depth", "labels", "ids"):
        np.testing.assert_array_equal(getattr(found, name), getattr(frame, name))


def test_the_truth_is_left_as_it_was() -> None:
    world = made("reef/string")
    frame, pose = view(world)
    before = {name: getattr(frame, name).tobytes() for name in ("rgb", "depth", "labels", "ids")}
    found = sensed(world, frame, pose, replace(NOISE, false_targets=20.0))
    assert found.depth.tobytes() != before["depth"]
    assert found.labels.tobytes() != before["labels"]
    assert found.rgb is frame.rgb
    found.depth[:], found.labels[:] = 0.0, 0
    assert before == {name: getattr(frame, name).tobytes() for name in before}


def test_the_same_generator_errs_alike_and_another_one_does_not() -> None:
    world = made("reef/string")
    frame, pose = view(world)
    noise = replace(NOISE, false_targets=5.0)
    first, again, other = (sensed(world, frame, pose, noise, seed) for seed in (0, 0, 1))
    for name in ("depth", "labels"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
        assert getattr(first, name).tobytes() != getattr(other, name).tobytes()


def test_randomness_follows_from_world_seed_start_and_step_and_from_nothing_else() -> None:
    world, start = made("reef/string"), SE2(1.5, -2.0, 0.0)
    missions = [
        (world, start, 0),
        (world, start, 1),
        (world, SE2(2.0, -2.0, 0.0), 0),
        (world, SE2(1.5, -2.0, 0.5), 0),
        (replace(world, seed=2), start, 0),
        (replace(world, name="reef/patch"), start, 0),
    ]
    drawn = [noise_generator(*mission).random(4).tolist() for mission in missions]
    assert drawn == [noise_generator(*mission).random(4).tolist() for mission in missions]
    assert len({tuple(numbers) for numbers in drawn}) == len(missions)


def test_what_is_drawn_is_the_same_for_ever() -> None:
    generator = noise_generator(made("reef/string"), SE2(1.5, -2.0, 0.0), 7)
    noisy = noisy_depth(np.full((2, 2), 10.0, np.float32), 0.002, generator)
    np.testing.assert_allclose(noisy, [[9.503148, 9.598018], [10.1041355, 10.287242]], atol=1e-5)
