"""Ways in three dimensions, against a slow search that asks the volume itself."""

from __future__ import annotations

import math
from collections import deque
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dream.control.setpoints import setpoint
from dream.geometry import SE2, SE3, Bounds, camera_mount
from dream.mapping.volume import SOLID, Volume
from dream.planning.space.ways import KnownWays, ways_in
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Decision, Label

BOUNDS = Bounds(-2.0, -1.5, 2.0, 1.5)
START = SE2(0.0, 0.0, 0.0)
Z = -4.0
Pose = tuple[float, float, float, int]


def known_water(seed: int) -> Volume:
    """Balls of known water around the start; what lies between them is not known."""
    rng = np.random.default_rng(seed)
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, Z], 1.2)
    for _ in range(6):
        centre = [rng.uniform(-2.0, 2.0), rng.uniform(-1.5, 1.5), Z + rng.uniform(-1.5, 1.5)]
        volume.clear(centre, rng.uniform(0.6, 1.4))
    return volume


def may(volume: Volume, pose: Pose, move: Decision) -> Pose | None:
    """Where a move leads, by the guard's own test; None where that does not let it pass."""
    from dream.control.guard import obstruction

    x, y, z, heading = pose
    here = SE2(x, y, heading * PROTOCOL.heading_step)
    end = setpoint(here, move, PROTOCOL, z)
    assert end.z is not None
    if not (move.advance or move.climb):
        return x, y, z, PROTOCOL.heading_index(end.yaw)
    occupancy = cast(Any, SimpleNamespace(volume=volume, bounds=BOUNDS))
    if obstruction(move, here, occupancy, PROTOCOL, z):
        return None
    return end.x, end.y, end.z, PROTOCOL.heading_index(end.yaw)


def walked(volume: Volume, ways: KnownWays, path: list[Decision]) -> Pose:
    """The pose at the end of a way, each of whose moves the guard lets pass."""
    pose: Pose | None = (START.x, START.y, Z, 0)
    for move in path:
        assert pose is not None
        pose = may(volume, pose, move)
    assert pose is not None
    return pose


@pytest.mark.parametrize("seed", range(4))
def test_the_guard_lets_every_way_pass_and_its_length_is_what_was_said(seed: int) -> None:
    volume = known_water(seed)
    ways = ways_in(volume, BOUNDS, PROTOCOL)
    steps = ways.steps(START, Z)
    rng = np.random.default_rng(seed)
    reached = np.argwhere(steps > 0)
    assert len(reached) > 50
    for level, row, col, heading in reached[rng.choice(len(reached), 12)]:
        goal = np.zeros(ways.shape, np.bool_)
        goal[level, row, col] = True
        path = ways.to(START, Z, goal, np.arange(PROTOCOL.headings) == heading)
        # Asked of ways that have not told their steps yet, it is found by a search of its own.
        assert path == ways_in(volume, BOUNDS, PROTOCOL).to(
            START, Z, goal, np.arange(PROTOCOL.headings) == heading
        )
        assert path is not None
        assert len(path) == steps[level, row, col, heading]
        x, y, z, end = walked(volume, ways, path)
        np.testing.assert_allclose((x, y, z), ways.positions[level, row, col], atol=1e-9)
        assert end == heading


@pytest.mark.parametrize("seed", range(3))
def test_it_takes_as_few_steps_as_a_slow_search_over_the_same_room(seed: int) -> None:
    volume = known_water(seed)
    ways = ways_in(volume, BOUNDS, PROTOCOL)
    fast, slow = ways.steps(START, Z), slow_steps(ways)
    np.testing.assert_array_equal(fast, slow)


def slow_steps(ways: KnownWays) -> np.ndarray[Any, Any]:
    """The same by a plain search; a straight move fits where it does at eight points a lattice step."""

    def fits(level: float, row: float, col: float) -> bool:
        sides = [(math.floor(2.0 * v + 1e-9), math.ceil(2.0 * v - 1e-9)) for v in (level, row, col)]
        return all(ways.fits[i, j, k] for i in sides[0] for j in sides[1] for k in sides[2])

    steps = np.full((*ways.shape, PROTOCOL.headings), -1)
    first = (*ways.node(START.x, START.y, Z), 0)
    steps[first] = 0
    queue = deque([first])
    while queue:
        level, row, col, heading = here = queue.popleft()
        for turn in PROTOCOL.turns:
            to = (heading + turn) % PROTOCOL.headings
            for advance in (0.0, *PROTOCOL.advances):
                east, north = PROTOCOL.offset(to, advance) if advance else (0, 0)
                for climb in PROTOCOL.climbs:
                    up = round(climb / PROTOCOL.lattice)
                    end = (level + up, row + north, col + east, to)
                    if not all(0 <= k < n for k, n in zip(end[:3], ways.shape, strict=True)):
                        continue
                    if steps[end] >= 0:
                        continue
                    if (up, north, east) != (0, 0, 0):
                        count = 2 * max(abs(up), abs(north), abs(east))
                        way = np.array([level, row, col]) + np.outer(
                            np.arange(1, count + 1) / count, [up, north, east]
                        )
                        if not ways.stands[end[:3]] or not all(fits(*point) for point in way.tolist()):
                            continue
                    steps[end] = steps[here] + 1
                    queue.append(end)
    return steps


def test_it_stays_above_what_is_solid() -> None:
    assert PROTOCOL.space is not None
    volume, camera = known_water(0), PROTOCOL.camera
    # A floor 1.5 m below, seen from straight above.
    depth = np.full((camera.height, camera.width), 1.5, np.float32)
    labels = np.full(depth.shape, int(Label.SEABED), np.uint8)
    downwards = SE3.level(0.0, 0.0, Z, 0.0) @ camera_mount(0.5 * math.pi)
    volume.integrate(depth, labels, camera, downwards)
    ways = ways_in(volume, BOUNDS, PROTOCOL)
    fine = ways.fits[::2, ::2, ::2]
    assert (fine[ways.stands == 0] > 0).any()
    for level, row, col in np.argwhere(ways.stands > 0):
        x, y, z = ways.positions[level, row, col]
        below = z - np.arange(0.0, PROTOCOL.space.lowest, 0.1)
        column = np.column_stack([np.full_like(below, x), np.full_like(below, y), below])
        assert not (volume.state(column) == SOLID).any()


def test_no_way_leads_where_nothing_is_known() -> None:
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, Z], 1.2)
    ways = ways_in(volume, BOUNDS, PROTOCOL)
    goal = np.linalg.norm(ways.positions - np.array([1.5, 1.5, Z]), axis=-1) < 0.5
    assert ways.to(START, Z, goal, np.ones(PROTOCOL.headings, np.bool_)) is None
