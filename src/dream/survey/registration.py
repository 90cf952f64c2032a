"""Where a later survey lies on an earlier one of the same ground."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import cKDTree

from dream.geometry import SE2
from dream.mapping.alignment import Matching
from dream.survey import globe
from dream.survey.survey import Layers, Survey

Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

SAME_PLACE = 5000.0
"""Metres that the origins of two runs at one site may be apart."""
FEWEST = 10
"""Individuals that must lie on each other at least."""
DENSITY = 0.2
"""Metres: cells of the densities that are held against each other; of far ones they grow."""
MOST_CELLS = 1024
"""Along a side of a density."""
FARTHEST = 200.0
"""Metres from the middle of the individuals that are held against each other."""
TURN = math.radians(1.0)
"""Between turns."""
BEST = 8
"""Turns of which the individuals are tried."""
_EIGHTHS = np.arange(8) * (math.pi / 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Where the world of a later survey (b) is in that of an earlier one (a)."""

    T_a_b: SE2
    """Metres and radians."""
    pivot: tuple[float, float]
    """Middle of the later survey in the earlier one's world: what the covariance is about."""
    covariance: Float64Array
    """(3, 3) of east, north and turn about the pivot, metres and radians."""
    moved: SE2
    """By how much it differs from what sites and poses said, at the pivot."""
    by: str
    """`individuals`, `map`, or `poses` where neither showed where it lies."""
    pairs: int
    """Individuals of both that lie on each other."""
    residual: float
    """Metres between them, root mean square along an axis; 0 where there are none."""
    note: str = ""
    """What is to be known of it."""

    @property
    def sigma(self) -> float:
        """Metres, standard error of a place near the pivot, along its worse direction."""
        return math.sqrt(max(0.0, float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1])))

    def place(self, points: Float64Array) -> Float64Array:
        """(n, 2) places of the later survey, in the earlier one's world."""
        return placed(self.T_a_b, points)

    def back(self, points: Float64Array) -> Float64Array:
        """(n, 2) places of the earlier survey's world, in the later one's."""
        T = self.T_a_b
        return placed(SE2(0.0, 0.0, -T.yaw), points - (T.x, T.y))


@dataclass(frozen=True, slots=True)
class Registering:
    """Lays a later survey on an earlier one.

    What it does: the densities of individuals are correlated over a window of shifts and turns. From where
    they are most alike each pair of near ones pulls, less the farther it is, while the reach is drawn in. The
    fit holds where many more lie on each other than with one of them shifted aside. An origin may be off by
    more than the window, so that a wider one is tried, too; there chance offers more. The covariance comes
    from the residuals in squares of ground, because neighbours err alike. Where individuals do not tell, the
    maps of target and relief are matched over the window.

    Reference: iterative closest points with an annealed Gaussian reach, after Granger and Pennec, EM-ICP,
    ECCV 2002; the sandwich covariance by clusters of Liang and Zeger, Biometrika 73 (1986).

    Assumes: both surveys are rigid up to some centimetres; their frames are off by less than the wide window,
    or the window where there are few individuals.
    Fails when: little of what there was is still there, or there was nothing but an even crust; it then
    says so and takes the poses.
    """

    window: float = 1.5
    """Metres by which the frames may be off."""
    turn: float = math.radians(4.0)
    """Radians."""
    wide: float = 12.0
    """Metres by which origins may be off, as read off a map or a receiver held over the side."""
    wide_turn: float = math.radians(15.0)
    """Radians, as of a compass beside steel."""
    reaches: tuple[float, ...] = (0.3, 0.2, 0.14, 0.1, 0.07, 0.07, 0.05, 0.05)
    """Metres: standard deviations of the pull, one a round."""
    block: float = 2.0
    """Metres: side of the squares whose individuals err alike."""
    sure: float = 5.0
    """Standard deviations by which more pairs must lie on each other than by chance."""
    sure_wide: float = 8.0
    """The same over the wide window, in which there is more chance."""
    lost: float = 0.3
    """Metres, standard error of poses that nothing has shown to be right, at the least."""

    def register(self, a: Survey, b: Survey) -> Registration:
        """Where b lies on a.

        Raises:
            ValueError: They are of different sites.
        """
        start, note = frames(a, b)
        there = placed(start, b.individuals.position[:, :2])
        pivot = _pivot(a, b, start)
        ours = a.individuals.position[:, :2]
        fits = (
            self._individuals(ours, there, pivot, self.window, self.turn, self.sure),
            self._individuals(ours, there, pivot, self.wide, self.wide_turn, self.sure_wide),
        )
        # Within the window some may lie on each other where all do beyond it.
        fitted = max(filter(None, fits), key=lambda fit: fit[2], default=None)
        if fitted is None:
            offset, covariance, by = self._maps(a, b, start, pivot)
            pairs, residual = 0, 0.0
        else:
            offset, covariance, pairs, residual = fitted
            by = "individuals"
            apart, turned = math.hypot(offset.x, offset.y), abs(offset.yaw)
            if apart > self.window or turned > self.turn:
                off = (
                    f"Origins and headings of the two runs disagree by {apart:.1f} m and "
                    f"{math.degrees(turned):.0f}°: so their individuals lie on each other. Which of the two "
                    "is off they do not show."
                )
                note = " ".join(filter(None, (note, off)))
        if by == "poses":
            lost = max(
                self.lost, *(float(np.mean(s.track.sigma)) if len(s.track.sigma) else 0.0 for s in (a, b))
            )
            covariance = np.diag([lost**2, lost**2, (lost / 10.0) ** 2])
            few = min(len(ours), len(there)) < FEWEST
            window, turn = (self.window, self.turn) if few else (self.wide, self.wide_turn)
            nothing = (
                f"Nothing in both showed how they lie on each other, within {window:g} m and "
                f"{math.degrees(turn):g}°; the poses are taken. Either little of what there was is "
                "still there, or an origin is farther off: check the origins."
            )
            note = " ".join(filter(None, (note, nothing)))
        return Registration(_onto(start, pivot, offset), pivot, covariance, offset, by, pairs, residual, note)

    def _maps(
        self, a: Survey, b: Survey, start: SE2, pivot: tuple[float, float]
    ) -> tuple[SE2, Float64Array, str]:
        cell = max(a.layers.cell, b.layers.cell)
        matching = Matching(
            window=self.window,
            turn=self.turn,
            step=cell,
            turn_step=math.radians(1.0),
            cell=cell,
            # A cell of the map is one witness, not the many pixels that are behind it.
            trust=0.25,
        )
        ours, theirs = _ground(a.layers, None), _ground(b.layers, start)
        if not (ours[:, 2].any() and theirs[:, 2].any()):
            return SE2(0.0, 0.0, 0.0), np.zeros((3, 3)), "poses"
        found = matching.align(theirs, pivot, ours)
        if found is None or np.linalg.matrix_rank(found.information) < 3:
            return SE2(0.0, 0.0, 0.0), np.zeros((3, 3)), "poses"
        # Both maps are drawn to a cell: less than a share of it is not known from them.
        floor = np.diag([(0.3 * cell) ** 2, (0.3 * cell) ** 2, math.radians(0.3) ** 2])
        covariance: Float64Array = np.asarray(np.linalg.inv(found.information) + floor, np.float64)
        return found.offset, covariance, "map"

    def _individuals(
        self,
        ours: Float64Array,
        theirs: Float64Array,
        pivot: tuple[float, float],
        window: float,
        turn: float,
        sure: float,
    ) -> tuple[SE2, Float64Array, int, float] | None:
        if min(len(ours), len(theirs)) < FEWEST:
            return None
        tree, starts = cKDTree(ours), _alike(ours, theirs, pivot, window, turn)
        best = max((self._drawn_in(tree, theirs, pivot, start) for start in starts), key=lambda one: one[1])
        offset = best[0]
        at_best = _moved(theirs, pivot, offset)
        pairs = mutual(tree, at_best, 3.0 * self.reaches[-1])
        # As many lie on each other by chance as with one of them shifted aside.
        around = 0.8 * np.column_stack([np.cos(_EIGHTHS), np.sin(_EIGHTHS)])
        aside = [len(mutual(tree, at_best + shift, 3.0 * self.reaches[-1])) for shift in around]
        chance = float(np.mean(aside))
        if len(pairs) < FEWEST or len(pairs) - chance < sure * math.sqrt(chance + 1.0):
            return None
        residual = ours[pairs[:, 0]] - at_best[pairs[:, 1]]
        covariance = self._covariance(at_best[pairs[:, 1]] - pivot, residual)
        return offset, covariance, len(pairs), float(np.sqrt((residual**2).mean()))

    def _drawn_in(
        self, tree: cKDTree, theirs: Float64Array, pivot: tuple[float, float], start: SE2
    ) -> tuple[SE2, int]:
        offset = start
        for reach in self.reaches:
            at = _moved(theirs, pivot, offset)
            distance, near = _nearest(tree, at, min(6, tree.n), 3.0 * reach)
            who, which = np.nonzero(np.isfinite(distance))
            if len(who) < 6:
                return offset, 0
            pull = np.exp(-0.5 * (distance[who, which] / reach) ** 2)
            # One that has many neighbours is pulled once all the same; e^-2 stands for what is not there.
            pull /= np.bincount(who, pull, len(at))[who] + math.exp(-2.0)
            step = _rigid(at[who] - pivot, tree.data[near[who, which]] - pivot, pull)
            offset = SE2(offset.x + step.x, offset.y + step.y, offset.yaw + step.yaw)
            strayed = math.hypot(offset.x - start.x, offset.y - start.y)
            if abs(offset.yaw - start.yaw) > 2.0 * self.turn or strayed > 3.0 * self.window:
                return offset, 0
        return offset, len(mutual(tree, _moved(theirs, pivot, offset), 2.0 * self.reaches[-1]))

    def _covariance(self, place: Float64Array, residual: Float64Array) -> Float64Array:
        jacobian = np.zeros((len(place), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -place[:, 1], place[:, 0]
        information = np.einsum("nij,nik->jk", jacobian, jacobian)
        _, block = np.unique(np.floor(place / self.block), axis=0, return_inverse=True)
        count = int(block.max()) + 1
        pulls = np.zeros((count, 3))
        np.add.at(pulls, block.ravel(), np.einsum("nij,ni->nj", jacobian, residual))
        bread = np.linalg.inv(information + 1e-9 * np.eye(3))
        correction = count / max(1.0, count - 3.0)
        spread = correction * np.einsum("ni,nj->ij", pulls, pulls)
        # Few squares say little of how they differ: as if all erred on their own, at the least.
        alone = float((residual**2).mean()) * information
        return np.asarray(bread @ (spread + alone) @ bread)


def _alike(
    ours: Float64Array, theirs: Float64Array, pivot: tuple[float, float], window: float, turn: float
) -> list[SE2]:
    """Where the densities of individuals correlate best within a window, for each of the best turns."""
    # What is far from all others, or beyond the window, tells nothing and would widen the grid.
    reach = min(float(np.quantile(np.abs(theirs - pivot).max(axis=1), 0.98)), FARTHEST)
    cell = max(DENSITY, 2.0 * (reach + window) / MOST_CELLS)
    half = math.ceil((reach + window) / cell)
    edges = np.asarray(np.arange(-half, half + 1) * cell, np.float64)
    fixed = np.fft.rfft2(_density(ours - pivot, edges))

    def best(turns: Iterable[float]) -> list[tuple[float, SE2]]:
        found = []
        far = math.ceil(window / cell)
        for yaw in turns:
            there = _density(_moved(theirs, pivot, SE2(0.0, 0.0, yaw)) - pivot, edges)
            alike = np.fft.irfft2(fixed * np.conj(np.fft.rfft2(there)), s=there.shape)
            alike = np.roll(alike, (far, far), axis=(0, 1))[: 2 * far + 1, : 2 * far + 1]
            east, north = np.unravel_index(int(alike.argmax()), alike.shape)
            found.append((float(alike.max()), SE2((east - far) * cell, (north - far) * cell, yaw)))
        return sorted(found, key=lambda one: -one[0])

    steps = math.ceil(turn / TURN)
    coarse = best((TURN * np.arange(-steps, steps + 1)).tolist())
    # Between two turns the ends of a long reef move by more than individuals are looked for at first.
    finer = math.ceil(TURN * reach / DENSITY)
    if finer > 1:
        parts = TURN * np.arange(-finer + 1, finer) / finer
        coarse += best(coarse[0][1].yaw + parts) + best(coarse[1][1].yaw + parts)
        coarse.sort(key=lambda one: -one[0])
    return [start for _, start in coarse[:BEST]]


def _density(points: Float64Array, edges: Float64Array) -> Float64Array:
    number, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=(edges, edges))
    smooth: Float64Array = ndimage.gaussian_filter(number, 1.0)
    return smooth


def frames(a: Survey, b: Survey) -> tuple[SE2, str]:
    """`T_a_b` by the origins of their sites, and what is to be known of it.

    Raises:
        ValueError: They are of different sites, or one of them is of none.
    """
    if a.site is None and b.site is None:
        return SE2(0.0, 0.0, 0.0), "Neither run had an origin: their frames are taken for the same."
    if a.site is None or b.site is None:
        without = a if a.site is None else b
        raise ValueError(
            f"compare: expected two surveys of one site, got {without.name}, a run without origin. Name its "
            "site with --site FILE"
        )
    if not a.site.is_called(b.site.name):
        raise ValueError(
            f"compare: expected two surveys of one site, got {a.site.name!r} ({a.name}) and {b.site.name!r} "
            f"({b.name})"
        )
    T_a_b = globe.between(a.site, b.site)
    apart = math.hypot(T_a_b.x, T_a_b.y)
    if apart > SAME_PLACE:
        raise ValueError(
            f"compare: expected two surveys of one site, got origins {apart / 1000.0:.1f} km apart. Is one "
            "of the two site files wrong?"
        )
    return T_a_b, ""


def placed(T_a_b: SE2, points: Float64Array) -> Float64Array:
    """(n, 2) points in frame a."""
    return _moved(points, (0.0, 0.0), T_a_b)


def mutual(tree: cKDTree, points: Float64Array, reach: float) -> IntArray:
    """(n, 2) pairs of indices, into the tree and into the points: each point with its nearest.

    Of several with the same nearest the one that lies nearest has it, so that each is in one pair at most.
    """
    distance, near = (found[:, 0] for found in _nearest(tree, points, 1, reach))
    there = np.flatnonzero(np.isfinite(distance))
    order = there[np.argsort(distance[there], kind="stable")]
    # The nearest of those that share a neighbour has it.
    _, first = np.unique(near[order], return_index=True)
    kept = order[first]
    return np.column_stack([near[kept], kept])


def _nearest(tree: cKDTree, points: Float64Array, count: int, reach: float) -> tuple[Float64Array, IntArray]:
    """(n, count) distances and indices; infinite where there is none within reach."""
    distance, near = tree.query(points, k=list(range(1, count + 1)), distance_upper_bound=reach)
    return np.asarray(distance, np.float64), np.asarray(near, np.intp)


def _ground(layers: Layers, T: SE2 | None) -> Float64Array:
    """(n, 4) known cells as ground points: place, share of target, height above the bare seabed."""
    rows, cols = np.nonzero(layers.state > 0)
    x = layers.bounds.x_min + (cols + 0.5) * layers.cell
    y = layers.bounds.y_min + (rows + 0.5) * layers.cell
    place = np.column_stack([x, y])
    target = np.isin(layers.state[rows, cols], (2, 4)).astype(np.float64)
    height = np.nan_to_num(layers.relief[rows, cols].astype(np.float64))
    return np.column_stack([place if T is None else placed(T, place), target, height])


def _pivot(a: Survey, b: Survey, start: SE2) -> tuple[float, float]:
    """The middle of what is looked for in the later survey, or of its ground, or of the area of one that saw
    nothing."""
    points = b.individuals.position[:, :2]
    if not len(points):
        ground = _ground(b.layers, None)
        points = ground[ground[:, 2] > 0.0, :2] if ground[:, 2].any() else ground[:, :2]
    if not len(points):
        area = b.layers.bounds
        points = np.array([[area.x_min + area.x_max, area.y_min + area.y_max]]) / 2.0
    x, y = placed(start, points).mean(axis=0).tolist()
    return x, y


def _moved(points: Float64Array, pivot: tuple[float, float], offset: SE2) -> Float64Array:
    """Points turned about the pivot, then shifted."""
    c, s = math.cos(offset.yaw), math.sin(offset.yaw)
    x, y = (points - pivot).T
    return np.column_stack([pivot[0] + offset.x + c * x - s * y, pivot[1] + offset.y + s * x + c * y])


def _onto(start: SE2, pivot: tuple[float, float], offset: SE2) -> SE2:
    """First `start`, then the offset about the pivot."""
    x, y = _moved(np.array([[start.x, start.y]]), pivot, offset)[0].tolist()
    return SE2(x, y, math.remainder(start.yaw + offset.yaw, math.tau))


def _rigid(of: Float64Array, to: Float64Array, weight: Float64Array) -> SE2:
    """The turn about 0 and then the shift that bring points nearest to others, by weighted squares."""
    total = weight.sum()
    p, q = weight @ of / total, weight @ to / total
    u, v = of - p, to - q
    yaw = math.atan2(
        float(weight @ (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])), float(weight @ (u * v).sum(axis=1))
    )
    c, s = math.cos(yaw), math.sin(yaw)
    return SE2(float(q[0] - c * p[0] + s * p[1]), float(q[1] - s * p[0] - c * p[1]), yaw)
