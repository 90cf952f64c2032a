"""What an observation would add."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.mapping import OccupancyMap, gain, view
from dream.protocol import DREAM_V1
from tests.mapping.analytic import AREA, empty_map, look, map_with, wall

ONES = np.ones((96, 96), np.float32)


@given(seed=st.integers(0, 2**31), on_lattice=st.booleans())
@settings(max_examples=20)
def test_the_gain_is_the_weight_of_the_new_cells_of_each_view(seed: int, on_lattice: bool) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((96, 96)) < 0.02
    occupancy = map_with(solid=solid, explored=solid | (rng.random((96, 96)) < 0.4))
    weights = rng.random((96, 96)).astype(np.float32)
    positions = rng.uniform(-13.0, 13.0, (6, 2))
    if on_lattice:
        positions = np.round(positions / DREAM_V1.lattice) * DREAM_V1.lattice
    gains = gain(occupancy, positions, weights)
    assert gains.shape == (6, DREAM_V1.headings)
    assert gains.dtype == np.float32
    new = np.where(occupancy.explored, 0.0, weights)
    for (x, y), row in zip(positions, gains, strict=True):
        expected = [new[view(occupancy, x, y, k * DREAM_V1.heading_step)].sum() for k in range(12)]
        np.testing.assert_allclose(row, expected, atol=1e-3)


def test_in_an_unknown_world_a_view_gains_its_sector_s_area() -> None:
    occupancy = empty_map()
    cells = gain(occupancy, [[0.0, 0.0]], ONES)[0]
    blind = DREAM_V1.blind
    # A quarter disc less the triangle before the blind line.
    area = 0.25 * math.pi * DREAM_V1.reach**2 - blind**2
    np.testing.assert_allclose(cells * DREAM_V1.cell**2, area, rtol=0.03)


def test_nothing_is_gained_behind_a_wall_or_where_all_is_explored() -> None:
    occupancy = empty_map()
    before = gain(occupancy, [[0.0, 0.0]], ONES)[0, 0]
    look(occupancy, 0.0, 0.0, 0.0, wall(4.1))
    after = gain(occupancy, [[0.0, 0.0]], ONES)[0]
    assert after[0] == 0.0
    assert after[6] == before


def test_outside_the_bounds_there_is_nothing_to_gain() -> None:
    occupancy = empty_map()
    inside, at_the_edge, outside = gain(occupancy, [[0.0, 0.0], [11.5, 0.0], [60.0, 0.0]], ONES)
    assert at_the_edge[0] == 0.0
    assert at_the_edge[6] == inside[6]
    assert not outside.any()


def test_the_headings_are_those_of_the_protocol() -> None:
    occupancy = OccupancyMap(AREA, replace(DREAM_V1, headings=24))
    gains = gain(occupancy, [[0.0, 0.0]], ONES)
    assert gains.shape == (1, 24)
    assert gains[0, 5] == view(occupancy, 0.0, 0.0, math.radians(75.0)).sum()


def test_no_position_gains_nothing_at_all() -> None:
    assert gain(empty_map(), np.zeros((0, 2)), ONES).shape == (0, 12)


def test_arguments_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"positions: expected \(P, 2\) metres, got \(2,\)"):
        gain(empty_map(), [0.0, 0.0], ONES)
    with pytest.raises(ValueError, match="positions: expected finite numbers"):
        gain(empty_map(), [[0.0, math.nan]], ONES)
    with pytest.raises(ValueError, match=r"weights: expected \(96, 96\) like the map, got \(3, 3\)"):
        gain(empty_map(), [[0.0, 0.0]], np.ones((3, 3)))
