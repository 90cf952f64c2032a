"""Worlds and flown missions that several tests share; each is made once."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

from dream.evaluation.runner import simulate
from dream.planning import SixSteps
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Step

# No test may ask a model that is not on this machine.
os.environ["DREAM_OFFLINE"] = "1"

# The first call of a kernel compiles it or reads it from disk, which no deadline should judge.
settings.register_profile("dream", deadline=None, max_examples=50)
settings.load_profile("dream")


@pytest.fixture(scope="session")
def string_reef() -> World:
    """The reef of `make run`."""
    return make_world("reef/string", 1)


@pytest.fixture(scope="session")
def empty_world() -> World:
    """Flat sand and nothing else."""
    return make_world("flat/empty", 1)


@pytest.fixture(scope="session")
def short_mission(string_reef: World) -> list[Step]:
    """Twelve steps of `sixsteps` on the string reef; the map in every step is the final one."""
    return list(simulate(string_reef, SixSteps(), DREAM_V1, max_steps=12))
