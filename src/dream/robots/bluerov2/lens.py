"""A calibrated lens, and its pictures as a pinhole camera would have taken them.

References: the lens models of OpenCV (calib3d: radial, tangential, thin prism, tilted sensor; Kannala and
Brandt 2006 for fisheye). Refraction at a flat port: Treibitz, Schechner, Kunz and Singh, Flat refractive
geometry, IEEE TPAMI 34(1), 2012; Lavest, Rives and Lapresté, Underwater camera calibration, ECCV 2000, for
the focal length that grows by the refractive index.
"""

from __future__ import annotations

import enum
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.geometry import Camera
from dream.robots.bluerov2.camera import opencv
from dream.robots.bluerov2.lens_files import FISHEYE_COUNTS, PINHOLE_COUNTS, parse

Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]
BoolArray = npt.NDArray[np.bool_]

WATER_INDEX = 1.333
"""Refractive index of fresh water, against air; sea water has up to 1.34."""
_WIDEST = 3.0
"""Tangent of the widest angle, 72°, up to which the pinhole models are looked at."""


class Calibrated(enum.StrEnum):
    """Where the lens was calibrated, as `calibrated_in` of the file says."""

    WATER = "water"
    """As it is used."""
    AIR_DOME_PORT = "air_dome_port"
    """Behind a dome whose centre is the lens's: it sees the same in water."""
    AIR_FLAT_PORT = "air_flat_port"
    """Behind flat glass: water bends each ray."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A calibration, in OpenCV's terms: pixel centres lie at whole numbers."""

    width: int
    height: int
    matrix: Float64Array
    """(3, 3) camera matrix, pixels."""
    distortion: Float64Array
    """(4,), (5,), (8,), (12,) or (14,) coefficients; (4,) for a fisheye."""
    fisheye: bool
    calibrated: Calibrated

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, np.float64)
        distortion = np.asarray(self.distortion, np.float64).reshape(-1)
        if not (16 <= self.width <= 16384 and 16 <= self.height <= 16384):
            raise ValueError(f"image size: expected 16 to 16384 pixels, got {self.width} x {self.height}")
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise ValueError(f"camera_matrix: expected (3, 3) finite numbers, got {matrix.tolist()}")
        (fx, skew, cx), (zero, fy, cy) = matrix[:2]
        if skew or zero or list(matrix[2]) != [0.0, 0.0, 1.0]:
            raise ValueError(
                f"camera_matrix: expected fx 0 cx; 0 fy cy; 0 0 1, got {matrix.tolist()}. "
                "Calibrate without skew"
            )
        if not (0.1 * self.width < fx < 20.0 * self.width and 0.5 < fy / fx < 2.0):
            raise ValueError(
                f"camera_matrix: expected focal lengths of 0.1 to 20 times the width of {self.width} pixels, "
                f"one at most twice the other, got {fx:g} and {fy:g}. Are they in pixels, of pictures of "
                "this size?"
            )
        if not (0.0 < cx < self.width and 0.0 < cy < self.height):
            raise ValueError(
                f"camera_matrix: expected a centre within the picture of {self.width} x {self.height}, got "
                f"({cx:g}, {cy:g}). Is the image size that of the calibration's pictures?"
            )
        counts = FISHEYE_COUNTS if self.fisheye else PINHOLE_COUNTS
        if len(distortion) not in counts or not np.isfinite(distortion).all():
            raise ValueError(
                f"distortion_coefficients: expected {counts} finite numbers, got {distortion.tolist()}"
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)

    @staticmethod
    def read(path: Path) -> Lens:
        """A calibration file, with one line more than calibrations write: `calibrated_in`, a `Calibrated`.

        OpenCV's has `image_width`, `image_height`, `camera_matrix`, `distortion_coefficients`, and may have
        `fisheye_model` (1 for a fisheye) or `distortion_model`. ROS's and Kalibr's are read as well, see
        `lens_files`.

        Raises:
            ValueError: What it says cannot be, or is missing; the message begins with its path.
            FileNotFoundError: There is none.
        """
        if not path.is_file():
            raise FileNotFoundError(f"{path}: there is no such file. Calibrate the camera first")
        try:
            said = parse(path)
            where, kinds = said.calibrated_in, ", ".join(Calibrated)
            if where is None:
                raise ValueError(
                    f"calibrated_in is missing. This is {said.kind}, which is read with one line more, "
                    f"at its top: calibrated_in: {Calibrated.WATER} (or another of {kinds})"
                )
            if where not in list(Calibrated):
                raise ValueError(f"calibrated_in: expected one of {kinds}, got {str(where)[:60]}")
            return Lens(
                said.width, said.height, said.matrix, said.distortion, said.fisheye, Calibrated(where)
            )
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    def write(self, path: Path) -> None:
        """The file that `read` reads."""
        cv2 = opencv()
        storage = cv2.FileStorage(os.fspath(path), cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_FORMAT_YAML)
        storage.write("calibrated_in", str(self.calibrated))
        storage.write("image_width", self.width)
        storage.write("image_height", self.height)
        storage.write("fisheye_model", int(self.fisheye))
        storage.write("camera_matrix", self.matrix)
        storage.write("distortion_coefficients", self.distortion)
        storage.release()

    def at(self, width: int, height: int) -> Lens:
        """The same lens in a stream of another size, whose picture shows as much.

        Raises:
            ValueError: The picture has another shape, so that it shows less or more.
        """
        factor = width / self.width
        if abs(height / self.height - factor) > 0.01 * factor:
            raise ValueError(
                f"picture: expected width to height as in the lens file, {self.width} x {self.height} (ratio "
                f"{self.width / self.height:.2f}), got {width} x {height} (ratio {width / height:.2f}). "
                "Calibrate in the mode in which the camera streams, or let it stream in that of the lens file"
            )
        # The outer edges stay where they are, and they lie half a pixel beyond the centres.
        scale = np.diag([factor, height / self.height, 1.0])
        matrix = scale @ self.matrix
        matrix[:2, 2] += 0.5 * np.diag(scale)[:2] - 0.5
        return Lens(width, height, matrix, self.distortion, self.fisheye, self.calibrated)

    def pixels(self, rays: Float64Array) -> Float64Array:
        """Where the lens shows what lies in a direction in water.

        Args:
            rays: (..., 2) x / z and y / z in the optical frame.

        Returns:
            (..., 2) float64, in OpenCV's pixels, also outside of the picture; NaN where no light comes from.
        """
        rays = np.asarray(rays, np.float64)
        if self.calibrated is Calibrated.AIR_FLAT_PORT:
            rays = in_air(rays)
        x, y = rays[..., 0], rays[..., 1]
        radius = np.hypot(x, y)
        x, y = (np.where(radius <= self._widest(), side, np.nan) for side in (x, y))
        x, y = (_fisheye if self.fisheye else _pinhole)(x, y, self.distortion)
        (fx, _, cx), (_, fy, cy) = self.matrix[:2]
        return np.stack([fx * x + cx, fy * y + cy], axis=-1)

    def _widest(self) -> float:
        """Tangent of the widest angle up to which what lies further out is shown further out.

        Beyond it the polynomials of the model turn back, and would show the same pixel twice.
        """
        if self.fisheye:
            angle = np.linspace(0.0, math.radians(89.0), 1000)
            powers = angle[:, None] ** np.array([3, 5, 7, 9])
            shown, reach = angle + powers @ self.distortion, np.tan(angle)
        else:
            reach = np.linspace(0.0, _WIDEST, 1000)
            k = np.pad(self.distortion, (0, 14 - len(self.distortion)))
            r2 = reach**2
            above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
            below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            shown = reach * above / np.where(below > 0.0, below, np.nan)
        grows = np.diff(shown) > 0.0
        return float(reach[-1] if grows.all() else reach[np.argmin(grows)])


class Rectifier:
    """Makes a lens's pictures those of a pinhole camera. Prepared once."""

    def __init__(self, lens: Lens, camera: Camera) -> None:
        """Computes which pixel comes from where.

        Args:
            lens: At the size of the stream; see `Lens.at`.
            camera: The camera wanted, such as the protocol's or a whole multiple of it.
        """
        cv2 = opencv()
        self.lens, self.camera = lens, camera
        # Where the lens resolves more than the camera, its pixels are averaged rather than skipped.
        self._fineness = max(1, min(8, round(float(lens.matrix[0, 0]) / camera.fx)))
        fine = camera.scaled(self._fineness)
        u = (np.arange(fine.width) + 0.5 - fine.cx) / fine.fx
        v = (np.arange(fine.height) + 0.5 - fine.cy) / fine.fy
        pixels = lens.pixels(np.stack(np.meshgrid(u, v), axis=-1))
        corner = np.array([lens.width - 1, lens.height - 1])
        inside = np.asarray(((pixels >= 0.0) & (pixels <= corner)).all(axis=-1))
        outside = np.where(inside[..., None], pixels, -10.0).astype(np.float32)
        self._maps = cv2.convertMaps(outside, None, cv2.CV_16SC2)
        blocks = inside.reshape(camera.height, self._fineness, camera.width, self._fineness)
        self.seen: BoolArray = np.asarray(blocks.all(axis=(1, 3)))
        """(H, W): the lens sees all of that pixel. Where it does not, nothing is known."""

    def rectified(self, rgb: UInt8Array) -> UInt8Array:
        """The picture of the pinhole camera.

        Args:
            rgb: (H, W, 3) uint8 of the lens.

        Returns:
            (H, W, 3) uint8 of the camera; black where the lens does not see.
        """
        cv2 = opencv()
        if rgb.shape != (self.lens.height, self.lens.width, 3) or rgb.dtype != np.uint8:
            raise ValueError(
                f"rgb: expected {(self.lens.height, self.lens.width, 3)} uint8 as the lens was calibrated, "
                f"got {rgb.shape} {rgb.dtype}. See Lens.at"
            )
        picture = cv2.remap(rgb, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        if self._fineness > 1:
            size = (self.camera.width, self.camera.height)
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        picture[~self.seen] = 0
        return np.asarray(picture, np.uint8)


def in_air(rays: Float64Array, index: float = WATER_INDEX) -> Float64Array:
    """Rays in water as they go on behind a flat port, by Snell's law.

    Near the axis it is as if the focal length were `index` times as long. The distance of the lens's pupil
    from the port, some millimetres, and the thickness of the port are neglected.

    Args:
        rays: (..., 2) x / z and y / z in water.
        index: Refractive index of water.

    Returns:
        (..., 2) x / z and y / z in air; NaN beyond the angle of total reflection, 48.6°.
    """
    square = np.sum(np.square(rays), axis=-1)
    # sin θ_air = n sin θ_water, and tan θ_air / tan θ_water is the factor.
    left = 1.0 - (index * index - 1.0) * square
    return np.asarray(rays * (index / np.sqrt(np.where(left > 0.0, left, np.nan)))[..., None])


def _pinhole(x: Float64Array, y: Float64Array, k: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Radial, tangential, thin prism and tilt, in OpenCV's order: k1 k2 p1 p2 k3 to k6 s1 to s4 τx τy."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tilt_x, tilt_y = np.pad(k, (0, 14 - len(k)))
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    shown_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2)
    shown_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4)
    if not (tilt_x or tilt_y):
        return shown_x, shown_y
    # The sensor stands askew behind the lens: turned about x, then about y, and seen from the centre.
    cx, sx, cy, sy = math.cos(tilt_x), math.sin(tilt_x), math.cos(tilt_y), math.sin(tilt_y)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    turned = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]]) @ about_x
    across = turned[2, 2] * np.eye(3) - np.array(
        [[0.0, 0.0, turned[0, 2]], [0.0, 0.0, turned[1, 2]], [0, 0, 0]]
    )
    across[2, 2] = 1.0
    on_sensor = np.stack([shown_x, shown_y, np.ones_like(shown_x)], axis=-1) @ (across @ turned).T
    return on_sensor[..., 0] / on_sensor[..., 2], on_sensor[..., 1] / on_sensor[..., 2]


def _fisheye(x: Float64Array, y: Float64Array, k: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Kannala and Brandt: the distance from the centre is a polynomial of the angle."""
    radius = np.hypot(x, y)
    angle = np.arctan(radius)
    square = angle * angle
    shown = angle * (1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
    factor = np.where(radius > 0.0, shown / np.where(radius > 0.0, radius, 1.0), 1.0)
    return x * factor, y * factor
