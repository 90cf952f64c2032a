"""`perf/homeward.py` goes on with what it was asked for and has not flown yet."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

from dream.evaluation.suites import Case


@pytest.fixture(scope="module")
def perf() -> Any:
    path = Path(__file__).parents[1] / "perf" / "homeward.py"
    spec = importlib.util.spec_from_file_location("perf_homeward", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_shares_that_were_not_flown_are_missing(perf: Any) -> None:
    one, other = Case("reef/string", 101), Case("reef/L", 101)

    def kept(share: float | None, protocol: str = "dream-v2") -> Any:
        return perf.Flown("reef/string", 101, protocol, share, "done", 90, 400.0, None, 0.99, 0, None)

    flown = [kept(None), kept(0.3), kept(0.5, "dream-v1")]
    assert perf.missing([one, other], "dream-v2", [0.3, 0.5], flown) == [
        (one, "dream-v2", (0.5,), 400.0),
        (other, "dream-v2", (0.3, 0.5), None),
    ]
    assert perf.missing([one], "dream-v2", [0.3], flown) == []
    assert perf.missing([one], "dream-v1", [0.5], flown) == [(one, "dream-v1", (), None)]
