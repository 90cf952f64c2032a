"""A cover of what is left by looks, and a tour over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dream.options import First
from dream.planning.parameters import check_range
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

BAND = 1.0
"""Metres by which a viewpoint may be nearer or farther than the viewing range."""
CHANGED = 0.5
"""Share of what a look was to show by which it must change for the tour to be made again."""


@dataclass(frozen=True, slots=True)
class CoverTour:
    """Cover what is left with looks from a viewing range, and fly a short tour over them.

    What it does: takes places on a grid of a metre whose nearest piece of what is left is about `standoff`
    away; of all looks from there always the one that adds most, until none adds `least`; orders them by an
    open travelling salesman's tour from here; flies to the first. It plans again when that look was taken,
    or would show much less or more than when it was chosen. Everything else is as in `belief`.

    Reference: a re-implementation of the inspection of GBPlanner3 in OmniPlanner (arXiv 2603.04284) under
    this protocol: viewpoints at a viewing range, greedy cover, tour. There the surface is a mesh, and the
    tour is planned once exploration is over.

    Assumes: water around structures is wide enough for the viewing range. Fails when: what is left shows
    only from nearer; then it takes places at any distance, but only if no other look is left.
    """

    spatial: ClassVar[bool] = True
    planar: ClassVar[bool] = False

    standoff: First[float] = 3.0
    """Metres from the nearest piece of what is left: the viewing range."""
    least: First[float] = 0.5
    """Square metres that a look has to add to the cover."""

    def __post_init__(self) -> None:
        check_range("standoff", self.standoff, 1.0, 20.0)
        check_range("least", self.least, 0.01, 100.0)

    def begin(self, mission: Mission) -> SpaceBelief:
        """A fresh pilot."""
        from dream.planning.belief import Belief

        return Belief().in_space(mission, CoverTourChooser(self))


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """Looks in the order in which they are to be taken."""

    views: IntArray
    """(n, 5), nodes counted from the world's origin."""
    gains: FloatArray
    """(n,) square metres that each adds."""
    steps: FloatArray
    """(n,) to each from the one before."""
    first: float
    """Square metres that the first look shows alone."""


@dataclass(slots=True)
class CoverTourChooser:
    """`CoverTour` during one mission."""

    planner: CoverTour
    tour: Tour | None = None
    """The one that it is on."""

    def plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """The next move, and the square metres a step that the tour yields; None without one."""
        if not len(left):
            self.tour = None
            return None
        scene = Scene(ways, left, observation)
        if self.tour is not None and not self._holds(self.tour, scene):
            self.tour = None
        for _ in range(2):
            tour = self.tour = self.tour or self._tour(scene)
            if tour is None:
                return None
            view = scene.relative(tour.views[:1])[0]
            path = scene.way(view)
            if path:
                steps = np.concatenate([[len(path)], tour.steps[1:]])
                why = f"It is the first of a tour over {len(tour.views)} looks that cover what is left."
                return scene.plan(path[0], view, len(path), rate_of(tour.gains, steps), why)
            # It is there, or the way is closed.
            self.tour = None
        return None

    def _holds(self, tour: Tour, scene: Scene) -> bool:
        """Is the first look still to be taken, and does it show about as much?"""
        view = scene.relative(tour.views[:1])[0]
        is_known = ((view[:3] >= 0) & (view[:3] < scene.ways.shape)).all()
        if not is_known or np.array_equal(view, scene.here):
            return False
        return abs(scene.shown_by(view) - tour.first) <= CHANGED * tour.first

    def _tour(self, scene: Scene) -> Tour | None:
        from dream.planning._kernels.space_cover import greedy_cover, open_tour, shown_from

        planner, protocol = self.planner, scene.protocol
        for nearest, farthest in (
            (planner.standoff - BAND, planner.standoff + BAND),
            (0.0, protocol.reach),
        ):
            nodes = scene.places(nearest, farthest)
            shown = shown_from(scene.ways.scene, optics_of(protocol), scene.lattice, scene.elements, nodes)
            allowed = scene.reached(nodes)
            here = (nodes == scene.here[:3]).all(axis=1)
            allowed[here, scene.here[3] * len(protocol.tilts) + scene.here[4]] = False
            looks, gains = greedy_cover(shown, scene.elements.weights, allowed, planner.least)
            if len(looks):
                break
        else:
            return None
        views = views_of(nodes[looks[:, 0]], looks[:, 1], len(protocol.tilts))
        costs = np.zeros((len(views) + 1, len(views) + 1))
        costs[0, 1:] = scene.steps_to(views)
        costs[1:, 1:] = travel(views, views, protocol)
        order = open_tour(costs)
        steps = costs[np.concatenate([[0], order[:-1]]), order]
        views, gains = views[order - 1], gains[order - 1]
        return Tour(scene.absolute(views), gains, steps, scene.shown_by(views[0]))
