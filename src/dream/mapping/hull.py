"""What of a hull is still unseen: a belief in three dimensions, made from observations alone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds, FloatArray
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Float32Array, IntArray, Label, Observation

PATCH = 0.5
"""Metres along a patch of hull: an individual of a wreck."""
SLANT = 1.125
"""Voxels that a surface cuts for each that its area would fill; on average over its directions."""
_VAIN = np.arange(12)
WORTH = np.stack([0.76 * 0.78**_VAIN, 0.12 * 0.86**_VAIN])
"""(2, looks) probability that a look from a new side shows hull, by from how many it failed to show:
where hull was seen from beyond reach, and where it may go on into the unknown. After the last one a voxel is
given up. Fitted, within 0.07, to 47,000 looks at one wreck of each kind, of no suite."""
CARVED = 1.5
"""Times the reach: how far the water is taken for free where nothing returned."""
STEEPEST = 2.0
"""Widths of a pixel by which neighbouring depths may differ and still be taken for one surface."""
AROUND = 2
"""Pixels on each side that depths which scatter are averaged over."""
SURE = 0.25
"""Of a voxel: the standard error of a depth up to which its return is marked from beyond reach."""
OVERLAP = 0.8
"""Voxels before an element in which nothing hides it: at a slant, its own surface would."""


class Hull:
    """A belief over a hull's surface: seen, known but not seen within reach, or to be expected.

    What it does: keeps voxels of half a map cell that are free, hull, or anything else that returned. What
    counts as unseen is hull that was only seen from beyond reach, and unknown voxels at its edges: those
    that touch both hull and free water. Both are worth what looks at their like have shown. No look is
    repeated from the same side, by bearing and range; each that fails makes them worth less, until they are
    given up.

    Depths that scatter are averaged over one surface. Then a return is marked where it is sure to a part of a
    voxel, or as sure as one within reach that all pixels around agree on; and what seems to be hull from
    beyond reach is none where a ray passed through. Else walls would grow thick, with hull in and behind them
    that never shows.

    Assumes: depths that are true to half a voxel, or err from pixel to pixel each for itself; labels that are
    true; poses that are true to half a voxel; a level vehicle at its altitude.

    Fails when: a patch is seen only through a gap finer than a voxel, or over the edge of a deck above
    the camera. Depths that err by more than a voxel, or neighbours that err alike, make walls thicker and
    hide what is behind their edges.
    """

    def __init__(self, bounds: Bounds, protocol: SurveyProtocol) -> None:
        """Nothing is known yet.

        Args:
            bounds: The survey area; nothing outside is ever known.
            protocol: Camera, reach and altitude.
        """
        from dream.mapping._kernels import hull as kernels
        from dream.perception.scatter import Scatter

        self.protocol = protocol
        margin = 0.5 * protocol.cell
        # Up to the seabed an altitude lower than at the start, and to hull as high above the camera again.
        heights = 4.0 * protocol.altitude
        levels, rows, cols = (
            math.ceil(length / (0.5 * protocol.cell))
            for length in (heights, bounds.depth + protocol.cell, bounds.width + protocol.cell)
        )
        corner = np.array([bounds.x_min - margin, bounds.y_min - margin, np.nan])
        self._volume = kernels.empty_volume((levels, rows, cols), corner, 0.5 * protocol.cell)
        self._looks = np.zeros_like(self._volume.voxels)
        self._failed = np.zeros((2, *self._volume.near.shape), np.uint64)
        self._ground: FloatArray = np.zeros(self._volume.posts.shape[1:])
        self._seen = 0
        self._scatter = Scatter()
        self._elements = np.zeros((0, 4), np.int32)
        self._middles: FloatArray = np.zeros((0, 3))
        self._weights: FloatArray = np.zeros(0)

    @property
    def found(self) -> float:
        """Patches of hull seen so far, about."""
        return self._seen / self._voxels_of_patch

    @property
    def weights(self) -> FloatArray:
        """(n,) expected unseen patches of each element; `integrate` makes new ones."""
        return self._weights

    @property
    def middles(self) -> FloatArray:
        """(n, 3) where the elements are, metres in the world."""
        return self._middles

    @property
    def unseen(self) -> float:
        """Expected unseen patches, whether or not any place is left to see them from."""
        return float(self._weights.sum())

    def integrate(self, observation: Observation) -> None:
        """Add what an observation shows, and count it as a look at what it should have shown and did not."""
        from dream.mapping._kernels import hull as kernels

        protocol, camera = self.protocol, observation.camera
        T_world_camera = observation.T_world_camera
        place, rotation = T_world_camera.translation, np.ascontiguousarray(T_world_camera.rotation)
        if math.isnan(self._volume.corner[2]):
            self._volume.corner[2] = place[2] - 2.0 * protocol.altitude
        looked_at, bits = self._looked_at(observation)
        depth, sure, far = self._depths(observation)
        labels, target, seabed = observation.labels, int(Label.TARGET), int(Label.SEABED)
        viewpoint = kernels.CameraPlace(
            rotation, place, (camera.fx, camera.fy, camera.cx, camera.cy), protocol.returns
        )
        volume = self._volume
        self._seen += kernels.mark(volume, sure, labels, target, seabed, viewpoint, protocol.reach, far)
        kernels.fill(volume, depth, labels, seabed, viewpoint, STEEPEST)
        farthest = min(CARVED * protocol.reach, protocol.max_depth)
        kernels.carve(volume, depth, viewpoint, farthest, 0.5 * volume.side)
        kernels.doubt(volume.voxels, self._looks, looked_at)
        level, row, col, kind = looked_at.T
        self._failed[kind, level, row, col] |= bits
        self._ground = self._smooth_ground()
        self._list_elements()

    def visible(self, positions: npt.ArrayLike, among: BoolArray | None = None) -> tuple[IntArray, IntArray]:
        """Which elements a view from each position would show, for all headings of the lattice.

        An element is shown where it is within reach over ground, in the image, not behind anything known to
        be solid (the unknown hides nothing), and its block was not looked at from that side.

        Args:
            positions: (P, 2) metres in the world.
            among: (n,) only these elements; all unless given.

        Returns:
            starts: (P * headings + 1,) and elements: (m,). With heading k, position p shows the elements
            numbered elements[starts[n]:starts[n + 1]], n = p * headings + k; they index `weights`.
        """
        points = np.asarray(positions, np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"positions: expected (P, 2) metres, got {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("positions: expected finite numbers, got NaN or infinity")
        angles = np.arange(self.protocol.headings) * self.protocol.heading_step
        heights = self._ground_at(points) + self.protocol.altitude
        return self._shown(np.column_stack([points, heights]), angles, among)

    def give_up(self, position: tuple[float, float], yaw: float) -> None:
        """Hope no more to see from that side what of the hull should be in view and is still to be seen."""
        from dream.mapping._kernels import hull as kernels

        if not len(self._weights):
            return
        place = np.array(position)
        camera = np.append(place, self._ground_at(place[None]) + self.protocol.altitude)
        shown = np.unique(self._shown(camera[None], np.array([yaw]))[1])
        level, row, col, kind = self._elements[shown].T
        sides = kernels.sides(self._middles[shown], camera, self.protocol.reach)
        self._failed[kind, level, row, col] |= sides

    # ------------------------------------------------------------------------------------------------------

    @property
    def _voxels_of_patch(self) -> float:
        return SLANT * (PATCH / self._volume.side) ** 2

    def _depths(self, observation: Observation) -> tuple[Float32Array, Float32Array, int]:
        """Depths, those of them that are marked (NaN elsewhere), and what hull beyond reach is marked as."""
        from dream.mapping._kernels import hull as kernels
        from dream.perception.scatter import SCATTERS, steadied

        protocol = self.protocol
        self._scatter.add(observation)
        scatter = self._scatter.value
        if scatter <= SCATTERS:
            return observation.depth, observation.depth, kernels.HULL
        depth, averaged = steadied(observation, AROUND, scatter)
        error = scatter * depth**2 / np.sqrt(np.maximum(averaged, 1))
        # Within reach a hull counts as seen: there it must be marked, however much all depths scatter.
        at_reach = scatter * (protocol.reach**2 + protocol.altitude**2) / (2 * AROUND + 1)
        sure = np.where(error <= max(SURE * self._volume.side, at_reach), depth, np.float32(np.nan))
        return depth, sure, kernels.HULL | kernels.VAGUE

    def _looked_at(self, observation: Observation) -> tuple[IntArray, npt.NDArray[np.uint64]]:
        """Elements that the observation should show from a new side, and those sides' bits.

        By its camera or as `visible` foretold it: the two differ by how well the seabed is known. Counting
        only one of them, a planner that goes by the other could wait for ever.
        """
        from dream.mapping._kernels import hull as kernels

        place, yaw = observation.T_world_camera.translation, np.array([observation.pose.yaw])
        foretold = np.append(place[:2], self._ground_at(place[None, :2]) + self.protocol.altitude)
        which = np.unique(self._shown(np.stack([place, foretold]), yaw)[1])
        return self._elements[which], kernels.sides(self._middles[which], place, self.protocol.reach)

    def _shown(
        self, cameras: FloatArray, yaws: FloatArray, among: BoolArray | None = None
    ) -> tuple[IntArray, IntArray]:
        """CSR over cameras (P, 3) and yaws (K,)."""
        from dream.mapping._kernels import hull as kernels

        protocol, camera = self.protocol, self.protocol.camera
        which = np.arange(len(self._weights)) if among is None else np.flatnonzero(among)
        if not len(which):
            return np.zeros(len(cameras) * len(yaws) + 1, np.int64), np.zeros(0, np.int32)
        level, row, col, kind = self._elements[which].T
        level_camera = kernels.LevelCamera(
            (math.cos(protocol.camera_pitch), math.sin(protocol.camera_pitch)),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            (camera.width, camera.height),
            protocol.returns,
            protocol.reach,
        )
        starts, elements = kernels.visible(
            self._volume,
            self._middles[which],
            self._failed[kind, level, row, col],
            np.ascontiguousarray(cameras),
            np.stack([np.cos(yaws), np.sin(yaws)], axis=1),
            level_camera,
            OVERLAP,
        )
        return starts, which[elements]

    def _list_elements(self) -> None:
        from dream.mapping._kernels import hull as kernels

        volume = self._volume
        low, past = (volume.box[:3] - 1) // kernels.BLOCK, volume.box[3:] // kernels.BLOCK + 1
        low, past = np.maximum(low, 0), np.minimum(past, np.array(volume.voxels.shape) // kernels.BLOCK)
        if (low >= past).any():
            return
        # Elsewhere no voxel counts.
        near = volume.near[low[0] : past[0], low[1] : past[1], low[2] : past[2]].any(axis=0)
        rows, cols = np.nonzero(near)
        block = kernels.BLOCK * volume.side
        columns = volume.corner[:2] + (np.stack([cols + low[2], rows + low[1]], axis=1) + 0.5) * block
        ground = self._ground_at(columns) - volume.corner[2]
        lowest, highest = np.zeros((2, *near.shape), np.int64)
        for levels, height in ((lowest, 0.0), (highest, self._top)):
            levels[near] = np.rint((ground + height) / volume.side)
        self._elements, voxel, weights = kernels.list_elements(
            volume.voxels,
            volume.near,
            self._looks,
            WORTH,
            np.concatenate([low, past]),
            lowest,
            highest,
        )
        self._middles = volume.corner + voxel[:, ::-1] * volume.side
        self._weights = weights / self._voxels_of_patch

    @property
    def _top(self) -> float:
        """Metres above the seabed below which hull can be in the image and within reach at once."""
        protocol, camera = self.protocol, self.protocol.camera
        above = math.atan(camera.cy / camera.fy) - protocol.camera_pitch
        return protocol.altitude + protocol.reach * math.tan(above)

    def _smooth_ground(self) -> FloatArray:
        """World z of the seabed at each post: from returns where there are any, else from those around."""
        from scipy.ndimage import gaussian_filter

        count = np.minimum(self._volume.posts[1], 20.0)
        mean = self._volume.posts[0] / np.maximum(self._volume.posts[1], 1.0) - self._datum
        total, weight = np.zeros_like(mean), np.full_like(mean, 1e-9)
        # Each wider blur counts only where the narrower ones say nothing.
        for sigma, share in ((0.6, 1.0), (2.0, 1e-2), (6.0, 1e-4)):
            total += share * gaussian_filter(count * mean, sigma)
            weight += share * gaussian_filter(count, sigma)
        return np.asarray(self._datum + total / weight)

    @property
    def _datum(self) -> float:
        """World z of the seabed at the start, by the vehicle's altitude."""
        return float(self._volume.corner[2] + self.protocol.altitude)

    def _ground_at(self, positions: npt.NDArray[Any]) -> FloatArray:
        """(n,) world z of the seabed below positions (n, 2)."""
        from scipy.ndimage import map_coordinates

        from dream.mapping._kernels import hull as kernels

        at = (positions - self._volume.corner[:2]) / (kernels.POST * self._volume.side) - 0.5
        return np.asarray(map_coordinates(self._ground, at[:, ::-1].T, order=1, mode="nearest"))
