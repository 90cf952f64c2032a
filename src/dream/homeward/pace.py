"""What moves take of what a mission spends, learnt as they are made."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dream.geometry import wrap_angle
from dream.types import Decision

SPEED = 0.5
"""m/s over ground that moves are reckoned with before any was made."""
TURN_RATE = 0.5
"""rad/s likewise."""
PRIOR = 4.0
"""Moves that count for what is believed before any was made."""
DEVIATIONS = 3.0
"""Of all moves of a way together, that it may take beyond its mean."""


def nominal_seconds(move: Decision) -> float:
    """Seconds that a move should take: on its way, and turning."""
    return math.hypot(move.advance, move.climb) / SPEED + abs(wrap_angle(move.turn)) / TURN_RATE


@dataclass(slots=True, eq=False)
class Pace:
    """What moves take of one thing: so much for each nominal second, and so much for each move beside.

    What it does: linear regression by least squares of what moves took on their nominal seconds, with a prior
    of a few moves; the residuals say how far a way of some moves may take more than its mean.
    Assumes: moves err independently.
    Reference: Bayesian linear regression with a conjugate prior (Gelman et al., *Bayesian
    Data Analysis*, 14).
    """

    rate: float = 1.0
    """Believed for each nominal second before any move was made."""
    _moments: npt.NDArray[np.float64] = field(init=False)
    _sums: npt.NDArray[np.float64] = field(init=False)
    _squares: float = field(init=False, default=0.0)
    _count: float = field(init=False, default=PRIOR)

    def __post_init__(self) -> None:
        # As if moves of 4 s and none had been seen.
        self._moments = PRIOR * np.array([[8.0, 2.0], [2.0, 1.0]])
        self._sums = self._moments @ np.array([self.rate, 0.0])

    def learn(self, nominal: float, taken: float) -> None:
        """Of a move of so many nominal seconds, that took so much."""
        error = taken - self.mean(nominal, 1)
        features = np.array([nominal, 1.0])
        self._moments += np.outer(features, features)
        self._sums += taken * features
        self._squares += error * error
        self._count += 1.0

    def mean(self, nominal: float, moves: int) -> float:
        """What a way of some moves takes that has so many nominal seconds together, as expected."""
        rate, beside = np.linalg.solve(self._moments, self._sums)
        return max(float(rate * nominal + beside * moves), 0.0)

    def margin(self, moves: int) -> float:
        """That it will hardly take beyond."""
        return DEVIATIONS * math.sqrt(self._squares / self._count * moves)
