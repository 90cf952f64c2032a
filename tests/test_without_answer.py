"""A mission under a model's name of which no answer counted is told of, whoever flew it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from dream.commands.dive.flight import Flight
from dream.evaluation.metrics import without_answer

SILENT = {"model": "seer", "questions": 4, "fallbacks": 4, "last_fallback": "timeout: no answer within 1 s"}


@pytest.mark.parametrize(
    ("vlm", "told"),
    [
        (SILENT, True),
        ({**SILENT, "fallbacks": 3}, False),
        ({**SILENT, "questions": 1, "fallbacks": 1}, True),
        (None, False),
    ],
)
def test_a_dive_of_which_no_answer_counted_exits_with_1(
    vlm: dict[str, Any] | None,
    told: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("dream.report.write_report", lambda folder: folder / "report.html")
    log = SimpleNamespace(lost={})
    ready = SimpleNamespace(
        folder=tmp_path, devices=SimpleNamespace(log=log), told=SimpleNamespace(json=True)
    )
    flight: Any = SimpleNamespace(ready=ready)
    assert Flight._end(flight, {"steps": 7, "vlm": vlm}, None) == int(told)
    printed = capsys.readouterr()
    assert ("dream: no answer of seer counted" in printed.err) == told == bool(without_answer(vlm))
    assert ("because of timeout: no answer within 1 s" in printed.err) == told
    assert printed.out.startswith('{"steps": 7')
