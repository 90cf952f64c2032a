"""What stands on the page of the user's own worlds works as it is."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.evaluation.suites import Case, suite_named
from dream.sim.files import save_world
from dream.sim.formats import COLUMNS
from dream.sim.worlds import make_world, open_world
from tests.sim.made import made

PAGE = (Path(__file__).parents[2] / "docs/worlds.md").read_text(encoding="utf-8")


def code(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


def test_the_code_on_the_page_takes_a_patch_out_of_a_reef(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    save = re.search(r"^dream (worlds --save .*?) +#", code("sh"), re.MULTILINE)
    assert save is not None
    assert run_command(save[1].split()) == 0
    exec(code("python"), {})
    before, after = make_world("reef/O", 1), open_world("runs/my-reef", 1)
    assert after.name == "reef/O (changed)"
    assert after.water.name == "clear"
    sizes = np.bincount(before.targets.group)
    assert len(sizes) > 1, "something is left"
    assert sorted(np.bincount(after.targets.group, minlength=len(sizes))) == [0, *sorted(sizes)[:-1]]


def test_the_list_on_the_page_is_read(tmp_path: Path) -> None:
    for folder, name in (("my-reef", "mine"), ("the bay/north side", "north")):
        save_world(replace(made("flat/empty", 1), name=name), tmp_path / folder)
    (tmp_path / "my-worlds.txt").write_text(code("text"))
    cases = suite_named(str(tmp_path / "my-worlds.txt"))
    assert cases[:3] == (Case("mine", 1), Case("mine", 1, 2), Case("north", 1))
    assert cases[3:] == (*(Case("reef/K", seed) for seed in range(1, 21)), Case("reef/string+1y1", 3))


def fields(content: Any) -> Iterator[str]:
    for name, value in content.items() if isinstance(content, dict) else ():
        yield name
        yield from fields(value[0] if isinstance(value, list) and value else value)


def test_the_page_names_every_file_field_and_column(tmp_path: Path) -> None:
    save_world(made("flat/empty", 1), tmp_path)
    told = set(re.findall(r"`([^`]+)`", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)))
    assert {path.name for path in tmp_path.iterdir()} <= told
    assert set(COLUMNS.split(",")) <= told
    # `name` of the water, too, is told by that word.
    assert set(fields(json.loads((tmp_path / "world.json").read_text()))) <= told
