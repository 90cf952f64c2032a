"""Maps with known content, drawn, and requests that show them."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from pydantic import BaseModel

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.mapping.drawing import Mark
from dream.planning.vlm import pictures
from dream.protocol import DREAM_V1, SurveyProtocol
from dream.standin.sight import COLORS, EXPLORED, SOLID, SOLID_TARGET, TARGET, UNKNOWN
from dream.types import Label, Observation
from tests.mapping.analytic import CAMERA, Disc, Pillar, camera_at, empty_map, look_around, render

Cells = npt.NDArray[np.uint8]
Shown = npt.NDArray[np.uint8]


def random_cells(shape: tuple[int, int], seed: int) -> Cells:
    """Rectangles of everything; rows from the south."""
    rng = np.random.default_rng(seed)
    cells = np.full(shape, UNKNOWN, np.uint8)
    for kind in (EXPLORED, EXPLORED, TARGET, TARGET, SOLID, SOLID_TARGET, TARGET):
        row, col = rng.integers(0, shape[0] - 5), rng.integers(0, shape[1] - 5)
        high, wide = rng.integers(3, max(4, shape[0] // 3), 2)
        cells[row : row + high, col : col + wide] = kind
    return cells


def map_of(cells: Cells, bounds: Bounds, protocol: SurveyProtocol = DREAM_V1) -> OccupancyMap:
    """A map that holds these cells."""
    occupancy = OccupancyMap(bounds, protocol)
    assert occupancy.shape == cells.shape
    solid = (cells == SOLID) | (cells == SOLID_TARGET)
    target = (cells == TARGET) | (cells == SOLID_TARGET)
    occupancy._write("log_odds", (0, 0), 20 * solid)
    occupancy._write("flags", (0, 0), (flags.EXPLORED | flags.BARE) * (cells == EXPLORED))
    occupancy._write("votes", (0, 0), 0x30 * target)
    return occupancy


def drawn(
    occupancy: OccupancyMap, pose: SE2, places: Mapping[int, tuple[float, float]] | None = None
) -> Shown:
    """Its picture; a straight way to each place."""
    marks = [Mark(number, np.array([[pose.x, pose.y], [x, y]])) for number, (x, y) in (places or {}).items()]
    return np.asarray(pictures.map_picture(occupancy, pose, [(pose.x, pose.y)], marks)).copy()


def scene() -> tuple[OccupancyMap, dict[str, bytes]]:
    """A patch of targets ahead and a pillar behind it, looked at all round; and all four pictures."""
    pose = SE2(0.0, 0.0, 0.0)
    things = (Disc(5.0, 1.0, 1.5), Pillar(7.0, -2.0, 0.6, 3.0))
    occupancy = empty_map()
    occupancy.clear_launch(pose.x, pose.y)
    look_around(occupancy, pose.x, pose.y, *things)
    T_world_base = camera_at(pose.x, pose.y, pose.yaw) @ DREAM_V1.T_base_camera.inverse
    depth, labels = render(T_world_base @ DREAM_V1.T_base_camera, *things)
    rng = np.random.default_rng(0)
    rgb = rng.integers(20, 200, (*depth.shape, 3)).astype(np.uint8)
    observation = Observation(0.0, rgb, depth, labels, CAMERA, T_world_base, DREAM_V1.T_base_camera)
    assert (labels == Label.TARGET).any()
    return occupancy, {
        **pictures.camera_pictures(observation),
        "map": png(drawn(occupancy, pose)),
    }


def png(shown: Shown) -> bytes:
    return pictures.png(Image.fromarray(shown))


def painted(shown: Shown, box: Sequence[float], color: tuple[int, int, int]) -> Shown:
    """With a rectangle over it: left, top, right, bottom."""
    picture = Image.fromarray(shown)
    ImageDraw.Draw(picture).rectangle(tuple(box), fill=color)
    return np.asarray(picture).copy()


def recolored(shown: Shown, old: tuple[int, int, int], new: tuple[int, int, int]) -> Shown:
    changed = shown.copy()
    changed[(shown == old).all(axis=-1)] = new
    return changed


def request(reply: type[BaseModel], shown: Mapping[str, bytes], text: str = "") -> dict[str, Any]:
    """As pydantic-ai sends it."""
    parts: list[dict[str, Any]] = []
    for name, file in shown.items():
        url = f"data:image/png;base64,{base64.b64encode(file).decode()}"
        parts += [{"type": "text", "text": f"[{name}]"}, {"type": "image_url", "image_url": {"url": url}}]
    schema = {"name": reply.__name__, "schema": reply.model_json_schema()}
    return {
        "model": "x",
        "messages": [
            {"role": "system", "content": "Look at the pictures."},
            {"role": "user", "content": [*parts, {"type": "text", "text": text}]},
        ],
        "response_format": {"type": "json_schema", "json_schema": schema},
    }


def off(one: float, other: float) -> float:
    """Degrees between two headings in radians."""
    return abs(math.degrees(math.remainder(one - other, 2.0 * math.pi)))


GRAY_GREEN = tuple((a + b) // 2 for a, b in zip(COLORS[TARGET], COLORS[EXPLORED], strict=True))
