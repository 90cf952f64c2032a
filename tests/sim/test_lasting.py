"""Errors that last: how much is wrong and where, the same from everywhere and in each flight of a mission."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage, stats

from dream.geometry import SE2, SE3, Camera
from dream.protocol import DREAM_V2, LastingErrors
from dream.sim.lasting import MissionErrors, mission_errors, with_wrong_labels
from dream.sim.render import Frame
from dream.types import Label
from tests.sim.made import made

assert DREAM_V2.lasting is not None
LASTING = DREAM_V2.lasting
CAMERA = Camera.from_fov(320, 240, math.radians(90.0))
COARSE = CAMERA.scaled(0.25)
"""For what is counted over many views."""
SHAPE = CAMERA.height, CAMERA.width
MISSED_AS = np.full(3, Label.OBSTACLE, np.uint8)
WORD, GOLDEN = 2**64 - 1, 0x9E3779B97F4A7C15

Wrong = npt.NDArray[np.bool_]


def straight(camera: Camera) -> npt.NDArray[np.floating]:
    """(H, W) metres straight from the camera for each along its axis."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return np.sqrt(1.0 + u[None, :] ** 2 + v[:, None] ** 2)


def showing(depth: npt.NDArray[np.floating], label: Label) -> Frame:
    ids = np.full(depth.shape, 0 if label == Label.TARGET else -1, np.int32)
    rgb = np.zeros((*depth.shape, 3), np.uint8)
    return Frame(rgb, depth.astype(np.float32), np.full(depth.shape, label, np.uint8), ids)


def around(metres: float, place: tuple[float, float, float], label: Label, key: int = 1) -> Wrong:
    """What is wrong of a sphere about the camera."""
    pose = SE3.level(*place, 0.3) @ DREAM_V2.T_base_camera
    frame = showing(metres / straight(COARSE), label)
    return np.asarray(with_wrong_labels(frame, COARSE, pose, LASTING, key, MISSED_AS) != label)


def below(
    height: float,
    lasting: LastingErrors,
    label: Label = Label.SEABED,
    x: float = 0.0,
    turn: float = 0.0,
    camera: Camera = CAMERA,
) -> Wrong:
    """What is wrong of level ground at z = 0 right below a camera."""
    c, s = math.cos(turn), math.sin(turn)
    down = SE3(np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]]), np.array([x, 0.0, height]))
    frame = showing(np.full((camera.height, camera.width), height), label)
    return np.asarray(with_wrong_labels(frame, camera, down, lasting, 1, MISSED_AS) != label)


@pytest.mark.parametrize("label", [Label.SEABED, Label.TARGET])
@pytest.mark.parametrize(
    ("metres", "share"),
    [(1.0, 0.02), (2.0, 0.02), (3.5, 0.06), (5.0, 0.1), (6.5, 0.175), (8.0, 0.25), (12.0, 0.25)],
)
def test_the_share_that_is_wrong_is_that_of_the_distance(label: Label, metres: float, share: float) -> None:
    shares = np.array(
        [around(metres, (29.0 * k, 31.0 * (k % 7), -25.0 * (k % 3)), label).mean() for k in range(150)]
    )
    # Views this far apart share no ball.
    assert abs(shares.mean() - share) < 4.0 * shares.std() / math.sqrt(len(shares))
    assert shares.std() / math.sqrt(len(shares)) < 0.01


def test_a_share_of_what_stands_upright_is_the_same() -> None:
    ahead = SE3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
    flat = replace(LASTING, labels=((1.0, 0.2),))
    shares = []
    for k in range(150):
        pose = SE3(ahead.rotation, np.array([23.0 * k, 0.0, 0.0]))
        frame = showing(np.full((COARSE.height, COARSE.width), 6.0), Label.TARGET)
        shares.append((with_wrong_labels(frame, COARSE, pose, flat, 1, MISSED_AS) != Label.TARGET).mean())
    assert abs(np.mean(shares) - 0.2) < 4.0 * np.std(shares) / math.sqrt(len(shares))


def test_what_is_taken_for_what() -> None:
    at = np.full(SHAPE, 8.0)
    pose = SE3.level(0.0, 0.0, 0.0, 0.0) @ DREAM_V2.T_base_camera
    for label in (Label.SEABED, Label.OBSTACLE):
        found = with_wrong_labels(showing(at, label), CAMERA, pose, LASTING, 1, MISSED_AS)
        assert set(np.unique(found)) == {label, Label.TARGET}
    for missed_as in (Label.SEABED, Label.OBSTACLE):
        frame = replace(showing(at, Label.TARGET), ids=np.full(at.shape, 2, np.int32))
        kinds = np.array([Label.WATER, Label.WATER, missed_as], np.uint8)
        found = with_wrong_labels(frame, CAMERA, pose, LASTING, 1, kinds)
        assert set(np.unique(found)) == {Label.TARGET, missed_as}


def test_where_nothing_returns_there_is_nothing_to_be_wrong_about() -> None:
    frame = showing(np.full(SHAPE, np.nan), Label.WATER)
    pose = SE3.level(0.0, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(with_wrong_labels(frame, CAMERA, pose, LASTING, 1, MISSED_AS), frame.labels)


@pytest.mark.parametrize("label", [Label.SEABED, Label.TARGET])
def test_what_is_wrong_from_near_by_is_wrong_from_farther_away(label: Label) -> None:
    last: Wrong = np.zeros(SHAPE, np.bool_)
    for share in (0.02, 0.1, 0.175, 0.25):
        # The share of every distance is set in turn, so that the pixels show the same places.
        scale = replace(LASTING, labels=((1.0, share), (90.0, share), (91.0, 0.25)))
        wrong = below(20.0, scale, label)
        assert not (last & ~wrong).any()
        assert last.sum() < wrong.sum()
        last = wrong


def test_the_same_places_are_wrong_seen_from_elsewhere() -> None:
    flat = replace(LASTING, labels=((1.0, 0.2),))
    height, pitch = 8.0, 8.0 / CAMERA.fx
    first = below(height, flat)
    assert 0.02 < first.mean() < 0.6
    # 40 pixels to the east, and turned by half a turn.
    np.testing.assert_array_equal(below(height, flat, x=40 * pitch)[:, :-40], first[:, 40:])
    np.testing.assert_array_equal(below(height, flat, turn=math.pi)[::-1, ::-1], first)
    # From half as high the middle shows the same ground with twice the pixels.
    closer = below(0.5 * height, flat)
    both = closer[::2, ::2] == first[60:180, 80:240]
    assert both.mean() > 0.97


def test_other_missions_err_elsewhere() -> None:
    wrong = [around(8.0, (0.0, 0.0, -9.0), Label.SEABED, key) for key in (1, 2, 1)]
    np.testing.assert_array_equal(wrong[0], wrong[2])
    assert (wrong[0] != wrong[1]).mean() > 0.1


def test_a_target_and_the_seabed_are_not_wrong_together() -> None:
    flat = replace(LASTING, labels=((1.0, 0.25),))
    both = [below(15.0, flat, label) for label in (Label.SEABED, Label.TARGET)]
    shared = (both[0] & both[1]).mean()
    assert shared < 0.5 * min(wrong.mean() for wrong in both)
    np.testing.assert_array_equal(below(15.0, flat, Label.OBSTACLE), both[0])


def test_patches_are_as_wide_as_they_should_be() -> None:
    # So few that they hardly ever meet.
    few = replace(LASTING, labels=((1.0, 0.01),))
    pitch, widths, areas = 6.0 / COARSE.fx, [], []
    for k in range(300):
        pieces, _ = ndimage.label(below(6.0, few, x=40.0 * k, camera=COARSE))
        for rows, cols in ndimage.find_objects(pieces):
            if rows.start and cols.start and rows.stop < COARSE.height and cols.stop < COARSE.width:
                widths.append(max(rows.stop - rows.start, cols.stop - cols.start) * pitch)
                areas.append((pieces[rows, cols] > 0).sum() * pitch * pitch)
    width, area = np.array(widths), np.array(areas)
    # A ball shows its cut: some are narrow, but make up little of what is wrong. Some meet after all.
    assert len(width) > 150
    assert 0.8 < np.median(width) < 1.5
    assert area[width < 0.5].sum() < 0.05 * area.sum()
    assert area[width > 2.25].sum() < 0.2 * area.sum()
    # Patches, not threads.
    assert area.sum() / np.square(width).sum() > 0.5


def test_without_any_share_nothing_is_wrong() -> None:
    for none in ((), ((2.0, 0.0),)):
        assert not below(8.0, replace(LASTING, labels=none)).any()


def mixed(x: int) -> int:
    """SplitMix64's output function, in whole numbers of Python."""
    x = (x ^ x >> 30) * 0xBF58476D1CE4E5B9 & WORD
    x = (x ^ x >> 27) * 0x94D049BB133111EB & WORD
    return x ^ x >> 31


def balls(
    lasting: LastingErrors, key: int, kind: int, low: list[int], past: list[int]
) -> npt.NDArray[np.float64]:
    """(n, 5) middle, radius and least share of each ball whose middle is in a box of cells."""
    (least, greatest), densest = lasting.blob, max(share for _, share in lasting.labels)
    widths = np.linspace(least, greatest, 20001)
    mean = -math.log(1.0 - densest) / np.mean(math.pi / 6.0 * widths**3) * greatest**3
    cumulative = stats.poisson.cdf(np.arange(200), mean)
    found = []
    for cell in itertools.product(*map(range, low, past)):
        state = key + kind
        for step in cell:
            state = mixed((state + step + GOLDEN) & WORD)
        numbers = ((mixed((state + n * GOLDEN) & WORD) >> 11) / 2.0**53 for n in itertools.count(1))
        for _ in range(int(np.searchsorted(cumulative, next(numbers), side="right"))):
            middle = [(a + next(numbers)) * greatest for a in cell]
            radius = 0.5 * (least + (greatest - least) * next(numbers))
            found.append([*middle, radius, 1.0 - (1.0 - densest) ** next(numbers)])
    return np.array(found).reshape(-1, 5)


# A narrow view is of few cells, whose balls are mostly of those around.
@pytest.mark.parametrize("fov", [20.0, 90.0])
@pytest.mark.parametrize(("label", "densest"), [(Label.SEABED, 0.25), (Label.TARGET, 0.6)])
@pytest.mark.parametrize("x", [3.1, -17.4, 40.2])
def test_the_kernel_finds_what_all_balls_cover(label: Label, densest: float, x: float, fov: float) -> None:
    lasting = replace(LASTING, labels=((2.0, 0.02), (5.0, 0.1), (8.0, densest)))
    key, place = 77, np.array([x, -2.2, -8.0])
    pose = SE3.level(x, -2.2, -8.0, 0.1 * x) @ DREAM_V2.T_base_camera
    camera = Camera.from_fov(24, 18, math.radians(fov))
    rows, cols = np.indices((camera.height, camera.width))
    # Steps in depth, so that rows end in the middle of cells.
    frame = showing(3.5 + (rows % 7) * 0.5 + (cols % 5) * 0.5, label)
    wrong = with_wrong_labels(frame, camera, pose, lasting, key, MISSED_AS) != label

    points = camera.back_project(frame.depth, pose).reshape(-1, 3)
    shares = np.interp(np.linalg.norm(points - place, axis=1), *np.array(lasting.labels).T)
    a, b, c = points.T
    sway, wave = 0.25 * lasting.blob[0], 2.5 * lasting.blob[0]
    a = a + sway * parabolas((0.93 * b + 0.67 * c) / wave)
    b = b + sway * parabolas((1.12 * a - 0.81 * c) / wave)
    c = c + sway * parabolas((0.74 * a + 0.98 * b) / wave)
    swayed = np.stack([a, b, c], axis=1)
    side = lasting.blob[1]
    low = np.floor(swayed.min(axis=0) / side).astype(int) - 2
    past = np.floor(swayed.max(axis=0) / side).astype(int) + 3
    expected = np.zeros(len(points), np.bool_)
    for ball in balls(lasting, key, int(label == Label.TARGET), low.tolist(), past.tolist()):
        expected |= (np.linalg.norm(swayed - ball[:3], axis=1) < ball[3]) & (ball[4] < shares)
    assert 0.0 < expected.mean() < 1.0
    np.testing.assert_array_equal(wrong.ravel(), expected)


def parabolas(t: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Of period 1 and within ±1, as minus a sine."""
    u = np.mod(t, 1.0)
    return np.where(u < 0.5, -16.0 * u * (0.5 - u), 16.0 * (u - 0.5) * (1.0 - u))


def test_a_share_below_the_greatest_is_as_exact_as_that() -> None:
    sparse = replace(LASTING, labels=((1.0, 0.5), (90.0, 0.5), (91.0, 0.9)))
    shares = np.array([below(6.0, sparse, x=37.0 * k, camera=COARSE).mean() for k in range(60)])
    assert abs(shares.mean() - 0.5) < 4.0 * shares.std() / math.sqrt(len(shares))


@pytest.mark.parametrize(("share", "blob"), [(0.9, (0.2, 0.2)), (0.9, (1.0, 5.0)), (0.5, (0.2, 2.0))])
def test_shares_hold_of_other_widths(share: float, blob: tuple[float, float]) -> None:
    other = replace(LASTING, labels=((1.0, share),), blob=blob)
    height = 3.0 * blob[1]
    shares = np.array([below(height, other, x=37.0 * k, camera=COARSE).mean() for k in range(60)])
    assert abs(shares.mean() - share) < 4.0 * shares.std() / math.sqrt(len(shares)) + 1e-3


# ------------------------------------------------------------------------------------- once a mission


def drawn(count: int, lasting: LastingErrors = LASTING) -> list[MissionErrors]:
    world = made("reef/string")
    return [mission_errors(replace(world, seed=seed), SE2(1.0, 2.0, 0.0), lasting) for seed in range(count)]


@pytest.mark.parametrize("name", ["depth", "height", "tilt"])
def test_each_scale_is_off_evenly_between_both_signs(name: str) -> None:
    most = getattr(LASTING, name)
    shares = np.array([getattr(errors, name) for errors in drawn(400)]) / most
    assert -1.0 <= shares.min() < -0.97
    assert 0.97 < shares.max() < 1.0
    assert abs(shares.mean()) < 4.0 / math.sqrt(3.0 * len(shares))
    assert abs((np.abs(shares) < 0.5).mean() - 0.5) < 4.0 * 0.5 / math.sqrt(len(shares))


def test_scales_are_off_independently() -> None:
    table = np.array([(e.depth, e.height, e.tilt) for e in drawn(400)])
    off_diagonal = np.abs(np.corrcoef(table.T) - np.eye(3))
    assert off_diagonal.max() < 4.0 / math.sqrt(len(table))


@pytest.mark.parametrize("off", ["depth", "height", "tilt"])
def test_one_that_is_switched_off_is_zero_and_the_others_stay(off: str) -> None:
    none: dict[str, Any] = {off: 0.0}
    all_of, rest = drawn(1)[0], drawn(1, replace(LASTING, **none))[0]
    assert rest == replace(all_of, **none)
    assert getattr(all_of, off) != 0.0


def test_a_mission_errs_alike_when_flown_again_and_others_err_otherwise() -> None:
    world, start = made("reef/string"), SE2(1.5, -2.0, 0.0)
    missions = [
        (world, start),
        (world, SE2(2.0, -2.0, 0.0)),
        (world, SE2(1.5, -2.0, 0.5)),
        (replace(world, seed=2), start),
        (replace(world, name="reef/patch"), start),
    ]
    errors = [mission_errors(*mission, LASTING) for mission in missions]
    assert errors == [mission_errors(*mission, LASTING) for mission in missions]
    assert len({e.key for e in errors}) == len({e.depth for e in errors}) == len(missions)


def test_what_is_drawn_is_the_same_for_ever() -> None:
    errors = mission_errors(made("reef/string"), SE2(1.5, -2.0, 0.0), LASTING)
    assert errors == MissionErrors(
        depth=0.0017963875695873044,
        height=-0.005459843813952259,
        tilt=0.006603379718525697,
        key=714905159004146,
    )
    wrong = around(8.0, (1.0, 2.0, -9.0), Label.SEABED, errors.key)
    assert wrong.sum() == 1378
    assert np.flatnonzero(wrong)[::300].tolist() == [26, 1103, 2344, 3277, 4183]
