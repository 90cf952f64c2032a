"""RunScene → what a page holds of it: JSON with arrays in base64, positions in 16 bits."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.scene.parts import LEGEND, RunScene, SceneSurface, UInt8Array, UInt16Array, Voxels

SIDES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
"""Of a voxel, in the order of the bits of `exposed`."""


def encoded(scene: RunScene) -> dict[str, Any]:
    """A scene for the page, which can be written as JSON.

    Positions of surfaces are whole numbers of `step`, from `low`: (3,) metres each, `step` a 65535th of the
    extent. The vertices of targets come in the order of their individuals, with how many each has.
    """
    surfaces = {"targets": _ordered(scene.targets), "obstacles": scene.obstacles, "seabed": scene.seabed}
    low, step = _box([surface.positions for surface in surfaces.values()])
    counts = np.bincount(surfaces["targets"].owner, minlength=len(scene.kind))
    path = scene.path
    return {
        "title": scene.title,
        "bounds": scene.bounds.tolist(),
        "water": scene.water,
        "field_of_view": list(scene.field_of_view),
        "legend": [{"name": name, "color": list(color)} for name, color in LEGEND.values()],
        "kinds": list(scene.kinds),
        "kind": _packed(scene.kind),
        "seen_at": _packed(scene.seen_at),
        "inspected_at": _packed(scene.inspected_at),
        "vertices": _packed(counts.astype(np.uint16 if counts.max(initial=0) < 65536 else np.uint32)),
        "low": low.tolist(),
        "step": step.tolist(),
        "surfaces": {
            name: {
                "positions": _packed(quantised(surface.positions, low, step)),
                "faces": _packed(
                    surface.faces.astype(np.uint16 if len(surface.positions) <= 65536 else np.uint32)
                ),
            }
            for name, surface in surfaces.items()
            if len(surface.faces)
        },
        "voxels": _voxels(scene.voxels) if len(scene.voxels.positions) else None,
        "path": {
            "step": path.step.tolist(),
            "positions": _packed(path.positions),
            "yaw": _packed(path.yaw),
            "tilt": _packed(path.tilt),
            "collided": np.flatnonzero(path.collided).tolist(),
        },
    }


def quantised(
    positions: npt.NDArray[np.floating], low: npt.NDArray[np.float64], step: npt.NDArray[np.float64]
) -> UInt16Array:
    """(V, 3) positions as whole numbers of `step` from `low`."""
    return np.rint((positions - low) / step).astype(np.uint16)


def exposed(voxels: Voxels) -> UInt8Array:
    """(n,) which sides of a voxel can be looked at, a bit each: no other was mapped there by then."""
    _, cells = voxels.cells()
    shape = cells.max(axis=0, initial=0).astype(np.int64) + 3
    keys = ((cells[:, 0] + 1) * shape[1] + cells[:, 1] + 1) * shape[2] + cells[:, 2] + 1
    order = np.argsort(keys)
    ranked = keys[order]
    seen = voxels.seen_at
    sides = np.zeros(len(cells), np.uint8)
    for bit, (dx, dy, dz) in enumerate(SIDES):
        beside = keys + (dx * shape[1] + dy) * shape[2] + dz
        place = np.minimum(np.searchsorted(ranked, beside), max(0, len(ranked) - 1))
        hidden = (ranked[place] == beside) & (seen[order[place]] <= seen)
        sides |= np.where(hidden, 0, 1 << bit).astype(np.uint8)
    return sides


def _voxels(voxels: Voxels) -> dict[str, Any]:
    low, cells = voxels.cells()
    return {
        "size": voxels.size,
        "low": low.tolist(),
        "cells": _packed(cells),
        "sides": _packed(exposed(voxels)),
        "target": _packed(voxels.target.astype(np.uint8)),
        "seen_at": _packed(voxels.seen_at),
        "inspected_at": _packed(voxels.inspected_at),
    }


def _ordered(surface: SceneSurface) -> SceneSurface:
    """Its vertices in the order of their individuals."""
    order = np.argsort(surface.owner, kind="stable")
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    return SceneSurface(surface.positions[order], place[surface.faces], surface.owner[order])


def _box(parts: list[npt.NDArray[np.float32]]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    positions = np.concatenate(parts).astype(np.float64)
    if len(positions) == 0:
        return np.zeros(3), np.ones(3)
    low = positions.min(axis=0)
    return low, np.maximum((positions.max(axis=0) - low) / 65535.0, 1e-9)


def _packed(array: npt.NDArray[Any]) -> dict[str, str]:
    """Its numbers row by row, the lowest byte first, and what they are: `u1`, `u2`, `u4` or `f4`."""
    little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    return {"type": little.dtype.str[1:], "data": base64.b64encode(little.tobytes()).decode()}
