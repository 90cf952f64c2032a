"""An archive as a GeoPackage: one file, no server.

Reference: OGC 12-128r17, GeoPackage 1.3, which is SQLite with some tables of its own.

A rollback journal and a lock of the whole file while a survey is written: writers take turns, and what one
left half-written when it died is undone by whoever opens the file next. The journal is SQLite's default
rather than a write-ahead log, so that between writes the archive is one file that can be copied.
"""

from __future__ import annotations

import contextlib
import errno
import math
import sqlite3
import struct
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from dream.files import first_or_nothing
from dream.survey import files
from dream.survey.archive import entries as told
from dream.survey.archive import wkb
from dream.survey.archive.entries import Entry
from dream.survey.archive.keeping import OF_ITS_RUN, Keeping, missing
from dream.survey.archive.rows import Row, digest
from dream.survey.archive.schema import MIGRATIONS, VERSIONS, WGS84, Column, Table, order, parts
from dream.survey.archive.strangers import check_tables, confine
from dream.survey.survey import Survey

APPLICATION = 0x47504B47
"""`GPKG`, in the header of the file."""
GEOPACKAGE = 10_300
"""Version 1.3; QGIS of 2026's stable systems calls 1.4 partly supported."""
HEADER = 8
"""Bytes of a geometry before its envelope (clause 2.1.3)."""
PATIENCE = 30.0
"""Seconds to wait for another writer."""
READING, CHANGING, MIGRATION = 60.0, 600.0, 3600.0
"""Seconds that asking an archive, changing it, and bringing it up to date may take."""
STEPS = 10_000
"""Of SQLite's machine, between two looks at the clock."""

_KINDS = {"id": "INTEGER", "integer": "INTEGER", "real": "DOUBLE", "text": "TEXT", "time": "DATETIME"}
_KINDS |= {"blob": "BLOB"}
_OF_GEOPACKAGE = (
    """CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY,
    organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL,
    description TEXT)""",
    """CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
    identifier TEXT UNIQUE, description TEXT DEFAULT '',
    last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')), min_x DOUBLE, min_y DOUBLE,
    max_x DOUBLE, max_y DOUBLE, srs_id INTEGER, CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES
    gpkg_spatial_ref_sys(srs_id))""",
    """CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
    CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name), CONSTRAINT uk_gc_table_name UNIQUE
    (table_name), CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
    CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id))""",
)
_OF_STYLES = """CREATE TABLE layer_styles (id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    f_table_catalog TEXT, f_table_schema TEXT, f_table_name TEXT, f_geometry_column TEXT, styleName TEXT,
    styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT, owner TEXT, ui TEXT,
    update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')))"""
"""What QGIS looks for."""
_WKT = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
    'AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["degree",'
    '0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]]'
)
_SYSTEMS = (
    ("Undefined Cartesian", -1, "NONE", -1, "undefined", None),
    ("Undefined geographic", 0, "NONE", 0, "undefined", None),
    ("WGS 84 geodetic", WGS84, "EPSG", WGS84, _WKT, "longitude, latitude in degrees"),
)


_COLUMNS = {
    "gpkg_contents": ("table_name", "last_change", "min_x", "min_y", "max_x", "max_y", "srs_id"),
    "gpkg_geometry_columns": ("table_name", "column_name", "geometry_type_name", "srs_id"),
    "gpkg_spatial_ref_sys": ("srs_id",),
}
"""Of a GeoPackage's own tables, what is asked or written here."""


class GeoPackageArchive(Keeping):
    """Surveys in a GeoPackage. Use it as a context, or close it."""

    def __init__(self, path: Path, *, begin: bool = False) -> None:
        """Open it, bring it to the present version, and see that it is whole.

        Args:
            path: Of the file.
            begin: Make it where there is none.

        Raises:
            FileNotFoundError: There is none, and none is to be begun.
            OSError: It cannot be opened.
            ValueError: It is no archive, is damaged, or of a later version.
        """
        self._path = path
        if not begin and not path.is_file():
            raise FileNotFoundError(
                f"{path}: expected an archive of surveys, got no file. Begin one with dream survey add, or "
                "name another with --archive"
            )
        self._until = math.inf
        if begin:
            self._begin_file()
        with self._told(MIGRATION):
            # As a path, also where a name means something else to SQLite, as ":memory:" does.
            self._connection = sqlite3.connect(path.absolute(), timeout=PATIENCE, isolation_level=None)
        try:
            with self._told(MIGRATION):
                self._set_up()
                try:
                    self._migrate(begin=begin)
                except sqlite3.OperationalError as error:
                    if begin or _code(error) != sqlite3.SQLITE_READONLY:
                        raise
                    self._go_on_with_a_copy()
        except BaseException:
            self._connection.close()
            raise

    def _set_up(self) -> None:
        # What it is asked may last for ever, and SQLite does not hear Ctrl-C meanwhile.
        self._connection.set_progress_handler(self._is_late, STEPS)
        confine(self._connection)
        # What was reported as kept is on the disk, also where the power fails.
        self._connection.execute("PRAGMA synchronous = FULL")
        self._connection.execute("PRAGMA foreign_keys = ON")

    def _go_on_with_a_copy(self) -> None:
        """Bring a copy up to date where an older archive cannot be written to, and only read from it."""
        # Without a name it goes to a file of SQLite's own where it is large, which is gone when it is closed.
        with contextlib.ExitStack() as stack:
            copy = stack.enter_context(contextlib.closing(sqlite3.connect("", isolation_level=None)))
            self._connection.backup(copy, pages=STEPS, progress=self._go_on)
            stack.pop_all()
        self._connection.close()
        self._connection = copy
        self._set_up()
        self._migrate(begin=False)
        # What is kept there would be lost.
        self._connection.execute("PRAGMA query_only = ON")

    def _is_late(self) -> bool:
        return time.monotonic() > self._until

    def _go_on(self, status: int, remaining: int, total: int) -> None:
        """Called between parts of a copy, where Ctrl-C is heard too."""
        if self._is_late():
            raise TimeoutError(f"{self._path}: expected to copy it within {MIGRATION:g} s, gave up")

    def _begin_file(self) -> None:
        """Make an archive where there is none: it is there whole or not at all, whatever dies meanwhile."""
        if self._path.exists() or not self._path.parent.is_dir():
            return
        with first_or_nothing(self._path) as partial:
            self._connection = sqlite3.connect(partial, isolation_level=None)
            with contextlib.closing(self._connection), self._told(MIGRATION):
                # What is left of one that was killed is one file, and of no use to anybody.
                self._connection.execute("PRAGMA journal_mode = MEMORY")
                self._set_up()
                self._migrate(begin=True)

    def __enter__(self) -> GeoPackageArchive:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the file back."""
        self._connection.close()

    @property
    def name(self) -> str:
        """Its path."""
        return str(self._path)

    def entries(self) -> list[Entry]:
        """What is there, by number."""
        with self._told(READING), self._transaction("DEFERRED"):
            return self._entries()

    def get(self, number: int) -> Survey:
        """The survey of that number."""
        with self._told(READING):
            found = self._connection.execute(
                "SELECT digest, body FROM surveys JOIN documents ON survey_id = id WHERE id = ?", (number,)
            ).fetchone()
            if found is None:
                there = self._connection.execute("SELECT id FROM surveys ORDER BY id").fetchall()
                raise missing(self.name, number, (one for (one,) in there))
        return document(found, number, self.name)

    def _entries(self) -> list[Entry]:
        surveys = self._connection.execute(f"SELECT {', '.join(told.COLUMNS)} FROM surveys ORDER BY id")
        measures = self._connection.execute(
            f"SELECT {', '.join(told.MEASURES)} FROM measures WHERE patch IS NULL ORDER BY id"
        )
        return told.entries(surveys.fetchall(), measures.fetchall(), self.name)

    def _of_its_run(self, head: Row) -> list[tuple[int, str, str]]:
        return self._connection.execute(
            """SELECT id, digest, name FROM surveys WHERE digest = :digest OR run = :run
            OR (name = :name AND began = :began AND (run IS NULL OR :run IS NULL)) ORDER BY id""",
            {name: head[name] for name in OF_ITS_RUN},
        ).fetchall()

    def _begin_survey(self, head: Row) -> int:
        return insert(self._connection, "surveys", head)

    def _renew_survey(self, number: int, head: Row) -> None:
        marks = ", ".join(f"{name} = ?" for name in head)
        self._connection.execute(f"UPDATE surveys SET {marks} WHERE id = ?", (*_values(head), number))

    def _end_survey(self, number: int) -> None:
        self._connection.execute("DELETE FROM surveys WHERE id = ?", (number,))

    def _fill(self, number: int, others: Mapping[str, Iterable[Row]]) -> None:
        """Put in what belongs to a survey."""
        for table, rows_of in others.items():
            for row in rows_of:
                insert(self._connection, table, {"survey_id": number, **row})

    def _read_back(self, number: int) -> tuple[str, bytes, dict[str, int]]:
        found = self._connection.execute(
            "SELECT digest, body FROM surveys JOIN documents ON survey_id = id WHERE id = ?", (number,)
        ).fetchone()
        counts = {
            table: self._connection.execute(
                f"SELECT count(*) FROM {table} WHERE survey_id = ?", (number,)
            ).fetchone()[0]
            for table in parts()
        }
        digest, body = found or ("", b"")
        return str(digest), bytes(body), counts

    def _empty(self, number: int) -> None:
        """Take out what belongs to a survey."""
        for table in parts():
            self._connection.execute(f"DELETE FROM {table} WHERE survey_id = ?", (number,))

    def _register_change(self) -> None:
        """Tell those who open the file that it changed, and where its layers lie now."""
        boxes = self._connection.execute("SELECT CAST(geom AS BLOB) FROM surveys").fetchall()
        sides = zip(*(struct.unpack_from("<4d", box, HEADER) for (box,) in boxes), strict=True)
        ends = [end(side) for end, side in zip((min, max, min, max), sides, strict=False)]
        self._connection.execute(
            """UPDATE gpkg_contents SET last_change = strftime('%Y-%m-%dT%H:%M:%fZ','now'),
            min_x = ?, max_x = ?, min_y = ?, max_y = ? WHERE srs_id IS NOT NULL""",
            ends or [None] * 4,
        )

    def _migrate(self, *, begin: bool) -> None:
        version = self._version()
        if version == len(MIGRATIONS):
            return
        if version == 0 and not begin:
            raise ValueError(f"{self._path}: expected an archive of surveys, got an empty file")
        # Another may have been faster: look again with the lock.
        with self._transaction():
            version = self._version()
            if version == 0:
                begin_file(self._connection)
                self._connection.execute(
                    f"CREATE TABLE {VERSIONS} (version INTEGER PRIMARY KEY NOT NULL, made TEXT NOT NULL)"
                )
            known = order(MIGRATIONS[:version])
            for number, migration in enumerate(MIGRATIONS[version:], start=version + 1):
                for table in migration.tables:
                    for statement in statements(table, extends=table.name in known):
                        self._connection.execute(statement)
                    if not table.hidden:
                        (retitle if table.name in known else register)(self._connection, table)
                    known[table.name] = table
                for update in migration.updates:
                    self._connection.execute(update.format(schema=""))
                self._connection.execute(
                    f"INSERT INTO {VERSIONS} VALUES (?, strftime('%Y-%m-%dT%H:%M:%fZ','now'))", (number,)
                )

    def _version(self) -> int:
        """0 of an empty file.

        Raises:
            ValueError: It is no archive, or of a later version.
        """
        check_tables(self._connection, {VERSIONS: ("version", "made")}, self.name)
        tables = {name for (name,) in self._connection.execute("SELECT name FROM sqlite_master")}
        if not tables:
            return 0
        if VERSIONS not in tables:
            raise ValueError(f"{self._path}: expected an archive of surveys, got another database")
        version = self._connection.execute(f"SELECT max(version) FROM {VERSIONS}").fetchone()[0]
        if not isinstance(version, int) or version < 1:
            raise ValueError(f"{self._path}: expected the version of an archive, got {str(version)[:80]!r}")
        if version > len(MIGRATIONS):
            raise ValueError(
                f"{self._path}: expected an archive of version {len(MIGRATIONS)} at most, got {version}. "
                "Open it with a later dream"
            )
        known = order(MIGRATIONS[:version]).values()
        missing = [table.name for table in known if table.name not in tables]
        if missing:
            raise ValueError(f"{self._path}: expected the table {missing[0]}, got none of that name")
        columns = {table.name: [column.name for column in table.columns] for table in known}
        check_tables(self._connection, {**columns, **_COLUMNS}, self.name)
        return version

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """A transaction in a file that is whole."""
        with self._told(CHANGING), self._transaction():
            found = self._connection.execute("PRAGMA quick_check(1)").fetchone()[0]
            if found != "ok":
                raise sqlite3.DatabaseError(found)
            yield

    @contextlib.contextmanager
    def _transaction(self, kind: str = "IMMEDIATE") -> Iterator[None]:
        self._connection.execute(f"BEGIN {kind}")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            # Some errors, such as a full disk, have rolled it back already.
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise

    @contextlib.contextmanager
    def _told(self, seconds: float) -> Iterator[None]:
        """Say what SQLite complains of in words of the archive, and that it took longer than it may."""
        outer = self._until
        self._until = min(outer, time.monotonic() + seconds) if outer == math.inf else outer
        try:
            yield
        # Of a complaint that quotes what is damaged, or of a geometry that is none.
        except (UnicodeDecodeError, struct.error) as error:
            raise ValueError(f"{self._path}: expected an archive of surveys, got a damaged file") from error
        except sqlite3.DatabaseError as error:
            code = _code(error)
            if code == sqlite3.SQLITE_INTERRUPT:
                # It was stopped in time: by Ctrl-C, which a callback from C does not hand on.
                if not self._is_late():
                    raise KeyboardInterrupt from None
                raise TimeoutError(
                    f"{self._path}: expected an archive of surveys, got one that takes longer than "
                    f"{seconds:g} s. Nothing was changed"
                ) from error
            if code in _FAILED:
                raise OSError(f"{self._path}: {_FAILED[code]} ({error}). Nothing was changed") from error
            raise ValueError(
                f"{self._path}: expected an archive of surveys, got a damaged or foreign file ({error})"
            ) from error
        finally:
            self._until = outer


def _code(error: sqlite3.DatabaseError) -> int:
    """SQLite's own number of what failed; that of damage where Python, which raised it itself, has none."""
    code: int = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
    return code & 0xFF


_FAILED = {
    sqlite3.SQLITE_FULL: "could not write the archive: there is no room",
    sqlite3.SQLITE_IOERR: "could not read or write the archive",
    sqlite3.SQLITE_BUSY: f"another program has been writing to the archive for {PATIENCE:g} s",
    sqlite3.SQLITE_READONLY: "expected an archive that can be written",
    sqlite3.SQLITE_CANTOPEN: "expected a place where an archive can be opened",
    sqlite3.SQLITE_PERM: "expected an archive that may be opened",
    sqlite3.SQLITE_TOOBIG: "the survey is larger than a row may be",
    sqlite3.SQLITE_NOMEM: "there is not enough memory",
}
"""Errors that are no fault of the file's content."""


def statements(table: Table, *, extends: bool) -> list[str]:
    """The SQL that makes a table, or that adds its columns to the one that is there."""
    if extends:
        return [f"ALTER TABLE {table.name} ADD COLUMN {_column(column)}" for column in table.columns]
    made = [f"CREATE TABLE {table.name} ({', '.join(_column(column) for column in table.columns)})"]
    made += [
        f"CREATE INDEX {table.name}_{column.name} ON {table.name} ({column.name})"
        for column in table.columns
        if column.of and column.kind != "id"
    ]
    return made


def _column(column: Column) -> str:
    words = [column.name, column.kind if column.is_geometry else _KINDS[column.kind]]
    if column.kind == "id":
        # Numbers of surveys are not given twice.
        words.append("PRIMARY KEY NOT NULL" if column.of else "PRIMARY KEY AUTOINCREMENT NOT NULL")
    elif column.required:
        words.append("NOT NULL")
    if column.unique:
        words.append("UNIQUE")
    if column.of:
        words.append(f"REFERENCES {column.of}(id)")
    return " ".join(words)


def header(geometry: bytes, srs: int = WGS84) -> bytes:
    """What a GeoPackage puts before well-known binary, with an envelope for all but points (clause 2.1.3)."""
    if wkb.kind(geometry) == 1:
        return struct.pack("<2sBBi", b"GP", 0, 0b0000_0001, srs)
    return struct.pack("<2sBBi4d", b"GP", 0, 0b0000_0011, srs, *wkb.envelope(geometry))


def begin_file(connection: sqlite3.Connection) -> None:
    """Make an empty database a GeoPackage."""
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {GEOPACKAGE}")
    for statement in _OF_GEOPACKAGE:
        connection.execute(statement)
    connection.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", _SYSTEMS)


def register(connection: sqlite3.Connection, table: Table, srs: int = WGS84) -> None:
    """List a table for those who open the file."""
    geometry = table.geometry
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        "VALUES (?, ?, ?, ?, ?)",
        (
            table.name,
            "attributes" if geometry is None else "features",
            table.name,
            table.title,
            None if geometry is None else srs,
        ),
    )
    if geometry is not None:
        connection.execute(
            "INSERT INTO gpkg_geometry_columns VALUES (?, ?, ?, ?, 0, 0)",
            (table.name, geometry.name, geometry.kind, srs),
        )


def retitle(connection: sqlite3.Connection, table: Table) -> None:
    """Tell those who open the file of a table that is listed what it is now."""
    connection.execute(
        "UPDATE gpkg_contents SET description = ? WHERE table_name = ?", (table.title, table.name)
    )


def write_layers(
    path: Path,
    tables: Sequence[Table],
    rows_of: Mapping[str, Iterable[Row]],
    styles: Mapping[str, str],
    *,
    on_globe: bool,
) -> None:
    """Write a GeoPackage that holds these tables, how QGIS draws them, and nothing else.

    Args:
        path: Of a file that is not there.
        tables: Their columns.
        rows_of: By table; `geom` is well-known binary.
        styles: By table, as QGIS writes them (QML).
        on_globe: Places are longitude and latitude; else metres of no known system.

    Raises:
        OSError: It could not be written.
    """
    srs = WGS84 if on_globe else -1
    try:
        with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            begin_file(connection)
            for table in tables:
                for statement in statements(table, extends=False):
                    connection.execute(statement)
                register(connection, table, srs)
                for row in rows_of[table.name]:
                    insert(connection, table.name, row, srs)
            connection.execute(_OF_STYLES)
            connection.execute(
                "INSERT INTO gpkg_contents (table_name, data_type, identifier) "
                "VALUES ('layer_styles', 'attributes', 'layer_styles')"
            )
            connection.executemany(
                "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, "
                "styleName, styleQML, styleSLD, useAsDefault, description, owner) "
                "VALUES ('', '', ?, 'geom', ?, ?, '', 1, '', '')",
                [(name, name, style) for name, style in styles.items()],
            )
            connection.execute("COMMIT")
    except sqlite3.DatabaseError as error:
        raise OSError(errno.EIO, str(error), str(path)) from error


def insert(connection: sqlite3.Connection, table: str, row: Row, srs: int = WGS84) -> int:
    """Add a row; its key."""
    marks = ", ".join("?" * len(row))
    done = connection.execute(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({marks})", _values(row, srs))
    return int(done.lastrowid or 0)


def _values(row: Row, srs: int = WGS84) -> list[Any]:
    """As a GeoPackage holds them."""
    return [header(value, srs) + value if name == "geom" else value for name, value in row.items()]


def document(found: Sequence[Any], number: int, where: str) -> Survey:
    """The survey of a row of digest and body.

    Raises:
        ValueError: The body is not what was added.
    """
    kept, body = found
    data = bytes(body)
    if digest(data) != kept:
        raise ValueError(f"{where}: survey {number}: expected what was added, got damaged content")
    return files.loaded(data, f"{where}: survey {number}")
