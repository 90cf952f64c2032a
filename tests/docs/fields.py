"""What `docs/files.md` says that files hold."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import Any

from tests.docs.reading import ROOT, tables

PAGE = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")


def described(heading: str, *, table: int = 0, columns: int = 1) -> list[str]:
    """The first columns of a table, joined by dots.

    Args:
        heading: Under which it stands.
        table: Which of those under it.
        columns: How many name a thing, such as a layer and its column.
    """
    found = [rows for at, _, rows in tables(PAGE) if at.replace("`", "") == heading]
    assert len(found) > table, f"docs/files.md: no table {table} under {heading}"
    names = [".".join(cell.strip("`") for cell in row[:columns]) for row in found[table]]
    assert len(set(names)) == len(names), f"docs/files.md: {heading} tells something twice"
    return names


def types(heading: str) -> dict[str, str]:
    """Unit and type by name, over all tables under a heading."""
    return {
        row[0].strip("`"): row[1]
        for at, _, rows in tables(PAGE)
        if at.replace("`", "") == heading
        for row in rows
    }


def keys(content: Any, told: Collection[str], path: str = "") -> Iterator[str]:
    """The keys of an object as the page names them: `a.b`, and `a[].b` of the objects in a list.

    What the page tells as a whole is not gone into, nor is what is null or empty.
    """
    inside = [name for name in told if re.match(rf"{re.escape(path)}(\.|\[\])", name)]
    if path in told:
        yield path
        if not inside:
            return
    if isinstance(content, dict):
        for name, value in content.items():
            yield from keys(value, told, f"{path}.{name}" if path else name)
    elif isinstance(content, list) and inside:
        for value in content:
            yield from keys(value, told, f"{path}[]")
    elif path not in told and not (content is None and inside):
        yield path
