"""The parts of the rivals in space against closed forms and brute force, and what they do before a plate."""

from __future__ import annotations

import math
from itertools import pairwise, permutations, product
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dream.geometry import SE2, Bounds
from dream.mapping.volume import Volume
from dream.planning._kernels.space_cover import ShownFrom, best_of_parts, greedy_cover, grow_tree, open_tour
from dream.planning.space.belief import Chooser
from dream.planning.space.looks import optics_of
from dream.planning.space.remains import SURFACE, LeftToInspect
from dream.planning.space.rivals.cover_tour import CoverTour, CoverTourChooser
from dream.planning.space.rivals.fuel import Fuel, FuelChooser, layered_path, parts_of
from dream.planning.space.rivals.inspection import FloatArray, Scene, rate_of, travel
from dream.planning.space.rivals.space_nbv import SpaceNextBestView, SpaceNextBestViewChooser
from dream.planning.space.ways import KnownWays, ways_in
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Decision, Mission, Observation

BOUNDS = Bounds(-5.0, -4.0, 5.0, 4.0)
Z = -6.0
MISSION = Mission(PROTOCOL, BOUNDS, 100)
LOOKS = PROTOCOL.headings * len(PROTOCOL.tilts)


@pytest.fixture(scope="module")
def ways() -> KnownWays:
    """A ball of known water around the origin."""
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, Z], 4.0)
    return ways_in(volume, BOUNDS, PROTOCOL)


def at(x: float = 0.0, y: float = 0.0, z: float = Z, yaw: float = 0.0) -> Observation:
    """As much of an observation as planning from it takes."""
    return cast(Observation, SimpleNamespace(pose=SE2(x, y, yaw), z=z, tilt=PROTOCOL.camera_pitch))


def plate(x: float = 4.5, *, kept: slice = slice(None)) -> LeftToInspect:
    """A plate across the x axis, 4 m wide and 2 m high, that is to be looked at from the origin."""
    y, z = np.meshgrid(np.arange(-1.75, 2.0, 0.5), Z + np.arange(-0.75, 1.0, 0.5))
    points = np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])[kept]
    n = len(points)
    return LeftToInspect(
        points, np.tile([-1.0, 0.0, 0.0], (n, 1)), np.full(n, 0.25), np.full(n, SURFACE), 0.0, 0.0
    )


def random_shown(rng: np.random.Generator, nodes: int, elements: int) -> ShownFrom:
    """Each node shows some elements by some looks."""
    which: list[int] = []
    bits: list[int] = []
    first = [0]
    for _ in range(nodes):
        some = rng.choice(elements, rng.integers(1, elements), replace=False)
        which.extend(some)
        bits.extend(rng.integers(1, 1 << LOOKS, len(some), dtype=np.uint64))
        first.append(len(which))
    return ShownFrom(np.array(first), np.array(which, np.int32), np.array(bits, np.uint64))


def sets_of(shown: ShownFrom, allowed: np.ndarray[Any, Any]) -> dict[tuple[int, int], set[int]]:
    """The elements of each look that is allowed."""
    return {
        (node, look): {
            int(shown.which[i])
            for i in range(shown.first[node], shown.first[node + 1])
            if int(shown.bits[i]) >> look & 1
        }
        for node, look in product(range(len(allowed)), range(LOOKS))
        if allowed[node, look]
    }


# ------------------------------------------------------------------------------------------------ cover


@pytest.mark.parametrize("seed", range(5))
def test_the_cover_covers_all_that_looks_show_and_takes_the_best_each_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shown, weights = random_shown(rng, 12, 20), rng.uniform(0.5, 2.0, 20)
    allowed = rng.random((12, LOOKS)) < 0.1
    looks, added = greedy_cover(shown, weights, allowed, 1e-6)
    sets, covered = sets_of(shown, allowed), set[int]()
    for (node, look), gain in zip(looks.tolist(), added, strict=True):
        gains = {key: weights[list(shows - covered)].sum() for key, shows in sets.items()}
        assert gain == pytest.approx(max(gains.values()))
        assert gains[node, look] == pytest.approx(gain)
        covered |= sets[node, look]
    assert covered == set().union(*sets.values())


def test_a_look_that_adds_too_little_is_left_out() -> None:
    shown = ShownFrom(np.array([0, 2, 3]), np.array([0, 1, 2], np.int32), np.array([1, 1, 1], np.uint64))
    looks, added = greedy_cover(shown, np.array([1.0, 1.0, 0.4]), np.ones((2, LOOKS), np.bool_), 0.5)
    assert looks.tolist() == [[0, 0]]
    assert added.tolist() == [2.0]


def test_the_best_look_at_a_part_counts_that_part_alone() -> None:
    rng = np.random.default_rng(0)
    shown, weights = random_shown(rng, 6, 15), rng.uniform(0.5, 2.0, 15)
    allowed, part_of = rng.random((6, LOOKS)) < 0.3, rng.integers(3, size=15)
    gains, looks = best_of_parts(shown, weights, part_of, 3, allowed)
    sets = sets_of(shown, allowed)
    for node, part in product(range(6), range(3)):
        each = {
            look: sum(weights[k] for k in shows if part_of[k] == part)
            for (of, look), shows in sets.items()
            if of == node
        }
        assert gains[node, part] == pytest.approx(max(each.values()))
        assert each[looks[node, part]] == pytest.approx(gains[node, part])


# ------------------------------------------------------------------------------------------------ tours


def test_a_tour_of_points_on_a_line_goes_to_the_nearer_end_first() -> None:
    places = np.array([0.0, 5.0, -1.0, 2.0, -3.0, 9.0, 7.0])
    order = open_tour(np.abs(places[:, None] - places))
    assert places[order].tolist() == [-1.0, -3.0, 2.0, 5.0, 7.0, 9.0]


@pytest.mark.parametrize("seed", range(6))
def test_a_short_tour_is_hardly_longer_than_the_shortest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 10.0, (7, 2))
    # It costs more one way than the other.
    costs = np.linalg.norm(places[:, None] - places, axis=-1) + rng.uniform(0.0, 1.0, (7, 7))

    def length(order: Any) -> float:
        return float(sum(costs[a, b] for a, b in pairwise([0, *order])))

    order = open_tour(costs)
    assert sorted(order) == list(range(1, 7))
    assert length(order) <= 1.05 * min(length(other) for other in permutations(range(1, 7)))


def test_a_shortest_path_through_layers_is_what_brute_force_finds() -> None:
    rng = np.random.default_rng(1)
    first = rng.random(4)
    between: list[FloatArray] = [rng.random((4, 3)), rng.random((3, 5)), rng.random((5, 1))]

    def cost(path: tuple[int, ...]) -> float:
        return float(
            first[path[0]] + sum(one[a, b] for one, (a, b) in zip(between, pairwise(path), strict=True))
        )

    best = min(product(range(4), range(3), range(5), range(1)), key=cost)
    assert layered_path(first, between) == list(best)


def test_a_rate_is_of_the_part_of_a_tour_that_yields_most() -> None:
    assert rate_of(np.array([1.0, 8.0, 1.0]), np.array([2.0, 1.0, 5.0])) == pytest.approx(3.0)


# ------------------------------------------------------------------------------------------------ steps


def test_steps_between_looks_count_way_turns_and_climb() -> None:
    here = np.array([[10, 10, 10, 0, 1]])

    def steps(*view: int) -> float:
        return float(travel(here, np.array([view]), PROTOCOL)[0, 0])

    assert steps(10, 10, 28, 0, 1) == pytest.approx(9.0 / 1.8), "ahead"
    assert steps(10, 10, 28, 3, 1) == pytest.approx(9.0 / 1.8 + 1.0), "it turns at the end"
    assert steps(10, 10, 28, 4, 1) == pytest.approx(9.0 / 1.8 + 2.0), "120° take two moves"
    assert steps(16, 10, 10, 0, 1) == pytest.approx(3.0), "straight up"
    assert steps(16, 10, 10, 4, 1) == pytest.approx(3.0), "it turns as it climbs"
    assert steps(10, 10, 10, 0, 0) == pytest.approx(1.0), "the camera alone"
    assert steps(10, 10, 10, 0, 1) == 0.0


def test_in_free_water_they_are_about_the_steps_of_the_ways(ways: KnownWays) -> None:
    scene = Scene(ways, plate(), at())
    rng = np.random.default_rng(0)
    poses = np.argwhere(scene.steps > 0)
    poses = poses[rng.choice(len(poses), 300, replace=False)]
    views = np.column_stack([poses, np.full(len(poses), scene.here[4])])
    told = travel(scene.here[None], views, PROTOCOL)[0]
    apart = np.abs(told - scene.steps[tuple(poses.T)])
    assert apart.mean() < 0.8
    assert (apart < 2.0).mean() > 0.9, "but where the ball leaves no room to turn on the way"


# ------------------------------------------------------------------------------------------------ clusters


def test_what_faces_away_or_is_apart_is_another_cluster_and_none_is_too_long() -> None:
    wall = np.column_stack([np.arange(0.0, 10.0, 0.5), np.zeros(20), np.zeros(20)])
    points = np.concatenate([wall, wall + np.array([0.0, 0.2, 0.0]), [[0.0, 9.0, 0.0]]])
    normals = np.repeat([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]], [20, 20, 1], axis=0)
    number = parts_of(points, normals, 4.0)
    assert set(number) == set(range(number.max() + 1))
    for k in range(number.max() + 1):
        assert np.ptp(points[number == k, 0]) <= 4.0
        assert len(np.unique(normals[number == k], axis=0)) == 1
    assert (number == number[-1]).sum() == 1


# ------------------------------------------------------------------------------------------------ tree


def test_a_tree_is_of_real_moves_and_its_scores_are_its_gains_discounted(ways: KnownWays) -> None:
    scene, decay = Scene(ways, plate(), at(yaw=math.pi)), 0.3
    rng = np.random.default_rng(0)
    samples = np.column_stack([scene.here[:3] + rng.uniform(-8.0, 8.0, (200, 3)), rng.integers(12, size=200)])
    tree = grow_tree(
        ways.scene,
        optics_of(PROTOCOL),
        scene.lattice,
        ways.moves,
        scene.elements,
        scene.here[:3],
        int(scene.here[3]),
        int(scene.here[4]),
        np.empty((0, 4), np.int64),
        samples,
        decay,
        1.0,
        6,
    )
    assert len(tree.node) > 60
    assert tree.gain.max() > 1.0
    assert tree.depth.max() == 6
    for n in range(1, len(tree.node)):
        before = tree.parent[n]
        assert tree.depth[n] == tree.depth[before] + 1
        assert tree.score[n] == pytest.approx(
            tree.score[before] + tree.gain[n] * math.exp(-decay * tree.depth[n])
        )
        turn = (tree.heading[n] - tree.heading[before]) % PROTOCOL.headings
        assert turn in {one % PROTOCOL.headings for one in PROTOCOL.turns}
        up, north, east = (tree.node[n] - tree.node[before]).tolist()
        assert up * PROTOCOL.lattice in PROTOCOL.climbs
        ahead = [PROTOCOL.offset(int(tree.heading[n]), far) for far in PROTOCOL.advances]
        assert (east, north) in [(0, 0), *ahead]
        shown, k = 0.0, n
        while k > 0:
            shown, k = shown + tree.gain[k], tree.parent[k]
        assert shown <= scene.elements.weights.sum() + 1e-9, "nothing counts twice"


# ------------------------------------------------------------------------------------------------ all


def choosers() -> list[Chooser]:
    return [
        CoverTourChooser(CoverTour()),
        SpaceNextBestViewChooser(SpaceNextBestView()),
        FuelChooser(Fuel()),
    ]


every = pytest.mark.parametrize("number", range(3), ids=lambda k: type(choosers()[k]).__name__)


def moved(observation: Observation, move: Decision) -> Observation:
    """Where a move leads."""
    yaw = observation.pose.yaw + move.turn
    east, north = PROTOCOL.offset(PROTOCOL.heading_index(yaw), move.advance) if move.advance else (0, 0)
    to = at(
        observation.pose.x + east * PROTOCOL.lattice,
        observation.pose.y + north * PROTOCOL.lattice,
        observation.z + move.climb,
        yaw,
    )
    return cast(
        Observation,
        SimpleNamespace(pose=to.pose, z=to.z, tilt=observation.tilt if move.tilt is None else move.tilt),
    )


@every
def test_it_turns_to_a_plate_behind_it_until_all_was_shown(number: int, ways: KnownWays) -> None:
    chooser: Any = choosers()[number]
    observation, left, rates = at(yaw=math.pi), plate(), []
    for _ in range(12):
        if not len(left):
            break
        plan = chooser.plan(ways, left, observation)
        if plan is None:
            break
        rates.append(plan.rate)
        assert not plan.move.stops
        assert plan.why
        observation = moved(observation, plan.move)
        scene = Scene(ways, left, observation)
        left = left.only(~shown(scene))
    assert rates
    assert rates[0] > 0.5
    assert left.area.sum() < 0.5, "less than is worth a look"
    assert chooser.plan(ways, plate(kept=slice(0)), observation) is None


def shown(scene: Scene) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(n,) what shows from here."""
    from dream.planning.space.looks import shown

    pose, here = scene.observation.pose, scene.observation
    return shown(scene.ways, (pose.x, pose.y, here.z), pose.yaw, here.tilt, *scene.elements[:3])


@every
def test_what_is_out_of_reach_is_no_reason_to_move(number: int, ways: KnownWays) -> None:
    chooser: Any = choosers()[number]
    assert chooser.plan(ways, plate(30.0), at()) is None


def test_a_tour_is_kept_until_its_first_look_was_taken_or_shows_less(ways: KnownWays) -> None:
    chooser, observation = CoverTourChooser(CoverTour(least=0.25)), at(yaw=math.pi)
    plan = chooser.plan(ways, plate(), observation)
    first = chooser.tour
    assert plan is not None
    assert first is not None
    scene = Scene(ways, plate(), observation)
    chooser.plan(ways, plate(), observation)
    assert chooser.tour is first, "nothing changed"
    there = first.views[0]
    x, y, z = (scene.lattice.first + scene.relative(there[None])[0][2::-1] * PROTOCOL.lattice).tolist()
    chooser.plan(ways, plate(kept=slice(0, 4)), observation)
    assert chooser.tour is not first, "most of what it was to show was seen"
    chooser.tour = first
    arrived = at(x, y, z, there[3] * PROTOCOL.heading_step)
    arrived = cast(Any, SimpleNamespace(pose=arrived.pose, z=z, tilt=PROTOCOL.tilts[there[4]]))
    chooser.plan(ways, plate(), arrived)
    assert chooser.tour is not first, "it was taken"


def test_places_that_a_tree_found_are_flown_to_when_the_next_finds_nothing(ways: KnownWays) -> None:
    chooser = SpaceNextBestViewChooser(SpaceNextBestView())
    chooser.plan(ways, plate(), at())
    assert chooser.kept
    chooser.planner = SpaceNextBestView(samples=1)
    chooser.branch = chooser.branch[:0]
    plan = chooser.plan(ways, plate(), at(-3.0, 0.0, Z, math.pi))
    assert plan is not None
    assert plan.rate > 0.0
    assert "earlier trees" in plan.why
