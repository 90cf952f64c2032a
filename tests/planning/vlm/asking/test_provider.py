"""Who is asked is whom the name says, with the key that is theirs; else the operator is told."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import dream
from dream.planning.vlm.asking import Asking
from dream.planning.vlm.asking.provider import OFFLINE
from dream.planning.vlm.asking.scrubbing import KEY
from tests.model_server import SECRET


@pytest.mark.rare
@pytest.mark.parametrize(
    ("model", "variable"),
    [
        ("openai:gpt-5", "OPENAI_BASE_URL"),
        ("anthropic:claude-sonnet-4-6", "ANTHROPIC_BASE_URL"),
        ("google:gemini-3.5-flash-lite", "GOOGLE_GEMINI_BASE_URL"),
    ],
)
def test_a_maker_whose_address_is_another_is_not_asked_under_its_name(
    model: str, variable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(OFFLINE)
    for key in ("OPENAI_API_KEY", "ANTHROPIC_API_KEY", "GOOGLE_API_KEY"):
        monkeypatch.setenv(key, SECRET)
    Asking(model=model).line()
    monkeypatch.setenv(variable, "http://127.0.0.1:1/v1")
    with pytest.raises(
        ValueError, match=f"model: expected {model} to be asked at its maker's, got {variable}"
    ):
        Asking(model=model).line()


@pytest.mark.parametrize(
    "model", ["openai:gpt-5", "anthropic:claude-sonnet-4-6", "google:gemini-3.5-flash-lite"]
)
def test_a_known_model_without_its_key_says_which_is_missing(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(OFFLINE, raising=False)
    for name in ("OPENAI_API_KEY", "ANTHROPIC_API_KEY", "GOOGLE_API_KEY", "GEMINI_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    missing = {"openai": "OPENAI_API_KEY", "anthropic": "ANTHROPIC_API_KEY", "google": "GOOGLE_API_KEY"}
    key = missing[model.partition(":")[0]]
    with pytest.raises(ValueError, match="API_KEY") as told:
        Asking(model=model).line()
    said = f"model: expected a key in {key}, got none. Say export {key}=..., or try --model wire"
    assert str(told.value) == said


@pytest.mark.parametrize("model", ["openai:gpt-5", "http://192.0.2.1:8000/v1", "http://example.org/v1"])
def test_offline_no_model_elsewhere_can_be_asked(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(OFFLINE, "1")
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with pytest.raises(ValueError, match="expected one on this machine while DREAM_OFFLINE is set"):
        Asking(model=model, model_name="x" if "//" in model else "").line()


@pytest.mark.parametrize("address", ["http://localhost:1/v1", "http://127.0.0.2:1/v1", "http://[::1]:1/v1"])
def test_offline_a_server_on_this_machine_can_be_asked(address: str) -> None:
    assert Asking(model=address, model_name="x").line() is not None


def test_a_key_that_no_header_could_hold_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEY, "one\ntwo")
    with pytest.raises(ValueError, match="DREAM_API_KEY: expected plain characters"):
        Asking(model="http://localhost:1/v1", model_name="x").line()


@pytest.mark.rare
def test_nothing_imports_the_stand_in_but_where_a_model_of_its_name_is_asked() -> None:
    root = Path(dream.__file__).parent
    importing = [
        (path.relative_to(root).as_posix(), node in tree.body)
        for path in root.rglob("*.py")
        for tree in [ast.parse(path.read_text("utf-8"))]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dream.standin")
    ]
    others = [(name, at_the_top) for name, at_the_top in importing if not name.startswith("standin/")]
    assert others == [("planning/vlm/asking/provider.py", False)]
