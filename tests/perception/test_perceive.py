"""Labels and depth together."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dream.geometry import SE3, Camera, camera_mount
from dream.perception import FlatFloor, Perception, View
from dream.perception.depth import averaged
from dream.types import Float32Array, Label, UInt8Array

CAMERA = Camera.from_fov(8, 6, math.radians(90.0))
LEVEL, MOUNT = SE3.level(0.0, 0.0, 0.0, 0.0), camera_mount(math.radians(20.0))
SMALL_VIEW = View(CAMERA, LEVEL, MOUNT, 2.0)


class Bright:
    """Calls bright pixels target."""

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        labels = np.where(rgb.mean(axis=2) > 100.0, Label.TARGET, Label.SEABED).astype(np.uint8)
        return labels, np.full(labels.shape, 0.8, np.float32)


def test_confidence_is_the_lesser_of_the_two() -> None:
    perception = Perception(Bright(), FlatFloor())
    shows = perception.perceive(np.zeros((6, 8, 3), np.uint8), SMALL_VIEW)
    depth, labels, confidence = shows.depth, shows.labels, shows.confidence
    assert depth.shape == labels.shape == confidence.shape == (6, 8)
    assert depth.dtype == confidence.dtype == np.float32
    assert confidence.max() <= np.float32(0.8)
    assert (confidence[np.isnan(depth)] == 0.0).all()
    assert np.isnan(depth).any()


LARGE_VIEW = View(Camera.from_fov(32, 24, math.radians(90.0)), LEVEL, MOUNT, 2.0)


class Far:
    """The flat floor, so many times as far; and how sure of it."""

    def __init__(self, times: float, sure: float) -> None:
        self.times, self.sure = times, sure

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        floor, _ = FlatFloor().estimate(rgb, labels, view)
        return self.times * floor, np.where(np.isnan(floor), 0.0, self.sure).astype(np.float32)


def test_how_far_a_depth_errs_is_what_its_confidence_says() -> None:
    """Of a Laplace distribution with that mean error, so large a share lies within a tenth."""
    rng = np.random.default_rng(4)
    for sure in (0.2, 0.6, 0.95):
        shows = Perception(Bright(), Far(1.0, sure)).perceive(np.zeros((24, 32, 3), np.uint8), LARGE_VIEW)
        known = np.isfinite(shows.depth)
        assert (np.isnan(shows.error) == ~known).all()
        mean = float(shows.error[known][0])
        drawn = np.abs(rng.laplace(0.0, mean, 20_000))
        assert (drawn <= math.log(1.1)).mean() == pytest.approx(sure, abs=0.01)
    sure_of_all = Perception(Bright(), Far(1.0, 1.0)).perceive(np.zeros((24, 32, 3), np.uint8), LARGE_VIEW)
    assert np.nanmax(sure_of_all.error) == 0.0


def test_water_is_as_sure_as_its_label() -> None:
    class Blue:
        def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
            return np.zeros(rgb.shape[:2], np.uint8), np.full(rgb.shape[:2], 0.7, np.float32)

    shows = Perception(Blue(), FlatFloor()).perceive(np.zeros((24, 32, 3), np.uint8), LARGE_VIEW)
    assert (shows.confidence == np.float32(0.7)).all()
    assert np.isnan(shows.depth).all()


@pytest.mark.parametrize("times", [3.0, 0.3, 1.3])
def test_depth_of_which_nobody_is_sure_is_none_and_it_is_said_how_far_off_it_is(times: float) -> None:
    black = np.zeros((24, 32, 3), np.uint8)
    shows = Perception(Bright(), Far(times, 0.0)).perceive(black, LARGE_VIEW)
    assert np.isnan(shows.depth).all()
    assert (shows.confidence == 0.0).all()
    assert shows.account.beside_floor == pytest.approx(times)
    assert shows.account.agreement == 0.0
    assert shows.account.no_depth == 24 * 32
    assert f"depth: {times:.1f} times as far as the floor" in shows.account.doubt
    unsure = Perception(Bright(), Far(times, 0.2)).perceive(black, LARGE_VIEW)
    assert np.isfinite(unsure.depth).any()
    assert unsure.account.confidence == pytest.approx(0.2)


def test_what_the_lens_did_not_see_counts_for_nothing() -> None:
    seen = np.zeros((24, 32), np.bool_)
    seen[12:] = True
    black = np.zeros((24, 32, 3), np.uint8)
    shows = Perception(Bright(), FlatFloor()).perceive(black, LARGE_VIEW, seen)
    assert np.isnan(shows.depth[:12]).all()
    assert np.isfinite(shows.depth[12:]).all()
    assert shows.account.shares == (0.0, 1.0, 0.0, 0.0)
    assert shows.account.beside_floor == pytest.approx(1.0)
    assert (shows.account.lost, shows.account.no_depth, shows.account.doubt) == (0, 0, "")


def test_an_account_goes_into_json() -> None:
    tiny = Perception(Bright(), FlatFloor()).perceive(np.zeros((6, 8, 3), np.uint8), SMALL_VIEW)
    said = json.loads(json.dumps(tiny.account.said(), allow_nan=False))
    # Too few pixels show the floor.
    assert said["depth_beside_floor"] is None
    assert said["label_shares"] == {"water": 0.0, "seabed": 1.0, "target": 0.0, "obstacle": 0.0}


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
        Perception(Bright(), FlatFloor()).perceive(rgb, SMALL_VIEW)
