"""From a box in metres to what holds it on the globe: an outline in degrees, and the box of that.

A side of a box is no straight line between degrees of latitude and longitude: near a pole it is far from one,
and a box around the pole has all longitudes. So sides are followed in steps that bend by less than a
millimetre.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds

Float64Array = npt.NDArray[np.float64]
Globe = Callable[[Float64Array, Float64Array], tuple[Float64Array, Float64Array]]
"""Longitude and latitude, degrees, of points in metres."""

MARGIN = 1e-3
"""Metres by which a box is grown, so that what lies on its sides lies within."""
BEND = 0.4e-3
"""Metres that an outline may lie off a side."""
ROUNDS, MOST_POINTS = 40, 50_000
DEGREE = 111_320.0
"""Metres of a degree of latitude, about."""
AT_POLE = 90.0 - 2.0 * MARGIN / DEGREE


class DegreeBox(NamedTuple):
    """West, south, east and north in degrees; west is the larger number where it crosses the date line.

    So RFC 7946 has it of every box, and ACDD 1.3 of `geospatial_lon_min`.
    """

    west: float
    south: float
    east: float
    north: float

    @property
    def crosses(self) -> bool:
        """Does it go on through the date line?"""
        return self.west > self.east


def held(*points: Float64Array) -> Bounds:
    """The box, in metres, of points, (n, 2) or more columns; a side of no length becomes a millimetre."""
    flat = np.concatenate([one[:, :2] for one in points])
    (x_min, y_min), (x_max, y_max) = (end.tolist() for end in (flat.min(axis=0), flat.max(axis=0)))
    return Bounds(x_min, y_min, max(x_max, x_min + MARGIN), max(y_max, y_min + MARGIN))


def box(globe: Globe, of: Bounds) -> DegreeBox:
    """What holds a box in metres, at the poles and on the date line too."""
    longitude, latitude, pole = _rim(globe, of)
    low, high = float(latitude.min()), float(latitude.max())
    west, east = float(longitude.min()), float(longitude.max())
    if pole or east - west >= 360.0:
        return DegreeBox(-180.0, -90.0 if pole < 0 else low, 180.0, 90.0 if pole > 0 else high)
    end = _wrapped(east)
    return DegreeBox(_wrapped(west), low, 180.0 if end == -180.0 else end, high)


def outline(globe: Globe, of: Bounds) -> Float64Array:
    """(n, 2) longitude and latitude of a closed ring, counter-clockwise, that holds a box in metres.

    On a map of degrees, whose edges are ±180 and ±90: around a pole it goes along that edge of the map, and
    on the date line, where one ring cannot be on both sides, it is all of the parallel.
    """
    longitude, latitude, pole = _rim(globe, of)
    limits = box(globe, of)
    if pole and abs(longitude[-1] - longitude[0]) > 180.0:
        return _around_pole(longitude, latitude, pole)
    if pole or limits.crosses or longitude.max() - longitude.min() >= 360.0:
        south, north = limits.south, limits.north
        return np.array([(-180.0, south), (180.0, south), (180.0, north), (-180.0, north), (-180.0, south)])
    ring = np.column_stack([longitude, latitude])
    ring[:, 0] -= 360.0 * round(float(longitude.mean()) / 360.0)
    ring[-1] = ring[0]
    return ring


def _rim(globe: Globe, of: Bounds) -> tuple[Float64Array, Float64Array, int]:
    """Along the sides of a box, once around it: longitude, which goes on beyond ±180, and latitude; and 1 or
    −1 where the north or the south pole lies within, else 0."""
    x = np.array([of.x_min - MARGIN, of.x_max + MARGIN])[[0, 1, 1, 0, 0]]
    y = np.array([of.y_min - MARGIN, of.y_max + MARGIN])[[0, 0, 1, 1, 0]]

    def at(t: Float64Array) -> tuple[Float64Array, Float64Array]:
        corners = np.arange(5.0)
        return globe(np.interp(t, corners, x), np.interp(t, corners, y))

    # Odd, so that no symmetric bend hides at a middle.
    t = np.linspace(0.0, 4.0, 13)
    longitude, latitude = at(t)
    for _ in range(ROUNDS):
        middle = 0.5 * (t[:-1] + t[1:])
        lon, lat = at(middle)
        expected = longitude[:-1] + 0.5 * _turn(np.diff(longitude))
        off = np.hypot(
            _turn(lon - expected) * np.cos(np.radians(lat)), lat - 0.5 * (latitude[:-1] + latitude[1:])
        )
        (new,) = np.nonzero(off * DEGREE > BEND)
        if not len(new) or len(t) + len(new) > MOST_POINTS:
            break
        t = np.insert(t, new + 1, middle[new])
        longitude = np.insert(longitude, new + 1, lon[new])
        latitude = np.insert(latitude, new + 1, lat[new])
    steps = _turn(np.diff(longitude))
    highest = latitude[np.abs(latitude).argmax()]
    pole = 0
    if abs(float(steps.sum())) > 180.0 or abs(highest) > AT_POLE:
        pole = 1 if highest > 0.0 else -1
    return longitude[0] + np.concatenate([[0.0], np.cumsum(steps)]), latitude, pole


def _around_pole(longitude: Float64Array, latitude: Float64Array, pole: int) -> Float64Array:
    """The ring of a rim around a pole: along the rim from one edge of the map to the other, and back."""
    east = np.array([_wrapped(float(value)) for value in longitude[:-1]])
    order = np.argsort(east, kind="stable")
    east, north = east[order], latitude[:-1][order]
    # At the edge of the map the rim is between the last of its points and the first.
    gap = east[0] + 360.0 - east[-1]
    edge = north[-1] + (north[0] - north[-1]) * ((180.0 - east[-1]) / gap if gap else 0.0)
    rim = np.column_stack([[-180.0, *east, 180.0], [edge, *north, edge]])
    far = 90.0 * pole
    closing = [(180.0, far), (-180.0, far), (-180.0, edge)]
    ring = np.concatenate([rim, closing])
    return ring if pole > 0 else ring[::-1].copy()


def _turn(degrees: Float64Array) -> Float64Array:
    """The same way around, within ±180."""
    turned: Float64Array = np.mod(degrees + 180.0, 360.0) - 180.0
    return turned


def _wrapped(longitude: float) -> float:
    return (longitude + 180.0) % 360.0 - 180.0
