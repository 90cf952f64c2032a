"""One survey or several of a site as a netCDF file by the CF conventions 1.8: measures over time, and maps.

The classic format (CDF-2) is written by SciPy and read by everything that reads netCDF. `time` counts the
surveys, one for a single one. Measures are variables over `time`; `NAME_low` and `NAME_high` are the ends of
their 95 % intervals and stand in their `ancillary_variables`. Maps lie north up on the map sheet of the site,
as the GeoTIFFs do.

Site files are corrected over the years, so that surveys of one site may have origins some metres apart. The
reference position is the origin of the survey that is exported, and the maps are of its ground: others are
laid there as what stands on it shows, else as their own site files say.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.survey import globe
from dream.survey.boxes import box
from dream.survey.products import areas, words
from dream.survey.products.geotiff import Laid, Sheet, laid_on, sheet_around
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.series import NONE_OF_THAT_SIZE, of_one_site
from dream.survey.products.sheet import corners_of
from dream.survey.products.styles import EXPLORED, SOLID, SOLID_TARGET, TARGET, UNKNOWN
from dream.survey.registration import Registering, Registration
from dream.survey.sizes import measures_over, size_bin
from dream.survey.survey import Survey
from dream.types import Target

NAME = "survey.nc"
FINER = 2
"""Cells along one of the map: less than a GeoTIFF has, as each also tells its latitude and longitude."""
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MEANINGS = {
    UNKNOWN: "not_seen",
    EXPLORED: "seen_none_found",
    TARGET: "target",
    SOLID: "obstacle",
    SOLID_TARGET: "high_target",
}
LAID_BY = ("", "individuals", "map", "poses")
"""As `Registration.by` has it, after the survey itself."""
FILL = 9.96921e36
"""netCDF's own for floats: CF wants a number, and NaN is not understood everywhere."""
FILL_BYTE, FILL_SHORT = -127, -32767

_UNITS = {"m2": "m2", "1/m2": "m-2", "m": "m", "": "1"}


def write(survey: Survey, path: Path, others: Sequence[Survey] = ()) -> None:
    """Write a survey, and others of its site, in the order of their time.

    Args:
        survey: Whose origin is the reference position, and whose ground the maps are of.
        path: Of the file.
        others: Of the same site.

    Raises:
        ValueError: A survey has no origin, or one is of another site.
        OSError: It cannot be written.
    """
    from scipy.io import netcdf_file

    ground = Ground(site_of(survey))
    surveys, elsewhere = of_one_site(survey, others)
    if elsewhere:
        raise ValueError(f"netCDF: {elsewhere[0]}")
    sheet = sheet_around(ground, corners_of(survey.layers.bounds), survey.layers.cell / FINER)
    lying = [None if one is survey else Registering().register(survey, one) for one in surveys]
    on = _laid(sheet, ground, surveys, lying)
    # Made in memory: SciPy cannot be told to give up where the disk is full.
    content = io.BytesIO()
    with netcdf_file(content, "w", version=2) as file:
        _describe(file, survey, surveys, ground, sheet)
        file.createDimension("time", len(surveys))
        file.createDimension("side", 2)
        file.createDimension("name_length", max(len(survey.name.encode()) for survey in surveys))
        file.createDimension("y", sheet.rows)
        file.createDimension("x", sheet.cols)
        _times(file, surveys)
        _origins(file, surveys, ground)
        _lying(file, ground, lying)
        easting, northing = sheet.axes()
        for name, values, of in (("x", easting, "easting"), ("y", northing, "northing")):
            _variable(
                file,
                name,
                "d",
                (name,),
                values,
                standard_name=f"projection_{name}_coordinate",
                long_name=of,
                units="m",
                axis=name.upper(),
            )
        _grid_mapping(file, ground)
        _globe(file, ground, easting, northing)
        _maps(file, surveys, on)
        _measures(file, surveys)
        file.flush()
        path.write_bytes(content.getvalue())


def _describe(file: Any, survey: Survey, surveys: Sequence[Survey], ground: Ground, sheet: Sheet) -> None:
    site, first, last = ground.site, surveys[0], surveys[-1]
    # Of all cells that have a latitude and a longitude here, whether anything is known of them or not.
    west, south, east, north = box(ground.from_sheet, sheet.bounds)
    versions = dict.fromkeys(str(one.made_by.get("version", "unknown")) for one in surveys)
    made_up = [f"{one.name}: {told}" for one in surveys if (told := words.warning(one))]
    attributes = {
        "Conventions": "CF-1.8, ACDD-1.3",
        "title": f"{'SIMULATED: ' if made_up else ''}Surveys of {site.name}",
        "summary": "Measures with 95 % intervals and maps from missions of an underwater robot: what was "
        "seen, where the target stands, its relief, and how often each place was looked at.",
        "keywords": "seabed habitat, reef, wreck, autonomous underwater vehicle",
        "source": f"DREAM {', '.join(versions)}",
        "history": f"{_iso(last.began)}: made from {', '.join(one.name for one in surveys)}",
        "references": "docs/survey-measures.md of DREAM",
        "comment": " ".join(
            (
                *(f"{told}." for told in made_up),
                f"Maps are of the ground of {survey.name}. Its origin is the reference position: "
                f"{site.latitude:.7f} degrees north, {site.longitude:.7f} degrees east. Other surveys are "
                "laid there as their individuals or maps lie on its own where these show it, else as their "
                "own site files say (laid_by); what of them lies beyond is in their own exports.",
                *((words.CLUMPS,) if survey.target is not Target.WRECK else ()),
            )
        ),
        "geospatial_lat_min": south,
        "geospatial_lat_max": north,
        "geospatial_lon_min": west,
        "geospatial_lon_max": east,
        "geospatial_vertical_positive": "up",
        "time_coverage_start": _iso(first.began),
        "time_coverage_end": _iso(_ended(last)),
    }
    _set(file, attributes)


def _times(file: Any, surveys: Sequence[Survey]) -> None:
    began = np.array([(survey.began - EPOCH).total_seconds() for survey in surveys])
    ended = np.array([(_ended(survey) - EPOCH).total_seconds() for survey in surveys])
    # A coordinate has to increase; of surveys of which only the day is known several may be of one time.
    told = began.copy()
    for k in range(1, len(told)):
        told[k] = max(told[k], told[k - 1] + 1.0)
    _variable(
        file,
        "time",
        "d",
        ("time",),
        told,
        standard_name="time",
        long_name="when the survey began",
        comment="of surveys that began at one time each is told a second after the one before; time_bounds "
        "has what was recorded",
        units="seconds since 1970-01-01 00:00:00",
        calendar="standard",
        axis="T",
        bounds="time_bounds",
    )
    _variable(file, "time_bounds", "d", ("time", "side"), np.column_stack([began, np.maximum(ended, told)]))
    width = file.dimensions["name_length"]
    names = np.array([list(survey.name.encode().ljust(width)) for survey in surveys], np.uint8).view("S1")
    _variable(file, "survey", "c", ("time", "name_length"), names, long_name="name of the survey")


def _origins(file: Any, surveys: Sequence[Survey], ground: Ground) -> None:
    """How far the site file of each survey puts its origin from the reference position."""
    offsets = [globe.between(replace(ground.site, heading_deg=0.0), site_of(one)) for one in surveys]
    for name, which in (("x", "east"), ("y", "north")):
        _variable(
            file,
            f"origin_{which}",
            "d",
            ("time",),
            np.array([getattr(offset, name) for offset in offsets]),
            long_name=f"metres {which} of the reference position at which the origin of the survey lies",
            units="m",
        )


def _laid(
    sheet: Sheet, ground: Ground, surveys: Sequence[Survey], lying: Sequence[Registration | None]
) -> list[Laid]:
    x, y = ground.world(*sheet.centres())
    points = np.column_stack([x.ravel(), y.ravel()])
    on = []
    for one, there in zip(surveys, lying, strict=True):
        own = points if there is None else there.back(points)
        on.append(laid_on(sheet, one.layers, own[:, 0].reshape(x.shape), own[:, 1].reshape(x.shape)))
    return on


def _lying(file: Any, ground: Ground, lying: Sequence[Registration | None]) -> None:
    """What shows how each survey lies on the ground of the one that is exported, and how far off site files
    are."""
    by = [0 if there is None else LAID_BY.index(there.by) for there in lying]
    _variable(
        file,
        "laid_by",
        "b",
        ("time",),
        np.array(by, np.int8),
        long_name="what shows how the maps of the survey lie on the ground of the one that is exported",
        flag_values=np.arange(len(LAID_BY), dtype=np.int8),
        flag_meanings="its_own individuals map site_files",
    )
    moved = [SE2(0.0, 0.0, 0.0) if there is None else there.moved for there in lying]
    east, north = ground.site.east_north([of.x for of in moved], [of.y for of in moved])
    off = "the maps of the survey are laid otherwise than the site files say"
    for name, values, what, units in (
        ("laid_east", east, f"metres east by which {off}", "m"),
        ("laid_north", north, f"metres north by which {off}", "m"),
        (
            "laid_turn",
            np.degrees([of.yaw for of in moved]),
            f"degrees counter-clockwise, seen from above, by which {off}",
            "degree",
        ),
        (
            "laid_sigma",
            np.array([0.0 if there is None else there.sigma for there in lying]),
            "standard error of where the maps of the survey lie on the ground of the one that is exported",
            "m",
        ),
    ):
        _variable(file, name, "d", ("time",), values, long_name=what, units=units)


def _grid_mapping(file: Any, ground: Ground) -> None:
    attributes = {
        name: value
        for name, value in ground.crs.to_cf().items()
        if not (isinstance(value, str) and not value) and value != "undefined"
    }
    # GDAL and QGIS read it from there; the CF attributes say the same.
    attributes["spatial_ref"] = attributes["crs_wkt"]
    attributes["long_name"] = f"EPSG:{ground.epsg}"
    _variable(file, "crs", "i", (), np.int32(0), **attributes)


def _globe(
    file: Any, ground: Ground, easting: npt.NDArray[np.float64], northing: npt.NDArray[np.float64]
) -> None:
    """Latitude and longitude of every cell, for readers that know no projection."""
    x, y = ground.world(*np.meshgrid(easting, northing))
    longitude, latitude = ground.globe(x, y)
    for name, values, unit in (("lat", latitude, "degrees_north"), ("lon", longitude, "degrees_east")):
        whole = {"lat": "latitude", "lon": "longitude"}[name]
        _variable(file, name, "d", ("y", "x"), values, standard_name=whole, long_name=whole, units=unit)


def _maps(file: Any, surveys: Sequence[Survey], on: Sequence[Laid]) -> None:
    shared: dict[str, Any] = {"grid_mapping": "crs", "coordinates": "lat lon"}
    grid = ("time", "y", "x")
    layers = [survey.layers for survey in surveys]
    state = np.stack([o.take(of.state.astype(np.int8), UNKNOWN) for o, of in zip(on, layers, strict=True)])
    _variable(
        file,
        "habitat",
        "b",
        grid,
        state,
        long_name="what the place is",
        comment=areas.WHY if surveys[0].target is not Target.WRECK else "none",
        flag_values=np.array(list(MEANINGS), np.int8),
        flag_meanings=" ".join(MEANINGS.values()),
        **shared,
    )
    for name, what, unit in (
        ("target_probability", "probability of target", "1"),
        ("relief", "height above the bare seabed around it", "m"),
    ):
        values = np.stack(
            [o.take(getattr(of, name), math.nan) for o, of in zip(on, layers, strict=True)]
        ).astype(np.float32)
        values[~np.isfinite(values)] = FILL
        _variable(
            file,
            name,
            "f",
            grid,
            values,
            long_name=what,
            units=unit,
            _FillValue=np.float32(FILL),
            **shared,
        )
    seen = np.stack([o.take(of.times_seen, 0) for o, of in zip(on, layers, strict=True)])
    _variable(
        file,
        "times_seen",
        "h",
        grid,
        np.minimum(seen, 32767).astype(np.int16),
        long_name="frames that saw it within reach",
        units="1",
        **shared,
    )


def _measures(file: Any, surveys: Sequence[Survey]) -> None:
    units = {measure.name: measure.unit for survey in surveys for measure in survey.measures}
    for name, of in measures_over(surveys).items():
        unit = units[name]
        values = np.array([_filled(m.value if m else None) for m in of])
        plain = re.sub(r"\W", "_", name)
        variable = plain if re.match(r"[A-Za-z]", plain) else f"measure_{plain}"
        notes = dict.fromkeys(m.note for m in of if m and m.note)
        if size_bin(name) is not None:
            notes[NONE_OF_THAT_SIZE] = None
        long_name = words.long_name(name)
        _variable(
            file,
            variable,
            "d",
            ("time",),
            values,
            long_name=long_name,
            units=_UNITS.get(unit, unit),
            _FillValue=FILL,
            ancillary_variables=f"{variable}_low {variable}_high",
            comment="; ".join(notes) or "none",
        )
        for end, which in (("low", "lower"), ("high", "upper")):
            _variable(
                file,
                f"{variable}_{end}",
                "d",
                ("time",),
                np.array([_filled(getattr(m, end) if m else None) for m in of]),
                long_name=f"{which} end of the 95 % interval of {long_name}",
                units=_UNITS.get(unit, unit),
                _FillValue=FILL,
            )


def _variable(
    file: Any, name: str, kind: str, dimensions: tuple[str, ...], values: Any, **attributes: Any
) -> None:
    variable = file.createVariable(name, kind, dimensions)
    _set(variable, attributes)
    variable.data[...] = values


def _set(holder: Any, attributes: Mapping[str, Any]) -> None:
    """Set attributes. SciPy would write text as ASCII only, and a plain float in single precision."""
    for key, value in attributes.items():
        kept = value.encode() if isinstance(value, str) else value
        setattr(holder, key, np.float64(kept) if isinstance(kept, float) else kept)


def _filled(value: float | None) -> float:
    return FILL if value is None else value


def _ended(survey: Survey) -> datetime:
    seconds = float(survey.track.time[-1]) if len(survey.track.time) else 0.0
    return survey.began + timedelta(seconds=seconds)


def _iso(moment: datetime) -> str:
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
