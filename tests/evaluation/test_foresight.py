"""What an area will take: the interval of one more mission, and what a plan tells."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dream.cli import run_command
from dream.evaluation.foresight import Foreseen, Foresight, cases_in, held, quantile, spread
from dream.evaluation.plan_report import told, write_plan
from dream.evaluation.results import Flown
from dream.evaluation.suites import Case
from dream.homeward import Budget
from dream.protocol import DREAM_V1, protocol_named
from dream.sim.sizes import Size
from tests.engines import InProcess
from tests.evaluation.benches import Made, flown

SIZE = Size(40, 30)


def timed(case: Case, made: Made, pace: float) -> Flown:
    """A mission whose steps take so many seconds each, at 90 W."""
    mission = flown(case, "belief", made)
    seconds = pace * np.arange(mission.row.steps + 1, dtype=np.float64)
    return replace(mission, trace=replace(mission.trace, seconds=seconds, drawn_wh=seconds / 40.0))


def missions(*made: Made, pace: float = 5.0) -> tuple[Flown, ...]:
    return tuple(timed(Case("reef/mound+40x30", k), one, pace) for k, one in enumerate(made))


# ------------------------------------------------------------------------------------------------ intervals


def test_quantiles_of_ordered_values_are_those_of_the_order_statistics() -> None:
    for n, expected in ((9, (1.0, 5.0, 9.0)), (19, (2.0, 10.0, 18.0)), (4, (1.0, 2.5, 4.0))):
        values = list(range(n, 0, -1))
        assert [quantile(values, share) for share in (0.1, 0.5, 0.9)] == pytest.approx(expected)


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng, n: rng.exponential(1.0, n),
        lambda rng, n: rng.lognormal(0.0, 1.5, n),
        lambda rng, n: np.where(rng.random(n) < 0.3, 10.0, 0.0) + rng.normal(0.0, 1.0, n),
    ],
    ids=["exponential", "lognormal", "two heaps"],
)
@pytest.mark.parametrize("n", [2, 5, 8, 9, 19])
def test_one_more_mission_lies_within_as_often_as_is_said(
    draw: Callable[[np.random.Generator, int], np.ndarray[tuple[int, ...], np.dtype[np.float64]]], n: int
) -> None:
    rng = np.random.default_rng(n)
    trials, within = 1500, 0
    for _ in range(trials):
        *known, one_more = draw(rng, n + 1)
        found = spread(known)
        within += found.low <= one_more <= found.high
    assert within / trials == pytest.approx(held(n), abs=4.0 * math.sqrt(0.25 / trials))


def test_too_few_missions_promise_less() -> None:
    assert [held(n) for n in (2, 4, 8, 9, 50)] == pytest.approx([1 / 3, 3 / 5, 7 / 9, 0.8, 0.8])


def test_what_was_cut_short_makes_a_quantile_a_lower_bound() -> None:
    values = [float(v) for v in range(1, 10)]
    assert spread(values).at_least == (False, False, False)
    assert spread(values, [v == 9.0 for v in values]).at_least == (False, False, True)
    assert spread(values, [v == 3.0 for v in values]).at_least == (False, True, True)
    assert spread(values, [True] * 9).at_least == (True, True, True)


# ------------------------------------------------------------------------------------------------- missions


def test_more_missions_begin_with_the_same_worlds() -> None:
    kinds = ("reef/mound", "reef/tiny", "wreck/2")
    many = cases_in(Size(40, 30, 6.0), kinds, 200, 900_000)
    assert cases_in(Size(40, 30, 6.0), kinds, 5, 900_000) == many[:5]
    assert [case.seed for case in many[:3]] == [900_000, 900_001, 900_002]
    counts = [sum(case.world == f"{kind}+40x30v6" for case in many) for kind in kinds]
    assert sum(counts) == 200
    assert min(counts) > 40


def test_coverage_over_time_is_what_was_seen_by_then() -> None:
    # One sees all in 100 s, the other in 200 s; what a mission ended with stays.
    foresight = Foresight(missions(Made(20.0, 20), Made(40.0, 40)))
    at = foresight.moments
    assert at[-1] == 200.0
    stepped = np.floor(at / 5.0 + 1e-9)
    assert foresight.coverage == pytest.approx(
        np.stack([np.minimum(stepped / 20, 1), stepped / 40]).round(6), abs=1e-6
    )
    assert foresight.band()[1] == pytest.approx(foresight.coverage.mean(axis=0))


def test_one_that_is_late_is_not_home_in_time() -> None:
    both = missions(Made(30.0, 20), Made(30.0, 21))
    assert Foresight(both).home == 2
    assert Foresight(both, Budget(seconds=100.0)).home == 1
    out = (both[0], replace(both[1], row=replace(both[1].row, ended="cap", t_stop=None)))
    assert Foresight(out).home == 1


def test_one_mission_has_no_spread() -> None:
    with pytest.raises(ValueError, match="2 or more"):
        Foresight(missions(Made(20.0, 20)))


def test_traces_without_a_clock_are_refused() -> None:
    old = tuple(
        replace(one, trace=replace(one.trace, seconds=None)) for one in missions(Made(9.0), Made(9.0))
    )
    with pytest.raises(ValueError, match="expected a clock"):
        _ = Foresight(old).seconds


# ------------------------------------------------------------------------------------------------ the plan


@pytest.fixture
def foreseen() -> Foreseen:
    free = Foresight(missions(Made(20.0, 24), Made(35.0, 40), Made(400.0)))
    within = Foresight(missions(Made(20.0, 11), Made(35.0, 12), Made(400.0, 12)), Budget(seconds=60.0))
    return Foreseen(SIZE, ("reef/mound", "wreck/<1>"), "belief", DREAM_V1, free, within)


def test_a_plan_tells_how_sure_it_is_and_what_was_cut_short(foreseen: Foreseen) -> None:
    words = "\n".join(told(foreseen))
    assert "between the outer two figures with 50 %: 3 are too few" in words
    assert "1 of 3 were not complete (2 done, 1 out of steps)" in words
    assert "≥ 16.7 min" in words
    assert "Home within 60 s: 34.3 % seen (3.0 % to 55.0 %)" in words
    assert "3 of 3 were home in time" in words
    assert "nominal" in words
    swimming = replace(foreseen, protocol=protocol_named("dream-v2-nav"))
    assert "nominal" not in "\n".join(told(swimming))


def test_a_plan_s_page_holds_its_figures_and_no_script(foreseen: Foreseen, tmp_path: Path) -> None:
    page = write_plan(tmp_path, foreseen).read_text(encoding="utf-8")
    assert page.count("<img") == 2
    assert "3.3 min" in page
    assert "wreck/&lt;1&gt;" in page
    assert "<script" not in page
    assert "{{" not in page
    plan = json.loads((tmp_path / "plan.json").read_text())
    assert plan == json.loads(json.dumps(foreseen.as_dict()))
    assert plan["free"]["time_s"] == {
        "low": 120.0, "median": 200.0, "high": 1000.0, "at_least": [False, False, True]
    }  # fmt: skip
    assert plan["within"]["budget"]["seconds"] == 60.0


LINE = [
    "plan",
    "random",
    "--area",
    "30x26",
    "--protocol",
    "dream-v1",
    "--max-steps",
    "12",
    "--seed",
    "900000",
]


def test_the_command_keeps_what_was_flown_and_flies_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)
    out = ["--out", str(tmp_path), "--json"]
    assert run_command([*LINE, *out, "--missions", "2"]) == 0
    first = json.loads(capsys.readouterr().out)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "free" / "missions").iterdir()}
    assert len(kept) == 2
    assert run_command([*LINE, *out, "--missions", "3", "--budget-s", "25"]) == 0
    second = json.loads(capsys.readouterr().out)
    assert all(path.stat().st_mtime_ns == when for path, when in kept.items())
    assert second["free"]["each"][:2] == first["free"]["each"]
    assert [one["seed"] for one in second["within"]["each"]] == [900000, 900001, 900002]
    assert all(one["time_s"] <= 25.0 for one in second["within"]["each"])
    assert second["within"]["home"] == 3
    assert (tmp_path / "plan.html").exists()
    assert first["within"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--area", "40"],
            "--area: expected metres from west to east and from south to north as 40x30, got 40",
        ),
        (["--area", "40x31"], "--area: expected two even numbers of metres from 26 to 100"),
        (["--area", "40x30", "--visibility", "50"], "--visibility: expected 1 to 30 m, got 50"),
        (["--area", "40x30", "--missions", "1"], "--missions: expected 2 to 1000"),
        (["--area", "40x30", "--worlds", "reef/mond"], 'Did you mean "reef/mound"?'),
        (["--area", "40x30", "--budget-s", "5"], "expected 10 s or more, which the first look around takes"),
        (["--area", "40x30", "--jobs", "0"], "--jobs: expected at least 1, got 0"),
        (["belif", "--area", "40x30"], 'no planner "belif". Did you mean "belief"?'),
        ([], "expected --area EASTxNORTH"),
    ],
)
def test_what_cannot_be_planned_is_told_before_anything_is_flown(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run_command(["plan", *words, "--out", str(out)]) == 2
    assert said in capsys.readouterr().err
    assert not (out / "free" / "missions").exists()
