"""Labels and depth together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.geometry import SE3, Camera, camera_mount
from dream.perception import FlatFloor, Perception
from dream.perception.depth import averaged
from dream.types import Float32Array, Label, UInt8Array

CAMERA = Camera.from_fov(8, 6, math.radians(90.0))
LEVEL, MOUNT = SE3.level(0.0, 0.0, 0.0, 0.0), camera_mount(math.radians(20.0))


class Bright:
    """Calls bright pixels target."""

    def segment(self, rgb: UInt8Array) -> tuple[UInt8Array, Float32Array]:
        labels = np.where(rgb.mean(axis=2) > 100.0, Label.TARGET, Label.SEABED).astype(np.uint8)
        return labels, np.full(labels.shape, 0.8, np.float32)


def test_confidence_is_the_lesser_of_the_two() -> None:
    perception = Perception(Bright(), FlatFloor())
    depth, labels, confidence = perception.perceive(np.zeros((6, 8, 3), np.uint8), CAMERA, LEVEL, MOUNT, 2.0)
    assert depth.shape == labels.shape == confidence.shape == (6, 8)
    assert depth.dtype == confidence.dtype == np.float32
    assert confidence.max() <= np.float32(0.8)
    assert (confidence[np.isnan(depth)] == 0.0).all()
    assert np.isnan(depth).any()


def test_a_finer_picture_is_averaged_over_the_cameras_pixels() -> None:
    fine = np.zeros((18, 24, 3), np.uint8)
    fine[3:6, 6:9] = 90
    fine[3, 6] = 255
    coarse = averaged(fine, CAMERA)
    assert coarse.shape == (6, 8, 3)
    assert coarse[1, 2, 0] == round((8 * 90 + 255) / 9)
    assert coarse.sum() == 3 * int(coarse[1, 2, 0])


@pytest.mark.parametrize(
    "rgb",
    [
        np.zeros((8, 6, 3), np.uint8),
        np.zeros((6, 8, 3)),
        np.zeros((6, 8), np.uint8),
        np.zeros((13, 16, 3), np.uint8),
    ],
)
def test_a_picture_that_does_not_fit_is_refused(rgb: np.ndarray) -> None:
    with pytest.raises(ValueError, match="rgb: expected"):
        Perception(Bright(), FlatFloor()).perceive(rgb, CAMERA, LEVEL, MOUNT, 2.0)
