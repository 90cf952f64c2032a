"""The open formats of a world's files: NumPy arrays, Wavefront OBJ, tables of comma-separated values.

Readers trust nothing. What is damaged is refused with a ValueError that names file and field.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import arrays
from dream.sim.sampling import FACTOR, MILLIMETRE, QUATERNION, quantised
from dream.sim.world import Instances, Mesh

COLUMNS = "mesh,x,y,z,qw,qx,qy,qz,sx,sy,sz,red,green,blue,group"
MOST_BYTES = 256 * 1024 * 1024
"""No file of a world is larger."""
LARGEST = 2**31 - 1
"""What an index can hold."""


def readable(path: Path) -> Path:
    """The path, if it is a file of bearable size."""
    if not path.is_file():
        raise ValueError(
            f"{path.name}: expected a file in {path.parent}, got none. Is this the folder of a world?"
        )
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"{path.name}: expected at most {MOST_BYTES:,} bytes, got {size:,}")
    return path


def text(path: Path) -> str:
    """What the file says in UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path.name}: expected UTF-8 text, got byte {error.object[error.start]:#x} at {error.start}"
        ) from None


def read_heights(path: Path, shape: tuple[int, int]) -> npt.NDArray[np.float32]:
    """The float32 array of that shape."""
    return arrays.read(path, f"a float32 array {shape} as world.json says", shape, np.float32)


def obj(meshes: tuple[Mesh, ...]) -> str:
    """The meshes as an OBJ file, one object each, with colours on the vertices."""
    lines = ["# One object a mesh; vertices in metres with sRGB colours from 0 to 1."]
    first = 1
    for number, mesh in enumerate(meshes):
        lines.append(f"o mesh_{number}")
        vertices = quantised(mesh.vertices, MILLIMETRE).tolist()
        for (x, y, z), (r, g, b) in zip(vertices, (mesh.colors / 255.0).tolist(), strict=True):
            lines.append(f"v {x:.3f} {y:.3f} {z:.3f} {r:.4f} {g:.4f} {b:.4f}")
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + first).tolist()]
        first += len(mesh.vertices)
    return "\n".join(lines) + "\n"


def read_meshes(path: Path, counts: tuple[int, int, int], two_sided: list[int]) -> tuple[Mesh, ...]:
    """The meshes of an OBJ file.

    Args:
        path: The file.
        counts: Objects, vertices and faces that it must hold.
        two_sided: Indices of the meshes that are seen from both sides.
    """
    vertices: list[list[list[float]]] = []
    faces: list[list[list[int]]] = []
    for number, line in enumerate(text(path).splitlines(), 1):
        word, *values = line.split() or ["#"]
        try:
            if word == "o":
                vertices.append([])
                faces.append([])
            elif word == "v":
                x, y, z, r, g, b = map(float, values)
                vertices[-1].append([x, y, z, r, g, b])
            elif word == "f":
                i, j, k = (int(value.split("/")[0]) for value in values)
                if max(i, j, k) > LARGEST or min(i, j, k) < 1:
                    raise ValueError
                faces[-1].append([i, j, k])
        except (ValueError, IndexError):
            raise ValueError(
                f'{path.name}: line {number}: expected an object, then "v x y z red green blue" '
                f'and triangles "f i j k", got "{line[:60]}"'
            ) from None
    found = (len(vertices), sum(map(len, vertices)), sum(map(len, faces)))
    for what, count, wanted in zip(
        ("objects", "vertices", "faces"),
        found,
        counts,
        strict=True,
    ):
        if count != wanted:
            raise ValueError(
                f"{path.name}: {what}: expected {wanted} as world.json says, got {count}. If the file "
                "is whole, correct world.json"
            )
    meshes = []
    first = 1
    for number, (points, triangles) in enumerate(zip(vertices, faces, strict=True)):
        table = np.array(points, np.float64).reshape(-1, 6)
        if not ((table[:, 3:] >= 0.0) & (table[:, 3:] <= 1.0)).all():
            raise ValueError(
                f"{path.name}: object {number}: expected colours from 0 to 1, got {_worst(table[:, 3:])}"
            )
        corners = np.array(triangles, np.int64).reshape(-1, 3) - first
        meshes.append(
            Mesh(
                table[:, :3].astype(np.float32),
                corners.astype(np.int32),
                np.rint(table[:, 3:] * 255.0).astype(np.uint8),
                number in two_sided,
            )
        )
        first += len(points)
    return tuple(meshes)


def _worst(values: npt.NDArray[Any]) -> float:
    flat = values.ravel()
    return float(flat[~((flat >= 0.0) & (flat <= 1.0))][0])


def csv(table: Instances) -> str:
    """The instances as lines of comma-separated values under a header."""
    columns = zip(
        table.mesh.tolist(),
        quantised(table.position, MILLIMETRE).tolist(),
        quantised(table.wxyz, QUATERNION).tolist(),
        quantised(table.scale, FACTOR).tolist(),
        quantised(table.tint, FACTOR).tolist(),
        table.group.tolist(),
        strict=True,
    )
    lines = [
        ",".join(
            [
                str(mesh),
                *(f"{v:.3f}" for v in position),
                *(f"{v:.6f}" for v in wxyz),
                *(f"{v:.4f}" for v in (*scale, *tint)),
                str(group),
            ]
        )
        for mesh, position, wxyz, scale, tint, group in columns
    ]
    return "\n".join([COLUMNS, *lines]) + "\n"


def read_table(path: Path, rows: int) -> Instances:
    """The instances of a file that must hold that many."""
    header, *lines = text(path).splitlines() or [""]
    if header.strip() != COLUMNS:
        raise ValueError(f'{path.name}: expected the header "{COLUMNS}", got "{header[:80]}"')
    if len(lines) != rows:
        raise ValueError(
            f"{path.name}: rows: expected {rows} as world.json says, got {len(lines)}. If the file is whole, "
            "correct world.json"
        )
    values = np.empty((rows, 13))
    mesh, group = np.empty(rows, np.int32), np.empty(rows, np.int32)
    for k, line in enumerate(lines):
        try:
            first, *middle, last = line.split(",")
            mesh[k], group[k] = int(first), int(last)
            values[k] = [float(v) for v in middle]
        except (ValueError, OverflowError):
            raise ValueError(
                f'{path.name}: row {k}: expected 15 numbers ({COLUMNS}), got "{line[:80]}"'
            ) from None
    table = values.astype(np.float32)
    return Instances(mesh, table[:, :3], table[:, 3:7], table[:, 7:10], table[:, 10:13], group)
