"""A survey as one GeoPackage: track, decisions with their reasoning, patches, individuals, swath, and styles.

Written with sqlite3 alone, as the standard says (OGC 12-128r17, GeoPackage 1.3.1): QGIS 3.22, which many
still have, calls the 1.4 of newer GDAL only partly supported. Geometries are on the map sheet of the site
(`ground`).
"""

from __future__ import annotations

import math
import sqlite3
import struct
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.survey.patches import grouped
from dream.survey.products import styles
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.outlines import outlines, ring_around
from dream.survey.products.words import of_structures, warning
from dream.survey.survey import Survey
from dream.types import Reasoning, Target

if TYPE_CHECKING:
    from collections.abc import Mapping

Float64Array = npt.NDArray[np.float64]
Rings = Sequence[Float64Array]

APPLICATION_ID = 0x47504B47
"""The letters GPKG."""
VERSION = 10_301
NAME = "survey.gpkg"

_POINT, _LINE, _POLYGON, _MULTIPOLYGON = 1, 2, 3, 6
_Z = 1000
"""Added to the type of a geometry with heights (ISO WKB)."""

_SCHEMA = """
CREATE TABLE gpkg_spatial_ref_sys (
  srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (
  table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT
  NULL, z TINYINT NOT NULL, m TINYINT NOT NULL, CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name), CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES
  gpkg_contents(table_name), CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys
  (srs_id));
CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT, f_table_schema TEXT, f_table_name TEXT,
  f_geometry_column TEXT, styleName TEXT, styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description
  TEXT, owner TEXT, ui TEXT, update_time DATETIME);
INSERT INTO gpkg_spatial_ref_sys VALUES
  ('Undefined cartesian SRS', -1, 'NONE', -1, 'undefined', 'undefined cartesian coordinate reference system'),
  ('Undefined geographic SRS', 0, 'NONE', 0, 'undefined', 'undefined geographic coordinate reference system');
"""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """One geometry, and all its points."""

    wkb: bytes
    points: Float64Array
    """(N, 2 or more)."""

    @property
    def box(self) -> tuple[float, float, float, float]:
        """West, east, south, north, as the header of a geometry has them."""
        (west, south), (east, north) = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        return float(west), float(east), float(south), float(north)

    def blob(self, srs: int) -> bytes:
        """As the file stores it: little-endian, with its box (clause 2.1.3)."""
        return struct.pack("<2sBBi4d", b"GP", 0, 0b11, srs, *self.box) + self.wkb


@dataclass(frozen=True, slots=True)
class Table:
    """One layer of the file."""

    name: str
    description: str
    columns: Mapping[str, str]
    """SQL type by name; the geometry and the key come before."""
    rows: Iterable[Sequence[Any]]
    """The geometry first, where there is one."""
    kind: str = ""
    """`POINT`, `LINESTRING`, `POLYGON` or `MULTIPOLYGON`; empty for a table without geometry."""
    heights: bool = False
    style: str = ""


def write(survey: Survey, path: Path) -> None:
    """Write a survey as a GeoPackage.

    The file is not complete until this returns; whoever needs it whole or not at all writes it elsewhere
    first.

    Raises:
        ValueError: The survey has no origin.
        OSError: It cannot be written.
    """
    ground = Ground(site_of(survey))
    tables = (
        _swath(survey, ground),
        _box(survey, ground),
        _patches(survey, ground),
        _individuals(survey, ground),
        _track(survey, ground),
        _decisions(survey, ground),
        _measures(survey),
        *((_structures(survey),) if survey.structures else ()),
        _about(survey),
    )
    path.unlink(missing_ok=True)
    try:
        with closing(sqlite3.connect(path, isolation_level=None)) as file:
            file.execute("PRAGMA journal_mode = MEMORY")
            file.executescript(_SCHEMA)
            file.execute("BEGIN")
            file.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            file.execute(f"PRAGMA user_version = {VERSION}")
            for srs in dict.fromkeys((4326, ground.epsg)):
                file.execute("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, 'EPSG', ?, ?, '')", _srs(srs))
            styled = ("layer_styles", "attributes", "layer_styles", _time(survey.began))
            file.execute(
                "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change) "
                "VALUES (?, ?, ?, ?)",
                styled,
            )
            made_up = f"{told}. " if (told := warning(survey)) else ""
            for table in tables:
                described = replace(table, description=made_up + table.description)
                _add(file, described, ground.epsg, survey.began)
            file.execute("COMMIT")
    except sqlite3.Error as error:
        path.unlink(missing_ok=True)
        raise OSError(f"could not write {path} ({error})") from error


def _add(file: sqlite3.Connection, table: Table, srs: int, changed: datetime) -> None:
    columns = ["fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL"]
    columns += [f"geom {table.kind}"] if table.kind else []
    columns += [f'"{name}" {kind}' for name, kind in table.columns.items()]
    file.execute(f'CREATE TABLE "{table.name}" ({", ".join(columns)})')
    boxes = []
    marks = ", ".join("?" * (len(columns) - 1))
    names = (["geom"] if table.kind else []) + [f'"{name}"' for name in table.columns]
    for row in table.rows:
        values = list(row)
        if table.kind:
            boxes.append(values[0].box)
            values[0] = values[0].blob(srs)
        file.execute(f'INSERT INTO "{table.name}" ({", ".join(names)}) VALUES ({marks})', values)
    extent: tuple[float | None, ...] = (None,) * 4
    if boxes:
        west, east, south, north = zip(*boxes, strict=True)
        extent = (min(west), min(south), max(east), max(north))
    file.execute(
        "INSERT INTO gpkg_contents VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            table.name,
            "features" if table.kind else "attributes",
            table.name,
            table.description,
            _time(changed),
            *extent,
            srs if table.kind else None,
        ),
    )
    if table.kind:
        file.execute(
            "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, ?, 0)",
            (table.name, table.kind, srs, int(table.heights)),
        )
    if table.style:
        file.execute(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, "
            "styleName, styleQML, styleSLD, useAsDefault, description, owner, update_time) "
            "VALUES ('', '', ?, 'geom', ?, ?, '', 1, ?, '', ?)",
            (table.name, table.name, table.style, table.description, _time(changed)),
        )


def _srs(epsg: int) -> tuple[str, int, int, str]:
    import pyproj

    crs = pyproj.CRS.from_epsg(epsg)
    return crs.name, epsg, epsg, crs.to_wkt("WKT1_GDAL")


def _track(survey: Survey, ground: Ground) -> Table:
    track = survey.track
    moved = np.linalg.norm(np.diff(track.position[:, :2], axis=0), axis=1)
    seconds = float(track.time[-1] - track.time[0]) if len(track.time) else 0.0
    rows = []
    if len(track.time) > 1:
        # A line is at least two points, also of a vehicle that never left its place.
        rows.append(
            (
                _geometry(
                    _LINE, [_on_sheet(ground, track.position[:, :2])], -ground.depth(track.position[:, 2])
                ),
                survey.name,
                _time(survey.began),
                _time(_at(survey, float(track.time[-1]))),
                seconds,
                float(moved.sum()),
                len(track.time) - 1,
                float(track.sigma.max(initial=0.0)),
            )
        )
    return Table(
        "track",
        "Where the vehicle went; heights are above the datum",
        {
            "survey": "TEXT",
            "began": "DATETIME",
            "ended": "DATETIME",
            "seconds": "DOUBLE",
            "metres": "DOUBLE",
            "steps": "INTEGER",
            "worst_sigma_m": "DOUBLE",
        },
        rows,
        "LINESTRING",
        heights=True,
        style=styles.line_qml(styles.TRACK, 0.5),
    )


def _decisions(survey: Survey, ground: Ground) -> Table:
    thoughts = [field.name for field in fields(Reasoning)]
    points = np.array([(point.x, point.y) for point in survey.decisions]).reshape(-1, 2)
    easting, northing = ground.sheet(points[:, 0], points[:, 1])
    # Symbols turn from the sheet's north, which is not the true one: where one metre ahead lies on it.
    ahead = points + np.array([(math.cos(p.yaw), math.sin(p.yaw)) for p in survey.decisions]).reshape(-1, 2)
    there = ground.sheet(ahead[:, 0], ahead[:, 1])
    grid = np.mod(np.degrees(np.arctan2(there[0] - easting, there[1] - northing)), 360.0)
    rows = [
        (
            _geometry(_POINT, [np.array([[easting[n], northing[n]]])]),
            point.step,
            _time(_at(survey, point.time)),
            point.time,
            float(ground.true_heading(point.yaw)),
            float(grid[n]),
            math.degrees(point.turn),
            point.advance,
            *(getattr(point.reasoning, thought) for thought in thoughts),
            point.note,
        )
        for n, point in enumerate(survey.decisions)
    ]
    return Table(
        "decisions",
        "Where each step ended, what was decided, and why; turns are positive to the left",
        {
            "step": "INTEGER",
            "time": "DATETIME",
            "seconds": "DOUBLE",
            "heading_true_deg": "DOUBLE",
            "heading_grid_deg": "DOUBLE",
            "turn_deg": "DOUBLE",
            "advance_m": "DOUBLE",
            **dict.fromkeys(thoughts, "TEXT"),
            "note": "TEXT",
        },
        rows,
        "POINT",
        style=styles.point_qml(styles.DECISION, 2.6, "#4a3405", angle="heading_grid_deg", shape="triangle"),
    )


def _patches(survey: Survey, ground: Ground) -> Table:
    names = dict.fromkeys(measure.name for patch in survey.patches for measure in patch.measures)
    units = {measure.name: measure.unit for patch in survey.patches for measure in patch.measures}
    columns = [
        (f"{name}_{_unit_word(units[name])}" if units[name] else name, name) for name in map(str, names)
    ]
    rows = []
    for number, patch in enumerate(survey.patches):
        of = {measure.name: measure for measure in patch.measures}
        values: list[float | None] = []
        for _, name in columns:
            measure = of.get(name)
            values += [measure.value, measure.low, measure.high] if measure else [None] * 3
        rings = grouped([_on_sheet(ground, ring) for ring in patch.rings])
        rows.append((_multipolygon(rings), number + 1, *values))
    wreck = survey.target is Target.WRECK
    color = styles.STATE_COLORS[styles.SOLID_TARGET if wreck else styles.TARGET]
    return Table(
        "patches",
        "Patches of reef, or a wreck and its debris, with what was measured of each; counts are of "
        "individuals, low and high bound 95 %",
        {
            "patch": "INTEGER",
            **{name + end: "DOUBLE" for name, _ in columns for end in ("", "_low", "_high")},
        },
        rows,
        "MULTIPOLYGON",
        style=styles.polygon_qml(color, styles.outline_color(survey.target), 0.4, 70),
    )


def _individuals(survey: Survey, ground: Ground) -> Table:
    found = survey.individuals
    easting, northing = ground.sheet(found.position[:, 0], found.position[:, 1])
    depth = ground.depth(found.position[:, 2])
    rows = [
        (
            _geometry(_POINT, [np.array([[easting[n], northing[n]]])], -depth[n : n + 1]),
            n + 1,
            int(found.patch[n]) + 1 if found.patch[n] >= 0 else None,
            float(found.size[n]) if found.clear[n] else None,
            float(found.size_sigma[n]) if found.clear[n] else None,
            float(found.sigma[n]),
            float(depth[n]),
            float(found.confidence[n]),
            int(found.hits[n]),
            int(found.looks[n]),
        )
        for n in range(len(found))
    ]
    return Table(
        "individuals",
        "Individuals that were found, each once; on a reef one is a clump of shells. How many there are is "
        "told by count in measures. Sizes are the longest diameter of those that stand clear of others, "
        "depths are below the datum",
        {
            "individual": "INTEGER",
            "patch": "INTEGER",
            "size_m": "DOUBLE",
            "size_sigma_m": "DOUBLE",
            "position_sigma_m": "DOUBLE",
            "depth_m": "DOUBLE",
            "confidence": "DOUBLE",
            "hits": "INTEGER",
            "looks": "INTEGER",
        },
        rows,
        "POINT",
        heights=True,
        style=styles.sized_point_qml(styles.INDIVIDUAL, "size_m", "individual"),
    )


def _swath(survey: Survey, ground: Ground) -> Table:
    layers = survey.layers
    corner = (layers.bounds.x_min, layers.bounds.y_min)
    polygons = outlines(layers.state != styles.UNKNOWN)
    area = float((layers.state != styles.UNKNOWN).sum()) * layers.cell**2
    rows = []
    if polygons:
        rings = [[_on_sheet(ground, ring * layers.cell + corner) for ring in polygon] for polygon in polygons]
        rows.append((_multipolygon(rings), area))
    return Table(
        "swath",
        "The ground that was seen",
        {"area_m2": "DOUBLE"},
        rows,
        "MULTIPOLYGON",
        style=styles.polygon_qml("#56a9c2", "#1f7396", 0.25, 28),
    )


def _box(survey: Survey, ground: Ground) -> Table:
    box = survey.area
    rows = [(_geometry(_POLYGON, [_on_sheet(ground, ring_around(box))]), box.width * box.depth)]
    return Table(
        "area",
        "The operator's box",
        {"area_m2": "DOUBLE"},
        rows,
        "POLYGON",
        style=styles.polygon_qml("#ffffff", styles.BOX, 0.35, 0),
    )


def _measures(survey: Survey) -> Table:
    return Table(
        "measures",
        "Of the whole survey; counts are of individuals, low and high bound 95 %",
        {
            "name": "TEXT",
            "value": "DOUBLE",
            "low": "DOUBLE",
            "high": "DOUBLE",
            "unit": "TEXT",
            "note": "TEXT",
        },
        [(m.name, m.value, m.low, m.high, m.unit, m.note) for m in survey.measures],
    )


def _structures(survey: Survey) -> Table:
    return Table(
        "structures",
        "What stands, and what of each of its sides was inspected; of all of it where side is empty",
        {
            "structure": "INTEGER",
            "side": "TEXT",
            "name": "TEXT",
            "value": "DOUBLE",
            "low": "DOUBLE",
            "high": "DOUBLE",
            "unit": "TEXT",
            "note": "TEXT",
        },
        [
            (number, side, m.name, m.value, m.low, m.high, m.unit, m.note)
            for number, side, measures in of_structures(survey)
            for m in measures
        ],
    )


def _about(survey: Survey) -> Table:
    site = site_of(survey)
    told = {
        "survey": survey.name,
        "site": site.name,
        "began": survey.began.isoformat(),
        "target": str(survey.target),
        "protocol": survey.protocol,
        "simulated": warning(survey) or "no",
        "latitude": site.latitude,
        "longitude": site.longitude,
        "heading_deg": site.heading_deg,
        "datum": site.datum,
        "datum_offset_m": site.datum_offset,
        **({} if site.uncertainty is None else {"uncertainty_m": site.uncertainty}),
        **{f"made_by.{key}": value for key, value in survey.made_by.items()},
    }
    rows = [(key, str(value)) for key, value in told.items()]
    return Table("about", "What survey this is", {"key": "TEXT", "value": "TEXT"}, rows)


def _on_sheet(ground: Ground, points: Float64Array) -> Float64Array:
    """(N, 2) on the map sheet of (N, 2) of the world."""
    return np.column_stack(ground.sheet(points[:, 0], points[:, 1]))


def _geometry(kind: int, parts: Rings, heights: Float64Array | None = None) -> Geometry:
    """Little-endian ISO WKB of a point, a line or a polygon; `heights` go with the points of the only
    part."""
    body = struct.pack("<BI", 1, kind + (_Z if heights is not None else 0))
    if heights is not None:
        parts = [np.column_stack([parts[0], heights])]
    if kind == _POLYGON:
        body += struct.pack("<I", len(parts))
    for part in parts:
        if kind != _POINT:
            body += struct.pack("<I", len(part))
        body += np.ascontiguousarray(part, "<f8").tobytes()
    return Geometry(body, np.concatenate(parts))


def _multipolygon(polygons: Sequence[Rings]) -> Geometry:
    parts = [_geometry(_POLYGON, rings) for rings in polygons]
    body = struct.pack("<BII", 1, _MULTIPOLYGON, len(parts)) + b"".join(part.wkb for part in parts)
    return Geometry(body, np.concatenate([part.points for part in parts]))


def _at(survey: Survey, seconds: float) -> datetime:
    return survey.began + timedelta(seconds=seconds)


def _time(moment: datetime) -> str:
    """As the standard writes it: UTC with milliseconds."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def _unit_word(unit: str) -> str:
    return {"1/m2": "per_m2"}.get(unit, unit)
