"""`space.npz` in the folder of a run: a scene on disk."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np

from dream import arrays
from dream.files import whole_or_nothing
from dream.scene.parts import Path, RunScene, SceneSurface, Voxels

SPACE = "space.npz"
"""Its name in a run folder."""
MOST_BYTES = 128 << 20
"""Of a file, unpacked."""
MOST_LETTERS = 200
"""Of its title, and of the name of a kind of target."""
_VERSION = 1
_KINDS = 255


def save(scene: RunScene, path: pathlib.Path) -> None:
    """Write a scene; the file appears whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    with whole_or_nothing(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **_arrays(scene))


def load(path: pathlib.Path) -> RunScene:
    """The scene that `save` wrote, or anybody.

    Raises:
        OSError: It cannot be read.
        ValueError: It is damaged or foreign; the message names the file.
    """
    with arrays.opened(path, "a scene written by save", MOST_BYTES) as npz:
        if (version := int(_of(npz, "version", (), "i"))) != _VERSION:
            raise ValueError(f"version: expected {_VERSION}, got {version}")
        kinds = _of(npz, "kinds", (None,), "U")
        if len(kinds) > _KINDS:
            raise ValueError(f"kinds: expected at most {_KINDS}, got {len(kinds)}")
        across, up = _of(npz, "field_of_view", (2,), "f").tolist()
        return RunScene(
            title=str(_of(npz, "title", (), "U"))[:MOST_LETTERS],
            bounds=_of(npz, "bounds", (2, 3), "f").astype(np.float64),
            water=float(_of(npz, "water", (), "f")),
            field_of_view=(across, up),
            targets=_surface(npz, "target", owned=True),
            kinds=tuple(str(kind)[:MOST_LETTERS] for kind in kinds),
            kind=_of(npz, "kind", (None,), "u"),
            seen_at=_of(npz, "seen_at", (None,), "u"),
            inspected_at=_of(npz, "inspected_at", (None,), "u"),
            obstacles=_surface(npz, "obstacle", owned=False),
            seabed=_surface(npz, "seabed", owned=False),
            voxels=Voxels(
                float(_of(npz, "voxel_size", (), "f")),
                _of(npz, "voxel_positions", (None, 3), "f"),
                _of(npz, "voxel_target", (None,), "b"),
                _of(npz, "voxel_seen_at", (None,), "u"),
                _of(npz, "voxel_inspected_at", (None,), "u"),
            ),
            path=Path(
                _of(npz, "step", (None,), "i"),
                _of(npz, "path", (None, 3), "f"),
                _of(npz, "yaw", (None,), "f"),
                _of(npz, "tilt", (None,), "f"),
                _of(npz, "collided", (None,), "b"),
            ),
        )


def _arrays(scene: RunScene) -> dict[str, Any]:
    return {
        "version": np.int64(_VERSION),
        "title": np.str_(scene.title[:MOST_LETTERS]),
        "bounds": scene.bounds,
        "water": np.float64(scene.water),
        "field_of_view": np.array(scene.field_of_view),
        "target_positions": scene.targets.positions,
        "target_faces": scene.targets.faces,
        "target_owner": scene.targets.owner,
        "kinds": np.array([kind[:MOST_LETTERS] for kind in scene.kinds], dtype=np.str_),
        "kind": scene.kind,
        "seen_at": scene.seen_at,
        "inspected_at": scene.inspected_at,
        "obstacle_positions": scene.obstacles.positions,
        "obstacle_faces": scene.obstacles.faces,
        "seabed_positions": scene.seabed.positions,
        "seabed_faces": scene.seabed.faces,
        "voxel_size": np.float64(scene.voxels.size),
        "voxel_positions": scene.voxels.positions,
        "voxel_target": scene.voxels.target,
        "voxel_seen_at": scene.voxels.seen_at,
        "voxel_inspected_at": scene.voxels.inspected_at,
        "step": scene.path.step,
        "path": scene.path.positions,
        "yaw": scene.path.yaw,
        "tilt": scene.path.tilt,
        "collided": scene.path.collided,
    }


def _surface(npz: arrays.Npz, name: str, *, owned: bool) -> SceneSurface:
    positions = _of(npz, f"{name}_positions", (None, 3), "f")
    owner = _of(npz, f"{name}_owner", (None,), "i") if owned else np.full(len(positions), -1, np.int32)
    return SceneSurface(positions, _of(npz, f"{name}_faces", (None, 3), "i"), owner)


def _of(npz: arrays.Npz, name: str, shape: tuple[int | None, ...], kind: str) -> Any:
    """An array of that kind of number and of that shape, in which None is any length."""
    found = npz[name]
    fits = len(found.shape) == len(shape) and all(
        wanted in (None, got) for wanted, got in zip(shape, found.shape, strict=True)
    )
    if not fits or found.dtype.kind != kind:
        raise ValueError(f"{name}: expected {shape} of kind {kind}, got {found.shape} {found.dtype}")
    return found
