"""What counts as traversed: under the body, or ahead of it in the image, near enough."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import Camera
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.traversal import traversed

LOPSIDED = replace(POOL_V1, camera=Camera(320, 240, 200.0, 200.0, 100.0, 120.0))
"""It sees farther to the right than to the left."""
NEAR = POOL_V1.traversal or 0.0

metres = st.floats(-0.8, 0.8)


def by_bearing(east: float, north: float, yaw: float, protocol: SurveyProtocol) -> bool:
    """The slow twin: polar coordinates, and the bearings of the image's two edges."""
    camera, distance = protocol.camera, math.hypot(east, north)
    bearing = math.remainder(math.atan2(north, east) - yaw, 2.0 * math.pi)
    left, right = math.atan2(camera.cx, camera.fx), math.atan2(camera.width - camera.cx, camera.fx)
    return distance <= NEAR and (-right <= bearing <= left or distance <= protocol.body_radius)


@given(metres, metres, st.floats(-math.pi, math.pi), st.sampled_from([POOL_V1, LOPSIDED]))
def test_it_agrees_with_bearings_away_from_the_edges(
    east: float, north: float, yaw: float, protocol: SurveyProtocol
) -> None:
    around = [
        by_bearing(east + dx, north + dy, yaw, protocol) for dx in (-1e-9, 1e-9) for dy in (-1e-9, 1e-9)
    ]
    if len(set(around)) == 1:
        assert traversed(np.array([east]), np.array([north]), yaw, protocol).tolist() == [around[0]]


@given(metres, metres, st.floats(-math.pi, math.pi), st.floats(0.0, 0.1), st.floats(-math.pi, math.pi))
def test_what_keeps_a_margin_is_traversed_by_a_vehicle_that_is_so_far_off(
    east: float, north: float, yaw: float, margin: float, towards: float
) -> None:
    off = (margin - 1e-9) * np.array([math.cos(towards), math.sin(towards)])
    if traversed(np.array([east]), np.array([north]), yaw, LOPSIDED, margin=margin)[0]:
        assert traversed(np.array([east + off[0]]), np.array([north + off[1]]), yaw, LOPSIDED)[0]


def test_a_margin_is_kept_from_every_edge() -> None:
    camera = LOPSIDED.camera
    left, right = math.atan2(camera.cx, camera.fx), -math.atan2(camera.width - camera.cx, camera.fx)
    body = LOPSIDED.body_radius
    for point, inwards in (
        (0.5 * np.array([math.cos(left), math.sin(left)]), left - 0.5 * math.pi),
        (0.5 * np.array([math.cos(right), math.sin(right)]), right + 0.5 * math.pi),
        (np.array([NEAR, 0.0]), math.pi),
        (np.array([-body, 0.0]), 0.0),
    ):
        for away, kept in ((0.019, False), (0.021, True)):
            east, north = point + away * np.array([math.cos(inwards), math.sin(inwards)])
            at = np.array([east]), np.array([north])
            assert traversed(*at, 0.0, LOPSIDED, margin=0.02)[0] == kept
            assert traversed(*at, 0.0, LOPSIDED)[0]


def test_nothing_is_traversed_where_no_traversal_is_asked_for() -> None:
    assert not traversed(np.zeros(3), np.zeros(3), 0.0, DREAM_V1).any()
