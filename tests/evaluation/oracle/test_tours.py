"""Tours: against brute force where that is possible, and the searches inside against slow twins."""

from __future__ import annotations

import itertools
from collections import deque

import numpy as np
import pytest

from dream.evaluation.oracle import tours
from dream.evaluation.oracle._kernels import tours as kernels
from dream.evaluation.oracle.graph import PoseGraph

SIDE = 5


def field(seed: int, *, side: int = SIDE, individuals: int = 9, seen_by: float = 0.04) -> PoseGraph:
    """A square of places with four headings, some places blocked, and individuals seen from few poses."""
    rng = np.random.default_rng(seed)
    free = rng.random((side, side)) < 0.85
    free[0, 0] = True
    steps = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    actions = ((0, 1.0), (1, 0.0), (-1, 0.0), (1, 1.0), (-1, 1.0))
    arcs = np.full((side * side * 4, len(actions)), -1, np.int32)
    poses = np.zeros((side * side * 4, 3))
    for row, col, heading in itertools.product(range(side), range(side), range(4)):
        pose = (row * side + col) * 4 + heading
        poses[pose] = col, row, heading * np.pi / 2
        for a, (turn, advance) in enumerate(actions):
            to = (heading + turn) % 4
            r, c = row + int(advance) * steps[to][1], col + int(advance) * steps[to][0]
            if free[row, col] and 0 <= r < side and 0 <= c < side and free[r, c]:
                arcs[pose, a] = (r * side + c) * 4 + to
    reached = _slow_steps(arcs, 0)
    places = np.array(sorted(reached))
    seen = np.zeros((len(poses), individuals), np.bool_)
    for i in range(individuals):
        seen[rng.choice(places, 1 + int(seen_by * len(places) * rng.random()), replace=False), i] = True
    views = np.packbits(seen, axis=1, bitorder="little")
    words = np.pad(views, ((0, 0), (0, -views.shape[1] % 8))).view("<u8").astype(np.uint64)
    return PoseGraph(poses, arcs, actions, words, np.arange(individuals), 0, words[0])


def _slow_steps(arcs: np.ndarray, begin: int) -> dict[int, int]:
    steps, queue = {begin: 0}, deque([begin])
    while queue:
        here = queue.popleft()
        for to in arcs[here]:
            if to >= 0 and int(to) not in steps:
                steps[int(to)] = steps[here] + 1
                queue.append(int(to))
    return steps


def shortest(graph: PoseGraph, may_miss: int) -> int:
    """By breadth-first search over pose and set seen."""
    views = [int(sum(int(word) << (64 * w) for w, word in enumerate(row))) for row in graph.views]
    goal = len(graph.individuals) - may_miss
    first = (graph.start, views[graph.start])
    seen, layer, length = {first}, [first], 0
    while True:
        if any(mask.bit_count() >= goal for _, mask in layer):
            return length
        after = []
        for pose, mask in layer:
            for to in graph.arcs[pose]:
                state = (int(to), mask | views[to])
                if to >= 0 and state not in seen:
                    seen.add(state)
                    after.append(state)
        layer, length = after, length + 1
        assert layer, "no walk sees that much"


@pytest.fixture(scope="module")
def graph() -> PoseGraph:
    """With so many individuals that a tour is some forty actions long."""
    return field(7, side=14, individuals=70, seen_by=0.02)


@pytest.mark.parametrize("may_miss", [0, 2])
@pytest.mark.parametrize("seed", range(6))
def test_on_a_tiny_graph_the_tour_is_as_short_as_any(seed: int, may_miss: int) -> None:
    tiny = field(seed)
    least = shortest(tiny, may_miss)
    tour = tours.best_tour(tiny, may_miss, budget_s=3.0, enough=least)
    assert tour is not None
    assert len(tour) == least
    assert tours.missed(tiny, tour) <= may_miss


@pytest.mark.parametrize("may_miss", [0, 5])
def test_a_tour_is_a_walk_that_misses_no_more_than_it_may(graph: PoseGraph, may_miss: int) -> None:
    tour = tours.best_tour(graph, may_miss, budget_s=0.5)
    assert tour is not None
    graph.walk(tour)
    seen = set().union(*(kernels.members(graph.views[pose]).tolist() for pose in graph.walk(tour)))
    assert len(graph.individuals) - len(seen) == tours.missed(graph, tour) <= may_miss
    # It ends where enough is seen, not later.
    assert tours.missed(graph, tour[:-1]) > may_miss


def test_a_tour_is_no_longer_than_a_hint(graph: PoseGraph) -> None:
    hint = tours.best_tour(graph, 0, budget_s=0.5)
    assert hint is not None
    again = tours.best_tour(graph, 0, hints=[(*hint, 1, 2)], budget_s=0.0)
    assert again is not None
    assert len(again) <= len(hint)


def test_what_no_walk_sees_has_no_tour() -> None:
    tiny = field(1)
    blind = np.zeros_like(tiny.views)
    nothing = PoseGraph(tiny.poses, tiny.arcs, tiny.actions, blind, tiny.individuals, 0, blind[0])
    assert tours.best_tour(nothing, 0, budget_s=1.0) is None
    assert tours.best_tour(nothing, len(tiny.individuals), budget_s=1.0) == ()


@pytest.mark.parametrize("may_miss", [0, 5])
def test_repair_never_lengthens_nor_loses(graph: PoseGraph, may_miss: int) -> None:
    search = tours._Search(tours._scene(graph), may_miss, 3)
    walk = search.complete([], 200)
    assert walk is not None
    length, changed = len(walk), 0
    for _ in range(40):
        low = int(search.rng.integers(0, len(walk) - 4))
        size = int(search.rng.integers(3, 12))
        high = min(len(walk), low + size)
        new = search.window(walk, low, high, high - low, noise=0.5)
        if new is None:
            continue
        changed += new != walk
        assert len(new) <= len(walk)
        assert tours.missed(graph, new) <= may_miss
        walk = new
    assert changed > 2
    assert len(walk) < length


def test_disturbed_walks_are_completed_again(graph: PoseGraph) -> None:
    search = tours._Search(tours._scene(graph), 3, 5)
    walk = search.complete([], 200)
    assert walk is not None
    for change in (search.disturb, search.reorder):
        new = change(walk)
        assert new is not None
        assert tours.missed(graph, search.complete(new, 200) or ()) <= 3


def test_a_walk_pruned_in_hindsight_sees_as_much(graph: PoseGraph) -> None:
    search = tours._Search(tours._scene(graph), 0, 0)
    rng = np.random.default_rng(0)
    walk: list[int] = []
    here = graph.start
    for _ in range(300):
        action = int(rng.choice(np.flatnonzero(graph.arcs[here] >= 0)))
        walk.append(action)
        here = int(graph.arcs[here, action])
    pruned = search.pruned(walk)
    assert len(pruned) < len(walk)
    assert tours.missed(graph, pruned) <= tours.missed(graph, walk)


def test_a_trace_is_followed_pose_by_pose_and_past_gaps(graph: PoseGraph) -> None:
    tour = tours.best_tour(graph, 0, budget_s=0.2)
    assert tour is not None
    poses = graph.walk(tour)
    assert tours.follow(graph, graph.poses[poses]) == tour
    gappy = tours.follow(graph, np.vstack([graph.poses[poses[::3]], [[0.3, 0.3, 0.1]]]))
    assert set(poses[::3]) <= set(graph.walk(gappy))
    assert len(gappy) <= len(tour)


# The searches inside, against slow twins.


def test_distances_from_and_to(graph: PoseGraph) -> None:
    arcs, nowhere = graph.arcs, np.zeros(len(graph.arcs), np.uint8)
    first, source = kernels.reverse(arcs)
    slow = {p: _slow_steps(arcs, p) for p in range(0, len(arcs), 37)}
    goals, costs = np.array([40, 7, 333]), np.array([0, 2, 5])
    to = kernels.steps_to(first, source, goals, costs, 250)
    for p, steps in slow.items():
        fast, order = kernels.steps_from(arcs, np.array([p]), nowhere, 250)
        assert {int(q): int(fast[q]) for q in order} == steps
        assert int((fast < kernels.FAR).sum()) == len(steps)
        ways = [steps[int(g)] + int(c) for g, c in zip(goals, costs, strict=True) if int(g) in steps]
        assert int(to[p]) == min(ways, default=kernels.FAR)


def test_a_goal_may_be_nearer_by_way_of_another() -> None:
    arcs = np.array([[1], [2], [-1]], np.int32)
    first, source = kernels.reverse(arcs)
    assert kernels.steps_to(first, source, np.array([2, 0]), np.array([0, 9]), 250).tolist() == [2, 1, 0]


def test_the_searched_part_holds_every_short_walk(graph: PoseGraph) -> None:
    scene = tours._scene(graph)
    begin, limit = graph.start, 9
    steps = _slow_steps(graph.arcs, begin)
    end = next(p for p, d in steps.items() if d == 6)
    part = tours._part(scene, begin, end, np.arange(len(graph.individuals)), limit, 60, 0)
    assert part is not None
    back = {p: _slow_steps(graph.arcs, p).get(end, 999) for p in steps}
    assert len(part.arcs) == sum(steps[p] + back[p] <= limit for p in steps)


def test_bit_tables(graph: PoseGraph) -> None:
    count = len(graph.individuals)
    seen = np.unpackbits(graph.views.view(np.uint8), axis=1, bitorder="little")[:, :count].astype(bool)
    watch = kernels.transposed(graph.views, count)
    for i in range(count):
        assert kernels.members(watch[i]).tolist() == np.flatnonzero(seen[:, i]).tolist()
    nodes, wanted = np.array([5, 3, 77]), np.array([69, 0, 64, 63])
    some = kernels.columns(graph.views, nodes, wanted)
    assert [kernels.members(row).tolist() for row in some] == [
        np.flatnonzero(seen[p, wanted]).tolist() for p in nodes
    ]
    assert kernels.members(kernels.bits(wanted, 2)).tolist() == sorted(wanted)
    steps = np.random.default_rng(0).integers(0, 200, len(seen)).astype(np.uint8)
    assert kernels.nearest(watch, steps).tolist() == [int(steps[seen[:, i]].min()) for i in range(count)]


def test_implied_individuals_are_those_that_another_brings_along() -> None:
    rng = np.random.default_rng(4)
    seen = rng.random((12, 40)) < 0.2
    seen[:, seen.sum(axis=0) == 0] = True
    watch = kernels.transposed(
        np.pad(np.packbits(seen, axis=1, bitorder="little"), ((0, 0), (0, 3))).view(np.uint64), 40
    )
    implied = kernels.implied(watch)
    kept = np.flatnonzero(~implied)
    inside = np.array([[not (seen[:, j] & ~seen[:, i]).any() for i in range(40)] for j in range(40)])
    assert 0 < len(kept) < 40
    for i in np.flatnonzero(implied):
        assert any(inside[j, i] for j in kept)
    for i, j in itertools.permutations(kept, 2):
        assert not inside[j, i]


def test_groups_in_order_and_in_the_best_order() -> None:
    rng = np.random.default_rng(2)
    between = rng.integers(1, 20, (14, 14)).astype(np.uint8)
    first = np.array([0, 3, 5, 8, 9, 12])
    member = rng.integers(1, 14, 12)
    groups = [member[a:b].tolist() for a, b in itertools.pairwise(first)]

    def slow(order: tuple[int, ...]) -> int:
        return min(
            sum(int(between[a, b]) for a, b in itertools.pairwise([0, *poses]))
            for poses in itertools.product(*(groups[k] for k in order))
        )

    choice = np.empty(5, np.int64)
    for order in [(0, 1, 2, 3, 4), (3, 1, 4, 0, 2)]:
        assert kernels.through(between[0], between, first, member, np.array(order), choice) == slow(order)
        walk = [0, *choice.tolist()]
        assert sum(int(between[a, b]) for a, b in itertools.pairwise(walk)) == slow(order)
    best = min(slow(order) for order in itertools.permutations(range(5)))
    found = np.arange(5)
    chosen = kernels.anneal(between[0], between, first, member, found, 5, 3000, 5.0, 0.2, rng)
    walk = [0, *chosen.tolist()]
    assert sum(int(between[a, b]) for a, b in itertools.pairwise(walk)) == best == slow(tuple(found.tolist()))


@pytest.mark.parametrize("may_miss", [0, 3])
def test_a_beam_that_keeps_everything_finds_the_shortest_way_between_two_poses(may_miss: int) -> None:
    small = field(11, side=4, individuals=7)
    scene = tours._scene(small)
    views = [int(row[0]) for row in small.views]
    rng = np.random.default_rng(0)
    for end in (None, *(int(p) for p in rng.choice(sorted(_slow_steps(small.arcs, 0)), 6))):
        states, length = {(0, views[0])}, 0
        while not any(m.bit_count() >= 7 - may_miss and end in (None, p) for p, m in states):
            moves = [(int(to), m | views[to]) for p, m in states for to in small.arcs[p] if to >= 0]
            states, length = states | set(moves), length + 1
        part = tours._part(scene, 0, end, np.arange(7), 40, may_miss, 8)
        assert part is not None
        found, _ = tours._beam(
            part,
            np.ones(len(part.wanted)),
            40,
            width=5000,
            crowd=200,
            urge=2.0,
            noise=0.0,
            rng=rng,
        )
        assert found is not None
        poses = small.walk(found)
        assert len(found) == length
        assert end in (None, poses[-1])
        assert tours.missed(small, found) <= may_miss
