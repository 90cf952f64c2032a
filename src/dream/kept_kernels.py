"""Compiled kernels that numba keeps, dropped where any kernel's source has changed since.

Numba looks at the file that a kernel stands in, alone. It would go on running a kernel whose callee in
another file has changed, and fail where a type of its arguments has another name.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from dream.files import write_whole

STAMP = "kernels.sha256"
"""File in the package's `__pycache__`: what the sources were from which is kept."""


def drop_outdated(package: Path) -> None:
    """Drop all that is kept beside the sources if any of them is another than it was, by its time and size.

    A package that cannot be written to is left as it is: nothing of it is kept there either.
    """
    kernels, kept = _files(package)
    digest = hashlib.sha256()
    for path in sorted(kernels):
        state = path.stat()
        digest.update(f"{path.relative_to(package)} {state.st_mtime_ns} {state.st_size}\n".encode())
    stamp, now = package / "__pycache__" / STAMP, digest.hexdigest().encode()
    with contextlib.suppress(OSError):
        if stamp.read_bytes() == now:
            return
    with contextlib.suppress(OSError):
        for folder in kept:
            for path in folder.glob("*.nb[ci]"):
                path.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        write_whole(stamp, now)


def _files(package: Path) -> tuple[list[Path], list[Path]]:
    """Sources of kernels, and the folders in which their compiled code is kept."""
    kernels, kept = [], []
    for place, folders, names in os.walk(package):
        here = Path(place)
        if "__pycache__" in folders:
            folders.remove("__pycache__")
            kept.append(here / "__pycache__")
        kernels += [here / name for name in names if name.endswith(".py") and _is_kernel(here, name)]
    return kernels, kept


def _is_kernel(folder: Path, name: str) -> bool:
    return folder.name == "_kernels" or name == "_kernels.py"
