"""The parts of a scene, and the one legend for all that draws one."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]
UInt8Array = npt.NDArray[np.uint8]
UInt16Array = npt.NDArray[np.uint16]
BoolArray = npt.NDArray[np.bool_]

NEVER = 65535
"""In place of the number of a step: it did not happen."""
MOST_FACES = 250_000
"""Of one surface."""
MOST_VERTICES = 3 * MOST_FACES
MOST_VOXELS = 200_000
MOST_STEPS = 60_000
MOST_INDIVIDUALS = 200_000
MOST_METRES = 1e5
"""Of a coordinate."""


class SceneState(enum.IntEnum):
    """What is known of a piece of surface at a step."""

    OTHER = 0
    """No target: seabed, boulders, whatever is solid."""
    UNSEEN = 1
    SEEN = 2
    INSPECTED = 3


LEGEND: Mapping[SceneState, tuple[str, tuple[int, int, int]]] = {
    SceneState.OTHER: ("Seabed and rock", (132, 146, 152)),
    SceneState.UNSEEN: ("Target, not yet seen", (122, 28, 92)),
    SceneState.SEEN: ("Target, seen", (226, 138, 18)),
    SceneState.INSPECTED: ("Target, inspected", (190, 240, 228)),
}
"""Name and sRGB. Their lightness rises with what is known: they differ in grey, and to the colour-blind."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneSurface:
    """A triangle mesh."""

    positions: Float32Array
    """(V, 3) metres in the world."""
    faces: Int32Array
    """(F, 3) indices of vertices."""
    owner: Int32Array
    """(V,) the individual that a vertex belongs to, −1 for none; the corners of a face belong to one."""

    def __post_init__(self) -> None:
        count = len(self.positions)
        _check("positions", self.positions, (count, 3), np.float32, MOST_VERTICES)
        _check("faces", self.faces, (len(self.faces), 3), np.int32, MOST_FACES)
        _check("owner", self.owner, (count,), np.int32, MOST_VERTICES)
        _check_metres("positions", self.positions)
        _check_between("faces", self.faces, 0, count - 1)
        if self.faces.size and np.ptp(self.owner[self.faces], axis=1).any():
            raise ValueError("owner: expected the corners of a face to belong to one individual")

    @property
    def triangles(self) -> Float32Array:
        """(F, 3, 3) corners of the faces."""
        return self.positions[self.faces]

    @property
    def face_owner(self) -> Int32Array:
        """(F,) the individual that a face belongs to."""
        return self.owner[self.faces[:, 0]] if len(self.faces) else np.empty(0, np.int32)

    @staticmethod
    def none() -> SceneSurface:
        """One without a face."""
        return SceneSurface(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty(0, np.int32))


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """What the vehicle mapped as solid: cubes on one lattice."""

    size: float
    """Metres a side."""
    positions: Float32Array
    """(n, 3) middles, whole numbers of `size` apart."""
    target: BoolArray
    """(n,) taken for a target."""
    seen_at: UInt16Array
    """(n,) the step from which on it is mapped."""
    inspected_at: UInt16Array
    """(n,) the step from which on it is inspected; `NEVER` where it is not."""

    def __post_init__(self) -> None:
        count = len(self.positions)
        _check("voxels", self.positions, (count, 3), np.float32, MOST_VOXELS)
        _check("voxels", self.target, (count,), np.bool_, MOST_VOXELS)
        _check("voxels", self.seen_at, (count,), np.uint16, MOST_VOXELS)
        _check("voxels", self.inspected_at, (count,), np.uint16, MOST_VOXELS)
        _check_metres("voxels", self.positions)
        if not 1e-3 <= self.size <= 1e3:
            raise ValueError(f"voxels: expected a size of 0.001 to 1000 m, got {self.size}")
        if count:
            extent = np.ptp(self.positions.astype(np.float64), axis=0) / self.size
            if extent.max() > 65000:
                raise ValueError(f"voxels: expected at most 65000 of {self.size} m a side, got {extent}")

    def cells(self) -> tuple[Float64Array, UInt16Array]:
        """The middle of the lowest cell, (3,), and the (n, 3) place of each in cells from there."""
        if len(self.positions) == 0:
            return np.zeros(3), np.empty((0, 3), np.uint16)
        low = self.positions.min(axis=0).astype(np.float64)
        return low, np.rint((self.positions - low) / self.size).astype(np.uint16)

    def states(self, step: int) -> UInt8Array:
        """(n,) `SceneState` of each at a step; `UNSEEN` of what is not mapped by then."""
        state = np.where(self.target, SceneState.SEEN, SceneState.OTHER)
        state[self.target & (self.inspected_at <= step)] = SceneState.INSPECTED
        state[self.seen_at > step] = SceneState.UNSEEN
        return state.astype(np.uint8)

    @staticmethod
    def none() -> Voxels:
        """A map without one."""
        nothing = np.empty(0, np.uint16)
        return Voxels(1.0, np.empty((0, 3), np.float32), np.empty(0, np.bool_), nothing, nothing)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where the vehicle was at the end of each step."""

    step: Int32Array
    """(P,) numbers of the steps, rising."""
    positions: Float32Array
    """(P, 3) metres in the world."""
    yaw: Float32Array
    """(P,) radians, 0 towards east, positive to the left."""
    tilt: Float32Array
    """(P,) pitch of the camera, radians, positive downwards."""
    collided: BoolArray
    """(P,) it touched something on the way."""

    def __post_init__(self) -> None:
        count = len(self.step)
        _check("path", self.step, (count,), np.int32, MOST_STEPS)
        _check("path", self.positions, (count, 3), np.float32, MOST_STEPS)
        _check("path", self.yaw, (count,), np.float32, MOST_STEPS)
        _check("path", self.tilt, (count,), np.float32, MOST_STEPS)
        _check("path", self.collided, (count,), np.bool_, MOST_STEPS)
        _check_metres("path", self.positions)
        if not (np.isfinite(self.yaw).all() and np.isfinite(self.tilt).all()):
            raise ValueError("path: expected finite angles")
        if count and (self.step[0] < 0 or self.step[-1] >= NEVER or (np.diff(self.step) <= 0).any()):
            raise ValueError(f"path: expected rising numbers of steps below {NEVER}")

    @staticmethod
    def none() -> Path:
        """Of a vehicle that was nowhere yet."""
        nothing = np.empty(0, np.float32)
        return Path(
            np.empty(0, np.int32), np.empty((0, 3), np.float32), nothing, nothing, np.empty(0, np.bool_)
        )


@dataclass(frozen=True, slots=True, eq=False)
class RunScene:
    """All that a picture shows. Each part may be empty; of a real place only map and path are known."""

    title: str
    bounds: Float64Array
    """(2, 3) metres: the lowest and the highest corner of the operator's box."""
    water: float
    """Height of the water's surface in the world."""
    field_of_view: tuple[float, float]
    """Of the camera, across and up: full angles, radians."""
    targets: SceneSurface
    """Its vertices belong to individuals."""
    kinds: tuple[str, ...]
    """Names of the kinds of target, such as "hull"."""
    kind: UInt8Array
    """(N,) of each individual, index into `kinds`."""
    seen_at: UInt16Array
    """(N,) the step from which on an individual counts as seen; `NEVER` where it does not."""
    inspected_at: UInt16Array
    """(N,) the step from which on it counts as inspected."""
    obstacles: SceneSurface
    """Solid, and no target."""
    seabed: SceneSurface
    voxels: Voxels
    path: Path

    def __post_init__(self) -> None:
        count = len(self.kind)
        _check("bounds", self.bounds, (2, 3), np.float64, 2)
        _check_metres("bounds", self.bounds)
        if not (self.bounds[0] < self.bounds[1]).all():
            raise ValueError(f"bounds: expected a box, got {self.bounds.tolist()}")
        if not abs(self.water) <= MOST_METRES:
            raise ValueError(f"water: expected a height in metres, got {self.water}")
        if len(self.field_of_view) != 2 or not all(0.0 < angle < np.pi for angle in self.field_of_view):
            raise ValueError(
                f"field of view: expected two angles of less than half a turn, got {self.field_of_view}"
            )
        _check("kind", self.kind, (count,), np.uint8, MOST_INDIVIDUALS)
        _check("seen_at", self.seen_at, (count,), np.uint16, MOST_INDIVIDUALS)
        _check("inspected_at", self.inspected_at, (count,), np.uint16, MOST_INDIVIDUALS)
        _check_between("kind", self.kind, 0, len(self.kinds) - 1)
        _check_between("owner of targets", self.targets.owner, 0, count - 1)
        for name, surface in (("obstacles", self.obstacles), ("seabed", self.seabed)):
            _check_between(f"owner of {name}", surface.owner, -1, -1)

    def states(self, step: int) -> UInt8Array:
        """(N,) `SceneState` of each individual at a step."""
        state = np.full(len(self.kind), SceneState.UNSEEN, np.uint8)
        state[self.seen_at <= step] = SceneState.SEEN
        state[self.inspected_at <= step] = SceneState.INSPECTED
        return state


def _check(name: str, array: npt.NDArray[np.generic], shape: tuple[int, ...], dtype: type, most: int) -> None:
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(
            f"{name}: expected {shape} {np.dtype(dtype).name}, got {array.shape} {array.dtype.name}"
        )
    if len(array) > most:
        raise ValueError(f"{name}: expected at most {most}, got {len(array)}")


def _check_metres(name: str, positions: npt.NDArray[np.floating]) -> None:
    # Of NaN no comparison is true.
    if not (np.abs(positions) <= MOST_METRES).all():
        raise ValueError(f"{name}: expected finite metres, {MOST_METRES:g} at most")


def _check_between(name: str, values: npt.NDArray[np.integer], least: int, most: int) -> None:
    if values.size and not (least <= values.min() and values.max() <= most):
        raise ValueError(f"{name}: expected {least} to {most}, got {values.min()} to {values.max()}")
