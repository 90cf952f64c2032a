"""`docs/files.md` describes every field that the program writes, and no other."""

from __future__ import annotations

import ast
import csv
import dataclasses
import inspect
import json
import re
import sqlite3
import zipfile
from collections.abc import Iterator
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream import scene
from dream.cli import run_command
from dream.evaluation import results
from dream.evaluation.engines import Processes
from dream.evaluation.foresight import Foreseen, Foresight
from dream.evaluation.metrics import Coverage
from dream.evaluation.oracle.bounds import read_bounds
from dream.evaluation.oracle.space_bounds import SpaceBounds
from dream.evaluation.probe import Score, write_page
from dream.evaluation.runner import Plan, _manifest
from dream.evaluation.suites import Case
from dream.geometry import SE2, SE3, Bounds
from dream.homeward import Budget
from dream.learning.lerobot import FEATURES
from dream.mapping import OccupancyMap
from dream.mapping.prior import Prior
from dream.orders import Leg, Orders, Side, SideOf, Task
from dream.perception.sidecar import Sidecar
from dream.planning import PLANNERS
from dream.planning.vlm.orders import write_mission
from dream.protocol import DREAM_V1, DREAM_V1_NAV, POOL_V1
from dream.recording import RecordedExchange, RecordedStep, RunConfig, RunSummary
from dream.robots import replay
from dream.robots.bluerov2 import dataset
from dream.robots.replay import Kept, Move
from dream.sim.sizes import Size
from dream.survey import files as survey_files
from dream.survey import reef as reef_measures
from dream.survey import wreck as wreck_measures
from dream.survey.archive.schema import MIGRATIONS, order
from dream.survey.change_layers import write_change_layers
from dream.survey.comparison import Comparing
from dream.survey.products import Species, export
from dream.survey.products.darwin_core import ARCHIVE
from dream.survey.products.export import FILES
from dream.survey.products.words import MEANINGS
from dream.survey.site import Site, read_site
from dream.types import Arrival, Setpoint
from tests.docs.fields import PAGE, described, keys, types
from tests.docs.reading import ROOT
from tests.evaluation.benches import Made, flown
from tests.recorded_runs import painted_observation
from tests.survey import repeated, scenes

HALF = Bounds(-20.0, -20.0, 0.0, 20.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run with orders, a site and a model."""
    where = tmp_path_factory.mktemp("run")
    write_mission(where / "half.json", "the western half", Orders((Leg(area=HALF),)))
    line = ["run", "dream", "--model", "wire", "--world", "flat/empty", "--max-steps", "8", "--json"]
    line += ["--budget-s", "1000", "--battery-wh", "100", "--tether-m", "100"]
    given = {
        "--out": where / "runs",
        "--site": ROOT / "examples" / "site.json",
        "--mission": where / "half.json",
    }
    assert run_command([*line, *(str(word) for pair in given.items() for word in pair)]) == 0
    return (where / "runs" / "latest").resolve()


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def fields_of(model: type[Any]) -> set[str]:
    return set(model.model_fields)


def test_every_file_of_a_run_is_told(run: Path) -> None:
    told = {name.rstrip("/") for row in described("A run") for name in row.replace("`", "").split(", ")}
    assert {path.name for path in run.iterdir()} <= told


# --- steps.jsonl


def step_keys() -> Iterator[str]:
    """Those that a line can have, by the models that check it."""
    for name, field in RecordedStep.model_fields.items():
        parts = [field.annotation, *getattr(field.annotation, "__args__", ())]
        nested = next((part for part in parts if hasattr(part, "model_fields")), None)
        if name == "map":
            yield from (
                f"map.{layer}" for p in (DREAM_V1, POOL_V1) for layer in OccupancyMap(None, p).areas()
            )
        elif name == "coverage":
            yield from (f"coverage.{way}" for way in Coverage.__slots__)
        else:
            if nested is None or len(parts) > 1:
                yield name
            yield from (f"{name}.{inner}" for inner in (nested.model_fields if nested else ()))


def test_every_key_of_a_step_is_told() -> None:
    assert set(described("steps.jsonl", table=0)) == set(step_keys())


def test_every_key_of_the_steps_of_a_run_is_told(run: Path) -> None:
    told = described("steps.jsonl", table=0)
    lines = [json.loads(line) for line in (run / "steps.jsonl").read_text().splitlines()]
    seen = {key for line in lines for key in keys(line, told)}
    assert seen == set(told)


def test_the_steps_of_a_run_make_a_table(run: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    pytest.importorskip("pandas")
    monkeypatch.chdir(run.parents[1])
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(code, {})
    assert "coverage.instances" in capsys.readouterr().out


# --- summary.json, config.json


def test_every_key_of_a_summary_is_told(run: Path) -> None:
    told = [name for table in range(4) for name in described("summary.json", table=table)]
    seen = set(keys(read(run / "summary.json"), told))
    assert seen == set(told)
    assert fields_of(RunSummary) <= {name.partition(".")[0] for name in told}


def test_every_key_of_a_config_is_told(run: Path) -> None:
    told = described("config.json")
    seen = set(keys(read(run / "config.json"), told))
    assert seen | {"from_survey", "mounting", "dive"} == set(told)
    assert fields_of(RunConfig) <= set(told)


# --- What lies beside them


def test_every_picture_of_a_run_is_told(run: Path) -> None:
    told = {name.replace("NNNN", "0003") for name in described("frames/ and maps/")}
    here = {f"{path.parent.name}/{path.name}" for path in run.glob("*/0003*.png")}
    assert told == here


def test_every_array_of_an_observation_is_told(run: Path, tmp_path: Path) -> None:
    told = described("observations/")
    with np.load(run / "observations" / "0003.npz") as arrays:
        assert set(told) - set(arrays.files) == {"confidence", "contact", "error", "trouble"}
    seen = painted_observation(1, SE2(0.0, 0.0, 0.0), np.random.default_rng(1))
    ones = np.ones_like(seen.depth)
    sure = dataclasses.replace(seen, confidence=ones, error=ones, drawn_wh=1.0, trouble="a lamp is out")
    truth = SE3.level(0.0, 0.0, 0.0, 0.0)
    arrival = Arrival(truth.se2, True, 1.0, 2.0, truth=truth, contact=(0.0, 0.0, 0.0))
    replay.write(tmp_path / "0001.npz", Kept(Move(Setpoint(0.0, 0.0, 0.0, 2.0), arrival), sure))
    into_space = Setpoint(0.0, 0.0, 0.0, None, -8.0)
    replay.write(tmp_path / "0002.npz", Kept(Move(into_space, arrival), sure))
    with np.load(tmp_path / "0001.npz") as planar, np.load(tmp_path / "0002.npz") as arrays:
        assert set(arrays.files) == set(told) == {*planar.files, "height"}
        kinds = {name: types("observations/")[name].rpartition(" ")[2] for name in told}
        assert {name: str(arrays[name].dtype) for name in told} == kinds


def test_every_array_of_a_map_is_told(tmp_path: Path) -> None:
    told, seen = described("map.npz"), set[str]()
    for protocol in (DREAM_V1, POOL_V1):
        OccupancyMap(Bounds(0.0, 0.0, 4.0, 4.0), protocol).save(tmp_path / "map.npz")
        with np.load(tmp_path / "map.npz") as arrays:
            seen |= set(arrays.files)
            about = json.loads(str(arrays["about"]))
    assert seen == set(told)
    (row,) = re.findall(r"^\| `about` .* JSON: (.*)$", PAGE, re.MULTILINE)
    assert set(about) == set(re.findall(r"`(\w+)`", row)) - {"ground_sum"}


def test_every_array_of_a_scene_is_told_with_its_type(tmp_path: Path) -> None:
    bounds = [[0.0, 0.0, -1.0], [1.0, 1.0, 0.0]]
    scene.save(scene.made(title="", bounds=bounds, water=0.0, field_of_view=(1.0, 1.0)), tmp_path / "s.npz")
    told = types("space.npz")
    with np.load(tmp_path / "s.npz") as arrays:
        assert set(arrays.files) == set(described("space.npz"))
        numbers = {name: str(arrays[name].dtype) for name in arrays.files if arrays[name].dtype.kind != "U"}
    assert numbers == {name: told[name].rpartition(" ")[2] for name in numbers}


def test_every_array_of_a_prior_is_told(tmp_path: Path) -> None:
    cells = np.zeros((4, 4))
    prior = Prior(Bounds(0.0, 0.0, 1.0, 1.0), 0.25, cells.astype(np.float32), cells.astype(np.bool_))
    prior.save(tmp_path / "prior.npz")
    with np.load(tmp_path / "prior.npz") as arrays:
        assert set(arrays.files) == set(described("prior.npz"))
    (row,) = re.findall(r"^\| `from_survey` .*$", PAGE, re.MULTILINE)
    assert {"given", *prior.as_dict()} == set(re.findall(r"`(\w+)`", row)) - {"from_survey"}


def test_every_key_of_an_exchange_is_told(run: Path) -> None:
    told = set(described("replies/"))
    assert told == fields_of(RecordedExchange)
    assert told == set(read(run / "replies" / "0004.json"))


# --- Benchmarks


def test_every_column_of_a_benchmark_is_told() -> None:
    assert tuple(described("results.csv")) == results.COLUMNS
    assert tuple(described("traces.csv.gz")) == results.TRACE_COLUMNS
    (said,) = re.findall(r"depend on the machine are (.*?);", PAGE)
    assert tuple(re.findall(r"`(\w+)`", said)) == results.TIMES


def test_every_key_of_a_manifest_is_told(tmp_path: Path) -> None:
    told = described("manifest.json")
    plan = Plan("reef", (Case("reef/string", 1),), {"random": PLANNERS["random"]}, DREAM_V1_NAV)
    assert set(keys(_manifest(plan, tmp_path, Processes(1)), told)) == set(told)
    assert fields_of(results.Manifest) <= {re.split(r"[.\[]", name)[0] for name in told}


def test_every_key_of_a_bound_is_told() -> None:
    known = Path(inspect.getfile(read_bounds)).parent / "known" / "paper.jsonl"
    assert list(read_bounds(known)[0].as_dict()) == described("Bounds")
    in_space = SpaceBounds("tower", 1, 0, "dream-v2", "0" * 64, 0, None, None, (), (), 0.0)
    assert list(in_space.as_dict()) == described("Bounds in space")


def test_every_key_of_a_probe_is_told(tmp_path: Path) -> None:
    score = Score((), 8)
    write_page(tmp_path, score, {"model": "wire", "prompt": "probe 1", **score.as_dict()})
    told = described("probe.json")
    assert set(keys(read(tmp_path / "probe.json"), told)) == set(told)


def test_every_key_of_a_plan_is_told() -> None:
    told = described("plan.json")
    case = Case("reef/mound+40x30", 1)
    mission = flown(case, "belief", Made(20.0, 24))
    seconds = np.arange(len(mission.trace), dtype=np.float64)
    mission = dataclasses.replace(
        mission, trace=dataclasses.replace(mission.trace, seconds=seconds, drawn_wh=seconds)
    )
    free, within = (Foresight((mission, mission), budget) for budget in (None, Budget(seconds=90.0)))
    plan = Foreseen(Size(40, 30), ("reef/mound",), "belief", DREAM_V1, free, within).as_dict()
    assert set(keys(plan, told)) == set(told)
    assert set(plan["within"]) == {"budget", *plan["free"]}


# --- What people write


def test_every_key_of_a_site_is_told() -> None:
    told = described("site.json")
    assert told == [field.name for field in dataclasses.fields(Site)]
    assert set(read(ROOT / "examples" / "site.json")) <= set(told)
    assert read_site(ROOT / "examples" / "site.json").name


def test_every_key_of_a_mission_is_told(tmp_path: Path) -> None:
    told, seen = described("mission.json"), set[str]()
    for area in (HALF, SideOf(Side.WEST, 1), None):
        legs = (Leg(task=Task.FIND), Leg(area=area))
        write_mission(tmp_path / "mission.json", "words", Orders(legs, max_steps=80))
        seen |= set(keys(read(tmp_path / "mission.json"), told))
    assert seen == set(told)


def test_every_key_of_a_sidecar_is_told() -> None:
    assert set(described("MODEL.json")) == fields_of(Sidecar)


# --- Surveys


def test_every_measure_is_told() -> None:
    """Those that the modules which measure name."""
    told = set(described("Measures"))
    named = {
        node.value
        for module in (reef_measures, wreck_measures)
        for node in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(node, ast.Constant) and node.value in MEANINGS
    }
    assert named <= told
    assert told - {"size_share_AAA_BBB_cm"} <= set(MEANINGS)


@pytest.mark.parametrize("scene", [scenes.reef, scenes.wreck, scenes.raised_wreck])
def test_every_part_of_the_file_of_a_survey_is_told(scene: Any, tmp_path: Path) -> None:
    survey = scene()
    survey_files.write(survey, tmp_path / "one.survey.npz")
    with zipfile.ZipFile(tmp_path / "one.survey.npz") as content:
        arrays = {name.removesuffix(".npy") for name in content.namelist()} - {"header.json"}
        header = json.loads(content.read("header.json"))
    keys, told = (set(described("NAME.survey.npz", table=table)) for table in (0, 1))
    if not survey.structures:
        keys.remove("structures")
        told -= {name for name in told if name.startswith("cells.")}
    assert set(header) == keys
    assert arrays == told
    sides = [side for one in survey.structures for side in one.sides]
    parts = [survey, *survey.patches, *survey.structures, *sides]
    assert {measure.name for part in parts for measure in part.measures} <= set(described("Measures"))


def test_every_column_of_an_archive_is_told() -> None:
    told = described("The archive", columns=2)
    assert told == [f"{table.name}.{c.name}" for table in order(MIGRATIONS).values() for c in table.columns]


def columns_of(path: Path) -> set[str]:
    """Layers and columns of a GeoPackage, but for what it holds for itself."""
    with sqlite3.connect(path) as database:
        layers = [name for (name,) in database.execute("SELECT table_name FROM gpkg_contents")]
        return {
            f"{layer}.{column[1]}"
            for layer in layers
            if layer != "layer_styles"
            for column in database.execute(f"PRAGMA table_info({layer})")
            if column[1] != "fid"
        }


@pytest.fixture(scope="module")
def products(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A survey of a reef, with another of the year before."""
    pytest.importorskip("pyproj")
    pytest.importorskip("rasterio")
    now = scenes.reef()
    before = dataclasses.replace(now, name="before", began=now.began - timedelta(days=365))
    folder = tmp_path_factory.mktemp("products") / "export"
    oyster = Species("Ostrea edulis", "urn:lsid:marinespecies.org:taxname:140658")
    wanted = ("geopackage", "netcdf", "tables", "darwin-core", "series")
    export(now, folder, species=oyster, others=[before], only=wanted)
    export(scenes.raised_wreck(), folder.with_name("in space"), only=("geopackage", "mesh"))
    return folder


def without_measures(names: set[str], units: tuple[str, ...] = ("",)) -> set[str]:
    """Names of columns, those of measures and of their intervals as the page has them."""
    measures = sorted(described("Measures"), key=len, reverse=True)
    word = "|".join(re.escape(name) for name in measures)
    unit = "|".join(map(re.escape, units))
    pattern = re.compile(rf"(?<![a-z_])(?:{word}|size_share_\d+_\d+_cm)(?:{unit})(_low|_high|)$")
    return {pattern.sub(r"MEASURE\1", name) for name in names}


def test_every_column_of_the_geopackage_is_told(products: Path) -> None:
    told = set(described("survey.gpkg", columns=2))
    seen = columns_of(products / "survey.gpkg")
    in_space = columns_of(products.with_name("in space") / "survey.gpkg")
    seen |= {name for name in in_space if name.startswith("structures.")}
    patches = {name for name in seen if name.startswith("patches.")}
    assert (seen - patches) | without_measures(patches, ("", "_m", "_m2", "_per_m2")) == told


def test_every_variable_of_the_netcdf_is_told(products: Path) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(products / "survey.nc", mmap=False) as file:
        variables = {name: variable.dimensions for name, variable in file.variables.items()}
    assert without_measures(set(variables)) == set(described("survey.nc"))
    for name, kind in types("survey.nc").items():
        if name in variables and kind:
            assert ", ".join(variables[name]) == kind


@pytest.mark.parametrize("name", ["measures.csv", "individuals.csv", "series.csv", "occurrence.csv"])
def test_every_column_of_a_table_is_told(name: str, products: Path) -> None:
    with (products / name).open(newline="") as file:
        assert next(csv.reader(file)) == described(name)


def test_every_column_of_the_darwin_core_archive_is_told(products: Path) -> None:
    with zipfile.ZipFile(products / ARCHIVE) as content:
        lines = content.read("extendedmeasurementorfact.csv").decode().splitlines()
    assert next(csv.reader(lines)) == described("extendedmeasurementorfact.csv")


def test_every_file_of_an_export_is_told() -> None:
    assert {name for name in FILES if name not in PAGE} <= {"report.html", "report.pdf"}
    assert set(described("GeoTIFFs")) == {name for name in FILES if name.endswith(".tif")}


def test_every_figure_of_a_change_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    before = repeated.reef(rng)
    after = repeated.without(before, 1, 0.3, rng)
    found = Comparing().compare(
        *(repeated.survey(one, rng, None, name) for one, name in ((before, "a"), (after, "b")))
    )
    told = described("change.json")
    # Reefs that were made by hand tell no measures of their own; those have the fields of the others.
    difference = {name for name in told if name.startswith("measures[].")}
    assert {name.replace("measures", "differences") for name in difference} <= set(told)
    assert set(keys(found.as_dict(), told)) | difference == set(told)
    write_change_layers(found, tmp_path / "change.gpkg")
    assert columns_of(tmp_path / "change.gpkg") == set(described("change.gpkg", columns=2))


# --- Data sets and networks


def test_every_column_of_a_data_set_is_told() -> None:
    told = described("A dive's data set", columns=2)
    frames = [f"decisions.jsonl.{name}" for name in ("frame", *dataset.DECISIONS)]
    assert told == [*(f"poses.csv.{name}" for name in dataset.POSES), *frames]


def test_every_key_of_a_network_s_card_is_told() -> None:
    for table, name in enumerate(("perception/weights/sight.json", "planning/weights/uivnav.json")):
        assert list(read(ROOT / "src" / "dream" / name)) == described("A network's folder", table=table)
    assert list(FEATURES) == described("A network's folder", table=2)


# --- That these tests can fail


def test_a_key_that_is_not_told_is_found() -> None:
    told = ["a", "b.c", "d[].e", "f"]
    find = partial(keys, told=told)
    assert list(find({"a": 1, "b": {"c": 2}, "d": [{"e": 3}], "f": {"g": 4}})) == ["a", "b.c", "d[].e", "f"]
    assert set(find({"a": 1, "b": {"x": 2}, "d": [{"y": 1}], "z": 0})) - set(told) == {"b.x", "d[].y", "z"}
    assert list(find({"b": None})) == []
