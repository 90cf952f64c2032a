"""A reef some years on: its clumps have grown, died, settled anew and been buried; all else is as it was.

`make_world("reef/string+1y3", 5)` is the string reef of seed 5 a year on; the 3 says which of many futures.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.protocol import DREAM_V1
from dream.sim.files import CHANGED, world_hash
from dream.sim.reefs import renumbered
from dream.sim.sampling import (
    FACTOR,
    MILLIMETRE,
    QUATERNION,
    exponential,
    indices,
    normals,
    power,
    quantised,
    uniform,
    uniforms,
    yaw_and_tilt,
)
from dream.sim.structures import feet
from dream.sim.terrain import smoothstep
from dream.sim.validity import check_seed, check_world
from dream.sim.world import Instances, Terrain, World

LARGEST = 0.35
"""Metres across: what a clump grows towards, the largest that the worlds know."""
MOST_YEARS = 100.0
SETTLED = 0.165, 0.19
"""Metres across of a clump that settled since, as the smallest of the worlds."""
NEAR = 0.5
"""Metres from a living clump, one standard deviation, at which larvae settle."""
LENS = 0.8, 2.0
"""Metres: radii of the lenses of sand that bury a part of a reef."""
THICK = 0.25, 0.45
"""Metres: how thick they are in the middle."""
MOST_LENSES = 400
LATER = re.compile(r"(?P<name>.+)\+(?P<years>\d{1,3}(?:\.\d{1,3})?)y(?P<seed>\d{1,18})")


def years_on(name: str) -> float:
    """Simulated years from the world that a name begins with to that of the whole name."""
    on = LATER.fullmatch(name.removesuffix(CHANGED))
    return 0.0 if on is None else float(on["years"]) + years_on(on["name"])


@dataclass(frozen=True, slots=True)
class Change:
    """What becomes of a reef in a year. The figures are those of single oysters, applied to clumps.

    Assumes: rates that stay the same from year to year. Fails when: what happens comes in events, as storms
    and dredges do.
    """

    growth: float = 0.55
    """Rate at which a clump nears `LARGEST`, 1/a: k of von Bertalanffy's curve for eastern oysters of
    Chesapeake Bay (Coakley and Miller 2004)."""
    mortality: float = 0.15
    """Share that dies where nothing is amiss: in Delaware Bay more than 15 % in most years since 1990
    (Powell et al. 2008, J. Shellfish Res. 27: 729-755)."""
    outbreak: float = 0.47
    """Share that dies in a patch with disease: that of the worst year there, 1985 (the same)."""
    stricken: float = 0.2
    """Probability that a patch has it in a year."""
    recruitment: float = 0.15
    """New clumps for each one that lives. Our choice: about what ordinary mortality takes."""
    burial: float = 0.05
    """Share of the clumps that sand covers. Our choice."""

    def __post_init__(self) -> None:
        for name, most in (("growth", 10.0), ("recruitment", 10.0)):
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected 0 to {most:g} a year, got {getattr(self, name):g}")
        for name in ("mortality", "outbreak", "stricken", "burial"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: expected a share from 0 to 1, got {getattr(self, name):g}")


A_YEAR = Change()


def later(world: World, years: float, seed: int, change: Change = A_YEAR) -> World:
    """The world that many years on. Bounds, starts, obstacles and water stay; sand may bury a part.

    First some die, then the living grow, others settle beside them, and sand covers some of all. The same
    world, years, seed and change give the same world on every machine.

    Args:
        world: A reef.
        years: More than 0.
        seed: Which future.
        change: What happens in a year.

    Raises:
        ValueError: It is no reef, or nothing of it is left.
    """
    if world.hull.all() or world.protocol != DREAM_V1.name:
        raise ValueError(f"years: expected a reef of {DREAM_V1.name}, which lives, got {world.name}")
    if not 0.0 < years <= MOST_YEARS:
        raise ValueError(f"years: expected more than 0, up to {MOST_YEARS:g}, got {years:g}")
    check_seed(seed)
    words = [int(world_hash(world)[k : k + 8], 16) for k in range(0, 32, 8)]
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, round(1e6 * years), *words])))
    hull, clumps = world.targets.chosen(world.hull), world.targets.chosen(~world.hull)
    clumps = clumps.chosen(_survivors(clumps, years, change, rng))
    clumps = _grown(clumps, years, change)
    clumps = _joined(clumps, _settled(world, clumps, years, change, rng))
    ground = _silted(world.terrain, clumps, min(change.burial * years, 1.0), rng)
    clumps = clumps.chosen(~_covered(ground, clumps))
    if not len(clumps):
        raise ValueError(f"years: expected something alive after {years:g}, got nothing left of {world.name}")
    targets = _joined(hull, clumps)
    made = dataclasses.replace(
        world,
        name=f"{world.name}+{years:g}y{seed}",
        terrain=ground,
        targets=dataclasses.replace(targets, group=renumbered(targets.group)),
        hull=np.arange(len(targets)) < len(hull),
    )
    check_world(made)
    return made


def _survivors(
    targets: Instances, years: float, change: Change, rng: np.random.Generator
) -> npt.NDArray[np.bool_]:
    """(N,) bool. Years with disease strike whole patches."""
    groups = int(targets.group.max()) + 1
    whole = math.ceil(years)
    struck = rng.random((groups, whole)) < change.stricken
    lives = np.where(struck, 1.0 - change.outbreak, 1.0 - change.mortality)
    shares = np.ones(groups)
    for k in range(whole):
        shares *= power(lives[:, k], min(years - k, 1.0))
    return np.asarray(rng.random(len(targets)) < shares[targets.group])


def _grown(targets: Instances, years: float, change: Change) -> Instances:
    """Each nears the largest size, in all directions alike; its foot stays where it is."""
    scale = targets.scale.astype(np.float64)
    across = 0.5 * (scale[:, 0] + scale[:, 1])
    left = float(exponential(-change.growth * years))
    after = np.maximum(LARGEST - (LARGEST - across) * left, across)
    return dataclasses.replace(
        targets, scale=quantised(scale * (after / across)[:, None], FACTOR).astype(np.float32)
    )


def _settled(
    world: World, living: Instances, years: float, change: Change, rng: np.random.Generator
) -> Instances:
    """New clumps beside the living, not on boulders or hull and not out of bounds."""
    wanted = round(change.recruitment * years * len(living))
    beside = indices(rng, max(len(living), 1), wanted)
    away = NEAR * normals(rng, (wanted, 2))
    x, y = (living.position[beside, k].astype(np.float64) + away[:, k] for k in (0, 1))
    x, y = quantised(x, MILLIMETRE), quantised(y, MILLIMETRE)
    size = uniforms(rng, *SETTLED, wanted)
    sunk, turn = uniforms(rng, 0.05, 0.15, wanted), uniforms(rng, 0.0, 2.0 * math.pi, wanted)
    tilt, tint = uniforms(rng, -0.12, 0.12, (wanted, 2)), uniforms(rng, 0.72, 1.18, wanted)
    box = world.bounds
    inside = (np.abs(x - 0.5 * (box.x_min + box.x_max)) < 0.5 * box.width - SETTLED[1]) & (
        np.abs(y - 0.5 * (box.y_min + box.y_max)) < 0.5 * box.depth - SETTLED[1]
    )
    standing = _joined(world.obstacles, world.targets.chosen(world.hull))
    for x_rock, y_rock, radius in feet(world.meshes, standing):
        inside &= np.square(x - x_rock) + np.square(y - y_rock) > radius * radius
    z = world.terrain.height(x, y) - sunk * size
    made = Instances(
        mesh=living.mesh[beside],
        position=quantised(np.stack([x, y, z], 1), MILLIMETRE).astype(np.float32),
        wxyz=quantised(yaw_and_tilt(turn, tilt), QUATERNION).astype(np.float32),
        scale=quantised(np.repeat(size[:, None], 3, axis=1), FACTOR).astype(np.float32),
        tint=quantised(np.repeat(tint[:, None], 3, axis=1), FACTOR).astype(np.float32),
        group=living.group[beside],
    )
    return made.chosen(np.asarray(inside))


def _silted(terrain: Terrain, targets: Instances, share: float, rng: np.random.Generator) -> Terrain:
    """The seabed with lenses of sand on the reef, until they cover that share of the clumps."""
    heights = terrain.heights.astype(np.float64)
    rows, cols = heights.shape
    y = terrain.y0 + np.arange(rows)[:, None] * terrain.spacing
    x = terrain.x0 + np.arange(cols)[None, :] * terrain.spacing
    silted = terrain
    for _ in range(MOST_LENSES):
        if not len(targets) or _covered(silted, targets).mean() >= share:
            break
        middle = targets.position[int(rng.random() * len(targets))].astype(np.float64)
        radius, thick = uniform(rng, *LENS), uniform(rng, *THICK)
        near = np.sqrt(np.square(x - middle[0]) + np.square(y - middle[1])) / radius
        # Upon what is there, so that lenses that overlap do not pile up.
        sand = terrain.heights + thick * (1.0 - smoothstep(0.4, 1.0, near))
        heights = np.maximum(heights, np.where(near < 1.0, sand, heights))
        silted = dataclasses.replace(terrain, heights=quantised(heights, MILLIMETRE).astype(np.float32))
    return silted


def _covered(terrain: Terrain, targets: Instances) -> npt.NDArray[np.bool_]:
    """(N,) bool: nothing of a clump is above the ground where it stands; its height is 0.48 of its scale."""
    x, y, foot = targets.position.astype(np.float64).T
    top = foot + 0.48 * targets.scale[:, 2].astype(np.float64)
    return np.asarray(terrain.height(x, y) >= top)


def _joined(first: Instances, second: Instances) -> Instances:
    return Instances(
        **{
            field.name: np.concatenate([getattr(first, field.name), getattr(second, field.name)])
            for field in dataclasses.fields(Instances)
        }
    )
