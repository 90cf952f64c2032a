"""Waiting for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable


def until(true: Callable[[], object]) -> bool:
    """Did it come true within five seconds?"""
    end = time.monotonic() + 5.0
    while not true() and time.monotonic() < end:
        time.sleep(0.005)
    return bool(true())
