"""The open formats of a world's files: NumPy arrays and tables of comma-separated values.

Readers trust nothing. What is damaged is refused with a ValueError that names file and field.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from dream import arrays
from dream.sim.sampling import FACTOR, MILLIMETRE, QUATERNION, quantised
from dream.sim.world import BoolArray, Instances
from dream.telling import one_line

COLUMNS = "mesh,x,y,z,qw,qx,qy,qz,sx,sy,sz,red,green,blue,group"
KIND = "hull"
"""One more column, 0 or 1, of individuals that are not all alike."""
_KINDS = {"0": False, "1": True}
MOST_BYTES = 256 * 1024 * 1024
"""No file of a world is larger."""
MOST_TOLD = 20
"""Rows that are refused one by one; of more there is the number."""


@dataclass(frozen=True, slots=True)
class Said:
    """What became of a part of a world."""

    what: Literal["taken", "turned", "refused"]
    file: str
    words: str

    def __str__(self) -> str:
        return f"{self.file}: {self.words}"


def readable(path: Path) -> Path:
    """The path, if it is a file of bearable size."""
    if not path.is_file():
        raise ValueError(
            f"{path.name}: expected a file in {path.parent}, got none. Is this the folder of a world?"
        )
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"{path.name}: expected at most {MOST_BYTES:,} bytes, got {size:,}")
    return path


def text(path: Path) -> str:
    """What the file says in UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path.name}: expected UTF-8 text, got byte {error.object[error.start]:#x} at {error.start}"
        ) from None


def read_heights(path: Path, shape: tuple[int, int]) -> npt.NDArray[np.float32]:
    """The float32 array of that shape."""
    return arrays.read(path, f"a float32 array {shape} as world.json says", shape, np.float32)


def csv(table: Instances, hull: BoolArray | None = None) -> str:
    """The instances as lines of comma-separated values under a header; with hull, (N,), its column."""
    columns = zip(
        table.mesh.tolist(),
        quantised(table.position, MILLIMETRE).tolist(),
        quantised(table.wxyz, QUATERNION).tolist(),
        quantised(table.scale, FACTOR).tolist(),
        quantised(table.tint, FACTOR).tolist(),
        table.group.tolist(),
        strict=True,
    )
    lines = [
        ",".join(
            [
                str(mesh),
                *(f"{v:.3f}" for v in position),
                *(f"{v:.6f}" for v in wxyz),
                *(f"{v:.4f}" for v in (*scale, *tint)),
                str(group),
            ]
        )
        for mesh, position, wxyz, scale, tint, group in columns
    ]
    header = COLUMNS
    if hull is not None:
        header = f"{COLUMNS},{KIND}"
        lines = [f"{line},{kind:d}" for line, kind in zip(lines, hull.tolist(), strict=True)]
    return "\n".join([header, *lines]) + "\n"


def read_table(
    path: Path, rows: int | None, *, kinds: bool = False
) -> tuple[Instances, BoolArray, list[Said]]:
    """The instances of a file, which of them are hull, and what is refused; the table is then not whole.

    Args:
        path: The file.
        rows: That it must hold; None where nobody says.
        kinds: Its last column says which are hull; none are without it.
    """
    columns = f"{COLUMNS},{KIND}" if kinds else COLUMNS
    header, *lines = text(path).splitlines() or [""]
    if header.strip() != columns:
        raise ValueError(f'{path.name}: expected the header "{columns}", got "{one_line(header)[:90]}"')
    refused = []
    if rows is not None and len(lines) != rows:
        refused.append(
            f"rows: expected {rows} as world.json says, got {len(lines)}. If the file is whole, correct "
            "world.json"
        )
    count = len(lines)
    values = np.full((count, 13), np.nan)
    mesh, group, hull = np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros(count, np.bool_)
    wrong = 0
    for k, line in enumerate(lines):
        try:
            cells = line.split(",")
            if kinds:
                hull[k] = _KINDS[cells.pop().strip()]
            first, *middle, last = cells
            mesh[k], group[k] = int(first), int(last)
            values[k] = [float(v) for v in middle]
        except (KeyError, ValueError, OverflowError):
            wrong += 1
            if wrong <= MOST_TOLD:
                asked = f"{15 + kinds} numbers ({columns}{'; hull 0 or 1' if kinds else ''})"
                refused.append(f'line {k + 2}: expected {asked}, got "{one_line(line)[:90]}"')
    if wrong > MOST_TOLD:
        refused.append(f"{wrong - MOST_TOLD} more lines like these")
    with np.errstate(over="ignore"):
        table = values.astype(np.float32)
    instances = Instances(mesh, table[:, :3], table[:, 3:7], table[:, 7:10], table[:, 10:13], group)
    return instances, hull, [Said("refused", path.name, words) for words in refused]
