"""Hand-made frames: a flat floor, targets painted on it, boxes that stand on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dream.protocol import DREAM_V1, SurveyProtocol
from dream.types import Float32Array, Label, UInt8Array

Where = Callable[[npt.NDArray[np.float64], npt.NDArray[np.float64]], npt.NDArray[np.bool_]]


def nowhere(ahead: npt.NDArray[np.float64], left: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    return np.zeros(ahead.shape, np.bool_)


def floor(
    target: Where = nowhere, solid: Where = nowhere, protocol: SurveyProtocol = DREAM_V1
) -> tuple[Float32Array, UInt8Array]:
    """Depth and labels of a flat floor: targets lie flat where told, boxes a metre high stand where told."""
    camera = protocol.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    optical = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    rays = optical @ protocol.T_base_camera.rotation.T
    down = -rays[..., 2]
    depth = np.where(down > 1e-6, protocol.altitude / np.maximum(down, 1e-6), np.inf)
    labels = np.full(depth.shape, int(Label.SEABED))
    labels[target(depth * rays[..., 0], depth * rays[..., 1])] = int(Label.TARGET)
    top = 0.5 * protocol.altitude
    # Where a ray first comes below the top of a box, or later meets its foot, a wall stands in its way.
    for share in np.linspace(top / protocol.altitude, 1.0, 41)[::-1]:
        along = share * depth
        hit = solid(along * rays[..., 0], along * rays[..., 1]) & np.isfinite(depth)
        depth, labels = np.where(hit, along, depth), np.where(hit, int(Label.OBSTACLE), labels)
    far = depth > protocol.max_depth
    depth, labels = np.where(far, np.nan, depth), np.where(far, int(Label.WATER), labels)
    return depth.astype(np.float32), labels.astype(np.uint8)
