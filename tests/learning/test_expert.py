"""The teacher on frames whose best answer is plain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.learning.expert import TURNS, Expert
from dream.perception.representation import represent
from dream.planning.baselines.uivnav import TURNS_DEG
from dream.protocol import DREAM_V1
from dream.types import Label
from tests.learning.frames import Where, floor, nowhere

RIGHT_90, RIGHT_60, RIGHT_30, STRAIGHT, LEFT_30, LEFT_60, LEFT_90 = range(7)


def disc(ahead: float, left: float, radius: float) -> Where:
    return lambda x, y: np.asarray(np.hypot(x - ahead, y - left) < radius)


def odds_of(target: Where = nowhere, solid: Where = nowhere) -> np.ndarray:
    return Expert().weigh(*floor(target, solid), DREAM_V1)


def test_turns_are_those_of_the_planner() -> None:
    assert np.degrees(TURNS) == pytest.approx(TURNS_DEG)


def test_it_turns_to_the_side_where_the_target_is() -> None:
    assert odds_of(disc(9.0, 5.5, 1.5)).argmax() == LEFT_30
    assert odds_of(disc(9.0, -5.5, 1.5)).argmax() == RIGHT_30
    assert odds_of(disc(11.0, 0.0, 1.5)).argmax() == STRAIGHT


def test_what_lies_beyond_the_reach_pulls_more_than_what_was_seen() -> None:
    def both(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return disc(5.0, 3.0, 1.5)(x, y) | disc(9.0, -5.5, 1.5)(x, y)

    assert odds_of(both).argmax() == RIGHT_30


def test_what_the_side_cuts_off_is_turned_to() -> None:
    odds = odds_of(lambda x, y: (x > 2.0) & (x < 4.0) & (y > 1.8))
    assert odds.argmax() == LEFT_60


def test_where_nothing_is_seen_it_goes_on_and_wanders() -> None:
    expert = Expert(wander=0.3)
    for depth, labels in (floor(), (np.full((240, 320), np.nan, np.float32), np.zeros((240, 320), np.uint8))):
        odds = expert.weigh(depth, labels, DREAM_V1)
        assert odds[STRAIGHT] == pytest.approx(0.7)
        assert (odds > 0.0).all()


def test_it_never_goes_where_something_stands_nearby() -> None:
    ahead = odds_of(solid=disc(3.0, 0.0, 0.5))
    assert ahead[STRAIGHT] == 0.0
    assert ahead[LEFT_60] > 0.0
    # Not even for a target behind it; and what stands far away is nothing yet.
    assert odds_of(disc(11.0, 0.0, 2.0), disc(3.0, 0.0, 0.5))[STRAIGHT] == 0.0
    assert odds_of(solid=disc(7.0, 0.0, 0.5))[STRAIGHT] > 0.4


def test_a_depth_of_exactly_the_greatest_pulls_nowhere() -> None:
    depth, labels = floor(target=lambda forward, left: left > 1.0)
    far = depth > 4.0
    padded, missing = (
        Expert().weigh(np.where(far, np.float32(z), depth), labels, DREAM_V1)
        for z in (DREAM_V1.max_depth, np.nan)
    )
    assert (labels[far] == Label.TARGET).any()
    assert np.array_equal(padded, missing)


def test_before_a_wall_it_turns_out_of_view() -> None:
    odds = odds_of(solid=lambda x, y: (x > 2.0) & (x < 2.6))
    assert odds[[RIGHT_30, STRAIGHT, LEFT_30]].sum() == 0.0
    assert odds.sum() == pytest.approx(1.0)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_the_mirror_image_gets_the_mirrored_answer(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def some(count: int, least: float, size: float) -> Where:
        discs = [disc(*rng.uniform((least, -7.0, 0.1), (14.0, 7.0, size))) for _ in range(count)]
        return lambda x, y: np.logical_or.reduce([each(x, y) for each in discs])

    depth, labels = floor(some(4, 2.0, 2.0), some(2, 2.5, 0.5))
    labels[(rng.random(labels.shape) < 0.1) & (labels > 0)] = int(Label.TARGET)
    straight = Expert().weigh(depth, labels, DREAM_V1)
    crossed = Expert().weigh(depth[:, ::-1], labels[:, ::-1], DREAM_V1)
    np.testing.assert_allclose(crossed, straight[::-1], rtol=1e-9)
    assert straight.sum() == pytest.approx(1.0)


def test_half_the_size_looks_the_same() -> None:
    half = replace(
        DREAM_V1, name="half", altitude=1.0, reach=4.0, band=(0.25, 1.25), max_depth=10.0, min_depth=0.05
    )

    def boxes(size: float) -> Where:
        near, off = disc(1.4 * size, 0.0, 0.25 * size), disc(2.4 * size, 1.4 * size, 0.25 * size)
        return lambda x, y: near(x, y) | off(x, y)

    depth, labels = floor(disc(5.0, 2.0, 0.8), boxes(1.0), half)
    whole_depth, whole_labels = floor(disc(10.0, 4.0, 1.6), boxes(2.0))
    np.testing.assert_allclose(
        Expert().weigh(depth, labels, half), Expert().weigh(whole_depth, whole_labels, DREAM_V1), rtol=1e-5
    )
    pictures = represent(depth, labels, altitude=1.0), represent(whole_depth, whole_labels)
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() <= 1


def test_it_refuses_frames_of_another_camera() -> None:
    depth, labels = floor()
    with pytest.raises(ValueError, match="rows and columns"):
        Expert().weigh(depth.T, labels, DREAM_V1)
