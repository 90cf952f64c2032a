"""One frame into the map, against slow twins."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from dream.geometry import SE3, Bounds, Camera, camera_mount
from dream.mapping import OccupancyMap
from dream.mapping._kernels.flags import (
    BARE,
    CROSSED,
    EXPLORED,
    GROUNDED,
    RETURNED,
    SEABED,
)
from dream.mapping.frame import MARGIN, _overlook
from dream.mapping.layers import Evidence, probability_of_votes
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.types import Label
from tests.mapping.analytic import SEABED as SEABED_Z
from tests.mapping.analytic import Disc, Pillar, render

Float64Array = npt.NDArray[np.float64]
f32 = np.float32

SHALLOW = replace(DREAM_V1, altitude=0.8, reach=2.4, cell=0.16, band=(0.2, 1.0))
COARSE = replace(DREAM_V1, altitude=1.3, reach=5.0)
FAR = 1e6


# --------------------------------------------------------------------------------------------- the seabed


def halved(cells: Float64Array) -> Float64Array:
    """Sums of two by two."""
    rows, cols = cells.shape
    summed: Float64Array = cells.reshape(rows // 2, 2, cols // 2, 2).sum(axis=(1, 3))
    return summed


def between(cells: Float64Array, at_row: Float64Array, at_col: Float64Array) -> Float64Array:
    """Bilinear values between the cells' centres, whose own coordinates are whole; the border goes on."""
    rows, cols = cells.shape
    at_row, at_col = np.clip(at_row, 0, rows - 1), np.clip(at_col, 0, cols - 1)
    i, j = (
        np.minimum(np.floor(at_row).astype(int), rows - 2),
        np.minimum(np.floor(at_col).astype(int), cols - 2),
    )
    u, v = (at_row - i)[:, None], (at_col - j)[None, :]
    corners = [cells[np.ix_(a, b)] for a in (i, i + 1) for b in (j, j + 1)]
    value: Float64Array = (corners[0] * (1 - v) + corners[1] * v) * (1 - u) + (
        corners[2] * (1 - v) + corners[3] * v
    ) * u
    return value


def smooth(total: Float64Array, count: Float64Array, evidence: Evidence, datum: float) -> Float64Array:
    """Heights of all posts: from the coarsest grid down, each mean is drawn to the coarser grid's value."""
    grids = [(total, count)]
    for _ in range(3):
        weight = np.minimum(grids[-1][1], evidence.ground_share)
        mean = np.divide(grids[-1][0], grids[-1][1], out=np.zeros_like(weight), where=grids[-1][1] > 0)
        grids.append((halved(mean * weight), halved(weight)))
    total, count = grids.pop()
    height = np.where(count > 0, total / np.maximum(count, 1e-300), datum)
    for total, count in reversed(grids):
        rows, cols = (np.arange(n, dtype=np.float64) * 0.5 - 0.25 for n in total.shape)
        prior = between(height, rows, cols)
        height = (total + evidence.ground_pixels * prior) / (count + evidence.ground_pixels)
    return height


# ------------------------------------------------------------------------------------------- the whole map


class Sector:
    """What the camera sees of the plane; its angles are those in the vertical plane along its axis."""

    def __init__(self, protocol: SurveyProtocol, camera: Camera, T_world_camera: SE3) -> None:
        x, y, z = T_world_camera.rotation[:, 2]
        down = math.atan2(-z, math.hypot(x, y))
        left, right = math.atan(camera.cx / camera.fx), math.atan((camera.width - camera.cx) / camera.fx)
        lower = down + math.atan((camera.height - camera.cy) / camera.fy)
        self.exists = math.hypot(x, y) >= 0.1
        self.yaw, self.half = math.atan2(y, x) + (left - right) / 2, (left + right) / 2
        self.level = down <= math.atan(camera.cy / camera.fy)
        if lower <= 0.0:
            self.blind = math.inf
        else:
            self.blind = protocol.altitude / math.tan(lower) if lower < math.pi / 2 else 0.0

    def contains(self, x: float, y: float) -> bool:
        ahead = x * math.cos(self.yaw) + y * math.sin(self.yaw)
        return not self.exists or ahead >= math.hypot(x, y) * math.cos(self.half) - 1e-6

    def rays(self) -> range:
        if not self.exists:
            return range(0)
        first, last = ((self.yaw + side) * 1024 / (2 * math.pi) for side in (-self.half, self.half))
        return range(math.floor(first) - 1, math.floor(last) + 2)


class PlainMap:
    """`OccupancyMap.integrate` over dense arrays around a place, cell by cell."""

    def __init__(
        self,
        bounds: Bounds | None,
        protocol: SurveyProtocol,
        x: float,
        y: float,
        evidence: Evidence | None = None,
    ) -> None:
        self.bounds, self.protocol, self.evidence = bounds, protocol, evidence or Evidence()
        self.post = 2 ** min(max(round(math.log2(0.64 / protocol.cell)), 0), 4)
        self.x0, self.y0 = (0.0, 0.0) if bounds is None else (bounds.x_min, bounds.y_min)
        block = max(8 * self.post, 64)  # Whole blocks, and whole posts of the coarsest grid.
        here = (math.floor((a - b) / protocol.cell) for a, b in ((y, self.y0), (x, self.x0)))
        self.low = tuple((a // block - 2) * block for a in here)
        side = 5 * block
        self.log_odds = np.zeros((side, side), np.int8)
        self.flags, self.votes = np.zeros((side, side), np.uint8), np.zeros((side, side), np.uint8)
        posts = side // self.post
        self.ground_sum, self.ground_count = np.zeros((posts, posts), f32), np.zeros((posts, posts), f32)
        self.inside = np.ones((side, side), np.bool_)
        if bounds is not None:
            rows, cols = (np.arange(side) + low for low in self.low)
            self.inside = ((rows >= 0) & (rows < round(bounds.depth / protocol.cell)))[:, None] & (
                (cols >= 0) & (cols < round(bounds.width / protocol.cell))
            )[None, :]
        self.datum = math.nan

    def posts(self, extra: tuple[Float64Array, Float64Array] | None = None) -> Float64Array:
        total, count = self.ground_sum.astype(float), self.ground_count.astype(float)
        if extra is not None:
            total, count = total + extra[0], count + extra[1]
        return smooth(total, count, self.evidence, self.datum)

    def heights(self, posts: Float64Array) -> npt.NDArray[np.float32]:
        """At every cell's centre; from west to east in single precision."""
        n = self.post
        at = (np.arange(len(self.flags)) + 0.5) / n - 0.5
        lines = between(posts, at, np.arange(len(posts), dtype=float)).astype(f32)
        col = np.clip(np.floor(at).astype(int), 0, len(posts) - 2)
        share = (((np.arange(n) + 0.5) / n).astype(f32))[(np.arange(len(at)) + n // 2) % n]
        west, east = lines[:, col], lines[:, col + 1]
        height: npt.NDArray[np.float32] = west + (east - west) * share
        return height

    def integrate(
        self,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
        confidence: npt.NDArray[Any] | None = None,
    ) -> None:
        protocol, evidence, cell = self.protocol, self.evidence, self.protocol.cell
        R, t = T_world_camera.rotation, T_world_camera.translation
        soft = labels.dtype.kind == "f"
        self.datum = float(t[2]) - protocol.altitude
        here = [math.floor((float(a) - b) / cell) for a, b in ((t[1], self.y0), (t[0], self.x0))]
        # The cells are counted from the corner of a window around the camera, on a post.
        half = math.ceil(protocol.reach / cell) + 1
        corner = [(a - half) // self.post * self.post for a in here]

        # ---- which pixels count, and where they are, in single precision
        z = depth.astype(f32) * f32(0.001 if depth.dtype == np.uint16 else 1.0)
        thin = cell * min(camera.fx, camera.fy) / 4
        cuts = [f32(thin / 2), f32(thin / 4)]
        valid = (z > f32(protocol.min_depth)) & (z <= f32(protocol.max_depth))
        sixteenths = np.rint((np.ones(z.shape, f32) if confidence is None else confidence) * 16).astype(int)
        if not soft:
            valid &= (labels != Label.WATER) & (sixteenths > 0)
        level: npt.NDArray[Any] = (z <= cuts[0]).astype(int) + (z <= cuts[1])
        pixel: npt.NDArray[Any] = np.indices(z.shape)
        v, u = pixel
        near_horizon = np.abs(R[2, 1] * ((v + 0.5 - camera.cy) / camera.fy) + R[2, 2]) <= 0.1
        taken = valid & ((v % (1 << level) == 0) | near_horizon) & (u % (2 << level) == 0)
        # By levels, then in raster order.
        order = np.lexsort((u[taken], v[taken], level[taken]))
        v, u, z, level, label, sure = (a[taken][order] for a in (v, u, z, level, labels, sixteenths))
        a, b = (u + 0.5 - camera.cx) / camera.fx, (v + 0.5 - camera.cy) / camera.fy
        part = [(R[k, 0] * a).astype(f32) + (R[k, 1] * b + R[k, 2]).astype(f32) for k in range(3)]
        x, y, up = (z * of for of in part)
        left = f32((t[0] - (self.x0 + corner[1] * cell)) / cell)
        bottom = f32((t[1] - (self.y0 + corner[0] * cell)) / cell)
        col = (left + x * f32(1 / cell)).astype(int) + corner[1] - self.low[1]
        row = (bottom + y * f32(1 / cell)).astype(int) + corner[0] - self.low[0]
        height = f32(t[2]) + up

        # ---- how far every ray is known to have run: each column's farthest return, some rays to either side
        farthest = np.zeros(1024, f32)
        for of in range(3):
            for column in np.unique(u[level == of]):
                own = (level == of) & (u == column)
                square = (x * x + y * y)[own]
                far = int(square.argmax())
                ray = math.floor(float(np.arctan2(y[own][far], x[own][far])) * (1024 / (2 * math.pi)))
                spread = max(math.ceil((2 << of) * 1024 / (2 * math.pi) / camera.fx), 5)
                for near in range(ray - spread, ray + spread + 1):
                    farthest[near % 1024] = max(farthest[near % 1024], np.sqrt(square[far]))

        near = x * x + y * y <= f32(protocol.reach**2)
        row, col = np.where(near, row, 0), np.where(near, col, 0)
        near &= self.inside[row, col]
        row, col, height, u, level, label, sure = (a[near] for a in (row, col, height, u, level, label, sure))

        # ---- the seabed
        total, count = np.zeros(self.ground_sum.shape), np.zeros(self.ground_sum.shape)
        under = tuple((a - low) // self.post for a, low in zip(here, self.low, strict=True))
        total[under], count[under] = self.datum, 1
        if soft:
            byte = (label.astype(f32) * f32(255)).astype(int)
            prior = self.posts()[row // self.post, col // self.post]
            seabed = (byte < 128) & (np.abs(height - prior) <= protocol.band[0])
            weight = np.rint(byte / 255 * 16).astype(int)
        else:
            seabed = (label == Label.SEABED) & (sure >= 8)
            weight = np.where(label == Label.TARGET, sure, 0)
        seabed &= (u // (2 << level)) % 8 == 0
        np.add.at(total, (row[seabed] // self.post, col[seabed] // self.post), height[seabed])
        np.add.at(count, (row[seabed] // self.post, col[seabed] // self.post), 1)
        ground = self.heights(self.posts((total, count)))

        # ---- what every cell shows: pixels below the band, in its lower quarter, above that, over it
        low, high = protocol.band
        above = height - ground[row, col]
        field = (
            (above >= f32(low)).astype(int) + (above > f32(low + 0.25 * (high - low))) + (above > f32(high))
        )
        shown = np.zeros((*self.flags.shape, 4), int)
        np.add.at(shown, (row, col, field), 1)
        targets = np.zeros(self.flags.shape, int)
        np.add.at(targets, (row, col), weight)
        whole = np.zeros(self.flags.shape, int)
        np.add.at(whole, (row, col), sure)

        eye = (float(t[1]) - self.y0) / cell - self.low[0], (float(t[0]) - self.x0) / cell - self.low[1]
        sector = Sector(protocol, camera, T_world_camera)
        odds, said = self.log_odds.astype(int), np.zeros(self.flags.shape, np.uint8)
        vote = np.zeros(self.flags.shape, int)
        for i, j in np.argwhere(shown.any(axis=2)):
            pixels = shown[i, j].sum()
            trust = whole[i, j] / (16 * pixels)
            change = self.change(shown, int(i), int(j), eye, sector, trust)
            odds[i, j] = min(max(odds[i, j] + change, LOWEST), 70)
            said[i, j] |= RETURNED
            if shown[i, j, 0]:
                said[i, j] |= BARE | SEABED
            if targets[i, j]:
                said[i, j] |= SEABED
            if change > 0 and shown[i, j, 1]:
                said[i, j] |= GROUNDED
            band = shown[i, j, 1:3].sum()
            enough = pixels - (band if band < evidence.min_pixels else 0) >= evidence.vote_pixels
            if enough and trust >= 0.5:
                if targets[i, j] >= evidence.vote_share * whole[i, j]:
                    vote[i, j] = 1
                elif targets[i, j] <= evidence.against_share * whole[i, j]:
                    vote[i, j] = 2
        returned: npt.NDArray[np.bool_] = np.asarray(shown.any(axis=2))
        self.cast(sector, eye, farthest, returned, odds, said)

        # ---- into the map
        blocks = len(self.flags) // 64
        touched: npt.NDArray[np.bool_] = np.asarray(
            (said > 0).reshape(blocks, 64, blocks, 64).any(axis=(1, 3))
        )
        self.log_odds = odds.astype(np.int8)
        self.flags |= said
        self.flags[odds <= 0] &= 0xFF ^ GROUNDED
        for i, j in np.argwhere(vote):
            votes = [self.votes[i, j] >> 4, self.votes[i, j] & 15]
            if votes[vote[i, j] - 1] == 15:
                votes = [votes[0] // 2, votes[1] // 2]
            votes[vote[i, j] - 1] += 1
            self.votes[i, j] = votes[0] << 4 | votes[1]
        for i, j in np.argwhere(count):
            if touched[i * self.post // 64, j * self.post // 64]:
                points = float(self.ground_count[i, j]) + count[i, j]
                mean = (float(self.ground_sum[i, j]) + total[i, j]) / points
                points = min(points, evidence.ground_memory)
                self.ground_sum[i, j], self.ground_count[i, j] = mean * points, points

    def change(
        self, shown: npt.NDArray[Any], i: int, j: int, here: tuple[float, float], sector: Sector, trust: float
    ) -> int:
        """Twentieths of log-odds from a cell's own pixels: 12 a hit, −12 or −3 a miss, −6 mere scatter; as
        far as its pixels are sure, but one at least."""
        evidence = self.evidence
        band, below, pixels = shown[i, j, 1:3].sum(), shown[i, j, 0], shown[i, j].sum()
        away = np.array([i + 0.5 - here[0], j + 0.5 - here[1]])
        distance = float(np.hypot(*away))
        if band < evidence.min_share * pixels or band < evidence.min_pixels:
            if band >= evidence.min_share * pixels or below < evidence.min_ground:
                return 0
            if not sector.contains(away[1], away[0]):
                return 0
            around = np.s_[i - 1 : i + 2, j - 1 : j + 2]
            grounded = (self.log_odds[around] > 0) & (self.flags[around] & GROUNDED > 0)
            return -max(round(trust * (12 if self.log_odds[i, j] <= 0 or grounded.any() else 3)), 1)
        scatter = evidence.range_noise * (distance * self.protocol.cell) ** 2 / self.protocol.cell
        most = band
        for k in range(1, math.ceil(2 * scatter - 0.3) + 1):
            behind = np.floor(np.array([i, j]) + 0.5 + k * away / distance).astype(int)
            most = max(most, shown[behind[0], behind[1], 1:3].sum())
        if band < evidence.peak_share * most:
            return -max(round(trust * 6), 1)
        return max(round(12 * (trust * min(1.0, 0.5 / max(scatter, 1e-9)))), 1)

    def cast(
        self,
        sector: Sector,
        here: tuple[float, float],
        farthest: npt.NDArray[np.float32],
        returned: npt.NDArray[np.bool_],
        odds: npt.NDArray[Any],
        said: npt.NDArray[np.uint8],
    ) -> None:
        """Ray by ray, every cell that it crosses, in order."""
        cell, reach = self.protocol.cell, self.protocol.reach / self.protocol.cell
        ran, ended = np.zeros(odds.shape, np.bool_), np.zeros(odds.shape, np.bool_)
        for ray in sector.rays():
            known = float(farthest[ray % 1024]) / cell
            if not known:
                continue
            bearing = (ray % 1024 + 0.5) * 2 * math.pi / 1024
            way = np.array([math.sin(bearing), math.cos(bearing)])
            lines = [
                (np.arange(-reach - 2, reach + 3).round() + math.floor(a) - a) / w
                for a, w in zip(here, way, strict=True)
            ]
            enters = np.unique(np.concatenate([[0.0], *lines]))
            enters = enters[(enters >= 0.0) & (enters <= reach + 2)]
            middle = 0.5 * (enters[:-1] + enters[1:])[enters[:-1] <= reach]
            enters = enters[: len(middle)]
            i, j = (np.floor(a + middle * w).astype(int) for a, w in zip(here, way, strict=True))
            solid = self.inside[i, j] & (odds[i, j] > 0)
            runs = (enters <= known) & (np.cumsum(solid) - solid == 0)
            for state, at in ((ran, runs & self.inside[i, j]), (ended, ~runs & self.inside[i, j])):
                state[i[at], j[at]] = True
        for i, j in np.argwhere(ran):
            up, right = i + 0.5 - here[0], j + 0.5 - here[1]
            if math.hypot(up, right) > reach + 1e-6 or not sector.contains(right, up):
                continue
            if right * math.cos(sector.yaw) + up * math.sin(sector.yaw) >= sector.blind / cell - 1e-6:
                said[i, j] |= EXPLORED
                if not returned[i, j] and not ended[i, j]:
                    odds[i, j] = max(odds[i, j] - 12, LOWEST)
            if sector.level and odds[i, j] <= 0:
                said[i, j] |= CROSSED

    def check(self, occupancy: OccupancyMap) -> None:
        """Byte for byte, everywhere."""
        store = occupancy._store
        for name, bits in (("log_odds", -1), ("flags", 0xFF), ("votes", 0xFF)):
            mask = store.layers[name][0].type(bits)
            found = store.read(name, self.low, self.flags.shape) & mask
            np.testing.assert_array_equal(found, getattr(self, name), err_msg=name)
            everything = np.count_nonzero(store.pools[name] & mask)
            assert everything == np.count_nonzero(found), "elsewhere"
        low, shape = tuple(a // self.post for a in self.low), self.ground_sum.shape
        np.testing.assert_array_equal(store.read("ground_count", low, shape), self.ground_count)
        np.testing.assert_allclose(store.read("ground_sum", low, shape), self.ground_sum, rtol=1e-5)
        ground = self.heights(self.posts())
        over = occupancy.over(self.window(occupancy))
        i, j = over.low[0] - self.low[0], over.low[1] - self.low[1]
        np.testing.assert_allclose(
            over.ground, ground[i : i + over.shape[0], j : j + over.shape[1]], rtol=0, atol=1e-4
        )

    def window(self, occupancy: OccupancyMap) -> Bounds:
        """All but the margin."""
        low, side = [a + 60 for a in self.low], len(self.flags) - 120
        return occupancy._window((low[0], low[1]), (side, side))


LOWEST = -6
"""Twentieths."""


def random_frame(
    rng: np.random.Generator, protocol: SurveyProtocol, camera: Camera, at: tuple[float, float], kind: str
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], SE3]:
    x, y = at + rng.uniform(-0.5, 0.5, 2) * protocol.reach
    roll, pitch = rng.uniform(-0.5, 0.5), rng.uniform(0.15, 0.7)
    c, s = math.cos(roll), math.sin(roll)
    rolled = SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
    z = SEABED_Z + protocol.altitude * rng.uniform(0.7, 1.3)
    pose = SE3.level(x, y, z, rng.uniform(-math.pi, math.pi)) @ camera_mount(pitch) @ rolled
    shape = (camera.height, camera.width)
    if kind == "random":
        coarse = rng.uniform(0.0, 2.0 * protocol.reach, (4, 4))
        depth = np.kron(coarse, np.ones((-(-shape[0] // 4), -(-shape[1] // 4))))[: shape[0], : shape[1]]
        labels = rng.integers(0, 4, shape).astype(np.uint8)
    else:
        places = rng.uniform(-1.0, 1.0, (3, 2)) * protocol.reach + at
        sizes = rng.uniform(0.05, 0.4, 3) * protocol.reach
        tall = rng.uniform(0.5, 1.5, 3) * protocol.band[1]
        things = [
            Pillar(float(place[0]), float(place[1]), float(size), float(high))
            for place, size, high in zip(places, sizes, tall, strict=True)
        ]
        disc_x, disc_y = (float(a + rng.uniform(-1.0, 1.0) * protocol.reach) for a in at)
        disc = Disc(disc_x, disc_y, float(sizes[0]))
        depth, labels = render(pose, *things, disc, camera=camera)
    depth = depth + rng.normal(size=shape) * 0.003 * depth**2
    if rng.random() < 0.5:
        depth[rng.random(shape) < rng.choice([0.01, 0.5])] = rng.choice([0.0, np.nan, np.inf, -1.0, 1e-30])
    wrong = rng.random(shape) < 0.02
    labels[wrong] = rng.integers(0, 4, int(wrong.sum()))
    return depth.astype(f32), labels, pose


def millimetres(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    return np.where(np.isfinite(depth), np.clip(depth * 1000, 0, 65535), 0).astype(np.uint16)


def probabilities(rng: np.random.Generator, labels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    target = labels == Label.TARGET
    soft: npt.NDArray[np.float32] = np.where(
        target, 1 - rng.random(target.shape) ** 2, rng.random(target.shape) ** 3
    ).astype(f32)
    return soft


CAMERAS = {
    "wide": Camera.from_fov(40, 30, math.radians(80.0)),
    "off centre": Camera(41, 27, 30.0, 24.0, 17.5, 15.0),
    "narrow": Camera.from_fov(96, 40, math.radians(60.0)),
}
PROTOCOLS = {"shallow": SHALLOW, "coarse": COARSE}


@settings(max_examples=20, phases=[Phase.explicit, Phase.generate])  # A seed does not shrink.
@given(
    seed=st.integers(0, 2**31),
    kind=st.sampled_from(["random", "scene", "scene"]),
    lens=st.sampled_from(list(CAMERAS)),
    scale=st.sampled_from(list(PROTOCOLS)),
    whole=st.booleans(),
    told=st.sampled_from(["labels", "labels, unsure", "probabilities"]),
    bounded=st.booleans(),
    far=st.sampled_from([(0.0, 0.0), (-3.3, 7.1), (FAR, -FAR)]),
)
# What is cleared in a frame does not depend on which cell comes first.
@example(2055518068, "scene", "narrow", "coarse", True, "labels", False, (-3.3, 7.1))
@example(911820706, "scene", "off centre", "coarse", False, "probabilities", True, (FAR, -FAR))
@example(17, "scene", "wide", "coarse", False, "labels, unsure", False, (0.0, 0.0))
def test_frame_after_frame_the_map_is_that_of_the_plain_rule(
    seed: int,
    kind: str,
    lens: str,
    scale: str,
    whole: bool,
    told: str,
    bounded: bool,
    far: tuple[float, float],
) -> None:
    rng = np.random.default_rng(seed)
    protocol, camera, bounds = PROTOCOLS[scale], CAMERAS[lens], None
    if bounded:
        half = 10 * protocol.cell
        bounds = Bounds(far[0] - half, far[1] - 2 * half, far[0] + 3 * half, far[1] + half)
    occupancy, plain = OccupancyMap(bounds, protocol), PlainMap(bounds, protocol, *far)
    for _ in range(int(rng.integers(1, 6))):
        depth, labels, pose = random_frame(rng, protocol, camera, far, kind)
        soft, unsure = told == "probabilities", told == "labels, unsure"
        frame = (millimetres(depth) if whole else depth, probabilities(rng, labels) if soft else labels)
        confidence = rng.random(depth.shape).astype(f32) ** rng.uniform(0.0, 3.0) if unsure else None
        occupancy.integrate(*frame, camera, pose, confidence)
        plain.integrate(*frame, camera, pose, confidence)
    plain.check(occupancy)


@pytest.mark.few(3)
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (30, 1), (2, 3), (5, 1030)])
@given(seed=st.integers(0, 2**31), soft=st.booleans())
@settings(max_examples=5, phases=[Phase.generate])
def test_images_of_any_shape_are_read_to_their_borders(shape: tuple[int, int], seed: int, soft: bool) -> None:
    rng = np.random.default_rng(seed)
    height, width = shape
    camera = Camera(width, height, 0.6 * width + 1.0, 0.7 * height + 1.0, 0.5 * width, 0.4 * height)
    occupancy, plain = OccupancyMap(None, COARSE), PlainMap(None, COARSE, 0.0, 0.0)
    for _ in range(2):
        depth, labels, pose = random_frame(rng, COARSE, camera, (0.0, 0.0), "random")
        images = depth, probabilities(rng, labels) if soft else labels
        occupancy.integrate(*images, camera, pose)
        plain.integrate(*images, camera, pose)
    plain.check(occupancy)


@pytest.mark.parametrize("pixel", [None, (0, 0), (29, 38), (29, 39), (0, 24), (14, 20), (4, 8)])
@pytest.mark.parametrize("z", [0.1, 0.11, 0.9, 2.0, 19.9, 20.1])
def test_a_single_valid_pixel_or_none_says_what_the_plain_rule_says(
    pixel: tuple[int, int] | None, z: float
) -> None:
    camera, protocol = CAMERAS["wide"], COARSE
    pose = SE3.level(0.05, -0.1, SEABED_Z + protocol.altitude, 0.4) @ camera_mount(0.5)
    for fill in (np.nan, 0.0):
        depth = np.full((30, 40), fill, f32)
        if pixel is not None:
            depth[pixel] = z
        labels = np.full((30, 40), Label.TARGET, np.uint8)
        occupancy, plain = OccupancyMap(None, protocol), PlainMap(None, protocol, 0.0, 0.0)
        occupancy.integrate(depth, labels, camera, pose)
        plain.integrate(depth, labels, camera, pose)
        plain.check(occupancy)
        if pixel is None:
            assert occupancy._store.slot_of == {}


def test_a_camera_that_looks_up_or_straight_down_explores_nothing() -> None:
    camera = CAMERAS["wide"]
    depth, labels = np.full((30, 40), 2.0, f32), np.full((30, 40), Label.OBSTACLE, np.uint8)
    for pitch in (-1.2, -0.8, 0.5 * math.pi, 1.5):
        pose = SE3.level(0.05, -0.1, SEABED_Z + COARSE.altitude, 0.4) @ camera_mount(pitch)
        occupancy, plain = OccupancyMap(None, COARSE), PlainMap(None, COARSE, 0.0, 0.0)
        occupancy.integrate(depth, labels, camera, pose)
        plain.integrate(depth, labels, camera, pose)
        plain.check(occupancy)
        assert not occupancy.explored.any()
        assert occupancy.known.any()


def test_in_the_pool_the_map_is_that_of_the_plain_rule() -> None:
    rng = np.random.default_rng(5)
    bounds = Bounds(-1.85, -1.85, 1.85, 1.85)
    occupancy, plain = OccupancyMap(bounds, POOL_V1), PlainMap(bounds, POOL_V1, 0.0, 0.0)
    for _ in range(3):
        depth, labels, pose = random_frame(rng, POOL_V1, CAMERAS["narrow"], (0.0, 0.0), "scene")
        occupancy.integrate(depth, labels, CAMERAS["narrow"], pose)
        plain.integrate(depth, labels, CAMERAS["narrow"], pose)
    plain.check(occupancy)


# ------------------------------------------------------------------------------------------ its parts


@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.0, 0.02, 0.5, 1.0]))
@settings(max_examples=15, phases=[Phase.generate])
def test_the_seabed_over_any_window_is_that_of_the_plain_pyramid(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    occupancy, plain = OccupancyMap(None, COARSE), PlainMap(None, COARSE, 0.0, 0.0)
    side = len(plain.ground_sum) // 2
    count = (rng.random((side, side)) < share) * rng.integers(1, 60, (side, side))
    total = (count * rng.uniform(-12.0, -8.0, (side, side))).astype(f32)
    low = tuple(a // plain.post + side // 2 for a in plain.low)
    occupancy._write("ground_count", (low[0], low[1]), count)
    occupancy._write("ground_sum", (low[0], low[1]), total)
    occupancy._datum = plain.datum = -9.0
    inner = np.s_[side // 2 : side // 2 + side, side // 2 : side // 2 + side]
    plain.ground_sum[inner], plain.ground_count[inner] = total, count
    expected = plain.heights(plain.posts())
    for _ in range(3):
        size = rng.integers(1, 90, 2)
        at = rng.integers(60, len(expected) - 160, 2)
        window = occupancy._window(
            (int(plain.low[0] + at[0]), int(plain.low[1] + at[1])), (int(size[0]), int(size[1]))
        )
        found = occupancy.over(window).ground
        np.testing.assert_allclose(
            found, expected[at[0] : at[0] + size[0], at[1] : at[1] + size[1]], rtol=0, atol=1e-4
        )


@given(ballots=st.lists(st.booleans(), max_size=80), start=st.integers(0, 255))
@settings(max_examples=15, phases=[Phase.generate])
def test_votes_are_counted_and_both_halved_when_one_is_full(ballots: list[bool], start: int) -> None:
    occupancy = OccupancyMap(None, COARSE)
    camera = Camera.from_fov(4, 4, 0.1)
    down = SE3.level(0.1, 0.1, SEABED_Z + 1.3, 0.0) @ camera_mount(0.5 * math.pi)
    occupancy._write("votes", (0, 0), np.array([[start]]))
    yes, no = divmod(start, 16)
    for ballot in ballots:
        labels = np.full((4, 4), Label.TARGET if ballot else Label.SEABED, np.uint8)
        occupancy.integrate(np.full((4, 4), 1.3, f32), labels, camera, down)
        if (yes if ballot else no) == 15:
            yes, no = yes // 2, no // 2
        yes, no = yes + ballot, no + (not ballot)
    assert int(occupancy._store.read("votes", (0, 0), (1, 1))[0, 0]) == 16 * yes + no
    e = occupancy.evidence
    for_it = e.target_prior * e.detection**yes * (1 - e.detection) ** no
    against = (1 - e.target_prior) * e.false_alarm**yes * (1 - e.false_alarm) ** no
    probability = float(probability_of_votes(e)[16 * yes + no])
    assert probability == pytest.approx(for_it / (for_it + against), rel=1e-5)
    row, col = occupancy.cell_of(0.1, 0.1)
    assert float(occupancy.target_probability[row, col]) == probability


@given(
    seed=st.integers(0, 2**31),
    yaw=st.one_of(st.floats(-math.pi, math.pi), st.sampled_from([k * 0.5 * math.pi for k in range(-2, 3)])),
)
def test_a_level_camera_overlooks_the_box_around_its_sector_and_a_margin(seed: int, yaw: float) -> None:
    row, col = np.random.default_rng(seed).uniform(-50.0, 50.0, 2)
    reach, pose = 32.0, SE3.level(0.0, 0.0, SEABED_Z + 2.0, yaw) @ camera_mount(0.0)
    for camera in CAMERAS.values():
        found = _overlook(camera, pose.rotation.tolist(), reach, row, col)
        left, right = math.atan(camera.cx / camera.fx), math.atan((camera.width - camera.cx) / camera.fx)
        turns = yaw + np.linspace(-right, left, 1001)
        rows, cols = np.append(row, row + reach * np.sin(turns)), np.append(col, col + reach * np.cos(turns))
        box = (rows.min() - MARGIN, cols.min() - MARGIN, rows.max() + 1 + MARGIN, cols.max() + 1 + MARGIN)
        # Between the bearings that are tried it reaches less than a hundredth of a cell farther.
        np.testing.assert_allclose(np.array(found) - np.floor(box), 0.0, atol=1.0)
        assert (np.array(found[:2]) <= box[:2]).all()
        assert (np.array(found[2:]) >= np.array(box[2:]) - 1.0).all()
