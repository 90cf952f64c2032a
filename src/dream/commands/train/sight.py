"""`dream train sight`: a network that tells labels and depth from colours."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dream.commands.console import check_writable, print_json
from dream.commands.train.parts import done
from dream.options import First
from dream.telling import rich_console


@dataclass(frozen=True, slots=True)
class TrainSight:
    """Teach a network to tell labels and depth from colours, altitude and attitude.

    First views of simulated worlds are drawn, as in air, with their labels and depth. Then a network learns
    from them, each time through other water, light and camera faults. Last it is marked on views of other
    worlds. `sight.onnx` is the network, `sight.json` its card. Try it with
    `dream dive --see sight/sight.onnx`.

    With its defaults it makes the network that comes with DREAM: some eighty minutes on two cores, 4 GB of
    pictures, or minutes on a GPU. It never learns from a world of a suite. After an interruption the same
    command goes on, from at most ten minutes before.

    Examples:
        dream train sight
        dream train sight --albums 1 --batches 300 --out try
    """

    out: First[Path] = Path("sight")
    """Folder of the pictures, the network and its card."""
    albums: First[int] = 16
    """Files of pictures to learn from, of 40 worlds with ten views each."""
    batches: First[int] = 2900
    """That it learns from: of 48 pictures at half the size, then of 16."""
    seed: First[int] = 0
    """Seed of all that is drawn. The same seed on the same machine gives the same network."""
    jobs: First[int | None] = None
    """Albums at a time. Unless given, one for each processor."""
    device: First[str] = "auto"
    """Where it learns: cpu, cuda, or auto, which takes a GPU if there is one."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.engines import Processes
        from dream.learning.sight.making import CARD, MODEL, Making, make
        from dream.learning.sight.training import SightTraining

        making = Making(self.albums, self.seed, training=SightTraining(batches=self.batches, seed=self.seed))
        engine = Processes(self.jobs)
        check_writable(self.out)
        done(make(making, self.out, engine, self.device), self.out)
        card = json.loads((self.out / CARD).read_text(encoding="utf-8"))
        if self.json:
            print_json({"out": str(self.out), "card": card})
        else:
            _print(card["marks"], self.out / MODEL)
        return 0


def _print(marks: dict[str, Any], model: Path) -> None:
    """The marks as a table."""
    from rich.table import Table

    table = Table(title=f"{marks['pictures']} pictures of worlds that nothing was learned from")
    table.add_column("")
    table.add_column("", justify="right")
    for name, share in marks["iou"].items():
        table.add_row(f"IoU of {name}", f"{share:.2f}")
    table.add_row("IoU, mean", f"{marks['mean_iou']:.2f}")
    table.add_row("IoU of target within 6 m", f"{marks['target_iou_within_6_m']:.2f}")
    table.add_row("relative error of depth within 8 m", f"{marks['depth_relative_error_within_8_m']:.1%}")
    table.add_row("depth right to a quarter", f"{marks['depth_within_a_quarter']:.1%}")
    for name in ("labels", "depths"):
        both = marks[name]
        table.add_row(f"confidence in {name}, and right", f"{both['confidence']:.0%}, {both['right']:.0%}")
    console = rich_console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    console.print(str(model), markup=False, highlight=False, soft_wrap=True)
