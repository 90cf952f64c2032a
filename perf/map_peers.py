"""Other maps on the same frames: two in 2-D that do what ours does, and 3-D ones that do something else.

None of them learns where the seabed is: all are given its true height, which ours must find by itself.
The 3-D ones know no targets; for the score their voxels are projected onto the ground.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Bounds, Camera
from dream.types import Label

Array = npt.NDArray[Any]
BoolArray = npt.NDArray[np.bool_]
Layers = tuple[BoolArray, BoolArray, BoolArray | None]

TWO, THREE = "2-D", "3-D: different work"
MIN_DEPTH, MAX_DEPTH = 0.1, 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a map is told before the first frame. Metres."""

    bounds: Bounds
    cell: float
    reach: float
    """Over ground."""
    band: tuple[float, float]
    """Heights above the seabed."""
    blind: float
    ground: Array
    """(rows, cols) true world z of the seabed at the cells' centres."""


class Mapper(Protocol):
    """A map that is measured."""

    name: str
    does: str
    """What it does, in a line."""
    stride: int
    """It is given every so many frames, and scored only where that is 1."""

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame: (H, W) millimetres, 0 for none, (H, W) values of `Label`, and `T_world_camera`."""
        ...

    def layers(self) -> Layers:
        """Solid, explored and target, (rows, cols) over the bounds; None where it has no targets."""
        ...

    def megabytes(self) -> float:
        """Memory of the map itself, in 10⁶ bytes."""
        ...


class _Rays:
    """The rays of a camera, with 1 along the optical axis, (3, H·W) float32."""

    def __init__(self) -> None:
        self._of: dict[Camera, npt.NDArray[np.float32]] = {}

    def points(self, depth_mm: npt.NDArray[np.uint16], camera: Camera, pose: SE3) -> tuple[Array, BoolArray]:
        """(3, H·W) world vectors from the camera to each pixel's point, and (H·W,) which are valid."""
        if camera not in self._of:
            u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
            v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
            grid = np.broadcast_arrays(u[None, :], v[:, None], 1.0)
            self._of[camera] = np.stack(grid).reshape(3, -1).astype(np.float32)
        z = depth_mm.ravel() * np.float32(1e-3)
        valid = (z >= MIN_DEPTH) & (z <= MAX_DEPTH)
        return (pose.rotation.astype(np.float32) @ self._of[camera]) * z, valid


class _Doubles(_Rays):
    """The same in double precision, by `Camera.back_project`."""

    def points(self, depth_mm: npt.NDArray[np.uint16], camera: Camera, pose: SE3) -> tuple[Array, BoolArray]:
        """See `_Rays`."""
        z = depth_mm * 1e-3
        points = (camera.back_project(z, pose) - pose.translation).reshape(-1, 3)
        return points.T, ((z >= MIN_DEPTH) & (z <= MAX_DEPTH)).ravel()


class PlainNumpy:
    """2-D, vectorised: counts of pixels by cell and class, one step of log-odds a cell, marched rays."""

    name = "plain NumPy"
    does = f"{TWO}: counts by bincount, one log-odds step a cell and frame, rays marched as arrays; targets"
    stride = 1
    hit, miss, low, high = 0.6, -0.6, -2.0, 3.5
    min_pixels, min_share, min_ground = 3, 0.05, 2

    def __init__(self, survey: Survey) -> None:
        self.survey = survey
        self.rays = _Rays()
        rows, cols = survey.ground.shape
        self.shape = rows, cols
        self.radius = math.ceil(survey.reach / survey.cell) + 1
        # A margin around the arena, so that the window about the camera never leaves the arrays.
        self.margin = margin = 2 * self.radius
        padded = rows + 2 * margin, cols + 2 * margin
        self.log_odds = np.zeros(padded, np.float32)
        self.explored = np.zeros(padded, np.bool_)
        self.hits = np.zeros(padded, np.uint32)
        self.returns = np.zeros(padded, np.uint32)
        self.ground = np.pad(survey.ground.astype(np.float32), margin, mode="edge")

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame."""
        survey, radius = self.survey, self.radius
        side = 2 * radius + 1
        x, y, z = (float(value) for value in pose.translation)
        gx, gy = (x - survey.bounds.x_min) / survey.cell, (y - survey.bounds.y_min) / survey.cell
        col, row = math.floor(gx) - radius, math.floor(gy) - radius
        corner_x, corner_y = x - (gx - col) * survey.cell, y - (gy - row) * survey.cell
        rows = slice(row + self.margin, row + self.margin + side)
        cols = slice(col + self.margin, col + self.margin + side)

        (dx, dy, dz), valid = self.rays.points(depth_mm, camera, pose)
        near = valid & (dx * dx + dy * dy <= survey.reach**2)
        dx, dy, dz, seen = dx[near], dy[near], dz[near], labels.ravel()[near]
        per_cell = np.float32(1.0 / survey.cell)
        j = ((dx + np.float32(x - corner_x)) * per_cell).astype(np.int32)
        i = ((dy + np.float32(y - corner_y)) * per_cell).astype(np.int32)
        index = i * side + j
        height = dz + np.float32(z) - self.ground[rows, cols].ravel()[index]
        kind = np.where(height < survey.band[0], 0, np.where(height <= survey.band[1], 1, 3))
        kind[seen == Label.TARGET] = 2
        n = side * side
        counts = np.bincount(kind * n + index, minlength=4 * n).reshape(4, side, side)
        floor, raised, target = counts[0], counts[1], counts[2]
        total = floor + target

        log_odds = self.log_odds[rows, cols]
        solid = (raised >= self.min_pixels) & (raised >= self.min_share * total)
        free = (total >= self.min_ground) & (raised < self.min_pixels) & ~solid
        log_odds += np.where(solid, self.hit, np.where(free, self.miss, 0.0)).astype(np.float32)
        self.hits[rows, cols] += target.astype(np.uint32)
        self.returns[rows, cols] += (total + raised).astype(np.uint32)
        any_return = (total + raised) > 0

        forward = pose.rotation[:, 2]
        yaw = math.atan2(forward[1], forward[0])
        blocking = solid | (log_odds > 0.0)
        visible = self._visible(blocking, gx - col, gy - row, yaw, 0.5 * camera.horizontal_fov)
        line = np.arange(side) + 0.5
        ahead = (line - (gx - col))[None, :] * math.cos(yaw) + (line - (gy - row))[:, None] * math.sin(yaw)
        visible &= ahead >= survey.blind / survey.cell
        log_odds += np.where(visible & ~any_return & ~solid, 0.5 * self.miss, 0.0).astype(np.float32)
        np.clip(log_odds, self.low, self.high, out=log_odds)
        self.explored[rows, cols] |= visible | any_return

    def _visible(self, blocking: BoolArray, x: float, y: float, yaw: float, half_angle: float) -> BoolArray:
        """(side, side) cells that rays from (x, y), in cells, reach within the sector."""
        reach = self.survey.reach / self.survey.cell
        count = math.ceil(2.0 * half_angle * reach * 2.0)
        bearings = yaw + np.linspace(-half_angle, half_angle, count)
        steps = np.arange(0.0, reach, 0.5)
        j = (x + np.cos(bearings)[:, None] * steps).astype(np.int32)
        i = (y + np.sin(bearings)[:, None] * steps).astype(np.int32)
        index = i * blocking.shape[1] + j
        stopped = np.logical_or.accumulate(blocking.ravel()[index], axis=1)
        # A ray may take two steps in the cell that stops it; only the cells behind are hidden.
        passed = np.ones_like(stopped)
        passed[:, 1:] = ~stopped[:, :-1]
        visible = np.zeros(blocking.size, np.bool_)
        visible[index[passed]] = True
        return visible.reshape(blocking.shape)

    def layers(self) -> Layers:
        """Solid, explored, target."""
        inner = (slice(self.margin, -self.margin),) * 2
        hits, returns = self.hits[inner], self.returns[inner]
        return self.log_odds[inner] > 0.0, self.explored[inner], (hits > 0) & (hits > 0.5 * returns)

    def megabytes(self) -> float:
        """Of the arena; the margin is not counted."""
        rows, cols = self.shape
        return float(rows * cols * (4 + 1 + 4 + 4) / 1e6)


class NumpyDoubles(PlainNumpy):
    """As plain NumPy, in double precision."""

    name = "NumPy, doubles"
    does = f"{TWO}: as plain NumPy, points by Camera.back_project in double precision; targets"

    def __init__(self, survey: Survey) -> None:
        super().__init__(survey)
        self.rays = _Doubles()


class ScikitImage(PlainNumpy):
    """As plain NumPy, but each ray is a line of cells drawn by `skimage.draw.line`."""

    name = "scikit-image"
    does = f"{TWO}: as plain NumPy, rays drawn by skimage.draw.line in a Python loop; targets"

    def __init__(self, survey: Survey) -> None:
        from skimage.draw import line

        super().__init__(survey)
        self.line: Callable[..., tuple[Array, Array]] = line

    def _visible(self, blocking: BoolArray, x: float, y: float, yaw: float, half_angle: float) -> BoolArray:
        reach = self.survey.reach / self.survey.cell - 0.5
        bearings = yaw + np.linspace(-half_angle, half_angle, math.ceil(2.0 * half_angle * reach * 2.0))
        row, col = int(y), int(x)
        ends_row = (y + np.sin(bearings) * reach).astype(np.int32)
        ends_col = (x + np.cos(bearings) * reach).astype(np.int32)
        visible = np.zeros_like(blocking)
        for end_row, end_col in set(zip(ends_row.tolist(), ends_col.tolist(), strict=True)):
            i, j = self.line(row, col, end_row, end_col)
            stops = blocking[i, j]
            past = int(stops.argmax()) + 1 if stops.any() else len(i)
            visible[i[:past], j[:past]] = True
        return visible


def project(survey: Survey, occupied: Array, known: Array) -> Layers:
    """Voxels' centres (N, 3) as layers: solid where one is occupied in the band, explored where one is known.

    Only what lies below the top of the band counts as explored, as in the 3-D truth.
    """
    rows, cols = survey.ground.shape
    layers = []
    for points, lowest in ((occupied, survey.band[0]), (known, -math.inf)):
        col = np.floor((points[:, 0] - survey.bounds.x_min) / survey.cell).astype(np.int64)
        row = np.floor((points[:, 1] - survey.bounds.y_min) / survey.cell).astype(np.int64)
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        row, col, z = row[inside], col[inside], points[inside, 2]
        height = z - survey.ground[row, col]
        chosen = (height >= lowest) & (height <= survey.band[1])
        layer = np.zeros((rows, cols), np.bool_)
        layer[row[chosen], col[chosen]] = True
        layers.append(layer)
    return layers[0], layers[1], None


def ask(survey: Survey, states: Callable[[Array], Array]) -> Layers:
    """A 3-D map's layers: each voxel of the arena from below the seabed to above the band is asked for.

    Args:
        survey: What to project onto.
        states: Takes voxels' centres (N, 3), gives (N,) 1 for occupied, 0 for free, −1 for unknown.
    """
    cell = survey.cell
    rows, cols = survey.ground.shape
    x = survey.bounds.x_min + (np.arange(cols) + 0.5) * cell
    y = survey.bounds.y_min + (np.arange(rows) + 0.5) * cell
    lowest = math.floor((survey.ground.min() - 1.0) / cell)
    highest = math.ceil((survey.ground.max() + survey.band[1]) / cell)
    occupied, known = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for level in range(lowest, highest):
        grid = np.meshgrid(x, y, [(level + 0.5) * cell], indexing="xy")
        points = np.stack([axis.ravel() for axis in grid], axis=1)
        answers = states(points)
        occupied.append(points[answers == 1])
        known.append(points[answers >= 0])
    return project(survey, np.concatenate(occupied), np.concatenate(known))


class _Cloud:
    """What the 3-D peers share: points of a frame, ended a little past the reach."""

    stride = 1

    def __init__(self, survey: Survey) -> None:
        self.survey = survey
        self.rays = _Rays()
        # Their range is a sphere's. This one holds all ground within reach of a camera up to 2 m above it.
        self.range = math.hypot(survey.reach, 2.0)

    def points(
        self, depth_mm: npt.NDArray[np.uint16], camera: Camera, pose: SE3
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """(N, 3) world points of all valid pixels, and the camera's position."""
        vectors, valid = self.rays.points(depth_mm, camera, pose)
        points = np.empty((int(np.count_nonzero(valid)), 3))
        for axis in range(3):
            np.add(vectors[axis][valid], pose.translation[axis], out=points[:, axis])
        return points, np.ascontiguousarray(pose.translation)


class PyOctoMap(_Cloud):
    """OctoMap's `insertPointCloud`, each voxel of returns taken once a frame."""

    name = "pyoctomap"
    does = f"{THREE}: OctoMap, insertPointCloud(discretize=True), its defaults"
    discretize = True

    def __init__(self, survey: Survey) -> None:
        import pyoctomap

        super().__init__(survey)
        self.tree = pyoctomap.OcTree(survey.cell)

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame."""
        points, origin = self.points(depth_mm, camera, pose)
        self.tree.insertPointCloud(points, origin, self.range, discretize=self.discretize)

    def layers(self) -> Layers:
        """Projected."""
        return ask(self.survey, lambda points: np.asarray(self.tree.getLabels(points)))

    def megabytes(self) -> float:
        """As the tree counts it."""
        return float(self.tree.memoryUsage()) / 1e6


class PyOctoMapPlain(PyOctoMap):
    """The same with every ray cast; slow, so that it gets only every tenth frame."""

    name = "pyoctomap, every ray"
    does = f"{THREE}: the same, discretize=False; every tenth frame, not scored"
    discretize = False
    stride = 10


class Bonxai(_Cloud):
    """Bonxai's ProbabilisticMap, compiled when first used.

    There is no wheel: BONXAI in the environment names a checkout of github.com/facontidavide/Bonxai, EIGEN
    the folder that holds eigen3/, unless the compiler finds it. PyPI's bonxai is something else.
    """

    name = "Bonxai"
    does = f"{THREE}: ProbabilisticMap::insertPointCloud with its defaults; back-projection in C++ too"

    def __init__(self, survey: Survey) -> None:
        super().__init__(survey)
        self.library = _bonxai()
        self.map = self.library.bonxai_new(survey.cell)

    def __del__(self) -> None:
        if hasattr(self, "map"):
            self.library.bonxai_delete(self.map)

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame."""
        depth = np.ascontiguousarray(depth_mm)
        pinhole = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        rotation, origin = (np.ascontiguousarray(part) for part in (pose.rotation, pose.translation))
        self.library.bonxai_insert(
            self.map,
            depth.ctypes.data,
            camera.width,
            camera.height,
            *(array.ctypes.data for array in (pinhole, rotation, origin)),
            MIN_DEPTH,
            MAX_DEPTH,
            self.range,
        )

    def _voxels(self, state: int) -> Array:
        count = self.library.bonxai_voxels(self.map, state, None)
        found = np.empty((count, 3), np.int32)
        self.library.bonxai_voxels(self.map, state, found.ctypes.data)
        return (found + 0.5) * self.survey.cell

    def layers(self) -> Layers:
        """Projected."""
        occupied, free = self._voxels(1), self._voxels(0)
        return project(self.survey, occupied, np.concatenate([occupied, free]))

    def megabytes(self) -> float:
        """As the grid counts it."""
        return float(self.library.bonxai_memory(self.map)) / 1e6


def _bonxai() -> ctypes.CDLL:
    """The shim of bonxai.cpp, compiled once for a checkout and a source."""
    checkout, eigen = os.environ.get("BONXAI"), os.environ.get("EIGEN")
    if not checkout:
        raise ImportError("set BONXAI to a checkout of github.com/facontidavide/Bonxai, EIGEN to its include")
    source = Path(__file__).with_name("bonxai.cpp")
    key = hashlib.sha256(source.read_bytes() + f"{Path(checkout).resolve()} {eigen}".encode()).hexdigest()
    library = Path(tempfile.gettempdir()) / "dream-perf" / f"bonxai-{key[:12]}.so"
    if not library.is_file():
        library.parent.mkdir(parents=True, exist_ok=True)
        making = library.with_suffix(f".{os.getpid()}")
        command = ["g++", "-std=c++17", "-O3", "-DNDEBUG", "-march=native", "-shared", "-fPIC"]
        command += [f"-I{checkout}/bonxai_core/include", f"-I{checkout}/bonxai_map/include"]
        command += [f"-I{eigen}"] if eigen else []
        command += [str(source), f"{checkout}/bonxai_map/src/probabilistic_map.cpp", "-o", str(making)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ImportError(f"bonxai.cpp does not compile: {done.stderr.strip().splitlines()[:1]}")
        making.replace(library)
    loaded = ctypes.CDLL(str(library))
    pointer = ctypes.c_void_p
    for name, arguments, result in (
        ("bonxai_new", [ctypes.c_double], pointer),
        ("bonxai_delete", [pointer], None),
        ("bonxai_insert", [pointer] * 2 + [ctypes.c_int] * 2 + [pointer] * 3 + [ctypes.c_double] * 3, None),
        ("bonxai_voxels", [pointer, ctypes.c_int, pointer], ctypes.c_size_t),
        ("bonxai_memory", [pointer], ctypes.c_size_t),
    ):
        function = getattr(loaded, name)
        function.argtypes, function.restype = arguments, result
    return loaded


class Wavemap(_Cloud):
    """Wavemap's hashed chunked wavelet octree, fed with depth images.

    There is no wheel: `pip install library/python` in a checkout of github.com/ethz-asl/wavemap, with Eigen
    and glog at hand. PyPI's wavemap is something else.
    """

    name = "wavemap"
    does = f"{THREE}: pywavemap 2.2, range_sigma .05, scaling_free .2, scaling_occupied .4 as in its examples"
    sigma, free, solid = 0.05, 0.2, 0.4

    def __init__(self, survey: Survey) -> None:
        import pywavemap

        super().__init__(survey)
        self.wave = pywavemap
        kind = "hashed_chunked_wavelet_octree"
        self.map = pywavemap.Map.create({"type": kind, "min_cell_width": {"meters": survey.cell}})
        self.pipeline = pywavemap.Pipeline(self.map)
        self.cameras: list[Camera] = []

    def _integrator(self, camera: Camera) -> str:
        name = f"camera{self.cameras.index(camera) if camera in self.cameras else len(self.cameras)}"
        if camera in self.cameras:
            return name
        self.cameras.append(camera)
        pinhole = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        parameters = {
            "projection_model": {"type": "pinhole_camera_projector", **pinhole},
            "measurement_model": {
                "type": "continuous_ray",
                "range_sigma": {"meters": self.sigma},
                "scaling_free": self.free,
                "scaling_occupied": self.solid,
            },
            "integration_method": {
                "type": "hashed_chunked_wavelet_integrator",
                "min_range": {"meters": MIN_DEPTH},
                "max_range": {"meters": self.range},
            },
        }
        if not self.pipeline.add_integrator(name, parameters):
            raise RuntimeError(f"wavemap: refused {parameters}")
        return name

    def integrate(
        self, depth_mm: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8], camera: Camera, pose: SE3
    ) -> None:
        """Add a frame."""
        name = self._integrator(camera)
        matrix = np.eye(4, dtype=np.float32)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.translation
        image = self.wave.Image((depth_mm * np.float32(1e-3)).T)
        self.pipeline.run_pipeline([name], self.wave.PosedImage(self.wave.Pose(matrix), image))

    def layers(self) -> Layers:
        """Projected; a value of exactly 0 is unknown."""

        def states(points: Array) -> Array:
            index = np.floor(points / self.survey.cell).astype(np.int32)
            value = np.asarray(self.map.get_cell_values(index)).ravel()
            return np.where(np.abs(value) < 1e-3, -1, (value > 0.0).astype(np.int8))

        return ask(self.survey, states)

    def megabytes(self) -> float:
        """As the map counts it, pruned."""
        self.map.prune()
        return float(self.map.memory_usage) / 1e6


class WavemapTuned(Wavemap):
    """The same, tuned to keep what is seen at grazing angles."""

    name = "wavemap, tuned"
    does = f"{THREE}: the same with scaling_free .1, scaling_occupied .8"
    free, solid = 0.1, 0.8


PEERS: tuple[Callable[[Survey], Mapper], ...] = (
    PlainNumpy,
    NumpyDoubles,
    ScikitImage,
    PyOctoMap,
    PyOctoMapPlain,
    Bonxai,
    Wavemap,
    WavemapTuned,
)
"""Each raises ImportError with the reason where it is not there."""
