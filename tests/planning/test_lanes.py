"""Lanes and spirals on paper: their spacing, their turns, which of their mirror images is flown."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import SE2, Bounds
from dream.planning import Lawnmower, Spiral
from dream.planning.baselines.lanes import (
    Points,
    across,
    densified,
    lanes,
    mirrored,
    seen_to_both_sides,
    shortest,
    spiral,
    spread,
)
from dream.protocol import DREAM_V1, PROTOCOLS
from dream.types import Mission

boxes = st.builds(
    lambda x, y, width, depth: Bounds(x, y, x + width, y + depth),
    *(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0)),
    *(st.floats(3.0, 60.0), st.floats(3.0, 60.0)),
)
spacings = st.floats(2.0, 15.0)


@given(st.floats(-50.0, 50.0), st.floats(0.5, 60.0), spacings)
def test_strips_fill_the_width_and_no_strip_is_too_wide(low: float, width: float, spacing: float) -> None:
    middles = spread(low, low + width, spacing)
    strip = width / len(middles)
    assert strip <= spacing * (1.0 + 1e-6)
    assert len(middles) == 1 or width / (len(middles) - 1) > spacing
    np.testing.assert_allclose(np.diff(middles), strip)
    assert middles[0] - low == pytest.approx(strip / 2.0)
    assert low + width - middles[-1] == pytest.approx(strip / 2.0)


@given(boxes, spacings)
def test_lanes_run_from_end_to_end_in_turns(box: Bounds, spacing: float) -> None:
    route = lanes(box, spacing, inset=1.0)
    legs = np.diff(route, axis=0)
    np.testing.assert_allclose(legs[::2, 0], 0.0)
    np.testing.assert_allclose(np.abs(legs[::2, 1]), box.depth - 2.0)
    np.testing.assert_allclose(legs[1::2, 1], 0.0)
    assert (legs[1::2, 0] > 0.0).all()
    assert (np.sign(legs[::2, 1]) == (-1.0) ** np.arange(len(legs[::2]))).all()


@given(boxes, spacings)
def test_a_spiral_always_turns_the_same_way_and_passes_every_strip_crossing_once(
    box: Bounds, spacing: float
) -> None:
    route = spiral(box, spacing)
    xs, ys = spread(box.x_min, box.x_max, spacing), spread(box.y_min, box.y_max, spacing)
    legs = np.diff(route, axis=0)
    assert ((np.abs(legs) < 1e-9).sum(axis=1) == 1).all(), "legs run along an axis"
    turns = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    assert (turns < 0.0).all(), "to the right, from the south-west corner northwards"
    passed = [
        (x, y)
        for x in xs
        for y in ys
        if any(_on_leg(np.array([x, y]), a, b) for a, b in zip(route, [*route[1:], route[-1]], strict=True))
    ]
    assert len(passed) == len(xs) * len(ys)
    # As long as one leg between neighbours for every crossing but the first: none is passed twice.
    steps = np.abs(legs) / [box.width / len(xs), box.depth / len(ys)]
    assert steps.sum() == pytest.approx(len(passed) - 1)


def _on_leg(point: Points, a: Points, b: Points) -> bool:
    low, high = np.minimum(a, b) - 1e-9, np.maximum(a, b) + 1e-9
    return bool(((low <= point) & (point <= high)).all())


@given(boxes)
def test_the_mirror_images_stay_in_the_box_and_are_as_long(box: Bounds) -> None:
    route = lanes(box, 5.0, 1.0)
    for image in mirrored(route, box):
        assert _length(image) == pytest.approx(_length(route))
        assert (image >= [box.x_min - 1e-9, box.y_min - 1e-9]).all()
        assert (image <= [box.x_max + 1e-9, box.y_max + 1e-9]).all()
    assert across(across(box)) == box


def _length(route: Points) -> float:
    return float(np.hypot(*np.diff(route, axis=0).T).sum())


@given(boxes, st.floats(0.05, 3.0))
def test_points_between_the_corners_are_on_the_way_and_near_each_other(box: Bounds, step: float) -> None:
    route = lanes(box, 6.0, 0.5)
    points = densified(route, step)
    gaps = np.hypot(*np.diff(points, axis=0).T)
    assert gaps.max() <= step * (1.0 + 1e-6)
    assert gaps.sum() == pytest.approx(_length(route))
    assert all((np.abs(points - corner).max(axis=1) < 1e-9).any() for corner in route)


@pytest.mark.few(12)
@pytest.mark.parametrize("planner", [Lawnmower(), Spiral()], ids=["lawnmower", "spiral"])
@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=PROTOCOLS)
@pytest.mark.parametrize("start", [(0.2, -0.1), (-0.7, 0.6), (0.8, 0.8)])
def test_no_ground_is_farther_from_the_route_than_the_camera_sees_to_one_side(
    planner: Lawnmower | Spiral, protocol: object, start: tuple[float, float]
) -> None:
    rules = PROTOCOLS["dream-v1"] if protocol is DREAM_V1 else PROTOCOLS["pool-v1"]
    half = 2.8 * rules.reach
    box = Bounds(-half, -half, half, half)
    mission = Mission(rules, box, 200)
    pose = SE2(start[0] * half, start[1] * half, 0.0)
    x, y = np.meshgrid(np.linspace(-half, half, 41), np.linspace(-half, half, 41))
    ground = np.stack([x.ravel(), y.ravel()], axis=-1)
    for sweep in (0, 1):
        route = planner.route(mission, pose, sweep)
        points = densified(route, 0.05 * rules.reach)
        away = np.abs(ground[:, None] - points[None]).max(axis=2).min(axis=1)
        # The ends of the lanes are farther from the edge, which the camera sees ahead.
        ahead = max(seen_to_both_sides(rules) / 2.0, getattr(planner, "inset", 0.0) * rules.reach)
        assert away.max() <= ahead + 0.05 * rules.reach


def test_the_route_begins_near_by() -> None:
    box = Bounds(-20.0, -20.0, 20.0, 20.0)
    for x, y in ((-18.0, 17.0), (18.0, 18.0), (16.0, -19.0), (-15.0, -15.0)):
        begin = Lawnmower().route(Mission(DREAM_V1, box, 200), SE2(x, y, 0.0), 0)[0]
        assert np.sign(begin).tolist() == [math.copysign(1.0, x), math.copysign(1.0, y)]


def test_a_spiral_begins_in_the_middle_where_the_start_is_there_and_outside_where_it_is_not() -> None:
    mission = Mission(DREAM_V1, Bounds(-22.5, -22.5, 22.5, 22.5), 200)
    outward = Spiral().route(mission, SE2(1.0, -2.0, 0.0), 0)
    inward = Spiral().route(mission, SE2(-19.0, 18.0, 0.0), 0)
    assert np.abs(outward[0]).max() < np.abs(outward[-1]).max()
    assert np.abs(inward[0]).max() > np.abs(inward[-1]).max()


def test_the_second_sweep_goes_over_the_area_in_another_way() -> None:
    mission, start = Mission(DREAM_V1, Bounds(-20.0, -20.0, 20.0, 20.0), 200), SE2(0.5, 3.0, 0.0)
    first, second = (Lawnmower().route(mission, start, sweep) for sweep in (0, 1))
    along_x = [abs(float(route[1, 0] - route[0, 0])) > 1e-9 for route in (first, second)]
    assert along_x[0] != along_x[1]
    out, back = (Spiral().route(mission, start, sweep) for sweep in (0, 1))
    assert np.abs(out[0]).max() < np.abs(back[0]).max()


@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
def test_the_shortest_of_the_routes_is_taken(x: float, y: float) -> None:
    box = Bounds(-20.0, -20.0, 20.0, 20.0)
    routes = mirrored(lanes(box, 9.0, 4.0), box)
    ways = [math.hypot(route[0][0] - x, route[0][1] - y) for route in routes]
    chosen = shortest(routes, SE2(x, y, 0.0))
    assert math.hypot(chosen[0][0] - x, chosen[0][1] - y) == pytest.approx(min(ways))


@pytest.mark.parametrize("planner", [Lawnmower(), Spiral()], ids=["lawnmower", "spiral"])
@pytest.mark.parametrize("sweep", [0, 1])
def test_the_route_over_an_area_lies_in_it(planner: Lawnmower | Spiral, sweep: int) -> None:
    area = Bounds(-20.0, 0.0, -4.0, 20.0)
    mission = Mission(DREAM_V1, Bounds(-20.0, -20.0, 20.0, 20.0), 200, area=area)
    for x, y in planner.route(mission, SE2(13.0, -13.0, 0.0), sweep):
        assert area.contains(x, y)
