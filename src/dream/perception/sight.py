"""Labels and depth from one picture, by the network that comes with DREAM; `dream train sight` makes it.

What it sees is the picture, and for each pixel what is known of the view: how far the floor would be, how far
down the ray goes, how wide the view is. So the scale of its depth comes from altitude and intrinsics.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dream.perception.depth import KNOWN_TO
from dream.perception.flat_floor import Rays, rays
from dream.perception.placing import nearest, placed, resampled
from dream.perception.repeats import Repeats
from dream.perception.view import View
from dream.types import Float32Array, Label, UInt8Array

if TYPE_CHECKING:
    from dream.perception.onnx import Network

SHIPPED = Path(__file__).parent / "weights" / "sight.onnx"
"""The network that comes with DREAM; `sight.json` beside it is its card."""
MOST_BYTES = 16 << 20
"""Of a network's file; the one that comes with DREAM has less than 3 MB."""

WIDTH, HEIGHT = 320, 240
"""Pixels of its input; a picture of any other size is stretched."""
GRID = 60, 80
"""Rows and columns of its depth."""
PICTURE, VIEW, LABELS, DEPTH, FEATURES = "picture", "view", "labels", "depth", "features"
"""What goes in and comes out: (1, 3, H, W) colours in [0, 1]; (1, 3, H, W) see `planes`; (1, 4, H, W) scores
of `Label`; (1, 2, h, w) logarithms of depth over that of the flat floor, and of the error in it (the scale of
a Laplace distribution); (1, 72, h, w) what it makes of the picture before that."""
NEAREST, FARTHEST = 0.15, 30.0
"""Metres along the optical axis that the flat floor is taken to lie between."""


@dataclass(frozen=True, slots=True, eq=False)
class SightAnswer:
    """What the network says of a picture of (H, W)."""

    shares: Float32Array
    """(4, H, W) probability of each `Label`."""
    depth: Float32Array | None
    """(H, W) metres along the optical axis, of water too; None where nothing is known of the view."""
    near: Float32Array | None
    """(H, W) probability that the depth is right to within `KNOWN_TO`."""
    features: Float32Array
    """(72, h, w) over the whole picture."""


class Sight:
    """Labels and depth by one network from colours, intrinsics, altitude and attitude.

    What it does: the probability of its likeliest label is the confidence in it. A depth's is the probability
    that it is right to a tenth, by the error that the network itself expects. Water has no depth. Where the
    answer stays the same for one picture after the other, there is none: water, with a confidence of 0.

    Assumes: a picture without lens distortion; an altitude above what is below, as a DVL gives it.

    Fails when: what is in view is like nothing that it learned from; see its card and docs/perception.md.
    """

    def __init__(self, path: str | Path | None = None, *, threads: int = 1) -> None:
        """Open a network.

        Args:
            path: Of the .onnx file; the one that comes with DREAM where None.
            threads: Of the CPU.

        Raises:
            ValueError: It is too large, damaged, not as its card says, or has other inputs or outputs.
        """
        self._network = opened(path, threads=threads)
        self._repeats = Repeats()
        self._last: tuple[UInt8Array, View | None, SightAnswer | None] | None = None

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        """See `Segmenter.segment`."""
        answer = self._answer(rgb, view)
        if answer is None:
            return np.full(rgb.shape[:2], Label.WATER, np.uint8), np.zeros(rgb.shape[:2], np.float32)
        return answer.shares.argmax(axis=0).astype(np.uint8), answer.shares.max(axis=0)

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        """See `DepthModel.estimate`; the labels only say what is water."""
        answer = self._answer(rgb, view)
        if answer is None or answer.depth is None or answer.near is None:
            return np.full(labels.shape, np.nan, np.float32), np.zeros(labels.shape, np.float32)
        solid = labels != Label.WATER
        return (
            np.where(solid, answer.depth, np.float32(np.nan)),
            np.where(solid, answer.near, np.float32(0.0)),
        )

    def answer(self, rgb: UInt8Array, view: View | None = None) -> SightAnswer:
        """All that the network says, believed or not.

        Args:
            rgb: (H, W, 3) uint8.
            view: Where it was taken; None where that is not known.

        Raises:
            ValueError: The picture does not fit the view's camera, or the network fails.
        """
        return self._asked(rgb, view)[0]

    def _answer(self, rgb: UInt8Array, view: View | None) -> SightAnswer | None:
        """That of the last time where the question is the same; None where it is not to be believed."""
        if self._last is not None:
            picture, seen_from, answer = self._last
            if picture is rgb and seen_from is view:
                return answer
        found, repeats = self._asked(rgb, view)
        self._last = rgb, view, None if repeats else found
        return self._last[2]

    def _asked(self, rgb: UInt8Array, view: View | None) -> tuple[SightAnswer, bool]:
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
            raise ValueError(f"rgb: expected (H, W, 3) uint8, got {rgb.shape} {rgb.dtype}")
        if view is not None:
            view.camera.check(rgb, "rgb")
        picture, known = scaled(rgb), planes(view)
        names = [LABELS, DEPTH, FEATURES]
        scores, depth, features = (
            out[0].astype(np.float32) for out in self._network.run(picture, names, {VIEW: known})
        )
        repeats = self._repeats.told(picture, scores) or not np.isfinite(scores).all()
        frame = placed(rgb.shape, HEIGHT, WIDTH, letterbox=False)
        odds = np.exp(scores - scores.max(axis=0))
        shares = odds / odds.sum(axis=0)
        if shares.shape[1:] != rgb.shape[:2]:
            shares = resampled(shares, frame, rgb.shape)
        if view is None:
            return SightAnswer(shares, None, None, features), repeats
        # A depth between that of what is in front and that of what is behind would be neither.
        ratio, error = nearest(depth, frame, rgb.shape)
        with np.errstate(over="ignore"):
            metres = floor_along_axis(rays(view)) * np.exp(np.clip(ratio, -6.0, 6.0))
            near = 1.0 - np.exp(-math.log(KNOWN_TO) * np.exp(-np.clip(error, -8.0, 8.0)))
        lost = ~(np.isfinite(ratio) & np.isfinite(error))
        return (
            SightAnswer(
                shares,
                np.where(lost, np.float32(np.nan), metres).astype(np.float32),
                np.where(lost, np.float32(0.0), near).astype(np.float32),
                features,
            ),
            repeats,
        )


def opened(path: str | Path | None = None, *, threads: int = 1) -> Network:
    """The network in a file, checked; the one that comes with DREAM where None.

    Raises:
        ValueError: See `Sight`.
    """
    from dream.perception.onnx import Network, sha256_of

    if path is None:
        network = Network(
            SHIPPED,
            threads=threads,
            most=MOST_BYTES,
            sha256=sha256_of(SHIPPED.with_suffix(".json")),
            extra="learned",
            beside=(VIEW,),
        )
    else:
        network = Network(path, threads=threads, most=MOST_BYTES, extra="learned", beside=(VIEW,))
    missing = [name for name in (LABELS, DEPTH, FEATURES) if name not in network.outputs]
    if missing or network.input_shape[1:] != (3, HEIGHT, WIDTH):
        raise ValueError(
            f"model: expected a network of `dream train sight`, with an input (n, 3, {HEIGHT}, {WIDTH}) and "
            f"outputs {LABELS}, {DEPTH} and {FEATURES}, got {network.input_shape} and "
            f"{', '.join(network.outputs)[:200]}"
        )
    return network


def file_sha256(path: str | Path) -> str:
    """Of a network's file.

    Raises:
        ValueError: It cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ValueError(f"model: expected a readable file, got {path} ({error.strerror})") from error


def scaled(rgb: UInt8Array) -> Float32Array:
    """(1, 3, H, W) float32 in [0, 1]: a picture at the size of the network's input."""
    from PIL import Image

    if rgb.shape[:2] != (HEIGHT, WIDTH):
        rgb = np.asarray(Image.fromarray(rgb).resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR))
    picture: Float32Array = np.ascontiguousarray(rgb.transpose(2, 0, 1)[None]).astype(np.float32)
    picture /= np.float32(255.0)
    return picture


def planes(view: View | None) -> Float32Array:
    """(1, 3, H, W) float32: what is known of the view at each pixel of the input; 0 where nothing is.

    How near the flat floor would be, 1 / (1 + z / 2) − 0.4 for a depth of z metres; the share of each metre
    along the ray that leads down; and the tangent of half the view's width, less 0.8.
    """
    found = np.zeros((1, 3, HEIGHT, WIDTH), np.float32)
    if view is None:
        return found
    there = _at_input(view)
    looks, camera = rays(there), there.camera
    found[0, 0] = 1.0 / (1.0 + 0.5 * floor_along_axis(looks)) - 0.4
    found[0, 1] = looks.down / np.hypot(looks.down, looks.ahead)
    found[0, 2] = 0.5 * camera.width / camera.fx - 0.8
    return found


def floor_along_axis(looks: Rays) -> Float32Array:
    """(H, W) metres along the optical axis to the flat floor, between `NEAREST` and `FARTHEST`.

    The latter above the horizon, too.
    """
    down = np.maximum(looks.down, 1e-3)
    depth = np.where(looks.down > 1e-3, np.float32(looks.height) / down, np.float32(FARTHEST))
    return np.clip(depth, NEAREST, FARTHEST).astype(np.float32)


def _at_input(view: View) -> View:
    """The same view in pixels of the network's input."""
    camera = view.camera
    if (camera.width, camera.height) == (WIDTH, HEIGHT):
        return view
    across, along = WIDTH / camera.width, HEIGHT / camera.height
    stretched = replace(
        camera,
        width=WIDTH,
        height=HEIGHT,
        fx=camera.fx * across,
        fy=camera.fy * along,
        cx=camera.cx * across,
        cy=camera.cy * along,
    )
    return replace(view, camera=stretched)
