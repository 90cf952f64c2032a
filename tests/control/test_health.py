"""What is wrong has a name, and a reaction."""

from __future__ import annotations

import math
from dataclasses import fields

import pytest

from dream.control.health import REACTIONS, Condition, Reaction, Watch

WELL = {"imu_age": 0.01, "depth_age": 0.1, "dvl_age": 0.2, "velocity_sigma": 0.01, "position_sigma": 0.3}


def condition(**worse: float) -> Condition:
    return Watch().condition(**{**WELL, **worse})


@pytest.mark.parametrize(
    ("worse", "name"),
    [
        ({}, Condition.FINE),
        ({"dvl_age": 1.5}, Condition.BLIND),
        ({"dvl_age": 11.0}, Condition.LOST),
        ({"dvl_age": math.inf}, Condition.LOST),
        ({"velocity_sigma": 0.6}, Condition.DIVERGED),
        ({"position_sigma": 6.0}, Condition.DIVERGED),
        ({"velocity_sigma": math.nan}, Condition.DIVERGED),
        ({"imu_age": 0.3}, Condition.STALE),
        ({"imu_age": math.nan}, Condition.STALE),
        ({"depth_age": 2.1}, Condition.STALE),
        ({"dvl_age": math.nan}, Condition.LOST),
    ],
)
def test_each_fault_has_its_name(worse: dict[str, float], name: Condition) -> None:
    assert condition(**worse) is name


def test_the_worst_of_several_counts() -> None:
    assert condition(dvl_age=20.0, velocity_sigma=1.0) is Condition.DIVERGED
    assert condition(dvl_age=20.0, velocity_sigma=1.0, imu_age=1.0) is Condition.STALE


def test_every_condition_has_a_reaction_and_worse_ones_are_no_bolder() -> None:
    order = list(Reaction)
    reactions = [order.index(REACTIONS[one]) for one in sorted(Condition)]
    assert reactions == sorted(reactions)
    assert Condition.FINE.reaction is Reaction.GO
    assert Condition.STALE.reaction is Reaction.SURFACE


@pytest.mark.parametrize("limit", [field.name for field in fields(Watch)])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_limit_that_is_none_is_refused_by_name(limit: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{limit}: expected"):
        Watch(**{limit: value})
