"""Files that appear whole or not at all, whoever else writes them."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path

import pytest

from dream.files import whole_or_nothing, write_whole


def test_nothing_is_seen_of_it_before_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    path.write_text("before")
    with whole_or_nothing(path) as partial:
        partial.write_text("af")
        assert path.read_text() == "before"
        with partial.open("a") as file:
            file.write("ter")
    assert path.read_text() == "after"
    assert os.listdir(tmp_path) == ["map.npz"]


def test_what_a_killed_process_leaves_is_no_file_of_its_kind(tmp_path: Path) -> None:
    with whole_or_nothing(tmp_path / "0007.npz") as partial:
        partial.write_bytes(b"half of it")
        (left,) = tmp_path.iterdir()
        assert left == partial
        assert left.name.startswith(".")
        assert not list(tmp_path.glob("*.npz"))


def test_two_that_write_the_same_file_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    with whole_or_nothing(path) as one, whole_or_nothing(path) as other:
        one.write_text("one")
        other.write_text("another")
    # The outer block ends last.
    assert path.read_text() == "one"
    assert os.listdir(tmp_path) == ["map.npz"]


@pytest.mark.parametrize(
    ("problem", "told"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device"),
            r"could not write PATH \(No space left on device\)",
        ),
        (OSError("the archive is gone"), "the archive is gone"),
        (ValueError("expected finite numbers"), "expected finite numbers"),
        (KeyboardInterrupt("stop"), "stop"),
    ],
)
def test_what_fails_leaves_what_was_there(tmp_path: Path, problem: BaseException, told: str) -> None:
    path = tmp_path / "map.npz"
    path.write_text("before")

    def fail_halfway() -> None:
        with whole_or_nothing(path) as partial:
            partial.write_text("half")
            raise problem

    with pytest.raises(type(problem), match=f"^{told.replace('PATH', re.escape(str(path)))}$"):
        fail_halfway()
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["map.npz"]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "gone" / "map.npz"
    with pytest.raises(
        OSError, match=rf"^could not write {re.escape(str(path))} \(No such file or directory\)$"
    ):
        write_whole(path, b"whole")


def test_what_is_written_whole_is_what_was_given(tmp_path: Path) -> None:
    write_whole(tmp_path / "plan.json", b"first")
    write_whole(tmp_path / "plan.json", b"second")
    assert (tmp_path / "plan.json").read_bytes() == b"second"
    assert os.listdir(tmp_path) == ["plan.json"]
