"""What the planners say in words: numbers and directions in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.geometry import SE2
from dream.mapping import OccupancyMap, check_completion
from dream.planning import Belief, sentences
from dream.planning.lookahead import Choice
from dream.protocol import DREAM_V1
from dream.types import BoolArray, Mission
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import SIDE, all_but, observed_at

HERE = SE2(-9.0, -9.0, 0.0)
MISSION = Mission(DREAM_V1, AREA, DREAM_V1.cap)


def _cells(*boxes: tuple[slice, slice]) -> BoolArray:
    return ~all_but(*boxes)


def _bar(length: float, degrees: float) -> BoolArray:
    """(rows, cols) cells within 0.3 m of a line of that length through the middle of the map."""
    along = math.radians(degrees)
    north, east = (np.indices((SIDE, SIDE)) + 0.5) * DREAM_V1.cell - 0.5 * AREA.width
    ahead = east * math.cos(along) + north * math.sin(along)
    aside = north * math.cos(along) - east * math.sin(along)
    bar: BoolArray = (np.abs(ahead) <= 0.5 * length) & (np.abs(aside) <= 0.3)
    return bar


def _said_of(occupancy: OccupancyMap) -> str:
    return sentences.distribution(occupancy, check_completion(occupancy, HERE))


# ---------------------------------------------------------------------------------------------- distribution


@pytest.mark.parametrize(
    ("box", "said"),
    [
        (np.s_[48:49, 30:49], "5 m long towards east around (-2.1, 0.1)"),
        (np.s_[30:50, 48:49], "5 m long towards north around (0.1, -2.0)"),
        (np.s_[40:44, 10:58], "12 m long towards east around (-3.5, -1.5)"),
    ],
)
def test_a_region_is_as_long_as_its_row_of_cells_from_edge_to_edge(
    box: tuple[slice, slice], said: str
) -> None:
    target = _cells(box)
    area = float(target.sum()) * DREAM_V1.cell**2
    occupancy = map_with(explored=all_but(), target=target)
    assert (
        _said_of(occupancy)
        == f"Targets cover {area:.1f} m² in one region, {said}; 100% of the area is explored."
    )


@pytest.mark.parametrize(
    ("degrees", "direction"),
    [
        (0, "east"),
        (17, "east"),
        (28, "northeast"),
        (45, "northeast"),
        (62, "northeast"),
        (73, "north"),
        (90, "north"),
        (107, "north"),
        (118, "northwest"),
        (135, "northwest"),
        (152, "northwest"),
        (163, "east"),
        (175, "east"),
    ],
)
def test_a_region_lies_along_the_nearest_of_four_directions_and_a_half_turn_is_none(
    degrees: int, direction: str
) -> None:
    occupancy = map_with(explored=all_but(), target=_bar(10.0, degrees))
    assert f" m long towards {direction} around (" in _said_of(occupancy)


def test_a_slanting_region_is_as_long_as_it_is_along_its_own_axis() -> None:
    diagonal = np.eye(SIDE, dtype=np.bool_)
    diagonal[:20] = diagonal[60:] = False
    length = 39 * math.sqrt(2.0) * DREAM_V1.cell + DREAM_V1.cell
    for target, direction in ((diagonal, "northeast"), (diagonal[:, ::-1], "northwest")):
        said = _said_of(map_with(explored=all_but(), target=target))
        assert f"{length:.0f} m long towards {direction}" in said
    assert round(length) == 14, "not the 10 m of its box"


def test_of_several_regions_the_largest_is_told() -> None:
    target = _cells(np.s_[10:12, 10:14], np.s_[60:62, 50:82])
    said = _said_of(map_with(explored=all_but(), target=target))
    assert said == (
        "Targets cover 4.5 m² in 2 regions, the largest 8 m long towards east around (4.5, 3.2); "
        "100% of the area is explored."
    )


# ------------------------------------------------------------------------------------- current target area


def test_where_all_known_regions_are_closed_it_says_so() -> None:
    occupancy = map_with(explored=all_but(np.s_[:20, 70:]), target=_cells(np.s_[60:64, 8:12]))
    said = Belief().begin(MISSION).decide(observed_at(0.0, 0.0, 0.0), occupancy).reasoning
    assert said.target_area == "None: every known region is enclosed."


def test_where_no_target_was_found_there_is_nothing_to_work_on() -> None:
    occupancy = map_with(explored=all_but(np.s_[:20, 70:]))
    said = Belief().begin(MISSION).decide(observed_at(0.0, 0.0, 0.0), occupancy).reasoning
    assert said.target_area == "None: nothing to work on yet."


@pytest.mark.parametrize(("x", "nearest"), [(-9.0, -8.5), (9.0, 8.5)])
def test_of_two_open_regions_the_nearest_is_named_as_that(x: float, nearest: float) -> None:
    """Each has one cell at its edge that nothing observed."""
    west, east = np.s_[47:49, 13:15], np.s_[47:49, 81:83]
    unknown = all_but(np.s_[49:50, 13:14], np.s_[49:50, 82:83])
    occupancy = map_with(explored=unknown, target=_cells(west, east))
    said = Belief().begin(MISSION).decide(observed_at(x, -4.0, 0.0), occupancy).reasoning.target_area
    assert (
        said
        == f"The nearest open region, around ({nearest}, 0.0), with 1 unknown cell at its edge or inside."
    )


# -------------------------------------------------------------------------------- completion and the end


def test_ground_that_was_given_up_is_told_by_its_area_and_only_where_there_is_any() -> None:
    assert sentences.not_counted(0.0) == ""
    assert (
        sentences.not_counted(1.25) == " 1.2 m² that never came into view were given up and are not counted."
    )
    assert "0.003 m²" in sentences.not_counted(0.05**2), "a cell of a tank is no more than that"
    assert sentences.enough(0.0) == "Every region is enclosed and little can have been missed: done."
    assert sentences.enough(0.4375).endswith(
        "little can have been missed, but for 0.4 m² that were given up: done."
    )
    assert sentences.nothing_left(0.0) == "Nothing is left that any known way leads to a view of: done."
    assert sentences.nothing_left(12.0) == (
        "Nothing is left that any known way leads to a view of; "
        "12.0 m² that never came into view were given up: done."
    )


# --------------------------------------------------------------------------------------------- next target


@pytest.mark.parametrize(
    ("between", "said"),
    [
        (
            Choice(0.6, 48, shown=26.61, after=1.557, rate=6.464, view=4.1),
            "It is worth most of 48 sequences of actions, 26.6 weighted m² of targets on its way and 1.56 "
            "by the tour after it; its best stretch gives 6.46 a step, at least 60% of the "
            "best single view's 4.1.",
        ),
        (
            Choice(0.6, 3, shown=1.0, after=250.4, rate=0.5),
            "It is worth most of 3 sequences of actions, 1 weighted m² of targets on its way and 250 by "
            "the tour after it; there is no single view to go to instead.",
        ),
        (
            Choice(0.6, 48, shown=0.2, after=0.1, rate=0.1, view=0.2),
            "It is the best single view for its distance, 0.2 weighted m² of targets a step; "
            "the best sequence of actions gives 0.1 at most, less than 60% of that.",
        ),
        (
            Choice(0.6, 48, view=0.00005),
            "It is the best single view for its distance, almost 0 weighted m² of targets a step; "
            "no sequence of the next actions shows anything.",
        ),
    ],
)
def test_it_says_why_it_goes_there_by_what_it_compared(between: Choice, said: str) -> None:
    assert sentences.choice(between) == said


@pytest.mark.parametrize(
    ("rate", "view", "jump", "straight"),
    [
        (0.6, 1.0, 0.6, False),
        (0.59, 1.0, 0.6, True),
        (1.0, 0.0, 0.6, False),
        (0.0, 1.0, 0.0, True),
        (1e-5, 1.0, 0.0, False),
    ],
)
def test_the_view_is_gone_for_where_the_sequence_gives_less_than_its_share_or_nothing(
    rate: float, view: float, jump: float, straight: bool
) -> None:
    assert Choice(jump, 48, rate=rate, view=view).straight == straight
