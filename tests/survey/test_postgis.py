"""What only an archive on a server has: passwords, a server that goes away, rights, geometries it can ask."""

from __future__ import annotations

import logging
import sys
import traceback

import pytest

from dream.survey import files
from dream.survey.archive import open_archive
from dream.survey.archive.postgis import PostgisArchive
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
            with pytest.raises(ValueError, match="permission denied"):
                archive.add(wreck())
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
