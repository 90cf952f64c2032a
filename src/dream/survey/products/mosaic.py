"""One picture of the sea floor from the frames of a run, seen from straight above, georeferenced.

Each frame's depth image is a surface; it is drawn from above with the frame's colours on it. Where frames
overlap, the nearest and steepest view dominates. Colours are as the camera saw them: water dims and tints
what is far, so that the brightness follows the track. Poses are those that the vehicle believed; their errors
are in the picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.protocol import PROTOCOLS
from dream.robots import replay
from dream.survey.products import _kernels, geotiff
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.sheet import corners_of
from dream.survey.survey import Survey
from dream.types import Label, Observation, UInt8Array

Float64Array = npt.NDArray[np.float64]

NAME = "mosaic.tif"
LEAST_WEIGHT = 1e-30
SAME_PLACE = 0.1
"""Metres: a frame that was made farther from the track of a survey is of another run."""
SMALL = 1400
"""Cells along the longer side of a mosaic in a report."""


@dataclass(frozen=True, slots=True)
class Mosaic:
    """How the picture is made."""

    cell: float = 0.025
    """Metres."""
    reach: float = 8.0
    """Metres over ground; what is farther from the camera is left out."""
    sharpness: float = 3.0
    """How much better views outweigh others: weights are (pixels per m²) to this power."""
    margin: float = 0.06
    """Share of the picture's width over which a frame fades out."""
    longest: float = 0.6
    """Metres; neighbouring pixels that are farther apart on the ground lie on two surfaces."""

    def __post_init__(self) -> None:
        for name in ("cell", "reach", "sharpness", "margin", "longest"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise ValueError(f"mosaic: {name}: expected a number above 0, got {getattr(self, name)}")

    def write(
        self,
        survey: Survey,
        run: Path,
        path: Path,
        watched: Callable[[Sequence[Path]], Iterable[Path]] = iter,
    ) -> None:
        """Write the picture as a cloud-optimised GeoTIFF.

        Args:
            survey: Of the run.
            run: Its folder, with the observations that were kept.
            path: Of the file.
            watched: Passes the files of the frames on, and may show how far it is.

        Raises:
            FileNotFoundError: Nothing was kept of the run.
            ValueError: An observation is damaged or of another run, or the survey has no origin.
            OSError: It cannot be written.
        """
        ground = Ground(site_of(survey))
        files = sorted((run / replay.FOLDER).glob("*.npz"))
        if not files:
            raise FileNotFoundError(
                f"{run}: expected a run with its observations, got no {replay.FOLDER}/*.npz in it. "
                "Fly it with --keep-observations"
            )
        box = survey.layers.bounds
        sheet = geotiff.sheet_around(ground, corners_of(survey.layers.bounds), self.cell)
        plan = _Plan(sheet, ground, box)
        frames = (_of(survey, replay.read(file).observation, file) for file in watched(files))
        picture, mask = self.paint(frames, plan.to_cells, (sheet.rows, sheet.cols))
        geotiff.write_cog(
            path,
            np.ascontiguousarray(picture.transpose(2, 0, 1)),
            sheet,
            ground,
            nodata=None,
            descriptions=("red", "green", "blue"),
            tags=geotiff.tags_of(survey, "the sea floor as the camera saw it, from above"),
            mask=mask,
        )

    def paint(
        self,
        frames: Iterable[Observation],
        to_cells: Callable[[Float64Array], Float64Array],
        shape: tuple[int, int],
    ) -> tuple[UInt8Array, npt.NDArray[np.bool_]]:
        """Put frames together.

        Args:
            frames: With their poses.
            to_cells: Takes (..., 2) points of the world to column and row of the plan, fractional.
            shape: (rows, cols) of the plan.

        Returns:
            (rows, cols, 3) colours, and (rows, cols) where there are any.
        """
        color, weight = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
        for seen in frames:
            points, good = self._surface(seen)
            cells = to_cells(points)
            # Pixels per cell, not per m², keeps the sums near 1.
            _kernels.paint(
                cells,
                good,
                np.ascontiguousarray(seen.rgb),
                self.sharpness,
                self.longest / self.cell,
                self.margin,
                color,
                weight,
            )
        mask = weight > LEAST_WEIGHT
        picture = np.zeros(color.shape, np.uint8)
        picture[mask] = np.clip(np.rint(color[mask] / weight[mask][:, None]), 0, 255).astype(np.uint8)
        return picture, mask

    def _surface(self, seen: Observation) -> tuple[Float64Array, npt.NDArray[np.bool_]]:
        """(H, W, 2) where each pixel's point lies on the ground, and which pixels have one that counts."""
        good = np.isfinite(seen.depth) & (seen.depth > 0.0) & (seen.labels != Label.WATER)
        points = seen.camera.back_project(np.where(good, seen.depth, 1.0), seen.T_world_camera)[..., :2]
        away = np.linalg.norm(points - seen.T_world_camera.translation[:2], axis=-1)
        return np.asarray(points, np.float64), good & (away <= self.reach)


def _of(survey: Survey, seen: Observation, file: Path) -> Observation:
    """The same, once it is sure that it was made on the way that the survey tells."""
    here = seen.T_world_base.translation[:2]
    away = np.linalg.norm(survey.track.position[:, :2] - here, axis=1).min(initial=np.inf)
    if not away <= SAME_PLACE:
        raise ValueError(
            f"{file}: expected a frame of {survey.name}, got one made {away:.2f} m from its track. "
            "Is it the folder of another run?"
        )
    return seen


class _Plan:
    """From the world to the cells of a sheet, by the affine map that is exact in three corners of a box.

    A sheet is not quite an affine image of the world: over a box of 100 m it is so to within a millimetre or
    two.
    """

    def __init__(self, sheet: geotiff.Sheet, ground: Ground, box: Bounds) -> None:
        corners = np.array([(box.x_min, box.y_min), (box.x_max, box.y_min), (box.x_min, box.y_max)])
        easting, northing = ground.sheet(corners[:, 0], corners[:, 1])
        cells = np.column_stack([easting - sheet.west, sheet.north - northing]) / sheet.cell
        along = np.column_stack([(cells[1] - cells[0]) / box.width, (cells[2] - cells[0]) / box.depth])
        self._matrix = along
        self._origin = cells[0] - along @ corners[0]

    def to_cells(self, points: Float64Array) -> Float64Array:
        """(..., 2) column and row of (..., 2) points of the world."""
        cells: Float64Array = points @ self._matrix.T + self._origin
        return cells


def mosaic_for(survey: Survey) -> Mosaic:
    """What suits the protocol of a survey: finer where the camera is nearer."""
    protocol = PROTOCOLS.get(survey.protocol)
    if protocol is None:
        return Mosaic()
    return Mosaic(cell=min(0.025, 0.1 * survey.layers.cell), reach=protocol.reach)


def small(path: Path, ground: Ground) -> tuple[UInt8Array, tuple[float, float, float, float]]:
    """A mosaic at most `SMALL` cells wide and high, for a report.

    Returns:
        (rows, cols, 4) RGBA, the first row in the north; and west, east, south, north in metres of the sheet
        from the origin of the site.
    """
    rasterio = geotiff.import_rasterio()
    east, north = (float(value) for value in ground.sheet(0.0, 0.0))
    with rasterio.open(path) as file:
        shrink = max(1.0, max(file.shape) / SMALL)
        shape = tuple(max(1, round(side / shrink)) for side in file.shape)
        picture = file.read(out_shape=(3, *shape))
        mask = file.dataset_mask(out_shape=shape)
        box = file.bounds
    extent = (box.left - east, box.right - east, box.bottom - north, box.top - north)
    return np.concatenate([picture, mask[None]]).transpose(1, 2, 0), extent
