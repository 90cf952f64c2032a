"""The loop that conversations go on in, and the HTTP client that they share: replies are bounded."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import AsyncIterator, Callable
from contextvars import ContextVar
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar, cast

import httpx2
from pydantic_ai.models import get_user_agent

from dream.planning.vlm.asking.refusals import NO_SUCH_REQUEST, TooLongError
from dream.planning.vlm.asking.scrubbing import is_passed_on
from dream.planning.vlm.asking.server_words import never, said

T = TypeVar("T")
A = ParamSpec("A")

MOST_REPLY_BYTES = 1 << 20
"""A longer reply is not read to its end."""

statuses: ContextVar[list[int]] = ContextVar("statuses")
"""HTTP statuses of the replies to a question; the requests may be sent by tasks below its own."""


def _once(make: Callable[A, T]) -> Callable[A, T]:
    """Makes the same thing once, also for threads that come at the same time."""
    lock, made = threading.Lock(), cache(make)

    @wraps(make)
    def one(*args: A.args, **options: A.kwargs) -> T:
        with lock:
            return made(*args, **cast(Any, options))

    return one


@_once
def loop() -> asyncio.AbstractEventLoop:
    """Where all conversations of this process go on."""
    started = asyncio.new_event_loop()
    threading.Thread(target=started.run_forever, name="models", daemon=True).start()
    return started


@_once
def http_client(*, address: bool, near: bool) -> httpx2.AsyncClient:
    """The client of this process for known models, or for servers that are given by their address.

    Args:
        address: Whether it is for servers that are given by their address. To those nothing is sent that the
            environment holds for others.
        near: Whether they are on this machine. Before those is no proxy.
    """
    return httpx2.AsyncClient(
        timeout=httpx2.Timeout(600.0, connect=5.0),
        headers={"User-Agent": get_user_agent(), "Accept-Encoding": "identity"},
        event_hooks={"request": [_drop_foreign_headers] if address else [], "response": [_bound]},
        trust_env=not near,
    )


class _BoundedStream(httpx2.AsyncByteStream):
    """The bytes of a reply, as long as they are not too many."""

    def __init__(self, stream: httpx2.AsyncByteStream) -> None:
        self._stream = stream

    async def __aiter__(self) -> AsyncIterator[bytes]:
        length = 0
        async for chunk in self._stream:
            length += len(chunk)
            if length > MOST_REPLY_BYTES:
                raise TooLongError(f"a reply of more than {MOST_REPLY_BYTES} bytes")
            yield chunk

    async def aclose(self) -> None:
        await self._stream.aclose()


async def _bound(response: httpx2.Response) -> None:
    """Note the status, hold the body to its bound, and tell the client what need not be tried again."""
    if (noted := statuses.get(None)) is not None:
        noted.append(response.status_code)
    if response.headers.get("content-encoding", "identity") != "identity":
        raise TooLongError("a reply that is packed, of unknown length")
    assert isinstance(response.stream, httpx2.AsyncByteStream)
    response.stream = _BoundedStream(response.stream)
    # The clients try again whatever is said with 500, also what will never be taken.
    if response.status_code >= 500:
        await response.aread()
        body: object = response.text
        with contextlib.suppress(ValueError, RecursionError):
            body = json.loads(response.content)
        if response.status_code in NO_SUCH_REQUEST or never(said(body)):
            response.headers["x-should-retry"] = "false"


async def _drop_foreign_headers(request: httpx2.Request) -> None:
    for name in [name for name in request.headers if not is_passed_on(name)]:
        del request.headers[name]
