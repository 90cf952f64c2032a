"""A box holds its data: wherever a site is, at the poles and on the date line, however it is turned."""

from __future__ import annotations

import contextlib
import sqlite3
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import Bounds
from dream.survey import Survey, globe
from dream.survey.archive import open_archive
from dream.survey.boxes import DegreeBox, box, held, outline
from dream.survey.products import darwin_core, geotiff, netcdf
from dream.survey.products.darwin_core import Author
from dream.survey.products.ground import Ground
from dream.survey.products.sheet import corners_of
from dream.survey.site import Site
from tests.survey.scenes import reef
from tests.survey.test_products_files import OYSTER, opened, rows_of

Float64Array = npt.NDArray[np.float64]


def holds(limits: DegreeBox, longitude: Float64Array, latitude: Float64Array) -> bool:
    """By the rule that west is the larger number where a box crosses the date line."""
    east = np.mod(longitude - limits.west, 360.0) <= np.mod(limits.east - limits.west, 360.0)
    east |= limits.east - limits.west >= 360.0
    # A place on the date line is both.
    east |= np.isin(longitude, (limits.west, limits.east))
    return bool((east & (latitude >= limits.south) & (latitude <= limits.north)).all())


def sites() -> Iterator[tuple[Site, Bounds]]:
    """Some of all over, half of them within a degree, or some metres, of a pole or of the date line."""
    rng = np.random.default_rng(39)
    for number in range(60):
        latitude = float(rng.uniform(-89.0, 89.0))
        if number % 3 == 0:
            latitude = float(rng.choice([-1, 1]) * (90.0 - 10.0 ** rng.uniform(-7, 0)))
        longitude = float(rng.uniform(-180.0, 180.0))
        if number % 4 == 0:
            longitude = float(np.clip(rng.choice([-180, 180]) + rng.normal(0.0, 1e-4), -180.0, 180.0))
        x, y = rng.normal(0.0, 30.0, 2)
        wide, high = 10.0 ** rng.uniform(-1, 2.5, 2)
        yield (
            Site("A", latitude, longitude, float(rng.uniform(0.0, 360.0))),
            Bounds(x - wide, y - high, x + wide, y + high),
        )
    for latitude in (90.0, -90.0):
        # The pole in the middle, on a side, in a corner, and a hand's breadth off.
        for x, y in ((0.0, 0.0), (20.0, 3.0), (20.0, 20.0), (20.1, 0.0)):
            yield Site("Pole", latitude, 30.0, 10.0), Bounds(x - 20.0, y - 20.0, x + 20.0, y + 20.0)


def inside(of: Bounds) -> Float64Array:
    """(n, 2) points of a box, those of its sides and corners too."""
    rng = np.random.default_rng(1)
    at = rng.uniform(0.0, 1.0, (400, 2))
    at[:100, 0] = np.repeat((0.0, 1.0), 50)
    at[100:200, 1] = np.repeat((0.0, 1.0), 50)
    low, side = np.array([of.x_min, of.y_min]), np.array([of.width, of.depth])
    found: Float64Array = np.concatenate([low + at * side, corners_of(of)])
    return found


def test_the_box_of_any_site_holds_all_of_it_and_little_else() -> None:
    for site, of in sites():
        there = partial(globe.degrees, site)
        limits, points = box(there, of), inside(of)
        longitude, latitude = there(points[:, 0], points[:, 1])
        assert holds(limits, longitude, latitude), (site, of, limits)
        # No farther to the north and south than the box is, and some millimetres.
        slack = 0.01 / 111_000.0
        whole = limits.south == -90.0 or limits.north == 90.0
        assert limits.north - limits.south < np.hypot(of.width, of.depth) / 110_000.0 + slack or whole
        if not whole:
            assert latitude.min() - slack - 0.2 * (limits.north - limits.south) < limits.south
            assert limits.north < latitude.max() + slack + 0.2 * (limits.north - limits.south)
            assert (limits.east - limits.west) % 360.0 < 359.0


def test_the_outline_of_any_site_holds_all_of_it_as_a_map_of_degrees_does() -> None:
    shapely = pytest.importorskip("shapely")
    for site, of in sites():
        there = partial(globe.degrees, site)
        ring, points = outline(there, of), inside(of)
        assert np.abs(ring).max(axis=0).tolist() <= [180.0, 90.0]
        assert (ring[0] == ring[-1]).all()
        shape = shapely.Polygon(ring)
        assert shape.is_valid, (site, of)
        assert shape.exterior.is_ccw
        where = shapely.points(*there(points[:, 0], points[:, 1]))
        assert shapely.covers(shape, where).all(), (site, of)


def test_an_ordinary_box_has_four_corners_and_fits() -> None:
    site, of = Site("A", 12.0, 30.0, 20.0), Bounds(0.0, 0.0, 20.0, 16.0)
    ring = outline(partial(globe.degrees, site), of)
    assert len(ring) < 20
    longitude, latitude = globe.degrees(site, *corners_of(of).T)
    limits = box(partial(globe.degrees, site), of)
    wanted = longitude.min(), latitude.min(), longitude.max(), latitude.max()
    assert limits == pytest.approx(wanted, abs=2e-8)


def test_the_box_of_one_place_is_a_box() -> None:
    of = held(np.array([[3.0, 4.0, 9.0]]))
    assert (of.x_min, of.y_min) == (3.0, 4.0)
    assert 0.0 < of.width < 0.01


PLACES = {
    "the north pole": Site("A", 90.0, 0.0, 0.0),
    "the south pole, turned": Site("A", -90.0, -70.0, 33.0),
    "ten metres off a pole": Site("A", 90.0 - 1e-4, 120.0, 80.0),
    "a kilometre off a pole": Site("A", -89.99, 179.99999, 45.0),
    "the date line": Site("A", 12.0, 179.99999, 300.0),
    "high and turned": Site("A", 78.2, 15.6, 44.0),
}
"""Of a survey of 20 by 16 metres beside its origin."""


def strayed(site: Site) -> Survey:
    """A survey whose vehicle, and one of whose individuals, were beyond its area."""
    survey = reef(site)
    position = survey.individuals.position.copy()
    position[0, :2] = (-7.0, 20.0)
    track = survey.track.position.copy()
    track[-1, :2] = (26.0, -5.0)
    return replace(
        survey,
        individuals=replace(survey.individuals, position=position),
        track=replace(survey.track, position=track),
    )


@pytest.mark.parametrize("place", PLACES)
def test_the_box_of_a_netcdf_holds_every_cell_of_it(place: str, tmp_path: Path) -> None:
    netcdf.write(strayed(PLACES[place]), tmp_path / "survey.nc")
    with opened(tmp_path / "survey.nc") as file:
        edges = [
            float(getattr(file, f"geospatial_{end}")) for end in ("lon_min", "lat_min", "lon_max", "lat_max")
        ]
        longitude, latitude = file.variables["lon"][:].copy(), file.variables["lat"][:].copy()
    assert holds(DegreeBox(*edges), longitude, latitude)


@pytest.mark.parametrize("place", PLACES)
def test_the_box_of_a_data_set_of_occurrences_holds_every_one(place: str, tmp_path: Path) -> None:
    darwin_core.write(strayed(PLACES[place]), OYSTER, tmp_path, Author("Ada", "CC0-1.0"))
    with zipfile.ZipFile(tmp_path / "darwin-core.zip") as archive:
        eml = ET.fromstring(archive.read("eml.xml"))
        told = {name: archive.read(name).decode() for name in archive.namelist() if name.endswith(".csv")}
    edges = [
        float(next(eml.iter(f"{side}BoundingCoordinate")).text or "")
        for side in ("west", "south", "east", "north")
    ]
    count = 0
    for text in told.values():
        for row in rows_of(text):
            if row.get("decimalLatitude"):
                count += 1
                at = np.array([[float(row["decimalLongitude"])], [float(row["decimalLatitude"])]])
                assert holds(DegreeBox(*edges), *at)
    assert count >= 50


@pytest.mark.parametrize("place", PLACES)
def test_the_boxes_of_an_archive_hold_what_its_layers_hold(place: str, tmp_path: Path) -> None:
    """A GeoPackage tells of every layer where it lies, in degrees from west to east."""
    where = tmp_path / "surveys.gpkg"
    with open_archive(str(where), begin=True) as archive:
        archive.add(strayed(PLACES[place]))
    with contextlib.closing(sqlite3.connect(where)) as database:
        for table in ("individuals", "decisions"):
            (edges,) = database.execute(
                "SELECT min_x, min_y, max_x, max_y FROM gpkg_contents WHERE table_name = ?", (table,)
            ).fetchall()
            geometries = database.execute(f"SELECT geom FROM {table}").fetchall()
            places = np.array([struct.unpack_from("<2d", blob, 13) for (blob,) in geometries])
            assert (places >= edges[:2]).all()
            assert (places <= edges[2:]).all()
        (blob,) = database.execute("SELECT geom FROM tracks").fetchone()
        west, east, south, north = struct.unpack_from("<4d", blob, 8)
    assert edges[0] <= west <= east <= edges[2]
    assert edges[1] <= south <= north <= edges[3]
    # A box of the globe only where it has to be.
    assert (edges[2] - edges[0] < 1.0) == (place in ("high and turned",)) or place == "a kilometre off a pole"


@pytest.mark.parametrize("metres", [20.0, 2000.0, 15_000.0])
def test_a_raster_holds_what_bends_out_between_its_corners(metres: float) -> None:
    ground = Ground(Site("A", 61.0, 5.9, 0.0))
    of = Bounds(-metres, -metres, metres, metres)
    sheet = geotiff.sheet_around(ground, corners_of(of) * 0.9, metres / 50.0)
    points = inside(Bounds(*(0.9 * side for side in (of.x_min, of.y_min, of.x_max, of.y_max))))
    easting, northing = ground.sheet(points[:, 0], points[:, 1])
    slack = 0.05
    assert sheet.bounds.x_min - slack <= easting.min() <= easting.max() <= sheet.bounds.x_max + slack
    assert sheet.bounds.y_min - slack <= northing.min() <= northing.max() <= sheet.bounds.y_max + slack
