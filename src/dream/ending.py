"""Why a mission ended, in words for its owner."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from types import FrameType
from typing import NoReturn

from dream.errors import MissionAborted, PlannerFailed

WORDS: Mapping[str, str] = {
    "done": "the planner held the mission to be complete and its map agreed",
    "returned": "it turned round and went home",
    "cap": "all steps that it was given are spent",
}
"""Of a mission that ended by itself, by `Step.ended`."""
ENDED: Mapping[str, str] = {
    "done": "done",
    "returned": "returned",
    "cap": "out of steps",
    "aborted": "aborted",
}
"""In a word or two, by `RunSummary.ended`."""
MOST = 600
"""Characters of a reason; of a longer one the middle is left out."""
FULL = os.strerror(errno.ENOSPC)
TERMINATED = "the program was asked to end (SIGTERM)"

_TOLD_IN_WORDS = (MissionAborted, PlannerFailed, KeyboardInterrupt, OSError, ValueError, RuntimeError)
"""Errors whose message says what is wrong; that of any other is for who mends the program."""


def why(ended: str, stopped: BaseException | None) -> str:
    """Why a mission ended, in a line.

    Args:
        ended: As its last step says; empty where it did not end by itself.
        stopped: What stopped it, or went wrong after its end.
    """
    said = [WORDS[ended]] if ended in WORDS else []
    return "; then ".join([*said, *([] if stopped is None else [reason(stopped)])])


def reason(stopped: BaseException) -> str:
    """What stopped a mission, in a line; what else went wrong because of it, which are its notes, follows."""
    lines = dict.fromkeys(" ".join(text.split()) for text in (_said(stopped), *_notes(stopped)))
    said = "; ".join(filter(None, lines))
    if FULL in said:
        # First why it was aborted, where that is something else.
        full = "the disk is full"
        said = f"{full}: {said}" if FULL in _said(stopped) else said.replace(FULL, full)
    return said if len(said) <= MOST else f"{said[: MOST - 200]} … {said[-197:]}"


def also(stopped: BaseException | None, later: BaseException) -> BaseException:
    """What stopped a mission, where something went wrong after it: the first, which is told of the later."""
    if stopped is None:
        return later
    if not (FULL in _said(stopped) and FULL in _said(later)):
        stopped.add_note(_said(later))
    return stopped


def _said(stopped: BaseException) -> str:
    text = str(stopped)
    if isinstance(stopped, KeyboardInterrupt):
        return f"interrupted: {text}" if text else "interrupted"
    if isinstance(stopped, _TOLD_IN_WORDS):
        return text or type(stopped).__name__
    return f"a fault of the program ({type(stopped).__name__}: {text})"


def _notes(stopped: BaseException) -> list[str]:
    return list(getattr(stopped, "__notes__", ()))


def asked_to_end(number: int, frame: FrameType | None) -> NoReturn:
    """A handler of SIGTERM: whoever sends it has the mission ended in order, as by Ctrl-C."""
    raise KeyboardInterrupt(TERMINATED)
