"""What two pictures have in common: not how bright they are, and not what flickers in a part of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from dream.robots.bluerov2.likeness import FAINT, Likeness, difference, glance, likeness
from dream.types import Float32Array, UInt8Array

QUIET = np.zeros(48, np.float32)


def pattern(seed: int = 0, *, contrast: float = 20.0, shift: float = 0.0, blur: float = 10.0) -> Float32Array:
    """(240, 320) grey levels around 110 of spots that are some `blur` pixels wide, shifted to the right."""
    spots = np.random.default_rng(seed).standard_normal((280, 360), np.float32)
    spots = ndimage.shift(ndimage.gaussian_filter(spots, blur), (0.0, shift), order=1)[20:260, 20:340]
    whole: Float32Array = 110.0 + contrast * spots / spots.std()
    return whole


def rgb(grey: Float32Array, noise: float = 0.0, seed: int = 1) -> UInt8Array:
    grain = noise * np.random.default_rng(seed).standard_normal((*grey.shape, 3), np.float32)
    return np.clip(np.rint(grey[..., None] + grain), 0.0, 255.0).astype(np.uint8)


def judged(one: UInt8Array, other: UInt8Array, noise: Float32Array = QUIET) -> Likeness:
    """Either way round."""
    found = {likeness(glance(a), glance(b), noise) for a, b in ((one, other), (other, one))}
    assert len(found) == 1
    return found.pop()


def measured(grey: Float32Array, noise: float) -> Float32Array:
    """By two pictures of the same."""
    return difference(glance(rgb(grey, noise, 10)), glance(rgb(grey, noise, 11)))


def test_a_picture_does_not_differ_from_itself() -> None:
    seen = glance(rgb(pattern()))
    assert difference(seen, seen).max() == 0.0
    assert likeness(seen, seen, QUIET) is Likeness.SAME


def test_pictures_of_different_things_differ_by_as_much_as_they_show() -> None:
    apart = difference(glance(rgb(pattern(0))), glance(rgb(pattern(1))))
    assert np.median(apart) == pytest.approx(np.sqrt(2.0), rel=0.15)
    assert judged(rgb(pattern(0)), rgb(pattern(1))) is Likeness.CHANGED


@pytest.mark.parametrize("factor", [0.4, 1.0, 1.8])
def test_how_bright_it_is_and_how_the_light_falls_off_are_no_difference(factor: float) -> None:
    slope = np.linspace(-40.0, 40.0, 320, dtype=np.float32)
    assert judged(rgb(pattern()), rgb(factor * pattern())) is Likeness.SAME
    assert judged(rgb(pattern()), rgb(pattern() + slope)) is Likeness.SAME


def test_a_curve_of_tones_is_no_difference() -> None:
    """A longer exposure does not make all greys brighter by the same factor."""
    grey = pattern(contrast=35.0)
    bright = 20.0 + 235.0 * np.clip(grey / 255.0, 0.0, 1.0) ** 0.7
    apart = difference(glance(rgb(grey)), glance(rgb(bright.astype(np.float32))))
    assert np.median(apart) > 0.05
    assert judged(rgb(grey), rgb(bright.astype(np.float32))) is Likeness.SAME


def test_what_is_seen_no_more_has_changed() -> None:
    assert judged(rgb(pattern()), rgb(np.full((240, 320), 60.0, np.float32))) is Likeness.CHANGED


def test_the_slightest_move_is_a_difference_where_there_is_no_noise() -> None:
    assert judged(rgb(pattern()), rgb(pattern(shift=3.0))) is Likeness.CHANGED


def test_what_is_the_same_but_for_noise_is_the_same() -> None:
    grey = pattern()
    for noise in (4.0, 10.0, 20.0):
        assert judged(rgb(grey, noise, 1), rgb(grey, noise, 2), measured(grey, noise)) is Likeness.SAME
    # Where nobody has measured it, noise is taken for a change.
    assert judged(rgb(grey, 20.0, 1), rgb(grey, 20.0, 2)) is Likeness.CHANGED


def test_noise_that_would_hide_a_move_leaves_it_untold() -> None:
    grey, moved = pattern(contrast=4.0), pattern(contrast=4.0, shift=3.0)
    noise = measured(grey, 16.0)
    assert judged(rgb(grey, 16.0, 1), rgb(moved, 16.0, 2), noise) is Likeness.UNTOLD
    assert judged(rgb(grey, 16.0, 1), rgb(grey, 16.0, 2), noise) is Likeness.UNTOLD
    # Something else altogether is told all the same.
    assert judged(rgb(grey, 16.0, 1), rgb(pattern(1, contrast=4.0), 16.0, 2), noise) is Likeness.CHANGED


def test_noise_is_no_texture() -> None:
    flat = np.full((240, 320), 90.0, np.float32)
    seen = glance(rgb(flat, 12.0))
    assert seen.textured < 0.1
    assert seen.texture.min() == FAINT
    assert judged(rgb(flat, 12.0, 1), rgb(flat, 12.0, 2), measured(flat, 12.0)) is Likeness.UNTOLD


def test_a_gripper_in_empty_water_leaves_it_untold() -> None:
    """It stays where it is in the picture of a vehicle that moves, and a few fish do not."""
    water, gripper, fish = np.full((240, 320), 90.0, np.float32), pattern(2), (pattern(3), pattern(4))
    water[160:, 80:240] = gripper[160:, 80:240]
    pictures = [water.copy(), water.copy()]
    for grey, own in zip(pictures, fish, strict=True):
        grey[:80, :80] = own[:80, :80]
    assert judged(rgb(pictures[0]), rgb(pictures[1])) is Likeness.UNTOLD


@pytest.mark.parametrize("share", [0.0, 0.25, 0.75, 1.0])
def test_most_of_what_can_be_seen_decides(share: float) -> None:
    grey = pattern()
    other = grey.copy()
    cols = round(share * 320)
    other[:, :cols] = pattern(5)[:, :cols]
    assert judged(rgb(grey), rgb(other)) is (Likeness.SAME if share < 0.5 else Likeness.CHANGED)


@pytest.mark.parametrize("size", [(1080, 1920), (120, 160), (48, 64), (61, 83)])
def test_any_size_will_do(size: tuple[int, int]) -> None:
    grey = ndimage.zoom(pattern(blur=16.0), (size[0] / 240, size[1] / 320), order=1)
    seen = glance(rgb(grey))
    assert seen.blocks.shape == (48, 100)
    assert seen.textured == 1.0
    assert likeness(seen, glance(rgb(pattern(blur=16.0))), np.full(48, 0.2, np.float32)) is Likeness.SAME
