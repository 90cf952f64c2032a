"""What `--help` and `--help-all` of a command print.

Both are read from the class of the command: its docstring, its fields, their types and their docstrings. tyro
reads the same fields to parse a command line.
"""

from __future__ import annotations

import ast
import inspect
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from dream.names import look_up
from dream.options import FirstRank
from dream.own_code import is_own
from dream.planning.vlm import Asking

WIDEST = 110
"""Columns of a page at most: longer lines are hard to read."""
INDENT = 22
"""Columns before the words of an option."""
EXAMPLES = "Examples:"
"""Before the command lines that end a command's docstring."""
METAVARS: dict[Any, str] = {int: "N", float: "NUMBER", str: "TEXT", Path: "PATH"}


@dataclass(frozen=True, slots=True)
class Option:
    """An option of a command, as its page shows it."""

    words: str
    """How it is typed, such as `--seed N`; or the name of an argument without dashes."""
    told: str
    """What it does, and its default."""
    first: bool
    positional: bool = False

    def lines(self, width: int) -> list[str]:
        """Laid out for a page of so many columns."""
        told = textwrap.wrap(self.told, width - INDENT, break_long_words=False, break_on_hyphens=False)
        head = f"  {self.words}"
        if told and len(head) + 2 <= INDENT:
            head, told = f"{head:{INDENT}}{told[0]}", told[1:]
        return [head.rstrip(), *(" " * INDENT + line for line in told)]


@dataclass(frozen=True, slots=True)
class Group:
    """Options that belong together."""

    title: str
    options: tuple[Option, ...]


def page(
    name: str, kind: type, chosen: str | None = None, called: str | None = None, *, everything: bool = False
) -> str:
    """What a command says of itself.

    Args:
        name: Of the command.
        kind: Its class.
        chosen: Of its planners or subcommands the one that was named; None where none was.
        called: How that is typed.
        everything: Show all its options, and the whole of its docstring.
    """
    width = min(shutil.get_terminal_size().columns, WIDEST)
    choices, command = _choices(kind), f"dream {name}"
    about, examples = _about(kind)
    if choices is None:
        return _laid(width, command, about, [], _groups(kind), [], examples, everything=everything)
    if choices.default is None:
        if chosen is not None:
            return page(f"{name} {chosen}", choices.kinds[chosen][0], everything=everything)
        usage, more = f"{command} SUBCOMMAND", [f"{command} SUBCOMMAND --help explains one of them."]
        return _laid(width, usage, about, _listed(choices, width), [], more, examples, everything=everything)
    groups = list(_groups(kind))
    if chosen is None:
        usage, more = f"{command} [PLANNER]", [f"{command} PLANNER --help shows the options of a planner."]
        if everything:
            groups += _of_planner(choices, choices.default)
        listed = _listed(choices, width)
        return _laid(width, usage, about, listed, groups, more, examples, everything=everything)
    planner, _ = choices.kinds[chosen]
    usage = f"{command} {called or chosen}"
    more = [f"{command} --help shows the options that go with every planner."]
    about, examples = _about(planner)[0], [usage + " --model wire" * issubclass(planner, Asking)]
    groups = [*_of_planner(choices, chosen), *(groups if everything else [])]
    return _laid(width, usage, about, [], groups, more, examples, everything=everything)


def _laid(
    width: int,
    usage: str,
    about: Sequence[str],
    listed: Sequence[str],
    groups: Iterable[Group],
    more: Sequence[str],
    examples: Sequence[str],
    *,
    everything: bool,
) -> str:
    """A page: usage, what it is about, what may be chosen, options, where the rest stands, examples."""
    groups = list(groups)
    positionals = [one.words for group in groups for one in group.options if one.positional]
    lines = [" ".join(["usage:", usage, *positionals, "[OPTIONS]"]), ""]
    for paragraph in about if everything else about[:1]:
        lines += [*textwrap.wrap(paragraph, width, break_on_hyphens=False), ""]
    lines += listed
    for group in groups:
        shown = [one for one in group.options if everything or one.first or one.positional]
        if shown:
            lines += [group.title, *(line for one in shown for line in one.lines(width)), ""]
    if groups and not everything:
        more = [f"{usage.removesuffix(' [PLANNER]')} --help-all shows all options.", *more]
    lines += [*more, ""] if more else []
    return "\n".join([*lines, "examples", *(f"  {example}" for example in examples), ""])


def _of_planner(choices: _Choices, name: str) -> list[Group]:
    """The options of a planner; a class that it inherits from counts as its own."""
    kind, value = choices.kinds[name]
    return [Group(f"options of {name}", group.options) for group in _groups(kind, value)]


def chosen_in(arguments: Sequence[str], kind: type) -> str | None:
    """The planner or the subcommand that a command line names; None where it names none."""
    choices = _choices(kind)
    if choices is None:
        return None
    places = places_of_names(arguments, kind)
    return next((arguments[place] for place in places if arguments[place] in choices.kinds), None)


def check_subcommand(kind: type, arguments: Sequence[str]) -> None:
    """Raise a ValueError where a command that has subcommands is given none of them."""
    choices = _choices(kind)
    if choices is None or choices.default is not None or chosen_in(arguments, kind) is not None:
        return
    place = next(places_of_names(arguments, kind), None)
    if place is not None:
        look_up(choices.kinds, arguments[place], "subcommand")
    raise ValueError(f"expected a subcommand, got none. There are: {', '.join(choices.kinds)}")


def missing_in(complaint: str, kind: type, arguments: Sequence[str]) -> str:
    """What tyro says is missing, in words; empty where it says something else."""
    if not complaint.startswith("Missing from"):
        return ""
    chosen, choices = chosen_in(arguments, kind), _choices(kind)
    if chosen is not None and choices is not None and choices.default is None:
        kind = choices.kinds[chosen][0]
    options = [one for group in _groups(kind) for one in group.options]
    found = [(one.words, one.told.removesuffix(" (required)")) for one in options]
    first = {words: told.split(". ")[0].rstrip(".") for words, told in found if told and told in complaint}
    return " and ".join(f"{words} ({told[:1].lower()}{told[1:]})" for words, told in first.items())


def places_of_names(arguments: Sequence[str], kind: type) -> Iterator[int]:
    """Where a planner could be named in a command line: what is no option, and no value of one."""
    flags = _flags(kind)
    for place, word in enumerate(arguments):
        before = arguments[place - 1] if place else ""
        if not word.startswith("-") and (not before.startswith("-") or before in flags or "=" in before):
            yield place


def _flags(kind: type) -> set[str]:
    """Options that take no value."""
    found = {"-h", "--help", "--help-all"}
    for one in fields(kind):
        typed, _ = _typed(kind, one)
        if typed is bool:
            found |= {f"--{one.name.replace('_', '-')}", f"--no-{one.name.replace('_', '-')}"}
        elif is_dataclass(typed):
            assert isinstance(typed, type)
            found |= _flags(typed)
    return found


@dataclass(frozen=True, slots=True)
class _Choices:
    """The planners that a command may be given, or its subcommands."""

    kinds: dict[str, tuple[type, Any]]
    """By name: the class, and the instance whose values are the defaults; None where there is none."""
    default: str | None
    """The planner that decides unless one is named; None of subcommands, one of which must be."""


def _listed(choices: _Choices, width: int) -> list[str]:
    """Planners side by side; subcommands in a line each."""
    if choices.default is not None:
        asking = [name for name, (kind, _) in choices.kinds.items() if hasattr(kind, "max_calls")]
        names = ", ".join(name for name in choices.kinds if name not in asking)
        if asking:
            names += f"; ask a model: {', '.join(asking)}"
        return [
            f"planners, who decide ({choices.default} unless one is named)",
            *(f"  {line}" for line in textwrap.wrap(names, width - 2, break_on_hyphens=False)),
            "",
        ]
    long = max(map(len, choices.kinds))
    said = {name: _about(kind)[0][0].split(". ")[0].rstrip(".") for name, (kind, _) in choices.kinds.items()}
    lines = []
    for name, words in said.items():
        indent = " " * (long + 4)
        lines += textwrap.wrap(f"  {name:{long}}  {words}", width, subsequent_indent=indent)
    return ["subcommands", *lines, ""]


def _about(kind: type) -> tuple[list[str], list[str]]:
    """The paragraphs of a command's docstring, and its examples."""
    told = inspect.getdoc(kind) or ""
    if told.startswith(f"{kind.__name__}("):  # What a dataclass without a docstring gives itself.
        told = f"{kind.__name__}."
    words, _, examples = told.partition(EXAMPLES)
    paragraphs = [" ".join(paragraph.split()) for paragraph in words.strip().split("\n\n")]
    return paragraphs, [line.strip() for line in examples.splitlines() if line.strip()]


def _choices(kind: type) -> _Choices | None:
    """What stands in the field that holds a planner or a subcommand; None where there is none."""
    for one in fields(kind):
        typed, _ = _typed(kind, one)
        members = get_args(typed) if get_origin(typed) in (Union, UnionType) else (typed,)
        named = {}
        for member in members:
            called = next((mark for mark in _marks(member) if _names_one(mark)), None)
            if called is not None:
                given = called.default if is_dataclass(called.default) else None
                named[str(called.name)] = (_bare(member), given)
        if named:
            default = next((name for name, (_, value) in named.items() if value == _default(one)), None)
            return _Choices(named, default)
    return None


def _groups(kind: type, value: Any = None) -> Iterator[Group]:
    """The options of a class; those of a dataclass in one of its fields are a group of their own."""
    options, nested = [], []
    for one in fields(kind):
        typed, marks = _typed(kind, one)
        members = (*marks, *(mark for member in get_args(typed) for mark in _marks(member)))
        if tyro.conf.Suppress in marks or any(map(_names_one, members)):
            continue
        default = _default(one) if value is None else getattr(value, one.name)
        if is_dataclass(typed):
            assert isinstance(typed, type)
            title = _about(typed)[0][0].rstrip(".")
            nested += [Group(title[:1].lower() + title[1:], each.options) for each in _groups(typed, default)]
        else:
            options.append(_option(kind, one, typed, marks, default))
    options.sort(key=lambda option: not option.positional)
    if options:
        yield Group("options", tuple(options))
    yield from nested


def _option(kind: type, one: Field[Any], typed: Any, marks: Sequence[Any], default: Any) -> Option:
    called = next((m for mark in marks if (m := getattr(mark, "name", None))), None) or one.name
    name = f"--{called.replace('_', '-')}"
    positional = tyro.conf.Positional in marks
    metavar = next((m for mark in marks if (m := getattr(mark, "metavar", None))), None) or _metavar(typed)
    told = _told(kind, one.name)
    if typed is bool:
        words = f"--no-{name[2:]}" if default else name
    elif positional:
        metavar = one.name.upper() + " ..." * metavar.endswith("...")
        words = metavar if default is MISSING else f"[{metavar}]"
    else:
        words = f"{name} {metavar}"
        if default is MISSING:
            told = f"{told} (required)"
    if typed is not bool and default not in (MISSING, None, "", ()) and (shown := _shown(default)):
        told = f"{told} (default: {shown})"
    first = any(isinstance(mark, FirstRank) for mark in marks) or default is MISSING or is_own(kind)
    return Option(words, told, first, positional)


def _shown(value: Any) -> str:
    """A default, numbers with six digits at most."""
    if isinstance(value, tuple):
        return " ".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _metavar(typed: Any) -> str:
    if get_origin(typed) is Literal:
        return "|".join(map(str, get_args(typed)))
    if get_origin(typed) is tuple:
        kinds = get_args(typed)
        if kinds[-1] is Ellipsis:
            return f"{_metavar(kinds[0])} ..."
        return " ".join(map(_metavar, kinds))
    return METAVARS.get(typed, "VALUE")


def _typed(kind: type, one: Field[Any]) -> tuple[Any, tuple[Any, ...]]:
    """The type of a field, without None and without marks; and the marks."""
    hint = _hints(kind).get(one.name, type(_default(one)))
    marks = _marks(hint)
    bare = _bare(hint)
    if get_origin(bare) in (Union, UnionType):
        others = [member for member in get_args(bare) if member is not NoneType]
        if len(others) == 1:
            bare, marks = _bare(others[0]), (*marks, *_marks(others[0]))
    return bare, marks


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Types of fields; none where a planner of one's own names what is imported for type checkers only."""
    try:
        return get_type_hints(kind, include_extras=True)
    except NameError:
        return {}


def _names_one(mark: Any) -> bool:
    """Is it tyro's mark of a subcommand?"""
    return hasattr(mark, "is_default")


def _marks(hint: Any) -> tuple[Any, ...]:
    return tuple(hint.__metadata__) if get_origin(hint) is Annotated else ()


def _bare(hint: Any) -> Any:
    return hint.__origin__ if get_origin(hint) is Annotated else hint


def _default(one: Field[Any]) -> Any:
    return one.default if one.default_factory is MISSING else one.default_factory()


def _told(kind: type, name: str) -> str:
    """The docstring under a field, in the class that declares it last."""
    return next((words for one in kind.__mro__ if (words := _docstrings(one).get(name))), "")


@cache
def _docstrings(kind: type) -> dict[str, str]:
    """The docstrings under the fields that a class itself declares."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    except (OSError, TypeError, SyntaxError, ValueError):  # Not written in a file, such as `object`.
        return {}
    return {
        line.target.id: " ".join(str(following.value.value).split())
        for line, following in pairwise(getattr(tree, "body", []))
        if isinstance(line, ast.AnnAssign)
        and isinstance(line.target, ast.Name)
        and isinstance(following, ast.Expr)
        and isinstance(following.value, ast.Constant)
    }
