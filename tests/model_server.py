"""A model that is none: a server on this machine that speaks OpenAI's interface and says what it is told."""

from __future__ import annotations

import base64
import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from dream.planning.vlm.reply import STEPS

NAME = "scripted"
"""What the server calls its model."""
SAID = "The reef goes on to the <b>north</b>."
"""Each step of its reasoning."""
SECRET = "sk-secret-0123456789"
"""Stands in every error."""

Json = dict[str, Any]


@dataclass(frozen=True)
class Request:
    """What was sent to the server."""

    body: Json
    headers: Mapping[str, str]
    """In small letters."""

    @property
    def schema(self) -> Json:
        """Of the reply; empty where none was sent."""
        schema: Json = self.body.get("response_format", {}).get("json_schema", {}).get("schema", {})
        return schema

    @property
    def text(self) -> str:
        """All of it, the instructions first."""
        return "\n".join(part["text"] for part in self._parts() if part["type"] == "text")

    @property
    def question(self) -> str:
        """The end of what was asked first: who is asked again is shown the reply that did not fit, too."""
        user = next(message for message in self.body["messages"] if message["role"] == "user")
        said: str = _parts(user)[-1]["text"]
        return said

    @property
    def pictures(self) -> list[bytes]:
        urls = [part["image_url"]["url"] for part in self._parts() if part["type"] == "image_url"]
        return [base64.b64decode(url.partition(",")[2]) for url in urls]

    @property
    def key(self) -> str:
        """What stood in the header for the key."""
        return self.headers["authorization"]

    def _parts(self) -> list[Json]:
        return [part for message in self.body["messages"] for part in _parts(message)]


def _parts(message: Json) -> list[Json]:
    content = message["content"]
    return content if isinstance(content, list) else [{"type": "text", "text": str(content)}]


@dataclass(frozen=True)
class Response:
    """What the server sends."""

    body: bytes
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    late: float = 0.0
    """Seconds before it."""
    breaks: bool = False
    """Half of it, then nothing."""


Answer = Callable[[Request], Response]


def says(
    content: str | None,
    *,
    refusal: str | None = None,
    finish: str = "stop",
    beside: Mapping[str, Any] | None = None,
    **fields: Any,
) -> Response:
    """A reply of that text, or one that would be but for some fields, and with some beside its text."""
    message = {"role": "assistant", "content": content, "refusal": refusal, **(beside or {})}
    reply = {
        "id": "1",
        "object": "chat.completion",
        "created": 1,
        "model": NAME,
        "choices": [{"index": 0, "finish_reason": finish, "message": message}],
        "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
    }
    return Response(json.dumps({**reply, **fields}).encode())


def error(status: int, words: str = "denied to key", **headers: str) -> Response:
    """An error, as such servers say it: with what no one should repeat in it."""
    body = {"error": {"message": f"{words} {SECRET}", "type": "error", "code": None}}
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Response(json.dumps(body).encode(), status, named)


def fitting(request: Request) -> Response:
    """A reply that fits: straight on, to the left where that was not safe; places as they are numbered."""
    fields = request.schema.get("properties", {})
    blocked = "not safe all the way" in request.text
    known = {
        "direction": "left" if blocked else "forward",
        "turn_deg": 90 if blocked else 0,
        "step_m": 1 if blocked else 2,
        "done": False,
        "ranking": fields.get("ranking", {}).get("items", {}).get("enum", []),
        "confidence": 0.5,
        "mission_complete": False,
    }
    return says(json.dumps({name: known.get(name, SAID) for name in fields}))


def ranking(
    order: Callable[[list[int]], list[int]] = sorted, *, confidence: float = 1.0, complete: bool = False
) -> Answer:
    """Ranks the places that are asked for in the order that a function makes of their numbers."""

    def answer(request: Request) -> Response:
        kind = request.schema["properties"]["ranking"]["items"]
        numbers = kind["enum"] if "enum" in kind else [kind["const"]]
        said: dict[str, Any] = dict.fromkeys(STEPS, SAID)
        said |= {"ranking": order(numbers), "confidence": confidence, "mission_complete": complete}
        return says(json.dumps(said))

    return answer


class Server(ThreadingHTTPServer):
    """Gives what is next in its script, or is made by it, and the last of it for ever."""

    daemon_threads = True

    def __init__(self, *script: Response | Answer) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.script = list(script)
        self.asked: list[Request] = []
        self._lock = threading.Lock()

    def respond(self, request: Request) -> Response:
        with self._lock:
            self.asked.append(request)
            said = self.script.pop(0) if len(self.script) > 1 else self.script[0]
        return said if isinstance(said, Response) else said(request)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"

    @property
    def options(self) -> Json:
        """Of a planner that asks it."""
        return {"model": self.address, "model_name": NAME}

    def handle_error(self, request: Any, client_address: Any) -> None:
        """One who hangs up is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        headers = {name.lower(): value for name, value in self.headers.items()}
        response = self.server.respond(Request(body, headers))
        time.sleep(response.late)
        self.send_response(response.status)
        usual = {"Content-Type": "application/json", "Content-Length": str(len(response.body))}
        for name, value in {**usual, **response.headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(response.body[: len(response.body) // (1 + response.breaks)])
        self.close_connection |= response.breaks

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextlib.contextmanager
def serving(*script: Response | Answer) -> Iterator[Server]:
    """Such a server, as long as the block lasts; what it says fits where no script is given."""
    with Server(*(script or [fitting])) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()
