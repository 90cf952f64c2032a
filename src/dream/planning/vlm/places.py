"""Places to go next: the offline planner's own, and what else it could do.

In the plane they are found here; what one in space must say of itself stands here, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.planning.lookahead import NOTHING, Judged, Plan

if TYPE_CHECKING:
    from dream.planning.belief import BeliefPilot, Thought

MOST = 9
"""Places of one question."""
APART = 0.5
"""Between two places, and between a place and the offline planner's way, in reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Somewhere to go next. As the map is now, the guard lets every move on the way there pass.

    Of the offline planner's own, it is only sure to pass the first: others may lead over ground that the
    vehicle would see on the way.
    """

    plan: Plan
    loss: float
    """Steps that going there first is expected to cost, against what the offline planner would do."""
    path: npt.NDArray[np.float64]
    """(N, 2) metres in the world, where the vehicle is first."""
    yaw: float
    """Radians, where the camera looks there."""
    closes: tuple[int, ...]
    """Numbers of the regions that have nothing open left then."""

    @property
    def pose(self) -> Pose:
        """On the planner's lattice."""
        return self.plan.path[-1]

    @property
    def steps(self) -> int:
        """To get there."""
        return len(self.plan.path) - 1


class SpacePlace(Protocol):
    """Somewhere to look from next."""

    @property
    def position(self) -> tuple[float, float, float]:
        """x, y and z, metres in the world."""
        ...

    @property
    def yaw(self) -> float:
        """Radians, where the vehicle heads there."""
        ...

    @property
    def tilt(self) -> float:
        """Pitch of the camera there, radians, positive downwards."""
        ...

    @property
    def steps(self) -> int:
        """To get there."""
        ...

    @property
    def loss(self) -> float:
        """Steps that going there first is expected to cost, against the planner's own choice."""
        ...

    @property
    def shows(self) -> Mapping[str, float]:
        """Square metres that the look is expected to show: `target` that is left to inspect, `unknown` water
        beside target, `ground` from which nothing returned."""
        ...

    @property
    def path(self) -> npt.NDArray[np.float64]:
        """(N, 3) metres in the world, where the vehicle is first."""
        ...


def places(pilot: BeliefPilot, thought: Thought) -> list[Place]:
    """The end of the offline planner's plan, where it has one, and the best views elsewhere.

    Args:
        pilot: Who thought it.
        thought: Of this moment.

    Returns:
        The offline planner's own first; at most `MOST`.
    """
    travel, ahead = thought.travel, pilot.planner.look_ahead
    prospect = pilot.prospect(thought.expected, thought.situation)
    apart = APART * pilot.mission.protocol.reach
    ways = [] if thought.plan is None else [thought.plan.path]
    taken = [place for way in ways for place in travel.lattice.position(way)]
    views = ahead.viewpoints(prospect, travel)
    rates = views.rates
    at = views.positions
    # Rounded, so that a tie is a tie on every machine.
    for k in np.argsort(-rates.max(axis=1, initial=0.0).round(6), kind="stable"):
        heading = int(rates[k].argmax())
        if len(ways) == MOST or rates[k, heading] <= NOTHING:
            break
        if all(np.hypot(*(at[k] - other)) >= apart for other in taken):
            ways.append(travel.path(travel.lattice.pose_at(views.nodes[k], heading)))
            taken.append(at[k])
    if not ways:
        return []
    judged = ahead.judge(prospect, travel, ways)
    return [
        Place(
            one.plan,
            _loss(one, None if thought.plan is None else judged[0]),
            travel.lattice.position(one.plan.path),
            travel.lattice.world(one.plan.path[-1]).yaw,
            _closes(pilot, thought, one.plan.path),
        )
        for one in judged
    ]


def again(pilot: BeliefPilot, thought: Thought, pose: Pose) -> tuple[Plan, float] | None:
    """The way from here to a place that was chosen before, and the steps that it costs now.

    None where no way leads there any more, where the vehicle is there, and where nothing is left to see.
    """
    travel = thought.travel
    if travel.steps[pose] <= 0:
        return None
    ways = [travel.path(pose)] if thought.plan is None else [thought.plan.path, travel.path(pose)]
    judged = pilot.planner.look_ahead.judge(pilot.prospect(thought.expected, thought.situation), travel, ways)
    if judged[-1].plan.rate <= NOTHING:
        return None
    return judged[-1].plan, _loss(judged[-1], None if thought.plan is None else judged[0])


def _loss(judged: Judged, own: Judged | None) -> float:
    """Steps that a way costs against the planner's own; all of them where that would end the mission."""
    if own is None:
        return float(len(judged.plan.path) - 1)
    # Where the simple tour behind the values rates another place higher, the search knew better.
    return max(own.value - judged.value, 0.0)


def _closes(pilot: BeliefPilot, thought: Thought, path: list[Pose]) -> tuple[int, ...]:
    regions = thought.completion.regions
    if all(region.enclosed for region in regions):
        return ()
    shown = np.zeros_like(pilot.pose_views.shown(path[-1])[0])
    for pose in path[1:]:
        shown |= pilot.pose_views.shown(pose)[0]
    return tuple(
        number
        for number, region in enumerate(regions, start=1)
        if not region.enclosed and shown[tuple(region.open_cells.T)].all()
    )
