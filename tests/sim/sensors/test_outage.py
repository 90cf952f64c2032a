"""When sensors are silent: by the clock, and in bursts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numba import njit

from dream.sim.sensors import Bursts, Outage, _kernels
from dream.sim.sensors.outage import SENSORS, table


def test_an_outage_lasts_from_its_begin_to_its_end_for_its_sensor_alone() -> None:
    outages = table([Outage("dvl", 2.0, 3.0), Outage("depth", 4.0), Outage("dvl", 10.0, 1.0)])
    for time in np.arange(0.0, 20.0, 0.25):
        dark = {"dvl": 2.0 <= time < 5.0 or 10.0 <= time < 11.0, "depth": time >= 4.0}
        for k, sensor in enumerate(SENSORS):
            assert _kernels.silent(outages, k, time) == dark.get(sensor, False)
    assert not _kernels.silent(table([]), _kernels.IMU, 1.0)


@njit
def silences(means: Any, dt: float, count: int, rng: np.random.Generator) -> Any:
    """(count,) was it silent at each of these times?"""
    chain, dark = np.array([1.0, 0.0]), np.zeros(count, np.bool_)
    for k in range(count):
        dark[k] = _kernels.burst(means, k * dt, chain, rng)
    return dark


@pytest.mark.parametrize(("share", "lasts"), [(0.3, 2.0), (0.1, 1.0), (0.6, 2.0)])
def test_bursts_take_their_share_of_the_time_and_last_as_long_as_they_should(
    share: float, lasts: float
) -> None:
    dt = 0.05
    dark = silences(Bursts(share, lasts).means, dt, 400_000, np.random.default_rng(1))
    assert not dark[0]
    assert dark.mean() == pytest.approx(share, rel=0.15)
    assert dark.sum() * dt / (np.diff(dark.astype(int)) == 1).sum() == pytest.approx(lasts, rel=0.15)


def test_without_bursts_nothing_is_lost_and_nothing_drawn() -> None:
    rng = np.random.default_rng(0)
    assert not any(_kernels.burst(Bursts().means, t, np.array([1.0, 0.0]), rng) for t in range(100))
    assert rng.random() == np.random.default_rng(0).random()


@pytest.mark.parametrize(
    ("kind", "wrong", "complaint"),
    [
        (Outage, {"sensor": "sonar", "begins": 0.0}, "outage.sensor: expected one of imu"),
        (Outage, {"sensor": "imu", "begins": -1.0}, "outage.begins: expected 0 s"),
        (Outage, {"sensor": "imu", "begins": 1.0, "lasts": 0.0}, "outage.lasts: expected more"),
        (Bursts, {"share": 1.0}, "bursts.share: expected"),
        (Bursts, {"share": math.nan}, "bursts.share: expected"),
        (Bursts, {"lasts": 0.0}, "bursts.lasts: expected"),
    ],
)
def test_what_is_no_silence_is_refused_by_name(kind: Any, wrong: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        kind(**wrong)
