from __future__ import annotations

from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[2] / "docs" / "map.md"


def test_the_code_on_the_page_of_the_map_runs() -> None:
    code = PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    exec(code, names)
    layers = names["occupancy"]
    assert layers.explored.any()
    assert layers.areas()["target"] == 0.0
