"""The search for what stands up: what is glimpsed of it from far off, and where nothing was glimpsed yet."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.planning.space.looks import nearest_tilt
from dream.planning.space.ways import KnownWays
from dream.types import BoolArray, Decision, IntArray, Label, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping.volume import Surface

FloatArray = npt.NDArray[np.floating[Any]]

COLUMN = 1.0
"""Metres a side of the columns that are told apart."""
EVERY = 4
"""Pixels apart, along each side of the image, that are looked at."""
STANDS = 1.0
"""Metres above the ground at the start from which on a return stands up."""
WIDE = 4.0
"""Metres that something is wide at least to be gone to whatever its label says: no boulder is."""
PIXELS = 4
"""That a column takes to count as glimpsed to stand."""
JOINED = 2
"""Columns apart that parts of one thing may be."""
FAR = 0.8
"""Share of the greatest depth up to which a look is counted on."""
TRIES = 2
"""Looks that should have brought a column into view and did not, after which it is not looked for."""
ENOUGH = 0.04
"""Share of the area that may be left unglimpsed."""
LEAST = 6.0
"""Square metres a step that a search has to bring into view."""


@dataclass(slots=True)
class FarSearch:
    """Goes to what stands up far off, else to where most of the area comes into view for the first time.

    What it does: the volume keeps what is within 1.5 times the reach. Beyond, the depth of each frame tells
    which columns of the area something returned from, and whether that stood up.

    Assumes: ground that is level to a metre. Fails when: a structure is narrow and its label is not told.
    """

    mission: Mission
    glimpsed: BoolArray = field(init=False)
    """(rows, cols) columns that something returned from, from however far."""
    standing: IntArray = field(init=False)
    """(2, rows, cols) pixels that stood up there, and those of them that were told to be target."""
    tried: IntArray = field(init=False)
    """(rows, cols) looks that columns were in, seen or not."""
    given_up: BoolArray = field(init=False)
    """(rows, cols) columns that it came near to and found no structure at."""
    to_see: BoolArray = field(init=False)
    """(rows, cols) columns of the area that has to be seen."""
    middles: FloatArray = field(init=False)
    """(rows, cols, 2) world x and y of the middle of each."""
    ground: float | None = None
    """World z of the ground."""

    def __post_init__(self) -> None:
        bounds = self.mission.bounds
        shape = math.ceil(bounds.depth / COLUMN), math.ceil(bounds.width / COLUMN)
        self.glimpsed = np.zeros(shape, np.bool_)
        self.standing = np.zeros((2, *shape), np.int64)
        self.given_up = np.zeros(shape, np.bool_)
        self.tried = np.zeros(shape, np.int64)
        rows, cols = np.indices(shape)
        self.middles = np.stack(
            [bounds.x_min + (cols + 0.5) * COLUMN, bounds.y_min + (rows + 0.5) * COLUMN], axis=-1
        )
        self.to_see = self.mission.to_see.covers(*np.moveaxis(self.middles, -1, 0))

    def take(self, observation: Observation, surface: Surface) -> None:
        """Add a frame; what the volume knows from within reach is not far off any more."""
        protocol = self.mission.protocol
        if self.ground is None:
            # A later leg begins at whatever height the one before ended.
            heights = surface.middles[surface.seen, 2]
            low = observation.z - protocol.altitude
            self.ground = float(np.percentile(heights, 10)) if len(heights) else low
        camera, depth = observation.camera, observation.depth[::EVERY, ::EVERY]
        rows, cols = np.nonzero(np.isfinite(depth) & (depth <= protocol.returns[1]))
        z = depth[rows, cols].astype(np.float64)
        label = observation.labels[::EVERY, ::EVERY][rows, cols]
        image = np.stack(
            [
                (cols * EVERY + 0.5 - camera.cx) / camera.fx * z,
                (rows * EVERY + 0.5 - camera.cy) / camera.fy * z,
                z,
            ]
        )
        T = observation.T_world_camera
        x, y, up = T.rotation @ image + np.asarray(T.translation)[:, None]
        at, inside = self._columns(x, y)
        at, stands, label = at[:, inside], up[inside] > self.ground + STANDS, label[inside]
        self.glimpsed[at[0], at[1]] = True
        self.tried += self._in_view(observation)
        np.add.at(self.standing[0], tuple(at[:, stands]), 1)
        np.add.at(self.standing[1], tuple(at[:, stands & (label == Label.TARGET)]), 1)
        at, inside = self._columns(*surface.middles[surface.seen, :2].T)
        self.given_up[tuple(at[:, inside])] = True

    def errand(self, ways: KnownWays, observation: Observation) -> tuple[Decision | None, str]:
        """The next move to what stands up far off, or to a look at what was never in view; and why."""
        goal = self._structure()
        if goal is not None:
            move = self._near(ways, goal, observation)
            if move is not None:
                return move, f"Something that stands up was glimpsed at ({goal[0]:.0f}, {goal[1]:.0f})."
            self._forget(goal)
        return self._look(ways, observation), "No structure is known yet: a look at ground never in view."

    # ------------------------------------------------------------------------------------------------------

    def _columns(self, x: FloatArray, y: FloatArray) -> tuple[IntArray, BoolArray]:
        bounds = self.mission.bounds
        at = np.floor(np.stack([y - bounds.y_min, x - bounds.x_min]) / COLUMN).astype(np.int64)
        rows, cols = self.glimpsed.shape
        return at, (at[0] >= 0) & (at[0] < rows) & (at[1] >= 0) & (at[1] < cols)

    def _in_view(self, observation: Observation) -> BoolArray:
        """(rows, cols) columns that a look should show, were nothing in between."""
        pose, protocol = observation.pose, self.mission.protocol
        dx, dy = np.moveaxis(self.middles - [pose.x, pose.y], -1, 0)
        apart = np.abs((np.arctan2(dy, dx) - pose.yaw + np.pi) % (2.0 * np.pi) - np.pi)
        near = np.hypot(dx, dy) <= FAR * protocol.max_depth
        return np.asarray(near & (apart <= 0.5 * protocol.camera.horizontal_fov))

    def _structure(self) -> FloatArray | None:
        """(2,) the place of the largest thing that stands up far off; None where there is none."""
        from scipy.ndimage import binary_dilation, label

        far = (self.standing[0] >= PIXELS) & ~self.given_up & self.to_see
        if not far.any():
            return None
        parts, count = label(binary_dilation(far, np.ones((3, 3), np.bool_), JOINED - 1), np.ones((3, 3)))
        best, most = None, 0
        for number in range(1, count + 1):
            at = np.argwhere(far & (parts == number))
            pixels, target = self.standing[:, at[:, 0], at[:, 1]].sum(axis=1)
            wide = COLUMN * float((np.ptp(at, axis=0) + 1).max())
            if (wide >= WIDE or 2 * target > pixels) and pixels > most:
                best, most = at, int(pixels)
        if best is None:
            return None
        places = self.middles[tuple(best.T)]
        # One of its own columns: of a ring the middle is none, and would never be given up.
        return np.asarray(places[np.hypot(*(places - places.mean(axis=0)).T).argmin()])

    def _forget(self, place: FloatArray) -> None:
        """Hope for nothing more around a place (2,)."""
        self.given_up |= np.hypot(*np.moveaxis(self.middles - place, -1, 0)) <= WIDE

    def _near(self, ways: KnownWays, goal: FloatArray, observation: Observation) -> Decision | None:
        """A move towards where known water comes nearest to a place, if that is nearer than here."""
        away = np.hypot(ways.positions[..., 0] - goal[0], ways.positions[..., 1] - goal[1])
        pose = observation.pose
        reached = (ways.steps(pose, observation.z) >= 0).any(axis=-1)
        nearest = float(away[reached].min())
        if nearest > math.hypot(goal[0] - pose.x, goal[1] - pose.y) - 0.5:
            return None
        bearing = math.atan2(goal[1] - pose.y, goal[0] - pose.x)
        angles = np.arange(ways.protocol.headings) * ways.protocol.heading_step
        facing = np.cos(angles - bearing) >= math.cos(1.01 * ways.protocol.heading_step)
        path = ways.to(pose, observation.z, reached & (away <= nearest + 1.0), facing)
        return self._first(path, observation)

    def _look(self, ways: KnownWays, observation: Observation) -> Decision | None:
        """A move to the look that brings most ground into view for the first time for its steps."""
        unseen = np.argwhere(~self.glimpsed & (self.tried < TRIES) & self.to_see)
        if len(unseen) <= ENOUGH * np.count_nonzero(self.to_see):
            return None
        places = self.middles[tuple(unseen.T)]
        protocol = self.mission.protocol
        steps = ways.steps(observation.pose, observation.z)
        over = steps.max(axis=(0, 3))
        soonest = np.where(steps >= 0, steps, np.iinfo(np.int32).max).min(axis=0)
        rows, cols = np.nonzero(over >= 0)
        coarse = (rows % 4 == 0) & (cols % 4 == 0)
        at = np.column_stack([rows[coarse], cols[coarse]])
        pose = observation.pose
        here = np.array(ways.node(pose.x, pose.y, observation.z)[1:])
        at = np.concatenate([here[None], at])
        x, y = ways.positions[0, at[:, 0], at[:, 1], :2].T
        dx, dy = places[:, 0] - x[:, None], places[:, 1] - y[:, None]
        within = np.hypot(dx, dy) <= FAR * protocol.max_depth
        bearing = np.arctan2(dy, dx)
        half = 0.5 * protocol.camera.horizontal_fov
        best, goal = LEAST, None
        for heading in range(protocol.headings):
            apart = np.abs((bearing - heading * protocol.heading_step + np.pi) % (2.0 * np.pi) - np.pi)
            count = (within & (apart <= half)).sum(axis=1) * COLUMN**2
            if heading == protocol.heading_index(pose.yaw):
                # The look that was just taken.
                count = np.where((at == here).all(axis=1), 0.0, count)
            there = np.maximum(soonest[at[:, 0], at[:, 1], heading], 1).astype(np.float64)
            rates = np.round(count / there, 6)
            k = int(rates.argmax())
            if rates[k] > best:
                best, goal = float(rates[k]), (at[k], heading)
        if goal is None:
            return None
        (row, col), heading = goal
        place = np.zeros(ways.shape, np.bool_)
        place[:, row, col] = True
        path = ways.to(pose, observation.z, place, np.arange(protocol.headings) == heading)
        return self._first(path, observation)

    def _first(self, path: list[Decision] | None, observation: Observation) -> Decision | None:
        if not path:
            return None
        protocol = self.mission.protocol
        is_ahead = protocol.tilts[nearest_tilt(protocol, observation)] == protocol.camera_pitch
        return replace(path[0], tilt=None if is_ahead else protocol.camera_pitch)
