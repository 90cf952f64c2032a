"""Small worlds made by hand, whose pictures are known on paper or hard to draw."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, Bounds, Camera, camera_mount
from dream.sim.water import WATERS, Water
from dream.sim.world import Instances, Mesh, Terrain, World

DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""R_world_camera of a camera that looks straight down, with east to the right."""


def ball(rings: int, color: tuple[int, int, int] = (150, 140, 120), bump: float = 0.0, seed: int = 0) -> Mesh:
    """A unit sphere of 4·rings² triangles or so, its radius shaken by `bump`."""
    rng = np.random.default_rng(seed)
    sides = 2 * rings
    points = [(0.0, 0.0, -1.0)]
    for i in range(1, rings):
        for j in range(sides):
            polar, around = math.pi * i / rings, 2.0 * math.pi * j / sides
            r = 1.0 + bump * rng.normal()
            points.append(
                (
                    r * math.sin(polar) * math.cos(around),
                    r * math.sin(polar) * math.sin(around),
                    -r * math.cos(polar),
                )
            )
    points.append((0.0, 0.0, 1.0))
    last = len(points) - 1

    def at(i: int, j: int) -> int:
        return 0 if i == 0 else last if i == rings else 1 + (i - 1) * sides + j % sides

    faces = []
    for i in range(rings):
        for j in range(sides):
            a, b, c, d = at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)
            faces += [[a, b, c]] * (i > 0) + [[a, c, d]] * (i < rings - 1)
    return Mesh(
        np.array(points, np.float32), np.array(faces, np.int32), np.full((len(points), 3), color, np.uint8)
    )


def plate(color: tuple[int, int, int] = (120, 120, 120), *, two_sided: bool = True) -> Mesh:
    """The unit square of the plane y = 0, its front towards −y."""
    vertices = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(vertices, faces, np.full((4, 3), color, np.uint8), two_sided)


def instances(
    mesh: list[int],
    position: npt.ArrayLike,
    scale: npt.ArrayLike = 1.0,
    wxyz: npt.ArrayLike = (1.0, 0.0, 0.0, 0.0),
) -> Instances:
    """Placed meshes; a single scale or quaternion serves all."""
    count = len(mesh)
    return Instances(
        mesh=np.array(mesh, np.int32),
        position=np.array(position, np.float32).reshape(count, 3),
        wxyz=np.ascontiguousarray(np.broadcast_to(np.array(wxyz, np.float32), (count, 4))),
        scale=np.ascontiguousarray(np.broadcast_to(np.array(scale, np.float32), (count, 3))),
        tint=np.ones((count, 3), np.float32),
        group=np.zeros(count, np.int32),
    )


def world(
    meshes: tuple[Mesh, ...] = (),
    targets: Instances | None = None,
    obstacles: Instances | None = None,
    *,
    floor: float = -10.0,
    relief: float = 0.0,
    water: Water = WATERS["clear"],
    targets_are_hull: bool = False,
    half: float = 30.0,
) -> World:
    """A square of seabed with these things on it; `relief` shakes its heights."""
    count = round(2.0 * half) + 1
    targets = targets if targets is not None else instances([], [])
    heights = floor + relief * np.random.default_rng(5).normal(size=(count, count))
    return World(
        name="hand/made",
        seed=7,
        protocol="dream-v1",
        bounds=Bounds(-10, -10, 10, 10),
        starts=(SE2(0.0, 0.0, 0.0),),
        terrain=Terrain(heights.astype(np.float32), -half, -half, 1.0),
        meshes=meshes,
        targets=targets,
        hull=np.full(len(targets), targets_are_hull),
        obstacles=obstacles if obstacles is not None else instances([], []),
        water=water,
    )


def jumble(seed: int = 3) -> World:
    """Bumpy balls stretched and turned every way, plates seen from both sides, rough ground."""
    rng = np.random.default_rng(seed)
    meshes = (
        ball(6, bump=0.1),
        ball(8, bump=0.15, seed=1),
        plate(),
        plate(two_sided=False),
        ball(20, bump=0.05),
    )

    def scattered(mesh: npt.NDArray[np.signedinteger], low: float, high: float) -> Instances:
        count = len(mesh)
        wxyz = rng.normal(size=(count, 4))
        return instances(
            list(mesh),
            np.column_stack([rng.uniform(-6, 6, (count, 2)), rng.uniform(-10.0, -8.2, count)]),
            rng.uniform(low, high, (count, 3)),
            wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True),
        )

    return world(
        meshes,
        targets=scattered(rng.integers(0, 3, 150), 0.08, 0.4),
        obstacles=scattered(np.array([2, 3, 3, 4, 1, 1, 0]), 0.4, 1.3),
        relief=0.25,
    )


def looking(x: float, y: float, z: float, yaw: float, pitch: float = math.radians(20.0)) -> SE3:
    """T_world_camera of a level vehicle's camera."""
    return SE3.level(x, y, z, yaw) @ camera_mount(pitch)


def camera(width: int = 80, height: int = 60, fov: float = math.radians(90.0)) -> Camera:
    return Camera.from_fov(width, height, fov)
