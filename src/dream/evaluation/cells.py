"""Numbers of a comparison → cells of tables and the notes that belong to them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dream.evaluation.comparison import Comparison, better, paired, share_unanswered
from dream.evaluation.results import Row
from dream.evaluation.statistics import FloatArray, Interval
from dream.evaluation.suites import Case
from dream.planning.vlm import WIRE_TEST

NONE = "–"
"""What a table shows where nothing is known."""
UNANSWERED = "by belief, %"
"""Heading of the share of the questions to which no reply counted."""
ASKING = ("calls", "tokens", "US$", "minutes", UNANSWERED)
"""Headings of what asking a model took; see `asking_cells`."""

ANYTIME = (
    "anytime-valid 95 % intervals (a betting confidence sequence): they hold at every number of worlds at "
    "once, so that more worlds may follow, or none, for any reason"
)
"""What the intervals of a sealed test are."""


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


def p_cell(value: float) -> str:
    """A p-value, or a dash where it is NaN."""
    return NONE if math.isnan(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def mean_share(comparison: Comparison, planner: str, cases: Sequence[Case], name: str) -> Interval:
    """Mean of a share of a mission, such as `instances`, over worlds."""
    return comparison.estimate(planner, cases, lambda _, row: float(getattr(row, name)), limits=(0.0, 1.0))


def success_cell(comparison: Comparison, planner: str, cases: Sequence[Case]) -> str:
    """Missions that succeeded, of those flown, and the 95 % interval of the share of worlds."""
    found = comparison.success(planner, cases)
    flown = comparison.flown(planner, cases)
    if not flown:
        return NONE
    successes = sum(row.success for _, row in flown)
    return f"{successes}/{len(flown)} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"


def time_cell(comparison: Comparison, planner: str, cases: Sequence[Case], mark: str) -> str:
    """Mean steps to a mark, and how many missions reached it."""
    found = comparison.estimate(planner, cases, comparison.time(mark), limits=comparison.time_limits)
    reached, flown = comparison.reached(planner, cases, mark)
    return f"{with_interval(found)} · {reached}/{flown}" if flown else NONE


def too_early_cell(comparison: Comparison, planner: str, cases: Sequence[Case]) -> str:
    """How many missions said that they were done and were not."""
    flown = comparison.flown(planner, cases)
    early = sum(row.too_early for _, row in flown)
    return f"{early}/{len(flown)}" if flown else NONE


def how_many_worlds(cases: Sequence[Case]) -> str:
    """Worlds, and starts where some world has several, in words."""
    worlds = len({(case.world, case.seed) for case in cases})
    starts = "" if worlds == len(cases) else f", {len(cases)} starts"
    return f"{worlds} world{'s' if worlds != 1 else ''}{starts}"


def ratio_cell(comparison: Comparison, planner: str, cases: Sequence[Case], mark: str, which: str) -> str:
    """A mean ratio, marked where missions in it never reached the mark, and how many did."""
    found = comparison.estimate(planner, cases, comparison.against(mark, which))
    reached, counted = reached_with_ratio(comparison, planner, cases, mark)
    least = "≥ " if reached < counted else ""
    return f"{least}{with_interval(found, 2)} · {reached}/{counted}" if counted else NONE


def reached_with_ratio(
    comparison: Comparison, planner: str, cases: Sequence[Case], mark: str
) -> tuple[int, int]:
    """Of the missions that have ratios, those that reached the mark; and all."""
    ratio_of = comparison.against(mark, "best_tour")
    counted = [case for case, row in comparison.flown(planner, cases) if not math.isnan(ratio_of(case, row))]
    return comparison.reached(planner, counted, mark)


def ratio_note(comparison: Comparison) -> str:
    """What must stand below ratios to the fewest steps possible."""
    return (
        "Ratios are means over the missions without a contact in worlds whose bound and tour are both "
        "known; after the dot, how many of these reached the mark. ≥ stands where some did not: they count "
        f"as {comparison.unreached}, so that the mean and its interval are too low. A mission that was "
        "cut before even the tour ends, and did not reach the mark, is left out."
    )


def improvement_cell(
    comparison: Comparison, planner: str, reference: str | None, cases: Sequence[Case]
) -> str:
    """P(better) than the reference on the worlds that both have flown; a dash for itself."""
    if reference is None or planner == reference:
        return NONE
    ours, theirs, _ = paired(comparison, planner, reference, cases)
    return better_cell(comparison, ours, theirs)


def better_cell(comparison: Comparison, ours: FloatArray, theirs: FloatArray) -> str:
    """Share of worlds on which the first is smaller, ties count half."""
    return with_interval(better(comparison, ours, theirs), 2)


def asked_cell(
    rows: Sequence[Row], name: str, digits: int, combine: Callable[[list[float]], float | np.floating[Any]]
) -> str:
    """A number of the missions that asked a model; a dash where none did, `unknown` where one has none."""
    found = [getattr(row, name) for row in rows if row.vlm_calls is not None]
    if None in found:
        return "unknown"
    return number(float(combine(found)), digits) if found else NONE


def asking_cells(rows: Sequence[Row]) -> tuple[str, ...]:
    """Calls, tokens, cost and minutes on the mission's clock, means over missions; whose word counted."""
    minutes = [row.mission_s / 60.0 for row in rows if row.mission_s is not None]
    return (
        asked_cell(rows, "vlm_calls", 1, np.mean),
        asked_cell(rows, "vlm_tokens", 0, np.mean),
        asked_cell(rows, "vlm_cost_usd", 4, np.mean),
        number(float(np.mean(minutes)), 1) if rows and len(minutes) == len(rows) else NONE,
        unanswered_cell(rows),
    )


def unanswered_cell(rows: Sequence[Row]) -> str:
    """Per cent of the questions to which no reply counted."""
    (share,) = share_unanswered(rows).values() or (math.nan,)
    return number(share, 0, scale=100)


def asking_note(comparison: Comparison) -> str:
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
