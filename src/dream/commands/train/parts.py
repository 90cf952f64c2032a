"""How far a training is, told part by part."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from dream.commands.progress import Stage, stage

if TYPE_CHECKING:
    from dream.learning.curriculum import Progress


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
