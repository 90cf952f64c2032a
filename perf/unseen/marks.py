"""What answers are worth: sums over the pixels of each scene, and figures with intervals over scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from dream.evaluation.statistics import LEVEL, Interval, resampling_weights
from dream.geometry import FloatArray
from dream.types import BoolArray, Float32Array, Label, UInt8Array

BINS = 10
LEAST_SHARE = 0.01
"""Of the pixels: a bin with fewer has no gap to speak of."""
CLOSE = 6.0
"""Metres along the optical axis within which targets are marked apart."""
DEEPEST = 8.0
"""Metres along the optical axis within which depth is marked."""
KNOWN_TO = 1.1
"""The confidence in a depth is the probability that it is right to within this factor."""
KINDS = len(Label)


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What is said of a picture, (H, W) each."""

    labels: UInt8Array
    sure: Float32Array
    """Confidence in them."""
    depth: Float32Array
    """Metres along the optical axis; NaN where nothing is said."""
    near: Float32Array
    """Confidence in it."""


@dataclass(slots=True, eq=False)
class Tally:
    """Sums over pixels."""

    confusion: FloatArray = field(default_factory=lambda: np.zeros((KINDS, KINDS)))
    """Truth by said."""
    close: FloatArray = field(default_factory=lambda: np.zeros((KINDS, KINDS)))
    """The same of what is within `CLOSE`."""
    depth: FloatArray = field(default_factory=lambda: np.zeros(4))
    """Pixels with a true depth, those told one, sum of their relative errors, right ones to a factor 1.25."""
    sure: FloatArray = field(default_factory=lambda: np.zeros((BINS, 3)))
    """Pixels, sum of the confidence in the label, right ones; by bin of confidence."""
    near: FloatArray = field(default_factory=lambda: np.zeros((BINS, 3)))
    """Likewise of depth; right is to within `KNOWN_TO`."""

    def add(self, other: Tally) -> None:
        """Take in another."""
        for name in ("confusion", "close", "depth", "sure", "near"):
            mine: FloatArray = getattr(self, name)
            mine += getattr(other, name)

    def add_labels(self, truth: UInt8Array, told: Told, marked: BoolArray, close: BoolArray) -> None:
        """Those of one picture: all (H, W); `marked` are the pixels that count."""
        self.confusion += confused(truth[marked], told.labels[marked])
        self.close += confused(truth[marked & close], told.labels[marked & close])
        _bin(self.sure, told.sure[marked], told.labels[marked] == truth[marked])

    def add_depth(self, truth: Float32Array, told: Told, marked: BoolArray) -> None:
        """That of one picture: metres (H, W); `marked` are the pixels that count, with a true depth."""
        true, said = truth[marked].astype(np.float64), told.depth[marked].astype(np.float64)
        known = np.isfinite(said) & (said > 0.0)
        true, said = true[known], said[known]
        factor = np.maximum(said / true, true / said)
        errors = np.abs(said - true) / true
        self.depth += (len(known), len(true), errors.sum(), (factor < 1.25).sum())
        _bin(self.near, told.near[marked][known], factor <= KNOWN_TO)

    @property
    def flat(self) -> FloatArray:
        """All sums in a row."""
        parts = (self.confusion, self.close, self.depth, self.sure, self.near)
        return np.concatenate([part.ravel() for part in parts])


def confused(truth: UInt8Array, said: UInt8Array, kinds: int = KINDS) -> FloatArray:
    """(kinds, kinds) pixels, truth by said."""
    pairs = np.bincount(kinds * truth.astype(np.intp) + said, minlength=kinds * kinds)
    return pairs.reshape(kinds, kinds).astype(np.float64)


def _bin(sums: FloatArray, confidence: Float32Array, right: BoolArray) -> None:
    bins = np.clip((confidence * BINS).astype(np.intp), 0, BINS - 1)
    columns: tuple[FloatArray, ...] = (np.ones(len(bins)), confidence, right.astype(np.float64))
    for column, value in enumerate(columns):
        sums[:, column] += np.bincount(bins, value, BINS)


def overlap(confusion: FloatArray, kind: int) -> FloatArray:
    """Intersection over union of one kind, from (..., n, n) truth by said; NaN where it is not there."""
    both, there = confusion[..., kind, kind], confusion[..., kind, :].sum(axis=-1)
    either = there + confusion[..., :, kind].sum(axis=-1) - both
    return np.asarray(both / np.where(there > 0.0, either, np.nan), np.float64)


def mean_overlap(confusion: FloatArray) -> FloatArray:
    """Over the kinds that there are."""
    each = np.stack([overlap(confusion, kind) for kind in range(confusion.shape[-1])])
    there = np.moveaxis(confusion.sum(axis=-1) > 0.0, -1, 0)
    return np.asarray(np.where(there, each, 0.0).sum(axis=0) / there.sum(axis=0))


def gaps(bins: FloatArray) -> FloatArray:
    """(..., BINS): share that is right less mean confidence, from (..., BINS, 3); 0 in an empty bin."""
    pixels = np.maximum(bins[..., 0], 1e-9)
    return np.asarray((bins[..., 2] - bins[..., 1]) / pixels, np.float64)


def expected_gap(bins: FloatArray) -> FloatArray:
    """Mean over pixels of the size of their bin's gap: the expected calibration error."""
    pixels = bins[..., 0]
    return np.asarray((np.abs(gaps(bins)) * pixels).sum(axis=-1) / np.maximum(pixels.sum(axis=-1), 1e-9))


def greatest_gap(bins: FloatArray) -> FloatArray:
    """That of the bins with at least `LEAST_SHARE` of the pixels."""
    share = bins[..., 0] / np.maximum(bins[..., 0].sum(axis=-1, keepdims=True), 1e-9)
    return np.asarray(np.where(share >= LEAST_SHARE, np.abs(gaps(bins)), 0.0).max(axis=-1))


def _parts(flat: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The sums of `Tally.flat` (..., n) in their shapes."""
    square, first = KINDS * KINDS, flat.shape[:-1]
    cuts = np.cumsum([square, square, 4, 3 * BINS])
    a, b, depth, sure, near = np.split(flat, cuts, axis=-1)
    shape = (*first, KINDS, KINDS)
    bins = (*first, BINS, 3)
    return a.reshape(shape), b.reshape(shape), depth, sure.reshape(bins), near.reshape(bins)


Figure = Callable[[FloatArray], FloatArray]


def _overlap_of(label: Label) -> Figure:
    return lambda flat: overlap(_parts(flat)[0], int(label))


FIGURES: dict[str, Figure] = {
    **{f"{label.name.lower()} IoU": _overlap_of(label) for label in Label},
    "mean IoU": lambda flat: mean_overlap(_parts(flat)[0]),
    f"target IoU within {CLOSE:g} m": lambda flat: overlap(_parts(flat)[1], int(Label.TARGET)),
    f"depth within {DEEPEST:g} m: AbsRel": lambda flat: _parts(flat)[2][..., 2] / _parts(flat)[2][..., 1],
    f"depth within {DEEPEST:g} m: delta1": lambda flat: _parts(flat)[2][..., 3] / _parts(flat)[2][..., 0],
    "depth: not told": lambda flat: 1.0 - _parts(flat)[2][..., 1] / _parts(flat)[2][..., 0],
    "label confidence: expected error": lambda flat: expected_gap(_parts(flat)[3]),
    "label confidence: greatest gap": lambda flat: greatest_gap(_parts(flat)[3]),
    "depth confidence: expected error": lambda flat: expected_gap(_parts(flat)[4]),
    "depth confidence: greatest gap": lambda flat: greatest_gap(_parts(flat)[4]),
}
"""From sums (..., n), see `Tally.flat`. A depth that is not told is wrong for delta1, and has no AbsRel."""


def interval(
    sums: FloatArray, figure: Figure, *, most: float = 1.0, draws: int = 2000, seed: int = 0
) -> Interval:
    """A figure of sums (n, k), one row a scene, with its 95 % bootstrap interval over scenes.

    As `dream.evaluation.statistics.interval` has it: the estimate ± Student's t times the bootstrap's error,
    cut at 0 and at the most that the figure can be.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(figure(sums.sum(axis=0)))
        if len(sums) < 3 or not math.isfinite(value):
            return Interval(value, math.nan, math.nan, len(sums))
        weights = resampling_weights(["all"] * len(sums), np.random.default_rng(seed), draws)
        error = float(np.nanstd(figure(weights @ sums), ddof=1))
    margin = float(stats.t.ppf(0.5 + 0.5 * LEVEL, len(sums) - 1)) * error
    return Interval(value, max(value - margin, 0.0), min(value + margin, most), len(sums))


def figures(tallies: Sequence[Tally]) -> dict[str, Interval]:
    """All figures of the scenes' tallies."""
    sums = np.stack([tally.flat for tally in tallies])
    return {
        name: interval(sums, figure, most=math.inf if "AbsRel" in name else 1.0)
        for name, figure in FIGURES.items()
    }
