"""All of it in order, small: the same network again, and the folder goes on where it was."""

from __future__ import annotations

import hashlib
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

from dream.evaluation.machine import source
from dream.extras import missing
from dream.learning.curriculum import CARD, MODEL, Curriculum, Progress, learn, missions
from dream.learning.network import Network
from dream.learning.rollouts import Lesson
from dream.learning.training import Training
from dream.planning.baselines.uivnav import opened
from tests.learning.engines import Inline

TINY = Curriculum(
    missions=2,
    more=1,
    rounds=1,
    steps=8,
    held_out=1,
    trials=1,
    horizon=6,
    temperatures=(1.0,),
    network=Network(channels=(4, 4, 4, 4), hidden=8),
    training=Training(epochs=2, batch=4),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("train")
    list(learn(TINY, made, Inline(), "cpu"))
    return made


def lessons_of(engine: Inline) -> list[Any]:
    return [item for item in engine.ran if isinstance(item, Lesson)]


def test_it_leaves_a_network_that_flies_and_its_card(folder: Path) -> None:
    card = json.loads((folder / CARD).read_text())
    model = (folder / MODEL).read_bytes()
    assert card["sha256"] == hashlib.sha256(model).hexdigest()
    assert card["bytes"] == len(model)
    told = "dream train uivnav --missions 2 --more 1 --steps 8 --trials 1 --epochs 2"
    assert card["command"].startswith(told)
    assert card["turns_deg"] == [-90, -60, -30, 0, 30, 60, 90]
    assert [entry["frames"] for entry in card["rounds"]] == [10, 15]
    rows = card["trials"]["rows"]
    assert list(rows) == ["random", "lawnmower", "teacher", "student 0 at 1", "student 1 at 1"]
    best = max(("student 0 at 1", "student 1 at 1"), key=lambda name: rows[name]["share"])
    assert card["chosen"].startswith(f"round {best.split()[1]} ")
    opened(str(folder / MODEL))


def test_the_student_flies_the_second_round(folder: Path) -> None:
    second = TINY.lessons(1, str(folder / "student-0.onnx"))
    assert all(lesson.file(folder / "frames").is_file() for lesson in second)
    assert {lesson.case for lesson in second}.isdisjoint(lesson.case for lesson in TINY.lessons(0))


def test_the_missions_that_were_learned_from_are_there_for_others(folder: Path, tmp_path: Path) -> None:
    card = json.loads((folder / CARD).read_text())
    found = list(missions(TINY, folder))
    assert len(found) == TINY.missions + TINY.more
    assert sum(map(len, found)) == card["rounds"][-1]["frames"]
    with pytest.raises(ValueError, match="Train once more"):
        list(missions(replace(TINY, steps=9), folder))


def test_the_same_again_is_the_same_network(folder: Path, tmp_path: Path) -> None:
    list(learn(TINY, tmp_path, Inline(), "cpu"))
    assert (tmp_path / MODEL).read_bytes() == (folder / MODEL).read_bytes()
    assert (tmp_path / CARD).read_bytes() == (folder / CARD).read_bytes()


def test_what_is_broken_off_goes_on_and_ends_with_the_same_network(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        list(learn(TINY, tmp_path, Inline(stops=2), "cpu"))
    for now in learn(TINY, tmp_path, Inline(), "cpu"):
        if now.part == "student 0 learns":
            break
    engine = Inline()
    parts = [now.part for now in learn(TINY, tmp_path, engine, "cpu")]
    assert len(lessons_of(engine)) == TINY.more
    assert parts.count("student 0 learns") == 1
    assert (tmp_path / MODEL).read_bytes() == (folder / MODEL).read_bytes()


def test_what_is_done_is_not_done_again_when_rounds_are_added(folder: Path) -> None:
    engine = Inline()
    shown: list[Progress] = list(learn(replace(TINY, temperatures=(0.5, 1.0)), folder, engine, "cpu"))
    assert not lessons_of(engine)
    assert not [now for now in shown if "learns" in now.part]
    list(learn(TINY, folder, Inline(), "cpu"))


def test_a_folder_of_another_curriculum_is_refused(folder: Path) -> None:
    with pytest.raises(
        ValueError, match=r"seed: expected 0 as for what is in it, got 1\. Choose another --out"
    ):
        next(learn(replace(TINY, seed=1), folder, Inline(), "cpu"))


def test_a_folder_that_other_code_filled_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = json.loads((folder / "plan.json").read_text())
    assert plan["source"] != source(), "the teacher is part of it, as it is of no mission"
    monkeypatch.setattr("dream.learning.curriculum.source", lambda *_: "5eed")
    with pytest.raises(ValueError, match=rf"source: expected {plan['source']} .* got 5eed\. Choose another"):
        next(learn(TINY, folder, Inline(), "cpu"))


@pytest.mark.parametrize("damaged", [b"", b"[]", b"{", b"\xff"])
def test_a_damaged_plan_is_told_of(tmp_path: Path, damaged: bytes) -> None:
    (tmp_path / "plan.json").write_bytes(damaged)
    with pytest.raises(ValueError, match=r"plan\.json: expected one JSON object"):
        next(learn(TINY, tmp_path, Inline(), "cpu"))


def test_what_is_missing_is_told_before_anything_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("onnx", "onnxruntime"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, name, None)
            engine = Inline()
            with pytest.raises(ValueError, match=re.escape(missing("train", name, "train"))):
                next(learn(TINY, tmp_path / name, engine, "cpu"))
        assert not engine.ran


@pytest.mark.parametrize(
    "wrong", [{"missions": 0}, {"rounds": 10}, {"temperatures": ()}, {"steps": -1}, {"seed": -1}]
)
def test_wrong_numbers_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="expected"):
        replace(TINY, **wrong)
