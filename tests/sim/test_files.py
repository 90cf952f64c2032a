from __future__ import annotations

import dataclasses
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE2, SE3, Bounds
from dream.protocol import protocol_named
from dream.sim.files import load_world, save_world, world_hash
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.world import Instances, Mesh, World
from tests.sim.made import made


@pytest.fixture(scope="module")
def tank() -> World:
    return made("pool/arc", 3)


@pytest.fixture(scope="module")
def saved(tank: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("world") / "pool"
    save_world(tank, folder)
    return folder


def changed(folder: Path, field: str, value: Any) -> None:
    """Set one field of world.json, given as a dotted path."""
    path = folder / "world.json"
    content = json.loads(path.read_text())
    *parents, last = field.split(".")
    part = content
    for name in parents:
        part = part[int(name)] if isinstance(part, list) else part[name]
    part[last] = value
    path.write_text(json.dumps(content))


def replaced(folder: Path, name: str, old: str, new: str) -> None:
    path = folder / name
    text = path.read_text()
    assert re.search(old, text)
    path.write_text(re.sub(old, new, text, count=1))


def cut(folder: Path, name: str, share: float) -> None:
    path = folder / name
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])


def row(folder: Path, column: int, value: str) -> None:
    """Set one column of the first individual."""
    lines = (folder / "targets.csv").read_text().splitlines()
    cells = lines[1].split(",")
    cells[column] = value
    (folder / "targets.csv").write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]) + "\n")


def heights(folder: Path, values: Any) -> None:
    np.save(folder / "terrain.npy", values)


def peak(column: int) -> Any:
    """A seabed like the tank's with one high point."""
    ground = np.full((41, 41), -1.524, np.float32)
    ground[20, column] = -0.5
    return ground


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "no manifest": (lambda f: (f / "world.json").unlink(), r"world\.json: expected a file in .*got none"),
    "no terrain": (lambda f: (f / "terrain.npy").unlink(), r"terrain\.npy: expected a file"),
    "no meshes": (lambda f: (f / "meshes.obj").unlink(), r"meshes\.obj: expected a file"),
    "no targets": (lambda f: (f / "targets.csv").unlink(), r"targets\.csv: expected a file"),
    "cut manifest": (lambda f: cut(f, "world.json", 0.5), r"world\.json: the file: Invalid JSON"),
    "cut terrain": (
        lambda f: cut(f, "terrain.npy", 0.5),
        r"terrain\.npy: expected a float32 array \(41, 41\)",
    ),
    "cut header": (lambda f: cut(f, "terrain.npy", 0.001), r"terrain\.npy: expected a float32 array"),
    "cut meshes": (lambda f: cut(f, "meshes.obj", 0.7), r"meshes\.obj: .*expected .*got"),
    "cut targets": (lambda f: cut(f, "targets.csv", 0.5), r"targets\.csv: row.*: expected .*got"),
    "empty targets": (lambda f: cut(f, "targets.csv", 0.0), r'targets\.csv: expected the header .*got ""'),
    "other bytes": (
        lambda f: (f / "targets.csv").write_bytes(b"\xff\xfe\x00"),
        r"targets\.csv: expected UTF-8 text",
    ),
    "pickle": (lambda f: heights(f, np.array([{}], object)), r"terrain\.npy: expected a float32 array"),
    "other shape": (lambda f: heights(f, np.zeros((3, 4), np.float32)), r"got float32 \(3, 4\)"),
    "other type": (
        lambda f: heights(f, np.zeros((41, 41))),
        r"terrain\.npy: expected a float32 .*got float64",
    ),
    "NaN height": (
        lambda f: heights(f, np.full((41, 41), np.nan, np.float32)),
        r"terrain\.heights, row 1, column 1: expected a number within .*got nan",
    ),
    "dry land": (
        lambda f: heights(f, np.ones((41, 41), np.float32)),
        r"terrain\.heights: expected a seabed below",
    ),
    "a seabed just below the surface": (
        lambda f: heights(f, np.full((41, 41), -0.79, np.float32)),
        r"terrain\.heights: expected a seabed below z = -0\.8 inside the bounds, .*got -0\.79",
    ),
    "one high point beside the bounds": (
        lambda f: heights(f, peak(5)),
        r"terrain\.heights: expected a seabed below z = -0\.8 inside the bounds, .*got -0\.5",
    ),
    "another format": (
        lambda f: changed(f, "format", "sdf"),
        r"world\.json: format: .*'dream-world', got 'sdf'",
    ),
    "a later version": (lambda f: changed(f, "version", 2), r"world\.json: version: .*got 2"),
    "unknown field": (lambda f: changed(f, "colour", 1), r"world\.json: colour: Extra inputs"),
    "text for a number": (
        lambda f: changed(f, "terrain.x0", "east"),
        r"world\.json: terrain\.x0: .*got 'east'",
    ),
    "huge terrain": (
        lambda f: changed(f, "terrain.rows", 10**9),
        r"world\.json: terrain\.rows: .*8192, got 10+",
    ),
    "control characters in the name": (
        lambda f: changed(f, "name", "reef\n\x1b[31m"),
        r"world\.json: name: .*expected 1 to 100 printable characters, got 'reef\\n\\x1b\[31m'",
    ),
    "writing direction in the name": (
        lambda f: changed(f, "name", "reef\u202e"),
        r"world\.json: name: .*expected 1 to 100 printable characters",
    ),
    "control characters in the name of the water": (
        lambda f: changed(f, "water.name", "clear\x07"),
        r"world\.json: water\.name: .*expected 1 to 100 printable characters",
    ),
    "no name": (lambda f: changed(f, "name", ""), r"world\.json: name: .*expected 1 to 100 printable"),
    "long name": (lambda f: changed(f, "name", "x" * 101), r"world\.json: name: .*at most 100"),
    "huge seed": (lambda f: changed(f, "seed", 2**63), r"world\.json: seed: .*got 9223372036854775808"),
    "negative seed": (lambda f: changed(f, "seed", -1), r"world\.json: seed: .*got -1"),
    "bounds reversed": (
        lambda f: changed(f, "bounds.x_min", 9.0),
        r"world\.json: bounds: expected .*x_min < x_max",
    ),
    "bounds off the lattice": (
        lambda f: changed(f, "bounds.x_min", -1.03),
        r"bounds\.x_min: expected a multiple",
    ),
    "bounds beyond terrain": (
        lambda f: changed(f, "bounds.x_max", 4.0),
        r"terrain: expected to cover the bounds",
    ),
    "no start": (lambda f: changed(f, "starts", []), r"world\.json: starts: .*at least 1"),
    "start outside": (
        lambda f: changed(f, "starts.0.x", 2.0),
        r"starts\[0\]: expected a place inside the bounds",
    ),
    "start at the side": (
        lambda f: changed(f, "starts.0.x", 1.5),
        r"starts\[0\]: expected a place inside the bounds .*, 0\.4 m from every side, got \(1\.5",
    ),
    "start off the lattice": (
        lambda f: changed(f, "starts.1.y", 0.123),
        r"starts\[1\]\.y: expected a multiple",
    ),
    "start askew": (
        lambda f: changed(f, "starts.0.yaw", 0.1),
        r"starts\[0\]\.yaw: expected a multiple of 15°",
    ),
    "unknown protocol": (
        lambda f: changed(f, "protocol", "pool-v2"),
        r'no protocol "pool-v2"\. Did you mean "pool-v1"',
    ),
    "bad water": (
        lambda f: changed(f, "water.veil", [0.1, 0.2, 3.0]),
        r"world\.json: water\.veil\.2: .*got 3\.0",
    ),
    "two-sided nothing": (
        lambda f: changed(f, "meshes.two_sided", [99]),
        r"meshes\.two_sided: expected .*got \[99\]",
    ),
    "missing object": (
        lambda f: changed(f, "meshes.count", 11),
        r"meshes\.obj: objects: expected 11.*got 10",
    ),
    "missing row": (lambda f: changed(f, "targets", 201), r"targets\.csv: rows: expected 201.*got 200"),
    "NaN vertex": (
        lambda f: replaced(f, "meshes.obj", r"v \S+", "v nan"),
        r'meshes\.obj: line 3: expected finite numbers, got "v nan',
    ),
    "far vertex": (
        lambda f: replaced(f, "meshes.obj", r"v \S+", "v 1e30"),
        r"meshes\[0\]\.vertices, row 1, column 1",
    ),
    "word in a vertex": (
        lambda f: replaced(f, "meshes.obj", r"v \S+", "v here"),
        r'meshes\.obj: line 3: .*got "v here',
    ),
    "colour out of range": (
        lambda f: replaced(f, "meshes.obj", r"\d\.\d{4}\nv", "7.0\nv"),
        r"meshes\.obj: object 0: expected colours from 0 to 1, got 7",
    ),
    "face out of range": (
        lambda f: replaced(f, "meshes.obj", r"f \d+", "f 9999"),
        r"meshes\.obj: line 15: expected vertices 1 to \d+, got 9999",
    ),
    "face number too large": (
        lambda f: replaced(f, "meshes.obj", r"f \d+", "f " + "9" * 30),
        r"meshes\.obj: ",
    ),
    "a face of two corners": (
        lambda f: replaced(f, "meshes.obj", r"f \d+ \d+ \d+", "f 1 2"),
        r"meshes\.obj: line 15: expected a face of 3 to 1000 corners",
    ),
    "other columns": (
        lambda f: replaced(f, "targets.csv", "mesh,x", "x,mesh"),
        r"targets\.csv: expected the header",
    ),
    "word in a table": (lambda f: row(f, 2, "there"), r"targets\.csv: line 2: expected 15 numbers"),
    "mesh out of range": (lambda f: row(f, 0, "10"), r"targets\.mesh, row 1: expected 0 to 9, got 10"),
    "mesh number too large": (lambda f: row(f, 0, "9" * 20), r"targets\.csv: line 2"),
    "position NaN": (
        lambda f: row(f, 1, "nan"),
        r"targets\.position, row 1, column 1: expected a number within .*got nan",
    ),
    "quaternion": (
        lambda f: row(f, 4, "2.0"),
        r"targets\.wxyz, row 1: expected a quaternion of length 1, got 2",
    ),
    "negative scale": (
        lambda f: row(f, 8, "-0.1"),
        r"targets\.scale, row 1: expected more than 0, got -0\.1",
    ),
    "negative tint": (lambda f: row(f, 11, "-1"), r"targets\.tint, row 1: expected 0 or more, got -1"),
    "no group": (lambda f: row(f, 14, "-1"), r"targets\.group, row 1: expected 0 to 199, got -1"),
    "group beyond the individuals": (
        lambda f: row(f, 14, "200"),
        r"targets\.group, row 1: expected 0 to 199, got 200",
    ),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_world_is_refused_with_what_was_expected_and_found(
    kind: str, saved: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "damaged"
    shutil.copytree(saved, folder)
    damage, message = DAMAGE[kind]
    damage(folder)
    with pytest.raises(ValueError, match=message) as caught:
        load_world(folder)
    assert "\n" not in str(caught.value)


def test_a_high_point_that_no_ground_inside_the_bounds_rises_to_is_allowed(
    saved: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "steep"
    shutil.copytree(saved, folder)
    heights(folder, peak(4))
    assert load_world(folder).terrain.heights[20, 4] == np.float32(-0.5)


def test_a_start_a_body_and_a_cell_from_the_side_is_allowed(saved: Path, tmp_path: Path) -> None:
    folder = tmp_path / "near"
    shutil.copytree(saved, folder)
    changed(folder, "starts.0.x", 1.45)
    changed(folder, "starts.0.y", -1.45)
    assert load_world(folder).starts[0].x == 1.45


def test_a_world_comes_back_as_it_was(tank: World, saved: Path) -> None:
    loaded = load_world(saved)
    assert world_hash(loaded) == world_hash(tank)
    assert (loaded.name, loaded.seed, loaded.bounds, loaded.starts) == (
        tank.name,
        tank.seed,
        tank.bounds,
        tank.starts,
    )
    assert loaded.water == tank.water
    for field in dataclasses.fields(Instances):
        assert np.array_equal(getattr(loaded.targets, field.name), getattr(tank.targets, field.name))
    for mine, theirs in zip(loaded.meshes, tank.meshes, strict=True):
        for name in ("vertices", "faces", "colors"):
            assert np.array_equal(getattr(mine, name), getattr(theirs, name))


@pytest.mark.rare
@pytest.mark.parametrize("name", ["wreck/4", "reef/patch"])
def test_a_loaded_world_looks_and_counts_like_the_one_that_was_saved(name: str, tmp_path: Path) -> None:
    world = made(name)
    save_world(world, tmp_path)
    loaded = load_world(tmp_path)
    assert world_hash(loaded) == world_hash(world)
    protocol = protocol_named(world.protocol)
    x, y, _ = world.targets.position[0].tolist()
    poses = np.array(
        [
            (x + 3.0 * c, y + 3.0 * s, a + np.pi)
            for a in np.arange(4) * 0.5 * np.pi
            for c, s in [(np.cos(a), np.sin(a))]
        ]
    )
    seen, seen_again = (Visibility(each, protocol).seen(poses) for each in (world, loaded))
    assert seen.any()
    assert np.array_equal(seen, seen_again)
    z = float(world.terrain.height(*poses[0, :2])) + protocol.altitude
    eye = SE3.level(float(poses[0, 0]), float(poses[0, 1]), z, float(poses[0, 2])) @ protocol.T_base_camera
    frame, again = (Renderer(each).render(protocol.camera, eye) for each in (world, loaded))
    assert (frame.ids >= 0).any()
    for part in ("rgb", "depth", "labels", "ids"):
        np.testing.assert_array_equal(getattr(frame, part), getattr(again, part))


def test_a_two_sided_mesh_stays_two_sided(tank: World, tmp_path: Path) -> None:
    plate = dataclasses.replace(tank.meshes[0], two_sided=True)
    save_world(dataclasses.replace(tank, meshes=(plate, *tank.meshes[1:])), tmp_path)
    loaded = load_world(tmp_path)
    assert [mesh.two_sided for mesh in loaded.meshes] == [True] + [False] * 9


def moved(table: Instances, metres: float) -> Instances:
    position = table.position.copy()
    position[0, 0] += metres
    return dataclasses.replace(table, position=position)


CHANGES: dict[str, Callable[[World], World]] = {
    "name": lambda w: dataclasses.replace(w, name="pool/bow"),
    "seed": lambda w: dataclasses.replace(w, seed=4),
    "bounds": lambda w: dataclasses.replace(w, bounds=Bounds(-1.9, -1.85, 1.85, 1.85)),
    "start": lambda w: dataclasses.replace(w, starts=(SE2(0.05, 0.0, 0.0), *w.starts[1:])),
    "water": lambda w: dataclasses.replace(w, water=dataclasses.replace(w.water, particles=3.0)),
    "hull": lambda w: dataclasses.replace(w, hull=~w.hull),
    "target": lambda w: dataclasses.replace(w, targets=moved(w.targets, 0.001)),
    "obstacle": lambda w: dataclasses.replace(w, obstacles=moved(w.obstacles, 0.001)),
    "terrain": lambda w: dataclasses.replace(w, terrain=dataclasses.replace(w.terrain, x0=-2.501)),
    "colour": lambda w: dataclasses.replace(w, meshes=(recoloured(w.meshes[0]), *w.meshes[1:])),
}


def recoloured(mesh: Mesh) -> Mesh:
    return dataclasses.replace(mesh, colors=mesh.colors ^ np.uint8(1))


@pytest.mark.parametrize("what", CHANGES)
def test_the_hash_sees_every_part_of_a_world(what: str, tank: World) -> None:
    assert world_hash(CHANGES[what](tank)) != world_hash(tank)


def test_the_hash_does_not_see_what_is_smaller_than_the_rounding(tank: World) -> None:
    assert world_hash(dataclasses.replace(tank, targets=moved(tank.targets, 0.0002))) == world_hash(tank)


def test_an_inconsistent_world_is_not_written(tank: World, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"starts: expected at least one"):
        save_world(dataclasses.replace(tank, starts=()), tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(("field", "value"), [("name", "reef\n2"), ("name", "x" * 101), ("seed", 2**63)])
def test_what_would_not_be_read_back_is_not_written(
    field: str, value: Any, tank: World, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=f"^{field}: expected .*, got "):
        save_world(dataclasses.replace(tank, **{field: value}), tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_folder_that_cannot_be_made_is_an_os_error(tank: World, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    told = r"world: expected a folder that can be made and written, got .*taken.* \(.+\)\. Choose another"
    for folder in (tmp_path / "taken", tmp_path / "taken" / "deeper"):
        with pytest.raises(OSError, match=told):
            save_world(tank, folder)


def test_a_folder_that_cannot_be_written_is_an_os_error_with_the_way_out(tank: World, tmp_path: Path) -> None:
    (tmp_path / "meshes.obj").mkdir()
    with pytest.raises(OSError, match=r"world: expected a folder that can be made and written.*--out"):
        save_world(tank, tmp_path)
    assert not (tmp_path / "world.json").exists()
