"""Triangles, heights, a map and a path → a scene that a page can hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.scene.parts import (
    MOST_VOXELS,
    NEVER,
    BoolArray,
    Float32Array,
    Int32Array,
    Path,
    RunScene,
    SceneSurface,
    UInt16Array,
    Voxels,
)

AIM_FACES = 200_000
"""Finer surfaces of targets and obstacles are thinned until they have no more."""
FINEST = 0.002
"""Metres: corners that lie closer are one."""
APRON = 2.0
"""Metres of seabed that are shown beyond the bounds."""
MOST_POSTS = 220
"""Squares a side; a finer seabed is thinned. That of an arena of 50 m is kept as it is: a coarser
one covers low clumps."""


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """The individuals, and when each was seen and inspected."""

    triangles: npt.NDArray[np.floating]
    """(T, 3, 3) corners, metres in the world."""
    owner: npt.NDArray[np.integer]
    """(T,) the individual of each."""
    kinds: tuple[str, ...]
    """Names of the kinds of target."""
    kind: npt.NDArray[np.integer]
    """(N,) kind of each individual, index into `kinds`."""
    seen_at: npt.NDArray[np.integer]
    """(N,) numbers of steps; −1 where it never was."""
    inspected_at: npt.NDArray[np.integer]
    """(N,) likewise."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights of a seabed on a square grid."""

    heights: npt.NDArray[np.floating]
    """(rows, cols) world z in metres; row grows with y, col with x."""
    x0: float
    y0: float
    """World position of `heights[0, 0]`."""
    spacing: float


def made(
    *,
    title: str,
    bounds: npt.ArrayLike,
    water: float,
    field_of_view: tuple[float, float],
    targets: Targets | None = None,
    obstacles: npt.NDArray[np.floating] | None = None,
    seabed: HeightGrid | None = None,
    voxels: Voxels | None = None,
    path: Path | None = None,
) -> RunScene:
    """A scene of what is there.

    Args:
        title: Such as the world's name and seed.
        bounds: (2, 3) lowest and highest corner of the operator's box.
        water: Height of the water's surface.
        field_of_view: Of the camera, across and up: full angles, radians.
        targets: Individuals, as only a simulator knows them.
        obstacles: (T, 3, 3) corners of the triangles of all else that is solid.
        seabed: What of it lies within `APRON` of the bounds is shown.
        voxels: What the vehicle mapped; see `mapped`.
        path: Where it went.

    Raises:
        ValueError: A part is not of its shape, or too large to be shown.
    """
    box = np.asarray(bounds, np.float64)
    none: Int32Array = np.empty(0, np.int32)
    return RunScene(
        title=title,
        bounds=box,
        water=water,
        field_of_view=field_of_view,
        targets=SceneSurface.none() if targets is None else _thinned(targets.triangles, targets.owner),
        kinds=() if targets is None else targets.kinds,
        kind=np.asarray(none if targets is None else targets.kind, np.uint8),
        seen_at=steps(none if targets is None else targets.seen_at),
        inspected_at=steps(none if targets is None else targets.inspected_at),
        obstacles=SceneSurface.none()
        if obstacles is None
        else _thinned(obstacles, np.full(len(obstacles), -1)),
        seabed=SceneSurface.none() if seabed is None else _seabed(seabed, box),
        voxels=Voxels.none() if voxels is None else voxels,
        path=Path.none() if path is None else path,
    )


def mapped(
    size: float,
    positions: npt.ArrayLike,
    target: npt.ArrayLike,
    seen_at: npt.ArrayLike,
    inspected_at: npt.ArrayLike,
) -> Voxels:
    """What a map holds as solid; of more voxels than can be shown eight are made one, until they are fewer.

    Args:
        size: Metres a side.
        positions: (n, 3) middles.
        target: (n,) taken for a target.
        seen_at: (n,) the step from which on it is mapped; 0 where that is not known.
        inspected_at: (n,) the step from which on it is inspected; −1 where it is not.
    """
    middles: npt.NDArray[np.floating] = np.asarray(positions, np.float64).reshape(-1, 3)
    is_target, seen, inspected = np.asarray(target, bool), steps(seen_at), steps(inspected_at)
    while len(middles) > MOST_VOXELS:
        size *= 2.0
        cells, at = np.unique(np.floor(middles / size).astype(np.int64), axis=0, return_inverse=True)
        at = at.reshape(-1)
        middles = (cells + 0.5) * size
        # A coarse one is as far as the target in it that comes last.
        is_target, was_target = _any(at, is_target, len(cells)), is_target
        seen, inspected = (
            _least(at, seen, len(cells)),
            _greatest(at[was_target], inspected[was_target], len(cells)),
        )
    return Voxels(size, middles.astype(np.float32), is_target, seen, inspected)


def steps(numbers: npt.ArrayLike) -> UInt16Array:
    """Numbers of steps as a scene holds them: `NEVER` in place of what is below 0."""
    given = np.asarray(numbers)
    if given.size and given.max() >= NEVER:
        raise ValueError(f"steps: expected numbers below {NEVER}, got {given.max()}")
    return np.where(given < 0, NEVER, given).astype(np.uint16)


def _any(at: npt.NDArray[np.intp], flags: BoolArray, count: int) -> BoolArray:
    return np.bincount(at, flags, count) > 0


def _least(at: npt.NDArray[np.intp], values: UInt16Array, count: int) -> UInt16Array:
    found = np.full(count, NEVER, np.uint16)
    np.minimum.at(found, at, values)
    return found


def _greatest(at: npt.NDArray[np.intp], values: UInt16Array, count: int) -> UInt16Array:
    found = np.zeros(count, np.uint16)
    np.maximum.at(found, at, values)
    return found


def _thinned(triangles: npt.NDArray[np.floating], owner: npt.NDArray[np.integer]) -> SceneSurface:
    """Triangles as a mesh whose corners are shared within an individual; coarser, where they are too many."""
    corners = np.asarray(triangles, np.float64).reshape(-1, 3, 3)
    if len(owner) != len(corners):
        raise ValueError(f"owner: expected one for each of {len(corners)} triangles, got {len(owner)}")
    grid = FINEST
    parts = _welded(corners, owner, grid)
    while len(parts[1]) > AIM_FACES:
        grid *= 1.5
        parts = _welded(corners, owner, grid)
    return SceneSurface(*parts)


def _welded(
    corners: npt.NDArray[np.float64], owner: npt.NDArray[np.integer], grid: float
) -> tuple[Float32Array, Int32Array, Int32Array]:
    """One vertex for all corners of an individual in one cell of the grid, at their mean.

    What has lost its area is left out, and so is a triangle that another covers. Positions, faces and owners
    are those of a `SceneSurface`, which may be too large for one.

    Reference: vertex clustering, Rossignac and Borrel (1993).
    """
    points = corners.reshape(-1, 3)
    keys = np.column_stack([np.repeat(owner, 3), np.rint(points / grid)]).astype(np.int64)
    # One number each: rows are sorted five times as slowly.
    keys -= keys.min(axis=0) if len(keys) else 0
    sides = keys.max(axis=0, initial=0) + 1
    if np.prod(sides.astype(np.float64)) > 2.0**62:
        raise ValueError("triangles: expected them in one place, got them too far apart")
    flat = ((keys[:, 0] * sides[1] + keys[:, 1]) * sides[2] + keys[:, 2]) * sides[3] + keys[:, 3]
    cells, first, at, count = np.unique(flat, return_index=True, return_inverse=True, return_counts=True)
    faces = at.reshape(-1, 3)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, kept = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    mean = np.column_stack([np.bincount(at.reshape(-1), axis, len(cells)) for axis in points.T])
    return (
        (mean / count[:, None]).astype(np.float32),
        faces[np.sort(kept)].astype(np.int32),
        np.repeat(owner, 3)[first].astype(np.int32),
    )


def _seabed(grid: HeightGrid, bounds: npt.NDArray[np.float64]) -> SceneSurface:
    """Two triangles a square, split from its lower-left to its upper-right corner."""
    rows, cols = grid.heights.shape
    (left, lower), (right, upper) = (
        np.floor((bounds[0, :2] - APRON - (grid.x0, grid.y0)) / grid.spacing).astype(int),
        np.ceil((bounds[1, :2] + APRON - (grid.x0, grid.y0)) / grid.spacing).astype(int),
    )
    every = max(1, -(-int(max(right - left, upper - lower)) // MOST_POSTS))
    row = np.arange(max(0, lower), min(rows - 1, upper) + 1, every)
    col = np.arange(max(0, left), min(cols - 1, right) + 1, every)
    x, y = np.meshgrid(grid.x0 + col * grid.spacing, grid.y0 + row * grid.spacing)
    positions = np.stack([x, y, grid.heights[np.ix_(row, col)]], axis=-1).reshape(-1, 3)
    corner = np.arange(len(row) * len(col), dtype=np.int32).reshape(len(row), len(col))
    a, b, c, d = (
        part.reshape(-1) for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    )
    faces: Int32Array = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    vertices: Float32Array = positions.astype(np.float32)
    return SceneSurface(vertices, faces, np.full(len(vertices), -1, np.int32))
