"""The tank of the paper's real test: 12 ft across, 5 ft deep, 200 shells in an arc and two pipes."""

from __future__ import annotations

import math

import numpy as np

from dream.geometry import SE2, Bounds
from dream.protocol import POOL_V1
from dream.sim.meshes import post, ring_wall, shell
from dream.sim.sampling import (
    FACTOR,
    MILLIMETRE,
    QUATERNION,
    Float64Array,
    direction,
    directions,
    index,
    indices,
    quantised,
    uniform,
    uniforms,
    yaw_and_tilt,
)
from dream.sim.terrain import terrain
from dream.sim.water import Water
from dream.sim.world import Instances, World

RADIUS = 1.829
"""Metres to the inner face of the wall: 12 ft across."""
DEPTH = 1.524
"""Metres of water: 5 ft."""
SHELLS = 200
PIPE = 0.055
"""Radius of a pipe, metres."""
PASSAGE = 0.9
"""Least metres between a pipe and the wall or the other pipe."""
GROUP = 1.0
"""Metres of the arc that make one group."""


def pool(rng: np.random.Generator, water: Water) -> World:
    """`pool/arc`. The wall and the pipes are obstacles; the arc runs about 0.6 m inside the wall."""
    half = 1.85
    seabed = terrain(np.full((41, 41), -DEPTH), Bounds(-2.5, -2.5, 2.5, 2.5), 0.125)
    away = uniform(rng, 0.0, 2.0 * math.pi)
    starts = tuple(_start(away + turn, 0.8, rng) for turn in (0.0, 0.25, -0.25))
    pipes = _pipes(away, starts, rng)
    targets = _arc(away + math.pi + uniform(rng, -0.6, 0.6), pipes, rng)
    count = 1 + len(pipes)
    return World(
        name="pool/arc",
        seed=0,
        protocol=POOL_V1.name,
        bounds=Bounds(-half, -half, half, half),
        starts=starts,
        terrain=seabed,
        meshes=(
            *(shell(rng) for _ in range(8)),
            ring_wall(RADIUS, 0.05, DEPTH + 0.15, 72, (128, 158, 176)),
            post(PIPE, 1.35, 24, (214, 212, 204)),
        ),
        targets=targets,
        hull=np.zeros(len(targets), np.bool_),
        obstacles=Instances(
            mesh=np.array([8] + [9] * len(pipes), np.int32),
            position=np.array([[0.0, 0.0, -DEPTH], *([x, y, -DEPTH] for x, y in pipes)], np.float32),
            wxyz=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
            scale=np.ones((count, 3), np.float32),
            tint=np.ones((count, 3), np.float32),
            group=np.arange(count, dtype=np.int32),
        ),
        water=water,
    )


def _start(angle: float, radius: float, rng: np.random.Generator) -> SE2:
    x, y = radius * direction(angle)
    heading = index(rng, POOL_V1.headings) * POOL_V1.heading_step
    return POOL_V1.snap(SE2(float(x), float(y), heading))


def _pipes(away: float, starts: tuple[SE2, ...], rng: np.random.Generator) -> Float64Array:
    """(2, 2) metres: one to either side, where a vehicle passes them on any side."""
    while True:
        left, right = uniforms(rng, 1.75, 2.5, 2)
        radii = uniforms(rng, 0.72, RADIUS - PIPE - PASSAGE - 0.002, (2, 1))
        pipes = quantised(radii * directions(np.array([away + left, away - right])), MILLIMETRE)
        apart = math.hypot(*(pipes[0] - pipes[1])) - 2.0 * PIPE
        clear = min(math.hypot(x - s.x, y - s.y) for x, y in pipes for s in starts) - PIPE
        if apart >= PASSAGE and clear >= POOL_V1.launch_radius + POOL_V1.body_radius + 0.01:
            return pipes


def _arc(middle: float, pipes: Float64Array, rng: np.random.Generator) -> Instances:
    """200 shells about 0.1 m long, 0.6 m wide around part of the tank."""
    span = uniform(rng, 2.6, 3.6)
    pieces = max(1, round(1.15 * span / GROUP))
    kept_x: list[float] = []
    kept_y: list[float] = []
    kept_group: list[int] = []
    while len(kept_x) < SHELLS:
        share = float(rng.random())
        x, y = quantised(uniform(rng, 0.85, 1.45) * direction(middle + (share - 0.5) * span), MILLIMETRE)
        near = min((math.hypot(x - a, y - b) for a, b in zip(kept_x, kept_y, strict=True)), default=1.0)
        if near > 0.055 and all(math.hypot(x - a, y - b) > PIPE + 0.07 for a, b in pipes):
            kept_x.append(float(x))
            kept_y.append(float(y))
            kept_group.append(min(int(share * pieces), pieces - 1))
    size = uniforms(rng, 0.085, 0.115, SHELLS)
    tilt = uniforms(rng, -0.12, 0.12, (SHELLS, 2))
    yaw = uniforms(rng, 0.0, 2.0 * math.pi, SHELLS)
    return Instances(
        mesh=indices(rng, 8, SHELLS).astype(np.int32),
        position=np.stack([kept_x, kept_y, np.full(SHELLS, -DEPTH + 0.003)], 1).astype(np.float32),
        wxyz=quantised(yaw_and_tilt(yaw, tilt), QUATERNION).astype(np.float32),
        scale=quantised(size[:, None] * uniforms(rng, 0.92, 1.08, (SHELLS, 3)), FACTOR).astype(np.float32),
        tint=quantised(uniforms(rng, 0.8, 1.25, (SHELLS, 1)) * np.ones(3), FACTOR).astype(np.float32),
        group=np.array(kept_group, np.int32),
    )
