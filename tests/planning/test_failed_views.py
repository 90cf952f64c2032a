"""Views that failed: what is counted, and when it is forgotten."""

from __future__ import annotations

import math

import numpy as np

from dream.geometry import SE2
from dream.mapping import view
from dream.planning.failed_views import GIVEN_UP, FailedViews
from dream.protocol import DREAM_V1
from dream.types import Mission
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import SIDE, all_but

MISSION = Mission(DREAM_V1, AREA, 200)
SLIT = np.s_[70:72, 20:22]
"""Four cells that no observation shows."""
POSE = SE2(-4.0, 2.0, math.pi / 2)
"""From where the map's view promises them."""
AWAY = SE2(8.0, -8.0, 0.0)
"""From where it does not."""


def test_a_cell_counts_each_look_that_should_have_shown_it_and_no_other_does() -> None:
    occupancy = map_with(explored=all_but(SLIT))
    assert view(occupancy, POSE.x, POSE.y, POSE.yaw)[SLIT].all()
    failed = FailedViews(MISSION, 3)
    for looks in range(1, 4):
        failed.note(POSE, occupancy)
        np.testing.assert_array_equal(failed.count, looks * ~occupancy.observed)
    failed.note(AWAY, occupancy)
    assert (failed.count[SLIT] == 3).all()


def test_what_was_promised_counts_too_but_only_once_a_look() -> None:
    occupancy = map_with(explored=all_but(SLIT))
    promised = np.zeros((SIDE, SIDE), np.bool_)
    promised[71, :] = True
    failed = FailedViews(MISSION, 3)
    failed.note(AWAY, occupancy, promised)
    assert failed.count[71, 20:22].tolist() == [1, 1]
    failed.note(POSE, occupancy, promised)
    assert failed.count[71, 20:22].tolist() == [2, 2]
    assert failed.count[70, 20:22].tolist() == [1, 1]
    assert failed.count.sum() == 6, "what is observed never fails to show"


def test_something_new_beside_a_cell_makes_it_worth_looking_at_again() -> None:
    failed = FailedViews(MISSION, 3)
    wide = np.s_[70:72, 20:26]
    for _ in range(3):
        failed.note(POSE, map_with(explored=all_but(wide)))
    nearer = map_with(explored=all_but(np.s_[70:72, 20:25]))
    failed.note(AWAY, nearer)
    assert not failed.count[70:72, 24:26].any(), "they touch the column that is new"
    assert (failed.count[70:72, 20:24] == 3).all(), "these do not"


def test_what_was_known_before_is_not_news() -> None:
    occupancy, failed = map_with(explored=all_but(SLIT)), FailedViews(MISSION, 3)
    failed.note(AWAY, occupancy)
    for _ in range(2):
        failed.note(POSE, occupancy)
    assert (failed.count[SLIT] == 2).all()


def test_noting_a_look_leaves_the_map_and_the_promise_as_they_were() -> None:
    occupancy, promised = map_with(explored=all_but(SLIT)), np.zeros((SIDE, SIDE), np.bool_)
    before = occupancy.observed.copy()
    FailedViews(MISSION, 3).note(POSE, occupancy, promised)
    np.testing.assert_array_equal(occupancy.observed, before)
    assert not promised.any()


def test_patience_decides_what_is_given_up_and_a_new_try_lasts_one_view() -> None:
    occupancy, failed = map_with(explored=all_but(SLIT)), FailedViews(MISSION, 2)
    for given_up in (False, True, True):
        failed.note(POSE, occupancy)
        assert failed.given_up[SLIT].all() == given_up
        assert failed.left(occupancy)[SLIT].all() != given_up
        assert failed.area_given_up(occupancy) == (4 * DREAM_V1.cell**2 if given_up else 0.0)
    failed.give_up(~occupancy.observed)
    assert (failed.count[SLIT] == GIVEN_UP).all()
    failed.try_again()
    assert failed.patience == 3
    assert failed.given_up[SLIT].all(), "once more is asked for than patience lasts"
    assert (failed.count[SLIT] == 4).all()
