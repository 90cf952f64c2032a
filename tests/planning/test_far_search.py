"""The search for what stands up far off, by frames of walls that are known on paper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE3, Bounds, camera_mount
from dream.mapping.volume import Volume
from dream.planning.space.search import ENOUGH, TRIES, FarSearch
from dream.planning.space.ways import KnownWays, ways_in
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Label, Mission, Observation
from tests.planning.standing import observed

Array = np.ndarray[Any, Any]
BOUNDS = Bounds(-18.0, -18.0, 18.0, 18.0)
Z, GROUND, AWAY = -8.0, -10.0, 13.0
"""Metres: of the vehicle, of the seabed, and to a wall in the east."""


@pytest.fixture(scope="module")
def volume() -> Volume:
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, Z], 4.0)
    return volume


@pytest.fixture(scope="module")
def ways(volume: Volume) -> KnownWays:
    return ways_in(volume, BOUNDS, PROTOCOL)


def frame(yaw: float, width: float = 0.0, label: Label = Label.OBSTACLE) -> Observation:
    """Of a level seabed, and a wall of such a width that stands up by 4 m."""
    camera = PROTOCOL.camera
    T = SE3.level(0.0, 0.0, Z, yaw) @ camera_mount(PROTOCOL.camera_pitch)
    rays = camera.back_project(np.ones((camera.height, camera.width)), T) - T.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[..., 2] < 0.0, (GROUND - Z) / rays[..., 2], np.inf)
        wall = np.where(rays[..., 0] > 0.0, AWAY / rays[..., 0], np.inf)
        y, z = wall * rays[..., 1], Z + wall * rays[..., 2]
    wall[~((np.abs(y) < 0.5 * width) & (z > GROUND) & (z < GROUND + 4.0))] = np.inf
    depth = np.minimum(floor, wall)
    labels = np.where(wall < floor, label, Label.SEABED).astype(np.uint8)
    labels[depth >= 19.0] = Label.WATER
    depth[depth >= 19.0] = np.nan
    return observed(0.0, 0.0, Z, yaw, depth=depth, labels=labels)


def searching() -> FarSearch:
    return FarSearch(Mission(PROTOCOL, BOUNDS, max_steps=100))


def errand_of(volume: Volume, ways: KnownWays, width: float, label: Label) -> tuple[FarSearch, Any, str]:
    search = searching()
    looks = [frame(yaw, width, label) for yaw in (0.0, 0.5 * math.pi)]
    for look in looks:
        search.take(look, volume.surface())
    return search, *search.errand(ways, looks[-1])


@pytest.mark.parametrize(("width", "label"), [(6.0, Label.OBSTACLE), (1.5, Label.TARGET)])
def test_it_goes_to_what_is_wide_or_told_to_be_target(
    volume: Volume, ways: KnownWays, width: float, label: Label
) -> None:
    _, move, why = errand_of(volume, ways, width, label)
    assert move is not None
    # East, from where it looks north.
    assert move.turn < 0.0
    assert "stands up" in why


def test_it_does_not_go_to_what_is_narrow_and_no_target(volume: Volume, ways: KnownWays) -> None:
    search, _, why = errand_of(volume, ways, 1.5, Label.OBSTACLE)
    assert search.standing[0].any()
    assert "stands up" not in why


def test_it_gives_up_what_stands_up_where_no_way_comes_nearer(volume: Volume, ways: KnownWays) -> None:
    search, _, _ = errand_of(volume, ways, 6.0, Label.OBSTACLE)
    nearest = observed(3.0, 0.0, Z, 0.0)
    for _ in range(10):
        _, why = search.errand(ways, nearest)
        if "stands up" not in why:
            break
    assert "stands up" not in why


def test_first_looks_bring_the_area_into_view(volume: Volume, ways: KnownWays) -> None:
    search, look, shares = searching(), frame(0.0), []
    for _ in range(20):
        search.take(look, volume.surface())
        shares.append(float(search.glimpsed.mean()))
        move, _ = search.errand(ways, look)
        if move is None:
            break
        # The camera sees on all sides from where it is: whatever the advance, the turn counts.
        look = frame(look.pose.yaw + move.turn)
    assert shares == sorted(shares)
    assert shares[-1] > 2.5 * shares[0]


def test_columns_that_looks_do_not_show_are_given_up(volume: Volume, ways: KnownWays) -> None:
    # Nothing ever returns.
    search, looks = searching(), [observed(0.0, 0.0, Z, k * 0.5 * math.pi) for k in range(4)]
    for k in range(TRIES):
        assert search.errand(ways, looks[0])[0] is not None, k
        for look in looks:
            search.take(look, volume.surface())
    assert not search.glimpsed.any()
    assert (search.tried < TRIES).mean() > ENOUGH
    rows, cols = np.indices(search.tried.shape) + 0.5 - 18.0
    # Where two of the looks meet a column may be in neither.
    seen = (np.hypot(rows, cols) < 0.75 * PROTOCOL.max_depth) & (np.abs(rows) != np.abs(cols))
    assert (search.tried[seen] >= TRIES).all()
