"""Where a look tells most of a field of targets for the way there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.options import First
from dream.planning.baselines.remains import Remains, group_cells
from dream.planning.parameters import check_count, check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.planning.target_field import TargetField
from dream.planning.travel import Travel, careful_travel
from dream.planning.viewpoints import Viewpoint, Viewpoints, viewpoints_from
from dream.types import BoolArray, Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class MutualInformation:
    """Go where the looks on the way tell most of a Gaussian field of targets, and show most of them.

    What it does: holds the share of target in each square metre of ground for a Gaussian Markov field, which
    what was seen pins down. A way is worth the mutual information of the ground that its looks show and the
    unknown ground beside it, and the targets in it by an upper confidence bound; both for each step. Ways end
    at all views near by; the `paths` best of them, by a bound that is never too low for the last look, are
    reckoned whole, and the first move of the best is made. Ground whose upper bound is below `level` is not
    looked for. It is done when no view shows any other; where that is refused, all ground counts.

    Reference: mutual information of Krause, Singh and Guestrin (JMLR 2008), along paths as in rapidly
    exploring information gathering (Hollinger and Sukhatme, IJRR 2014) and in the terrain monitoring of
    Popović et al. (Autonomous Robots 2020), whose upper confidence bound it takes too; level sets after
    Gotovos et al. (IJCAI 2013). Departures: a Markov field (Lindgren et al. 2011), so that a set of squares
    has a closed form; ways are shortest ones over the protocol's moves, not sampled nor bent by an
    evolution strategy; no budget, since a mission ends by its own word; what is known has no noise.

    Assumes: targets lie in patches wider than a square. Fails when: they are smaller or alone: what lies
    a square beside bare ground counts as bare.
    """

    spatial: ClassVar[bool] = True

    tell: First[float] = 10.0
    """Worth of a nat of information, in map cells of target."""
    beta: First[float] = 1.0
    """Standard deviations that the upper bound of the share of target lies above the mean."""
    level: First[float] = 0.15
    """Ground is looked for whose upper bound is at least this share of target."""
    related: float = 4.0
    """Distance at which squares are correlated by about a tenth, as a multiple of the radius of the smallest
    patch (1.5 m under dream-v1)."""
    mean: float = 0.1
    """Share of target that is expected where nothing is known."""
    deviation: float = 0.3
    """Standard deviation of that share."""
    least: float = 0.25
    """A way counts if it is worth this much target: share of the area of the smallest patch."""
    paths: int = 24
    """Ways that are reckoned whole."""

    def __post_init__(self) -> None:
        check_range("tell", self.tell, 0.0, 1e6)
        check_range("beta", self.beta, 0.0, 100.0)
        check_range("level", self.level, 0.0, 1.0)
        check_range("related", self.related, 0.1, 100.0)
        check_range("mean", self.mean, 0.0, 1.0)
        check_range("deviation", self.deviation, 1e-3, 10.0)
        check_range("least", self.least, 0.0, 100.0)
        check_count("paths", self.paths, 1, 10_000)

    def begin(self, mission: Mission) -> _Informed | OverGround:
        """A fresh pilot; it remembers the field, the view it is heading for and which views failed.

        Under a protocol that moves in space it searches the ground: see `OverGround`.
        """
        return in_plane_or_over_ground(mission, self.in_plane)

    def in_plane(self, mission: Mission) -> _Informed:
        """A pilot that keeps its altitude, under whatever protocol."""
        protocol = mission.protocol
        return _Informed(
            self,
            Remains(mission, max(1.0, self.least * group_cells(protocol))),
            TargetField(mission, self.related * protocol.group_radius, self.mean, self.deviation),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Worth:
    """What looking at ground is worth, in map cells of target."""

    occupancy: OccupancyMap
    target: FloatArray
    """(rows, cols) by the targets to be expected there."""
    squares: FloatArray
    """(squares,) map cells of each that are left to be seen; 0 where it is known."""
    ground: TargetField
    tell: float
    _views: dict[Pose, BoolArray] = field(default_factory=dict)

    def of_way(self, path: list[Pose], travel: Travel) -> float:
        """Of all that the looks along a way show together."""
        from dream.mapping import view

        shown = np.zeros(self.occupancy.shape, np.bool_)
        for pose in path:
            if pose not in self._views:
                there = travel.lattice.world(pose)
                self._views[pose] = view(self.occupancy, there.x, there.y, there.yaw)
            shown |= self._views[pose]
        return self.of_cells(shown)

    def of_cells(self, shown: BoolArray) -> float:
        """Of some ground (rows, cols), each square of which counts for information where half of it shows."""
        known = self.ground.on_squares(shown & ~self.occupancy.observed)
        squares = np.flatnonzero((known >= 0.5 * self.squares) & (self.squares > 0.0))
        return float(self.target[shown].sum()) + self.tell * self.ground.information(squares)


@dataclass(slots=True)
class _Informed:
    planner: MutualInformation
    remains: Remains
    ground: TargetField

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        pose = observation.pose
        self.remains.look(pose, occupancy)
        self.ground.learn(occupancy)
        travel = careful_travel(pose, occupancy)
        going = self.remains.go(pose, travel, occupancy, lambda way: self._best(way, occupancy))
        if going is None:
            return self.remains.done("No view is left that shows ground where targets are likely enough.")
        view, decision = going
        x, y = travel.lattice.position(view.pose)
        action = (
            f"To the view from ({x:.1f}, {y:.1f}), {view.steps} steps away: the way there is worth "
            f"{view.gain:.0f} cells of target."
        )
        return replace(decision, reasoning=Reasoning(action=action))

    def _worth(self, occupancy: OccupancyMap) -> _Worth:
        planner, ground = self.planner, self.ground
        bound = np.clip(ground.expected + planner.beta * np.sqrt(ground.variances), 0.0, 1.0)
        # After a refused `done` all ground counts, however little is expected there.
        shares = np.where(bound >= planner.level, bound, 0.0) if self.remains.claims == 0 else 1.0
        cells = ground.on_cells(np.broadcast_to(shares, bound.shape))
        left = self.remains.worth_looking(occupancy) & (cells > 0.0)
        squares = np.where(ground.known, 0.0, ground.on_squares(left))
        return _Worth(occupancy, np.where(left, cells, 0.0), squares, ground, planner.tell)

    def _best(self, travel: Travel, occupancy: OccupancyMap) -> Viewpoint | None:
        """The end of the best way; None where none is worth it."""
        planner, worth = self.planner, self._worth(occupancy)
        alone = planner.tell * self.ground.of_one() / np.maximum(worth.squares, 1.0)
        weights = worth.target + np.where(worth.target > 0.0, self.ground.on_cells(alone), 0.0)
        views = viewpoints_from(travel, occupancy, weights.astype(np.float32), keep=self.remains.goal)
        best: Viewpoint | None = None
        for one in self._promising(views):
            path = travel.path(one.pose)
            gain = worth.of_way(path[1:], travel)
            # Rounded, so that a tie is a tie on every machine.
            if gain >= self.remains.least and (best is None or round(gain / one.steps, 6) > best.rate):
                best = Viewpoint(one.pose, one.steps, round(gain / one.steps, 6) * one.steps)
        return best

    def _promising(self, views: Viewpoints) -> list[Viewpoint]:
        """The views with the best bounds for each step, the one that is headed for first."""
        rates = np.where(views.gains >= self.remains.least, views.rates, 0.0).round(6)
        order = np.argsort(-rates, axis=None, kind="stable")[: self.planner.paths]
        kept = None if self.remains.goal is None else views.at(self.remains.goal)
        found = [] if kept is None else [kept]
        for k, heading in zip(*np.unravel_index(order, rates.shape), strict=True):
            if rates[k, heading] > 0.0:
                pose = views.lattice.pose_at(int(views.nodes[k]), int(heading))
                found.append(Viewpoint(pose, int(views.steps[k, heading]), float(views.gains[k, heading])))
        return found
