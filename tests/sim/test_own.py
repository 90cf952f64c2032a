"""A world of the user's own is called by a name that is true."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dream.cli import run_command
from dream.sim.files import load_world, save_world, world_hash
from dream.sim.worlds import make_world, open_world, origin
from tests.sim.made import made


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("name", "given", "called"),
    [
        ("pool/arc", {}, "pool/arc"),
        ("pool/arc", {"seed": 4}, "pool/arc (changed)"),
        ("pool/arc", {"name": "pool/bow"}, "pool/bow"),
        ("pool/arc", {"name": "wreck/1+1y1"}, "wreck/1+1y1 (changed)"),
        ("reef/patch+1y2", {}, "reef/patch+1y2"),
        ("reef/patch+1y2", {"seed": 4}, "reef/patch+1y2 (changed)"),
    ],
)
def test_a_saved_world_is_called_by_its_name_only_where_that_gives_it(
    name: str, given: dict[str, Any], called: str, tmp_path: Path
) -> None:
    world = replace(make_world(name, 3), **given)
    save_world(world, tmp_path)
    opened = open_world(str(tmp_path), 1)
    assert (opened.name, opened.seed) == (called, world.seed)
    assert world_hash(opened) == world_hash(world) == world_hash(load_world(tmp_path))
    # It stays so, also where it is saved and read again.
    save_world(opened, tmp_path)
    assert open_world(str(tmp_path), 1).name == called


def test_a_name_is_of_the_package_or_of_the_user() -> None:
    assert origin("reef/O") == origin("reef/O+1y1") == origin("reef/O+1y1+2.5y3") == "reef/O"
    for own in ("reef/O (changed)", "reef/Q", "reef/Q+1y1", "", "reef/O+1y1 (changed)"):
        assert origin(own) is None


def test_every_command_says_that_a_world_was_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    save_world(replace(made("flat/empty", 1), seed=2, starts=made("flat/empty", 1).starts[:1]), "mine")
    assert run_command(["run", "belief", "--world", "mine", "--max-steps", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["world"] == "flat/empty (changed)"
    assert json.loads(Path("runs/latest/config.json").read_text())["world"] == "flat/empty (changed)"
    assert run_command(["draw", "--world", "mine"]) == 0
    drawn = "flat/empty (changed) 2: 0 individuals, 0 obstacles → flat-empty-changed-2.png"
    assert capsys.readouterr().out.strip() == drawn
    assert run_command(["oracle", "--world", "mine", "--budget", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["world"] == "flat/empty (changed)"


def test_lines_that_come_or_go_need_their_count_changed(tmp_path: Path) -> None:
    save_world(made("pool/arc", 3), tmp_path)
    lines = (tmp_path / "targets.csv").read_text().splitlines()
    (tmp_path / "targets.csv").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(ValueError, match=r"targets\.csv: rows: .* If the file is whole, correct world\.json"):
        load_world(tmp_path)
    content = json.loads((tmp_path / "world.json").read_text())
    content["targets"] -= 1
    (tmp_path / "world.json").write_text(json.dumps(content))
    assert len(load_world(tmp_path).targets) == len(lines) - 2
