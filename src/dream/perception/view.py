"""Where a picture was taken."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from dream.geometry import SE3, Camera, FloatArray

BEAM_SLANT = math.radians(22.5)
"""Of each of the DVL's beams from its axis (Water Linked A50, data sheet)."""


@dataclass(frozen=True, slots=True)
class View:
    """From where, and through what lens, a picture was taken."""

    camera: Camera
    """Intrinsics of a picture of (H, W)."""
    T_world_base: SE3
    T_base_camera: SE3
    altitude: float
    """Metres of `base` above the floor, along the vertical."""
    beams: FloatArray | None = field(default=None, compare=False)
    """(n, 3) metres in `base`: where beams of the DVL met something; NaN where one did not return."""

    @property
    def T_world_camera(self) -> SE3:
        """Where the optical frame was."""
        return self.T_world_base @ self.T_base_camera


def beam_ends(ranges: FloatArray, T_base_dvl: SE3) -> FloatArray:
    """(4, 3) metres in `base`: where the beams of a DVL end.

    Args:
        ranges: (4,) metres along the beams, ahead left and right, astern left and right; NaN without return.
        T_base_dvl: Where it sits; its own frame is forward-left-up.
    """
    beside = math.sin(BEAM_SLANT) / math.sqrt(2.0)
    down = -math.cos(BEAM_SLANT)
    ahead = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    beams = np.column_stack([beside * ahead, np.full(4, down)])
    along: FloatArray = np.asarray(ranges, np.float64)[:, None]
    return T_base_dvl @ np.asarray(along * beams)
