from __future__ import annotations

from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[2] / "docs" / "navigation.md"


def test_the_code_on_the_page_of_navigation_runs() -> None:
    code = PAGE.read_text().split("```python\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["arrival"].pose.distance(names["there"]) < 0.06
    assert 0.0 < names["unknown"] < 0.1
    assert names["commands"].shape == (8,)
    assert names["commands"].max() > 0.0
