"""The picture of the sea floor: colours at their place, the better view in front, the kernel's twin."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import Bounds
from dream.robots import replay
from dream.survey.products import _kernels
from dream.survey.products.ground import Ground
from dream.survey.products.mosaic import Mosaic, mosaic_for
from dream.types import Label
from tests.survey.floor import colour, keep_frames, looking_down
from tests.survey.scenes import AREA, SITE, reef

CELL = 0.05


def to_cells(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows grow with y, from the corner of the box."""
    return (points - (AREA.x_min, AREA.y_min)) / CELL


def plan() -> tuple[tuple[int, int], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    shape = (round(AREA.depth / CELL), round(AREA.width / CELL))
    y, x = (np.indices(shape) + 0.5) * CELL
    return shape, x, y


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_every_colour_stands_where_it_is_on_the_floor(scale: int) -> None:
    shape, x, y = plan()
    frames = [looking_down(8.0 + n, 8.0, 2.0 + 0.3 * n, 0.5 * n, scale) for n in range(4)]
    picture, mask = Mosaic(cell=CELL).paint(frames, to_cells, shape)
    assert mask.sum() * CELL**2 > 10.0
    assert np.abs(picture[mask].astype(float) - colour(x, y)[mask]).max() <= 2.0


def test_a_frame_covers_what_its_camera_sees() -> None:
    shape, _, _ = plan()
    _, mask = Mosaic(cell=CELL).paint([looking_down(10.0, 8.0, 2.0)], to_cells, shape)
    width = 2.0 * 2.0 * math.tan(math.radians(35.0))
    # From the middle of the first pixel to that of the last, to half a cell along the edge.
    across, along = width * 47 / 48, 0.75 * width * 35 / 36
    assert mask.sum() * CELL**2 == pytest.approx(across * along, abs=CELL * (across + along))


def test_the_nearer_view_dominates_and_two_alike_blend() -> None:
    shape, x, y = plan()
    near, far = looking_down(10.0, 8.0, 1.0), looking_down(10.0, 8.0, 3.0)
    near.rgb[:], far.rgb[:] = (200, 0, 0), (0, 0, 200)
    picture, _ = Mosaic(cell=CELL).paint([far, near], to_cells, shape)
    middle = np.hypot(x - 10.0, y - 8.0) < 0.3
    assert (picture[middle] == (200, 0, 0)).all(axis=-1).mean() > 0.95
    other = looking_down(10.0, 8.0, 1.0)
    other.rgb[:] = (0, 0, 200)
    picture, _ = Mosaic(cell=CELL).paint([near, other], to_cells, shape)
    assert np.abs(picture[middle].astype(int) - (100, 0, 100)).max() <= 1


def test_water_missing_depth_and_what_is_far_are_left_out() -> None:
    shape, _, _ = plan()
    seen = looking_down(10.0, 8.0, 2.0)
    seen.labels[:, :24] = Label.WATER
    seen.depth[:18] = np.nan
    _, mask = Mosaic(cell=CELL).paint([seen], to_cells, shape)
    _, whole = Mosaic(cell=CELL).paint([looking_down(10.0, 8.0, 2.0)], to_cells, shape)
    assert 0.2 < mask.sum() / whole.sum() < 0.26
    _, near = Mosaic(cell=CELL, reach=0.5).paint([looking_down(10.0, 8.0, 2.0)], to_cells, shape)
    assert near.sum() * CELL**2 == pytest.approx(math.pi * 0.5**2, rel=0.15)


def test_a_step_in_depth_is_no_surface() -> None:
    shape, _, _ = plan()
    seen = looking_down(10.0, 8.0, 2.0)
    seen.depth[:, 24:] = 6.0
    _, mask = Mosaic(cell=CELL, longest=0.3).paint([seen], to_cells, shape)
    _, stretched = Mosaic(cell=CELL, longest=30.0).paint([seen], to_cells, shape)
    assert mask.sum() < stretched.sum()


def test_the_kernel_is_its_slow_twin() -> None:
    rng = np.random.default_rng(3)
    height, width, k, shape = 5, 6, 2, (24, 28)
    even = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1) * 4.0 + 2.0
    points = np.asarray(even + rng.uniform(-0.8, 0.8, even.shape), np.float64)
    good = rng.random((height, width)) < 0.9
    rgb = rng.integers(0, 256, (k * height, k * width, 3), np.uint8)
    color, weight = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    _kernels.paint(points, good, rgb, 2.0, 9.0, 0.3, color, weight)
    slow_color, slow_weight = paint_slowly(points, good, rgb, 2.0, 9.0, 0.3, shape)
    assert weight == pytest.approx(slow_weight, rel=1e-4, abs=1e-9)
    assert color == pytest.approx(slow_color, rel=1e-3, abs=1e-6)
    assert (weight > 0).any()


def paint_slowly(
    points: npt.NDArray[np.float64],
    good: npt.NDArray[np.bool_],
    rgb: npt.NDArray[np.uint8],
    sharpness: float,
    longest: float,
    margin: float,
    shape: tuple[int, int],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Every triangle against every cell."""
    height, width = good.shape
    k = len(rgb) // height
    color, weight = np.zeros((*shape, 3)), np.zeros(shape)
    for v in range(height - 1):
        for u in range(width - 1):
            if not good[v : v + 2, u : u + 2].all():
                continue
            for corner, beside, below in (
                ((v, u), (v, u + 1), (v + 1, u)),
                ((v + 1, u + 1), (v + 1, u), (v, u + 1)),
            ):
                a, b, c = points[corner], points[beside], points[below]
                if max(abs(a - b).max(), abs(a - c).max(), abs(b - c).max()) > longest:
                    continue
                basis = np.column_stack([b - a, c - a])
                edge = min(corner[1], width - 1 - corner[1], corner[0], height - 1 - corner[0]) + 1.0
                gain = (
                    abs(np.linalg.det(basis)) ** -sharpness * min(1.0, edge / max(margin * width, 1.0)) ** 2
                )
                for row, col in np.ndindex(*shape):
                    s, t = np.linalg.solve(basis, (col + 0.5, row + 0.5) - a)
                    if s < 0.0 or t < 0.0 or s + t > 1.0:
                        continue
                    at = np.array(corner) + s * (np.array(beside) - corner) + t * (np.array(below) - corner)
                    fv, fu = (at + 0.5) * k - 0.5
                    iu, iv = min(int(fu), k * width - 2), min(int(fv), k * height - 2)
                    wu, wv = fu - iu, fv - iv
                    square = rgb[iv : iv + 2, iu : iu + 2].astype(float)
                    mixed = np.einsum("v,u,vuc->c", [1.0 - wv, wv], [1.0 - wu, wu], square)
                    color[row, col] += gain * mixed
                    weight[row, col] += gain
    return color, weight


def test_from_a_run_it_lies_on_the_globe(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    pytest.importorskip("pyproj")
    keep_frames(tmp_path)
    path = tmp_path / "mosaic.tif"
    Mosaic(cell=CELL).write(reef(), tmp_path, path)
    x, y = np.array([7.0, 8.3, 10.5]), np.array([8.0, 7.5, 8.4])
    easting, northing = Ground(SITE).sheet(x, y)
    with rasterio.open(path) as file:
        assert file.count == 3
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        found = np.array(list(file.sample(zip(easting, northing, strict=True))))
        (unseen,) = file.sample([Ground(SITE).sheet(1.0, 1.0)], masked=True)
    assert np.abs(found.astype(float) - colour(x, y)).max() <= 2.0
    assert unseen.mask.all()


def test_frames_of_another_run_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    pytest.importorskip("pyproj")
    (tmp_path / replay.FOLDER).mkdir()
    replay.write(tmp_path / replay.FOLDER / "0000.npz", replay.Kept(None, looking_down(7.0, 9.0, 2.0)))
    with pytest.raises(ValueError, match=r"0000.npz: .*1\.00 m from its track"):
        Mosaic(cell=CELL).write(reef(), tmp_path, tmp_path / "mosaic.tif")
    assert not (tmp_path / "mosaic.tif").exists()


def test_without_observations_it_says_how_to_get_them(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    with pytest.raises(FileNotFoundError, match="--keep-observations"):
        Mosaic().write(reef(), tmp_path, tmp_path / "mosaic.tif")
    assert not list(tmp_path.iterdir())


def test_its_parameters_are_checked_and_fit_the_protocol() -> None:
    with pytest.raises(ValueError, match="cell"):
        Mosaic(cell=0.0)
    assert mosaic_for(reef()).reach == 8.0
    pool = replace(
        reef(), protocol="pool-v1", layers=replace(reef().layers, cell=0.05, bounds=Bounds(0, 0, 4, 3.2))
    )
    assert mosaic_for(pool).cell == pytest.approx(0.005)
