"""A world from somebody's mesh, such as photogrammetry of a wreck: surface → patches on a seabed.

What it does: turns and scales the surface, cuts it into patches of half a metre as the package's wrecks are
cut, lays a seabed under its foot, so deep that its top stays under water, and puts bounds and starts around
it. A part that is open is seen from both sides, for it is a shell without thickness.
Assumes: what looks up and has nothing under it is ground or lies on it; what looks down may hang, and the
seabed under it is what stands near by. Ground is no steeper than `STEEP`.
Fails when: an open shell has decks but no sides. The seabed then rises towards them.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import DREAM_V1
from dream.sim.mesh_files import MOST_TRIANGLES, ReadMesh
from dream.sim.sampling import MILLIMETRE, index, length, quantised
from dream.sim.terrain import APRON, SPACING, smoothstep, undulation
from dream.sim.validity import MOST_MESHES, check_seed, check_world
from dream.sim.water import water_named
from dream.sim.winding import turned
from dream.sim.world import BoolArray, Instances, Mesh, Terrain, UInt8Array, World
from dream.sim.wrecks.paint import RUST, weathering
from dream.sim.wrecks.patches import SLIVER, WIDEST, areas, groups, pieces, split
from dream.sim.wrecks.shapes import PATCH, Part

Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Up = Literal["y", "z"]

LIKELY = 3.0, 250.0
"""Metres that a wreck is long, if nobody says so."""
POSSIBLE = 0.5, 400.0
"""Metres that anything may be long."""
UNITS = {
    "millimetres": 0.001,
    "centimetres": 0.01,
    "inches": 0.0254,
    "feet": 0.3048,
    "kilometres": 1000.0,
    "a model of 1:10": 10.0,
    "a model of 1:100": 100.0,
}
FLOOR = -10.0
"""World z of the seabed, if the mesh is not too tall for it."""
COVER = 4.0
"""Least metres of water over the top."""
MARGIN = 12.0
"""Metres between the mesh and the sides of the bounds."""
LEAST_SIDE = 40.0
"""Metres of the shortest side of the bounds."""
GROUP = 10.0
"""Metres a side of the squares of ground whose patches are one group."""
RAGGED = 1.1
"""Metres across that no patch exceeds: triangles of somebody's mesh do not end where a patch should."""
CONFETTI = 0.01
"""Square metres: what is smaller and hangs together with nothing is left out."""
GROUND_CELL = 0.5
"""Metres a side of the cells in which the lowest place of the mesh is looked for."""
SPAN = 8.0
"""Metres within which lower ground bounds that about it."""
STEEP = 0.7
"""Metres that ground rises in one."""
LOOKS_UP = 0.3
"""Least z of the unit normal of what counts as ground."""
RIM = 3
"""Cells of ground from the edge of the mesh that are its rim."""
SMOOTH, BROAD = 1.0, 8.0
"""Metres, one standard deviation, by which the seabed is smoothed under the mesh and so far away from it."""
SINK = 0.01
"""Metres that the seabed stays under the lowest place."""
START_EDGE, START_APART = 4.0, 8.0
"""Least metres from a start to the sides, and to another start."""
START_HULL = 4.5, 8.0
"""Metres from a start to the mesh, which its camera sees."""
STARTS = 4


@dataclass(frozen=True, slots=True)
class Made:
    """A world, and what was found in the mesh."""

    world: World
    extents: tuple[float, float, float]
    """Metres along x, y and z."""
    told: tuple[str, ...]
    """What was turned, left out, or taken in another way."""


def world_of(
    surface: ReadMesh,
    name: str,
    *,
    seed: int = 1,
    up: Up | None = None,
    scale: float | None = None,
    target: bool = True,
    shells: bool = False,
    water: str = "clear",
) -> Made:
    """A world with the surface as its target.

    Args:
        surface: Of a file; see `read_surface`.
        name: Of the world.
        seed: Of open seabed, starts, and growth where the surface has no colours.
        up: The axis that is up in the file. Unless given, z, and refused where that looks wrong.
        scale: Metres of one unit of the file. Unless given, 1, and refused where no wreck has such a size.
        target: It is what is to be explored; otherwise an obstacle, and the world has no individuals.
        shells: Its patches are shells, which block neither sight nor vehicle; otherwise hull.
        water: Its name.

    Raises:
        ValueError: Something is wrong with the mesh, or looks so; what to do is said.
    """
    check_seed(seed)
    sea = water_named(water)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    told = list(surface.told)
    vertices = _upright(surface.vertices, up, scale)
    vertices, faces, colors = _welded(vertices, surface, told)
    faces, loose = _outwards(vertices, faces, told)
    vertices, faces, colors, origin = _subdivided(vertices, faces, colors)
    loose = loose[origin]
    cell = _cells(vertices, faces, loose, told)
    kept = cell >= 0
    faces, cell, loose = faces[kept], cell[kept], loose[kept]
    if colors is None:
        told.append("no colours: painted as rusty steel")
        colors = weathering(rng).colours(RUST, vertices, _upward(vertices, faces))
    used = np.unique(faces)
    half = 0.5 * np.ptp(vertices[used], axis=0)
    middle = vertices[used].min(axis=0) + half
    bottom, top = vertices[used, 2].min(), vertices[used, 2].max()
    floor = np.floor(min(FLOOR, -COVER - (top - bottom)))
    vertices = vertices - np.array([*middle[:2], bottom - floor])
    vertices = quantised(vertices, MILLIMETRE)
    lattice = DREAM_V1.lattice
    sides = [max(np.ceil((extent + MARGIN) / lattice) * lattice, 0.5 * LEAST_SIDE) for extent in half[:2]]
    wide, deep = map(float, sides)
    bounds = Bounds(-wide, -deep, wide, deep)
    points = vertices[np.unique(faces)]
    seabed = _seabed(vertices, faces, bounds, rng)
    meshes: list[Mesh] = []
    for two_sided in (False, True):
        mine = loose == two_sided
        if mine.any():
            part = Part(vertices, faces[mine], cell[mine], "", RUST, two_sided)
            meshes += pieces(part, colors) if target else [_whole(part, colors)]
    meshes, centres = map(list, zip(*(_centred(mesh) for mesh in meshes), strict=True))
    count = len(meshes)
    if target and count > MOST_MESHES:
        raise ValueError(f"mesh: expected at most {MOST_MESHES:,} patches, got {count:,}. Cut it into parts")
    middles = np.array(centres)
    squares = [f"part {x:g} {y:g}" for x, y in np.floor(middles[:, :2] / GROUP)]
    everywhere = [
        replace(mesh, vertices=mesh.vertices + at) for mesh, at in zip(meshes, middles, strict=True)
    ]
    table = Instances(
        mesh=np.arange(count, dtype=np.int32),
        position=middles.astype(np.float32),
        wxyz=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scale=np.ones((count, 3), np.float32),
        tint=np.ones((count, 3), np.float32),
        group=groups(everywhere, squares) if target else np.full(count, -1, np.int32),
    )
    nothing = table.chosen(np.zeros(count, np.bool_))
    world = World(
        name=name,
        seed=seed,
        protocol=DREAM_V1.name,
        bounds=bounds,
        starts=_starts(points[:, :2], bounds, rng),
        terrain=seabed,
        meshes=tuple(meshes),
        targets=table if target else nothing,
        hull=np.full(count if target else 0, not shells),
        obstacles=nothing if target else table,
        water=sea,
    )
    check_world(world)
    return Made(world, (float(2.0 * half[0]), float(2.0 * half[1]), float(top - bottom)), tuple(told))


def _upright(vertices: Float64Array, up: Up | None, scale: float | None) -> Float64Array:
    """In metres with z up, about the middle.

    Raises:
        ValueError: Size or axis look wrong, and nobody said that they are right.
    """
    points = vertices - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    extents = np.ptp(points, axis=0)
    longest = float(extents.max())
    factor = 1.0 if scale is None else scale
    if not (np.isfinite(factor) and factor > 0.0):
        raise ValueError(f"--scale: expected metres of a unit, more than 0, got {factor:g}")
    low, high = LIKELY if scale is None else POSSIBLE
    if not low <= longest * factor <= high:
        likely = [
            f"--scale {unit:g} if it is in {word}, which makes {longest * unit:.3g} m"
            if "model" not in word
            else f"--scale {unit:g} if it is {word}, which makes {longest * unit:.3g} m"
            for word, unit in UNITS.items()
            if LIKELY[0] <= longest * unit <= LIKELY[1]
        ]
        known = f"; or --scale 1 if {longest:.3g} m is right" * (POSSIBLE[0] <= longest <= POSSIBLE[1])
        raise ValueError(
            f"--scale: expected a mesh {low:g} to {high:g} m long, got {longest * factor:.6g} m. Say "
            + (", or ".join(likely) or "--scale with the metres of one unit")
            + known * (scale is None)
        )
    x, y, z = extents.tolist()
    if up is None and (z > max(x, y) or (y < x and y < 0.7 * z)):
        raise ValueError(
            f"--up: expected a mesh that lies flat, got x {x * factor:.3g}, y {y * factor:.3g}, z "
            f"{z * factor:.3g} m. Say --up y if y is up in it, or --up z if it is right"
        )
    if up == "y":
        points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
    return np.asarray(points * factor)


def _welded(
    vertices: Float64Array, surface: ReadMesh, told: list[str]
) -> tuple[Float64Array, IntArray, UInt8Array | None]:
    """One vertex a millimetre, and no face that has no area or stands there twice."""
    millimetres, first, same = np.unique(
        np.rint(vertices * MILLIMETRE).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    welded = millimetres / float(MILLIMETRE)
    faces = same.reshape(-1)[surface.faces]
    sides = length(welded[faces] - np.roll(welded[faces], 1, axis=1)).max(axis=1)
    # Flatter than two tenths of a millimetre, it has no normal after rounding.
    sound = areas(welded, faces) > 0.0001 * np.maximum(sides, 0.002)
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    single = np.zeros(len(faces), np.bool_)
    single[once] = True
    if flat := int((~sound).sum()):
        told.append(f"{flat:,} triangles without area left out")
    if twice := int((sound & ~single).sum()):
        told.append(f"{twice:,} triangles that stand there twice left out")
    kept = sound & single
    if not kept.any():
        raise ValueError("mesh: expected triangles with an area, got none. Is --scale right?")
    return welded, faces[kept], None if surface.colors is None else surface.colors[first]


def _outwards(vertices: Float64Array, faces: IntArray, told: list[str]) -> tuple[IntArray, BoolArray]:
    """The faces turned outwards, as far as they show where that is, and (F,) those of open parts."""
    shape = Mesh(vertices.astype(np.float32), faces.astype(np.int32), np.zeros((len(vertices), 3), np.uint8))
    found = turned([shape])
    flip, loose = found.flips[0], found.loose[0]
    if found.endless:
        loose = np.ones(len(faces), np.bool_)
        told.append("a surface with but one side: all of it is seen from both sides")
    faces = np.where(flip[:, None], faces[:, [0, 2, 1]], faces)
    a, b, c = (vertices[faces[loose, k]] for k in range(3))
    if np.cross(b - a, c - a)[:, 2].sum() < 0.0:  # Nobody looks at a shell from under the seabed.
        flip = flip ^ loose
        faces = np.where(loose[:, None], faces[:, [0, 2, 1]], faces)
    if flip.any():
        told.append(f"{int(flip.sum()):,} of {len(faces):,} triangles turned, which were wound the other way")
    if loose.any():
        told.append(
            f"{int(loose.sum()):,} of {len(faces):,} triangles are of open shells: seen from both sides"
        )
    _, shared = np.unique(_edges(faces), return_counts=True)
    if many := int((shared > 2).sum()):
        told.append(f"{many:,} edges with more than two triangles (not manifold)")
    return faces, loose


def _edges(faces: IntArray) -> IntArray:
    """(F, 3) a number for the edge from each corner to the next, the same in both directions."""
    begin, end = faces, faces[:, [1, 2, 0]]
    return np.minimum(begin, end) * (int(faces.max(initial=0)) + 1) + np.maximum(begin, end)


def _subdivided(
    vertices: Float64Array, faces: IntArray, colors: UInt8Array | None
) -> tuple[Float64Array, IntArray, UInt8Array | None, IntArray]:
    """Edges longer than a patch are halved, in all faces that share them, until none is; and (F,) the face
    that each was a part of."""
    area = float(areas(vertices, faces).sum())
    if area > MOST_MESHES * PATCH * PATCH:
        raise ValueError(
            f"mesh: expected at most {MOST_MESHES * PATCH * PATCH:,.0f} m² of surface, got {area:,.0f} m². "
            "Cut it into parts, or is --scale right?"
        )
    origin = np.arange(len(faces))
    tones = None if colors is None else colors.astype(np.float64)
    while True:
        name = _edges(faces)
        sides = length(vertices[faces] - vertices[faces[:, [1, 2, 0]]])
        long = sides > PATCH
        if not long.any():
            return vertices, faces, None if tones is None else np.rint(tones).astype(np.uint8), origin
        if len(faces) > 2 * MOST_TRIANGLES:
            raise ValueError(
                f"mesh: expected at most {2 * MOST_TRIANGLES:,} triangles of half a metre, got more. "
                "Simplify it"
            )
        halved, first = np.unique(name[long], return_index=True)
        ends = np.stack([faces[long], faces[:, [1, 2, 0]][long]], axis=1)[first]
        middle = len(vertices) + np.arange(len(halved))
        vertices = np.concatenate([vertices, quantised(vertices[ends].mean(axis=1), MILLIMETRE)])
        if tones is not None:
            tones = np.concatenate([tones, tones[ends].mean(axis=1)])
        at = np.searchsorted(halved, name)
        between = np.where(long, np.append(middle, -1)[np.minimum(at, len(halved))], -1)
        parts, owners = [faces[~long.any(axis=1)]], [origin[~long.any(axis=1)]]
        number = long.sum(axis=1)
        for count in (1, 2, 3):
            mine = np.flatnonzero(number == count)
            # Turned so that its first edge is halved, and its last is not unless all are.
            turn = {1: long[mine].argmax(axis=1), 2: ((~long[mine]).argmax(axis=1) + 1) % 3, 3: 0 * mine}[
                count
            ]
            order = (turn[:, None] + np.arange(3)) % 3
            a, b, c = np.take_along_axis(faces[mine], order, axis=1).T
            ab, bc, ca = np.take_along_axis(between[mine], order, axis=1).T
            made = {
                1: [(a, ab, c), (ab, b, c)],
                2: [(ab, b, bc), (a, ab, bc), (a, bc, c)],
                3: [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
            }[count]
            parts += [np.stack(corner, axis=1) for corner in made]
            owners += [origin[mine]] * len(made)
        faces, origin = np.concatenate(parts), np.concatenate(owners)


def _upward(vertices: Float64Array, faces: IntArray) -> Float64Array:
    """(V,) z of the mean normal at each vertex."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    total = np.stack(
        [
            np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), minlength=len(vertices))
            for axis in range(3)
        ],
        axis=1,
    )
    return np.asarray(total[:, 2] / np.maximum(length(total), 1e-9))


def _cells(vertices: Float64Array, faces: IntArray, loose: BoolArray, told: list[str]) -> IntArray:
    """(F,) the patch of each face: what hangs together in a cube of half a metre and looks about one way.

    Slivers go to the neighbour with the longest common edge, as those of the package's wrecks do. What is
    left and hangs together with nothing has −1.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = vertices[faces]
    a, b, c = np.moveaxis(corners, 1, 0)
    normal, middle = np.cross(b - a, c - a), corners.mean(axis=1)
    way = np.abs(normal).argmax(axis=1)
    way = 2 * way + (normal[np.arange(len(faces)), way] < 0.0)
    cube = np.floor(middle / PATCH).astype(np.int64)
    key = np.column_stack([cube, way, loose])
    _, kind = np.unique(key, axis=0, return_inverse=True)
    kind = kind.reshape(-1)
    name = _edges(faces).ravel()
    order = np.argsort(name, kind="stable")
    twin = np.flatnonzero(name[order][1:] == name[order][:-1])
    i, j = order[twin] // 3, order[twin + 1] // 3
    size = length(corners - corners[:, [1, 2, 0]]).ravel()[order[twin]]
    alike = kind[i] == kind[j]
    links = (np.ones(int(alike.sum()), np.int8), (i[alike], j[alike]))
    _, together = connected_components(coo_matrix(links, (len(faces),) * 2), directed=False)
    cell = split(Part(vertices, faces, together, "", RUST), RAGGED).cell
    count = int(cell.max()) + 1
    area = np.bincount(cell, areas(vertices, faces), count)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in np.moveaxis(corners, 1, 0):
        np.minimum.at(low, cell, corner)
        np.maximum.at(high, cell, corner)
    beside: list[dict[int, float]] = [{} for _ in range(count)]
    apart = (cell[i] != cell[j]) & (loose[i] == loose[j])
    for p, q, metres in zip(
        cell[i][apart].tolist(), cell[j][apart].tolist(), size[apart].tolist(), strict=True
    ):
        beside[p][q] = beside[p].get(q, 0.0) + metres
        beside[q][p] = beside[q].get(p, 0.0) + metres
    into: IntArray = np.arange(count)
    waiting = [(float(area[k]), k) for k in np.flatnonzero(area < SLIVER).tolist()]
    heapq.heapify(waiting)
    while waiting:
        size_then, k = heapq.heappop(waiting)
        if into[k] != k or area[k] != size_then:
            continue  # It went to another, or has grown since.
        for other, _ in sorted(beside[k].items(), key=lambda item: (-item[1], item[0])):
            least, most = np.minimum(low[k], low[other]), np.maximum(high[k], high[other])
            if float(length(most - least)) > WIDEST:
                continue
            into[k], low[other], high[other] = other, least, most
            area[other] += area[k]
            for third, metres in beside[k].items():
                del beside[third][k]
                if third != other:
                    beside[other][third] = beside[other].get(third, 0.0) + metres
                    beside[third][other] = beside[third].get(other, 0.0) + metres
            beside[k] = {}
            if area[other] < SLIVER:
                heapq.heappush(waiting, (float(area[other]), other))
            break
    while (into[into] != into).any():
        into = np.asarray(into[into], np.int64)
    patch = into[cell]
    own = into == np.arange(count)
    small = own & (area < CONFETTI) & np.array([not one for one in beside])
    if not (own & ~small).any():
        raise ValueError("mesh: expected a surface that hangs together, got only scraps. Is --scale right?")
    if small.any():
        told.append(f"{int(small.sum()):,} loose scraps of less than {CONFETTI * 1e4:g} cm² left out")
    return np.where(small[patch], -1, patch)


def _whole(part: Part, colors: UInt8Array) -> Mesh:
    """All of a part as one mesh."""
    (mesh,) = pieces(replace(part, cell=np.zeros(len(part.faces), np.int64)), colors)
    return mesh


def _centred(mesh: Mesh) -> tuple[Mesh, Float64Array]:
    """The mesh about its own middle, and that middle, in whole millimetres."""
    points = np.rint(mesh.vertices.astype(np.float64) * MILLIMETRE)
    middle = np.rint(0.5 * (points.min(axis=0) + points.max(axis=0)))
    return replace(mesh, vertices=((points - middle) / MILLIMETRE).astype(np.float32)), middle / MILLIMETRE


def _seabed(vertices: Float64Array, faces: IntArray, bounds: Bounds, rng: np.random.Generator) -> Terrain:
    """Ground under the lowest places of the mesh, and as rough as elsewhere away from it.

    Args:
        vertices: (V, 3) in the world.
        faces: (F, 3) with no edge longer than half a metre.
        bounds: About the origin.
        rng: Of the open seabed.
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    points = vertices[np.unique(faces)]
    half = np.array([bounds.x_max, bounds.y_max]) + APRON
    cols, rows = np.ceil(2.0 * half / GROUND_CELL).astype(int).tolist()

    def cells(places: Float64Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        col, row = np.floor((places[:, :2] + half) / GROUND_CELL).astype(np.intp).T
        return row, col

    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal, middle = np.cross(b - a, c - a), (a + b + c) / 3.0
    low = np.full((rows, cols), np.inf)
    for places in (points, middle, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)):
        np.minimum.at(low, cells(places), places[:, 2])
    # In each cell, does the lowest face look up?
    downwards = np.argsort(-middle[:, 2], kind="stable")
    up = np.zeros((rows, cols), np.bool_)
    up[cells(middle[downwards])] = (normal[:, 2] > LOOKS_UP * length(normal))[downwards]
    reach = int(SPAN / GROUND_CELL)
    away = GROUND_CELL * np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    disc = away <= SPAN
    lowest = ndimage.minimum_filter(low, footprint=disc, mode="constant", cval=np.inf)
    stands = np.isfinite(low) & (up | (low <= lowest + GROUND_CELL * STEEP))
    far = float(points[:, 2].max()) + 1e3
    ground = ndimage.grey_erosion(
        np.where(stands, low, far), footprint=disc, structure=-STEEP * away, mode="constant", cval=far
    )
    # What looks up at the rim of the mesh is ground, however steep; a spar that juts out is no rim.
    wide = ndimage.binary_opening(ndimage.binary_fill_holes(np.isfinite(low)), iterations=RIM)
    ground = np.where(wide & up & ~ndimage.binary_erosion(wide, iterations=RIM), low, ground)
    off, nearest = ndimage.distance_transform_edt(~stands, return_indices=True)
    filled = ground[tuple(nearest)]
    smooth = ndimage.gaussian_filter(filled, SMOOTH / GROUND_CELL, mode="nearest")
    broad = ndimage.gaussian_filter(filled, BROAD / GROUND_CELL, mode="nearest")
    smooth += smoothstep(0.0, BROAD, GROUND_CELL * off) * (broad - smooth)
    smooth += smoothstep(0.0, APRON, GROUND_CELL * off) * (float(np.median(ground[stands])) - smooth)
    # Each grid point of the coarse ground lies under all that is in the nine cells about it, so that what is
    # drawn between four of them lies under the mesh everywhere.
    under = ndimage.minimum_filter(low, size=3, mode="constant", cval=np.inf) - SINK
    coarse = Terrain(
        np.minimum(smooth, under).astype(np.float32),
        float(-half[0] + 0.5 * GROUND_CELL),
        float(-half[1] + 0.5 * GROUND_CELL),
        GROUND_CELL,
    )
    x, y = (np.arange(round(2.0 * side / SPACING) + 1) * SPACING - side for side in half)
    x, y = x[None, :], y[:, None]
    grid = np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2)
    apart = np.asarray(cKDTree(points[:, :2]).query(grid, distance_upper_bound=9.0)[0])
    near = quantised(np.minimum(apart, 9.0), 1_000_000).reshape(y.size, x.size)
    extent = float(half.max())
    swell = undulation(Bounds(-extent, -extent, extent, extent), rng)
    skip_y, skip_x = ((swell.shape[0] - y.size) // 2, (swell.shape[1] - x.size) // 2)
    swell = swell[skip_y : skip_y + y.size, skip_x : skip_x + x.size]
    heights = coarse.height(x, y) + swell * smoothstep(1.0, 8.0, near)
    return Terrain(
        quantised(heights, MILLIMETRE).astype(np.float32), float(-half[0]), float(-half[1]), SPACING
    )


def _starts(places: Float64Array, bounds: Bounds, rng: np.random.Generator) -> tuple[SE2, ...]:
    """Four poses on the lattice in free water that look towards the nearest part of the mesh.

    Args:
        places: (V, 2) corners of the mesh, seen from above.
        bounds: Of the world.
        rng: Which of all such poses.
    """
    from scipy.spatial import cKDTree

    spacing = DREAM_V1.lattice
    lines = [
        np.arange(np.ceil((low + START_EDGE) / spacing), np.floor((high - START_EDGE) / spacing) + 1)
        * spacing
        for low, high in ((bounds.x_min, bounds.x_max), (bounds.y_min, bounds.y_max))
    ]
    nodes = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
    away, nearest = map(np.asarray, cKDTree(places).query(nodes))
    free = (away >= START_HULL[0]) & (away <= START_HULL[1])
    starts: list[SE2] = []
    while len(starts) < STARTS:
        left = np.flatnonzero(free)
        if not len(left):
            raise ValueError(f"starts: expected free water for {STARTS} around the mesh, got {len(starts)}")
        chosen = left[index(rng, len(left))]
        x, y = nodes[chosen]
        ahead = places[nearest[chosen]] - (x, y)
        starts.append(DREAM_V1.snap(SE2(float(x), float(y), float(np.arctan2(ahead[1], ahead[0])))))
        free &= length(nodes - (x, y)) >= START_APART
    return tuple(starts)
