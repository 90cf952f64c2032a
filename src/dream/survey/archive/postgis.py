"""An archive in PostgreSQL with PostGIS, for many writers and readers.

The tables lie in the schema `dream`. A survey is added in one transaction. Passwords are not repeated in
errors; better than in the URL they are kept in `~/.pgpass` or in PGPASSWORD, where no list of processes
shows them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any

from dream.survey.archive import entries as told
from dream.survey.archive.entries import Entry
from dream.survey.archive.geopackage import document
from dream.survey.archive.keeping import OF_ITS_RUN, Keeping, missing
from dream.survey.archive.rows import Row
from dream.survey.archive.schema import MIGRATIONS, VERSIONS, WGS84, Column, Table, order, parts
from dream.survey.survey import Survey

SCHEMA = "dream"
LOCK = 0x6472_6561_6D
"""Of the server, held while tables are made or a survey is changed: a number of our own."""
PATIENCE = 30
"""Seconds after which a server that says nothing is gone."""

_KINDS = {"integer": "bigint", "real": "double precision", "text": "text", "time": "timestamptz"}
_KINDS |= {"blob": "bytea"}


class PostgisArchive(Keeping):
    """Surveys in a database. Use it as a context, or close it."""

    def __init__(self, url: str, *, begin: bool = False) -> None:
        """Connect, and bring the tables to the present version.

        Args:
            url: Such as `postgresql://user@host:5432/database`.
            begin: Make the tables where there are none.

        Raises:
            FileNotFoundError: There are none, and none are to be made.
            OSError: The server cannot be reached.
            ValueError: The URL is none, or the tables are of a later version.
        """
        pg = _psycopg()
        if not url.startswith(("postgresql://", "postgres://")):
            scheme = url.split("://", 1)[0]
            raise ValueError(
                f"--archive: expected a path or postgresql://user@host/database, got {scheme}://…"
            )
        try:
            parts = pg.conninfo.conninfo_to_dict(url)
        except pg.ProgrammingError:
            # What cannot be read may hold a password anywhere.
            raise ValueError(
                "--archive: expected postgresql://user@host/database, got a URL that cannot be read. Are "
                "special characters of a password written as %40 and the like?"
            ) from None
        self._secrets = [str(parts[key]) for key in ("password", "sslpassword") if parts.get(key)]
        self._name = _shown(parts)
        options = {"connect_timeout": "10", "keepalives_idle": "10", "keepalives_interval": "5"}
        options |= {"keepalives_count": "3", "tcp_user_timeout": str(1000 * PATIENCE)}
        with self._told():
            # Autocommit: every transaction below is a block, and none stays open between them.
            self._connection = pg.connect(**{**options, **parts}, autocommit=True)
        try:
            with self._told():
                self._migrate(begin=begin)
        except BaseException:
            self._connection.close()
            raise

    def __enter__(self) -> PostgisArchive:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the connection back."""
        self._connection.close()

    @property
    def name(self) -> str:
        """Its URL without any password."""
        return self._name

    def entries(self) -> list[Entry]:
        """What is there, by number."""
        with self._told(), self._connection.transaction():
            # One picture of both tables, whoever writes meanwhile.
            self._connection.execute("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
            return self._entries()

    def get(self, number: int) -> Survey:
        """The survey of that number."""
        with self._told():
            found = self._connection.execute(
                f"SELECT digest, body FROM {SCHEMA}.surveys JOIN {SCHEMA}.documents ON survey_id = id "
                "WHERE id = %s",
                (number,),
            ).fetchone()
            if found is None:
                there = self._connection.execute(f"SELECT id FROM {SCHEMA}.surveys ORDER BY id").fetchall()
                raise missing(self.name, number, (one for (one,) in there))
        return document(found, number, self.name)

    def _entries(self) -> list[Entry]:
        surveys = self._connection.execute(
            f"SELECT {', '.join(told.COLUMNS)} FROM {SCHEMA}.surveys ORDER BY id"
        )
        measures = self._connection.execute(
            f"SELECT {', '.join(told.MEASURES)} FROM {SCHEMA}.measures WHERE patch IS NULL ORDER BY id"
        )
        return told.entries(surveys.fetchall(), measures.fetchall())

    def _of_its_run(self, head: Row) -> list[tuple[int, str, str]]:
        found: list[tuple[int, str, str]] = self._connection.execute(
            f"""SELECT id, digest, name FROM {SCHEMA}.surveys WHERE digest = %(digest)s OR run = %(run)s::text
            OR (name = %(name)s AND began = %(began)s AND (run IS NULL OR %(run)s::text IS NULL))
            ORDER BY id""",
            {name: head[name] for name in OF_ITS_RUN},
        ).fetchall()
        return found

    def _begin_survey(self, head: Row) -> int:
        done = self._connection.execute(
            _insert("surveys", head, " RETURNING id"), list(head.values())
        ).fetchone()
        assert done is not None
        return int(done[0])

    def _renew_survey(self, number: int, head: Row) -> None:
        marks = ", ".join(f"{name} = {_mark(name)}" for name in head)
        self._connection.execute(
            f"UPDATE {SCHEMA}.surveys SET {marks} WHERE id = %s", [*head.values(), number]
        )

    def _end_survey(self, number: int) -> None:
        self._connection.execute(f"DELETE FROM {SCHEMA}.surveys WHERE id = %s", (number,))

    def _fill(self, number: int, others: Mapping[str, list[Row]]) -> None:
        """Put in what belongs to a survey."""
        with self._connection.cursor() as cursor:
            for table, rows_of in others.items():
                if rows_of:
                    full = [{"survey_id": number, **row} for row in rows_of]
                    cursor.executemany(_insert(table, full[0]), [list(row.values()) for row in full])

    def _empty(self, number: int) -> None:
        """Take out what belongs to a survey."""
        for table in parts():
            self._connection.execute(f"DELETE FROM {SCHEMA}.{table} WHERE survey_id = %s", (number,))

    def _register_change(self) -> None:
        """Readers of a server find what is there."""

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """A transaction; of two who change surveys, the second waits, and then finds what the first did."""
        with self._told(), self._connection.transaction():
            self._connection.execute("SELECT pg_advisory_xact_lock(%s)", (LOCK,))
            yield

    def _migrate(self, *, begin: bool) -> None:
        if self._version() == len(MIGRATIONS):
            return
        with self._connection.transaction():
            # Who comes second waits, and finds the tables made.
            self._connection.execute("SELECT pg_advisory_xact_lock(%s)", (LOCK,))
            version = self._version()
            if version == 0:
                if not begin:
                    raise FileNotFoundError(
                        f"{self._name}: expected an archive of surveys, got a database without. Begin one "
                        "with dream survey add"
                    )
                self._begin()
            known = order(MIGRATIONS[:version])
            for number, migration in enumerate(MIGRATIONS[version:], start=version + 1):
                for table in migration.tables:
                    for statement in statements(table, extends=table.name in known):
                        self._connection.execute(statement)
                    known[table.name] = table
                for update in migration.updates:
                    self._connection.execute(update.format(schema=f"{SCHEMA}."))
                self._connection.execute(f"INSERT INTO {SCHEMA}.{VERSIONS} VALUES (%s, now())", (number,))

    def _begin(self) -> None:
        pg = _psycopg()
        extension = self._connection.execute("SELECT 1 FROM pg_extension WHERE extname = 'postgis'")
        if extension.fetchone() is None:
            try:
                with self._connection.transaction():
                    self._connection.execute("CREATE EXTENSION postgis")
            except pg.Error as error:
                raise ValueError(
                    f"{self._name}: expected a database with PostGIS, got one without. Let its administrator "
                    f"install PostGIS and run CREATE EXTENSION postgis ({self._cleaned(error)})"
                ) from None
        self._connection.execute(f"CREATE SCHEMA IF NOT EXISTS {SCHEMA}")
        self._connection.execute(
            f"CREATE TABLE {SCHEMA}.{VERSIONS} (version bigint PRIMARY KEY, made timestamptz NOT NULL)"
        )

    def _version(self) -> int:
        """0 of a database without an archive.

        Raises:
            ValueError: It is of a later version.
        """
        # Asked of the catalogue as of now: to_regclass may answer from before a lock was waited for.
        there = self._connection.execute(
            "SELECT 1 FROM pg_catalog.pg_tables WHERE schemaname = %s AND tablename = %s", (SCHEMA, VERSIONS)
        )
        if there.fetchone() is None:
            return 0
        found = self._connection.execute(f"SELECT max(version) FROM {SCHEMA}.{VERSIONS}").fetchone()
        version = int((found and found[0]) or 0)
        if version > len(MIGRATIONS):
            raise ValueError(
                f"{self._name}: expected an archive of version {len(MIGRATIONS)} at most, got {version}. "
                "Open it with a later dream"
            )
        return version

    def _cleaned(self, error: Exception) -> str:
        """What an error says, in one line, without a password."""
        words = " ".join(str(error).split()) or type(error).__name__
        for secret in self._secrets:
            words = words.replace(secret, "…")
        return words

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Say what the server complains of in words of the archive, and no password."""
        pg = _psycopg()
        try:
            yield
        except pg.OperationalError as error:
            # Here is also a server without room, which takes back what was begun.
            message = f"{self._name}: the server cannot be reached, or went away ({self._cleaned(error)})"
            if error.sqlstate is not None and not error.sqlstate.startswith(("08", "57")):
                message = f"{self._name}: the server refused ({self._cleaned(error)})"
            raise OSError(f"{message}. Nothing was changed; do again what was not confirmed") from None
        except pg.Error as error:
            raise ValueError(
                f"{self._name}: expected an archive of surveys, got an error of the database "
                f"({self._cleaned(error)})"
            ) from None


def statements(table: Table, *, extends: bool) -> list[str]:
    """The SQL that makes a table, or that adds its columns to the one that is there."""
    name = f"{SCHEMA}.{table.name}"
    titled = f"COMMENT ON TABLE {name} IS '{table.title}'"
    if extends:
        return [*(f"ALTER TABLE {name} ADD COLUMN {_column(column)}" for column in table.columns), titled]
    made = [f"CREATE TABLE {name} ({', '.join(_column(column) for column in table.columns)})"]
    for column in table.columns:
        if column.is_geometry:
            made.append(f"CREATE INDEX ON {name} USING gist ({column.name})")
        elif column.of and column.kind != "id":
            made.append(f"CREATE INDEX ON {name} ({column.name})")
    return [*made, titled]


def _column(column: Column) -> str:
    if column.is_geometry:
        words = [column.name, f"geometry({column.kind}, {WGS84})"]
    elif column.kind == "id":
        words = [column.name, "bigint PRIMARY KEY"]
        words += [] if column.of else ["GENERATED ALWAYS AS IDENTITY"]
    else:
        words = [column.name, _KINDS[column.kind]]
    if column.required and column.kind != "id":
        words.append("NOT NULL")
    if column.unique:
        words.append("UNIQUE")
    if column.of:
        words.append(f"REFERENCES {SCHEMA}.{column.of}(id)")
    return " ".join(words)


def _insert(table: str, row: Row, ending: str = "") -> str:
    marks = ", ".join(map(_mark, row))
    return f"INSERT INTO {SCHEMA}.{table} ({', '.join(row)}) VALUES ({marks}){ending}"


def _mark(name: str) -> str:
    """What stands for the value of a column."""
    return f"ST_GeomFromWKB(%s, {WGS84})" if name == "geom" else "%s"


def _shown(parts: dict[str, Any]) -> str:
    user = f"{parts['user']}@" if parts.get("user") else ""
    port = f":{parts['port']}" if parts.get("port") else ""
    return f"postgresql://{user}{parts.get('host', '')}{port}/{parts.get('dbname', '')}"


def _psycopg() -> Any:
    try:
        import psycopg
    except ImportError as error:
        raise ValueError(
            'an archive in PostgreSQL needs psycopg: pip install "dream-auv[postgis]"'
        ) from error
    return psycopg
