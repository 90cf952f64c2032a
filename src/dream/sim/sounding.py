"""What the four beams of a DVL meet: ground, and what stands on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import SE3, Camera, FloatArray, camera_mount
from dream.sim.render import Renderer

SLANT = math.radians(22.5)
"""Of each beam from the instrument's axis (Water Linked A50, data sheet), ahead and astern to both sides."""
_BESIDE = math.tan(SLANT) / math.sqrt(2.0)
_BEAMS = Camera(2, 2, 0.5 / _BESIDE, 0.5 / _BESIDE, 1.0, 1.0)
"""A camera whose four pixels look along the beams."""
_DOWN = camera_mount(0.5 * math.pi)


@dataclass(frozen=True, slots=True)
class Sounder:
    """Four beams downwards from the middle of the vehicle.

    What it does: each returns from the first thing on its axis.

    Assumes: beams without width.
    """

    renderer: Renderer

    def ranges(self, T_world_base: SE3) -> FloatArray:
        """(4,) metres along the beams, NaN without return: ahead left and right, astern left and right."""
        depth = self.renderer.measure(_BEAMS, T_world_base @ _DOWN).depth.astype(np.float64)
        return depth.ravel() / math.cos(SLANT)


def altitude(ranges: FloatArray) -> float:
    """Metres along the instrument's axis, the mean of the beams (4,) that return; NaN where none does."""
    back = np.isfinite(ranges)
    return float(ranges[back].mean()) * math.cos(SLANT) if back.any() else math.nan
