"""Meshes of other programs, PLY, OBJ and STL, as one surface of triangles.

Formats: PLY, Turk 1994, text and binary of either byte order; OBJ, see `wavefront`; STL, 3D Systems 1989,
text and binary. Readers trust nothing: what is damaged or too large is refused with a ValueError that says
what was expected and what was found.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.sim import wavefront
from dream.sim.world import UInt8Array

Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MOST_BYTES = 512 * 1024 * 1024
MOST_TRIANGLES = 2_000_000
MOST_HEADER = 65_536
"""Bytes of the header of a PLY file."""
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_CORNERS = ("vertex_indices", "vertex_index")
_COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))


@dataclass(frozen=True, slots=True, eq=False)
class ReadMesh:
    """Triangles in the axes and units of their file."""

    vertices: Float64Array
    """(V, 3)."""
    faces: IntArray
    """(F, 3) vertex indices."""
    colors: UInt8Array | None
    """(V, 3) sRGB; None where the file has none."""
    told: tuple[str, ...]
    """What was read in another way than it stands there."""


def read_surface(path: Path) -> ReadMesh:
    """All objects of a file as one surface.

    Raises:
        ValueError: It is no such file, damaged, or larger than `MOST_TRIANGLES`.
    """
    readers = {".ply": _ply, ".obj": _obj, ".stl": _stl}
    if not path.is_file():
        raise ValueError(
            f"{path}: expected a file with a mesh, got {'a folder' if path.is_dir() else 'none'}"
        )
    if path.suffix.lower() not in readers:
        raise ValueError(
            f"{path}: expected a mesh in .ply, .obj or .stl, got {path.suffix or 'no ending'}. Export it as "
            "PLY, with colours on the vertices"
        )
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES:,} bytes, got {size:,}. Simplify the mesh")
    try:
        surface = readers[path.suffix.lower()](path)
    except (OverflowError, IndexError):  # As fractions, or past all that a file may hold.
        raise ValueError(f"{path}: expected whole numbers of vertices as corners, got others") from None
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path.name}: ')}") from error
    _check(surface, path)
    return surface


def _check(surface: ReadMesh, path: Path) -> None:
    count, vertices = len(surface.faces), surface.vertices
    if not count:
        raise ValueError(f"{path}: expected triangles, got none. Is it a cloud of points? Mesh it first")
    if count > MOST_TRIANGLES:
        raise ValueError(f"{path}: expected at most {MOST_TRIANGLES:,} triangles, got {count:,}. Simplify it")
    if not np.isfinite(vertices).all():
        row = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
        raise ValueError(f"{path}: vertex {row}: expected finite numbers, got {vertices[row].tolist()}")
    low, high = int(surface.faces.min()), int(surface.faces.max())
    if low < 0 or high >= len(vertices):
        got = low if low < 0 else high
        raise ValueError(f"{path}: expected corners from 0 to {len(vertices) - 1}, got {got}")


def _obj(path: Path) -> ReadMesh:
    return ReadMesh(*wavefront.read_surface(path))


def _stl(path: Path) -> ReadMesh:
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little") if len(content) >= 84 else -1
    if len(content) == 84 + 50 * count:
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        corners = np.frombuffer(content, facet, count, 84)["corners"].astype(np.float64)
    else:
        words = content.split()
        at = [k for k, word in enumerate(words) if word == b"vertex"]
        if not at and count >= 0:
            raise ValueError(
                f"expected {84 + 50 * count:,} bytes of {count:,} triangles, got {len(content):,}"
            )
        try:
            corners = np.array([words[k + 1 : k + 4] for k in at], np.float64).reshape(-1, 3, 3)
        except ValueError:
            raise ValueError('expected lines "vertex x y z", three a facet, got others') from None
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return ReadMesh(vertices, index.reshape(-1, 3).astype(np.int64), None, ())


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    """NumPy's code of the number, or of each in a list."""
    count: str | None
    """NumPy's code of how many are in a list; None of a single number."""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def _ply(path: Path) -> ReadMesh:
    content = path.read_bytes()
    order, elements, begin = _header(content)
    tables: dict[str, dict[str, Any]] = {}
    lines = content[begin:].splitlines() if order is None else []
    for element in elements:
        if order is None:
            rows, lines = lines[: element.count], lines[element.count :]
            if len(rows) < element.count:
                raise ValueError(f"expected {element.count} lines of {element.name}, got {len(rows)}")
            tables[element.name] = _text_rows(element, rows)
        else:
            tables[element.name], begin = _binary_rows(element, content, begin, order)
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    missing = [axis for axis in "xyz" if axis not in vertex]
    if missing:
        raise ValueError(f"expected vertices with x, y and z, got none of {', '.join(missing)}")
    vertices = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(np.float64)
    corners = next((face[name] for name in _CORNERS if name in face), None)
    if corners is None:
        raise ValueError(f"expected faces with {' or '.join(_CORNERS)}, got {', '.join(face) or 'no faces'}")
    told: list[str] = []
    if isinstance(corners, list):
        corners = _triangles(corners, vertices, told)
    colors = None
    for names in _COLORS:
        if all(name in vertex for name in names):
            levels = np.stack([vertex[name] for name in names], axis=1)
            if levels.dtype.kind == "f" and levels.max(initial=0.0) <= 1.0:
                levels = 255.0 * levels
            colors = np.clip(np.rint(levels.astype(np.float64)), 0, 255).astype(np.uint8)
            break
    return ReadMesh(vertices, np.asarray(corners, np.int64), colors, tuple(told))


def _header(content: bytes) -> tuple[str | None, list[_Element], int]:
    """NumPy's byte order, None of text; the elements; and where the first begins."""
    head = content[:MOST_HEADER]
    end = head.find(b"end_header")
    stop = head.find(b"\n", end)
    if not head.startswith(b"ply") or end < 0 or stop < 0:
        raise ValueError('expected a header from "ply" to "end_header", got another file')
    orders = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
    order: str | None = ""
    elements: list[_Element] = []
    for line in head[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        try:
            match words:
                case ["format", name, _]:
                    order = orders[name]
                case ["element", name, count] if int(count) >= 0:
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", count, kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], None))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (KeyError, IndexError, ValueError):
            raise ValueError(f'expected a line of a PLY header, got "{line[:60]}"') from None
    if order == "":
        raise ValueError("expected a line with the format in the header, got none")
    return order, elements, stop + 1


def _text_rows(element: _Element, rows: list[bytes]) -> dict[str, Any]:
    lists = any(one.count is not None for one in element.properties)
    names = [one.name for one in element.properties]
    try:
        if not lists:
            table = np.array(b" ".join(rows).split(), np.float64).reshape(len(rows), -1)
            if len(rows) and table.shape[1] != len(names):
                raise ValueError
            return {name: table[:, k] for k, name in enumerate(names)} if len(rows) else {}
        found: dict[str, list[Any]] = {name: [] for name in names}
        for row in rows:
            words, at = row.split(), 0
            for one in element.properties:
                if one.count is None:
                    found[one.name].append(float(words[at]))
                    at += 1
                else:
                    size = int(words[at])
                    values = [int(float(word)) for word in words[at + 1 : at + 1 + size]]
                    if len(values) != size:
                        raise ValueError
                    found[one.name].append(values)
                    at += 1 + size
        return found
    except (ValueError, IndexError, OverflowError):
        raise ValueError(
            f"{element.name}: expected numbers for {', '.join(names)}, got other lines"
        ) from None


def _binary_rows(element: _Element, content: bytes, begin: int, order: str) -> tuple[dict[str, Any], int]:
    """The element's columns, and where the next element begins."""
    sizes = {}
    at = begin
    for one in element.properties:  # As long as those of the first row, lists are read at once.
        if one.count is not None:
            width = np.dtype(one.count).itemsize
            sizes[one.name] = int.from_bytes(content[at : at + width], "little" if order == "<" else "big")
            at += width + sizes[one.name] * np.dtype(one.kind).itemsize
        else:
            at += np.dtype(one.kind).itemsize
    if element.count and at > len(content):
        raise ValueError(f"expected {element.count} rows of {element.name}, got {len(content) - begin} bytes")
    fields: list[Any] = []
    for one in element.properties:
        if one.count is None:
            fields.append((one.name, order + one.kind))
        else:
            fields += [
                (f"{one.name} count", order + one.count),
                (one.name, order + one.kind, (sizes[one.name],)),
            ]
    row = np.dtype(fields)
    whole = begin + row.itemsize * element.count <= len(content)
    if whole:
        table = np.frombuffer(content, row, element.count, begin)
        if all((table[f"{name} count"] == size).all() for name, size in sizes.items()):
            columns: dict[str, Any] = {one.name: table[one.name] for one in element.properties}
            for name, size in sizes.items():
                if size != 3:
                    columns[name] = list(columns[name].tolist())
            return columns, begin + row.itemsize * element.count
    elif not sizes:
        got = (len(content) - begin) // max(row.itemsize, 1)
        raise ValueError(f"expected {element.count} rows of {element.name}, got {got}")
    return _one_by_one(element, content, begin, order)


def _one_by_one(element: _Element, content: bytes, begin: int, order: str) -> tuple[dict[str, Any], int]:
    """Rows whose lists differ in length."""
    found: dict[str, list[Any]] = {one.name: [] for one in element.properties}
    single = {one.name: np.dtype(order + one.kind) for one in element.properties}
    count = {one.name: np.dtype(order + one.count) for one in element.properties if one.count is not None}
    for number in range(element.count):
        try:
            for one in element.properties:
                size = 1
                if one.count is not None:
                    size = int(np.frombuffer(content, count[one.name], 1, begin)[0])
                    begin += count[one.name].itemsize
                    if size < 0:
                        raise ValueError
                values = np.frombuffer(content, single[one.name], size, begin)
                begin += values.nbytes
                found[one.name].append(values.tolist() if one.count is not None else values[0])
        except ValueError:
            raise ValueError(f"expected {element.count} rows of {element.name}, got {number}") from None
    return found, begin


def _triangles(faces: list[list[int]], vertices: Float64Array, told: list[str]) -> IntArray:
    """Faces of any number of corners, split."""
    split, left = 0, 0
    found: list[tuple[int, int, int]] = []
    for face in faces:
        if len(face) == 3:
            found.append((face[0], face[1], face[2]))
        elif len(face) < 3:
            left += 1
        elif not 0 <= min(face) <= max(face) < len(vertices):
            raise ValueError(f"expected corners from 0 to {len(vertices) - 1}, got {max(face)}")
        else:
            fan = wavefront.fan(vertices[face])
            if fan is None:
                raise ValueError(
                    f"expected polygons that are fans of triangles, got one of {len(face)} corners that is "
                    "none. Triangulate the mesh"
                )
            found += [(face[a], face[b], face[c]) for a, b, c in fan]
            split += 1
    if split:
        told.append(f"{split:,} polygons split into triangles")
    if left:
        told.append(f"{left:,} faces of less than three corners passed over")
    return np.array(found, np.int64).reshape(-1, 3)
