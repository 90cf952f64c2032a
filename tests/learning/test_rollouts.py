"""Missions to learn from: the same for the same lesson, and kept whole or not at all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dream.evaluation.suites import SUITES
from dream.learning.rollouts import TRAINING, VALIDATION, Frames, Lesson, fly, gather, read, reef_cases, write
from dream.sim.habitats import HABITATS
from dream.sim.worlds import WORLDS
from tests.learning.engines import Inline

LESSON = Lesson(reef_cases(2, TRAINING)[1], seed=0, steps=6)


@pytest.fixture(scope="module")
def flown() -> Frames:
    return fly(LESSON)


def test_a_lesson_is_what_was_seen_and_said_before_every_decision(flown: Frames) -> None:
    assert len(flown) == LESSON.steps - 3  # The look-around is nobody's decision.
    assert flown.images.shape == (3, 2, 72, 96)
    assert flown.images.dtype == np.uint8
    np.testing.assert_allclose(flown.odds.sum(axis=1), 1.0, rtol=1e-6)
    assert flown.images.std() > 0.0


def test_the_same_lesson_gives_the_same_frames_and_another_seed_others(flown: Frames) -> None:
    again, other = fly(LESSON), fly(replace(LESSON, seed=1, steps=40))
    assert np.array_equal(again.images, flown.images)
    assert np.array_equal(again.odds, flown.odds)
    longer = fly(replace(LESSON, steps=40))
    assert np.array_equal(longer.images[:3], flown.images)
    assert not np.array_equal(longer.images, other.images)


def test_no_suite_has_a_world_that_is_learned_from() -> None:
    cases = {*reef_cases(999, TRAINING), *reef_cases(999, VALIDATION)}
    assert len(cases) == 2 * 999
    reefs = {name for name in WORLDS if name.startswith("reef/")}
    assert {case.world for case in cases} == reefs - set(HABITATS)
    seeds = {(case.world, case.seed) for case in cases}
    assert not seeds & {(case.world, case.seed) for suite in SUITES.values() for case in suite}


def test_frames_come_back_from_their_file(tmp_path: Path, flown: Frames) -> None:
    path = tmp_path / "lesson.npz"
    write(path, flown)
    found = read(path)
    assert found is not None
    assert np.array_equal(found.images, flown.images)
    assert np.array_equal(found.odds, flown.odds)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_damaged_or_foreign_file_counts_as_none(tmp_path: Path, flown: Frames) -> None:
    path = tmp_path / "lesson.npz"
    assert read(path) is None
    write(path, flown)
    whole = path.read_bytes()
    for damaged in (b"", whole[:100], whole[:-200], b"not an archive"):
        path.write_bytes(damaged)
        assert read(path) is None
    write(path, Frames(flown.images[:, :1], flown.odds))
    assert read(path) is None


def test_what_is_broken_off_goes_on_where_it_was(tmp_path: Path) -> None:
    lessons = [replace(LESSON, seed=seed, steps=4) for seed in range(3)]
    with pytest.raises(KeyboardInterrupt):
        list(gather(lessons, tmp_path, Inline(stops=2)))
    engine = Inline()
    frames = list(gather(lessons, tmp_path, engine))
    assert engine.ran == lessons[2:]
    assert [len(part) for part in frames] == [1, 1, 1]
    lessons[1].file(tmp_path).write_bytes(b"damaged")
    engine = Inline()
    again = list(gather(lessons, tmp_path, engine))
    assert engine.ran == [lessons[1]]
    assert np.array_equal(Frames.joined(again).odds, Frames.joined(frames).odds)


def test_another_student_is_another_file(tmp_path: Path) -> None:
    student = tmp_path / "student.onnx"
    student.write_bytes(b"one")
    lesson = replace(LESSON, student=str(student))
    before = lesson.file(tmp_path)
    student.write_bytes(b"two")
    assert len({before, lesson.file(tmp_path), LESSON.file(tmp_path)}) == 3
