"""What the stand-in reads is what was drawn; what is hidden from it, it does not read."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from dream.geometry import SE2, Bounds
from dream.mapping.drawing import draw_disc
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.standin import sight
from dream.standin.eyes import read_map
from dream.standin.marks import read_marks
from dream.standin.sight import UnreadableError
from tests.standin.sheets import GRAY_GREEN, drawn, map_of, off, painted, random_cells, recolored

AREA = Bounds(-12.0, -12.0, 12.0, 12.0)
ARENAS = [
    (AREA, DREAM_V1),
    (Bounds(-20.0, -20.0, 20.0, 20.0), DREAM_V1),
    (Bounds(-30.0, -15.0, 30.0, 15.0), DREAM_V1),
    (Bounds(0.0, 0.0, 60.0, 60.0), DREAM_V1),
    (Bounds(-1.85, -1.85, 1.85, 1.85), POOL_V1),
    (Bounds(0.0, 0.0, 3.7, 3.7), POOL_V1),
]


def full(bounds: Bounds, protocol: SurveyProtocol, seed: int) -> np.ndarray:
    shape = round(bounds.depth / protocol.cell), round(bounds.width / protocol.cell)
    return random_cells(shape, seed)


@pytest.mark.few(4)
@pytest.mark.parametrize("bounds, protocol", ARENAS)
@pytest.mark.parametrize("seed", range(4))
def test_scale_origin_pose_and_cells_are_read_as_drawn(
    bounds: Bounds, protocol: SurveyProtocol, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    cells = full(bounds, protocol, seed)
    margin = 2.0 * protocol.body_radius
    pose = SE2(
        rng.uniform(bounds.x_min + margin, bounds.x_max - margin),
        rng.uniform(bounds.y_min + margin, bounds.y_max - margin),
        rng.uniform(-math.pi, math.pi),
    )
    chart = read_map(drawn(map_of(cells, bounds, protocol), pose))
    assert chart.west == pytest.approx(bounds.x_min, abs=1e-6)
    assert chart.north == pytest.approx(bounds.y_max, abs=1e-6)
    assert chart.reach == pytest.approx(protocol.reach, rel=0.25)
    assert math.hypot(chart.x - pose.x, chart.y - pose.y) * chart.per_metre < 2.0
    assert off(chart.yaw, pose.yaw) < 4.0
    shown = cells[::-1]
    coarser = round(chart.cell / protocol.cell)
    shown = shown[coarser // 2 :: coarser, coarser // 2 :: coarser]
    rows, cols = np.mgrid[: shown.shape[0], : shown.shape[1]]
    row, col = chart.place(pose.x, pose.y)
    # The arrow and the launch's dot hide what lies below them.
    clear = np.hypot(rows + 0.5 - row, cols + 0.5 - col) * chart.cell > 0.25 * protocol.reach
    np.testing.assert_array_equal(chart.cells[clear], shown[clear])


@pytest.mark.rare
@settings(max_examples=25, deadline=None)
@given(
    st.integers(-44, 44), st.integers(-44, 44), st.integers(0, 23), st.integers(0, 3)
)  # fmt: skip
def test_every_pose_is_read(x: int, y: int, heading: int, seed: int) -> None:
    pose = SE2(0.25 * x, 0.25 * y, math.radians(15.0 * heading))
    chart = read_map(drawn(map_of(full(AREA, DREAM_V1, seed), AREA), pose))
    assert math.hypot(chart.x - pose.x, chart.y - pose.y) < 0.06
    assert off(chart.yaw, pose.yaw) < 4.0


@pytest.mark.rare
@settings(max_examples=25, deadline=None)
@given(st.data())
def test_every_mark_is_read_with_its_number(data: st.DataObject) -> None:
    numbers = data.draw(st.lists(st.integers(1, 24), min_size=1, max_size=9, unique=True))
    places: dict[int, tuple[float, float]] = {}
    for number in numbers:
        x, y = data.draw(st.integers(-12, 12)), data.draw(st.integers(-12, 12))
        if all(math.hypot(x - a, y - b) >= 1.0 for a, b in ((0.5, 0.5), *places.values())):
            places[number] = (float(x), float(y))
    seed = data.draw(st.integers(0, 3))
    pose = SE2(0.5, 0.5, math.radians(30.0 * data.draw(st.integers(0, 11))))
    chart = read_map(drawn(map_of(full(AREA, DREAM_V1, seed), AREA), pose, places))
    assert [number for number, _, _ in chart.marks] == sorted(places)
    for number, read_x, read_y in chart.marks:
        # At the edge a disc stands wholly on the map.
        wanted = np.clip(places[number], -11.7, 11.7)
        assert math.hypot(read_x - wanted[0], read_y - wanted[1]) < 0.12
    assert off(chart.yaw, pose.yaw) < 20.0


@pytest.mark.parametrize("heading", range(12))
def test_a_mark_where_the_vehicle_is_stands_behind_it_and_hides_nothing_of_it(heading: int) -> None:
    pose = SE2(0.5, 0.5, math.radians(30.0 * heading))
    cells = map_of(full(AREA, DREAM_V1, 1), AREA)
    chart = read_map(drawn(cells, pose, {7: (0.5, 0.5)}))
    assert math.hypot(chart.x - pose.x, chart.y - pose.y) < 0.06
    assert off(chart.yaw, pose.yaw) < 4.0
    ((number, x, y),) = chart.marks
    back = -math.cos(pose.yaw), -math.sin(pose.yaw)
    assert number == 7
    assert 1.0 < (x - pose.x) * back[0] + (y - pose.y) * back[1] < 1.6


def test_marks_in_the_picture_of_the_camera_are_read() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (480, 640, 3)).astype(np.uint8)
    picture = Image.fromarray(noise)
    for number, place in ((3, (100.0, 80.0)), (12, (300.5, 200.2)), (7, (310.0, 208.0))):
        draw_disc(picture, place, number)
    discs = read_marks(np.asarray(picture), "camera")
    assert [(d.number, d.column, d.row) for d in discs] == [(3, 100, 80), (7, 310, 208), (12, 300, 200)]


# -------------------------------------------------------------------------------------- what must not be read

CELLS = full(AREA, DREAM_V1, 2)
POSE = SE2(1.0, -2.0, 0.5)
PLACES = {1: (5.0, 5.0), 2: (-6.0, 3.0), 3: (8.0, -8.0)}


def shown() -> np.ndarray:
    return drawn(map_of(CELLS, AREA), POSE, PLACES)


def test_a_mark_that_is_painted_over_is_gone_and_half_of_one_is_not_guessed() -> None:
    picture = shown()
    row, col = np.argwhere((picture == sight.MARK).all(axis=-1))[0]
    chart = read_map(picture)
    assert len(chart.marks) == 3
    whole = painted(picture, (col - 12, row - 2, col + 14, row + 22), (127, 127, 127))
    assert len(read_map(whole).marks) == 2
    half = painted(picture, (col - 12, row - 2, col + 14, row + 9), (127, 127, 127))
    assert len(read_map(half).marks) == 2


def test_a_number_that_is_painted_over_is_not_guessed() -> None:
    picture = shown()
    below = (picture[..., 0] == 40) & (picture[..., 1] == 40)
    disc = read_marks(picture, "map")[0]
    part = np.zeros(below.shape, np.bool_)
    part[disc.row - 6 : disc.row + 7, disc.column - 6 : disc.column + 7] = True
    picture[part & below] = sight.MARK
    with pytest.raises(UnreadableError, match="expected a number on the yellow disc"):
        read_map(picture)


def test_a_colour_that_means_nothing_is_refused() -> None:
    green, gray = sight.COLORS[sight.TARGET], sight.COLORS[sight.EXPLORED]
    with pytest.raises(UnreadableError, match="expected target as"):
        read_map(recolored(shown(), green, gray))
    blended = shown()
    top = blended.shape[0] - 200
    blended[:top] = recolored(blended[:top], green, GRAY_GREEN)  # type: ignore[arg-type]
    with pytest.raises(UnreadableError, match="expected the colours of the legend, got"):
        read_map(blended)


@pytest.mark.parametrize(
    "part", [np.s_[:, :-60], np.s_[:, 60:], np.s_[60:], np.s_[:-20], np.s_[:-300, :], np.s_[100:600, 100:600]]
)
def test_a_picture_that_is_cut_off_is_refused(part: tuple[slice, ...]) -> None:
    with pytest.raises(UnreadableError, match="cut off"):
        read_map(np.ascontiguousarray(shown()[part]))


def test_a_scale_or_numbers_that_are_hidden_are_missed() -> None:
    picture = shown()
    bottom = picture.shape[0]
    with pytest.raises(UnreadableError, match="scale bar"):
        read_map(painted(picture, (20, bottom - 40, 220, bottom - 1), (244, 244, 240)))
    with pytest.raises(UnreadableError, match="expected numbers along the border"):
        read_map(painted(picture, (0, 0, 38, bottom), (244, 244, 240)))


def test_a_map_without_vehicle_is_refused() -> None:
    picture = shown()
    top = picture.shape[0] - 150
    picture[:top] = recolored(picture[:top], sight.VEHICLE, (127, 127, 127))
    with pytest.raises(UnreadableError, match="expected the vehicle"):
        read_map(picture)
