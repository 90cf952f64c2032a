"""What is missing is asked for by a command that adds it to the Python that says so."""

from __future__ import annotations

import importlib.metadata
import re
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest

from dream import extras

STATED = (
    "numpy>=2.1",
    "ray>=2.50; (python_version < '3.14') and extra == 'ray'",
    "pydantic-ai-slim[anthropic,openai]<3,>=2.68; extra == 'vlm'",
    "onnxruntime>=1.22; extra == 'rov'",
    'pymavlink>=2.4.49; extra == "rov"',
)
"""Requirements as build tools write them into the metadata of a distribution."""


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One whose own environment runs this, though what lies there is no more than its Makefile."""
    root = tmp_path / "some clone"
    (root / "src/dream").mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml"):
        (root / name).touch()
    monkeypatch.setattr(extras, "__file__", str(root / "src/dream/extras.py"))
    monkeypatch.setattr(sys, "prefix", str(root / ".venv"))
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: list(STATED))
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def installed(clone: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The Python of an installed package, which has pip."""
    pip = ModuleType("pip")
    pip.__spec__ = ModuleSpec("pip", None)
    monkeypatch.setitem(sys.modules, "pip", pip)
    monkeypatch.setattr(extras, "__file__", str(clone / "lib/python3.12/site-packages/dream/extras.py"))
    monkeypatch.setattr(sys, "executable", "/opt/my python/bin/python3")
    return Path(sys.executable)


def test_in_a_clone_its_make_adds_an_extra(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert extras.how_to_add("vlm") == "make setup EXTRAS=vlm"
    monkeypatch.chdir(clone.parent)
    assert extras.how_to_add("vlm") == f"make -C '{clone}' setup EXTRAS=vlm"


def test_an_environment_of_ones_own_is_not_left_for_that_of_the_clone(
    clone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(clone.parent / "mine"))
    assert extras.how_to_add("rov").endswith(" 'onnxruntime>=1.22' 'pymavlink>=2.4.49'")


def test_an_installed_package_asks_for_the_requirements_and_never_for_its_own_name(installed: Path) -> None:
    install = f"'{installed}' -m pip install"
    assert extras.how_to_add("rov") == f"{install} 'onnxruntime>=1.22' 'pymavlink>=2.4.49'"
    assert extras.how_to_add("vlm") == f"{install} 'pydantic-ai-slim[anthropic,openai]<3,>=2.68'"
    assert extras.how_to_add("ray") == f"""{install} 'ray>=2.50; (python_version < '"'"'3.14'"'"')'"""


def test_where_python_has_no_pip_uv_is_asked(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pip", None)
    assert extras.how_to_add("rov").startswith(f"uv pip install --python '{installed}' 'onnxruntime")


def test_without_a_clone_and_without_metadata_the_extra_is_named(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(name: str) -> list[str]:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", nothing)
    assert extras.how_to_add("rov") == "install what the extra rov of DREAM needs"


def test_the_first_module_that_is_missing_is_named(clone: Path) -> None:
    extras.check_installed("rov", "dive", "sys", "json")
    with pytest.raises(ValueError, match=r"^dive: expected .* module no\.such, got none\. To add it: "):
        extras.check_installed("rov", "dive", "sys", "no.such", "other")


def test_every_extra_that_is_asked_for_exists_and_no_index_is_asked_for_this_package() -> None:
    stated = set(importlib.metadata.metadata(extras.NAME).get_all("Provides-Extra") or ())
    said = "".join(path.read_text("utf-8") for path in Path(extras.__file__).parent.rglob("*.py"))
    asked_for = set(re.findall(r'extras\.(?:missing|check_installed)\(\s*"(\w+)"', said))
    assert {
        "learned",
        "live",
        "postgis",
        "ray",
        "rerun",
        "rov",
        "survey",
        "teach",
        "train",
        "vlm",
    } == asked_for
    assert asked_for <= stated
    assert f"{extras.NAME}[" not in said
