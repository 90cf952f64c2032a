"""What a plain installation lacks is asked for in one sentence, with the command that adds it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import re
import shlex
import sys
from pathlib import Path

NAME = "dream-auv"
"""Of the distribution that brings this package."""


def check_installed(extra: str, what: str, *modules: str) -> None:
    """Raise a ValueError, with `missing` as its words, where one of the modules cannot be found."""
    for module in modules:
        if not _is_there(module):
            raise ValueError(missing(extra, module, what))


def missing(extra: str, module: str, what: str) -> str:
    """What to say where something needs a module of an extra that is not installed.

    Args:
        extra: Name of the extra, as in `pyproject.toml`.
        module: What could not be imported.
        what: What needs it: a command, an option, a planner or a thing.
    """
    return f"{what}: expected the Python module {module}, got none. To add it: {how_to_add(extra)}"


def how_to_add(extra: str) -> str:
    """The command that adds an extra to this Python: `make setup` in a clone, else that of an installer.

    The installer is given what the extra needs and not this package's name, which an index need not know.
    """
    clone, wanted = _clone(), _requirements(extra)
    its_own = clone is not None and Path(sys.prefix).resolve() == (clone / ".venv").resolve()
    if clone is None and not wanted:
        return f"install what the extra {extra} of DREAM needs"
    if its_own or not wanted:
        where = "" if clone == Path.cwd() else f"-C {shlex.quote(str(clone))} "
        return f"make {where}setup EXTRAS={extra}"
    python = shlex.quote(sys.executable)
    installer = f"{python} -m pip install" if _is_there("pip") else f"uv pip install --python {python}"
    return f"{installer} {shlex.join(wanted)}"


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # Of a package in one that is missing itself.
        return False


def _clone() -> Path | None:
    """The folder of the clone that this file lies in, if it lies in one."""
    root = Path(__file__).resolve().parents[2]
    return root if all((root / name).is_file() for name in ("Makefile", "pyproject.toml")) else None


def _requirements(extra: str) -> list[str]:
    """What the installed distribution says that the extra needs; nothing where none is installed."""
    try:
        stated = importlib.metadata.requires(NAME) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    found = []
    for requirement in stated:
        wanted, _, marker = requirement.partition(";")
        if re.search(rf"""\bextra == ['"]{re.escape(extra)}['"]""", marker):
            # What else the marker asks, as a version of Python, is left to the installer.
            rest = re.sub(r"""(\s+and\s+)?\bextra == ['"][\w-]+['"]""", "", marker).strip()
            found.append(f"{wanted.strip()}; {rest}" if rest else wanted.strip())
    return found
