"""Pictures of made-up scenes: rays that meet triangles, light in water, and a camera that is not good."""

from __future__ import annotations

import io
import logging
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy import ndimage

from dream.geometry import SE3, Camera, FloatArray, camera_mount
from dream.perception import View
from dream.types import BoolArray, Float32Array, Label, UInt8Array
from unseen.scenes import Part, Scene, attenuation, scene
from unseen.waters import FARTHEST, SEEN, WITHIN, Light, reflected, sensor

Int32Array = npt.NDArray[np.int32]

HEIGHT, WIDTH = 240, 320
FINE = 1.5
"""Pixels of the sensor to one of the picture, along each axis."""
NEAREST = 0.3
"""Metres from the camera within which nothing is."""
BEAM = math.radians(22.5)
"""Of a DVL's beams from the vertical."""
OPEN = 0.7
"""Metres within which something keeps the light of the sky from a surface."""
RANGES = np.concatenate([[0.0], np.geomspace(0.1, 60.0, 36)])
"""Metres to which what the water sends is summed."""
LOOKS = 60
"""Poses that are tried for a picture before a scene is given up."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture and all that is true of it."""

    rgb: UInt8Array
    """(240, 320, 3)."""
    depth: Float32Array
    """(240, 320) metres along the optical axis; NaN where nothing is."""
    labels: UInt8Array
    """(240, 320) values of `Label`; water too where something is too far off to be told."""
    view: View
    """Its altitude is that of base above what the four beams of a DVL meet, along the vehicle's vertical."""
    label_range: float
    """Metres, straight: two attenuation lengths of the luminance, at most 20."""
    scene: int
    """Pictures of one number show one scene."""

    @property
    def straight(self) -> Float32Array:
        """(240, 320) metres along each ray; NaN where nothing is."""
        lengths = np.linalg.norm(_rays(self.view.camera, 1), axis=-1).astype(np.float32)
        return np.asarray(self.depth * lengths)


def pictures(seed: int, scenes: int, per_scene: int) -> Iterator[Picture]:
    """Pictures, the same for the same seed and the same folder of scans.

    Args:
        seed: Of all of them.
        scenes: How many.
        per_scene: Pictures of each.
    """
    named = os.environ.get("DREAM_REAL_DATA")
    if named is None:
        log.warning("DREAM_REAL_DATA names no folder: no scanned reef, wreck or coral among the shapes")
    for number in range(scenes):
        rng = np.random.default_rng([seed, number])
        yield from _of_scene(rng, number, per_scene, Path(named) if named else None)


def _of_scene(rng: np.random.Generator, number: int, count: int, real: Path | None) -> Iterator[Picture]:
    """Scenes are made until one has enough free views."""
    while True:
        there = scene(rng, real)
        seen = Seen(there.parts)
        views = [view for _ in range(count) if (view := _free_view(rng, there, seen)) is not None]
        if len(views) == count:
            break
    for view in views:
        yield _taken(rng, number, there, seen, view)


class Seen:
    """The triangles of a scene, for rays."""

    def __init__(self, parts: tuple[Part, ...]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        for part in parts:
            TriangleMesh(self._scene, part.mesh.points.astype(np.float32), part.mesh.faces)
        self.normals = [part.mesh.normals.astype(np.float32) for part in parts]
        self.faces = [part.mesh.faces for part in parts]

    def hits(self, origin: FloatArray, rays: FloatArray) -> Hits:
        """What rays (n, 3) from one point meet first."""
        starts = np.broadcast_to(origin.astype(np.float32), rays.shape)
        found = self._scene.run(np.ascontiguousarray(starts), rays.astype(np.float32), output=1)
        return Hits(found["geomID"], found["primID"], found["tfar"], found["u"], found["v"])

    def free(self, points: Float32Array, ways: Float32Array, most: Float32Array | float) -> BoolArray:
        """From which points (n, 3) is nothing met on the ways (n, 3), up to some multiples of these?"""
        reach = np.full(len(points), most, np.float32) if isinstance(most, float) else most
        return np.asarray(self._scene.run(points, ways, dists=reach, query="OCCLUDED") < 0)

    def normal(self, hits: Hits, chosen: npt.NDArray[np.intp]) -> Float32Array:
        """(n, 3) unit normals at some of the hits, between those at the corners."""
        normals = np.empty((len(chosen), 3), np.float32)
        for part, (faces, corners) in enumerate(zip(self.faces, self.normals, strict=True)):
            mine = np.flatnonzero(hits.part[chosen] == part)
            at = chosen[mine]
            a, b, c = (corners[faces[hits.face[at], k]] for k in range(3))
            u, v = hits.u[at, None], hits.v[at, None]
            normals[mine] = (1.0 - u - v) * a + u * b + v * c
        return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What rays meet, (n,) each."""

    part: Int32Array
    """-1 where nothing is."""
    face: Int32Array
    far: Float32Array
    """In lengths of the ray."""
    u: Float32Array
    v: Float32Array


def _rays(camera: Camera, fine: float) -> FloatArray:
    """(fine H, fine W, 3) in the camera's frame, of depth 1."""
    finer = camera.scaled(fine)
    u = (np.arange(finer.width) + 0.5 - finer.cx) / finer.fx
    v = (np.arange(finer.height) + 0.5 - finer.cy) / finer.fy
    across, down = np.meshgrid(u, v)
    return np.stack([across, down, np.ones_like(across)], axis=-1)


# Where from


def _free_view(rng: np.random.Generator, there: Scene, seen: Seen) -> View | None:
    """A view of something, with nothing too near and a bed below; None where none is found."""
    for _ in range(LOOKS):
        view = _some_view(rng, there)
        eye = view.T_world_camera
        if eye.translation[2] > -0.5:
            continue
        around = rng.normal(size=(60, 3))
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        beams = [(math.sin(BEAM) * math.cos(a), math.sin(BEAM) * math.sin(a), -math.cos(BEAM)) for a in DVL]
        ways = np.concatenate([around, np.array(beams) @ view.T_world_base.rotation.T])
        near = seen.hits(eye.translation, ways)
        distances = np.where(near.part >= 0, near.far, np.inf)
        beneath = distances[-4:]
        shown = seen.hits(eye.translation, (_rays(view.camera, 1)[::8, ::8] @ eye.rotation.T).reshape(-1, 3))
        hit = shown.part >= 0
        loss = attenuation(there.light, float(eye.translation[2]))
        within = hit & (shown.far * 1.1 < min(FARTHEST, WITHIN / loss))
        if (
            distances.min() < NEAREST
            or not np.isfinite(beneath).all()
            or shown.far[hit].min(initial=9.0) < NEAREST
        ):
            continue
        if within.mean() < 0.15 and rng.random() < 0.9:
            continue
        altitude = float(beneath.mean()) * math.cos(BEAM)
        return replace(view, altitude=altitude)
    return None


DVL = np.radians([45.0, 135.0, 225.0, 315.0])
"""Azimuths of its beams."""


def _some_view(rng: np.random.Generator, there: Scene) -> View:
    """Towards something at a distance that fits the tilt, free or not; its altitude is not known yet."""
    camera = Camera.from_fov(WIDTH, HEIGHT, math.radians(rng.uniform(60.0, 95.0)))
    tilt = math.radians(rng.choice([20.0, 45.0, rng.uniform(-25.0, 60.0)], p=[0.35, 0.3, 0.35]))
    height = math.exp(rng.uniform(math.log(0.7), math.log(5.0)))
    target = there.places[rng.integers(len(there.places))]
    away = float(np.clip(height / math.tan(max(tilt, 0.25)) * rng.uniform(0.6, 1.7), 0.8, 8.0))
    heading = rng.uniform(0, 2 * math.pi)
    x, y = target - away * np.array([math.cos(heading), math.sin(heading)])
    z = there.bed.height_at(x, y) + height
    level = SE3.level(x, y, z, heading + rng.normal(0.0, 0.25))
    roll, pitch = rng.normal(0.0, math.radians(2.5), 2)
    c, s = math.cos(pitch), math.sin(pitch)
    p, q = math.cos(roll), math.sin(roll)
    nodded = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    rolled = np.array([[1.0, 0.0, 0.0], [0.0, p, -q], [0.0, q, p]])
    base = SE3(level.rotation @ nodded @ rolled, level.translation)
    return View(camera, base, camera_mount(tilt), math.nan)


# What is seen


def _taken(rng: np.random.Generator, number: int, there: Scene, seen: Seen, view: View) -> Picture:
    """One picture."""
    eye, light = view.T_world_camera, there.light
    loss = attenuation(light, float(eye.translation[2]))
    rays = _rays(view.camera, 1)
    truth = seen.hits(eye.translation, (rays @ eye.rotation.T).reshape(-1, 3))
    there_is = truth.part >= 0
    depth = np.where(there_is, truth.far, np.nan).astype(np.float32).reshape(HEIGHT, WIDTH)
    labels = np.array([*(part.label for part in there.parts), Label.WATER], np.uint8)[truth.part]
    labels = labels.reshape(HEIGHT, WIDTH)
    labels[depth * np.linalg.norm(rays, axis=-1) > SEEN / loss] = Label.WATER
    takes = sensor(rng)
    shown = _developed(rng, _light_on_sensor(rng, there, seen, view, takes))
    return Picture(shown, depth, labels, view, min(FARTHEST, WITHIN / loss), number)


def _light_on_sensor(
    rng: np.random.Generator, there: Scene, seen: Seen, view: View, takes: FloatArray
) -> Float32Array:
    """(FINE H, FINE W, 3) linear light on red, green and blue pixels, through `takes` (10, 3)."""
    eye, light, rays = view.T_world_camera, there.light, _rays(view.camera, FINE)
    shape, lengths = rays.shape[:2], np.linalg.norm(rays, axis=-1).astype(np.float32)
    hits = seen.hits(eye.translation, (rays @ eye.rotation.T).reshape(-1, 3))
    chosen = np.flatnonzero(hits.part >= 0)
    far = np.where(hits.part >= 0, hits.far * lengths.ravel(), RANGES[-1]).astype(np.float32).reshape(shape)
    surface = _shaded(rng, there, seen, view, rays, hits, chosen, far)
    taken, water = takes.astype(np.float32), light.water
    ranges = far.ravel()[chosen, None]
    all_left, sharp_left = (np.exp(-k.astype(np.float32) * ranges) for k in (water.kept, water.beam))
    sharp, blurred = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)
    sharp.reshape(-1, 3)[chosen] = (surface * sharp_left) @ taken
    blurred.reshape(-1, 3)[chosen] = (surface * (all_left - sharp_left)) @ taken
    picture = sharp + _scattered_forward(rng, blurred, far, float(water.beam[4] - water.kept[4]))
    picture += _from_water(light, eye, rays, lengths, far, takes)
    picture += _above(rng, light, eye, rays, lengths, hits.part.reshape(shape) < 0, takes)
    return picture + _snow(rng, light, view, far, takes)


def _shaded(
    rng: np.random.Generator,
    there: Scene,
    seen: Seen,
    view: View,
    rays: FloatArray,
    hits: Hits,
    chosen: npt.NDArray[np.intp],
    far: Float32Array,
) -> Float32Array:
    """(n, 10) light that leaves the chosen hits towards the camera."""
    eye, light = view.T_world_camera, there.light
    in_camera = (rays.reshape(-1, 3)[chosen] * hits.far[chosen, None]).astype(np.float32)
    points = in_camera @ eye.rotation.T.astype(np.float32) + eye.translation.astype(np.float32)
    towards = (eye.translation - points).astype(np.float32)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normals = seen.normal(hits, chosen)
    normals *= np.where((normals * towards).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0).astype(np.float32)
    footprint = far.ravel()[chosen] / np.float32(view.camera.fx * FINE)
    colours = np.empty((len(chosen), 3), np.float32)
    bent = normals.copy()
    for number, part in enumerate(there.parts):
        mine = np.flatnonzero(hits.part[chosen] == number)
        if len(mine):
            colours[mine], bent[mine] = _surface(part, points[mine], normals[mine], footprint[mine])
    off = points + 0.004 * normals + 0.002 * towards
    open_sky = _openness(rng, seen, off, normals, chosen, far)
    sun = light.sun.astype(np.float32)
    facing = np.maximum(bent @ sun, 0.0) * seen.free(off, np.tile(sun, (len(off), 1)), 60.0)
    if there.caustics is not None:
        across = points - sun * (points[:, 2:3] / sun[2])
        lines = there.caustics.at(across[:, 0] / 3.0, across[:, 1] / 3.0, footprint / 3.0)
        facing *= np.maximum(1.0 + 0.55 * lines, 0.1)
    diffuse = open_sky * (0.5 + 0.5 * bent[:, 2] + 0.12 * (1.0 - bent[:, 2]))
    day = light.straight * facing / sun[2] + (1.0 - light.straight) * diffuse
    lit = light.daylight(points[:, 2]) * day.astype(np.float32)[:, None]
    for lamp in light.lamps:
        reaching, way, metres = lamp.reaching(in_camera, light.water)
        back = -(way @ eye.rotation.T.astype(np.float32))
        clear = seen.free(off, back, np.asarray(metres - 0.05, np.float32))
        facing = np.maximum((bent * back).sum(axis=1), 0.0) * clear
        lit += reaching * facing[:, None]
    return np.asarray(reflected(colours) * lit / np.float32(math.pi))


def _surface(
    part: Part, points: Float32Array, normals: Float32Array, footprint: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Reflectances (n, 3) and bent normals (n, 3) of points (n, 3) of a part."""
    made = part.material
    steep = np.argmax(np.abs(normals) + np.array([0.0, 0.0, 0.15], np.float32), axis=1)
    at = np.arange(len(points))
    u = points[at, (steep + 1) % 3] + 0.37 * steep
    v = points[at, (steep + 2) % 3] + 0.71 * steep
    (fine, large), step = made.sizes, np.float32(0.006)
    small = made.grain.at(u / fine, v / fine, footprint / fine)
    wide, across, along = 2.7 * fine, 0.8 * u - 0.6 * v, 0.6 * u + 0.8 * v
    grain = 0.75 * small + 0.66 * made.grain.at(across / wide, along / wide, footprint / wide)
    patches = made.patches.at(u / large, v / large, footprint / large)
    second = 1.0 / (1.0 + np.exp(-4.0 * (patches + 0.4 * grain - made.second)))
    settled = made.dust * np.clip(2.2 * normals[:, 2] - 0.6 + 0.35 * patches, 0.0, 1.0)
    first, other, dust = made.colours.astype(np.float32)
    colours = first + second[:, None] * (other - first)
    colours = colours * np.exp(np.float32(made.contrast) * grain - 0.5 * made.contrast**2)[:, None]
    colours = colours + settled[:, None] * (dust - colours)
    bent = normals.copy()
    if made.bump:
        for axis, (du, dv) in ((1, (step, 0.0)), (2, (0.0, step))):
            rise = made.grain.at((u + du) / fine, (v + dv) / fine, footprint / fine) - small
            bent[at, (steep + axis) % 3] -= np.clip(made.bump * rise / step, -0.8, 0.8) * (1.0 - settled)
        bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    return np.clip(colours, 0.005, 0.9), bent


def _openness(
    rng: np.random.Generator,
    seen: Seen,
    points: Float32Array,
    normals: Float32Array,
    chosen: npt.NDArray[np.intp],
    far: Float32Array,
) -> Float32Array:
    """(n,) share of the half space above surfaces that is open, from two rays a pixel and its neighbours'."""
    share = np.zeros(len(points), np.float32)
    rows, cols = np.divmod(chosen, far.shape[1])
    cell = (rows % 4) * 4 + cols % 4
    for turn in range(2):
        ways = rng.normal(size=(16, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        way = 1.05 * normals + ways[cell].astype(np.float32)
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-6)
        share += 0.5 * seen.free(points, way, OPEN * (0.4 + 0.6 * turn))
    image = np.zeros(far.shape, np.float32)
    image.ravel()[chosen] = share
    sums, weights = np.zeros_like(image), np.full(far.shape, 1e-6, np.float32)
    for down in range(-2, 2):
        for right in range(-2, 2):
            moved = np.roll(far, (down, right), (0, 1))
            weight = (np.abs(moved - far) < 0.04 * far).astype(np.float32)
            sums += weight * np.roll(image, (down, right), (0, 1))
            weights += weight
    return (sums / weights).ravel()[chosen]


def _scattered_forward(
    rng: np.random.Generator, blurred: Float32Array, far: Float32Array, rate: float
) -> Float32Array:
    """What arrives by small angles: the more scattering lies between, the wider it is spread."""
    scatterings, wide = rate * far, rng.uniform(0.5, 1.3)
    place = np.clip(np.log2(np.maximum(scatterings, 1e-3) / 0.25), 0.0, 2.0)
    spread = np.zeros_like(blurred)
    for n, sigma in enumerate((2.0, 5.0, 12.0)):
        share = np.maximum(1.0 - np.abs(place - n), 0.0)[..., None]
        spread += ndimage.gaussian_filter(blurred * share, (wide * sigma, wide * sigma, 0.0), truncate=2.5)
    return spread


def _from_water(
    light: Light, eye: SE3, rays: FloatArray, lengths: Float32Array, far: Float32Array, takes: FloatArray
) -> Float32Array:
    """(H, W, 3) what the water sends, from sums along fewer rays."""
    every = 20
    rows, cols = (np.linspace(0, n - 1, n // every + 1) for n in far.shape)
    i, j = np.rint(rows).astype(int), np.rint(cols).astype(int)
    thin = (rays[np.ix_(i, j)] / lengths[np.ix_(i, j)][..., None]).reshape(-1, 3)
    sums = light.path(thin, eye.rotation, float(eye.translation[2]), RANGES) @ takes
    sums = sums.reshape(len(i), len(j), len(RANGES), 3)
    place = np.interp(far, RANGES, np.arange(len(RANGES)))
    at_row = np.broadcast_to(
        (np.arange(far.shape[0]) / (far.shape[0] - 1) * (len(i) - 1))[:, None], far.shape
    )
    at_col = np.broadcast_to(
        (np.arange(far.shape[1]) / (far.shape[1] - 1) * (len(j) - 1))[None, :], far.shape
    )
    where = np.stack([at_row, at_col, place])
    return np.stack(
        [ndimage.map_coordinates(sums[..., k], where, np.float32, order=1) for k in range(3)], axis=-1
    )


def _above(
    rng: np.random.Generator,
    light: Light,
    eye: SE3,
    rays: FloatArray,
    lengths: Float32Array,
    nothing: BoolArray,
    takes: FloatArray,
) -> Float32Array:
    """(H, W, 3) the water's surface from below: bright within the window to the sky."""
    up = (rays @ eye.rotation.T)[..., 2] / lengths
    seen = nothing & (up > 0.05)
    shown = np.zeros((*up.shape, 3), np.float32)
    if seen.any():
        waves = ndimage.gaussian_filter(rng.normal(size=up.shape), (3.0, 9.0))
        bright = 0.06 + 0.94 / (1.0 + np.exp(-30.0 * (up[seen] + 0.06 * waves[seen] / waves.std() - 0.66)))
        far = -eye.translation[2] / up[seen]
        left = np.exp(-light.water.kept * far[:, None]) * light.surface / math.pi
        shown[seen] = (left @ takes) * bright[:, None]
    return shown


def _snow(
    rng: np.random.Generator, light: Light, view: View, far: Float32Array, takes: FloatArray
) -> Float32Array:
    """(H, W, 3) what drifts before the camera, out of focus where it is near."""
    picture = np.zeros((*far.shape, 3), np.float32)
    if rng.random() < 0.3:
        return picture
    per_metre, reach = math.exp(rng.uniform(math.log(2.0), math.log(400.0))), 3.0
    camera = view.camera.scaled(FINE)
    area = camera.width * camera.height / (camera.fx * camera.fy)
    count = min(int(per_metre * area * reach**3 / 3.0), 2500)
    depth = reach * rng.random(count) ** (1.0 / 3.0)
    col, row = rng.random(count) * camera.width, rng.random(count) * camera.height
    points = np.stack([(col - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones(count)], -1)
    points *= depth[:, None]
    metres, size = np.linalg.norm(points, axis=1), 0.0006 * rng.lognormal(0.0, 0.6, count)
    radius = np.hypot(camera.fx * size / depth, 0.9 * rng.uniform(0.5, 2.0) / depth)
    i, j = row.astype(int), col.astype(int)
    kept = (depth > 0.08) & (far[i, j] > metres) & (radius < 24.0)
    lit = 0.5 * light.daylight(np.full(count, view.T_world_camera.translation[2]))
    for lamp in light.lamps:
        lit = lit + lamp.reaching(points, light.water)[0]
    bright = 0.5 / math.pi * lit * np.exp(-light.water.kept * metres[:, None]) @ takes
    covers = (camera.fx * size / depth / radius) ** 2
    step = np.minimum(np.rint(np.log2(np.maximum(radius, 0.7)) * 2.0).astype(int), 9)
    for n in np.unique(step[kept]):
        these = np.flatnonzero(kept & (step == n))
        drawn = np.zeros_like(picture)
        disc = 2.0 ** (n / 2.0)
        np.add.at(drawn, (i[these], j[these]), bright[these] * covers[these, None] * math.pi * disc**2)
        side = math.ceil(disc)
        across = np.hypot(*np.mgrid[-side : side + 1, -side : side + 1])
        kernel = np.clip(disc - across + 0.5, 0.0, 1.0)
        kernel /= kernel.sum()
        for k in range(3):
            picture[..., k] += _spread(drawn[..., k], kernel)
    return picture


def _spread(image: Float32Array, kernel: FloatArray) -> Float32Array:
    """A convolution of points, each as an array added where it is."""
    out = np.zeros_like(image)
    side = len(kernel) // 2
    for row, col in zip(*np.nonzero(image), strict=True):
        top, left = max(row - side, 0), max(col - side, 0)
        bottom, right = min(row + side + 1, image.shape[0]), min(col + side + 1, image.shape[1])
        patch = kernel[top - row + side : bottom - row + side, left - col + side : right - col + side]
        out[top:bottom, left:right] += image[row, col] * patch
    return out


# The camera


def _developed(rng: np.random.Generator, light: Float32Array) -> UInt8Array:
    """(H, W, 3) what a camera makes of linear light (FINE H, FINE W, 3)."""
    if rng.random() < 0.25:
        light = _moved(rng, light)
    lens = rng.uniform(0.3, 1.3)
    light = ndimage.gaussian_filter(light, (lens, lens, 0.0), truncate=2.5)
    rows, cols = (np.linspace(-1.0, 1.0, n) for n in light.shape[:2])
    darker = (1.0 + rng.uniform(0.0, 0.35) * (rows[:, None] ** 2 + cols[None, :] ** 2)) ** -2
    light = light * darker[..., None].astype(np.float32)
    bright, target = float(np.quantile(light.max(axis=-1), 0.98)), rng.uniform(0.55, 1.15)
    middle = max(float(light[..., 1].mean()), 1e-9)
    gain = min(target / max(bright, 1e-9), rng.uniform(0.15, 0.5) / middle)
    noisy = _noisy(rng, _mosaic(light * gain))
    colour = _smaller(_demosaiced(noisy))
    means = np.maximum(colour.mean(axis=(0, 1)), 1e-4)
    balance = np.clip(
        (means[1] / means) ** rng.choice([rng.uniform(0.0, 0.4), rng.uniform(0.4, 1.0)]), 0.4, 5.0
    )
    colour = colour * balance * np.exp(rng.normal(0.0, 0.04, 3))
    grey = colour.mean(axis=-1, keepdims=True)
    colour = np.clip(grey + rng.uniform(0.8, 1.5) * (colour - grey), 0.0, 1.0)
    curve = colour ** (1.0 / rng.uniform(1.8, 2.6))
    curve = curve + rng.uniform(-0.1, 0.5) * (curve - 0.5) * curve * (1.0 - curve) * 2.0
    if rng.random() < 0.5:
        curve = curve + rng.uniform(0.2, 1.2) * (curve - ndimage.gaussian_filter(curve, (0.9, 0.9, 0.0)))
    return _compressed(rng, np.rint(255.0 * np.clip(curve, 0.0, 1.0)).astype(np.uint8))


def _moved(rng: np.random.Generator, light: Float32Array) -> Float32Array:
    """Blurred along a straight line by motion."""
    long, turn = rng.uniform(1.0, 6.0), rng.uniform(0, math.pi)
    moved = np.zeros_like(light)
    for t in (-0.5, -0.25, 0.0, 0.25, 0.5):
        by = round(t * long * math.sin(turn)), round(t * long * math.cos(turn))
        moved += 0.2 * np.roll(light, by, (0, 1))
    return moved


def _mosaic(light: Float32Array) -> Float32Array:
    """(H, W) one colour a pixel: red and green in even rows, green and blue in odd ones."""
    raw = light[..., 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = light[::2, ::2, 0], light[1::2, 1::2, 2]
    return raw


def _noisy(rng: np.random.Generator, raw: Float32Array) -> Float32Array:
    """Of photons and of reading, then 10 bits."""
    full, read = math.exp(rng.uniform(math.log(400.0), math.log(12000.0))), rng.uniform(1.0, 6.0)
    electrons = full * np.clip(raw, 0.0, 1.0)
    counted = electrons + np.sqrt(electrons + read**2) * rng.normal(size=raw.shape)
    return np.asarray(np.clip(np.rint(1023.0 * counted / full) / 1023.0, 0.0, 1.0), np.float32)


def _demosaiced(raw: Float32Array) -> Float32Array:
    """(H, W, 3) bilinear."""
    corners, sides = (
        np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0,
        np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4.0,
    )
    planes = np.zeros((*raw.shape, 3), np.float32)
    planes[::2, ::2, 0], planes[1::2, 1::2, 2] = raw[::2, ::2], raw[1::2, 1::2]
    planes[::2, 1::2, 1], planes[1::2, ::2, 1] = raw[::2, 1::2], raw[1::2, ::2]
    kernels = (corners, sides, corners)
    return np.stack([ndimage.convolve(planes[..., k], kernels[k], mode="mirror") for k in range(3)], axis=-1)


def _smaller(image: Float32Array) -> Float32Array:
    """(HEIGHT, WIDTH, 3) means over what each pixel covers."""
    planes = [
        Image.fromarray(np.ascontiguousarray(image[..., k])).resize((WIDTH, HEIGHT), Image.Resampling.BOX)
        for k in range(3)
    ]
    return np.stack([np.asarray(plane) for plane in planes], axis=-1)


def _compressed(rng: np.random.Generator, rgb: UInt8Array) -> UInt8Array:
    """As a still of a video, whose blocks WebP shares, as a JPEG, or as it is."""
    kind, buffer = rng.random(), io.BytesIO()
    if kind < 0.55:
        Image.fromarray(rgb).save(buffer, "WEBP", quality=int(rng.integers(15, 90)), method=2)
    elif kind < 0.9:
        Image.fromarray(rgb).save(buffer, "JPEG", quality=int(rng.integers(35, 92)), subsampling=2)
    else:
        return rgb
    return np.asarray(Image.open(buffer).convert("RGB"))
