"""Marks: how strokes become them, and how they are kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from dream.teaching.marks import (
    OTHER,
    TARGET,
    UNMARKED,
    MarkSheet,
    MarkStroke,
    marked_in,
    read_marks,
    write_marks,
)

SIZE = 60, 80


def stroke(**fields: Any) -> MarkStroke:
    usual = {"picture": 0, "tool": "brush", "mark": "target", "width": 0.1, "points": [(0.5, 0.5)]}
    return MarkStroke.read(json.dumps({**usual, **fields}).encode())


def blank() -> np.ndarray:
    return np.zeros(SIZE, np.uint8)


def test_a_stroke_marks_what_it_passes_over_and_nothing_else() -> None:
    marks = stroke(points=[(0.25, 0.5), (0.75, 0.5)]).drawn(blank())
    rows, cols = np.nonzero(marks == TARGET)
    assert abs(rows.mean() - 29.5) < 0.6
    assert abs(cols.mean() - 39.5) < 0.6
    assert 7 <= np.ptp(rows) + 1 <= 10
    assert 46 <= np.ptp(cols) + 1 <= 52
    assert (marks != OTHER).all()


def test_a_box_may_be_drawn_from_any_corner() -> None:
    one = stroke(tool="box", mark="other", points=[(0.25, 0.25), (0.5, 0.75)]).drawn(blank())
    two = stroke(tool="box", mark="other", points=[(0.5, 0.75), (0.25, 0.25)]).drawn(blank())
    np.testing.assert_array_equal(one, two)
    assert 0.1 < (one == OTHER).mean() < 0.15


def test_erasing_takes_marks_away_and_changes_no_array() -> None:
    marks = stroke(tool="box", points=[(0.0, 0.0), (1.0, 1.0)]).drawn(blank())
    kept = marks.copy()
    gone = stroke(mark="none", points=[(0.5, 0.5)]).drawn(marks)
    np.testing.assert_array_equal(marks, kept)
    assert 0 < (gone == UNMARKED).sum() < gone.size


@given(
    st.lists(st.tuples(st.floats(-1.0, 2.0), st.floats(-1.0, 2.0)), min_size=1, max_size=8),
    st.sampled_from(["brush", "box"]),
    st.floats(0.001, 0.5),
)
def test_any_stroke_leaves_marks(points: list[tuple[float, float]], tool: str, width: float) -> None:
    marks = stroke(points=points, tool=tool, width=width).drawn(blank())
    assert marks.shape == SIZE
    assert set(np.unique(marks)) <= {UNMARKED, TARGET}


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[]",
        b'{"picture": 0}',
        b'{"picture": 0, "tool": "brush", "mark": "target", "width": 0.1, "points": []}',
        b'{"picture": 0, "tool": "brush", "mark": "target", "width": NaN, "points": [[0, 0]]}',
        b'{"picture": 0, "tool": "brush", "mark": "target", "width": 0.1, "points": [[0, 1e9]]}',
        b'{"picture": 0, "tool": "brush", "mark": "white", "width": 0.1, "points": [[0, 0]]}',
        b'{"picture": 0, "tool": "brush", "mark": "target", "width": 0.1, "points": [[0, 0]], "more": 1}',
        json.dumps(
            {"picture": 0, "tool": "brush", "mark": "target", "width": 0.1, "points": [[0, 0]] * 4001}
        ).encode(),
    ],
)
def test_what_is_no_stroke_is_refused(text: bytes) -> None:
    with pytest.raises(ValueError):
        MarkStroke.read(text)


def test_strokes_can_be_taken_back() -> None:
    sheet = MarkSheet(blank())
    first = stroke().drawn(sheet.marks)
    sheet.put(first)
    sheet.put(stroke(mark="other", points=[(0.1, 0.1)]).drawn(first))
    assert sheet.back()
    np.testing.assert_array_equal(sheet.marks, first)
    assert sheet.back()
    assert not sheet.marks.any()
    assert not sheet.back()


def test_marks_come_back_as_they_were_kept(tmp_path: Path) -> None:
    marks = np.random.default_rng(0).integers(0, 3, SIZE).astype(np.uint8)
    path = tmp_path / "deep/reef.png"
    write_marks(path, marks, "abc")
    np.testing.assert_array_equal(read_marks(path, SIZE, "abc"), marks)
    assert marked_in(path.parent) == ["reef"]
    with pytest.raises(ValueError, match=r"those of another of its name"):
        read_marks(path, SIZE, "abd")
    write_marks(path, np.zeros(SIZE, np.uint8), "abc")
    assert marked_in(path.parent) == []
    assert marked_in(tmp_path / "nowhere") == []


def test_any_program_may_have_painted_them(tmp_path: Path) -> None:
    rgba = np.zeros((120, 160, 4), np.uint8)
    rgba[:40] = 255, 254, 255, 255
    rgba[40:80] = 2, 0, 0, 255
    rgba[80:100] = 255, 0, 0, 255
    rgba[100:] = 255, 255, 255, 0
    Image.fromarray(rgba).save(tmp_path / "a.png")
    marks = read_marks(tmp_path / "a.png", SIZE, "any")
    assert marks.shape == SIZE
    assert (marks[:20] == TARGET).all()
    assert (marks[20:40] == OTHER).all()
    assert (marks[40:] == UNMARKED).all()


def test_marks_of_other_proportions_or_of_no_picture_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.new("L", (80, 80)).save(path)
    with pytest.raises(ValueError, match=r"expected the proportions of its picture, 80 x 60, got 80 x 80"):
        read_marks(path, SIZE, "any")
    path.write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"expected a PNG of marks"):
        read_marks(path, SIZE, "any")
