"""What an observation would add."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.mapping import OccupancyMap, gain, view, visible_weight
from dream.mapping.visibility import FRACTIONS
from dream.protocol import DREAM_V1, SurveyProtocol
from dream.types import BoolArray
from tests.mapping.analytic import AREA, empty_map, look, map_with, wall
from tests.mapping.test_visibility import cells_reached, drawn_map

ONES = np.ones((96, 96), np.float32)
FINE = replace(DREAM_V1, cell=0.1)
NARROW = replace(DREAM_V1, reach=3.0, altitude=0.5)


def views(
    solid: BoolArray, x: float, y: float, protocol: SurveyProtocol, headings: int, rays: int = 1024
) -> npt.NDArray[np.bool_]:
    """(headings, rows, cols) what each heading shows, from rays cut at the grid lines. Position in cells."""
    reach, blind = protocol.reach / protocol.cell, protocol.blind / protocol.cell
    dx, dy = np.arange(solid.shape[1]) + 0.5 - x, (np.arange(solid.shape[0]) + 0.5 - y)[:, None]
    reached = cells_reached(solid, x, y, reach, rays) & (np.hypot(dx, dy) <= reach + 1e-9)
    yaw = (np.arange(headings) * 2.0 * math.pi / headings)[:, None, None]
    relative = (np.arctan2(dy, dx) - yaw + math.pi) % (2.0 * math.pi) - math.pi
    in_sector = np.abs(relative) <= 0.5 * protocol.camera.horizontal_fov + 1e-6
    shown: npt.NDArray[np.bool_] = reached & in_sector & (np.hypot(dx, dy) * np.cos(relative) >= blind - 1e-6)
    return shown


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    solid_share=st.sampled_from([0.0, 0.02, 0.1, 0.5]),
    protocol=st.sampled_from([DREAM_V1, NARROW]),
    headings=st.sampled_from([None, 1, 7, 64]),
    corner=st.sampled_from([(0.0, 0.0), (-12.0, -12.0), (250_000.0, -1_000_000.0)]),
    shape=st.sampled_from([(40, 70), (1, 1), (130, 17), (90, 90)]),
)
def test_every_heading_sums_exactly_the_cells_that_its_rays_reach(
    seed: int,
    solid_share: float,
    protocol: SurveyProtocol,
    headings: int | None,
    corner: tuple[float, float],
    shape: tuple[int, int],
) -> None:
    rng = np.random.default_rng(seed)
    solid, explored = rng.random(shape) < solid_share, rng.random(shape) < 0.4
    occupancy = drawn_map(solid, explored, corner, protocol)
    weights = rng.integers(0, 5, shape).astype(np.float32)
    # Inside, on solid cells, at the border and outside, all mixed in one call.
    in_eighths = rng.integers(-20 * FRACTIONS, (np.array(shape[::-1]) + 20) * FRACTIONS, (3, 2))
    in_cells = in_eighths / FRACTIONS
    positions = in_cells * protocol.cell + corner
    count = protocol.headings if headings is None else headings
    new, every = (f(occupancy, positions, weights, headings) for f in (gain, visible_weight))
    counted = gain(occupancy, positions, headings=headings)
    for p, (x, y) in enumerate(in_cells):
        shown = views(solid, x, y, protocol, count)
        np.testing.assert_array_equal(every[p], (shown * weights).sum(axis=(1, 2)))
        np.testing.assert_array_equal(new[p], (shown * weights * ~explored).sum(axis=(1, 2)))
        np.testing.assert_array_equal(counted[p], (shown & ~explored).sum(axis=(1, 2)))


def test_positions_asked_together_gain_what_each_gains_alone() -> None:
    rng = np.random.default_rng(5)
    solid = rng.random((400, 500)) < 0.03
    occupancy = drawn_map(solid, rng.random(solid.shape) < 0.5)
    weights = rng.random(solid.shape).astype(np.float32)
    positions = rng.uniform((-20.0, -20.0), (145.0, 120.0), (200, 2))
    together = gain(occupancy, positions, weights)
    alone = np.concatenate([gain(occupancy, position[None], weights) for position in positions])
    np.testing.assert_array_equal(together, alone)
    assert (together > 0.0).any(axis=1).sum() > 100


def boulders(share: float, shape: tuple[int, int], cell: float, seed: int) -> BoolArray:
    """Boxes of 0.5 to 3 m anywhere, until they make up that share."""
    rng = np.random.default_rng(seed)
    solid = np.zeros(shape, np.bool_)
    while solid.mean() < share:
        height, width = (rng.uniform(0.5, 3.0, 2) / cell).astype(int)
        row, col = rng.integers(0, shape)
        solid[row : row + height, col : col + width] = True
    return solid


@pytest.mark.few(3)
@pytest.mark.parametrize("protocol", [DREAM_V1, FINE], ids=["0.25 m", "0.1 m"])
@pytest.mark.parametrize("share", [0.02, 0.05, 0.1])
def test_the_gain_is_within_two_percent_of_a_caster_with_many_more_rays(
    share: float, protocol: SurveyProtocol
) -> None:
    side = round(24.0 / protocol.cell)
    solid = boulders(share, (side, side), protocol.cell, seed=round(100 * share))
    free = np.argwhere(~solid)[:, ::-1]
    places = np.random.default_rng(1).choice(free, 6, replace=False) + np.random.default_rng(2).random((6, 2))
    ours = visible_weight(drawn_map(solid, protocol=protocol), places * protocol.cell)
    exact = np.array([views(solid, x, y, protocol, 12, rays=7200).sum(axis=(1, 2)) for x, y in places])
    assert abs(ours.sum() / exact.sum() - 1.0) < 0.02
    assert np.corrcoef(ours.ravel(), exact.ravel())[0, 1] > 0.998


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
    with pytest.raises(ValueError, match="headings: expected at least 1, got 0"):
        gain(empty_map(), [[0.0, 0.0]], headings=0)


def test_what_is_explored_gains_nothing_whatever_it_weighs() -> None:
    explored = np.ones((96, 96), np.bool_)
    occupancy = drawn_map(np.zeros_like(explored), explored)
    assert not gain(occupancy, [[12.0, 12.0]], np.full((96, 96), np.nan, np.float32)).any()
