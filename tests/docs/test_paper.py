"""The page of the paper's equations names the functions that compute them, and these name the equations."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
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
    text = file.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef) and node.name == name.split(".")[-1]:
            return ast.get_source_segment(text, node) or ""
    raise AssertionError(f"{file.name} has no function {name}")


@pytest.mark.parametrize(("equation", "name", "file"), rows())
def test_a_function_that_the_page_names_names_its_equation(equation: int, name: str, file: str) -> None:
    assert equation in named_in(source_of((DOCS / file).resolve(), name))


def test_the_page_has_every_equation_of_the_map() -> None:
    assert {equation for equation, _, _ in rows()} >= set(range(1, 9))
