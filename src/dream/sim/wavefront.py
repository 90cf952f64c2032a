"""Wavefront OBJ: written as a world's meshes are, and read as other programs write it.

Format: Object Files, Appendix B1 of the Advanced Visualizer manual, Wavefront Technologies; colours behind a
vertex as MeshLab, Blender and CloudCompare write them. What is read is taken as it is, turned so that its
faces look outwards, or refused by its line; `Said` keeps which.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.sim.formats import Said, text
from dream.sim.sampling import MILLIMETRE, quantised
from dream.sim.winding import Standing, turned
from dream.sim.world import Mesh, UInt8Array
from dream.telling import one_line

Float64Array = npt.NDArray[np.float64]

GREY = 0.5
"""sRGB of a vertex without a colour."""
MOST_CORNERS = 1000
"""Of one face."""
MOST_TOLD = 20
"""Lines that are refused one by one; of more there is the number."""


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


def read_meshes(
    path: Path,
    counts: tuple[int, int, int] | None,
    two_sided: Collection[int],
    *,
    y_up: bool = False,
    standing: Standing | None = None,
) -> tuple[tuple[Mesh, ...], list[str], list[Said]]:
    """The meshes of an OBJ file, the names of its objects, and what is to be said of it.

    Args:
        path: The file.
        counts: Objects, vertices and faces that it must hold; faces as they stand there, or as triangles.
            None where nobody says.
        two_sided: Indices of the meshes that are seen from both sides.
        y_up: Its y is up; then it is turned.
        standing: Starts of the vehicle in the frame of a mesh: a room around one looks inwards.

    Returns:
        What is refused is among what is said; the meshes then are not all, or not whole.
    """
    content = _parsed(path)
    objects, told = content.objects, _Notes(path.name)
    told.lines(content.refused)
    triangles = sum(len(one.faces) + sum(len(face) - 3 for face in one.faces) for one in objects)
    faces = sum(len(one.faces) for one in objects)
    if counts is not None:
        found = (len(objects), len(content.vertices), faces)
        for what, count, wanted in zip(("objects", "vertices", "faces"), found, counts, strict=True):
            if count != wanted and not (what == "faces" and wanted == triangles):
                said = (
                    f"{count}"
                    if what != "faces" or triangles == faces
                    else f"{count} ({triangles} triangles)"
                )
                told.refused(
                    f"{what}: expected {wanted} as world.json says, got {said}. If the file is whole, "
                    "correct world.json"
                )
    table = np.array(content.vertices, np.float64).reshape(-1, 6)
    if y_up:
        table[:, :3] = np.stack([table[:, 0], -table[:, 2], table[:, 1]], axis=1)
        told.turned("y is up, as world.json says: x, −z, y")
    _colored(objects, table, told)
    meshes = [_mesh(number, one, table, number in two_sided, told) for number, one in enumerate(objects)]
    names = [one.name for one in objects]
    if split := triangles - faces:
        polygons = sum(len(face) > 3 for one in objects for face in one.faces)
        told.taken(f"{_many(polygons, 'polygon')} split into triangles, {split} more faces")
    if content.from_the_end:
        told.taken(f"{_many(content.from_the_end, 'face')} counted from the end")
    if grey := content.grey:
        told.taken(f"{_many(grey, 'vertex', 'vertices')} without colour, taken for grey")
    if content.materials:
        told.taken("materials and textures are passed over: only colours behind a vertex count")
    whole = all(note.what != "refused" for note in told.notes)
    if whole:
        if flat := _flat(meshes):
            told.taken(f"{_many(flat, 'face')} without area, which nobody sees")
        meshes = _oriented(meshes, names, standing, told)
    return tuple(meshes), names, told.notes


def read_surface(
    path: Path,
) -> tuple[Float64Array, npt.NDArray[np.int64], UInt8Array | None, tuple[str, ...]]:
    """All objects of an OBJ file as one surface, as they are wound there.

    Returns:
        (V, 3) in double precision; (F, 3); (V, 3) sRGB, None where the file has no colours; and what was
        taken in another way than it stands there.

    Raises:
        ValueError: What is refused first.
    """
    content = _parsed(path)
    objects, told = content.objects, _Notes(path.name)
    told.lines(content.refused)
    table = np.array(content.vertices, np.float64).reshape(-1, 6)
    colored = len(table) > content.grey
    _colored(objects, table, told)
    faces: list[list[int]] = []
    for one in objects:
        faces += _split(one, table, told) if any(len(face) != 3 for face in one.faces) else one.faces
    if content.materials:
        told.taken("materials and textures are passed over: only colours behind a vertex count")
    for note in told.notes:
        if note.what == "refused":
            raise ValueError(note.words)
    levels = np.rint(np.clip(table[:, 3:], 0.0, 1.0) * 255.0).astype(np.uint8) if colored else None
    corners = np.array(faces, np.int64).reshape(-1, 3)
    return table[:, :3].copy(), corners, levels, tuple(note.words for note in told.notes)


@dataclass(slots=True)
class _Notes:
    """What is said of one file."""

    file: str
    notes: list[Said] = field(default_factory=list)

    def taken(self, words: str) -> None:
        self.notes.append(Said("taken", self.file, words))

    def turned(self, words: str) -> None:
        self.notes.append(Said("turned", self.file, words))

    def refused(self, words: str) -> None:
        self.notes.append(Said("refused", self.file, words))

    def lines(self, refused: list[str]) -> None:
        for words in refused[:MOST_TOLD]:
            self.refused(words)
        if len(refused) > MOST_TOLD:
            self.refused(f"{len(refused) - MOST_TOLD} more lines like these")


@dataclass(slots=True)
class _Object:
    """One object as it stands there."""

    name: str
    first: int
    """Index of its first vertex in the file."""
    past: int
    """Past its last one."""
    faces: list[list[int]] = field(default_factory=list)
    """Indices of vertices of the file, three or more a face."""
    lines: list[int] = field(default_factory=list)
    """Where each face stands."""


@dataclass(slots=True)
class _Content:
    """What a file says, line by line."""

    vertices: list[list[float]] = field(default_factory=list)
    """x, y, z, red, green, blue."""
    objects: list[_Object] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    grey: int = 0
    from_the_end: int = 0
    materials: bool = False


def _parsed(path: Path) -> _Content:
    content = _Content()
    vertices, objects, farthest = content.vertices, content.objects, -1
    for number, line in enumerate(_lines(text(path)), 1):
        word, *values = line.split() or ["#"]
        try:
            if word == "v":
                vertices.append(_vertex(values, content))
                if objects:
                    objects[-1].past = len(vertices)
            elif word == "f":
                if not objects:
                    objects.append(_Object("", 0, len(vertices)))
                face = _face(values, len(vertices), content)
                farthest = max(farthest, *face)
                objects[-1].faces.append(face)
                objects[-1].lines.append(number)
            elif word == "o":
                objects.append(_Object(" ".join(values), len(vertices), len(vertices)))
            elif word in ("usemtl", "mtllib"):
                content.materials = True
        except ValueError as error:
            if word == "v":
                vertices.append([np.nan] * 6)  # Those that follow keep their numbers.
            why = str(error) if str(error).startswith("expected") else "expected numbers"
            content.refused.append(f'line {number}: {why}, got "{one_line(line)[:60]}"')
    if farthest >= len(vertices):
        for one in objects:
            for face, number in zip(one.faces, one.lines, strict=True):
                if max(face) >= len(vertices):
                    content.refused.append(
                        f"line {number}: expected vertices 1 to {len(vertices)}, got {max(face) + 1}"
                    )
    return content


def _lines(content: str) -> list[str]:
    """Lines without comments, each with those that it is continued by; empty in place of these."""
    lines = content.removeprefix("\ufeff").splitlines()
    if "#" in content:
        lines = [line.split("#", 1)[0] if "#" in line else line for line in lines]
    if "\\" in content:
        for k in range(len(lines) - 1):
            if lines[k].endswith("\\"):
                lines[k], lines[k + 1] = "", f"{lines[k][:-1]} {lines[k + 1]}"
    return lines


def _vertex(values: list[str], content: _Content) -> list[float]:
    numbers = list(map(float, values))
    if not all(map(math.isfinite, numbers)):
        raise ValueError("expected finite numbers")
    if len(numbers) == 6:
        return numbers
    if len(numbers) == 4 and numbers[3] == 1.0:
        numbers.pop()  # The weight of a rational curve.
    if len(numbers) != 3:
        raise ValueError('expected "v x y z" or "v x y z red green blue"')
    content.grey += 1
    return [*numbers, GREY, GREY, GREY]


def _face(values: list[str], vertices: int, content: _Content) -> list[int]:
    """Indices from 0, of corners such as 3, 3/1, 3//2 or -1."""
    if not 3 <= len(values) <= MOST_CORNERS:
        raise ValueError(f"expected a face of 3 to {MOST_CORNERS} corners, such as triangles have")
    if any("/" in value for value in values):
        values = [value.split("/", 1)[0] for value in values]
    corners = list(map(int, values))
    if min(corners) < 0:
        content.from_the_end += 1
        corners = [corner if corner >= 0 else max(vertices + 1 + corner, 0) for corner in corners]
    if min(corners) < 1:
        raise ValueError(f"expected vertices from 1, or from −1 to {-vertices} from the end")
    return [corner - 1 for corner in corners]


def _colored(objects: list[_Object], table: Float64Array, told: _Notes) -> None:
    """Colours as they are from 0 to 1, in place; those from 0 to 255 are divided."""
    good = (table[:, 3:] >= 0.0) & (table[:, 3:] <= 1.0) | np.isnan(table[:, :1])
    if good.all():
        return
    for number, one in enumerate(objects):
        colors, fine = table[one.first : one.past, 3:], good[one.first : one.past]
        if fine.all():
            continue
        whole = colors[~np.isnan(colors).any(axis=1)]
        bright = np.count_nonzero((whole > 1.0).any(axis=1))
        steps = (whole == np.rint(whole)).all() and (whole >= 0.0).all() and (whole <= 255.0).all()
        if steps and 2 * bright > len(colors):
            told.taken(f"{_called(number, one.name)}: colours from 0 to 255")
            colors /= 255.0
        else:
            told.refused(f"object {number}: expected colours from 0 to 1, got {colors[~fine][0]:g}")


def _mesh(number: int, one: _Object, table: Float64Array, two_sided: bool, told: _Notes) -> Mesh:
    """One object as a mesh; empty where it cannot be."""
    if not one.faces:
        told.refused(
            f"{_called(number, one.name)}: expected faces, got none. Take it out, or make a mesh of the curve"
        )
    triangles = one.faces
    if any(len(face) != 3 for face in one.faces):
        triangles = _split(one, table, told)
    corners = np.array([face for face in triangles if max(face) < len(table)], np.int64).reshape(-1, 3)
    own_corners = (corners >= one.first) & (corners < one.past)
    if len(corners) and one.past > one.first and not own_corners.any():
        told.refused(
            f"{_called(number, one.name)}: expected faces between its {one.past - one.first} vertices, got "
            "faces between those of others. They count from the first vertex of the file, not of the object"
        )
    if not own_corners.all():
        used, corners = np.unique(corners, return_inverse=True)  # Vertices that stand with another object.
        corners, own = corners.reshape(-1, 3), table[used]
    else:
        corners, own = corners - one.first, table[one.first : one.past]
    with np.errstate(over="ignore"):
        points = own[:, :3].astype(np.float32)
    levels = np.rint(np.nan_to_num(np.clip(own[:, 3:], 0.0, 1.0)) * 255.0).astype(np.uint8)
    return Mesh(points, corners.astype(np.int32), levels, two_sided)


def _split(one: _Object, table: Float64Array, told: _Notes) -> list[list[int]]:
    """The faces of an object as triangles."""
    triangles: list[list[int]] = []
    for face, line in zip(one.faces, one.lines, strict=True):
        if len(face) == 3 or max(face) >= len(table):
            triangles.append(face[:3])
        elif (split := fan(table[face, :3])) is not None:
            triangles += [[face[k] for k in corner] for corner in split]
        else:
            told.refused(f"line {line}: expected a polygon that is a fan of triangles. Triangulate the mesh")
    return triangles


def fan(corners: Float64Array) -> list[tuple[int, int, int]] | None:
    """Triangles of a polygon, all from one corner of it and none turned over; None where there are none such.

    Args:
        corners: (k, 3) metres.
    """
    k = len(corners)
    middle = corners - corners.mean(axis=0)
    normal = np.cross(middle, np.roll(middle, -1, axis=0)).sum(axis=0)  # Newell's.
    for first in range(k):
        fan = [(first, (first + i) % k, (first + i + 1) % k) for i in range(1, k - 1)]
        a, b, c = (corners[[corner[side] for corner in fan]] for side in range(3))
        facing = np.cross(b - a, c - a) @ normal
        if not (facing < -1e-9 * (normal @ normal)).any():
            return fan
        if k > 100:
            break  # Trying every corner of a large one takes long.
    return None


def _flat(meshes: list[Mesh]) -> int:
    """How many of all faces have no area."""
    if not meshes:
        return 0
    a, b, c = (
        np.concatenate([mesh.vertices[mesh.faces[:, side]] for mesh in meshes]).astype(np.float64)
        for side in range(3)
    )
    with np.errstate(over="ignore", invalid="ignore"):
        return int((np.cross(b - a, c - a) == 0.0).all(axis=1).sum())


def _oriented(meshes: list[Mesh], names: list[str], standing: Standing | None, told: _Notes) -> list[Mesh]:
    """All meshes with their faces outwards, as far as they show where that is."""
    turn = turned(meshes, standing)
    done = []
    for number, mesh in enumerate(meshes):
        called, flip = _called(number, names[number]), turn.flips[number]
        if number in turn.endless:
            told.refused(
                f"{called}: expected faces with an inside and an outside, got a surface that has but one. "
                "List it under two_sided in world.json"
            )
        elif flip.any():
            wound = (
                "wound inside out" if flip.all() else f"of which {int(flip.sum())} were wound the other way"
            )
            told.turned(f"{called}: {_many(len(flip), 'face')}, {wound}")
            faces = np.where(flip[:, None], mesh.faces[:, [0, 2, 1]], mesh.faces)
            mesh = replace(mesh, faces=faces)
        done.append(mesh)
    if turn.rooms:
        told.taken(
            f"{_many(len(turn.rooms), 'object')} around a start, with faces inwards as a room's: "
            f"{_shown(turn.rooms, names)}. Seen from within"
        )
    if turn.open_ones:
        told.taken(
            f"{_many(len(turn.open_ones), 'object')} open, so that nothing tells which side is out: "
            f"{_shown(turn.open_ones, names)}. Seen from where corners run counter-clockwise; "
            "list under two_sided what is seen from both"
        )
    return done


def _shown(numbers: list[int], names: list[str]) -> str:
    """The first of some objects."""
    return ", ".join(_called(number, names[number]) for number in numbers[:3]) + ", ..." * (len(numbers) > 3)


def _called(number: int, name: str) -> str:
    return f"object {number} ({one_line(name)[:40]})" if name else f"object {number}"


def _many(count: int, one: str, more: str = "") -> str:
    return f"{count:,} {one if count == 1 else more or one + 's'}"
