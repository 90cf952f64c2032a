"""A tour over parts of what is left, and the best looks at the first of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dream.options import First
from dream.planning.parameters import check_count, check_range
from dream.planning.space.lookahead import SpacePlan
from dream.planning.space.looks import optics_of
from dream.planning.space.remains import LeftToInspect
from dream.planning.space.rivals.inspection import (
    FloatArray,
    Scene,
    rate_of,
    travel,
    views_of,
)
from dream.planning.space.ways import KnownWays
from dream.types import IntArray, Mission, Observation

if TYPE_CHECKING:
    from dream.planning.space.belief import SpaceBelief

JOINED = 1.0
"""Metres between pieces of one part."""
FACING = 0.5
"""Cosine of the angle between the normals of joined pieces, at least: a plate has two parts."""
NEAREST, FARTHEST = 1.0, 4.0
"""Metres from what is left at which viewpoints are."""
ENOUGH = 0.5
"""Share of what the best look at a part shows that another must show to be one of its viewpoints."""


@dataclass(frozen=True, slots=True)
class Fuel:
    """Order parts of what is left by a tour, and choose the looks at the first few by a shortest path.

    What it does: joins pieces that are near and face alike to parts, and splits those that are longer than
    `longest` across their longest axis. Each has several viewpoints, the looks that show most of it. An open
    travelling salesman's tour from here over the best of each gives the order; then, of the first `refined`
    parts, the looks with the fewest steps in all are chosen by a shortest path through their viewpoints,
    layer by layer. It flies to the first, and plans again at every step. A part of which no look shows
    `least` is left out. Everything else is as in `belief`.

    Reference: a re-implementation of FUEL (Zhou et al., RA-L 2021, arXiv 2010.11561) under this protocol:
    frontier parts with viewpoints, a global tour, local refinement. There parts are of frontier cells
    alone, and a trajectory of least time is flown; here surface that is still to be inspected counts as well.

    Assumes: a part shows from one look. Fails when: what is left lies in many small parts; it takes
    each for as urgent as a large one.
    """

    spatial: ClassVar[bool] = True
    planar: ClassVar[bool] = False

    longest: First[float] = 4.0
    """Metres along a part at most."""
    least: First[float] = 0.5
    """Square metres of a part that a look has to show."""
    viewpoints: First[int] = 8
    """Of a part at most."""
    refined: First[int] = 5
    """Parts of the tour whose looks are chosen together."""

    def __post_init__(self) -> None:
        check_range("longest", self.longest, 0.5, 100.0)
        check_range("least", self.least, 0.01, 100.0)
        check_count("viewpoints", self.viewpoints, 1, 1000)
        check_count("refined", self.refined, 1, 1000)

    def begin(self, mission: Mission) -> SpaceBelief:
        """A fresh pilot."""
        from dream.planning.belief import Belief

        return Belief().in_space(mission, FuelChooser(self))


@dataclass(frozen=True, slots=True, eq=False)
class PartToInspect:
    """Of what is left, as far as looks show it."""

    views: IntArray
    """(n, 5) its viewpoints, the one that shows most first."""
    gains: FloatArray
    """(n,) square metres of it that each shows."""


@dataclass(slots=True)
class FuelChooser:
    """`Fuel` during one mission."""

    planner: Fuel

    def plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """The next move, and the square metres a step that the tour yields; None without one."""
        if not len(left):
            return None
        scene = Scene(ways, left, observation)
        parts = self._viewpoints(scene)
        if not parts:
            return None
        order, costs = self._tour(scene, parts)
        first = [parts[k] for k in order[: self.planner.refined]]
        chosen = self._refined(scene, first, parts[order[len(first)]] if len(order) > len(first) else None)
        views = np.stack([one.views[k] for one, k in zip(first, chosen, strict=True)])
        gains = np.array([one.gains[k] for one, k in zip(first, chosen, strict=True)])
        between = np.diagonal(travel(views[:-1], views[1:], scene.protocol))
        path = scene.way(views[0])
        assert path, "a way leads to every viewpoint, and none is here"
        why = f"It is the first of a tour over {len(parts)} parts of what is left."
        rate = rate_of(
            np.concatenate([gains, [parts[k].gains[0] for k in order[len(first) :]]]),
            np.concatenate([scene.steps_to(views[:1]), between, costs[len(first) :]]),
        )
        return scene.plan(path[0], views[0], len(path), rate, why)

    def _viewpoints(self, scene: Scene) -> list[PartToInspect]:
        """The parts that looks show, with those looks."""
        from dream.planning._kernels.space_cover import best_of_parts, shown_from

        protocol, elements, planner = scene.protocol, scene.elements, self.planner
        nodes = scene.places(NEAREST, FARTHEST)
        if not len(nodes):
            return []
        shown = shown_from(scene.ways.scene, optics_of(protocol), scene.lattice, elements, nodes)
        allowed = scene.reached(nodes)
        here = (nodes == scene.here[:3]).all(axis=1)
        allowed[here, scene.here[3] * len(protocol.tilts) + scene.here[4]] = False
        number = parts_of(elements.points, elements.normals, planner.longest)
        gains, looks = best_of_parts(shown, elements.weights, number, int(number.max()) + 1, allowed)
        found = []
        for gain, look in zip(gains.T.round(6), looks.T, strict=True):
            enough = np.flatnonzero((gain >= planner.least) & (gain >= ENOUGH * gain.max()))
            if len(enough):
                best = enough[np.argsort(-gain[enough], kind="stable")][: planner.viewpoints]
                found.append(
                    PartToInspect(views_of(nodes[best], look[best], len(protocol.tilts)), gain[best])
                )
        return found

    def _tour(self, scene: Scene, parts: list[PartToInspect]) -> tuple[IntArray, FloatArray]:
        """The order of the parts, and the steps to each from the one before, by their best viewpoints."""
        from dream.planning._kernels.space_cover import open_tour

        views = np.stack([one.views[0] for one in parts])
        costs = np.zeros((len(views) + 1, len(views) + 1))
        costs[0, 1:] = [scene.steps_to(one.views).min() for one in parts]
        costs[1:, 1:] = travel(views, views, scene.protocol)
        order = open_tour(costs)
        return order - 1, costs[np.concatenate([[0], order[:-1]]), order]

    def _refined(self, scene: Scene, first: list[PartToInspect], then: PartToInspect | None) -> list[int]:
        """Which viewpoint of each of the first parts makes the way through them shortest."""
        between = [travel(a.views, b.views, scene.protocol) for a, b in pairwise(first)]
        if then is not None:
            between.append(travel(first[-1].views, then.views[:1], scene.protocol))
        return layered_path(scene.steps_to(first[0].views), between)[: len(first)]


def parts_of(points: FloatArray, normals: FloatArray, longest: float) -> IntArray:
    """(n,) the part of each piece: those near that face alike, split until none is longer, in metres."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    n = len(points)
    pairs = cKDTree(points).query_pairs(JOINED, output_type="ndarray")
    pairs = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1) >= FACING]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, number = connected_components(graph, directed=False)
    todo = [np.flatnonzero(number == k) for k in range(count)]
    result, found = np.empty(n, np.int64), 0
    while todo:
        part = todo.pop()
        spread = points[part] - points[part].mean(axis=0)
        axis = np.linalg.svd(spread, full_matrices=False)[2][0]
        along = spread @ axis
        if np.ptp(along) > longest:
            todo += [part[along >= 0.0], part[along < 0.0]]
        else:
            result[part] = found
            found += 1
    return result


def layered_path(first: FloatArray, between: list[FloatArray]) -> list[int]:
    """Which of each layer a shortest path leads through.

    Args:
        first: (a,) costs to those of the first layer.
        between: (a, b), (b, c), … costs from those of a layer to those of the next.
    """
    costs, before = np.asarray(first), []
    for one in between:
        through = costs[:, None] + one
        before.append(through.argmin(axis=0))
        costs = through.min(axis=0)
    path = [int(costs.argmin())]
    for layer in reversed(before):
        path.append(int(layer[path[-1]]))
    return path[::-1]
