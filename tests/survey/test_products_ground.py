"""Where on earth a point of the world is: closed forms of the ellipsoid, and the way back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dream.survey import globe
from dream.survey.products.ground import Ground, epsg_of, site_of
from dream.survey.site import Site
from tests.survey.scenes import reef

pytest.importorskip("pyproj")

A, F = 6_378_137.0, 1.0 / 298.257_223_563
E2 = F * (2.0 - F)


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Of longitude and of latitude, from the radii of curvature of WGS 84."""
    phi = math.radians(latitude)
    w = math.sqrt(1.0 - E2 * math.sin(phi) ** 2)
    return math.radians(A / w * math.cos(phi)), math.radians(A * (1.0 - E2) / w**3)


@pytest.mark.parametrize("latitude", [0.0, 54.9, -33.85, 79.0])
def test_degrees_follow_from_the_radii_of_the_ellipsoid(latitude: float) -> None:
    ground = Ground(Site("here", latitude, 8.3))
    of_longitude, of_latitude = metres_per_degree(latitude)
    longitude, there = ground.globe([0.0, 40.0, 0.0], [0.0, 0.0, 30.0])
    assert longitude - 8.3 == pytest.approx([0.0, 40.0 / of_longitude, 0.0], abs=1e-8)
    assert there - latitude == pytest.approx([0.0, 0.0, 30.0 / of_latitude], abs=1e-8)


def test_heading_is_the_bearing_of_the_y_axis() -> None:
    ground = Ground(Site("here", 54.9, 8.3, heading_deg=90.0))
    of_longitude, of_latitude = metres_per_degree(54.9)
    longitude, latitude = ground.globe([0.0, 50.0], [50.0, 0.0])
    # y looks east, x south.
    assert longitude - 8.3 == pytest.approx([50.0 / of_longitude, 0.0], abs=1e-8)
    assert latitude - 54.9 == pytest.approx([0.0, -50.0 / of_latitude], abs=1e-8)
    assert ground.true_heading([0.0, 0.5 * math.pi]) == pytest.approx([180.0, 90.0])


def test_on_the_central_meridian_utm_is_500_km_and_its_scale() -> None:
    ground = Ground(Site("here", 10.0, 9.0))
    easting, northing = ground.sheet([0.0, 100.0], [0.0, 0.0])
    assert ground.epsg == 32632
    assert easting[0] == pytest.approx(500_000.0, abs=1e-6)
    assert easting[1] - easting[0] == pytest.approx(99.96, abs=1e-4)
    assert northing[1] == pytest.approx(northing[0], abs=1e-3)


@given(
    st.floats(-90.0, 90.0),
    st.floats(-180.0, 180.0),
    st.floats(0.0, 360.0),
    st.floats(-100.0, 100.0),
    st.floats(-100.0, 100.0),
)
def test_the_way_back_ends_where_it_began(
    latitude: float, longitude: float, heading: float, x: float, y: float
) -> None:
    ground = Ground(Site("anywhere", latitude, longitude, heading))
    there = ground.sheet([x], [y])
    assert np.ravel(ground.world(*there)) == pytest.approx([x, y], abs=2e-3)


def test_zones() -> None:
    assert epsg_of(54.9, 8.3) == 32632
    assert epsg_of(-33.85, 151.2) == 32756
    assert epsg_of(10.0, -180.0) == epsg_of(10.0, 180.0) == 32601
    assert epsg_of(10.0, 179.99) == 32660
    assert epsg_of(84.1, 0.0) == 5041
    assert epsg_of(-80.1, 0.0) == 5042


@pytest.mark.parametrize("longitude", [11.999_999, 180.0, -180.0])
def test_a_survey_across_the_edge_of_a_zone_stays_whole(longitude: float) -> None:
    ground = Ground(Site("edge", 54.9, longitude))
    easting, northing = ground.sheet([-50.0, 50.0], [0.0, 0.0])
    assert np.hypot(np.diff(easting), np.diff(northing)) == pytest.approx(100.0, abs=0.11)


def test_depth_is_below_the_datum() -> None:
    ground = Ground(Site("here", 1.0, 1.0, datum_offset=0.5))
    assert ground.depth([-6.0, 0.0]) == pytest.approx([5.5, -0.5])


def test_what_lies_far_off_is_refused() -> None:
    ground = Ground(Site("here", 1.0, 1.0))
    for far in (30_000.0, math.nan):
        with pytest.raises(ValueError, match="within 20 km"):
            ground.globe([far], [0.0])


def test_without_an_origin_it_says_so() -> None:
    with pytest.raises(ValueError, match=r"run without origin.*--site"):
        site_of(reef(site=None))


@given(
    st.floats(-89.9, 89.9),
    st.floats(-180.0, 180.0),
    st.floats(-360.0, 360.0),
    st.floats(0.0, 5000.0),
    st.floats(0.0, 6.28),
)
@example(0.0, 1e-9, 0.0, 0.0, 0.0)
@example(1.0, 1.0, 0.0, 5e-4, 0.0)
def test_archives_and_products_put_a_point_at_the_same_place(
    latitude: float, longitude: float, heading: float, away: float, way: float
) -> None:
    """The plane that touches the ellipsoid and pyproj's projection, over all that one site may span."""
    site = Site("here", latitude, longitude, heading_deg=heading)
    x, y = [away * math.cos(way)], [away * math.sin(way)]
    (east, north), (easting, northing) = globe.degrees(site, x, y), Ground(site).globe(x, y)
    of_longitude, of_latitude = metres_per_degree(float(northing[0]))
    turn = math.remainder(float(east[0] - easting[0]), 360.0)
    # A plane leaves the ellipsoid by d³ / 3R²: a millimetre at 5 km.
    most = 1e-4 + away**3 / (2.5 * 6.33e6**2)
    if min(abs(east[0]), abs(north[0])) < 2e-8 or away < 1e-3:
        # PROJ takes degrees below 1e-8, a millimetre, for 0, and 1e-10 radii from its origin for the origin.
        most += 1.2e-3
    assert math.hypot(of_longitude * turn, of_latitude * float(north[0] - northing[0])) <= most
