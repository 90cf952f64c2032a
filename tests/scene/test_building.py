from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.scene import NEVER, HeightGrid, RunScene, Targets, building, made, mapped, parts
from dream.scene.parts import MOST_VOXELS
from tests.scene.orbits import orbited

Array = npt.NDArray[Any]

BOX = [[0.0, 0.0, -10.0], [10.0, 10.0, 0.0]]
ABOUT: dict[str, Any] = {"title": "a box", "bounds": BOX, "water": 0.0, "field_of_view": (1.4, 1.1)}


def ball(rings: int, at: tuple[float, float, float]) -> Array:
    """(T, 3, 3) triangles of a ball of radius 1."""
    across, down = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * rings + 1), np.linspace(0, np.pi, rings + 1))
    points = np.stack([np.sin(down) * np.cos(across), np.sin(down) * np.sin(across), np.cos(down)], -1) + at
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.concatenate(
        [np.stack([a, b, c], -2).reshape(-1, 3, 3), np.stack([a, c, d], -2).reshape(-1, 3, 3)]
    )


def area(triangles: Array) -> float:
    edges = triangles[:, 1:] - triangles[:, :1]
    return float(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())


def targets(triangles: Array, owner: Array, count: int) -> Targets:
    nothing = np.full(count, -1)
    return Targets(triangles, owner, ("ball",), np.zeros(count, int), nothing, nothing)


def test_corners_are_shared_within_an_individual_and_not_between_two() -> None:
    one = ball(8, (2.0, 2.0, -5.0))
    scene = made(**ABOUT, targets=targets(np.concatenate([one, one]), np.repeat([0, 1], len(one)), 2))
    surface = scene.targets
    assert np.bincount(surface.owner).tolist() == [7 * 16 + 2] * 2
    assert np.bincount(surface.face_owner).tolist() == [2 * 16 * 7] * 2  # the poles' triangles have no area
    assert area(surface.triangles) == pytest.approx(2 * area(one), rel=1e-5)


def test_triangles_keep_their_side() -> None:
    one = ball(8, (2.0, 2.0, -5.0))
    corners = made(**ABOUT, obstacles=one).obstacles.triangles.astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = corners.mean(axis=1) - (2.0, 2.0, -5.0)
    given = np.cross(one[:, 1] - one[:, 0], one[:, 2] - one[:, 0])
    sign = np.sign((given * (one.mean(axis=1) - (2.0, 2.0, -5.0))).sum())
    assert (np.sign((normals * outwards).sum(axis=1)) == sign).all()


def test_too_fine_a_surface_is_thinned_and_keeps_its_place_and_most_of_its_area(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(building, "AIM_FACES", 2000)
    monkeypatch.setattr(parts, "MOST_FACES", 2000)
    one = ball(60, (2.0, 2.0, -5.0))
    surface = made(**ABOUT, obstacles=one).obstacles
    assert 200 < len(surface.faces) <= 2000
    assert area(surface.triangles) == pytest.approx(area(one), rel=0.05)
    away = np.linalg.norm(surface.positions - np.array([2.0, 2.0, -5.0]), axis=1)
    assert (np.abs(away - 1.0) < 0.05).all()


@pytest.mark.rare
def test_no_individual_of_a_reef_vanishes_when_it_is_thinned() -> None:
    reef = orbited("reef/mixed", 1, steps=3)
    assert len(reef.targets.faces) <= building.AIM_FACES
    assert np.unique(reef.targets.face_owner).size == len(reef.kind)


def test_the_seabed_is_shown_around_the_bounds_and_no_finer_than_can_be_held() -> None:
    x, y = np.meshgrid(np.arange(400), np.arange(300))
    grid = HeightGrid(-10.0 + 0.01 * x + 0.02 * y, -20.0, -15.0, 0.1)
    seabed = made(**ABOUT, seabed=grid).seabed
    low, high = seabed.positions.min(axis=0), seabed.positions.max(axis=0)
    np.testing.assert_allclose(low[:2], (-2.0, -2.0), atol=1e-5)
    np.testing.assert_allclose(high[:2], (12.0, 12.0), atol=0.1)
    x, y, z = seabed.positions.T
    np.testing.assert_allclose(z, -10.0 + 0.1 * (x + 20.0) + 0.2 * (y + 15.0), atol=1e-4)
    corners = seabed.triangles
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0).all()
    wide = made(**{**ABOUT, "bounds": [[-20, -15, -10], [20, 15, 0]]}, seabed=grid).seabed
    assert len(wide.positions) <= (building.MOST_POSTS + 1) ** 2


def test_of_too_many_voxels_eight_are_made_one() -> None:
    side = 70
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    assert len(cells) > MOST_VOXELS
    target = cells[:, 0] < 30
    inspected = np.where(target & (cells[:, 1] < 20), 7, -1)
    voxels = mapped(0.25, (cells + 0.5) * 0.25, target, cells[:, 2], inspected)
    assert voxels.size == 0.5
    assert len(voxels.positions) == (side // 2) ** 3
    column, row, level = np.rint((voxels.positions - 0.25) / 0.5).astype(int).T
    np.testing.assert_array_equal(voxels.target, column < 15)
    np.testing.assert_array_equal(voxels.seen_at, 2 * level)
    np.testing.assert_array_equal(
        voxels.inspected_at[voxels.target], np.where(row < 10, 7, NEVER)[voxels.target]
    )


def test_a_coarse_voxel_is_inspected_when_the_last_target_in_it_is() -> None:
    at = np.zeros(3, np.intp)
    found = building._greatest(at, np.array([3, NEVER, 5], np.uint16), 1)
    assert found.tolist() == [NEVER]


def test_a_step_below_zero_is_never() -> None:
    assert building.steps(np.array([-1, 0, 7])).tolist() == [NEVER, 0, 7]
    with pytest.raises(ValueError, match="below 65535"):
        building.steps(np.array([NEVER]))


def test_a_scene_may_be_empty() -> None:
    scene = made(**ABOUT)
    assert isinstance(scene, RunScene)
    assert [len(part) for part in (scene.targets.faces, scene.voxels.positions, scene.path.step)] == [0] * 3
