from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from dream.geometry import Bounds
from dream.sim.reef_shapes import Stroke, letter, patches, strings
from dream.sim.reefs import Bed, renumbered
from dream.sim.sampling import rotated
from dream.sim.world import World
from tests.sim.made import made

FAMILIES = ("fringing", "string", "patch", "mixed", "S")


def _square(half: float) -> Bounds:
    return Bounds(-half, -half, half, half)


def reef(kind: str) -> World:
    return made(f"reef/{kind}", 2)


every_family = pytest.mark.parametrize("kind", FAMILIES)


@every_family
def test_a_reef_has_800_to_3000_individuals_of_the_right_size(kind: str) -> None:
    world = reef(kind)
    targets = world.targets
    assert 800 <= len(targets) <= 3000
    for k in range(0, len(targets), 7):
        points = rotated(targets.wxyz[k], world.meshes[targets.mesh[k]].vertices * targets.scale[k])
        centred = points[:, :2] - 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))
        across = 2.0 * math.sqrt(float((centred**2).sum(axis=1).max()))
        assert 0.13 <= across <= 0.36
        assert 0.04 < points[:, 2].max() < 0.3


@every_family
def test_clumps_sit_on_the_seabed_and_stay_below_what_blocks(kind: str) -> None:
    world = reef(kind)
    targets = world.targets
    ground = world.terrain.height(targets.position[:, 0], targets.position[:, 1])
    foot = targets.position[:, 2] - ground
    assert foot.min() > -0.06
    tops = np.empty(len(targets))
    for k in range(len(targets)):
        points = rotated(targets.wxyz[k], world.meshes[targets.mesh[k]].vertices * targets.scale[k])
        tops[k] = foot[k] + points[:, 2].max()
    assert tops.max() < 0.35
    assert 0.05 < (foot > 0.03).mean() < 0.15, "about a tenth is stacked on others"


@every_family
def test_no_individual_lies_under_a_boulder(kind: str) -> None:
    world = reef(kind)
    stacked = world.targets.position[:, :2].astype(np.float64)
    for k in range(len(world.obstacles)):
        vertices = world.meshes[world.obstacles.mesh[k]].vertices * world.obstacles.scale[k]
        radius = math.sqrt(float((vertices[:, :2] ** 2).sum(axis=1).max()))
        away = np.sqrt(((stacked - world.obstacles.position[k, :2]) ** 2).sum(axis=1))
        # An upper clump may lean over the edge by a few centimetres.
        assert away.min() > radius - 0.15


@every_family
def test_the_reef_is_rough_by_about_a_decimetre(kind: str) -> None:
    world = reef(kind)
    targets = world.targets
    tops = []
    for k in range(len(targets)):
        points = rotated(targets.wxyz[k], world.meshes[targets.mesh[k]].vertices * targets.scale[k])
        tops.append(targets.position[k, 2] + points[:, 2].max())
    x, y = targets.position[:, 0].astype(np.float64), targets.position[:, 1].astype(np.float64)
    bare = world.terrain.height(x, y)
    # Half of the reef's surface is crust and half the ground between: the spread of both together.
    spread = [
        np.concatenate([np.array(tops)[near] - bare[near], np.zeros(int(near.sum()))]).std()
        for near in (np.hypot(x - x[k], y - y[k]) < 1.0 for k in range(0, len(x), 50))
    ]
    assert 0.05 < float(np.median(spread)) < 0.15


def test_patches_are_well_apart() -> None:
    world = reef("patch")
    places = {
        int(k): world.targets.position[world.targets.group == k, :2] for k in np.unique(world.targets.group)
    }
    assert 4 <= len(places) <= 7
    for a, b in itertools.combinations(places.values(), 2):
        assert np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1)).min() > 2.0


@pytest.mark.parametrize("seed", range(6))
def test_strings_are_long_and_keep_inside_the_arena(seed: int) -> None:
    strokes = strings(_square(20.0), np.random.default_rng(seed))
    assert 1 <= len(strokes) <= 3
    for stroke in strokes:
        assert 14.0 <= stroke.length <= 33.0
        assert 1.5 <= stroke.half_width <= 2.5
        assert np.abs(stroke.line).max() + stroke.half_width <= 17.5


@pytest.mark.parametrize("which", "LSOKE")
def test_letters_fill_most_of_the_arena_and_keep_inside(which: str) -> None:
    strokes = letter(which, _square(20.0), np.random.default_rng(3))
    line = np.concatenate([stroke.line for stroke in strokes])
    assert np.abs(line).max() < 17.0
    assert np.ptp(line, axis=0).max() > 18.0
    assert sum(stroke.length for stroke in strokes) > 25.0
    if which == "O":
        assert np.allclose(line[0], line[-1])


def test_the_nearest_place_on_a_stroke_agrees_with_a_dense_search() -> None:
    rng = np.random.default_rng(5)
    stroke = strings(_square(22.5), rng)[0]
    x, y = rng.uniform(-22.5, 22.5, (2, 200))
    distance, along = stroke.nearest(x, y)
    steps = np.linspace(0.0, 1.0, 401)[:, None]
    dense = np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(stroke.line)])
    slow = np.sqrt(((dense[:, None] - np.stack([x, y], 1)) ** 2).sum(axis=-1)).min(axis=0)
    assert np.allclose(distance, slow, atol=2e-3)
    assert along.min() >= 0.0
    assert along.max() <= 1.0


def test_no_bed_is_thinner_than_three_metres() -> None:
    rng = np.random.default_rng(1)
    for stroke in (*patches(_square(20.0), rng), *strings(_square(20.0), rng)):
        bed = Bed.of([stroke], _square(20.0), rng)
        angle = np.linspace(0.0, 2.0 * math.pi, 60)
        for x0, y0 in stroke.line:
            inside, _ = bed.cover(x0 + 1.45 * np.cos(angle), y0 + 1.45 * np.sin(angle))
            assert (inside > 0.0).all()


def test_ground_far_from_every_stroke_is_bare() -> None:
    bed = Bed.of([Stroke(np.array([[0.0, 0.0], [5.0, 0.0]]), 2.0)], _square(20.0), np.random.default_rng(0))
    inside, _ = bed.cover(np.array([-18.0, 2.5, 9.0, 2.5]), np.array([15.0, 3.5, 0.0, 0.0]))
    assert inside.tolist() == [0.0, 0.0, 0.0, 1.0]


def test_pieces_of_a_stroke_are_its_groups_in_order() -> None:
    bed = Bed.of(
        [Stroke(np.array([[-12.0, 0.0], [12.0, 0.0]]), 2.0)], _square(20.0), np.random.default_rng(0)
    )
    _, group = bed.cover(np.linspace(-12.0, 12.0, 49), np.zeros(49))
    assert (np.diff(group) >= 0).all()
    assert set(group.tolist()) == {0, 1, 2, 3}


def test_renumbering_closes_gaps_and_keeps_the_order() -> None:
    assert renumbered(np.array([5, -1, 2, 5, 9], np.int32)).tolist() == [1, -1, 0, 1, 2]
