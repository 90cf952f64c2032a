"""Pictures that become dark."""

from __future__ import annotations

import numpy as np
import pytest

from dream.geometry import SE3, Camera, camera_mount
from dream.mapping import OccupancyMap
from dream.perception.lighting import KNOWN, RUNNING, Lighting, brightness, untold
from dream.protocol import DREAM_V1
from dream.robots import Teleport
from dream.sim.world import World
from dream.types import Label, Observation

SEEN = [100.0] * KNOWN
CAMERA = Camera(width=8, height=6, fx=4.0, fy=4.0, cx=4.0, cy=3.0)


def picture(level: float, time: float) -> Observation:
    """Of one colour."""
    return Observation(
        time=time,
        rgb=np.full((6, 8, 3), round(level), np.uint8),
        depth=np.full((6, 8), 2.0, np.float32),
        labels=np.full((6, 8), Label.SEABED, np.uint8),
        camera=CAMERA,
        T_world_base=SE3.level(0.0, 0.0, 1.0, 0.0),
        T_base_camera=camera_mount(0.3),
    )


def watched(*levels: float) -> Lighting:
    """After so many pictures."""
    lighting = Lighting()
    for k, level in enumerate(levels):
        lighting.seen(picture(level, float(k)))
    return lighting


@pytest.mark.parametrize(
    ("levels", "trouble"),
    [
        ([100.0] * 30, ""),
        ([*SEEN, *[24.0] * RUNNING], "the lamp is out: 24% of the usual light"),
        ([*SEEN, *[24.0] * (RUNNING - 1)], ""),
        ([*SEEN, *[26.0] * 10], ""),
        ([*SEEN, *[0.0] * RUNNING], "the camera is dark: 0% of the usual light"),
        ([100.0, *[8.0] * RUNNING], "the camera is dark: from the first pictures on"),
        ([0.0] * RUNNING, "the camera is dark: from the first pictures on"),
        ([*SEEN, 20.0, 20.0, 90.0, 20.0, 20.0, 90.0], ""),
        ([*SEEN, *[20.0] * RUNNING, 100.0], "the lamp is out: 20% of the usual light"),
        # One picture of glare is no usual light.
        ([250.0, *[60.0] * 10], ""),
        # It goes by day: half in ten pictures.
        ([200.0 * 0.93**k for k in range(35)], ""),
    ],
)
def test_trouble_is_what_stays_dark(levels: list[float], trouble: str) -> None:
    assert watched(*levels).trouble == trouble


def test_a_picture_counts_once_however_often_it_is_looked_at() -> None:
    lighting = watched(100.0)
    for _ in range(10):
        lighting.seen(picture(0.0, 7.0))
    assert lighting.trouble == ""


def test_of_a_dark_picture_nothing_is_believed_and_of_others_all() -> None:
    lighting = watched(*SEEN)
    bright, dark = picture(90.0, 11.0), picture(20.0, 12.0)
    assert lighting.seen(bright) is bright
    told = lighting.seen(dark)
    assert told.rgb is dark.rgb
    assert np.isnan(told.depth).all()
    assert told.confidence is not None
    assert not told.confidence.any()


def test_what_is_untold_leaves_the_map_as_it_is(string_reef: World) -> None:
    robot, twice = Teleport(string_reef, DREAM_V1), []
    seen = robot.observe()
    for looks in ([seen], [seen, untold(seen)]):
        occupancy = OccupancyMap(string_reef.bounds, DREAM_V1)
        for one in looks:
            occupancy.integrate(
                one.depth, one.labels, one.camera, one.T_world_camera, one.confidence, one.error
            )
        twice.append({name: pool.copy() for name, pool in occupancy._store.pools.items() if name != "stamps"})
    once, again = twice
    assert occupancy.areas()["explored"] > 10.0
    for name, pool in once.items():
        np.testing.assert_array_equal(pool, again[name])


def test_brightness_is_that_of_what_is_bright() -> None:
    rgb = np.zeros((10, 10, 3), np.uint8)
    rgb[:2] = 200
    assert brightness(rgb) == 200.0
