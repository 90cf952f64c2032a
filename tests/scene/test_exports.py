"""Files for other programs, read back by what their standards say: no reader of ours has a part in it."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.cli import run_command
from dream.recording import write_config
from dream.scene import NEVER, SPACE, RunScene, SceneState, made, mapped, save
from dream.scene.exports import write_gltf, write_ply
from dream.scene.meshes import meshes
from dream.scene.parts import LEGEND
from tests.recorded_runs import CONFIG
from tests.scene.test_building import ABOUT

Array = npt.NDArray[Any]
NUMBERS = {5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class Gltf:
    """A binary glTF file, taken apart and checked by its standard."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", content)
        assert (magic, version, length) == (b"glTF", 2, len(content))
        chunks, at = [], 12
        while at < length:
            size, kind = struct.unpack_from("<I4s", content, at)
            assert size % 4 == 0
            chunks.append((kind, content[at + 8 : at + 8 + size]))
            at += 8 + size
        assert at == length
        assert [kind for kind, _ in chunks] == [b"JSON", b"BIN\0"][: len(chunks)]
        self.told = json.loads(chunks[0][1])
        self.binary = chunks[1][1] if len(chunks) > 1 else b""
        assert self.told["asset"]["version"] == "2.0"
        if self.binary:
            (buffer,) = self.told["buffers"]
            assert buffer["byteLength"] == len(self.binary)

    def accessor(self, number: int) -> Array:
        told = self.told["accessors"][number]
        view = self.told["bufferViews"][told["bufferView"]]
        kind, width = np.dtype(NUMBERS[told["componentType"]]), WIDTHS[told["type"]]
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(self.binary)
        assert told["count"] * width * kind.itemsize == view["byteLength"]
        assert view["target"] in (34962, 34963)
        if view["target"] == 34962:
            assert width * kind.itemsize % 4 == 0
        values: Array = np.frombuffer(self.binary, kind, told["count"] * width, view["byteOffset"])
        values = values.reshape(-1, width)
        if "min" in told:
            assert told["min"] == values.min(axis=0).tolist()
            assert told["max"] == values.max(axis=0).tolist()
        return values

    def parts(self) -> dict[str, tuple[int, dict[str, Array], Array | None]]:
        """Mode, attributes and indices of each node's mesh."""
        found = {}
        for node in (self.told["nodes"][number] for number in self.told["scenes"][0]["nodes"]):
            (primitive,) = self.told["meshes"][node["mesh"]]["primitives"]
            assert primitive["material"] < len(self.told["materials"])
            attributes = {name: self.accessor(at) for name, at in primitive["attributes"].items()}
            assert "min" in self.told["accessors"][primitive["attributes"]["POSITION"]]
            assert len({len(values) for values in attributes.values()}) == 1
            indices = self.accessor(primitive["indices"]) if "indices" in primitive else None
            if indices is not None:
                assert indices.max() < len(attributes["POSITION"])
            found[node["name"]] = (primitive["mode"], attributes, indices)
        return found


def test_gltf_holds_each_part_with_y_up(wreck: RunScene, tmp_path: Path) -> None:
    write_gltf(wreck, tmp_path / "wreck.glb")
    parts = Gltf(tmp_path / "wreck.glb").parts()
    assert list(parts) == ["hull", "obstacles", "seabed", "mapped", "path"]
    mode, hull, faces = parts["hull"]
    assert mode == 4
    assert faces is not None
    corners = hull["POSITION"][faces.reshape(-1, 3)]
    east, up, south = np.moveaxis(corners, -1, 0)
    np.testing.assert_array_equal(np.stack([east, -south, up], -1), wreck.targets.triangles)
    np.testing.assert_array_equal(hull["_STATE"][:, 0], wreck.states(NEVER - 1)[wreck.targets.owner])
    mode, way, faces = parts["path"]
    assert (mode, faces) == (3, None)
    np.testing.assert_array_equal(way["POSITION"][:, 1], wreck.path.positions[:, 2])


def test_gltf_colours_are_light_and_those_of_the_legend(wreck: RunScene, tmp_path: Path) -> None:
    write_gltf(wreck, tmp_path / "wreck.glb")
    _, hull, _ = Gltf(tmp_path / "wreck.glb").parts()["hull"]
    light = hull["COLOR_0"] / 65535.0
    assert (light[:, 3] == 1.0).all()
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)[:, :3]
    legend = np.array([color for _, color in LEGEND.values()])
    np.testing.assert_allclose(255.0 * srgb, legend[hull["_STATE"][:, 0].astype(int)], atol=0.1)


def test_an_empty_scene_is_an_empty_file(tmp_path: Path) -> None:
    write_gltf(made(**ABOUT), tmp_path / "none.glb")
    told = Gltf(tmp_path / "none.glb").told
    assert told["scenes"] == [{"name": "a box"}]
    assert "buffers" not in told
    write_ply(made(**ABOUT), tmp_path / "none.ply")
    assert ply(tmp_path / "none.ply")[1:] == (0, 0)


def ply(path: Path) -> tuple[list[str], Any, Any]:
    """Header, vertices and faces of a PLY file; of none their count."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {"float": "<f4", "uchar": "u1", "int": "<i4"}
    counts: dict[str, int] = {}
    fields: dict[str, list[tuple[str, str]]] = {}
    for words in (line.split() for line in lines[2:]):
        if words[0] == "element":
            name = words[1]
            counts[name], fields[name] = int(words[2]), []
        elif words[0] == "property" and words[1] == "list":
            assert words[4] == "vertex_indices"
            fields[name] += [("count", kinds[words[2]]), *((c, kinds[words[3]]) for c in "abc")]
        elif words[0] == "property":
            fields[name].append((words[2], kinds[words[1]]))
        else:
            assert words[0] == "comment"
    vertex, face = np.dtype(fields["vertex"]), np.dtype(fields["face"])
    assert len(body) == counts["vertex"] * vertex.itemsize + counts["face"] * face.itemsize
    if not counts["vertex"]:
        return lines, 0, 0
    vertices = np.frombuffer(body, vertex, counts["vertex"])
    return lines, vertices, np.frombuffer(body, face, counts["face"], vertices.nbytes)


def test_ply_holds_all_parts_in_the_axes_of_the_world(wreck: RunScene, tmp_path: Path) -> None:
    write_ply(replace(wreck, title="a wreck\nelement vertex 7 ü"), tmp_path / "wreck.ply")
    lines, vertices, faces = ply(tmp_path / "wreck.ply")
    assert "comment scene: a wreck?element vertex 7 ?" in lines
    names = [mesh.name for mesh in meshes(wreck, NEVER - 1)]
    assert [line for line in lines if "part " in line] == [
        f"comment part {number}: {name}" for number, name in enumerate(names)
    ]
    assert (faces["count"] == 3).all()
    hull = vertices["part"][faces["a"]] == 0
    corners = np.stack([np.stack([vertices[axis][faces[c][hull]] for axis in "xyz"], -1) for c in "abc"], 1)
    np.testing.assert_array_equal(corners, wreck.targets.triangles)
    legend = np.array([color for _, color in LEGEND.values()])
    colors = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    np.testing.assert_array_equal(colors, legend[vertices["state"]])
    states = wreck.states(NEVER - 1)
    assert (vertices["state"][vertices["part"] == 0] == SceneState.INSPECTED).sum() == (
        states[wreck.targets.owner] == SceneState.INSPECTED
    ).sum()


def test_kinds_of_target_are_parts_of_their_own(wreck: RunScene) -> None:
    kind = (np.arange(len(wreck.kind)) % 2).astype(np.uint8)
    both = list(meshes(replace(wreck, kinds=("hull", "oysters"), kind=kind), NEVER - 1))
    assert [mesh.name for mesh in both[:2]] == ["hull", "oysters"]
    assert len(both[0].faces) + len(both[1].faces) == len(wreck.targets.faces)
    odd = kind[wreck.targets.face_owner] == 1
    np.testing.assert_array_equal(both[1].positions[both[1].faces], wreck.targets.triangles[odd])


def test_two_voxels_beside_each_other_are_a_box_that_is_closed_and_faces_outwards() -> None:
    voxels = mapped(0.5, [[1.0, 2.0, -3.0], [1.5, 2.0, -3.0]], [True, False], [0, 0], [4, -1])
    (box,) = meshes(made(**ABOUT, voxels=voxels), 4)
    corners = box.positions[box.faces].astype(float)
    assert len(corners) == 2 * 10
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = (normals * corners[:, 0]).sum() / 6.0
    assert volume == pytest.approx(2 * 0.5**3)
    assert sorted(set(box.state.tolist())) == [SceneState.OTHER, SceneState.INSPECTED]


def test_the_command_makes_either_file_and_writes_over_none(
    wreck: RunScene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run := tmp_path / "run").mkdir()
    write_config(run, CONFIG)
    words = ["export", str(run), "--to"]
    assert run_command([*words, str(tmp_path / "wreck.glb")]) != 0
    assert "got no space.npz in it" in capsys.readouterr().err
    save(wreck, run / SPACE)
    assert run_command([*words, str(tmp_path / "wreck.glb"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bytes"] == (tmp_path / "wreck.glb").stat().st_size
    assert Gltf(tmp_path / "wreck.glb").told["scenes"][0]["name"] == wreck.title
    assert run_command([*words, str(tmp_path / "WRECK.PLY")]) == 0
    assert len(ply(tmp_path / "WRECK.PLY")[1]) > 1000
    assert run_command([*words, str(tmp_path / "wreck.glb")]) != 0
    assert "expected a file that does not exist" in capsys.readouterr().err
    assert run_command([*words, str(tmp_path / "nowhere" / "x.ply")]) != 0
    assert "could not write" in capsys.readouterr().err
