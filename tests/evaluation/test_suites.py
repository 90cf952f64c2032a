"""The suites are what they say they are."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import pytest

from dream.evaluation.comparison import FAMILIES
from dream.evaluation.suites import REEF_FAMILIES, SUITES, WEAK, Case, family_of, suite_named
from dream.sim.habitats import HABITATS
from dream.sim.worlds import WORLDS

WIDE = [name.removeprefix("reef/") for name in HABITATS]
EXPECTED = {
    "paper": {"fringing": 1, "string": 1, "patch": 1, "mixed": 2, "letter": 5, "wreck": 5},
    "dev": {**dict.fromkeys(REEF_FAMILIES, 5), "letter": 20, "wreck": 20},
    "test": {**dict.fromkeys(REEF_FAMILIES, 25), "letter": 50, "wreck": 50},
    "dev-v2": {
        **dict.fromkeys(WIDE, 25),
        **{name.removeprefix("reef/"): 100 for name in WEAK},
        "wreck": 20,
        "several": 10,
    },
    "test-v2": {**dict.fromkeys(WIDE, 25), "wreck": 50, "several": 25},
    "test-seen": {
        **dict.fromkeys(WIDE, 5),
        **{name.removeprefix("reef/"): 6 for name in (*WEAK, "reef/two")},
        "wreck": 10,
    },
}


@pytest.mark.parametrize("name", SUITES)
def test_a_suite_has_as_many_worlds_of_each_family_as_it_says(name: str) -> None:
    cases = suite_named(name)
    assert Counter(family_of(case.world) for case in cases) == EXPECTED[name]
    assert len(set(cases)) == len(cases)
    assert {part for case in cases for part in case.world.split("+")} <= set(WORLDS)


def test_no_world_is_in_two_suites() -> None:
    for one, other in combinations(SUITES.values(), 2):
        assert not set(one) & set(other)


def test_the_paper_suite_is_fixed() -> None:
    assert suite_named("paper")[3:6] == (Case("reef/mixed", 1), Case("reef/mixed", 2), Case("reef/L", 1))
    assert {case.start for case in suite_named("paper")} == {0}


def test_letters_and_wrecks_are_spread_evenly() -> None:
    assert Counter(
        case.world for case in suite_named("test") if family_of(case.world) in ("letter", "wreck")
    ) == {
        **{f"reef/{letter}": 10 for letter in "LSOKE"},
        **{f"wreck/{number}": 10 for number in range(1, 6)},
    }


def test_every_world_has_a_family() -> None:
    wide = {name.removeprefix("reef/") for name in HABITATS}
    families = {*REEF_FAMILIES, "letter", "wreck", "pool", "flat", *wide}
    assert set(FAMILIES) == {*families, "several", "other"}
    assert {family_of(world) for world in WORLDS} == families
    assert family_of("reef/string+1y1") == "string"
    assert {family_of(name) for name in ("wreck/1+wreck/2", "wreck/1+reef/S", "wreck/1+reef/S+1y1")} == {
        "several"
    }
    own = ("wreck/harbour", "wreck/1 (changed)", "reef/string+1y1 (changed)", "pool/of mine")
    for stranger in ("reef/X", "reef", "", "lake/1", *own):
        with pytest.raises(ValueError, match="no family"):
            family_of(stranger)


def test_an_unknown_suite_is_answered_with_the_nearest() -> None:
    with pytest.raises(ValueError, match=r'no suite "paepr"\. Did you mean "paper"\?'):
        suite_named("paepr")
