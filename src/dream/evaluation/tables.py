"""Benchmark results as tables: the same ones for the page, for Markdown and for the terminal."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from dream.evaluation import published
from dream.evaluation.results import MAX_STEPS, Results, Row
from dream.evaluation.statistics import (
    FloatArray,
    Interval,
    Statistic,
    holm,
    improvement,
    interquartile_mean,
    interval,
    mean,
    paired_p_value,
    ratio,
    share_interval,
    soft_spl,
    spl,
)
from dream.evaluation.suites import REEF_FAMILIES, Case, family_of
from dream.planning import PLANNERS
from dream.planning.vlm import WIRE_TEST, stands_in

if TYPE_CHECKING:
    from rich.console import Console

    from dream.evaluation.oracle.bounds import Bounds, Limit

NONE = "–"
"""What a table shows where nothing is known."""
UNMEASURED = "not yet measured here"

FAMILIES = {
    "fringing": "Fringing reefs",
    "string": "String reefs",
    "patch": "Patch reefs",
    "mixed": "Mixed reefs",
    "letter": "Letter reefs",
    "wreck": "Wrecks",
    "pool": "Tank",
    "flat": "Empty ground",
    "other": "Other worlds",
}
REEFS = (*REEF_FAMILIES, "letter")

BY_BELIEF = 0.1
"""Share of a planner's questions without a reply that counts from which on its rows are marked."""
MOST_OF_A_MISSION, FEW = 0.5, 3
"""Likewise in a single mission, and how many questions that must be."""

PAIRED = ("worlds", "planner", "other", "pairs", "t98 minus the other's", "P(better)", "p", "p, Holm")
"""Columns of a table of any two planners, world by world."""
PAPERS = "sixsteps"
"""The planner that does the paper's six steps literally."""

REIMPLEMENTED = {"uivnav": "our re-implementation"}
"""What is said of a planner after a paper whose code and parameters are not public."""

Measure = Callable[[Case, Row], float]
"""A number of one mission; NaN where it has none."""


def coverage_at_end(_: Case, row: Row) -> float:
    """Share of the instances that a mission has seen when it ends."""
    return row.instances


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text."""

    name: str
    """For links."""
    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    labels: int = 1
    """How many columns, from the left, hold names; the others hold numbers."""

    def markdown(self) -> str:
        """As GitHub-flavoured Markdown, with a title in bold and the notes below."""
        align = [":--" if k < self.labels else "--:" for k in range(len(self.headings))]
        lines = [_line(self.headings), _line(align, plain=True), *map(_line, self.rows)]
        parts = [f"**{escape_markdown(self.title)}**", "\n".join(lines), *map(escape_markdown, self.notes)]
        return "\n\n".join(parts) + "\n"


def escape_markdown(text: str) -> str:
    """Text that Markdown shows as it is, on one line."""
    escaped = re.sub(r"([\\`*_\[\]|#~])", r"\\\1", " ".join(text.split()))
    return escaped.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _line(cells: Iterable[str], *, plain: bool = False) -> str:
    return "| " + " | ".join(cells if plain else map(escape_markdown, cells)) + " |"


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Planners over worlds: the missions of one benchmark folder and what is certified about its worlds."""

    planners: tuple[str, ...]
    """In the order of the benchmark."""
    cases: tuple[Case, ...]
    rows: Mapping[tuple[Case, str], Row]
    """Finished missions."""
    bounds: Mapping[Case, Bounds]
    """Where they are known."""
    protocol: str
    horizon: int
    """Steps that a mission had; an unreached mark counts as this many."""
    failures: Mapping[tuple[Case, str], str]
    """Missions that have no result because the last attempt failed, and why."""
    latencies: Mapping[str, float]
    """Of planners that ask a model: seconds that a call takes on the mission's clock."""
    wire_tests: tuple[str, ...]
    """Planners that asked the stand-in."""
    unanswered: Mapping[str, float]
    """Planners that asked a model: share of their questions to which no reply counted."""
    by_belief: Mapping[str, int]
    """Planners whose decisions were `belief`'s by more than `BY_BELIEF`, or that flew missions of which it
    decided most; and how many such missions there are."""

    @property
    def missing(self) -> int:
        """Missions that have no result: those that failed, and those not yet flown."""
        return len(self.cases) * len(self.planners) - len(self.rows)

    def shared(self, planners: Sequence[str], cases: Sequence[Case]) -> tuple[Case, ...]:
        """The cases that all these planners have flown; one that has flown none of them is passed over."""
        some = [name for name in planners if self.flown(name, cases)]
        return tuple(case for case in cases if some and all((case, name) in self.rows for name in some))

    def standing(self, planners: Sequence[str], cases: Sequence[Case]) -> dict[str, tuple[float, float]]:
        """What planners are ranked by, the best first: mean time to 98.26 %, mean share unseen at the end.

        Both are over those of the cases that all of them have flown, so that none gains by the worlds it
        left out: empty where there is no such case. One that has flown none of the cases is not ranked.
        What is equal stays in the order given.
        """
        shared = self.shared(planners, cases)
        found = {}
        for name in planners:
            if not self.flown(name, shared):
                continue
            means = (
                float(np.mean([*self.by_world(name, shared, measure).values()]))
                for measure in (self.time("t98"), lambda case, row: 1.0 - coverage_at_end(case, row))
            )
            time, unseen = (round(value, 9) for value in means)  # Equal ones differ by rounding only.
            found[name] = time, unseen
        return dict(sorted(found.items(), key=lambda item: item[1]))

    @property
    def ranked(self) -> tuple[str, ...]:
        """All planners, the fastest to 98.26 % first; see `standing`. Those that cannot be ranked last."""
        return tuple(dict.fromkeys([*self.standing(self.planners, self.cases), *self.planners]))

    def flown(self, planner: str, cases: Sequence[Case]) -> list[tuple[Case, Row]]:
        """The finished missions of a planner, in the order of the cases."""
        return [(case, self.rows[case, planner]) for case in cases if (case, planner) in self.rows]

    def by_world(self, planner: str, cases: Sequence[Case], measure: Measure) -> dict[tuple[str, int], float]:
        """A measure for each world (name, seed): the mean over its starts, where it has a value."""
        found: dict[tuple[str, int], list[float]] = {}
        for case, row in self.flown(planner, cases):
            value = measure(case, row)
            if not math.isnan(value):
                found.setdefault((case.world, case.seed), []).append(value)
        return {world: float(np.mean(values)) for world, values in found.items()}

    def estimate(
        self,
        planner: str,
        cases: Sequence[Case],
        measure: Measure,
        *,
        statistic: Statistic = mean,
        limits: tuple[float, float] = (0.0, math.inf),
    ) -> Interval:
        """A statistic of a measure over worlds, with its interval."""
        values = self.by_world(planner, cases, measure)
        return interval(np.array([*values.values()]), list(map(_family, values)), statistic, limits=limits)

    def time(self, mark: str) -> Measure:
        """Steps to a mark (`t90` … `t_stop`), the horizon where it was not reached."""

        def steps(case: Case, row: Row) -> float:
            value = getattr(row, mark)
            return float(self.horizon if value is None else min(value, self.horizon))

        return steps

    def against(self, mark: str, which: str) -> Measure:
        """Steps to `t98` or `t100` over the `lower_bound` or the `best_tour` for it.

        Both ratios are of the same missions: of those that have both.
        """

        def steps(case: Case, row: Row) -> float:
            limit = self.limit(case, mark)
            if limit is None or limit.best_tour is None:
                return math.nan
            ratios = {
                name: ratio(row, getattr(row, mark), length, self.horizon)
                for name, length in (("lower_bound", limit.lower_bound), ("best_tour", limit.best_tour))
            }
            return math.nan if any(map(math.isnan, ratios.values())) else ratios[which]

        return steps

    def limit(self, case: Case, mark: str) -> Limit | None:
        """What is known of the fewest steps to `t98` or `t100`."""
        bounds = self.bounds.get(case)
        return None if bounds is None else bounds.full if mark == "t100" else bounds.t98

    def reached(self, planner: str, cases: Sequence[Case], mark: str) -> tuple[int, int]:
        """Missions that reached a mark within the horizon, and missions."""
        flown = self.flown(planner, cases)
        times = [getattr(row, mark) for _, row in flown]
        return sum(time is not None and time <= self.horizon for time in times), len(flown)


def compare(results: Results) -> Comparison:
    """Arrange the missions of a benchmark folder, and look up what is certified about its worlds."""
    saved = results.manifest.get("worlds", {})
    cases = dict.fromkeys(
        Case(
            str(case["world"]),
            int(case["seed"]),
            int(case.get("start", 0)),
            **saved.get(f"{case['world']} {case['seed']}", {}),
        )
        for case in results.manifest["cases"]
    )
    given = results.manifest["planners"]
    unanswered = _unanswered(results.rows)
    by_belief = _by_belief(results.rows, unanswered)
    titles = {
        name: title(name, parameters, by_belief=name in by_belief) for name, parameters in given.items()
    }
    rows: dict[tuple[Case, str], Row] = {}
    bounds: dict[Case, Bounds] = {}
    for row in results.rows:
        case = Case(row.world, row.seed, row.start)
        cases.setdefault(case)
        rows[case, titles.get(row.planner, row.planner)] = row
        if case not in bounds and (known := _bounds(row)) is not None:
            bounds[case] = known
    protocol = results.manifest["protocol"]
    cap = protocol.get("cap")
    if type(cap) is not int or not 1 <= cap <= MAX_STEPS:
        raise ValueError(f"manifest.json: protocol.cap: expected 1 to {MAX_STEPS} steps, got {cap!r:.80}")
    asked = results.manifest["max_steps"]
    planners = tuple(dict.fromkeys([*titles.values(), *(planner for _, planner in rows)]))
    failures = {
        (
            Case(str(entry["world"]), int(entry["seed"]), int(entry["start"])),
            titles.get(str(entry["planner"]), str(entry["planner"])),
        ): str(entry["error"])
        for entry in results.manifest.get("failed", [])
    }
    return Comparison(
        planners=planners,
        cases=tuple(cases),
        rows=rows,
        bounds=bounds,
        protocol=str(protocol.get("name")),
        horizon=cap if asked is None else min(cap, int(asked)),
        failures={
            (case, planner): error
            for (case, planner), error in failures.items()
            if case in cases and planner in planners and (case, planner) not in rows
        },
        latencies={
            titles[name]: float(parameters["latency"])
            for name, parameters in given.items()
            if is_number(parameters.get("latency"))
        },
        wire_tests=tuple(titles[name] for name, parameters in given.items() if is_wire_test(parameters)),
        unanswered={titles.get(name, name): share for name, share in unanswered.items()},
        by_belief={titles.get(name, name): missions for name, missions in by_belief.items()},
    )


def _unanswered(rows: Iterable[Row]) -> dict[str, float]:
    """By planner, the share of its questions to which no reply counted; of those where it is known."""
    questions: Counter[str] = Counter()
    fallbacks: Counter[str] = Counter()
    for row in rows:
        if row.vlm_questions is not None:
            questions[row.planner] += row.vlm_questions
            fallbacks[row.planner] += row.vlm_fallbacks or 0
    return {planner: fallbacks[planner] / count for planner, count in questions.items() if count}


def _by_belief(rows: Iterable[Row], unanswered: Mapping[str, float]) -> dict[str, int]:
    """See `Comparison.by_belief`; with what `_unanswered` has of the same rows."""
    missions = Counter(
        row.planner
        for row in rows
        if row.vlm_questions is not None
        and (row.vlm_fallbacks or 0) >= FEW
        and (row.vlm_fallbacks or 0) > MOST_OF_A_MISSION * row.vlm_questions
    )
    return {
        planner: missions[planner]
        for planner, share in unanswered.items()
        if share > BY_BELIEF or missions[planner]
    }


def title(planner: str, parameters: Mapping[str, Any], *, by_belief: bool) -> str:
    """What a planner is called in tables: one that asks a model together with that model.

    Args:
        planner: Its name.
        parameters: Of it.
        by_belief: Was it `belief` that decided much of it?
    """
    model = str(parameters.get("model_name") or parameters.get("model") or "")
    told = [
        REIMPLEMENTED.get(planner, ""),
        "another network" if parameters.get("weights") else "",
        "wire test" if is_wire_test(parameters) else model,
        "own prompts" if parameters.get("prompts") else "",
        "partly belief" if by_belief else "",
    ]
    said = "; ".join(filter(None, told))
    return f"{planner} ({said})" if said else planner


def is_wire_test(parameters: Mapping[str, Any]) -> bool:
    """Did a planner with these parameters ask the stand-in?"""
    return stands_in(str(parameters.get("model", "")))


def is_number(value: Any) -> bool:
    """A finite number in a file that anybody may have written."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def about_wire_tests(comparison: Comparison) -> str:
    """What must stand beside rows that were flown with the stand-in; empty where there are none."""
    if not comparison.wire_tests:
        return ""
    return f"{', '.join(comparison.wire_tests)}: flown with the stand-in for a model, {WIRE_TEST}."


def about_by_belief(comparison: Comparison) -> str:
    """What must stand beside rows of which `belief` decided much; empty where there are none."""
    told = "; ".join(
        f"{name} {100 * comparison.unanswered[name]:.0f} % of the questions"
        + (f", most of those in {missions} mission{'s' if missions != 1 else ''}" if missions else "")
        for name, missions in comparison.by_belief.items()
    )
    if not told:
        return ""
    return (
        f"Decided by belief, since no reply of the model counted: {told}. These rows do not show what the "
        "model can do; a mission without any reply is no success."
    )


def about_rows(comparison: Comparison) -> list[str]:
    """What must stand beside some rows."""
    return [said for said in (about_wire_tests(comparison), about_by_belief(comparison)) if said]


def _bounds(row: Row) -> Bounds | None:
    from dream.evaluation.oracle.bounds import known_bounds

    return known_bounds(row.protocol, row.world, row.seed, row.start, row.world_hash)


def family(case: Case) -> str:
    """The family of a case's world, `other` for a world of the user's own."""
    return _family((case.world, case.seed))


def _family(world: tuple[str, int]) -> str:
    try:
        return family_of(world[0])
    except ValueError:
        return "other"


def groups(comparison: Comparison) -> dict[str, tuple[Case, ...]]:
    """Worlds that are reported together, by title: all, reefs, wrecks, then each family that occurs."""
    kinds = {case: family(case) for case in comparison.cases}
    found = {
        "All worlds": comparison.cases,
        "Reefs together": tuple(case for case, kind in kinds.items() if kind in REEFS),
    }
    for kind, title in FAMILIES.items():
        found[title] = tuple(case for case, other in kinds.items() if other == kind)
    different: dict[frozenset[Case], str] = {}
    for title, cases in found.items():
        if cases:
            different.setdefault(frozenset(cases), title)
    return {title: found[title] for title in different.values()}


def baselines(planners: Iterable[str]) -> list[str]:
    """Those of the planners that are baselines by where their code stands."""
    return [
        name
        for name, planner in ((name, PLANNERS.get(name.partition(" (")[0])) for name in planners)
        if type(planner).__module__.startswith("dream.planning.baselines")
    ]


def best_baseline(comparison: Comparison, cases: Sequence[Case]) -> str | None:
    """The first of the baselines on these cases; see `Comparison.standing`.

    It is chosen on the same missions that it is then compared on, which favours it. None where there is no
    baseline, or no case that all of them have flown.
    """
    return next(iter(comparison.standing(baselines(comparison.planners), cases)), None)


def what_is_missing(comparison: Comparison) -> str:
    """How many missions have no result, and why not."""
    missing, failed = comparison.missing, len(comparison.failures)
    every = missing + len(comparison.rows)
    why = [f"{failed} failed"] * bool(failed) + [f"{missing - failed} not yet flown"] * (missing > failed)
    return f"{missing} of {every} missions {'is' if missing == 1 else 'are'} missing ({', '.join(why)})"


def contradictions(comparison: Comparison) -> list[str]:
    """Missions without a collision that were faster than a certified bound: then the bound is wrong."""
    found = []
    for (case, planner), row in comparison.rows.items():
        for mark in ("t98", "t100"):
            limit, time = comparison.limit(case, mark), getattr(row, mark)
            faster = limit and time is not None and time < limit.lower_bound
            if limit and faster and not row.collisions:
                found.append(
                    f"{planner} took {time} steps to {mark} in {label(case)}, below the bound "
                    f"{limit.lower_bound}"
                )
    return found


def label(case: Case) -> str:
    """A case in words."""
    return f"{case.world} {case.seed}" + (f", start {case.start}" if case.start else "")


# ---- cells ----


def number(value: float, digits: int = 1, *, scale: float = 1.0) -> str:
    """A number, or a dash where it is NaN."""
    return NONE if math.isnan(value) else f"{scale * value:.{digits}f}".replace("-", "−")


def with_interval(found: Interval, digits: int = 1, *, scale: float = 1.0) -> str:
    """An estimate with its interval in parentheses, where it has one."""
    write = partial(number, digits=digits, scale=scale)
    if math.isnan(found.low):
        return write(found.value)
    between = " to " if found.low < 0.0 else "–"
    return f"{write(found.value)} ({write(found.low)}{between}{write(found.high)})"


def _p(value: float) -> str:
    return NONE if math.isnan(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _share(comparison: Comparison, planner: str, cases: Sequence[Case], name: str) -> Interval:
    return comparison.estimate(planner, cases, lambda _, row: float(getattr(row, name)), limits=(0.0, 1.0))


def _success(comparison: Comparison, planner: str, cases: Sequence[Case]) -> str:
    by_world = comparison.by_world(planner, cases, lambda _, row: float(row.success))
    found = share_interval(sum(by_world.values()), len(by_world))
    flown = comparison.flown(planner, cases)
    if not flown:
        return NONE
    successes = sum(row.success for _, row in flown)
    return f"{successes}/{len(flown)} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"


def _time_cell(comparison: Comparison, planner: str, cases: Sequence[Case], mark: str) -> str:
    found = comparison.estimate(
        planner, cases, comparison.time(mark), limits=(0.0, float(comparison.horizon))
    )
    reached, flown = comparison.reached(planner, cases, mark)
    return f"{with_interval(found)} · {reached}/{flown}" if flown else NONE


# ---- the tables ----


def headline(comparison: Comparison, cases: Sequence[Case], title: str = "At a glance") -> Table:
    """The few numbers that matter most, best planner first."""
    reference = best_baseline(comparison, cases)
    asked = _some_asked(comparison)
    incomplete = any((case, name) not in comparison.rows for case in cases for name in comparison.planners)
    rows = []
    for planner in comparison.ranked:
        t98 = comparison.time("t98")
        cap = (0.0, float(comparison.horizon))
        rows.append(
            (
                planner,
                *([f"{len(comparison.flown(planner, cases))}/{len(cases)}"] if incomplete else []),
                _success(comparison, planner, cases),
                _too_early(comparison, planner, cases),
                with_interval(comparison.estimate(planner, cases, t98, limits=cap)),
                with_interval(
                    comparison.estimate(planner, cases, t98, statistic=interquartile_mean, limits=cap)
                ),
                with_interval(comparison.estimate(planner, cases, comparison.time("t_stop"), limits=cap)),
                with_interval(_share(comparison, planner, cases, "instances"), 2, scale=100),
                _ratio_cell(comparison, planner, cases, "t98", "lower_bound"),
                _ratio_cell(comparison, planner, cases, "t98", "best_tour"),
                str(sum(row.collisions for _, row in comparison.flown(planner, cases))),
                _improvement_cell(comparison, planner, reference, cases),
                *([_unanswered_cell([row for _, row in comparison.flown(planner, cases)])] if asked else []),
            )
        )
    return Table(
        "headline",
        f"{title}: {_worlds(cases)}",
        (
            "planner",
            *(["flown"] if incomplete else []),
            "success",
            "stopped too early",
            "t98, mean",
            "t98, IQM",
            "own stop, mean",
            "coverage at the end, %",
            "t98 ÷ certified bound",
            "t98 ÷ best known tour",
            "collisions",
            f"better than {reference}, P" if reference else "better than the best baseline, P",
            *([UNANSWERED] if asked else []),
        ),
        tuple(rows),
        (
            f"A time that was never reached counts as {comparison.horizon} steps. In parentheses: 95 % "
            "intervals over worlds (stratified by family, paired; Wilson's for shares). Success: stopped "
            "by itself with at least 98.26 % of the instances and no collision. Stopped too early: by itself "
            "with less.",
            _ratio_note(comparison),
            *about_rows(comparison),
        ),
    )


def _too_early(comparison: Comparison, planner: str, cases: Sequence[Case]) -> str:
    """How many missions said that they were done and were not."""
    flown = comparison.flown(planner, cases)
    early = sum(row.too_early for _, row in flown)
    return f"{early}/{len(flown)}" if flown else NONE


def _worlds(cases: Sequence[Case]) -> str:
    worlds = len({(case.world, case.seed) for case in cases})
    starts = "" if worlds == len(cases) else f", {len(cases)} starts"
    return f"{worlds} world{'s' if worlds != 1 else ''}{starts}"


def _ratio_cell(comparison: Comparison, planner: str, cases: Sequence[Case], mark: str, which: str) -> str:
    """A mean ratio, marked where missions in it never reached the mark, and how many did."""
    found = comparison.estimate(planner, cases, comparison.against(mark, which))
    reached, counted = _counted(comparison, planner, cases, mark)
    least = "≥ " if reached < counted else ""
    return f"{least}{with_interval(found, 2)} · {reached}/{counted}" if counted else NONE


def _counted(comparison: Comparison, planner: str, cases: Sequence[Case], mark: str) -> tuple[int, int]:
    """Of the missions that have ratios, those that reached the mark; and all."""
    ratio_of = comparison.against(mark, "best_tour")
    counted = [case for case, row in comparison.flown(planner, cases) if not math.isnan(ratio_of(case, row))]
    return comparison.reached(planner, counted, mark)


def _ratio_note(comparison: Comparison) -> str:
    return (
        "Ratios are means over the missions without a collision in worlds whose bound and tour are both "
        "known; after the dot, how many of these reached the mark. ≥ stands where some did not: they count "
        f"as {comparison.horizon} steps, so that the mean and its interval are too low. A mission that was "
        "cut before even the tour ends, and did not reach the mark, is left out."
    )


def _improvement_cell(
    comparison: Comparison, planner: str, reference: str | None, cases: Sequence[Case]
) -> str:
    if reference is None or planner == reference:
        return NONE
    ours, theirs, _ = _pairs(comparison, planner, reference, cases)
    return _improvement(ours, theirs)


def _improvement(ours: FloatArray, theirs: FloatArray) -> str:
    return with_interval(share_interval(float(improvement(ours, theirs).sum()), len(ours)), 2)


def _pairs(
    comparison: Comparison,
    planner: str,
    reference: str,
    cases: Sequence[Case],
    measure: Measure | None = None,
) -> tuple[FloatArray, FloatArray, list[str]]:
    """A measure of two planners by world, over the cases that both have flown, and the worlds' families.

    Of the time to 98.26 % unless another is given.
    """
    measure = comparison.time("t98") if measure is None else measure
    both = [case for case in cases if all((case, name) in comparison.rows for name in (planner, reference))]
    ours, theirs = (comparison.by_world(name, both, measure) for name in (planner, reference))
    return np.array([*ours.values()]), np.array([*theirs.values()]), list(map(_family, ours))


def difference(
    comparison: Comparison,
    planner: str,
    reference: str,
    cases: Sequence[Case],
    *,
    measure: Measure | None = None,
) -> Interval:
    """Mean of a measure minus the other planner's, paired by world.

    Of the time to 98.26 % unless another is given; then below 0 where the planner is faster.
    """
    ours, theirs, strata = _pairs(comparison, planner, reference, cases, measure)
    return interval(ours - theirs, strata, mean)


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
            ours, theirs, _ = _pairs(comparison, planner, other, cases)
            if not len(ours):
                continue
            told = with_interval(difference(comparison, planner, other, cases)), _improvement(ours, theirs)
            lines.append((title, planner, other, str(len(ours)), *told))
            p_values.append(paired_p_value(ours, theirs))
        rows += [(*line, _p(p), _p(q)) for line, p, q in zip(lines, p_values, holm(p_values), strict=True)]
    return tuple(rows)


def _about_tests(comparison: Comparison, of: str) -> str:
    """What the columns of `_world_by_world` mean."""
    designs = len(_designs(comparison))
    only = f" The wrecks are of {designs} designs, and no more than these is told of." * (designs > 0)
    return (
        "P(better): share of worlds with the smaller t98, ties count half; Wilson's interval. p: two-sided "
        f"exchange test of the paired mean difference, with Holm's correction over the {of} of a block. The "
        "blocks are separate families of tests, though they share worlds: nothing corrects for their number."
        + only
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
                *(_time_cell(comparison, planner, cases, mark) for mark in marks),
                with_interval(
                    comparison.estimate(
                        planner,
                        cases,
                        comparison.time("t98"),
                        statistic=interquartile_mean,
                        limits=(0.0, float(comparison.horizon)),
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
            "instances at the end",
            "clusters at the end",
            "area at the end",
        ),
        tuple(
            (
                planner,
                *(with_interval(_share(comparison, planner, cases, name), scale=100) for name in names),
            )
            for planner in comparison.ranked
        ),
        ("Share of the instances, held after the mission ended; the last two columns count otherwise.",),
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
            _ratio_cell(comparison, planner, cases, mark, which)
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
            _ratio_note(comparison),
            "The fewest steps possible lie between the certified lower bound and the best known tour. So the "
            "ratio to them lies between the two columns where all reached the mark; where some did not, the "
            "column of the tour is still a lower estimate of it, and nothing bounds it from above.",
            "SPL: mean of 1[98.26 % reached] · bound ÷ max(t98, bound). Soft SPL: final share · bound ÷ "
            "max(steps flown, bound). Both against the certified bound for 98.26 %, 0 with a collision.",
        ),
    )


def conduct(comparison: Comparison, title: str, cases: Sequence[Case]) -> Table:
    """How the planners flew, and at what cost."""
    asked = _some_asked(comparison)
    aborted = any(row.ended == "aborted" for row in comparison.rows.values())
    rows = []
    for planner in comparison.ranked:
        flown = [row for _, row in comparison.flown(planner, cases)]
        clearances = [row.min_clearance_m for row in flown if row.min_clearance_m is not None]

        def average(name: str, digits: int = 1, rows: Sequence[Row] = flown) -> str:
            return number(float(np.mean([getattr(row, name) for row in rows])) if rows else math.nan, digits)

        cells = [
            planner,
            _success(comparison, planner, cases),
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
                _of_asking(flown, name, digits, sum)
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
            "collisions",
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


def _some_asked(comparison: Comparison) -> bool:
    return any(row.vlm_calls is not None for row in comparison.rows.values())


def _of_asking(
    rows: Sequence[Row], name: str, digits: int, combine: Callable[[list[float]], float | np.floating[Any]]
) -> str:
    """A number of the missions that asked a model; a dash where none did, `unknown` where one has none."""
    found = [getattr(row, name) for row in rows if row.vlm_calls is not None]
    if None in found:
        return "unknown"
    return number(float(combine(found)), digits) if found else NONE


UNANSWERED = "by belief, %"
"""Heading of the share of the questions to which no reply counted."""
ASKING = ("calls", "tokens", "US$", "minutes", UNANSWERED)
"""Headings of what asking a model took; see `_asking_cells`."""


def _asking_cells(rows: Sequence[Row]) -> tuple[str, ...]:
    """Calls, tokens, cost and minutes on the mission's clock, means over missions; whose word counted."""
    minutes = [row.mission_s / 60.0 for row in rows if row.mission_s is not None]
    return (
        _of_asking(rows, "vlm_calls", 1, np.mean),
        _of_asking(rows, "vlm_tokens", 0, np.mean),
        _of_asking(rows, "vlm_cost_usd", 4, np.mean),
        number(float(np.mean(minutes)), 1) if rows and len(minutes) == len(rows) else NONE,
        _unanswered_cell(rows),
    )


def _unanswered_cell(rows: Sequence[Row]) -> str:
    (share,) = _unanswered(rows).values() or (math.nan,)
    return number(share, 0, scale=100)


def _asking_note(comparison: Comparison) -> str:
    """What the columns `ASKING` mean."""
    by_latency: dict[float, list[str]] = {}
    for planner, latency in comparison.latencies.items():
        by_latency.setdefault(latency, []).append(planner)
    at = "; ".join(
        f"at {latency:g} s a call" + (f" for {', '.join(planners)}" if len(by_latency) > 1 else "")
        for latency, planners in by_latency.items()
    )
    return (
        "Calls to a model, tokens, US$ and minutes are means over missions. Minutes are on the mission's "
        f"clock, which goes on while the vehicle waits for an answer{f', {at}' if at else ''}. "
        f"{UNANSWERED.capitalize()}: questions to which no reply counted."
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
        return _time_cell(comparison, planner, cases, "t98")

    def final(planner: str, cases: Sequence[Case]) -> str:
        return with_interval(_share(comparison, planner, cases, "instances"), scale=100)

    def far(planner: str, cases: Sequence[Case]) -> str:
        low, high = (
            comparison.estimate(planner, cases, comparison.against("t98", which))
            for which in ("best_tour", "lower_bound")
        )
        reached, counted = _counted(comparison, planner, cases, "t98")
        if not counted:
            return NONE
        # Nothing bounds the ratio from above where a mark was not reached.
        ends = [number(end.value, 2) for end in (low, high)]
        return f"{' … '.join(ends) if reached == counted else f'≥ {ends[0]}'} · {reached}/{counted}"

    designs = _designs(comparison)
    return [
        table(
            "t98-by-family",
            "Steps to 98.26 %, by family",
            "Restricted mean (95 % interval) · missions that reached it; never counts as "
            f"{comparison.horizon}.",
            time,
        ),
        table(
            "success-by-family",
            "Success, by family",
            "Missions that stopped by themselves with at least 98.26 % and no collision; Wilson's 95 % "
            "interval.",
            lambda planner, cases: _success(comparison, planner, cases),
        ),
        table(
            "coverage-by-family",
            "Instances seen at the end, %, by family",
            "Mean (95 % interval).",
            final,
        ),
        table(
            "ratio-by-family",
            "Times the fewest possible steps to 98.26 %, by family",
            "To the best known tour … to the certified lower bound; the truth lies between the two. "
            "Where not all reached the mark, only the lower end is known. " + _ratio_note(comparison),
            far,
        ),
        *([_by_design(comparison, designs)] if len(designs) > 1 else []),
    ]


def _designs(comparison: Comparison) -> dict[str, list[Case]]:
    """Wrecks by design, where any has several worlds; nothing otherwise."""
    found: dict[str, list[Case]] = {}
    for case in comparison.cases:
        if family(case) == "wreck":
            found.setdefault(case.world, []).append(case)
    return found if len(found) < sum(map(len, found.values())) else {}


def _by_design(comparison: Comparison, designs: Mapping[str, Sequence[Case]]) -> Table:
    """Wrecks design by design: what holds of one need not hold of another."""

    def cell(planner: str, cases: Sequence[Case]) -> str:
        seen = number(_share(comparison, planner, cases, "instances").value, scale=100)
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


def paper_tables(comparison: Comparison) -> list[Table]:
    """The paper's Tables I and II in its own form, with our missions in our simulator."""
    found = []
    asked = _some_asked(comparison)
    kinds = (
        ("paper-1", "Table I", "reefs", REEFS, "instances"),
        ("paper-2", "Table II", "wrecks", ("wreck",), "area"),
    )
    for name, title, what, families, column in kinds:
        cases = tuple(case for case in comparison.cases if family(case) in families)
        if not cases:
            continue
        rows = [
            (
                planner,
                str(len(comparison.flown(planner, cases))),
                number(comparison.estimate(planner, cases, comparison.time("t_stop")).value),
                number(_share(comparison, planner, cases, column).value, 2, scale=100),
                *(_asking_cells([row for _, row in comparison.flown(planner, cases)]) if asked else ()),
            )
            for planner in comparison.ranked
        ]
        unmeasured = (NONE, UNMEASURED, *([NONE] * (1 + (len(ASKING) if asked else 0))))
        if not any("uivnav" in planner for planner in comparison.planners):
            rows.append((f"UIVNav ({REIMPLEMENTED['uivnav']})", *unmeasured))
        if not any(
            row.vlm_calls is not None and planner not in comparison.wire_tests
            for (_, planner), row in comparison.rows.items()
        ):
            rows.append(("planners that ask a vision-language model", *unmeasured))
        meaning = "oysters" if what == "reefs" else "outer surface"
        found.append(
            Table(
                name,
                f"{title} of the paper in our simulator: {what}",
                ("method", "worlds", "steps", "coverage, %", *(ASKING if asked else ())),
                tuple(rows),
                (
                    f"Steps: mean of the step at which the planner itself stopped; {comparison.horizon} "
                    f"where it did not. Coverage: mean share of the {meaning} seen at the end. Protocol "
                    f"{comparison.protocol}.",
                    *([_asking_note(comparison)] if asked else []),
                    *about_rows(comparison),
                ),
            )
        )
    return found


def published_tables() -> list[Table]:
    """What others published, from other simulators: not to be ranked with ours."""
    note = (
        "Other simulator, other sensor, other moves: these numbers stand here to be read, not to be compared "
        "with ours line by line."
    )
    paper = [
        Table(
            f"published-{k}",
            f"As published, other simulator: {title}",
            ("method", "steps", "coverage, %"),
            tuple((each.name, f"{each.steps:g}", f"{each.coverage:.2f}") for each in methods),
            (f"{published.DREAM_PAPER}, Table {'I' * k}. {note}",),
        )
        for k, title, methods in ((1, "reefs", published.REEFS), (2, "wrecks", published.WRECKS))
    ]
    coral = Table(
        "published-coral",
        "As published, other simulator: the successor",
        ("method", "coverage, %", "time, s", "collisions", "VLM calls"),
        tuple(
            (
                each.name,
                f"{each.coverage:.2f}",
                f"{each.time_s:.1f}",
                str(each.collisions),
                str(each.vlm_calls),
            )
            for each in published.CORAL
        ),
        (f"{published.CORAL_PAPER}, ten scenes. {note}",),
    )
    return [*paper, coral]


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
            "Bound: no mission without a collision is faster, certified. Tour: the best that was found by "
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
        (f"Never: with the share of the instances seen at the end. ×n: n collisions.{lost}",),
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
                _time_cell(each, planner, each.cases, "t98"),
                with_interval(_share(each, planner, each.cases, "instances"), 2, scale=100),
                _time_cell(each, planner, each.cases, "t_stop"),
                _success(each, planner, each.cases),
            )
            for planner in planners
            for reach, each in comparisons.items()
        ),
        ("Restricted mean, its 95 % interval, and in how many missions the mark was reached.",),
    )


def detail_tables(comparison: Comparison, title: str, cases: Sequence[Case]) -> list[Table]:
    """All measures of a group of worlds."""
    return [table(comparison, title, cases) for table in (times, coverage, efficiency, conduct)]


def print_summary(results: Results, console: Console) -> None:
    """The short table at the end of a benchmark."""
    from rich.table import Table as RichTable
    from rich.text import Text

    comparison = compare(results)
    table = RichTable(
        title=f"mean over worlds; what was never reached counts as {comparison.horizon}",
        title_justify="left",
    )
    headings = (
        "worlds",
        "planner",
        "to 90 %",
        "to 98.26 %",
        "own stop",
        "seen, %",
        "success",
        "collisions",
        "÷ bound",
    )
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("worlds", "planner") else "right")
    titles = ("All worlds", "Reefs together", FAMILIES["wreck"])
    shown = {title: cases for title, cases in groups(comparison).items() if title in titles}
    for title, cases in (shown or groups(comparison)).items():
        for k, planner in enumerate(comparison.ranked):
            flown = comparison.flown(planner, cases)
            table.add_row(
                f"{title} ({len(cases)})" if k == 0 else "",
                Text(planner),
                *(
                    number(comparison.estimate(planner, cases, comparison.time(mark)).value)
                    for mark in ("t90", "t98", "t_stop")
                ),
                number(_share(comparison, planner, cases, "instances").value, 2, scale=100),
                f"{sum(row.success for _, row in flown)}/{len(flown)}",
                str(sum(row.collisions for _, row in flown)),
                _ratio_of_bound(comparison, planner, cases),
            )
        table.add_section()
    console.print(table)
    if _some_asked(comparison):
        _print_asking(comparison, console)
    if comparison.missing:
        console.print(
            f"{what_is_missing(comparison)}; the means are over those that were flown, so that they "
            "cannot be compared."
        )


def _print_asking(comparison: Comparison, console: Console) -> None:
    """What asking a model took, in a table of its own: beside the steps there is no room."""
    from rich.table import Table as RichTable
    from rich.text import Text

    table = RichTable(title="what asking a model took, mean over missions", title_justify="left")
    for heading in ("planner", "missions", *ASKING):
        table.add_column(heading, justify="left" if heading == "planner" else "right")
    for planner in comparison.ranked:
        flown = [row for _, row in comparison.flown(planner, comparison.cases)]
        table.add_row(Text(planner), str(len(flown)), *_asking_cells(flown))
    console.print(table)
    for note in (_asking_note(comparison), *about_rows(comparison)):
        console.print(note, markup=False, highlight=False)


def _ratio_of_bound(comparison: Comparison, planner: str, cases: Sequence[Case]) -> str:
    """The mean ratio, and behind it of how many missions it is where that is not all of them."""
    value = comparison.estimate(planner, cases, comparison.against("t98", "lower_bound")).value
    reached, counted = _counted(comparison, planner, cases, "t98")
    every = len(comparison.flown(planner, cases))
    some = f" ({counted} of {every})" if 0 < counted < every else ""
    return ("≥ " if reached < counted else "") + number(value, 2) + some
