"""Planning with an earlier survey: what it foretells, how far it is believed, and what stays as it is."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dream.evaluation.runner import simulate
from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap, check_completion
from dream.mapping.completion import Region
from dream.mapping.layers import Evidence
from dream.mapping.prior import Prior
from dream.planning import Belief, sentences
from dream.planning.belief import BeliefPilot
from dream.planning.distribution import OBSERVED
from dream.planning.prior_survey import BELIEVED, LIKELY, LOOKS, PriorSurvey
from dream.planning.sources import Expected, ForetoldTargets
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import BoolArray, Mission, Step
from tests.mapping.analytic import AREA, Disc, empty_map, look_around, map_with
from tests.planning.flights import observed_at, situation_of, source_of

SIDE = round(AREA.width / DREAM_V1.cell)
NOWHERE: BoolArray = np.zeros((SIDE, SIDE), np.bool_)


def survey(target: BoolArray, seen: BoolArray | None = None, years: float = 1.0) -> Prior:
    told = np.where(np.ones_like(NOWHERE) if seen is None else seen, np.where(target, 0.99, 0.0), np.nan)
    return Prior(AREA, DREAM_V1.cell, told.astype(np.float32), NOWHERE, years=years)


def patch(row: int, col: int, half: int = 6) -> BoolArray:
    cells = NOWHERE.copy()
    cells[row - half : row + half, col - half : col + half] = True
    return cells


def test_what_is_foretold_is_likeliest_where_it_was_and_never_certain() -> None:
    was = patch(40, 40)
    prior_survey = PriorSurvey(survey(was))
    assert prior_survey.foretold[40, 40] > 0.7
    assert LIKELY < prior_survey.foretold[40, 46] < prior_survey.foretold[40, 40]
    assert 0.0 < prior_survey.foretold[5, 5] < LIKELY
    assert prior_survey.foretold.max() < 1.0


def test_the_older_a_survey_the_less_it_foretells_and_the_more_may_have_come() -> None:
    young, old = (PriorSurvey(survey(patch(40, 40), years=years)).foretold for years in (1.0, 8.0))
    assert old[40, 40] < young[40, 40]
    assert old[5, 5] > young[5, 5]


def test_where_the_survey_saw_nothing_it_foretells_nothing() -> None:
    seen = NOWHERE.copy()
    seen[:, :60] = True
    prior_survey = PriorSurvey(survey(patch(40, 40), seen))
    assert np.isnan(prior_survey.foretold[:, 60:]).all()
    assert not np.isnan(prior_survey.foretold[:, :60]).any()
    beside = np.full(NOWHERE.shape, 0.3, np.float32)
    np.testing.assert_array_equal(prior_survey.weighed(beside, ~NOWHERE)[:, 60:], beside[:, 60:])


def test_a_survey_that_holds_is_believed_and_one_that_does_not_is_not() -> None:
    was = patch(40, 40, 10)
    seen = patch(40, 40, 20)
    right, elsewhere = PriorSurvey(survey(was)), PriorSurvey(survey(patch(85, 85, 10)))
    occupancy = heard(seen, was)
    right.compare(occupancy)
    elsewhere.compare(occupancy)
    assert right.believed > BELIEVED > 0.5 > elsewhere.believed


def heard(of: BoolArray, target: BoolArray) -> OccupancyMap:
    """A map that heard of these cells, some target and the others bare ground."""
    occupancy = map_with(explored=of, target=target & of)
    occupancy._write("votes", (0, 0), (0x30 * (target & of) + 0x03 * (~target & of)).astype(np.uint8))
    return occupancy


def blocks(north: int = 0, east: int = 0) -> BoolArray:
    """Three patches, not in one line nor alike."""
    cells = patch(30 + north, 30 + east, 4) | patch(50 + north, 36 + east, 6)
    return cells | patch(34 + north, 60 + east, 3)


def test_cells_of_which_nothing_was_heard_say_nothing_about_a_survey() -> None:
    prior_survey = PriorSurvey(survey(patch(40, 40, 10)))
    prior_survey.compare(map_with(explored=patch(40, 40, 20)))
    assert prior_survey.believed == pytest.approx(BELIEVED)


def test_the_evidence_for_every_shift_is_what_a_loop_over_the_cells_gives() -> None:
    was, now, of = blocks(), blocks(3, -5), patch(60, 40, 34)
    prior_survey = PriorSurvey(survey(was, seen=patch(40, 44, 36)))
    evidence = prior_survey.evidence(heard(of, now))
    p, usual, most = prior_survey.foretold, prior_survey._usual, evidence.shape[0] // 2
    for north, east in ((0, 0), (3, -5), (-most, most), (most, -7)):
        total = 0.0
        for row, col in np.argwhere(of):
            r, c = row - north, col - east
            if 0 <= r < SIDE and 0 <= c < SIDE and not np.isnan(p[r, c]):
                share = p[r, c] / usual if now[row, col] else (1.0 - p[r, c]) / (1.0 - usual)
                total += float(np.log(share))
        assert evidence[most + north, most + east] == pytest.approx(total, abs=1e-3 + 1e-4 * abs(total))


def test_a_survey_told_in_the_wrong_place_is_moved_to_the_right_one() -> None:
    prior_survey = PriorSurvey(survey(blocks()))
    prior_survey.compare(heard(patch(50, 36, 36), blocks(8, -10)))
    assert prior_survey.shift == (8, -10)
    assert prior_survey.believed > 0.5
    assert prior_survey.spread < 1.0
    assert prior_survey.foretold[38, 20] > 0.5 > prior_survey.foretold[50, 30]
    assert np.isnan(prior_survey.foretold[:8]).all()


def test_the_words_say_by_how_much_a_survey_was_moved() -> None:
    prior_survey, occupancy = PriorSurvey(survey(blocks())), heard(patch(50, 36, 36), blocks(8, -10))
    assert "taken to lie" not in sentences.foretold(prior_survey, occupancy)
    prior_survey.compare(occupancy)
    assert "2.50 m west and 2.00 m north of where it was told" in sentences.foretold(prior_survey, occupancy)


def test_a_survey_told_in_the_right_place_stays_there() -> None:
    prior_survey = PriorSurvey(survey(blocks()))
    told = prior_survey.foretold.copy()
    prior_survey.compare(heard(patch(40, 40, 30), blocks()))
    assert prior_survey.shift == (0, 0)
    np.testing.assert_array_equal(prior_survey.foretold, told)


def test_around_a_target_that_was_not_foretold_it_is_expected_as_without_a_survey() -> None:
    prior_survey = PriorSurvey(survey(patch(40, 40)))
    prior_survey.compare(heard(patch(80, 80, 4), patch(80, 80, 1)))
    assert prior_survey.believed > 0.5
    beside = np.full(NOWHERE.shape, 0.3, np.float32)
    weighed = prior_survey.weighed(beside, ~NOWHERE)
    assert weighed[80, 84] == pytest.approx(0.3)
    assert weighed[60, 80] < 0.1


def test_it_foretells_no_group_where_it_would_have_seen_one() -> None:
    seen = NOWHERE.copy()
    seen[:, :60] = True
    prior_survey = PriorSurvey(survey(patch(40, 40), seen), radius=3.0)
    assert prior_survey.empty[75, 40]
    assert not prior_survey.empty[40, 54]  # 2 m from where targets were,
    assert not prior_survey.empty[75, 80]  # and 5 m from what it saw.


def test_a_survey_that_foretells_nothing_is_no_reason_to_look_elsewhere_first() -> None:
    assert not PriorSurvey(survey(NOWHERE)).empty.any()


def test_where_it_foretells_no_group_moves_with_the_survey() -> None:
    prior_survey = PriorSurvey(survey(blocks()))
    before = prior_survey.empty.copy()
    prior_survey.compare(heard(patch(50, 36, 36), blocks(8, -10)))
    np.testing.assert_array_equal(prior_survey.empty[30:80, 20:60], before[22:72, 30:70])


def test_a_group_has_come_where_none_of_it_was_foretold() -> None:
    prior_survey = PriorSurvey(survey(patch(30, 30)))
    for target, came in ((patch(30, 30), 0), (patch(75, 75, 2), 1), (patch(30, 30) | patch(75, 75, 2), 1)):
        assert prior_survey.came(regions_of(target)) == came


def regions_of(target: BoolArray) -> tuple[Region, ...]:
    return check_completion(map_with(explored=~NOWHERE, target=target), SE2(0.0, 0.0, 0.0)).regions


def told_of(prior: Prior | None, target: BoolArray, believed: float = 1.0, arriving: float = 0.5) -> Expected:
    """What a pilot expects that has searched a part of the ground, and seen these targets."""
    pilot = Belief(glimpse=1.0, arriving=arriving).begin(Mission(DREAM_V1, AREA, 200, prior=prior))
    assert isinstance(pilot, BeliefPilot)
    occupancy = map_with(explored=patch(40, 40, 34), target=target)
    source = source_of(pilot, ForetoldTargets)
    if source is not None:
        source.survey.believed = believed
    return pilot.expect(situation_of(pilot, observed_at(0.0, 0.0, 0.0), occupancy))


def test_where_a_believed_survey_saw_no_group_few_are_to_be_expected() -> None:
    was = patch(40, 40)
    without, believed = told_of(None, was), told_of(survey(was), was)
    fewer = told_of(survey(was), was, arriving=0.05)
    assert 0.0 < fewer.risk < 0.2 * believed.risk < 0.1 * without.risk
    assert fewer.rarity < 0.2 * believed.rarity < 0.1 < without.rarity == 1.0
    np.testing.assert_array_equal(believed.hiding, without.hiding)


def test_the_less_a_survey_is_believed_the_more_the_risk_is_as_without() -> None:
    was = patch(40, 40)
    without = told_of(None, was).risk
    risks = [told_of(survey(was), was, believed).risk for believed in (1.0, 0.5, 0.0)]
    assert risks[0] < risks[1] < risks[2] == pytest.approx(without)
    models = [OBSERVED.uncalibrated(risk) for risk in risks]
    assert models[1] == pytest.approx(0.5 * (models[0] + models[2]))


def test_one_group_that_came_makes_more_of_them_likely() -> None:
    was, came = patch(40, 40), patch(40, 40) | patch(15, 15, 3)
    before, after = (told_of(survey(was), now, arriving=0.05) for now in (was, came))
    assert after.risk > 3.0 * before.risk
    assert after.rarity > 3.0 * before.rarity


def test_where_no_risk_is_accepted_a_round_leaves_no_ground_that_the_survey_does_not_know() -> None:
    was, seen = patch(40, 40), patch(40, 40, 36)
    pilot = Belief(risk=0.0).begin(Mission(DREAM_V1, AREA, 200, prior=survey(was, seen)))
    assert isinstance(pilot, BeliefPilot)
    thought = pilot.consider(observed_at(0.0, 0.0, 0.0), map_with(explored=patch(40, 40, 34), target=was))
    assert thought.plan is not None
    source = source_of(pilot, ForetoldTargets)
    assert source is not None
    assert source.coverage_tour.path == thought.plan.path


def test_a_map_of_nothing_leaves_the_belief_as_it_was() -> None:
    prior_survey = PriorSurvey(survey(patch(40, 40)))
    prior_survey.compare(OccupancyMap(AREA, DREAM_V1))
    assert prior_survey.believed == pytest.approx(BELIEVED)


def test_an_unbelieved_survey_weighs_nothing() -> None:
    prior_survey = PriorSurvey(survey(patch(40, 40)))
    prior_survey.believed = 0.0
    beside = np.full(NOWHERE.shape, 0.3, np.float32)
    np.testing.assert_array_equal(prior_survey.weighed(beside, ~NOWHERE), beside)
    assert prior_survey.solid(OccupancyMap(AREA, DREAM_V1)) is None


def test_a_cell_of_which_nothing_is_heard_is_given_up_after_some_looks() -> None:
    prior_survey, occupancy = PriorSurvey(survey(patch(40, 40))), OccupancyMap(AREA, DREAM_V1)
    assert prior_survey.unheard(occupancy)[40, 40]
    for _ in range(LOOKS):
        prior_survey.look(~NOWHERE, occupancy)
    assert not prior_survey.unheard(occupancy).any()


def test_a_prior_of_another_map_is_refused_before_anything_moves(string_reef: World) -> None:
    small = Prior(
        Bounds(0.0, 0.0, 5.0, 5.0), 0.25, np.zeros((20, 20), np.float32), np.zeros((20, 20), np.bool_)
    )
    with pytest.raises(ValueError, match="prior: expected the map's"):
        simulate(string_reef, Belief(), DREAM_V1, prior=small)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("target", np.zeros((3, 3), np.float32), "target: expected"),
        ("target", np.full(NOWHERE.shape, 1.5, np.float32), "probabilities"),
        ("solid", np.zeros((3, 3), np.bool_), "solid: expected"),
        ("sigma", -1.0, "sigma"),
        ("years", float("nan"), "years"),
    ],
)
def test_a_prior_that_says_nonsense_is_refused(field: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(survey(NOWHERE), **{field: value})


@pytest.fixture(scope="module")
def known(string_reef: World) -> list[Step]:
    """The first steps of a mission that knows the reef as it is."""
    box, cell = string_reef.bounds, DREAM_V1.cell
    shape = round(box.depth / cell), round(box.width / cell)
    was = np.zeros(shape, np.float32)
    col, row = (
        ((string_reef.targets.position[:, k] - low) / cell).astype(int)
        for k, low in ((0, box.x_min), (1, box.y_min))
    )
    was[row, col] = 0.99
    prior = Prior(box, cell, was, np.zeros(shape, np.bool_), source="last year")
    return list(simulate(string_reef, Belief(), DREAM_V1, max_steps=12, prior=prior))


@pytest.mark.rare
def test_it_goes_where_the_targets_were(known: list[Step], string_reef: World) -> None:
    blind = list(simulate(string_reef, Belief(), DREAM_V1, max_steps=12))
    areas = [float(steps[-1].occupancy.target.sum()) for steps in (known, blind)]
    assert areas[0] >= areas[1]
    assert not any(step.arrival.collided for step in known)


def test_its_words_say_whose_survey_it_is_and_that_it_is_believed(known: list[Step]) -> None:
    words = known[-1].decision.reasoning.distribution
    told = re.search(r"The survey last year, 1\.0 years old, is believed to (\d+)%: ([\d.]+) m²", words)
    assert told is not None
    assert int(told[1]) > 50


STAYED, CAME, WENT, BEHIND = (
    *(Disc(3.0, 3.0, 1.2), Disc(-4.0, 3.0, 1.0), Disc(0.0, -4.5, 1.5)),
    Disc(10.5, -10.5, 1.0),
)
"""Groups; the last one lies out of reach of a look around from the middle."""
SHOWN = 0.0501
"""m² to which the words are exact."""


def cells_of(disc: Disc, more: float = 0.0) -> BoolArray:
    """Those whose middles are on it, or at most so many metres beside it."""
    row, col = np.mgrid[:SIDE, :SIDE]
    x, y = (AREA.x_min + (k + 0.5) * DREAM_V1.cell for k in (col, row))
    return np.asarray(np.hypot(x - disc.x, y - disc.y) <= disc.radius + more)


@pytest.mark.parametrize("came", [(), (CAME,)], ids=["none came", "one came"])
@pytest.mark.parametrize("went", [(), (WENT,)], ids=["none went", "one went"])
def test_its_words_say_how_much_is_left_is_new_and_is_gone(
    came: tuple[Disc, ...], went: tuple[Disc, ...]
) -> None:
    # Told a cell larger than it is, so that nothing at its rim is news.
    was = cells_of(STAYED, 0.25) | cells_of(BEHIND)
    for disc in went:
        was |= cells_of(disc)
    occupancy = empty_map()
    for _ in range(2):
        look_around(occupancy, 0.0, 0.0, STAYED, BEHIND, *came)
    pilot = Belief().begin(Mission(DREAM_V1, AREA, 200, prior=survey(was)))
    assert isinstance(pilot, BeliefPilot)
    words = pilot.consider(observed_at(0.0, 0.0, 0.0), occupancy).reasoning.distribution
    told = re.search(
        r"([\d.]+) m² where it foretells targets are still to be seen; "
        r"([\d.]+) m² of targets are new, ([\d.]+) m² are gone",
        words,
    )
    assert told is not None
    left, new, gone = map(float, told.groups())
    square, not_told = DREAM_V1.cell**2, occupancy.target & ~was
    assert new == pytest.approx(square * np.count_nonzero(not_told), abs=SHOWN)
    assert new == pytest.approx(sum(math.pi * disc.radius**2 for disc in came), rel=0.15)
    # Of some cells at a rim no frame said anything: they hold both.
    bare = occupancy.target_probability < 0.9 * Evidence().target_prior
    assert gone == pytest.approx(square * np.count_nonzero(was & bare), abs=SHOWN)
    lost = was & bare & ~cells_of(STAYED, 0.25)
    assert square * np.count_nonzero(lost) == pytest.approx(
        sum(math.pi * disc.radius**2 for disc in went), rel=0.05
    )
    # New ones are foretold beside it, but not a metre away.
    sizes = (square * np.count_nonzero(cells_of(BEHIND, more)) for more in (0.0, 1.0))
    assert next(sizes) < left < next(sizes)


def test_a_survey_of_bare_ground_alone_lowers_no_risk() -> None:
    occupancy = map_with(explored=patch(40, 40, 20), target=patch(40, 40))
    thoughts = []
    for prior in (None, survey(NOWHERE)):
        pilot = Belief(glimpse=1.0).begin(Mission(DREAM_V1, AREA, 200, prior=prior))
        assert isinstance(pilot, BeliefPilot)
        thoughts.append(pilot.consider(observed_at(0.0, 0.0, 0.0), occupancy))
    assert thoughts[0].expected.risk == pytest.approx(thoughts[1].expected.risk)
    assert thoughts[0].completion.complete == thoughts[1].completion.complete


def test_without_a_survey_nothing_is_foretold() -> None:
    pilot = Belief().begin(Mission(DREAM_V1, AREA, 200))
    assert isinstance(pilot, BeliefPilot)
    assert source_of(pilot, ForetoldTargets) is None
