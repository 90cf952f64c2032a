"""Every `.npz` and `.npy` of the package goes through one reader, which believes nothing."""

from __future__ import annotations

import io
import re
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import dream
from dream import arrays
from dream.geometry import SE3, Bounds, Camera
from dream.learning import rollouts
from dream.learning.expert import TURNS
from dream.mapping import OccupancyMap
from dream.mapping.prior import Prior
from dream.perception.representation import HEIGHT, WIDTH
from dream.protocol import protocol_named
from dream.robots import replay
from dream.sim.formats import read_heights
from dream.survey import files
from dream.types import Observation
from tests.survey.scenes import reef

ABOUT = {"sigma": 0.1, "years": 1.0, "source": "an earlier survey"}
AREA = Bounds(0.0, 0.0, 2.0, 1.0)


def npy(array: npt.ArrayLike) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(array))
    return buffer.getvalue()


def headed(text: str, values: bytes = b"") -> bytes:
    """An `.npy` file with a header of one's own."""
    line = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(line)) + line + values


def says(descr: str = "'<f4'", shape: str = "(3, 4)", order: str = "False") -> str:
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"


# ---- the readers of the package, each with a small file that it takes


def a_move(path: Path) -> None:
    camera = Camera(8, 6, 5.0, 5.0, 3.5, 2.5)
    pose = SE3(np.eye(3), np.zeros(3))
    rgb, depth = np.zeros((6, 8, 3), np.uint8), np.ones((6, 8), np.float32)
    seen = Observation(0.0, rgb, depth, np.zeros((6, 8), np.uint8), camera, pose, pose)
    replay.write(path, replay.Kept(None, seen))


def a_prior(path: Path) -> None:
    Prior(AREA, 0.5, np.full((2, 4), 0.5, np.float32), np.zeros((2, 4), np.bool_)).save(path)


def a_lesson(path: Path) -> None:
    shape = (3, 2, HEIGHT, WIDTH)
    odds = np.zeros((3, len(TURNS)), np.float32)
    rollouts.write(path, rollouts.Frames(np.zeros(shape, np.uint8), odds))


def lesson(path: Path) -> rollouts.Frames:
    """Frames that are flown again where their file is damaged: there it says nothing."""
    frames = rollouts.read(path)
    if frames is None:
        raise ValueError(f"{path}: damaged")
    return frames


READERS: dict[str, tuple[Callable[[Path], Any], Callable[[Path], Any]]] = {
    "map": (lambda path: OccupancyMap(AREA, protocol_named("dream-v1")).save(path), OccupancyMap.load),
    "prior": (a_prior, lambda path: Prior.load(path, ABOUT, AREA, 0.5)),
    "observation": (a_move, replay.read),
    "lesson": (a_lesson, lesson),
    "survey": (lambda path: files.write(reef(), path), files.read),
}
"""Who writes a file, and who reads it."""

DAMAGED = {
    "promises 149 GiB": headed(says(shape="(40000000000,)"), b"0" * 48),
    "promises more than can be counted": headed(says(shape=f"({10**14}, {10**14}, {10**14})")),
    "another dtype": headed(says("[('a', '<f4'), ('b', 'O')]"), b"0" * 48),
    "objects": headed(says("'|O'"), b"0" * 96),
    "a dtype that is none": headed(says("'<q9'"), b"0" * 48),
    "no text for a dtype": headed(says("7"), b"0" * 48),
    "a header that does not close": headed("{'descr': '<f4', 'shape': ((((", b"0" * 48),
    "a header that is a sum": headed(says(shape="(3, 4) + (1,)"), b"0" * 48),
    "a header that calls": headed(says(shape="__import__('os').abort()"), b"0" * 48),
    "an attribute in the header": headed(says("'<f4'.x"), b"0" * 48),
    "a deep header": headed("(" * 3000),
    "a negative side": headed(says(shape="(-3, 4)"), b"0" * 48),
    "fields that are missing": headed("{'descr': '<f4'}", b"0" * 48),
    "no letters": headed(says("'<U4'", "()"), b"\xff" * 16),
    "neither yes nor no": headed(says("'|b1'", "(2, 4)"), b"\x02" * 8),
    "nothing": b"",
    "magic alone": b"\x93NUMPY",
    "another version": b"\x93NUMPY\x09\x09" + npy(np.zeros(3))[8:],
    "too few values": npy(np.zeros((3, 4), np.float32))[:-1],
    "too many values": npy(np.zeros((3, 4), np.float32)) + b"0",
}


def repacked(path: Path, entry: str, content: bytes) -> None:
    with zipfile.ZipFile(path) as old:
        held = {name: old.read(name) for name in old.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name, was in held.items():
            new.writestr(name, content if name == entry else was)


@pytest.mark.parametrize("kind", READERS)
def test_what_is_damaged_in_an_archive_is_one_error_that_names_the_file(kind: str, tmp_path: Path) -> None:
    write, read = READERS[kind]
    path = tmp_path / f"a {kind}.npz"
    write(path)
    read(path)
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as file:
        entry = next(name for name in file.namelist() if name.endswith(".npy"))
    tracemalloc.start()
    for how, content in DAMAGED.items():
        path.write_bytes(whole)
        repacked(path, entry, content)
        with pytest.raises(ValueError, match=f"a {kind}") as caught:
            read(path)
        assert len(str(caught.value)) < 500, how
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 64 << 20


@pytest.mark.parametrize("kind", READERS)
def test_an_archive_with_anything_wrong_is_refused_or_says_the_same(kind: str, tmp_path: Path) -> None:
    """A short fuzz, seeded: bits, bytes and lengths of the file, which its directory and its sums tell of."""
    write, read = READERS[kind]
    path = tmp_path / f"a {kind}.npz"
    write(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(39)
    refused = 0
    for trial in range(60):
        content = bytearray(whole)
        # Half of them in the directory at the end, which says how long all else is.
        at = int(rng.integers(len(content))) if trial % 2 else len(content) - 1 - int(rng.integers(400))
        if trial % 3 == 0:
            content[at] ^= 1 << int(rng.integers(8))
        elif trial % 3 == 1:
            content[at : at + 4] = rng.bytes(4)
        else:
            del content[at : at + int(rng.integers(1, 30))]
        path.write_bytes(bytes(content))
        try:
            read(path)
        except ValueError as error:
            assert str(path) in str(error)  # noqa: PT017
            refused += 1
    assert refused > 20


def test_an_encrypted_entry_and_one_packed_in_another_way_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a prior.npz"
    for way in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with zipfile.ZipFile(path, "w", way) as file:
            file.writestr("target.npy", npy(np.zeros((2, 4), np.float32)))
        with pytest.raises(ValueError, match="expected it stored or deflated"):
            Prior.load(path, ABOUT, AREA, 0.5)
    a_prior(path)
    content = bytearray(path.read_bytes())
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + flags] |= 1
    path.write_bytes(bytes(content))
    with pytest.raises(ValueError, match=r"a prior\.npz: expected .*encrypted"):
        Prior.load(path, ABOUT, AREA, 0.5)


def test_an_entry_that_claims_more_than_packing_can_hold_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a prior.npz"
    a_prior(path)
    content = bytearray(path.read_bytes())
    at = content.index(b"PK\x01\x02")
    content[at + 24 : at + 28] = struct.pack("<I", 1 << 30)  # Its size unpacked, in the directory.
    path.write_bytes(bytes(content))
    with pytest.raises(ValueError, match="claims 1073741824 bytes in"):
        Prior.load(path, ABOUT, AREA, 0.5)


@pytest.mark.parametrize("how", DAMAGED)
def test_a_damaged_array_of_a_world_is_one_error_that_names_the_file(how: str, tmp_path: Path) -> None:
    (tmp_path / "terrain.npy").write_bytes(DAMAGED[how])
    with pytest.raises(ValueError, match=r"^terrain\.npy: expected a float32 array \(3, 4\)"):
        read_heights(tmp_path / "terrain.npy", (3, 4))


def test_a_picture_that_is_none_or_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "0000.npz"
    monkeypatch.setattr(replay, "MOST_UNPACKED", 1 << 16)
    for content in (b"\x89PNG\r\n\x1a\n" + b"0" * 40, bytes(20), _png(4000, 6)):
        a_move(path)
        repacked(path, "rgb_png.npy", npy(np.frombuffer(content, np.uint8)))
        with pytest.raises(ValueError, match=r"0000\.npz: .*rgb_png: expected"):
            replay.read(path)


def _png(width: int, height: int) -> bytes:
    return replay._png(np.zeros((height, width, 3), np.uint8))


@pytest.mark.parametrize(
    "array",
    [
        np.zeros(()),
        np.zeros((0, 3), np.float32),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(4, dtype=">i8"),
        np.array("reef\u00e4"),
        np.array([True, False]),
        np.arange(5, dtype=np.float16),
    ],
)
def test_what_numpy_writes_is_what_is_read(array: npt.NDArray[Any]) -> None:
    found = arrays.parsed(npy(array))
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert (found == array).all()
    assert found.flags.writeable


def test_nobody_else_reads_arrays() -> None:
    """`np.load` and what it is made of, and whatever evaluates what a file says."""
    loading = re.compile(
        r"\b(np|numpy)\.(lib\.format\.)?(load|fromfile|memmap|open_memmap|loadtxt|genfromtxt|read_\w+)\b"
        r"|^\s*(import|from) pickle\b|mmap_mode|allow_pickle=True",
        re.MULTILINE,
    )
    root = Path(dream.__file__).parent
    found = [
        f"{path.relative_to(root)}: {one[0]}"
        for path in sorted(root.rglob("*.py"))
        for one in loading.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []
