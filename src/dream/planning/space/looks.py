"""What a look from somewhere would show of points on surfaces, as far as the volume is known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Observation

if TYPE_CHECKING:
    from dream.planning._kernels.looks import LookOptics
    from dream.planning.space.ways import KnownWays

FloatArray = npt.NDArray[np.floating[Any]]

WITHIN = 0.95
"""A look is counted on as far as this share of the reach, and of the greatest useful angle."""


def shown(
    ways: KnownWays,
    position: tuple[float, float, float],
    yaw: float,
    tilt: float,
    points: FloatArray,
    normals: FloatArray,
    cosines: FloatArray | None = None,
) -> BoolArray:
    """(P,) which points one look shows: in the image, within reach, at a useful angle, nothing solid between.

    Args:
        ways: Of which the voxels are taken.
        position: Of the camera, metres in the world.
        yaw: Of the vehicle, radians.
        tilt: Of the camera, radians downwards.
        points: (P, 3) metres in the world, middles of voxels at the surface.
        normals: (P, 3) of length 1, towards the water.
        cosines: (P,) of the greatest angle to each normal that is useful; the protocol's where None.
    """
    from dream.planning._kernels import looks as kernels

    optics = optics_of(ways.protocol)
    least = np.full(len(points), optics.cosine) if cosines is None else cosines
    found: BoolArray = kernels.shown(
        ways.scene, optics, np.array(position, np.float64), yaw, tilt, points, normals, least
    )
    return found


def gains(
    ways: KnownWays, cameras: FloatArray, points: FloatArray, normals: FloatArray, weights: FloatArray
) -> FloatArray:
    """(C, headings, tilts) weight (P,) of all points that looks from cameras (C, 3) show; else as `shown`."""
    from dream.planning._kernels import looks as kernels

    protocol = ways.protocol
    found: FloatArray = kernels.gains(
        ways.scene,
        optics_of(protocol),
        cameras,
        np.arange(protocol.headings) * protocol.heading_step,
        np.array(protocol.tilts),
        points,
        normals,
        weights,
    )
    return found


def edges(ways: KnownWays, middles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where known water beside some voxels ends.

    Args:
        ways: Of which the voxels are taken.
        middles: (m, 3) of those voxels, metres in the world.

    Returns:
        found: (n, 3) middles of free voxels around them that have an unknown one at a face.
        towards: (n, 3) the sum of the directions out of the unknown, of no length where they cancel out.
    """
    from dream.planning._kernels import looks as kernels

    first, side = ways.scene.first, ways.scene.side
    voxels = np.floor(middles[:, ::-1] / side).astype(np.int64) - first
    at, away = kernels.edges(ways.scene, voxels)
    found, index = np.unique(at, axis=0, return_index=True)
    return np.asarray((found + first + 0.5)[:, ::-1] * side, np.float64), away[index][:, ::-1]


def optics_of(protocol: SurveyProtocol) -> LookOptics:
    """Camera, reach and greatest useful angle of a protocol that moves in space."""
    from dream.planning._kernels.looks import LookOptics

    assert protocol.space is not None
    camera = protocol.camera
    return LookOptics(
        0.5 * camera.width / camera.fx,
        0.5 * camera.height / camera.fy,
        WITHIN * protocol.reach,
        math.cos(WITHIN * protocol.space.incidence),
    )


def nearest_tilt(protocol: SurveyProtocol, observation: Observation) -> int:
    """Which of the protocol's tilts the camera has."""
    return int(np.abs(np.array(protocol.tilts) - observation.tilt).argmin())
