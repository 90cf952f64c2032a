"""The command `dream`: picks a command, runs it, and turns every failure into one line."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import sys
from collections.abc import Sequence

from dream.errors import MissionAborted
from dream.names import look_up

USAGE = """\
usage: dream COMMAND [OPTIONS]

An underwater robot that finds and maps a habitat without knowing where it is.

  run      one mission in a simulated world, with its recording and its report
  bench    many missions side by side: planners over the worlds of a suite
  sweep    the same missions with one reach after another
  results  the documentation's page of results, from benchmark folders
  oracle   the fewest steps that see a world: certified bound and best tour
  worlds   list the worlds
  draw     draw a world as a picture
  report   write the HTML page of a recorded run again

`dream COMMAND --help` explains a command. To begin with: dream run --world reef/string
"""
COMMANDS = ("run", "bench", "sweep", "results", "oracle", "worlds", "draw", "report")

FAILED, BAD_INPUT = 1, 2


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Exits with 0, with 1 where a mission was aborted, with 2 on bad arguments or input."""
    sys.exit(run_command(list(sys.argv[1:] if arguments is None else arguments)))


def run_command(arguments: list[str]) -> int:
    """Run one command line; returns its exit status."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return 0
    name = arguments[0]
    if name == "--version":
        from dream import __version__

        print(f"dream {__version__}")
        return 0
    logging.basicConfig(format="dream: %(message)s", level=logging.WARNING)
    try:
        return _dispatch(name, arguments[1:])
    except (ValueError, OSError) as error:
        return _fail(str(error), BAD_INPUT)
    except MissionAborted as error:
        return _fail(str(error), FAILED)
    except KeyboardInterrupt:
        return _fail("interrupted", FAILED)


def _dispatch(name: str, arguments: list[str]) -> int:
    if name not in COMMANDS:
        look_up(dict.fromkeys(COMMANDS), name, "command")
    import tyro

    from dream import commands
    from dream.planning import PLANNERS

    complaints = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaints):
            command = tyro.cli(
                getattr(commands, name.capitalize()),
                prog=f"dream {name}",
                args=arguments,
                config=(
                    tyro.conf.CascadeSubcommandArgs,
                    tyro.conf.OmitSubcommandPrefixes,
                    tyro.conf.OmitArgPrefixes,
                    tyro.conf.FlagCreatePairsOff,
                ),
            )
    except SystemExit as end:
        if end.code:
            complaint = _one_line(complaints.getvalue())
            stray = re.search(r"Unrecognized options: (\w[\w-]*)", complaint)
            if stray and name == "run":
                look_up(PLANNERS, stray[1], "planner")
            return _fail(complaint, BAD_INPUT)
        return 0
    status: int = command()
    return status


def _fail(message: str, status: int) -> int:
    print("dream: " + " ".join(message.split()), file=sys.stderr)
    return status


def _one_line(panel: str) -> str:
    """The argument parser's boxed complaint in one line: what was wrong, and what it may have meant."""
    blocks: list[list[str]] = [[]]
    for line in panel.splitlines():
        words = line.strip("│| ")
        if words.startswith(("╭", "╰", "─", "---")):  # The border of the box, or a rule across it.
            blocks.append([])
        elif words:
            blocks[-1].append(words)
    # Where the box has no border to hold it, the title is a block of its own: a few plain words.
    blocks = [block for block in blocks if not re.fullmatch(r"[A-Za-z ]*", " ".join(block))]
    wrong = " ".join(blocks[0]) if blocks else "cannot read the arguments"
    guess = next((block[1].split()[0] for block in blocks if block[0] == "Perhaps you meant:"), "")
    return wrong + (f". Did you mean {guess}?" if guess else ".") + " Add --help to see the options."


if __name__ == "__main__":
    main()
