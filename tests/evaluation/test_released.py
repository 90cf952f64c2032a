"""The page of results can be made from what a clone holds, and the documentation has the one that is made."""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from dream.cli import run_command
from dream.evaluation.results import read_results
from dream.sim.world import World

ROOT = Path(__file__).parents[2]


def blank(world: World, *, pixels: int) -> Image.Image:
    """As large as the world's chart, whose drawing takes most of the time and needs no released file."""
    return Image.new("RGB", (pixels, pixels), "white")


@pytest.mark.slow
def test_the_page_of_results_is_made_from_the_files_that_are_tracked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("no git checkout, so that nothing says which files are tracked")
    listing = subprocess.run(
        ["git", "ls-files", "-z", "results"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    tracked = [name for name in listing.stdout.split("\0") if name]
    for name in tracked:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    folders = [str(tmp_path / "results" / name) for name in ("test", "paper", "sweep")]
    page = tmp_path / "docs/results.md"
    monkeypatch.setattr("dream.sim.chart.chart", blank)
    assert run_command(["results", *folders, "--out", str(page)]) == 0
    assert page.read_text(encoding="utf-8") == (ROOT / "docs/results.md").read_text(encoding="utf-8")
    made = {path.name for path in (tmp_path / "docs/results").iterdir()}
    assert made == {path.name for path in (ROOT / "docs/results").iterdir()}


def test_the_readme_shows_the_tables_of_the_released_missions() -> None:
    printed = subprocess.run(
        [sys.executable, ROOT / "perf/families.py", ROOT / "results/test"],
        capture_output=True,
        text=True,
        check=True,
    )
    lines = [line for line in printed.stdout.splitlines() if line.startswith("|")]
    assert len(lines) == 20
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for line in lines:
        assert line in readme


def test_who_stands_beside_uivnav_in_the_papers_form_is_told_as_released() -> None:
    rows = read_results(ROOT / "results/paper").rows
    page = (ROOT / "docs/uivnav.md").read_text(encoding="utf-8")
    for planner in {row.planner for row in rows}:
        cells = []
        for wrecks in (False, True):
            of = [row for row in rows if row.planner == planner and row.world.startswith("wreck") == wrecks]
            stop = statistics.fmean(row.t_stop if row.t_stop is not None else 200 for row in of)
            cells += [
                f"{stop:.1f}",
                f"{100 * statistics.fmean(r.area if wrecks else r.instances for r in of):.2f}",
            ]
        assert f"| `{planner}` | {' | '.join(cells)} |" in page


def test_the_table_of_wrong_answers_is_that_of_the_released_missions() -> None:
    page = (ROOT / "docs/models.md").read_text(encoding="utf-8")
    by_adviser: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for planner in ("ranked", "dream"):
        for line in (ROOT / f"results/wire/{planner}.jsonl").read_text(encoding="utf-8").splitlines():
            mission = json.loads(line)
            by_adviser.setdefault(mission["adviser"], {}).setdefault(planner, []).append(mission)
    assert len(by_adviser) == 6
    for adviser, planners in by_adviser.items():
        cells = ["`belief` alone" if adviser == "belief" else adviser.partition("error:")[2] or "0"]
        for flown in planners.values():
            t98, stop, seen = (statistics.fmean(m[mark] for m in flown) for mark in ("t98", "stop", "seen"))
            cells += [f"{t98:.1f}", f"{stop:.1f}", f"{100.0 * seen:.1f} %"]
            cells.append(str(sum(m["collisions"] for m in flown)))
        assert f"\n| {' | '.join(cells)} |\n" in page
