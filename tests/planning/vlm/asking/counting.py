"""A reply that is a number, for tests of how models are asked."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from dream.planning.vlm.asking import Answer, Asking, Line, Question
from tests.model_server import Response, Server, says


class Number(BaseModel):
    model_config = ConfigDict(extra="forbid")

    why: str = Field(max_length=20)
    number: int


SO = '{"why": "so", "number": 3}'
GOOD = says(SO)
WRONG = says('{"why": "so", "number": "many"}')
BLIND = "image input is not supported - hint: if this is unexpected, you may need to provide the mmproj"


def line(server: Server, **options: Any) -> Line:
    """To a server that is given five seconds, unless told otherwise."""
    return Asking(**{"timeout": 5.0, **server.options, **options}).line()


def question(words: str = "How many?", reply: type[BaseModel] = Number) -> Question[Any]:
    return Question("test 1", "Count.", words, {"map": b"a picture", "camera": b"another"}, reply)


def ask(on: Line, words: str = "How many?", reply: type[BaseModel] = Number) -> Answer[Any]:
    return on.ask(question(words, reply)).answer()


def body(content: Any, status: int = 200) -> Response:
    return Response(json.dumps(content).encode(), status, {"retry-after": "0"})
