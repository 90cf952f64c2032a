"""How likely a look overlooks what lies on the ground, by its angle to the vertical, and two looks together.

    python perf/overlooked.py                the table of docs/space.md: a world of each family, 4 minutes
    python perf/overlooked.py reef/mound:7   of some worlds

From all round 20 spots of each world on which something lies, each look is at the angle told from the height
from which ground is searched, the camera 45 degrees down. Counted are all individuals within a metre of the
spot that can be inspected at all; seed 1, which no suite holds.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from dream.geometry import SE3, wrap_angle
from dream.planning.space.in_water import HEIGHT
from dream.planning.space.overlooked import overlooked
from dream.sim.habitats import HABITATS
from dream.sim.inspection import Inspection
from dream.sim.ordered import protocol_in
from dream.sim.worlds import make_world

ANGLES = (30, 40, 50)
"""Degrees."""
SPOTS, AROUND = 20, 1.0
LOOKS = 8
"""At one angle, evenly round a spot."""


def measured(name: str, seed: int) -> tuple[list[float], list[float]]:
    """Share that a look misses by its angle, and that two looks from a quarter turn apart do."""
    world = make_world(name, seed)
    protocol = protocol_in(world, "dream-v2")
    sight, position = Inspection(world, protocol), world.targets.position
    height = HEIGHT * protocol.trusted
    chosen = np.random.default_rng(0).choice(np.flatnonzero(sight.countable), SPOTS)
    once, twice = [], []
    for angle in ANGLES:
        missed = np.zeros(2)
        counted = 0
        away = height * math.tan(math.radians(angle))
        for x, y, z in position[chosen].tolist():
            there = sight.countable & (np.hypot(*(position[:, :2] - [x, y]).T) < AROUND)
            looks = []
            for k in range(LOOKS):
                bearing = 2.0 * math.pi * k / LOOKS
                at = x + away * math.cos(bearing), y + away * math.sin(bearing), z + height
                pose = SE3.level(*at, wrap_angle(bearing + math.pi))
                looks.append(sight.look(pose, max(protocol.tilts)).inspected[there])
            missed_by = ~np.array(looks)
            both = missed_by & np.roll(missed_by, LOOKS // 4, axis=0)
            missed += missed_by.sum(), both.sum()
            counted += missed_by.size
        once.append(missed[0] / counted)
        twice.append(missed[1] / counted)
    return once, twice


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("worlds", nargs="*", metavar="WORLD:SEED")
    cases = parser.parse_args().worlds or [f"{name}:1" for name in HABITATS]
    print("| one look / two, percent missed | " + " | ".join(f"{angle}°" for angle in ANGLES) + " |")
    print("|---|" + "--:|" * len(ANGLES))
    rows = []
    for case in cases:
        name, _, seed = case.partition(":")
        once, twice = measured(name, int(seed or 1))
        rows.append((once, twice))
        print(row(f"`{case}`", once, twice), flush=True)
    once, twice = np.median(rows, axis=0).tolist()
    print(row("median", once, twice))
    told = overlooked(np.cos(np.radians(ANGLES, dtype=np.float32))).tolist()
    print(row("as `belief` has it", told, [share**2 for share in told]))


def row(name: str, once: list[float], twice: list[float]) -> str:
    """One of the table."""
    cells = (f"{100 * a:.1f} / {100 * b:.1f}" for a, b in zip(once, twice, strict=True))
    return f"| {name} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
