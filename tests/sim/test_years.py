"""A reef some years on: what changes, what stays, and that it is the same on every call."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from dream.evaluation.suites import family_of
from dream.sim.files import load_world, save_world, world_hash
from dream.sim.validity import check_world
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.sim.years import A_YEAR, LARGEST, Change, later
from tests.sim.made import made

NOTHING = Change(growth=0.0, mortality=0.0, outbreak=0.0, stricken=0.0, recruitment=0.0, burial=0.0)
HASH = "d9401af74b4266fc"
"""First digits of that of reef/string 1 a year on, future 3. A change changes what results mean: say why."""


@pytest.fixture(scope="module")
def on() -> World:
    return later(made("reef/string"), 1.0, 3)


def across(world: World) -> npt.NDArray[np.float64]:
    return np.asarray(world.targets.scale[:, :2].astype(np.float64).mean(axis=1))


def test_a_name_and_a_seed_give_the_same_future_for_ever(on: World) -> None:
    assert (on.name, on.seed) == ("reef/string+1y3", 1)
    assert world_hash(on)[:16] == HASH
    assert world_hash(make_world("reef/string+1y3", 1)) == world_hash(on)
    assert world_hash(later(made("reef/string"), 1.0, 4)) != world_hash(on)


def test_what_does_not_live_stays_as_it_was(on: World) -> None:
    before = made("reef/string")
    for name in ("bounds", "starts", "water", "meshes", "seed", "protocol"):
        assert getattr(on, name) == getattr(before, name)
    for field in dataclasses.fields(before.obstacles):
        np.testing.assert_array_equal(
            getattr(on.obstacles, field.name), getattr(before.obstacles, field.name)
        )


def test_the_seabed_only_rises_and_only_on_the_reef(on: World) -> None:
    before = made("reef/string")
    rise = on.terrain.heights - before.terrain.heights
    assert rise.min() == 0.0
    assert 0.2 < rise.max() < 0.5
    row, col = np.nonzero(rise)
    places = np.stack([before.terrain.x0 + col * 0.25, before.terrain.y0 + row * 0.25], axis=1)
    reef = before.targets.position[:, :2]
    assert max(np.hypot(*(reef - place).T).min() for place in places) < 2.1


def test_it_is_a_valid_world_that_can_be_saved(on: World, tmp_path: Path) -> None:
    check_world(on)
    save_world(on, tmp_path)
    assert world_hash(load_world(tmp_path)) == world_hash(on)


def test_without_change_nothing_changes_but_the_name() -> None:
    before = made("reef/patch")
    after = later(before, 2.0, 1, NOTHING)
    assert world_hash(dataclasses.replace(after, name=before.name)) == world_hash(before)


def test_clumps_grow_by_von_bertalanffy_towards_the_largest() -> None:
    before = made("reef/patch")
    after = later(before, 1.0, 1, dataclasses.replace(NOTHING, growth=0.5))
    expected = np.maximum(LARGEST - (LARGEST - across(before)) * np.exp(-0.5), across(before))
    np.testing.assert_allclose(across(after), expected, atol=2e-4)
    np.testing.assert_array_equal(after.targets.position, before.targets.position)


def test_as_many_die_as_the_rate_says_and_some_patches_suffer_more() -> None:
    before = made("reef/string")
    usual = later(before, 2.0, 1, dataclasses.replace(NOTHING, mortality=0.3))
    share = len(usual.targets) / len(before.targets)
    assert share == pytest.approx(0.49, abs=4.0 * np.sqrt(0.25 / len(before.targets)))
    struck = later(before, 1.0, 2, dataclasses.replace(NOTHING, outbreak=0.9, stricken=0.5))
    counts = np.bincount(before.targets.group)
    alive = {tuple(p) for p in struck.targets.position.tolist()}
    lived = np.array([tuple(p) in alive for p in before.targets.position.tolist()])
    shares = np.bincount(before.targets.group[lived], minlength=len(counts)) / counts
    assert ((shares == 1.0) | (shares < 0.3)).all()
    assert 0 < (shares < 0.3).sum() < len(counts)


def test_recruits_settle_near_the_living() -> None:
    before = made("reef/string")
    after = later(before, 1.0, 1, dataclasses.replace(NOTHING, recruitment=0.2))
    new = after.targets.position[len(before.targets) :, :2]
    assert 0.1 < len(new) / len(before.targets) <= 0.2
    away = [np.hypot(*(before.targets.position[:, :2] - place).T).min() for place in new]
    assert max(away) < 3.0


def test_sand_buries_about_the_share_that_is_asked_for() -> None:
    before = made("reef/mixed")
    after = later(before, 1.0, 1, dataclasses.replace(NOTHING, burial=0.2))
    assert 0.2 <= 1.0 - len(after.targets) / len(before.targets) < 0.3


def test_a_family_stays_itself() -> None:
    assert family_of("reef/patch+2.5y7") == "patch"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("wreck/5+1y1", "expected a reef"),
        ("flat/empty+1y1", "expected a reef"),
        ("reef/strng+1y1", "Did you mean"),
        ("reef/string+0y1", "more than 0"),
        ("reef/string+101y1", "up to 100"),
        ("reef/string+1y", "Did you mean"),
    ],
)
def test_what_is_no_reef_or_no_year_is_refused(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_world(name, 1)


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(Change)])
def test_a_rate_out_of_range_is_refused_by_name(field: str) -> None:
    with pytest.raises(ValueError, match=f"{field}: expected"):
        dataclasses.replace(A_YEAR, **{field: -0.1})
    with pytest.raises(ValueError, match=f"{field}: expected"):
        dataclasses.replace(A_YEAR, **{field: float("nan")})
