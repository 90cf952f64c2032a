"""The server of a page on which a target is taught: it shows pictures, takes strokes, and saves the model."""

from __future__ import annotations

import asyncio
import contextlib
import html
import json
import re
import socket
import threading
import time
from collections.abc import Callable
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dream.live.doors import Doorkeeper, Doors
from dream.live.server import FOR_EVER, MAX_PAGES, NEVER, Admit, host
from dream.report import fill, part
from dream.teaching.marks import OTHER, TARGET, MarkStroke
from dream.teaching.session import COLORS, Session

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp

LOOK_S = 0.03
"""Seconds between two looks at the session while a page waits for what is new."""
WAIT_S = 5.0
"""Seconds that a page waits at most; then it is told that nothing is new, and asks again."""
MOST_BODY = 256 << 10
"""Bytes of what is posted: a long stroke has a hundred thousand."""
WRITES = frozenset({"/draw", "/back", "/clear", "/save"})
"""What may be posted to."""
WHAT = ("shown", "thumb", "marks", "labels", "small")
"""Of a picture: itself and small; its marks; what it is labelled as, and that small."""


class _Which(BaseModel):
    model_config = ConfigDict(extra="forbid")

    picture: Annotated[int, Field(ge=0, le=100_000)]


def page_of(
    session: Session,
    doors: Doors,
    admit: Admit = lambda client: True,
    closing: Callable[[], bool] = lambda: False,
) -> ASGIApp:
    """The server without its socket.

    Args:
        session: What is taught.
        doors: Who may look; whoever may look, may mark.
        admit: See `dream.live.server.host`.
        closing: Likewise.
    """
    from fastapi import FastAPI
    from fastapi.responses import PlainTextResponse, Response

    page, style, script = _page(session)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    waiting = 0

    def refused(status: int, why: str) -> Response:
        return PlainTextResponse(f"{why}\n", status, NEVER)

    async def view(request: Request) -> Response:
        nonlocal waiting
        if waiting >= MAX_PAGES:
            return refused(503, f"{MAX_PAGES} pages are open already; close one.")
        has = request.query_params.get("has", "")
        waiting += 1
        try:
            until = time.monotonic() + WAIT_S
            while str(session.view.number) == has:
                if closing() or time.monotonic() > until:
                    return Response(status_code=204, headers=NEVER)
                await asyncio.sleep(LOOK_S)
        finally:
            waiting -= 1
        now = session.view
        told = json.dumps({**now.told, "number": now.number}, allow_nan=False)
        return Response(told, headers=NEVER, media_type="application/json")

    async def picture(request: Request) -> Response:
        number, what = request.path_params["number"], request.path_params["what"]
        found = None
        if re.fullmatch(r"[0-9]{1,6}", number) and what in WHAT:
            found = await asyncio.to_thread(session.picture, int(number), what)
        if found is None:
            return refused(404, "There is nothing of that name yet.")
        content, kind = found
        keeps = FOR_EVER if what in ("shown", "thumb") else NEVER
        return Response(content, headers=keeps, media_type=kind)

    def posted(act: Callable[[bytes], None]) -> Callable[[Request], Any]:
        async def answer(request: Request) -> Response:
            try:
                body = await _body(request)
                await asyncio.to_thread(act, body)
            except LookupError as error:
                return refused(409, str(error.args[0]))
            except ValueError as error:
                return refused(400, str(error))
            except OSError as error:
                return refused(507, str(error))
            return Response(status_code=204, headers=NEVER)

        return answer

    def draw(body: bytes) -> None:
        session.draw(MarkStroke.read(body))

    def back(body: bytes) -> None:
        session.back(_which(body))

    def clear(body: bytes) -> None:
        session.clear(_which(body))

    def save(body: bytes) -> None:
        session.save()

    def fixed(content: str, kind: str) -> Callable[[Request], Any]:
        async def given(request: Request) -> Response:
            return Response(content, headers=NEVER, media_type=kind)

        return given

    app.add_route("/", fixed(page, "text/html"))
    app.add_route("/page.css", fixed(style, "text/css"))
    app.add_route("/page.js", fixed(script, "text/javascript"))
    app.add_route("/view", view)
    app.add_route("/pictures/{number}/{what}", picture)
    for path, act in (("/draw", draw), ("/back", back), ("/clear", clear), ("/save", save)):
        app.add_route(path, posted(act), methods=["POST"])
    return Doorkeeper(app, doors, admit, WRITES)


def _page(session: Session) -> tuple[str, str, str]:
    """HTML, style and script of the page."""
    own = {name: _own_part(name) for name in ("teach.html", "teach.css", "teach.js")}
    colors = {"target": COLORS[TARGET], "other": COLORS[OTHER]}
    fixed = html.escape(json.dumps({"colors": colors}))
    return (
        fill(own["teach.html"], {"fixed": fixed, "target": html.escape(session.name)}),
        part("page.css") + own["teach.css"],
        own["teach.js"],
    )


def _own_part(name: str) -> str:
    return resources.files("dream").joinpath("teaching/page", name).read_text(encoding="utf-8")


def _which(body: bytes) -> int:
    try:
        return _Which.model_validate_json(body).picture
    except ValidationError as error:
        raise ValueError(f"picture: {error.errors()[0]['msg'][:200]}") from error


async def _body(request: Request) -> bytes:
    """What was posted; a ValueError where it is too much, however much it says it is."""
    content = b""
    async for chunk in request.stream():
        content += chunk
        if len(content) > MOST_BODY:
            raise ValueError(f"body: expected at most {MOST_BODY} bytes, got more")
    return content


def serve(session: Session, doors: Doors, listening: socket.socket, over: Callable[[], bool]) -> None:
    """Show the page of a session, whose worker works meanwhile, until `over` says so or an interrupt comes.

    Args:
        session: What is taught; it is ended.
        doors: Who may look and mark.
        listening: From `dream.live.server.listen`; closed at the end.
        over: Asked every so often whether it is time to end.
    """

    def made(admit: Admit, closing: Callable[[], bool]) -> ASGIApp:
        return page_of(session, doors, admit, closing)

    worker = threading.Thread(target=session.work, daemon=True)
    try:
        with contextlib.closing(listening):
            worker.start()
            host(made, listening, over)
    finally:
        session.end()
        if worker.is_alive():
            worker.join()
