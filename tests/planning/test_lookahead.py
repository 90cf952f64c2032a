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

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.mapping.lattice import offsets_of
from dream.planning._kernels import lookahead
from dream.planning._kernels.lookahead import FREE, UNKNOWN, Views
from dream.planning.lookahead import NOTHING, SERVICE, LookAhead, Plan, Prospect
from dream.planning.outlook import Listed, Outlook
from dream.planning.travel import Pose, Travel, careful_standoff, careful_travel
from dream.protocol import DREAM_V1
from dream.types import BoolArray, Mission
from tests.planning.views import shown_by

NEARSIGHTED = replace(DREAM_V1, reach=2.5)
"""So that an arena can be small."""
SMALL = Bounds(-4.0, -4.0, 4.0, 4.0)
OFFSETS = offsets_of(NEARSIGHTED)
TURNS = np.array(NEARSIGHTED.turns, np.int64)


@dataclass(frozen=True)
class Puzzle:
    """All that the search is given."""

    outlook: Outlook
    weights: npt.NDArray[np.float32]
    views: Views
    moves: npt.NDArray[np.uint8]
    known: BoolArray
    start: Pose

    def beam(
        self, width: int, horizon: int, discount: float
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.float64], int]:
        """Pose, parent and score of each sequence, and the first of the last level."""
        pose, parent, score, _, _, first = lookahead.beam(
            self.weights,
            self.views,
            self.moves,
            OFFSETS,
            TURNS,
            self.start,
            self.known,
            width,
            horizon,
            discount,
        )
        return pose, parent, score, first

    def tile(self, row: int, col: int) -> int:
        return (row + self.views.pad) * self.views.stride + col + self.views.pad

    def shown(self, pose: Pose) -> frozenset[int]:
        """Elements of any weight."""
        return frozenset(e for e in shown_by(self.views, *pose) if self.weights[e] > 0.0)

    def next_poses(self, pose: Pose, first: bool, seen: frozenset[int]) -> Iterator[Pose]:
        """Where one action may lead, in the order of the protocol."""
        row, col, heading = pose
        for turn in TURNS:
            to = int(heading + turn) % NEARSIGHTED.headings
            if turn:
                yield row, col, to
            for a in range(len(NEARSIGHTED.advances)):
                end = row + int(OFFSETS[to, a, 1]), col + int(OFFSETS[to, a, 0])
                kind = self.moves[row, col, to, a]
                if kind == FREE or (
                    kind == UNKNOWN and not first and (self.known[self.tile(*end)] or self.tile(*end) in seen)
                ):
                    yield *end, to

    def flat(self, pose: Pose) -> int:
        return int(np.ravel_multi_index(pose, self.moves.shape[:3]))


def _puzzle(seed: int, start: Pose = (8, 8, 2)) -> Puzzle:
    """Random ground with a few solids; weights are whole numbers, so that sums are exact."""
    generator = np.random.default_rng(seed)
    occupancy = OccupancyMap(SMALL, NEARSIGHTED)
    solid = generator.random(occupancy.shape) < 0.004
    occupancy._write("log_odds", (0, 0), 20 * solid)
    outlook = Outlook(Mission(NEARSIGHTED, SMALL, 200), 1.0)
    outlook.update(occupancy)
    nodes = generator.choice(outlook.rows * outlook.cols, 30, replace=False)
    sizes = generator.integers(0, 3, 30 * NEARSIGHTED.headings)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    elements = generator.integers(0, 6, starts[-1])
    # Within one view an element is listed once.
    for k in range(len(sizes)):
        here = slice(starts[k], starts[k + 1])
        elements[here] = generator.choice(6, sizes[k], replace=False)
    worth = generator.integers(1, 9, 6).astype(np.float64)
    listed = Listed(worth, worth, np.zeros((6, 2)), nodes, starts, elements)
    views = outlook.views(listed)
    weights = np.concatenate([generator.integers(0, 9, 2 * outlook.tiles), listed.weights])
    weights[: 2 * outlook.tiles][generator.random(2 * outlook.tiles) < 0.5] = 0
    shape = (outlook.rows, outlook.cols, *OFFSETS.shape[:2])
    free = (generator.random(shape) < 0.5).astype(np.uint8)
    row, col = np.indices(shape[:2])
    for heading in range(shape[2]):
        for advance in range(shape[3]):
            to_row, to_col = row + OFFSETS[heading, advance, 1], col + OFFSETS[heading, advance, 0]
            outside = (to_row < 0) | (to_row >= shape[0]) | (to_col < 0) | (to_col >= shape[1])
            free[outside, heading, advance] = 0
    moves = outlook.moves(free, occupancy, 0.5)
    known = generator.random(outlook.tiles) < 0.3
    return Puzzle(outlook, weights.astype(np.float32), views, moves, known, start)


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
    puzzle = _puzzle(seed)
    shown = shown_by(puzzle.views, row, col, heading)
    half = frozenset(e for e in range(len(puzzle.weights)) if e % 2)
    for seen in (frozenset[int](), half):
        found = lookahead.gain(
            puzzle.weights, _bits(seen, len(puzzle.weights)), puzzle.views, row, col, heading
        )
        assert found == sum(puzzle.weights[list(shown - seen)])


@given(seed=st.integers(0, 30), row=st.integers(0, 16), col=st.integers(0, 16), heading=st.integers(0, 11))
def test_a_gain_is_the_same_to_the_last_bit_where_the_tiles_in_view_are_known(
    seed: int, row: int, col: int, heading: int
) -> None:
    puzzle, pose = _puzzle(seed), (row, col, heading)
    generator = np.random.default_rng(seed)
    # Sums of these depend on their order.
    weights = puzzle.weights * generator.random(len(puzzle.weights)).astype(np.float32) ** 9
    seen = generator.integers(0, 2**64, (len(weights) + 63) // 64, np.uint64)
    room = np.empty(int(np.diff(puzzle.views.first).max()), np.uint16)
    tiles = room[: lookahead.clear_tiles(weights, puzzle.views, *pose, room)]
    listed = puzzle.outlook.tiles * 2
    in_list = puzzle.views.offset[puzzle.views.first[heading] + tiles.astype(int)]
    shown = {e for e in shown_by(puzzle.views, *pose) if e < listed and weights[e] > 0.0}
    assert set(puzzle.tile(row, col) + in_list) == shown
    expected = lookahead.gain(weights, seen, puzzle.views, *pose)
    assert lookahead.gain_of(tiles, weights, seen, puzzle.views, *pose) == expected


def test_what_was_looked_at_gains_nothing_again() -> None:
    puzzle = _puzzle(1)
    seen = _bits(frozenset(), len(puzzle.weights))
    assert lookahead.gain(puzzle.weights, seen, puzzle.views, 8, 8, 0) > 0.0
    lookahead.look(puzzle.weights, seen, puzzle.views, 8, 8, 0)
    np.testing.assert_array_equal(seen, _bits(puzzle.shown((8, 8, 0)), len(puzzle.weights)))
    assert lookahead.gain(puzzle.weights, seen, puzzle.views, 8, 8, 0) == 0.0
    assert lookahead.gain(puzzle.weights, seen, puzzle.views, 8, 8, 6) > 0.0


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
    rows, cols = (k.ravel() for k in np.indices((17, 17)))
    steps = generator.integers(-1, farthest + 1, (len(rows), NEARSIGHTED.headings))
    gains = lookahead.best_gains(puzzle.weights, puzzle.views, rows, cols, steps)
    slow = np.array(
        [
            [
                sum(puzzle.weights[list(shown_by(puzzle.views, int(row), int(col), heading))])
                for heading in range(NEARSIGHTED.headings)
            ]
            for row, col in zip(rows, cols, strict=True)
        ]
    )
    np.testing.assert_array_equal(lookahead.gains(puzzle.weights, puzzle.views, rows, cols), slow)
    rates = np.where(steps > 0, slow / np.maximum(steps, 1), 0.0)
    assert (gains[rates == rates.max()] == slow[rates == rates.max()]).all()
    assert ((gains == slow) | (gains == 0.0)).all()
    assert not gains[steps <= 0].any()
    if farthest == 40:
        assert np.count_nonzero(gains) < 0.5 * np.count_nonzero(rates), "most promise too little"


def test_where_nothing_is_worth_a_look_no_pose_gains() -> None:
    puzzle = _puzzle(1)
    node = np.array([8])
    for steps in (1, 0, -1):
        nothing = np.zeros_like(puzzle.weights)
        assert not lookahead.best_gains(nothing, puzzle.views, node, node, np.full((1, 12), steps)).any()
    assert not lookahead.best_gains(
        puzzle.weights, puzzle.views, node, node, np.zeros((1, 12), np.int64)
    ).any()


# ----------------------------------------------------------------------------------------------------- beam


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
        taken: set[tuple[int, int, int]] = set()
        kept: list[tuple[Pose, int, float]] = []
        for end, parent, score in sorted(candidates, key=lambda candidate: -candidate[2]):
            place = end[0] // 2, end[1] // 2, end[2]
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
    puzzle.moves[puzzle.start[0], puzzle.start[1], :, 0] = 0
    ends = list(puzzle.next_poses(puzzle.start, True, frozenset()))
    assert len({(row // 2, col // 2, heading) for row, col, heading in ends}) == len(ends), "none shadows one"
    _, _, score, first = puzzle.beam(10_000, depth, 0.5)
    assert score[first:].max() == _best_by_brute_force(puzzle, depth, 0.5)


def test_in_depth_a_beam_finds_almost_the_best_and_never_more() -> None:
    """Sequences that end in the same place shadow each other, so that the very best may be lost."""
    for seed in range(3):
        puzzle = _puzzle(seed)
        best = _best_by_brute_force(puzzle, 3, 0.5)
        _, _, score, first = puzzle.beam(10_000, 3, 0.5)
        assert 0.9 * best <= score[first:].max() <= best


@pytest.mark.parametrize("width", [1, 7, 48])
@pytest.mark.parametrize("seed", range(4))
def test_a_beam_equals_its_slow_twin(seed: int, width: int) -> None:
    puzzle = _puzzle(seed)
    pose, parent, score, first = puzzle.beam(width, 4, 0.5)
    slow = _slow_beam(puzzle, width, 4, 0.5)
    starts = np.cumsum([0] + [len(level) for level in slow])
    assert first == starts[-2]
    assert pose.tolist() == [puzzle.flat(end) for level in slow for end, _, _ in level]
    assert score.tolist() == [value for level in slow for _, _, value in level]
    for k, level in enumerate(slow[1:], start=1):
        assert parent[starts[k] : starts[k + 1]].tolist() == [starts[k - 1] + above for _, above, _ in level]


@given(seed=st.integers(0, 40), width=st.integers(1, 30))
def test_the_first_move_is_free_and_later_ones_lead_over_ground_known_or_seen_by_then(
    seed: int, width: int
) -> None:
    puzzle = _puzzle(seed)
    pose, parent, _, first = puzzle.beam(width, 4, 0.9)
    for end in range(first, len(pose)):
        chain = [end]
        while parent[chain[-1]] >= 0:
            chain.append(int(parent[chain[-1]]))
        poses = [
            tuple(map(int, np.unravel_index(int(pose[k]), puzzle.moves.shape[:3]))) for k in reversed(chain)
        ]
        seen: set[int] = set()
        for step, (before, after) in enumerate(pairwise(poses)):
            if before[:2] != after[:2]:
                moved = after[1] - before[1], after[0] - before[0]
                advance = [tuple(offset) for offset in OFFSETS[after[2]]].index(moved)
                kind = puzzle.moves[before[0], before[1], after[2], advance]
                tile = puzzle.tile(after[0], after[1])
                assert kind == FREE or (kind == UNKNOWN and step > 0 and (puzzle.known[tile] or tile in seen))
            seen |= puzzle.shown((after[0], after[1], after[2]))


@pytest.mark.parametrize(("known", "leaves"), [(False, False), (True, True)])
def test_into_the_unknown_it_never_goes_at_once(known: bool, leaves: bool) -> None:
    puzzle = _puzzle(3)
    puzzle = replace(
        puzzle,
        moves=np.where(puzzle.moves > 0, UNKNOWN, 0).astype(np.uint8),
        known=np.full_like(puzzle.known, known),
        weights=np.zeros_like(puzzle.weights),
    )
    headings = NEARSIGHTED.headings
    for horizon, may in ((1, False), (2, leaves)):
        pose, _, _, first = puzzle.beam(1000, horizon, 0.9)
        away = {int(p) // headings for p in pose[first:]} - {puzzle.flat(puzzle.start) // headings}
        assert bool(away) == may


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
    x, y = np.array(places, np.float64).reshape(-1, 2).T
    areas, left = (np.array(mass), x, y, np.array(service)), np.zeros(len(mass), np.int64)
    # With no rates worked out beforehand, and with all.
    none, every = np.zeros(len(mass), np.bool_), np.ones(len(mass), np.bool_)
    on_the_way, ahead = (
        lookahead.tour(*areas, *at, 2.0, 4.0, discount, keep, rates, rated, left)
        for rated in (none, every)
        for rates in [lookahead.rates_between(*areas, rated, 2.0, 4.0)]
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
    outlook, count = puzzle.outlook, len(puzzle.weights)
    none = np.zeros(0, np.int64)
    listed = Listed(np.ones(6), np.ones(6), np.zeros((6, 2)), none, np.zeros(1, np.int64), none)
    x, y, area = outlook.places(listed)
    ends = [(8, 8, 0), (2, 13, 5)]
    seen = [
        frozenset(range(0, count, 3)) if everywhere else puzzle.shown((8, 10, 6)),
        puzzle.shown((8, 8, 0)),
    ]
    alike = set(area[puzzle.weights > 0.0]) - set(area[list(seen[0] | seen[1])])
    assert bool(alike) != everywhere, "areas that no sequence has seen any of"
    worth, steps = lookahead.tours(
        puzzle.weights,
        puzzle.views,
        np.stack([_bits(elements, count) for elements in seen]),
        np.array([puzzle.flat(end) for end in ends]),
        x,
        y,
        area,
        outlook.areas,
        NEARSIGHTED.lattice,
        40.0,
        2.0,
        4.0,
        0.9,
        1.0,
    )
    for k, (end, elements) in enumerate(zip(ends, seen, strict=True)):
        left = np.array([e not in elements and puzzle.weights[e] > 0.0 for e in range(count)])
        weights = np.where(left, puzzle.weights, 0.0).astype(np.float64)
        mass = np.bincount(area, weights, outlook.areas)
        middle = [np.bincount(area, weights * at, outlook.areas) / np.maximum(mass, 1e-9) for at in (x, y)]
        service = 0.3 + np.bincount(area, left, outlook.areas) / 40.0
        expected = _tour(
            list(mass),
            list(zip(*middle, strict=True)),
            list(service),
            at=(end[1] * NEARSIGHTED.lattice, end[0] * NEARSIGHTED.lattice),
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
    outlook = Outlook(Mission(DREAM_V1, WIDE, 200), 1.5)
    travel = careful_travel(SE2(-9.0, 0.0, 0.0), occupancy)
    ground = np.zeros(occupancy.shape)
    for rows, cols, weight in worth:
        ground[rows, cols] = weight
    tiles, nothing = outlook.on_tiles(ground), np.zeros(outlook.tiles, np.float32)
    prospect = Prospect(outlook, ground=tiles, hiding=nothing, targets=tiles, hidden=nothing)
    moves = outlook.moves(travel.free, occupancy, careful_standoff(DREAM_V1))
    return Scene(travel, prospect, moves, outlook.known_tiles(occupancy))


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
    shown = shown_by(scene.prospect.outlook.views(), *end)
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
        shown = shown_by(scene.prospect.outlook.views(), *pose)
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
        shown = set().union(*(shown_by(scene.prospect.outlook.views(), *pose) for pose in poses))
        tiles = [element for element in shown if element < scene.prospect.outlook.tiles]
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
    outlook, weights = scene.prospect.outlook, scene.prospect.weights.astype(np.float64)
    views, total = outlook.views(), float(weights.sum())
    seen: set[int] = set()
    gained = 0.0
    for step, pose in enumerate(plan.path[1:], start=1):
        shown = shown_by(views, *pose)
        gained += discount**step * float(weights[list(shown - seen)].sum())
        seen |= shown
    assert plan.choice.shown == pytest.approx(gained, rel=1e-4)

    weights[list(seen)] = 0.0
    x, y, area = outlook.places()
    mass = np.bincount(area, weights, outlook.areas)
    middle = [np.bincount(area, weights * at, outlook.areas) / np.maximum(mass, 1e-9) for at in (x, y)]
    service = lookahead.DETOUR + np.bincount(area, weights > 0.0, outlook.areas) / (SERVICE * views.first[1])
    row, col, _ = plan.path[-1]
    worth, steps = _tour(
        list(mass),
        list(zip(*middle, strict=True)),
        list(service),
        at=(col * DREAM_V1.lattice, row * DREAM_V1.lattice),
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
    if before[:2] != after[:2]:
        moved = after[1] - before[1], after[0] - before[0]
        advance = [tuple(offset) for offset in offsets_of(DREAM_V1)[after[2]]].index(moved)
        assert scene.travel.free[before[0], before[1], after[2], advance]
    shown = set().union(*(shown_by(scene.prospect.outlook.views(), *pose) for pose in plan.path[1:]))
    assert sum(scene.prospect.weights[list(shown)]) > 0.0
