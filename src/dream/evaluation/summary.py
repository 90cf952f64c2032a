"""The short table that a benchmark ends with in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dream.evaluation.cells import (
    ANYTIME,
    ASKING,
    about_rows,
    asking_cells,
    asking_note,
    mean_share,
    number,
    reached_with_ratio,
    with_interval,
)
from dream.evaluation.comparison import FAMILIES, Comparison, compare, groups, some_asked, what_is_missing
from dream.evaluation.results import Results
from dream.evaluation.suites import Case

if TYPE_CHECKING:
    from rich.console import Console


def print_summary(results: Results, console: Console) -> None:
    """The short table at the end of a benchmark."""
    from rich.table import Table as RichTable
    from rich.text import Text

    comparison = compare(results)
    table = RichTable(
        title=f"mean over worlds; what was never reached counts as {comparison.unreached}",
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
        "contacts",
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
                number(mean_share(comparison, planner, cases, "instances").value, 2, scale=100),
                f"{sum(row.success for _, row in flown)}/{len(flown)}",
                str(sum(row.collisions for _, row in flown)),
                _ratio_of_bound(comparison, planner, cases),
            )
        table.add_section()
    console.print(table)
    if comparison.sealed:
        _print_intervals(comparison, console)
    if some_asked(comparison):
        _print_asking(comparison, console)
    if comparison.missing:
        console.print(
            f"{what_is_missing(comparison)}; the means are over those that were flown, so that they "
            "cannot be compared."
        )


def _print_intervals(comparison: Comparison, console: Console) -> None:
    """What is known of all worlds that may be drawn, in a table of its own."""
    from rich.table import Table as RichTable
    from rich.text import Text

    cases, cap = comparison.cases, comparison.time_limits
    table = RichTable(title="all worlds that may be drawn", title_justify="left")
    for heading in ("planner", "worlds", "to 98.26 %", "seen, %", "success, %"):
        table.add_column(heading, justify="left" if heading == "planner" else "right")
    for planner in comparison.ranked:
        table.add_row(
            Text(planner),
            str(len(comparison.unbroken([planner], cases))),
            with_interval(comparison.estimate(planner, cases, comparison.time("t98"), limits=cap)),
            with_interval(mean_share(comparison, planner, cases, "instances"), 2, scale=100),
            with_interval(comparison.success(planner, cases), scale=100),
        )
    console.print(table)
    console.print(f"In parentheses: {ANYTIME}.", markup=False, highlight=False)


def _print_asking(comparison: Comparison, console: Console) -> None:
    """What asking a model took, in a table of its own: beside the steps there is no room."""
    from rich.table import Table as RichTable
    from rich.text import Text

    table = RichTable(title="what asking a model took, mean over missions", title_justify="left")
    for heading in ("planner", "missions", *ASKING):
        table.add_column(heading, justify="left" if heading == "planner" else "right")
    for planner in comparison.ranked:
        flown = [row for _, row in comparison.flown(planner, comparison.cases)]
        table.add_row(Text(planner), str(len(flown)), *asking_cells(flown))
    console.print(table)
    for note in (asking_note(comparison), *about_rows(comparison)):
        console.print(note, markup=False, highlight=False)


def _ratio_of_bound(comparison: Comparison, planner: str, cases: Sequence[Case]) -> str:
    """The mean ratio, and behind it of how many missions it is where that is not all of them."""
    value = comparison.estimate(planner, cases, comparison.against("t98", "lower_bound")).value
    reached, counted = reached_with_ratio(comparison, planner, cases, "t98")
    every = len(comparison.flown(planner, cases))
    some = f" ({counted} of {every})" if 0 < counted < every else ""
    return ("≥ " if reached < counted else "") + number(value, 2) + some
