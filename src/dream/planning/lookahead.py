"""The way to go: a search over the real actions, and a tour over what is left after them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.planning.pose_views import Listed, PoseViews
from dream.planning.travel import Travel, traced
from dream.planning.viewpoints import Viewpoints
from dream.types import BoolArray, Float32Array, IntArray

if TYPE_CHECKING:
    from dream.planning._kernels.views import Views

SERVICE = 0.63
"""Share of what its view could hold, of ground and of hiding places together, that a step shows on its way
through unseen ground."""
NEAR = 16
"""Steps within which every second node is a view to go to; every fourth beyond."""
NOT_ROUNDED = -1
"""Decimals of the scores of sequences: what they show is compared to the last digit."""
NOTHING = 1e-6
"""Square metres of targets a step from which on it is not worth going."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Between the best sequence of actions and the way straight to the best single view.

    Weights are square metres of targets, some of which count more than once.
    """

    jump: float
    """Share of the view's rate that the sequence must reach."""
    sequences: int
    """Among which the best was chosen."""
    shown: float = 0.0
    """Weight that the best of them shows, the later the less."""
    after: float = 0.0
    """What the tour after it counts, the later the less."""
    rate: float = 0.0
    """Weight that its best stretch shows a step, the discount taken out; 0 where it shows nothing."""
    view: float = 0.0
    """Weight that the best single view shows for each step there; 0 where none shows anything."""

    @property
    def straight(self) -> bool:
        """The view is gone for."""
        return self.view > 0.0 and (self.rate == 0.0 or self.rate < self.jump * self.view)


@dataclass(frozen=True, slots=True)
class Plan:
    """Where to go, and what that is expected to show."""

    path: list[Pose]
    """The poses, the present one first; at least two."""
    rate: float
    """Weight that a step shows up to where the path shows most a step, the discount taken out."""
    later: float
    """Steps that what is left would take after it, about; 0 where nobody asked."""
    targets: float = 0.0
    """Square metres of targets beside known ones."""
    cleared: float = 0.0
    """Square metres on which the middle of a group could lie."""
    patches: float = 0.0
    """Further elements, by what is expected in each."""
    passed: int = 0
    """Target cells that it traverses, where it is a walk for that."""
    cells: float = 0.0
    """Cells that only the map's own view of a pose still promises."""
    choice: Choice | None = None
    """Why this way, where there was one to choose."""


@dataclass(frozen=True, slots=True)
class Judged:
    """A way, and what it is worth."""

    plan: Plan
    value: float
    """In steps: what would be lost by doing the best of them that much later. Only differences count."""


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """What is worth looking at, and what can be seen of it from where."""

    pose_views: PoseViews
    ground: Float32Array
    """(tiles,) weight of seeing it."""
    hiding: Float32Array
    """(tiles,) weight of knowing that no group has its middle there."""
    targets: Float32Array
    """(tiles,) square metres of targets to be expected."""
    hidden: Float32Array
    """(tiles,) square metres on which the middle of a group could lie."""
    listed: Listed | None = None

    @property
    def weights(self) -> Float32Array:
        """(elements,) of the ground, of the hiding places and of what is listed."""
        parts = [self.ground, self.hiding]
        if self.listed is not None:
            parts.append(np.asarray(self.listed.weights, np.float32))
        return np.concatenate(parts)

    def plan(self, path: list[Pose], rate: float, later: float, shown: BoolArray) -> Plan:
        """A plan by which elements it shows."""
        tiles, patches = self.pose_views.tiles, 0.0
        if self.listed is not None:
            patches = float(
                self.listed.expected[shown[2 * tiles : 2 * tiles + len(self.listed.expected)]].sum()
            )
        targets = float(self.targets[shown[:tiles]].sum())
        return Plan(path, rate, later, targets, float(self.hidden[shown[tiles : 2 * tiles]].sum()), patches)


def elements_of(bits: npt.NDArray[np.uint64]) -> BoolArray:
    """(64 · words,) which elements have their bits set; see `_kernels.views.look`."""
    return np.unpackbits(bits.view(np.uint8), bitorder="little").astype(np.bool_)


@dataclass(frozen=True, slots=True)
class LookAhead:
    """A beam search over the real actions, whose ends are judged by a tour over what they leave.

    What it does: keeps the sequences that show most, sooner rather than later; of those of the last level it
    takes the one whose gain, with that of a greedy tour over the remaining areas, is greatest. Where another
    view far off gains much more a step than the sequence, it goes there.

    Reference: beam search; the tour is a heuristic for orienteering with rewards that fade.
    """

    width: int
    """Sequences kept at each level."""
    horizon: int
    """Actions of a sequence."""
    discount: float
    """What a gain is worth a step later."""
    tour: float
    """What the tour counts beside the sequence's own gain."""
    keep: float
    """Share of it that a tour may leave."""
    jump: float
    """Share of the best rate of going straight to one view below which the sequence is given up for that."""

    def plan(
        self, prospect: Prospect, travel: Travel, moves: npt.NDArray[np.uint8], known: BoolArray
    ) -> Plan | None:
        """The best way; None where nothing is in sight.

        Args:
            prospect: What is worth looking at.
            travel: Ways over known free ground.
            moves: See `PoseViews.moves`.
            known: (tiles,) where ground is known.
        """
        # Kernels add them up as float64: as such they are given, so that one compiled form serves all.
        weights = prospect.weights.astype(np.float64)
        views = prospect.pose_views.views(prospect.listed)
        sequence, choice = self._sequence(prospect, weights, views, travel, moves, known)
        view = best_view(prospect, weights, views, travel)
        if view is not None:
            choice = replace(choice, view=view.rate)
        plan = view if choice.straight else sequence
        return None if plan is None else replace(plan, choice=choice)

    def _sequence(
        self,
        prospect: Prospect,
        weights: npt.NDArray[np.float64],
        views: Views,
        travel: Travel,
        moves: npt.NDArray[np.uint8],
        known: BoolArray,
    ) -> tuple[Plan | None, Choice]:
        """The best sequence, None where none shows anything; and the choice, still without the view."""
        from dream.planning._kernels.beam import BeamScore, beam

        none, nowhere = np.zeros(0, np.int64), np.zeros((0, travel.lattice.nodes), np.uint8)
        score = BeamScore(self.discount, NOT_ROUNDED, -np.inf, 0.0, 0.0, none, none, nowhere)
        found = beam(
            weights, views, travel.lattice.graph, moves, travel.start, known, score, self.width, self.horizon
        )
        nothing = Choice(self.jump, len(found.score) - found.first)
        if found.score.max() <= NOTHING:
            return None, nothing
        ends = slice(found.first, None)
        worth, steps = self._later(
            prospect, views, travel, found.seen[ends], found.pose[ends], found.level[ends]
        )
        value = found.score[ends] + self.tour * worth
        # Rounded, so that the last digits decide nothing.
        best = int(value.round(6).argmax())
        end = found.first + best
        indices = traced(found.parent, end)
        # The rate up to where it is best: a view is compared with what the sequence shows on the way there.
        weight_of_steps = np.cumsum(self.discount ** np.arange(1, len(indices)))
        rate = float((found.score[indices[1:]] / weight_of_steps).max())
        if rate <= NOTHING:
            return None, nothing
        path = found.pose[indices].tolist()
        shown = float(found.score[end])
        choice = replace(nothing, shown=shown, after=float(value[best]) - shown, rate=rate)
        return prospect.plan(path, rate, float(steps[best]), elements_of(found.seen[end])), choice

    def _later(
        self,
        prospect: Prospect,
        views: Views,
        travel: Travel,
        seen: npt.NDArray[np.uint64],
        pose: npt.NDArray[np.int32],
        level: npt.NDArray[np.int32],
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """What a tour after each sequence is worth, and its steps."""
        from dream.planning._kernels.tour import tours

        protocol, lattice, weights = travel.protocol, travel.lattice, prospect.weights
        worth, steps = tours(
            weights,
            seen,
            lattice.graph.place[lattice.node_of(pose)] * lattice.spacing,
            *prospect.pose_views.places(prospect.listed),
            prospect.pose_views.areas,
            SERVICE * views.first[1],
            max(protocol.advances),
            0.5 * protocol.reach,
            self.discount,
            self.keep * float(weights.sum()),
        )
        return self.discount**level * worth, steps

    def judge(self, prospect: Prospect, travel: Travel, paths: list[list[Pose]]) -> list[Judged]:
        """What given ways are worth, all by the measure by which a plan is chosen.

        Args:
            prospect: What is worth looking at.
            travel: The poses of the ways are on its lattice.
            paths: At least one; the present pose first.
        """
        from dream.planning._kernels.views import gain, look

        weights = prospect.weights.astype(np.float64)
        views = prospect.pose_views.views(prospect.listed)
        seen = np.zeros((len(paths), (len(weights) + 63) // 64), np.uint64)
        score = np.zeros(len(paths))
        for k, path in enumerate(paths):
            for step, pose in enumerate(path[1:], start=1):
                score[k] += self.discount**step * gain(weights, seen[k], views, pose)
                look(weights, seen[k], views, pose)
        ends = np.array([path[-1] for path in paths], np.int32)
        level = np.array([len(path) - 1 for path in paths], np.int32)
        worth, steps = self._later(prospect, views, travel, seen, ends, level)
        # What all loses by coming a step later.
        step = (1.0 - self.discount) * (score[0] + worth[0])
        value = (score + self.tour * worth) / max(step, NOTHING)
        rates = score / np.maximum(level, 1)
        return [
            Judged(prospect.plan(path, float(rate), float(later), elements_of(bits)), float(v))
            for path, rate, later, bits, v in zip(paths, rates, steps, seen, value, strict=True)
        ]

    def viewpoints(self, prospect: Prospect, travel: Travel) -> Viewpoints:
        """What single poses within reach would show: every second node near by, every fourth beyond."""
        from dream.planning._kernels.views import gains

        weights = prospect.weights.astype(np.float64)
        views = prospect.pose_views.views(prospect.listed)
        nodes = _spread(travel)
        return Viewpoints(travel.lattice, nodes, travel.steps_to(nodes), gains(weights, views, nodes))


def best_view(
    prospect: Prospect, weights: npt.NDArray[np.float64], views: Views, travel: Travel
) -> Plan | None:
    """The way to the view of the best rate of all that ways lead to; None where none shows anything.

    Args:
        prospect: What is worth looking at.
        weights: (elements,) of it.
        views: What each pose shows.
        travel: Ways over known free ground.
    """
    from dream.planning._kernels.views import best_gains, look

    nodes = _spread(travel)
    if not len(nodes):
        return None
    steps = travel.steps_to(nodes)
    viewpoints = Viewpoints(travel.lattice, nodes, steps, best_gains(weights, views, nodes, steps))
    best = viewpoints.best(viewpoints.rates)
    if best is None or best.rate <= NOTHING:
        return None
    seen = np.zeros((len(weights) + 63) // 64, np.uint64)
    look(weights, seen, views, best.pose)
    return prospect.plan(travel.path(best.pose), best.rate, 0.0, elements_of(seen))


def _spread(travel: Travel) -> IntArray:
    """(n,) nodes that can be reached: every second one near by, and every fourth beyond."""
    lattice, near = travel.lattice, travel.nearest <= NEAR
    return np.flatnonzero(travel.reached & (lattice.every(2) & near | lattice.every(4)))
