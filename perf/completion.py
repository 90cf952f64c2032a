"""The completion check per observation, on an arena and on a survey 20 times as long, beside from scratch.

    python perf/completion.py --frames 60

Ground with boulders and patches of targets, half of it explored, is looked at by an 8 m sector that walks
along the edge of the known. Ours takes in each frame and answers; the peer, the same rule from scratch with
numba and scipy, answers every few frames. It follows lines of sight with our kernel; the twin of that in
NumPy is for the tests. The answers must be the same to the cell. CPU time counts all threads.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from scipy import ndimage  # noqa: E402
from tests.mapping import completion_from_scratch as scratch  # noqa: E402

from dream.geometry import SE2, Bounds  # noqa: E402
from dream.mapping import OccupancyMap, check_completion, reachable  # noqa: E402
from dream.mapping._kernels.flags import BARE, EXPLORED, RETURNED  # noqa: E402
from dream.protocol import DREAM_V1  # noqa: E402

Rectangle = tuple[int, int, int, int]
SEEN = EXPLORED | BARE | RETURNED
VOTES = 0x30


class Survey:
    """A strip of sea floor of which the lower half is known, and a vehicle at its edge."""

    def __init__(self, length: float, width: float, *, targets: bool, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.cell = DREAM_V1.cell
        self.map = OccupancyMap(Bounds(0.0, 0.0, length, width), DREAM_V1)
        shape = self.map.shape
        self.solid = _patches(self.rng, shape, round(1.0 / self.cell)) > 2.6
        self.target = _patches(self.rng, shape, round(3.0 / self.cell)) > 1.6
        self.target &= targets
        known = np.zeros(shape, np.bool_)
        known[: shape[0] // 2] = True
        known &= _patches(self.rng, shape, round(2.0 / self.cell)) < 2.0
        self.write((0, 0, *shape), known)

    def write(self, rectangle: Rectangle, seen: npt.NDArray[np.bool_]) -> None:
        """What a frame does to the cells."""
        row, col, past_row, past_col = rectangle
        part = np.s_[row:past_row, col:past_col]
        store, shape = self.map._store, seen.shape
        for name, value in (
            ("flags", np.where(seen, SEEN, 0)),
            ("log_odds", np.where(seen, np.where(self.solid[part], 30, -6), 0)),
            ("votes", np.where(seen & self.target[part], VOTES, 0)),
        ):
            old = store.read(name, (row, col), shape)
            self.map._write(name, (row, col), np.where(seen, value, old))

    def frames(self, count: int) -> Iterator[SE2]:
        """Look with a sector of 90 degrees from places 0.5 m apart, along the edge of the known."""
        rows, cols = self.map.shape
        reach = math.ceil(DREAM_V1.reach / self.cell)
        away = np.arange(-reach, reach + 1)
        radius = np.hypot(away[:, None], away[None, :])
        bearing = np.arctan2(away[:, None], away[None, :])
        for frame in range(count):
            x = 20.0 + 0.5 * (frame % 30)
            y = 0.5 * rows * self.cell - 2.0 + 1.5 * (frame // 30)
            yaw = 0.5 * math.pi + 0.9 * math.sin(0.5 * frame)
            row, col = int(y / self.cell), int(x / self.cell)
            turned = (bearing - yaw + math.pi) % (2.0 * math.pi) - math.pi
            seen = (radius <= reach) & (np.abs(turned) <= math.pi / 4.0)
            seen &= self.rng.random(seen.shape) > 0.002
            found_rows, found_cols = np.nonzero(seen)
            low = (max(row - reach + int(found_rows.min()), 0), max(col - reach + int(found_cols.min()), 0))
            past = (
                min(row - reach + int(found_rows.max()) + 1, rows),
                min(col - reach + int(found_cols.max()) + 1, cols),
            )
            rectangle = (*low, *past)
            part = np.s_[
                low[0] - row + reach : past[0] - row + reach, low[1] - col + reach : past[1] - col + reach
            ]
            self.write(rectangle, seen[part])
            yield SE2(x, y, yaw)


def _patches(
    rng: np.random.Generator, shape: tuple[int, int], size: int
) -> npt.NDArray[np.floating[npt.NBitBase]]:
    """Smooth noise of unit variance, patches of about `size` cells."""
    noise = ndimage.gaussian_filter(rng.normal(size=shape), 0.5 * size)
    return np.asarray(noise / noise.std())


def measure(name: str, survey: Survey, frames: int, every: int) -> float:
    """Print the rows of one map; milliseconds of ours."""
    occupancy = survey.map
    start = time.process_time()
    completion = check_completion(occupancy, SE2(20.0, 10.0, 0.0))
    building = time.process_time() - start
    ours, theirs = [], []
    for frame, pose in enumerate(survey.frames(frames)):
        start = time.process_time()
        completion = check_completion(occupancy, pose)
        ours.append((time.process_time() - start) * 1e3)
        if frame % every == 0:
            start = time.process_time()
            expected = scratch.check_completion(occupancy, pose, scratch.seeable_at_once)
            theirs.append((time.process_time() - start) * 1e3)
            scratch.assert_same(completion, expected)
            np.testing.assert_array_equal(reachable(occupancy, pose), scratch.reachable(occupancy, pose))
    p50, p99 = np.percentile(ours, (50, 99))
    other50, other99 = np.percentile(theirs, (50, 99))
    rows, cols = occupancy.shape
    print(
        f"\n{name}: {rows} x {cols} cells, {len(completion.regions)} regions, "
        f"{len(completion.open_cells)} open cells, {len(scratch.reachable(occupancy, pose))} reachable nodes"
    )
    print(f"{'':24} {'CPU ms p50':>11} {'p99':>9} {'ours':>9}")
    print(f"{'dream, a frame':24} {p50:>11.3f} {p99:>9.3f} {1.0:>8.1f}x")
    print(f"{'from scratch':24} {other50:>11.3f} {other99:>9.3f} {other50 / p50:>8.1f}x")
    print(f"  dream reads everything anew in {building * 1e3:.0f} ms")
    return float(p50)


def main() -> None:
    """Print one table a map."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--every", type=int, default=5, help="frames between answers from scratch")
    arguments = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    measure("to compile", Survey(50.0, 50.0, targets=True, seed=1), 2, 1)
    for targets in (True, False):
        kind = "with targets" if targets else "without"
        short = measure(
            f"50 m, {kind}", Survey(50.0, 50.0, targets=targets, seed=0), arguments.frames, arguments.every
        )
        long = measure(
            f"1 km, {kind}",
            Survey(1000.0, 50.0, targets=targets, seed=0),
            arguments.frames,
            3 * arguments.every,
        )
        print(f"  on the long map {long / short:.2f} times what it is on the short one")
    print("\nours: how many times as fast as that row dream is, in the same run. Equal to the cell.")


if __name__ == "__main__":
    main()
