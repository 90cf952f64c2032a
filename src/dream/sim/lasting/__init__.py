"""A camera that errs all mission long: labels wrong at the same places, and three scales that are a bit off.

Looking again from as far away shows the same mistake; see `protocol.LastingErrors` for how much is wrong.

Labels are wrong in blobs of a Boolean model (Chiu, Stoyan, Kendall and Mecke, *Stochastic Geometry and its
Applications*, 2013, section 3.1): balls of random width about the points of a Poisson process. What lies in a
ball of a density λ and a mean volume V is the share 1 − exp(−λ V) of all space, and so of any surface. Each
ball has a share from which on it is there, so that what is wrong at a short distance is wrong at all longer
ones. Space is displaced by smooth waves before it is asked, which makes the blobs' outlines irregular, and
the share no other. Balls follow from a hash of the cell that they lie in: nothing is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2, SE3, Camera
from dream.protocol import LastingErrors
from dream.sim.camera_noise import noise_generator
from dream.sim.render import Frame
from dream.sim.sampling import index, steady, uniform
from dream.sim.world import UInt8Array, World
from dream.types import Label

if TYPE_CHECKING:
    from dream.sim.lasting._kernels import Blobs

MISSION = -2
"""The step of which a mission's lasting errors are drawn: −1 is that of a vehicle's motion."""
RARE = 1e-9
"""Probability of a number of balls in a cell that is not drawn any more."""
SWAY = 0.25
"""Share of the least width by which blobs' outlines are displaced at most."""
WAVE = 2.5
"""Least widths along the waves by which they are, about."""


@dataclass(frozen=True, slots=True)
class MissionErrors:
    """What one mission gets wrong, from its start to its end."""

    depth: float
    """Share of its range by which each depth is too long."""
    height: float
    """Metres by which the vehicle believes to be higher than it is."""
    tilt: float
    """Radians by which it believes the camera to look farther down than it does."""
    key: int
    """Where labels are wrong."""


def mission_errors(world: World, start: SE2, lasting: LastingErrors) -> MissionErrors:
    """Those of a mission; one that is flown again errs alike, and other missions err otherwise.

    Each is drawn whether or not others are switched off, and so does not depend on them.

    Args:
        world: Where.
        start: Where the mission began.
        lasting: How much is wrong at most.
    """
    rng = noise_generator(world, start, MISSION)
    depth, height, tilt = (
        uniform(rng, -most, most) for most in (lasting.depth, lasting.height, lasting.tilt)
    )
    return MissionErrors(depth, height, tilt, index(rng, 2**53))


def with_wrong_labels(
    frame: Frame,
    camera: Camera,
    T_world_camera: SE3,
    lasting: LastingErrors,
    key: int,
    missed_as: UInt8Array,
) -> UInt8Array:
    """(H, W) labels of a view, wrong where they are wrong all mission long.

    In one set of blobs seabed and obstacles are taken for a target; in another, drawn apart, a target is
    taken for what it is not. So the stated share is wrong of either, and a blob that reaches from a target to
    the seabed beside it moves the border rather than inverting both.

    Args:
        frame: The truth; it is not changed.
        camera: It was drawn with.
        T_world_camera: It was drawn from.
        lasting: How much is wrong.
        key: Of the mission; see `MissionErrors`.
        missed_as: (N,) label that each individual of the world is given where it is not recognised.
    """
    from dream.sim.lasting import _kernels

    labels = frame.labels.copy()
    if max((share for _, share in lasting.labels), default=0.0) == 0.0:
        return labels
    distances, shares = np.array(lasting.labels, np.float64).T.copy()
    _kernels.mislabel(
        labels,
        frame.ids,
        frame.depth,
        np.ascontiguousarray(T_world_camera.rotation),
        T_world_camera.translation,
        (camera.fx, camera.fy, camera.cx, camera.cy),
        distances,
        shares,
        _blobs(lasting, key),
        np.uint8(Label.WATER),
        np.uint8(Label.TARGET),
        missed_as,
    )
    return labels


@lru_cache(maxsize=4)
def _blobs(lasting: LastingErrors, key: int) -> Blobs:
    from dream.sim.lasting._kernels import Blobs

    (least, greatest), densest = lasting.blob, max(share for _, share in lasting.labels)
    # Of widths that are spread evenly: the mean of π D³ / 6.
    volume = math.pi / 24.0 * (greatest + least) * (greatest * greatest + least * least)
    mean = -math.log(1.0 - densest) / volume * greatest**3
    counts = [term := math.exp(-mean)]
    while counts[-1] < 1.0 - RARE:
        term *= mean / len(counts)
        counts.append(counts[-1] + term)
    return Blobs(
        key=np.uint64(key),
        side=greatest,
        counts=steady(counts),
        least=least,
        greatest=greatest,
        densest=densest,
        sway=SWAY * least,
        wave=WAVE * least,
    )
