"""Rasters and polygons: each value where it belongs, readable by GDAL, cloud-optimised by its own layout."""

from __future__ import annotations

import sqlite3
import struct
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dream.survey.patches import grouped
from dream.survey.products import geopackage, geotiff, mosaic
from dream.survey.products.ground import Ground
from dream.survey.products.outlines import outlines
from dream.survey.site import Site
from dream.survey.survey import Survey
from tests.survey import scenes
from tests.survey.floor import keep_frames
from tests.survey.scenes import SITE, area_of, reef, wreck

pytest.importorskip("pyproj")
rasterio = pytest.importorskip("rasterio")
warp = pytest.importorskip("rasterio.warp")

# Of rasterio's own use of affine, in its readers.
pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
MAPS = ("habitat", "target_probability", "relief", "times_seen")


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    geotiff.write(reef(), folder)
    return folder


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("package") / "survey.gpkg"
    geopackage.write(reef(), path)
    return path


@pytest.mark.parametrize("name", MAPS)
def test_every_cell_stands_at_its_place_on_the_globe(maps: Path, name: str) -> None:
    """Each map cell's middle, taken to the globe by another way, finds its value."""
    survey, ground = reef(), Ground(SITE)
    x, y = scenes.centres()
    longitude, latitude = ground.globe(x.ravel(), y.ravel())
    values = {"habitat": "state"}.get(name, name)
    expected = getattr(survey.layers, values).ravel()
    with rasterio.open(maps / f"{name}.tif") as file:
        easting, northing = warp.transform("EPSG:4326", file.crs, longitude, latitude)
        found = np.array([value[0] for value in file.sample(zip(easting, northing, strict=True))])
    assert np.array_equal(found, expected.astype(found.dtype), equal_nan=found.dtype.kind == "f")


def test_a_cell_of_known_place(maps: Path) -> None:
    """The middle of the western patch: 6 m along x, 6 m along y, turned by 20°, by hand."""
    east = 6.0 * np.cos(np.radians(20.0)) + 6.0 * np.sin(np.radians(20.0))
    north = -6.0 * np.sin(np.radians(20.0)) + 6.0 * np.cos(np.radians(20.0))
    phi, a, e2 = np.radians(54.9), 6_378_137.0, 0.006_694_379_990_14
    w = np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    latitude = 54.9 + np.degrees(north / (a * (1.0 - e2) / w**3))
    longitude = 8.3 + np.degrees(east / (a / w * np.cos(phi)))
    with rasterio.open(maps / "habitat.tif") as file:
        easting, northing = warp.transform("EPSG:4326", file.crs, [longitude], [latitude])
        row, col = file.index(easting[0], northing[0])
        picture = file.read(1) == scenes.TARGET
        # The middle of all cells of that patch, in the raster itself.
        rows, cols = np.nonzero(picture[:, : picture.shape[1] // 2])
        assert (rows.mean(), cols.mean()) == pytest.approx((row, col), abs=1.0)


def test_north_is_up_and_nothing_is_turned(maps: Path) -> None:
    with rasterio.open(maps / "habitat.tif") as file:
        assert file.transform.b == file.transform.d == 0.0
        assert file.transform.e < 0.0 < file.transform.a
        assert file.crs.to_epsg() == 32632


def test_areas_are_kept_and_nothing_is_told_of_what_lies_outside(maps: Path) -> None:
    survey = reef()
    with rasterio.open(maps / "habitat.tif") as file:
        picture, cell = file.read(1), file.res[0] * file.res[1]
    for value in (scenes.EXPLORED, scenes.TARGET, scenes.SOLID):
        whole = int((survey.layers.state == value).sum()) * survey.layers.cell**2
        assert int((picture == value).sum()) * cell == pytest.approx(whole, rel=0.02)


@pytest.mark.parametrize("name", MAPS)
def test_cloud_optimised_by_its_own_layout(maps: Path, name: str) -> None:
    """The rules of the format: tiled, overviews, directories before data, coarse data before fine."""
    path = maps / f"{name}.tif"
    with rasterio.open(path) as file:
        assert file.profile["tiled"]
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        levels = file.overviews(1)
        assert max(file.shape) / max(levels, default=1) <= geotiff.BLOCK
    directories, tiles = _directories(path.read_bytes())
    assert len(directories) == len(levels) + 1
    assert max(directories) < min(min(of) for of in tiles)
    firsts = [min(of) for of in tiles]
    assert firsts == sorted(firsts, reverse=True), "the data of the coarsest come first"


def test_rio_cogeo_agrees(maps: Path, tmp_path: Path) -> None:
    checker = pytest.importorskip("rio_cogeo")
    keep_frames(tmp_path)
    mosaic.mosaic_for(reef()).write(reef(), tmp_path, tmp_path / mosaic.NAME)
    for path in (*(maps / f"{name}.tif" for name in MAPS), tmp_path / mosaic.NAME):
        valid, errors, warnings = checker.cog_validate(str(path), strict=True)
        assert valid, (path.name, errors, warnings)


def _directories(data: bytes) -> tuple[list[int], list[list[int]]]:
    """Offsets of a little-endian TIFF's directories, and of the tiles of each that are not empty."""
    assert data[:4] == b"II*\0"
    (at,) = struct.unpack_from("<I", data, 4)
    directories, tiles = [], []
    while at:
        directories.append(at)
        (count,) = struct.unpack_from("<H", data, at)
        for entry in range(count):
            tag, kind, number, value = struct.unpack_from("<HHII", data, at + 2 + 12 * entry)
            if tag == 324:  # TileOffsets
                assert kind == 4
                found = [value] if number == 1 else list(struct.unpack_from(f"<{number}I", data, value))
                tiles.append([offset for offset in found if offset])
        (at,) = struct.unpack_from("<I", data, at + 2 + 12 * count)
    return directories, tiles


def test_colours_and_what_is_not_seen(maps: Path) -> None:
    with rasterio.open(maps / "habitat.tif") as file:
        assert file.colormap(1)[scenes.TARGET][:3] == (0x1F, 0x9E, 0x62)
        assert file.nodata == scenes.UNKNOWN
        assert "oysters" in file.tags()["TIFFTAG_IMAGEDESCRIPTION"]
    with rasterio.open(maps / "relief.tif") as file:
        assert np.isnan(file.nodata)
        assert file.units == ("metre",)
    style = (maps / "habitat.qml").read_text()
    assert style.count("<paletteEntry") == 3
    assert 'label="oysters"' in style


def test_near_a_pole_and_across_the_date_line(tmp_path: Path) -> None:
    for number, site in enumerate((Site("ice", 89.9, 10.0), Site("line", -17.0, 180.0, 45.0))):
        folder = tmp_path / str(number)
        folder.mkdir()
        geotiff.write(reef(site=site), folder)
        with rasterio.open(folder / "habitat.tif") as file:
            assert file.width < 700
            area = int((file.read(1) == scenes.TARGET).sum()) * file.res[0] ** 2
        assert area == pytest.approx(area_of_target(reef()), rel=0.02)


def area_of_target(survey: Survey) -> float:
    return float((survey.layers.state == scenes.TARGET).sum()) * survey.layers.cell**2


def test_an_absurd_raster_is_refused() -> None:
    ground = Ground(SITE)
    with pytest.raises(ValueError, match="at most 100000000 cells"):
        geotiff.sheet_around(ground, np.array([(0.0, 0.0), (10_000.0, 10_000.0)]), 0.1)


@given(arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_outlines_hold_their_cells_and_no_others(mask: Any) -> None:
    polygons = outlines(mask)
    for rings in polygons:
        assert _area(rings[0]) > 0.0
        assert all(_area(hole) < 0.0 for hole in rings[1:])
        for ring in rings:
            assert (ring[0] == ring[-1]).all()
            corners = [tuple(corner) for corner in ring[:-1].tolist()]
            assert len(set(corners)) == len(corners), "a ring that touches itself is none to OGC"
    rows, cols = mask.shape
    for row in range(rows):
        for col in range(cols):
            inside = [_inside(rings, col + 0.5, row + 0.5) for rings in polygons]
            assert sum(inside) == mask[row, col]
    assert sum(_area(ring) for rings in polygons for ring in rings) == mask.sum()


def _area(ring: Any) -> float:
    x, y = ring.T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _inside(rings: Any, x: float, y: float) -> bool:
    crossings = 0
    for ring in rings:
        for (x0, y0), (_, y1) in pairwise(ring):
            crossings += (y0 > y) != (y1 > y) and x0 > x
    return crossings % 2 == 1


def test_a_geopackage_of_version_1_3(package: Path) -> None:
    header = package.read_bytes()[:100]
    assert header[:15] == b"SQLite format 3"
    assert struct.unpack_from(">II", header, 60)[0] == 10_301
    assert header[68:72] == b"GPKG"
    with sqlite3.connect(package) as file:
        assert file.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert file.execute("PRAGMA foreign_key_check").fetchall() == []
        tables = {name for (name,) in file.execute("SELECT table_name FROM gpkg_contents")}
        ids = {srs for (srs,) in file.execute("SELECT srs_id FROM gpkg_spatial_ref_sys")}
    assert {"track", "decisions", "patches", "individuals", "swath", "area", "measures"} <= tables
    assert {-1, 0, 4326, 32632} == ids


def test_geometries_stand_at_their_place(package: Path) -> None:
    """Read back without any library: header, box and little-endian WKB."""
    survey, ground = reef(), Ground(SITE)
    easting, northing = ground.sheet(survey.individuals.position[:, 0], survey.individuals.position[:, 1])
    with sqlite3.connect(package) as file:
        blobs = [row[0] for row in file.execute("SELECT geom FROM individuals ORDER BY fid")]
        (patch,) = file.execute("SELECT geom FROM patches WHERE patch = 2").fetchone()
    for n, blob in enumerate(blobs):
        magic, _, flags, srs, west, east, south, north = struct.unpack_from("<2sBBi4d", blob)
        assert (magic, flags, srs) == (b"GP", 3, 32632)
        assert (west, south) == (east, north) == (easting[n], northing[n])
        assert struct.unpack_from("<BI3d", blob, 40) == (1, 1001, easting[n], northing[n], -5.7 + 0.5)
    assert struct.unpack_from("<BII", patch, 40) == (1, 6, 1)
    assert struct.unpack_from("<BII", patch, 49) == (1, 3, 2), "an outline and a hole"
    assert struct.unpack_from("<I", patch, 58) == (len(survey.patches[1].rings[0]),)


def test_parts_of_a_patch_are_polygons_with_their_own_holes() -> None:
    """Two squares that touch at a corner, a hole in each, one of them with an island in it."""

    def square(x: float, y: float, side: float, *, hole: bool = False) -> Any:
        ring = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) * side + (x, y)
        return ring[::-1] if hole else ring

    one, two = square(0, 0, 10), square(10, 10, 10)
    in_one, in_two, island = square(2, 2, 6, hole=True), square(12, 12, 3, hole=True), square(4, 4, 2)
    found = grouped([one, in_one, two, in_two, island])
    assert [[ring.tolist() for ring in rings] for rings in found] == [
        [one.tolist(), in_one.tolist()],
        [two.tolist(), in_two.tolist()],
        [island.tolist()],
    ]


def test_how_sure_the_origin_is_stands_with_it_where_somebody_said(package: Path, tmp_path: Path) -> None:
    geopackage.write(reef(site=replace(SITE, uncertainty=2.5)), tmp_path / "surer.gpkg")
    told = []
    for path in (package, tmp_path / "surer.gpkg"):
        with sqlite3.connect(path) as file:
            told.append(file.execute("SELECT value FROM about WHERE key = 'uncertainty_m'").fetchall())
    assert told == [[], [("2.5",)]]


def test_reasons_sizes_and_intervals_are_told(package: Path) -> None:
    survey = reef()
    with sqlite3.connect(package) as file:
        step, safety, note, time = file.execute(
            "SELECT step, safety, note, time FROM decisions WHERE step = 5"
        ).fetchone()
        sizes = [size for (size,) in file.execute("SELECT size_m FROM individuals ORDER BY fid")]
        area = file.execute("SELECT area_m2, area_m2_low, area_m2_high FROM patches").fetchone()
        unmeasured = file.execute("SELECT value, note FROM measures WHERE name = 'rugosity'").fetchone()
        (swath,) = file.execute("SELECT area_m2 FROM swath").fetchone()
    assert (step, safety, note) == (5, "Free water ahead.", "slowed down <for & by the guard>")
    assert time == "2026-06-01T09:30:50.000Z"
    found = survey.individuals
    assert sizes == [size if clear else None for size, clear in zip(found.size, found.clear, strict=True)]
    measure = survey.patches[0].measures[0]
    assert area == (measure.value, measure.low, measure.high)
    assert unmeasured[0] is None
    assert "too seldom" in unmeasured[1]
    assert swath == float((survey.layers.state != scenes.UNKNOWN).sum()) * 0.25**2


def test_gdal_reads_every_layer(package: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    counts = {}
    for name, kind in pyogrio.list_layers(package):
        if kind is None:
            continue
        about = pyogrio.read_info(package, layer=name)
        assert about["crs"] == "EPSG:32632"
        _, _, geometry, _ = pyogrio.raw.read(package, layer=name)
        shapes = shapely.from_wkb(geometry)
        assert shapely.is_valid(shapes).all()
        counts[name] = len(shapes)
        if name == "patches":
            expected = sum(area_of(patch.rings) for patch in reef().patches)
            assert shapely.area(shapes).sum() == pytest.approx(expected, rel=1e-3)
    assert counts == {"swath": 1, "area": 1, "patches": 2, "individuals": 60, "track": 1, "decisions": 12}


def test_a_wreck_and_a_survey_that_found_nothing(tmp_path: Path) -> None:
    bare = wreck()
    bare = replace(
        bare,
        patches=(),
        decisions=(),
        measures=(),
        layers=replace(bare.layers, state=np.zeros_like(bare.layers.state)),
        track=replace(
            bare.track,
            time=bare.track.time[:1],
            position=bare.track.position[:1],
            yaw=bare.track.yaw[:1],
            sigma=bare.track.sigma[:1],
        ),
    )
    for name, survey in (("wreck", wreck()), ("bare", bare)):
        path = tmp_path / f"{name}.gpkg"
        geopackage.write(survey, path)
        with sqlite3.connect(path) as file:
            assert file.execute("SELECT count(*) FROM patches").fetchone() == (len(survey.patches),)
        geotiff.write(survey, tmp_path)


def test_maps_need_an_origin(tmp_path: Path) -> None:
    for write in (
        lambda survey: geotiff.write(survey, tmp_path),
        lambda survey: geopackage.write(survey, tmp_path / "survey.gpkg"),
        lambda survey: mosaic.Mosaic().write(survey, tmp_path, tmp_path / "mosaic.tif"),
    ):
        with pytest.raises(ValueError, match="run without origin"):
            write(reef(site=None))
    assert not list(tmp_path.iterdir())
