"""An HTML page as a browser takes it."""

from __future__ import annotations

from html.parser import HTMLParser


class Seen(HTMLParser):
    """What a browser would show, load and run."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.tags, self.loads = "", [], []
        self.feed(text)
        self.close()

    text: str
    tags: list[str]
    loads: list[str]

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [value or "" for name, value in attributes if name in ("src", "href", "onload")]

    def handle_data(self, data: str) -> None:
        self.text += data
