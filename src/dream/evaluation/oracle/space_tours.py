"""Short clairvoyant walks in space: the best known tour of a world.

A tour starts after the look-around and leaves at most `may_miss` of the countable individuals not inspected.
It is built from frames that inspect much for the steps they cost, in a short order, joined by the shortest
ways; what shows on those ways counts. Then windows of it are cut out and searched again for what they alone
showed, and parts of it are removed and built anew elsewhere (large neighbourhood search).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from dream.compiling import thread_time
from dream.evaluation.oracle._kernels import space as _kernels
from dream.evaluation.oracle._kernels.tours import anneal
from dream.evaluation.oracle.space_graph import BoolArray, Int32Array, Pose, SpaceGraph

LONGEST = 250
"""Actions of the longest walk looked for."""
STARTS = 0.3
"""Share of the time for walks built anew; the best of them is then improved."""
HEAT = 0.7
"""Steps: the mean of how much longer a changed walk may be to be kept."""

DETOUR = 12
"""Steps by which the way to the next frame may be longer than in open water."""

UInt8Array = npt.NDArray[np.uint8]
NOWHERE: UInt8Array = np.zeros((0, 0), np.uint8)

Walk = list[Pose]
"""Poses one move apart, the first after the look-around."""


class _SpaceSearch:
    """One search for a tour: the best so far, and what it takes to find others."""

    def __init__(self, graph: SpaceGraph, may_miss: int, seed: int) -> None:
        self.graph, self.may_miss = graph, may_miss
        self.rng = np.random.default_rng(seed)
        self.count = len(graph.individuals)
        self.entries = _kernels.by_individual(graph.kernel, self.count)
        self.open: BoolArray = ~graph.looked[-1]
        shown_from = np.bincount(graph.kernel.who, minlength=self.count)
        self.rarity = 1.0 / np.maximum(shown_from, 1)
        self.best: Walk | None = None
        self._shows: dict[Pose, Int32Array] = {}

    def shows(self, pose: Pose) -> Int32Array:
        """As `SpaceGraph.shows`."""
        if pose not in self._shows:
            self._shows[pose] = self.graph.shows(pose)
        return self._shows[pose]

    def counts(self, poses: Sequence[Pose]) -> npt.NDArray[np.int64]:
        """(N,) how many of the poses inspect each individual."""
        every = [self.shows(pose) for pose in poses]
        return (
            np.bincount(np.concatenate(every), minlength=self.count) if every else np.zeros(self.count, int)
        )

    def unseen(self, walk: Walk) -> BoolArray:
        """(N,) who is not inspected by the look-around and the walk."""
        unseen: BoolArray = self.open & (self.counts(walk) == 0)
        return unseen

    def offer(self, walk: Walk | None) -> bool:
        """Keep a walk that is a shorter tour than the best, as far as it takes."""
        if walk is None:
            return False
        left = self.open.copy()
        for k, pose in enumerate(walk):
            left[self.shows(pose)] = False
            if self.best is not None and k >= len(self.best) - 1:
                return False
            if int(left.sum()) <= self.may_miss:
                self.best = walk[: k + 1]
                return True
        return False

    def beam(
        self, begin: Pose, end: Pose | None, wanted: BoolArray, limit: int, may_miss: int, *,
        width: int, urge: float, noise: float = 0.0, crowd: int = 6, togo: UInt8Array = NOWHERE,
    ) -> Walk | None:  # fmt: skip
        """The poses after `begin` of a walk of at most `limit` steps; None where none was found.

        Of long ways it knows best with `togo`, the steps to the end around what is in the way.
        """
        chosen = np.flatnonzero(wanted)
        column = np.full(self.count, -1, np.int16)
        column[chosen] = np.arange(len(chosen), dtype=np.int16)
        weights = self.rarity[chosen] ** 0.5
        kernel, goal = self.graph.kernel, end or begin
        found, ok = _kernels.beam(
            kernel, begin[:2], goal[:2], end is not None, togo, column,
            weights / max(weights.sum(), 1e-12), limit, may_miss, width, crowd, urge, noise, self.rng,
        )  # fmt: skip
        if not ok:
            return None
        walk = [(int(p), int(h), int(t)) for p, h, t in found]
        return walk if end is None else [*walk[:-1], end]

    def joined(self, stops: Walk) -> Walk | None:
        """A walk through poses by short ways; None where there is none."""
        walk = [stops[0]]
        counts = self.counts(stops)
        for stop in stops[1:]:
            if stop[:2] == walk[-1][:2] and stop[2] == walk[-1][2]:
                continue
            kernel, begin = self.graph.kernel, walk[-1]
            low = max(_kernels.floor(kernel, *begin[:2], *stop[:2]), 1)
            for limit in range(low, low + DETOUR):
                togo = _kernels.steps_to(kernel, stop[:2], begin[:2], limit)
                if togo[begin[:2]] <= limit:
                    break
            wanted = self.open & (counts == 0)
            way = self.beam(begin, stop, wanted, limit, self.count, width=60, urge=4.0, togo=togo)
            if way is None:
                return None
            for pose in way[:-1]:
                counts[self.shows(pose)] += 1
            walk += way
            if len(walk) > LONGEST:
                return None
        return walk

    def complete(self, walk: Walk, *, share: float = 0.5) -> Walk | None:
        """The walk with frames put in until little enough is unseen; None where that cannot be had."""
        for _ in range(4):
            wanted = self.unseen(walk)
            if int(wanted.sum()) <= self.may_miss:
                return walk
            weights = wanted * self.rng.uniform(0.7, 1.3, self.count)
            stops = _kernels.insert_stops(
                self.graph.kernel, self.entries, _kernels.values(self.graph.kernel, weights), weights, wanted,
                self.may_miss, np.array(walk, np.int32), float(self.rng.uniform(0.3, 1.5)),
                float(self.rng.uniform(0.4, 1.0)), share, self.rng,
            )  # fmt: skip
            longer = self.joined([(int(p), int(h), int(t)) for p, h, t in stops])
            if longer is None:
                return None
            walk = longer
        return walk if int(self.unseen(walk).sum()) <= self.may_miss else None

    def needed(self, walk: Walk) -> Walk:
        """Poses of a walk, the first among them, without those whose loss leaves few enough unseen."""
        counts = self.counts(walk)
        unseen = int((self.open & (counts == 0)).sum())
        kept = list(range(len(walk)))
        alone = [int((counts[self.shows(pose)] == 1).sum()) for pose in walk]
        for k in np.argsort(np.array(alone) + self.rng.uniform(0.0, 3.0, len(walk))):
            own = self.shows(walk[k])
            lost = int((self.open[own] & (counts[own] == 1)).sum())
            if k > 0 and (lost == 0 or unseen + lost <= self.may_miss):
                counts[own] -= 1
                unseen += lost
                kept.remove(int(k))
        return [walk[k] for k in kept]

    def reordered(self, stops: Walk, *, hot: float = 2.0, rounds: int = 8000) -> Walk:
        """The same poses in a short order, the first staying the first."""
        kernel = self.graph.kernel
        between = np.array([[_kernels.floor(kernel, *a[:2], *b[:2]) for b in stops] for a in stops], np.uint8)
        count = len(stops)
        if count < 3:
            return stops
        order = np.arange(count - 1)
        chosen = anneal(
            between[0], between, np.arange(count).astype(np.int64), np.arange(1, count).astype(np.int64),
            order, count - 1, rounds, hot, 0.15, self.rng,
        )  # fmt: skip
        return [stops[0], *(stops[k] for k in chosen)]

    def window(
        self, walk: Walk, low: int, high: int, limit: int, *, lacking: int | None = None,
        width: int, urge: float, noise: float = 0.0,
    ) -> Walk | None:  # fmt: skip
        """The walk with the poses between low and high replaced, by at most `limit` steps, that show as much.

        Args:
            walk: Poses.
            low: Pose that stays.
            high: The next that stays; at the end of the walk the new end is free.
            limit: Most steps from one to the other.
            lacking: How many of those that the cut poses alone showed may be lost; as many of all as the task
                allows unless given.
            width: Of the beam.
            urge: Of the beam.
            noise: Of the beam.
        """
        last = high >= len(walk)
        outside = self.counts(walk[: low + 1] + walk[high:])
        wanted = self.open & (outside == 0)
        allowed = self.may_miss
        if lacking is not None:
            wanted &= self.counts(walk[low + 1 : high]) > 0
            allowed = lacking
        if int(wanted.sum()) <= allowed:
            # Nothing is left to show but the way.
            wanted &= False
        found = self.beam(
            walk[low],
            None if last else walk[high],
            wanted,
            limit,
            allowed,
            width=width,
            urge=urge,
            noise=noise,
        )
        if found is None:
            return None
        return walk[: low + 1] + found + ([] if last else walk[high + 1 :])

    def polish(self, walk: Walk, until: float, tries: int, *, before: Walk | None = None) -> Walk:
        """Search windows of the walk again, until `tries` in a row have made it no shorter.

        Args:
            walk: Poses.
            until: Processor time to end at.
            tries: See above.
            before: A walk that was polished already: only where this one differs are windows cut.
        """
        old = set(before or ())
        idle = 0
        while idle < tries and thread_time() < until:
            fresh = [k for k, pose in enumerate(walk) if pose not in old]
            if not fresh or len(walk) < 3:
                break
            size = int(self.rng.integers(3, min(14, max(4, len(walk)))))
            low = max(0, int(self.rng.choice(fresh)) - int(self.rng.integers(0, size + 1)))
            high = min(len(walk), low + size)
            steps = high - low - (high == len(walk))
            if steps < 2:
                continue
            strict = bool(self.rng.random() < 0.7)
            new = self.window(
                walk, low, high, steps - strict, width=150, noise=0.0 if strict else 0.5,
                lacking=0 if self.rng.random() < 0.3 else None,
                urge=float(self.rng.choice([4.0, 8.0, 16.0, 32.0])),
            )  # fmt: skip
            idle += 1
            if new is not None:
                if len(new) < len(walk):
                    idle = 0
                walk = new
                self.offer(walk)
        return walk

    def disturbed(self, walk: Walk) -> Walk | None:
        """Leave out a stretch, or all around a place, go straight instead, and put in what that lost."""
        places = self.graph.kernel.places[[pose[0] for pose in walk]].astype(np.float64)
        centre = int(self.rng.integers(len(walk)))
        if self.rng.random() < 0.5:
            size = int(self.rng.integers(2, 12))
            cut = (np.arange(len(walk)) >= centre) & (np.arange(len(walk)) < centre + size)
        else:
            away = np.linalg.norm(places - places[centre], axis=1)
            cut = away < self.rng.uniform(1.0, 4.0) * self.graph.kernel.stride
        cut[0] = False
        shorter = self.joined([pose for pose, gone in zip(walk, cut, strict=True) if not gone])
        return None if shorter is None else self.complete(shorter)

    def built(self) -> Walk | None:
        """A walk built anew."""
        walk = self.complete([self.graph.start], share=float(self.rng.uniform(0.3, 0.7)))
        return None if walk is None else self.rewired(walk)

    def rewired(self, walk: Walk) -> Walk | None:
        """A walk past what this one is needed for, in another order."""
        again = self.joined(self.reordered(self.needed(walk)))
        return None if again is None else self.complete(again)

    def run(self, until: float) -> Iterator[int]:
        """Search until a time; yields the steps of the best walk, now and then and whenever it is shorter."""
        began = thread_time()
        every: list[Walk] = [] if self.best is None else [self.best]
        first_until = began + STARTS * (until - began)
        while not every or thread_time() < first_until:
            walk = self.built()
            if walk is None:
                if not every and thread_time() > until:
                    return
                continue
            self.offer(walk)
            every.append(self.polish(walk, min(until, thread_time() + 0.25 * (first_until - began)), 25))
            self.offer(every[-1])
            if self.best is not None:
                yield len(self.best) - 1
        current = min(every, key=len)
        while thread_time() < until and self.best is not None:
            before, kind = len(self.best), self.rng.random()
            if kind < 0.05:
                current = self.best
            new = self.rewired(current) if kind > 0.9 else self.disturbed(current)
            if new is not None:
                new = self.polish(new, until, 15, before=current)
                self.offer(new)
                if len(new) - len(current) <= HEAT * self.rng.exponential():
                    current = new
            if len(self.best) < before:
                current = self.best
                yield len(self.best) - 1


def best_tour(
    graph: SpaceGraph,
    may_miss: int,
    *,
    hints: Sequence[Walk] = (),
    budget_s: float,
    seed: int = 0,
    enough: int = 0,
) -> Iterator[tuple[int, ...]]:
    """Ever shorter walks that leave at most `may_miss` individuals not inspected; none where none was found.

    Args:
        graph: The world as nodes, moves and frames.
        may_miss: Individuals that may stay.
        hints: Walks to begin with, complete or not.
        budget_s: Seconds of processor time. How far a search gets in them depends on the machine.
        seed: Of all that is left to chance.
        enough: A tour this short ends the search: no walk is shorter.

    Yields:
        Actions after the look-around.
    """
    until = thread_time() + budget_s
    search = _SpaceSearch(graph, may_miss, seed)
    if int(search.open.sum()) <= may_miss:
        yield ()
        return
    for hint in hints:
        search.offer(search.complete(list(hint)))
    if search.best is not None:
        yield graph.actions_between(search.best)
    if search.best is not None and len(search.best) - 1 <= enough:
        return
    shortest = len(search.best) if search.best is not None else LONGEST + 2
    for _ in search.run(until):
        if search.best is not None and len(search.best) < shortest:
            shortest = len(search.best)
            yield graph.actions_between(search.best)
            if shortest - 1 <= enough:
                return
