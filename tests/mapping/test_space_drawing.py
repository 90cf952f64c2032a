"""Pictures of a volume: slices and views from the side, in the colours of their legends."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from dream.geometry import SE3, Camera, camera_mount
from dream.mapping.space_drawing import (
    EDGE,
    FREE,
    INSPECTED,
    SOLID,
    TO_INSPECT,
    UNKNOWN,
    draw_oblique,
    draw_slice,
)
from dream.mapping.volume import Volume
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Label

CAMERA = Camera.from_fov(160, 120, math.radians(90.0))


def faced(label: Label, away: float = 4.0) -> Volume:
    """A volume after one look at a wall of that label, square to the camera, so far to the east."""
    volume = Volume(PROTOCOL)
    depth = np.full((CAMERA.height, CAMERA.width), away, np.float32)
    labels = np.full(depth.shape, label, np.uint8)
    T_world_camera = SE3.level(0.0, 0.0, -5.0, 0.0) @ camera_mount(0.0)
    volume.integrate(depth, labels, CAMERA, T_world_camera)
    return volume


def at(picture: Image.Image, along: float, z: float, high: float, scale: int = 24) -> tuple[int, ...]:
    """Colour of the slice so far from its left edge, at a height."""
    pixel = picture.getpixel((round(EDGE + along * scale), round(EDGE + (high - z) * scale)))
    assert isinstance(pixel, tuple)
    return pixel


def colors(picture: Image.Image) -> npt.NDArray[np.uint8]:
    return np.asarray(picture).reshape(-1, 3)


def test_a_slice_shows_free_water_before_a_wall_and_nothing_behind_it() -> None:
    volume = faced(Label.OBSTACLE)
    assert volume.box is not None
    high = min(float(volume.box[1, 2]), 0.0)
    picture = draw_slice(volume, (-2.0, 0.1), (6.0, 0.1))
    assert at(picture, 4.1, -5.1, high) == FREE
    assert at(picture, 6.1, -5.1, high) == SOLID
    assert at(picture, 7.2, -5.1, high) == UNKNOWN
    assert at(picture, 1.1, -5.1, high) == UNKNOWN


def test_a_target_that_was_looked_at_squarely_is_drawn_as_inspected_and_one_beyond_reach_is_not() -> None:
    for away, color, other in ((4.0, INSPECTED, TO_INSPECT), (9.0, TO_INSPECT, INSPECTED)):
        volume = faced(Label.TARGET, away)
        assert volume.box is not None
        picture = draw_slice(volume, (0.0, 0.1), (away + 2.0, 0.1))
        assert at(picture, away + 0.1, -5.1, min(float(volume.box[1, 2]), 0.0)) == color
        # The legend holds a small square of each colour.
        assert (colors(picture) == other).all(axis=1).sum() < 200


def test_seen_from_the_side_a_wall_hides_what_is_behind_it() -> None:
    volume = faced(Label.OBSTACLE)
    near = draw_oblique(volume, bearing=0.0, elevation=0.0)
    assert near.size == (960, 640 + 26)
    gray = np.ptp(colors(near).astype(int), axis=1) < 20
    assert gray.mean() > 0.9
    with_target = faced(Label.TARGET)
    shown = np.asarray(draw_oblique(with_target, bearing=0.0, elevation=0.0))[:640]
    greenish = (shown[..., 1].astype(int) > shown[..., 0] + 40).mean()
    assert greenish > 0.05


def test_the_vehicle_is_drawn_at_the_end_of_its_path() -> None:
    volume = faced(Label.OBSTACLE)
    without = np.asarray(draw_oblique(volume, path=[[0.0, 0.0, -5.0]]))
    moved = np.asarray(draw_oblique(volume, path=[[0.0, 0.0, -5.0], [0.0, 2.0, -5.0]]))
    assert (without != moved).any()


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(ValueError, match="something is known"):
        draw_slice(Volume(PROTOCOL), (0.0, 0.0), (1.0, 0.0))
    with pytest.raises(ValueError, match="something solid"):
        draw_oblique(Volume(PROTOCOL))
    with pytest.raises(ValueError, match="two places"):
        draw_slice(faced(Label.OBSTACLE), (1.0, 0.0), (1.0, 0.0))
