"""Compiled kernels are kept while no source of a kernel changes, and dropped when one does."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import dream
from dream.kept_kernels import STAMP, TYPES, drop_outdated

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


@pytest.mark.rare
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


def test_a_link_that_leads_nowhere_does_not_hurt(package: Path) -> None:
    (package / "b" / "_kernels").mkdir()
    (package / "b" / "_kernels" / ".#c.py").symlink_to("nobody@nowhere.1234")
    _keep(package)
    drop_outdated(package)
    assert _kept(package) == 2


def test_importing_the_package_drops_what_is_outdated(tmp_path: Path) -> None:
    root = Path(dream.__file__).parent
    (tmp_path / "dream" / "_kernels" / "__pycache__").mkdir(parents=True)
    for name in ("__init__.py", "kept_kernels.py", "files.py"):
        shutil.copy(root / name, tmp_path / "dream" / name)
    kept = tmp_path / "dream" / "_kernels" / "__pycache__" / "kernel-1.py311.nbi"
    for change in ("new", "older"):
        (tmp_path / "dream" / "_kernels" / "kernel.py").write_text(f"# {change}")
        kept.touch()
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        subprocess.run([sys.executable, "-c", "import dream"], env=environment, check=True)
        assert not kept.exists(), change
        kept.touch()
        subprocess.run([sys.executable, "-c", "import dream"], env=environment, check=True)
        assert kept.exists()


def test_what_kernels_take_is_defined_by_kernels_or_in_a_file_that_is_looked_at() -> None:
    """Named tuples with an array in them: nothing else is made of these but arguments of kernels."""
    root, found = Path(dream.__file__).parent, set()
    for path in root.rglob("*.py"):
        if path.name == "_kernels.py" or path.parent.name == "_kernels":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            bases = [ast.unparse(base) for base in node.bases] if isinstance(node, ast.ClassDef) else []
            if "NamedTuple" in bases and "Array" in ast.unparse(node):
                found.add(path.relative_to(root).as_posix())
    assert found - {"sim/chart.py", "sim/render/rasterizer.py"} == set(TYPES)
