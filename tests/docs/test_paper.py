"""The page of the paper's equations names the functions that compute them, and these name the equations."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PACKAGE = DOCS.parent / "src" / "dream"
LINK = re.compile(r"\[(`[^]]*`)\]\(([^)]+\.py)\)")


def rows() -> list[tuple[int, str, str]]:
    """For each equation in a table: its number, a function, and the file that the page links it to."""
    found = []
    for line in (DOCS / "paper.md").read_text(encoding="utf-8").splitlines():
        if equation := re.match(r"\| Eq\. (\d+), ", line):
            for names, file in LINK.findall(line):
                found += [(int(equation[1]), name, file) for name in re.findall(r"`([^`]+)`", names)]
    return found


def named_in(text: str) -> set[int]:
    """Equations that a text names, alone or as a range."""
    spans = re.findall(r"Eq\. (\d+)(?:[-–](\d+))?", text)
    return {number for first, last in spans for number in range(int(first), int(last or first) + 1)}


def source_of(file: Path, name: str) -> str:
    """Of a function, or of a method as Class.method."""
    text = file.read_text(encoding="utf-8")
    within: ast.AST = ast.parse(text)
    for part in name.split("."):
        kinds = (ast.FunctionDef, ast.ClassDef)
        named = (node for node in ast.walk(within) if isinstance(node, kinds) and node.name == part)
        found = next(named, None)
        assert found is not None, f"{file.name} has no {name}"
        within = found
    return ast.get_source_segment(text, within) or ""


@pytest.mark.parametrize(("equation", "name", "file"), rows())
def test_a_function_that_the_page_names_names_its_equation(equation: int, name: str, file: str) -> None:
    assert equation in named_in(source_of((DOCS / file).resolve(), name))


def test_the_page_has_every_equation() -> None:
    assert {equation for equation, _, _ in rows()} == set(range(1, 12))


def running() -> list[tuple[str, str, str]]:
    """What the page says runs: an equation or the completion rule, a function, and its file."""
    found = []
    for line in (DOCS / "paper.md").read_text(encoding="utf-8").splitlines():
        if line.startswith(("| Eq. ", "| completion rule ")):
            what, runs = (cell.strip() for cell in line.split("|")[1:3])
            for names, file in LINK.findall(runs):
                found += [(what.split(",")[0], name, file) for name in re.findall(r"`([^`]+)`", names)]
    return found


@cache
def called() -> set[str]:
    """Names that are called in the package, by others than a function or class of that name."""
    found: set[str] = set()
    for file in PACKAGE.rglob("*.py"):
        for function in ast.parse(file.read_text(encoding="utf-8")).body:
            for node in ast.walk(function):
                if isinstance(node, ast.Call):
                    name = getattr(node.func, "id", getattr(node.func, "attr", None))
                    if name is not None and name != getattr(function, "name", None):
                        found.add(name)
    return found


def test_two_clicks_lead_from_the_readme_to_every_equation_where_it_runs() -> None:
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert "](docs/paper.md)" in readme
    assert {what for what, _, _ in running()} == {*(f"Eq. {n}" for n in range(1, 12)), "completion rule"}


@pytest.mark.parametrize(("what", "name", "file"), running())
def test_what_the_page_says_runs_is_called_and_says_what_it_is(what: str, name: str, file: str) -> None:
    path = (DOCS / file).resolve()
    assert name.split(".")[-1] in called(), f"nothing in the package calls {name}"
    if what == "completion rule":
        assert "the paper's rule" in (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "")
        assert source_of(path, name.split(".")[-1])
    else:
        assert int(what.removeprefix("Eq. ")) in named_in(source_of(path, name))
