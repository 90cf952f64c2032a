"""Who decided: what has to be kept to know a planner again."""

from __future__ import annotations

from dataclasses import asdict
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
    """SHA-256 of all files that a planner is given, by what they are: another file makes other missions.

    Raises:
        ValueError: One cannot be read.
    """
    weights = weights_sha256(planner)
    return prompts_sha256(planner) | ({} if weights is None else {"weights": weights})
