"""By how much depths scatter, and means over one surface, which scatter less.

The depth of a stereo pair errs by σ = s z²: its disparity, and with it 1/z, errs alike everywhere. So all
here goes by inverse depths, which on a plane are linear in the pixel besides.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from dream.types import Float32Array, Label, UInt8Array

SCATTERS = 0.0005
"""Per metre: depths that scatter more are averaged before they are used."""
ENOUGH = 100
"""Pixels of flat seabed that show how depths scatter."""
ONE_SURFACE = 4.0
"""Standard deviations of a difference by which the depths of one surface may differ."""
SLOPE = 0.001
"""Per metre: and by which they may on a slope."""


class Frame(Protocol):
    """What of a camera frame is looked at."""

    @property
    def depth(self) -> Float32Array:
        """(H, W) metres along the optical axis; NaN where there is no return."""
        ...

    @property
    def labels(self) -> UInt8Array:
        """(H, W) values of `Label`."""
        ...


class Scatter:
    """By how much depths scatter, as the frames tell that it is given.

    What it does: on a plane the second differences of inverse depth along a row show nothing but noise. Their
    median magnitude over flat seabed passes over edges, and that over the frames over odd ones.

    Assumes: errors that are independent from pixel to pixel.

    Fails when: neighbouring pixels err alike, as where depth was smoothed or comes in steps; then it finds
    less than there is, down to nothing.
    """

    def __init__(self) -> None:
        """Nothing was seen yet."""
        self._found: list[float] = []

    def add(self, frame: Frame) -> None:
        """Take in one frame; one that shows hardly any seabed tells nothing."""
        depth = frame.depth.astype(np.float64)
        inverse = 1.0 / np.where((depth > 0.0) & np.isfinite(depth), depth, np.nan)
        bend = np.abs(inverse[:, :-2] - 2.0 * inverse[:, 1:-1] + inverse[:, 2:])
        seabed = frame.labels == Label.SEABED
        flat = seabed[:, :-2] & seabed[:, 1:-1] & seabed[:, 2:] & np.isfinite(bend)
        if np.count_nonzero(flat) >= ENOUGH:
            # The median of |N(0, 1)| is 0.6745; the second difference has six times the variance.
            self._found.append(float(np.median(bend[flat])) / 0.6745 / math.sqrt(6.0))

    @property
    def value(self) -> float:
        """Per metre: depths z scatter by σ = this z². 0 where no frame told."""
        return float(np.median(self._found)) if self._found else 0.0


def scatter_of(frames: Iterable[Frame]) -> float:
    """`Scatter.value` after some frames."""
    scatter = Scatter()
    for frame in frames:
        scatter.add(frame)
    return scatter.value


def steadied(frame: Frame, half: int, scatter: float) -> tuple[Float32Array, npt.NDArray[np.int32]]:
    """Depths averaged over the pixels around that show the same surface.

    A mean across the edge of what stands up would lie in the water behind it. Surfaces whose difference
    drowns in the scatter are taken for one: at σ = 0.002 z² and 7.5 m those less than 0.7 m apart.

    Args:
        frame: Its depths and labels.
        half: The mean is over at most (2 half + 1)² pixels.
        scatter: Per metre, as `scatter_of` finds it; depths that hardly scatter are left as they are.

    Returns:
        (H, W) metres, NaN where there is no return (those of the frame itself where they hardly scatter); and
        (H, W) how many pixels each is the mean of.
    """
    from dream.perception import _kernels

    if scatter <= SCATTERS:
        return frame.depth, np.ones(frame.depth.shape, np.int32)
    apart = ONE_SURFACE * math.sqrt(2.0) * scatter + SLOPE
    depth, averaged = _kernels.steadied(frame.depth, frame.labels, half, apart)
    return depth, averaged
