"""The search over real actions: slow twins, every sequence by brute force, tours on paper."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree

from dream.geometry import SE2, Bounds
from dream.lattice import Lattice, Pose, lattice_of
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.planning._kernels import tour as tours
from dream.planning._kernels import views as kernels
from dream.planning._kernels.beam import BeamScore, Sequences, beam
from dream.planning._kernels.moves import FREE, UNKNOWN
from dream.planning._kernels.search import ways_between
from dream.planning._kernels.views import Views
from dream.planning.lookahead import NOT_ROUNDED, NOTHING, SERVICE, LookAhead, Plan, Prospect
from dream.planning.pose_views import Listed, PoseViews
from dream.planning.travel import Travel, careful_standoff, careful_travel, traced
from dream.protocol import DREAM_V1
from dream.types import BoolArray, Mission
from tests.planning.views import shown_by

NEARSIGHTED = replace(DREAM_V1, reach=2.5)
"""So that an arena can be small."""
SMALL = Bounds(-4.0, -4.0, 4.0, 4.0)
LATTICE = lattice_of(SMALL, NEARSIGHTED)


def pose_of(row: int, col: int, heading: int, lattice: Lattice = LATTICE) -> Pose:
    """So many steps north and east of node 0."""
    return lattice.pose_at(lattice.graph.grid[row, col], heading)


@dataclass(frozen=True)
class Puzzle:
    """All that the search is given."""

    pose_views: PoseViews
    weights: npt.NDArray[np.float64]
    views: Views
    moves: npt.NDArray[np.uint8]
    known: BoolArray
    start: Pose

    def beam(self, width: int, horizon: int, discount: float) -> Sequences:
        """By gains alone."""
        none, nowhere = np.zeros(0, np.int64), np.zeros((0, LATTICE.nodes), np.uint8)
        score = BeamScore(discount, NOT_ROUNDED, -np.inf, 0.0, 0.0, none, none, nowhere)
        found: Sequences = beam(
            self.weights, self.views, LATTICE.graph, self.moves, self.start, self.known, score, width, horizon
        )
        return found

    def tile(self, pose: Pose) -> int:
        return int(self.views.tile[LATTICE.node_of(pose)])

    def shown(self, pose: Pose) -> frozenset[int]:
        """Elements of any weight."""
        return frozenset(e for e in shown_by(self.views, pose) if self.weights[e] > 0.0)

    def may(self, kind: int, end: Pose, first: bool, seen: frozenset[int] | set[int]) -> bool:
        """Whether a move of that kind leads to a pose."""
        tile = self.tile(end)
        return kind == FREE or (kind == UNKNOWN and not first and (bool(self.known[tile]) or tile in seen))

    def next_poses(self, pose: Pose, first: bool, seen: frozenset[int]) -> Iterator[Pose]:
        """Where one action may lead, in the order of the protocol."""
        for turn in NEARSIGHTED.turns:
            heading = (LATTICE.heading_of(pose) + turn) % NEARSIGHTED.headings
            to = LATTICE.pose_at(int(LATTICE.node_of(pose)), heading)
            if turn:
                yield to
            for kind, end in zip(self.moves[to].tolist(), LATTICE.graph.ahead[to].tolist(), strict=True):
                if kind and self.may(kind, end, first, seen):
                    yield end


def _puzzle(seed: int) -> Puzzle:
    """Random ground with a few solids; weights are whole numbers, so that sums are exact."""
    generator = np.random.default_rng(seed)
    occupancy = OccupancyMap(SMALL, NEARSIGHTED)
    solid = generator.random(occupancy.shape) < 0.004
    occupancy._write("log_odds", (0, 0), 20 * solid)
    pose_views = PoseViews(Mission(NEARSIGHTED, SMALL, 200), 1.0)
    pose_views.update(occupancy)
    nodes = generator.choice(LATTICE.nodes, 30, replace=False)
    sizes = generator.integers(0, 3, 30 * NEARSIGHTED.headings)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    elements = generator.integers(0, 6, starts[-1])
    # Within one view an element is listed once.
    for k in range(len(sizes)):
        here = slice(starts[k], starts[k + 1])
        elements[here] = generator.choice(6, sizes[k], replace=False)
    worth = generator.integers(1, 9, 6).astype(np.float64)
    listed = Listed(worth, worth, np.zeros((6, 2)), nodes, starts, elements)
    views = pose_views.views(listed)
    tiles = 2 * pose_views.tiles
    weights = np.concatenate([generator.integers(0, 9, tiles), listed.weights])
    weights[:tiles][generator.random(tiles) < 0.5] = 0
    free = (generator.random(LATTICE.graph.ahead.shape) < 0.5) & (LATTICE.graph.ahead >= 0)
    moves = pose_views.moves(free.astype(np.uint8), occupancy, 0.5)
    known = generator.random(pose_views.tiles) < 0.3
    return Puzzle(pose_views, weights.astype(np.float64), views, moves, known, pose_of(8, 8, 2))


def _bits(elements: frozenset[int], count: int) -> npt.NDArray[np.uint64]:
    words = np.zeros((count + 63) // 64, np.uint64)
    for element in elements:
        words[element // 64] |= np.uint64(1 << element % 64)
    return words


# ---------------------------------------------------------------------------------------------------- views


@given(seed=st.integers(0, 30), row=st.integers(0, 16), col=st.integers(0, 16), heading=st.integers(0, 11))
def test_a_gain_is_the_weight_of_what_is_shown_and_was_not_seen(
    seed: int, row: int, col: int, heading: int
) -> None:
    puzzle, pose = _puzzle(seed), pose_of(row, col, heading)
    shown = shown_by(puzzle.views, pose)
    half = frozenset(e for e in range(len(puzzle.weights)) if e % 2)
    for seen in (frozenset[int](), half):
        found = kernels.gain(puzzle.weights, _bits(seen, len(puzzle.weights)), puzzle.views, pose)
        assert found == sum(puzzle.weights[list(shown - seen)])


@given(seed=st.integers(0, 30), row=st.integers(0, 16), col=st.integers(0, 16), heading=st.integers(0, 11))
def test_a_gain_is_the_same_to_the_last_bit_where_the_tiles_in_view_are_known(
    seed: int, row: int, col: int, heading: int
) -> None:
    puzzle, pose = _puzzle(seed), pose_of(row, col, heading)
    generator = np.random.default_rng(seed)
    # Sums of these depend on their order.
    weights = puzzle.weights * generator.random(len(puzzle.weights)).astype(np.float32) ** 9
    seen = generator.integers(0, 2**64, (len(weights) + 63) // 64, np.uint64)
    room = np.empty(int(np.diff(puzzle.views.first).max()), np.uint16)
    tiles = room[: kernels.clear_tiles(weights, puzzle.views, pose, room)]
    listed = puzzle.pose_views.tiles * 2
    in_list = puzzle.views.offset[puzzle.views.first[heading] + tiles.astype(int)]
    shown = {e for e in shown_by(puzzle.views, pose) if e < listed and weights[e] > 0.0}
    assert set(puzzle.tile(pose) + in_list) == shown
    expected = kernels.gain(weights, seen, puzzle.views, pose)
    assert kernels.gain_of(tiles, weights, seen, puzzle.views, pose) == expected


def test_what_was_looked_at_gains_nothing_again() -> None:
    puzzle, pose, behind = _puzzle(1), pose_of(8, 8, 0), pose_of(8, 8, 6)
    seen = _bits(frozenset(), len(puzzle.weights))
    assert kernels.gain(puzzle.weights, seen, puzzle.views, pose) > 0.0
    kernels.look(puzzle.weights, seen, puzzle.views, pose)
    np.testing.assert_array_equal(seen, _bits(puzzle.shown(pose), len(puzzle.weights)))
    assert kernels.gain(puzzle.weights, seen, puzzle.views, pose) == 0.0
    assert kernels.gain(puzzle.weights, seen, puzzle.views, behind) > 0.0


@pytest.mark.few(9)
@pytest.mark.parametrize("few", [False, True])
@pytest.mark.parametrize("farthest", [1, 3, 40])
@pytest.mark.parametrize("seed", range(8))
def test_gains_are_those_of_each_pose_that_could_be_the_best_for_its_steps(
    seed: int, farthest: int, few: bool
) -> None:
    puzzle, generator = _puzzle(seed), np.random.default_rng(seed)
    if few:
        puzzle.weights[generator.random(len(puzzle.weights)) < 0.99] = 0.0
        puzzle.weights[-1] = 5.0
    nodes = np.arange(LATTICE.nodes)
    steps = generator.integers(-1, farthest + 1, (len(nodes), NEARSIGHTED.headings), np.int32)
    gains = kernels.best_gains(puzzle.weights, puzzle.views, nodes, steps)
    slow = np.array([sum(puzzle.weights[list(shown_by(puzzle.views, p))]) for p in range(LATTICE.poses)])
    slow = slow.reshape(steps.shape)
    np.testing.assert_array_equal(kernels.gains(puzzle.weights, puzzle.views, nodes), slow)
    rates = np.where(steps > 0, slow / np.maximum(steps, 1), 0.0)
    assert (gains[rates == rates.max()] == slow[rates == rates.max()]).all()
    assert ((gains == slow) | (gains == 0.0)).all()
    assert not gains[steps <= 0].any()
    if farthest == 40:
        assert np.count_nonzero(gains) < 0.5 * np.count_nonzero(rates), "most promise too little"


def test_where_nothing_is_worth_a_look_no_pose_gains() -> None:
    puzzle = _puzzle(1)
    node = LATTICE.graph.grid[8, 8:9].astype(np.int64)
    for steps in (1, 0, -1):
        nothing = np.zeros_like(puzzle.weights)
        assert not kernels.best_gains(nothing, puzzle.views, node, np.full((1, 12), steps, np.int32)).any()
    assert not kernels.best_gains(puzzle.weights, puzzle.views, node, np.zeros((1, 12), np.int32)).any()


# ----------------------------------------------------------------------------------------------------- beam


def _pair_of(pose: Pose) -> tuple[int, ...]:
    """By which sequences of one level differ."""
    col, row = LATTICE.graph.place[LATTICE.node_of(pose)].tolist()
    return row // 2, col // 2, LATTICE.heading_of(pose)


def _best_by_brute_force(puzzle: Puzzle, depth: int, discount: float) -> float:
    """The greatest discounted weight of all sequences of so many actions."""

    def best(pose: Pose, seen: frozenset[int], step: int) -> float:
        if step > depth:
            return 0.0
        most = -math.inf
        for end in puzzle.next_poses(pose, step == 1, seen):
            shown = puzzle.shown(end)
            gained = discount**step * float(sum(puzzle.weights[list(shown - seen)]))
            most = max(most, gained + best(end, seen | shown, step + 1))
        return most

    return best(puzzle.start, frozenset(), 1)


def _slow_beam(
    puzzle: Puzzle, width: int, horizon: int, discount: float
) -> list[list[tuple[Pose, int, float]]]:
    """Level by level the pose, the parent's place in its level and the score of each sequence."""
    nothing: frozenset[int] = frozenset()
    levels = [[(puzzle.start, -1, 0.0)]]
    seen_by = [nothing]
    for step in range(1, horizon + 1):
        candidates = [
            (
                end,
                k,
                score + discount**step * float(sum(puzzle.weights[list(puzzle.shown(end) - seen_by[k])])),
            )
            for k, (pose, _, score) in enumerate(levels[-1])
            for end in puzzle.next_poses(pose, step == 1, seen_by[k])
        ]
        taken: set[tuple[int, ...]] = set()
        kept: list[tuple[Pose, int, float]] = []
        for end, parent, score in sorted(candidates, key=lambda candidate: -candidate[2]):
            place = _pair_of(end)
            if place not in taken and len(kept) < width:
                taken.add(place)
                kept.append((end, parent, score))
        if not kept:
            break
        seen_by = [seen_by[parent] | puzzle.shown(end) for end, parent, _ in kept]
        levels.append(kept)
    return levels


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("depth", [1, 2])
def test_a_beam_wide_enough_finds_the_best_of_all_sequences(seed: int, depth: int) -> None:
    puzzle = _puzzle(seed)
    # The shorter advance may end beside the longer one.
    node = int(LATTICE.node_of(puzzle.start))
    puzzle.moves[LATTICE.pose_at(node, 0) : LATTICE.pose_at(node + 1, 0), 0] = 0
    ends = list(puzzle.next_poses(puzzle.start, True, frozenset()))
    assert len(set(map(_pair_of, ends))) == len(ends), "none shadows one"
    found = puzzle.beam(10_000, depth, 0.5)
    assert found.score[found.first :].max() == _best_by_brute_force(puzzle, depth, 0.5)
    assert found.score[found.best] == found.score.max()


def test_in_depth_a_beam_finds_almost_the_best_and_never_more() -> None:
    """Sequences that end in the same place shadow each other, so that the very best may be lost."""
    for seed in range(3):
        puzzle = _puzzle(seed)
        best = _best_by_brute_force(puzzle, 3, 0.5)
        found = puzzle.beam(10_000, 3, 0.5)
        assert 0.9 * best <= found.score[found.first :].max() <= best


@pytest.mark.parametrize("width", [1, 7, 48])
@pytest.mark.parametrize("seed", range(4))
def test_a_beam_equals_its_slow_twin(seed: int, width: int) -> None:
    puzzle = _puzzle(seed)
    found = puzzle.beam(width, 4, 0.5)
    slow = _slow_beam(puzzle, width, 4, 0.5)
    starts = np.cumsum([0] + [len(level) for level in slow])
    assert found.first == starts[-2]
    assert found.pose.tolist() == [end for level in slow for end, _, _ in level]
    assert found.score.tolist() == [value for level in slow for _, _, value in level]
    assert found.level.tolist() == [k for k, level in enumerate(slow) for _ in level]
    for k, level in enumerate(slow[1:], start=1):
        parents = found.parent[starts[k] : starts[k + 1]].tolist()
        assert parents == [starts[k - 1] + above for _, above, _ in level]


@pytest.mark.parametrize("leave", [0.0, 15.0])
@pytest.mark.parametrize("slight", [0.0, 6.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_beam_over_parts_equals_its_slow_twin(seed: int, slight: float, leave: float) -> None:
    """Sequences by what they leave, the moves to the nearest part and those along the tree over all parts."""
    puzzle, generator = _puzzle(seed), np.random.default_rng(seed)
    near = set[int]().union(*(puzzle.shown(pose) for pose in generator.choice(LATTICE.poses, 12)))
    elements = np.sort(generator.choice(sorted(near), 12, replace=False))
    puzzle.weights[np.setdiff1d(np.arange(len(puzzle.weights)), elements)] = 0.0
    part_of = generator.integers(0, 4, len(elements))
    place = LATTICE.graph.place
    around = place[generator.choice(LATTICE.nodes, 4, replace=False)]
    ways = np.abs(place - around[:, None]).max(axis=2).astype(np.uint8)
    between = ways_between(ways)
    score = BeamScore(1.0, 6, leave, slight, 1.5, elements, part_of, ways)
    known = np.ones_like(puzzle.known)
    found = beam(puzzle.weights, puzzle.views, LATTICE.graph, puzzle.moves, puzzle.start, known, score, 9, 5)

    everything = replace(puzzle, known=known)
    level = [(puzzle.start, frozenset[int]())]
    poses, best = [puzzle.start], float(puzzle.weights.sum())
    for step in range(5):
        candidates = []
        for pose, seen in level:
            left = [e not in seen for e in elements.tolist()]
            mass = np.bincount(part_of, puzzle.weights[elements] * left, 4)
            parts = np.flatnonzero(mass > slight)
            along = minimum_spanning_tree(between[np.ix_(parts, parts)]).sum()
            for end in everything.next_poses(pose, step == 0, seen):
                rest = float(puzzle.weights.sum() - puzzle.weights[list(seen | puzzle.shown(end))].sum())
                away = min((int(ways[part, LATTICE.node_of(end)]) for part in parts), default=0)
                candidates.append((rest + 1.5 * (away + along), end, seen | puzzle.shown(end), rest))
        taken: set[tuple[int, ...]] = set()
        level = []
        for _, end, seen, rest in sorted(candidates, key=lambda candidate: candidate[0]):
            if _pair_of(end) not in taken and len(level) < 9:
                taken.add(_pair_of(end))
                level.append((end, seen))
                best = min(best, rest)
        poses += [end for end, _ in level]
        if best <= leave:
            break
    assert found.pose.tolist() == poses
    assert -found.score[found.best] == best
    first = np.flatnonzero(found.score == found.score[found.best])[0]
    assert found.best == first, "the shortest"


@given(seed=st.integers(0, 40), width=st.integers(1, 30))
def test_the_first_move_is_free_and_later_ones_lead_over_ground_known_or_seen_by_then(
    seed: int, width: int
) -> None:
    puzzle = _puzzle(seed)
    found = puzzle.beam(width, 4, 0.9)
    for end in range(found.first, len(found.pose)):
        poses = found.pose[traced(found.parent, end)].tolist()
        seen: set[int] = set()
        for step, (before, after) in enumerate(pairwise(poses)):
            advance = LATTICE.advance_to(before, after)
            if LATTICE.node_of(before) == LATTICE.node_of(after):
                assert advance is None
            else:
                kind = puzzle.moves[LATTICE.turned_to(before, after), advance]
                assert puzzle.may(int(kind), after, step == 0, seen)
            seen |= puzzle.shown(after)


@pytest.mark.parametrize(("known", "leaves"), [(False, False), (True, True)])
def test_into_the_unknown_it_never_goes_at_once(known: bool, leaves: bool) -> None:
    puzzle = _puzzle(3)
    puzzle = replace(
        puzzle,
        moves=np.where(puzzle.moves > 0, UNKNOWN, 0).astype(np.uint8),
        known=np.full_like(puzzle.known, known),
        weights=np.zeros_like(puzzle.weights),
    )
    for horizon, may in ((1, False), (2, leaves)):
        found = puzzle.beam(1000, horizon, 0.9)
        away = LATTICE.node_of(found.pose[found.first :]) != LATTICE.node_of(puzzle.start)
        assert away.any() == may


# ----------------------------------------------------------------------------------------------------- tour


def _tour(
    mass: list[float],
    places: list[tuple[float, float]],
    service: list[float],
    *,
    at: tuple[float, float] = (0.0, 0.0),
    keep: float = 0.0,
    discount: float = 0.9,
) -> tuple[float, float]:
    """With 2 m a step, from 4 m away."""
    x, y = np.array(places, np.float64).reshape(-1, 2).T.copy()
    areas, left = (np.array(mass), x, y, np.array(service)), np.zeros(len(mass), np.int64)
    # With no rates worked out beforehand, and with all.
    none, every = np.zeros(len(mass), np.bool_), np.ones(len(mass), np.bool_)
    on_the_way, ahead = (
        tours.tour(*areas, *at, 2.0, 4.0, discount, keep, rates, rated, left)
        for rated in (none, every)
        for rates in [tours.rates_between(*areas, rated, 2.0, 4.0)]
    )
    assert on_the_way == ahead
    return float(ahead[0]), float(ahead[1])


def test_a_tour_of_one_area_takes_the_way_there_and_its_service() -> None:
    assert _tour([5.0], [(10.0, 0.0)], [1.5]) == pytest.approx((5.0 * 0.9**4.5, 4.5))
    assert _tour([5.0], [(3.0, 0.0)], [1.5]) == pytest.approx((5.0 * 0.9**1.5, 1.5)), "looked at from here"


def test_a_tour_goes_first_where_there_is_most_for_its_time() -> None:
    east, west = (10.0, 0.0), (-12.0, 0.0)
    # East: 3 + 1 steps for 5; then 22 m less 4 to the west, 9 + 1 for 4.
    assert _tour([4.0, 5.0], [west, east], [1.0, 1.0]) == pytest.approx((5.0 * 0.9**4 + 4.0 * 0.9**14, 14.0))
    # West: 4 + 1 steps for 9; then 9 + 1 for 5.
    assert _tour([9.0, 5.0], [west, east], [1.0, 1.0]) == pytest.approx((9.0 * 0.9**5 + 5.0 * 0.9**15, 15.0))


def test_a_tour_ends_where_little_enough_is_left() -> None:
    places = [(10.0, 0.0), (-10.0, 0.0)]
    assert _tour([5.0, 1.0], places, [1.0, 1.0], keep=1.0)[1] == pytest.approx(4.0)
    assert _tour([5.0, 1.0], places, [1.0, 1.0], keep=0.9)[1] == pytest.approx(13.0)
    assert _tour([5.0, 1.0], places, [1.0, 1.0], keep=6.0) == (0.0, 0.0)
    assert _tour([0.0, 0.0], places, [1.0, 1.0]) == (0.0, 0.0)


@given(seed=st.integers(0, 1000), count=st.integers(1, 8), keep=st.floats(0.0, 5.0))
def test_a_tour_equals_its_slow_twin(seed: int, count: int, keep: float) -> None:
    generator = np.random.default_rng(seed)
    mass = generator.random(count) * (generator.random(count) < 0.7)
    places, service = generator.uniform(-20.0, 20.0, (count, 2)), generator.uniform(0.3, 3.0, count)
    left, here, worth, steps = {k for k in range(count) if mass[k]}, np.zeros(2), 0.0, 0.0
    while left and sum(mass[k] for k in left) > keep:

        def time(k: int, here: npt.NDArray[np.float64] = here) -> float:
            return max(math.dist(places[k], here) - 4.0, 0.0) / 2.0 + float(service[k])

        best = max(left, key=lambda k: mass[k] / time(k))
        steps += time(best)
        worth += float(mass[best]) * 0.9**steps
        here = places[best]
        left.remove(best)
    found = _tour(list(mass), [tuple(p) for p in places], list(service), keep=keep)
    assert found == pytest.approx((worth, steps))


@pytest.mark.parametrize("everywhere", [False, True])
def test_the_tour_after_a_sequence_leaves_out_what_it_has_seen(everywhere: bool) -> None:
    puzzle = _puzzle(4)
    pose_views, count = puzzle.pose_views, len(puzzle.weights)
    none = np.zeros(0, np.int64)
    listed = Listed(np.ones(6), np.ones(6), np.zeros((6, 2)), none, np.zeros(1, np.int64), none)
    x, y, area = pose_views.places(listed)
    ends = np.array([[4.0, 4.0], [6.5, 1.0]])
    seen = [
        frozenset(range(0, count, 3)) if everywhere else puzzle.shown(pose_of(8, 10, 6)),
        puzzle.shown(pose_of(8, 8, 0)),
    ]
    alike = set(area[puzzle.weights > 0.0]) - set(area[list(seen[0] | seen[1])])
    assert bool(alike) != everywhere, "areas that no sequence has seen any of"
    worth, steps = tours.tours(
        puzzle.weights.astype(np.float32),
        np.stack([_bits(elements, count) for elements in seen]),
        ends,
        x,
        y,
        area,
        pose_views.areas,
        40.0,
        2.0,
        4.0,
        0.9,
        1.0,
    )
    for k, (end, elements) in enumerate(zip(ends, seen, strict=True)):
        left = np.array([e not in elements and puzzle.weights[e] > 0.0 for e in range(count)])
        weights = np.where(left, puzzle.weights, 0.0).astype(np.float64)
        mass = np.bincount(area, weights, pose_views.areas)
        middle = [np.bincount(area, weights * at, pose_views.areas) / np.maximum(mass, 1e-9) for at in (x, y)]
        service = 0.3 + np.bincount(area, left, pose_views.areas) / 40.0
        expected = _tour(
            list(mass),
            list(zip(*middle, strict=True)),
            list(service),
            at=(end[0], end[1]),
            keep=1.0,
        )
        assert (worth[k], steps[k]) == pytest.approx(expected, rel=1e-5)


# ----------------------------------------------------------------------------------------------------- plan

WIDE = Bounds(-12.0, -12.0, 12.0, 12.0)


@dataclass(frozen=True)
class Scene:
    """Free ground everywhere, and some of it worth looking at."""

    travel: Travel
    prospect: Prospect
    moves: npt.NDArray[np.uint8]
    known: BoolArray

    def plan(self, **parameters: float) -> Plan | None:
        values = {"discount": 0.95, "tour": 1.0, "keep": 0.01, "jump": 0.5} | parameters
        return LookAhead(32, 4, **values).plan(self.prospect, self.travel, self.moves, self.known)


def _scene(*worth: tuple[slice, slice, float]) -> Scene:
    """Rows, columns and weight of cells; the vehicle looks east at (-9, 0)."""
    occupancy = OccupancyMap(WIDE, DREAM_V1)
    occupancy._write("flags", (0, 0), np.full(occupancy.shape, flags.EXPLORED | flags.BARE, np.uint8))
    pose_views = PoseViews(Mission(DREAM_V1, WIDE, 200), 1.5)
    travel = careful_travel(SE2(-9.0, 0.0, 0.0), occupancy)
    ground = np.zeros(occupancy.shape)
    for rows, cols, weight in worth:
        ground[rows, cols] = weight
    tiles, nothing = pose_views.on_tiles(ground), np.zeros(pose_views.tiles, np.float32)
    prospect = Prospect(pose_views, ground=tiles, hiding=nothing, targets=tiles, hidden=nothing)
    moves = pose_views.moves(travel.free, occupancy, careful_standoff(DREAM_V1))
    return Scene(travel, prospect, moves, pose_views.known_tiles(occupancy))


NEAR_BY = (slice(44, 52), slice(2, 4), 0.01)
"""Little, behind the vehicle."""
FAR_OFF = (slice(40, 56), slice(80, 96), 1.0)
"""Much, at the other end of the arena: more than four steps to where it is in view."""


def test_with_nothing_worth_looking_at_there_is_no_plan() -> None:
    assert _scene().plan() is None


def test_a_far_view_is_gone_for_when_jump_says_that_it_is_so_much_better() -> None:
    scene = _scene(NEAR_BY, FAR_OFF)
    near, far = scene.plan(jump=0.0), scene.plan(jump=1.0)
    assert near is not None
    assert far is not None
    assert len(near.path) - 1 <= 4
    assert len(far.path) - 1 > 4
    assert far.rate > near.rate, "it gains more a step, the way there included"
    turning_point = near.rate / far.rate
    before, after = (scene.plan(jump=share * turning_point) for share in (0.9, 1.1))
    assert before is not None
    assert after is not None
    assert replace(before, choice=near.choice) == near
    assert replace(after, choice=far.choice) == far
    for plan in (before, after):
        assert plan.choice is not None
        assert plan.choice.straight == (plan is after)
        assert (plan.choice.rate, plan.choice.view) == (near.rate, far.rate)


def test_where_the_horizon_shows_nothing_the_far_view_is_taken_whatever_jump_says() -> None:
    plan = _scene(FAR_OFF).plan(jump=0.0)
    assert plan is not None
    assert len(plan.path) - 1 > 4
    assert plan.choice is not None
    assert plan.choice.straight
    assert (plan.choice.rate, plan.choice.view) == (0.0, plan.rate)


def test_the_rate_of_a_far_view_is_what_it_shows_over_the_steps_to_it() -> None:
    scene = _scene(FAR_OFF)
    plan = scene.plan()
    assert plan is not None
    *_, end = plan.path
    shown = shown_by(scene.prospect.pose_views.views(), end)
    assert plan.rate * (len(plan.path) - 1) == pytest.approx(
        sum(scene.prospect.weights[list(shown)]), rel=1e-4
    )
    assert plan.path == scene.travel.path(end)


def test_the_rate_of_a_sequence_is_that_of_the_stretch_where_it_shows_most_a_step() -> None:
    scene = _scene((slice(20, 76), slice(30, 60), 1.0))
    plan = scene.plan(jump=0.0)
    assert plan is not None
    seen: set[int] = set()
    gained, paces, rates = 0.0, 0.0, []
    for step, pose in enumerate(plan.path[1:], start=1):
        shown = shown_by(scene.prospect.pose_views.views(), pose)
        gained += 0.95**step * float(sum(scene.prospect.weights[list(shown - seen)]))
        paces += 0.95**step
        seen |= shown
        rates.append(gained / paces)
    assert plan.rate == pytest.approx(max(rates), rel=1e-4)
    assert plan.rate > NOTHING


def test_a_plan_says_how_much_of_what_it_is_after_it_shows() -> None:
    scene = _scene((slice(20, 76), slice(30, 60), 1.0))
    for jump in (0.0, 100.0):  # The sequence, and the single view.
        plan = scene.plan(jump=jump)
        assert plan is not None
        poses = plan.path[1:] if jump == 0.0 else plan.path[-1:]
        shown = set().union(*(shown_by(scene.prospect.pose_views.views(), pose) for pose in poses))
        tiles = [element for element in shown if element < scene.prospect.pose_views.tiles]
        assert plan.targets == pytest.approx(float(scene.prospect.targets[tiles].sum()), rel=1e-4)
        assert plan.targets > 0.0
        assert plan.cleared == plan.patches == plan.cells == 0.0


def test_a_plan_says_what_its_way_the_tour_after_it_and_the_best_view_were_worth() -> None:
    """By the slow twins of what is shown and of the tour."""
    scene = _scene((slice(20, 40), slice(30, 60), 1.0), FAR_OFF)
    tour, discount, keep = 0.7, 0.95, 0.01
    plan = scene.plan(jump=0.0, tour=tour, discount=discount, keep=keep)
    assert plan is not None
    assert plan.choice is not None
    pose_views, weights = scene.prospect.pose_views, scene.prospect.weights.astype(np.float64)
    views, total = pose_views.views(), float(weights.sum())
    seen: set[int] = set()
    gained = 0.0
    for step, pose in enumerate(plan.path[1:], start=1):
        shown = shown_by(views, pose)
        gained += discount**step * float(weights[list(shown - seen)].sum())
        seen |= shown
    assert plan.choice.shown == pytest.approx(gained, rel=1e-4)

    weights[list(seen)] = 0.0
    x, y, area = pose_views.places()
    mass = np.bincount(area, weights, pose_views.areas)
    middle = [np.bincount(area, weights * at, pose_views.areas) / np.maximum(mass, 1e-9) for at in (x, y)]
    service = tours.DETOUR + np.bincount(area, weights > 0.0, pose_views.areas) / (SERVICE * views.first[1])
    lattice = scene.travel.lattice
    east, north = lattice.position(plan.path[-1]) - lattice.positions[0]
    worth, steps = _tour(
        list(mass),
        list(zip(*middle, strict=True)),
        list(service),
        at=(east, north),
        keep=keep * total,
        discount=discount,
    )
    assert plan.later == pytest.approx(steps, rel=1e-4)
    assert steps > 4.0
    level = len(plan.path) - 1
    after = tour * discount**level * worth
    assert plan.choice.after == pytest.approx(after, rel=1e-4)
    straight = scene.plan(jump=100.0)
    assert straight is not None
    assert plan.choice.view == straight.rate
    assert straight.later == 0.0


def test_a_plan_says_among_how_many_sequences_it_was_chosen() -> None:
    scene = _scene((slice(20, 76), slice(30, 60), 1.0))
    for width in (1, 5):
        values = {"discount": 0.95, "tour": 1.0, "keep": 0.01, "jump": 0.0}
        plan = LookAhead(width, 4, **values).plan(scene.prospect, scene.travel, scene.moves, scene.known)
        assert plan is not None
        assert plan.choice is not None
        assert plan.choice.sequences == width


def test_what_is_left_takes_longer_the_more_there_is() -> None:
    little, much = (_scene(*worth).plan(jump=0.0) for worth in ([NEAR_BY], [NEAR_BY, FAR_OFF]))
    assert little is not None
    assert much is not None
    assert much.later > little.later >= 0.0


@given(row=st.integers(4, 80), col=st.integers(4, 80))
def test_a_plan_begins_here_and_its_first_move_is_free(row: int, col: int) -> None:
    scene = _scene((slice(row, row + 12), slice(col, col + 12), 1.0))
    plan = scene.plan()
    assert plan is not None
    assert plan.path[0] == scene.travel.start
    assert len(plan.path) >= 2
    assert plan.path[1] != plan.path[0]
    before, after = plan.path[:2]
    lattice = scene.travel.lattice
    if lattice.node_of(before) != lattice.node_of(after):
        assert scene.travel.free[lattice.turned_to(before, after), lattice.advance_to(before, after)]
    shown = set().union(*(shown_by(scene.prospect.pose_views.views(), pose) for pose in plan.path[1:]))
    assert sum(scene.prospect.weights[list(shown)]) > 0.0


def test_a_way_that_is_given_is_judged_as_the_search_judges_its_own() -> None:
    scene = _scene((slice(20, 40), slice(30, 60), 1.0), FAR_OFF)
    ahead = LookAhead(32, 4, discount=0.95, tour=0.7, keep=0.01, jump=0.0)
    found = ahead.plan(scene.prospect, scene.travel, scene.moves, scene.known)
    assert found is not None
    assert found.choice is not None
    assert len(found.path) > 2
    judged = ahead.judge(scene.prospect, scene.travel, [found.path, found.path[:2]])
    own, first = (one.plan for one in judged)
    assert own.path == found.path
    assert own.rate * (len(found.path) - 1) == pytest.approx(found.choice.shown, rel=1e-4)
    assert own.later == pytest.approx(found.later, rel=1e-4)
    assert own.targets == pytest.approx(found.targets, rel=1e-4)
    shown = shown_by(scene.prospect.pose_views.views(), found.path[1])
    assert first.rate == pytest.approx(0.95 * float(scene.prospect.weights[list(shown)].sum()), rel=1e-4)
    # In steps: what the best of them loses by coming one later.
    all_of_it = found.choice.shown + found.choice.after / 0.7
    worth = found.choice.shown + found.choice.after
    assert judged[0].value == pytest.approx(worth / (0.05 * all_of_it), rel=1e-4)
