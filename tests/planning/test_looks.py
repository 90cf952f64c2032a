"""What looks show, of points whose answer is known in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from dream.geometry import Bounds
from dream.mapping.volume import FREE, SOLID, Volume
from dream.planning.space.looks import WITHIN, edges, gains, shown
from dream.planning.space.ways import KnownWays, ways_in
from dream.protocol import DREAM_V2_TRUE as PROTOCOL

EYE = (6.0, 0.0, -8.0)
Array = np.ndarray[Any, Any]


@pytest.fixture
def ways() -> KnownWays:
    """Through a box of which nothing is known but that it is there."""
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, -8.0], 6.0)
    return ways_in(volume, Bounds(-8.0, -8.0, 8.0, 8.0), PROTOCOL)


def cylinder() -> tuple[Array, Array]:
    """Points and normals of one of 2 m radius about the origin, from 10 to 6 m deep."""
    angle, z = np.meshgrid(np.linspace(0.0, 2.0 * math.pi, 200), np.arange(-10.0, -6.0, 0.25))
    out = np.column_stack([np.cos(angle.ravel()), np.sin(angle.ravel()), np.zeros(angle.size)])
    return 2.0 * out + np.column_stack([np.zeros((angle.size, 2)), z.ravel()]), out


def test_a_look_shows_all_that_faces_it_in_its_image_and_reach(ways: KnownWays) -> None:
    points, normals = cylinder()
    assert PROTOCOL.space is not None
    away = points - np.array(EYE)
    distance = np.linalg.norm(away, axis=1)
    useful = -(away * normals).sum(axis=1) >= math.cos(WITHIN * PROTOCOL.space.incidence) * distance
    # Looking west and level: x is depth, y is to the left, and the image is 90 degrees wide, 4 by 3.
    depth = -away[:, 0]
    image = (np.abs(away[:, 1]) <= depth) & (np.abs(away[:, 2]) <= 0.75 * depth)
    expected = useful & image & (distance <= WITHIN * PROTOCOL.reach)
    assert 0 < expected.sum() < len(points)
    np.testing.assert_array_equal(shown(ways, EYE, math.pi, 0.0, points, normals), expected)


def test_what_is_solid_hides_what_lies_behind(ways: KnownWays) -> None:
    points, normals = cylinder()
    scene = ways.scene
    _, row, col = (np.floor(np.array([-8.0, 0.0, 4.0]) / scene.side) - scene.first).astype(int)
    scene.states[:, :, col] = SOLID
    assert not shown(ways, EYE, math.pi, 0.0, points, normals).any()
    scene.states[:, row:, col] = FREE
    seen = points[shown(ways, EYE, math.pi, 0.0, points, normals)]
    assert len(seen)
    assert seen[:, 1].min() > -0.5


def test_the_gain_of_a_look_is_the_weight_of_what_it_shows(ways: KnownWays) -> None:
    points, normals = cylinder()
    weights = np.random.default_rng(0).random(len(points))
    cameras = np.array([EYE, (0.0, -6.0, -7.0)])
    worth = gains(ways, cameras, points, normals, weights)
    assert worth.shape == (2, PROTOCOL.headings, len(PROTOCOL.tilts))
    for (c, heading, tilt), gain in np.ndenumerate(worth):
        yaw, pitch = heading * PROTOCOL.heading_step, PROTOCOL.tilts[tilt]
        seen = shown(ways, tuple(cameras[c].tolist()), yaw, pitch, points, normals)
        assert gain == pytest.approx(weights[seen].sum())


def test_edges_are_free_and_touch_what_is_unknown(ways: KnownWays) -> None:
    # The ball of known water ends 6 m from its middle.
    found = edges(ways, np.array([[0.0, 5.9, -8.0], [0.1, 0.1, -8.0]]))[0]
    assert len(found)
    away = np.linalg.norm(found - np.array([0.0, 0.0, -8.0]), axis=1)
    assert (away > 5.4).all()
    assert (away < 6.0).all()
