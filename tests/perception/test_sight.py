"""What the network is told of a view, and what is made of its answers."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from dream.geometry import SE3, Camera, camera_mount
from dream.perception import Perception, Sight, View
from dream.perception.flat_floor import rays
from dream.perception.sight import (
    FARTHEST,
    GRID,
    HEIGHT,
    MOST_BYTES,
    SHIPPED,
    WIDTH,
    file_sha256,
    floor_along_axis,
    opened,
    planes,
    scaled,
)
from dream.sim.render import Renderer
from dream.sim.worlds import make_world
from dream.types import Label, UInt8Array
from tests.perception.models import constant, frozen_network

CAMERA = Camera.from_fov(WIDTH, HEIGHT, math.radians(90.0))
LEVEL, MOUNT = SE3.level(0.0, 0.0, -8.0, 0.3), camera_mount(math.radians(30.0))
VIEW = View(CAMERA, LEVEL, MOUNT, 2.0)
CARD = json.loads(SHIPPED.with_suffix(".json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def picture() -> tuple[UInt8Array, View]:
    """Of a reef in clear water, two metres above it."""
    world = make_world("reef/string", 3)
    target = world.targets.position[0]
    x, y = float(target[0]) - 3.0, float(target[1])
    z = float(world.terrain.height(x, y)) + 2.0
    view = View(CAMERA, SE3.level(x, y, z, 0.0), MOUNT, 2.0)
    return Renderer(world).render(CAMERA, view.T_world_camera).rgb, view


def test_the_card_tells_of_this_file() -> None:
    assert file_sha256(SHIPPED) == CARD["sha256"]
    assert SHIPPED.stat().st_size == CARD["bytes"] <= 3_000_000
    assert CARD["command"].startswith("dream train sight")


def test_the_middle_of_the_view_sinks_as_the_camera_looks_down() -> None:
    known = planes(VIEW)[0]
    assert known.shape == (3, HEIGHT, WIDTH)
    middle = known[:, HEIGHT // 2 - 1 : HEIGHT // 2 + 1, WIDTH // 2 - 1 : WIDTH // 2 + 1].mean((1, 2))
    depth = 2.0 / math.sin(math.radians(30.0))
    np.testing.assert_allclose(
        middle, [1.0 / (1.0 + 0.5 * depth) - 0.4, math.sin(math.radians(30.0)), 0.2], atol=2e-3
    )
    assert (known[1, 0] < 0.0).all()
    assert (floor_along_axis(rays(VIEW))[0] == FARTHEST).all()


def test_nothing_is_told_where_nothing_is_known() -> None:
    assert (planes(None) == 0.0).all()


def test_the_same_view_at_another_size_is_told_alike() -> None:
    fine = replace(VIEW, camera=CAMERA.scaled(2))
    np.testing.assert_allclose(planes(fine), planes(VIEW), atol=1e-6)


def test_a_picture_comes_in_at_the_size_of_the_input(picture: tuple[UInt8Array, View]) -> None:
    rgb = picture[0]
    assert scaled(rgb).shape == scaled(rgb[:100, :130]).shape == (1, 3, HEIGHT, WIDTH)
    np.testing.assert_allclose(scaled(rgb)[0].transpose(1, 2, 0) * 255.0, rgb, atol=1e-4)


def test_it_answers_a_picture_of_any_size(picture: tuple[UInt8Array, View]) -> None:
    rgb, view = picture
    sight = Sight()
    answer = sight.answer(rgb, view)
    assert answer.depth is not None
    assert answer.near is not None
    assert answer.shares.shape == (len(Label), HEIGHT, WIDTH)
    np.testing.assert_allclose(answer.shares.sum(axis=0), 1.0, atol=1e-5)
    assert answer.features.shape == (CARD["output"]["features"]["shape"][1], *GRID)
    small = sight.answer(np.ascontiguousarray(rgb[::2, ::2]))
    assert small.shares.shape == (len(Label), HEIGHT // 2, WIDTH // 2)
    assert small.depth is None


def test_what_it_knows_of_the_view_gives_the_scale(picture: tuple[UInt8Array, View]) -> None:
    """Twice as high above the floor, the same picture shows what is about twice as far away."""
    rgb, view = picture
    sight = Sight()
    near, far = sight.answer(rgb, view).depth, sight.answer(rgb, replace(view, altitude=4.0)).depth
    assert near is not None
    assert far is not None
    below = slice(3 * HEIGHT // 4, None)
    assert 1.5 < float(np.median(far[below] / near[below])) < 2.5


def test_water_has_no_depth_and_confidence_is_a_probability(picture: tuple[UInt8Array, View]) -> None:
    rgb, view = picture
    sight = Sight()
    labels, sure = sight.segment(rgb, view)
    depth, near = sight.estimate(rgb, labels, view)
    water = labels == Label.WATER
    assert np.isnan(depth[water]).all()
    assert (near[water] == 0.0).all()
    assert np.isfinite(depth[~water]).all()
    for confidence in (sure, near):
        assert confidence.dtype == np.float32
        assert confidence.min() >= 0.0
        assert confidence.max() <= 1.0


def test_it_sees_a_reef_and_how_far_it_is(picture: tuple[UInt8Array, View]) -> None:
    """About as well as its card says: of a simulator that it learned from, in a world that it did not."""
    rgb, view = picture
    world = make_world("reef/string", 3)
    truth = Renderer(world).measure(CAMERA, view.T_world_camera)
    sight = Sight()
    shows = Perception(sight, sight).perceive(rgb, view)
    near = np.nan_to_num(truth.depth, nan=np.inf) < 5.0
    target = (shows.labels == Label.TARGET) & near
    true = (truth.labels == Label.TARGET) & near
    card = CARD["marks"]["target_iou_within_6_m"]
    assert (target & true).sum() / (target | true).sum() > 0.5 * card
    both = near & np.isfinite(shows.depth)
    assert both.sum() > 0.9 * near.sum()
    assert float(np.median(np.abs(shows.depth[both] / truth.depth[both] - 1.0))) < 0.08


def test_a_network_that_answers_the_same_for_every_picture_is_not_believed(tmp_path: Path) -> None:
    frozen = frozen_network(tmp_path / "frozen.onnx")
    sight = Sight(frozen)
    rng = np.random.default_rng(0)
    sure = []
    for _ in range(5):
        rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
        labels, confidence = sight.segment(rgb, VIEW)
        sure.append(float(confidence.max()))
        depth, near = sight.estimate(rgb, labels, VIEW)
    assert sure[0] > 0.5
    assert sure[-1] == 0.0
    assert np.isnan(depth).all()
    assert (near == 0.0).all()


def test_another_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected"):
        opened(constant(tmp_path / "other.onnx", np.zeros((1, 4, 8, 8), np.float32)))


def test_a_file_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.onnx"
    with path.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(ValueError, match="at most"):
        opened(path)
