"""Engines that run here and now, and tell what they ran."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

from dream.evaluation.engines import Failure


@dataclass(slots=True)
class Inline:
    """Runs every item in this process; after `stops` of them it is interrupted."""

    stops: int | None = None
    ran: list[Any] = field(default_factory=list)

    def run(
        self, task: Callable[[Any], Any], groups: Sequence[Sequence[Any]]
    ) -> Generator[tuple[Any, Any | Failure], None, None]:
        for item in [item for group in groups for item in group]:
            if len(self.ran) == self.stops:
                raise KeyboardInterrupt
            self.ran.append(item)
            yield item, task(item)
