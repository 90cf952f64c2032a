"""A benchmark folder → planners over worlds: who flew what, which baseline is the best, what is paired."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from dream.evaluation.anytime import anytime_interval, anytime_p_value
from dream.evaluation.results import MAX_STEPS, Results, Row
from dream.evaluation.statistics import (
    FloatArray,
    Interval,
    Statistic,
    improvement,
    interval,
    mean,
    paired_p_value,
    ratio,
    share_interval,
)
from dream.evaluation.suites import REEF_FAMILIES, SEALED_STEPS, Case, family_of
from dream.planning import PLANNERS
from dream.planning.vlm import stands_in
from dream.sim.habitats import HABITATS

if TYPE_CHECKING:
    from dream.evaluation.oracle.bounds import Limit, OracleBounds

FAMILIES = {
    "fringing": "Fringing reefs",
    "string": "String reefs",
    "patch": "Patch reefs",
    "mixed": "Mixed reefs",
    "letter": "Letter reefs",
    "mound": "Mounds",
    "ledge": "Ledges",
    "carpet": "Carpets",
    "tiny": "Tiny patches",
    "dense": "Dense beds",
    "rocks": "Rocks",
    "holes": "Reefs with holes",
    "border": "Reefs at a border",
    "walls": "Reefs cut by walls",
    "two": "Two habitats",
    "wide": "Wide reefs",
    "wreck": "Wrecks",
    "several": "Several structures",
    "pool": "Tank",
    "flat": "Empty ground",
    "other": "Other worlds",
}
REEFS = (*REEF_FAMILIES, "letter", *(name.removeprefix("reef/") for name in HABITATS))

BY_BELIEF = 0.1
"""Share of a planner's questions without a reply that counts from which on its rows are marked."""
MOST_OF_A_MISSION, FEW = 0.5, 3
"""Likewise in a single mission, and how many questions that must be."""

REIMPLEMENTED = {"uivnav": "our re-implementation"}
"""What is said of a planner after a paper whose code and parameters are not public."""

Measure = Callable[[Case, Row], float]
"""A number of one mission; NaN where it has none."""


def coverage_at_end(_: Case, row: Row) -> float:
    """Share of the instances that a mission has seen when it ends."""
    return row.instances


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Planners over worlds: the missions of one benchmark folder and what is certified about its worlds."""

    planners: tuple[str, ...]
    """In the order of the benchmark."""
    cases: tuple[Case, ...]
    rows: Mapping[tuple[Case, str], Row]
    """Finished missions."""
    bounds: Mapping[Case, OracleBounds]
    """Where they are known."""
    protocol: str
    horizon: int
    """Steps that a mission had, the most of any; an unreached mark counts as those of its world."""
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
    sealed: bool = False
    """A sealed test's: more worlds may follow, so that intervals hold at every number of them at once."""

    @property
    def unreached(self) -> str:
        """What a mark counts as that was not reached, in words: one number, or that of each world."""
        each = {row.horizon(self.horizon) for row in self.rows.values()} or {self.horizon}
        least = min(each)
        return f"{least} steps" if len(each) == 1 else f"the cap of its world, {least} to {max(each)} steps"

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

    def unbroken(self, planners: Sequence[str], cases: Sequence[Case]) -> tuple[Case, ...]:
        """The cases before the first that one of these planners has not flown."""
        return tuple(takewhile(lambda case: all((case, name) in self.rows for name in planners), cases))

    @property
    def time_limits(self) -> tuple[float, float]:
        """What steps to a mark can be at all: of a sealed test fixed before any of its worlds is drawn."""
        return 0.0, float(max(self.horizon, SEALED_STEPS) if self.sealed else self.horizon)

    def success(self, planner: str, cases: Sequence[Case]) -> Interval:
        """The share of the worlds that succeeded, with its interval: Wilson's, or `anytime_interval`."""
        if self.sealed:
            return self.estimate(planner, cases, lambda _, row: float(row.success), limits=(0.0, 1.0))
        by_world = self.by_world(planner, cases, lambda _, row: float(row.success))
        return share_interval(sum(by_world.values()), len(by_world))

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
        """A statistic of a measure over worlds, with its interval.

        Of a sealed test it is over the worlds before the first that is missing, so that it does not matter
        why one is. Its interval is `anytime_interval`, which there is of means with two limits alone.
        """
        if self.sealed:
            values = self.by_world(planner, self.unbroken([planner], cases), measure)
            return _anytime(np.array([*values.values()]), statistic, limits)
        values = self.by_world(planner, cases, measure)
        return interval(np.array([*values.values()]), list(map(_family, values)), statistic, limits=limits)

    def time(self, mark: str) -> Measure:
        """Steps to a mark (`t90` … `t_stop`), the horizon where it was not reached."""

        def steps(case: Case, row: Row) -> float:
            value = getattr(row, mark)
            most = row.horizon(self.horizon)
            return float(most if value is None else min(value, most))

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
                name: ratio(row, getattr(row, mark), length, row.horizon(self.horizon))
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
    unanswered = share_unanswered(results.rows)
    by_belief = _by_belief(results.rows, unanswered)
    titles = {
        name: title(name, parameters, by_belief=_how_much(unanswered[name]) if name in by_belief else "")
        for name, parameters in given.items()
    }
    rows: dict[tuple[Case, str], Row] = {}
    bounds: dict[Case, OracleBounds] = {}
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
    most = max((row.cap or cap for row in results.rows), default=cap)
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
        horizon=most if asked is None else min(most, int(asked)),
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
        sealed=results.manifest.get("sealed") is not None,
    )


def share_unanswered(rows: Iterable[Row]) -> dict[str, float]:
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


def _how_much(unanswered: float) -> str:
    return "all belief" if unanswered == 1.0 else "partly belief"


def title(planner: str, parameters: Mapping[str, Any], *, by_belief: str) -> str:
    """What a planner is called in tables: one that asks a model together with that model.

    Args:
        planner: Its name.
        parameters: Of it.
        by_belief: How much of it `belief` decided, in words; empty where that is little.
    """
    model = str(parameters.get("model_name") or parameters.get("model") or "")
    told = [
        REIMPLEMENTED.get(planner, ""),
        "another network" if parameters.get("weights") else "",
        "wire test" if is_wire_test(parameters) else model,
        "own prompts" if parameters.get("prompts") else "",
        by_belief,
    ]
    said = "; ".join(filter(None, told))
    return f"{planner} ({said})" if said else planner


def is_wire_test(parameters: Mapping[str, Any]) -> bool:
    """Did a planner with these parameters ask the stand-in?"""
    return stands_in(str(parameters.get("model", "")))


def is_number(value: Any) -> bool:
    """A finite number in a file that anybody may have written."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _bounds(row: Row) -> OracleBounds | None:
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


def paired(
    comparison: Comparison,
    planner: str,
    reference: str,
    cases: Sequence[Case],
    measure: Measure | None = None,
) -> tuple[FloatArray, FloatArray, list[str]]:
    """A measure of two planners by world, over the cases that both have flown, and the worlds' families.

    Of the time to 98.26 % unless another is given. Of a sealed test it is over the cases before the first
    that one of the two has not flown.
    """
    measure = comparison.time("t98") if measure is None else measure
    two = (planner, reference)
    if comparison.sealed:
        cases = comparison.unbroken(two, cases)
    both = [case for case in cases if all((case, name) in comparison.rows for name in two)]
    ours, theirs = (comparison.by_world(name, both, measure) for name in (planner, reference))
    return np.array([*ours.values()]), np.array([*theirs.values()]), list(map(_family, ours))


def difference(
    comparison: Comparison,
    planner: str,
    reference: str,
    cases: Sequence[Case],
    *,
    measure: Measure | None = None,
    most: float | None = None,
) -> Interval:
    """Mean of a measure minus the other planner's, paired by world.

    Of the time to 98.26 % unless another is given; then below 0 where the planner is faster.

    Args:
        comparison: That is told of.
        planner: Whose measure it is.
        reference: The other.
        cases: On which both are compared.
        measure: What is compared.
        most: The most that it can be, where its least is 0; unless given, the steps of a mission.
    """
    ours, theirs, strata = paired(comparison, planner, reference, cases, measure)
    if comparison.sealed:
        limit = float(comparison.horizon) if most is None else most
        return _anytime(ours - theirs, mean, (-limit, limit))
    return interval(ours - theirs, strata, mean)


def no_difference(comparison: Comparison, ours: FloatArray, theirs: FloatArray) -> float:
    """P-value of (n,) pairs of times whose mean difference is 0; one that holds whenever whoever looks stops
    where it is a sealed test's."""
    if comparison.sealed:
        limit = float(comparison.horizon)
        return anytime_p_value(ours - theirs, (-limit, limit), 0.0)
    return paired_p_value(ours, theirs)


def better(comparison: Comparison, ours: FloatArray, theirs: FloatArray) -> Interval:
    """Share of (n,) worlds on which the first of two times is smaller, ties count half."""
    first = improvement(ours, theirs)
    if comparison.sealed:
        return _anytime(first, mean, (0.0, 1.0))
    return share_interval(float(first.sum()), len(first))


def _anytime(values: FloatArray, statistic: Statistic, limits: tuple[float, float]) -> Interval:
    """A statistic of a sealed test, with its interval where it is the mean of what has two limits."""
    if len(values) and (statistic is not mean or not all(map(math.isfinite, limits))):
        value = float(statistic(values, np.ones((1, len(values))))[0])
        return Interval(value, math.nan, math.nan, len(values))
    return anytime_interval(values, limits)


def some_asked(comparison: Comparison) -> bool:
    """Did any mission ask a model?"""
    return any(row.vlm_calls is not None for row in comparison.rows.values())


def wreck_designs(comparison: Comparison) -> dict[str, list[Case]]:
    """Wrecks by design, where any has several worlds; nothing otherwise."""
    found: dict[str, list[Case]] = {}
    for case in comparison.cases:
        if family(case) == "wreck":
            found.setdefault(case.world, []).append(case)
    return found if len(found) < sum(map(len, found.values())) else {}
