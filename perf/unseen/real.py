"""Real pictures with something that is true of them, from folders that whoever runs it has.

None of them tells the pose. What a view needs is left out, or taken from the true depth, as said below.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from dream.geometry import SE3, Camera, FloatArray, camera_mount
from dream.perception import View
from dream.types import BoolArray, Float32Array, Label, UInt8Array

SIZE = 320, 240
"""Width and height to which pictures are brought."""
WATER, FLOOR, STRUCTURE, LEFT_OUT = 0, 1, 2, 255
KINDS = ("water", "floor", "structure")
SUIM_KINDS = np.array(
    [WATER, STRUCTURE, LEFT_OUT, STRUCTURE, STRUCTURE, STRUCTURE, LEFT_OUT, FLOOR], np.uint8
)
"""Of water, divers, plants, wrecks, robots, reefs, fish, and floor with rocks; by red, green, blue."""
FOCAL = 1230.0 / 968.0
"""Focal length of the cameras of FLSea beside the picture's width: 1175 and 1297 of 968 pixels."""
PLANE_TRIES = 400
FLATTEST = 0.2
"""Share of a picture that lies on a plane, below which the picture shows no bed."""


@dataclass(frozen=True, slots=True, eq=False)
class Masked:
    """A picture with kinds of what it shows."""

    name: str
    rgb: UInt8Array
    """(240, 320, 3)."""
    kinds: UInt8Array
    """(240, 320) `WATER`, `FLOOR`, `STRUCTURE` or `LEFT_OUT`."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A picture with depth."""

    name: str
    rgb: UInt8Array
    """(240, 320, 3)."""
    depth: Float32Array
    """(240, 320) metres along the optical axis; NaN where it is not known."""
    view: View


@dataclass(frozen=True, slots=True, eq=False)
class Boxed:
    """A picture with objects in boxes."""

    name: str
    rgb: UInt8Array
    """(240, 320, 3)."""
    boxes: tuple[tuple[str, int, int, int, int], ...]
    """Name, first column and row, last column and row; pixels of the small picture."""


def kinds_of(labels: UInt8Array) -> UInt8Array:
    """(H, W) kinds of values of `Label`: what is a target or an obstacle is structure."""
    return np.minimum(labels, np.uint8(Label.TARGET))


def _small(path: Path) -> UInt8Array:
    return np.asarray(Image.open(path).convert("RGB").resize(SIZE, Image.Resampling.BILINEAR))


def masked(folder: Path) -> Iterator[Masked]:
    """Pictures of SUIM: `name.jpg` with `name.bmp` beside it, or in `masks` beside `images`.

    Reference: Islam et al., Semantic Segmentation of Underwater Imagery, IROS 2020.
    """
    for path in sorted(folder.rglob("*.jpg")):
        beside = path.with_suffix(".bmp")
        mask = beside if beside.exists() else path.parent.parent / "masks" / beside.name
        if mask.exists():
            colours = Image.open(mask).convert("RGB").resize(SIZE, Image.Resampling.NEAREST)
            bits = (np.asarray(colours) > 127) @ np.array([4, 2, 1])
            yield Masked(path.stem, _small(path), SUIM_KINDS[bits])


def measured(folder: Path) -> Iterator[Measured]:
    """Pictures of FLSea as TRUDepth's example has them: `rgb/name.tiff`, `depth/name_depth.tif` in metres.

    Attitude and altitude are those over the plane that most of the true depth lies on: what a DVL and an IMU
    would tell over a flat bed. A picture without one is left out.

    Reference: Randall, Treibitz, FLSea, arXiv 2302.12772; Ebner et al., arXiv 2310.16750.
    """
    for path in sorted((folder / "rgb").glob("*.tif*")):
        found = np.asarray(Image.open(folder / "depth" / f"{path.stem}_depth.tif"), np.float32)
        thin = Image.fromarray(found).resize(SIZE, Image.Resampling.NEAREST)
        depth = np.where(np.asarray(thin) > 0.0, np.asarray(thin), np.float32(np.nan)).astype(np.float32)
        height, width = found.shape
        across, along = FOCAL * SIZE[0], FOCAL * width * SIZE[1] / height
        camera = Camera(*SIZE, across, along, 0.5 * SIZE[0], 0.5 * SIZE[1])
        view = view_over(depth, camera)
        if view is not None:
            yield Measured(path.stem, _small(path), depth, view)


def view_over(depth: Float32Array, camera: Camera) -> View | None:
    """The view over the plane that most of the lower part of (H, W) true depth lies on; None without one."""
    level = SE3(np.eye(3), np.zeros(3))
    points = camera.back_project(depth, level)[camera.height // 3 :: 3, ::3].reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    rng, best, most = np.random.default_rng(0), None, FLATTEST
    if len(points) < 100:
        return None
    for _ in range(PLANE_TRIES):
        a, b, c = points[rng.integers(len(points), size=3)]
        plane = _plane(np.cross(b - a, c - a), a)
        if plane is not None and (share := float(_on(points, plane).mean())) > most:
            best, most = plane, share
    if best is None:
        return None
    on = points[_on(points, best)]
    _, _, axes = np.linalg.svd(on - on.mean(axis=0), full_matrices=False)
    plane = _plane(axes[2], on.mean(axis=0))
    if plane is None:
        return None
    up, altitude = plane
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([ahead, np.cross(up, ahead), up])
    mount = camera_mount(0.0)
    return View(camera, SE3(rotation, np.zeros(3)) @ mount.inverse, mount, altitude)


def _plane(normal: FloatArray, point: FloatArray) -> tuple[FloatArray, float] | None:
    """Up (3,) and metres of the camera above a plane, in the camera's frame; None for what is no bed."""
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        return None
    up = normal / length
    up = up if up[1] < 0.0 else -up
    altitude = -float(up @ point)
    return (up, altitude) if up[1] < -math.cos(math.radians(65.0)) and altitude > 0.2 else None


def _on(points: FloatArray, plane: tuple[FloatArray, float]) -> BoolArray:
    """Which points (n, 3) lie within a twentieth of their height below the camera."""
    up, altitude = plane
    return np.asarray(np.abs(points @ up + altitude) < 0.05 * altitude)


def boxed(folder: Path, most: int = 200) -> Iterator[Boxed]:
    """Some pictures of the RoboSub Transdec set: `Images/n.jpg` and `Annotations/n.xml`, evenly chosen."""
    paths = sorted((folder / "Images").glob("*.jpg"))
    for path in paths[:: max(1, len(paths) // most)]:
        told = folder / "Annotations" / f"{path.stem}.xml"
        width, height = Image.open(path).size
        boxes = []
        for thing in ElementTree.parse(told).getroot().iter("object"):
            ends = [
                float(thing.findtext(f"bndbox/{end}") or math.nan) for end in ("xmin", "ymin", "xmax", "ymax")
            ]
            if not all(map(math.isfinite, ends)):
                continue
            a, b, c, d = (e * SIZE[n % 2] / (width, height)[n % 2] for n, e in enumerate(ends))
            if c - a >= 2.0 and d - b >= 2.0:
                boxes.append((thing.findtext("name") or "", int(a), int(b), math.ceil(c), math.ceil(d)))
        if boxes:
            yield Boxed(path.stem, _small(path), tuple(boxes))
