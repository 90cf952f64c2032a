"""Which cells could be seen from where the vehicle can get to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2
from dream.lattice import nodes_in
from dream.mapping.lattice import grid_of, node_of, reached
from dream.mapping.nearness import within
from dream.mapping.visibility import FRACTIONS, ray_table
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping._kernels.sightlines import Nodes
    from dream.mapping.occupancy import OccupancyMap

UNASKED, HIDDEN, SEEN = 0, 1, 2
"""What is known of whether a cell could be seen."""


def seeable(occupancy: OccupancyMap, pose: SE2, cells: IntArray) -> BoolArray:
    """(n,) whether an observation from some reachable position would explore each of the cells (n, 2).

    With the lattice heading that suits the cell best (Eq. 7). Asked are the nearest position, and all to
    whose cells rays lead from the middle of this one: what shows only in a sliver may be missed, but nothing
    is found that no view explores. Each cell is looked at once until the map changes.
    """
    from dream.mapping._kernels import sightlines as kernels

    node = node_of(pose, occupancy.protocol)
    answers = occupancy.answer(("seeable", node), lambda: np.full(occupancy.shape, UNASKED, np.uint8))
    asked = cells[answers[tuple(cells.T)] == UNASKED]
    if len(asked):
        protocol = occupancy.protocol
        reach = protocol.reach / protocol.cell
        nodes, near = occupancy.answer(("nodes by cell", node), lambda: _nodes_by_cell(occupancy, pose))
        answers[tuple(asked.T)] = HIDDEN
        asked = asked[near[tuple(asked.T)]]
        sensor = kernels.Sensor(
            reach,
            protocol.blind / protocol.cell,
            0.5 * protocol.camera.horizontal_fov,
            protocol.heading_step,
        )
        rays = ray_table(reach + 1.0, FRACTIONS // 2, FRACTIONS // 2)
        found = kernels.seeable(occupancy.solid, asked, nodes, sensor, rays)
        answers[tuple(asked[found].T)] = SEEN
    seen: BoolArray = answers[tuple(cells.T)] == SEEN
    return seen


def _nodes_by_cell(occupancy: OccupancyMap, pose: SE2) -> tuple[Nodes, BoolArray]:
    """The reachable positions, and (rows, cols) the cells that some of them is near enough to see."""
    from dream.mapping._kernels import sightlines as kernels

    first, _ = nodes_in(occupancy.bounds, occupancy.protocol)
    nodes: Nodes = kernels.nodes_by_cell(
        reached(occupancy, pose), first, grid_of(occupancy), occupancy.low, occupancy.shape
    )
    protocol = occupancy.protocol
    # From the middle of one cell to that of another: a position may be half a cell's diagonal beside it.
    return nodes, within(nodes.at >= 0, protocol.reach + protocol.cell, protocol.cell)
