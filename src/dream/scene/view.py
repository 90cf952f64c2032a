"""The viewer of a scene as parts of a page: no library, and nothing that is loaded."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

from dream.scene.encoding import encoded
from dream.scene.files import load


def part(name: str) -> str:
    """A file of the viewer: `space.html`, `space.css`, `space.js` or `space_report.js`."""
    return resources.files("dream").joinpath("scene/page", name).read_text(encoding="utf-8")


def shown(path: Path) -> dict[str, Any]:
    """What a page gets of a file of a scene.

    Returns:
        `scene`: See `encoding.encoded`; None where the file cannot be shown.
        `problem`: Why not, in words; None where it can.
    """
    try:
        return {"scene": encoded(load(path)), "problem": None}
    except (OSError, ValueError) as error:
        why = str(error).replace(str(path), path.name)
        return {"scene": None, "problem": f"The view in three dimensions is left out. {why}"}
