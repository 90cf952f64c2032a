"""The paper's planner and its ablation: a model decides every step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

from dream.geometry import SE2
from dream.planning import sentences
from dream.planning.space import words
from dream.planning.vlm import pictures, prompts
from dream.planning.vlm.asking import Asking, Line, Question
from dream.planning.vlm.heights import heights
from dream.planning.vlm.offline import Offline, offline_planner
from dream.planning.vlm.reply import Acting, dream_reply, vanilla_reply
from dream.protocol import SurveyProtocol
from dream.types import Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


@dataclass(frozen=True, slots=True)
class Dream(Asking):
    """Asks a vision-language model at every step, with the paper's six reasoning steps in the prompt.

    What it does: shows the model the camera's picture, its depth and labels, and the map; the model reasons
    in six steps and gives an action of the protocol. The vehicle waits for it. Where no valid reply comes in
    time, `belief` decides that step, in space `sixsteps`. There the model is shown two cuts through what is
    known of the water, too, and climbs and tilts the camera.

    Reference: DREAM (arXiv 2509.13666). Its prompts are not public; these are our own, in
    `planning/prompts`.

    Assumes: a model that reads pictures. Fails when: the model cannot read the map; see `dream probe`.
    """

    spatial: ClassVar[bool] = True

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

    spatial: ClassVar[bool] = True

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
    offline: Offline[Any, Any, Any, Any] = field(init=False)
    trail: list[SE2] = field(default_factory=list)
    """Where it decided."""
    height: float = 0.0
    """World z where it decided last."""
    last: Decision | None = None
    """What it decided last; the guard may have changed it."""

    def __post_init__(self) -> None:
        self.line = self.asking.line(self.mission.asked)
        self.offline = offline_planner(self.mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        thought = self.offline.consider(observation, occupancy)
        answer = self.line.insist(self.line.ask(self._question(observation, occupancy)).answer())
        exchange = answer.exchange
        if answer.reply is None:
            decision = self.offline.act(thought, self.offline.own(thought))
        else:
            decision = self._with_its_action(answer.reply.decision)
            exchange = replace(exchange, outcome="followed")
        self.trail.append(observation.pose)
        self.last, self.height = decision, observation.z
        return replace(decision, exchanges=(exchange,), waited=self.line.took(exchange))

    def _question(self, observation: Observation, occupancy: OccupancyMap) -> Question[Acting]:
        protocol, pose = self.mission.protocol, observation.pose
        trail = [(past.x, past.y) for past in (*self.trail, pose)]
        instructions, version = prompts.instructions(self.prompt, self.mission, occupancy, self.line.prompts)
        shown = pictures.camera_pictures(observation)
        shown["map"] = pictures.png(pictures.map_picture(occupancy, pose, trail))
        if protocol.space is not None:
            shown |= pictures.cuts(occupancy, observation, trail)
        return Question(
            version, instructions, self._situation(observation, occupancy), shown, self.reply(protocol)
        )

    def _situation(self, observation: Observation, occupancy: OccupancyMap) -> str:
        """What the pictures do not say."""
        lines = prompts.progress(self.mission, observation.pose, len(self.trail))
        if occupancy.volume is not None:
            lines += heights(occupancy.volume, observation, self.mission.protocol.body_radius)
        lines += prompts.area(occupancy)
        if self.last is not None and self.mission.protocol.space is None:
            lines.append(self._last_action(observation.pose, occupancy))
        elif self.last is not None:
            lines.append(self._last_action_in_space(self.last, observation))
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

    def _last_action_in_space(self, last: Decision, observation: Observation) -> str:
        """What came of it, with the height."""
        protocol = self.mission.protocol
        asked = words.action(last.turn, last.advance, last.climb, last.tilt)
        asked = f"The last action was: {asked[0].lower()}{asked[1:-1]}."
        ahead, up = self.trail[-1].distance(observation.pose), observation.z - self.height
        short = last.advance - ahead > 0.5 * min(protocol.advances)
        if short or abs(last.climb - up) > 0.5 * protocol.lattice:
            went = "stayed where it is" if max(ahead, abs(up)) < 0.1 else f"went only {_went(ahead, up)}"
            asked += f" That was not safe all the way, so that the robot {went}."
        return asked

    def _with_its_action(self, decision: Decision) -> Decision:
        """With the action in words, where the model gave none."""
        if decision.reasoning.action:
            return decision
        if decision.done:
            action = "Done."
        elif self.mission.protocol.space is None:
            action = sentences.action(decision.turn, decision.advance)
        else:
            action = words.action(decision.turn, decision.advance, decision.climb, decision.tilt)
        return replace(decision, reasoning=replace(decision.reasoning, action=action))


def _went(ahead: float, up: float) -> str:
    """Metres ahead, and up or down where there are any."""
    if abs(up) < 0.1:
        return f"{ahead:.1f} m ahead"
    return f"{ahead:.1f} m ahead and {abs(up):.1f} m {'up' if up > 0.0 else 'down'}"
