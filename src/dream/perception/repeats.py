"""Networks that answer the same whatever they are shown."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

REPEATS = 3
"""Different pictures in a row after which one and the same answer is none."""


class Repeats:
    """Whether a network answers the same whatever it is shown.

    Numbers that are the same everywhere tell nothing: so may open water be answered to for long. Nor do whole
    ones: those of a view that stays the same may well be the same.
    """

    def __init__(self) -> None:
        """Nothing was shown yet."""
        self._picture: npt.NDArray[Any] | None = None
        self._answer: npt.NDArray[Any] | None = None
        self._count = 0

    def told(self, x: npt.NDArray[Any], answer: npt.NDArray[Any]) -> bool:
        """Take in what went in and came out; has it been the same for `REPEATS` more that were different?"""
        if self._picture is None or not np.array_equal(x, self._picture):
            same = self._answer is not None and np.array_equal(answer, self._answer, equal_nan=True)
            tells = answer.dtype.kind == "f" and answer.size > 0 and answer.min() != answer.max()
            self._count = self._count + 1 if same and tells else 0
            self._picture, self._answer = x, answer
        return self._count >= REPEATS
