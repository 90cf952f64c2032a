"""CPU time and accuracy of the map beside named peers: the same noisy frames, one run, unseen seeds.

    python perf/map.py --quick          one seed, 40 frames
    python perf/map.py                  seeds 101 to 105, all frames; some minutes a seed
    python perf/map.py --kilometre      ours alone: is it as fast after a kilometre as at the start?
    python perf/map.py --memory         ours alone: what does it hold after a quarter of a square kilometre?

CPU time counts all threads of the process. All maps take turns at every frame, so that the caches are
nobody's. Frames are uint16 millimetres with noise, labels with missed individuals and false targets; see
map_workload.py, also for what truth is.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import itertools
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from scipy import ndimage  # noqa: E402

import map_workload as workload  # noqa: E402
from dream.geometry import SE3, Bounds, Camera  # noqa: E402
from dream.mapping import OccupancyMap, frontiers  # noqa: E402
from dream.protocol import DREAM_V1, SurveyProtocol  # noqa: E402
from map_peers import PEERS, TWO, BoolArray, Layers, Mapper, Survey  # noqa: E402

SEEDS = (101, 102, 103, 104, 105)
"""Never used in development; seeds 1 to 5 are."""
BAND = (0.35, 2.5)
SQUARES = 100
"""Of 50 m, that `memory` surveys."""
LAP = workload.FRAMES - workload.PANORAMA
"""Frames after which `kilometre` repeats its images."""


def protocol(cell: float, reach: float) -> SurveyProtocol:
    """The protocol of the workload."""
    return dataclasses.replace(
        DREAM_V1,
        name="perf",
        altitude=workload.ALTITUDE,
        camera=workload.CAMERA,
        min_depth=workload.MIN_DEPTH,
        max_depth=workload.MAX_DEPTH,
        reach=reach,
        cell=cell,
        band=BAND,
    )


class Ours:
    """The map of this project. It learns the height of the seabed itself."""

    name = "dream"
    does = f"{TWO}: finds the seabed's height itself, which all others are given; targets"
    stride = 1

    def __init__(self, survey: Survey) -> None:
        self.map = OccupancyMap(survey.bounds, protocol(survey.cell, survey.reach))

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame."""
        self.map.integrate(depth_mm, labels, camera, pose)

    def layers(self) -> Layers:
        """Solid, explored, target."""
        return self.map.solid, self.map.explored, self.map.target

    def megabytes(self) -> float:
        """Of all blocks that it holds."""
        return self.map.nbytes / 1e6


class OursWithFrontiers(Ours):
    """The same, and what no other does."""

    name = "dream, with frontier"
    does = f"{TWO}: the same, and the frontier and its clusters after every frame"

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame, and ask for the frontier."""
        super().integrate(depth_mm, labels, camera, pose)
        frontiers(self.map)


# ------------------------------------------------------------------------------------------- measuring


def contenders(names: list[str] | None) -> tuple[list[Callable[[Survey], Mapper]], list[str]]:
    """Those that are there, and a sentence for each that is not."""
    ready: list[Callable[[Survey], Mapper]] = []
    missing = []
    tiny = Survey(Bounds(-10.0, -10.0, 10.0, 10.0), 0.5, 4.0, BAND, 1.0, np.full((40, 40), -10.0))
    for make in (Ours, OursWithFrontiers, *PEERS):
        name = str(make.name)  # type: ignore[attr-defined]
        if names and not any(wanted.lower() in name.lower() for wanted in names):
            continue
        try:
            make(tiny)
            ready.append(make)
        except ImportError as error:
            missing.append(f"{name}: not measured ({error})")
    return ready, missing


def survey_of(scene: workload.Scene, cell: float, reach: float) -> Survey:
    """What the maps are told of a scene."""
    bounds = scene.bounds
    x = bounds.x_min + (np.arange(round(bounds.width / cell)) + 0.5) * cell
    y = bounds.y_min + (np.arange(round(bounds.depth / cell)) + 0.5) * cell
    ground = scene.world.terrain.height(x[None, :], y[:, None])
    return Survey(bounds, cell, reach, BAND, protocol(cell, reach).blind, ground)


def fly(mappers: list[Mapper], frames: Iterable[workload.Frame], camera: Camera) -> list[list[float]]:
    """CPU milliseconds of each frame, for each map."""
    taken: list[list[float]] = [[] for _ in mappers]
    gc.collect()
    gc.disable()
    try:
        for k, frame in enumerate(frames):
            # Copied, so that nobody pays for reading the file; by turns, so that nobody is always first.
            depth, labels = np.array(frame.depth_mm), np.array(frame.labels_noisy)
            for m in np.roll(np.arange(len(mappers)), k):
                if k % mappers[m].stride == 0:
                    mapper = mappers[m]
                    start = time.process_time()
                    mapper.integrate(depth, labels, camera, frame.T_world_camera)
                    taken[m].append(1e3 * (time.process_time() - start))
    finally:
        gc.enable()
    return taken


def ratio(part: BoolArray, whole: BoolArray) -> float:
    """Share of `whole` that is in `part`; NaN where it is empty."""
    count = np.count_nonzero(whole)
    return np.count_nonzero(part & whole) / count if count else math.nan


def accuracy(layers: Layers, truth: workload.Truth) -> dict[str, float]:
    """Precision (P) and recall (R) of what a map holds, over the scored cells."""
    solid, explored, target = layers
    inside = truth.scored
    observed = truth.solid & truth.solid_observed & inside
    square = np.ones((3, 3), np.bool_)
    precision, recall = ratio(truth.solid, solid & inside), ratio(solid, observed)
    scores = {
        "occ P": precision,
        "occ R": recall,
        "occ F1": 2.0 * precision * recall / max(precision + recall, 1e-9),
        "P±1": ratio(ndimage.binary_dilation(truth.solid, square), solid & inside),
        "R±1": ratio(ndimage.binary_dilation(solid, square), observed),
    }
    for name, there in (("2d", truth.explored_2d), ("3d", truth.explored_3d)):
        scores[f"E{name} P"] = ratio(there, explored & inside)
        scores[f"E{name} R"] = ratio(explored, there & inside)
    scores["E P"] = ratio(truth.explored_2d | truth.explored_3d, explored & inside)
    if target is not None:
        scores["tgt P"] = ratio(truth.target_touched, target & inside)
        scores["tgt P½"] = ratio(truth.target, target & inside)
        scores["tgt R"] = ratio(target, truth.target & truth.target_observed & inside)
    return scores


COLUMNS = (
    "occ P",
    "occ R",
    "occ F1",
    "P±1",
    "R±1",
    "E2d P",
    "E2d R",
    "E3d P",
    "E3d R",
    "E P",
    "tgt P",
    "tgt P½",
    "tgt R",
)


def measure(arguments: argparse.Namespace) -> None:
    """Fly all maps over all seeds and print the tables."""
    makes, missing = contenders(arguments.only)
    speed: dict[str, list[dict[str, float]]] = {}
    right: dict[str, list[dict[str, float]]] = {}
    does: dict[str, str] = {}
    for seed in arguments.seeds:
        began = time.monotonic()
        scene = workload.make_scene(seed)
        frames = workload.frames(scene, arguments.folder)[: arguments.frames]
        survey = survey_of(scene, arguments.cell, arguments.reach)
        truth = workload.truth(
            scene, frames, arguments.cell, arguments.reach, BAND, survey.blind, arguments.folder
        )
        fly([make(survey) for make in makes], frames[:2], scene.camera)  # compiles what must be compiled
        mappers = [make(survey) for make in makes]
        print(f"seed {seed}: flying", file=sys.stderr, flush=True)
        for mapper, taken in zip(mappers, fly(mappers, frames, scene.camera), strict=True):
            does[mapper.name] = mapper.does
            p50, p99 = np.percentile(taken, (50, 99))
            row = {"mean": float(np.mean(taken)), "p50": p50, "p99": p99, "p99/p50": p99 / p50}
            speed.setdefault(mapper.name, []).append(row | {"MB": mapper.megabytes()})
            if mapper.stride == 1:
                right.setdefault(mapper.name, []).append(accuracy(mapper.layers(), truth))
        print(f"seed {seed}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)

    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, NumPy {np.__version__}")
    size = f"{arguments.frames} frames of {workload.CAMERA.width} x {workload.CAMERA.height}"
    seeds = ", ".join(map(str, arguments.seeds))
    print(f"cells {arguments.cell} m, reach {arguments.reach} m, {size}, seeds {seeds}")
    print("\nCPU ms a frame: mean over the seeds [least - greatest]")
    fixed = ("plain NumPy", "pyoctomap", "Bonxai")
    columns = ("mean", "p50", "p99", "p99/p50", "MB")
    print(f"{'':22}" + "".join(f"{name:>22}" for name in columns) + "".join(f"{f'x {n}':>15}" for n in fixed))
    for name, rows in speed.items():
        line = "".join(f"{spread([row[column] for row in rows], 2):>22}" for column in columns)
        for other in fixed:
            times = [b["mean"] / a["mean"] for a, b in zip(rows, speed.get(other, []), strict=False)]
            line += f"{np.mean(times):>15.3g}" if times else f"{'-':>15}"
        print(f"{name:22}{line}")
    print("x NAME: how many times as fast as NAME that row is: the mean of the seeds' ratios of means.")
    print("\nAccuracy: mean over the seeds, and below it least - greatest")
    print(f"{'':22}" + "".join(f"{name:>12}" for name in COLUMNS))
    for name, rows in right.items():
        values = {column: [row[column] for row in rows if column in row] for column in COLUMNS}
        print(f"{name:22}" + "".join(f"{np.mean(v):>12.4f}" if v else f"{'-':>12}" for v in values.values()))
        if len(rows) > 1:
            ends = (f"{min(v):.3f}-{max(v):.3f}" if v else "" for v in values.values())
            print(f"{'':22}" + "".join(f"{text:>12}" for text in ends))
    print(
        "occ: solid; P against the true footprint, R against what of it was observed; ±1 forgives a cell.\n"
        "E2d: explored against the paper's visibility among true obstacles; E3d: against columns crossed;\n"
        "E: against either. Returns on a low obstacle or over it explore in 3-D, not in the paper's 2-D.\n"
        "tgt: labels have 10 % misses and false targets; R of the cells at least half covered by oysters,\n"
        "P of those that hold any. P½ asks for half, which views from the side do not tell: clumps hide the\n"
        "ground behind."
    )
    for name, line in does.items():
        print(f"  {name}: {line}")
    for line in missing:
        print(f"  {line}")


def spread(values: list[float], digits: int) -> str:
    """Mean [least - greatest]."""
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} [{min(values):.{digits}f}-{max(values):.{digits}f}]"


def kilometre(arguments: argparse.Namespace) -> None:
    """Print our time on the same images at the start and after a kilometre, on a map without bounds."""
    cell, reach = arguments.cell, arguments.reach
    stream = workload.kilometre(arguments.seeds[0], arguments.folder)
    warm = OccupancyMap(None, protocol(cell, reach))
    for frame in (next(stream) for _ in range(2)):
        warm.integrate(
            np.array(frame.depth_mm), np.array(frame.labels_noisy), workload.CAMERA, frame.T_world_camera
        )
    stream = workload.kilometre(arguments.seeds[0], arguments.folder)
    occupancy = OccupancyMap(None, protocol(cell, reach))
    # Laps 1 to 4 are 1.2 km; lap 5 comes after them, on the same images as lap 1.
    taken = []
    gc.disable()
    for frame in (next(stream) for _ in range(5 * LAP)):
        depth, labels = np.array(frame.depth_mm), np.array(frame.labels_noisy)
        start = time.process_time()
        occupancy.integrate(depth, labels, workload.CAMERA, frame.T_world_camera)
        taken.append(1e3 * (time.process_time() - start))
    gc.enable()
    print(f"dream, cells {cell} m: CPU ms a frame over the same {LAP} images, each lap on new ground")
    laps = np.array(taken).reshape(5, LAP)
    for number, lap in enumerate(laps):
        p50, p99 = np.percentile(lap, (50, 99))
        print(f"  after {0.293 * number:.2f} km: mean {lap.mean():.3f}  p50 {p50:.3f}  p99 {p99:.3f}")
    print(f"  last against first: p50 {np.median(laps[4]) / np.median(laps[0]):.2f}, ", end="")
    print(f"p99 {np.percentile(laps[4], 99) / np.percentile(laps[0], 99):.2f}")


def memory(arguments: argparse.Namespace) -> None:
    """Print what a map without bounds takes after a survey of a quarter of a square kilometre."""
    occupancy = OccupancyMap(None, protocol(arguments.cell, arguments.reach))
    stream = workload.kilometre(arguments.seeds[0], arguments.folder)
    for number in range(SQUARES):
        for frame in itertools.islice(stream, LAP):
            occupancy.integrate(frame.depth_mm, frame.labels_noisy, workload.CAMERA, frame.T_world_camera)
        if sys.stderr.isatty():
            print(f"\r{number + 1} of {SQUARES} squares", end="", file=sys.stderr, flush=True)
    cells = occupancy.nbytes
    explored, surveyed = occupancy.areas()["explored"], SQUARES * (2.0 * workload.HALF) ** 2
    print(f"dream, cells {arguments.cell} m, {SQUARES * LAP} frames over {surveyed / 1e6:.2f} km²")
    print(f"  cells {cells / 1e6:.1f} MB")
    for name, area in (("surveyed", surveyed), ("explored", explored)):
        print(f"  {cells / area:.0f} MB a km² {name}")


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--frames", type=int, default=workload.FRAMES, help="the first so many of each seed")
    parser.add_argument("--cell", type=float, default=0.1, help="metres")
    parser.add_argument("--reach", type=float, default=8.0, help="metres over ground")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="maps whose name contains one of these")
    parser.add_argument("--folder", type=Path, default=workload.default_folder(), help="of frames")
    parser.add_argument("--quick", action="store_true", help="seed 1, 40 frames")
    parser.add_argument("--kilometre", action="store_true", help="only ours, over 1.5 km")
    parser.add_argument("--memory", action="store_true", help="only ours, over 500 m x 500 m")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.seeds, arguments.frames = [1], min(arguments.frames, 40)
    if arguments.kilometre:
        kilometre(arguments)
    elif arguments.memory:
        memory(arguments)
    else:
        measure(arguments)


if __name__ == "__main__":
    main()
