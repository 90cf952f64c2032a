"""The map in three dimensions: what is free, solid, target, and from where its surface was inspected."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from dream import arrays
from dream.geometry import SE3, Bounds, Camera, FloatArray
from dream.mapping._kernels import volume as bricks_kernels
from dream.mapping._kernels.volume import FELT, SIDE, VOXELS, Bricks
from dream.mapping.blocks import grown
from dream.mapping.leash import Leash
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Float32Array, IntArray, Label, UInt8Array

if TYPE_CHECKING:
    from dream.mapping._kernels.strings import FreeWater

KEPT = 1.5
"""Times the reach: how far returns are kept, and rays clear. What returns from beyond reach is a hint."""
HIT, MISS = 17, 8
"""Steps of log-odds, in twentieths, of a voxel that something returned from, and of one that a ray passed."""
LEAST, MOST = -16, 70
"""Log-odds are kept between them: one return makes what was free solid, so that the guard knows at once. What
the body touched has more, and keeps it."""
HELD, BELIEVED = 0.03, 0.12
"""Of the pixels that a voxel covers, where depths scatter: where more return from it, the others of the frame
do not clear it; and where more do, it is solid. In between a thin thing stays unknown, never free."""
MARGIN = 0.05
"""Metres of water around the body that must be known to be free as well."""
LAST_LABEL = int(max(Label))
MOUND = 3.0
"""Metres: what is narrower stands on the ground, seen from above; what is wider is ground."""
WIDEST = 400
"""Voxels within which all that is kept of a frame must lie, on each side of the camera."""

FORMAT = "dream-volume-1"
MOST_TEXT = 1 << 16
"""Bytes of what a file says of its volume."""
STORED = ("names", "log_odds", "stamps")
"""Arrays of a file with an entry for each brick."""
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
    """(n,) whether it ever returned from where labels are trusted: `SurveyProtocol.trusted`."""
    sides: npt.NDArray[np.uint32]
    """(n,) bits of the sides from which it was inspected, see `side_bit` in its kernels."""
    area: npt.NDArray[np.float64]
    """(n,) square metres of surface that it stands for."""


@dataclass(frozen=True, slots=True, eq=False)
class Above:
    """A volume from above, over the cells of a box; row grows with y, col with x."""

    bounds: Bounds
    ground: npt.NDArray[np.float64]
    """(rows, cols) world z of the local ground; NaN where nothing solid is known. Grey opening of the lowest
    solid voxels' middles that are not target: what is narrower than `MOUND` stands on it."""
    top: npt.NDArray[np.float64]
    """(rows, cols) world z of the upper face of the highest solid voxel; NaN where there is none."""
    solid: BoolArray
    """(rows, cols) whether a solid voxel is in the protocol's height band above the ground, and no part of
    it below."""
    target: npt.NDArray[np.float64]
    """(rows, cols) share of the column's votes for target; NaN where nothing returned."""
    explored: BoolArray
    """(rows, cols) whether anything solid looks up into free water, and all that does was seen from within
    reach, or lies on a voxel that was. So the flank of a mound that was not seen is not explored."""


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
        self.leash: Leash | None = None
        """Beyond which the vehicle may not go; see `OccupancyMap.hold`."""
        self._sees = 0.0
        self._bricks = _empty_bricks()
        self._scratch: Any = None
        self._surface: tuple[int, Surface] | None = None
        """The latest that was asked for, and of which revision it is."""
        self._held: tuple[tuple[Any, ...], BoolArray] | None = None
        """Likewise, and for which leash and grid."""

    # ------------------------------------------------------------------------------------ what goes in

    def integrate(
        self,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
        confidence: npt.NDArray[Any] | None = None,
        error: npt.NDArray[Any] | None = None,
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
            error: (H, W) see `Observation.error`. A ray clears as far as its depth is sure to reach, however
                sure its label is; and water no farther than anything is seen in the same frame. Where a depth
                is unsure, what it covers beyond that is not cleared by other rays either.

        Raises:
            ValueError: The images do not fit the camera, labels are not labels, or the camera is farther away
                than any map reaches.
        """
        from dream.mapping._kernels import volume_frame as kernels

        depth, labels, weights, errors = _checked(depth, labels, camera, confidence, error, kernels.WEIGHT)
        place = T_world_camera.translation
        self._check_place("T_world_camera", place)
        lens = kernels.FrameLens(
            np.ascontiguousarray(T_world_camera.rotation),
            np.ascontiguousarray(place),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            self.protocol.returns,
        )
        rule = self._rule()
        window = kernels.window_of(lens, camera.width, camera.height, self._farthest, self.cell)
        count = math.prod(window[1].tolist())
        scratch = self._scratch_for(depth.shape, count)
        water, target = int(Label.WATER), int(Label.TARGET)
        sees = kernels.read(depth, labels, weights, errors, water, lens, rule, scratch)
        self._sees = max(self._sees, sees)
        found, hit = kernels.mark(depth, labels, weights, target, lens, rule, window, scratch)
        self._reserve(count, hit)
        self.revision += 1
        limit = min(self._farthest, self._sees if error is None else sees)
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

    def feel(self, here: npt.ArrayLike, contact: npt.ArrayLike, goal: npt.ArrayLike) -> None:
        """Take for solid, for good, what the body touched on its straight way to a goal.

        That is what a body with its margin would touch within the length of a voxel beyond the contact, but
        for what it swept until twice the margin before: what is left lies within 60° of ahead, and does not
        hold up who goes on beside it. Nothing where it was not on its way anywhere.

        Args:
            here: (3,) of the body's centre now, metres in the world.
            contact: (3,) likewise, at the contact.
            goal: (3,) likewise, where it was sent.
        """
        from dream.mapping._kernels import volume_room as kernels

        points = self._points("here, contact and goal", np.array([here, contact, goal], np.float64))
        place, onward = points[1], points[2] - points[1]
        length = float(np.linalg.norm(onward))
        if length == 0.0:
            return
        radius, half_height = self._body
        bricks = math.ceil((2.0 * max(radius, half_height) + 3.0 * self.cell) / (SIDE * self.cell) + 1) ** 3
        self._reserve(bricks, bricks)
        self.revision += 1
        body, ahead = kernels.SweptBody(radius, half_height), onward / length
        before, end = place - 2.0 * MARGIN * ahead, place + self.cell * ahead
        kernels.feel(self._bricks, points[0], before, place, end, body, self.cell, self.revision)

    # ---------------------------------------------------------------------------------- what comes out

    def state(self, points: npt.ArrayLike) -> UInt8Array:
        """(N,) `VoxelState` of the voxels that points (N, 3) lie in; metres in the world."""
        odds = self._odds(points)
        return np.where(odds > 0, SOLID, np.where(odds < 0, FREE, UNKNOWN)).astype(np.uint8)

    def states_in(self, first: IntArray, shape: tuple[int, int, int]) -> UInt8Array:
        """(levels, rows, cols) `VoxelState` of the voxels of a box.

        Args:
            first: (3,) level, row and column of the box's first voxel, from the world's origin.
            shape: Of the box, in voxels.
        """
        states = np.empty(shape, np.uint8)
        bricks_kernels.states_in(self._bricks, np.asarray(first, np.int64), states)
        return states

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

    def held(self, first: tuple[int, int, int], spacing: float, shape: tuple[int, int, int]) -> BoolArray:
        """Which points of a grid the leash reaches through water that is known to be free; all without one.

        Args:
            first: Level, row and column of the first point, from the world's origin.
            spacing: Metres between points.
            shape: (levels, rows, cols).
        """
        if self.leash is None:
            return np.ones(shape, np.bool_)
        question = self.revision, self.leash, first, spacing, shape
        if self._held is None or self._held[0] != question:
            corner = np.array(first[::-1]) * spacing
            lengths = self.leash.lengths(self.free_water(), corner, spacing, shape)
            self._held = question, np.isfinite(lengths)
        return self._held[1]

    def free_water(self) -> FreeWater:
        """All that is known to be free."""
        from dream.mapping._kernels.strings import FreeWater

        box = np.zeros((2, 3)) if self.box is None else self.box
        low, past = np.rint(box[:, ::-1] / self.cell).astype(np.int64)
        levels, rows, cols = (past - low).tolist()
        states = self.states_in(low, (levels, rows, cols))
        return FreeWater((states == FREE).view(np.uint8), low[::-1] * self.cell, np.full(3, self.cell))

    def surface(self) -> Surface:
        """All solid voxels with a free one at a face.

        On a plane whose normal has the greatest component m, one such voxel comes to so many square metres as
        a face has, over m. Found once for each change; whoever changes the arrays copies them.
        """
        if self._surface is None or self._surface[0] != self.revision:
            self._surface = self.revision, self._find_surface()
        return self._surface[1]

    def _find_surface(self) -> Surface:
        from dream.mapping._kernels import volume_surface as kernels

        voxels, normals, target, seen, sides = kernels.surface(self._bricks)
        middles = (voxels[:, ::-1] + 0.5) * self.cell
        area = self.cell**2 / np.abs(normals).max(axis=1, initial=1e-9)
        return Surface(middles, normals, target, seen, sides, area)

    def above(self, bounds: Bounds) -> Above:
        """The view from above, on cells as wide as voxels, by the column of voxels under each cell's middle.

        Args:
            bounds: What to look at; cells begin at its lower left corner, and cover it.
        """
        from scipy import ndimage

        from dream.mapping._kernels import volume_surface as kernels

        cell = self.cell
        half = round(0.5 * MOUND / cell)
        # The opening at an edge needs what lies twice as far outside.
        rim = 2 * half
        x = bounds.x_min + (np.arange(-rim, math.ceil(bounds.width / cell - 1e-9) + rim) + 0.5) * cell
        y = bounds.y_min + (np.arange(-rim, math.ceil(bounds.depth / cell - 1e-9) + rim) + 0.5) * cell
        names = self._bricks.names[1 : int(self._bricks.used[0]), 0]
        levels = (int(names.min()), int(names.max()) + 1) if len(names) else (0, 0)
        lowest, highest, votes, explored = kernels.columns(self._bricks, x, y, cell, levels)
        none = levels[0] * SIDE - 1
        known, inner = lowest > none, (slice(rim, len(y) - rim), slice(rim, len(x) - rim))
        local = np.full(lowest.shape, np.nan)
        if known.any():
            # Where none is known, the nearest that is: it neither digs nor fills.
            nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
            filled = ((lowest + 0.5) * cell)[tuple(nearest)]
            local = ndimage.grey_opening(filled, size=(2 * half + 1, 2 * half + 1), mode="nearest")
        low, high = (local[inner] + edge for edge in self.protocol.band)
        # Ground whose height errs by a voxel does not stand up.
        low += 0.5 * cell
        solid = kernels.solid_between(self._bricks, x[inner[1]], y[inner[0]], cell, levels, low, high)
        highest, votes = highest[inner], votes[inner]
        ground = np.where(highest > none, local[inner], np.nan)
        top = np.where(highest > none, (highest + 1) * cell, np.nan)
        cast = votes[..., 1]
        target = np.where(cast > 0, votes[..., 0] / np.maximum(cast, 1), np.nan)
        return Above(bounds, ground, top, solid, target, explored[inner])

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

    # ----------------------------------------------------------------------------------- copies, files

    def copy(self) -> Volume:
        """A volume of its own with the same content."""
        other = Volume(self.protocol, self.cell)
        used, kept = self._bricks.used.tolist()
        other._bricks = Bricks(
            **{
                name: pool[: used if name in OF_BRICKS else kept if name in OF_SURFACES else None].copy()
                for name, pool in self._bricks._asdict().items()
            }
        )
        other.revision, other._sees = self.revision, self._sees
        return other

    def save(self, path: str | Path) -> None:
        """Write everything to one .npz file."""
        about = {
            "format": FORMAT,
            "protocol": dataclasses.asdict(self.protocol),
            "cell": self.cell,
            "revision": self.revision,
            "sees": self._sees,
        }
        held, used = self._bricks, int(self._bricks.used[0])
        with_surface = np.flatnonzero(held.surface_of[:used])
        kept = held.surface_of[with_surface]
        arrays_of: dict[str, Any] = {name: getattr(held, name)[1:used] for name in STORED}
        arrays_of |= {name: getattr(held, name)[kept] for name in OF_SURFACES}
        arrays_of |= {"about": np.array(json.dumps(about)), "surfaces": with_surface}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **arrays_of)

    @staticmethod
    def load(path: str | Path) -> Volume:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is damaged, or no volume; the message says what was expected and what was found.
        """
        with arrays.opened(Path(path), "a volume written by save") as content:
            try:
                return _read(content)
            except (ArithmeticError, MemoryError) as error:  # Of lengths that no volume has.
                raise ValueError(f"about: {error}") from error

    # ------------------------------------------------------------------------------------------------------

    @property
    def _body(self) -> tuple[float, float]:
        """Radius and half height of the body with its margin, metres."""
        return self.protocol.body_radius + MARGIN, 0.5 * self.protocol.body_height + MARGIN

    @property
    def _incidence(self) -> float:
        """Greatest angle at which a surface is inspected; any where the protocol is planar."""
        space = self.protocol.space
        return 0.5 * math.pi if space is None else space.incidence

    def _rule(self) -> Any:
        from dream.mapping._kernels import volume_frame as kernels

        protocol = self.protocol
        scatter = protocol.noise.depth if protocol.noise is not None else 0.0
        return kernels.Weighing(
            side=self.cell,
            reach=protocol.reach,
            trusted=protocol.trusted,
            farthest=self._farthest,
            scatter=scatter,
            bias=protocol.lasting.depth if protocol.lasting is not None else 0.0,
            held=HELD if scatter > 0.0 else 0.0,
            believed=BELIEVED if scatter > 0.0 else 0.0,
            cosine=math.cos(self._incidence),
            hit=HIT,
            miss=MISS,
            least=LEAST,
            most=MOST,
        )

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


def _packed(names: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """(n,) one number for each name of a brick."""
    level, row, col = names.T.astype(np.int64) + bricks_kernels.FARTHEST
    return np.asarray((level << 42) | (row << 21) | col)


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
        votes=np.zeros((1, VOXELS, 2), np.uint16),
        seen=np.zeros((1, VOXELS), np.uint8),
        sides=np.zeros((1, VOXELS), np.uint32),
    )


class _Said(BaseModel):
    """What a file says of its volume."""

    model_config = ConfigDict(extra="forbid", strict=True)

    format: Literal["dream-volume-1"]
    protocol: SurveyProtocol
    cell: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    revision: Annotated[int, Field(ge=0, lt=1 << 62)]
    sees: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


def _read(content: arrays.Npz) -> Volume:
    names, headers = {"about", "surfaces", *STORED, *OF_SURFACES}, content.headers
    if set(headers) != names or len(content.entries) != len(headers):
        raise ValueError(f"expected the arrays {', '.join(sorted(names))}, got others")
    shape, dtype = headers["about"][:2]
    if shape != () or dtype.kind != "U" or dtype.itemsize > MOST_TEXT:
        raise ValueError(f"about: expected a text, got {shape} {dtype}")
    about = _Said.model_validate_json(str(content["about"]))
    volume = Volume(about.protocol, about.cell)
    count, kept = (headers[name].shape[0] if headers[name].shape else 0 for name in ("names", "surfaces"))
    empty = volume._bricks
    expected = {
        name: (getattr(empty, name).dtype, (count, *getattr(empty, name).shape[1:])) for name in STORED
    }
    expected |= {
        name: (getattr(empty, name).dtype, (kept, *getattr(empty, name).shape[1:])) for name in OF_SURFACES
    }
    for name, (dtype, shape) in {**expected, "surfaces": (np.dtype(np.int64), (kept,))}.items():
        if headers[name][:2] != (shape, dtype):
            raise ValueError(f"{name}: expected {shape} {dtype}, got {headers[name][:2]}")
    found = {name: content[name] for name in (*STORED, *OF_SURFACES, "surfaces")}
    _check_content(found, count, about.revision)
    volume._reserve(count, kept)
    held = volume._bricks
    for name in STORED:
        getattr(held, name)[1 : 1 + count] = found[name]
    for name in OF_SURFACES:
        getattr(held, name)[1 : 1 + kept] = found[name]
    # By eighths of a brick: bit 4, 2 and 1 of their number tell upper, northern and eastern ones.
    eighths = found["log_odds"].reshape(count, 2, SIDE // 2, 2, SIDE // 2, 2, SIDE // 2)
    full = (eighths <= LEAST).all(axis=(2, 4, 6)).reshape(count, 8)
    held.saturated[1 : 1 + count] = np.packbits(full, axis=1, bitorder="little")[:, 0]
    held.surface_of[found["surfaces"]] = np.arange(1, 1 + kept)
    held.used[:] = 1 + count, 1 + kept
    bricks_kernels.enter(held.keys, held.slots, held.names, 1 + count)
    volume.revision, volume._sees = about.revision, about.sees
    return volume


def _check_content(found: dict[str, npt.NDArray[Any]], count: int, revision: int) -> None:
    """Raise a ValueError unless the arrays hold what a volume can."""
    names, surfaces, odds = found["names"], found["surfaces"], found["log_odds"]
    limit = bricks_kernels.FARTHEST
    if (names < -limit).any() or (names >= limit).any() or len(np.unique(_packed(names))) != count:
        raise ValueError("names: expected different bricks of the map, got others")
    if (odds < LEAST).any() or ((odds > MOST) & (odds != FELT)).any():
        raise ValueError(f"log_odds: expected {LEAST} to {MOST} or {FELT}, got others")
    if (found["stamps"] < 0).any() or (found["stamps"] > revision).any():
        raise ValueError(f"stamps: expected 0 to {revision}, got others")
    if (surfaces < 1).any() or (surfaces > count).any() or (np.diff(surfaces) <= 0).any():
        raise ValueError("surfaces: expected rising numbers of bricks, got others")
    if (found["votes"][..., 0] > found["votes"][..., 1]).any():
        raise ValueError("votes: expected no more for target than all, got others")
    if (found["seen"] > 1).any():
        raise ValueError("seen: expected 0 or 1, got others")
    bare = np.ones(count, np.bool_)
    bare[surfaces - 1] = False
    if (odds[bare] > 0).any():
        raise ValueError("surfaces: expected every brick with something solid, got others")


def _checked(
    depth: npt.NDArray[Any],
    labels: npt.NDArray[Any],
    camera: Camera,
    confidence: npt.NDArray[Any] | None,
    error: npt.NDArray[Any] | None,
    weight: int,
) -> tuple[Float32Array, UInt8Array, UInt8Array, Float32Array]:
    """The images in the types that the kernels know, the pixels' weights, and the errors of their depths."""
    depth, labels = np.asarray(depth), np.asarray(labels)
    for name, image in (("depth", depth), ("labels", labels)):
        if image.ndim != 2:
            raise ValueError(f"{name}: expected (height, width), got {image.shape}")
        camera.check(image, name)
    if not np.issubdtype(depth.dtype, np.floating):
        raise ValueError(f"depth: expected floating-point metres, got {depth.dtype}")
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"labels: expected integers, values of Label, got {labels.dtype}")
    unsigned = np.issubdtype(labels.dtype, np.unsignedinteger)
    if labels.max() > LAST_LABEL or not (unsigned or labels.min() >= 0):
        wrong = labels.max() if labels.max() > LAST_LABEL else labels.min()
        raise ValueError(f"labels: expected values of Label, 0 to {LAST_LABEL}, got {wrong}")
    weights = np.zeros((0, 0), np.uint8)
    if confidence is not None:
        sure = np.asarray(confidence, np.float64)
        camera.check(sure, "confidence")
        if not (sure.min() >= 0.0 and sure.max() <= 1.0):
            raise ValueError("confidence: expected probabilities in [0, 1], got others")
        weights = np.rint(weight * sure).astype(np.uint8)
    errors = np.zeros((0, 0), np.float32)
    if error is not None:
        errors = np.ascontiguousarray(error, np.float32)
        camera.check(errors, "error")
        if (errors < 0.0).any():
            raise ValueError("error: expected 0 or more, or NaN, got less")
    return np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(labels, np.uint8), weights, errors
