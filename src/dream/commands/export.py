"""`dream export`: a recorded dive as a data set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dream.commands.console import print_json
from dream.commands.progress import with_progress
from dream.options import First

if TYPE_CHECKING:
    from dream.recording import RunConfig


@dataclass(frozen=True, slots=True)
class Export:
    """Make a data set of a dive for others: pictures, depth, labels, poses and decisions.

    Its README.md says what is in it, in which frames and units. After an interruption the same command goes
    on. A simulated run can be exported too, if it was flown with --keep-observations.

    Examples:
        dream export runs/latest --to tank --title "A tank with an arc of shells"
    """

    run: tyro.conf.Positional[Path]
    """Folder of the run."""
    to: Path
    """Folder to make. It must not exist."""
    title: str
    """Name of the data set."""
    what: First[str] = ""
    """What the data set shows, in a sentence or two."""
    where: First[str] = ""
    """Where the dive was."""
    sensors: First[str] = ""
    """Vehicle, camera, lights and DVL."""
    labels_by: First[str] = ""
    """How labels and depth were made, and by which model."""
    authors: First[tuple[str, ...]] = ()
    """Whom to name, and how to reach them: "Ada L. <ada@example.org>"."""
    licence: First[str] = ""
    """SPDX name of the licence that the owner of the data chose, such as CC-BY-4.0."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream import recording
        from dream.robots.bluerov2.dataset import Card, export
        from dream.robots.bluerov2.log import dive_began

        config, steps = recording.read_config(self.run), recording.read_steps(self.run)
        card = Card(
            title=self.title,
            what=" ".join(filter(None, (self.what, _simulated(config)))),
            where=self.where,
            sensors=self.sensors,
            labels_by=self.labels_by,
            began=dive_began(self.run),
            authors=self.authors,
            licence=self.licence,
        )
        made = export(
            self.run,
            self.to,
            card,
            (step.model_dump(mode="json") for step in steps),
            watched=lambda files: with_progress(files, f"exporting {self.title}", len(files), "frames"),
        )
        told = {"frames": made.frames, "decisions": made.decisions, "bytes": made.nbytes}
        if self.json:
            print_json({"run": str(self.run), "to": str(made.folder), **told})
        else:
            print(
                f"{made.folder}: {made.frames} frames, {made.decisions} decisions, {made.nbytes / 1e6:.1f} MB"
            )
        return 0


def _simulated(config: RunConfig) -> str:
    """Said of what no camera has seen; empty of a dive in real water."""
    if config.real:
        return ""
    return f"Simulated: world {config.world}, seed {config.seed}, protocol {config.protocol}."
