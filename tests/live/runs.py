"""Run folders that grow line by line, as a mission writes them."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path
from typing import Any

from dream.recording import record, write_config, write_summary
from tests.recorded_runs import CONFIG, SUMMARY, painted_coverage, painted_mission

STEPS = 6


def recorded_once(folder: Path) -> Path:
    """A whole run of six steps, of which others are made."""
    folder.mkdir()
    write_config(folder, CONFIG)
    for _ in itertools.islice(record(painted_mission(STEPS), folder, annotate=painted_coverage), STEPS):
        pass
    return folder


class Growing:
    """A run folder with the pictures of all steps, and as many lines as were told."""

    def __init__(self, folder: Path, whole: Path, **config: Any) -> None:
        self.folder = folder
        self.lines = (whole / "steps.jsonl").read_bytes().splitlines(keepends=True)
        shutil.copytree(whole, folder, ignore=shutil.ignore_patterns("steps.jsonl", "config.json"))
        write_config(folder, {**CONFIG, **config})
        (folder / "steps.jsonl").touch()
        self.written = 0

    def write(self, count: int = 1) -> Growing:
        """The next lines."""
        for line in self.lines[self.written : self.written + count]:
            self.append(line)
        self.written += count
        return self

    def append(self, text: bytes) -> None:
        """Whatever it is, at the end of the lines."""
        with (self.folder / "steps.jsonl").open("ab") as lines:
            lines.write(text)

    def end(self, **summary: Any) -> None:
        """The mission is over."""
        write_summary(self.folder, {**SUMMARY, "steps": self.written - 1, **summary})
