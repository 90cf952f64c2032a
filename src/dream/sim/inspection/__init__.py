"""Which individuals a frame inspects: the geometry of a vehicle that moves in three dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, camera_mount
from dream.protocol import Space, SurveyProtocol
from dream.sim.inspection import _kernels, kept
from dream.sim.inspection.points import SurfacePoints, sight_index, surface_of
from dream.sim.solids import FreeSpace, Solids, checked
from dream.sim.visibility import lattice_yaws
from dream.sim.world import World

Float64Array = npt.NDArray[np.float64]
IntpArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
UInt8Array = npt.NDArray[np.uint8]
Int32Array = npt.NDArray[np.int32]
UInt64Array = npt.NDArray[np.uint64]

SHARE = 0.2
"""So much of its points must be inspected in one frame. `perf/inspection.py share` measures what that asks:
alone, from 1 to 7 m and at up to 70° to the mean normal, evenly over the sphere, clumps pass in 98.7 % of
the views, flat patches in all, patches bent over an edge in 96.8 %. At a share of 0.3 clumps would in 93 %,
at 0.4 in 79 %."""
NODES = 20
"""From so many places at least, and from ..."""
NODE_SHARE = 0.01
"""... this share of the places within reach, must an individual be inspected to count as one that can be."""


@dataclass(frozen=True, slots=True, eq=False)
class Inspected:
    """What one frame makes of a world's individuals."""

    points: UInt8Array
    """(M,) of each point of `Inspection.surface`: 2 inspected, 1 seen, 0 neither."""
    seen: BoolArray
    """(N,) a point is seen, at whatever angle."""
    inspected: BoolArray
    """(N,) enough points are inspected."""


class Inspection:
    """Which individuals of a world are inspected from where, under a protocol that moves in space.

    What it does: an individual has a handful of points on its surface (`points.surface_of`). One is seen when
    it lies within `reach` straight through the water, projects into the image at a valid depth, shows the eye
    its face, and has a clear line of sight past everything: terrain, boulders, hull, clumps, its own
    individual too. It is inspected when it is seen at an incidence of the protocol's `space` at most. An
    individual is inspected when `SHARE` of its points are, in one frame, and seen when one of them is.
    Assumes: the camera sits at the vehicle's centre. How far labels reach in the water plays no part.
    Fails when: a pose lies inside something solid. It then sees what that hides; ask `Solids.free_at` first.
    """

    def __init__(self, world: World, protocol: SurveyProtocol, solids: Solids | None = None) -> None:
        if protocol.space is None:
            raise ValueError(f"protocol: expected one that moves in space, got {protocol.name}")
        self.world, self.protocol = world, protocol
        self.solids = solids or Solids(world)
        self._clumps = sight_index(world)
        self.surface: SurfacePoints = surface_of(world, self.solids.index, self._clumps)
        """The points, and the area that each individual has."""
        count = np.diff(self.surface.first)
        self._points = _kernels.Points(
            at=self.surface.points,
            normal=self.surface.normals,
            both=self.surface.two_sided[self.surface.owner],
            first=self.surface.first,
            # Nudged, so that a fifth of ten is two.
            needed=np.maximum(np.ceil(SHARE * count - 1e-9), 1.0).astype(np.intp),
        )
        self._optics = _optics(protocol, protocol.space)

    def __len__(self) -> int:
        return len(self.surface.area)

    def look(self, T_world_base: SE3, tilt: float) -> Inspected:
        """What the vehicle sees and inspects from one pose.

        Args:
            T_world_base: Where it is.
            tilt: Of the camera, radians downwards.
        """
        T_world_camera = T_world_base @ camera_mount(tilt)
        points = _kernels.look(
            self.solids.index,
            self._clumps,
            self._points,
            self._optics,
            np.ascontiguousarray(T_world_camera.rotation, np.float64),
            np.ascontiguousarray(T_world_camera.translation, np.float64),
        )
        owner, count = self.surface.owner, len(self)
        inspected = np.bincount(owner[points == _kernels.INSPECTED], minlength=count)
        seen = np.bincount(owner[points > 0], minlength=count)
        return Inspected(points, seen > 0, inspected >= self._points.needed)

    def inspected(self, T_world_base: SE3, tilt: float) -> BoolArray:
        """(N,) as `look`."""
        return self.look(T_world_base, tilt).inspected

    def seen(self, T_world_base: SE3, tilt: float) -> BoolArray:
        """(N,) as `look`."""
        return self.look(T_world_base, tilt).seen

    @cached_property
    def free_space(self) -> FreeSpace:
        """Where the vehicle can be."""
        return self.solids.free_space(self.protocol)

    @cached_property
    def countable(self) -> BoolArray:
        """(N,) the individuals that what a vehicle can do can show: only they count.

        Such a one is inspected from at least `NODE_SHARE` of the reachable places within reach of the middle
        of its points, and from `NODES` at least; a place inspects it when the frame does whose heading and
        tilt point nearest to that middle. Kept on disk, by the world and by what of the protocol matters.
        """
        return kept.countable(self.world, self.protocol, self.worked_out)

    @property
    def dropped(self) -> float:
        """Share of the area of all individuals that belongs to those that are not `countable`."""
        area = self.surface.area
        return float(area[~self.countable].sum() / area.sum()) if len(area) else 0.0

    def worked_out(self) -> BoolArray:
        """(N,) `countable` without the cache: seconds of CPU."""
        space, protocol = self.free_space, self.protocol
        span = math.ceil(protocol.reach / space.spacing) + 1
        offsets = np.stack(np.meshgrid(*[np.arange(-span, span + 1)] * 3), axis=-1).reshape(-1, 3)
        square = (offsets**2).sum(axis=1)
        offsets = offsets[square <= span * span]
        nearest_first = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
        return _kernels.inspectable(
            self.solids.index,
            self._clumps,
            self._points,
            self._optics,
            space.reachable,
            space.first,
            space.spacing,
            nearest_first.astype(np.intp),
            self._rotations,
            np.array(protocol.tilts, np.float64),
            NODE_SHARE,
            NODES,
        )

    @property
    def _rotations(self) -> Float64Array:
        """(headings, tilts, 3, 3) of `T_world_camera`."""
        rotations = [
            [(SE3.level(0.0, 0.0, 0.0, yaw) @ camera_mount(tilt)).rotation for tilt in self.protocol.tilts]
            for yaw in lattice_yaws(self.protocol)
        ]
        return np.array(rotations, np.float64)

    def shown_from(self, eyes: npt.ArrayLike) -> tuple[IntpArray, Int32Array, UInt64Array]:
        """Which frames inspect which countable individuals from each of some places, as `look` does.

        Args:
            eyes: (E, 3) metres in the world.

        Returns:
            first: (E + 1,) place e has the entries first[e] to first[e + 1].
            who: (K,) the individual of an entry, as an index into those that are countable.
            frames: (K,) bit `heading · tilts + tilt` is set where the frame with that heading and tilt of the
                protocol inspects it.

        Raises:
            ValueError: The protocol has more than 64 frames at a place.
        """
        rotations = self._rotations.reshape(-1, 3, 3)
        if len(rotations) > 64:
            raise ValueError(f"protocol: expected at most 64 headings and tilts, got {len(rotations)}")
        wanted, first = np.flatnonzero(self.countable), self.surface.first
        middles = np.zeros((len(wanted), 3))
        radii = np.zeros(len(wanted))
        for r, n in enumerate(wanted):
            own = self.surface.points[first[n] : first[n + 1]]
            middles[r] = own.mean(axis=0)
            # Nudged, so that rounding leaves no point outside.
            radii[r] = np.linalg.norm(own - middles[r], axis=1).max() + 1e-6
        found: tuple[IntpArray, Int32Array, UInt64Array] = _kernels.shown_from(
            self.solids.index,
            self._clumps,
            self._points,
            self._optics,
            wanted,
            middles,
            radii,
            checked(eyes, "eyes", 3),
            rotations,
        )
        return found


def _optics(protocol: SurveyProtocol, space: Space) -> _kernels.Optics:
    camera = protocol.camera
    return _kernels.Optics(
        fx=float(camera.fx),
        fy=float(camera.fy),
        cx=float(camera.cx),
        cy=float(camera.cy),
        width=float(camera.width),
        height=float(camera.height),
        min_depth=float(protocol.min_depth),
        max_depth=float(protocol.max_depth),
        reach=float(protocol.reach),
        cosine=math.cos(space.incidence),
    )
