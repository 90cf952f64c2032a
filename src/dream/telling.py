"""Words that came from outside → words that a terminal may be given.

A name in a file may hold commands to a terminal: to colour it, to write elsewhere on it, to set its title or
its clipboard, to turn the direction of what is read. None of them gets there: what cannot be printed is shown
as Python writes it in a string, `\\x1b`.

Reference: ECMA-48, of control functions; Unicode 16.0, general categories Cc, Cf, Zl, Zp and Cs.
"""

from __future__ import annotations

import contextlib
import sys
import unicodedata
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, TextIO, cast

if TYPE_CHECKING:
    from rich.console import Console

MOST = 2000
"""Characters of a line that tells of an error."""
LAST = 500
"""Of those, from its end: what to do next stands there."""
MOST_LINES = 100
"""Of what is told at a time."""

_JOINERS = "\u200c\u200d"
"""Without which some scripts cannot be written; they command nothing."""


def cleaned(text: str) -> str:
    """The text without anything that a terminal might take for a command; lines and tabs stay."""
    if text.isprintable():
        return text
    return "".join(map(_shown, text))


def one_line(text: str) -> str:
    """The text as one line, cleaned, and cut where it is long; the line says how much was left out."""
    # Cut first: what follows costs time by its length.
    text = cleaned(" ".join(_cut(text).split()))
    return _cut(text)


def in_lines(text: str) -> str:
    """The text in its lines, each as `one_line` has it, the first and the last of very many."""
    found = text.split("\n")
    if len(found) > MOST_LINES:
        half = MOST_LINES // 2
        found = [*found[:half], f"… ({len(found) - 2 * half} lines left out) …", *found[-half:]]
    return "\n".join(map(_kept_indent, found))


def _kept_indent(text: str) -> str:
    return " " * min(len(text) - len(text.lstrip(" ")), 40) + one_line(text)


def _cut(text: str) -> str:
    if len(text) <= MOST:
        return text
    room = 60  # For the words in between.
    left = len(text) - (MOST - room)
    return f"{text[: MOST - room - LAST]}… ({left} characters left out) …{text[-LAST:]}"


def _shown(letter: str) -> str:
    if letter.isprintable() or letter in "\n\t" or letter in _JOINERS or unicodedata.category(letter) == "Zs":
        return letter
    return letter.encode("unicode_escape", "surrogatepass").decode("ascii")


class Cleaned:
    """A stream whose text is cleaned on the way to another; in all else it is that other."""

    def __init__(self, stream: TextIO) -> None:
        """In front of that stream."""
        self.behind = stream

    def write(self, text: str) -> int:
        """Pass text on, cleaned."""
        self.behind.write(cleaned(text))
        return len(text)

    def writelines(self, texts: Any) -> None:
        """Pass several on."""
        for text in texts:
            self.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.behind, name)


@contextlib.contextmanager
def clean_streams() -> Iterator[None]:
    """Let nothing but text through `sys.stdout` and `sys.stderr` while the block lasts.

    What draws on a terminal on purpose takes a `rich_console`.
    """
    with contextlib.ExitStack() as stack:
        for stream, put in (
            (sys.stdout, contextlib.redirect_stdout),
            (sys.stderr, contextlib.redirect_stderr),
        ):
            if stream is not None and not isinstance(stream, Cleaned):
                stack.enter_context(put(cast("TextIO", Cleaned(stream))))
        yield


def rich_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """The console of rich for a command: it draws, but the words in what it draws are only words.

    Args:
        stderr: Draws on standard error.
        width: Columns, where it is not that of the terminal.
    """
    from rich.console import Console
    from rich.segment import Segment

    class Terminal(Console):
        def render(self, renderable: Any, options: Any = None) -> Any:
            for text, style, control in super().render(renderable, options):
                if control is None:
                    # A link is a command too, and nothing here makes one.
                    plain = style.update_link(None) if style is not None and style.link else style
                    yield Segment(cleaned(text), plain)
                else:
                    yield Segment(text, style, control)

    stream = sys.stderr if stderr else sys.stdout
    behind = stream.behind if isinstance(stream, Cleaned) else stream
    # Words in brackets and between colons are not for rich to read either.
    return Terminal(file=behind, stderr=stderr, width=width, markup=False, emoji=False)
