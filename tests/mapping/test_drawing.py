"""The picture of the map."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap, draw_map
from dream.mapping.drawing import (
    EXPLORED,
    MARK,
    OUTLINE,
    SOLID,
    SOLID_TARGET,
    TARGET,
    UNKNOWN,
    VEHICLE,
    draw_areas,
)
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.types import Label
from tests.mapping.analytic import Disc, Pillar, empty_map, look_around, map_with, wall


def pixel(occupancy: OccupancyMap, picture: npt.NDArray[np.uint8], x: float, y: float) -> tuple[int, ...]:
    """Colour at a world position; the map begins right of and below the first frame line's pixels."""
    frame = np.argwhere((picture == (40, 40, 40)).all(axis=-1))
    top, left = frame.min(axis=0)[0] + 2, frame[frame[:, 0] == frame.min(axis=0)[0]].min(axis=0)[1] + 2
    row, col = occupancy.cell_of(x, y)
    down = (occupancy.shape[0] - 1 - int(row)) * 4 + 2
    return tuple(int(channel) for channel in picture[top + down, left + int(col) * 4 + 2])


def test_north_is_up_and_each_cell_has_the_colour_of_what_it_is() -> None:
    occupancy = empty_map()
    look_around(
        occupancy, 0.0, 0.0, Pillar(3.1, 3.1, 0.6, 3.0), Disc(-3.0, 4.1, 1.0), wall(6.1, label=Label.TARGET)
    )
    picture = np.asarray(draw_map(occupancy))
    assert pixel(occupancy, picture, -3.1, 4.1) == TARGET
    assert pixel(occupancy, picture, 2.7, 2.7) == SOLID
    assert pixel(occupancy, picture, 6.12, 0.6) == SOLID_TARGET
    assert pixel(occupancy, picture, -3.0, -3.0) == EXPLORED
    assert pixel(occupancy, picture, 11.0, -11.0) == UNKNOWN


def test_the_vehicle_and_its_way_are_drawn_where_they_are() -> None:
    occupancy = map_with(explored=np.ones((96, 96), np.bool_))
    picture = np.asarray(
        draw_map(occupancy, SE2(4.0, 2.0, math.pi / 2.0), [[-4.0, 2.1], [0.0, 2.1], [4.0, 2.1]])
    )
    assert pixel(occupancy, picture, 4.05, 2.3) == VEHICLE
    red, _, blue = pixel(occupancy, picture, -2.0, 2.1)
    assert blue > 200 > red
    # Inside the cone the cells show through, a little bluer; behind the vehicle they are as they were.
    red, _, blue = pixel(occupancy, picture, 4.3, 7.3)
    assert red < 127 < blue
    assert pixel(occupancy, picture, 4.3, -2.3) == EXPLORED


def test_drawing_leaves_the_map_alone_and_is_the_same_every_time() -> None:
    occupancy = empty_map()
    look_around(occupancy, 0.0, 0.0)
    before = occupancy.explored.copy()
    first = draw_map(occupancy, SE2(0.0, 0.0, 0.0), [(0.0, 0.0)])
    assert first.tobytes() == draw_map(occupancy, SE2(0.0, 0.0, 0.0), [(0.0, 0.0)]).tobytes()
    np.testing.assert_array_equal(occupancy.explored, before)


def test_the_size_depends_on_shape_and_scale_only() -> None:
    occupancy = empty_map()
    size = draw_map(occupancy).size
    assert draw_map(occupancy, SE2(-11.0, 11.0, 2.0), [(50.0, 50.0), (-80.0, 3.0)]).size == size
    assert draw_map(occupancy, scale=8).size[0] > size[0]


def count(picture: npt.NDArray[np.uint8], color: tuple[int, int, int]) -> int:
    return int((picture == color).all(axis=-1).sum())


@pytest.mark.parametrize("scale", [4, 8])
@pytest.mark.parametrize("protocol", [DREAM_V1, POOL_V1])
def test_the_frame_around_an_area_is_explained_where_there_is_one(
    protocol: SurveyProtocol, scale: int
) -> None:
    side = 100 * protocol.cell
    occupancy = OccupancyMap(Bounds(0.0, 0.0, side, side), protocol)
    plain = draw_map(occupancy, scale=scale)
    assert count(np.asarray(plain), OUTLINE) == 0
    occupancy.restrict(Bounds(0.0, 0.0, 0.5 * side, side))
    framed = draw_map(occupancy, scale=scale)
    assert framed.size == plain.size
    legend = np.asarray(framed)[-30:]
    assert count(legend, OUTLINE) > 16
    # Its name is written in full: there is paper to the right of it.
    assert (legend[:, -4:] == legend[0, -1]).all()


def test_areas_are_drawn_with_their_numbers_and_sentences_and_nothing_that_is_not_there() -> None:
    bounds = Bounds(-10.0, -10.0, 10.0, 10.0)
    east = Bounds(0.0, -10.0, 10.0, 10.0)

    def drawn(areas: list[Bounds | None], lines: list[str]) -> npt.NDArray[np.uint8]:
        return np.asarray(draw_areas(bounds, DREAM_V1, areas, lines))

    one = drawn([east], ["1. Map the east."])
    for color in (EXPLORED, TARGET, SOLID, SOLID_TARGET, VEHICLE, MARK):
        assert count(one, color) == 0
    assert count(one, OUTLINE) > 100
    # One that has no place is told of and not drawn; a number is.
    told = drawn([east, None], ["1. Map the east."])
    assert (told == one).all()
    assert count(drawn([east, east], ["1. Map the east."]), OUTLINE) > count(one, OUTLINE)
    lines = drawn([east], ["1. Map the east.", "2. A side of it."])
    long = drawn([east], ["1. " + "Map the east. " * 20])
    assert one.shape[0] < lines.shape[0] < long.shape[0]
    assert lines.shape[1] == long.shape[1] == one.shape[1]
    assert (long[:, -4:] == long[-1, -1]).all()


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="scale: expected at least 1 pixel per cell, got 0"):
        draw_map(empty_map(), scale=0)
    with pytest.raises(ValueError, match=r"trail: expected \(N, 2\) metres, got \(3,\)"):
        draw_map(empty_map(), trail=[1.0, 2.0, 3.0])
