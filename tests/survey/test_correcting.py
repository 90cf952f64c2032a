"""Surveys whose run was wrong about where or when it was, put right."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import UTC, datetime

import numpy as np
import pytest

from dream.survey import files
from dream.survey.correcting import corrections, dated, located
from dream.survey.globe import A, apart
from dream.survey.site import Site
from tests.survey.scenes import BEGAN, SITE, reef

THEN = datetime(2025, 7, 8, 12, tzinfo=UTC)


def test_an_origin_that_is_put_right_keeps_what_the_run_said() -> None:
    there, further = replace(SITE, latitude=54.95), replace(SITE, latitude=54.99)
    survey = located(located(reef(), there), further)
    assert survey.site == further
    assert survey.made_by["corrected"] == {"site": asdict(SITE)}
    assert files.loaded(files.dumped(survey), "it").made_by["corrected"]["site"]["latitude"] == 54.9


def test_an_origin_where_there_was_none_and_the_same_one_correct_nothing() -> None:
    assert located(reef(site=None), SITE).site == SITE
    assert "corrected" not in located(reef(site=None), SITE).made_by
    assert located(reef(), SITE).made_by == reef().made_by


def test_a_date_that_is_put_right_keeps_what_the_run_said_and_by_what_it_was_known() -> None:
    known = replace(reef(), made_by={**reef().made_by, "began_by": "the name of its folder"})
    survey = dated(located(known, replace(SITE, latitude=54.95)), THEN)
    assert survey.began == THEN
    assert survey.made_by["began_by"] == "who added it"
    assert survey.made_by["corrected"] == {
        "site": asdict(SITE),
        "began": BEGAN.isoformat(),
        "began_by": "the name of its folder",
    }
    assert dated(survey, BEGAN).made_by["corrected"]["began_by"] == "the name of its folder"


@pytest.mark.parametrize("foreign", [None, "no", ["at all"]])
def test_what_another_program_put_in_its_place_is_no_obstacle(foreign: object) -> None:
    odd = replace(reef(), made_by={"corrected": foreign, "run": foreign})
    assert dated(odd, THEN).made_by["corrected"]["began"] == BEGAN.isoformat()
    assert odd.run == ("no" if foreign == "no" else None)


def test_it_is_said_by_how_much_an_origin_moves_and_turns() -> None:
    # A ten-thousandth of a degree of the meridian; from 20° to 350° the short way round.
    moved = replace(reef(), site=replace(SITE, latitude=SITE.latitude + 1e-4, heading_deg=350.0))
    (told,) = corrections(reef(), moved)
    assert told == (
        "its origin moves by 11.1 m and turns by -30.0°, from Inner reef (54.900000, 8.300000, heading 20°) "
        "to Inner reef (54.900100, 8.300000, heading 350°)"
    )
    (told,) = corrections(reef(), replace(reef(), site=replace(SITE, longitude=-8.3)))
    assert "moves by 1061.2 km and turns by 0.0°" in told
    assert corrections(reef(), reef()) == ()
    assert corrections(reef(site=None), reef()) == ()


def test_what_does_not_move_an_origin_is_told_as_what_it_is() -> None:
    surer = replace(SITE, name="Outer reef", uncertainty=2.0, datum="LAT")
    before, after = replace(reef(), site=SITE), replace(reef(), site=surer)
    assert corrections(before, after) == (
        "the name of its site is Outer reef, and not Inner reef",
        "the datum of its site is LAT, and not MLLW",
        "the uncertainty of its site is 2 m, and not unknown",
    )
    assert corrections(after, replace(reef(), site=replace(surer, uncertainty=None, datum_offset=0.0))) == (
        "the datum offset of its site is 0 m, and not 0.5 m",
        "the uncertainty of its site is unknown, and not 2 m",
    )


def test_it_is_said_when_a_survey_began_instead() -> None:
    (told,) = corrections(reef(), replace(reef(), began=THEN))
    assert told == "it began at 2025-07-08 12:00:00 UTC, and not at 2026-06-01 09:30:00 UTC"


def test_places_on_the_equator_are_apart_by_the_chord_between_them() -> None:
    one, other = Site("gulf", 0.0, 7.0), Site("gulf", 0.0, -173.0)
    assert apart(one, one) == 0.0
    assert apart(one, other) == pytest.approx(2.0 * A)
    assert apart(one, replace(one, longitude=8.0)) == pytest.approx(2.0 * A * np.sin(np.radians(0.5)))
