"""The command `dream`: picks a command, runs it, and turns every failure into one line."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from dream.errors import MissionAborted, PlannerFailed
from dream.names import look_up
from dream.telling import clean_streams, in_lines, one_line

if TYPE_CHECKING:
    from tyro.constructors import ConstructorRegistry

N = TypeVar("N", int, float)

USAGE = """\
usage: dream COMMAND [OPTIONS]

An underwater robot that finds and maps oyster reefs and wrecks without knowing
where they are.

fly in a simulated world
  run      fly one mission; leave its recording and its report
  fly      fly one yourself, in a browser, with what a planner is told
  worlds   list the worlds, save one to edit, check one of your own
  draw     draw a world as a picture
  mission  turn an operator's words into orders that every planner obeys
  plan     tell what an area will take, before a mission
dive with a BlueROV2
  dive     fly one mission with the vehicle, or in a tank with its stand-in
survey a reef or a wreck
  survey   measure a run, keep it in an archive, tell what changed, make maps
look at runs
  watch    show runs in a browser, while they are flown and after
  report   write the page of a run again
  replay   decide a run again: are its decisions the same?
  export   make a data set of a dive
compare planners
  bench    fly planners over many worlds; leave a table and a report
  sweep    fly the same missions with one reach after another
  seal     make the key of a sealed test, whose worlds nobody knows yet
  oracle   find the fewest steps in which a world can be seen
  results  write the page of results from folders of benchmarks
models
  probe    ask a vision-language model what it reads in a map
  teach    teach a new target with a few strokes on pictures of your own
  train    make the networks that see, and that steer by sight

dream COMMAND --help      the options that people use first
dream COMMAND --help-all  all options
dream --version           the version

Every command takes --json, for programs. To begin with: dream run
"""
COMMANDS = (
    *("run", "fly", "worlds", "draw", "mission", "plan", "dive", "survey", "watch", "report"),
    *("replay", "export", "bench", "sweep", "seal", "oracle", "results", "probe", "teach"),
    "train",
)

FAILED, BAD_INPUT = 1, 2
NOWHERE_TO_KEEP = (
    "expected a folder to keep compiled code in, got none that this user may write: neither that of the "
    "package nor ~/.cache. Say which: export NUMBA_CACHE_DIR=FOLDER"
)
EVERYTHING = "--help-all"
HELP = ("-h", "--help", EVERYTHING)


class _Telling(logging.Handler):
    """Writes to what standard error is by then: a progress bar takes its place and lets lines by."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line; where the terminal is gone, nobody reads it, and whoever logs has to go on."""
        with contextlib.suppress(OSError, ValueError):
            print(in_lines(self.format(record)), file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Exits with 0, with 1 where a mission was aborted, with 2 on bad arguments or input."""
    sys.exit(run_command(list(sys.argv[1:] if arguments is None else arguments)))


def run_command(arguments: list[str]) -> int:
    """Run one command line; returns its exit status."""
    if not arguments or arguments[0] in (*HELP, "help"):
        print(USAGE, end="")
        return 0
    name = arguments[0]
    if name == "--version":
        from dream import __version__

        print(f"dream {__version__}")
        return 0
    logging.basicConfig(format="dream: %(message)s", level=logging.WARNING, handlers=[_Telling()])
    try:
        return _dispatch(name, arguments[1:])
    except (ValueError, OSError) as error:
        return _fail(str(error), BAD_INPUT)
    except (MissionAborted, PlannerFailed) as error:
        return _fail(str(error), FAILED)
    except KeyboardInterrupt:
        return _fail("interrupted", FAILED)
    except RuntimeError as error:
        if "cannot cache function" not in str(error):  # So says numba.
            raise
        return _fail(NOWHERE_TO_KEEP, BAD_INPUT)


def _dispatch(name: str, arguments: list[str]) -> int:
    if name not in COMMANDS:
        look_up(dict.fromkeys(COMMANDS), name, "command")
    import tyro

    from dream import commands
    from dream.commands.console import check_no_world
    from dream.commands.help import check_subcommand, missing_in
    from dream.commands.progress import telling

    kind = getattr(commands, name.capitalize())
    own = _own_planner(arguments) if name == "run" else None
    if own is not None:
        file = arguments[own]
        kind = commands.run_with(file)
        arguments = [*arguments[:own], Path(file).name, *arguments[own + 1 :]]
    if any(word in HELP for word in arguments):
        from dream.commands import help as pages

        chosen = pages.chosen_in(arguments, kind)
        called = chosen if own is None else file
        print(pages.page(name, kind, chosen, called, everything=EVERYTHING in arguments), end="")
        return 0
    complaints = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaints):
            command = tyro.cli(
                kind,
                prog=f"dream {name}",
                args=arguments,
                add_help=False,  # What is asked for was printed above.
                registry=_numbers(),
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
            stray = re.match(r"Unrecognized options: (\S+?)\.? ", complaint)
            check_no_world(name, stray[1] if stray else arguments[0] if arguments else "")
            check_subcommand(kind, arguments)
            if missing := missing_in(complaint, kind, arguments):
                complaint = f"expected {missing}, got none. Add --help to see the options."
            if name in ("run", "dive", "plan") and own is None:
                _check_planner(complaint, arguments)
            complaint = _in_our_words(complaint)
            return _fail(complaint, BAD_INPUT)
        return 0
    with clean_streams(), telling():
        status: int = command()
    return status


def _own_planner(arguments: Sequence[str]) -> int | None:
    """Where the file of a planner stands in the place of a planner's name; None where none does."""
    from dream import commands
    from dream.commands.help import places_of_names
    from dream.own_code import SUFFIX

    places = places_of_names(arguments, commands.Run)
    return next((place for place in places if arguments[place].endswith(SUFFIX)), None)


def _numbers() -> ConstructorRegistry:
    """How numbers are read from the command line, and that a default is shown with six digits at most."""
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

    registry = ConstructorRegistry()

    @registry.primitive_rule
    def number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        if info.type is int:
            return PrimitiveConstructorSpec(
                nargs=1,
                metavar="INT",
                instance_from_str=lambda words: _read(int, words[0], "a whole number"),
                is_instance=lambda value: type(value) is int,
                str_from_instance=lambda value: [str(value)],
            )
        if info.type is float:
            return PrimitiveConstructorSpec(
                nargs=1,
                metavar="FLOAT",
                instance_from_str=lambda words: _read(float, words[0], "a number"),
                is_instance=lambda value: isinstance(value, int | float),
                str_from_instance=lambda value: [f"{value:g}"],
            )
        return None

    return registry


def _read(kind: Callable[[str], N], word: str, what: str) -> N:
    try:
        return kind(word)
    except ValueError:
        raise ValueError(f"expected {what}, got {word}") from None


def _check_planner(complaint: str, arguments: Sequence[str]) -> None:
    """Raise a ValueError where `dream run` was given no planner's name, or an option of another planner."""
    from dream.planning import PLANNERS

    if arguments and not arguments[0].startswith("-"):
        look_up(PLANNERS, arguments[0], "planner")
    stray = re.match(r"Unrecognized options: (\w[\w-]*)", complaint)
    if stray:
        look_up(PLANNERS, stray[1], "planner")
    # Behind another planner's name, before any, and before one that is not the default.
    misplaced = re.search(r"(?P<option>--[\w-]+) \(applied to dream run ?(?P<planner>[\w-]*)\)", complaint)
    before = re.search(r"subcommand '(?P<planner>[\w-]+)' because .* flag '(?P<option>--[\w-]+)'", complaint)
    if found := misplaced or before:
        option, planner = found["option"], found["planner"]
        field = option[2:].replace("-", "_")
        owners = [name for name, default in PLANNERS.items() if hasattr(default, field)]
        if planner and planner not in owners:
            raise ValueError(
                f"{option}: expected an option of {planner}, got one of {', '.join(owners)}. "
                f"See dream run {planner} --help"
            )
        raise ValueError(
            f"{option}: expected the planner's name before it, got none. "
            f"Say: dream run {planner or owners[0]} {option} ..."
        )


def _fail(message: str, status: int) -> int:
    print(one_line(f"dream: {message}"), file=sys.stderr)
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
    wrong = _value_error(" ".join(blocks[0])).rstrip(".") if blocks else "cannot read the arguments"
    guess = next((block[1].split()[0] for block in blocks if block[0] == "Perhaps you meant:"), "")
    return wrong + (f". Did you mean {guess}?" if guess else ".") + " Add --help to see the options."


def _in_our_words(complaint: str) -> str:
    """What tyro complains of, in the words of this program: what, expected, got."""
    found = re.match(
        r"Error parsing (--\S+): .*input length (\d+) did not match expected argument count (\d+)", complaint
    )
    if found:
        return f"{found[1]}: expected {found[3]} values, got {found[2]}. Add --help to see the options."
    found = re.match(r"invalid choice '(.*?)' for argument '(\S+)'\. Expected one of \((.*?),?\)", complaint)
    if found:
        choices = found[3].replace("'", "")
        return f"{found[2]}: expected one of {choices}, got {found[1]}. Add --help to see the options."
    for pattern, words in (
        # What follows an option that does not exist may be its value.
        (r"^Unrecognized options: (-\S*?)(?:, [^-].*?)?\. ", r"no option \1. "),
        (r"^Unrecognized options: ", "expected an option, got "),
        (r"^Missing value for argument '(\S+)'\. Expected \d+ values?", r"\1: expected a value, got none"),
    ):
        complaint = re.sub(pattern, words, complaint)
    return complaint


def _value_error(wrong: str) -> str:
    """A complaint about a value, under the name of the option that was typed.

    What a planner refuses is told as an error of `planner`, and of an option that may also be None there
    is a complaint for each of its types.
    """
    found = re.match(r"Error parsing (\S+): (?:.*<class '\w+'>: )?(?:(\w+): )?(expected .*)", wrong)
    if not found:
        return wrong
    option, field, rest = found.groups()
    return f"{'--' + field.replace('_', '-') if field else option}: {rest}"


if __name__ == "__main__":
    main()
