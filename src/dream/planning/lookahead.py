"""The way to go: a search over the real actions, and a tour over what is left after them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.mapping.lattice import offsets_of
from dream.planning.outlook import Listed, Outlook
from dream.planning.travel import IntArray, Pose, Travel
from dream.planning.views import Views as PoseViews
from dream.types import BoolArray, Float32Array

if TYPE_CHECKING:
    from dream.planning._kernels.lookahead import Views

SERVICE = 0.63
"""Share of what its view could hold, of ground and of hiding places together, that a step shows on its way
through unseen ground."""
NEAR = 16
"""Steps within which every second node is a view to go to; every fourth beyond."""
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

    outlook: Outlook
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

    def plan(self, path: list[Pose], rate: float, later: float, seen: npt.NDArray[np.uint64]) -> Plan:
        """A plan by the bits of what it shows; see `_kernels.lookahead.look`."""
        shown = np.unpackbits(seen.view(np.uint8), bitorder="little").astype(np.bool_)
        tiles, patches = self.outlook.tiles, 0.0
        if self.listed is not None:
            patches = float(
                self.listed.expected[shown[2 * tiles : 2 * tiles + len(self.listed.expected)]].sum()
            )
        targets = float(self.targets[shown[:tiles]].sum())
        return Plan(path, rate, later, targets, float(self.hidden[shown[tiles : 2 * tiles]].sum()), patches)


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
            moves: See `Outlook.moves`.
            known: (tiles,) where ground is known.
        """
        weights, views = prospect.weights, prospect.outlook.views(prospect.listed)
        sequence, choice = self._sequence(prospect, weights, views, travel, moves, known)
        view = self._view(prospect, weights, views, travel)
        if view is not None:
            choice = replace(choice, view=view.rate)
        plan = view if choice.straight else sequence
        return None if plan is None else replace(plan, choice=choice)

    def _sequence(
        self,
        prospect: Prospect,
        weights: Float32Array,
        views: Views,
        travel: Travel,
        moves: npt.NDArray[np.uint8],
        known: BoolArray,
    ) -> tuple[Plan | None, Choice]:
        """The best sequence, None where none shows anything; and the choice, still without the view."""
        from dream.planning._kernels import lookahead

        protocol = travel.protocol
        pose, parent, score, level, seen, first = lookahead.beam(
            weights,
            views,
            moves,
            offsets_of(protocol),
            np.array(protocol.turns, np.int64),
            travel.start,
            known,
            self.width,
            self.horizon,
            self.discount,
        )
        nothing = Choice(self.jump, len(score) - first)
        if score.max() <= NOTHING:
            return None, nothing
        ends = slice(first, None)
        worth, steps = self._later(prospect, weights, views, travel, seen[ends], pose[ends], level[ends])
        value = score[ends] + self.tour * worth
        # Rounded, so that the last digits decide nothing.
        end = first + int(value.round(6).argmax())
        indices = [end]
        while parent[indices[-1]] >= 0:
            indices.append(int(parent[indices[-1]]))
        indices.reverse()
        # The rate up to where it is best: a view is compared with what the sequence shows on the way there.
        weight_of_steps = np.cumsum(self.discount ** np.arange(1, len(indices)))
        rate = float((score[indices[1:]] / weight_of_steps).max())
        if rate <= NOTHING:
            return None, nothing
        path = [travel.pose(int(pose[k])) for k in indices]
        choice = replace(
            nothing, shown=float(score[end]), after=float(value[end - first] - score[end]), rate=rate
        )
        return prospect.plan(path, rate, float(steps[end - first]), seen[end]), choice

    def _later(
        self,
        prospect: Prospect,
        weights: Float32Array,
        views: Views,
        travel: Travel,
        seen: npt.NDArray[np.uint64],
        pose: npt.NDArray[np.int32],
        level: npt.NDArray[np.int32],
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """What a tour after each sequence is worth, and its steps."""
        from dream.planning._kernels import lookahead

        protocol = travel.protocol
        worth, steps = lookahead.tours(
            weights,
            views,
            seen,
            pose,
            *prospect.outlook.places(prospect.listed),
            prospect.outlook.areas,
            protocol.lattice,
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
        from dream.planning._kernels import lookahead

        weights, views = prospect.weights, prospect.outlook.views(prospect.listed)
        seen = np.zeros((len(paths), (len(weights) + 63) // 64), np.uint64)
        score = np.zeros(len(paths))
        for k, path in enumerate(paths):
            for step, pose in enumerate(path[1:], start=1):
                score[k] += self.discount**step * lookahead.gain(weights, seen[k], views, *pose)
                lookahead.look(weights, seen[k], views, *pose)
        ends = np.array([np.ravel_multi_index(path[-1], travel.steps.shape) for path in paths], np.int32)
        level = np.array([len(path) - 1 for path in paths], np.int32)
        worth, steps = self._later(prospect, weights, views, travel, seen, ends, level)
        # What all loses by coming a step later.
        step = (1.0 - self.discount) * (score[0] + worth[0])
        value = (score + self.tour * worth) / max(step, NOTHING)
        rates = score / np.maximum(level, 1)
        return [
            Judged(prospect.plan(path, float(rate), float(later), bits), float(v))
            for path, rate, later, bits, v in zip(paths, rates, steps, seen, value, strict=True)
        ]

    def views(self, prospect: Prospect, travel: Travel) -> PoseViews:
        """What single poses within reach would show: every second node near by, every fourth beyond."""
        from dream.planning._kernels import lookahead

        weights, views = prospect.weights, prospect.outlook.views(prospect.listed)
        rows, cols, steps = _viewpoints(travel)
        return PoseViews(rows, cols, steps, lookahead.gains(weights, views, rows, cols))

    def _view(self, prospect: Prospect, weights: Float32Array, views: Views, travel: Travel) -> Plan | None:
        """The way to the view of the best rate."""
        from dream.planning._kernels import lookahead

        rows, cols, steps = _viewpoints(travel)
        shown = PoseViews(rows, cols, steps, lookahead.best_gains(weights, views, rows, cols, steps))
        best = shown.best(shown.rates)
        if best is None or best.rate <= NOTHING:
            return None
        row, col, heading = best.pose
        seen = np.zeros((len(weights) + 63) // 64, np.uint64)
        lookahead.look(weights, seen, views, row, col, heading)
        return prospect.plan(travel.path(best.pose), best.rate, 0.0, seen)


def _viewpoints(travel: Travel) -> tuple[IntArray, IntArray, IntArray]:
    """Rows, columns and steps to every second node near by, and to every fourth beyond."""
    rows, cols = np.nonzero(travel.reached)
    near = travel.nearest[rows, cols] <= NEAR
    chosen = (rows % 2 == 0) & (cols % 2 == 0) & (near | (rows % 4 == 0) & (cols % 4 == 0))
    rows, cols = rows[chosen], cols[chosen]
    return rows, cols, travel.steps[rows, cols]
