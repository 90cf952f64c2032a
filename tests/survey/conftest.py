"""What tests of surveys share."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import pytest

from tests.survey.postgres import Server, missing, serving


@pytest.fixture(scope="session")
def postgres() -> Iterator[Server]:
    """A real server; skipped where its packages are not there."""
    if importlib.util.find_spec("psycopg") is None:
        pytest.skip("needs psycopg, an optional extra")
    if reason := missing():
        pytest.skip(reason)
    with serving() as server:
        yield server
