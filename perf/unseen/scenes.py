"""What lies where: a bed with reefs, wrecks and obstacles on it, what they are made of, water and light."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.geometry import FloatArray
from dream.types import Label
from unseen import shapes
from unseen.shapes import Bed, Mesh
from unseen.textures import Texture, caustics, photographic, ripples, some_texture
from unseen.waters import Light, some_light, some_water

Float32Array = npt.NDArray[np.float32]

SANDS = (
    (0.38, 0.31, 0.21),
    (0.55, 0.50, 0.41),
    (0.24, 0.21, 0.16),
    (0.12, 0.10, 0.07),
    (0.16, 0.16, 0.14),
    (0.06, 0.06, 0.06),
)
SHELLS = (
    (0.60, 0.57, 0.50),
    (0.32, 0.31, 0.28),
    (0.22, 0.16, 0.10),
    (0.14, 0.15, 0.08),
    (0.09, 0.08, 0.06),
    (0.42, 0.36, 0.30),
)
WRECKS = (
    (0.22, 0.09, 0.04),
    (0.07, 0.06, 0.05),
    (0.16, 0.11, 0.07),
    (0.28, 0.22, 0.15),
    (0.12, 0.12, 0.11),
    (0.35, 0.18, 0.08),
)
ROCKS = ((0.20, 0.19, 0.17), (0.09, 0.09, 0.08), (0.36, 0.31, 0.25), (0.16, 0.14, 0.10))
CONCRETES = ((0.33, 0.32, 0.29), (0.22, 0.22, 0.20), (0.14, 0.14, 0.12))
PAINTS = (
    (0.55, 0.38, 0.05),
    (0.50, 0.12, 0.05),
    (0.60, 0.60, 0.58),
    (0.05, 0.05, 0.05),
    (0.08, 0.16, 0.35),
    (0.10, 0.25, 0.10),
)
GROWTH = (
    (0.05, 0.09, 0.03),
    (0.12, 0.04, 0.04),
    (0.10, 0.07, 0.03),
    (0.36, 0.20, 0.22),
    (0.07, 0.07, 0.05),
    (0.18, 0.17, 0.10),
)
"""Linear red, green and blue reflectances."""
LEAST_VISIBILITY, MOST_VISIBILITY = 3.0, 25.0
"""Metres."""
FEWEST_CLUMPS, MOST_CLUMPS = 20, 110


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A colour with grain, a second one in patches, and what settles on it."""

    colours: FloatArray
    """(3, 3) reflectances: the first, the second, and the dust's."""
    grain: Texture
    patches: Texture
    sizes: tuple[float, float]
    """Metres of a tile of each."""
    contrast: float
    """Deviation of the logarithm of the reflectance by the grain."""
    second: float
    """Deviations of the patches above which the second colour is."""
    dust: float
    """Share of what lies level that dust covers."""
    bump: float
    """Metres of the grain's height."""


def material(rng: np.random.Generator, colours: tuple[tuple[float, ...], ...], dust: FloatArray) -> Material:
    """Of one of some colours, with growth on it; `dust` is the colour of the bed."""
    first = np.array(colours[rng.integers(len(colours))])
    others = colours if rng.random() < 0.4 else GROWTH
    second = np.array(others[rng.integers(len(others))])
    mixed = np.stack([first, second, dust]) * np.exp(
        rng.normal(0.0, 0.18, (3, 1)) + rng.normal(0.0, 0.07, (3, 3))
    )
    return Material(
        np.clip(mixed, 0.01, 0.8),
        some_texture(rng),
        photographic(rng) if rng.random() < 0.6 else some_texture(rng),
        (rng.uniform(0.25, 1.2), rng.uniform(0.8, 4.0)),
        rng.uniform(0.08, 0.5),
        rng.uniform(-0.3, 1.8),
        float(rng.choice([0.0, rng.uniform(0.0, 0.5), rng.uniform(0.4, 0.9)])),
        rng.uniform(0.0, 0.006),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Triangles of one label and material."""

    mesh: Mesh
    label: Label
    material: Material


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is there to be seen."""

    parts: tuple[Part, ...]
    """The first is the bed."""
    bed: Bed
    places: FloatArray
    """(n, 2) metres: what is worth a look."""
    light: Light
    caustics: Texture | None
    """Of the sun on what it meets, where the water is shallow."""


def scene(rng: np.random.Generator, real: Path | None) -> Scene:
    """Some scene; `real` is a folder of scans, without which shapes are made up only."""
    level = -math.exp(rng.uniform(math.log(6.5), math.log(30.0)))
    light = _light(rng, level)
    relief = real / "reef_dem" / "horseshoe_8m_1cm.npz" if real else None
    scanned = None
    if relief is not None:
        scanned = np.asarray(np.load(relief, allow_pickle=False)["z"], np.float64)
    crests = np.asarray(ripples(rng).levels[0])
    bed = shapes.bed(rng, level, scanned, crests)
    sand = np.array(SANDS[rng.integers(len(SANDS))])
    parts = [Part(bed.mesh(), Label.SEABED, _sandy(rng, sand))]
    kind = rng.random()
    if kind < 0.6:
        parts += _reef(rng, bed, sand)
    if 0.5 < kind < 0.93:
        parts += _wreck(rng, bed, sand, real)
    parts += _obstacles(rng, bed, sand, real)
    places = [part.mesh.points[rng.integers(len(part.mesh.points), size=12), :2] for part in parts[1:]]
    open_bed = rng.normal(0.0, 5.0, (6, 2))
    shallow = level > -12.0 and light.surface.max() > 0.5 and rng.random() < 0.6
    return Scene(
        tuple(parts), bed, np.concatenate([open_bed, *places]), light, caustics(rng) if shallow else None
    )


def _light(rng: np.random.Generator, level: float) -> Light:
    """Of that of many waters, the one with the visibility that is most like one drawn at random."""
    wanted = rng.uniform(math.log(LEAST_VISIBILITY), math.log(MOST_VISIBILITY))
    some = [some_light(rng, some_water(rng), level + 2.0) for _ in range(40)]
    return min(some, key=lambda light: abs(math.log(1.7 / attenuation(light, level + 2.0)) - wanted))


def attenuation(light: Light, z: float) -> float:
    """Per metre, of the luminance of all light about a camera at z metres."""
    from_lamps = sum((lamp.strength for lamp in light.lamps), np.zeros(light.surface.shape))
    return light.water.attenuation(light.daylight(np.array(z)) + from_lamps)


def _sandy(rng: np.random.Generator, sand: FloatArray) -> Material:
    made = material(rng, (tuple(sand),), sand)
    grain = photographic(rng) if rng.random() < 0.45 else made.grain
    return Material(
        made.colours, grain, made.patches, (rng.uniform(0.4, 1.0), rng.uniform(3.0, 12.0)),
        rng.uniform(0.05, 0.35), rng.uniform(0.0, 2.5), 0.0, rng.uniform(0.0, 0.008),
    )  # fmt: skip


def _reef(rng: np.random.Generator, bed: Bed, sand: FloatArray) -> Iterator[Part]:
    """Clumps of oysters in mounds, strips, or here and there."""
    length = rng.uniform(0.07, 0.17)
    some = [shapes.clump(rng, int(rng.integers(8, 34)), length) for _ in range(4)]
    count = int(rng.integers(FEWEST_CLUMPS, MOST_CLUMPS))
    kind = rng.integers(3)
    if kind == 0:
        middles = rng.normal(0.0, 3.5, (int(rng.integers(1, 5)), 2))
        places = middles[rng.integers(len(middles), size=count)] + rng.normal(
            0.0, rng.uniform(0.3, 1.0), (count, 2)
        )
    elif kind == 1:
        along, turn = rng.uniform(-6.0, 6.0, count), rng.uniform(0, 2 * math.pi)
        across = rng.normal(0.0, rng.uniform(0.15, 0.6), count) + 0.05 * rng.normal() * along**2
        places = np.stack([along, across], axis=-1) @ shapes.about(np.array([0.0, 0.0, 1.0]), turn)[:2, :2]
    else:
        places = rng.normal(0.0, rng.uniform(1.0, 4.5), (count, 2))
    heights = bed.height(places[:, 0], places[:, 1])
    kinds: list[list[Mesh]] = [[], []]
    for (x, y), z in zip(places, heights, strict=True):
        at = np.array([x, y, z])
        moved = some[rng.integers(4)].moved(shapes.turned(rng, 0.15), at, rng.lognormal(0.1, 0.3))
        kinds[rng.integers(2)].append(moved)
    for meshes in kinds:
        if meshes:
            yield Part(shapes.joined(meshes), Label.TARGET, material(rng, SHELLS, sand))


def _wreck(rng: np.random.Generator, bed: Bed, sand: FloatArray, real: Path | None) -> Iterator[Part]:
    """One hull, or a part of the scanned one, half buried."""
    if real is not None and rng.random() < 0.5:
        mesh, length = shapes.scanned_wreck(real / "wreck" / "sesa_60k.ply", rng)
        lean, sunk = 0.08, rng.uniform(0.0, 0.4)
    else:
        mesh, length = shapes.hull(rng)
        lean, sunk = 0.35, rng.uniform(0.0, 0.08) * length
    x, y = rng.normal(0.0, 2.5, 2)
    place = np.array([x, y, bed.height_at(x, y) - sunk])
    yield Part(mesh.moved(shapes.turned(rng, lean), place), Label.TARGET, material(rng, WRECKS, sand))


def _obstacles(rng: np.random.Generator, bed: Bed, sand: FloatArray, real: Path | None) -> Iterator[Part]:
    """Some of a few kinds, anywhere."""
    for _ in range(int(rng.integers(0, 4))):
        make = shapes.OBSTACLES[rng.integers(len(shapes.OBSTACLES))]
        colony = real is not None and rng.random() < 0.12
        size, meshes = rng.uniform(0.2, 1.0), []
        middle = rng.normal(0.0, 4.0, 2)
        for _ in range(int(rng.integers(1, 8))):
            x, y = middle + rng.normal(0.0, 2.5, 2)
            z = bed.height_at(x, y)
            scale, sunk = 1.0, 0.05
            if colony and real is not None:
                mesh = shapes.scanned_coral(real / "reef_dem" / "mcap.ply")
                scale = rng.uniform(1.0, 4.0)
            else:
                mesh = make(rng)
                if make is shapes.boulder:
                    scale = size * rng.lognormal(0.0, 0.5)
                    sunk = -scale * rng.uniform(-0.2, 0.4)
            meshes.append(mesh.moved(shapes.turned(rng, 0.06), np.array([x, y, z - sunk]), scale))
            if make is shapes.chain:
                break
        colours = CONCRETES if make is shapes.blocks else ROCKS if make is shapes.boulder else WRECKS
        if make in (shapes.pole, shapes.pipe, shapes.tyre) and rng.random() < 0.5:
            colours = PAINTS
        yield Part(shapes.joined(meshes), Label.OBSTACLE, material(rng, GROWTH if colony else colours, sand))
