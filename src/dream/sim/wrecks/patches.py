"""From parts to individuals: cut at the seabed, merge slivers, colour, round, group."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dream.sim.sampling import length, products, steady
from dream.sim.world import Int32Array, Mesh, UInt8Array
from dream.sim.wrecks.paint import Weathering, weathering
from dream.sim.wrecks.shapes import FloatArray, IntArray, Part

BURIED = -0.1
"""Faces wholly below this height are not part of the wreck."""
SLIVER = 0.09
"""Square metres above the seabed below which a patch goes to its neighbour."""
WIDEST = 0.9
"""Metres across that no patch exceeds."""
MOST_FACES = 32
"""Faces that no patch exceeds by taking in a neighbour."""
SMALLEST_GROUP = 15


def centred(parts: Sequence[Part]) -> list[Part]:
    """The parts shifted so that the origin is the middle of what stands above the seabed."""
    points = np.concatenate([part.vertices[np.unique(part.faces)] for part in parts])
    points = points[points[:, 2] > BURIED]
    middle = np.append((points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2, 0.0)
    return [part.moved(np.eye(3), -middle) for part in parts]


def individuals(parts: Sequence[Part], rng: np.random.Generator) -> tuple[tuple[Mesh, ...], Int32Array]:
    """One mesh a patch, and the group (N,) of each, numbered from 0 in the order of the parts."""
    weather = weathering(rng)
    meshes: list[Mesh] = []
    regions: list[str] = []
    for part in parts:
        cut = _merged(split(_cut(part)))
        if not len(cut.faces):
            continue
        pieces = _coloured(cut, weather, rng)
        meshes += pieces
        regions += [part.region] * len(pieces)
    return tuple(meshes), groups(meshes, regions)


def areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(F,) square metres."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.asarray(0.5 * length(np.cross(b - a, c - a)))


def _cut(part: Part) -> Part:
    """Rounded to a millimetre, with one vertex a place, without buried or degenerate faces."""
    millimetres, index = np.unique(
        np.rint(part.vertices * 1000).astype(np.int64), axis=0, return_inverse=True
    )
    vertices = millimetres / 1000.0
    faces = index.reshape(-1)[part.faces]
    corners = vertices[faces]
    longest = length(corners - np.roll(corners, 1, axis=1)).max(axis=1)
    # A face flatter than 2 mm has no normal worth the name after rounding.
    sound = areas(vertices, faces) > 0.001 * np.maximum(longest, 0.02)
    keep = sound & (corners[:, :, 2].max(axis=1) > BURIED)
    used, faces = np.unique(faces[keep], return_inverse=True)
    vertices = vertices[used]
    return Part(vertices, faces.reshape(-1, 3), part.cell[keep], part.region, part.paint, part.two_sided)


def split(part: Part, widest: float = WIDEST) -> Part:
    """Patches that are more than so many metres across are halved across their longest extent."""
    cell = np.unique(part.cell, return_inverse=True)[1]
    middles = part.centroids
    count = int(cell.max(initial=-1)) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in np.moveaxis(part.vertices[part.faces], 1, 0):
        np.minimum.at(low, cell, corner)
        np.maximum.at(high, cell, corner)
    waiting = np.flatnonzero(length(high - low) > widest).tolist()
    while waiting:
        label = waiting.pop()
        members = np.flatnonzero(cell == label)
        points = part.vertices[np.unique(part.faces[members])]
        if len(members) < 2 or _width(points) <= widest:
            continue
        spread = points - points.mean(axis=0)
        far = spread[int(np.argmax(steady(length(spread))))]
        order = members[np.argsort(steady(products(middles[members], far[None])[:, 0]), kind="stable")]
        cell[order[len(order) // 2 :]] = count
        waiting += [label, count]
        count += 1
    return Part(part.vertices, part.faces, cell, part.region, part.paint, part.two_sided)


def _merged(part: Part) -> Part:
    """Patches of which hardly anything shows go to the neighbour with the longest common edge."""
    if not len(part.faces):
        return part
    _, cell = np.unique(part.cell, return_inverse=True)
    corners = part.vertices[part.faces]
    showing = areas(part.vertices, part.faces) * (corners[:, :, 2].mean(axis=1) > 0.0)
    area = np.bincount(cell, showing)
    border = _borders(part, cell)
    members = {int(label): part.faces[cell == label] for label in range(len(area))}
    for label in np.argsort(area, kind="stable").tolist():
        if area[label] >= SLIVER:
            break
        neighbours = sorted(border[label].items(), key=lambda item: (-item[1], item[0]))
        for neighbour, _ in neighbours:
            together = np.concatenate([members[neighbour], members[label]])
            if len(together) > MOST_FACES or _width(part.vertices[np.unique(together)]) > WIDEST:
                continue
            members[neighbour] = together
            area[neighbour] += area[label]
            cell[cell == label] = neighbour
            del members[label]
            for other, metres in border.pop(label).items():
                del border[other][label]
                if other != neighbour:
                    border[other][neighbour] = border[other].get(neighbour, 0.0) + metres
                    border[neighbour][other] = border[neighbour].get(other, 0.0) + metres
            break
    return Part(part.vertices, part.faces, cell, part.region, part.paint, part.two_sided)


def _borders(part: Part, cell: IntArray) -> dict[int, dict[int, float]]:
    """Length of the common edges of every two patches that touch."""
    edges = np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(cell, 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    twin = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1) & (owner[1:] != owner[:-1]))
    shared = length(part.vertices[edges[twin, 0]] - part.vertices[edges[twin, 1]])
    borders: dict[int, dict[int, float]] = {label: {} for label in range(int(cell.max()) + 1)}
    for a, b, metres in zip(owner[twin].tolist(), owner[twin + 1].tolist(), shared.tolist(), strict=True):
        borders[a][b] = borders[a].get(b, 0.0) + metres
        borders[b][a] = borders[b].get(a, 0.0) + metres
    return borders


def _width(points: FloatArray) -> float:
    """The greatest distance between two of the points."""
    return float(length(points[:, None] - points[None]).max())


def _coloured(part: Part, weather: Weathering, rng: np.random.Generator) -> list[Mesh]:
    """The patches of a part as meshes of their own."""
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    total = np.zeros((len(part.vertices), 3))
    for k in range(3):
        np.add.at(total, part.faces[:, k], normal)
    size = np.maximum(length(total), 1e-9)
    upward = np.abs(total[:, 2]) / size if part.two_sided else total[:, 2] / size
    colours = weather.colours(part.paint, part.vertices, upward).astype(np.float64)
    colours *= 0.94 + 0.12 * rng.random(len(colours))[:, None]
    albedo = np.clip(np.rint(colours), 0, 255).astype(np.uint8)
    return pieces(part, albedo)


def pieces(part: Part, albedo: UInt8Array) -> list[Mesh]:
    """The patches of a part as meshes of their own, in the order of their numbers.

    Args:
        part: Cut into patches.
        albedo: (V, 3) the colour of each vertex.
    """
    order = np.argsort(part.cell, kind="stable")
    cell = part.cell[order]
    # All patches at once: a key for each vertex of each patch, in the order of the patches.
    keys, local = np.unique(cell[:, None] * len(albedo) + part.faces[order], return_inverse=True)
    owner, vertex = np.divmod(keys, len(albedo))
    begins = np.flatnonzero(np.diff(owner, prepend=-1))
    first_faces = np.flatnonzero(np.diff(cell, prepend=-1))
    faces = local.reshape(-1, 3) - np.repeat(begins, np.diff(first_faces, append=len(cell)))[:, None]
    return [
        Mesh(
            vertices=part.vertices[used].astype(np.float32),
            faces=triangles.astype(np.int32),
            colors=albedo[used],
            two_sided=part.two_sided,
        )
        for used, triangles in zip(
            np.split(vertex, begins[1:]), np.split(faces, first_faces[1:]), strict=True
        )
    ]


def groups(meshes: Sequence[Mesh], regions: Sequence[str]) -> Int32Array:
    """Regions as numbers. One with too few patches joins another so that both together stay compact.

    That other has the same first word in its name if any has.
    """
    names = list(dict.fromkeys(regions))
    number = {name: i for i, name in enumerate(names)}
    group = np.array([number[region] for region in regions])
    middles = np.array([0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) for mesh in meshes])
    while True:
        labels, counts = np.unique(group, return_counts=True)
        if counts.min() >= SMALLEST_GROUP or len(labels) == 1:
            break
        low = np.array([middles[group == label].min(axis=0) for label in labels])
        high = np.array([middles[group == label].max(axis=0) for label in labels])
        kinds = np.array([names[label].split()[0] for label in labels])
        smallest = int(np.argmin(counts))
        size = length(np.maximum(high, high[smallest]) - np.minimum(low, low[smallest]))
        size[smallest] = np.inf
        if (kinds == kinds[smallest]).sum() > 1:
            size[kinds != kinds[smallest]] = np.inf
        group[group == labels[smallest]] = labels[int(np.argmin(steady(size)))]
    return np.unique(group, return_inverse=True)[1].astype(np.int32)
