"""What must hold of every world, whoever made it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import SurveyProtocol, protocol_named
from dream.sim.sampling import rotated
from dream.sim.world import Instances, Mesh, World

MOST_SEED = 2**63 - 1
LONGEST_NAME = 100
NAME = f"1 to {LONGEST_NAME} printable characters"
MOST_TERRAIN = 8192
"""Rows or columns of a seabed."""
MOST_INSTANCES = 200_000
MOST_MESHES = 100_000
MOST_VERTICES = 5_000_000
MOST_FACES = 10_000_000
FARTHEST = 10_000.0
"""Metres: no coordinate is larger."""
LARGEST_INDIVIDUAL = 5.0
"""Metres that an individual may be long that is not a part of a hull."""
LARGEST = 2.0
"""Sides of the bounds that a mesh may be long where it stands, if it is slender or goes round the bounds; any
other may be one side long."""
SLENDER = 0.25
"""Share of the longest side of a slender mesh that its next longest has at most, as of a pipe or a quay."""
GROUP_RADII = 0.05, 50.0
"""Metres: the least and the greatest that a world may promise of its groups."""
SMALLEST = 0.001
"""Metres: what is smaller is rounded to a point."""


def check_world(world: World) -> None:
    """Raise a ValueError that names the field, what was expected and what was found, if anything is amiss."""
    for problem in problems(world):
        raise ValueError(problem)


def problems(world: World) -> Iterator[str]:
    """All that is amiss, one after the other: the field, what was expected and what was found."""
    checks: list[Callable[[], None]] = [
        partial(_check_name, "name", world.name),
        partial(_check_name, "water.name", world.water.name),
        partial(check_seed, world.seed),
        partial(_check_group_radius, world.group_radius),
    ]
    try:
        protocol = protocol_named(world.protocol)
    except ValueError as error:
        yield str(error)
        checks.append(partial(_check_ground, world))
    else:
        checks += [partial(_check_bounds, world, protocol), partial(_check_terrain, world, protocol)]
        checks += [
            partial(_check_start, f"starts[{number}]", start, world, protocol)
            for number, start in enumerate(world.starts)
        ]
    checks.append(partial(_check_any_start, world))
    checks += [partial(_check_mesh, f"meshes[{number}]", mesh) for number, mesh in enumerate(world.meshes)]
    checks += [partial(_check_targets, world), partial(_check_instances, "obstacles", world.obstacles, world)]
    for check in checks:
        try:
            check()
        except ValueError as error:
            yield str(error)


def _check_name(field: str, name: str) -> None:
    if not is_name(name):
        raise ValueError(f"{field}: expected {NAME}, got {name[: LONGEST_NAME + 1]!r}")


def _check_any_start(world: World) -> None:
    if not world.starts:
        raise ValueError("starts: expected at least one, got none")


def _check_targets(world: World) -> None:
    if world.hull.shape != (len(world.targets),) or world.hull.dtype != np.bool_:
        got = f"{world.hull.dtype} {world.hull.shape}"
        raise ValueError(f"hull: expected bool ({len(world.targets)},), one an individual, got {got}")
    _check_instances("targets", world.targets, world)
    group, most = world.targets.group, len(world.targets) - 1
    _check_rows("targets.group", (group >= 0) & (group <= most), group, f"0 to {most}")


def _check_instances(name: str, table: Instances, world: World) -> None:
    _check_table(name, table, len(world.meshes))
    if len(table) and all(is_near(mesh) for mesh in world.meshes):
        _check_size(name, table, world)


def is_name(text: str) -> bool:
    """Can it stand in a line of text: neither empty nor too long, and nothing in it that does not print?"""
    return 0 < len(text) <= LONGEST_NAME and text.isprintable()


def check_seed(seed: int) -> None:
    """Raise a ValueError unless the seed is one that a world can have."""
    if not 0 <= seed <= MOST_SEED:
        raise ValueError(f"seed: expected 0 to {MOST_SEED}, got {seed}. Choose a whole number between them")


def _check_group_radius(radius: float) -> None:
    least, most = GROUP_RADII
    if not least <= radius <= most:
        raise ValueError(f"group_radius: expected {least:g} to {most:g} m, got {radius:g}")


def _check_bounds(world: World, protocol: SurveyProtocol) -> None:
    for name in ("x_min", "y_min", "x_max", "y_max"):
        value = getattr(world.bounds, name)
        if not _on_lattice(value, protocol.lattice):
            raise ValueError(f"bounds.{name}: expected a multiple of {protocol.lattice} m, got {value}")


def _check_ground(world: World) -> None:
    box, ground = world.bounds, world.terrain
    if ground.heights.ndim != 2 or min(ground.heights.shape) < 2 or max(ground.heights.shape) > MOST_TERRAIN:
        raise ValueError(
            f"terrain.heights: expected 2 to {MOST_TERRAIN} rows and columns, got {ground.heights.shape}"
        )
    if not (math.isfinite(ground.spacing) and ground.spacing > 0.0):
        raise ValueError(f"terrain.spacing: expected more than 0 m, got {ground.spacing}")
    _check_finite("terrain.heights", ground.heights)
    if float(ground.heights.max()) >= 0.0:
        raise ValueError(
            f"terrain.heights: expected a seabed below z = 0, got {float(ground.heights.max()):g}"
        )
    rows, cols = ground.heights.shape
    x1, y1 = ground.x0 + (cols - 1) * ground.spacing, ground.y0 + (rows - 1) * ground.spacing
    if not (ground.x0 <= box.x_min and ground.y0 <= box.y_min and box.x_max <= x1 and box.y_max <= y1):
        raise ValueError(
            f"terrain: expected to cover the bounds x {box.x_min:g}..{box.x_max:g}, "
            f"y {box.y_min:g}..{box.y_max:g}, got x {ground.x0:g}..{x1:g}, "
            f"y {ground.y0:g}..{y1:g}"
        )


def _check_terrain(world: World, protocol: SurveyProtocol) -> None:
    _check_ground(world)
    _check_depth(world, protocol)


def _check_depth(world: World, protocol: SurveyProtocol) -> None:
    """The whole vehicle is under water wherever it may go."""
    box, ground = world.bounds, world.terrain
    # The grid points around each side as well: the ground in between is interpolated from them.
    rows, cols = (
        slice(math.floor((low - origin) / ground.spacing), math.ceil((high - origin) / ground.spacing) + 1)
        for low, high, origin in ((box.y_min, box.y_max, ground.y0), (box.x_min, box.x_max, ground.x0))
    )
    highest = float(ground.heights[rows, cols].max())
    room = protocol.altitude + 0.5 * protocol.body_height
    if highest + room >= 0.0:
        raise ValueError(
            f"terrain.heights: expected a seabed below z = {-room:g} inside the bounds, so that the vehicle "
            f"is under water {protocol.altitude:g} m above it, got {highest:g}"
        )


def _check_start(name: str, start: SE2, world: World, protocol: SurveyProtocol) -> None:
    box = world.bounds
    # The vehicle fits, with a cell to spare: the cell of the map that a side cuts through is not free.
    margin = protocol.body_radius + protocol.cell
    if not box.contains(start.x, start.y, margin - 1e-9):
        raise ValueError(
            f"{name}: expected a place inside the bounds x {box.x_min:g}..{box.x_max:g}, "
            f"y {box.y_min:g}..{box.y_max:g}, {margin:g} m from every side, got ({start.x:g}, {start.y:g})"
        )
    for axis, value in (("x", start.x), ("y", start.y)):
        if not _on_lattice(value, protocol.lattice):
            raise ValueError(f"{name}.{axis}: expected a multiple of {protocol.lattice} m, got {value}")
    if not _on_lattice(start.yaw, protocol.heading_step) or abs(start.yaw) > math.pi + 1e-9:
        raise ValueError(
            f"{name}.yaw: expected a multiple of {math.degrees(protocol.heading_step):g}° in (−π, π], "
            f"got {start.yaw} rad"
        )


def _check_mesh(name: str, mesh: Mesh) -> None:
    for field, array, width in (
        ("vertices", mesh.vertices, 3),
        ("faces", mesh.faces, 3),
        ("colors", mesh.colors, 3),
    ):
        if array.ndim != 2 or array.shape[1] != width or not len(array):
            raise ValueError(
                f"{name}.{field}: expected a table of {width} columns with at least a row, got {array.shape}"
            )
    if len(mesh.colors) != len(mesh.vertices):
        raise ValueError(
            f"{name}.colors: expected {len(mesh.vertices)}, one a vertex, got {len(mesh.colors)}"
        )
    _check_finite(f"{name}.vertices", mesh.vertices, ". Are they in millimetres?")
    low, high = int(mesh.faces.min()), int(mesh.faces.max())
    if low < 0 or high >= len(mesh.vertices):
        raise ValueError(
            f"{name}.faces: expected vertices 0 to {len(mesh.vertices) - 1}, got {low if low < 0 else high}"
        )


def _check_table(name: str, table: Instances, meshes: int) -> None:
    count = len(table)
    if count > MOST_INSTANCES:
        raise ValueError(f"{name}: expected at most {MOST_INSTANCES:,} rows, got {count:,}")
    shapes: dict[str, tuple[int, ...]] = {
        "mesh": (count,),
        "position": (count, 3),
        "wxyz": (count, 4),
        "scale": (count, 3),
        "tint": (count, 3),
        "group": (count,),
    }
    for field, shape in shapes.items():
        array = getattr(table, field)
        if array.shape != shape:
            raise ValueError(f"{name}.{field}: expected shape {shape}, got {array.shape}")
        _check_finite(f"{name}.{field}", array)
    _check_rows(f"{name}.mesh", (table.mesh >= 0) & (table.mesh < meshes), table.mesh, f"0 to {meshes - 1}")
    length = np.sqrt((table.wxyz.astype(np.float64) ** 2).sum(axis=1))
    _check_rows(f"{name}.wxyz", np.asarray(np.abs(length - 1.0) < 1e-3), length, "a quaternion of length 1")
    smallest = table.scale.min(axis=1, initial=np.inf)
    _check_rows(f"{name}.scale", np.asarray(smallest > 0.0), smallest, "more than 0")
    least = table.tint.min(axis=1, initial=np.inf)
    _check_rows(f"{name}.tint", np.asarray(least >= 0.0), least, "0 or more")
    _check_rows(f"{name}.group", table.group >= -1, table.group, "−1 or more")


def is_near(mesh: Mesh) -> bool:
    """Has it vertices, and all of them where any may be?"""
    return len(mesh.vertices) > 0 and bool((np.abs(mesh.vertices) <= FARTHEST).all())


def _check_size(name: str, table: Instances, world: World) -> None:
    """Nothing is far larger than the ground it stands on, as it is where millimetres are taken for metres."""
    sides = np.array([np.ptp(mesh.vertices.astype(np.float64), axis=0) for mesh in world.meshes])
    _, middle, longest = np.sort(sides[table.mesh] * table.scale, axis=1).T
    box = world.bounds
    side = max(box.width, box.depth)
    small = ~world.hull if name == "targets" else np.zeros(len(table), np.bool_)
    most = np.where(middle <= SLENDER * longest, LARGEST * side, side)
    for k in np.flatnonzero(~small & (longest > most) & (longest <= LARGEST * side)):
        if _goes_round(world.meshes[table.mesh[k]], table, int(k), box):
            most[k] = LARGEST * side
    most[small] = LARGEST_INDIVIDUAL
    row = int((longest / most).argmax())
    if longest[row] > most[row]:
        within = (
            "of an individual that is no part of a hull"
            if small[row]
            else f"in bounds of {box.width:g} x {box.depth:g} m"
        )
        raise ValueError(
            f"{name}, row {row + 1}: expected at most {most[row]:g} m {within}, got {longest[row]:g} m "
            f"(mesh {table.mesh[row]}). Are its lengths in millimetres? Export metres, or give it a scale of "
            "0.001"
        )
    row = int(longest.argmin())
    if longest[row] < SMALLEST:
        raise ValueError(
            f"{name}, row {row + 1}: expected a mesh of a millimetre or more, got {longest[row]:g} m (mesh "
            f"{table.mesh[row]}). Are its lengths in metres?"
        )


def _goes_round(mesh: Mesh, table: Instances, row: int, box: Bounds) -> bool:
    """Do the walls of a mesh go round the bounds, seen from above, where this row of the table puts it?"""
    points = table.position[row] + rotated(table.wxyz[row], table.scale[row] * mesh.vertices)
    (x0, y0, _), (x1, y1, _) = points.min(axis=0), points.max(axis=0)
    return bool(x0 <= box.x_min and y0 <= box.y_min and box.x_max <= x1 and box.y_max <= y1)


def _check_rows(name: str, holds: npt.NDArray[np.bool_], values: npt.NDArray[Any], expected: str) -> None:
    if not holds.all():
        row = int(np.argmin(holds))
        raise ValueError(f"{name}, row {row + 1}: expected {expected}, got {values[row]:g}")


def _check_finite(name: str, values: npt.NDArray[Any], hint: str = "") -> None:
    bad = ~(np.abs(values) <= FARTHEST) if values.dtype.kind == "f" else np.zeros(1, np.bool_)
    if bad.any():
        place = tuple(int(k) for k in np.argwhere(bad)[0])
        where = ", ".join(f"{axis} {k + 1}" for axis, k in zip(("row", "column"), place, strict=False))
        raise ValueError(
            f"{name}, {where}: expected a number within ±{FARTHEST:g}, got {values[place]}"
            + hint * bool(np.isfinite(values[place]))
        )


def _on_lattice(value: float, spacing: float) -> bool:
    return abs(value / spacing - round(value / spacing)) < 1e-6
