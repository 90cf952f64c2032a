"""Compiling is told once, and it is no time in which a planner thinks."""

from __future__ import annotations

import gc
import time

import pytest
from numba import njit
from numba.core.errors import TypingError
from numba.core.event import trigger_event

from dream.compiling import COMPILES, when_compiling, working_time
from dream.evaluation.runner import simulate
from dream.mapping import OccupancyMap
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Decision, Mission, Observation


def test_numba_tells_when_it_compiles_and_not_when_it_need_not() -> None:
    told: list[str] = []
    doubled = njit(lambda x: 2 * x)
    with when_compiling(lambda: told.append("told")):
        assert doubled(2) == 4
        assert doubled(2.5) == 5.0
    assert told == ["told"]
    with when_compiling(lambda: told.append("again")):
        assert doubled(3) == 6
    assert told == ["told"]


@pytest.mark.parametrize("before", [True, False])
def test_garbage_is_not_collected_while_it_compiles_and_then_as_before(before: bool) -> None:
    (gc.enable if before else gc.disable)()
    try:
        with trigger_event(COMPILES):
            with trigger_event(COMPILES):
                assert not gc.isenabled()
            assert not gc.isenabled()
        assert gc.isenabled() is before
    finally:
        gc.enable()


def test_garbage_is_collected_again_after_what_does_not_compile() -> None:
    with pytest.raises(TypingError):
        njit(lambda x: x + "no number")(1)
    assert gc.isenabled()


class Compiles:
    """A planner whose decisions take no time, but what they need is compiled first."""

    def begin(self, mission: Mission) -> Compiles:
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        with trigger_event(COMPILES), trigger_event(COMPILES):
            time.sleep(0.2)
        time.sleep(0.01)
        return Decision()


def test_what_a_decision_takes_is_told_without_compiling(empty_world: World) -> None:
    before = working_time()
    *_, last = simulate(empty_world, Compiles(), DREAM_V1, max_steps=4)
    assert 0.01 <= last.planner_s < 0.15
    assert last.planner_s < working_time() - before
