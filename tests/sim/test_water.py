from __future__ import annotations

import numpy as np
import pytest

from dream.sim.water import WATERS, water_named


def test_water_is_found_by_its_name() -> None:
    for name, water in WATERS.items():
        assert water_named(name) is water
        assert water.name == name


def test_an_unknown_water_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(ValueError, match=r'no water "tubid"\. Did you mean "turbid"'):
        water_named("tubid")


def test_waters_grow_more_turbid_in_their_order() -> None:
    # Green light goes farthest in all of them, or nearly so, and tells them apart.
    green = [water.attenuation[1] for water in WATERS.values()]
    assert green == sorted(green)


@pytest.mark.parametrize("name", WATERS)
def test_light_decays_and_the_veil_grows_towards_open_water(name: str) -> None:
    water = WATERS[name]
    distance = np.linspace(0.0, 80.0, 400)
    direct, scattered = water.direct(distance), water.scattered(distance)
    np.testing.assert_allclose(direct[0], 1.0)
    np.testing.assert_allclose(scattered[0], 0.0)
    assert (np.diff(direct, axis=0) < 0).all()
    assert (np.diff(scattered, axis=0) > 0).all()
    np.testing.assert_allclose(scattered[-1], water.veil, rtol=0.02)
    # Two stretches of water take what their sum takes.
    np.testing.assert_allclose(water.direct(3.0) * water.direct(4.5), water.direct(7.5))


@pytest.mark.parametrize("name", WATERS)
def test_red_dies_first(name: str) -> None:
    red, green, blue = WATERS[name].attenuation
    assert red > green
    assert red > blue
