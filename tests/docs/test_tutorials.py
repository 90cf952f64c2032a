"""The tutorials are followed as they stand: here with missions of a few steps, in `make test-slow` whole."""

from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

import dream
from dream.cli import run_command
from dream.commands import Dive
from dream.survey.archive import VARIABLE
from tests.docs.follow import TUTORIALS, Command, commands, follow, to_be_seen, typed
from tests.docs.pages import REPOSITORY
from tests.engines import InProcess

NEEDS = {"model": ("pydantic_ai",), "reef": ("rasterio", "pyproj"), "dive": ("pymavlink", "cv2")}
"""Modules of extras that a page has its reader install."""
STEPS = 5
"""Decisions of a mission: the first of which is the second after the look-around."""
LISTS_ITS_WORDS = """#!/bin/sh
{ printf '%s\\037' "$DREAM_ARCHIVE" "$(basename "$0")" "$@"; printf '\\036'; } >> "$TYPED"
"""
"""A program in the place of `dream` and `python`: it leaves what it was given."""


def page_named(name: str) -> Path:
    """The tutorial of that name."""
    return next(page for page in TUTORIALS if page.stem == name)


if shutil.which("make") is None or shutil.which("bash") is None:
    pytest.skip("needs make and bash", allow_module_level=True)


class Reader:
    """Types commands in a folder; `dream` and `python` are called in this process, with short missions."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, steps: int = STEPS) -> None:
        self.programs, self.typed = folder / "bin", folder / "typed"
        self.at, self.patch, self.steps = folder / "clone", patch, steps
        self.programs.mkdir()
        for name in ("dream", "python"):
            (self.programs / name).write_text(LISTS_ITS_WORDS)
            (self.programs / name).chmod(0o755)
        shutil.copytree(REPOSITORY / "examples", self.at / "examples")
        path = f"{self.programs}{os.pathsep}{os.environ['PATH']}"
        self.environment = {**os.environ, "PATH": path, "TYPED": str(self.typed), VARIABLE: ""}
        patch.chdir(self.at)

    def type(self, command: Command) -> int:
        """Type it; the status of what it calls last."""
        self.typed.write_text("")
        kept = self.at.parent / "environment"
        # What it assigns is there for the next command.
        text = f"set -a\n{typed(command, self.programs)}\nstatus=$?\nenv -0 > {kept}\nexit $status"
        status = subprocess.run(["bash", "-c", text], cwd=self.at, env=self.environment).returncode
        self.environment = dict(
            line.split("=", 1) for line in kept.read_text().split("\0") if line.partition("=")[1]
        )
        for called in self.typed.read_text().split("\036")[:-1]:
            archive, program, *words = called.split("\037")[:-1]
            if archive:
                self.patch.setenv(VARIABLE, archive)
            status = self.call(program, words)
        return status

    def call(self, program: str, words: Sequence[str]) -> int:
        """What a program does with these words."""
        if program == "dream":
            return run_command(in_short(words, self.steps))
        with self.patch.context() as patch:
            patch.setattr(dream, "fly_mission", partial(dream.fly_mission, max_steps=self.steps))
            runpy.run_path(words[0], run_name="__main__")
        return 0

    def follow(self, page: Path) -> None:
        """Type all of a page, and look for the files that it has its reader open."""
        for command in commands(page):
            if not command.sets_up:
                assert self.type(command) == command.status, command.text
        for name in to_be_seen(page):
            assert list(self.at.glob(name)), name


def in_short(words: Sequence[str], steps: int) -> list[str]:
    """The same command with little to fly or to ask."""
    limit = {
        "run": ("--max-steps", str(steps)),
        "bench": ("--max-steps", str(steps)),
        "probe": ("--questions", "8"),
    }
    option, most = limit.get(words[0], ("", ""))
    if not option:
        return list(words)
    before = words[: words.index(option)] if option in words else words
    return [*before, *words[len(before) + 2 :], option, most]


@pytest.fixture
def reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worlds_are_made_once: None, undrawn: None
) -> Reader:
    monkeypatch.setattr("dream.evaluation.engines.Processes", lambda _: InProcess())
    monkeypatch.setattr(Dive, "__call__", lambda _: 0)  # Its options are read; a dive takes its time.
    return Reader(tmp_path, monkeypatch)


@pytest.mark.rare
@pytest.mark.parametrize("name", ["first-mission", "model"])
def test_a_tutorial_can_be_followed(name: str, reader: Reader) -> None:
    for needed in NEEDS.get(name, ()):
        pytest.importorskip(needed)
    reader.follow(page_named(name))


def test_the_commands_of_the_tutorial_of_a_dive_are_understood(reader: Reader) -> None:
    for needed in NEEDS["dive"]:
        pytest.importorskip(needed)
    for command in commands(page_named("dive")):
        # What is looked at after a dive is there after one.
        if not command.sets_up and "runs/latest" not in command.text:
            assert reader.type(command) == command.status, command.text


def test_each_tutorial_is_followed_by_a_test() -> None:
    # That of a reef by `tests/test_makefile_survey.py`, which looks at all that is left.
    assert {page.stem for page in TUTORIALS} == {"first-mission", "model", "dive", "reef"}


@pytest.mark.rare
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_is_followed_to_its_end(page: Path, tmp_path: Path) -> None:
    for needed in NEEDS.get(page.stem, ()):
        pytest.importorskip(needed)
    follow(page, Path(sys.executable).parent / "dream", tmp_path)


def test_each_target_of_make_that_a_page_names_is_one() -> None:
    targets = {
        line.split(":")[0] for line in (REPOSITORY / "Makefile").read_text().splitlines() if "## " in line
    }
    named = [command for page in TUTORIALS for command in commands(page) if command.text.startswith("make ")]
    assert {command.text.split()[1] for command in named} == {"run", "tank", "survey", "setup"}
    assert {command.text.split()[1] for command in named} <= targets
