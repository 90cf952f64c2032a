"""A planner of one's own beside two of the package: a file to copy.

    python examples/planner.py      six missions, half a minute of computing; leaves bench/nearby/report.html

    dream run examples/planner.py   one reef, with a report; --beside 3 and the like are its options

Nothing in the package knows of it. One that is to have a name, `dream run NAME`, joins the package: see
CONTRIBUTING.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dream.commands.bench import fly
from dream.evaluation.engines import Processes
from dream.evaluation.runner import Plan
from dream.evaluation.suites import Case
from dream.mapping import OccupancyMap, check_completion, within
from dream.planning import PLANNERS
from dream.planning.failed_views import FailedViews
from dream.planning.parameters import check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.planning.travel import careful_travel
from dream.planning.viewpoints import viewpoints_from
from dream.protocol import DREAM_V1
from dream.types import Decision, Mission, Observation, Reasoning


@dataclass(frozen=True, slots=True)
class Nearby:
    """Look at what is unseen beside known targets first.

    What it does: gives every unseen cell a weight, a large one within `beside` metres of targets, and makes
    the first move to the view that shows most of it for each step there. It is done when no view shows any,
    or when every region is enclosed and it has looked around for `least_steps`.

    Reference: greedy next-best-view planning.

    Assumes: nothing. Fails when: groups lie far apart; it looks one view ahead only.
    """

    spatial: ClassVar[bool] = True
    """That it flies under protocols that move in space, too: over the ground, as `OverGround` says."""

    beside: float = 2.0
    """Metres from known targets within which more are expected."""
    elsewhere: float = 0.1
    """Weight of the other cells."""
    least_steps: int = 100
    """Steps before which it is never done."""

    def __post_init__(self) -> None:
        check_range("beside", self.beside, 0.0, 50.0)
        check_range("elsewhere", self.elsewhere, 0.0, 1.0)
        check_range("least_steps", self.least_steps, 0, 10_000)

    def begin(self, mission: Mission) -> NearbyPilot | OverGround:
        """What decides during one mission, and remembers what it must."""
        return in_plane_or_over_ground(mission, lambda in_plane: NearbyPilot(self, in_plane))


@dataclass(slots=True)
class NearbyPilot:
    """`Nearby` during one mission. It never sees the world, only what the vehicle saw."""

    planner: Nearby
    mission: Mission
    failed: FailedViews = field(init=False)
    """What stands on the ground may hide what a view promises: without this it would look there for ever."""
    steps: int = 0

    def __post_init__(self) -> None:
        self.failed = FailedViews(self.mission, patience=3)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """One move, by what was just seen and the map with it."""
        pose = observation.pose
        self.steps += 1
        self.failed.note(pose, occupancy)
        enclosed = check_completion(occupancy, pose).complete
        if enclosed and occupancy.target.any() and self.steps >= self.planner.least_steps:
            return Decision(done=True, reasoning=Reasoning(action="Every region is enclosed: done."))

        near = within(occupancy.target, self.planner.beside, self.mission.protocol.cell)
        weights = np.where(near, 1.0, self.planner.elsewhere) * self.failed.left(occupancy)
        travel = careful_travel(pose, occupancy)  # Ways that the guard lets pass.
        views = viewpoints_from(travel, occupancy, weights.astype(np.float32))
        best = views.best(np.where(views.gains > 0.0, views.rates, -np.inf))
        if best is None:
            return Decision(done=True, reasoning=Reasoning(action="No view shows anything new: done."))
        here, after, *_ = travel.path(best.pose)
        turn, advance = travel.move(here, after)
        why = f"Towards a view of weight {best.gain:.1f}, {best.steps} steps away."
        return Decision(turn, advance, reasoning=Reasoning(action=why))


def main() -> None:
    """Fly it beside others, in the same worlds from the same starts; say and draw how each fared."""
    planners: dict[str, Any] = {"nearby": Nearby()}
    planners |= {name: PLANNERS[name] for name in ("belief", "frontier")}
    cases = tuple(Case("reef/string", seed) for seed in (1, 2))
    plan = Plan("reef/string 1..2", cases, planners, DREAM_V1)
    fly(plan, Path("bench/nearby"), Processes()).print()


if __name__ == "__main__":
    main()
