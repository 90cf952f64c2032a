"""`docs/bluerov2.md`: what it tells one to type, copy and expect is there."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dream import commands
from dream.cli import COMMANDS, run_command
from dream.commands.dive.console import KEYS
from dream.perception.sidecar import Sidecar
from dream.robots.bluerov2.lens import Calibrated, Lens
from dream.robots.bluerov2.log import DiveLog
from dream.robots.bluerov2.parameters import rules
from dream.robots.bluerov2.standin.drill import FAULTS

ROOT = Path(__file__).parents[3]
PAGE = "\n\n".join(
    (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("bluerov2.md", "perception.md")
)
LINES = sorted(
    {found.rstrip() for found in re.findall(r"^ {4,8}(dream .*)$", PAGE.replace("\\\n", " "), re.MULTILINE)}
    | set(re.findall(r"`(dream [a-z]+ [^`]*)`", PAGE))
)


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def rows(title: str) -> list[list[str]]:
    """Cells of the table whose head holds that."""
    table = next(part for part in PAGE.split("\n\n") if part.startswith("|") and title in part.split("\n")[0])
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


@pytest.mark.parametrize("line", LINES)
def test_every_command_on_the_page_is_understood(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, *words = shlex.split(line)[1:]
    if name in ("replay", "export") and name not in COMMANDS:
        pytest.skip("not there yet")
    monkeypatch.setattr(getattr(commands, name.capitalize()), "__call__", lambda self: 0)
    assert run_command([name, *words]) == 0


def test_the_page_has_commands() -> None:
    assert len(LINES) >= 8


def test_the_parameters_on_the_page_are_those_that_are_checked() -> None:
    told = {cells[0].strip("`"): cells[2] for cells in rows("wanted")}
    assert told == {rule.name: "–" if math.isnan(rule.wanted) else f"{rule.wanted:g}" for rule in rules(255)}


def test_the_keys_on_the_page_are_those_of_the_console() -> None:
    assert [cells[0].strip("`") for cells in rows("key")] == list(KEYS)


def test_the_list_on_the_page_ends_with_go() -> None:
    (shown,) = blocks("text")
    *found, verdict = shown.strip().splitlines()
    assert verdict == "go"
    assert len(found) == 26
    assert all(line.startswith("  ok  ") or not line.startswith("  ") for line in found)


def test_the_table_of_faults_has_all_of_them() -> None:
    named = [cells[0] for cells in rows("| fault |")]
    assert named == [*(fault.name for fault in FAULTS), "the program is killed", "the program is stopped"]


def test_the_calibration_on_the_page_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(blocks("yaml")[0])
    lens = Lens.read(path)
    assert (lens.width, lens.height, lens.calibrated) == (1920, 1080, Calibrated.WATER)
    assert [cells[0].strip("`") for cells in rows("`calibrated_in`")] == list(Calibrated)


def test_the_sidecar_on_the_page_is_one() -> None:
    sidecar = Sidecar.model_validate(json.loads(blocks("json")[0]))
    assert len(sidecar.labels) == 4
    outputs = Sidecar.model_json_schema()["properties"]["output"]["enum"]
    assert [cells[0].strip("`") for cells in rows("`output`")] == outputs


def chessboard(T: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """What a pinhole of 640 x 480 sees of a board of 10 x 7 squares of 3 cm; T (3, 4) places it."""
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(matrix).T
    normal, middle = T[:, 2], T[:, 3]
    points = rays * ((middle @ normal) / (rays @ normal))[..., None] - middle
    across, down = (points @ T[:, :2] / 0.03).transpose(2, 0, 1) + 1.0
    on = (across > 0) & (across < 10) & (down > 0) & (down < 7)
    dark = on & ((np.floor(across) + np.floor(down)) % 2 == 0)
    return cv2.GaussianBlur(np.where(dark, 30, 220).astype(np.uint8), (3, 3), 0)


def test_the_calibration_that_the_page_tells_of_finds_the_lens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matrix = np.array([[500.0, 0.0, 322.0], [0.0, 500.0, 236.0], [0.0, 0.0, 1.0]])
    (tmp_path / "board").mkdir()
    rng = np.random.default_rng(1)
    for number in range(8):
        R, _ = cv2.Rodrigues(rng.uniform(-0.4, 0.4, 3))
        middle = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.3, 0.5)]) - R @ [0.12, 0.075, 0.0]
        picture = chessboard(np.column_stack([R, middle]), matrix)
        cv2.imwrite(str(tmp_path / f"board/{number}.png"), picture)
    monkeypatch.chdir(tmp_path)
    exec(blocks("python")[0], {})
    lens = Lens.read(tmp_path / "camera.yaml")
    np.testing.assert_allclose(lens.matrix, matrix, atol=5.0)
    assert lens.calibrated is Calibrated.WATER


def test_the_log_is_read_as_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with DiveLog(tmp_path, epoch_ns=10**18) as log:
        log.tap(1.25, "goal", True, {"x": 0.5})
        log.tap(2.0, "other", True, {"x": 0.5})
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(blocks("python")[1], names)
    assert capsys.readouterr().out.split()[:2] == ["1.25", "/goal"]
