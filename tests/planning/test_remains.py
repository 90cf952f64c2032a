"""What is left of structures, of boxes and plates that are built voxel by voxel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from dream.geometry import Bounds
from dream.mapping.volume import FREE, SOLID, Volume
from dream.planning._kernels.looks import LookScene
from dream.planning._kernels.space_beam import SpaceElements, SpaceLattice, openness
from dream.planning.space.remains import (
    FOOT,
    LOOKS,
    LOW,
    SPHERE,
    SURFACE,
    UNKNOWN,
    LeftOfStructures,
    LeftToInspect,
    _keys,
    standing_targets,
)
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Observation
from tests.planning.standing import (
    SEABED,
    forget,
    free,
    inspect,
    middles_in,
    mission,
    observed,
    solid,
    vote,
    water,
    ways_of,
)

Array = np.ndarray[Any, Any]
LOW_END, HIGH_END = (-1.0, -1.0, SEABED), (1.0, 1.0, SEABED + 2.0)
BOX = middles_in(LOW_END, HIGH_END)
ELSEWHERE = observed(-6.0, 0.0, SEABED + 2.0, math.pi)
"""From where the box is behind the camera."""


def boxed(target: float = 1.0) -> Volume:
    volume = water()
    solid(volume, LOW_END, HIGH_END, target)
    return volume


def left_of(
    volume: Volume, observation: Observation = ELSEWHERE, remains: LeftOfStructures | None = None
) -> LeftToInspect:
    remains = LeftOfStructures(mission().bounds) if remains is None else remains
    return remains.take(observation, volume, ways_of(volume))


def test_what_stands_outside_the_ordered_area_is_left_alone() -> None:
    volume = boxed()
    whole = left_of(volume)
    half = left_of(volume, remains=LeftOfStructures(Bounds(-6.0, -6.0, 0.0, 6.0)))
    # A foot reaches a little out of it.
    assert half.points[half.kind != UNKNOWN, 0].max() < FOOT
    assert 0.3 * whole.of(SURFACE) < half.of(SURFACE) < 0.7 * whole.of(SURFACE)
    assert not len(left_of(volume, remains=LeftOfStructures(Bounds(3.0, 3.0, 6.0, 6.0))))


def facing(left: LeftToInspect, way: tuple[float, float, float]) -> int:
    """Pieces of surface whose normal is within 26° of a way."""
    return int(((left.normals @ np.array(way) > 0.9) & (left.kind == SURFACE)).sum())


WAYS = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)]


def test_nothing_is_left_where_nothing_is_known_or_nothing_stands_up() -> None:
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, SEABED + 2.0], 4.0)
    assert len(left_of(volume)) == 0
    assert len(left_of(water())) == 0


def test_all_faces_of_a_box_are_left_at_first() -> None:
    left = left_of(boxed())
    for way in WAYS:
        assert facing(left, way) >= 4, way
    assert left.inspected == 0.0
    assert left.hidden == 1.0


@pytest.mark.parametrize("way", WAYS)
def test_a_face_that_was_inspected_from_its_side_is_gone_and_the_others_are_not(
    way: tuple[float, float, float],
) -> None:
    volume = boxed()
    before = left_of(volume)
    of_face = np.isclose((BOX - [0.0, 0.0, SEABED + 1.0]) @ np.array(way), 1.0 - 0.5 * PROTOCOL.cell)
    # Of the voxels around the foot as well, as a camera has it.
    inspect(volume, BOX[of_face], way)
    after = left_of(volume)
    assert after.inspected > 0.0
    assert facing(after, way) < 0.5 * facing(before, way)
    for other in WAYS:
        if np.dot(way, other) < 0.5:
            assert facing(after, other) >= 0.5 * facing(before, other), other


def test_a_plate_one_voxel_thick_has_two_faces() -> None:
    volume = water()
    low, high = (0.0, -1.5, SEABED), (PROTOCOL.cell, 1.5, SEABED + 2.5)
    solid(volume, low, high)
    before = left_of(volume)
    inspect(volume, middles_in(low, high), WAYS[0])
    after = left_of(volume)
    assert facing(before, WAYS[0]) > 0
    assert facing(after, WAYS[0]) < 0.3 * facing(before, WAYS[0])
    assert facing(after, WAYS[1]) == facing(before, WAYS[1]) > 0


def test_the_foot_beside_what_is_steep_goes_on() -> None:
    left = left_of(boxed())
    at = left.points[left.kind == SURFACE]
    assert (at[:, 2] < SEABED).any()
    # Without anything that stands there is no foot.
    assert np.abs(at[at[:, 2] < SEABED, :2]).max() <= 1.0 + 0.7


def test_labels_that_are_wrong_in_a_blob_change_nothing() -> None:
    volume = water()
    low, high = (-2.0, -2.0, SEABED), (2.0, 2.0, SEABED + 3.0)
    solid(volume, low, high)
    points = middles_in(low, high)
    blob = np.linalg.norm(points - [2.0, 0.0, SEABED + 1.5], axis=1) < 0.7
    assert blob.any()
    vote(volume, points[blob], 0.0)
    surface = volume.surface()
    standing, target = standing_targets(surface)
    assert (surface.target[standing] < 0.5).any()
    assert target[standing].all()


def test_a_boulder_whose_labels_are_mostly_right_is_no_structure() -> None:
    volume = boxed(target=0.0)
    vote(volume, BOX[np.linalg.norm(BOX - [1.0, 0.0, SEABED + 1.0], axis=1) < 0.6], 1.0)
    assert (volume.surface().target > 0.5).any()
    assert len(left_of(volume)) == 0


def test_what_shows_through_a_slit_alone_is_not_asked_for() -> None:
    # A wide block with a shaft one voxel wide down its middle.
    volume, cell = water(), PROTOCOL.cell
    solid(volume, (-1.5, -1.5, SEABED), (1.5, 1.5, SEABED + 2.5))
    free(volume, (0.0, 0.0, SEABED), (cell, cell, SEABED + 2.5))
    left = left_of(volume)
    assert len(left)
    height = left.points[:, 2] - SEABED
    inside = (np.abs(left.points[:, :2] - 0.5 * cell).max(axis=1) < 0.5) & (height > 0.0) & (height < 1.5)
    assert not inside.any()


def test_one_good_look_is_enough_for_surface_and_more_are_taken_into_the_unknown() -> None:
    volume = boxed()
    # Water behind the box that was never seen.
    forget(volume, (-3.0, -1.0, SEABED), (-1.0, 1.0, SEABED + 1.5))
    remains = LeftOfStructures(mission().bounds)
    before = left_of(volume, remains=remains)
    assert before.of(UNKNOWN) > 0.0
    assert before.given_up == 0.0
    look = observed(4.0, 0.0, SEABED + 2.0, math.pi)
    once = left_of(volume, look, remains)
    assert facing(once, WAYS[0]) < facing(before, WAYS[0])
    assert once.given_up > 0.0
    # The same look shows nothing more that it had not shown.
    assert left_of(volume, look, remains).of(SURFACE) == once.of(SURFACE)
    into = observed(-4.5, 0.0, SEABED + 2.5, 0.0)
    counts = [left_of(volume, into, remains).of(UNKNOWN) for _ in range(LOOKS)]
    assert counts[0] == once.of(UNKNOWN)
    assert counts[-1] < counts[0]


def hand_made() -> LeftToInspect:
    points = np.arange(12.0).reshape(4, 3)
    kind = np.array([SURFACE, UNKNOWN, LOW, SURFACE])
    return LeftToInspect(
        points, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([1.0, 2.0, 4.0, 8.0]), kind, 6.0, 3.0
    )


def test_the_share_that_is_hidden_is_of_surface_known_and_expected() -> None:
    left = hand_made()
    assert (left.of(SURFACE), left.of(UNKNOWN), left.of(LOW)) == (9.0, 2.0, 4.0)
    assert left.hidden == pytest.approx(11.0 / (11.0 + 3.0 + 6.0))
    some = left.only(np.array([False, True, True, False]))
    assert len(some) == 2
    np.testing.assert_array_equal(some.points, left.points[1:3])
    assert some.hidden == pytest.approx(2.0 / (2.0 + 3.0 + 6.0))


def test_cubes_have_keys_of_their_own() -> None:
    at = np.stack(np.meshgrid(*[np.arange(-6, 6)] * 3), axis=-1).reshape(-1, 3)
    keys = _keys((at + 0.5) * 0.5, 0.5)
    assert len(np.unique(keys)) == len(at)
    np.testing.assert_array_equal(_keys((at + 0.2) * 0.5, 0.5), keys)


# ------------------------------------------------------------------------------------------- openness


def share_open(states: Array, angle: float) -> float:
    """Of a point at the middle of a face that looks up, in a box of voxels where the body fits everywhere."""
    side, spacing = 0.25, 0.5
    size = states.shape[0] * side
    nodes = round(size / spacing)
    lattice = SpaceLattice(
        np.ones((2 * nodes + 1,) * 3, np.uint8),
        np.ones((nodes + 1,) * 3, np.uint8),
        np.zeros(3),
        spacing,
        np.array([[1.0, 0.0]]),
        np.array([[1.0, 0.0]]),
    )
    point = np.array([[0.5 * size + 0.5 * side, 0.5 * size + 0.5 * side, 0.5 * size - 0.5 * side]])
    elements = SpaceElements(
        point,
        np.array([[0.0, 0.0, 1.0]]),
        np.array([math.cos(angle)]),
        np.ones(1),
        np.zeros(1, np.int64),
        point,
    )
    scene = LookScene(states, np.zeros(3, np.int64), side)
    return float(openness(scene, lattice, elements, 4.0, SPHERE)[0])


def floor() -> Array:
    """(40, 40, 40) voxels of which the lower half is solid."""
    states = np.full((40, 40, 40), FREE, np.uint8)
    states[:20] = SOLID
    return states


@pytest.mark.parametrize("degrees", [30.0, 50.0, 70.0])
def test_from_an_open_plane_the_share_is_that_of_the_cone(degrees: float) -> None:
    angle = math.radians(degrees)
    assert share_open(floor(), angle) == pytest.approx(1.0 - math.cos(angle), abs=0.04)


def test_a_wall_beside_a_point_hides_half_of_it_and_a_shaft_nearly_all() -> None:
    angle = math.radians(70.0)
    states = floor()
    states[:, :, 21:] = SOLID
    assert share_open(states, angle) == pytest.approx(0.5 * share_open(floor(), angle), rel=0.25)
    states[20:36] = SOLID
    states[20:36, 20, 20] = FREE
    assert share_open(states, angle) < 0.02
