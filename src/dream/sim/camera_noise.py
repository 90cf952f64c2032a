"""A camera that errs: depth that scatters, individuals that are overlooked, targets where none are.

Colours stay as they were drawn. What is wrong in one frame is drawn anew in the next, so that looking again
helps; see `protocol.SensorNoise` for how much is wrong.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from dream.geometry import SE2, SE3, Camera
from dream.protocol import Grain, SensorNoise
from dream.sim.render import Frame
from dream.sim.render.scene import linear_from_srgb
from dream.sim.sampling import MILLIMETRE, index, length, normals, poisson, uniform
from dream.sim.world import BoolArray, Float32Array, Int32Array, UInt8Array, World
from dream.types import Label


def noise_generator(world: World, start: SE2, step: int) -> np.random.Generator:
    """Randomness of the frame at the end of a step.

    It follows from the mission and the step alone: a mission that is flown again errs alike, whatever was
    flown before, and another world, seed, start or step errs otherwise.

    Args:
        world: Where.
        start: Where the mission began.
        step: Moves since then.
    """
    place = [round(MILLIMETRE * value) for value in (start.x, start.y, start.yaw)]
    name = repr((world.name, world.seed, place, step))
    words = np.frombuffer(hashlib.sha256(name.encode()).digest(), "<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([int(word) for word in words])))


def grainy(rgb: UInt8Array, grain: Grain, rng: np.random.Generator) -> UInt8Array:
    """A picture as the sensor and the camera's JPEG give it.

    Args:
        rgb: (H, W, 3) sRGB as it is drawn; it is not changed.
        grain: How much noise.
        rng: Of this frame.
    """
    import io

    from PIL import Image

    linear = linear_from_srgb(rgb)
    sigma = np.sqrt(linear / grain.photons + grain.reading**2)
    light = np.clip(linear + sigma * normals(rng, linear.shape), 0.0, 1.0)
    coded = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1.0 / 2.4) - 0.055
    )
    packed = io.BytesIO()
    Image.fromarray(np.rint(255.0 * coded).astype(np.uint8)).save(packed, "JPEG", quality=grain.quality)
    with Image.open(packed) as image:
        return np.array(image)


def with_noise(
    frame: Frame,
    camera: Camera,
    T_world_camera: SE3,
    noise: SensorNoise,
    rng: np.random.Generator,
    *,
    hull: BoolArray,
) -> Frame:
    """What a sensor that errs makes of a view.

    Args:
        frame: The truth; it is not changed.
        camera: It was drawn with.
        T_world_camera: It was drawn from.
        noise: How much is wrong.
        rng: What is wrong.
        hull: (N,) bool, see `World.hull`. A patch that is overlooked is part of something solid all the same:
            an obstacle. Labelled seabed, it would raise the ground that the map learns. A clump of shells
            passes for the seabed that it lies on.
    """
    missed_as = np.where(hull, np.uint8(Label.OBSTACLE), np.uint8(Label.SEABED))
    depth = noisy_depth(frame.depth, noise.depth, rng)
    labels = with_false_targets(frame.labels, frame.depth, camera, T_world_camera, noise, rng)
    labels = with_missed(labels, frame.ids, noise.missed, missed_as, rng)
    return replace(frame, depth=depth, labels=labels)


def noisy_depth(depth: Float32Array, scatter: float, rng: np.random.Generator) -> Float32Array:
    """Depths z with normal errors of σ = `scatter` z², each pixel for itself.

    Args:
        depth: (H, W) metres along the optical axis; NaN where there is no return, which stays so.
        scatter: Per metre.
        rng: Of this frame.
    """
    z = depth.astype(np.float64)
    return (z + scatter * z * z * normals(rng, z.shape)).astype(np.float32)


def with_false_targets(
    labels: UInt8Array,
    depth: Float32Array,
    camera: Camera,
    T_world_camera: SE3,
    noise: SensorNoise,
    rng: np.random.Generator,
) -> UInt8Array:
    """Labels with round spots of seabed that are called target, at pixels that are all equally likely.

    Args:
        labels: (H, W) the true ones.
        depth: (H, W) the true depth, metres along the optical axis.
        camera: Intrinsics of both images.
        T_world_camera: Where the optical frame was.
        noise: How many there are, and how large.
        rng: Of this frame.
    """
    found = labels.copy()
    seabed = labels == Label.SEABED
    rows, cols = np.nonzero(seabed)
    count = poisson(rng, noise.false_targets)
    if count == 0 or len(rows) == 0:
        return found
    ground = camera.back_project(depth, T_world_camera)[..., :2]
    for _ in range(count):
        middle, width = index(rng, len(rows)), uniform(rng, *noise.false_size)
        away = length(ground - ground[rows[middle], cols[middle]])
        found[seabed & (away <= 0.5 * width)] = Label.TARGET
    return found


def with_missed(
    labels: UInt8Array, ids: Int32Array, share: float, missed_as: UInt8Array, rng: np.random.Generator
) -> UInt8Array:
    """Labels without some of the individuals, each missed with all its pixels or not at all.

    Args:
        labels: (H, W).
        ids: (H, W) which individual a pixel shows, −1 for none.
        share: Probability of each to be missed.
        missed_as: (N,) the label that the pixels of each are taken for.
        rng: Of this frame.
    """
    missed = rng.random(int(ids.max(initial=-1)) + 1) < share
    # An id of −1 reads the last entry, which is never missed.
    return np.where(np.append(missed, False)[ids], np.append(missed_as, np.uint8(0))[ids], labels)
