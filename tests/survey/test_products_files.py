"""netCDF, Darwin Core, tables and reports: what standards ask, and what a reader has to find."""

from __future__ import annotations

import base64
import csv
import io
import math
import re
import sqlite3
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import netcdf_file

from dream.geometry import Bounds
from dream.survey import Measure, Picture, Survey
from dream.survey.products import (
    Author,
    Species,
    areas,
    darwin_core,
    export,
    figures,
    netcdf,
    page,
    pdf,
    sheet,
    tables,
    words,
)
from dream.survey.products.ground import Ground
from dream.survey.registration import Registering
from dream.survey.site import Site
from tests.survey import repeated, scenes
from tests.survey.browsing import Seen
from tests.survey.scenes import SITE, reef, wreck

pytest.importorskip("pyproj")

ROOT = Path(__file__).parents[2]
OYSTER = Species("Ostrea edulis", "urn:lsid:marinespecies.org:taxname:1")
LATER = replace(
    reef(),
    name="a year later",
    began=scenes.BEGAN + timedelta(days=365),
    measures=(Measure("reef_area", 30.0, 28.0, 32.0, "m2"), Measure("cover", 0.4, None, None, "")),
)


def opened(path: Path) -> Any:
    return netcdf_file(path, mmap=False)


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two surveys."""
    path = tmp_path_factory.mktemp("series") / "survey.nc"
    netcdf.write(reef(), path, [LATER])
    return path


def test_measures_over_time(series: Path) -> None:
    with opened(series) as file:
        of = file.variables
        assert of["time"][:].tolist() == [1_780_306_200.0, 1_780_306_200.0 + 365 * 86_400]
        assert (of["time_bounds"][:, 1] - of["time_bounds"][:, 0]).tolist() == [120.0, 120.0]
        assert b"".join(of["survey"][1]).decode().strip() == "a year later"
        first = next(m for m in reef().measures if m.name == "reef_area")
        assert of["reef_area"][:].tolist() == [first.value, 30.0]
        assert of["reef_area_low"][:].tolist() == [first.low, 28.0]
        assert of["reef_area_high"][:].tolist() == [first.high, 32.0]
        assert of["reef_area"].units == b"m2"
        # What was not measured, then or at all, is the fill value and no number.
        assert of["rugosity"][:].tolist() == [netcdf.FILL, netcdf.FILL]
        assert of["cover_low"][:].tolist() == [netcdf.FILL, netcdf.FILL]
        assert b"too seldom" in of["rugosity"].comment
        assert of["density"].long_name == b"density: individuals on each square metre of reef"


def test_maps_stand_at_their_place(series: Path) -> None:
    x, y = scenes.centres()
    easting, northing = Ground(SITE).sheet(x.ravel(), y.ravel())
    longitude, latitude = Ground(SITE).globe(x.ravel(), y.ravel())
    with opened(series) as file:
        of = file.variables
        col = np.abs(of["x"][:][:, None] - easting).argmin(axis=0)
        row = np.abs(of["y"][:][:, None] - northing).argmin(axis=0)
        assert (of["habitat"][0][row, col] == reef().layers.state.ravel()).all()
        assert np.abs(of["lat"][:][row, col] - latitude).max() < 1e-6
        assert np.abs(of["lon"][:][row, col] - longitude).max() < 2e-6
        relief = of["relief"][1][row, col]
        of_map = reef().layers.relief.ravel()
        expected = np.where(np.isnan(of_map), np.float32(netcdf.FILL), of_map)
        assert (relief == expected).all()


def test_rules_of_cf(series: Path) -> None:
    """What CF 1.8 asks of this kind of file, by its sections."""
    with opened(series) as file:
        assert b"CF-1.8" in file.Conventions  # 2.6.1
        for name in ("title", "history", "source", "references", "comment"):  # 2.6.2
            assert getattr(file, name)
        for name, variable in file.variables.items():
            assert re.fullmatch(r"[A-Za-z]\w*", name)  # 2.3
            if name in ("crs", "time_bounds"):
                continue
            assert variable.long_name  # 3.2
            if name != "survey" and not hasattr(variable, "flag_meanings"):
                assert variable.units  # 3.1
            for other in getattr(variable, "ancillary_variables", b"").split():  # 3.4
                assert other.decode() in file.variables
            if variable.dimensions[-2:] == ("y", "x") and name not in ("lat", "lon"):
                assert variable.grid_mapping == b"crs"  # 5.6
                assert variable.coordinates == b"lat lon"  # 5
        time, crs, habitat = (file.variables[name] for name in ("time", "crs", "habitat"))
        assert (time.standard_name, time.calendar, time.bounds) == (
            b"time",
            b"standard",
            b"time_bounds",
        )  # 4.4, 7.1
        assert crs.grid_mapping_name == b"transverse_mercator"  # F
        assert crs.longitude_of_central_meridian == 9.0
        assert crs.semi_major_axis == 6_378_137.0, "in double precision"
        assert len(habitat.flag_meanings.split()) == len(habitat.flag_values) == 5  # 3.5
        assert set(np.unique(habitat[:])) <= set(habitat.flag_values.tolist())


def test_a_cf_checker_finds_no_fault(series: Path) -> None:
    runner = pytest.importorskip("compliance_checker.runner")
    runner.CheckSuite.load_all_available_checkers()
    report = io.StringIO()
    passed, broken = runner.ComplianceChecker.run_checker(
        str(series), ["cf:1.8"], verbose=0, criteria="normal", output_filename="-", output_format="text"
    )
    assert passed, report.getvalue()
    assert not broken


def test_surveys_of_two_sites_make_no_series(tmp_path: Path) -> None:
    elsewhere = replace(LATER, site=Site("Outer reef", 54.8, 8.3))
    with pytest.raises(ValueError, match="expected the site Inner reef, got Outer reef"):
        netcdf.write(reef(), tmp_path / "survey.nc", [elsewhere])
    assert not list(tmp_path.iterdir())


def test_an_origin_that_was_corrected_by_metres_is_laid_where_its_own_file_says(tmp_path: Path) -> None:
    """A cell that both saw stands at one place on earth, whatever either calls it."""
    moved = Site("inner reef", 54.900027, 8.3, heading_deg=50.0, datum="LAT", datum_offset=1.0)
    netcdf.write(reef(), tmp_path / "survey.nc", [replace(LATER, site=moved)])
    x, y = scenes.centres()
    easting, northing = Ground(moved).sheet(x.ravel(), y.ravel())
    with opened(tmp_path / "survey.nc") as file:
        of = file.variables
        # A minute of latitude is 1852 m, about.
        assert of["origin_north"][:].tolist() == pytest.approx([0.0, 0.000027 * 60.0 * 1855.0], abs=0.02)
        assert of["origin_east"][:].tolist() == pytest.approx([0.0, 0.0], abs=0.001)
        assert b"Its origin is the reference position: 54.9000000" in file.comment
        within = (abs(easting - of["x"][:].mean()) < 4.0) & (abs(northing - of["y"][:].mean()) < 4.0)
        col = np.abs(of["x"][:][:, None] - easting[within]).argmin(axis=0)
        row = np.abs(of["y"][:][:, None] - northing[within]).argmin(axis=0)
        # In a cell of the map, not on its edge.
        assert (of["habitat"][1][row, col] == LATER.layers.state.ravel()[within]).mean() > 0.98
        # Farther off than two surveys are looked for on each other.
        assert of["laid_by"][:].tolist() == [0, 3]
        assert (
            of["laid_turn"][:].tolist()
            == of["laid_east"][:].tolist()
            == of["laid_north"][:].tolist()
            == [0, 0]
        )
        assert of["laid_sigma"][1] > 0.25


def blinded(survey: Survey) -> Survey:
    """The same, had it seen nothing."""
    layers = survey.layers
    return replace(
        survey,
        individuals=wreck().individuals,
        patches=(),
        layers=replace(
            layers,
            state=np.full_like(layers.state, scenes.UNKNOWN),
            target_probability=np.full_like(layers.target_probability, np.nan),
            relief=np.full_like(layers.relief, np.nan),
            times_seen=np.zeros_like(layers.times_seen),
        ),
    )


@pytest.mark.parametrize("blind", [(1,), (0,), (0, 1)], ids=str)
def test_a_survey_that_saw_nothing_keeps_its_place_in_the_series(
    blind: tuple[int, ...], tmp_path: Path
) -> None:
    """Be it the one that is exported, another, or all."""
    first, later = (blinded(one) if n in blind else one for n, one in enumerate((reef(), LATER)))
    netcdf.write(first, tmp_path / "survey.nc", [later])
    with opened(tmp_path / "survey.nc") as file:
        of = file.variables
        assert of["laid_by"][:].tolist() == [0, 3]
        assert of["laid_by"].flag_meanings.split()[3] == b"site_files"
        assert [bool(habitat.any()) for habitat in of["habitat"]] == [n not in blind for n in (0, 1)]


def test_surveys_of_one_time_each_have_a_time_of_their_own(tmp_path: Path) -> None:
    """As CF asks of a coordinate. What was recorded stands in the bounds."""
    began = reef().began
    same = [replace(LATER, name=name, began=began) for name in ("second", "third")]
    after = replace(LATER, name="fourth", began=began + timedelta(seconds=1))
    netcdf.write(reef(), tmp_path / "survey.nc", [*same, after])
    with opened(tmp_path / "survey.nc") as file:
        time, bounds = file.variables["time"][:].copy(), file.variables["time_bounds"][:].copy()
    assert np.diff(time).tolist() == [1.0, 1.0, 1.0]
    assert (bounds[:, 0] - bounds[0, 0]).tolist() == [0.0, 0.0, 0.0, 1.0]
    assert ((bounds[:, 0] <= time) & (time <= bounds[:, 1])).all()


@pytest.mark.rare
@pytest.mark.parametrize("heading", [0.0, 40.0])
def test_maps_lie_as_the_individuals_do_where_site_files_err(heading: float, tmp_path: Path) -> None:
    """The site file of the later one has moved by 3 m, and its world by a hand."""
    rng = np.random.default_rng(5)
    there = repeated.reef(rng)
    first, later = (repeated.survey(there, rng, name=name) for name in ("first", "later"))
    site = replace(repeated.SITE, heading_deg=heading)
    moved = replace(site, latitude=site.latitude + 3.0 / 111_300.0)
    before = replace(first, site=site)
    after = replace(later, site=moved, began=first.began + timedelta(days=365))
    netcdf.write(before, tmp_path / "survey.nc", [after])
    how = Registering().register(before, after)
    assert how.by == "individuals"
    with opened(tmp_path / "survey.nc") as file:
        of = file.variables
        assert of["laid_by"][:].tolist() == [0, 1]
        assert of["laid_by"].flag_meanings.split()[1] == b"individuals"
        # Back to where it was, but for the drift of both worlds.
        assert np.hypot(of["laid_east"][1], of["laid_north"][1] + 3.0) < 1.0
        assert abs(of["laid_turn"][1]) < 4.0
        assert 0.0 < of["laid_sigma"][1] < 0.1
        habitat = of["habitat"][:].copy()
    both = (habitat != 0).all(axis=0)
    target = habitat == scenes.TARGET
    alike = (target[0] & target[1] & both).sum() / (target.any(axis=0) & both).sum()
    assert alike > 0.85, alike


def test_an_origin_beyond_the_edge_of_a_zone_is_laid_on_the_same_sheet(tmp_path: Path) -> None:
    west, east = (Site("Inner reef", 54.9, 6.0 + side) for side in (-0.00001, 0.00001))
    assert Ground(west).epsg != Ground(east).epsg
    netcdf.write(reef(site=west), tmp_path / "survey.nc", [replace(LATER, site=east)])
    with opened(tmp_path / "survey.nc") as file:
        assert (file.variables["habitat"][:] == scenes.TARGET).any(axis=(1, 2)).tolist() == [True, True]


def sized(first: int, last: int, note: str = "from 50 that stand clear of others") -> tuple[Measure, ...]:
    """Shares in bins of 5 cm between two sizes, in centimetres."""
    ends = range(first, last, 5)
    share = 1.0 / len(ends)
    return tuple(
        Measure(f"size_share_{end:03d}_{end + 5:03d}_cm", share, 0.5 * share, 1.0, "", note) for end in ends
    )


def test_sizes_that_a_survey_found_none_of_are_a_share_of_0(tmp_path: Path) -> None:
    surveys = [
        replace(reef(), name=str(n), began=scenes.BEGAN + timedelta(days=n), measures=measures)
        for n, measures in enumerate((sized(10, 20), sized(15, 30, "by eye"), (), sized(10, 30)))
    ]
    netcdf.write(surveys[0], tmp_path / "survey.nc", surveys)
    with opened(tmp_path / "survey.nc") as file:
        of = file.variables
        fill = netcdf.FILL
        assert of["size_share_010_015_cm"][:].tolist() == [0.5, 0.0, fill, 0.25]
        assert of["size_share_025_030_cm"][:].tolist() == pytest.approx([0.0, 1.0 / 3.0, fill, 0.25])
        assert of["size_share_025_030_cm_low"][0] == 0.0
        # As wide as a bin of which so many told a share of 0.
        high = [1.96 * math.sqrt(0.01 * (0.183**2 + 1.0 / n)) for n in (50, 1)]
        assert of["size_share_025_030_cm_high"][0] == pytest.approx(high[0])
        # Of how many, nobody says: as if one told.
        assert of["size_share_010_015_cm_high"][1] == pytest.approx(high[1])
        assert b"a bin in which none is found" in of["size_share_025_030_cm"].comment
        assert b"a bin" not in getattr(of["time"], "comment", b"")


@pytest.mark.parametrize(("longitude", "heading"), [(179.9999, 20.0), (-179.9999, 200.0)])
def test_the_box_of_a_survey_on_the_date_line_is_narrow(
    longitude: float, heading: float, tmp_path: Path
) -> None:
    """West is the larger number: the box goes on through the line, and not around the globe."""
    survey = reef(site=Site("Reef", -17.0, longitude, heading_deg=heading))
    netcdf.write(survey, tmp_path / "survey.nc")
    darwin_core.write(survey, OYSTER, tmp_path, Author("Ada", "CC0-1.0"))
    with opened(tmp_path / "survey.nc") as file:
        west, east = float(file.geospatial_lon_min), float(file.geospatial_lon_max)
    with zipfile.ZipFile(tmp_path / "darwin-core.zip") as archive:
        eml = ET.fromstring(archive.read("eml.xml"))
    edges = [float(next(eml.iter(f"{side}BoundingCoordinate")).text or "") for side in ("west", "east")]
    for one, other in ((west, east), edges):
        assert one > 179.99
        assert other < -179.99
        assert (other - one) % 360.0 < 0.001


@pytest.mark.rare
def test_every_file_of_a_simulated_survey_says_so(tmp_path: Path) -> None:
    """And none of a real one."""
    for name, survey in (("made-up", reef()), ("real", replace(reef(), made_by={"version": "0.1.0"}))):
        folder = export(survey, tmp_path / name, species=OYSTER, author=Author("Ada", "CC0-1.0")).folder
        with opened(folder / "survey.nc") as file:
            told = {
                "nc title": file.title,
                "nc comment": file.comment,
            }
        with sqlite3.connect(folder / "survey.gpkg") as file:
            rows = file.execute("SELECT description FROM gpkg_contents WHERE description <> ''").fetchall()
            told |= {f"gpkg {n}": text.encode() for n, (text,) in enumerate(rows)}
            about = file.execute("SELECT value FROM about WHERE key = 'simulated'").fetchone()
        assert len(rows) == 8
        assert about == (words.warning(survey) or "no",)
        for path in folder.glob("*.tif"):
            # An ASCII tag of the header.
            told[path.name] = path.read_bytes()
        told |= {text: (folder / text).read_bytes() for text in ("README.md", "report.html")}
        with zipfile.ZipFile(folder / "darwin-core.zip") as archive:
            told["eml"] = archive.read("eml.xml")
            told |= {
                f"row {row}": row.encode()
                for row in archive.read("occurrence.csv").decode().split("\n")[1:-1]
            }
            measured = archive.read("extendedmeasurementorfact.csv").decode()
            told |= {f"row {row}": row.encode() for row in measured.split("\n")[1:-1]}
        # Each individual has a place and how sure it is; those that were measured have a size.
        facts = 2 * len(survey.individuals) + np.count_nonzero(survey.individuals.clear)
        assert sum(what.startswith("row ") for what in told) == facts
        assert len(told) > facts + 15
        for what, content in told.items():
            assert (b"simulated" in content.lower().replace(b"simulated reefs", b"")) == (
                name == "made-up"
            ), what
        for table in ("measures.csv", "individuals.csv"):
            column = {row["simulated"] for row in rows_of((folder / table).read_text())}
            assert column == ({"world made/by-hand, seed 1"} if name == "made-up" else {""})


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_occurrences_as_obis_asks(tmp_path: Path) -> None:
    real = replace(reef(), made_by={"version": "0.1.0"})
    darwin_core.write(real, OYSTER, tmp_path)
    rows = rows_of((tmp_path / "occurrence.csv").read_text())
    assert len(rows) == 60
    cited = (ROOT / "CITATION.cff").read_text()
    author, title = (re.search(rf"{key}: (.*)", cited) for key in ("name", "title"))
    assert author is not None
    assert title is not None
    assert (ROOT / darwin_core.METHOD).is_file()
    reference = f"{author[1]}: {title[1]}, version 0.1.0, {darwin_core.METHOD}"
    longitude, latitude = Ground(SITE).globe(*real.individuals.position[:, :2].T)
    for n, row in enumerate(rows):
        assert row["basisOfRecord"] == "MachineObservation"
        assert row["identificationVerificationStatus"] == "PredictedByMachine"
        assert row["identificationReferences"] == reference
        assert row["occurrenceStatus"] == "present"
        assert (row["scientificName"], row["scientificNameID"]) == (OYSTER.name, OYSTER.id)
        assert row["eventDate"] == "2026-06-01T09:30:00Z/2026-06-01T09:32:00Z"
        assert float(row["decimalLongitude"]) == pytest.approx(longitude[n], abs=6e-8)
        assert float(row["decimalLatitude"]) == pytest.approx(latitude[n], abs=6e-8)
        assert row["coordinateUncertaintyInMeters"] == "", "nobody said how sure the place of the reef is"
        assert (row["organismQuantity"], row["organismQuantityType"]) == ("1", "clumps")
        assert "individualCount" not in row
        assert "clump of shells" in row["occurrenceRemarks"]
        assert row["minimumDepthInMeters"] == row["maximumDepthInMeters"] == "5.20"
        assert row["verticalDatum"] == "MLLW"
    assert len({row["occurrenceID"] for row in rows}) == 60


def test_an_older_survey_that_does_not_say_whose_size_is_its_own_is_warned_of(tmp_path: Path) -> None:
    found = reef().individuals
    older = replace(reef(), individuals=replace(found, clear=np.zeros(len(found), np.bool_)))
    for name, survey, warned in (("older", older, True), ("new", reef(), False), ("wreck", wreck(), False)):
        made = export(survey, tmp_path / name, only=["tables"])
        assert any("no individual is given a size" in line for line in made.warnings) == warned
        assert ("no individual is given a size" in (made.folder / "README.md").read_text()) == warned


@pytest.mark.parametrize("metres", [0.0, 0.1, 5.0])
def test_a_place_is_as_sure_as_the_site_and_the_find_together(metres: float) -> None:
    rows = darwin_core.occurrences(reef(site=replace(SITE, uncertainty=metres)), OYSTER)
    # √(−2 ln 0.05) standard errors of 5 cm hold 95 % of a circular scatter.
    found = 0.05 * np.sqrt(-2.0 * np.log(0.05))
    assert {row["coordinateUncertaintyInMeters"] for row in rows} == {f"{np.hypot(found, metres):.2f}"}
    told = dict(words.facts(reef(site=replace(SITE, uncertainty=metres))))
    assert told["Origin sure to"] == f"{metres:g} m (95 %)"
    assert "Origin sure to" not in dict(words.facts(reef()))


def test_what_is_likely_no_individual_is_not_told_to_be_present(tmp_path: Path) -> None:
    found = reef().individuals
    confidence = found.confidence.copy()
    confidence[[3, 40]] = 0.4
    # One that stands on the reef may be likely though no frame labelled it.
    hits = found.hits.copy()
    hits[17] = 0
    doubtful = replace(reef(), individuals=replace(found, confidence=confidence, hits=hits))
    darwin_core.write(doubtful, OYSTER, tmp_path)
    rows = rows_of((tmp_path / "occurrence.csv").read_text())
    sure = np.delete(np.arange(60), [3, 17, 40])
    every = [row["occurrenceID"] for row in darwin_core.occurrences(reef(), OYSTER)]
    assert [row["occurrenceID"] for row in rows] == [every[n] for n in sure]
    with zipfile.ZipFile(tmp_path / "darwin-core.zip") as archive:
        measured = rows_of(archive.read("extendedmeasurementorfact.csv").decode())
    sizes = [float(r["measurementValue"]) for r in measured if r["measurementType"].startswith("longest")]
    assert sizes == pytest.approx(found.size[sure[found.clear[sure]]].tolist(), abs=5e-4)


def test_rows_are_nowhere_taken_for_all_individuals(tmp_path: Path) -> None:
    """The relief shows about half of them; how many there are is the measure."""
    count = Measure("count", 1234.0, 1100.0, 1350.0, "")
    survey = replace(reef(), measures=(count,))
    darwin_core.write(survey, OYSTER, tmp_path, Author("Ada", "CC0-1.0"))
    with zipfile.ZipFile(tmp_path / "darwin-core.zip") as archive:
        assert "the number of records is no count" in archive.read("eml.xml").decode()
    page.write(survey, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "the 60 individuals that were found one by one. They are not all" in text
    assert "1,234" in text
    assert "counted once" not in text


def test_a_reef_in_ground_that_nobody_saw_is_not_said_to_be_in_the_figures() -> None:
    some, told = reef(), "where it was looked at and right beside"
    assert (some.layers.state == 0).any()
    assert told in words.summary(some)[0]
    every = replace(some, layers=replace(some.layers, state=np.maximum(some.layers.state, 1)))
    assert told not in words.summary(every)[0]


def test_how_much_was_looked_at_is_one_figure_in_a_report(tmp_path: Path) -> None:
    """That of the measure, which is of the area to be seen; the map may reach farther."""
    survey = reef()
    page.write(survey, tmp_path / "report.html")
    told = next(m for m in survey.measures if m.name == "seen_share")
    assert (survey.layers.state != scenes.UNKNOWN).mean() > 0.95
    assert words.value_text(told) == "90.0 %"
    sentences = [line for line in words.summary(survey) if "was looked at; of the rest" in line]
    assert sentences == [
        "90.0 % of the area that was to be seen was looked at; of the rest nothing is known."
    ]
    assert "97 %" not in Seen((tmp_path / "report.html").read_text()).text
    untold = replace(survey, measures=())
    assert words.summary(untold) == ["97 % of the map was looked at; of the rest nothing is known."]


def test_each_of_the_three_areas_is_told_with_what_it_is(tmp_path: Path) -> None:
    """Two square metres of picture, a quarter of it shell, an eighth doubtful and an eighth unseen."""
    share = np.zeros((4, 8), np.uint8)
    share[:2, :4], share[2, :4], share[3, :4] = 200, 99, 255
    survey = replace(reef(), picture=Picture(Bounds(0.0, 0.0, 2.0, 1.0), 0.25, share))
    told = {area.title: area.value for area in areas.areas(survey)}
    cells = int((survey.layers.state == scenes.TARGET).sum())
    assert told["Target cells"] == f"{cells * 0.0625:.1f} m²"
    assert told["Reef area"] == words.value_text(survey.measures[0])
    assert told["Shell cover"] == "0.500 m²"
    folder = export(survey, tmp_path / "out", only=("html", "netcdf")).folder
    texts = [(folder / "README.md").read_text(), Seen((folder / "report.html").read_text()).text]
    for area in areas.areas(survey):
        assert all(area.value in text and area.says in text for text in texts)
    with opened(folder / "survey.nc") as file:
        assert file.variables["habitat"].comment.decode() == areas.WHY
    assert areas.areas(wreck()) == ()


def test_limits_say_where_intervals_come_from_and_what_they_do_not_hold() -> None:
    told = " ".join(words.limits(replace(reef(), made_by={})))
    assert "calibrated" in told
    assert "simulated reefs" in told
    assert "What lies farther into it is in no figure and in no interval" in told
    assert "neither as reef nor as bare" not in told
    assert "not calibrated" in " ".join(words.limits(wreck()))


def test_identifiers_are_the_same_again_and_no_others(tmp_path: Path) -> None:
    once = [row["occurrenceID"] for row in darwin_core.occurrences(reef(), OYSTER)]
    again = [row["occurrenceID"] for row in darwin_core.occurrences(reef(), OYSTER)]
    later = [row["occurrenceID"] for row in darwin_core.occurrences(LATER, OYSTER)]
    assert once == again
    assert not set(once) & set(later)


def test_what_is_simulated_says_so_in_every_row() -> None:
    assert all(
        row["occurrenceRemarks"].startswith("SIMULATED") for row in darwin_core.occurrences(reef(), OYSTER)
    )
    real = replace(reef(), made_by={})
    assert not any("SIMULATED" in row["occurrenceRemarks"] for row in darwin_core.occurrences(real, OYSTER))


def test_an_archive_whose_columns_are_what_it_says(tmp_path: Path) -> None:
    darwin_core.write(reef(), OYSTER, tmp_path, Author("Ada & Lovelace <A.>", "CC0-1.0", "ada@example.org"))
    with zipfile.ZipFile(tmp_path / "darwin-core.zip") as archive:
        assert archive.testzip() is None
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    meta = ET.fromstring(texts["meta.xml"])
    space = "{http://rs.tdwg.org/dwc/text/}"
    assert meta.get("metadata") == "eml.xml"
    for part in (meta.find(f"{space}core"), meta.find(f"{space}extension")):
        assert part is not None
        location = part.find(f"{space}files/{space}location")
        assert location is not None
        assert location.text is not None
        header = next(csv.reader(io.StringIO(texts[location.text])))
        for field in part.findall(f"{space}field"):
            assert header[int(field.get("index", ""))] == field.get("term", "").rpartition("/")[2]
    ids = {row["occurrenceID"] for row in rows_of(texts["occurrence.csv"])}
    measured = rows_of(texts["extendedmeasurementorfact.csv"])
    assert {row["occurrenceID"] for row in measured} == ids
    for row in measured:
        size = row["measurementType"].startswith("longest")
        assert row["measurementTypeID"].endswith("/P01/current/OBSINDLX/" if size else "")
        assert bool(row["measurementTypeID"]) == size, "no id is made up"
        assert row["measurementUnitID"].endswith("/P06/current/ULAA/" if size else "/P06/current/UUUU/")
    sizes = [float(r["measurementValue"]) for r in measured if r["measurementType"].startswith("longest")]
    found = reef().individuals
    assert sizes == pytest.approx(found.size[found.clear].tolist(), abs=5e-4), (
        "one that was not measured has none"
    )
    eml = ET.fromstring(texts["eml.xml"])
    names = [name.text for name in eml.iter("surName")]
    assert names == ["Ada & Lovelace <A.>"] * 2
    address = "http://creativecommons.org/publicdomain/zero/1.0/legalcode"
    assert [link.get("url") for link in eml.findall("dataset/intellectualRights/para/ulink")] == [address]
    assert [url.text for url in eml.findall("dataset/licensed/url")] == [address]
    assert {row["license"] for row in rows_of(texts["occurrence.csv"])} == {address}
    assert 'term="http://purl.org/dc/terms/license"' in texts["meta.xml"]
    assert 'term="http://rs.iobis.org/obis/terms/measurementTypeID"' in texts["meta.xml"]


def test_a_licence_is_one_that_can_be_read_somewhere() -> None:
    own = Author("Ada", "https://example.org/terms")
    assert own.licence_address == own.licence
    with pytest.raises(ValueError, match=r"expected CC0-1\.0, CC-BY-4\.0, CC-BY-NC-4\.0, or the address"):
        Author("Ada", "ask me")


def test_no_species_and_no_author_are_made_up(tmp_path: Path) -> None:
    for name, number in (("", OYSTER.id), ("Ostrea edulis", ""), ("Ostrea edulis", "140658")):
        with pytest.raises(ValueError, match="species"):
            Species(name, number)
    darwin_core.write(reef(), OYSTER, tmp_path)
    with zipfile.ZipFile(tmp_path / "darwin-core.zip") as archive:
        assert "eml.xml" not in archive.namelist()
        assert b"metadata" not in archive.read("meta.xml")
    with pytest.raises(ValueError, match="one of a wreck"):
        darwin_core.write(wreck(), OYSTER, tmp_path)


def test_tables_open_with_and_without_an_origin(tmp_path: Path) -> None:
    tables.write(reef(), tmp_path)
    measures = rows_of((tmp_path / "measures.csv").read_text())
    assert len(measures) == len(reef().measures) + sum(len(patch.measures) for patch in reef().patches)
    assert measures[0]["of"] == "survey"
    assert float(measures[0]["value"]) == pytest.approx(reef().measures[0].value, rel=1e-5)
    placed = rows_of((tmp_path / "individuals.csv").read_text())
    tables.write(reef(site=None), tmp_path)
    local = rows_of((tmp_path / "individuals.csv").read_text())
    assert len(placed) == len(local) == 60
    assert "longitude" in placed[0]
    assert "longitude" not in local[0]
    found = reef().individuals
    assert float(local[7]["x_m"]) == pytest.approx(found.position[7, 0], abs=5e-4)
    for row, size, clear in zip(local, found.size, found.clear, strict=True):
        assert (row["size_m"], bool(row["size_sigma_m"])) == (f"{size:.3f}" if clear else "", clear)


def test_names_that_people_gave_stay_as_they_are_and_all_else_is_ascii(tmp_path: Path) -> None:
    """Without a byte order mark, which R would take into the name of the first column."""
    name = "Rømø Flak, Österriff"
    survey = replace(reef(site=replace(SITE, name=name)), name=name)
    other = replace(survey, name="before", began=survey.began - timedelta(days=365))
    only = ("tables", "series", "darwin-core")
    made = export(survey, tmp_path / "out", only=only, species=OYSTER, others=[other])
    files = {path.name: path.read_text("utf-8") for path in made.folder.glob("*.csv")}
    assert len(files) == 4
    for text in files.values():
        assert text.replace(name, "").isascii()
    assert rows_of(files["occurrence.csv"])[0]["locality"] == name
    assert rows_of(files["series.csv"])[-1]["survey"] == name


@pytest.mark.parametrize("begins", "=+-@\t\r")
def test_no_cell_is_taken_for_a_formula(begins: str, tmp_path: Path) -> None:
    sly = begins + '1+cmd|" /C calc"!A0'
    told = Measure("sly", -1.5, -2.0, -1.0, "m", sly)
    site = replace(SITE, name=sly)
    survey = replace(reef(site=site), measures=(told, *reef().measures))
    tables.write(survey, tmp_path)
    darwin_core.write(survey, Species(sly, OYSTER.id), tmp_path)
    measured = rows_of((tmp_path / "measures.csv").read_bytes().decode())[0]
    assert (measured["note"], measured["value"]) == (f"'{sly}", "-1.5")
    occurred = rows_of((tmp_path / "occurrence.csv").read_bytes().decode())[0]
    assert (occurred["locality"], occurred["scientificName"]) == (f"'{sly}", f"'{sly}")


@pytest.mark.parametrize("survey", [reef(), wreck(), reef(site=None)], ids=["reef", "wreck", "no origin"])
def test_a_page_that_loads_nothing_and_tells_every_measure(survey: Any, tmp_path: Path) -> None:
    page.write(survey, tmp_path / "report.html", [("survey.gpkg", "all of it")])
    text = (tmp_path / "report.html").read_text()
    seen = Seen(text)
    assert "script" not in seen.tags
    assert all(load.startswith("data:") for load in seen.loads)
    assert "default-src 'none'" in text
    for measure in survey.measures:
        assert words.value_text(measure) in seen.text
        assert words.interval_text(measure) in seen.text
    for line in (*words.summary(survey), *words.limits(survey)):
        assert line in seen.text
    assert ("no origin" in seen.text) == (survey.site is None)
    for load in seen.loads[1:]:
        ET.fromstring(base64.b64decode(load.partition(",")[2]))


@pytest.mark.rare
def test_words_of_a_stranger_stay_words(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>$\\frac{"
    survey = replace(
        reef(site=replace(SITE, name=evil)),
        name=evil,
        measures=(
            Measure("<b>", 1.0, 0.0, 2.0, "<i>", evil),
            Measure("median_size", None, None, None, "m", evil),
        ),
        made_by={"world": evil, "planner": evil},
    )
    page.write(survey, tmp_path / "report.html")
    seen = Seen((tmp_path / "report.html").read_text())
    assert "script" not in seen.tags
    assert evil in seen.text
    pdf.write(survey, tmp_path / "report.pdf")


@pytest.mark.rare
def test_a_pdf_of_three_pages_that_is_the_same_again(tmp_path: Path) -> None:
    for name in ("one", "two"):
        pdf.write(reef(), tmp_path / f"{name}.pdf")
    content = (tmp_path / "one.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert len(re.findall(rb"/Type /Page\b", content)) == 3
    assert content == (tmp_path / "two.pdf").read_bytes()


@pytest.mark.parametrize(
    ("width", "length"), [(4.9, 0.5), (5.0, 1.0), (24.0, 2.0), (25.0, 5.0), (40.0, 5.0), (50.0, 10.0)]
)
def test_a_scale_of_round_length(width: float, length: float) -> None:
    assert sheet.scale_length(width) == pytest.approx(length)


def test_maps_of_the_report_are_turned_to_the_north() -> None:
    """With y bearing east, what lies along y is drawn to the right."""
    survey = reef(site=replace(SITE, heading_deg=90.0))
    east, north = sheet.east_north(survey.site, np.array([[0.0, 10.0]]))[0]
    assert (east, north) == pytest.approx((10.0, 0.0), abs=1e-9)
    figure, axes = sheet.new_figure(4.0, 4.0)
    figures.habitat_map(axes, survey)
    figure.canvas.draw()
    image = axes.images[0]
    corner = image.get_transform().transform(((0.0, 0.0),))
    assert axes.transData.inverted().transform(corner)[0] == pytest.approx((0.0, 0.0), abs=1e-6)
    far = image.get_transform().transform(((0.0, 16.0),))
    assert axes.transData.inverted().transform(far)[0] == pytest.approx((16.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(
    ("measure", "value", "interval"),
    [
        (Measure("reef_area", 34.8348, 33.09, 36.58, "m2"), "34.8 m²", "33.1 to 36.6 m²"),
        (Measure("density", 1.7224, 1.5157, 1.9291, "1/m2"), "1.72 per m²", "1.52 to 1.93 per m²"),
        (Measure("count", 60.0, 52.8, 67.2, ""), "60", "53 to 67"),
        (Measure("hull_seen", 0.93, 0.9, 0.96, ""), "93.0 %", "90.0 to 96.0 %"),
        (Measure("reef_area", 12_345.6, 11_000.0, 13_000.0, "m2"), "12,346 m²", "11,000 to 13,000 m²"),
        (Measure("reef_area", None, None, None, "m2"), "not measured", ""),
        (Measure("something_new", 2.0, None, None, "kg"), "2.0 kg", ""),
        (Measure("patch_count", 0.0, 0.0, 0.0, ""), "0", "0 to 0"),
    ],
)
def test_figures_have_the_digits_that_they_are_worth(measure: Measure, value: str, interval: str) -> None:
    assert words.value_text(measure) == value
    assert words.interval_text(measure) == interval


@pytest.mark.rare
def test_only_sizes_that_were_measured_are_drawn_and_none_where_none_was(tmp_path: Path) -> None:
    found = reef().individuals
    _, axes = sheet.new_figure(4.0, 3.0)
    figures.size_figure(axes, reef())
    bars: Any = axes.containers[0]
    assert sum(bar.get_height() for bar in bars) == np.count_nonzero(found.clear) < len(found)
    none = replace(reef(), individuals=replace(found, clear=np.zeros(len(found), np.bool_)))
    for survey, drawn in ((reef(), True), (none, False)):
        assert figures.tells_sizes(survey) == drawn
        page.write(survey, tmp_path / "report.html")
        assert ("<h2>Sizes" in (tmp_path / "report.html").read_text()) == drawn


def test_shares_of_sizes_are_drawn_with_their_intervals_and_not_listed() -> None:
    shares = tuple(
        Measure(f"size_share_{first:03d}_{first + 5:03d}_cm", 0.2, 0.1, 0.3, "") for first in range(10, 35, 5)
    )
    survey = replace(reef(), measures=reef().measures + shares)
    assert words.listed(survey) == list(reef().measures)
    assert words.meaning(shares[1].name).title == "15 to 20 cm wide"
    assert words.value_text(shares[1]) == "20 %"
    _, axes = sheet.new_figure(4.0, 3.0)
    figures.size_figure(axes, survey)
    bars = [(bar.get_x(), bar.get_width(), bar.get_height()) for bar in axes.containers[0]]
    assert bars[0] == pytest.approx((0.10, 0.05, 20.0))
    assert np.sort(np.asarray(axes.lines[0].get_ydata(), float)) == pytest.approx([10.0, 30.0])


def test_individuals_without_a_measured_size_are_drawn_as_dots() -> None:
    from matplotlib.colors import to_hex

    survey = reef()
    clear = np.arange(len(survey.individuals)) % 3 == 0
    survey = replace(survey, individuals=replace(survey.individuals, clear=clear))
    _, axes = sheet.new_figure(4.0, 4.0)
    figures.habitat_map(axes, survey)
    (scaled,) = axes.collections
    assert len(np.asarray(scaled.get_offsets())) == clear.sum()
    (dots,) = (line for line in axes.lines if np.asarray(line.get_xdata()).size == (~clear).sum())
    assert dots.get_linestyle() == "None"
    filled = to_hex(np.asarray(scaled.get_facecolor())[0])
    assert to_hex(dots.get_markerfacecolor()) != filled, "or it looks like a small one drawn to scale"
    legend = axes.get_legend()
    assert legend is not None
    told = [text.get_text() for text in legend.get_texts()]
    assert {"individual, to scale", "individual, size not measured"} <= set(told)
