"""Commands → forces → the wrench on the vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.vehicle import _kernels

Float64Array = npt.NDArray[np.float64]

T200 = (
    (-1.0, -39.9),
    (-0.75, -26.6),
    (-0.5, -14.1),
    (-0.25, -4.71),
    (-0.15, -1.77),
    (-0.1, -0.69),
    (-0.07, 0.0),
    (0.07, 0.0),
    (0.1, 0.78),
    (0.15, 2.16),
    (0.25, 5.88),
    (0.5, 17.8),
    (0.75, 33.5),
    (1.0, 51.5),
)
"""Command and force in newtons of a Blue Robotics T200 at 16 V, tied to the spot (the maker's public table of
September 2019; a command is (PWM − 1500 µs) / 400 µs)."""
TABLE_VOLTAGE = 16.0
"""Volts that the table holds for."""
VOLTAGE_POWER = 1.15
"""Force grows with this power of the voltage. A propeller on a motor without losses would have 2. Fitted to
the same table, which also has 12 and 14 V: from half throttle on they are met within 3 %, at a quarter within
11 %, since the dead band widens to ±0.09 at 12 V and here does not. Above 17 V, which a battery of four cells
does not have, part throttle gives less than this."""


@dataclass(frozen=True, slots=True)
class Thrusters:
    """Where thrusters sit and what they give.

    What it does: a command in [−1, 1] sets the force that a thruster tends to, with a dead band about zero;
    the force itself follows as a first-order lag.
    Assumes: forces as at the spot, whatever the speed, and no wash from one to another.
    """

    positions: tuple[tuple[float, float, float], ...]
    """Metres in `base`, from the centre of gravity."""
    directions: tuple[tuple[float, float, float], ...]
    """Of the force for a command above 0, in `base`; of length 1."""
    curve: tuple[tuple[float, float], ...] = T200
    """(command, newtons) at 16 V, both rising. Between the points the root of the force, which goes with the
    propeller's speed, is linear in the command."""
    voltage: float = TABLE_VOLTAGE
    """Volts at the thrusters, 12 to 17: a battery of four cells, full or under load."""
    lag: float = 0.08
    """Seconds. The slowest pole of von Benzon et al. (JMSE 10(12):1898, 2022) is at 13.2 rad/s."""

    def __post_init__(self) -> None:
        if len(self.positions) != len(self.directions) or not self.positions:
            raise ValueError(
                f"thrusters: expected as many directions as positions, at least one, "
                f"got {len(self.directions)} and {len(self.positions)}"
            )
        lengths = np.linalg.norm(np.asarray(self.directions, np.float64), axis=1)
        if not np.allclose(lengths, 1.0, atol=1e-9):
            raise ValueError(f"thrusters.directions: expected length 1, got {lengths.tolist()}")
        command, force = np.asarray(self.curve, np.float64).T
        if (np.diff(command) <= 0.0).any() or (np.diff(force) < 0.0).any():
            raise ValueError(f"thrusters.curve: expected rising commands and forces, got {self.curve}")
        for name in ("voltage", "lag"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"thrusters.{name}: expected a number above 0, got {getattr(self, name)}")

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.positions)

    @property
    def allocation(self) -> Float64Array:
        """(6, n) force and moment in `base`, about the centre of gravity, for one newton of each."""
        direction = np.asarray(self.directions, np.float64)
        moments = np.cross(np.asarray(self.positions, np.float64), direction)
        return np.ascontiguousarray(np.concatenate([direction, moments], axis=1).T)

    @property
    def points(self) -> tuple[Float64Array, Float64Array]:
        """Commands and roots of the force, with its sign, at the points of the curve at this voltage."""
        command, force = np.array(self.curve, np.float64).T
        scale = (self.voltage / TABLE_VOLTAGE) ** VOLTAGE_POWER
        return command.copy(), np.sign(force) * np.sqrt(scale * np.abs(force))

    def forces(self, commands: npt.ArrayLike) -> Float64Array:
        """(...) newtons that thrusters tend to at commands (...); beyond ±1 as at ±1."""
        values = _finite(commands, "commands")
        points, roots = self.points
        return np.array([_kernels.thrust(points, roots, u) for u in values.ravel()]).reshape(values.shape)

    def commands(self, forces: npt.ArrayLike) -> Float64Array:
        """(...) commands for forces (...) in newtons: the inverse of `forces`; at most ±1, 0 for no force."""
        values = _finite(forces, "forces")
        points, roots = self.points
        return np.array([_kernels.command(points, roots, f) for f in values.ravel()]).reshape(values.shape)


def _finite(values: npt.ArrayLike, name: str) -> Float64Array:
    array = np.asarray(values, np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    return array


def _inward(angle: float) -> tuple[float, float, float]:
    return math.cos(angle), math.sin(angle), 0.0


_UP = (0.0, 0.0, 1.0)
_QUARTER = math.pi / 4
_HORIZONTAL = tuple(_inward(angle) for angle in (_QUARTER, -_QUARTER, 3 * _QUARTER, -3 * _QUARTER))
"""Front right, front left, rear right, rear left: the front pair pushes ahead and inwards, the rear pair
astern and inwards."""

VECTORED = Thrusters(
    positions=(
        (0.14, -0.0955, 0.0),
        (0.14, 0.0955, 0.0),
        (-0.15, -0.0975, 0.0),
        (-0.15, 0.0975, 0.0),
        (0.0, -0.1105, 0.077),
        (0.0, 0.1105, 0.077),
    ),
    directions=(*_HORIZONTAL, _UP, _UP),
)
"""The BlueROV2's six, numbered as ArduSub does in its frame VECTORED: four horizontal ones, then right and
left vertical. Positions along x are those of the model clydemcqueen/bluerov2_ignition; those along y give the
yaw and roll arms of the allocation matrix of HKPolyU-UAV/bluerov2. That matrix also puts the horizontal ones
73 mm below the centre of gravity; they are at its height here, because the hulls have their drag there, too,
and a frame that cannot pitch would else turn over at an eighth of its thrust."""

VECTORED_6DOF = Thrusters(
    positions=(
        (0.156, -0.111, -0.085),
        (0.156, 0.111, -0.085),
        (-0.156, -0.111, -0.085),
        (-0.156, 0.111, -0.085),
        (0.12, -0.218, 0.0),
        (0.12, 0.218, 0.0),
        (-0.12, -0.218, 0.0),
        (-0.12, 0.218, 0.0),
    ),
    directions=(*_HORIZONTAL, _UP, _UP, _UP, _UP),
)
"""The Heavy's eight, numbered as ArduSub does in its frame VECTORED_6DOF: four horizontal ones, then front
right, front left, rear right and rear left vertical. Positions are those of von Benzon et al. (2022)."""
