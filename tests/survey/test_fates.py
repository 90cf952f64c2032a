"""What became of individuals: told by the ground in their place, and held against what surveys miss."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import betabinom, binom

from dream.geometry import SE2, Bounds
from dream.survey import Individuals, Picture
from dream.survey.fates import Fate, Shown, fates, missing, standing
from dream.survey.registration import Registration

RATE, ALIKE = 0.03, 0.0025


def people(*places: tuple[float, float]) -> Individuals:
    """Well seen, to a centimetre."""
    n = len(places)
    position = np.column_stack([np.array(places, np.float64).reshape(n, 2), np.zeros(n)])
    hits = np.full(n, 5, np.int32)
    return Individuals(
        position=position,
        sigma=np.full(n, 0.01),
        size=np.full(n, 0.2),
        size_sigma=np.full(n, 0.01),
        hits=hits,
        looks=hits,
        confidence=np.ones(n),
        patch=np.zeros(n, np.int32),
        clear=np.ones(n, np.bool_),
    )


def picture(*places: tuple[float, float]) -> Picture:
    """Discs of 20 cm on 4 x 4 m in cells of 2.5 cm; its last metre was not seen."""
    bounds, cell = Bounds(0.0, 0.0, 4.0, 4.0), 0.025
    middle = (np.arange(160) + 0.5) * cell
    share = np.zeros((160, 160), np.uint8)
    for x, y in places:
        share[np.hypot(middle[None, :] - x, middle[:, None] - y) < 0.1] = 200
    share[:, 120:] = 255
    return Picture(bounds, cell, share)


LAID = Registration(SE2(0.0, 0.0, 0.0), (2.0, 2.0), np.zeros((3, 3)), SE2(0, 0, 0), "individuals", 10, 0.01)


def test_a_place_is_covered_bare_or_not_seen_and_bare_beyond_the_picture() -> None:
    shown = Shown(picture((1.0, 1.0)))
    share = shown.around(np.array([(1.0, 1.0), (1.0, 1.5), (3.5, 1.0), (-1.0, 1.0), (9.0, 9.0)]))
    assert share[0] > 0.9
    assert share[1] == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(share[2])
    assert share[3:].tolist() == [0.0, 0.0]


def test_what_stood_on_ground_that_is_bare_now_is_lost_and_what_another_covers_is_hidden() -> None:
    stays, dies, covered, moved, unseen = (0.5, 0.5), (1.5, 0.5), (0.5, 1.5), (0.6, 1.5), (3.5, 0.5)
    a, b = people(stays, dies, covered, unseen), people(stays, moved)
    shown = Shown(picture(stays, dies, covered)), Shown(picture(stays, moved))
    at_b = b.position[:, :2]
    common = np.ones(4, np.bool_), np.ones(2, np.bool_)
    told = standing(shown, (a, b), LAID)
    fate_a, fate_b = fates((a, b), at_b, common, told, LAID)
    # A hand aside is beyond what two places of a centimetre may err, but where it stood is covered.
    assert fate_a.tolist() == [Fate.THERE, Fate.LOST, Fate.HIDDEN, Fate.HIDDEN]
    assert fate_b.tolist() == [Fate.THERE, Fate.HIDDEN]
    assert told[0].known.tolist() == [True, True, True, False]
    # Without pictures all that is not found again is lost or new.
    fate_a, fate_b = fates((a, b), at_b, common, None, LAID)
    assert fate_a.tolist() == [Fate.THERE, Fate.LOST, Fate.LOST, Fate.LOST]
    assert fate_b.tolist() == [Fate.THERE, Fate.NEW]


def test_ground_that_only_one_saw_tells_no_fate_neither_of_a_partner_on_it() -> None:
    a, b = people((0.5, 0.5), (1.5, 0.5)), people((0.5, 0.5))
    common = np.array([True, False]), np.array([False])
    fate_a, fate_b = fates((a, b), b.position[:, :2], common, None, LAID)
    assert fate_a.tolist() == [Fate.NOT_COMPARABLE, Fate.NOT_COMPARABLE]
    assert fate_b.tolist() == [Fate.NOT_COMPARABLE]


def test_where_none_is_gone_p_is_as_likely_below_any_level_as_the_level_says() -> None:
    rng = np.random.default_rng(1)
    strength = 1.0 / ALIKE - 1.0
    bare = betabinom(200, RATE * strength, (1.0 - RATE) * strength).rvs(2000, random_state=rng)
    p_of = {k: missing(int(k), 200, RATE, ALIKE).p for k in np.unique(bare)}
    p = np.array([p_of[k] for k in bare])
    for level in (0.05, 0.2, 0.5, 0.8):
        # Numbers are whole: a level is met to half of what one of them weighs.
        assert (p < level).mean() == pytest.approx(level, abs=0.09)
    assert (p < 0.0125).mean() < 0.02


@pytest.mark.rare
def test_the_interval_holds_the_share_that_is_gone() -> None:
    rng = np.random.default_rng(2)
    strength = 1.0 / ALIKE - 1.0
    expected = RATE + (1.0 - RATE) * 0.15
    bare = betabinom(120, expected * strength, (1.0 - expected) * strength).rvs(1000, random_state=rng)
    told = {k: missing(int(k), 120, RATE, ALIKE) for k in np.unique(bare)}
    held = np.mean([told[k].low <= 0.15 <= told[k].high for k in bare])
    assert 0.93 < held < 0.98
    assert np.mean([told[k].share for k in bare]) == pytest.approx(0.15, abs=0.01)


@pytest.mark.parametrize("bare", [0, 4, 8, 30])
def test_the_interval_begins_above_none_where_its_side_of_the_test_says_so(bare: int) -> None:
    told = missing(bare, 100, RATE, ALIKE)
    assert (told.low > 0.0) == (told.p < 0.025)
    assert told.low <= told.share <= told.high


def test_of_neighbours_that_are_missed_on_their_own_the_numbers_are_binomial() -> None:
    alone = binom(80, RATE)
    assert missing(6, 80, RATE, 1e-7).p == pytest.approx(alone.sf(6) + 0.5 * alone.pmf(6), rel=1e-3)


def test_none_that_could_be_looked_for_tells_nothing() -> None:
    told = missing(0, 0, RATE, ALIKE)
    assert (told.share, told.low) == (0.0, 0.0)
    assert told.high > 0.99
    assert told.p == pytest.approx(0.5)
