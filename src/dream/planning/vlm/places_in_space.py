"""Places to go next in three dimensions: what an offline planner offers, and `sixsteps` as one that does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.planning.sixsteps import SixSteps
from dream.planning.space.sixsteps import SpacePilot, SpaceThought, SpaceView
from dream.planning.vlm.asking import Question
from dream.planning.vlm.places import APART, MOST, SpacePlace
from dream.planning.vlm.prompts import Own
from dream.planning.vlm.ranking_question import ranking_question_in_space
from dream.planning.vlm.reply import Ranking
from dream.types import Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

T = TypeVar("T")
P = TypeVar("P", bound="SpacePlace")
SAME = 0.25
"""Two places of one question and of a later one are the same where they lie this near, in reaches."""


class OffersPlaces(Protocol[T, P]):
    """A pilot in space that can say where else it could go."""

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> T:
        """Take in what is new, once for each decision."""
        ...

    def candidates(self, thought: T, most: int) -> Sequence[P]:
        """Places apart from each other, best first. The first is its own choice and loses nothing, unless it
        would end the mission: then all lose something."""
        ...

    def act(self, thought: T, place: P | None) -> Decision:
        """The first move to a place; without one what it would do itself, which may be done."""
        ...


@dataclass(frozen=True, slots=True)
class Position:
    """In the world, metres."""

    x: float
    y: float
    z: float

    def distance(self, other: Position) -> float:
        """Metres."""
        return math.dist((self.x, self.y, self.z), (other.x, other.y, other.z))


class Considered:
    """What a pilot in space holds of a situation, and what it offers once that is asked for."""

    def __init__(self, pilot: OffersPlaces[Any, Any], thought: Any, here: Position) -> None:
        self.pilot, self.thought, self.here = pilot, thought, here

    @cached_property
    def places(self) -> Sequence[Any]:
        """At most `MOST`."""
        return self.pilot.candidates(self.thought, MOST)


class InSpace:
    """A pilot that offers places in space, as models' planners see it. See `offline.Offline`."""

    def __init__(self, mission: Mission, pilot: OffersPlaces[Any, Any]) -> None:
        self.mission, self.pilot = mission, pilot

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Considered:
        """Take in what is new."""
        thought = self.pilot.consider(observation, occupancy)
        pose = observation.pose
        return Considered(self.pilot, thought, Position(pose.x, pose.y, observation.z))

    def own(self, thought: Considered) -> SpacePlace | None:
        """The first place, where it loses nothing."""
        first = thought.places[0] if thought.places else None
        return first if first is not None and first.loss <= 0.0 else None

    def act(self, thought: Considered, way: SpacePlace | None) -> Decision:
        """The first move there."""
        return self.pilot.act(thought.thought, None if way is self.own(thought) else way)

    def places(self, thought: Considered) -> Sequence[SpacePlace]:
        """All that it offers."""
        return thought.places

    def again(self, thought: Considered, place: SpacePlace) -> tuple[SpacePlace, float] | None:
        """The nearest of what it offers now, where that is near enough to be the same."""
        goal, near = self.spot(place), SAME * self.mission.protocol.reach
        if goal.distance(thought.here) <= 0.5 * self.mission.protocol.lattice:
            return None
        now = min(thought.places, key=lambda other: self.spot(other).distance(goal), default=None)
        if now is None or self.spot(now).distance(goal) > near:
            return None
        return now, now.loss

    def question(
        self,
        observation: Observation,
        occupancy: OccupancyMap,
        thought: Considered,
        trail: Sequence[SE2],
        numbered: Mapping[int, SpacePlace],
        own: Own,
    ) -> Question[Ranking]:
        """See `ranking_question.ranking_question_in_space`."""
        ends = self.own(thought) is None
        return ranking_question_in_space(
            self.mission, observation, occupancy, trail, numbered, own, ends=ends
        )

    def here(self, thought: Considered) -> Position:
        """Where the vehicle is."""
        return thought.here

    def goal(self, thought: Considered, way: SpacePlace) -> Position:
        """Where a place is."""
        return self.spot(way)

    def spot(self, place: SpacePlace) -> Position:
        """Likewise."""
        return Position(*place.position)

    def is_bound(self, thought: Considered) -> bool:
        """Never."""
        return False

    def closed(self, thought: Considered) -> int:
        """None is counted."""
        return 0

    def achieved(self, occupancy: OccupancyMap) -> int:
        """Cells observed, and voxels of target inspected."""
        assert occupancy.volume is not None
        surface = occupancy.volume.surface()
        inspected = (surface.target > 0.5) & (surface.sides != 0)
        return int(np.count_nonzero(occupancy.observed) + np.count_nonzero(inspected))


# ------------------------------------------------------------------------------------------------ sixsteps


@dataclass(frozen=True, slots=True, eq=False)
class SixStepsPlace:
    """A look of `sixsteps`. See `SpacePlace`."""

    view: SpaceView
    position: tuple[float, float, float]
    yaw: float
    tilt: float
    loss: float
    shows: Mapping[str, float]
    path: npt.NDArray[np.float64]

    @property
    def steps(self) -> int:
        """To get there."""
        return self.view.steps


class SixStepsPlaces:
    """`sixsteps` in space, with the looks that show most for their steps as places."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.pilot = SpacePilot(SixSteps(), mission)

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> SpaceThought:
        """See `OffersPlaces`."""
        return self.pilot.consider(observation, occupancy)

    def candidates(self, thought: SpaceThought, most: int) -> list[SixStepsPlace]:
        """The looks with the best rates.

        In the steps to one of them the way to its own look would have shown so much; what it shows less is
        the loss, in steps of its own look.
        """
        protocol, own = self.mission.protocol, thought.view
        return [
            SixStepsPlace(
                view,
                tuple(thought.ways.positions[view.node].tolist()),
                view.heading * protocol.heading_step,
                protocol.tilts[view.tilt],
                0.0 if view is own or own is None else max(view.steps * (1.0 - view.rate / own.rate), 0.0),
                dict(zip(("target", "unknown", "ground"), self.pilot.shows(thought, view), strict=True)),
                self._path(thought, view),
            )
            for view in self.pilot.views(thought, most, APART * protocol.reach)
        ]

    def act(self, thought: SpaceThought, place: SixStepsPlace | None) -> Decision:
        """See `OffersPlaces`."""
        return self.pilot.act(thought, thought.view if place is None else place.view)

    def _path(self, thought: SpaceThought, view: SpaceView) -> npt.NDArray[np.float64]:
        ways, observation, protocol = thought.ways, thought.observation, self.mission.protocol
        goal = np.zeros(ways.shape, np.bool_)
        goal[view.node] = True
        facing = np.arange(protocol.headings) == view.heading
        heading = protocol.heading_index(observation.pose.yaw)
        at = np.array([observation.pose.x, observation.pose.y, observation.z])
        path = [at]
        for move in ways.to(observation.pose, observation.z, goal, facing) or []:
            heading += round(move.turn / protocol.heading_step)
            east, north = protocol.offset(heading, move.advance)
            at = at + np.array([east, north, 0.0]) * protocol.lattice + np.array([0.0, 0.0, move.climb])
            path.append(at)
        return np.array(path)
