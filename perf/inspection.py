"""What does *inspected* ask, and what does it cost?

    python perf/inspection.py share     which share of its points a single clump or patch shows; half a minute
    python perf/inspection.py cost      CPU of one pose, and what of each world can be inspected; a minute

`share` puts each of some clumps, and flat and bent patches of hulls, alone on level ground (a patch in open
water) and looks at it from 1 to 7 m away, at up to 70° to its mean normal, evenly over the sphere and never
from under the ground. It prints in how many of the views so many of its points are inspected.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace

import numpy as np

from dream.geometry import SE3
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.sim.inspection import SHARE, Inspection
from dream.sim.inspection.points import POINTS
from dream.sim.world import Terrain, World
from dream.sim.worlds import make_world

SEED = 470_101
"""Of the worlds; no suite has it."""
EACH, VIEWS = 40, 60
"""So many individuals of each world, and of each so many views."""
KINDS = {
    "clumps": ("reef/string", "reef/mixed", "reef/K"),
    "flat patches": ("wreck/1", "wreck/4", "wreck/5"),
    "bent patches": ("wreck/1", "wreck/4", "wreck/5"),
}
FLAT = 0.98
"""A patch is flat where the mean of its points' normals is at least so long."""
WORLDS = (
    "reef/string",
    "reef/fringing",
    "reef/patch",
    "reef/mixed",
    "reef/K",
    *(f"wreck/{k}" for k in range(1, 6)),
)


def alone(world: World, individual: int) -> World:
    """The world with nothing in it but that individual."""
    chosen = np.arange(len(world.targets)) == individual
    x, y, z = map(float, world.targets.position[individual])
    ground = z - 30.0 if world.hull[individual] else float(world.terrain.height(x, y))
    return replace(
        world,
        targets=world.targets.chosen(chosen),
        obstacles=world.obstacles.chosen(np.zeros(len(world.obstacles), np.bool_)),
        terrain=Terrain(np.full((5, 5), ground, np.float32), x - 20.0, y - 20.0, 10.0),
    )


def shares(inspection: Inspection, rng: np.random.Generator) -> list[float]:
    """Of each of some views, the share of the points that it inspects."""
    surface, terrain = inspection.surface, inspection.world.terrain
    middle, normal = surface.points.mean(axis=0), surface.normals.mean(axis=0)
    normal = normal / np.linalg.norm(normal)
    found: list[float] = []
    while len(found) < VIEWS:
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        eye = middle + rng.uniform(1.0, 7.0) * way
        if way @ normal < math.cos(math.radians(70.0)) or eye[2] < terrain.height(eye[0], eye[1]) + 0.2:
            continue
        yaw, down = math.atan2(-way[1], -way[0]), math.asin(way[2])
        look = inspection.look(SE3.level(float(eye[0]), float(eye[1]), float(eye[2]), yaw), down)
        found.append(float((look.points == 2).mean()))
    return found


def share() -> None:
    """Print the table of `KINDS`."""
    rng = np.random.default_rng(SEED)
    print(f"views that inspect so many of {POINTS} points; {SHARE:g} of them are asked for")
    for kind, names in KINDS.items():
        found: list[float] = []
        for name in names:
            world, left = make_world(name, SEED), EACH
            for individual in rng.permutation(len(world.targets)):
                inspection = Inspection(alone(world, int(individual)), PROTOCOL)
                flat = np.linalg.norm(inspection.surface.normals.mean(axis=0)) >= FLAT
                if kind != "clumps" and flat != (kind == "flat patches"):
                    continue
                found += shares(inspection, rng)
                left -= 1
                if not left:
                    break
        row = [f"{k}: {np.mean(np.array(found) >= k / POINTS - 1e-9):6.1%}" for k in range(1, 6)]
        print(f"{kind:13} {len(found) // VIEWS:4} of them   {'   '.join(row)}")


def cost() -> None:
    """Print CPU time and what can be inspected, world by world."""
    print(
        "world           a look, ms: median, 95 %, most   to prepare, s   can be inspected    dropped   in s"
    )
    for name in WORLDS:
        world = make_world(name, SEED)
        Inspection(world, PROTOCOL).look(SE3.level(0.0, 0.0, -8.0, 0.0), 0.35)
        start = time.process_time()
        inspection = Inspection(world, PROTOCOL)
        prepared = time.process_time() - start
        surface, rng, spent = inspection.surface, np.random.default_rng(SEED), []
        for _ in range(200):
            x, y, z = surface.points[rng.integers(len(surface.points))]
            yaw, away = rng.uniform(-math.pi, math.pi), rng.uniform(1.0, 6.0)
            pose = SE3.level(
                x - away * math.cos(yaw), y - away * math.sin(yaw), z + rng.uniform(0.5, 4.0), yaw
            )
            tilt = float(rng.choice(PROTOCOL.tilts))
            start = time.process_time()
            inspection.look(pose, tilt)
            spent.append(1e3 * (time.process_time() - start))
        start = time.process_time()
        can = inspection.worked_out()
        whole = time.process_time() - start
        dropped = surface.area[~can].sum() / surface.area.sum()
        middle, most = np.percentile(spent, [50, 95]), max(spent)
        print(
            f"{name:14} {middle[0]:8.2f} {middle[1]:8.2f} {most:8.2f} {prepared:20.2f} "
            f"{can.mean():18.2%} {dropped:14.2%} {whole:6.1f}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("share", "cost"))
    {"share": share, "cost": cost}[parser.parse_args().what]()
