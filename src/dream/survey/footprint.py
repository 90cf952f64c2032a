"""Observations of a wreck → the ground that it stands over, and how high it reaches."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.perception.scatter import SCATTERS, steadied
from dream.protocol import SurveyProtocol
from dream.survey.ground import Frame
from dream.types import BoolArray, Label

Float64Array = npt.NDArray[np.float64]

FOOT, TOP = 1, 2
"""Pixels on each side that scattering depths are averaged over: for the footprint, and for the highest point,
which is seen from further off."""


@dataclass(frozen=True, slots=True)
class Top:
    """The highest point that one frame shows."""

    z: float
    """Metres in the world."""
    error: float
    """Metres, standard error of that."""
    cut: bool
    """Does the edge of the image cut off what is above it?"""

    @property
    def sure(self) -> float:
        """World z, less its error: the greatest of many heights that scatter is too great."""
        return self.z - self.error


class Footprint:
    """What each frame shows of a wreck, put together.

    What it does: cells are covered where most of the frames, by weight z⁻⁴, show target; where depths
    scatter, two frames at least have to show it there or right beside. The highest point is the highest
    that any frame shows, less one standard error. Where depths scatter they are averaged first, over pixels
    of one surface: a mean across the edge of a hull would lie in the water behind it.

    Assumes: labels that are wrong in one frame are right in most others; poses that are true to a cell.

    Fails when: what was seen from one place only is wanted from a sensor that errs: it counts as not there.
    """

    def __init__(self, bounds: Bounds, cell: float, protocol: SurveyProtocol, scatter: float) -> None:
        """Nothing is known yet.

        Args:
            bounds: What to draw.
            cell: Metres.
            protocol: Reach and depth limits.
            scatter: Per metre: depths z scatter by σ = this z², see `perception.scatter.scatter_of`.
        """
        self.cell = cell
        self._scatter = scatter
        self._corner = np.array([bounds.x_min, bounds.y_min])
        self._limits = np.array([*protocol.returns, protocol.reach])
        shape = (round(bounds.depth / cell), round(bounds.width / cell))
        self._weight = np.zeros((2, *shape), np.float32)
        self._last = np.full((2, *shape), -1, np.int32)
        self._times = np.zeros(shape, np.uint16)
        self._number = count()
        self._tops: list[Top] = []

    @property
    def support(self) -> int:
        """Frames that have to show a cell as covered before that is believed."""
        return 2 if self._scatter > SCATTERS else 1

    def covered(self, support: int) -> BoolArray:
        """(rows, cols) is there any of the wreck above the ground of each cell, as so many frames say?"""
        from scipy import ndimage

        seabed, target = self._weight
        most: BoolArray = (target > 0.0) & (target >= seabed)
        return most & (ndimage.maximum_filter(self._times, 3) >= support)

    @property
    def top(self) -> Top | None:
        """The highest point; None where nothing was seen."""
        return max(self._tops, key=lambda top: top.sure, default=None)

    def integrate(self, frame: Frame) -> None:
        """Add what a frame shows."""
        from dream.survey import _kernels

        depth, _ = steadied(frame, FOOT, self._scatter)
        _kernels.vote(
            depth,
            frame.labels,
            frame.lens,
            frame.rotation,
            frame.origin,
            self._limits,
            self._corner,
            self.cell,
            next(self._number),
            self._last,
            self._weight,
            self._times,
        )
        self._note_top(frame)

    def _note_top(self, frame: Frame) -> None:
        # From further off than labels are trusted: the top of a hull is only then in the image.
        depth, averaged = steadied(frame, TOP, self._scatter)
        valid = (frame.labels == Label.TARGET) & (depth >= self._limits[0]) & (depth <= self._limits[1])
        if not valid.any():
            return
        rows, cols = np.nonzero(valid)
        fx, fy, cx, cy = frame.lens
        rise = frame.rotation[2] @ np.stack(
            [(cols + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(len(rows))]
        )
        along = depth[valid].astype(np.float64)
        z = frame.origin[2] + along * rise
        error = self._scatter * along**2 * np.abs(rise) / np.sqrt(averaged[valid])
        highest = int((z - error).argmax())
        self._tops.append(Top(float(z[highest]), float(error[highest]), bool(rows[highest] == 0)))
