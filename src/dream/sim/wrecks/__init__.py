"""Five wrecks, each cut into the half-metre patches of its surface that a survey counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.sim.sampling import length
from dream.sim.world import Int32Array, Mesh
from dream.sim.wrecks.barge import barge
from dream.sim.wrecks.patches import centred, individuals
from dream.sim.wrecks.steel import broken, coaster, tug
from dream.sim.wrecks.wooden import wooden

_DESIGNS = (coaster, broken, barge, tug, wooden)


@dataclass(frozen=True, slots=True, eq=False)
class Wreck:
    """A wreck in its own frame: x along the keel, y to port, z up from the bare local seabed.

    The origin is the middle of the ground that it takes, debris included.
    """

    meshes: tuple[Mesh, ...]
    """One for each individual, a patch of about 0.5 m of the surface; neighbours share the vertices between
    them to the millimetre."""
    group: Int32Array
    """(N,) the part of the wreck, from 0, that each belongs to."""
    radius: float
    """Metres from the origin within which all of it lies, debris included."""


def wreck(number: int, rng: np.random.Generator) -> Wreck:
    """The wreck of that number, its sizes and decay drawn from the generator.

    1 an intact coaster, 2 a hull broken in two, 3 a barge on its side, 4 a tug with a list, 5 a wooden
    hull half buried.

    Raises:
        ValueError: No such number.
    """
    if number not in range(1, len(_DESIGNS) + 1):
        raise ValueError(f"wreck: expected a number from 1 to {len(_DESIGNS)}, got {number}")
    meshes, group = individuals(centred(_DESIGNS[number - 1](rng)), rng)
    radius = max(float(length(mesh.vertices[:, :2]).max()) for mesh in meshes)
    return Wreck(meshes, group, radius)
