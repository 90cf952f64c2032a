"""Where on the lattice the vehicle can get to."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.lattice import nodes_in, offsets_of
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap

Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]


def reachable(occupancy: OccupancyMap, pose: SE2) -> Float64Array:
    """The lattice positions to which the protocol's moves lead from a pose over standable ground.

    Args:
        occupancy: What is known; `passable` decides about each move.
        pose: Where the vehicle is, snapped to the lattice.

    Returns:
        (P, 2) metres in the world by row, then column, the snapped position among them; empty where that is
        out of bounds.
    """
    first, _ = nodes_in(occupancy.bounds, occupancy.protocol)
    nodes = np.add(np.argwhere(reached(occupancy, pose)), first)
    positions: Float64Array = np.multiply(nodes[:, ::-1], occupancy.protocol.lattice)
    return positions


def free_moves(occupancy: OccupancyMap) -> UInt8Array:
    """Which of the protocol's advances are `passable` from the nodes in the bounds; see `nodes_in`.

    Returns:
        (rows, cols, headings, advances) 1 or 0; 0 from nodes where the vehicle cannot stand.
    """
    free: UInt8Array = _free(occupancy)[:, :, moves_of(occupancy.protocol)[1]]
    return free


def node_of(pose: SE2, protocol: SurveyProtocol) -> tuple[int, int]:
    """Row and column of the node that is nearest to a pose."""
    return round(pose.y / protocol.lattice), round(pose.x / protocol.lattice)


@lru_cache(maxsize=8)
def moves_of(protocol: SurveyProtocol) -> tuple[IntArray, IntArray]:
    """The moves of all headings and advances, each once.

    Returns:
        (n, 2) lattice steps east and north, none at all among them; (headings, advances) which of them it is.
    """
    offsets = [[tuple(offset) for offset in row] for row in offsets_of(protocol).tolist()]
    moves = sorted({(0, 0)}.union(*offsets))
    return np.array(moves, np.int64), np.array([[moves.index(o) for o in row] for row in offsets], np.int64)


def grid_of(occupancy: OccupancyMap) -> tuple[float, float, float, float]:
    """Metres between nodes, metres of a cell, and world y and x of the corner of the store's cell (0, 0)."""
    west, south = occupancy.origin
    return occupancy.protocol.lattice, occupancy.protocol.cell, south, west


def _free(occupancy: OccupancyMap) -> UInt8Array:
    """(rows, cols, moves) 1 where a move is free from a node in the bounds at which the vehicle can stand."""
    from dream.mapping._kernels import lattice as kernels

    def find() -> UInt8Array:
        (row, col), (rows, cols) = nodes_in(occupancy.bounds, occupancy.protocol)
        moves, _ = moves_of(occupancy.protocol)
        free: UInt8Array = kernels.free_moves(
            occupancy.room,
            occupancy.low,
            occupancy.needed_room,
            grid_of(occupancy),
            (row, col, row + rows, col + cols),
            moves,
        )
        return free

    return occupancy.answer("free moves", find)


def reached(occupancy: OccupancyMap, pose: SE2) -> BoolArray:
    """(rows, cols) of the nodes in the bounds: those to which moves lead from the node nearest to a pose."""
    from dream.mapping._kernels import lattice as kernels

    start = node_of(pose, occupancy.protocol)

    def find() -> BoolArray:
        (row, col), (rows, cols) = nodes_in(occupancy.bounds, occupancy.protocol)
        if not (0 <= start[0] - row < rows and 0 <= start[1] - col < cols):
            return np.zeros((rows, cols), np.bool_)
        found: BoolArray = kernels.reach(
            _free(occupancy),
            occupancy.room,
            occupancy.low,
            occupancy.needed_room,
            grid_of(occupancy),
            (row, col),
            start,
            moves_of(occupancy.protocol)[0],
        )
        return found

    return occupancy.answer(("reached", start), find)
