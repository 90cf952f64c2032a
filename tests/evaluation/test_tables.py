"""The tables, from missions that are made up so that every number in them is known."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from dream.commands.bench import Outcome
from dream.errors import MissionAborted
from dream.evaluation import tables
from dream.evaluation.cells import ASKING, NONE, Table, escape_markdown
from dream.evaluation.comparison import (
    BY_BELIEF,
    Comparison,
    baselines,
    best_baseline,
    compare,
    contradictions,
    difference,
    groups,
    what_is_missing,
)
from dream.evaluation.oracle.bounds import OracleBounds
from dream.evaluation.paper_tables import UNMEASURED, paper_tables, published_tables
from dream.evaluation.report import warnings
from dream.evaluation.results import Flown, Results
from dream.evaluation.runner import Plan
from dream.evaluation.suites import Case
from dream.evaluation.summary import print_summary
from dream.planning import PLANNERS
from dream.protocol import DREAM_V1
from tests.evaluation.benches import (
    ASKED,
    GPT,
    PAPER,
    Made,
    Planners,
    bounds,
    flown,
    manifest,
    paper_missions,
)

L1, L2, W1 = Case("reef/L", 1), Case("reef/L", 2), Case("wreck/1", 1)
FAST, SLOW = Made(50, 60), Made(100, 120)


def results(missions: Sequence[Flown], cases: Sequence[Case], planners: Planners, **changes: Any) -> Results:
    rows = tuple(mission.row for mission in missions)
    traces = {mission.row.key: mission.trace for mission in missions}
    return Results(manifest(cases, planners, **changes), rows, traces)


def comparison(
    *missions: Flown,
    cases: Sequence[Case] = (L1, L2, W1),
    planners: Sequence[str] = ("sixsteps", "lawnmower"),
    **changes: Any,
) -> Comparison:
    return compare(results(missions, cases, planners, **changes))


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> dict[Case, OracleBounds]:
    """What is certified, by case; empty at first."""
    found: dict[Case, OracleBounds] = {}

    def known_bounds(
        protocol: str, world: str, seed: int, start: int, world_hash: str
    ) -> OracleBounds | None:
        assert (protocol, world_hash) == ("dream-v1", "made")
        return found.get(Case(world, seed, start))

    monkeypatch.setattr("dream.evaluation.oracle.bounds.known_bounds", known_bounds)
    return found


def row(table: Table, *names: str) -> dict[str, str]:
    """The line that begins with these names, by heading; the first of two equal headings wins."""
    line = next(line for line in table.rows if line[: len(names)] == names)
    found: dict[str, str] = {}
    for heading, cell in zip(table.headings, line, strict=True):
        found.setdefault(heading, cell)
    return found


def summary_of(made: Results, *, width: int) -> str:
    """What the terminal shows of a benchmark."""
    shown = io.StringIO()
    print_summary(made, Console(file=shown, width=width))
    return shown.getvalue()


def three_each() -> tuple[Flown, ...]:
    return tuple(
        flown(case, planner, made)
        for case in (L1, L2, W1)
        for planner, made in (("sixsteps", FAST), ("lawnmower", SLOW))
    )


def test_times_are_restricted_means_with_the_number_that_got_there() -> None:
    # 98.26 % of 50 steps is 50 (49.13), 90 % is 45; the third never gets past 75 %.
    three = comparison(
        flown(L1, "sixsteps", FAST),
        flown(L2, "sixsteps", Made(100, 120)),
        flown(W1, "sixsteps", Made(200, 150)),
        planners=["sixsteps"],
    )
    line = row(tables.times(three, "All", three.cases), "sixsteps")
    # Three worlds are too few for an interval.
    assert line["to 98.26 %"] == f"{(50 + 99 + 200) / 3:.1f} · 2/3"
    assert line["to 90 %"].startswith(f"{(45 + 90 + 200) / 3:.1f} ·")
    assert line["until its own stop"] == "110.0 · 3/3"


def test_missions_that_were_cut_short_count_as_their_own_cap() -> None:
    cut = comparison(
        *(flown(case, "random", Made(400), cap=100) for case in (L1, L2)), planners=["random"], max_steps=100
    )
    assert cut.horizon == 100
    assert row(tables.times(cut, "All", cut.cases), "random")["to 98.26 %"] == "100.0 · 0/2"
    assert cut.unreached == "100 steps"


def test_where_each_world_has_its_own_cap_what_was_never_reached_counts_as_that() -> None:
    mixed = comparison(
        flown(L1, "random", Made(400), cap=80), flown(L2, "random", Made(400), cap=120), planners=["random"]
    )
    assert row(tables.times(mixed, "All", mixed.cases), "random")["to 98.26 %"] == "100.0 · 0/2"
    assert mixed.unreached == "the cap of its world, 80 to 120 steps"
    (note,) = [note for note in tables.headline(mixed, mixed.cases).notes if "never reached" in note]
    assert note.endswith("counts as the cap of its world, 80 to 120 steps.")


def test_the_fastest_planner_stands_first() -> None:
    assert comparison(*three_each(), planners=["lawnmower", "sixsteps"]).ranked == ("sixsteps", "lawnmower")


def test_nobody_wins_by_the_worlds_it_left_out() -> None:
    # frontier is fast in the one easy world that it has flown, and slower there than the others.
    easy = comparison(
        flown(L1, "sixsteps", Made(30, 40)),
        flown(L1, "lawnmower", Made(40, 50)),
        flown(L1, "frontier", Made(50, 60)),
        *(flown(case, "sixsteps", Made(120, 130)) for case in (L2, W1)),
        *(flown(case, "lawnmower", Made(100, 110)) for case in (L2, W1)),
        planners=["frontier", "lawnmower", "sixsteps", "random"],
    )
    assert easy.shared(easy.planners, easy.cases) == (L1,)
    assert easy.ranked == ("sixsteps", "lawnmower", "frontier", "random")
    assert best_baseline(easy, easy.cases) == "lawnmower"
    assert best_baseline(easy, (L2, W1)) == "lawnmower"
    # Without a world in common there is no order.
    apart = comparison(
        flown(L1, "frontier", Made(50, 60)),
        flown(L2, "lawnmower", Made(40, 50)),
        planners=["frontier", "lawnmower"],
    )
    assert apart.standing(apart.planners, apart.cases) == {}
    assert apart.ranked == ("frontier", "lawnmower")
    assert best_baseline(apart, apart.cases) is None


def test_equal_times_are_ranked_by_what_was_seen_at_the_end() -> None:
    never = comparison(
        *(flown(case, "lawnmower", Made(400)) for case in (L1, L2, W1)),
        *(flown(case, "frontier", Made(300)) for case in (L1, L2, W1)),
        planners=["lawnmower", "frontier"],
    )
    assert never.ranked == ("frontier", "lawnmower")
    assert best_baseline(never, never.cases) == "frontier"


def test_starts_that_only_one_has_flown_are_not_compared() -> None:
    starts = [Case("reef/L", 1, start) for start in (0, 1)]
    half = comparison(
        *(flown(start, "sixsteps", Made(50 + 50 * start.start, 190)) for start in starts),
        flown(starts[0], "lawnmower", Made(60, 190)),
        cases=starts,
    )
    assert difference(half, "sixsteps", "lawnmower", half.cases).value == 50 - 59


def test_starts_of_a_world_count_as_one_world() -> None:
    starts = [Case("reef/L", 1, start) for start in (0, 1)]
    both = comparison(
        flown(starts[0], "sixsteps", Made(50, 60)),
        flown(starts[1], "sixsteps", Made(100, 120)),
        flown(W1, "sixsteps", Made(150, 160)),
        cases=[*starts, W1],
        planners=["sixsteps"],
    )
    found = both.estimate("sixsteps", both.cases, both.time("t98"))
    assert found.count == 2
    assert found.value == ((50 + 99) / 2 + 148) / 2


def test_groups_leave_out_what_says_the_same() -> None:
    every = groups(comparison(cases=PAPER))
    assert {title: len(cases) for title, cases in every.items()} == {
        "All worlds": 15,
        "Reefs together": 10,
        "Fringing reefs": 1,
        "String reefs": 1,
        "Patch reefs": 1,
        "Mixed reefs": 2,
        "Letter reefs": 5,
        "Wrecks": 5,
    }
    assert list(groups(comparison(cases=[L1, L2]))) == ["All worlds"]
    own = Case("my-world", 1)
    assert groups(comparison(cases=[L1, own]))["Other worlds"] == (own,)


def test_the_best_baseline_is_no_planner_of_ours() -> None:
    assert baselines(["sixsteps", "random", "unheard-of", "lawnmower"]) == ["random", "lawnmower"]
    assert best_baseline(comparison(*three_each()), (L1, L2, W1)) == "lawnmower"
    alone = comparison(flown(L1, "sixsteps", FAST), planners=["sixsteps"])
    assert best_baseline(alone, alone.cases) is None


@pytest.mark.parametrize(
    ("parameters", "title"),
    [
        ({"weights": None}, "uivnav (our re-implementation)"),
        ({"weights": "mine.onnx"}, "uivnav (our re-implementation; another network)"),
    ],
)
def test_what_we_wrote_after_a_paper_is_called_so_wherever_it_stands(
    parameters: dict[str, Any], title: str
) -> None:
    made = results([flown(L1, "uivnav", FAST)], (L1,), ["uivnav"])
    found = compare(replace(made, manifest={**made.manifest, "planners": {"uivnav": parameters}}))
    assert found.planners == (title,)
    assert row(tables.headline(found, (L1,)), title)
    assert baselines(found.planners) == [title]


def test_planners_are_compared_in_the_worlds_that_both_have_flown() -> None:
    half = comparison(*(m for m in three_each() if m.row.key[1:] != ("reef/L", 2, 0, "lawnmower")))
    line = row(tables.against_the_best_baseline(half), "All worlds", "sixsteps", "lawnmower")
    assert line["pairs"] == "2"
    assert line["t98 minus the baseline's"] == "−49.0"
    assert line["P(better)"].startswith("1.00 (")
    assert half.missing == 1


def test_p_values_are_corrected_for_their_number() -> None:
    paper = compare(results(paper_missions(), PAPER, ["sixsteps", "lawnmower", "frontier", "random"]))
    table = tables.against_the_best_baseline(paper)
    assert len(table.rows) == 9
    ours = row(table, "All worlds", "sixsteps", "lawnmower")
    assert ours["p"] == "< 0.001"
    # The smallest of the three of its block is multiplied by three: 2 of 32,768 exchanges.
    assert ours["p, Holm"] == "< 0.001"
    wrecks = row(table, "Wrecks", "sixsteps", "lawnmower")
    assert wrecks["p"] == "0.062"
    # 3/16: of nine it would be more.
    assert wrecks["p, Holm"] == "0.188"


def test_what_stopped_by_itself_with_too_little_seen_is_counted_apart_from_what_ran_into_the_cap() -> None:
    three = comparison(
        flown(L1, "sixsteps", FAST),  # Saw it all and stopped.
        flown(L2, "sixsteps", Made(200, 150)),  # Stopped at three quarters.
        flown(W1, "sixsteps", Made(400, None)),  # Never stopped.
        planners=["sixsteps"],
    )
    line = row(tables.headline(three, three.cases), "sixsteps")
    assert line["success"].startswith("1/3")
    assert line["stopped too early"] == "1/3"


def test_everybody_is_held_against_the_papers_steps_too_where_these_were_flown() -> None:
    both = comparison(*three_each())
    line = row(tables.against_the_papers_planner(both), "All worlds", "lawnmower", "sixsteps")
    assert line["t98 minus the other's"].startswith("49.0")
    assert line["P(better)"].startswith("0.00 (")
    alone = comparison(
        *(each for each in three_each() if each.row.planner == "lawnmower"), planners=["lawnmower"]
    )
    assert not tables.against_the_papers_planner(alone).rows


def test_wrecks_stand_design_by_design_where_there_are_several_of_each() -> None:
    cases = [Case(f"wreck/{number}", seed) for number in (1, 5) for seed in (1, 2)]
    makes = (Made(400, None), Made(400, None), FAST, Made(400, None))
    wrecks = comparison(*(flown(c, "sixsteps", m) for c, m in zip(cases, makes, strict=True)), cases=cases)
    table = next(table for table in tables.by_family(wrecks) if table.name == "wrecks-by-design")
    line = row(table, "sixsteps")
    assert line["wreck/1 (2)"] == "50.0 % · 0/2"
    assert line["wreck/5 (2)"] == "75.0 % · 1/2"
    assert "The wrecks are of 2 designs" in tables.against_the_best_baseline(wrecks).notes[0]
    one_each = comparison(*three_each())
    assert "wrecks-by-design" not in {table.name for table in tables.by_family(one_each)}
    assert "designs" not in tables.against_the_best_baseline(one_each).notes[0]


def test_ratios_stand_side_by_side_and_leave_collisions_out(known: dict[Case, OracleBounds]) -> None:
    known[L1] = bounds(L1, (25, 40), (30, None))
    known[L2] = bounds(L2, (20, 20), (20, 20))
    missions = [flown(L1, "sixsteps", FAST), flown(L2, "sixsteps", replace(FAST, collides_at=9))]
    line = row(tables.efficiency(comparison(*missions), "All", (L1, L2)), "sixsteps")
    assert line["t98 ÷ certified bound"] == "2.00 · 1/1"
    assert line["t98 ÷ best known tour"] == "1.25 · 1/1"
    # No tour to 100 % is known there, and both columns are over the same worlds.
    assert line["t100 ÷ certified bound"] == line["t100 ÷ best known tour"] == NONE
    # The one that collided scores 0 over both.
    assert line["SPL"] == "0.25"
    assert line["soft SPL"] == f"{0.5 * 25 / 60:.2f}"


def test_ratios_that_hold_unreached_marks_say_so(known: dict[Case, OracleBounds]) -> None:
    for case in (L1, L2):
        known[case] = bounds(case, (25, 40), (30, 50))
    known[W1] = bounds(W1, (25, None), (30, None))
    some = comparison(
        flown(L1, "sixsteps", FAST),
        flown(L2, "sixsteps", Made(400)),
        flown(W1, "sixsteps", FAST),
        *(flown(case, "lawnmower", SLOW) for case in (L1, L2)),
    )
    table = tables.efficiency(some, "All", some.cases)
    ours, theirs = row(table, "sixsteps"), row(table, "lawnmower")
    assert ours["t98 ÷ certified bound"] == f"≥ {(2 + 8) / 2:.2f} · 1/2"
    assert ours["t98 ÷ best known tour"] == f"≥ {(1.25 + 5) / 2:.2f} · 1/2"
    assert theirs["t98 ÷ certified bound"] == f"{99 / 25:.2f} · 2/2"
    assert "≥ stands where some did not" in table.notes[0]
    headline = row(tables.headline(some, some.cases), "sixsteps")
    assert headline["t98 ÷ best known tour"] == "≥ 3.12 · 1/2"
    *_, far = tables.by_family(some)
    assert row(far, "sixsteps")["All worlds (3)"] == "≥ 3.12 · 1/2"
    assert row(far, "lawnmower")["All worlds (3)"] == f"{99 / 40:.2f} … {99 / 25:.2f} · 2/2"
    missions = [flown(L1, "sixsteps", FAST), flown(L2, "sixsteps", Made(400))]
    summary = summary_of(results(missions, (L1, L2), ["sixsteps"]), width=140)
    assert "≥ 5.00 │" in summary


def test_the_summary_says_of_how_many_missions_a_ratio_is(known: dict[Case, OracleBounds]) -> None:
    known[L1] = bounds(L1, (25, 40), (30, 50))
    missions = [flown(case, "sixsteps", FAST) for case in (L1, L2, W1)]
    summary = summary_of(results(missions, (L1, L2, W1), ["sixsteps"]), width=120)
    every, reefs, wrecks = (line for line in summary.splitlines() if "sixsteps" in line)
    assert "│ 2.00 (1 of 3) │" in every
    assert "│ 2.00 (1 of 2) │" in reefs
    assert f" {NONE} │" in wrecks


def test_missions_too_short_for_any_tour_have_no_ratio(known: dict[Case, OracleBounds]) -> None:
    known[L1] = bounds(L1, (60, 90), (95, 120))
    cut = comparison(flown(L1, "sixsteps", SLOW, cap=80), cases=[L1], planners=["sixsteps"], max_steps=80)
    line = row(tables.efficiency(cut, "All", (L1,)), "sixsteps")
    assert {line[heading] for heading in line if "÷" in heading} == {NONE}


def test_without_bounds_there_are_no_ratios(known: dict[Case, OracleBounds]) -> None:
    line = row(tables.efficiency(comparison(*three_each()), "All", (L1, L2, W1)), "sixsteps")
    assert set(line.values()) == {"sixsteps", NONE}


def test_the_table_of_bounds_never_calls_a_tour_the_optimum_without_proof(
    known: dict[Case, OracleBounds],
) -> None:
    known[L1] = bounds(L1, (25, 40), (30, None))
    known[L2] = bounds(L2, (20, 20), (21, 21))
    table = tables.bounds_table(comparison(*three_each()))
    assert table.rows == (
        ("reef/L 1", "400", "25", "40", "38 %", "gap", "30", NONE, NONE, "no tour known"),
        ("reef/L 2", "400", "20", "20", "0 %", "optimal", "21", "21", "0 %", "optimal"),
    )


def test_a_mission_below_a_certified_bound_is_told(known: dict[Case, OracleBounds]) -> None:
    known[L1] = bounds(L1, (50, 50), (51, 51))
    known[L2] = bounds(L2, (51, 60), (51, 60))
    assert contradictions(comparison(flown(L1, "sixsteps", FAST))) == [
        "sixsteps took 50 steps to t100 in reef/L 1, below the bound 51"
    ]
    assert not contradictions(comparison(flown(L2, "sixsteps", replace(FAST, collides_at=3))))


def test_the_look_around_is_below_a_bound_that_comes_after_it(known: dict[Case, OracleBounds]) -> None:
    known[L1] = bounds(L1, (3, 3), (3, 3))
    told = contradictions(comparison(flown(L1, "sixsteps", Made(2, 10))))
    assert told[0] == "sixsteps took 2 steps to t98 in reef/L 1, below the bound 3"


def test_the_papers_tables_count_the_planners_own_stop() -> None:
    first, second = paper_tables(
        comparison(
            flown(L1, "sixsteps", FAST),
            flown(L2, "sixsteps", Made(400)),
            flown(W1, "sixsteps", FAST, area=0.875),
            planners=["sixsteps"],
        )
    )
    assert row(first, "sixsteps")["steps"] == "130.0"
    assert row(first, "sixsteps")["coverage, %"] == "75.00"
    assert row(second, "sixsteps")["coverage, %"] == "87.50"
    for table in (first, second):
        assert [line[0] for line in table.rows if UNMEASURED in line] == [
            "UIVNav (our re-implementation)",
            "planners that ask a vision-language model",
        ]


def test_what_is_measured_is_no_longer_called_unmeasured() -> None:
    asked = comparison(
        flown(L1, "uivnav", FAST),
        flown(L1, "gpt", FAST, vlm_calls=60),
        cases=[L1],
        planners=["uivnav", "gpt"],
    )
    (table,) = paper_tables(asked)
    assert UNMEASURED not in str(table.rows)
    assert row(tables.conduct(asked, "All", (L1,)), "gpt")["VLM calls"] == "60"


def test_published_numbers_stand_in_tables_of_their_own() -> None:
    reefs, wrecks, successor = published_tables()
    assert row(reefs, "DREAM") == {"method": "DREAM", "steps": "137.3", "coverage, %": "98.26"}
    assert row(reefs, "UIVNav")["coverage, %"] == "55.46"
    assert row(wrecks, "vanilla GPT-5")["coverage, %"] == "60.23"
    assert row(successor, "CORAL")["VLM calls"] == "547"
    ours = paper_tables(comparison(*three_each()))
    assert not {"DREAM", "CORAL", "vanilla GPT-5"} & {line[0] for table in ours for line in table.rows}


def test_conduct_adds_up_contacts_and_averages_the_way() -> None:
    missions = [
        flown(L1, "sixsteps", replace(FAST, collides_at=5), distance_m=10.0, min_clearance_m=0.02),
        flown(L2, "sixsteps", FAST, distance_m=20.0, min_clearance_m=None, planner_ms_p99=95.0),
    ]
    line = row(tables.conduct(comparison(*missions), "All", (L1, L2)), "sixsteps")
    assert line["contacts"] == "1"
    assert line["missions with one"] == "1"
    assert line["success"].startswith("1/2 (")
    assert line["least clearance, m"] == "0.02"
    assert line["distance, m"] == "15.0"
    assert line["worst 99th percentile"] == "95.0"
    assert row(tables.conduct(comparison(*missions), "All", (L1, L2)), "lawnmower")["distance, m"] == NONE


def test_world_by_world_says_what_never_and_what_is_missing() -> None:
    some = comparison(flown(L1, "sixsteps", replace(FAST, collides_at=5)), flown(L2, "sixsteps", Made(400)))
    table = tables.world_table(some)
    assert [row(table, world)["sixsteps"] for world in ("reef/L 1", "reef/L 2", "wreck/1 1")] == [
        "50 ×1",
        "never, 50.0 %",
        "not yet flown",
    ]


def test_missions_that_were_aborted_are_counted_and_marked_where_there_are_any() -> None:
    lost = flown(L1, "sixsteps", Made(400), ended="aborted")
    some = comparison(lost, flown(L2, "sixsteps", FAST))
    assert row(tables.conduct(some, "All", (L1, L2)), "sixsteps")["aborted"] == "1"
    table = tables.world_table(some)
    assert row(table, "reef/L 1")["sixsteps"] == "never, 50.0 %, aborted"
    assert "Aborted" in table.notes[0]
    well = comparison(flown(L2, "sixsteps", FAST))
    assert "aborted" not in tables.conduct(well, "All", (L1, L2)).headings
    assert "Aborted" not in tables.world_table(well).notes[0]


def failure(case: Case, planner: str, error: str = "ValueError: no way") -> dict[str, Any]:
    return {"world": case.world, "seed": case.seed, "start": case.start, "planner": planner, "error": error}


def test_missions_that_failed_are_told_from_those_not_yet_flown() -> None:
    failed = [failure(L1, "sixsteps"), failure(L2, "sixsteps"), failure(W1, "lawnmower", "x" * 1000)]
    # The second was flown after all, and the last two are not of this benchmark.
    failed += [failure(Case("reef/K", 9), "sixsteps"), failure(L1, "unheard-of")]
    some = comparison(flown(L2, "sixsteps", FAST), failed=failed)
    assert some.missing == 5
    assert what_is_missing(some) == "5 of 6 missions are missing (2 failed, 3 not yet flown)"
    worlds = tables.world_table(some)
    assert row(worlds, "reef/L 1")["sixsteps"] == "failed"
    assert row(worlds, "wreck/1 1")["sixsteps"] == "not yet flown"
    first, second = tables.failure_table(some).rows
    assert first == ("sixsteps", "ValueError: no way", "reef/L 1", "1")
    assert len(second[1]) == 300
    assert row(tables.headline(some, some.cases), "sixsteps")["flown"] == "1/3"
    assert "flown" not in tables.headline(comparison(*three_each()), (L1, L2, W1)).headings


def test_the_headline_of_no_success_at_all() -> None:
    never = comparison(*(flown(case, "random", Made(400)) for case in (L1, L2, W1)), planners=["random"])
    line = row(tables.headline(never, never.cases), "random")
    assert line["success"] == "0/3 (0–56 %)"
    assert line["t98, mean"] == "200.0"
    assert line["coverage at the end, %"] == "50.00"


def test_markdown_shows_any_text_as_it_is() -> None:
    hostile = "a|b <script>*x*</script> [y](z) `c` #d\n# e"
    table = Table("t", hostile, ("name", "n"), ((hostile, "1"),), (hostile,))
    text = table.markdown()
    lines = text.splitlines()
    assert lines[2] == "| name | n |"
    assert lines[3] == "| :-- | --: |"
    assert lines[4].count("|") - lines[4].count("\\|") == 3
    assert "<script>" not in text
    assert "\n# e" not in text
    assert escape_markdown("[y](z)") == "\\[y\\](z)"


def test_the_summary_names_planners_and_what_is_missing() -> None:
    printed = summary_of(results(three_each()[:5], (L1, L2, W1), ["sixsteps", "lawnmower"]), width=120)
    assert "sixsteps" in printed
    assert "Wrecks (1)" in printed
    assert "1 of 6 missions is missing (1 not yet flown)" in printed


def asking(parameters: dict[str, Any], **changes: Any) -> Results:
    """`dream` asked a model in two worlds, `sixsteps` asked none."""
    missions = [
        flown(L1, "dream", FAST, **ASKED),
        flown(L2, "dream", FAST, **{**ASKED, "vlm_calls": 40, "mission_s": 600.0, **changes}),
        flown(L1, "sixsteps", SLOW, mission_s=240.0),
        flown(L2, "sixsteps", SLOW, mission_s=360.0),
    ]
    return results(missions, (L1, L2), {"dream": {**GPT, **parameters}, "sixsteps": {}})


def test_every_two_that_asked_a_model_are_held_against_each_other_world_by_world() -> None:
    assert tables.between_models(compare(asking({}))).rows == ()
    made = asking({})
    rows = (*made.rows, *(replace(row, planner="dream+b") for row in made.rows if row.planner == "sixsteps"))
    asked = tuple(replace(row, vlm_questions=50, vlm_fallbacks=0, vlm_calls=50) for row in rows)
    rows = tuple(new if row.planner == "dream+b" else row for row, new in zip(rows, asked, strict=True))
    planners = {**made.manifest["planners"], "dream+b": {**GPT, "model_name": "small"}}
    found = compare(replace(made, rows=rows, manifest={**made.manifest, "planners": planners}))
    (line,) = tables.between_models(found).rows
    # FAST is the faster one in both of two worlds, which proves little.
    assert line[1:4] == ("dream (openai:gpt)", "dream+b (small)", "2")
    assert line[4].startswith("-") or line[4].startswith("−")
    assert line[5].startswith("1.00")
    assert float(line[6]) == 0.5


def test_the_papers_tables_say_what_asking_took() -> None:
    (table,) = paper_tables(compare(asking({})))
    assert table.headings[-5:] == ("calls", "tokens", "US$", "minutes", "by belief, %")
    line = row(table, "dream (openai:gpt)")
    assert (line["calls"], line["tokens"], line["US$"], line["minutes"]) == (
        "50.0",
        "90000",
        "0.5000",
        "13.0",
    )
    line = row(table, "sixsteps")
    assert [line[name] for name in ASKING] == [NONE, NONE, NONE, "5.0", NONE]
    assert "at 12 s a call." in " ".join(table.notes)
    assert [line[0] for line in table.rows if UNMEASURED in line] == ["UIVNav (our re-implementation)"]
    assert {len(line) for line in table.rows} == {len(table.headings)}


def test_a_cost_that_one_mission_lacks_is_unknown_and_no_sum_of_the_others() -> None:
    found = compare(asking({}, vlm_cost_usd=None))
    assert row(paper_tables(found)[0], "dream (openai:gpt)")["US$"] == "unknown"
    assert row(tables.conduct(found, "All", (L1, L2)), "dream (openai:gpt)")["US$"] == "unknown"
    assert row(tables.conduct(found, "All", (L1, L2)), "dream (openai:gpt)")["VLM calls"] == "100"


def test_minutes_that_were_not_written_down_are_not_made_up() -> None:
    (table,) = paper_tables(compare(asking({}, mission_s=None)))
    assert row(table, "dream (openai:gpt)")["minutes"] == NONE


def test_where_no_model_was_asked_the_papers_tables_have_no_columns_for_it() -> None:
    for table in paper_tables(comparison(*three_each())):
        assert table.headings == ("method", "worlds", "steps", "coverage, %")
        assert len(table.notes) == 1


def test_planners_asked_with_different_latency_are_told_apart() -> None:
    made = asking({})
    both = {**made.manifest["planners"], "vanilla": {**GPT, "model_name": "small", "latency": 3}}
    found = compare(replace(made, manifest={**made.manifest, "planners": both}))
    (table,) = paper_tables(found)
    assert "at 12 s a call for dream (openai:gpt); at 3 s a call for vanilla (small)." in " ".join(
        table.notes
    )


@pytest.mark.parametrize("model", ["wire", "wire:slow"])
def test_what_asked_the_stand_in_is_a_wire_test_and_measures_no_model(model: str) -> None:
    found = compare(asking({"model": model}))
    assert found.planners == ("dream (wire test)", "sixsteps")
    (table,) = paper_tables(found)
    assert row(table, "dream (wire test)")["calls"] == "50.0"
    assert "planners that ask a vision-language model" in [line[0] for line in table.rows]
    assert "never what a model can do" in " ".join(table.notes)
    assert "never what a model can do" in " ".join(tables.headline(found, (L1, L2)).notes)


@pytest.mark.parametrize(("fallbacks", "missions"), [(5, None), (6, 0), (50, 2)])
def test_rows_that_belief_flew_much_of_are_marked_wherever_they_stand(
    fallbacks: int, missions: int | None
) -> None:
    made, marked = asking({}), missions is not None
    rows = tuple(
        replace(each, vlm_fallbacks=fallbacks) if each.planner == "dream" else each for each in made.rows
    )
    found = compare(replace(made, rows=rows))
    how_much = "all" if fallbacks == 50 else "partly"
    name = f"dream (openai:gpt; {how_much} belief)" if marked else "dream (openai:gpt)"
    assert set(found.planners) == {name, "sixsteps"}
    line = row(tables.headline(found, (L1, L2)), name)
    assert line["by belief, %"] == str(2 * fallbacks)
    most = f", most of those in {missions} missions" if missions else ""
    said = f"counted: {name} {2 * fallbacks} % of the questions{most}."
    printed = " ".join(summary_of(replace(made, rows=rows), width=300).split())
    assert (said in " ".join(tables.headline(found, (L1, L2)).notes)) == marked
    assert (said in " ".join(warnings(found))) == marked
    assert (said in printed) == marked


@pytest.mark.parametrize(("first", "second", "fails"), [(50, 50, True), (50, 49, False), (0, 0, False)])
def test_a_benchmark_fails_where_belief_flew_all_of_a_planner_that_asked(
    first: int, second: int, *, fails: bool, tmp_path: Path
) -> None:
    rows = asking({}).rows
    rows = (replace(rows[0], vlm_fallbacks=first), replace(rows[1], vlm_fallbacks=second), *rows[2:])
    plan = Plan("made", (L1, L2), {"dream": PLANNERS["dream"], "sixsteps": PLANNERS["sixsteps"]}, DREAM_V1)
    outcome = Outcome(plan, tmp_path, rows, (), None)
    assert outcome.as_dict()["without_answer"] == (["dream"] if fails else [])
    told = pytest.raises(
        MissionAborted, match="no answer of its model counted in any mission of dream: belief"
    )
    with told if fails else contextlib.nullcontext():
        outcome.check()


@pytest.mark.parametrize(("fallbacks", "marked"), [(2, False), (25, False), (26, True)])
def test_one_mission_that_belief_flew_marks_the_row(fallbacks: int, marked: bool) -> None:
    made = asking({})
    first = next(k for k, each in enumerate(made.rows) if each.planner == "dream")
    few = {2: 3}.get(fallbacks, 50)
    rows = list(made.rows)
    rows[first] = replace(rows[first], vlm_questions=few, vlm_fallbacks=fallbacks)
    # Of all questions of the planner these are few.
    rows = [
        replace(each, vlm_questions=500, vlm_fallbacks=0) if k != first and each.planner == "dream" else each
        for k, each in enumerate(rows)
    ]
    found = compare(replace(made, rows=tuple(rows)))
    assert all(share <= BY_BELIEF for share in found.unanswered.values())
    assert list(found.by_belief.values()) == ([1] if marked else [])
    assert ("most of those in 1 mission." in " ".join(warnings(found))) == marked


def test_who_decided_is_not_known_of_what_was_flown_before_it_was_written_down() -> None:
    made = asking({})
    rows = tuple(replace(each, vlm_questions=None) for each in made.rows)
    found = compare(replace(made, rows=rows))
    assert found.by_belief == {}
    assert row(tables.headline(found, (L1, L2)), "dream (openai:gpt)")["by belief, %"] == NONE


def test_a_model_that_is_only_called_like_the_stand_in_is_none() -> None:
    assert compare(asking({"model": "wired:x"})).planners == ("dream (wired:x)", "sixsteps")


def test_a_mission_that_failed_stands_under_the_title_of_its_planner() -> None:
    made = asking({"model": "wire"})
    failed = [{"world": "reef/L", "seed": 2, "start": 0, "planner": "dream", "error": "burnt"}]
    rows = tuple(row for row in made.rows if (row.planner, row.seed) != ("dream", 2))
    found = compare(replace(made, rows=rows, manifest={**made.manifest, "failed": failed}))
    assert found.failures == {(L2, "dream (wire test)"): "burnt"}
    assert row(tables.world_table(found), "reef/L 2")["dream (wire test)"] == "failed"


def test_the_summary_says_what_asking_took_and_that_a_wire_test_is_one() -> None:
    printed = " ".join(summary_of(asking({"model": "wire"}), width=160).split())
    for said in (
        "dream (wire test)",
        "minutes",
        "50.0",
        "13.0",
        "at 12 s a call",
        "never what a model can do",
    ):
        assert said in printed
    summary = summary_of(results(three_each(), (L1, L2, W1), ["sixsteps", "lawnmower"]), width=160)
    assert "minutes" not in summary
