"""Hull and oysters in one world: each individual is treated by its own kind."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.evaluation.runner import labelled_in
from dream.geometry import SE3
from dream.protocol import DREAM_V1, SensorNoise
from dream.sim.camera_noise import with_noise
from dream.sim.chart import chart
from dream.sim.files import load_world, save_world, world_hash
from dream.sim.render import Renderer
from dream.sim.render.scene import Material, build_scene
from dream.sim.solids import Solids
from dream.sim.validity import check_world
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.types import Label, Target
from tests.sim.arenas import EYE, FLOOR, arena, placed

HULL = np.array([False, True, False])
"""A clump, a slab behind it, and a clump in the slab's shadow."""
AHEAD = SE3.level(0.0, 0.0, EYE, 0.0) @ DREAM_V1.T_base_camera


def mixed() -> World:
    things = placed(
        0,
        [(3.0, 0.0, FLOOR), (4.0, 0.0, FLOOR), (6.0, 0.0, FLOOR)],
        [(0.3, 0.3, 0.2), (0.2, 4.0, 3.0), (0.3, 0.3, 0.2)],
    )
    things = replace(things, group=np.array([0, 1, 2], np.int32))
    return replace(arena(targets=things), hull=HULL)


def test_hull_stops_sight_and_vehicle_and_oysters_do_neither() -> None:
    world = mixed()
    assert Visibility(world, DREAM_V1).seen([[0.0, 0.0, 0.0]]).tolist() == [[True, True, False]]
    solids = Solids(world)
    assert not solids.line_of_sight([0.0, 0.0, EYE], [[6.0, 0.0, FLOOR + 0.2]])[0]
    assert solids.free([[3.0, 0.0], [4.0, 0.0], [6.0, 0.0]], DREAM_V1).tolist() == [True, False, True]
    as_oysters = replace(world, hull=np.zeros(3, np.bool_))
    assert Visibility(as_oysters, DREAM_V1).seen([[0.0, 0.0, 0.0]]).all()


def test_the_points_of_each_kind_are_those_that_it_has_alone() -> None:
    world = mixed()
    both = Visibility(world, DREAM_V1)
    for kind in (HULL, ~HULL):
        alone = replace(world, targets=world.targets.chosen(kind), hull=HULL[kind])
        np.testing.assert_array_equal(both.points[kind], Visibility(alone, DREAM_V1).points)
    assert both.points[0].tolist() == pytest.approx([2.85, -0.15, FLOOR + 0.2], abs=1e-5)


def test_what_is_overlooked_takes_the_label_of_its_kind() -> None:
    world = mixed()
    frame = Renderer(world).render(DREAM_V1.camera, AHEAD)
    every = SensorNoise(0.0, 1.0, 0.0, (0.1, 0.1))
    found = with_noise(frame, DREAM_V1.camera, AHEAD, every, np.random.default_rng(1), hull=world.hull)
    assert {0, 1} <= set(np.unique(frame.ids).tolist())
    assert (found.labels[frame.ids == 0] == Label.SEABED).all()
    assert (found.labels[frame.ids == 1] == Label.OBSTACLE).all()
    np.testing.assert_array_equal(found.labels[frame.ids < 0], frame.labels[frame.ids < 0])


def test_one_mesh_is_textured_by_what_it_stands_for() -> None:
    scene = build_scene(mixed())
    of = {int(k): int(m) for k, m in zip(scene.entity_id, scene.entity_material, strict=True) if k >= 0}
    assert of.pop(1) in (Material.HULL, Material.WOOD)
    assert of == {0: Material.SHELL, 2: Material.SHELL}


def test_the_labels_of_both_are_no_one_kind_of_target() -> None:
    world = mixed()
    assert labelled_in(world) is Target.ANY
    for kind, target in ((HULL, Target.WRECK), (~HULL, Target.OYSTERS)):
        assert labelled_in(replace(world, targets=world.targets.chosen(kind), hull=HULL[kind])) is target


def test_the_chart_shows_both() -> None:
    world = mixed()
    pixels, bare = (np.asarray(chart(one, pixels=300)) for one in (world, arena()))
    scale = 300.0 / (24.0 * 1.08)
    for x, y, there in ((3.0, 0.0, True), (4.0, 1.5, True), (6.0, 0.0, True), (6.0, 1.5, False)):
        at = round((12.96 - y) * scale), round((x + 12.96) * scale)
        assert np.array_equal(pixels[at], bare[at]) != there


def test_a_mixed_world_survives_the_disk_and_others_are_written_as_ever(tmp_path: Path) -> None:
    world = mixed()
    save_world(world, tmp_path / "mixed")
    assert json.loads((tmp_path / "mixed/world.json").read_text())["targets_are_hull"] == "mixed"
    loaded = load_world(tmp_path / "mixed")
    assert loaded.hull.tolist() == HULL.tolist()
    assert world_hash(loaded) == world_hash(world)
    for said in (True, False):
        folder = tmp_path / str(said)
        alike = replace(world, hull=np.full(3, said))
        save_world(alike, folder)
        assert json.loads((folder / "world.json").read_text())["targets_are_hull"] is said
        assert "hull" not in (folder / "targets.csv").read_text()
        assert load_world(folder).hull.tolist() == [said] * 3


def test_the_hash_sees_which_are_hull() -> None:
    world = mixed()
    kinds = ([False] * 3, [True] * 3, HULL, ~HULL)
    assert len({world_hash(replace(world, hull=np.array(kind))) for kind in kinds}) == 4


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (",1\n", ",2\n", r"targets\.csv: line \d: expected 16 numbers .*hull 0 or 1"),
        (",0\n", ",\n", r"targets\.csv: line \d: expected 16 numbers"),
        (",hull\n", "\n", r'targets\.csv: expected the header "mesh,.*,group,hull"'),
    ],
)
def test_a_damaged_kind_is_refused(old: str, new: str, words: str, tmp_path: Path) -> None:
    save_world(mixed(), tmp_path)
    table = tmp_path / "targets.csv"
    table.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=words):
        load_world(tmp_path)


def test_a_kind_for_each_individual_is_asked_for() -> None:
    wrong: list[Any] = [HULL[:2], HULL.astype(np.int64)]
    for hull in wrong:
        with pytest.raises(ValueError, match=re.escape("hull: expected bool (3,), one an individual, got ")):
            check_world(replace(mixed(), hull=hull))


def test_only_oysters_have_the_size_of_oysters() -> None:
    world = mixed()
    scale = world.targets.scale.copy()
    scale[1] = 0.2, 9.0, 3.0
    check_world(replace(world, targets=replace(world.targets, scale=scale)))
    scale[2] = 0.3, math.nextafter(5.1, 6.0), 0.2
    with pytest.raises(ValueError, match=r"targets, row 3: expected at most 5 m of an individual that is no"):
        check_world(replace(world, targets=replace(world.targets, scale=scale)))
