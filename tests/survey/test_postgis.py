"""What only an archive on a server has: passwords, a server that goes away, rights, geometries it can ask."""

from __future__ import annotations

import contextlib
import logging
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator

import pytest

from dream.survey import files
from dream.survey.archive import open_archive, postgis, schema
from dream.survey.archive.postgis import PostgisArchive
from dream.survey.archive.rows import Row
from tests.survey.postgres import PASSWORD, QUOTED, Server
from tests.survey.scenes import reef, wreck

psycopg = pytest.importorskip("psycopg")

NOBODY = "127.0.0.1:9"
"""Nothing listens there."""


@pytest.mark.parametrize(
    "url, complaint",
    [
        (f"postgresql://me:{QUOTED}@{NOBODY}/reef", "cannot be reached, or went away"),
        (f"postgresql://me@{NOBODY}/reef?password={QUOTED}", "cannot be reached, or went away"),
        (f"postgresql://me:{PASSWORD}@{NOBODY}/reef", "got a URL that cannot be read"),
        (f"postgresql://me:{PASSWORD.replace('/', '')}%@{NOBODY}/reef", "got a URL that cannot be read"),
        (f"postgresql://me:{QUOTED}@{NOBODY}/reef?nonsense=1", "cannot be read"),
        (f"postgresql://me:{QUOTED}@127.0.0.1:port/reef", "invalid integer value"),
        (f"mysql://me:{QUOTED}@{NOBODY}/reef", "expected a path or postgresql://"),
    ],
)
def test_no_password_is_told_in_any_error(url: str, complaint: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    with pytest.raises((OSError, ValueError), match=complaint) as caught:
        open_archive(url, begin=True)
    told = "".join(traceback.format_exception(caught.value)) + caplog.text
    # The lines of this file that a traceback quotes do not hold it either.
    for secret in (PASSWORD, QUOTED, "s3cret"):
        assert secret not in told


def test_a_wrong_password_is_told_of_and_not_repeated(postgres: Server) -> None:
    url = postgres.url("postgres", password="wr0ng")
    with pytest.raises(OSError, match="password authentication failed") as caught:
        open_archive(url)
    assert "wr0ng" not in str(caught.value)


def test_its_name_has_no_password(postgres: Server) -> None:
    with open_archive(postgres.emptied(), begin=True) as archive:
        assert archive.name == f"postgresql://surveyor@127.0.0.1:{postgres.port}/postgres"


def test_a_server_that_goes_away_is_told_of_and_nothing_is_half_written(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = postgres.emptied()
    archive = PostgisArchive(url, begin=True)
    archive.add(wreck())
    rows_of = sys.modules["dream.survey.archive.keeping"].rows

    def rows_and_then_it_dies(survey: object) -> object:
        head, others = rows_of(survey)

        class Dying(list):  # type: ignore[type-arg]
            def __iter__(self):  # type: ignore[no-untyped-def]
                postgres.stop()
                return super().__iter__()

        return head, {**others, "individuals": Dying(others["individuals"])}

    monkeypatch.setattr("dream.survey.archive.keeping.rows", rows_and_then_it_dies)
    try:
        with pytest.raises(OSError, match="the server cannot be reached, or went away") as caught:
            archive.add(reef())
        assert PASSWORD not in str(caught.value)
        with pytest.raises(OSError, match="went away"):
            archive.entries()
        archive.close()
        with pytest.raises(OSError, match="cannot be reached"):
            open_archive(url)
    finally:
        postgres.start()
    monkeypatch.undo()
    with open_archive(url) as again:
        assert [entry.number for entry in again.entries()] == [1]
        with psycopg.connect(url) as connection:
            row = connection.execute("SELECT count(*) FROM dream.measures WHERE survey_id <> 1").fetchone()
            assert row == (0,)
        number, new = again.add(reef())
        assert new
        assert files.dumped(again.get(number)) == files.dumped(reef())


@contextlib.contextmanager
def soon(most: float) -> Iterator[None]:
    """Done within so many seconds."""
    begun = time.monotonic()
    yield
    assert time.monotonic() - begun < most


STANDS_STILL = """
import os, signal, sys
from dream.survey.archive.postgis import PostgisArchive

with PostgisArchive(sys.argv[1]) as archive, archive._changing():
    print("changing", flush=True)
    os.kill(os.getpid(), signal.SIGSTOP)
"""


def test_a_writer_that_stands_still_is_not_waited_for_for_ever(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = postgres.emptied()
    with open_archive(url, begin=True) as archive:
        archive.add(reef())
    writer = subprocess.Popen([sys.executable, "-c", STANDS_STILL, url], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    assert writer.stdout.readline() == "changing\n"
    monkeypatch.setattr(postgis, "PATIENCE", 0.5)
    try:
        with open_archive(url) as archive:
            # Nobody waits to read.
            assert len(archive.entries()) == 1
            with soon(10.0), pytest.raises(OSError, match=r"has kept the archive to itself for 0\.5 s"):
                archive.add(wreck())
            writer.kill()
            writer.communicate(timeout=60.0)
            until = time.monotonic() + 10.0
            while time.monotonic() < until:
                with contextlib.suppress(OSError):
                    assert archive.add(wreck()) == (2, True)
                    break
            assert len(archive.entries()) == 2
    finally:
        writer.kill()
        writer.communicate(timeout=60.0)


def test_a_writer_that_stands_still_makes_way_for_others_and_keeps_nothing(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = postgres.emptied()
    open_archive(url, begin=True).__exit__(None, None, None)
    monkeypatch.setattr(postgis, "PATIENCE", 0.5)
    with PostgisArchive(url) as still:
        begin_survey = still._begin_survey

        def stand_still(head: Row) -> int:
            monkeypatch.setattr(postgis, "PATIENCE", 20.0)
            with open_archive(url) as other, soon(10.0):
                other.add(wreck())
            return begin_survey(head)

        monkeypatch.setattr(still, "_begin_survey", stand_still)
        with pytest.raises(OSError, match=r"but stood still for longer .* Nothing was changed"):
            still.add(reef())
    with open_archive(url) as archive:
        assert [entry.name for entry in archive.entries()] == [wreck().name]


def test_a_server_that_hangs_is_told_of_and_is_not_waited_for_for_ever(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgis, "STATEMENT", 0.5)
    monkeypatch.setattr(postgis, "MARGIN", 0.5)
    url = postgres.emptied()
    with open_archive(url, begin=True) as archive:
        archive.add(reef())
        with postgres.frozen():
            with soon(5.0), pytest.raises(OSError, match=r"went away \(it has said nothing for 1 s\)"):
                archive.entries()
            with soon(5.0), pytest.raises(OSError, match="cannot be reached, or went away"):
                open_archive(f"{url}?connect_timeout=2")
        with pytest.raises(OSError, match="went away"):
            archive.entries()
    with open_archive(url) as archive:
        assert len(archive.entries()) == 1


@pytest.mark.parametrize("step", ["_begin_survey", "_fill"])
def test_a_server_that_hangs_while_a_survey_is_added_keeps_none_of_it(
    step: str, postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgis, "STATEMENT", 0.5)
    monkeypatch.setattr(postgis, "MARGIN", 0.5)
    url = postgres.emptied()
    with contextlib.ExitStack() as hanging, PostgisArchive(url, begin=True) as archive:
        go_on = getattr(archive, step)

        def hang(*of: object) -> object:
            hanging.enter_context(postgres.frozen())
            return go_on(*of)

        monkeypatch.setattr(archive, step, hang)
        with soon(5.0), pytest.raises(OSError, match=r"said nothing for 1 s\)\. Nothing was changed"):
            archive.add(reef())
    with open_archive(url) as again:
        assert again.entries() == []


def test_what_a_server_may_have_kept_is_not_told_as_unchanged(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is asked to keep a survey, and does not answer: this one does keep it."""
    monkeypatch.setattr(postgis, "STATEMENT", 0.5)
    monkeypatch.setattr(postgis, "MARGIN", 0.5)
    url = postgres.emptied()
    with contextlib.ExitStack() as hanging, PostgisArchive(url, begin=True) as archive:
        monkeypatch.setattr(archive, "_register_change", lambda: hanging.enter_context(postgres.frozen()))
        with (
            soon(5.0),
            pytest.raises(OSError, match="may be kept or not: look with dream survey list") as told,
        ):
            archive.add(reef())
        assert "Nothing was changed" not in str(told.value)
    until = time.monotonic() + 10.0
    with open_archive(url) as again:
        while not again.entries() and time.monotonic() < until:
            time.sleep(0.05)
        assert [entry.name for entry in again.entries()] == [reef().name]


def test_a_server_that_dies_while_it_keeps_a_survey_may_have_kept_it(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = PostgisArchive(postgres.emptied(), begin=True)
    monkeypatch.setattr(archive, "_register_change", postgres.stop)
    try:
        with archive, pytest.raises(OSError, match="may be kept or not: look with dream survey list"):
            archive.add(reef())
    finally:
        postgres.start()


def test_a_server_that_takes_too_long_is_told_to_stop(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postgis, "STATEMENT", 0.5)
    url = postgres.emptied()
    with open_archive(url, begin=True) as archive:
        with psycopg.connect(url) as connection:
            connection.execute(
                "CREATE FUNCTION dream.slow() RETURNS trigger LANGUAGE plpgsql AS "
                "'BEGIN PERFORM pg_sleep(30); RETURN NEW; END'"
            )
            connection.execute(
                "CREATE TRIGGER slow BEFORE INSERT ON dream.surveys EXECUTE FUNCTION dream.slow()"
            )
        complaint = "the server gave up what it was asked for .*statement timeout.* Nothing was changed"
        with soon(5.0), pytest.raises(OSError, match=complaint):
            archive.add(reef())
        # It is there still, and so is the connection.
        assert archive.entries() == []


def test_a_database_without_postgis_and_without_the_right_to_make_it_is_told_of(postgres: Server) -> None:
    with psycopg.connect(postgres.emptied(), autocommit=True) as connection:
        connection.execute("DROP DATABASE IF EXISTS bare")
        connection.execute("DROP ROLE IF EXISTS guest")
        connection.execute("CREATE ROLE guest LOGIN PASSWORD 'guest'")
        connection.execute("CREATE DATABASE bare OWNER guest")
    url = postgres.url("bare", user="guest", password="guest")
    with pytest.raises(ValueError, match="expected a database with PostGIS, got one without"):
        open_archive(url, begin=True)
    with psycopg.connect(url) as connection:
        assert connection.execute("SELECT to_regclass('dream.surveys')").fetchone() == (None,)


def test_who_may_only_read_can_read(postgres: Server) -> None:
    with open_archive(postgres.emptied(), begin=True) as archive:
        archive.add(reef())
    with psycopg.connect(postgres.url("postgres"), autocommit=True) as connection:
        connection.execute("DROP ROLE IF EXISTS reader")
        connection.execute("CREATE ROLE reader LOGIN PASSWORD 'reader'")
        connection.execute("GRANT USAGE ON SCHEMA dream TO reader")
        connection.execute("GRANT SELECT ON ALL TABLES IN SCHEMA dream TO reader")
        with open_archive(postgres.url("postgres", user="reader", password="reader")) as archive:
            assert len(archive.entries()) == 1
            with pytest.raises(OSError, match=r"expected the right to do this there .*permission denied"):
                archive.add(wreck())
        connection.execute("DROP SCHEMA dream CASCADE")
        connection.execute("DROP ROLE reader")


def test_who_may_only_read_is_told_who_can_bring_an_older_archive_up_to_date(
    postgres: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = postgres.emptied()
    with monkeypatch.context() as then:
        then.setattr(postgis, "MIGRATIONS", schema.MIGRATIONS[:2])
        open_archive(url, begin=True).__exit__(None, None, None)
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute("DROP ROLE IF EXISTS reader")
        connection.execute("CREATE ROLE reader LOGIN PASSWORD 'reader'")
        connection.execute("GRANT USAGE ON SCHEMA dream TO reader")
        connection.execute("GRANT SELECT ON ALL TABLES IN SCHEMA dream TO reader")
        reading = postgres.url("postgres", user="reader", password="reader")
        complaint = (
            "expected an archive of version 4, got version 2 and no right to bring it up to date .*owner"
        )
        with pytest.raises(PermissionError, match=complaint):
            open_archive(reading)
        with open_archive(url), open_archive(reading) as archive:
            assert archive.entries() == []
        connection.execute("DROP SCHEMA dream CASCADE")
        connection.execute("DROP ROLE reader")


def test_postgis_measures_the_patches_as_the_survey_does(postgres: Server) -> None:
    """Square metres on the ellipsoid: holes cut out, places and sides as they were."""
    url, survey = postgres.emptied(), reef()
    with open_archive(url, begin=True) as archive:
        archive.add(survey)
    with psycopg.connect(url) as connection:
        areas = [
            row[0]
            for row in connection.execute("SELECT ST_Area(geom::geography) FROM dream.patches ORDER BY patch")
        ]
        within = connection.execute(
            """SELECT count(*) FROM dream.individuals i JOIN dream.patches p
            ON p.patch = i.patch AND p.survey_id = i.survey_id AND ST_Covers(p.geom, i.geom)"""
        ).fetchone()
    expected = [next(m.value for m in patch.measures if m.name == "area") for patch in survey.patches]
    assert areas == pytest.approx(expected, rel=1e-3)
    assert within == (60,)


def test_a_document_that_was_changed_in_the_database_is_not_handed_out(postgres: Server) -> None:
    url = postgres.emptied()
    with open_archive(url, begin=True) as archive:
        archive.add(reef())
        with psycopg.connect(url) as connection:
            connection.execute(
                "UPDATE dream.documents SET body = set_byte(body, 500, 1 + get_byte(body, 500) % 255)"
            )
        with pytest.raises(ValueError, match="survey 1: expected what was added, got damaged content"):
            archive.get(1)
        with psycopg.connect(url) as connection:
            connection.execute("DROP TABLE dream.documents")
        with pytest.raises(ValueError, match="expected an archive of surveys"):
            archive.get(1)


@pytest.mark.parametrize(
    "sql, complaint",
    [
        (
            "ALTER TABLE dream.measures RENAME TO others; "
            "CREATE VIEW dream.measures AS SELECT * FROM dream.others",
            "dream.measures, which is another thing",
        ),
        (
            "CREATE RULE sly AS ON INSERT TO dream.tracks DO INSTEAD NOTHING",
            "dream.tracks, which is another thing",
        ),
    ],
)
def test_what_is_no_table_of_an_archive_is_refused_by_name(
    postgres: Server, sql: str, complaint: str
) -> None:
    url = postgres.emptied()
    with open_archive(url, begin=True):
        pass
    with psycopg.connect(url, autocommit=True) as connection:
        for one in sql.split("; "):
            connection.execute(one.encode())
    with pytest.raises(ValueError, match=complaint):
        open_archive(url)


def test_what_a_trigger_of_the_server_takes_away_is_missed(postgres: Server) -> None:
    url = postgres.emptied()
    with open_archive(url, begin=True) as archive:
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute(
                "CREATE FUNCTION dream.sly() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RETURN NULL; END'"
            )
            connection.execute(
                "CREATE TRIGGER sly BEFORE INSERT ON dream.decisions FOR EACH ROW "
                "EXECUTE FUNCTION dream.sly()"
            )
        with pytest.raises(ValueError, match="just written, got other rows of decisions"):
            archive.add(reef())
        assert archive.entries() == []
