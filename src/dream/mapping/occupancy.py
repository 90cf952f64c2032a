"""The map: what is solid, target, explored and traversable, cell by cell."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Bounds, Camera
from dream.mapping._kernels import flags
from dream.mapping.blocks import BlockStore
from dream.mapping.edges import Edges
from dream.mapping.layers import (
    BLOCK,
    CELLS,
    LEVELS,
    POSTS,
    QUANTUM,
    Evidence,
    Layers,
    post_bits,
)
from dream.mapping.visibility import FRACTIONS, RAYS, ray_table
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray, Label

FORMAT = "dream-map-2"
PIXELS_ACROSS = 4
"""Pixels that are looked at along the side of a cell that faces the camera; what is nearer is thinned."""
THINNINGS = 2
"""How often rows and columns may be halved, at most."""
Rectangle = tuple[int, int, int, int]
"""First row and column, past row and column; cells of the store."""
MOST_TABLES = 8
MOST_PENDING = 8
"""Changes that the edges may be behind."""
NO_BOUNDS = 1 << 30
"""Cells: farther than any survey goes."""


class OccupancyMap(Layers):
    """A semantic occupancy grid that grows where the robot looks.

    What it does: frames with poses go in by `integrate`, layers come out as read-only arrays of
    (rows, cols), over the survey area or, by `over`, over any window. An array that was read keeps its values
    when the map goes on.

    Reference: Eq. 1-8 of the paper; docs/map.md has the update rule. Solid and target are separate, since a
    wreck is both; heights are above the local seabed, whose height is learnt from the points labelled seabed.

    Assumes: a camera that looks ahead, mounted at the vehicle's centre; the protocol's altitude.

    Fails when: labels call a boulder seabed in most of its pixels (the ground then rises to it).
    """

    def __init__(
        self, bounds: Bounds | None, protocol: SurveyProtocol, evidence: Evidence | None = None
    ) -> None:
        """An empty map.

        Args:
            bounds: The survey area, whose sides are whole numbers of cells: nothing outside is ever known. None
                for a map without an end, whose `bounds` are the blocks that it has so far.
            protocol: Cell size, reach, height band, depth limits and body.
            evidence: How frames are weighed.
        """
        bits = post_bits(protocol)
        posts = (BLOCK >> bits, BLOCK >> bits)
        store = BlockStore(
            {
                "log_odds": (np.int8, (BLOCK, BLOCK)),
                "flags": (np.uint8, (BLOCK, BLOCK)),
                "votes": (np.uint8, (BLOCK, BLOCK)),
                "ground_sum": (np.float32, posts),
                "ground_count": (np.float32, posts),
            }
        )
        if bounds is not None:
            for side, length in (("depth", bounds.depth), ("width", bounds.width)):
                cells = length / protocol.cell
                if abs(cells - round(cells)) > 1e-6:
                    raise ValueError(
                        f"bounds: expected a {side} of whole {protocol.cell} m cells, got {length} m"
                    )
        area = bounds or Bounds(0.0, 0.0, protocol.cell, protocol.cell)
        super().__init__(store, (0, 0), area, protocol, evidence or Evidence(), math.nan)
        self._origin = (area.x_min, area.y_min)
        self._bounded = bounds is not None
        self._stamp = 0
        self._frame: _Frame | None = None
        self._edges = Edges(store, self.needed_room, (0, 0, *self.shape) if self._bounded else None)
        self._pending: list[Rectangle] = []

    # ------------------------------------------------------------------------------------ what goes in

    def clear_launch(self, x: float, y: float) -> None:
        """Take the ground within the protocol's launch radius for free: traversable, not explored."""
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"launch: expected a finite position, got ({x}, {y})")
        cell, radius = self.protocol.cell, self.protocol.launch_radius
        (row, col), half = self._global(x, y), math.ceil(radius / cell) + 1
        rows, cols = np.mgrid[row - half : row + half + 1, col - half : col + half + 1]
        center_x, center_y = self._origin[0] + (cols + 0.5) * cell, self._origin[1] + (rows + 0.5) * cell
        near = np.hypot(center_x - x, center_y - y) <= radius
        if self._bounded:
            near &= (rows >= 0) & (rows < self.shape[0]) & (cols >= 0) & (cols < self.shape[1])
        low = (row - half, col - half)
        marked = self._store.read("flags", low, near.shape)
        marked[near] |= flags.CROSSED
        self._write("flags", low, marked)

    def _write(self, name: str, low: tuple[int, int], cells: npt.NDArray[Any]) -> None:
        self._stamp += 1
        for key in self._store.write(name, low, cells):
            self._store.stamps[self._store.slot_of[key]] = self._stamp
        self._changed((*low, low[0] + cells.shape[0], low[1] + cells.shape[1]))

    def integrate(
        self,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
    ) -> None:
        """Add one frame. The inputs are not changed.

        A direct return explores its cell. Beside that, rays explore the camera's sector from the blind distance to
        the protocol's reach (Eq. 7-8), as far as they are unblocked and as some return in their direction shows
        that they ran; a direction without any return claims nothing.

        Args:
            depth: (H, W) along the optical axis: float metres, NaN for no return, or uint16 millimetres, 0 for no
                return. What is outside the protocol's limits is ignored.
            labels: (H, W) integers, values of `Label`, water being no return; or floats, the probability in
                [0, 1] that the pixel shows target, whose seabed is then told by its height.
            camera: Intrinsics of both images.
            T_world_camera: Where the optical frame was.

        Raises:
            ValueError: The images do not fit the camera, or labels are not labels.
        """
        depth, labels = np.asarray(depth), np.asarray(labels)
        _check_frame(depth, labels, camera)
        if self._frame is None or self._frame.pixels < depth.size:
            self._frame = _Frame(self.protocol, self.evidence, depth.size)
        self._frame.read(self, depth, labels, camera, T_world_camera)
        self._changed(self._frame.commit(self))

    def _global(self, x: float, y: float) -> tuple[int, int]:
        """Row and column in the store."""
        cell = self.protocol.cell
        return math.floor((y - self._origin[1]) / cell), math.floor((x - self._origin[0]) / cell)

    def _changed(self, cells: Rectangle) -> None:
        """Cells of the store in (first row, first col, past row, past col) became another."""
        self._layers = {}
        self._pending.append(cells)
        if len(self._pending) > MOST_PENDING:
            self._renew_edges()
        if not self._bounded and len(self._store):
            keys = np.array(list(self._store.slot_of))
            (row, col), past = keys.min(axis=0) * BLOCK, (keys.max(axis=0) + 1) * BLOCK
            self._low, self._shape = (int(row), int(col)), (int(past[0] - row), int(past[1] - col))
            self.bounds = self._window(self._low, self._shape)

    def _renew_edges(self) -> None:
        for cells in self._pending:
            self._edges.update(*cells)
        self._pending = []

    @property
    def edges(self) -> Edges:
        """Frontier and clusters, and the bits of inflation, up to date."""
        if self._pending:
            self._renew_edges()
        return self._edges

    @property
    def inflated(self) -> BoolArray:
        """See `Layers.inflated`."""
        if self._pending:
            self._renew_edges()
            self._layers.pop("wide flags", None)
        return super().inflated

    # ---------------------------------------------------------------------------------- what comes out

    def over(self, bounds: Bounds) -> Layers:
        """The map over the cells that a box touches, as it is now; inside the map's bounds or not."""
        cell = self.protocol.cell
        low_row, low_col = (
            math.floor((edge - origin) / cell + 1e-9)
            for edge, origin in ((bounds.y_min, self._origin[1]), (bounds.x_min, self._origin[0]))
        )
        past_row, past_col = (
            math.ceil((edge - origin) / cell - 1e-9)
            for edge, origin in ((bounds.y_max, self._origin[1]), (bounds.x_max, self._origin[0]))
        )
        low = (low_row, low_col)
        window = self._window(low, (past_row - low_row, past_col - low_col))
        self._renew_edges()
        layers = Layers(self._store, low, window, self.protocol, self.evidence, self._datum)
        for name in CELLS:  # read now, since the store goes on
            layers._wide(name)
        assert layers.ground.shape == layers.shape
        return layers

    def _window(self, low: tuple[int, int], shape: tuple[int, int]) -> Bounds:
        cell, (x, y) = self.protocol.cell, self._origin
        return Bounds(
            x + low[1] * cell,
            y + low[0] * cell,
            x + (low[1] + shape[1]) * cell,
            y + (low[0] + shape[0]) * cell,
        )

    @property
    def stamp(self) -> int:
        """Number of changes so far; `dirty` takes one from before."""
        return self._stamp

    def dirty(self, since: int = 0) -> list[Bounds]:
        """The blocks that were written after a stamp, as boxes in the world."""
        stamps = self._store.stamps
        return [
            self._window((row * BLOCK, col * BLOCK), (BLOCK, BLOCK))
            for (row, col), slot in self._store.slot_of.items()
            if stamps[slot] > since
        ]

    @property
    def nbytes(self) -> int:
        """Bytes that the cells take."""
        return self._store.nbytes

    # ----------------------------------------------------------------------------------- copies, files

    def copy(self) -> OccupancyMap:
        """A map of its own with the same content."""
        other = OccupancyMap(self.bounds if self._bounded else None, self.protocol, self.evidence)
        other._store = self._store.copy()
        other._edges = self.edges.copy(other._store)
        other._stamp, other._datum = self._stamp, self._datum
        other.bounds, other._low, other._shape = self.bounds, self._low, self._shape
        return other

    def save(self, path: str | Path) -> None:
        """Write everything to one .npz file."""
        about = {
            "format": FORMAT,
            "bounds": dataclasses.asdict(self.bounds) if self._bounded else None,
            "protocol": dataclasses.asdict(self.protocol),
            "evidence": dataclasses.asdict(self.evidence),
            "stamp": self._stamp,
            "datum": self._datum if math.isfinite(self._datum) else None,
        }
        self._renew_edges()
        store, used = self._store, 1 + len(self._store)
        keys = np.array(list(store.slot_of), np.int64).reshape(-1, 2)
        arrays = {name: store.pools[name][1:used] for name in (*CELLS, *POSTS)}
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file, about=np.array(json.dumps(about)), blocks=keys, stamps=store.stamps[1:used], **arrays
            )

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
            bounds = None if about["bounds"] is None else Bounds(**about["bounds"])
            occupancy = OccupancyMap(bounds, SurveyProtocol(**protocol), Evidence(**about["evidence"]))
            occupancy._stamp = int(about["stamp"])
            occupancy._datum = math.nan if about["datum"] is None else float(about["datum"])
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"{path}: expected bounds, protocol and evidence, got something else ({error})"
            ) from error
        keys = stored.get("blocks")
        if keys is None or keys.dtype != np.int64 or keys.ndim != 2 or keys.shape[1] != 2:
            raise ValueError(f"{path}: blocks: expected (n, 2) int64, got {_kind(keys)}")
        if len(np.unique(keys, axis=0)) != len(keys) or (len(keys) and np.abs(keys).max() > NO_BOUNDS):
            raise ValueError(f"{path}: blocks: expected different blocks within reach, got others")
        store = occupancy._store
        expected = {name: (dtype, (len(keys), *shape)) for name, (dtype, shape) in store.layers.items()}
        for name, (dtype, shape) in {**expected, "stamps": (np.dtype(np.int64), (len(keys),))}.items():
            found = stored.get(name)
            if found is None or found.shape != shape or found.dtype != dtype:
                raise ValueError(f"{path}: {name}: expected {shape} {dtype}, got {_kind(found)}")
            if not np.isfinite(found).all():
                raise ValueError(f"{path}: {name}: expected finite numbers, got NaN or infinity")
        store.make((int(row), int(col)) for row, col in keys)
        for name in expected:
            store.pools[name][1 : 1 + len(keys)] = stored[name]
        store.stamps[1 : 1 + len(keys)] = stored["stamps"]
        occupancy._edges = Edges(store, occupancy.needed_room, occupancy._edges.limits)
        occupancy._changed((0, 0, 0, 0))
        return occupancy


class _Frame:
    """What one frame says, over a window of cells around the camera; and room to work it out in."""

    def __init__(self, protocol: SurveyProtocol, evidence: Evidence, pixels: int) -> None:
        self.pixels = pixels
        self.bits = post_bits(protocol)
        self.post = 1 << self.bits
        reach = math.ceil(protocol.reach / protocol.cell)
        # The window's low corner lies on a post; two cells are for rounding.
        self.side = -(-(2 * reach + 3 + self.post) // self.post) * self.post
        self.half = reach + 1
        self.posts = self.side >> self.bits
        cells = self.side * self.side
        self.samples = np.empty(pixels + 1, np.int32)
        self.heights = np.empty(pixels + 1, np.float32)
        post = np.arange(self.side) >> self.bits
        self.post_of = (post[:, None] * self.posts + post[None, :]).astype(np.int32).ravel()
        self.farthest = np.empty(RAYS, np.float32)
        self.ground = np.empty(cells, np.float32)
        self.counts = np.empty(cells, np.uint64)
        self.targets = np.empty(cells, np.int32)
        self.log_odds = np.empty(cells, np.int8)
        self.tables: dict[tuple[int, ...], tuple[int, IntArray]] = {}
        self.flags, self.said, self.votes = (np.empty(cells, np.uint8) for _ in range(3))
        self.low = (0, 0)
        self.post_sum = np.empty((self.posts, self.posts))
        self.post_count = np.empty((self.posts, self.posts))
        self.steps = (round(evidence.step / QUANTUM), round(evidence.doubt / QUANTUM))
        self.clamp = (math.ceil(evidence.clamp[0] / QUANTUM), math.floor(evidence.clamp[1] / QUANTUM))

    def read(
        self,
        occupancy: OccupancyMap,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
    ) -> None:
        from dream.mapping._kernels import frame

        protocol, evidence, store = occupancy.protocol, occupancy.evidence, occupancy._store
        t, R = T_world_camera.translation, T_world_camera.rotation
        x, y = float(t[0]), float(t[1])
        row, col = occupancy._global(x, y)
        low = ((row - self.half) // self.post * self.post, (col - self.half) // self.post * self.post)
        self.low = low
        rows, cols = occupancy.shape if occupancy._bounded else (NO_BOUNDS, NO_BOUNDS)
        clip = (
            min(max(-low[0], 0), self.side) if occupancy._bounded else 0,
            max(min(rows - low[0], self.side), 0),
            min(max(-low[1], 0), self.side) if occupancy._bounded else 0,
            max(min(cols - low[1], self.side), 0),
        )
        offset = (low[0] % BLOCK, low[1] % BLOCK)
        blocks = [(o + self.side - 1) // BLOCK + 1 for o in offset]
        first = [a // BLOCK for a in low]
        table = self._table(store, first, blocks)
        occupancy._datum = float(t[2]) - protocol.altitude
        soft = np.issubdtype(labels.dtype, np.floating)

        # ---- the seabed as it was, and this frame's points of it
        post_low = [a >> self.bits for a in low]
        coarse = 1 << LEVELS
        wide_low = [(a // coarse - 2) * coarse for a in post_low]
        wide = [
            (-(-(a + self.posts) // coarse) + 2) * coarse - b for a, b in zip(post_low, wide_low, strict=True)
        ]
        per_block = BLOCK >> self.bits
        wide_first = [a // per_block for a in wide_low]
        wide_offset = [a % per_block for a in wide_low]
        wide_table = self._table(
            store, wide_first, [(o + n - 1) // per_block + 1 for o, n in zip(wide_offset, wide, strict=True)]
        )
        total, count = np.empty(wide), np.empty(wide)
        frame.gather_posts(
            store.pools["ground_sum"], store.pools["ground_count"], wide_table, *wide_offset, total, count
        )
        margin = [a - b for a, b in zip(post_low, wide_low, strict=True)]
        region = (
            margin[0] - 1,
            margin[0] + self.posts + 1,
            margin[1] - 1,
            margin[1] + self.posts + 1,
        )

        def smooth() -> npt.NDArray[np.float64]:
            heights: npt.NDArray[np.float64] = frame.smooth_ground(
                total,
                count,
                LEVELS,
                evidence.ground_share,
                evidence.ground_pixels,
                occupancy._datum,
                region,
            )
            return heights

        inside = np.s_[margin[0] : margin[0] + self.posts, margin[1] : margin[1] + self.posts]
        self.post_sum[:], self.post_count[:] = 0.0, 0.0
        under = (row - low[0]) >> self.bits, (col - low[1]) >> self.bits
        self.post_sum[under] += occupancy._datum
        self.post_count[under] += 1.0
        prior = np.zeros(1)
        if soft:
            prior = smooth()[inside].ravel()
        thin = protocol.cell * min(camera.fx, camera.fy) / PIXELS_ACROSS
        cuts = np.array([thin / (2 << k) for k in range(THINNINGS)], np.float32)
        unit = 0.001 if depth.dtype == np.uint16 else 1.0
        self.count = frame.project(
            depth,
            unit,
            labels,
            255.0 if soft else 1,
            labels.dtype.type(-1.0) if soft else labels.dtype.type(Label.WATER),
            _KIND_SOFT if soft else _KIND,
            (camera.fx, camera.fy, camera.cx, camera.cy),
            R,
            t,
            (
                occupancy._origin[0] + low[1] * protocol.cell,
                occupancy._origin[1] + low[0] * protocol.cell,
            ),
            protocol.cell,
            (protocol.min_depth, protocol.max_depth, protocol.reach),
            cuts,
            (np.append(cuts, protocol.min_depth) / unit).astype(depth.dtype),
            self.side,
            clip,
            self.post_of,
            prior,
            protocol.band[0],
            self.samples,
            self.heights,
            self.post_sum.ravel(),
            self.post_count.ravel(),
            self.farthest,
        )
        total[inside] += self.post_sum
        count[inside] += self.post_count
        frame.spread_ground(
            smooth(),
            *margin,
            self.bits,
            self.side,
            self.ground,
        )

        # ---- what every cell shows
        self.counts[:], self.targets[:] = 0, 0
        lower, upper = protocol.band
        frame.count_returns(
            self.count,
            self.samples,
            self.heights,
            self.ground,
            tuple(np.float32(edge) for edge in (lower, lower + 0.25 * (upper - lower), upper)),
            _WEIGHT_SOFT if soft else _WEIGHT,
            self.counts,
            self.targets,
        )
        frame.gather(
            store.pools["log_odds"], store.pools["flags"], table, *offset, self.side, self.log_odds, self.flags
        )
        self.touched = np.zeros(blocks, np.bool_)
        self.said[:], self.votes[:] = 0, 0
        frame.weigh(
            self.counts,
            self.targets,
            self.side,
            (y - occupancy._origin[1]) / protocol.cell - low[0],
            (x - occupancy._origin[0]) / protocol.cell - low[1],
            self.steps,
            self.clamp,
            (
                evidence.min_pixels,
                evidence.min_share,
                evidence.peak_share,
                evidence.min_ground,
                evidence.vote_pixels,
                evidence.vote_share,
            ),
            evidence.range_noise,
            protocol.cell,
            self.log_odds,
            self.flags,
            self.said,
            self.votes,
            *offset,
            self.touched,
        )
        self.first, self.offset, self.blocks = first, offset, blocks
        self._cast(occupancy, camera, T_world_camera, clip)

    def _cast(
        self,
        occupancy: OccupancyMap,
        camera: Camera,
        T_world_camera: SE3,
        clip: tuple[int, int, int, int],
    ) -> None:
        from dream.mapping._kernels import frame

        protocol = occupancy.protocol
        forward = T_world_camera.rotation[:, 2]
        level_part = math.hypot(forward[0], forward[1])
        if level_part < 0.1:  # Looking straight down there is no sector; the direct returns are all.
            return
        pitch = math.atan2(-forward[2], level_part)
        left, right = math.atan(camera.cx / camera.fx), math.atan((camera.width - camera.cx) / camera.fx)
        yaw = math.atan2(forward[1], forward[0]) + 0.5 * (left - right)
        highest = math.atan(camera.cy / camera.fy) - pitch
        steepest = math.atan((camera.height - camera.cy) / camera.fy) + pitch
        blind = protocol.altitude / math.tan(steepest) if steepest < 0.5 * math.pi else 0.0
        cell, (x0, y0) = protocol.cell, occupancy._origin
        x, y = (float(value) for value in T_world_camera.translation[:2])
        col, fraction_x = divmod(round((x - x0) / cell * FRACTIONS), FRACTIONS)
        row, fraction_y = divmod(round((y - y0) / cell * FRACTIONS), FRACTIONS)
        table = ray_table(protocol.reach / cell, fraction_x, fraction_y)
        frame.cast_frame(
            row - self.low[0],
            col - self.low[1],
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
            blind / cell,
            highest >= 0.0,
            1.0 / cell,
            self.farthest,
            self.side,
            clip,
            self.counts,
            self.steps[0],
            self.clamp[0],
            self.log_odds,
            self.said,
            *self.offset,
            self.touched,
        )

    def _table(self, store: BlockStore, low: list[int], shape: list[int]) -> IntArray:
        """`BlockStore.table`; mostly it is the same as before."""
        key = (*low, *shape)
        known = self.tables.get(key)
        if known is None or known[0] != len(store):
            if len(self.tables) > MOST_TABLES:
                self.tables = {}
            known = self.tables[key] = (len(store), store.table(low, shape))
        return known[1]

    def commit(self, occupancy: OccupancyMap) -> Rectangle:
        from dream.mapping._kernels import frame

        store = occupancy._store
        occupancy._stamp += 1
        rows, cols = np.nonzero(self.touched)
        store.make((self.first[0] + int(row), self.first[1] + int(col)) for row, col in zip(rows, cols, strict=True))
        table = self._table(store, self.first, self.blocks)
        changed = frame.commit(
            store.pools["log_odds"],
            store.pools["flags"],
            store.pools["votes"],
            store.stamps,
            table,
            self.touched,
            *self.offset,
            self.side,
            self.log_odds,
            self.said,
            self.votes,
            occupancy._stamp,
        )
        frame.commit_ground(
            store.pools["ground_sum"],
            store.pools["ground_count"],
            table,
            self.offset[0] >> self.bits,
            self.offset[1] >> self.bits,
            self.post_sum,
            self.post_count,
            occupancy.evidence.ground_memory,
        )
        first_row, past_row, first_col, past_col = changed
        row, col = self.low
        return row + first_row, col + first_col, row + past_row, col + past_col


_KIND = np.ones(256, np.uint8)
_KIND[Label.SEABED] = 0
_WEIGHT = np.zeros(256, np.int32)
_WEIGHT[Label.TARGET] = 16
_KIND_SOFT = np.where(np.arange(256) < 128, 2, 1).astype(np.uint8)
_WEIGHT_SOFT = np.rint(np.arange(256) / 255.0 * 16.0).astype(np.int32)


def _kind(array: npt.NDArray[Any] | None) -> str:
    return "nothing" if array is None else f"{array.shape} {array.dtype}"


def _check_frame(depth: npt.NDArray[Any], labels: npt.NDArray[Any], camera: Camera) -> None:
    for name, image in (("depth", depth), ("labels", labels)):
        if image.ndim != 2:
            raise ValueError(f"{name}: expected (height, width), got {image.shape}")
        camera.check(image, name)
    if not (np.issubdtype(depth.dtype, np.floating) or depth.dtype == np.uint16):
        raise ValueError(f"depth: expected floating-point metres or uint16 millimetres, got {depth.dtype}")
    if np.issubdtype(labels.dtype, np.floating):
        if labels.size and not (labels.min() >= 0.0 and labels.max() <= 1.0):
            raise ValueError("labels: expected probabilities in [0, 1], got others")
        return
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"labels: expected integers, values of Label, or probabilities, got {labels.dtype}")
    unsigned = np.issubdtype(labels.dtype, np.unsignedinteger)
    if labels.size and (labels.max() > max(Label) or (not unsigned and labels.min() < min(Label))):
        wrong = labels.max() if labels.max() > max(Label) else labels.min()
        raise ValueError(f"labels: expected values of Label, {min(Label):d} to {max(Label):d}, got {wrong}")
