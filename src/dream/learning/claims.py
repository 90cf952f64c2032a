"""Whose a folder of training is: what was begun by one plan is not gone on with by another."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dream.files import write_whole


def claim(folder: Path, plan: Mapping[str, Any]) -> None:
    """A folder is of this plan, or becomes it.

    Args:
        folder: Its `plan.json` says whose it is.
        plan: As JSON has it.

    Raises:
        ValueError: It is of another plan, or does not say whose it is.
        OSError: It cannot be written.
    """
    path = folder / "plan.json"
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        write_whole(path, (json.dumps(plan, indent=2) + "\n").encode())
        return
    except ValueError:
        before = None
    if not isinstance(before, dict):
        raise ValueError(f"{path}: expected one JSON object, got damaged text. Choose another --out")
    for name in plan:
        if before.get(name) != plan[name]:
            raise ValueError(
                f"{folder}: {name}: expected {before.get(name)} as for what is in it, got {plan[name]}. "
                "Choose another --out"
            )
