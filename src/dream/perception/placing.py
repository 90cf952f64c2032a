"""Pictures into a network's input, and maps of the network's output back onto the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.perception.sidecar import Sidecar
from dream.types import Float32Array, UInt8Array

GREY = 114
"""Around a picture that keeps its proportions; what Ultralytics trains with."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Where a picture lies in a network's input."""

    height: int
    width: int
    rows: tuple[float, float]
    """First row and number of rows, in pixels of the input."""
    cols: tuple[float, float]


def placed(shape: tuple[int, ...], height: int, width: int, *, letterbox: bool) -> Frame:
    """A picture of (H, W) in an input of that size: stretched, or in its middle with its proportions."""
    if not letterbox:
        return Frame(height, width, (0.0, float(height)), (0.0, float(width)))
    factor = min(height / shape[0], width / shape[1])
    rows, cols = max(1, round(shape[0] * factor)), max(1, round(shape[1] * factor))
    return Frame(height, width, (float((height - rows) // 2), rows), (float((width - cols) // 2), cols))


def picture(
    rgb: UInt8Array, frame: Frame, sidecar: Sidecar, kind: np.dtype[Any] | None = None
) -> npt.NDArray[Any]:
    """(1, 3, h, w), or (1, h, w, 3): a picture as the network wants it.

    Args:
        rgb: (H, W, 3) uint8.
        frame: Where it lies in the input.
        sidecar: How it wants it.
        kind: Of the input; float32 unless given. Into bytes go the bytes of the picture.
    """
    from PIL import Image

    size = (round(frame.cols[1]), round(frame.rows[1]))
    small = np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BILINEAR))
    whole = np.full((frame.height, frame.width, 3), GREY, np.uint8)
    row, col = int(frame.rows[0]), int(frame.cols[0])
    whole[row : row + size[1], col : col + size[0]] = small
    if sidecar.colours == "BGR":
        whole = whole[..., ::-1]
    if kind == np.uint8:
        x: npt.NDArray[Any] = whole
    else:
        x = (whole * np.float32(sidecar.scale) - np.array(sidecar.mean, np.float32)) / np.array(
            sidecar.std, np.float32
        )
    if sidecar.layout == "NCHW":
        x = x.transpose(2, 0, 1)
    return np.ascontiguousarray(x[None], np.uint8 if kind == np.uint8 else np.float32)


def resampled(maps: Float32Array, frame: Frame, shape: tuple[int, ...]) -> Float32Array:
    """(C, H, W): maps (C, h, w) over the whole input, bilinear at the picture's own pixels.

    What is not finite spoils the pixels that lie between it and its neighbours, and no others.
    """
    out = maps
    for axis, at in enumerate(_places(maps, frame, shape), 1):
        low = at.astype(np.intp)
        share = (at - low).astype(np.float32)
        # Nothing of a cell counts where its share is 0, not even a NaN.
        upper = np.minimum(low + (share > 0.0), maps.shape[axis] - 1)
        share = share.reshape((-1, 1) if axis == 1 else (1, -1))
        with np.errstate(over="ignore", invalid="ignore"):
            out = out.take(low, axis) * (1.0 - share) + out.take(upper, axis) * share
    return out


def nearest(maps: Float32Array, frame: Frame, shape: tuple[int, ...]) -> Float32Array:
    """(C, H, W): likewise, of whole numbers, between which nothing lies."""
    rows, cols = (np.rint(at).astype(np.intp) for at in _places(maps, frame, shape))
    return maps[:, rows[:, None], cols[None, :]]


def _places(maps: Float32Array, frame: Frame, shape: tuple[int, ...]) -> list[npt.NDArray[np.float64]]:
    """Row and column of the maps, in cells, of the middles of the picture's rows and columns."""
    places = []
    for axis, (side, (first, length), count) in enumerate(
        zip((frame.height, frame.width), (frame.rows, frame.cols), shape[:2], strict=True), 1
    ):
        cells = maps.shape[axis]
        at = (first + (np.arange(count) + 0.5) * length / count) * cells / side - 0.5
        places.append(np.clip(at, 0.0, cells - 1.0))
    return places
