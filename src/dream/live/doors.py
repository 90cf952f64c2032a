"""Who may look: requests for this server, from pages of this server, by those who know the token."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Callable, Iterable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN_LENGTH = 16
"""Characters of a token at least."""
COOKIE = "dream-watch"
"""How the names of our cookies begin; see `cookie_name`."""

_PLAIN = re.compile(r"[!#-+\--:<-\[\]-~]+")  # What RFC 6265 allows in a cookie.

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


@dataclass(frozen=True, slots=True)
class Doors:
    """Where the server listens, and what a page has to bring.

    A name of another server that leads here (DNS rebinding) is not answered: only addresses in numbers and
    names of this machine are.
    """

    host: str = "127.0.0.1"
    """Address or name that is listened at."""
    token: str = ""
    """What a page brings once in its address, and then as a cookie. May be empty at a loopback address."""

    def __post_init__(self) -> None:
        if not self.token and not is_loopback(self.host):
            raise ValueError(f"token: expected one where others can connect, got none for {self.host}")
        if self.token and (len(self.token) < TOKEN_LENGTH or not _PLAIN.fullmatch(self.token)):
            raise ValueError(
                f"token: expected at least {TOKEN_LENGTH} plain characters, no space, comma, semicolon, "
                "quote or backslash, got fewer or others"
            )

    def answers_to(self, header: str) -> bool:
        """Whether a request for this host, as its header names it, is meant for this server."""
        name = header.rsplit(":", 1)[0] if not header.endswith("]") else header
        name = name.strip("[]").lower().rstrip(".")
        address = _address(name)
        if is_loopback(self.host):
            return name == "localhost" or (address is not None and address.is_loopback)
        machine = socket.gethostname().lower()
        return address is not None or name in (self.host.lower(), "localhost", machine, f"{machine}.local")

    def knows(self, token: str) -> bool:
        """Whether this is the token, in a time that does not tell how much of it is right."""
        return not self.token or hmac.compare_digest(token.encode(), self.token.encode())


def made_token() -> str:
    """A new token that nobody can guess."""
    return secrets.token_urlsafe(24)


def cookie_name(header: str) -> str:
    """The cookie's name at a host as its header names it.

    Cookies of one host are shared over its ports, also those of other servers behind a tunnel: with the port
    in its name, two pages that are watched at once do not lock each other out.
    """
    port = re.search(r":([0-9]{1,5})$", header)
    return f"{COOKIE}-{port[1] if port else 80}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to a host."""
    address = _address(host)
    return host == "localhost" if address is None else address.is_loopback


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


class Doorkeeper:
    """Lets requests through to an application, or answers them itself with a line of text."""

    def __init__(
        self,
        app: ASGIApp,
        doors: Doors,
        admit: Callable[[Any], bool],
        writes: frozenset[str] = frozenset(),
    ) -> None:
        """Before an application; `writes` are the paths that something may be posted to."""
        self._app = app
        self._doors = doors
        self._admit = admit
        self._writes = writes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            return
        headers = _headers(scope["headers"])
        refused = self._refused(scope, headers)
        if refused is None and not self._admit(scope.get("client")):
            refused = 503, "Too many are connected already; close a page.\n", {"retry-after": "5"}
        if refused is None:
            await self._app(scope, receive, _with_headers(send))
            return
        status, text, extra = refused
        if status >= 400:
            extra = {**extra, "connection": "close"}  # Nobody who was refused keeps a place.
        body = text.encode()
        await send({"type": "http.response.start", "status": status, "headers": [
            (b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store"),
            (b"content-length", str(len(body)).encode()), *_raw(_HEADERS), *_raw(extra),
        ]})  # fmt: skip
        await send({"type": "http.response.body", "body": b"" if scope["method"] == "HEAD" else body})

    def _refused(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str, dict[str, str]] | None:
        """Status, text and headers of an answer; None where the application answers."""
        if not self._doors.answers_to(headers.get("host", "")):
            return 421, "This server is not the one that was asked for.\n", {}
        posts = scope["method"] == "POST" and scope["path"] in self._writes
        if not posts and scope["method"] not in ("GET", "HEAD"):
            return 405, "There is nothing to change here.\n", {"allow": "GET, HEAD"}
        # Every browser says of what is posted which page posts it, and no page can say so of another.
        if posts and headers.get("origin") != f"http://{headers.get('host', '')}":
            return 403, "Only the page of this server may do that: expected its address as Origin.\n", {}
        # A page of another server may link to this one; it may neither use nor exhaust it.
        site = headers.get("sec-fetch-site", "none")
        if scope["path"] != "/" and site not in ("same-origin", "none"):
            return 403, "Only the page of this server may ask for that.\n", {}
        if not self._doors.token:
            return None
        name = cookie_name(headers.get("host", ""))
        brought = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if brought and scope["path"] == "/" and self._doors.knows(brought):
            # From now on a cookie stands for it, and the address no longer shows it.
            cookie = f"{name}={brought}; HttpOnly; SameSite=Lax; Path=/; Max-Age=604800"
            return 303, "", {"location": "/", "set-cookie": cookie}
        if self._doors.knows(_cookie(headers.get("cookie", ""), name)):
            return None
        return 401, "This page needs its token: open the address that was printed with it.\n", {}


def _headers(raw: Iterable[tuple[bytes, bytes]]) -> dict[str, str]:
    return {name.decode("latin-1"): value.decode("latin-1") for name, value in raw}


def _raw(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode(), value.encode()) for name, value in headers.items()]


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return found.value if found else ""


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers: MutableMapping[str, Any] = message
            headers["headers"] = [*message.get("headers", []), *_raw(_HEADERS)]
        await send(message)

    return sent
