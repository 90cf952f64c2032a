"""How long a decision takes: `belief` beside other planners, in arenas as they are and of 100 m a side.

    python perf/decision.py              three minutes, one process
    python perf/decision.py --world reef/mixed --seed 101 --planners belief nbv
    python perf/decision.py --wrecks --planners belief    a wreck of each design; two minutes

The times are those of the planner alone. They hold on an idle core; the ratios hold on a busy one, too.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning import OFFLINE, PLANNERS
from dream.protocol import DREAM_V1
from dream.robots import Teleport
from dream.sim import worlds
from dream.sim.render import Renderer
from dream.sim.world import World
from dream.types import LOOK_AROUND

LARGE, CAP = 100.0, 800
"""Metres along the large arena, and its steps at most."""
DESIGNS = 5
"""Of wrecks."""


def milliseconds(world: World, planner: str, cap: int) -> tuple[npt.NDArray[np.float64], str]:
    """(n,) of each decision of a mission, and how it ended."""
    protocol = replace(DREAM_V1, cap=cap)
    robot = Teleport(world, protocol, world.starts[0], renderer=Renderer(world))
    taken: list[float] = []
    ended = ""
    for step in explore(robot, PLANNERS[planner], OccupancyMap(world.bounds, protocol)):
        taken.append(1e3 * step.planner_s)
        ended = f"{step.ended} after {step.index}, {step.occupancy.observed.mean():.0%} observed"
    # The first decision compiles or loads kernels.
    return np.array(taken[LOOK_AROUND + 2 :]), ended


def main() -> int:
    """Fly each planner in both arenas and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="reef/mixed", help="a reef")
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--planners", nargs="+", default=["belief", "sixsteps", "nbv"], choices=OFFLINE)
    parser.add_argument("--wrecks", action="store_true", help="one of each design, instead of a reef")
    options = parser.parse_args()
    if options.wrecks:
        names = [f"wreck/{design}" for design in range(1, DESIGNS + 1)]
        arenas = [(name, worlds.make_world(name, options.seed), DREAM_V1.cap) for name in names]
    else:
        usual = worlds.make_world(options.world, options.seed)
        # The same recipe on a larger sea floor.
        worlds.SIDES = (LARGE,) * 3
        large = worlds.make_world(options.world, options.seed)
        arenas = [("usual", usual, DREAM_V1.cap), ("large", large, CAP)]
    print("| planner | arena | side | p50, ms | p99, ms | p50 to that of the usual arena | ended |")
    print("|---|---|--:|--:|--:|--:|---|")
    for planner in options.planners:
        first = 0.0
        for name, world, cap in arenas:
            taken, ended = milliseconds(world, planner, cap)
            p50, p99 = np.percentile(taken, [50, 99])
            first = first or p50
            ratio = "" if options.wrecks else f"{p50 / first:.2f}"
            cells = (f"{world.bounds.width:.0f} m", f"{p50:.0f}", f"{p99:.0f}", ratio, ended)
            print(f"| {planner} | {name} | {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
