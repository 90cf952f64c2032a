"""Checks of planners' parameters."""

from __future__ import annotations


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise a ValueError that names the parameter unless low ≤ value ≤ high; NaN is in no range."""
    if not low <= value <= high:
        raise ValueError(f"{name}: expected {low:g} to {high:g}, got {value:g}")
