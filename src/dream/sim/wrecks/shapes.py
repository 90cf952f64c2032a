"""Sheets, boxes and beams, each already divided into patches of about half a metre."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.sim.sampling import direction, directions, length, products, steady
from dream.sim.wrecks.paint import Paint

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.signedinteger[Any]]

PATCH = 0.5
"""Side in metres of the patches that a surface is cut into."""
SUBDIVISION = 2
"""Each patch is this many quads by this many, so that it can bend and be torn."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A surface of the wreck before it is cut into individuals."""

    vertices: FloatArray
    """(V, 3) metres."""
    faces: IntArray
    """(F, 3) vertex indices, counter-clockwise seen from outside."""
    cell: IntArray
    """(F,) the faces of one number are one patch."""
    region: str
    """The group that its patches belong to."""
    paint: Paint
    two_sided: bool = False

    @property
    def centroids(self) -> FloatArray:
        """(F, 3) the middle of each face."""
        return steady(self.vertices[self.faces].mean(axis=1))

    @property
    def quad_middles(self) -> FloatArray:
        """(F, 3) for each face the middle of the quad that it is half of: openings get straight edges.

        Only for what grids are made of and whole quads were taken from.
        """
        return np.repeat(steady(self.centroids.reshape(-1, 2, 3).mean(axis=1)), 2, axis=0)

    def moved(self, rotation: FloatArray, translation: Sequence[float] | FloatArray = (0, 0, 0)) -> Part:
        """The part turned about the origin, then shifted."""
        turned = products(self.vertices, rotation)
        return replace(self, vertices=turned + np.asarray(translation, np.float64))

    def warped(self, displacement: Callable[[FloatArray], FloatArray]) -> Part:
        """Every vertex shifted by a function of its position, so that touching parts still touch."""
        return replace(self, vertices=self.vertices + displacement(self.vertices))

    def kept(self, condition: BoolArray) -> Part:
        """Only the faces for which the condition (F,) holds."""
        return replace(self, faces=self.faces[condition], cell=self.cell[condition])

    def divided(self, names: Callable[[FloatArray], npt.NDArray[np.str_]]) -> list[Part]:
        """One part for each region that `names` gives to the middles (N, 3) of the patches."""
        labels, cell = np.unique(self.cell, return_inverse=True)
        middle = np.stack([np.bincount(cell, self.centroids[:, k]) for k in range(3)], axis=1)
        names_of_faces = names(steady(middle / np.bincount(cell, minlength=len(labels))[:, None]))[cell]
        return [
            replace(self.kept(names_of_faces == name), region=str(name)) for name in np.unique(names_of_faces)
        ]


def patches_along(distance: float) -> int:
    """How many patches fit a distance in metres."""
    return max(1, round(float(steady(distance / PATCH))))


def resample(curve: FloatArray, intervals: int) -> FloatArray:
    """`intervals + 1` points at equal distances along a polyline (N, 3); both ends are kept exactly."""
    along = np.concatenate([[0.0], np.cumsum(length(np.diff(curve, axis=0)))])
    wanted = np.linspace(0.0, along[-1], intervals + 1)
    points = np.stack([np.interp(wanted, along, curve[:, k]) for k in range(curve.shape[1])], axis=1)
    points[0], points[-1] = curve[0], curve[-1]
    return points


def _lengths(points: FloatArray, axis: int) -> float:
    """Mean length of the lines of a grid of points along an axis."""
    return float(length(np.diff(points, axis=axis)).sum(axis=axis).mean())


def grid(points: FloatArray, region: str, paint: Paint, *, two_sided: bool = False) -> Part:
    """A sheet through the nodes (rows, cols, 3), seen from where rows to columns turns counter-clockwise.

    Every `SUBDIVISION` quads along each side are a patch.
    """
    rows, cols = points.shape[:2]
    i, j = (index.ravel() for index in np.meshgrid(np.arange(rows - 1), np.arange(cols - 1), indexing="ij"))
    a, b, c, d = i * cols + j, (i + 1) * cols + j, (i + 1) * cols + j + 1, i * cols + j + 1
    # Diagonals alternate, or everything painted on the sheet would lean one way.
    first, second, third, fourth = np.where((i + j) % 2, [b, c, d, a], [a, b, c, d])
    faces = np.stack([first, second, third, first, third, fourth], axis=1).reshape(-1, 3)
    cell = (i // SUBDIVISION) * (cols // SUBDIVISION + 1) + j // SUBDIVISION
    return Part(points.reshape(-1, 3), faces, np.repeat(cell, 2), region, paint, two_sided)


def sheet(points: FloatArray, region: str, paint: Paint, *, two_sided: bool = False) -> Part:
    """A smooth sheet through a dense grid of points (N, M, 3), cut into patches of equal arc length.

    Nodes on the four sides depend on that side alone, so two sheets with a common side meet exactly
    when they have as many patches along it.
    """
    columns = SUBDIVISION * patches_along(_lengths(points, 1))
    return lofted(
        points, SUBDIVISION * patches_along(_lengths(points, 0)), columns, region, paint, two_sided=two_sided
    )


def lofted(
    points: FloatArray, rows: int, columns: int, region: str, paint: Paint, *, two_sided: bool = False
) -> Part:
    """As `sheet`, with the number of quads along the first and the second axis given."""
    lines = np.stack([resample(points[:, j], rows) for j in range(points.shape[1])], axis=1)
    nodes = np.stack([resample(lines[i], columns) for i in range(rows + 1)])
    return grid(nodes, region, paint, two_sided=two_sided)


def rectangle(
    corner: Sequence[float],
    side: Sequence[float],
    other: Sequence[float],
    region: str,
    paint: Paint,
    *,
    two_sided: bool = False,
) -> Part:
    """A flat rectangle from a corner along two sides, seen from side × other."""
    p, u, v = (np.asarray(vector, np.float64) for vector in (corner, side, other))
    s, t = (np.linspace(0, 1, SUBDIVISION * patches_along(float(length(w))) + 1) for w in (u, v))
    return grid(p + s[:, None, None] * u + t[None, :, None] * v, region, paint, two_sided=two_sided)


def joined(parts: Sequence[Part]) -> Part:
    """Parts of one paint as one; their patches stay apart."""
    vertices = np.cumsum([0] + [len(part.vertices) for part in parts])
    cells = np.cumsum([0] + [int(part.cell.max()) + 1 for part in parts])
    return replace(
        parts[0],
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, vertices, strict=False)]),
        cell=np.concatenate([part.cell + start for part, start in zip(parts, cells, strict=False)]),
    )


def box(
    low: Sequence[float],
    high: Sequence[float],
    region: str,
    paint: Paint,
    *,
    faces: str = "XxYyZz",
    two_sided: bool = False,
) -> Part:
    """The faces of an upright box between two corners: X is the one towards +x, x towards −x, and so on."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    x, y, z = (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, z1 - z0)
    sides = {
        "X": ((x1, y0, z0), y, z),
        "x": ((x0, y0, z0), z, y),
        "Y": ((x0, y1, z0), z, x),
        "y": ((x0, y0, z0), x, z),
        "Z": ((x0, y0, z1), x, y),
        "z": ((x0, y0, z0), y, x),
    }
    return joined([rectangle(*sides[face], region, paint, two_sided=two_sided) for face in faces])


def inside_out(part: Part) -> Part:
    """The same faces seen from the other side: the walls of a hold."""
    return replace(part, faces=part.faces[:, ::-1])


def rounded(sides: int) -> FloatArray:
    """The unit circle as a profile (sides, 2), counter-clockwise."""
    return directions(2 * np.pi * np.arange(sides) / sides)


def squared(width: float, height: float) -> FloatArray:
    """A rectangle as a profile (4, 2), counter-clockwise."""
    return np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * (width / 2, height / 2)


def beam(
    path: FloatArray,
    profile: FloatArray,
    region: str,
    paint: Paint,
    *,
    across: Sequence[float] = (0, 0, 1),
    scale: FloatArray | float = 1.0,
    open_ended: bool = False,
    around: int | None = None,
    bends: int = 1,
) -> Part:
    """A profile (P, 2) swept along a path (N, 3): masts, funnels, ribs and timbers.

    Args:
        path: Where it runs; cut into patches of equal length.
        profile: Counter-clockwise; its second axis points along `across` as far as the path allows.
        region: The group.
        paint: The colours.
        across: Any direction that is never parallel to the path.
        scale: Size of the profile at equal distances along the path, or everywhere.
        open_ended: Without lids, as a funnel is; its inside is then seen too.
        around: Patches about the profile; as the perimeter asks where not given.
        bends: Rings in the length of one patch, more where the path is curved.
    """
    rings = bends * patches_along(float(length(np.diff(path, axis=0)).sum()))
    nodes = resample(path, rings)
    tangent = np.gradient(nodes, axis=0)
    tangent /= length(tangent)[:, None]
    first = np.cross(np.asarray(across, np.float64), tangent)
    first /= length(first)[:, None]
    second = np.cross(tangent, first)
    given = np.atleast_1d(np.asarray(scale, np.float64))
    sizes = np.interp(np.linspace(0, 1, rings + 1), np.linspace(0, 1, len(given)), given)
    n = len(profile)
    points = nodes[:, None] + sizes[:, None, None] * (
        profile[None, :, :1] * first[:, None] + profile[None, :, 1:] * second[:, None]
    )
    sides = patches_along(float(length(profile - np.roll(profile, 1, axis=0)).sum() * sizes.mean()))
    sides = min(n, sides if around is None else around)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(rings), np.arange(n), indexing="ij"))
    k = (j + 1) % n
    a, b, c, d = i * n + j, i * n + k, (i + 1) * n + k, (i + 1) * n + j
    faces = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1).reshape(-1, 3)
    cell = np.repeat(i // bends * sides + j * sides // n, 2)
    vertices = points.reshape(-1, 3)
    if open_ended:
        return Part(vertices, faces, cell, region, paint, two_sided=True)
    start, end = len(vertices), len(vertices) + 1
    ring = np.arange(n)
    following = (ring + 1) % n
    lids = np.concatenate(
        [
            np.stack([np.full(n, start), following, ring], axis=1),
            np.stack([np.full(n, end), rings * n + ring, rings * n + following], axis=1),
        ]
    )
    # A lid goes with the sides next to it: on its own it would be too small for a patch.
    slices = ring * sides // n
    lid_cells = np.concatenate([slices, (rings - 1) // bends * sides + slices])
    return Part(
        np.concatenate([vertices, nodes[[0, -1]]]),
        np.concatenate([faces, lids]),
        np.concatenate([cell, lid_cells]),
        region,
        paint,
    )


def turn(axis: str, angle: float) -> FloatArray:
    """The rotation about x, y or z, counter-clockwise seen from its tip."""
    c, s = direction(angle)
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = c
    rotation[second, first], rotation[first, second] = s, -s
    return rotation
