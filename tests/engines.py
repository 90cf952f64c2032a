"""An engine that starts no process."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any

from dream.evaluation.engines import Failure


class InProcess:
    """Flies one mission after the other, here; what fails is that mission's failure, as of any engine."""

    def __init__(self, jobs: int | None = None) -> None:
        """As `Processes` is made."""

    def run(
        self, task: Callable[[Any], Any], groups: Sequence[Sequence[Any]]
    ) -> Generator[tuple[Any, Any], None, None]:
        for group in groups:
            for item in group:
                try:
                    outcome = task(item)
                except ValueError as error:
                    outcome = Failure(str(error))
                yield item, outcome
