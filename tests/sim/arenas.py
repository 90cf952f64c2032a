"""Worlds built by hand for closed forms: a flat seabed and boxes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import DREAM_V1
from dream.sim.water import Water
from dream.sim.world import Instances, Mesh, Terrain, World

HALF = 12.0
FLOOR = -10.0
EYE = FLOOR + DREAM_V1.altitude


def box() -> Mesh:
    """A unit cube that stands on its origin."""
    vertices = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (1, 5, 7, 3), (0, 2, 6, 4)]
    faces = [(q[0], q[i], q[i + 1]) for q in quads for i in (1, 2)]
    return Mesh(vertices, np.array(faces, np.int32), np.full((8, 3), 128, np.uint8))


def placed(mesh: int, positions: npt.ArrayLike, scales: npt.ArrayLike) -> Instances:
    position = np.asarray(positions, np.float32).reshape(-1, 3)
    count = len(position)
    return Instances(
        mesh=np.full(count, mesh, np.int32),
        position=position,
        wxyz=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scale=np.broadcast_to(np.asarray(scales, np.float32), (count, 3)).copy(),
        tint=np.ones((count, 3), np.float32),
        group=np.zeros(count, np.int32),
    )


NOTHING = placed(0, np.empty((0, 3)), 1.0)


def flat() -> Terrain:
    count = int(2 * (HALF + 10) / 0.5) + 1
    return Terrain(np.full((count, count), FLOOR, np.float32), -HALF - 10, -HALF - 10, 0.5)


def arena(
    obstacles: Instances = NOTHING, targets: Instances = NOTHING, terrain: Terrain | None = None
) -> World:
    return World(
        name="by hand",
        seed=0,
        protocol="dream-v1",
        bounds=Bounds(-HALF, -HALF, HALF, HALF),
        starts=(SE2(0.0, 0.0, 0.0),),
        terrain=terrain or flat(),
        meshes=(box(),),
        targets=targets,
        hull=np.zeros(len(targets), np.bool_),
        obstacles=obstacles,
        water=Water("clear", (0.1, 0.1, 0.1), (0.1, 0.1, 0.1), (0.1, 0.2, 0.3)),
    )
