"""The map: what is solid, target, explored and traversable, cell by cell."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from dream import arrays
from dream.geometry import SE3, Bounds, Camera, FloatArray
from dream.mapping._kernels import flags
from dream.mapping._kernels.flags import BLOCK, EDGE
from dream.mapping.blocks import BlockStore
from dream.mapping.frame import FrameWindow, unsure
from dream.mapping.layers import (
    CELLS,
    POSTS,
    TRAVERSED,
    Evidence,
    Layers,
    cells_of,
    cells_within,
    post_bits,
    probability_of_votes,
)
from dream.mapping.leash import Leash
from dream.protocol import SurveyProtocol
from dream.traversal import traversed
from dream.types import BoolArray, Float32Array, Label

if TYPE_CHECKING:
    from dream.mapping.volume import Volume

T = TypeVar("T")
Float64Array = npt.NDArray[np.float64]

FORMAT = "dream-map-2"
MOST_TEXT = 1 << 16
"""Bytes of what a file says of its map."""
LAST_LABEL = int(max(Label))
MOST_PIXELS = 1 << 20
"""Of larger images every n-th row and column is taken."""
MOST_SIDE = 8192
"""Likewise of images with a longer side. Within both no cell's counts overflow."""
MOST_CELLS = 1400
"""Of the reach and of the lengths around the vehicle: a window's cells and labels then fit 32 bits."""
SURE = (20, -6)
"""Log-odds of a cell, in steps, that the volume shows to be solid from above, and of one that is not."""
VOTED = (0x30, 0x03)
"""Votes of a cell that the volume shows to be target from above, and of one that is not."""
MARGIN_BLOCKS = 1 + MOST_CELLS // BLOCK
"""Blocks around the bounds that a file may hold, in which nothing is written."""
FARTHEST = 1 << 30
"""Cells from the origin beyond which there is no map."""


class OccupancyMap(Layers):
    """A semantic occupancy grid that grows where the robot looks.

    What it does: frames with poses go in by `integrate`, layers come out as read-only arrays of
    (rows, cols), over the survey area or, by `over`, over any window. An array that was read keeps its values
    when the map goes on.

    Reference: Eq. 1-8 of the paper; docs/map.md has the update rule. Solid and target are separate, since a
    wreck is both; heights are above the local seabed, whose height is learnt from the points labelled seabed.

    Assumes: a camera that looks ahead, mounted at the vehicle's centre; the protocol's altitude.

    Fails when: labels call a boulder seabed in most of its pixels (the ground then rises to it).
    """

    def __init__(
        self, bounds: Bounds | None, protocol: SurveyProtocol, evidence: Evidence | None = None
    ) -> None:
        """An empty map.

        Args:
            bounds: The survey area, whose sides are whole numbers of cells: nothing outside is ever known.
                None for a map without an end, whose `bounds` are those of the blocks that were written so
                far, and one cell at the world's origin before any was.
            protocol: Cell size, reach, height band, depth limits and body.
            evidence: How frames are weighed.
        """
        for name in ("reach", "body_radius", "launch_radius", "lattice"):
            if not getattr(protocol, name) / protocol.cell <= MOST_CELLS:
                length = getattr(protocol, name)
                raise ValueError(
                    f"{name}: expected at most {MOST_CELLS} cells of {protocol.cell} m, got {length} m"
                )
        bits = post_bits(protocol)
        posts = (BLOCK >> bits, BLOCK >> bits)
        layers: dict[str, tuple[npt.DTypeLike, tuple[int, ...]]] = {
            "log_odds": (np.int8, (BLOCK, BLOCK)),
            "flags": (np.uint8, (BLOCK, BLOCK)),
            "votes": (np.uint8, (BLOCK, BLOCK)),
            "ground_sum": (np.float32, posts),
            "ground_count": (np.float32, posts),
        }
        if protocol.traversal is not None:
            layers[TRAVERSED] = (np.uint8, (BLOCK, BLOCK))
        store = BlockStore(layers)
        if bounds is not None:
            farthest = FARTHEST * protocol.cell
            if max(map(abs, (bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max))) > farthest:
                raise ValueError(
                    f"bounds: expected a place within {farthest:g} m of the origin, got {bounds}"
                )
            for side, length in (("depth", bounds.depth), ("width", bounds.width)):
                cells = length / protocol.cell
                if abs(cells - round(cells)) > 1e-6:
                    raise ValueError(
                        f"bounds: expected a {side} of whole {protocol.cell} m cells, got {length} m"
                    )
        area = bounds or Bounds(0.0, 0.0, protocol.cell, protocol.cell)
        origin = (area.x_min, area.y_min)
        super().__init__(store, (0, 0), area, protocol, evidence or Evidence(), origin, math.nan)
        self._bounded = bounds is not None
        self.volume: Volume | None = None if protocol.space is None else _volume(protocol)
        """The map in three dimensions, whose view from above this one then is; None under a planar
        protocol, and of a map that was read from a file."""
        self._place: FloatArray | None = None
        """(3,) where the last frame was taken, in space."""
        self._stamp = 0
        self._frame: FrameWindow | None = None
        self._answers: dict[Hashable, Any] = {}

    # ------------------------------------------------------------------------------------ what goes in

    def clear_launch(self, x: float, y: float, z: float | None = None) -> None:
        """Take the ground within the protocol's launch radius for free: traversable, not explored.

        In space it is the water within that radius of the vehicle at height `z`, metres in the world.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"launch: expected a finite position, got ({x}, {y})")
        radius = self.protocol.launch_radius
        if self.volume is not None:
            if z is None:
                raise ValueError(f"launch: expected a height, since {self.protocol.name} moves in space")
            self.volume.clear(np.array([x, y, z]), radius)
        low, east, north, inside = self._around(x, y, radius)
        marked = self._store.read("flags", low, inside.shape)
        marked[inside & (np.hypot(east, north) <= radius)] |= flags.CROSSED
        self._write("flags", low, marked)

    def _around(
        self, x: float, y: float, radius: float
    ) -> tuple[tuple[int, int], Float64Array, Float64Array, BoolArray]:
        """The cells of the store up to so far from a position: the first row and column of their box, how far
        east and north of it each middle lies, and which are in the bounds."""
        cell = self.protocol.cell
        (row, col), half = self._global(x, y), math.ceil(radius / cell) + 1
        rows, cols = np.mgrid[row - half : row + half + 1, col - half : col + half + 1]
        east, north = self._origin[0] + (cols + 0.5) * cell - x, self._origin[1] + (rows + 0.5) * cell - y
        inside = np.ones(rows.shape, np.bool_)
        if self._bounded:
            inside = (rows >= 0) & (rows < self.shape[0]) & (cols >= 0) & (cols < self.shape[1])
        return (row - half, col - half), east, north, inside

    def restrict(self, area: Bounds | None) -> None:
        """Only this area has to be seen from now on; None for everything.

        What lies outside counts as observed: nothing is left to look for there. It is mapped as before where
        it is seen, and the vehicle may swim there.

        Raises:
            ValueError: No cell's middle lies in it and in the map's bounds.
        """
        if area is not None and self._bounded:
            row, col, past_row, past_col = cells_within(area, self._origin, self.protocol.cell)
            rows, cols = self.shape
            if min(past_row, rows) <= max(row, 0) or min(past_col, cols) <= max(col, 0):
                raise ValueError(f"area: expected a part of {self.bounds} with a cell in it, got {area}")
        self.area = area
        self._changed()

    def hold(self, leash: Leash | None) -> None:
        """The vehicle may go no farther than a leash reaches from now on; None where nothing holds it."""
        self.leash = leash
        if self.volume is not None:
            self.volume.leash = leash
        self._changed()

    def _write(self, name: str, low: tuple[int, int], cells: npt.NDArray[Any]) -> None:
        self._stamp += 1
        for key in self._store.write(name, low, cells):
            self._store.stamps[self._store.slot_of[key]] = self._stamp
        self._changed()

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

        Rays explore the camera's sector from the blind distance to the protocol's reach (Eq. 7-8), as far as
        they are unblocked and as some return in their direction shows that they ran; a direction without any
        return claims nothing. A cell with a return of its own, which a ray over a low boulder may give, is
        observed, but not explored.

        In space the frame goes into the volume, and depth is float metres, labels integers there.

        Args:
            depth: (H, W) along the optical axis: float metres, NaN for no return, or uint16 millimetres, 0
                for no return. What is outside the protocol's limits is ignored.
            labels: (H, W) integers, values of `Label`, water being no return; or floats, the probability in
                [0, 1] that the pixel shows target, whose seabed is then told by its height.
            camera: Intrinsics of both images.
            T_world_camera: Where the optical frame was.
            confidence: (H, W) float, the probability in [0, 1] that depth and label of a pixel are right: by
                so much it counts, in sixteenths, and not at all where it is 0. All are sure where None. With
                labels of integers only, since probabilities have their own.
            error: (H, W) float, see `Observation.error`; counts in space, where None depths err as the
                protocol says.

        Raises:
            ValueError: The images do not fit the camera, labels are not labels, or the camera is farther away
                than any map reaches.
        """
        depth, labels = np.asarray(depth), np.asarray(labels)
        _check_frame(depth, labels, camera)
        if self.protocol.space is not None:
            self._integrate_in_space(depth, labels, camera, T_world_camera, confidence, error)
            return
        if confidence is not None:
            labels = unsure(labels.astype(np.uint8), _checked_confidence(confidence, labels, camera))
        depth, labels, camera = _thinned(depth, labels, camera)
        if self._frame is None or self._frame.pixels < depth.size:
            self._frame = FrameWindow(self.protocol, self.evidence, depth.size)
        place, farthest = T_world_camera.translation[:2].tolist(), FARTHEST * self.protocol.cell
        if not all(abs(a - b) < farthest for a, b in zip(place, self._origin, strict=True)):
            raise ValueError(
                f"T_world_camera: expected a place within {farthest:g} m of the map's origin, got {place}"
            )
        endless = (-FARTHEST, -FARTHEST, FARTHEST, FARTHEST)
        limits = (0, 0, *self._shape) if self._bounded else endless
        window, origin = self._frame, self._origin
        window.read(self._store, origin, limits, depth, labels, camera, T_world_camera)
        self._datum = window.datum
        self._stamp += 1
        window.commit(self._store, self._stamp)
        self._changed()
        if self.protocol.traversal is not None:
            self._traverse(T_world_camera)

    def _integrate_in_space(
        self,
        depth: npt.NDArray[Any],
        labels: npt.NDArray[Any],
        camera: Camera,
        T_world_camera: SE3,
        confidence: npt.NDArray[Any] | None,
        error: npt.NDArray[Any] | None,
    ) -> None:
        """Add one frame to the volume; the camera sits at the vehicle's centre, which came there straight."""
        if self.volume is None:
            raise ValueError(
                "map: expected one with a volume to add a frame to, got the view from above that a file holds"
            )
        place = T_world_camera.translation
        self.volume.clear_body(place if self._place is None else self._place, place)
        self._place = place.copy()
        self.volume.integrate(depth, labels, camera, T_world_camera, confidence, error)
        if math.isnan(self._datum):
            self._datum = float(place[2]) - self.protocol.altitude
        self._look_from_above(*place.tolist())
        self._changed()  # The volume has, also where nothing of it is seen from above.

    def feel(self, here: npt.ArrayLike, contact: npt.ArrayLike, goal: npt.ArrayLike) -> None:
        """Take for solid what the body touched, in space; see `Volume.feel`."""
        if self.volume is None:
            raise ValueError("map: expected one with a volume to take something solid into, got none")
        self.volume.feel(here, contact, goal)
        self._look_from_above(*np.asarray(here, np.float64).tolist())

    def _look_from_above(self, x: float, y: float, z: float) -> None:
        """Write what the volume shows from above, as far as a frame from there may have changed it."""
        assert self.volume is not None
        from dream.mapping.volume import FREE

        (low, past), width = self._seen_from(x, y), 1 << post_bits(self.protocol)
        if min(b - a for a, b in zip(low, past, strict=True)) <= 0:
            return
        above = self.volume.above(self._window(low, (past[0] - low[0], past[1] - low[1])))
        rows, cols = np.indices(above.solid.shape)
        rows, cols = rows + low[0], cols + low[1]
        rows_in, cols_in = self._shape if self._bounded else (FARTHEST, FARTHEST)
        inside: BoolArray = np.logical_and(rows < rows_in, cols < cols_in)
        known, returned = inside & ~np.isnan(above.ground), inside & ~np.isnan(above.top)
        self._write("log_odds", low, np.where(known, np.where(above.solid, *SURE), 0))
        self._write("votes", low, np.where(returned, np.where(above.target > 0.5, *VOTED), 0))

        cell, (west, south) = self.protocol.cell, self._origin
        east, north = west + (cols.ravel() + 0.5) * cell, south + (rows.ravel() + 0.5) * cell
        level = np.column_stack([east, north, np.full(east.size, z)])
        marked = self._store.read("flags", low, inside.shape) & flags.CROSSED
        for bits, where in (
            (flags.CROSSED, inside & (self.volume.state(level) == FREE).reshape(inside.shape)),
            (flags.RETURNED | flags.EXPLORED, inside & above.explored),
            (flags.BARE | flags.SEABED, known & ~above.solid),
        ):
            marked[where] |= bits
        # At another height it may be free there.
        marked[above.solid] &= ~np.uint8(flags.CROSSED)
        self._write("flags", low, marked)

        folded = (known.shape[0] // width, width, known.shape[1] // width, width)
        posts = low[0] // width, low[1] // width
        total = np.where(known, above.ground, 0.0).reshape(folded).sum(axis=(1, 3))
        self._write("ground_sum", posts, total)
        self._write("ground_count", posts, known.reshape(folded).sum(axis=(1, 3)))

    def _seen_from(self, x: float, y: float) -> tuple[tuple[int, int], tuple[int, int]]:
        """First cell and past the last, in whole posts, of what a frame from there may change."""
        from dream.mapping.volume import KEPT, MOUND

        protocol, width = self.protocol, 1 << post_bits(self.protocol)
        row, col = self._global(x, y)
        # What becomes known changes the local ground that far around it.
        half = math.ceil((KEPT * protocol.reach + MOUND) / protocol.cell) + width
        low, past = [], []
        for at, size in zip((row, col), self._shape, strict=True):
            first, last = at - half, at + half
            if self._bounded:
                first, last = max(first, 0), min(last, size)
            low.append(first // width * width)
            past.append(-(-last // width) * width)
        return (low[0], low[1]), (past[0], past[1])

    def _traverse(self, T_world_camera: SE3) -> None:
        """Mark what a frame from there traverses; the camera sits at the vehicle's centre and looks ahead."""
        assert self.protocol.traversal is not None
        (x, y), axis = T_world_camera.translation[:2].tolist(), T_world_camera.rotation[:, 2]
        low, east, north, inside = self._around(x, y, self.protocol.traversal)
        marked = self._store.read(TRAVERSED, low, inside.shape)
        marked[inside & traversed(east, north, math.atan2(axis[1], axis[0]), self.protocol)] = 1
        self._write(TRAVERSED, low, marked)

    def _global(self, x: float, y: float) -> tuple[int, int]:
        """Row and column in the store."""
        cell = self.protocol.cell
        return math.floor((y - self._origin[1]) / cell + EDGE), math.floor(
            (x - self._origin[0]) / cell + EDGE
        )

    def _changed(self) -> None:
        """Forget what was read; an endless map has the blocks that were made since, too."""
        self._layers = {}
        self._answers = {}
        if not self._bounded and len(self._store):
            (row, col), (past_row, past_col) = self._store.first, self._store.past
            self._low = row * BLOCK, col * BLOCK
            self._shape = (past_row - row) * BLOCK, (past_col - col) * BLOCK
            self.bounds = self._window(self._low, self._shape)

    # ---------------------------------------------------------------------------------- what comes out

    def answer(self, question: Hashable, find: Callable[[], T]) -> T:
        """What was found for a question since the map changed, or is found now."""
        if question not in self._answers:
            self._answers[question] = find()
        return cast(T, self._answers[question])

    def over(self, bounds: Bounds) -> Layers:
        """The map over the cells that a box touches, as it is now; inside the map's bounds or not."""
        cell = self.protocol.cell
        low_row, low_col = (
            math.floor((edge - origin) / cell + EDGE)
            for edge, origin in ((bounds.y_min, self._origin[1]), (bounds.x_min, self._origin[0]))
        )
        past_row, past_col = (
            math.ceil((edge - origin) / cell - EDGE)
            for edge, origin in ((bounds.y_max, self._origin[1]), (bounds.x_max, self._origin[0]))
        )
        low = (low_row, low_col)
        window = self._window(low, (past_row - low_row, past_col - low_col))
        layers = Layers(
            self._store, low, window, self.protocol, self.evidence, self._origin, self._datum, self.area
        )
        # Read now, since the store goes on.
        for name in cells_of(self.protocol):
            layers._wide(name)
        layers._layer("ground", layers._smooth_ground)
        return layers

    def areas(self) -> dict[str, float]:
        """Square metres explored, target, solid and of seabed really seen; of what was written alone, however
        far apart that lies."""
        if self._bounded:
            return super().areas()
        used = 1 + len(self._store)
        marks, odds, votes = (self._store.pools[name][1:used] for name in ("flags", "log_odds", "votes"))
        square = self.protocol.cell**2
        return {
            "explored": float(np.count_nonzero(marks & flags.EXPLORED)) * square,
            "target": float(np.count_nonzero((probability_of_votes(self.evidence) > 0.5)[votes])) * square,
            "solid": float(np.count_nonzero(odds > 0)) * square,
            "seabed_seen": float(np.count_nonzero(marks & flags.SEABED)) * square,
        }

    def _window(self, low: tuple[int, int], shape: tuple[int, int]) -> Bounds:
        cell, (x, y) = self.protocol.cell, self._origin
        return Bounds(
            x + low[1] * cell,
            y + low[0] * cell,
            x + (low[1] + shape[1]) * cell,
            y + (low[0] + shape[0]) * cell,
        )

    @property
    def bounded(self) -> bool:
        """Whether there is a survey area, outside of which nothing is ever known."""
        return self._bounded

    @property
    def nbytes(self) -> int:
        """Bytes that the cells take."""
        return self._store.nbytes

    # ----------------------------------------------------------------------------------- copies, files

    def counting(self, unseen: Float32Array, reach: float, below: BoolArray) -> OccupancyMap:
        """The map to a planner to which other cells count as seen or as solid, until this map changes.

        Args:
            unseen: (rows, cols) in the place of `Layers.unseen`; a cell counts as seen where it is 0.
            reach: Metres, in the place of the protocol's.
            below: (rows, cols) solid cells that are none to it: it passes over what stands there.
        """
        other = copy.copy(self)
        other.protocol, other._answers = dataclasses.replace(self.protocol, reach=reach), {}
        margin, (rows, cols) = self._room_radius, self._shape
        flagged, odds = self._wide("flags").copy(), self._wide("log_odds").copy()
        inner = np.s_[margin : margin + rows, margin : margin + cols]
        flagged[inner][below] |= flags.CROSSED | flags.BARE | flags.SEABED
        odds[inner][below] = SURE[1]
        names = ("target", "target_probability", "explored", "to_see", "ground", "distance_to_bounds")
        other._layers = {
            **{name: self._layers[name] for name in names if name in self._layers},
            "seen": unseen == 0.0,
            "unseen": np.array(unseen, np.float32),
            "wide flags": flagged,
            "wide log_odds": odds,
        }
        for layer in other._layers.values():
            layer.flags.writeable = False
        return other

    def copy(self) -> OccupancyMap:
        """A map of its own with the same content."""
        other = OccupancyMap(self.bounds if self._bounded else None, self.protocol, self.evidence)
        other._store = self._store.copy()
        other._stamp, other._datum, other.area = self._stamp, self._datum, self.area
        other._place, other.volume = self._place, None if self.volume is None else self.volume.copy()
        other.hold(self.leash)
        return other

    def save(self, path: str | Path) -> None:
        """Write everything to one .npz file."""
        about = {
            "format": FORMAT,
            "bounds": dataclasses.asdict(self.bounds) if self._bounded else None,
            "area": dataclasses.asdict(self.area) if self.area is not None else None,
            "protocol": dataclasses.asdict(self.protocol),
            "evidence": dataclasses.asdict(self.evidence),
            "stamp": self._stamp,
            "datum": self._datum if math.isfinite(self._datum) else None,
        }
        store, used = self._store, 1 + len(self._store)
        keys = np.array(list(store.slot_of), np.int64).reshape(-1, 2)
        held: dict[str, Any] = {
            name: store.pools[name][1:used] for name in (*cells_of(self.protocol), *POSTS)
        }
        held |= {"about": np.array(json.dumps(about)), "blocks": keys, "stamps": store.stamps[1:used]}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **held)

    @staticmethod
    def load(path: str | Path) -> OccupancyMap:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is damaged, or no map; the message says what was expected and what was found.
        """
        with arrays.opened(Path(path), "a map written by save") as content:
            try:
                return _read(content)
            except (ArithmeticError, MemoryError) as error:  # Of lengths that no map has.
                raise ValueError(f"about: {error}") from error


def _volume(protocol: SurveyProtocol) -> Volume:
    from dream.mapping.volume import Volume

    return Volume(protocol)


class _About(BaseModel):
    """What a file says of its map."""

    model_config = ConfigDict(extra="forbid", strict=True)

    format: Literal["dream-map-2"]
    bounds: Bounds | None
    area: Bounds | None = None
    protocol: SurveyProtocol
    evidence: Evidence
    stamp: Annotated[int, Field(ge=0)]
    datum: Annotated[float, Field(allow_inf_nan=False)] | None


def _read(content: arrays.Npz) -> OccupancyMap:
    names, headers = {"about", "blocks", "stamps", *CELLS, *POSTS}, content.headers
    # Those that are traversed may be missing.
    if set(headers) - {TRAVERSED} != names or len(content.entries) != len(headers):
        raise ValueError(f"expected the arrays {', '.join(sorted(names))}, got others")
    shape, dtype = headers["about"][:2]
    if shape != () or dtype.kind != "U" or dtype.itemsize > MOST_TEXT:
        raise ValueError(f"about: expected a text, got {shape} {dtype}")
    about = _About.model_validate_json(str(content["about"]))
    if (TRAVERSED in headers) != (about.protocol.traversal is not None):
        raise ValueError(f"{TRAVERSED}: expected where the protocol has a traversal, and only there")
    occupancy = OccupancyMap(about.bounds, about.protocol, about.evidence)
    store, count = occupancy._store, headers["blocks"].shape[0] if headers["blocks"].shape else 0
    expected = {name: (dtype, (count, *shape)) for name, (dtype, shape) in store.layers.items()}
    whole = np.dtype(np.int64)
    for name, (dtype, shape) in {
        **expected,
        "blocks": (whole, (count, 2)),
        "stamps": (whole, (count,)),
    }.items():
        if headers[name][:2] != (shape, dtype):
            raise ValueError(f"{name}: expected {shape} {dtype}, got {headers[name][:2]}")
    keys, stamps = content["blocks"], content["stamps"]
    low, past = np.full(2, -FARTHEST // BLOCK), np.full(2, FARTHEST // BLOCK)
    if about.bounds is not None:
        low = np.full(2, -MARGIN_BLOCKS)
        past = np.array([-(-side // BLOCK) + MARGIN_BLOCKS for side in occupancy.shape])
    if len(np.unique(keys, axis=0)) != count or ((keys < low) | (keys >= past)).any():
        raise ValueError("blocks: expected different blocks of the map, got others")
    if ((stamps < 0) | (stamps > about.stamp)).any():
        raise ValueError(f"stamps: expected 0 to {about.stamp}, got others")
    store.make((int(row), int(col)) for row, col in keys)
    for name in expected:
        cells = content[name]
        if not np.isfinite(cells).all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
        store.pools[name][1 : 1 + count] = cells
    store.stamps[1 : 1 + count] = stamps
    occupancy._stamp = about.stamp
    occupancy._datum = math.nan if about.datum is None else about.datum
    occupancy.volume = None  # It has a file of its own.
    occupancy.restrict(about.area)
    return occupancy


def _thinned(
    depth: npt.NDArray[Any], labels: npt.NDArray[Any], camera: Camera
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], Camera]:
    """Images in the types that the kernels know, every n-th row and column of very large ones."""
    n = max(math.ceil(math.sqrt(depth.size / MOST_PIXELS)), math.ceil(max(depth.shape) / MOST_SIDE), 1)
    if n > 1:
        depth, labels = depth[::n, ::n], labels[::n, ::n]
        height, width = depth.shape
        half = 0.5 - 0.5 / n  # A pixel's centre moves to that of the pixels around it.
        camera = Camera(
            width, height, camera.fx / n, camera.fy / n, camera.cx / n + half, camera.cy / n + half
        )
    depth = np.ascontiguousarray(depth, np.uint16 if depth.dtype == np.uint16 else np.float32)
    soft = np.issubdtype(labels.dtype, np.floating)
    return depth, np.ascontiguousarray(labels, np.float32 if soft else np.uint8), camera


def _checked_confidence(
    confidence: npt.NDArray[Any], labels: npt.NDArray[Any], camera: Camera
) -> npt.NDArray[np.float32]:
    confidence = np.asarray(confidence, np.float32)
    camera.check(confidence, "confidence")
    if np.issubdtype(labels.dtype, np.floating):
        raise ValueError("confidence: expected none beside probabilities, which tell it themselves")
    if confidence.size and not (confidence.min() >= 0.0 and confidence.max() <= 1.0):
        raise ValueError("confidence: expected probabilities in [0, 1], got others")
    return confidence


def _check_frame(depth: npt.NDArray[Any], labels: npt.NDArray[Any], camera: Camera) -> None:
    for name, image in (("depth", depth), ("labels", labels)):
        if image.ndim != 2:
            raise ValueError(f"{name}: expected (height, width), got {image.shape}")
        camera.check(image, name)
    if not (np.issubdtype(depth.dtype, np.floating) or depth.dtype == np.uint16):
        raise ValueError(f"depth: expected floating-point metres or uint16 millimetres, got {depth.dtype}")
    if np.issubdtype(labels.dtype, np.floating):
        if labels.size and not (labels.min() >= 0.0 and labels.max() <= 1.0):
            raise ValueError("labels: expected probabilities in [0, 1], got others")
        return
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"labels: expected integers, values of Label, or probabilities, got {labels.dtype}")
    unsigned = np.issubdtype(labels.dtype, np.unsignedinteger)
    if labels.size and (labels.max() > LAST_LABEL or (not unsigned and labels.min() < 0)):
        wrong = labels.max() if labels.max() > LAST_LABEL else labels.min()
        raise ValueError(f"labels: expected values of Label, 0 to {LAST_LABEL}, got {wrong}")
