"""Light and water as tables, so that a pixel costs look-ups and no exponentials."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.protocol import POOL_V1
from dream.sim.render import textures
from dream.sim.render.ground import GroundMap, ground_map
from dream.sim.water import Water
from dream.sim.world import World

Array = npt.NDArray[Any]

TILES = np.array(
    [
        [math.log2(textures.SAND_SIZE), 1.0 / textures.SAND_METRES],
        [math.log2(textures.STONE_SIZE), 1.0 / textures.STONE_METRES],
        [math.log2(textures.CAUSTIC_SIZE), 1.0 / textures.CAUSTIC_METRES],
    ]
)
"""log2 of the texels along the side of a tile and tiles per metre, of sand, stone and caustics."""
SUN = np.array([0.30, 0.22, 0.93]) / np.linalg.norm([0.30, 0.22, 0.93])
"""Towards the light. Refraction at the surface keeps it within 49° of the zenith."""
WATER_STEP = 64.0
"""Rows of the water table per metre."""
RAYS = 48.0
"""Metres of ray that the water table covers; a longer ray sees what the longest sees."""
FADE = 0.6
"""Share of the far plane's depth at which things begin to fade into open water."""
WHITE_BALANCE = 0.55
"""How much of the light's colour the camera takes out: 0 none, 1 all."""
EXPOSURE = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Shading:
    """All that colour needs beside the scene."""

    ground: GroundMap
    foot: Array
    """(E,) float32, world z of the seabed beneath each entity."""
    light: Array
    """(L, 4) float32 by height: colour of the light from above, contrast of the caustics."""
    light_frame: Array
    """(2,) world z of the first row, rows per metre."""
    water: Array
    """(T, 7) float32 by distance: direct light, what the veil still lacks, share not yet faded by depth."""
    veil: Array
    """(3,) linear."""
    seabed: Array
    """(4, 3): colours of sand, growth and shell hash, then strength of texture and of growth."""


def shading(world: World, entity_offset: Array, far: float) -> Shading:
    """Bake the light of one world.

    Args:
        world: What is lit.
        entity_offset: (E, 3) places of the scene's entities.
        far: Depth at which everything has faded into open water.
    """
    floor = float(world.terrain.heights.min())
    foot = world.terrain.height(entity_offset[:, 0], entity_offset[:, 1]).astype(np.float32)
    light, light_frame = _light(world.water, floor)
    return Shading(
        ground=ground_map(world),
        foot=foot,
        light=light,
        light_frame=light_frame,
        water=_water_table(world.water, far),
        veil=np.array(world.water.veil),
        seabed=_TANK if world.protocol == POOL_V1.name else _SAND,
    )


# Linear albedos: quartz sand, sand under a film of algae, broken shell; then texture and growth.
_SAND = np.array([[0.44, 0.37, 0.27], [0.17, 0.17, 0.085], [0.42, 0.40, 0.36], [1.0, 0.85, 0.0]])
# A painted tank: a smooth liner, a little stained.
_TANK = np.array([[0.20, 0.42, 0.52], [0.14, 0.30, 0.36], [0.0, 0.0, 0.0], [0.12, 0.5, 0.0]])


def _light(water: Water, floor: float) -> tuple[Array, Array]:
    """Daylight by height, as a camera records it that is balanced for the floor.

    Daylight decays with the water's diffuse attenuation, which Jerlov's table gives.
    """
    per_metre = 10.0
    count = max(int(-floor * per_metre) + 2, 2)
    below = np.maximum(-floor - np.arange(count) / per_metre, 0.0)
    decay = np.array(water.attenuation)
    arriving = np.exp(-decay * -floor)
    # A camera's exposure and white balance undo most of what was lost at the floor.
    balanced = (arriving / arriving.max()) ** (1.0 - WHITE_BALANCE)
    # Nor does a camera follow the light through more than a few stops towards the surface.
    gain = np.exp(np.minimum(decay.min() * (-floor - below), 2.0))
    contrast = 0.75 * np.exp(-below / 14.0)
    light = np.column_stack([EXPOSURE * balanced[None, :] * gain[:, None], contrast])
    return light.astype(np.float32), np.array([floor, per_metre])


def _water_table(water: Water, far: float) -> Array:
    distance = (np.arange(int(RAYS * WATER_STEP)) + 0.5) / WATER_STEP
    t = np.clip((distance - FADE * far) / (far - FADE * far), 0.0, 1.0)
    left = 1.0 - t * t * (3.0 - 2.0 * t)
    lacking = np.exp(-distance[:, None] * np.array(water.backscatter))
    return np.column_stack([water.direct(distance), lacking, left]).astype(np.float32)


def encode_table() -> Array:
    """(4096,) uint8 sRGB of linear light in [0, 1] (IEC 61966-2-1)."""
    value = (np.arange(4096) + 0.5) / 4096.0
    srgb = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * srgb).astype(np.uint8)


FLAKE = 0.0035
"""Metres across a flake of marine snow."""
SNOW_BOX = 4.0
"""Metres along the side of the box of flakes that repeats through the water."""
SNOW_SHARE = 8.0
"""Flakes in the box for one that is seen: the view takes in about an eighth of it."""


def flakes(water: Water, eye: Array) -> Array:
    """(N, 3) positions of marine snow about the camera, relative to it, in world axes.

    The flakes stay where they are in the world as the camera moves through them.
    """
    seeds = np.random.default_rng(21).random((round(water.particles * SNOW_SHARE), 3))
    offset: Array = np.mod(seeds * SNOW_BOX - eye, SNOW_BOX) - 0.5 * SNOW_BOX
    return offset
