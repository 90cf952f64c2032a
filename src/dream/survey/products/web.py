"""What every HTML page of surveys is made of: it loads nothing, runs nothing, and opens anywhere.

It has the look of the report of a run. Text of surveys enters it escaped, pictures as data; its policy
forbids it everything else.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

from dream.report import digest, fill


@dataclass(frozen=True, slots=True)
class Masthead:
    """What stands above a page. All of it is text, and is escaped."""

    kind: str
    """What page it is, such as "survey report"."""
    place: str
    date: str
    how: str
    """A line on how it was got."""
    simulated: str
    """Said of what no camera has seen; empty of a dive in real water."""
    headlines: Sequence[tuple[str, str, str]]
    """Title, figure and interval of up to four."""


def page(masthead: Masthead, main: str, version: str, style: str = "") -> str:
    """A whole page.

    Args:
        masthead: What stands above.
        main: HTML of the rest, as `filled` gives it.
        version: Of the program.
        style: Rules to add to those that all pages share.
    """
    style = part("report_page/page.css") + part("survey/products/page.css") + style
    told = html.escape(masthead.simulated)
    return fill(
        part("survey/products/page.html"),
        {
            "policy": "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
            f"style-src {digest(style)}",
            "style": style,
            "title": html.escape(f"{masthead.place}, {masthead.date} · DREAM {masthead.kind}"),
            "kind": html.escape(masthead.kind),
            "place": html.escape(masthead.place),
            "date": html.escape(masthead.date),
            "how": html.escape(masthead.how),
            "simulated": f'<p class="outcome"><strong class="badge warn">{told}</strong></p>' if told else "",
            "headlines": "".join(
                f"<div><dt>{html.escape(title)}</dt><dd>{html.escape(value)}"
                f"<small>{html.escape(interval) or '&nbsp;'}</small></dd></div>"
                for title, value, interval in masthead.headlines
            ),
            "main": main,
            "version": html.escape(version),
        },
    )


def filled(name: str, parts: Mapping[str, str]) -> str:
    """A template beside this file, with each part, which is HTML, in its place."""
    return fill(part(f"survey/products/{name}"), parts)


def picture(content: bytes, kind: str, what: str) -> str:
    """A picture inside the page.

    Args:
        content: The file.
        kind: Such as `png`, `jpeg`, `svg+xml`.
        what: Said to who does not see it.
    """
    data = base64.b64encode(content).decode()
    return f'<img class="figure" alt="{html.escape(what)}" src="data:image/{kind};base64,{data}">'


def sharp_map(content: bytes, what: str, pixels: int) -> str:
    """A map that stays so large that its marks can be told apart, and is moved about where a screen is small.

    Args:
        content: The PNG.
        what: Said to who does not see it.
        pixels: Of the picture for each one of the page.
    """
    width = int.from_bytes(content[16:20], "big")  # Of its header, which comes first.
    drawn = picture(content, "png", what).replace('class="figure"', f'class="map" width="{width // pixels}"')
    return f'<div class="wide">{drawn}</div>'


def terms(of: Iterable[tuple[str, str]]) -> str:
    """What and its value, for a `dl`."""
    return "".join(f"<dt>{html.escape(what)}</dt><dd>{html.escape(value)}</dd>" for what, value in of)


def lines(of: Iterable[str]) -> str:
    """For a `ul`."""
    return "".join(f"<li>{html.escape(line)}</li>" for line in of)


def head(titles: Iterable[str]) -> str:
    """The headings of a table."""
    cells = "".join(f"<th scope='col'>{html.escape(title)}</th>" for title in titles)
    return f"<thead><tr>{cells}</tr></thead>"


def files(of: Sequence[tuple[str, str]]) -> str:
    """(name, what it is) of what lies beside the page; nothing where there is none."""
    if not of:
        return ""
    rows = "".join(
        f"<li><code>{html.escape(name)}</code> <span>{html.escape(what)}</span></li>" for name, what in of
    )
    return f"<section class='panel'><h2>Files beside this page</h2><ul class='files'>{rows}</ul></section>"


def part(name: str) -> str:
    """A file of the package as text."""
    return resources.files("dream").joinpath(name).read_text(encoding="utf-8")
