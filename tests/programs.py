"""Programs of the machine that some tests need."""

from __future__ import annotations

import os
import shutil
from typing import NoReturn

import pytest

VARIABLE = "DREAM_NO_SKIPS"
"""Of the environment: 1 where all such programs are said to be there, as in CI."""
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def do_without(reason: str) -> NoReturn:
    """Skip a test that lacks a program; fail it where none should lack."""
    if os.environ.get(VARIABLE) == "1":
        pytest.fail(f"{VARIABLE}=1: expected a machine on which this test is not skipped, but it {reason}")
    pytest.skip(reason)
