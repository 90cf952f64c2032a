from __future__ import annotations

import numpy as np
import pytest

from dream.sim.water import LUMINANCE, WATERS, Water, water_named


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


def test_attenuation_lengths_lie_between_those_of_red_and_of_green() -> None:
    lengths = [water.attenuation_length for water in WATERS.values()]
    assert lengths == sorted(lengths, reverse=True)
    shares = np.array(
        [[water.attenuation_length * a for a in water.attenuation[:2]] for water in WATERS.values()]
    )
    # By red alone 0.4 to 0.7 times as long, by green alone 1.2 to 1.7 times.
    assert (1.0 / shares).round(1).min(axis=0).tolist() == [0.4, 1.2]
    assert (1.0 / shares).round(1).max(axis=0).tolist() == [0.7, 1.7]


def test_an_attenuation_length_is_that_of_grey_light() -> None:
    assert sum(LUMINANCE) == pytest.approx(1.0)
    grey = Water("grey", (0.2, 0.2, 0.2), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    assert grey.attenuation_length == pytest.approx(5.0)
    assert grey.direct(grey.attenuation_length) == pytest.approx(np.exp(-1.0))
    assert Water("none", (0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0)).attenuation_length == np.inf
