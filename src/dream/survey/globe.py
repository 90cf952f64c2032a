"""From a site's metres to degrees, and from one site's frame to another's.

Metres east and north lie on the plane that touches the WGS 84 ellipsoid at the origin, as a survey of some
hundred metres may be drawn.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.survey.site import Site

Float64Array = npt.NDArray[np.float64]

A = 6_378_137.0
"""Metres: semi-major axis of WGS 84 (NIMA TR8350.2)."""
F = 1.0 / 298.257_223_563
"""Its flattening."""
E2 = F * (2.0 - F)


def degrees(site: Site, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
    """Longitude and latitude, degrees of WGS 84, of points of the world."""
    east, north = site.east_north(x, y)
    axes = _axes(site)
    place = _geocentric(site) + east[..., None] * axes[0] + north[..., None] * axes[1]
    # Bowring 1976: one step is exact to far below a millimetre near the surface.
    across = np.hypot(place[..., 0], place[..., 1])
    b = A * (1.0 - F)
    u = np.arctan2(place[..., 2] * A, across * b)
    latitude = np.arctan2(
        place[..., 2] + E2 / (1.0 - E2) * b * np.sin(u) ** 3, across - E2 * A * np.cos(u) ** 3
    )
    return np.degrees(np.arctan2(place[..., 1], place[..., 0])), np.degrees(latitude)


def apart(one: Site, other: Site) -> float:
    """Metres from one origin to the other, straight through the earth."""
    return float(np.linalg.norm(_geocentric(one) - _geocentric(other)))


def between(to: Site, of: Site) -> SE2:
    """`T_a_b`: where the frame of one site (b, `of`) is in that of another (a, `to`): metres, radians."""
    offset, axes, others = _geocentric(of) - _geocentric(to), _axes(to), _axes(of)
    # North leans towards the meridian of the other, the more so the nearer to a pole.
    leaning = math.atan2(float(axes[1] @ others[0]), float(axes[0] @ others[0]))
    east, north = float(axes[0] @ offset), float(axes[1] @ offset)
    bearing = math.radians(to.heading_deg)
    c, s = math.cos(bearing), math.sin(bearing)
    yaw = bearing + leaning - math.radians(of.heading_deg)
    return SE2(c * east - s * north, s * east + c * north, math.remainder(yaw, math.tau))


def _geocentric(site: Site) -> Float64Array:
    """(3,) metres from the middle of the earth."""
    latitude, longitude = math.radians(site.latitude), math.radians(site.longitude)
    normal = A / math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)
    across = normal * math.cos(latitude)
    return np.array(
        [
            across * math.cos(longitude),
            across * math.sin(longitude),
            normal * (1.0 - E2) * math.sin(latitude),
        ]
    )


def _axes(site: Site) -> Float64Array:
    """(2, 3) east and north there, from the middle of the earth."""
    latitude, longitude = math.radians(site.latitude), math.radians(site.longitude)
    north = [
        -math.sin(latitude) * math.cos(longitude),
        -math.sin(latitude) * math.sin(longitude),
        math.cos(latitude),
    ]
    return np.array([[-math.sin(longitude), math.cos(longitude), 0.0], north])
