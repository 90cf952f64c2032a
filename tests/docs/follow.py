"""Follow the tutorials literally, with the `dream` of some installation.

    python -m tests.docs.follow PATH_TO_DREAM [PAGE ...]

Every command of the blocks marked `sh` is typed in its order, in a folder with nothing but the examples of
the clone. A Python block whose first line names a file is saved under that name. What sets up a clone is
passed over; `make run` and the like are the lines of the Makefile, with that `dream`. Needs nothing but the
standard library.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.docs.pages import DOCS, REPOSITORY, fenced

TUTORIALS = tuple(sorted((DOCS / "tutorials").glob("*.md")))
_SETS_UP = re.compile(r"(git clone|cd|source|make setup)\b")
_MAKES = re.compile(r"make ([a-z-]+)")
_NAMED = re.compile(r"# ([\w-]+\.py)\n")
_HEREDOC = re.compile(r"<<'(\w+)'")
_STATUS = re.compile(r"\s+# exits with (\d+)$")
_SEEN = re.compile(r"\bOpen\s+`([^`]+)`")


@dataclass(frozen=True, slots=True)
class Command:
    """One thing that a reader types."""

    text: str
    status: int
    """With which it has to end."""

    @property
    def sets_up(self) -> bool:
        """Does it set up a clone?"""
        return _SETS_UP.match(self.text) is not None

    @property
    def target(self) -> str | None:
        """Of `make`, where it is that."""
        made = _MAKES.match(self.text)
        return None if made is None else made[1]


def commands(page: Path) -> list[Command]:
    """All that a page has its reader type, in order."""
    found: list[Command] = []
    for kind, text in fenced(page):
        if kind == "sh":
            found += [_command(lines) for lines in _split(text)]
        elif kind == "python" and (named := _NAMED.match(text)):
            found.append(Command(f"cat > {named[1]} <<'END_OF_FILE'\n{text}END_OF_FILE", 0))
    return found


def to_be_seen(page: Path) -> list[str]:
    """The files that a page tells its reader to open, perhaps with a `*`."""
    return _SEEN.findall(page.read_text(encoding="utf-8"))


def _split(block: str) -> Iterator[str]:
    """The commands of a block: a line, or all lines of one that goes on."""
    typed: list[str] = []
    for line in block.splitlines():
        typed.append(line)
        inner = _HEREDOC.search(typed[0])
        if inner is not None and line != inner[1]:
            continue
        if not line.endswith("\\"):
            yield "\n".join(typed)
            typed = []
    assert not typed, f"{typed[0]} has no end"


def _command(text: str) -> Command:
    ends = _STATUS.search(text)
    return Command(text, 0) if ends is None else Command(text[: ends.start()], int(ends[1]))


def recipe(target: str, programs: Path) -> str:
    """What `make TARGET` types, with the programs of that folder; its set-up is left out."""
    made = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    printed = subprocess.run(
        ["make", "--no-print-directory", "-n", "-C", str(REPOSITORY), target, f"BIN={programs}"],
        check=True,
        capture_output=True,
        text=True,
        env=made,
    ).stdout
    lines = printed.replace("\\\n", "\n\0").split("\n")
    whole: list[str] = []
    for line in lines:
        if line.startswith("\0"):
            whole[-1] += "\n" + line[1:]
        else:
            whole.append(line)
    flown = [line for line in whole if f"{programs}/dream" in line]
    assert flown, f"make {target} calls no dream"
    return "\n".join(flown)


def typed(command: Command, programs: Path) -> str:
    """The words for a shell, in the place of what a reader types."""
    if command.target is None:
        return command.text
    return f"(\n{recipe(command.target, programs)}\n)"  # A shell of its own, as `make` gives it.


def follow(page: Path, dream: Path, folder: Path) -> None:
    """Type all of a page in a folder.

    Raises:
        AssertionError: A command ended otherwise than the page says, or a file is missing that it has its
            reader open.
    """
    programs = dream.absolute().parent
    shutil.copytree(REPOSITORY / "examples", folder / "examples")
    script = ["set -u"]
    for command in commands(page):
        if command.sets_up:
            continue
        shown = shlex.quote(f"$ {command.text.splitlines()[0]}")
        first = command.text.splitlines()[0]
        told = shlex.quote(f"{page.name}: {first}: expected exit status {command.status}, got")
        script += [
            f"echo {shown}",
            typed(command, programs),
            f"got=$?; [ $got -eq {command.status} ] || {{ echo {told} $got >&2; exit 1; }}",
        ]
    bash = ["bash", "-c", "\n".join(script)]
    environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    ended = subprocess.run(bash, cwd=folder, env=environment)
    assert ended.returncode == 0, f"{page.name} could not be followed"
    for name in to_be_seen(page):
        assert list(folder.glob(name)), f"{page.name}: expected {name} to open, got no such file"


def main() -> None:
    """Follow the pages that are named, or all."""
    parser = argparse.ArgumentParser(description="Follow the tutorials with an installed dream.")
    parser.add_argument("dream", type=Path, help="the program, such as /tmp/env/bin/dream")
    parser.add_argument("pages", nargs="*", help="names of tutorials, such as reef; all unless given")
    given = parser.parse_args()
    for page in TUTORIALS:
        if given.pages and page.stem not in given.pages:
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                follow(page, given.dream, Path(folder))
            except AssertionError as failed:
                sys.exit(str(failed))


if __name__ == "__main__":
    main()
