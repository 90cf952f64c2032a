"""`dream run --site`, `dream survey add`, `dream run --from-survey`, `dream replay`: a reef come back to."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.commands.ground import Ground
from dream.planning import Belief
from dream.protocol import DREAM_V1
from dream.recording import read_config, read_steps
from dream.survey import files
from dream.survey.archive import VARIABLE
from dream.survey.measuring import measure
from dream.survey.products.words import facts
from dream.survey.site import Site, write_site
from tests.survey.scenes import AREA, SITE, reef, wreck

pytestmark = pytest.mark.usefixtures("worlds_are_made_once")

STEPS = 6
"""Of each mission: the planner decides after the three of the look around."""
BEFORE, LATER = "reef/mixed --start 3", "reef/mixed+1y1 --start 2"


@dataclass(frozen=True)
class Surveyed:
    """A reef that was surveyed, and kept."""

    run: Path
    file: Path
    archive: Path
    site: Path


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> Surveyed:
    """Flown, measured and kept as survey 1."""
    folder = tmp_path_factory.mktemp("surveyed")
    site, archive, file = (folder / name for name in ("site.json", "kept.gpkg", "first.survey.npz"))
    write_site(Site("Inner reef", 54.9, 8.3, heading_deg=20.0), site)
    run = flown(folder, f"--world {BEFORE} --site {site}")
    assert run_command(f"survey add {run} --archive {archive} --save {file} --json".split()) == 0
    return Surveyed(run, file, archive, site)


@pytest.fixture(scope="module")
def again(surveyed: Surveyed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of a mission a year on that plans with it, and has no site: what it saw is not kept."""
    out = tmp_path_factory.mktemp("again")
    return flown(out, f"--world {LATER} --from-survey 1 --archive {surveyed.archive}")


@pytest.mark.rare
def test_a_simulated_year_is_a_year_between_two_surveys(
    surveyed: Surveyed, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    run, archive = flown(tmp_path, f"--world {LATER} --site {surveyed.site}"), tmp_path / "kept.gpkg"
    shutil.copyfile(surveyed.archive, archive)
    later = measure(run)
    assert read_config(run).years_on == later.years_on == 1.0
    flown_at = read_config(run).began
    assert flown_at is not None
    assert abs(later.began - flown_at - timedelta(days=365.25)) < timedelta(seconds=1)
    assert files.read(surveyed.file).years_on == 0.0
    capsys.readouterr()
    assert run_command(f"survey add {run} --archive {archive}".split()) == 0
    assert "still to come" not in caplog.text
    world, first = (words.split()[0] for words in (LATER, BEFORE))
    assert f"Simulated: world {world}, seed 1, one year after {first}\n" in capsys.readouterr().out
    assert run_command(f"survey list --archive {archive} --json".split()) == 0
    years = [one["began"][:4] for one in json.loads(capsys.readouterr().out)["surveys"]]
    assert int(years[1]) == int(years[0]) + 1
    assert "one year after it was flown" in dict(facts(later))["Began"]


def flown(out: Path, words: str, steps: int = STEPS) -> Path:
    """The folder of a short mission."""
    assert (
        run_command(f"run {words} --protocol dream-v1 --max-steps {steps} --out {out}/runs --json".split())
        == 0
    )
    return out / "runs" / (out / "runs/latest").readlink()


def decided(run: Path) -> list[tuple[float, float, str]]:
    """What was decided, and what the planner held of the ground then."""
    return [
        (step.decision.turn, step.decision.advance, step.reasoning.distribution) for step in read_steps(run)
    ]


def told(run: Path) -> dict[str, Any]:
    """What its config says of the earlier survey."""
    return dict((read_config(run).model_extra or {})["from_survey"])


def complaint(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a command fails with."""
    capsys.readouterr()
    assert run_command(words.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


def test_its_words_name_the_survey_and_its_age_and_the_run_keeps_what_it_was_told(
    surveyed: Surveyed, again: Path
) -> None:
    kept, survey = told(again), files.read(surveyed.file)
    assert (kept["given"], kept["source"], kept["years"]) == ("1", surveyed.run.name, pytest.approx(1.0))
    assert kept["seen_m2"] == pytest.approx(DREAM_V1.cell**2 * np.count_nonzero(survey.layers.state), abs=0.1)
    words = [said for *_, said in decided(again)[4:]]
    assert len(words) == STEPS - 3
    assert all(f"The survey {surveyed.run.name}, 1.0 years old, is believed to" in said for said in words)
    with np.load(again / "prior.npz") as prior:
        np.testing.assert_array_equal(prior["target"], survey.layers.target_probability)
        np.testing.assert_array_equal(prior["solid"], np.isin(survey.layers.state, (3, 4)))


@pytest.mark.rare
@pytest.mark.parametrize("what", ["run", "file"])
def test_a_survey_is_the_same_by_its_run_or_its_file_as_by_its_number(
    what: str, surveyed: Surveyed, again: Path, tmp_path: Path
) -> None:
    given = getattr(surveyed, what)
    run = flown(tmp_path, f"--world {LATER} --from-survey {given}")
    assert told(run) == {**told(again), "given": str(given)}
    assert decided(run) == decided(again)
    with np.load(run / "prior.npz") as one, np.load(again / "prior.npz") as other:
        np.testing.assert_array_equal(one["target"], other["target"])


def test_the_number_is_looked_up_in_the_archive_that_is_named_else_in_that_of_the_environment(
    surveyed: Surveyed, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE, raising=False)
    ask = f"run --world {LATER} --protocol dream-v1 --from-survey 1 --max-steps 1 --out runs"
    assert "surveys.gpkg: expected an archive of surveys, got no file" in complaint(ask, capsys)
    monkeypatch.setenv(VARIABLE, str(surveyed.archive))
    assert run_command(f"{ask} --json".split()) == 0
    error = complaint(f"{ask} --archive there.gpkg", capsys)
    assert "there.gpkg: expected an archive of surveys, got no file" in error


@pytest.mark.rare
@pytest.mark.parametrize("keeping", ["", "--keep-observations"], ids=["flown again", "played back"])
def test_a_replay_decides_as_then_by_what_was_kept_of_the_survey(
    keeping: str, surveyed: Surveyed, again: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "flown"
    if keeping:
        run = flown(tmp_path, f"--world {LATER} --from-survey {surveyed.file} {keeping}")
    else:
        shutil.copytree(again, run)
    capsys.readouterr()
    assert run_command(f"replay {run} --out {tmp_path}/replayed --json".split()) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["from"] == ("observations" if keeping else "simulator")
    assert (said["agree"], said["first_difference"]) == (STEPS, None)
    replayed = tmp_path / "replayed" / (tmp_path / "replayed/latest").readlink()
    assert decided(replayed) == decided(run)
    # A replay can be replayed.
    if not keeping:
        assert run_command(f"replay {replayed} --json".split()) == 0
        assert json.loads(capsys.readouterr().out)["agree"] == STEPS
    # With another survey in its place it says otherwise.
    with np.load(run / "prior.npz") as kept:
        bare, solid = np.where(np.isnan(kept["target"]), np.nan, 0.0), kept["solid"]
    np.savez(run / "prior.npz", target=bare, solid=solid)
    run_command(f"replay {run} --out {tmp_path}/otherwise --json".split())
    otherwise = tmp_path / "otherwise" / (tmp_path / "otherwise/latest").readlink()
    assert decided(otherwise)[4] != decided(run)[4]


def test_a_replay_without_what_the_run_was_told_says_so(
    again: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(again, tmp_path / "flown")
    kept = tmp_path / "flown/prior.npz"
    whole = kept.read_bytes()
    kept.write_bytes(whole[:200])
    assert f"{kept}: expected what a mission was told" in complaint(f"replay {tmp_path}/flown", capsys)
    kept.unlink()
    error = complaint(f"replay {tmp_path}/flown", capsys)
    assert f"{kept}: expected what the mission was told of an earlier survey, got no file" in error


def test_a_planner_that_cannot_use_a_survey_says_so_and_flies_as_without(
    surveyed: Surveyed, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    paths = []
    for name, more in (("without", ""), ("with", f"--from-survey {surveyed.file}")):
        caplog.clear()
        paths.append(
            [move[:2] for move in decided(flown(tmp_path / name, f"frontier --world {LATER} {more}"))]
        )
        doubt = "--from-survey: frontier cannot use it and flies as without it"
        assert (doubt in caplog.messages) == bool(more)
    assert paths[0] == paths[1]


def test_how_the_two_frames_were_brought_together_is_told(
    surveyed: Surveyed, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ask = f"--world {LATER} --from-survey {surveyed.file}"
    flown(tmp_path, ask, steps=1)
    assert (
        f"the frames of {surveyed.run.name} and of the mission are taken as equal: one of the two does"
        in (caplog.text)
    )
    caplog.clear()
    write_site(Site(" inner REEF", 54.9, 8.3, heading_deg=30.0), tmp_path / "turned.json")
    flown(tmp_path, f"{ask} --site {tmp_path}/turned.json", steps=1)
    assert f"{surveyed.run.name} is shifted by 0.0 m and turned by 10.0° to where the mission" in caplog.text


@pytest.mark.parametrize(
    ("given", "site", "expected"),
    [
        (
            "1",
            "other.json",
            "expected a survey of 'Other reef', where the mission is, got one of 'Inner reef'",
        ),
        ("1", "far.json", "expected a survey of this place, got one whose origin is 11.1 km away"),
        ("1", "beside.json", "expected a survey of this area, got"),
        ("7", "", "expected the number of a survey in it, got 7. There are: 1."),
        (
            "nothing",
            "",
            "nothing: expected the number of a survey in the archive, its file, or the folder of",
        ),
        ("damaged.survey.npz", "", "damaged.survey.npz: expected the file of a survey, got a damaged"),
        (".", "", "expected a run folder, got no config.json"),
        ("wreck.survey.npz", "", "expected a survey of oysters, got one of wreck"),
    ],
)
def test_what_cannot_be_planned_with_is_said_in_one_line_and_nothing_is_flown(
    given: str,
    site: str,
    expected: str,
    surveyed: Surveyed,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_site(Site("Other reef", 54.9, 8.3), tmp_path / "other.json")
    write_site(Site("Inner reef", 55.0, 8.3), tmp_path / "far.json")
    write_site(Site("Inner reef", 54.91, 8.3), tmp_path / "beside.json")
    (tmp_path / "damaged.survey.npz").write_bytes(surveyed.file.read_bytes()[:-3000])
    files.write(wreck(), tmp_path / "wreck.survey.npz")
    at = f"--site {site}" if site else ""
    ask = f"run --world {LATER} {at} --from-survey {given} --archive {surveyed.archive} --out runs"
    assert expected in complaint(ask, capsys)
    assert not (tmp_path / "runs").exists()


def test_in_real_water_a_survey_is_as_old_as_the_clock_says(tmp_path: Path) -> None:
    year = timedelta(days=365.25)
    for years in (3.0, -1.0):
        survey = replace(reef(), began=datetime.now(UTC) - years * year)
        files.write(survey, tmp_path / "old.survey.npz")
        ground = Ground(from_survey=str(tmp_path / "old.survey.npz"))
        if years < 0.0:
            with pytest.raises(ValueError, match="expected a survey from before the mission"):
                ground.known(SITE, Belief(), AREA, DREAM_V1, None)
            continue
        prior = ground.known(SITE, Belief(), AREA, DREAM_V1, None).prior
        assert prior is not None
        assert prior.years == pytest.approx(years, abs=0.01)
