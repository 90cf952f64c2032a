"""What a server sends instead of an answer, and what can be asked of it after that."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from dream.planning.vlm.asking.server_words import CONTEXT, never, said

NO_SUCH_REQUEST = (400, 413, 415, 422, 501)
"""HTTP statuses of a request that the server does not take, whoever sends it and whenever."""
TOO_MANY = 429
"""HTTP status of a request that comes too soon; the client waits as long as it is told, and asks again."""
BOUNDS = ("max_tokens", "max_completion_tokens", "")
"""What a server may call the most tokens of a reply; the last is none. Most know the first; OpenAI's models
that think only the second, which llama-cpp-python and some Ollama ignore (llama-cpp-python issue 1907)."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """What a server says instead of an answer."""

    status: int
    """Of HTTP, or the one that the error names."""
    within: bool
    """It stood in a reply of status 200."""
    words: str
    """Its own, in a line."""

    @property
    def about(self) -> str:
        """What it will not take another time either; see `server_words.never`."""
        return never(self.words)

    @property
    def lasting(self) -> bool:
        """Would the same request be turned away again?"""
        return self.status in NO_SUCH_REQUEST or (self.status != TOO_MANY and bool(self.about))


class TooLongError(ValueError):
    """A reply that is not read to its end."""


class ErrorInReplyError(Exception):
    """A reply of status 200 that holds an error, and no answer."""

    def __init__(self, body: object) -> None:
        super().__init__("an error in a reply")
        self.body = body


class NoReplyError(Exception):
    """What was sent with status 200 is no reply; the message says why."""


def refusal_in(error: BaseException) -> Refusal | None:
    """What a server said; None where it said nothing that is read."""
    from pydantic_ai.exceptions import ModelHTTPError

    if isinstance(error, ModelHTTPError):
        return Refusal(error.status_code, within=False, words=said(error.body))
    if isinstance(error, ErrorInReplyError):
        named = [error.body.get(name) for name in ("code", "type")] if isinstance(error.body, Mapping) else []
        known = (_STATUSES.get(str(name), str(name)) for name in named)
        status = next((int(name) for name in known if re.fullmatch(r"[45]\d\d", name, re.ASCII)), 200)
        return Refusal(status, within=True, words=said(error.body))
    return None


_STATUSES = {
    "insufficient_quota": "402",
    "rate_limit_exceeded": "429",
    "rate_limit_error": "429",
    "invalid_api_key": "401",
    "authentication_error": "401",
    "invalid_request_error": "400",
    "BadRequestError": "400",
    "model_not_found": "404",
}
"""HTTP statuses of errors by name, for those that come without one."""


LIMITS = re.compile(r"m(?:ax|in)(?:Length|Items)|repetition|grammar|keyword|not permitted", re.IGNORECASE)
"""What a server names that may take a schema without limits on lengths."""


def other_bound(words: str, bound: int) -> int:
    """The next of `BOUNDS` that may be taken; 0 where the words name none of them."""
    if bound == 0 and re.search(r"use\W+max_completion_tokens", words, re.IGNORECASE):
        return 1
    # vLLM counts the most tokens of a reply towards a context that has room for the question alone.
    named = re.search(r"max_(?:completion_|output_|new_)?tokens|in the completion|output tokens", words)
    return len(BOUNDS) - 1 if named or never(words) == CONTEXT else 0
