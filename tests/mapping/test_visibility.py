"""Eq. 7 and 8: what a pose sees of the map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.geometry import Bounds
from dream.mapping import OccupancyMap, view
from dream.mapping._kernels.flags import RAYS
from dream.mapping._kernels.sight import SECTOR_SLACK
from dream.mapping.visibility import locate, visible_sector
from dream.protocol import DREAM_V1, SurveyProtocol
from dream.types import BoolArray
from tests.mapping.analytic import empty_map, look, map_with

HALF = 0.5 * DREAM_V1.camera.horizontal_fov


def offsets(
    shape: tuple[int, int], x: float, y: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Metres from a position to every cell's centre."""
    center_x, center_y = empty_map().center_of(*np.indices(shape))
    return center_x - x, center_y - y


def sector(shape: tuple[int, int], x: float, y: float, yaw: float) -> BoolArray:
    """The paper's sector without occlusion, from its definition."""
    dx, dy = offsets(shape, x, y)
    relative = (np.arctan2(dy, dx) - yaw + math.pi) % (2.0 * math.pi) - math.pi
    distance = np.hypot(dx, dy)
    return (
        (distance * np.cos(relative) >= distance * math.cos(HALF) - SECTOR_SLACK * DREAM_V1.cell)
        & (distance <= DREAM_V1.reach + 1e-9)
        & (distance * np.cos(relative) >= DREAM_V1.blind - SECTOR_SLACK * DREAM_V1.cell)
    )


@dataclass(frozen=True)
class Drawn:
    """What a map tells about sight, straight from arrays."""

    solid: BoolArray
    explored: BoolArray
    bounds: Bounds
    protocol: SurveyProtocol = DREAM_V1

    @property
    def shape(self) -> tuple[int, int]:
        return self.solid.shape[0], self.solid.shape[1]

    @property
    def observed(self) -> BoolArray:
        return self.explored


def drawn_map(
    solid: BoolArray,
    explored: BoolArray | None = None,
    corner: tuple[float, float] = (0.0, 0.0),
    protocol: SurveyProtocol = DREAM_V1,
) -> OccupancyMap:
    """A map with these layers, its corner anywhere."""
    (rows, cols), (x, y) = solid.shape, corner
    bounds = Bounds(x, y, x + cols * protocol.cell, y + rows * protocol.cell)
    layer = np.zeros_like(solid) if explored is None else explored
    return cast(OccupancyMap, Drawn(solid, layer, bounds, protocol))


def cells_reached(solid: BoolArray, x: float, y: float, reach: float, rays: int = RAYS) -> BoolArray:
    """Cells that a ray gets to, the observer anywhere. Lengths in cells.

    Each ray is cut at every grid line that it meets; no table, no sweep.
    """
    turn = (np.arange(rays) + 0.5)[:, None] * 2.0 * math.pi / rays
    lines = np.arange(math.ceil(reach) + 3)
    cuts = [np.zeros((rays, 1))]
    for start, along in ((x, np.cos(turn)), (y, np.sin(turn))):
        first = np.where(along > 0.0, math.floor(start) + 1.0 - start, start - math.ceil(start) + 1.0)
        cuts.append((first + lines) / np.abs(along))
    ends = np.sort(np.concatenate(cuts, axis=1))
    middle = 0.5 * (ends[:, :-1] + ends[:, 1:])
    row = np.floor(y + middle * np.sin(turn)).astype(int)
    col = np.floor(x + middle * np.cos(turn)).astype(int)
    rows, cols = solid.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols) & (middle <= reach + 1.0)
    stops = np.where(inside, solid[row.clip(0, rows - 1), col.clip(0, cols - 1)], False)
    lit = inside & (np.cumsum(stops, axis=1) - stops == 0)
    reached = np.zeros_like(solid)
    reached[row[lit], col[lit]] = True
    return reached


def test_eq_07_an_empty_map_shows_the_whole_sector_from_the_blind_distance_to_the_reach() -> None:
    occupancy = empty_map()
    for x, y, yaw in ((0.0, 0.0, 0.0), (1.0, -2.5, math.radians(30.0)), (-3.0, 0.5, math.pi)):
        np.testing.assert_array_equal(view(occupancy, x, y, yaw), sector(occupancy.shape, x, y, yaw))


def test_eq_07_a_ray_ends_in_the_first_solid_cell_which_is_itself_visible() -> None:
    solid = np.zeros((96, 96), np.bool_)
    solid[40:56, 60] = True  # A wall 3 m ahead, 4 m wide.
    visible = view(map_with(solid=solid), 0.0, 0.0, 0.0)
    assert visible[40:56, 60].all()
    assert not visible[44:52, 61:].any()
    assert visible[44:52, 56:60].all()


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    x=st.integers(-600, 600).map(lambda eighths: eighths / 32.0),
    y=st.integers(-600, 600).map(lambda eighths: eighths / 32.0),
    yaw=st.floats(-math.pi, math.pi),
)
def test_eq_07_the_sweep_is_exactly_its_rays_cast_one_by_one(
    seed: int, x: float, y: float, yaw: float
) -> None:
    solid = np.random.default_rng(seed).random((96, 96)) < 0.03
    occupancy = map_with(solid=solid)
    row, col, table = locate(occupancy, x, y)
    everywhere = visible_sector(solid, row, col, table, yaw=yaw, half_angle=math.pi, blind=-100.0)
    in_reach = np.hypot(*offsets(solid.shape, x, y)) <= DREAM_V1.reach + 1e-9
    expected = cells_reached(solid, (x + 12.0) / 0.25, (y + 12.0) / 0.25, 32.0) & in_reach
    np.testing.assert_array_equal(everywhere, expected)
    np.testing.assert_array_equal(view(occupancy, x, y, yaw), expected & sector(solid.shape, x, y, yaw))


def test_eq_08_what_was_explored_stays_explored_and_what_is_visible_joins_it() -> None:
    occupancy = empty_map()
    look(occupancy, 0.0, 0.0, 0.0)
    before = occupancy.explored
    promised = view(occupancy, 1.0, 0.0, 2.0)
    look(occupancy, 1.0, 0.0, 2.0)
    assert promised.any()
    assert (promised & ~before).any()
    assert occupancy.explored[before | promised].all()


def test_a_view_from_outside_the_map_looks_into_it() -> None:
    visible = view(empty_map(), -13.0, 0.0, 0.0)
    assert visible[48, 10]
    assert not visible[48, 40]


def test_a_view_needs_finite_numbers() -> None:
    with pytest.raises(ValueError, match="view: expected finite"):
        view(empty_map(), math.nan, 0.0, 0.0)
