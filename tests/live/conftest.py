from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.live.runs import Growing, recorded_once


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_once(tmp_path_factory.mktemp("live") / "whole")


@pytest.fixture
def growing(whole: Path, tmp_path: Path) -> Callable[..., Growing]:
    def made(name: str = "run", **config: object) -> Growing:
        return Growing(tmp_path / "runs" / name, whole, **config)

    return made
