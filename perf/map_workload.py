"""Posed, noisy frames of a made seabed, and the exact answers that a map of it is scored against.

An arena of 50 x 50 m: an undulating seabed near z = −10 m with boulders, piles, boxes, walls and oysters,
inside a ring wall. A camera 1.5 m above the bare seabed first turns on the spot, then mows the lawn.
Everything follows from a seed. World frame as in `dream.geometry`: east-north-up, metres.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, Bounds, Camera, camera_mount
from dream.sim.meshes import icosphere, mesh
from dream.sim.water import WATERS
from dream.sim.world import Instances, Mesh, Terrain, World
from dream.types import Label

Float64Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Array = npt.NDArray[Any]

VERSION = 2
"""Of the workload; what a cache holds of another version is made again."""
HALF = 25.0
"""Metres from the arena's centre to its sides."""
RING = 0.45
"""Metres of ring wall inside each side: no whole cells, so that its face lies on no border of cells."""
THICKNESS = 0.5
"""Of the ring wall; the rest of it stands outside the arena."""
FRINGE = 0.5
"""Metres in front of the ring wall that are not scored either: almost four deviations of the depth at 8 m, so
that what noise smears off a wall that is not scored is not scored."""
RASTER = 0.025
"""Metres between the points that areas are measured with."""
ALTITUDE = 1.5
CAMERA = Camera.from_fov(640, 480, math.radians(90.0))
MOUNT = camera_mount(math.radians(20.0))
PANORAMA, FRAMES = 24, 300
MIN_DEPTH, MAX_DEPTH = 0.1, 20.0
NOISE = 0.002
"""Standard deviation of a depth z is `NOISE` z², both in metres."""
MISSED = 0.1
"""Probability with which an individual is missed in a frame."""
BLOBS = 1.5
"""Mean number of false targets in a frame."""
CLEARANCE = 0.6
"""Least metres between the camera's path and an obstacle."""
OYSTERS = 140.0
"""Square metres covered by clumps."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The arena, for the renderer and as the solids that truth is computed from."""

    seed: int
    world: World
    ellipsoids: Float64Array
    """(E, 7) x, y, z of the centre, three half-axes (the third upright), yaw."""
    boxes: Float64Array
    """(B, 7) x, y, z of foot, half-length, half-width, height, yaw; the last four are the ring wall."""
    clumps: Float64Array
    """(C, 5) x, y, two half-axes over ground, yaw."""
    poses: tuple[SE3, ...]
    """`T_world_camera` of each frame."""

    @property
    def bounds(self) -> Bounds:
        """The arena; its lower-left corner is that of cell (0, 0)."""
        return self.world.bounds

    @property
    def camera(self) -> Camera:
        """Intrinsics of every frame."""
        return CAMERA


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What the camera gives from one pose, and without errors what it should have given."""

    depth_mm: npt.NDArray[np.uint16]
    """(H, W) millimetres along the optical axis with noise, 0 for none."""
    depth_m: npt.NDArray[np.float32]
    """(H, W) metres without noise, NaN for none. For truth only."""
    labels: npt.NDArray[np.uint8]
    """(H, W) values of `Label`, all right."""
    labels_noisy: npt.NDArray[np.uint8]
    """(H, W) the same with missed individuals and false targets."""
    T_world_camera: SE3


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a perfect map would hold: (rows, cols) bool, rows grow with y, cell (0, 0) is lower-left."""

    solid: BoolArray
    """Some obstacle, the ring wall included, stands in the height band over some 2.5 cm point of the cell."""
    solid_observed: BoolArray
    """At least 3 noise-free returns labelled obstacle, within reach and in the band, over all frames."""
    target: BoolArray
    """Clumps cover at least half of the cell's 2.5 cm points."""
    target_touched: BoolArray
    """Clumps cover at least one of the cell's 2.5 cm points."""
    target_observed: BoolArray
    """Some noise-free return labelled target within reach."""
    explored_2d: BoolArray
    """The paper's E_t among the true obstacles; see `truth`."""
    explored_3d: BoolArray
    """A noise-free ray with a valid return ended in the cell, or crossed it below the top of the band."""
    scored: BoolArray
    """At least `FRINGE` away from the ring wall."""


# ------------------------------------------------------------------------------------------ the arena


def make_scene(seed: int) -> Scene:
    """The arena of a seed."""
    rng = np.random.default_rng(seed)
    terrain = _terrain(rng)
    track, yaws = _track()
    poses = _poses(terrain, track, yaws, rng)
    around = _densified(track)
    ellipsoids, boxes = _obstacles(terrain, around, rng)
    ring = _ring(terrain)
    boxes = np.concatenate([boxes, ring])
    clumps, heights, groups = _oysters(terrain, ellipsoids, boxes, rng)

    ball, faces = icosphere(3)
    coarse, coarse_faces = icosphere(1)
    grey, pale = (96, 92, 84), (150, 142, 124)
    cube = np.array([(x, y, z) for z in (0.0, 1.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    sides = "021 032 456 467 015 054 126 165 237 276 304 347"
    cube_faces = np.array([[int(corner) for corner in side] for side in sides.split()])
    meshes = (
        mesh(ball, faces, np.broadcast_to(grey, ball.shape)),
        mesh(cube, cube_faces, np.broadcast_to(grey, cube.shape)),
        # A ball of few triangles lies inside its sphere; this gives it the sphere's mean radius.
        mesh(1.035 * coarse, coarse_faces, np.broadcast_to(pale, coarse.shape)),
    )
    targets = _instances(
        np.full(len(clumps), 2),
        np.column_stack([clumps[:, :2], terrain.height(clumps[:, 0], clumps[:, 1])]),
        clumps[:, 4],
        np.column_stack([clumps[:, 2:4], heights]),
        groups,
    )
    solids = np.concatenate([ellipsoids, boxes])
    obstacles = _instances(
        np.repeat([0, 1], [len(ellipsoids), len(boxes)]),
        solids[:, :3],
        solids[:, 6],
        solids[:, 3:6],
        np.full(len(solids), -1),
    )
    world = _world(seed, terrain, meshes, targets, obstacles)
    return Scene(seed, world, ellipsoids, boxes, clumps, poses)


def _world(
    seed: int, terrain: Terrain, meshes: tuple[Mesh, ...], targets: Instances, obstacles: Instances
) -> World:
    return World(
        name=f"perf/{seed}",
        seed=seed,
        protocol="dream-v1",
        bounds=Bounds(-HALF, -HALF, HALF, HALF),
        starts=(SE2(0.0, 0.0, 0.0),),
        terrain=terrain,
        meshes=meshes,
        targets=targets,
        hull=np.zeros(len(targets), np.bool_),
        obstacles=obstacles,
        water=WATERS["clear"],
    )


def _instances(index: Array, position: Array, yaw: Array, scale: Array, group: Array) -> Instances:
    zero = np.zeros(len(index))
    return Instances(
        index.astype(np.int32),
        position.astype(np.float32),
        np.stack([np.cos(0.5 * yaw), zero, zero, np.sin(0.5 * yaw)], axis=1).astype(np.float32),
        scale.astype(np.float32),
        np.ones((len(index), 3), np.float32),
        group.astype(np.int32),
    )


def _terrain(rng: np.random.Generator) -> Terrain:
    """Eight waves of 4 to 25 m, the longer the higher, about 0.3 m high together."""
    spacing, half = 0.25, HALF + 6.0
    line = np.arange(-half, half + 0.5 * spacing, spacing)
    x, y = np.meshgrid(line, line)
    z = np.zeros_like(x)
    for length in np.geomspace(4.0, 25.0, 8):
        angle, phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        z += length * np.sin(2.0 * math.pi / length * (x * math.cos(angle) + y * math.sin(angle)) + phase)
    z *= 0.3 / np.abs(z).max()
    return Terrain((z - 10.0).astype(np.float32), -half, -half, spacing)


def _track() -> tuple[Float64Array, Float64Array]:
    """(F, 2) positions and (F,) yaws: a turn on the spot, then lanes 8 m apart."""
    corners = []
    for lane, y in enumerate(np.arange(-20.0, 20.1, 8.0)):
        ends = (-21.0, 21.0) if lane % 2 == 0 else (21.0, -21.0)
        corners += [(ends[0], y), (ends[1], y)]
    points = np.array(corners)
    legs = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(legs)])
    s = np.linspace(0.0, along[-1], FRAMES - PANORAMA)

    def at(distance: Array) -> Float64Array:
        return np.stack([np.interp(distance, along, points[:, k]) for k in (0, 1)], axis=1)

    ahead = at(np.minimum(s + 1.2, along[-1])) - at(np.maximum(s - 1.2, 0.0))
    sway = math.radians(25.0) * np.sin(2.0 * math.pi * s / 11.3)
    yaws = np.arctan2(ahead[:, 1], ahead[:, 0]) + sway
    turn = 2.0 * math.pi / PANORAMA * np.arange(PANORAMA)
    return np.concatenate([np.repeat(points[:1], PANORAMA, 0), at(s)]), np.concatenate([turn, yaws])


def _poses(
    terrain: Terrain, track: Float64Array, yaws: Float64Array, rng: np.random.Generator
) -> tuple[SE3, ...]:
    """Camera poses over the track, rolling and pitching by up to 2 degrees."""
    swing = math.radians(2.0)
    phases = rng.uniform(0.0, 2.0 * math.pi, 2)
    z = terrain.height(track[:, 0], track[:, 1]) + ALTITUDE
    poses = []
    for k, ((x, y), height, yaw) in enumerate(zip(track, z, yaws, strict=True)):
        roll, pitch = swing * math.sin(0.71 * k + phases[0]), swing * math.sin(0.47 * k + phases[1])
        (cr, sr), (cp, sp) = ((math.cos(a), math.sin(a)) for a in (roll, pitch))
        rolled = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        pitched = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        level = SE3.level(float(x), float(y), float(height), float(yaw))
        poses.append(level @ SE3(pitched @ rolled, np.zeros(3)) @ MOUNT)
    return tuple(poses)


def _densified(track: Float64Array) -> Float64Array:
    """(N, 2) points at most 0.2 m apart along the track."""
    steps = np.linspace(0.0, 1.0, 8, endpoint=False)
    between = track[:-1, None] + steps[:, None] * (track[1:] - track[:-1])[:, None]
    return np.concatenate([between.reshape(-1, 2), track[-1:]])


def _obstacles(
    terrain: Terrain, path: Float64Array, rng: np.random.Generator
) -> tuple[Float64Array, Float64Array]:
    """Walls first, since they are the hardest to place, then boxes, piles and boulders."""
    ellipsoids: list[Array] = []
    boxes: list[Array] = []
    taken: list[tuple[float, float, float]] = []
    # A third low, a third below the camera's height or near it, the rest well above it.
    kinds = ["wall"] * int(rng.integers(4, 7)) + ["box"] * 10 + ["pile"] * 9 + ["boulder"] * 26

    def top() -> float:
        low, high = ((0.6, 1.0), (1.0, 1.7), (1.7, 2.8))[rng.choice(3, p=(0.3, 0.3, 0.4))]
        return float(rng.uniform(low, high))

    for kind in kinds:
        for _ in range(400):
            x, y = rng.uniform(-HALF + 1.5, HALF - 1.5, 2)
            yaw = rng.uniform(0.0, math.pi)
            ground = float(terrain.height(x, y))
            if kind in ("wall", "box"):
                if kind == "wall":
                    half = 0.5 * np.array([rng.uniform(4.0, 10.0), rng.uniform(0.2, 0.5)])
                    high = rng.uniform(2.0, 3.5)
                else:
                    half, high = 0.5 * rng.uniform(0.6, 2.2, 2), top()
                body = np.array([[x, y, ground - 0.6, half[0], half[1], high + 0.6, yaw]])
            elif kind == "boulder":
                a, b, h = rng.uniform(0.4, 1.3), rng.uniform(0.4, 1.3), top()
                c = h * rng.uniform(0.55, 0.8)  # partly sunk
                body = np.array([[x, y, ground + h - c, a, b, c, yaw]])
            else:
                rocks = []
                for _ in range(int(rng.integers(4, 9))):
                    a, b, c = rng.uniform(0.25, 0.8, 3)
                    dx, dy = rng.normal(0.0, 0.55, 2)
                    # The nearer to the middle, the higher it may lie on the others.
                    lift = rng.uniform(0.0, 0.9) * math.exp(-(dx * dx + dy * dy))
                    foot = float(terrain.height(x + dx, y + dy))
                    rocks.append([x + dx, y + dy, foot + 0.3 * c + lift, a, b, c, rng.uniform(0.0, math.pi)])
                body = np.array(rocks)
            circles = [(px, py, float(max(p, q))) for px, py, _, p, q, _, _ in body]
            if kind == "wall":  # a row of circles, so that a long wall does not bar a large disc
                steps = np.linspace(-body[0, 3], body[0, 3], 9)
                circles = [
                    (x + s * math.cos(yaw), y + s * math.sin(yaw), 0.125 * body[0, 3] + 0.3) for s in steps
                ]
            elif kind == "box":
                circles = [(x, y, float(math.hypot(body[0, 3], body[0, 4])))]
            if all(
                max(abs(px), abs(py)) + r < HALF - RING - 0.5
                and np.hypot(path[:, 0] - px, path[:, 1] - py).min() > r + CLEARANCE
                and all(math.hypot(px - tx, py - ty) > r + tr + 0.2 for tx, ty, tr in taken)
                for px, py, r in circles
            ):
                (boxes if kind in ("wall", "box") else ellipsoids).append(body)
                taken += circles
                break
    return np.concatenate(ellipsoids), np.concatenate(boxes)


def _ring(terrain: Terrain) -> Float64Array:
    """(4, 7) boxes along the sides, 3 m high."""
    foot = float(terrain.heights.min()) - 0.5
    high = float(terrain.heights.max()) + 3.0 - foot
    thick = 0.5 * THICKNESS
    middle = HALF - RING + thick
    return np.array(
        [
            [0.0, -middle, foot, HALF + thick, thick, high, 0.0],
            [0.0, middle, foot, HALF + thick, thick, high, 0.0],
            [-middle, 0.0, foot, thick, HALF + thick, high, 0.0],
            [middle, 0.0, foot, thick, HALF + thick, high, 0.0],
        ]
    )


def _oysters(
    terrain: Terrain, ellipsoids: Float64Array, boxes: Float64Array, rng: np.random.Generator
) -> tuple[Float64Array, Float64Array, Array]:
    """Clumps (C, 5), their heights (C,) and reefs (C,): discs and strings until `OYSTERS` are covered."""
    side = round(2.0 * HALF / RASTER)
    covered = np.zeros((side, side), np.bool_)
    blocked = _present(terrain, ellipsoids, boxes, (0.0, math.inf))
    clumps: list[Array] = []
    groups: list[int] = []
    for reef in range(200):
        if covered.sum() * RASTER**2 >= OYSTERS:
            break
        x, y = rng.uniform(-HALF + 3.0, HALF - 3.0, 2)
        yaw = rng.uniform(0.0, math.pi)
        if rng.random() < 0.5:
            long = wide = rng.uniform(1.2, 2.8)
        else:
            long, wide = rng.uniform(3.0, 7.0), rng.uniform(0.4, 0.8)
        pitch = 0.19
        u, v = (
            grid.ravel() for grid in np.meshgrid(np.arange(-long, long, pitch), np.arange(-wide, wide, pitch))
        )
        u, v = u + rng.uniform(-0.06, 0.06, len(u)), v + rng.uniform(-0.06, 0.06, len(v))
        inside = (u / long) ** 2 + (v / wide) ** 2 <= 1.0 if long == wide else np.abs(v) <= wide
        u, v = u[inside], v[inside]
        bend = 0.0 if long == wide else rng.uniform(-0.08, 0.08)
        v = v + bend * u * u
        px, py = x + u * math.cos(yaw) - v * math.sin(yaw), y + u * math.sin(yaw) + v * math.cos(yaw)
        for cx, cy in zip(px, py, strict=True):
            half = 0.5 * rng.uniform(0.15, 0.35, 2)
            clump = np.array([cx, cy, half[0], half[1], rng.uniform(0.0, math.pi)])
            if max(abs(cx), abs(cy)) > HALF - RING - 0.3:
                continue
            rows, cols, within = _ellipse(clump)
            if blocked[rows, cols].any():
                continue
            covered[rows, cols] |= within
            clumps.append(clump)
            groups.append(reef)
    count = len(clumps)
    return np.array(clumps), rng.uniform(0.05, 0.2, count), np.array(groups)


def _ellipse(clump: Array) -> tuple[slice, slice, BoolArray]:
    """The raster rows and columns around a clump, and which of their points it covers."""
    x, y, a, b, yaw = (float(value) for value in clump)
    rows, cols, px, py = _patch(x, y, max(a, b))
    u, v = _turned(px - x, py - y, yaw)
    return rows, cols, (u / a) ** 2 + (v / b) ** 2 <= 1.0


def _turned(x: Array, y: Array, yaw: float) -> tuple[Array, Array]:
    c, s = math.cos(yaw), math.sin(yaw)
    return c * x + s * y, c * y - s * x


def _patch(x: float, y: float, radius: float) -> tuple[slice, slice, Array, Array]:
    """Raster rows and columns within `radius` of a point along each axis, and their x (1, n) and y (m, 1)."""
    side = round(2.0 * HALF / RASTER)
    low_col, past_col, low_row, past_row = (
        min(max(math.floor((value + HALF) / RASTER), 0), side)
        for value in (x - radius, x + radius + RASTER, y - radius, y + radius + RASTER)
    )
    rows, cols = slice(low_row, past_row), slice(low_col, past_col)
    px = (np.arange(low_col, past_col) + 0.5) * RASTER - HALF
    py = (np.arange(low_row, past_row) + 0.5) * RASTER - HALF
    return rows, cols, px[None, :], py[:, None]


def _present(
    terrain: Terrain, ellipsoids: Float64Array, boxes: Float64Array, band: tuple[float, float]
) -> BoolArray:
    """Raster points over which some solid, from its lowest to its highest point there, meets the band.

    The band is in heights above the seabed at that very point; what is below the seabed does not count.
    """
    side = round(2.0 * HALF / RASTER)
    present = np.zeros((side, side), np.bool_)
    for body, is_box in [(b, False) for b in ellipsoids] + [(b, True) for b in boxes]:
        x, y, z, a, b, c, yaw = (float(value) for value in body)
        rows, cols, px, py = _patch(x, y, math.hypot(a, b))
        u, v = _turned(px - x, py - y, yaw)
        if is_box:
            inside = (np.abs(u) <= a) & (np.abs(v) <= b)
            low, high = np.full(u.shape, z), np.full(u.shape, z + c)
        else:
            left = 1.0 - (u / a) ** 2 - (v / b) ** 2
            inside = left >= 0.0
            half = c * np.sqrt(np.maximum(left, 0.0))
            low, high = z - half, z + half
        ground = terrain.height(px, py)
        above = (high - ground > 0.0) & (high - ground >= band[0]) & (low - ground <= band[1])
        present[rows, cols] |= inside & above
    return present


# ----------------------------------------------------------------------------------------- the frames


def default_folder() -> Path:
    """Where frames are kept unless told."""
    return Path(tempfile.gettempdir()) / "dream-perf"


def frames(scene: Scene, folder: Path | None = None) -> list[Frame]:
    """All frames of a scene, rendered once and then read from `folder`.

    Images are mapped from their files: copy one before timing what is done with it. A scene takes 740 MB.
    """
    home = (default_folder() if folder is None else Path(folder)) / f"v{VERSION}-{scene.seed}"
    if not home.is_dir():
        _render(scene, home)
    mm, metres, clean, noisy = (
        np.load(home / f"{name}.npy", mmap_mode="r")
        for name in ("depth_mm", "depth_m", "labels", "labels_noisy")
    )
    return [Frame(mm[k], metres[k], clean[k], noisy[k], pose) for k, pose in enumerate(scene.poses)]


def _render(scene: Scene, home: Path) -> None:
    from dream.sim.render import Renderer

    # Made beside its place and then moved there, so that what was cut short is never taken for whole.
    making = home.with_name(f"{home.name}.{os.getpid()}")
    making.mkdir(parents=True)
    camera, renderer = scene.camera, Renderer(scene.world)
    shape = (len(scene.poses), camera.height, camera.width)
    kinds: dict[str, npt.DTypeLike] = {
        "depth_mm": np.uint16,
        "depth_m": np.float32,
        "labels": np.uint8,
        "labels_noisy": np.uint8,
    }
    stacks = {
        name: np.lib.format.open_memmap(making / f"{name}.npy", mode="w+", dtype=kind, shape=shape)
        for name, kind in kinds.items()
    }
    for k, pose in enumerate(scene.poses):
        seen = renderer.measure(camera, pose)
        rng = np.random.default_rng((scene.seed, 1, k))
        stacks["depth_m"][k] = seen.depth
        stacks["depth_mm"][k] = noisy_depth(seen.depth, rng)
        stacks["labels"][k] = seen.labels
        stacks["labels_noisy"][k] = noisy_labels(seen.labels, seen.ids, rng)
    for stack in stacks.values():
        stack.flush()
    try:
        making.rename(home)
    except OSError:  # another process was first
        shutil.rmtree(making)


def noisy_depth(depth: npt.NDArray[np.float32], rng: np.random.Generator) -> npt.NDArray[np.uint16]:
    """Millimetres of a depth in metres with its noise; 0 where there is none or it is out of range."""
    z = np.asarray(depth, np.float64)
    noisy = z + NOISE * z * z * rng.standard_normal(z.shape)
    valid = (noisy >= MIN_DEPTH) & (noisy <= MAX_DEPTH)
    return np.where(valid, np.rint(1e3 * noisy), 0.0).astype(np.uint16)


def noisy_labels(
    labels: npt.NDArray[np.uint8], ids: npt.NDArray[np.int32], rng: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """Labels with one individual in ten missed and a few discs of seabed or obstacle called target."""
    noisy = labels.copy()
    missed = rng.random(int(ids.max(initial=-1)) + 1) < MISSED
    noisy[(ids >= 0) & np.append(missed, False)[ids]] = Label.SEABED
    other = (labels == Label.SEABED) | (labels == Label.OBSTACLE)
    where = np.flatnonzero(other)
    rows, cols = np.ogrid[: labels.shape[0], : labels.shape[1]]
    for _ in range(rng.poisson(BLOBS) if len(where) else 0):
        row, col = divmod(int(where[rng.integers(len(where))]), labels.shape[1])
        radius = rng.uniform(8.0, 40.0)
        noisy[other & ((rows - row) ** 2 + (cols - col) ** 2 <= radius * radius)] = Label.TARGET
    return noisy


def kilometre(seed: int, folder: Path | None = None) -> Iterator[Frame]:
    """An endless survey over ever new ground: the lanes of a scene again and again, each time moved 50 m.

    The moves follow a square spiral about the origin, so that coordinates are negative as often as
    positive. Consecutive frames are 1.06 m apart; 942 frames make a kilometre.
    """
    scene = make_scene(seed)
    lanes = frames(scene, folder)[PANORAMA:]
    col = row = 0
    step, leg, done, turns = (1, 0), 1, 0, 0
    while True:
        shift = 2.0 * HALF * np.array([col, row, 0.0])
        for frame in lanes:
            pose = frame.T_world_camera
            yield replace(frame, T_world_camera=SE3(pose.rotation, pose.translation + shift))
        col, row, done = col + step[0], row + step[1], done + 1
        if done == leg:
            step, done, turns = (-step[1], step[0]), 0, turns + 1
            leg += turns % 2 == 0


# ------------------------------------------------------------------------------------------ the truth


def truth(
    scene: Scene,
    frames: Sequence[Frame],
    cell: float,
    reach: float,
    band: tuple[float, float],
    blind: float,
    folder: Path | None = None,
) -> Truth:
    """What those frames could tell at best.

    Heights are above the seabed at the very point, distances over ground from the camera.

    - `explored_2d`: a frame's sector holds the cells whose centre is within half the horizontal field of
      view of the camera's yaw, at least `blind` ahead along the view axis and at most `reach` away. 4096
      rays a turn, those inside the sector, walk the cells from the camera's exact position and end in the
      first solid cell. A cell of the sector is seen when a ray enters it, be it by a corner. A ray through
      a corner exactly goes along x first. Solid is `Truth.solid`, the ring wall included.
    - `explored_3d`: rays of all columns and every second row walk the cells up to their return or `reach`.
      A cell counts when the lowest point of the ray over it lies below the top of the band above the
      seabed at the cell's centre. Beside that, every return within reach marks its cell at any height.

    Args:
        scene: The arena.
        frames: Those the map has seen.
        cell: Side of a cell, metres; a whole number of cells fits the arena.
        reach: Metres over ground that returns are used up to.
        band: Heights between which anything is solid.
        blind: Metres ahead that the camera does not see.
        folder: Truth is kept here, where given.
    """
    kept = None
    if folder is not None:
        key = f"{cell}-{reach}-{band[0]}-{band[1]}-{blind:.4f}-{len(frames)}"
        kept = Path(folder) / f"v{VERSION}-{scene.seed}-truth" / f"{key}.npz"
        if kept.is_file():
            with np.load(kept) as stored:
                return Truth(*(stored[name] for name in Truth.__slots__))
    side = round(2.0 * HALF / cell)
    if abs(side * cell - 2.0 * HALF) > 1e-9:
        raise ValueError(f"cell: expected a size that divides {2.0 * HALF} m, got {cell}")
    terrain, camera = scene.world.terrain, scene.camera
    solid = _any_in(_points_of_cells(_present(terrain, scene.ellipsoids, scene.boxes, band), side))
    line = (np.arange(side) + 0.5) * cell - HALF
    ground = terrain.height(line[None, :], line[:, None])
    obstacle_returns = np.zeros((side, side), np.int64)
    target_returns = np.zeros((side, side), np.int64)
    explored_2d = np.zeros((side, side), np.bool_)
    explored_3d = np.zeros((side, side), np.bool_)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    for frame in frames:
        pose = frame.T_world_camera
        _see(
            np.ascontiguousarray(frame.depth_m),
            np.ascontiguousarray(frame.labels),
            intrinsics,
            pose.rotation,
            pose.translation,
            (-HALF, -HALF, cell, reach, band[0], band[1], MIN_DEPTH, MAX_DEPTH),
            terrain.heights,
            (terrain.x0, terrain.y0, terrain.spacing),
            ground,
            obstacle_returns,
            target_returns,
            explored_3d,
        )
        forward = pose.rotation[:, 2]
        _look(
            solid,
            pose.translation[0],
            pose.translation[1],
            math.atan2(forward[1], forward[0]),
            0.5 * camera.horizontal_fov,
            (-HALF, -HALF, cell, reach, blind),
            explored_2d,
        )
    covered = np.zeros((round(2.0 * HALF / RASTER),) * 2, np.bool_)
    for clump in scene.clumps:
        rows, cols, within = _ellipse(clump)
        covered[rows, cols] |= within
    target = _share_in(_points_of_cells(covered, side)) >= 0.5
    target_touched = _any_in(_points_of_cells(covered, side))
    inner = np.abs(line) + 0.5 * cell <= HALF - RING - FRINGE + 1e-9
    found = Truth(
        solid=solid,
        solid_observed=obstacle_returns >= 3,
        target=target,
        target_touched=target_touched,
        target_observed=target_returns > 0,
        explored_2d=explored_2d,
        explored_3d=explored_3d,
        scored=inner[None, :] & inner[:, None],
    )
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        making = kept.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(making, **{name: getattr(found, name) for name in Truth.__slots__})
        making.replace(kept)
    return found


def _points_of_cells(points: BoolArray, side: int) -> Array:
    """(side, n, side, n) raster points by cell."""
    n = points.shape[0] // side
    if n * side != points.shape[0]:
        raise ValueError(f"cell: expected whole multiples of {RASTER} m, got {2.0 * HALF / side}")
    return points.reshape(side, n, side, n)


def _any_in(points: Array) -> BoolArray:
    return np.asarray(points.any(axis=(1, 3)))


def _share_in(points: Array) -> Float64Array:
    return np.asarray(points.mean(axis=(1, 3)))


def _height_python(heights: Any, grid: Any, x: float, y: float) -> float:
    """World z of the seabed, as `Terrain.height` has it."""
    gx = min(max((x - grid[0]) / grid[2], 0.0), heights.shape[1] - 1 - 1e-9)
    gy = min(max((y - grid[1]) / grid[2], 0.0), heights.shape[0] - 1 - 1e-9)
    col, row = int(gx), int(gy)
    fx, fy = gx - col, gy - row
    z00, z01 = heights[row, col], heights[row, col + 1]
    z10, z11 = heights[row + 1, col], heights[row + 1, col + 1]
    if fx >= fy:
        return float(z00 + fx * (z01 - z00) + fy * (z11 - z01))
    return float(z00 + fy * (z10 - z00) + fx * (z11 - z10))


_height = numba.njit(cache=True)(_height_python)


def _see_python(
    depth: Any,
    labels: Any,
    intrinsics: Any,
    rotation: Any,
    origin: Any,
    limits: Any,
    heights: Any,
    grid: Any,
    ground: Any,
    obstacle_returns: Any,
    target_returns: Any,
    crossed: Any,
) -> None:
    """Add one noise-free frame to the counts of returns and to the columns its rays crossed."""
    fx, fy, cx, cy = intrinsics
    x_min, y_min, cell, reach, low, high, nearest, farthest = limits
    side = crossed.shape[0]
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not (nearest <= z <= farthest):
                continue
            a, b = (u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy
            dx = z * (rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2])
            dy = z * (rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2])
            dz = z * (rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2])
            away = math.hypot(dx, dy)
            end = 1.0
            if away <= reach:
                x, y = origin[0] + dx, origin[1] + dy
                col, row = math.floor((x - x_min) / cell), math.floor((y - y_min) / cell)
                if 0 <= row < side and 0 <= col < side:
                    crossed[row, col] = True
                    if labels[v, u] == 2:
                        target_returns[row, col] += 1
                    elif labels[v, u] == 3:
                        above = origin[2] + dz - _height(heights, grid, x, y)
                        if low <= above <= high:
                            obstacle_returns[row, col] += 1
            else:
                end = reach / away
            if v % 2 == 1:
                continue
            # Amanatides and Woo; t runs from 0 at the camera to 1 at the return.
            gx, gy = (origin[0] - x_min) / cell, (origin[1] - y_min) / cell
            col, row = math.floor(gx), math.floor(gy)
            step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
            per_x = cell / abs(dx) if dx != 0.0 else math.inf
            per_y = cell / abs(dy) if dy != 0.0 else math.inf
            next_x = ((col + 1 - gx) if dx > 0.0 else (gx - col)) * per_x if dx != 0.0 else math.inf
            next_y = ((row + 1 - gy) if dy > 0.0 else (gy - row)) * per_y if dy != 0.0 else math.inf
            t = 0.0
            while t < end:
                leave = min(next_x, next_y, end)
                if 0 <= row < side and 0 <= col < side and not crossed[row, col]:
                    lowest = origin[2] + dz * (leave if dz < 0.0 else t)
                    if lowest - ground[row, col] < high:
                        crossed[row, col] = True
                t = leave
                if next_x <= next_y:
                    next_x += per_x
                    col += step_x
                else:
                    next_y += per_y
                    row += step_y


_see = numba.njit(cache=True)(_see_python)


def _look_python(
    solid: Any, x: float, y: float, yaw: float, half_angle: float, limits: Any, explored: Any
) -> None:
    """Add one frame's sector among known solids to the explored cells."""
    x_min, y_min, cell, reach, blind = limits
    side = solid.shape[0]
    cos_yaw, sin_yaw, least = math.cos(yaw), math.sin(yaw), math.cos(half_angle) - 1e-12
    rays = 4096
    first = math.ceil((yaw - half_angle) / (2.0 * math.pi) * rays)
    last = math.floor((yaw + half_angle) / (2.0 * math.pi) * rays)
    for ray in range(first, last + 1):
        angle = 2.0 * math.pi * ray / rays
        dx, dy = math.cos(angle), math.sin(angle)
        gx, gy = (x - x_min) / cell, (y - y_min) / cell
        col, row = math.floor(gx), math.floor(gy)
        per_x = 1.0 / abs(dx) if dx != 0.0 else math.inf
        per_y = 1.0 / abs(dy) if dy != 0.0 else math.inf
        next_x = ((col + 1 - gx) if dx > 0.0 else (gx - col)) * per_x if dx != 0.0 else math.inf
        next_y = ((row + 1 - gy) if dy > 0.0 else (gy - row)) * per_y if dy != 0.0 else math.inf
        t = 0.0
        while t <= reach / cell + 1.0 and 0 <= row < side and 0 <= col < side:
            to_x, to_y = (col + 0.5) * cell + x_min - x, (row + 0.5) * cell + y_min - y
            away = math.hypot(to_x, to_y)
            ahead = to_x * cos_yaw + to_y * sin_yaw
            if away <= reach and ahead >= blind and ahead >= away * least:
                explored[row, col] = True
            if solid[row, col]:
                break
            if next_x <= next_y:
                t = next_x
                next_x += per_x
                col += 1 if dx > 0.0 else -1
            else:
                t = next_y
                next_y += per_y
                row += 1 if dy > 0.0 else -1


_look = numba.njit(cache=True)(_look_python)
