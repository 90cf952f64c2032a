"""What the camera's pictures show, and that each is what its name says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dream.standin import sight
from dream.standin.sight import UInt8, UnreadableError

FAR = 12.0
"""Metres that are black in the picture of the depth."""
FEW_COLORS = 16
"""A camera's picture has more."""


@dataclass(frozen=True, slots=True)
class CameraView:
    """What the camera sees."""

    free: float
    """Metres along the optical axis to what stands ahead of the vehicle; `FAR` where nothing does."""
    target: float
    """Part of the picture that is target, 0 to 1."""
    near_target: float
    """Part of the picture that is target and within 5 m of the camera, 0 to 1."""


def read_views(camera: UInt8, depth: UInt8, labels: UInt8, *, in_space: bool = False) -> CameraView:
    """What three pictures of one view show.

    Args:
        camera: (H, W, 3) uint8, in colour.
        depth: (H, W) uint8, white at the camera.
        labels: (H, W, 3) uint8, in the colours of the legend.
        in_space: Targets may stand up, so that one above is nearer than the ground.

    Raises:
        UnreadableError: One of them is not what its name says, or they do not show the same.
    """
    if not camera.shape[:2] == depth.shape[:2] == labels.shape[:2]:
        raise UnreadableError(
            f"[depth], [labels]: expected the size of [camera], {camera.shape[:2]}, "
            f"got {depth.shape[:2]} and {labels.shape[:2]}"
        )
    check_camera(camera)
    if depth.ndim == 3:
        if (depth != depth[..., :1]).any():
            raise UnreadableError("[depth]: expected gray, got colours")
        depth = depth[..., 0]
    if labels.ndim != 3:
        raise UnreadableError("[labels]: expected colours, got gray")
    green, gray, black, water = (
        sight.is_color(labels, color)
        for color in (
            sight.COLORS[sight.TARGET],
            sight.COLORS[sight.EXPLORED],
            sight.COLORS[sight.SOLID],
            sight.WATER,
        )
    )
    strange = ~(green | gray | black | water)
    if strange.any():
        row, column = np.argwhere(strange)[0]
        raise UnreadableError(
            f"[labels]: expected the colours of the legend and of water, "
            f"got {tuple(int(v) for v in labels[row, column])} at pixel ({column}, {row})"
        )
    rows = len(depth)
    ground = gray if in_space else gray | green
    if ground[-rows // 4 :].any() and ground[: rows * 3 // 4].any():
        bottom = depth[-rows // 4 :][ground[-rows // 4 :]].mean()
        above = depth[: rows * 3 // 4][ground[: rows * 3 // 4]].mean()
        if bottom < above:
            raise UnreadableError(
                f"[depth]: expected the ground at the bottom to be nearer, and brighter, than that above, "
                f"got {bottom:.0f} and {above:.0f} of 255. Is it upside down?"
            )
    if water.any() and np.count_nonzero(depth[water] > 2) > 0.05 * np.count_nonzero(water):
        raise UnreadableError("[depth], [labels]: expected black where there is water. Are they of one view?")
    metres = FAR * (1.0 - depth / 255.0)
    middle = slice(depth.shape[1] * 2 // 5, depth.shape[1] * 3 // 5)
    ahead = metres[:, middle][black[:, middle]]
    return CameraView(
        free=float(ahead.min()) if ahead.size else FAR,
        target=float(green.mean()),
        near_target=float((green & (metres < 5.0)).mean()),
    )


def check_camera(camera: UInt8) -> None:
    """Raise an `UnreadableError` unless it is a picture in natural colours."""
    if camera.ndim != 3:
        raise UnreadableError("[camera]: expected colours, got gray")
    thinned = camera[::7, ::7].reshape(-1, 3)
    if len(np.unique(thinned, axis=0)) < FEW_COLORS:
        raise UnreadableError(
            f"[camera]: expected natural colours, got fewer than {FEW_COLORS}. Are they labels?"
        )
    if (thinned == thinned[:, :1]).all():
        raise UnreadableError("[camera]: expected colours, got gray. Is it the depth?")


def needed(pictures: Mapping[str, bytes], *names: str) -> list[UInt8]:
    """The pictures of these names, as arrays.

    Raises:
        UnreadableError: One is missing or is no picture.
    """
    for name in names:
        if name not in pictures:
            raise UnreadableError(
                f"[{name}]: expected a picture, got none among {', '.join(pictures) or 'none'}"
            )
    return [sight.decode(pictures[name], name) for name in names]
