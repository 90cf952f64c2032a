"""Who decided: what has to be kept to know a planner again."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from typing import Any

from dream.own_code import is_own, own_file, shown
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
        **_own(planner),
    }


def _own(planner: AnyPlanner) -> dict[str, Any]:
    """Of a planner of one's own: its file, and what that holds."""
    kind = type(planner)
    file = own_file(kind) if is_own(kind) else None
    return {} if file is None else {"planner_file": shown(file), "planner_sha256": code_sha256(planner)}


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
    given = {"weights": weights_sha256(planner), "code": code_sha256(planner)}
    return prompts_sha256(planner) | {name: sha256 for name, sha256 in given.items() if sha256 is not None}


def code_sha256(planner: AnyPlanner) -> str | None:
    """SHA-256 of the file of a planner; None of the package's own, which `machine.source` tells."""
    kind = type(planner)
    file = own_file(kind) if is_own(kind) else None
    try:
        return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return None
