"""Who decided: what has to be kept to know a planner again."""

from __future__ import annotations

import hashlib
import inspect
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dream.planning import AnyPlanner, Asking
from dream.planning.baselines.uivnav import weights_sha256
from dream.planning.vlm.prompts import own_prompts


def identity(name: str, planner: AnyPlanner) -> dict[str, Any]:
    """What `config.json` says of who decides.

    Args:
        name: Of the planner, perhaps with a label.
        planner: With its parameters.

    Raises:
        ValueError: A file that it is given cannot be read.
    """
    return {
        "planner": name,
        "planner_parameters": asdict(planner),
        "weights_sha256": weights_sha256(planner),
        "prompts_sha256": prompts_sha256(planner),
    }


def prompts_sha256(planner: AnyPlanner) -> dict[str, str]:
    """SHA-256 of every prompt that a planner is given in the place of the package's, by name."""
    if not isinstance(planner, Asking):
        return {}
    return {name: prompt.own for name, prompt in own_prompts(planner.prompts).items()}


def files_given(planner: AnyPlanner) -> dict[str, str]:
    """SHA-256 of all files besides this package that decide, by what they are; other ones, other missions.

    A planner of one's own is told by the file that its class stands in; what that imports is not followed,
    and one that was typed at a prompt has none.

    Raises:
        ValueError: One cannot be read.
    """
    given = {"weights": weights_sha256(planner), "code": _code_sha256(type(planner))}
    return prompts_sha256(planner) | {name: sha256 for name, sha256 in given.items() if sha256 is not None}


def _code_sha256(kind: type) -> str | None:
    """SHA-256 of the file of a class; None of the package's own, which `machine.source` tells."""
    if kind.__module__.partition(".")[0] == "dream":
        return None
    try:
        file = inspect.getsourcefile(kind)
        return None if file is None else hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except (OSError, TypeError):
        return None
