"""A lens's pictures become a pinhole camera's, and files that cannot be a lens are named."""

import gzip
import json
from pathlib import Path
from textwrap import dedent

import cv2
import numpy as np
import pytest

from dream.geometry import Camera
from dream.robots.bluerov2.lens import WATER_INDEX, Calibrated, Lens, Rectifier, in_air

MATRIX = np.array([[330.0, 0.0, 325.0], [0.0, 332.0, 236.0], [0.0, 0.0, 1.0]])
BARREL = np.array([-0.22, 0.06, 0.001, -0.0008, -0.006])
FISHEYE = np.array([0.05, -0.02, 0.004, -0.001])
CAMERA = Camera.from_fov(320, 240, np.pi / 2)


def lens(
    distortion: np.ndarray = BARREL, *, fisheye: bool = False, where: Calibrated = Calibrated.WATER
) -> Lens:
    return Lens(640, 480, MATRIX, distortion, fisheye, where)


LENSES = [
    lens(),
    lens(np.zeros(4)),
    lens(np.array([0.1, 0.02, 0.0, 0.0, 0.001, 0.3, 0.05, 0.002])),
    lens(FISHEYE, fisheye=True),
    lens(where=Calibrated.AIR_FLAT_PORT),
    lens(FISHEYE, fisheye=True, where=Calibrated.AIR_FLAT_PORT),
    lens(where=Calibrated.AIR_DOME_PORT),
]


def as_seen(x: float, y: float, seen_by: Lens) -> np.ndarray:
    """The pixel of one ray, step by step: refraction, then the model of OpenCV's manual."""
    if seen_by.calibrated is Calibrated.AIR_FLAT_PORT:
        direction = np.array([x, y, 1.0]) / np.sqrt(x * x + y * y + 1.0)
        sideways = WATER_INDEX * direction[:2]
        x, y = sideways / np.sqrt(1.0 - sideways @ sideways)
    k = np.pad(seen_by.distortion, (0, 12 - len(seen_by.distortion)))
    r = np.hypot(x, y)
    if seen_by.fisheye:
        angle = np.arctan(r)
        factor = angle * (1 + k[0] * angle**2 + k[1] * angle**4 + k[2] * angle**6 + k[3] * angle**8) / r
        x, y = x * factor, y * factor
    else:
        r2 = r * r
        radial = (1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3) / (1 + k[5] * r2 + k[6] * r2**2 + k[7] * r2**3)
        x, y = (
            x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
            y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
        )
    fx, fy, cx, cy = seen_by.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
    return np.array([fx * x + cx, fy * y + cy])


def painted(seen_by: Lens, spots: np.ndarray) -> np.ndarray:
    """What the lens sees of small round white spots in these directions, (n, 2)."""
    rows, cols = np.mgrid[: seen_by.height, : seen_by.width]
    picture = np.zeros((seen_by.height, seen_by.width))
    for x, y in spots:
        u, v = as_seen(x, y, seen_by)
        picture += np.exp(-((cols - u) ** 2 + (rows - v) ** 2) / (2 * 2.0**2))
    return np.repeat(np.round(255 * np.clip(picture, 0, 1)).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("seen_by", LENSES)
def test_rays_land_where_the_model_says(seen_by: Lens) -> None:
    rng = np.random.default_rng(0)
    rays = rng.uniform(-0.5, 0.5, (40, 2))
    want = np.array([as_seen(x, y, seen_by) for x, y in rays])
    assert np.abs(seen_by.pixels(rays) - want).max() < 1e-6


@pytest.mark.parametrize("seen_by", [lens(np.linspace(0.03, -0.02, count)) for count in (4, 5, 8, 12, 14)])
def test_without_refraction_rays_land_where_opencv_says(seen_by: Lens) -> None:
    rays = np.random.default_rng(2).uniform(-0.8, 0.8, (50, 2))
    points = np.concatenate([rays, np.ones((50, 1))], axis=1)
    want, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), seen_by.matrix, seen_by.distortion)
    assert np.abs(seen_by.pixels(rays) - want[:, 0]).max() < 1e-6


def test_rays_of_a_fisheye_land_where_opencv_says() -> None:
    rays = np.concatenate([np.random.default_rng(2).uniform(-3.0, 3.0, (50, 2)), [[0.0, 0.0]]])
    points = np.concatenate([rays, np.ones((51, 1))], axis=1)[None]
    want, _ = cv2.fisheye.projectPoints(points, np.zeros((3, 1)), np.zeros((3, 1)), MATRIX, FISHEYE)
    assert np.abs(lens(FISHEYE, fisheye=True).pixels(rays) - want[0]).max() < 1e-6


@pytest.mark.few(3)
@pytest.mark.parametrize("seen_by", LENSES)
@pytest.mark.parametrize("factor", [1, 2])
def test_a_distorted_grid_becomes_straight(seen_by: Lens, factor: int) -> None:
    camera = CAMERA.scaled(factor)
    grid = np.stack(np.meshgrid(np.linspace(-0.45, 0.45, 5), np.linspace(-0.36, 0.36, 4)), axis=-1)
    picture = Rectifier(seen_by, camera).rectified(painted(seen_by, grid.reshape(-1, 2)))
    bright = picture[..., 0].astype(float)
    for x, y in grid.reshape(-1, 2):
        u, v = camera.fx * x + camera.cx, camera.fy * y + camera.cy
        row, col = int(v), int(u)
        window = bright[row - 8 : row + 9, col - 8 : col + 9]
        rows, cols = np.mgrid[row - 8 : row + 9, col - 8 : col + 9] + 0.5
        found = np.array([(window * cols).sum(), (window * rows).sum()]) / window.sum()
        assert np.abs(found - [u, v]).max() < 0.5


def test_in_water_the_focal_length_of_a_flat_port_grows_by_the_index() -> None:
    air, water = lens(np.zeros(4), where=Calibrated.AIR_FLAT_PORT), lens(np.zeros(4))
    small = np.array([[1e-4, 0.0], [0.0, 1e-4]])
    centre = MATRIX[:2, 2]
    ratio = np.diag(air.pixels(small) - centre) / np.diag(water.pixels(small) - centre)
    assert ratio == pytest.approx([WATER_INDEX] * 2, rel=1e-6)


def test_rays_bend_by_snells_law() -> None:
    angles = np.radians([5.0, 20.0, 40.0, 48.0])
    rays = np.stack([0.6 * np.tan(angles), 0.8 * np.tan(angles)], axis=-1)
    bent = np.arctan(np.linalg.norm(in_air(rays), axis=-1))
    assert np.sin(bent) == pytest.approx(WATER_INDEX * np.sin(angles))
    assert in_air(rays)[:, 0] / in_air(rays)[:, 1] == pytest.approx(0.75)
    assert np.isnan(in_air(np.tan(np.radians([[48.7, 0.0]])))).all()


def test_what_the_lens_does_not_see_is_masked_and_black() -> None:
    narrow = Lens(
        640,
        480,
        np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]),
        np.zeros(4),
        False,
        Calibrated.WATER,
    )
    rectifier = Rectifier(narrow, CAMERA)
    picture = rectifier.rectified(np.full((480, 640, 3), 200, np.uint8))
    assert np.array_equal(picture[..., 0] == 200, rectifier.seen)
    assert (picture[~rectifier.seen] == 0).all()
    # It sees 320 / 600 to each side, of the 1 that the camera looks.
    assert rectifier.seen[120].sum() == pytest.approx(2 * 160 * 320 / 600, abs=3)
    assert rectifier.seen[:, 160].sum() == pytest.approx(2 * 160 * 240 / 600, abs=3)


def test_no_ray_is_shown_where_the_model_turns_back() -> None:
    """r (1 − 0.3 r²) grows up to r = 1.054 only; what lies further out would be shown a second time."""
    folding = Lens(
        640,
        480,
        np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]]),
        np.array([-0.3, 0, 0, 0]),
        False,
        Calibrated.WATER,
    )
    x = np.array([[1.0, 0.0], [1.04, 0.0], [1.07, 0.0], [1.5, 0.0]])
    assert np.isnan(folding.pixels(x)[:, 0]).tolist() == [False, False, True, True]
    wide = Rectifier(folding, Camera.from_fov(320, 240, 2.2))
    assert not wide.seen[120, 0]
    assert wide.seen[120, 160]


def test_a_stream_of_another_size_shows_the_same_directions() -> None:
    small, rays = lens(), np.random.default_rng(1).uniform(-0.5, 0.5, (20, 2))
    large = small.at(1280, 960)
    assert large.pixels(rays) + 0.5 == pytest.approx(2.0 * (small.pixels(rays) + 0.5))
    with pytest.raises(ValueError, match="1280 x 720"):
        small.at(1280, 720)
    with pytest.raises(ValueError, match=r"rgb: expected \(480, 640, 3\)"):
        Rectifier(small, CAMERA).rectified(np.zeros((960, 1280, 3), np.uint8))


@pytest.mark.parametrize("seen_by", LENSES)
def test_a_lens_is_read_as_it_was_written(tmp_path: Path, seen_by: Lens) -> None:
    path = tmp_path / "lens.yaml"
    seen_by.write(path)
    again = Lens.read(path)
    assert np.array_equal(again.matrix, seen_by.matrix)
    assert np.array_equal(again.distortion, seen_by.distortion)
    assert (again.width, again.height, again.fisheye) == (640, 480, seen_by.fisheye)
    assert again.calibrated is seen_by.calibrated


def test_opencvs_own_calibration_finds_the_lens_that_took_the_pictures(tmp_path: Path) -> None:
    """From points seen by a known lens to a file and back to straight lines."""
    truth = lens(np.array([-0.2, 0.05, 0.0005, -0.0005, 0.0]))
    board = np.concatenate([np.mgrid[0:9, 0:6].T.reshape(-1, 2) * 0.03, np.zeros((54, 1))], axis=1).astype(
        np.float32
    )
    rng = np.random.default_rng(4)
    boards, corners = [], []
    for _ in range(12):
        turn, _ = cv2.Rodrigues(rng.uniform(-0.4, 0.4, 3))
        placed = (board - board.mean(axis=0)) @ turn.T + [
            *rng.uniform(-0.06, 0.06, 2),
            rng.uniform(0.2, 0.35),
        ]
        seen = truth.pixels(placed[:, :2] / placed[:, 2:])
        boards.append(board)
        corners.append(seen.astype(np.float32)[:, None])
    _, matrix, distortion, _, _ = cv2.calibrateCamera(boards, corners, (640, 480), np.eye(3), np.zeros(5))
    found = Lens(640, 480, np.asarray(matrix, float), np.asarray(distortion, float), False, Calibrated.WATER)
    rays = rng.uniform(-0.5, 0.5, (50, 2))
    assert np.abs(found.pixels(rays) - truth.pixels(rays)).max() < 0.5


GOOD = """%YAML:1.0
---
calibrated_in: water
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 330., 0., 325., 0., 332., 236., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.22, 0.06, 0.001, -0.0008, -0.006 ]
"""


def test_a_file_of_opencvs_calibration_is_read(tmp_path: Path) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text(GOOD)
    read = Lens.read(path)
    assert np.array_equal(read.matrix, MATRIX)
    assert not read.fisheye


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (GOOD, "", "expected YAML|missing"),
        (GOOD, "just words", "expected YAML"),
        (GOOD, "%YAML:1.0\n---\na: [", "expected YAML"),
        ("calibrated_in: water\n", "", "calibrated_in is missing"),
        ("water", "soup", "calibrated_in: expected one of water, air_dome_port, air_flat_port, got soup"),
        ("640", "64.5", "image size: expected two whole numbers"),
        ("640", "-640", "image size"),
        ("640", "wide", "image size"),
        ("330.", "0.", "focal lengths"),
        ("330.", ".Nan", "finite"),
        ("325.", "900.", "centre within the picture"),
        ("330., 0.,", "330., 5.,", "fx 0 cx"),
        ("rows: 5", "rows: 3", "distortion_coefficients: expected 3.0 x 1.0 numbers as it says, got 5"),
        (
            "   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.22,",
            "   rows: 6\n   cols: 1\n   dt: d\n   data: [ 0., -0.22,",
            "distortion_coefficients: expected",
        ),
        (
            "calibrated_in: water",
            "calibrated_in: water\nfisheye_model: 1",
            "distortion_coefficients: expected",
        ),
        ("camera_matrix:", "matrix:", "camera_matrix is missing"),
    ],
)
def test_a_file_that_cannot_be_a_lens_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ValueError, match=message) as caught:
        Lens.read(path)
    assert str(path) in str(caught.value)


DISTORTION = GOOD[GOOD.index("distortion_coefficients") :]
ROS = """image_width: 640
image_height: 480
camera_name: low_light
camera_matrix:
  rows: 3
  cols: 3
  data: [330.0, 0.0, 325.0, 0.0, 332.0, 236.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.22, 0.06, 0.001, -0.0008, -0.006]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [310.0, 0.0, 325.0, 0.0, 0.0, 320.0, 236.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
MESSAGE = """header:
  frame_id: camera
height: 480
width: 640
distortion_model: rational_polynomial
d:
- 0.1
- 0.02
- 0.0
- 0.0
- 0.001
- 0.3
- 0.05
- 0.002
k: [330.0, 0.0, 325.0, 0.0, 332.0, 236.0, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""
KALIBR = """cam0:
  T_cam_imu:
  - [0.01, -0.99, 0.004, 0.06]
  - [0.99, 0.01, 0.008, -0.1]
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.22, 0.06, 0.001, -0.0008]
  distortion_model: radtan
  intrinsics: [330.0, 332.0, 325.0, 236.0]
  resolution: [640, 480]
  rostopic: /camera/image_raw
"""
RATIONAL = [0.1, 0.02, 0.0, 0.0, 0.001, 0.3, 0.05, 0.002]


def in_water(text: str) -> str:
    """A file with the line that says where it was calibrated."""
    return text if "calibrated_in" in text or text.startswith("#") else "calibrated_in: water\n" + text


def opencvs(line: str, coefficients: list[float]) -> str:
    """OpenCV's file with one line more, and these coefficients."""
    many = (
        f"   rows: {len(coefficients)}\n   cols: 1\n   dt: d\n   data: {[float(k) for k in coefficients]}\n"
    )
    return GOOD.replace(DISTORTION, f"{line}\ndistortion_coefficients: !!opencv-matrix\n{many}")


@pytest.mark.parametrize(
    ("text", "distortion", "fisheye"),
    [
        (opencvs("distortion_model: equidistant", FISHEYE.tolist()), FISHEYE, True),
        (opencvs("camera_model: Kannala-Brandt", FISHEYE.tolist()), FISHEYE, True),
        (opencvs("lens_type: fisheye", [*FISHEYE, 0.0]), FISHEYE, True),
        (opencvs("fisheye: True", FISHEYE.tolist()), FISHEYE, True),
        (
            opencvs("camera_model: pinhole\ndistortion_model: radial-tangential", BARREL.tolist()),
            BARREL,
            False,
        ),
        (opencvs("fisheye_model: 0", [*RATIONAL, *[0.0] * 6]), [*RATIONAL, *[0.0] * 6], False),
        (
            opencvs("", [*RATIONAL, 0.001, 0.0, -0.002, 0.0, 0.01, -0.02]),
            [*RATIONAL, 0.001, 0, -0.002, 0, 0.01, -0.02],
            False,
        ),
        (opencvs("distortion_model: plumb_bob", [*BARREL, 0.0, 0.0, 0.0]), BARREL, False),
        (opencvs("units: pixels\nbinning_x: 1\nroi: [0, 0, 640, 480]", BARREL.tolist()), BARREL, False),
        (GOOD.replace("camera_matrix", "Camera_Matrix").replace("image_width", "image_Width"), BARREL, False),
        (ROS, BARREL, False),
        (
            ROS.replace("plumb_bob", "equidistant").replace(", -0.006]", "]").replace("cols: 5", "cols: 4"),
            BARREL[:4],
            True,
        ),
        (ROS.replace("[1.0, 0.0, 0.0, 0.0, 1.0", "[0.6, 0.8, 0.0, -0.8, 0.6"), BARREL, False),
        (MESSAGE, RATIONAL, False),
        (MESSAGE.replace("d:\n", "D:\n").replace("k:", "K:"), RATIONAL, False),
        (KALIBR, BARREL[:4], False),
        (KALIBR.replace("radtan", "equidistant"), BARREL[:4], True),
        (KALIBR.replace("radtan", "none").replace("[-0.22, 0.06, 0.001, -0.0008]", "[]"), np.zeros(4), False),
        (dedent(KALIBR.replace("cam0:\n", "")), BARREL[:4], False),
    ],
)
def test_what_a_file_says_of_its_model_is_read(
    tmp_path: Path, text: str, distortion: list[float], fisheye: bool
) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text(in_water(text))
    read = Lens.read(path)
    assert (read.width, read.height, read.fisheye) == (640, 480, fisheye)
    assert np.array_equal(read.matrix, MATRIX)
    assert np.array_equal(read.distortion, distortion)


def test_python_s_own_json_is_read(tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    content = {"calibrated_in": "water", "image_width": 640, "image_height": 480, "fisheye": False}
    content |= {"camera_matrix": MATRIX.tolist(), "distortion_coefficients": [BARREL.tolist()]}
    path.write_text(json.dumps(content))
    assert np.array_equal(Lens.read(path).distortion, BARREL)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            ROS,
            r"calibrated_in is missing. This is ROS's camera_info, which is read with one line more.*water",
        ),
        (MESSAGE, r"calibrated_in is missing. This is ROS's message CameraInfo"),
        (KALIBR, r"calibrated_in is missing. This is Kalibr's camchain"),
        (opencvs("distortion_model: omni", [0.1] * 4), "distortion_model: expected pinhole.*got 'omni'.*cv2"),
        (
            opencvs("distortion_model: double_sphere", [0.1] * 4),
            "distortion_model: expected .*'double_sphere'",
        ),
        (opencvs("model: 7", [0.1] * 4), "model: expected pinhole, .*got 7.0"),
        (
            opencvs("camera_model: GoPro Hero", [0.1] * 4),
            "camera_model: .*name of the camera goes under camera_name",
        ),
        (
            opencvs("distortion_model: equidistant\nfisheye_model: 0", [0.1] * 4),
            "expected one lens model, got",
        ),
        (
            opencvs("distortion_model: equidistant", BARREL.tolist()),
            "expected 4 finite numbers of distortion_model",
        ),
        (
            opencvs("distortion_model: plumb_bob", RATIONAL),
            "expected 4 or 5 finite numbers of distortion_model",
        ),
        (opencvs("distortion_model: rational_polynomial", BARREL.tolist()), "expected 8 or 12 or 14 finite"),
        (opencvs("fisheye_model: perhaps", BARREL.tolist()), "fisheye_model: expected 1 for a fisheye or 0"),
        (opencvs("binning_x: 2\nbinning_y: 2", BARREL.tolist()), "binning_x: expected 1.*got 2"),
        (opencvs("scale: 0.5", BARREL.tolist()), "scale: expected 1"),
        (opencvs("xi: 1.2", BARREL.tolist()), "xi: expected 0, got 1.2"),
        (opencvs("rectified: true", BARREL.tolist()), "rectified: expected 0"),
        (opencvs("units: mm", BARREL.tolist()), "units: expected pixels, got 'mm'"),
        (opencvs("roi: [100, 0, 540, 480]", BARREL.tolist()), "roi: expected the whole picture"),
        (
            MESSAGE.replace("x_offset: 0", "x_offset: 8").replace("width: 0", "width: 99"),
            "roi: expected the whole",
        ),
        (
            opencvs("resolution: [1280, 960]", BARREL.tolist()),
            "resolution: expected 640 x 480 as the file says",
        ),
        (
            KALIBR.replace("pinhole", "omni"),
            "Kalibr's camchain: camera_model: expected pinhole, got 'omni'. Run",
        ),
        (KALIBR + KALIBR.replace("cam0", "cam1"), "expected one camera, got cam0, cam1"),
        (
            KALIBR.replace("resolution: [640, 480]", "resolution: [640]"),
            "image_width, image_height is missing",
        ),
        ("M1: [1]\nD1: [2]\n", "camera_matrix.*is missing.*holds calibrated_in, m1, d1"),
        ("# none\n- 1\n- 2\n", "fields by their names such as"),
        ("# oST version 5.0 parameters\n\n[image]\n", "ost.yaml that lies beside it"),
    ],
)
def test_what_no_lens_here_has_is_refused_by_its_name(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text(text if "is missing. This" in message else in_water(text))
    with pytest.raises(ValueError, match=message) as caught:
        Lens.read(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


def test_whatever_stands_in_a_file_it_is_a_lens_or_refused_in_a_line(tmp_path: Path) -> None:
    """Bytes that are cut, repeated, swapped and made up, by a seed."""
    rng, path = np.random.default_rng(39), tmp_path / "lens.yaml"
    words = [
        b"equidistant",
        b"1e999",
        b"-",
        b"[",
        b"]",
        b"{",
        b"}",
        b": ",
        b"\n",
        b"\n- ",
        b"!!opencv-matrix",
        b"\xff",
    ]
    words += [
        b"rows: 99999999",
        b"cam0:",
        b"fisheye_model: 1",
        b"&a *a",
        b"%YAML",
        b"---\n",
        b"nan",
        b"<",
        b"\t",
        b"'",
    ]
    texts = [text.encode() for text in (GOOD, in_water(ROS), MESSAGE, in_water(KALIBR))]
    told = []
    for _ in range(160):
        content = bytearray(texts[rng.integers(len(texts))])
        for _ in range(rng.integers(1, 4)):
            at, wide = int(rng.integers(len(content) + 1)), int(rng.integers(12))
            content[at : at + wide] = words[rng.integers(len(words))] if rng.random() < 0.7 else b""
        path.write_bytes(content)
        try:
            seen = Lens.read(path)
        except ValueError as error:
            told.append(str(error))
        else:
            assert np.isfinite(seen.distortion).all()
    assert 0 < len(told) < 160
    assert not any("\n" in line or len(line) > 1000 for line in told)


CLEAN = opencvs("fisheye_model: 0", BARREL.tolist())


@pytest.mark.parametrize(
    "content",
    [
        CLEAN.replace("calibrated_in", "# F\xf6rde, gemessen\ncalibrated_in").encode("latin-1"),
        CLEAN.replace("fisheye_model: 0", 'place: "K\xf6ln"').encode("latin-1"),
        CLEAN.replace("fisheye_model: 0", "place: \u5357\u6d77").encode("gb18030"),
        CLEAN.replace("\n", "\r\n").encode(),
        (b"\xef\xbb\xbf" + ROS.encode()).replace(b"\n", b"\r\n"),
        KALIBR.replace("\n", "\r\n").encode(),
        CLEAN.replace("fisheye_model: 0", "note: %done").encode(),
        CLEAN.replace("fisheye_model: 0", "note: @cam").encode(),
        CLEAN.replace("fisheye_model: 0", "note: camera: front").replace("\n", "\r\n").encode(),
        CLEAN.replace("fisheye_model: 0", "note: `a\nby: @me\nfisheye_model: 0\nof: a: b").encode(),
        CLEAN.replace("fisheye_model: 0", 'model: "exploreHD 3.0"\nfisheye_model: 0').encode(),
        CLEAN.replace("fisheye_model: 0", "camera_type: usb\ndistortion_model: plumb_bob").encode(),
        CLEAN.replace("fisheye_model: 0", "model_type: Low-Light\ncamera_model: pinhole").encode(),
        CLEAN.replace(
            "fisheye_model: 0", f"image_points: !!opencv-matrix\n   data: [ {'1.5e+02, ' * 99999}1. ]"
        ).encode(),
        CLEAN.encode() + b"views:\n" + b"   - [ 1., 2. ]\n" * 60000,
        CLEAN.encode() + b"names:\n" + b"- a.png\n" * 99999,
    ],
)
def test_what_no_lens_needs_is_passed_over_however_it_is_written(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "lens.yaml"
    path.write_bytes(
        content if b"calibrated_in" in content else in_water(content.decode("utf-8-sig")).encode()
    )
    read = Lens.read(path)
    assert not read.fisheye
    assert read.distortion.tolist() in (BARREL.tolist(), BARREL[:4].tolist())


def test_long_json_is_read(tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    content = {"calibrated_in": "water", "image_width": 640, "image_height": 480, "model": True, "fisheye": 1}
    content |= {"camera_matrix": MATRIX.tolist(), "distortion_coefficients": FISHEYE.tolist()}
    path.write_text(json.dumps(content | {"model": None, "image_points": [[1.5, 2.5]] * 20000}, indent="\t"))
    assert path.stat().st_size > 256 << 10
    assert np.array_equal(Lens.read(path).distortion, FISHEYE)
    path.write_text(json.dumps(content)[:-1] + ', "fisheye": 0}')
    with pytest.raises(ValueError, match="'fisheye': expected once, got twice"):
        Lens.read(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CLEAN + "fisheye_model: 1\n", "'fisheye_model': expected once, got twice. Delete"),
        (ROS + "Image_Width: 640\n", "'Image_Width': expected once, got twice"),
        (KALIBR + "  distortion_model: equidistant\n", "'distortion_model': expected once, got twice"),
        (
            CLEAN.replace("fisheye_model: 0", "fisheye_model: @cam"),
            "expected YAML as OpenCV writes it: .* in line",
        ),
        (
            CLEAN.replace("fisheye_model: 0", "fisheye_model: a: b"),
            "expected YAML as OpenCV writes it: .* in line",
        ),
        (
            CLEAN.replace("fisheye_model: 0", "model: omni\nfisheye_model: 0"),
            "^[^ ]*: model: expected pinhole",
        ),
        (CLEAN.replace("fisheye_model: 0", "model: exploreHD"), "model: expected pinhole.*got 'exploreHD'"),
        (CLEAN.replace("fisheye_model: 0", "fisheye_mod\xf6l: 1"), "expected names of fields in UTF-8"),
        (CLEAN.replace("fisheye_model: 0", "scale: 1\n" + "# x\n" * 20000), "at most 32768 characters"),
        ("[" * 20000, "nests too deeply"),
        ("<calibrated_in>" + "<!--" * 250000, "it holds declarations"),
        ("calibrated_in: " + "[" * 20000, "nests too deeply"),
    ],
)
def test_what_a_lens_needs_is_refused_where_it_cannot_be_sure(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "lens.yaml"
    path.write_bytes(in_water(text).encode("latin-1"))
    with pytest.raises(ValueError, match=message) as caught:
        Lens.read(path)
    assert len(str(caught.value)) < 700


def test_a_file_that_is_compressed_is_to_be_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "lens.yml.gz"
    path.write_bytes(gzip.compress(GOOD.encode()))
    with pytest.raises(ValueError, match=r"got it compressed.* Unpack it with gunzip"):
        Lens.read(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"lens.yaml.*Calibrate"):
        Lens.read(tmp_path / "lens.yaml")
    (tmp_path / "large.yaml").write_bytes(b"#" * (2 << 20))
    with pytest.raises(ValueError, match="at most"):
        Lens.read(tmp_path / "large.yaml")
