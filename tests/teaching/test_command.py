"""`dream teach` without its page, and how it ends with it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from dream.commands.help import page
from dream.commands.teach import Teach
from dream.extras import missing
from dream.perception import LearnedLabels
from dream.teaching.backbone import TEXTURE
from dream.types import Label
from tests.teaching.lessons import save_masks, save_picture, scene

PLAIN = Path(TEXTURE)
WAIT_S = 120.0


def test_marks_that_are_ready_become_a_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos, masks = save_masks(tmp_path, list(range(6)), [0, 1, 2, 3])
    command = Teach(photos, name="scallop", out=tmp_path / "out", marks=masks, backbone=PLAIN, json=True)
    assert command() == 0
    told = json.loads(capsys.readouterr().out)
    assert told["model"] == str(tmp_path / "out/scallop.onnx")
    assert told["iou_low"] <= told["iou"] <= told["iou_high"]
    assert told["iou"] > 0.85
    assert [one["name"] for one in told["pictures"]] == ["p0", "p1", "p2", "p3"]
    assert told["seconds"] < 10.0
    rgb, inside = scene(5)
    found = LearnedLabels(tmp_path / "out/scallop.onnx").segment(rgb)[0] == Label.TARGET
    assert (found & inside).sum() / (found | inside).sum() > 0.85
    assert not (tmp_path / "out/marks").exists()


def test_with_few_marks_it_promises_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos, masks = save_masks(tmp_path, [0, 1], [0])
    assert Teach(photos, out=tmp_path / "out", marks=masks, backbone=PLAIN)() == 0
    said = capsys.readouterr().out
    assert "was not measured: target is marked in 1 of at least 3 pictures" in said
    assert "IoU" not in said
    assert json.loads((tmp_path / "out/target.card.json").read_text())["iou"] is None


def test_the_same_marks_give_the_same_model(tmp_path: Path) -> None:
    photos, masks = save_masks(tmp_path, [0, 1, 2], [0, 1, 2])
    for out in ("one", "two"):
        Teach(photos, out=tmp_path / out, marks=masks, backbone=PLAIN)()
    assert (tmp_path / "one/target.onnx").read_bytes() == (tmp_path / "two/target.onnx").read_bytes()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"name": "../shell"}, "--name: expected at most 40 letters"),
        ({"pictures": 0}, "--pictures: expected 1 to 200, got 0"),
        ({"port": 70_000}, "--port: expected 0 to 65535"),
        ({"marks": Path("nowhere")}, "--marks: expected a folder, got nowhere"),
        ({"marks": Path()}, "--marks: expected a PNG named as a picture"),
        ({"backbone": Path("nowhere.onnx")}, "expected a readable file, got nowhere.onnx"),
    ],
)
def test_options_that_cannot_be_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fields: dict[str, object], words: str
) -> None:
    photos, _ = save_masks(tmp_path / "all", [0], [0])
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    given: dict[str, object] = {"out": tmp_path / "out", "backbone": PLAIN, **fields}
    with pytest.raises(ValueError, match=words):
        Teach(photos, **given)()  # type: ignore[arg-type]


def test_without_what_it_needs_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_picture(tmp_path / "photos/a.png", scene(0)[0])
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError) as error:
        Teach(tmp_path / "photos", out=tmp_path / "out")()
    assert str(error.value) == missing("teach", "fastapi", "a page to teach on")


def test_help_fits_a_screen() -> None:
    assert len(page("teach", Teach).splitlines()) <= 40


@pytest.mark.slow
def test_ctrl_c_ends_it_and_marks_stay(tmp_path: Path) -> None:
    pytest.importorskip("fastapi")
    save_picture(tmp_path / "photos/p0.png", scene(0)[0])
    lines = (
        "from pathlib import Path; from dream.commands.teach import Teach; import sys; "
        f"sys.exit(Teach(Path('photos'), backbone=Path('{TEXTURE}'), port=0)())"
    )
    words = [sys.executable, "-c", lines]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as command:
        ending = threading.Timer(WAIT_S, command.kill)
        ending.start()
        assert command.stdout is not None
        assert "teach target on 1 pictures at http://127.0.0.1:" in command.stdout.readline()
        assert "marks are kept in teach/photos" in command.stdout.readline()
        command.send_signal(signal.SIGINT)
        # Python loses one that comes just as a lock of an import is let go.
        again = threading.Timer(5.0, command.send_signal, (signal.SIGINT,))
        again.start()
        said = command.stdout.read()
        assert command.wait() == 0
        again.cancel()
        ending.cancel()
    assert "No model was saved. The marks are kept in teach/photos; the same command goes on" in said
