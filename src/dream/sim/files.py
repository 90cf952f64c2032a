"""Worlds on disk: a folder of open formats that other programs can write, and the hash of a world.

```
world.json      name, seed, protocol, bounds, starts, water, and what the other files must hold
terrain.npy     (rows, cols) float32 world heights; row grows with y
meshes.obj      Wavefront OBJ: one object a mesh, in the order of the tables' `mesh` column;
                `v x y z red green blue` with colours from 0 to 1, triangles only
targets.csv     one individual a line: mesh,x,y,z,qw,qx,qy,qz,sx,sy,sz,red,green,blue,group
obstacles.csv   the same
```

Lengths are written to a millimetre, quaternions to 1e-6, scales and tints to 1e-4: what the hash sees.
A damaged or inconsistent folder is refused with a ValueError that names file and field.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from dream.geometry import SE2, Bounds
from dream.sim.formats import csv, obj, read_heights, read_meshes, read_table, readable, text
from dream.sim.sampling import FACTOR, MILLIMETRE, QUATERNION, quantised
from dream.sim.validity import (
    LONGEST_NAME,
    MOST_FACES,
    MOST_INSTANCES,
    MOST_MESHES,
    MOST_SEED,
    MOST_TERRAIN,
    MOST_VERTICES,
    NAME,
    check_world,
    is_name,
)
from dream.sim.water import Water
from dream.sim.world import Terrain, World


def _named(text: str) -> str:
    if not is_name(text):
        raise ValueError(f"expected {NAME}")
    return text


CHANGED = " (changed)"
"""Stands behind the name of a world that is not, or no longer, what its name and seed give."""

Name = Annotated[str, Field(max_length=LONGEST_NAME), AfterValidator(_named)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Rate = Annotated[float, Field(ge=0.0, le=100.0)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class _Bounds(_Part):
    x_min: Finite
    y_min: Finite
    x_max: Finite
    y_max: Finite


class _Start(_Part):
    x: Finite
    y: Finite
    yaw: Finite


class _Terrain(_Part):
    x0: Finite
    y0: Finite
    spacing: Annotated[float, Field(gt=0.0, le=100.0)]
    rows: Annotated[int, Field(ge=2, le=MOST_TERRAIN)]
    cols: Annotated[int, Field(ge=2, le=MOST_TERRAIN)]


class _Water(_Part):
    name: Name
    attenuation: tuple[Rate, Rate, Rate]
    backscatter: tuple[Rate, Rate, Rate]
    veil: tuple[Share, Share, Share]
    particles: Annotated[float, Field(ge=0.0, le=1e6)]


class _Meshes(_Part):
    count: Annotated[int, Field(ge=0, le=MOST_MESHES)]
    vertices: Annotated[int, Field(ge=0, le=MOST_VERTICES)]
    faces: Annotated[int, Field(ge=0, le=MOST_FACES)]
    two_sided: list[int]
    """Indices of those that are seen from both sides."""


class _World(_Part):
    format: Literal["dream-world"]
    version: Literal[1]
    name: Name
    seed: Annotated[int, Field(ge=0, le=MOST_SEED)]
    protocol: str
    bounds: _Bounds
    starts: Annotated[list[_Start], Field(min_length=1, max_length=1000)]
    terrain: _Terrain
    water: _Water
    meshes: _Meshes
    targets: Annotated[int, Field(ge=0, le=MOST_INSTANCES)]
    """Rows of targets.csv."""
    targets_are_hull: bool
    obstacles: Annotated[int, Field(ge=0, le=MOST_INSTANCES)]
    """Rows of obstacles.csv."""


def world_hash(world: World) -> str:
    """64 hexadecimal digits of all that the world holds, rounded as it is written to disk.

    `CHANGED` behind its name does not count: the files do not say it.
    """
    digest = hashlib.sha256()

    def words(*texts: str) -> None:
        digest.update(json.dumps(texts).encode())

    def numbers(values: npt.ArrayLike, steps: int) -> None:
        array = np.rint(np.asarray(values, np.float64) * steps).astype("<i8")
        words(str(array.shape))
        digest.update(array.tobytes())

    name = world.name.removesuffix(CHANGED)
    words("dream-world 1", name, str(world.seed), world.protocol, world.water.name)
    box = world.bounds
    numbers([box.x_min, box.y_min, box.x_max, box.y_max], MILLIMETRE)
    numbers([(start.x, start.y) for start in world.starts], MILLIMETRE)
    numbers([start.yaw for start in world.starts], QUATERNION)
    numbers([world.terrain.x0, world.terrain.y0, world.terrain.spacing], MILLIMETRE)
    numbers(world.terrain.heights, MILLIMETRE)
    water = world.water
    numbers([*water.attenuation, *water.backscatter, *water.veil, water.particles], QUATERNION)
    numbers([mesh.two_sided for mesh in world.meshes], 1)
    for mesh in world.meshes:
        numbers(mesh.vertices, MILLIMETRE)
        numbers(mesh.faces, 1)
        numbers(mesh.colors, 1)
    numbers(world.targets_are_hull, 1)
    for table in (world.targets, world.obstacles):
        numbers(table.mesh, 1)
        numbers(table.position, MILLIMETRE)
        numbers(table.wxyz, QUATERNION)
        numbers(table.scale, FACTOR)
        numbers(table.tint, FACTOR)
        numbers(table.group, 1)
    return digest.hexdigest()


def save_world(world: World, folder: Path | str) -> None:
    """Write the world into the folder, which is made if it is not there.

    Raises:
        ValueError: The world is inconsistent.
        OSError: The folder cannot be written.
    """
    check_world(world)
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write(world, folder)
    except OSError as error:
        why = error.strerror or error
        raise OSError(
            f"world: expected a folder that can be made and written, got {folder} ({why}). "
            "Choose another with --out"
        ) from error


def _write(world: World, folder: Path) -> None:
    np.save(
        folder / "terrain.npy", quantised(world.terrain.heights, MILLIMETRE).astype("<f4"), allow_pickle=False
    )
    (folder / "meshes.obj").write_text(obj(world.meshes), encoding="ascii")
    (folder / "targets.csv").write_text(csv(world.targets), encoding="ascii")
    (folder / "obstacles.csv").write_text(csv(world.obstacles), encoding="ascii")
    box, ground, water = world.bounds, world.terrain, world.water
    content = {
        "format": "dream-world",
        "version": 1,
        "name": world.name,
        "seed": world.seed,
        "protocol": world.protocol,
        "bounds": {"x_min": box.x_min, "y_min": box.y_min, "x_max": box.x_max, "y_max": box.y_max},
        "starts": [{"x": start.x, "y": start.y, "yaw": start.yaw} for start in world.starts],
        "terrain": {
            "x0": ground.x0,
            "y0": ground.y0,
            "spacing": ground.spacing,
            "rows": ground.heights.shape[0],
            "cols": ground.heights.shape[1],
        },
        "water": {
            "name": water.name,
            "attenuation": water.attenuation,
            "backscatter": water.backscatter,
            "veil": water.veil,
            "particles": water.particles,
        },
        "meshes": {
            "count": len(world.meshes),
            "vertices": sum(len(mesh.vertices) for mesh in world.meshes),
            "faces": sum(len(mesh.faces) for mesh in world.meshes),
            "two_sided": [k for k, mesh in enumerate(world.meshes) if mesh.two_sided],
        },
        "targets": len(world.targets),
        "targets_are_hull": world.targets_are_hull,
        "obstacles": len(world.obstacles),
    }
    # Last, so that a folder with a world.json is whole.
    (folder / "world.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def load_world(folder: Path | str) -> World:
    """The world in the folder.

    Raises:
        ValueError: A file is missing, damaged or too large, or does not fit the others. The message
            names the file and the field, what was expected and what was found.
    """
    folder = Path(folder)
    content = _manifest(readable(folder / "world.json"))
    try:
        bounds = Bounds(**content.bounds.model_dump())
    except ValueError as error:
        raise ValueError(f"world.json: {error}") from None
    heights = read_heights(readable(folder / "terrain.npy"), (content.terrain.rows, content.terrain.cols))
    parts = content.meshes
    if any(not 0 <= k < parts.count for k in parts.two_sided):
        raise ValueError(
            f"world.json: meshes.two_sided: expected indices of {parts.count} meshes, "
            f"got {parts.two_sided[:10]}"
        )
    world = World(
        name=content.name,
        seed=content.seed,
        protocol=content.protocol,
        bounds=bounds,
        starts=tuple(SE2(start.x, start.y, start.yaw) for start in content.starts),
        terrain=Terrain(heights, content.terrain.x0, content.terrain.y0, content.terrain.spacing),
        meshes=read_meshes(
            readable(folder / "meshes.obj"),
            (parts.count, parts.vertices, parts.faces),
            parts.two_sided,
        ),
        targets=read_table(readable(folder / "targets.csv"), content.targets),
        targets_are_hull=content.targets_are_hull,
        obstacles=read_table(readable(folder / "obstacles.csv"), content.obstacles),
        water=Water(**content.water.model_dump()),
    )
    check_world(world)
    return world


def _manifest(path: Path) -> _World:
    try:
        return _World.model_validate_json(text(path))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or "the file"
        found = repr(first["input"])
        raise ValueError(f"{path.name}: {field}: {first['msg']}, got {found[:80]}") from None
