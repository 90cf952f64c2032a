"""Orders as they are flown, with scripted planners and with each of ours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from dream.course import Planner
from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.geometry import Bounds
from dream.learning.rollouts import Colourless
from dream.mapping import OccupancyMap, check_completion
from dream.mapping.targets import target_extent
from dream.orders import BESIDE, Flown, Leg, Orders, Outcome, Side, SideOf, Task, place, sentences, side_of
from dream.planning import OFFLINE, PLANNERS, Belief
from dream.planning.belief import BeliefPilot
from dream.planning.sources import HullSurface
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND, Asked, Decision, Exchange, Mission, Observation, Reasoning, Step, Target
from tests.planning.flights import situation_of, source_of

BOX = Bounds(-20.0, -20.0, 20.0, 20.0)
NEAR = Bounds(-15.0, 7.0, -11.0, 10.0)
"""Bare ground beside the start of the string reef, all of which the look-around sees."""
OBEYING = [name for name in OFFLINE if name != "random"]


@pytest.fixture(scope="module")
def wreck() -> World:
    return make_world("wreck/1", 1)


@dataclass(slots=True)
class Listening:
    """Turns on the spot, or says done; remembers which missions it was given and when it was asked."""

    done: bool = False
    missions: list[Mission] = field(default_factory=list)

    def begin(self, mission: Mission) -> Listening:
        self.missions.append(mission)
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        return Decision(done=True) if self.done else Decision(turn=DREAM_V1.turn_angles[1])


@cache
def colourless(world: World) -> Colourless:
    return Colourless(world)


def flight(world: World, planner: Planner, **options: Any) -> Iterator[Step]:
    """A mission whose colours, which nobody here looks at, are not drawn."""
    return simulate(world, planner, DREAM_V1, renderer=colourless(world), **options)


def decisions(steps: Iterator[Step]) -> list[tuple[Decision, str]]:
    return [(step.decision, step.ended) for step in steps]


# ------------------------------------------------------------------------------------------- words and boxes


@pytest.mark.parametrize(
    ("side", "box"),
    [
        (Side.NORTH, Bounds(-20.0, 0.0, 20.0, 20.0)),
        (Side.WEST, Bounds(-20.0, -20.0, 0.0, 20.0)),
        (Side.SOUTHEAST, Bounds(0.0, -20.0, 20.0, 0.0)),
    ],
)
def test_a_side_is_a_half_and_one_between_is_a_quarter(side: Side, box: Bounds) -> None:
    assert side_of(BOX, side) == box
    assert place(SideOf(side), BOX, {}) == box


def test_a_side_of_what_was_found_reaches_a_little_beyond_it_and_not_past_the_bounds() -> None:
    found = {1: Bounds(10.0, -4.0, 16.0, 2.0)}
    assert place(SideOf(Side.NORTH, 1), BOX, found) == Bounds(10.0 - BESIDE, -1.0, 20.0, 2.0 + BESIDE)
    with pytest.raises(LookupError, match="leg 2 found nothing"):
        place(SideOf(Side.NORTH, 2), BOX, found)


def test_orders_are_told_in_plain_words() -> None:
    legs = (
        Leg(Target.WRECK, Task.FIND),
        Leg(Target.OYSTERS, Task.MAP, SideOf(Side.NORTH, 1)),
        Leg(Target.ANY, Task.MAP, SideOf(Side.WEST)),
        Leg(Target.ANY, Task.FIND, Bounds(0.0, 1.0, 5.5, 9.0)),
    )
    assert sentences(Orders(legs, 80), 200) == [
        "1. Find the wreck in the whole survey area.",
        "2. Map the oysters on the north side of what leg 1 found, up to 10 m from it.",
        "3. Map all targets in the western half of the survey area.",
        "4. Find any target in the box from x = 0 to 5.5 m and from y = 1 to 9 m.",
        "At most 80 steps in all.",
    ]
    assert sentences(Orders(legs[:1]), 200)[-1] == "At most 200 steps in all."


@pytest.mark.parametrize(
    ("legs", "max_steps", "complaint"),
    [
        ((), None, "legs: expected 1 to 8, got 0"),
        ((Leg(),) * 9, None, "legs: expected 1 to 8, got 9"),
        ((Leg(),), 0, "max_steps: expected at least 1, got 0"),
        (
            (Leg(area=SideOf(Side.EAST, 1)),),
            None,
            "leg 1: expected a side of what an earlier leg finds, got 1",
        ),
    ],
)
def test_orders_that_cannot_be_are_refused(
    legs: tuple[Leg, ...], max_steps: int | None, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        Orders(legs, max_steps)


# ------------------------------------------------------------------------------------------- leg after leg


def test_the_limit_of_the_orders_ends_a_mission_and_so_does_a_smaller_one(empty_world: World) -> None:
    orders = Orders((Leg(),), max_steps=6)
    assert [s.ended for s in flight(empty_world, Listening(), orders=orders)][-1] == "cap"
    for max_steps, last in ((4, 4), (50, 6)):
        *_, step = flight(empty_world, Listening(), max_steps=max_steps, orders=orders)
        assert step.index == last


def test_each_leg_gets_a_fresh_pilot_and_the_look_around_comes_once(string_reef: World) -> None:
    planner = Listening(done=True)
    orders = Orders((Leg(Target.OYSTERS, Task.MAP, NEAR), Leg(Target.ANY, Task.FIND, NEAR)))
    steps = list(flight(string_reef, planner, orders=orders))
    first, second = planner.missions[:2]
    assert (first.area, first.target, first.flown) == (NEAR, Target.OYSTERS, LOOK_AROUND)
    assert (second.area, second.target, second.flown) == (NEAR, Target.ANY, LOOK_AROUND + 1)
    assert [step.leg.number for step in steps if step.leg] == [1] * (LOOK_AROUND + 2) + [2]
    assert [step.ended for step in steps] == [""] * (LOOK_AROUND + 2) + ["done"]
    outcomes = [step.leg.outcome for step in steps if step.leg and step.leg.outcome]
    assert outcomes == [Outcome.MAPPED, Outcome.NOT_FOUND]


def test_a_pilot_is_told_of_the_steps_that_the_way_to_its_area_took(empty_world: World) -> None:
    start, bounds = empty_world.starts[0], empty_world.bounds
    x = bounds.x_min if start.x > 0.0 else bounds.x_max - 8.0
    far = Bounds(x, bounds.y_max - 8.0, x + 8.0, bounds.y_max)
    planner, orders = Listening(), Orders((Leg(area=far),))
    steps = list(flight(empty_world, planner, orders=orders, max_steps=30))
    way = sum("On the way" in step.decision.reasoning.action for step in steps)
    assert way > 0
    assert [mission.flown for mission in planner.missions] == [LOOK_AROUND, LOOK_AROUND + way]


def test_a_leg_beside_what_was_not_found_is_left_out(string_reef: World) -> None:
    legs = (
        Leg(Target.ANY, Task.FIND, NEAR),
        Leg(area=SideOf(Side.NORTH, 1)),
        Leg(Target.ANY, Task.MAP, NEAR),
    )
    orders = Orders(legs)
    scorer = Scorer(string_reef, DREAM_V1, orders=orders)
    for step in flight(string_reef, Listening(done=True), orders=orders):
        scorer.add(step)
    summary = scorer.summary()
    assert [leg["outcome"] for leg in summary["legs"]] == ["not found", "not flown", "mapped"]
    assert summary["ended"] == "done"
    assert not summary["success"], "what was to be found is missing"


def test_without_orders_all_is_mapped_in_one_leg(empty_world: World) -> None:
    *_, last = flight(empty_world, Listening(), max_steps=5)
    assert last.leg == Flown(1, Leg(Target.OYSTERS), None)


# ------------------------------------------------------------------------------------------- every planner


@pytest.mark.few(3)
@pytest.mark.parametrize("name", OFFLINE)
def test_an_area_that_is_everything_is_flown_like_no_orders(name: str, string_reef: World) -> None:
    def flown(orders: Orders | None) -> list[tuple[Decision, str]]:
        steps = flight(string_reef, PLANNERS[name], max_steps=9, orders=orders)
        return decisions(steps)

    plain = flown(None)
    assert flown(Orders((Leg(Target.OYSTERS),))) == plain
    # Frontiers of an area are also beside what is known and was not observed, which some talk of.
    if name != "frontier":
        boxed = flown(Orders((Leg(Target.OYSTERS, Task.MAP, string_reef.bounds),)))
        assert [replace(decision, reasoning=Reasoning()) for decision, _ in boxed] == [
            replace(decision, reasoning=Reasoning()) for decision, _ in plain
        ]


@pytest.mark.few(3)
@pytest.mark.parametrize("name", OBEYING)
def test_every_planner_spends_its_steps_on_the_area(name: str, string_reef: World) -> None:
    # It starts in the north-west; this quarter is beyond its first view.
    orders = Orders((Leg(Target.OYSTERS, Task.MAP, SideOf(Side.NORTHEAST)),))
    scorer = Scorer(string_reef, DREAM_V1, orders=orders)
    for step in flight(string_reef, PLANNERS[name], orders=orders):
        scorer.add(step)
    summary, occupancy = scorer.summary(), step.occupancy
    assert summary["ended"] == "done"
    assert check_completion(occupancy, step.observation.pose).complete
    assert summary["coverage"]["instances"] >= 0.98
    inside, outside = occupancy.seen[occupancy.to_see], occupancy.seen[~occupancy.to_see]
    # What `belief` glimpsed from afar it need not come to, nor `greedy`, which believes as much.
    assert inside.mean() > (1.3 * outside.mean() if name in ("belief", "greedy") else 0.75)
    assert outside.mean() < 0.45, "nothing else is explored"


def test_the_share_counts_only_what_lies_in_the_areas_that_are_mapped(string_reef: World) -> None:
    def counted(*legs: Leg) -> int:
        return int(Scorer(string_reef, DREAM_V1, orders=Orders(legs)).summary()["countable"])

    whole = Scorer(string_reef, DREAM_V1).summary()["countable"]
    west, east = Leg(area=SideOf(Side.WEST)), Leg(area=SideOf(Side.EAST))
    assert counted(Leg()) == counted(west, east) == whole
    assert counted(west) + counted(east) == whole
    assert 0 < counted(west) < whole
    assert counted(west, Leg(task=Task.FIND)) == counted(west)


# ------------------------------------------------------------------------------------------- find, then map


@pytest.fixture(scope="module")
def round_a_wreck(wreck: World) -> list[Step]:
    """`sixsteps` finds it, and then maps its north side."""
    orders = Orders((Leg(Target.WRECK, Task.FIND), Leg(Target.ANY, Task.MAP, SideOf(Side.NORTH, 1))))
    return list(flight(wreck, PLANNERS["sixsteps"], orders=orders))


@pytest.mark.rare
def test_the_side_of_a_wreck_is_where_the_hull_was_found(wreck: World, round_a_wreck: list[Step]) -> None:
    steps = round_a_wreck
    legs = [step.leg for step in steps if step.leg is not None]
    found = next(k for k, leg in enumerate(legs) if leg.outcome is Outcome.FOUND)
    assert {leg.number for leg in legs[: found + 1]} == {1}
    assert {leg.number for leg in legs[found + 1 :]} == {2}
    assert found < 40, "it need not be mapped to be found"
    assert (steps[-1].ended, legs[-1].outcome) == ("done", Outcome.MAPPED)
    area, last = legs[-1].area, steps[-1].occupancy.copy()
    assert area is not None
    assert last.area == area
    inside = last.to_see
    assert last.seen[inside].mean() > 0.7
    # It lies where the hull is on the map, as far as that was seen, and so where it is in the world.
    last.restrict(None)
    known = target_extent(last, Target.WRECK)
    assert known is not None
    assert area == place(SideOf(Side.NORTH, 1), wreck.bounds, {1: known})
    hull = wreck.targets.position[:, :2].astype(np.float64)
    (west, south), (east, north) = hull.min(axis=0), hull.max(axis=0)
    assert south < area.y_min < north
    assert area.y_max == pytest.approx(north + BESIDE, abs=4.0)
    assert area.x_min < west < east < area.x_max


def test_the_area_follows_what_becomes_known_of_a_hull(round_a_wreck: list[Step]) -> None:
    legs = [step.leg for step in round_a_wreck[:26] if step.leg is not None]
    widths = [leg.area.width for leg in legs if leg.area is not None]
    assert widths == sorted(widths)
    assert widths[-1] > widths[0] + 2.0


@dataclass(slots=True)
class Watched:
    """`belief`, whose pilots can be looked into."""

    pilots: list[BeliefPilot] = field(default_factory=list)

    def begin(self, mission: Mission) -> BeliefPilot:
        self.pilots.append(Belief().in_plane(mission))
        return self.pilots[-1]


def test_belief_expects_no_hull_outside_of_the_area(wreck: World) -> None:
    planner, orders = Watched(), Orders((Leg(area=SideOf(Side.NORTH)),))
    *_, last = flight(wreck, planner, orders=orders, max_steps=15)
    pilot, occupancy = planner.pilots[-1], last.occupancy
    source = source_of(pilot, HullSurface)
    assert source is not None
    outside = source.hull.middles[:, 1] < -DREAM_V1.cell
    for area, expects in ((last.leg.area if last.leg else None, False), (None, True)):
        occupancy.restrict(area)
        hull = pilot.expect(situation_of(pilot, last.observation, occupancy)).hull
        assert hull[~outside].sum() > 0.0
        assert (hull[outside].sum() > 0.0) == expects


@dataclass(slots=True)
class Spending:
    """Says done; every decision costs two calls, and the prices are known up to the third decision."""

    missions: list[Mission] = field(default_factory=list)
    decided: int = 0

    def begin(self, mission: Mission) -> Spending:
        self.missions.append(mission)
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        self.decided += 1
        price = 0.5 if self.decided <= 3 else None
        exchange = Exchange("", "", "", {}, (), "", 2, 1, 1, price, 1.0)
        return Decision(done=True, exchanges=(exchange,))


def test_each_leg_is_told_what_those_before_it_spent(string_reef: World) -> None:
    planner = Spending()
    list(flight(string_reef, planner, orders=Orders((Leg(area=NEAR),) * 6), max_steps=40))
    spent = [mission.asked for mission in planner.missions]
    assert spent[0] == Asked(0, 0.0)
    assert len(spent) == 6
    assert [after.calls - before.calls for before, after in pairwise(spent)] == [2] * 5
    assert [one.cost_usd for one in spent] == [0.0, 0.5, 1.0, 1.5, None, None]
