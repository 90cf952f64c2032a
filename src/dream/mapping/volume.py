"""The map in three dimensions: what is free, solid, target, and from where its surface was inspected."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera, FloatArray
from dream.mapping._kernels import volume as bricks_kernels
from dream.mapping._kernels.volume import SIDE, VOXELS, Bricks
from dream.mapping.blocks import grown
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray, Label, UInt8Array

KEPT = 1.5
"""Times the reach: how far returns are kept, and rays clear. What returns from beyond reach is a hint."""
HIT, MISS = 17, 8
"""Steps of log-odds, in twentieths, of a voxel that something returned from, and of one that a ray passed."""
LEAST, MOST = -16, 70
"""Log-odds are kept between them: one return makes what was free solid, so that the guard knows at once."""
SHARE = 0.03
"""Of the pixels that a voxel covers, which must return from it to be believed, where depths scatter."""
MARGIN = 0.05
"""Metres of water around the body that must be known to be free as well."""
WIDEST = 400
"""Voxels within which all that is kept of a frame must lie, on each side of the camera."""

OF_BRICKS = ("names", "log_odds", "saturated", "stamps", "surface_of")
OF_SURFACES = ("votes", "seen", "sides")
"""Arrays of `Bricks` with an entry for each brick; and for each that something returned from."""


class VoxelState(enum.IntEnum):
    """What is known of a voxel."""

    UNKNOWN = bricks_kernels.UNKNOWN
    FREE = bricks_kernels.FREE
    SOLID = bricks_kernels.SOLID


UNKNOWN, FREE, SOLID = VoxelState


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """What the body of the vehicle would touch on its way, segment by segment."""

    clear: BoolArray
    """(M,) whether all of it is known to be free."""
    reason: UInt8Array
    """(M,) the worst `VoxelState` that it touches: solid before unknown before free."""
    share: npt.NDArray[np.float64]
    """(M,) of the way, before it touches what is not known to be free; 1 where it never does."""
    where: npt.NDArray[np.float64]
    """(M, 3) middle of the first voxel that it touches so, metres in the world; NaN where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The solid voxels that have a free one at a face."""

    middles: npt.NDArray[np.float64]
    """(n, 3) metres in the world."""
    normals: npt.NDArray[np.float64]
    """(n, 3) of length 1, towards free water: the mean direction of the free voxels among the 26 around."""
    target: npt.NDArray[np.float64]
    """(n,) share of its votes that were for target."""
    seen: BoolArray
    """(n,) whether it ever returned from within the protocol's reach."""
    sides: npt.NDArray[np.uint32]
    """(n,) bits of the sides from which it was inspected, `side_of` tells which."""
    area: npt.NDArray[np.float64]
    """(n,) square metres of surface that it stands for."""


class Volume:
    """A belief over space: free, solid or unknown, voxel by voxel, wherever the vehicle looks.

    What it does: frames with poses go in by `integrate`. A voxel that something returned from gains log-odds,
    and in the same frame none of its rays clears it. One that a ray passed loses some; so many points of it
    are looked up in the depth image that nearly all partly seen ones are found. A ray without a return clears
    as far as any return ever came from, and no farther than returns are kept. Of what returned, votes for
    target are kept, whether it was within reach, and from which sides it was inspected.

    Reference: Hornung et al., OctoMap, 2013, for log-odds with clamping; Niessner et al., Voxel Hashing,
    2013, for the bricks; voxels are looked up in the depth image, as supereight2 does, and no rays cast.

    Assumes: poses that are true to part of a voxel; depths that err as the protocol says.

    Fails when: something is thinner than the pixels are apart, or stands between two looks' voxels. A plate
    within one voxel is solid on both sides.
    """

    def __init__(self, protocol: SurveyProtocol, cell: float | None = None) -> None:
        """Nothing is known yet.

        Args:
            protocol: Reach, body, depth limits, and how depths err.
            cell: Side of a voxel, metres; that of the protocol's cells unless given.
        """
        side = protocol.cell if cell is None else cell
        if not 0.0 < side < math.inf:
            raise ValueError(f"cell: expected metres above 0, got {side}")
        self.protocol = protocol
        self.cell = side
        self.revision = 0
        """Grows with every change."""
        self._farthest = min(KEPT * protocol.reach, protocol.max_depth)
        for name, length in (("reach", self._farthest), ("launch_radius", protocol.launch_radius)):
            if length / side > WIDEST:
                raise ValueError(f"{name}: expected at most {WIDEST} voxels of {side} m, got {length} m")
        self._sees = 0.0
        self._bricks = _empty_bricks()
        self._scratch: Any = None

    # ------------------------------------------------------------------------------------ what goes in

    def integrate(
        self,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
        confidence: npt.NDArray[Any] | None = None,
    ) -> None:
        """Add one frame. The inputs are not changed.

        A voxel's surface counts as inspected from where the camera is where something returned from it within
        reach, at an angle to the surface's normal that the protocol calls useful. Normals are those of 4 × 4
        pixels whose depths are all there.

        Args:
            depth: (H, W) metres along the optical axis, NaN for no return.
            labels: (H, W) integers, values of `Label`. A pixel without a return clears the water only where
                its label is water.
            camera: Intrinsics of both images.
            T_world_camera: Where the optical frame was.
            confidence: (H, W) the probability in [0, 1] that depth and label of a pixel are right: by so much
                it counts, and below ½ it clears nothing. All are sure where None.

        Raises:
            ValueError: The images do not fit the camera, labels are not labels, or the camera is farther away
                than any map reaches.
        """
        from dream.mapping._kernels import volume_frame as kernels

        depth, labels, weights = _checked(depth, labels, camera, confidence, kernels.WEIGHT)
        place = T_world_camera.translation
        self._check_place("T_world_camera", place)
        lens = kernels.FrameLens(
            np.ascontiguousarray(T_world_camera.rotation),
            np.ascontiguousarray(place),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            self.protocol.returns,
        )
        rule, window = self._rule(), self._window(camera, T_world_camera)
        count = int(np.prod(window[1]))
        scratch = self._scratch_for(depth.shape, count)
        water, target = int(Label.WATER), int(Label.TARGET)
        self._sees = max(self._sees, kernels.read(depth, labels, weights, water, lens, rule, scratch))
        found, hit = kernels.mark(depth, labels, weights, target, lens, rule, window, scratch)
        self._reserve(count, hit)
        self.revision += 1
        limit = min(self._farthest, self._sees)
        kernels.settle(self._bricks, lens, rule, window, scratch, found, limit, self.revision)

    def clear(self, centre: npt.ArrayLike, radius: float) -> None:
        """Take a ball for free where it is not known to be solid, such as around the launch.

        Args:
            centre: (3,) metres in the world.
            radius: Metres; voxels count whose middle lies in it.
        """
        (point,) = self._points("centre", np.asarray(centre, np.float64)[None])
        if not 0.0 <= radius / self.cell <= WIDEST:
            raise ValueError(f"radius: expected 0 to {WIDEST} voxels of {self.cell} m, got {radius}")
        self._reserve(math.ceil(2.0 * radius / (SIDE * self.cell) + 2) ** 3)
        self.revision += 1
        bricks_kernels.clear_ball(self._bricks, point, radius, self.cell, -MISS, self.revision)

    def clear_body(self, start: npt.ArrayLike, end: npt.ArrayLike) -> None:
        """Take for free what the body swept on its way, with its margin, where it is not known to be solid.

        A voxel that it touched at all counts: the rest of it was as near as the margin, or is the body's own.

        Args:
            start: (3,) of the body's centre, metres in the world.
            end: (3,) likewise.
        """
        from dream.mapping._kernels import volume_room as kernels

        way = np.array([start, end], np.float64)
        way = self._points("start and end", way)
        reach = np.abs(way[1] - way[0]) + 2.0 * (max(self._body) + self.cell)
        if (reach / self.cell > 2 * WIDEST).any():
            raise ValueError(
                f"end: expected a way of at most {2 * WIDEST} voxels of {self.cell} m, got {way[1] - way[0]}"
            )
        self._reserve(int(np.prod(np.ceil(reach / (SIDE * self.cell)) + 1)))
        self.revision += 1
        body = kernels.SweptBody(*self._body)
        kernels.swept(self._bricks, way[0], way[1], body, self.cell, -MISS, self.revision)

    # ---------------------------------------------------------------------------------- what comes out

    def state(self, points: npt.ArrayLike) -> UInt8Array:
        """(N,) `VoxelState` of the voxels that points (N, 3) lie in; metres in the world."""
        odds = self._odds(points)
        return np.where(odds > 0, SOLID, np.where(odds < 0, FREE, UNKNOWN)).astype(np.uint8)

    def probability(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N,) of being solid, likewise; ½ where nothing is known."""
        return np.asarray(1.0 / (1.0 + np.exp(-0.05 * self._odds(points))))

    def target(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N,) share of votes for target, likewise; NaN where nothing ever returned."""
        slots, numbers = self._look_up(points)
        target, all_votes = self._bricks.votes[self._bricks.surface_of[slots], numbers].T.astype(np.float64)
        return np.asarray(np.where(all_votes > 0.0, target / np.maximum(all_votes, 1.0), np.nan))

    def room(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Room:
        """Whether the body moves straight from each start to its end in water that is known to be free.

        The body is the protocol's level cylinder, grown by `MARGIN` on all sides. Every voxel that it
        touches must be free. But what it touches at its start already does not hold it up where it moves
        away from that, over ground and in height.

        Args:
            starts: (M, 3) of the body's centre, metres in the world.
            ends: (M, 3) likewise.
        """
        from dream.mapping._kernels import volume_room as kernels

        first, last = self._points("starts", starts), self._points("ends", ends)
        if len(first) != len(last):
            raise ValueError(f"ends: expected {len(first)}, one for every start, got {len(last)}")
        if len(first) and np.abs(last - first).max() / self.cell > 2 * WIDEST:
            raise ValueError(f"ends: expected ways of at most {2 * WIDEST} voxels of {self.cell} m, got more")
        reason, share, where = kernels.room(
            self._bricks, first, last, kernels.SweptBody(*self._body), self.cell
        )
        return Room(reason == FREE, reason, share, where)

    def surface(self) -> Surface:
        """All solid voxels with a free one at a face.

        On a plane whose normal has the greatest component m, one such voxel comes to so many square metres as
        a face has, over m.
        """
        from dream.mapping._kernels import volume_surface as kernels

        voxels, normals, target, seen, sides = kernels.surface(self._bricks)
        middles = (voxels[:, ::-1] + 0.5) * self.cell
        area = self.cell**2 / np.abs(normals).max(axis=1, initial=1e-9)
        return Surface(middles, normals, target, seen, sides, area)

    @property
    def box(self) -> FloatArray | None:
        """(2, 3) low and high corner of the bricks that hold anything, metres; None where none does."""
        used = int(self._bricks.used[0])
        if used == 1:
            return None
        names = self._bricks.names[1:used]
        return np.asarray(np.stack([names.min(axis=0), names.max(axis=0) + 1])[:, ::-1] * (SIDE * self.cell))

    @property
    def nbytes(self) -> int:
        """Bytes that what is known takes, without what is in reserve."""
        used, kept = self._bricks.used.tolist()
        total = sum(getattr(self._bricks, name)[:used].nbytes for name in OF_BRICKS)
        total += sum(getattr(self._bricks, name)[:kept].nbytes for name in OF_SURFACES)
        return int(total + self._bricks.keys.nbytes + self._bricks.slots.nbytes)

    # ------------------------------------------------------------------------------------------------------

    @property
    def _body(self) -> tuple[float, float]:
        """Radius and half height of the body with its margin, metres."""
        return self.protocol.body_radius + MARGIN, 0.5 * self.protocol.body_height + MARGIN

    def _rule(self) -> Any:
        from dream.mapping._kernels import volume_frame as kernels

        protocol = self.protocol
        scatter = protocol.noise.depth if protocol.noise is not None else 0.0
        incidence = protocol.space.incidence if protocol.space is not None else 0.5 * math.pi
        return kernels.Weighing(
            side=self.cell,
            reach=protocol.reach,
            farthest=self._farthest,
            scatter=scatter,
            bias=protocol.lasting.depth if protocol.lasting is not None else 0.0,
            share=SHARE if scatter > 0.0 else 0.0,
            cosine=math.cos(incidence),
            hit=HIT,
            miss=MISS,
            least=LEAST,
            most=MOST,
        )

    def _window(self, camera: Camera, T_world_camera: SE3) -> IntArray:
        """(2, 3) level, row and column of the first brick around the view, and how many there are."""
        u, v = np.array([0.0, camera.width]), np.array([0.0, camera.height])
        a, b = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
        rays = np.stack([a.ravel(), b.ravel(), np.ones(4)], axis=1) @ T_world_camera.rotation.T
        place, farthest = T_world_camera.translation, self._farthest
        ends = np.vstack([np.zeros((1, 3)), rays * farthest])
        low = place + np.clip(ends.min(axis=0), -farthest, None)
        high = place + np.clip(ends.max(axis=0), None, farthest)
        first = np.floor(low / (SIDE * self.cell)).astype(np.int64)
        past = np.floor(high / (SIDE * self.cell)).astype(np.int64) + 1
        return np.stack([first, past - first])[:, ::-1].copy()

    def _scratch_for(self, shape: tuple[int, ...], count: int) -> Any:
        from dream.mapping._kernels import volume_frame as kernels

        kept = self._scratch
        if kept is None or kept.clear_to.shape != shape or len(kept.hit_of) < count:
            height, width = shape
            bricks = count + 64
            hit = min(bricks, height * width) + 1
            tiles = (-(-height // kernels.TILE), -(-width // kernels.TILE))
            self._scratch = kernels.FrameScratch(
                clear_to=np.empty(shape, np.float32),
                inverse=np.empty(shape, np.float32),
                tiles=np.empty((2, 2 * tiles[0] * tiles[1] + 4 * (sum(tiles) + kernels.LEVELS)), np.float32),
                facing=np.empty(tiles, np.uint8),
                codes=np.empty(width, np.int32),
                hit_of=np.zeros(bricks, np.int32),
                slot_of=np.zeros(bricks, np.int32),
                counts=np.zeros((hit, VOXELS, 2), np.int32),
                kinds=np.zeros((hit, VOXELS), np.uint8),
                touched=np.empty(height * width, np.int32),
            )
        return self._scratch

    def _reserve(self, bricks: int, surfaces: int = 0) -> None:
        """Make room for so many more."""
        held = self._bricks
        used, kept = held.used.tolist()
        if used + bricks > len(held.names):
            size = max(2 * len(held.names), used + bricks)
            held = held._replace(**{name: grown(getattr(held, name), size, used) for name in OF_BRICKS})
        if kept + surfaces > len(held.seen):
            size = max(2 * len(held.seen), kept + surfaces)
            held = held._replace(**{name: grown(getattr(held, name), size, kept) for name in OF_SURFACES})
        if 2 * (used + bricks) > len(held.keys):
            size = 1 << math.ceil(math.log2(4 * (used + bricks)))
            held = held._replace(keys=np.full(size, -1, np.int64), slots=np.zeros(size, np.int32))
            bricks_kernels.enter(held.keys, held.slots, held.names, used)
        self._bricks = held

    def _points(self, name: str, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        checked = np.ascontiguousarray(points, np.float64)
        if checked.ndim != 2 or checked.shape[1] != 3:
            raise ValueError(f"{name}: expected (N, 3) metres, got {checked.shape}")
        self._check_place(name, checked)
        return checked

    def _check_place(self, name: str, points: npt.NDArray[Any]) -> None:
        farthest = (bricks_kernels.FARTHEST - 2 * WIDEST) * SIDE * self.cell
        if not (np.abs(points) < farthest).all():
            raise ValueError(
                f"{name}: expected finite places within {farthest:g} m of the origin, got others"
            )

    def _look_up(self, points: npt.ArrayLike) -> tuple[IntArray, IntArray]:
        found: tuple[IntArray, IntArray] = bricks_kernels.look_up(
            self._bricks, self._points("points", points), self.cell
        )
        return found

    def _odds(self, points: npt.ArrayLike) -> npt.NDArray[np.int8]:
        slots, numbers = self._look_up(points)
        return np.asarray(self._bricks.log_odds[slots, numbers])


def _empty_bricks() -> Bricks:
    return Bricks(
        keys=np.full(4, -1, np.int64),
        slots=np.zeros(4, np.int32),
        used=np.ones(2, np.int64),
        names=np.zeros((1, 3), np.int32),
        log_odds=np.zeros((1, VOXELS), np.int8),
        saturated=np.zeros(1, np.uint8),
        stamps=np.zeros(1, np.int64),
        surface_of=np.zeros(1, np.int32),
        votes=np.zeros((1, VOXELS, 2), np.uint8),
        seen=np.zeros((1, VOXELS), np.uint8),
        sides=np.zeros((1, VOXELS), np.uint32),
    )


def _checked(
    depth: npt.NDArray[Any],
    labels: npt.NDArray[Any],
    camera: Camera,
    confidence: npt.NDArray[Any] | None,
    weight: int,
) -> tuple[npt.NDArray[np.float32], UInt8Array, UInt8Array]:
    """The images in the types that the kernels know, and the pixels' weights."""
    depth, labels = np.asarray(depth), np.asarray(labels)
    for name, image in (("depth", depth), ("labels", labels)):
        if image.ndim != 2:
            raise ValueError(f"{name}: expected (height, width), got {image.shape}")
        camera.check(image, name)
    if not np.issubdtype(depth.dtype, np.floating):
        raise ValueError(f"depth: expected floating-point metres, got {depth.dtype}")
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"labels: expected integers, values of Label, got {labels.dtype}")
    if labels.min() < 0 or labels.max() > max(Label):
        raise ValueError(
            f"labels: expected values of Label, 0 to {int(max(Label))}, "
            f"got {labels.max() if labels.min() >= 0 else labels.min()}"
        )
    weights = np.zeros((0, 0), np.uint8)
    if confidence is not None:
        sure = np.asarray(confidence, np.float64)
        camera.check(sure, "confidence")
        if not (sure.min() >= 0.0 and sure.max() <= 1.0):
            raise ValueError("confidence: expected probabilities in [0, 1], got others")
        weights = np.rint(weight * sure).astype(np.uint8)
    return np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(labels, np.uint8), weights
