"""A connection to PostgreSQL that does not wait for ever on a server that hangs.

TCP does not tell: the system of a server whose programs stand still goes on acknowledging what it is sent.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any, TypeVar

import psycopg

T = TypeVar("T")

CONNECTING = 10.0
"""Seconds to wait for the first answers."""


class Silent(psycopg.OperationalError):
    """The server said nothing for as long as is waited for it."""


class PatientConnection(psycopg.Connection[Any]):
    """Gives up, and is closed, where the server neither says nor takes anything for some time."""

    patience = CONNECTING
    """Seconds. More than the server is given for a statement, or it could not tell that it took too long."""

    def wait(self, gen: Generator[Any, Any, T], *limits: Any, **more: Any) -> T:
        """What psycopg calls to go on with whatever it does on the connection."""
        return super().wait(self._heard(gen), *limits, **more)

    def _heard(self, gen: Generator[Any, Any, T]) -> Generator[Any, Any, T]:
        heard, ready = time.monotonic(), None
        while True:
            try:
                wanted = gen.send(ready)
            except StopIteration as done:
                answer: T = done.value
                return answer
            # Several times a second, with 0 where nothing came and nothing could be sent.
            ready = yield wanted
            now = time.monotonic()
            if ready:
                heard = now
            elif now - heard > self.patience:
                # Closed first: to roll back would be to ask it once more.
                self.close()
                raise Silent(f"it has said nothing for {self.patience:g} s")
