"""What poses show, by lists made beforehand: the map's own view, slow twins, symmetries."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from dream.geometry import SE2, Bounds
from dream.lattice import Pose
from dream.mapping import OccupancyMap, view
from dream.planning._kernels.moves import FREE, UNKNOWN
from dream.planning._kernels.views import BEARINGS
from dream.planning.pose_views import Listed, PoseViews
from dream.planning.travel import careful_standoff
from dream.protocol import DREAM_V1
from dream.types import BoolArray, Mission
from tests.mapping.analytic import AREA
from tests.planning.views import shown_by

NOTICE = 1.5
CELL, LATTICE, REACH = DREAM_V1.cell, DREAM_V1.lattice, DREAM_V1.reach
BESIDE, TWO_AROUND = np.ones((3, 3), np.bool_), np.ones((5, 5), np.bool_)
ALL_BOUNDS = {
    "on the lattice": AREA,
    "half a lattice step off": Bounds(-12.25, -11.75, 11.5, 12.0),
    "on no multiple of a cell": Bounds(-12.1, -11.9, 11.65, 12.1),
}
in_all_bounds = pytest.mark.parametrize("bounds", ALL_BOUNDS.values(), ids=ALL_BOUNDS)


def _pose_views(bounds: Bounds = AREA, notice: float = NOTICE) -> PoseViews:
    return PoseViews(Mission(DREAM_V1, bounds, 200), notice)


def _shape(bounds: Bounds) -> tuple[int, int]:
    return round(bounds.depth / CELL), round(bounds.width / CELL)


def _blobs(bounds: Bounds, seed: int, share: float = 0.003) -> BoolArray:
    """Solids of three cells by three."""
    seeds = np.random.default_rng(seed).random(_shape(bounds)) < share
    return np.asarray(binary_dilation(seeds, BESIDE))


def _map(bounds: Bounds, solid: BoolArray) -> OccupancyMap:
    occupancy = OccupancyMap(bounds, DREAM_V1)
    occupancy._write("log_odds", (0, 0), 20 * solid)
    return occupancy


def _tiles_with(pose_views: PoseViews, cells: BoolArray, least: int) -> BoolArray:
    """Of the tiles whose four cells are all on the map, those with so many in the mask."""
    whole = pose_views.on_tiles(np.ones(cells.shape)) >= 4
    return np.asarray(whole & (pose_views.on_tiles(cells.astype(np.float64)) >= least))


def _poses(pose_views: PoseViews, solid: BoolArray, count: int) -> list[Pose]:
    """Random poses on nodes that are not inside or beside something solid."""
    i, j = pose_views.cells_of_nodes()
    free = np.flatnonzero(~binary_dilation(solid, BESIDE)[i, j])
    generator = np.random.default_rng(5)
    nodes = generator.choice(free, count, replace=False)
    headings = generator.integers(DREAM_V1.headings, size=count)
    return [pose_views.lattice.pose_at(node, heading) for node, heading in zip(nodes, headings, strict=True)]


def _seen(occupancy: OccupancyMap, pose_views: PoseViews, pose: Pose) -> BoolArray:
    """(map rows, map cols) what the map says that a pose shows."""
    here = pose_views.lattice.world(pose)
    return view(occupancy, here.x, here.y, here.yaw)


def _middles(pose_views: PoseViews) -> npt.NDArray[np.float64]:
    """(tiles, 2) metres in the world."""
    x, y, _ = pose_views.places()
    corner = pose_views.lattice.positions[0]
    return np.asarray(np.stack([x, y], axis=1)[: pose_views.tiles] + corner, np.float64)


def _nearest(places: npt.NDArray[np.float64], points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(n,) distance of each point to the nearest place."""
    return np.asarray(cKDTree(places).query(points)[0], np.float64)


def _ground_of(pose_views: PoseViews, pose: Pose) -> BoolArray:
    """(tiles,) what the pose shows as ground."""
    tiles = np.zeros(2 * pose_views.tiles, np.bool_)
    tiles[sorted(shown_by(pose_views.views(), pose))] = True
    return tiles[: pose_views.tiles]


def _noticed_of(pose_views: PoseViews, pose: Pose) -> BoolArray:
    """(tiles,) where it would notice a group."""
    tiles = np.zeros(2 * pose_views.tiles, np.bool_)
    tiles[sorted(shown_by(pose_views.views(), pose))] = True
    return tiles[pose_views.tiles :]


# ------------------------------------------------------------------------------------------ against the map


@in_all_bounds
def test_in_the_open_a_tile_is_shown_when_the_map_shows_it(bounds: Bounds) -> None:
    """Exactly where all of its cells are in view, whose middle is then too: the sector is convex.

    At the sector's edge a tile counts by its middle: one of its cells at least is then in view.
    """
    pose_views, nothing = _pose_views(bounds), np.zeros(_shape(bounds), np.bool_)
    occupancy = _map(bounds, nothing)
    for pose in _poses(pose_views, nothing, 40):
        cells = _seen(occupancy, pose_views, pose)
        tiles = _ground_of(pose_views, pose)
        assert tiles[_tiles_with(pose_views, cells, 4)].all()
        in_view_in_part = _tiles_with(pose_views, cells, 1)
        whole = _tiles_with(pose_views, ~nothing, 4)
        assert in_view_in_part[tiles & whole].all()


@in_all_bounds
def test_past_solids_a_tile_is_shown_when_the_map_surely_shows_it(bounds: Bounds) -> None:
    """Surely is with every solid two cells wider.

    The bearing of a tile is rounded to 1/256 of a turn, 0.2 m at the reach, and its middle is a cell's
    diagonal from the far corner of its cells: together less than two cells. So where all four cells are in
    view past the wider solids, the ray to the middle gets past the true ones.
    """
    pose_views, solid = _pose_views(bounds), _blobs(bounds, 1)
    occupancy, wider = _map(bounds, solid), _map(bounds, binary_dilation(solid, TWO_AROUND))
    pose_views.update(occupancy)
    hidden = 0
    for pose in _poses(pose_views, solid, 60):
        surely = _tiles_with(pose_views, _seen(wider, pose_views, pose), 4)
        tiles = _ground_of(pose_views, pose)
        assert tiles[surely].all()
        hidden += int((~tiles & ~_tiles_with(pose_views, _seen(occupancy, pose_views, pose), 1)).sum())
    assert hidden > 1000


@pytest.mark.parametrize("bounds", list(ALL_BOUNDS.values())[:2], ids=list(ALL_BOUNDS)[:2])
def test_nothing_is_shown_that_the_map_hides_behind_a_solid(bounds: Bounds) -> None:
    """The same rounding the other way: of a tile that is shown, the map shows a cell or one beside it."""
    pose_views, solid = _pose_views(bounds), _blobs(bounds, 1)
    occupancy = _map(bounds, solid)
    pose_views.update(occupancy)
    whole = _tiles_with(pose_views, np.ones_like(solid), 4)
    for pose in _poses(pose_views, solid, 60):
        cells = _seen(occupancy, pose_views, pose)
        beside = _tiles_with(pose_views, binary_dilation(cells, BESIDE), 1)
        assert beside[_ground_of(pose_views, pose) & whole].all()


def test_a_wall_hides_all_that_lies_behind_it_and_nothing_before_it() -> None:
    solid = np.zeros(_shape(AREA), np.bool_)
    solid[:, 60:62] = True  # x from 3.0 to 3.5 m.
    pose_views = _pose_views()
    pose_views.update(_map(AREA, solid))
    east = _middles(pose_views)[_ground_of(pose_views, _at(pose_views, 0.0, 0.0, 0))][:, 0]
    assert east.max() < 3.5
    assert east.max() > 3.0, "the face of the wall itself is in view"
    west = _middles(pose_views)[_ground_of(pose_views, _at(pose_views, 0.0, 0.0, 6))][:, 0]
    assert west.min() < -7.0


# ---------------------------------------------------------------------------------------------- sight lines


def _at(pose_views: PoseViews, x: float, y: float, heading: int) -> Pose:
    return pose_views.lattice.pose(SE2(x, y, heading * DREAM_V1.heading_step))


def _slow_depth(solid: BoolArray, bounds: Bounds, x: float, y: float) -> list[int]:
    """Cells to the first solid one along each bearing, in half steps of a cell."""
    limit = math.ceil(REACH / CELL) + 2
    depths = []
    for bearing in range(BEARINGS):
        angle = (bearing + 0.5) * 2.0 * math.pi / BEARINGS
        away = 0.5 * np.arange(1, 2 * limit + 1)
        i = np.floor((y - bounds.y_min) / CELL + away * math.sin(angle)).astype(int)
        j = np.floor((x - bounds.x_min) / CELL + away * math.cos(angle)).astype(int)
        on = (i >= 0) & (i < solid.shape[0]) & (j >= 0) & (j < solid.shape[1])
        hit = np.zeros(len(away), np.bool_)
        hit[on] = solid[i[on], j[on]]
        depths.append(math.ceil(away[hit.argmax()]) if hit.any() else limit)
    return depths


@in_all_bounds
def test_sight_lines_equal_a_slow_walk_along_each_ray(bounds: Bounds) -> None:
    pose_views, solid = _pose_views(bounds), _blobs(bounds, 2, 0.01)
    pose_views.update(_map(bounds, solid))
    depth = pose_views.views().depth
    for node in pose_views.lattice.node_of(_poses(pose_views, solid, 12)).tolist():
        x, y = pose_views.lattice.positions[node].tolist()
        assert depth[node].tolist() == _slow_depth(solid, bounds, x, y)


@in_all_bounds
def test_a_map_that_changes_is_taken_in_as_if_it_had_always_been_so(bounds: Bounds) -> None:
    growing = _pose_views(bounds)
    # One more, then one fewer, then all others.
    one, both = _blobs(bounds, 3, 0.0005), _blobs(bounds, 3, 0.0005) | _blobs(bounds, 4, 0.0005)
    for solid in (one, both, one, np.zeros_like(one), _blobs(bounds, 5)):
        growing.update(_map(bounds, solid))
        at_once = _pose_views(bounds)
        at_once.update(_map(bounds, solid))
        # No view asks farther than the reach.
        far = math.ceil(REACH / CELL)
        np.testing.assert_array_equal(
            np.minimum(growing.views().depth, far), np.minimum(at_once.views().depth, far)
        )


def test_turning_the_solids_by_a_quarter_turns_what_is_shown() -> None:
    solid = _blobs(AREA, 6)
    pose_views, turned = _pose_views(), _pose_views()
    pose_views.update(_map(AREA, solid))
    # Rows grow with y: that way round it is a quarter turn to the left.
    turned.update(_map(AREA, np.rot90(solid, -1)))
    for pose in _poses(pose_views, solid, 30):
        place = pose_views.lattice.world(pose)
        image = turned.lattice.pose(SE2(-place.y, place.x, place.yaw + math.pi / 2))
        for tiles_of in (_ground_of, _noticed_of):
            here = _middles(pose_views)[tiles_of(pose_views, pose)]
            there = _middles(turned)[tiles_of(turned, image)]
            expected = np.stack([-here[:, 1], here[:, 0]], axis=1)
            assert {tuple(p) for p in expected.round(3) + 0.0} == {tuple(p) for p in there.round(3) + 0.0}


# ------------------------------------------------------------------------------------------------ noticing


@pytest.mark.parametrize("notice", [0.6, 1.5, 3.0])
def test_a_group_is_noticed_where_some_ground_near_its_middle_is_shown(notice: float) -> None:
    """Never farther than `notice`; always within it less half a tile, which rounding may lose."""
    pose_views = _pose_views(notice=notice)
    middles = _middles(pose_views)
    for heading in range(DREAM_V1.headings):
        pose = _at(pose_views, 0.5, -1.0, heading)
        seen = middles[_ground_of(pose_views, pose)]
        away = _nearest(seen, middles)
        noticed = _noticed_of(pose_views, pose)
        assert (away[noticed] <= notice).all()
        assert noticed[away <= notice - 0.5 * LATTICE - 1e-6].all()
        assert noticed.sum() >= len(seen) > 0


def test_a_group_as_small_as_a_cell_is_noticed_where_its_ground_is_shown() -> None:
    pose_views = _pose_views(notice=0.5 * CELL)
    pose = _at(pose_views, 0.5, -1.0, 2)
    np.testing.assert_array_equal(_noticed_of(pose_views, pose), _ground_of(pose_views, pose))


def test_a_group_behind_a_wall_is_not_noticed_beyond_its_own_size() -> None:
    solid = np.zeros(_shape(AREA), np.bool_)
    solid[:, 60:62] = True
    pose_views = _pose_views()
    pose_views.update(_map(AREA, solid))
    noticed = _middles(pose_views)[_noticed_of(pose_views, _at(pose_views, 0.0, 0.0, 0))]
    assert 3.5 < noticed[:, 0].max() <= 3.5 + NOTICE


# -------------------------------------------------------------------------------------------------- tiles


@in_all_bounds
def test_tiles_hold_their_cells_and_areas_hold_their_tiles(bounds: Bounds) -> None:
    pose_views = _pose_views(bounds)
    occupancy = _map(bounds, np.zeros(_shape(bounds), np.bool_))
    weights = np.random.default_rng(7).random(occupancy.shape)
    assert pose_views.on_tiles(weights).sum() == pytest.approx(weights.sum(), rel=1e-5)
    middles = _middles(pose_views)
    for row, col in [(0, 0), (40, 17), (occupancy.shape[0] - 1, occupancy.shape[1] - 1)]:
        alone = np.zeros(occupancy.shape)
        alone[row, col] = 1.0
        (tile,) = np.flatnonzero(pose_views.on_tiles(alone))
        gap = np.abs(middles[tile] - np.array(occupancy.center_of(row, col)))
        assert gap.max() <= 0.5 * LATTICE + 1e-6

    x, y, area = pose_views.places()
    assert area.min() >= 0
    assert area.max() < pose_views.areas
    for number in np.unique(area):
        members = np.stack([x, y])[:, area == number]
        assert np.ptp(members, axis=1).max() <= 4.0
    ground, hiding = np.split(np.stack([x, y, area]), 2, axis=1)
    np.testing.assert_array_equal(ground, hiding)


def test_listed_elements_follow_the_tiles_and_lie_where_they_say() -> None:
    pose_views = _pose_views()
    positions = np.array([[-3.1, 4.4], [11.9, -11.9]])
    here = pose_views.lattice.node(0.0, 0.0)
    starts = np.zeros(DREAM_V1.headings + 1, np.int64)
    starts[4:] = 2  # Heading 3 shows both, the others none.
    node = np.array([here])
    listed = Listed(np.ones(2), np.ones(2), positions, node, starts, np.array([0, 1]))
    x, y, area = pose_views.places(listed)
    corner = pose_views.lattice.positions[0]
    np.testing.assert_allclose(np.stack([x, y], axis=1)[-2:] + corner, positions, atol=1e-5)
    tree = cKDTree(_middles(pose_views))
    np.testing.assert_array_equal(area[-2:], area[: pose_views.tiles][tree.query(positions)[1]])
    both = {2 * pose_views.tiles, 2 * pose_views.tiles + 1}
    without, views = pose_views.views(), pose_views.views(listed)
    for heading in range(DREAM_V1.headings):
        pose = pose_views.lattice.pose_at(here, heading)
        more = shown_by(views, pose) - shown_by(without, pose)
        assert more == (both if heading == 3 else set())
    beside = _at(pose_views, LATTICE, 0.0, 3)
    assert shown_by(views, beside) == shown_by(without, beside)


def test_ground_is_known_where_some_of_a_tile_is_traversable() -> None:
    occupancy = OccupancyMap(AREA, DREAM_V1)
    occupancy.clear_launch(1.0, 2.0)
    pose_views = _pose_views()
    known = pose_views.known_tiles(occupancy)
    np.testing.assert_array_equal(known, pose_views.on_tiles(occupancy.traversable.astype(np.float64)) > 0)
    assert 0 < known.sum() < 200


# -------------------------------------------------------------------------------------------------- moves


@pytest.fixture(scope="module", params=list(ALL_BOUNDS.values()), ids=list(ALL_BOUNDS))
def crossing(request: pytest.FixtureRequest) -> tuple[PoseViews, OccupancyMap, npt.NDArray[np.uint8]]:
    """A map with solids, nothing of which is known to be free, and its moves."""
    bounds: Bounds = request.param
    pose_views = _pose_views(bounds)
    occupancy = _map(bounds, _blobs(bounds, 8, 0.002))
    known = np.zeros(pose_views.lattice.graph.ahead.shape, np.uint8)
    return pose_views, occupancy, pose_views.moves(known, occupancy, careful_standoff(DREAM_V1))


def _along(pose_views: PoseViews, move: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """(n, 2) points on the way of a move (pose, advance)."""
    lattice = pose_views.lattice
    heading, length = lattice.heading_of(move[0]), DREAM_V1.advances[move[1]]
    way = np.array(DREAM_V1.offset(heading, length)) * LATTICE
    return np.asarray(lattice.position(move[0]) + np.linspace(0.0, 1.0, 17)[:, None] * way)


def _clearance(occupancy: OccupancyMap, points: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Least distance of points to the middle of a solid cell, and to the bounds; −1 outside."""
    bounds = occupancy.bounds
    edge = min(np.min(points - [bounds.x_min, bounds.y_min]), np.min([bounds.x_max, bounds.y_max] - points))
    solids = np.stack(occupancy.center_of(*np.nonzero(occupancy.solid)), axis=1)
    return float(_nearest(solids, points).min()), float(edge)


def test_no_move_into_the_unknown_leads_past_solids_too_near_or_out_of_bounds(
    crossing: tuple[PoseViews, OccupancyMap, npt.NDArray[np.uint8]],
) -> None:
    """A way is probed every quarter, at most 0.5 m apart, in whole cells: so much nearer it may come."""
    pose_views, occupancy, moves = crossing
    slack = 0.5 * 0.5 + 0.5 * math.sqrt(2.0) * CELL
    chosen = np.argwhere(moves == UNKNOWN)[::97]
    assert len(chosen) > 100
    for move in chosen:
        solid, edge = _clearance(occupancy, _along(pose_views, move))
        assert solid >= careful_standoff(DREAM_V1) - slack
        assert edge >= DREAM_V1.body_radius


def test_where_nothing_solid_is_near_every_move_may_be_tried(
    crossing: tuple[PoseViews, OccupancyMap, npt.NDArray[np.uint8]],
) -> None:
    pose_views, occupancy, moves = crossing
    slack = 0.5 * math.sqrt(2.0) * CELL
    free = 0
    for move in np.argwhere(moves != UNKNOWN)[::97]:
        solid, edge = _clearance(occupancy, _along(pose_views, move))
        assert solid < careful_standoff(DREAM_V1) + slack or edge < DREAM_V1.body_radius + CELL + slack
    for move in np.argwhere(moves == UNKNOWN)[::97]:
        free += _clearance(occupancy, _along(pose_views, move))[0] > 2.0
    assert free > 100


def test_moves_known_to_be_free_stay_so_whatever_is_near() -> None:
    occupancy = _map(AREA, _blobs(AREA, 8, 0.02))
    pose_views = _pose_views()
    ahead = pose_views.lattice.graph.ahead
    known = (np.random.default_rng(9).random(ahead.shape) < 0.2).astype(np.uint8)
    before = known.copy()
    moves = pose_views.moves(known, occupancy, careful_standoff(DREAM_V1))
    np.testing.assert_array_equal(moves == FREE, before == 1)
    np.testing.assert_array_equal(known, before)
    assert set(np.unique(moves)) == {0, FREE, UNKNOWN}


@in_all_bounds
def test_nodes_and_their_cells_are_where_the_map_has_them(bounds: Bounds) -> None:
    pose_views = _pose_views(bounds)
    occupancy = _map(bounds, np.zeros(_shape(bounds), np.bool_))
    i, j = pose_views.cells_of_nodes()
    lattice = pose_views.lattice
    for node in (0, int(lattice.graph.grid[7, 12]), int(lattice.graph.grid[-2, -2])):
        x, y = lattice.positions[node]
        assert lattice.node(x, y) == node
        assert (i[node], j[node]) == occupancy.cell_of(x, y)
    assert i.max() < occupancy.shape[0]
    assert j.max() < occupancy.shape[1]
