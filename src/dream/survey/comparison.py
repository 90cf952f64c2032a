"""What changed between two surveys of one site, and how sure that is."""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.special import ndtr

from dream.geometry import Bounds
from dream.survey.fates import BARE, Fate, Missing, Shown, Standing, fates, missing, standing
from dream.survey.registration import Registering, Registration
from dream.survey.sizes import measures_over
from dream.survey.survey import Individuals, Layers, Measure, Survey, under

Float64Array = npt.NDArray[np.float64]
FateArray = npt.NDArray[np.uint8]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

Verdict = Literal["gain", "loss", "mixed", "no change shown", "not comparable"]
"""`mixed`: both a loss and a gain."""
Z95 = 1.959964
"""Standard deviations to each side of a 95 % interval."""
YEAR = 365.25 * 86_400.0
"""Seconds."""
POINT = 0.05
"""Metres between the points at which ground is asked whether it is covered."""


class Change(enum.IntEnum):
    """What became of a cell of ground."""

    NOT_COMPARABLE = 0
    BARE = 1
    """Bare in both."""
    KEPT = 2
    """Target in both, or at an edge of it that no survey draws the same twice."""
    GAIN = 3
    LOSS = 4


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure before and after, on ground that both saw."""

    name: str
    """`found` (individuals that show in the relief, which are fewer than a survey's `count` says there are),
    `found_density`, `target_area` (cells of the map; the reef of a survey is closed over its gaps, and
    larger), `covered` (ground of patches that is not bare in the fine pictures); or a measure of a survey."""
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
    gone: Missing | None
    """Of the earlier survey's individuals; None where pictures do not tell."""
    come: Missing | None
    """Of the later one's."""
    p: float | None
    """Of the tests for it, of both sides; None where it is not comparable."""
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
    measures: tuple[Difference, ...]
    """What each survey says of all that it saw itself, as the universal metrics."""
    withheld: bool
    """Nothing shows how they lie on each other, so that no ground is compared."""
    comparable: float
    """Square metres that both saw."""
    only_a: float
    only_b: float
    """Square metres that only one of them saw; 0 where nothing is compared."""
    comparing: Comparing
    """How they were told apart."""

    @property
    def years(self) -> float:
        """From the earlier survey to the later one."""
        return (self.b.began - self.a.began).total_seconds() / YEAR

    def as_dict(self) -> dict[str, Any]:
        """As `--json` prints it."""
        ground = self.cell**2 * np.bincount(self.change.ravel(), minlength=5)
        laid = self.registration
        return {
            "before": _named(self.a),
            "after": _named(self.b),
            "years": self.years,
            "doubts": list(doubts(self.a, self.b)),
            "simulated": [one.simulated for one in (self.a, self.b)],
            "registration": {
                "x": laid.T_a_b.x,
                "y": laid.T_a_b.y,
                "yaw": laid.T_a_b.yaw,
                "sigma_m": None if self.withheld else laid.sigma,
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
                "hidden_before": int((self.fate_a == Fate.HIDDEN).sum()),
                "hidden_after": int((self.fate_b == Fate.HIDDEN).sum()),
                "not_comparable": int((self.fate_a == 0).sum() + (self.fate_b == 0).sum()),
            },
            "withheld": self.withheld,
            "measures": [asdict(one) for one in self.measures],
            "differences": [asdict(one) for one in self.differences],
            "patches": [
                {
                    "before": one.before,
                    "after": list(one.after),
                    "seen": one.seen,
                    "verdict": one.verdict,
                    "p": one.p,
                    "q": one.q,
                    "gone": None if one.gone is None else asdict(one.gone),
                    "come": None if one.come is None else asdict(one.come),
                    "differences": [asdict(difference) for difference in one.differences],
                }
                for one in self.patches
            ],
        }


def doubts(a: Survey, b: Survey) -> tuple[str, ...]:
    """What two surveys have that makes their comparison less than it says."""
    told = []
    if (a.name, a.began) == (b.name, b.began) or (a.run is not None and a.run == b.run):
        told.append(
            f"both are {a.name}: expected two of a site. What differs is how one was laid on the other"
        )
    if a.began > b.began:
        told.append(
            f"{a.name} began after {b.name}; what is told as gained was lost, if their clocks are right"
        )
    if a.calibration != b.calibration:
        told.append(
            f"{a.name} and {b.name} were measured by different calibrations: sizes, counts and densities may "
            "differ by that alone. Measure both by one version: dream survey add RUN --replace NUMBER"
        )
    if a.protocol != b.protocol:
        told.append(
            f"{a.name} was made by {a.protocol} and {b.name} by {b.protocol}: what two ways of looking "
            "differ by is not in the intervals, and may be told as a change"
        )
    return tuple(told)


def _named(survey: Survey) -> dict[str, Any]:
    return {"name": survey.name, "began": survey.began.isoformat()}


@dataclass(frozen=True, slots=True)
class Comparing:
    """Tells change from what two surveys of the same ground differ by.

    What it does: lays the later survey on the earlier one and keeps to ground that both saw. Of the earlier
    one's individuals in a patch those are counted in whose place the later one shows bare ground (`gone`),
    and the other way round (`come`). Where nothing changed surveys miss a few of them as well; more than that
    is a loss, or a gain. What is covered is held against each other too, which also tells of growth. A patch
    is called changed where its sharpest test, held against how many it has (Bonferroni), says so at `level`,
    and of all that are called so a share of `false` at most is false. It is `mixed` where both a loss and a
    gain are shown: some died, and others settled or grew. Patches of few individuals are told by their area.
    Where there are no pictures, or individuals do not show how they lie on each other, the number that was
    found tells: each weighed by how likely it is one and by how likely one like it is found. Where both show
    target but nothing shows how they lie on each other, no ground is compared.

    Reference: the beta-binomial of `fates.missing` for what is missed; Benjamini and Hochberg, JRSS B 57
    (1995), for many patches; Horvitz and Thompson, JASA 47 (1952), for the weights; Petersen's mark and
    recapture for the chance to be found. `missed`, `alike`, `cover_spread`, `cover_least` and `spread` were
    measured on repeated simulated surveys of 59 worlds (perf/change.py) and rounded up. `area_spread`, `edge`
    and `edge_length` were not: they are guesses that err towards "no change shown".

    Assumes: the two surveys were measured alike, with the same camera and labels.
    Fails when: the poses of one survey err against each other by more than a few centimetres, so that its
    individuals stand beside themselves: gone and come. Deaths that others hide are not told, nor is who
    settles on others.
    """

    level: float = 0.05
    """Share of unchanged patches that are called changed, at most."""
    false: float = 0.1
    """Share of false ones among the patches that are called changed, at most."""
    missed: float = 0.029
    """Share of individuals in whose place another survey of unchanged ground shows it bare."""
    alike: float = 0.0025
    """Correlation between two of a patch, of being missed."""
    sightings: int = 2
    """Frames in which an individual must have been found; seen but once, from afar, it may lie elsewhere."""
    cover_spread: float = 0.03
    """Standard deviation of the ratio of what is covered of a patch in repeated surveys."""
    cover_least: float = 0.3
    """Square metres by which it differs at the least."""
    spread: float = 0.03
    """The same of the number of individuals found, beyond chance."""
    area_spread: float = 0.05
    """The same of areas of the map."""
    edge: float = 0.25
    """Metres by which an outline is drawn otherwise each time, over `edge_length` of it."""
    edge_length: float = 1.0
    """Metres along an outline that err alike."""
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
        # Ground that did not change would be told as gained and lost.
        withheld = laid.by == "poses" and bool(both.any())
        withheld &= all(np.isin(one.layers.state, (2, 4)).any() for one in (a, b))
        if withheld:
            for mask in (seen_a, seen_b, both):
                mask[:] = False
        target = (np.isin(a.layers.state, (2, 4)) & both, np.isin(theirs, (2, 4)) & both)
        units = self._units(a, b, grid, laid)
        places = (a.individuals.position[:, :2], laid.place(b.individuals.position[:, :2]))
        common = (grid.at(both, places[0]), grid.at(both, places[1]))
        shown = None
        # Laid by their maps alone, what stands a hand aside would seem gone.
        if a.picture is not None and b.picture is not None and laid.by == "individuals":
            shown = (Shown(a.picture), Shown(b.picture))
        stand = None if shown is None else standing(shown, (a.individuals, b.individuals), laid)
        fate_a, fate_b = fates((a.individuals, b.individuals), places[1], common, stand, laid)
        patch = (grid.at(units.ground, places[0]), grid.at(units.ground, places[1]))
        met = _Met(
            grid=grid,
            both=both,
            target=target,
            ground=units.ground,
            counts=(
                _Counts(a.individuals, common[0], patch[0], fate_b),
                _Counts(b.individuals, common[1], patch[1], fate_a),
            ),
            covered=None if shown is None else _covered(shown, laid, grid, both, units),
            missed=None
            if stand is None
            else (
                _Missed(a.individuals, fate_a, patch[0], stand[0], self.sightings),
                _Missed(b.individuals, fate_b, patch[1], stand[1], self.sightings),
            ),
        )
        tested = [self._tested(met, number) for number in range(len(units.rings))]
        cell2 = grid.cell**2
        return Comparison(
            a=a,
            b=b,
            registration=laid,
            bounds=a.layers.bounds,
            cell=grid.cell,
            change=_change(both, *target, grid.cell, self.edge + grid.cell + 2.0 * laid.sigma),
            fate_a=fate_a,
            fate_b=fate_b,
            positions_b=places[1],
            patches=self._judged(units, tested),
            differences=() if withheld else self._whole(met),
            measures=tuple(_told_by_both(a, b)),
            withheld=withheld,
            comparable=float(both.sum()) * cell2,
            only_a=float((seen_a & ~seen_b).sum()) * cell2,
            only_b=float((seen_b & ~seen_a).sum()) * cell2
            + (0.0 if withheld else _beyond(b.layers, grid, laid)),
            comparing=self,
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
            if not any(k in found for found in on):
                masks.append(mask)
                rings.append(rings_b[k])
                before.append(None)
                after.append((k,))
        ground = np.full(grid.shape, -1, np.intp)
        if any(mask.any() for mask in masks):
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

    def _tested(self, met: _Met, number: int) -> _Tested:
        """One patch: its figures, and how often as much of a loss or gain is seen where there is none."""
        own = met.ground == number
        seen = float((own & met.both).sum() / max(1, own.sum()))
        if seen < self.least_seen:
            return _Tested(seen)
        area = self._area(met.target[0] & own, met.target[1] & own, met.grid)
        count = self._count(*(counts.of(number) for counts in met.counts))
        if met.missed is not None and met.covered is not None:
            gone, come = (self._missing(missed, number) for missed in met.missed)
            if gone.of + come.of >= self.least:
                cover = self._cover(*(float(covered[number]) for covered in met.covered))
                less, more = _sides(cover)
                figures = (count, cover, area)
                return _Tested(seen, figures, gone, come, 2.0 * min(gone.p, less), 2.0 * min(come.p, more))
        elif met.found(number) >= self.least:
            return _Tested(seen, (count, area), None, None, *_sides(count))
        return _Tested(seen, (count, area), None, None, *_sides(area))

    def _missing(self, missed: _Missed, number: int) -> Missing:
        return missing(*missed.of(number), self.missed, self.alike)

    def _cover(self, was: float, now: float) -> Difference:
        error = math.hypot(self.cover_spread * 0.5 * (was + now), self.cover_least)
        return _difference("covered", was, now, error, "m2")

    def _count(self, one: _Count, other: _Count) -> Difference:
        """Both find shares of the same individuals where nothing changed."""
        same = 0.5 * (one.total + other.total)
        chance = same * (one.odds + other.odds) + one.doubt + other.doubt + 1.0
        error = math.sqrt(chance + (self.spread * same) ** 2)
        return _difference("found", one.total, other.total, error, "")

    def _area(self, before: BoolArray, after: BoolArray, grid: _Grid) -> Difference:
        cell2 = grid.cell**2
        was, now = float(before.sum()) * cell2, float(after.sum()) * cell2
        length = max(_outline(before), _outline(after)) * grid.cell
        edges = 2.0 * self.edge**2 * length * self.edge_length
        variance = edges + (self.area_spread * 0.5 * (was + now)) ** 2 + cell2**2
        return _difference("target_area", was, now, math.sqrt(variance), "m2")

    def _judged(self, units: _Units, tested: list[_Tested]) -> tuple[PatchChange, ...]:
        q = adjusted([one.p for one in tested])
        changes = []
        for number, one in enumerate(tested):
            verdict: Verdict = "not comparable"
            share = q[number]
            if one.loss is not None and one.gain is not None:
                lost, gained = (side <= 0.5 * self.level for side in (one.loss, one.gain))
                verdict = "no change shown"
                if share is not None and share <= self.false and (lost or gained):
                    verdict = "mixed" if lost and gained else "loss" if lost else "gain"
            changes.append(
                PatchChange(
                    before=units.before[number],
                    after=units.after[number],
                    rings=units.rings[number],
                    seen=one.seen,
                    differences=one.differences,
                    gone=one.gone,
                    come=one.come,
                    p=one.p,
                    q=share,
                    verdict=verdict,
                )
            )
        return tuple(changes)

    def _whole(self, met: _Met) -> tuple[Difference, ...]:
        area = self._area(*met.target, met.grid)
        found = [area]
        if met.covered is not None:
            found.append(self._cover(*(float(covered.sum()) for covered in met.covered)))
        if met.found(None) >= self.least:
            count = self._count(*(counts.of(None) for counts in met.counts))
            found.append(count)
            if area.before > 0.0 and area.after > 0.0:
                found.append(_density(count, area))
        return tuple(found)


@dataclass(frozen=True, slots=True)
class _Tested:
    """What the tests of a patch say; nothing of one that is not comparable."""

    seen: float
    differences: tuple[Difference, ...] = ()
    gone: Missing | None = None
    come: Missing | None = None
    loss: float | None = None
    """P of a loss, of one side."""
    gain: float | None = None

    @property
    def p(self) -> float | None:
        """Of both sides."""
        if self.loss is None or self.gain is None:
            return None
        return min(1.0, 2.0 * min(self.loss, self.gain))


@dataclass(frozen=True, slots=True, eq=False)
class _Met:
    """What both surveys say of the ground that both saw. Pairs are of the earlier and of the later one."""

    grid: _Grid
    both: BoolArray
    target: tuple[BoolArray, BoolArray]
    ground: IntArray
    """(rows, cols) the patch of each cell."""
    counts: tuple[_Counts, _Counts]
    covered: tuple[Float64Array, Float64Array] | None
    """Square metres of each patch that are not bare; None without pictures that can be laid on each other."""
    missed: tuple[_Missed, _Missed] | None

    def found(self, patch: int | None) -> int:
        """Individuals in both together."""
        return sum(counts.of(patch).found for counts in self.counts)


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
        return under(points, values, self.bounds, self.cell, False if values.dtype == np.bool_ else -1)

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


class _Missed:
    """Individuals of one survey whose place is well known, and whether the other shows it bare."""

    def __init__(
        self, individuals: Individuals, fate: FateArray, patch: IntArray, stands: Standing, sightings: int
    ) -> None:
        clear = (fate != Fate.NOT_COMPARABLE) & stands.known & (individuals.hits >= sightings)
        self._patch, self._bare = patch[clear], stands.bare[clear]

    def of(self, patch: int) -> tuple[int, int]:
        """How many are on bare ground, and of how many."""
        mine = self._patch == patch
        return int((mine & self._bare).sum()), int(mine.sum())


class _Counts:
    """Individuals of one survey on ground that both saw, by patch."""

    def __init__(
        self,
        individuals: Individuals,
        common: BoolArray,
        patch: IntArray,
        others: FateArray,
    ) -> None:
        """Of one survey; `others` are the fates of those of the other, which this one found again or not."""
        self._common, self._patch = common, patch
        self._sure = individuals.confidence
        self._found = detection(individuals.hits, individuals.looks)
        again = int((others == Fate.THERE).sum())
        missed = int(np.isin(others, (Fate.LOST, Fate.NEW, Fate.HIDDEN)).sum())
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
    points = laid.back(np.column_stack([x.ravel(), y.ravel()]))
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


def _covered(
    shown: tuple[Shown, Shown], laid: Registration, grid: _Grid, both: BoolArray, units: _Units
) -> tuple[Float64Array, Float64Array]:
    """Square metres of each patch that are not bare, before and after, of what both pictures show."""
    rows, cols = np.nonzero(both & (units.ground >= 0))
    side = max(1, round(grid.cell / POINT))
    step = grid.cell / side
    within = (np.arange(side) + 0.5) * step - 0.5 * grid.cell
    x = grid.x[cols][:, None, None] + within[None, :, None]
    y = grid.y[rows][:, None, None] + within[None, None, :]
    points = np.column_stack([np.broadcast_to(one, (len(rows), side, side)).ravel() for one in (x, y)])
    before, after = shown[0].around(points), shown[1].around(laid.back(points))
    known = np.isfinite(before) & np.isfinite(after)
    patch = np.repeat(units.ground[rows, cols], side**2)[known]
    one, other = (
        step**2 * np.bincount(patch, share[known] >= BARE, len(units.rings)) for share in (before, after)
    )
    return np.asarray(one, np.float64), np.asarray(other, np.float64)


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


def _outline(mask: BoolArray) -> float:
    """Length of the edges of a set of cells, in cells: of a diagonal too, by π/4 of its steps."""
    padded = np.pad(mask, 1)
    steps = float((padded[1:] != padded[:-1]).sum() + (padded[:, 1:] != padded[:, :-1]).sum())
    return 0.25 * math.pi * steps


def _density(count: Difference, area: Difference) -> Difference:
    before, after = count.before / area.before, count.after / area.after
    # Both intervals as standard errors, carried through the ratio halfway between the surveys: what is told
    # of B after A and of A after B differs in its sign alone.
    of_count, of_area = ((one.high - one.low) / (2.0 * Z95) for one in (count, area))
    ground, density = 0.5 * (area.before + area.after), 0.5 * (before + after)
    error = math.hypot(of_count / ground, density * of_area / ground)
    return _difference("found_density", before, after, max(error, 1e-9), "1/m2")


def _difference(name: str, was: float, now: float, error: float, unit: str) -> Difference:
    """By a standard error of the change."""
    change, half = now - was, Z95 * error
    return Difference(name, was, now, change, change - half, change + half, _two_sided(change / error), unit)


def held_against(was: Measure, now: Measure) -> Difference | None:
    """One measure of two surveys; None where one did not measure it. Their errors are taken for independent,
    though part of them is not.

    Reference: the interval of a difference from those of its parts, Zou and Donner, Stat. Med. 27 (2008).
    """
    numbers = [was.value, was.low, was.high, now.value, now.low, now.high]
    known = [value for value in numbers if value is not None]
    if len(known) < len(numbers):
        return None
    before, low_a, high_a, after, low_b, high_b = known
    change = after - before
    less, more = math.hypot(after - low_b, high_a - before), math.hypot(high_b - after, before - low_a)
    # Of no change the side that a change would be told by is the lesser.
    side = min(less, more) if change == 0.0 else less if change > 0.0 else more
    p = _two_sided(Z95 * change / side) if side > 0.0 else float(change == 0.0)
    return Difference(now.name, before, after, change, change - less, change + more, p, now.unit)


def _told_by_both(a: Survey, b: Survey) -> Iterator[Difference]:
    """Measures of both surveys that are of the ground, not of how much of it was seen. The number of patches
    is left out: of a few whole numbers a normal error says nothing."""
    for was, now in measures_over((a, b)).values():
        if was is None or now is None or now.name in ("seen_share", "hull_seen", "patch_count"):
            continue
        if (one := held_against(was, now)) is not None:
            yield one


def _sides(of: Difference) -> tuple[float, float]:
    """P of a loss and of a gain."""
    less = 0.5 * of.p if of.change < 0.0 else 1.0 - 0.5 * of.p
    return less, 1.0 - less


def _two_sided(z: float) -> float:
    return float(2.0 * ndtr(-abs(z)))
