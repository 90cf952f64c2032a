"""The picture of the map."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap, draw_map
from dream.mapping.drawing import (
    EXPLORED,
    FOR_PEOPLE,
    MARK,
    OUTLINE,
    SOLID,
    SOLID_TARGET,
    TARGET,
    UNKNOWN,
    VEHICLE,
    draw_areas,
    inset,
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


DEUTERANOPIA = np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]])
"""Linear RGB as one sees it who lacks the cones for green (Machado, Oliveira and Fernandes 2009)."""
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ.sum(axis=1)


def lab(color: tuple[int, ...], *, deuteranope: bool = False) -> npt.NDArray[np.float64]:
    """CIELAB of an sRGB colour."""
    share = np.array(color) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(DEUTERANOPIA @ linear, 0.0, 1.0) if deuteranope else linear
    xyz = TO_XYZ @ seen / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16.0) / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def test_people_tell_the_colours_apart_without_green_and_in_grey() -> None:
    names = ("unknown", "crossed", "explored", "solid_target", "target", "traversed", "solid")
    colors = {name: getattr(FOR_PEOPLE, name) for name in names}
    for one, other in itertools.combinations(names, 2):
        apart = np.linalg.norm(lab(colors[one], deuteranope=True) - lab(colors[other], deuteranope=True))
        grey = abs(lab(colors[one])[0] - lab(colors[other])[0])
        if {one, other} == {"unknown", "crossed"}:
            continue  # Both are ground that was not seen.
        assert apart > 13.0, (one, other)
        assert grey > 10.0, (one, other)


def test_people_see_targets_in_the_field_of_view_in_their_own_colour() -> None:
    everywhere = np.ones((96, 96), np.bool_)
    target = np.zeros((96, 96), np.bool_)
    target[60:66, 40:60] = True
    occupancy = map_with(explored=everywhere, target=target)
    pose = SE2(0.0, 0.0, math.pi / 2.0)
    plain = np.asarray(draw_map(occupancy, palette=FOR_PEOPLE))
    watched = np.asarray(draw_map(occupancy, pose, palette=FOR_PEOPLE))
    legend = 64  # pixels of the target's colour in the legend, about
    assert count(watched, FOR_PEOPLE.target) > 0.8 * count(plain, FOR_PEOPLE.target) > 10 * legend
    # What models are shown stays tinted.
    assert count(np.asarray(draw_map(occupancy, pose)), TARGET) < 0.2 * count(
        np.asarray(draw_map(occupancy)), TARGET
    )


def test_the_inset_is_where_the_map_is_drawn() -> None:
    bounds = Bounds(-10.0, -6.0, 14.0, 8.0)
    occupancy = OccupancyMap(bounds, DREAM_V1)
    found = inset(bounds, DREAM_V1)
    picture = np.asarray(draw_map(occupancy, palette=FOR_PEOPLE))
    assert picture.shape[1::-1] == found.picture
    top, left = found.top, found.left
    cells = picture[top : top + found.height, left : left + found.width]
    lines = (cells != FOR_PEOPLE.unknown).any(axis=-1)
    across = [round(share * found.width) for _, share in found.across]
    down = [round(share * found.height) for _, share in found.down]
    assert set(np.flatnonzero(lines.all(axis=0))) == set(across) - {0, found.width}
    assert set(np.flatnonzero(lines.all(axis=1))) == set(down) - {0, found.height}
    assert [metres for metres, _ in found.across] == [-10.0, -5.0, 0.0, 5.0, 10.0]
    assert [metres for metres, _ in found.down] == [5.0, 0.0, -5.0]
