"""Run folders → a small web server that shows them while they are written, and can change nothing."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import html
import io
import json
import re
import socket
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import quote

from PIL import Image

from dream.live.doors import Doorkeeper, Doors
from dream.live.folders import Watched
from dream.live.stream import Cursor
from dream.recording import LABEL_COLORS
from dream.report import (
    DEPTH_LEVEL,
    SHARED_SCRIPTS,
    asked_at,
    depth_levels,
    fill,
    label_levels,
    open_picture,
    part,
)
from dream.scene import SPACE, view
from dream.types import Label

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp, Receive, Scope, Send

PORT = 8412
"""Where the page is unless another is asked for, or this one is taken."""
LOOK_S = 0.25
"""Seconds between two looks at the folders; only while a page is open."""
BEAT_S = 2.0
"""Seconds after which a page is told that the server is still there."""
SEND_S = 10.0
"""Seconds that a page may take to accept what it is sent; a slower one is let go, and may come back."""
LIFE_S = 600.0
"""Seconds after which a page has to come back, so that one that vanished without a word keeps no place."""
MAX_PAGES = 8
"""Open at a time."""
MAX_CONNECTIONS = 64
"""Of those who passed the door."""

Admit = Callable[[Any], bool]
"""Whether there is a place for one who passed the door, by where it comes from."""

_PICTURES = {
    "rgb": "frames/{:04d}_rgb.png",
    "depth": "frames/{:04d}_depth.png",
    "labels": "frames/{:04d}_labels.png",
    "map": "maps/{:04d}.png",
}
FOR_EVER = {"cache-control": "private, max-age=3600, immutable"}
NEVER = {"cache-control": "no-store"}


@dataclass(slots=True)
class Pages:
    """The pages that are open, and what they look at."""

    watched: Watched
    open: int = 0
    left: float = field(default_factory=time.monotonic)
    """When the last one went, on the clock `time.monotonic`."""
    closing: Callable[[], bool] = lambda: False
    """Whether the server is about to end, and pages have to let go."""
    _looked: float = 0.0
    _looking: asyncio.Task[None] | None = None

    async def look(self) -> None:
        """See what came since; all pages share one look, which goes on when a page goes that waits for it."""
        if self._looking is None and time.monotonic() - self._looked >= LOOK_S:
            self._looking = asyncio.create_task(self._look())
        if self._looking is not None:
            await asyncio.shield(self._looking)

    async def _look(self) -> None:
        try:
            await asyncio.to_thread(self.watched.look)
        finally:
            self._looked, self._looking = time.monotonic(), None


def application(pages: Pages, doors: Doors, admit: Admit = lambda client: True) -> ASGIApp:
    """The server without its socket.

    Args:
        pages: That are open.
        doors: Who may look.
        admit: Whether there is a place for one who may, by where it comes from.
    """
    from fastapi import FastAPI
    from fastapi.responses import PlainTextResponse, Response

    page, style, script = _page()
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    async def of_run(request: Request) -> Response:
        answer = await asyncio.to_thread(_of_run, pages.watched, **request.path_params)
        if answer is None:
            return PlainTextResponse("There is nothing of that name.\n", 404, NEVER)
        content, kind = answer
        return Response(content, headers=FOR_EVER, media_type=kind)

    async def space(request: Request) -> Response:
        told = await asyncio.to_thread(_space, pages.watched, **request.path_params)
        if told is None:
            return PlainTextResponse("There is nothing of that name.\n", 404, NEVER)
        return Response(told, headers=NEVER, media_type="application/json")

    async def events(request: Request) -> Any:
        if pages.open >= MAX_PAGES:
            said = f"{MAX_PAGES} pages are open already; close one.\n"
            return PlainTextResponse(said, 503, {**NEVER, "retry-after": "5"})
        # A page that comes back by itself says in the header where it was; the address is that of its begin.
        was = request.headers.get("last-event-id") or request.query_params.get("have", "")
        return _Stream(pages, Cursor.at(was, request.query_params.get("open", "")))

    def fixed(content: str, kind: str) -> Callable[[Request], Any]:
        async def given(request: Request) -> Response:
            return Response(content, headers=NEVER, media_type=kind)

        return given

    app.add_route("/", fixed(page, "text/html"))
    app.add_route("/page.css", fixed(style, "text/css"))
    app.add_route("/page.js", fixed(script, "text/javascript"))
    app.add_route("/events", events)
    app.add_route("/runs/{key}/space", space)
    app.add_route("/runs/{key}/{step}/{what}", of_run)
    return Doorkeeper(app, doors, admit)


def _page() -> tuple[str, str, str]:
    """HTML, style and script of the page."""
    fixed = {
        "labels": [{"name": label.name.lower(), "color": LABEL_COLORS[label]} for label in Label],
        "depth_level": DEPTH_LEVEL,
    }
    own = {name: own_part(name) for name in ("live.html", "live.css", "live.js")}
    shared = {name: part(f"{name}.html") for name in ("stage", "player")}
    parts = {**shared, "space": view.part("space.html"), "fixed": html.escape(json.dumps(fixed))}
    return (
        fill(own["live.html"], parts),
        part("page.css") + view.part("space.css") + own["live.css"],
        "".join(map(part, SHARED_SCRIPTS)) + view.part("space.js") + own["live.js"],
    )


def own_part(name: str) -> str:
    """A file of a page that this server shows."""
    return resources.files("dream").joinpath("live/page", name).read_text(encoding="utf-8")


def _of_run(watched: Watched, key: str, step: str, what: str) -> tuple[bytes, str] | None:
    """Content and media type of something of a recorded step; None where there is no such thing.

    Paths are made here, from a number and a name of a table: what a page asks for never becomes part of one.
    """
    run = watched.get(key)
    if run is None or not re.fullmatch(r"[0-9]{1,7}", step) or not run.has(number := int(step)):
        return None
    if what == "asked":
        exchanges = asked_at(run.folder, number) if run.keeps_replies(number) else []
        return json.dumps(exchanges).encode(), "application/json"
    path = run.file(_PICTURES[what].format(number)) if what in _PICTURES else None
    content = None if path is None else open_picture(path, _SHOWN.get(what, lambda image: path.read_bytes()))
    return None if content is None else (content, "image/png")


def _space(watched: Watched, key: str) -> bytes | None:
    """What `view.shown` says of a run's scene, as JSON; None where it has none."""
    run = watched.get(key)
    path = None if run is None else run.file(SPACE)
    return None if path is None else json.dumps(view.shown(path), separators=(",", ":")).encode()


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "png", compress_level=1)
    return buffer.getvalue()


# A browser gets depth and labels as levels, which it draws and tells in words.
_SHOWN: dict[str, Callable[[Image.Image], bytes]] = {
    "depth": lambda image: _png(Image.fromarray(depth_levels(image))),
    "labels": lambda image: _png(label_levels(image)),
}


class _Stream:
    """The answer that goes on: events, until the page goes, is too slow, or has to come back."""

    def __init__(self, pages: Pages, cursor: Cursor) -> None:
        self._pages = pages
        self._cursor = cursor

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._pages.open += 1
        tasks = [asyncio.create_task(self._tell(send)), asyncio.create_task(_until_gone(receive))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                with contextlib.suppress(TimeoutError, OSError):
                    task.result()  # One that was too slow, or is gone, comes back and says where it was.
        finally:
            for task in tasks:
                task.cancel()
            self._pages.open -= 1
            self._pages.left = time.monotonic()

    async def _tell(self, send: Send) -> None:
        headers = [(b"content-type", b"text/event-stream"), (b"cache-control", b"no-store")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        async for chunk in self._chunks():
            body = {"type": "http.response.body", "body": chunk, "more_body": True}
            await asyncio.wait_for(send(body), SEND_S)
        await send({"type": "http.response.body", "body": b""})

    async def _chunks(self) -> AsyncIterator[bytes]:
        watched, cursor = self._pages.watched, self._cursor
        began, beaten = time.monotonic(), -BEAT_S
        yield b"retry: 1000\n\n"
        while time.monotonic() - began < LIFE_S and not self._pages.closing():
            await self._pages.look()
            news = b"".join(cursor.news(watched))
            behind = cursor.is_behind(watched)
            if news and behind:
                yield news
                continue
            # What is behind without news waits for the next look at the folders.
            if not behind and (news or time.monotonic() - beaten >= BEAT_S):
                beaten = time.monotonic()
                yield news + cursor.beat(watched)
            await asyncio.sleep(LOOK_S)


async def _until_gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


def listen(host: str, port: int | None) -> socket.socket:
    """A socket that listens at `port`; at a free one where none is asked for and the usual one is taken.

    Raises:
        OSError: It cannot listen there.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, PORT, type=socket.SOCK_STREAM)[0]
        for candidate in (PORT, 0) if port is None else (port,):
            found = socket.socket(family, socket.SOCK_STREAM)
            try:
                found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                found.bind((address[0], candidate))
                found.listen(MAX_CONNECTIONS)
            except OSError as error:
                found.close()
                if error.errno != errno.EADDRINUSE or candidate == 0 or port is not None:
                    raise
            else:
                return found
    except OSError as error:
        where = f"{host}:{PORT if port is None else port}"
        raise OSError(
            f"--host, --port: expected a place to listen at, got {where} ({error.strerror})"
        ) from error
    raise AssertionError("the system gives a free port or an error")


def address(doors: Doors, listening: socket.socket) -> str:
    """What to open in a browser; with the token, if there is one."""
    port = listening.getsockname()[1]
    host = _reached_at() if doors.host in ("0.0.0.0", "::") else doors.host
    bracketed = f"[{host}]" if ":" in host else host
    return f"http://{bracketed}:{port}/" + (f"?token={quote(doors.token, safe='')}" if doors.token else "")


def _reached_at() -> str:
    """This machine's address on the network that it has; its name where it has none. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(("192.0.2.1", 9))  # RFC 5737: an address of nobody.
        except OSError:
            return socket.gethostname()
        return str(asking.getsockname()[0])


def serve(places: list[Path], doors: Doors, listening: socket.socket, over: Callable[[Pages], bool]) -> None:
    """Show run folders until `over` says so, or Ctrl-C.

    Args:
        places: Run folders, or folders of them; they may not be there yet.
        doors: Who may look.
        listening: From `listen`.
        over: Asked every so often whether it is time to end.
    """
    pages = Pages(Watched(places))

    def made(admit: Admit, closing: Callable[[], bool]) -> ASGIApp:
        pages.closing = closing
        return application(pages, doors, admit)

    host(made, listening, lambda: over(pages))


def host(
    made: Callable[[Admit, Callable[[], bool]], ASGIApp],
    listening: socket.socket,
    over: Callable[[], bool],
) -> None:
    """Answer requests with an application until `over` says so, or Ctrl-C.

    Args:
        made: Gives the application; it is told whether there is a place for a connection, by where that comes
            from, and whether the server is about to end.
        listening: From `listen`.
        over: Asked every so often whether it is time to end.
    """
    import uvicorn

    from dream.live.guests import MOST_AT_ONCE, MOST_HEAD, House, guests_of

    house = House(MAX_CONNECTIONS)
    server = uvicorn.Server(
        uvicorn.Config(
            made(house.admit, lambda: server.should_exit),
            http=cast("type[asyncio.Protocol]", guests_of(house)),
            ws="none",
            lifespan="off",
            log_level="error",
            access_log=False,  # An address may hold the token.
            server_header=False,
            proxy_headers=False,
            h11_max_incomplete_event_size=MOST_HEAD,
            backlog=MOST_AT_ONCE,
            timeout_graceful_shutdown=1,
        )
    )

    async def run() -> None:
        async def watch() -> None:
            while not over():
                await asyncio.sleep(LOOK_S)
            server.should_exit = True

        ending = asyncio.create_task(watch())
        await server.serve(sockets=[listening])
        ending.cancel()
        # One that came while it ended would stay open and unanswered, and its page would wait for it.
        for connection in list(server.server_state.connections):
            connection.transport.abort()
        await asyncio.sleep(0)

    asyncio.run(run())
