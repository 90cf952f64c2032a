"""What a model is asked when it ranks places: the text, the table, and the pictures with numbers in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from dream.geometry import SE2
from dream.planning.space import words
from dream.planning.vlm import pictures, prompts
from dream.planning.vlm.asking import Question
from dream.planning.vlm.heights import heights
from dream.planning.vlm.places import Place, SpacePlace
from dream.planning.vlm.reply import Ranking, ranked_reply
from dream.types import Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.drawing import Mark
    from dream.planning.belief import Thought

HISTORY = 8
"""Past positions in the text."""
ENDS = "By the program's own judgement the mission is complete. These places would be left unseen."


def ranking_question(
    mission: Mission,
    observation: Observation,
    occupancy: OccupancyMap,
    thought: Thought,
    trail: Sequence[SE2],
    numbered: Mapping[int, Place],
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

    ground = observation.T_world_base.translation[2] - mission.protocol.altitude
    marks = [
        (Mark(number, place.path), (*place.path[-1].tolist(), ground))
        for number, place in sorted(numbered.items())
    ]
    text = _situation(mission, observation.pose, occupancy, thought, trail, numbered)
    return _question(mission, observation, occupancy, trail, marks, text, own)


def ranking_question_in_space(
    mission: Mission,
    observation: Observation,
    occupancy: OccupancyMap,
    trail: Sequence[SE2],
    numbered: Mapping[int, SpacePlace],
    own: prompts.Own = prompts.PACKAGED,
    *,
    ends: bool,
) -> Question[Ranking]:
    """The same for places in three dimensions, whose depth stands beside their discs.

    Args:
        mission: See `ranking_question`, as of the others.
        observation: Likewise.
        occupancy: With a volume.
        trail: Likewise.
        numbered: Likewise.
        own: Likewise.
        ends: Whether the offline planner would end the mission.
    """
    from dream.mapping.drawing import Mark

    assert occupancy.volume is not None
    marks = [
        (Mark(number, place.path[:, :2], f"{-place.position[2]:g} m"), place.position)
        for number, place in sorted(numbered.items())
    ]
    lines = [
        *_came(mission, observation.pose, trail),
        *heights(occupancy.volume, observation, mission.protocol.body_radius),
        *prompts.area(occupancy),
        *([ENDS] if ends else []),
        "",
        *table_in_space(numbered),
    ]
    return _question(mission, observation, occupancy, trail, marks, "\n".join(lines), own)


def _question(
    mission: Mission,
    observation: Observation,
    occupancy: OccupancyMap,
    trail: Sequence[SE2],
    marks: Sequence[tuple[Mark, tuple[float, float, float]]],
    text: str,
    own: prompts.Own,
) -> Question[Ranking]:
    """With the pictures; each mark with its place in the camera's picture, metres in the world."""
    pose = observation.pose
    instructions, version = prompts.instructions("ranked", mission, occupancy, own, count=str(len(marks)))
    way = [(past.x, past.y) for past in (*trail, pose)]
    camera = pictures.camera_picture(observation)
    for mark, place in marks:
        pictures.mark_in_view(camera, observation, mark.number, place)
    shown = pictures.map_picture(occupancy, pose, way, [mark for mark, _ in marks])
    return Question(
        version,
        instructions,
        text,
        {"map": pictures.png(shown), "camera": pictures.png(camera)},
        ranked_reply([mark.number for mark, _ in marks]),
    )


def _situation(
    mission: Mission,
    pose: SE2,
    occupancy: OccupancyMap,
    thought: Thought,
    trail: Sequence[SE2],
    numbered: Mapping[int, Place],
) -> str:
    """What the pictures do not say."""
    lines = [*_came(mission, pose, trail), *thought.told, *prompts.area(occupancy)]
    if thought.plan is None:
        lines.append(ENDS)
    return "\n".join([*lines, "", *table(numbered)])


def _came(mission: Mission, pose: SE2, trail: Sequence[SE2]) -> list[str]:
    """Where the vehicle is, and which way it came."""
    past = "; ".join(f"({p.x:g}, {p.y:g})" for p in trail[-HISTORY:]) or "only the start"
    return [*prompts.progress(mission, pose, len(trail)), f"It came by way of: {past}."]


def table(numbered: Mapping[int, Place]) -> list[str]:
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
    rows = []
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
        rows.append(cells)
    return _lines(columns, rows)


def table_in_space(numbered: Mapping[int, SpacePlace]) -> list[str]:
    """The same of places in three dimensions.

    Args:
        numbered: The places by their numbers.
    """
    columns = (
        "number",
        "position",
        "depth, m",
        "steps away",
        "looks towards",
        "camera",
        "target to inspect, m2",
        "unknown beside target, m2",
        "new ground, m2",
    )
    rows = []
    for number, place in sorted(numbered.items()):
        x, y, z = place.position
        cells = (
            str(number),
            f"({x:g}, {y:g})",
            f"{-z:g}",
            str(place.steps),
            pictures.bearing(SE2(0.0, 0.0, place.yaw)),
            words.tilted(place.tilt),
            *(f"{place.shows[kind]:.1f}" for kind in ("target", "unknown", "ground")),
        )
        rows.append(cells)
    return _lines(columns, rows)


def _lines(columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """A table in Markdown."""
    return [f"| {' | '.join(cells)} |" for cells in (columns, ("---",) * len(columns), *rows)]
