"""Tours over the real actions, round all that is left of something: what coverage and traversal share."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.planning.travel import Travel, traced
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.planning._kernels.views import Views

FloatArray = npt.NDArray[np.floating[Any]]

DECIMALS = 6
"""To which what sequences leave is rounded where they are compared."""
WIDTH = 48
"""Sequences of actions that a search keeps."""


@dataclass(frozen=True, slots=True)
class Search:
    """How a tour is searched for."""

    side: int
    """Of a part of what is left, in cells of `Left`."""
    near: float
    """Lattice steps from which most of a part is shown."""
    step: float
    """Weight that a move counts as much as."""
    horizon: int
    """Moves at most."""
    leave: float
    """Weight that may be left."""
    slight: float = 0.0
    """Weight that a part may hold and is not worth a way of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """What is left to be shown, and which poses show it; `of` makes it."""

    weights: FloatArray
    """(n,) of the elements."""
    cells: IntArray
    """(n, 2) where they lie, on a grid by whose squares they make parts."""
    spots: FloatArray
    """(n, 2) lattice steps east and north of node 0, of their middles."""
    views: Views
    """Of these elements alone."""
    travel: Travel
    moves: npt.NDArray[np.uint8]
    """See `PoseViews.moves`; the first one must be known to be free."""
    reached: BoolArray
    """(nodes,) to which such moves lead."""

    @staticmethod
    def of(
        weights: FloatArray,
        index: IntArray,
        cells: IntArray,
        spots: FloatArray,
        views: Views,
        travel: Travel,
        moves: npt.NDArray[np.uint8],
        reached: BoolArray,
    ) -> Left:
        """Of some elements, (n,) of those that weights and views are of."""
        from dream.planning._kernels.views import listed_only

        starts, elements = listed_only(index, views)
        nodes = np.arange(travel.lattice.nodes)
        # All tiles are known, so that one stands for all.
        views = views._replace(
            first=np.zeros_like(views.first),
            tile=np.zeros_like(views.tile),
            listed=nodes,
            listed_first=starts,
            listed_element=elements,
        )
        return Left(weights[index], cells, spots, views, travel, moves, reached)

    def search(self, how: Search) -> tuple[list[Pose], float]:
        """The tour that leaves least, the present pose first, and the weight that it leaves."""
        from dream.planning._kernels.beam import BeamScore, beam
        from dream.planning._kernels.search import ways_to

        lattice = self.travel.lattice
        _, part_of = np.unique(self.cells // how.side, axis=0, return_inverse=True)
        part_of = part_of.ravel()
        ways = ways_to(
            part_of, int(part_of.max()) + 1, self.spots, lattice.graph, self.moves, self.reached, how.near
        )
        index, known = np.arange(len(self.weights)), np.ones(1, np.bool_)
        score = BeamScore(1.0, DECIMALS, how.leave, how.slight, how.step, index, part_of, ways)
        found = beam(
            self.weights,
            self.views,
            lattice.graph,
            self.moves,
            self.travel.start,
            known,
            score,
            WIDTH,
            how.horizon,
        )
        path = found.pose[traced(found.parent, found.best)].tolist()
        return path, -float(found.score[found.best])

    def follow(self, path: list[Pose], leave: float) -> tuple[int, BoolArray, float]:
        """See `_kernels.views.follow`; what is shown is (n,)."""
        from dream.planning._kernels.views import follow
        from dream.planning.lookahead import elements_of

        steps, seen, left = follow(self.weights, self.views, np.array(path), leave)
        return steps, elements_of(seen)[: len(self.weights)], left


def reached_by(travel: Travel, moves: npt.NDArray[np.uint8]) -> BoolArray:
    """(nodes,) to which moves (poses, advances) lead, those over unknown ground too."""
    from dream.planning._kernels.search import search

    return np.asarray(search(travel.lattice.graph, moves, travel.start)[2] >= 0)


def rest_of(path: list[Pose], travel: Travel, moves: npt.NDArray[np.uint8]) -> list[Pose]:
    """What of a way is still to go, one step on; empty where the vehicle is not on it, or it is blocked."""
    from dream.planning._kernels.moves import FREE

    if len(path) < 2 or path[1] != travel.start:
        return []
    rest, lattice = path[1:], travel.lattice
    for step, (before, after) in enumerate(pairwise(rest)):
        advance = lattice.advance_to(before, after)
        kind = FREE if advance is None else moves[lattice.turned_to(before, after), advance]
        if kind == 0 or (kind != FREE and step == 0):
            return []
    return rest
