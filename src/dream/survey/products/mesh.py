"""The surface of structures as one PLY mesh, coloured by what was inspected; needs no origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dream.scene.exports import put_ply, triangles
from dream.scene.meshes import boxes
from dream.scene.parts import Voxels
from dream.survey.products import elevations
from dream.survey.products.words import side_name, warning
from dream.survey.survey import SEEN, Survey

NAME = "structures.ply"
_VERTEX = np.dtype(
    [("position", "<f4", 3), ("color", "u1", 3)]
    + [(name, "u1") for name in ("state", "inspected_from", "structure", "side")]
)
_COLORS = (elevations.MAY_GO_ON, elevations.SEEN_ALONE, elevations.INSPECTED)


def write(survey: Survey, path: Path) -> None:
    """Write the mesh: the cubes of the map, in metres of the world of the run, x east, y north, z up.

    A vertex has a colour, its `state` (0 may go on, 1 seen, 2 inspected), from how many sides its cube was
    inspected, and by number its structure, from 1 on, and its side, which the header names.

    Raises:
        OSError: It cannot be written.
    """
    vertices, faces, first = [np.empty(0, _VERTEX)], [triangles(np.empty((0, 3), np.int32))], 0
    says = [told] if (told := warning(survey)) else []
    says += ["metres; x east, y north, z up", "state 0: may go on, 1: seen, 2: inspected"]
    for number, one in enumerate(survey.structures, start=1):
        cells = one.cells
        count = len(cells.state)
        mapped = np.zeros(count, np.uint16)
        places = cells.position.astype(np.float32)
        cubes = Voxels(one.cell, places, np.ones(count, np.bool_), mapped, mapped)
        positions, corners, owner = boxes(cubes, 0)
        state = np.minimum(cells.state, SEEN + 1)
        own = np.empty(len(positions), _VERTEX)
        own["position"], own["color"] = positions, np.array(_COLORS, np.uint8)[state[owner]]
        own["state"], own["side"] = state[owner], cells.side[owner]
        own["inspected_from"] = np.maximum(cells.state, SEEN)[owner] - SEEN
        own["structure"] = min(number, 255)
        vertices.append(own)
        faces.append(triangles(corners + first))
        first += len(positions)
        says += [
            f"structure {number}, side {k}: {side_name(side, survey.site)}"
            for k, side in enumerate(one.sides)
        ]
    put_ply(path, [_plain(line) for line in says], np.concatenate(vertices), np.concatenate(faces))


def _plain(text: str) -> str:
    """On one line and in ASCII, as a comment has to be."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)
