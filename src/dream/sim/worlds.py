"""Every world by its name, and how an arena is put together.

`make_world("reef/string", 3)` gives the same world for ever, on every machine; `reef/string+1y2` is the same
reef a year on, the second of its futures (`dream.sim.years`). `wreck/2+wreck/3` are two wrecks side by side,
and `wreck/4+reef/patch` is a wreck with a reef around it (`dream.sim.structures`). `reef/mound+40x30` is a
world of that many metres (`dream.sim.sizes`).
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from dream.geometry import Bounds
from dream.names import look_up
from dream.protocol import DREAM_V1
from dream.sim import boulders, reef_shapes
from dream.sim.files import CHANGED, load_world, world_hash
from dream.sim.habitats import HABITATS
from dream.sim.pool import pool
from dream.sim.reef_shapes import Stroke
from dream.sim.reefs import Bed, individuals, renumbered
from dream.sim.sampling import (
    MILLIMETRE,
    Float64Array,
    direction,
    index,
    quantised,
    uniform,
    uniforms,
)
from dream.sim.sizes import SIZED, TRIES, Size, SizedBuilder, sized
from dream.sim.starts import starts_in
from dream.sim.structures import around, beside
from dream.sim.terrain import APRON, grid, smoothstep, terrain, undulation
from dream.sim.terrain import SPACING as TERRAIN_SPACING
from dream.sim.validity import check_seed
from dream.sim.water import WATERS, Water
from dream.sim.world import Instances, Mesh, World
from dream.sim.wrecks import wreck
from dream.sim.years import LATER, later

Builder = Callable[[np.random.Generator], World]

NEAR = 0.6
"""Least likeness, of 0 to 1, of a word to the name of a world that it may have meant."""
SIDES = (40.0, 45.0, 50.0)
"""Metres: the sides that an arena may have."""
FLOOR = -10.0
"""World z of the nominal seabed."""
HULL_MARGIN = 4.0
"""Least metres between a wreck and the sides, so that a vehicle can go all round it."""
MOST_STRUCTURES = 4
"""Worlds that one name may join."""


def reef(shape: Callable[[Bounds, np.random.Generator], list[Stroke]], rng: np.random.Generator) -> World:
    """An arena with a reef of that shape, and boulders in and around it.

    Starts are drawn before the reef, so that they tell nothing about it.
    """
    bounds = _square(0.5 * SIDES[index(rng, 3)])
    starts = starts_in(bounds, np.empty((0, 2)), rng)
    strokes, wide = shape(bounds, rng), bounds.widened(APRON)
    bed = Bed.of(strokes, wide, rng)
    x, y = grid(wide, TERRAIN_SPACING)
    heights = undulation(wide, rng) + bed.relief(x, y, uniform(rng, 0.08, 0.17))
    seabed = terrain(FLOOR + heights, wide)
    near = np.concatenate([stroke.line for stroke in strokes])
    # A rock may stand at the rim of a small patch or in a string, but not on top of a whole small patch.
    small = [
        (*stroke.line.mean(axis=0), stroke.half_width - 2.3)
        for stroke in strokes
        if stroke.length < reef_shapes.PATCH
    ]
    taken = np.array(small).reshape(-1, 3)
    rocks = boulders.formations(bounds, starts, near, taken, rng, ring=rng.random() < 0.25)
    clumps, targets = individuals(bed, seabed, boulders.feet(rocks), bounds, rng)
    targets = dataclasses.replace(targets, group=renumbered(targets.group))
    stones = boulders.variants(rng)
    return World(
        name="reef",
        seed=0,
        protocol=DREAM_V1.name,
        bounds=bounds,
        starts=starts,
        terrain=seabed,
        meshes=clumps + stones,
        targets=targets,
        hull=np.zeros(len(targets), np.bool_),
        obstacles=boulders.placed(rocks, stones, len(clumps), seabed, rng),
        water=_sea(rng),
    )


def sunken(number: int, rng: np.random.Generator, size: Size | None = None) -> World:
    """An arena with wreck `number`, off its centre at any heading, on ground that has settled around it."""
    bounds = _square(0.5 * SIDES[index(rng, 3)]) if size is None else size.bounds
    found = wreck(number, rng)
    level = np.concatenate([mesh.vertices[:, :2] for mesh in found.meshes]).astype(np.float64)
    room = 0.5 * np.array([bounds.width, bounds.depth]) - HULL_MARGIN
    # A narrow arena has room for it at some headings only.
    for _ in range(TRIES):
        c, s = direction(uniform(rng, 0.0, 2.0 * np.pi))
        footprint = np.stack([c * level[:, 0] - s * level[:, 1], s * level[:, 0] + c * level[:, 1]], 1)
        low, high = -room - footprint.min(axis=0), room - footprint.max(axis=0)
        if (low <= high).all():
            break
    else:
        raise ValueError(
            f"area: expected room for wreck {number} and {HULL_MARGIN:g} m around it, "
            f"got {bounds.width:g}x{bounds.depth:g} m"
        )
    x0, y0 = quantised(low + uniforms(rng, 0.0, 1.0, 2) * (high - low), MILLIMETRE)
    footprint += (x0, y0)
    starts, wide = starts_in(bounds, footprint, rng), bounds.widened(APRON)
    seabed = terrain(FLOOR + _settled(wide, footprint, rng), wide)
    z0 = FLOOR
    meshes, centres = zip(*(_patch(mesh, c, s, (x0, y0, z0)) for mesh in found.meshes), strict=True)
    count = len(meshes)
    taken = _circles(footprint)
    rocks = boulders.formations(bounds, starts, np.empty((0, 2)), taken, rng, ring=rng.random() < 0.25)
    stones = boulders.variants(rng)
    return World(
        name=f"wreck/{number}",
        seed=0,
        protocol=DREAM_V1.name,
        bounds=bounds,
        starts=starts,
        terrain=seabed,
        meshes=meshes + stones,
        targets=Instances(
            mesh=np.arange(count, dtype=np.int32),
            position=np.array(centres, np.float32),
            wxyz=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
            scale=np.ones((count, 3), np.float32),
            tint=np.ones((count, 3), np.float32),
            group=renumbered(np.asarray(found.group, np.int32)),
        ),
        hull=np.ones(count, np.bool_),
        obstacles=boulders.placed(rocks, stones, count, seabed, rng),
        water=(None if size is None else size.water) or _sea(rng),
    )


def flat(rng: np.random.Generator) -> World:
    """A level seabed with nothing on it, for tests."""
    bounds = _square(20.0)
    wide = bounds.widened(APRON)
    nothing = Instances(
        mesh=np.empty(0, np.int32),
        position=np.empty((0, 3), np.float32),
        wxyz=np.empty((0, 4), np.float32),
        scale=np.empty((0, 3), np.float32),
        tint=np.empty((0, 3), np.float32),
        group=np.empty(0, np.int32),
    )
    count = round(wide.width / TERRAIN_SPACING) + 1
    return World(
        name="flat/empty",
        seed=0,
        protocol=DREAM_V1.name,
        bounds=bounds,
        starts=starts_in(bounds, np.empty((0, 2)), rng),
        terrain=terrain(np.full((count, count), FLOOR), wide),
        meshes=(),
        targets=nothing,
        hull=np.empty(0, np.bool_),
        obstacles=nothing,
        water=WATERS["clear"],
    )


WRECKS: Mapping[str, SizedBuilder] = {f"wreck/{number}": partial(sunken, number) for number in range(1, 6)}
SIZABLE: Mapping[str, SizedBuilder] = {**WRECKS, **HABITATS}
"""Those that can be made in any size."""
BUILDERS: Mapping[str, Builder] = {
    "reef/fringing": partial(reef, reef_shapes.fringes),
    "reef/string": partial(reef, reef_shapes.strings),
    "reef/patch": partial(reef, reef_shapes.patches),
    "reef/mixed": partial(reef, reef_shapes.mixed),
    **{f"reef/{which}": partial(reef, partial(reef_shapes.letter, which)) for which in reef_shapes.LETTERS},
    **WRECKS,
    "pool/arc": partial(pool, water=WATERS["pool"]),
    "flat/empty": flat,
    **HABITATS,
}
"""What makes each world from a random generator."""

WORLDS: tuple[str, ...] = tuple(BUILDERS)
"""The names of all worlds."""


def make_world(name: str, seed: int) -> World:
    """The world of that name and seed; a name such as `reef/string+1y2` is that reef some years on.

    `wreck/2+wreck/3+reef/patch` is a wreck, another beside it, and a reef around both; see `structures_in`.

    Raises:
        ValueError: No world has that name, or the seed is not in [0, 2**63).
    """
    on = LATER.fullmatch(name)
    if on is not None:
        return later(make_world(on["name"], seed), float(on["years"]), int(on["seed"]))
    check_seed(seed)
    parts, wanted = structures_in(name), sized(name)
    if wanted is not None:
        kind, size = wanted
        build = look_up(SIZABLE, kind, "world that can be made in any size")
        made = build(_source(seed, name), size)
    elif parts:
        made = _built(parts[0], seed, f"{name} 0")
        for number, part in enumerate(parts[1:], 1):
            another = _built(part, seed, f"{name} {number}")
            made = (beside if another.hull.any() else around)(made, another)
    else:
        made = _built(name, seed, name)
    return dataclasses.replace(made, name=name, seed=int(seed))


def _built(name: str, seed: int, words: str) -> World:
    """What that name gives, with its randomness from the seed and these words."""
    return look_up(BUILDERS, name, "world", see="See dream worlds")(_source(seed, words))


def _source(seed: int, words: str) -> np.random.Generator:
    """Randomness from the seed and these words."""
    digest = np.frombuffer(hashlib.sha256(words.encode()).digest()[:16], "<u4")
    sequence = np.random.SeedSequence([int(seed), *(int(word) for word in digest)])
    return np.random.Generator(np.random.PCG64(sequence))


def structures_in(name: str) -> tuple[str, ...]:
    """The names that `wreck/2+wreck/3+reef/patch` is made of: a wreck, others beside it, a reef around them.

    Empty where it is no such name; 2 to `MOST_STRUCTURES` otherwise.
    """
    parts = name.split("+")
    wrecks = [part for part in parts if part in BUILDERS and part.startswith("wreck/")]
    # Those of HABITATS are of another protocol than the wrecks.
    reefs = [part for part in parts if part in BUILDERS and part.startswith("reef/") and part not in HABITATS]
    if not (wrecks and 2 <= len(parts) <= MOST_STRUCTURES and len(reefs) <= 1 and parts == wrecks + reefs):
        return ()
    return tuple(parts)


def origin(name: str) -> str | None:
    """The name of the package's world that a name is of, be it some years on or of a wanted size; None where
    it is the user's."""
    on = LATER.fullmatch(name) or SIZED.fullmatch(name)
    if on is not None:
        return origin(on["name"])
    return name if name in BUILDERS or structures_in(name) else None


def is_saved(folder: Path) -> bool:
    """Does the folder hold a world?"""
    return (folder / "world.json").is_file()


def open_world(name: str, seed: int) -> World:
    """A world by its name and seed, or the one saved in the folder of that name; see `saved_world`."""
    folder = Path(name)
    if is_saved(folder):
        return saved_world(folder)
    check_named(name, folder)
    return make_world(name, seed)


def check_named(name: str, folder: Path) -> None:
    """Raise a ValueError unless a world has that name; it says what is there in place of a folder of one."""
    if origin(name) is not None:
        return
    path_alone = Path(name).is_absolute() or name.startswith((".", "~")) or name.endswith(("/", "\\"))
    if path_alone or folder.exists():
        check_folder(folder)
    family = f"{name.partition('/')[0]}/"
    known = any(one.startswith(family) for one in BUILDERS)
    if not known and not difflib.get_close_matches(name, BUILDERS, n=1, cutoff=NEAR):
        raise ValueError(
            f'no such folder or world: "{name}". dream worlds lists the worlds; '
            f"dream worlds --save WORLD --out {name} makes a folder of one"
        )
    look_up(BUILDERS, name, "world", see="Nor is there a folder of that name. See dream worlds")


def check_folder(folder: Path) -> None:
    """Raise a ValueError that says what is there instead, unless the folder holds a world."""
    if is_saved(folder):
        return
    got = "a folder without it" if folder.is_dir() else "a file" if folder.exists() else "no such folder"
    raise ValueError(
        f"world: expected a folder with a world.json, got {got}: {folder}. Make one with dream worlds --save"
    )


def saved_world(folder: Path) -> World:
    """The world in the folder, called `reef/O (changed)` where `reef/O` of that seed is another.

    Raises:
        ValueError: See `load_world`.
    """
    world = load_world(folder)
    if origin(world.name) is None:
        return world
    try:
        same = world_hash(make_world(world.name, world.seed)) == world_hash(world)
    except ValueError:  # Such as a wreck some years on, which there is not.
        same = False
    return world if same else dataclasses.replace(world, name=world.name + CHANGED)


def _square(half: float) -> Bounds:
    """The box from −half to +half."""
    return Bounds(-half, -half, half, half)


def _sea(rng: np.random.Generator) -> Water:
    return WATERS[("clear", "coastal", "coastal", "green")[index(rng, 4)]]


def _settled(bounds: Bounds, footprint: Float64Array, rng: np.random.Generator) -> Float64Array:
    """(N, M) metres about 0: level under the wreck, scoured around it, the open seabed further off."""
    from scipy.spatial import cKDTree

    x, y = grid(bounds, TERRAIN_SPACING)
    points = np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2)
    away = np.asarray(cKDTree(footprint).query(points, distance_upper_bound=9.0)[0], np.float64)
    # Rounded well above the last digit, so that nothing below turns on how the tree sums squares.
    near = quantised(np.minimum(away, 9.0), 1_000_000).reshape(y.size, x.size)
    scour = smoothstep(0.2, 1.2, near) * (1.0 - smoothstep(1.2, 4.0, near))
    open_bed = undulation(bounds, rng) * (0.15 + 0.85 * smoothstep(1.0, 8.0, near))
    return open_bed - uniform(rng, 0.06, 0.14) * scour


def _circles(footprint: Float64Array) -> Float64Array:
    """(T, 3) circles x, y, radius that cover the wreck, for keeping boulders away."""
    squares = np.unique(np.floor(footprint), axis=0)
    return np.concatenate([squares + 0.5, np.full((len(squares), 1), 0.71)], axis=1)


def _patch(
    mesh: Mesh, c: float, s: float, origin: tuple[float, float, float]
) -> tuple[Mesh, tuple[float, float, float]]:
    """A wreck's mesh turned into the world about its own middle, and that middle.

    Vertices are rounded in the world, so that neighbours that shared an edge still do.
    """
    x, y, z = mesh.vertices.astype(np.float64).T
    turned = np.stack([c * x - s * y, s * x + c * y, z], axis=1) + origin
    turned = np.rint(turned * MILLIMETRE)
    middle = np.rint(0.5 * (turned.min(axis=0) + turned.max(axis=0)))
    vertices = ((turned - middle) / MILLIMETRE + 0.0).astype(np.float32)
    at = middle / MILLIMETRE
    return dataclasses.replace(mesh, vertices=vertices), (float(at[0]), float(at[1]), float(at[2]))
