from __future__ import annotations

import math

import numpy as np
import pytest

from dream.geometry import SE3, Camera
from dream.protocol import PROTOCOLS
from dream.sim.render import FAR, NEAR, Renderer
from dream.sim.world import World
from dream.sim.worlds import make_world
from tests.sim.render.ray_caster import cast, parts_of
from tests.sim.render.scenes import ball, camera, instances, jumble, looking, plate, world


def disagreeing(world: World, camera: Camera, poses: list[SE3]) -> float:
    """Share of pixels whose label, id, or depth within 1 %, differs from the ray caster's."""
    renderer, parts = Renderer(world), parts_of(world)
    wrong = 0
    for pose in poses:
        depth, labels, ids = cast(parts, camera, pose, near=NEAR, far=FAR)
        seen = renderer.measure(camera, pose)
        same = (ids == seen.ids) & (labels == seen.labels) & (np.isnan(depth) == np.isnan(seen.depth))
        same &= ~(np.abs(depth - seen.depth) > 0.01 * depth)
        wrong += int((~same).sum())
    return wrong / (len(poses) * camera.width * camera.height)


def around_targets(world: World, count: int) -> list[SE3]:
    """Poses at the protocol's altitude that look at targets from near and far."""
    protocol = PROTOCOLS[world.protocol]
    rng = np.random.default_rng(1)
    poses = []
    for _ in range(count):
        x, y, _ = world.targets.position[rng.integers(len(world.targets))]
        yaw, away = rng.uniform(-math.pi, math.pi), protocol.altitude * rng.uniform(0.0, 4.0)
        x, y = float(x) - away * math.cos(yaw), float(y) - away * math.sin(yaw)
        z = float(world.terrain.height(x, y)) + protocol.altitude
        poses.append(SE3.level(x, y, z, yaw) @ protocol.T_base_camera)
    return poses


def test_a_jumble_of_shapes_agrees_with_the_rays_from_any_side() -> None:
    rng = np.random.default_rng(0)
    poses = []
    for _ in range(12):
        # Any attitude at all, a vehicle's and others.
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        poses.append(
            SE3(rotation * np.linalg.det(rotation), np.append(rng.uniform(-5, 5, 2), rng.uniform(-9.5, -8.0)))
        )
    assert disagreeing(jumble(), camera(), poses) < 0.001


def test_triangles_through_the_near_plane_are_cut_and_not_dropped() -> None:
    ground = world(
        (plate(), ball(5)), obstacles=instances([0, 1], [[0, 0.4, -9.8], [1.2, 0, -10]], 0.9), relief=0.1
    )
    # So low and so near that squares of 1 m and the plate reach behind the camera.
    poses = [looking(0.1 * k, 0.05 * k, -9.8 + 0.02 * k, 0.9 * k, 0.1 * k) for k in range(12)]
    assert disagreeing(ground, camera(), poses) < 0.001


def test_a_wall_before_the_lens_agrees_with_the_rays() -> None:
    wall = world((plate(),), obstacles=instances([0], [0, 0, -9], (4, 1, 4)))
    poses = [
        looking(0.3, -distance, -8.7, 0.5 * math.pi + turn)
        for distance in (0.06, 0.1, 0.4)
        for turn in (0, 0.6, 1.3)
    ]
    assert disagreeing(wall, camera(), poses) < 0.001


@pytest.mark.rare
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("pool/arc", 3),
        pytest.param("reef/patch", 2, marks=pytest.mark.slow),
        pytest.param("wreck/1", 2, marks=pytest.mark.slow),
    ],
)
def test_worlds_agree_with_the_rays(name: str, count: int) -> None:
    made = make_world(name, 2)
    assert disagreeing(made, camera(48, 36), around_targets(made, count)) < 0.001


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("name", ["reef/mixed", "wreck/2", "wreck/3", "wreck/4", "wreck/5"])
def test_more_worlds_agree_with_the_rays(name: str) -> None:
    made = make_world(name, 5)
    assert disagreeing(made, camera(64, 48), around_targets(made, 3)) < 0.001
