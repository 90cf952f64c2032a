"""What a model is shown: the camera's three pictures, the map and cuts through the volume, as PNG files."""

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
HIDDEN = 1.0
"""Metres by which a return must be nearer than a place to hide it: the seabed is not quite level."""
BEHIND, AHEAD = 5.0, 12.0
"""Metres behind the vehicle and ahead of it that the upright cut shows."""
PER_METRE = 32
"""Its pixels."""
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
    """The map as it is known; with a volume it says what is inspected."""
    from dream.mapping.drawing import FOR_MODELS, FOR_MODELS_IN_SPACE, draw_map

    palette = FOR_MODELS if occupancy.volume is None else FOR_MODELS_IN_SPACE
    return draw_map(occupancy, pose, trail, marks, scale=scale_of(occupancy), palette=palette)


def cuts(occupancy: OccupancyMap, observation: Observation, trail: npt.ArrayLike) -> dict[str, bytes]:
    """What is known of the water at the height of the vehicle, and upright straight ahead of it.

    Args:
        occupancy: With a volume.
        observation: Made where the vehicle is.
        trail: (N, 2) where it was, metres in the world.
    """
    from dream.mapping.space_drawing import FOR_MODELS, Beholder, draw_level, draw_slice

    assert occupancy.volume is not None
    pose, protocol = observation.pose, occupancy.protocol
    ahead = np.array([math.cos(pose.yaw), math.sin(pose.yaw)])
    back, front = (np.array([pose.x, pose.y]) + along * ahead for along in (-BEHIND, AHEAD))
    vehicle = Beholder(
        (pose.x, pose.y, observation.z),
        protocol.body_radius,
        protocol.body_height,
        observation.tilt,
        math.atan(0.5 * protocol.camera.height / protocol.camera.fy),
        protocol.reach,
    )
    level = draw_level(occupancy, pose, observation.z, trail, scale=scale_of(occupancy))
    upright = draw_slice(
        occupancy.volume,
        (float(back[0]), float(back[1])),
        (float(front[0]), float(front[1])),
        vehicle=vehicle,
        scale=PER_METRE,
        colors=FOR_MODELS,
    )
    return {"level": png(level), "slice": png(upright)}


def mark_in_view(picture: Image.Image, observation: Observation, number: int, place: npt.ArrayLike) -> None:
    """Draw a mark's number where its place is in the camera's picture, if it can be seen there.

    Args:
        picture: Of that observation, of any size; changed.
        observation: What the camera saw.
        number: Of the mark.
        place: (3,) metres in the world.
    """
    from dream.mapping.drawing import DISC, draw_disc

    point = observation.T_world_camera.inverse @ np.asarray(place, np.float64)
    if point[2] <= 0.0:
        return
    camera = observation.camera
    u, v = camera.project(point[None])[0][0]
    if not (0.0 <= u < camera.width and 0.0 <= v < camera.height):
        return
    # A nearer return hides it; a comparison with none is false.
    if observation.depth[int(v), int(u)] < point[2] - HIDDEN:
        return
    scale, edge = picture.width / camera.width, DISC + 1
    column = min(max(scale * u, edge), picture.width - edge)
    row = min(max(scale * v, edge), picture.height - edge)
    draw_disc(picture, (float(column), float(row)), number)


def png(picture: Image.Image) -> bytes:
    """As a file."""
    file = io.BytesIO()
    # A model waits for it: a third of the time of the usual level for a picture 4 % larger.
    picture.save(file, "png", compress_level=4)
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
