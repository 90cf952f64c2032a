"""Pictures to learn from: views of simulated worlds, lit but without water, with their labels and depth.

Water, lamps and the camera's own faults come on top each time a picture is learned from; see `waters`.
"""

from __future__ import annotations

import contextlib
import math
import mmap
from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.evaluation.engines import Engine, Failure
from dream.files import whole_or_nothing
from dream.geometry import SE3, Camera, camera_mount
from dream.perception.sight import HEIGHT, WIDTH
from dream.sim.habitats import HABITATS
from dream.sim.meshes import icosphere, mesh
from dream.sim.render import Renderer
from dream.sim.sounding import Sounder, altitude
from dream.sim.water import Water
from dream.sim.world import Instances, Mesh, World
from dream.sim.worlds import make_world

Random = np.random.Generator

SEEDS = 2_000_000
"""Of the worlds that are learned from, upwards: no suite has any of them."""
KINDS = (
    *HABITATS,
    *("reef/string", "reef/patch", "reef/mixed", "reef/fringing", "reef/K"),
    *(f"wreck/{number}" for number in range(1, 6)),
    *("wreck/5+reef/patch", "wreck/3+reef/string", "wreck/1", "wreck/2"),
)
"""Worlds, in equal shares."""
CLEAR = Water("none", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Takes nothing and adds nothing."""
NEAREST = 0.25
"""Metres: a view with anything nearer is none that a vehicle has."""
EMPTY = 0.9
"""Share of a view without anything in it from which most such views are left out."""
TRIES = 8
"""Views that are looked for, for each that is kept."""

PICTURE = np.dtype(
    [
        ("rgb", np.uint8, (HEIGHT, WIDTH, 3)),
        ("depth", np.float16, (HEIGHT, WIDTH)),
        ("labels", np.uint8, (HEIGHT, WIDTH)),
        ("camera", np.float32, (4,)),
        ("rotation", np.float32, (3, 3)),
        ("position", np.float32, (3,)),
        ("altitude", np.float32),
    ]
)
"""One view: colours as in air; metres along the optical axis, NaN where nothing is; `Label`s; fx, fy, cx and
cy; rotation and position of the camera in the world; metres of the vehicle above what its DVL sees."""


@dataclass(frozen=True, slots=True)
class Album:
    """The pictures that one file holds: some views of each of some worlds."""

    number: int
    worlds: int
    views: int
    """Of each world."""
    seed: int

    def __len__(self) -> int:
        return self.worlds * self.views

    def file(self, folder: Path) -> Path:
        """Where it is kept."""
        return folder / f"{self.seed}-{self.number:04d}-{self.worlds}x{self.views}.pictures"


def drawn(albums: list[Album], folder: Path, engine: Engine) -> Generator[Path, None, None]:
    """Draw what is missing in a folder, and yield the file of every album as it is there.

    Raises:
        ValueError: One could not be drawn; the others are kept.
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = [album for album in albums if not album.file(folder).is_file()]
    yield from (album.file(folder) for album in albums if album.file(folder).is_file())
    with contextlib.closing(engine.run(partial(draw, folder=folder), [[album] for album in missing])) as done:
        for album, outcome in done:
            if isinstance(outcome, Failure):
                raise ValueError(f"album {album.number}: {outcome.message}")
            yield outcome


def opened(path: Path) -> npt.NDArray[Any]:
    """The pictures of an album, read as they are asked for.

    Raises:
        ValueError: The file is damaged, or no album.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        if size == 0 or size % PICTURE.itemsize:
            raise ValueError(f"{path}: expected pictures to learn from, got a damaged file. Delete it")
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    return np.frombuffer(content, PICTURE)


def draw(album: Album, folder: Path) -> Path:
    """Draw an album, and write it whole or not at all. The same again for the same album."""
    pictures = np.zeros(len(album), PICTURE)
    for k in range(album.worlds):
        number = album.number * album.worlds + k
        rng = np.random.default_rng([album.seed, number])
        name = KINDS[int(rng.integers(len(KINDS)))]
        world = strange(make_world(name, SEEDS + number), rng)
        at = k * album.views
        _fill(pictures[at : at + album.views], replace(world, water=CLEAR), rng)
    path = album.file(folder)
    with whole_or_nothing(path) as partial_file, partial_file.open("wb") as file:
        file.write(pictures.tobytes())
    return path


def strange(world: World, rng: Random) -> World:
    """The world with sizes, proportions and tints that its kind does not have, and with things strewn in.

    What is strewn are superellipsoids (Barr, *IEEE Computer Graphics and Applications*, 1981): posts, plates,
    boxes and balls, which are obstacles.
    """
    meshes = [*world.meshes, *(_superellipsoid(rng) for _ in range(6))]
    things = _strewn(world, len(world.meshes), rng)
    return replace(
        world,
        meshes=tuple(meshes),
        targets=world.targets if world.hull.all() else _reshaped(world.targets, world.hull, rng),
        obstacles=_joined(_reshaped(world.obstacles, np.zeros(len(world.obstacles), np.bool_), rng), things),
    )


def _reshaped(these: Instances, fixed: npt.NDArray[np.bool_], rng: Random) -> Instances:
    """Larger or smaller all together, each stretched a little, and in other tints; hulls stay whole."""
    free = ~fixed[:, None]
    stretch = math.exp(rng.normal(0.0, 0.25)) * np.exp(rng.normal(0.0, 0.15, (len(these), 3)))
    tint = np.exp(rng.normal(0.0, 0.15, (len(these), 3)) + rng.normal(0.0, 0.2, (len(these), 1)))
    return replace(
        these,
        scale=np.where(free, these.scale * stretch, these.scale).astype(np.float32),
        tint=np.where(free, these.tint * tint, these.tint).astype(np.float32),
    )


def _joined(one: Instances, other: Instances) -> Instances:
    return Instances(
        *(
            np.concatenate([getattr(one, name), getattr(other, name)])
            for name in ("mesh", "position", "wxyz", "scale", "tint", "group")
        )
    )


def _superellipsoid(rng: Random) -> Mesh:
    """Of unit half axes, in one colour, rough or smooth."""
    points, faces = icosphere(3)
    east_west, up_down = np.exp(rng.uniform(math.log(0.12), math.log(1.4), 2))
    flat = np.hypot(points[:, 0], points[:, 1])
    lat, lon = np.arctan2(points[:, 2], flat), np.arctan2(points[:, 1], points[:, 0])

    def power(values: npt.NDArray[np.float64], exponent: float) -> npt.NDArray[np.float64]:
        raised: npt.NDArray[np.float64] = np.sign(values) * np.abs(values) ** exponent
        return raised

    around = power(np.cos(lat), up_down)
    shape = np.stack(
        [
            around * power(np.cos(lon), east_west),
            around * power(np.sin(lon), east_west),
            power(np.sin(lat), up_down),
        ],
        axis=1,
    )
    shape *= 1.0 + rng.choice([0.0, 0.05, 0.12]) * rng.normal(size=(len(shape), 1))
    colour = rng.integers(20, 230) + rng.normal(0.0, 25.0, 3)
    colours = np.clip(colour + rng.normal(0.0, rng.uniform(0.0, 15.0), (len(shape), 1)), 5, 250)
    return mesh(shape, faces, colours)


def _strewn(world: World, first: int, rng: Random) -> Instances:
    """Things on and above the ground near targets and elsewhere; meshes from number `first` on."""
    count = int(rng.integers(0, 40))
    bounds, near = world.bounds, world.targets.position
    x = rng.uniform(bounds.x_min, bounds.x_max, count)
    y = rng.uniform(bounds.y_min, bounds.y_max, count)
    if len(near):
        beside = rng.random(count) < 0.6
        around = near[rng.integers(0, len(near), count)]
        x = np.where(beside, around[:, 0] + rng.normal(0.0, 3.0, count), x)
        y = np.where(beside, around[:, 1] + rng.normal(0.0, 3.0, count), y)
    scale = np.exp(rng.uniform(math.log(0.06), math.log(0.9), (count, 3)))
    upright = rng.random(count) < 0.4
    scale[upright, 2] = np.exp(rng.uniform(math.log(0.5), math.log(2.5), int(upright.sum())))
    turned = rng.normal(size=(count, 4)) * np.where(upright, 0.05, 1.0)[:, None]
    turned[:, 0] += upright * 1.0
    lifted = np.where(rng.random(count) < 0.15, rng.uniform(0.3, 2.0, count), rng.uniform(-0.4, 0.6, count))
    z = world.terrain.height(x, y) + lifted * scale[:, 2]
    return Instances(
        mesh=(first + rng.integers(0, 6, count)).astype(np.int32),
        position=np.stack([x, y, z], axis=1).astype(np.float32),
        wxyz=(turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32),
        scale=scale.astype(np.float32),
        tint=np.exp(rng.normal(0.0, 0.2, (count, 3))).astype(np.float32),
        group=np.full(count, -1, np.int32),
    )


def _fill(pictures: npt.NDArray[Any], world: World, rng: Random) -> None:
    """Draw views of a world until there are enough; the last is drawn again where too few are found."""
    renderer = Renderer(world)
    sounder = Sounder(renderer)
    found = 0
    for _ in range(TRIES * len(pictures)):
        camera, T_world_base, mount = _pose(world, rng)
        T_world_camera = T_world_base @ mount
        try:
            above = altitude(sounder.ranges(T_world_base))
            depth = renderer.measure(camera, T_world_camera).depth
        except ValueError:  # The camera is inside something, or the view is too wide to be drawn.
            continue
        empty = float(np.isnan(depth).mean())
        if not math.isfinite(above) or np.nanmin(depth, initial=math.inf) < NEAREST:
            continue
        if empty > EMPTY and rng.random() < 0.8:
            continue
        frame = renderer.render(camera, T_world_camera)
        one = pictures[found]
        one["rgb"], one["depth"], one["labels"] = frame.rgb, frame.depth, frame.labels
        one["camera"] = camera.fx, camera.fy, camera.cx, camera.cy
        one["rotation"], one["position"] = T_world_camera.rotation, T_world_camera.translation
        one["altitude"] = above
        found += 1
        if found == len(pictures):
            return
    if found == 0:
        raise ValueError(f"{world.name} {world.seed}: expected a free view, found none")
    pictures[found:] = pictures[np.arange(len(pictures) - found) % found]


def _pose(world: World, rng: Random) -> tuple[Camera, SE3, SE3]:
    """Camera, `T_world_base` and `T_base_camera`: mostly near a target, and looking at it."""
    bounds, near = world.bounds, world.targets.position
    if rng.random() < 0.75 and len(near):
        at, away, bearing = (
            near[int(rng.integers(len(near)))],
            rng.uniform(0.5, 9.0),
            rng.uniform(-math.pi, math.pi),
        )
        x, y = float(at[0]) - away * math.cos(bearing), float(at[1]) - away * math.sin(bearing)
        yaw = bearing + rng.normal(0.0, 0.5)
    else:
        x, y = rng.uniform(bounds.x_min, bounds.x_max), rng.uniform(bounds.y_min, bounds.y_max)
        yaw = rng.uniform(-math.pi, math.pi)
    up = math.exp(rng.uniform(math.log(0.6), math.log(6.0)))
    T_world_base = SE3.level(x, y, float(world.terrain.height(x, y)) + up, yaw) @ _rolled(
        *rng.normal(0.0, math.radians(3.0), 2)
    )
    level, steep, up_hill = math.radians(20.0), math.radians(45.0), math.radians(-25.0)
    tilt = rng.choice(
        [math.radians(rng.uniform(-25.0, 75.0)), steep, level, up_hill, 0.0, math.radians(85.0)],
        p=[0.5, 0.18, 0.14, 0.06, 0.06, 0.06],
    )
    fx = 0.5 * WIDTH / math.tan(0.5 * math.radians(rng.uniform(42.0, 104.0)))
    # A wider picture is squeezed into this one: 16:9 is 4:3 then with pixels a third taller than wide.
    fy = fx * (rng.uniform(0.98, 1.02) if rng.random() < 0.7 else rng.uniform(1.0, 1.36))
    cx, cy = 0.5 * WIDTH + rng.normal(0.0, 6.0), 0.5 * HEIGHT + rng.normal(0.0, 6.0)
    return Camera(WIDTH, HEIGHT, fx, fy, cx, cy), T_world_base, camera_mount(float(tilt))


def _rolled(roll: float, pitch: float) -> SE3:
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    pitched = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    rolled = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return SE3(pitched @ rolled, np.zeros(3))
