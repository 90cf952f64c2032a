"""The page of results can be made from what a clone holds, and the documentation has the one that is made."""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.evaluation.metrics import COMPLETE
from dream.evaluation.results import Row, read_results
from dream.evaluation.statistics import interval, mean
from dream.evaluation.suites import Case, family_of
from dream.sim.world import World

ROOT = Path(__file__).parents[2]


def unopened(case: Case) -> World:
    """Worlds are made and drawn for pictures alone, of which this asks only the names."""
    raise ValueError(case.world)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
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
    folders = [str(tmp_path / "results" / name) for name in ("test-v2", "test", "paper", "sweep")]
    page = tmp_path / "docs/results/README.md"
    monkeypatch.setattr("dream.evaluation.suites.Case.open", unopened)
    assert run_command(["results", *folders, "--out", str(page), "--figures", str(page.parent)]) == 0
    released = ROOT / "docs/results/README.md"
    assert page.read_text(encoding="utf-8") == released.read_text(encoding="utf-8")
    made = {path.name for path in page.parent.iterdir() if path.suffix != ".md"}
    assert made == {path.name for path in released.parent.iterdir() if path.suffix != ".md"}


def test_the_page_of_the_benchmark_shows_the_tables_of_the_released_missions() -> None:
    printed = subprocess.run(
        [sys.executable, ROOT / "perf/families.py", ROOT / "results/test"],
        capture_output=True,
        text=True,
        check=True,
    )
    lines = [line for line in printed.stdout.splitlines() if line.startswith("|")]
    assert len(lines) == 24
    page = (ROOT / "docs/benchmark.md").read_text(encoding="utf-8")
    for line in lines:
        assert line in page


def test_what_is_told_of_the_worlds_to_tune_on_is_as_released() -> None:
    reefs: dict[str, list[Row]] = {}
    for row in read_results(ROOT / "results/dev").rows:
        if family_of(row.world) != "wreck":
            reefs.setdefault(row.planner, []).append(row)

    def soon(rows: list[Row]) -> float:
        return statistics.fmean(200 if row.t98 is None else row.t98 for row in rows)

    def stop(rows: list[Row]) -> float:
        return statistics.fmean(200 if row.t_stop is None else row.t_stop for row in rows)

    page = " ".join((ROOT / "docs/planner.md").read_text(encoding="utf-8").split())
    belief, baselines = reefs.pop("belief"), {name for name in reefs if name != "sixsteps"}
    assert min(baselines, key=lambda name: soon(reefs[name])) == "sweep-and-graze"
    steps = f"98.26 % are seen after {soon(belief):.1f} steps and it stops by itself after {stop(belief):.1f}"
    assert steps in page
    assert all(row.success for row in belief)
    assert len(reefs) == 6
    for name, rows in reefs.items():
        assert stop(rows) > stop(belief)
        missed = statistics.fmean(row.instances < COMPLETE for row in rows)
        seen = statistics.fmean(row.instances for row in rows)
        shares = f"{100.0 * missed:.1f} % | {stop(rows):.1f} | {100.0 * seen:.2f} %"
        assert f"| {name} | {shares} | {soon(rows):.1f} |" in page


def test_what_a_sensor_that_errs_costs_is_told_as_released() -> None:
    true, noisy = (
        {
            (row.world, row.seed): row
            for row in read_results(ROOT / "results" / folder).rows
            if row.planner == "belief"
        }
        for folder in ("test", "noisy")
    )
    assert len(noisy) == 200
    assert true.keys() == noisy.keys()
    wrecks = sorted(key for key in noisy if key[0].startswith("wreck"))
    reefs = sorted(noisy.keys() - set(wrecks))

    def costs(value: Callable[[Row], float], keys: list[tuple[str, int]], digits: int) -> str:
        change = np.array([value(noisy[key]) - value(true[key]) for key in keys])
        strata = [key[0] if key[0].startswith("wreck") else family_of(key[0]) for key in keys]
        found = interval(change, strata, mean)
        told = [f"{x:.{digits}f}".replace("-", "−") for x in (found.value, found.low, found.high)]
        return f"{told[0]} [{told[1]}, {told[2]}]"

    def stop(row: Row) -> float:
        return 200 if row.t_stop is None else row.t_stop

    def seen(row: Row) -> float:
        return 100.0 * row.instances

    def won(rows: dict[tuple[str, int], Row], keys: list[tuple[str, int]]) -> list[tuple[str, int]]:
        return [key for key in keys if rows[key].success]

    benchmark = " ".join((ROOT / "docs/benchmark.md").read_text(encoding="utf-8").split())
    assert won(noisy, reefs) == reefs
    stops = [statistics.fmean(stop(rows[key]) for key in reefs) for rows in (noisy, true)]
    assert f"succeeds on all 150 reefs, after {stops[0]:.1f} steps and not {stops[1]:.1f}" in benchmark
    assert f"(paired {costs(stop, reefs, 1)})" in benchmark
    assert won(noisy, wrecks) == won(true, wrecks)
    assert len(won(noisy, wrecks)) == 10
    assert all(row.success for row in noisy.values() if row.t_stop is not None)
    assert "Of the 50 wrecks it succeeds on the same ten" in benchmark
    shown = [statistics.fmean(seen(rows[key]) for key in wrecks) for rows in (noisy, true)]
    assert f"sees {shown[0]:.1f} %, not {shown[1]:.1f} % ({costs(seen, wrecks, 1)})" in benchmark
    assert not any(row.collisions for row in noisy.values())
    page = " ".join((ROOT / "docs/planner.md").read_text(encoding="utf-8").split())
    assert f"sees {shown[0]:.1f} %, not {shown[1]:.1f} % ({costs(seen, wrecks, 1)})" in page
    assert "succeeds on the same ten as with the true sensor, and no stop is wrong" in page


def test_who_stands_beside_uivnav_in_the_papers_form_is_told_as_released() -> None:
    rows = read_results(ROOT / "results/paper").rows
    page = (ROOT / "docs/results/uivnav.md").read_text(encoding="utf-8")
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


@pytest.mark.rare
def test_what_noise_does_to_uivnav_is_told_as_released(tmp_path: Path) -> None:
    printed = subprocess.run(
        [sys.executable, ROOT / "perf/uivnav.py", "draw", "--picture", tmp_path / "noise.svg"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    rows = [line for line in printed.stdout.splitlines() if line.startswith(("| iou", "| depth"))]
    assert len(rows) == 12
    page = (ROOT / "docs/results/uivnav.md").read_text(encoding="utf-8")
    assert all(row in page for row in rows)


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
