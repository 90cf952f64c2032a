"""A situation in space, flown once: a reef that was looked at for a few steps."""

from __future__ import annotations

from functools import cache

from dream.evaluation.runner import simulate
from dream.mapping import OccupancyMap
from dream.planning import SixSteps
from dream.protocol import DREAM_V2_TRUE
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND, Mission, Observation

PROTOCOL = DREAM_V2_TRUE
FLOWN = 4


@cache
def reef() -> World:
    return make_world("reef/string", 1)


@cache
def flown() -> tuple[Observation, OccupancyMap]:
    """What is seen and known after the look around and some steps; only read."""
    *_, last = simulate(reef(), SixSteps(), PROTOCOL, max_steps=LOOK_AROUND + FLOWN)
    return last.observation, last.occupancy


def mission(steps: int = 200) -> Mission:
    return Mission(PROTOCOL, reef().bounds, steps)
