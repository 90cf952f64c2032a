"""The bare seabed: smooth noise in several octaves, and sand ripples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.sim.sampling import MILLIMETRE, Float64Array, direction, quantised, uniform, uniforms
from dream.sim.world import Terrain

SPACING = 0.25
"""Metres between the grid points of an arena's seabed."""
APRON = 20.0
"""Metres of seabed beyond the bounds: as far as the camera's depth is valid."""

OCTAVES = ((9.0, 0.24), (4.0, 0.09), (1.8, 0.03), (0.8, 0.01))
"""Knot distance and amplitude, metres. Features repeat after about two knots."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Smooth random numbers over the ground: a uniform cubic B-spline through random knots.

    Values lie in about ±1 with a standard deviation near 0.5; first and second derivatives are
    continuous, so neither slopes nor shading show the knots.
    """

    knots: Float64Array
    """(rows, cols)."""
    x0: float
    y0: float
    """World position of the first knot."""
    pitch: float
    """Metres between knots."""

    @staticmethod
    def over(bounds: Bounds, pitch: float, rng: np.random.Generator) -> Noise:
        """Noise over that box."""
        rows, cols = (math.ceil(side / pitch) + 4 for side in (bounds.depth, bounds.width))
        knots = uniforms(rng, -1.0, 1.0, (rows, cols))
        return Noise(knots, bounds.x_min - 1.5 * pitch, bounds.y_min - 1.5 * pitch, pitch)

    def on_grid(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """(N, M) the noise at every pair of M values of x and N of y, to the last bit what `at` gives."""
        rows, row_weights = self._taps(y - self.y0, self.knots.shape[0])
        cols, col_weights = self._taps(x - self.x0, self.knots.shape[1])
        # Along x first, on each line of knots, which are few.
        lines = np.zeros((self.knots.shape[0], len(x)))
        for j in range(4):
            lines += col_weights[j] * self.knots[:, cols + j]
        total = np.zeros((len(y), len(x)))
        for i in range(4):
            total += row_weights[i][:, None] * lines[rows + i]
        return 1.8 * total

    def at(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """The noise at points of equal shape, or of shapes that broadcast."""
        if x.ndim == y.ndim == 2 and x.shape[0] == y.shape[1] == 1:
            return self.on_grid(x[0], y[:, 0])
        rows, row_weights = self._taps(y - self.y0, self.knots.shape[0])
        cols, col_weights = self._taps(x - self.x0, self.knots.shape[1])
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
        for i in range(4):
            line = np.zeros_like(total)
            for j in range(4):
                line += col_weights[j] * self.knots[rows + i, cols + j]
            total += row_weights[i] * line
        return 1.8 * total

    def _taps(
        self, values: Float64Array, count: int
    ) -> tuple[npt.NDArray[np.intp], tuple[Float64Array, ...]]:
        """The first of four knots of each place, given as metres from the first of all, and their weights."""
        position = values / self.pitch - 1.0
        first = np.clip(np.floor(position), 0, count - 4).astype(np.intp)
        t = np.clip(position - first, 0.0, 1.0)
        s = 1.0 - t
        return first, (
            s * s * s / 6.0,
            (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
            (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
            t * t * t / 6.0,
        )


def smoothstep(low: float, high: float, values: Float64Array) -> Float64Array:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def grid(bounds: Bounds, spacing: float) -> tuple[Float64Array, Float64Array]:
    """x (1, M) and y (N, 1) of the multiples of the spacing in that box, which has its sides on such."""
    x, y = (
        np.arange(round(low / spacing), round(high / spacing) + 1).astype(np.float64) * spacing
        for low, high in ((bounds.x_min, bounds.x_max), (bounds.y_min, bounds.y_max))
    )
    return x[None, :], y[:, None]


def undulation(bounds: Bounds, rng: np.random.Generator) -> Float64Array:
    """(N, M) metres about 0 on the arena's grid: gentle swells of ±0.35 m, and ripples where sand is loose.

    Swells are 10 to 20 m long and slopes stay below about 0.2. Ripples are 1 to 2 cm high.
    """
    x, y = grid(bounds, SPACING)
    lines = x[0], y[:, 0]
    heights = np.zeros((y.size, x.size))
    for pitch, amplitude in OCTAVES:
        heights += amplitude * Noise.over(bounds, pitch, rng).on_grid(*lines)
    across = direction(uniform(rng, 0.0, math.pi))
    wavelength = uniform(rng, 1.2, 1.7)
    height = uniform(rng, 0.005, 0.012)
    wander, loose = Noise.over(bounds, 5.0, rng), Noise.over(bounds, 7.0, rng)
    phase = (across[0] * x + across[1] * y) / wavelength + 0.6 * wander.on_grid(*lines)
    return heights + height * smoothstep(-0.2, 0.5, loose.on_grid(*lines)) * _wave(phase)


def terrain(heights: Float64Array, bounds: Bounds, spacing: float = SPACING) -> Terrain:
    """World heights on the `grid` of that box, rounded to whole millimetres."""
    return Terrain(quantised(heights, MILLIMETRE).astype(np.float32), bounds.x_min, bounds.y_min, spacing)


def _wave(phase: Float64Array) -> Float64Array:
    """A sine made of parabolas: period 1, from −1 to 1."""
    t = 2.0 * (phase - np.floor(phase)) - 1.0
    return 4.0 * t * (1.0 - np.abs(t))
