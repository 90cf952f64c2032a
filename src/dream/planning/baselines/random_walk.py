"""A random walk with bounces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dream.options import First
from dream.planning.parameters import check_range
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


@dataclass(frozen=True, slots=True)
class RandomWalk:
    """Go straight; now and then, and whenever the way ahead is blocked, turn at random.

    What it does: advances by the protocol's longest step. With probability `turn_rate`, or where even
    the shortest step ahead is blocked, it first takes one of the protocol's turns, all equally likely. What
    it draws depends on the seed, the step and the pose, so that walks in other worlds are other walks.

    Reference: the random-walk baseline of UIVNav (arXiv 2309.08806); its turning law is not published, this
    one is ours.

    Assumes: nothing. Fails when: time matters. It never says that it is done.
    """

    turn_rate: First[float] = 0.1
    """Probability of a turn in a step with a free way ahead, 0 to 1."""
    walk_seed: First[int] = 0
    """Seed of the walk: any number makes another."""

    def __post_init__(self) -> None:
        check_range("turn_rate", self.turn_rate, 0.0, 1.0)
        check_range("walk_seed", self.walk_seed, 0, 2**63 - 1)

    def begin(self, mission: Mission) -> _Walk:
        """A fresh walk, the same for the same seed."""
        return _Walk(self, mission)


@dataclass(slots=True)
class _Walk:
    planner: RandomWalk
    mission: Mission
    steps: int = 0

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        protocol = self.mission.protocol
        advance = max(protocol.advances)
        blocked = self._is_blocked(observation, occupancy)
        rng = self._dice(observation)
        self.steps += 1
        if not blocked and rng.random() >= self.planner.turn_rate:
            return Decision(advance=advance, reasoning=Reasoning(action=f"Straight on for {advance:g} m."))
        turn = float(rng.choice([angle for angle in protocol.turn_angles if angle != 0.0]))
        why = "The way ahead is blocked" if blocked else "Time for a change"
        action = f"{why}: a turn of {math.degrees(turn):.0f}°, then on for up to {advance:g} m."
        return Decision(turn, advance, reasoning=Reasoning(action=action))

    def _dice(self, observation: Observation) -> np.random.Generator:
        """A generator for this step alone."""
        pose, protocol = observation.pose, self.mission.protocol
        place = (round(pose.x / protocol.lattice), round(pose.y / protocol.lattice))
        heading = protocol.heading_index(pose.yaw)
        # Seeds are not negative.
        words = [self.planner.walk_seed, self.steps, heading, *(along % 2**32 for along in place)]
        return np.random.default_rng(words)

    def _is_blocked(self, observation: Observation, occupancy: OccupancyMap) -> bool:
        pose, protocol = observation.pose, self.mission.protocol
        offset = protocol.offset(protocol.heading_index(pose.yaw), min(protocol.advances))
        start = np.array([[pose.x, pose.y]])
        return not occupancy.passable(start, start + np.array(offset) * protocol.lattice)[0]
