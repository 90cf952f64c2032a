"""What may never leak: keys in what is told or kept, and headers that are meant for others."""

from __future__ import annotations

import os
import re
from functools import cache

from dream.telling import one_line

KEY = "DREAM_API_KEY"
"""Environment variable with the key for a server that is given by its address. No other key is sent there."""
LEAST_KEY = 8
"""Characters of a key that is looked for in what a model writes."""
LONG_WORD = 16
"""Characters of a word with digits in it that may be part of a key."""
PASSED_ON = frozenset(
    ("accept", "accept-encoding", "authorization", "connection", "content-length", "content-type", "host")
)
"""Headers that a server given by its address gets, beside what the client says of itself."""


def plain(text: str) -> str:
    """What a model wrote, without keys, and without halves of surrogate pairs, which no file could hold."""
    for name, value in os.environ.items():
        if name.endswith("_KEY") and len(value.strip()) >= LEAST_KEY:
            text = _spelt(value.strip()).sub("[key]", text)
    return text.encode(errors="replace").decode()


def plain_line(text: str, most: int) -> str:
    """The same in one line without control characters.

    Args:
        text: What a stranger wrote.
        most: Characters at most.
    """
    return one_line(plain(text))[:most]


def wary_line(text: str, most: int) -> str:
    """As `plain_line`, of a server that may repeat a part of a key: without long words that hold digits."""
    # Before it is cleaned: what cannot be printed is then shown by digits.
    words = plain(text[: 20 * most]).split()
    line = " ".join("..." if len(word) >= LONG_WORD and re.search(r"\d", word) else word for word in words)
    return one_line(line)[:most]


def is_passed_on(header: str) -> bool:
    """May a server at an address get this header? The environment may hold others, for makers."""
    name = header.lower()
    return name in PASSED_ON or name.startswith(("x-stainless-", "user-agent"))


@cache
def _spelt(key: str) -> re.Pattern[str]:
    """A key in all the ways in which JSON may spell it."""
    ways = (rf"(?:\\?{re.escape(c)}|\\u(?i:{ord(c):04x}))" for c in key)
    return re.compile("".join(ways))
