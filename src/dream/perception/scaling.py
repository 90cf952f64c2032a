"""Metres for a network's depth, from the flat floor that altitude and attitude predict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.geometry import FloatArray
from dream.perception.depth import FEWEST, NEAR_ENOUGH
from dream.types import BoolArray, Float32Array

TRIES = 100
"""With half of the pixels right, one pair in four is; among so many some surely are."""
MOST_ROWS = 2000
"""Pixels that the tries are judged by."""
ROUNDS = 8
TUKEY = 4.685
"""Standard deviations beyond which a pixel has no weight: 95 % efficient where errors are normal."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How a raw output becomes metres: z = scale · raw, or 1 / z = scale · raw + shift."""

    scale: float
    shift: float
    inverse: bool
    error: float
    """Median over the floor of |z / z_floor − 1|."""
    agreement: float
    """Share of the floor's pixels that lie within a tenth of its depth, all of those that were given."""

    def depth(self, raw: FloatArray) -> Float32Array:
        """Metres; NaN where the raw output stands for no positive depth."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            z = 1.0 / (self.scale * raw + self.shift) if self.inverse else self.scale * raw
            return np.where(np.isfinite(z) & (z > 0.0), z, np.nan).astype(np.float32)


def fit_to_floor(raw: FloatArray, floor: FloatArray, on_floor: BoolArray, *, inverse: bool) -> Fit | None:
    """The scale, and the shift of an inverse depth, with which the raw output fits the floor best.

    Least squares of the relative error of z, or of 1/z, reweighted by Tukey's biweight: what stands on the
    floor or was labelled wrongly loses its say.

    Args:
        raw: (H, W) the network's output.
        floor: (H, W) metres to the flat floor; NaN where there is none.
        on_floor: (H, W) pixels that show the floor.
        inverse: Whether the output is a reciprocal.

    Returns:
        None where too little floor is seen, or the output does not follow it: a scale that is not positive.
    """
    chosen = on_floor & np.isfinite(floor) & (floor > 0.0) & np.isfinite(raw)
    x, z = raw[chosen].astype(np.float64), floor[chosen].astype(np.float64)
    if len(x) < FEWEST:
        return None
    columns = np.column_stack([x * z, z]) if inverse else (x / z)[:, None]
    answer = _robust(columns)
    if answer is None or answer[0] <= 0.0:
        return None
    fit = Fit(float(answer[0]), float(answer[1]) if inverse else 0.0, inverse, 0.0, 0.0)
    return judged(fit, raw, floor, chosen)


def judged(fit: Fit, raw: FloatArray, floor: FloatArray, on_floor: BoolArray) -> Fit:
    """A fit with its error over the floor. A pixel without a depth agrees with nothing."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(fit.depth(raw[on_floor]) / floor[on_floor] - 1.0)
    error = np.where(np.isnan(error), np.inf, error)
    if len(error) == 0:
        return Fit(fit.scale, fit.shift, fit.inverse, np.inf, 0.0)
    return Fit(
        fit.scale, fit.shift, fit.inverse, float(np.median(error)), float((error <= NEAR_ENOUGH).mean())
    )


def _robust(columns: FloatArray) -> FloatArray | None:
    """The answer a for which columns @ a is 1 as nearly as most rows allow; None where nothing fixes it."""
    size = np.abs(columns).max(axis=0)
    if not (size > 0.0).all():
        return None
    scaled = columns / size
    answer = _least_median(scaled[:: 1 + len(scaled) // MOST_ROWS])
    for _ in range(ROUNDS):
        if answer is None:
            return None
        error = np.abs(scaled @ answer - 1.0)
        spread = max(1.4826 * float(np.median(error)), 1e-6)
        weight = np.clip(1.0 - (error / (TUKEY * spread)) ** 2, 0.0, None) ** 2
        normal = (scaled * weight[:, None]).T @ scaled
        answer = None if np.linalg.cond(normal) > 1e10 else np.linalg.solve(normal, scaled.T @ weight)
    found: FloatArray = answer / size
    return found


def _least_median(rows: FloatArray) -> FloatArray | None:
    """Of the answers to a few rows each, that with the least median error over all (Rousseeuw, 1984).

    The least squares of all rows would be a worse start: a third of wrong ones on one side drag them along.
    """
    rng, unknowns = np.random.default_rng(0), rows.shape[1]
    few = (rows[chosen] for chosen in rng.integers(len(rows), size=(TRIES, unknowns)))
    answers = [np.linalg.solve(some, np.ones(unknowns)) for some in few if np.linalg.cond(some) < 1e6]
    if not answers:
        return None
    medians = np.median(np.abs(rows @ np.array(answers).T - 1.0), axis=0)
    best: FloatArray = answers[int(medians.argmin())]
    return best
