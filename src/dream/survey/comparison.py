"""What changed between two surveys of one site, and how sure that is."""

from __future__ import annotations

import enum
import itertools
import math
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.special import ndtr

from dream.geometry import SE2, Bounds
from dream.survey.registration import Registering, Registration, mutual, placed
from dream.survey.survey import Individuals, Layers, Picture, Survey

Float64Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

_Tested = tuple[float, tuple["Difference", ...], float | None, float]
Verdict = Literal["gain", "loss", "unchanged", "not comparable"]
Z95 = 1.959964
"""Standard deviations to each side of a 95 % interval."""


class Change(enum.IntEnum):
    """What became of a cell of ground."""

    NOT_COMPARABLE = 0
    BARE = 1
    """Bare in both."""
    KEPT = 2
    """Target in both, or at an edge of it that no survey draws the same twice."""
    GAIN = 3
    LOSS = 4


class Fate(enum.IntEnum):
    """What became of an individual."""

    NOT_COMPARABLE = 0
    THERE = 1
    """In both."""
    LOST = 2
    """Only in the earlier survey."""
    NEW = 3
    """Only in the later one."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure before and after, on ground that both saw."""

    name: str
    """`found` (individuals that show in the relief, which are fewer than a survey's `count` says there are),
    `found_density`, `target_area` (cells of the map; the reef of a survey is closed over its gaps, and
    larger), `cover`, `median_size`."""
    before: float
    after: float
    change: float
    low: float
    high: float
    """95 % interval of the change."""
    p: float
    """How often two surveys of ground that has not changed differ by as much."""
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class PatchChange:
    """What became of one patch."""

    before: int | None
    """Index in the earlier survey; None of a patch that is new."""
    after: tuple[int, ...]
    """Indices of those in the later survey that lie on it."""
    rings: tuple[Float64Array, ...]
    """Its outline and holes in the earlier survey's world: as they were, or of the new one."""
    seen: float
    """Share of it that both saw."""
    differences: tuple[Difference, ...]
    p: float | None
    """Of the test for it; None where it is not comparable."""
    q: float | None
    """The same, held against how many patches were tested: the share of false changes among all that are
    called so is at most this."""
    verdict: Verdict


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """An earlier survey (a) and a later one (b), in the earlier one's world."""

    a: Survey
    b: Survey
    registration: Registration
    bounds: Bounds
    cell: float
    change: npt.NDArray[np.uint8]
    """(rows, cols) values of `Change` on the earlier survey's grid."""
    fate_a: npt.NDArray[np.uint8]
    """Of each individual of the earlier survey."""
    fate_b: npt.NDArray[np.uint8]
    """Of each of the later one."""
    positions_b: Float64Array
    """(N, 2) of those in the earlier one's world."""
    patches: tuple[PatchChange, ...]
    differences: tuple[Difference, ...]
    """On all ground that both saw."""
    comparable: float
    """Square metres that both saw."""
    only_a: float
    only_b: float
    """Square metres that only one of them saw."""

    def as_dict(self) -> dict[str, Any]:
        """As `--json` prints it."""
        ground = self.cell**2 * np.bincount(self.change.ravel(), minlength=5)
        laid = self.registration
        return {
            "before": _named(self.a),
            "after": _named(self.b),
            "registration": {
                "x": laid.T_a_b.x,
                "y": laid.T_a_b.y,
                "yaw": laid.T_a_b.yaw,
                "sigma_m": laid.sigma,
                "by": laid.by,
                "pairs": laid.pairs,
                "residual_m": laid.residual,
                "note": laid.note,
            },
            "ground_m2": {
                "comparable": self.comparable,
                "only_before": self.only_a,
                "only_after": self.only_b,
                "gain": float(ground[Change.GAIN]),
                "loss": float(ground[Change.LOSS]),
                "kept": float(ground[Change.KEPT]),
            },
            "individuals": {
                "there": int((self.fate_a == Fate.THERE).sum()),
                "lost": int((self.fate_a == Fate.LOST).sum()),
                "new": int((self.fate_b == Fate.NEW).sum()),
                "not_comparable": int((self.fate_a == 0).sum() + (self.fate_b == 0).sum()),
            },
            "differences": [asdict(one) for one in self.differences],
            "patches": [
                {
                    "before": one.before,
                    "after": list(one.after),
                    "seen": one.seen,
                    "verdict": one.verdict,
                    "p": one.p,
                    "q": one.q,
                    "differences": [asdict(difference) for difference in one.differences],
                }
                for one in self.patches
            ],
        }


def _named(survey: Survey) -> dict[str, Any]:
    return {"name": survey.name, "began": survey.began.isoformat()}


@dataclass(frozen=True, slots=True)
class Comparing:
    """Tells change from what two surveys of the same ground differ by.

    What it does: lays the later survey on the earlier one and keeps to ground that both saw. Of a patch the
    individuals are counted in both, each weighed by how likely it is one and by how likely one like it is
    found: a binomial in its looks, whose rate comes from the hits of those that were found (of which those
    never hit are missing: zero-truncated). How much of them chance finds shows in how many of one survey the
    other found again. What is covered is held against each other too, in squares that both pictures show.
    Each difference is held against the chance and against the spread by which repeated surveys differ beyond
    it; the two tests are weighed by how sharp they are. Patches with few individuals are told by their area.
    A patch is called changed where its own test says so at `level` and, of all that are called so, a share of
    `false` at most is false.

    Reference: Horvitz and Thompson, JASA 47 (1952), for the weights; Petersen's mark and recapture for the
    chance; Benjamini and Hochberg, JRSS B 57 (1995), for many patches. `spread`, `cover_spread` and
    `together` were measured on repeated simulated surveys of worlds of their own (perf/change.py). `edge`,
    `edge_length` and `area_spread` were not: they are guesses that err towards "unchanged".

    Assumes: the two surveys were measured alike, with the same camera and labels, and most individuals are
    still there.
    Fails when: as many die as settle. Count and cover stay, and only the fates of individuals tell of it,
    which in a dense crust are often mistaken for each other. Fewer but larger individuals: count falls, cover
    grows, and the two tests cancel each other; `differences` shows both.
    """

    level: float = 0.05
    """Share of unchanged patches that are called changed, at most."""
    false: float = 0.1
    """Share of false ones among the patches that are called changed, at most."""
    spread: float = 0.03
    """Standard deviation of the ratio of the counts of a patch in repeated surveys, beyond chance."""
    area_spread: float = 0.05
    """The same of areas."""
    edge: float = 0.25
    """Metres by which an outline is drawn otherwise each time, over `edge_length` of it."""
    edge_length: float = 1.0
    """Metres along an outline that err alike."""
    cover_spread: float = 0.08
    """The same of what is covered, in the fine pictures."""
    cover_least: float = 0.05
    """Square metres by which it differs at the least."""
    together: float = 0.15
    """Correlation of count and cover in repeated surveys."""
    block: float = 0.1
    """Metres: side of the squares whose cover is compared."""
    least: int = 10
    """Individuals in both together below which a patch is told by its area."""
    least_seen: float = 0.3
    """Share of a patch that both must have seen to compare it."""
    registering: Registering = field(default_factory=Registering)

    def compare(self, a: Survey, b: Survey) -> Comparison:
        """What changed from a to b.

        Raises:
            ValueError: They are of different sites or targets, or one of them saw nothing.
        """
        if a.target != b.target:
            raise ValueError(f"compare: expected two surveys of one target, got {a.target} and {b.target}")
        laid = self.registering.register(a, b)
        grid = _Grid(a.layers)
        theirs = _resampled(b.layers, grid, laid)
        seen_a, seen_b = a.layers.state > 0, theirs > 0
        both = seen_a & seen_b
        target_a, target_b = np.isin(a.layers.state, (2, 4)) & both, np.isin(theirs, (2, 4)) & both
        change = _change(both, target_a, target_b, grid.cell, self.edge + grid.cell + 2.0 * laid.sigma)
        at_b = laid.place(b.individuals.position[:, :2])
        common_a = grid.at(both, a.individuals.position[:, :2])
        common_b = grid.at(both, at_b)
        units = self._units(a, b, grid, laid)
        fate_a, fate_b = _fates(a.individuals, b.individuals, at_b, common_a, common_b, laid)
        counts = (
            _Counts(a.individuals, common_a, grid.at(units.ground, a.individuals.position[:, :2]), fate_b),
            _Counts(b.individuals, common_b, grid.at(units.ground, at_b), fate_a),
        )
        covers = None
        if a.picture is not None and b.picture is not None:
            ground = np.where(both, units.ground, -1)
            covers = _covers(a.picture, b.picture, laid, grid, ground, len(units.rings), self.block)
        tested = [
            self._patch(units, number, grid, both, target_a, target_b, counts, covers)
            for number in range(len(units.rings))
        ]
        changes = self._judged(units, tested)
        cell2 = grid.cell**2
        return Comparison(
            a=a,
            b=b,
            registration=laid,
            bounds=a.layers.bounds,
            cell=grid.cell,
            change=change,
            fate_a=fate_a,
            fate_b=fate_b,
            positions_b=at_b,
            patches=changes,
            differences=self._whole(counts, target_a, target_b, grid, a, b, common_a, common_b),
            comparable=float(both.sum()) * cell2,
            only_a=float((seen_a & ~seen_b).sum()) * cell2,
            only_b=float((seen_b & ~seen_a).sum()) * cell2 + _beyond(b.layers, grid, laid),
        )

    def _units(self, a: Survey, b: Survey, grid: _Grid, laid: Registration) -> _Units:
        """Patches of the earlier survey, and those of the later one that lie on none of them."""
        rings_b = [tuple(laid.place(ring) for ring in patch.rings) for patch in b.patches]
        masks_b = [grid.within(rings) for rings in rings_b]
        masks = [grid.within(patch.rings) for patch in a.patches]
        rings = [patch.rings for patch in a.patches]
        before: list[int | None] = list(range(len(masks)))
        after: list[tuple[int, ...]] = []
        near = [
            ndimage.binary_dilation(mask, iterations=max(1, round(self.edge / grid.cell))) for mask in masks
        ]
        on = [[k for k, other in enumerate(masks_b) if (mask & other).any()] for mask in near]
        after = [tuple(found) for found in on]
        for k, mask in enumerate(masks_b):
            if mask.any() and not any(k in found for found in on):
                masks.append(mask)
                rings.append(rings_b[k])
                before.append(None)
                after.append((k,))
        ground = np.full(grid.shape, -1, np.intp)
        if masks:
            owner = np.full(grid.shape, -1, np.intp)
            for number, mask in enumerate(masks):
                owner[mask & (owner < 0)] = number
            # What the later survey shows beyond the old outline belongs to the nearest patch.
            reach = ndimage.distance_transform_edt(owner < 0) * grid.cell
            _, nearest = ndimage.distance_transform_edt(owner < 0, return_indices=True)
            any_of = np.logical_or.reduce([*masks, *masks_b])
            edge = ndimage.distance_transform_edt(~any_of) * grid.cell <= self.edge
            ground = np.where(edge | (reach <= self.edge), owner[tuple(nearest)], -1)
        return _Units(tuple(rings), tuple(before), tuple(after), ground)

    def _patch(
        self,
        units: _Units,
        number: int,
        grid: _Grid,
        both: BoolArray,
        target_a: BoolArray,
        target_b: BoolArray,
        counts: tuple[_Counts, _Counts],
        covers: tuple[Float64Array, Float64Array] | None,
    ) -> _Tested:
        """Share seen by both, the figures, p, and the direction."""
        own = units.ground == number
        seen = float((own & both).sum() / max(1, own.sum()))
        if seen < self.least_seen:
            return seen, (), None, 0.0
        area = self._area(target_a & own, target_b & own, grid)
        one, other = (count.of(number) for count in counts)
        count = self._count(one, other)
        if one.found + other.found < self.least:
            return seen, (count, area), area.p, math.copysign(1.0, area.change)
        if covers is None:
            return seen, (count, area), count.p, math.copysign(1.0, count.change)
        cover = self._cover(float(covers[0][number]), float(covers[1][number]))
        # Both tell of the same; each weighs by how sharply it tells of a share of what was there.
        told = [
            (one.change / error, 0.5 * (one.before + one.after) / error)
            for one, error in (
                (count, self._count_error(one, other)),
                (cover, self._cover_error(cover.before, cover.after)),
            )
        ]
        (z, weight), (other_z, other_weight) = told
        spread = math.sqrt(weight**2 + other_weight**2 + 2.0 * self.together * weight * other_weight)
        both_tell = (weight * z + other_weight * other_z) / max(spread, 1e-9)
        return seen, (count, cover, area), _two_sided(both_tell), math.copysign(1.0, both_tell)

    def _count_error(self, one: _Count, other: _Count) -> float:
        """Standard deviation of the difference where nothing changed: both find shares of the same ones."""
        same = 0.5 * (one.total + other.total)
        chance = same * (one.odds + other.odds) + one.doubt + other.doubt + 1.0
        return math.sqrt(chance + (self.spread * same) ** 2)

    def _cover_error(self, was: float, now: float) -> float:
        return math.hypot(self.cover_spread * 0.5 * (was + now), self.cover_least)

    def _cover(self, was: float, now: float) -> Difference:
        error = self._cover_error(was, now)
        change, half = now - was, Z95 * error
        p = _two_sided(change / error)
        return Difference("cover", was, now, change, change - half, change + half, p, "m2")

    def _count(self, one: _Count, other: _Count) -> Difference:
        change = other.total - one.total
        chance = one.total * one.odds + other.total * other.odds + one.doubt + other.doubt + 1.0
        half = Z95 * math.sqrt(chance + (self.spread * 0.5 * (one.total + other.total)) ** 2)
        p = _two_sided(change / self._count_error(one, other))
        return Difference("found", one.total, other.total, change, change - half, change + half, p, "")

    def _area(self, before: BoolArray, after: BoolArray, grid: _Grid) -> Difference:
        cell2 = grid.cell**2
        was, now = float(before.sum()) * cell2, float(after.sum()) * cell2
        length = max(_outline(before), _outline(after)) * grid.cell
        edges = 2.0 * self.edge**2 * length * self.edge_length
        variance = edges + (self.area_spread * 0.5 * (was + now)) ** 2 + cell2**2
        half = Z95 * math.sqrt(variance)
        change = now - was
        return Difference(
            "target_area",
            was,
            now,
            change,
            change - half,
            change + half,
            _two_sided(change / math.sqrt(variance)),
            "m2",
        )

    def _judged(self, units: _Units, tested: list[_Tested]) -> tuple[PatchChange, ...]:
        q = adjusted([p for _, _, p, _ in tested])
        changes = []
        for number, (seen, differences, p, direction) in enumerate(tested):
            verdict: Verdict = "not comparable" if p is None else "unchanged"
            share = q[number]
            if p is not None and share is not None and p <= self.level and share <= self.false:
                verdict = "gain" if direction > 0.0 else "loss"
            changes.append(
                PatchChange(
                    before=units.before[number],
                    after=units.after[number],
                    rings=units.rings[number],
                    seen=seen,
                    differences=differences,
                    p=p,
                    q=share,
                    verdict=verdict,
                )
            )
        return tuple(changes)

    def _whole(
        self,
        counts: tuple[_Counts, _Counts],
        target_a: BoolArray,
        target_b: BoolArray,
        grid: _Grid,
        a: Survey,
        b: Survey,
        common_a: BoolArray,
        common_b: BoolArray,
    ) -> tuple[Difference, ...]:
        area = self._area(target_a, target_b, grid)
        one, other = counts[0].of(None), counts[1].of(None)
        found = [area]
        if one.found + other.found >= self.least:
            count = self._count(one, other)
            found.append(count)
            if area.before > 0.0 and area.after > 0.0:
                found.append(_density(count, area))
            sizes = (_sized(a.individuals, common_a), _sized(b.individuals, common_b))
            errors = [error for error in map(_size_error, (a, b)) if error is not None]
            if min(map(len, sizes)) >= self.least and len(errors) == 2:
                found.append(_median(sizes, errors))
        return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Units:
    """The patches to compare."""

    rings: tuple[tuple[Float64Array, ...], ...]
    before: tuple[int | None, ...]
    after: tuple[tuple[int, ...], ...]
    ground: IntArray
    """(rows, cols) which one a cell belongs to; −1 for none."""


class _Grid:
    """The earlier survey's cells."""

    def __init__(self, layers: Layers) -> None:
        self.bounds, self.cell, self.shape = layers.bounds, layers.cell, layers.state.shape
        rows, cols = self.shape
        self.x = self.bounds.x_min + (np.arange(cols) + 0.5) * self.cell
        self.y = self.bounds.y_min + (np.arange(rows) + 0.5) * self.cell

    def at(self, values: Any, points: Float64Array) -> Any:
        """Values of the cells under points: False or −1 outside."""
        col = np.floor((points[:, 0] - self.bounds.x_min) / self.cell).astype(np.intp)
        row = np.floor((points[:, 1] - self.bounds.y_min) / self.cell).astype(np.intp)
        inside = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        outside = False if values.dtype == np.bool_ else -1
        found = np.full(len(points), outside, values.dtype)
        found[inside] = values[row[inside], col[inside]]
        return found

    def within(self, rings: tuple[Float64Array, ...]) -> BoolArray:
        """Cells whose middle is inside the outline and in no hole: by the parity of crossings."""
        inside = np.zeros(self.shape, np.bool_)
        for ring in rings:
            for (x0, y0), (x1, y1) in itertools.pairwise(ring.tolist()):
                if y0 == y1:
                    continue
                rows = np.flatnonzero((self.y >= min(y0, y1)) & (self.y < max(y0, y1)))
                crossing = x0 + (self.y[rows] - y0) * ((x1 - x0) / (y1 - y0))
                inside[rows] ^= self.x[None, :] >= crossing[:, None]
        return inside


@dataclass(frozen=True, slots=True)
class _Count:
    """Individuals of one survey on some ground."""

    found: int
    total: float
    """Those there are, by what was found and how likely it is found."""
    odds: float
    """Variance of the total that finding by chance brings, for each of them: (1 − π) / π."""
    doubt: float
    """Variance because some may be none."""


class _Counts:
    """Individuals of one survey on ground that both saw, by patch."""

    def __init__(
        self,
        individuals: Individuals,
        common: BoolArray,
        patch: IntArray,
        others: npt.NDArray[np.uint8],
    ) -> None:
        """Of one survey; `others` are the fates of those of the other, which this one found again or not."""
        self._common, self._patch = common, patch
        self._sure = individuals.confidence
        self._found = detection(individuals.hits, individuals.looks)
        again = int((others == Fate.THERE).sum())
        missed = int(np.isin(others, (Fate.LOST, Fate.NEW)).sum())
        # Of two that lie close, now the one and now the other is taken for the peak of both.
        self._odds = missed / max(again, 1) if again >= missed else 1.0

    def of(self, patch: int | None) -> _Count:
        mine = self._common if patch is None else self._common & (self._patch == patch)
        sure, found = self._sure[mine], self._found[mine]
        by_looks = float(((1.0 - found) / found).mean()) if len(found) else 0.0
        return _Count(
            found=int(mine.sum()),
            total=float((sure / found).sum()),
            odds=max(by_looks, self._odds),
            doubt=float((sure * (1.0 - sure) / found**2).sum()),
        )


def detection(hits: npt.NDArray[np.int32], looks: npt.NDArray[np.int32]) -> Float64Array:
    """(N,) how likely each is found at least once, from how often those that were found are.

    The rate of one look is the most likely one of binomials of which the zeros are missing.
    """
    seen = looks > 0
    if not seen.any():
        return np.ones(len(looks))
    hit, look = float(hits[seen].sum()), looks[seen].astype(np.float64)
    low, high = 1e-4, 1.0 - 1e-9
    for _ in range(60):
        rate = 0.5 * (low + high)
        expected = float((look * rate / -np.expm1(look * math.log1p(-rate))).sum())
        low, high = (rate, high) if expected < hit else (low, rate)
    found = np.where(seen, -np.expm1(looks * math.log1p(-0.5 * (low + high))), 1.0)
    return np.maximum(found, 0.05)


def adjusted(p: list[float | None]) -> list[float | None]:
    """Benjamini and Hochberg's q of each; None where there is no p."""
    there = [k for k, value in enumerate(p) if value is not None]
    order = sorted(there, key=lambda k: p[k] or 0.0, reverse=True)
    q: list[float | None] = [None] * len(p)
    least = 1.0
    for rank, k in zip(range(len(order), 0, -1), order, strict=True):
        least = min(least, (p[k] or 0.0) * len(order) / rank)
        q[k] = least
    return q


def _resampled(layers: Layers, grid: _Grid, laid: Registration) -> npt.NDArray[np.uint8]:
    """(rows, cols) states of the later survey under the middles of the earlier one's cells."""
    x, y = np.meshgrid(grid.x, grid.y)
    T = laid.T_a_b
    c, s = math.cos(T.yaw), math.sin(T.yaw)
    dx, dy = x.ravel() - T.x, y.ravel() - T.y
    points = np.column_stack([c * dx + s * dy, -s * dx + c * dy])
    states = _Grid(layers).at(layers.state.astype(np.int16), points)
    resampled: npt.NDArray[np.uint8] = np.maximum(states, 0).astype(np.uint8).reshape(grid.shape)
    return resampled


def _beyond(layers: Layers, grid: _Grid, laid: Registration) -> float:
    """Square metres that the later survey saw outside the earlier one's grid."""
    rows, cols = np.nonzero(layers.state > 0)
    theirs = _Grid(layers)
    there = laid.place(np.column_stack([theirs.x[cols], theirs.y[rows]]))
    inside = grid.at(np.ones(grid.shape, np.bool_), there)
    return float((~inside).sum()) * layers.cell**2


def _covers(
    a: Picture, b: Picture, laid: Registration, grid: _Grid, ground: IntArray, units: int, block: float
) -> tuple[Float64Array, Float64Array]:
    """Square metres that are covered of each patch, before and after, in blocks that both pictures show."""
    ours, theirs = (_blocks(one, T, grid, block) for one, T in ((a, None), (b, laid.T_a_b)))
    rows, cols = np.nonzero(np.isfinite(ours) & np.isfinite(theirs))
    middle = np.column_stack(
        [grid.bounds.x_min + (cols + 0.5) * block, grid.bounds.y_min + (rows + 0.5) * block]
    )
    unit = grid.at(ground, middle)
    kept = unit >= 0
    before, after = (
        block**2 * np.bincount(unit[kept], share[rows, cols][kept], units) for share in (ours, theirs)
    )
    return np.asarray(before, np.float64), np.asarray(after, np.float64)


def _blocks(picture: Picture, T: SE2 | None, grid: _Grid, block: float) -> Float64Array:
    """(rows, cols) mean share of what a picture shows of each block of the earlier survey's grid, or NaN."""
    rows, cols = np.nonzero(picture.share <= 200)
    places = np.column_stack(
        [
            picture.bounds.x_min + (cols + 0.5) * picture.cell,
            picture.bounds.y_min + (rows + 0.5) * picture.cell,
        ]
    )
    if T is not None:
        places = placed(T, places)
    shape = (math.ceil(grid.bounds.depth / block), math.ceil(grid.bounds.width / block))
    col = np.floor((places[:, 0] - grid.bounds.x_min) / block).astype(np.intp)
    row = np.floor((places[:, 1] - grid.bounds.y_min) / block).astype(np.intp)
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    flat = row[inside] * shape[1] + col[inside]
    count = np.bincount(flat, minlength=shape[0] * shape[1])
    total = np.bincount(flat, picture.share[rows, cols][inside] / 200.0, shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count, np.float64).reshape(shape)


def _change(
    both: BoolArray, before: BoolArray, after: BoolArray, cell: float, tolerance: float
) -> npt.NDArray[np.uint8]:
    change = np.full(both.shape, Change.NOT_COMPARABLE, np.uint8)
    change[both] = Change.BARE
    change[before | after] = Change.KEPT
    for now, then, what in ((after, before, Change.GAIN), (before, after, Change.LOSS)):
        if now.any():
            # Where there was none at all, all is far.
            far = ndimage.distance_transform_edt(~then) * cell > tolerance if then.any() else True
            change[now & ~then & far] = what
    return change


def _fates(
    a: Individuals,
    b: Individuals,
    at_b: Float64Array,
    common_a: BoolArray,
    common_b: BoolArray,
    laid: Registration,
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Pairs of nearest, one to one, within what their places may err are the same individual."""
    fate_a = np.where(common_a, np.uint8(Fate.LOST), np.uint8(Fate.NOT_COMPARABLE))
    fate_b = np.where(common_b, np.uint8(Fate.NEW), np.uint8(Fate.NOT_COMPARABLE))
    if len(a) and len(b):
        pairs = mutual(cKDTree(a.position[:, :2]), at_b, 0.5)
        gap = np.hypot(*(a.position[pairs[:, 0], :2] - at_b[pairs[:, 1]]).T)
        sigma = np.sqrt(a.sigma[pairs[:, 0]] ** 2 + b.sigma[pairs[:, 1]] ** 2 + laid.sigma**2)
        kept = pairs[gap <= 3.0 * np.maximum(sigma, 0.02)]
        same = common_a[kept[:, 0]] & common_b[kept[:, 1]]
        fate_a[kept[same, 0]] = Fate.THERE
        fate_b[kept[same, 1]] = Fate.THERE
        # One whose partner lies beyond what both saw is neither lost nor new.
        fate_a[kept[~same, 0]] = Fate.NOT_COMPARABLE
        fate_b[kept[~same, 1]] = Fate.NOT_COMPARABLE
    return fate_a, fate_b


def _outline(mask: BoolArray) -> float:
    """Length of the edges of a set of cells, in cells: of a diagonal too, by π/4 of its steps."""
    padded = np.pad(mask, 1)
    steps = float((padded[1:] != padded[:-1]).sum() + (padded[:, 1:] != padded[:, :-1]).sum())
    return 0.25 * math.pi * steps


def _density(count: Difference, area: Difference) -> Difference:
    before, after = count.before / area.before, count.after / area.after
    # Both intervals as standard errors, carried through the ratio.
    of_count, of_area = ((one.high - one.low) / (2.0 * Z95) for one in (count, area))
    error = math.hypot(of_count / area.before, before * of_area / area.before)
    change = after - before
    half = Z95 * error
    p = _two_sided(change / max(error, 1e-9))
    return Difference("found_density", before, after, change, change - half, change + half, p, "1/m2")


def _sized(individuals: Individuals, common: BoolArray) -> Float64Array:
    """Sizes of those on common ground that were measured; the others are only said to be like them."""
    if not common.any():
        return individuals.size[common]
    least = float(individuals.size_sigma[common].min())
    return individuals.size[common & (individuals.size_sigma <= least * (1.0 + 1e-9))]


def _size_error(survey: Survey) -> float | None:
    """Standard error of a survey's median size, as its own interval has it; None where it tells none."""
    told = next((one for one in survey.measures if one.name == "median_size"), None)
    if told is None or told.low is None or told.high is None:
        return None
    return (told.high - told.low) / (2.0 * Z95)


def _median(samples: tuple[Float64Array, Float64Array], told: list[float]) -> Difference:
    """Medians and their difference; standard errors by order statistics (binomial ranks).

    All sizes of a survey err together too (`told`), which their scatter does not show.
    """
    medians, errors = [], [*told]
    for sizes in map(np.sort, samples):
        n = len(sizes)
        half = 0.5 * math.sqrt(n)
        low, high = (min(n - 1, max(0, round(0.5 * n + sign * half))) for sign in (-1.0, 1.0))
        medians.append(float(np.median(sizes)))
        errors.append(0.5 * float(sizes[high] - sizes[low]))
    was, now = medians
    change, error = now - was, math.hypot(*errors)
    reach = Z95 * error
    p = _two_sided(change / max(error, 1e-9))
    return Difference("median_size", was, now, change, change - reach, change + reach, p, "m")


def _two_sided(z: float) -> float:
    return float(2.0 * ndtr(-abs(z)))
