"""What the decoder of OpenCV shows is what the encoder was given."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.robots.bluerov2.standin import h264
from dream.robots.bluerov2.standin.h264 import UInt8Array, encode, escaped, yuv420

START = b"\x00\x00\x00\x01"


def coarse(rng: np.random.Generator, height: int, width: int) -> UInt8Array:
    """A picture whose colour changes every second pixel only, so that 4:2:0 loses nothing of it."""
    small = rng.integers(0, 256, (height // 2, width // 2, 3), dtype=np.uint8)
    return small.repeat(2, axis=0).repeat(2, axis=1)


def as_yuv(rgb: UInt8Array) -> np.ndarray:
    """Rec. ITU-R BT.601 with 8 bits, 16 to 235, of each pixel: (H, W, 3)."""
    matrix = np.array([[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]])
    return np.asarray(rgb / 255.0 @ matrix.T + [16.0, 128.0, 128.0])


def as_rgb(yuv: np.ndarray) -> np.ndarray:
    """The way back."""
    matrix = np.array([[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]])
    return np.clip((yuv - [16.0, 128.0, 128.0]) @ np.linalg.inv(matrix).T * 255.0, 0.0, 255.0)


def decoded(path: Path, pictures: list[UInt8Array], *, luma: bool = False) -> list[UInt8Array]:
    path.write_bytes(b"".join(START + unit for k, yuv in enumerate(pictures) for unit in encode(yuv, k)))
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if luma:
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    shown: list[UInt8Array] = []
    while True:
        good, picture = capture.read()
        if not good:
            capture.release()
            return shown
        shown.append(np.asarray(picture, np.uint8))


@pytest.mark.parametrize(("height", "width"), [(48, 64), (480, 640), (50, 70), (16, 16)])
def test_brightness_comes_out_bit_for_bit(tmp_path: Path, height: int, width: int) -> None:
    rng = np.random.default_rng(0)
    given = [rng.integers(16, 236, (height * 3 // 2, width), dtype=np.uint8) for _ in range(3)]
    shown = decoded(tmp_path / "film.h264", given, luma=True)
    assert len(shown) == 3
    for yuv, luma in zip(given, shown, strict=True):
        assert np.array_equal(luma.reshape(height, width), yuv[:height])


def test_colours_come_out_as_they_went_in(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    pictures = [coarse(rng, 50, 70) for _ in range(3)]
    shown = decoded(tmp_path / "film.h264", [yuv420(rgb) for rgb in pictures])
    assert len(shown) == 3
    for rgb, bgr in zip(pictures, shown, strict=True):
        want = as_rgb(np.round(as_yuv(rgb)))
        assert np.abs(bgr[..., ::-1] - want).max() <= 4.0


def test_the_conversion_is_bt_601() -> None:
    rgb = coarse(np.random.default_rng(2), 30, 20)
    yuv, want = yuv420(rgb), as_yuv(rgb)
    assert np.abs(yuv[:30] - want[..., 0]).max() <= 1.0
    chroma = yuv[30:].reshape(2, 15, 10)
    assert np.abs(chroma[0] - want[::2, ::2, 1]).max() <= 1.0
    assert np.abs(chroma[1] - want[::2, ::2, 2]).max() <= 1.0
    assert yuv.min() >= 16


def test_black_that_reads_as_a_start_code_comes_out_too(tmp_path: Path) -> None:
    """Below 16 nothing is a colour, but a plane of zeros is where escapes matter."""
    black = np.zeros((48 * 3 // 2, 64), np.uint8)
    stripes = black.copy()
    stripes[::3] = 1
    shown = decoded(tmp_path / "film.h264", [black, stripes, black], luma=True)
    assert [int(picture.max()) for picture in shown] == [0, 1, 0]
    assert np.array_equal(shown[1].reshape(48, 64), stripes[:48])


@given(st.lists(st.sampled_from([0, 0, 0, 1, 2, 3, 4, 255]), max_size=40).map(bytes))
def test_nothing_in_a_unit_reads_as_a_start_code(raw: bytes) -> None:
    safe = escaped(raw)
    assert re.search(rb"\x00\x00[\x00-\x02]", safe) is None
    assert re.search(rb"\x00\x00\x03[^\x00-\x03]", safe) is None or b"\x00\x00\x03" in raw
    assert _unescaped(safe) == raw


def _unescaped(safe: bytes) -> bytes:
    """What a decoder does (clause 7.3.1), byte by byte."""
    raw, zeros = bytearray(), 0
    for index, byte in enumerate(safe):
        if zeros >= 2 and byte == 3 and index + 1 < len(safe):
            zeros = 0
            continue
        raw.append(byte)
        zeros = zeros + 1 if byte == 0 else 0
    return bytes(raw)


def test_two_pictures_in_a_row_have_different_ids() -> None:
    yuv = np.full((24, 16), 100, np.uint8)
    first, second, third = (encode(yuv, k)[2] for k in range(3))
    assert first != second
    assert first == third


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((24, 15), "even"),
        ((25, 16), "even"),
        ((0, 16), "even"),
        ((3 * 2048, 4096), "at most 8192 macroblocks"),
    ],
)
def test_what_cannot_be_encoded_is_refused(shape: tuple[int, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        encode(np.zeros(shape, np.uint8), 0)


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="even sides"):
        yuv420(np.zeros((5, 4, 3), np.uint8))
    with pytest.raises(ValueError, match="uint8"):
        h264.yuv420(np.zeros((4, 4, 3), np.float32))
