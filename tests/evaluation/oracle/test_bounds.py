"""Bounds: what they claim is flown and searched again, and what is read is what was written."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.control import setpoint
from dream.evaluation.metrics import COMPLETE, Scorer
from dream.evaluation.oracle import bounds as bounds_module
from dream.evaluation.oracle.bounds import (
    KNOWN,
    Limit,
    OracleBounds,
    bound,
    check,
    drive,
    every_known,
    known_bounds,
    may_miss_t98,
    read_bounds,
    tighten,
    tour_poses,
    walks_of,
    write_bounds,
)
from dream.evaluation.oracle.graph import pose_graph
from dream.evaluation.oracle.tours import best_tour, missed, trimmed
from dream.evaluation.results import Results, Trace
from dream.evaluation.suites import Case, suite_named
from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.protocol import DREAM_V1
from dream.robots import Teleport
from dream.sim.files import world_hash
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND, Arrival, Decision, Guarded, Step
from tests.sim.arenas import FLOOR, arena, placed

PLACES = [(-9.0, -9.0), (9.5, -9.5), (0.2, 10.5), (11.0, 4.0)]
"""Out of sight of the start, which is in the middle."""
COUNT = 60
PAPER_OFTEN = [
    pytest.param(suite, marks=[] if suite == "paper" else [pytest.mark.slow, pytest.mark.rare])
    for suite in KNOWN
]
"""Every suite with bounds; all but the paper's in `make test-slow` alone."""


@pytest.fixture(scope="module")
def world() -> World:
    """Sixty clumps, most of them at two places and the last one alone; a boulder stands to the south."""
    points = [(x + 0.1 * k, y + 0.03 * k) for k in range(20) for x, y in PLACES[:3]]
    points[-1] = PLACES[3]
    boulder = placed(0, [(0.0, -6.0, FLOOR)], (1.5, 1.5, 3.0))
    return arena(boulder, placed(0, [(x, y, FLOOR) for x, y in points], 0.02))


@pytest.fixture(scope="module")
def found(world: World) -> OracleBounds:
    # On a machine that has to compile the searches first, the first budget goes into that.
    found = bound(world, DREAM_V1, budget_s=3.0)
    return bound(world, DREAM_V1, budget_s=5.0, known=found)


def test_both_ends_are_found_and_hold(world: World, found: OracleBounds) -> None:
    assert found.countable == COUNT
    for limit in (found.full, found.t98):
        assert limit.best_tour is not None
        assert LOOK_AROUND < limit.lower_bound <= limit.best_tour
        assert limit.status == ("optimal" if limit.lower_bound == limit.best_tour else "gap")
    assert (found.t98.best_tour or 0) <= (found.full.best_tour or 0)
    check(found, world)


def test_what_certifies_a_share_certifies_all(world: World, found: OracleBounds) -> None:
    weaker = replace(found.full, lower_bound=found.t98.lower_bound, witnesses=found.t98.witnesses)
    check(replace(found, full=weaker), world)


def test_a_search_yields_ends_that_only_close_in(world: World) -> None:
    states = list(tighten(world, DREAM_V1, budget_s=1.0))
    assert states[0].full == Limit(LOOK_AROUND + 1, None, (), ())
    for before, after in pairwise(states):
        for share in ("full", "t98"):
            old, new = getattr(before, share), getattr(after, share)
            assert new.lower_bound >= old.lower_bound
            assert (new.best_tour or math.inf) <= (old.best_tour or math.inf)
    resumed = next(tighten(world, DREAM_V1, budget_s=0.0, known=states[-1]))
    assert replace(resumed, cpu_s=0.0) == replace(states[-1], cpu_s=0.0)


def test_a_tour_flown_in_the_simulator_scores_its_share_at_its_step(
    world: World, found: OracleBounds
) -> None:
    drive(found, world)
    poses = tour_poses(found, world, DREAM_V1)
    assert len(poses) + LOOK_AROUND - 1 == found.full.best_tour
    assert Visibility(world, DREAM_V1).seen(poses).any(axis=0).all()


# Around the start: in all of a world a graph takes long, and a tour of a wreck is flown for long.
@pytest.mark.rare
@pytest.mark.parametrize(
    ("name", "area"),
    [("reef/string", Bounds(-20.0, 0.0, 0.0, 20.0)), ("wreck/1", Bounds(-20.0, -12.0, -4.0, 4.0))],
)
def test_a_mission_that_flies_a_tour_is_scored_as_the_tour_says(name: str, area: Bounds) -> None:
    whole = make_world(name, 1)
    world = replace(whole, bounds=area, starts=whole.starts[:1])
    visibility = Visibility(world, DREAM_V1)
    graph = pose_graph(world, DREAM_V1, visibility=visibility)
    count = len(graph.individuals)
    shares = {"t98": may_miss_t98(count), "t100": 0}
    tour = best_tour(graph, 0, budget_s=0.0)
    assert tour is not None
    parts = {share: trimmed(graph, may_miss, tour) for share, may_miss in shares.items()}
    reached = {share: LOOK_AROUND + len(part) for share, part in parts.items() if part is not None}

    renderer = Renderer(world)
    robot = Teleport(world, DREAM_V1, renderer=renderer, solids=visibility.solids)
    scorer = Scorer(world, DREAM_V1, visibility=visibility, renderer=renderer)
    occupancy = OccupancyMap(world.bounds, DREAM_V1)
    actions = [graph.actions[action] for action in tour]
    moves = [Decision(turn=turn * DREAM_V1.heading_step, advance=advance) for turn, advance in actions]
    arrival = Arrival(DREAM_V1.snap(world.starts[0]), collided=False, distance=0.0, clearance=math.inf)
    for index, decision in enumerate([Decision(), *[Decision(turn=math.pi / 2)] * LOOK_AROUND, *moves]):
        if index:
            arrival = robot.go_to(setpoint(arrival.pose, decision, DREAM_V1))
        step = Step(index, decision, Guarded(decision), arrival, robot.observe(), occupancy)
        coverage = scorer.add(step)
        if index >= LOOK_AROUND:
            # What is seen, individual by individual, and not only how much.
            flown = graph.seen(graph.walk(tour[: index - LOOK_AROUND]))
            bits = np.unpackbits(flown.astype("<u8").view(np.uint8), bitorder="little")[:count]
            assert (bits == scorer._seen[graph.individuals]).all()
            assert coverage.instances == pytest.approx(bits.mean(), abs=1e-12)
    summary = scorer.summary()
    assert {share: summary[share] for share in shares} == reached
    assert summary["collisions"] == 0

    limits = {
        share: Limit(LOOK_AROUND + 1, reached[share], (), part)
        for share, part in parts.items()
        if part is not None
    }
    told = OracleBounds(
        name, 1, 0, "dream-v1", world_hash(world), count, limits["t100"], limits["t98"], cpu_s=0.0
    )  # fmt: skip
    drive(told, world, visibility=visibility)


def _turned(found: OracleBounds) -> OracleBounds:
    """The first action another one: all that comes after happens elsewhere."""
    tour = found.full.tour
    return replace(found, full=replace(found.full, tour=((tour[0] + 3) % 20, *tour[1:])))


def _cut(found: OracleBounds) -> OracleBounds:
    limit = found.full
    return replace(found, full=replace(limit, tour=limit.tour[:-1], best_tour=(limit.best_tour or 0) - 1))


def _stretched(found: OracleBounds) -> OracleBounds:
    limit = found.t98
    return replace(found, t98=replace(limit, tour=(*limit.tour, 1), best_tour=(limit.best_tour or 0) + 1))


def _into_the_wall(found: OracleBounds) -> OracleBounds:
    return replace(found, full=replace(found.full, tour=(1,) * 30, best_tour=33))


def _over_the_edge(found: OracleBounds) -> OracleBounds:
    return replace(found, full=replace(found.full, tour=(22,) + (1,) * 29, best_tour=33))


def _no_action(found: OracleBounds) -> OracleBounds:
    return replace(found, t98=replace(found.t98, tour=(99, *found.t98.tour[1:])))


@pytest.mark.parametrize(
    ("tamper", "complaint"),
    [
        (_turned, "tour to 100 %"),
        (_cut, "tour to 100 %: expected it at step"),
        (_stretched, "tour to 98.26 %: expected it at step"),
        (_into_the_wall, "touches something"),
        (_over_the_edge, "leaves the arena"),
        (_no_action, "expected actions 0 to 22, got 99"),
        (lambda b: replace(b, world_hash="0" * 64), "world_hash: expected"),
        (lambda b: replace(b, countable=61), "countable: expected 60, got 61"),
        (lambda b: replace(b, start=5), "start: expected 0 to 0"),
    ],
)
def test_a_tampered_tour_is_refused(
    tamper: Callable[[OracleBounds], OracleBounds], complaint: str, world: World, found: OracleBounds
) -> None:
    with pytest.raises(ValueError, match=complaint):
        drive(tamper(found), world)


def test_a_lower_bound_that_its_witnesses_do_not_certify_is_refused(
    world: World, found: OracleBounds
) -> None:
    with pytest.raises(ValueError, match="do not certify"):
        check(replace(found, full=replace(found.full, witnesses=())), world)
    too_high = replace(found.full, lower_bound=(found.full.best_tour or 0) + 1)
    with pytest.raises(ValueError, match="do not certify"):
        check(replace(found, full=too_high), world)


def test_what_the_look_around_shows_takes_no_tour() -> None:
    # Ahead of the start, which looks east, and behind it.
    for points, step in ([], 0), ([(4.0, 0.0)], 0), ([(4.0, 0.0), (-4.0, 0.0)], 2), ([(0.0, -4.0)], 3):
        near = arena(targets=placed(0, [(x, y, FLOOR) for x, y in points], 0.02))
        found = bound(near, DREAM_V1, budget_s=1.0)
        assert (found.full.lower_bound, found.full.best_tour, found.full.status) == (step, step, "optimal")
        assert found.full == found.t98
        check(found, near)


def test_how_many_may_be_missed() -> None:
    for countable in (0, 1, 57, 58, 100, 877, 1314, 3000):
        most = max(
            (
                m
                for m in range(countable + 1)
                if countable and (countable - m) / countable >= COMPLETE - 1e-12
            ),
            default=0,
        )
        assert may_miss_t98(countable) == most
    assert (may_miss_t98(2958), may_miss_t98(877)) == (51, 15)


def test_bounds_are_read_as_they_were_written(found: OracleBounds, tmp_path: Path) -> None:
    other = replace(found, seed=2, full=replace(found.full, best_tour=None, tour=()))
    write_bounds(tmp_path / "some.jsonl", [found, other])
    assert read_bounds(tmp_path / "some.jsonl") == [found, other]
    assert [path.name for path in tmp_path.iterdir()] == ["some.jsonl"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"tour": [1, 2, 3]}, "tour: expected"),
        ({"best_tour": 1, "tour": []}, "best_tour: expected at least the lower bound"),
        ({"status_t98": "best"}, "status_t98: expected"),
        ({"lower_bound": "9"}, "lower_bound: "),
        ({"seed": -1}, "seed: "),
        ({"world_hash": "abc"}, "world_hash: "),
        ({"cpu_s": math.nan}, "cpu_s: "),
        ({"mood": "good"}, "mood: "),
        ({"witnesses": [[]]}, "witnesses.0: "),
        ({"tour_t98": [-1]}, "tour_t98.0: "),
    ],
)
def test_a_damaged_line_is_named(
    change: dict[str, Any], complaint: str, found: OracleBounds, tmp_path: Path
) -> None:
    path = tmp_path / "some.jsonl"
    good = json.dumps(found.as_dict())
    path.write_text(good + "\n" + json.dumps(found.as_dict() | {"seed": 7} | change) + "\n")
    with pytest.raises(ValueError) as error:
        read_bounds(path)
    assert f"{path}, line 2: {complaint}" in str(error.value)


@pytest.mark.parametrize("line", ["", "{", "[1]", "[" * 100_000])
def test_a_line_that_is_no_record_is_named(line: str, found: OracleBounds, tmp_path: Path) -> None:
    path = tmp_path / "some.jsonl"
    path.write_text(json.dumps(found.as_dict()) + "\n" + line + "\n")
    with pytest.raises(ValueError, match="line 2: "):
        read_bounds(path)


def test_a_mission_must_not_stand_in_a_file_twice(found: OracleBounds, tmp_path: Path) -> None:
    write_bounds(tmp_path / "some.jsonl", [found, found])
    with pytest.raises(ValueError, match=r"line 2: .* stands there twice"):
        read_bounds(tmp_path / "some.jsonl")


def test_missions_flown_are_walks_to_begin_with(world: World, found: OracleBounds) -> None:
    poses = tour_poses(found, world, DREAM_V1)
    graph = pose_graph(world, DREAM_V1)
    looks = np.repeat(poses[:1], LOOK_AROUND, axis=0)
    x, y, yaw = np.vstack([looks, poses]).T
    flown = Trace(x, y, np.degrees(yaw), np.zeros(len(x)), np.zeros(len(x), np.bool_))
    results = Results({}, (), {(*found.key, "oracle"): flown, ("dream-v1", "other", 1, 0, "oracle"): flown})
    (walk,) = walks_of(results, found.key)(graph)
    assert walk == found.full.tour
    assert missed(graph, walk) == 0
    hinted = bound(world, DREAM_V1, budget_s=0.01, hints=walks_of(results, found.key))
    assert hinted.full.best_tour == found.full.best_tour


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"start": 1}, "start: expected 0 to 0"),
        ({"budget_s": -1.0}, "budget: expected 0 seconds or more"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: dict[str, Any], complaint: str, world: World) -> None:
    with pytest.raises(ValueError, match=complaint):
        bound(world, DREAM_V1, **{"budget_s": 1.0} | arguments)


def test_bounds_of_another_mission_are_no_beginning(world: World, found: OracleBounds) -> None:
    with pytest.raises(ValueError, match="known bounds: expected those of"):
        bound(world, DREAM_V1, budget_s=1.0, known=replace(found, world_hash="0" * 64))


def test_known_bounds_are_those_of_this_very_world(
    monkeypatch: pytest.MonkeyPatch, found: OracleBounds
) -> None:
    monkeypatch.setattr(bounds_module, "every_known", lambda: {found.key: found})
    assert known_bounds(*found.key, found.world_hash) == found
    assert known_bounds(*found.key, "0" * 64) is None
    assert known_bounds("dream-v1", "reef/none", 1, 0, found.world_hash) is None


def _bounded(suite: str) -> list[Case]:
    """Cases whose bounds come with the package: of `test` the first ten of each of four families of reefs."""
    cases = suite_named(suite)
    if suite != "test":
        return list(cases)
    families = ("fringing", "string", "patch", "mixed")
    return [case for name in families for case in [c for c in cases if c.world == f"reef/{name}"][:10]]


def test_the_worlds_that_should_come_with_their_bounds() -> None:
    cases = [case for suite in KNOWN for case in _bounded(suite)]
    names = ("dream-v1", "dream-v1-noisy")
    assert set(every_known()) == {(name, c.world, c.seed, c.start) for name in names for c in cases}


def test_noise_changes_no_bounds() -> None:
    for (name, *mission), bounds in every_known().items():
        alike = every_known()["dream-v1", *mission]  # type: ignore[index]
        assert replace(bounds, protocol="dream-v1") == alike
        assert bounds.protocol == name


@pytest.mark.rare
@pytest.mark.parametrize("suite", PAPER_OFTEN)
def test_bounds_that_come_with_the_package_are_of_the_worlds_of_today(suite: str) -> None:
    cases = _bounded(suite)
    # The worlds take a while: of the many, one of each four.
    for case in cases if suite == "paper" else cases[::4]:
        bounds = every_known()["dream-v1", case.world, case.seed, case.start]
        assert bounds.world_hash == world_hash(make_world(case.world, case.seed)), case


@pytest.mark.rare
@pytest.mark.parametrize("suite", PAPER_OFTEN)
def test_bounds_that_come_with_the_package_hold(suite: str) -> None:
    cases = _bounded(suite)
    every = [every_known()["dream-v1", case.world, case.seed, case.start] for case in cases]
    # What was found fast is searched again fast. Of the others, the tours of a few are flown.
    cheap, *others = sorted(every, key=lambda bounds: bounds.cpu_s)
    check(cheap, make_world(cheap.world, cheap.seed))
    for bounds in others[:: -(-len(others) // 3)]:
        drive(bounds, make_world(bounds.world, bounds.seed))
