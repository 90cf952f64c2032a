"""Depth by motion and by the DVL's beams, on scenes whose depth is known."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dream.geometry import SE3, FloatArray, camera_mount
from dream.perception import LearnedDepth, Parallax, Perceived, Perception, View, beam_ends
from dream.perception.parallax import _kernels
from dream.perception.parallax.matching import MotionPoints, PoseNoise, Shot, corners, depths
from dream.protocol import DREAM_V2
from dream.sim.render import Renderer
from dream.sim.sounding import Sounder, altitude
from dream.sim.worlds import make_world
from dream.types import BoolArray, Float32Array, Label, UInt8Array
from tests.perception.models import constant
from tests.perception.scenes import ALTITUDE, CAMERA, Scene, Seen, pose

AMIDSHIPS = SE3(np.eye(3), np.zeros(3))
ALL = np.ones((CAMERA.height, CAMERA.width), np.bool_)
WAY = [pose(0.0, 0.0, 0.0), pose(0.6, 0.1, 0.1), pose(1.2, 0.0, -0.1)]
"""Ahead, towards the wall."""


def shot(seen: Seen, T_world_base: SE3 | None = None) -> Shot:
    view = seen.view if T_world_base is None else replace(seen.view, T_world_base=T_world_base)
    return Shot.of(seen.rgb, CAMERA, view.T_world_camera)


def found(then: Shot, now: Shot, noise: PoseNoise | None = None) -> MotionPoints:
    up = now.T_world_camera.rotation[2]
    return depths(now, then, corners(now, ALL), up, noise or PoseNoise())


def errors(points: MotionPoints, truth: Float32Array) -> FloatArray:
    """(n,) of the logarithms."""
    there = truth[points.places[:, 1].astype(int), points.places[:, 0].astype(int)]
    return np.asarray(np.log(points.depth / there))


class Answers:
    """A network that says of each picture of a scene what a function makes of the truth."""

    def __init__(self, told: Callable[[Float32Array, UInt8Array], tuple[Float32Array, UInt8Array]]) -> None:
        self.told = told
        self.now: tuple[Float32Array, UInt8Array]

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        labels = self.told(*self.now)[1]
        return labels, np.full(labels.shape, 0.9, np.float32)

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        depth = self.told(*self.now)[0]
        return depth, np.where(np.isnan(depth), 0.0, 0.9).astype(np.float32)


def times(factor: float) -> Answers:
    return Answers(lambda depth, labels: (depth * np.float32(factor), labels))


def perceived(network: Answers, frames: Sequence[Seen]) -> list[Perceived]:
    perception, shows = Perception(network, network, Parallax()), []
    for seen in frames:
        network.now = seen.depth, seen.labels
        shows.append(perception.perceive(seen.rgb, seen.view))
    return shows


# MotionPoints.


def test_points_of_floor_and_wall_are_as_deep_as_they_are() -> None:
    then, now = (Scene().seen(place) for place in WAY[:2])
    points = found(shot(then), shot(now))
    off = np.abs(errors(points, now.depth))
    assert len(off) >= 30
    assert np.median(off) < 0.01
    assert np.quantile(off, 0.95) < 0.05
    on_wall = now.labels[points.places[:, 1].astype(int), points.places[:, 0].astype(int)] == Label.OBSTACLE
    assert 5 < np.count_nonzero(on_wall) < len(off) - 5
    assert points.shared < 0.05


def test_what_matches_are_off_their_lines_by_corrects_the_pose() -> None:
    then, now = (Scene().seen(place) for place in (pose(0.0, 0.0, 0.0), pose(0.6, 0.0, 0.0)))
    c, s = math.cos(math.radians(0.4)), math.sin(math.radians(0.4))
    pitched = SE3(then.view.T_world_base.rotation @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.zeros(3))
    free, stiff = PoseNoise(), PoseNoise(1e-6, 1e-7)
    points, uncorrected = (found(shot(then, pitched), shot(now), noise) for noise in (free, stiff))
    off, before = (np.median(np.abs(errors(one, now.depth))) for one in (points, uncorrected))
    assert before > 0.02
    assert off < 0.5 * before


def test_tiles_that_are_all_alike_are_not_taken_for_each_other() -> None:
    scene = Scene(wall=math.inf, tiles=0.25)
    then, now = scene.seen(pose(0.0, 0.7, 0.0)), scene.seen(pose(0.0, 0.0, 0.0))
    off = np.abs(errors(found(shot(then), shot(now)), now.depth))
    # Of some there is only one in view.
    assert np.count_nonzero(off > 0.1) <= 4


def test_the_less_parallax_the_less_is_known() -> None:
    now = Scene().seen(WAY[1])
    near, far = (found(shot(Scene().seen(pose(x, 0.1, 0.1))), shot(now)) for x in (0.5, 0.0))
    assert len(near.depth) < len(far.depth)
    assert near.shared > 2.0 * far.shared
    assert float(near.sigma.max(initial=0.0)) < 0.1


@pytest.mark.parametrize("yaw", [0.2, 0.5])
def test_a_turn_on_the_spot_tells_nothing_and_changes_nothing(yaw: float) -> None:
    shows = perceived(times(1.2), [Scene().seen(pose(0.0, 0.0, turn)) for turn in (0.0, yaw)])
    assert [show.account.points for show in shows] == [0, 0]
    np.testing.assert_array_equal(shows[1].depth, np.float32(1.2) * Scene().seen(pose(0.0, 0.0, yaw)).depth)
    assert math.isnan(shows[1].account.scale)


@pytest.mark.parametrize("what", ["noise", "grey"])
def test_pictures_that_show_nothing_change_nothing(what: str) -> None:
    rng = np.random.default_rng(3)
    frames = []
    for place in WAY:
        seen = Scene().seen(place)
        rgb = np.full_like(seen.rgb, 90)
        if what == "noise":
            rgb = rng.integers(0, 256, rgb.shape, np.uint8)
        frames.append(replace(seen, rgb=rgb))
    for show, seen in zip(perceived(times(1.3), frames), frames, strict=True):
        np.testing.assert_array_equal(show.depth, np.float32(1.3) * seen.depth)
        assert show.account.points < 3
        assert show.account.doubt == ""


# Scale.


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2, 1.3])
def test_a_scale_that_is_a_little_off_is_found(factor: float) -> None:
    frames = [Scene().seen(place) for place in WAY]
    shows = perceived(times(factor), frames)
    assert math.isnan(shows[0].account.scale)
    for show, seen in zip(shows[1:], frames[1:], strict=True):
        assert factor * show.account.scale == pytest.approx(1.0, abs=0.03)
        np.testing.assert_allclose(show.depth, factor * show.account.scale * seen.depth, rtol=1e-5)
        assert show.account.doubt == ""
        assert show.account.points >= 12
        assert show.account.against <= 0.1 * show.account.points


@pytest.mark.parametrize(("factor", "said"), [(3.0, "3"), (0.4, "0.4"), (1.8, "1.8")])
def test_a_depth_that_is_far_off_is_named_and_not_mapped(factor: float, said: str) -> None:
    # Without a floor that is labelled so, only motion can tell.
    network = Answers(
        lambda depth, labels: (depth * np.float32(factor), np.full_like(labels, Label.OBSTACLE))
    )
    first, *others = perceived(network, [Scene().seen(place) for place in WAY])
    assert first.account.points == 0
    assert np.isfinite(first.depth).any()
    for show in others:
        assert np.isnan(show.depth).all()
        assert not show.confidence.any()
        assert f"depth: {said} times as far as motion says, and not mapped" in show.account.doubt


def test_only_the_surface_that_motion_contradicts_is_lost() -> None:
    def told(depth: Float32Array, labels: UInt8Array) -> tuple[Float32Array, UInt8Array]:
        return np.where(labels == Label.OBSTACLE, np.float32(2.0), np.float32(1.0)) * depth, labels

    frames = [Scene(wall=3.0).seen(place) for place in WAY]
    show, seen = perceived(Answers(told), frames)[1], frames[1]
    wall = seen.labels == Label.OBSTACLE
    assert np.isnan(show.depth[wall]).mean() > 0.5
    assert np.isnan(show.depth[~wall]).mean() < 0.05
    assert show.account.against >= 3
    assert show.account.doubt == ""


def test_ground_that_falls_away_is_believed_where_motion_vouches_for_it() -> None:
    scene = Scene(wall=math.inf, fall=math.tan(math.radians(38.0)))
    frames = [scene.seen(SE3.level(x, 0.0, -scene.fall * x, 0.0)) for x in (0.0, 0.5, 1.0)]
    first, *others = perceived(times(1.0), frames)
    assert np.isnan(first.depth).all()
    assert "times as far as the floor by the DVL" in first.account.doubt
    for show, seen in zip(others, frames[1:], strict=True):
        np.testing.assert_array_equal(np.isfinite(show.depth), np.isfinite(seen.depth))
        assert show.account.doubt == ""


def test_a_check_that_begins_anew_has_seen_nothing() -> None:
    network = times(1.2)
    perception = Perception(network, network, Parallax(PoseNoise(0.03)))
    one, other = (Scene().seen(place) for place in WAY[:2])
    network.now = one.depth, one.labels
    perception.perceive(one.rgb, one.view)
    network.now = other.depth, other.labels
    anew = perception.anew
    assert anew.check is not None
    assert anew.check.noise == PoseNoise(0.03)
    assert anew.perceive(other.rgb, other.view).account.points == 0
    assert perception.perceive(other.rgb, other.view).account.points >= 12
    without = Perception(network, network)
    assert without.anew is without
    said = json.loads(json.dumps(without.perceive(other.rgb, other.view).account.said()))
    assert (said["depth_scale"], said["points_checked"], said["points_against"]) == (None, 0, 0)


# Beams.


def with_beams(seen: Seen, factor: float = 1.0) -> Seen:
    """Beams that end on the floor, so many times as far below."""
    ranges = np.full(4, factor * ALTITUDE / math.cos(math.radians(22.5)))
    return replace(seen, view=replace(seen.view, beams=beam_ends(ranges, AMIDSHIPS)))


def test_beams_end_below_to_all_sides() -> None:
    ends = beam_ends(np.full(4, 2.0), SE3.level(-0.2, 0.0, -0.1, 0.0))
    np.testing.assert_allclose(ends[:, 2], -0.1 - 2.0 * math.cos(math.radians(22.5)))
    beside = 2.0 * math.sin(math.radians(22.5)) / math.sqrt(2.0)
    np.testing.assert_allclose(ends[:, 0] + 0.2, [beside, beside, -beside, -beside])
    np.testing.assert_allclose(ends[:, 1], [beside, -beside, beside, -beside])


@pytest.mark.parametrize(("factor", "lost"), [(3.0, True), (0.5, True), (1.2, False)])
def test_beams_in_view_contradict_a_depth_before_anything_moves(factor: float, lost: bool) -> None:
    down = Scene().seen(WAY[0], camera_mount(math.radians(45.0)))
    network = Answers(
        lambda depth, labels: (depth * np.float32(factor), np.full_like(labels, Label.OBSTACLE))
    )
    (show,) = perceived(network, [with_beams(down)])
    assert (show.account.points, show.account.against) == (2, 2 if lost else 0)
    assert np.isnan(show.depth).all() == lost
    assert ("as far as the DVL's beams say, and not mapped" in show.account.doubt) == lost


def test_beams_out_of_view_hold_the_altitude_to_account() -> None:
    seen = Scene().seen(WAY[0])
    (good,) = perceived(times(1.0), [with_beams(seen)])
    assert (good.account.points, good.account.doubt) == (0, "")
    (bad,) = perceived(times(1.0), [with_beams(seen, 0.5)])
    assert bad.account.doubt == "altitude: 2 times that of the DVL's beams"


# Networks that are wrong on purpose.


def noise(depth: Float32Array, labels: UInt8Array) -> tuple[Float32Array, UInt8Array]:
    rng = np.random.default_rng(0)
    cells = np.exp(rng.normal(0.7, 0.5, (60, 80))).astype(np.float32)
    return np.repeat(np.repeat(cells, 4, 0), 4, 1), labels


def confetti(depth: Float32Array, labels: UInt8Array) -> tuple[Float32Array, UInt8Array]:
    cells = np.random.default_rng(0).integers(0, 4, (60, 80)).astype(np.uint8)
    return depth, np.repeat(np.repeat(cells, 4, 0), 4, 1)


@pytest.mark.parametrize("steps", [0.0, 0.3])
@pytest.mark.parametrize(
    ("told", "said"),
    [
        (noise, "depth: scattered as noise is, and not mapped"),
        (confetti, "labels: scattered as noise is, and not mapped"),
        (lambda depth, labels: (3.0 * depth, labels), "depth: 3"),
        (lambda depth, labels: (depth, np.full_like(labels, Label.TARGET)), "labels: every pixel is target"),
    ],
    ids=["noise", "confetti", "far", "target"],
)
def test_a_network_that_is_wrong_on_purpose_is_named_at_once(
    told: Callable[[Float32Array, UInt8Array], tuple[Float32Array, UInt8Array]], said: str, steps: float
) -> None:
    frames = [Scene().seen(pose(steps * k, 0.0, 0.0)) for k in range(3)]
    for show in perceived(Answers(told), frames):
        assert said in show.account.doubt
        assert np.isnan(show.depth).all()


@pytest.fixture(scope="module")
def reef() -> list[Seen]:
    """Five frames of a vehicle that goes on, in the simulator."""
    world, frames = make_world("reef/mound", 3), []
    renderer, start, mount = Renderer(world), world.starts[0], DREAM_V2.T_base_camera
    sounder = Sounder(renderer)
    for k in range(5):
        along = 0.5 * k
        x, y = start.x + along * math.cos(start.yaw), start.y + along * math.sin(start.yaw)
        z = float(world.terrain.height(start.x, start.y)) + 2.0
        T_world_base = SE3.level(x, y, z, start.yaw + 0.1 * (k % 2))
        frame = renderer.render(CAMERA, T_world_base @ mount)
        ranges = sounder.ranges(T_world_base)
        view = View(CAMERA, T_world_base, mount, altitude(ranges), beam_ends(ranges, AMIDSHIPS))
        frames.append(Seen(frame.rgb, frame.depth, frame.labels, view))
    return frames


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_in_the_simulator_the_true_depth_stays_and_another_is_corrected(
    reef: list[Seen], factor: float
) -> None:
    shows = perceived(times(factor), reef)
    scales = [show.account.scale for show in shows]
    assert np.count_nonzero(np.isfinite(scales)) >= 3
    for show, seen in zip(shows, reef, strict=True):
        assert show.account.doubt == ""
        assert np.isfinite(show.depth).sum() > 0.97 * np.isfinite(seen.depth).sum()
        if math.isfinite(show.account.scale):
            assert factor * show.account.scale == pytest.approx(1.0, abs=0.03)


def test_in_the_simulator_networks_that_are_wrong_are_named_within_five_frames(
    reef: list[Seen], tmp_path: Path
) -> None:
    wrong = {
        "depth: 3": times(3.0),
        "depth: 0.3": times(1.0 / 3.0),
        "depth: scattered": Answers(noise),
        "labels: scattered": Answers(confetti),
        "labels: every pixel is target": Answers(
            lambda depth, labels: (depth, np.full_like(labels, Label.TARGET))
        ),
    }
    for said, network in wrong.items():
        assert any(said in show.account.doubt for show in perceived(network, reef)), said
    # A network that is frozen says the same of all of them.
    (tmp_path / "m.json").write_text(json.dumps({"output": "metric_depth"}))
    frozen = LearnedDepth(constant(tmp_path / "m.onnx", np.nan_to_num(reef[0].depth, nan=19.0)))
    labels, doubts = times(1.0), []
    perception = Perception(labels, frozen, Parallax())
    for seen in reef:
        labels.now = seen.depth, seen.labels
        show = perception.perceive(seen.rgb, seen.view)
        doubts.append(show.account.doubt)
    assert "not mapped" in doubts[-1] or "can be believed" in doubts[-1]
    assert np.isnan(show.depth).all()


# Kernels, and the same in a few slow lines.


def test_greys_and_halves() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (9, 13, 3), np.uint8)
    grey = _kernels.grey(rgb)
    np.testing.assert_allclose(grey, rgb @ np.array([0.3, 0.6, 0.1]), rtol=1e-5)
    slow = grey[:8, :12].reshape(4, 2, 6, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(_kernels.halved(grey), slow, rtol=1e-5)


def slow_corners(image: Float32Array, usable: BoolArray, side: int, half: int, least: float) -> FloatArray:
    along, across = np.gradient(image.astype(np.float64))
    moments = np.zeros((*image.shape, 2, 2))
    scores = np.full(image.shape, -1.0)
    moments[1:-1, 1:-1] = np.stack(
        [np.stack([across**2, across * along], -1), np.stack([across * along, along**2], -1)], -1
    )[1:-1, 1:-1]
    for v in range(half + 1, image.shape[0] - half - 1):
        for u in range(half + 1, image.shape[1] - half - 1):
            mean = moments[v - half : v + half + 1, u - half : u + half + 1].mean(axis=(0, 1))
            scores[v, u] = np.linalg.eigvalsh(mean)[0] if usable[v, u] else -1.0
    places = []
    for top in range(0, image.shape[0], side):
        for left in range(0, image.shape[1], side):
            cell = scores[top : top + side, left : left + side]
            if cell.max() > least:
                row, col = divmod(int(cell.argmax()), cell.shape[1])
                places.append((left + col + 0.5, top + row + 0.5))
    return np.array(places)


def test_corners_are_where_gradients_have_two_directions() -> None:
    image = Scene().seen(WAY[0]).rgb[:60, :80, 0].astype(np.float32)
    usable = np.random.default_rng(1).random(image.shape) < 0.7
    found = _kernels.corners(image, usable, 15, 2, 0.3)
    np.testing.assert_array_equal(found, slow_corners(image, usable, 15, 2, 0.3))
    assert len(found) > 5


def test_a_patch_is_read_between_the_pixels() -> None:
    rng = np.random.default_rng(2)
    image = rng.random((20, 30)).astype(np.float32)
    placed, values = (31.3, 18.2, 2.1, 0.3, -0.2, 1.8), np.empty(25)
    assert _kernels._read(image, 2.0, placed, 2, values)
    slow = []
    for i in range(-2, 3):
        for j in range(-2, 3):
            x, y = (31.3 + 2.1 * j - 0.2 * i) / 2.0 - 0.5, (18.2 + 0.3 * j + 1.8 * i) / 2.0 - 0.5
            u, v = int(x), int(y)
            shares = np.outer((1.0 - y + v, y - v), (1.0 - x + u, x - u))
            slow.append(float((shares * image[v : v + 2, u : u + 2]).sum()))
    np.testing.assert_allclose(values, slow, rtol=1e-5)
    assert not _kernels._read(image, 2.0, (3.0, *placed[1:]), 2, values)
    assert not _kernels._read(image, 2.0, (math.nan, *placed[1:]), 2, values)
