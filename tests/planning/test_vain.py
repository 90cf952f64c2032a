"""Looks in vain: what is counted, and when it is forgotten."""

from __future__ import annotations

import math

import numpy as np

from dream.geometry import SE2
from dream.mapping import view
from dream.planning.vain import VainLooks
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
    vain = VainLooks(MISSION)
    for looks in range(1, 4):
        vain.note(POSE, occupancy)
        np.testing.assert_array_equal(vain.count, looks * ~occupancy.observed)
    vain.note(AWAY, occupancy)
    assert (vain.count[SLIT] == 3).all()


def test_what_was_promised_counts_too_but_only_once_a_look() -> None:
    occupancy = map_with(explored=all_but(SLIT))
    promised = np.zeros((SIDE, SIDE), np.bool_)
    promised[71, :] = True
    vain = VainLooks(MISSION)
    vain.note(AWAY, occupancy, promised)
    assert vain.count[71, 20:22].tolist() == [1, 1]
    vain.note(POSE, occupancy, promised)
    assert vain.count[71, 20:22].tolist() == [2, 2]
    assert vain.count[70, 20:22].tolist() == [1, 1]
    assert vain.count.sum() == 6, "what is observed is never looked at in vain"


def test_something_new_beside_a_cell_makes_it_worth_looking_at_again() -> None:
    vain = VainLooks(MISSION)
    wide = np.s_[70:72, 20:26]
    for _ in range(3):
        vain.note(POSE, map_with(explored=all_but(wide)))
    nearer = map_with(explored=all_but(np.s_[70:72, 20:25]))
    vain.note(AWAY, nearer)
    assert not vain.count[70:72, 24:26].any(), "they touch the column that is new"
    assert (vain.count[70:72, 20:24] == 3).all(), "these do not"


def test_what_was_known_before_is_not_news() -> None:
    occupancy, vain = map_with(explored=all_but(SLIT)), VainLooks(MISSION)
    vain.note(AWAY, occupancy)
    for _ in range(2):
        vain.note(POSE, occupancy)
    assert (vain.count[SLIT] == 2).all()


def test_noting_a_look_leaves_the_map_and_the_promise_as_they_were() -> None:
    occupancy, promised = map_with(explored=all_but(SLIT)), np.zeros((SIDE, SIDE), np.bool_)
    before = occupancy.observed.copy()
    VainLooks(MISSION).note(POSE, occupancy, promised)
    np.testing.assert_array_equal(occupancy.observed, before)
    assert not promised.any()
