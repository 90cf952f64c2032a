"""Compiled kernels that numba keeps beside the sources, dropped where a source of theirs has changed since.

Numba looks at the file that a kernel stands in, alone. It would go on running a kernel whose callee in
another file has changed, and fail where a type of its arguments has another name.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from dream.files import whole_or_nothing

STAMP = "kernels.sha256"
"""File in the package's `__pycache__`: what the sources were from which is kept."""
TYPES = ("lattice.py", "mapping/gain.py", "mapping/visibility.py")
"""Files that are no kernels, but define what kernels take."""


def drop_outdated(package: Path) -> None:
    """Drop all that is kept beside the sources if one of them is another than it was, by its time and size.

    A package that cannot be written to is left as it is. What numba keeps elsewhere (`NUMBA_CACHE_DIR`, the
    user's cache where the package cannot be written to) is not looked at, and a process that began before a
    source was changed may keep code of the old one.
    """
    sources, kept = _files(package)
    digest = hashlib.sha256()
    for path in sources:
        # One that has just gone is none.
        with contextlib.suppress(OSError):
            state = path.stat()
            digest.update(f"{path.relative_to(package)} {state.st_mtime_ns} {state.st_size}\n".encode())
    stamp, now = package / "__pycache__" / STAMP, digest.hexdigest().encode()
    with contextlib.suppress(OSError):
        if stamp.read_bytes() == now:
            return
    with contextlib.suppress(OSError):
        stamp.parent.mkdir(exist_ok=True)
        # The stamp is written first and put in its place last: where it cannot be, nothing is dropped, and
        # where something cannot be dropped, it is tried again.
        with whole_or_nothing(stamp) as partial:
            partial.write_bytes(now)
            for folder in kept:
                for path in folder.glob("*.nb[ci]"):
                    path.unlink(missing_ok=True)


def _files(package: Path) -> tuple[list[Path], list[Path]]:
    """Sources of kernels, in order, and the folders in which their compiled code is kept."""
    sources, kept = [package / name for name in TYPES], []
    for place, folders, names in os.walk(package):
        here = Path(place)
        if "__pycache__" in folders:
            folders.remove("__pycache__")
            kept.append(here / "__pycache__")
        if here.name == "_kernels":
            sources += [here / name for name in names if name.endswith(".py")]
        elif "_kernels.py" in names:
            sources.append(here / "_kernels.py")
    return sorted(sources), kept
