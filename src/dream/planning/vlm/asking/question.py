"""What a model is asked, and what comes of it: as it came, and checked."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from pydantic import BaseModel

from dream.types import Exchange

R = TypeVar("R", bound=BaseModel)

THINKING = 16_384
"""Tokens that a model may think before it answers. Of more than 21 000 in all, Anthropic's client asks to be
streamed."""
BESIDE = 1024
"""Tokens of an answer beside its sentences: names of fields, numbers, braces."""
TOKEN = 2
"""Characters of a sentence that make a token at least, in languages that models know well."""


@dataclass(frozen=True, slots=True, eq=False)
class Question(Generic[R]):
    """What is asked."""

    prompt: str
    """Name and version of the prompt."""
    instructions: str
    text: str
    pictures: Mapping[str, bytes]
    """PNG files by name, in the order in which they are shown."""
    reply: type[R]
    """What an answer must be."""

    @property
    def sent(self) -> str:
        """All that is sent as text."""
        shown = "".join(f"[{name}]\n" for name in self.pictures)
        return f"{self.instructions}\n\n{shown}\n{self.text}"

    @property
    def most_tokens(self) -> int:
        """Tokens of a reply at most: enough to think, and to fill every field."""
        sentences = re.findall(r'"maxLength": (\d+)', json.dumps(self.reply.model_json_schema()))
        return THINKING + BESIDE + sum(map(int, sentences)) // TOKEN

    def key(self, model: str) -> str:
        """Hash of all that an answer may depend on."""
        texts = [model, self.instructions, self.text, self.reply.model_json_schema()]
        whole = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
        for name, png in self.pictures.items():
            whole.update(f"\n{name}:{hashlib.sha256(png).hexdigest()}".encode())
        return whole.hexdigest()[:32]


@dataclass(frozen=True, slots=True)
class RawAnswer:
    """What came of a question, before it is checked."""

    replies: tuple[str, ...] = ()
    """Each as the model wrote it, without keys; the last is the one that counts."""
    fallback: str = ""
    """Why there is no answer; see `failures`. Empty where a reply came that the client took for one."""
    requests: int = 0
    tokens_in: int = 0
    tokens_out: int = 0
    cost_usd: float | None = 0.0
    """US dollars; None where a price is not known."""
    seconds: float = 0.0
    answered_by: str = ""
    """What the server says is the model's name."""

    def lasting(self, seconds: float) -> RawAnswer:
        """The same, with the time that it took."""
        return replace(self, seconds=round(seconds, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Generic[R]):
    """What came of a question."""

    reply: R | None
    """None where the exchange says why there is none."""
    exchange: Exchange
