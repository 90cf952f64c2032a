"""`dream survey`: what it prints, what it writes, how it fails; and `dream run --site`."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import sqlite3
import time
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.survey import files
from dream.survey.archive import VARIABLE
from dream.survey.measuring import GUESSED
from dream.survey.products.words import limits, summary
from dream.survey.site import Site, read_site, write_site
from dream.survey.survey import Measure
from dream.types import Target
from tests.survey.browsing import Seen
from tests.survey.repeated import reef, survey, without
from tests.survey.scenes import reef as made_reef
from tests.survey.scenes import wreck as made_wreck


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two surveys of a site, in which we are; a third of a patch died between them."""
    rng = np.random.default_rng(12)
    before = reef(rng)
    files.write(survey(before, rng, name="first"), tmp_path / "first.survey.npz")
    files.write(survey(without(before, 1, 0.33, rng), rng, name="second"), tmp_path / "second.survey.npz")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE, raising=False)
    return tmp_path


def said(words: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """The one object that a command prints."""
    capsys.readouterr()
    assert run_command([*words.split(), "--json"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("\n") == 1
    return dict(json.loads(printed))


def complaint(words: str, capsys: pytest.CaptureFixture[str], status: int = 2) -> str:
    """The one line that a command fails with."""
    capsys.readouterr()
    assert run_command(words.split()) == status
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


def test_surveys_are_kept_listed_shown_and_compared(two: Path, capsys: pytest.CaptureFixture[str]) -> None:
    added = said("survey add first.survey.npz", capsys)
    measures = added.pop("measures")
    assert added == {
        "archive": "surveys.gpkg",
        "survey": 1,
        "name": "first",
        "new": True,
        "replaced": False,
    }
    assert measures == said("survey show 1", capsys)["measures"]
    assert said("survey add second.survey.npz", capsys)["survey"] == 2
    assert not said("survey add first.survey.npz", capsys)["new"]
    listed = said("survey list", capsys)["surveys"]
    assert [(one["survey"], one["name"], one["site"]) for one in listed] == [
        (1, "first", "Test reef"),
        (2, "second", "Test reef"),
    ]
    assert said("survey show 2", capsys)["individuals_found"] == listed[1]["individuals_found"]
    compared = said("survey compare 1 2 --out told", capsys)
    assert [patch["verdict"] for patch in compared["patches"]].count("loss") == 1
    assert compared["patches"][1]["verdict"] == "loss"
    assert sorted(path.name for path in (two / "told").iterdir()) == [
        *("change.gpkg", "change.html", "change.json", "change.png")
    ]
    with contextlib.closing(sqlite3.connect(two / "told/change.gpkg")) as change:
        sizes = change.execute("SELECT survey, size_m FROM individuals ORDER BY id").fetchall()
    both = {name: files.read(two / f"{name}.survey.npz").individuals for name in ("first", "second")}
    assert 0 < sum(size is None for _, size in sizes) < len(sizes) / 3
    assert sizes == [
        (when, size if clear else None)
        for when, found in zip(("before", "after"), both.values(), strict=True)
        for size, clear in zip(found.size.tolist(), found.clear, strict=True)
    ]
    for words in ("survey list", "survey show 1", "survey compare 1 second.survey.npz"):
        assert run_command(words.split()) == 0
        printed = capsys.readouterr().out
        assert "first" in printed
    assert printed.splitlines()[-1] == "  to read: change/change.html"


def added(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[str, list[list[str]]]:
    """What `survey add` prints of the survey, and the commands that it says come next."""
    capsys.readouterr()
    assert run_command(["survey", "add", *words.split()]) == 0
    told, _, after = capsys.readouterr().out.partition("next:\n")
    lines = [line.strip() for line in after.splitlines()]
    return told, [shlex.split(line)[1:] for line in lines if line.startswith("dream ")]


@pytest.mark.rare
def test_what_is_added_is_told_with_what_can_be_done_next(
    two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = files.read(two / "first.survey.npz")
    measures = (Measure("reef_area", 66.2, 64.3, 68.2, "m2"), Measure("count", 1118.0, 1008.0, 1239.0, ""))
    files.write(replace(first, measures=measures), two / "first.survey.npz")
    told, following = added("first.survey.npz", capsys)
    assert [" ".join(line.split()) for line in told.splitlines()[1:3]] == [
        "Reef area 66.2 m² (64.3 to 68.2 m²)",
        "Individuals 1,118 (1,008 to 1,239)",
    ]
    assert "An individual is a clump of shells, not one oyster." in told
    assert [words[:3] for words in following] == [["survey", "show", "1"], ["survey", "export", "1"]]
    _, following = added("second.survey.npz --archive surveys.gpkg", capsys)
    assert following == [
        *(["survey", "show", "2"], ["survey", "compare", "1", "2"]),
        ["survey", "export", "2", "--to", "products"],
    ]
    for words in following[:2]:
        assert run_command(words) == 0
    assert (two / "change/change.html").is_file()


def test_what_can_be_done_next_names_an_archive_that_is_not_the_default(
    two: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (two / "my reefs").mkdir()
    monkeypatch.setenv(VARIABLE, "my reefs/kept.gpkg")
    _, following = added("first.survey.npz", capsys)
    monkeypatch.delenv(VARIABLE)
    assert all(words[-2:] == ["--archive", "my reefs/kept.gpkg"] for words in following)
    capsys.readouterr()
    assert run_command(following[0]) == 0


def test_where_there_is_no_archive_those_near_are_named(
    two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "Begin one with dream survey add" in complaint("survey list", capsys)
    for k, name in enumerate(("older", "newer")):
        archive = two / f"runs/survey-{name}/surveys.gpkg"
        archive.parent.mkdir(parents=True)
        said(f"survey add first.survey.npz --archive {archive}", capsys)
        os.utime(archive, (k, k))
    error = complaint("survey list", capsys)
    newer, older = (f"runs/survey-{name}/surveys.gpkg" for name in ("newer", "older"))
    assert f"Near here: {newer}, {older}. Say --archive {newer}, or export DREAM_ARCHIVE={newer}" in error
    assert len(said(f"survey list --archive {newer}", capsys)["surveys"]) == 1


@pytest.mark.rare
def test_in_a_small_terminal_each_figure_stands_on_one_line(
    two: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    compared = said("survey compare first.survey.npz second.survey.npz", capsys)
    rows = len(compared["differences"]) + sum(
        len(patch["differences"]) + sum(patch[share] is not None for share in ("gone", "come"))
        for patch in compared["patches"]
    )
    assert run_command(["survey", "compare", "first.survey.npz", "second.survey.npz"]) == 0
    lines = capsys.readouterr().out.splitlines()
    figure = r"[a-z ]+ [-\d.,]+ (→|of) [-\d.,]+( /?m²?)? +[-+\d.%() ]+ [-+\d.%]+ to [-+\d.%]+ +<?[\d.e-]+ *"
    assert sum(re.fullmatch(figure, line) is not None for line in lines) == rows
    said("survey add first.survey.npz", capsys)
    assert run_command(["survey", "list"]) == 0
    assert "patches  count" in (printed := capsys.readouterr().out)
    assert "…" not in printed


@pytest.mark.few(3)
@pytest.mark.parametrize("name", ["[/]", r"\[/]", r"\\[/]", "[bold]"])
def test_names_that_look_like_markup_are_printed_as_they_are(
    name: str, two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = replace(files.read(two / "first.survey.npz"), site=Site(name, 1.0, 2.0), name=name)
    files.write(one, two / "odd.survey.npz")
    folder = "to[" + "/]"
    for words in (
        "survey add odd.survey.npz --archive [/odd].gpkg",
        "survey list --archive [/odd].gpkg",
        "survey show odd.survey.npz",
        f"survey compare odd.survey.npz odd.survey.npz --out {folder}",
    ):
        (two / "[").mkdir(exist_ok=True)
        capsys.readouterr()
        assert run_command(words.split()) == 0, words
        assert name in "".join(capsys.readouterr().out.split("\n")), words


@pytest.mark.rare
def test_surveys_the_wrong_way_round_or_made_in_two_ways_are_doubted(
    two: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    first = files.read(two / "first.survey.npz")
    later = replace(first, began=first.began + timedelta(days=1), name="later")
    files.write(later, two / "later.survey.npz")
    files.write(replace(later, protocol="dream-v1-noisy", name="other"), two / "other.survey.npz")
    for names, doubts in (
        ("first.survey.npz later.survey.npz", 0),
        ("first.survey.npz first.survey.npz", 1),
        ("later.survey.npz first.survey.npz", 1),
        ("first.survey.npz other.survey.npz", 1),
        ("other.survey.npz first.survey.npz", 2),
    ):
        caplog.clear()
        out = two / names.replace(" ", "-")
        said(f"survey compare {names} --out {out}", capsys)
        told = [one.getMessage() for one in caplog.records if one.getMessage().startswith("compare: ")]
        assert len(told) == doubts
        kept = json.loads((out / "change.json").read_text())["doubts"]
        assert [doubt.removeprefix("compare: ") for doubt in told] == kept
        page = Seen((out / "change.html").read_text()).text.casefold()
        assert all(doubt.removeprefix("compare: ").casefold() in page for doubt in told)


@pytest.mark.rare
def test_a_change_is_not_written_over_that_of_other_surveys(
    two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = files.read(two / "first.survey.npz")
    files.write(replace(first, began=first.began + timedelta(days=1), name="later"), two / "later.survey.npz")
    for again in range(2):
        said("survey compare first.survey.npz second.survey.npz", capsys)
        held = (two / "change/change.json").read_bytes()
        assert json.loads(held)["after"]["name"] == "second", again
    assert run_command(["survey", "compare", "first.survey.npz", "later.survey.npz"]) == 2
    assert "name another folder with --out" in capsys.readouterr().err
    assert (two / "change/change.json").read_bytes() == held


def test_what_was_counted_by_an_uncalibrated_protocol_is_doubted_wherever_it_is_told(
    two: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    first = files.read(two / "first.survey.npz")
    tank = replace(first, protocol="pool-v1", name="tank")
    files.write(tank, two / "tank.survey.npz")
    for one, name, doubted in ((first, "first", False), (tank, "tank", True)):
        caplog.clear()
        capsys.readouterr()
        assert run_command(["survey", "add", f"{name}.survey.npz", "--json"]) == 0
        assert run_command(["survey", "show", f"{name}.survey.npz"]) == 0
        printed = " ".join(capsys.readouterr().out.split())
        told = ("This survey was made by pool-v1" in text for text in (printed, caplog.text))
        assert list(told) == [doubted, doubted]
        assert summary(one)[0].startswith("Counts, densities and sizes are calibrated") == doubted
        assert any("Not so here. Counts" in line for line in limits(one)) == doubted
    assert not any("pool-v1" in line for line in summary(replace(tank, target=Target.WRECK)))


def test_the_archive_is_the_one_that_is_named_else_that_of_the_environment(
    two: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, str(two / "there.gpkg"))
    assert said("survey add first.survey.npz", capsys)["archive"] == str(two / "there.gpkg")
    assert said("survey add first.survey.npz --archive here.gpkg", capsys)["archive"] == "here.gpkg"
    assert not (two / "surveys.gpkg").exists()


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "words, expected",
    [
        ("survey list", "surveys.gpkg: expected an archive of surveys, got no file"),
        ("survey show 1", "surveys.gpkg: expected an archive of surveys, got no file"),
        ("survey show \u00b2", "\u00b2: expected the number of a survey in the archive, its file, or the"),
        (f"survey show {10**30}", f"{10**30}: expected the number of a survey in the archive, its file"),
        ("survey show nothing", "nothing: expected the number of a survey in the archive, its file, or the"),
        ("survey show first.survey.npz --site none.json", "none.json: expected a site file"),
        ("survey add nowhere.survey.npz", "run without origin"),
        ("survey add damaged.survey.npz", "damaged.survey.npz: expected the file of a survey, got a damaged"),
        ("survey add .", "expected a run folder, got no config.json"),
        ("survey add first.survey.npz --archive damaged.survey.npz", "got a damaged or foreign file"),
        ("survey compare first.survey.npz elsewhere.survey.npz", "expected two surveys of one site"),
        ("survey compare first.survey.npz nowhere.survey.npz", "a run without origin"),
        ("survey add first.survey.npz --replace 3", "surveys.gpkg: expected an archive of surveys, got no"),
        ("survey remove 3", "surveys.gpkg: expected an archive of surveys, got no file"),
        ("survey remove first", "expected a whole number, got first"),
        (
            "survey add first.survey.npz --date 01.06.2026",
            "such as 2026-06-01 or 2026-06-01T09:30, got 01.06",
        ),
        ("survey add first.survey.npz --date 0001-01-01T00:00+05:00", "--date: expected a date, or a date"),
        ("survey add first.survey.npz --date 0001-01-01", "began: expected a year from 1900 to 9000, got 1"),
        ("survey add first.survey.npz --site none.json", "none.json: expected a site file"),
        ("survey list --archive mysql://me:secret@host/reef", "expected a path or postgresql://"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_and_nothing_is_written(
    words: str, expected: str, two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = made_reef()
    files.write(replace(one, site=None), two / "nowhere.survey.npz")
    files.write(replace(one, site=Site("Other reef", 10.0, 10.0)), two / "elsewhere.survey.npz")
    (two / "damaged.survey.npz").write_bytes(files.dumped(one)[:-3000])
    before = {path: path.read_bytes() for path in two.iterdir()}
    error = complaint(words, capsys)
    assert expected in error
    assert "secret" not in error
    assert {path: path.read_bytes() for path in two.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("survey add first.survey.npz --save saved.survey.npz --archive second.survey.npz", "foreign file"),
        ("survey add first.survey.npz --save none/saved.survey.npz", "could not write none/saved.survey.npz"),
        ("survey add first.survey.npz --save folder --archive new.gpkg", "could not write folder"),
        ("survey add nowhere.survey.npz --save saved.survey.npz", "run without origin"),
    ],
)
def test_a_survey_is_kept_and_saved_or_neither(
    words: str, expected: str, two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files.write(replace(files.read(two / "first.survey.npz"), site=None), two / "nowhere.survey.npz")
    (two / "folder").mkdir()
    before = {path: path.read_bytes() for path in two.rglob("*") if path.is_file()}
    assert expected in complaint(words, capsys)
    assert {path: path.read_bytes() for path in two.rglob("*") if path.is_file()} == before


def test_a_run_with_a_site_is_measured_and_kept(two: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = Site("Inner reef", 54.9, 8.3, heading_deg=20.0)
    write_site(site, two / "reef.json")
    assert read_site(two / "reef.json") == site
    said(
        "run belief --world reef/string --protocol dream-v1 --max-steps 12 --site reef.json --out runs",
        capsys,
    )
    run = next(path for path in (two / "runs").iterdir() if not path.is_symlink())
    assert read_site(run / "site.json") == site
    # A first look before all of them.
    assert len(list((run / "observations").iterdir())) == 13
    added = said(f"survey add {run} --save flown.survey.npz", capsys)
    assert added["name"] == run.name
    assert files.read(two / "flown.survey.npz").site == site
    assert said("survey show 1", capsys)["site"]["name"] == "Inner reef"
    assert "expected none, because" in complaint(f"survey show {run} --site {_other(two)}", capsys)
    # Under another name it is the same run, made at the same time.
    began = said("survey show 1", capsys)["began"]
    assert began[:16].replace(":", "-") == run.name[:16]
    run.rename(two / "a-copy")
    os.utime(two / "a-copy" / "config.json", (1, 1))
    assert said("survey show a-copy", capsys)["began"] == began
    assert f"got that of survey 1 ({run.name})" in complaint("survey add a-copy", capsys)
    assert said("survey add a-copy --replace 1", capsys)["replaced"]
    assert said("survey show 1", capsys)["name"] == "a-copy"


def test_what_is_there_is_put_right_by_its_number(
    two: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    said("survey add first.survey.npz", capsys)
    said("survey add second.survey.npz", capsys)
    here = files.read(two / "second.survey.npz").site
    assert here is not None
    write_site(replace(here, latitude=here.latitude + 1e-3, heading_deg=5.0), two / "right.json")
    caplog.clear()
    words = "survey add second.survey.npz --site right.json --date 2026-06-03T10:30 --replace 2"
    assert said(words, capsys) == {
        "archive": "surveys.gpkg",
        "survey": 2,
        "name": "second",
        "new": False,
        "replaced": True,
        "measures": [],
    }
    moved, began = caplog.messages
    assert moved.startswith(
        "second: its origin moves by 111.3 m and turns by 5.0°, from Test reef (54.900000"
    )
    assert began == "second: it began at 2026-06-03 10:30:00 UTC, and not at 2026-06-01 00:00:00 UTC"
    told = said("survey show 2", capsys)
    assert told["began"] == "2026-06-03T10:30:00+00:00"
    assert told["site"]["latitude"] == here.latitude + 1e-3
    assert told["made_by"]["corrected"]["site"]["latitude"] == here.latitude
    assert not said(words, capsys)["replaced"]
    # Without its file; and what was put right is not lost without a word.
    caplog.clear()
    assert said("survey add 2 --date 2026-06-04 --replace 2", capsys)["replaced"]
    (began,) = caplog.messages
    assert "it began at 2026-06-04 00:00:00 UTC, and not at 2026-06-03 10:30:00 UTC" in began
    caplog.clear()
    assert run_command(["survey", "add", "second.survey.npz", "--replace", "2"]) == 0
    assert "put second (Test reef) in the place of survey 2" in capsys.readouterr().out
    assert [text.split(": ")[1].split(" at")[0].split(" by")[0] for text in caplog.messages] == [
        "its origin moves",
        "it began",
    ]
    assert said("survey show 2", capsys)["made_by"] == {}
    assert said("survey show 1", capsys)["name"] == "first"


def test_an_origin_that_a_run_says_wrongly_is_put_right_when_it_is_added(
    two: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    added = said(f"survey add first.survey.npz --site {_other(two)} --save right.survey.npz", capsys)
    assert added["new"]
    (moved,) = caplog.messages
    assert re.fullmatch(r"first: its origin moves by [\d.]+ km and turns by 0.0°, from Test reef .*", moved)
    assert said("survey show 1", capsys)["site"]["name"] == "Other reef"
    assert files.read(two / "right.survey.npz").made_by["corrected"]["site"]["name"] == "Test reef"


def test_a_date_still_to_come_is_doubted_and_one_of_another_zone_understood(
    two: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with monkeypatch.context() as abroad:
        abroad.setenv("TZ", "America/New_York")
        time.tzset()
        said("survey add first.survey.npz --date 2999-01-01", capsys)
    time.tzset()
    (began, doubt) = caplog.messages
    assert began.startswith("first: it began at 2999-01-01 00:00:00 UTC, and not")
    assert doubt == (
        "first: began at 2999-01-01 00:00:00 UTC, which is still to come. If that is wrong, say when with "
        "dream survey add first.survey.npz --date"
    )
    said("survey add second.survey.npz --date 2026-06-01T01:00:00+02:00", capsys)
    assert said("survey show 2", capsys)["began"] == "2026-05-31T23:00:00+00:00"
    assert [one["survey"] for one in said("survey list", capsys)["surveys"]] == [2, 1]


def test_a_date_that_is_only_guessed_is_doubted_until_it_is_said(
    two: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    guessed = replace(files.read(two / "first.survey.npz"), made_by={"began_by": GUESSED})
    files.write(guessed, two / "guessed.survey.npz")
    for command in ("show", "add"):
        caplog.clear()
        said(f"survey {command} guessed.survey.npz", capsys)
        (doubt,) = caplog.messages
        assert doubt.startswith("first: began at 2026-06-01 00:00:00 UTC, going by when its config.json was")
        assert doubt.endswith("say when with dream survey add guessed.survey.npz --date")
    caplog.clear()
    said("survey add guessed.survey.npz --date 2026-05-01 --replace 1", capsys)
    assert "going by" not in caplog.text


def test_a_survey_is_removed_by_its_number(two: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said("survey add first.survey.npz", capsys)
    said("survey add second.survey.npz", capsys)
    assert said("survey remove 1", capsys) == {
        "archive": "surveys.gpkg",
        "survey": 1,
        "name": "first",
        "site": "Test reef",
        "began": "2026-06-01T00:00:00+00:00",
    }
    assert "expected the number of a survey in it, got 1. There are: 2." in complaint(
        "survey remove 1", capsys
    )
    assert run_command(["survey", "remove", "2"]) == 0
    printed = capsys.readouterr().out
    assert printed == "surveys.gpkg: removed survey 2, second (Test reef, 2026-06-01 00:00)\n"
    assert said("survey list", capsys)["surveys"] == []


def test_a_site_that_cannot_be_read_stops_a_run_before_it_begins(
    two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (two / "bad.json").write_text('{"name": "reef", "latitude": 95, "longitude": 8}')
    assert "latitude" in complaint("run --site bad.json --out runs", capsys)
    assert not (two / "runs").exists()


def _other(folder: Path) -> Path:
    write_site(Site("Other reef", 1.0, 2.0), folder / "other.json")
    return folder / "other.json"


def test_of_a_wreck_pieces_are_told_and_of_a_reef_patches(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    for made, part, parts in ((made_wreck(), "piece", "pieces"), (made_reef(), "patch", "patches")):
        path = tmp_path / f"{part}.survey.npz"
        files.write(made, path)
        assert run_command(["survey", "show", str(path)]) == 0
        out = capsys.readouterr().out
        assert f", {parts}: {len(made.patches)}" in out
        assert any(line.startswith(part) for line in out.splitlines())


@pytest.mark.slow
@pytest.mark.rare
def test_a_run_in_space_is_measured_shown_compared_and_told_if_damaged(
    two: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_site(Site("Wreck", 54.9, 8.3), two / "wreck.json")
    flying = "run orbits --world wreck/1 --protocol dream-v2-true --max-steps 30 --site wreck.json"
    said(f"{flying} --out runs", capsys)
    run = next(path for path in (two / "runs").iterdir() if not path.is_symlink())
    said(f"survey add {run} --save flown.survey.npz", capsys)
    (hull,) = said("survey show 1", capsys)["structures"]
    told = {measure["name"]: measure["value"] for measure in hull["measures"]}
    assert 2.0 < told["height"] < 7.0
    assert 0.0 < told["inspected_share"] < 1.0
    assert [side["kind"] for side in hull["sides"]] == ["side", "side", "end", "end", "top", "underside"]
    assert "inspected share" in shown("survey show 1", capsys)
    # A comparison holds the ground against each other, and leaves out what only one tells.
    said(f"survey add {run} --date 2026-01-01 --save earlier.survey.npz --archive other.gpkg", capsys)
    compared = said("survey compare earlier.survey.npz flown.survey.npz --out told", capsys)
    assert {one["name"] for one in compared["measures"]} >= {"inspected_share", "known_surface"}
    whole = (run / "volume.npz").read_bytes()
    (run / "volume.npz").write_bytes(whole[: len(whole) // 2])
    assert "volume.npz: expected a volume written by save" in complaint(f"survey show {run}", capsys)
    (run / "volume.npz").unlink()
    assert "expected a run with its volume, got no volume.npz in it" in complaint(
        f"survey show {run}", capsys
    )


def shown(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert run_command(words.split()) == 0
    return " ".join(capsys.readouterr().out.split())
