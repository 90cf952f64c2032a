"""What stands in a volume: a box whose every voxel is known has exactly its shares, sides and height."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import SE3, Bounds
from dream.mapping import OccupancyMap
from dream.mapping.volume import Volume
from dream.protocol import DREAM_V2, DREAM_V2_TRUE
from dream.survey import About, Measure, Survey, SurveyedStructure, measure_observations, measuring
from dream.survey.ground import fuse
from dream.survey.standing import RISES, Looks, measure_structures, sides_of, standing
from dream.survey.survey import OPEN, SEEN
from dream.types import Label, Observation, Target
from tests.survey.standing_box import CELL, GROUND, HIGH, LONG, WIDE, box_volume
from tests.survey.test_wreck_measures import cast

ABOUT = About("a box", datetime(2026, 6, 1, tzinfo=UTC), target=Target.WRECK)
FACE, EDGE, CORNER = CELL**2, CELL**2 * math.sqrt(2.0), CELL**2 * math.sqrt(3.0)
"""Square metres that a voxel stands for, by how many of its faces look into the water."""
RISEN = HIGH - 1
"""Levels of the box that lie `RISES` above the ground or more: the lowest one is not told from it."""
BOX = np.array([[-4.0, -2.0, GROUND], [4.0, 2.0, GROUND + 3.0]])
NORTH, SOUTH, EAST, WEST, TOP, UNDERSIDE = range(6)


def two_sides(i: Any, j: Any, k: Any) -> Any:
    """The north side was inspected from three sides, the south side from one."""
    return np.where(j == WIDE - 1, 3, np.where(j == 0, 1, 0))


def of(measures: tuple[Measure, ...]) -> dict[str, float | None]:
    return {measure.name: measure.value for measure in measures}


def structures_of(volume: Volume) -> tuple[SurveyedStructure, ...]:
    protocol = volume.protocol
    ground = fuse([], Bounds(-8.0, -8.0, 8.0, 8.0), protocol, 0.0)
    return measure_structures(Looks(volume, 0.0), ground, 0.0)[1]


def test_a_box_that_was_inspected_on_two_sides_has_these_shares(tmp_path: Path) -> None:
    (one,) = structures_of(box_volume(tmp_path, looked_at=two_sides))
    long = (LONG - 2) * (RISEN - 1) * FACE + (LONG - 2 + 2 * (RISEN - 1)) * EDGE + 2 * CORNER
    # Its upright edges belong to the long sides, its upper edge is its own.
    end = (WIDE - 2) * (RISEN - 1) * FACE + (WIDE - 2) * EDGE
    top = (LONG - 2) * (WIDE - 2) * FACE
    told = [of(side.measures) for side in one.sides]
    assert [side["known_surface"] for side in told[:5]] == pytest.approx([long, long, end, end, top])
    assert [side["inspected_share"] for side in told[:5]] == [1.0, 1.0, 0.0, 0.0, 0.0]
    assert told[UNDERSIDE]["known_surface"] is None
    whole = of(one.measures)
    assert whole["known_surface"] == pytest.approx(2.0 * (long + end) + top)
    assert whole["inspected_share"] == pytest.approx(2.0 * long / (2.0 * (long + end) + top))
    assert whole["open_area"] == 0.0
    bearings = [side.bearing for side in one.sides]
    assert bearings[:4] == pytest.approx([math.pi / 2, -math.pi / 2, 0.0, math.pi])
    assert bearings[4:] == [None, None]
    for side, looks in ((NORTH, SEEN + 3), (SOUTH, SEEN + 1), (TOP, SEEN)):
        assert set(one.cells.state[one.cells.side == side].tolist()) == {looks}


def test_intervals_hold_more_than_the_value(tmp_path: Path) -> None:
    (one,) = structures_of(box_volume(tmp_path, looked_at=two_sides))
    told = [m for side in one.sides for m in side.measures if m.low is not None]
    assert len(told) == 10
    for measure in told:
        assert measure.value is not None
        assert measure.low is not None
        assert measure.high is not None
        assert 0.0 <= measure.low <= measure.value <= measure.high
        assert measure.low < measure.high
        assert measure.unit or measure.high <= 1.0


def test_where_surface_ends_in_the_unknown_it_may_go_on(tmp_path: Path) -> None:
    """A window of three by two voxels in the east end, that nothing was seen through: its rim is solid."""

    def window(i: Any, j: Any, k: Any) -> Any:
        return (i == LONG - 1) & (j >= 5) & (j < 8) & (k >= 4) & (k < 6)

    (one,) = structures_of(box_volume(tmp_path, unknown=window))
    told = [of(side.measures)["open_area"] for side in one.sides]
    assert told == pytest.approx([0.0, 0.0, 6 * FACE, 0.0, 0.0, 0.0])
    dark = one.cells.position[one.cells.state == OPEN]
    assert len(dark) == 6
    assert dark[:, 0] == pytest.approx(0.5 * LONG * CELL - 0.5 * CELL)


def test_what_hangs_together_is_target_by_most_of_its_votes(tmp_path: Path) -> None:
    """A third of the hull is labelled wrongly from everywhere, in one place, and a patch of ground too."""

    def votes(i: Any, j: Any, k: Any) -> Any:
        box = (i >= 0) & (i < LONG) & (j >= 0) & (j < WIDE) & (k >= 0)
        return np.where(box, np.where(i < LONG // 3, 2, 96), np.where((i > -9) & (i < -2), 98, 3))

    found = standing(box_volume(tmp_path, votes=votes))
    assert len(found.structures) == 1
    assert (found.owner == 0).all()
    assert found.surface.middles[:, 0].min() == pytest.approx(-0.5 * LONG * CELL + 0.5 * CELL)
    assert found.surface.middles[:, 2].min() > GROUND + RISES

    mostly_rock = standing(box_volume(tmp_path, votes=lambda i, j, k: np.where(i < LONG // 3, 98, 10)))
    assert mostly_rock.structures == ()
    assert len(mostly_rock.owner) == 0


@pytest.mark.parametrize("axis", [0.0, 0.7, -1.2, math.pi / 2])
def test_sides_turn_with_the_structure(axis: float) -> None:
    angles = axis + np.array([math.pi / 2, -math.pi / 2, 0.0, math.pi]) + 0.3
    level = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)])
    steep = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, math.sqrt(0.5), math.sqrt(0.5)]])
    assert sides_of(level, axis).tolist() == [NORTH, SOUTH, EAST, WEST]
    assert sides_of(steep, axis).tolist()[:2] == [TOP, UNDERSIDE]
    assert sides_of(steep, axis)[2] < TOP


def seen_around(labels_of: Any = None) -> list[Observation]:
    """The box from eight places 3 m above the ground and 8 m off, looked at a little downwards."""
    protocol = DREAM_V2_TRUE
    blank = np.zeros((protocol.camera.height, protocol.camera.width, 3), np.uint8)
    seen = []
    for number in range(8):
        angle = number * math.pi / 4.0
        base = SE3.level(-8.0 * math.cos(angle), -8.0 * math.sin(angle), GROUND + 3.5, angle)
        depth, labels = cast(base, protocol, BOX)
        if labels_of is not None:
            labels = labels_of(labels)
        seen.append(
            Observation(
                float(number),
                blank,
                depth.astype(np.float32),
                labels,
                protocol.camera,
                base,
                protocol.T_base_camera,
            )
        )
    return seen


def surveyed(volume: Volume, seen: list[Observation]) -> Survey:
    occupancy = OccupancyMap(Bounds(-6.0, -6.0, 6.0, 6.0), volume.protocol)
    for one in seen:
        occupancy.integrate(one.depth, one.labels, one.camera, one.T_world_camera)
    return measure_observations(seen, occupancy, ABOUT, volume=volume)


def test_a_box_is_as_high_as_it_is(tmp_path: Path) -> None:
    survey = surveyed(box_volume(tmp_path, looked_at=two_sides), seen_around())
    height = survey.structures[0].measures[0]
    assert height.name == "height"
    assert height.value == pytest.approx(3.0, abs=0.03)
    assert height.low is not None
    assert height.high is not None
    assert height.low < 3.0 < height.high
    told = of(survey.measures)
    assert told["outline_area"] == pytest.approx(8.0 * 4.0, rel=0.03)
    assert told["inspected_share"] == of(survey.structures[0].measures)["inspected_share"]
    assert "hull_seen" not in told


def test_sides_are_looked_at_from_as_near_as_the_camera_was(tmp_path: Path) -> None:
    protocol = DREAM_V2_TRUE
    looks = Looks(box_volume(tmp_path), 0.0)
    from dream.survey.ground import Frame

    for seen in seen_around():
        looks.integrate(Frame.of(seen))
    camera = (SE3.level(8.0, 0.0, GROUND + 3.5, math.pi) @ protocol.T_base_camera).translation
    middles = looks.found.surface.middles
    east = np.flatnonzero(
        (middles[:, 0] > 3.8) & (np.abs(middles[:, 1]) < 1.0) & (middles[:, 2] > GROUND + 1.0)
    )
    away = np.linalg.norm(middles[east] - camera, axis=1)
    # The nearest point of a voxel, or of one beside it, is at most its diagonal nearer than its middle.
    assert (np.abs(looks.nearest[east] - away) < 2.0 * CELL).all()


def test_where_labels_err_from_everywhere_what_stands_is_told_all_the_same(
    tmp_path: Path,
) -> None:
    """Half of the seabed is called target; what labels alone tell is not measured."""

    def wrong(labels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        odd = labels.copy()
        odd[:, ::2][odd[:, ::2] == Label.SEABED] = Label.TARGET
        return odd

    survey = surveyed(box_volume(tmp_path, protocol=DREAM_V2), seen_around(wrong))
    height = survey.structures[0].measures[0]
    assert height.value == pytest.approx(3.0, abs=0.03)
    told = {measure.name: measure for measure in survey.measures}
    for name in ("outline_area", "debris_area", "debris_extent"):
        assert told[name].value is None
        assert "labels alone" in told[name].note
    target = np.isin(survey.layers.state, (2, 4))
    assert float(target.sum()) * survey.layers.cell**2 == pytest.approx(32.0, abs=10.0)


def test_nothing_that_stands_is_no_structure(tmp_path: Path) -> None:
    volume = box_volume(tmp_path, votes=lambda i, j, k: np.zeros(i.shape))
    ground = fuse([], Bounds(-8.0, -8.0, 8.0, 8.0), volume.protocol, 0.0)
    measures, structures = measure_structures(Looks(volume, 0.0), ground, 0.0)
    assert structures == ()
    told = {measure.name: measure for measure in measures}
    assert told["inspected_share"].value is None
    assert told["inspected_share"].note == "nothing stands"


def test_a_volume_that_is_missing_or_damaged_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"expected a run with its volume, got no volume\.npz"):
        measuring.volume_of(tmp_path)
    box_volume(tmp_path)
    whole = (tmp_path / "volume.npz").read_bytes()
    (tmp_path / "volume.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"volume\.npz: expected a volume written by save"):
        measuring.volume_of(tmp_path)


def test_the_long_axis_is_told_however_it_lies(tmp_path: Path) -> None:
    from dream.survey.standing import long_axis

    along = np.linspace(-5.0, 5.0, 41)[:, None]
    across = np.linspace(-1.0, 1.0, 9)[None, :]
    for angle in (-1.5, -0.4, 0.0, 1.0, math.pi / 2):
        x = along * math.cos(angle) - across * math.sin(angle)
        y = along * math.sin(angle) + across * math.cos(angle)
        assert long_axis(np.column_stack([x.ravel(), y.ravel()])) == pytest.approx(angle)
