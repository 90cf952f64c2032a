"""The map in three dimensions: planes, boxes, plates and spheres that are known on paper, and slow twins."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

from dream.geometry import SE3, Bounds, Camera, camera_mount
from dream.mapping._kernels import volume_frame as frame_kernels
from dream.mapping._kernels import volume_surface as surface_kernels
from dream.mapping._kernels.volume import SIDE
from dream.mapping._kernels.volume_frame import CAST, MOST_VOTES, UNSURE
from dream.mapping.volume import (
    BELIEVED,
    FREE,
    HELD,
    HIT,
    KEPT,
    LEAST,
    MARGIN,
    MISS,
    MOST,
    SOLID,
    UNKNOWN,
    Volume,
)
from dream.protocol import DREAM_V2, DREAM_V2_TRUE, LastingErrors, SensorNoise
from dream.types import Label

PROTOCOL = DREAM_V2_TRUE
INCIDENCE = math.radians(70.0)
CAMERA = Camera.from_fov(160, 120, math.radians(90.0))
Array = npt.NDArray[Any]
Distance = Callable[[Array], Array]
"""Signed distance of points (n, 3) from the surface of what is solid, metres; negative inside."""


def pose(x: float, y: float, z: float, yaw: float = 0.0, tilt: float = 0.0) -> SE3:
    """`T_world_camera` of a level vehicle that looks down by `tilt`."""
    return SE3.level(x, y, z, yaw) @ camera_mount(tilt)


def plane(point: tuple[float, float, float], normal: tuple[float, float, float]) -> Distance:
    n = np.array(normal) / np.linalg.norm(normal)
    return lambda p: np.asarray((p - np.array(point)) @ n)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Distance:
    middle, half = 0.5 * (np.array(low) + np.array(high)), 0.5 * (np.array(high) - np.array(low))

    def distance(p: Array) -> Array:
        q = np.abs(p - middle) - half
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0))

    return distance


def ball(centre: tuple[float, float, float], radius: float) -> Distance:
    return lambda p: np.asarray(np.linalg.norm(p - np.array(centre), axis=-1) - radius)


def render(things: list[Distance], T: SE3, camera: Camera = CAMERA, far: float = 20.0) -> tuple[Array, Array]:
    """Depth and labels, by sphere tracing; the first thing is seabed, the others are target."""
    rays = camera.back_project(np.ones((camera.height, camera.width)), T) - T.translation
    length = np.linalg.norm(rays, axis=-1)
    rays = (rays / length[..., None]).reshape(-1, 3)
    away = np.zeros(len(rays))
    for _ in range(200):
        step = np.min([d(T.translation + away[:, None] * rays) for d in things], axis=0)
        away = np.minimum(away + step, 10.0 * far)
        if not ((step > 1e-5) & (away < 2.0 * far)).any():
            break
    nearest = np.argmin([d(T.translation + away[:, None] * rays) for d in things], axis=0)
    depth = (away / length.ravel()).reshape(length.shape)
    labels = np.where(nearest == 0, Label.SEABED, Label.TARGET).reshape(length.shape).astype(np.uint8)
    none = depth > far
    depth[none], labels[none] = np.nan, Label.WATER
    return depth.astype(np.float32), labels


def looked(
    things: list[Distance], *poses: SE3, protocol: Any = PROTOCOL, cell: float | None = None
) -> Volume:
    volume = Volume(protocol, cell)
    for T in poses:
        volume.integrate(*render(things, T), CAMERA, T)
    return volume


def grid(low: tuple[float, float, float], high: tuple[float, float, float], cell: float) -> Array:
    """(n, 3) middles of the voxels of a box."""
    first = [math.floor(a / cell + 1e-9) for a in low]
    last = [math.ceil(b / cell - 1e-9) for b in high]
    axes = [(np.arange(a, b) + 0.5) * cell for a, b in zip(first, last, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


FLOOR = plane((0.0, 0.0, -10.07), (0.0, 0.0, 1.0))


# ------------------------------------------------------------------------------------------ slow twins


class Twin:
    """The same by plain NumPy over a box of voxels, every sample of every one of them looked up."""

    def __init__(self, protocol: Any, cell: float, low: tuple[int, int, int], size: tuple[int, int, int]):
        self.protocol, self.cell = protocol, cell
        self.low, self.size = np.array(low), size
        self.odds = np.zeros(size, np.int64)
        self.votes = np.zeros((*size, 2), np.int64)
        self.seen = np.zeros(size, np.bool_)
        self.sides = np.zeros(size, np.uint32)
        self.sees = 0.0

    @property
    def middles(self) -> Array:
        axes = [(np.arange(n) + a + 0.5) * self.cell for a, n in zip(self.low, self.size, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def integrate(
        self,
        depth: Array,
        labels: Array,
        camera: Camera,
        T: SE3,
        sure: Array | None,
        error: Array | None,
    ) -> None:
        protocol, cell = self.protocol, self.cell
        scatter = protocol.noise.depth if protocol.noise else 0.0
        bias = protocol.lasting.depth if protocol.lasting else 0.0
        weight = np.full(depth.shape, 16) if sure is None else np.rint(16 * sure).astype(int)
        z = depth.astype(np.float64)
        valid = (z >= protocol.returns[0]) & (z <= protocol.returns[1])
        through = ~(z < protocol.returns[0]) & (labels == Label.WATER)
        off = bias if error is None else 1.0 - np.exp(-3.0 * error)
        clear = np.where(valid, z - scatter * z**2 - off * z, np.where(through, np.inf, 0.0))
        trusted = (2 * weight >= 16) | (valid & (error is not None))
        clear = np.where(trusted, np.maximum(clear, 0.0), 0.0).astype(np.float32)
        trusted &= valid
        facing = self._facing(np.where(trusted, 1.0 / z, np.nan), camera)
        sees = self._farthest(clear, camera)
        self.sees = max(self.sees, sees)
        # What returned, voxel by voxel.
        farthest = min(KEPT * protocol.reach, protocol.max_depth)
        points = camera.back_project(z, T)
        away = np.linalg.norm(points - T.translation, axis=-1)
        hits = np.zeros((*self.size, 4), np.int64)
        used = valid & (away <= farthest) & (weight > 0)
        near = away <= protocol.reach
        index = np.floor(points[used] / cell).astype(int) - self.low
        assert (index >= 0).all()
        assert (index < self.size).all()
        for column, values in enumerate(
            (
                weight,
                weight * (labels == Label.TARGET),
                near.astype(int),
                (near & facing).astype(int),
            )
        ):
            np.add.at(hits, (*index.T, np.full(len(index), column)), values[used])
        middles = self.middles
        to_middle = middles - T.translation
        ahead = to_middle @ T.rotation[:, 2]
        covered = camera.fx * camera.fy * (cell / np.maximum(ahead, cell)) ** 2
        noisy = 1.0 if scatter > 0.0 else 0.0
        held = hits[..., 0] > noisy * HELD * covered * 16
        believed = hits[..., 0] > noisy * BELIEVED * covered * 16
        # What a ray passed.
        limit = min(farthest, self.sees if error is None else sees)
        unsure = trusted & (False if error is None else error > UNSURE)
        passed = self._passed(clear, unsure, camera, T, limit) & ~held
        self.odds[passed] = np.maximum(self.odds[passed] - MISS, LEAST)
        step = np.maximum((HIT * cell / np.maximum(2.0 * scatter * ahead**2, cell)).astype(int), 1)
        self.odds = np.where(believed, np.minimum(self.odds + step, MOST), self.odds)
        full = believed & (self.votes[..., 1] > MOST_VOTES - CAST)
        self.votes[full] >>= 1
        part = hits[..., 1] / np.maximum(hits[..., 0], 1)
        square = (to_middle**2).sum(axis=-1)
        cast = np.maximum(np.floor(CAST * (4.0 / np.maximum(square, 4.0)) ** 2 + 0.5).astype(int), 1)
        self.votes[..., 0] += np.where(believed, np.floor(cast * part + 0.5).astype(int), 0)
        self.votes[..., 1] += np.where(believed, cast, 0)
        self.seen |= believed & (hits[..., 2] > 0) & (square <= protocol.trusted**2)
        bearing = np.arctan2(-to_middle[..., 1], -to_middle[..., 0]) / (2.0 * math.pi)
        band = np.floor(2.0 - 2.0 * to_middle[..., 2] / np.linalg.norm(to_middle, axis=-1))
        side = np.minimum(band, 3) * 8 + np.floor((bearing + 1.0) * 8) % 8
        bits = np.uint32(1) << side.astype(np.uint32)
        self.sides |= np.where(believed & (hits[..., 3] > 0), bits, np.uint32(0))

    def _facing(self, inverse: Array, camera: Camera) -> Array:
        """By least squares in every tile: 1 / depth = a x + b y + c on a plane with normal (a, b, c)."""
        facing = np.zeros(inverse.shape, np.bool_)
        limit = INCIDENCE
        for i in range(0, camera.height - 3, 4):
            for j in range(0, camera.width - 3, 4):
                w = inverse[i : i + 4, j : j + 4].ravel()
                if np.isnan(w).any():
                    continue
                v, u = np.mgrid[i : i + 4, j : j + 4] + 0.5
                x, y = (u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy
                normal = np.linalg.lstsq(np.stack([x, y, np.ones(16)], axis=1), w, rcond=None)[0]
                ray = np.array([x.mean(), y.mean(), 1.0])
                angle = math.acos(min(1.0, normal @ ray / np.linalg.norm(normal) / np.linalg.norm(ray)))
                facing[i : i + 4, j : j + 4] = angle <= limit
        return facing

    def _farthest(self, clear: Array, camera: Camera) -> float:
        farthest = 0.0
        for i in range(0, camera.height - 3, 4):
            for j in range(0, camera.width - 3, 4):
                tile = clear[i : i + 4, j : j + 4]
                if tile.max() < np.inf:
                    x, y = (j + 2 - camera.cx) / camera.fx, (i + 2 - camera.cy) / camera.fy
                    farthest = max(farthest, float(tile.min()) * math.hypot(x, y, 1.0))
        return farthest

    def _passed(self, clear: Array, unsure: Array, camera: Camera, T: SE3, limit: float) -> Array:
        middles = (self.middles - T.translation) @ T.rotation
        size = np.array([camera.width, camera.height])
        half_pixel = 0.5 * middles[..., 2] / min(camera.fx, camera.fy)
        inner = np.maximum(0.5 - half_pixel / self.cell, frame_kernels.INNER)
        padded = np.pad(clear, 1)  # Outside the image nothing is clear.
        any_point, every_corner = np.zeros(self.size, np.bool_), np.ones(self.size, np.bool_)
        may_be_there, covered = np.zeros(self.size, np.bool_), np.pad(unsure, 1)
        for signs in [(0, 0, 0), *itertools.product((-1, 1), repeat=3)]:
            around_corner = tuple(itertools.product((-0.5, 0.5), repeat=2))
            for off, around in ((inner, ((0.0, 0.0),)), (np.full_like(inner, 0.5), around_corner)):
                points = middles + self.cell * off[..., None] * (np.array(signs) @ T.rotation)
                pixel, ahead = camera.project(points)
                near = np.linalg.norm(points, axis=-1) <= limit
                for shift in around:
                    at = np.floor(np.nan_to_num(pixel + shift, nan=-1.0)).astype(int)
                    u, v = np.moveaxis(np.clip(at, -1, size), -1, 0)
                    passes = near & (ahead > 0.0) & (padded[v + 1, u + 1] >= ahead)
                    if off is not inner:
                        every_corner &= passes
                    else:
                        any_point |= passes
                        may_be_there |= (
                            near & (ahead > 0.0) & ~passes & covered[v + 1, u + 1].astype(np.bool_)
                        )
        return np.where(self.odds > 0, every_corner, any_point & ~may_be_there)


@pytest.mark.few(3)
@pytest.mark.parametrize("seed", range(4))
def test_a_volume_is_what_a_plain_twin_makes_of_the_same_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = Camera(42, 31, 20.0, 22.0, 20.5, 16.0)
    protocol = replace(
        DREAM_V2,
        reach=1.8,
        noise=SensorNoise(0.01, 0.0, 0.0, (0.1, 0.2)) if seed % 2 else None,
        lasting=LastingErrors(depth=0.02) if seed > 1 else None,
    )
    cell = 0.19
    things = [FLOOR, ball((1.5, 0.2, -9.6), 0.5), box((1.0, -1.3, -11.0), (1.3, -0.4, -8.6))]
    volume, twin = Volume(protocol, cell), Twin(protocol, cell, (-19, -19, -65), (38, 38, 38))
    for k in range(5):
        x, y, z = rng.uniform((-0.6, -0.6, -9.2), (0.4, 0.6, -8.8))
        T = pose(x, y, z, yaw=rng.uniform(-0.8, 0.8), tilt=rng.uniform(-0.3, 0.9))
        depth, labels = render(things, T, camera, far=5.0)
        depth += protocol.noise.depth * depth**2 * rng.standard_normal(depth.shape) if protocol.noise else 0.0
        sure = rng.uniform(size=depth.shape) if k >= 3 else None
        error = np.where(np.isnan(depth), np.nan, rng.uniform(0.0, 0.2, depth.shape)) if k == 4 else None
        volume.integrate(depth, labels, camera, T, sure, error)
        twin.integrate(depth, labels, camera, T, sure, error)
    points = twin.middles.reshape(-1, 3)
    slots, numbers = volume._look_up(points)
    held = volume._bricks
    kept = held.surface_of[slots]
    assert np.count_nonzero(twin.odds > 0) > 200
    assert np.count_nonzero(twin.odds < 0) > 1000
    assert np.count_nonzero(twin.sides) > 50
    np.testing.assert_array_equal(held.log_odds[slots, numbers], twin.odds.ravel())
    np.testing.assert_array_equal(held.votes[kept, numbers], twin.votes.reshape(-1, 2))
    np.testing.assert_array_equal(held.seen[kept, numbers], twin.seen.ravel())
    np.testing.assert_array_equal(held.sides[kept, numbers], twin.sides.ravel())
    # Nothing is known outside the twin's box.
    assert np.count_nonzero(held.log_odds) == np.count_nonzero(twin.odds)


def slow_room(volume: Volume, start: Array, end: Array) -> tuple[int, float]:
    """The worst state that the body touches, and how far it comes, by 4,000 samples of the way."""
    cell, protocol = volume.cell, volume.protocol
    radius, half = protocol.body_radius + MARGIN, 0.5 * protocol.body_height + MARGIN
    reach = np.array([radius, radius, half]) + cell
    low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
    middles = grid(tuple(low), tuple(high), cell)
    states = volume.state(middles)
    worst, share = int(FREE), 1.0
    way = np.linspace(0.0, 1.0, 4001)
    at = start + way[:, None] * (end - start)
    for middle, state in zip(middles[states != FREE], states[states != FREE], strict=True):
        off = np.abs(at - middle) - 0.5 * cell
        touched = (np.hypot(*np.maximum(off[:, :2], 0.0).T) <= radius) & (off[:, 2] <= half)
        if not touched.any():
            continue
        away = middle - start
        if touched[0] and (end - start)[:2] @ away[:2] <= 0.0 and (end - start)[2] * away[2] <= 0.0:
            continue
        share = min(share, float(way[touched.argmax()]))
        worst = int(state) if int(state) == SOLID or worst == FREE else worst
    return worst, share


def test_one_look_from_near_by_outweighs_many_from_afar() -> None:
    def integrate(volume: Volume, away: float, label: Label) -> None:
        depth, labels = render([plane((away, 0.0, 0.0), (-1.0, 0.0, 0.0))], pose(0.0, 0.0, -5.0))
        T = pose(6.1 - away, 0.0, -5.0)
        labels[labels != Label.WATER] = label
        volume.integrate(depth, labels, CAMERA, T)

    volume, on_axis = Volume(PROTOCOL), np.array([[6.1, 0.1, -4.9]])
    for _ in range(50):
        integrate(volume, 8.0, Label.TARGET)
    assert volume.target(on_axis)[0] == 1.0
    integrate(volume, 2.0, Label.SEABED)
    assert volume.target(on_axis)[0] < 0.5
    # Nor do as many from afar put it wrong again.
    for _ in range(20):
        integrate(volume, 8.0, Label.TARGET)
    assert volume.target(on_axis)[0] < 0.5


def test_room_is_what_a_sampled_way_finds() -> None:
    rng = np.random.default_rng(3)
    volume = Volume(PROTOCOL)
    volume.clear((0.0, 0.0, -5.0), 2.4)
    inside = grid((-3.0, -3.0, -8.0), (3.0, 3.0, -2.0), volume.cell)
    slots, numbers = volume._look_up(inside)
    free = volume._bricks.log_odds[slots, numbers] < 0
    solid = np.flatnonzero(free)[rng.choice(np.count_nonzero(free), 30, replace=False)]
    volume._bricks.log_odds[slots[solid], numbers[solid]] = HIT
    starts = rng.uniform((-1.2, -1.2, -6.0), (1.2, 1.2, -4.0), (150, 3))
    ends = starts + rng.uniform(-1.5, 1.5, (150, 3)) * rng.integers(0, 2, (150, 3))
    room = volume.room(starts, ends)
    assert set(room.reason) == {UNKNOWN, FREE, SOLID}
    for m in range(150):
        worst, share = slow_room(volume, starts[m], ends[m])
        assert (room.reason[m], room.clear[m]) == (worst, worst == FREE)
        assert room.share[m] == pytest.approx(share, abs=5e-4)
        if worst == FREE:
            assert np.isnan(room.where[m]).all()
        else:
            assert volume.state(room.where[m : m + 1])[0] != FREE


# ------------------------------------------------------------------------------------ known on paper


def test_over_a_plane_water_is_free_the_seabed_solid_and_below_it_unknown() -> None:
    volume = looked([FLOOR], pose(0.0, 0.0, -8.0, tilt=math.radians(45.0)))
    column = np.array([[2.0, 0.1, z] for z in (-8.4, -8.7, -9.1, -9.6, -10.1, -10.4, -11.0)])
    assert volume.state(column).tolist() == [FREE] * 4 + [SOLID] + [UNKNOWN] * 2
    assert volume.probability(column)[0] < 0.5 < volume.probability(column)[4]
    assert volume.probability(column)[6] == 0.5
    surface = volume.surface()
    near = np.linalg.norm(surface.middles - (2.0, 0.0, -10.0), axis=1) < 1.0
    np.testing.assert_allclose(surface.normals[near], [[0.0, 0.0, 1.0]] * near.sum(), atol=0.2)
    np.testing.assert_allclose(surface.area[near], 0.25**2, rtol=0.05)
    assert near.sum() == pytest.approx(math.pi / 0.25**2, rel=0.1)
    assert surface.seen[near].all()
    assert surface.sides[near].all()
    assert (surface.target == 0.0).all()


@pytest.mark.parametrize("pitch", [0.0, 0.3, 0.7])
def test_the_area_of_an_inclined_plane_is_its_own(pitch: float) -> None:
    wall = plane((4.0, 0.0, -5.0), (-math.cos(pitch), 0.2, math.sin(pitch)))
    volume = looked([wall], pose(0.0, 0.0, -5.0), cell=0.1)
    surface = volume.surface()
    close = np.linalg.norm(surface.middles - (4.0, 0.0, -5.0), axis=1) < 1.5
    assert surface.area[close].sum() == pytest.approx(math.pi * 1.5**2, rel=0.08)


def test_what_is_seen_at_a_grazing_angle_or_from_afar_is_not_inspected() -> None:
    protocol = replace(PROTOCOL, reach=6.0)
    volume = looked([FLOOR], pose(0.0, 0.0, -9.0), protocol=protocol)
    surface = volume.surface()
    over_ground = np.hypot(surface.middles[:, 0], surface.middles[:, 1])
    # 70° off straight down, a metre above the ground, is 2.9 m away.
    inspected = surface.sides != 0
    assert inspected[(over_ground > 2.0) & (over_ground < 2.5)].mean() > 0.9
    assert not inspected[over_ground > 3.4].any()
    assert surface.seen[over_ground < 5.5].all()
    assert not surface.seen[over_ground > 6.3].any()
    assert np.count_nonzero(over_ground > 6.3) > 100


@pytest.mark.rare
def test_a_ball_is_inspected_side_by_side() -> None:
    things = [FLOOR, ball((0.0, 0.0, -7.0), 0.9)]
    views = [
        pose(3.0 * math.cos(a), 3.0 * math.sin(a), -7.0, a + math.pi)
        for a in np.arange(4) * math.pi / 2 + 0.4
    ]
    volume = looked(things, *views, cell=0.1)
    surface = volume.surface()
    on_ball = np.linalg.norm(surface.middles - (0.0, 0.0, -7.0), axis=1) < 1.1
    outwards = surface.middles[on_ball] - (0.0, 0.0, -7.0)
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    along = np.sum(outwards * surface.normals[on_ball], axis=1)
    assert along.mean() > 0.9
    assert (along > 0.7).mean() > 0.9
    level = np.abs(outwards[:, 2]) < 0.5
    assert (surface.sides[on_ball][level] != 0).mean() > 0.95
    assert surface.target[on_ball].min() == 1.0
    sides = []
    for view in views[:2]:
        surface = looked(things, view, cell=0.1).surface()
        sides.append(set(surface.sides[surface.middles[:, 2] > -8.0].tolist()) - {0})
        assert len(sides[-1]) >= 2
    assert not sides[0] & sides[1]
    np.testing.assert_allclose(volume.target([[0.87, 0.02, -7.02], [3.0, 0.0, -9.0]]), [1.0, np.nan])


@pytest.mark.rare
def test_a_thin_plate_stays_however_often_rays_graze_it() -> None:
    plate = box((1.0, -1.0, -8.52), (5.0, 1.0, -8.48))
    head_on = pose(3.0, 0.0, -6.5, tilt=math.radians(89.0))
    grazing = [pose(-2.0, 0.3 * k, -8.4 + 0.05 * k) for k in range(6)]
    volume = looked([FLOOR, plate], head_on, *grazing)
    middles = grid((1.5, -0.75, -8.5), (4.5, 0.75, -8.25), volume.cell)
    assert (volume.state(middles - np.array([0.0, 0.0, 0.1])) == SOLID).all()
    # What lies above and below it and was seen is water.
    above = volume.state(middles + np.array([0.0, 0.0, 0.5]))
    assert (above == FREE).all()


def test_nothing_behind_a_box_is_known_nor_anything_that_no_ray_passed() -> None:
    crate = box((3.0, -1.0, -12.0), (4.0, 1.0, -6.0))
    volume = looked([FLOOR, crate], pose(0.0, 0.0, -8.0))
    behind = grid((4.5, -1.0, -10.0), (8.0, 1.0, -8.0), volume.cell)
    assert (volume.state(behind) == UNKNOWN).all()
    beside = volume.state([[3.5, 2.0, -8.0], [0.0, 2.0, -8.0], [-1.0, 0.0, -8.0]])
    assert beside.tolist() == [FREE, UNKNOWN, UNKNOWN]


def test_water_without_a_return_is_free_as_far_as_anything_ever_returned() -> None:
    volume, up = Volume(PROTOCOL), pose(0.0, 0.0, -8.0, tilt=-1.2)
    nothing = np.full((120, 160), np.nan), np.zeros((120, 160), np.uint8)
    volume.integrate(*nothing, CAMERA, up)
    assert volume.state([[1.0, 0.0, -6.0]])[0] == UNKNOWN
    wall = plane((5.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    volume.integrate(*render([wall], pose(0.0, 0.0, -8.0)), CAMERA, pose(0.0, 0.0, -8.0))
    volume.integrate(*nothing, CAMERA, up)
    assert volume.state([[1.0, 0.0, -5.0], [3.0, 0.0, 2.5]]).tolist() == [FREE, UNKNOWN]
    # A pixel that is told to show something, but has no depth, clears nothing.
    told = Volume(PROTOCOL)
    told._sees = 20.0
    told.integrate(nothing[0], np.ones((120, 160), np.uint8), CAMERA, up)
    assert told.box is None


def test_a_ray_clears_as_far_as_its_depth_is_sure_to_reach_whatever_returned() -> None:
    view = pose(0.0, 0.0, -5.0)
    depth, labels = render([plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))], view)
    unsure = np.full(depth.shape, 0.2)
    for mean, clear in ((0.01, 5.7), (0.1, 4.4), (0.4, 1.7), (math.nan, 0.0)):
        volume = Volume(PROTOCOL)
        volume.integrate(depth, labels, CAMERA, view, unsure, np.full(depth.shape, mean))
        assert not clear or volume.state([[clear - 0.4, 0.0, -5.0]])[0] == FREE
        assert volume.state([[clear + 0.4, 0.0, -5.0]])[0] != FREE
    # Of the same pixels without an error none is sure enough.
    doubted = Volume(PROTOCOL)
    doubted.integrate(depth, labels, CAMERA, view, unsure)
    assert doubted.state([[1.0, 0.0, -5.0]])[0] == UNKNOWN


def test_where_depths_err_water_is_free_as_far_as_something_is_seen_in_the_same_frame() -> None:
    volume, view, up = Volume(PROTOCOL), pose(0.0, 0.0, -8.0), pose(0.0, 0.0, -8.0, tilt=-1.2)
    error = np.full((120, 160), 0.01)
    depth, labels = render([plane((5.0, 0.0, 0.0), (-1.0, 0.0, 0.0))], view)
    volume.integrate(depth, labels, CAMERA, view, np.ones(depth.shape), error)
    nothing = np.full((120, 160), np.nan), np.zeros((120, 160), np.uint8)
    volume.integrate(*nothing, CAMERA, up, np.ones((120, 160)), error)
    assert volume.state([[1.0, 0.0, -5.0]])[0] == UNKNOWN
    # A quarter of the picture shows something 2 m away: the rest is free to there, where it is surely water.
    near = np.where(np.arange(160) < 40, np.float32(2.0), np.float32(np.nan)) * np.ones((120, 1), np.float32)
    kinds = np.where(np.isnan(near), Label.WATER, Label.SEABED).astype(np.uint8)
    for sure, state in ((0.3, UNKNOWN), (0.9, FREE)):
        volume.integrate(near, kinds, CAMERA, up, np.full((120, 160), sure), error)
        assert volume.state([[0.4, 0.0, -7.0]])[0] == state
    assert volume.state([[1.0, 0.0, -5.0]])[0] == UNKNOWN


def test_one_return_makes_solid_what_was_free_and_looks_clear_it_again() -> None:
    view = pose(0.0, 0.0, -5.0)
    far, close = [plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))], [plane((3.1, 0.0, 0.0), (-1.0, 0.0, 0.0))]
    volume = looked(far, *[view] * 20)
    assert volume.state([[3.1, 0.0, -5.0]])[0] == FREE
    volume.integrate(*render(close, view), CAMERA, view)
    assert volume.state([[3.1, 0.0, -5.0]])[0] == SOLID
    for _ in range(3):
        volume.integrate(*render(far, view), CAMERA, view)
    assert volume.state([[3.1, 0.0, -5.0]])[0] == FREE


def test_depths_that_scatter_leave_the_water_before_a_wall_free() -> None:
    rng = np.random.default_rng(8)
    wall, volume = [plane((5.03, 0.0, 0.0), (-1.0, 0.0, 0.0))], Volume(replace(DREAM_V2, lasting=None))
    for k in range(10):
        view = pose(0.1 * k, 0.0, -5.0)
        depth, labels = render(wall, view)
        depth += 0.002 * depth**2 * rng.standard_normal(depth.shape).astype(np.float32)
        volume.integrate(depth, labels, CAMERA, view)
    assert (volume.state(grid((2.0, -1.0, -6.0), (4.5, 1.0, -4.0), 0.25)) == FREE).all()
    assert (volume.state(grid((5.0, -1.0, -6.0), (5.25, 1.0, -4.0), 0.25)) == SOLID).all()


# --------------------------------------------------------------------------------------- room, launch


def test_a_ball_is_cleared_for_the_launch_but_nothing_solid() -> None:
    volume = looked([FLOOR], pose(0.0, 0.0, -8.0, tilt=0.7))
    volume.clear((0.0, 0.0, -8.0), 2.5)
    assert volume.state([[0.0, 0.0, -8.0], [-2.3, 0.0, -8.0], [0.0, 0.0, -5.3]]).tolist() == [
        FREE,
        FREE,
        UNKNOWN,
    ]
    assert volume.state([[1.5, 0.0, -10.1]])[0] == SOLID
    assert volume.room([[0.0, 0.0, -8.0]], [[-1.0, 0.5, -7.5]]).clear[0]


def test_what_the_body_swept_is_free_for_the_way_back() -> None:
    volume = Volume(PROTOCOL)
    way = np.array([[0.0, 0.0, -5.0], [1.3, -0.8, -4.5]])
    assert volume.room(way[:1], way[1:]).reason[0] == UNKNOWN
    volume.clear_body(*way)
    assert volume.room(way, way[::-1]).clear.all()
    for off in ([0.0, 0.0, 0.5], [0.6, 0.6, 0.0]):
        assert not volume.room(way[:1] + off, way[1:] + off).clear[0]


def test_what_the_body_touched_stays_solid_whatever_is_seen(tmp_path: Path) -> None:
    volume, here, goal = Volume(PROTOCOL), np.array([0.0, 0.0, -5.0]), np.array([2.0, 1.0, -5.0])
    volume.clear(here, 4.0)
    contact = here + 0.4 * (goal - here)
    volume.feel(here, contact, goal)
    far = np.full((CAMERA.height, CAMERA.width), 9.0)
    for _ in range(10):
        for x in (0.0, 1.5):
            volume.integrate(far, np.full(far.shape, Label.SEABED), CAMERA, pose(x, 0.0, -5.0))
        volume.clear_body(here, goal)
    volume.save(tmp_path / "felt.npz")
    for held in (volume, volume.copy(), Volume.load(tmp_path / "felt.npz")):
        room = held.room([here, here, here, goal], [goal, here - (goal - here), here, here])
        assert room.clear.tolist() == [False, True, True, False]
        assert room.reason[0] == SOLID
        # From twice the margin before the contact to a voxel beyond it.
        early, late = 2.0 * MARGIN / math.sqrt(5.0), held.cell / math.sqrt(5.0)
        assert 0.4 - early <= room.share[0] <= 0.4 + late


def test_whoever_touches_without_being_on_its_way_learns_nothing() -> None:
    volume, here = Volume(PROTOCOL), (0.0, 0.0, -5.0)
    volume.clear(here, 4.0)
    volume.feel(here, here, here)
    assert not len(volume.surface().middles)


def test_where_depths_err_the_edge_of_what_returned_is_not_free_for_what_passes_beside_it() -> None:
    post = box((4.0, -0.3, -8.0), (4.5, 0.3, -4.83))
    T = pose(0.0, 0.0, -5.0)
    depth, labels = render([plane((0.0, 0.0, -7.0), (0.0, 0.0, 1.0)), post], T)
    on_post = (depth > 3.9) & (depth < 4.6) & (labels != Label.WATER)
    # It stands at 4 m, and a depth told twice as far marks nothing there.
    told, error = np.where(on_post, 2.0 * depth, depth), np.where(on_post, 0.4, 0.02)
    volume = Volume(PROTOCOL)
    for _ in range(5):
        volume.integrate(told, labels, CAMERA, T, None, np.where(np.isnan(told), np.nan, error))
    edge = grid((3.9, -0.2, -5.1), (4.4, 0.2, -4.83), 0.5 * volume.cell)
    assert not (volume.state(edge) == FREE).any()
    assert (volume.state(edge + np.array([0.0, 0.0, 3.0 * volume.cell])) == FREE).all()


def test_a_move_is_clear_as_far_as_the_body_fits() -> None:
    wall = plane((5.03, 0.0, 0.0), (-1.0, 0.0, 0.0))
    volume = looked([wall], *(pose(0.0, 0.0, -5.0, tilt=tilt) for tilt in (-0.5, 0.0, 0.5)))
    volume.clear((0.0, 0.0, -5.0), 2.0)
    room = volume.room([[0.0, 0.0, -5.0]] * 3, [[4.0, 0.0, -5.0], [5.0, 0.0, -5.0], [-4.0, 0.0, -5.0]])
    assert room.clear.tolist() == [True, False, False]
    assert room.reason.tolist() == [FREE, SOLID, UNKNOWN]
    # The wall's voxels begin at 5 m: the body's front is there after 5 − 0.35 − 0.05 of 5 m.
    assert room.share[1] == pytest.approx((5.0 - 0.35 - MARGIN) / 5.0)
    assert room.where[1, 0] == 5.125
    # It may leave what it touches, and go no nearer.
    touching = volume.room([[4.7, 0.0, -5.0]] * 2, [[4.0, 0.0, -5.0], [4.8, 0.0, -5.0]])
    assert touching.clear.tolist() == [True, False]


# ------------------------------------------------------------------- surfaces, frontiers, views, files


@pytest.fixture(scope="module")
def corner() -> Volume:
    """A floor, a crate and a ball, seen from three sides."""
    things = [FLOOR, box((2.1, -0.9, -11.0), (3.4, 0.8, -8.6)), ball((1.2, 1.9, -9.3), 0.6)]
    return looked(
        things,
        pose(-1.0, 0.0, -8.0, tilt=0.35),
        pose(2.5, 3.5, -7.5, yaw=-1.6, tilt=0.6),
        pose(0.5, -2.0, -8.4, yaw=0.7, tilt=0.2),
        protocol=replace(PROTOCOL, reach=4.0),
    )


def states_around(volume: Volume) -> tuple[Array, Array]:
    """All states, with an unknown margin, as (levels, rows, cols), and the low corner's level, row, col."""
    assert volume.box is not None
    low, high = volume.box / volume.cell
    first = np.rint(low).astype(int)[::-1] - 2
    size = np.rint(high - low).astype(int)[::-1] + 4
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1) + first
    return volume.state((index[..., ::-1].reshape(-1, 3) + 0.5) * volume.cell).reshape(size), first


@pytest.mark.rare
def test_the_surface_is_all_that_is_solid_and_touches_free_water(corner: Volume) -> None:
    states, first = states_around(corner)
    at_face = ndimage.binary_dilation(states == FREE, ndimage.generate_binary_structure(3, 1))
    expected = (np.argwhere((states == SOLID) & at_face) + first)[:, ::-1] * corner.cell + 0.5 * corner.cell
    surface = corner.surface()
    assert len(expected) > 500
    assert sorted(map(tuple, expected)) == sorted(map(tuple, surface.middles))
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    np.testing.assert_allclose(surface.target, corner.target(surface.middles))


def test_normals_point_away_from_what_is_solid_around_and_towards_what_is_free(corner: Volume) -> None:
    states, first = states_around(corner)
    surface = corner.surface()
    at = np.floor(surface.middles / corner.cell).astype(int)[:, ::-1] - first
    sign = np.where(states == FREE, 1.0, np.where(states == SOLID, -1.0, 0.0))
    total = np.zeros(at.shape)
    for step in itertools.product((-1, 0, 1), repeat=3):
        if any(step):
            total += sign[tuple((at + step).T)][:, None] * np.array(step[::-1]) / np.linalg.norm(step)
    length = np.linalg.norm(total, axis=1)
    plain = length > 1e-6
    assert plain.mean() > 0.9
    np.testing.assert_allclose(surface.normals[plain], (total.T / length).T[plain], atol=1e-12)


def test_the_surface_of_nothing_is_none() -> None:
    assert len(Volume(PROTOCOL).surface().area) == 0


def slow_column(volume: Volume, x: float, y: float, levels: range) -> tuple[int, int, list[int], bool]:
    """Of one column: the lowest solid voxel that is no target, the highest, votes, and whether explored."""
    points = [(x, y, (level + 0.5) * volume.cell) for level in range(levels.start, levels.stop + 1)]
    states, (slots, numbers) = volume.state(points), volume._look_up(points)
    kept = volume._bricks.surface_of[slots]
    votes = volume._bricks.votes[kept, numbers].astype(int)
    seen = volume._bricks.seen[kept, numbers] != 0
    solid = states == SOLID
    below = np.append(False, (solid & seen)[:-1])
    bare = [k for k, level in enumerate(levels) if solid[k] and 2 * votes[k, 0] <= votes[k, 1]]
    up = solid[:-1] & (states[1:] == FREE)
    return (
        levels.start + min(bare, default=-1),
        levels.start + max(np.flatnonzero(solid).tolist(), default=-1),
        votes[solid].sum(axis=0).tolist(),
        bool(up.any() and (seen | below)[:-1][up].all()),
    )


@pytest.mark.parametrize("shift", [0.0, 0.1, 1.37])
def test_columns_are_those_that_are_looked_up_voxel_by_voxel(corner: Volume, shift: float) -> None:
    assert corner.box is not None
    # Past the bricks on all sides.
    x, y = (np.arange(a - 1.0, b + 1.0, corner.cell) + shift for a, b in corner.box[:, :2].T)
    x, y = x[::3], y[::2]
    low, past = (int(k) for k in np.rint(corner.box[:, 2] / (SIDE * corner.cell)))
    lowest, highest, votes, explored = surface_kernels.columns(corner._bricks, x, y, corner.cell, (low, past))
    levels = range(low * SIDE, past * SIDE)
    for i, j in np.ndindex(lowest.shape):
        found = lowest[i, j], highest[i, j], votes[i, j].tolist(), explored[i, j]
        assert found == slow_column(corner, float(x[j]), float(y[i]), levels), (i, j)
    assert explored.any()
    assert (votes[..., 1] > 0)[~explored].any()
    assert (lowest < highest).any()


def test_between_two_heights_something_is_solid_where_a_voxels_middle_is(corner: Volume) -> None:
    assert corner.box is not None
    rng = np.random.default_rng(0)
    x, y = (np.arange(a - 1.0, b + 1.0, 0.7) for a, b in corner.box[:, :2].T)
    low, past = (int(k) for k in np.rint(corner.box[:, 2] / (SIDE * corner.cell)))
    bottom = rng.uniform(-13.0, -7.0, (len(y), len(x)))
    top = bottom + rng.uniform(-0.5, 4.0, bottom.shape)
    bottom[rng.random(bottom.shape) < 0.1] = np.nan
    solid = surface_kernels.solid_between(corner._bricks, x, y, corner.cell, (low, past), bottom, top)
    middles = (np.arange(low * SIDE, past * SIDE) + 0.5) * corner.cell
    for i, j in np.ndindex(bottom.shape):
        between = middles[(middles >= bottom[i, j]) & (middles <= top[i, j])]
        points = np.column_stack(np.broadcast_arrays(x[j], y[i], between)).reshape(-1, 3)
        assert solid[i, j] == (corner.state(points) == SOLID).any()
    assert solid.any()
    assert not solid.all()


def test_from_above_a_mounds_unseen_flank_is_not_explored() -> None:
    mound = ball((3.0, 0.0, -10.2), 1.2)
    volume = looked([FLOOR, mound], pose(0.0, 0.0, -9.2, tilt=0.2))
    above = volume.above(Bounds(1.0, -2.0, 5.0, 2.0))
    assert above.explored.shape == (16, 16)
    row, front, back = 8, 4, 11
    assert above.explored[row, front]
    assert not above.explored[row, back]
    assert above.explored[2, 0]
    # What is no wider than 3 m stands on the ground, half a metre and more above it.
    assert above.solid[row, front]
    assert above.target[row, front] == 1.0
    assert above.ground[row, front] == pytest.approx(-10.125, abs=0.26)
    assert above.top[row, front] > -9.5
    assert not above.solid[2, 0]
    assert above.target[2, 0] == 0.0
    nothing = volume.above(Bounds(100.0, 100.0, 101.0, 101.0))
    assert np.isnan(nothing.ground).all()
    assert not nothing.explored.any()


def test_from_above_heights_that_err_by_a_voxel_hide_no_ground_and_make_none_stand() -> None:
    far, near = pose(-6.5, 0.0, -8.0, tilt=0.25), pose(1.0, 0.0, -8.0, tilt=0.8)
    ahead, clump = Bounds(2.0, -0.5, 3.0, 0.5), box((2.2, -0.3, -11.0), (2.8, 0.3, -9.8))
    for error in (0.0, 0.25, -0.25):
        volume = looked([plane((0.0, 0.0, -10.07 + error), (0.0, 0.0, 1.0))], far)
        assert not volume.above(ahead).explored.any()
        volume.integrate(*render([FLOOR], near), CAMERA, near)
        assert volume.above(ahead).explored.all(), error
        volume.integrate(*render([FLOOR, clump], near), CAMERA, near)
        assert not volume.above(ahead).solid.any(), error


def test_from_above_a_slope_is_ground() -> None:
    slope = plane((0.0, 0.0, -10.0), (-0.4, 0.0, 1.0))
    volume = looked([slope], *(pose(x, 0.0, -6.0 + 0.4 * x, tilt=1.0) for x in (0.0, 1.5, 3.0)))
    above = volume.above(Bounds(2.0, -1.0, 5.0, 1.0))
    x = 2.0 + (np.arange(12) + 0.5) * 0.25
    assert above.explored.all()
    assert not above.solid.any()
    np.testing.assert_allclose(above.ground, np.broadcast_to(-10.0 + 0.4 * x, (8, 12)), atol=0.4)


def test_a_copy_is_its_own(corner: Volume) -> None:
    copy, points = corner.copy(), grid((-1.0, -3.0, -11.0), (5.0, 4.0, -6.0), 0.25)
    before = corner.state(points)
    np.testing.assert_array_equal(copy.state(points), before)
    view = pose(0.0, 0.0, -8.0, yaw=-2.0)
    for _ in range(2):
        copy.integrate(*render([FLOOR], view), CAMERA, view)
    copy.clear((0.0, -3.0, -8.0), 2.0)
    np.testing.assert_array_equal(corner.state(points), before)
    assert (copy.state(points) != before).any()
    assert copy.revision == corner.revision + 3


def test_what_was_saved_is_loaded_and_goes_on_alike(corner: Volume, tmp_path: Path) -> None:
    corner.save(tmp_path / "volume.npz")
    loaded = Volume.load(tmp_path / "volume.npz")
    assert (loaded.protocol, loaded.cell, loaded.revision) == (corner.protocol, 0.25, corner.revision)
    assert loaded.nbytes == pytest.approx(corner.nbytes, rel=0.2)
    view, kept = pose(0.0, 0.0, -8.0, yaw=0.4), corner.copy()
    for volume in (loaded, kept):
        volume.integrate(*render([FLOOR], view), CAMERA, view)
    points = grid((-4.0, -5.0, -11.0), (6.0, 6.0, -5.0), 0.25)
    np.testing.assert_array_equal(loaded.probability(points), kept.probability(points))
    np.testing.assert_array_equal(loaded.target(points), kept.target(points))
    for one, other in zip(by_place(loaded), by_place(kept), strict=True):
        np.testing.assert_array_equal(one, other)
    Volume(PROTOCOL, 0.3).save(tmp_path / "nothing.npz")
    assert Volume.load(tmp_path / "nothing.npz").box is None


def by_place(volume: Volume) -> list[Array]:
    surface = volume.surface()
    order = np.lexsort(surface.middles.T)
    return [getattr(surface, name)[order] for name in ("middles", "normals", "target", "seen", "sides")]


def changed(name: str, change: Callable[[Array], Any]) -> Callable[[dict[str, Array]], None]:
    def apply(content: dict[str, Array]) -> None:
        content[name] = np.asarray(change(content[name].copy()))

    return apply


def put(index: Any, value: Any) -> Callable[[Array], Array]:
    def apply(array: Array) -> Array:
        array[index] = value
        return array

    return apply


def said(name: str, value: Any) -> Callable[[dict[str, Array]], None]:
    return changed("about", lambda text: json.dumps(json.loads(str(text)) | {name: value}))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda content: content.pop("sides"), "expected the arrays"),
        (lambda content: content.update(more=np.zeros(3)), "expected the arrays"),
        (changed("about", lambda text: 7), "about: expected a text"),
        (said("format", "dream-map-2"), "format"),
        (said("cell", 0.0), "cell"),
        (said("cell", 1e-9), "reach: expected at most"),
        (said("cell", float("nan")), "cell"),
        (said("revision", -1), "revision"),
        (said("revision", 1), "stamps: expected 0 to 1"),
        (said("sees", -1.0), "sees"),
        (said("protocol", {}), "protocol"),
        (changed("names", lambda a: a[:, :2]), "names: expected"),
        (changed("names", lambda a: a.astype(np.int64)), "names: expected"),
        (changed("names", put(0, [0, 0, 1 << 21])), "names: expected different bricks"),
        (changed("names", lambda a: put(0, a[1])(a)), "names: expected different bricks"),
        (changed("log_odds", lambda a: a[1:]), "log_odds: expected"),
        (changed("log_odds", put((0, 0), 71)), "log_odds: expected -16 to 70"),
        (changed("log_odds", put((0, 0), -128)), "log_odds: expected -16 to 70"),
        (changed("surfaces", put(0, 0)), "surfaces: expected rising"),
        (changed("surfaces", put(-1, 10**6)), "surfaces: expected rising"),
        (changed("surfaces", lambda a: a[::-1]), "surfaces: expected rising"),
        (changed("votes", put((0, 0), [9, 3])), "votes: expected no more"),
        (changed("seen", put((0, 0), 2)), "seen: expected 0 or 1"),
        (changed("stamps", put(0, -1)), "stamps: expected"),
        (
            lambda content: [
                content.update({name: content[name][1:]}) for name in ("surfaces", "votes", "seen", "sides")
            ],
            "surfaces: expected every brick",
        ),
    ],
)
def test_a_file_that_is_no_volume_is_refused(
    corner: Volume, tmp_path: Path, wrong: Callable[[dict[str, Array]], Any], words: str
) -> None:
    path = tmp_path / "volume.npz"
    corner.save(path)
    with np.load(path) as file:
        content = dict(file)
    wrong(content)
    np.savez_compressed(path, **content)
    with pytest.raises(ValueError, match=words):
        Volume.load(path)


def test_a_file_that_is_cut_or_missing_is_refused(corner: Volume, tmp_path: Path) -> None:
    path = tmp_path / "volume.npz"
    corner.save(path)
    whole = path.read_bytes()
    for length in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="expected a volume written by save"):
            Volume.load(path)
    with pytest.raises(FileNotFoundError):
        Volume.load(tmp_path / "none.npz")


# ------------------------------------------------------------------------------------------- refusals


def test_a_revision_grows_and_inputs_stay() -> None:
    volume, view = Volume(PROTOCOL), pose(0.0, 0.0, -8.0)
    depth, labels = render([FLOOR], view)
    before = depth.copy(), labels.copy()
    volume.integrate(depth, labels, CAMERA, view)
    np.testing.assert_array_equal(depth, before[0])
    np.testing.assert_array_equal(labels, before[1])
    seen = [volume.revision]
    volume.clear((0.0, 0.0, -8.0), 1.0)
    seen.append(volume.revision)
    volume.clear_body((0.0, 0.0, -8.0), (0.0, 0.0, -7.0))
    seen.append(volume.revision)
    assert seen == sorted(set(seen))


def test_it_lies_anywhere() -> None:
    """A thousand kilometres off, in any direction, the same is known."""
    shift = np.array([-1.0e6, 2.5e5, 0.0])
    here = looked([FLOOR], pose(0.3, 0.0, -8.0, tilt=0.5))
    floor = plane((0.0, 0.0, -10.07), (0.0, 0.0, 1.0))
    T = pose(0.3, 0.0, -8.0, tilt=0.5)
    there = Volume(PROTOCOL)
    there.integrate(*render([floor], T), CAMERA, SE3(T.rotation, T.translation + shift))
    points = grid((-1.0, -4.0, -11.0), (6.0, 4.0, -6.0), 0.25)
    assert (here.state(points) == there.state(points + shift)).mean() > 0.999


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"depth": np.zeros((160, 120), np.float32)}, "depth: expected .* swapped"),
        ({"depth": np.zeros((120, 160), np.uint16)}, "depth: expected floating-point"),
        ({"labels": np.zeros((120, 160))}, "labels: expected integers"),
        ({"labels": np.full((120, 160), 9)}, "labels: expected values of Label.* got 9"),
        ({"labels": np.full((120, 160), -1)}, "labels: expected values of Label.* got -1"),
        ({"confidence": np.full((120, 160), 1.5)}, "confidence: expected probabilities"),
        ({"confidence": np.full((120, 160), np.nan)}, "confidence: expected probabilities"),
        ({"error": np.full((120, 160), -0.1)}, "error: expected 0 or more"),
        ({"error": np.full((2, 2), 0.1)}, "error: expected"),
        ({"T_world_camera": pose(1e12, 0.0, 0.0)}, "T_world_camera: expected finite places"),
    ],
)
def test_a_frame_that_is_none_is_refused(wrong: dict[str, Any], words: str) -> None:
    frame: dict[str, Any] = {
        "depth": np.ones((120, 160), np.float32),
        "labels": np.ones((120, 160), np.uint8),
        "T_world_camera": pose(0.0, 0.0, 0.0),
    }
    with pytest.raises(ValueError, match=words):
        Volume(PROTOCOL).integrate(camera=CAMERA, **frame | wrong)


def test_points_and_cells_that_are_none_are_refused() -> None:
    volume = Volume(PROTOCOL)
    for points in ([1.0, 2.0, 3.0], [[np.nan, 0.0, 0.0]], [[1e12, 0.0, 0.0]]):
        with pytest.raises(ValueError, match="points: expected"):
            volume.state(points)
    with pytest.raises(ValueError, match="ends: expected 1, one for every start"):
        volume.room([[0.0, 0.0, 0.0]], np.zeros((2, 3)))
    with pytest.raises(ValueError, match="ends: expected ways"):
        volume.room([[0.0, 0.0, 0.0]], [[1e4, 0.0, 0.0]])
    with pytest.raises(ValueError, match="radius: expected"):
        volume.clear((0.0, 0.0, 0.0), math.inf)
    with pytest.raises(ValueError, match="end: expected a way"):
        volume.clear_body((0.0, 0.0, 0.0), (0.0, 0.0, 1e4))
    for cell in (0.0, -1.0, math.nan, 1e-3):
        with pytest.raises(ValueError, match="expected"):
            Volume(PROTOCOL, cell)


def test_sides_are_thirty_two_directions() -> None:
    directions = np.random.default_rng(1).standard_normal((20000, 3))
    bits = np.array([frame_kernels.side_bit(*d) for d in directions])
    values, counts = np.unique(bits, return_counts=True)
    assert len(values) == 32
    assert counts.max() < 1.3 * counts.min()
