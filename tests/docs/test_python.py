"""docs/python.md runs as it stands, and the interface that it promises is the one that there is."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
import types
from dataclasses import replace
from pathlib import Path

import pytest

import dream
from tests.docs.pages import DOCS, REPOSITORY, fenced

PAGE = DOCS / "python.md"


def test_every_block_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").symlink_to(REPOSITORY / "results", target_is_directory=True)
    module = types.ModuleType("page")  # A dataclass looks its own module up.
    monkeypatch.setitem(sys.modules, "page", module)
    without = importlib.util.find_spec("pandas") is None
    run = 0
    for block in (text for kind, text in fenced(PAGE) if kind == "python"):
        if without and "pandas" in block:
            continue
        exec(compile(block, str(PAGE), "exec"), vars(module))
        run += 1
    assert run >= 6
    said = capsys.readouterr().out
    assert re.search(r"^cap 12 \d+% of the individuals seen$", said, re.M)
    assert (tmp_path / "runs/mine/report.html").is_file()
    found = vars(module)
    assert found["occupancy"].areas()["explored"] > 10.0
    assert found["flown"].row.world == "murky"
    assert dream.read_steps("runs/mine")[-1].map["target"] > 0.0


def test_pandas_takes_what_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pandas = pytest.importorskip("pandas")
    monkeypatch.chdir(REPOSITORY)
    table = pandas.DataFrame(dream.read_results("results/paper").rows)
    assert len(table) == 120
    assert table.groupby("planner").t98.mean()["belief"] < 40.0


def test_the_page_lists_the_names_that_stay_and_no_other() -> None:
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("The names of `dream.__all__` stay") : text.index("A release that must break")]
    listed = re.findall(r"`(\w+)`", table)
    assert sorted(listed) == sorted(dream.__all__)
    for name in dream.__all__:
        assert getattr(dream, name).__doc__ or name == "PLANNERS", name
    assert set(dream.__all__) <= set(dir(dream))
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        getattr(dream, "fly")  # noqa: B009 - a checker of types knows that there is none.


def test_the_name_alone_imports_no_more_than_a_look_at_the_kept_kernels_takes() -> None:
    loaded = "import dream, sys; print([n for n in sys.modules if n.startswith(('dream.', 'numpy'))])"
    said = subprocess.run([sys.executable, "-c", loaded], check=True, capture_output=True, text=True)
    assert ast.literal_eval(said.stdout) == ["dream.files", "dream.kept_kernels"]


def test_a_mission_is_flown_into_no_folder_that_is_there_and_by_no_class_without_parameters(
    tmp_path: Path,
) -> None:
    world = dream.make_world("flat/empty", 1)
    with pytest.raises(FileExistsError, match="record_to: expected a folder that is not there yet"):
        dream.fly_mission(world, dream.PLANNERS["belief"], max_steps=1, record_to=tmp_path)

    class Bare:
        def begin(self, mission: dream.Mission) -> dream.Pilot:
            raise AssertionError

    with pytest.raises(ValueError, match=r"planner: expected a dataclass, .* got Bare"):
        dream.fly_mission(world, Bare(), max_steps=1)


def test_what_would_be_scored_by_other_rules_or_flies_no_step_is_refused() -> None:
    world, planner = dream.make_world("flat/empty", 1), dream.PLANNERS["belief"]
    changed = replace(dream.protocol_named("dream-v1"), cap=7)
    with pytest.raises(ValueError, match="protocol: expected dream-v1 as it is, got another"):
        dream.fly_mission(world, planner, changed)
    with pytest.raises(ValueError, match="max_steps: expected at least 1, got 0"):
        dream.fly_mission(world, planner, max_steps=0)
