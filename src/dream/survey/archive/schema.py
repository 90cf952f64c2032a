"""The tables of an archive, and how they came to be: the same for both backends.

`documents` holds every survey whole, as its file does; the other tables tell the same in the words of a
geographic information system: degrees of WGS 84, one row a thing.
"""

from __future__ import annotations

from dataclasses import dataclass

WGS84 = 4326
"""EPSG number of every geometry."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column."""

    name: str
    kind: str
    """`id`, `integer`, `real`, `text`, `time`, `blob`, or a geometry: `POINT`, `LINESTRING`,
    `POLYGON`, `MULTIPOLYGON`."""
    required: bool = True
    unique: bool = False
    of: str = ""
    """The table that its values are ids of."""

    @property
    def is_geometry(self) -> bool:
        """Is it a point, a line or a polygon?"""
        return self.kind.isupper()


@dataclass(frozen=True, slots=True)
class Table:
    """One table. The first column is its key; it has a geometry at most."""

    name: str
    title: str
    """Shown to those who open the archive."""
    columns: tuple[Column, ...]
    hidden: bool = False
    """Not for those who open the archive with other programs."""

    @property
    def geometry(self) -> Column | None:
        """Its column of points, lines or polygons."""
        return next((column for column in self.columns if column.is_geometry), None)


@dataclass(frozen=True, slots=True)
class Migration:
    """What a version brought."""

    tables: tuple[Table, ...] = ()
    """New ones, or what is new of those that are there: a title, further columns (then not `required`)."""
    updates: tuple[str, ...] = ()
    """SQL that puts right what rows of before hold; `{schema}` stands before each table."""


_ID = Column("id", "id")
_SURVEY = Column("survey_id", "integer", of="surveys")

_BOXES = "Surveys: the box of each"
_FOUND = (
    "Individuals that were found, each once; count in measures tells how many there are. Sizes are their own "
    "where clear is 1, else the mean of those, or a guess where there are none"
)

_FIRST = Migration(
    (
        Table(
            "surveys",
            _BOXES,
            (
                _ID,
                Column("digest", "text", unique=True),
                Column("name", "text"),
                Column("site", "text"),
                Column("began", "time"),
                Column("target", "text"),
                Column("protocol", "text"),
                Column("steps", "integer"),
                Column("patches", "integer"),
                Column("individuals", "integer"),
                Column("latitude", "real"),
                Column("longitude", "real"),
                Column("heading_deg", "real"),
                Column("datum", "text"),
                Column("datum_offset_m", "real"),
                Column("geom", "POLYGON"),
            ),
        ),
        Table(
            "documents",
            "Surveys as files",
            (Column("survey_id", "id", of="surveys"), Column("body", "blob")),
            hidden=True,
        ),
        Table(
            "measures",
            "Measures with their 95 % intervals; of the whole survey where patch is empty",
            (
                _ID,
                _SURVEY,
                Column("patch", "integer", required=False),
                Column("name", "text"),
                Column("value", "real", required=False),
                Column("low", "real", required=False),
                Column("high", "real", required=False),
                Column("unit", "text"),
                Column("note", "text"),
            ),
        ),
        Table(
            "patches",
            "Patches of reef, or outlines of wrecks",
            (_ID, _SURVEY, Column("patch", "integer"), Column("geom", "MULTIPOLYGON")),
        ),
        Table(
            "individuals",
            _FOUND,
            (
                _ID,
                _SURVEY,
                Column("patch", "integer", required=False),
                Column("z_m", "real"),
                Column("sigma_m", "real"),
                Column("size_m", "real"),
                Column("size_sigma_m", "real"),
                Column("hits", "integer"),
                Column("looks", "integer"),
                Column("confidence", "real"),
                Column("geom", "POINT"),
            ),
        ),
        Table("tracks", "Ways of the vehicle", (_ID, _SURVEY, Column("geom", "LINESTRING"))),
        Table(
            "decisions",
            "What was decided, and why",
            (
                _ID,
                _SURVEY,
                Column("step", "integer"),
                Column("time_s", "real"),
                Column("turn_deg", "real"),
                Column("advance_m", "real"),
                Column("distribution", "text"),
                Column("target_area", "text"),
                Column("completion", "text"),
                Column("next_target", "text"),
                Column("safety", "text"),
                Column("action", "text"),
                Column("note", "text"),
                Column("geom", "POINT"),
            ),
        ),
    )
)
_NUMBERED_AS_IN_REPORTS = Migration(
    (Table("surveys", _BOXES, (Column("run", "text", required=False),)),),
    (
        "UPDATE {schema}surveys SET steps = "
        "(SELECT count(*) FROM {schema}decisions WHERE survey_id = surveys.id)",
        "UPDATE {schema}patches SET patch = patch + 1",
        "UPDATE {schema}measures SET patch = patch + 1",
        "UPDATE {schema}individuals SET patch = patch + 1",
    ),
)
"""Steps had counted the first look, patches had begun with 0; `run` tells copies of one run."""
_HOW_SURE = Migration(
    (
        Table("individuals", _FOUND, (Column("clear", "integer", required=False),)),
        Table("surveys", _BOXES, (Column("uncertainty_m", "real", required=False),)),
    )
)
"""`clear` is 1 where the size is its own, 0 where it is the mean of those that stand clear;
`uncertainty_m` is that of the site. Surveys that were kept before do not say."""
_CLEAR_WHERE_IT_IS_TOLD = Migration(
    (Table("individuals", _FOUND, ()),),
    (
        "UPDATE {schema}individuals SET clear = NULL WHERE survey_id IN (SELECT survey_id FROM "
        "{schema}measures WHERE patch IS NULL AND name = 'median_size' AND value IS NOT NULL) AND survey_id "
        "NOT IN (SELECT survey_id FROM {schema}individuals WHERE clear = 1)",
    ),
)
"""Of files of older versions that were added since, `clear` had been 0."""
MIGRATIONS = (_FIRST, _NUMBERED_AS_IN_REPORTS, _HOW_SURE, _CLEAR_WHERE_IT_IS_TOLD)
VERSIONS = "dream_versions"
"""Table with a row for every migration that was made."""
FROM_NOWHERE = (
    "expected a survey of a run with an origin, got a run without origin. Fly it with dream run --site FILE, "
    "or name the site of this one with --site FILE"
)


def order(migrations: tuple[Migration, ...]) -> dict[str, Table]:
    """All tables as they are after the migrations, each after those that it points to."""
    tables: dict[str, Table] = {}
    for migration in migrations:
        for table in migration.tables:
            before = tables.get(table.name)
            columns = table.columns if before is None else before.columns + table.columns
            tables[table.name] = Table(table.name, table.title, columns, table.hidden)
    return tables


def parts() -> list[str]:
    """The tables that hold what belongs to a survey, in `survey_id`."""
    tables = order(MIGRATIONS).values()
    return [table.name for table in tables if any(column.of == "surveys" for column in table.columns)]
