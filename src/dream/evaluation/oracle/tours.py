"""Short clairvoyant walks: the best known tour of a world, an upper bound beside the certified lower one.

A tour starts after the look-around and leaves at most `may_miss` countable individuals unseen. It is built
by insertion at the cheapest place, then windows of it are cut out and solved again for what they alone
showed (large neighbourhood search); beams over whole walks compete with that. Both are one search: the
shortest walk between two poses that sees what is wanted (`_connect`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.compiling import thread_time
from dream.evaluation.oracle._kernels import tours as _kernels
from dream.evaluation.oracle.graph import Int32Array, PoseGraph, UInt64Array

LONGEST = 250
"""Actions of the longest walk looked for; distances are bytes."""
LANDMARKS = 48
"""Individuals far apart that the beams over whole walks tell the way left by."""
START_S = 8.0
"""Seconds for a walk built anew; the best of some is then improved."""
START_SHARE = 0.3
"""Share of the time for those."""
BEAM_SHARE = 0.2
"""Share of the time for beams over whole walks."""
WIDEST = 30_000
"""Walks kept of a layer by the widest of them."""
HEAT = 0.7
"""Steps: the mean of how much longer a changed walk may be to be kept."""

IntpArray = npt.NDArray[np.intp]
UInt8Array = npt.NDArray[np.uint8]
Float64Array = npt.NDArray[np.float64]


def follow(graph: PoseGraph, trace: npt.NDArray[np.float64]) -> tuple[int, ...]:
    """A walk from the start through the poses of a trace, by the shortest way where two are no move apart.

    Args:
        graph: The world.
        trace: (n, 3) x, y and yaw; a pose that is none of the graph's is left out.
    """
    number = {pose: p for p, pose in enumerate(map(_rounded, graph.poses))}
    known = [number[pose] for pose in map(_rounded, trace) if pose in number]
    return tuple(_through(_reversed(graph), graph.arcs, [graph.start, *known]))


def _rounded(pose: npt.NDArray[np.float64]) -> tuple[int, int, int]:
    """Millimetres and whole degrees in [0, 360): what tells lattice poses apart."""
    return round(1e3 * pose[0]), round(1e3 * pose[1]), round(math.degrees(pose[2])) % 360


def _reversed(graph: PoseGraph) -> tuple[npt.NDArray[np.int64], Int32Array]:
    first, source = _kernels.reverse(np.ascontiguousarray(graph.arcs))
    return first, source


def _through(
    arcs_to: tuple[npt.NDArray[np.int64], Int32Array], arcs: Int32Array, poses: Sequence[int]
) -> list[int]:
    """Actions of the shortest walk through poses, one after the other; those out of reach are left out."""
    walk: list[int] = []
    here = poses[0]
    for goal in poses[1:]:
        straight = np.flatnonzero(arcs[here] == goal)
        if here == goal:
            continue
        if len(straight):
            walk.append(int(straight[0]))
            here = goal
            continue
        back = _steps_to(*arcs_to, np.array([goal]))
        if back[here] == _kernels.FAR:
            continue
        while here != goal:
            row = arcs[here]
            action = int(np.where(row >= 0, back[row], _kernels.FAR).argmin())
            walk.append(action)
            here = int(row[action])
    return walk


def missed(graph: PoseGraph, actions: Sequence[int]) -> int:
    """Individuals that the look-around and the walk leave unseen.

    Raises:
        ValueError: The walk is none.
    """
    seen = graph.seen(graph.walk(actions))
    return len(graph.individuals) - int(np.bitwise_count(seen).sum())


def trimmed(graph: PoseGraph, may_miss: int, actions: Sequence[int]) -> tuple[int, ...] | None:
    """The walk as far as it takes to leave at most `may_miss` unseen; None where that is too much to ask.

    Raises:
        ValueError: The walk is none.
    """
    views = graph.views[graph.walk(actions)]
    views[0] |= graph.shown
    seen = np.bitwise_count(np.bitwise_or.accumulate(views, axis=0)).sum(axis=1, dtype=np.int64)
    enough = np.flatnonzero(len(graph.individuals) - seen <= may_miss)
    return tuple(actions[: enough[0]]) if len(enough) else None


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """A graph with what every search on it needs."""

    graph: PoseGraph
    arcs: Int32Array
    first: npt.NDArray[np.int64]
    source: Int32Array
    watch: UInt64Array
    """(N, ⌈P / 64⌉) the poses that see each individual."""
    rarity: Float64Array
    """(N,) 1 over the number of those."""
    stride: float
    """Metres of the longest move."""

    def floor(self, end: int | None) -> UInt8Array:
        """(P,) steps that any way from each pose to the end takes, by the straight distance."""
        poses = self.graph.poses
        if end is None:
            return np.zeros(len(poses), np.uint8)
        away = np.hypot(poses[:, 0] - poses[end, 0], poses[:, 1] - poses[end, 1])
        floor: UInt8Array = np.minimum(np.ceil(away / self.stride - 1e-6), _kernels.FAR - 1).astype(np.uint8)
        return floor

    def steps_to(self, individual: int) -> UInt8Array:
        """(P,) fewest steps from each pose to where it sees the individual."""
        return _steps_to(self.first, self.source, _kernels.members(self.watch[individual]))


def _scene(graph: PoseGraph) -> _Scene:
    arcs = np.ascontiguousarray(graph.arcs)
    first, source = _kernels.reverse(arcs)
    watch = _kernels.transposed(graph.views, len(graph.individuals))
    sizes = np.bitwise_count(watch).sum(axis=1, dtype=np.int64)
    ends = graph.poses[arcs, :2] - graph.poses[:, None, :2]
    stride = float(np.hypot(ends[..., 0], ends[..., 1])[arcs >= 0].max(initial=0.0))
    return _Scene(graph, arcs, first, source, watch, 1.0 / np.maximum(sizes, 1), stride or 1.0)


def _inner(arcs: Int32Array, nodes: Int32Array) -> tuple[Int32Array, Int32Array]:
    """The moves among some poses, renumbered, and the numbers: −1 for the poses left out."""
    index = np.full(len(arcs), -1, np.int32)
    index[nodes] = np.arange(len(nodes), dtype=np.int32)
    return _kernels.inner_arcs(arcs, nodes, index), index


def _steps_to(
    first: npt.NDArray[np.int64], source: Int32Array, goals: IntpArray, costs: UInt8Array | None = None
) -> UInt8Array:
    if costs is None:
        ordered, by_cost = goals, np.zeros(len(goals), np.int64)
    else:
        order = np.argsort(costs[goals], kind="stable")
        ordered, by_cost = goals[order], costs[goals[order]].astype(np.int64)
    steps: UInt8Array = _kernels.steps_to(first, source, ordered.astype(np.int64), by_cost, LONGEST)
    return steps


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The poses that a walk between two poses can use, renumbered, and what of the wanted they see."""

    arcs: Int32Array
    first: npt.NDArray[np.int64]
    source: Int32Array
    views: UInt64Array
    watch: UInt64Array
    wanted: IntpArray
    """(R,) individuals of the graph, without those seen whenever another is, where none may be missed."""
    togo: UInt8Array
    begin: int
    anchored: bool
    may_miss: int
    landmarks: npt.NDArray[np.int64]
    approach: UInt8Array
    detour: UInt8Array
    between: Float64Array


def _part(
    scene: _Scene, begin: int, end: int | None, wanted: IntpArray, limit: int, may_miss: int, landmarks: int
) -> _Part | None:
    """What of the graph a walk of at most `limit` steps can use; None where none can see what is wanted."""
    out, nodes = _kernels.steps_from(scene.arcs, np.array([begin]), scene.floor(end), limit)
    arcs, index = _inner(scene.arcs, nodes)
    first, source = _kernels.reverse(arcs)
    togo = np.zeros(len(nodes), np.uint8)
    if end is not None:
        if index[end] < 0:
            return None
        togo = _steps_to(first, source, np.array([index[end]]))
        near = np.flatnonzero(out[nodes].astype(np.int64) + togo <= limit).astype(np.int32)
        if not len(near):
            return None
        nodes, togo = nodes[near], togo[near]
        arcs, index = _inner(scene.arcs, nodes)
        first, source = _kernels.reverse(arcs)
    views = _kernels.columns(scene.graph.views, nodes, wanted)
    watch = _kernels.transposed(views, len(wanted))
    visible = watch.any(axis=1)
    may_miss -= len(wanted) - int(visible.sum())
    if may_miss < 0:
        return None
    keep = visible
    if may_miss == 0 and len(wanted) * len(nodes) < 30_000_000:
        keep = visible & ~_kernels.implied(watch)
    if not keep.all():
        chosen = np.flatnonzero(keep)
        wanted, watch = wanted[chosen], np.ascontiguousarray(watch[chosen])
        views = _kernels.columns(views, np.arange(len(nodes)), chosen)
    marks, approach, detour, between = _landmarks(first, source, watch, togo, end is not None, landmarks)
    return _Part(
        arcs, first, source, views, watch, wanted, togo, int(index[begin]), end is not None, may_miss,
        marks, approach, detour, between,
    )  # fmt: skip


def _landmarks(
    first: npt.NDArray[np.int64],
    source: Int32Array,
    watch: UInt64Array,
    togo: UInt8Array,
    anchored: bool,
    most: int,
) -> tuple[npt.NDArray[np.int64], UInt8Array, UInt8Array, Float64Array]:
    """Individuals far apart, the rarest first, and the distances to and between them."""
    count, n = len(watch), len(togo)
    chosen: list[int] = []
    approaches: list[UInt8Array] = []
    apart: list[UInt8Array] = []
    if count and most:
        size = np.bitwise_count(watch).sum(axis=1, dtype=np.int64)
        spread = np.full(count, 255, np.int64)
        while len(chosen) < most:
            pick = int(np.lexsort((size, -spread))[0])
            if spread[pick] == 0:
                break
            chosen.append(pick)
            approaches.append(_steps_to(first, source, _kernels.members(watch[pick])))
            apart.append(_kernels.nearest(watch, approaches[-1]))
            spread = np.minimum(spread, apart[-1])
            spread[pick] = 0
    marks = np.array(chosen, np.int64)
    approach = np.stack(approaches, axis=1) if chosen else np.empty((n, 0), np.uint8)
    detour = approach
    if anchored and chosen:
        detour = np.stack(
            [_steps_to(first, source, _kernels.members(watch[i]), togo) for i in chosen], axis=1
        )
    between = np.zeros((len(chosen) + 1, len(chosen) + 1))
    for k in range(len(chosen)):
        between[k, :-1] = apart[k][marks]
        if anchored:
            between[k, -1] = between[-1, k] = togo[_kernels.members(watch[marks[k]])].min()
    between[:-1, :-1] = np.minimum(between[:-1, :-1], between[:-1, :-1].T)
    return marks, np.ascontiguousarray(approach), np.ascontiguousarray(detour), between


def _beam(
    part: _Part,
    weights: Float64Array,
    limit: int,
    *,
    width: int,
    crowd: int,
    urge: float,
    noise: float,
    rng: np.random.Generator,
) -> tuple[list[int] | None, npt.NDArray[np.int64]]:
    """The actions of a walk through a part, None where the beam found none, and what it then lacked."""
    share = weights / max(weights.sum(), 1e-12)
    length, actions, end, lacking = _kernels.beam(
        part.arcs, part.views, share, part.togo, part.landmarks, part.approach, part.detour, part.between,
        part.anchored, part.begin, np.zeros(part.views.shape[1], np.uint64), min(limit, LONGEST),
        part.may_miss, width, crowd, urge, noise, rng,
    )  # fmt: skip
    if length < 0:
        return None, lacking
    walk = [int(a) for a in actions]
    while part.togo[end] > 0:
        row = part.arcs[end]
        steps = np.where(row >= 0, part.togo[row], 255)
        action = int(steps.argmin())
        walk.append(action)
        end = int(row[action])
    return walk, lacking


class _Bones:
    """A walk reduced to groups of poses, of each of which one must be passed.

    A generalized travelling salesman: all distances between the poses are known, so that orders are cheap
    to compare.
    """

    def __init__(self, scene: _Scene, start: int, groups: Sequence[npt.NDArray[Any]]) -> None:
        self.scene = scene
        poses = list(dict.fromkeys([start, *(int(pose) for group in groups for pose in group)]))
        number = {pose: k for k, pose in enumerate(poses)}
        self.poses = np.array(poses)
        self.first = np.cumsum([0, *map(len, groups)]).astype(np.int64)
        self.member = np.array([number[int(pose)] for group in groups for pose in group], np.int64)
        nowhere = np.zeros(len(scene.arcs), np.uint8)
        self.between = np.stack(
            [_kernels.steps_from(scene.arcs, np.array([p]), nowhere, LONGEST)[0][self.poses] for p in poses]
        )

    def walk(self, rounds: int, hot: float, rng: np.random.Generator) -> list[int]:
        """Actions of a short walk past all groups; the search begins with the order that they came in."""
        order = np.arange(len(self.first) - 1)
        chosen = _kernels.anneal(
            self.between[0], self.between, self.first, self.member, order, len(order), rounds, hot, 0.15, rng
        )
        scene = self.scene
        return _through((scene.first, scene.source), scene.arcs, [int(self.poses[0]), *self.poses[chosen]])


class _Search:
    """One search for a tour: the walk as it is, and the best so far."""

    def __init__(self, scene: _Scene, may_miss: int, seed: int) -> None:
        self.scene = scene
        self.graph = scene.graph
        self.may_miss = may_miss
        self.rng = np.random.default_rng(seed)
        count = len(self.graph.individuals)
        shown = np.zeros(count, np.bool_)
        shown[_kernels.members(self.graph.shown | self.graph.views[self.graph.start])] = True
        self.open: IntpArray = np.flatnonzero(~shown)
        self.best: list[int] | None = None

    def counts(self, poses: Sequence[int]) -> npt.NDArray[np.int64]:
        """(N,) how many of the poses see each individual."""
        bits = self.graph.views[np.asarray(poses, np.intp)].astype("<u8").view(np.uint8)
        seen = np.unpackbits(bits, axis=1, bitorder="little")[:, : len(self.graph.individuals)]
        counts: npt.NDArray[np.int64] = seen.sum(axis=0, dtype=np.int64)
        return counts

    def unseen(self, walk: Sequence[int]) -> IntpArray:
        """Individuals that the walk leaves unseen."""
        counts = self.counts(self.graph.walk(walk))
        lacking: IntpArray = self.open[counts[self.open] == 0]
        return lacking

    def window(
        self,
        walk: list[int],
        low: int,
        high: int,
        limit: int,
        *,
        more: Sequence[int] = (),
        lacking: int | None = None,
        width: int = 400,
        urge: float = 4.0,
        noise: float = 0.0,
    ) -> list[int] | None:
        """The walk with actions low to high replaced by at most `limit` others that show as much.

        Args:
            walk: Actions.
            low: First action cut out.
            high: End of what is cut out; at the end of the walk the new end is free.
            limit: Most actions to put in.
            more: Individuals to be seen as well.
            lacking: How many individuals may be unseen after it; as many as the task allows unless given.
            width: Of the beam.
            urge: Of the beam.
            noise: Of the beam.
        """
        poses = self.graph.walk(walk)
        last = high == len(walk)
        outside = poses[: low + 1] + ([] if last else poses[high:])
        counts = self.counts(outside)
        inside = self.counts(poses[low + 1 : high] + ([poses[high]] if last else []))
        if lacking is None:
            wanted = self.open[counts[self.open] == 0]
            allowed = self.may_miss
            if allowed == 0 and len(more) == 0:
                wanted = wanted[inside[wanted] > 0]
        else:
            wanted = self.open[(counts[self.open] == 0) & (inside[self.open] > 0)]
            wanted = np.union1d(wanted, np.asarray(more, np.intp))
            allowed = lacking
        if not len(wanted):
            return None
        part = _part(
            self.scene,
            poses[low],
            None if last else poses[high],
            wanted,
            limit,
            allowed,
            0 if allowed else 12,
        )
        if part is None:
            return None
        weights = np.sqrt(self.scene.rarity[part.wanted])
        found, _ = _beam(part, weights, limit, width=width, crowd=8, urge=urge, noise=noise, rng=self.rng)
        return None if found is None else walk[:low] + found + walk[high:]

    def insert(self, walk: list[int], individual: int) -> list[int] | None:
        """The walk, lengthened by as little as can be found, so that it shows an individual as well."""
        field = self.scene.steps_to(individual)
        away = field[np.asarray(self.graph.walk(walk))].astype(int)
        shortest: list[int] | None = None
        tried: list[int] = []
        for k in np.argsort(away, kind="stable"):
            if len(tried) == 3:
                break
            if any(abs(int(k) - t) < 3 for t in tried):
                continue
            tried.append(int(k))
            low, high = max(0, int(k) - 3), min(len(walk), int(k) + 3)
            limit = high - low + 2 * int(away[k]) + 4
            if shortest is not None:
                limit = min(limit, high - low + len(shortest) - len(walk) - 1)
            if limit >= high - low:
                new = self.window(walk, low, high, limit, more=[individual], lacking=0, width=150)
                shortest = new or shortest
        return shortest

    def complete(self, walk: list[int], longest: int) -> list[int] | None:
        """Insert what is missing, in an order of chance that prefers the rare, until little enough is."""
        nowhere = np.zeros(len(self.graph.poses), np.uint8)
        while True:
            lacking = self.unseen(walk)
            if len(lacking) <= self.may_miss:
                return walk
            poses = np.array(self.graph.walk(walk))
            steps, _ = _kernels.steps_from(self.scene.arcs, poses, nowhere, LONGEST)
            away = _kernels.nearest(self.scene.watch[lacking], steps).astype(np.float64)
            # Where all must be seen, the far ones shape the walk; where some may be missed, it is them.
            chance = self.rng.exponential(size=len(lacking))
            keys = away * chance if self.may_miss == 0 else -away - chance
            new = self.insert(walk, int(lacking[keys.argmax()]))
            if new is None or len(new) > longest:
                return None
            walk = new

    def pruned(self, walk: Sequence[int]) -> list[int]:
        """The walk in hindsight: without poses whose loss leaves no more unseen, joined the shortest way."""
        poses = self.graph.walk(walk)
        counts = self.counts(poses)[self.open]
        shows = np.stack([self.counts([pose])[self.open] for pose in poses])
        kept = np.ones(len(poses), np.bool_)
        for k in np.argsort(shows.sum(axis=1), kind="stable"):
            if k > 0 and (counts - shows[k])[counts > 0].min(initial=1) > 0:
                counts = counts - shows[k]
                kept[k] = False
        scene = self.scene
        return _through((scene.first, scene.source), scene.arcs, [poses[k] for k in np.flatnonzero(kept)])

    def offer(self, walk: list[int] | None) -> bool:
        """Keep a walk that is a shorter tour than the best."""
        tour = None if walk is None else trimmed(self.graph, self.may_miss, walk)
        if tour is None or (self.best is not None and len(tour) >= len(self.best)):
            return False
        self.best = list(tour)
        return True

    def beams(self, part: _Part, weights: Float64Array, width: int, limit: int) -> Float64Array:
        """One beam over whole walks; gives the weights for the next, heavier for what this one lacked."""
        found, lacking = _beam(
            part,
            weights,
            limit,
            width=width,
            crowd=int(self.rng.choice([2, 4, 8])),
            urge=float(self.rng.choice([10.0, 20.0, 40.0, 80.0])),
            noise=float(self.rng.choice([0.0, 0.2])),
            rng=self.rng,
        )
        self.offer(found)
        heavier = weights * np.where(lacking > 0, 1.5, 1.0)
        # They count by their shares; in a long search they would grow or vanish without bounds.
        return np.maximum(heavier / float(heavier.max(initial=1e-12)), 1e-6).astype(np.float64)

    def reorder(self, walk: list[int], *, hot: float = 1.5, rounds: int = 6000, most: int = 10) -> list[int]:
        """A walk past what this one is needed for, in another order and from other poses."""
        poses = np.array(self.graph.walk(walk))
        views = self.graph.views
        left = _kernels.bits(self.open, views.shape[1])
        needed: dict[int, UInt64Array] = {}
        spare = self.may_miss
        while True:
            gains = np.bitwise_count(views[poses] & left).sum(axis=1, dtype=np.int64)
            if int(np.bitwise_count(left).sum()) <= spare or not gains.any():
                break
            k = int((gains * self.rng.uniform(0.3, 1.0, len(gains))).argmax())
            needed[k] = views[poses[k]] & left
            left = left & ~views[poses[k]]
        groups = []
        for k in sorted(needed):
            words = np.flatnonzero(needed[k])
            alike = np.flatnonzero(((views[:, words] & needed[k][words]) == needed[k][words]).all(axis=1))
            if len(alike) > most:
                away = self.graph.poses[alike, :2] - self.graph.poses[poses[k], :2]
                near = np.hypot(away[:, 0], away[:, 1]) * self.rng.uniform(0.3, 1.0, len(alike))
                alike = alike[np.argsort(near)[:most]]
            groups.append(np.union1d(alike, [poses[k]]))
        return _Bones(self.scene, self.graph.start, groups).walk(rounds, hot, self.rng)

    def disturb(self, walk: list[int]) -> list[int] | None:
        """Leave out a stretch, or all around a place, go straight instead, and insert what that lost."""
        poses = np.array(self.graph.walk(walk))
        centre = int(self.rng.integers(len(poses)))
        if self.rng.random() < 0.5:
            size = int(self.rng.integers(2, 12))
            cut = (np.arange(len(poses)) >= centre) & (np.arange(len(poses)) < centre + size)
        else:
            away = self.graph.poses[poses, :2] - self.graph.poses[poses[centre], :2]
            cut = np.hypot(away[:, 0], away[:, 1]) < self.rng.uniform(1.0, 4.0) * self.scene.stride
        cut[0] = False
        scene = self.scene
        shorter = _through((scene.first, scene.source), scene.arcs, [int(pose) for pose in poses[~cut]])
        return self.complete(shorter, len(walk) + 4)

    def polish(
        self, walk: list[int], until: float, tries: int, *, before: Sequence[int] | None = None
    ) -> list[int]:
        """Solve windows of the walk again, until `tries` in a row have made it no shorter.

        Args:
            walk: Actions.
            until: Processor time to end at.
            tries: See above.
            before: A walk that was polished already: only where this one differs are windows cut.
        """
        old = set() if before is None else set(self.graph.walk(before))
        idle = 0
        while idle < tries and thread_time() < until:
            size = int(self.rng.integers(3, min(16, max(4, len(walk)))))
            fresh = [k for k, pose in enumerate(self.graph.walk(walk)) if pose not in old]
            if not fresh:
                break
            low = int(self.rng.choice(fresh)) - int(self.rng.integers(0, size + 1))
            low, high = max(0, low), min(len(walk), max(0, low) + size)
            strict = self.rng.random() < 0.6
            # Now and then with the unseen left as they are: fewer are wanted then, which is easier.
            new = self.window(
                walk, low, high, high - low - strict, noise=0.0 if strict else 0.5,
                lacking=0 if self.rng.random() < 0.5 else None,
                urge=float(self.rng.choice([2.0, 4.0, 8.0, 16.0])),
            )  # fmt: skip
            idle += 1
            if new is not None:
                if len(new) < len(walk):
                    idle = 0
                walk = new
                self.offer(walk)
        return walk

    def run(self, until: float) -> Iterator[int]:
        """Search until a time; yields the length of the best walk whenever there is a shorter one."""
        began = thread_time()
        whole = _part(self.scene, self.graph.start, None, self.open, LONGEST, self.may_miss, LANDMARKS)
        if whole is None:
            return
        weights = self.scene.rarity[whole.wanted] ** 0.5
        width, in_beams = 1000, 0.0
        for first in (100, 300):
            self.beams(whole, weights, first, LONGEST if self.best is None else len(self.best) - 1)
        if self.best is not None:
            yield len(self.best)
        current = self.start(began + START_SHARE * (until - began))
        if current is None:
            return
        yield len(self.best or current)
        while thread_time() < until and self.best:
            before, now = len(self.best), thread_time()
            kind = self.rng.random()
            if in_beams <= BEAM_SHARE * (now - began):
                weights = self.beams(whole, weights, width, before - 1)
                width = min(2 * width, WIDEST)
                in_beams += thread_time() - now
            elif kind < 0.03:
                current = self.best
            else:
                current = self.change(current, until, rewire=kind < 0.1)
            if len(self.best) < before:
                current = self.best
                yield len(self.best)

    def start(self, until: float) -> list[int] | None:
        """The best of some walks that were each built anew and improved for a while."""
        every = [] if self.best is None else [self.polish(self.best, until, 40)]
        while not every or thread_time() + START_S <= until:
            end = min(until, thread_time() + START_S)
            walk = self.complete([], LONGEST)
            if walk is None:
                break
            self.offer(walk)
            walk = self.polish(walk, end, 40)
            while thread_time() < end:
                walk = self.change(walk, end)
            every.append(walk)
        return min(every, key=len, default=None)

    def change(self, walk: list[int], until: float, *, rewire: bool = False) -> list[int]:
        """The walk disturbed, or in another order, and repaired; as it was where that is much longer."""
        new = self.reorder(walk, hot=3.0) if rewire else self.disturb(walk)
        new = None if new is None else self.complete(new, len(walk) + 4)
        if new is None:
            return walk
        new = self.polish(new, until, 15, before=walk)
        self.offer(new)
        return new if len(new) - len(walk) <= HEAT * self.rng.exponential() else walk


def best_tour(
    graph: PoseGraph,
    may_miss: int,
    *,
    hints: Sequence[Sequence[int]] = (),
    budget_s: float,
    seed: int = 0,
    enough: int = 0,
) -> tuple[int, ...] | None:
    """The shortest walk found that leaves at most `may_miss` individuals unseen.

    Args:
        graph: The world as poses, moves and views.
        may_miss: Individuals that may stay unseen.
        hints: Walks to begin with, complete or not.
        budget_s: Seconds of processor time. How far a search gets in them depends on the machine: only a
            tour that was found in time is the same again with the same seed.
        seed: Of all that is left to chance.
        enough: A tour this short ends the search: no walk is shorter.

    Returns:
        Actions after the look-around; None where no walk of at most `LONGEST` actions was found.
    """
    until = thread_time() + budget_s
    search = _Search(_scene(graph), may_miss, seed)
    if len(search.open) <= may_miss:
        return ()
    for hint in hints:
        if search.best is not None and thread_time() >= until:
            break
        search.offer(search.complete(search.pruned(hint), LONGEST))
        search.offer(search.complete(list(hint), LONGEST))
    if search.best is None or len(search.best) > enough:
        for length in search.run(until):
            if length <= enough:
                break
    return None if search.best is None else tuple(search.best)
