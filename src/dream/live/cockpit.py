"""The server of a page at which a person flies: it shows what the helm has to show, and takes its steps."""

from __future__ import annotations

import asyncio
import contextlib
import html
import json
import re
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any

from dream.live.doors import Doorkeeper, Doors, cookie_name
from dream.live.helm import Helmsman, SaidStep, Seat, moves_of
from dream.live.server import MAX_PAGES, NEVER, Admit, host, own_part
from dream.report import fill, part

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp

LOOK_S = 0.04
"""Seconds between two looks at the helm while a page waits for what is new."""
WAIT_S = 5.0
"""Seconds that a page waits at most; then it is told that nothing is new, and asks again."""
MOST_BODY = 1024
"""Bytes of what is posted."""
LINGER_S = 1.5
"""Seconds that the server stays once the mission is over, so that its page hears of it."""
WRITES = frozenset({"/decide", "/take"})
"""What may be posted to."""

_SEAT = re.compile(r"[A-Za-z0-9_-]{22}")


def cockpit(
    helm: Helmsman,
    doors: Doors,
    admit: Admit = lambda client: True,
    closing: Callable[[], bool] = lambda: False,
    seat: Seat | None = None,
) -> ASGIApp:
    """The server without its socket.

    Args:
        helm: Of the mission.
        doors: Who may look; whoever may look, may fly where nobody else does.
        admit: See `server.host`.
        closing: Likewise.
        seat: Who is at the helm; nobody unless given.
    """
    from fastapi import FastAPI
    from fastapi.responses import PlainTextResponse, Response

    seat = seat or Seat()
    page, style, script = _page(helm)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    waiting = 0

    def refused(status: int, why: str) -> Response:
        return PlainTextResponse(f"{why}\n", status, NEVER)

    async def opened(request: Request) -> Response:
        answer = Response(page, headers=NEVER, media_type="text/html")
        if not _who(request):
            # Tells this browser from others; its name holds the port, as that of the token's does.
            name = _cookie_of(request)
            answer.set_cookie(name, secrets.token_urlsafe(16), 604800, httponly=True, samesite="lax")
        return answer

    async def view(request: Request) -> Response:
        nonlocal waiting
        who = _who(request)
        if not who:
            return refused(403, "Open the page first.")
        if waiting >= MAX_PAGES:
            return PlainTextResponse(f"{MAX_PAGES} pages are open already; close one.\n", 503, NEVER)
        has = request.query_params.get("has", "")
        waiting += 1
        try:
            until = time.monotonic() + WAIT_S
            while f"{helm.view.number}-{(at := seat.hear(who))}" == has:
                if closing() or time.monotonic() > until:
                    return Response(status_code=204, headers=NEVER)
                await asyncio.sleep(LOOK_S)
        finally:
            waiting -= 1
        now = helm.view
        told = {**now.told, "number": now.number, "helm": at, "pictures": list(now.pictures)}
        return Response(json.dumps(told, allow_nan=False), headers=NEVER, media_type="application/json")

    async def picture(request: Request) -> Response:
        now = helm.view
        content = now.pictures.get(request.path_params["name"])
        if content is None:
            return refused(404, "There is nothing of that name.")
        return Response(content, headers=NEVER, media_type="image/png")

    async def decide(request: Request) -> Response:
        who = _who(request)
        if not who or seat.hear(who) != "yours":
            return refused(409, "Another page is at the helm.")
        try:
            said = SaidStep.read(await _body(request))
            helm.say(said)
        except ValueError as error:
            return refused(400, str(error))
        except LookupError as error:
            return refused(409, str(error.args[0]))
        return Response(status_code=204, headers=NEVER)

    async def take(request: Request) -> Response:
        who = _who(request)
        if not who or not seat.take(who):
            return refused(409, "Another page is at the helm.")
        return Response(status_code=204, headers=NEVER)

    def fixed(content: str, kind: str) -> Callable[[Request], Any]:
        async def given(request: Request) -> Response:
            return Response(content, headers=NEVER, media_type=kind)

        return given

    app.add_route("/", opened)
    app.add_route("/page.css", fixed(style, "text/css"))
    app.add_route("/page.js", fixed(script, "text/javascript"))
    app.add_route("/view", view)
    app.add_route("/pictures/{number}/{name}", picture)
    app.add_route("/decide", decide, methods=["POST"])
    app.add_route("/take", take, methods=["POST"])
    return Doorkeeper(app, doors, admit, WRITES)


def _page(helm: Helmsman) -> tuple[str, str, str]:
    """HTML, style and script of the page."""
    own = {name: own_part(name) for name in ("fly.html", "fly.css", "fly.js")}
    fixed = html.escape(json.dumps(moves_of(helm.protocol)))
    return (
        fill(own["fly.html"], {"fixed": fixed, "space": "space" if helm.protocol.space else "planar"}),
        part("page.css") + own["fly.css"],
        part("words.js") + part("step.js") + own["fly.js"],
    )


async def _body(request: Request) -> bytes:
    """What was posted; a ValueError where it is too much, however much it says it is."""
    content = b""
    async for chunk in request.stream():
        content += chunk
        if len(content) > MOST_BODY:
            raise ValueError(f"body: expected at most {MOST_BODY} bytes, got more")
    return content


def _cookie_of(request: Request) -> str:
    return f"{cookie_name(request.headers.get('host', ''))}-seat"


def _who(request: Request) -> str:
    """Which browser asks; empty where it was not given a name here yet."""
    try:
        found = SimpleCookie(request.headers.get("cookie", "")).get(_cookie_of(request))
    except CookieError:
        return ""
    return found.value if found and _SEAT.fullmatch(found.value) else ""


@contextlib.contextmanager
def served(helm: Helmsman, doors: Doors, listening: socket.socket) -> Iterator[None]:
    """Serve the page of a helm while the block runs, in a thread of its own, and a little longer.

    Args:
        helm: Of the mission.
        doors: Who may look and fly.
        listening: From `server.listen`; closed at the end.
    """
    over = threading.Event()

    def made(admit: Admit, closing: Callable[[], bool]) -> ASGIApp:
        return cockpit(helm, doors, admit, closing)

    thread = threading.Thread(target=host, args=(made, listening, over.is_set), daemon=True)
    thread.start()
    try:
        yield
    finally:
        with contextlib.suppress(KeyboardInterrupt):
            time.sleep(LINGER_S)
        over.set()
        thread.join()
        listening.close()
