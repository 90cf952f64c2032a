"""OpenAI's chat completions: what is asked in a request, and replies."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dream.standin import sight
from dream.standin.sight import UnreadableError

Json = dict[str, Any]

_DATA = "data:image/png;base64,"
_NAME = re.compile(r"\[(\w+)\]")
TOKEN = 4
"""Characters of text that make one token."""
PICTURE_TOKENS = 85
"""Of a picture of any size."""
TILE_TOKENS = 170
"""Of each tile of a picture."""
TILE = 512
"""Pixels along a tile."""


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """What a request asks for."""

    title: str
    """Of the schema that the answer must fit."""
    schema: Json
    text: str
    """All of it, but the names of the pictures."""
    pictures: Mapping[str, bytes]
    """PNG files by the name that stood before each, in the order in which they came."""

    def choices(self, field: str) -> list[Any]:
        """What the schema allows in a field, or in each item of a list.

        Raises:
            UnreadableError: It does not say.
        """
        about = self.schema.get("properties", {}).get(field, {})
        allowed = about.get("enum") or about.get("items", {}).get("enum")
        if not allowed and "const" in about.get("items", {}):
            allowed = [about["items"]["const"]]
        if not isinstance(allowed, list) or not allowed:
            raise UnreadableError(
                f"{self.title}: expected the schema to list what {field} may be, got {about}"
            )
        return allowed

    def number(self, pattern: str) -> float | None:
        """The number in the text where a pattern with one group matches; None where it does not."""
        found = re.search(pattern, self.text)
        return float(found[1]) if found else None


def asked(request: Json) -> Asked:
    """What a request asks for.

    Raises:
        UnreadableError: A picture has no name, or is none; or no schema is there.
    """
    wanted: Any = request.get("response_format")
    schema: Any = wanted.get("json_schema") if isinstance(wanted, dict) else None
    if not isinstance(schema, dict) or not schema.get("name") or not isinstance(schema.get("schema"), dict):
        raise UnreadableError("response_format: expected a json_schema with name and schema, got none")
    texts: list[str] = []
    pictures: dict[str, bytes] = {}
    name = ""
    for message in request.get("messages", []):
        content = message.get("content") or ""
        parts: list[Any] = [{"type": "text", "text": content}] if isinstance(content, str) else content
        for part in parts:
            if part.get("type") == "image_url":
                if not name or name in pictures:
                    raise UnreadableError(
                        f"[{name}]: expected each picture behind a name of its own, got another"
                    )
                pictures[name] = _png(part.get("image_url", {}).get("url", ""), name)
                name = ""
            elif named := _NAME.fullmatch(part.get("text", "").strip()):
                name = named[1]
            else:
                texts.append(part.get("text", ""))
    if name:
        raise UnreadableError(f"[{name}]: expected a picture behind its name, got none")
    return Asked(schema["name"], schema["schema"], "\n".join(texts), pictures)


def _png(url: str, name: str) -> bytes:
    if not url.startswith(_DATA):
        raise UnreadableError(f"[{name}]: expected an address that begins with {_DATA}, got {url[:30]!r}")
    try:
        return base64.b64decode(url[len(_DATA) :], validate=True)
    except binascii.Error as error:
        raise UnreadableError(f"[{name}]: expected base64, got {error}") from error


def completion(content: str, question: Asked) -> Json:
    """A reply with that text."""
    return _completion({"role": "assistant", "content": content, "refusal": None}, "stop", question)


def refusal(question: Asked) -> Json:
    """A reply that declines to answer."""
    message = {"role": "assistant", "content": None, "refusal": "I cannot help with steering a robot."}
    return _completion(message, "content_filter", question)


def _completion(message: Json, reason: str, question: Asked) -> Json:
    spent = tokens(question)
    made = math.ceil(len(message["content"] or message["refusal"]) / TOKEN)
    return {
        "id": "chatcmpl-stand-in",
        "object": "chat.completion",
        "created": 0,
        "model": "stand-in",
        "choices": [{"index": 0, "message": message, "finish_reason": reason, "logprobs": None}],
        "usage": {"prompt_tokens": spent, "completion_tokens": made, "total_tokens": spent + made},
    }


def tokens(question: Asked) -> int:
    """Of a question, by its text and the sizes of its pictures."""
    total = math.ceil(len(question.text) / TOKEN)
    for name, png in question.pictures.items():
        height, width = sight.decode(png, name).shape[:2]
        total += PICTURE_TOKENS + TILE_TOKENS * math.ceil(width / TILE) * math.ceil(height / TILE)
    return total


def error(kind: str, message: str) -> bytes:
    """An error as OpenAI words it."""
    return json.dumps({"error": {"message": message, "type": kind, "param": None, "code": None}}).encode()
