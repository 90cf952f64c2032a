"""Things chosen by name, and the answer to a name that does not exist."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")


def look_up(table: Mapping[str, T], name: str, kind: str, *, see: str = "") -> T:
    """The entry of that name.

    Raises:
        ValueError: With the nearest name, or with all of its family, such as `reef/`, where none is near;
            and with all of them or with where to see them.
    """
    if name in table:
        return table[name]
    family = name[: name.find("/") + 1] or f"{name}/"
    if not any(one.startswith(family) for one in table):
        family = ""
    rest, others = name[len(family) :], [one[len(family) :] for one in table if one.startswith(family)]
    # All numbers are as near as each other.
    near = [] if rest.isdigit() else difflib.get_close_matches(rest, others, n=1, cutoff=0.4)
    hint = f' Did you mean "{family}{near[0]}"?' if near else ""
    if family and not near:
        hint = f" Of {family} there are: {', '.join(others)}."
    raise ValueError(f'no {kind} "{name}".{hint} {see or "There are: " + ", ".join(table)}')
