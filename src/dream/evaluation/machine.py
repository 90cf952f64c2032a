"""What a result was made with: the code, the libraries under it, and the machine."""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import dream
from dream.versions import commit

LIBRARIES = ("numpy", "numba", "scipy")
_SHOWS_ONLY = (
    *("cli.py", "commands", "learning", "live", "recording.py", "report.py", "report_page", "survey"),
    "versions.py",
)
_SCORES = ("metrics.py", "runner.py")


@cache
def source(*also: str) -> str:
    """SHA-256 of the code, and the data with it, that a mission's outcome can depend on.

    Where it is equal, results are.

    Args:
        also: Parts of the package on which more depends than a mission, such as `learning`.

    A commit says nothing of changes that were not committed, and an installed package has none.
    """
    root = Path(dream.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        parts = path.relative_to(root).parts
        if "__pycache__" in parts or not path.is_file():
            continue
        if parts[0] in _SHOWS_ONLY and parts[0] not in also:
            continue
        if parts[0] == "evaluation" and parts[1:] not in [(name,) for name in _SCORES]:
            continue
        digest.update("/".join(parts).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def code() -> dict[str, str | None]:
    """Version, commit and source of this package: results of other code do not belong beside its own."""
    return {"version": dream.__version__, "commit": commit(), "source": source()}


def libraries() -> dict[str, str]:
    """Versions of Python and of what computes."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


def machine() -> dict[str, Any]:
    """Processor, cores, memory and system of this machine; None for what it does not tell."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory_gb": _memory_gb(),
        "os": platform.platform(),
    }


def _processor() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, None) or platform.processor() or None


def _memory_gb() -> float | None:
    try:
        return round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9, 1)
    except (AttributeError, OSError, ValueError):
        return None
