"""Worlds that several tests look at, each made once."""

from __future__ import annotations

import functools

from dream.sim.world import World
from dream.sim.worlds import make_world


@functools.cache
def made(name: str, seed: int = 1) -> World:
    return make_world(name, seed)
