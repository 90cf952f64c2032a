"""Every command that a how-to page tells one to type is understood."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from dream import commands
from dream.cli import run_command

ROOT = Path(__file__).parents[2]
PAGES = {
    "README": ROOT / "README.md",
    **{name: ROOT / "docs" / f"{name}.md" for name in ("models", "runs", "survey", "worlds")},
}


def typed(page: str) -> list[str]:
    """What follows `dream` on lines of blocks, and in code that names more than a command."""
    text = re.sub(r" *\\\n *", " ", page)
    lines = re.findall(r"^(?: {4,}|)dream ([a-z]+\b.*)$", text, re.MULTILINE)
    lines += re.findall(r"`dream ([a-z]+ [^`]*)`", text)
    return sorted({line.split(" #")[0].strip() for line in lines})


LINES = [(name, line) for name, page in PAGES.items() for line in typed(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(("name", "line"), LINES)
def test_every_command_on_the_page_is_understood(
    name: str, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, *words = shlex.split(line)
    monkeypatch.setattr(getattr(commands, command.capitalize()), "__call__", lambda self: 0)
    assert run_command([command, *words]) == 0


def test_every_target_in_the_readme_is_one_of_the_makefile() -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    told = re.findall(
        r"^(?:git clone .* && )?make ([a-z-]+)", PAGES["README"].read_text(encoding="utf-8"), re.MULTILINE
    )
    assert {"run", "tank", "survey"} <= set(told) <= set(targets)


@pytest.mark.parametrize("name", PAGES)
def test_the_page_has_commands(name: str) -> None:
    assert sum(page == name for page, _ in LINES) >= 5
