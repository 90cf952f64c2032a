"""Comparing surveys: laid on each other, told apart from chance, and only where both looked."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import pickle
import re
import sqlite3
import subprocess
import sys
from dataclasses import fields, replace
from datetime import timedelta
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from PIL import Image
from scipy.spatial import cKDTree
from scipy.special import ndtr
from scipy.stats import false_discovery_control

from dream.cli import run_command
from dream.geometry import SE2
from dream.survey import Individuals, Measure, Survey, change_words, files
from dream.survey.archive import wkb
from dream.survey.change_layers import GROUND, VERDICTS
from dream.survey.change_map import FILES, draw_on, write_change
from dream.survey.change_page import change_page
from dream.survey.change_words import a_year, summary
from dream.survey.comparison import (
    Change,
    Comparing,
    Comparison,
    Difference,
    _density,
    _difference,
    _Grid,
    adjusted,
    detection,
    doubts,
)
from dream.survey.fates import Fate
from dream.survey.numbers import number, p_value, typeset
from dream.survey.products.sheet import corners_of, new_figure
from dream.survey.registration import Registering, frames, mutual, placed
from dream.survey.site import Site
from dream.types import Target
from tests.survey import scenes
from tests.survey.browsing import Seen
from tests.survey.repeated import AREAS, BOX, SITE, Reef, Surveying, reef, survey, without

COMPARING = Comparing()
STILL = Surveying(drift=(0.0, 0.0, 0.0), unseen=0.0)
ALL = Surveying(unseen=0.0)


def pair(seed: int, share: float = 0.0, how: Surveying | None = None) -> tuple[Survey, Survey]:
    """Two surveys; in the second a share of patch 1 is dead."""
    rng = np.random.default_rng(seed)
    before = reef(rng)
    after = without(before, 1, share, rng) if share else before
    return survey(before, rng, how, "first"), survey(after, rng, how, "second")


@pytest.fixture(scope="module")
def same() -> list[Comparison]:
    return [COMPARING.compare(*pair(seed)) for seed in range(6)]


@pytest.fixture(scope="module")
def less() -> list[Comparison]:
    return [COMPARING.compare(*pair(seed, 0.2)) for seed in range(6)]


# --- One on the other


@pytest.mark.rare
def test_a_drift_is_found_to_a_fraction_of_a_cell_and_the_covariance_says_so() -> None:
    """The normalised square of the error is near its 3 degrees of freedom."""
    squares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        there = reef(rng)
        a = survey(there, rng, STILL)
        b = survey(there, rng, replace(STILL, drift=(1e-9, 1e-9, 1e-9)))
        east, north, yaw = (float(rng.uniform(-most, most)) for most in (0.25, 0.25, 0.01))
        T = SE2(east, north, yaw)
        # Seen from a frame of which T says where it is in the first.
        back = placed(SE2(0.0, 0.0, -T.yaw), np.array([[-T.x, -T.y]]))[0]
        inverse = SE2(float(back[0]), float(back[1]), -T.yaw)
        position = b.individuals.position.copy()
        position[:, :2] = placed(inverse, position[:, :2])
        moved = replace(b, individuals=replace(b.individuals, position=position))
        found = Registering().register(a, moved)
        assert found.by == "individuals"
        pivot = np.array([found.pivot])
        at = placed(found.T_a_b, placed(inverse, pivot))[0] - pivot[0]
        error = np.array([*at, math.remainder(found.T_a_b.yaw - T.yaw, math.tau)])
        assert np.hypot(*at) < 0.03
        squares.append(float(error @ np.linalg.solve(found.covariance, error)))
    assert 0.5 < np.mean(squares) < 9.0


@pytest.mark.rare
@pytest.mark.parametrize("off", [2.2, 6.4, 11.0])
def test_an_origin_that_is_off_by_metres_is_found_out_and_told_of(off: float) -> None:
    a, b = pair(3, how=STILL)
    wrong = replace(SITE, latitude=SITE.latitude + off / 111_000.0, heading_deg=9.0)
    found = Registering().register(a, replace(b, site=wrong))
    assert found.by == "individuals"
    there = b.individuals.position[:, :2]
    assert np.hypot(*(found.place(there) - there).T).max() < 0.1
    assert "disagree by" in found.note
    right = Registering().register(a, b)
    assert right.note == ""


@pytest.mark.rare
def test_a_long_reef_is_laid_along_all_of_it() -> None:
    """Half a degree between two turns that are tried moves its ends by more than individuals are apart."""
    rng = np.random.default_rng(1)
    there = np.column_stack([rng.uniform(-150.0, 150.0, 1500), rng.uniform(-2.0, 2.0, 1500)])
    first, again = (there[rng.random(1500) < 0.8] for _ in range(2))
    a, b = pair(3, how=STILL)
    a, b = (
        replace(one, site=None, individuals=at(one.individuals, place))
        for one, place in ((a, first), (b, placed(SE2(4.0, 3.0, math.radians(5.5)), again)))
    )
    found = Registering().register(a, b)
    off = np.hypot(*(found.place(b.individuals.position[:, :2]) - again).T)
    assert found.by == "individuals"
    assert off.max() < 0.05
    assert found.pairs > 800


def at(individuals: Individuals, place: np.ndarray) -> Individuals:
    """As many of them as there are places, there."""
    some = Individuals(
        *(
            np.resize(getattr(individuals, one.name), (len(place), *getattr(individuals, one.name).shape[1:]))
            for one in fields(Individuals)
        )
    )
    return replace(some, position=np.column_stack([place, np.full(len(place), -6.0)]))


@pytest.mark.parametrize("off", [100.0, 4000.0])
def test_origins_that_are_far_apart_cost_no_more(off: float) -> None:
    """The grid of what is held against each other does not grow with the way between them."""
    a, b = pair(3, how=STILL)
    found = Registering().register(
        a, replace(b, site=replace(SITE, latitude=SITE.latitude + off / 111_000.0))
    )
    assert found.by == "poses"


@pytest.mark.rare
def test_another_reef_is_not_laid_on_this_one() -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        a, b = survey(reef(rng), rng, STILL), survey(reef(rng), rng, STILL)
        assert Registering().register(a, b).by != "individuals"


def test_where_nothing_shows_how_they_lie_no_ground_is_compared() -> None:
    """An origin that is off by more than is searched would paint gain beside loss."""
    a, b = pair(3, how=STILL)
    found = COMPARING.compare(a, replace(b, site=replace(SITE, latitude=SITE.latitude + 30.0 / 111_000.0)))
    assert found.registration.by == "poses"
    assert found.withheld
    assert found.comparable == found.only_a == found.only_b == 0.0
    assert found.differences == ()
    assert found.as_dict()["registration"]["sigma_m"] is None
    assert {patch.verdict for patch in found.patches} == {"not comparable"}
    assert not np.isin(found.change, (Change.GAIN, Change.LOSS)).any()
    assert "no ground is compared" in summary(found)[0]
    # A reef of which nothing is left is a loss all the same: there is nothing that could lie elsewhere.
    bare = replace(b.layers, state=np.minimum(b.layers.state, 1))
    none = Individuals(*(getattr(b.individuals, one.name)[:0] for one in fields(Individuals)))
    gone = COMPARING.compare(a, replace(b, layers=bare, patches=(), individuals=none, picture=None))
    assert gone.registration.by == "poses"
    assert not gone.withheld
    assert {patch.verdict for patch in gone.patches} == {"loss"}


def test_ground_that_shows_nothing_in_common_is_told_of_and_the_poses_are_taken() -> None:
    rng = np.random.default_rng(2)
    a, b = survey(reef(rng), rng, STILL), survey(reef(rng), rng, STILL)
    blank = replace(b.layers, state=np.minimum(b.layers.state, 1))
    found = Registering().register(a, replace(b, layers=blank))
    assert found.by == "poses"
    # The way over the globe and back may round.
    laid = found.T_a_b
    np.testing.assert_allclose([laid.x, laid.y, laid.yaw], 0.0, atol=1e-12)
    assert found.sigma >= 0.3
    assert "Nothing in both showed" in found.note


def test_a_wreck_is_laid_by_its_map() -> None:
    found = Registering().register(scenes.wreck(), scenes.wreck())
    assert found.by == "map"
    assert math.hypot(found.T_a_b.x, found.T_a_b.y) < 0.2


def test_frames_of_other_origins_and_headings_meet_on_the_globe() -> None:
    a, b = pair(3, how=STILL)
    turned = replace(SITE, heading_deg=40.0, latitude=SITE.latitude + 2e-4, longitude=SITE.longitude - 1e-4)
    T_a_b, _ = frames(a, replace(b, site=turned))
    c, s = math.cos(T_a_b.yaw), math.sin(T_a_b.yaw)

    def there(points: np.ndarray) -> np.ndarray:
        x, y = (points - [T_a_b.x, T_a_b.y]).T
        return np.column_stack([c * x + s * y, -s * x + c * y])

    position = b.individuals.position.copy()
    position[:, :2] = there(position[:, :2])
    b = replace(b, site=turned, individuals=replace(b.individuals, position=position))
    tree = cKDTree(a.individuals.position[:, :2])
    placed_b = Registering().register(a, b).place(b.individuals.position[:, :2])
    assert len(mutual(tree, placed_b, 0.15)) > 0.8 * len(b.individuals)


@pytest.mark.parametrize(
    "change, complaint",
    [
        ({"site": replace(SITE, name="Other reef")}, "expected two surveys of one site, got 'Test reef'"),
        ({"site": None}, "got second, a run without origin"),
        ({"site": replace(SITE, latitude=55.9)}, "got origins 111.* km apart"),
        ({"target": Target.WRECK}, "expected two surveys of one target, got oysters and wreck"),
    ],
)
def test_surveys_that_cannot_be_compared_are_refused(change: dict[str, object], complaint: str) -> None:
    a, b = pair(1)
    with pytest.raises(ValueError, match=complaint):
        COMPARING.compare(a, replace(b, **change))  # type: ignore[arg-type]


def test_without_any_origin_the_frames_are_taken_for_the_same_and_that_is_said() -> None:
    a, b = pair(1, how=STILL)
    found = COMPARING.compare(replace(a, site=None), replace(b, site=None))
    assert "Neither run had an origin" in found.registration.note


# --- What changed


def test_a_survey_held_against_itself_has_not_changed() -> None:
    a, _ = pair(4, how=ALL)
    found = COMPARING.compare(a, a)
    assert {patch.verdict for patch in found.patches} == {"no change shown"}
    assert (found.fate_a == Fate.THERE).all()
    assert (found.fate_b == Fate.THERE).all()
    assert not np.isin(found.change, (Change.GAIN, Change.LOSS)).any()
    assert found.only_a == found.only_b == 0.0
    for difference in found.differences:
        assert difference.change == pytest.approx(0.0, abs=1e-9)
        assert difference.low < 0.0 < difference.high


@pytest.mark.rare
def test_nothing_that_did_not_change_is_told_as_changed(same: list[Comparison]) -> None:
    verdicts = [patch.verdict for one in same for patch in one.patches]
    assert len(verdicts) == 6 * len(AREAS)
    assert verdicts.count("no change shown") >= len(verdicts) - 1


def test_a_fifth_of_a_patch_that_died_is_found_there_and_nowhere_else(less: list[Comparison]) -> None:
    found = [[patch.verdict for patch in one.patches] for one in less]
    assert sum(verdicts[1] == "loss" for verdicts in found) >= 5
    assert sum(verdicts[k] != "no change shown" for verdicts in found for k in (0, 2, 3)) <= 1


def test_the_interval_of_the_count_holds_what_died(less: list[Comparison]) -> None:
    """A fifth of those on ground that both saw."""
    held = 0
    for one in less:
        count = next(d for d in one.patches[1].differences if d.name == "found")
        held += count.low <= -0.2 * count.before <= count.high
    assert held >= 5


def told(name: str, value: float, low: float, high: float) -> Measure:
    return Measure(name, value, low, high, "m")


def test_what_each_survey_tells_is_set_side_by_side_with_an_interval_of_the_change() -> None:
    """Of symmetric intervals those of Zou and Donner are those of independent normal errors."""
    a, b = pair(5, how=ALL)
    a = replace(a, measures=(told("median_size", 0.20, 0.17, 0.23), told("seen_share", 0.9, 0.9, 0.9)))
    b = replace(
        b,
        began=b.began + timedelta(days=731),
        measures=(
            told("median_size", 0.25, 0.21, 0.29),
            told("seen_share", 0.8, 0.8, 0.8),
            Measure("reef_height", None, None, None, "m"),
        ),
    )
    found = COMPARING.compare(a, b)
    (size,) = found.measures
    assert (size.name, size.before, size.after) == ("median_size", 0.20, 0.25)
    assert (size.change, size.low, size.high) == pytest.approx((0.05, 0.0, 0.1))
    assert size.p == pytest.approx(0.05, abs=1e-4)
    assert found.years == pytest.approx(2.0, abs=0.01)
    assert a_year(size, found.years) == "0.0250 (0.0000 to 0.0500) m"
    assert a_year(size, 0.1) == ""
    # The side that zero is on tells how sure a change is.
    lop = replace(a, measures=(told("median_size", 0.20, 0.05, 0.21),))
    (again,) = COMPARING.compare(lop, b).measures
    assert again.low == pytest.approx(0.05 - math.hypot(0.04, 0.01))
    assert again.high == pytest.approx(0.05 + math.hypot(0.04, 0.15))
    assert again.p == pytest.approx(2.0 * ndtr(-1.959964 * 0.05 / math.hypot(0.04, 0.01)))


def test_a_size_that_only_one_survey_has_is_compared_with_none() -> None:
    a, b = pair(5, how=ALL)

    def shares(**bins: float) -> tuple[Measure, ...]:
        return tuple(
            Measure(f"size_share_{name}_cm", value, 0.9 * value, 1.1 * value, "", "from 100 that stand clear")
            for name, value in bins.items()
        )

    a = replace(a, measures=(*shares(**{"020_025": 1.0}), told("patch_count", 4.0, 4.0, 5.0)))
    b = replace(b, measures=(*shares(**{"020_025": 0.6, "035_040": 0.4}), told("patch_count", 6.0, 6.0, 7.0)))
    found = {one.name: one for one in COMPARING.compare(a, b).measures}
    assert set(found) == {"size_share_020_025_cm", "size_share_035_040_cm"}
    new = found["size_share_035_040_cm"]
    assert (new.before, new.after) == (0.0, 0.4)
    assert 0.0 < new.low < new.change < new.high
    assert change_words.difference_cells(new)[1] == "+40 points"


def test_surveys_that_were_measured_otherwise_are_doubted() -> None:
    a, b = pair(5, how=ALL)
    b = replace(b, made_by={"measuring": {"calibration": {"size": 0.95}}})
    (doubt,) = doubts(a, b)
    assert "different calibrations" in doubt


def test_figures_of_other_things_than_a_survey_measures_have_other_names(less: list[Comparison]) -> None:
    """Peaks that were found are about half of the individuals; cells of target are less than the reef."""
    every = [told.differences for told in less] + [part.differences for told in less for part in told.patches]
    names = {one.name for differences in every for one in differences}
    assert {"found", "found_density", "target_area"} <= names
    assert not names & {"count", "density", "area", "reef_area"}


def test_ground_that_only_the_later_survey_saw_counts_beyond_the_box_of_the_earlier_one() -> None:
    a, b = pair(9, how=STILL)
    half = a.layers.state.shape[1] // 2
    bounds = replace(a.layers.bounds, x_max=a.layers.bounds.x_min + half * a.layers.cell)
    west = replace(
        a.layers,
        bounds=bounds,
        **{
            name: getattr(a.layers, name)[:, :half]
            for name in ("state", "target_probability", "relief", "times_seen")
        },
    )
    found = COMPARING.compare(replace(a, layers=west), b)
    beyond = float((b.layers.state[:, half:] > 0).sum()) * a.layers.cell**2
    assert found.only_b == pytest.approx(beyond, rel=0.05)


def other(patch: int, share: float, seed: int) -> tuple[Survey, Survey]:
    """Two surveys; some of one patch are not there yet in the first, others no more in the second."""
    rng = np.random.default_rng(seed)
    whole = reef(rng)
    return (
        survey(without(whole, patch, share, rng), rng, ALL, "first"),
        survey(without(whole, patch, share, rng), rng, ALL, "second"),
    )


@pytest.mark.rare
def test_as_many_deaths_as_arrivals_are_mixed_though_the_count_stays() -> None:
    told = [COMPARING.compare(*other(1, 0.2, seed)) for seed in range(6)]
    assert sum(one.patches[1].verdict == "mixed" for one in told) >= 5
    assert sum(one.patches[k].verdict != "no change shown" for one in told for k in (0, 2, 3)) <= 1
    counts = [next(d for d in one.patches[1].differences if d.name == "found") for one in told]
    assert np.mean([count.p > 0.05 for count in counts]) > 0.6


@pytest.mark.rare
def test_fewer_but_larger_are_mixed_and_larger_alone_a_gain() -> None:
    rng = np.random.default_rng(3)
    before = reef(rng)
    grown = replace(before, size=np.where(before.patch == 2, 1.35, 1.0) * before.size)
    fewer = without(grown, 2, 0.25, rng)
    a, larger, both = (survey(one, rng, ALL) for one in (before, grown, fewer))
    verdicts = [[patch.verdict for patch in COMPARING.compare(a, b).patches] for b in (larger, both)]
    none = "no change shown"
    assert verdicts == [[none, none, "gain", none], [none, none, "mixed", none]]
    # No other has come: it is what is covered that tells.
    gained = COMPARING.compare(a, larger).patches[2]
    assert gained.come is not None
    assert gained.come.p > 0.05


def test_surveys_that_their_individuals_do_not_lay_on_each_other_are_told_by_numbers() -> None:
    """What stands a hand aside would seem gone."""
    comparing = Comparing(registering=Registering(sure=math.inf, sure_wide=math.inf))
    found = comparing.compare(*pair(6, how=ALL))
    assert found.registration.by == "map"
    assert all(patch.gone is None and patch.come is None for patch in found.patches)
    assert {patch.verdict for patch in found.patches} == {"no change shown"}


def test_a_patch_beyond_the_box_of_the_earlier_survey_is_told_as_not_comparable() -> None:
    a, b = pair(9, how=STILL)
    away = replace(b.patches[0], rings=tuple(ring + 100.0 for ring in b.patches[0].rings))
    found = COMPARING.compare(a, replace(b, patches=(*b.patches, away)))
    beyond = found.patches[-1]
    assert (beyond.before, beyond.after, beyond.seen) == (None, (len(b.patches),), 0.0)
    assert beyond.verdict == "not comparable"
    alone = COMPARING.compare(replace(a, patches=()), replace(b, patches=(away,)))
    assert [patch.verdict for patch in alone.patches] == ["not comparable"]


def test_without_pictures_the_individuals_tell() -> None:
    a, b = (replace(one, picture=None) for one in pair(5, 0.3, ALL))
    verdicts = [patch.verdict for patch in COMPARING.compare(a, b).patches]
    assert verdicts == ["no change shown", "loss", "no change shown", "no change shown"]
    assert {d.name for d in COMPARING.compare(a, b).patches[0].differences} == {"found", "target_area"}


def test_the_other_way_round_a_loss_is_a_gain() -> None:
    a, b = pair(6, 0.3, ALL)
    there, back = COMPARING.compare(a, b), COMPARING.compare(b, a)
    assert there.patches[1].verdict == "loss"
    assert back.patches[1].verdict == "gain"
    assert there.patches[1].gone is not None
    assert back.patches[1].come is not None
    assert there.patches[1].gone.share == pytest.approx(back.patches[1].come.share, abs=0.05)
    for one, turned in zip(there.patches[1].differences, back.patches[1].differences, strict=True):
        assert one.change == pytest.approx(-turned.change, abs=0.05 * max(1.0, one.before))


def test_a_patch_that_is_gone_is_lost_ground_and_one_that_came_is_gained() -> None:
    rng = np.random.default_rng(7)
    whole = reef(rng)

    def only(patches: tuple[int, ...]) -> Survey:
        kept = np.isin(whole.patch, patches)
        part = Reef(whole.position[kept], whole.size[kept], whole.patch[kept])
        found = survey(part, np.random.default_rng(8), STILL)
        state = found.layers.state.copy()
        x = BOX.x_min + 0.25 * (np.arange(state.shape[1]) + 0.5)
        y = BOX.y_min + 0.25 * (np.arange(state.shape[0]) + 0.5)
        for k, (mid_x, mid_y, a, b) in enumerate(AREAS):
            if k not in patches:
                inside = (x[None, :] - mid_x) ** 2 / (a + 1) ** 2 + (y[:, None] - mid_y) ** 2 / (b + 1) ** 2
                state[(inside < 1.0) & (state == 2)] = 1
        renumbered = np.searchsorted(patches, found.individuals.patch).astype(np.int32)
        return replace(
            found,
            layers=replace(found.layers, state=state),
            patches=tuple(found.patches[k] for k in patches),
            individuals=replace(found.individuals, patch=renumbered),
        )

    found = COMPARING.compare(only((0, 1, 2)), only((0, 2, 3)))
    verdicts = {(patch.before, patch.after): patch.verdict for patch in found.patches}
    assert verdicts == {
        (0, (0,)): "no change shown",
        (1, ()): "loss",
        (2, (1,)): "no change shown",
        (None, (2,)): "gain",
    }
    ground = found.as_dict()["ground_m2"]
    assert ground["loss"] == pytest.approx(math.pi * 9.0, rel=0.2)
    assert ground["gain"] == pytest.approx(math.pi * 10.0, rel=0.2)


def test_only_ground_that_both_saw_is_compared() -> None:
    a, b = pair(9, how=STILL)
    state = b.layers.state.copy()
    state[:, : state.shape[1] // 2] = 0
    found = COMPARING.compare(a, replace(b, layers=replace(b.layers, state=state)))
    assert [patch.verdict for patch in found.patches] == [
        *("not comparable", "no change shown", "not comparable", "no change shown")
    ]
    assert found.patches[0].p is None
    assert (found.change[:, : state.shape[1] // 2 - 1] == Change.NOT_COMPARABLE).all()
    west = a.individuals.position[:, 0] < 19.0
    assert (found.fate_a[west] == Fate.NOT_COMPARABLE).all()
    both = (a.layers.state > 0) & (state > 0)
    assert found.comparable == pytest.approx(both.sum() * 0.0625, rel=0.02)


def test_a_wreck_is_told_by_its_area() -> None:
    found = COMPARING.compare(scenes.wreck(), scenes.wreck())
    assert [patch.verdict for patch in found.patches] == ["no change shown"] * len(found.patches)
    assert [difference.name for difference in found.differences] == ["target_area"]


# --- The parts


@pytest.mark.parametrize("rate", [0.1, 0.4, 0.9])
def test_the_share_that_is_found_comes_from_those_that_are(rate: float) -> None:
    rng = np.random.default_rng(3)
    looks = rng.integers(1, 12, 40_000)
    hits = rng.binomial(looks, rate)
    found = hits > 0
    share = detection(hits[found].astype(np.int32), looks[found].astype(np.int32))
    assert (1.0 / share).sum() == pytest.approx(40_000, rel=0.02)


def test_many_tests_are_held_to_a_rate_of_false_ones() -> None:
    p = np.random.default_rng(1).uniform(0.0, 1.0, 20) ** 3
    mixed = [None, *p.tolist(), None]
    assert np.array(adjusted(mixed)[1:-1]) == pytest.approx(false_discovery_control(p))
    assert adjusted(mixed)[0] is None


def test_cells_within_rings_are_those_that_a_plotting_library_finds() -> None:
    one = scenes.reef()
    grid = _Grid(one.layers)
    x, y = np.meshgrid(grid.x, grid.y)
    points = np.column_stack([x.ravel(), y.ravel()])
    for patch in one.patches:
        expected = Outline(patch.rings[0]).contains_points(points)
        for hole in patch.rings[1:]:
            expected &= ~Outline(hole).contains_points(points)
        assert (grid.within(patch.rings).ravel() != expected).sum() <= 2


def test_parts_that_touch_at_a_corner_are_polygons_of_their_own_with_their_holes() -> None:
    def square(x: float, y: float, side: float) -> np.ndarray:
        return np.array([(x, y), (x + side, y), (x + side, y + side), (x, y + side), (x, y)])

    shape = wkb.multipolygon([square(0, 0, 4), square(4, 4, 3), square(5, 5, 1)[::-1], square(1, 1, 1)[::-1]])
    assert wkb.kind(shape) == 6
    assert wkb.envelope(shape) == (0.0, 7.0, 0.0, 7.0)
    parts = [
        wkb.polygon([square(0, 0, 4), square(1, 1, 1)[::-1]]),
        wkb.polygon([square(4, 4, 3), square(5, 5, 1)[::-1]]),
    ]
    assert shape[9:] == b"".join(parts)


# --- As files


def test_the_change_is_written_as_a_picture_layers_and_figures(
    less: list[Comparison], tmp_path: Path
) -> None:
    png, gpkg, text, html = written = write_change(less[0], tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert html.name == "change.html"
    with Image.open(png) as picture:
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 5
    assert json.loads(text.read_text()) == less[0].as_dict()
    database = sqlite3.connect(gpkg)
    assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    verdicts = [row[0] for row in database.execute("SELECT verdict FROM patches ORDER BY patch")]
    fates = dict(
        database.execute("SELECT fate, count(*) FROM individuals WHERE survey = 'before' GROUP BY 1")
    )
    database.close()
    assert verdicts == [patch.verdict for patch in less[0].patches]
    assert fates["lost"] == (less[0].fate_a == Fate.LOST).sum()


CHANGES = {
    Change.NOT_COMPARABLE: "not comparable",
    Change.BARE: "bare",
    Change.KEPT: "kept",
    Change.GAIN: "gain",
    Change.LOSS: "loss",
}


@pytest.mark.few(2)
@pytest.mark.parametrize("site", [None, replace(SITE, heading_deg=33.0)])
def test_gdal_opens_the_ground_as_one_valid_area_of_each_kind(
    site: Site | None, less: list[Comparison], tmp_path: Path
) -> None:
    """All of the earlier survey's box: bare ground is told from ground that one of them did not see."""
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    change = less[0].change.copy()
    # Cells that touch at a corner, and a hole that touches its outline in one.
    change[40:48, 40:48] = Change.GAIN
    change[41, 41] = change[42, 42] = change[47, 47] = Change.LOSS
    change[39, 39] = Change.GAIN
    comparison = replace(less[0], a=replace(less[0].a, site=site), change=change)
    _, gpkg, *_ = write_change(comparison, tmp_path)
    assert [name for name, _ in pyogrio.list_layers(gpkg)] == [
        *("ground", "patches", "individuals", "layer_styles")
    ]
    meta, _, geometry, (kinds, areas) = pyogrio.raw.read(gpkg, layer="ground", columns=["change", "area_m2"])
    assert kinds.tolist() == list(CHANGES.values())
    cells = np.bincount(change.ravel(), minlength=len(Change))
    assert areas == pytest.approx(cells * comparison.cell**2)
    shapes = shapely.from_wkb(geometry)
    assert shapely.is_valid(shapes).all()
    assert set(shapely.get_type_id(shapes)) == {6}
    if site is None:
        assert shapely.area(shapes) == pytest.approx(areas)
        box = comparison.bounds
        whole = shapely.box(box.x_min, box.y_min, box.x_max, box.y_max)
        assert shapely.union_all(shapes).symmetric_difference(whole).area < 1e-9
    else:
        assert meta["crs"] == "EPSG:4326"
        geod = pytest.importorskip("pyproj").Geod(ellps="WGS84")
        there = [abs(geod.geometry_area_perimeter(shape)[0]) for shape in shapes]
        assert there == pytest.approx(areas, rel=1e-4)
    _, _, geometry, _ = pyogrio.raw.read(gpkg, layer="patches")
    assert shapely.is_valid(shapely.from_wkb(geometry)).all()


def test_every_kind_of_thing_in_the_layers_has_a_look_of_its_own(
    less: list[Comparison], tmp_path: Path
) -> None:
    _, gpkg, *_ = write_change(less[0], tmp_path)
    with contextlib.closing(sqlite3.connect(gpkg)) as database:
        drawn = dict(
            database.execute(
                "SELECT f_table_name, styleQML FROM layer_styles "
                "WHERE useAsDefault AND f_geometry_column = 'geom'"
            )
        )
        assert set(drawn) == {"ground", "patches", "individuals"}
        for layer, style in drawn.items():
            (renderer,) = ElementTree.fromstring(style.partition("\n")[2]).iter("renderer-v2")
            assert renderer.get("type") == "categorizedSymbol"
            there = {
                one for (one,) in database.execute(f"SELECT DISTINCT {renderer.get('attr')} FROM {layer}")
            }
            looks = {
                symbol.get("name"): tuple(
                    (option.get("name"), option.get("value")) for option in symbol.iter("Option")
                )
                for symbol in renderer.iter("symbol")
            }
            kinds = {one.get("value"): looks[one.get("symbol")] for one in renderer.iter("category")}
            assert there
            assert there <= set(kinds)
            assert len(kinds) == len(looks)
            told = set(kinds) - {"hidden"}  # Drawn as what is there, as on the picture.
            assert len({kinds[kind] for kind in told}) == len(told)
            if layer == "ground":
                assert set(kinds) == set(CHANGES.values())
                for change in (Change.BARE, Change.KEPT, Change.GAIN, Change.LOSS):
                    red, green, blue = (int(GROUND[change][at : at + 2], 16) for at in (1, 3, 5))
                    assert ("color", f"{red},{green},{blue},255") in kinds[CHANGES[change]]


FULL = """
import pickle, resource, sys
from pathlib import Path
from unittest import mock
from dream.survey import change_map

comparison = pickle.loads(sys.stdin.buffer.read())
for folder in map(Path, sys.argv[1:]):
    owner = change_map.json if folder.name == "dumps" else change_map
    go_on = getattr(owner, folder.name)

    def without_room(*of, **more):
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
        return go_on(*of, **more)

    with mock.patch.object(owner, folder.name, without_room):
        try:
            change_map.write_change(comparison, folder)
        except OSError as error:
            print(error)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
"""


@pytest.mark.rare
def test_on_a_full_disk_no_part_of_the_change_is_written_and_what_was_there_stays(
    same: list[Comparison], tmp_path: Path
) -> None:
    """The system itself makes no file longer: each time it is another one of the four that is cut off."""
    told = same[0].as_dict()
    before = dict.fromkeys(FILES, b"of before")
    # By which it is known whose change this is.
    before["change.json"] = json.dumps({which: told[which] for which in ("before", "after")}).encode()
    # Each is called just before its file is written.
    folders = [tmp_path / name for name in ("draw", "write_change_layers", "dumps", "change_page")]
    for folder in folders:
        folder.mkdir()
        for name, content in before.items():
            (folder / name).write_bytes(content)
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-c", FULL, *folders],
        input=pickle.dumps(same[0]),
        capture_output=True,
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, b"")
    for folder, line in zip(folders, ended.stdout.decode().splitlines(), strict=True):
        reason = "disk I/O error" if folder.name == "write_change_layers" else "File too large"
        assert line.startswith(
            f"could not write the change to {folder} ({reason}). Nothing there was changed"
        )
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.rare
def test_a_comparison_that_fails_leaves_no_folder(
    same: list[Comparison], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files.write(same[0].a, tmp_path / "one")
    files.write(replace(same[0].b, site=replace(SITE, name="Other reef")), tmp_path / "other")
    files.write(same[0].b, tmp_path / "again")
    compare = ["survey", "compare", str(tmp_path / "one")]
    there = set(tmp_path.rglob("*"))
    for out in ("new", "new/within", "."):
        failing = [*compare, str(tmp_path / "other"), "--out", str(tmp_path / out)]
        assert run_command(failing) == 2
        assert set(tmp_path.rglob("*")) == there

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("dream.survey.change_map.draw", full)
        assert run_command([*compare, str(tmp_path / "again"), "--out", str(tmp_path / "new/within")]) == 2
    assert set(tmp_path.rglob("*")) == there
    # A folder that was there stays, though it is empty.
    (tmp_path / "empty").mkdir()
    assert run_command([*compare, str(tmp_path / "other"), "--out", str(tmp_path / "empty")]) == 2
    assert (tmp_path / "empty").is_dir()


def test_a_folder_in_the_place_of_a_file_leaves_all_as_it_was(same: list[Comparison], tmp_path: Path) -> None:
    (tmp_path / "change.html").mkdir()
    with pytest.raises(OSError, match=r"could not write the change to .*change\.html is a folder"):
        write_change(same[0], tmp_path)
    assert [path.name for path in tmp_path.rglob("*")] == ["change.html"]


def test_the_map_of_a_change_is_turned_to_the_north(less: list[Comparison]) -> None:
    """With y bearing east, what lies along y is drawn to the right: ground, outlines and individuals."""
    comparison = replace(less[0], a=replace(less[0].a, site=replace(SITE, heading_deg=90.0)))
    figure, axes = new_figure(4.0, 4.0)
    draw_on(axes, comparison, corners_of(comparison.bounds))
    figure.canvas.draw()
    (image,) = axes.images
    drawn = axes.transData.inverted().transform(image.get_transform().transform(((1.0, 2.0),)))
    assert drawn[0] == pytest.approx((2.0, -1.0), abs=1e-6)
    gone = less[0].a.individuals.position[less[0].fate_a == Fate.LOST, :2]
    assert len(gone) > 10
    offsets = axes.collections[1].get_offsets()
    assert np.asarray(offsets) == pytest.approx(gone[:, ::-1] * [1.0, -1.0], abs=1e-6)
    x, y = less[0].patches[0].rings[0].T
    assert np.asarray(axes.lines[0].get_xydata()) == pytest.approx(np.column_stack([y, -x]), abs=1e-6)


def test_the_map_of_a_change_shows_where_both_looked_though_it_is_one_cell(
    same: list[Comparison], tmp_path: Path
) -> None:
    change = np.full_like(same[0].change, Change.NOT_COMPARABLE)
    change[10, 20] = Change.BARE
    png, *_ = write_change(replace(same[0], change=change), tmp_path)
    bare = np.array([0xD8, 0xD2, 0xC4])
    rows, _ = np.nonzero((np.asarray(Image.open(png).convert("RGB")) == bare).all(axis=2))
    # The cell fills the sheet, and is no dot among the ground that one of them saw.
    assert np.ptp(rows) > 300


def test_the_page_tells_what_the_figures_hold_and_loads_nothing(
    less: list[Comparison], tmp_path: Path
) -> None:
    png, _, figures, html = write_change(less[0], tmp_path)
    told, text = json.loads(figures.read_text()), html.read_text()
    seen = Seen(text)
    patches = seen.text.partition("Patch by patch")[2].partition("All that both saw")[0]
    whole = seen.text.partition("All that both saw")[2].partition("How one was laid on the other")[0]
    for where, differences in (
        (whole, told["differences"]),
        *((patches, patch["differences"]) for patch in told["patches"]),
    ):
        assert differences
        for one in (Difference(**difference) for difference in differences):
            assert f"{number(one.before)} → {number(one.after)}" in where
            assert all(typeset(cell) in where for cell in change_words.difference_cells(one))
            assert p_value(one.p) in where
    for verdict in VERDICTS:
        rows = [patch for patch in told["patches"] if patch["verdict"] == verdict]
        assert text.count(f">{verdict}<") == len(rows)
    for share in (patch[what] for patch in told["patches"] for what in ("gone", "come")):
        assert f"{share['bare']} of {share['of']}" in patches
    for line in (*change_words.summary(less[0]), *change_words.limits(less[0])):
        assert line in seen.text
    assert f"{100.0 * told['registration']['sigma_m']:.1f} cm (one sigma)" in seen.text
    assert f"{told['registration']['pairs']} individuals that both found" in seen.text
    assert f"Seen by both{number(told['ground_m2']['comparable'])} m²" in seen.text
    assert "script" not in seen.tags
    assert all(load.startswith("data:") for load in seen.loads)
    assert "default-src 'none'" in text
    assert base64.b64decode(seen.loads[-1].partition("data:image/png;base64,")[2]) == png.read_bytes()


def test_words_of_a_stranger_stay_words_on_the_page(less: list[Comparison]) -> None:
    evil = "<script>alert(1)</script>\"'&amp;{{map}}"
    a = replace(
        less[0].a,
        site=Site(evil, 1.0, 2.0, datum=evil),
        name=evil,
        protocol=evil,
        made_by={"world": evil, "planner": evil},
    )
    laid = replace(less[0].registration, note=evil)
    seen = Seen(change_page(replace(less[0], a=a, b=a, registration=laid), b"", VERDICTS, [(evil, evil)]))
    assert "script" not in seen.tags
    # Title, heading, how, doubt, note, and most of what is told of two surveys.
    assert seen.text.count(evil) > 15


def bare(survey: Survey) -> Survey:
    """It saw the same ground, on which nothing is."""
    people = survey.individuals
    none = {name: getattr(people, name)[:0] for name in people.__dataclass_fields__}
    state = np.minimum(survey.layers.state, 1)
    return replace(
        survey,
        patches=(),
        picture=None,
        individuals=replace(people, **none),
        layers=replace(survey.layers, state=state),
    )


def half(survey: Survey, *, east: bool) -> Survey:
    """It saw but half of the ground, and nothing near the middle."""
    state = survey.layers.state.copy()
    middle = state.shape[1] // 2
    state[:, slice(0, middle + 12) if east else slice(middle, None)] = 0
    return replace(survey, layers=replace(survey.layers, state=state))


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("itself", ("All 4 patches show no change.", "Both are first: expected two of a site.")),
        ("nothing", ("Neither survey shows a patch, and there is no verdict.", "the poses are taken.")),
        ("gone", ("All 4 patches are called a loss.", "The table tells of the others.")),
        ("apart", ("The two surveys looked at no ground in common", "0 m²")),
        ("no origin", ("Neither run had an origin", "What changed between two surveys")),
        ("wreck", ("Both outlines show no change.", "Hull and pieces", "was not measured but guessed wide")),
    ],
)
def test_a_page_of_what_is_rare_says_what_is_so(kind: str, says: tuple[str, ...]) -> None:
    a, b = pair(4, how=ALL)
    pairs = {
        "itself": (a, a),
        "nothing": (bare(a), bare(b)),
        "gone": (a, bare(b)),
        "apart": (half(a, east=False), half(b, east=True)),
        "no origin": (replace(a, site=None), replace(b, site=None)),
        "wreck": (scenes.wreck(), scenes.wreck()),
    }
    comparison = COMPARING.compare(*pairs[kind])
    seen = Seen(change_page(comparison, b"", VERDICTS))
    for words in says:
        assert words in seen.text
    assert not re.search(r"\bnan\b|\binf\b|None", seen.text)
    assert ("Patch by patch" in seen.text) == (bool(comparison.patches) and kind != "wreck")
    assert ("those that were found, which are not all" in seen.text) == (kind != "wreck")


def test_a_density_that_fell_is_as_sure_as_the_same_one_that_rose() -> None:
    counts, areas = (592.0, 520.0), (34.4, 40.1)

    def told(first: int, second: int) -> tuple[float, float, float]:
        count = _difference("found", counts[first], counts[second], 26.0, "")
        area = _difference("target_area", areas[first], areas[second], 5.5, "m2")
        density = _density(count, area)
        return density.low, density.high, density.p

    low, high, p = told(0, 1)
    assert told(1, 0) == pytest.approx((-high, -low, p))
    # The delta method of a ratio, by a draw of a million.
    rng = np.random.default_rng(5)
    area = np.array(areas) + rng.normal(0.0, 5.5 / math.sqrt(2.0), (1_000_000, 2))
    count = np.array(counts) + rng.normal(0.0, 26.0 / math.sqrt(2.0), (1_000_000, 2))
    spread = float((count / area @ (-1.0, 1.0)).std())
    assert (high - low) / (2.0 * 1.96) == pytest.approx(spread, rel=0.1)
