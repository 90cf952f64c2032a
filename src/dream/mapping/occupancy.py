"""The map: what is solid, target, explored and traversable, cell by cell."""

from __future__ import annotations

import dataclasses
import json
import math
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Bounds, Camera
from dream.mapping.visibility import RAYS, locate
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Float32Array, IntArray, Label

FORMAT = "dream-map-1"
STATE = (
    "log_odds",
    "hits",
    "returns",
    "ground_sum",
    "ground_count",
    "explored",
    "bare",
    "seabed_seen",
    "crossed",
    "launch",
)
"""What a map remembers; everything else follows from it."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """How much a frame changes the map's mind."""

    hit: float = 0.6
    """Log-odds that a cell gains in a frame with returns from the height band."""
    miss: float = 0.15
    """Log-odds that it loses where the ground below the band was seen, or a ray passed without a return. Much
    less than a hit: the way to the ground also leads under what overhangs, such as the flare of a hull."""
    clamp: tuple[float, float] = (-0.5, 1.5)
    """Limits of the log-odds: one frame makes a wall whatever was believed before, and what moved away is
    forgotten after ten."""
    min_pixels: int = 3
    """Pixels in the height band that make a hit; fewer are taken for errors."""
    min_share: float = 0.05
    """Share of a cell's pixels that must be in the band for a hit."""
    min_ground: int = 2
    """Pixels below the band that show a cell to be free."""
    frame_pixels: float = 20.0
    """A frame speaks with at most as many pixels per cell, so that one near look does not outvote many."""
    target_pixels: float = 3.0
    """Target pixels without which a cell is no target, however large their share."""
    target_share: float = 0.5
    """Share of a cell's pixels that must be target; lower finds more lone clumps and more errors."""
    ground_pixels: float = 4.0
    """The seabed around a cell weighs as much as so many of its own points in its height."""
    ground_share: float = 20.0
    """A cell weighs at most as much as so many points in the height of the seabed around it."""
    ground_memory: float = 1000.0
    """Seabed points that a cell remembers."""


class OccupancyMap:
    """A semantic occupancy grid over the survey area.

    What it does: frames with poses go in by `integrate`, layers come out as read-only arrays of
    (rows, cols). An array that was read keeps its values when the map goes on.

    Reference: Eq. 1-8 of the paper. Solid and target are separate, since a wreck is both; heights
    are above the local seabed, whose height is learnt from the points labelled seabed.

    Assumes: a camera that looks ahead, mounted at the vehicle's centre; the protocol's altitude.

    Fails when: labels call a boulder seabed in most of its pixels (the ground then rises to it).
    """

    def __init__(self, bounds: Bounds, protocol: SurveyProtocol, evidence: Evidence | None = None) -> None:
        """An empty map.

        Args:
            bounds: The survey area; its sides are whole numbers of cells.
            protocol: Cell size, reach, height band, depth limits and body.
            evidence: How frames are weighed.
        """
        shape = []
        for side, length in (("depth", bounds.depth), ("width", bounds.width)):
            cells = length / protocol.cell
            if abs(cells - round(cells)) > 1e-6:
                raise ValueError(
                    f"bounds: expected a {side} of whole {protocol.cell} m cells, got {length} m"
                )
            shape.append(round(cells))
        self.bounds = bounds
        self.protocol = protocol
        self.evidence = Evidence() if evidence is None else evidence
        rows, cols = shape
        self._log_odds = np.zeros((rows, cols), np.float32)
        self._hits = np.zeros((rows, cols), np.float32)
        self._returns = np.zeros((rows, cols), np.float32)
        self._ground_sum = np.zeros((rows, cols), np.float64)
        self._ground_count = np.zeros((rows, cols), np.float64)
        self._explored = np.zeros((rows, cols), np.bool_)
        self._bare = np.zeros((rows, cols), np.bool_)
        self._seabed_seen = np.zeros((rows, cols), np.bool_)
        self._crossed = np.zeros((rows, cols), np.bool_)
        self._launch = np.zeros((rows, cols), np.bool_)
        self._layers: dict[str, npt.NDArray[Any]] = {}

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self._log_odds.shape[0], self._log_odds.shape[1]

    # ------------------------------------------------------------------------------ where cells are

    def cell_of(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[IntArray, IntArray]:
        """Row and column of world positions; outside the grid where they are outside the bounds."""
        row = np.floor((np.asarray(y, np.float64) - self.bounds.y_min) / self.protocol.cell).astype(np.intp)
        col = np.floor((np.asarray(x, np.float64) - self.bounds.x_min) / self.protocol.cell).astype(np.intp)
        return row, col

    def center_of(
        self, row: npt.ArrayLike, col: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """World x and y of cells' centres."""
        x = self.bounds.x_min + (np.asarray(col) + 0.5) * self.protocol.cell
        y = self.bounds.y_min + (np.asarray(row) + 0.5) * self.protocol.cell
        return x, y

    def contains(self, x: npt.ArrayLike, y: npt.ArrayLike) -> BoolArray:
        """Whether world positions fall into a cell of the map."""
        row, col = self.cell_of(x, y)
        inside: BoolArray = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        return inside

    # ------------------------------------------------------------------------------------ what goes in

    def clear_launch(self, x: float, y: float) -> None:
        """Take the ground within the protocol's launch radius for free: traversable, not explored."""
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"launch: expected a finite position, got ({x}, {y})")
        rows, cols = np.indices(self.shape, sparse=True)
        center_x, center_y = self.center_of(rows, cols)
        self._launch |= np.hypot(center_x - x, center_y - y) <= self.protocol.launch_radius
        self._layers = {}

    def integrate(
        self,
        depth: npt.NDArray[np.floating[Any]],
        labels: npt.NDArray[np.integer[Any]],
        camera: Camera,
        T_world_camera: SE3,
    ) -> None:
        """Add one frame. The inputs are not changed.

        A direct return explores its cell. Beside that, rays explore the camera's sector from the
        protocol's blind distance to its reach (Eq. 7-8), as far as they are unblocked and as some return in
        their direction shows that they ran; a direction without any return claims nothing.

        Args:
            depth: (H, W) metres along the optical axis. NaN is no return; what is outside the protocol's
                limits is ignored.
            labels: (H, W) values of `Label`. Water is no return.
            camera: Intrinsics of both images.
            T_world_camera: Where the optical frame was.

        Raises:
            ValueError: The images do not fit the camera, or labels are not labels.
        """
        from dream.mapping._kernels import frame

        depth, labels = np.asarray(depth), np.asarray(labels)
        _check_frame(depth, labels, camera)
        depth, labels = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(labels, np.uint8)
        protocol, evidence, t = self.protocol, self.evidence, T_world_camera.translation
        cells = np.empty(depth.size, np.int32)
        heights = np.empty(depth.size, np.float32)
        farthest = np.zeros(RAYS, np.float64)
        counts = np.zeros((self._explored.size, 4), np.int32)
        window = self._anchor_ground(t)
        frame.project_pixels(
            depth,
            labels,
            (camera.fx, camera.fy, camera.cx, camera.cy),
            T_world_camera.rotation,
            t,
            (self.bounds.x_min, self.bounds.y_min),
            protocol.cell,
            (protocol.min_depth, protocol.max_depth, protocol.reach),
            (int(Label.WATER), int(Label.SEABED), int(Label.TARGET)),
            cells,
            heights,
            self._ground_sum,
            self._ground_count,
            self._seabed_seen,
            farthest,
        )
        excess = self._ground_count > evidence.ground_memory
        self._ground_sum[excess] *= evidence.ground_memory / self._ground_count[excess]
        self._ground_count[excess] = evidence.ground_memory
        frame.count_returns(
            cells, heights, labels, self._smooth_ground(window), protocol.band, int(Label.TARGET), counts
        )
        frame.update_evidence(
            counts,
            self._log_odds,
            self._hits,
            self._returns,
            self._explored,
            self._bare,
            evidence.hit,
            evidence.miss,
            evidence.clamp,
            evidence.min_pixels,
            evidence.min_share,
            evidence.min_ground,
            evidence.frame_pixels,
        )
        self._cast(camera, T_world_camera, farthest, counts)
        self._layers = {}

    def _anchor_ground(self, camera_position: npt.NDArray[np.floating[Any]]) -> tuple[int, int, int, int]:
        """Count the camera as a faint sample of the ground; the window of cells within reach of it.

        The vehicle holds its altitude above the bare seabed.
        """
        x, y, z = camera_position
        rows, cols = self.shape
        row, col = (int(index) for index in self.cell_of(x, y))
        under = min(max(row, 0), rows - 1), min(max(col, 0), cols - 1)
        self._ground_sum[under] += z - self.protocol.altitude
        self._ground_count[under] += 1.0
        reach = math.ceil(self.protocol.reach / self.protocol.cell) + 1
        return (
            max(row - reach, 0),
            min(row + reach + 1, rows),
            max(col - reach, 0),
            min(col + reach + 1, cols),
        )

    def _cast(
        self,
        camera: Camera,
        T_world_camera: SE3,
        farthest: npt.NDArray[np.float64],
        counts: npt.NDArray[np.int32],
    ) -> None:
        from dream.mapping._kernels import frame

        forward = T_world_camera.rotation[:, 2]
        level_part = math.hypot(forward[0], forward[1])
        if level_part < 0.1:  # Looking straight down there is no sector; the direct returns are all.
            return
        left, right = math.atan(camera.cx / camera.fx), math.atan((camera.width - camera.cx) / camera.fx)
        yaw = math.atan2(forward[1], forward[0]) + 0.5 * (left - right)
        highest = math.atan(camera.cy / camera.fy) - math.atan2(-forward[2], level_part)
        row, col, table = locate(self, *(float(value) for value in T_world_camera.translation[:2]))
        cell = self.protocol.cell
        frame.integrate_sector(
            row,
            col,
            table.rows,
            table.cols,
            table.x,
            table.y,
            table.distance,
            table.first,
            table.last,
            math.cos(yaw),
            math.sin(yaw),
            math.cos(0.5 * camera.horizontal_fov),
            self.protocol.blind / cell,
            highest >= 0.0,
            # One more cell, since the farthest return lies anywhere in its own.
            np.where(farthest > 0.0, farthest / cell + 1.0, 0.0),
            counts,
            self._log_odds,
            self.evidence.miss,
            self.evidence.clamp[0],
            self._explored,
            self._crossed,
        )

    def _smooth_ground(self, window: tuple[int, int, int, int]) -> npt.NDArray[np.float64]:
        """The ground inside a window of cells, from means on ever coarser grids; NaN elsewhere."""
        from dream.mapping._kernels import frame

        levels = [(self._ground_sum, self._ground_count)]
        windows = [window]
        while levels[-1][0].size > 1:
            levels.append(frame.pull(*levels[-1], self.evidence.ground_share))
            rows, cols = levels[-1][0].shape
            low_row, past_row, low_col, past_col = windows[-1]
            windows.append(
                (
                    max(low_row // 2 - 1, 0),
                    min(past_row // 2 + 2, rows),
                    max(low_col // 2 - 1, 0),
                    min(past_col // 2 + 2, cols),
                )
            )
        total, count = levels[-1]
        ground = np.where(count > 0.0, total / np.maximum(count, 1e-9), np.nan)
        for (total, count), part in zip(reversed(levels[:-1]), reversed(windows[:-1]), strict=True):
            ground = frame.push(total, count, ground, self.evidence.ground_pixels, part)
        return ground

    # ---------------------------------------------------------------------------------- what comes out

    def _layer(self, name: str, compute: Callable[[], npt.NDArray[Any]]) -> npt.NDArray[Any]:
        if name not in self._layers:
            layer = compute()
            layer.flags.writeable = False
            self._layers[name] = layer
        return self._layers[name]

    @property
    def solid(self) -> BoolArray:
        """Something stands in the height band above the local seabed, target or not."""
        return self._layer("solid", lambda: self._log_odds > 0.0)

    @property
    def target(self) -> BoolArray:
        """Most of what was seen in the cell is target, in enough pixels."""
        return self._layer(
            "target",
            lambda: (
                (self._hits >= self.evidence.target_pixels)
                & (self._hits > self.evidence.target_share * self._returns)
            ),
        )

    @property
    def target_probability(self) -> Float32Array:
        """Share of target among what was seen in the cell, float32; one half where nothing was."""
        return self._layer("target_probability", lambda: (self._hits + 1.0) / (self._returns + 2.0))

    @property
    def explored(self) -> BoolArray:
        """The paper's E_t. Never forgets."""
        return self._layer("explored", self._explored.copy)

    @property
    def seabed_seen(self) -> BoolArray:
        """A return from the seabed or a target fell into the cell."""
        return self._layer("seabed_seen", self._seabed_seen.copy)

    @property
    def crossed(self) -> BoolArray:
        """A ray at the vehicle's own height passed through."""
        return self._layer("crossed", self._crossed.copy)

    @property
    def traversable(self) -> BoolArray:
        """Explored, crossed or launch ground, and not solid.

        What was explored only by returns from above the band, a deck or an overhang, is left out: what stands
        below was not seen.
        """
        return self._layer("traversable", lambda: (self._bare | self._crossed | self._launch) & ~self.solid)

    @property
    def inflated(self) -> BoolArray:
        """Solid, or so near that the body could touch it from somewhere in the cell."""
        return self._layer("inflated", lambda: self._clearance(self.solid) <= self.needed_room)

    @property
    def standable(self) -> BoolArray:
        """Where the vehicle's centre may be.

        Wherever inside such a cell it is, the whole disc of its body lies in bounds and on traversable
        ground (half a cell's diagonal of margin makes it so).
        """
        return self._layer("standable", lambda: self.room > self.needed_room)

    @property
    def ground(self) -> Float32Array:
        """World z of the seabed, float32 metres: a smooth surface through the points labelled seabed.

        Where none were, it follows from those around; with none at all, from the camera's height less
        the protocol's altitude. NaN before the first frame.
        """
        rows, cols = self.shape
        return self._layer("ground", lambda: self._smooth_ground((0, rows, 0, cols)).astype(np.float32))

    @property
    def distance_to_solid(self) -> Float32Array:
        """Metres between each cell's centre and the nearest solid cell's, float32; inf without one."""
        return self._layer("distance_to_solid", self._distance_to_solid)

    def _distance_to_solid(self) -> npt.NDArray[Any]:
        from scipy import ndimage

        if not self.solid.any():
            return np.full(self.shape, np.inf, np.float32)
        distance: npt.NDArray[Any] = ndimage.distance_transform_edt(~self.solid, self.protocol.cell)
        return distance.astype(np.float32)

    @property
    def needed_room(self) -> int:
        """`room` that a standable cell exceeds: body radius and half a cell's diagonal."""
        return math.floor((2.0 * self.protocol.body_radius / self.protocol.cell + math.sqrt(2.0)) ** 2 - 1e-9)

    @property
    def room(self) -> npt.NDArray[np.int32]:
        """Squared distance, int32 in half cells, from each cell's centre to what is not traversable.

        Measured to the nearest such cell's square, or to the outside. Beyond `needed_room` it is only known
        to be larger.
        """
        return self._layer("room", self._measure_room)

    def _measure_room(self) -> npt.NDArray[np.int32]:
        # What lies outside the bounds is not traversable either.
        barrier = np.pad(~self.traversable, 1, constant_values=True)
        return self._clearance(barrier)[1:-1, 1:-1].copy()

    def _clearance(self, barrier: BoolArray) -> npt.NDArray[np.int32]:
        from dream.mapping._kernels import room

        squared: npt.NDArray[np.int32] = room.clearance(barrier, (math.isqrt(self.needed_room) + 1) // 2)
        return squared

    def passable(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> BoolArray:
        """Whether the vehicle may move straight from each start to its end.

        Every sample along the segment, half a cell apart, must lie in a standable cell. From a start
        that is not standable itself (a wall turned out to be nearer than thought), only a way out is
        free: its room never shrinks, and its end has more of it.

        Args:
            starts: (N, 2) metres in the world.
            ends: (N, 2) metres in the world.

        Returns:
            (N,) bool.
        """
        from dream.mapping._kernels import room

        origin = np.array([self.bounds.x_min, self.bounds.y_min])
        pairs = []
        for name, points in (
            ("starts", np.asarray(starts, np.float64)),
            ("ends", np.asarray(ends, np.float64)),
        ):
            if points.ndim != 2 or points.shape[1] != 2:
                raise ValueError(f"{name}: expected (N, 2) metres, got {points.shape}")
            if not np.isfinite(points).all():
                raise ValueError(f"{name}: expected finite positions, got NaN or infinity")
            pairs.append((points - origin) / self.protocol.cell)
        if len(pairs[0]) != len(pairs[1]):
            raise ValueError(f"ends: expected {len(pairs[0])}, one for every start, got {len(pairs[1])}")
        free: BoolArray = room.segments_are_free(self.room, self.needed_room, *pairs)
        return free

    def areas(self) -> dict[str, float]:
        """Square metres explored, target, solid and of seabed really seen."""
        square = self.protocol.cell**2
        layers = ("explored", "target", "solid", "seabed_seen")
        return {name: float(np.count_nonzero(getattr(self, name))) * square for name in layers}

    # ----------------------------------------------------------------------------------- copies, files

    def copy(self) -> OccupancyMap:
        """A map of its own with the same content."""
        other = OccupancyMap(self.bounds, self.protocol, self.evidence)
        for name in STATE:
            setattr(other, f"_{name}", getattr(self, f"_{name}").copy())
        return other

    def save(self, path: str | Path) -> None:
        """Write everything to one .npz file."""
        about = {
            "format": FORMAT,
            "bounds": dataclasses.asdict(self.bounds),
            "protocol": dataclasses.asdict(self.protocol),
            "evidence": dataclasses.asdict(self.evidence),
        }
        arrays = {name: getattr(self, f"_{name}") for name in STATE}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)

    @staticmethod
    def load(path: str | Path) -> OccupancyMap:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is damaged, or no map; the message says what was expected and what was found.
        """
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as content:
                stored = {name: content[name] for name in content.files}
            about = json.loads(str(stored.pop("about")))
        except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, OSError, TypeError, ValueError) as error:
            if isinstance(error, FileNotFoundError):
                raise
            raise ValueError(
                f"{path}: expected a map written by save, got a damaged or foreign file ({error})"
            ) from error
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise ValueError(f'{path}: expected format "{FORMAT}", got {about!r:.80}')
        try:
            protocol = about["protocol"]
            protocol["camera"] = Camera(**protocol["camera"])
            for name in ("band", "turns", "advances"):
                protocol[name] = tuple(protocol[name])
            about["evidence"]["clamp"] = tuple(about["evidence"]["clamp"])
            occupancy = OccupancyMap(
                Bounds(**about["bounds"]), SurveyProtocol(**protocol), Evidence(**about["evidence"])
            )
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"{path}: expected bounds, protocol and evidence, got something else ({error})"
            ) from error
        for name in STATE:
            mine = getattr(occupancy, f"_{name}")
            found = stored.get(name)
            if found is None or found.shape != mine.shape or found.dtype != mine.dtype:
                got = "nothing" if found is None else f"{found.shape} {found.dtype}"
                raise ValueError(f"{path}: {name}: expected {mine.shape} {mine.dtype}, got {got}")
            if not np.isfinite(found).all():
                raise ValueError(f"{path}: {name}: expected finite numbers, got NaN or infinity")
            setattr(occupancy, f"_{name}", found)
        return occupancy


def _check_frame(depth: npt.NDArray[Any], labels: npt.NDArray[Any], camera: Camera) -> None:
    for name, image in (("depth", depth), ("labels", labels)):
        if image.ndim != 2:
            raise ValueError(f"{name}: expected (height, width), got {image.shape}")
        camera.check(image, name)
    if not np.issubdtype(depth.dtype, np.floating):
        raise ValueError(f"depth: expected floating-point metres, got {depth.dtype}. Are these millimetres?")
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"labels: expected integers, values of Label, got {labels.dtype}")
    if labels.size and (labels.min() < min(Label) or labels.max() > max(Label)):
        wrong = labels.max() if labels.max() > max(Label) else labels.min()
        raise ValueError(f"labels: expected values of Label, {min(Label):d} to {max(Label):d}, got {wrong}")
