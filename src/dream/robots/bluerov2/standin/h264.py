"""The smallest honest H.264 encoder: every picture whole, every macroblock as it is.

Reference: Rec. ITU-T H.264 (08/2021), clauses 7.3 (syntax), 7.4.1 (emulation prevention), 9.1 (Exp-Golomb
codes), Annex A (profiles and levels), Annex E (VUI). Constrained baseline profile, IDR pictures of one slice,
I_PCM macroblocks, in-loop filter off: what a decoder shows is what went in, bit for bit.

The price is its rate, 1.5 bytes a pixel: 37 Mbit/s for 640 × 480 at 10 Hz, which level 4.1 allows.
"""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np
import numpy.typing as npt

UInt8Array = npt.NDArray[np.uint8]

BLOCK = 16
"""Pixels along a macroblock."""
_BASELINE = 66
_CONSTRAINED = 0xC0
_LEVEL = 41
_MOST_BLOCKS = 8192
"""Macroblocks of a picture at level 4.1 (table A-1)."""
_SPS, _PPS, _IDR = 0x67, 0x68, 0x65
"""First byte of a unit: nal_ref_idc 3 and the type, 7, 8 and 5."""
_I_PCM = 25
_I_SLICES = 7
_BT601 = 6
_FORGED = re.compile(rb"\x00\x00(?=[\x00-\x03])")


def yuv420(rgb: UInt8Array) -> UInt8Array:
    """A picture as H.264 carries it: BT.601, 16 to 235, a colour for each 2 × 2 pixels.

    Args:
        rgb: (H, W, 3) uint8, both sides even.

    Returns:
        (3 H / 2, W) uint8: the rows of Y, then those of U and of V, W / 2 long and two to a row.
    """
    import cv2

    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or rgb.shape[0] % 2 or rgb.shape[1] % 2:
        raise ValueError(f"rgb: expected (H, W, 3) uint8 with even sides, got {rgb.shape} {rgb.dtype}")
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420), np.uint8)


def encode(yuv: UInt8Array, number: int, fps: float = 10.0) -> list[bytes]:
    """The NAL units of one picture: sequence and picture parameters, then the slice.

    Args:
        yuv: As `yuv420` gives it.
        number: Of the picture. Two IDR pictures in a row must not share their idr_pic_id.
        fps: Pictures a second, for the timing information.
    """
    height, width = yuv.shape[0] * 2 // 3, yuv.shape[1]
    if yuv.dtype != np.uint8 or yuv.shape[0] % 3 or height % 2 or width % 2 or not yuv.size:
        raise ValueError(f"yuv: expected (3 H / 2, W) uint8 with even H and W, got {yuv.shape} {yuv.dtype}")
    rows, cols = -(-height // BLOCK), -(-width // BLOCK)
    if rows * cols > _MOST_BLOCKS:
        raise ValueError(f"yuv: expected at most {_MOST_BLOCKS} macroblocks, got {rows * cols}")
    head = _slice_header(number % 2)
    # Each block after the first begins on a byte: mb_type and alignment are the bytes 0D 00.
    blocks = np.empty((rows, cols, 2 + 384), np.uint8)
    blocks[..., 0], blocks[..., 1] = 0x0D, 0x00
    chroma = yuv[height:].reshape(2, height // 2, width // 2)
    blocks[..., 2:258] = _tiles(yuv[:height], rows, cols, BLOCK)
    blocks[..., 258:322] = _tiles(chroma[0], rows, cols, BLOCK // 2)
    blocks[..., 322:] = _tiles(chroma[1], rows, cols, BLOCK // 2)
    slice_unit = bytes([_IDR]) + escaped(head + blocks.reshape(-1)[2:].tobytes() + b"\x80")
    return [_sequence(width, height, round(fps * 1000)), _picture(), slice_unit]


def escaped(rbsp: bytes) -> bytes:
    """With an 03 wherever three bytes would read as a start code or an escape (clause 7.4.1)."""
    return _FORGED.sub(b"\x00\x00\x03", rbsp)


def _tiles(plane: UInt8Array, rows: int, cols: int, side: int) -> UInt8Array:
    """(rows, cols, side²): the plane in blocks; its edge is repeated where it ends within one."""
    below, right = rows * side - plane.shape[0], cols * side - plane.shape[1]
    if below or right:
        plane = np.pad(plane, ((0, below), (0, right)), mode="edge")
    return plane.reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, side * side)


class _Bits:
    """Writes the syntax elements of a header."""

    def __init__(self) -> None:
        self._text = ""

    def u(self, *values: int, width: int = 1) -> None:
        """Each in `width` bits."""
        self._text += "".join(format(value, f"0{width}b") for value in values)

    def ue(self, *values: int) -> None:
        """Each as an unsigned Exp-Golomb code."""
        for value in values:
            code = format(value + 1, "b")
            self._text += "0" * (len(code) - 1) + code

    def aligned(self) -> bytes:
        """Filled up with zeros."""
        text = self._text + "0" * (-len(self._text) % 8)
        return int(text, 2).to_bytes(len(text) // 8, "big")

    def ended(self) -> bytes:
        """Closed by a one, as a unit is."""
        self.u(1)
        return self.aligned()


@lru_cache(maxsize=8)
def _sequence(width: int, height: int, fps_thousandths: int) -> bytes:
    bits = _Bits()
    bits.u(_BASELINE, _CONSTRAINED, _LEVEL, width=8)
    # seq_parameter_set_id, log2_max_frame_num − 4, pic_order_cnt_type 2 (as decoded), one reference frame.
    bits.ue(0, 0, 2, 1)
    bits.u(0)
    bits.ue(-(-width // BLOCK) - 1, -(-height // BLOCK) - 1)
    bits.u(1, 1)  # frame_mbs_only, direct_8x8_inference
    right, bottom = -width % BLOCK // 2, -height % BLOCK // 2
    bits.u(int(right > 0 or bottom > 0))
    if right or bottom:
        bits.ue(0, right, 0, bottom)
    bits.u(1)  # VUI follows
    bits.u(0, 0, 1)  # no aspect ratio, no overscan, but the kind of signal
    bits.u(5, width=3)
    bits.u(0, 1)  # 16 to 235, colours described
    bits.u(_BT601, _BT601, _BT601, width=8)
    bits.u(0, 1)  # no chroma location, but timing: two ticks a frame
    bits.u(1000, 2 * fps_thousandths, width=32)
    bits.u(1, 0, 0, 0)  # fixed rate, no HRD, no picture structure
    # Nothing is reordered, so that a decoder shows each picture at once.
    bits.u(1, 1)
    bits.ue(0, 0, 16, 16, 0, 1)
    return bytes([_SPS]) + escaped(bits.ended())


@lru_cache(maxsize=1)
def _picture() -> bytes:
    bits = _Bits()
    bits.ue(0, 0)  # ids
    bits.u(0, 0)  # CAVLC
    bits.ue(0, 0, 0)  # one slice group, one reference each way
    bits.u(0, 0, 0)  # no weighted prediction
    bits.ue(0, 0, 0)  # QP and its offsets: se(0) is ue(0)
    bits.u(1, 0, 0)  # the slice says how it is filtered
    return bytes([_PPS]) + escaped(bits.ended())


def _slice_header(idr_id: int) -> bytes:
    """Up to and with mb_type and alignment of the first macroblock."""
    bits = _Bits()
    bits.ue(0, _I_SLICES, 0)
    bits.u(0, width=4)  # frame_num
    bits.ue(idr_id)
    bits.u(0, 0)  # no_output_of_prior_pics, long_term_reference
    bits.ue(0, 1)  # slice_qp_delta 0, in-loop filter off
    bits.ue(_I_PCM)
    return bits.aligned()
