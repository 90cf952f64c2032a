"""The beam in three dimensions and what single looks show, against plain Python on small scenes."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree

from dream.mapping.volume import FREE, SOLID
from dream.planning._kernels.looks import LookOptics, LookScene, shown
from dream.planning._kernels.space_beam import (
    SpaceElements,
    SpaceLattice,
    SpaceScore,
    SpaceSequences,
    beam,
    best_views,
)
from dream.planning._kernels.ways import FINE, SpaceMoves

Array = np.ndarray[Any, Any]
Place = tuple[int, int, int]
Pose = tuple[Place, int, int]
SPACING, HEADINGS, HORIZON = 0.5, 8, 3
SIZE = (5, 7, 7)
START: Pose = ((2, 2, 2), 1, 0)
OPTICS = LookOptics(1.0, 0.75, 2.5, 0.3)
SCORE = SpaceScore(discount=0.9, step=0.4, slight=0.2, near=0.3, stride=1.0, climb=0.5)


class Scene:
    """A small box of water with some solid voxels and some places where the body does not fit."""

    def __init__(self, seed: int, tilts: tuple[float, ...] = (0.4, -0.4), stride: int = 1) -> None:
        rng = np.random.default_rng(seed)
        fine = [FINE * (n - 1) + 1 for n in SIZE]
        states = np.where(rng.random([n + 4 for n in fine]) < 0.02, SOLID, FREE).astype(np.uint8)
        self.scene = LookScene(states, np.full(3, -2, np.int64), SPACING / FINE)
        fits = (rng.random(fine) > 0.06).astype(np.uint8)
        first = tuple(FINE * k for k in START[0])
        fits[first] = 1
        stands = fits[::FINE, ::FINE, ::FINE].copy()
        angles = np.arange(HEADINGS) * 2.0 * math.pi / HEADINGS
        self.yaws, self.pitches = angles, np.array(tilts)
        self.lattice = SpaceLattice(
            fits,
            stands,
            np.zeros(3),
            SPACING,
            np.column_stack([np.cos(angles), np.sin(angles)]),
            np.column_stack([np.cos(self.pitches), np.sin(self.pitches)]),
        )
        east = np.round(np.column_stack([np.cos(angles), np.sin(angles)])).astype(np.int64) * stride
        offsets = np.stack([np.zeros_like(east), east], axis=1)
        self.moves = SpaceMoves(np.array([0, 1, -1]), offsets, np.array([0, stride, -stride]))
        count = 80
        normals = rng.normal(size=(count, 3))
        points = rng.uniform(0.0, 1.0, (count, 3)) * (np.array(SIZE[::-1]) - 1) * SPACING
        part_of = rng.integers(0, 5, count)
        self.elements = SpaceElements(
            points,
            normals / np.linalg.norm(normals, axis=1, keepdims=True),
            rng.uniform(0.0, 0.6, count),
            rng.uniform(0.1, 1.0, count),
            part_of,
            np.stack([points[part_of == p].mean(axis=0) for p in range(5)]),
        )

    def beam(self, width: int, horizon: int = HORIZON) -> SpaceSequences:
        place, heading, tilt = START
        found: SpaceSequences = beam(
            self.scene,
            OPTICS,
            self.lattice,
            self.moves,
            self.elements,
            SCORE,
            np.array(place),
            heading,
            tilt,
            width,
            horizon,
        )
        return found

    def position(self, place: Place) -> Array:
        return np.array(place[::-1]) * SPACING

    def shown(self, pose: Pose) -> Array:
        """(E,) what a look shows, by the definition."""
        place, heading, tilt = pose
        yaw, pitch = self.yaws[heading], self.pitches[tilt]
        ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
        axis = math.cos(pitch) * ahead - math.sin(pitch) * up
        above = math.sin(pitch) * ahead + math.cos(pitch) * up
        camera, seen = self.position(place), []
        for point, normal, cosine in zip(*self.elements[:3], strict=True):
            away = point - camera
            depth, distance = away @ axis, float(np.linalg.norm(away))
            image = depth > 0.0 and abs(away @ left) <= OPTICS.across * depth
            image = image and abs(away @ above) <= OPTICS.upright * depth
            useful = distance <= OPTICS.reach and -(away @ normal) >= cosine * distance
            seen.append(bool(image and useful and self.clear(camera, point + self.scene.side * normal)))
        return np.array(seen)

    def clear(self, camera: Array, point: Array) -> bool:
        """Does nothing solid lie at points so near each other on the way?"""
        steps = math.ceil(float(np.linalg.norm(point - camera)) / (0.6 * self.scene.side))
        way = camera + np.arange(steps + 1)[:, None] / max(steps, 1) * (point - camera)
        at = np.floor(way[:, ::-1] / self.scene.side).astype(int) - self.scene.first
        inside = ((at >= 0) & (at < self.scene.states.shape)).all(axis=1)
        return not (self.scene.states[tuple(at[inside].T)] == SOLID).any()

    def actions(self, pose: Pose) -> list[Pose]:
        """Where one action leads; nothing but a look again is none."""
        (level, row, col), heading, _ = pose
        found = []
        for turn in self.moves.turns:
            to = int((heading + turn) % HEADINGS)
            for (east, north), up in itertools.product(self.moves.offsets[to], self.moves.climbs):
                end = (int(level + up), int(row + north), int(col + east))
                if not all(0 <= k < n for k, n in zip(end, SIZE, strict=True)):
                    continue
                if end != pose[0] and not (self.lattice.stands[end] and self.passes(pose[0], end)):
                    continue
                found += [(end, to, t) for t in range(len(self.pitches)) if (end, to, t) != pose]
        return found

    def passes(self, start: Place, end: Place) -> bool:
        """Does the body fit at points along a straight move? Between two fine points at all around."""
        way = FINE * (np.array(end) - np.array(start))
        steps = int(np.abs(way).max())
        for k in range(1, steps + 1):
            at = FINE * np.array(start) + way * k / steps
            ends = [{math.floor(v + 1e-9), math.ceil(v - 1e-9)} for v in at]
            if not all(self.lattice.fits[point] for point in itertools.product(*ends)):
                return False
        return True

    def value(self, poses: list[Pose]) -> tuple[float, float]:
        """What a sequence gains, and that less the way to what it leaves."""
        seen, gained = np.zeros(len(self.elements.weights), np.bool_), 0.0
        for number, pose in enumerate(poses[1:], start=1):
            shown = self.shown(pose)
            gained += SCORE.discount**number * float(self.elements.weights[shown & ~seen].sum())
            seen |= shown
        weight = np.bincount(self.elements.part_of, self.elements.weights * ~seen, len(self.elements.parts))
        parts = self.elements.parts[weight > SCORE.slight]
        if not len(parts):
            return gained, gained
        # A way of no steps is one as well: to the library nought, or nearly that, is none.
        tree = minimum_spanning_tree(way(parts[:, None] - parts[None]) + 1e-6).sum()
        return gained, gained - SCORE.step * (tree + way(parts - self.position(poses[-1][0])).min())


def way(apart: Array) -> Array:
    """Steps from one place to another, were the water free."""
    over = np.maximum(np.hypot(apart[..., 0], apart[..., 1]) - SCORE.near, 0.0)
    return np.asarray(over / SCORE.stride + np.maximum(np.abs(apart[..., 2]) - SCORE.near, 0.0) / SCORE.climb)


def sequences(found: SpaceSequences) -> list[list[Pose]]:
    """Of a beam, each with its poses from the start on."""
    paths: list[list[Pose]] = []
    for number, parent in enumerate(found.parent):
        level, row, col = found.node[number].tolist()
        pose = ((level, row, col), int(found.heading[number]), int(found.tilt[number]))
        paths.append([*([] if parent < 0 else paths[parent]), pose])
    return paths


@pytest.mark.parametrize("seed", range(3))
def test_each_sequence_is_worth_what_it_first_shows_less_the_tree_over_what_it_leaves(seed: int) -> None:
    scene = Scene(seed)
    found = scene.beam(width=8)
    assert found.level.max() == HORIZON
    assert found.score.max() > 0.0
    for number, path in enumerate(sequences(found)):
        assert len(path) == found.level[number] + 1
        assert (found.score[number], found.value[number]) == pytest.approx(scene.value(path), abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_every_action_is_one_of_the_protocols_through_water_where_the_body_fits(seed: int) -> None:
    scene = Scene(seed)
    paths = sequences(scene.beam(width=30))
    assert paths[0] == [START]
    for path in paths[1:]:
        assert path[-1] in scene.actions(path[-2])
    assert len({len(path) for path in paths}) == HORIZON + 1


@pytest.mark.parametrize("seed", range(3))
def test_the_best_of_a_beam_that_keeps_all_is_the_best_there_is(seed: int) -> None:
    # Actions so long that no two of their ends share a cube, and one tilt.
    scene = Scene(seed, tilts=(0.4,), stride=2)
    found = scene.beam(width=1000, horizon=2)
    every = [[START, one, two] for one in scene.actions(START) for two in scene.actions(one)]
    assert found.value[found.level == 2].max() == pytest.approx(
        max(scene.value(path)[1] for path in every), abs=1e-5
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_look_shows_what_is_in_its_image_and_reach_and_not_hidden(seed: int) -> None:
    scene = Scene(seed)
    total = 0
    for pose in itertools.product([START[0], (1, 4, 5)], range(HEADINGS), range(2)):
        place, heading, tilt = pose
        args = scene.position(place), scene.yaws[heading], scene.pitches[tilt]
        fast = shown(scene.scene, OPTICS, *args, *scene.elements[:3])
        np.testing.assert_array_equal(fast, scene.shown(pose))
        total += int(fast.sum())
    assert total > 0


def test_the_best_look_from_each_node_is_that_which_shows_most() -> None:
    scene = Scene(0)
    nodes = np.array([START[0], (1, 4, 5), (3, 0, 6)])
    weight, heading, tilt = best_views(scene.scene, OPTICS, scene.lattice, scene.elements, nodes)
    assert weight.max() > 0.0
    for n, node in enumerate(nodes.tolist()):
        place: Place = (node[0], node[1], node[2])
        looks = {
            (h, t): float(scene.elements.weights[scene.shown((place, h, t))].sum())
            for h in range(HEADINGS)
            for t in range(2)
        }
        assert weight[n] == pytest.approx(max(looks.values()))
        assert looks[int(heading[n]), int(tilt[n])] == pytest.approx(weight[n])
