"""RunScene → files for other programs: glTF for viewers, PLY for those who measure.

Both show the scene as it is at its end. References: glTF 2.0 (Khronos, ISO/IEC 12113:2022), binary form; PLY
(Turk 1994), binary, the lowest byte first.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.files import whole_or_nothing
from dream.scene.meshes import SceneMesh, meshes
from dream.scene.parts import LEGEND, NEVER, Float32Array, RunScene, SceneState

PATH_COLOR = (22, 82, 214)
"""sRGB of the vehicle's way."""
END = NEVER - 1
"""After all steps."""
_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_POINTS, _FACES = 34962, 34963
_LINE_STRIP, _TRIANGLES = 3, 4


def write_gltf(scene: RunScene, path: Path) -> None:
    """A binary glTF file, `.glb`: a node for each part, coloured by state, and the way as a line.

    glTF has y up: its x is east, its y is up and its z is south. Lengths are metres. The attribute `_STATE`
    of a vertex is its `SceneState`.

    Raises:
        OSError: It cannot be written.
    """
    glb = _Glb()
    for mesh in meshes(scene, END):
        glb.add(mesh.name, _mesh(glb, mesh))
    if len(scene.path.step) > 1:
        glb.add("path", _way(glb, scene.path.positions))
    with whole_or_nothing(path) as partial:
        partial.write_bytes(glb.content(scene.title))


def write_ply(scene: RunScene, path: Path) -> None:
    """A PLY file with all surfaces as one mesh, in the axes of the world: x east, y north, z up, metres.

    A vertex has a colour, its `state`, and in `part` which of the parts that the header names it belongs to.
    The way is not in it.

    Raises:
        OSError: It cannot be written.
    """
    parts = list(meshes(scene, END))
    vertices = np.concatenate([np.empty(0, _VERTEX), *(_vertices(mesh, i) for i, mesh in enumerate(parts))])
    firsts = np.cumsum([0, *(len(mesh.positions) for mesh in parts)])
    faces = np.concatenate(
        [np.empty(0, _FACE), *(_faces(mesh, int(first)) for mesh, first in zip(parts, firsts, strict=False))]
    )
    says = [
        _line(f"scene: {scene.title}"),
        "metres; x east, y north, z up",
        *(f"state {int(state)}: {name}" for state, (name, _) in LEGEND.items()),
        *(_line(f"part {number}: {mesh.name}") for number, mesh in enumerate(parts)),
    ]
    put_ply(path, says, vertices, faces)


def put_ply(path: Path, says: Sequence[str], vertices: npt.NDArray[Any], faces: npt.NDArray[Any]) -> None:
    """A PLY file of one mesh.

    Args:
        path: Of the file, which is there whole or not at all.
        says: Comments, a line each.
        vertices: (V,) records of `position`, (3,) float32, `color`, (3,) uint8 sRGB, and further bytes.
        faces: (F,) records of `count`, which is 3, and `corners`, (3,) indices of vertices.

    Raises:
        OSError: It cannot be written.
    """
    names = vertices.dtype.names or ()
    more = [name for name in names if name not in ("position", "color")]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in says),
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {name}" for name in ("red", "green", "blue", *more)),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    with whole_or_nothing(path) as partial, partial.open("wb") as stream:
        stream.write("\n".join(header).encode("ascii"))
        stream.write(vertices.tobytes())
        stream.write(faces.tobytes())


WRITERS = {".glb": write_gltf, ".ply": write_ply}
"""By the suffix of the file."""

_VERTEX = np.dtype([("position", "<f4", 3), ("color", "u1", 3), ("state", "u1"), ("part", "u1")])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def _vertices(mesh: SceneMesh, part: int) -> npt.NDArray[Any]:
    vertices = np.empty(len(mesh.positions), _VERTEX)
    vertices["position"], vertices["color"] = mesh.positions, mesh.colors
    vertices["state"], vertices["part"] = mesh.state, min(part, 255)
    return vertices


def _faces(mesh: SceneMesh, first: int) -> npt.NDArray[Any]:
    return triangles(mesh.faces + first)


def triangles(corners: npt.NDArray[np.integer]) -> npt.NDArray[Any]:
    """(F,) records of faces for `put_ply`, of their corners, (F, 3)."""
    faces = np.empty(len(corners), _FACE)
    faces["count"], faces["corners"] = 3, corners
    return faces


def _line(text: str) -> str:
    """On one line and in ASCII, as a comment has to be."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)


class _Glb:
    """A file in the making: what lies in its buffer, and what its JSON says of that."""

    def __init__(self) -> None:
        self.buffer = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []

    def add(self, name: str, primitive: dict[str, Any]) -> None:
        self.meshes.append({"name": name, "primitives": [primitive]})

    def accessor(self, array: npt.NDArray[Any], target: int, **told: Any) -> int:
        """The number of an accessor to an array of numbers, or of rows of them."""
        kinds = {"f4": _FLOAT, "u4": _UINT, "u2": _USHORT}
        rows = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
        content = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": content.nbytes, "target": target}
        )
        # All of these are whole words long, so that the next begins at one.
        self.buffer += content.tobytes()
        self.accessors.append(
            {
                "bufferView": len(self.views) - 1,
                "componentType": kinds[content.dtype.str[1:]],
                "count": len(array),
                "type": rows[1 if array.ndim == 1 else array.shape[1]],
                **told,
            }
        )
        return len(self.accessors) - 1

    def positions(self, world: Float32Array) -> int:
        """An accessor to positions, east, north and up in the world."""
        turned = world[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0], np.float32)
        low, high = turned.min(axis=0).tolist(), turned.max(axis=0).tolist()
        return self.accessor(turned, _POINTS, min=low, max=high)

    def content(self, title: str) -> bytes:
        """All of the file."""
        matte = {"baseColorFactor": [1.0, 1.0, 1.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}
        states = {str(int(state)): name for state, (name, _) in LEGEND.items()}
        told: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "DREAM", "extras": {"states": states}},
            "scene": 0,
            "scenes": [{"name": title}],
        }
        if self.meshes:
            told["scenes"][0]["nodes"] = list(range(len(self.meshes)))
            told |= {
                "nodes": [{"name": mesh["name"], "mesh": i} for i, mesh in enumerate(self.meshes)],
                "meshes": self.meshes,
                "materials": [{"name": "matte", "doubleSided": True, "pbrMetallicRoughness": matte}],
                "accessors": self.accessors,
                "bufferViews": self.views,
                "buffers": [{"byteLength": len(self.buffer)}],
            }
        words = json.dumps(told, allow_nan=False, separators=(",", ":")).encode()
        words += b" " * (-len(words) % 4)
        chunks = struct.pack("<I4s", len(words), b"JSON") + words
        if self.buffer:
            chunks += struct.pack("<I4s", len(self.buffer), b"BIN\0") + self.buffer
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _mesh(glb: _Glb, mesh: SceneMesh) -> dict[str, Any]:
    return {
        "mode": _TRIANGLES,
        "material": 0,
        "attributes": {
            "POSITION": glb.positions(mesh.positions),
            "COLOR_0": glb.accessor(_linear(mesh.colors), _POINTS, normalized=True),
            "_STATE": glb.accessor(mesh.state.astype(np.float32), _POINTS),
        },
        "indices": glb.accessor(mesh.faces.astype(np.uint32).reshape(-1), _FACES),
    }


def _way(glb: _Glb, positions: Float32Array) -> dict[str, Any]:
    colors = np.tile(np.array(PATH_COLOR, np.uint8), (len(positions), 1))
    states = np.full(len(positions), SceneState.OTHER, np.float32)
    return {
        "mode": _LINE_STRIP,
        "material": 0,
        "attributes": {
            "POSITION": glb.positions(positions),
            "COLOR_0": glb.accessor(_linear(colors), _POINTS, normalized=True),
            "_STATE": glb.accessor(states, _POINTS),
        },
    }


def _linear(srgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint16]:
    """(V, 4) colours as light adds up, opaque, in 65535ths: what glTF has at a vertex."""
    shares = srgb / 255.0
    light = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    opaque = np.column_stack([light, np.ones(len(light))])
    return np.rint(65535.0 * opaque).astype(np.uint16)
