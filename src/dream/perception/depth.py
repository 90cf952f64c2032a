"""What labels and depth are asked of, and the two together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dream.geometry import SE3, Camera
from dream.types import Float32Array, UInt8Array


class Segmenter(Protocol):
    """Tells what every pixel shows."""

    def segment(self, rgb: UInt8Array) -> tuple[UInt8Array, Float32Array]:
        """Labels and confidence.

        Args:
            rgb: (H, W, 3).

        Returns:
            (H, W) values of `Label`, and (H, W) float32 in [0, 1]: the probability that each is right.
        """


class DepthModel(Protocol):
    """Tells how far away every pixel is."""

    def estimate(
        self,
        rgb: UInt8Array,
        labels: UInt8Array,
        camera: Camera,
        altitude: float,
        T_world_base: SE3,
        T_base_camera: SE3,
    ) -> tuple[Float32Array, Float32Array]:
        """Depth and confidence.

        Args:
            rgb: (H, W, 3).
            labels: (H, W) values of `Label`, as a segmenter gave them.
            camera: Intrinsics of both.
            altitude: Metres of `base` above the floor, along the vertical.
            T_world_base: Attitude of the vehicle; where it is and its heading do not matter.
            T_base_camera: Where the camera sits.

        Returns:
            (H, W) float32 metres along the optical axis, NaN where unknown; and (H, W) float32 in [0, 1],
            0 where the depth is NaN.
        """


@dataclass(frozen=True, slots=True)
class Perception:
    """Depth and labels of a real camera's picture, for the map.

    What it does: labels first, then depth, which may follow from the labels. Colour may be finer than the
    camera for mapping by a whole factor; it is averaged.

    Assumes: a picture without lens distortion, that belongs to the pose.
    """

    segmenter: Segmenter
    depth: DepthModel

    def perceive(
        self, rgb: UInt8Array, camera: Camera, T_world_base: SE3, T_base_camera: SE3, altitude: float
    ) -> tuple[Float32Array, UInt8Array, Float32Array]:
        """What a picture shows.

        Args:
            rgb: (k H, k W, 3) uint8.
            camera: Intrinsics of an image of (H, W).
            T_world_base: Only its attitude counts.
            T_base_camera: Where the camera sits.
            altitude: Metres of `base` above the floor, along the vertical.

        Returns:
            (H, W) float32 depth, metres along the optical axis, NaN where unknown; (H, W) uint8 labels; and
            (H, W) float32 confidence in both, the lesser of the two.

        Raises:
            ValueError: The picture does not fit the camera, or the altitude is not a number above 0.
        """
        coarse = averaged(rgb, camera)
        labels, sure = self.segmenter.segment(coarse)
        camera.check(labels, "labels")
        depth, near = self.depth.estimate(coarse, labels, camera, altitude, T_world_base, T_base_camera)
        camera.check(depth, "depth")
        return depth, labels, np.minimum(sure, near)


def averaged(rgb: UInt8Array, camera: Camera) -> UInt8Array:
    """A picture that is k times as fine as the camera, at the camera's size: means over k × k pixels."""
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
        raise ValueError(f"rgb: expected (H, W, 3) uint8, got {rgb.shape} {rgb.dtype}")
    k = max(1, len(rgb) // camera.height)
    camera.scaled(k).check(rgb, "rgb")
    if k == 1:
        return rgb
    blocks = rgb.reshape(camera.height, k, camera.width, k, 3)
    means: UInt8Array = np.rint(blocks.mean(axis=(1, 3), dtype=np.float32)).astype(np.uint8)
    return means
