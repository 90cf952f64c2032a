from __future__ import annotations

from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[3] / "docs" / "navigation.md"


def test_the_code_on_the_page_of_the_vehicle_runs() -> None:
    code = PAGE.read_text().split("```python\n")[2].split("```")[0]
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["state"].thrust.shape == (8,)
    assert names["ping"].arrives > 1.0
