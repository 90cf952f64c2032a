from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from dream.sim.world import World
from dream.sim.worlds import make_world


@pytest.fixture(scope="module", params=range(4))
def tank(request: pytest.FixtureRequest) -> World:
    return make_world("pool/arc", request.param)


def test_the_tank_is_12_feet_across_and_5_feet_deep(tank: World) -> None:
    wall = tank.meshes[tank.obstacles.mesh[0]].vertices
    radius = np.sqrt((wall[:, :2].astype(np.float64) ** 2).sum(axis=1))
    assert 2.0 * radius.min() == pytest.approx(12 * 0.3048, abs=0.005)
    assert -float(tank.terrain.heights.max()) == pytest.approx(5 * 0.3048, abs=0.001)
    assert np.ptp(tank.terrain.heights) == 0.0
    assert wall[:, 2].max() + tank.obstacles.position[0, 2] > 0.0, "the wall rises above the water"
    assert tank.protocol == "pool-v1"


def test_200_shells_lie_in_an_arc_inside_the_wall(tank: World) -> None:
    x, y = tank.targets.position[:, 0].astype(np.float64), tank.targets.position[:, 1].astype(np.float64)
    assert len(tank.targets) == 200
    away = np.hypot(x, y)
    assert away.min() > 0.8
    assert away.max() < 1.5
    angles = np.sort(np.arctan2(y, x))
    opening = np.diff(np.concatenate([angles, angles[:1] + 2.0 * math.pi])).max()
    assert 2.0 * math.pi - opening == pytest.approx(3.1, abs=0.7)


def test_a_vehicle_passes_the_pipes_on_every_side(tank: World) -> None:
    pipes = tank.obstacles.position[1:, :2].astype(np.float64)
    assert len(pipes) == 2
    for (ax, ay), (bx, by) in itertools.combinations(pipes, 2):
        assert math.hypot(ax - bx, ay - by) - 0.11 >= 0.9
    assert (1.829 - np.hypot(*pipes.T) - 0.055 >= 0.9).all()


def test_no_shell_lies_under_a_pipe(tank: World) -> None:
    for pipe in tank.obstacles.position[1:, :2]:
        assert np.hypot(*(tank.targets.position[:, :2] - pipe).T).min() > 0.11
