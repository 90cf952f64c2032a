"""What a server says is wrong with a request, and what it will never take, by its words."""

from __future__ import annotations

import re
from collections.abc import Mapping

from dream.planning.vlm.asking.scrubbing import wary_line

MOST_SAID = 200
"""Characters of what a server says is wrong with a request."""
PICTURE, CONTEXT, FORMAT, MODEL, ADDRESS = "picture", "context", "format", "model", "address"
"""What a server will never take, as far as its words tell."""

# Servers word it each in its own way, and some send it with a status of their own faults: llama.cpp says
# "image input is not supported" with 500 (llama.cpp issue 13566), LM Studio answers an address that is none
# with 200 (lmstudio-bug-tracker issue 618). A subject alone is not enough: it must also be said to fail.
_TAKES_NONE = (
    r"not (?:be |been |yet )?(?:\w+ )?(?:support|accept|allow|permit|implement|compil|configur|enabled)"
    r"|n[o']t (?:support|accept|allow)|do(?:es)?(?: not|n't) (?:have|take|handle|process)"
    r"|not available (?:for|in|on|with)\b|unsupported|no support|only (?:be )?supported|disabled"
    r"|(?:invalid|unknown|unrecogni[sz]ed) (?:content|field|parameter|part|type|variant)"
    r"|at most \d+ (?:image|picture)|exceeds?\b|too large|too many (?:image|picture)|found that support"
    r"|is not an? |no (?:vision|image|multimodal|mmproj)"
)
_FAILS = {
    # A picture goes through a decoder and an encoder, which fail for a while in many words: what cannot be
    # done, was not found or is missing tells of this picture, or of this moment.
    PICTURE: rf"{_TAKES_NONE}|mmproj|missing data required",
    FORMAT: rf"{_TAKES_NONE}|n[o']t (?:available|have|exist|handle|process)"
    r"|cannot|can't|unable|fail\w* to (?:parse|initiali[sz]e|compile)|error parsing|sane defaults"
    r"|invalid|unknown|unrecogni[sz]ed|missing|not found|at most|exceed|too (?:long|many|complex)",
}
_SUBJECTS = {
    PICTURE: r"\bimages?\b|image_url|\bpictures?\b|\bvision\b|\bvisual\b|multi-?modal|mmproj"
    r"|content\[\w*\]\.type",
    FORMAT: r"response_format|json_schema|json_object|\bschemas?\b|\bgrammars?\b|structured[ _-]outputs?"
    r"|guided|repetitions?\b|max_(?:completion_)?tokens|\btemperature\b",
}
_WHOLE = {
    CONTEXT: r"context[ _](?:length|size|window)|(?:prompt|input) is too long|reduce the length"
    r"|too many (?:input |prompt )?tokens",
    MODEL: r"\bmodel\b.{0,120}?(?:not found|not exist|n't exist|not loaded|is not served)"
    r"|(?:no such|unknown|no) model\b|model_not_found|no models? (?:is |are )?loaded",
    ADDRESS: r"unexpected endpoint|no such (?:endpoint|path|route)",
}
_NEVER = {kind: re.compile(pattern, re.IGNORECASE) for kind, pattern in {**_WHOLE, **_SUBJECTS}.items()}
_FAILING = {kind: re.compile(pattern, re.IGNORECASE) for kind, pattern in _FAILS.items()}
_PASSES = re.compile(
    r"overload|busy|try again|retry|temporar|loading|time[sd]?[ -]?out|deadline|over capacity|rate limit"
    r"|unavailable|memory|allocat|\bCUDA|crash|connect|fetch|found in (?:\w+ )?cache|cache miss"
    r"|shutting down|starting|currently|at (?:this time|the moment)|other requests|concurren|in flight|queue"
    r"|not ready|(?:available|initiali[sz]ed|loaded|ready|started) yet"
    r"|not yet (?:available|initiali[sz]ed|loaded|started)",
    re.IGNORECASE,
)


def never(words: str) -> str:
    """What the server will not take another time either, by its words; empty where they do not say so.

    Args:
        words: As `said` gives them.
    """
    if _PASSES.search(words):
        return ""
    for kind, pattern in _NEVER.items():
        if pattern.search(words) and (kind in _WHOLE or _FAILING[kind].search(words)):
            return kind
    return ""


def said(body: object) -> str:
    """What a server says is wrong: one short line, without what may be part of a key. Empty where nothing."""
    told = body
    # As deep as such bodies go; deeper ones tell nothing.
    for name in ("error", "message", "detail", "msg"):
        if isinstance(told, list) and told:
            told = told[0]
        if isinstance(told, Mapping) and told.get(name):
            told = told[name]
    if not isinstance(told, str) or told.lstrip().startswith("<"):
        return ""
    return wary_line(told, MOST_SAID)
