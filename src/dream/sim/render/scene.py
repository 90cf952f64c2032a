"""A world as the kernels want it: small clusters of triangles, placed by entities.

A mesh that several individuals share is kept once and placed often. A mesh that is used once (a patch of
hull, say) is moved into world coordinates and merged with its neighbours, so that thousands of tiny meshes
cost no more than one big one.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.protocol import POOL_V1
from dream.sim.world import Instances, Mesh, Terrain, World
from dream.types import Label

Array = npt.NDArray[Any]

MAX_FACES = 512
"""Faces of a cluster; a face's index fits the low bits of a pixel's triangle name."""
CHUNK = 8
"""Squares along the side of a terrain cluster."""
CREASE = 0.6
"""Faces whose normals have at least this cosine are shaded as one smooth surface."""
RUSTY = 1.75
"""How many times its linear green the linear red of rust is; wood stays below."""


class Material(enum.IntEnum):
    """What a surface is made of; it chooses the texture."""

    SEABED = 0
    SHELL = 1
    ROCK = 2
    HULL = 3
    WOOD = 4
    PLAIN = 5


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Clusters of at most `MAX_FACES` faces and the entities that place them in the world."""

    vertices: Array
    """(3, V) float32, each cluster's own vertices in its own frame."""
    faces: Array
    """(F, 3) uint16, indices into the cluster's vertices."""
    face_id: Array
    """(F,) int32, added to the entity's id."""
    face_shade: Array
    """(F, 27) float32: corner 0, gradients of the weights of corners 1 and 2, then normal and linear colour
    as value at corner 0 and differences at corners 1 and 2. Zeros for terrain, which is shaded by place."""
    clusters: Array
    """(C, 4) int32: first vertex, vertices, first face, faces."""
    entity_cluster: Array
    """(E,) int32."""
    entity_matrix: Array
    """(E, 3, 3) float32, cluster to world axes with the scale in it."""
    entity_inverse: Array
    """(E, 3, 3) float32."""
    entity_offset: Array
    """(E, 3) float64, the cluster's origin in the world."""
    entity_sphere: Array
    """(E, 4) float64, bounding centre in the world and radius."""
    entity_two_sided: Array
    """(E,) bool."""
    entity_label: Array
    """(E,) uint8."""
    entity_id: Array
    """(E,) int32."""
    entity_material: Array
    """(E,) uint8."""
    entity_tint: Array
    """(E, 3) float32."""


@dataclass(slots=True)
class _Cluster:
    vertices: Array
    faces: Array
    face_id: Array
    shade: Array
    origin: Array
    """Where the cluster's frame lies in its mesh; its axes are the mesh's."""
    radius: float


def rotation_matrices(wxyz: Array) -> Array:
    """(N, 3, 3) float64 rotations of (N, 4) unit quaternions."""
    w, x, y, z = np.moveaxis(np.asarray(wxyz, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def linear_from_srgb(srgb: Array) -> Array:
    """Linear light in [0, 1], float32, of 8-bit sRGB (IEC 61966-2-1)."""
    return _LINEAR[srgb]


# One value at a time: NumPy's power of a whole array rounds otherwise on a processor with wider registers.
_LINEAR = np.array(
    [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in (k / 255.0 for k in range(256))],
    np.float32,
)


def build_scene(world: World) -> Scene:
    """Cut the world's terrain and meshes into clusters and place them: targets, obstacles, then terrain."""
    clusters: list[_Cluster] = []
    entities: list[dict[str, Array]] = []
    uses = np.bincount(
        np.concatenate([world.targets.mesh, world.obstacles.mesh]).astype(np.intp),
        minlength=len(world.meshes),
    )
    of_mesh: dict[int, range] = {}
    for instances, label, materials in zip(
        (world.targets, world.obstacles), (Label.TARGET, Label.OBSTACLE), _materials(world), strict=True
    ):
        shared = uses[instances.mesh] > 1
        for mesh in np.unique(instances.mesh[shared]):
            if mesh not in of_mesh:
                cut = list(_cut(_Soup.of_mesh(world.meshes[mesh])))
                of_mesh[mesh] = range(len(clusters), len(clusters) + len(cut))
                clusters += cut
            two_sided = world.meshes[mesh].two_sided
            placed = np.flatnonzero(shared & (instances.mesh == mesh))
            for material in np.unique(materials[placed]):
                chosen = placed[materials[placed] == material]
                entities += [
                    _place(clusters[index], index, instances, chosen, label, material, two_sided)
                    for index in of_mesh[mesh]
                ]
        single = np.flatnonzero(~shared)
        kinds = [
            (world.meshes[m].two_sided, material)
            for m, material in zip(instances.mesh[single], materials[single].tolist(), strict=True)
        ]
        for kind in sorted(set(kinds)):
            two_sided, material = kind
            chosen = single[[k == kind for k in kinds]]
            for cluster in _cut(_Soup.of_instances(world.meshes, instances, chosen, label)):
                entities.append(_stand(cluster, len(clusters), label, material, two_sided))
                clusters.append(cluster)
    return _pack(clusters, entities, world.terrain)


def _materials(world: World) -> tuple[Array, Array]:
    """Of each target and each obstacle its `Material`: targets are shells or hull; obstacles are rock, or
    hull where they are plates or part of a wreck."""
    hull, table = _hull(world), world.obstacles
    targets = np.where(world.hull, hull, Material.SHELL)
    if world.protocol == POOL_V1.name:
        return targets, np.full(len(table), Material.PLAIN)
    plates = np.array([mesh.two_sided for mesh in world.meshes], np.bool_)[table.mesh]
    return targets, np.where(plates | (world.hull.any() & (table.group >= 0)), hull, Material.ROCK)


def _hull(world: World) -> Material:
    """Steel rusts somewhere: a tenth of it is far redder than green. A hull without that is of wood.

    All hull of a world looks alike.
    """
    if not world.hull.any():
        return Material.HULL
    hull = world.targets.mesh[world.hull]
    colors = linear_from_srgb(np.concatenate([world.meshes[mesh].colors for mesh in hull]))
    redness = np.percentile(colors[:, 0] / np.maximum(colors[:, 1], 1e-3), 90)
    return Material.WOOD if redness < RUSTY else Material.HULL


@dataclass(slots=True)
class _Soup:
    """Triangles with corners of their own."""

    corners: Array
    """(F, 3, 3) float64."""
    colors: Array
    """(F, 3, 3) float32 linear."""
    face_id: Array
    """(F,) int32."""

    @staticmethod
    def of_mesh(mesh: Mesh) -> _Soup:
        corners = mesh.vertices.astype(np.float64)[mesh.faces]
        colors = linear_from_srgb(mesh.colors)[mesh.faces]
        return _Soup(corners, colors, np.zeros(len(mesh.faces), np.int32))

    @staticmethod
    def of_instances(meshes: tuple[Mesh, ...], instances: Instances, chosen: Array, label: Label) -> _Soup:
        rotations = rotation_matrices(instances.wxyz[chosen])
        soups = []
        for i, rotation in zip(chosen, rotations, strict=True):
            soup = _Soup.of_mesh(meshes[instances.mesh[i]])
            soup.corners = (soup.corners * instances.scale[i]) @ rotation.T + instances.position[i]
            soup.colors = soup.colors * instances.tint[i]
            soup.face_id[:] = i if label is Label.TARGET else -1
            soups.append(soup)
        return _Soup(
            np.concatenate([s.corners for s in soups]),
            np.concatenate([s.colors for s in soups]),
            np.concatenate([s.face_id for s in soups]),
        )


def _cut(soup: _Soup) -> Iterator[_Cluster]:
    """Halve the faces along their longest extent until each part is small enough."""
    normals = _corner_normals(soup.corners)
    centroids = soup.corners.mean(axis=1)
    parts = [np.arange(len(centroids))]
    while parts:
        part = parts.pop()
        if len(part) > MAX_FACES:
            axis = np.argmax(np.ptp(centroids[part], axis=0))
            order = part[np.argsort(centroids[part, axis], kind="stable")]
            parts += [order[len(order) // 2 :], order[: len(order) // 2]]
        elif len(part):
            yield _cluster(soup, part, normals)


def _cluster(soup: _Soup, part: Array, normals: Array) -> _Cluster:
    corners = soup.corners[part]
    # Corners that coincide exactly share a vertex, so that it is transformed once and leaves no crack.
    points, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
    local = points - origin
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # The dual basis of the two edges in the triangle's plane: weight k of a point p is g_k · (p − corner 0).
    a, b, c = (
        np.einsum("fi,fi->f", *pair)[:, None] for pair in ((edge1, edge1), (edge1, edge2), (edge2, edge2))
    )
    scale = 1.0 / np.maximum(a * c - b * b, 1e-30)
    shade = np.empty((len(part), 9, 3), np.float32)
    shade[:, 0] = corners[:, 0] - origin
    shade[:, 1], shade[:, 2] = (c * edge1 - b * edge2) * scale, (a * edge2 - b * edge1) * scale
    for slot, values in ((3, normals[part]), (6, soup.colors[part])):
        shade[:, slot] = values[:, 0]
        shade[:, slot + 1 : slot + 3] = values[:, 1:] - values[:, :1]
    return _Cluster(
        local.astype(np.float32),
        index.reshape(-1, 3).astype(np.uint16),
        soup.face_id[part],
        shade.reshape(len(part), 27),
        origin,
        float(np.linalg.norm(local, axis=1).max()),
    )


def _corner_normals(corners: Array) -> Array:
    """(F, 3, 3) unit normals: at each corner the mean over the faces that meet there without a crease."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    flat = cross / np.maximum(length, 1e-30)
    # Patches of a hull are meshes of their own that meet at the same places: weld by position.
    welded = np.round(corners.reshape(-1, 3) / 1e-4).astype(np.int64)
    _, vertex = np.unique(welded, axis=0, return_inverse=True)
    order = np.argsort(vertex.ravel(), kind="stable")
    vertex, face = vertex.ravel()[order], order // 3
    total = flat[face].copy()
    # Pairs of corners that share a vertex lie within a few places of each other in the sorted list.
    for step in range(1, 16):
        near = (vertex[step:] == vertex[:-step]) & (
            np.einsum("ci,ci->c", flat[face[step:]], flat[face[:-step]]) >= CREASE
        )
        total[:-step][near] += cross[face[step:]][near] / length.mean()
        total[step:][near] += cross[face[:-step]][near] / length.mean()
    normals = np.empty_like(total)
    normals[order] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
    per_face: Array = normals.reshape(-1, 3, 3)
    return per_face


def _place(
    cluster: _Cluster,
    index: int,
    instances: Instances,
    chosen: Array,
    label: Label,
    material: int,
    two_sided: bool,
) -> dict[str, Array]:
    """Entities that put one shared cluster at each of the chosen instances."""
    count = len(chosen)
    scale = instances.scale[chosen].astype(np.float64)
    rotation = rotation_matrices(instances.wxyz[chosen])
    matrix = rotation * scale[:, None, :]
    offset = instances.position[chosen] + np.einsum("nij,j->ni", matrix, cluster.origin)
    return {
        "cluster": np.full(count, index, np.int32),
        "matrix": matrix,
        "inverse": np.swapaxes(rotation, 1, 2) / scale[:, :, None],
        "offset": offset,
        "sphere": np.column_stack([offset, cluster.radius * scale.max(axis=1)]),
        "two_sided": np.full(count, two_sided),
        "label": np.full(count, label, np.uint8),
        "id": (chosen if label is Label.TARGET else np.full(count, -1)).astype(np.int32),
        "material": np.full(count, material, np.uint8),
        "tint": instances.tint[chosen],
    }


def _stand(cluster: _Cluster, index: int, label: Label, material: int, two_sided: bool) -> dict[str, Array]:
    """The one entity of a cluster that was cut in world coordinates; its faces know their ids."""
    return {
        "cluster": np.array([index], np.int32),
        "matrix": np.eye(3)[None],
        "inverse": np.eye(3)[None],
        "offset": cluster.origin[None],
        "sphere": np.append(cluster.origin, cluster.radius)[None],
        "two_sided": np.array([two_sided]),
        "label": np.array([label], np.uint8),
        "id": np.zeros(1, np.int32),
        "material": np.array([material], np.uint8),
        "tint": np.ones((1, 3), np.float32),
    }


def _pack(clusters: list[_Cluster], entities: list[dict[str, Array]], terrain: Terrain) -> Scene:
    """Join meshes and terrain. All terrain clusters share one list of faces."""
    ground, centres = _chunks(terrain)
    ground_faces = _chunk_faces()
    vertices = [c.vertices for c in clusters] + [ground.reshape(-1, 3)]
    vertex_counts = np.array([len(c.vertices) for c in clusters] + [ground.shape[1]] * len(ground))
    face_counts = np.array([len(c.faces) for c in clusters] + [len(ground_faces)] * len(ground))
    face_starts = np.concatenate([[0], np.cumsum(face_counts)])[: len(face_counts)]
    face_starts[len(clusters) :] = face_counts[: len(clusters)].sum()
    table = np.column_stack(
        [np.cumsum(vertex_counts) - vertex_counts, vertex_counts, face_starts, face_counts]
    )
    count = len(ground)
    identity = np.broadcast_to(np.eye(3), (count, 3, 3))
    entities = [
        *entities,
        {
            "cluster": np.arange(len(clusters), len(clusters) + count),
            "matrix": identity,
            "inverse": identity,
            "offset": centres,
            "sphere": np.column_stack([centres, np.linalg.norm(ground, axis=2).max(axis=1)]),
            "two_sided": np.zeros(count, np.bool_),
            "label": np.full(count, Label.SEABED),
            "id": np.full(count, -1),
            "material": np.full(count, Material.SEABED),
            "tint": np.ones((count, 3)),
        },
    ]

    def join(name: str, dtype: npt.DTypeLike) -> Array:
        return np.ascontiguousarray(np.concatenate([entity[name] for entity in entities]), dtype)

    zeros = np.zeros(len(ground_faces), np.int32)
    return Scene(
        vertices=np.ascontiguousarray(np.concatenate(vertices).T, np.float32),
        faces=np.concatenate([*(c.faces for c in clusters), ground_faces]).astype(np.uint16),
        face_id=np.concatenate([*(c.face_id for c in clusters), zeros]).astype(np.int32),
        face_shade=np.concatenate(
            [*(c.shade for c in clusters), np.zeros((len(ground_faces), 27), np.float32)]
        ).astype(np.float32),
        clusters=np.ascontiguousarray(table, np.int32),
        entity_cluster=join("cluster", np.int32),
        entity_matrix=join("matrix", np.float32),
        entity_inverse=join("inverse", np.float32),
        entity_offset=join("offset", np.float64),
        entity_sphere=join("sphere", np.float64),
        entity_two_sided=join("two_sided", np.bool_),
        entity_label=join("label", np.uint8),
        entity_id=join("id", np.int32),
        entity_material=join("material", np.uint8),
        entity_tint=join("tint", np.float32),
    )


def _chunks(terrain: Terrain) -> tuple[Array, Array]:
    """Vertices (C, (CHUNK + 1)², 3) of the terrain's clusters about their centres, and the centres (C, 3)."""
    rows, cols = terrain.heights.shape
    # Past the edge the last row repeats; its triangles have no area.
    row = np.minimum(np.arange(0, rows - 1, CHUNK)[:, None] + np.arange(CHUNK + 1), rows - 1)
    col = np.minimum(np.arange(0, cols - 1, CHUNK)[:, None] + np.arange(CHUNK + 1), cols - 1)
    row4, col4 = np.broadcast_arrays(row[:, None, :, None], col[None, :, None, :])
    points = np.stack(
        [
            terrain.x0 + terrain.spacing * col4,
            terrain.y0 + terrain.spacing * row4,
            terrain.heights[row4, col4].astype(np.float64),
        ],
        axis=-1,
    ).reshape(-1, (CHUNK + 1) ** 2, 3)
    centres = 0.5 * (points.min(axis=1) + points.max(axis=1))
    return points - centres[:, None], centres


def _chunk_faces() -> Array:
    """Two triangles a square, split from the lower-left to the upper-right corner."""
    row, col = np.divmod(np.arange(CHUNK * CHUNK), CHUNK)
    a = row * (CHUNK + 1) + col
    b, c, d = a + 1, a + CHUNK + 2, a + CHUNK + 1
    return np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
