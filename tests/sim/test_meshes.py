from __future__ import annotations

import numpy as np
import pytest

from dream.geometry import Bounds
from dream.sim.meshes import boulder, clump, icosphere, post, ring_wall, shell
from dream.sim.terrain import Noise, smoothstep, undulation
from dream.sim.world import Mesh

rng = np.random.default_rng(4)
SHAPES = {
    "shell": shell(rng),
    "clump": clump(rng),
    "boulder": boulder(rng),
    "cobble": boulder(rng, planes=40, subdivisions=2),
    "post": post(0.055, 1.2, 16, (200, 200, 200)),
    "wall": ring_wall(1.8, 0.05, 1.5, 48, (10, 20, 30)),
}


def volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.faces], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_are_closed_and_face_outwards(name: str) -> None:
    mesh = SHAPES[name]
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).tolist()
    directed = {tuple(edge) for edge in edges}
    assert len(directed) == len(edges)
    assert all((b, a) in directed for a, b in directed)
    assert volume(mesh) > 0.0


def test_the_volume_of_a_post_and_a_wall_is_known_on_paper() -> None:
    sides = 16
    area = 0.5 * sides * 0.055**2 * np.sin(2.0 * np.pi / sides)
    assert volume(SHAPES["post"]) == pytest.approx(1.2 * area, rel=0.03)
    ring = 0.5 * 48 * np.sin(2.0 * np.pi / 48) * (1.85**2 - 1.8**2)
    assert volume(SHAPES["wall"]) == pytest.approx(1.5 * ring, rel=0.02)


def test_a_clump_is_one_metre_across_and_stands_on_the_ground() -> None:
    vertices = SHAPES["clump"].vertices
    assert np.sqrt((vertices[:, :2] ** 2).sum(axis=1)).max() == pytest.approx(0.5, abs=0.002)
    assert vertices[:, 2].max() == pytest.approx(0.48, abs=0.002)
    assert vertices[:, 2].min() > -0.4


def test_an_icosphere_is_a_sphere_of_equal_triangles() -> None:
    vertices, faces = icosphere(2)
    assert len(faces) == 320
    assert len(vertices) == 162
    assert np.allclose((vertices**2).sum(axis=1), 1.0)


def test_noise_is_the_same_at_the_same_place_and_changes_smoothly() -> None:
    noise = Noise.over(Bounds(-10.0, -10.0, 10.0, 10.0), 2.0, np.random.default_rng(1))
    x = np.linspace(-10.0, 10.0, 4001)
    values = noise.at(x, np.full_like(x, 3.3))
    assert np.array_equal(values, noise.at(x[None, :], np.array([[3.3]]))[0])
    first = np.diff(values) / 0.005
    second = np.diff(first) / 0.005
    assert np.abs(first).max() < 2.0
    # The second derivative is continuous: no jump where one knot hands over to the next.
    assert np.abs(np.diff(second)).max() < 0.05


def test_noise_on_a_grid_is_the_noise_at_its_points_to_the_last_bit() -> None:
    noise = Noise.over(Bounds(-10.0, -10.0, 10.0, 10.0), 1.3, np.random.default_rng(1))
    # Some lie past the last knots.
    x, y = np.linspace(-14.0, 13.0, 97), np.linspace(-10.0, 15.0, 61)
    assert np.array_equal(noise.on_grid(x, y), noise.at(x[None, :], y[:, None]))


def test_noise_of_equal_knots_is_constant() -> None:
    noise = Noise(np.ones((12, 12)), -4.0, -4.0, 1.0)
    x = np.linspace(-2.0, 3.0, 50)
    assert np.allclose(noise.at(x, x[::-1]), 1.8)


def test_smoothstep_is_flat_outside_and_a_half_in_the_middle() -> None:
    assert smoothstep(1.0, 3.0, np.array([0.0, 1.0, 2.0, 3.0, 9.0])).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_undulation_stays_within_a_few_decimetres() -> None:
    heights = undulation(Bounds(-30.0, -30.0, 30.0, 30.0), np.random.default_rng(2))
    assert heights.shape == (241, 241)
    assert 0.1 < heights.std() < 0.25
