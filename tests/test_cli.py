"""The command line: what it prints, how it fails, with which status."""

from __future__ import annotations

import collections
import contextlib
import errno
import hashlib
import itertools
import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import tyro
from numba import njit
from numba.core.event import trigger_event

from dream import commands
from dream.cli import COMMANDS, run_command
from dream.commands.console import check_max_steps, kept_interrupts
from dream.compiling import COMPILES
from dream.evaluation import runner
from dream.evaluation.locks import alone_at
from dream.evaluation.oracle import bounds as bounds_module
from dream.evaluation.oracle.bounds import OracleBounds
from dream.evaluation.results import read_results
from dream.evaluation.runner import simulate
from dream.evaluation.suites import SUITES, Case
from dream.extras import how_to_add, missing
from dream.planning import PLANNERS
from dream.protocol import DREAM_V1, DREAM_V1_NAV
from dream.recording import read_config, read_exchanges, read_steps, read_summary
from dream.robots import Teleport
from dream.robots.swimming import read_swimming
from dream.sim.worlds import WORLDS, make_world
from dream.types import Arrival, Observation, Setpoint
from tests.engines import InProcess
from tests.model_server import NAME, Answer, Request, Response, error, fitting, says, serving
from tests.recorded_runs import Disk

pytestmark = pytest.mark.usefixtures("worlds_are_made_once")

PLANE = ("--protocol", "dream-v1")
SUMMARY_KEYS = {
    *("protocol", "world", "seed", "world_hash", "planner", "ended", "steps", "t_stop", "t_claimed"),
    *("t90", "t95", "t98", "t100", "coverage", "collisions", "distance_m", "turns", "min_clearance_m"),
    *("planner_ms", "wall_s", "mission_s", "vlm", "success"),
}

MADE_UP = {"lower_bound": 4, "best_tour": 4, "status": "optimal", "tour": [0]}
"""Of a world that shows all there is at the first look."""


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["--help"]) == 0
    printed = capsys.readouterr().out
    for command in COMMANDS:
        assert f"  {command} " in printed


SUBCOMMANDS = ("add", "list", "show", "remove", "compare", "export")
SEALING = ("new", "show", "open", "check")
NETWORKS = ("sight", "uivnav")
PAGES = [
    *([command] for command in COMMANDS),
    *(["survey", subcommand] for subcommand in SUBCOMMANDS),
    *(["seal", subcommand] for subcommand in SEALING),
    *(["train", network] for network in NETWORKS),
    *(["run", planner] for planner in PLANNERS),
    ["dive", "belief"],
]
"""What `--help` may be asked of."""


def _help(words: list[str], option: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    assert run_command([*words, option]) == 0
    return capsys.readouterr().out.splitlines()


@pytest.fixture
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.usefixtures("narrow")
@pytest.mark.parametrize("words", [[], *PAGES], ids=" ".join)
def test_help_fits_a_screen(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    lines = _help(words, "--help", capsys)
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80


@pytest.mark.usefixtures("narrow")
@pytest.mark.parametrize("option", ["--help", "--help-all"])
@pytest.mark.parametrize("words", PAGES, ids=" ".join)
def test_help_is_in_words(words: list[str], option: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = _help(words, option, capsys)
    text = " ".join(" ".join(lines).split())
    riddles = r"None\}|default: (None|False|True)\)|source subcommand|\.\.\. (\(|on )|VALUE|come back to"
    assert re.search(riddles, text) is None


@pytest.mark.parametrize("words", PAGES, ids=" ".join)
def test_every_option_is_explained_in_sentences(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.commands.help.WIDEST", 10_000)
    monkeypatch.setenv("COLUMNS", "10000")
    lines = _help(words, "--help-all", capsys)
    options = itertools.takewhile(lambda line: line != "examples", lines)
    # Words too long to stand beside theirs have a line of their own.
    shown = re.sub(r"\n {22}", "  ", "\n".join(options))
    for line in re.findall(r"^  (?:--|\[?[A-Z]{3,}).*$", shown, re.MULTILINE):
        told = re.sub(r" \((default: .*|required)\)$", "", line)
        assert re.search(r"  [A-Z`x0-9r].*[.\"]$", told), line


@pytest.mark.parametrize(
    "words", [words for words in PAGES if words not in (["survey"], ["seal"], ["train"])], ids=" ".join
)
def test_help_all_shows_what_the_command_takes(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = _help(words, "--help-all", capsys)
    shown = {found[1] for line in lines if (found := re.match(r"  (--[a-z][a-z-]*)", line))}
    # Asked for a page by tyro itself, which reads the same classes in its own way.
    marks = (tyro.conf.CascadeSubcommandArgs, tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)
    config = (*marks, tyro.conf.FlagCreatePairsOff)
    with pytest.raises(SystemExit):
        tyro.cli(getattr(commands, words[0].capitalize()), args=[*words[1:], "--help"], config=config)
    taken = set(re.findall(r"^(?:[│|] |  )(?:-h, )?(--[a-z][a-z-]*)", capsys.readouterr().out, re.MULTILINE))
    assert "--json" in shown
    assert shown == taken - {"--help"}


@pytest.mark.parametrize("words", PAGES, ids=" ".join)
def test_help_shows_first_what_help_all_shows_too(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    first, everything = (_help(words, option, capsys) for option in ("--help", "--help-all"))
    assert {line for line in first if line.startswith("  --")} <= set(everything)
    assert first[-2:] == everything[-2:]


@pytest.mark.parametrize("words", PAGES, ids=" ".join)
def test_the_examples_of_every_page_are_taken(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = _help(words, "--help", capsys)
    examples = [line.strip() for line in lines[lines.index("examples") + 1 :]]
    assert 1 <= len(examples) <= 3
    called: list[object] = []

    def call(self: object) -> int:
        called.append(self)
        return 0

    for name in COMMANDS:
        monkeypatch.setattr(getattr(commands, name.capitalize()), "__call__", call)
    for example in examples:
        program, *arguments = shlex.split(example)
        assert program == "dream"
        assert arguments[: len(words)] == words or words[0] in arguments
        assert run_command(arguments) == 0, capsys.readouterr().err
    assert len(called) == len(examples)


def test_help_of_a_planner_of_ones_own_shows_its_parameters(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = _help(["run", "examples/planner.py"], "--help-all", capsys)
    assert lines[0] == "usage: dream run examples/planner.py [OPTIONS]"
    assert lines[-1] == "  dream run examples/planner.py"
    assert "--world" in "\n".join(lines)


def _options(words: list[str], option: str, capsys: pytest.CaptureFixture[str]) -> set[str]:
    lines = _help(words, option, capsys)
    return {found[1] for line in lines if (found := re.match(r"  (--[a-z][a-z-]*)", line))}


def test_the_page_of_commands_names_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    head, *sections = re.split(
        r"^## dream ", Path("docs/commands.md").read_text(encoding="utf-8"), flags=re.M
    )
    assert set(re.findall(r"--[a-z][a-z-]+", head)) == {"--help", "--help-all", "--json", "--version"}
    assert [section.split("\n", 1)[0] for section in sections] == list(COMMANDS)
    for section in sections:
        name, told = section.split("\n", 1)
        named = set(re.findall(r"--[a-z][a-z-]+", told)) - {"--help", "--help-all"}
        pages = [words for words in PAGES if words[0] == name]
        known = {option for words in pages for option in _options(words, "--help-all", capsys)}
        if name == "export":
            known |= {"--keep-observations"}  # Of `dream run`, as the page says.
        assert named <= known, name
        planners = [[name, planner] for planner in PLANNERS] if name == "run" else []
        first = [words for words in pages if words not in planners and words != ["dive", "belief"]]
        wanted = {option for words in first for option in _options(words, "--help", capsys)}
        assert wanted <= named, name
    assert all(f"`dream survey {subcommand}" in "".join(sections) for subcommand in SUBCOMMANDS)
    assert all(f"`dream seal {subcommand}" in "".join(sections) for subcommand in SEALING)
    assert all(f"`{planner}`" in sections[0] for planner in PLANNERS)


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["--version"]) == 0
    assert re.fullmatch(r"dream \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


@pytest.mark.rare
def test_a_default_that_is_shown_short_is_not_rounded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["run", "--help-all"]) == 0
    assert "1.33333)" in capsys.readouterr().out
    assert run_command(["run", "--max-steps", "1", "--world", "flat/empty", "--out", str(tmp_path)]) == 0
    config = json.loads((tmp_path / "latest" / "config.json").read_text())
    assert config["planner_parameters"] == asdict(PLANNERS["belief"])


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from dream.cli import run_command; run_command(['--help']); "
        "heavy = {'numpy', 'numba', 'scipy', 'tyro', 'pydantic', 'rich', 'PIL'} & set(sys.modules); "
        "sys.exit(' '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_package_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dream", "bench", "paepr"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith('dream: no suite "paepr". Did you mean "paper"?')


def test_more_steps_than_the_protocols_cap_are_flown_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    check_max_steps(DREAM_V1.cap, DREAM_V1)
    check_max_steps(None, DREAM_V1)
    assert capsys.readouterr().err == ""
    check_max_steps(DREAM_V1.cap + 1, DREAM_V1)
    assert capsys.readouterr().err.startswith(
        "dream: 201 steps are more than the cap of dream-v1, 200: not to be"
    )


def test_where_nothing_compiled_can_be_kept_it_says_what_to_set(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.core.caching.CompileResultCacheImpl._locator_classes", [])

    def decorated(command: object) -> None:
        njit(cache=True)(decorated)

    monkeypatch.setattr("dream.commands.worlds.Worlds.__call__", decorated)
    assert run_command(["worlds"]) == 2
    assert capsys.readouterr().err.endswith("Say which: export NUMBA_CACHE_DIR=FOLDER\n")


def test_an_engine_that_is_not_installed_is_told_before_there_is_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    out = tmp_path / "bench"
    assert run_command(["bench", "--world", "flat/empty", "--engine", "ray", "--out", str(out)]) == 2
    assert capsys.readouterr().err == f"dream: {missing('ray', 'ray', '--engine ray')}\n"
    assert not out.exists()


def test_a_planner_that_asks_a_model_is_chosen_and_explained_without_its_client_or_compiler() -> None:
    code = (
        "import sys; from dream import commands; from dream.cli import run_command; "
        "commands.Run.__call__ = lambda run: print(run.planner.model) or 0; "
        "assert run_command(['run', 'dream', '--model', 'wire']) == 0; "
        "assert run_command(['run', 'vanilla', '--help']) == 0; "
        "sys.exit(' '.join({'pydantic_ai', 'openai', 'httpx2', 'numba', 'scipy'} & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("wire\n")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["rnu"], 'no command "rnu". Did you mean "run"?'),
        (["run", "--world", "reef/fringe"], 'no world "reef/fringe". Did you mean "reef/fringing"?'),
        (["run", "--protocol", "dream-v9"], 'no protocol "dream-v9". Did you mean "dream-v2"?'),
        (["run", "--wrold", "reef/L"], "Did you mean --world?"),
        (["run", "--seed", "many"], "dream: --seed: expected a whole number, got many. Add --help"),
        (["run", "--seed", "-1"], "got -1. Choose a whole number between them"),
        (["run", "--max-steps", "1.5"], "dream: --max-steps: expected a whole number, got 1.5. Add --help"),
        (["run", "belief", "--width", "1.5"], "dream: --width: expected a whole number, got 1.5. Add --help"),
        (["run", "belief", "--risk", "2"], "dream: --risk: expected 0 to 1, got 2. Add --help"),
        (["run", "random", "--turn-rate", "x"], "dream: --turn-rate: expected a number, got x. Add --help"),
        (
            ["run", "lawnmower", "--risk", "0.1"],
            "dream: --risk: expected an option of lawnmower, got one of belief. See dream run lawnmower",
        ),
        (
            ["run", "--risk", "0.1", "lawnmower"],
            "--risk: expected an option of lawnmower, got one of belief.",
        ),
        (["run", "--swath", "1", "spiral"], "--swath: expected the planner's name before it, got none."),
        (["run", "--patience", "3", "sixsteps"], "Say: dream run sixsteps --patience ..."),
        (["run", "--max-steps", "0"], "--max-steps: expected at least 1, got 0"),
        (
            ["sweep", "paper", "--max-steps", "201"],
            "--max-steps: expected 1 to 200, the cap of dream-v1-reach4",
        ),
        (["run", "--start", "99"], "start: expected 0 to"),
        (["draw", "--world", "wreck/9"], 'no world "wreck/9". Of wreck/ there are: 1, 2, 3, 4, 5.'),
        (["draw", "--world", "wreck/12"], 'no world "wreck/12". Of wreck/ there are: 1, 2, 3, 4, 5.'),
        (["draw", "--world", "reef/99x"], 'no world "reef/99x". Of reef/ there are: fringing, string,'),
        (["draw", "--world", "reef"], 'no world "reef". Of reef/ there are: fringing, string,'),
        (["draw", "--world", "reef/strin"], 'no world "reef/strin". Did you mean "reef/string"?'),
        (["draw", "--world", "wrek/2"], 'no world "wrek/2". Did you mean "wreck/2"?'),
        (["bench", "paepr"], 'no suite "paepr". Did you mean "paper"?'),
        (["bench", "paper", "--planners", "sixstep"], 'no planner "sixstep". Did you mean "sixsteps"?'),
        (["oracle", "--world", "reef/strng"], 'no world "reef/strng". Did you mean "reef/string"?'),
        (
            ["oracle", "--world", "reef/string", "--start", "9"],
            "start: expected 0 to 3 for reef/string, got 9",
        ),
        (["oracle", "--budget", "nan"], "--budget: expected 0 to 1000000 seconds, got nan"),
        (["oracle", "--picture", "tour.txt"], "--picture: expected a name that ends in .png"),
        (["oracle", "--check"], "--check: expected a suite, got none. Say: dream oracle paper --check"),
        (["oracle", "papre"], 'no suite "papre". Did you mean "paper"?'),
        (["oracle", "paper", "--jobs", "0"], "--jobs: expected at least 1, got 0"),
        (
            ["oracle", "paper", "--world", "reef/L"],
            "--world: expected a world or a suite, got reef/L and paper",
        ),
        (["oracle", "paper", "--picture", "tour.png"], "--picture: expected one world"),
        (["oracle", "paper", "--out", "/dev/null/a"], "--out: expected a place that can be written, got"),
        (["oracle", "paper", "--out", "/"], "--out: expected a file, got the folder /"),
        (["oracle", "paper", "--check", "--out", "nowhere.jsonl"], "nowhere.jsonl"),
        (["oracle", "--traces", "nowhere"], "nowhere"),
        (["report", "nowhere"], "nowhere"),
        (["run", "lawnmowr"], 'no planner "lawnmowr". Did you mean "lawnmower"?'),
        (["run", "draem", "--model", "wire"], 'no planner "draem". Did you mean "dream"?'),
        (["run", "lawnmower", "--swath", "nan"], "--swath: expected 0.1 to 4, got nan"),
        (["run", "random", "--walk-seed", "-1"], "--walk-seed: expected 0 to"),
        (["run", "--protocol", "pool-v1"], "reef/string is made for dream-v1"),
        (["bench", "paper", "--jobs", "0"], "--jobs: expected at least 1, got 0"),
        (["bench", "paper", "--max-steps", "0"], "--max-steps: expected 1 to 10000, got 0"),
        (["bench", "paper", "--planners"], "--planners: expected one or more of"),
        (["bench", "paper", "--planners", "random", "random"], "--planners: expected each once"),
        (
            ["bench", "paper", "--planners", "vanilla", "belief", "dream"],
            "--model: expected which model vanilla and dream should ask, got none",
        ),
        (["sweep", "paper", "--planners", "dream"], "--model: expected which model dream should ask"),
        (
            ["bench", "paper", "--model", "wire"],
            "--planners: expected one that asks a model, such as dream, beside options for asking",
        ),
        (
            ["bench", "paper", "--planners", "dream", "--replay-replies", "nowhere"],
            "--replay-replies: expected a folder of kept replies, got nowhere",
        ),
        (["run", "dream", "--replay-replies", "/tmp"], "expected the one whose replies were kept"),
        (["run", "dream", "--model", "http://me:secret@far/v1"], "model: expected a plain address"),
        (["run", "dream"], "model: expected which model to ask, got none"),
        (["bench", "paper", "--world", "reef/L"], "expected a suite or --world, got both: paper and --world"),
        (["bench", "--world", "reef/mixd"], 'no world "reef/mixd". Did you mean "reef/mixed"?'),
        (["bench", "--world", "reef/L", "--seeds", "5..1"], "got 5..1. Did you mean 1..5?"),
        (
            ["bench", "--world", "reef/L", "--seeds", "1-5"],
            "--seeds: expected a number or A..B such as 1..5, got 1-5",
        ),
        (
            ["bench", "--world", "reef/L", "--seeds", "0..99999"],
            "--seeds: expected at most 10000 seeds, got 100000",
        ),
        (["bench", "--seeds", "1..5"], "--seeds: expected --world with it"),
        (["bench", "paper", "--address", "auto"], "--address: expected --engine ray with it"),
        (["bench", "paper", "--engine", "slurm"], "--engine: expected one of process, ray, got slurm. Add"),
        (["bench", "paper", "--planners", "./mine.py"], "by dream run ./mine.py, one mission at a time"),
        (["run", "--seed"], "dream: --seed: expected a value, got none. Add --help"),
        (["dive", "--area", "0", "0"], "dream: --area: expected 4 values, got 2. Add --help"),
        (["dive"], "Say --area 0 0 8 5, for a tank of 8 by 5 m; or --stand-in"),
        (["run", "--world", "my-reef-x"], 'dream: no such folder or world: "my-reef-x". dream worlds lists'),
        (
            ["run", "dream", "--model", "wire:error:500"],
            "with P from 0 to 1, got wire:error:500. docs/models.md",
        ),
        (
            ["mission", "Map it.", "--model", "wire"],
            "dream: Nobody can confirm without a terminal. Add --yes to",
        ),
        (
            ["worlds", "reef/string"],
            "Say: dream draw --world reef/string, to look at it; or dream worlds --save",
        ),
        (["worlds", "extra"], "dream: expected an option, got extra. Add --help"),
        (
            ["watch", "nosuch"],
            "dream: nosuch: expected a folder that exists, or one below runs, which may still come; got none",
        ),
        (["survey"], "dream: expected a subcommand, got none. There are: add, list,"),
        (["survey", "lst"], 'dream: no subcommand "lst". Did you mean "list"?'),
        (["survey", "compare", "1"], "dream: expected AFTER (the later survey), got none. Add --help"),
        (["survey", "remove", "x"], "dream: SURVEY: expected a whole number, got x. Add --help"),
        (
            ["export", "x"],
            "dream: expected --to PATH (folder to make, or a file .glb or .ply), got none.",
        ),
        (["report"], "dream: expected RUN (folder of the run; runs/latest is the newest), got none."),
        (["bench", "paper", "--protocol", "pool-v1"], "reef/fringing is made for dream-v1, got pool-v1"),
        (["bench", "paper", "--protocol", "dream-v1-reach5"], 'Did you mean "dream-v1-reach'),
        (["sweep", "paepr"], 'no suite "paepr". Did you mean "paper"?'),
        (["sweep", "paper", "--reach", "5"], "--reach: expected one or more of 4, 6, 8, 10, got 5"),
        (["sweep", "paper", "--reach"], "--reach: expected one or more of 4, 6, 8, 10, got none"),
        (["sweep", "paper", "--reach", "8", "nan"], "--reach: expected one or more of 4, 6, 8, 10, got nan"),
        (["probe"], "model: expected which model to ask, got none"),
        (["probe", "--latency", "3"], "no option --latency. Add --help"),
        (["run", "dream", "--model", "wire:foo"], "error:P; docs/models.md says what each does"),
        (["probe", "--questions", "0"], "--questions: expected 1 to 200, got 0"),
        (["probe", "--at-once", "0"], "--at-once: expected 1 to 64, got 0"),
        (["probe", "--limit", "nan"], "--limit: expected above 0 to 1000000 seconds, got nan"),
        (["probe", "--timeout", "nan"], "timeout: expected 0.1 to 3600"),
        (["draw", "--out", "reef.xyz"], "--out: expected a name that ends in .png"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = ["--out", str(tmp_path)] if arguments[0] in ("run", "bench", "sweep") else []
    assert run_command([*arguments, *out]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert complaint in printed.err
    assert not re.search(r"[^.]\.\.\s", printed.err), "two full stops"
    assert len(printed.err.strip().splitlines()) == 1


def test_a_short_run_prints_one_json_object_and_leaves_a_complete_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--json", "--max-steps", "5", "lawnmower", "--out", str(tmp_path), "--world", "reef/string"]
    assert run_command(["run", *options]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert set(summary) >= SUMMARY_KEYS
    assert (summary["planner"], summary["steps"], summary["ended"]) == ("lawnmower", 5, "cap")
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir() and not path.is_symlink())
    assert json.loads((folder / "summary.json").read_text()) == summary
    for name in ("config.json", "steps.jsonl", "map.npz", "report.html"):
        assert (folder / name).stat().st_size > 0
    assert len((folder / "steps.jsonl").read_text().splitlines()) == 6


@pytest.mark.rare
def test_a_run_with_a_sensor_that_errs_is_repeated_to_the_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.sim.worlds.make_world", make_world)  # The world is made again, too.
    options = ["--json", "--max-steps", "5", "--protocol", "dream-v1-noisy"]
    pictures = []
    for name in ("first", "again"):
        assert run_command(["run", *options, "--out", str(tmp_path / name)]) == 0
        assert json.loads(capsys.readouterr().out)["protocol"] == "dream-v1-noisy"
        folder = (tmp_path / name / "latest").resolve()
        assert json.loads((folder / "config.json").read_text())["protocol"] == "dream-v1-noisy"
        pictures.append([path.read_bytes() for path in sorted((folder / "frames").iterdir())])
    assert pictures[0] == pictures[1]


def test_a_vehicle_that_swims_says_how_far_it_was_from_where_it_believed_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--world", "flat/empty", "--protocol", "dream-v1-nav", "--max-steps", "5"]
    assert run_command(["run", "lawnmower", *options, "--out", str(tmp_path)]) == 0
    assert "m (rms) from where it believed to be" in capsys.readouterr().out
    folder = next(tmp_path.glob("2*"))
    summary = json.loads((folder / "summary.json").read_text())
    steps = [json.loads(line) for line in (folder / "steps.jsonl").read_text().splitlines()]
    errors = [
        math.dist((step["pose"]["x"], step["pose"]["y"]), (step["truth"]["x"], step["truth"]["y"]))
        for step in steps[1:]
    ]
    assert summary["position_error_m"]["end"] == pytest.approx(errors[-1], abs=1e-4)
    assert 0.0 < summary["position_error_m"]["rmse"] < 0.2
    assert summary["drift"] == pytest.approx(errors[-1] / summary["distance_m"], abs=1e-4)
    assert all(step["position_sigma_m"] > 0.0 for step in steps[1:])


def test_a_run_that_swims_can_be_flown_again_from_its_config(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = ["--vehicle", "bluerov2", "--current", "0.2", "--dvl", "performance", "--no-anchoring"]
    options = ["--world", "flat/empty", "--protocol", "dream-v1-nav", "--max-steps", "2", *chosen]
    assert run_command(["run", "lawnmower", *options, "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    folder = next(tmp_path.glob("2*"))
    config, steps = read_config(folder), read_steps(folder)
    assert config.swimming is not None
    again = simulate(
        make_world(config.world, config.seed),
        PLANNERS[config.planner],
        DREAM_V1_NAV,
        max_steps=config.max_steps,
        swimming=read_swimming(config.swimming),
    )
    assert [step.observation.pose.x for step in again] == [step.pose.x for step in steps]


def test_options_of_a_vehicle_are_refused_where_none_swims(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("run", "bench"):
        assert run_command([command, "--current", "0.2", "--out", str(tmp_path / command)]) == 2
        assert "--protocol dream-v2-nav" in capsys.readouterr().err
        assert not (tmp_path / command).exists()


def test_an_unwritable_folder_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert run_command(["run", "--max-steps", "1", "--out", str(blocked)]) == 2
    assert str(blocked) in capsys.readouterr().err


def test_the_help_of_an_option_that_turns_something_off_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["run", "--help-all"]) == 0
    assert "  --no-anchoring      Do not correct the position" in capsys.readouterr().out


def test_a_world_can_be_saved_changed_and_flown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "mine"
    assert run_command(["worlds", "--save", "flat/empty", "--out", str(folder)]) == 0
    fly = ["run", "--json", "--world", str(folder), "--max-steps", "2", "--out", str(tmp_path)]
    assert run_command(fly) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["world"] == "flat/empty"


def test_draw_writes_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "reef.png"
    assert run_command(["draw", "--world", "reef/O", "--out", str(picture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_world_is_not_saved_over_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "mine"
    save = ["worlds", "--save", "flat/empty", "--out", str(folder)]
    assert run_command(save) == 0
    assert run_command(save) == 0  # The very same is no loss.
    capsys.readouterr()
    changed = (folder / "world.json").read_text().replace('"seed": 1', '"seed":  1')
    (folder / "world.json").write_text(changed)
    assert run_command(save) == 2
    assert f"got {folder}, which holds something else. Choose another" in capsys.readouterr().err
    assert (folder / "world.json").read_text() == changed


def test_a_full_disk_leaves_no_half_of_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    picture = tmp_path / "reef.png"
    picture.write_bytes(b"an older one")
    monkeypatch.setattr("dream.files.os.fsync", full)
    assert run_command(["draw", "--world", "flat/empty", "--out", str(picture)]) == 2
    told = capsys.readouterr().err
    assert re.search(
        r"--out: expected room for a picture of \d\.\d MB, could not write .*No space left", told
    )
    assert "Make room, or choose another place" in told
    assert [path.name for path in tmp_path.iterdir()] == ["reef.png"]
    assert picture.read_bytes() == b"an older one"


OWN = """
from dataclasses import dataclass
from dream.types import Decision

@dataclass(frozen=True, slots=True)
class Mine:
    def begin(self, mission):
        return Pilot()

class Pilot:
    def decide(self, observation, occupancy):
        return {decided}
"""


@pytest.mark.parametrize(
    ("decided", "words"),
    [
        ("{}['x']", "mine.py, line 12: step 4: KeyError: 'x'"),
        ("(0.4, 1.3)", "mine.py, line 11: step 4: expected a Decision with a turn of 0,"),
        ("Decision(0.4, 1.3)", "got a turn of 22.9183° and an advance of 1.3 m"),
    ],
)
def test_what_fails_in_a_planner_of_ones_own_is_told_by_its_line_and_kept_whole(
    decided: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(OWN.replace("{decided}", decided))
    assert (
        run_command(
            [
                "run",
                str(file),
                "--world",
                "flat/empty",
                *PLANE,
                "--out",
                str(tmp_path / "runs"),
            ]
        )
        == 1
    )
    told = capsys.readouterr().err.splitlines()[-1]
    assert words in told
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if not path.is_symlink())
    kept = folder / "traceback.txt"
    assert told.endswith(f"All of the error is in {kept}")
    assert kept.read_text().startswith("Traceback (most recent call last):")


@pytest.mark.rare
def test_a_mission_that_breaks_off_keeps_its_steps_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def burns(self: Teleport, setpoint: Setpoint) -> Arrival:
        if setpoint.yaw > 3.0:
            raise RuntimeError("the thruster burns")
        return go_to(self, setpoint)

    go_to = Teleport.go_to
    monkeypatch.setattr(Teleport, "go_to", burns)
    assert run_command(["run", "--json", "--world", "flat/empty", "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1].startswith("dream: aborted: the thruster burns; ")
    summary = json.loads(printed.out)
    assert summary["ended"] == "aborted"
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir() and not path.is_symlink())
    assert len((folder / "steps.jsonl").read_text().splitlines()) == summary["steps"] + 1
    assert (folder / "report.html").stat().st_size > 0


@pytest.mark.rare
@pytest.mark.parametrize("full_at", [3, None])
def test_a_full_disk_ends_a_run_with_what_is_kept_and_how_to_go_on(
    full_at: int | None, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, summarize = Disk(monkeypatch), runner.summarize

    def observe(self: Teleport) -> Observation:
        seen = see(self)
        if next(looks) == full_at:
            disk.full = True
        return seen

    def fill_and_summarize(*arguments: Any) -> dict[str, Any]:
        disk.full = True
        return summarize(*arguments)

    see, looks = Teleport.observe, itertools.count()
    monkeypatch.setattr(Teleport, "observe", observe)
    monkeypatch.setattr(runner, "summarize", fill_and_summarize)
    assert run_command(["run", "--json", "--max-steps", "4", "--out", str(tmp_path)]) == 1
    folder = tmp_path / (tmp_path / "latest").readlink()
    printed = capsys.readouterr()
    what, kept = ("step 3", 2) if full_at else (str(folder / "summary.json"), 4)
    assert printed.err.splitlines()[-1] == (
        f"dream: aborted: the disk is full: could not write {what} (No space left on device); {kept} "
        f"steps are kept in {folder}. Once there is room: dream report {folder}"
    )
    assert json.loads(printed.out)["world"] == "reef/string"
    assert not [path for path in folder.iterdir() if "partial" in path.name]

    disk.full = False
    assert run_command(["report", str(folder)]) == 0
    assert (folder / "report.html").stat().st_size > 10_000


def compiles(seconds: float = 0.0) -> None:
    """As if numba had compiled for so long."""
    with trigger_event(COMPILES):
        time.sleep(seconds)


def test_a_run_says_once_that_it_compiles(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    observe = Teleport.observe

    def compiles_and_observes(self: Teleport) -> Observation:
        compiles(0.3)
        return observe(self)

    fly = ["run", "--json", "--world", "flat/empty", "--max-steps", "2", "--out", str(tmp_path)]
    assert run_command(fly) == 0  # Whatever it really compiles, it compiles here.
    capsys.readouterr()
    assert run_command(fly) == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(Teleport, "observe", compiles_and_observes)
    began = time.perf_counter()
    assert run_command(fly) == 0
    took = time.perf_counter() - began
    printed = capsys.readouterr()
    assert (
        printed.err == "dream: compiling what was not used here before; the first time takes about a minute\n"
    )
    said = json.loads(printed.out)
    assert said["steps"] == 2
    assert said["wall_s"] < took - 0.85  # Three pictures, each after compiling.


@pytest.mark.parametrize("planner", ["belief", "lawnmower"])
def test_a_run_prints_how_it_ended_and_what_its_planner_said_last(
    planner: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [*PLANE, "--max-steps", "5", "--out", str(tmp_path)]
    assert run_command(["run", planner, *options]) == 0
    printed = capsys.readouterr().out
    assert "\n  out of steps after 5 steps\n" in printed
    last = read_steps(tmp_path / "latest")[-1].reasoning
    assert f"\n  its last word: {last.completion if planner == 'belief' else last.action}\n" in printed
    summary = read_summary(tmp_path / "latest")
    assert summary is not None
    metres, seconds = summary.distance_m, summary.mission_s
    assert f"\n  0 contacts, {metres:.0f} m in {seconds:.0f} s of the mission; computed in " in printed
    assert f"computed in {summary.wall_s:.1f} s\n" in printed
    assert (planner == "belief") == (
        "If it stopped now, it would miss a whole patch with a probability of" in printed
    )


def test_a_run_prints_the_shares_that_its_steps_are_told_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Where there is nothing to see, all of it is seen at the first look.
    assert run_command(["run", "--world", "flat/empty", "--max-steps", "1", "--out", str(tmp_path)]) == 0
    shares = "90 % at 0, 95 % at 0, 98.26 % at 0, 100 % at 0"
    assert f"steps until a share of the individuals was inspected: {shares}\n" in capsys.readouterr().out


def test_oracle_prints_both_ends_as_one_json_object_and_draws_the_tour(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "tour.png"
    options = ["--world", "flat/empty", "--budget", "0", "--picture", str(picture)]
    assert run_command(["oracle", "--json", *options]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["lower_bound"], printed["best_tour"], printed["status"]) == (0, 0, "optimal")
    assert set(printed) == {
        *("protocol", "world", "seed", "start", "world_hash", "countable", "lower_bound", "lower_bound_t98"),
        *("best_tour", "best_tour_t98", "status", "status_t98", "cpu_s"),
    }
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run_command(["oracle", *options]) == 0
    assert "0 steps, and no fewer: optimal" in capsys.readouterr().out


@pytest.mark.rare
def test_oracle_knows_the_bounds_of_a_protocol_with_noise_too(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--world", "reef/string", "--seed", "1", "--budget", "0"]
    assert run_command(["oracle", "--json", *options, "--protocol", "dream-v1-noisy"]) == 0
    noisy = json.loads(capsys.readouterr().out)
    truth = bounds_module.every_known()["dream-v1", "reef/string", 1, 0].summary()
    assert noisy | {"cpu_s": 0.0} == truth | {"protocol": "dream-v1-noisy", "cpu_s": 0.0}
    assert noisy["best_tour"] is not None


def search_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches of a suite need no process of their own."""
    monkeypatch.setattr(
        "dream.commands.oracle.ProcessPoolExecutor", lambda jobs, **_: ThreadPoolExecutor(jobs)
    )


def test_oracle_keeps_the_bounds_of_a_suite_and_checks_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    search_here(monkeypatch)
    monkeypatch.setitem(SUITES, "empty", (Case("flat/empty", 1), Case("flat/empty", 2)))
    out = tmp_path / "empty.jsonl"
    search = ["oracle", "empty", "--out", str(out), "--json", "--budget", "0"]
    assert run_command(search) == 0
    assert [world["status"] for world in json.loads(capsys.readouterr().out)["worlds"]] == ["optimal"] * 2
    lines = out.read_text().splitlines()
    assert [json.loads(line)["seed"] for line in lines] == [1, 2]

    # Of another world: it must be neither told nor kept.
    stale = json.loads(lines[1]) | {"world_hash": "0" * 64} | MADE_UP
    out.write_text(lines[0] + "\n" + json.dumps(stale) + "\n")
    assert run_command(search) == 0
    assert [world["best_tour"] for world in json.loads(capsys.readouterr().out)["worlds"]] == [0, 0]
    after = out.read_text().splitlines()
    assert after[0] == lines[0]
    assert json.loads(after[1]) | {"cpu_s": 0.0} == json.loads(lines[1]) | {"cpu_s": 0.0}
    written = out.stat().st_ino
    assert run_command([*search, "--again"]) == 0
    assert out.stat().st_ino == written, "nothing was left to search"

    capsys.readouterr()
    assert run_command(["oracle", "empty", "--check", "--out", str(out)]) == 0
    assert capsys.readouterr().out == "flat/empty 1: holds\nflat/empty 2: holds\n"


@pytest.mark.rare
def test_oracle_names_the_worlds_of_a_suite_that_fail_and_searches_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SUITES, "empty", (Case("flat/empty", 1),))
    out = tmp_path / "new" / "empty.jsonl"
    search = ["oracle", "empty", "--out", str(out), "--json", "--budget", "0"]
    with monkeypatch.context() as patch:
        search_here(patch)
        assert run_command(search) == 0
    (line,) = out.read_text().splitlines()
    wrong = json.dumps(json.loads(line) | MADE_UP)
    out.write_text(wrong + "\n")
    # A tour that cannot be flown, a start that is none, and one without a fault.
    cases = (Case("flat/empty", 1), Case("flat/empty", 2, start=99), Case("flat/empty", 3))
    monkeypatch.setitem(SUITES, "empty", cases)
    capsys.readouterr()
    assert run_command(search) == 1
    printed = capsys.readouterr()
    assert [world["seed"] for world in json.loads(printed.out)["worlds"]] == [3]
    (complaint,) = printed.err.splitlines()
    assert "2 of 3 worlds failed: flat/empty 1: tour to 100 %: expected it at step 4, got 0; " in complaint
    assert "flat/empty 2: start: expected 0 to" in complaint
    assert [json.loads(line)["seed"] for line in out.read_text().splitlines()] == [1, 3]


def test_a_check_of_the_bounds_of_a_suite_fails_where_none_is_known_or_one_does_not_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SUITES, "empty", (Case("flat/empty", 1), Case("flat/empty", 2)))
    monkeypatch.setattr("dream.evaluation.oracle.bounds.every_known", dict)
    assert run_command(["oracle", "empty", "--check"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "--check: expected bounds of a world of empty, got none with the package." in printed.err

    assert run_command(["oracle", "--world", "flat/empty", "--budget", "0", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    line = found | {"tour": [], "tour_t98": [], "witnesses": [], "witnesses_t98": []}
    good = OracleBounds.from_dict(line)
    stale = replace(good, seed=2, world_hash="0" * 64)
    many = replace(good, countable=7)
    for bounds, verdict in (good, "holds"), (many, "countable: expected 0, got 7"):
        known = {b.key: b for b in (bounds, stale)}
        monkeypatch.setattr("dream.evaluation.oracle.bounds.every_known", lambda known=known: known)
        assert run_command(["oracle", "empty", "--check"]) == 1
        first, second = capsys.readouterr().out.splitlines()
        assert first == f"flat/empty 1: {verdict}"
        assert second.startswith("flat/empty 2: world_hash: expected ")

    monkeypatch.setattr("dream.evaluation.oracle.bounds.every_known", lambda: {good.key: good})
    assert run_command(["oracle", "empty", "--check"]) == 0
    told = "flat/empty 1: holds\nnot checked: 1 of 2 worlds, of which no bounds are known\n"
    assert capsys.readouterr().out == told
    assert run_command(["oracle", "empty", "--check", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["failed"], record["unknown"], len(record["worlds"])) == (0, 1, 1)


def test_oracle_flies_its_tours_before_it_tells_them(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tighten = bounds_module.tighten

    def made_up(*arguments: Any, **options: Any) -> Iterator[OracleBounds]:
        for found in tighten(*arguments, **options):
            yield OracleBounds.from_dict(found.as_dict() | MADE_UP)

    monkeypatch.setattr(bounds_module, "tighten", made_up)
    assert run_command(["oracle", "--world", "flat/empty", "--budget", "0"]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == "dream: flat/empty 1: tour to 100 %: expected it at step 4, got 0\n"


def test_an_interrupted_search_tells_what_it_found(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tighten = bounds_module.tighten

    def interrupted(*arguments: Any, **options: Any) -> Iterator[OracleBounds]:
        yield from tighten(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(bounds_module, "tighten", interrupted)
    assert run_command(["oracle", "--world", "flat/empty", "--budget", "0", "--json"]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["best_tour"] == 0
    assert printed.err == "dream: interrupted\n"


def test_two_searches_of_a_suite_do_not_share_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "paper.jsonl"
    with alone_at(out, tmp_path / ".paper.jsonl.lock"):
        assert run_command(["oracle", "paper", "--out", str(out), "--budget", "0"]) == 2
    assert "expected that no other process writes here" in capsys.readouterr().err
    assert not out.exists()


def test_an_interrupt_that_somebody_swallowed_is_not_lost() -> None:
    with kept_interrupts() as check:
        check()
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            check()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def interrupted_in(module: str) -> None:
    """As Ctrl-C while a function of that module runs."""
    exec("signal.raise_signal(signal.SIGINT)", {"__name__": module, "signal": signal})


def test_an_interrupt_of_what_calls_kernels_waits_for_the_end_of_the_step() -> None:
    with kept_interrupts(between_steps=True) as check:
        interrupted_in("dream.planning.lookahead")
        with pytest.raises(KeyboardInterrupt):
            check()
        with pytest.raises(KeyboardInterrupt):  # Whoever presses again does not want to wait.
            interrupted_in("dream.planning.lookahead")
    with kept_interrupts(between_steps=True) as check:
        # As while the named tuple is made that a kernel returns.
        made_in = collections.namedtuple("Returned", "value").__new__.__globals__["__name__"]
        inner = {"__name__": made_in, "signal": signal}
        call = "exec('signal.raise_signal(signal.SIGINT)', inner)"
        exec(call, {"__name__": "dream.planning.lookahead", "inner": inner})
        with pytest.raises(KeyboardInterrupt):
            check()
    for module in ("dream.planning.vlm.asking.line", "dream.commands.run", "httpx"):
        with pytest.raises(KeyboardInterrupt), kept_interrupts(between_steps=True):
            interrupted_in(module)
    with pytest.raises(KeyboardInterrupt), kept_interrupts():
        interrupted_in("dream.planning.lookahead")


def interrupts(*_: object, **__: object) -> None:
    """As Ctrl-C within a kernel does."""
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    raise SystemError("CPUDispatcher returned a result with an exception set")


def test_what_fails_after_an_interrupt_was_interrupted() -> None:
    with pytest.raises(KeyboardInterrupt), kept_interrupts():
        interrupts()
    with pytest.raises(SystemError), kept_interrupts():
        raise SystemError("nobody interrupted this")


def test_an_interrupt_within_a_kernel_ends_a_run_as_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Teleport, "go_to", interrupts)
    assert run_command(["run", "--json", "--world", "flat/empty", "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    folder = tmp_path / (tmp_path / "latest").readlink()
    assert printed.err.splitlines()[-1] == f"dream: aborted: interrupted; 0 steps are kept in {folder}"
    assert json.loads(printed.out)["ended"] == "aborted"
    assert [step.step for step in read_steps(folder)] == [0]


def test_a_run_interrupted_before_it_can_fly_leaves_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.metrics.Scorer", interrupts)
    assert run_command(["run", "--world", "flat/empty", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "dream: interrupted"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("where", "steps"), [("dream.robots.Teleport.observe", 0), ("dream.report.write_report", 2)]
)
def test_a_run_interrupted_after_that_names_its_folder(
    where: str,
    steps: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(where, interrupt)
    fly = ["run", "--world", "flat/empty", "--max-steps", "2", "--out", str(tmp_path)]
    assert run_command(fly) == 1
    folder = tmp_path / (tmp_path / "latest").readlink()
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"dream: aborted: interrupted; {steps} steps are kept in {folder}"


@pytest.mark.slow
def test_an_interrupted_run_keeps_its_steps(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dream.cli", "run", "--world", "flat/empty", "--json"]
    command += ["--out", str(tmp_path)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ)
    lines: list[str] = []
    try:
        while running.poll() is None and len(lines) < 6:
            files = list(tmp_path.glob("*/steps.jsonl"))
            lines = files[0].read_text().splitlines() if files else []
            time.sleep(0.02)
    finally:
        running.send_signal(2)
        printed, _ = running.communicate(timeout=60)
    assert running.returncode == 1
    assert json.loads(printed)["ended"] == "aborted"
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir() and not path.is_symlink())
    kept = (folder / "steps.jsonl").read_text().splitlines()
    assert len(kept) == json.loads(printed)["steps"] + 1
    assert all(json.loads(line) for line in kept)
    assert (folder / "report.html").stat().st_size > 10_000


def ask(script: list[Response | Answer], out: Path, *options: str) -> tuple[int, list[Request]]:
    """Fly a few steps with a model that answers so; returns the exit status and what it was asked."""
    with serving(*script) as server:
        model = ["--model", server.address, "--model-name", NAME, "--timeout", "20"]
        fly = [
            "run",
            "vanilla",
            "--world",
            "flat/empty",
            *PLANE,
            *model,
            "--max-steps",
            "6",
            "--out",
            str(out),
            *options,
        ]
        return run_command(fly), server.asked


def test_a_run_tells_what_asking_came_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, asked = ask([says("no JSON"), says("still none"), fitting], tmp_path)
    assert status == 0
    assert [len(request.pictures) for request in asked] == [4] * 4
    printed = capsys.readouterr().out
    address = read_config(tmp_path / "latest").planner_parameters["model"]
    said = re.escape(f"  asked {NAME} at {address}: 4 calls, 440 tokens, at an unknown price, ")
    assert re.search(rf"{said}\d+\.\d s an answer, waited 48 s of \d+ s\n", printed), printed
    assert "  1 of 3 questions were decided by geometry (invalid 1); its answers: 2 followed\n" in printed
    assert "  its last word: " in printed
    assert "wire test" not in printed
    kept = [len(read_exchanges(tmp_path / "latest", step)) for step in range(7)]
    assert kept == [0, 0, 0, 0, 1, 1, 1]
    summary = json.loads((tmp_path / "latest" / "summary.json").read_text())
    assert (summary["vlm"]["questions"], summary["vlm"]["fallbacks"]) == (3, 1)
    assert summary["vlm"]["outcomes"] == {"followed": 2}
    assert summary["mission_s"] > 48.0


@pytest.mark.rare
def test_nothing_breaks_into_the_progress_of_a_run(tmp_path: Path) -> None:
    def answer(request: Request) -> Response:
        shutil.rmtree(tmp_path / "kept", ignore_errors=True)
        return fitting(request)

    # Under pytest or in CI the client is quiet by itself.
    known = {name: value for name, value in os.environ.items() if name not in ("PYTEST_VERSION", "CI")}
    ours, theirs = os.openpty()
    with serving(answer) as server, os.fdopen(ours, "rb", buffering=0) as terminal:
        model = ["--model", server.address, "--model-name", NAME, "--record", str(tmp_path / "kept")]
        fly = ["run", "vanilla", "--world", "flat/empty", *PLANE, *model]
        fly += ["--max-steps", "5", "--out", str(tmp_path / "runs")]
        code = "import sys; from dream.cli import main; main(sys.argv[1:])"
        environment = {**known, "TERM": "xterm", "COLUMNS": "300"}
        command = [sys.executable, "-c", code, *fly]
        running = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=theirs)
        os.close(theirs)
        printed = ""
        with contextlib.suppress(OSError):  # So a terminal ends.
            while shown := terminal.read(4096):
                printed += shown.decode(errors="replace")
        assert running.wait(60) == 0
    assert "of at most 5 steps" in printed
    assert "pydantic" not in printed
    said = [line.rstrip() for line in re.split(r"\r|\n|\x1b\[2K", printed) if "dream: " in line]
    first, last = (line for line in said if "kept" in line)
    assert first.startswith(f"dream: {tmp_path / 'kept'}: this exchange is not kept (could not write ")
    assert last == f"dream: {tmp_path / 'kept'}: 2 exchanges in all were not kept"


@pytest.mark.rare
def test_worlds_that_can_be_named_are_listed_with_others_that_follow_from_them(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_command(["worlds"]) == 0
    names, _, told = capsys.readouterr().out.partition("\n\n")
    assert names.splitlines() == list(WORLDS)
    # The names that are given there are some.
    joined = [line for line in told.splitlines() if "+" in line.split()[0]]
    assert len(joined) == 3
    for line in joined:
        assert make_world(line.split()[0], 1).name == line.split()[0]


def test_a_key_is_sent_but_never_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DREAM_API_KEY", "sk-hush")
    status, asked = ask([fitting, error(400)], tmp_path, "--record", str(tmp_path / "kept"))
    assert status == 0
    assert {request.key for request in asked} == {"Bearer sk-hush"}
    assert "sk-hush" not in "".join(capsys.readouterr())
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert any(path.parent.name == "kept" for path in files)
    assert not [path for path in files if b"sk-hush" in path.read_bytes()]


def test_a_planner_that_cannot_begin_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["run", "dream", "--model", "http://127.0.0.1:1/v1", "--out", str(tmp_path)]) == 2
    complaint = capsys.readouterr().err
    assert "Say --model-name NAME" in complaint
    assert len(complaint.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_key_ends_the_run_at_its_first_question_and_says_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, asked = ask([error(401)], tmp_path)
    assert (status, len(asked)) == (1, 1)
    complaint = capsys.readouterr().err
    assert "and its key in the environment, as DREAM_API_KEY?; 3 steps are kept in" in complaint
    assert len(complaint.splitlines()) == 1
    assert [step.step for step in read_steps(tmp_path / "latest")] == [0, 1, 2, 3]
    assert (tmp_path / "latest" / "report.html").is_file()


@pytest.mark.rare
def test_nobody_at_the_address_ends_the_run_at_its_first_question(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving() as server:
        address = server.address
    fly = ["run", "vanilla", "--model", address, "--model-name", NAME, "--out", str(tmp_path)]
    assert run_command(fly) == 1
    printed = capsys.readouterr()
    assert "Is the server running, and its address right?; 3 steps are kept in" in printed.err
    assert "asked" not in printed.out


def test_the_first_answer_that_does_not_count_is_told_at_once_and_whose_word_the_last_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    assert ask([fitting, error(418)], tmp_path)[0] == 0
    (told,) = caplog.messages
    assert told.startswith(f"step 5: {NAME} at http://127.0.0.1:")
    assert "(server: HTTP 418: denied to key ...); geometry decides there and wherever none comes" in told
    printed = capsys.readouterr().out
    assert "  2 of 3 questions were decided by geometry (server 2); its answers: 1 followed\n" in printed
    assert "  belief's last word: " in printed


def test_a_run_of_which_no_answer_counted_says_so_wherever_it_is_told_and_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half = says('Left, I think: {"direction": "left", "turn_deg": 30, "done": false}')
    assert ask([half], tmp_path, "--json")[0] == 1
    printed = capsys.readouterr()
    lacked = "step_m: Field required"
    (told,) = [line for line in printed.err.splitlines() if "no answer of" in line]
    assert told.startswith(f"dream: no answer of {NAME} at http://127.0.0.1")
    assert "counted: geometry decided all 3 questions, so that nothing here shows what the model can" in told
    assert told.endswith(f"The last had none because of invalid: {lacked}, asked twice")
    summary = json.loads(printed.out)
    assert summary["vlm"]["last_fallback"] == f"invalid: {lacked}, asked twice"
    assert (summary["vlm"]["fallbacks"], summary["success"]) == (3, False)
    folder = tmp_path / "latest"
    assert json.loads((folder / "replies" / "0004.json").read_text())["lacks"] == [lacked, lacked]
    page = (folder / "report.html").read_text()
    assert page.count(f'"lacks":["{lacked}","{lacked}"]') == 3
    assert "No answer of the model counted" in page


def test_a_server_that_takes_no_pictures_ends_the_run_at_its_first_question_in_its_own_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = "image input is not supported - hint: if this is unexpected, you may need to provide the mmproj"
    status, asked = ask([error(500, blind)], tmp_path)
    assert (status, len(asked)) == (1, 1)
    assert f"got rejected: HTTP 500: {blind}. Does the model take pictures" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ["run", "vanilla", "--model", "wire"],
        ["run", "ranked", "--model", "openai:gpt-5", "--mission", "look around", "--yes"],
        ["mission", "look around", "--model", "wire", "--yes"],
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_a_client_that_is_not_installed_is_told_before_anything_compiles(
    command: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def compiles(*_: Any) -> None:
        raise AssertionError("the world was opened")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pydantic_ai", None)
    monkeypatch.setattr("dream.commands.run.open_world", compiles)
    monkeypatch.setattr("dream.commands.mission.open_world", compiles)
    assert run_command(command) == 2
    assert f"got none. To add it: {how_to_add('vlm')}\n" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_planner_that_had_nothing_to_ask_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving() as server:
        model = [*PLANE, "--model", server.address, "--model-name", NAME, "--margin", "0"]
        assert run_command(["run", "ranked", *model, "--max-steps", "5", "--out", str(tmp_path)]) == 0
        assert not server.asked
    asked = f"  asked {NAME} at {server.address}: nothing, no choice was close enough\n"
    assert asked in capsys.readouterr().out


def test_a_key_that_is_refused_later_is_a_fallback(tmp_path: Path) -> None:
    assert ask([fitting, error(401)], tmp_path, "--json")[0] == 0
    summary = json.loads((tmp_path / "latest" / "summary.json").read_text())
    assert summary["vlm"]["reasons"] == {"denied": 2}


@pytest.mark.rare
def test_replies_that_were_kept_fly_the_same_mission_without_a_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = str(tmp_path / "kept")
    assert ask([fitting], tmp_path / "first", "--record", kept)[0] == 0
    model = read_config(tmp_path / "first" / "latest").planner_parameters["model"]
    again = [
        "run",
        "vanilla",
        "--world",
        "flat/empty",
        *PLANE,
        "--model",
        model,
        "--model-name",
        NAME,
        "--replay-replies",
        kept,
    ]
    assert run_command([*again, "--max-steps", "6", "--out", str(tmp_path / "again")]) == 0
    first, second = (read_steps(tmp_path / name / "latest") for name in ("first", "again"))
    assert [step.pose for step in first] == [step.pose for step in second]
    asked, replayed = (line for line in capsys.readouterr().out.splitlines() if " calls, " in line)
    assert asked.startswith("  asked ")
    assert replayed.startswith("  replayed ")

    capsys.readouterr()
    assert run_command([*again, "--max-steps", "7", "--out", str(tmp_path / "longer")]) == 1
    complaint = capsys.readouterr().err
    assert "expected a kept reply to this question" in complaint
    assert "--max-steps, --protocol, --mission and code must be those" in complaint
    assert "Else record again with --record; 3 steps are kept in" in complaint
    assert len(complaint.splitlines()) == 1


@pytest.mark.rare
def test_an_interrupted_mission_goes_on_with_what_was_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = str(tmp_path / "kept")
    go_to, moves = Teleport.go_to, itertools.count(1)

    def interrupted(self: Teleport, setpoint: Setpoint) -> Arrival:
        if next(moves) == 5:
            raise KeyboardInterrupt
        return go_to(self, setpoint)

    with serving(fitting) as server:
        model = ["--model", server.address, "--model-name", NAME, "--timeout", "20", "--record", kept]
        fly = ["run", "vanilla", "--world", "flat/empty", *PLANE, *model]
        fly += ["--max-steps", "6", "--out", str(tmp_path / "runs")]
        monkeypatch.setattr(Teleport, "go_to", interrupted)
        assert run_command(fly) == 1
        hint = f"To go on without asking again, say the same with --replay-replies {kept}"
        assert capsys.readouterr().err.rstrip().endswith(hint)
        assert len(server.asked) == 2
        assert run_command([*fly, "--replay-replies", kept]) == 0
        assert len(server.asked) == 3, "each question was asked once"
        assert run_command([*fly, "--replay-replies", kept]) == 0
        assert len(server.asked) == 3
        # Without it, all is asked anew.
        assert run_command(fly) == 0
        assert len(server.asked) == 6


@pytest.mark.usefixtures("undrawn")
def test_a_benchmark_hands_its_model_to_those_that_ask_and_writes_it_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DREAM_API_KEY", "sk-hush")
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)
    with serving() as server:
        options = ["--model", server.address, "--model-name", NAME, "--latency", "9", "--timeout", "20"]
        command = ["bench", "--world", "flat/empty", *PLANE, "--planners", "vanilla", "random", *options]
        limits = ["--max-steps", "5", "--jobs", "1", "--max-calls", "1", "--json"]
        assert run_command([*command, *limits, "--out", str(tmp_path)]) == 0
        assert len(server.asked) == 1
    results = read_results(tmp_path)
    asked = results.manifest["planners"]["vanilla"]
    assert (asked["model"], asked["model_name"], asked["latency"]) == (server.address, NAME, 9.0)
    assert asked["max_calls"] == 1
    assert "model" not in results.manifest["planners"]["random"]
    random, vanilla = results.rows
    assert (vanilla.vlm_calls, vanilla.vlm_fallbacks, vanilla.vlm_waited_s) == (1, 1, 9.0)
    assert (vanilla.vlm_questions, random.vlm_questions) == (2, None)
    assert (random.vlm_calls, random.vlm_waited_s) == (None, None)
    assert vanilla.mission_s is not None
    assert vanilla.mission_s > 9.0
    assert not [path for path in tmp_path.rglob("*.*") if b"sk-hush" in path.read_bytes()]


@pytest.mark.rare
@pytest.mark.usefixtures("undrawn")
def test_a_folder_holds_one_planner_with_several_models(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)
    with serving() as server:
        for label in ("one", "two"):
            options = ["--model", server.address, "--model-name", label, "--max-steps", "4", "--jobs", "1"]
            fly = [
                "bench",
                "--world",
                "reef/string",
                *PLANE,
                "--planners",
                f"dream+{label}",
                *options,
                "--keep-runs",
            ]
            assert run_command([*fly, "--out", str(tmp_path)]) == 0
        assert {request.body["model"] for request in server.asked} == {"one", "two"}
    results = read_results(tmp_path)
    assert [row.planner for row in results.rows] == ["dream+one", "dream+two"]
    assert [results.manifest["planners"][f"dream+{label}"]["model_name"] for label in ("one", "two")] == [
        "one",
        "two",
    ]
    page = (tmp_path / "report.html").read_text()
    assert "Between models" in page
    assert "dream+one (one)" in page
    # Each is repeated by a line of its own, and a recorded run is of a planner that there is.
    assert all(f"--planners dream+{label} --protocol" in page for label in ("one", "two"))
    kept = [json.loads(path.read_text())["planner"] for path in (tmp_path / "runs").glob("*/config.json")]
    assert kept == ["dream", "dream"]


@pytest.mark.rare
@pytest.mark.usefixtures("undrawn")
def test_a_folder_holds_one_planner_with_several_prompts_and_none_of_them_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)
    own, out = tmp_path / "own", tmp_path / "bench"
    own.mkdir()
    (own / "dream.md").write_text("version: 2\n\n$mission Prefer the left. $legend")
    fly = ["bench", "--world", "reef/string", "--model", "wire", "--max-steps", "4", "--jobs", "1"]
    fly += ["--keep-runs", "--out", str(out), "--planners"]
    assert run_command([*fly, "dream"]) == 0
    assert run_command([*fly, "dream+left", "--prompts", str(own)]) == 0
    asked = {}
    for run in (out / "runs").iterdir():
        parameters = json.loads((run / "config.json").read_text())["planner_parameters"]
        (asked[parameters["prompts"]],) = json.loads((run / "summary.json").read_text())["vlm"]["prompts"]
    assert asked[None].startswith("dream 1, ")
    assert asked[str(own)].startswith("dream 2 (own, ")
    assert "dream+left (wire test; own prompts)" in (out / "report.html").read_text()
    sha256 = hashlib.sha256((own / "dream.md").read_bytes()).hexdigest()
    assert read_results(out).manifest["files"] == {"dream+left": {"dream": sha256}}
    (own / "legend.md").write_text("version: 2\n\nGreen is good.")
    capsys.readouterr()
    assert run_command([*fly, "dream+left", "--prompts", str(own)]) == 2
    assert "files of dream+left.legend: expected None as for the missions in it" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["belief+x", "dream+", "dream+a/b", "dream+" + 41 * "x"])
def test_a_label_is_for_those_that_ask_a_model_and_plain(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["bench", "--planners", name, "--model", "wire"]) == 2
    assert "--planners: expected NAME+LABEL of one that asks a model" in capsys.readouterr().err


@pytest.mark.rare
@pytest.mark.usefixtures("undrawn")
def test_a_benchmark_says_of_each_mission_that_its_key_was_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving(error(401)) as server:
        options = ["--model", server.address, "--model-name", NAME, "--max-steps", "5", "--jobs", "1"]
        fly = [
            "bench",
            "--world",
            "flat/empty",
            *PLANE,
            "--planners",
            "dream",
            *options,
            "--out",
            str(tmp_path),
        ]
        assert run_command(fly) == 1
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert "1 of 1 missions failed, first dream in flat/empty 1: " in complaint
    assert "HTTP 401. Is its name right, and its key in the environment, as DREAM_API_KEY?" in complaint


@pytest.mark.rare
@pytest.mark.usefixtures("undrawn")
def test_a_mission_without_its_model_is_not_kept_and_goes_on_without_paying_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)
    quota = {"error": {"message": "nothing left", "code": "insufficient_quota"}}
    empty = Response(json.dumps(quota).encode(), 429, {"retry-after": "0"})
    left = [1]

    def answer(request: Request) -> Response:
        left[0] -= 1
        return fitting(request) if left[0] >= 0 else empty

    kept = str(tmp_path / "kept")
    with serving(answer) as server:
        options = ["--model", server.address, "--model-name", NAME, "--max-steps", "5", "--jobs", "1"]
        fly = ["bench", "--world", "flat/empty", *PLANE, "--planners", "dream", *options]
        fly += ["--out", str(tmp_path / "bench"), "--json"]
        going_on = ["--record", kept, "--replay-replies", kept]
        assert run_command([*fly, *going_on]) == 1
        assert "got quota: nothing is left to spend there" in capsys.readouterr().err
        assert not list((tmp_path / "bench/missions").glob("*.json"))
        left[0], asked = 9, len(server.asked)
        assert run_command([*fly, *going_on]) == 0
        assert len(server.asked) == asked + 1
        (row,) = read_results(tmp_path / "bench").rows
        assert (row.vlm_questions, row.vlm_fallbacks) == (2, 0)
        # Where they are kept decides nothing: the mission is the same without.
        assert run_command(fly) == 0
        assert len(server.asked) == asked + 1


def test_a_model_that_cannot_be_asked_is_found_out_before_anything_is_flown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("OPENAI_API_KEY", "DREAM_OFFLINE"):
        monkeypatch.delenv(name, raising=False)
    out = tmp_path / "bench"
    assert run_command(["bench", "--planners", "dream", "--model", "openai:x", "--out", str(out)]) == 2
    assert "OPENAI_API_KEY" in capsys.readouterr().err
    assert not out.exists()
