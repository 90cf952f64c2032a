"""Archives of surveys: both backends keep the same promises."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dream.survey import files
from dream.survey.archive import open_archive, schema
from dream.survey.archive.geopackage import GeoPackageArchive
from dream.survey.archive.schema import Column, Table
from dream.survey.globe import between, degrees
from dream.survey.site import Site
from dream.types import Reasoning
from tests.survey.scenes import SITE, reef, wreck

BACKENDS = ("geopackage", "postgis")


@pytest.fixture(params=BACKENDS)
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A place for an archive that is not begun yet."""
    if request.param == "geopackage":
        return str(tmp_path / "surveys.gpkg")
    return str(request.getfixturevalue("postgres").emptied())


def counts(where: str) -> dict[str, int]:
    """Rows of each table."""
    names = list(schema.order(schema.MIGRATIONS))
    if "://" not in where:
        database = sqlite3.connect(where)
        try:
            return {name: database.execute(f"SELECT count(*) FROM {name}").fetchone()[0] for name in names}
        finally:
            database.close()
    import psycopg

    with psycopg.connect(where) as connection:
        found = {}
        for name in names:
            rows = connection.execute(f"SELECT 1 FROM dream.{name}").fetchall()
            found[name] = len(rows)
        return found


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
    assert (entry.steps, entry.patches, entry.individuals) == (len(survey.track.time), 2, 60)
    assert entry.measures == survey.measures


def test_added_again_it_keeps_its_number(where: str) -> None:
    with open_archive(where, begin=True) as archive:
        assert archive.add(reef()) == (1, True)
        before = counts(where)
        assert archive.add(reef()) == (1, False)
        assert counts(where) == before
        assert archive.add(reef(name="another"))[1]


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
    later = (
        Table("surveys", "", (Column("weather", "text", required=False),)),
        Table("visits", "Who came", (Column("id", "id"), Column("survey_id", "integer", of="surveys"))),
    )
    for module in ("geopackage", "postgis"):
        monkeypatch.setattr(f"dream.survey.archive.{module}.MIGRATIONS", (*schema.MIGRATIONS, later))
    monkeypatch.setattr(schema, "MIGRATIONS", (*schema.MIGRATIONS, later))
    with open_archive(where) as archive:
        assert files.dumped(archive.get(1)) == files.dumped(reef())
        assert archive.add(wreck()) == (2, True)
    assert counts(where)["visits"] == 0
    monkeypatch.undo()
    with pytest.raises(ValueError, match="expected an archive of version 1 at most, got 2"):
        open_archive(where)


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


def test_a_file_of_a_stranger_calls_no_function_of_ours(kept: Path) -> None:
    with sqlite3.connect(kept) as database:
        database.execute("CREATE TRIGGER sly AFTER INSERT ON surveys BEGIN SELECT harm(); END")
    database.close()
    harmed: list[str] = []
    with GeoPackageArchive(kept) as archive:
        archive._connection.create_function("harm", 0, lambda: harmed.append("harmed"))
        with pytest.raises(ValueError, match="unsafe use of harm"):
            archive.add(replace(reef(), name="another"))
    assert harmed == []


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
