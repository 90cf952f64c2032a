"""`dream sweep`: the same missions under protocols that differ only in the reach."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.bench import Flying, Outcome, fly
from dream.commands.console import print_json
from dream.protocol import REACHES, protocol_named, reach_variant


@dataclass(frozen=True, slots=True)
class Sweep(Flying):
    """Fly the same missions with one reach after another: how far the sensor is trusted.

    A reach of 8 m is `dream-v1` itself; another one is a protocol with a name of its own, such as
    `dream-v1-reach4`. Interrupted, the same command goes on where it was.
    """

    suite: tyro.conf.Positional[str] = "paper"
    """A suite: `paper`, `dev` or `test`; or a file .txt that lists worlds of your own."""
    reach: tuple[float, ...] = REACHES
    """Metres over ground, one or more of 4, 6, 8 and 10."""
    out: Path | None = None
    """Folder for one benchmark folder per reach, `reach-4` and so on; `sweep/SUITE` unless given."""

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where a mission failed."""
        from dream.evaluation.runner import Plan
        from dream.evaluation.suites import suite_named

        planners, engine, cases = self.chosen_planners(), self.chosen_engine(), suite_named(self.suite)
        if not self.reach:
            raise ValueError(
                f"--reach: expected one or more of {', '.join(f'{r:g}' for r in REACHES)}, got none"
            )
        protocols = {reach: protocol_named(reach_variant(reach)) for reach in self.reach}
        root = self.out or Path("sweep") / Path(self.suite).stem
        outcomes: list[Outcome] = []
        for reach, protocol in protocols.items():
            plan = Plan(self.suite, cases, planners, protocol, self.max_steps, self.keep_runs)
            outcomes.append(fly(plan, root / f"reach-{reach:g}", engine))
            if not self.json:
                outcomes[-1].print()
        if self.json:
            print_json({"out": str(root), "reaches": [outcome.as_dict() for outcome in outcomes]})
        for outcome in outcomes:
            outcome.check()
        return 0
