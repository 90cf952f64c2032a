"""A server on this machine that speaks the protocol of chat completions and says what a test tells it to."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from dream.planning.vlm.reply import STEPS

Body = dict[str, Any]
Respond = Callable[["Handler"], None]


def text(content: str | None, **message: Any) -> Respond:
    """A reply of that text."""
    finish = message.pop("finish_reason", "stop")
    completion = {
        "id": "1",
        "object": "chat.completion",
        "created": 1,
        "model": "scripted",
        "choices": [
            {
                "index": 0,
                "finish_reason": finish,
                "message": {"role": "assistant", "content": content, **message},
            }
        ],
        "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
    }
    return raw(json.dumps(completion).encode())


def ranking(
    order: Callable[[list[int]], list[int]] = sorted, *, confidence: float = 1.0, complete: bool = False
) -> Respond:
    """A ranking of the places that are asked for, in the order that a function makes of their numbers."""

    def respond(handler: Handler) -> None:
        schema = handler.body["response_format"]["json_schema"]["schema"]
        kind = schema["properties"]["ranking"]["items"]
        numbers = kind["enum"] if "enum" in kind else [kind["const"]]
        reply = {
            **dict.fromkeys(STEPS, "Because."),
            "ranking": order(numbers),
            "confidence": confidence,
            "mission_complete": complete,
        }
        text(json.dumps(reply))(handler)

    return respond


def raw(content: bytes, status: int = 200, **headers: str) -> Respond:
    """Those bytes."""

    def respond(handler: Handler) -> None:
        handler.send_response(status)
        for name, value in {"Content-Type": "application/json", **headers}.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.send_header("Content-Length", str(len(content)))
        handler.end_headers()
        handler.wfile.write(content)

    return respond


def error(status: int, **headers: str) -> Respond:
    """An error, as such servers say it: with what no one should repeat in it."""
    body = {"error": {"message": f"denied to key {SECRET}", "type": "error", "code": None}}
    return raw(json.dumps(body).encode(), status, **headers)


def dropped(handler: Handler) -> None:
    """Half of a reply, then nothing."""
    handler.send_response(200)
    handler.send_header("Content-Length", "1000")
    handler.end_headers()
    handler.wfile.write(b'{"id": "1", ')
    handler.close_connection = True


def after(seconds: float, respond: Respond) -> Respond:
    """That, but late."""

    def late(handler: Handler) -> None:
        time.sleep(seconds)
        respond(handler)

    return late


SECRET = "sk-secret-0123456789"


class Handler(BaseHTTPRequestHandler):
    server: Scripted
    body: Body
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        self.body = body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        with self.server.lock:
            self.server.requests.append(body)
            self.server.keys.append(self.headers.get("Authorization", ""))
            self.server.headers.append(dict(self.headers))
            script = self.server.script
            respond = script.pop(0) if len(script) > 1 else script[0]
        try:
            respond(self)
        except OSError:
            self.close_connection = True  # The client did not wait.

    def log_message(self, *_: Any) -> None:
        pass


class Scripted(ThreadingHTTPServer):
    """Answers with what is next in its script, and with the last of it for ever."""

    daemon_threads = True

    def __init__(self, *script: Respond) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.script = list(script)
        self.lock = threading.Lock()
        self.requests: list[Body] = []
        self.keys: list[str] = []
        self.headers: list[dict[str, str]] = []

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass


@contextmanager
def serving(*script: Respond) -> Iterator[Scripted]:
    """Such a server, as long as the block lasts."""
    server = Scripted(*script)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
