"""A planner of one's own: flown from its file, and what is wrong in it told with file and line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from dream.cli import run_command
from dream.errors import MissionAborted, PlannerFailed
from dream.evaluation.runner import simulate
from dream.own_code import own_planner
from dream.protocol import DREAM_V1, POOL_V1
from dream.recording import read_config
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Decision, Mission, Observation

pytestmark = pytest.mark.usefixtures("worlds_are_made_once")

WHOLE = """\
import math
from dataclasses import dataclass
from dream.types import Decision, Reasoning
from beside import SAID

@dataclass(frozen=True, slots=True)
class Circling:
    side: int = 1

    def begin(self, mission):
        return Pilot(self)

@dataclass
class Pilot:
    planner: Circling

    def decide(self, observation, occupancy):
        turn = self.planner.side * math.pi / 6
        return Decision(turn, 1.0, reasoning=Reasoning(action=SAID))
"""
WORLD = ("--world", "flat/empty", "--max-steps", "5", "--protocol", "dream-v1")


def written(folder: Path, text: str = WHOLE) -> Path:
    (folder / "beside.py").write_text("SAID = 'Round and round.'\n")
    path = folder / "my planner.py"
    path.write_text(text)
    return path


@pytest.fixture
def run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[int, str]]:
    monkeypatch.chdir(tmp_path)

    def command(*words: str) -> tuple[int, str]:
        status = run_command(["run", *words, *WORLD, "--out", "runs"])
        said = capsys.readouterr().err.splitlines(keepends=True)
        # Whether something has to be compiled depends on what ran here before.
        return status, "".join(line for line in said if not line.startswith("dream: compiling"))

    return command


def test_a_file_where_a_planners_name_stands_is_flown_with_its_options_and_a_report(
    run: Callable[..., tuple[int, str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path)
    status, said = run(f"./{path.name}", "--side", "-1")
    assert (status, said) == (0, "")
    folder = tmp_path / "runs/latest"
    config = read_config(folder)
    assert config.planner == "my-planner.py"
    assert config.planner_file == "my planner.py"
    assert config.planner_parameters == {"side": -1}
    steps = [json.loads(line) for line in (folder / "steps.jsonl").read_text().splitlines()]
    assert [round(math.degrees(step["decision"]["turn"])) for step in steps[4:]] == [-30, -30]
    assert steps[-1]["reasoning"]["action"] == "Round and round."
    assert "Round and round." in (folder / "report.html").read_text()

    # What a run's folder names is never run: it may be a stranger's.
    assert run_command(["replay", str(folder)]) == 2
    assert "expected one of DREAM, got the file my planner.py" in capsys.readouterr().err
    # The same file, given by the user, decides as then; another is another planner.
    path.write_text(path.read_text().replace("side: int = 1", "side: int = -1"))
    assert run_command(["replay", str(folder), "--planner", path.name]) == 2
    assert "expected a run with its observations" in capsys.readouterr().err


def test_options_may_stand_before_the_file_and_a_file_may_be_an_options_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path)
    for before in (["--seed", "2"], ["--json"], ["--seed=2", "--json"]):
        words = ["run", *before, path.name, *WORLD, "--out", "runs"]
        assert run_command(words) == 0
        assert read_config(tmp_path / "runs/latest").planner == "my-planner.py"
    words = ["run", "lawnmower", "--out", "folder.py", *WORLD]
    assert run_command(words) == 0
    assert read_config(tmp_path / "folder.py/latest").planner == "lawnmower"


def test_the_help_of_a_file_shows_its_own_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["run", str(written(tmp_path)), "--help"]) == 0
    shown = capsys.readouterr().out
    assert "--side N" in shown
    assert "(default: 1)" in shown
    assert "side: int = 1" not in shown, "what a dataclass says of itself where it has no docstring"


def test_what_decided_decides_again(run: Callable[..., tuple[int, str]], tmp_path: Path) -> None:
    path = written(tmp_path)
    assert run(path.name)[0] == 0
    assert run_command(["replay", str(tmp_path / "runs/latest"), "--planner", path.name]) == 0


@pytest.mark.parametrize(
    ("instead", "by", "told"),
    [
        ("import math\n", "import maths\n", "line 1: ModuleNotFoundError: No module named 'maths'"),
        ("    side: int = 1", "    side: int = = 1", "line 8: SyntaxError: invalid syntax"),
        (
            "from beside import SAID",
            "from beside import SAD",
            "line 4: ImportError: cannot import name 'SAD'",
        ),
        ("@dataclass\nclass", "1 / 0\n\nclass", "line 13: ZeroDivisionError: division by zero"),
        ("import math\n", "raise SystemExit(0)\n", "line 1: SystemExit: 0"),
        ("def begin(", "def start(", "expected one class with a method begin(mission), got none"),
        ("class Pilot:", "class Pilot:\n    begin = 1\n    def begin(self): ...", "got Circling, Pilot"),
        ("@dataclass(frozen=True, slots=True)\n", "\n", "line 7: expected a dataclass"),
        ("side: int = 1", "side: int", "line 6: TypeError: Circling.__init__() missing 1 required"),
        ("begin(self, mission)", "begin(self)", "line 10: expected begin(mission), got begin()"),
        ("begin(self, mission)", "begin(self, a, b)", "line 10: expected begin(mission), got begin(a, b)"),
        (
            "return Pilot(self)",
            "return None",
            "line 10: expected a pilot with decide(observation, occupancy), got",
        ),
        ("return Pilot(self)", "return Pilot()", "line 11: begin: TypeError: Pilot.__init__() missing 1"),
        ("decide(self, observation, occupancy)", "decide(self, observation)", "line 17: expected decide(obs"),
        ("decide(", "choose(", "expected a pilot with decide(observation, occupancy), got a Pilot"),
    ],
)
def test_what_cannot_fly_is_told_with_file_and_line_before_there_is_a_folder(
    instead: str, by: str, told: str, run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    assert instead in WHOLE
    path = written(tmp_path, WHOLE.replace(instead, by, 1))
    status, said = run(path.name)
    assert status == 1
    assert said.startswith("dream: my planner.py")
    assert told in said
    assert said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("decides", "told"),
    [
        ("1 / 0", "line 19: step 4: ZeroDivisionError: division by zero"),
        ("observation.rgbd", "line 19: step 4: AttributeError: 'Observation' object has no attribute 'rgbd'"),
        ("(lambda: [][3])()", "line 19: step 4: IndexError: list index out of range"),
        ("Decision(math.nan)", "line 19: step 4: ValueError: decision: expected a finite turn"),
        ("Decision(done=True, turn=1.0)", "line 19: step 4: ValueError: decision: done stays"),
        ("Decision('left')", "line 19: step 4: TypeError: must be real number, not str"),
        (
            "None",
            "line 17: step 4: expected a Decision with a turn of 0, ±30, ±60, ±90 or 180° and an advance",
        ),
        ("(0.5, 1.0)", "or 2 m (dream-v1), got a tuple"),
        ("Decision(math.pi / 4)", "got a turn of 45° and an advance of 0 m"),
        ("Decision(30.0)", "an advance of 0 m. A turn is in radians: math.radians(30)"),
        ("Decision(0.0, 1.5)", "got a turn of 0° and an advance of 1.5 m"),
        ("Decision(0.0, 1.0, reasoning='on')", "got as reasoning a str, not a Reasoning"),
        ("Decision(0.0, 1.0, done='no')", "decision: done stays where it is"),
        ("Decision(reasoning=Reasoning(action=3))", "got as reasoning.action a int, not a str"),
        ("Decision(waited=math.inf)", "got waited=inf, which is no finite float"),
        ("Decision(__import__('numpy').float32(0.0))", "which is no finite float but a float32"),
    ],
)
def test_a_decision_that_fails_or_is_off_the_protocol_is_refused_when_it_is_made(
    decides: str, told: str, tmp_path: Path, empty_world: World
) -> None:
    path = written(tmp_path, WHOLE.replace("Decision(turn, 1.0, reasoning=Reasoning(action=SAID))", decides))
    steps = simulate(empty_world, own_planner(path), DREAM_V1, max_steps=6)
    flown: list[int] = []
    with pytest.raises(PlannerFailed) as failed:
        flown.extend(step.index for step in steps)
    assert flown == [0, 1, 2, 3]
    assert "my planner.py, line " in str(failed.value)
    assert told in str(failed.value)
    assert len(str(failed.value)) < 500


def test_a_run_that_fails_keeps_what_was_flown(run: Callable[..., tuple[int, str]], tmp_path: Path) -> None:
    path = written(tmp_path, WHOLE.replace("Decision(turn, 1.0", "Decision(turn, 1.25"))
    status, said = run(path.name)
    assert status == 1
    assert said.startswith("dream: aborted: my planner.py, line 17: step 4: expected a Decision with a turn")
    assert "3 steps are kept in runs/" in said


def test_other_rules_allow_other_decisions(tmp_path: Path) -> None:
    path = written(tmp_path, WHOLE.replace("Decision(turn, 1.0", "Decision(math.pi / 12, 0.2"))
    world = make_world("pool/arc", 1)
    assert len(list(simulate(world, own_planner(path), POOL_V1, max_steps=5))) == 6
    path.write_text(path.read_text().replace("0.2, reason", "0.15, reason"))
    with pytest.raises(
        PlannerFailed, match=r"or 0\.2 m \(pool-v1\), got a turn of 15° and an advance of 0\.15 m"
    ):
        list(simulate(world, own_planner(path), POOL_V1, max_steps=5))


@pytest.mark.parametrize("missing", ["nowhere.py", "runs/nowhere.py", "."])
def test_a_file_that_is_not_there_is_told(missing: str, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no file"):
        own_planner(tmp_path / missing)


def test_one_that_aborts_says_so_itself(empty_world: World) -> None:
    class Aborts:
        def begin(self, mission: Mission) -> Aborts:
            return self

        def decide(self, observation: Observation, occupancy: object) -> Decision:
            raise MissionAborted("enough")

    with pytest.raises(MissionAborted, match=r"^enough$"):
        list(simulate(empty_world, Aborts(), DREAM_V1, max_steps=4))
