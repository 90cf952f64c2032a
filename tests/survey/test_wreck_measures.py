"""The measures of a wreck against their truth: of a box whose figures are known on paper, and of a tug."""

import dataclasses
import math
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage
from scipy.spatial import ConvexHull

from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap
from dream.protocol import DREAM_V1, DREAM_V1_NOISY, SurveyProtocol
from dream.sim.camera_noise import noise_generator, noisy_depth, with_noise
from dream.sim.render import Frame, Renderer
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.survey import About, Measure, Survey, measure_observations, patches
from dream.survey.footprint import Footprint
from dream.survey.ground import Frame as MeasuredFrame
from dream.types import Label, Observation, Target

ABOUT = About("a wreck", datetime(2026, 6, 1, tzinfo=UTC), target=Target.WRECK)
SEABED = -10.0
HULL = np.array([[-2.99, -1.49, SEABED], [2.99, 1.49, SEABED + 2.6]])
"""Corners of a box 2.6 m high; not on the borders of cells."""
AREA = 5.98 * 2.98
"""Of the hull, square metres."""
PIECE = np.array([[-0.49, -3.79, SEABED], [0.49, -2.81, SEABED + 0.3]])
"""A piece of debris, 1.32 m from the hull."""
DEBRIS = 0.98**2
"""Square metres of it."""
MAST = np.array([[-0.11, -0.11, SEABED], [0.11, 0.11, SEABED + 6.0]])
CELL = 0.025

Float64Array = npt.NDArray[np.float64]


def looking(x: float, y: float, yaw: float, protocol: SurveyProtocol, seabed: float = SEABED) -> SE3:
    """T_world_base at the protocol's altitude."""
    return SE3.level(x, y, seabed + protocol.altitude, yaw)


def cast(
    T_world_base: SE3, protocol: SurveyProtocol, *boxes: Float64Array
) -> tuple[Float64Array, npt.NDArray[np.uint8]]:
    """Depth and labels of boxes on their level seabed, as a camera without noise sees them."""
    camera, T = protocol.camera, T_world_base @ protocol.T_base_camera
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    rays = rays @ T.rotation.T
    with np.errstate(divide="ignore"):
        bed = (SEABED - T.translation[2]) / rays[..., 2]
        depth = np.where(bed > 0.0, bed, np.inf)
        labels = np.full(depth.shape, Label.SEABED, np.uint8)
        for box in boxes:
            sides = (box[:, None, None] - T.translation) / rays
            near, far = sides.min(axis=0).max(axis=-1), sides.max(axis=0).min(axis=-1)
            hit = (near <= far) & (near > 0.0) & (near <= depth)
            depth[hit], labels[hit] = near[hit], Label.TARGET
    beyond = depth > protocol.max_depth
    depth[beyond], labels[beyond] = np.nan, Label.WATER
    return depth, labels


def of_the_boxes(protocol: SurveyProtocol, piece: Float64Array = PIECE) -> list[Observation]:
    """From three rings about them; a noisy sensor misses the hull now and then, and once sees debris."""
    blank = np.zeros((protocol.camera.height, protocol.camera.width, 3), np.uint8)
    rng = np.random.default_rng(5)
    seen = []
    for number in range(30):
        angle, away = 2.0 * math.pi * number / 10.0, (4.5, 6.0, 9.0)[number // 10]
        base = looking(-away * math.cos(angle), -away * math.sin(angle), angle, protocol)
        depth, labels = cast(base, protocol, HULL, piece)
        exact = depth.astype(np.float32)
        if protocol.noise is not None:
            exact = noisy_depth(exact, protocol.noise.depth, rng)
            if number % 10 == 9:
                labels[labels == Label.TARGET] = Label.OBSTACLE
            if number == 3:
                labels[-60:, 100:220][labels[-60:, 100:220] == Label.SEABED] = Label.TARGET
        seen.append(
            Observation(float(number), blank, exact, labels, protocol.camera, base, protocol.T_base_camera)
        )
    return seen


def surveyed(seen: list[Observation], bounds: Bounds, protocol: SurveyProtocol) -> Survey:
    occupancy = OccupancyMap(bounds, protocol)
    for one in seen:
        occupancy.integrate(one.depth, one.labels, one.camera, one.T_world_camera)
    return measure_observations(seen, occupancy, ABOUT)


def told(survey: Survey) -> dict[str, Measure]:
    return {measure.name: measure for measure in survey.measures}


def holds(measure: Measure, truth: float) -> bool:
    assert measure.low is not None
    assert measure.high is not None
    return measure.low <= truth <= measure.high


@pytest.fixture(scope="module", params=[DREAM_V1, DREAM_V1_NOISY], ids=lambda protocol: protocol.name)
def boxes(request: pytest.FixtureRequest) -> Survey:
    seen = of_the_boxes(request.param)
    return surveyed(seen, Bounds(-9.0, -9.0, 9.0, 9.0), request.param)


@pytest.mark.rare
def test_the_outline_of_a_box_is_its_area(boxes: Survey) -> None:
    area = told(boxes)["outline_area"]
    assert area.value == pytest.approx(AREA, rel=0.03)
    assert holds(area, AREA)


def test_the_top_of_a_box_is_its_height(boxes: Survey) -> None:
    top = told(boxes)["highest_point"]
    assert top.value == pytest.approx(2.6, abs=0.04)
    assert holds(top, 2.6)


def test_debris_is_what_more_than_one_frame_shows(boxes: Survey) -> None:
    measures = told(boxes)
    assert len(boxes.patches) == 2
    assert measures["debris_area"].value == pytest.approx(DEBRIS, abs=0.1)
    assert holds(measures["debris_area"], DEBRIS)
    corners = np.array([[x, y] for box in (HULL, PIECE) for x in box[:, 0] for y in box[:, 1]])
    across, _ = patches.calipers(corners)
    assert measures["debris_extent"].value == pytest.approx(across, abs=0.06)
    assert holds(measures["debris_extent"], across)


def test_the_hull_has_the_measures_of_the_whole(boxes: Survey) -> None:
    measures = told(boxes)
    hull = {measure.name: measure for measure in boxes.patches[0].measures}
    assert hull["area"].value == measures["outline_area"].value
    assert hull["height"].value == measures["highest_point"].value
    assert hull["length"].value == pytest.approx(math.hypot(5.98, 2.98), abs=0.06)
    assert hull["width"].value == pytest.approx(2.98, abs=0.15)
    piece = {measure.name: measure for measure in boxes.patches[1].measures}
    assert piece["height"].value == pytest.approx(0.3, abs=0.1)


def test_a_gap_that_may_be_bridged_is_in_the_interval() -> None:
    """The debris lies 1.05 m from the hull: with a closing of 5 cm more it would be hull."""
    seen = of_the_boxes(DREAM_V1, PIECE + np.array([0.0, 0.27, 0.0]))
    measures = told(surveyed(seen, Bounds(-9.0, -9.0, 9.0, 9.0), DREAM_V1))
    assert measures["outline_area"].value == pytest.approx(AREA, rel=0.02)
    assert holds(measures["outline_area"], 19.9)
    assert holds(measures["debris_area"], 0.0)


def test_many_looks_from_afar_do_not_raise_the_highest_point() -> None:
    """One look scatters by 4 cm there, and the greatest of forty is 7 cm too high."""
    protocol, rng = DREAM_V1_NOISY, np.random.default_rng(3)
    assert protocol.noise is not None
    blank = np.zeros((protocol.camera.height, protocol.camera.width, 3), np.uint8)
    footprint = Footprint(Bounds(-9.0, -9.0, 9.0, 9.0), CELL, protocol, protocol.noise.depth)
    for number in range(40):
        angle = 2.0 * math.pi * number / 40.0
        base = looking(-16.0 * math.cos(angle), -16.0 * math.sin(angle), angle, protocol)
        depth, labels = cast(base, protocol, MAST)
        noisy = noisy_depth(depth.astype(np.float32), protocol.noise.depth, rng)
        footprint.integrate(
            MeasuredFrame.of(
                Observation(
                    float(number), blank, noisy, labels, protocol.camera, base, protocol.T_base_camera
                )
            )
        )
    top = footprint.top
    assert top is not None
    assert top.sure == pytest.approx(MAST[1, 2], abs=0.05)
    assert not top.cut


@pytest.mark.rare
def test_a_mast_that_the_image_cuts_off_may_be_higher() -> None:
    blank = np.zeros((DREAM_V1.camera.height, DREAM_V1.camera.width, 3), np.uint8)
    seen = []
    for number in range(12):
        angle = 2.0 * math.pi * number / 12.0
        base = looking(-12.0 * math.cos(angle), -12.0 * math.sin(angle), angle, DREAM_V1)
        depth, labels = cast(base, DREAM_V1, HULL, MAST)
        seen.append(
            Observation(
                float(number),
                blank,
                depth.astype(np.float32),
                labels,
                DREAM_V1.camera,
                base,
                DREAM_V1.T_base_camera,
            )
        )
        near = looking(-5.0 * math.cos(angle), -5.0 * math.sin(angle), angle, DREAM_V1)
        depth, labels = cast(near, DREAM_V1, HULL, MAST)
        seen.append(
            dataclasses.replace(seen[-1], depth=depth.astype(np.float32), labels=labels, T_world_base=near)
        )
    top = told(surveyed(seen, Bounds(-14.0, -14.0, 14.0, 14.0), DREAM_V1))["highest_point"]
    assert "cuts it off" in top.note
    assert holds(top, 6.0)


def test_a_seabed_without_a_wreck_leaves_every_measure_unknown() -> None:
    camera, seen = DREAM_V1.camera, []
    for turn in range(4):
        base = looking(0.0, 0.0, 0.5 * math.pi * turn, DREAM_V1)
        depth, labels = cast(base, DREAM_V1)
        rgb = np.zeros((camera.height, camera.width, 3), np.uint8)
        seen.append(
            Observation(
                float(turn), rgb, depth.astype(np.float32), labels, camera, base, DREAM_V1.T_base_camera
            )
        )
    survey = surveyed(seen, Bounds(-9.0, -9.0, 9.0, 9.0), DREAM_V1)
    names = ["outline_area", "hull_seen", "debris_extent", "debris_area", "highest_point"]
    assert [measure.name for measure in survey.measures if measure.value is None] == names
    assert {measure.note for measure in survey.measures if measure.value is None} == {"no wreck was found"}
    assert survey.patches == ()


# ------------------------------------------------------------------------------------------------- a tug


def corners_of(world: World) -> Float64Array:
    """(T, 3, 3) of every triangle of the wreck, in the world."""
    targets = world.targets
    parts = [
        (world.meshes[mesh].vertices.astype(np.float64) + position)[world.meshes[mesh].faces]
        for mesh, position in zip(targets.mesh, targets.position, strict=True)
    ]
    return np.concatenate(parts)


def true_outline(world: World) -> float:
    """Square metres of the largest piece, from points strewn over every triangle that is above ground."""
    triangles = corners_of(world)
    steps = np.linspace(0.0, 1.0, 21)
    a, b = (one.ravel() for one in np.meshgrid(steps, steps))
    a, b = a[a + b <= 1.0], b[a + b <= 1.0]
    weights = np.stack([1.0 - a - b, a, b])
    points = np.einsum("tij,ik->tkj", triangles, weights).reshape(-1, 3)
    points = points[points[:, 2] > world.terrain.height(points[:, 0], points[:, 1])]
    bounds = world.bounds
    cover = np.zeros((round(bounds.depth / CELL), round(bounds.width / CELL)), np.bool_)
    col, row = ((points[:, :2] - (bounds.x_min, bounds.y_min)) / CELL).astype(np.intp).T
    cover[row, col] = True
    marks, _ = patches.parts(patches.closed(cover, CELL), CELL)
    return float(np.count_nonzero(ndimage.binary_fill_holes(marks == 0))) * CELL**2


def around_it(world: World) -> Iterator[SE3]:
    """Along its sides 3 m and 11 m off, looking at it: from near its outline shows, from afar its mast."""
    targets = np.asarray(world.targets.position[:, :2], np.float64)
    ring = targets[ConvexHull(targets).vertices]
    for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        along = (end - start) / math.dist(start, end)
        out = np.array([along[1], -along[0]])
        for away, step in ((3.0, 1.5), (11.0, 6.0)):
            for share in np.arange(0.0, 1.0, step / max(math.dist(start, end), step)):
                x, y = start + share * (end - start) + away * out
                if world.bounds.contains(x, y):
                    seabed = float(world.terrain.height(x, y))
                    yield looking(float(x), float(y), math.atan2(-out[1], -out[0]), DREAM_V1, seabed)


def of_the_tug(world: World, protocol: SurveyProtocol) -> list[Observation]:
    assert protocol.noise is not None
    renderer, camera = Renderer(world), protocol.camera
    blank = np.zeros((camera.height, camera.width, 3), np.uint8)
    seen = []
    for number, base in enumerate(around_it(world)):
        T_world_camera = base @ protocol.T_base_camera
        frame = Frame(blank, *renderer.measure(camera, T_world_camera))
        rng = noise_generator(world, SE2(0.0, 0.0, 0.0), number)
        frame = with_noise(frame, camera, T_world_camera, protocol.noise, rng, hull=world.hull)
        seen.append(
            Observation(float(number), blank, frame.depth, frame.labels, camera, base, protocol.T_base_camera)
        )
    return seen


@pytest.mark.rare
def test_a_tug_has_its_outline_and_height_in_the_intervals_for_all_the_noise() -> None:
    tug = make_world("wreck/4", 7201)
    low, high = (one(corners_of(tug)[..., :2], axis=(0, 1)) for one in (np.min, np.max))
    bounds = Bounds(*np.floor(low - 2.0).tolist(), *np.ceil(high + 2.0).tolist())
    measures = told(surveyed(of_the_tug(tug, DREAM_V1_NOISY), bounds, DREAM_V1_NOISY))
    area = true_outline(tug)
    assert measures["outline_area"].value == pytest.approx(area, rel=0.05)
    assert holds(measures["outline_area"], area)
    middle = np.asarray(tug.targets.position[:, :2], np.float64).mean(axis=0)
    height = corners_of(tug)[..., 2].max() - float(tug.terrain.height(*middle))
    assert measures["highest_point"].value == pytest.approx(height, abs=0.1)
    assert holds(measures["highest_point"], height)
