"""What the kernels of a frame are given: the window of cells that it is read into, images, rules and scratch.

Arrays over the window are flat, `row * side + col`; lengths are metres unless something else is said.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dream.types import BoolArray, Float32Array, UInt8Array

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]


class CellWindow(NamedTuple):
    """A square of cells around the camera with the reach inside; its low corner lies on a post."""

    side: int
    """Cells along it."""
    post_bits: int
    """A post of the ground is 2 to this many cells wide."""
    row: int
    """The low corner, counted from the first of the blocks around the window and those posts."""
    col: int
    first_row: int
    """The part that lies in bounds and around what the frame may show; nothing else is written."""
    past_row: int
    first_col: int
    past_col: int
    x: float
    """The camera, cells from the low corner."""
    y: float
    west: float
    """The low corner in the world."""
    south: float
    cell: float


class Image(NamedTuple):
    """A frame's pixels."""

    depth: npt.NDArray[Any]
    """(H, W) of `unit` metres along the optical axis."""
    bits: npt.NDArray[Any]
    """(H, W) the same as unsigned integers, which are in the same order."""
    unit: float
    labels: npt.NDArray[Any]
    """(H, W), times `label_scale` an index into `kind_of`."""
    label_scale: float
    water: Any
    """What `labels` holds where there is no return."""
    kind_of: UInt8Array
    """(256,) `GROUND`, `THING` or `UNSURE`."""


class FrameView(NamedTuple):
    """The camera, where it was, and which depths count."""

    fx: float
    """Pixels, as the three that follow."""
    fy: float
    cx: float
    cy: float
    rotation: npt.NDArray[np.floating[Any]]
    """(3, 3), camera to world."""
    translation: npt.NDArray[np.floating[Any]]
    """(3,), likewise."""
    min_depth: float
    """What is not beyond is no return."""
    max_depth: float
    reach: float
    """Over ground."""
    cuts: Float32Array
    """(levels,) depths at which thinning changes, falling."""
    raw: npt.NDArray[Any]
    """(levels + 2,) `max_depth`, the cuts and `min_depth` as the image's `bits`."""


class SeabedSamples(NamedTuple):
    """What a frame's samples say of the seabed's height, by post of the window."""

    post_of: Int32Array
    """(side²) the post of every cell."""
    prior: Float64Array
    """(posts²) height before this frame."""
    prior_room: float
    """From there within which an unsure pixel is seabed."""
    total: Float64Array
    """(posts²) sum of the samples' heights."""
    points: Float64Array
    """(posts²) samples in it."""


class Samples(NamedTuple):
    """Pixels that count."""

    cells: Int32Array
    """(pixels + 1,) flat cell and label; see `pixels.LABEL_BITS`."""
    heights: Float32Array
    """(pixels + 1,) world z."""
    farthest: Float32Array
    """(RAYS,) over ground to the farthest return in that direction; nothing is claimed beyond."""


class Runs(NamedTuple):
    """Scratch of `pixels.project`."""

    lines: Float32Array
    """(6 W or more)"""
    extremes: npt.NDArray[Any]
    """(2, H W or more) of the type of the image's `bits`."""
    metric: Float32Array
    """(4 RUN)"""
    marks: Int32Array
    """(RUN)"""


class Pools(NamedTuple):
    """The map's blocks: (slots, BLOCK, BLOCK), and for the ground (slots, posts, posts)."""

    log_odds: npt.NDArray[np.int8]
    flags: UInt8Array
    votes: UInt8Array
    ground_sum: Float32Array
    ground_count: Float32Array


class Posts(NamedTuple):
    """The posts that the window's ground depends on, and how their heights are smoothed."""

    row: int
    """The first of them, counted from the first block around the window."""
    col: int
    rows: int
    cols: int
    first_row: int
    """The window's first among them."""
    first_col: int
    levels: int
    """See `evidence.smooth_ground`, as for the three that follow."""
    share: float
    trust: float
    datum: float
    grids: Float64Array
    """(levels + 1, 3, rows or more, cols or more), out."""


class WeighingRule(NamedTuple):
    """How samples are weighed; log-odds in units of `layers.QUANTUM`."""

    step: int
    """Of a hit or a miss."""
    doubt: int
    """Of a miss where what is solid was not seen to reach down."""
    lowest: int
    highest: int
    hit_pixels: int
    """Least of a hit."""
    hit_share: float
    """Their least share of the cell's."""
    peak_share: float
    """Their least share of what lies just behind."""
    miss_pixels: int
    vote_pixels: int
    vote_share: float
    """Least target share of a yes."""
    against_share: float
    """Greatest of a no."""
    noise: float
    """Standard deviation of the depth over its square, 1/m."""
    lower: float
    """Where the height band begins, above the seabed."""
    middle: float
    """Where its lower part ends."""
    upper: float
    weight_of: npt.NDArray[np.int64]
    """(256,) target weight and doubt of every label; see `flags.DOUBT_BITS`."""


class Sector(NamedTuple):
    """Where the camera looks over ground; lengths in cells."""

    first: int
    """First and last ray; beyond a full turn where it wraps, and none where last is before first."""
    last: int
    forward_x: float
    forward_y: float
    cos_half: float
    """Cosine of half its angle."""
    reach: float
    blind: float
    """What is less far ahead is not in the image."""
    level: bool
    """Whether the horizon is in the image."""


class FrameFindings(NamedTuple):
    """What a frame says."""

    log_odds: npt.NDArray[np.int8]
    """(side²) after it."""
    bits: UInt8Array
    """(side²) flags to set."""
    votes: UInt8Array
    """(side²) 1 target, 2 another thing, 0 no vote."""
    touched: BoolArray
    """(block rows, block cols) blocks of which it says something."""


class Scratch(NamedTuple):
    """Scratch of `evidence.read_frame`; (side²) each but for the last three."""

    ground: Float32Array
    counts: npt.NDArray[np.uint64]
    """See `evidence.FIELD_BITS`."""
    targets: npt.NDArray[np.int64]
    """In parts of `flags.WEIGHT`, and the doubt; see `flags.DOUBT_BITS`."""
    flags: UInt8Array
    """As they were."""
    paths: UInt8Array
    """`evidence.RAN`, `evidence.ENDED`."""
    wide: Float32Array
    """(posts along the window + 2, as many times their width)"""
    above: Float32Array
    """(n or more,) and `shifts` (n,), for n samples at a time."""
    shifts: Int32Array
