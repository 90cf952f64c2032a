"""A session: what is marked is kept, learned, shown and saved."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream.perception import LearnedLabels
from dream.teaching import session as sessions
from dream.teaching.marks import MarkStroke
from dream.teaching.model import Extractor
from dream.teaching.pictures import Picture, pictures_in
from dream.teaching.session import Session
from dream.types import Label
from tests.teaching.lessons import save_picture, scene, texture

WAIT_S = 60.0
WHOLE = [(0.0, 0.0), (1.0, 1.0)]


@pytest.fixture(scope="module")
def extractor() -> Extractor:
    return texture()


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    for n in range(5):
        save_picture(tmp_path / f"photos/p{n}.png", scene(n)[0])
    return tmp_path / "photos"


@contextlib.contextmanager
def at_work(photos: Path, extractor: Extractor, out: Path) -> Iterator[Session]:
    session = Session(pictures_in(photos), extractor, out, "shell")
    worker = threading.Thread(target=session.work, daemon=True)
    worker.start()
    try:
        yield session
    finally:
        session.end()
        worker.join(WAIT_S)
        assert not worker.is_alive()


def until(session: Session, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    end = time.monotonic() + WAIT_S
    while not wanted(told := session.view.told):
        assert time.monotonic() < end, told
        time.sleep(0.01)
    return told


def all_open(told: dict[str, Any]) -> bool:
    return all(one["open"] or one["lost"] for one in told["pictures"])


def dots(number: int, *, target: bool, every: int = 25) -> Iterator[MarkStroke]:
    """Short strokes on what is target, or on what is not, as far from its edge as a person stays."""
    _, inside = scene(number)
    height, width = inside.shape
    for y in range(12, height - 12, every):
        for x in range(12, width - 12, every):
            around = inside[y - 8 : y + 9, x - 8 : x + 9]
            if around.all() if target else not around.any():
                yield MarkStroke(
                    picture=number,
                    tool="brush",
                    mark="target" if target else "other",
                    width=0.04,
                    points=[((x + 0.5) / width, (y + 0.5) / height)],
                )


def mark(session: Session, *numbers: int) -> None:
    for number in numbers:
        for target in (True, False):
            for stroke in dots(number, target=target):
                session.draw(stroke)


@pytest.mark.slow
def test_what_is_marked_is_learned_shown_measured_and_saved(
    photos: Path, extractor: Extractor, tmp_path: Path
) -> None:
    with at_work(photos, extractor, tmp_path / "out") as session:
        assert until(session, all_open)["lacks"] == "mark some target"
        with pytest.raises(ValueError, match="Nothing to save yet: mark some target"):
            session.save()
        mark(session, 0, 1)
        told = until(session, lambda told: told["quality"] is not None)
        assert told["quality"]["iou"] is None
        assert "2 of at least 3 pictures" in told["quality"]["why"]
        mark(session, 2)
        told = until(session, lambda told: bool(told["quality"] and told["quality"]["iou"]))
        assert told["quality"]["iou"] > 0.8
        assert [one["iou"] is not None for one in told["pictures"]] == [True] * 3 + [False] * 2
        assert all(one["unsure"] is not None for one in told["pictures"])
        session.save()
        assert session.view.told["saved"] == str(tmp_path / "out/shell.onnx")
        labels = LearnedLabels(tmp_path / "out/shell.onnx")
        for number in range(5):
            shown = session.picture(number, "labels")
            assert shown is not None
            (tmp_path / "labels.png").write_bytes(shown[0])
            painted = np.asarray(Image.open(tmp_path / "labels.png").convert("RGBA"))[..., 3] > 0
            told_so = labels.segment(scene(number)[0])[0] == Label.TARGET
            np.testing.assert_array_equal(painted, told_so)


@pytest.mark.slow
def test_marks_survive_and_the_same_folder_goes_on(
    photos: Path, extractor: Extractor, tmp_path: Path
) -> None:
    with at_work(photos, extractor, tmp_path / "out") as session:
        until(session, all_open)
        mark(session, 0, 3)
        first = session.picture(3, "marks")
    with at_work(photos, extractor, tmp_path / "out") as session:
        told = until(session, lambda told: all_open(told) and told["quality"] is not None)
        assert [one["target"] for one in told["pictures"]] == [True, False, False, True, False]
        assert session.picture(3, "marks") == first
        assert told["lacks"] == ""


def test_the_last_strokes_are_taken_back_on_disk_too(
    photos: Path, extractor: Extractor, tmp_path: Path
) -> None:
    path = tmp_path / "out/marks/p0.png"
    box = MarkStroke(picture=0, tool="box", mark="target", width=0.1, points=WHOLE)
    with at_work(photos, extractor, tmp_path / "out") as session:
        until(session, all_open)
        session.draw(box)
        kept = path.read_bytes()
        session.clear(0)
        assert not path.exists()
        assert session.back(0)
        assert path.read_bytes() == kept
        assert session.back(0)
        assert not path.exists()
        assert not session.back(0)


def test_marks_that_cannot_be_kept_are_not_shown(
    photos: Path, extractor: Extractor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError("could not write (No space left on device)")

    with at_work(photos, extractor, tmp_path / "out") as session:
        until(session, all_open)
        monkeypatch.setattr(sessions, "write_marks", full)
        with pytest.raises(OSError, match="No space left"):
            session.draw(MarkStroke(picture=0, tool="box", mark="target", width=0.1, points=WHOLE))
        assert not session.view.told["pictures"][0]["target"]


@pytest.mark.filterwarnings("ignore")
def test_a_picture_that_cannot_be_read_stops_nothing(
    photos: Path, extractor: Extractor, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (photos / "p1.png").write_bytes(b"no picture")
    with at_work(photos, extractor, tmp_path / "out") as session:
        told = until(session, all_open)
        assert "expected a picture" in told["pictures"][1]["lost"]
        assert session.picture(1, "shown") is None
        with pytest.raises(LookupError):
            session.draw(MarkStroke(picture=1, tool="box", mark="target", width=0.1, points=WHOLE))
        mark(session, 0)
        until(session, lambda told: told["quality"] is not None)


def test_the_picture_that_somebody_waits_for_is_opened_first(
    tmp_path: Path, extractor: Extractor, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    going = threading.Event()
    opened = Picture.open

    def noted(picture: Picture) -> Any:
        order.append(picture.name)
        if len(order) == 1:
            going.wait(WAIT_S)
        return opened(picture)

    monkeypatch.setattr(Picture, "open", noted)
    for n in range(4):
        save_picture(tmp_path / f"photos/p{n}.png", scene(n)[0])
    with at_work(tmp_path / "photos", extractor, tmp_path / "out") as session:
        assert session.picture(3, "shown") is None
        going.set()
        until(session, all_open)
    assert order == ["p0", "p3", "p1", "p2"]


def test_there_is_nothing_of_other_names_or_numbers(
    photos: Path, extractor: Extractor, tmp_path: Path
) -> None:
    with at_work(photos, extractor, tmp_path / "out") as session:
        until(session, all_open)
        assert session.picture(0, "labels") is None
        assert session.picture(-1, "shown") is None
        assert session.picture(99, "shown") is None
        assert session.picture(0, "passwords") is None
        with pytest.raises(LookupError):
            session.back(99)
