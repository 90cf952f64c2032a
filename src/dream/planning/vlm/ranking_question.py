"""What a model is asked when it ranks places: the text, the table, and the pictures with numbers in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dream.geometry import SE2
from dream.planning.vlm import pictures, prompts
from dream.planning.vlm.asking import Question
from dream.planning.vlm.places import Place
from dream.planning.vlm.reply import Ranking, ranked_reply
from dream.types import Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.planning.belief import Thought

HISTORY = 8
"""Past positions in the text."""


def ranking_question(
    mission: Mission,
    observation: Observation,
    occupancy: OccupancyMap,
    thought: Thought,
    trail: Sequence[SE2],
    numbered: dict[int, Place],
    own: prompts.Own = prompts.PACKAGED,
) -> Question[Ranking]:
    """The question in which order places are best to go to.

    Args:
        mission: What is looked for, and by which rules.
        observation: What the camera sees.
        occupancy: What is known.
        thought: Of the offline planner, at this moment.
        trail: Where the vehicle decided before.
        numbered: The places by the numbers that they are shown with.
        own: Prompts in the place of the package's, by name.
    """
    from dream.mapping.drawing import Mark

    pose = observation.pose
    instructions, version = prompts.instructions("ranked", mission, occupancy, own, count=str(len(numbered)))
    marks = [Mark(number, place.path) for number, place in sorted(numbered.items())]
    way = [(past.x, past.y) for past in (*trail, pose)]
    camera = pictures.camera_picture(observation)
    for mark in marks:
        pictures.mark_in_view(camera, observation, mark, mission.protocol.altitude)
    shown = pictures.map_picture(occupancy, pose, way, marks)
    return Question(
        version,
        instructions,
        _situation(mission, pose, occupancy, thought, trail, numbered),
        {"map": pictures.png(shown), "camera": pictures.png(camera)},
        ranked_reply(list(numbered)),
    )


def _situation(
    mission: Mission,
    pose: SE2,
    occupancy: OccupancyMap,
    thought: Thought,
    trail: Sequence[SE2],
    numbered: dict[int, Place],
) -> str:
    """What the pictures do not say."""
    past = "; ".join(f"({p.x:g}, {p.y:g})" for p in trail[-HISTORY:]) or "only the start"
    lines = [
        *prompts.progress(mission, pose, len(trail)),
        f"It came by way of: {past}.",
        *thought.told,
        *prompts.area(occupancy),
    ]
    if thought.plan is None:
        lines.append(
            "By the program's own judgement the mission is complete. These places would be left unseen."
        )
    return "\n".join([*lines, "", *table(numbered)])


def table(numbered: dict[int, Place]) -> list[str]:
    """What the program has calculated of each place, as lines of Markdown.

    Args:
        numbered: The places by their numbers.
    """
    columns = (
        "number",
        "position",
        "steps away",
        "looks towards",
        "targets expected, m2",
        "search area cleared, m2",
        "hull patches expected",
        "closes",
    )
    lines = [" | ".join(columns), " | ".join("---" for _ in columns)]
    for number, place in sorted(numbered.items()):
        x, y = place.path[-1]
        plan = place.plan
        cells = (
            str(number),
            f"({x:g}, {y:g})",
            str(place.steps),
            pictures.bearing(SE2(0.0, 0.0, place.yaw)),
            f"{plan.targets:.1f}",
            f"{plan.cleared:.0f}",
            f"{plan.patches:.1f}",
            ", ".join(f"region {k}" for k in place.closes) or "none",
        )
        lines.append(" | ".join(cells))
    return [f"| {line} |" for line in lines]
