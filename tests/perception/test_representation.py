"""What a policy is shown of a frame, against scenes made by hand and a slow twin."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.perception.representation import HEIGHT, WIDTH, represent
from dream.protocol import DREAM_V1, POOL_V1
from dream.types import Float32Array, Label, UInt8Array

SHAPE = (240, 320)


def scene(depth: float = 4.0) -> tuple[Float32Array, UInt8Array]:
    """Bare seabed, everywhere as far away."""
    return np.full(SHAPE, depth, np.float32), np.full(SHAPE, Label.SEABED, np.uint8)


def slowly(depth: Float32Array, labels: UInt8Array, altitude: float) -> npt.NDArray[np.float64]:
    """The same, pixel by pixel: every pixel is cut into as many parts as there are blocks along it."""
    fine_depth = depth.repeat(HEIGHT, axis=0).repeat(WIDTH, axis=1)
    fine_labels = labels.repeat(HEIGHT, axis=0).repeat(WIDTH, axis=1)
    rows, cols = depth.shape
    shown = np.zeros((2, HEIGHT, WIDTH))
    for i in range(HEIGHT):
        for j in range(WIDTH):
            block = np.s_[i * rows : (i + 1) * rows, j * cols : (j + 1) * cols]
            z, kind = fine_depth[block], fine_labels[block]
            seen = z[~np.isnan(z) & (kind != Label.WATER)].astype(np.float64)
            if seen.size:
                shown[0, i, j] = np.minimum(0.25 * altitude / seen, 1.0).mean()
            shown[1, i, j] = (kind == Label.TARGET).mean()
    return 255.0 * shown


def test_a_wall_at_four_metres_is_an_eighth_near() -> None:
    near, target = represent(*scene(4.0))
    assert (near == round(255 / 8)).all()
    assert not target.any()


def test_nothing_is_nearer_than_half_a_metre() -> None:
    assert (represent(*scene(0.5))[0] == 255).all()
    assert (represent(*scene(0.1))[0] == 255).all()
    assert (represent(*scene(1.0))[0] == round(255 / 2)).all()


def test_water_and_no_return_are_far() -> None:
    depth, labels = scene(1.0)
    depth[:120] = np.nan
    labels[120:180] = Label.WATER
    near, _ = represent(depth, labels)
    assert not near[:54].any()
    assert (near[54:] == round(255 / 2)).all()


def test_the_rim_of_a_boulder_before_open_water_is_as_near_as_the_boulder() -> None:
    depth, labels = scene(1.0)
    depth[:, 101:] = np.nan  # Within the block of columns 100 to 103.33.
    assert (represent(depth, labels)[0][:, :31] == round(255 / 2)).all()
    assert not represent(depth, labels)[0][:, 31:].any()


def test_target_is_the_share_of_a_block() -> None:
    depth, labels = scene()
    labels[:, 100:102] = Label.TARGET
    _, target = represent(depth, labels)
    assert (target[:, 30] == round(255 * 2 / (320 / 96))).all()
    assert not np.delete(target, 30, axis=1).any()


def test_target_pixels_count_where_there_is_no_return_too() -> None:
    depth, labels = scene(np.nan)
    labels[:] = Label.TARGET
    near, target = represent(depth, labels)
    assert not near.any()
    assert (target == 255).all()


@settings(max_examples=5, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from([(24, 32), (60, 80), (7, 5)]),
    altitude=st.floats(0.3, 3.0),
)
def test_it_is_the_mean_over_the_area_of_each_block(
    seed: int, shape: tuple[int, int], altitude: float
) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.2, 20.0, shape).astype(np.float32)
    depth[rng.random(shape) < 0.3] = np.nan
    labels = rng.integers(0, 4, shape).astype(np.uint8)
    expected = slowly(depth, labels, altitude)
    np.testing.assert_allclose(represent(depth, labels, altitude=altitude), expected, atol=0.501)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_mirrored_frame_is_mirrored(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.choice([0.4, 1.0, 3.0, 9.0, np.nan], SHAPE).astype(np.float32)
    labels = rng.integers(0, 4, SHAPE).astype(np.uint8)
    mirrored = represent(depth[:, ::-1], labels[:, ::-1])[:, :, ::-1].astype(int)
    there = represent(depth, labels).astype(int)
    np.testing.assert_array_equal(mirrored[1], there[1])
    # Sums of nearness are rounded in another order.
    assert np.abs(mirrored[0] - there[0]).max() <= 1


def test_a_floor_looks_the_same_from_the_tank_s_height_as_from_the_reef_s() -> None:
    shown = []
    for protocol in (DREAM_V1, POOL_V1):
        depth = np.full(SHAPE, np.nan, np.float32)
        rows = (np.arange(240) + 0.5 - protocol.camera.cy) / protocol.camera.fy
        down = np.sin(protocol.camera_pitch) + rows * np.cos(protocol.camera_pitch)
        depth[down > 0.0] = (protocol.altitude / down[down > 0.0])[:, None]
        labels = np.where(np.isnan(depth), np.uint8(Label.WATER), np.uint8(Label.SEABED))
        shown.append(represent(depth, labels, altitude=protocol.altitude))
    np.testing.assert_array_equal(shown[0], shown[1])


def test_what_is_given_is_not_changed_and_what_comes_is_a_copy() -> None:
    depth, labels = scene()
    kept = depth.copy(), labels.copy()
    represent(depth, labels)[:] = 7
    np.testing.assert_array_equal(depth, kept[0])
    np.testing.assert_array_equal(labels, kept[1])
    assert not (represent(depth, labels) == 7).all()


def test_images_that_do_not_belong_together_are_refused() -> None:
    depth, labels = scene()
    with pytest.raises(ValueError, match=r"labels: expected the shape of depth"):
        represent(depth, labels.T)
    with pytest.raises(ValueError, match=r"altitude: expected metres above 0, got -1"):
        represent(depth, labels, altitude=-1.0)
