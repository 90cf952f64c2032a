"""The search of the ground in three dimensions: as in the plane, at a height that the water allows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

from dream.planning.space.in_water import ENOUGH, InWater
from dream.types import Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


class PilotInPlane(Protocol):
    """`belief` at one altitude, as it is needed here."""

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Any:
        """Its thought: the situation, and a plan or none."""
        ...

    def act(self, thought: Any, plan: Any) -> Decision:
        """The first move of a plan; done without one."""
        ...


@dataclass(slots=True)
class GroundSearch:
    """`belief` of the plane on the view from above, from higher up.

    What it does: labels are trusted as far as `SurveyProtocol.trusted` says, straight; over ground that is
    less, and so far the planar pilot plans for. Where targets are told, ground counts as seen once its
    looks hardly overlooked any (`Overlooked`): until then the pilot expects targets there and comes again,
    but gives it up like other ground. It climbs or descends to its altitude where the water on the way is
    known to be free, and looks down, where targets hide one another least, while the water ahead of it is.

    Assumes: that what the camera shows ahead it shows looking down too, since plans know one tilt only.
    """

    mission: Mission
    in_plane: Callable[[Mission], PilotInPlane]
    """Makes the pilot that plans."""
    pilot: PilotInPlane = field(init=False)
    water: InWater = field(init=False)

    def __post_init__(self) -> None:
        self.water = InWater(self.mission)
        self.pilot = self.in_plane(self.water.in_plane)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move; done where the risk that something was missed is accepted."""
        self.water.take(observation, occupancy)
        near = self.water.from_above(occupancy)
        out = self.water.into_the_open(observation, near)
        if out is not None:
            return out
        thought = self.pilot.consider(observation, near)
        hiding = thought.expected.hiding
        if self.water.enough(hiding, occupancy):
            thought = replace(thought, plan=None, why=ENOUGH)
        decision = self.pilot.act(thought, thought.plan)
        if decision.done:
            return self.water.ended(decision, hiding, occupancy)
        return replace(self.water.moved(decision, observation, occupancy), reasoning=decision.reasoning)
