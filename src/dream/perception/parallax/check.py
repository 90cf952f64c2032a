"""A depth that a network claims, held against motion, the DVL's beams, and itself."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from dream.geometry import FloatArray
from dream.perception.flat_floor import rays
from dream.perception.parallax.matching import MotionPoints, PoseNoise, Shot, best_shot, corners, depths
from dream.perception.view import View
from dream.types import BoolArray, Float32Array, Label, UInt8Array

KEPT = 6
"""Earlier pictures."""
MOVED, TURNED = 0.1, math.radians(10.0)
"""Metres or radians from the last one that is kept on which another is."""

ENOUGH = 12
"""Points from which on they tell the scale."""
SPREAD = 4
"""Of the 4 × 3 parts of a picture, those that they must lie in."""
FEW = 3
"""Points that contradict together."""
PAIR = 2
"""Beams of the DVL that do."""
CONSISTENT = 0.15
"""By how much the logarithms of two depths may differ that agree."""
AGREEING = 0.6
"""Share of the points that must agree with each other to tell the scale."""
BELIEVED = math.log(1.4)
"""Logarithm of a scale beyond which the network is not corrected but contradicted."""
MOST = 0.75
"""Share of the points that contradict all of a depth where they do so."""
POINT = 0.05
"""Standard deviation of the logarithm of a network's depth at one point, once it is scaled."""
KNOWN = 0.05
"""Standard deviation of the logarithm of a scale beyond which it is not applied."""
ERRS = 0.15
"""Standard deviation of the logarithm of a network's scale."""
GROSS = math.log(1.5)
"""By how much the logarithms of depths differ of which one is wrong."""
EDGE = math.log(1.25)
"""By how much they differ on both sides of an edge."""
AROUND = 24.0
"""Pixels around a point for which it speaks, on the same surface."""
BEAM_WIDE = math.radians(4.0)
"""Half of what a beam of the DVL may be wide, and be off its direction."""
BEAM_SIGMA = 0.05
"""Standard deviation of the logarithm of a depth that a beam tells."""
ROUGH = 0.4
"""Share of the pixels, `PITCH` apart, that differ from their neighbours, from which on an answer is noise."""
BEND = 0.25
"""Share of an inverse depth by which it is off the mean of both its neighbours; on a plane it is not."""
PITCH = 8
"""Pixels, twice as many as a network makes one answer for."""
FALLS, FARTHEST_FALL = math.radians(25.0), 2.2
"""Radians below the horizon of floor that is near, and how many times as far as level ground it may be."""
ASKEW = 1.5
"""How many times as high as the DVL's beams say an altitude may be."""


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """What is left of a network's depth."""

    depth: Float32Array
    """(H, W) metres, corrected in scale; contradicted or not."""
    near: Float32Array
    """(H, W) confidence; 0 where it is contradicted."""
    scale: float
    """That it was multiplied by; NaN where nothing tells."""
    points: int
    """By which it was checked, beams among them."""
    against: int
    """Of these, those that contradict it."""
    doubt: str
    """What speaks against all of it; empty where nothing does."""


@dataclass(frozen=True, slots=True, eq=False)
class _Evidence:
    """Depths that are known at some pixels, and what the network says there."""

    places: FloatArray
    """(n, 2) columns and rows."""
    claimed: FloatArray
    """(n,) metres, by the network."""
    off: FloatArray
    """(n,) logarithm of what is known over that."""
    sigma: FloatArray
    beam: BoolArray
    shared: float

    def __len__(self) -> int:
        return len(self.off)


class Parallax:
    """Corrects the scale of depths, and finds those that cannot be.

    What it does: points of a picture that an earlier one shows from elsewhere have a depth by the poses of
    both. Where enough of them agree with each other, the depth is scaled by what they say, if that is
    little; if it is much, the frame has no depth, nor where points around say something else together. The
    beams of the DVL that end in view are points too. Where neither motion nor beams vouch for it, ground that
    is near below may not be far from where a level floor is. Depths and labels that change from pixel to
    pixel as noise does are none.

    Reference: points by correlation along the epipolar line, as in semi-dense depth from motion (Engel,
    Sturm, Cremers, *ICCV*, 2013), on patches that lie on level ground or stand upright.

    Assumes: a scene that stays as it is. Poses from one frame to the next that err by `noise`.

    Fails when: the vehicle only turns, the water has no contrast, or what is seen moves: light that plays on
    sand, say. Then it says nothing.
    """

    def __init__(self, noise: PoseNoise | None = None) -> None:
        """Nothing seen yet."""
        self.noise = noise or PoseNoise()
        """Of the pose from one frame to another."""
        self._shots: deque[Shot] = deque(maxlen=KEPT)

    def corrected(
        self,
        rgb: UInt8Array,
        labels: UInt8Array,
        depth: Float32Array,
        near: Float32Array,
        view: View,
        seen: BoolArray,
    ) -> Checked:
        """Hold a depth against what else is known, and remember the picture.

        Args:
            rgb: (H, W, 3).
            labels: (H, W) values of `Label`.
            depth: (H, W) metres along the optical axis, NaN where unknown.
            near: (H, W) confidence in it.
            view: Where the picture was taken.
            seen: (H, W) pixels that the lens saw.
        """
        now = Shot.of(rgb, view.camera, view.T_world_camera)
        points = self._points(now, view, depth, seen)
        self._keep(now)
        found = _evidence(points, depth, view)
        nothing = np.zeros_like(near)
        noise = _noise(labels, depth, seen)
        if noise:
            return Checked(depth, nothing, math.nan, len(found), len(found), noise)
        scale, against, doubt = _judged(found, depth.shape)
        if doubt:
            return Checked(depth, nothing, math.nan, len(found), int(np.count_nonzero(against)), doubt)
        vouching = ~against
        by_motion, by_beams = (np.count_nonzero(vouching & part) for part in (~found.beam, found.beam))
        vouched = by_motion >= FEW or by_beams >= PAIR
        if (labels[seen] == Label.TARGET).all() or not (vouched or _level(labels, depth, view, seen)):
            near = nothing
        else:
            near = np.where(_contradicted(found, against, depth), np.float32(0.0), near)
        if math.isfinite(scale):
            depth = depth * np.float32(scale)
        return Checked(depth, near, scale, len(found), int(np.count_nonzero(against)), _askew(view))

    def _points(self, now: Shot, view: View, depth: Float32Array, seen: BoolArray) -> MotionPoints:
        shots = best_shot(now, self._shots, _some_points(view))
        if not shots:
            return MotionPoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0), math.inf)
        places = corners(now, seen & np.isfinite(depth))
        up = now.T_world_camera.rotation[2]
        found = depths(now, shots[0], places, up, self.noise)
        if len(found.depth) < ENOUGH and len(shots) > 1:
            other = depths(now, shots[1], places, up, self.noise)
            if len(other.depth) > len(found.depth):
                return other
        return found

    def _keep(self, now: Shot) -> None:
        if self._shots:
            T_last_now = self._shots[-1].T_world_camera.inverse @ now.T_world_camera
            turned = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(T_last_now.rotation)) - 1.0))))
            if float(np.linalg.norm(T_last_now.translation)) < MOVED and turned < TURNED:
                return
        self._shots.append(now)


def _some_points(view: View) -> FloatArray:
    """(48, 3) metres in the camera's frame, evenly over the view: on the floor, or at most 4 m off."""
    camera = view.camera
    u, v = np.meshgrid((np.arange(8) + 0.5) / 8.0 * camera.width, (np.arange(6) + 0.5) / 6.0 * camera.height)
    x, y = (u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy
    ways = np.stack([x, y, np.ones_like(x)], axis=1)
    T_world_camera = view.T_world_camera
    height = view.altitude + float(T_world_camera.translation[2] - view.T_world_base.translation[2])
    down = -(ways @ T_world_camera.rotation[2])
    far = np.clip(height / np.maximum(down, 1e-3), 0.5, 4.0)
    return np.asarray(ways * far[:, None])


def _evidence(points: MotionPoints, depth: Float32Array, view: View) -> _Evidence:
    """What is known where the network claims something that is no edge."""
    places = points.places
    rows, cols = places[:, 1].astype(np.intp), places[:, 0].astype(np.intp)
    around = np.stack(
        [
            depth[np.clip(rows + i, 0, depth.shape[0] - 1), np.clip(cols + j, 0, depth.shape[1] - 1)]
            for i, j in ((-3, 0), (3, 0), (0, -3), (0, 3), (-1, -1), (-1, 0), (0, -1), (0, 0))
        ]
    ).astype(np.float64)
    claimed = 0.25 * around[4:].sum(axis=0)
    with np.errstate(invalid="ignore"):
        even = around.max(axis=0) < math.exp(EDGE) * around.min(axis=0)
    beams, along, claims = _beams(depth, view)
    return _Evidence(
        np.concatenate([places[even], beams]),
        np.concatenate([claimed[even], claims]),
        np.log(np.concatenate([points.depth[even] / claimed[even], along / claims])),
        np.concatenate([points.sigma[even], np.full(len(along), BEAM_SIGMA)]),
        np.concatenate([np.zeros(int(even.sum()), np.bool_), np.ones(len(along), np.bool_)]),
        points.shared,
    )


def _beams(depth: Float32Array, view: View) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where in view the DVL's beams end: places (n, 2), metres along the axis, and a claim near there."""
    camera = view.camera
    if view.beams is None:
        return np.zeros((0, 2)), np.zeros(0), np.zeros(0)
    pixels, away = camera.project(view.T_base_camera.inverse @ view.beams)
    places, known, claimed = [], [], []
    wide = BEAM_WIDE * camera.fx
    for (u, v), z in zip(pixels, away, strict=True):
        if not (0.0 <= u < camera.width and 0.0 <= v < camera.height and z > 0.1):
            continue
        top, left = max(0, int(v - wide)), max(0, int(u - wide))
        there = depth[top : int(v + wide) + 1, left : int(u + wide) + 1].astype(np.float64)
        there = there[there > 0.0]
        if there.size:
            places.append((u, v))
            known.append(z)
            claimed.append(there[np.argmin(np.abs(np.log(there / z)))])
    return np.array(places).reshape(-1, 2), np.array(known), np.array(claimed)


def _noise(labels: UInt8Array, depth: Float32Array, seen: BoolArray) -> str:
    """Whether neighbouring pixels have as little to do with each other as in noise, in words; else empty."""
    shown = seen[::PITCH, ::PITCH]
    marks = labels[::PITCH, ::PITCH]
    with np.errstate(divide="ignore"):
        inverse = 1.0 / np.where(shown, depth[::PITCH, ::PITCH].astype(np.float64), np.nan)
    differ, pairs, bent, threes = 0, 0, 0, 0
    for mark, near, inside in ((marks, inverse, shown), (marks.T, inverse.T, shown.T)):
        both = inside[1:] & inside[:-1]
        differ += int(np.count_nonzero(both & (mark[1:] != mark[:-1])))
        pairs += int(np.count_nonzero(both))
        with np.errstate(invalid="ignore"):
            bend = np.abs(0.5 * (near[2:] + near[:-2]) / near[1:-1] - 1.0)
        bent += int(np.count_nonzero(bend > BEND))
        threes += int(np.count_nonzero(np.isfinite(bend)))
    if pairs and differ > ROUGH * pairs:
        return "labels: scattered as noise is, and not mapped"
    if threes >= ENOUGH and bent > ROUGH * threes:
        return "depth: scattered as noise is, and not mapped"
    return ""


def _judged(found: _Evidence, shape: tuple[int, ...]) -> tuple[float, BoolArray, str]:
    """Scale, NaN where it is not known; which points contradict the depth; and what contradicts all of it."""
    if len(found) == 0:
        return math.nan, np.zeros(0, np.bool_), ""
    weights = 1.0 / (found.sigma**2 + POINT**2)
    middle, rough = _weighted_median(found.off, weights), 3.0 * found.sigma
    agree = np.abs(found.off - middle) <= CONSISTENT + rough
    gross = np.abs(found.off) > GROSS + rough
    moved = ~found.beam
    if np.count_nonzero(moved) < ENOUGH:
        least = FEW if moved.any() else PAIR
        all_of_it = np.count_nonzero(gross & agree) >= max(least, MOST * len(found))
        return math.nan, gross, _times(middle, found) if all_of_it else ""
    share = float(agree[moved].mean())
    sigma = math.hypot(found.shared, 1.0 / math.sqrt(float(weights[agree].sum())))
    far_off = abs(middle) - 2.0 * sigma > BELIEVED
    if far_off or share < 0.5:
        if float((np.abs(found.off) <= CONSISTENT + rough).mean()) > 1.0 - MOST:
            return math.nan, gross, ""
        odds = "depth: at odds with motion in most of the view, and not mapped"
        return math.nan, gross, _times(middle, found) if far_off else odds
    parts = np.unique(_parts(found.places[agree & moved], shape))
    if share < AGREEING or len(parts) < SPREAD or sigma > KNOWN:
        return math.nan, np.abs(found.off - middle) > GROSS + rough, ""
    middle = float(np.average(found.off[agree], weights=weights[agree]))
    middle *= ERRS**2 / (ERRS**2 + sigma**2)
    return math.exp(middle), np.abs(found.off - middle) > GROSS + rough, ""


def _times(middle: float, found: _Evidence) -> str:
    """How far off a depth is, in words."""
    says = "motion and the DVL's beams say"
    if found.beam.all() or not found.beam.any():
        says = "the DVL's beams say" if found.beam.all() else "motion says"
    return f"depth: {_about(math.exp(-middle))} times as far as {says}, and not mapped"


def _about(times: float) -> str:
    """In words that stay the same while it is about the same."""
    return f"{times:.1f}" if 0.95 <= times < 1.95 else f"{times:.1g}"


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, 0.5 * reached[-1])])


def _parts(places: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Which part of a picture (H, W) each place is in, of 4 × 3."""
    return np.asarray(places[:, 0] * 4.0 // shape[1] + 4.0 * (places[:, 1] * 3.0 // shape[0]))


def _contradicted(found: _Evidence, against: BoolArray, depth: Float32Array) -> BoolArray:
    """(H, W) pixels of a surface of which most points that are known contradict its depth, or a beam."""
    lost = np.zeros(depth.shape, np.bool_)
    rows, cols = np.arange(depth.shape[0])[:, None], np.arange(depth.shape[1])[None, :]
    for n in np.flatnonzero(against):
        apart = np.hypot(*(found.places - found.places[n]).T)
        beside = (apart <= 2.0 * AROUND) & (np.abs(np.log(found.claimed / found.claimed[n])) <= EDGE)
        alike = beside & against & (np.abs(found.off - found.off[n]) <= EDGE)
        if not found.beam[n] and np.count_nonzero(alike) < max(FEW, 0.67 * np.count_nonzero(beside)):
            continue
        u, v = found.places[n].tolist()
        near = (cols + 0.5 - u) ** 2 + (rows + 0.5 - v) ** 2 <= AROUND**2
        with np.errstate(invalid="ignore"):
            lost |= near & (np.abs(np.log(depth / found.claimed[n])) <= EDGE)
    return lost


def _level(labels: UInt8Array, depth: Float32Array, view: View, seen: BoolArray) -> bool:
    """Whether ground that is near below is about where a level floor is, or nothing tells."""
    looks = rays(view)
    steep = looks.down > math.tan(FALLS) * looks.ahead
    ground = seen & steep & ((labels == Label.SEABED) | (labels == Label.TARGET)) & np.isfinite(depth)
    if np.count_nonzero(ground) < 100:
        return True
    times = float(np.median(depth[ground].astype(np.float64) * looks.down[ground] / looks.height))
    return 1.0 / FARTHEST_FALL <= times <= FARTHEST_FALL


def _askew(view: View) -> str:
    """Whether the altitude is another than the DVL's beams say, in words; empty if not."""
    if view.beams is None:
        return ""
    level = view.T_world_base.rotation
    heights = -(view.beams @ level.T)[:, 2]
    heights = heights[np.isfinite(heights)]
    if len(heights) < FEW:
        return ""
    times = view.altitude / heights
    if (times > ASKEW).all() or (times < 1.0 / ASKEW).all():
        return f"altitude: {_about(float(np.median(times)))} times that of the DVL's beams"
    return ""
