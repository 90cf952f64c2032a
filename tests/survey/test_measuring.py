"""A whole survey: from frames of a simulated patch, and from run folders that are good and bad."""

import dataclasses
import math
import os
import re
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dream.commands.dive import Dive
from dream.commands.dive.ready import Ready
from dream.commands.dive.records import config as dive_config
from dream.commands.ground import Known
from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning import Belief
from dream.protocol import DREAM_V1, DREAM_V1_NOISY, SurveyProtocol
from dream.recording import read_config, record, write_config
from dream.robots import Teleport, replay
from dream.robots.bluerov2.log import DiveLog
from dream.sim.camera_noise import noise_generator, with_noise
from dream.sim.render import Frame, Renderer
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.survey import About, Survey, files, measure, measure_observations
from dream.survey.calibration import SHARP
from dream.survey.change_page import change_page
from dream.survey.comparison import Comparing
from dream.survey.measuring import GUESSED
from dream.survey.products import Species, export, tables, words
from dream.survey.reef import _Shape, _totals
from dream.survey.site import Site
from dream.types import Observation, Target

ABOUT = About("a survey", datetime(2026, 6, 1, tzinfo=UTC))


def around(world: World, middle: tuple[float, float], protocol: SurveyProtocol) -> list[Observation]:
    """Frames of a place from a ring about it, without colour."""
    renderer, camera = Renderer(world), protocol.camera
    blank = np.zeros((camera.height, camera.width, 3), np.uint8)
    frames = []
    for number in range(16):
        angle, away = number * math.pi / 8.0, 3.5 if number % 2 else 5.5
        x, y = middle[0] - away * math.cos(angle), middle[1] - away * math.sin(angle)
        z = float(world.terrain.height(x, y)) + protocol.altitude
        T_world_base = SE3.level(x, y, z, angle)
        T_world_camera = T_world_base @ protocol.T_base_camera
        frame = Frame(blank, *renderer.measure(camera, T_world_camera))
        if protocol.noise is not None:
            rng = noise_generator(world, SE2(0.0, 0.0, 0.0), number)
            frame = with_noise(frame, camera, T_world_camera, protocol.noise, rng, hull=world.hull)
        frames.append(
            Observation(
                float(number), blank, frame.depth, frame.labels, camera, T_world_base, protocol.T_base_camera
            )
        )
    return frames


def mapped(frames: list[Observation], world: World, protocol: SurveyProtocol) -> OccupancyMap:
    occupancy = OccupancyMap(world.bounds, protocol)
    for seen in frames:
        occupancy.integrate(seen.depth, seen.labels, seen.camera, seen.T_world_camera)
    return occupancy


@pytest.fixture(scope="module")
def world() -> World:
    return make_world("reef/patch", 4)


@pytest.fixture(scope="module")
def middle(world: World) -> tuple[float, float]:
    """Of the first patch."""
    of_it = np.asarray(world.targets.group) == 0
    x, y = np.asarray(world.targets.position[of_it, :2], np.float64).mean(axis=0)
    return float(x), float(y)


@pytest.fixture(scope="module", params=[DREAM_V1, DREAM_V1_NOISY], ids=lambda protocol: protocol.name)
def survey(request: pytest.FixtureRequest, world: World, middle: tuple[float, float]) -> Survey:
    frames = around(world, middle, request.param)
    return measure_observations(frames, mapped(frames, world, request.param), ABOUT)


def values(survey: Survey) -> dict[str, float]:
    return {told.name: told.value for told in survey.measures if told.value is not None}


@pytest.mark.rare
def test_individuals_of_a_patch_are_counted_within_the_interval(
    survey: Survey, world: World, middle: tuple[float, float]
) -> None:
    nearest = min(
        survey.patches, key=lambda patch: np.hypot(*(patch.rings[0][:-1].mean(axis=0) - middle)).item()
    )
    (count,) = (told for told in nearest.measures if told.name == "count")
    position = np.asarray(world.targets.position[:, :2], np.float64)
    ring = nearest.rings[0]
    x, y = position.T
    crosses = (ring[:-1, 1, None] > y) != (ring[1:, 1, None] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ring[:-1, 0, None] + (y - ring[:-1, 1, None]) * np.divide(
            (ring[1:, 0] - ring[:-1, 0])[:, None], (ring[1:, 1] - ring[:-1, 1])[:, None]
        )
    inside = (crosses & (x < at)).sum(axis=0) % 2 == 1
    assert inside.sum() > 100
    assert count.low is not None
    assert count.high is not None
    assert count.low <= inside.sum() <= count.high
    assert count.value == pytest.approx(inside.sum(), rel=0.15)


def test_every_individual_is_near_a_true_one(survey: Survey, world: World) -> None:
    sure = survey.individuals.confidence > 0.8
    sure &= survey.individuals.patch >= 0
    true = np.asarray(world.targets.position[:, :2], np.float64)
    found = survey.individuals.position[sure][:, None, :2]
    away = np.hypot(*(found - true[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.mean(away < 0.12) > 0.9


def test_those_that_stand_clear_have_a_size_of_their_own(survey: Survey, world: World) -> None:
    found = survey.individuals
    clear = found.clear
    assert 10 < np.count_nonzero(clear) < 0.6 * len(clear)
    assert (found.confidence[clear] > 0.5).all()
    assert (found.patch[clear] >= 0).all()
    (note,) = {one.note for one in survey.measures if one.name == "median_size"}
    assert note == f"from {np.count_nonzero(clear)} that stand clear of others"
    # The others have one size, the mean.
    assert len(np.unique(found.size[~clear])) == 1
    assert len(np.unique(found.size[clear])) > 0.5 * np.count_nonzero(clear)
    targets = world.targets
    away, nearest = cKDTree(targets.position[:, :2]).query(found.position[:, :2])
    across = np.array(
        [
            np.ptp((world.meshes[mesh].vertices * scale)[:, :2], axis=0).max()
            for mesh, scale in zip(targets.mesh, targets.scale, strict=True)
        ]
    )
    sure = clear & (away < 0.12)
    assert np.corrcoef(found.size[sure], across[np.asarray(nearest)[sure]])[0, 1] > 0.25


def test_the_parts_make_the_whole(survey: Survey) -> None:
    told = values(survey)
    parts = [{m.name: m.value for m in patch.measures} for patch in survey.patches]
    assert told["patch_count"] == len(parts) >= 1
    assert told["reef_area"] >= sum(part["area"] or 0.0 for part in parts) - 1e-9
    assert told["density"] == pytest.approx(
        sum(part["count"] or 0.0 for part in parts) / sum(part["area"] or 0.0 for part in parts)
    )
    people = survey.individuals
    for name in ("sigma", "size", "size_sigma", "hits", "looks", "confidence", "patch"):
        assert len(getattr(people, name)) == len(people)
    assert (people.hits <= people.looks).all()
    assert people.patch.min() >= -1
    assert people.patch.max() < len(survey.patches)
    shares = [told[name] for name in told if name.startswith("size_share")]
    assert sum(shares) == pytest.approx(1.0)


def test_every_value_lies_in_its_interval(survey: Survey) -> None:
    everything = [*survey.measures, *(told for patch in survey.patches for told in patch.measures)]
    for told in everything:
        if told.value is None:
            assert told.low is None
            assert told.high is None
            assert told.note
        else:
            assert told.low is not None
            assert told.high is not None
            assert told.low <= told.value <= told.high
            assert all(map(math.isfinite, (told.low, told.high)))


def test_a_survey_that_was_kept_was_measured_by_the_same_calibration(survey: Survey) -> None:
    assert survey.calibration
    assert files.loaded(files.dumped(survey), "it").calibration == survey.calibration


def test_layers_share_the_grid_of_the_map(survey: Survey) -> None:
    layers = survey.layers
    shape = (round(layers.bounds.depth / layers.cell), round(layers.bounds.width / layers.cell))
    for name in ("state", "target_probability", "relief", "times_seen"):
        assert getattr(layers, name).shape == shape
    unknown = layers.state == 0
    assert np.isnan(layers.target_probability[unknown]).all()
    assert np.isnan(layers.relief[unknown]).all()
    assert layers.times_seen.max() <= 16


def test_poses_that_may_err_widen_the_intervals(world: World, middle: tuple[float, float]) -> None:
    frames = around(world, middle, DREAM_V1)
    occupancy = mapped(frames, world, DREAM_V1)
    sure, unsure = (
        measure_observations(frames, occupancy, dataclasses.replace(ABOUT, sigma=(sigma,) * 16))
        for sigma in (0.0, 0.3)
    )
    widths = [
        {told.name: (told.high or 0.0) - (told.low or 0.0) for told in survey.measures}
        for survey in (sure, unsure)
    ]
    assert widths[1]["reef_area"] > 1.5 * widths[0]["reef_area"]
    assert widths[1]["density"] > widths[0]["density"]
    assert (unsure.individuals.sigma > sure.individuals.sigma).all()


def test_what_was_not_seen_beside_a_reef_is_expected_and_doubted(
    world: World, middle: tuple[float, float]
) -> None:
    frames = around(world, middle, DREAM_V1)
    whole, half = (
        measure_observations(part, mapped(part, world, DREAM_V1), ABOUT) for part in (frames, frames[1:2])
    )
    told = [{measure.name: measure for measure in survey.measures} for survey in (whole, half)]
    assert "not seen but likely" in told[1]["reef_area"].note
    shares = [
        ((area.high or 0.0) - (area.low or 0.0)) / (area.value or 1.0)
        for area in (told[0]["reef_area"], told[1]["reef_area"])
    ]
    assert shares[1] > 1.5 * shares[0]
    seen = [survey["seen_share"].value or 0.0 for survey in told]
    assert seen[1] < 0.7 * seen[0]


def test_notes_in_tables_are_read_alike_by_all_spreadsheets(
    world: World, middle: tuple[float, float], tmp_path: Path
) -> None:
    """Some take a file for Latin letters: what we write ourselves is ASCII."""
    frames = around(world, middle, DREAM_V1)[1:2]
    tables.write(measure_observations(frames, mapped(frames, world, DREAM_V1), ABOUT), tmp_path)
    told = (tmp_path / "measures.csv").read_bytes()
    assert b"square metres of it not seen but likely" in told
    assert told.isascii()


def test_a_seabed_without_a_reef_has_none(world: World) -> None:
    empty = make_world("flat/empty", 1)
    frames = around(empty, (0.0, 0.0), DREAM_V1)
    survey = measure_observations(frames, mapped(frames, empty, DREAM_V1), ABOUT)
    told = {measure.name: measure for measure in survey.measures}
    assert told["reef_area"].value == 0.0
    assert told["density"].value is None
    assert told["median_size"].value is None
    assert len(survey.individuals) == 0
    assert survey.patches == ()


@pytest.mark.parametrize("shapes", [(), (_Shape((), 4.0, 8.0, 0.0, ()),)])
def test_none_found_is_not_none_for_sure(shapes: tuple[_Shape, ...]) -> None:
    told = {one.name: one for one in _totals(shapes, np.zeros(0), 0.0, 0.0, SHARP)}
    assert told["count"].value == 0.0
    assert told["count"].low == 0.0
    assert told["count"].high == pytest.approx(3.0)
    assert (told["patch_count"].high or 0.0) >= 1.0
    assert (told["reef_area"].high or 0.0) > 0.0
    if shapes:
        assert told["density"].high == pytest.approx(3.0 / 4.0)


@pytest.mark.rare
def test_a_wreck_is_known_by_what_it_is() -> None:
    wreck = make_world("wreck/2", 1)
    x, y = np.asarray(wreck.targets.position[:, :2], np.float64).mean(axis=0)
    frames = around(wreck, (float(x), float(y)), DREAM_V1)
    survey = measure_observations(frames, mapped(frames, wreck, DREAM_V1), ABOUT)
    told = values(survey)
    assert survey.target is Target.WRECK
    assert {"outline_area", "hull_seen", "debris_extent", "highest_point"} <= told.keys()
    assert 0.0 < told["hull_seen"] < 1.0
    tops = [
        (wreck.meshes[mesh].vertices[:, 2] + position[2]).max()
        for mesh, position in zip(wreck.targets.mesh, wreck.targets.position, strict=True)
    ]
    assert 0.5 < told["highest_point"] < max(tops) + 10.0 + 0.3


def test_no_observations_are_an_error() -> None:
    occupancy = OccupancyMap(Bounds(0.0, 0.0, 5.0, 5.0), DREAM_V1)
    with pytest.raises(ValueError, match="at least one observation"):
        measure_observations([], occupancy, ABOUT)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, world: World) -> Path:
    """A run of six steps whose observations were kept."""
    folder = tmp_path_factory.mktemp("runs") / "2026-06-01T09-30-12_reef-patch-4_belief"
    folder.mkdir()
    write_config(
        folder,
        {
            "version": "0",
            "protocol": "dream-v1",
            "world": world.name,
            "seed": world.seed,
            "planner": "belief",
        },
    )
    steps = explore(Teleport(world, DREAM_V1), Belief(), OccupancyMap(world.bounds, DREAM_V1), max_steps=6)
    for _ in record(replay.keep(steps, folder, DREAM_V1), folder):
        pass
    return folder


def test_a_run_folder_is_measured_as_it_was_seen(run: Path) -> None:
    heard: list[tuple[int, int]] = []
    survey = measure(run, told=lambda done, of: heard.append((done, of)))
    assert survey.name == run.name
    assert survey.began == datetime(2026, 6, 1, 9, 30, 12, tzinfo=UTC)
    assert survey.site is None
    assert len(survey.track.time) == 7
    assert [point.step for point in survey.decisions] == [1, 2, 3, 4, 5, 6]
    assert "quarter turn" in survey.decisions[0].reasoning.action
    assert heard == [(n, 7) for n in range(1, 8)]
    assert survey.made_by["planner"] == "belief"
    assert survey.made_by["measuring"]["cell"] == pytest.approx(0.025)


def test_a_folder_of_an_older_version_tells_the_minute(run: Path, tmp_path: Path) -> None:
    older = Path(shutil.copytree(run, tmp_path / "2026-06-01T09-30_reef-patch-4_belief"))
    survey = measure(older)
    assert survey.began == datetime(2026, 6, 1, 9, 30, tzinfo=UTC)
    assert survey.made_by["began_by"] == "the name of its folder"


def test_a_run_says_itself_when_it_began_whatever_its_folder_is_called(run: Path, tmp_path: Path) -> None:
    for name in ("2020-01-01T00-00-00_reef-patch-4_belief", "reef"):
        copy = Path(shutil.copytree(run, tmp_path / name))
        config = read_config(copy).model_dump()
        write_config(copy, {**config, "began": "2026-06-01T11:30:12.7+02:00"})
        survey = measure(copy)
        assert survey.began == datetime(2026, 6, 1, 9, 30, 12, tzinfo=UTC)
        assert survey.made_by["began_by"] == "its own record"


def test_an_older_dive_began_when_its_log_says(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    dive = Path(shutil.copytree(run, tmp_path / "dive"))
    DiveLog(dive, epoch_ns=1_780_000_000_250_000_000).close()
    assert measure(dive).began == datetime.fromtimestamp(1_780_000_000, UTC)
    (dive / "log.mcap").write_bytes(b"no log")
    assert measure(dive).made_by["began_by"] == "when its config.json was written"


def as_a_dive(run: Path, to: Path, *, stand_in: bool) -> Path:
    """The run as `dream dive` leaves one: with the config.json that it writes."""
    dive = Path(shutil.copytree(run, to))
    tank: Any = SimpleNamespace(world=SimpleNamespace(name="pool/arc")) if stand_in else None
    devices: Any = SimpleNamespace(log=SimpleNamespace(epoch_ns=1_780_000_000_000_000_000))
    unused: Any = None
    limits: Any = SimpleNamespace(area=Bounds(-2.0, -2.0, 2.0, 2.0))
    begun, start = Dive(stand_in=stand_in), SE2(0.0, 0.0, 0.0)
    ready = Ready(begun, DREAM_V1, devices, limits, start, dive, tank, unused, Known())
    write_config(dive, dive_config(ready, "belief", None))
    return dive


@pytest.mark.rare
@pytest.mark.parametrize("stand_in", [False, True])
def test_a_dive_is_simulated_only_in_the_stand_in_and_every_file_says_so(
    run: Path, tmp_path: Path, stand_in: bool
) -> None:
    pytest.importorskip("pyproj")
    pytest.importorskip("rasterio")
    dive = as_a_dive(run, tmp_path / "dive", stand_in=stand_in)
    survey = files.loaded(files.dumped(measure(dive, Site("Inner reef", 54.9, 8.3))), "it")
    assert survey.simulated is stand_in
    later = dataclasses.replace(
        survey,
        name="later",
        began=survey.began + timedelta(days=365),
        made_by={**survey.made_by, "run": "another"},
    )
    species = Species("Ostrea edulis", "urn:lsid:marinespecies.org:taxname:1")
    made = export(survey, tmp_path / "out", run=dive, species=species, others=[later]).folder
    page = change_page(Comparing().compare(survey, later), b"", {})
    (made / "change.html").write_text(page)
    said = (b"SIMULATED", b"Simulated: world pool/arc, seed 1", b"world pool/arc")
    telling = {file.name for file in made.iterdir() if any(word in file.read_bytes() for word in said)}
    # What is compressed or drawn has tests of its own, by what it is.
    drawn = {"darwin-core.zip", "report.pdf", "series.png"}
    plain = {file.name for file in made.iterdir() if file.suffix != ".qml"} - drawn
    assert len(plain) == 14
    assert telling == (plain if stand_in else set())


def test_an_older_survey_of_a_dive_is_of_real_water(run: Path) -> None:
    survey = measure(run)
    assert survey.simulated
    older = dataclasses.replace(survey, made_by={**survey.made_by, "world": "dive"})
    assert not files.loaded(files.dumped(older), "it").simulated
    assert words.world(older) == words.warning(older) == words.simulated(older) == ""


def test_copies_of_a_run_are_the_same_run_and_no_other_is(run: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    first = measure(run).run
    assert first is not None
    assert measure(copy).run == first
    steps = (copy / "steps.jsonl").read_text()
    milliseconds = re.search(r'"planner_ms":[^,]+', steps)
    assert milliseconds is not None
    (copy / "steps.jsonl").write_text(steps.replace(milliseconds[0], '"planner_ms":77.0', 1))
    assert measure(copy).run != first


def test_a_time_that_nothing_tells_is_guessed(run: Path, tmp_path: Path) -> None:
    assert measure(run).made_by["began_by"] == "the name of its folder"
    renamed = Path(shutil.copytree(run, tmp_path / "reef"))
    when = datetime(2026, 5, 4, 3, 2, 7, tzinfo=UTC)
    os.utime(renamed / "config.json", (when.timestamp(), when.timestamp()))
    survey = measure(renamed)
    assert survey.began == when
    assert survey.made_by["began_by"] == GUESSED


def test_the_place_is_that_of_the_folder(run: Path) -> None:
    site = run / "site.json"
    site.write_text('{"name": "Inner reef", "latitude": 54.9, "longitude": 8.3}')
    try:
        found = measure(run).site
    finally:
        site.unlink()
    assert found is not None
    assert found.name == "Inner reef"


def test_a_run_without_observations_says_how_to_fly_again(run: Path, tmp_path: Path) -> None:
    for name in ("config.json", "steps.jsonl", "map.npz"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    with pytest.raises(FileNotFoundError, match="--keep-observations"):
        measure(tmp_path)


def test_a_run_with_a_gap_or_a_damaged_file_names_it(run: Path, tmp_path: Path) -> None:
    (tmp_path / "observations").mkdir()
    for path in run.rglob("*.*"):
        if path.is_file() and path.parent.name in (run.name, "observations"):
            (tmp_path / path.relative_to(run)).write_bytes(path.read_bytes())
    damaged = tmp_path / "observations" / "0003.npz"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"0003\.npz"):
        measure(tmp_path)
    damaged.unlink()
    with pytest.raises(ValueError, match=r"0003\.npz before it"):
        measure(tmp_path)
    (tmp_path / "map.npz").unlink()
    damaged.write_bytes((run / "observations" / "0003.npz").read_bytes())
    with pytest.raises(FileNotFoundError, match=r"map\.npz"):
        measure(tmp_path)
