"""How few steps no mission in space can do with: a certified lower bound by prices on individuals.

Give every individual a price of 0 or more. A step has one frame, so that k steps after the look-around
inspect individuals worth at most the sum of what the best frames within 1, 2, …, k steps of it are worth,
each counted in full. A mission that leaves at most m individuals inspects all that the look-around has left
but m, which are worth at least their total less the m dearest. So k is at least the number of steps at which
the first sum reaches the second. This holds for all prices, and for every mission without a contact that
keeps to the free space; the best ones are the dual of a linear programme: how few frames, taken in parts,
cover enough (column generation; Dantzig and Wolfe, 1960).

The bound knows the way to the first frames and how much a frame can show, not the ways between them: it is
far from tight, and says how much room there may be below the best tour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.compiling import thread_time
from dream.evaluation.oracle._kernels import space as _kernels
from dream.evaluation.oracle.space_graph import SpaceGraph

Float64Array = npt.NDArray[np.float64]

UNITS = 1000
"""A price of 1 in the whole numbers that certify: sums of those are exact."""
FIRST, MORE = 2000, 400
"""Frames that the programme begins with, and that each round adds."""
CLOSE = 1.01
"""No frame is worth more than this, where 1 is allowed: the prices are as good as the best."""
MOST = 1000
"""Steps of the largest bound."""


class PriceLimit:
    """Lower bounds on one graph."""

    def __init__(self, graph: SpaceGraph, may_miss: int) -> None:
        self._graph, self._may_miss = graph, may_miss
        self._open = ~graph.looked[-1]
        steps = _kernels.steps_from(graph.kernel, graph.start[0], graph.start[1])
        self._steps = np.repeat(steps, graph.kernel.tilts, axis=1)

    def certified(self, prices: Sequence[int]) -> int:
        """Steps after the look-around that the prices (N,) prove to be needed.

        Raises:
            ValueError: There is not one price for each individual, or one is below 0.
        """
        whole = np.asarray(prices, np.int64)
        if whole.shape != self._open.shape:
            raise ValueError(f"prices: expected {len(self._open)}, got {whole.shape}")
        if whole.min(initial=0) < 0:
            raise ValueError(f"prices: expected 0 or more, got {whole.min()}")
        return self._steps_for(whole.astype(np.float64))

    def _steps_for(self, prices: Float64Array) -> int:
        prices = np.where(self._open, prices, 0.0)
        wanted = prices.sum() - np.sort(prices)[len(prices) - min(self._may_miss, len(prices)) :].sum()
        values = _kernels.values(self._graph.kernel, prices)
        within = np.zeros(_kernels.FAR + 1)
        np.maximum.at(within, self._steps.ravel(), values.ravel())
        best = np.maximum.accumulate(within[: _kernels.FAR])
        collected, steps = 0.0, 0
        while collected < wanted and steps < MOST:
            steps += 1
            collected += best[min(steps, len(best) - 1)]
        return steps

    def search(self, budget_s: float) -> tuple[int, ...]:
        """The best prices found in so many seconds of processor time, as whole numbers."""
        until = thread_time() + budget_s
        prices = self._open.astype(np.float64)
        best, most = self._whole(prices), 0
        columns: dict[tuple[int, int], npt.NDArray[np.int32]] = {}
        while True:
            values = _kernels.values(self._graph.kernel, prices)
            greatest = float(values.max(initial=0.0))
            if greatest <= 0.0:
                return best
            whole = self._whole(prices / greatest)
            if (steps := self.certified(whole)) > most:
                best, most = whole, steps
            if (columns and greatest <= CLOSE) or thread_time() > until:
                return best
            at_node, frame = values.max(axis=1), values.argmax(axis=1)
            dearest = np.argsort(-at_node, kind="stable")[: MORE if columns else FIRST]
            tilts = self._graph.kernel.tilts
            for p in dearest[at_node[dearest] > (1.0 if columns else 0.0)].tolist():
                f = int(frame[p])
                columns.setdefault((p, f), self._graph.shows((p, f // tilts, f % tilts)))
            prices = self._duals(list(columns.values()))

    def _whole(self, prices: Float64Array) -> tuple[int, ...]:
        return tuple(np.where(self._open, np.round(UNITS * prices), 0).astype(int).tolist())

    def _duals(self, columns: list[npt.NDArray[np.int32]]) -> Float64Array:
        """(N,) what it is worth to have to inspect each, where only these frames are to be had."""
        from scipy.optimize import linprog
        from scipy.sparse import csr_array, eye_array, hstack, vstack

        rows = np.flatnonzero(self._open)
        count = len(rows)
        first = np.concatenate([[0], np.cumsum([len(column) for column in columns])])
        shown = csr_array(
            (np.ones(first[-1]), np.concatenate(columns), first), shape=(len(columns), len(self._open))
        ).T.tocsr()[rows]
        # Unknowns: parts of frames, individuals left, and those bought at a price that no frame is worth.
        one = eye_array(count)
        spare: Any = csr_array(np.repeat([0.0, 1.0, 0.0], [len(columns), count, count])[None])
        within: Any = vstack([hstack([-shown, -one, -one]), spare])
        found = linprog(
            np.repeat([1.0, 0.0, 0.5], [len(columns), count, count]),
            A_ub=within.tocsc(),
            b_ub=np.concatenate([-np.ones(count), [self._may_miss]]),
            bounds=[(0.0, np.inf)] * len(columns) + [(0.0, 1.0)] * count + [(0.0, np.inf)] * count,
            method="highs",
        )
        prices = np.zeros(len(self._open))
        prices[rows] = np.maximum(-found.ineqlin.marginals[:-1], 0.0)
        return prices
