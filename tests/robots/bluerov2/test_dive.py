"""`dream dive --stand-in`: the paper's tank trial, end to end, over the real protocols."""

import contextlib
import copy
import csv
import errno
import importlib.util
import json
import logging
import math
import os
import signal
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream import recording
from dream.cli import _Telling, run_command
from dream.commands.dive import Dive, _outlives_its_terminal, draw_flown
from dream.commands.dive.console import tell
from dream.commands.dive.flight import Flight
from dream.commands.dive.options import mounting_told, repeating_command
from dream.commands.dive.ready import Ready, how_to_restore
from dream.commands.dive.records import _perception, config
from dream.commands.dive.tank import rehearse_return
from dream.commands.ground import Ground, Known
from dream.ending import why
from dream.errors import MissionAborted
from dream.estimation import InEkf, InEkfState, Timeline
from dream.evaluation.dive_figure import read_dive
from dream.extras import missing
from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.perception import Account
from dream.planning.belief import Belief
from dream.planning.coverage_tour import CoverageTour
from dream.planning.lookahead import Plan
from dream.protocol import POOL_V1
from dream.recording import read_config, read_steps
from dream.robots.bluerov2.camera import RtpVideo
from dream.robots.bluerov2.devices import PARAMETERS_BEFORE, Devices, source_of
from dream.robots.bluerov2.home import LEAVING, WayHome
from dream.robots.bluerov2.limits import LastResort, Limits
from dream.robots.bluerov2.log import dive_began, read_log, read_measurements, read_wire
from dream.robots.bluerov2.mcap import McapFile, McapWriter
from dream.robots.bluerov2.navigation import Instruments
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.rig import Rig
from dream.robots.replay import Replayed
from dream.sim.worlds import make_world
from dream.survey import files
from dream.survey.site import Site, read_site, write_site
from dream.types import Decision
from tests.docs.fields import described, keys, types
from tests.recorded_runs import CONFIG, SUMMARY, painted_mission
from tests.robots.bluerov2 import rigged
from tests.survey.scenes import reef

STEPS = 50
"""At most. It ends by itself after some 35."""


TRIES = 3
"""Dives in real time that are begun until the machine is found quick enough for one."""
BEHIND = 0.25
"""Seconds by which a simulated tank may fall behind for a dive in real time to be one."""
SHOWN: list[tuple[Path, list[str]]] = []
"""Folders that a page began or ended to show, and what lay in them then."""


@contextlib.contextmanager
def shown_live(folder: Path) -> Iterator[None]:
    """In the place of a server and its page, which `tests/live` tries."""
    SHOWN.append((folder, sorted(path.name for path in folder.iterdir())))
    yield
    SHOWN.append((folder, sorted(path.name for path in folder.iterdir())))


SITE = Site("Test tank", 54.9, 8.3, heading_deg=20.0)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that says where on earth the tank is."""
    path = tmp_path_factory.mktemp("site") / "site.json"
    write_site(SITE, path)
    return path


@pytest.fixture(scope="module")
def dive(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a dive that ends by itself, on a simulated clock."""
    folder = tmp_path_factory.mktemp("dive") / "2026-01-01T00-00-00_dive_belief"
    folder.mkdir()
    with Rig(folder, make_world("pool/arc", 1), pictures=5.0, width=320, depth=0.25) as rig:
        dived = rigged.dive(rig, folder, max_steps=STEPS, ground=Ground(site=site))
    assert dived.error is None
    assert [finding for finding in dived.found if not finding.ok] == []
    draw_flown(folder, quiet=True)
    return folder


@pytest.fixture(scope="module")
def second(site: Path, dive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short dive, in real time, that plans with the survey of the first."""
    out = tmp_path_factory.mktemp("second")
    fly = ["dive", "--stand-in", "--world", "pool/arc", "--max-steps", "5", "--json", "--out", str(out)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dream.live.beside.check_installed", lambda: None)
        patch.setattr("dream.live.beside.shown_live", shown_live)
        for _ in range(TRIES):
            ended = run_command([*fly, "--live", "--site", str(site), "--from-survey", str(dive)])
            folder = out / (out / "latest").readlink()
            if (folder / "summary.json").exists():
                break
    behind = summary_of(folder)["dive"]["behind_s"]
    if ended != 0 and behind > BEHIND:
        pytest.skip(f"this machine was too slow: the simulated tank fell behind by {behind} s")
    assert ended == 0
    return folder


def summary_of(folder: Path) -> dict:  # type: ignore[type-arg]
    told: dict = json.loads((folder / "summary.json").read_text())  # type: ignore[type-arg]
    return told


@pytest.mark.slow
def test_the_tank_is_explored(dive: Path) -> None:
    told = summary_of(dive)
    assert told["coverage"]["instances"] >= 0.95
    assert told["collisions"] == 0
    assert told["position_error_m"]["rmse"] < 0.1
    assert told["dive"]["pictures_per_s"] > 4.0
    assert told["dive"]["log_lost"] == {}


@pytest.mark.slow
def test_all_that_it_writes_is_told_in_the_page_of_files(dive: Path) -> None:
    whole, of_dive = described("summary.json", table=0), described("summary.json", table=4)
    going_home = {"home.reached", "home.why", "home.left"}
    assert set(keys(summary_of(dive), [*whole, *of_dive])) == {*whole, *of_dive} - going_home
    config = json.loads((dive / "config.json").read_text())
    assert set(keys(config, described("config.json"))) == {*described("config.json")} - {
        "world_hash",
        "from_survey",
    }
    steps = [json.loads(line) for line in (dive / "steps.jsonl").read_text().splitlines()]
    told = [*described("steps.jsonl", table=0), *described("steps.jsonl", table=1)]
    seen = {key for step in steps for key in keys(step, told)}
    assert seen <= set(told)
    assert set(described("steps.jsonl", table=1)) <= seen
    files = {name.rstrip("/") for row in described("A run") for name in row.replace("`", "").split(", ")}
    assert {path.name for path in dive.iterdir()} <= files


@pytest.mark.slow
def test_every_topic_of_its_log_is_told_in_the_page_of_files(dive: Path) -> None:
    file = McapFile(dive / "log.mcap")
    file.read_metadata()
    logged = {message.topic: message.schema for message in file.messages()}
    told = {name: kind.strip("`") for name, kind in types("log.mcap").items()}
    assert logged == {name: kind for name, kind in told.items() if name in logged}
    assert set(told) - set(logged) <= {"/camera/video", "/camera/image", "/a50/sent", "/standing", "/log"}


@pytest.mark.rare
@pytest.mark.slow
def test_a_page_shows_it_from_the_beginning_and_holds_up_nothing(second: Path) -> None:
    (begun, before), (ended, after) = SHOWN
    assert begun == ended == second
    assert "steps.jsonl" not in before
    # What is made once the vehicle is let go is there before anybody has to close the page.
    assert {"steps.jsonl", "report.html", "log.mcap", "dive.svg"} <= set(after)


@pytest.mark.slow
def test_the_dive_is_drawn_with_goals_and_truth(dive: Path) -> None:
    flown = read_dive(dive)
    steps = read_steps(dive)
    # One to begin with, and one for each step; where the first look was taken nobody asked for the truth.
    assert len(flown.goals) == len(steps)
    off = flown.truth[:, 1:3] - flown.goals[1:, 1:3]
    assert np.hypot(*off.T).max() < 0.15
    assert (dive / "dive.svg").is_file()
    assert (dive / "dive.png").is_file()


@pytest.mark.slow
def test_both_pipes_are_on_the_map(dive: Path) -> None:
    world = make_world("pool/arc", 1)
    solid = np.argwhere(OccupancyMap.load(dive / "map.npz").solid)
    cell = POOL_V1.cell
    x = world.bounds.x_min + (solid[:, 1] + 0.5) * cell
    y = world.bounds.y_min + (solid[:, 0] + 0.5) * cell
    for pipe in np.asarray(world.obstacles.position)[1:, :2]:
        assert np.hypot(x - pipe[0], y - pipe[1]).min() < 0.15


@pytest.mark.slow
def test_no_motion_outlives_the_dive_and_none_comes_before_arming(dive: Path) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    parser = dialect.MAVLink(None)
    packets = [(time, packet) for time, out, packet in read_wire(dive / "log.mcap", "mavlink") if out]
    sent = [(time, message) for time, packet in packets for message in parser.parse_buffer(packet) or ()]
    sticks = [(t, m) for t, m in sent if m.get_type() == "MANUAL_CONTROL"]
    moving = [t for t, m in sticks if (m.x, m.y, m.z, m.r) != (0, 0, 500, 0)]
    armed = [t for t, m in sent if m.get_type() == "COMMAND_LONG" and m.command == 400 and m.param1 == 1.0]
    assert len(moving) > 100
    assert min(moving) > min(armed)
    modes = [m.param2 for _, m in sent if m.get_type() == "COMMAND_LONG" and m.command == 176]
    assert modes == [2.0, 9.0]  # ALT_HOLD, and SURFACE in the end.
    last = sticks[-1][1]
    assert (last.x, last.y, last.z, last.r) == (0, 0, 500, 0)


@pytest.mark.slow
def test_the_log_holds_all_that_the_estimate_was_made_of(dive: Path) -> None:
    assert dive_began(dive) == read_config(dive).began
    (begun,) = read_log(dive / "log.mcap", ["/begun"])
    told = json.loads(begun.message.data)["said"]
    fields: dict[str, Any] = {n: np.array(v) if isinstance(v, list) else v for n, v in told.items()}
    estimator = Instruments().filter
    assert isinstance(estimator, InEkf)
    timeline = Timeline(estimator, InEkfState(**fields))
    estimates = [entry.message.pose.pose.position for entry in read_log(dive / "log.mcap", ["/estimate"])]
    made = set()
    for measurement in read_measurements(dive / "log.mcap"):
        timeline.take(measurement)
        made.add(tuple(timeline.state.position.tolist()))
    assert len(estimates) > 500
    assert sum((place.x, place.y, place.z) in made for place in estimates) == len(estimates)


@pytest.mark.slow
def test_how_far_its_pictures_could_be_believed_is_in_its_steps_log_and_summary(dive: Path) -> None:
    logged = [
        json.loads(entry.message.data)["said"] for entry in read_log(dive / "log.mcap", ["/perception"])
    ]
    steps = [step.model_extra for step in read_steps(dive)]
    assert [said["step"] for said in logged] == list(range(len(steps)))
    for said, extra in zip(logged, steps, strict=True):
        assert extra is not None
        assert {"step": said["step"], **extra["perception"]} == said
        assert 0.5 < said["confidence"] <= 1.0
        assert said["doubt"] == ""
    told = summary_of(dive)["dive"]["perception"]
    assert told["frames"] == len(steps)
    assert told["confidence"] == pytest.approx(np.mean([said["confidence"] for said in logged]), abs=0.002)
    assert (told["frames_doubted"], told["pixels_without_label"]) == (0, 0)


@pytest.mark.slow
def test_a_replay_decides_as_the_dive_did(dive: Path) -> None:
    flown = read_steps(dive)
    replayed = Replayed(dive)
    occupancy = OccupancyMap(make_world("pool/arc", 1).bounds, POOL_V1)
    again = list(explore(replayed, Belief(), occupancy, max_steps=len(flown) - 1))
    assert replayed.divergences == ()
    assert [(step.decision.turn, step.decision.advance) for step in again] == [
        (step.decision.turn, step.decision.advance) for step in flown
    ]


@pytest.mark.rare
@pytest.mark.slow
def test_a_dive_with_a_site_is_measured_and_written_for_others_at_its_place(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rasterio, pyogrio = (pytest.importorskip(name) for name in ("rasterio", "pyogrio.raw"))
    transform = pytest.importorskip("rasterio.warp").transform
    assert read_site(dive / "site.json") == SITE
    capsys.readouterr()
    assert run_command(["survey", "add", str(dive), "--archive", str(tmp_path / "kept.gpkg"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["survey"] == 1
    show = ["survey", "show", "1", "--archive", str(tmp_path / "kept.gpkg"), "--json"]
    assert run_command(show) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["name"], told["site"]["name"], told["protocol"]) == (dive.name, "Test tank", "pool-v1")
    assert told["target"] == "oysters"
    export = ["survey", "export", "1", "--archive", str(tmp_path / "kept.gpkg"), "--to", str(tmp_path / "to")]
    assert run_command([*export, "--only", "geotiff", "geopackage", "tables", "html", "--json"]) == 0
    # Each that was found lies on a shell of the tank, where on earth that is, and as deep.
    shells = np.asarray(make_world("pool/arc", 1).targets.position)
    bearing = math.radians(SITE.heading_deg)
    east = math.cos(bearing) * shells[:, 0] + math.sin(bearing) * shells[:, 1]
    north = math.cos(bearing) * shells[:, 1] - math.sin(bearing) * shells[:, 0]
    with rasterio.open(tmp_path / "to/habitat.tif") as habitat:
        cells, crs, around = habitat.read(1), habitat.crs, habitat.bounds
        square, tags = abs(habitat.transform.a * habitat.transform.e), habitat.tags()
    plane = f"+proj=aeqd +lat_0={SITE.latitude} +lon_0={SITE.longitude} +datum=WGS84"
    there = np.array(transform(plane, crs, east, north)).T
    assert (there > [around.left, around.bottom]).all()
    assert (there < [around.right, around.top]).all()
    with (tmp_path / "to/individuals.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    lon_lat = np.array([[float(row["longitude"]), float(row["latitude"])] for row in rows])
    found = np.array(transform("EPSG:4326", crs, *lon_lat.T)).T
    away = np.hypot(*(found[:, None] - there).transpose(2, 0, 1))
    assert away.min(axis=1).max() < 0.2
    assert [float(row["depth_m"]) for row in rows] == pytest.approx(-shells[away.argmin(axis=1), 2], abs=0.15)
    # Nobody calibrated counts in a tank; but they are of its size.
    measures = {measure["name"]: measure["value"] for measure in told["measures"]}
    assert told["individuals_found"] == len(rows)
    assert 0.2 * len(shells) < len(rows) < measures["count"] < 2.0 * len(shells)
    known = OccupancyMap.load(dive / "map.npz")
    assert measures["seen_share"] == pytest.approx(known.known[known.to_see].mean(), abs=0.01)
    assert square * np.count_nonzero(cells == 2) == pytest.approx(
        POOL_V1.cell**2 * np.count_nonzero(known.target & ~known.solid), rel=0.1
    )
    assert measures["reef_area"] > POOL_V1.cell**2 * np.count_nonzero(known.target)
    _, _, places, _ = pyogrio.read(tmp_path / "to/survey.gpkg", layer="individuals")
    assert len(places) == len(rows)
    # The stand-in's tank is simulated, and each file says so.
    assert all(row["simulated"] == "world pool/arc, seed 1" for row in rows)
    assert "SIMULATED" in tags["TIFFTAG_IMAGEDESCRIPTION"]
    assert "Simulated: world pool/arc, seed 1" in (tmp_path / "to/report.html").read_text(encoding="utf-8")


@pytest.mark.rare
@pytest.mark.slow
def test_a_dive_plans_with_an_earlier_survey_and_keeps_what_it_was_told(
    dive: Path, second: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = (read_config(second).model_extra or {})["from_survey"]
    assert (kept["given"], kept["source"], kept["years"]) == (str(dive), dive.name, 1.0)
    assert read_site(second / "site.json") == SITE
    before = OccupancyMap.load(dive / "map.npz")
    with np.load(second / "prior.npz") as prior:
        np.testing.assert_array_equal(np.isfinite(prior["target"]), before.known)
        np.testing.assert_array_equal(np.nan_to_num(prior["target"]) > 0.5, before.target & before.known)
    words = [step.reasoning.distribution for step in read_steps(second)[4:]]
    assert words
    assert all(f"The survey {dive.name}, 1.0 years old, is believed to" in said for said in words)
    capsys.readouterr()
    assert run_command(["replay", str(second), "--estimator", "none", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert (again["from"], again["agree"]) == ("observations", again["steps"])


@pytest.mark.rare
def test_before_a_dive_with_a_survey_ways_round_what_it_foretells_are_rehearsed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planned = []
    plan = CoverageTour.plan

    def planning(tour: CoverageTour, *rest: Any) -> Plan | None:
        planned.append(plan(tour, *rest))
        return planned[-1]

    monkeypatch.setattr(CoverageTour, "plan", planning)
    rehearse_return()
    assert any(way is not None for way in planned)


@pytest.fixture
def no_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Devices that must not be opened."""
    monkeypatch.setattr(
        "dream.robots.bluerov2.devices.Devices.__enter__", lambda devices: pytest.fail("devices were opened")
    )


CHECK = ["dive", "--area", "0", "0", "20", "16", "--at", "1", "1", "0", "--protocol", "dream-v1", "--check"]
"""A list gone through before a dive over `tests.survey.scenes.AREA`."""


@pytest.mark.usefixtures("no_devices")
@pytest.mark.parametrize(
    ("told", "wanted"),
    [
        ("--site none.json", "none.json: expected a site file such as"),
        ("--site bad.json", "bad.json: site: latitude: expected a number within ±90, got 95.0"),
        ("--from-survey nothing", "nothing: expected the number of a survey in the archive, its file, or"),
        ("--from-survey 1", "surveys.gpkg: expected an archive of surveys, got no file"),
        ("--from-survey 1 --archive there.gpkg", "there.gpkg: expected an archive of surveys, got no file"),
        (
            "--from-survey damaged.survey.npz",
            "damaged.survey.npz: expected the file of a survey, got a damaged",
        ),
        ("--site other.json --from-survey reef.survey.npz", "got one of 'Inner reef'"),
        ("--from-survey beside.survey.npz", "expected a survey of this area, got"),
        ("--from-survey later.survey.npz", "expected a survey from before the mission"),
    ],
)
def test_a_site_or_a_survey_that_does_not_fit_is_told_before_any_vehicle_is_asked(
    told: str,
    wanted: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DREAM_ARCHIVE", raising=False)
    Path("bad.json").write_text('{"name": "reef", "latitude": 95, "longitude": 8}')
    write_site(Site("Other reef", 54.9, 8.3), Path("other.json"))
    then = replace(reef(), began=datetime(2020, 6, 1, tzinfo=UTC))
    files.write(then, Path("reef.survey.npz"))
    files.write(replace(then, began=datetime(2999, 6, 1, tzinfo=UTC)), Path("later.survey.npz"))
    beside = Bounds(100.0, 0.0, 120.0, 16.0)
    files.write(
        replace(then, area=beside, layers=replace(then.layers, bounds=beside)), Path("beside.survey.npz")
    )
    Path("damaged.survey.npz").write_bytes(files.dumped(then)[:-3000])
    assert run_command([*CHECK, *told.split(), "--out", "runs"]) == 2
    said = capsys.readouterr().err
    assert wanted in said
    assert len(said.splitlines()) == 1
    assert not Path("runs").exists()


def test_a_planner_that_cannot_use_a_survey_says_so_before_it_dives(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opening(devices: Devices) -> None:
        # They are open already; left so, their threads would outlive the test.
        devices.__exit__(None, None, None)
        raise ValueError("devices are opened")

    monkeypatch.setattr("dream.robots.bluerov2.devices.Devices.__enter__", opening)
    for rehearsal in ("rehearse_mission", "rehearse_return"):
        monkeypatch.setattr(f"dream.commands.dive.{rehearsal}", lambda *_: None)
    survey = replace(reef(), began=datetime(2020, 6, 1, tzinfo=UTC))
    files.write(survey, tmp_path / "reef.survey.npz")
    more = ["--from-survey", str(tmp_path / "reef.survey.npz"), "--out", str(tmp_path)]
    for planner, doubted in (("frontier", True), ("belief", False)):
        caplog.clear()
        assert run_command([CHECK[0], planner, *CHECK[1:], *more]) == 2
        frames, *doubts = caplog.messages
        assert "and of the mission are taken as equal: one of the two does not say" in frames
        assert doubts == ["--from-survey: frontier cannot use it and flies as without it"] * doubted


def test_without_an_area_there_is_no_dive(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["dive"]) == 2
    said = capsys.readouterr().err
    assert "--area: expected the least x and y and the largest x and y in metres, got none" in said


def test_without_a_calibration_there_is_none_either(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["dive", "--area", "-1", "-1", "1", "1"]) == 2
    assert "--calibration: expected the lens file of the camera, got none" in capsys.readouterr().err


def test_without_the_extra_it_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name, *more: None if name == "pymavlink" else found(name, *more)
    )
    assert run_command(["dive", "--stand-in"]) == 2
    assert missing("rov", "pymavlink", "dive") in capsys.readouterr().err


@pytest.mark.parametrize(
    ("told", "wanted"),
    [
        (["--pilot", "udpin:127.0.0.1:0", "--drive", "guided"], "--pilot: expected --drive alt-hold"),
        (["--pilot", "127.0.0.1"], "pilot: expected udpin:HOST:PORT"),
    ],
)
def test_a_pilot_who_could_not_steer_is_refused(
    told: list[str], wanted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ask = ["dive", "--area", "-1", "-1", "1", "1", "--check", "--vehicle", "udpin:127.0.0.1:0"]
    ask += ["--dvl", "127.0.0.1:9", "--camera", "rtp:0", "--out", str(tmp_path)]
    assert run_command([*ask, *told]) == 2
    assert wanted in capsys.readouterr().err


def test_a_vehicle_that_does_not_answer_is_told_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.commands.dive.ready.HEARTBEAT", 0.5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    ask = ["dive", "--area", "-1", "-1", "1", "1", "--check", "--vehicle", f"udpin:127.0.0.1:{port}"]
    ask += ["--dvl", "127.0.0.1:9", "--camera", "rtp:0", "--out", str(tmp_path)]
    assert run_command(ask) == 1
    assert "expected a heartbeat of system 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "content", "wanted"),
    [
        ("--calibration", None, "there is no such file. Calibrate the camera first"),
        ("--calibration", "", "expected YAML as OpenCV writes it, got an empty file"),
        ("--calibration", "%YAML:1.0\n---\na: [", "expected YAML as OpenCV writes it: "),
        ("--labels", None, "model: expected a readable file, got"),
        ("--depth", "no model", "is not of ONNX. Is it an ONNX file?"),
    ],
)
def test_a_file_that_pictures_need_is_read_before_any_vehicle_is_asked(
    option: str,
    content: str | None,
    wanted: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "dream.robots.bluerov2.devices.Devices.__enter__", lambda devices: pytest.fail("devices were opened")
    )
    path = tmp_path / "file"
    if content is not None:
        path.write_text(content)
    ask = [
        "dive",
        "--area",
        "-1",
        "-1",
        "1",
        "1",
        "--check",
        option,
        str(path),
        "--out",
        str(tmp_path / "runs"),
    ]
    assert run_command(ask) == 2
    said = capsys.readouterr().err
    assert wanted in said
    assert str(path) in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "runs").exists()


def test_without_an_operator_there_is_no_dive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dive = ["dive", "--area", "-1", "-1", "1", "1", "--calibration", str(tmp_path / "camera.yaml")]
    assert run_command(dive) == 2
    assert "expected an operator at a terminal, got none. Say --unattended" in capsys.readouterr().err


class Home(WayHome):
    """A way home that a test goes."""

    there = unheard = False

    def __init__(self, clock: LockStep, how: LastResort = LastResort.SURFACE) -> None:
        limits = Limits(Bounds(-1.0, -1.0, 1.0, 1.0), last_resort=how)
        telemetry = SimpleNamespace(own_altitude=math.nan, depth=math.nan, own_altitude_from="")
        super().__init__(SimpleNamespace(telemetry=telemetry), limits, clock, threads=clock)  # type: ignore[arg-type]
        self.begun: list[LastResort] = []
        self.said: list[str] = []
        self.closed = False

    def begin(self, how: LastResort) -> None:
        self.how = how
        self.begun.append(how)

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(
    ("how", "said"),
    [
        (LastResort.SURFACE, "it comes to the surface"),
        (LastResort.HOLD, "it holds its depth: take the sticks, or end with Ctrl-C"),
        (LastResort.DISARM, "it is disarmed"),
    ],
)
def test_a_dive_ends_once_the_vehicle_is_home(how: LastResort, said: str) -> None:
    clock = LockStep()
    home = Home(clock, how)

    def arrive() -> None:
        clock.sleep(500.0)
        home.there = True

    clock.start(arrive, "arrives")
    home.finish(home.said.append)
    assert clock() == pytest.approx(500.0, abs=0.2)
    assert (home.begun, home.closed, home.said) == ([how], True, [said])


def test_a_vehicle_that_is_home_or_not_ours_is_left_without_a_word() -> None:
    clock = LockStep()
    home = Home(clock)
    home.there = True
    home.finish(home.said.append)
    assert (clock(), home.begun, home.said) == (0.0, [], [])


def test_one_that_stays_silent_is_waited_for_as_long_as_its_own_failsafe_may_take() -> None:
    clock = LockStep()
    home = Home(clock)

    def silence() -> None:
        for home.unheard in (True, False, True):
            clock.sleep(0.9 * LEAVING)

    clock.start(silence, "silence")
    home.finish(home.said.append)
    # Who is heard in between is waited for anew.
    assert clock() == pytest.approx(2.8 * LEAVING, abs=0.3)
    assert "left to its own failsafe" in home.said[-1]
    assert home.closed


@pytest.mark.parametrize(
    ("how", "presses", "leaves"),
    [
        (LastResort.HOLD, [20.0], 20.0),
        (LastResort.SURFACE, [20.0, 22.0], 22.0),
        (LastResort.SURFACE, [20.0, 30.0, 31.0], 31.0),
    ],
)
def test_ctrl_c_leaves_one_that_holds_and_one_that_comes_up_only_by_a_second(
    how: LastResort, presses: list[float], leaves: float
) -> None:
    clock = LockStep()
    home = Home(clock, how)

    def press() -> None:
        for at in presses:
            clock.sleep(at - clock())
            clock.interrupt()

    clock.start(press, "presses")
    home.finish(home.said.append)
    assert clock() == leaves
    assert "left as it is: interrupted" in home.said[-1]
    assert home.closed


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU])
def test_a_terminal_neither_ends_the_program_by_closing_nor_stops_it(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with _outlives_its_terminal():
        signal.raise_signal(number)
    assert signal.getsignal(number) == before


def test_a_warning_that_nobody_can_read_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    class Gone:
        def write(self, text: str) -> int:
            raise OSError("the terminal is gone")

        def flush(self) -> None:
            raise OSError("the terminal is gone")

    monkeypatch.setattr("sys.stderr", Gone())
    record = logging.LogRecord("dream", logging.WARNING, __file__, 1, "the battery is low", None, None)
    _Telling().handle(record)
    tell("it comes to the surface", quiet=False)


def test_the_line_that_dives_again_says_what_was_told() -> None:
    told = Dive(area=(-1.8, -1.8, 1.8, 1.8), at=(0.5, 0.0, 90.0), set_parameters=True, max_steps=5, json=True)
    line = repeating_command(told, "belief")
    assert line == ("dream dive belief --area -1.8 -1.8 1.8 1.8 --at 0.5 0 90 --max-steps 5 --set-parameters")
    planner = Belief(risk=0.1)
    assert repeating_command(Dive(planner=planner), "belief") == "dream dive belief --risk 0.1"
    ground = Ground(site=Path("reef.json"), from_survey="3", archive="kept.gpkg")
    line = "dream dive belief --site reef.json --from-survey 3"
    assert repeating_command(Dive(ground=ground), "belief") == f"{line} --archive kept.gpkg"
    ground = replace(ground, archive="postgresql://me:secret@host/reef")
    assert repeating_command(Dive(ground=ground), "belief") == line


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ("--area 1 -1 -1 1", "--area: expected finite x_min < x_max and y_min < y_max"),
        ("--area -1.83 -1 1 1", "--area: expected a width of whole 0.05 m cells, got 2.83 m"),
        ("--area -1 -1 1 1 --at 50 50 0", "--at: expected a place inside --area -1 -1 1 1, got 50 50"),
        ("--area -1 -1 1 1 --max-depth -3", "--max-depth: expected a limit above 0, got -3"),
        ("--area -1 -1 1 1 --minutes 0", "--minutes: expected a limit above 0, got 0"),
        ("--area -1 -1 1 1 --min-voltage -1", "--min-voltage: expected 0 or more, got -1"),
        ("--area -1 -1 1 1 --min-altitude -0.1", "--min-altitude: expected 0 or more, got -0.1"),
        ("--area -1 -1 1 1 --min-altitude 0.5", "--min-altitude: expected less than the 0.5 m of the A50"),
        ("--stand-in --area -1 -1 1 1", "--area: expected none with --stand-in"),
        ("--area -1 -1 1 1 --protocol dream-v2 --tilt 30", "--tilt: expected 20, where the camera"),
        ("--area -1 -1 1 1 --protocol dream-v2 --see shells", "--see: expected learned, or a network with"),
        ("--area -1 -1 1 1 --protocol dream-v2 --min-altitude 0.75", "less than the 0.7 m of the A50"),
    ],
)
def test_a_dive_that_cannot_be_is_refused_at_the_desk(
    options: str, wanted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "runs"
    assert run_command(["dive", "--check", *options.split(), "--out", str(out)]) == 2
    assert wanted in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.rare
@pytest.mark.parametrize("taken", ["vehicle", "pilot"])
def test_a_port_that_another_program_has_is_told_with_who_that_may_be(
    taken: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        at = {"vehicle": "udpin:127.0.0.1:0", "dvl": "127.0.0.1:9", "camera": "rtp:0"}
        at[taken] = f"udpin:127.0.0.1:{port}"
        ask = ["dive", "--area", "-1", "-1", "1", "1", "--check", "--out", str(tmp_path)]
        assert (
            run_command([*ask, *(word for name, where in at.items() for word in (f"--{name}", where))]) == 2
        )
    said = capsys.readouterr().err
    assert f"expected port {port} of this computer to be free" in said
    assert "Close QGroundControl" in said


@pytest.mark.parametrize(
    "option, values, wanted",
    [
        ("--dvl-at", ["-150", "0", "-100"], "--dvl-at: expected metres from the autopilot"),
        ("--gauge-at", ["0", "nan", "0"], "--gauge-at: expected metres from the autopilot"),
        ("--camera-at", ["0", "0", "2"], "--camera-at: expected metres from the autopilot"),
        ("--speed-of-sound", ["343"], "--speed-of-sound: expected 1400 to 1600 m/s, got 343"),
        ("--speed-of-sound", ["nan"], "--speed-of-sound: expected 1400 to 1600 m/s, got nan"),
        ("--tilt", ["120"], "--tilt: expected -90 to 90 degrees down, got 120"),
        ("--tilt", ["nan"], "--tilt: expected -90 to 90 degrees down, got nan"),
        ("--lights", ["1.5"], "--lights: expected a share from 0 to 1, got 1.5"),
        ("--at", ["1", "1", "0"], "--at: expected none with --stand-in, which has its own"),
        ("--vehicle", ["udpin:0.0.0.0:14551"], "--vehicle: expected none with --stand-in"),
        ("--surface-pressure", ["1013"], "--surface-pressure: expected none with --stand-in"),
    ],
)
def test_what_cannot_be_of_a_vehicle_in_water_is_refused(
    option: str, values: list[str], wanted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["dive", "--stand-in", "--out", str(tmp_path), option, *values]) != 0
    assert wanted in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_dive_that_ends_before_its_first_step_says_why_and_what_the_log_lost(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    limits, start = Limits(Bounds(-1.0, -1.0, 1.0, 1.0)), SE2(0.0, 0.0, 0.0)
    devices = SimpleNamespace(log=SimpleNamespace(lost={"mavlink": 3, "a50": 0, "camera": 2}))
    ready = Ready(Dive(), POOL_V1, devices, limits, start, tmp_path, None, None, Known())  # type: ignore[arg-type]
    with pytest.raises(
        MissionAborted, match=r"aborted: 48\.2 m outside the area; no step was made\. The log"
    ):
        Flight(ready, "belief")._end({"steps": 0}, MissionAborted("48.2 m outside the area"))
    assert "messages are lost: 3 of mavlink, 2 of camera. Was the disk full?" in caplog.text


def test_a_step_whose_depth_is_not_believed_says_so_and_one_with_trouble(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    told: list[tuple[str, Any]] = []
    devices = SimpleNamespace(
        log=SimpleNamespace(tap=lambda at, channel, sent, said: told.append((channel, said))), now=lambda: 7.0
    )
    limits, start = Limits(Bounds(-1.0, -1.0, 1.0, 1.0)), SE2(0.0, 0.0, 0.0)
    ready = Ready(Dive(), POOL_V1, devices, limits, start, tmp_path, None, None, Known())  # type: ignore[arg-type]
    flight = Flight(ready, "belief")
    far = "depth: 3.0 times as far as the floor by the DVL and the attitude, and not mapped"
    accounts = [
        Account(
            sure, 0.9, beside, 0.0, lost=2, no_depth=5, shares=(0.0, 1.0, 0.0, 0.0), floating=0.1, doubt=doubt
        )
        for sure, beside, doubt in ((0.8, 1.0, ""), (0.0, 3.0, far), (0.0, math.nan, far), (0.4, 1.0, ""))
    ]
    vehicle = SimpleNamespace(accounts=[])
    troubles = ["", "", "the battery is at 14.3 V", "the battery is at 14.2 V"]

    def steps() -> Iterator[Any]:
        for index, (account, trouble) in enumerate(zip(accounts, troubles, strict=True)):
            vehicle.accounts.append(account)
            yield SimpleNamespace(
                index=index,
                decision=Decision(),
                observation=SimpleNamespace(trouble=trouble),
                guarded=SimpleNamespace(note=""),
                arrival=SimpleNamespace(note=""),
            )

    logbook = SimpleNamespace(note=lambda step: None)
    noted = [
        flight._annotated(step, logbook, vehicle)["perception"]  # type: ignore[arg-type]
        for step in flight._logged(steps(), vehicle)  # type: ignore[arg-type]
    ]
    assert [said["doubt"] for said in noted] == ["", far, far, ""]
    assert [said["depth_beside_floor"] for said in noted] == [1.0, 3.0, None, 1.0]
    assert noted[1]["pixels_without_label"] == 2
    assert [said["doubt"] for channel, said in told if channel == "perception"] == ["", far, far, ""]
    # It is told once, as long as it stays the same.
    assert caplog.text.count(f"step 1: {far}") == 1
    assert caplog.text.count(far) == 1
    assert caplog.text.count("step 2: the battery is at 14.3 V: the mission goes home") == 1
    assert caplog.text.count("goes home") == 1
    counted = _perception(accounts)
    assert (counted["frames"], counted["frames_doubted"], counted["frames_without_depth"]) == (4, 2, 2)
    assert (counted["pixels_without_label"], counted["pixels_without_depth"]) == (8, 20)


def flight(folder: Path) -> Flight:
    """A dive that is over, with nothing lost of its log."""
    limits, start = Limits(Bounds(-1.0, -1.0, 1.0, 1.0)), SE2(0.0, 0.0, 0.0)
    devices = SimpleNamespace(log=SimpleNamespace(lost={}))
    ready = Ready(Dive(json=True), POOL_V1, devices, limits, start, folder, None, None, Known())  # type: ignore[arg-type]
    return Flight(ready, "belief")


@pytest.mark.parametrize(
    ("stopped", "said"),
    [
        (MissionAborted("dive: Lost manual control"), "dive: Lost manual control; could not write .*"),
        (KeyboardInterrupt(), "interrupted; could not write .*"),
        (None, "the disk is full: could not write .*"),
        (OSError("could not write step 3 (No space left on device)"), "the disk is full: .* step 3 .*"),
    ],
)
@pytest.mark.parametrize("takes", ["summary.json", "report.html"])
def test_a_full_disk_takes_nothing_from_why_a_dive_ended_nor_from_the_exit_status(
    stopped: BaseException | None,
    said: str,
    takes: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stopped = copy.copy(stopped)  # It is told of what follows it.
    recording.write_config(tmp_path, CONFIG)
    list(recording.record(painted_mission(1), tmp_path))
    came = {
        **SUMMARY,
        "ended": "aborted",
        "why": why("", stopped),
        "success": False,
    }
    write_text = Path.write_text

    def full(path: Path, *arguments: Any, **options: Any) -> int:
        if takes in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write_text(path, *arguments, **options)

    monkeypatch.setattr(Path, "write_text", full)
    over = flight(tmp_path)
    kept = "[0-9]+ steps are kept in .*"
    # Exit status 1, as of any other abort.
    with pytest.raises(MissionAborted, match=f"^aborted: {said}; {kept}"):
        over._end(came, over._summed_up(came, stopped))
    assert json.loads(capsys.readouterr().out)["why"] == came["why"]
    assert (tmp_path / "summary.json").exists() == (takes != "summary.json")


class Filling:
    """A disk that is full for whatever lies in a place, from the time on when step 1 is written."""

    def __init__(self, place: str, then: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
        self.place, self.then = place, then
        self.full = False
        self.refused: set[str] = set()
        for owner, name in ((Image.Image, "save"), (Path, "write_text"), (OccupancyMap, "save")):
            monkeypatch.setattr(owner, name, self._until_full(getattr(owner, name)))
        monkeypatch.setattr(np, "savez_compressed", self._until_full(np.savez_compressed))
        monkeypatch.setattr(McapWriter, "_append", self._until_full(McapWriter._append))
        monkeypatch.setattr(recording, "_append", self._until_full(self._step))

    def _step(self, lines: FileIO, line: bytes) -> None:
        append(lines, line)
        if b'"step":1,' in line:
            self.full = True
            self.then()

    def _until_full(self, write: Callable[..., Any]) -> Callable[..., Any]:
        def writes(*arguments: Any, **options: Any) -> Any:
            names = {_written_to(one) for one in arguments[:2]} - {""}
            if self.full and any(self.place in name for name in names):
                self.refused |= names
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(*arguments, **options)

        return writes


append = recording._append


def _written_to(target: object) -> str:
    """The path of what is written to, be it open or not; empty of anything else."""
    target = target._file if isinstance(target, McapWriter) else target
    return str(target if isinstance(target, Path) else getattr(target, "name", ""))


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "leaks", "said"),
    [
        ("frames", False, "the disk is full: could not write step 2"),
        pytest.param("observations", False, "the disk is full: could not write", marks=pytest.mark.rare),
        pytest.param("log.mcap", True, "dive: water in the hull", marks=pytest.mark.rare),
        ("", True, "dive: water in the hull; could not write"),
    ],
)
def test_wherever_there_is_no_more_room_the_vehicle_is_brought_home_and_the_reason_kept(
    place: str, leaks: bool, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Rig(tmp_path, make_world("pool/arc", 1), pictures=5.0) as rig:
        disk = Filling(place, lambda: setattr(rig.standin.tank, "leak", leaks), monkeypatch)
        dived = rigged.dive(rig, tmp_path, max_steps=4)
        assert not rig.link.telemetry.armed
        assert isinstance(dived.error, MissionAborted)
        assert f"aborted: {said}" in str(dived.error)
    assert disk.refused
    summary = recording.read_summary(tmp_path)
    if place:
        assert summary is not None
        assert summary.why.startswith(said)
        assert read_steps(tmp_path)[-1].why == summary.why
    else:
        assert "Once there is room: dream report" in str(dived.error)


def test_who_could_not_be_left_as_it_was_is_told_with_the_file_to_restore_it_from(tmp_path: Path) -> None:
    assert (
        f"2 parameters are not as before the dive: their values stand in {tmp_path / PARAMETERS_BEFORE}."
        in (how_to_restore(2, tmp_path))
    )


def test_where_things_sit_is_kept_with_the_dive(tmp_path: Path) -> None:
    told = Dive(dvl_at=(0.1, 0.0, -0.2), camera_at=(0.25, 0.0, 0.02), tilt=30.0, speed_of_sound=1482.0)
    limits, start = Limits(Bounds(-1.0, -1.0, 1.0, 1.0)), SE2(0.0, 0.0, 0.0)
    devices = SimpleNamespace(log=SimpleNamespace(epoch_ns=1_780_000_000_250_000_000))
    ready = Ready(told, POOL_V1, devices, limits, start, tmp_path, None, None, Known())  # type: ignore[arg-type]
    kept = config(ready, "belief", None)
    assert kept["began"].isoformat() == "2026-05-28T20:26:40.250000+00:00"
    assert kept["mounting"] == {
        "dvl": [0.1, 0.0, -0.2],
        "gauge": [-0.2, 0.0, 0.0],
        "camera": [0.25, 0.0, 0.02],
    }
    assert kept["dive"]["speed_of_sound"] == 1482.0
    assert "--dvl-at 0.1 0 -0.2" in kept["command"]
    # The camera looks from there, and the estimator reads the DVL there.
    assert ready.mount.translation == pytest.approx([0.25, 0.0, 0.02])
    ahead = ready.mount.rotation[:, 2]
    assert math.degrees(math.asin(-ahead[2])) == pytest.approx(30.0)
    assert mounting_told(told).T_base_dvl.translation == pytest.approx([0.1, 0.0, -0.2])


@pytest.mark.rare
@pytest.mark.slow
def test_the_dvl_is_told_how_fast_sound_goes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "check").mkdir()
    (tmp_path / "check/mine").write_text("kept")
    fly = ["dive", "--stand-in", "--check", "--json", "--speed-of-sound", "1482", "--out", str(tmp_path)]
    run_command(fly)
    said = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    # How many pictures come in, and how soon they are mapped, is for the machine to say.
    of_the_machine = {"camera", "pictures", "computer"}
    assert [name for name, item in said.items() if not item["ok"] and name not in of_the_machine] == []
    assert said["sound"]["said"] == "told 1482 m/s, it had 1500"
    assert said["speed of sound"]["said"] == "1482 m/s"
    # No run, `latest` is what it was, and what lies there is left alone.
    assert {path.name for path in tmp_path.iterdir()} == {".dream-check", "check"}
    assert (tmp_path / "check/mine").read_text() == "kept"
    log = tmp_path / ".dream-check" / "log.mcap"
    (mounting,) = read_log(log, ["/mounting"])
    assert json.loads(mounting.message.data)["said"] == {"dvl": [-0.15, 0.0, -0.1], "gauge": [-0.2, 0.0, 0.0]}
    lines = b"".join(line for _, out, line in read_wire(log, "a50") if out)
    assert b'"speed_of_sound": 1482' in lines


def test_pictures_may_come_to_any_address_of_this_computer() -> None:
    source = source_of("rtp:5600")
    assert isinstance(source, RtpVideo)
    assert (source.host, source.port) == ("0.0.0.0", 5600)
    narrow = source_of("rtp:127.0.0.1:5601")
    assert isinstance(narrow, RtpVideo)
    assert (narrow.host, narrow.port) == ("127.0.0.1", 5601)
