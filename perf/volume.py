"""CPU time and accuracy of the volume beside named 3-D maps: the same noisy frames, one run.

    python perf/volume.py --quick                       one world, 40 frames
    python perf/volume.py --cells 0.25 0.1              wrecks and reefs, 160 frames each
    python perf/volume.py --memory                      ours alone: 100 x 100 x 12 m

CPU time counts all threads of the process. All maps take turns at every frame. Frames are 320 x 240, depths
have σ = 0.002 z², and all maps keep 8 m straight. Ours takes float metres, the others uint16 millimetres;
ours also votes for targets, and finds from which sides the surface is inspected. How peers are built and
found: see map_peers.py; who is not there is named.

Truth is traced without noise, ray by ray: voxels that one passes, and that the true surface does not cut, are
free; those that a ray ends in are the seen surface. The others clear no water where nothing returns: `free R`
counts only voxels that a ray with a return passed, `all R` those of all rays.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numba  # noqa: E402
import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from scipy import ndimage  # noqa: E402

import map_peers  # noqa: E402
from dream.geometry import SE3, Bounds, camera_mount  # noqa: E402
from dream.mapping.volume import FREE, KEPT, SOLID, Volume  # noqa: E402
from dream.protocol import DREAM_V2  # noqa: E402
from dream.sim.render.rasterizer import Renderer  # noqa: E402
from dream.sim.world import World  # noqa: E402
from dream.sim.worlds import make_world  # noqa: E402
from dream.types import Label  # noqa: E402
from peers import soup_of  # noqa: E402

Array = npt.NDArray[Any]
RANGE = 8.0
"""Metres straight that all maps keep."""
SCATTER = 0.002
WORLDS = ("wreck/1", "wreck/4", "reef/string", "reef/K")
SEEDS = (7, 8)
"""Of no suite. How many pixels a voxel needs to be believed (`BELIEVED`) was chosen on wreck/1, seed 7."""
PROTOCOL = dataclasses.replace(DREAM_V2, name="perf", reach=RANGE / KEPT, lasting=None)
CAMERA = PROTOCOL.camera


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One view, without and with noise."""

    T_world_camera: SE3
    true: Array
    """(H, W) float32 metres; NaN for none."""
    depth: Array
    """Likewise, with noise."""
    depth_mm: npt.NDArray[np.uint16]
    """The same in millimetres, 0 for none."""
    labels: npt.NDArray[np.uint8]


class Ours:
    """The volume of this project."""

    name = "dream"

    def __init__(self, cell: float) -> None:
        self.volume = Volume(PROTOCOL, cell)

    def integrate(self, frame: Frame) -> None:
        """Add a frame."""
        self.volume.integrate(frame.depth, frame.labels, CAMERA, frame.T_world_camera)

    def states(self, index: Array) -> Array:
        """(n,) 1 solid, 0 free, −1 unknown of voxels (n, 3) x, y, z."""
        state = self.volume.state((index + 0.5) * self.volume.cell)
        return np.where(state == SOLID, 1, np.where(state == FREE, 0, -1))

    def megabytes(self) -> float:
        """Of what is known, in 10⁶ bytes."""
        return self.volume.nbytes / 1e6


class Peer:
    """A map of map_peers.py, asked voxel by voxel."""

    def __init__(self, make: Any, cell: float) -> None:
        bounds = Bounds(-10.0, -10.0, 10.0, 10.0)
        self.mapper = make(map_peers.Survey(bounds, cell, RANGE, (0.35, 2.5), 1.0, np.zeros((1, 1))))
        self.mapper.range = RANGE
        self.name, self.cell = str(make.name), cell

    def integrate(self, frame: Frame) -> None:
        """Add a frame."""
        self.mapper.integrate(frame.depth_mm, frame.labels, CAMERA, frame.T_world_camera)

    def states(self, index: Array) -> Array:
        """Likewise."""
        if isinstance(self.mapper, map_peers.Bonxai):
            known = {}
            for state in (0, 1):
                voxels = np.rint(self.mapper._voxels(state) / self.cell - 0.5).astype(np.int64)
                known.update(dict.fromkeys(map(tuple, voxels.tolist()), state))
            return np.array([known.get(voxel, -1) for voxel in map(tuple, index.tolist())])
        if isinstance(self.mapper, map_peers.Wavemap):
            value = np.asarray(self.mapper.map.get_cell_values(index.astype(np.int32))).ravel()
            return np.where(np.abs(value) < 1e-3, -1, (value > 0.0).astype(np.int64))
        return np.asarray(self.mapper.tree.getLabels((index + 0.5) * self.cell))

    def megabytes(self) -> float:
        """Of what is known, in 10⁶ bytes."""
        return float(self.mapper.megabytes())


def contenders(cell: float) -> list[Callable[[], Ours | Peer]]:
    """Those that are there; who is not is told."""
    ready: list[Callable[[], Ours | Peer]] = [lambda: Ours(cell)]
    for make in (map_peers.PyOctoMap, map_peers.Bonxai, map_peers.Wavemap, map_peers.WavemapTuned):
        try:
            Peer(make, cell)
            ready.append(lambda make=make: Peer(make, cell))  # type: ignore[misc]
        except ImportError as error:
            print(f"{make.name}: not measured ({error})")
    return ready


def frames_of(world: World, count: int, rng: np.random.Generator) -> list[Frame]:
    """Views on rings around the targets, at heights of 1 to 4.5 m and all tilts, and lanes over them."""
    renderer = Renderer(world)
    centre = world.targets.position[:, :2].mean(axis=0)
    spread = 0.7 * np.linalg.norm(world.targets.position[:, :2] - centre, axis=1).max() + 2.0
    frames: list[Frame] = []
    for k in range(4 * count):
        if len(frames) == count:
            break
        bearing, height = 0.13 * k, (1.2, 2.0, 3.0, 4.5)[k // 12 % 4]
        away = spread * (1.0 if k % 3 else 0.6)
        x, y = centre + away * np.array([math.cos(bearing), math.sin(bearing)])
        x, y = float(np.clip(x, -23.0, 23.0)), float(np.clip(y, -23.0, 23.0))
        yaw = bearing + math.pi + rng.uniform(-0.7, 0.7)
        z = float(world.terrain.height(x, y)) + height
        T = SE3.level(x, y, z, yaw) @ camera_mount(PROTOCOL.tilts[k % len(PROTOCOL.tilts)])
        seen = renderer.measure(CAMERA, T)
        if np.nanmin(np.append(seen.depth, 20.0)) < 0.5:
            continue
        noise = SCATTER * seen.depth**2 * rng.standard_normal(seen.depth.shape).astype(np.float32)
        depth = (seen.depth + noise).astype(np.float32)
        millimetres = np.nan_to_num(1e3 * depth, nan=0.0).clip(0, 65535).astype(np.uint16)
        frames.append(Frame(T, seen.depth, depth, millimetres, seen.labels))
    return frames


# --------------------------------------------------------------------------------------------- truth


def _sample_python(corners: Any, cell: float, low: Any, grid: Any) -> None:
    """Mark the voxels that triangles (T, 3, 3) cut, by points a quarter of a voxel apart."""
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0]
        longest = max(
            max(math.sqrt((b * b).sum()), math.sqrt((c * c).sum())), math.sqrt(((b - c) ** 2).sum())
        )
        n = int(longest / (0.25 * cell)) + 1
        for i in range(n + 1):
            for j in range(n + 1 - i):
                inside = True
                x = math.floor((a[0] + (b[0] * i + c[0] * j) / n) / cell) - low[0]
                y = math.floor((a[1] + (b[1] * i + c[1] * j) / n) / cell) - low[1]
                z = math.floor((a[2] + (b[2] * i + c[2] * j) / n) / cell) - low[2]
                at = (x, y, z)
                for k in range(3):
                    inside &= 0 <= at[k] < grid.shape[k]
                if inside:
                    grid[at] = 1


def _trace_python(
    depth: Any,
    rotation: Any,
    place: Any,
    lens: Any,
    far: float,
    cell: float,
    low: Any,
    passed: Any,
    returned: Any,
    ended: Any,
) -> None:
    """Mark the voxels that each ray passes, and the one that it ends in if that is near enough."""
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            ray = np.array([(u + 0.5 - lens[2]) / lens[0], (v + 0.5 - lens[3]) / lens[1], 1.0])
            length = math.sqrt((ray * ray).sum())
            d = (rotation @ ray) / length
            reach = min(z * length, far) if z > 0.0 else far
            hit = z > 0.0 and z * length <= far
            at, step = np.empty(3, np.int64), np.empty(3, np.int64)
            slope, crossing = np.empty(3), np.empty(3)
            for k in range(3):
                g = place[k] / cell
                at[k] = math.floor(g)
                step[k] = 1 if d[k] > 0 else -1
                slope[k] = cell / abs(d[k]) if d[k] != 0.0 else np.inf
                crossing[k] = slope[k] * ((at[k] + 1 - g) if d[k] > 0 else (g - at[k])) if d[k] else np.inf
            while True:
                axis = 0
                if crossing[1] < crossing[axis]:
                    axis = 1
                if crossing[2] < crossing[axis]:
                    axis = 2
                x, y, h = at[0] - low[0], at[1] - low[1], at[2] - low[2]
                inside = 0 <= x < passed.shape[0] and 0 <= y < passed.shape[1] and 0 <= h < passed.shape[2]
                if crossing[axis] >= reach:
                    if inside and hit:
                        ended[x, y, h] = 1
                    elif inside:
                        passed[x, y, h] = 1
                        returned[x, y, h] |= z > 0.0
                    break
                if inside:
                    passed[x, y, h] = 1
                    returned[x, y, h] |= z > 0.0
                at[axis] += step[axis]
                crossing[axis] += slope[axis]


_sample = numba.njit(_sample_python)
_trace = numba.njit(_trace_python)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is really there, on a grid of voxels (x, y, z)."""

    low: Array
    cut: Array
    """The true surface cuts it."""
    passed: Array
    """A ray passed it, or part of it."""
    returned: Array
    """Likewise, one of those that returned at all."""
    ended: Array
    """A ray ended in it."""

    @property
    def index(self) -> Array:
        """(n, 3) of all voxels."""
        return np.argwhere(np.ones(self.cut.shape, np.bool_)) + self.low


def truth_of(world: World, frames: list[Frame], cell: float) -> Truth:
    """Traced and sampled."""
    places = np.array([frame.T_world_camera.translation for frame in frames])
    low = np.floor((places.min(axis=0) - RANGE) / cell).astype(np.int64)
    high = np.ceil((places.max(axis=0) + RANGE) / cell).astype(np.int64)
    # Nothing returns from below the seabed; above, water is all alike.
    low[2] = math.floor((float(world.terrain.heights.min()) - 1.0) / cell)
    high[2] = math.ceil((places[:, 2].max() + 2.0) / cell)
    shape = tuple((high - low).tolist())
    cut, passed, returned, ended = (np.zeros(shape, np.uint8) for _ in range(4))
    _sample(soup_of(world).corners.astype(np.float64), cell, low, cut)
    lens = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    for frame in frames:
        rotation = np.ascontiguousarray(frame.T_world_camera.rotation)
        depth = np.nan_to_num(frame.true, nan=0.0).astype(np.float64)
        place = frame.T_world_camera.translation
        _trace(depth, rotation, place, lens, RANGE, cell, low, passed, returned, ended)
    return Truth(low, cut > 0, passed > 0, returned > 0, ended > 0)


def share(part: Array, whole: Array) -> float:
    """Of `whole` that is in `part`."""
    return float((part & whole).sum()) / max(float(whole.sum()), 1.0)


def scores(states: Array, truth: Truth) -> dict[str, float]:
    """Precision (P) and recall (R) of free water and of the surface; F1±1 forgives one voxel."""
    free, solid = states == 0, states == 1
    bare, surface = ~truth.cut & ~truth.ended, truth.ended
    around = np.ones((3, 3, 3), np.bool_)
    real = truth.cut | truth.ended
    precision, recall = share(real, solid), share(solid, surface)
    near = share(ndimage.binary_dilation(real, around), solid)
    found = share(ndimage.binary_dilation(solid, around), surface)
    return {
        "free P": 1.0 - share(truth.cut, free),
        "passed": share(truth.passed, free),
        "free R": share(free, truth.returned & bare),
        "all R": share(free, truth.passed & bare),
        "surf P": precision,
        "surf R": recall,
        "surf F1": 2.0 * precision * recall / max(precision + recall, 1e-9),
        "F1±1": 2.0 * near * found / max(near + found, 1e-9),
    }


# ----------------------------------------------------------------------------------------- measuring


def measure(names: tuple[str, ...], seeds: tuple[int, ...], cells: list[float], count: int) -> None:
    """One table for each size of cell; times are CPU milliseconds a frame."""
    for cell in cells:
        rows: dict[str, list[dict[str, float]]] = {}
        for name in names:
            for seed in seeds:
                world = make_world(name, seed)
                frames = frames_of(world, count, np.random.default_rng(seed))
                truth = truth_of(world, frames, cell)
                for mapper, taken in fly([make() for make in contenders(cell)], frames):
                    states = mapper.states(truth.index).reshape(truth.cut.shape)
                    row = {"CPU ms": float(np.mean(taken)), "p50": float(np.median(taken))}
                    row |= {"p99": float(np.quantile(taken, 0.99)), "MB": mapper.megabytes()}
                    rows.setdefault(mapper.name, []).append(row | scores(states, truth))
        columns = list(next(iter(rows.values()))[0])
        print(f"\n{cell} m cells, {len(names) * len(seeds)} worlds of {count} frames, {RANGE:g} m")
        print(f"{'':16s}" + "".join(f"{column:>9s}" for column in columns) + "    x dream")
        ours = np.mean([row["CPU ms"] for row in rows["dream"]])
        for name, found in rows.items():
            means = {column: float(np.mean([row[column] for row in found])) for column in columns}
            print(
                f"{name:16s}"
                + "".join(f"{means[c]:9.3f}" for c in columns)
                + f"{means['CPU ms'] / ours:11.2f}"
            )


def fly(mappers: list[Ours | Peer], frames: list[Frame]) -> list[tuple[Ours | Peer, list[float]]]:
    """Each map, and the CPU milliseconds that each frame took it."""
    taken: list[list[float]] = [[] for _ in mappers]
    Ours(0.5).integrate(frames[0])  # Compiled, and nobody's.
    gc.collect()
    gc.disable()
    for k, frame in enumerate(frames):
        for m in np.roll(np.arange(len(mappers)), k):
            start = time.process_time()
            mappers[m].integrate(frame)
            taken[m].append(1e3 * (time.process_time() - start))
    gc.enable()
    return list(zip(mappers, taken, strict=True))


def memory() -> None:
    """Ours over 100 x 100 m of seabed and 12 m of water, lane by lane."""
    volume = Volume(PROTOCOL, 0.25)
    half = 50.0
    rays = CAMERA.back_project(np.ones((CAMERA.height, CAMERA.width)), SE3.level(0, 0, 0, 0.0))
    for y in np.arange(-half, half, 4.0):
        for x in np.arange(-half, half, 4.0):
            for z, tilt in ((-11.0, 0.35), (-5.0, 0.8), (-4.0, -0.4)):
                T = SE3.level(x, y, z, 0.0 if round(y) % 8 else math.pi) @ camera_mount(tilt)
                rays = CAMERA.back_project(np.ones((CAMERA.height, CAMERA.width)), T) - T.translation
                down = rays[..., 2] < -1e-9
                depth = np.where(down, (-13.0 - z) / np.where(down, rays[..., 2], -1.0), np.nan)
                depth[depth > PROTOCOL.max_depth] = np.nan
                labels = np.where(np.isnan(depth), Label.WATER, Label.SEABED).astype(np.uint8)
                volume.integrate(depth.astype(np.float32), labels, CAMERA, T)
    assert volume.box is not None
    size = " x ".join(f"{length:.0f}" for length in volume.box[1] - volume.box[0])
    start = time.process_time()
    surface = volume.surface()
    end = time.process_time()
    print(f"{size} m at {volume.cell} m: {volume.nbytes / 1e6:.1f} MB")
    print(f"surface {len(surface.area)} voxels, {1e3 * (end - start):.0f} ms")


def main() -> None:
    """See the file's head."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.25, 0.1])
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS))
    parser.add_argument("--frames", type=int, default=160)
    arguments = parser.parse_args()
    if arguments.memory:
        memory()
    elif arguments.quick:
        measure(("wreck/1",), SEEDS[:1], arguments.cells, 40)
    else:
        measure(tuple(arguments.worlds), SEEDS[:1], arguments.cells, arguments.frames)


if __name__ == "__main__":
    main()
