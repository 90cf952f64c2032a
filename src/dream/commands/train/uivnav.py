"""`dream train uivnav`: a network that steers by sight, learned from a teacher in simulated reefs."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dream.commands.console import check_writable, print_json
from dream.commands.progress import stage
from dream.commands.train.parts import done
from dream.options import First
from dream.protocol import DREAM_V1
from dream.telling import rich_console


@dataclass(frozen=True, slots=True)
class TrainUivnav:
    """Teach a network to steer by sight, as the planner uivnav does: no map, no position, no memory.

    A teacher who sees only the present picture flies simulated reefs. To each picture it says how likely it
    would turn which way, and a student learns to say the same. Then the student flies, the teacher says what
    it would have done there, and a new student learns from all of it: once for each of the --rounds. All
    students fly trials on other reefs, and the best is kept: `uivnav.onnx`, and `uivnav.json`, its card. Try
    it with `dream run uivnav --protocol dream-v1 --weights train/uivnav.onnx`.

    With its defaults it makes the network that comes with DREAM, in some minutes on two cores. It
    never learns from a world of a suite. After an interruption the same command goes on.

    Examples:
        dream train uivnav
        dream train uivnav --missions 9 --rounds 0 --epochs 1 --out try
    """

    out: First[Path] = Path("train")
    """Folder of the pictures, the students, the network and its card."""
    missions: First[int] = 126
    """Missions that the teacher flies, in nine kinds of reef in turn."""
    more: int = 45
    """Missions that the student flies in each further round."""
    rounds: First[int] = 1
    """Further rounds. 0 learns from the teacher's missions alone; more can be asked for later."""
    steps: int = 150
    """Steps of each mission."""
    epochs: First[int] = 8
    """How often a student sees each picture."""
    trials: int = 18
    """Worlds in which the students are tried."""
    seed: First[int] = 0
    """Seed of all that is drawn. The same seed on the same machine gives the same network."""
    jobs: First[int | None] = None
    """Missions at a time. Unless given, one for each processor."""
    device: First[str] = "auto"
    """Where a student learns: cpu, cuda, or auto, which takes a GPU if there is one."""
    lerobot: First[Path | None] = None
    """Folder to make of the missions that were learned from: a data set that LeRobot 3.0 reads."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.engines import Processes
        from dream.learning import lerobot
        from dream.learning.curriculum import CARD, MODEL, Curriculum, learn, missions
        from dream.learning.training import Training

        curriculum = Curriculum(
            missions=self.missions,
            more=self.more,
            rounds=self.rounds,
            steps=self.steps,
            trials=self.trials,
            seed=self.seed,
            training=Training(epochs=self.epochs, seed=self.seed),
        )
        engine = Processes(self.jobs)
        check_writable(self.out)
        if self.lerobot is not None:
            lerobot.check_possible(self.lerobot)
        done(learn(curriculum, self.out, engine, self.device), self.out)
        card = json.loads((self.out / CARD).read_text(encoding="utf-8"))
        if self.lerobot is not None:
            episodes = (
                lerobot.Episode("Steer over the target in view.", frames.images, frames.odds)
                for frames in missions(curriculum, self.out)
            )
            with stage(f"writing {self.lerobot}"):
                lerobot.export(episodes, self.lerobot, advance=max(DREAM_V1.advances))
        if self.json:
            print_json({"out": str(self.out), "card": card})
        else:
            _print(card, self.out / MODEL)
        return 0


def _print(card: dict[str, Any], model: Path) -> None:
    """The trials as a table, and what came of them."""
    from rich.table import Table

    trials = card["trials"]
    table = Table(title=f"{trials['worlds']} reefs that nothing was learned from, {trials['steps']} steps")
    for heading in ("", "of the targets", "targets a metre", "metres"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in trials["rows"].items():
        table.add_row(name, f"{row['share']:.1%}", f"{row['targets_per_metre']:.2f}", f"{row['metres']:.1f}")
    console = rich_console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    console.print(f"{model}: {card['chosen']}", markup=False, highlight=False, soft_wrap=True)
