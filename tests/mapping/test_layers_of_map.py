"""Laws of the whole map: windows, bounds, turns, files, memory, and what changes its mind."""

from __future__ import annotations

import io
import itertools
import json
import math
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from dream.geometry import SE3, Bounds, Camera, camera_mount
from dream.mapping import OccupancyMap, frontiers
from dream.mapping.layers import CELLS, POST, POSTS, Layers, post_bits
from dream.protocol import DREAM_V1
from dream.types import Label
from tests.mapping.analytic import (
    AREA,
    CAMERA,
    SEABED,
    Disc,
    Pillar,
    camera_at,
    empty_map,
    look,
    look_around,
    render,
    wall,
)

LAYERS = (
    "known",
    "solid",
    "target",
    "target_probability",
    "explored",
    "observed",
    "seabed_seen",
    "crossed",
    "traversable",
    "standable",
    "room",
    "ground",
)
STORED = (*CELLS, *POSTS)
THINGS = (
    Pillar(4.0, 1.3, 0.7, 3.0),
    Pillar(-2.2, 5.1, 1.1, 1.0),
    Pillar(3.3, -4.4, 0.4, 2.0),
    Disc(2.0, 5.2, 1.3),
    Disc(-5.0, -2.0, 0.9),
)
POSES = ((0.0, 0.5, 0.2), (1.5, -1.0, 1.4), (-2.0, 2.5, -2.3), (0.3, 0.1, 3.0))


def endless_map() -> OccupancyMap:
    return OccupancyMap(None, DREAM_V1)


def moved(thing: Pillar | Disc, x: float, y: float) -> Pillar | Disc:
    if isinstance(thing, Disc):
        return Disc(thing.x + x, thing.y + y, thing.radius)
    return Pillar(thing.x + x, thing.y + y, thing.radius, thing.height, thing.label)


def survey(occupancy: OccupancyMap, x: float = 0.0, y: float = 0.0, poses: Any = POSES) -> None:
    for at_x, at_y, yaw in poses:
        look(occupancy, at_x + x, at_y + y, yaw, *(moved(thing, x, y) for thing in THINGS))


def everything(occupancy: OccupancyMap) -> dict[tuple[int, ...], list[bytes]]:
    """All that is stored, block by block."""
    store = occupancy._store
    return {
        key: [store.pools[name][slot].tobytes() for name in STORED] for key, slot in store.slot_of.items()
    }


def same_layers(one: Layers, other: Layers) -> None:
    assert one.shape == other.shape
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


# ------------------------------------------------------------------------------------ windows and bounds


def test_a_map_without_an_end_holds_the_same_inside_the_bounds_as_one_with() -> None:
    wide = Bounds(-32.0, -32.0, 32.0, 32.0)
    bounded, endless = OccupancyMap(wide, DREAM_V1), endless_map()
    for occupancy in (bounded, endless):
        occupancy.clear_launch(0.0, 0.0)
        survey(occupancy)
    window = Bounds(-12.0, -12.0, 12.0, 12.0)
    same_layers(bounded.over(window), endless.over(window))
    found = [
        sorted((frontier.size, frontier.centroid) for frontier in frontiers(occupancy))
        for occupancy in (bounded, endless)
    ]
    assert [size for size, _ in found[0]] == [size for size, _ in found[1]]
    np.testing.assert_allclose([at for _, at in found[0]], [at for _, at in found[1]], atol=1e-9)


@pytest.mark.parametrize("far", [(10_000.0, 0.0), (10_000.0, 10_000.0), (-60_000.0, 9_000.0), (3.0, 2e7)])
def test_areas_of_a_map_without_an_end_take_what_was_seen_and_not_the_box_around_it(
    far: tuple[float, float],
) -> None:
    alone, both = endless_map(), endless_map()
    for occupancy in (alone, both):
        occupancy.clear_launch(0.0, 0.0)
        survey(occupancy)
    # Of one place the sums are those of the layers.
    assert alone.areas() == Layers.areas(alone)
    here = alone.areas()
    survey(both, *far)
    tracemalloc.start()
    areas = both.areas()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 16 << 20
    for name, area in here.items():
        assert 1.9 * area <= areas[name] <= 2.1 * area + 1.0


@pytest.mark.parametrize("far", [(10_000.0, 10_000.0), (-60_000.0, 9_000.0), (500.0, 2e7)])
def test_a_box_of_too_many_cells_is_not_read_at_once(far: tuple[float, float]) -> None:
    occupancy = endless_map()
    for x, y in ((0.0, 0.0), far):
        look(occupancy, x, y, 0.0)
    for layer in ("solid", "room", "ground", "distance_to_bounds"):
        with pytest.raises(
            ValueError, match=r"at most 67108864 cells to be read at a time, got .* with over"
        ):
            getattr(occupancy, layer)
    with pytest.raises(ValueError, match="cells to be read at a time"):
        occupancy.over(occupancy.bounds)
    x, y = far
    assert occupancy.over(Bounds(x - 10.0, y - 10.0, x + 10.0, y + 10.0)).explored.any()
    with pytest.raises(ValueError, match="cells to be read at a time"):
        _ = OccupancyMap(Bounds(0.0, 0.0, 100_000.0, 1_000.0), DREAM_V1).explored


def test_nothing_is_ever_known_outside_the_bounds() -> None:
    small = Bounds(-1.0, -2.5, 3.0, 4.0)
    occupancy = OccupancyMap(small, DREAM_V1)
    occupancy.clear_launch(0.0, 0.0)
    survey(occupancy)
    assert occupancy.explored.any()
    over = occupancy.over(Bounds(-9.0, -9.0, 9.0, 9.0))
    outside = np.ones(over.shape, np.bool_)
    row, col = over.cell_of(small.x_min + 0.1, small.y_min + 0.1)
    outside[row : row + occupancy.shape[0], col : col + occupancy.shape[1]] = False
    for name in ("known", "solid", "target", "observed", "traversable"):
        assert not (getattr(over, name) & outside).any(), name
        np.testing.assert_array_equal(getattr(over, name)[~outside].ravel(), getattr(occupancy, name).ravel())


@given(seed=st.integers(0, 2**31))
@settings(max_examples=6, phases=[Phase.generate])
def test_moving_world_and_robot_by_whole_blocks_moves_the_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    row, col = (int(n) for n in rng.integers(-1000, 1000, 2))
    here, there = endless_map(), endless_map()
    poses = [(*rng.integers(-64, 64, 2) / 16.0, rng.uniform(-3.0, 3.0)) for _ in range(2)]
    survey(here, poses=poses)
    survey(there, 16.0 * col, 16.0 * row, poses=poses)
    at_here, at_there = everything(here), everything(there)
    assert {(i + row, j + col) for i, j in at_here} == set(at_there)
    for (i, j), content in at_here.items():
        assert at_there[i + row, j + col][:3] == content[:3]
    assert there.bounds.x_min - here.bounds.x_min == 16.0 * col
    np.testing.assert_allclose(here.ground, there.ground, atol=1e-5)


def test_quarter_turns_of_scene_and_robot_turn_the_answer_also_when_things_vanish() -> None:
    def turned(quarter: int, x: float, y: float) -> tuple[float, float]:
        for _ in range(quarter):
            x, y = -y, x
        return x, y

    maps = []
    for quarter in range(4):
        occupancy = empty_map()
        for gone in (False, False, True, True):
            things: list[Pillar | Disc] = []
            for thing in THINGS:
                x, y = turned(quarter, thing.x, thing.y)
                if not (gone and isinstance(thing, Pillar)):
                    things.append(moved(thing, x - thing.x, y - thing.y))
            for x, y, yaw in POSES:
                look(occupancy, *turned(quarter, x + 0.013, y - 0.021), yaw + quarter * math.pi / 2, *things)
        maps.append(occupancy)
    first = maps[0]
    assert first.solid.any() or first.target.any()
    for quarter, occupancy in enumerate(maps):
        for name in ("solid", "target", "explored", "observed", "crossed", "traversable"):
            back = np.rot90(getattr(occupancy, name), quarter)
            # Pixels are thinned from the left and rays have fixed bearings: the same up to rounding.
            assert (back != getattr(first, name)).sum() <= 2, (name, quarter)
        odds = [occupancy._store.read("log_odds", (0, 0), (96, 96)) for occupancy in (first, occupancy)]
        assert (odds[0] != np.rot90(odds[1], quarter)).sum() <= 4, quarter


@pytest.mark.parametrize("bounded", [True, False])
@given(seed=st.integers(0, 2**31))
@settings(max_examples=10, phases=[Phase.generate])
def test_a_window_is_a_slice_of_the_whole_also_across_its_edge(bounded: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupancy = empty_map() if bounded else endless_map()
    occupancy.clear_launch(0.0, 0.0)
    survey(occupancy, poses=POSES[:2])
    x, y = rng.uniform(-25.0, 20.0, 2)
    width, depth = rng.uniform(0.1, 25.0, 2)
    over = occupancy.over(Bounds(x, y, x + width, y + depth))
    assert over.bounds.x_min <= x + 1e-6
    assert over.bounds.y_max >= y + depth - 1e-6
    assert over.bounds.width < width + 2 * DREAM_V1.cell
    inside = occupancy.contains(*over.center_of(*np.indices(over.shape)))
    row, col = occupancy.cell_of(*over.center_of(*np.indices(over.shape)))
    for name in LAYERS:
        part, whole = getattr(over, name), getattr(occupancy, name)
        np.testing.assert_array_equal(part[inside], whole[row[inside], col[inside]], err_msg=name)
    for name in ("known", "solid", "target", "observed", "traversable", "standable"):
        assert not getattr(over, name)[~inside].any(), name


def test_a_window_keeps_its_values_when_the_map_goes_on() -> None:
    occupancy = endless_map()
    survey(occupancy, poses=POSES[:1])
    window = Bounds(-5.0, -20.0, 20.0, 9.0)
    kept, read = occupancy.over(window), occupancy.over(window)
    before = {name: getattr(read, name).copy() for name in LAYERS}
    survey(occupancy, poses=POSES[1:])
    survey(occupancy, 40.0, 0.0)
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(kept, name), before[name], err_msg=name)
    assert (occupancy.over(window).explored & ~kept.explored).any()


def test_reading_a_map_does_not_change_what_comes_next() -> None:
    reader, writer = endless_map(), endless_map()
    pose = SE3.level(15.7, 8.3, SEABED + 2.1, 0.0) @ camera_mount(math.radians(40.0))
    for _ in range(4):
        for occupancy in (reader, writer):
            occupancy.integrate(*render(pose, Pillar(16.45, 8.3, 0.25, 1.5)), CAMERA, pose)
        reader.standable, frontiers(reader), reader.over(Bounds(0.0, 0.0, 30.0, 1.0)), reader.areas()
    assert everything(reader) == everything(writer)


READERS = {
    "standable": lambda occupancy: occupancy.standable,
    "explored": lambda occupancy: occupancy.explored,
    "frontiers": frontiers,
    "over": lambda occupancy: occupancy.over(Bounds(0.0, 0.0, 30.0, 1.0)),
    "copy": OccupancyMap.copy,
}


@pytest.mark.parametrize("readers", list(itertools.permutations(READERS, 2)), ids="-".join)
def test_what_was_read_before_does_not_change_what_is_read(readers: tuple[str, str]) -> None:
    for make, x in ((empty_map, 0.0), (endless_map, 8.0)):
        reader, other = make(), make()
        for occupancy in (reader, other):
            look(occupancy, x, 8.0, 0.0, Pillar(x + 7.6, 8.0, 0.2, 4.0))
        for name in readers:
            READERS[name](reader)
        same_layers(reader, other)
        assert reader.bounds == other.bounds
        assert reader.solid.any()


def test_beyond_the_farthest_cell_there_is_no_map() -> None:
    occupancy = endless_map()
    with pytest.raises(ValueError, match="T_world_camera: expected a place within"):
        look(occupancy, 2e9, 0.0, 0.0)
    assert occupancy.nbytes == endless_map().nbytes


# ---------------------------------------------------------------------------------------- what changed


@given(seed=st.integers(0, 2**31))
@settings(max_examples=8, phases=[Phase.generate])
def test_a_frame_changes_cells_within_reach_and_none_far_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupancy = endless_map()
    window = Bounds(-80.0, -80.0, 80.0, 80.0)
    for _ in range(3):
        x, y, yaw = rng.uniform(-60.0, 60.0), rng.uniform(-60.0, 60.0), rng.uniform(-3.0, 3.0)
        before = occupancy.over(window)
        look(occupancy, x, y, yaw, Pillar(x + 3.0, y, 0.5, 2.0))
        after = occupancy.over(window)
        east, north = after.center_of(*np.indices(after.shape))
        far = np.hypot(east - x, north - y) > DREAM_V1.reach + DREAM_V1.cell
        for name in ("solid", "target_probability", "observed", "explored", "crossed", "traversable"):
            changed = getattr(before, name) != getattr(after, name)
            assert not (changed & far).any(), name
        assert ((before.explored != after.explored) & ~far).any()


def test_memory_grows_only_with_what_was_seen() -> None:
    occupancy = endless_map()
    empty = occupancy.nbytes
    look_around(occupancy, 0.1, 0.1)
    once = occupancy.nbytes
    for _ in range(3):
        look_around(occupancy, 0.1, 0.1)
    assert occupancy.nbytes == once > empty
    far = endless_map()
    look_around(far, 0.1, 0.1)
    look_around(far, 16e5 + 0.1, -16e5 + 0.1)
    assert far.nbytes - once == once - empty
    square_kilometre = (once - empty) / (len(occupancy._store) * 16.0**2) * 1e6
    assert square_kilometre < 350e6


# ------------------------------------------------------------------------------- what changes its mind


def test_a_vanished_obstacle_is_cleared_within_six_frames_that_see_the_ground_there() -> None:
    for pillar in (Pillar(4.0, 0.3, 0.5, 3.0), Pillar(3.0, -0.6, 0.2, 1.2), Pillar(5.0, 0.0, 1.0, 2.0)):
        occupancy = empty_map()
        for _ in range(20):
            look(occupancy, 0.0, 0.0, 0.0, pillar)
        assert occupancy.solid.any()
        for _ in range(6):
            look(occupancy, 0.0, 0.0, 0.0)
        assert not occupancy.solid.any()


def test_the_middle_of_a_flat_top_that_vanished_is_cleared_by_doubt() -> None:
    # Its sides were seen, its middle only from above, as that of an overhang would be.
    occupancy = empty_map()
    for _ in range(20):
        look(occupancy, 0.0, 0.0, 0.0, Pillar(3.0, -0.6, 0.3, 1.2))
    for _ in range(6):
        look(occupancy, 0.0, 0.0, 0.0)
    assert 0 < occupancy.solid.sum() <= 2
    for _ in range(18):
        look(occupancy, 0.0, 0.0, 0.0)
    assert not occupancy.solid.any()


def test_an_obstacle_that_moved_is_where_it_is_and_no_longer_where_it_was() -> None:
    occupancy = empty_map()
    for _ in range(10):
        look(occupancy, 0.0, 0.0, 0.0, Pillar(3.5, 1.3, 0.5, 3.0))
    assert occupancy.solid[occupancy.cell_of(3.1, 1.2)]
    for _ in range(6):
        look(occupancy, 0.0, 0.0, 0.0, Pillar(4.0, -1.3, 0.5, 3.0))
    y = occupancy.center_of(*np.nonzero(occupancy.solid))[1]
    assert len(y)
    assert (y < 0.0).all()


def test_an_overhang_under_which_the_ground_is_seen_stays_longer_than_a_pillar() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, wall(4.1, height=6.0))
    heights = CAMERA.back_project(depth, pose)[..., 2] - SEABED
    for _ in range(20):
        # Of the wall only what is higher than 1.2 m was there.
        occupancy.integrate(np.where(heights < 1.2, np.nan, depth), labels, CAMERA, pose)
    assert occupancy.solid.sum() > 20
    hull = occupancy.solid
    for _ in range(6):
        below = render(pose)
        occupancy.integrate(np.where(heights < 1.2, below[0], np.nan), below[1], CAMERA, pose)
    assert (occupancy.solid & hull).sum() == hull.sum()


@pytest.mark.parametrize("below", [0.1, 0.15, 0.2])
def test_a_deck_at_the_height_of_the_camera_is_not_cleared_by_the_ground_seen_under_its_edge(
    below: float,
) -> None:
    occupancy = empty_map()
    edge = 6.0
    east, north = occupancy.center_of(*np.indices(occupancy.shape))
    front = (abs(east - edge - 0.5 * DREAM_V1.cell) < 0.01) & (abs(north) < 1.0)
    marked = np.zeros_like(front)
    for x in np.arange(2.5, 4.6, 0.25):
        pose = camera_at(float(x), 0.0, 0.0)
        depth, labels = render(pose)
        # A level plate without thickness, from x = 6 to 9 m: a few rows of the image, or one.
        rays = CAMERA.back_project(np.ones_like(depth), pose) - pose.translation
        far = np.divide(-below, rays[..., 2], out=np.full(depth.shape, np.inf), where=rays[..., 2] < 0.0)
        x_of, y_of = (far * rays[..., axis] + pose.translation[axis] for axis in (0, 1))
        plate = (x_of >= edge) & (x_of <= edge + 3.0) & (abs(y_of) <= 2.0)
        occupancy.integrate(
            np.where(plate, far, depth).astype(np.float32),
            np.where(plate, Label.TARGET, labels).astype(np.uint8),
            CAMERA,
            pose,
        )
        assert not (marked & front & ~occupancy.solid).any()
        marked = occupancy.solid
    assert marked[front].all()


@pytest.mark.parametrize("offset", [0.6, 1.0, 1.7])
def test_a_wall_seen_at_a_grazing_angle_is_neither_erased_nor_invented(offset: float) -> None:
    occupancy = empty_map()
    beside = Pillar(0.0, offset + 500.0, 500.0, 3.0)  # Along the x axis, to the left.
    for x in (-6.0, -3.0, 0.0, 3.0):  # Seen from in front first.
        look(occupancy, x, offset - 3.0, 0.5 * math.pi, beside)
    _, y = occupancy.center_of(*np.indices(occupancy.shape))
    face = math.floor(offset / 0.25) * 0.25 + 0.125
    solid = occupancy.solid
    assert solid[abs(y - face) < 0.01].sum() > 30
    # Nothing in front of the wall, and no more behind its face than the next cell.
    assert not solid[(y < face - 0.13) | (y > face + 0.38)].any()
    for _ in range(6):
        for x in (-6.0, 0.0):
            look(occupancy, x, 0.0, 0.0, beside)
            look(occupancy, x, 0.0, -0.2, beside)
    assert (occupancy.solid & solid).sum() == solid.sum()
    assert not occupancy.solid[(y < face - 0.13) | (y > face + 0.38)].any()


# --------------------------------------------------------------------------------------------- files


def saved(path: Path, occupancy: OccupancyMap) -> OccupancyMap:
    occupancy.save(path)
    return OccupancyMap.load(path)


def near_a_border() -> OccupancyMap:
    """The wall's inflation falls into a block that was not seen."""
    occupancy = endless_map()
    look(occupancy, 11.7, 0.3, 0.0, wall(15.6))
    return occupancy


def of_negative_blocks() -> OccupancyMap:
    occupancy = endless_map()
    survey(occupancy, -100.0, -180.0)
    survey(occupancy, 40.0, 3.0)
    return occupancy


def surveyed() -> OccupancyMap:
    occupancy = empty_map()
    occupancy.clear_launch(0.0, 0.0)
    survey(occupancy)
    return occupancy


MAPS = {
    "empty": empty_map,
    "endless and empty": endless_map,
    "bounded": surveyed,
    "negative blocks": of_negative_blocks,
    "near a border": near_a_border,
}


@pytest.mark.parametrize("kind", MAPS)
def test_a_map_comes_back_without_loss_and_goes_on_alike(tmp_path: Path, kind: str) -> None:
    occupancy = MAPS[kind]()
    back = saved(tmp_path / "map.npz", occupancy)
    for later in (False, True):
        if later:
            for one in (occupancy, back):
                survey(one, 3.0, -2.0, poses=POSES[:2])
        assert (back.bounds, back.low, back.shape) == (occupancy.bounds, occupancy.low, occupancy.shape)
        assert (back.protocol, back.evidence) == (occupancy.protocol, occupancy.evidence)
        assert everything(back) == everything(occupancy)
        same_layers(back, occupancy)
        assert [f.centroid for f in frontiers(back)] == [f.centroid for f in frontiers(occupancy)]


@pytest.mark.parametrize("kind", MAPS)
def test_a_copy_is_equal_in_every_layer_and_goes_its_own_way(kind: str) -> None:
    occupancy = MAPS[kind]()
    other = occupancy.copy()
    assert everything(other) == everything(occupancy)
    same_layers(other, occupancy)
    assert other.bounds == occupancy.bounds
    before = everything(occupancy)
    survey(other, poses=[(0.0, 0.0, -1.0)])
    assert everything(occupancy) == before != everything(other)


def refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"map\.npz: .*expected .*got"):
        OccupancyMap.load(path)


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("maps") / "whole.npz"
    surveyed().save(path)
    return path.read_bytes()


def members(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        return {name: file.read(name) for name in file.namelist()}


def zipped(of: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in of.items():
            file.writestr(name, data)
    return stream.getvalue()


def as_npy(array: npt.NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=True)
    return stream.getvalue()


def of_npy(data: bytes) -> npt.NDArray[Any]:
    array: npt.NDArray[Any] = np.lib.format.read_array(io.BytesIO(data))
    return array


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"a map",
        b"PK\x03\x04",
        as_npy(np.zeros(3)),
        zipped({}),
        zipped({"x.npy": as_npy(np.zeros(3))}),
    ],
)
def test_a_foreign_file_is_refused(tmp_path: Path, data: bytes) -> None:
    refused(tmp_path / "map.npz", data)


def test_a_file_cut_short_anywhere_is_refused(tmp_path: Path, content: bytes) -> None:
    for length in np.linspace(0, len(content) - 1, 60).astype(int):
        refused(tmp_path / "map.npz", content[:length])


def test_a_file_with_any_wrong_bit_is_refused_or_is_the_same_map(tmp_path: Path, content: bytes) -> None:
    rng = np.random.default_rng(3)
    path = tmp_path / "map.npz"
    path.write_bytes(content)
    expected = everything(OccupancyMap.load(path))
    # All over the file, and in its directory at the end.
    places = [*rng.integers(0, len(content), 150), *(len(content) - 1 - rng.integers(0, 600, 150))]
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            found = OccupancyMap.load(path)
        except ValueError:
            refused(path, bytes(damaged))
        else:
            assert everything(found) == expected


@pytest.mark.parametrize("name", [*STORED, "blocks", "stamps", "about"])
@pytest.mark.parametrize("damage", ["missing", "shape", "type", "empty", "pickled", "cut", "huge", "text"])
def test_a_file_with_a_damaged_layer_is_refused(
    tmp_path: Path, content: bytes, name: str, damage: str
) -> None:
    parts = members(content)
    key = f"{name}.npy"
    array = of_npy(parts[key])
    if damage == "missing":
        del parts[key]
    elif damage == "shape":
        parts[key] = as_npy(np.stack([array, array]))
    elif damage == "type":
        parts[key] = as_npy(np.zeros(array.shape, np.complex64))
    elif damage == "empty":
        parts[key] = b""
    elif damage == "pickled":
        parts[key] = as_npy(np.array([{}], object))
    elif damage == "cut":
        parts[key] = parts[key][:-1]
    elif damage == "text":
        parts[key] = b"nothing that NumPy would write"
    else:
        for count in (10**7, 10**12, 10**18):
            stream = io.BytesIO()
            shape = (count, *array.shape[1:])
            descr = np.lib.format.dtype_to_descr(array.dtype)
            np.lib.format.write_array_header_1_0(
                stream, {"descr": descr, "fortran_order": False, "shape": shape}
            )
            refused(tmp_path / "map.npz", zipped(parts | {key: stream.getvalue() + parts[key][128:]}))
        return
    refused(tmp_path / "map.npz", zipped(parts))


@pytest.mark.parametrize("name", POSTS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_file_with_heights_that_are_no_numbers_is_refused(
    tmp_path: Path, content: bytes, name: str, value: float
) -> None:
    parts = members(content)
    array = of_npy(parts[f"{name}.npy"]).copy()
    array.flat[17] = value
    refused(tmp_path / "map.npz", zipped(parts | {f"{name}.npy": as_npy(array)}))


@pytest.mark.parametrize(
    "blocks",
    [
        lambda keys: np.repeat(keys[:1], len(keys), axis=0),
        lambda keys: keys + (1 << 40),
        lambda keys: keys.astype(np.int32),
        lambda keys: keys.astype(float),
        lambda keys: keys[:, :1],
        lambda keys: keys.ravel(),
        lambda keys: keys[:-1],
        lambda keys: np.where(np.arange(len(keys))[:, None] == 0, np.iinfo(np.int64).min, keys),
        lambda keys: np.where(np.arange(len(keys))[:, None] == 0, 1 << 25, keys),
    ],
)
def test_a_file_with_blocks_that_cannot_be_is_refused(tmp_path: Path, content: bytes, blocks: Any) -> None:
    parts = members(content)
    refused(tmp_path / "map.npz", zipped(parts | {"blocks.npy": as_npy(blocks(of_npy(parts["blocks.npy"])))}))


@pytest.mark.parametrize(
    "path, value",
    [
        (("format",), "dream-map-1"),
        (("format",), None),
        (("bounds",), [1, 2, 3]),
        (("bounds",), {"x_min": 0.0}),
        (("bounds", "x_max"), 1e6 + 0.1),
        (("bounds", "x_max"), -1e6),
        (("bounds", "x_max"), math.nan),
        (("bounds", "x_max"), 1e300),
        (("protocol",), None),
        (("protocol", "cell"), 0),
        (("protocol", "cell"), -0.25),
        (("protocol", "cell"), "0.25"),
        (("protocol", "reach"), 1e9),
        (("protocol", "cell"), 1e-9),
        (("protocol", "body_radius"), 1e9),
        (("protocol", "headings"), 10**9),
        (("protocol", "altitude"), "deep"),
        (("protocol", "altitude"), math.inf),
        (("protocol", "camera", "fx"), 0.0),
        (("protocol", "camera"), None),
        (("protocol", "band"), 3),
        (("protocol", "unheard_of"), 3),
        (("evidence",), []),
        (("evidence", "clamp"), 5),
        (("evidence", "clamp"), [0.3, 3.5]),
        (("evidence", "detection"), 1.5),
        (("evidence", "detection"), 0.01),
        (("evidence", "range_noise"), math.nan),
        (("evidence", "vote_share"), math.nan),
        (("evidence", "vote_share"), 0.05),
        (("evidence", "against_share"), 0.6),
        (("evidence", "min_pixels"), "two"),
        (("evidence", "ground_pixels"), 0.0),
        (("evidence", "step"), "much"),
        (("stamp",), "late"),
        (("stamp",), -5),
        (("stamp",), 0),
        (("stamp",), math.inf),
        (("stamp",), None),
        (("datum",), [1.0]),
        (("datum",), "deep"),
    ],
)
def test_a_file_that_says_wrong_things_about_itself_is_refused(
    tmp_path: Path, content: bytes, path: tuple[str, ...], value: Any
) -> None:
    parts = members(content)
    about = json.loads(str(of_npy(parts["about.npy"])))
    place = about
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    refused(tmp_path / "map.npz", zipped(parts | {"about.npy": as_npy(np.array(json.dumps(about)))}))


def test_a_file_with_more_in_it_is_refused(tmp_path: Path, content: bytes) -> None:
    more = {"more.npy": as_npy(np.zeros(3))}
    refused(tmp_path / "map.npz", zipped(members(content) | more))


# ------------------------------------------------------------------------------------ kinds of images


@pytest.mark.parametrize("shape", [(1500, 2000), (1, 1 << 17), (1 << 16, 1)])
def test_of_a_very_large_image_enough_is_read_to_tell_a_wall(shape: tuple[int, int]) -> None:
    # All of it lies on a wall 3 m ahead, in so few cells that counting every pixel would overflow.
    height, width = shape
    camera = Camera(width, height, 40.0 * width, 40.0 * height, 0.5 * width, 0.5 * height)
    occupancy = endless_map()
    pose = SE3.level(0.1, 0.1, SEABED + 1.5, 0.0) @ camera_mount(0.0)
    occupancy.integrate(
        np.full(shape, 3.0, np.float32), np.full(shape, Label.OBSTACLE, np.uint8), camera, pose
    )
    assert occupancy.solid[occupancy.cell_of(3.1, 0.1)]
    assert occupancy.solid.sum() == 1


def test_millimetres_and_metres_of_any_width_make_the_same_map() -> None:
    pose = camera_at(0.2, 0.1, 0.3)
    depth, labels = render(pose, *THINGS)
    depth_mm = np.where(np.isfinite(depth), np.rint(1000.0 * depth), 0.0).astype(np.uint16)
    exact = depth_mm.astype(np.float32) * np.float32(0.001)
    maps = []
    kinds: list[tuple[npt.NDArray[Any], npt.NDArray[Any]]] = [
        (depth_mm, labels),
        (exact, labels),
        (exact.astype(np.float64), labels.astype(np.int64)),
        (exact.astype(">f4"), labels.astype(">i2")),
        (np.asfortranarray(exact), labels[::-1].copy()[::-1]),
    ]
    for depth_so, labels_so in kinds:
        maps.append(empty_map())
        maps[-1].integrate(depth_so, labels_so, CAMERA, pose)
    for other in maps[1:]:
        assert everything(other) == everything(maps[0])
    half = empty_map()
    half.integrate(depth.astype(np.float16), labels, CAMERA, pose)
    assert (half.explored != maps[0].explored).mean() < 0.01


def test_sure_probabilities_find_the_targets_that_labels_do() -> None:
    soft, hard = empty_map(), empty_map()
    for x, y, yaw in POSES * 2:
        pose = camera_at(x, y, yaw)
        depth, labels = render(pose, *THINGS)
        hard.integrate(depth, labels, CAMERA, pose)
        soft.integrate(depth, np.where(labels == Label.TARGET, 1.0, 0.0), CAMERA, pose)
    np.testing.assert_array_equal(soft.target, hard.target)
    np.testing.assert_array_equal(soft.explored, hard.explored)
    assert (soft.solid != hard.solid).sum() <= 2
    assert soft.target.sum() > 50


def test_unsure_pixels_vote_by_the_share_that_they_would_be_right() -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, _ = render(pose)
    # By shares of 0.1 and 0.5; between them a frame says nothing of a cell.
    for probability, expected in ((0.05, -1), (0.2, 0), (0.4, 0), (0.6, 1)):
        occupancy = empty_map()
        before = occupancy.target_probability
        occupancy.integrate(depth, np.full(depth.shape, probability), CAMERA, pose)
        after = occupancy.target_probability
        assert (np.sign(after - before)[occupancy.seabed_seen] == expected).all()
        assert (occupancy.target[occupancy.seabed_seen] == (expected > 0)).all()


def test_poses_a_thousand_kilometres_away_make_the_same_map() -> None:
    away = 2.0**20
    there = Bounds(AREA.x_min + away, AREA.y_min - away, AREA.x_max + away, AREA.y_max - away)
    near, far = empty_map(), OccupancyMap(there, DREAM_V1)
    for x, y, yaw in POSES:
        pose = camera_at(x, y, yaw)
        images = render(pose, *THINGS)
        near.integrate(*images, CAMERA, pose)
        far.integrate(*images, CAMERA, SE3(pose.rotation, pose.translation + np.array([away, -away, 0.0])))
    for name in CELLS:
        np.testing.assert_array_equal(
            near._store.read(name, (0, 0), (96, 96)), far._store.read(name, (0, 0), (96, 96)), err_msg=name
        )


@pytest.mark.parametrize(("confidence", "units"), [(1.0, 12), (0.5, 6), (0.25, 3), (0.05, 1), (0.02, 0)])
def test_a_hit_counts_as_far_as_it_is_sure(confidence: float, units: int) -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, wall(3.0))
    sure, unsure = empty_map(), empty_map()
    sure.integrate(depth, labels, CAMERA, pose)
    unsure.integrate(depth, labels, CAMERA, pose, np.full(depth.shape, confidence))
    whole = sure._wide("log_odds") == 12
    assert whole.sum() > 10
    assert (unsure._wide("log_odds")[whole] == units).all()


def test_what_is_unsure_clears_slowly() -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, wall(3.0))
    ground = render(pose)
    left = []
    for confidence in (1.0, 0.5, 0.1):
        occupancy = empty_map()
        for _ in range(4):
            occupancy.integrate(depth, labels, CAMERA, pose)
        stood = int(occupancy.solid.sum())
        for _ in range(5):
            occupancy.integrate(*ground, CAMERA, pose, np.full(depth.shape, confidence))
        left.append(int(occupancy.solid.sum()) / stood)
    assert left[0] < 0.3
    assert left[0] < left[1] <= left[2]
    assert left[2] > 0.9


def test_unsure_labels_have_no_vote_and_surer_ones_outvote_others() -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, _ = render(pose)
    target = np.full(depth.shape, Label.TARGET, np.uint8)
    for confidence, expected in ((0.9, 1), (0.5, 1), (0.4, 0), (0.1, 0)):
        occupancy = empty_map()
        before = occupancy.target_probability
        occupancy.integrate(depth, target, CAMERA, pose, np.full(depth.shape, confidence))
        after = occupancy.target_probability
        assert (np.sign(after - before)[occupancy.seabed_seen] == expected).all()


@pytest.mark.parametrize(
    ("confidence", "wrong"),
    [
        (np.full((2, 2), 0.5), "confidence: expected"),
        (np.full((CAMERA.height, CAMERA.width), 1.5), "confidence: expected probabilities"),
        (np.full((CAMERA.height, CAMERA.width), np.nan), "confidence: expected probabilities"),
    ],
)
def test_a_confidence_that_is_none_is_refused(confidence: npt.NDArray[Any], wrong: str) -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose)
    with pytest.raises(ValueError, match=wrong):
        empty_map().integrate(depth, labels, CAMERA, pose, confidence)
    with pytest.raises(ValueError, match="expected none beside probabilities"):
        empty_map().integrate(depth, np.zeros(depth.shape), CAMERA, pose, np.ones(depth.shape))


@pytest.mark.parametrize("cell", [0.05, 0.1, 0.25, 0.4, 0.6, 1.0, 2.5])
def test_a_post_is_as_wide_as_doubled_cells_allow_and_never_less_than_a_cell(
    cell: float,
) -> None:
    width = cell * 2.0 ** post_bits(replace(DREAM_V1, cell=cell))
    assert width >= cell
    if cell <= POST:
        assert POST / math.sqrt(2.0) <= width <= POST * math.sqrt(2.0)
    else:
        assert width == cell
