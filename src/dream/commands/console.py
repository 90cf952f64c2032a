"""What commands share: how they print, show progress and find a world."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from dream.sim.world import World

T = TypeVar("T")


def open_world(name: str, seed: int) -> World:
    """A world by its name and seed, or the one saved in the folder of that name."""
    from dream.sim.files import load_world
    from dream.sim.worlds import make_world

    return load_world(Path(name)) if (Path(name) / "world.json").is_file() else make_world(name, seed)


def with_progress(items: Iterator[T], title: str, total: int) -> Iterator[T]:
    """Pass items on, with a progress bar on standard error where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=total)
        for done, item in enumerate(items):
            bar.update(task, completed=done)
            yield item


def print_json(record: Mapping[str, Any]) -> None:
    """Print exactly one JSON object."""
    print(json_format.dumps(record, allow_nan=False))
