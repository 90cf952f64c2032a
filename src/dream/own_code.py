"""Planners of one's own: a file where a planner's name may stand; what goes wrong is told by its line."""

from __future__ import annotations

import contextlib
import importlib.util
import inspect
import math
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from dream.errors import MissionAborted, PlannerFailed
from dream.geometry import wrap_angle
from dream.protocol import SurveyProtocol
from dream.types import Decision, Exchange, Reasoning

SUFFIX = ".py"
LONGEST = 300
"""Characters of what an error says that are told."""
ROUNDING = 1e-6
"""Radians and metres by which a decision may miss what the protocol allows."""


def is_own(kind: type) -> bool:
    """Is it a class of somebody's own file, not of this package?"""
    return kind.__module__.partition(".")[0] != "dream"


def own_file(kind: type) -> Path | None:
    """The file of such a class; None where it was typed at a prompt."""
    try:
        file = inspect.getsourcefile(kind)
    except (OSError, TypeError):
        return None
    return None if file is None else Path(file)


def own_name(kind: type) -> str:
    """What runs of such a planner are called: after its file, so that it is none of the package's names."""
    file = own_file(kind)
    return re.sub(r"[^A-Za-z0-9._-]+", "-", kind.__name__ if file is None else file.name)


def own_planner(path: Path) -> Any:
    """The planner of a file, with its default parameters.

    The file is run, as `python FILE` runs it but for its name; what lies beside it can be imported. Its
    planner is the one dataclass that it defines with a method `begin`.

    Raises:
        FileNotFoundError: There is no such file.
        PlannerFailed: It cannot be run, or does not define one planner; the message names file and line.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}. Expected one with a planner of your own")
    file = path.resolve()
    name = f"own_{re.sub(r'[^A-Za-z0-9]', '_', file.stem)}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # A dataclass looks its own module up.
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    with told_where(file):
        spec.loader.exec_module(module)
    kinds = [
        kind
        for kind in vars(module).values()
        if isinstance(kind, type) and kind.__module__ == name and callable(getattr(kind, "begin", None))
    ]
    if len(kinds) != 1:
        got = ", ".join(kind.__name__ for kind in kinds) or "none"
        raise PlannerFailed(
            f"{shown(file)}: expected one class with a method begin(mission), got {got}. "
            "See examples/planner.py for a whole one"
        )
    (kind,) = kinds
    if not is_dataclass(kind):
        raise PlannerFailed(
            f"{_at_class(kind)}: expected a dataclass, whose fields are its parameters, got {kind.__name__}, "
            "which is none. Put @dataclass(frozen=True, slots=True) above it"
        )
    with told_where(file, _at_class(kind)):
        planner: Any = kind()
    check_takes(planner.begin, "mission")
    return planner


def check_takes(method: Callable[..., Any], *arguments: str) -> None:
    """Raise a PlannerFailed, with file and line, where a method cannot be called with these arguments."""
    try:
        inspect.signature(method).bind(*arguments)
    except TypeError as error:
        raise PlannerFailed(
            f"{_at(method)}: expected {method.__name__}({', '.join(arguments)}), "
            f"got {method.__name__}{inspect.signature(method)} ({error})"
        ) from error


def checked_pilot(pilot: Any, planner: Any) -> Any:
    """The pilot that a planner of one's own began with, if it can decide; else a PlannerFailed."""
    if not callable(getattr(pilot, "decide", None)):
        raise PlannerFailed(
            f"{_at(planner.begin)}: expected a pilot with decide(observation, occupancy), "
            f"got {_kind(pilot)}. See examples/planner.py"
        )
    check_takes(pilot.decide, "observation", "occupancy")
    return pilot


@contextlib.contextmanager
def told_where(file: Path, otherwise: str = "", doing: str = "") -> Iterator[None]:
    """Tell what fails within the block as a PlannerFailed with its line in that file, or in one beside it.

    Args:
        file: Of the planner.
        otherwise: What to name where no line of these files was running.
        doing: What was going on, such as a step.
    """
    try:
        yield
    except (PlannerFailed, MissionAborted):
        raise  # They say already what was wrong.
    except (Exception, SystemExit) as error:
        lines = [
            (frame.filename, frame.lineno)
            for frame in traceback.extract_tb(error.__traceback__)
            if Path(frame.filename).parent == file.parent
        ]
        if isinstance(error, SyntaxError) and error.filename is not None:
            lines.append((error.filename, error.lineno))
        where = f"{shown(Path(lines[-1][0]))}, line {lines[-1][1]}" if lines else otherwise or shown(file)
        said = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())[:LONGEST]
        what = f"{type(error).__name__}: {said}" if said else type(error).__name__
        raise PlannerFailed(": ".join(filter(None, (where, doing, what)))) from error


def check_decision(decision: Any, protocol: SurveyProtocol, decide: Callable[..., Any], step: int) -> None:
    """Raise a PlannerFailed where a planner decided what the protocol does not know.

    Args:
        decision: What it gave.
        protocol: With the turns and advances that it allows.
        decide: What gave it; its file and line are named.
        step: Of the mission.
    """
    if not isinstance(decision, Decision):
        got = _kind(decision)
    elif wrong := _no_number(decision) or _no_words(decision):
        got = wrong
    elif decision.done or (
        any(abs(wrap_angle(decision.turn - turn)) <= ROUNDING for turn in protocol.turn_angles)
        and any(abs(decision.advance - advance) <= ROUNDING for advance in (0.0, *protocol.advances))
        and any(abs(decision.climb - climb) <= ROUNDING for climb in protocol.climbs)
        and (decision.tilt is None or any(abs(decision.tilt - tilt) <= ROUNDING for tilt in protocol.tilts))
    ):
        return
    else:
        got = f"a turn of {math.degrees(decision.turn):g}° and an advance of {decision.advance:g} m"
        if decision.climb != 0.0:
            got += f", a climb of {decision.climb:g} m"
        if decision.tilt is not None:
            got += f", a tilt of {math.degrees(decision.tilt):g}°"
    ask = ""
    if isinstance(decision, Decision) and any(
        abs(decision.turn - math.degrees(turn)) <= ROUNDING for turn in protocol.turn_angles if turn != 0.0
    ):
        ask = f". A turn is in radians: math.radians({decision.turn:g})"
    raise PlannerFailed(f"{_at(decide)}: step {step}: expected {_allowed(protocol)}, got {got}{ask}")


def _no_number(decision: Decision) -> str:
    for name in ("turn", "advance", "waited", "climb", "tilt"):
        value = getattr(decision, name)
        if name == "tilt" and value is None:
            continue
        if not isinstance(value, int | float) or not math.isfinite(value):
            return f"{name}={value!r:.40}, which is no finite float but {_kind(value)}"
    return "" if decision.waited >= 0.0 else f"waited={decision.waited:g}"


def _no_words(decision: Decision) -> str:
    for name, kind in (("done", bool), ("reasoning", Reasoning), ("exchanges", tuple)):
        if not isinstance(value := getattr(decision, name), kind):
            return f"as {name} {_kind(value)}, not a {kind.__name__}"
    for name in Reasoning.__slots__:
        if not isinstance(value := getattr(decision.reasoning, name), str):
            return f"as reasoning.{name} {_kind(value)}, not a str"
    strays = (value for value in decision.exchanges if not isinstance(value, Exchange))
    stray: Any = next(strays, None)
    return "" if stray is None else f"among exchanges {_kind(stray)}, not an Exchange"


def _allowed(protocol: SurveyProtocol) -> str:
    """What a decision may be, in words."""
    sizes = sorted({round(abs(math.degrees(turn)), 3) for turn in protocol.turn_angles})
    turns = [f"{size:g}" if size in (0.0, 180.0) else f"±{size:g}" for size in sizes]
    advances = [f"{advance:g}" for advance in sorted({0.0, *protocol.advances})]
    parts = [f"a turn of {_either(turns)}°", f"an advance of {_either(advances)} m"]
    if protocol.space is not None:
        tilts = [f"{math.degrees(tilt):g}" for tilt in sorted(protocol.tilts)]
        parts.append(f"a climb of {_either([f'{climb:g}' for climb in protocol.climbs])} m")
        parts.append(f"a tilt of None or {_either(tilts)}°")
    return f"a Decision with {', '.join(parts[:-1])} and {parts[-1]} ({protocol.name})"


def _either(words: list[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else words[0]


def _kind(value: Any) -> str:
    """What it is, in words."""
    return "None" if value is None else f"a {type(value).__name__}"


def shown(file: Path) -> str:
    """A file as somebody in the working directory would name it."""
    with contextlib.suppress(ValueError):
        return str(file.resolve().relative_to(Path.cwd()))
    return str(file)


def _at(method: Callable[..., Any]) -> str:
    code = getattr(inspect.unwrap(getattr(method, "__func__", method)), "__code__", None)
    if code is None:  # An object that can be called.
        return _at_class(type(method))
    return f"{shown(Path(code.co_filename))}, line {code.co_firstlineno}"


def _at_class(kind: type) -> str:
    file = own_file(kind)
    try:
        return f"{shown(file or Path('?'))}, line {inspect.getsourcelines(kind)[1]}"
    except (OSError, TypeError):
        return kind.__name__
