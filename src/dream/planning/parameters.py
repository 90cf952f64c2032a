"""Checks of planners' parameters."""

from __future__ import annotations


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise a ValueError that names the parameter unless low ≤ value ≤ high; NaN is in no range."""
    if not low <= value <= high:
        raise ValueError(f"{name}: expected {low:g} to {high:g}, got {value:g}")


def check_count(name: str, value: int, low: int, high: int) -> None:
    """Likewise, and unless it is a whole number."""
    check_range(name, value, low, high)
    if value != int(value):
        raise ValueError(f"{name}: expected a whole number, got {value:g}")
