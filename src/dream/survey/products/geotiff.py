"""The maps of a survey as cloud-optimised GeoTIFFs, north up on the map sheet, with their styles beside them.

A survey is turned against its sheet (by the heading of its site, and because the sheet's north is not the
true one), and many readers of rasters ignore a turned geotransform. So each map is laid on a grid of its own,
north up, with cells of a quarter of the size; each takes the value of the map cell that its middle lies in.
No value is made up between two cells, and an edge moves by at most half of the finer cell's diagonal: 0.04 m
for cells of 0.25 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream import extras
from dream.geometry import Bounds
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.sheet import corners_of
from dream.survey.products.styles import (
    PROBABILITY_COLORS,
    RELIEF_COLORS,
    SEEN_COLORS,
    STATE_COLORS,
    UNKNOWN,
    Ramp,
    colormap,
    palette_qml,
    ramp_qml,
    state_names,
)
from dream.survey.products.words import warning
from dream.survey.survey import Layers, Survey

if TYPE_CHECKING:
    from rasterio.io import DatasetWriter

Float64Array = npt.NDArray[np.float64]

FINER = 4
"""Cells of the sheet along one of the map."""
MOST_CELLS = 100_000_000
"""A larger raster is refused."""
BLOCK = 256
ALONG = 32
"""Points of each side of a box that are followed on the map sheet."""
NAMES = ("habitat.tif", "target_probability.tif", "relief.tif", "times_seen.tif")


@dataclass(frozen=True, slots=True)
class Sheet:
    """A raster, north up, on the map sheet of a site."""

    west: float
    north: float
    """Metres, the outer corner of its first cell."""
    cell: float
    rows: int
    cols: int

    def centres(self) -> tuple[Float64Array, Float64Array]:
        """(rows, cols) easting and northing of the middle of each cell; the first row lies in the north."""
        easting, northing = self.axes()
        shape = (self.rows, self.cols)
        return np.broadcast_to(easting, shape), np.broadcast_to(northing[:, None], shape)

    @property
    def bounds(self) -> Bounds:
        """Metres on the map sheet, to the outer edges of its cells."""
        south, east = self.north - self.rows * self.cell, self.west + self.cols * self.cell
        return Bounds(self.west, south, east, self.north)

    def axes(self) -> tuple[Float64Array, Float64Array]:
        """(cols,) easting and (rows,) northing of the middles of its columns and rows."""
        easting = self.west + self.cell * (np.arange(self.cols, dtype=np.float64) + 0.5)
        northing = self.north - self.cell * (np.arange(self.rows, dtype=np.float64) + 0.5)
        return easting, northing


def sheet_around(ground: Ground, corners: Float64Array, cell: float) -> Sheet:
    """The least raster that holds a convex polygon of the world; its edges lie on whole multiples of `cell`.

    Args:
        ground: Of the site.
        corners: (N, 2) metres; sides between them are straight in the world, and bend on the sheet.
        cell: Metres.

    Raises:
        ValueError: It would be larger than any survey is.
    """
    share = np.linspace(0.0, 1.0, ALONG, endpoint=False)[:, None, None]
    sides = ((1.0 - share) * corners + share * np.roll(corners, -1, axis=0)).reshape(-1, 2)
    easting, northing = ground.sheet(sides[:, 0], sides[:, 1])
    west, south = (math.floor(values.min() / cell + 1e-6) for values in (easting, northing))
    east, north = (math.ceil(values.max() / cell - 1e-6) for values in (easting, northing))
    if (east - west) * (north - south) > MOST_CELLS:
        raise ValueError(
            f"raster: expected at most {MOST_CELLS} cells, "
            f"got {east - west} × {north - south} of {cell:g} m. "
            "Take larger cells"
        )
    return Sheet(west * cell, north * cell, cell, north - south, east - west)


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """Which map cell each cell of a sheet takes its value from."""

    sheet: Sheet
    index: npt.NDArray[np.intp]
    """(rows, cols) into the flattened map; −1 outside."""

    def take(self, values: npt.NDArray[Any], fill: float) -> npt.NDArray[Any]:
        """(rows, cols) of the sheet; `fill` outside the map."""
        return np.where(self.index >= 0, values.ravel()[self.index], np.asarray(fill, values.dtype))


def laid(layers: Layers, ground: Ground) -> Laid:
    """Lay a map on a sheet of its own."""
    sheet = sheet_around(ground, corners_of(layers.bounds), layers.cell / FINER)
    return laid_on(sheet, layers, *ground.world(*sheet.centres()))


def laid_on(sheet: Sheet, layers: Layers, x: Float64Array, y: Float64Array) -> Laid:
    """Lay a map on a sheet.

    Args:
        sheet: The sheet.
        layers: The map.
        x: (rows, cols) metres in the map's world, of the middles of the sheet's cells.
        y: The same.
    """
    rows, cols = layers.state.shape
    col = np.floor((x - layers.bounds.x_min) / layers.cell).astype(np.intp)
    row = np.floor((y - layers.bounds.y_min) / layers.cell).astype(np.intp)
    within = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    return Laid(sheet, np.where(within, row * cols + col, -1))


def write(survey: Survey, folder: Path) -> list[Path]:
    """Write the four maps and their styles: `habitat`, `target_probability`, `relief`, `times_seen`.

    Returns:
        The files, `.tif` and `.qml`.

    Raises:
        ValueError: The survey has no origin.
        OSError: It cannot be written.
    """
    ground = Ground(site_of(survey))
    layers = survey.layers
    on = laid(layers, ground)
    names = state_names(survey.target)
    told = [value for value in names if value in np.unique(layers.state)] or list(names)
    seen_most = max(2, int(layers.times_seen.max(initial=0)))
    relief = layers.relief[np.isfinite(layers.relief)]
    highest = max(0.1, float(np.quantile(relief, 0.99))) if relief.size else 1.0
    times = np.where(layers.state == UNKNOWN, 0, layers.times_seen).astype(np.uint16)
    maps: dict[str, tuple[npt.NDArray[Any], float, str, str, str]] = {
        "habitat": (
            layers.state,
            UNKNOWN,
            "; ".join(f"{value} {name}" for value, name in names.items()),
            "",
            palette_qml({value: names[value] for value in told}, STATE_COLORS),
        ),
        "target_probability": (
            layers.target_probability,
            math.nan,
            "probability of target",
            "1",
            ramp_qml(Ramp(0.0, 1.0, PROBABILITY_COLORS)),
        ),
        "relief": (
            layers.relief,
            math.nan,
            "height above the bare seabed",
            "metre",
            ramp_qml(Ramp(0.0, highest, RELIEF_COLORS, "m")),
        ),
        "times_seen": (
            times,
            0,
            "frames that saw the cell within reach",
            "1",
            ramp_qml(Ramp(1.0, float(seen_most), SEEN_COLORS, "frames")),
        ),
    }
    files = []
    for name, (values, nodata, description, unit, style) in maps.items():
        path, qml = folder / f"{name}.tif", folder / f"{name}.qml"
        write_cog(
            path,
            on.take(values, nodata)[None],
            on.sheet,
            ground,
            nodata=nodata,
            descriptions=(description,),
            unit=unit,
            tags=tags_of(survey, description),
            colors=colormap(STATE_COLORS, list(STATE_COLORS)) if name == "habitat" else None,
        )
        qml.write_text(style, encoding="utf-8")
        files += [path, qml]
    return files


def tags_of(survey: Survey, what: str) -> dict[str, str]:
    """What the header of a file says of its origin."""
    made_up = f"{told}; " if (told := warning(survey)) else ""
    return {
        "TIFFTAG_IMAGEDESCRIPTION": f"{made_up}{site_of(survey).name}, {survey.name}: {what}",
        "TIFFTAG_SOFTWARE": f"DREAM {survey.made_by.get('version', '')}".strip(),
        "TIFFTAG_DATETIME": survey.began.astimezone(UTC).strftime("%Y:%m:%d %H:%M:%S"),
    }


def write_cog(
    path: Path,
    bands: npt.NDArray[Any],
    sheet: Sheet,
    ground: Ground,
    *,
    nodata: float | None,
    descriptions: tuple[str, ...],
    tags: dict[str, str],
    unit: str = "",
    colors: dict[int, tuple[int, int, int, int]] | None = None,
    mask: npt.NDArray[np.bool_] | None = None,
) -> None:
    """Write a cloud-optimised GeoTIFF: tiled, compressed without loss, overviews behind the header.

    Args:
        path: Of the file.
        bands: (B, rows, cols), the first row in the north.
        sheet: Where it lies.
        ground: Of which site.
        nodata: The value of what was not seen; None where `mask` says it.
        descriptions: One a band.
        tags: TIFF tags.
        unit: Of all bands; empty for none.
        colors: RGBA of the values of a single band of classes.
        mask: (rows, cols) where there is data.
    """
    rasterio = import_rasterio()
    from rasterio.enums import ColorInterp
    from rasterio.io import MemoryFile
    from rasterio.shutil import copy

    profile = {
        "driver": "GTiff",
        "width": sheet.cols,
        "height": sheet.rows,
        "count": len(bands),
        "dtype": bands.dtype.name,
        "crs": rasterio.crs.CRS.from_epsg(ground.epsg),
        "transform": rasterio.Affine(sheet.cell, 0.0, sheet.west, 0.0, -sheet.cell, sheet.north),
        "nodata": nodata,
        # Without it three bands of bytes would not be taken as a colour picture.
        "photometric": "RGB" if len(bands) == 3 else "MINISBLACK",
    }
    classes = np.issubdtype(bands.dtype, np.integer) and len(bands) == 1
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True, GDAL_PAM_ENABLED=False),
        MemoryFile() as memory,
    ):
        dataset: DatasetWriter
        with memory.open(**profile) as dataset:
            dataset.write(bands)
            dataset.update_tags(**tags)
            for band, description in enumerate(descriptions, start=1):
                dataset.set_band_description(band, description)
                if unit:
                    dataset.set_band_unit(band, unit)
            if colors is not None:
                dataset.write_colormap(1, colors)
                dataset.colorinterp = (ColorInterp.palette,)
            if mask is not None:
                dataset.write_mask(mask)
        # Closing a file, GDAL cannot report that the disk was full: it writes to memory, and we to the disk.
        with memory.open() as dataset, MemoryFile() as target:
            copy(
                dataset,
                target.name,
                driver="COG",
                blocksize=BLOCK,
                compress="DEFLATE",
                predictor="YES" if colors is None else "NO",
                overview_resampling="MODE" if classes else "AVERAGE",
                overview_count=_overviews(sheet),
            )
            path.write_bytes(target.read())


def _overviews(sheet: Sheet) -> int:
    """Enough that the coarsest fits one tile."""
    return max(0, math.ceil(math.log2(max(sheet.rows, sheet.cols) / BLOCK)))


def check_installed() -> None:
    """Raise a ValueError where what maps need is not installed."""
    extras.check_installed("survey", "maps", "rasterio", "pyproj")


def import_rasterio() -> Any:
    """It is an extra, and slow to import.

    Raises:
        ValueError: It is not installed.
    """
    try:
        import rasterio
        import rasterio.crs
    except ImportError as error:
        raise ValueError(extras.missing("survey", "rasterio", "maps")) from error
    return rasterio
