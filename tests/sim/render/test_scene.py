from __future__ import annotations

import numpy as np

from dream.sim.render import _kernels
from dream.sim.render.scene import MAX_FACES, RUSTY, Material, build_scene
from dream.sim.worlds import make_world
from tests.sim.render.scenes import jumble


def test_the_kernels_and_the_scene_mean_the_same_numbers() -> None:
    assert 1 << _kernels.FACE_BITS == MAX_FACES
    for name in ("SEABED", "SHELL", "ROCK", "HULL", "WOOD"):
        assert getattr(_kernels, name) == Material[name]
    assert _kernels.RUSTY == RUSTY


def test_the_wooden_wreck_is_of_wood_and_a_coaster_is_of_steel() -> None:
    for number in (1, 5):
        material = build_scene(make_world(f"wreck/{number}", 1)).entity_material
        assert (material == Material.WOOD).any() == (number == 5)
        assert (material == Material.HULL).any() == (number != 5)


def test_every_vertex_lies_within_its_entity_s_sphere_and_no_face_is_lost() -> None:
    world = jumble()
    scene = build_scene(world)
    assert scene.clusters[:, 3].max() <= MAX_FACES
    for e, cluster in enumerate(scene.entity_cluster):
        first, count = scene.clusters[cluster, :2]
        local = scene.vertices[:, first : first + count].astype(np.float64)
        placed = (scene.entity_matrix[e] @ local).T + scene.entity_offset[e]
        away = np.linalg.norm(placed - scene.entity_sphere[e, :3], axis=1).max()
        assert away <= scene.entity_sphere[e, 3] * (1.0 + 1e-5)
    drawn = scene.clusters[scene.entity_cluster[scene.entity_material != Material.SEABED], 3].sum()
    held = sum(len(world.meshes[m].faces) for m in [*world.targets.mesh, *world.obstacles.mesh])
    assert drawn == held
