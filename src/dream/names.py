"""Things chosen by name, and the answer to a name that does not exist."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")


def look_up(table: Mapping[str, T], name: str, kind: str, *, see: str = "") -> T:
    """The entry of that name.

    Raises:
        ValueError: With the nearest name, and with all of them or with where to see them.
    """
    if name in table:
        return table[name]
    near = difflib.get_close_matches(name, table, n=1, cutoff=0.4)
    hint = f' Did you mean "{near[0]}"?' if near else ""
    raise ValueError(f'no {kind} "{name}".{hint} {see or "There are: " + ", ".join(table)}')
