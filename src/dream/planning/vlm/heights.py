"""What a model is told of heights: where the vehicle is, what stands up, what is left to inspect."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.mapping.structures import COLUMN, Structure, clearance, structures
from dream.planning.space import words
from dream.planning.vlm.pictures import bearing
from dream.types import BoolArray, Observation

if TYPE_CHECKING:
    from dream.mapping.volume import Surface, Volume

MOST = 3
"""Structures that are told of, the largest; and parts of what is left, the largest for the way there."""
CUBE = 4.0
"""Metres a side of the parts."""
LEAST = 0.5
"""Square metres of one."""
LEANS = 0.5
"""Share of a normal that points up or down from which on a surface is said to face so."""


def heights(volume: Volume, observation: Observation, body_radius: float) -> list[str]:
    """Lines of text.

    Args:
        volume: What is known.
        observation: Made where the vehicle is.
        body_radius: Metres around its centre within which something lies below or above it.
    """
    surface, known = volume.surface(), structures(volume)
    here = observation.pose.x, observation.pose.y, observation.z
    below, above = clearance(surface, here, body_radius)
    under = f"{below:.1f} m above what lies below it" if math.isfinite(below) else "over ground not seen yet"
    over = f" Something solid is {above:.1f} m above it." if math.isfinite(above) else ""
    is_target = surface.target > 0.5
    inspected = is_target & (surface.sides != 0)
    return [
        f"It is {-observation.z:.1f} m under water, {under}; its camera looks "
        f"{words.tilted(observation.tilt)}.{over}",
        words.distribution(_area(surface, is_target), _area(surface, inspected), known),
        *(_structure(one, surface, is_target, inspected) for one in known[:MOST]),
        *_left(surface, is_target & ~inspected, here),
    ]


def _structure(one: Structure, surface: Surface, is_target: BoolArray, inspected: BoolArray) -> str:
    rows, cols, inside = one.column_of(surface.middles)
    inside[inside] = one.mask[rows[inside], cols[inside]]
    whole, done = _area(surface, inside & is_target), _area(surface, inside & inspected)
    x, y = one.middle.tolist()
    east, north = np.ptp(one.columns, axis=0) + COLUMN
    return (
        f"A structure around ({x:.1f}, {y:.1f}), {east:.0f} m from west to east and {north:.0f} m from south "
        f"to north, stands from {-one.ground:.1f} up to {-one.top:.1f} m under water; of {whole:.0f} m² of "
        f"target on it {done / max(whole, 1e-9):.0%} are inspected."
    )


def _left(surface: Surface, left: BoolArray, here: tuple[float, float, float]) -> list[str]:
    """Where most is left for the way there; nothing where nothing is."""
    points, area, normals = surface.middles[left], surface.area[left], surface.normals[left]
    cubes, cube = np.unique(np.floor(points / CUBE), axis=0, return_inverse=True)
    weight = np.bincount(cube.ravel(), area, len(cubes))
    parts = []
    for k in np.flatnonzero(weight >= LEAST):
        mine = cube.ravel() == k
        middle = np.average(points[mine], axis=0, weights=area[mine])
        away = float(np.linalg.norm(middle - np.array(here)))
        facing = _facing(np.average(normals[mine], axis=0, weights=area[mine]))
        x, y, z = middle.tolist()
        told = f"around ({x:.1f}, {y:.1f}), {-z:.1f} m under water, {weight[k]:.1f} m² that face {facing}"
        parts.append((-round(float(weight[k]) / (away + CUBE), 6), told))
    if not parts:
        return []
    return [
        f"{float(area.sum()):.0f} m² of target are seen and not inspected. Some that are near: "
        f"{'; '.join(told for _, told in sorted(parts)[:MOST])}."
    ]


def _facing(normal: npt.NDArray[np.float64]) -> str:
    """Where a mean normal points, in words."""
    east, north, up = normal.tolist()
    length = math.sqrt(east**2 + north**2 + up**2)
    if length < 0.2:
        return "all ways"
    ways = []
    if abs(up) >= LEANS * length:
        ways.append("up" if up > 0.0 else "down")
    if math.hypot(east, north) >= LEANS * length:
        named = bearing(SE2(0.0, 0.0, math.atan2(north, east)))
        ways.append(named.partition("(")[2].rstrip(")"))
    return " and ".join(ways)


def _area(surface: Surface, which: BoolArray) -> float:
    return float(surface.area[which].sum())
