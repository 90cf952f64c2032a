"""Kernels of the thrust curve: commands, never falling, and the root of the force with its sign, √N."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]


@njit(cache=True, nogil=True)
def thrust(commands: Float64Array, roots: Float64Array, u: float) -> float:
    """Force of a thruster at rest in the water: the root of the force is linear between the points."""
    if u <= commands[0]:
        root = roots[0]
    elif u >= commands[-1]:
        root = roots[-1]
    else:
        k = 1
        while commands[k] < u:
            k += 1
        part = (u - commands[k - 1]) / (commands[k] - commands[k - 1])
        root = roots[k - 1] + part * (roots[k] - roots[k - 1])
    return float(root * abs(root))


@njit(cache=True, nogil=True)
def command(commands: Float64Array, roots: Float64Array, force: float) -> float:
    """The command that gives this force; the nearest end where none does, 0 for no force."""
    if force == 0.0:
        return 0.0
    root = math.copysign(math.sqrt(abs(force)), force)
    if root <= roots[0]:
        return float(commands[0])
    if root >= roots[-1]:
        return float(commands[-1])
    k = 1
    while roots[k] < root:
        k += 1
    part = (root - roots[k - 1]) / (roots[k] - roots[k - 1])
    return float(commands[k - 1] + part * (commands[k] - commands[k - 1]))
