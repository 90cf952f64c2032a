from __future__ import annotations

import pytest

from dream.scene import RunScene
from tests.scene.orbits import orbited


@pytest.fixture(scope="session")
def wreck() -> RunScene:
    return orbited()
