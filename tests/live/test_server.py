from __future__ import annotations

import asyncio
import contextlib
import io
import json
import logging
import re
import socket
import time
from collections.abc import Callable, Iterator, MutableMapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("fastapi")
pytest.importorskip("httpx")
pytest.importorskip("uvicorn")

import uvicorn
from starlette.testclient import TestClient

from dream.live import folders, server
from dream.live.doors import COOKIE, Doors
from dream.live.folders import Watched
from dream.live.server import Pages, address, application, listen, serve
from dream.live.stream import Cursor
from dream.types import Label
from tests.live.runs import STEPS, Growing

Make = Callable[..., Growing]
TOKEN = "a-token-of-some-length"


@pytest.fixture
def run(growing: Make) -> Growing:
    return growing().write(STEPS)


@pytest.fixture
def pages(run: Growing) -> Pages:
    watched = Watched([run.folder])
    watched.look()
    return Pages(watched)


@pytest.fixture
def client(pages: Pages) -> TestClient:
    return TestClient(application(pages, Doors()), base_url="http://localhost:8412", follow_redirects=False)


@pytest.fixture
def guarded(pages: Pages) -> TestClient:
    doors = Doors("0.0.0.0", TOKEN)
    return TestClient(application(pages, doors), base_url="http://10.0.0.1:8412", follow_redirects=False)


@pytest.fixture
def base(pages: Pages) -> str:
    (run,) = pages.watched
    return f"/runs/{run.key}"


async def streamed(
    app: Any, path: str, *, headers: dict[str, str] | None = None, until: Callable[[bytes], bool]
) -> tuple[int, bytes]:
    """Status and body of a stream, whose page goes as soon as it has what it wants."""
    body, status, done = b"", 0, asyncio.Event()

    async def receive() -> dict[str, Any]:
        await done.wait()
        return {"type": "http.disconnect"}

    async def send(message: dict[str, Any]) -> None:
        nonlocal body, status
        status = message.get("status", status)
        body += message.get("body", b"")
        if until(body):
            done.set()
            await asyncio.sleep(0)

    path, _, query = path.partition("?")
    raw = [(b"host", b"localhost"), *((k.encode(), v.encode()) for k, v in (headers or {}).items())]
    scope = {"type": "http", "method": "GET", "path": path, "query_string": query.encode(), "headers": raw}
    await asyncio.wait_for(app({**scope, "http_version": "1.1", "root_path": ""}, receive, send), 10.0)
    return status, body


def indices(body: bytes) -> list[int]:
    return [int(found) for found in re.findall(rb'"index":(\d+)', body)]


# ---- what it gives


def test_the_page_may_load_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/")
    assert page.status_code == 200
    policy = page.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:")
    assert "unsafe" not in policy
    loads = re.findall(r'(?:src|href)="([^"]*)"', page.text)
    assert {"/page.css", "/page.js"} <= set(loads)
    assert all(load in ("/page.css", "/page.js") or load.startswith(("#", "data:")) for load in loads)
    for part in loads[:3]:
        if part.startswith("/"):
            text = client.get(part).text
            assert not re.search(r"https?://(?!www\.w3\.org/)|innerHTML|eval\(|@import", text)


def test_there_is_no_other_page(client: TestClient) -> None:
    for path in ("/docs", "/redoc", "/openapi.json", "/report.html", "/config.json", "/page", "/runs"):
        assert client.get(path).status_code == 404


def test_nothing_can_be_changed(client: TestClient, base: str) -> None:
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"):
        assert client.request(method, f"{base}/0/map").status_code == 405
    assert client.head("/").status_code in (200, 405)


def test_pictures_are_those_of_the_run(client: TestClient, base: str, run: Growing) -> None:
    for what, name in (("rgb", "frames/0003_rgb.png"), ("map", "maps/0003.png")):
        given = client.get(f"{base}/3/{what}")
        assert given.content == (run.folder / name).read_bytes()
        assert given.headers["content-type"] == "image/png"
        assert given.headers["x-content-type-options"] == "nosniff"


def test_depth_and_labels_come_as_levels(client: TestClient, base: str, run: Growing) -> None:
    def levels(what: str) -> np.ndarray:
        with Image.open(io.BytesIO(client.get(f"{base}/3/{what}").content)) as image:
            assert image.mode == "L"
            return np.asarray(image)

    with Image.open(run.folder / "frames/0003_depth.png") as depth:
        millimetres = np.asarray(depth).astype(int)
    assert np.abs(100 * levels("depth").astype(int) - millimetres).max() <= 50
    with Image.open(run.folder / "frames/0003_labels.png") as labels:
        assert (levels("labels") == np.asarray(labels)).all()
    assert set(np.unique(levels("labels"))) <= set(Label)


def test_what_was_asked_is_given_with_its_pictures(pages: Pages, client: TestClient, base: str) -> None:
    (run,) = pages.watched
    assert client.get(f"{base}/1/asked").json() == []
    (run.folder / "replies").mkdir()
    kept = {
        **dict.fromkeys(("prompt", "model", "question", "fallback"), ""),
        **dict.fromkeys(("requests", "tokens_in", "tokens_out", "seconds"), 1),
        "pictures": [],
        "replies": ["<b>"],
        "cost_usd": None,
    }
    (run.folder / "replies/0001.json").write_text(json.dumps(kept))
    (exchange,) = client.get(f"{base}/1/asked").json()
    assert exchange["replies"] == ["<b>"]


# ---- what it does not give


@pytest.mark.parametrize(
    "path",
    ["99/map", "-1/map", "0/config.json", "0/steps.jsonl", "0/..%2fconfig.json", "..%2f..%2f0/map",
     "0/map.png", "0/%2e%2e/config.json", "0x1/map", "1e0/map", "٣/map", "000000000003/map", "0/", "0"],
)  # fmt: skip
def test_nothing_but_pictures_of_recorded_steps_is_given(client: TestClient, base: str, path: str) -> None:
    assert client.get(f"{base}/{path}").status_code == 404


def test_a_run_that_is_not_watched_is_not_given(client: TestClient) -> None:
    for key in ("00000000", "..", "run", "%2e%2e"):
        assert client.get(f"/runs/{key}/0/map").status_code == 404


def test_a_picture_is_given_once_its_step_is_recorded(growing: Make) -> None:
    made = growing().write(2)
    watched = Watched([made.folder])
    watched.look()
    (run,) = watched
    client = TestClient(application(Pages(watched), Doors()), base_url="http://localhost")
    assert (made.folder / "maps/0002.png").exists()
    assert client.get(f"/runs/{run.key}/2/map").status_code == 404
    made.write()
    watched.look()
    assert client.get(f"/runs/{run.key}/2/map").status_code == 200


def test_damaged_pictures_are_missing_and_the_others_are_there(
    client: TestClient, base: str, run: Growing, caplog: pytest.LogCaptureFixture
) -> None:
    (run.folder / "frames/0001_rgb.png").write_bytes(b"<html>no picture</html>")
    depth = run.folder / "frames/0001_depth.png"
    depth.write_bytes(depth.read_bytes()[:200])
    (run.folder / "frames/0001_labels.png").unlink()
    with caplog.at_level(logging.WARNING):
        answers = {
            what: client.get(f"{base}/1/{what}").status_code for what in ("rgb", "depth", "labels", "map")
        }
    assert answers == {"rgb": 404, "depth": 404, "labels": 404, "map": 200}
    assert client.get(f"{base}/2/rgb").status_code == 200


def test_a_link_out_of_the_folder_is_not_given(
    client: TestClient, base: str, run: Growing, tmp_path: Path
) -> None:
    secret = tmp_path / "secret.png"
    (run.folder / "frames/0001_rgb.png").rename(secret)
    (run.folder / "frames/0001_rgb.png").symlink_to(secret)
    assert client.get(f"{base}/1/rgb").status_code == 404


# ---- who may look


def test_a_name_of_another_server_is_not_answered(client: TestClient, base: str) -> None:
    for path in ("/", "/events", f"{base}/0/map"):
        answer = client.get(path, headers={"host": "evil.example"})
        assert answer.status_code == 421
        assert "evil" not in answer.text


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_pages_of_others_may_link_but_not_use(client: TestClient, base: str, site: str) -> None:
    headers = {"sec-fetch-site": site}
    assert client.get("/", headers=headers).status_code == 200
    for path in ("/events", "/page.js", f"{base}/0/map"):
        assert client.get(path, headers=headers).status_code == 403
    assert client.get(f"{base}/0/map", headers={"sec-fetch-site": "same-origin"}).status_code == 200


def test_with_a_token_nothing_is_given_without_it(guarded: TestClient, base: str) -> None:
    for path in (
        "/",
        "/page.js",
        "/events",
        f"{base}/0/map",
        "/?token=",
        "/?token=wrong",
        f"/page.js?token={TOKEN}",
    ):
        answer = guarded.get(path)
        assert answer.status_code == 401, path
        assert TOKEN not in answer.text + str(answer.headers)
    assert guarded.get("/", headers={"cookie": f"{COOKIE}-8412=wrong"}).status_code == 401
    assert guarded.get("/", headers={"cookie": "x" * 4000}).status_code == 401


def test_pages_of_two_ports_of_a_host_do_not_lock_each_other_out(pages: Pages) -> None:
    # A browser sends the cookies of a host to all its ports.
    cookies: dict[str, str] = {}
    for port, token in ((8000, TOKEN), (8001, TOKEN[::-1])):
        client = TestClient(application(pages, Doors(token=token)), base_url=f"http://127.0.0.1:{port}")
        entered = client.get(f"/?token={token}", follow_redirects=False)
        name, value = entered.headers["set-cookie"].split(";")[0].split("=", 1)
        cookies[name] = value
    for port, token in ((8000, TOKEN), (8001, TOKEN[::-1])):
        client = TestClient(application(pages, Doors(token=token)), base_url=f"http://127.0.0.1:{port}")
        header = "; ".join(f"{name}={value}" for name, value in cookies.items())
        assert client.get("/", headers={"cookie": header}).status_code == 200


def test_the_token_becomes_a_cookie_that_scripts_cannot_read(guarded: TestClient, base: str) -> None:
    entered = guarded.get(f"/?token={TOKEN}")
    assert entered.status_code == 303
    assert entered.headers["location"] == "/"
    assert "HttpOnly" in entered.headers["set-cookie"]
    assert "SameSite=Lax" in entered.headers["set-cookie"]
    assert guarded.get("/").status_code == 200
    assert guarded.get(f"{base}/0/map").status_code == 200
    assert TOKEN not in guarded.get("/").text


@pytest.mark.parametrize("token", ["q+8/Rt%2B&x=1#Zw==", "!#$%&'()*+-./:<=>?@[]^_`{|}~"])
def test_any_token_that_is_taken_opens_the_door_by_the_address_that_is_told(pages: Pages, token: str) -> None:
    doors = Doors("0.0.0.0", token)
    client = TestClient(application(pages, doors), base_url="http://10.0.0.1", follow_redirects=False)
    with listen("0.0.0.0", 0) as listening:
        query = address(doors, listening).partition("/?")[2]
    assert client.get(f"/?{query}").status_code == 303
    assert client.get("/").status_code == 200


# ---- the stream


def test_a_stream_brings_a_page_up_to_date_and_keeps_it_there(pages: Pages, growing: Make) -> None:
    made = growing("another").write(2)
    pages.watched = Watched([made.folder])
    app = application(pages, Doors())

    def until(body: bytes) -> bool:
        if made.written < STEPS and b"event: beat" in body:
            made.write()
        return indices(body)[-1:] == [STEPS - 1] and body.endswith(b"\n\n")

    status, body = asyncio.run(streamed(app, "/events", until=until))
    assert status == 200
    assert indices(body) == list(range(STEPS))
    assert pages.open == 0


def test_a_long_run_is_told_of_as_it_is_read_and_between_two_looks_nobody_works(
    growing: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = growing("long").write(STEPS)
    monkeypatch.setattr(folders, "READ_BYTES", max(map(len, made.lines)) + 1)
    monkeypatch.setattr(server, "LOOK_S", 0.05)
    rounds = 0
    news = Cursor.news

    def counted(cursor: Cursor, watched: Watched) -> Iterator[bytes]:
        nonlocal rounds
        rounds += 1
        return news(cursor, watched)

    monkeypatch.setattr(Cursor, "news", counted)
    app = application(Pages(Watched([made.folder])), Doors())
    _, body = asyncio.run(streamed(app, "/events", until=lambda body: b"event: beat" in body))
    assert indices(body) == list(range(STEPS))
    assert rounds <= 4 * STEPS


def test_a_page_that_comes_back_says_where_it_was(pages: Pages) -> None:
    app = application(pages, Doors())
    (run,) = pages.watched

    def until(body: bytes) -> bool:
        return b"event: beat" in body

    was = {"last-event-id": f"{run.key}.4"}
    _, body = asyncio.run(streamed(app, f"/events?have={run.key}.1", headers=was, until=until))
    assert indices(body) == [4, 5]
    _, body = asyncio.run(streamed(app, f"/events?open={run.key}&have={run.key}.5", until=until))
    assert indices(body) == [5]
    assert b'"reasoning"' in body


def test_too_many_pages_are_turned_away_and_let_in_when_one_goes(
    pages: Pages, client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_PAGES", 1)
    app = application(pages, Doors())

    async def two() -> tuple[int, int]:
        refused = 0

        async def other() -> None:
            nonlocal refused
            refused, _ = await streamed(app, "/events", until=lambda body: True)

        tasks: list[asyncio.Task[None]] = []

        def until(body: bytes) -> bool:
            if not tasks:
                tasks.append(asyncio.create_task(other()))
            return refused != 0

        first, _ = await streamed(app, "/events", until=until)
        return first, refused

    monkeypatch.setattr(server, "BEAT_S", 0.0)
    assert asyncio.run(two()) == (200, 503)
    status, _ = asyncio.run(streamed(app, "/events", until=lambda body: b"beat" in body))
    assert status == 200


def test_a_look_goes_on_alone_when_the_page_goes_that_waits_for_it(
    pages: Pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is read is read by one at a time, and those who come meanwhile wait for it."""
    looks: list[int] = []
    under_way = 0

    def slow(watched: Watched) -> None:
        nonlocal under_way
        under_way += 1
        looks.append(under_way)
        time.sleep(0.3)
        under_way -= 1

    monkeypatch.setattr(Watched, "look", slow)

    async def come_and_go() -> None:
        for _ in range(3):
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(pages.look(), 0.05)
        await pages.look()

    asyncio.run(come_and_go())
    assert looks == [1]


def test_a_page_that_takes_too_long_is_let_go(pages: Pages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "SEND_S", 0.05)
    app = application(pages, Doors())

    async def stuck() -> None:
        async def receive() -> dict[str, Any]:
            await asyncio.Event().wait()
            return {}

        async def send(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.body":
                assert pages.open == 1
                await asyncio.Event().wait()

        scope = {"type": "http", "method": "GET", "path": "/events", "query_string": b"", "root_path": ""}
        await app({**scope, "headers": [(b"host", b"localhost")], "http_version": "1.1"}, receive, send)

    asyncio.run(asyncio.wait_for(stuck(), 5.0))
    assert pages.open == 0


def test_a_stream_ends_by_itself_so_that_a_page_has_to_come_back(
    pages: Pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "LIFE_S", 0.01)
    status, body = asyncio.run(streamed(application(pages, Doors()), "/events", until=lambda body: False))
    assert status == 200
    assert indices(body) == list(range(STEPS))


def test_a_run_that_is_not_there_yet_is_waited_for(
    growing: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "LIST_S", 0.0)
    app = application(Pages(Watched([tmp_path / "runs" / "later"])), Doors())
    made: list[Growing] = []

    def until(body: bytes) -> bool:
        if not made and b"event: beat" in body:
            assert b'"waiting":["later"]' in body
            made.append(growing("later").write(1))
        return bool(indices(body))

    _, body = asyncio.run(streamed(app, "/events", until=until))
    assert indices(body) == [0]


# ---- where it listens


def test_a_connection_that_comes_while_it_ends_is_closed(
    run: Growing, monkeypatch: pytest.MonkeyPatch
) -> None:
    listening = listen("127.0.0.1", 0)
    place = listening.getsockname()
    late: list[socket.socket] = []
    shutdown = uvicorn.Server.shutdown

    async def shutdown_as_one_comes(ending: uvicorn.Server, sockets: list[socket.socket]) -> None:
        late.append(socket.create_connection(place, timeout=5.0))
        for _ in range(3):
            await asyncio.sleep(0)  # It is accepted, but not yet among the server's connections.
        await shutdown(ending, sockets)

    monkeypatch.setattr(uvicorn.Server, "shutdown", shutdown_as_one_comes)
    serve([run.folder], Doors(), listening, lambda pages: True)
    (connection,) = late
    with connection, contextlib.suppress(ConnectionResetError):
        assert connection.recv(1) == b""


def test_the_usual_port_gives_way_and_one_that_was_asked_for_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setattr(server, "PORT", port)
        with listen("127.0.0.1", None) as other:
            assert other.getsockname()[1] != port
            assert address(Doors(), other) == f"http://127.0.0.1:{other.getsockname()[1]}/"
        with pytest.raises(OSError, match="--host, --port: expected a place to listen at"):
            listen("127.0.0.1", port)
    with pytest.raises(OSError, match="--host, --port"):
        listen("no-such-host.invalid", None)


def test_the_address_holds_the_token_that_a_page_has_to_bring() -> None:
    with listen("0.0.0.0", 0) as listening:
        assert address(Doors("0.0.0.0", TOKEN), listening).endswith(f"/?token={TOKEN}")
