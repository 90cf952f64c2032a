"""Frontiers, clusters and inflation per observation, beside scipy and scikit-image, in one run.

    python perf/edges.py --frames 300

A map that is known in part is looked at by an 8 m sector that walks across it. Ours takes in each frame; the
peers, which know no map that changes, begin from scratch, a few times on the small map and once on the large
one. What comes out must be the same to the cell. CPU time counts all threads of the process.
"""

from __future__ import annotations

import argparse
import functools
import math
import os
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from scipy import ndimage  # noqa: E402

from dream.mapping._kernels.flags import EXPLORED, FRONTIER, INFLATED  # noqa: E402
from dream.mapping.blocks import BlockStore  # noqa: E402
from dream.mapping.edges import Edges  # noqa: E402

BoolArray = npt.NDArray[np.bool_]
Rectangle = tuple[int, int, int, int]

SIDE = 64
REACH = 8.0
BODY_RADIUS = 0.35
LAYERS = {"log_odds": (np.int8, (SIDE, SIDE)), "flags": (np.uint8, (SIDE, SIDE))}
CROSS = ndimage.generate_binary_structure(2, 1)
SQUARE = np.ones((3, 3), np.bool_)


@dataclass(frozen=True)
class Result:
    """What every contender must find."""

    frontier: BoolArray
    inflated: BoolArray
    sizes: npt.NDArray[np.int64]
    centroids: npt.NDArray[np.float64]


class World:
    """A square map, known in part, as plain arrays and as blocks."""

    def __init__(self, side: int, cell: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.cell = cell
        self.needed_room = math.floor((2.0 * BODY_RADIUS / cell + math.sqrt(2.0)) ** 2 - 1e-9)
        # Patches of some metres, known or not, with holes; boulders.
        blocks = -(-side // SIDE)
        shape = (blocks * SIDE, blocks * SIDE)
        self.known = _patches(rng, shape, round(2.5 / cell)) < 0.0
        self.known &= rng.random(shape) > 0.002
        self.truth = _patches(rng, shape, round(0.5 / cell)) > 2.0
        self.solid = self.truth & self.known
        self.store = BlockStore(LAYERS)
        self.low = -(blocks // 2) * SIDE
        first = self.low // SIDE
        keys = [(first + i, first + j) for i in range(blocks) for j in range(blocks)]
        self.store.make(keys)
        self.write((0, 0, *shape))
        self.rng = rng

    def write(self, rectangle: Rectangle) -> None:
        """Copy a rectangle of the arrays into the blocks, as the map would change them."""
        row, col, past_row, past_col = rectangle
        for i in range(row // SIDE, (past_row - 1) // SIDE + 1):
            for j in range(col // SIDE, (past_col - 1) // SIDE + 1):
                slot = self.store.slot_of[self.low // SIDE + i, self.low // SIDE + j]
                part = np.s_[i * SIDE : (i + 1) * SIDE, j * SIDE : (j + 1) * SIDE]
                self.store.pools["log_odds"][slot] = np.where(self.solid[part], 3, -2)
                flags = self.store.pools["flags"][slot]
                flags[:] = np.where(self.known[part], flags | EXPLORED, flags)

    def frames(self, count: int) -> Iterator[Rectangle]:
        """Look with a sector of 90° from places 0.3 m apart, swaying; what each look may have changed."""
        side = len(self.known)
        reach = math.ceil(REACH / self.cell)
        x, y, yaw = 0.5 * side, 0.5 * side, 0.3
        away = np.arange(-reach, reach + 1)
        radius = np.hypot(away[:, None], away[None, :])
        bearing = np.arctan2(away[:, None], away[None, :])
        for frame in range(count):
            yaw += 0.15 * math.sin(0.11 * frame) + self.rng.normal(0.0, 0.02)
            step = 0.3 / self.cell
            x, y = x + step * math.cos(yaw), y + step * math.sin(yaw)
            margin = reach + 4
            if not (margin < x < side - margin and margin < y < side - margin):
                x, y, yaw = 0.5 * side, 0.5 * side, self.rng.uniform(-math.pi, math.pi)
            row, col = int(y), int(x)
            here = np.s_[row - reach : row + reach + 1, col - reach : col + reach + 1]
            turned = (bearing - yaw + math.pi) % (2.0 * math.pi) - math.pi
            seen = (radius <= reach) & (np.abs(turned) <= math.pi / 4.0)
            rows, cols = np.nonzero(seen)
            seen &= self.rng.random(seen.shape) > 0.001
            self.known[here] |= seen
            # One cell in a hundred of what is solid is missed.
            solid = self.truth[here] & (self.rng.random(seen.shape) > 0.01)
            self.solid[here] = np.where(seen, solid, self.solid[here])
            rectangle = (
                row - reach + int(rows.min()),
                col - reach + int(cols.min()),
                row - reach + int(rows.max()) + 1,
                col - reach + int(cols.max()) + 1,
            )
            self.write(rectangle)
            yield rectangle


def _patches(rng: np.random.Generator, shape: tuple[int, int], size: int) -> npt.NDArray[np.float32]:
    """Smooth noise of unit variance, patches of about `size` cells."""
    coarse = tuple(n // size + 3 for n in shape)
    noise = ndimage.zoom(rng.normal(size=coarse).astype(np.float32), size, order=1)[: shape[0], : shape[1]]
    smooth: npt.NDArray[np.float32] = noise / noise.std()
    return smooth


def with_scipy(world: World) -> Result:
    """Dilate, label, centroids; distance to the nearest solid cell's square."""
    free = world.known & ~world.solid
    frontier: BoolArray = free & ndimage.binary_dilation(~(world.known | world.solid), CROSS)
    labels, count = ndimage.label(frontier, SQUARE)
    numbers = np.arange(1, count + 1)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    centroids = np.array(ndimage.center_of_mass(frontier, labels, numbers)).reshape(-1, 2)
    inflated = ndimage.binary_dilation(world.solid, _body(world.needed_room))
    return Result(frontier, inflated, sizes, centroids)


def with_scikit_image(world: World) -> Result:
    """The same with its own label, regions and dilation."""
    from skimage.measure import label, regionprops_table
    from skimage.morphology import dilation

    free = world.known & ~world.solid
    frontier = free & dilation(~(world.known | world.solid), CROSS)
    labels = label(frontier, connectivity=2)
    table = regionprops_table(labels, properties=("area", "centroid"))
    centroids = np.stack([table["centroid-0"], table["centroid-1"]], axis=1)
    inflated = dilation(world.solid, _body(world.needed_room))
    return Result(frontier, inflated, np.asarray(table["area"], np.int64), centroids)


def _body(needed_room: int) -> BoolArray:
    """The structuring element of inflation."""
    radius = (math.isqrt(needed_room) + 1) // 2
    half = np.maximum(2 * np.abs(np.arange(-radius, radius + 1)) - 1, 0)
    disc: BoolArray = half[:, None] ** 2 + half[None, :] ** 2 <= needed_room
    return disc


def with_ours(world: World, edges: Edges) -> Result:
    """What the incremental one holds."""
    shape = world.known.shape
    flags = world.store.read("flags", (world.low, world.low), shape)
    clusters = edges.clusters()
    sizes = np.array([cluster.size for cluster in clusters], np.int64)
    centroids = np.array([cluster.centroid for cluster in clusters]).reshape(-1, 2) - world.low
    return Result((flags & FRONTIER) > 0, (flags & INFLATED) > 0, sizes, centroids)


def check(name: str, ours: Result, theirs: Result) -> None:
    """Equal to the cell, clusters in the order of their first cells, or an error."""
    for part in ("frontier", "inflated", "sizes"):
        if not np.array_equal(getattr(ours, part), getattr(theirs, part)):
            raise AssertionError(f"{part}: expected what {name} finds, got something else")
    np.testing.assert_allclose(ours.centroids, theirs.centroids, rtol=1e-9, atol=1e-6)


def cpu_ms(call: Callable[[], Any]) -> tuple[float, Any]:
    """CPU milliseconds of one call, and what it gave."""
    start = time.process_time()
    result = call()
    return (time.process_time() - start) * 1e3, result


def measure(side: int, cell: float, frames: int, rounds: int) -> None:
    """Print the rows of one map."""
    world = World(side, cell, 0)
    bounds = (world.low, world.low, len(world.known), len(world.known))
    building, edges = cpu_ms(lambda: Edges(world.store, world.needed_room, bounds))
    taken = []
    for rectangle in world.frames(frames):
        moved = tuple(index + world.low for index in rectangle)
        start = time.process_time_ns()
        edges.update(moved[0], moved[1], moved[2], moved[3])
        taken.append((time.process_time_ns() - start) * 1e-6)
    p50, p99 = np.percentile(taken, (50, 99))
    reading, clusters = cpu_ms(edges.clusters)
    ours = with_ours(world, edges)
    print(
        f"\n{len(world.known)} x {len(world.known)} cells of {cell:g} m: "
        f"{np.count_nonzero(ours.frontier)} frontier cells in {len(clusters)} clusters, "
        f"needed room {world.needed_room}"
    )
    print(f"{'':24} {'CPU ms p50':>11} {'p99':>9} {'ours':>9}")
    print(f"{'dream, a frame':24} {p50:>11.3f} {p99:>9.3f} {1.0:>8.1f}x")
    peers: dict[str, Callable[[World], Result]] = {
        "scipy, from scratch": with_scipy,
        "scikit-image, likewise": with_scikit_image,
    }
    missing = []
    for name, peer in peers.items():
        try:
            times = []
            for _ in range(rounds):
                spent, theirs = cpu_ms(functools.partial(peer, world))
                times.append(spent)
        except ImportError as error:
            missing.append(f"{name.split(',')[0]}: not installed ({error})")
            continue
        check(name, ours, theirs)
        theirs_p50, theirs_p99 = np.percentile(times, (50, 99))
        print(f"{name:24} {theirs_p50:>11.3f} {theirs_p99:>9.3f} {theirs_p50 / p50:>8.1f}x")
    print(
        f"  dream reads the clusters in {reading:.2f} ms, builds all anew in {building:.0f} ms, "
        f"holds {edges.nbytes / 1e6:.1f} MB"
    )
    for line in missing:
        print(line)


def main() -> None:
    """Print one table a map."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    # The first calls compile the kernels or read them from disk.
    Edges(World(128, 0.25, 1).store, 17)
    for side, cell, rounds in ((500, 0.25, arguments.rounds), (500, 0.1, arguments.rounds), (5000, 0.1, 1)):
        measure(side, cell, arguments.frames, rounds)
    print("\nours: how many times as fast as that row dream is, in the same run. Equal to the cell.")


if __name__ == "__main__":
    main()
