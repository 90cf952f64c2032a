"""`dream bench`: planners over the worlds of a suite."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import tyro

from dream.commands.console import print_json, with_progress
from dream.names import look_up
from dream.planning import PLANNERS
from dream.protocol import protocol_named


@dataclass(frozen=True, slots=True)
class Bench:
    """Fly planners over the worlds of a suite, side by side, and print a table."""

    suite: tyro.conf.Positional[str] = "paper"
    """A suite: `paper` is ten reefs and five wrecks."""
    planners: tuple[str, ...] = ("sixsteps", "lawnmower", "random")
    """Which planners, with their default parameters."""
    protocol: str = "dream-v1"
    """Survey protocol."""
    max_steps: int | None = None
    """Decisions at most; the protocol's cap unless given."""
    workers: int | None = None
    """Missions at a time; as many as there are processors unless given."""
    json: bool = False
    """Print all summaries as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.runner import Flight, fly_all
        from dream.evaluation.suites import suite_named

        protocol_named(self.protocol)
        if not self.planners:
            raise ValueError(f"--planners: expected one or more of {', '.join(PLANNERS)}, got none")
        if self.workers is not None and self.workers < 1:
            raise ValueError(f"--workers: expected at least 1, got {self.workers}")
        flights = [
            Flight(
                case.world,
                case.seed,
                name,
                look_up(PLANNERS, name, "planner"),
                self.protocol,
                max_steps=self.max_steps,
            )
            for case in suite_named(self.suite)
            for name in self.planners
        ]
        finished = dict(with_progress(fly_all(flights, self.workers), self.suite, len(flights)))
        if self.json:
            print_json({"suite": self.suite, "missions": [finished[flight] for flight in flights]})
        else:
            _print_table(
                [finished[flight] for flight in flights],
                list(self.planners),
                protocol_named(self.protocol).cap,
            )
        return 0


def _print_table(summaries: list[dict[str, Any]], planners: list[str], cap: int) -> None:
    from rich.console import Console
    from rich.table import Table

    from dream.evaluation.metrics import pooled

    table = Table(title=f"mean over the worlds; a time never reached counts as {cap}")
    for heading in (
        "worlds",
        "planner",
        "t90",
        "t98",
        "steps",
        "instances",
        "clusters",
        "area",
        "success",
        "collisions",
    ):
        table.add_column(heading, justify="left" if heading in ("worlds", "planner") else "right")
    families = sorted({s["world"].split("/")[0] for s in summaries})
    for family in families:
        for planner in planners:
            chosen = [s for s in summaries if s["planner"] == planner and s["world"].startswith(family + "/")]
            shares = [
                sum(s["coverage"][k] for s in chosen) / len(chosen) for k in ("instances", "clusters", "area")
            ]
            table.add_row(
                f"{len(chosen)} {family}",
                planner,
                *(f"{pooled(chosen, key, cap):.1f}" for key in ("t90", "t98", "t_stop")),
                *(f"{share:.1%}" for share in shares),
                f"{sum(s['success'] for s in chosen)}/{len(chosen)}",
                str(sum(s["collisions"] for s in chosen)),
            )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
