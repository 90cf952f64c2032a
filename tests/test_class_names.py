"""A class has a name of its own, so that a reader who sees one knows which it is."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "dream"

SHARED = {
    "Asked",
    "Autopilot",
    "Calibration",
    "Change",
    "Comparison",
    "Condition",
    "Coverage",
    "Export",
    "Exported",
    "Flight",
    "Flown",
    "Frame",
    "Frames",
    "Ground",
    "Hull",
    "Keeping",
    "Layers",
    "Limits",
    "Mission",
    "Network",
    "Outcome",
    "Parameters",
    "Picture",
    "Plan",
    "Reading",
    "Results",
    "Scene",
    "Sensor",
    "Sight",
    "Standing",
    "State",
    "Survey",
    "Sweep",
    "Table",
    "Tank",
    "Terminal",
    "Watch",
    "_Bounds",
    "_Event",
    "_Part",
    "_Stage",
}
"""Names of two classes or more. The list only gets shorter: a new class takes a name that is free, and who
renames one takes its name off."""


@cache
def shared(folder: Path) -> set[str]:
    """Names that classes of the package share, nested ones too."""
    count = Counter(
        node.name
        for file in folder.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    return {name for name, times in count.items() if times > 1}


def test_no_class_takes_the_name_of_another() -> None:
    assert shared(PACKAGE) - SHARED == set()


def test_a_name_that_is_no_longer_shared_is_off_the_list() -> None:
    assert SHARED - shared(PACKAGE) == set()


def test_a_name_is_shared_across_files_and_within_classes(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("class A: ...\nclass B:\n    class C: ...\n")
    (tmp_path / "two.py").write_text("def f():\n    class C: ...\nclass D(A): ...\n")
    assert shared(tmp_path) == {"C"}
