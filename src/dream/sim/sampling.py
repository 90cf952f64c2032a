"""Random draws and roundings that come out the same on every machine.

Worlds are named by a name and a seed, so what is drawn must not depend on the processor, the
mathematical library or the NumPy version. Four habits see to it: the only generator method used
is `Generator.random`; sines, powers and the like come from here, rounded to 1e-9, because libraries
differ in their last digit; products of matrices are written out, because linear algebra libraries add
in their own order; and what is kept is rounded to whole millimetres and the like, far coarser than any
rounding error.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]

MILLIMETRE = 1000
"""Steps per metre of every coordinate of a world."""
QUATERNION = 1_000_000
"""Steps per unit of a quaternion's components."""
FACTOR = 10_000
"""Steps per unit of scales and tints."""


def quantised(values: npt.ArrayLike, steps: int) -> Float64Array:
    """The nearest multiples of 1 / steps."""
    return np.rint(np.asarray(values, np.float64) * steps) / steps + 0.0  # + 0.0 turns −0.0 into 0.0


def steady(values: npt.ArrayLike) -> Float64Array:
    """Rounded to 1e-9: what a decision may turn on."""
    return np.asarray(np.round(np.asarray(values, np.float64), 9))


def sine(angles: npt.ArrayLike) -> Float64Array:
    """Of radians, rounded to 1e-9."""
    return steady(np.sin(angles))


def cosine(angles: npt.ArrayLike) -> Float64Array:
    """Of radians, rounded to 1e-9."""
    return steady(np.cos(angles))


def exponential(values: npt.ArrayLike) -> Float64Array:
    """e to the power of the values, rounded to 1e-9."""
    return steady(np.exp(values))


def power(base: npt.ArrayLike, exponent: npt.ArrayLike) -> Float64Array:
    """The base, 0 or more, to the power of the exponent, rounded to 1e-9."""
    return steady(np.power(np.asarray(base, np.float64), exponent))


def length(vectors: npt.ArrayLike) -> Float64Array:
    """(...) of vectors (..., K), their components added from first to last."""
    squares = np.square(np.asarray(vectors, np.float64))
    total = squares[..., 0]
    for k in range(1, squares.shape[-1]):
        total = total + squares[..., k]
    return np.sqrt(total)


def products(points: Float64Array, rows: Float64Array) -> Float64Array:
    """(N, M) scalar products of points (N, K) with rows (M, K), their terms added from first to last."""
    total = points[:, :1] * rows[:, 0]
    for k in range(1, points.shape[1]):
        total = total + points[:, k, None] * rows[:, k]
    return total


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """One number in [low, high)."""
    return low + (high - low) * float(rng.random())


def uniforms(rng: np.random.Generator, low: float, high: float, shape: int | tuple[int, ...]) -> Float64Array:
    """Numbers in [low, high)."""
    return low + (high - low) * rng.random(shape)


def gaps(rng: np.random.Generator, count: int) -> Float64Array:
    """(count,) exponential numbers of mean 1: how long to wait for what happens once in a while."""
    return steady(-np.log(1.0 - rng.random(count)))


def normals(rng: np.random.Generator, shape: tuple[int, ...]) -> Float64Array:
    """Normal numbers of mean 0 and deviation 1, by Box and Muller's transform."""
    count = math.prod(shape)
    half = -(-count // 2)
    radius = np.sqrt(2.0 * gaps(rng, half))
    angle = uniforms(rng, 0.0, 2.0 * math.pi, half)
    return np.concatenate([radius * cosine(angle), radius * sine(angle)])[:count].reshape(shape)


def poisson(rng: np.random.Generator, mean: float) -> int:
    """How many of many rare things happen: the gaps between them that fit into the mean."""
    spent, count = float(gaps(rng, 1)[0]), 0
    while spent < mean:
        spent, count = spent + float(gaps(rng, 1)[0]), count + 1
    return count


def index(rng: np.random.Generator, count: int) -> int:
    """One of 0 .. count − 1."""
    return int(rng.random() * count)


def indices(rng: np.random.Generator, count: int, size: int) -> npt.NDArray[np.intp]:
    """`size` draws of 0 .. count − 1."""
    return (rng.random(size) * count).astype(np.intp)


def between(rng: np.random.Generator, low: int, high: int) -> int:
    """A whole number from low to high, both included."""
    return low + index(rng, high - low + 1)


def direction(angle: float) -> Float64Array:
    """(2,) unit vector at `angle` radians from +x, counter-clockwise."""
    return np.array([round(math.cos(angle), 9), round(math.sin(angle), 9)])


def directions(angles: npt.NDArray[np.floating[Any]]) -> Float64Array:
    """(..., 2) unit vectors at `angles` radians from +x, counter-clockwise."""
    return np.stack([np.round(np.cos(angles), 9), np.round(np.sin(angles), 9)], axis=-1)


def unit_vectors(rng: np.random.Generator, count: int) -> Float64Array:
    """(count, 3) vectors of length 1, spread evenly over the sphere."""
    z = uniforms(rng, -1.0, 1.0, count)
    level = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.concatenate(
        [level[:, None] * directions(uniforms(rng, 0.0, 2.0 * math.pi, count)), z[:, None]], 1
    )


def yaw_and_tilt(yaw: Float64Array, tilt: Float64Array) -> Float64Array:
    """(N, 4) unit quaternions wxyz: turned about z by `yaw`, then tilted.

    Args:
        yaw: (N,) radians.
        tilt: (N, 2) tangents of half the tilt about world x and y.
    """
    half = directions(0.5 * yaw)
    c, s = half[:, 0], half[:, 1]
    a, b = tilt[:, 0], tilt[:, 1]
    wxyz = np.stack([c, a * c + b * s, b * c - a * s, s], axis=1)
    return np.asarray(wxyz / np.sqrt((wxyz * wxyz).sum(axis=1, keepdims=True)))


def rotated(wxyz: npt.NDArray[Any], points: npt.NDArray[Any]) -> Float64Array:
    """(V, 3) points turned by one unit quaternion."""
    w, x, y, z = (float(value) for value in wxyz)
    px, py, pz = np.asarray(points, np.float64).T
    return np.stack(
        [
            (1 - 2 * (y * y + z * z)) * px + 2 * (x * y - w * z) * py + 2 * (x * z + w * y) * pz,
            2 * (x * y + w * z) * px + (1 - 2 * (x * x + z * z)) * py + 2 * (y * z - w * x) * pz,
            2 * (x * z - w * y) * px + 2 * (y * z + w * x) * py + (1 - 2 * (x * x + y * y)) * pz,
        ],
        axis=1,
    )
