"""Rigid transforms, the camera and angles (Eq. 1).

Frames follow REP-103 and REP-105: `world` is east-north-up with z = 0 at the surface, `base` is
forward-left-up, `camera` is the optical frame, right-down-forward. `T_a_b` takes b-coordinates to
a: `p_a = T_a_b @ p_b`. Everything is in metres and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]

UNTRUE = 1e-3
"""How far the axes of a rotation may be from length 1 and square to each other: what float32, or six written
digits, leave of one."""


def wrap_angle(angle: float) -> float:
    """The same direction in (−π, π]."""
    wrapped = math.remainder(angle, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class SE2:
    """A level pose in the world: position and heading.

    `yaw` is 0 towards +x (east) and grows counter-clockwise.
    """

    x: float
    y: float
    yaw: float

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x, self.y, self.yaw))):
            raise ValueError(f"pose: expected finite x, y and yaw, got ({self.x}, {self.y}, {self.yaw})")

    def distance(self, other: SE2) -> float:
        """Metres between the two positions."""
        return math.hypot(other.x - self.x, other.y - self.y)


@dataclass(frozen=True, slots=True, eq=False)
class SE3:
    """A rigid transform `T_a_b`: a rotation (3, 3) and a translation (3,), both float64.

    What mirrors, scales, shears or flattens is refused: it takes a floor for a wall, and says nothing.
    """

    rotation: FloatArray
    translation: FloatArray

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(
                f"transform: expected rotation (3, 3) and translation (3,), "
                f"got {rotation.shape} and {translation.shape}"
            )
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise ValueError(
                "transform: expected finite numbers, got NaN or infinity. Is the pose estimate alive?"
            )
        _check_rotation(rotation.tolist())
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @staticmethod
    def level(x: float, y: float, z: float, yaw: float) -> SE3:
        """`T_world_base` of a vehicle that neither rolls nor pitches."""
        c, s = math.cos(yaw), math.sin(yaw)
        return SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, z]))

    @property
    def inverse(self) -> SE3:
        """`T_b_a`."""
        return SE3(self.rotation.T, -self.rotation.T @ self.translation)

    @property
    def yaw(self) -> float:
        """Heading of the x axis of b, seen in a."""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])

    @property
    def se2(self) -> SE2:
        """Position and heading on the ground plane."""
        return SE2(float(self.translation[0]), float(self.translation[1]), self.yaw)

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: FloatArray) -> FloatArray: ...
    def __matmul__(self, other: SE3 | FloatArray) -> SE3 | FloatArray:
        if isinstance(other, SE3):
            return SE3(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)
        return np.asarray(other) @ self.rotation.T + self.translation


def _check_rotation(rows: list[list[float]]) -> None:
    """Raise a ValueError that says what a (3, 3) matrix is, unless it is a rotation.

    In plain numbers: a pose is made at every sample of the gyroscope, and arrays so small are slower.
    """
    (a, b, c), (d, e, f), (g, h, i) = rows
    lengths = a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0
    angles = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
    turns = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if turns > 0.0 and all(-UNTRUE <= off <= UNTRUE for off in (*lengths, *angles)):
        return
    if not any(map(any, rows)):
        what, ask = "zeros", "Was it ever filled in?"
    elif abs(turns) < 1e-9:
        what, ask = "one that flattens (determinant 0)", "Is it whole?"
    elif all(-UNTRUE <= off <= UNTRUE for off in angles):
        scales = ", ".join(f"{math.sqrt(length + 1.0):.4g}" for length in lengths)
        mirrors = "one that mirrors (determinant below 0)"
        what = mirrors if turns < 0.0 else f"axes of length {scales}"
        ask = (
            "Is one axis the other way, such as NED taken for ENU?"
            if turns < 0.0
            else ("Is the quaternion of length 1, and the matrix without a scale?")
        )
    else:
        what, ask = "axes that are not square to each other", "Is it in rows, three numbers each?"
    raise ValueError(f"transform: expected a rotation, got {what}. {ask}")


def camera_mount(pitch: float) -> SE3:
    """`T_base_camera` of a camera at the base's origin that looks forward and `pitch` radians down."""
    c, s = math.cos(pitch), math.sin(pitch)
    # Columns: the camera's right, down and forward axes in base coordinates.
    return SE3(np.array([[0.0, -s, c], [-1.0, 0.0, 0.0], [0.0, -c, -s]]), np.zeros(3))


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera. Pixel centres lie at half-integers: pixel (u, v) is seen through (u + ½, v + ½)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least one pixel, got {getattr(self, name)}")
        for name in ("fx", "fy"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected pixels above 0, got {getattr(self, name)}")
        for name in ("cx", "cy"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name}: expected a finite number of pixels, got {getattr(self, name)}")

    @staticmethod
    def from_fov(width: int, height: int, horizontal_fov: float) -> Camera:
        """Square pixels, principal point in the middle."""
        f = 0.5 * width / math.tan(0.5 * horizontal_fov)
        return Camera(width, height, f, f, 0.5 * width, 0.5 * height)

    @property
    def horizontal_fov(self) -> float:
        """Radians between the left and the right edge of the image."""
        return math.atan(self.cx / self.fx) + math.atan((self.width - self.cx) / self.fx)

    def scaled(self, factor: float) -> Camera:
        """The same view with `factor` times as many pixels along each axis."""
        return Camera(
            round(self.width * factor),
            round(self.height * factor),
            self.fx * factor,
            self.fy * factor,
            self.cx * factor,
            self.cy * factor,
        )

    def check(self, image: npt.NDArray[Any], name: str) -> None:
        """Raise a ValueError unless `image` is (height, width, ...)."""
        if image.shape[:2] != (self.height, self.width):
            swapped = image.shape[:2] == (self.width, self.height)
            raise ValueError(
                f"{name}: expected {(self.height, self.width)} to match the camera, got {image.shape[:2]}."
                + (" Are rows and columns swapped?" if swapped else "")
            )

    def back_project(self, depth: FloatArray, T_world_camera: SE3) -> FloatArray:
        """World point of every pixel (Eq. 1).

        Args:
            depth: (H, W) metres along the optical axis.
            T_world_camera: Where the optical frame was.

        Returns:
            (H, W, 3) float64, metres in the world; NaN where depth is NaN.
        """
        self.check(depth, "depth")
        u = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        v = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        z = np.asarray(depth, dtype=np.float64)
        return T_world_camera @ np.stack([u[None, :] * z, v[:, None] * z, z], axis=-1)

    def project(self, points_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixel coordinates (..., 2) and depths (...) of points given in the camera frame.

        A coordinate floors to its pixel. Where the depth is not positive the pixel is NaN.
        """
        points = np.asarray(points_camera, dtype=np.float64)
        z = points[..., 2]
        safe = np.where(z > 0.0, z, np.nan)
        u = self.fx * points[..., 0] / safe + self.cx
        v = self.fy * points[..., 1] / safe + self.cy
        return np.stack([u, v], axis=-1), z


@dataclass(frozen=True, slots=True)
class Bounds:
    """An axis-aligned box on the ground: the operator's survey area."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float

    def __post_init__(self) -> None:
        values = (self.x_min, self.y_min, self.x_max, self.y_max)
        if not all(map(math.isfinite, values)) or self.x_min >= self.x_max or self.y_min >= self.y_max:
            raise ValueError(f"bounds: expected finite x_min < x_max and y_min < y_max, got {values}")

    @property
    def width(self) -> float:
        """Metres from west to east."""
        return self.x_max - self.x_min

    @property
    def depth(self) -> float:
        """Metres from south to north."""
        return self.y_max - self.y_min

    @property
    def area(self) -> float:
        """Square metres."""
        return self.width * self.depth

    def widened(self, by: float) -> Bounds:
        """The box with all its sides that many metres farther out; farther in where it is less than 0."""
        return Bounds(self.x_min - by, self.y_min - by, self.x_max + by, self.y_max + by)

    def covers(self, x: npt.NDArray[Any], y: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
        """Which of many points are inside or on a side?"""
        return np.asarray((x >= self.x_min) & (x <= self.x_max) & (y >= self.y_min) & (y <= self.y_max))

    def contains(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Is the point inside, at least `margin` metres from every side?"""
        return (
            self.x_min + margin <= x <= self.x_max - margin
            and self.y_min + margin <= y <= self.y_max - margin
        )
