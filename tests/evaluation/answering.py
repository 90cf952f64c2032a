"""A server that speaks as much of OpenAI's interface as a probe needs, and answers as it is told."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Answers = Callable[[str, str, list[str]], str | None]
"""What is replied to a question, a picture's SHA-256 and the answers of the schema; None is an error."""


def sha(picture: bytes) -> str:
    return hashlib.sha256(picture).hexdigest()


@contextlib.contextmanager
def answering(answers: Answers) -> Iterator[tuple[str, list[list[str]]]]:
    """Its address, and the enumerations of the requests so far."""
    seen: list[list[str]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked = json.loads(self.rfile.read(int(self.headers["content-length"])))
            # Who is asked again is shown the reply that did not fit, too: the question stands before it.
            parts = next(m["content"] for m in asked["messages"] if isinstance(m["content"], list))
            text = next(part["text"] for part in reversed(parts) if part["type"] == "text")
            url = next(part["image_url"]["url"] for part in parts if part["type"] == "image_url")
            picture = base64.b64decode(url.partition(",")[2])
            choices = asked["response_format"]["json_schema"]["schema"]["properties"]["answer"]["enum"]
            seen.append(choices)
            content = answers(text, sha(picture), choices)
            body: dict[str, Any] = {
                "id": "1",
                "object": "chat.completion",
                "created": 0,
                "model": "told",
                "choices": [
                    {
                        "index": 0,
                        "finish_reason": "stop",
                        "message": {"role": "assistant", "content": content},
                    }
                ],
                "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
            }
            sent = json.dumps({"error": {"message": "no"}} if content is None else body).encode()
            self.send_response(403 if content is None else 200)
            self.send_header("content-type", "application/json")
            self.send_header("content-length", str(len(sent)))
            self.end_headers()
            self.wfile.write(sent)

        def log_message(self, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1", seen
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def choice(answer: str) -> str:
    """A valid reply."""
    return json.dumps({"reason": "The map shows it.", "answer": answer})
