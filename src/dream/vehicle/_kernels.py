"""Kernels of the thrust curve: commands, never falling, and the root of the force with its sign, √N."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]

DEAD, WEAK, JAMMED = range(3)
"""See `faults.FaultKind`."""
WEAK_SHARE = 0.3
"""Of its force, that a weak thruster gives."""
JAMMED_COMMAND = 0.5
"""That a jammed thruster runs at."""
SAG_OHM = 0.5
"""Of a battery that sags. Assumption: a contact that corrodes; a sound one of this size has a twentieth."""


class PackedFault(NamedTuple):
    """`faults.ThrusterFault`, ready for the loops."""

    thruster: int
    """Counted from 0."""
    kind: int
    at: float
    """Seconds; infinite where nothing fails."""


NO_FAULT = PackedFault(0, DEAD, math.inf)


@njit(cache=True, nogil=True)
def between(commands: Float64Array, values: Float64Array, u: float) -> float:
    """Linear between the points, and beyond them as at the ends."""
    if u <= commands[0]:
        return float(values[0])
    if u >= commands[-1]:
        return float(values[-1])
    k = 1
    while commands[k] < u:
        k += 1
    part = (u - commands[k - 1]) / (commands[k] - commands[k - 1])
    return float(values[k - 1] + part * (values[k] - values[k - 1]))


@njit(cache=True, nogil=True)
def thrust(commands: Float64Array, roots: Float64Array, u: float) -> float:
    """Force of a thruster at rest in the water: the root of the force is linear between the points."""
    root = between(commands, roots, u)
    return root * abs(root)


@njit(cache=True, nogil=True)
def watts(commands: Float64Array, roots: Float64Array, u: float) -> float:
    """What a thruster draws at rest in the water: the cube root of its power is linear between the points."""
    return between(commands, roots, u) ** 3


@njit(cache=True, nogil=True)
def command(commands: Float64Array, roots: Float64Array, force: float) -> float:
    """The command that gives this force; the nearest end where none does, 0 for no force."""
    if force == 0.0:
        return 0.0
    root = math.copysign(math.sqrt(abs(force)), force)
    return between(roots, commands, root)


@njit(cache=True, nogil=True)
def obeyed(fault: PackedFault, commands: Float64Array, roots: Float64Array, u: float) -> float:
    """The command whose force a thruster with that fault gives when it is commanded u."""
    if fault.kind == DEAD:
        return 0.0
    if fault.kind == JAMMED:
        return JAMMED_COMMAND
    return command(commands, roots, WEAK_SHARE * thrust(commands, roots, u))
