"""The paper's own tables: in its form with our missions, and as published by others."""

from __future__ import annotations

from dream.evaluation import published
from dream.evaluation.cells import (
    ASKING,
    NONE,
    Table,
    about_rows,
    asking_cells,
    asking_note,
    mean_share,
    number,
)
from dream.evaluation.comparison import REEFS, REIMPLEMENTED, Comparison, family, some_asked

UNMEASURED = "not yet measured here"


def paper_tables(comparison: Comparison) -> list[Table]:
    """The paper's Tables I and II in its own form, with our missions in our simulator."""
    found = []
    asked = some_asked(comparison)
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
                number(mean_share(comparison, planner, cases, column).value, 2, scale=100),
                *(asking_cells([row for _, row in comparison.flown(planner, cases)]) if asked else ()),
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
                    f"Steps: mean of the step at which the planner itself stopped; {comparison.unreached} "
                    f"where it did not. Coverage: mean share of the {meaning} seen at the end. Protocol "
                    f"{comparison.protocol}.",
                    *([asking_note(comparison)] if asked else []),
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
        ("method", "coverage, %", "time, s", "contacts", "VLM calls"),
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
