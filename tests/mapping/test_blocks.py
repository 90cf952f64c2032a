"""The block store, against one dense array."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.mapping.blocks import BlockStore

SHAPES = {"flat": (64, 64), "solid": (8, 8, 8), "line": (5,)}
EDGE = 150
"""The dense array covers cells from −EDGE to EDGE along each axis, or less in three dimensions."""


def store_of(shape: tuple[int, ...]) -> BlockStore:
    return BlockStore({"a": (np.int8, shape), "b": (np.float32, shape)})


def random_box(rng: np.random.Generator, axes: int, edge: int) -> tuple[list[int], list[int]]:
    low = [int(n) for n in rng.integers(-edge, edge, axes)]
    return low, [int(rng.integers(1, edge - first + 1)) for first in low]


def cut(dense: npt.NDArray[Any], low: list[int], shape: list[int], edge: int) -> npt.NDArray[Any]:
    return dense[tuple(slice(a + edge, a + edge + n) for a, n in zip(low, shape, strict=True))]


@pytest.mark.parametrize("kind", SHAPES)
@given(seed=st.integers(0, 2**31))
def test_what_is_written_is_read_at_any_sign_and_across_any_border(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    side = SHAPES[kind]
    edge = EDGE if len(side) < 3 else 20
    store = store_of(side)
    dense = {name: np.zeros([2 * edge] * len(side), store.layers[name][0]) for name in ("a", "b")}
    for _ in range(4):
        name = str(rng.choice(["a", "b"]))
        low, shape = random_box(rng, len(side), edge)
        cells = rng.integers(-100, 100, shape) * (rng.random(shape) < rng.choice([0.0, 0.001, 0.5]))
        cut(dense[name], low, shape, edge)[...] = cells
        for key in store.write(name, low, cells):
            for i, n, first, count in zip(key, side, low, shape, strict=True):
                assert i * n < first + count
                assert (i + 1) * n > first
            assert key in store.slot_of
        for read in ("a", "b"):
            low, shape = random_box(rng, len(side), edge)
            np.testing.assert_array_equal(store.read(read, low, shape), cut(dense[read], low, shape, edge))
    # And nothing anywhere else: as much as was written is in the pools, each cell once.
    for name in ("a", "b"):
        assert np.count_nonzero(store.pools[name]) == np.count_nonzero(dense[name])
        assert not store.pools[name][0].any(), "the block of nothing"


@given(seed=st.integers(0, 2**31))
def test_only_blocks_with_something_in_them_take_memory(seed: int) -> None:
    rng = np.random.default_rng(seed)
    store = store_of((8, 8, 8))
    empty = store.nbytes
    assert store.write("a", [-40, -40, -40], np.zeros((80, 80, 80))) == []
    assert (len(store), store.nbytes) == (0, empty)
    places = rng.integers(-40, 40, (10, 3))
    for place in places:
        store.write("a", place.tolist(), np.ones((1, 1, 1)))
    assert set(store.slot_of) == {(int(i), int(j), int(k)) for i, j, k in places // 8}
    assert store.nbytes - empty == len(store) * 8**3 * 5
    # Zeros over what is there are written, and make nothing.
    blocks = len(store)
    assert len(store.write("a", [-40, -40, -40], np.zeros((80, 80, 80)))) == len(store) == blocks
    assert not store.pools["a"].any()


def test_slots_stay_as_the_store_grows() -> None:
    store = store_of((8, 8, 8))
    keys = [(i, -i, 3 * i) for i in range(-50, 50)]
    for number, key in enumerate(keys):
        store.make([key, key] if number % 2 else [key])
        store.pools["a"][store.slot_of[key]] = number
        store.pools["b"][store.slot_of[key]] = -number
        store.stamps[store.slot_of[key]] = 1000 + number
    slots = [store.slot_of[key] for key in keys]
    assert slots == list(range(1, 101))
    store.make(keys)
    assert [store.slot_of[key] for key in keys] == slots
    for number, key in enumerate(keys):
        slot = store.slot_of[key]
        assert (store.pools["a"][slot] == number).all()
        assert (store.pools["b"][slot] == -number).all()
        assert store.stamps[slot] == 1000 + number
    assert all(len(pool) == len(store.stamps) >= 101 for pool in store.pools.values())
    assert not any(pool[101:].any() for pool in store.pools.values())
    assert not store.stamps[0]


def test_many_blocks_made_at_once_are_those_made_one_by_one() -> None:
    once, one_by_one = store_of((5,)), store_of((5,))
    keys = [(i,) for i in range(-500, 500)]
    once.make(keys)
    for key in keys:
        one_by_one.make([key])
    assert once.slot_of == one_by_one.slot_of
    assert len(once.stamps) == len(one_by_one.stamps)


@given(
    low=st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    shape=st.tuples(st.integers(0, 9), st.integers(0, 9)),
)
def test_a_table_gives_the_slot_of_every_block_and_none_where_there_is_none(
    low: tuple[int, int], shape: tuple[int, int]
) -> None:
    store = store_of((64, 64))
    store.make((i, j) for i in range(-5, 6, 2) for j in range(-6, 5, 3))
    table = store.table(low, shape)
    assert table.shape == shape
    for i, j in np.ndindex(shape):
        assert table[i, j] == store.slot_of.get((low[0] + i, low[1] + j), 0)
    assert not (table == 0).all() or not any(
        low[0] <= i < low[0] + shape[0] and low[1] <= j < low[1] + shape[1] for i, j in store.slot_of
    )


def test_layers_may_have_blocks_of_different_sizes() -> None:
    store = BlockStore({"fine": (np.uint8, (64, 64)), "coarse": (np.float32, (16, 16))})
    store.write("coarse", (-1, 15), np.array([[2.5, 0.0], [0.0, 3.5]]))
    assert set(store.slot_of) == {(-1, 0), (0, 1)}
    store.write("fine", (-1, 63), np.array([[7, 0], [0, 8]]))
    assert set(store.slot_of) == {(-1, 0), (0, 1)}
    np.testing.assert_array_equal(store.read("coarse", (-1, 15), (2, 2)), [[2.5, 0.0], [0.0, 3.5]])
    np.testing.assert_array_equal(store.read("fine", (-1, 63), (2, 2)), [[7, 0], [0, 8]])


def test_what_is_read_is_a_copy_and_may_be_empty_or_huge() -> None:
    store = store_of((64, 64))
    store.write("a", (-10, -10), np.full((20, 20), 5))
    read = store.read("a", (-10, -10), (20, 20))
    read[:] = 9
    assert (store.read("a", (-10, -10), (20, 20)) == 5).all()
    assert store.read("a", (3, 3), (0, 7)).shape == (0, 7)
    # More blocks than there are: those that there are, are looked through.
    wide = store.read("a", (-3000, -2000), (6000, 4000))
    assert np.argwhere(wide).min(axis=0).tolist() == [2990, 1990]
    assert int(wide.sum(dtype=np.int64)) == 5 * 400


def test_blocks_very_far_apart_take_no_more_memory() -> None:
    store = store_of((64, 64))
    far = 1 << 40
    for row, col in ((0, 0), (far, -far), (-far, far)):
        store.write("a", (row, col), np.ones((1, 1)))
        assert store.read("a", (row - 1, col - 1), (3, 3)).sum() == 1
    assert len(store) == 3
    assert store.nbytes == 4 * math.prod((64, 64, 5))


def test_a_copy_is_equal_and_goes_its_own_way() -> None:
    store = store_of((8, 8, 8))
    cells = np.arange(20 * 20 * 20).reshape(20, 20, 20) % 100
    store.write("a", (-10, -10, -10), cells)
    store.stamps[1 : 1 + len(store)] = 7
    other = store.copy()
    assert other.slot_of == store.slot_of
    np.testing.assert_array_equal(other.stamps[: 1 + len(store)], store.stamps[: 1 + len(store)])
    store.write("a", (0, 0, 0), np.full((2, 2, 2), -1))
    store.make([(99, 99, 99)])
    other.write("b", (50, 50, 50), np.ones((1, 1, 1)))
    np.testing.assert_array_equal(other.read("a", (-10, -10, -10), (20, 20, 20)), cells)
    assert (99, 99, 99) not in other.slot_of
    assert (6, 6, 6) not in store.slot_of
    assert not store.read("b", (50, 50, 50), (1, 1, 1)).any()
