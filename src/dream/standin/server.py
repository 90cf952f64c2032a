"""The server: OpenAI's protocol over HTTP on this machine."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from dream.names import look_up
from dream.standin import chat, rules
from dream.standin.chat import Json
from dream.standin.faults import RETRY_MS, Delivery, Past, fault_named

PATH = "/v1/chat/completions"
MOST_BYTES = 64 << 20
"""Of a request; a longer one is refused."""
PATIENCE = 60.0
"""Seconds without a byte after which a connection is closed."""


class ModelStandIn(ThreadingHTTPServer):
    """A stand-in for a model, listening."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, fault: str = "") -> None:
        """Bind to a free port.

        Args:
            fault: How it errs; see `faults.FAULTS`. Not at all where empty.
        """
        self.fault = fault_named(fault)
        self.failures: list[str] = []
        """What could not be read, or was not understood."""
        self._past = Past()
        self._lock = threading.Lock()
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def address(self) -> str:
        """Where it listens, as OpenAI's clients want it."""
        return f"http://127.0.0.1:{self.server_address[1]}/v1"

    def reply(self, request: Json) -> Delivery:
        """What a request is answered with; failures are kept."""
        try:
            question = chat.asked(request)

            def right() -> Json:
                return look_up(rules.RULES, question.title, "rule for the schema")(question)

            with self._lock:
                return self.fault(question, right, self._past)
        except Exception as error:  # noqa: BLE001 - whatever went wrong must be loud, and not hang the client.
            self.failures.append(f"{type(error).__name__}: {error}")
            return Delivery(chat.error("unreadable", str(error)), 500)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away is no matter."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE
    server: ModelStandIn

    def do_POST(self) -> None:
        """Answer a question."""
        if self.path != PATH:
            self._refuse(404, f"no such path; this is {PATH}")
            return
        try:
            length = int(self.headers.get("Content-Length", ""))
        except ValueError:
            length = -1
        if length < 0:
            self._refuse(411, "expected a Content-Length")
            return
        if length > MOST_BYTES:
            self._refuse(413, f"expected at most {MOST_BYTES} bytes, got {length}")
            return
        try:
            request = json.loads(self.rfile.read(length))
        except (ValueError, RecursionError):
            self._refuse(400, "expected JSON, got something else")
            return
        if not isinstance(request, dict):
            self._refuse(400, "expected an object, got something else")
            return
        self._send(self.server.reply(request))

    def do_GET(self) -> None:
        """Nothing is to be got."""
        self._refuse(404, f"no such path; this is {PATH}")

    def log_message(self, *args: Any) -> None:
        """Be quiet."""

    def _refuse(self, status: int, why: str) -> None:
        self.close_connection = True
        self._send(Delivery(chat.error("invalid_request_error", why), status))

    def _send(self, delivery: Delivery) -> None:
        time.sleep(delivery.pause)
        try:
            self.send_response(delivery.status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(delivery.body)))
            if delivery.status in (429, 500):
                self.send_header("retry-after-ms", str(RETRY_MS))
            if self.close_connection:
                self.send_header("Connection", "close")
            self.end_headers()
            if delivery.breaks:
                self.wfile.write(delivery.body[: len(delivery.body) // 2])
                self.close_connection = True
            elif delivery.trickle:
                for byte in delivery.body:
                    self.wfile.write(bytes([byte]))
                    time.sleep(delivery.trickle)
            else:
                self.wfile.write(delivery.body)
        except OSError:
            self.close_connection = True


_STARTED: dict[str, ModelStandIn] = {}
_STARTING = threading.Lock()


def server(fault: str = "") -> ModelStandIn:
    """The stand-in of this process with that fault; started when first asked for."""
    with _STARTING:
        if fault not in _STARTED:
            _STARTED[fault] = started = ModelStandIn(fault)
            name = f"stand-in {fault}".strip()
            threading.Thread(target=started.serve_forever, name=name, daemon=True).start()
        return _STARTED[fault]
