"""The file of a survey: what was written is what is read, and nothing damaged comes in."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.survey import Measure, Patch, Survey, files
from dream.types import Reasoning
from tests.survey.scenes import raised_wreck, reef, wreck


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit, in type too."""
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes())
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


@pytest.mark.parametrize(
    "survey",
    [reef(), reef(site=None), wreck(), raised_wreck()],
    ids=["reef", "nowhere", "wreck", "in space"],
)
def test_what_was_written_is_what_is_read(survey: Survey, tmp_path: Path) -> None:
    path = tmp_path / f"one{files.SUFFIX}"
    files.write(survey, path)
    assert same(files.read(path), survey)
    assert [left.name for left in tmp_path.iterdir()] == [path.name]


def test_the_same_survey_gives_the_same_bytes() -> None:
    data = files.dumped(reef())
    assert files.dumped(reef()) == data
    assert files.dumped(files.loaded(data, "it")) == data


def test_numpy_reads_the_arrays_of_a_file(tmp_path: Path) -> None:
    survey = reef()
    files.write(survey, tmp_path / "one.npz")
    with np.load(tmp_path / "one.npz", allow_pickle=False) as arrays:
        assert np.array_equal(arrays["individuals.position"], survey.individuals.position)


def test_what_a_model_said_is_kept_to_the_letter() -> None:
    survey = reef()
    odd = replace(survey.decisions[0], reasoning=Reasoning(action="“größer”\x00\n\u2028 🦪"))
    kept = files.loaded(files.dumped(replace(survey, decisions=(odd,))), "it")
    assert kept.decisions == (odd,)


def _with(part: str, **changes: Any) -> Callable[[Survey], Survey]:
    return lambda survey: replace(survey, **{part: replace(getattr(survey, part), **changes)})


def _individual(name: str, value: Any) -> Callable[[Survey], Survey]:
    def change(survey: Survey) -> Survey:
        array = getattr(survey.individuals, name).copy()
        array[0] = value
        return replace(survey, individuals=replace(survey.individuals, **{name: array}))

    return change


def _ring(change: Callable[[Any], Any]) -> Callable[[Survey], Survey]:
    return lambda survey: replace(survey, patches=(Patch((change(survey.patches[0].rings[0]),), ()),) * 2)


INCONSISTENT: dict[str, tuple[Callable[[Survey], Survey], str]] = {
    "a place that is no number": (_individual("position", math.nan), "individuals.position: expected finite"),
    "a place far away": (_individual("position", 1e9), "individuals.position: expected metres within"),
    "one place too few": (
        lambda s: replace(s, individuals=replace(s.individuals, position=s.individuals.position[1:])),
        "individuals.position: expected shape",
    ),
    "more hits than looks": (_individual("hits", 30_000), "individuals.hits: expected 0 to as many"),
    "surer than sure": (_individual("confidence", 1.01), "individuals.confidence: expected 0 to 1"),
    "a negative size": (_individual("size", -0.1), "individuals.size: expected 0 or more"),
    "of no patch": (_individual("patch", 7), "individuals.patch: expected −1 to 1"),
    "maps of another shape": (
        _with("layers", state=np.zeros((3, 3), np.uint8)),
        "layers.state: expected shape",
    ),
    "cells that do not fit": (_with("layers", cell=0.3), "layers.bounds: expected"),
    "an unknown state": (
        lambda s: _with("layers", state=np.full_like(s.layers.state, 9))(s),
        "layers.state: expected values",
    ),
    "halves of counts": (
        lambda s: _with("layers", times_seen=s.layers.times_seen + 0.5)(s),
        "layers.times_seen: expected values of uint16",
    ),
    "counts that do not fit": (
        lambda s: _with("layers", times_seen=np.full(s.layers.state.shape, 70_000))(s),
        "layers.times_seen: expected values of uint16",
    ),
    "an open ring": (_ring(lambda ring: ring[:-1]), "expected a last point that is the first"),
    "an outline the wrong way round": (
        _ring(lambda ring: ring[::-1]),
        "expected an outline counter-clockwise",
    ),
    "a ring of three points": (_ring(lambda ring: ring[[0, 1, 0]]), "rings"),
    "an interval upside down": (
        lambda s: replace(s, measures=(Measure("density", 1.0, 2.0, 0.5, "1/m2"),)),
        "density: expected an interval",
    ),
    "half an interval": (
        lambda s: replace(s, measures=(Measure("density", 1.0, None, 2.0, "1/m2"),)),
        "density: expected an interval",
    ),
    "no number as a value": (
        lambda s: replace(s, measures=(Measure("density", math.nan, 1.0, 2.0, "1/m2"),)),
        "value: Input should be a finite number",
    ),
    "a time without a zone": (lambda s: replace(s, began=s.began.replace(tzinfo=None)), "began"),
    "no name": (lambda s: replace(s, name=""), "name"),
    "made by what JSON cannot hold": (lambda s: replace(s, made_by={"seed": math.inf}), "JSON"),
}


@pytest.mark.parametrize("case", INCONSISTENT)
def test_an_inconsistent_survey_is_not_written(case: str, tmp_path: Path) -> None:
    change, complaint = INCONSISTENT[case]
    path = tmp_path / "one.npz"
    files.write(reef(), path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=complaint.replace("(", r"\(")):
        files.write(change(reef()), path)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "one.npz"
    files.write(reef(), path)
    before = path.read_bytes()

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"could not write .*one\.npz \(No space left on device\)"):
        files.write(wreck(), path)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def older(path: Path, *, leave: bool = False) -> None:
    """Make a file one of version 1, which did not hold whose sizes are their own; or say so alone."""
    with zipfile.ZipFile(path) as file:
        held = {name: file.read(name) for name in file.namelist()}
    header = json.loads(held["header.json"])
    held["header.json"] = json.dumps({**header, "version": 1}).encode()
    if not leave:
        del held["individuals.clear.npy"]
    with zipfile.ZipFile(path, "w") as file:
        for name, content in held.items():
            file.writestr(name, content)


def test_a_file_of_an_older_version_is_read_and_nothing_is_made_up(tmp_path: Path) -> None:
    path = tmp_path / "one.npz"
    files.write(reef(), path)
    older(path)
    found = files.read(path)
    assert not found.individuals.clear.any()
    assert files.dumped(found) == files.dumped(_with("individuals", clear=np.zeros(60, np.bool_))(reef()))
    files.write(reef(), path)
    older(path, leave=True)
    with pytest.raises(ValueError, match="version: expected the arrays of 1, got those of another"):
        files.read(path)


@pytest.mark.parametrize("version", [1, 2])
def test_of_a_file_that_lacks_an_array_that_one_is_named(version: int, tmp_path: Path) -> None:
    path = tmp_path / "one.npz"
    files.write(reef(), path)
    if version == 1:
        older(path)
    with zipfile.ZipFile(path) as file:
        held = {name: file.read(name) for name in file.namelist() if name != "layers.relief.npy"}
    with zipfile.ZipFile(path, "w") as file:
        for name, content in held.items():
            file.writestr(name, content)
    with pytest.raises(ValueError, match=r"missing or foreign: layers\.relief\.npy\)$"):
        files.read(path)


def test_no_file_and_a_foreign_one_are_told_of(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected the file of a survey, got no file"):
        files.read(tmp_path / "none.npz")
    (tmp_path / "text").write_text("a reef")
    with pytest.raises(ValueError, match=r"text: expected the file of a survey, got a damaged or foreign"):
        files.read(tmp_path / "text")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="entries that are missing or foreign"):
        files.read(tmp_path / "other.npz")


def test_a_file_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files.write(reef(), tmp_path / "one.npz")
    monkeypatch.setattr(files, "MOST_BYTES", 1000)
    with pytest.raises(ValueError, match="expected at most 1000 bytes"):
        files.read(tmp_path / "one.npz")


def test_damage_anywhere_is_refused_or_harmless() -> None:
    """A flipped bit or a cut either raises a ValueError or changes nothing: dates in the ZIP, say."""
    data = files.dumped(reef())
    survey = files.loaded(data, "it")
    rng = np.random.default_rng(3)
    refused = 0
    for trial in range(400):
        damaged = bytearray(data)
        place = int(rng.integers(len(data)))
        if trial % 4:
            damaged[place] ^= 1 << int(rng.integers(8))
        else:
            del damaged[place:]
        try:
            assert same(files.loaded(bytes(damaged), "it"), survey)
        except ValueError as error:
            refused += 1
            assert str(error).startswith("it: ")  # noqa: PT017
    assert refused > 300


def _repacked(data: bytes, name: str, content: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(buffer, "w") as new:
        for entry in old.namelist():
            new.writestr(entry, content if entry == name else old.read(entry), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _npy(array: Any, *, pickles: bool = False) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=pickles)
    return buffer.getvalue()


def _header(**changes: Any) -> bytes:
    with zipfile.ZipFile(io.BytesIO(files.dumped(reef()))) as file:
        return json.dumps(json.loads(file.read("header.json")) | changes).encode()


@pytest.mark.parametrize(
    "entry, content, complaint",
    [
        ("layers.relief.npy", _npy(np.array([None]), pickles=True), "layers.relief.npy: expected plain"),
        ("layers.relief.npy", _npy(np.zeros((64, 80))), "layers.relief: expected an array of float32"),
        ("layers.relief.npy", _npy(np.zeros((80, 64), np.float32)), "layers.relief: expected shape"),
        ("layers.relief.npy", _npy(np.zeros((64, 80), np.float32))[:-4], "layers.relief.npy: claims"),
        ("individuals.sigma.npy", _npy(np.zeros((60, 1))), "individuals.sigma: expected shape"),
        (
            "individuals.clear.npy",
            _npy(np.full(60, 2, np.uint8).view(np.bool_)),
            "individuals.clear: expected yes or no",
        ),
        ("header.json", b"{}", "format: Field required"),
        ("header.json", b"\xff", "header"),
        ("header.json", _header(version=4), "version: Input should be 1, 2 or 3"),
        ("header.json", _header(began="0001-01-01T00:00:00+05:00"), "began: expected a year from 1900"),
        (
            "header.json",
            _header(area={"x_min": 0.0, "y_min": 0.0, "x_max": 1e300, "y_max": 1.0}),
            r"area: expected metres within",
        ),
        ("track.time.npy", _npy(np.full(13, 1e300)), "track.time: expected"),
        ("header.json", _header(cell=1e-9), "layers.bounds: expected"),
        ("header.json", _header(patches=[]), "expected"),
        ("header.json", _header(extra=1), "extra: Extra inputs are not permitted"),
    ],
)
def test_a_made_up_file_is_refused(entry: str, content: bytes, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        files.loaded(_repacked(files.dumped(reef()), entry, content), "it")


@pytest.mark.parametrize(
    "entry, content, complaint",
    [
        ("cells.side.npy", _npy(np.full(18, 6, np.uint8)), r"structures.0.cells.side: expected 0 to 5"),
        ("cells.position.npy", _npy(np.zeros((18, 2))), r"cells.position: expected shape \(18, 3\)"),
        ("cells.position.npy", _npy(np.full((18, 3), np.nan)), "cells.position: expected finite"),
        ("cells.state.npy", _npy(np.zeros(17, np.uint8)), "cells.state: expected shape"),
        ("header.json", _header(version=2), "version: expected the arrays of 2"),
        ("header.json", _header(version=3, structures=[]), "structures: expected some in version 3 alone"),
    ],
)
def test_made_up_structures_are_refused(entry: str, content: bytes, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        files.loaded(_repacked(files.dumped(raised_wreck()), entry, content), "it")


def test_a_survey_in_the_plane_says_nothing_of_structures() -> None:
    """Its file is what programs that know of none read."""
    with zipfile.ZipFile(io.BytesIO(files.dumped(wreck()))) as file:
        header = json.loads(file.read("header.json"))
        assert not any(name.startswith("cells.") for name in file.namelist())
    assert header["version"] == 2
    assert "structures" not in header


def test_an_entry_that_unpacks_to_too_much_is_not_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    data = _repacked(files.dumped(reef()), "header.json", b" " * (1 << 20))
    monkeypatch.setattr(files, "MOST_HEADER", 1 << 19)
    with pytest.raises(ValueError, match="which is too much"):
        files.loaded(data, "it")
