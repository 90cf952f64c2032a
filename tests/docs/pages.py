"""What stands in the fenced blocks of a page."""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
DOCS = REPOSITORY / "docs"
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)


def fenced(page: Path) -> list[tuple[str, str]]:
    """Its blocks in their order: the language that each is marked with, and its text."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))
