"""How far the water lets a sensor see: labels end before depth does, and both before open water."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dream.geometry import Camera
from dream.protocol import Space
from dream.sim.render import Frame
from dream.sim.water import Water
from dream.sim.world import Float32Array
from dream.types import Label

UNTOLD = Label.OBSTACLE
"""The label of what returned from beyond the range of labels.

It is something solid of which no more is known. As an obstacle the map takes its depth, and whether it stands
in the way goes by its height; it teaches nothing of the seabed's height, is no hint of a target, and hides
what is behind it. Called seabed, what stands up would lift the ground that the map learns; called water, it
would be no return, and the way to it free of nothing. Its cost: where the range of labels is shorter than the
reach, its cell is told to be no target, until a closer look or two says otherwise.
"""


@dataclass(frozen=True, slots=True)
class VisualRange:
    """Metres straight through the water."""

    labels: float
    depth: float


def visual_range(water: Water, space: Space, max_depth: float) -> VisualRange:
    """How far labels and depths are told in a water.

    Args:
        water: With its attenuation.
        space: How many attenuation lengths they are told for.
        max_depth: Metres; the protocol's, and the farthest of both.
    """
    length = water.attenuation_length
    return VisualRange(
        min(space.label_lengths * length, max_depth), min(space.depth_lengths * length, max_depth)
    )


def through_water(frame: Frame, camera: Camera, water: Water, space: Space, max_depth: float) -> Frame:
    """What of a view is told: beyond the range of depth there is water, beyond that of labels `UNTOLD`.

    Which individual a pixel shows is not told there either.

    Args:
        frame: The truth, or what is taken for it; it is not changed.
        camera: It was drawn with.
        water: In which.
        space: See `visual_range`.
        max_depth: See `visual_range`.
    """
    told = visual_range(water, space, max_depth)
    straight = frame.depth * _straight(camera)
    returned = straight <= told.depth  # False where nothing returns, too.
    named = straight <= told.labels
    return replace(
        frame,
        depth=np.where(returned, frame.depth, np.float32(np.nan)),
        labels=np.where(named, frame.labels, np.where(returned, np.uint8(UNTOLD), np.uint8(Label.WATER))),
        ids=np.where(named, frame.ids, np.int32(-1)),
    )


@lru_cache(maxsize=4)
def _straight(camera: Camera) -> Float32Array:
    """(H, W) metres straight from the camera for each along its axis."""
    a = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    b = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return np.sqrt(1.0 + a[None, :] ** 2 + b[:, None] ** 2).astype(np.float32)
