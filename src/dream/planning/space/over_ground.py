"""A pilot of the plane that searches the ground in three dimensions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, TypeVar

from dream.planning.space.in_water import ENOUGH, InWater
from dream.types import Decision, Mission, Observation, Reasoning, Target

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.planning.belief import BeliefPilot


class PlanarPilot(Protocol):
    """A planner of the plane during one mission."""

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move at its altitude."""
        ...


Pilot = TypeVar("Pilot", bound=PlanarPilot)


def in_plane_or_over_ground(mission: Mission, in_plane: Callable[[Mission], Pilot]) -> Pilot | OverGround:
    """A fresh pilot of the plane; under a protocol that moves in space, over the ground.

    Args:
        mission: Of either kind.
        in_plane: Makes the pilot, under whatever protocol.
    """
    return in_plane(mission) if mission.protocol.space is None else OverGround(mission, in_plane)


@dataclass(slots=True)
class OverGround:
    """A pilot of the plane over the view from above, given what the ground search of `belief` is given.

    What it does: the pilot plans on the same view from above, with the same reach over ground, and its moves
    are made in known water by the same rule (`InWater`). The mission ends as soon as the ground counts as
    searched by the rule that ends the search of `belief`, so that no pilot has to be more thorough than that
    one. A pilot that says so earlier is asked once more, as where the map refuses a `done` in the plane; it
    ends the mission where it knows of nothing else to look at.

    Assumes: targets that lie on the ground. Fails when: they stand up; what is upright shows little from
    above.
    """

    mission: Mission
    in_plane: Callable[[Mission], PlanarPilot]
    """Makes the pilot."""
    pilot: PlanarPilot = field(init=False)
    water: InWater = field(init=False)
    judge: BeliefPilot = field(init=False)
    """Tells where something could still hide, and decides nothing."""

    def __post_init__(self) -> None:
        """Begin.

        Raises:
            ValueError: The mission looks for a wreck.
        """
        from dream.planning.belief import Belief

        if self.mission.target is Target.WRECK:
            raise ValueError(
                "target: expected oysters, or anything, of a planner that searches the ground in lanes or by "
                "views from above; got a wreck. Fly belief, or orbits; or by --protocol dream-v1"
            )
        self.water = InWater(self.mission)
        self.pilot = self.in_plane(self.water.in_plane)
        self.judge = Belief().over_ground.in_plane(self.water.in_plane)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move, or done."""
        self.water.take(observation, occupancy)
        near = self.water.from_above(occupancy)
        expected = self.judge.expect(self.judge.take(observation, near))
        if self.water.enough(expected.hiding, occupancy):
            done = Decision(done=True, reasoning=Reasoning(action=ENOUGH))
            return self.water.ended(done, expected.hiding, occupancy)
        out = self.water.into_the_open(observation, near)
        if out is not None:
            return out
        decision = self.pilot.decide(observation, near)
        if decision.done:
            decision = self.pilot.decide(observation, near)
        if decision.done:
            return self.water.ended(decision, expected.hiding, occupancy)
        return replace(self.water.moved(decision, observation, occupancy), reasoning=decision.reasoning)
