"""From the world of a run to the globe and to the grid of a map sheet, and back.

    world (x, y) → true east and north of the origin → longitude, latitude (WGS 84) → UTM, or UPS near a pole

The second step is an azimuthal equidistant projection about the origin, which keeps bearings and distances
from there; pyproj does it and the third. Nothing is rounded to a plane: UTM has a scale of its own (0.9996 to
1.0010) and a north of its own, which is why a survey with heading 0 is turned against its map sheet too.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream import extras
from dream.survey.site import Site
from dream.survey.survey import Survey

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

Float64Array = npt.NDArray[np.float64]

UTM_SOUTH, UTM_NORTH = -80.0, 84.0
"""Degrees of latitude between which UTM is defined; UPS serves beyond."""
UPS = {True: 5041, False: 5042}
"""EPSG codes of UPS with axes (east, north), of the north and of the south."""
FARTHEST = 20_000.0
"""Metres from the origin: farther than that no map of one survey goes, and the zone may not hold."""


def epsg_of(latitude: float, longitude: float) -> int:
    """The code of the map sheet on which a site is drawn: its UTM zone, or UPS near a pole.

    A survey that crosses the edge of a zone stays in the zone of its origin; UTM holds well beyond its edges.
    """
    if not UTM_SOUTH <= latitude <= UTM_NORTH:
        return UPS[latitude > 0.0]
    zone = math.floor((longitude + 180.0) / 6.0) % 60 + 1
    return (32600 if latitude >= 0.0 else 32700) + zone


def site_of(survey: Survey) -> Site:
    """Where on earth a survey was made.

    Raises:
        ValueError: It has no origin.
    """
    if survey.site is None:
        raise ValueError(
            f"{survey.name}: expected a survey of a site, got a run without origin. "
            "Fly it with --site, or give the site when measuring"
        )
    return survey.site


class Ground:
    """The ground of a site, between the world of its runs and its map sheet.

    Assumes: points within 20 km of the origin.
    Fails when: pyproj is not installed (a ValueError says what to install).
    """

    def __init__(self, site: Site, epsg: int | None = None) -> None:
        """The ground of a site.

        Args:
            site: Where on earth its world is.
            epsg: Of the map sheet, where it is not the site's own: that of another run of the same place.
        """
        self.site = site
        self.epsg = epsg_of(site.latitude, site.longitude) if epsg is None else epsg

    @cached_property
    def crs(self) -> CRS:
        """Of the map sheet."""
        found: CRS = _pyproj().CRS.from_epsg(self.epsg)
        return found

    @cached_property
    def _to_globe(self) -> Transformer:
        about = (
            f"+proj=aeqd +lat_0={self.site.latitude!r} +lon_0={self.site.longitude!r} +datum=WGS84 +units=m"
        )
        pyproj = _pyproj()
        local = pyproj.CRS.from_proj4(about)
        found: Transformer = pyproj.Transformer.from_crs(local, "EPSG:4326", always_xy=True)
        return found

    @cached_property
    def _to_sheet(self) -> Transformer:
        found: Transformer = _pyproj().Transformer.from_crs("EPSG:4326", self.crs, always_xy=True)
        return found

    def globe(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Longitude and latitude in degrees of points of the world.

        Raises:
            ValueError: A point is no number, or farther from the origin than 20 km.
        """
        east, north = self.site.east_north(x, y)
        if not np.all(np.hypot(east, north) <= FARTHEST):  # Not so for NaN either.
            raise ValueError(
                f"site {self.site.name}: expected points within {FARTHEST / 1000.0:g} km of its origin, "
                "got others"
            )
        longitude, latitude = self._to_globe.transform(east, north)
        return np.asarray(longitude, np.float64), np.asarray(latitude, np.float64)

    def from_sheet(
        self, easting: npt.ArrayLike, northing: npt.ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Longitude and latitude in degrees of points of the map sheet."""
        longitude, latitude = self._to_sheet.transform(easting, northing, direction="INVERSE")
        return np.asarray(longitude, np.float64), np.asarray(latitude, np.float64)

    def sheet(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Easting and northing in metres on the map sheet of points of the world."""
        easting, northing = self._to_sheet.transform(*self.globe(x, y))
        return np.asarray(easting, np.float64), np.asarray(northing, np.float64)

    def world(self, easting: npt.ArrayLike, northing: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Points of the world under points of the map sheet: the inverse of `sheet`."""
        globe = self.from_sheet(easting, northing)
        east, north = map(np.asarray, self._to_globe.transform(*globe, direction="INVERSE"))
        bearing = math.radians(self.site.heading_deg)
        c, s = math.cos(bearing), math.sin(bearing)
        return c * east - s * north, s * east + c * north

    def depth(self, z: npt.ArrayLike) -> Float64Array:
        """Metres below the datum of heights in the world."""
        return -(np.asarray(z, np.float64) + self.site.datum_offset)

    def true_heading(self, yaw: npt.ArrayLike) -> Float64Array:
        """Degrees clockwise from true north, in [0, 360), of yaws in the world."""
        turned = 90.0 - np.degrees(np.asarray(yaw, np.float64)) + self.site.heading_deg
        return np.asarray(np.mod(turned, 360.0), np.float64)


def _pyproj() -> Any:
    try:
        import pyproj
    except ImportError as error:
        raise ValueError(extras.missing("survey", "pyproj", "maps")) from error
    return pyproj
