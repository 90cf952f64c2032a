"""Outlines and dimensions of patches, against shapes whose every figure is known."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dream.survey import patches

CELL = 0.05
Mask = npt.NDArray[np.bool_]


def disc(x: float, y: float, radius: float, side: float = 8.0) -> Mask:
    """In a square of `side` metres."""
    at = (np.arange(round(side / CELL)) + 0.5) * CELL
    return np.asarray(np.hypot(at[None, :] - x, at[:, None] - y) <= radius)


def test_a_disc_has_its_area_outline_and_dimensions() -> None:
    mask = disc(4.0, 3.0, 2.0)
    (ring,) = patches.rings(mask, (0.0, 0.0), CELL)
    assert patches.signed_area(ring) == pytest.approx(4.0 * math.pi, rel=0.01)
    assert ring.mean(axis=0) == pytest.approx((4.0, 3.0), abs=0.05)
    assert patches.calipers(ring) == pytest.approx((4.0, 4.0), abs=0.08)
    # Lines at multiples of 45° alone are at most 8 % longer than the curve that they follow.
    assert 1.0 <= patches.perimeter((ring,)) / (4.0 * math.pi) <= 1.09


def test_a_hole_is_a_ring_of_its_own_and_turns_the_other_way() -> None:
    mask = disc(4.0, 4.0, 2.0) & ~disc(4.0, 4.0, 1.0)
    outline, hole = patches.rings(mask, (10.0, -5.0), CELL)
    assert patches.signed_area(outline) == pytest.approx(4.0 * math.pi, rel=0.01)
    assert patches.signed_area(hole) == pytest.approx(-math.pi, rel=0.02)
    for ring in (outline, hole):
        assert (ring[0] == ring[-1]).all()
        assert ring.mean(axis=0) == pytest.approx((14.0, -1.0), abs=0.05)


@given(st.integers(0, 2**32 - 1))
@example(74886368)  # A ring begins where two parts touch.
def test_rings_hold_the_area_of_any_mask(seed: int) -> None:
    mask = np.random.default_rng(seed).random((9, 11)) < 0.5
    found = patches.rings(mask, (0.0, 0.0), 1.0)
    if not mask.any():
        assert found == ()
        return
    # Each corner of the outline is cut by an eighth: outward ones off, inward ones filled.
    wide = np.pad(mask, 1).astype(int)
    four = wide[1:, 1:] + wide[:-1, 1:] + wide[1:, :-1] + wide[:-1, :-1]
    diagonal = (four == 2) & (wide[1:, 1:] == wide[:-1, :-1])
    cut = 0.125 * (np.count_nonzero(four == 1) - np.count_nonzero(four == 3) + 2 * np.count_nonzero(diagonal))
    assert sum(map(patches.signed_area, found)) == pytest.approx(mask.sum() - cut)


def test_what_is_less_than_twice_the_radius_apart_is_one_reef() -> None:
    near = disc(2.0, 4.0, 1.0) | disc(4.8, 4.0, 1.0)
    far = disc(2.0, 4.0, 1.0) | disc(5.2, 4.0, 1.0)
    assert patches.parts(patches.closed(near, CELL), CELL)[1] == 1
    assert patches.parts(patches.closed(far, CELL), CELL)[1] == 2


@given(st.integers(0, 2**32 - 1))
def test_closing_adds_only_and_closes_once(seed: int) -> None:
    mask = np.random.default_rng(seed).random((30, 40)) < 0.02
    once = patches.closed(mask, 0.1)
    assert (once | ~mask).all()
    assert (patches.closed(once, 0.1) == once).all()


def test_closing_is_what_no_empty_disc_reaches() -> None:
    mask = np.random.default_rng(3).random((24, 26)) < 0.05
    slow = np.zeros_like(mask)
    rows, cols = np.indices(np.pad(mask, 12).shape)
    wide = np.pad(mask, 12)
    covered = np.argwhere(wide)
    centre = np.stack([rows, cols], axis=-1).reshape(-1, 2)
    away = np.hypot(*(centre[:, None] - covered[None]).transpose(2, 0, 1)).min(axis=1)
    empty = centre[away > 5.0 + 1e-9]
    for row, col in np.ndindex(mask.shape):
        slow[row, col] = (np.hypot(*(empty - (row + 12, col + 12)).T) > 5.0 + 1e-9).all()
    assert (patches.closed(mask, 0.1, 0.5) == (slow | mask)).all()


def test_patches_come_by_size_and_small_ones_do_not() -> None:
    mask = disc(1.5, 1.5, 0.7) | disc(5.0, 5.0, 2.0) | disc(1.0, 6.0, 0.3)
    marks, count = patches.parts(mask, CELL)
    assert count == 2
    assert (marks[disc(5.0, 5.0, 2.0)] == 0).all()
    assert (marks[disc(1.5, 1.5, 0.7)] == 1).all()
    assert (marks[disc(1.0, 6.0, 0.3)] == -1).all()


def test_calipers_of_a_turned_rectangle() -> None:
    c, s = math.cos(0.4), math.sin(0.4)
    corners = np.array([[0, 0], [5, 0], [5, 2], [0, 2]], float) @ np.array([[c, s], [-s, c]])
    assert patches.calipers(corners) == pytest.approx((math.hypot(5.0, 2.0), 2.0))
    assert patches.calipers(np.array([[0.0, 0.0], [3.0, 4.0]])) == pytest.approx((5.0, 0.0))
