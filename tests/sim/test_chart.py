from __future__ import annotations

import numpy as np

from dream.sim.chart import START, chart
from tests.sim.made import made


def test_a_chart_shows_targets_obstacles_and_the_start_where_they_are() -> None:
    world = made("reef/patch")
    empty = np.asarray(chart(made("flat/empty"), pixels=500), np.int64)
    picture = np.asarray(chart(world, pixels=500), np.int64)
    assert picture.shape == (546, 500, 3)
    scale = 500 / (1.08 * world.bounds.width)

    def pixel(x: float, y: float) -> tuple[int, int]:
        reach = 0.54 * world.bounds.width
        return int((reach - y) * scale), int((x + reach) * scale)

    start = world.starts[0]
    assert picture[pixel(start.x, start.y)].tolist() == list(START)
    saturation = np.ptp(picture, axis=2)
    shown = [saturation[pixel(float(x), float(y))] for x, y, _ in world.targets.position[::10]]
    assert np.median(shown) > 60
    assert np.ptp(empty[100, 100:200], axis=0).max() == 0


def test_a_chart_of_a_wreck_and_of_the_tank_can_be_drawn() -> None:
    for name in ("wreck/5", "pool/arc"):
        assert np.asarray(chart(made(name), pixels=300)).std() > 5.0
