"""The map knows what was traversed, and is not complete before all targets are that can be."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap, check_completion, to_traverse, traversal_margin
from dream.mapping._kernels import flags
from dream.mapping.drawing import TARGET, TRAVERSED, draw_map
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.sim.visibility import traversed as scored
from dream.types import BoolArray
from tests.mapping import analytic

TANK = Bounds(-1.5, -1.5, 1.5, 1.5)
SIDE = 60
NOWHERE = np.full((POOL_V1.camera.height, POOL_V1.camera.width), np.nan, np.float32)
START = SE2(0.0, 0.0, 0.0)


def pass_by(occupancy: OccupancyMap, pose: SE2) -> None:
    """A frame from there, in which nothing is seen."""
    T_world_camera = SE3.level(pose.x, pose.y, -0.9, pose.yaw) @ POOL_V1.T_base_camera
    occupancy.integrate(NOWHERE, np.zeros(NOWHERE.shape, np.uint8), POOL_V1.camera, T_world_camera)


def tank(target: BoolArray | None = None, *, explored: BoolArray | None = None) -> OccupancyMap:
    """A map under pool-v1 of bare, explored ground with these targets."""
    occupancy = OccupancyMap(TANK, POOL_V1)
    known = np.ones((SIDE, SIDE), np.bool_) if explored is None else explored
    occupancy._write("flags", (0, 0), (flags.EXPLORED | flags.BARE) * known)
    if target is not None:
        occupancy._write("votes", (0, 0), 0x30 * target)
    return occupancy


def cells(*boxes: tuple[int | slice, int | slice]) -> BoolArray:
    """(rows, cols) true in boxes of rows and columns."""
    marked = np.zeros((SIDE, SIDE), np.bool_)
    for box in boxes:
        marked[box] = True
    return marked


def by_the_score(occupancy: OccupancyMap, poses: list[SE2]) -> BoolArray:
    """The slow twin: each cell's middle, taken for an individual, by the measure of the simulator."""
    flown = np.array([[pose.x, pose.y, pose.yaw] for pose in poses])
    found = np.zeros(occupancy.shape, np.bool_)
    for row, col in np.ndindex(*occupancy.shape):
        x, y = occupancy.center_of(row, col)
        found[row, col] = scored(np.array([float(x), float(y), 0.0]), flown, POOL_V1).any()
    return found


def test_the_layer_is_the_measure_of_the_score_on_the_middles_of_cells() -> None:
    generator = np.random.default_rng(3)
    places = generator.uniform((-1.8, -1.8, -3.0), (1.8, 1.8, 3.0), (9, 3)).tolist()
    poses = [SE2(x, y, yaw) for x, y, yaw in places]
    occupancy = tank()
    before = np.zeros(occupancy.shape, np.bool_)
    for pose in poses:
        pass_by(occupancy, pose)
        assert (occupancy.traversed | ~before).all(), "it never forgets"
        before = occupancy.traversed
    np.testing.assert_array_equal(before, by_the_score(occupancy, poses))
    assert 0 < before.sum() < before.size


def test_a_map_without_an_end_knows_it_too() -> None:
    occupancy = OccupancyMap(None, POOL_V1)
    pose = SE2(7.013, -4.021, 1.1)
    pass_by(occupancy, pose)
    window = occupancy.over(Bounds(6.0, -5.0, 8.0, -3.0))
    x, y = window.center_of(*np.indices(window.shape))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    flown = np.array([[pose.x, pose.y, pose.yaw]])
    expected = [scored(point, flown, POOL_V1)[0] for point in points]
    np.testing.assert_array_equal(window.traversed.ravel(), expected)


def test_a_copy_and_a_file_keep_it(tmp_path: Path) -> None:
    occupancy = tank(cells(np.s_[30:34, 35:45]))
    pass_by(occupancy, START)
    occupancy.save(tmp_path / "map.npz")
    for other in (occupancy.copy(), OccupancyMap.load(tmp_path / "map.npz")):
        np.testing.assert_array_equal(other.traversed, occupancy.traversed)
        before = occupancy.traversed
        pass_by(other, SE2(0.5, 0.5, 2.0))
        assert (other.traversed & ~before).any()
        assert (occupancy.traversed == before).all(), "they share nothing"


@pytest.mark.parametrize("protocol", [DREAM_V1, POOL_V1])
def test_a_file_has_it_where_its_protocol_asks_for_it_and_only_there(
    tmp_path: Path, protocol: SurveyProtocol
) -> None:
    (analytic.empty_map() if protocol is DREAM_V1 else tank()).save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as file:
        content = dict(file)
    if protocol is POOL_V1:
        del content["traversed"]
    else:
        content["traversed"] = content["flags"]
    np.savez_compressed(tmp_path / "other.npz", **content)
    with pytest.raises(ValueError, match="traversed: expected where the protocol has a traversal"):
        OccupancyMap.load(tmp_path / "other.npz")


def test_without_a_traversal_nothing_is_traversed_and_nothing_has_to_be() -> None:
    occupancy = analytic.map_with(explored=np.ones((96, 96), np.bool_), target=np.eye(96, dtype=np.bool_))
    analytic.look(occupancy, 0.0, 0.0, 0.0)
    assert not occupancy.traversed.any()
    assert not to_traverse(occupancy).any()
    assert check_completion(occupancy, START).complete
    assert "traversed" not in occupancy._store.pools


def test_a_map_is_not_complete_before_its_targets_are_traversed() -> None:
    occupancy = tank(cells(np.s_[29:31, 36:38], np.s_[29:31, 44:46]))
    refused = check_completion(occupancy, START)
    assert refused.seen
    assert not refused.complete
    assert len(refused.untraversed) == 8
    assert refused.open_region == "8 target cells around (0.6, 0.0) were not traversed"
    pass_by(occupancy, START)
    assert len(check_completion(occupancy, START).untraversed) == 4, "those within 0.6 m were"
    pass_by(occupancy, SE2(0.3, 0.0, math.pi))
    assert not check_completion(occupancy, START).complete, "it looked the other way"
    pass_by(occupancy, SE2(0.3, 0.0, 0.0))
    accepted = check_completion(occupancy, START)
    assert accepted.complete
    assert accepted.open_region == ""
    assert not accepted.untraversed.flags.writeable


def test_what_is_open_is_said_before_what_is_not_traversed() -> None:
    explored = ~cells(np.s_[31, 36])
    sentence = check_completion(tank(cells(np.s_[29:31, 36:38]), explored=explored), START).open_region
    assert sentence.startswith("region 1 near")


def test_targets_that_no_reachable_pose_traverses_do_not_count() -> None:
    corner = np.s_[0, 0]
    target = cells(corner, np.s_[5, 5])
    occupancy = tank(target)
    # Beside the bounds the body must stay 0.385 m off them, which is 0.54 m from the very corner.
    assert len(check_completion(occupancy, START).untraversed) == 2
    behind = tank(target)
    behind._write("log_odds", (0, 0), 20 * cells(np.s_[:13, 12], np.s_[12, :13]))
    assert len(check_completion(behind, START).untraversed) == 0, "walled off"
    assert to_traverse(behind).sum() == 2


def test_only_the_area_has_to_be_traversed() -> None:
    occupancy = tank(cells(np.s_[29:31, 36:38], np.s_[29:31, 10:12]))
    occupancy.restrict(Bounds(0.0, -1.5, 1.5, 1.5))
    assert {tuple(cell) for cell in check_completion(occupancy, START).untraversed} == {
        (29, 36), (29, 37), (30, 36), (30, 37)
    }  # fmt: skip


def test_each_cell_that_counts_is_traversed_from_some_pose_of_the_lattice_with_its_margin() -> None:
    """So that completion never waits for what no heading brings in front."""
    near = (POOL_V1.traversal or 0.0) - traversal_margin(POOL_V1) - 1e-9
    for bearing in np.linspace(0.0, 2.0 * math.pi, 97):
        point = near * np.array([math.cos(bearing), math.sin(bearing), 0.0])
        yaws = np.arange(POOL_V1.headings) * POOL_V1.heading_step
        poses = np.column_stack([np.zeros((len(yaws), 2)), yaws])
        assert scored(point, poses, POOL_V1).any()


def test_the_picture_tells_what_was_traversed() -> None:
    occupancy = tank(cells(np.s_[29:31, 36:38], np.s_[29:31, 44:46]))
    pass_by(occupancy, START)
    pixels = np.asarray(draw_map(occupancy, scale=4)).reshape(-1, 3)
    squares = {color: int((pixels == color).all(axis=1).sum()) for color in (TARGET, TRAVERSED)}
    assert min(squares.values()) > 4 * 4 * 2
    plain = np.asarray(draw_map(analytic.map_with(target=np.eye(96, dtype=np.bool_)))).reshape(-1, 3)
    assert not (plain == TRAVERSED).all(axis=1).any()
