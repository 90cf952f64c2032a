"""Bounds in space, in a world small enough to try every walk: a tower with a plate on each of four sides."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.cli import run_command
from dream.control import setpoint
from dream.evaluation.metrics import Scorer
from dream.evaluation.oracle._kernels import space as kernels
from dream.evaluation.oracle.bounds import read_lines, write_bounds
from dream.evaluation.oracle.space_bounds import (
    SpaceBounds,
    check,
    decisions_of,
    drive,
    tighten,
    tour_poses,
)
from dream.evaluation.oracle.space_graph import SpaceGraph, space_graph
from dream.evaluation.oracle.space_limits import PriceLimit
from dream.evaluation.oracle.space_tours import best_tour
from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap
from dream.protocol import DREAM_V1, DREAM_V2_NAV, DREAM_V2_TRUE, SurveyProtocol
from dream.robots import Teleport
from dream.sim.files import save_world
from dream.sim.inspection import Inspection
from dream.sim.render import Renderer
from dream.sim.visibility import lattice_yaws
from dream.sim.world import Mesh, World
from dream.types import LOOK_AROUND, Arrival, Guarded, Step
from tests.sim.arenas import FLOOR, arena, box, placed

PROTOCOL = DREAM_V2_TRUE
SIDES = 4
LAYERS = 14
"""Steps after which a walk around the tower must be through."""


def plate(side: int) -> Mesh:
    """Half a metre of hull before one side of a tower of 1.6 m that stands on the origin."""
    across, low, high, out = 0.25, FLOOR + 1.5, FLOOR + 2.0, 0.85
    corners = np.array([[out, -across, low], [out, across, low], [out, across, high], [out, -across, high]])
    c, s = math.cos(side * math.pi / 2), math.sin(side * math.pi / 2)
    turned = corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(turned.astype(np.float32), faces, np.zeros((4, 3), np.uint8))


@pytest.fixture(scope="module")
def world() -> World:
    targets = replace(placed(0, np.zeros((SIDES, 3)), 1.0), mesh=np.arange(1, SIDES + 1, dtype=np.int32))
    made = arena(placed(0, [(0.0, 0.0, FLOOR)], (1.6, 1.6, 6.0)), targets)
    return replace(
        made,
        bounds=Bounds(-3.0, -3.0, 3.0, 3.0),
        starts=(SE2(-2.0, 0.0, 0.0), SE2(2.0, 0.5, 0.0)),
        meshes=(box(), *(plate(side) for side in range(SIDES))),
        hull=np.ones(SIDES, np.bool_),
    )


@pytest.fixture(scope="module")
def inspection(world: World) -> Inspection:
    return Inspection(world, PROTOCOL)


@pytest.fixture(scope="module")
def graph(inspection: Inspection) -> SpaceGraph:
    return space_graph(inspection)


@pytest.fixture(scope="module")
def found(world: World, inspection: Inspection) -> list[SpaceBounds]:
    """All that a search yields."""
    return list(tighten(world, PROTOCOL, budget_s=1.5, inspection=inspection))


@pytest.fixture(scope="module")
def optimum(graph: SpaceGraph) -> int:
    """The fewest steps that inspect all plates, the look-around included, by trying all walks at once."""
    kernel = graph.kernel
    nodes, headings, masks = len(kernel.places), graph.headings, 1 << SIDES
    shown = np.zeros((nodes, headings, kernel.tilts), np.intp)
    for p, h, t in np.ndindex(shown.shape):
        shown[p, h, t] = sum(1 << int(i) for i in graph.shows((p, h, t)))
    reached = np.zeros((nodes, headings, masks), np.bool_)
    looked = int((1 << np.flatnonzero(graph.looked[-1])).sum())
    reached[graph.start[0], graph.start[1], looked] = True
    p, h = np.indices((nodes, headings))
    for steps in range(1, LAYERS + 1):
        moved = np.zeros_like(reached)
        for heading, turn in np.ndindex(headings, len(kernel.turns)):
            to = (heading + int(kernel.turns[turn])) % headings
            for move in kernel.moves[to]:
                begin = np.flatnonzero(kernel.ends[:, move] >= 0)
                # No two nodes have the same end.
                moved[kernel.ends[begin, move], to] |= reached[begin, heading]
        reached = np.zeros_like(moved)
        for mask, tilt in np.ndindex(masks, kernel.tilts):
            reached[p, h, mask | shown[:, :, tilt]] |= moved[:, :, mask]
        if reached[:, :, masks - 1].any():
            return steps + LOOK_AROUND
    raise AssertionError("no walk inspects all plates")


def test_moves_are_those_that_a_sweep_finds_free(graph: SpaceGraph, inspection: Inspection) -> None:
    rng = np.random.default_rng(0)
    node_of = {tuple(place): k for k, place in enumerate(graph.kernel.places.tolist())}
    blocked = 0
    for action in range(0, len(graph.actions), 7):
        turn, advance, climb, tilt = graph.actions[action].tolist()
        for node in rng.choice(len(graph.kernel.places), 60, replace=False).tolist():
            heading = int(rng.integers(PROTOCOL.headings))
            to = (heading + turn) % PROTOCOL.headings
            east, north = PROTOCOL.offset(to, (0.0, *PROTOCOL.advances)[advance])
            up = round(PROTOCOL.climbs[climb] / PROTOCOL.lattice)
            col, row, level = graph.kernel.places[node].tolist()
            place = (col + east, row + north, level + up)
            end = node_of.get(place)
            start, goal = graph.positions[node], np.array(place) * PROTOCOL.lattice
            if end is not None and inspection.solids.sweep_through(start, goal, PROTOCOL).contact:
                end = None
                blocked += 1
            expected = None if end is None else (end, to, tilt)
            assert graph.after((node, heading, 0), action) == expected
    assert blocked > 5


def test_frames_inspect_what_a_look_inspects(graph: SpaceGraph, inspection: Inspection) -> None:
    rng = np.random.default_rng(0)
    yaws, inspected = lattice_yaws(PROTOCOL), 0
    for node in rng.choice(len(graph.kernel.places), 60, replace=False).tolist():
        x, y, z = graph.positions[node]
        for heading in range(PROTOCOL.headings):
            for tilt, pitch in enumerate(PROTOCOL.tilts):
                looked = inspection.inspected(SE3.level(x, y, z, yaws[heading]), pitch)
                assert graph.shows((node, heading, tilt)).tolist() == np.flatnonzero(looked).tolist()
                inspected += int(looked.sum())
    assert inspected > 100


def test_steps_are_counted_around_what_is_in_the_way(graph: SpaceGraph) -> None:
    kernel = graph.kernel
    begin = graph.start[:2]
    steps = kernels.steps_from(kernel, *begin)
    longer = 0
    rng = np.random.default_rng(0)
    for node in rng.choice(len(kernel.places), 40, replace=False).tolist():
        end = (node, int(rng.integers(graph.headings)))
        assert kernels.floor(kernel, *begin, *end) <= steps[end]
        longer += kernels.floor(kernel, *begin, *end) < steps[end]
        assert kernels.steps_to(kernel, end, begin, int(steps[end]))[begin] == steps[end]
        assert kernels.steps_to(kernel, end, begin, int(steps[end]) - 1)[begin] == kernels.FAR
    assert longer > 0


def test_a_bound_is_no_more_than_the_optimum_and_a_tour_no_less(
    graph: SpaceGraph, found: list[SpaceBounds], optimum: int
) -> None:
    last = found[-1]
    assert last.lower_bound is not None
    assert last.best_tour is not None
    assert LOOK_AROUND < last.lower_bound <= optimum <= last.best_tour
    limit, rng = PriceLimit(graph, 0), np.random.default_rng(0)
    for _ in range(20):
        assert limit.certified(rng.integers(0, 1000, SIDES).tolist()) + LOOK_AROUND <= optimum
    # Where one may be missed, as few are needed or fewer.
    for prices in ([1000] * SIDES, last.prices):
        assert PriceLimit(graph, 1).certified(prices) <= limit.certified(prices)
    with pytest.raises(ValueError, match="prices: expected 4, got"):
        limit.certified([1, 2])
    with pytest.raises(ValueError, match="prices: expected 0 or more, got -1"):
        limit.certified([1, 2, 3, -1])


def test_the_best_tour_of_a_small_world_is_found(found: list[SpaceBounds], optimum: int) -> None:
    assert found[-1].best_tour == optimum


def test_a_search_yields_ends_that_only_close_in(
    world: World, inspection: Inspection, found: list[SpaceBounds]
) -> None:
    assert (found[0].lower_bound, found[0].best_tour) == (None, None)
    again = list(tighten(world, PROTOCOL, budget_s=0.3, known=found[-1], seed=7, inspection=inspection))
    for before, after in pairwise([*found, *again]):
        assert (after.best_tour or math.inf) <= (before.best_tour or math.inf)
        assert (after.lower_bound or 0) >= (before.lower_bound or 0)
        assert after.cpu_s >= before.cpu_s


def test_a_tour_is_a_walk_that_inspects_what_it_says(graph: SpaceGraph) -> None:
    tours = list(best_tour(graph, 1, budget_s=0.2))
    assert [len(tour) for tour in tours] == sorted({len(tour) for tour in tours}, reverse=True)
    for tour in tours:
        poses = graph.walk(tour)
        assert int((~graph.inspected(poses)).sum()) <= 1
        assert int((~graph.inspected(poses[:-1])).sum()) > 1
        assert graph.walk(graph.actions_between(poses)) == poses
    # A walk to begin with is made complete, and is never made longer.
    (first, *_) = best_tour(graph, 1, hints=[graph.walk(tours[-1])], budget_s=0.0)
    assert len(first) <= len(tours[-1])


@pytest.mark.parametrize("start", [0, 1])
def test_a_mission_that_flies_a_tour_is_scored_as_the_tour_says(
    world: World, inspection: Inspection, start: int
) -> None:
    *_, told = tighten(world, PROTOCOL, start=start, budget_s=0.3, inspection=inspection)
    drive(told, world, inspection=inspection)
    check(told, world)
    renderer = Renderer(world)
    robot = Teleport(world, PROTOCOL, world.starts[start], renderer=renderer, solids=inspection.solids)
    scorer = Scorer(world, PROTOCOL, visibility=inspection, renderer=renderer)
    occupancy = OccupancyMap(world.bounds, PROTOCOL)
    poses = tour_poses(told, world, PROTOCOL)
    arrival = Arrival(PROTOCOL.snap(world.starts[start]), collided=False, distance=0.0, clearance=math.inf)
    for index, decision in enumerate([None, *decisions_of(told.tour, PROTOCOL)]):
        observation = robot.observe()
        if decision is not None:
            z = float(observation.T_world_base.translation[2])
            arrival = robot.go_to(setpoint(arrival.pose, decision, PROTOCOL, z))
            observation = robot.observe()
        guarded = Guarded(decision or decisions_of((), PROTOCOL)[0])
        scorer.add(Step(index, guarded.decision, guarded, arrival, observation, occupancy))
        if index >= LOOK_AROUND:
            at = observation.T_world_base
            x, y, z, yaw, _ = poses[index - LOOK_AROUND]
            assert at.translation.tolist() == [x, y, z]
            assert at.yaw == pytest.approx(yaw)
    summary = scorer.summary()
    assert summary["t98"] == told.best_tour
    assert summary["collisions"] == 0


def _shorter(bounds: SpaceBounds) -> SpaceBounds:
    return replace(bounds, tour=bounds.tour[:-1], best_tour=(bounds.best_tour or 0) - 1)


def _into_the_tower(bounds: SpaceBounds) -> SpaceBounds:
    # Straight on by the longest advance, without a climb, each time.
    return replace(bounds, tour=tuple([_action(0, 2.0, 0.0)] * len(bounds.tour)))


def _action(turn: int, advance: float, climb: float) -> int:
    advances = (0.0, *PROTOCOL.advances)
    wanted = PROTOCOL.turns.index(turn), advances.index(advance), PROTOCOL.climbs.index(climb)
    sizes = len(PROTOCOL.turns), len(advances), len(PROTOCOL.climbs)
    return int(np.ravel_multi_index(wanted, sizes)) * len(PROTOCOL.tilts)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_shorter, "tour: expected 98.26 % at step"),
        (_into_the_tower, "tour: step "),
        (lambda bounds: replace(bounds, lower_bound=(bounds.lower_bound or 0) + 1), "lower bound: expected"),
        (lambda bounds: replace(bounds, prices=(0,) * SIDES), "lower bound: expected at most the 3 proved"),
        (lambda bounds: replace(bounds, countable=3), "countable: expected 4, got 3"),
        (lambda bounds: replace(bounds, world_hash="0" * 64), "world_hash: expected"),
        (lambda bounds: replace(bounds, start=2), "start: expected 0 to 1"),
        (lambda bounds: replace(bounds, tour=(9999, *bounds.tour[1:])), "tour: expected actions 0 to"),
    ],
)
def test_what_does_not_hold_is_told(
    change: Any, complaint: str, world: World, found: list[SpaceBounds]
) -> None:
    check(found[-1], world)
    with pytest.raises(ValueError, match=complaint):
        check(change(found[-1]), world)


def test_bounds_are_read_as_they_were_written(found: list[SpaceBounds], tmp_path: Path) -> None:
    every = [found[-1], replace(found[0], seed=2)]
    write_bounds(tmp_path / "some.jsonl", every)
    assert read_lines(tmp_path / "some.jsonl", SpaceBounds) == every


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"tour_t98": [1, 2]}, "tour_t98: expected"),
        ({"best_tour_t98": 4, "tour_t98": [1]}, "best_tour_t98: expected at least the lower bound"),
        ({"status_t98": "best"}, "status_t98: expected"),
        ({"prices_t98": [-1]}, "prices_t98.0: "),
        ({"mood": "good"}, "mood: "),
    ],
)
def test_a_damaged_line_is_named(
    change: dict[str, Any], complaint: str, found: list[SpaceBounds], tmp_path: Path
) -> None:
    path = tmp_path / "some.jsonl"
    path.write_text(json.dumps(found[-1].as_dict() | change) + "\n")
    with pytest.raises(ValueError) as error:
        read_lines(path, SpaceBounds)
    assert f"{path}, line 1: {complaint}" in str(error.value)


@pytest.mark.parametrize(
    ("protocol", "start", "complaint"),
    [
        (DREAM_V1, 0, "expected one that moves in space"),
        (DREAM_V2_NAV, 0, "whose vehicle swims"),
        (PROTOCOL, 2, "start: expected 0 to 1"),
    ],
)
def test_what_has_no_graph_is_told(
    protocol: SurveyProtocol, start: int, complaint: str, world: World
) -> None:
    with pytest.raises(ValueError, match=complaint):
        next(tighten(world, protocol, start=start, budget_s=0.0))


def test_what_the_look_around_shows_needs_no_more_steps(world: World) -> None:
    facing: npt.NDArray[np.bool_] = np.array([False, False, True, False])
    alone = replace(world, targets=world.targets.chosen(facing), hull=np.ones(1, np.bool_))
    (only,) = tighten(alone, PROTOCOL, budget_s=1.0)
    assert (only.lower_bound, only.best_tour, only.status) == (0, 0, "optimal")
    check(only, alone)


def test_a_lower_bound_that_is_not_proved_is_not_known(
    world: World, inspection: Inspection, found: list[SpaceBounds]
) -> None:
    (known,) = tighten(world, PROTOCOL, budget_s=0.0, known=found[-1], inspection=inspection)
    assert replace(known, cpu_s=0.0) == replace(found[-1], cpu_s=0.0)
    (nothing,) = tighten(world, PROTOCOL, budget_s=0.0, inspection=inspection)
    assert (nothing.lower_bound, nothing.best_tour) == (None, None)
    drive(nothing, world, inspection=inspection)
    check(nothing, world)


def test_oracle_tells_of_a_mission_in_space_and_keeps_a_suite(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "dream.commands.oracle.ProcessPoolExecutor", lambda jobs, **_: ThreadPoolExecutor(jobs)
    )
    save_world(world, tmp_path / "tower")
    picture, out = tmp_path / "tour.png", tmp_path / "kept.jsonl"
    in_space = ["--protocol", PROTOCOL.name, "--budget", "0.2"]
    one = ["oracle", "--world", str(tmp_path / "tower"), *in_space]
    assert run_command([*one, "--json", "--picture", str(picture)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["lower_bound_t98"] <= printed["best_tour_t98"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run_command([*one[:-1], "0"]) == 0
    assert "  98.26 %  no tour known, lower bound: not known\n" in capsys.readouterr().out

    (tmp_path / "towers.txt").write_text("tower\ntower start 1\n")
    suite = ["oracle", str(tmp_path / "towers.txt"), *in_space, "--out", str(out)]
    assert run_command([*suite, "--json"]) == 0
    capsys.readouterr()
    lines = out.read_text()
    assert [json.loads(line)["start"] for line in lines.splitlines()] == [0, 1]
    # What is kept is flown, and not searched again.
    assert run_command(suite) == 0
    assert "98.26 %: at least" in capsys.readouterr().out
    assert out.read_text() == lines
    assert run_command([*suite, "--check"]) == 0
    assert capsys.readouterr().out.count(": holds\n") == 2
    assert run_command([*suite, "--traces", str(tmp_path)]) == 2
    assert "--traces: expected a planar protocol" in capsys.readouterr().err
