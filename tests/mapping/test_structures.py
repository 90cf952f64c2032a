"""Structures and the lines around them, on surfaces that are known in closed form."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest

from dream.mapping.structures import COLUMN, Structure, structures
from dream.mapping.volume import Surface

STANDOFF = 3.5


def surface(points: np.ndarray[Any, Any], normals: np.ndarray[Any, Any], target: bool) -> Surface:
    n = len(points)
    return Surface(
        points,
        normals,
        np.full(n, float(target)),
        np.ones(n, np.bool_),
        np.zeros(n, np.uint32),
        np.full(n, 0.06),
    )


def joined(*parts: Surface) -> Surface:
    return Surface(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("middles", "normals", "target", "seen", "sides", "area")
        )
    )


def seabed() -> Surface:
    x, y = np.meshgrid(np.arange(-12.0, 12.0, 0.25), np.arange(-12.0, 12.0, 0.25))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -10.0)])
    return surface(points, np.tile([0.0, 0.0, 1.0], (x.size, 1)), target=False)


def cylinder(x: float, y: float, radius: float, height: float) -> Surface:
    angle, z = np.meshgrid(np.linspace(0.0, 2.0 * math.pi, 200), np.arange(-10.0, -10.0 + height, 0.25))
    out = np.column_stack([np.cos(angle.ravel()), np.sin(angle.ravel())])
    points = np.column_stack([np.array([x, y]) + radius * out, z.ravel()])
    return surface(points, np.column_stack([out, np.zeros(len(out))]), target=True)


def found(*parts: Surface) -> list[Structure]:
    return structures(cast(Any, None), joined(seabed(), *parts))


def test_a_cylinder_is_one_structure_of_its_height() -> None:
    (one,) = found(cylinder(1.0, -2.0, 2.0, 4.0))
    np.testing.assert_allclose(one.middle, [1.0, -2.0], atol=COLUMN)
    assert one.ground == pytest.approx(-10.0, abs=0.3)
    assert one.top == pytest.approx(-6.25, abs=0.3)


def test_the_ring_around_a_cylinder_is_a_circle_that_looks_inwards() -> None:
    (one,) = found(cylinder(1.0, -2.0, 2.0, 4.0))
    ring = one.ring(STANDOFF)
    away = ring[:, :2] - [1.0, -2.0]
    np.testing.assert_allclose(np.hypot(*away.T), 2.0 + STANDOFF, atol=COLUMN)
    inwards = np.arctan2(-away[:, 1], -away[:, 0])
    assert np.abs(np.angle(np.exp(1j * (ring[:, 2] - inwards)))).max() < math.radians(20.0)
    length = float(np.hypot(*np.diff(ring[:, :2], axis=0).T).sum())
    assert length == pytest.approx(2.0 * math.pi * (2.0 + STANDOFF), rel=0.1)
    # Closed, and counter-clockwise.
    np.testing.assert_allclose(ring[0, :2], ring[-1, :2], atol=1e-9)
    turned = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(2.0 * math.pi, abs=0.01)


def test_two_far_apart_are_two_and_two_close_by_are_one() -> None:
    assert len(found(cylinder(-6.0, 0.0, 1.0, 3.0), cylinder(6.0, 0.0, 1.0, 2.0))) == 2
    assert len(found(cylinder(-1.6, 0.0, 1.0, 3.0), cylinder(1.6, 0.0, 1.0, 3.0))) == 1


def test_what_lies_flat_or_is_no_target_is_no_structure() -> None:
    assert found(cylinder(0.0, 0.0, 2.0, 0.6)) == []
    rock = cylinder(0.0, 0.0, 2.0, 4.0)
    assert found(surface(rock.middles, rock.normals, target=False)) == []
