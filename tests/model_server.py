"""A model that is none: a server on this machine that speaks OpenAI's interface and answers by a function."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

NAME = "painted"
"""What the server calls its model."""
SAID = "The reef goes on to the <b>north</b>."
"""Each step of its reasoning."""


@dataclass(frozen=True)
class Request:
    """What a planner sent."""

    wanted: dict[str, Any]
    """JSON schema of the reply; empty where none was sent."""
    text: str
    """All text, the instructions first."""
    pictures: int
    key: str
    """What stood in the header for the key."""


Answer = Callable[[Request], str | int]
"""The text of the reply, or the status of an error."""


def fitting(request: Request) -> str:
    """A reply that fits: straight on, to the left where that was not safe; places as they are numbered."""
    fields = request.wanted.get("properties", {})
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
    return json.dumps({name: known.get(name, SAID) for name in fields})


@dataclass
class Server:
    """Where it listens, and what it was asked."""

    address: str
    asked: list[Request] = field(default_factory=list)

    @property
    def options(self) -> dict[str, Any]:
        """Of a planner that asks it."""
        return {"model": self.address, "model_name": NAME}


@contextlib.contextmanager
def serving(answer: Answer = fitting) -> Iterator[Server]:
    """Serve until the block ends."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            sent = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            request = _read(sent, self.headers.get("Authorization", ""))
            served.asked.append(request)
            said = answer(request)
            status = said if isinstance(said, int) else 200
            body = json.dumps(_completion(said) if isinstance(said, str) else {"error": "no"}).encode()
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            """Say nothing."""

    class Quiet(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, request: Any, client_address: Any) -> None:
            """One who hangs up is no error."""

    with Quiet(("127.0.0.1", 0), Handler) as server:
        served = Server(f"http://127.0.0.1:{server.server_address[1]}/v1")
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield served
        finally:
            server.shutdown()
            thread.join()


def _read(sent: dict[str, Any], key: str) -> Request:
    texts, pictures = [], 0
    for message in sent["messages"]:
        parts = message["content"] if isinstance(message["content"], list) else [message["content"]]
        for part in parts:
            if isinstance(part, dict) and part["type"] == "image_url":
                pictures += 1
            else:
                texts.append(part["text"] if isinstance(part, dict) else str(part))
    wanted = sent.get("response_format", {}).get("json_schema", {}).get("schema", {})
    return Request(wanted, "\n".join(texts), pictures, key)


def _completion(text: str) -> dict[str, Any]:
    return {
        "id": "1",
        "object": "chat.completion",
        "created": 0,
        "model": NAME,
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 1000, "completion_tokens": 50, "total_tokens": 1050},
    }
