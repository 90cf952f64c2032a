"""What the water lets be told: labels near by, depth farther out, nothing beyond."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import Camera
from dream.protocol import DREAM_V2
from dream.sim.render import Frame
from dream.sim.visual_range import UNTOLD, VisualRange, through_water, visual_range
from dream.sim.water import WATERS, Water
from dream.types import Label

assert DREAM_V2.space is not None
SPACE = DREAM_V2.space
CAMERA = Camera.from_fov(320, 240, math.radians(90.0))
MURKY = Water("murky", (0.5, 0.5, 0.5), (0.3, 0.3, 0.3), (0.1, 0.1, 0.1))
"""Labels as far as 4 m, depth as far as 6 m."""


def facing(depth: float, label: Label = Label.TARGET) -> Frame:
    """A wall of individuals across the whole image."""
    shape = (CAMERA.height, CAMERA.width)
    return Frame(
        np.zeros((*shape, 3), np.uint8),
        np.full(shape, depth, np.float32),
        np.full(shape, label, np.uint8),
        np.zeros(shape, np.int32),
    )


def seen(frame: Frame, water: Water = MURKY) -> Frame:
    return through_water(frame, CAMERA, water, SPACE, DREAM_V2.max_depth)


def away(depth: float) -> npt.NDArray[np.float64]:
    """(H, W) metres straight from the camera, worked out from the pixels' angles."""
    u, v = np.meshgrid(np.arange(320) + 0.5 - 160.0, np.arange(240) + 0.5 - 120.0)
    return np.asarray(depth * np.hypot(np.hypot(u, v), 160.0) / 160.0)


@pytest.mark.parametrize("depth", [2.0, 3.5, 5.0])
def test_both_ranges_are_straight_through_the_water(depth: float) -> None:
    found, metres = seen(facing(depth)), away(depth)
    sure = (np.abs(metres - 4.0) > 1e-4) & (np.abs(metres - 6.0) > 1e-4)
    near, far = metres < 4.0, metres > 6.0
    np.testing.assert_array_equal((found.labels == Label.TARGET)[sure], near[sure])
    np.testing.assert_array_equal((found.labels == UNTOLD)[sure], (~near & ~far)[sure])
    np.testing.assert_array_equal((found.labels == Label.WATER)[sure], far[sure])
    np.testing.assert_array_equal(np.isnan(found.depth)[sure], far[sure])
    np.testing.assert_array_equal((found.ids < 0)[sure], ~near[sure])
    assert set(np.unique(found.depth[~np.isnan(found.depth)])) <= {np.float32(depth)}


def test_what_is_water_stays_water_and_the_truth_stays_whole() -> None:
    frame = facing(3.0)
    frame.depth[:50], frame.labels[:50], frame.ids[:50] = np.nan, Label.WATER, -1
    before = [array.tobytes() for array in (frame.rgb, frame.depth, frame.labels, frame.ids)]
    found = seen(frame)
    assert (found.labels[:50] == Label.WATER).all()
    assert np.isnan(found.depth[:50]).all()
    assert found.rgb is frame.rgb
    found.depth[:], found.labels[:], found.ids[:] = 0.0, 0, 0
    assert before == [array.tobytes() for array in (frame.rgb, frame.depth, frame.labels, frame.ids)]


def test_in_water_that_takes_nothing_the_protocol_ends_both() -> None:
    gin = Water("gin", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert visual_range(gin, SPACE, 20.0) == VisualRange(20.0, 20.0)
    assert np.isnan(seen(facing(19.0), gin).depth[0, 0])


@pytest.mark.parametrize("water", WATERS.values(), ids=lambda water: water.name)
def test_labels_are_told_as_far_as_the_reach_in_every_water(water: Water) -> None:
    told = visual_range(water, SPACE, DREAM_V2.max_depth)
    assert DREAM_V2.reach < told.labels <= told.depth <= DREAM_V2.max_depth
    assert visual_range(water, replace(SPACE, label_lengths=1.0), 20.0).labels == water.attenuation_length
