"""What holds of several structures in one world, beyond what holds of every world."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dream.evaluation.runner import labelled_in
from dream.protocol import DREAM_V1
from dream.sim.boulders import PASSAGE
from dream.sim.files import world_hash
from dream.sim.solids import Solids, corners
from dream.sim.structures import OFF_HULL, around, beside, feet
from dream.sim.world import World
from dream.sim.worlds import make_world, origin, structures_in
from dream.sim.years import later
from dream.types import Target
from tests.sim.made import made

PAIR, GROWN = "wreck/2+wreck/3", "wreck/4+reef/patch"


def hull_corners(world: World) -> np.ndarray:
    """(K, 3) corners of all hull, patch after patch."""
    hull = world.targets.chosen(world.hull)
    parts = [
        corners(world.meshes[mesh], hull, np.array([k])).reshape(-1, 3) for k, mesh in enumerate(hull.mesh)
    ]
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        (PAIR, ("wreck/2", "wreck/3")),
        (GROWN, ("wreck/4", "reef/patch")),
        ("wreck/1+wreck/1+wreck/1+reef/O", ("wreck/1", "wreck/1", "wreck/1", "reef/O")),
        ("wreck/1+wreck/1+wreck/1+wreck/1+reef/O", ()),
        ("reef/patch+wreck/4", ()),
        ("reef/patch+reef/O", ()),
        ("wreck/1+reef/O+reef/K", ()),
        ("wreck/1+pool/arc", ()),
        ("wreck/1+wreck/9", ()),
        ("wreck/1+", ()),
        ("wreck/1", ()),
    ],
)
def test_a_name_tells_its_structures(name: str, parts: tuple[str, ...]) -> None:
    assert structures_in(name) == parts
    assert (origin(name) is not None) == (bool(parts) or name == "wreck/1")


def test_a_name_of_no_such_world_is_refused() -> None:
    with pytest.raises(ValueError, match=r'no world "wreck/2\+wreck/9"'):
        make_world("wreck/2+wreck/9", 1)


def test_kinds_follow_from_the_parts() -> None:
    assert labelled_in(made(PAIR)) is Target.WRECK
    assert labelled_in(made(GROWN)) is Target.ANY


def test_the_same_wreck_twice_is_two_wrecks() -> None:
    twins = make_world("wreck/5+wreck/5", 1)
    west = twins.targets.position[:, 0] < 0.5 * (twins.bounds.x_min + twins.bounds.x_max)
    assert west.any()
    assert not west.all()
    assert west.sum() != (~west).sum()


@pytest.mark.rare
def test_each_wreck_stays_as_it_was_on_ground_of_its_own() -> None:
    west, east = made("wreck/2", 3), made("wreck/3", 3)
    world = beside(west, east)
    shift = np.array([west.bounds.x_max - east.bounds.x_min, 0.0, 0.0])
    alone = np.concatenate([hull_corners(west), hull_corners(east) + shift])
    np.testing.assert_allclose(hull_corners(world), alone, atol=1e-5)
    for part, (x, y, _) in ((west, np.zeros(3)), (east, shift)):
        points = hull_corners(part)[:, :2]
        before, after = part.terrain.height(*points.T), world.terrain.height(*(points + np.array([x, y])).T)
        np.testing.assert_allclose(after, before, atol=0.0011)


def test_a_wreck_on_the_border_of_two_seabeds_stays_whole() -> None:
    wreck = made("wreck/2", 3)
    world = beside(wreck, made("reef/mixed", 3), 20.0)
    east = hull_corners(wreck)[:, 0].max()
    assert east > 0.5 * (wreck.bounds.x_max + made("reef/mixed", 3).bounds.x_min + 20.0), "on the border"
    np.testing.assert_array_equal(hull_corners(world), hull_corners(wreck))


def test_a_reef_grows_around_the_wreck_and_not_through_it() -> None:
    wreck, reef = made("wreck/4", 3), made("reef/mixed", 3)
    world = around(wreck, reef)
    np.testing.assert_array_equal(hull_corners(world), hull_corners(wreck))
    tree = cKDTree(hull_corners(world)[:, :2])
    clumps = world.targets.chosen(~world.hull)
    assert 0.5 * len(reef.targets) < len(clumps) < len(reef.targets), "some had to make room"
    assert np.min(tree.query(clumps.position[:, :2])[0]) >= OFF_HULL - 1e-5
    rocks = feet(world.meshes, world.obstacles.chosen(world.obstacles.mesh >= len(wreck.meshes)))
    assert len(rocks)
    assert (tree.query(rocks[:, :2])[0] >= rocks[:, 2] + PASSAGE - 1e-5).all()
    stones = feet(world.meshes, world.obstacles.chosen(world.obstacles.mesh < len(wreck.meshes)))
    for (x, y, radius), (u, v, other) in itertools.product(rocks, stones):
        assert np.hypot(x - u, y - v) >= radius + other + PASSAGE - 1e-5
    for x, y, radius in stones:
        assert (np.hypot(*(clumps.position[:, :2] - (x, y)).T) > radius).all()


def test_what_stands_on_the_seabed_stands_as_deep_in_it_as_before() -> None:
    wreck, reef = made("wreck/4", 3), made("reef/mixed", 3)
    world, depths = around(wreck, reef), {}
    for name, part in (("before", reef), ("after", world)):
        clumps = part.targets.chosen(~part.hull)
        sunk = clumps.position[:, 2] - part.terrain.height(*clumps.position[:, :2].T)
        depths[name] = dict(zip(map(tuple, clumps.position[:, :2].tolist()), sunk, strict=True))
    common = depths["before"].keys() & depths["after"].keys()
    assert len(common) == len(depths["after"])
    assert max(abs(depths["before"][place] - depths["after"][place]) for place in common) < 0.002


@pytest.mark.parametrize("name", [PAIR, GROWN])
def test_the_seabed_has_no_cliffs(name: str) -> None:
    heights = made(name).terrain.heights.astype(np.float64)
    parts = [made(part).terrain for part in structures_in(name)]
    steepest = max(np.abs(np.diff(part.heights.astype(np.float64))).max() for part in parts)
    assert max(np.abs(np.diff(heights, axis=axis)).max() for axis in (0, 1)) < steepest + 0.05


@pytest.mark.parametrize("name", [PAIR, GROWN])
def test_the_starts_are_free_and_lead_to_one_another(name: str) -> None:
    world = made(name)
    lattice = Solids(replace(world, starts=world.starts[:1])).lattice(DREAM_V1)
    col, row = lattice.first
    for start in world.starts:
        at = round(start.y / lattice.spacing) - row, round(start.x / lattice.spacing) - col
        assert lattice.reachable[at]


@pytest.mark.rare
def test_the_reef_lives_on_and_the_wreck_stays() -> None:
    before, after = made(GROWN), make_world(f"{GROWN}+2y1", 1)
    np.testing.assert_array_equal(hull_corners(after), hull_corners(before))
    assert len(after.targets) == len(after.hull)
    assert (~after.hull).sum() != (~before.hull).sum()
    assert set(after.targets.group.tolist()) == set(range(int(after.targets.group.max()) + 1))
    assert world_hash(after) == world_hash(make_world(f"{GROWN}+2y1", 1))


def test_no_recruit_settles_on_the_hull() -> None:
    world = made(GROWN)
    hull = world.targets.chosen(world.hull)
    position = world.targets.position.copy()
    position[~world.hull] = hull.position[: (~world.hull).sum()] + np.array([0.6, 0.0, 0.0], np.float32)
    crowded = replace(world, targets=replace(world.targets, position=position))
    old = set(map(tuple, position[:, :2].tolist()))
    found = later(crowded, 2.0, 1)
    places = found.targets.position[~found.hull, :2].astype(np.float64)
    new = np.array([place for place in places.tolist() if tuple(place) not in old])
    assert len(new) > 10
    for x, y, radius in feet(world.meshes, hull):
        assert (np.hypot(*(new - (x, y)).T) > radius).all()
