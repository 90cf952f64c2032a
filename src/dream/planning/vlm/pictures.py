"""What a model is shown: the camera's three pictures and the map, as PNG files."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.types import Float32Array, Label, Observation, UInt8Array

if TYPE_CHECKING:
    from PIL import Image

    from dream.mapping import OccupancyMap
    from dream.mapping.drawing import Color, Mark

SIDE = 640
"""Pixels along the camera's pictures."""
MAP_SIDE = 800
"""Pixels along the map, about: not larger, so that no model scales it down."""
FAR = 12.0
"""Metres that are black in the picture of the depth."""
WATER: Color = (60, 110, 190)


def scale_of(occupancy: OccupancyMap) -> int:
    """Pixels of a map cell."""
    return max(1, min(16, round(MAP_SIDE / max(occupancy.shape))))


def camera_pictures(observation: Observation) -> dict[str, bytes]:
    """The camera's picture, its depth and its labels."""
    return {
        "camera": png(camera_picture(observation)),
        "depth": png(_enlarged(_gray(observation.depth))),
        "labels": png(_enlarged(_colored(observation.labels))),
    }


def camera_picture(observation: Observation) -> Image.Image:
    """What the camera sees, in colour."""
    from PIL import Image

    picture = Image.fromarray(observation.rgb)
    return picture.resize(_size(picture), Image.Resampling.BICUBIC)


def map_picture(
    occupancy: OccupancyMap, pose: SE2, trail: npt.ArrayLike, marks: Sequence[Mark] = ()
) -> Image.Image:
    """The map as it is known."""
    from dream.mapping.drawing import draw_map

    return draw_map(occupancy, pose, trail, marks, scale=scale_of(occupancy))


def png(picture: Image.Image) -> bytes:
    """As a file."""
    file = io.BytesIO()
    picture.save(file, "png")
    return file.getvalue()


def _size(picture: Image.Image) -> tuple[int, int]:
    return SIDE, round(SIDE * picture.height / picture.width)


def _enlarged(picture: Image.Image) -> Image.Image:
    """Larger, with every value kept."""
    from PIL import Image

    return picture.resize(_size(picture), Image.Resampling.NEAREST)


def _gray(depth: Float32Array) -> Image.Image:
    """White at the camera, black from `FAR` on and where there is no return."""
    from PIL import Image

    near = np.clip(1.0 - np.nan_to_num(depth, nan=FAR) / FAR, 0.0, 1.0)
    return Image.fromarray(np.rint(255.0 * near).astype(np.uint8))


def _colored(labels: UInt8Array) -> Image.Image:
    """In the colours of the map; water is blue."""
    from PIL import Image

    from dream.mapping.drawing import EXPLORED, SOLID, TARGET

    colors = np.zeros((len(Label), 3), np.uint8)
    for label, color in (
        (Label.WATER, WATER),
        (Label.SEABED, EXPLORED),
        (Label.TARGET, TARGET),
        (Label.OBSTACLE, SOLID),
    ):
        colors[label] = color
    return Image.fromarray(colors[labels])


def bearing(pose: SE2) -> str:
    """Where the vehicle heads, in degrees from east to the left and in words."""
    names = ("east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")
    name = names[round(pose.yaw / (0.25 * math.pi)) % 8]
    return f"{math.degrees(pose.yaw) % 360.0:.0f} degrees ({name})"
