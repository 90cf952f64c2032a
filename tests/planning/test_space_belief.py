"""`belief` in three dimensions over a wreck, a few steps long, by a sensor that does not err."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dream.control import setpoint
from dream.evaluation.runner import simulate
from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.mapping.occupancy import SURE
from dream.planning import Belief
from dream.planning.space.belief import SpaceBelief
from dream.planning.space.ground import GroundSearch
from dream.planning.space.in_water import InWater
from dream.planning.space.remains import LeftOfStructures, LeftToInspect
from dream.planning.space.search import FarSearch
from dream.protocol import DREAM_V1
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND, Decision, Mission, Target
from tests.planning.standing import SEABED, forget, mission, observed, water

STEPS = 20
SENTENCES = ("distribution", "completion", "next_target", "safety", "action")


@pytest.fixture(scope="module")
def wreck() -> World:
    return make_world("wreck/5", 1)


@pytest.fixture(scope="module")
def flown(wreck: World) -> list[Any]:
    """Of each step its decision, where it led, whether it touched anything, and how much is inspected."""
    found = []
    for step in simulate(wreck, Belief(), PROTOCOL, max_steps=STEPS):
        assert step.occupancy.volume is not None
        surface = step.occupancy.volume.surface()
        done = float(surface.area[(surface.sides != 0) & (surface.target > 0.5)].sum())
        found.append((step.decision, step.arrival, step.guarded, done))
    return found


def test_it_flies_in_space_and_in_the_plane() -> None:
    assert Belief.spatial
    assert isinstance(Belief().begin(mission()), SpaceBelief)
    assert not isinstance(Belief().begin(Mission(DREAM_V1, mission().bounds, 10)), SpaceBelief)


def test_it_looks_over_a_wreck_and_touches_nothing(flown: list[Any]) -> None:
    assert len(flown) == STEPS + 1
    assert not any(arrival.collided for _, arrival, _, _ in flown)
    assert not any(guarded.note for _, _, guarded, _ in flown)
    assert flown[-1][3] > flown[LOOK_AROUND][3] + 5.0


def test_it_says_what_is_left_and_what_each_look_is_to_show(flown: list[Any]) -> None:
    planned = [d.reasoning for d, _, _, _ in flown if d.reasoning.next_target.startswith("The look from")]
    assert planned
    for said in planned:
        for name in SENTENCES:
            assert getattr(said, name).endswith("."), name
    for decision, _, _, _ in flown[LOOK_AROUND + 1 :]:
        said = decision.reasoning.action.lower()
        assert ("climb" in said) == (decision.climb > 0.0)
        assert ("descend" in said) == (decision.climb < 0.0)
        assert ("camera" in said) == (decision.tilt is not None)


def test_it_decides_the_same_twice(wreck: World, flown: list[Any]) -> None:
    again = [step.decision for step in simulate(wreck, Belief(), PROTOCOL, max_steps=12)]
    assert again == [decision for decision, _, _, _ in flown[: len(again)]]


def test_it_never_asks_what_is_left_of_structures_where_oysters_are_ordered(
    wreck: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(*_: object) -> LeftToInspect:
        raise AssertionError("asked")

    monkeypatch.setattr(LeftOfStructures, "take", asked)
    pilot = Belief().begin(mission(Target.OYSTERS))
    assert isinstance(pilot, SpaceBelief)
    monkeypatch.setattr(GroundSearch, "decide", lambda *_: Decision(advance=1.0))
    occupancy: Any = type("Map", (), {"volume": water()})()
    assert pilot.decide(observed(0.0, 0.0, SEABED + 2.0, 0.0), occupancy).advance == 1.0
    any_pilot = Belief().begin(mission())
    assert isinstance(any_pilot, SpaceBelief)
    with pytest.raises(AssertionError, match="asked"):
        any_pilot.decide(observed(0.0, 0.0, SEABED + 2.0, 0.0), occupancy)


@pytest.mark.parametrize(("target", "done"), [(Target.WRECK, True), (Target.ANY, False)])
def test_a_mission_for_a_wreck_ends_when_all_of_it_is_looked_over(
    target: Target, done: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    none = np.zeros((0, 3))
    over = LeftToInspect(none, none, np.zeros(0), np.zeros(0, np.int64), 50.0, 0.0)
    monkeypatch.setattr(LeftOfStructures, "take", lambda *_: over)
    monkeypatch.setattr(FarSearch, "errand", lambda *_: (None, ""))
    monkeypatch.setattr(GroundSearch, "decide", lambda *_: Decision(advance=1.0))
    pilot = Belief().begin(mission(target))
    assert isinstance(pilot, SpaceBelief)
    occupancy: Any = type("Map", (), {"volume": water()})()
    decision = pilot.decide(observed(0.0, 0.0, SEABED + 2.0, 0.0), occupancy)
    assert decision.done == done
    assert decision.reasoning.completion
    assert ("missed 1.1% of what can be inspected" in decision.reasoning.action) == done


# -------------------------------------------------------------------------------------- over the ground


def through(volume: Any, z: float, decision: Decision) -> Decision:
    """A move over a level seabed as it is made through known water."""
    flat = np.full((1, 1), SEABED)
    occupancy: Any = SimpleNamespace(volume=volume, ground=flat, cell_of=lambda *_: (0, 0))
    return InWater(mission()).moved(decision, observed(0.0, 0.0, z, 0.0), occupancy)


def test_it_climbs_to_its_altitude_and_stays_there() -> None:
    volume, z = water(), SEABED + 1.5
    ahead = Decision(advance=1.0)
    for _ in range(10):
        move = through(volume, z, ahead)
        assert replace(move, climb=0.0, tilt=None) == ahead
        assert move.climb >= 0.0
        if move.climb == 0.0:
            break
        z += move.climb
    assert move.climb == 0.0
    assert SEABED + PROTOCOL.altitude < z < SEABED + 5.0
    assert through(volume, z + 1.0, ahead).climb < 0.0


@pytest.mark.parametrize("above", [1.0, 2.0, 3.0])
def test_it_never_moves_through_water_that_is_not_known(above: float) -> None:
    volume, z = water(), SEABED + above
    forget(volume, (1.0, -7.0, SEABED), (7.0, 7.0, SEABED + 9.0))
    for turn in PROTOCOL.turn_angles:
        for advance in (0.0, *PROTOCOL.advances):
            here = observed(0.0, 0.0, z, 0.0)
            move = through(volume, z, Decision(turn, advance))
            end = setpoint(here.pose, move, PROTOCOL, z)
            start, goal = [0.0, 0.0, z], [end.x, end.y, z if end.z is None else end.z]
            if start != goal:
                assert volume.room([start], [goal]).clear.all(), (turn, advance)


def test_it_looks_down_while_the_water_ahead_is_known() -> None:
    z = SEABED + 3.5
    down, ahead = max(PROTOCOL.tilts), None
    assert through(water(), z, Decision(advance=1.0)).tilt == down
    near = water()
    forget(near, (2.0, -7.0, SEABED), (7.0, 7.0, SEABED + 9.0))
    assert through(near, z, Decision(advance=1.0)).tilt is ahead


def test_a_map_of_which_other_ground_counts_as_seen_leaves_the_map_as_it_was() -> None:
    occupancy = OccupancyMap(mission().bounds, PROTOCOL)
    occupancy.restrict(Bounds(-3.0, -3.0, 3.0, 3.0))
    before, area = occupancy.observed, occupancy.to_see
    seen = np.zeros(occupancy.shape, np.bool_)
    seen[occupancy.cell_of(1.0, 1.0)] = True
    low, high = (np.zeros(occupancy.shape, np.bool_) for _ in range(2))
    low[occupancy.cell_of(2.0, 0.0)] = high[occupancy.cell_of(-2.0, 0.0)] = True
    occupancy._write("log_odds", (0, 0), np.where(low | high, SURE[0], 0).astype(np.int8))
    assert np.array_equal(occupancy.solid, low | high)
    other = occupancy.counting((~seen).astype(np.float32), 5.0, low)
    assert np.array_equal(other.observed, seen | ~area)
    # What is passed over stands in no way; all else does as before.
    assert np.array_equal(other.solid, high)
    assert other.traversable[low].all()
    assert not other.traversable[high].any()
    assert float(other.distance_to_solid[low][0]) == pytest.approx(4.0)
    assert np.array_equal(occupancy.solid, low | high)
    assert not occupancy.traversable[low].any()
    assert other.protocol == replace(PROTOCOL, reach=5.0)
    assert occupancy.protocol == PROTOCOL
    assert np.array_equal(occupancy.observed, before)
    assert np.array_equal(before, ~area)
