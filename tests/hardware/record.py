"""Flies a real ArduSub anew and writes its traces.

DREAM_ARDUSUB_SITL=/path/to/ardusub python -m tests.hardware.record [NAME ...]
"""

import sys
from functools import partial

from dream.sim.worlds import make_world
from tests.hardware.manoeuvres import FAR, RUNS
from tests.hardware.sitl import SETUPS, Sitl, at


def main(names: list[str]) -> None:
    """All, or those that are named."""
    world = make_world("pool/arc", 1)
    for name in names or RUNS:
        run = RUNS[name]
        parameters = at(FAR) if (run.setup, run.home) == ("origin", FAR) else SETUPS[run.setup]
        run.fly(world, partial(Sitl, parameters=parameters, home=run.home)).save(run.path)


if __name__ == "__main__":
    main(sys.argv[1:])
