"""One process at a time writes to a place."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def alone_at(place: Path, lock: Path) -> Iterator[None]:
    """Keep other processes from writing to a place. However this one ends, the place is free.

    Args:
        place: What is written to, for the messages.
        lock: A file that stands for it, made with its folder where there is none. It stays: to take it away
            while another process waits for it would let two in.

    Raises:
        OSError: The lock's folder cannot be written.
        ValueError: Another process holds the lock.
    """
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        file = lock.open("w")
    except OSError as error:
        raise OSError(
            f"--out: expected a place that can be written, got {place} ({error.strerror}). Choose another"
        ) from error
    with file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as taken:
            raise ValueError(
                f"{place}: expected that no other process writes here, got one at work. "
                "Wait for it, or choose another --out"
            ) from taken
        except (ImportError, OSError):
            # Neither Windows nor every network disk has such locks; there the user takes care.
            pass
        yield
