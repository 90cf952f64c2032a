"""What the rivals share: places to look from, the steps between, and the way to one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.planning.space.lookahead import SpacePlan, way_to
from dream.planning.space.looks import nearest_tilt
from dream.planning.space.remains import LeftToInspect, elements_of
from dream.planning.space.ways import KnownWays, lattice_of
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision, IntArray, Observation

if TYPE_CHECKING:
    from dream.planning._kernels.space_beam import SpaceElements, SpaceLattice

FloatArray = npt.NDArray[np.floating[Any]]

STRIDE = 1.8
"""Metres over ground of a step, taken over a way on the lattice."""
APART = 2
"""Nodes between places to look from."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What is known at one step, as the kernels take it."""

    ways: KnownWays
    left: LeftToInspect
    observation: Observation

    @property
    def protocol(self) -> SurveyProtocol:
        """Of the mission."""
        return self.ways.protocol

    @cached_property
    def elements(self) -> SpaceElements:
        """What is left."""
        return elements_of(self.left, self.protocol)

    @cached_property
    def lattice(self) -> SpaceLattice:
        """Where the body may be."""
        return lattice_of(self.ways)

    @cached_property
    def steps(self) -> npt.NDArray[np.int32]:
        """(levels, rows, cols, headings) from here; −1 where no way is known."""
        return self.ways.steps(self.observation.pose, self.observation.z)

    @cached_property
    def here(self) -> IntArray:
        """(5,) level, row, column, heading and tilt."""
        pose, protocol = self.observation.pose, self.protocol
        tilt = nearest_tilt(protocol, self.observation)
        node = self.ways.node(pose.x, pose.y, self.observation.z)
        return np.array([*node, protocol.heading_index(pose.yaw), tilt])

    def places(self, nearest: float, farthest: float) -> IntArray:
        """(n, 3) nodes on a grid of 1 m to which ways lead, and whose nearest piece is so far, in metres."""
        from scipy.spatial import cKDTree

        nodes = np.argwhere((self.steps >= 0).any(axis=-1))
        nodes = nodes[((nodes + np.array(self.ways.first)) % APART == 0).all(axis=1)]
        at = self.lattice.first + nodes[:, ::-1] * self.lattice.spacing
        away, _ = cKDTree(self.elements.points).query(at, distance_upper_bound=farthest)
        return np.ascontiguousarray(nodes[np.isfinite(away) & (away >= nearest)])

    def reached(self, nodes: IntArray) -> BoolArray:
        """(n, headings · tilts) which looks from nodes (n, 3) ways lead to."""
        return np.repeat(self.steps[tuple(nodes.T)] >= 0, len(self.protocol.tilts), axis=1)

    def shown_by(self, view: IntArray) -> float:
        """Weight that a view (5,) shows."""
        level, row, col, heading, tilt = view.tolist()
        return float(self.left.area[self.left.shown(self.ways, (level, row, col), heading, tilt)].sum())

    def way(self, view: IntArray) -> list[Decision] | None:
        """The moves to a view (5,), the last of which tilts the camera; none where it is here."""
        if np.array_equal(view, self.here):
            return []
        level, row, col, heading, tilt = view.tolist()
        return way_to(self.ways, (level, row, col), heading, tilt, self.observation)

    def steps_to(self, views: IntArray) -> FloatArray:
        """(n,) from here to views (n, 5), at least one; inf where no way is known."""
        steps = self.steps[tuple(views[:, :4].T)].astype(np.float64)
        steps[steps < 0] = np.inf
        return np.asarray(np.maximum(steps, 1.0))

    def absolute(self, views: IntArray) -> IntArray:
        """Views (n, 5) with nodes counted from the world's origin, which the box of ways moves against."""
        return np.asarray(views + np.array([*self.ways.first, 0, 0]))

    def relative(self, views: IntArray) -> IntArray:
        """The reverse."""
        return np.asarray(views - np.array([*self.ways.first, 0, 0]))

    def plan(self, step: Decision, view: IntArray, steps: int, rate: float, why: str) -> SpacePlan:
        """A step to a view (5,) so many steps away, of a plan with a rate; and why."""
        level, row, col, heading, tilt = view.tolist()
        return SpacePlan(step, rate, max(steps, 1), (level, row, col), heading, tilt, why)


def travel(starts: IntArray, ends: IntArray, protocol: SurveyProtocol) -> FloatArray:
    """(n, m) steps from views (n, 5) to views (m, 5), were all water free.

    The vehicle advances where it looks: it turns to set off, which a move does on its way where it turns so
    far at all, and turns again at the end.
    """
    between = (ends[None, :, :3] - starts[:, None, :3]) * protocol.lattice
    over, climb = np.hypot(between[..., 1], between[..., 2]), np.abs(between[..., 0])
    bearing = np.arctan2(between[..., 1], between[..., 2])
    along = np.rint(bearing / protocol.heading_step).astype(np.int64)
    turns = _turns(protocol)
    here, there = starts[:, None, 3], ends[None, :, 3]
    setting_off = np.maximum(turns[(along - here) % protocol.headings] - 1, 0)
    moved = over > 0.0
    turned = np.where(
        moved, turns[(there - along) % protocol.headings], turns[(there - here) % protocol.headings]
    )
    way = np.maximum(np.where(moved, over / STRIDE + setting_off, 0.0), climb / max(protocol.climbs))
    # On the spot turn and climb are one move.
    steps = np.where(moved, way + turned, np.maximum(way, turned))
    return np.asarray(np.maximum(steps, starts[:, None, 4] != ends[None, :, 4]), np.float64)


def _turns(protocol: SurveyProtocol) -> IntArray:
    """(headings,) moves that turn by so many headings to the left."""
    steps = np.full(protocol.headings, protocol.headings)
    steps[0] = 0
    for count in range(1, protocol.headings):
        before = np.flatnonzero(steps == count - 1)
        after = (before[:, None] + np.array(protocol.turns)).ravel() % protocol.headings
        steps[after] = np.minimum(steps[after], count)
    return steps


def rate_of(gains: FloatArray, steps: FloatArray) -> float:
    """Square metres a step of the part of a tour that yields most: its looks' gains, and steps to each."""
    return float((np.cumsum(gains) / np.maximum(np.cumsum(steps), 1.0)).max(initial=0.0))


def views_of(nodes: IntArray, looks: IntArray, tilts: int) -> IntArray:
    """(n, 5) views from nodes (n, 3) and the looks (n,) there, heading · tilts + tilt."""
    return np.column_stack([nodes, looks // tilts, looks % tilts])
