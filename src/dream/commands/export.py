"""`dream export`: a recorded dive as a data set, or a run in three dimensions as one file."""

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

    Of a run in three dimensions (its folder has space.npz) it makes one file for other programs, too: targets
    coloured by what was seen and inspected, what stands around them, the map, and the path. The suffix says
    which: .glb is glTF 2.0, whose y is up and whose z is south; .ply has the axes of the world, without path.

    Examples:
        dream export runs/latest --to tank --title "A tank with an arc of shells"
        dream export runs/latest --to wreck.glb
    """

    run: tyro.conf.Positional[Path]
    """Folder of the run."""
    to: Path
    """Folder to make, or a file .glb or .ply. It must not exist."""
    title: First[str] = ""
    """Name of the data set, which needs one."""
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
        if self.to.suffix.lower() in (".glb", ".ply"):
            return self._scene()
        if not self.title:
            raise ValueError("--title: expected the name of the data set, got none")
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

    def _scene(self) -> int:
        """The run in three dimensions as one file."""
        from dream import recording
        from dream.scene import SPACE, load
        from dream.scene.exports import WRITERS

        recording.read_config(self.run)
        if not (self.run / SPACE).exists():
            raise ValueError(
                f"{self.run}: expected a run in three dimensions, got no {SPACE} in it. "
                "It is made under a protocol in which the vehicle climbs, such as dream-v2"
            )
        if self.to.exists():
            raise ValueError(f"--to: expected a file that does not exist, got {self.to}")
        WRITERS[self.to.suffix.lower()](load(self.run / SPACE), self.to)
        size = self.to.stat().st_size
        if self.json:
            print_json({"run": str(self.run), "to": str(self.to), "bytes": size})
        else:
            print(f"{self.to}: {size / 1e6:.1f} MB")
        return 0


def _simulated(config: RunConfig) -> str:
    """Said of what no camera has seen; empty of a dive in real water."""
    if config.real:
        return ""
    return f"Simulated: world {config.world}, seed {config.seed}, protocol {config.protocol}."
