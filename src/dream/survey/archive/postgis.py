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

from dream import extras
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
PATIENCE = 30.0
"""Seconds to wait for another writer; to hold up others while we ask for nothing; and for a network that is
down."""
STATEMENT = 60.0
"""Seconds that the server may take for one statement."""
MIGRATION = 3600.0
"""The same of those that bring a large archive up to date, each of which changes all rows of a table."""
MARGIN = 15.0
"""Seconds beyond these after which a server that says nothing hangs."""

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
        pg = import_psycopg()
        from dream.survey.archive.patience import CONNECTING, PatientConnection

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
        options = {"connect_timeout": f"{CONNECTING:.0f}", "keepalives_idle": "10"}
        options |= {"keepalives_interval": "5", "keepalives_count": "3"}
        options |= {"tcp_user_timeout": f"{1000 * PATIENCE:.0f}"}
        with self._told():
            # Autocommit: every transaction below is a block, and none stays open between them.
            self._connection = PatientConnection.connect(**{**options, **parts}, autocommit=True)
        try:
            with self._told():
                self._wait_for_others(PATIENCE)
                self._wait_for_statements(STATEMENT)
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
        return told.entries(surveys.fetchall(), measures.fetchall(), self.name)

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

    def _read_back(self, number: int) -> tuple[str, bytes, dict[str, int]]:
        found = self._connection.execute(
            f"SELECT digest, body FROM {SCHEMA}.surveys JOIN {SCHEMA}.documents ON survey_id = id "
            "WHERE id = %s",
            (number,),
        ).fetchone()
        counts = {}
        for table in parts():
            (count,) = self._connection.execute(
                f"SELECT count(*) FROM {SCHEMA}.{table} WHERE survey_id = %s", (number,)
            ).fetchone() or (0,)
            counts[table] = int(count)
        digest, body = found or ("", b"")
        return str(digest), bytes(body), counts

    def _empty(self, number: int) -> None:
        """Take out what belongs to a survey."""
        for table in parts():
            self._connection.execute(f"DELETE FROM {SCHEMA}.{table} WHERE survey_id = %s", (number,))

    def _register_change(self) -> None:
        """Readers of a server find what is there."""

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """A transaction; of two who change surveys, the second waits, and then finds what the first did."""
        with self._told(), self._alone():
            yield

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """A transaction in which no other program changes the archive.

        Raises:
            OSError: Whether it was kept is not known.
        """
        pg = import_psycopg()
        done = False
        try:
            with self._connection.transaction():
                self._connection.execute("SELECT pg_advisory_xact_lock(%s)", (LOCK,))
                yield
                done = True
        except pg.OperationalError as error:
            if not (done and _gone(error)):
                raise
            raise OSError(
                f"{self._name}: expected the server to confirm the change, got no answer "
                f"({self._cleaned(error)}). It may be kept or not: look with dream survey list, and do again "
                "what is not there"
            ) from None

    def _wait_for_others(self, seconds: float) -> None:
        """Bound how long we wait for another writer, and how long others wait for us where we stand still."""
        for setting in ("lock_timeout", "idle_in_transaction_session_timeout"):
            self._set(setting, seconds)

    def _wait_for_statements(self, seconds: float) -> None:
        """Bound how long one statement may take, by the server's clock, and by ours where it hangs."""
        self._set("statement_timeout", seconds)
        self._connection.patience = seconds + MARGIN

    def _set(self, setting: str, seconds: float) -> None:
        self._connection.execute("SELECT set_config(%s, %s, false)", (setting, f"{1000 * seconds:.0f}ms"))

    def _migrate(self, *, begin: bool) -> None:
        version = self._version()
        if version == len(MIGRATIONS):
            return
        pg = import_psycopg()
        try:
            self._bring_up_to_date(begin=begin)
        except pg.errors.InsufficientPrivilege as error:
            if version == 0:
                raise
            raise PermissionError(
                f"{self._name}: expected an archive of version {len(MIGRATIONS)}, got version {version} and "
                f"no right to bring it up to date ({self._cleaned(error)}). Let the owner of its tables open "
                "it once, such as with dream survey list"
            ) from None

    def _bring_up_to_date(self, *, begin: bool) -> None:
        # Who comes second waits, and finds the tables made.
        with self._alone():
            version = self._version()
            if version == 0:
                if not begin:
                    raise FileNotFoundError(
                        f"{self._name}: expected an archive of surveys, got a database without. Begin one "
                        "with dream survey add"
                    )
                self._begin()
            self._wait_for_statements(MIGRATION)
            known = order(MIGRATIONS[:version])
            for number, migration in enumerate(MIGRATIONS[version:], start=version + 1):
                for table in migration.tables:
                    for statement in statements(table, extends=table.name in known):
                        self._connection.execute(statement)
                    known[table.name] = table
                for update in migration.updates:
                    self._connection.execute(update.format(schema=f"{SCHEMA}."))
                self._connection.execute(f"INSERT INTO {SCHEMA}.{VERSIONS} VALUES (%s, now())", (number,))
            self._wait_for_statements(STATEMENT)

    def _begin(self) -> None:
        pg = import_psycopg()
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
        # A view of that name, or a rule on a table, may be anybody's program.
        names = [VERSIONS, *order(MIGRATIONS)]
        other = self._connection.execute(
            "SELECT relname FROM pg_catalog.pg_class WHERE relnamespace = %s::regnamespace "
            "AND relname = ANY(%s) AND (relkind NOT IN ('r', 'p') OR relhasrules) ORDER BY relname LIMIT 1",
            (SCHEMA, names),
        ).fetchone()
        if other is not None:
            raise ValueError(
                f"{self._name}: expected an archive of surveys, which is made of tables without rules, got "
                f"{SCHEMA}.{other[0]}, which is another thing"
            )
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
        pg = import_psycopg()
        try:
            yield
        except pg.Error as error:
            words = self._cleaned(error)
            failed = _FAILED.get(error.sqlstate or "", "").format(PATIENCE)
            if not failed and isinstance(error, pg.OperationalError):
                # Refused is also what there is no room for: the server takes back what was begun.
                failed = _GONE if _gone(error) else "the server refused"
            if not failed:
                raise ValueError(
                    f"{self._name}: expected an archive of surveys, got an error of the database ({words})"
                ) from None
            raise OSError(
                f"{self._name}: {failed} ({words}). Nothing was changed; do again what was not confirmed"
            ) from None


_GONE = "the server cannot be reached, or went away"
_FAILED = {
    "25P03": "expected to go on within {:g} s, as others wait for us, but stood still for longer",
    "42501": "expected the right to do this there",
    "55P03": "another program has kept the archive to itself for {:g} s; it may hang",
    "57014": "the server gave up what it was asked for",
}
"""Errors that are no fault of the archive's content, by SQLSTATE."""


def _gone(error: Any) -> bool:
    """Does an error leave open what the server did last?"""
    return error.sqlstate is None or error.sqlstate.startswith(("08", "57"))


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


def import_psycopg() -> Any:
    """It is an extra.

    Raises:
        ValueError: It is not installed.
    """
    try:
        import psycopg
    except ImportError as error:
        raise ValueError(extras.missing("postgis", "psycopg", "an archive in PostgreSQL")) from error
    return psycopg
