"""Benchmark results as tables: the same ones for the page, for Markdown and for the terminal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dream.evaluation.cells import (
    ANYTIME,
    NONE,
    UNANSWERED,
    Table,
    about_rows,
    asked_cell,
    better_cell,
    how_many_worlds,
    improvement_cell,
    mean_share,
    number,
    p_cell,
    ratio_cell,
    ratio_note,
    reached_with_ratio,
    success_cell,
    time_cell,
    too_early_cell,
    unanswered_cell,
    with_interval,
)
from dream.evaluation.comparison import (
    FAMILIES,
    Comparison,
    best_baseline,
    difference,
    groups,
    label,
    no_difference,
    paired,
    some_asked,
    wreck_designs,
)
from dream.evaluation.results import Row
from dream.evaluation.statistics import FEW, holm, interquartile_mean, soft_spl, spl
from dream.evaluation.suites import Case

if TYPE_CHECKING:
    from dream.evaluation.oracle.bounds import Limit

PAIRED = ("worlds", "planner", "other", "pairs", "t98 minus the other's", "P(better)", "p", "p, Holm")
"""Columns of a table of any two planners, world by world."""
PAPERS = "sixsteps"
"""The planner that does the paper's six steps literally."""


def headline(comparison: Comparison, cases: Sequence[Case], title: str = "At a glance") -> Table:
    """The few numbers that matter most, best planner first."""
    reference = best_baseline(comparison, cases)
    asked = some_asked(comparison)
    incomplete = any((case, name) not in comparison.rows for case in cases for name in comparison.planners)
    rows = []
    for planner in comparison.ranked:
        t98 = comparison.time("t98")
        cap = comparison.time_limits
        rows.append(
            (
                planner,
                *([f"{len(comparison.flown(planner, cases))}/{len(cases)}"] if incomplete else []),
                success_cell(comparison, planner, cases),
                too_early_cell(comparison, planner, cases),
                with_interval(comparison.estimate(planner, cases, t98, limits=cap)),
                with_interval(
                    comparison.estimate(planner, cases, t98, statistic=interquartile_mean, limits=cap)
                ),
                with_interval(comparison.estimate(planner, cases, comparison.time("t_stop"), limits=cap)),
                with_interval(mean_share(comparison, planner, cases, "instances"), 2, scale=100),
                ratio_cell(comparison, planner, cases, "t98", "lower_bound"),
                ratio_cell(comparison, planner, cases, "t98", "best_tour"),
                str(sum(row.collisions for _, row in comparison.flown(planner, cases))),
                improvement_cell(comparison, planner, reference, cases),
                *([unanswered_cell([row for _, row in comparison.flown(planner, cases)])] if asked else []),
            )
        )
    return Table(
        "headline",
        f"{title}: {how_many_worlds(cases)}",
        (
            "planner",
            *(["flown"] if incomplete else []),
            "success",
            "stopped too early",
            "t98, mean",
            "t98, middle half",
            "own stop, mean",
            "coverage at the end, %",
            "t98 ÷ certified bound",
            "t98 ÷ best known tour",
            "contacts",
            f"better than {reference}, P" if reference else "better than the best baseline, P",
            *([UNANSWERED] if asked else []),
        ),
        tuple(rows),
        (
            "An individual is one thing that is counted: on a reef a clump of oysters, on a wreck 0.5 m of "
            "its outer surface. Success: the robot stopped by itself with at least 98.26 % of them seen "
            "and no contact. Stopped too early: by itself with less.",
            "t98: steps until 98.26 % were seen, the paper's own coverage. Middle half: the mean over the "
            "worlds without the quarter that took least and the one that took most (IQM). Own stop: steps "
            f"until it stopped by itself. What was never reached counts as {comparison.unreached}.",
            "Certified bound: no mission can do with fewer steps. Best known tour: steps of the shortest way "
            "found by a program that knows the world. A ratio of 1 is the best there is.",
            "P: share of the worlds on which a planner reached 98.26 % sooner than the other; equal ones "
            f"count half. In parentheses: {_intervals(comparison)}",
            ratio_note(comparison),
            *about_rows(comparison),
        ),
    )


def _intervals(comparison: Comparison) -> str:
    """What the intervals of the first table are."""
    if comparison.sealed:
        return (
            f"{ANYTIME}. They are of the mean over all worlds that may be drawn. The middle half has none, "
            "since it is no mean."
        )
    return (
        "95 % intervals over worlds (stratified by family, paired; Wilson's for shares); a mean over fewer "
        f"than {FEW} worlds has none, since so few cannot tell one."
    )


def _world_by_world(
    comparison: Comparison, pairs: Callable[[Sequence[Case]], Iterable[tuple[str, str]]]
) -> tuple[tuple[str, ...], ...]:
    """Lines on pairs of planners, block by block.

    Args:
        comparison: That is told of.
        pairs: Who is held against whom on some cases.
    """
    rows: list[tuple[str, ...]] = []
    for title, cases in groups(comparison).items():
        if title not in ("All worlds", "Reefs together", FAMILIES["wreck"]):
            continue
        lines: list[tuple[str, ...]] = []
        p_values: list[float] = []
        for planner, other in pairs(cases):
            ours, theirs, _ = paired(comparison, planner, other, cases)
            if not len(ours):
                continue
            told = (
                with_interval(difference(comparison, planner, other, cases)),
                better_cell(comparison, ours, theirs),
            )
            lines.append((title, planner, other, str(len(ours)), *told))
            p_values.append(no_difference(comparison, ours, theirs))
        rows += [
            (*line, p_cell(p), p_cell(q)) for line, p, q in zip(lines, p_values, holm(p_values), strict=True)
        ]
    return tuple(rows)


def _about_tests(comparison: Comparison, of: str) -> str:
    """What the columns of `_world_by_world` mean."""
    designs = len(wreck_designs(comparison))
    only = f" The wrecks are of {designs} designs, and no more than these is told of." * (designs > 0)
    kind, p = "Wilson's interval", "exchange test"
    if comparison.sealed:
        kind, p = ANYTIME, "anytime-valid test by betting"
    return (
        f"P(better): share of worlds with the smaller t98, ties count half; {kind}. p: two-sided {p} of the "
        f"paired mean difference, with Holm's correction over the {of} of a block. The blocks are separate "
        "families of tests, though they share worlds: nothing corrects for their number." + only
    )


def against_the_best_baseline(comparison: Comparison) -> Table:
    """Paired by world: difference, probability of improvement, p-values with Holm's correction by block."""

    def pairs(cases: Sequence[Case]) -> list[tuple[str, str]]:
        best = best_baseline(comparison, cases)
        return [(planner, best) for planner in comparison.ranked if best is not None and planner != best]

    return Table(
        "comparison",
        "Against the best baseline, world by world",
        (
            "worlds",
            "planner",
            "best baseline",
            "pairs",
            "t98 minus the baseline's",
            "P(better)",
            "p",
            "p, Holm",
        ),
        _world_by_world(comparison, pairs),
        (
            "The best baseline of a block is the one with the shortest mean t98 on the worlds that all "
            "baselines have flown, the one that has seen more at the end where these are equal. It is chosen "
            f"afterwards, which favours it. {_about_tests(comparison, 'planners')}",
        ),
        labels=3,
    )


def against_the_papers_planner(comparison: Comparison) -> Table:
    """The same against `sixsteps`, our literal version of the paper's planner, which is no baseline."""
    others = [planner for planner in comparison.ranked if planner != PAPERS]
    return Table(
        "against-sixsteps",
        f"Against {PAPERS}, the paper's steps done literally, world by world",
        PAIRED,
        _world_by_world(
            comparison,
            lambda _: [(planner, PAPERS) for planner in others if PAPERS in comparison.planners],
        ),
        (_about_tests(comparison, "planners"),),
        labels=3,
    )


def between_models(comparison: Comparison) -> Table:
    """The same of every two planners that asked a model: of two models, or of two prompts."""
    asked = [planner for planner in comparison.ranked if planner in comparison.unanswered]
    return Table(
        "models",
        "Between planners that ask a model, world by world",
        PAIRED,
        _world_by_world(comparison, lambda _: itertools.combinations(asked, 2)),
        (
            _about_tests(comparison, "pairs"),
            *about_rows(comparison),
        ),
        labels=3,
    )


def times(comparison: Comparison, title: str, cases: Sequence[Case]) -> Table:
    """Steps to each mark."""
    marks = ("t90", "t95", "t98", "t100", "t_stop")
    return Table(
        "times",
        f"{title}: steps",
        ("planner", "to 90 %", "to 95 %", "to 98.26 %", "to 100 %", "until its own stop", "to 98.26 %, IQM"),
        tuple(
            (
                planner,
                *(time_cell(comparison, planner, cases, mark) for mark in marks),
                with_interval(
                    comparison.estimate(
                        planner,
                        cases,
                        comparison.time("t98"),
                        statistic=interquartile_mean,
                        limits=comparison.time_limits,
                    )
                ),
            )
            for planner in comparison.ranked
        ),
        (
            f"Mean with what was never reached counted as {comparison.horizon} (restricted mean), its 95 "
            "% interval, and in how many missions the mark was reached.",
        ),
    )


def coverage(comparison: Comparison, title: str, cases: Sequence[Case]) -> Table:
    """Coverage after given steps and at the end."""
    names = ("c50", "c100", "c137", "c200", "auc", "instances", "clusters", "area")
    return Table(
        "coverage",
        f"{title}: coverage, %",
        (
            "planner",
            "after 50 steps",
            "after 100",
            "after 137",
            "after 200",
            "mean over the steps",
            "individuals at the end",
            "patches at the end",
            "area at the end",
        ),
        tuple(
            (
                planner,
                *(with_interval(mean_share(comparison, planner, cases, name), scale=100) for name in names),
            )
            for planner in comparison.ranked
        ),
        (
            "Share of the individuals seen, held after the mission ended. Patches: individuals that lie "
            "together; one is seen when half of its individuals are. Area: square metres of targets.",
        ),
    )


def efficiency(comparison: Comparison, title: str, cases: Sequence[Case]) -> Table:
    """Steps against what one who knows the world needs."""
    rows = []
    for planner in comparison.ranked:
        of_bound = comparison.estimate(
            planner, cases, lambda case, row: spl(row, comparison.limit(case, "t98"), comparison.horizon)
        )
        soft = comparison.estimate(
            planner, cases, lambda case, row: soft_spl(row, comparison.limit(case, "t98"))
        )
        cells = [
            ratio_cell(comparison, planner, cases, mark, which)
            for mark in ("t98", "t100")
            for which in ("best_tour", "lower_bound")
        ]
        rows.append((planner, *cells, with_interval(of_bound, 2), with_interval(soft, 2)))
    return Table(
        "efficiency",
        f"{title}: against one who knows the world",
        (
            "planner",
            "t98 ÷ best known tour",
            "t98 ÷ certified bound",
            "t100 ÷ best known tour",
            "t100 ÷ certified bound",
            "SPL",
            "soft SPL",
        ),
        tuple(rows),
        (
            ratio_note(comparison),
            "The fewest steps possible lie between the certified lower bound and the best known tour. So the "
            "ratio to them lies between the two columns where all reached the mark; where some did not, the "
            "column of the tour is still a lower estimate of it, and nothing bounds it from above.",
            "t100: steps until all were seen. SPL says how directly it got there, from 0, never, to 1, as "
            "fast as the bound; soft SPL counts what was seen instead of whether 98.26 % were.",
            "SPL: mean of 1[98.26 % reached] · bound ÷ max(t98, bound). Soft SPL: final share · bound ÷ "
            "max(steps flown, bound). Both against the certified bound for 98.26 %, 0 with a contact.",
        ),
    )


def conduct(comparison: Comparison, title: str, cases: Sequence[Case]) -> Table:
    """How the planners flew, and at what cost."""
    asked = some_asked(comparison)
    aborted = any(row.ended == "aborted" for row in comparison.rows.values())
    rows = []
    for planner in comparison.ranked:
        flown = [row for _, row in comparison.flown(planner, cases)]
        clearances = [row.min_clearance_m for row in flown if row.min_clearance_m is not None]

        def average(name: str, digits: int = 1, rows: Sequence[Row] = flown) -> str:
            return number(float(np.mean([getattr(row, name) for row in rows])) if rows else math.nan, digits)

        cells = [
            planner,
            success_cell(comparison, planner, cases),
            str(sum(row.collisions for row in flown)),
            str(sum(row.collisions > 0 for row in flown)),
            *([str(sum(row.ended == "aborted" for row in flown))] if aborted else []),
            number(min(clearances, default=math.nan), 2),
            average("distance_m"),
            average("turns"),
            average("guarded"),
            number(float(np.median([row.planner_ms_p50 for row in flown])) if flown else math.nan),
            number(max((row.planner_ms_p99 for row in flown), default=math.nan)),
        ]
        if asked:
            cells += [
                asked_cell(flown, name, digits, sum)
                for name, digits in (
                    ("vlm_calls", 0),
                    ("vlm_tokens", 0),
                    ("vlm_cost_usd", 2),
                    ("vlm_fallbacks", 0),
                )
            ]
        rows.append(tuple(cells))
    return Table(
        "conduct",
        f"{title}: conduct",
        (
            "planner",
            "success",
            "contacts",
            "missions with one",
            *(["aborted"] if aborted else []),
            "least clearance, m",
            "distance, m",
            "turns",
            "guarded",
            "ms a decision, median",
            "worst 99th percentile",
            *(("VLM calls", "tokens", "US$", "fallbacks") if asked else ()),
        ),
        tuple(rows),
        ("Distance, turns and guarded decisions are means over missions; times depend on the machine.",),
    )


def by_family(comparison: Comparison) -> list[Table]:
    """Planner × family, one table a measure."""
    found = groups(comparison)
    headings = ("planner", *(f"{title} ({len(cases)})" for title, cases in found.items()))

    def table(name: str, title: str, note: str, cell: Callable[[str, Sequence[Case]], str]) -> Table:
        rows = tuple(
            (planner, *(cell(planner, cases) for cases in found.values())) for planner in comparison.ranked
        )
        return Table(name, title, headings, rows, (note,))

    def time(planner: str, cases: Sequence[Case]) -> str:
        return time_cell(comparison, planner, cases, "t98")

    def final(planner: str, cases: Sequence[Case]) -> str:
        return with_interval(mean_share(comparison, planner, cases, "instances"), scale=100)

    def far(planner: str, cases: Sequence[Case]) -> str:
        low, high = (
            comparison.estimate(planner, cases, comparison.against("t98", which))
            for which in ("best_tour", "lower_bound")
        )
        reached, counted = reached_with_ratio(comparison, planner, cases, "t98")
        if not counted:
            return NONE
        # Nothing bounds the ratio from above where a mark was not reached.
        ends = [number(end.value, 2) for end in (low, high)]
        return f"{' … '.join(ends) if reached == counted else f'≥ {ends[0]}'} · {reached}/{counted}"

    designs = wreck_designs(comparison)
    kind = "anytime-valid" if comparison.sealed else "Wilson's"
    return [
        table(
            "t98-by-family",
            "Steps to 98.26 %, by family",
            "Restricted mean (95 % interval) · missions that reached it; never counts as "
            f"{comparison.unreached}.",
            time,
        ),
        table(
            "success-by-family",
            "Success, by family",
            "Missions that stopped by themselves with at least 98.26 % and no contact; "
            f"{kind} 95 % interval.",
            lambda planner, cases: success_cell(comparison, planner, cases),
        ),
        table(
            "coverage-by-family",
            "Individuals seen at the end, %, by family",
            "Mean (95 % interval).",
            final,
        ),
        table(
            "ratio-by-family",
            "Times the fewest possible steps to 98.26 %, by family",
            "To the best known tour … to the certified lower bound; the truth lies between the two. "
            "Where not all reached the mark, only the lower end is known. " + ratio_note(comparison),
            far,
        ),
        *([_by_design(comparison, designs)] if len(designs) > 1 else []),
    ]


def _by_design(comparison: Comparison, designs: Mapping[str, Sequence[Case]]) -> Table:
    """Wrecks design by design: what holds of one need not hold of another."""

    def cell(planner: str, cases: Sequence[Case]) -> str:
        seen = number(mean_share(comparison, planner, cases, "instances").value, scale=100)
        reached, flown = comparison.reached(planner, cases, "t98")
        return f"{seen} % · {reached}/{flown}" if flown else NONE

    return Table(
        "wrecks-by-design",
        "Wrecks, design by design: seen at the end, and missions that reached 98.26 %",
        ("planner", *(f"{name} ({len(cases)})" for name, cases in designs.items())),
        tuple(
            (planner, *(cell(planner, cases) for cases in designs.values())) for planner in comparison.ranked
        ),
        ("Each world has sizes, decay, place and heading of its own.",),
    )


def bounds_table(comparison: Comparison) -> Table:
    """What one who knows the world needs: certified from below, found from above."""

    def cells(limit: Limit | None) -> tuple[str, str, str, str]:
        if limit is None:
            return NONE, NONE, NONE, "unknown"
        if limit.best_tour is None:
            return str(limit.lower_bound), NONE, NONE, "no tour known"
        gap = (limit.best_tour - limit.lower_bound) / limit.best_tour
        return str(limit.lower_bound), str(limit.best_tour), f"{100 * gap:.0f} %", limit.status

    rows = []
    for case, known in comparison.bounds.items():
        rows.append(
            (
                label(case),
                str(known.countable),
                *cells(comparison.limit(case, "t98")),
                *cells(comparison.limit(case, "t100")),
            )
        )
    return Table(
        "bounds",
        "Fewest steps possible, world by world",
        (
            "world",
            "individuals",
            "98.26 %: bound",
            "tour",
            "gap",
            "status",
            "100 %: bound",
            "tour",
            "gap",
            "status",
        ),
        tuple(rows),
        (
            "Bound: no mission without a contact is faster, certified. Tour: the best that was found by "
            "one who knows the world; it is the optimum only where the status says so. Both count the "
            "look-around. Worlds of which no bound is known are left out.",
        ),
    )


def world_table(comparison: Comparison) -> Table:
    """Steps to 98.26 % of every planner in every world."""
    planners = comparison.ranked
    aborted = any(row.ended == "aborted" for row in comparison.rows.values())
    lost = " Aborted: the vehicle lost its way." if aborted else ""

    def cell(case: Case, planner: str) -> str:
        row = comparison.rows.get((case, planner))
        if row is None:
            return "failed" if (case, planner) in comparison.failures else "not yet flown"
        mark = f" ×{row.collisions}" if row.collisions else ""
        mark += ", aborted" if row.ended == "aborted" else ""
        return (str(row.t98) if row.t98 is not None else f"never, {100 * row.instances:.1f} %") + mark

    return Table(
        "worlds",
        "Steps to 98.26 %, world by world",
        ("world", *planners),
        tuple((label(case), *(cell(case, planner) for planner in planners)) for case in comparison.cases),
        (f"Never: with the share of the individuals seen at the end. ×n: n contacts.{lost}",),
    )


def failure_table(comparison: Comparison) -> Table:
    """Which missions failed, and why; equal errors of a planner together."""
    found: dict[tuple[str, str], list[str]] = {}
    for (case, planner), error in comparison.failures.items():
        found.setdefault((planner, error), []).append(label(case))
    return Table(
        "failures",
        "Missions that failed",
        ("planner", "error", "worlds", "missions"),
        tuple(
            (planner, _shortened(error), _some(worlds), str(len(worlds)))
            for (planner, error), worlds in found.items()
        ),
        ("As of the last attempt. They have no result and count nowhere: neither as 0 nor as the cap.",),
        labels=3,
    )


def _shortened(text: str, most: int = 300) -> str:
    text = " ".join(text.split())
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _some(names: Sequence[str], most: int = 5) -> str:
    return ", ".join(names) if len(names) <= most else f"{', '.join(names[:most])} and others"


def sweep_table(comparisons: Mapping[float, Comparison]) -> Table:
    """Steps to 98.26 % and coverage at the end of every planner under every reach in metres."""
    planners = tuple(dict.fromkeys(name for each in comparisons.values() for name in each.planners))
    return Table(
        "sweep",
        "By reach",
        ("planner", "reach, m", "to 98.26 %", "coverage at the end, %", "until its own stop", "success"),
        tuple(
            (
                planner,
                f"{reach:g}",
                time_cell(each, planner, each.cases, "t98"),
                with_interval(mean_share(each, planner, each.cases, "instances"), 2, scale=100),
                time_cell(each, planner, each.cases, "t_stop"),
                success_cell(each, planner, each.cases),
            )
            for planner in planners
            for reach, each in comparisons.items()
        ),
        ("Restricted mean, its 95 % interval, and in how many missions the mark was reached.",),
    )


def detail_tables(comparison: Comparison, title: str, cases: Sequence[Case]) -> list[Table]:
    """All measures of a group of worlds."""
    return [table(comparison, title, cases) for table in (times, coverage, efficiency, conduct)]
