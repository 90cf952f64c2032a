"""The planner behind a model: it decides where no answer comes, and knows what else could be done.

A model's planner sees it through `Offline`, which is the same whether the vehicle keeps its altitude or
moves in space.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from dream.geometry import SE2
from dream.planning.belief import Belief, BeliefPilot, Thought, achieved
from dream.planning.lookahead import Plan
from dream.planning.vlm.asking import Question
from dream.planning.vlm.places import Place, again, places
from dream.planning.vlm.places_in_space import InSpace, OffersPlaces, SixStepsPlaces
from dream.planning.vlm.prompts import Own
from dream.planning.vlm.ranking_question import ranking_question
from dream.planning.vlm.reply import Ranking
from dream.types import Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

T = TypeVar("T")
"""What the planner holds of a situation."""
P = TypeVar("P", bound="Goal")
"""A place to go next."""
W = TypeVar("W")
"""A way that can be carried out."""
S_co = TypeVar("S_co", bound="Spot", covariant=True)
"""A position."""


class Spot(Protocol):
    """A position, in the plane or in space."""

    def distance(self, other: Any) -> float:
        """Metres to another."""
        ...


class Goal(Protocol):
    """A place to go next."""

    @property
    def loss(self) -> float:
        """Steps that going there first is expected to cost, against what the planner itself would do."""
        ...

    @property
    def path(self) -> Any:
        """(N, 2) or (N, 3) metres in the world, where the vehicle is first."""
        ...


class Offline(Protocol[T, P, W, S_co]):
    """A planner that needs no model, and what it can say of what it would do."""

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> T:
        """Take in what is new."""
        ...

    def own(self, thought: T) -> W | None:
        """What it would do itself; None where it would end the mission."""
        ...

    def act(self, thought: T, way: W | None) -> Decision:
        """The first move of a way; done without one."""
        ...

    def places(self, thought: T) -> Sequence[P]:
        """Where it could go next, its own first where it has one."""
        ...

    def again(self, thought: T, place: P) -> tuple[W, float] | None:
        """The way to a place that was chosen before, and the steps that it costs now; None where there is
        none, where the vehicle is there, and where nothing is left to see."""
        ...

    def question(
        self,
        observation: Observation,
        occupancy: OccupancyMap,
        thought: T,
        trail: Sequence[SE2],
        numbered: Mapping[int, P],
        own: Own,
    ) -> Question[Ranking]:
        """The question in which order places are best to go to; see `ranking_question`."""
        ...

    def here(self, thought: T) -> S_co:
        """Where the vehicle is."""
        ...

    def goal(self, thought: T, way: W) -> S_co:
        """Where a way ends."""
        ...

    def spot(self, place: P) -> S_co:
        """Where a place is."""
        ...

    def is_bound(self, thought: T) -> bool:
        """Is what it would do no matter of opinion?"""
        ...

    def closed(self, thought: T) -> int:
        """Regions that are complete, as far as it counts any."""
        ...

    def achieved(self, occupancy: OccupancyMap) -> int:
        """Grows with everything that is new."""
        ...


def offline_planner(mission: Mission) -> Offline[Any, Any, Any, Any]:
    """The planner behind the models of a mission."""
    if mission.protocol.space is None:
        return InPlane(Belief().in_plane(mission))
    return InSpace(mission, offline_pilot(mission))


def offline_pilot(mission: Mission) -> OffersPlaces[Any, Any]:
    """Who decides in space where no answer comes, and offers places to choose among."""
    return SixStepsPlaces(mission)


class InPlane:
    """`belief` under a planar protocol."""

    def __init__(self, pilot: BeliefPilot) -> None:
        self.pilot = pilot

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Thought:
        """See `Offline`, as of the others."""
        return self.pilot.consider(observation, occupancy)

    def own(self, thought: Thought) -> Plan | None:
        """Its plan."""
        return thought.plan

    def act(self, thought: Thought, way: Plan | None) -> Decision:
        """Its six steps."""
        return self.pilot.act(thought, way)

    def places(self, thought: Thought) -> list[Place]:
        """See `places.places`."""
        return places(self.pilot, thought)

    def again(self, thought: Thought, place: Place) -> tuple[Plan, float] | None:
        """See `places.again`."""
        return again(self.pilot, thought, place.pose)

    def question(
        self,
        observation: Observation,
        occupancy: OccupancyMap,
        thought: Thought,
        trail: Sequence[SE2],
        numbered: Mapping[int, Place],
        own: Own,
    ) -> Question[Ranking]:
        """See `ranking_question.ranking_question`."""
        mission = self.pilot.mission
        return ranking_question(mission, observation, occupancy, thought, trail, numbered, own)

    def here(self, thought: Thought) -> SE2:
        """On the lattice."""
        return thought.pose

    def goal(self, thought: Thought, way: Plan) -> SE2:
        """Without a heading."""
        x, y = thought.travel.lattice.position(way.path[-1])
        return SE2(float(x), float(y), 0.0)

    def spot(self, place: Place) -> SE2:
        """Likewise."""
        x, y = place.path[-1]
        return SE2(float(x), float(y), 0.0)

    def is_bound(self, thought: Thought) -> bool:
        """Is it about to traverse what was found?"""
        return thought.plan is not None and thought.plan.passed > 0

    def closed(self, thought: Thought) -> int:
        """Regions that explored ground encloses."""
        return sum(region.enclosed for region in thought.completion.regions)

    def achieved(self, occupancy: OccupancyMap) -> int:
        """See `belief.achieved`."""
        return achieved(occupancy)
