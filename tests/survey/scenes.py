"""Two surveys made by hand, whose every figure is known: a reef of two patches, and a wreck.

Both are the same on every call. A test that needs another one takes `dataclasses.replace`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.survey import (
    Cells,
    DecisionPoint,
    Individuals,
    Layers,
    Measure,
    Patch,
    StructureSide,
    Survey,
    SurveyedStructure,
    Track,
)
from dream.survey.site import Site
from dream.types import Reasoning, Target

Float64Array = npt.NDArray[np.float64]

BEGAN = datetime(2026, 6, 1, 9, 30, tzinfo=UTC)
SITE = Site("Inner reef", 54.9, 8.3, heading_deg=20.0, datum="MLLW", datum_offset=0.5)
WRECK_SITE = Site("Old trawler", -33.85, 151.2, datum="LAT")
AREA = Bounds(0.0, 0.0, 20.0, 16.0)
CELL = 0.25
SEABED = -6.0
"""Metres, `z` of the bare seabed."""
STEPS = 12
UNKNOWN, EXPLORED, TARGET, SOLID, SOLID_TARGET = range(5)

WEST = (6.0, 6.0, 3.0, 2.0)
"""Middle x, y and half-axes of the ellipse of the first patch, which has 40 individuals on it."""
EAST = (14.5, 10.5, 2.4, 2.4)
"""Of the second, with 20 individuals, around a hole."""
HOLE = (14.5, 10.5, 0.8, 0.8)
HULL = (10.0, 8.0, 5.0, 1.5)


def reef(site: Site | None = SITE, name: str = "2026-06-01T09-30_inner-reef") -> Survey:
    """Two patches, 60 individuals, 12 steps; the upper right corner of the box was not seen."""
    rings = ((ellipse(*WEST),), (ellipse(*EAST), ellipse(*HOLE)[::-1]))
    areas = [area_of(patch) for patch in rings]
    individuals = _individuals()
    patches = []
    for number, (patch, area, (_, _, a, b)) in enumerate(zip(rings, areas, (WEST, EAST), strict=True)):
        count = int((individuals.patch == number).sum())
        patches.append(
            Patch(
                rings=patch,
                measures=(
                    _within("area", area, 0.05, "m2"),
                    _within("length", 2.0 * max(a, b), 0.03, "m"),
                    _within("width", 2.0 * min(a, b), 0.03, "m"),
                    _within("height", 0.30, 0.10, "m"),
                    _within("rugosity", 1.15, 0.04, ""),
                    _within("density", count / area, 0.15, "1/m2"),
                    _within("count", float(count), 0.12, ""),
                ),
            )
        )
    measures = (
        _within("reef_area", sum(areas), 0.05, "m2"),
        _within("patch_count", 2.0, 0.0, ""),
        _within("density", 60.0 / sum(areas), 0.12, "1/m2"),
        _within("count", 60.0, 0.12, ""),
        _within("median_size", float(np.median(individuals.size)), 0.06, "m"),
        _within("reef_height", 0.30, 0.10, "m"),
        Measure("rugosity", None, None, None, "", "the sea floor between the patches was seen too seldom"),
        _within("seen_share", 0.9, 0.01, ""),
    )
    x, y = centres()
    relief = np.full(x.shape, np.nan, np.float32)
    state = np.full(x.shape, EXPLORED, np.uint8)
    state[(x > 17.0) & (y > 13.0)] = UNKNOWN
    within = inside(x, y, WEST) | (inside(x, y, EAST) & ~inside(x, y, HOLE))
    state[within] = TARGET
    state[(abs(x - 10.0) < 0.5) & (abs(y - 13.0) < 0.5)] = SOLID
    seen = state != UNKNOWN
    relief[seen] = 0.0
    relief[within] = 0.3
    return Survey(
        name=name,
        began=BEGAN,
        site=site,
        target=Target.OYSTERS,
        protocol="dream-v1",
        area=AREA,
        measures=measures,
        individuals=individuals,
        patches=tuple(patches),
        layers=_layers(state, relief),
        track=_track(),
        decisions=_decisions(),
        made_by={"version": "0.1.0", "planner": "belief", "world": "made/by-hand", "seed": 1},
    )


def wreck(site: Site | None = WRECK_SITE, name: str = "2026-06-01T09-30_old-trawler") -> Survey:
    """A hull of 10 by 3 metres and one piece of debris; no individuals are counted on it."""
    hull, debris = ellipse(*HULL), ellipse(16.5, 12.0, 0.6, 0.4)
    none = np.zeros(0)
    x, y = centres()
    state = np.full(x.shape, EXPLORED, np.uint8)
    state[(x < 3.0) & (y < 3.0)] = UNKNOWN
    on_hull = inside(x, y, HULL)
    state[on_hull] = SOLID_TARGET
    state[inside(x, y, (16.5, 12.0, 0.6, 0.4))] = TARGET
    relief = np.where(state == UNKNOWN, np.nan, np.where(on_hull, 2.5, 0.0)).astype(np.float32)
    return Survey(
        name=name,
        began=BEGAN,
        site=site,
        target=Target.WRECK,
        protocol="dream-v1",
        area=AREA,
        measures=(
            _within("outline_area", area_of((hull,)), 0.04, "m2"),
            _within("hull_seen", 0.93, 0.03, ""),
            _within("debris_extent", 8.0, 0.05, "m"),
            _within("highest_point", 2.5, 0.04, "m"),
        ),
        individuals=Individuals(
            position=np.zeros((0, 3)),
            sigma=none,
            size=none,
            size_sigma=none,
            hits=np.zeros(0, np.int32),
            looks=np.zeros(0, np.int32),
            confidence=none,
            patch=np.zeros(0, np.int32),
            clear=np.zeros(0, np.bool_),
        ),
        patches=(
            Patch(
                (hull,),
                (
                    _within("area", area_of((hull,)), 0.04, "m2"),
                    _within("length", 10.0, 0.02, "m"),
                    _within("width", 3.0, 0.04, "m"),
                    _within("height", 2.5, 0.04, "m"),
                ),
            ),
            Patch((debris,), (_within("area", area_of((debris,)), 0.2, "m2"),)),
        ),
        layers=_layers(state, relief),
        track=_track(),
        decisions=_decisions(),
        made_by={"version": "0.1.0", "planner": "belief", "world": "made/by-hand", "seed": 2},
    )


def centres() -> tuple[Float64Array, Float64Array]:
    """(rows, cols) x and y of the middle of each cell of the layers."""
    x = np.arange(AREA.x_min + 0.5 * CELL, AREA.x_max, CELL)
    y = np.arange(AREA.y_min + 0.5 * CELL, AREA.y_max, CELL)
    return np.broadcast_to(x, (y.size, x.size)), np.broadcast_to(y[:, None], (y.size, x.size))


def inside(
    x: Float64Array, y: Float64Array, shape: tuple[float, float, float, float]
) -> npt.NDArray[np.bool_]:
    """Are the points in an ellipse of middle and half-axes `shape`?"""
    return ((x - shape[0]) / shape[2]) ** 2 + ((y - shape[1]) / shape[3]) ** 2 <= 1.0


def ellipse(x: float, y: float, a: float, b: float, points: int = 48) -> Float64Array:
    """(points + 1, 2) a closed ring, counter-clockwise."""
    angle = np.linspace(0.0, 2.0 * math.pi, points + 1)
    ring = np.column_stack([x + a * np.cos(angle), y + b * np.sin(angle)])
    ring[-1] = ring[0]
    return ring


def area_of(rings: tuple[Float64Array, ...]) -> float:
    """Square metres within the rings; holes, which turn the other way, count as less."""
    return sum(float(0.5 * np.sum(ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1])) for ring in rings)


def _individuals() -> Individuals:
    """60 of them on spirals, so that no two are close; sizes from 0.15 to 0.35 m."""
    number = np.arange(60)
    patch = np.where(number < 40, 0, 1).astype(np.int32)
    within = np.where(patch == 0, number, number - 40)
    of = np.where(patch == 0, 40, 20)
    least = np.where(patch == 0, 0.0, 0.45)  # Clear of the hole.
    radius = np.sqrt(least**2 + (0.95**2 - least**2) * (within + 0.5) / of)
    angle = math.pi * (3.0 - math.sqrt(5.0)) * within
    shape = np.array([WEST, EAST])[patch]
    x = shape[:, 0] + shape[:, 2] * radius * np.cos(angle)
    y = shape[:, 1] + shape[:, 3] * radius * np.sin(angle)
    looks = (6 + number % 7).astype(np.int32)
    return Individuals(
        position=np.column_stack([x, y, np.full(60, SEABED + 0.3)]),
        sigma=np.full(60, 0.05),
        size=np.asarray(0.15 + 0.2 * ((number * 37) % 60) / 59.0, np.float64),
        size_sigma=np.full(60, 0.02),
        hits=np.ceil(0.9 * looks).astype(np.int32),
        looks=looks,
        confidence=np.asarray(0.9 + 0.01 * (number % 10), np.float64),
        patch=patch,
        clear=number % 4 != 3,
    )


def _layers(state: npt.NDArray[np.uint8], relief: npt.NDArray[np.float32]) -> Layers:
    seen = state != UNKNOWN
    target = (state == TARGET) | (state == SOLID_TARGET)
    probability = np.where(seen, np.where(target, 0.95, 0.02), np.nan).astype(np.float32)
    columns = np.arange(state.shape[1], dtype=np.uint16)
    return Layers(
        bounds=AREA,
        cell=CELL,
        state=state,
        target_probability=probability,
        relief=relief,
        times_seen=np.where(seen, 1 + columns % 9, 0).astype(np.uint16),
    )


def _track() -> Track:
    """A straight run to the east, 1.5 m a step, 2 m above the seabed."""
    step = np.arange(STEPS + 1, dtype=np.float64)
    x = 1.0 + 1.5 * step
    return Track(
        time=10.0 * step,
        position=np.column_stack([x, np.full_like(x, 8.0), np.full_like(x, SEABED + 2.0)]),
        yaw=np.zeros_like(x),
        sigma=0.02 + 0.005 * step,
    )


def _decisions() -> tuple[DecisionPoint, ...]:
    return tuple(
        DecisionPoint(
            step=step,
            time=10.0 * step,
            x=1.0 + 1.5 * step,
            y=8.0,
            yaw=0.0,
            turn=0.0,
            advance=1.5,
            reasoning=Reasoning(
                distribution="Oysters stand to the left and ahead.",
                target_area="They form two patches.",
                completion="The corner in the north-east is still open.",
                next_target="The eastern patch.",
                safety="Free water ahead.",
                action=f"Step {step}: go on to the east.",
            ),
            note="slowed down <for & by the guard>" if step == 5 else "",
        )
        for step in range(1, STEPS + 1)
    )


def _within(name: str, value: float, share: float, unit: str) -> Measure:
    return Measure(name, value, value * (1.0 - share), value * (1.0 + share), unit)


def raised_wreck() -> Survey:
    """The wreck as a mission in space tells it: a wall of 4 by 2 cubes, and a boulder of one cube.

    The wall lies along east. Its north side was inspected from two sides but for one cube, its south side was
    seen alone, and beyond its east end it may go on.
    """
    wall = np.array([(x, y, z) for x in range(4) for y in range(2) for z in range(2)], np.float64)
    side = np.where(wall[:, 1] == 1, 0, 1).astype(np.uint8)
    state = np.where(side == 0, 3, 1).astype(np.uint8)
    state[np.flatnonzero(side == 0)[0]] = 1
    beyond = np.array([(4.0, 1.0, 0.0)])
    cells = Cells(
        0.25 * (np.concatenate([wall, beyond]) + 0.5) + (0.0, 0.0, -10.0),
        np.append(side, 2).astype(np.uint8),
        np.append(state, 0).astype(np.uint8),
    )

    def told(surface: float, inspected: float, more: float) -> tuple[Measure, ...]:
        return (
            _within("known_surface", surface, 0.4, "m2"),
            Measure("inspected_share", inspected, max(inspected - 0.1, 0.0), min(inspected + 0.1, 1.0), ""),
            Measure("open_area", more, None, None, "m2"),
        )

    none = (
        Measure("known_surface", None, None, None, "m2", "none of it is known"),
        Measure("inspected_share", None, None, None, "", "none of it is known"),
        Measure("open_area", 0.0, None, None, "m2"),
    )
    quarter = 0.5 * math.pi
    sides = (
        StructureSide("side", quarter, told(0.5, 0.875, 0.0)),
        StructureSide("side", -quarter, told(0.5, 0.0, 0.0)),
        StructureSide("end", 0.0, (*none[:2], Measure("open_area", 0.0625, None, None, "m2"))),
        StructureSide("end", math.pi, none),
        StructureSide("top", None, none),
        StructureSide("underside", None, none),
    )
    height = _within("height", 2.5, 0.04, "m")
    boulder = Cells(np.array([[8.125, 3.125, -9.875]]), np.zeros(1, np.uint8), np.ones(1, np.uint8))
    return replace(
        wreck(),
        protocol="dream-v2",
        measures=(
            *(one for one in wreck().measures if one.name != "hull_seen"),
            *told(1.0, 0.4375, 0.0625),
        ),
        structures=(
            SurveyedStructure(0.0, (height, *told(1.0, 0.4375, 0.0625)), sides, cells, 0.25),
            SurveyedStructure(0.0, (height, *told(0.1, 0.0, 0.0)), sides[1:2] * 6, boulder, 0.25),
        ),
    )
