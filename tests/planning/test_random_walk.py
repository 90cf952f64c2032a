"""The random walk."""

from __future__ import annotations

import math

from dream.evaluation.runner import simulate
from dream.planning import RandomWalk
from dream.protocol import DREAM_V1
from dream.sim.worlds import make_world

STEPS = 24


def turns(seed: int, walk_seed: int = 0) -> list[int]:
    """Degrees of each step after the look-around, in one of the empty worlds."""
    world = make_world("flat/empty", seed)
    steps = [*simulate(world, RandomWalk(walk_seed=walk_seed), DREAM_V1, max_steps=STEPS + 3)][4:]
    return [round(math.degrees(step.decision.turn)) for step in steps]


def test_walks_differ_from_world_to_world_and_from_seed_to_seed() -> None:
    first = turns(1)
    assert turns(1) == first
    for other in (turns(2), turns(3), turns(1, walk_seed=1)):
        # Nine in ten steps go straight on: what two walks share by chance is little more than that.
        turned = {k for k, turn in enumerate(first) if turn} | {k for k, turn in enumerate(other) if turn}
        same = sum(first[k] == other[k] for k in turned)
        assert same <= len(turned) / 3
