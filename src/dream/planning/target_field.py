"""A Gaussian field over the ground: the targets to be expected, and what a view would tell."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.types import BoolArray, IntArray, Mission

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]

MOST = 2500
"""Squares of a field at most: the covariance of all pairs is kept."""
SIDE = 4
"""Map cells along a square at least; 1 m under `dream-v1`."""
FEWER = 0.8
"""Share of the squares kept that have to be unknown still: below, the others are left out."""
HALF = 0.5
"""Share of a square's ground that was observed from which on it counts as known."""


@dataclass(slots=True, eq=False)
class TargetField:
    """The share of target in each square of ground, as a Gaussian Markov random field.

    The prior has precision Q = (κ² + G)², G the Laplacian of the grid: a Matérn field of smoothness 1, whose
    inverse is kept for the squares that are not known. What is known is taken to be known exactly. Then, with
    U the unknown squares, S some of them and R the rest, all of this has a closed form:

        covariance of U given what is known   Σ = Q_UU⁻¹
        mean of U                              μ_U = m − Σ Q_UK (y_K − m)
        mutual information of S and R          ½ (log det Σ_SS + log det Q_SS)

    of which the last needs no more than the squares in S. It is 0 of no square, and of all of them, since
    nothing is left then to be told of.

    Reference: Lindgren, Rue and Lindström (JRSS B 2011) for the field; Krause, Singh and Guestrin
    (JMLR 2008) for the mutual information.
    """

    mission: Mission
    distance: float
    """Metres at which squares are correlated by about a tenth."""
    mean: float
    """Share of target that is expected where nothing is known."""
    deviation: float
    """Standard deviation of it, in the mean over the area."""
    shape: tuple[int, int] = field(init=False)
    """Rows and columns of squares."""
    known: BoolArray = field(init=False)
    """(squares,) those that were observed once."""
    share: npt.NDArray[np.float64] = field(init=False)
    """(squares,) of target, of those that are known."""
    _of_cell: IntArray = field(init=False)
    """(map rows, map cols) the square of each cell; the number of squares for cells outside the area."""
    _cells: npt.NDArray[np.float64] = field(init=False)
    """(squares,) map cells of each."""
    _precision: csc_matrix = field(init=False)
    _kept: IntArray = field(init=False)
    """(n,) all squares that are not known, and some that are."""
    _covariance: npt.NDArray[np.float64] = field(init=False)
    """(n, n) of these; 0 of what is known."""

    def __post_init__(self) -> None:
        protocol, bounds, box = self.mission.protocol, self.mission.bounds, self.mission.to_see
        cells = SIDE
        while _count(box.depth, cells * protocol.cell) * _count(box.width, cells * protocol.cell) > MOST:
            cells += 1
        side = cells * protocol.cell
        rows, cols = _count(box.depth, side), _count(box.width, side)
        self.shape = rows, cols
        y = bounds.y_min + (np.arange(round(bounds.depth / protocol.cell)) + 0.5) * protocol.cell
        x = bounds.x_min + (np.arange(round(bounds.width / protocol.cell)) + 0.5) * protocol.cell
        row, col = (
            np.floor((k - low) / side + 1e-9).astype(int) for k, low in ((y, box.y_min), (x, box.x_min))
        )
        inside = ((row >= 0) & (row < rows))[:, None] & ((col >= 0) & (col < cols))
        self._of_cell = np.where(inside, row[:, None] * cols + col, rows * cols)
        self._cells = self.on_squares(np.ones(self._of_cell.shape))
        self.known = np.zeros(rows * cols, np.bool_)
        self.share = np.zeros(rows * cols)
        precision, covariance = prior(self.shape, self.distance / side)
        scale = self.deviation**2 / float(np.diag(covariance).mean())
        self._precision, self._covariance = precision.multiply(1.0 / scale).tocsc(), covariance * scale
        self._kept = np.arange(rows * cols)

    def on_squares(self, cells: FloatArray | BoolArray) -> npt.NDArray[np.float64]:
        """(squares,) the sums of (map rows, map cols)."""
        squares = self.shape[0] * self.shape[1]
        weights = np.asarray(cells, np.float64).ravel()
        return np.asarray(np.bincount(self._of_cell.ravel(), weights, squares + 1)[:squares], np.float64)

    def on_cells(self, squares: FloatArray) -> npt.NDArray[np.float64]:
        """(map rows, map cols) the value of each cell's square (squares,); 0 outside the area."""
        return np.append(squares, 0.0)[self._of_cell]

    # --------------------------------------------------------------------------------------- what is known

    def learn(self, occupancy: OccupancyMap) -> None:
        """Take in what was observed: once known, a square stays so, and its share is that of the map now."""
        # In space ground counts as seen only once it was looked at from two sides; what a look told is known.
        looked_at = occupancy.explored | occupancy.seen
        seen = self.on_squares(looked_at)
        now = seen >= np.maximum(HALF * self._cells, 1.0)
        target = self.on_squares(occupancy.target & looked_at)
        self.share = np.where(now, target / np.maximum(seen, 1.0), self.share)
        self.condition(np.flatnonzero(now & ~self.known))

    def condition(self, squares: IntArray) -> None:
        """Have these squares (n,), none of which is known yet, be known, whatever their share."""
        from scipy.linalg import blas

        if not len(squares):
            return
        at = np.searchsorted(self._kept, squares)
        # Σ − C Σ_SS⁻¹ Cᵀ in place: with all pairs of squares, a copy takes longer than that.
        columns = self._covariance[at]
        halves = np.linalg.solve(np.linalg.cholesky(columns[:, at]), columns)
        blas.dgemm(-1.0, halves.T, halves.T, beta=1.0, c=self._covariance.T, trans_b=True, overwrite_c=True)
        self._covariance[at] = 0.0
        self._covariance[:, at] = 0.0
        self.known[squares] = True
        left = np.flatnonzero(~self.known[self._kept])
        if len(left) < FEWER * len(self._kept):
            self._kept = self._kept[left]
            self._covariance = self._covariance.take(left, 0).take(left, 1)

    # --------------------------------------------------------------------------------- what is to be expected

    @property
    def variances(self) -> npt.NDArray[np.float64]:
        """(squares,) of the share of target; 0 where it is known."""
        variances = np.zeros(len(self.known))
        variances[self._kept] = np.maximum(np.diag(self._covariance), 0.0)
        return variances

    @property
    def expected(self) -> npt.NDArray[np.float64]:
        """(squares,) share of target: the mean of the field, and what is known."""
        off = np.where(self.known, self.share - self.mean, 0.0)
        pull = np.where(self.known, 0.0, self._precision @ off)[self._kept]
        beside = np.flatnonzero(pull)
        expected = np.full(len(self.known), self.mean)
        expected[self._kept] -= pull[beside] @ self._covariance[beside]
        return np.where(self.known, self.share, expected)

    # ---------------------------------------------------------------------------- what a view would tell

    def of_one(self) -> npt.NDArray[np.float64]:
        """(squares,) nats that each alone tells of all others; 0 where it is known.

        The sum over some squares is never less than what they tell together (Hadamard's inequality).
        """
        return np.asarray(0.5 * np.log(np.maximum(self.variances * self._precision.diagonal(), 1.0)))

    def information(self, squares: IntArray) -> float:
        """Nats that some squares (n,) tell of all else that is unknown; what is known tells nothing."""
        some = squares[~self.known[squares]]
        if not len(some):
            return 0.0
        inside = self._precision[some][:, some].toarray()
        at = np.searchsorted(self._kept, some)
        spread = self._covariance[np.ix_(at, at)]
        return max(0.0, 0.5 * float(np.linalg.slogdet(inside)[1] + np.linalg.slogdet(spread)[1]))


def prior(shape: tuple[int, int], distance: float) -> tuple[csc_matrix, npt.NDArray[np.float64]]:
    """(squares, squares) precision (κ² + G)² on a grid, and covariance, but for their scale.

    G is the sum of the Laplacians of its rows and columns, so that cosines (DCT-II) are its eigenvectors.

    Args:
        shape: Rows and columns.
        distance: At which squares are correlated by about a tenth, in squares: κ = √8 over it.
    """
    from scipy.sparse import csc_matrix, diags, identity, kron

    along: list[Any] = []
    vectors, roots = [], []
    for n in shape:
        degree = np.full(n, 2.0)
        degree[[0, -1]] = 1.0 if n > 1 else 0.0
        steps: list[Any] = [degree, -np.ones(n - 1), -np.ones(n - 1)]
        along.append(diags(steps, [0, -1, 1]))
        k, at = np.arange(n), np.arange(n) + 0.5
        waves = np.cos(np.pi / n * np.outer(at, k))
        vectors.append(waves / np.linalg.norm(waves, axis=0))
        roots.append(2.0 - 2.0 * np.cos(np.pi / n * k))
    kappa = 8.0 / distance**2
    (rows, cols), (by_row, by_col) = shape, vectors
    root = kappa * identity(rows * cols) + kron(along[0], identity(cols)) + kron(identity(rows), along[1])
    spectrum = 1.0 / (kappa + roots[0][:, None] + roots[1]) ** 2
    # Rows first, then columns: (rows², cols) times (cols, cols²).
    of_rows = np.einsum("ia,ka,ab->ikb", by_row, by_row, spectrum, optimize=True).reshape(rows * rows, cols)
    of_cols = (by_col[:, None] * by_col).reshape(cols * cols, cols).T
    covariance = (of_rows @ of_cols).reshape(rows, rows, cols, cols).transpose(0, 2, 1, 3)
    return csc_matrix(root @ root), covariance.reshape(rows * cols, rows * cols)


def _count(length: float, side: float) -> int:
    """Squares along a length."""
    return max(1, math.ceil(length / side - 1e-9))
