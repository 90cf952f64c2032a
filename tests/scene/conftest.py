from __future__ import annotations

import pytest

from dream.scene import Scene
from tests.scene.orbits import orbited


@pytest.fixture(scope="session")
def wreck() -> Scene:
    return orbited()
