"""Marked cells → a head, and how good it is by leaving out one picture after the other.

The head is a logistic regression with an L2 penalty, both classes of equal weight. Its penalty, and whether
it sees the backbone's features or colour and texture alone, are those under which pictures that were left out
are told best. The logits of pictures that were left out also set scale and offset of all logits (Platt 1999),
so that a probability means what it says as far as the marked pictures can show that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.special import expit, stdtrit

from dream.teaching.marks import OTHER, TARGET
from dream.teaching.model import Extractor, Head
from dream.types import Float32Array, UInt8Array


@dataclass(frozen=True, slots=True)
class HeadChoice:
    """How a head is learned."""

    penalty: float
    """On squared weights of standardised features, beside the mean loss."""
    plain: bool
    """Whether colour and texture alone are seen."""


CHOICES = tuple(HeadChoice(penalty, plain) for plain in (False, True) for penalty in (0.01, 0.1, 1.0))
USUAL = CHOICES[1]
"""Which is taken while nothing can be measured."""
LEAST_MARKED = 1.0 / 8.0
"""Share of a cell that has to be marked for it to count."""
MOST_CELLS = 400
"""Of a class in a picture; of more, so many are drawn."""
MOST_DIMENSIONS = 128
"""Of more features of a backbone, the regression sees so many principal components over the marked cells."""
FEWEST_PICTURES = 3
"""With marks of the target, for a figure of how good it is."""
FEWEST_CELLS = 4
"""Of each class, for a head."""
MOST_TURNS = 30
"""Of Newton's method, which takes 5 to 10."""
CLOSE = 1e-4
"""Step of the weights at which it ends."""
SCEPTICAL = 0.5
"""Scale of the logits while nothing can be measured."""
SCALES = 0.05, 3.0
"""Between which the scale stays."""
SURE = 0.95

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """One marked picture."""

    name: str
    grid: Float32Array
    """(C, h, w) features of its cells."""
    marks: UInt8Array
    """(H, W) at the size at which it is shown."""
    rows: Float32Array
    """(n, C) of the cells that count."""
    share: Float64Array
    """(n,) of what is marked of a cell, the share that is target."""
    weight: Float64Array
    """(n,) share of a cell that is marked."""

    @classmethod
    def of(cls, name: str, grid: Float32Array, marks: UInt8Array) -> Example:
        """A picture's cells with what its marks say of them."""
        target, other = (_shares(marks == value, grid.shape[1:]) for value in (TARGET, OTHER))
        marked = target + other
        counts = marked >= LEAST_MARKED
        rng = np.random.default_rng(0)
        for kind in (target >= other, target < other):
            (where,) = np.nonzero((counts & kind).ravel())
            left_out = rng.permutation(where)[MOST_CELLS:]
            counts.ravel()[left_out] = False
        rows = np.ascontiguousarray(grid.reshape(len(grid), -1).T[counts.ravel()])
        return cls(name, grid, marks, rows, target[counts] / marked[counts], marked[counts])

    @property
    def has_target(self) -> bool:
        """Whether anything in it is marked as target."""
        return bool((self.marks == TARGET).any())


@dataclass(frozen=True, slots=True)
class Held:
    """How a picture was told by what all others taught."""

    name: str
    iou: float | None
    """Intersection over union of the target, over its marked pixels; None where none is marked as target."""
    wrong: float
    """Share of its marked pixels that were told wrongly."""


@dataclass(frozen=True, slots=True)
class Quality:
    """How good a head is on pictures that it was not taught on, as far as marks tell."""

    held: tuple[Held, ...] = ()
    iou: float | None = None
    """Mean over the pictures with target; None where too few are marked."""
    low: float | None = None
    """End of its 95 % interval, by Student's t over the pictures."""
    high: float | None = None
    why: str = ""
    """Why there is no figure; empty where there is one."""


@dataclass(frozen=True, slots=True, eq=False)
class TaughtHead:
    """What came of some marks."""

    head: Head
    quality: Quality
    choice: HeadChoice
    scale: float
    offset: float
    """Of the logits, from pictures that were left out."""


def _shares(where: npt.NDArray[np.bool_], shape: tuple[int, ...]) -> Float64Array:
    """(h, w) share of each cell in which something is so, from (H, W)."""
    fine = Image.fromarray(where.astype(np.float32))
    return np.asarray(fine.resize((shape[1], shape[0]), Image.Resampling.BOX), np.float64)


def lacking(examples: Sequence[Example]) -> str:
    """What has to be marked before anything can be learned; empty where nothing has."""
    for kind, word in ((True, "target"), (False, "other")):
        if sum(int(((e.share >= 0.5) == kind).sum()) for e in examples) < FEWEST_CELLS:
            return f"mark some {word}"
    return ""


class HeadLesson:
    """The marked pictures, with features on one scale and in few dimensions.

    Means, spreads and principal components are of the marked cells of all pictures; what they are labelled
    as has no part in them.
    """

    def __init__(self, examples: Sequence[Example], channels: int) -> None:
        """Of those pictures, the first so many features of whose cells are the backbone's.

        Raises:
            ValueError: They do not have marks of both kinds.
        """
        if lack := lacking(examples):
            raise ValueError(f"marks: expected target and other, got too few: {lack}")
        self.examples = tuple(examples)
        rows = np.concatenate([e.rows for e in examples]).astype(np.float64)
        self._mean, spread = rows.mean(axis=0), rows.std(axis=0)
        # What hardly varies where marks are may vary anywhere else, and would then count too much.
        self._spread = np.maximum(spread, 1e-3 + 0.1 * float(np.median(spread)))
        scaled = (rows - self._mean) / self._spread
        own, plain = scaled[:, :channels], scaled[:, channels:]
        self._basis = _principal(own) if channels > MOST_DIMENSIONS else np.eye(channels)
        self._rows = np.concatenate([own @ self._basis, plain, np.ones((len(scaled), 1))], axis=1)
        self._share = np.concatenate([e.share for e in examples])
        self._weight = np.concatenate([e.weight for e in examples])
        self._of = np.concatenate([np.full(len(e.rows), n) for n, e in enumerate(examples)])

    @property
    def choices(self) -> tuple[HeadChoice, ...]:
        """Those that differ."""
        return CHOICES if self._basis.shape[1] else tuple(choice for choice in CHOICES if choice.plain)

    def fit(
        self, choice: HeadChoice, without: int | None = None, start: Float64Array | None = None
    ) -> Float64Array:
        """Weights, and last the offset, from all pictures but one.

        Raises:
            ValueError: The others do not have marks of both kinds.
        """
        taken = self._of != (-1 if without is None else without)
        share, weight = balanced(self._share[taken], self._weight[taken])
        first = self._basis.shape[1] if choice.plain else 0
        rows, begin = self._rows[taken, first:], None if start is None else start[first:]
        found = logistic(rows, share, weight, choice.penalty, begin)
        return np.concatenate([np.zeros(first), found])

    def logits(self, weights: Float64Array, picture: int) -> Float64Array:
        """(n,) of a picture's cells."""
        found: Float64Array = self._rows[self._of == picture] @ weights
        return found

    def head(self, weights: Float64Array, scale: float = 1.0, offset: float = 0.0) -> Head:
        """The same as a head for features as they come, its logits scaled and moved."""
        first = self._basis.shape[1]
        outer = np.concatenate([self._basis @ weights[:first], weights[first:-1]]) / self._spread
        bias = float(weights[-1] - outer @ self._mean)
        return Head(scale * outer, scale * bias + offset)

    def learned(self, choice: HeadChoice, scale: float, offset: float) -> Head:
        """A head from all pictures, without measuring it."""
        return self.head(self.fit(choice), scale, offset)

    def measured(self, extractor: Extractor, stop: Callable[[], bool] = lambda: False) -> TaughtHead | None:
        """A head from all pictures, and how good it is.

        Args:
            extractor: Of the cells.
            stop: Asked after each part of the work; where it is time to stop, nothing comes of it.
        """
        # Without a picture, the others have to have both kinds.
        folds = [
            n
            for n, example in enumerate(self.examples)
            if len(example.rows) and not lacking([e for e in self.examples if e is not example])
        ]
        with_target = [n for n in folds if self.examples[n].has_target]
        if len(with_target) < FEWEST_PICTURES:
            marked = sum(e.has_target for e in self.examples)
            why = f"target is marked in {marked} of at least {FEWEST_PICTURES} pictures that a figure needs"
            if marked >= FEWEST_PICTURES:
                why = "without some picture the others have too few marks of one kind"
            head = self.learned(USUAL, SCEPTICAL, 0.0)
            return TaughtHead(head, Quality(why=why), USUAL, SCEPTICAL, 0.0)
        choices = self.choices
        whole = [self.fit(choice) for choice in choices]
        weights: dict[tuple[int, int], Float64Array] = {}
        losses = np.zeros((len(choices), len(folds)))
        for at, choice in enumerate(choices):
            for place, n in enumerate(folds):
                weights[at, n] = self.fit(choice, n, whole[at])
                losses[at, place] = self._loss(self.logits(weights[at, n], n), n)
                if stop():
                    return None
        held = []
        for place, n in enumerate(folds):
            # Nothing of a picture has a part in how it is told: neither in the choice nor in the scale.
            rest = [m for m in folds if m != n]
            at = int(np.delete(losses, place, axis=1).mean(axis=1).argmin())
            scale, offset = self._platt({m: self.logits(weights[at, m], m) for m in rest})
            held.append(_judged(self.examples[n], self.head(weights[at, n], scale, offset), extractor))
            if stop():
                return None
        at = int(losses.mean(axis=1).argmin())
        scale, offset = self._platt({n: self.logits(weights[at, n], n) for n in folds})
        head = self.head(whole[at], scale, offset)
        return TaughtHead(head, quality_of(held), choices[at], scale, offset)

    def _loss(self, logits: Float64Array, picture: int) -> float:
        """Mean log loss of a picture's cells, both kinds of equal weight where it has both."""
        mine = self._of == picture
        share, weight = self._share[mine], self._weight[mine]
        loss = np.logaddexp(0.0, logits) - share * logits
        kinds = [weight * share, weight * (1.0 - share)]
        means = [float(kind @ loss) / float(kind.sum()) for kind in kinds if kind.sum() > 0.0]
        return sum(means) / len(means)

    def _platt(self, logits: dict[int, Float64Array]) -> tuple[float, float]:
        """Scale and offset of logits by picture, under which their probabilities are right."""
        taken = np.concatenate([np.nonzero(self._of == n)[0] for n in logits])
        share, weight = self._share[taken], self._weight[taken]
        if min(float(weight @ share), float(weight @ (1.0 - share))) <= 0.0:
            return SCEPTICAL, 0.0
        rows = np.stack([np.concatenate(list(logits.values())), np.ones(len(taken))], axis=1)
        # No cell is told for certain (Platt): a handful of marks are never all that there is.
        share, weight = balanced(0.02 + 0.96 * share, weight)
        scale, offset = logistic(rows, share, weight, 1e-4)
        return float(np.clip(scale, *SCALES)), float(np.clip(offset, -4.0, 4.0))


def balanced(share: Float64Array, weight: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Shares and weights as if both kinds had been marked as much; the weights add up to 1."""
    target, other = float(weight @ share), float(weight @ (1.0 - share))
    if min(target, other) <= 0.0:
        raise ValueError("marks: expected target and other, got one kind alone")
    of_target = weight * share / (2.0 * target)
    both = of_target + weight * (1.0 - share) / (2.0 * other)
    return of_target / both, both


def logistic(
    rows: Float64Array,
    share: Float64Array,
    weight: Float64Array,
    penalty: float,
    start: Float64Array | None = None,
) -> Float64Array:
    """Weights of a logistic regression, by Newton's method.

    Args:
        rows: (n, d), the last column all ones; its weight is not penalised.
        share: (n,) what is to be told, 0 to 1.
        weight: (n,) of the rows; adds up to 1.
        penalty: On half the sum of squared weights.
        start: (d,) where to begin.
    """
    found = np.zeros(rows.shape[1]) if start is None else start.copy()
    ridge = np.full(len(found), penalty)
    ridge[-1] = 1e-6
    for _ in range(MOST_TURNS):
        told = expit(rows @ found)
        slope = rows.T @ (weight * (told - share)) + ridge * found
        bend = (rows * (weight * np.maximum(told * (1.0 - told), 1e-4))[:, None]).T @ rows
        bend[np.diag_indices_from(bend)] += ridge
        step = np.linalg.solve(bend, slope)
        found -= step
        if np.abs(step).max() < CLOSE:
            break
    return found


def _principal(rows: Float64Array) -> Float64Array:
    """(C, d) the directions in which rows (n, C) vary most.

    Reference: Halko, Martinsson and Tropp, *SIAM Review* 53 (2011), algorithm 4.4 with one power.
    """
    rng = np.random.default_rng(0)
    sketch = rows @ rng.standard_normal((rows.shape[1], MOST_DIMENSIONS + 16))
    basis, _ = np.linalg.qr(rows @ (rows.T @ sketch))
    _, _, directions = np.linalg.svd(basis.T @ rows, full_matrices=False)
    return np.ascontiguousarray(directions[:MOST_DIMENSIONS].T)


def _judged(example: Example, head: Head, extractor: Extractor) -> Held:
    shape = example.marks.shape[0], example.marks.shape[1]
    told = extractor.target(head.logits(example.grid), extractor.frame(shape), shape)
    target, other = example.marks == TARGET, example.marks == OTHER
    hit, missed = int((told & target).sum()), int((~told & target).sum())
    false = int((told & other).sum())
    iou = hit / (hit + missed + false) if target.any() else None
    return Held(example.name, iou, (missed + false) / max(int(target.sum() + other.sum()), 1))


def quality_of(held: Sequence[Held]) -> Quality:
    """The mean over pictures that were left out, with its interval; at least two of them with target."""
    found = np.array([one.iou for one in held if one.iou is not None])
    mean, error = float(found.mean()), float(found.std(ddof=1)) / math.sqrt(len(found))
    half = float(stdtrit(len(found) - 1, 0.5 + SURE / 2.0)) * error
    return Quality(tuple(held), mean, max(mean - half, 0.0), min(mean + half, 1.0))
