"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def whole_or_nothing(path: Path) -> Iterator[Path]:
    """A path to write to, whose file takes the place of `path` once the block is done; else nothing stays.

    A process that is killed in between leaves its part, a hidden file beside `path` that ends in `.partial`,
    so that nobody who looks for files of its kind finds it.

    Raises:
        OSError: It could not be written; the message names it. One that the block tells of in its own words
            is passed on.
    """
    # Nobody else's: another may be writing to the same path.
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        # The system's have a number; one without tells already what could not be done.
        if error.errno is None:
            raise
        raise OSError(f"could not write {path} ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def first_or_nothing(path: Path) -> Iterator[Path]:
    """A path to write to, whose file is put at `path` once the block is done, unless there is one by then.

    For a file that others may be adding to as soon as it is there, so that none may take its place.

    Raises:
        OSError: It could not be put there; the message names it. One of the block is passed on.
    """
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        try:
            os.link(partial, path)
        except FileExistsError:
            pass
        except OSError as error:
            # Not every file system has links. There the one that comes between these two is replaced.
            if not path.exists():
                try:
                    partial.replace(path)
                except OSError:
                    raise OSError(f"could not write {path} ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; it survives a loss of power once this returns.

    Raises:
        OSError: It could not be written; the message names it.
    """
    with whole_or_nothing(path) as partial, partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    # Not every system lets a folder be opened or synchronised; there the rename alone must do.
    with contextlib.suppress(OSError):
        descriptor = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
