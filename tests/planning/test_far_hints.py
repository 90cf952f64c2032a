"""Hints from beyond the reach: where they lie, what is learnt of them, and what the planner makes of them."""

from __future__ import annotations

import math
import re
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.evaluation.runner import simulate
from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap, within
from dream.planning import Belief, belief
from dream.planning.belief import BeliefPilot
from dream.planning.far_hints import HALF, USUAL, WORTH, FarHints
from dream.planning.sources import HintedTargets
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Label, Mission, Observation, Step
from tests.mapping.analytic import CAMERA, SEABED, Disc, Pillar, camera_at, render
from tests.planning.flights import observed_at, source_of
from tests.sim.arenas import FLOOR, arena, placed

WIDE = Bounds(-20.0, -20.0, 20.0, 20.0)
MISSION = Mission(DREAM_V1, WIDE, DREAM_V1.cap)
FAR = 20.0
REACH, CELL = DREAM_V1.reach, DREAM_V1.cell
REEF = Disc(12.0, 0.0, 2.0)


def _seen(x: float, y: float, yaw: float, *things: Pillar | Disc) -> Observation:
    """A frame of some things."""
    depth, labels = render(camera_at(x, y, yaw), *things)
    pose = SE3.level(x, y, SEABED + DREAM_V1.altitude, yaw)
    return replace(observed_at(x, y, yaw), depth=depth, labels=labels, T_world_base=pose)


def _map() -> OccupancyMap:
    return OccupancyMap(WIDE, DREAM_V1)


def _after(*frames: Observation, farthest: float = FAR) -> tuple[FarHints, OccupancyMap]:
    """What is held of some frames that are in the map."""
    far_hints, occupancy = FarHints(MISSION, farthest), _map()
    for frame in frames:
        occupancy.integrate(frame.depth, frame.labels, CAMERA, frame.T_world_camera)
        far_hints.add(frame, occupancy)
    return far_hints, occupancy


def _from(frame: Observation) -> npt.NDArray[np.float64]:
    """(H, W) metres over ground from the camera; NaN where there is no return."""
    points = CAMERA.back_project(frame.depth, frame.T_world_camera)
    east, north, _ = (points - frame.T_world_camera.translation).transpose(2, 0, 1)
    return np.asarray(np.hypot(east, north))


def _away(x: float, y: float) -> npt.NDArray[np.float64]:
    """(rows, cols) metres from a place to the middle of each cell."""
    rows, cols = np.indices(_map().shape)
    east, north = _map().center_of(rows, cols)
    return np.asarray(np.hypot(east - x, north - y))


# -------------------------------------------------------------------------------------------- where they lie


@pytest.mark.rare
@given(
    x=st.floats(-6.0, 6.0), y=st.floats(-6.0, 6.0), yaw=st.floats(-math.pi, math.pi), far=st.floats(8.5, 25.0)
)
def test_pixels_fall_into_the_cells_that_a_point_by_point_projection_gives(
    x: float, y: float, yaw: float, far: float
) -> None:
    frame = _seen(x, y, yaw, REEF, Pillar(5.0, 5.0, 1.0, 1.5))
    far_hints, occupancy = FarHints(MISSION, far), _map()
    far_hints.add(frame, occupancy)
    points, away = CAMERA.back_project(frame.depth, frame.T_world_camera), _from(frame)
    depth_ok = (frame.depth >= DREAM_V1.min_depth) & (frame.depth <= DREAM_V1.max_depth)
    told = np.isin(frame.labels, (Label.TARGET, Label.SEABED)) & depth_ok & (away > REACH) & (away <= far)
    slow = np.zeros((2, *occupancy.shape), int)
    for point, label in zip(points[told], frame.labels[told], strict=True):
        if WIDE.contains(point[0], point[1]):
            cell = occupancy.cell_of(point[0], point[1])
            slow[(1, *cell)] += 1
            slow[(0, *cell)] += label == Label.TARGET
    # In single precision a pixel at the very edge of a cell may fall into the next.
    assert np.abs(far_hints._pixels.astype(int) - slow).sum() <= 0.01 * max(slow.sum(), 100)
    assert slow.any()


def test_a_reef_beyond_the_reach_is_hinted_at_where_it_lies_and_nowhere_else() -> None:
    far_hints, occupancy = _after(_seen(0.0, 0.0, 0.0, REEF))
    hints, away = far_hints.hints(occupancy), _away(REEF.x, REEF.y)
    assert hints.any()
    assert away[hints].max() <= REEF.radius + CELL
    inside = far_hints.glimpsed(occupancy) & (away <= REEF.radius - CELL)
    assert inside.any()
    assert hints[inside].all()
    assert not occupancy.target.any()


def test_what_is_within_reach_or_farther_than_is_looked_is_not_glimpsed() -> None:
    for farthest in (11.0, 15.0):
        far_hints, _ = _after(_seen(0.0, 0.0, 0.0, REEF), farthest=farthest)
        away = _away(0.0, 0.0)[far_hints._looked_at]
        assert away.min() >= REACH - CELL
        assert farthest - 2.0 < away.max() <= farthest + CELL


def test_what_comes_within_reach_is_glimpsed_no_more() -> None:
    far, near = _seen(0.0, 0.0, 0.0, REEF), _seen(6.0, 0.0, 0.0, REEF)
    far_hints, occupancy = _after(far, near)
    assert occupancy.target.any()
    assert not (far_hints.glimpsed(occupancy) & occupancy.observed).any()
    assert not far_hints.hints(occupancy)[occupancy.observed].any()


def test_where_nothing_returns_from_beyond_the_reach_nothing_changes() -> None:
    """As in murky water."""
    frame = _seen(0.0, 0.0, 0.0, REEF)
    away = _from(frame)
    murky = replace(frame, depth=np.where(away > REACH, np.nan, frame.depth).astype(np.float32))
    far_hints, occupancy = _after(murky)
    evidence = far_hints.evidence(occupancy)
    targets, ground = evidence.targets, evidence.ground
    assert not far_hints.glimpsed(occupancy).any()
    np.testing.assert_array_equal(targets, occupancy.target)
    np.testing.assert_array_equal(ground, occupancy.seen)
    beside = np.random.default_rng(0).random(occupancy.shape).astype(np.float32)
    np.testing.assert_array_equal(far_hints.evidence(occupancy).weighed(beside), beside)
    assert (far_hints.evidence(occupancy).unnoticed(3.0, CELL) == 1.0).all()


# ------------------------------------------------------------------------------------------- what is learnt


def _lying(frame: Observation, told: Label) -> Observation:
    """The frame, with one label for all that is beyond the reach."""
    far = np.isin(frame.labels, (Label.TARGET, Label.SEABED)) & (_from(frame) > REACH)
    return replace(frame, labels=np.where(far, told, frame.labels).astype(np.uint8))


def test_before_anything_came_true_hints_are_thought_to_as_usual() -> None:
    far_hints, _ = _after(_seen(0.0, 0.0, 0.0, REEF))
    assert far_hints.precision == far_hints.sensitivity == USUAL


def test_what_came_true_is_counted_cell_by_cell() -> None:
    far, near = _seen(0.0, 0.0, 0.0, REEF), _seen(6.0, 0.0, 0.0, REEF)
    far_hints, before = _after(far)
    hints, glimpsed = far_hints.hints(before), far_hints.glimpsed(before)
    far_hints, occupancy = _after(far, near)
    came, target = occupancy.seen & glimpsed, occupancy.target
    square = CELL**2
    assert far_hints.hinted == pytest.approx(square * (came & hints).sum())
    assert far_hints.came_true == pytest.approx(square * (came & hints & target).sum())
    assert far_hints.found == pytest.approx(square * (came & target).sum())
    precision = (USUAL * WORTH + far_hints.came_true) / (WORTH + far_hints.hinted)
    assert far_hints.precision == pytest.approx(precision)
    assert far_hints.precision > USUAL
    assert far_hints.sensitivity > USUAL


def test_hints_that_lie_are_soon_believed_no_more() -> None:
    frames = [_lying(_seen(x, 0.0, 0.0), Label.TARGET) for x in (-10.0, -6.0, -2.0, 2.0, 6.0)]
    far_hints, occupancy = _after(*frames)
    assert far_hints.precision < 0.5 * USUAL
    hints = far_hints.hints(occupancy)
    assert hints.any()
    beside = far_hints.evidence(occupancy).weighed(np.zeros(occupancy.shape, np.float32))
    assert beside[hints] == pytest.approx(far_hints.precision)


def test_who_never_hints_at_what_is_found_later_is_soon_not_relied_on() -> None:
    reef = Disc(0.0, 0.0, 30.0)
    frames = [_lying(_seen(x, 0.0, 0.0, reef), Label.SEABED) for x in (-10.0, -6.0, -2.0, 2.0, 6.0)]
    far_hints, occupancy = _after(*frames)
    assert far_hints.sensitivity < 0.5 * USUAL
    unnoticed = far_hints.evidence(occupancy).unnoticed(3.0, CELL)
    assert unnoticed.min() == pytest.approx(1.0 - far_hints.sensitivity)


# ------------------------------------------------------------------------------------------ what it is worth


@given(seed=st.integers(0, 1000))
def test_probabilities_stay_probabilities_and_a_hint_never_lowers_one_that_is_less(seed: int) -> None:
    generator = np.random.default_rng(seed)
    far_hints, occupancy = _after(_seen(0.0, 0.0, float(generator.uniform(-3.0, 3.0)), REEF))
    far_hints.came_true, far_hints.hinted, far_hints.foreseen, far_hints.found = generator.uniform(0, 50) * (
        np.array([generator.random(), 1.0, generator.random(), 1.0])
    )
    beside = generator.random(occupancy.shape).astype(np.float32)
    weighed = far_hints.evidence(occupancy).weighed(beside)
    hints, glimpsed = far_hints.hints(occupancy), far_hints.glimpsed(occupancy)
    assert weighed.min() >= 0.0
    assert weighed.max() <= 1.0
    np.testing.assert_array_equal(weighed[~glimpsed], beside[~glimpsed])
    assert (weighed[glimpsed & ~hints] <= beside[glimpsed & ~hints]).all()
    np.testing.assert_allclose(weighed[hints], np.maximum(beside[hints], far_hints.precision), rtol=1e-6)
    # Of many such cells: those with a target that went unnoticed, among all without a hint.
    share = (1.0 - far_hints.sensitivity) * beside / (1.0 - far_hints.sensitivity * beside)
    np.testing.assert_allclose(weighed[glimpsed & ~hints], share[glimpsed & ~hints], rtol=1e-4)
    evidence = far_hints.evidence(occupancy)
    targets, ground = evidence.targets, evidence.ground
    assert (targets <= ground + 1e-6).all()
    assert ground.max() <= 1.0


def test_a_group_was_noticed_only_where_its_ground_was_glimpsed() -> None:
    far_hints, occupancy = _after(_seen(0.0, 0.0, 0.0))
    glimpsed = within(far_hints.glimpsed(occupancy), 3.0, CELL)
    unnoticed = far_hints.evidence(occupancy).unnoticed(3.0, CELL)
    np.testing.assert_allclose(unnoticed[glimpsed], 1.0 - USUAL)
    assert (unnoticed[~glimpsed] == 1.0).all()
    assert glimpsed.any()
    assert not glimpsed.all()


# ---------------------------------------------------------------------------------------------- the planner


def _clumps(x: float, y: float, spread: float, count: int) -> list[tuple[float, float, float]]:
    places = np.random.default_rng(0).normal((x, y), spread, (count, 2))
    return [(float(east), float(north), FLOOR) for east, north in places]


@dataclass
class _Kept:
    """The planner, and its pilots where they can be asked."""

    planner: Belief
    pilots: list[BeliefPilot]

    def begin(self, mission: Mission) -> BeliefPilot:
        self.pilots.append(self.planner.in_plane(mission))
        return self.pilots[-1]


FAR_REEF = replace(
    arena(targets=placed(0, _clumps(8.0, 2.0, 1.0, 60), (0.3, 0.3, 0.15))), starts=(SE2(-8.0, -8.0, 0.0),)
)
"""A reef 19 m from the start, and nothing else."""


def _until_seen(world: World, planner: Belief) -> int:
    for step in simulate(world, planner, DREAM_V1):
        if step.occupancy.target.any():
            return step.index
    raise AssertionError("no target was ever seen")


def test_it_heads_for_what_it_glimpsed() -> None:
    """Both know nothing of the reef at first; who takes hints never has to search for it."""
    assert _until_seen(FAR_REEF, Belief()) < _until_seen(FAR_REEF, Belief(glimpse=1.0))


def test_without_glimpses_what_is_beyond_the_reach_decides_nothing() -> None:
    """The same frames with other labels far off: the same decisions."""
    blind = Belief(glimpse=1.0)
    flown = simulate(FAR_REEF, blind, DREAM_V1, max_steps=12)
    asked = [(step.observation, step.occupancy.copy()) for step in flown]
    pilots = [blind.begin(Mission(DREAM_V1, FAR_REEF.bounds, DREAM_V1.cap)) for _ in range(2)]
    for observation, occupancy in asked[3:]:
        decisions = [
            pilot.decide(frame, occupancy)
            for pilot, frame in zip(pilots, (observation, _lying(observation, Label.TARGET)), strict=True)
        ]
        assert decisions[0] == decisions[1]


def test_it_is_not_done_while_much_that_was_hinted_at_was_not_looked_at(
    done: tuple[BeliefPilot, Step],
) -> None:
    pilot, step = done
    assert pilot.decide(step.observation, step.occupancy).done
    source = source_of(pilot, HintedTargets)
    assert source is not None
    far_hints = source.hints
    unseen = np.argwhere(~step.occupancy.observed)
    assert len(unseen) > 200
    row, col = unseen[len(unseen) // 2]
    far_hints._pixels[:, max(row - 8, 0) : row + 8, max(col - 8, 0) : col + 8] = 10
    pilot.claimed = None
    decision = pilot.decide(step.observation, step.occupancy)
    assert not decision.done
    assert "m² lie where targets were glimpsed beyond the reach" in decision.reasoning.distribution


def test_what_may_be_left_is_a_share_of_all_targets_seen_and_hinted_at(
    done: tuple[BeliefPilot, Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    pilot, step = done
    source = source_of(pilot, HintedTargets)
    assert source is not None
    row, col = np.argwhere(~step.occupancy.observed)[100]
    source.hints._pixels[:, max(row - 8, 0) : row + 8, max(col - 8, 0) : col + 8] = 10
    pilot.claimed = None
    hinted = deepcopy(pilot).consider(step.observation, step.occupancy).expected.hinted
    seen = DREAM_V1.cell**2 * np.count_nonzero(step.occupancy.target)
    assert hinted > 0.1 * seen
    share = hinted / (seen + hinted)
    for accepted in (0.99 * share, 1.01 * share):
        monkeypatch.setattr(belief, "LEAVE", accepted)
        decision = deepcopy(pilot).decide(step.observation, step.occupancy)
        assert decision.done == (accepted > share)


@pytest.fixture(name="done")
def _done(ended: tuple[BeliefPilot, Step]) -> tuple[BeliefPilot, Step]:
    """The same, to do with as one likes."""
    pilot, step = ended
    return deepcopy(pilot), step


@pytest.fixture(name="ended", scope="module")
def _ended() -> tuple[BeliefPilot, Step]:
    """A pilot at the end of its mission, in a world that it did not have to see all of."""
    pilots: list[BeliefPilot] = []
    near = arena(targets=placed(0, _clumps(3.0, 0.0, 1.0, 60), (0.3, 0.3, 0.15)))
    *_, last = simulate(near, _Kept(Belief(risk=0.5), pilots), DREAM_V1)
    assert last.ended == "done"
    return pilots[-1], last


def test_it_says_how_much_was_hinted_at_and_how_far_that_is_believed() -> None:
    pilots: list[BeliefPilot] = []
    said = 0
    for step in simulate(FAR_REEF, _Kept(Belief(), pilots), DREAM_V1, max_steps=10):
        match = re.search(
            r" Of that (\S+) m² lie where targets were glimpsed beyond the reach; "
            r"such hints are taken to come true to (\d+)%\.",
            step.decision.reasoning.distribution,
        )
        if match is None:
            continue
        source = source_of(pilots[-1], HintedTargets)
        assert source is not None
        assert float(match[2]) == pytest.approx(100.0 * source.hints.precision, abs=0.5)
        assert float(match[1]) > 0.0
        said += 1
    assert said


def test_half_of_the_pixels_make_a_hint() -> None:
    far_hints = FarHints(MISSION, FAR)
    far_hints._pixels[1, :, :] = 10
    far_hints._pixels[0, 0, :] = int(10 * HALF)
    far_hints._pixels[0, 1, :] = int(10 * HALF) - 1
    hints = far_hints.hints(_map())
    assert hints[0].all()
    assert not hints[1:].any()


def test_a_depth_of_exactly_the_greatest_is_no_hint() -> None:
    seen = _seen(0.0, 0.0, 0.0, REEF)
    far = _from(seen) > REACH
    assert (seen.labels[far] == Label.TARGET).any()
    padded, missing = (
        _after(replace(seen, depth=np.where(far, np.float32(depth), seen.depth)), farthest=2.0 * FAR)[0]
        for depth in (DREAM_V1.max_depth, np.nan)
    )
    np.testing.assert_array_equal(padded._pixels, missing._pixels)


def test_where_nothing_may_be_left_it_ends_once_nothing_that_was_hinted_at_is_left(
    done: tuple[BeliefPilot, Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    pilot, step = done
    source = source_of(pilot, HintedTargets)
    assert source is not None
    source.hints._pixels[:] = 0
    pilot.claimed = None
    monkeypatch.setattr(belief, "LEAVE", 0.0)
    assert deepcopy(pilot).consider(step.observation, step.occupancy).expected.hinted == 0.0
    assert pilot.decide(step.observation, step.occupancy).done
