"""What tests of surveys share."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import pytest

from tests.programs import do_without
from tests.survey.postgres import Server, missing, serving


@pytest.fixture(scope="session")
def postgres() -> Iterator[Server]:
    """A real server; its packages may not be there."""
    if importlib.util.find_spec("psycopg") is None:
        do_without("needs psycopg, an optional extra")
    if reason := missing():
        do_without(reason)
    with serving() as server:
        yield server
