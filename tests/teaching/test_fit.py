"""A head from marks, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from dream.teaching.fit import (
    CHOICES,
    MOST_CELLS,
    Example,
    HeadChoice,
    HeadLesson,
    Held,
    balanced,
    lacking,
    logistic,
    quality_of,
)
from dream.teaching.marks import OTHER, TARGET
from dream.teaching.model import Extractor
from tests.teaching.lessons import scene, strokes, texture


@pytest.fixture(scope="module")
def extractor() -> Extractor:
    return texture()


def examples(extractor: Extractor, numbers: list[int]) -> list[Example]:
    found = []
    for n in numbers:
        rgb, inside = scene(n)
        found.append(Example.of(str(n), extractor.cells(rgb), strokes(inside)))
    return found


def test_the_regression_is_where_its_loss_is_least() -> None:
    rng = np.random.default_rng(0)
    rows = np.concatenate([rng.normal(size=(200, 3)), np.ones((200, 1))], axis=1)
    share = (rows[:, 0] + 0.5 * rng.normal(size=200) > 0.3).astype(float)
    share, weight = balanced(share, np.ones(200))
    found = logistic(rows, share, weight, 0.05)

    def loss(weights: np.ndarray) -> float:
        logits = rows @ weights
        return float(weight @ (np.logaddexp(0.0, logits) - share * logits) + 0.025 * (weights[:3] ** 2).sum())

    for axis in range(4):
        for by in (-0.01, 0.01):
            assert loss(found) <= loss(found + by * np.eye(4)[axis]) + 1e-9


def test_both_kinds_weigh_the_same_however_much_of_each_is_marked() -> None:
    share = np.array([1.0, 0.0, 0.0, 0.5])
    share, weight = balanced(share, np.array([0.2, 1.0, 1.0, 1.0]))
    assert weight @ share == pytest.approx(0.5)
    assert weight.sum() == pytest.approx(1.0)
    with pytest.raises(ValueError, match="one kind alone"):
        balanced(np.ones(3), np.ones(3))


def test_a_large_mark_counts_no_more_than_its_most_cells(extractor: Extractor) -> None:
    rgb, inside = scene(1)
    whole = Example.of("1", extractor.cells(rgb), np.where(inside, TARGET, OTHER).astype(np.uint8))
    assert (whole.share < 0.5).sum() == MOST_CELLS
    assert len(whole.rows) <= 2 * MOST_CELLS
    again = Example.of("1", extractor.cells(rgb), whole.marks)
    np.testing.assert_array_equal(whole.rows, again.rows)


def test_it_says_what_is_lacking(extractor: Extractor) -> None:
    assert lacking([]) == "mark some target"
    rgb, inside = scene(1)
    target = np.where(inside, TARGET, 0).astype(np.uint8)
    assert lacking([Example.of("1", extractor.cells(rgb), target)]) == "mark some other"
    assert lacking(examples(extractor, [1])) == ""
    with pytest.raises(ValueError, match="mark some target"):
        HeadLesson([], 0)


@pytest.mark.parametrize("count", [1, 2])
def test_with_few_pictures_no_figure_is_given(extractor: Extractor, count: int) -> None:
    found = HeadLesson(examples(extractor, list(range(count))), 0).measured(extractor)
    assert found is not None
    assert found.quality.iou is None
    assert found.quality.held == ()
    assert f"marked in {count} of at least 3 pictures" in found.quality.why


def test_pictures_that_were_left_out_are_told_and_measured(extractor: Extractor) -> None:
    found = HeadLesson(examples(extractor, list(range(5))), 0).measured(extractor)
    assert found is not None
    quality = found.quality
    assert quality.why == ""
    assert [one.name for one in quality.held] == list("01234")
    assert quality.iou is not None
    assert quality.low is not None
    assert quality.high is not None
    assert 0.85 < quality.low <= quality.iou <= quality.high <= 1.0
    assert found.choice in CHOICES


def test_a_picture_has_no_part_in_how_it_is_told(extractor: Extractor) -> None:
    # One in which everything is marked the wrong way round.
    wrong = examples(extractor, [7])[0]
    flipped = Example.of("7", wrong.grid, np.array([0, OTHER, TARGET], np.uint8)[wrong.marks])
    found = HeadLesson([*examples(extractor, [0, 1, 2, 3]), flipped], 0).measured(extractor)
    assert found is not None
    held = {one.name: one for one in found.quality.held}
    assert held["7"].iou is not None
    assert held["7"].iou < 0.05
    assert held["7"].wrong > 0.9


def test_a_picture_without_target_says_how_much_was_wrong_alone(extractor: Extractor) -> None:
    rgb, inside = scene(6)
    plain = Example.of("6", extractor.cells(rgb), np.where(inside, 0, OTHER).astype(np.uint8))
    found = HeadLesson([*examples(extractor, [0, 1, 2]), plain], 0).measured(extractor)
    assert found is not None
    held = {one.name: one for one in found.quality.held}
    assert held["6"].iou is None
    assert held["6"].wrong < 0.1
    assert len([one for one in found.quality.held if one.iou is not None]) == 3


def test_the_interval_is_that_of_student() -> None:
    values = [0.5, 0.6, 0.9]
    quality = quality_of([Held(str(v), v, 0.0) for v in values] + [Held("none", None, 0.5)])
    low, high = stats.t.interval(0.95, 2, np.mean(values), stats.sem(values))
    assert quality.iou == pytest.approx(np.mean(values))
    assert quality.low == pytest.approx(max(low, 0.0))
    assert quality.high == pytest.approx(min(high, 1.0))


def test_it_stops_when_it_is_told_to(extractor: Extractor) -> None:
    assert HeadLesson(examples(extractor, [0, 1, 2]), 0).measured(extractor, lambda: True) is None


@pytest.mark.slow
def test_features_that_say_nothing_are_not_looked_at(extractor: Extractor) -> None:
    rng = np.random.default_rng(0)
    told = []
    for one in examples(extractor, [0, 1, 2, 3]):
        # Of each picture its own: they tell it apart, and nothing in another.
        noise = rng.normal(size=(132, *one.grid.shape[1:])) + rng.normal(size=(132, 1, 1)) * 5.0
        told.append(Example.of(one.name, np.concatenate([noise, one.grid]).astype(np.float32), one.marks))
    lesson = HeadLesson(told, 132)
    found = lesson.measured(extractor)
    assert found is not None
    assert found.choice.plain
    assert not found.head.weights[:132].any()
    seen = lesson.head(lesson.fit(HeadChoice(0.1, False)))
    row = told[0].rows[0].astype(np.float64)
    logit = lesson.logits(lesson.fit(HeadChoice(0.1, False)), 0)[0]
    assert seen.weights @ row + seen.bias == pytest.approx(logit, abs=1e-6)
