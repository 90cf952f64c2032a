"""`belief` in three dimensions: what stands up by a look-ahead in space, the ground as in the plane."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from dream.planning.space import words
from dream.planning.space.ground import GroundSearch
from dream.planning.space.remains import LOW, SURFACE, UNKNOWN, LeftOfStructures, LeftToInspect
from dream.planning.space.search import FarSearch
from dream.planning.space.ways import KnownWays, ways_in
from dream.types import Decision, Mission, Observation, Reasoning, Target

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.planning.space.lookahead import SpacePlan

LEAST = 0.35
"""Square metres that a step has to show of structures for them to be gone on with."""
LOOKED_OVER = 0.03
"""Share of the surface of structures, as it is estimated, that may be left when they are done with."""
MISSED = 0.011, 0.004, 0.023
"""Share of what can be inspected at all that a mission of `belief` for a wreck misses when it ends by its own
word: the mean, and between what eight of ten lie, in 39 missions on the wrecks of `dev`. What the map takes
for left says nothing of it: it is five times as much, most of which shows from nowhere."""


class Chooser(Protocol):
    """Chooses the way to what is left of structures."""

    def plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """The best way; None where nothing is in sight."""
        ...


@dataclass(slots=True)
class SpaceBelief:
    """`Belief` during one mission in space.

    What it does, each step the first of these that has anything to do: look at what is left of structures;
    go to something that stands up far off, or have a first look at the area; search the ground. What a step
    is spent on is told.
    """

    mission: Mission
    ground: GroundSearch
    chooser: Chooser
    remains: LeftOfStructures = field(init=False)
    far: FarSearch = field(init=False)

    def __post_init__(self) -> None:
        self.remains = LeftOfStructures(self.mission.to_see)
        self.far = FarSearch(self.mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move, or done."""
        assert occupancy.volume is not None
        if self.mission.target is Target.OYSTERS:
            return self.ground.decide(observation, occupancy)
        volume = occupancy.volume
        ways = ways_in(volume, self.mission.bounds, self.mission.protocol)
        left = self.remains.take(observation, volume, ways)
        self.far.take(observation, volume.surface())
        plan = self._plan(ways, left, observation)
        if plan is None and (again := self.remains.look_again()) is not None:
            left, plan = again, self._plan(ways, again, observation)
        if plan is not None:
            return replace(plan.move, reasoning=self._words(ways, left, plan))
        move, why = self.far.errand(ways, observation)
        if move is not None:
            told = replace(self._words(ways, left, None), next_target=why)
            return replace(move, reasoning=replace(told, action=_action(move)))
        if self.mission.target is Target.WRECK and left.inspected:
            said = replace(
                self._words(ways, left, None), action=words.ended(left.hidden, left.given_up, MISSED)
            )
            return Decision(done=True, reasoning=said)
        decision = self.ground.decide(observation, occupancy)
        if not len(left) and not left.inspected:
            return decision
        said = self._words(ways, left, None)
        completion = f"{said.completion} {decision.reasoning.completion}"
        return replace(decision, reasoning=replace(decision.reasoning, completion=completion))

    def _plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """What to do about structures; None where hardly anything is left, or little of it to be had."""
        plan = None if left.hidden <= LOOKED_OVER else self.chooser.plan(ways, left, observation)
        return plan if plan is not None and plan.rate >= LEAST else None

    def _words(self, ways: KnownWays, left: LeftToInspect, plan: SpacePlan | None) -> Reasoning:
        """What is known and left of structures, and what a plan shows of it."""
        known = left.inspected + left.given_up + left.of(SURFACE)
        told = Reasoning(
            distribution=words.surface(known, left.inspected),
            completion=words.remains(left.of(SURFACE), left.of(UNKNOWN), left.given_up, left.hidden),
        )
        if plan is None:
            return told
        protocol = self.mission.protocol
        shows = left.only(left.shown(ways, plan.node, plan.heading, plan.tilt))
        x, y, z = ((np.array(plan.node) + np.array(ways.first))[::-1] * protocol.lattice).tolist()
        yaw, tilt = plan.heading * protocol.heading_step, protocol.tilts[plan.tilt]
        surface, unknown = shows.of(SURFACE) + shows.of(LOW), shows.of(UNKNOWN)
        look = words.look((x, y, z), yaw, tilt, plan.steps, surface, unknown)
        return replace(
            told,
            next_target=f"{look} {plan.why}".rstrip(),
            safety=words.SAFE,
            action=_action(plan.move),
        )


def _action(move: Decision) -> str:
    return words.action(move.turn, move.advance, move.climb, move.tilt)
