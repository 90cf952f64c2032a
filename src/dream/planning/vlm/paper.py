"""The paper's planner and its ablation: a model decides every step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from dream.geometry import SE2
from dream.planning import sentences
from dream.planning.belief import Belief
from dream.planning.vlm import pictures, prompts
from dream.planning.vlm.asking import Asking, Line, Question
from dream.planning.vlm.reply import Acting, dream_reply, vanilla_reply
from dream.protocol import SurveyProtocol
from dream.types import Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.planning.belief import BeliefPilot


@dataclass(frozen=True, slots=True)
class Dream(Asking):
    """Asks a vision-language model at every step, with the paper's six reasoning steps in the prompt.

    What it does: shows the model the camera's picture, its depth and labels, and the map; the model reasons
    in six steps and gives an action of the protocol. The vehicle waits for it. Where no valid reply comes in
    time, `belief` decides that step.

    Reference: DREAM (arXiv 2509.13666). Its prompts are not public; these are our own, in
    `planning/prompts`.

    Assumes: a model that reads pictures. Fails when: the model cannot read the map; see `dream probe`.
    """

    def begin(self, mission: Mission) -> _EveryStep:
        """A fresh pilot with a line to the model; it remembers where it was and what the guard changed."""
        return _EveryStep(self, mission, "dream", dream_reply)


@dataclass(frozen=True, slots=True)
class Vanilla(Asking):
    """Asks a vision-language model at every step, and leaves the reasoning to it: the paper's ablation.

    What it does: as `dream`, with the same pictures and actions, but neither guidance nor reasoning steps.

    Reference: the vanilla planner of DREAM (arXiv 2509.13666).

    Assumes: a model that reads pictures. Fails when: the model cannot read the map; see `dream probe`.
    """

    def begin(self, mission: Mission) -> _EveryStep:
        """A fresh pilot; see `Dream.begin`."""
        return _EveryStep(self, mission, "vanilla", vanilla_reply)


@dataclass(slots=True)
class _EveryStep:
    asking: Asking
    mission: Mission
    prompt: str
    reply: Callable[[SurveyProtocol], type[Acting]]
    line: Line = field(init=False)
    offline: BeliefPilot = field(init=False)
    trail: list[SE2] = field(default_factory=list)
    """Where it decided."""
    last: Decision | None = None
    """What it decided last; the guard may have changed it."""

    def __post_init__(self) -> None:
        self.line = self.asking.line(self.mission.asked)
        self.offline = Belief().begin(self.mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        thought = self.offline.consider(observation, occupancy)
        answer = self.line.insist(self.line.ask(self._question(observation, occupancy)).answer())
        exchange = answer.exchange
        if answer.reply is None:
            decision = self.offline.act(thought, thought.plan)
        else:
            decision = _with_its_action(answer.reply.decision)
            exchange = replace(exchange, outcome="followed")
        self.trail.append(observation.pose)
        self.last = decision
        return replace(decision, exchanges=(exchange,), waited=self.line.took(exchange))

    def _question(self, observation: Observation, occupancy: OccupancyMap) -> Question[Acting]:
        protocol, pose = self.mission.protocol, observation.pose
        trail = [(past.x, past.y) for past in (*self.trail, pose)]
        instructions, version = prompts.instructions(self.prompt, self.mission, occupancy, self.line.prompts)
        shown = pictures.png(pictures.map_picture(occupancy, pose, trail))
        return Question(
            version,
            instructions,
            self._situation(pose, occupancy),
            {**pictures.camera_pictures(observation), "map": shown},
            self.reply(protocol),
        )

    def _situation(self, pose: SE2, occupancy: OccupancyMap) -> str:
        """What the pictures do not say."""
        lines = prompts.progress(self.mission, pose, len(self.trail))
        lines += prompts.area(occupancy)
        if self.last is not None:
            lines.append(self._last_action(pose, occupancy))
        return "\n".join(lines)

    def _last_action(self, pose: SE2, occupancy: OccupancyMap) -> str:
        """What came of it: a model that is not told keeps asking for it."""
        from dream.mapping import check_completion

        assert self.last is not None
        if self.last.done:
            still = check_completion(occupancy, pose).open_region
            return f"Done was said, and the map does not agree: {still}." if still else "Done was said."
        words = sentences.action(self.last.turn, self.last.advance)[:-1].lower()
        shortest = min(self.mission.protocol.advances)
        if self.last.advance - self.trail[-1].distance(pose) > 0.5 * shortest:
            return (
                f"The last action was: {words}. That was not safe all the way, so that the robot went only "
                f"{self.trail[-1].distance(pose):.1f} m."
            )
        return f"The last action was: {words}."


def _with_its_action(decision: Decision) -> Decision:
    """With the action in words, where the model gave none."""
    if decision.reasoning.action:
        return decision
    action = "Done." if decision.done else sentences.action(decision.turn, decision.advance)
    return replace(decision, reasoning=replace(decision.reasoning, action=action))
