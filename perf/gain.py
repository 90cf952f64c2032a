"""Views per CPU-second of the view gain, beside ray casters on the same maps, in one run.

    python perf/gain.py          or: python perf/gain.py --cells 0.1 --seed 7

CPU time counts all threads of the process; each contender takes the least of its rounds, since other programs
only ever add time. The ray casters cast 720 rays a view and count each cell once. Bias and correlation are
against 7200 rays in the full turn, cut at every grid line they meet, from the exact positions.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from numba import njit  # noqa: E402

from dream.geometry import Bounds  # noqa: E402
from dream.mapping import OccupancyMap, gain  # noqa: E402
from dream.protocol import DREAM_V1, SurveyProtocol  # noqa: E402

Array = npt.NDArray[Any]
SIDE = 60.0
"""Metres along the map."""
RAYS = 720
"""A view; 2880 in a turn."""
EXACT = 7200
"""In a turn."""
Contender = Callable[["Scene", Array, int], Array]


@dataclass(frozen=True)
class Scene:
    """A map, as the contenders read it."""

    name: str
    protocol: SurveyProtocol
    bounds: Bounds
    solid: Array
    observed: Array

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.solid.shape[0], self.solid.shape[1]


def scene(kind: str, share: float, cell: float, seed: int) -> Scene:
    """A share of solid cells, in boxes of 0.5 to 3 m or one by one; discs of observed ground."""
    rng = np.random.default_rng(seed)
    side = round(SIDE / cell)
    solid = np.zeros((side, side), np.bool_)
    if kind == "lone cells":
        solid = rng.random(solid.shape) < share
    while solid.mean() < share:
        height, width = (rng.uniform(0.5, 3.0, 2) / cell).astype(int)
        row, col = rng.integers(0, side, 2)
        solid[row : row + height, col : col + width] = True
    explored = np.zeros_like(solid)
    rows, cols = np.indices(solid.shape, sparse=True)
    while explored.mean() < 0.4:
        row, col = rng.integers(0, side, 2)
        explored |= (rows - row) ** 2 + (cols - col) ** 2 < (5.0 / cell) ** 2
    protocol = dataclasses.replace(DREAM_V1, cell=cell)
    return Scene(f"{share:.0%} {kind}", protocol, Bounds(0.0, 0.0, SIDE, SIDE), solid, explored)


@njit(cache=False, nogil=True)
def cast_rays(solid, x, y, first, step, reach, rays, seen, stamp, cells):  # type: ignore[no-untyped-def]
    """List the cells that the rays get to, each once: from grid line to grid line. Lengths in cells."""
    rows, cols = solid.shape
    count = 0
    for ray in range(rays):
        dx, dy = math.cos(first + ray * step), math.sin(first + ray * step)
        i, j = math.floor(y), math.floor(x)
        up, right = (1 if dy > 0.0 else -1), (1 if dx > 0.0 else -1)
        next_x = (j + (dx > 0.0) - x) / dx if dx != 0.0 else np.inf
        next_y = (i + (dy > 0.0) - y) / dy if dy != 0.0 else np.inf
        step_x = abs(1.0 / dx) if dx != 0.0 else np.inf
        step_y = abs(1.0 / dy) if dy != 0.0 else np.inf
        at = 0.0
        while at <= reach + 1.0 and 0 <= i < rows and 0 <= j < cols:
            if seen[i, j] != stamp:
                seen[i, j] = stamp
                cells[count] = i * cols + j
                count += 1
            if solid[i, j]:
                break
            if next_x < next_y:
                at = next_x
                next_x += step_x
                j += right
            else:
                at = next_y
                next_y += step_y
                i += up
    return count


@njit(cache=False, nogil=True)
def count_views(solid, explored, positions, headings, half, reach, blind, rays, whole_turn):  # type: ignore[no-untyped-def]
    """New cells of every view; rays of the view alone, or of the whole turn and then its sector's cells."""
    cols = solid.shape[1]
    seen = np.zeros(solid.shape, np.int32)
    cells = np.empty(solid.size, np.int32)
    counts = np.zeros((len(positions), headings), np.float32)
    stamp, found = 0, 0
    cos_half = math.cos(half)
    for p in range(len(positions)):
        x, y = positions[p]
        for h in range(headings):
            yaw = 2.0 * math.pi * h / headings
            if h == 0 or not whole_turn:
                stamp += 1
                step = (2.0 * math.pi if whole_turn else 2.0 * half) / rays
                first = 0.5 * step + (0.0 if whole_turn else yaw - half)
                found = cast_rays(solid, x, y, first, step, reach, rays, seen, stamp, cells)
            forward_x, forward_y = math.cos(yaw), math.sin(yaw)
            for k in range(found):
                i, j = cells[k] // cols, cells[k] % cols
                if explored[i, j]:
                    continue
                to_x, to_y = j + 0.5 - x, i + 0.5 - y
                distance = math.sqrt(to_x * to_x + to_y * to_y)
                forward = to_x * forward_x + to_y * forward_y
                if distance <= reach and forward >= distance * cos_half - 1e-6 and forward >= blind:
                    counts[p, h] += 1.0
    return counts


def ours(on: Scene, positions: Array, headings: int) -> Array:
    """Dream: one sweep a position."""
    return gain(cast(OccupancyMap, on), positions, headings=headings)


def with_numba(
    on: Scene, positions: Array, headings: int, *, rays: int = RAYS, whole_turn: bool = False
) -> Array:
    """Rays of each view by themselves, compiled."""
    p = on.protocol
    half = 0.5 * p.camera.horizontal_fov
    counts: Array = count_views(
        on.solid, on.observed, positions / p.cell, headings, half, p.reach / p.cell, p.blind / p.cell, rays,
        whole_turn,
    )  # fmt: skip
    return counts


def exact(on: Scene, positions: Array, headings: int) -> Array:
    """What bias and correlation are against."""
    return with_numba(on, positions, headings, rays=EXACT, whole_turn=True)


def with_numpy(on: Scene, positions: Array, headings: int) -> Array:
    """Rays of each view sampled every half cell, no loops over rays or samples."""
    p = on.protocol
    half, reach, blind = 0.5 * p.camera.horizontal_fov, p.reach / p.cell, p.blind / p.cell
    fan = (np.arange(RAYS, dtype=np.float32) + 0.5) * 2.0 * half / RAYS - half
    away = np.arange(0.0, reach + 1.0, 0.5, dtype=np.float32)
    steps = np.arange(len(away))
    span = math.ceil(reach) + 2
    side = 2 * span + 1
    solid, explored = (np.pad(layer, span, constant_values=True) for layer in (on.solid, on.observed))
    counts = np.zeros((len(positions), headings), np.float32)
    for n, (x, y) in enumerate(positions / p.cell):
        window = np.s_[int(y) : int(y) + side, int(x) : int(x) + side]
        stop, new = solid[window].ravel(), ~explored[window]
        inside_x, inside_y = np.float32(x % 1.0 + span), np.float32(y % 1.0 + span)
        dx = np.arange(side) + 0.5 - inside_x
        dy = (np.arange(side) + 0.5 - inside_y)[:, None]
        distance = np.hypot(dx, dy)
        for h in range(headings):
            yaw = 2.0 * math.pi * h / headings
            row = (inside_y + away * np.sin(yaw + fan).astype(np.float32)[:, None]).astype(np.int32)
            col = (inside_x + away * np.cos(yaw + fan).astype(np.float32)[:, None]).astype(np.int32)
            cells = row * side + col
            stops = stop[cells]
            first = np.where(stops.any(axis=1), stops.argmax(axis=1), len(away) - 1)
            seen = np.zeros(side * side, np.bool_)
            seen[cells[steps <= first[:, None]]] = True
            forward = dx * math.cos(yaw) + dy * math.sin(yaw)
            in_sector = (forward >= distance * math.cos(half) - 1e-6) & (forward >= blind)
            counts[n, h] = np.count_nonzero(seen.reshape(side, side) & new & in_sector & (distance <= reach))
    return counts


CONTENDERS: dict[str, tuple[Contender, int]] = {
    "dream": (ours, 576),
    "numba, rays a view": (with_numba, 8),
    "NumPy, rays a view": (with_numpy, 1),
}
"""By name, and how many positions are enough to time them."""


def cpu(call: Callable[[], object], rounds: int) -> float:
    """CPU seconds, the least of the rounds."""
    taken = []
    for _ in range(rounds):
        start = time.process_time()
        call()
        taken.append(time.process_time() - start)
    return min(taken)


def places(on: Scene, count: int) -> Array:
    """Every so many metres on the lattice, in the middle of the map."""
    side = math.ceil(math.sqrt(count))
    line = (
        12.0 + np.arange(side) * max(math.floor(36.0 / side / on.protocol.lattice), 1) * on.protocol.lattice
    )
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)[:count]


def agreement(found: Array, true: Array) -> str:
    """Bias of the total and correlation over views."""
    bias = found.sum() / true.sum() - 1.0
    return f"{bias:>+8.2%} {np.corrcoef(found.ravel(), true.ravel())[0, 1]:>8.5f}"


def main() -> None:
    """Print one table for speed, one for agreement."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", type=float, nargs="*", default=[0.1, 0.25])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seed", type=int, default=101)
    arguments = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    print(f"\nspeed: 5% boxes, 40% observed, reach {DREAM_V1.reach:g} m, 90° views, positions on the lattice")
    print(f"{'':24} {'cell m':>6} {'headings':>9} {'us/position':>12} {'views/CPU-s':>12} {'ours':>8}")
    for cell in arguments.cells:
        world = scene("boxes", 0.05, cell, arguments.seed)
        for headings in (12, 64):
            best = 0.0
            for name, (contender, count) in CONTENDERS.items():
                positions = places(world, count)
                contender(world, positions[:1], headings)
                contender(world, positions[:1], 1)
                taken = cpu(lambda: contender(world, positions, headings), arguments.rounds)  # noqa: B023
                speed = len(positions) * headings / taken
                best = best or speed
                print(
                    f"{name:24} {cell:>6g} {headings:>9}{taken / len(positions) * 1e6:>13.1f} {speed:>12,.0f}"
                    f" {best / speed:>7.1f}x"
                )
    print(f"\nagreement of new cells a view with {EXACT} rays a turn: bias and correlation, 12 headings")
    print(f"{'':24} {'cell m':>6} " + " ".join(f"{name:>18}" for name in ("dream", "720 rays a view")))
    for cell in arguments.cells:
        for kind in ("boxes", "lone cells"):
            for share in (0.02, 0.05, 0.1):
                world = scene(kind, share, cell, arguments.seed + 1)
                rng = np.random.default_rng(arguments.seed)
                anywhere = rng.uniform(10.0, SIDE - 10.0, (24, 2))
                row, col = (anywhere[:, ::-1] / cell).astype(int).T
                anywhere = anywhere[~world.solid[row, col]]
                true = exact(world, anywhere, 12)
                columns = (agreement(f(world, anywhere, 12), true) for f in (ours, with_numba))
                print(f"{world.name:24} {cell:>6g} " + " ".join(f"{column:>18}" for column in columns))
    print("\nours: how many times as fast as that row dream is, in the same run.")


if __name__ == "__main__":
    main()
