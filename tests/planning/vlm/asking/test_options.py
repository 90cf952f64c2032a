"""Options that cannot work are refused before anything is asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dream.planning.vlm.asking import Asking
from dream.planning.vlm.asking.provider import OFFLINE


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "model: expected which model to ask"),
        ({"model": "http://127.0.0.1:1/v1"}, "model_name: expected what"),
        ({"model": "openai:gpt-5", "model_name": "x"}, "model_name: expected only beside an address"),
        ({"model": "nonsense"}, "model: expected PROVIDER:NAME, an address or wire, got nonsense"),
        ({"model": "nobody:nothing"}, "model: expected one that can be asked, got nobody:nothing"),
        ({"timeout": 0.0}, "timeout: expected"),
        ({"latency": -1.0}, "latency: expected"),
        ({"max_calls": -1}, "max_calls: expected"),
        ({"max_calls": 1.5}, "max_calls: expected a whole number"),
        ({"max_usd": float("nan")}, "max_usd: expected"),
        ({"record": 3}, "record: expected a folder"),
    ],
)
def test_options_that_cannot_work_are_refused_by_name(
    options: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(OFFLINE, raising=False)
    with pytest.raises(ValueError, match=message):
        Asking(**options).line()


def test_folders_are_looked_at_before_anything_is_asked(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(OSError, match="--record: expected a folder that can be written"):
        Asking(model="http://127.0.0.1:1/v1", model_name="x", record=str(file)).line()
    with pytest.raises(ValueError, match="replay_replies: expected a folder of kept replies"):
        Asking(model="http://127.0.0.1:1/v1", model_name="x", replay_replies=str(tmp_path / "no")).line()


def test_a_temperature_goes_up_to_two() -> None:
    assert Asking(temperature=2.0).temperature == 2.0
    with pytest.raises(ValueError, match=r"temperature: expected 0 to 2, got 2\.1"):
        Asking(temperature=2.1)
