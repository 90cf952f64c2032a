"""Every link in the pages, and every page that the program names, leads somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.reading import FENCED, LINK, ROOT, SPAN, anchors, markdown, named

SAID = re.compile(r"(?<![\w/.-])docs/[A-Za-z0-9_/-]+\.md(?:#[a-z0-9-]+)?")
ELSEWHERE = re.compile(r"[a-z]+:")


def leads_nowhere(target: str, at: Path) -> str | None:
    """What is wrong with a link from the file `at`; None where nothing is."""
    path, _, anchor = target.partition("#")
    file = (at.parent / path).resolve() if path else at
    if not file.exists():
        return f"{target}: no such file"
    if anchor and file.suffix == ".md" and anchor not in anchors(file.read_text(encoding="utf-8")):
        return f"{target}: no such heading"
    return None


@pytest.mark.parametrize("page", markdown(), ids=named)
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page: Path) -> None:
    text = SPAN.sub("", FENCED.sub("", page.read_text(encoding="utf-8")))
    targets = [one for one in LINK.findall(text) if not ELSEWHERE.match(one)]
    wrong = [leads_nowhere(target, page) for target in targets]
    assert [one for one in wrong if one] == []


@pytest.mark.parametrize("page", markdown(), ids=named)
def test_every_page_that_a_page_names_in_words_is_there(page: Path) -> None:
    text = re.sub(r"https?://\S+", "", page.read_text(encoding="utf-8"))
    wrong = [leads_nowhere(said, ROOT / "README.md") for said in SAID.findall(text)]
    assert [one for one in wrong if one] == []


def test_every_page_that_the_program_names_is_there() -> None:
    kinds = {".py", ".html", ".js", ".toml", ".md", ".json"}
    places = [ROOT / "src", ROOT / "examples", ROOT / "perf"]
    files = [file for place in places for file in place.rglob("*") if file.suffix in kinds]
    files += [ROOT / "Makefile", ROOT / "pyproject.toml"]
    wrong = [
        f"{named(file)}: {amiss}"
        for file in files
        for said in SAID.findall(file.read_text(encoding="utf-8"))
        if (amiss := leads_nowhere(said, ROOT / "README.md"))
    ]
    assert wrong == []


def linked(page: Path) -> set[Path]:
    """The pages that a page leads to."""
    targets = LINK.findall(page.read_text(encoding="utf-8"))
    found = {(page.parent / one.partition("#")[0]).resolve() for one in targets}
    return {path for path in found if path.suffix == ".md" and path.is_file()}


def test_every_page_can_be_reached_from_the_list_of_pages() -> None:
    reached, left = set[Path](), [(ROOT / one).resolve() for one in ("README.md", "docs/README.md")]
    while left:
        page = left.pop()
        if page not in reached:
            reached.add(page)
            left += linked(page)
    assert [named(page) for page in markdown() if page.resolve() not in reached] == []


def test_every_picture_of_the_pages_is_shown_by_one() -> None:
    shown = {
        (page.parent / one).resolve()
        for page in markdown()
        for one in LINK.findall(page.read_text(encoding="utf-8"))
    }
    pictures = [
        path for path in ROOT.joinpath("docs").rglob("*") if path.suffix in {".png", ".jpg", ".svg", ".gif"}
    ]
    assert [named(path) for path in pictures if path.resolve() not in shown] == []


@pytest.mark.parametrize(
    ("heading", "anchor"),
    [
        ("## What it does", "what-it-does"),
        ("### `belief`: its stop, judged", "belief-its-stop-judged"),
        ("## The [list](a.md) – and more", "the-list--and-more"),
        ("## steps.jsonl", "stepsjsonl"),
    ],
)
def test_headings_are_named_as_on_github(heading: str, anchor: str) -> None:
    assert anchors(f"# Page\n\n{heading}\n") == {"page", anchor}


def test_the_second_heading_of_a_name_is_numbered() -> None:
    assert anchors("# A\n## Limits\n## Limits\n") == {"a", "limits", "limits-1"}


def test_a_link_that_leads_nowhere_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Here\n")
    assert leads_nowhere("#here", page) is None
    assert leads_nowhere("page.md#there", page) == "page.md#there: no such heading"
    assert leads_nowhere("gone.md", page) == "gone.md: no such file"
