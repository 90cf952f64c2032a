"""`dream replay` and `dream export`: a recorded run again, and a recorded dive for others."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from dream.cli import run_command
from dream.planning import Belief, NearestFrontier, SixSteps
from dream.planning.baselines.uivnav import SHIPPED
from dream.recording import read_config, read_steps, read_summary
from dream.robots.bluerov2.navigation import ESTIMATORS
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND
from tests.robots.bluerov2.test_estimates import SECONDS, dived, true_pose

STEPS = 7
ASKED = LOOK_AROUND + 2
"""Steps of a run whose planner asks a model twice."""


def fly(out: Path, *words: str, steps: int = STEPS) -> Path:
    """A run's folder."""
    command = ["run", "--world", "pool/arc", "--max-steps", str(steps), "--json", "--out", str(out)]
    assert run_command([*command, *words]) == 0
    return (out / "latest").resolve()


@pytest.fixture(scope="module")
def kept_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fly(tmp_path_factory.mktemp("kept"), "--keep-observations")


@pytest.fixture(scope="module")
def plain_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fly(tmp_path_factory.mktemp("plain"))


@pytest.fixture
def run(kept_run: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(kept_run, tmp_path / "run"))


def replay(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, dict[str, Any]]:
    """Exit status, and what was told."""
    capsys.readouterr()
    status = run_command(["replay", *map(str, words), "--json"])
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return status, told


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line in which bad input was told."""
    capsys.readouterr()
    assert run_command([*map(str, words)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def change(path: Path, how: Callable[[dict[str, Any]], object], line: int = 0) -> None:
    """Change a line of a file of JSON; all of a file with one object."""
    whole = path.suffix == ".json"
    lines = [path.read_text()] if whole else path.read_text().splitlines()
    fields = json.loads(lines[line])
    how(fields)
    lines[line] = json.dumps(fields)
    path.write_text("\n".join(lines) + "\n")


def as_dive(run: Path, **told: Any) -> None:
    """Make a run one of a stand-in, as far as its folder tells; or of a vehicle in real water."""
    told = {"stand_in": True, "estimator": "inekf", **told}
    change(run / "config.json", lambda config: config.update(dive=told))


@pytest.mark.rare
@pytest.mark.parametrize("which", ["kept_run", "plain_run"])
def test_the_same_code_decides_the_same(
    which: str, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    run: Path = request.getfixturevalue(which)
    before = sorted(path for path in run.rglob("*"))
    status, told = replay(capsys, run)
    assert status == 0
    assert told == {
        "run": str(run),
        "planner": "belief",
        "same_planner": True,
        "from": "observations" if which == "kept_run" else "simulator",
        "steps": STEPS,
        "agree": STEPS,
        "first_difference": None,
        "farthest_m": 0.0,
        "farthest_deg": 0.0,
        "estimates": None,
        "report": None,
    }
    assert sorted(path for path in run.rglob("*")) == before
    assert run_command(["replay", str(run)]) == 0
    printed = capsys.readouterr().out
    assert f"{STEPS} of {STEPS} decisions agree" in printed
    assert ("played back" in printed) is (which == "kept_run")


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("field", "value", "how"),
    [
        ("decision", {"turn": 0.25, "advance": 0.1, "done": False}, "then to turn +14° and advance 0.1 m"),
        ("decision", {"turn": 0.0, "advance": 0.0, "done": True}, "then to be done"),
        ("guarded", {"turn": 0.0, "advance": 0.0, "note": ""}, "the guard let it turn +90°, then stay"),
        ("ended", "cap", "the mission went on, then it ended for want of steps"),
    ],
)
def test_a_step_that_was_tampered_with_is_found(
    field: str, value: Any, how: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(run / "steps.jsonl", lambda step: step.update({field: value}), line=2)
    status, told = replay(capsys, run)
    assert (status, told["agree"]) == (1, STEPS - 1)
    assert told["first_difference"]["step"] == 2
    assert how in told["first_difference"]["how"]


def test_a_place_that_differs_is_told(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def move(step: dict[str, Any]) -> None:
        step["pose"]["x"] += 0.3
        step["pose"]["y"] -= 0.4
        step["pose"]["yaw"] += 0.1

    change(run / "steps.jsonl", move, line=2)
    status, told = replay(capsys, run)
    assert (status, told["agree"], told["first_difference"]) == (0, STEPS, None)
    assert (told["farthest_m"], told["farthest_deg"]) == pytest.approx((0.5, math.degrees(0.1)))
    assert run_command(["replay", str(run)]) == 0
    assert "it came up to 0.5 m and 5.7° from where it came then" in capsys.readouterr().out


def test_other_parameters_than_those_of_then_are_found(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def become_frontier(config: dict[str, Any]) -> None:
        config.update(planner="frontier", planner_parameters={"approach": 0.5, "smallest": 0.3})

    change(run / "config.json", become_frontier)
    status, told = replay(capsys, run)
    assert (status, told["planner"], told["same_planner"]) == (1, "frontier", True)
    assert told["first_difference"]["step"] > 3
    assert run_command(["replay", str(run)]) == 1
    printed = capsys.readouterr().out
    assert f"the first that differs is step {told['first_difference']['step']}: decided to" in printed
    assert "flown by 0." in printed


def test_another_planner_is_asked_in_the_same_places(
    kept_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, told = replay(capsys, kept_run, "--planner", "frontier")
    assert (status, told["same_planner"], told["planner"]) == (0, False, "frontier")
    assert 3 <= told["agree"] < STEPS
    assert told["first_difference"]["step"] > 3  # All missions begin with the look-around.
    assert replay(capsys, kept_run, "--planner", "belief")[1]["same_planner"] is True
    assert run_command(["replay", str(kept_run), "--planner", "frontier"]) == 0
    assert "by frontier in the place of belief" in capsys.readouterr().out


def test_another_planner_needs_observations(plain_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "replay", plain_run, "--planner", "frontier")
    assert "Say: dream run frontier --world pool/arc --seed 1" in said


def test_a_run_that_was_broken_off_is_replayed_as_far_as_it_went(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (run / "steps.jsonl").read_text().splitlines()
    (run / "steps.jsonl").write_text("\n".join(lines[:-2]) + "\n")
    assert replay(capsys, run)[1]["agree"] == STEPS - 2
    shutil.rmtree(run / "observations")
    status, told = replay(capsys, run)
    assert (status, told["agree"], told["from"]) == (0, STEPS - 2, "simulator")


def test_a_replay_is_recorded_where_one_asks_for_it(
    kept_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, told = replay(capsys, kept_run, "--out", tmp_path / "again")
    again = (tmp_path / "again" / "latest").resolve()
    assert status == 0
    assert Path(told["report"]).resolve() == again / "report.html"
    assert "<html" in (again / "report.html").read_text()[:200]
    one, other = read_steps(kept_run), read_steps(again)
    timed = {"planner_ms"}
    assert [s.model_dump(exclude=timed) for s in one] == [s.model_dump(exclude=timed) for s in other]
    assert read_config(again).model_extra is not None
    assert read_config(again).model_dump()["replay_of"] == str(kept_run)
    began, anew = read_config(kept_run).began, read_config(again).began
    assert began is not None
    assert anew is not None
    assert began < anew <= datetime.now(UTC)
    assert kept_run.name.startswith(f"{began:%Y-%m-%dT%H-%M-%S}_")
    before, after = read_summary(kept_run), read_summary(again)
    assert before is not None
    assert after is not None
    assert after.coverage == before.coverage
    # It says all that a run says, and so can be flown again itself.
    assert replay(capsys, again)[1]["agree"] == STEPS


def test_orders_are_obeyed_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    leg = {"task": "map", "target": "any", "area": "side", "box": None, "side": "west", "of_leg": None}
    orders = json.dumps({"legs": [leg], "max_steps": 5})
    run = fly(tmp_path, "--keep-observations", "--mission", orders)
    status, told = replay(capsys, run)
    assert (status, told["steps"], told["agree"]) == (0, 5, 5)


def test_a_tether_holds_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = fly(tmp_path, "--tether-m", "3", "--return", "start", steps=12)
    summary, steps = read_summary(run), read_steps(run)
    assert summary is not None
    assert summary.ended == "returned"
    status, told = replay(capsys, run)
    assert (status, told["steps"], told["agree"]) == (0, len(steps) - 1, len(steps) - 1)


@pytest.mark.rare
def test_a_run_of_a_model_is_answered_from_what_was_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "replies"
    asks = ["vanilla", "--model", "wire", "--record", str(kept)]
    run = fly(tmp_path, *asks, "--keep-observations", steps=ASKED)
    files = {path: path.read_bytes() for path in kept.rglob("*.json")}
    assert files
    assert replay(capsys, run, "--replay-replies", kept)[1]["agree"] == ASKED
    # The stand-in answers by rule, and is asked again.
    assert replay(capsys, run)[1]["agree"] == ASKED
    assert {path: path.read_bytes() for path in kept.rglob("*.json")} == files
    other = {"model": "openai:gpt-5", "record": None}
    change(run / "config.json", lambda config: config["planner_parameters"].update(other))
    said = refused(capsys, "replay", run)
    assert "expected the folder of what openai:gpt-5 answered, got none" in said


def test_another_network_under_the_same_name_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("onnxruntime")
    network = Path(shutil.copy(SHIPPED, tmp_path / "mine.onnx"))
    run = fly(tmp_path / "runs", "uivnav", "--weights", str(network), "--keep-observations")
    kept = read_config(run).weights_sha256
    assert kept == hashlib.sha256(network.read_bytes()).hexdigest()
    assert replay(capsys, run)[1]["agree"] == STEPS
    network.write_bytes(network.read_bytes() + b"\0")
    assert f"whose SHA-256 is {kept[:12]}..., got" in refused(capsys, "replay", run)
    network.unlink()
    assert f"weights: expected the path of an ONNX file, got {network}" in refused(capsys, "replay", run)
    # Who decides anew asks no network of then.
    assert replay(capsys, run, "--planner", "lawnmower")[1]["planner"] == "lawnmower"


@pytest.mark.rare
def test_another_prompt_under_the_same_name_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (own := tmp_path / "own").mkdir()
    (own / "dream.md").write_text("version: 2\n\n$mission $legend")
    asks = ["dream", "--model", "wire", "--prompts", str(own)]
    run = fly(tmp_path / "runs", *asks, "--keep-observations", steps=ASKED)
    kept = read_config(run).prompts_sha256
    assert replay(capsys, run)[1]["agree"] == ASKED
    (own / "dream.md").write_text("version: 2\n\n$mission Be quick. $legend")
    assert f"the dream.md of then, whose SHA-256 is {kept['dream'][:12]}..., got" in refused(
        capsys, "replay", run
    )


@pytest.mark.parametrize(
    ("harm", "complaint"),
    [
        (lambda run: (run / "steps.jsonl").unlink(), "expected a run folder, got no steps.jsonl in it"),
        (lambda run: (run / "config.json").unlink(), "expected a run folder, got no config.json in it"),
        (lambda run: (run / "steps.jsonl").write_text(""), "expected at least the first look, got no step"),
        (lambda run: (run / "steps.jsonl").write_text("{}\n{}\n"), "line 1: step: Field required"),
        (lambda run: (run / "config.json").write_text("{"), "expected one JSON object, got damaged text"),
        (lambda run: (run / "observations" / "0003.npz").unlink(), "expected 0003.npz before it"),
        (
            lambda run: (run / "observations" / "0007.npz").unlink(),
            "after 7 moves, got 6. Are the last files",
        ),
        (
            lambda run: (run / "observations" / "0002.npz").write_bytes(b"PK"),
            "0002.npz: expected what was seen",
        ),
        (
            lambda run: change(run / "config.json", lambda c: c["planner_parameters"].update(courage=1.0)),
            "expected the parameters of belief, got others",
        ),
        (
            lambda run: change(run / "config.json", lambda c: c["planner_parameters"].update(risk=7.0)),
            "risk: expected 0 to 1, got 7",
        ),
        (
            lambda run: change(run / "config.json", lambda c: c.update(world="pool/ark")),
            'no world "pool/ark"',
        ),
        (
            lambda run: change(run / "config.json", lambda c: c.update(world_hash="0" * 64)),
            "expected the world pool/arc of then, got another under its name",
        ),
        (
            lambda run: change(run / "steps.jsonl", lambda s: s.update(step=8), line=7),
            "expected step 7, got 8",
        ),
    ],
)
def test_what_is_damaged_is_named(
    harm: Callable[[Path], object], complaint: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(run / "config.json", lambda config: config.update(world_from=None))
    harm(run)
    assert complaint in refused(capsys, "replay", run)


class TestDives:
    """Folders as a dive leaves them."""

    @pytest.mark.rare
    def test_all_estimators_reckon_the_way_anew(self, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
        as_dive(run)
        dived(run)
        # As if the mission had gone along the circle of the log, and the truth were known.
        for line in range(1, STEPS + 1):
            time = 0.5 * line
            pose = true_pose(time).se2
            truth = {"x": pose.x, "y": pose.y + 1.0, "yaw": pose.yaw}
            change(run / "steps.jsonl", partial(dict.update, time=time, truth=truth), line)
        status, told = replay(capsys, run)
        assert (status, told["agree"]) == (0, STEPS)
        estimates = told["estimates"]
        assert (estimates["flown_with"], estimates["compared"]) == ("inekf", round(10 * SECONDS))
        for name in ESTIMATORS:
            assert estimates[name]["from_dive"]["most"] < 0.05
            assert estimates[name]["from_truth"]["rmse"] == pytest.approx(1.0, abs=0.05)
        assert estimates["inekf"]["from_dive"]["most"] == 0.0
        assert run_command(["replay", str(run)]) == 0
        rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
        assert [row[0] for row in rows] == ["estimator", *ESTIMATORS]
        assert rows[1][1:4] == ["(flown)", "the", "same"]

    def test_one_estimator_or_none(self, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
        as_dive(run)
        said = refused(capsys, "replay", run, "--estimator", "cipg")
        assert "--estimator: expected a dive with its log.mcap" in said
        dived(run)
        told = replay(capsys, run, "--estimator", "cipg")[1]["estimates"]
        assert set(told) == {"flown_with", "compared", "cipg"}
        assert told["cipg"]["from_truth"] is None
        assert replay(capsys, run, "--estimator", "none")[1]["estimates"] is None
        (run / "log.mcap").write_bytes(b"SQLite format 3")
        assert "expected an MCAP file" in refused(capsys, "replay", run)

    @pytest.mark.rare
    @pytest.mark.parametrize("kept", [0, 300, 20_000])
    def test_a_log_that_is_torn_costs_no_more_than_its_estimates(
        self, kept: int, run: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
    ) -> None:
        as_dive(run)
        whole = dived(run).read_bytes()
        (run / "log.mcap").write_bytes(whole[:kept].ljust(len(whole), b"\0"))
        status, told = replay(capsys, run)
        assert (status, told["agree"]) == (0, STEPS)
        assert (told["estimates"] is None) == ("no estimate is made again" in caplog.text)
        assert "is read as far as it goes" in caplog.text

    def test_a_dive_in_real_water(
        self, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        bounds = make_world("pool/arc", 1).bounds
        area = [bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max]
        as_dive(run, stand_in=False, area=area)
        change(
            run / "config.json", lambda config: config.update(world="dive", world_from=None, world_hash="")
        )
        status, told = replay(capsys, run, "--out", tmp_path / "again")
        assert (status, told["agree"]) == (0, STEPS)
        summary = read_summary(Path(told["report"]).parent)
        assert summary is not None
        assert summary.success is None
        as_dive(run, stand_in=False, area=[1.0])
        assert "dive.area: expected four numbers, got [1.0]" in refused(capsys, "replay", run)

    def test_a_dive_is_not_flown_again(self, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
        as_dive(run)
        shutil.rmtree(run / "observations")
        assert "expected a run with its observations" in refused(capsys, "replay", run)


class TestExport:
    """What others get."""

    def test_a_run_becomes_a_data_set(
        self, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        to = tmp_path / "set"
        words = ["--title", "A tank", "--licence", "CC-BY-4.0", "--authors", "Ada <ada@example.org>", "Bob"]
        as_dive(run)
        dived(run)
        capsys.readouterr()
        assert run_command(["export", str(run), "--to", str(to), *words, "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        frames = STEPS + 1
        assert told | {"bytes": 0} == {
            "run": str(run),
            "to": str(to),
            "frames": frames,
            "decisions": frames,
            "bytes": 0,
        }
        assert told["bytes"] == sum(path.stat().st_size for path in to.rglob("*") if path.is_file())
        page = (to / "README.md").read_text()
        assert 'license: "CC-BY-4.0"' in page
        assert "Authors: Ada <ada@example.org>, Bob" in page
        assert "Simulated: world pool/arc, seed 1, protocol pool-v1." in page
        assert "clock of the dive was 0: 2001-09-09T01:46:40+00:00" in page  # 10⁹ seconds after 1970.
        decided = [json.loads(line) for line in (to / "decisions.jsonl").read_text().splitlines()]
        assert [line["decision"] for line in decided] == [s.decision.model_dump() for s in read_steps(run)]
        assert "expected a folder that does not exist" in refused(
            capsys, "export", run, "--to", to, "--title", "A tank"
        )

    def test_no_dive_in_real_water_is_called_simulated(self, run: Path, tmp_path: Path) -> None:
        as_dive(run, stand_in=False)
        assert run_command(["export", str(run), "--to", str(tmp_path / "set"), "--title", "A tank"]) == 0
        page = (tmp_path / "set" / "README.md").read_text()
        assert "Simulated" not in page
        assert "clock of the dive was 0: not given" in page

    def test_broken_off_it_goes_on(
        self, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        words = ["export", str(run), "--to", str(tmp_path / "set"), "--title", "A tank"]
        from dream.robots.bluerov2 import dataset

        real, wrote = dataset._replace, []

        def interrupted(path: Path, content: bytes) -> None:
            wrote.append(path)
            if len(wrote) == 9:
                raise KeyboardInterrupt
            real(path, content)

        monkeypatch.setattr(dataset, "_replace", interrupted)
        assert run_command(words) == 1
        assert "interrupted" in capsys.readouterr().err
        assert not (tmp_path / "set").exists()
        first, wrote[:] = set(wrote[:-1]), [Path()] * 9
        assert run_command(words) == 0
        pictures = {path for path in first if path.suffix == ".png"}
        assert pictures
        assert not pictures & set(wrote)

    @pytest.mark.rare
    def test_bad_input_is_told_in_a_line(
        self, plain_run: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        ask = ["--to", tmp_path / "set", "--title"]
        assert "expected a dive with its observations" in refused(capsys, "export", plain_run, *ask, "A tank")
        assert "expected a run folder" in refused(capsys, "export", tmp_path, *ask, "A tank")
        assert "title: expected the name of the data set" in refused(capsys, "export", run, *ask, " ")
        assert "--title" in refused(capsys, "export", run, "--to", tmp_path / "set")
        nowhere = ["export", run, "--to", "/dev/null/set", "--title", "A tank"]
        assert "expected a place that can be written" in refused(capsys, *nowhere)
        (run / "observations" / "0002.npz").write_bytes(b"PK")
        assert "0002.npz: expected what was seen" in refused(capsys, "export", run, *ask, "A tank")


def test_who_decided_is_told_by_name_and_parameters(kept_run: Path) -> None:
    from dream.evaluation.again import read_record

    record = read_record(kept_run)
    assert record.planner == Belief()
    assert record.was_flown_by(Belief())
    assert not record.was_flown_by(Belief(risk=0.5))
    assert not record.was_flown_by(SixSteps())
    assert not record.was_flown_by(NearestFrontier())
