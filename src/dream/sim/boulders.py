"""Boulders: what a survey must find its way between.

A formation is a low boulder, a pinnacle, or one boulder stacked on another. At least half of the
formations rise above 2.4 m over the seabed, so that they bar the way of a vehicle at 2 m.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import SE2, Bounds
from dream.sim.meshes import boulder
from dream.sim.sampling import (
    FACTOR,
    MILLIMETRE,
    QUATERNION,
    Float64Array,
    between,
    direction,
    index,
    quantised,
    rotated,
    uniform,
    uniforms,
    yaw_and_tilt,
)
from dream.sim.world import Instances, Mesh, Terrain

NUMBER = 7, 14
"""Formations of an arena of 40 to 50 m, from the fewest to the most."""
PASSAGE = 2.0
"""Least metres between two formations."""
RING_GAP = 1.6
"""Least metres between two rocks of a ring about the start."""
CLEAR = 3.05
"""Least metres from a start to a formation: 2.5 m known to be free, the vehicle's radius, and a margin."""


@dataclass(frozen=True, slots=True)
class Rock:
    """One boulder to be placed. Metres."""

    x: float
    y: float
    radius: float
    """No part lies further from (x, y) over ground."""
    top: float
    """Height of its highest point above the seabed."""
    height: float
    """From its lowest to its highest point; what exceeds `top` is sunk."""
    formation: int
    sheer: bool = False
    """A slab-sided rock rather than a cobble."""


def variants(rng: np.random.Generator) -> tuple[Mesh, ...]:
    """Eight boulders about 2 m across: four cobbles, then four slab-sided rocks."""
    return tuple(boulder(rng, planes=planes) for planes in (26, 30, 34, 38, 12, 14, 16, 18))


def formations(
    bounds: Bounds,
    starts: tuple[SE2, ...],
    near: Float64Array,
    taken: Float64Array,
    rng: np.random.Generator,
    *,
    ring: bool,
    number: tuple[int, int] = NUMBER,
) -> list[Rock]:
    """Formations, at least 2 m apart and clear of every start.

    Args:
        bounds: Of the arena.
        starts: Kept clear, `CLEAR` metres around.
        near: (K, 2) places that attract: half of the formations stand within 4 m of one.
        taken: (T, 3) circles x, y, radius where none may stand.
        rng: Source of places and sizes.
        ring: Stand some around the first start, with gaps to leave by.
        number: So many, from the fewest to the most; more where a ring has all but four of them.
    """
    around = _ring(starts[0], rng) if ring else []
    around = [rock for rock in around if _free(rock, [], starts, taken, bounds)]
    rocks = [dataclasses.replace(rock, formation=formation) for formation, rock in enumerate(around)]
    total = max(between(rng, *number), len(rocks) + 4)
    tall = sum(rock.top > 2.4 for rock in rocks)
    formation = len(rocks)
    for _ in range(3000):
        if formation == total:
            break
        rises = 2 * tall < total or rng.random() < 0.3
        radius = uniform(rng, 0.75, 1.45) if rises else uniform(rng, 0.35, 1.3)
        low = np.array([bounds.x_min, bounds.y_min]) + 1.0 + radius
        high = np.array([bounds.x_max, bounds.y_max]) - 1.0 - radius
        x, y = low + (high - low) * rng.random(2)
        if len(near) and rng.random() < 0.55:
            x, y = near[index(rng, len(near))] + uniforms(rng, -4.0, 4.0, 2)
        x, y = (float(v) for v in quantised([x, y], MILLIMETRE))
        if not _free(Rock(x, y, radius, 0.0, 0.0, formation), rocks, starts, taken, bounds):
            continue
        rocks += _tall(x, y, radius, formation, rng) if rises else [_low(x, y, radius, formation, rng)]
        tall += rises
        formation += 1
    return rocks


def placed(
    rocks: list[Rock], meshes: tuple[Mesh, ...], first: int, terrain: Terrain, rng: np.random.Generator
) -> Instances:
    """The instances of these rocks on the terrain; `group` numbers the formations.

    Args:
        rocks: What to place.
        meshes: The eight of `variants`.
        first: Index of the first of them in the world's meshes.
        terrain: The seabed.
        rng: Source of poses and tints.
    """
    count = len(rocks)
    mesh = np.array([4 * rock.sheer + index(rng, 4) for rock in rocks], np.int32)
    slender = np.array([rock.radius / max(rock.radius, rock.height) for rock in rocks]).reshape(-1, 1)
    tilt = uniforms(rng, -0.1, 0.1, (count, 2)) * slender
    wxyz = quantised(yaw_and_tilt(uniforms(rng, 0.0, 2.0 * math.pi, count), tilt), QUATERNION)
    flat = uniforms(rng, 0.72, 1.0, count)
    tint = uniforms(rng, 0.7, 1.1, (count, 1)) * uniforms(rng, 0.95, 1.05, (count, 3))
    position, scale = np.empty((count, 3)), np.empty((count, 3))
    for k, rock in enumerate(rocks):
        shape = meshes[mesh[k]].vertices.astype(np.float64)
        size = shape * (1.0, flat[k], 1.0)
        level = rock.radius / math.sqrt(float(np.square(size[:, :2]).sum(axis=1).max())) * 0.97
        scale[k] = quantised([level, level * flat[k], rock.height / float(np.ptp(shape[:, 2]))], FACTOR)
        turned = rotated(wxyz[k], shape * scale[k])
        # The tilt of a tall rock moves its top sideways: it is made thinner until it keeps to its circle.
        while (over := math.sqrt(float(np.square(turned[:, :2]).sum(axis=1).max())) / rock.radius) > 1.0:
            scale[k, :2] = quantised(scale[k, :2] / (over * 1.01), FACTOR)
            turned = rotated(wxyz[k], shape * scale[k])
        around = rock.radius * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) + (rock.x, rock.y)
        ground = float(terrain.height(around[:, 0], around[:, 1]).max())
        position[k] = quantised([rock.x, rock.y, ground + rock.top - float(turned[:, 2].max())], MILLIMETRE)
    return Instances(
        mesh=mesh + np.int32(first),
        position=position.astype(np.float32),
        wxyz=wxyz.astype(np.float32),
        scale=scale.astype(np.float32),
        tint=quantised(tint, FACTOR).astype(np.float32),
        group=np.array([rock.formation for rock in rocks], np.int32),
    )


def feet(rocks: list[Rock]) -> Float64Array:
    """(T, 3) circles x, y, radius that the rocks cover."""
    return np.array([(rock.x, rock.y, rock.radius) for rock in rocks]).reshape(-1, 3)


def _low(x: float, y: float, radius: float, formation: int, rng: np.random.Generator) -> Rock:
    height = min(uniform(rng, 0.8, 1.3) * radius + 0.3, 1.6)
    return Rock(x, y, radius, height, 1.3 * height, formation, rng.random() < 0.5)


def _tall(x: float, y: float, radius: float, formation: int, rng: np.random.Generator) -> list[Rock]:
    """A pinnacle, or a boulder on a boulder."""
    top = uniform(rng, 2.65, 3.5)
    if radius < 1.0 or rng.random() < 0.5:
        return [Rock(x, y, radius, top, top + 0.35 * radius + 0.4, formation, sheer=True)]
    foot = uniform(rng, 1.35, 1.7)
    smaller = uniform(rng, 0.68, 0.85) * radius
    aside = 0.7 * (radius - smaller)
    dx, dy = quantised(uniforms(rng, -aside, aside, 2), MILLIMETRE)
    # The upper rock sits half a metre into the lower one's rounded top.
    return [
        Rock(x, y, radius, foot, 1.35 * foot, formation),
        Rock(x + float(dx), y + float(dy), smaller, top, top - foot + 0.55, formation, rng.random() < 0.5),
    ]


def _ring(start: SE2, rng: np.random.Generator) -> list[Rock]:
    """Rocks 3.5 to 5 m from the first start; two ways out are at least 2.6 m wide."""
    count = between(rng, 5, 7)
    begin = uniform(rng, 0.0, 2.0 * math.pi)
    rocks: list[Rock] = []
    for k in range(count):
        radius = uniform(rng, 0.65, 0.95)
        away = uniform(rng, max(3.8, CLEAR + radius + 0.05), 4.8)
        angle = begin + 2.0 * math.pi * (k + uniform(rng, -0.15, 0.15)) / (count + 0.6)
        c, s = direction(angle).tolist()
        x, y = round(start.x + away * c, 3), round(start.y + away * s, 3)
        if all(math.hypot(x - o.x, y - o.y) >= radius + o.radius + RING_GAP for o in rocks):
            rocks += (
                _tall(x, y, radius, len(rocks), rng)
                if rng.random() < 0.6
                else [_low(x, y, radius, len(rocks), rng)]
            )
    return rocks


def _free(
    rock: Rock, rocks: list[Rock], starts: tuple[SE2, ...], taken: Float64Array, bounds: Bounds
) -> bool:
    """Does the rock leave the passages, the starts, what is taken and the bounds free?"""
    return (
        bounds.x_min + 1.0 + rock.radius <= rock.x <= bounds.x_max - 1.0 - rock.radius
        and bounds.y_min + 1.0 + rock.radius <= rock.y <= bounds.y_max - 1.0 - rock.radius
        and all(math.hypot(rock.x - o.x, rock.y - o.y) >= rock.radius + o.radius + PASSAGE for o in rocks)
        and all(math.hypot(rock.x - s.x, rock.y - s.y) >= rock.radius + CLEAR for s in starts)
        and all(math.hypot(rock.x - x, rock.y - y) >= rock.radius + r + PASSAGE for x, y, r in taken)
    )
