"""Certified lower bounds on the actions that any collision-free walk needs.

A witness is a set of individuals; it is heard when one of them is seen. A walk misses all individuals of
the witnesses that it does not hear, so one that is good enough hears so many that the others hold no more
than may be missed. The fewest actions to hear so many of some witnesses, found by an exact search over (pose,
witnesses heard), are therefore a lower bound. Witnesses are added where the shortest walks that hear enough
of the present ones still miss too much, until such a walk misses no more than allowed (then it is an
optimum), or no walk of that length hears enough (then the bound grows), or the budget is spent.

Small witnesses say what a large one cannot: which of many places are left out together.

What makes the search short: every round knows, from the round before it, which states a walk within the limit
can pass at all, and at least how many actions each of them lacks. It looks only there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from dream.compiling import thread_time
from dream.evaluation.oracle._kernels import search
from dream.evaluation.oracle.graph import BoolArray, Int32Array, PoseGraph, UInt64Array

Int64Array = npt.NDArray[np.int64]
UInt8Array = npt.NDArray[np.uint8]
Witness = tuple[int, ...]

CORE = 9
"""Witnesses with an exact table of the actions to go for every set of them: 512 rows."""
PARTS = 4
"""Witnesses that what may be missed is cut into: more of them bind a walk closer, and fill a mask sooner."""
NEW = 2
"""Witnesses from which on a round adds no more."""
MOST = 128
"""Witnesses in all: the bits of a mask."""
SPARE = 4
"""How much more a state counts that leaves one more action to spare, when a bottleneck is looked for."""
WIDTH = 100
"""Walks kept at a time in looking for one that sees much."""
LARGE = 1_000_000
"""States of a proof from which it is worth while to look for a better core."""
ROOM = 60_000_000
"""States that a search may hold: 1.4 GB, twice that to find the steps to go, 1 GB of fronts."""
CHUNK = 20_000
"""States expanded between two looks at the clock."""
LONGEST = search.FAR - 1
"""No longer walk is looked for: a table has bytes."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """A lower bound, and what it takes to check it."""

    length: int
    """No walk from `graph.start` with fewer actions leaves at most `may_miss` individuals unseen."""
    witnesses: tuple[Witness, ...]
    """Each a set of individuals, as indices into `graph.individuals`. On every walk with fewer actions than
    `length`, those of which it sees nothing hold more than `may_miss` individuals."""
    walks: tuple[tuple[int, ...], ...]
    """Shortest walks past the witnesses of a round, as actions, those that see most; the last one is an
    optimum where it has `length` actions and leaves at most `may_miss` unseen."""
    unsettled: tuple[Witness, ...] = ()
    """More witnesses: of the round that the end of the budget broke off. The bound does not need them; a
    search that goes on does not have to find them again."""


def certify(
    graph: PoseGraph,
    may_miss: int,
    *,
    tour: Sequence[int] | None,
    budget_s: float,
    witnesses: Sequence[Sequence[int]] = (),
    length: int = 0,
) -> Certificate:
    """A lower bound on the actions of any walk that leaves at most `may_miss` individuals unseen.

    Equal arguments give equal certificates as long as the budget does not end the search. It may be overrun
    by a few seconds. Takes 0.3 GB at least and 4 GB at most.

    Args:
        graph: What the walk moves on and sees.
        may_miss: Individuals that may stay unseen.
        tour: A walk that is good enough, as actions; the search ends when it is proved to be shortest.
        budget_s: CPU seconds of the calling thread.
        witnesses: Those of an earlier certificate, and its unsettled ones, to begin with.
        length: Of that certificate. The search begins there, but it is not taken on trust: the new
            certificate says only what this search has shown, which may be less where the budget ends early.

    Raises:
        ValueError: `may_miss` or `length` is negative, more individuals than may be missed can never be seen,
            the tour is not good enough, or a witness is none.
    """
    unseen = _unseen(graph, may_miss)
    if (
        tour is not None
        and (lacking := len(_members(_everything(graph) & ~graph.seen(graph.walk(tour))))) > may_miss
    ):
        raise ValueError(
            f"tour: expected a walk that misses at most {may_miss} individuals, got one that misses {lacking}"
        )
    _check_witnesses(witnesses, unseen)
    if length < 0:
        raise ValueError(f"length: expected 0 or more, got {length}")
    if len(unseen) <= may_miss:
        return Certificate(0, (), ())
    product = _Product(graph, may_miss, thread_time() + budget_s)
    hopeless = len(unseen) - len(product.nearest([graph.start], unseen))
    if hopeless > may_miss:
        raise ValueError(
            f"graph: expected at most {may_miss} individuals that no walk from the start sees, got {hopeless}"
        )
    proof = _Proof(product, LONGEST if tour is None else min(len(tour), LONGEST))
    unsettled: list[Witness] = []
    try:
        proof.lengthen([tuple(witness) for witness in witnesses], length)
    except _SpentError:
        old = {*map(tuple, witnesses), *proof.witnesses}
        unsettled = [witness for witness in product.witnesses if witness not in old]
    return Certificate(proof.length, proof.witnesses, tuple(proof.walks), tuple(unsettled))


def verify(graph: PoseGraph, may_miss: int, witnesses: Sequence[Sequence[int]], length: int) -> bool:
    """Does no walk with fewer than `length` actions hear enough of the witnesses? Searches again, wholly.

    How the witnesses were found plays no part: the first few get a table, the others are added in turn to an
    exact search for walks of `length` − 1 actions, until there is none or no witness is left.

    Raises:
        ValueError: `may_miss` is negative, or a witness is empty, or has an individual that the look-around
            shows or that does not exist, or there are more than 128 of them.
    """
    _check_witnesses(witnesses, _unseen(graph, may_miss))
    if length <= 0 or not witnesses:
        return length <= 0
    if length > LONGEST:
        raise ValueError(f"length: expected at most {LONGEST}, got {length}")
    product = _Product(graph, may_miss, float("inf"))
    for witness in witnesses[:CORE]:
        product.add(witness)
    return product.past(length - 1, [tuple(witness) for witness in witnesses[CORE:]]) is None


class _SpentError(Exception):
    """The budget of time, memory or witnesses is spent."""


@dataclass(frozen=True, slots=True, eq=False)
class _Arcs:
    """Those of pose p lead to `to[first[p] : first[p + 1]]`."""

    first: Int64Array
    to: Int32Array

    @property
    def reversed(self) -> _Arcs:
        begins = np.repeat(np.arange(len(self.first) - 1, dtype=np.int32), np.diff(self.first))
        counts = np.bincount(self.to, minlength=len(self.first) - 1)
        return _Arcs(_cumulated(counts), begins[np.argsort(self.to, kind="stable")])


def _arcs(graph: PoseGraph) -> _Arcs:
    there = graph.arcs >= 0
    return _Arcs(_cumulated(there.sum(axis=1)), graph.arcs[there].astype(np.int32))


def _cumulated(counts: Int64Array) -> Int64Array:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _bits(individuals: Iterable[int], words: int) -> UInt64Array:
    bits = np.zeros(words, np.uint64)
    for i in individuals:
        bits[i // 64] |= np.uint64(1 << (i % 64))
    return bits


def _members(bits: UInt64Array) -> list[int]:
    return np.flatnonzero(np.unpackbits(bits.astype("<u8").view(np.uint8), bitorder="little")).tolist()


def _everything(graph: PoseGraph) -> UInt64Array:
    return _bits(range(len(graph.individuals)), len(graph.shown))


def _unseen(graph: PoseGraph, may_miss: int) -> list[int]:
    """The individuals that the look-around does not show."""
    if may_miss < 0:
        raise ValueError(f"may_miss: expected 0 or more, got {may_miss}")
    return _members(_everything(graph) & ~graph.shown)


def _check_witnesses(witnesses: Sequence[Sequence[int]], unseen: Sequence[int]) -> None:
    if len(witnesses) > MOST:
        raise ValueError(f"witnesses: expected at most {MOST}, got {len(witnesses)}")
    for k, witness in enumerate(witnesses):
        if not witness or not set(unseen).issuperset(witness):
            raise ValueError(
                f"witness {k}: expected individuals that the look-around does not show, got {list(witness)}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """The states of a search that walks within its limit pass, pose after pose."""

    bits: UInt64Array
    """(2,) its witnesses."""
    first: Int64Array
    """(P + 1,) the first of the states at each pose."""
    mask: UInt64Array
    """(n, 2) witnesses that each has heard."""
    since: UInt8Array
    """After how many actions."""
    steps: UInt8Array
    """At least so many actions it lacks."""
    state: Int32Array
    """Its place in that search, for as long as there is no other."""


NOTHING = _Known(
    np.zeros(2, np.uint64),
    np.zeros(0, np.int64),
    np.zeros((0, 2), np.uint64),
    np.zeros(0, np.uint8),
    np.zeros(0, np.uint8),
    np.zeros(0, np.int32),
)


class _Product:
    """The graph times the sets of witnesses heard, the first of them, the core, with an exact table."""

    def __init__(self, graph: PoseGraph, may_miss: int, until: float) -> None:
        self.graph = graph
        self.may_miss = may_miss
        self.until = until
        self.arcs = _arcs(graph)
        self.back = self.arcs.reversed
        poses = len(graph.arcs)
        self.witnesses: list[Witness] = []
        self.members = np.zeros((MOST, len(graph.shown)), np.uint64)
        self.core = 0
        self.seen = np.zeros((poses, 2), np.uint64)
        self.expanded = 0
        # Memory that is never touched costs nothing. One row for every set of the core and one more witness:
        # the actions to hear all of it.
        self.table = np.empty((2 << CORE, poses), np.uint8)
        self.table[0] = 0
        # One for every set of the core: to hear enough of it.
        self.least = np.zeros((1 << CORE, poses), np.uint8)
        self.pose = np.empty(ROOM, np.int32)
        self.mask = np.empty((ROOM, 2), np.uint64)
        self.parent = np.empty(ROOM, np.int32)
        self.front = np.empty((ROOM, 2), np.uint64)

    def add(self, witness: Sequence[int]) -> None:
        """One more witness: into the core while there is room, else behind it."""
        self.check_time()
        bits = _bits(witness, len(self.graph.shown))
        words = np.flatnonzero(bits)
        watching = ((self.graph.views[:, words] & bits[words]) != 0).any(axis=1)
        word, bit = divmod(len(self.witnesses), 64)
        self.seen[watching, word] |= np.uint64(1 << bit)
        self.members[len(self.witnesses)] = bits
        self.witnesses.append(tuple(witness))
        if self.core < CORE:
            self._fill_table()
            self.core += 1
            self._fill_least()

    def _fill_least(self) -> None:
        spared = self._spared(self.core)
        for wanted in range(1 << self.core):
            self.least[wanted] = self._least(wanted, spared)

    def _spared(self, count: int) -> list[bool]:
        """Of every set of the first witnesses, whether all of their individuals may be missed."""
        union = np.zeros((1 << count, self.members.shape[1]), np.uint64)
        for k in range(count):
            union[1 << k : 2 << k] = union[: 1 << k] | self.members[k]
        return [int(row.sum()) <= self.may_miss for row in np.bitwise_count(union)]

    def _least(self, wanted: int, spared: Sequence[bool]) -> UInt8Array:
        """Fewest actions from every pose to hear so many of the wanted that the others may be missed."""
        row: UInt8Array = self.table[wanted].copy()
        left = wanted
        while left:
            if spared[left]:
                np.minimum(row, self.table[wanted & ~left], out=row)
            left = (left - 1) & wanted
        return row

    def unheard(self, sight: UInt64Array) -> UInt64Array:
        """(..., W) individuals of the witnesses of which walks with this sight, (..., W), see nothing."""
        members = self.members[: len(self.witnesses)]
        silent = ((sight[..., None, :] & members) == 0).all(axis=-1)
        hidden: UInt64Array = np.bitwise_or.reduce(np.where(silent[..., None], members, 0), axis=-2)
        return hidden

    def _fill_table(self) -> None:
        """The rows of all sets with the witness after those of the core."""
        sets = 1 << self.core
        seen = np.ascontiguousarray(self.seen[:, 0])
        search.extend_table(self.back.first, self.back.to, seen, self.table, sets, 2 * sets)

    def forget(self) -> None:
        """Keep only the core."""
        del self.witnesses[self.core :]
        self.seen &= np.array([(1 << self.core) - 1, 0], np.uint64)

    def swap(self) -> bool:
        """Take the last witness into the full core for the one least missed; False if it is itself."""
        self.check_time()
        one, last = np.uint64(1), len(self.witnesses) - 1
        newest = (self.seen[:, last // 64] >> np.uint64(last % 64)) & one
        self.seen[:, 0] = (self.seen[:, 0] & np.uint64((1 << CORE) - 1)) | (newest << np.uint64(CORE))
        self.seen[:, 1] = 0
        self._fill_table()
        self.members[CORE] = self.members[last]
        every, spared = (2 << CORE) - 1, self._spared(CORE + 1)

        def worth(without: int) -> tuple[int, int, int]:
            row = self._least(every & ~(1 << without), spared)
            return int(row[self.graph.start]), int(row.sum(dtype=np.int64)), without

        out = max(range(CORE + 1), key=worth)
        self.witnesses[CORE:] = [self.witnesses[last]]
        low = (1 << out) - 1
        if out < CORE:
            for row in range(1 << CORE):
                self.table[row] = self.table[(row & low) | ((row & ~low) << 1)]
        seen = self.seen[:, 0]
        self.seen[:, 0] = (seen & np.uint64(low)) | ((seen >> one) & ~np.uint64(low))
        del self.witnesses[out]
        self.members[out:CORE] = self.members[out + 1 : CORE + 1].copy()
        if out < CORE:
            self._fill_least()
        return out < CORE

    def core_length(self) -> int:
        """Fewest actions from the start to hear enough of the core."""
        return int(self.least[(1 << self.core) - 1, self.graph.start])

    def search(self, limit: int, known: _Known) -> _Known | None:
        """What walks of at most `limit` actions that hear enough pass; None where there are none.

        Args:
            limit: Actions.
            known: The same for the same limit and some of the first witnesses, or `NOTHING`.
        """
        self.check_time()
        poses, start = len(self.seen), self.graph.start
        full = (1 << len(self.witnesses)) - 1
        bits = np.array([full & (1 << 64) - 1, full >> 64], np.uint64)
        if self.core_length() > limit:
            return None
        front_at, front_size = np.zeros(poses, np.int64), np.zeros(poses, np.int32)
        front_room = np.zeros(poses, np.int32)
        self.pose[0], self.mask[0], self.parent[0] = start, self.seen[start], -1
        self.front[0], front_size[start], front_room[start] = self.seen[start], 1, 1
        layers, total, used = [0, 1], 1, 1
        for layer in range(limit):
            low, high = layers[-2:]
            for at in range(low, high, CHUNK):
                total, used = search.expand(
                    self.arcs.first,
                    self.arcs.to,
                    self.seen,
                    limit,
                    self.least,
                    self.core,
                    known.bits,
                    known.first,
                    known.mask,
                    known.since,
                    known.steps,
                    layer,
                    at,
                    min(high, at + CHUNK),
                    total,
                    self.pose,
                    self.mask,
                    self.parent,
                    front_at,
                    front_size,
                    front_room,
                    self.front,
                    used,
                )
                if total < 0:
                    raise _SpentError
                self.check_time()
            total = search.drop_dominated(
                high, total, self.pose, self.mask, self.parent, front_at, front_size, self.front
            )
            if total == high:
                break
            layers.append(total)
        self.expanded += total
        first, mask, since, steps, state = search.steps_to_go(
            self.back.first,
            self.back.to,
            self.seen,
            self.members[: len(self.witnesses)],
            self.may_miss,
            limit,
            total,
            self.pose,
            self.mask,
            np.array(layers, np.int64),
        )
        return _Known(bits, first, mask, since, steps, state) if len(mask) else None

    def past(self, limit: int, witnesses: Sequence[Witness]) -> _Known | None:
        """The same with the core and then these witnesses, and no others."""
        self.forget()
        known = self.search(limit, NOTHING)
        # Not all at once: what is known of the first ones keeps the search for the next ones small.
        for k in range(0, len(witnesses), NEW):
            if known is None:
                return None
            for witness in witnesses[k : k + NEW]:
                self.add(witness)
            known = self.search(limit, known)
        return known

    def best_walks(self, known: _Known) -> tuple[list[list[int]], UInt64Array]:
        """Poses of walks of the last search that see much, and what each has seen, the best first.

        Goes back from the ends of the longest walks, and keeps those that see most with the way that the
        search took to where they are.
        """
        graph = self.graph
        where = np.repeat(np.arange(len(self.seen), dtype=np.int32), np.diff(known.first))
        goals = np.flatnonzero(known.steps == 0)
        length = int(known.since[goals].max())
        place = goals[known.since[goals] == length][: 10 * WIDTH]
        sight = graph.views[where[place]] | graph.shown
        chain = [(np.arange(len(place)), where[place])]
        for layer in range(length - 1, -1, -1):
            walk, prior, count = search.before(
                self.back.first,
                self.back.to,
                self.seen,
                graph.views,
                layer,
                known.first,
                known.mask,
                known.since,
                known.state,
                self.pose,
                self.parent,
                where[place],
                known.mask[place],
                sight,
            )
            order = np.lexsort((walk, prior, -count))
            if layer:
                _, best_of_each = np.unique(prior[order], return_index=True)
                order = order[np.sort(best_of_each)]
            order = order[:WIDTH]
            place = prior[order]
            sight = sight[walk[order]] | graph.views[where[place]]
            chain.append((walk[order], where[place]))
        walks = []
        for k in range(len(place)):
            at, poses = k, []
            for behind, pose in reversed(chain):
                poses.append(int(pose[at]))
                at = int(behind[at])
            walks.append(poses)
        return walks, sight

    def nearest(self, walk: Sequence[int], individuals: Sequence[int]) -> dict[int, int]:
        """Fewest actions from a walk to a pose that sees each individual; without those never seen."""
        on: BoolArray = np.zeros(len(self.seen), np.bool_)
        on[list(walk)] = True
        away = np.zeros((2, len(on)), np.uint8)
        # Against the arcs turned round, the steps from the walk to every pose.
        search.extend_table(self.arcs.first, self.arcs.to, on.astype(np.uint64), away, 1, 2)
        steps: dict[int, int] = {}
        left = _bits(individuals, len(self.graph.shown))
        for layer in range(search.FAR):
            here = np.flatnonzero(away[1] == layer)
            if not left.any() or not len(here):
                break
            new = np.bitwise_or.reduce(self.graph.views[here], axis=0) & left
            left &= ~new
            steps.update(dict.fromkeys(_members(new), layer))
        return steps

    def farthest(self, walk: Sequence[int], missed: Sequence[int]) -> Witness:
        """A witness among the missed individuals: the farthest from the walk, and its neighbours."""
        steps = self.nearest(walk, missed)
        order = np.array(sorted(missed, key=lambda i: (-steps.get(i, -1), i)), np.int64)
        views = self.graph.views
        away = (views[:, order[0] // 64] >> np.uint64(order[0] % 64)) & np.uint64(1) == 0
        others, _ = search.least_watched(
            views, away.astype(np.int64), order[1:], len(self.graph.individuals), self.may_miss
        )
        return tuple(sorted([int(order[0]), *others.tolist()]))

    def bottlenecks(self, missed: Sequence[int], known: _Known, limit: int, size: int) -> list[Witness]:
        """Witnesses of `size` missed individuals together, which few of the states in each layer hear.

        None of the earlier witnesses' individuals, if it can be.
        """
        spare = np.minimum(limit - known.since.astype(np.int64) - known.steps, 10)
        share = SPARE**spare
        share = 1_000_000_000 * share // np.bincount(known.since, share).astype(np.int64)[known.since]
        weights = np.diff(_cumulated(share)[known.first])
        passed = np.flatnonzero(np.diff(known.first))
        lost = set(_members(~np.bitwise_or.reduce(self.graph.views[passed], axis=0)))
        used = {i for witness in self.witnesses for i in witness}
        fresh = [i for i in missed if i in lost or i not in used]
        left = np.array(fresh if len(fresh) >= size else missed, np.int64)
        part = -(-(self.may_miss + 1) // PARTS)
        found = []
        for begin in range(0, size, part):
            chosen, _ = search.least_watched(
                self.graph.views[passed],
                weights[passed],
                left,
                len(self.graph.individuals),
                min(part, size - begin),
            )
            found.append(tuple(sorted(chosen.tolist())))
            left = left[~np.isin(left, chosen)]
        return found

    def actions(self, poses: Sequence[int]) -> tuple[int, ...]:
        """The actions between the poses of a walk."""
        arcs = self.graph.arcs
        return tuple(int(np.flatnonzero(arcs[a] == b)[0]) for a, b in pairwise(poses))

    def check_time(self) -> None:
        if thread_time() > self.until:
            raise _SpentError


class _Proof:
    """A bound that grows: `length` holds, by `witnesses`, whenever the search is broken off."""

    def __init__(self, product: _Product, most: int) -> None:
        self.product = product
        self.most = most
        self.everything = _everything(product.graph)
        self.length = 0
        self.witnesses: tuple[Witness, ...] = ()
        self.walks: list[tuple[int, ...]] = []

    def lengthen(self, witnesses: Sequence[Witness], length: int) -> None:
        """Until the bound is that of a walk, or the budget is spent.

        Args:
            witnesses: To begin with; the first are the core.
            length: That they are said to certify.
        """
        product = self.product
        for witness in witnesses[:CORE]:
            product.add(witness)
        self._use_core()
        if len(witnesses) > CORE and self._resume(witnesses[CORE:], length):
            return
        walk = [product.graph.start]
        while product.core < CORE and self.length < self.most:
            missed = self._missed(product.graph.seen(walk))
            product.add(product.farthest(walk, missed))
            self._use_core()
            if self.length >= self.most:
                return
            known = product.search(self.length, NOTHING)
            if known is None:
                raise AssertionError("a table promises a walk that the search does not find")
            found, sight = product.best_walks(known)
            if self._optimal(found, sight):
                return
            walk = found[0]
        while self.length < self.most and not self._settle(self.length):
            self._use_all(self.length + 1)

    def _resume(self, witnesses: Sequence[Witness], length: int) -> bool:
        """Go on at a length that the core and these witnesses are said to certify; True at an optimum.

        That there is no walk of `length` shows more than was said. Only where there is one has it to be shown
        as well that none is shorter.
        """
        limit = min(max(length, self.length), self.most - 1)
        if limit < self.length:
            return True
        if not self._settle(limit, witnesses):
            self._use_all(limit + 1)
            return False
        if limit > self.length:
            if self.product.past(limit - 1, self.product.witnesses[CORE:]) is not None:
                return False
            self._use_all(limit)
        return True

    def _use_all(self, length: int) -> None:
        """Take over a bound that all present witnesses certify, and improve the core for the next."""
        product = self.product
        # A core that was improved meanwhile may have shown more.
        if length > self.length:
            self.length, self.witnesses = length, tuple(product.witnesses)
        if product.expanded > LARGE and len(product.witnesses) > CORE and product.swap():
            self._use_core()

    def _settle(self, limit: int, witnesses: Sequence[Witness] = ()) -> bool:
        """Add witnesses until a walk of `limit` actions at most will do: True, or none is left: False."""
        product = self.product
        product.expanded = 0
        known = product.past(limit, witnesses)
        while known is not None:
            found, sight = product.best_walks(known)
            if self._optimal(found, sight):
                return True
            if len(product.witnesses) == MOST:
                # From a better core, other witnesses are found, maybe fewer.
                if not product.swap():
                    raise _SpentError
                self._use_core()
                known = product.search(limit, NOTHING)
                continue
            most = min(len(product.witnesses) + NEW, MOST)
            while len(sight) and len(product.witnesses) < most:
                unheard = product.unheard(sight[0])
                size = product.may_miss + 1 - int(np.bitwise_count(unheard).sum())
                missed = _members(self.everything & ~sight[0] & ~unheard)
                room = MOST - len(product.witnesses)
                for witness in product.bottlenecks(missed, known, limit, size)[:room]:
                    product.add(witness)
                # The next ones are for the best of the walks that hear enough of these.
                sight = sight[np.bitwise_count(product.unheard(sight)).sum(axis=-1) <= product.may_miss]
            known = product.search(limit, known)
        return False

    def _use_core(self) -> None:
        product = self.product
        if product.core and product.core_length() > self.length:
            self.length, self.witnesses = product.core_length(), tuple(product.witnesses[: product.core])

    def _optimal(self, found: list[list[int]], sight: UInt64Array) -> bool:
        self.walks.append(self.product.actions(found[0]))
        return len(self._missed(sight[0])) <= self.product.may_miss

    def _missed(self, sight: UInt64Array) -> list[int]:
        return _members(self.everything & ~sight)
