"""What a vehicle has traversed: what counts as seen under a protocol that asks for it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dream.protocol import SurveyProtocol

FloatArray = npt.NDArray[np.floating[Any]]


def traversed(
    east: FloatArray,
    north: FloatArray,
    yaw: npt.ArrayLike,
    protocol: SurveyProtocol,
    *,
    margin: float = 0.0,
) -> npt.NDArray[np.bool_]:
    """Which points pass under the body, or ahead of it in the sector of the image, within `traversal`?

    Nothing hides them. Where the protocol has no `traversal`, none do.

    Args:
        east: Metres over ground from the vehicle to each point.
        north: Likewise.
        yaw: Of the vehicle, radians; one for all points, or one for each.
        protocol: Says how near, and has the body and the camera.
        margin: Metres from the edges of what counts that a point must keep.
    """
    camera, near = protocol.camera, protocol.traversal
    if near is None:
        return np.zeros(np.shape(east), np.bool_)
    c, s = np.cos(yaw), np.sin(yaw)
    ahead, right, distance = c * east + s * north, s * east - c * north, np.hypot(east, north)
    # The column of the image, times the distance ahead; both edges of the image are half-planes.
    u = camera.fx * right + camera.cx * ahead
    left_edge = margin * np.hypot(camera.fx, camera.cx)
    right_edge = margin * np.hypot(camera.fx, camera.width - camera.cx)
    in_front = (ahead > 0.0) & (u >= left_edge) & (camera.width * ahead - u >= right_edge)
    under = distance <= protocol.body_radius - margin
    return np.asarray((distance <= near - margin) & (in_front | under), np.bool_)
