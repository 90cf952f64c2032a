"""What holds of every world by name."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from dream.protocol import protocol_named
from dream.sim.files import load_world, save_world, world_hash
from dream.sim.sampling import FACTOR, MILLIMETRE, QUATERNION, rotated
from dream.sim.validity import check_world
from dream.sim.world import Instances, World
from dream.sim.worlds import WORLDS, make_world
from tests.sim.made import made

# First 16 digits of the hash of seed 1. A change here changes the meaning of every result: say why.
HASHES = {
    "reef/fringing": "a0fffed0a2b5cd85",
    "reef/string": "65e4ca24731b246e",
    "reef/patch": "e1b4f96d14486a31",
    "reef/mixed": "597a4f2405112f8b",
    "reef/L": "f31184e655fa5d43",
    "reef/S": "bd69d2e295389bc4",
    "reef/O": "f0134ac7810c3a4e",
    "reef/K": "26bf0e5d7e99a720",
    "reef/E": "8f41eab861cc6cb0",
    "wreck/1": "7e9812be4fb4e63b",
    "wreck/2": "e2a2a5cda152a026",
    "wreck/3": "de3dd93080f517f9",
    "wreck/4": "f12db1e700b7e8b9",
    "wreck/5": "91d57315c8e8591b",
    "pool/arc": "e6a46ff62f7e6641",
    "flat/empty": "a11bd366836b3362",
    "reef/mound": "ec6c0811836a153e",
    "reef/ledge": "308691f7b6bb6a8e",
    "reef/carpet": "67fc1196ed31a3fa",
    "reef/tiny": "b1dfc66e48b9faaa",
    "reef/dense": "17f7d84991a8b77f",
    "reef/rocks": "caa8115f478f9254",
    "reef/holes": "2e388585a2943898",
    "reef/border": "700d66681a15615c",
    "reef/walls": "a69d36bbc45162b0",
    "reef/two": "4f3eabecc5f4e932",
    "reef/wide": "ecb144cd93161124",
    "wreck/2+wreck/3": "799de13681b6b108",
    "wreck/4+reef/patch": "47b6e64c6de0dd7f",
    "wreck/1+wreck/5+reef/K": "b8c2ceff3fd43e60",
}


def world(name: str) -> World:
    return made(name)


@cache
def hash_of(name: str) -> str:
    return world_hash(world(name))


def surface(world: World, table: Instances) -> npt.NDArray[np.float64]:
    """All triangles in the world: (T, 3, 3)."""
    parts = [np.empty((0, 3, 3))]
    for k in range(len(table)):
        mesh = world.meshes[table.mesh[k]]
        points = rotated(table.wxyz[k], mesh.vertices * table.scale[k]) + table.position[k]
        parts.append(points[mesh.faces])
    return np.concatenate(parts)


def whole(values: npt.ArrayLike, steps: int) -> bool:
    scaled = np.asarray(values, np.float64) * steps
    # float32 holds 50 m to 4 µm, so a whole millimetre comes back within a hundredth of one.
    return bool((np.abs(scaled - np.rint(scaled)) < 0.07).all())


SEVERAL = ("wreck/2+wreck/3", "wreck/4+reef/patch", "wreck/1+wreck/5+reef/K")
every_world = pytest.mark.parametrize("name", [*WORLDS, *SEVERAL])


@pytest.mark.few(6)
@every_world
def test_the_hash_of_a_name_and_a_seed_never_changes(name: str) -> None:
    assert hash_of(name)[:16] == HASHES[name]


@every_world
def test_a_world_is_consistent_and_says_what_it_is(name: str) -> None:
    check_world(world(name))
    assert (world(name).name, world(name).seed) == (name, 1)


@every_world
def test_everything_lies_on_whole_millimetres_and_the_like(name: str) -> None:
    made = world(name)
    assert whole(made.terrain.heights, MILLIMETRE)
    for mesh in made.meshes:
        assert whole(mesh.vertices, MILLIMETRE)
    for table in (made.targets, made.obstacles):
        assert whole(table.position, MILLIMETRE)
        assert whole(table.wxyz, QUATERNION)
        assert whole(table.scale, FACTOR)
        assert whole(table.tint, FACTOR)


@pytest.mark.few(6)
@every_world
def test_a_world_survives_the_disk(name: str, tmp_path: Path) -> None:
    save_world(world(name), tmp_path / "saved")
    assert world_hash(load_world(tmp_path / "saved")) == hash_of(name)


@every_world
def test_starts_are_lattice_poses_in_free_water_inside_the_bounds(name: str) -> None:
    made = world(name)
    protocol = protocol_named(made.protocol)
    solid = [surface(made, made.obstacles), surface(made, made.targets.chosen(made.hull))]
    points = np.concatenate([np.empty((0, 2)), *((t[:, [0, 1, 2], :2]).reshape(-1, 2) for t in solid)])
    assert len(made.starts) >= 3
    for start in made.starts:
        assert protocol.snap(start) == start
        assert made.bounds.contains(start.x, start.y, 0.9 if protocol.name == "pool-v1" else 4.0)
        near = np.sqrt(((points - (start.x, start.y)) ** 2).sum(axis=1)).min(initial=np.inf)
        assert near >= protocol.launch_radius + protocol.body_radius


@every_world
def test_targets_lie_inside_the_bounds_and_the_seabed_reaches_far_beyond(name: str) -> None:
    made = world(name)
    box, ground = made.bounds, made.terrain
    for x, y, _ in made.targets.position:
        assert box.contains(float(x), float(y))
    rows, cols = ground.heights.shape
    beyond = 0.5 if made.protocol == "pool-v1" else 20.0
    assert ground.x0 <= box.x_min - beyond
    assert ground.y0 <= box.y_min - beyond
    assert ground.x0 + (cols - 1) * ground.spacing >= box.x_max + beyond
    assert ground.y0 + (rows - 1) * ground.spacing >= box.y_max + beyond


@every_world
def test_meshes_seen_from_one_side_only_are_closed_where_they_are_obstacles(name: str) -> None:
    made = world(name)
    for k in np.unique(made.obstacles.mesh):
        faces = made.meshes[k].faces
        edges = {
            tuple(edge)
            for edge in np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()
        }
        assert len(edges) == 3 * len(faces)
        assert all((b, a) in edges for a, b in edges)


@every_world
def test_groups_are_numbered_without_gaps(name: str) -> None:
    group = world(name).targets.group
    assert set(group.tolist()) == set(range(int(group.max(initial=-1)) + 1))


@pytest.mark.parametrize("name", [name for name in WORLDS if name.startswith(("reef/", "pool/"))])
def test_no_group_is_smaller_than_the_world_promises(name: str) -> None:
    made = world(name)
    for k in np.unique(made.targets.group):
        places = made.targets.position[made.targets.group == k, :2].astype(np.float64)
        # That of the tank is less than what a world promises unless it says another.
        promised = min(made.group_radius, 0.3) if made.protocol == "pool-v1" else made.group_radius
        assert np.hypot(*(places - places.mean(axis=0)).T).max() >= promised


def test_a_world_shares_no_memory_with_the_next() -> None:
    again = make_world("reef/patch", 1)
    assert world_hash(again) == world_hash(world("reef/patch"))
    assert not np.shares_memory(again.terrain.heights, world("reef/patch").terrain.heights)
    assert world_hash(make_world("reef/patch", 2)) != world_hash(again)
