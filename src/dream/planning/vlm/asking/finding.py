"""Where the answer stands in what a model wrote: text from a stranger, searched and never evaluated."""

from __future__ import annotations

import json
import re

from pydantic import BaseModel, ValidationError

from dream.planning.vlm.asking.scrubbing import plain_line

MOST_SEARCHED = 1 << 16
"""Characters at the end of a reply in which its answer is looked for; a whole answer has ten thousand."""
MOST_OBJECTS = 1000
"""Beginnings of objects that are tried."""
MOST_LACKS = 5
"""Faults of a reply that are told."""
MOST_LACKING = 300
"""Characters of all of them."""
MOST_PLACE = 40
"""Characters of the name of a field, which a model may have made up."""
NOT_JSON = "no JSON object"
"""What a reply lacks that holds none."""

# The ends of thinking, and the beginnings of what comes after it, that templates of models write: tags of
# DeepSeek, Qwen and Seed, Magistral's, Kimi's, and the channel of gpt-oss's harmony format, whose tokens some
# servers drop and leave their words.
_THOUGHT = re.compile(
    r"</(?:think|thinking|thought|reasoning|seed:think)>|\[/THINK\]|◁/think▷|<\|end_of_thought\|>"
    r"|<\|channel\|>\s*final\b[^{}]{0,80}?<\|message\|>|assistantfinal",
    re.IGNORECASE,
)
_OBJECT = re.compile(r'\{\s*"')
_AT_ONCE = re.compile(r'\s*(?:```\w*\s*)?(?=\{\s*")')
_JSON = json.JSONDecoder()


def answer_in(text: str, reply: type[BaseModel], *, cut: bool = False) -> str:
    """The answer in a reply: all of it where it fits, else the last whole JSON object in it that does.

    What is thought before the answer does not count: neither inside tags nor before a lone closing one.

    Args:
        text: What the model wrote.
        reply: What an answer must be.
        cut: It broke off; then only an object counts that it began with.

    Returns:
        The last object, or the text, where none fits; so that what it lacks can be told.
    """
    text = text.strip()
    if fits(text, reply):
        return text
    text = text[-MOST_SEARCHED:]
    *_, after = _THOUGHT.split(text)
    after = after.strip() or text
    if cut:
        start = _AT_ONCE.match(after)
        whole = _objects(after[start.end() :])[:1] if start else []
    else:
        whole = _objects(after)
    fitting = (one for one in reversed(whole) if fits(one, reply))
    return next(fitting, whole[-1] if whole else after)


def lacking(text: str, reply: type[BaseModel]) -> str:
    """What a reply lacks, in a line; empty where there is an answer in it.

    Args:
        text: What the model wrote, without keys.
        reply: What an answer must be.
    """
    answer = answer_in(text, reply)
    if not answer.startswith("{"):
        return NOT_JSON if answer else "nothing was written"
    try:
        reply.model_validate_json(answer)
    except ValidationError as error:
        faults = error.errors(include_url=False, include_input=False, include_context=False)
        told = [f"{_place(fault['loc'])}: {_words(fault['msg'])}" for fault in faults[:MOST_LACKS]]
        more = [f"{len(faults) - MOST_LACKS} more"] if len(faults) > MOST_LACKS else []
        return plain_line("; ".join([*told, *more]), MOST_LACKING)
    return ""


def _place(loc: tuple[int | str, ...]) -> str:
    return ".".join(str(part)[:MOST_PLACE] for part in loc) or "the whole"


def _words(message: str) -> str:
    return message.removeprefix("Value error, ")


def fits(text: str, reply: type[BaseModel]) -> bool:
    """Is all of the text an answer?"""
    try:
        reply.model_validate_json(text)
    except ValidationError:
        return False
    return True


def _objects(text: str) -> list[str]:
    """The JSON objects that stand in a text side by side; those inside of others are part of them."""
    found, end = [], 0
    for start in list(_OBJECT.finditer(text))[:MOST_OBJECTS]:
        if start.start() < end:
            continue
        try:
            _, end = _JSON.raw_decode(text, start.start())
        except ValueError:
            continue
        except RecursionError:  # Nothing that nests so deeply is an answer.
            break
        found.append(text[start.start() : end])
    return found
