from __future__ import annotations

from pathlib import Path
from typing import Any

from dream.estimation import Verdict

PAGE = Path(__file__).parents[2] / "docs" / "navigation.md"


def test_the_code_of_the_filters_on_the_page_runs() -> None:
    code = PAGE.read_text(encoding="utf-8").split("```python\n")[3].split("```")[0]
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["outcome"].verdict is Verdict.TAKEN
    assert names["timeline"].state.time == 0.01
