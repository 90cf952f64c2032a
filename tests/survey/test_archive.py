"""Archives of surveys: both backends keep the same promises."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.survey import Survey, files
from dream.survey.archive import open_archive, schema, strangers
from dream.survey.archive.geopackage import GeoPackageArchive
from dream.survey.archive.postgis import PostgisArchive
from dream.survey.archive.rows import Row, rows
from dream.survey.archive.schema import Column, Migration, Table
from dream.survey.globe import between, degrees
from dream.survey.site import Site
from dream.types import Reasoning
from tests.survey.scenes import SITE, WRECK_SITE, reef, wreck

BACKENDS = ("geopackage", "postgis")


@pytest.fixture(params=BACKENDS)
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A place for an archive that is not begun yet."""
    if request.param == "geopackage":
        return str(tmp_path / "surveys.gpkg")
    return str(request.getfixturevalue("postgres").emptied())


def content(where: str) -> dict[str, list[tuple[Any, ...]]]:
    """All rows of each table."""
    tables = schema.order(schema.MIGRATIONS).values()
    asked = {
        table.name: f"SELECT {', '.join(column.name for column in table.columns)} FROM {{}}{table.name} "
        f"ORDER BY {table.columns[0].name}"
        for table in tables
    }
    if "://" not in where:
        with contextlib.closing(sqlite3.connect(where)) as database:
            return {name: database.execute(query.format("")).fetchall() for name, query in asked.items()}
    import psycopg

    with psycopg.connect(where) as connection:
        return {
            name: list(connection.execute(query.format("dream.").encode())) for name, query in asked.items()
        }


def counts(where: str) -> dict[str, int]:
    """Rows of each table."""
    return {name: len(rows) for name, rows in content(where).items()}


def rows_of_version_2(survey: Survey) -> tuple[Row, dict[str, list[Row]]]:
    """As that version wrote them: without how sure anything is."""
    head, others = rows(survey)
    del head["uncertainty_m"]
    for row in others["individuals"]:
        del row["clear"]
    return head, others


def of_version_1(survey: Survey) -> bytes:
    """Its file as that version wrote it: without whose sizes were measured."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(files.dumped(survey))) as file, zipfile.ZipFile(made, "w") as older:
        for name in file.namelist():
            content = file.read(name)
            if name == "header.json":
                content = json.dumps({**json.loads(content), "version": 1}).encode()
            if name != "individuals.clear.npy":
                older.writestr(name, content)
    return made.getvalue()


def of_run(survey: Survey, run: str = "a" * 64) -> Survey:
    """The survey as measured of a run whose steps are known."""
    return replace(survey, made_by={**survey.made_by, "run": run})


def test_what_was_added_comes_back_to_the_last_bit(where: str) -> None:
    with open_archive(where, begin=True) as archive:
        first, second = archive.add(reef()), archive.add(wreck())
        assert (first, second) == ((1, True), (2, True))
    with open_archive(where) as archive:
        assert files.dumped(archive.get(1)) == files.dumped(reef())
        assert files.dumped(archive.get(2)) == files.dumped(wreck())


def test_the_list_tells_what_is_there(where: str) -> None:
    survey = reef()
    with open_archive(where, begin=True) as archive:
        archive.add(survey)
        (entry,) = archive.entries()
    assert (entry.number, entry.name, entry.site) == (1, survey.name, "Inner reef")
    assert entry.began == survey.began
    assert (entry.target, entry.protocol) == ("oysters", "dream-v1")
    assert (entry.steps, entry.patches, entry.individuals) == (len(survey.decisions), 2, 60)
    assert entry.measures == survey.measures


def test_added_again_it_keeps_its_number(where: str) -> None:
    with open_archive(where, begin=True) as archive:
        assert archive.add(reef()) == (1, True)
        before = counts(where)
        assert archive.add(reef()) == (1, False)
        assert counts(where) == before
        assert archive.add(reef(name="another"))[1]


def test_another_survey_of_a_run_that_is_there_is_refused_by_its_number(where: str) -> None:
    survey = of_run(reef())
    with open_archive(where, begin=True) as archive:
        archive.add(wreck())
        assert archive.add(survey) == (2, True)
        before = content(where)
        assert archive.add(survey) == (2, False)
        copied = replace(survey, name="a copy under another name", began=survey.began + timedelta(days=9))
        with pytest.raises(ValueError, match=r"got that of survey 2 \(2026-06-01T09-30_inner-reef\)"):
            archive.add(copied)
        assert content(where) == before
        assert archive.add(of_run(survey, "b" * 64)) == (3, True)


def test_a_run_that_an_older_version_kept_is_known_by_name_and_time(where: str) -> None:
    with open_archive(where, begin=True) as archive:
        assert archive.add(reef()) == (1, True)
        for again in (of_run(reef()), replace(reef(), made_by={"version": "another"})):
            with pytest.raises(ValueError, match=r"got that of survey 1 .* --replace 1"):
                archive.add(again)
        assert archive.add(replace(of_run(reef()), began=reef().began + timedelta(seconds=1)))[1]
        assert archive.add(of_run(reef(name="another"), "b" * 64))[1]


def test_a_survey_takes_the_place_of_another_one_of_its_run(where: str) -> None:
    """With the number, as if the other had never been there."""
    better = of_run(reef(site=replace(SITE, latitude=10.0)))
    with open_archive(where, begin=True) as archive:
        archive.add(wreck())
        archive.add(of_run(reef(name="a copy")))
        archive.add(reef(name="another"))
        before = content(where)
        assert archive.replace(2, better)
        assert files.dumped(archive.get(2)) == files.dumped(better)
        after = content(where)
        assert not archive.replace(2, better)
        assert content(where) == after
        assert [entry.number for entry in archive.entries()] == [1, 2, 3]
    key = {table: 0 if table == "documents" else 1 for table in before}
    columns = {name: table.columns for name, table in schema.order(schema.MIGRATIONS).items()}

    def but_places(table: str, rows: list[tuple[Any, ...]]) -> list[list[Any]]:
        return [
            [one for one, column in zip(row, columns[table], strict=True) if not column.is_geometry][2:]
            for row in rows
            if row[key[table]] == 2
        ]

    for table, them in before.items():
        if table == "surveys":
            assert [row for row in after[table] if row[0] != 2] == [row for row in them if row[0] != 2]
            continue
        of = key[table]
        assert [row for row in after[table] if row[of] != 2] == [row for row in them if row[of] != 2]
        assert but_places(table, after[table]) == but_places(table, them)


def test_a_survey_does_not_take_the_place_of_another_run(where: str) -> None:
    track = replace(reef().track, position=reef().track.position + 0.5)
    elsewhere = replace(reef(name="elsewhere"), track=track)
    with open_archive(where, begin=True) as archive:
        archive.add(of_run(reef()))
        archive.add(of_run(wreck(), "b" * 64))
        archive.add(reef(name="of an older version"))
        before = content(where)
        for number, survey, complaint in (
            (1, of_run(reef(name="other"), "c" * 64), "--replace 1: expected another measurement of the run"),
            (1, of_run(wreck(), "b" * 64), "got that of survey 2"),
            (2, of_run(reef()), "got that of survey 1"),
            (3, elsewhere, "--replace 3: expected another measurement of the run"),
            (7, of_run(reef()), r"got 7\. There are: 1, 2, 3\."),
            (1, replace(of_run(reef()), site=None), "run without origin"),
        ):
            with pytest.raises(ValueError, match=complaint):
                archive.replace(number, survey)
            assert content(where) == before
        # That of an older version: the same places at the same times, whatever it was called.
        assert archive.replace(3, of_run(reef(name="renamed"), "d" * 64))


def test_a_survey_is_removed_with_all_that_belongs_to_it_and_with_nothing_else(where: str) -> None:
    with open_archive(where, begin=True) as archive:
        archive.add(wreck())
        alone = content(where)
        archive.add(reef())
        entry = archive.remove(2)
        assert (entry.number, entry.name, entry.began) == (2, reef().name, reef().began)
        assert content(where) == alone
        with pytest.raises(ValueError, match=r"got 2\. There are: 1\. See dream survey list"):
            archive.remove(2)
        # No number is given twice.
        assert archive.add(reef()) == (3, True)
        archive.remove(1)
        archive.remove(3)
        with pytest.raises(ValueError, match=r"got 3\. There are: none\."):
            archive.remove(3)
    assert set(counts(where).values()) == {0}


@pytest.mark.parametrize("what", ["replace", "remove"])
def test_what_fails_on_the_way_leaves_the_survey_that_was_there(
    what: str, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_archive(where, begin=True) as archive:
        archive.add(of_run(reef()))
        before = content(where)
        backend = "postgis" if "://" in where else "geopackage"
        monkeypatch.setattr(f"dream.survey.archive.{backend}.parts", lambda: [*schema.parts(), "no_table"])
        with pytest.raises(ValueError, match="no_table"):
            archive.replace(1, of_run(reef(name="renamed"))) if what == "replace" else archive.remove(1)
        assert content(where) == before
        monkeypatch.undo()
        archive.remove(1)


def test_steps_and_patches_are_numbered_as_in_reports(where: str) -> None:
    survey = reef()
    with open_archive(where, begin=True) as archive:
        archive.add(survey)
    _numbered_as_in_reports(where, survey)


def _numbered_as_in_reports(where: str, survey: Survey) -> None:
    found = content(where)
    columns = {name: table.columns for name, table in schema.order(schema.MIGRATIONS).items()}
    named = {
        name: [dict(zip((column.name for column in columns[name]), row, strict=True)) for row in found[name]]
        for name in found
    }
    assert [row["steps"] for row in named["surveys"]] == [len(survey.decisions)]
    assert [row["step"] for row in named["decisions"]] == [one.step for one in survey.decisions]
    assert [row["patch"] for row in named["patches"]] == [1, 2]
    assert [row["patch"] for row in named["individuals"]] == (survey.individuals.patch + 1).tolist()
    kept = [(row["patch"], row["name"], row["value"]) for row in named["measures"]]
    assert kept == [
        *((None, one.name, one.value) for one in survey.measures),
        *((k, one.name, one.value) for k, patch in enumerate(survey.patches, 1) for one in patch.measures),
    ]


def test_an_archive_that_counted_otherwise_tells_the_same_as_a_new_one(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As version 1 wrote it: steps with the first look, patches from 0, no runs, nor how sure anything is."""

    def as_then(survey: Survey) -> tuple[Row, dict[str, list[Row]]]:
        head, others = rows_of_version_2(survey)
        del head["run"]
        for table in ("measures", "patches", "individuals"):
            others[table] = [
                {**row, "patch": None if row["patch"] is None else row["patch"] - 1} for row in others[table]
            ]
        return {**head, "steps": len(survey.track.time)}, others

    there = f"dream.survey.archive.{'postgis' if '://' in where else 'geopackage'}"
    individuals = reef().individuals
    patch = np.where(np.arange(60) == 7, -1, individuals.patch).astype(np.int32)
    survey = replace(reef(), individuals=replace(individuals, patch=patch))
    with monkeypatch.context() as then:
        then.setattr(f"{there}.MIGRATIONS", schema.MIGRATIONS[:1])
        then.setattr("dream.survey.archive.keeping.rows", as_then)
        for archive_of in (GeoPackageArchive, PostgisArchive):
            then.setattr(archive_of, "_of_its_run", lambda self, head: [])
        with open_archive(where, begin=True) as archive:
            archive.add(survey)
    with open_archive(where) as archive:
        assert files.dumped(archive.get(1)) == files.dumped(survey)
        assert archive.entries()[0].steps == len(survey.decisions)
    migrated = content(where)
    with open_archive(where) as archive:
        archive.remove(1)
        archive.add(replace(survey, name="another"))
    fresh = content(where)
    for table in ("measures", "patches"):
        assert [row[2:] for row in migrated[table]] == [row[2:] for row in fresh[table]]
    assert [row[2:-1] for row in migrated["individuals"]] == [row[2:-1] for row in fresh["individuals"]]
    assert {row[-1] for row in migrated["individuals"]} == {None}
    assert [row[-1] for row in fresh["individuals"]] == individuals.clear.tolist()


def titles(where: str) -> dict[str, str]:
    """What those who open the archive read of each table."""
    if "://" not in where:
        with contextlib.closing(sqlite3.connect(where)) as database:
            return dict(database.execute("SELECT table_name, description FROM gpkg_contents"))
    import psycopg

    with psycopg.connect(where) as connection:
        return dict(
            connection.execute(
                "SELECT relname, obj_description(pg_class.oid) FROM pg_class JOIN pg_namespace ON "
                "pg_namespace.oid = relnamespace WHERE nspname = 'dream' AND relkind = 'r'"
            ).fetchall()
        )


def test_an_archive_that_is_brought_up_to_date_says_of_its_tables_what_a_new_one_says(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = f"dream.survey.archive.{'postgis' if '://' in where else 'geopackage'}"
    first, *others = schema.MIGRATIONS
    of_then = tuple(replace(table, title="as it was") for table in first.tables)
    with monkeypatch.context() as then:
        then.setattr(f"{there}.MIGRATIONS", (replace(first, tables=of_then),))
        open_archive(where, begin=True).__exit__(None, None, None)
    assert titles(where)["individuals"] == "as it was"
    with open_archive(where):
        told = titles(where)
    renewed = {table.name: table.title for migration in others for table in migration.tables}
    assert "clear" in renewed["individuals"]
    assert {name: told[name] for name in renewed} == renewed


def test_a_file_of_an_older_version_says_of_no_individual_whether_its_size_is_its_own(where: str) -> None:
    older = files.loaded(of_version_1(reef()), "it")
    with open_archive(where, begin=True) as archive:
        assert archive.add(older) == (1, True)
        assert archive.add(wreck()) == (2, True)
        assert {row[-1] for row in content(where)["individuals"]} == {None}
        assert archive.replace(1, of_run(reef()))
    assert [row[-1] for row in content(where)["individuals"]] == reef().individuals.clear.tolist()


def test_an_older_survey_added_again_keeps_its_number(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file that the archive keeps of it has other bytes than it would have now."""
    older = of_version_1(of_run(reef()))
    with monkeypatch.context() as then:
        then.setattr(files, "dumped", lambda survey: older)
        with open_archive(where, begin=True) as archive:
            archive.add(of_run(reef()))
    before = content(where)
    with open_archive(where) as archive:
        assert archive.add(files.loaded(older, "it")) == (1, False)
        assert not archive.replace(1, files.loaded(older, "it"))
        assert content(where) == before
        with pytest.raises(ValueError, match="got that of survey 1"):
            archive.add(of_run(reef()))
        assert archive.replace(1, of_run(reef()))


def test_what_was_said_of_older_files_whose_sizes_nobody_knows_is_taken_back(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Version 3 called them means; sizes that were measured, or not told at all, stay as they are."""
    there = f"dream.survey.archive.{'postgis' if '://' in where else 'geopackage'}"

    def as_then(survey: Survey) -> tuple[Row, dict[str, list[Row]]]:
        head, others = rows(survey)
        return head, {
            **others,
            "individuals": [{**row, "clear": row["clear"] or 0} for row in others["individuals"]],
        }

    none = np.zeros(60, np.bool_)
    unsized = tuple(
        replace(one, value=None, low=None, high=None) if one.name == "median_size" else one
        for one in reef().measures
    )
    with monkeypatch.context() as then:
        then.setattr(f"{there}.MIGRATIONS", schema.MIGRATIONS[:3])
        then.setattr("dream.survey.archive.keeping.rows", as_then)
        with open_archive(where, begin=True) as archive:
            archive.add(reef())
            archive.add(files.loaded(of_version_1(of_run(reef(name="older"))), "it"))
            archive.add(
                replace(
                    of_run(reef(name="few"), "b" * 64),
                    measures=unsized,
                    individuals=replace(reef().individuals, clear=none),
                )
            )
    with open_archive(where):
        found = content(where)["individuals"]
    clear = {number: [row[-1] for row in found if row[1] == number] for number in (1, 2, 3)}
    assert clear == {1: reef().individuals.clear.tolist(), 2: [None] * 60, 3: [0] * 60}


def test_the_tables_hold_a_row_for_everything(where: str) -> None:
    survey = reef()
    with open_archive(where, begin=True) as archive:
        archive.add(survey)
    measures = len(survey.measures) + sum(len(patch.measures) for patch in survey.patches)
    assert counts(where) == {
        "surveys": 1,
        "documents": 1,
        "measures": measures,
        "patches": 2,
        "individuals": 60,
        "tracks": 1,
        "decisions": len(survey.decisions),
    }


def test_an_archive_that_was_not_begun_is_not_made_by_reading(where: str, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="Begin one with dream survey add"):
        open_archive(where)
    assert list(tmp_path.iterdir()) == []


def test_a_number_that_is_not_there_is_told_of(where: str) -> None:
    with open_archive(where, begin=True) as archive, pytest.raises(ValueError, match="got 7"):
        archive.get(7)


def test_a_survey_of_nowhere_is_not_kept(where: str) -> None:
    with open_archive(where, begin=True) as archive:
        with pytest.raises(ValueError, match="run without origin"):
            archive.add(reef(site=None))
        assert archive.entries() == []


def test_of_a_survey_that_fails_on_the_way_nothing_stays(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_archive(where, begin=True) as archive:
        archive.add(wreck())
        before = counts(where)
        survey = reef()
        # The last table refuses it: a required column is empty.
        broken = replace(survey.decisions[-1], time=None)  # type: ignore[arg-type]
        monkeypatch.setattr(files, "dumped", lambda survey: survey.name.encode())
        with pytest.raises(ValueError, match="archive"):
            archive.add(replace(survey, decisions=(*survey.decisions[:-1], broken)))
        assert counts(where) == before
        monkeypatch.undo()
        assert archive.add(survey)[1]


def test_words_that_no_table_takes_are_replaced_there_and_kept_in_the_survey(where: str) -> None:
    said = replace(reef().decisions[0], reasoning=Reasoning(action="go\x00 “on” 🦪'; DROP TABLE surveys; --"))
    survey = replace(reef(), decisions=(said,))
    with open_archive(where, begin=True) as archive:
        archive.add(survey)
        assert archive.get(1).decisions == (said,)


def test_an_older_archive_is_brought_up_to_date_with_all_that_is_in_it(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_archive(where, begin=True) as archive:
        archive.add(reef())
    later = Migration(
        (
            Table("surveys", "", (Column("weather", "text", required=False),)),
            Table("visits", "Who came", (Column("id", "id"), Column("survey_id", "integer", of="surveys"))),
        ),
        ("UPDATE {schema}surveys SET weather = 'calm'",),
    )
    for module in ("geopackage", "postgis"):
        monkeypatch.setattr(f"dream.survey.archive.{module}.MIGRATIONS", (*schema.MIGRATIONS, later))
    monkeypatch.setattr(schema, "MIGRATIONS", (*schema.MIGRATIONS, later))
    with open_archive(where) as archive:
        assert files.dumped(archive.get(1)) == files.dumped(reef())
        assert archive.add(wreck()) == (2, True)
        assert archive.remove(1).name == reef().name
    assert counts(where)["visits"] == 0
    assert [row[-1] for row in content(where)["surveys"]] == [None]
    monkeypatch.undo()
    with pytest.raises(ValueError, match="expected an archive of version 4 at most, got 5"):
        open_archive(where)


def test_an_older_archive_that_cannot_be_written_to_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "surveys.gpkg"
    with monkeypatch.context() as then:
        then.setattr("dream.survey.archive.geopackage.MIGRATIONS", schema.MIGRATIONS[:2])
        then.setattr("dream.survey.archive.keeping.rows", rows_of_version_2)
        with open_archive(str(path), begin=True) as archive:
            archive.add(reef())
    before = path.read_bytes()
    connect: Any = sqlite3.connect

    def unwritable(database: Any, **options: Any) -> Any:
        if database == path:
            return connect(f"file:{path}?mode=ro", uri=True, **options)
        return connect(database, **options)

    monkeypatch.setattr(sqlite3, "connect", unwritable)
    with open_archive(str(path)) as archive:
        assert [entry.name for entry in archive.entries()] == [reef().name]
        assert files.dumped(archive.get(1)) == files.dumped(reef())
        for change in (lambda: archive.add(wreck()), lambda: archive.remove(1)):
            with pytest.raises(OSError, match=r"surveys\.gpkg: expected an archive that can be written"):
                change()
        assert len(archive.entries()) == 1
    assert path.read_bytes() == before


ADDS = """
import sys
from dataclasses import replace
from dream.survey.archive import open_archive
from tests.survey.scenes import reef

where, writer, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
survey = reef()
for k in range(count):
    with open_archive(where, begin=True) as archive:
        number, new = archive.add(replace(survey, name=f"{writer}-{k}"))
    print(number, f"{writer}-{k}", flush=True)
"""


def _writer(where: str, name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", ADDS, where, name, str(count)], stdout=subprocess.PIPE, text=True
    )


@pytest.mark.rare
def test_writers_at_once_lose_nothing(where: str) -> None:
    """They even begin the archive at once."""
    writers = [_writer(where, f"writer{k}", 5) for k in range(3)]
    said = [line.split() for writer in writers for line in writer.communicate(timeout=120)[0].splitlines()]
    assert [writer.returncode for writer in writers] == [0, 0, 0]
    with open_archive(where) as archive:
        assert {entry.number: entry.name for entry in archive.entries()} == {
            int(number): name for number, name in said
        }
    assert len({number for number, _ in said}) == 15


@pytest.mark.rare
def test_a_writer_that_is_killed_loses_nothing_that_it_said_it_kept(where: str) -> None:
    rng = random.Random(5)
    said: dict[str, int] = {}
    writers = [_writer(where, f"writer{k}", 1000) for k in range(3)]
    for writer in writers:
        assert writer.stdout is not None
        number, name = writer.stdout.readline().split()
        said[name] = int(number)
    for writer in writers:
        time.sleep(rng.uniform(0.0, 0.1))
        writer.send_signal(signal.SIGKILL)
    for writer in writers:
        assert writer.stdout is not None
        lines = [line.split() for line in writer.stdout.read().splitlines()]
        writer.wait(60.0)
        writer.stdout.close()
        said |= {words[1]: int(words[0]) for words in lines if len(words) == 2}
    with open_archive(where) as archive:
        entries = {entry.name: entry.number for entry in archive.entries()}
        assert said.items() <= entries.items()
        assert len(entries) - len(said) <= len(writers)  # One each may be kept and not said.
        for kept_as in entries.values():
            archive.get(kept_as)
        assert archive.add(reef(name="after"))[1]
    found, one = counts(where), len(reef().decisions)
    assert found["individuals"] == 60 * found["surveys"]
    assert found["decisions"] == one * found["surveys"]
    assert found["documents"] == found["tracks"] == found["surveys"]


def test_of_writers_who_add_one_run_at_once_one_keeps_it(where: str) -> None:
    for run in "abc":
        begin = threading.Barrier(4)

        def add(k: int, run: str = run, begin: threading.Barrier = begin) -> bool:
            with open_archive(where, begin=True) as archive:
                begin.wait(30.0)
                try:
                    return archive.add(of_run(reef(name=f"copy {k} of {run}"), run))[1]
                except ValueError as error:
                    assert "expected a run that is not in the archive" in str(error)  # noqa: PT017
                    return False

        with ThreadPoolExecutor(4) as pool:
            assert sum(pool.map(add, range(4))) == 1
    assert counts(where)["surveys"] == 3


REPLACES = """
import sys
from dataclasses import replace
from dream.survey.archive import open_archive
from tests.survey.scenes import reef

print("ready", flush=True)
with open_archive(sys.argv[1]) as archive:
    for k in range(1000):
        archive.replace(1, reef(name=f"turn {k % 2}"))
        print(k, flush=True)
"""


@pytest.mark.rare
def test_a_replacement_that_is_killed_leaves_one_whole_survey(where: str) -> None:
    rng = random.Random(7)
    with open_archive(where, begin=True) as archive:
        archive.add(reef())
        archive.add(wreck())
        before = counts(where)
    for _ in range(3):
        writer = subprocess.Popen([sys.executable, "-c", REPLACES, where], stdout=subprocess.PIPE, text=True)
        assert writer.stdout is not None
        assert [writer.stdout.readline() for _ in range(3)] == ["ready\n", "0\n", "1\n"]
        time.sleep(rng.uniform(0.0, 0.05))
        writer.send_signal(signal.SIGKILL)
        writer.communicate(timeout=60.0)
        with open_archive(where) as archive:
            assert files.dumped(archive.get(1)) in [files.dumped(reef(name=f"turn {k}")) for k in range(2)]
            assert files.dumped(archive.get(2)) == files.dumped(wreck())
        assert counts(where) == before


# --- The GeoPackage


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    path = tmp_path / "surveys.gpkg"
    with open_archive(str(path), begin=True) as archive:
        archive.add(reef())
    return path


def test_the_file_is_a_geopackage_1_3(kept: Path) -> None:
    data = kept.read_bytes()
    assert data[:16] == b"SQLite format 3\x00"
    assert data[68:72] == b"GPKG"
    assert int.from_bytes(data[60:64], "big") == 10_300
    database = sqlite3.connect(kept)
    assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert database.execute("PRAGMA foreign_key_check").fetchall() == []
    systems = {row[0] for row in database.execute("SELECT srs_id FROM gpkg_spatial_ref_sys")}
    assert systems == {-1, 0, 4326}
    registered = dict(database.execute("SELECT table_name, data_type FROM gpkg_contents"))
    assert registered == {
        **dict.fromkeys(("surveys", "patches", "individuals", "tracks", "decisions"), "features"),
        "measures": "attributes",
    }
    kinds = dict(database.execute("SELECT table_name, geometry_type_name FROM gpkg_geometry_columns"))
    assert kinds["individuals"] == "POINT"
    (blob,) = database.execute("SELECT geom FROM individuals ORDER BY id LIMIT 1").fetchone()
    assert blob[:8] == b"GP\x00\x01" + (4326).to_bytes(4, "little")
    longitude, latitude = degrees(SITE, *reef().individuals.position[0, :2])
    assert np.frombuffer(blob, "<f8", 2, 13).tolist() == [float(longitude), float(latitude)]
    west, north = database.execute(
        "SELECT min_x, max_y FROM gpkg_contents WHERE table_name = 'surveys'"
    ).fetchone()
    assert west <= longitude <= west + 1e-3
    assert north - 1e-3 <= latitude <= north
    database.close()


def test_gdal_opens_every_layer(kept: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    layers = dict(pyogrio.list_layers(kept).tolist())
    assert layers["patches"] == "MultiPolygon"
    assert layers["measures"] is None
    for name in ("surveys", "patches", "individuals", "tracks", "decisions"):
        meta, _, geometry, _ = pyogrio.raw.read(kept, layer=name)
        assert meta["crs"] == "EPSG:4326"
        assert len(geometry) == counts(str(kept))[name]


def test_layers_lie_where_surveys_are_and_no_longer_where_they_were(kept: Path) -> None:
    def box() -> list[Any]:
        with contextlib.closing(sqlite3.connect(kept)) as database:
            (found,) = database.execute(
                "SELECT DISTINCT min_x, min_y, max_x, max_y FROM gpkg_contents WHERE srs_id IS NOT NULL"
            ).fetchall()
        return list(found)

    alone = box()
    with open_archive(str(kept)) as archive:
        archive.add(wreck())
        west, south, _, _ = box()
        assert west == alone[0]
        assert south == pytest.approx(WRECK_SITE.latitude, abs=1e-3)
        archive.replace(2, wreck(site=SITE))
        assert box()[1] == pytest.approx(SITE.latitude, abs=1e-3)
        archive.remove(2)
        assert box() == alone
        archive.remove(1)
        assert box() == [None] * 4
        archive.add(reef())
        assert box() == alone


def test_a_geometry_that_is_none_is_told_of(kept: Path) -> None:
    with contextlib.closing(sqlite3.connect(kept)) as database:
        database.execute("UPDATE surveys SET geom = 'nowhere'")
        database.commit()
    with open_archive(str(kept)) as archive, pytest.raises(ValueError, match="got a damaged file"):
        archive.add(wreck())


def test_other_files_are_refused_and_left_alone(tmp_path: Path) -> None:
    other = tmp_path / "other.gpkg"
    database = sqlite3.connect(other)
    database.execute("CREATE TABLE fish (id INTEGER)")
    database.close()
    text = tmp_path / "text.gpkg"
    text.write_text("no database at all, though long enough to be taken for the header of one")
    for path, complaint in ((other, "got another database"), (text, "got a damaged or foreign file")):
        before = path.read_bytes()
        for begin in (False, True):
            with pytest.raises(ValueError, match=complaint):
                open_archive(str(path), begin=begin)
        assert path.read_bytes() == before
    (tmp_path / "empty.gpkg").touch()
    with pytest.raises(ValueError, match="got an empty file"):
        open_archive(str(tmp_path / "empty.gpkg"))
    with pytest.raises(OSError, match="expected a place where an archive can be opened"):
        open_archive(str(tmp_path / "nowhere" / "new.gpkg"), begin=True)


ENDLESS = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 'd' AS digest, "
    "'x' AS name, 's' AS site, '2026-01-01' AS began, 't' AS target, 'p' AS protocol, "
    "1 AS steps, 1 AS patches, 1 AS individuals FROM n"
)
STRANGERS = {
    "an endless view": (
        f"ALTER TABLE surveys RENAME TO others; CREATE VIEW surveys AS {ENDLESS}",
        "the view surveys",
    ),
    "a view of another name": ("CREATE VIEW fish AS SELECT * FROM surveys", "the view fish"),
    "a trigger that ignores": (
        "CREATE TRIGGER sly BEFORE INSERT ON surveys BEGIN SELECT RAISE(IGNORE); END",
        "the trigger sly",
    ),
    "a trigger that spoils": (
        "CREATE TRIGGER sly AFTER INSERT ON documents BEGIN UPDATE documents SET body = x'00'; END",
        "the trigger sly",
    ),
    "a trigger on what tells of layers": (
        "CREATE TRIGGER sly AFTER UPDATE ON gpkg_contents BEGIN DELETE FROM surveys; END",
        "the trigger sly",
    ),
    "a virtual table": (
        "DROP TABLE decisions; CREATE VIRTUAL TABLE decisions USING fts5(survey_id, note)",
        "the virtual table decisions",
    ),
    "a column that is made up": (
        "ALTER TABLE surveys ADD COLUMN more TEXT GENERATED ALWAYS AS (hex(zeroblob(9)))",
        "surveys: expected columns that hold values, got more",
    ),
    "a column that is made up in the list of layers": (
        "ALTER TABLE gpkg_contents ADD COLUMN more INTEGER AS (min_x + 1) VIRTUAL",
        "gpkg_contents: expected columns that hold values, got more",
    ),
    "an index over what is computed": (
        "CREATE INDEX sly ON measures (hex(note))",
        "measures: expected indices over columns, got sly",
    ),
    "a table that is not there": ("DROP TABLE measures", "expected the table measures, got none"),
    "another table of that name": (
        "DROP TABLE tracks; CREATE TABLE tracks (fish TEXT)",
        "tracks: expected the column id, got none",
    ),
    "versions from a view": (
        f"DROP TABLE dream_versions; CREATE VIEW dream_versions AS SELECT i AS version FROM ({ENDLESS})",
        "the view dream_versions",
    ),
    "a version that is none": (
        "DROP TABLE dream_versions; CREATE TABLE dream_versions (version, made); "
        "INSERT INTO dream_versions VALUES ('x', '')",
        "expected the version of an archive",
    ),
    "too many tables": ("".join(f"CREATE TABLE t{n} (x);" for n in range(1000)), "more than 1000 tables"),
}


@pytest.mark.parametrize("kind", STRANGERS)
def test_what_a_strangers_file_is_beside_tables_is_refused_by_name_before_it_is_asked(
    kind: str, kept: Path
) -> None:
    script, complaint = STRANGERS[kind]
    with contextlib.closing(sqlite3.connect(kept)) as database:
        database.executescript("BEGIN;" + script + ";COMMIT")
    before = kept.read_bytes()
    for begin in (False, True):
        with pytest.raises(ValueError, match=complaint):
            open_archive(str(kept), begin=begin)
    assert kept.read_bytes() == before


REPLACING = {
    # What ON CONFLICT of a table says happens without a word.
    "ignored": ("documents", "UNIQUE (survey_id) ON CONFLICT IGNORE", "documents"),
    "thinned": ("measures", "UNIQUE (survey_id) ON CONFLICT REPLACE", "measures"),
    "swallowed": ("individuals", "UNIQUE (hits) ON CONFLICT IGNORE", "individuals"),
}


@pytest.mark.parametrize("kind", REPLACING)
def test_what_is_added_is_read_back_and_is_missed_where_it_is_not_there(kind: str, kept: Path) -> None:
    table, rule, told = REPLACING[kind]
    with contextlib.closing(sqlite3.connect(kept)) as database:
        (sql,) = database.execute("SELECT sql FROM sqlite_master WHERE name = ?", (table,)).fetchone()
        if table == "documents":
            # Full already of what a survey is to have.
            sql += "; INSERT INTO documents VALUES (2, x'00')"
        head, *rest = sql.replace("PRIMARY KEY NOT NULL", "NOT NULL", 1).split(";")
        columns = head[head.index("(") :].rstrip(")")
        database.executescript(
            f"DROP TABLE {table}; CREATE TABLE {table} {columns}, {rule});" + ";".join(rest)
        )
    before = counts(str(kept))
    with open_archive(str(kept)) as archive:
        with pytest.raises(ValueError, match=f"survey that was just written, got other rows of {told}"):
            archive.add(replace(wreck(), individuals=reef().individuals))
        assert len(archive.entries()) == 1
    assert counts(str(kept)) == before


WRONG_ROWS = {
    "steps": "UPDATE surveys SET steps = 'many'",
    "began": "UPDATE surveys SET began = 'once upon a time'",
    "site": "UPDATE surveys SET site = x'1b5b'",
    "value": "UPDATE measures SET value = 'x' WHERE patch IS NULL",
    "note": "UPDATE measures SET note = printf('%.30000c', 'x') WHERE patch IS NULL",
}


@pytest.mark.parametrize("column", WRONG_ROWS)
def test_a_row_that_holds_something_else_is_told_of(column: str, kept: Path) -> None:
    with contextlib.closing(sqlite3.connect(kept)) as database:
        database.execute(WRONG_ROWS[column])
        database.commit()
    with open_archive(str(kept)) as archive:
        with pytest.raises(ValueError, match=rf"surveys\.gpkg: {column} of a row: expected") as caught:
            archive.entries()
        assert len(str(caught.value)) < 500


FOR_EVER = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT count(*) FROM n"


def test_what_takes_longer_than_it_may_is_given_up(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that each look at it sets on."""
    now = itertools.count(0.0)
    with GeoPackageArchive(kept) as archive:
        monkeypatch.setattr(time, "monotonic", lambda: next(now))
        with pytest.raises(TimeoutError, match="one that takes longer than 60 s"), archive._told(60.0):
            archive._connection.execute(FOR_EVER).fetchall()
        assert len(archive.entries()) == 1


def test_an_interrupt_is_heard_while_an_archive_is_asked(kept: Path) -> None:
    with GeoPackageArchive(kept) as archive:
        seen: list[int] = []
        late = archive._is_late

        def interrupted() -> bool:
            seen.append(1)
            if len(seen) == 3:
                signal.raise_signal(signal.SIGINT)
            return late()

        archive._connection.set_progress_handler(interrupted, 1000)
        with pytest.raises(KeyboardInterrupt), archive._told(60.0):
            archive._connection.execute(FOR_EVER).fetchall()


def test_a_table_of_a_stranger_is_held_to_the_size_of_a_survey(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with contextlib.closing(sqlite3.connect(kept)) as database:
        database.execute("UPDATE documents SET body = zeroblob(3000000)")
        database.commit()
    monkeypatch.setitem(strangers.LIMITS, sqlite3.SQLITE_LIMIT_LENGTH, 1 << 20)
    with (
        open_archive(str(kept)) as archive,
        pytest.raises(OSError, match="larger than a row may be"),
    ):
        archive.get(1)


@pytest.mark.parametrize("name", [":memory:", "file:reef.gpkg?mode=memory", "a reef.gpkg"])
def test_an_archive_of_any_name_is_a_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with open_archive(name, begin=True) as archive:
        archive.add(reef())
    with open_archive(name) as archive:
        assert len(archive.entries()) == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_killed_beginning_leaves_nothing_or_an_archive(tmp_path: Path) -> None:
    """Killed at each of its steps: in a child, at the n-th statement."""
    script = (
        "import os, sqlite3, sys\n"
        "from dream.survey.archive.geopackage import GeoPackageArchive\n"
        "steps = [int(n) for n in sys.argv[2].split(',')]\n"
        "for n in steps:\n"
        "    if os.fork() == 0:\n"
        "        left = [n]\n"
        "        def count(*_):\n"
        "            left[0] -= 1\n"
        "            if left[0] < 0: os._exit(9)\n"
        "            return 0\n"
        "        hook = lambda name, _: count() if name.startswith(('sqlite3', 'os.', 'open')) else None\n"
        "        sys.addaudithook(hook)\n"
        "        connect = sqlite3.connect\n"
        "        def traced(*a, **k):\n"
        "            made = connect(*a, **k)\n"
        "            made.set_trace_callback(count)\n"
        "            return made\n"
        "        sqlite3.connect = traced\n"
        "        GeoPackageArchive(__import__('pathlib').Path(sys.argv[1], f'{n}.gpkg'), begin=True)\n"
        "        os._exit(0)\n"
        "    os.wait()\n"
    )
    steps = ",".join(str(n) for n in (0, 1, 2, 3, 5, 8, 13, 21, 34, 45, 50, 55, 60, 65, 70, 400))
    subprocess.run([sys.executable, "-c", script, str(tmp_path), steps], check=True)
    made = sorted(tmp_path.glob("*.gpkg"))
    assert tmp_path / "400.gpkg" in made
    assert 1 <= len(made) < 16
    for path in made:
        with open_archive(str(path)) as archive:
            assert archive.entries() == []


def test_damage_is_told_of_and_never_handed_out(kept: Path) -> None:
    """Whatever byte is hit: a clear error, or what was added to the last bit."""
    whole, survey = kept.read_bytes(), files.dumped(reef())
    rng = np.random.default_rng(11)
    told = 0
    for trial in range(120):
        damaged = bytearray(whole)
        place = int(rng.integers(len(whole)))
        if trial % 6:
            damaged[place : place + 64] = rng.bytes(64)
        else:
            del damaged[place:]
        kept.write_bytes(damaged)
        try:
            with open_archive(str(kept)) as archive:
                assert files.dumped(archive.get(1)) == survey
        except (ValueError, OSError) as error:
            told += 1
            assert str(kept) in str(error)  # noqa: PT017
    assert told > 30


@pytest.mark.parametrize("name", [b"tracks", b"patches", b"measures"])
def test_names_that_are_no_text_are_damage(kept: Path, name: bytes) -> None:
    """Python complains of them itself, without a number of SQLite's."""
    whole = kept.read_bytes()
    assert name in whole
    kept.write_bytes(whole.replace(name, b"\xff" + name[1:]))
    with pytest.raises(ValueError, match="expected an archive of surveys"):
        open_archive(str(kept)).__enter__()


def test_nothing_is_added_to_a_damaged_archive(kept: Path) -> None:
    data = bytearray(kept.read_bytes())
    database = sqlite3.connect(kept)
    page, size = (
        database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'decisions'").fetchone()[0],
        database.execute("PRAGMA page_size").fetchone()[0],
    )
    database.close()
    data[(page - 1) * size : page * size] = os.urandom(size)
    kept.write_bytes(data)
    with open_archive(str(kept)) as archive, pytest.raises(ValueError, match="damaged or foreign"):
        archive.add(wreck())
    assert kept.read_bytes() == data


def test_a_full_disk_leaves_the_archive_as_it_was(kept: Path) -> None:
    before = counts(str(kept))
    with GeoPackageArchive(kept) as archive:
        pages = archive._connection.execute("PRAGMA page_count").fetchone()[0]
        archive._connection.execute(f"PRAGMA max_page_count = {pages + 1}")
        with pytest.raises(OSError, match=r"surveys\.gpkg: could not write the archive: there is no room"):
            archive.add(wreck())
        assert len(archive.entries()) == 1
    assert counts(str(kept)) == before
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_a_disk_that_is_full_for_every_file_leaves_the_archive_as_it_was(kept: Path) -> None:
    """The system itself refuses to make any file longer, the journal too."""
    before = counts(str(kept))
    script = (
        "import resource, signal, sys\n"
        "from dream.survey.archive import open_archive\n"
        "from tests.survey.scenes import wreck\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "archive = open_archive(sys.argv[1])\n"
        "size = int(sys.argv[2])\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))\n"
        "try:\n    archive.add(wreck())\n"
        "except OSError as error:\n    print(error)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, str(kept), str(kept.stat().st_size)], capture_output=True, text=True
    )
    assert "Nothing was changed" in ended.stdout, ended.stderr
    assert counts(str(kept)) == before
    with open_archive(str(kept)) as archive:
        assert archive.add(wreck()) == (2, True)


def test_an_archive_that_may_only_be_read_can_be_read(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = sqlite3.connect
    monkeypatch.setattr(
        sqlite3, "connect", lambda path, **options: connect(f"file:{path}?mode=ro", uri=True, **options)
    )
    with open_archive(str(kept)) as archive:
        assert len(archive.entries()) == 1
        with pytest.raises(OSError, match="expected an archive that can be written"):
            archive.add(wreck())


# --- On the globe


def test_degrees_are_where_the_ellipsoid_has_them() -> None:
    """Along the equator a degree is a 360th of it; 1000 m are so many degrees."""
    longitude, latitude = degrees(Site("gulf", 0.0, 7.0), [1000.0, 0.0], [0.0, 1000.0])
    assert longitude[0] - 7.0 == pytest.approx(np.degrees(1000.0 / 6_378_137.0), rel=1e-7)
    assert latitude[0] == pytest.approx(0.0, abs=1e-12)
    # Of the meridian there: a (1 − e²).
    assert latitude[1] == pytest.approx(np.degrees(1000.0 / (6_378_137.0 * (1 - 0.00669437999014))), rel=1e-6)


@pytest.mark.parametrize(
    "of",
    [
        Site("reef", 54.9, 8.3),
        Site("reef", 54.903, 8.306, heading_deg=75.0),
        Site("reef", -33.85, 151.2, heading_deg=-20.0),
    ],
)
def test_a_point_is_at_the_same_degrees_in_both_frames(of: Site) -> None:
    to = replace(of, latitude=of.latitude - 0.002, longitude=of.longitude + 0.003, heading_deg=33.0)
    x, y = np.array([0.0, 30.0, -12.0]), np.array([0.0, 5.0, 40.0])
    T = between(to, of)
    c, s = np.cos(T.yaw), np.sin(T.yaw)
    there = degrees(to, T.x + c * x - s * y, T.y + s * x + c * y)
    here = degrees(of, x, y)
    # Both planes touch the globe at their own origins: centimetres over some hundred metres.
    assert np.abs(there[0] - here[0]).max() * 111_320.0 * np.cos(np.radians(of.latitude)) < 0.02
    assert np.abs(there[1] - here[1]).max() * 111_320.0 < 0.02
