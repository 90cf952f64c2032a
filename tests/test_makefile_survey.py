"""The tutorial of a reef with short missions: every file of `make survey` opens in what it is for."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.recording import read_config, read_steps
from dream.survey.archive import VARIABLE
from dream.survey.site import Site, read_site
from tests.docs.test_tutorials import Reader, page_named
from tests.survey.browsing import Seen

for needed in ("rasterio", "pyogrio", "pyproj"):
    pytest.importorskip(needed)
if shutil.which("make") is None:
    pytest.skip("needs make", allow_module_level=True)

pytestmark = pytest.mark.rare

REPOSITORY = Path(__file__).parents[1]
STEPS = 14
"""Decisions of each mission: both see a part of the same reef."""
AWAY = 60.0
"""Metres from the origin within which all lies that was surveyed."""
LISTS_ITS_WORDS = """#!/bin/sh
{ printf '%s\\037' "$DREAM_ARCHIVE" "$@"; echo; } >> "$TYPED"
"""
"""A program in the place of `dream`: it leaves a line of what it was given."""


def recipe(folder: Path) -> list[list[str]]:
    """What `make survey` types, the archive of each command first."""
    shim, typed = folder / "bin/dream", folder / "typed"
    shim.parent.mkdir()
    shim.write_text(LISTS_ITS_WORDS)
    shim.chmod(0o755)
    # All that is set up is taken to be so.
    make = ["make", "--no-print-directory", "-C", str(REPOSITORY), "-o", "setup-survey", "survey"]
    told = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    made = subprocess.run(
        [*make, f"BIN={shim.parent}"], check=True, stdout=subprocess.PIPE, env={**told, "TYPED": str(typed)}
    )
    commands = [line.split("\037")[:-1] for line in typed.read_text().splitlines()]
    # Each is shown as it can be typed, behind where the archive is.
    shown = [line[2:] for line in made.stdout.decode().splitlines() if line.startswith("$ ")]
    archive = f"export DREAM_ARCHIVE={commands[0][0]}"
    assert shown == [archive, *(" ".join([str(shim), *words]) for _, *words in commands)]
    return commands


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, worlds_are_made_once: None) -> Path:
    """The folder that it leaves, once all of the tutorial is followed."""
    with pytest.MonkeyPatch.context() as patch:
        reader = Reader(tmp_path_factory.mktemp("reef"), patch, STEPS)
        reader.follow(page_named("reef"))
        (left,) = (reader.at / "runs").glob("survey-*")
    return left


def test_it_shows_its_commands_and_the_page_of_surveys_has_them_typed(tmp_path: Path) -> None:
    commands = recipe(tmp_path)
    assert [command[1] for command in commands].count("run") == 2
    page = (REPOSITORY / "docs/survey.md").read_text(encoding="utf-8")
    block = page.split("## From nothing to a comparison")[1].split("```sh\n")[1].split("```")[0]
    ((file, site),) = re.findall(r"cat > (\S+) <<'SITE'\n(.*?)\nSITE\n", block, re.DOTALL)
    typed = [line for line in block.replace("\\\n", " ").splitlines() if line.startswith("dream ")]
    # The page has a folder and a site of its own, and looks at the first survey too.
    own = {str(Path(commands[0][0]).parent): str(Path(file).parent), "examples/site.json": file}
    told = [" ".join(["dream", *words]) for _, *words in commands]
    for here, there in own.items():
        told = [line.replace(here, there) for line in told]
    assert [" ".join(line.split()) for line in typed if line != "dream survey show 1"] == told
    (tmp_path / "site.json").write_text(site)
    assert read_site(tmp_path / "site.json").name


@pytest.fixture(scope="module")
def site() -> Site:
    """Where it says that the reef is."""
    return read_site(REPOSITORY / "examples/site.json")


def newest(runs: Path) -> Path:
    """The folder of the only run."""
    return runs / (runs / "latest").readlink()


def metres_from(site: Site, longitude: Any, latitude: Any) -> Any:
    """How far places lie from the origin, on the ellipsoid."""
    from pyproj import Geod

    lon, lat, to_lon, to_lat = np.broadcast_arrays(site.longitude, site.latitude, longitude, latitude)
    return Geod(ellps="WGS84").inv(lon, lat, to_lon, to_lat)[2]


def rows_of(path: Path) -> list[dict[str, str]]:
    """Of a table, each with a cell for every heading."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(None not in row and None not in row.values() for row in rows)
    return rows


def pages_of(path: Path) -> int:
    """How many a PDF has, as its tree of pages says, and as many as there are."""
    content = path.read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    (count,) = map(int, re.findall(rb"/Count (\d+)", content))
    assert len(re.findall(rb"/Type /Page\b", content)) == count
    return count


def opens_raster(path: Path) -> None:
    import rasterio

    with rasterio.open(path) as raster:
        assert raster.crs is not None
        assert raster.dataset_mask().any()
        assert all(raster.read(band).size for band in raster.indexes)


def opens_vectors(path: Path) -> None:
    import pyogrio

    layers = pyogrio.list_layers(path)[:, 0]
    assert len(layers)
    for layer in layers:
        pyogrio.raw.read(path, layer=layer)


def opens_netcdf(path: Path) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(path, mmap=False) as file:
        assert file.variables
        assert all(np.shape(variable.data) == variable.shape for variable in file.variables.values())


def opens_picture(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as picture:
        picture.load()
        assert min(picture.size) > 1


def opens_page(path: Path) -> None:
    page = Seen(path.read_text(encoding="utf-8"))
    assert page.tags[0] == "html"
    assert page.text.strip()
    assert not [where for where in page.loads if where.startswith(("http", "//", "/"))]


def opens_arrays(path: Path) -> None:
    with np.load(path, allow_pickle=False) as arrays:
        assert all(arrays[name] is not None for name in arrays)


def opens_lines(path: Path) -> None:
    assert all(isinstance(json.loads(line), dict) for line in path.read_text(encoding="utf-8").splitlines())


OPENED: dict[str, Callable[[Path], object]] = {
    ".tif": opens_raster,
    ".gpkg": opens_vectors,
    ".nc": opens_netcdf,
    ".pdf": pages_of,
    ".png": opens_picture,
    ".html": opens_page,
    ".npz": opens_arrays,
    ".csv": rows_of,
    ".jsonl": opens_lines,
    ".json": lambda path: json.loads(path.read_text(encoding="utf-8")),
    ".qml": ElementTree.parse,
    ".md": lambda path: path.read_text(encoding="utf-8"),
}
"""How a file is opened, by its kind."""


def test_every_file_that_it_leaves_opens(made: Path) -> None:
    kinds: Counter[str] = Counter()
    for path in sorted(made.rglob("*")):
        if path.is_file() and not path.is_symlink():
            assert path.stat().st_size > 0, path
            OPENED[path.suffix](path)
            kinds[path.suffix] += 1
    assert kinds.keys() == OPENED.keys()


def test_the_second_mission_plans_with_the_survey_of_the_first(made: Path) -> None:
    before, after = (newest(made / name) for name in ("before", "after"))
    kept = (read_config(after).model_extra or {})["from_survey"]
    assert (kept["source"], kept["years"]) == (before.name, pytest.approx(1.0))
    said = [step.reasoning.distribution for step in read_steps(after)[4:]]
    assert len(said) == STEPS - 3
    assert all(f"The survey {before.name}, 1.0 years old, is believed to" in words for words in said)


def test_both_are_in_the_archive_and_what_changed_is_told_of_them(made: Path) -> None:
    import pyogrio

    names = [newest(made / name).name for name in ("before", "after")]
    fields, columns = (pyogrio.raw.read(made / "surveys.gpkg", layer="surveys")[k] for k in (0, 3))
    kept = dict(zip(fields["fields"], columns, strict=True))
    assert list(kept["name"][:2]) == names
    told = json.loads((made / "change/change.json").read_text())
    assert [told[when]["name"] for when in ("before", "after")] == names
    assert told["ground_m2"]["comparable"] > 100.0
    assert sum(told["individuals"][name] for name in ("there", "lost", "new")) > 0
    page = Seen((made / "change/change.html").read_text(encoding="utf-8")).text
    assert all(name in page for name in names)


def test_maps_lie_at_the_place_of_the_site_and_show_what_the_map_holds(made: Path, site: Site) -> None:
    import rasterio
    from rasterio.warp import transform_bounds

    with rasterio.open(made / "products/habitat.tif") as habitat:
        west, south, east, north = transform_bounds(habitat.crs, "EPSG:4326", *habitat.bounds)
        cells, square = habitat.read(1), abs(habitat.transform.a * habitat.transform.e)
    assert metres_from(site, [west, east], [south, north]).max() < AWAY
    told = {row["name"]: row["value"] for row in rows_of(made / "products/measures.csv")}
    assert 0.2 * float(told["reef_area"]) < square * np.count_nonzero(cells == 2) < float(told["reef_area"])
    with rasterio.open(made / "products/mosaic.tif") as mosaic:
        middle = transform_bounds(mosaic.crs, "EPSG:4326", *mosaic.bounds)
        picture = mosaic.read()[:3, mosaic.dataset_mask() > 0]
    assert metres_from(site, *middle[:2]) < AWAY
    assert picture.std() > 5.0


def test_individuals_are_the_same_in_the_table_and_in_the_geopackage(made: Path, site: Site) -> None:
    import pyogrio

    rows = rows_of(made / "products/individuals.csv")
    assert rows
    assert metres_from(
        site, [float(row["longitude"]) for row in rows], [float(row["latitude"]) for row in rows]
    ).max() < (AWAY)
    _, _, places, _ = pyogrio.raw.read(made / "products/survey.gpkg", layer="individuals")
    assert len(places) == len(rows)
    layers = set(pyogrio.list_layers(made / "products/survey.gpkg")[:, 0])
    assert {"area", "patches", "individuals", "track", "decisions"} <= layers


def test_the_series_holds_both_years(made: Path) -> None:
    from scipy.io import netcdf_file

    names = [newest(made / name).name for name in ("before", "after")]
    rows = rows_of(made / "products/series.csv")
    assert list(dict.fromkeys(row["survey"] for row in rows)) == names
    with netcdf_file(made / "products/survey.nc", mmap=False) as file:
        assert file.dimensions["time"] == 2
        area = [float(value) for value in file.variables["reef_area"].data]
    told = [float(row["value"]) for row in rows if row["measure"] == "reef_area"]
    assert area == pytest.approx(told, rel=1e-4)
    assert min(told) > 0.0


def test_reports_tell_the_figures_and_where_they_are_from(made: Path, site: Site) -> None:
    page = Seen((made / "products/report.html").read_text(encoding="utf-8")).text
    assert site.name in page
    assert "Simulated: world reef/string+1y1, seed 1" in page
    assert pages_of(made / "products/report.pdf") >= 3
    assert "darwin-core" in (made / "products/README.md").read_text(encoding="utf-8")


def test_with_a_species_its_survey_is_an_archive_of_darwin_core(
    made: Path, site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, str(made / "surveys.gpkg"))
    ask = ["survey", "export", "2", "--to", str(tmp_path / "to"), "--only", "darwin-core", "--json"]
    species = {
        "--species": "Crassostrea virginica",
        "--species-id": "urn:lsid:marinespecies.org:taxname:140657",
    }
    assert run_command([*ask, *(word for option in species.items() for word in option)]) == 0
    with zipfile.ZipFile(tmp_path / "to/darwin-core.zip") as archive:
        assert archive.testzip() is None
        meta = ElementTree.fromstring(archive.read("meta.xml"))
        named = {element.text for element in meta.iter("{http://rs.tdwg.org/dwc/text/}location")}
        assert named == {name for name in archive.namelist() if name.endswith(".csv")}
        lines = archive.read("occurrence.csv").decode("utf-8").splitlines()
    rows = [row for row in csv.DictReader(lines) if row["decimalLongitude"]]
    assert rows
    assert {row["scientificName"] for row in rows} == {species["--species"]}
    places = [[float(row[name]) for row in rows] for name in ("decimalLongitude", "decimalLatitude")]
    assert metres_from(site, *places).max() < AWAY
