"""Frontier, clusters and inflation that are kept up to date, against scipy from scratch."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from dream.mapping._kernels.flags import (
    BARE,
    CROSSED,
    EXPLORED,
    FRONTIER,
    GROUNDED,
    INFLATED,
    KNOWN,
    RETURNED,
    SEABED,
)
from dream.mapping.blocks import BlockStore
from dream.mapping.edges import Edges
from dream.types import BoolArray

CROSS = ndimage.generate_binary_structure(2, 1)
LOW, SHAPE = (-200, -200), (400, 400)
"""Wider than what the tests write, with room for inflation."""
REST = EXPLORED | BARE | SEABED | CROSSED | RETURNED | GROUNDED

Bounds = tuple[int, int, int, int]
BOUNDS: tuple[Bounds | None, ...] = (None, (-70, -130, 140, 200), (0, 0, 64, 128), (-64, -64, 1, 300))


def empty_store() -> BlockStore:
    return BlockStore({"log_odds": (np.int8, (64, 64)), "flags": (np.uint8, (64, 64))})


def put(
    store: BlockStore, row: int, col: int, known: BoolArray, solid: BoolArray, bit: int = EXPLORED
) -> None:
    """Write a rectangle as the map does: the frontier and inflation bits stay as they are."""
    old = store.read("flags", (row, col), known.shape) & (FRONTIER | INFLATED)
    store.write("flags", (row, col), old | np.where(known, bit, SEABED).astype(np.uint8))
    store.write("log_odds", (row, col), np.where(solid, 3, np.where(known, -2, 0)))


def check(store: BlockStore, edges: Edges, needed_room: int, bounds: Bounds | None) -> int:
    """Everything as scipy finds it from scratch; the number of clusters."""
    flags = store.read("flags", LOW, SHAPE)
    solid = store.read("log_odds", LOW, SHAPE) > 0
    known = solid | ((flags & KNOWN) > 0)
    inside = np.ones(SHAPE, np.bool_)
    if bounds is not None:
        inside[:] = False
        row, col = bounds[0] - LOW[0], bounds[1] - LOW[1]
        inside[max(row, 0) : row + bounds[2], max(col, 0) : col + bounds[3]] = True
    frontier = known & ~solid & ndimage.binary_dilation(~known & inside, CROSS)
    np.testing.assert_array_equal((flags & FRONTIER) > 0, frontier)
    reach = math.isqrt(needed_room) // 2 + 2
    half = np.maximum(2 * np.abs(np.arange(-reach, reach + 1)) - 1, 0)
    body = half[:, None] ** 2 + half[None, :] ** 2 <= needed_room
    np.testing.assert_array_equal((flags & INFLATED) > 0, ndimage.binary_dilation(solid, body) & inside)
    labels, count = ndimage.label(frontier, np.ones((3, 3)))
    clusters = edges.clusters()
    assert len(clusters) == count
    numbers = np.arange(1, count + 1)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    assert [cluster.size for cluster in clusters] == sizes.tolist()
    if count:
        centroids = np.array(ndimage.center_of_mass(frontier, labels, numbers)) + LOW
        np.testing.assert_allclose([cluster.centroid for cluster in clusters], centroids)
        cells = [cluster.cells for cluster in clusters]
        assert [cluster.first for cluster in clusters] == [tuple(own[0]) for own in cells]
        # Each cluster's cells in raster order, cluster after cluster.
        order = np.argsort(labels[labels > 0], kind="stable")
        np.testing.assert_array_equal(np.concatenate(cells), np.argwhere(labels)[order] + LOW)
    return count


@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**31),
    needed_room=st.sampled_from([0, 2, 17, 70, 237]),
    bounds=st.sampled_from(BOUNDS),
    far=st.sampled_from([3, 30, 100]),
)
def test_after_any_changes_all_is_as_from_scratch(
    seed: int, needed_room: int, bounds: Bounds | None, far: int
) -> None:
    rng = np.random.default_rng(seed)
    store = empty_store()
    edges = Edges(store, needed_room, bounds)
    for _ in range(6):
        shape = (int(rng.integers(1, far)), int(rng.integers(1, far)))
        row, col = int(rng.integers(-150, 150 - shape[0])), int(rng.integers(-150, 150 - shape[1]))
        share, crowd = rng.choice([0.0, 0.03, 0.4, 0.95, 1.0]), rng.choice([0.0, 0.0, 0.003, 0.1])
        known = np.kron(rng.random((1 + shape[0] // 4, 1 + shape[1] // 4)) < share, np.ones((4, 4), np.bool_))
        known = known[: shape[0], : shape[1]] ^ (rng.random(shape) < 0.01)
        bit = int(rng.choice([EXPLORED, BARE, CROSSED, RETURNED, REST]))
        put(store, row, col, known, rng.random(shape) < crowd, bit)
        edges.update(row, col, row + shape[0], col + shape[1])
        check(store, edges, needed_room, bounds)
    again = store.copy()
    check(again, Edges(again, needed_room, bounds), needed_room, bounds)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.1, 0.3, 0.5, 0.9]))
def test_many_parts_may_lie_along_the_borders_of_blocks(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    store = empty_store()
    edges = Edges(store, 2)
    for low, high in ((-100, 100), (-4, 4), (-66, -60), (-1, 1), (-65, 64)):
        row, col = (low, -80) if rng.random() < 0.5 else (-80, low)
        shape = (high - low, 160) if row == low else (160, high - low)
        put(store, row, col, rng.random(shape) < share, np.zeros(shape, np.bool_))
        edges.update(row, col, row + shape[0], col + shape[1])
        check(store, edges, 2, None)


def snake(rows: int, cols: int) -> BoolArray:
    """One path of single cells that winds up and down through a rectangle."""
    path = np.zeros((rows, cols), np.bool_)
    path[:, ::4] = True
    path[0, 2::8] = path[0, 1::8] = path[0, 3::8] = True
    path[-1, 5::8] = path[-1, 6::8] = path[-1, 7::8] = True
    return path


@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), ring=st.booleans())
def test_long_snakes_and_rings_are_cut_and_mended_anywhere(seed: int, ring: bool) -> None:
    rng = np.random.default_rng(seed)
    store = empty_store()
    edges = Edges(store, 17)
    whole = snake(160, 161)
    if ring:
        whole[:] = False
        whole[::158, :159] = whole[:159, ::158] = True
    rows, cols = whole.shape
    known = whole.copy()
    put(store, -90, -70, known, np.zeros_like(known))
    edges.update(-90, -70, rows - 90, cols - 70)
    assert check(store, edges, 17, None) == 1
    places = np.argwhere(whole)
    for _ in range(12):
        row, col = (int(n) for n in places[rng.integers(len(places))])
        known[row, col] ^= True
        put(store, row - 90, col - 70, known[row : row + 1, col : col + 1], np.zeros((1, 1), np.bool_))
        edges.update(row - 90, col - 70, row - 89, col - 69)
        check(store, edges, 17, None)


def test_a_ring_cut_once_is_one_cluster_and_cut_twice_two() -> None:
    store = empty_store()
    edges = Edges(store, 17)
    ring = np.zeros((200, 200), np.bool_)
    ring[::199, :] = ring[:, ::199] = True
    put(store, -100, -100, ring, np.zeros_like(ring))
    edges.update(-100, -100, 100, 100)
    for cut, clusters in (((-100, 5), 1), ((99, -40), 2)):
        put(store, *cut, np.zeros((1, 1), np.bool_), np.zeros((1, 1), np.bool_))
        edges.update(*cut, cut[0] + 1, cut[1] + 1)
        assert check(store, edges, 17, None) == clusters


@pytest.mark.parametrize("late", [(-1, -1), (-1, 0), (0, -1), (0, 0)])
def test_cells_that_touch_at_the_corner_of_four_blocks_are_one_cluster(late: tuple[int, int]) -> None:
    store = empty_store()
    edges = Edges(store, 17)
    other = (-1 - late[0], -1 - late[1])
    for row, col in (other, late):
        put(store, row, col, np.ones((1, 1), np.bool_), np.zeros((1, 1), np.bool_))
        edges.update(row, col, row + 1, col + 1)
        assert check(store, edges, 17, None) == 1


def test_without_inflation_the_cells_beside_a_change_are_renewed_too() -> None:
    store = empty_store()
    edges = Edges(store, 0)
    put(store, 0, 0, np.ones((5, 5), np.bool_), np.zeros((5, 5), np.bool_))
    edges.update(0, 0, 5, 5)
    put(store, 2, 2, np.zeros((1, 1), np.bool_), np.zeros((1, 1), np.bool_))
    edges.update(2, 2, 3, 3)
    assert check(store, edges, 0, None) == 1


def test_inflation_makes_the_blocks_that_it_falls_into() -> None:
    store = empty_store()
    edges = Edges(store, 70)
    put(store, 63, 0, np.ones((1, 1), np.bool_), np.ones((1, 1), np.bool_))
    edges.update(63, 0, 64, 1)
    assert set(store.slot_of) == {(0, 0), (0, -1), (1, 0), (1, -1)}
    check(store, edges, 70, None)


def test_nothing_is_touched_outside_the_bounds() -> None:
    store = empty_store()
    edges = Edges(store, 70, (0, 0, 64, 64))
    put(store, 63, 0, np.ones((1, 1), np.bool_), np.ones((1, 1), np.bool_))
    edges.update(63, 0, 64, 1)
    assert set(store.slot_of) == {(0, 0)}


def test_other_bits_stay() -> None:
    rng = np.random.default_rng(0)
    store = empty_store()
    edges = Edges(store, 70)
    put(store, -20, -20, rng.random((100, 100)) < 0.9, rng.random((100, 100)) < 0.01, REST)
    before = {key: store.pools["flags"][slot] & REST for key, slot in store.slot_of.items()}
    edges.update(-20, -20, 80, 80)
    for key, bits in before.items():
        np.testing.assert_array_equal(store.pools["flags"][store.slot_of[key]] & REST, bits)


def test_a_copy_goes_its_own_way() -> None:
    store = empty_store()
    edges = Edges(store, 17)
    put(store, 0, 0, snake(100, 101), np.zeros((100, 101), np.bool_))
    edges.update(0, 0, 100, 101)
    other_store = store.copy()
    other = edges.copy(other_store)
    put(other_store, 50, 0, np.zeros((1, 101), np.bool_), np.zeros((1, 101), np.bool_))
    other.update(50, 0, 51, 101)
    assert check(store, edges, 17, None) == 1
    assert check(other_store, other, 17, None) > 1


def test_a_hole_takes_some_fifty_bytes() -> None:
    store = empty_store()
    edges = Edges(store, 0)
    known = np.ones((256, 256), np.bool_)
    known[4::8, 4::8] = False
    put(store, -128, -128, known, np.zeros_like(known))
    edges.update(-128, -128, 128, 128)
    assert check(store, edges, 0, None) == 1025
    assert edges.nbytes - edges._chart.nbytes < 55 * 1024


def test_cells_of_a_frontier_that_changed_are_refused() -> None:
    store = empty_store()
    edges = Edges(store, 17)
    put(store, 0, 0, np.ones((3, 3), np.bool_), np.zeros((3, 3), np.bool_))
    edges.update(0, 0, 3, 3)
    (cluster,) = edges.clusters()
    edges.update(0, 0, 3, 3)
    assert len(cluster.cells) == 8
    put(store, 0, 3, np.ones((1, 1), np.bool_), np.zeros((1, 1), np.bool_))
    edges.update(0, 3, 1, 4)
    with pytest.raises(RuntimeError, match="Read the clusters again"):
        _ = cluster.cells


def test_blocks_very_far_apart_need_no_room_between_them() -> None:
    store = empty_store()
    edges = Edges(store, 17)
    for far in (0, 10**7, -(10**8)):
        put(store, far, -far, np.ones((70, 70), np.bool_), np.zeros((70, 70), np.bool_))
        edges.update(far, -far, far + 70, 70 - far)
    found = [(cluster.first, cluster.size) for cluster in edges.clusters()]
    assert found == [((-(10**8), 10**8), 276), ((0, 0), 276), ((10**7, -(10**7)), 276)]
    assert edges.nbytes < 100_000
