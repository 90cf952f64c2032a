"""The scorer's numbers, exactly, for missions that are written down step by step in small known worlds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.evaluation.metrics import Coverage, Scorer
from dream.geometry import SE2, SE3, camera_mount
from dream.mapping import OccupancyMap
from dream.protocol import DREAM_V1
from dream.sim.world import Instances, Mesh, World
from dream.types import Arrival, Decision, Guarded, Observation, Step
from tests.recorded_runs import exchange
from tests.sim.arenas import EYE, FLOOR, arena, placed

NEAR = replace(DREAM_V1, reach=3.0)
"""So short-sighted that a look at one site never sees another, 6 m away."""
SITES = [(float(x), float(y)) for y in (-9, -3, 3, 9) for x in (-9, -3, 3, 9)]
"""Where the vehicle looks east from."""
MAP = OccupancyMap(arena().bounds, NEAR)
CAMERA = NEAR.camera.scaled(0.25)
"""Coarser than the protocol's, which decides what is seen but not how many pixels show it."""
BLANK = np.zeros((CAMERA.height, CAMERA.width), np.uint8)


@dataclass(frozen=True)
class Batch:
    """Individuals that are seen together: from one site, looking east."""

    count: int
    cells: int
    """Map cells that they share."""
    group: int


BATCHES = (
    Batch(60, 12, 0),
    Batch(14, 7, 1),
    Batch(16, 8, 1),
    Batch(5, 5, 3),
    Batch(3, 1, 3),
    Batch(1, 1, 3),
    Batch(1, 1, 3),
)
"""100 individuals in three groups, whose numbers leave out 2, in 35 map cells."""
BURIED = 4
"""More of group 3, inside a boulder, where nothing sees them."""


def clumps(points: Sequence[tuple[float, float]], group: npt.ArrayLike = 0) -> Instances:
    """Cubes of 2 cm on the ground."""
    shape = placed(0, [(x, y, FLOOR) for x, y in points], 0.02)
    return replace(shape, group=np.broadcast_to(np.asarray(group, np.int32), len(points)).copy())


def ahead(site: tuple[float, float], batch: Batch) -> list[tuple[float, float]]:
    """Points 1.5 to 2.5 m east of the site, dealt out to the cells one after the other."""
    cells = [(1.5 + 0.25 * (k % 4), -0.5 + 0.25 * (k // 4)) for k in range(batch.cells)]
    return [
        (site[0] + east + 0.05 + 0.03 * (k // batch.cells), site[1] + north + 0.125)
        for k, (east, north) in enumerate(cells[k % batch.cells] for k in range(batch.count))
    ]


@pytest.fixture(scope="module")
def reef() -> World:
    """Batch k lies ahead of site k; a boulder stands at (11, 11), where no look goes."""
    points = [p for site, batch in zip(SITES, BATCHES, strict=False) for p in ahead(site, batch)]
    group = np.repeat([batch.group for batch in BATCHES], [batch.count for batch in BATCHES])
    points += [(10.9 + 0.05 * k, 11.0) for k in range(BURIED)]
    boulder = placed(0, [(11.0, 11.0, FLOOR)], (1.0, 1.0, 3.0))
    return arena(boulder, clumps(points, np.append(group, [3] * BURIED)))


def look(
    x: float, y: float, yaw: float = 0.0, T_base_camera: SE3 = NEAR.T_base_camera, altitude: float = 2.0
) -> Observation:
    return Observation(
        time=0.0,
        rgb=np.zeros((*BLANK.shape, 3), np.uint8),
        depth=np.full(BLANK.shape, np.nan, np.float32),
        labels=BLANK,
        camera=CAMERA,
        T_world_base=SE3.level(x, y, FLOOR + altitude, yaw),
        T_base_camera=T_base_camera,
    )


STAYS, DONE = Decision(), Decision(done=True)


def step(
    index: int,
    observation: Observation,
    *,
    decision: Decision = STAYS,
    guarded: Guarded | None = None,
    collided: bool = False,
    distance: float = 0.0,
    clearance: float = math.inf,
    ended: str = "",
    planner_s: float = 0.0,
) -> Step:
    return Step(
        index=index,
        decision=decision,
        guarded=guarded or Guarded(decision),
        arrival=Arrival(observation.pose, collided, distance, clearance),
        observation=observation,
        occupancy=MAP,
        ended=ended,
        planner_s=planner_s,
    )


Tour = Callable[..., tuple[dict[str, Any], list[Coverage]]]


@pytest.fixture(scope="module")
def tour(reef: World) -> Tour:
    """Visit sites of the reef, one a step; the last step may say something else. Summary and coverages."""

    @cache
    def fly(*sites: int, **last: Any) -> tuple[dict[str, Any], list[Coverage]]:
        scorer = Scorer(reef, NEAR)
        steps = [step(k, look(*SITES[site])) for k, site in enumerate(sites)]
        steps[-1] = step(len(sites) - 1, look(*SITES[sites[-1]]), **last)
        coverage = [scorer.add(each) for each in steps]
        return scorer.summary(), coverage

    return fly


ELSEWHERE = 15
"""A site with nothing ahead."""
WHOLE = [ELSEWHERE, 0, 1, 2, ELSEWHERE, 3, 4, 5, 6]
"""Sees 0, 60, 74, 90, 90, 95, 98, 99 and all 100 individuals."""


def test_instances_are_the_share_of_the_countable_individuals_seen_so_far(tour: Tour) -> None:
    summary, coverage = tour(*WHOLE)
    assert summary["countable"] == 100
    assert [c.instances for c in coverage] == [0.0, 0.6, 0.74, 0.9, 0.9, 0.95, 0.98, 0.99, 1.0]


def test_a_group_is_covered_from_half_its_countable_individuals_on(tour: Tour) -> None:
    _, coverage = tour(*WHOLE)
    # 14 of 30 are too few; 5 of 10 are enough, though 5 of 14 would not be.
    assert np.allclose([3 * c.clusters for c in coverage], [0, 1, 1, 2, 2, 3, 3, 3, 3])


def test_area_is_the_share_of_the_cells_that_hold_a_countable_individual(tour: Tour) -> None:
    _, coverage = tour(*WHOLE)
    assert np.allclose([35 * c.area for c in coverage], [0, 12, 19, 27, 27, 32, 33, 34, 35])


def test_a_cell_is_covered_by_any_one_of_its_individuals() -> None:
    # The first two share a cell, which begins 2.85 m ahead and ends 3.1 m ahead: beyond the reach.
    scorer = Scorer(arena(targets=clumps([(2.96, 0.1), (2.78, 0.1), (-3.0, 0.1)])), NEAR)
    coverage = scorer.add(step(0, look(-0.1, 0.1)))
    assert coverage.instances == pytest.approx(1 / 3)
    assert coverage.area == 0.5


def test_every_milestone_is_the_first_step_that_reaches_its_share(tour: Tour) -> None:
    summary = tour(*WHOLE)[0]
    assert [summary[name] for name in ("t90", "t95", "t98", "t100")] == [3, 5, 7, 8]


def test_98_of_100_are_less_than_the_papers_coverage(tour: Tour) -> None:
    summary = tour(*WHOLE[:7])[0]
    assert summary["coverage"]["instances"] == 0.98
    assert [summary[name] for name in ("t90", "t95", "t98", "t100")] == [3, 5, None, None]


def test_a_mission_succeeds_with_the_papers_coverage_done_and_no_contact(tour: Tour) -> None:
    assert tour(*WHOLE[:8], decision=DONE, ended="done")[0]["success"] is True


@pytest.mark.parametrize(
    ("sites", "last"),
    [
        pytest.param(WHOLE, {"ended": "cap"}, id="the steps were spent"),
        pytest.param(WHOLE, {}, id="aborted"),
        pytest.param(WHOLE, {"decision": DONE}, id="done was refused"),
        pytest.param(WHOLE[:7], {"ended": "done"}, id="98 %"),
        pytest.param(WHOLE, {"ended": "done", "collided": True}, id="one contact"),
    ],
)
def test_a_mission_fails_for_any_single_reason(tour: Tour, sites: list[int], last: dict[str, Any]) -> None:
    assert tour(*sites, **last)[0]["success"] is False


@pytest.mark.parametrize(
    ("last", "ended", "t_stop"), [("done", "done", 2), ("cap", "cap", None), ("", "aborted", None)]
)
def test_only_a_mission_that_ends_itself_has_a_time_of_stopping(
    tour: Tour, last: str, ended: str, t_stop: int | None
) -> None:
    summary = tour(0, 1, 2, ended=last)[0]
    assert (summary["ended"], summary["t_stop"], summary["steps"]) == (ended, t_stop, 2)


@pytest.fixture(scope="module")
def eventful() -> dict[str, Any]:
    """The summary of eight steps in an empty world, with a first one that must not count."""
    here, left = look(0.0, 0.0), Decision(turn=0.5, advance=1.0)
    steps = [
        step(0, here, decision=DONE, collided=True, distance=9.0, clearance=0.001, planner_s=9.0),
        step(1, here, decision=left, distance=1.25, clearance=2.5, planner_s=0.010),
        step(2, here, decision=replace(left, turn=-0.5), distance=1.5, clearance=0.75, planner_s=0.040),
        step(3, here, decision=Decision(advance=2.0), distance=0.125, clearance=0.0625, collided=True),
        # The guard takes the turn away, then the advance alone: only the second one turns.
        step(4, here, decision=left, guarded=Guarded(Decision(), "held"), planner_s=0.020),
        step(5, here, decision=left, guarded=Guarded(replace(left, advance=0.0), "cut"), planner_s=0.030),
        step(6, here, decision=DONE, planner_s=0.050),
        step(7, here, decision=DONE, collided=True, clearance=1.0, ended="done"),
    ]
    scorer = Scorer(arena(), NEAR)
    for each in steps:
        scorer.add(each)
    return scorer.summary()


def test_the_contacts_and_the_way_of_all_moves_are_added_up(eventful: dict[str, Any]) -> None:
    assert eventful["collisions"] == 2
    assert eventful["distance_m"] == 2.875


def test_the_least_clearance_counts(eventful: dict[str, Any]) -> None:
    assert eventful["min_clearance_m"] == 0.062


def test_no_clearance_is_known_where_no_move_knew_one(tour: Tour) -> None:
    assert tour(0, 1, 2)[0]["min_clearance_m"] is None


def test_turns_are_those_carried_out_and_guarded_those_changed(eventful: dict[str, Any]) -> None:
    assert eventful["turns"] == 3
    assert eventful["guarded"] == 2


def test_the_first_claim_to_be_done_counts_though_it_was_refused(eventful: dict[str, Any]) -> None:
    assert eventful["t_claimed"] == 6
    assert eventful["t_stop"] == 7


def test_a_mission_that_never_claims_has_no_time_of_claiming(tour: Tour) -> None:
    assert tour(*WHOLE, ended="cap")[0]["t_claimed"] is None


def test_the_planners_time_is_that_of_the_moves_in_milliseconds(eventful: dict[str, Any]) -> None:
    # 0, 0, 10, 20, 30, 40 and 50 ms: the 99th of a hundred lies 94 % of the way from 40 to 50.
    assert eventful["planner_ms"] == {"p50": 20.0, "p99": 49.4}


def test_a_world_without_targets_is_covered_at_the_first_look() -> None:
    scorer = Scorer(arena(), NEAR)
    assert scorer.add(step(0, look(0.0, 0.0), ended="done")) == Coverage(1.0, 1.0, 1.0, 1.0)
    summary = scorer.summary()
    assert summary["countable"] == 0
    assert [summary[name] for name in ("t90", "t95", "t98", "t100")] == [0, 0, 0, 0]
    assert summary["success"] is True


def test_a_mission_without_a_step_has_done_nothing(reef: World) -> None:
    summary = Scorer(reef, NEAR).summary()
    assert summary["coverage"] == {"instances": 0.0, "clusters": 0.0, "area": 0.0, "visible": 0.0}
    nothing = {"ended": "aborted", "steps": 0, "collisions": 0, "distance_m": 0, "turns": 0, "guarded": 0}
    assert {name: summary[name] for name in nothing} == nothing
    unknown = ("t_stop", "t_claimed", "t90", "t95", "t98", "t100", "min_clearance_m")
    assert all(summary[name] is None for name in unknown)
    assert summary["planner_ms"] == {"p50": 0.0, "p99": 0.0}
    assert summary["success"] is False


PIXEL = 1.0 / CAMERA.fx
"""Side of a pixel, 1 m ahead of a camera."""


def signs(*where: tuple[float, float, int]) -> Instances:
    """Thin boards just above the eye of a camera at the origin that looks east without a pitch.

    Each (x, y, pixels) has its front at x, begins at y, and is that many pixels wide and one high.
    """
    position = [(x + 5e-4, y + 0.5 * wide * PIXEL * x, EYE) for x, y, wide in where]
    return placed(0, position, [(1e-3, wide * PIXEL * x, PIXEL * x) for x, _, wide in where])


LEVEL = look(0.0, 0.0, T_base_camera=camera_mount(0.0))


def test_an_individual_is_visible_from_three_pixels_on() -> None:
    scorer = Scorer(arena(targets=signs((2.0, 0.0, 3), (2.0, 0.5, 2), (2.0, -0.5, 1))), NEAR)
    assert scorer.summary()["countable"] == 3
    assert scorer.add(step(0, LEVEL)).visible == pytest.approx(1 / 3)
    # Two looks of two pixels are not one of four.
    assert scorer.add(step(1, LEVEL)).visible == pytest.approx(1 / 3)


def test_an_individual_beyond_the_reach_over_ground_is_not_visible() -> None:
    # 2.6 m ahead and 1.6 m to the side are more than 3 m away, though the depth is less.
    scorer = Scorer(arena(targets=signs((2.6, 1.6, 5), (2.6, -1.0, 5), (3.1, 0.0, 5), (2.9, 0.5, 5))), NEAR)
    assert scorer.add(step(0, LEVEL)).visible == 0.5


def test_what_was_visible_once_stays_visible() -> None:
    scorer = Scorer(arena(targets=signs((2.0, 0.0, 3), (2.0, 0.5, 2))), NEAR)
    scorer.add(step(0, LEVEL))
    away = look(0.0, 0.0, math.pi, camera_mount(0.0))
    assert scorer.add(step(1, away)).visible == 0.5


def test_only_countable_individuals_are_visible(reef: World) -> None:
    # From inside the boulder, which shows no inner side, the buried ones are drawn.
    scorer = Scorer(reef, NEAR)
    assert scorer.add(step(0, look(10.7, 11.0, altitude=0.1))).visible == 0.0


def hull(*sides: tuple[float, float, float]) -> World:
    """Square plates that face west, each (x, y, side), with their middle 1 m above the ground.

    One mesh, the unit square, serves all of them: what a plate's surface is, its scale says.
    """
    square = np.array([(0, -0.5, -0.5), (0, -0.5, 0.5), (0, 0.5, 0.5), (0, 0.5, -0.5)], np.float32)
    faces = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    middle = [(x, y, FLOOR + 1.0) for x, y, _ in sides]
    plates = placed(1, middle, [(1.0, side, side) for _, _, side in sides])
    mesh = Mesh(square, faces, np.full((4, 3), 128, np.uint8))
    world = arena(targets=plates)
    return replace(world, meshes=(*world.meshes, mesh), hull=np.ones(len(plates), np.bool_))


def test_the_area_of_a_wreck_is_its_surface() -> None:
    scorer = Scorer(hull((2.0, 0.0, 0.5), (2.0, 6.0, 1.0), (-6.0, 6.0, 0.25)), NEAR)
    assert scorer.summary()["countable"] == 3
    coverage = [scorer.add(step(k, look(x, y))) for k, (x, y) in enumerate([(0, 0), (0, 6), (-8, 6)])]
    whole = 0.25 + 1.0 + 0.0625
    assert [c.area for c in coverage] == pytest.approx([0.25 / whole, 1.25 / whole, 1.0])
    assert [c.instances for c in coverage] == pytest.approx([1 / 3, 2 / 3, 1.0])


def test_two_patches_of_one_cell_are_two_surfaces() -> None:
    # The farther one stands for itself, 3 cm before its middle and 3.06 m away.
    scorer = Scorer(hull((2.85, 0.05, 0.1), (2.99, 0.2, 0.1)), NEAR)
    assert scorer.add(step(0, look(-0.1, 0.0))).area == pytest.approx(0.5)


def test_hull_counts_by_its_surface_and_oysters_beside_it_by_their_cells() -> None:
    plate, both = hull((2.0, 0.0, 0.5)), clumps([(2.02, 6.02), (2.07, 6.07), (2.02, -6.02)])
    names = [field.name for field in fields(Instances)]
    targets = Instances(
        *(np.concatenate([getattr(table, name) for table in (both, plate.targets)]) for name in names)
    )
    scorer = Scorer(replace(plate, targets=targets, hull=np.arange(4) == 3), NEAR)
    whole = 0.25 + 2.0 * NEAR.cell**2
    coverage = [scorer.add(step(k, look(0.0, y))) for k, y in enumerate((6.0, 0.0, -6.0))]
    seen = [NEAR.cell**2 / whole, (0.25 + NEAR.cell**2) / whole, 1.0]
    assert [c.area for c in coverage] == pytest.approx(seen)
    assert [c.instances for c in coverage] == [0.5, 0.75, 1.0]


def test_poses_are_where_the_vehicle_really_looked_from(reef: World) -> None:
    scorer = Scorer(reef, NEAR)
    turned = replace(look(*SITES[0]), T_world_base=SE3.level(*SITES[0], EYE, math.pi))
    believed = replace(step(0, turned), arrival=Arrival(SE2(*SITES[0], 0.0), False, 0.0, math.inf))
    assert scorer.add(believed).instances == 0.0


def asked(**changes: Any) -> dict[str, Any]:
    """What the summary says of two questions, one of which `changes`."""
    first = Decision(exchanges=(exchange(),), waited=12.0)
    second = Decision(exchanges=(exchange(**changes),), waited=24.0)
    scorer = Scorer(arena(), NEAR)
    for k, decision in enumerate((STAYS, first, STAYS, second)):
        scorer.add(step(k, replace(look(0.0, 0.0), time=2.5 * k), decision=decision))
    return scorer.summary()


def test_a_mission_that_asked_nothing_has_nothing_to_say_of_a_model(tour: Tour) -> None:
    assert tour(*WHOLE)[0]["vlm"] is None


def test_what_was_asked_of_a_model_is_summed_up() -> None:
    said = asked(
        prompt="dream 2",
        answered_by="painted-2026-11",
        requests=2,
        tokens_in=100,
        tokens_out=11,
        fallback="timeout: none within 9 s",
        seconds=9.25,
    )
    assert said["vlm"] == {
        "model": "openai:painted",
        "answered_by": ["painted-2026-11"],
        "prompts": ["dream 1, legend 1, oysters 1", "dream 2"],
        "calls": 3,
        "questions": 2,
        "tokens": 2821,
        "tokens_in": 2600,
        "tokens_out": 221,
        "cost_usd": 0.015,
        "fallbacks": 1,
        "reasons": {"timeout": 1},
        "last_fallback": "timeout: none within 9 s",
        "outcomes": {},
        "waited_s": 36.0,
        "latency_s": {"p50": 6.25, "p99": 9.19},
    }


def test_waiting_counts_on_the_missions_clock() -> None:
    assert asked()["mission_s"] == 3 * 2.5 + 36.0


def test_a_price_that_is_not_known_makes_the_sum_unknown() -> None:
    assert asked(cost_usd=None)["vlm"]["cost_usd"] is None


def test_what_is_seen_goes_by_where_the_vehicle_really_is() -> None:
    """It believes to be 12 m from there: beside one clump of shells it sees the other."""
    world = arena(targets=clumps([(2.5, 0.1), (-9.5, 0.1)]))
    scorer = Scorer(world, NEAR)
    scorer.add(step(0, look(0.0, 0.0, math.pi / 2)))
    there = SE3.level(-12.0, 0.0, FLOOR + 2.0, 0.0)
    swum = step(1, look(0.0, 0.0), distance=10.0, ended="cap")
    scorer.add(replace(swum, arrival=replace(swum.arrival, truth=there)))
    said = scorer.summary()
    assert scorer._seen.tolist() == [False, True]
    assert said["coverage"]["instances"] == 0.5
    assert said["position_error_m"] == {"rmse": pytest.approx(12.0 / math.sqrt(2.0), abs=1e-3), "end": 12.0}
    assert said["drift"] == pytest.approx(1.2)
