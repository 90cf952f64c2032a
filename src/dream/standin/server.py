"""A server on this machine that speaks OpenAI's chat completions and answers by rule."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
import threading
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from dream.standin import rules
from dream.standin.eyes import Unreadable
from dream.standin.faults import Fault, fault_named
from dream.standin.rules import Asked

MOST_BYTES = 64 << 20
"""A larger request is refused."""
PATH = "/v1/chat/completions"


@cache
def serve(fault: str = "") -> StandIn:
    """The stand-in of this process with that fault, listening."""
    server = StandIn(fault_named(fault))
    threading.Thread(target=server.serve_forever, name="stand-in", daemon=True).start()
    return server


class StandIn(ThreadingHTTPServer):
    """Listens on this machine only."""

    daemon_threads = True

    def __init__(self, fault: Fault) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.fault = fault
        self.failures: list[str] = []
        """What it could not read."""

    @property
    def address(self) -> str:
        """Where it is asked."""
        return f"http://127.0.0.1:{self.server_port}/v1"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """One who hangs up is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: StandIn
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        if self.path != PATH or not 0 < length <= MOST_BYTES:
            self.close_connection = True
            return self.say(404 if self.path != PATH else 413, _error(f"{self.path}, {length} bytes"))
        body = self.rfile.read(length)
        try:
            request = json.loads(body)
            asked = read_request(request)
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            return self.say(400, _error(f"no request: {error}"))
        try:
            said = rules.answer(asked)
        except (Unreadable, ValueError) as error:
            self.server.failures.append(str(error))
            return self.say(500, _error(str(error)))
        return self.server.fault.respond(self, body, asked, said, completion)

    def say(self, status: int, content: bytes) -> None:
        """Send a whole answer."""
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        if status in (429, 503):
            self.send_header("Retry-After-Ms", "1")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        """Say nothing of requests."""


def read_request(request: dict[str, Any]) -> Asked:
    """A request for a chat completion.

    Raises:
        ValueError, LookupError, TypeError, AttributeError: It is none.
    """
    texts: list[str] = []
    pictures: dict[str, bytes] = {}
    for message in request["messages"]:
        content = message["content"]
        for part in content if isinstance(content, list) else [{"type": "text", "text": content}]:
            if part["type"] == "image_url":
                name = re.fullmatch(r"\[(\w+)\]", texts[-1].strip()) if texts else None
                if not name:
                    raise ValueError("a picture without its name before it")
                pictures[name[1]] = _decoded(part["image_url"]["url"])
            else:
                texts.append(str(part["text"]))
    return Asked("\n".join(texts), pictures, request["response_format"]["json_schema"]["schema"])


def _decoded(url: str) -> bytes:
    head, _, data = url.partition(",")
    if head != "data:image/png;base64":
        raise ValueError(f"expected a PNG in a data URL, got {head[:40]}")
    try:
        return base64.b64decode(data, validate=True)
    except binascii.Error as error:
        raise ValueError("a picture that is not in base64") from error


def completion(asked: Asked, content: str | None, **message: Any) -> bytes:
    """A reply of that text; tokens are counted about as servers do."""
    tokens = len(asked.text) // 4 + sum(
        85 + 170 * max(1, math.ceil(len(p) / 65536)) for p in asked.pictures.values()
    )
    spoken = len(content or "") // 4
    finish = message.pop("finish_reason", "stop")
    reply = {
        "id": "stand-in",
        "object": "chat.completion",
        "created": 0,
        "model": "wire",
        "choices": [
            {
                "index": 0,
                "finish_reason": finish,
                "message": {"role": "assistant", "content": content, **message},
            }
        ],
        "usage": {"prompt_tokens": tokens, "completion_tokens": spoken, "total_tokens": tokens + spoken},
    }
    return json.dumps(reply).encode()


def _error(message: str) -> bytes:
    return json.dumps({"error": {"message": message, "type": "stand-in", "code": None}}).encode()
