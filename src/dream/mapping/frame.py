"""One frame into the map, by way of a window of cells around the camera."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.mapping._kernels import flags
from dream.mapping.blocks import BlockStore
from dream.mapping.layers import BLOCK, LEVELS, QUANTUM, Evidence, Rectangle, post_bits
from dream.mapping.visibility import RAYS
from dream.protocol import SurveyProtocol
from dream.types import Float32Array, IntArray, Label, UInt8Array

PIXELS_ACROSS = 4
"""Pixels that are looked at along the side of a cell that faces the camera; what is nearer is thinned."""
THINNINGS = 2
"""How often rows and columns may be halved, at most."""
MOST_TABLES = 8
MARGIN = 2
"""Cells around what a camera can see."""
LOWER_PART = 0.25
"""Share of the height band that is its lower part."""
LABEL_BITS = 2
"""Of a pixel's byte: its label. What is not sure about it is in the bits above."""


class FrameWindow:
    """What one frame says, over a window of cells around the camera; and room to work it out in.

    What it does: `read` leaves the map as it is, `commit` writes what was read. docs/map.md has the rule.
    """

    def __init__(self, protocol: SurveyProtocol, evidence: Evidence, pixels: int) -> None:
        """Room for frames of up to so many pixels.

        All of it is taken here: asking for memory frame by frame may mean tidying up after others.
        """
        from dream.mapping._kernels.pixels import RUN

        self.protocol = protocol
        self.evidence = evidence
        self.pixels = pixels
        self.datum = math.nan
        self._bits = post_bits(protocol)
        post = 1 << self._bits
        reach = math.ceil(protocol.reach / protocol.cell)
        # The window's low corner lies on a post; two cells are for rounding.
        self._side = -(-(2 * reach + 3 + post) // post) * post
        self._half = reach + 1
        self._posts = self._side >> self._bits
        cells = self._side**2
        at = np.arange(self._side) >> self._bits
        self._post_of = (at[:, None] * self._posts + at[None, :]).astype(np.int32).ravel()
        self._samples = np.empty(pixels + 1, np.int32)
        self._heights = np.empty(pixels + 1, np.float32)
        self._farthest = np.empty(RAYS, np.float32)
        self._post_sum, self._post_count = np.empty(self._posts**2), np.empty(self._posts**2)
        self._prior = np.empty(self._posts**2)
        self._row_scratch = (
            np.empty(6 * pixels, np.float32),
            np.empty(4 * RUN, np.float32),
            np.empty(RUN, np.int32),
        )
        self._extremes = np.empty((2, pixels), np.uint32)
        most_posts = (-(-self._posts // (1 << LEVELS)) + 5) << LEVELS
        self._scratch = (
            np.empty(cells, np.float32),
            np.empty(cells, np.uint64),
            np.empty(cells, np.int64),
            np.empty(cells, np.uint8),
            np.empty(cells, np.uint8),
            np.empty((LEVELS + 1, 3, most_posts, most_posts)),
            np.empty((self._posts + 2, self._side + 2 * post), np.float32),
        )
        self._said = (np.empty(cells, np.int8), np.empty(cells, np.uint8), np.empty(cells, np.uint8))
        self._touched = np.zeros((0, 0), np.bool_)
        self._outline = (0, 0, 0, 0, 0)
        self._low = (0, 0)
        self._clip = (0, 0, 0, 0)
        bearings = (np.arange(RAYS) + 0.5) * (2.0 * math.pi / RAYS)
        self._directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
        low, high = evidence.clamp
        lower, upper = protocol.band
        self._band = (lower, lower + LOWER_PART * (upper - lower), upper)
        self._rule = (
            (round(evidence.step / QUANTUM), round(evidence.doubt / QUANTUM)),
            (math.ceil(low / QUANTUM - 1e-9), math.floor(high / QUANTUM + 1e-9)),
            (
                evidence.min_pixels,
                evidence.min_share,
                evidence.peak_share,
                evidence.min_ground,
                evidence.vote_pixels,
                evidence.vote_share,
                evidence.against_share,
            ),
            evidence.range_noise,
        )
        self._tables: dict[tuple[int, ...], tuple[int, IntArray]] = {}

    def read(
        self,
        store: BlockStore,
        origin: tuple[float, float],
        limits: Rectangle,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
    ) -> None:
        """Work out what a frame says.

        Args:
            store: The map's cells; only read.
            origin: World x and y of the corner where the store's cell (0, 0) begins.
            limits: Cells in bounds.
            depth, labels, camera, T_world_camera: See `OccupancyMap.integrate`; checked.
        """
        from dream.mapping._kernels import evidence as kernels
        from dream.mapping._kernels import pixels

        protocol, evidence, side = self.protocol, self.evidence, self._side
        cell, t = protocol.cell, T_world_camera.translation
        x, y = (float(t[0]) - origin[0]) / cell, (float(t[1]) - origin[1]) / cell
        row, col = math.floor(y), math.floor(x)
        low = tuple((a - self._half) >> self._bits << self._bits for a in (row, col))
        self._low = (low[0], low[1])
        rotation = T_world_camera.rotation.tolist()
        box = _overlook(camera, rotation, protocol.reach / cell, y, x)
        first_row, first_col, past_row, past_col = limits
        self._clip = (
            min(max(first_row, box[0], low[0]) - low[0], side),
            max(min(past_row, box[2], low[0] + side) - low[0], 0),
            min(max(first_col, box[1], low[1]) - low[1], side),
            max(min(past_col, box[3], low[1] + side) - low[1], 0),
        )
        self.datum = float(t[2]) - protocol.altitude

        # ---- which posts the window's ground depends on
        coarse, per_block = 1 << LEVELS, BLOCK >> self._bits
        first = [a >> self._bits for a in low]
        wide = [(a // coarse - 2) * coarse for a in first]
        shape = [(-(-(a + self._posts) // coarse) + 2) * coarse - b for a, b in zip(first, wide, strict=True)]
        post_table = self._table(
            store,
            [a // per_block for a in wide],
            [(a % per_block + n - 1) // per_block + 1 for a, n in zip(wide, shape, strict=True)],
        )
        post_window = (*shape, first[0] - wide[0], first[1] - wide[1])
        ground_rule = (LEVELS, evidence.ground_share, evidence.ground_pixels, self.datum)
        pools = store.pools

        soft = bool(np.issubdtype(labels.dtype, np.floating))
        if soft:
            kernels.ground_before(
                pools["ground_sum"],
                pools["ground_count"],
                post_table,
                wide[0] % per_block,
                wide[1] % per_block,
                post_window,
                ground_rule,
                self._posts,
                self._scratch[5],
                self._prior,
            )
        self._post_sum[:], self._post_count[:] = 0.0, 0.0
        under = ((row - low[0]) >> self._bits) * self._posts + ((col - low[1]) >> self._bits)
        self._post_sum[under], self._post_count[under] = self.datum, 1.0
        unit, cuts, raw = _cuts(protocol, camera, depth.dtype == np.uint16)
        lines, metric, marks = self._row_scratch
        count = pixels.project(
            depth,
            depth.view(raw.dtype),
            unit,
            labels,
            255.0 if soft else 1.0,
            labels.dtype.type(-1.0 if soft else Label.WATER),
            _KIND_OF_PROBABILITY if soft else _KIND_OF_LABEL,
            (camera.fx, camera.fy, camera.cx, camera.cy),
            T_world_camera.rotation,
            t,
            (origin[0] + low[1] * cell, origin[1] + low[0] * cell),
            cell,
            (*protocol.returns, protocol.reach),
            cuts,
            raw,
            side,
            self._clip,
            self._post_of,
            self._prior,
            protocol.band[0],
            self._samples,
            self._heights,
            self._post_sum,
            self._post_count,
            self._farthest,
            (lines, self._extremes.view(raw.dtype), metric, marks),
        )
        offset = (low[0] % BLOCK, low[1] % BLOCK)
        blocks = [(a + side - 1) // BLOCK + 1 for a in offset]
        if self._touched.shape != tuple(blocks):
            self._touched = np.zeros(blocks, np.bool_)
        self._outline = kernels.read_frame(
            (pools["log_odds"], pools["flags"], pools["ground_sum"], pools["ground_count"]),
            (self._table(store, [a // BLOCK for a in low], blocks), post_table),
            (*offset, wide[0] % per_block, wide[1] % per_block),
            post_window,
            ground_rule,
            self._samples,
            self._heights,
            count,
            self._post_sum,
            self._post_count,
            side,
            self._bits,
            self._band,
            _WEIGHT_OF_PROBABILITY if soft else _WEIGHT_OF_LABEL,
            (x - low[1], y - low[0]),
            cell,
            self._rule,
            self._sector(camera, rotation),
            self._farthest,
            self._directions,
            self._clip,
            (*self._scratch, metric, marks),
            (*self._said, self._touched),
        )

    def _sector(
        self, camera: Camera, rotation: list[list[float]]
    ) -> tuple[int, int, float, float, float, float, float, bool]:
        """First and last ray, forward direction, half angle's cosine, reach, blind distance, level seen?"""
        protocol, forward = self.protocol, [row[2] for row in rotation]
        level_part = math.hypot(forward[0], forward[1])
        if level_part < 0.1:  # Looking straight down there is no sector; the direct returns are all.
            return 0, -1, 0.0, 0.0, -1.0, 0.0, 0.0, False
        pitch = math.atan2(-forward[2], level_part)
        left, right = _sides(camera)
        yaw, half = math.atan2(forward[1], forward[0]) + 0.5 * (left + right), 0.5 * camera.horizontal_fov
        steepest = math.atan((camera.height - camera.cy) / camera.fy) + pitch
        if steepest <= 0.0:  # All of the image is above the horizon.
            blind = math.inf
        else:
            blind = protocol.altitude / math.tan(steepest) if steepest < 0.5 * math.pi else 0.0
        per_radian, per_metre = RAYS / (2.0 * math.pi), 1.0 / protocol.cell
        return (
            math.floor((yaw - half) * per_radian) - 1,
            math.floor((yaw + half) * per_radian) + 1,
            math.cos(yaw),
            math.sin(yaw),
            math.cos(half),
            protocol.reach * per_metre,
            blind * per_metre,
            math.atan(camera.cy / camera.fy) >= pitch,
        )

    def _table(self, store: BlockStore, low: list[int], shape: list[int]) -> IntArray:
        """`BlockStore.table`; mostly it is the same as before."""
        key = (*low, *shape)
        known = self._tables.get(key)
        if known is None or known[0] != len(store):
            if len(self._tables) >= MOST_TABLES:
                self._tables = {}
            known = self._tables[key] = (len(store), store.table(low, shape))
        return known[1]

    @property
    def blocks(self) -> tuple[tuple[int, int], tuple[int, int]] | None:
        """First of the blocks of which the frame says something, and past the last; None without any."""
        first_row, past_row, first_col, past_col, _ = self._outline
        if first_row >= past_row:
            return None
        row, col = (a // BLOCK for a in self._low)
        return (row + first_row, col + first_col), (row + past_row, col + past_col)

    def commit(self, store: BlockStore, stamp: int) -> None:
        """Write what was read."""
        from dream.mapping._kernels import evidence as kernels

        low = self._low
        first = [a // BLOCK for a in low]
        if self._outline[-1] > 0:
            missing = self._touched & (self._table(store, first, list(self._touched.shape)) == 0)
            store.make((first[0] + int(i), first[1] + int(j)) for i, j in np.argwhere(missing))
        pools = store.pools
        kernels.commit(
            (pools["log_odds"], pools["flags"], pools["votes"], pools["ground_sum"], pools["ground_count"]),
            store.stamps,
            self._table(store, first, list(self._touched.shape)),
            low[0] % BLOCK,
            low[1] % BLOCK,
            self._side,
            self._clip,
            (*self._said, self._touched),
            stamp,
            self._bits,
            self._post_sum,
            self._post_count,
            self.evidence.ground_memory,
        )


@lru_cache(maxsize=8)
def _cuts(
    protocol: SurveyProtocol, camera: Camera, millimetres: bool
) -> tuple[float, Float32Array, npt.NDArray[Any]]:
    """Metres that depths are in, the depths at which thinning changes, and these with both limits as bits.

    As bits, positive floats are in order, and their extremes are found faster.
    """
    unit, kind, bits = (0.001, np.uint16, np.uint16) if millimetres else (1.0, np.float32, np.uint32)
    thin = protocol.cell * min(camera.fx, camera.fy) / PIXELS_ACROSS
    cuts = np.array([thin / (2 << k) for k in range(THINNINGS)], np.float32)
    limits = np.array([protocol.max_depth, *cuts, protocol.min_depth]) / unit
    if millimetres:
        limits = np.minimum(limits, np.iinfo(np.uint16).max)
    return unit, cuts, limits.astype(kind).view(bits)


@lru_cache(maxsize=8)
def _sides(camera: Camera) -> tuple[float, float]:
    """Bearings of the left and the right side of a level image."""
    return math.atan(camera.cx / camera.fx), -math.atan((camera.width - camera.cx) / camera.fx)


def _overlook(camera: Camera, rotation: list[list[float]], reach: float, row: float, col: float) -> Rectangle:
    """The cells around all that a camera can see within its reach, and two more; lengths in cells.

    Seen from above, what is farthest to the left or right in an image is one of its corners, unless it shows
    what is straight below or above.
    """
    (xx, xy, xz), (yx, yy, yz), _ = rotation
    bearings = [*_sides(camera)]  # The sector does not roll.
    for a in (-camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx):
        for b in (-camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy):
            x, y = xx * a + xy * b + xz, yx * a + yy * b + yz
            bearings.append(math.atan2(xz * y - yz * x, xz * x + yz * y))
    yaw, quarter = math.atan2(yz, xz), 0.5 * math.pi
    first, last = min(bearings), max(bearings)
    if max(-first, last) >= quarter - 1e-6:
        first, last = -math.pi, math.pi
    turns = [
        k * quarter for k in range(math.ceil((yaw + first) / quarter), math.floor((yaw + last) / quarter) + 1)
    ]
    turns += (yaw + first, yaw + last)
    rows = [row, *(row + reach * math.sin(turn) for turn in turns)]
    cols = [col, *(col + reach * math.cos(turn) for turn in turns)]
    return (
        math.floor(min(rows)) - MARGIN,
        math.floor(min(cols)) - MARGIN,
        math.floor(max(rows)) + 1 + MARGIN,
        math.floor(max(cols)) + 1 + MARGIN,
    )


def unsure(labels: UInt8Array, confidence: Float32Array) -> UInt8Array:
    """(H, W) labels, and in the bits above what is not sure about them, in sixteenths.

    What is not even half a sixteenth sure is water: no return.
    """
    trust = np.rint(confidence * flags.WEIGHT).astype(np.uint8)
    gone = (labels == Label.WATER) | (trust == 0)
    return np.where(gone, np.uint8(Label.WATER), labels | (flags.WEIGHT - trust) << LABEL_BITS).astype(
        np.uint8
    )


def _kinds_of_labels() -> tuple[UInt8Array, npt.NDArray[np.int64]]:
    """(256,) what a label is, and what it weighs, for every label with its doubt."""
    doubt, label = np.divmod(np.arange(256), 1 << LABEL_BITS)
    # Seabed that is likelier not there tells nothing of the seabed's height.
    ground = (label == Label.SEABED) & (2 * doubt <= flags.WEIGHT)
    target = np.where(label == Label.TARGET, np.maximum(flags.WEIGHT - doubt, 0), 0)
    weight = target + (doubt << flags.DOUBT_BITS)
    return np.where(ground, flags.GROUND, flags.THING).astype(np.uint8), weight.astype(np.int64)


_KIND_OF_LABEL, _WEIGHT_OF_LABEL = _kinds_of_labels()
_KIND_OF_PROBABILITY = np.where(np.arange(256) < 128, flags.UNSURE, flags.THING).astype(np.uint8)
_WEIGHT_OF_PROBABILITY = np.rint(np.arange(256) / 255.0 * 16.0).astype(np.int64)
