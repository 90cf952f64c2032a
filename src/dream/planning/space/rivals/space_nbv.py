"""The best branch of a tree of poses, and places kept from earlier trees."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dream.options import First
from dream.planning.parameters import check_count, check_range
from dream.planning.space.lookahead import SpacePlan
from dream.planning.space.looks import optics_of
from dream.planning.space.remains import LeftToInspect
from dream.planning.space.rivals.inspection import FloatArray, Scene
from dream.planning.space.ways import KnownWays
from dream.types import IntArray, Mission, Observation

if TYPE_CHECKING:
    from dream.planning._kernels.space_cover import SpaceTree
    from dream.planning.space.belief import SpaceBelief

AROUND = 6.0
"""Metres from the vehicle within which the tree is sampled, in each axis."""
TURNING = 1.0
"""Nodes that a heading step counts as, between a sample and a pose."""
GONE = 0.5
"""Share of what a kept place was to show that must be left for it to be flown to still."""
CUBE = 2
"""Nodes along a cube of which one place is kept."""


@dataclass(frozen=True, slots=True)
class SpaceNextBestView:
    """Grow a random tree of poses through known water, and take the first move of its best branch.

    What it does: grows a rapidly exploring random tree from here, each edge one real move, each pose with
    the tilt that shows most. A branch scores gain · exp(−`decay` · moves), summed over its poses; what one
    pose shows the later ones do not count. The first edge of the best branch is flown, and its rest begins
    the next tree. Places that showed `least` are kept; where the tree yields less a step, the kept place with
    the best gain · exp(−`decay` · steps) is flown to. Everything else is as in `belief`.

    Reference: a re-implementation of AEP (Selin et al., RA-L 2019) under this protocol, with the receding
    horizon of NBVP (Bircher et al., ICRA 2016). There gains are volumes, kept gains are interpolated by a
    Gaussian process, and what poses of a branch show twice counts twice.

    Assumes: what is left shows from near where it has been. Fails when: what is left is far, and shows only
    from places that no tree came near to.
    """

    spatial: ClassVar[bool] = True
    planar: ClassVar[bool] = False

    samples: First[int] = 600
    """Poses that are drawn for a tree."""
    decay: First[float] = 0.2
    """Of a gain with each move."""
    deepest: First[int] = 8
    """Moves of a branch at most."""
    least: First[float] = 0.5
    """Square metres a step below which kept places are flown to, and that a place shows that is kept."""

    def __post_init__(self) -> None:
        check_count("samples", self.samples, 1, 100_000)
        check_range("decay", self.decay, 0.0, 10.0)
        check_count("deepest", self.deepest, 1, 100)
        check_range("least", self.least, 0.01, 100.0)

    def begin(self, mission: Mission) -> SpaceBelief:
        """A fresh pilot."""
        from dream.planning.belief import Belief

        return Belief().in_space(mission, SpaceNextBestViewChooser(self))


@dataclass(slots=True)
class SpaceNextBestViewChooser:
    """`SpaceNextBestView` during one mission."""

    planner: SpaceNextBestView
    rng: np.random.Generator = field(init=False)
    """Of the samples; all missions begin alike."""
    branch: IntArray = field(init=False)
    """(n, 5) what is left of the best branch, nodes counted from the world's origin."""
    kept: dict[tuple[int, ...], IntArray] = field(default_factory=dict)
    """Places that showed something, one for each cube: level, row and column from the world's origin."""
    going: tuple[IntArray, float] | None = None
    """A view (5,) from a kept place that is flown to, likewise, and what it was to show."""

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.branch = np.empty((0, 5), np.int64)

    def plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """The next move, and the square metres a step that its branch shows; None where none shows any."""
        if not len(left):
            return None
        scene = Scene(ways, left, observation)
        tree = self._tree(scene)
        best = int(tree.score.round(6).argmax())
        path = _branch(tree, best)
        rate = float((np.cumsum(tree.gain[path]) / np.arange(1, len(path) + 1)).max(initial=0.0))
        self._keep(tree, scene)
        if rate < self.planner.least:
            kept = self._kept(scene, rate)
            if kept is not None:
                self.branch = self.branch[:0]
                return kept
        self.going = None
        if not len(path):
            self.branch = self.branch[:0]
            return None
        views = np.column_stack([tree.node, tree.heading, tree.tilt])[path]
        self.branch = scene.absolute(views[1:])
        step = scene.way(views[0])
        assert step, "an edge is a move"
        why = f"It begins a branch of {len(path)} moves that shows {tree.gain[path].sum():.1f} m²."
        return scene.plan(step[0], views[0], 1, rate, why)

    def _tree(self, scene: Scene) -> SpaceTree:
        from dream.planning._kernels.space_cover import grow_tree

        protocol, planner = scene.protocol, self.planner
        here = scene.here
        half = np.array([AROUND / protocol.lattice] * 3)
        samples = np.empty((planner.samples, 4))
        samples[:, :3] = here[:3] + self.rng.uniform(-half, half, (planner.samples, 3))
        samples[:, 3] = self.rng.integers(protocol.headings, size=planner.samples)
        begun = scene.relative(self.branch)[:, :4]
        tree: SpaceTree = grow_tree(
            scene.ways.scene,
            optics_of(protocol),
            scene.lattice,
            scene.ways.moves,
            scene.elements,
            here[:3],
            int(here[3]),
            int(here[4]),
            np.ascontiguousarray(begun),
            samples,
            planner.decay,
            TURNING,
            planner.deepest,
        )
        return tree

    def _keep(self, tree: SpaceTree, scene: Scene) -> None:
        """Keep the places of a tree that show something."""
        for n in np.flatnonzero(tree.gain >= self.planner.least).tolist():
            node = tree.node[n] + np.array(scene.ways.first)
            self.kept.setdefault(tuple((node // CUBE).tolist()), node)

    def _kept(self, scene: Scene, rate: float) -> SpacePlan | None:
        """The next move to the best of the places that were kept, if it yields more than a rate."""
        if self.going is not None:
            view, weight = scene.relative(self.going[0][None])[0], self.going[1]
            left = scene.shown_by(view)
            if left < GONE * weight or np.array_equal(view, scene.here):
                self.going = None
        if self.going is None:
            found = self._best_kept(scene)
            if found is None:
                return None
            view, left = found
            self.going = scene.absolute(view[None])[0], left
        path = scene.way(view)
        if not path or left / len(path) <= rate:
            self.going = None
            return None
        why = f"It is the best of {len(self.kept)} places that earlier trees left."
        return scene.plan(path[0], view, len(path), left / len(path), why)

    def _best_kept(self, scene: Scene) -> tuple[IntArray, float] | None:
        """The view (5,) with the best score from the kept places, and what it shows; forgets what is moot."""
        from dream.planning._kernels.space_beam import best_views

        if not self.kept:
            return None
        keys = list(self.kept)
        nodes = np.array([self.kept[key] for key in keys]) - np.array(scene.ways.first)
        weight, heading, tilt = best_views(
            scene.ways.scene, optics_of(scene.protocol), scene.lattice, scene.elements, nodes
        )
        for k in np.flatnonzero(weight < self.planner.least).tolist():
            del self.kept[keys[k]]
        views = np.column_stack([nodes, heading, tilt])
        score: FloatArray = weight * np.exp(-self.planner.decay * scene.steps_to(views))
        score[(views == scene.here).all(axis=1) | (weight < self.planner.least)] = 0.0
        score[~np.isfinite(score)] = 0.0
        best = int(score.round(9).argmax())
        return (
            (views[best], float(weight[best])) if score[best] > 0.0 and math.isfinite(score[best]) else None
        )


def _branch(tree: SpaceTree, best: int) -> list[int]:
    """The poses after the first that lead to one, in order, up to the last that shows anything."""
    path = []
    while tree.parent[best] >= 0:
        path.append(best)
        best = int(tree.parent[best])
    path.reverse()
    shows = np.flatnonzero(tree.gain[path] > 0.0)
    return path[: shows[-1] + 1] if len(shows) else []
