"""A name that is none is answered with what it may have meant."""

from __future__ import annotations

import pytest

from dream.planning.vlm.asking import Asking
from dream.planning.vlm.asking.provider import OFFLINE


@pytest.mark.parametrize(
    ("model", "meant"),
    [
        ("wier", "wire"),
        ("wier:slow", "wire:slow"),
        ("gpt-5", "openai:gpt-5"),
        ("claude-sonnet-4-6", "anthropic:claude-sonnet-4-6"),
        ("gemini-3.5-flash-lite", "google:gemini-3.5-flash-lite"),
        ("opnai:gpt-5", "openai:gpt-5"),
        ("localhost:8000/v1", "http://localhost:8000/v1"),
    ],
)
def test_a_name_that_is_none_is_answered_with_what_it_may_have_meant(
    model: str, meant: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(OFFLINE, raising=False)
    with pytest.raises(ValueError, match=r"model: expected .*") as told:
        Asking(model=model).line()
    assert str(told.value).endswith(f". Did you mean {meant}?")
