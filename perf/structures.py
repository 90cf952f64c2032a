"""Where several things stand apart: does the planner `belief` leave one for the next?

    python perf/structures.py wrecks     two wrecks 68 m apart; ten worlds, a quarter of an hour on two cores
    python perf/structures.py reefs      a wreck with a reef of three patches 40 m off; ten worlds
    python perf/structures.py wrecks --only 3 4    some of them, by number
    python perf/structures.py wrecks --insist      with a planner that never leaves a hull while any is left

Worlds are put together from two of the simulator's, of seeds that no suite has. The cap is 400 steps. It
prints the share that was seen of each wreck, and of each patch of a reef.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from ablation import Insistent
from dream.evaluation.engines import processors
from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.planning import Belief
from dream.protocol import DREAM_V1
from dream.sim.render import Renderer
from dream.sim.structures import beside
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import BoolArray

CAP = 400
FIRST = 470_001
"""Of the seeds; no suite has them."""
COUNT = 10
APART = {"wrecks": 68.0, "reefs": 40.0}
"""Metres between the middles of the two arenas."""
FOUND = 0.9
"""Share of a wreck that has to be seen."""


def world_of(kind: str, number: int) -> World:
    """The n-th of a kind."""
    seed = FIRST + number
    west = make_world(f"wreck/{1 + number % 5}", seed)
    if kind == "wrecks":
        return beside(west, make_world(f"wreck/{1 + (number + 2) % 5}", seed + 100), APART[kind])
    return beside(west, make_world("reef/mixed", seed), APART[kind])


def flown(task: tuple[str, int, Belief]) -> tuple[str, bool]:
    """A line about one world, and whether all of it was found."""
    kind, number, planner = task
    world = world_of(kind, number)
    visibility, renderer = Visibility(world, DREAM_V1), Renderer(world)
    scorer = Scorer(world, DREAM_V1, visibility=visibility, renderer=renderer)
    poses, step = [], None
    for step in simulate(world, planner, DREAM_V1, max_steps=CAP, renderer=renderer):
        scorer.add(step)
        poses.append([step.observation.pose.x, step.observation.pose.y, step.observation.pose.yaw])
    assert step is not None
    by_step = visibility.seen(poses).compress(visibility.countable, axis=1)
    seen: BoolArray = np.asarray(by_step.any(axis=0))
    east = visibility.points[visibility.countable][:, 0] > 0.5 * APART[kind]
    groups = world.targets.group[visibility.countable]
    if kind == "wrecks":
        shares = [float(seen[side].mean()) for side in (~east, east)]
        good = min(shares) >= FOUND
    else:
        shares = [float(seen[~east].mean())]
        shares += [float(seen[groups == group].mean()) for group in np.unique(groups[east])]
        good = min(shares) > 0.0
    told, first = ", ".join(f"{share:.1%}" for share in shares), by_step[:, east].any(axis=1)
    when = f"at step {int(first.argmax())}" if first.any() else "never"
    what = f"{step.ended} after {step.index} steps, found the second {when}, saw {told}"
    return f"{number} {world.name}: {what}", good


def main() -> int:
    """Fly them and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=tuple(APART))
    parser.add_argument("--only", nargs="*", type=int, help="numbers of worlds, 0 to 9; all unless given")
    parser.add_argument("--insist", action="store_true", help="never leave a hull while any is left")
    parser.add_argument("--jobs", type=int, default=processors(), help="worlds at a time")
    options = parser.parse_args()
    numbers = list(range(COUNT)) if options.only is None else options.only
    planner = Insistent() if options.insist else Belief()
    tasks = [(options.kind, number, planner) for number in numbers]
    found = 0
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for line, good in pool.map(flown, tasks):
            found += good
            print(line, flush=True)
    what = f"at least {FOUND:.0%} of both" if options.kind == "wrecks" else "something of every group"
    print(f"{found} of {len(tasks)}: {what}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
