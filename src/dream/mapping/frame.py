"""One frame into the map, by way of a window of cells around the camera."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.mapping._kernels import flags
from dream.mapping._kernels.flags import BLOCK, RAYS
from dream.mapping._kernels.window import (
    CellWindow,
    FrameFindings,
    FrameView,
    Image,
    Pools,
    Posts,
    Runs,
    Samples,
    Scratch,
    SeabedSamples,
    Sector,
    WeighingRule,
)
from dream.mapping.blocks import BlockStore
from dream.mapping.layers import LEVELS, QUANTUM, Evidence, Rectangle, post_bits
from dream.protocol import SurveyProtocol
from dream.types import Float32Array, Label, UInt8Array

PIXELS_ACROSS = 4
"""Pixels that are looked at along the side of a cell that faces the camera; what is nearer is thinned."""
THINNINGS = 2
"""How often rows and columns may be halved, at most."""
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

    # All that a frame needs room for, once; a helper for each part would only pass it on.
    def __init__(self, protocol: SurveyProtocol, evidence: Evidence, pixels: int) -> None:
        """Room for frames of up to so many pixels.

        All of it is taken here: asking for memory frame by frame may mean tidying up after others.
        """
        from dream.mapping._kernels.pixels import RUN

        self.protocol = protocol
        self.evidence = evidence
        self.pixels = pixels
        self.datum = math.nan
        """World z of the seabed below the camera, as the altitude has it."""
        self._bits = post_bits(protocol)
        post = 1 << self._bits
        reach = math.ceil(protocol.reach / protocol.cell)
        # The window's low corner lies on a post; two cells are for rounding.
        self._side = side = -(-(2 * reach + 3 + post) // post) * post
        self._half = reach + 1
        self._posts = side >> self._bits
        self._first = (0, 0)
        """The first block around the window."""
        at = np.arange(side) >> self._bits
        self._seabed = SeabedSamples(
            post_of=(at[:, None] * self._posts + at[None, :]).astype(np.int32).ravel(),
            prior=np.empty(self._posts**2),
            prior_room=protocol.band[0],
            total=np.empty(self._posts**2),
            points=np.empty(self._posts**2),
        )
        self._samples = Samples(
            np.empty(pixels + 1, np.int32), np.empty(pixels + 1, np.float32), np.empty(RAYS, np.float32)
        )
        self._runs = Runs(
            np.empty(6 * pixels, np.float32),
            np.empty((2, pixels), np.uint32),
            np.empty(4 * RUN, np.float32),
            np.empty(RUN, np.int32),
        )
        self._table = np.zeros((0, 0), np.int64)
        """Slots of the blocks from there on."""
        most_posts = (-(-self._posts // (1 << LEVELS)) + 5) << LEVELS
        self._grids = np.empty((LEVELS + 1, 3, most_posts, most_posts))
        self._scratch = Scratch(
            ground=np.empty(side**2, np.float32),
            counts=np.empty(side**2, np.uint64),
            targets=np.empty(side**2, np.int64),
            flags=np.empty(side**2, np.uint8),
            paths=np.empty(side**2, np.uint8),
            wide=np.empty((self._posts + 2, side + 2 * post), np.float32),
            above=self._runs.metric,
            shifts=self._runs.marks,
        )
        self._said = FrameFindings(
            np.empty(side**2, np.int8),
            np.empty(side**2, np.uint8),
            np.empty(side**2, np.uint8),
            np.zeros((0, 0), np.bool_),
        )
        self._rule = _rule(protocol, evidence)
        bearings = (np.arange(RAYS) + 0.5) * (2.0 * math.pi / RAYS)
        self._directions = np.column_stack([np.cos(bearings), np.sin(bearings)])

    # One frame from its pixels to its findings: each kernel takes what the one before it left.
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

        protocol, (x, y, z) = self.protocol, T_world_camera.translation.tolist()
        x, y = (x - origin[0]) / protocol.cell, (y - origin[1]) / protocol.cell
        self.datum = z - protocol.altitude
        overlook = _overlook(camera, T_world_camera.rotation.tolist(), protocol.reach / protocol.cell, y, x)
        self._window = window = self._around(x, y, origin, limits, overlook)
        posts, pools = self._posts_around(window), _pools(store)
        per_block = BLOCK >> self._bits
        blocks = -(-(posts.row + posts.rows) // per_block), -(-(posts.col + posts.cols) // per_block)
        self._table = store.table(self._first, blocks)
        if self._said.touched.shape != blocks:
            self._said = self._said._replace(touched=np.zeros(blocks, np.bool_))
        soft = bool(np.issubdtype(labels.dtype, np.floating))
        if soft:
            kernels.ground_before(pools, self._table, posts, self._posts, self._seabed.prior)
        self._seabed.total[:], self._seabed.points[:] = 0.0, 0.0
        under = (int(window.y) >> self._bits) * self._posts + (int(window.x) >> self._bits)
        self._seabed.total[under], self._seabed.points[under] = self.datum, 1.0
        # Who keeps frames may guard them: the kernel is compiled for that alone.
        depth, labels = _guarded(depth), _guarded(labels)
        unit, cuts, raw = _cuts(protocol, camera, depth.dtype == np.uint16)
        count = pixels.project(
            Image(
                depth,
                depth.view(raw.dtype),
                unit,
                labels,
                255.0 if soft else 1.0,
                labels.dtype.type(-1.0 if soft else Label.WATER),
                _KIND_OF_PROBABILITY if soft else _KIND_OF_LABEL,
            ),
            FrameView(
                camera.fx,
                camera.fy,
                camera.cx,
                camera.cy,
                T_world_camera.rotation,
                T_world_camera.translation,
                *protocol.returns,
                protocol.reach,
                cuts,
                raw,
            ),
            window,
            self._seabed,
            self._samples,
            self._runs._replace(extremes=self._runs.extremes.view(raw.dtype)),
        )
        kernels.read_frame(
            pools,
            self._table,
            posts,
            window,
            self._samples,
            count,
            self._seabed,
            _sector(protocol, camera, T_world_camera),
            self._directions,
            self._rule._replace(weight_of=_WEIGHT_OF_PROBABILITY) if soft else self._rule,
            self._scratch,
            self._said,
        )

    def _around(
        self, x: float, y: float, origin: tuple[float, float], limits: Rectangle, overlook: Rectangle
    ) -> CellWindow:
        """The window for a camera at (x, y), in cells; what is written lies in both rectangles of cells."""
        side, cell = self._side, self.protocol.cell
        row, col = ((math.floor(a) - self._half) >> self._bits << self._bits for a in (y, x))
        # Its posts depend on those up to two of the coarsest away.
        coarse = 1 << LEVELS + self._bits
        self._first = (row // coarse - 2) * coarse // BLOCK, (col // coarse - 2) * coarse // BLOCK
        first_row, first_col = max(limits[0], overlook[0], row), max(limits[1], overlook[1], col)
        past_row, past_col = min(limits[2], overlook[2], row + side), min(limits[3], overlook[3], col + side)
        return CellWindow(
            side,
            self._bits,
            row - self._first[0] * BLOCK,
            col - self._first[1] * BLOCK,
            min(first_row - row, side),
            max(past_row - row, 0),
            min(first_col - col, side),
            max(past_col - col, 0),
            x - col,
            y - row,
            origin[0] + col * cell,
            origin[1] + row * cell,
            cell,
        )

    def _posts_around(self, window: CellWindow) -> Posts:
        """The posts that the window's ground depends on."""
        coarse, margin = 1 << LEVELS, 2 << LEVELS
        row, col = window.row >> self._bits, window.col >> self._bits
        low_row, low_col = row // coarse * coarse - margin, col // coarse * coarse - margin
        return Posts(
            low_row,
            low_col,
            -(-(row + self._posts) // coarse) * coarse + margin - low_row,
            -(-(col + self._posts) // coarse) * coarse + margin - low_col,
            row - low_row,
            col - low_col,
            LEVELS,
            self.evidence.ground_share,
            self.evidence.ground_pixels,
            self.datum,
            self._grids,
        )

    def commit(self, store: BlockStore, stamp: int) -> None:
        """Write what was read."""
        from dream.mapping._kernels import evidence as kernels

        missing = self._said.touched & (self._table == 0)
        if missing.any():
            row, col = self._first
            store.make((row + i, col + j) for i, j in np.argwhere(missing).tolist())
            self._table = store.table(self._first, missing.shape)
        kernels.commit(
            _pools(store),
            store.stamps,
            self._table,
            self._window,
            self._said,
            self._seabed,
            stamp,
            self.evidence.ground_memory,
        )


def _pools(store: BlockStore) -> Pools:
    return Pools(*(store.pools[name] for name in Pools._fields))


def _rule(protocol: SurveyProtocol, evidence: Evidence) -> WeighingRule:
    low, high = evidence.clamp
    lower, upper = protocol.band
    return WeighingRule(
        step=round(evidence.step / QUANTUM),
        doubt=round(evidence.doubt / QUANTUM),
        lowest=math.ceil(low / QUANTUM - 1e-9),
        highest=math.floor(high / QUANTUM + 1e-9),
        hit_pixels=evidence.min_pixels,
        hit_share=evidence.min_share,
        peak_share=evidence.peak_share,
        miss_pixels=evidence.min_ground,
        vote_pixels=evidence.vote_pixels,
        vote_share=evidence.vote_share,
        against_share=evidence.against_share,
        noise=evidence.range_noise,
        lower=lower,
        middle=lower + LOWER_PART * (upper - lower),
        upper=upper,
        weight_of=_WEIGHT_OF_LABEL,
    )


def _sector(protocol: SurveyProtocol, camera: Camera, T_world_camera: SE3) -> Sector:
    forward = T_world_camera.rotation[:, 2].tolist()
    level_part = math.hypot(forward[0], forward[1])
    if level_part < 0.1:  # Looking straight down there is no sector; the direct returns are all.
        return Sector(0, -1, 0.0, 0.0, -1.0, 0.0, 0.0, False)
    pitch = math.atan2(-forward[2], level_part)
    left, right = _sides(camera)
    yaw, half = math.atan2(forward[1], forward[0]) + 0.5 * (left + right), 0.5 * camera.horizontal_fov
    steepest = math.atan((camera.height - camera.cy) / camera.fy) + pitch
    if steepest <= 0.0:  # All of the image is above the horizon.
        blind = math.inf
    else:
        blind = protocol.altitude / math.tan(steepest) if steepest < 0.5 * math.pi else 0.0
    per_radian, per_metre = RAYS / (2.0 * math.pi), 1.0 / protocol.cell
    return Sector(
        math.floor((yaw - half) * per_radian) - 1,
        math.floor((yaw + half) * per_radian) + 1,
        math.cos(yaw),
        math.sin(yaw),
        math.cos(half),
        protocol.reach * per_metre,
        blind * per_metre,
        math.atan(camera.cy / camera.fy) >= pitch,
    )


def _guarded(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The same values, not to be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


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
