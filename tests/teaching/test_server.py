"""The server of the page: who may ask, what may be posted."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")

from tests.live.flying import Browser
from tests.teaching.teaching import TOKEN, TaughtHead, taught
from tests.teaching.test_session import all_open, until

BOX = {"picture": 0, "tool": "box", "mark": "target", "width": 0.1, "points": [[0.1, 0.1], [0.4, 0.4]]}


@pytest.fixture
def lesson(tmp_path: Path) -> Iterator[TaughtHead]:
    with taught(tmp_path) as found:
        until(found.session, all_open)
        yield found


def opened(lesson: TaughtHead) -> Browser:
    browser = Browser(lesson.port)
    assert browser.open(TOKEN) == 200
    return browser


def test_the_page_holds_nothing_from_elsewhere(lesson: TaughtHead) -> None:
    browser = opened(lesson)
    for path in ("/", "/page.css", "/page.js"):
        status, content = browser.get(path)
        assert status == 200
        text = content.decode().replace("http:%2F%2Fwww.w3.org/2000/svg", "")
        assert "://" not in text, path
        assert "{{" not in text, path


def test_what_is_asked_for_is_told(lesson: TaughtHead) -> None:
    browser = opened(lesson)
    view: dict[str, Any] = json.loads(browser.get("/view")[1])
    assert view["target"] == "shell"
    assert [one["name"] for one in view["pictures"]] == [f"p{n}" for n in range(5)]
    assert view["pictures"][0]["size"] == [480, 360]
    for what, kind in (("shown", b"\xff\xd8"), ("thumb", b"\xff\xd8"), ("marks", b"\x89PNG")):
        status, content = browser.get(f"/pictures/0/{what}")
        assert status == 200
        assert content.startswith(kind)
    for path in ("/pictures/0/labels", "/pictures/9/shown", "/pictures/-1/shown", "/pictures/0/..%2fmarks"):
        assert browser.get(path)[0] == 404


def test_strokes_are_drawn_taken_back_and_cleared(lesson: TaughtHead) -> None:
    browser = opened(lesson)
    path = lesson.session.folder / "marks/p0.png"
    assert browser.post("/draw", BOX) == (204, "")
    assert path.is_file()
    assert browser.post("/back", {"picture": 0}) == (204, "")
    assert not path.exists()
    browser.post("/draw", BOX)
    assert browser.post("/clear", {"picture": 0}) == (204, "")
    assert not path.exists()
    status, said = browser.post("/save", {})
    assert status == 400
    assert "Nothing to save yet: mark some target" in said


@pytest.mark.parametrize(
    ("path", "content", "status"),
    [
        ("/draw", b"no JSON", 400),
        ("/draw", {**BOX, "picture": 77}, 409),
        ("/draw", {**BOX, "mark": "everything"}, 400),
        ("/draw", {**BOX, "points": [[0.5, 0.5]] * 30_000}, 400),
        ("/back", {"picture": -1}, 400),
        ("/back", {"picture": "0; rm"}, 400),
        ("/clear", {}, 400),
        ("/view", {}, 405),
        ("/pictures/0/marks", {}, 405),
    ],
)
def test_what_may_not_be_posted_is_refused(lesson: TaughtHead, path: str, content: Any, status: int) -> None:
    assert opened(lesson).post(path, content)[0] == status


def test_only_its_own_page_may_mark(lesson: TaughtHead) -> None:
    browser = opened(lesson)
    assert browser.post("/draw", BOX, origin="http://elsewhere.example")[0] == 403
    stranger = Browser(lesson.port)
    assert stranger.get("/view")[0] == 401
    assert stranger.post("/draw", BOX)[0] == 401
    assert not any(one["target"] for one in lesson.session.view.told["pictures"])
