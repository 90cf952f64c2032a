"""`dream sweep`: the same missions under protocols that differ only in the reach."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.bench import Flying, Outcome, fly
from dream.commands.console import print_json
from dream.options import First
from dream.protocol import REACHES, protocol_named, reach_variant


@dataclass(frozen=True, slots=True)
class Sweep(Flying):
    """Fly the same missions with one reach after another. Reach is how far over ground a label counts.

    A reach of 8 m is the protocol dream-v1. Each other reach is a protocol with its own name, such as
    dream-v1-reach4. After an interruption the same command goes on with the other missions.

    Examples:
        dream sweep paper --reach 4 8 --planners belief
    """

    suite: tyro.conf.Positional[str] = "paper"
    """`paper` (15 worlds), `dev` (60, to tune on), `test` (200, to report), or a file .txt with worlds of
    your own, one a line."""
    reach: First[tuple[float, ...]] = REACHES
    """Metres, one or more of 4, 6, 8 and 10."""
    out: First[Path | None] = None
    """Folder that gets a benchmark folder for each reach, such as `reach-4`. Unless given, `sweep/SUITE`."""

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where a mission failed."""
        from dream.evaluation.runner import Plan
        from dream.evaluation.suites import suite_named

        engine, cases = self.chosen_engine(), suite_named(self.suite)
        if not self.reach:
            raise ValueError(
                f"--reach: expected one or more of {', '.join(f'{r:g}' for r in REACHES)}, got none"
            )
        if strays := [reach for reach in self.reach if reach not in REACHES]:
            raise ValueError(
                f"--reach: expected one or more of {', '.join(f'{r:g}' for r in REACHES)}, got {strays[0]:g}"
            )
        protocols = {reach: protocol_named(reach_variant(reach)) for reach in self.reach}
        planners = self.chosen_planners(next(iter(protocols.values())))
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
