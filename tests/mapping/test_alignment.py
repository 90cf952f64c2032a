"""Alignment: laws on scenes with a formula, and a slow twin of the kernel."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from dream.geometry import SE2, SE3
from dream.mapping._kernels import alignment as kernels
from dream.mapping.alignment import (
    HEIGHT,
    PART,
    TARGET,
    Alignment,
    Float64Array,
    Matching,
    ground_points,
    moved,
)
from dream.protocol import DREAM_V1
from tests.mapping.analytic import CAMERA, SEABED, Disc, Pillar, camera_at, render

MATCHING = Matching()
SCATTERED = [
    Disc(x, y, r)
    for x, y, r in [
        (2.3, 0.4, 0.3),
        (3.1, -1.2, 0.25),
        (4.0, 1.7, 0.4),
        (4.9, -0.3, 0.2),
        (5.6, 2.6, 0.35),
        (5.2, -2.9, 0.3),
        (6.7, 0.9, 0.3),
    ]
]
BOULDERS = [
    Pillar(3.4, 1.1, 0.5, 0.7),
    Pillar(4.6, -1.6, 0.4, 0.9),
    Pillar(6.0, 0.6, 0.6, 0.5),
]


def seen_from(x: float, y: float, yaw: float, *things: Disc | Pillar) -> Float64Array:
    T_world_camera = camera_at(x, y, yaw)
    return ground_points(*render(T_world_camera, *things), CAMERA, T_world_camera, DREAM_V1)


def matched(error: SE2, *things: Disc | Pillar, matching: Matching = MATCHING) -> Alignment | None:
    """What a frame from the origin, taken for one that is `error` away, says to frames from around it."""
    others = [seen_from(x, y, yaw, *things) for x, y, yaw in [(-0.5, 0.6, 0.05), (0.4, -0.7, -0.1)]]
    frame = moved(seen_from(0.0, 0.0, 0.0, *things), (0.0, 0.0), error)
    return matching.align(frame, (error.x, error.y), np.concatenate(others))


@pytest.mark.parametrize(
    ("things", "matching"),
    [(SCATTERED, MATCHING), (BOULDERS, Matching(height_scale=0.5))],
    ids=["target", "relief"],
)
@pytest.mark.parametrize(
    "error",
    [SE2(0.0, 0.0, 0.0), SE2(0.2, -0.1, 0.0), SE2(-0.31, 0.17, 0.03), SE2(0.05, 0.4, -0.035)],
    ids=str,
)
def test_an_error_of_the_pose_is_answered_by_its_opposite(
    error: SE2, things: list[Disc | Pillar], matching: Matching
) -> None:
    found = matched(error, *things, matching=matching)
    assert found is not None
    assert math.hypot(found.offset.x + error.x, found.offset.y + error.y) < 0.06
    assert abs(found.offset.yaw + error.yaw) < math.radians(1.0)
    assert found.overlap > MATCHING.min_overlap
    assert np.linalg.eigvalsh(found.information)[0] > 0.0


def test_the_answer_turns_with_the_scene() -> None:
    error, turn = SE2(0.2, -0.1, 0.02), SE2(3.0, -5.0, 2.0)
    frame = moved(seen_from(0.0, 0.0, 0.0, *SCATTERED), (0.0, 0.0), error)
    others = seen_from(-0.5, 0.6, 0.05, *SCATTERED)
    found = MATCHING.align(frame, (error.x, error.y), others)
    c, s = math.cos(turn.yaw), math.sin(turn.yaw)
    pivot = (turn.x + c * error.x - s * error.y, turn.y + s * error.x + c * error.y)
    turned = MATCHING.align(moved(frame, (0.0, 0.0), turn), pivot, moved(others, (0.0, 0.0), turn))
    assert found is not None
    assert turned is not None
    # The grids are not turned with it.
    assert turned.offset.x == pytest.approx(c * found.offset.x - s * found.offset.y, abs=0.03)
    assert turned.offset.y == pytest.approx(s * found.offset.x + c * found.offset.y, abs=0.03)
    assert turned.offset.yaw == pytest.approx(found.offset.yaw, abs=math.radians(0.5))


def test_without_structure_nothing_is_said() -> None:
    assert matched(SE2(0.1, 0.1, 0.0)) is None


def test_without_common_ground_nothing_is_said() -> None:
    frame = seen_from(0.0, 0.0, 0.0, *SCATTERED)
    assert MATCHING.align(frame, (0.0, 0.0), seen_from(0.0, 0.0, math.pi, *SCATTERED)) is None
    assert MATCHING.align(frame, (0.0, 0.0), np.empty((0, 4))) is None


def test_beyond_the_window_nothing_is_said() -> None:
    assert matched(SE2(0.0, 0.9, 0.0), *SCATTERED, matching=Matching(window=0.4)) is None


@pytest.mark.parametrize("along", [-0.2, 0.0, 0.3])
def test_a_straight_edge_corrects_only_across(along: float) -> None:
    found = matched(SE2(0.2, along, 0.0), Disc(504.0, 0.0, 500.0))
    assert found is not None
    assert found.offset.x == pytest.approx(-0.2, abs=0.04)
    across, beside = found.information[0, 0], found.information[1, 1]
    assert across > 1.0 / 0.1**2
    assert beside < 0.02 * across


def test_a_pattern_that_repeats_within_the_window_does_not_correct_along_it() -> None:
    bars = [Disc(x, y, 0.14) for x, y in itertools.product((3.0, 4.0, 5.2), np.arange(-6.0, 6.0, 0.6))]
    found = matched(SE2(0.15, 0.3, 0.0), *bars)
    assert found is not None
    assert found.offset.x == pytest.approx(-0.15, abs=0.05)
    assert found.information[1, 1] < 0.05 * found.information[0, 0]


def test_a_greater_mismatch_makes_it_less_sure() -> None:
    rng = np.random.default_rng(0)
    others = seen_from(0.4, -0.7, -0.1, *SCATTERED)
    frame = seen_from(0.0, 0.0, 0.0, *SCATTERED)
    clear = MATCHING.align(frame, (0.0, 0.0), others)
    wrong = rng.random(len(frame)) < 0.1
    frame[wrong, TARGET] = 1.0 - frame[wrong, TARGET]
    noisy = MATCHING.align(frame, (0.0, 0.0), others)
    assert clear is not None
    assert noisy is not None
    assert noisy.mismatch > clear.mismatch
    assert (np.diag(noisy.information) < 0.5 * np.diag(clear.information)).all()


def test_ground_points_measure_the_ground() -> None:
    points = seen_from(1.0, 2.0, 0.5, Disc(1.0 + 3.0 * math.cos(0.5), 2.0 + 3.0 * math.sin(0.5), 0.8))
    np.testing.assert_allclose(points[:, HEIGHT], SEABED, atol=1e-4)
    assert points[:, TARGET].sum() * PART**2 == pytest.approx(math.pi * 0.8**2, rel=0.1)
    assert np.hypot(points[:, 0] - 1.0, points[:, 1] - 2.0).max() <= DREAM_V1.reach


def test_ground_points_of_a_tilted_camera_lie_on_the_ground_all_the_same() -> None:
    c, s = math.cos(0.1), math.sin(0.1)
    roll = SE3(np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]), np.zeros(3))
    T_world_camera = SE3.level(0.0, 0.0, SEABED + 2.0, 0.3) @ roll @ DREAM_V1.T_base_camera
    points = ground_points(*render(T_world_camera, *SCATTERED), CAMERA, T_world_camera, DREAM_V1)
    np.testing.assert_allclose(points[:, HEIGHT], SEABED, atol=1e-4)


def test_a_depth_of_exactly_the_greatest_is_no_ground() -> None:
    protocol, pose = replace(DREAM_V1, max_depth=4.1), camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose)
    near = depth < 3.5
    padded, missing = (
        ground_points(np.where(near, depth, np.float32(z)), labels, CAMERA, pose, protocol)
        for z in (4.1, np.nan)
    )
    assert len(missing)
    np.testing.assert_array_equal(padded, missing)


def test_images_that_do_not_fit_the_camera_are_refused() -> None:
    depth, labels = render(camera_at(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"labels: expected \(240, 320\)"):
        ground_points(depth, labels[:-1], CAMERA, camera_at(0.0, 0.0, 0.0), DREAM_V1)


def test_a_window_has_a_size() -> None:
    with pytest.raises(ValueError, match="window: expected a number above 0, got 0"):
        Matching(window=0.0)


def test_the_kernel_agrees_with_its_slow_twin() -> None:
    rng = np.random.default_rng(3)
    points, said = rng.uniform(-6.0, 6.0, (60, 2)), rng.random((60, 2))
    known = (rng.random((2, 9, 11)) < 0.7).astype(np.float64)
    value = rng.random(known.shape)
    offsets = rng.uniform(-1.0, 1.0, (7, 3))
    means, weights = kernels.mismatch(points, said, known, known * value, (5.0, 4.0), offsets)
    for k, (east, north, turn) in enumerate(offsets):
        total, weight = 0.0, 0.0
        for (x, y), says in zip(points, said, strict=True):
            col = 5.0 + east + math.cos(turn) * x - math.sin(turn) * y - 0.5
            row = 4.0 + north + math.sin(turn) * x + math.cos(turn) * y - 0.5
            corners = list(
                itertools.product(
                    (math.floor(row), math.floor(row) + 1), (math.floor(col), math.floor(col) + 1)
                )
            )
            if not all(0 <= i < 9 and 0 <= j < 11 for i, j in corners):
                continue
            for channel in range(2):
                shares = [
                    (1.0 - abs(row - i)) * (1.0 - abs(col - j)) * known[channel, i, j] for i, j in corners
                ]
                if sum(shares) > 0.0:
                    values = [value[channel, i, j] for i, j in corners]
                    total += sum(shares) * (says[channel] - np.average(values, weights=shares)) ** 2
                    weight += sum(shares)
        assert weights[k] == pytest.approx(weight)
        assert means[k] == pytest.approx(total / weight)


def test_where_nothing_is_known_nothing_counts() -> None:
    known = np.zeros((2, 5, 5))
    means, weights = kernels.mismatch(
        np.zeros((1, 2)), np.ones((1, 2)), known, known, (2.5, 2.5), np.zeros((1, 3))
    )
    assert (means[0], weights[0]) == (0.0, 0.0)


def test_a_frame_has_its_ground_in_common_with_itself_and_no_more() -> None:
    frame = seen_from(0.0, 0.0, 0.0, *SCATTERED)
    found = MATCHING.align(frame, (0.0, 0.0), frame)
    assert found is not None
    area = len(frame) * PART**2
    # Far off the points lie apart, and cells between them are not known.
    assert 0.8 * area < found.overlap <= area
