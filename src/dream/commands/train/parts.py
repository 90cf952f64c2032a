"""How far a training is, told part by part."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from dream.commands.progress import Stage, stage
from dream.errors import MissionAborted

if TYPE_CHECKING:
    from dream.learning.curriculum import Progress


def done(work: Generator[Progress, None, None], out: Path) -> None:
    """Do all of it, and tell of each part.

    Raises:
        MissionAborted: It was interrupted; the message says that the same command goes on.
    """
    try:
        with contextlib.closing(work):
            for _ in shown(work):
                pass
    except KeyboardInterrupt:
        raise MissionAborted(
            f"aborted: interrupted; what is done is kept in {out}, and the same command goes on from there"
        ) from None


def shown(work: Iterator[Progress]) -> Iterator[Progress]:
    """Pass the work on, and tell of each part of it."""
    with contextlib.ExitStack() as stack:
        at: Stage | None = None
        for now in work:
            if at is None or at.title != now.part:
                stack.close()
                at = stack.enter_context(stage(now.part, now.total))
                at.spared = now.done
            at.done, at.said = now.done, now.said
            yield now
