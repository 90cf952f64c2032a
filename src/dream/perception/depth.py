"""What labels and depth are asked of, and the two together."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from dream.geometry import Camera
from dream.perception.flat_floor import floor_depth, rays
from dream.perception.parallax import Checked, Parallax
from dream.perception.view import View
from dream.types import BoolArray, Float32Array, Label, UInt8Array

LEAST_BELIEVED = 1.0 / 32.0
"""Confidence below which a depth is none: half of the least weight that a map knows."""
FEWEST = 100
"""Pixels of floor that a fit, or a share, is made of."""
KNOWN_TO = 1.1
"""The confidence in a depth is the probability that it is right to within this factor."""
NEAR_ENOUGH = 0.1
"""Share of the floor's depth within which a pixel agrees with it."""


class Segmenter(Protocol):
    """Tells what every pixel shows."""

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        """Labels and confidence.

        Args:
            rgb: (H, W, 3).
            view: Where it was taken; None where that is not known.

        Returns:
            (H, W) values of `Label`, and (H, W) float32 in [0, 1]: the probability that each is right, 0
            where nothing tells what a pixel shows; that is called water.
        """


class DepthModel(Protocol):
    """Tells how far away every pixel is."""

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        """Depth and confidence.

        Args:
            rgb: (H, W, 3).
            labels: (H, W) values of `Label`, as a segmenter gave them.
            view: Where it was taken.

        Returns:
            (H, W) float32 metres along the optical axis, NaN where unknown; and (H, W) float32 in [0, 1]: the
            probability that each is right to within the factor `KNOWN_TO`, 0 where the depth is NaN.
        """


@dataclass(frozen=True, slots=True)
class Account:
    """How far a frame's labels and depth can be believed."""

    confidence: float
    """Mean over the pixels that have a depth; 0 without any."""
    labels: float
    """Mean confidence in the labels."""
    beside_floor: float
    """Median of depth over that of the flat floor that altitude and attitude tell, over what is labelled
    seabed or target, believed or not; NaN where too little of it is seen."""
    agreement: float
    """Share of those pixels that lie within a tenth of the floor's depth; NaN likewise."""
    lost: int
    """Pixels that have no label, since the network gave none that could be one."""
    no_depth: int
    """Pixels that show something, by their label, and have no depth that is believed."""
    shares: tuple[float, ...]
    """Of all pixels, for each label."""
    floating: float
    """Share of what is above the horizon that is labelled seabed, as a slope may be, and as walls and water
    are by a network that knows of neither; NaN where too little is above."""
    doubt: str
    """What speaks against all of it, in words that stay the same while it lasts; empty where nothing does."""
    scale: float = math.nan
    """That depth was multiplied by, as motion says; NaN where it was not."""
    points: int = 0
    """Pixels whose depth was checked by motion, or by a beam of the DVL."""
    against: int = 0
    """Of these, those that contradict it."""

    def said(self) -> dict[str, object]:
        """For a log, in JSON."""
        beside, agreement, floating, scale = (
            round(value, 3) if math.isfinite(value) else None
            for value in (self.beside_floor, self.agreement, self.floating, self.scale)
        )
        return {
            "confidence": round(self.confidence, 3),
            "labels_confidence": round(self.labels, 3),
            "depth_beside_floor": beside,
            "depth_agreement": agreement,
            "pixels_without_label": self.lost,
            "pixels_without_depth": self.no_depth,
            "label_shares": {
                label.name.lower(): round(share, 3) for label, share in zip(Label, self.shares, strict=True)
            },
            "seabed_above_horizon": floating,
            "depth_scale": scale,
            "points_checked": self.points,
            "points_against": self.against,
            "doubt": self.doubt,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Perceived:
    """What a picture shows."""

    depth: Float32Array
    """(H, W) metres along the optical axis, NaN where unknown or not believed."""
    labels: UInt8Array
    """(H, W) values of `Label`."""
    confidence: Float32Array
    """(H, W) in both, the lesser of the two; in the label where that is water; else 0 where no depth is."""
    error: Float32Array
    """(H, W) mean of the logarithm, without its sign, of depth over truth, NaN where there is no depth."""
    account: Account


@dataclass(frozen=True, slots=True)
class Perception:
    """Depth and labels of a real camera's picture, for the map.

    What it does: labels first, then depth, which may follow from the labels. Colour may be finer than the
    camera for mapping by a whole factor; it is averaged. Depth that is not believed is none, so that nothing
    of it is mapped.

    Assumes: a picture without lens distortion, that belongs to the pose.
    """

    segmenter: Segmenter
    depth: DepthModel
    check: Parallax | None = None
    """Holds the depth against motion and the DVL's beams, where given; it remembers earlier pictures."""

    @property
    def anew(self) -> Self:
        """The same, with a check that has seen nothing yet where it has one."""
        return self if self.check is None else replace(self, check=Parallax(self.check.noise))

    def perceive(self, rgb: UInt8Array, view: View, seen: BoolArray | None = None) -> Perceived:
        """What a picture shows.

        Args:
            rgb: (k H, k W, 3) uint8.
            view: Where it was taken; its camera is that of an image of (H, W).
            seen: (H, W) pixels that the lens saw; the others have no depth. All where None.

        Raises:
            ValueError: The picture does not fit the camera, or the altitude is not a number above 0.
        """
        camera = view.camera
        coarse = averaged(rgb, camera)
        labels, sure = self.segmenter.segment(coarse, view)
        camera.check(labels, "labels")
        depth, near = self.depth.estimate(coarse, labels, view)
        camera.check(depth, "depth")
        seen = np.ones(labels.shape, np.bool_) if seen is None else seen
        checked: Checked | None = None
        if self.check is not None:
            checked = self.check.corrected(coarse, labels, depth, near, view, seen)
            depth, near = checked.depth, checked.near
        confidence = np.minimum(sure, near)
        believed = seen & np.isfinite(depth) & (confidence >= LEAST_BELIEVED)
        kept = np.where(believed, depth, np.float32(np.nan))
        confidence = np.where(believed, confidence, np.float32(0.0))
        floor, above = _floor(view)
        account = _account(labels, sure, depth, confidence, seen, floor, above)
        if checked is not None:
            account = replace(
                account,
                scale=checked.scale,
                points=checked.points,
                against=checked.against,
                doubt="; ".join(filter(None, (account.doubt, checked.doubt))),
            )
        confidence = np.where((labels == Label.WATER) & seen, sure, confidence)
        return Perceived(kept, labels, confidence, _error(kept, near), account)


def _error(depth: Float32Array, near: Float32Array) -> Float32Array:
    """(H, W) see `Perceived.error`: that of a Laplace distribution, by the probability to be near."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error = -math.log(KNOWN_TO) / np.log1p(-near.astype(np.float64))
    return np.where(np.isfinite(depth), error, np.nan).astype(np.float32)


def _floor(view: View) -> tuple[Float32Array, BoolArray]:
    """(H, W) metres to the flat floor, however far, and the pixels that look above the horizon."""
    looks = rays(view)
    return floor_depth(looks, math.inf), looks.down <= 0.0


def _account(
    labels: UInt8Array,
    sure: Float32Array,
    depth: Float32Array,
    confidence: Float32Array,
    seen: BoolArray,
    floor: Float32Array,
    above: BoolArray,
) -> Account:
    """See `Account`; depth is that of the model, confidence 0 where it is not believed."""
    believed, lost = confidence > 0.0, seen & (sure <= 0.0)
    on_floor = seen & ((labels == Label.SEABED) | (labels == Label.TARGET)) & np.isfinite(floor)
    on_floor &= np.isfinite(depth)
    beside = agreement = math.nan
    if np.count_nonzero(on_floor) >= FEWEST:
        # Not in single precision, which a depth that is far off may leave.
        times = depth[on_floor].astype(np.float64) / floor[on_floor]
        beside, agreement = float(np.median(times)), float((np.abs(times - 1.0) <= NEAR_ENOUGH).mean())
    total = max(int(np.count_nonzero(seen)), 1)
    shares = tuple(np.count_nonzero(seen & (labels == label)) / total for label in Label)
    high = seen & above
    floating = math.nan
    if np.count_nonzero(high) >= FEWEST:
        floating = np.count_nonzero(high & (labels == Label.SEABED)) / np.count_nonzero(high)
    doubts = []
    if np.count_nonzero(lost) == total:
        doubts.append("labels: the network gives none that can be believed")
    if shares[Label.TARGET] == 1.0:
        doubts.append("labels: every pixel is target")
    if shares[Label.WATER] < 1.0 and not believed.any():
        doubts.append(
            f"depth: {beside:.1f} times as far as the floor by the DVL and the attitude, and not mapped"
            if abs(beside - 1.0) > NEAR_ENOUGH
            else "depth: nothing that is seen has one that can be believed"
        )
    return Account(
        float(confidence[believed].mean()) if believed.any() else 0.0,
        float(sure[seen].mean()) if seen.any() else 0.0,
        beside,
        agreement,
        int(np.count_nonzero(lost)),
        int(np.count_nonzero(seen & (labels != Label.WATER) & ~believed)),
        shares,
        floating,
        "; ".join(doubts),
    )


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
