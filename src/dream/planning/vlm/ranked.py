"""Our own planner with a model: it ranks safe places, and geometry keeps the last word."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dream.geometry import SE2
from dream.options import First
from dream.planning.parameters import check_count, check_range
from dream.planning.vlm.asking import Answer, Asking, Line
from dream.planning.vlm.offline import Offline, Spot, offline_planner
from dream.planning.vlm.reply import Ranking
from dream.planning.vlm.votes import Poll, Vote
from dream.types import Decision, Exchange, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FEWEST = 2
"""Places that make a choice."""
ARRIVED = 0.25
"""Reaches from a place at which it counts as reached."""
STUCK = 6
"""Steps without anything new after which the model is not followed, nor asked, for `REST` steps."""
REST = 10
FIRST = 1.0
"""Steps that the model's choices may have cost before any share of the way is flown."""
AGREES = "as the offline planner would"
LATE = "not heard: by then the mission was about to end"
"""Outcomes of an exchange."""


@dataclass(frozen=True, slots=True)
class Ranked(Asking):
    """Asks a vision-language model to rank safe places when the choice is close; `belief` does all else.

    What it does: `belief` works out where it could go next. When something has changed (it arrived, a region
    was closed, it found nothing new for a while) and some other place is expected to cost no more than
    `margin` steps, a model is shown the map with these places as numbers, the camera's picture, and a table
    of what each would cost and show, and ranks them. Its ranking moves the choice within the margin only,
    and all that it cost by `belief`'s own measure must stay below a share of the steps flown. Before the
    mission ends the model is asked, too. While it thinks, the vehicle takes `belief`'s next steps.

    Reference: set-of-mark prompting (2310.11441); ranking instead of scoring (2503.20241); events as in CORAL
    (2603.14786); a choice among proposals with a fading bonus (2606.20458).

    Assumes: a model that reads pictures. Fails when: never worse than `belief` by much, whatever the model
    says; better only where the model knows more about how targets lie than geometry does.
    """

    spatial: ClassVar[bool] = True

    margin: First[float] = 2.0
    """A place can be chosen if it is expected to cost at most this many steps more than the best one."""
    weight: float = 3.0
    """Worth of the first rank in steps, if the model is sure. The second rank is worth half of it, and so
    on."""
    allowance: float = 0.1
    """Share of the flown steps that the model's choices may cost in all, as belief expects it."""
    votes: int = 1
    """How often each question is asked, each time with other numbers. belief decides where less than two
    thirds of the answers agree."""
    wait: First[bool] = False
    """Stand still until the answer comes, as the paper's vehicle does."""

    def __post_init__(self) -> None:
        Asking.__post_init__(self)
        check_range("margin", self.margin, 0.0, 1000.0)
        check_range("weight", self.weight, 0.0, 1000.0)
        check_range("allowance", self.allowance, 0.0, 10.0)
        check_count("votes", self.votes, 1, 15)
        check_range("wait", self.wait, False, True)

    def begin(self, mission: Mission) -> RankedPilot:
        """A fresh pilot with a line to the model."""
        return RankedPilot(self, mission)


@dataclass(frozen=True, slots=True)
class _Chosen:
    """A place that the vehicle goes to on the model's advice."""

    place: Any
    why: str


@dataclass(slots=True)
class RankedPilot:
    """`Ranked` during one mission."""

    planner: Ranked
    mission: Mission
    line: Line = field(init=False)
    offline: Offline[Any, Any, Any, Any] = field(init=False)
    trail: list[SE2] = field(default_factory=list)
    """Where it decided."""
    asked: Poll | None = None
    chosen: _Chosen | None = None
    spent: float = 0.0
    """Steps that the model's choices have cost, by expectation."""
    heading_for: Spot | None = None
    """What was decided at the last event: until it is reached, or another comes, nobody is asked again."""
    enclosed: int = 0
    """Regions at the last event."""
    achieved: int = 0
    """See `Offline.achieved`."""
    idle: int = 0
    """Steps since more of them were."""
    resting: int = 0
    """Steps for which the offline planner flies alone."""

    def __post_init__(self) -> None:
        self.line = self.planner.line(self.mission.asked)
        self.offline = offline_planner(self.mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """What the model chose, where that holds; else what `belief` does."""
        thought = self.offline.consider(observation, occupancy)
        self._watch(occupancy)
        exchanges: list[Exchange] = []
        waited = 0.0
        # At the end first what is still on its way, which no longer matters, then the question about the end.
        while True:
            if self.asked is None and not self.resting and self._event(thought):
                self._ask(observation, thought, occupancy)
            if self.asked is None or not (answers := self._answers(observation.time, thought)):
                break
            waited = max(waited, self._due(answers) - observation.time)
            asked, self.asked = self.asked, None
            in_time = asked.to_end == (self.offline.own(thought) is None)
            outcome = self._choose(asked, answers, thought) if in_time else LATE
            exchanges += asked.told(outcome, answers)
            if in_time:
                break
        way, why = self._follow(thought)
        self.trail.append(observation.pose)
        decision = self.offline.act(thought, way)
        if why:
            reasoning = decision.reasoning
            reasoning = replace(reasoning, next_target=f"{reasoning.next_target} {why}")
            decision = replace(decision, reasoning=reasoning)
        return replace(decision, exchanges=tuple(exchanges), waited=waited)

    # -------------------------------------------------------------------------------------------- events

    def _watch(self, occupancy: OccupancyMap) -> None:
        """Who goes round in circles on advice goes on without it."""
        now = self.offline.achieved(occupancy)
        self.idle = 0 if now > self.achieved else self.idle + 1
        self.achieved = max(now, self.achieved)
        self.resting = max(self.resting - 1, 0)
        if self.idle >= STUCK and self.chosen is not None:
            self.chosen, self.resting = None, REST

    def _event(self, thought: Any) -> bool:
        """Has something changed that makes the choice a new one?"""
        if self.offline.is_bound(thought):
            return False
        closed, own, here = (
            self.offline.closed(thought),
            self.offline.own(thought),
            self.offline.here(thought),
        )
        more, self.enclosed = closed > self.enclosed, closed
        if own is None:
            # The mission would end: worth a question, once for all that is known.
            return self.chosen is None and self.heading_for != here
        if self.chosen is not None:
            return more
        reach, goal = self.mission.protocol.reach, self.heading_for
        if goal is None or more or self.idle == STUCK:
            return True
        end = self.offline.goal(thought, own)
        return goal.distance(here) <= ARRIVED * reach or goal.distance(end) > reach

    # ------------------------------------------------------------------------------------------- question

    def _ask(self, observation: Observation, thought: Any, occupancy: OccupancyMap) -> None:
        """Ask where the choice is close; remember that it was looked at in any case."""
        own = self.offline.own(thought)
        to_end = own is None
        self.heading_for = self.offline.here(thought) if to_end else self.offline.goal(thought, own)
        most = self._affordable(to_end=to_end)
        choice = [place for place in self.offline.places(thought) if place.loss <= most]
        if len(choice) < (1 if to_end else FEWEST):
            return
        votes = []
        for vote in range(self.planner.votes):
            # Other numbers each time, so that a liking for one of them decides nothing.
            rng = np.random.default_rng([len(self.trail), vote])
            numbers = (1 + rng.permutation(len(choice))).tolist()
            question = self.offline.question(
                observation,
                occupancy,
                thought,
                self.trail,
                dict(zip(numbers, choice, strict=True)),
                self.line.prompts,
            )
            votes.append(Vote({number: k for k, number in enumerate(numbers)}, self.line.ask(question)))
        self.asked = Poll(observation.time, choice, votes, to_end)

    def _answers(self, now: float, thought: Any) -> list[Answer[Ranking]]:
        """All answers, once they are due; earlier where the vehicle waits for them. Empty before."""
        assert self.asked is not None
        # After the last step nobody would hear the answer.
        last = self.mission.flown + len(self.trail) + 1 >= self.mission.max_steps
        waits = self.planner.wait or self.offline.own(thought) is None or last
        if not waits and not self._may_have_come(now):
            return []
        answers = [self.line.insist(vote.pending.answer()) for vote in self.asked.votes]
        return answers if waits or now >= self._due(answers) else []

    def _may_have_come(self, now: float) -> bool:
        """Only a simulated clock stands still while an answer that is due by it is awaited."""
        assert self.asked is not None
        if self.planner.latency is None:
            return all(vote.pending.done() for vote in self.asked.votes)
        return now >= self.asked.at + self.planner.latency

    def _due(self, answers: list[Answer[Ranking]]) -> float:
        """When the last of them has come, on the mission's clock; they are asked side by side."""
        assert self.asked is not None
        return self.asked.at + max(self.line.took(answer.exchange) for answer in answers)

    def _affordable(self, *, to_end: bool) -> float:
        """Steps that a choice may cost now; at the end as many as it may come to cost on the way."""
        flown = self.mission.flown + len(self.trail)
        left = self.planner.allowance * flown + FIRST - self.spent
        return min(self._most if to_end else self.planner.margin, left)

    @property
    def _most(self) -> float:
        """Steps that a choice may come to cost on the way, when something better comes up."""
        return 2.0 * self.planner.margin

    # -------------------------------------------------------------------------------------------- choice

    def _choose(self, asked: Poll, answers: list[Answer[Ranking]], thought: Any) -> str:
        """Fuse the ranking with what the offline planner holds of the places now.

        Returns:
            What came of it, as in `types.Exchange`; `{k}` stands for the number of the place of index k.
        """
        if self.resting:
            return f"not heard: nothing new was seen for {STUCK} steps"
        opinion = asked.opinion(answers)
        if opinion is None:
            return ""
        if not opinion.agrees:
            return "not heard: the votes disagree"
        if asked.to_end and opinion.complete:
            return f"{AGREES}: the mission is complete"
        bonus = opinion.bonus(self.planner.weight)
        # Where it had one, the offline planner's own way is the first: it needs no advice to go there.
        others, own = (0, 0.0) if asked.to_end else (1, bonus[0])
        affordable = self._affordable(to_end=asked.to_end)
        standing, short = [], {} if asked.to_end else {0: "the offline planner's own"}
        for k in range(others, len(asked.places)):
            now = self.offline.again(thought, asked.places[k])
            if now is None:
                short[k] = "where no way leads any more, or nothing is left to see"
            elif now[1] > affordable:
                short[k] = f"which costs {now[1]:.1f} steps, {max(affordable, 0.0):.1f} are allowed"
            else:
                standing.append((round(bonus[k] - now[1], 6), -k, now[1]))
                short[k] = f"which costs {now[1]:.1f} steps, its rank is worth {max(bonus[k] - own, 0.0):.1f}"
        first = opinion.first
        lost = f"place {{{first}}}, {short.get(first, '')}"
        if not standing or max(standing)[0] <= own:
            return AGREES if first < others else f"overruled: {lost}"
        _, behind, loss = max(standing)
        self._take(asked, -behind, loss, *opinion.rank(-behind))
        instead = "the end of the mission" if asked.to_end else "place {0}"
        dearer = "" if -behind == first else f"; its first was {lost}"
        return f"followed: place {{{-behind}}} instead of {instead}{dearer}"

    def _take(self, asked: Poll, k: int, loss: float, number: int, rank: int) -> None:
        """Go to a place from now on."""
        place = asked.places[k]
        self.spent += loss
        self.chosen = _Chosen(
            place,
            f"The model ranked place {number} of {len(asked.places)} "
            f"{_ordinal(rank)}; it costs {loss:.1f} steps by expectation.",
        )
        self.heading_for = self.offline.spot(place)

    def _follow(self, thought: Any) -> tuple[Any, str]:
        """The way to carry out, and why it is not the offline planner's own."""
        if self.offline.is_bound(thought):
            self.chosen = None
        if self.chosen is None:
            return self.offline.own(thought), ""
        now = self.offline.again(thought, self.chosen.place)
        if now is None or now[1] > self._most:
            self.chosen = None
            return self.offline.own(thought), ""
        return now[0], self.chosen.why


def _ordinal(rank: int) -> str:
    names = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")
    return names[rank - 1]
