"""Whoever is silent, slow or many at the door keeps nobody out who may come in."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")

from dream.live import guests, server
from dream.live.doors import Doors, cookie_name
from dream.live.guests import Guest, House
from dream.live.server import listen, serve

TOKEN = "a-token-of-some-length"
Place = tuple[str, int]


@contextlib.contextmanager
def served(folder: Path) -> Iterator[Place]:
    """A server on this machine that asks for a token."""
    over = threading.Event()
    listening = listen("127.0.0.1", 0)
    place = listening.getsockname()
    doors = Doors("127.0.0.1", TOKEN)
    running = threading.Thread(target=serve, args=([folder], doors, listening, lambda pages: over.is_set()))
    running.start()
    try:
        yield place
    finally:
        over.set()
        running.join()
        listening.close()


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    monkeypatch.setattr(server, "LOOK_S", 0.02)
    monkeypatch.setattr(guests, "ASK_S", 0.15)
    with served(tmp_path) as found:
        yield found


def request(place: Place, *more: str) -> bytes:
    host = f"{place[0]}:{place[1]}"
    cookie = f"Cookie: {cookie_name(host)}={TOKEN}"
    return "\r\n".join(("GET / HTTP/1.1", f"Host: {host}", cookie, *more, "", "")).encode()


def answer(place: Place, *more: str) -> bytes:
    """The first line of what one with the token is answered."""
    with socket.create_connection(place, timeout=5.0) as connection:
        connection.sendall(request(place, *more))
        return connection.makefile("rb").readline()


@contextlib.contextmanager
def silent(place: Place, count: int) -> Iterator[list[socket.socket]]:
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(socket.create_connection(place, timeout=5.0)) for _ in range(count)]


@pytest.mark.parametrize(("count", "most"), [(64, guests.MOST_STRANGERS), (50, 30)])
def test_silent_connections_keep_nobody_out(
    count: int, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Long before they have to go, and where they are more than may wait."""
    monkeypatch.setattr(guests, "MOST_STRANGERS", most)
    monkeypatch.setattr(server, "LOOK_S", 0.02)
    with served(tmp_path) as place, silent(place, count):
        assert answer(place) == b"HTTP/1.1 200 OK\r\n"


def test_those_who_are_refused_keep_no_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "LOOK_S", 0.02)
    with served(tmp_path) as place, silent(place, 20) as strangers:
        for one in strangers:
            one.sendall(request(place).replace(TOKEN.encode(), b"x"))
        for one in strangers:
            said = one.makefile("rb").read()  # To its end: the server closes it.
            assert said.startswith(b"HTTP/1.1 401")
        assert answer(place) == b"HTTP/1.1 200 OK\r\n"


def ends(connection: socket.socket, say: Callable[[], None] = lambda: None) -> float:
    """Seconds until the server ends a connection, to which something is said again and again."""
    began = time.monotonic()
    connection.settimeout(0.02)
    while time.monotonic() - began < 5.0:
        try:
            say()
            if connection.recv(1 << 16) == b"":
                return time.monotonic() - began
        except TimeoutError:
            continue
        except OSError:
            return time.monotonic() - began
    pytest.fail("it was never ended")


SLOW: dict[str, tuple[Callable[[Place], bytes], bytes]] = {
    "nothing": (lambda place: b"", b""),
    "byte by byte": (lambda place: b"GET / HTTP/1.1\r\nX: ", b"x"),
    "header by header": (lambda place: request(place)[:-2], b"X: y\r\n"),
    "a body that never ends": (lambda place: request(place, "Content-Length: 1000000"), b"z"),
    "after an answer": (lambda place: request(place) + b"GET / HT", b"T"),
}


@pytest.mark.parametrize("kind", SLOW)
def test_who_does_not_ask_in_time_has_to_go(kind: str, place: Place) -> None:
    first, then = SLOW[kind]
    with socket.create_connection(place, timeout=5.0) as connection:
        connection.sendall(first(place))
        assert 0.1 < ends(connection, lambda: connection.sendall(then) if then else None) < 10.0


def test_a_head_without_end_is_refused(place: Place) -> None:
    with socket.create_connection(place, timeout=5.0) as connection:
        connection.sendall(request(place)[:-2] + b"X: " + b"y" * (2 * guests.MOST_HEAD))
        assert connection.makefile("rb").readline().startswith(b"HTTP/1.1 400")


# ---- on their own


class _Transport:
    """As much of a connection as a guest needs."""

    def __init__(self) -> None:
        self.gone = False

    def get_extra_info(self, name: str) -> Any:
        return ("127.0.0.1", id(self)) if name == "peername" else None

    def is_closing(self) -> bool:
        return self.gone

    def abort(self) -> None:
        self.gone = True

    close = abort

    def pause_reading(self) -> None: ...

    def resume_reading(self) -> None: ...


def guest(house: House) -> tuple[Guest, _Transport]:
    import uvicorn
    from uvicorn.server import ServerState

    config = uvicorn.Config(lambda: None, log_config=None)
    one = Guest(
        house, config=config, server_state=ServerState(), app_state={}, _loop=asyncio.get_running_loop()
    )
    transport = _Transport()
    one.connection_made(transport)  # type: ignore[arg-type]
    return one, transport


def test_places_are_for_those_who_passed_and_the_longest_at_the_door_goes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(guests, "MOST_STRANGERS", 3)

    async def come() -> None:
        house = House(2)
        found = [guest(house) for _ in range(2)]
        for one, _ in found:
            assert house.admit(one.client)
            assert house.admit(one.client)
        strangers = [guest(house) for _ in range(5)]
        assert not house.admit(strangers[4][0].client)
        # Those that went make room, as asyncio tells them.
        assert strangers[0][1].gone
        assert not any(transport.gone for _, transport in found)
        assert not strangers[4][1].gone
        found[0][0].connection_lost(None)
        assert house.admit(strangers[4][0].client)
        assert house.admit(None)

    asyncio.run(come())


def test_who_takes_nothing_of_what_is_sent_has_to_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guests, "TAKE_S", 0.02)

    async def come() -> None:
        house = House(2)
        (slow, of_slow), (fast, of_fast) = guest(house), guest(house)
        for one in (slow, fast):
            one.pause_writing()
        fast.resume_writing()
        await asyncio.sleep(0.06)
        assert of_slow.gone
        assert not of_fast.gone

    asyncio.run(come())
