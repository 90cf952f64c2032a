"""From a survey to what a mission is told: the same cells, wherever the two frames lie."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from dream.geometry import Bounds
from dream.mapping.prior import Prior
from dream.survey import Survey
from dream.survey.prior import frames_told, prior_of
from dream.types import Target
from tests.survey.scenes import AREA, BEGAN, CELL, SITE, WRECK_SITE, reef, wreck


def moved(survey: Survey, east: float, north: float, heading_deg: float) -> Survey:
    """The same survey told in a frame whose origin lies that far off its own, by its site."""
    site = replace(
        SITE,
        latitude=SITE.latitude + north / 111_300.0,
        longitude=SITE.longitude + east / (111_300.0 * math.cos(math.radians(SITE.latitude))),
        heading_deg=heading_deg,
    )
    return replace(survey, site=site)


def test_on_the_same_cells_it_holds_what_the_survey_held() -> None:
    survey = reef()
    prior = prior_of(survey, AREA, CELL, site=SITE, now=BEGAN + timedelta(days=730.5))
    np.testing.assert_array_equal(prior.target, survey.layers.target_probability)
    np.testing.assert_array_equal(prior.solid, np.isin(survey.layers.state, (3, 4)))
    assert (prior.bounds, prior.cell, prior.source) == (AREA, CELL, survey.name)
    assert prior.years == pytest.approx(2.0)


def test_a_larger_box_holds_nothing_beyond_the_survey() -> None:
    wide = Bounds(AREA.x_min - 5.0, AREA.y_min, AREA.x_max, AREA.y_max + 2.0)
    prior = prior_of(reef(), wide, CELL)
    assert np.isnan(prior.target[:, : round(5.0 / CELL)]).all()
    np.testing.assert_array_equal(
        prior.target[: round(AREA.depth / CELL), round(5.0 / CELL) :], reef().layers.target_probability
    )


def test_a_shifted_and_turned_frame_brings_targets_to_the_same_place_on_earth() -> None:
    survey = moved(reef(), 4.0, -3.0, SITE.heading_deg + 90.0)
    wide = Bounds(-40.0, -40.0, 40.0, 40.0)
    prior = prior_of(survey, wide, CELL, site=SITE)
    row, col = np.nonzero(np.nan_to_num(prior.target) > 0.5)
    here = SITE.east_north(wide.x_min + (col + 0.5) * CELL, wide.y_min + (row + 0.5) * CELL)
    layers = survey.layers
    row, col = np.nonzero(np.nan_to_num(layers.target_probability) > 0.5)
    assert survey.site is not None
    there = survey.site.east_north(
        layers.bounds.x_min + (col + 0.5) * CELL, layers.bounds.y_min + (row + 0.5) * CELL
    )
    shift = np.array([4.0, -3.0])
    np.testing.assert_allclose(np.mean(here, axis=1), np.mean(there, axis=1) + shift, atol=0.05)
    assert len(here[0]) == pytest.approx(len(there[0]), rel=0.02)


def test_how_the_frames_were_brought_together_is_said() -> None:
    assert "neither says" in frames_told(reef(site=None), None)
    assert "one of the two" in frames_told(reef(), None)
    assert "shifted by 5.0 m and turned by 90.0°" in frames_told(moved(reef(), 4.0, -3.0, 110.0), SITE)


@pytest.mark.parametrize(
    ("survey", "site", "message"),
    [
        (wreck(), None, "expected a survey of oysters"),
        (
            reef(site=replace(WRECK_SITE, name=SITE.name)),
            SITE,
            "of this place, got one whose origin is [0-9]+",
        ),
        (moved(reef(), 0.0, 6_000.0, 20.0), SITE, r"of this place, got one whose origin is 6\.0 km away"),
        (reef(site=replace(SITE, name="Outer reef")), SITE, "of 'Inner reef', .* got one of 'Outer reef'"),
        (moved(reef(), 500.0, 0.0, 20.0), SITE, "saw nothing of it"),
    ],
)
def test_a_survey_of_something_else_is_refused(survey: Survey, site: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        prior_of(survey, AREA, CELL, target=Target.OYSTERS, site=site)  # type: ignore[arg-type]


def test_a_site_is_the_same_however_its_name_is_written() -> None:
    survey = reef(site=replace(SITE, name=f" {SITE.name.upper()} "))
    prior = prior_of(survey, AREA, CELL, site=SITE)
    np.testing.assert_array_equal(prior.target, survey.layers.target_probability)


def test_a_survey_from_after_the_mission_is_refused() -> None:
    with pytest.raises(ValueError, match="from before the mission"):
        prior_of(reef(), AREA, CELL, now=BEGAN - timedelta(days=1))


def test_it_is_kept_with_a_run_and_read_again(tmp_path: Path) -> None:
    prior = prior_of(reef(), AREA, CELL)
    prior.save(tmp_path / "prior.npz")
    again = Prior.load(tmp_path / "prior.npz", prior.as_dict(), AREA, CELL)
    np.testing.assert_array_equal(again.target, prior.target)
    assert (again.sigma, again.years, again.source) == (prior.sigma, prior.years, prior.source)
    (tmp_path / "prior.npz").write_bytes((tmp_path / "prior.npz").read_bytes()[:200])
    with pytest.raises(ValueError, match=r"prior\.npz: expected"):
        Prior.load(tmp_path / "prior.npz", prior.as_dict(), AREA, CELL)
