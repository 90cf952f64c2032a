"""A box that stands on level ground, in a volume whose every voxel is known beforehand."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.mapping.volume import MOST, STORED, Volume
from dream.protocol import DREAM_V2_TRUE, SurveyProtocol

CELL = 0.25
GROUND = -10.0
"""World z of the top of the ground."""
LONG, WIDE, HIGH = 32, 16, 12
"""Voxels of the box along east, north and up."""
SIDE = 8
FREE, SOLID = -16, MOST

Cells = npt.NDArray[np.bool_]


def box_volume(
    folder: Path,
    *,
    looked_at: Any = None,
    votes: Any = None,
    unknown: Any = None,
    protocol: SurveyProtocol = DREAM_V2_TRUE,
) -> Volume:
    """A volume with the box in the middle, all else above the ground free.

    Args:
        folder: Where its file is written.
        looked_at: (east, north, up) of voxels of the box → from how many sides they were inspected.
        votes: Likewise → votes for target out of 100; 100 where None. They are counted from the box's lowest
            west and south corner, the ground at −1.
        unknown: Likewise → bool, which are not known.
        protocol: Of the mission.
    """
    reach = np.array([56, 56, 24])  # Voxels around: whole bricks.
    low = np.array([-28 * CELL, -28 * CELL, GROUND]) / CELL - [0, 0, SIDE]
    low = (np.floor(low / SIDE) * SIDE).astype(np.int64)
    east, north, up = np.meshgrid(
        *(np.arange(n) + at for n, at in zip(reach, low, strict=True)), indexing="ij"
    )
    i, j, k = east + LONG // 2, north + WIDE // 2, up - round(GROUND / CELL)
    box = (i >= 0) & (i < LONG) & (j >= 0) & (j < WIDE) & (k >= 0) & (k < HIGH)
    odds = np.where(box | (k == -1), SOLID, np.where(k < -1, 0, FREE)).astype(np.int8)
    if unknown is not None:
        odds[unknown(i, j, k)] = 0
    shape = odds.shape
    counts = np.zeros((*shape, 2), np.uint16)
    counts[..., 1] = np.where(odds > 0, 100, 0)
    counts[..., 0] = np.where(odds > 0, np.where(box, 100, 0) if votes is None else votes(i, j, k), 0)
    number = np.zeros(shape, np.int64) if looked_at is None else np.asarray(looked_at(i, j, k))
    sides = np.where(box & (odds > 0), (1 << number) - 1, 0).astype(np.uint32)
    seen = (odds > 0).astype(np.uint8)

    def bricks(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """(bricks, voxels, ...) of an array by east, north and up, in the order of a file."""
        n = [size // SIDE for size in shape]
        split = array.reshape(n[0], SIDE, n[1], SIDE, n[2], SIDE, *array.shape[3:])
        rest = tuple(range(6, split.ndim))
        return split.transpose(4, 2, 0, 5, 3, 1, *rest).reshape(-1, SIDE**3, *array.shape[3:])

    names = bricks(np.stack([up, north, east], axis=-1))[:, 0] // SIDE
    about = {
        "format": "dream-volume-1",
        "protocol": asdict(protocol),
        "cell": CELL,
        "revision": 1,
        "sees": 12.0,
    }
    arrays: dict[str, Any] = {
        "names": names.astype(np.int32),
        "log_odds": bricks(odds),
        "stamps": np.ones(len(names), np.int64),
        "surfaces": np.arange(1, len(names) + 1),
        "votes": bricks(counts),
        "seen": bricks(seen),
        "sides": bricks(sides),
        "about": np.array(json.dumps(about)),
    }
    assert set(STORED) <= set(arrays)
    with (folder / "volume.npz").open("wb") as file:
        np.savez_compressed(file, **arrays)
    return Volume.load(folder / "volume.npz")
