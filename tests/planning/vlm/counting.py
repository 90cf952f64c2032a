"""A reply that is a number, for tests of how models are asked."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from dream.planning.vlm.asking import Asking, Line
from tests.model_server import Server, says


class Number(BaseModel):
    model_config = ConfigDict(extra="forbid")

    why: str = Field(max_length=20)
    number: int


SO = '{"why": "so", "number": 3}'
GOOD = says(SO)


def line(server: Server, **options: Any) -> Line:
    """To a server that is given five seconds, unless told otherwise."""
    return Asking(**{"timeout": 5.0, **server.options, **options}).line()
