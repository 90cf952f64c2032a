"""The pages of the documentation, as tests read them: prose, headings, links and tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path

ROOT = Path(__file__).parents[2]
FENCED = re.compile(r"^( *)```.*?^\1```[^\n]*$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`[^`\n]*`")
HEADING = re.compile(r"^#{1,6} +(.+?) *$", re.MULTILINE)
LINK = re.compile(r"\]\(<?([^()<>\s]*(?:\([^()\s]*\))?[^()<>\s]*)>?\)")


def markdown() -> list[Path]:
    """All pages in the repository that people read: not the prompts, which models are sent."""
    return sorted([*ROOT.glob("*.md"), *ROOT.joinpath("docs").rglob("*.md")])


def named(path: Path) -> str:
    """A file as it is called from the root of the repository."""
    return path.relative_to(ROOT).as_posix()


def prose_of_markdown(text: str) -> str:
    """What is neither code nor the address of a link."""
    return LINK.sub("]", SPAN.sub("`", FENCED.sub("", text)))


def prose_of_html(text: str) -> str:
    """What a browser shows of a page, and the hints on its elements."""
    text = re.sub(r"<!--.*?-->|<(style|script)\b.*?</\1>", "", text, flags=re.DOTALL)
    hints = re.findall(r'\b(?:title|alt|aria-label|placeholder)="([^"]*)"', text)
    return unescape(" ".join([re.sub(r"<[^>]*>", " ", text), *hints]))


def prose_of_script(text: str) -> str:
    """The strings of a script that hold a blank: sentences, not keys."""
    text = re.sub(r"^\s*//.*$", "", text, flags=re.MULTILINE)
    strings = re.findall(r"\"([^\"\n]*)\"|'([^'\n]*)'|`([^`]*)`", text)
    spoken = (re.sub(r"\$\{[^}]*\}|<[^>]*>", " ", "".join(one)) for one in strings)
    return ". ".join(one for one in spoken if " " in one.strip())


def sentences(prose: str) -> Iterator[str]:
    """Without line breaks; a row of a table is one."""
    for block in re.split(r"\n\s*\n|\n(?=[|#*\-] ?)", prose):
        if block.startswith("|"):
            yield block
        else:
            yield from re.split(r"(?<=[.:!?;]) (?=[A-Z`\[(])", " ".join(block.split()))


def anchors(text: str) -> set[str]:
    """What `#...` in a link may name, as GitHub makes it of headings."""
    found: set[str] = set()
    for heading in HEADING.findall(FENCED.sub("", text)):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        stem = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        name, number = stem, 0
        while name in found:
            number += 1
            name = f"{stem}-{number}"
        found.add(name)
    return found | set(re.findall(r"<a (?:id|name)=\"([^\"]+)\"", text))


def tables(text: str) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Each table: the heading that it stands under, its head, its rows."""
    heading, rows = "", list[list[str]]()
    for line in [*FENCED.sub("", text).splitlines(), ""]:
        if found := HEADING.match(line):
            heading = found[1]
        if line.startswith("|"):
            # A bar within a code span, or behind a backslash, parts no cells.
            cells = re.split(r"(?<!\\)\|", re.sub(r"`[^`]*`", lambda m: m[0].replace("|", "\0"), line))
            rows.append([cell.replace("\0", "|").strip() for cell in cells[1:-1]])
        elif rows:
            yield heading, rows[0], rows[2:]
            rows = []
