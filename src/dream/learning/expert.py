"""A teacher that steers by one frame: over the target in view, and clear of what is near."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from dream.geometry import Camera, camera_mount
from dream.planning.baselines.uivnav import TURNS_DEG
from dream.protocol import SurveyProtocol
from dream.types import Float32Array, Label, UInt8Array

Float64Array = npt.NDArray[np.float64]

TURNS = tuple(math.radians(degrees) for degrees in TURNS_DEG)
"""Radians, positive to the left: what the expert and the network choose from."""
AHEAD = 3
"""Index of the turn of 0."""
EVERY = 3
"""Rows and columns of the frame of which one is looked at."""
EDGE = math.radians(33.0)
"""To the side of ahead: what lies further out, the side of the image may cut off."""
LEAST = 0.002
"""Altitudes² of ground: a target that covers less does not pull."""
SPECK = 3
"""Pixels that are looked at: as few as that block nothing."""


@dataclass(frozen=True, slots=True)
class Expert:
    """What a person at the joystick would do who sees one frame and remembers nothing.

    What it does: every part of the target in view pulls into its direction, by the ground that it covers;
    what lies beyond the reach pulls more, since what is nearer counts as seen already, and what the side of
    the image cuts off pulls beyond that side. A direction that is blocked nearby is refused. Of the rest the
    pulls make probabilities: the most of them for the best, some for what is nearly as good, so that one who
    draws from them does not go round in circles. Where nothing pulls it goes straight on, mostly.

    Reference: UIVNav (arXiv 2309.08806) learns from people; its labels are not public, and these are ours.

    Assumes: a level vehicle at the protocol's altitude, depth and labels of one frame.
    Fails when: the target is out of view. It searches by chance.
    """

    near: float = 0.05
    """Pull of the target within the reach, where 1 is that of the target beyond."""
    far: float = 8.0
    """Metres beyond the reach within which the pull falls to 1/e."""
    side: float = 0.5
    """Pull of the target that the side of the image cuts off, within the reach."""
    straight: float = 0.3
    """Cost of each 60 degrees of turn, where the greatest pull counts 1."""
    sharpness: float = 6.0
    """Of the choice: the logarithm of the odds between the greatest pull and none."""
    wander: float = 0.5
    """Probability of a turn where nothing pulls and nothing blocks."""
    bend: float = 0.2
    """Of a turn that nothing pulls: by how much less likely each 30 degrees make it, as a logarithm."""
    clearance: float = 3.5
    """Metres from the vehicle within which a direction must be free."""
    room: float = 0.7
    """Metres to each side that must be free on the way there."""

    def weigh(self, depth: Float32Array, labels: UInt8Array, protocol: SurveyProtocol) -> Float64Array:
        """Probability of each turn.

        Args:
            depth: (H, W) float32, metres along the optical axis; NaN where there is no return.
            labels: (H, W) uint8, values of `Label`.
            protocol: Which camera took them, and from which height.

        Returns:
            (7,) float64, of `TURNS`, summing to 1.
        """
        protocol.camera.check(depth, "depth")
        protocol.camera.check(labels, "labels")
        rays = _rays(protocol.camera, protocol.camera_pitch)
        z, kind = np.asarray(depth[rays.pixels], np.float64), labels[rays.pixels]
        returned = (z > 0.0) & (z <= protocol.returns[1])
        z = np.where(returned, z, 0.0)
        pull = self._pull(z * rays.level, returned & (kind == Label.TARGET), z, rays, protocol)
        free = self._free(z, returned, rays, protocol)
        return self._chosen(pull, free)

    def _pull(
        self,
        away: Float64Array,
        target: npt.NDArray[np.bool_],
        z: Float64Array,
        rays: _Rays,
        protocol: SurveyProtocol,
    ) -> Float64Array:
        """(7,) how much target lies in, or goes on into, the direction of each turn; ground in altitudes²."""
        scale = protocol.altitude / 2.0
        ground = (z / protocol.altitude) ** 3 * EVERY**2 / protocol.camera.fx**2
        beyond = away - protocol.reach
        weight = np.where(beyond > 0.0, np.exp(-np.maximum(beyond, 0.0) / (self.far * scale)), self.near)
        worth = np.where(target, ground * weight, 0.0)
        sector = np.clip(np.rint(rays.bearing / math.radians(30.0)), -1, 1).astype(np.intp) + AHEAD
        pull = np.bincount(sector.ravel(), worth.ravel(), minlength=len(TURNS)).astype(np.float64)
        cut = np.where(target & (beyond <= 0.0), ground * self.side, 0.0)
        pull[AHEAD - 2] = cut[rays.bearing < -EDGE].sum()
        pull[AHEAD + 2] = cut[rays.bearing > EDGE].sum()
        return pull

    def _free(
        self, z: Float64Array, returned: npt.NDArray[np.bool_], rays: _Rays, protocol: SurveyProtocol
    ) -> npt.NDArray[np.bool_]:
        """(7,) is nothing solid near in that direction? What is out of view counts as free."""
        scale = protocol.altitude / 2.0
        height = z * rays.up + protocol.altitude
        x, y = z * rays.ahead, z * rays.left
        solid = returned & (height > protocol.band[0]) & (height < protocol.band[1])
        half = self.room * scale
        free = np.ones(len(TURNS), np.bool_)
        xs, ys = x[solid], y[solid]
        for k, turn in enumerate(TURNS):
            c, s = math.cos(turn), math.sin(turn)
            along, across = c * xs + s * ys, np.abs(c * ys - s * xs)
            hit = (along > 0.0) & (along < self.clearance * scale) & (across < half)
            free[k] = np.count_nonzero(hit) <= SPECK
        return free

    def _chosen(self, pull: Float64Array, free: npt.NDArray[np.bool_]) -> Float64Array:
        cost = np.abs(np.arange(len(TURNS)) - AHEAD)  # In turns of 30 degrees.
        allowed = np.where(free, pull, 0.0)
        if allowed.max() > LEAST:
            score = self.sharpness * (allowed / allowed.max() - self.straight * cost / 2.0)
            odds = np.where(free, np.exp(score), 0.0)
        elif free[AHEAD]:
            odds = np.where(free & (cost > 0), self.wander * np.exp(-self.bend * cost), 0.0)
            odds *= self.wander / odds.sum() if odds.any() else 0.0
            odds[AHEAD] = 1.0 - self.wander
        else:
            odds = np.where(free, np.exp(-self.bend * cost), 0.0)
        if not odds.any():  # Shut in on all sides: what was behind was free when it came.
            odds[[0, -1]] = 1.0
        shares: Float64Array = odds / odds.sum()
        return shares


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """The pixels that are looked at, and their directions in `base` for a depth of 1 m."""

    pixels: tuple[slice, slice]
    ahead: Float64Array
    left: Float64Array
    up: Float64Array
    level: Float64Array
    """Ground metres for a metre of depth."""
    bearing: Float64Array
    """Radians, positive to the left."""


@lru_cache(maxsize=8)
def _rays(camera: Camera, pitch: float) -> _Rays:
    # Begun so that the columns looked at are their own mirror image, as 2 × first = width − 1 (modulo 3).
    first = 2 * (camera.width - 1) % EVERY
    pixels = (slice(1, None, EVERY), slice(first, None, EVERY))
    v, u = (line + 0.5 for line in np.mgrid[0 : camera.height, 0 : camera.width][(slice(None), *pixels)])
    optical = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    ahead, left, up = np.moveaxis(optical @ camera_mount(pitch).rotation.T, -1, 0)
    return _Rays(pixels, ahead, left, up, np.hypot(ahead, left), np.arctan2(left, ahead))
