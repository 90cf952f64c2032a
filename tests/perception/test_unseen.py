"""The pictures and marks that perf/sight.py goes by."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from dream.types import Label

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where `unseen` lies; made-up shapes only."""
    monkeypatch.syspath_prepend(str(ROOT / "perf"))
    monkeypatch.delenv("DREAM_REAL_DATA", raising=False)


def test_marks_are_those_on_paper() -> None:
    import unseen.marks as marks

    truth = np.array([[0, 1, 1, 2], [3, 3, 2, 2]], np.uint8)
    said = np.array([[0, 1, 2, 2], [3, 3, 2, 1]], np.uint8)
    depth = np.full(truth.shape, 2.0, np.float32)
    told = marks.Told(
        said, np.full(truth.shape, 0.75, np.float32), depth * np.float32(1.2), np.zeros_like(depth)
    )
    tally = marks.Tally()
    everything = np.ones(truth.shape, np.bool_)
    tally.add_labels(truth, told, everything, everything)
    tally.add_depth(depth, told, everything)
    found = marks.figures([tally, tally, tally])
    assert found["target IoU"].value == pytest.approx(0.5)
    assert found["obstacle IoU"].value == pytest.approx(1.0)
    assert found["mean IoU"].value == pytest.approx((1.0 + 1.0 / 3.0 + 0.5 + 1.0) / 4.0)
    assert found["depth within 8 m: AbsRel"].value == pytest.approx(0.2, abs=1e-6)
    assert found["depth within 8 m: delta1"].value == 1.0
    # Six of eight labels are right, and each is believed to three quarters; no depth is right to a tenth.
    assert found["label confidence: expected error"].value == pytest.approx(0.0)
    assert found["depth confidence: greatest gap"].value == 0.0
    assert found["mean IoU"].low == pytest.approx(found["mean IoU"].high)


def test_what_is_not_there_has_no_overlap() -> None:
    import unseen.marks as marks

    confusion = np.array([[4.0, 0.0], [0.0, 0.0]])
    assert math.isnan(marks.overlap(confusion, 1))
    assert marks.mean_overlap(confusion) == 1.0


def test_textures_repeat_and_are_the_same_for_the_same_seed() -> None:
    from unseen import textures

    for kind in (textures.photographic, textures.ripples, textures.cells):
        tile = kind(np.random.default_rng(3))
        u, v = np.random.default_rng(0).random((2, 50)).astype(np.float32)
        fine = np.zeros(50, np.float32)
        np.testing.assert_allclose(tile.at(u + 2.0, v - 1.0, fine), tile.at(u, v, fine), atol=1e-3)
        np.testing.assert_array_equal(tile.levels[0], kind(np.random.default_rng(3)).levels[0])
        assert float(tile.levels[0].std()) == pytest.approx(1.0, abs=1e-3)


def test_a_view_over_a_plane_is_told_from_its_depth() -> None:
    from dream.geometry import SE3, Camera, camera_mount
    from dream.perception import View
    from dream.perception.flat_floor import rays
    from dream.perception.sight import floor_along_axis
    from unseen import real

    camera = Camera.from_fov(64, 48, 1.0)
    view = View(camera, SE3.level(0.0, 0.0, 0.0, 0.0), camera_mount(math.radians(40.0)), 1.7)
    found = real.view_over(floor_along_axis(rays(view)), camera)
    assert found is not None
    assert found.altitude == pytest.approx(1.7, abs=0.01)
    np.testing.assert_allclose(found.T_world_camera.rotation, view.T_world_camera.rotation, atol=0.01)


@pytest.mark.slow
def test_a_picture_is_true_of_itself() -> None:
    pytest.importorskip("embreex")
    from unseen import pictures

    (picture,) = pictures(4, 1, 1)
    assert picture.rgb.shape == (240, 320, 3)
    assert picture.rgb.dtype == picture.labels.dtype == np.uint8
    solid = picture.labels != Label.WATER
    assert solid.any()
    assert np.isfinite(picture.depth[solid]).all()
    assert float(picture.depth[solid].min()) > 0.1
    assert (picture.straight >= picture.depth)[solid].all()
    assert 0.0 < picture.label_range <= 20.0
    assert 0.3 < picture.view.altitude < 10.0
