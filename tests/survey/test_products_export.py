"""All products into one folder: whole or not at all, whatever goes wrong on the way."""

from __future__ import annotations

import csv
import json
import re
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.commands.survey.export import Export
from dream.extras import missing
from dream.survey import Survey
from dream.survey.archive import open_archive
from dream.survey.products import PRODUCTS, Species, export
from dream.survey.products.export import FILES
from tests.survey.floor import keep_frames
from tests.survey.scenes import reef, wreck

pytest.importorskip("pyproj")
pytest.importorskip("rasterio")

OYSTER = Species("Ostrea edulis", "urn:lsid:marinespecies.org:taxname:1")
QUICK = ("geotiff", "geopackage", "netcdf", "tables")


def test_every_product_of_a_reef(tmp_path: Path) -> None:
    made = export(reef(), tmp_path / "out", species=OYSTER)
    assert made.folder == tmp_path / "out"
    assert set(made.files) == {path.name for path in made.folder.iterdir()}
    assert set(FILES) - {"mosaic.tif", "series.csv", "series.png", "structures.ply"} <= set(made.files)
    assert list(made.left_out) == ["mosaic", "series"]
    assert "--run" in made.left_out["mosaic"]
    assert "two surveys of the site" in made.left_out["series"]
    readme = (made.folder / "README.md").read_text()
    for name in made.files:
        assert name.endswith(".qml") or name in readme or name == "README.md"
    assert "EPSG:32632" in readme
    assert "survey.gpkg" in (made.folder / "report.html").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_earlier_surveys_stand_before_it_in_the_series(tmp_path: Path) -> None:
    from scipy.io import netcdf_file

    pytest.importorskip("pyproj")
    now = reef()
    before = replace(now, name="the year before", began=now.began - timedelta(days=365))
    made = export(now, tmp_path / "export", others=[before], only=["netcdf"])
    with netcdf_file(made.folder / "survey.nc", mmap=False) as file:
        names = [b"".join(row).decode().strip("\0 ") for row in file.variables["survey"][:]]
    assert names == ["the year before", now.name]


def test_a_survey_of_elsewhere_is_left_out_of_the_series_and_all_else_is_written(tmp_path: Path) -> None:
    now = reef()
    assert now.site is not None
    far, near = (
        replace(now, name=name, began=now.began - timedelta(days=365), site=replace(now.site, latitude=north))
        for name, north in (("far", 54.95), ("near", 54.900027))
    )
    made = export(now, tmp_path / "one", others=[far], only=["netcdf", "tables"])
    assert {"survey.nc", "measures.csv"} <= set(made.files)
    assert made.warnings == (
        "far is not in the series: expected origins at most 5 km apart, got 5.6 km. Is one of the two site "
        "files wrong?",
    )
    assert made.warnings[0] in (made.folder / "README.md").read_text()
    both = export(now, tmp_path / "both", others=[far, near, now], only=["series"])
    rows = list(csv.DictReader((both.folder / "series.csv").read_text().splitlines()))
    assert list(dict.fromkeys(row["survey"] for row in rows)) == ["near", now.name]


@pytest.mark.rare
def test_without_an_origin_reports_and_tables_still_come(tmp_path: Path) -> None:
    made = export(reef(site=None), tmp_path / "out", species=OYSTER, run=tmp_path)
    assert made.files == ("README.md", "individuals.csv", "measures.csv", "report.html", "report.pdf")
    assert set(made.left_out) == set(PRODUCTS) - {"tables", "html", "pdf", "mesh"}
    assert all("run without origin" in reason for reason in made.left_out.values())


@pytest.mark.parametrize("name", ["geotiff", "geopackage", "netcdf", "darwin-core", "mosaic", "series"])
def test_what_is_asked_for_and_cannot_be_made_is_an_error(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"{name}: .*run without origin"):
        export(reef(site=None), tmp_path / "out", only=("tables", name))
    assert not list(tmp_path.iterdir())


def test_no_occurrences_of_a_wreck_nor_of_nameless_species(tmp_path: Path) -> None:
    for survey, species, reason in ((wreck(), OYSTER, "wreck"), (reef(), None, "--species-id")):
        with pytest.raises(ValueError, match=reason):
            export(survey, tmp_path / "out", only=("darwin-core",), species=species)
    assert not list(tmp_path.iterdir())


def test_an_unknown_product_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="geotif"):
        export(reef(), tmp_path / "out", only=("geotif",))


def test_a_folder_that_exists_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "kept").write_text("mine")
    with pytest.raises(ValueError, match="does not exist"):
        export(reef(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def shrunk(survey: Survey) -> Survey:
    return replace(survey, layers=replace(survey.layers, relief=survey.layers.relief[:-1]))


def strange_state(survey: Survey) -> Survey:
    return replace(survey, layers=replace(survey.layers, state=survey.layers.state + np.uint8(9)))


def lost_sizes(survey: Survey) -> Survey:
    return replace(survey, individuals=replace(survey.individuals, size=survey.individuals.size[:3]))


def nowhere(survey: Survey) -> Survey:
    position = survey.individuals.position.copy()
    position[7, 1] = np.nan
    return replace(survey, individuals=replace(survey.individuals, position=position))


def of_no_patch(survey: Survey) -> Survey:
    return replace(survey, patches=survey.patches[:1])


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (shrunk, "layers.relief"),
        (strange_state, "layers.state"),
        (lost_sizes, "individuals.size"),
        (nowhere, "individuals.position"),
        (of_no_patch, "individuals.patch"),
    ],
)
def test_a_damaged_survey_is_refused(damage: Callable[[Survey], Survey], says: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=says):
        export(damage(reef()), tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.rare
def test_where_the_disk_is_full_nothing_is_left(tmp_path: Path) -> None:
    """No file may grow beyond a limit, by the system itself: several at four sizes, and each by itself at one
    that its largest file exceeds and README.md does not."""
    attempts: list[tuple[int, tuple[str, ...]]] = [(room, QUICK) for room in (2_000, 9_000, 30_000, 120_000)]
    attempts += [(6_000, (name,)) for name in PRODUCTS if name != "mesh"]
    keep_frames(tmp_path / "run")
    program = (
        "import resource; from dataclasses import replace; from datetime import timedelta\n"
        "from pathlib import Path; from tests.survey.scenes import reef\n"
        "from dream.survey.products import Species, export\n"
        "now = reef(); before = replace(now, name='before', began=now.began - timedelta(days=365))\n"
        f"here, species = Path({str(tmp_path)!r}), Species({OYSTER.name!r}, {OYSTER.id!r})\n"
        f"for room, only in {attempts!r}:\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))\n"
        "    try: export(now, here / 'out', run=here / 'run', only=only, species=species, others=[before])\n"
        "    except OSError as error: print(*only, error)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    told = ended.stdout.splitlines()
    assert [line.partition(" export: ")[0] for line in told] == [" ".join(only) for _, only in attempts]
    assert all("Choose another" in line for line in told)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_interruption_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("dream.survey.products.geopackage.write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        export(reef(), tmp_path / "out", only=QUICK)
    assert not list(tmp_path.iterdir())


def test_the_same_survey_gives_the_same_files(tmp_path: Path) -> None:
    one, two = (export(reef(), tmp_path / name, only=QUICK).folder for name in ("one", "two"))
    for path in one.iterdir():
        assert path.read_bytes() == (two / path.name).read_bytes(), path.name


@pytest.mark.parametrize("package", ["pyproj", "rasterio"])
def test_a_missing_package_is_named(package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ValueError, match=re.escape(missing("survey", package, "maps"))):
        export(reef(), tmp_path / "out", only=("geotiff",))
    export(reef(site=None), tmp_path / "local", only=("tables",))
    assert [path.name for path in tmp_path.iterdir()] == ["local"]


def opened(command: Export, survey: Survey, monkeypatch: pytest.MonkeyPatch) -> Export:
    monkeypatch.setattr("dream.commands.survey.export.found", lambda *_: survey)
    return command


def test_the_command_prints_one_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = Export("7", tmp_path / "out", only=("tables", "geopackage"), json=True)
    assert opened(command, reef(), monkeypatch)() == 0
    told = json.loads(capsys.readouterr().out)
    assert told["files"] == ["README.md", "individuals.csv", "measures.csv", "survey.gpkg"]
    assert told["left_out"] == {}
    with pytest.raises(ValueError, match="does not exist"):
        command()


def test_the_command_says_what_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for report in ("page", "pdf"):
        monkeypatch.setattr(f"dream.survey.products.{report}.write", lambda *_: None)
    opened(Export("7", tmp_path / "out"), reef(site=None), monkeypatch)()
    out = capsys.readouterr().out
    assert "measures.csv" in out
    assert "without geotiff: " in out


def test_the_command_tells_how_all_surveys_of_the_site_in_the_archive_went(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Also where one of them is damaged, or where somebody else's lie beside them."""
    now = reef()
    assert now.site is not None
    names = ("first", "damaged", "elsewhere", "of a wreck")
    first, damaged, elsewhere, other = (
        replace(now, name=name, began=now.began - timedelta(days=400 - n)) for n, name in enumerate(names)
    )
    where = str(tmp_path / "surveys.gpkg")
    with open_archive(where, begin=True) as archive:
        archive.add(first)
        number, _ = archive.add(damaged)
        archive.add(replace(elsewhere, site=replace(now.site, name="Outer reef")))
        archive.add(replace(wreck(site=now.site), name=other.name))
        archive.add(now)
    with sqlite3.connect(where) as file:
        file.execute("UPDATE documents SET body = x'00' WHERE survey_id = ?", (number,))
    command = Export("7", tmp_path / "out", archive=where, only=("series", "tables"), json=True)
    assert opened(command, now, monkeypatch)() == 0
    assert {"series.csv", "series.png"} <= set(json.loads(capsys.readouterr().out)["files"])
    rows = list(csv.DictReader((tmp_path / "out/series.csv").read_text().splitlines()))
    assert list(dict.fromkeys(row["survey"] for row in rows)) == ["first", now.name]
    assert "damaged is not in the series" in caplog.text
    assert not re.search("elsewhere|of a wreck", caplog.text), "of those nobody asked"


@pytest.mark.rare
def test_an_archive_that_is_not_there_or_damaged_hinders_no_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "damaged.gpkg").write_text("no database")
    for name, only, warned in (
        ("none.gpkg", ("tables", "html"), False),
        ("damaged.gpkg", ("tables", "html"), True),
        # Which tell of one survey alone.
        ("damaged.gpkg", ("tables", "geopackage"), False),
    ):
        caplog.clear()
        to = tmp_path / f"{only[-1]} of {name}"
        command = Export("7", to, archive=str(tmp_path / name), only=only)
        assert opened(command, reef(), monkeypatch)() == 0
        assert ("the series is without what the archive keeps" in caplog.text) == warned


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"species": "Ostrea edulis"}, "--species-id"),
        ({"author": "Ada"}, "--licence"),
        ({"survey": "no such thing"}, "none of them"),
    ],
)
def test_the_command_refuses_half_of_an_answer(options: dict[str, str], says: str, tmp_path: Path) -> None:
    with pytest.raises((ValueError, FileNotFoundError), match=says):
        Export(**{"survey": "7", "to": tmp_path / "out", **options})()  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
