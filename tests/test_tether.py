"""The tether: how it lies when it is taut, how far it lets a mission go, and the way back along it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.commands.homing import Homing
from dream.control import guard
from dream.evaluation.runner import simulate
from dream.geometry import SE2, Bounds, FloatArray
from dream.homeward import Budget, Homeward, tether
from dream.homeward.strands import WAYS, Strand, Strands, StrandWater
from dream.homeward.tether import MOST_TURNS, TetherKeeper
from dream.homeward.ways import after, way_home
from dream.mapping import OccupancyMap
from dream.mapping._kernels.strings import FreeWater
from dream.mapping.leash import Leash, flat_water
from dream.planning import Belief
from dream.protocol import DREAM_V1, protocol_named
from dream.recording import read_steps, read_summary
from dream.robots.bluerov2.standin.rig import Rig
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import BoolArray, Decision, Guarded, Step
from tests.robots.bluerov2 import rigged

CELL = 0.25
HALF = 12.0
"""Metres from the middle of the water to its sides."""


def water_without(solid: Callable[[FloatArray, FloatArray], BoolArray]) -> FreeWater:
    """Flat water but for what is solid at (x, y)."""
    at = np.arange(-HALF + 0.5 * CELL, HALF, CELL)
    return flat_water(~solid(*np.meshgrid(at, at)), (-HALF, -HALF), CELL)


def square(side: float) -> FreeWater:
    """With a square pillar in the middle."""
    return water_without(lambda x, y: (abs(x) < 0.5 * side) & (abs(y) < 0.5 * side))


def pillar(radius: float) -> FreeWater:
    """With a round one."""
    return water_without(lambda x, y: np.hypot(x, y) < radius)


OPEN = water_without(lambda x, y: np.zeros(x.shape, np.bool_))


def level(free: FreeWater) -> StrandWater:
    """As it is at one height."""
    return StrandWater(free, free)


def along(water: FreeWater, places: list[tuple[float, float]]) -> Strand:
    """Of a vehicle that went straight from place to place, at one height: there it lies in one way alone."""
    lies = Strands.at((*places[0], 0.0))
    for place in places[1:]:
        lies = lies.to((*place, 0.0), level(water))
        assert len(lies.ways) == 1
    return lies.ways[0]


def circle(radius: float, turns: float) -> list[tuple[float, float]]:
    """Places on a way round the middle, from the west."""
    angles = math.pi + np.linspace(0.0, 2.0 * math.pi * turns, math.ceil(24 * abs(turns)) + 1)
    return [(radius * math.cos(a), radius * math.sin(a)) for a in angles]


# ------------------------------------------------------------------------------------------- how it lies


def test_where_nothing_is_solid_it_is_as_long_as_the_distance() -> None:
    strand = along(OPEN, [(-9.0, -9.0), (3.0, -8.0), (9.0, 5.0), (-2.0, 9.0)])
    assert strand.length == pytest.approx(math.hypot(7.0, 18.0), abs=1e-9)
    assert strand.turns == 0.0


def test_it_lies_round_the_corners_of_a_square() -> None:
    strand = along(square(4.0), [(-6.0, 0.0), (-6.0, 5.0), (6.0, 5.0), (6.0, 0.0)])
    bend = math.atan2(2.0, 4.0)
    assert strand.length == pytest.approx(2.0 * math.hypot(4.0, 2.0) + 4.0, abs=0.1)
    assert strand.turns == pytest.approx(2.0 * bend / (2.0 * math.pi), abs=0.01)


@pytest.mark.parametrize("turns", [1.0, -1.0, 1.75])
def test_it_lies_along_tangents_and_an_arc_of_a_round_pillar(turns: float) -> None:
    far, radius = 8.0, 3.0
    strand = along(pillar(radius), circle(far, turns))
    # Each tangent takes this angle of the way round.
    seen = math.acos(radius / far)
    arc = 2.0 * math.pi * abs(turns) - 2.0 * seen
    exact = 2.0 * math.sqrt(far**2 - radius**2) + radius * arc
    assert exact - 0.1 <= strand.length <= 1.06 * exact
    assert strand.turns == pytest.approx(arc / (2.0 * math.pi), abs=0.04)


@pytest.mark.parametrize("turns", [0.6, 1.5])
def test_there_and_back_leaves_nothing_out(turns: float) -> None:
    places = circle(7.0, turns)
    strand = along(pillar(3.0), [*places, *places[-2::-1]])
    assert strand.length == pytest.approx(0.0, abs=1e-6)
    assert strand.turns == 0.0


def test_once_round_and_back_at_the_start_it_lies_round() -> None:
    back = along(square(4.0), [(-6.0, 0.0), (-6.0, 6.0), (6.0, 6.0), (6.0, -6.0), (-6.0, -6.0), (-6.0, 0.0)])
    assert back.length == pytest.approx(2.0 * math.hypot(4.0, 2.0) + 12.0, abs=0.2)


def test_the_sides_of_a_pillar_are_told_apart() -> None:
    left = along(square(4.0), [(-6.0, 0.0), (0.0, 5.0), (6.0, 0.0)])
    right = along(square(4.0), [(-6.0, 0.0), (0.0, -5.0), (6.0, 0.0)])
    assert left.length == pytest.approx(right.length, abs=0.1)
    assert left.points[1:-1, 1].min() > 1.9
    assert right.points[1:-1, 1].max() < -1.9


def test_in_space_it_goes_over_a_wall_the_short_way() -> None:
    free = np.ones((20, 40, 40), np.uint8)
    free[:8, :, 20] = 0
    water = StrandWater.of(FreeWater(free, np.zeros(3), np.full(3, CELL)))
    lies = Strands.at((2.0, 5.0, 1.0))
    for place in [(2.0, 8.0, 4.0), (8.0, 8.0, 4.0), (8.0, 5.0, 1.0)]:
        lies = lies.to(place, water)
    # Over the edge at z = 2 between x = 5 and 5.25, straight across.
    exact = math.hypot(3.0, 1.0) + CELL + math.hypot(2.75, 1.0)
    (strand,) = lies.ways
    assert exact - 1e-6 <= strand.slid(water.free).length <= exact + 0.15
    # Held a box away from the wall's edge at most, where that is no other way to lie.
    assert exact <= strand.length <= exact + 0.75


def boulder(height: float, foot: float = 4.0) -> StrandWater:
    """A pyramid so high, with its foot so far from the middle, on the ground at z = 0; and water to z = 5."""
    at = np.arange(-HALF + 0.5 * CELL, HALF, CELL)
    east, north = np.meshgrid(at, at)
    top = height * (1.0 - np.maximum(abs(east), abs(north)) / foot)
    levels = np.arange(0.5 * CELL, 5.0, CELL)
    free = (levels[:, None, None] > top[None]).astype(np.uint8)
    return StrandWater.of(FreeWater(free, np.array([-HALF, -HALF, 0.0]), np.full(3, CELL)))


def test_what_it_lies_over_it_may_stay_on_or_slide_off() -> None:
    water = boulder(4.0, 2.0)
    over = [(-8.0, 0.5, 4.5), (8.0, 0.5, 4.5), (8.0, 0.5, 0.5), (8.0, 3.5, 0.5)]
    lies = Strands.at((-8.0, 0.5, 0.5))
    for place in over:
        lies = lies.to(place, water)
    straight = math.hypot(16.0, 3.0)
    assert lies.ways[-1].length <= straight + 0.25
    assert lies.ways[0].points[:, 2].max() > 2.5
    assert lies.length > straight + 1.0
    # Held there, it comes in as it went out; slid off to the north, that winds it round the boulder.
    for place in [*over[-2::-1], (-8.0, 0.5, 0.5)]:
        lies = lies.to(place, water)
    assert lies.ways[-1].length == pytest.approx(0.0, abs=1e-6)
    assert lies.length > 16.0
    assert lies.turns > 0.4


def test_once_a_move_is_taken_back_it_lies_as_it_did() -> None:
    water, places = boulder(4.0, 2.0), [(-8.0, 0.5, 4.5), (8.0, 0.5, 4.5), (8.0, 0.5, 0.5)]
    lies = Strands.at((-8.0, 0.5, 0.5))
    lay = [lies := lies.to(place, water) for place in places]
    # Turns on the spot in between change nothing.
    for _ in range(3):
        lies = lies.to(places[-1], water)
        assert lies.ways[0].was is lay[-1].ways[0].was
    for before in lay[-2::-1]:
        (lay_so,), place = before.ways, before.ways[0].points[-1].tolist()
        lies = lies.to(tuple(place), water)
        assert any(np.array_equal(one.points, lay_so.points) for one in lies.ways)
    # What slid off is pulled taut from where it lies now; what shows to be solid is not lain through again.
    strand = replace(lay[2].ways[0], was=None)
    assert strand.taken_back(places[1], water.free) is None
    wall = water.free.free.copy()
    wall[:, :, 48] = 0
    assert lay[2].ways[0].taken_back(places[1], water.free) is not None
    assert lay[2].ways[0].taken_back(places[1], water.free._replace(free=wall)) is None


def test_what_comes_off_something_does_not_lie_over_it_again() -> None:
    before, after_it = (
        Strand(np.array([(0.0, 0.0, 0.0), bend, (4.0, 0.0, 0.0)]))
        for bend in [(2.0, 3.0, 0.0), (2.0, 0.5, 0.0)]
    )
    stays = before.after_move(before, before)
    assert stays.was is None
    moved = Strand(before.points + np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]))
    assert before.after_move(moved, moved).was is before
    assert before.after_move(moved, after_it).was is None
    assert before.after_move(after_it, after_it).was is None


def test_the_more_friction_the_less_it_slides() -> None:
    rng, water, strand = np.random.default_rng(2), boulder(3.0).free, Strand.at((-8.0, 0.0, 0.5))
    lengths = []
    for x, y in rng.uniform(-10.0, 10.0, (60, 2)):
        for place in [(x, y, 4.5), (x, y, 0.5)][: 2 if max(abs(x), abs(y)) > 4.5 else 1]:
            strand = strand.to(place, water)
            lengths.append([strand.slid(water, friction).length for friction in (0.0, 0.5, math.inf)])
    slid, held, stays = np.array(lengths).T
    assert (slid <= held + 0.01).all()
    assert (held <= stays + 0.01).all()
    assert min((held > slid + 0.1).mean(), (stays > held + 0.1).mean()) > 0.3


def test_of_ways_to_lie_the_longest_and_the_shortest_are_kept() -> None:
    rng, water = np.random.default_rng(1), boulder(3.0)
    lies, least = Strands.at((-8.0, 0.0, 0.5)), Strand.at((-8.0, 0.0, 0.5))
    most = 1
    for x, y in rng.uniform(-10.0, 10.0, (60, 2)):
        for place in [(x, y, 4.5), (x, y, 0.5)][: 2 if max(abs(x), abs(y)) > 4.5 else 1]:
            lies = lies.to(place, water)
            least = least.to(place, water.free).slid(water.free)
            lengths = [one.length for one in lies.ways]
            assert lengths == sorted(lengths, reverse=True)
            assert lengths[-1] <= least.length + 0.75
            most = max(most, len(lengths))
    assert most == WAYS


def test_what_turns_out_to_be_solid_where_it_lies_it_goes_round_on_its_side() -> None:
    strand = along(square(4.0), [(-6.0, 0.0), (-6.0, 5.0), (6.0, 5.0), (6.0, 0.0)])
    wider = Strands((strand,)).to((6.0, 0.0, 0.0), level(square(5.0)))
    assert wider.length == pytest.approx(2.0 * math.hypot(3.5, 2.5) + 5.0, abs=0.15)
    again = wider.to((6.0, 0.0, 0.0), level(square(4.0)))
    assert again.length == pytest.approx(strand.length, abs=0.1)


def test_where_all_turns_out_to_be_solid_it_stays_as_it_lay() -> None:
    strand = along(square(4.0), [(-6.0, 0.0), (0.0, 5.0), (6.0, 0.0)])
    nowhere = water_without(lambda x, y: np.ones(x.shape, np.bool_))
    assert strand.to((6.0, 0.0, 0.0), nowhere).length == pytest.approx(strand.length, abs=1e-6)


# ----------------------------------------------------------------------------------- how far it lets go


def test_a_leash_goes_round_corners() -> None:
    water = water_without(lambda x, y: (abs(x) < CELL) & (y < 4.0))
    lengths = Leash((-4.0, 0.0, 0.0), 16.0).lengths(water, np.array([-10.0, -10.0, 0.0]), 0.5, (1, 41, 41))[0]
    at = {place: lengths[round((place[1] + 10) / 0.5), round((place[0] + 10) / 0.5)] for place in FAR}
    assert at[-8.0, 3.0] == pytest.approx(5.0, abs=1e-6)
    round_it = 2.0 * math.hypot(3.75, 4.0) + 0.5
    assert round_it - 1e-6 <= at[4.0, 0.0] <= 1.02 * round_it
    assert at[9.0, -9.0] == math.inf


def test_a_leash_leaves_out_what_is_closed() -> None:
    leash, low = Leash((-4.0, 0.0, 0.0), 16.0), np.array([-10.0, -10.0, 0.0])
    without = replace(leash, closed=(((1.0, 2.1, 0.0), 0.55),))
    open_, closed = (one.lengths(OPEN, low, 0.5, (1, 41, 41))[0] for one in (leash, without))
    assert math.isfinite(open_[24, 22])
    changed = np.argwhere(open_ != closed)
    assert changed.tolist() == [[24, 21], [24, 22], [24, 23], [25, 22]]
    assert (closed[tuple(changed.T)] == math.inf).all()


FAR = [(-8.0, 3.0), (4.0, 0.0), (9.0, -9.0)]


def test_it_lets_nobody_wind_it_beyond_the_limit(empty_world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tether, "water_in", lambda occupancy: level(pillar(2.0)))
    occupancy = OccupancyMap(empty_world.bounds, DREAM_V1)
    start = (0.0, -4.0, 0.0)
    held = TetherKeeper(100.0, start)
    once = [Decision(math.radians(30.0), 2.0)] * 12
    pose = SE2(0.0, -4.0, -math.radians(30.0))
    lies = list(held.along(2 * once, held.lies, pose, 0.0, occupancy))
    assert 0.4 < lies[11].turns < MOST_TURNS
    assert [held.over(one, held.lies) > 0.0 for one in lies].index(True) > 12
    assert held.over(lies[-1], held.lies) == pytest.approx(lies[-1].turns - 0.9)
    assert held.over(lies[-1], held.lies, back=True) == pytest.approx(lies[-1].turns - 1.0)
    assert held.over(lies[-1], lies[-1]) == 0.0
    long = TetherKeeper(12.0, start)
    assert max(long.over(one, long.lies) for one in long.along(once, long.lies, pose, 0.0, occupancy)) > 0.0


def wound(moves: int, monkeypatch: pytest.MonkeyPatch) -> tuple[TetherKeeper, SE2, OccupancyMap]:
    """So many moves, of which twelve lead once round a pillar, where everything else is free."""
    monkeypatch.setattr(tether, "water_in", lambda occupancy: level(pillar(2.0)))
    occupancy = OccupancyMap(Bounds(-HALF, -HALF, HALF, HALF), replace(DREAM_V1, launch_radius=3.0 * HALF))
    occupancy.clear_launch(0.0, 0.0)
    held, pose = TetherKeeper(100.0, (0.0, -4.0, 0.0)), SE2(0.0, -4.0, -math.radians(30.0))
    for _ in range(moves):
        pose, _ = after(pose, 0.0, Decision(math.radians(30.0), 2.0), occupancy)
        held.lies = held.lies.to((pose.x, pose.y, 0.0), level(pillar(2.0)))
        held.trail = held.trail.then((pose.x, pose.y, 0.0))
    return held, pose, occupancy


@pytest.mark.parametrize("pieces", [tether.PIECES, ()], ids=["beside the trail", "as it came"])
def test_the_way_back_takes_it_off_what_it_was_wound_round(
    pieces: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tether, "PIECES", pieces)
    held, pose, occupancy = wound(12, monkeypatch)
    came = held.trail.length
    assert math.hypot(pose.x, pose.y + 4.0) < 1.0
    way = held.way(held.lies, pose, 0.0, occupancy, held.anchor)
    assert way is not None
    *_, last = held.along(way, held.lies, pose, 0.0, occupancy)
    assert last.length <= 1.0
    assert held.trail.length < came + (0.1 if not pieces else -1.0)


def test_to_another_place_it_goes_back_as_far_as_needed_and_round(monkeypatch: pytest.MonkeyPatch) -> None:
    held, pose, occupancy = wound(14, monkeypatch)
    goal = (3.5, 2.0, 0.0)
    assert held.lies.to(goal, level(pillar(2.0))).turns > MOST_TURNS - 0.1
    way = held.way(held.lies, pose, 0.0, occupancy, goal)
    assert way is not None
    *_, last = held.along(way, held.lies, pose, 0.0, occupancy)
    assert last.ways[0].points[-1] == pytest.approx(goal, abs=0.3)
    assert last.turns < 0.3


def test_who_is_back_where_the_tether_may_be_in_is_home(monkeypatch: pytest.MonkeyPatch) -> None:
    held, _, occupancy = wound(12, monkeypatch)
    held.lies = held.lies.to(held.anchor, level(pillar(2.0)))
    wound_round, back = held.lies.ways[0], SE2(*held.anchor[:2], 0.0)
    assert wound_round.length > 10.0
    assert not held.may_be_in(back, 0.0, occupancy)
    held.lies = Strands((wound_round, Strand.at(held.anchor)))
    assert held.may_be_in(back, 0.0, occupancy)
    assert not held.may_be_in(SE2(2.0, -4.0, 0.0), 0.0, occupancy)
    # Before it goes home for good, what may be out counts.
    assert not held.comes_in(held.lies, back, 0.0, occupancy)
    assert held.comes_in(Strands.at(held.anchor), back, 0.0, occupancy)


def test_a_way_back_for_which_there_is_not_enough_is_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    held, pose, occupancy = wound(12, monkeypatch)
    back = held.way(held.lies, pose, 0.0, occupancy, held.anchor)
    assert back is not None
    less = held.way(held.lies, pose, 0.0, occupancy, held.anchor, affords=lambda moves: len(moves) < 3)
    assert less is not None
    assert len(less) < 3 < len(back)
    *_, last = [held.lies, *held.along(less, held.lies, pose, 0.0, occupancy)]
    assert last.length > 1.0


@pytest.mark.parametrize(("protocol", "away"), [("dream-v1", 2.0), ("dream-v1", 1.0), ("dream-v2", 0.5)])
def test_what_is_closed_is_never_where_the_vehicle_is_or_came_along(protocol: str, away: float) -> None:
    rules = protocol_named(protocol)
    occupancy = OccupancyMap(Bounds(-HALF, -HALF, HALF, HALF), replace(rules, launch_radius=3.0))
    held = TetherKeeper(40.0, (0.0, 0.0, -5.0))
    occupancy.clear_launch(0.0, 0.0, -5.0)
    occupancy.hold(held.leash)
    assert held.close((away, 0.0, -5.0), held.anchor, occupancy)
    occupancy.hold(held.leash)
    start = SE2(0.0, 0.0, 0.0)
    assert way_home(start, -5.0, occupancy, (0.0, 1.0, -5.0))
    assert way_home(start, -5.0, occupancy, (away, 0.0, -5.0)) is None
    held.trail = held.trail.then((0.0, 2.0, -5.0))
    assert not held.close((0.0, 2.0, -5.0), (0.0, 1.0, -5.0), occupancy)


def test_to_and_fro_leaves_no_trail() -> None:
    trail = Strand.at((0.0, 0.0, 0.0)).then((2.0, 0.0, 0.0)).then((2.0, 2.0, 0.0))
    assert trail.then((2.1, 0.1, 0.0), 0.25).points.tolist() == [[0.0, 0.0, 0.0], [2.1, 0.1, 0.0]]
    assert len(trail.then((4.0, 2.0, 0.0), 0.25).points) == 4
    out = Strand.at((0.0, 0.0, 0.0)).then((2.0, 0.0, 0.0))
    assert out.then((0.1, 0.1, 0.0), 0.25).points.tolist() == [[0.0, 0.0, 0.0], [0.1, 0.1, 0.0]]


def test_it_counts_how_often_it_is_led_to_a_place() -> None:
    held = TetherKeeper(40.0, (0.0, 0.0, 0.0))
    assert [held.times_led(place) for place in [(5.0, 0.0, 0.0), (5.5, 0.5, 0.0)]] == [1, 2]
    assert held.times_led((5.0, 3.0, 0.0)) == 1


# ---------------------------------------------------------------------------------------------- missions


@pytest.fixture(scope="module")
def reef() -> World:
    return make_world("reef/patch", 3)


def flown(world: World, max_steps: int, budget: Budget, protocol: str = "dream-v1") -> list[Step]:
    rules = protocol_named(protocol)
    return list(simulate(world, Belief(), rules, budget=budget, max_steps=max_steps))


@pytest.mark.parametrize(
    ("protocol", "metres", "away"),
    [
        ("dream-v1", 12.0, None),
        ("dream-v1", 12.0, (3.0, 4.0)),
        ("dream-v1-nav", 5.0, None),
        ("dream-v2", 8.0, None),
    ],
)
def test_a_mission_keeps_to_its_tether_and_comes_home_along_it(
    reef: World, protocol: str, metres: float, away: tuple[float, float] | None
) -> None:
    begins = reef.starts[0]
    home = None if away is None else (begins.x + away[0], begins.y + away[1])
    steps = flown(reef, 60, Budget(tether_m=metres, home=home), protocol)
    start, last = steps[0].observation.pose, steps[-1]
    assert last.ended in ("done", "returned")
    for step in steps:
        assert start.distance(step.observation.pose) <= 0.95 * metres
        assert step.home is not None
        balances = {balance.name: balance for balance in step.home.balances}
        if balances:
            assert not balances["tether"].short
            assert not balances["winding"].short
            assert balances["tether"].margin == pytest.approx(0.05 * metres + 3.0 * step.arrival.sigma)
            assert balances["tether"].way >= start.distance(step.observation.pose) - 1e-6
    assert max(start.distance(step.observation.pose) for step in steps) > 0.5 * metres
    x, y = home or (start.x, start.y)
    assert math.hypot(last.observation.pose.x - x, last.observation.pose.y - y) < 0.5
    assert last.home is not None
    if home is None:
        assert next(one.way for one in last.home.balances if one.name == "tether") <= 1.0
    assert not any(step.arrival.collided for step in steps)


@pytest.mark.parametrize("lasts", [True, False])
def test_where_the_map_leaves_no_way_on_which_it_comes_in_it_goes_back_as_it_came(
    reef: World, monkeypatch: pytest.MonkeyPatch, lasts: bool
) -> None:
    asked, sure = 0, TetherKeeper.comes_in

    def comes_in(held: TetherKeeper, lies: Strands, pose: SE2, z: float, occupancy: OccupancyMap) -> bool:
        nonlocal asked
        asked += 1
        unsure = asked > 16 and (lasts or asked < 19)
        return not unsure and sure(held, lies, pose, z, occupancy)

    monkeypatch.setattr(TetherKeeper, "comes_in", comes_in)
    steps = flown(reef, 30, Budget(tether_m=40.0))
    told = [step.decision.reasoning.action.startswith("Going back as it came") for step in steps]
    first = told.index(True)
    assert first > 5
    places = [(round(step.observation.pose.x, 2), round(step.observation.pose.y, 2)) for step in steps]
    came, back = list(dict.fromkeys(places[:first])), places[first - 1 : first + sum(told)]
    turned_at = list(dict.fromkeys(back))
    assert turned_at == came[::-1][: len(turned_at)]
    last = steps[-1]
    assert last.home is not None
    if lasts:
        assert last.ended == "returned"
        assert last.home.why == "no way is known on which all of a tether of 40 m comes in"
        assert places[-1] == places[0]
    else:
        assert back[-1] != places[0]
        assert max(math.dist(place, places[0]) for place in places[first + sum(told) :]) > 2.0


def test_back_at_the_start_as_it_came_what_is_out_is_taken_in(reef: World) -> None:
    step = flown(reef, 1, Budget(tether_m=40.0))[0]
    homeward = Homeward.of(Budget(tether_m=40.0), step.observation, 40, step.occupancy, ticking=False)
    held = homeward.tether
    assert held is not None
    away = np.array([(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (6.0, 6.0, 0.0), (0.0, 0.0, 0.0)])
    held.lies = Strands((Strand(np.array(held.anchor) + away), Strand.at(held.anchor)))
    told = []
    for steps in (1, 2):
        homeward.stands(step.observation, step.occupancy, steps)
        told.append((homeward.leads, held.lies.length > 20.0))
    assert told == [(True, True), (False, False)]


def test_a_trail_that_is_blocked_far_off_is_gone_back_along_to_there(monkeypatch: pytest.MonkeyPatch) -> None:
    held, pose, occupancy = wound(6, monkeypatch)
    x, y, _ = held.trail.points[2].tolist()
    whole = list(held.moves_back(held.trail, pose, 0.0, occupancy))
    assert None not in whole

    def blocked(move: Decision, pose: SE2, occupancy: OccupancyMap, *rest: Any) -> Guarded:
        to, _ = after(pose, 0.0, move, occupancy)
        return guard(move if math.hypot(to.x - x, to.y - y) > 0.5 else Decision(), pose, occupancy, *rest)

    monkeypatch.setattr(tether, "guard", blocked)
    cut = list(held.moves_back(held.trail, pose, 0.0, occupancy))
    assert cut[-1] is None
    assert 2 < len(cut) < len(whole)
    assert cut[:-1] == whole[: len(cut) - 1]


def test_a_tether_that_is_never_taut_changes_nothing(reef: World) -> None:
    free = list(simulate(reef, Belief(), DREAM_V1, max_steps=15, budget=Budget()))
    held = flown(reef, 15, Budget(tether_m=1000.0))
    for one, other in zip(free[:8], held[:8], strict=True):
        assert one.decision == other.decision


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--tether-m", "0"], "--tether-m: expected a number above 0, got 0"),
        (["--tether-m", "2"], "tether: expected 2.6 m or more, for one move of dream-v1"),
        (["--tether-m", "5", "--return", "0,0"], "home: expected a place within 4.8 m of the start"),
    ],
)
def test_bad_tethers_are_told_before_there_is_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    assert run_command(["run", "--protocol", "dream-v1", *options, "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.rare
def test_a_dive_keeps_to_its_tether(tmp_path: Path) -> None:
    metres = 1.5
    with Rig(tmp_path, make_world("pool/arc", 1), pictures=5.0) as rig:
        dived = rigged.dive(rig, tmp_path, max_steps=24, homing=Homing(tether_m=metres))
    assert dived.error is None
    summary, steps = read_summary(tmp_path), read_steps(tmp_path)
    assert summary is not None
    assert summary.ended in ("done", "returned")
    assert summary.home is not None
    assert summary.home["reached"]
    start = steps[0].pose
    away = [math.hypot(step.pose.x - start.x, step.pose.y - start.y) for step in steps]
    assert 0.2 * metres < max(away) <= 0.95 * metres
