from __future__ import annotations

import io
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.scene import SPACE, RunScene, load, made, save


def same(a: Any, b: Any) -> None:
    if is_dataclass(a):
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    else:
        assert a == b


def test_a_scene_comes_back_as_it_was(wreck: RunScene, tmp_path: Path) -> None:
    save(wreck, tmp_path / SPACE)
    same(load(tmp_path / SPACE), wreck)
    empty = made(title="", bounds=[[0, 0, -1], [1, 1, 0]], water=0.0, field_of_view=(1.0, 1.0))
    save(empty, tmp_path / SPACE)
    same(load(tmp_path / SPACE), empty)


def test_a_wreck_takes_less_than_a_megabyte(wreck: RunScene, tmp_path: Path) -> None:
    save(wreck, tmp_path / SPACE)
    assert (tmp_path / SPACE).stat().st_size < 1e6


def changed(path: Path, **arrays: Any) -> Path:
    with np.load(path) as npz:
        content = {name: npz[name] for name in npz.files} | arrays
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    path.write_bytes(buffer.getvalue())
    return path


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("arrays", "why"),
    [
        ({"version": np.int64(2)}, "version: expected 1"),
        ({"target_faces": np.full((1, 3), 10**6, np.int32)}, "faces: expected 0 to"),
        ({"target_faces": np.zeros((1, 3), np.int64)}, "faces: expected .* int32"),
        ({"target_positions": np.zeros((5, 2), np.float32)}, "target_positions: expected"),
        ({"bounds": np.full((2, 3), np.nan)}, "finite metres"),
        ({"water": np.float64(np.nan)}, "water: expected a height"),
        ({"field_of_view": np.array([0.0, 4.0])}, "field of view: expected"),
        ({"kinds": np.array(["x"] * 300)}, "kinds: expected at most 255"),
        ({"voxel_size": np.float64(np.inf)}, "expected a size"),
        ({"step": np.zeros(60, np.int32)}, "expected rising numbers"),
        ({"yaw": np.full(60, np.nan, np.float32)}, "finite angles"),
    ],
)
def test_a_foreign_file_is_refused_by_its_name(
    arrays: dict[str, Any], why: str, wreck: RunScene, tmp_path: Path
) -> None:
    save(wreck, tmp_path / SPACE)
    with pytest.raises(ValueError, match=rf"space\.npz: expected a scene .*{why}"):
        load(changed(tmp_path / SPACE, **arrays))


def test_a_damaged_file_is_refused(wreck: RunScene, tmp_path: Path) -> None:
    save(wreck, tmp_path / SPACE)
    whole = (tmp_path / SPACE).read_bytes()
    for part in (b"", b"PK nothing", whole[: len(whole) // 2]):
        (tmp_path / SPACE).write_bytes(part)
        with pytest.raises(ValueError, match=r"space\.npz: expected a scene"):
            load(tmp_path / SPACE)
    with pytest.raises(OSError, match="none"):
        load(tmp_path / "none.npz")
