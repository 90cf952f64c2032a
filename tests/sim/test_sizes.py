"""Worlds of a wanted size and water."""

from __future__ import annotations

import pytest

from dream.evaluation.suites import family_of
from dream.sim.sizes import Size, sized
from dream.sim.validity import check_world
from dream.sim.world import World
from dream.sim.worlds import SIZABLE, make_world, origin


@pytest.mark.parametrize("kind", [name for name in SIZABLE if not name.startswith("wreck")] + ["wreck/5"])
@pytest.mark.few(4)
def test_a_world_has_the_size_and_the_water_that_its_name_says(kind: str) -> None:
    world = make_world(f"{kind}+46x36v6.5", 900_001)
    assert (world.bounds.width, world.bounds.depth) == (46.0, 36.0)
    assert world.water.visibility == pytest.approx(6.5, rel=1e-3)
    assert world.name == f"{kind}+46x36v6.5"
    assert len(world.targets) > 0
    check_world(world)
    targets = world.targets.position[:, :2]
    assert world.bounds.x_min <= targets[:, 0].min()
    assert targets[:, 0].max() <= world.bounds.x_max


def test_another_size_or_seed_is_another_world() -> None:
    def told(world: World) -> tuple[object, ...]:
        return world.bounds, world.water.name, world.targets.position.tobytes()

    names = [("reef/tiny+30x30", 1), ("reef/tiny+30x32", 1), ("reef/tiny+30x30v5", 1), ("reef/tiny+30x30", 2)]
    assert len({told(make_world(*one)) for one in names}) == len(names)
    assert told(make_world(*names[0])) == told(make_world(*names[0]))


def test_its_name_is_read_as_it_was_written() -> None:
    for size in (Size(40, 30), Size(100, 26, 3.0), Size(26, 98, 12.5)):
        assert sized(f"wreck/1+{size}") == ("wreck/1", size)
    assert sized("reef/string+1y2") is None
    assert sized("wreck/1+reef/patch") is None


def test_it_is_of_the_family_that_it_is_a_size_of() -> None:
    assert origin("reef/mound+40x30v6") == "reef/mound"
    assert family_of("reef/mound+40x30v6") == family_of("reef/mound")
    assert family_of("wreck/2+60x40") == "wreck"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("reef/mound+40x31", "two even numbers of metres from 26 to 100"),
        ("reef/mound+200x40", "two even numbers of metres from 26 to 100"),
        ("reef/mound+40x30v90", "visibility: expected 1 to 30 m"),
        ("reef/string+40x30", "world that can be made in any size"),
        ("wreck/1+26x26", "expected room for wreck 1 and 4 m around it, got 26x26 m"),
    ],
)
def test_a_size_that_there_is_not_is_refused(name: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make_world(name, 900_001)
