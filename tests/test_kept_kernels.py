"""Compiled kernels are kept while no source of a kernel changes, and dropped when one does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dream.kept_kernels import STAMP, drop_outdated

CALLER = """
from numba import njit
from {name}.b._kernels import twice

@njit(cache=True)
def answer(x):
    return twice(x) + 1
"""
CALLEE = """
from numba import njit

@njit(cache=True)
def twice(x):
    return {factor} * x
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Two kernels in two folders, one calls the other; with compiled code beside each."""
    package = tmp_path / "sample"
    for part, source in (("a", CALLER.format(name="sample")), ("b", CALLEE.format(factor=2))):
        folder = package / part
        (folder / "__pycache__").mkdir(parents=True)
        (folder / "__init__.py").touch()
        (folder / "_kernels.py").write_text(source)
        for ending in ("nbi", "1.nbc"):
            (folder / "__pycache__" / f"_kernels.answer-5.py311.{ending}").touch()
        (folder / "__pycache__" / "_kernels.cpython-311.pyc").touch()
    (package / "__init__.py").write_text("")
    drop_outdated(package)
    return package


def _kept(package: Path) -> int:
    return len([*package.rglob("*.nb[ci]")])


def _keep(package: Path) -> None:
    for part in ("a", "b"):
        (package / part / "__pycache__" / "_kernels.answer-5.py311.nbi").touch()


def test_what_nobody_knows_the_sources_of_is_dropped_and_bytecode_stays(package: Path) -> None:
    assert _kept(package) == 0
    assert len([*package.rglob("*.pyc")]) == 2


def test_what_was_compiled_since_is_kept_until_a_kernel_changes(package: Path) -> None:
    _keep(package)
    drop_outdated(package)
    assert _kept(package) == 2
    (package / "a" / "other.py").write_text("# no kernel")
    drop_outdated(package)
    assert _kept(package) == 2
    for change in ("touched", "longer", "new", "gone"):
        path = package / "b" / ("_kernels.py" if change in ("touched", "longer") else "_kernels/c.py")
        path.parent.mkdir(exist_ok=True)
        if change == "touched":
            os.utime(path, ns=(1, 1))
        elif change == "gone":
            path.unlink()
        else:
            path.write_text(f"# {change}")
        drop_outdated(package)
        assert _kept(package) == 0, change
        _keep(package)
        drop_outdated(package)
        assert _kept(package) == 2


def test_a_package_that_cannot_be_written_to_is_left_alone(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    _keep(package)
    (package / "__pycache__" / STAMP).write_text("of another time")
    monkeypatch.setattr(Path, "unlink", refuse)
    drop_outdated(package)
    assert _kept(package) == 2
    assert (package / "__pycache__" / STAMP).read_text() == "of another time"


def test_numba_alone_would_go_on_with_a_callee_that_has_changed(package: Path) -> None:
    def answer() -> int:
        code = "from sample.a._kernels import answer; print(answer(10))"
        environment = {**os.environ, "PYTHONPATH": str(package.parent)}
        environment.pop("NUMBA_CACHE_DIR", None)
        said = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        return int(said.stdout)

    assert answer() == 21
    (package / "b" / "_kernels.py").write_text(CALLEE.format(factor=3000))
    assert answer() == 21, "that is why they are dropped"
    drop_outdated(package)
    assert answer() == 30001
