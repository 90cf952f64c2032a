"""What the devices tell together."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dream.geometry import FloatArray
from dream.robots.bluerov2.devices import Devices
from dream.robots.bluerov2.navigation import DVL_AT, mounting_of


def beams(ranges: list[float] | None) -> FloatArray | None:
    told = None if ranges is None else np.array(ranges)
    devices: Any = SimpleNamespace(dvl=SimpleNamespace(ranges=told), _mounting=mounting_of())
    found: FloatArray | None = Devices.beams.fget(devices)  # type: ignore[attr-defined]
    return found


def test_beams_that_agree_end_below_the_dvl() -> None:
    ends = beams([1.0, 1.05, 1.02, 1.0])
    assert ends is not None
    np.testing.assert_allclose(ends.mean(axis=0)[:2], DVL_AT[:2], atol=0.02)
    down = math.cos(math.radians(22.5))
    np.testing.assert_allclose(ends[:, 2] - DVL_AT[2], [-down, -1.05 * down, -1.02 * down, -down])


@pytest.mark.parametrize("ranges", [None, [1.0, 1.0, math.nan, 1.0], [1.0, 1.2, 1.0, 1.0]])
def test_beams_that_do_not_agree_are_not_known_as_nobody_tells_which_looks_where(
    ranges: list[float] | None,
) -> None:
    assert beams(ranges) is None
