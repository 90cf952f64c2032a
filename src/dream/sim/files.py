"""Worlds on disk: a folder of open formats that other programs can write, and the hash of a world.

```
world.json      name, seed, protocol, bounds, starts, water, the least radius of a group, and what the
                other files must hold
terrain.npy     (rows, cols) float32 world heights; row grows with y
meshes.obj      Wavefront OBJ: one object a mesh, in the order of the tables' `mesh` column;
                `v x y z red green blue` with colours from 0 to 1, and faces; see `wavefront`
targets.csv     one individual a line: mesh,x,y,z,qw,qx,qy,qz,sx,sy,sz,red,green,blue,group; and hull, where
                some are and some are not
obstacles.csv   the same, without hull
```

Lengths are written to a millimetre, quaternions to 1e-6, scales and tints to 1e-4: what the hash sees.
A damaged or inconsistent folder is refused with a ValueError that names file and field; `examine` says all
that is amiss, and what was turned or taken in another way than it stands there.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from dream.geometry import SE2, Bounds
from dream.protocol import PROTOCOLS
from dream.sim.formats import MOST_TOLD, Said, csv, read_heights, read_table, readable, text
from dream.sim.sampling import FACTOR, MILLIMETRE, QUATERNION, quantised, rotated
from dream.sim.validity import (
    FARTHEST,
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
    problems,
)
from dream.sim.water import Water
from dream.sim.wavefront import obj, read_meshes
from dream.sim.world import GROUP_RADIUS, BoolArray, Instances, Mesh, Terrain, World
from dream.telling import one_line


def _named(text: str) -> str:
    if not is_name(text):
        raise ValueError(f"expected {NAME}")
    return text


T = TypeVar("T")
_NO_INDEX, _NO_NUMBER = np.empty(0, np.int32), np.empty((0, 3), np.float32)
_NO_INSTANCES = Instances(
    _NO_INDEX, _NO_NUMBER, np.empty((0, 4), np.float32), _NO_NUMBER, _NO_NUMBER, _NO_INDEX
)
logger = logging.getLogger(__name__)
FILES = ("world.json", "terrain.npy", "meshes.obj", "targets.csv", "obstacles.csv")
LONG = 4.0
"""Times its other sides that a body is long which may stand as a post, or lie as a pipe."""
MOST_STANDING = 10_000
"""Starts that are asked whether a mesh goes round them."""
MOST_LOGGED = 3
"""Lines on the log of what was turned in a world."""
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
    up: Literal["y", "z"] | None = None
    """Which axis of meshes.obj is up, where somebody says: y is turned to z."""


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
    targets_are_hull: bool | Literal["mixed"]
    """Of all; mixed where the table says it of each."""
    obstacles: Annotated[int, Field(ge=0, le=MOST_INSTANCES)]
    """Rows of obstacles.csv."""
    group_radius: Finite = GROUP_RADIUS


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
    numbers(world.hull if _mixed(world) else world.hull.any(), 1)
    for table in (world.targets, world.obstacles):
        numbers(table.mesh, 1)
        numbers(table.position, MILLIMETRE)
        numbers(table.wxyz, QUATERNION)
        numbers(table.scale, FACTOR)
        numbers(table.tint, FACTOR)
        numbers(table.group, 1)
    if world.group_radius != GROUP_RADIUS:
        # Left out where it is the usual, so that worlds from before it was told keep their hash.
        words("group_radius")
        numbers(world.group_radius, MILLIMETRE)
    return digest.hexdigest()


def _mixed(world: World) -> bool:
    """Are some individuals hull, and some not?"""
    return bool(world.hull.any() and not world.hull.all())


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
    kinds = world.hull if _mixed(world) else None
    (folder / "targets.csv").write_text(csv(world.targets, kinds), encoding="ascii")
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
        "targets_are_hull": "mixed" if _mixed(world) else bool(world.hull.any()),
        "obstacles": len(world.obstacles),
        "group_radius": world.group_radius,
    }
    # Last, so that a folder with a world.json is whole.
    (folder / "world.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Examined:
    """A folder, all its files read."""

    world: World | None
    """None where anything is refused."""
    said: tuple[Said, ...]
    """By file: what was refused, turned, or taken in another way than it stands there."""


def load_world(folder: Path | str) -> World:
    """The world in the folder. What was turned in it is told on the log, once in a process.

    Raises:
        ValueError: A file is missing, damaged or too large, or does not fit the others. The message
            names the file and the field, what was expected and what was found.
    """
    examined = examine(folder)
    if examined.world is not None:
        told = [str(said) for said in examined.said if said.what == "turned"]
        if (left := len(told) - MOST_LOGGED) > 0:
            told[MOST_LOGGED:] = [f"and {left} more turned: dream worlds --check {folder}"]
        for words in told:
            _log_once(f"{folder}: {words}")
        return examined.world
    refused = [said for said in examined.said if said.what == "refused"]
    more = f" (and {len(refused) - 1} more: dream worlds --check {folder})" if len(refused) > 1 else ""
    raise ValueError(f"{refused[0]}{more}")


@lru_cache(maxsize=256)
def _log_once(words: str) -> None:
    """A benchmark reads a world again for each of its missions."""
    logger.warning("%s", words)


def examine(folder: Path | str) -> Examined:
    """Read all files of a world, as far as each can be read, and say what becomes of them."""
    folder, said = Path(folder), list[Said]()

    def tried(name: str, read: Callable[[Path], T], instead: T) -> T:
        try:
            return read(readable(folder / name))
        except ValueError as error:
            said.append(Said("refused", name, str(error).removeprefix(f"{name}: ")))
            return instead

    content = tried("world.json", lambda path: _manifest(path, said), None)
    counts, two_sided, up, shape = None, list[int](), None, None
    if content is not None:
        parts = content.meshes
        counts, two_sided, up = (parts.count, parts.vertices, parts.faces), parts.two_sided, parts.up
        shape = (content.terrain.rows, content.terrain.cols)

    def meshes_of(path: Path) -> tuple[tuple[Mesh, ...], list[str]]:
        standing = None
        if content is not None and content.protocol in PROTOCOLS:
            standing = partial(_standing, _starts(content, heights), (targets, obstacles))
        meshes, names, told = read_meshes(path, counts, set(two_sided), y_up=up == "y", standing=standing)
        said.extend(told)
        return meshes, names

    def table_of(path: Path, rows: int | None, kinds: bool = False) -> tuple[Instances, BoolArray]:
        table, hull, told = read_table(path, rows, kinds=kinds)
        said.extend(told)
        return table, hull

    # Seabed that nobody sees, so that all else can be held against the bounds.
    deep = np.broadcast_to(np.float32(-FARTHEST), shape or (2, 2))
    heights = tried("terrain.npy", lambda path: deep if shape is None else read_heights(path, shape), deep)
    nothing: tuple[tuple[Mesh, ...], list[str]] = ((), [])
    kinds = content is not None and content.targets_are_hull == "mixed"
    (targets, hull), (obstacles, _) = (
        tried(name, partial(table_of, rows=rows, kinds=kinds), (_NO_INSTANCES, np.empty(0, np.bool_)))
        for name, rows, kinds in (
            ("targets.csv", None if content is None else content.targets, kinds),
            ("obstacles.csv", None if content is None else content.obstacles, False),
        )
    )
    meshes, names = tried("meshes.obj", meshes_of, nothing)
    said.sort(key=lambda one: FILES.index(one.file))
    if content is None:
        return Examined(None, tuple(said))
    world = World(
        name=content.name,
        seed=content.seed,
        protocol=content.protocol,
        bounds=Bounds(**content.bounds.model_dump()),
        starts=tuple(SE2(start.x, start.y, start.yaw) for start in content.starts),
        terrain=Terrain(heights, content.terrain.x0, content.terrain.y0, content.terrain.spacing),
        meshes=meshes,
        targets=targets,
        hull=hull if kinds else np.full(len(targets), content.targets_are_hull),
        obstacles=obstacles,
        water=Water(**content.water.model_dump()),
        group_radius=content.group_radius,
    )
    # What follows from what is refused already is not told again.
    spoilt = {one.file for one in said if one.what == "refused"}
    if "meshes.obj" in spoilt:
        spoilt |= {"targets.csv", "obstacles.csv"}
    found = [(_file_of(words), words) for words in problems(world)]
    if up is None and not (found or spoilt):
        for what, words in _lying(world, names):
            if what == "refused":
                found.append(("meshes.obj", words))
            else:
                said.append(Said(what, "meshes.obj", words))
    found = [(file, words) for file, words in found if file not in spoilt]
    said += [Said("refused", file, words) for file, words in found[:MOST_TOLD]]
    if len(found) > MOST_TOLD:
        said.append(Said("refused", "world.json", f"{len(found) - MOST_TOLD} more findings like these"))
    return Examined(None if any(one.what == "refused" for one in said) else world, tuple(said))


def _starts(content: _World, heights: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """(N, 3) where the vehicle begins, in the world."""
    part = content.terrain
    x, y = np.array([(start.x, start.y) for start in content.starts]).T
    ground = Terrain(heights, part.x0, part.y0, part.spacing).height(x, y)
    return np.stack([x, y, ground + PROTOCOLS[content.protocol].altitude], axis=1)


def _standing(
    starts: npt.NDArray[np.float64],
    tables: tuple[Instances, ...],
    number: int,
    low: npt.NDArray[np.float32],
    high: npt.NDArray[np.float32],
) -> npt.NDArray[np.float64]:
    """(N, 3) the starts in a mesh's frame, of each place where it stands, that are within low and high; about
    MOST_STANDING of them."""
    found, count = [np.empty((0, 3))], 0
    for table in tables:
        for row in np.flatnonzero((table.mesh == number) & (table.scale > 0.0).all(axis=1)):
            if count > MOST_STANDING:
                break
            points = rotated(table.wxyz[row] * (1, -1, -1, -1), starts - table.position[row])
            points = points / table.scale[row]
            found.append(points[((low <= points) & (points <= high)).all(axis=1)])
            count += len(found[-1])
    return np.concatenate(found)


def _file_of(words: str) -> str:
    """Where that which is amiss stands."""
    starts = {"terrain": "terrain.npy", "meshes": "meshes.obj", "targets": "targets.csv"}
    starts["obstacles"] = "obstacles.csv"
    return next((file for start, file in starts.items() if words.startswith(start)), "world.json")


def _lying(world: World, names: list[str]) -> Iterator[tuple[Literal["taken", "refused"], str]]:
    """Meshes that seem to have y up: they begin at y = 0, lie half in the ground, and nobody turned them.

    One that is long along y may be a post with y up, or a pipe that is half buried: that is told.
    """
    told: set[int] = set()
    for name, table in (("targets", world.targets), ("obstacles", world.obstacles)):
        for row, k in enumerate(table.mesh.tolist()):
            if k in told:
                continue
            low, high = world.meshes[k].vertices.min(axis=0), world.meshes[k].vertices.max(axis=0)
            (x0, y0, z0), (x1, y1, z1) = low.tolist(), high.tolist()
            if not (abs(y0) <= 0.02 * (y1 - y0) and abs(z0 + z1) <= 0.2 * (z1 - z0)):
                continue
            w, x, y, z = table.wxyz[row].tolist()
            place = table.position[row].tolist()
            upright, seabed = 2.0 * (y * z + w * x), float(world.terrain.height(*place[:2]))
            if upright < 0.5 and abs(place[2] - seabed) <= 0.1 * (z1 - z0) * float(table.scale[row, 2]):
                told.add(k)
                called = f"object {k} ({one_line(names[k])[:40]})" if names[k] else f"object {k}"
                begins = f"{called}: begins at y = 0 and lies half in the seabed ({name}, row {row + 1})"
                says = 'Say "up": "y" under "meshes" in world.json and all are turned'
                if y1 - y0 > LONG * max(x1 - x0, z1 - z0):
                    yield "taken", f"{begins}, taken for a pipe along y. Is y up? {says}"
                else:
                    yield (
                        "refused",
                        f'{begins}. Is y up? {says}, or "up": "z" if it is right; or export it with z up',
                    )


def _manifest(path: Path, said: list[Said]) -> _World | None:
    """What world.json says; None where it says too little, which is then told, field by field."""
    refused: list[str] = []
    content = None
    try:
        content = _World.model_validate_json(text(path))
    except ValidationError as error:
        found = error.errors(include_url=False)
        for one in found[:MOST_TOLD]:
            field = ".".join(str(part) for part in one["loc"]) or "the file"
            refused.append(f"{field}: {one['msg']}, got {repr(one['input'])[:80]}")
        if len(found) > MOST_TOLD:
            refused.append(f"{len(found) - MOST_TOLD} more fields like these")
    else:
        parts = content.meshes
        if any(not 0 <= k < parts.count for k in parts.two_sided):
            refused.append(
                f"meshes.two_sided: expected indices of {parts.count} meshes, got {parts.two_sided[:10]}"
            )
        try:
            Bounds(**content.bounds.model_dump())
        except ValueError as error:
            refused.append(str(error))
            content = None
    said += [Said("refused", path.name, words) for words in refused]
    return content
