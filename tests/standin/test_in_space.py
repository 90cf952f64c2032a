"""Pictures of three dimensions are read as they were drawn; those that do not belong together are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE3
from dream.planning.vlm import pictures
from dream.planning.vlm.heights import heights
from dream.planning.vlm.offline import offline_planner
from dream.planning.vlm.reply import dream_reply, vanilla_reply
from dream.standin import eyes, sight
from dream.standin.rules import answer
from dream.standin.sight import UnreadableError
from dream.standin.upright import read_upright
from tests.planning.vlm.in_space import PROTOCOL, flown, mission
from tests.standin.sheets import recolored, request

PLAIN = vanilla_reply(PROTOCOL)


@cache
def shown() -> dict[str, bytes]:
    observation, occupancy = flown()
    here = [(observation.pose.x, observation.pose.y)]
    drawn = pictures.png(pictures.map_picture(occupancy, observation.pose, here))
    return {
        **pictures.camera_pictures(observation),
        "map": drawn,
        **pictures.cuts(occupancy, observation, here),
    }


def text() -> str:
    observation, occupancy = flown()
    assert occupancy.volume is not None
    pose = observation.pose
    place = f"The robot is at x = {pose.x:g} m, y = {pose.y:g} m and heads towards {pictures.bearing(pose)}."
    return "\n".join([place, *heights(occupancy.volume, observation, PROTOCOL.body_radius)])


def asked(**changed: bytes) -> dict[str, Any]:
    return answer(request(PLAIN, shown() | changed, text()))


@pytest.mark.rare
def test_an_action_fits_its_schema_and_says_climb_and_tilt() -> None:
    said = asked()
    PLAIN.model_validate(said)
    assert {"climb_m", "tilt_deg"} <= set(said)
    reasoned = answer(request(dream_reply(PROTOCOL), shown(), text()))
    dream_reply(PROTOCOL).model_validate(reasoned)
    assert {field: reasoned[field] for field in said} == said


def test_an_upright_cut_is_read_as_the_volume_is() -> None:
    observation, occupancy = flown()
    assert occupancy.volume is not None
    read = read_upright(sight.decode(shown()["slice"], "slice"))
    assert read.depth == pytest.approx(-observation.z, abs=0.05)
    ahead, up = (v.ravel() for v in np.meshgrid(np.arange(-4.0, 11.0, 0.5), np.arange(-1.5, 2.0, 0.5)))
    yaw = observation.pose.yaw
    points = np.column_stack(
        [
            observation.pose.x + ahead * math.cos(yaw),
            observation.pose.y + ahead * math.sin(yaw),
            observation.z + up,
        ]
    )
    state = occupancy.volume.state(points)
    found = read.look(ahead, -observation.z - up)
    assert ((found == sight.FREE) == (state == 1)).mean() > 0.95
    assert ((found == sight.UNKNOWN) == (state == 0)).mean() > 0.95


def test_a_level_cut_is_read_where_the_map_is() -> None:
    observation, occupancy = flown()
    level = eyes.read_map(sight.decode(shown()["level"], "level"), eyes.LEVEL, "level")
    assert math.hypot(level.x - observation.pose.x, level.y - observation.pose.y) < 0.2
    assert level.cells.shape == occupancy.shape
    free = level.cells[::-1] == sight.FREE
    assert 0.0 < free.mean() < 0.5
    row, col = np.argwhere(free)[len(np.argwhere(free)) // 2]
    x = occupancy.bounds.x_min + (col + 0.5) * PROTOCOL.cell
    y = occupancy.bounds.y_min + (row + 0.5) * PROTOCOL.cell
    assert occupancy.volume is not None
    assert occupancy.volume.state(np.array([[x, y, observation.z - 0.1]]))[0] == 1


@pytest.mark.parametrize("missing", ["map", "level", "slice"])
def test_a_picture_that_is_missing_is_missed(missing: str) -> None:
    kept = {name: file for name, file in shown().items() if name != missing}
    with pytest.raises(UnreadableError, match=rf"\[{missing}\]: expected a picture"):
        answer(request(PLAIN, kept, text()))


@pytest.mark.parametrize("one, other", [("map", "level"), ("level", "slice"), ("map", "slice")])
def test_pictures_that_are_swapped_are_noticed(one: str, other: str) -> None:
    with pytest.raises(UnreadableError):
        asked(**{one: shown()[other], other: shown()[one]})


def test_a_cut_from_another_place_or_depth_is_refused() -> None:
    observation, occupancy = flown()
    pose = observation.pose
    here = [(pose.x, pose.y)]
    deeper = replace(observation, T_world_base=SE3.level(pose.x, pose.y, observation.z - 1.0, pose.yaw))
    with pytest.raises(UnreadableError, match="m under water as the text says"):
        asked(slice=pictures.cuts(occupancy, deeper, here)["slice"])
    turned = replace(
        observation, T_world_base=SE3.level(pose.x, pose.y, observation.z, pose.yaw + 0.5 * math.pi)
    )
    with pytest.raises(UnreadableError, match=r"\[level\], \[map\]: expected one sheet"):
        asked(level=pictures.cuts(occupancy, turned, here)["level"])


def test_cuts_that_contradict_each_other_are_refused() -> None:
    level = sight.decode(shown()["level"], "level")
    free, unknown = sight.COLORS_IN_SPACE[sight.FREE], sight.COLORS_IN_SPACE[sight.UNKNOWN]
    # Water that was looked into is said to be unknown; in view it is tinted, which this does not touch.
    upright = sight.decode(shown()["slice"], "slice")
    dry = recolored(upright, free, unknown)
    with pytest.raises(UnreadableError, match=r"\[level\], \[slice\]: expected the same water"):
        asked(slice=pictures.png(_picture(dry)), level=pictures.png(_picture(level)))


def test_a_color_that_means_nothing_is_refused() -> None:
    upright = sight.decode(shown()["slice"], "slice")
    strange = recolored(upright, sight.COLORS_IN_SPACE[sight.FREE], (230, 20, 20))
    with pytest.raises(UnreadableError, match=r"\[slice\]: expected the colours of its legend"):
        asked(slice=pictures.png(_picture(strange)))


def _picture(pixels: np.ndarray[Any, np.dtype[np.uint8]]) -> Any:
    from PIL import Image

    return Image.fromarray(pixels)


# ------------------------------------------------------------------------------------------------- rankings


@cache
def ranking() -> tuple[Any, dict[int, Any]]:
    """A question about places in space, and the places."""
    observation, occupancy = flown()
    offline = offline_planner(mission())
    thought = offline.consider(observation, occupancy)
    numbered = dict(enumerate(offline.places(thought)[:4], start=1))
    return offline.question(observation, occupancy, thought, [], numbered, {}), numbered


def ranked(text: str | None = None, **changed: bytes) -> dict[str, Any]:
    question, _ = ranking()
    pictures = {**question.pictures, **changed}
    return answer(request(question.reply, pictures, question.text if text is None else text))


def test_places_in_space_are_ranked_by_what_the_table_says_they_show_for_their_steps() -> None:
    question, numbered = ranking()
    assert len(numbered) >= 2
    said = ranked()
    question.reply.model_validate(said)
    worth = {
        number: (p.shows["target"] + 0.5 * p.shows["unknown"] + 0.1 * p.shows["ground"]) / max(p.steps, 1)
        for number, p in numbered.items()
    }
    best = said["ranking"][0]
    assert worth[best] == pytest.approx(max(worth.values()), abs=0.1)


def test_a_depth_or_a_place_of_the_table_that_the_map_does_not_show_is_refused() -> None:
    question, numbered = ranking()
    place = numbered[1]
    x, y, z = place.position
    row = f"| 1 | ({x:g}, {y:g}) | {-z:g} |"
    assert row in question.text
    with pytest.raises(UnreadableError, match=r"expected 3\.25 m beside the disc of place 1"):
        ranked(question.text.replace(row, f"| 1 | ({x:g}, {y:g}) | 3.25 |"))
    with pytest.raises(UnreadableError, match="expected place 1 at"):
        ranked(question.text.replace(row, f"| 1 | ({x + 3.0:g}, {y + 3.0:g}) | {-z:g} |"))
