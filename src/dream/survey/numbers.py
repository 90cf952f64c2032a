"""How figures of surveys are written, the same on a terminal and on a page."""

from __future__ import annotations

import math

UNITS = {"m2": "m²", "1/m2": "/m²", "m": "m", "": ""}


def number(value: float) -> str:
    """Three digits that count, and no more before the point than there are."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def places(of: float) -> int:
    """After the point, so that three digits of a number count: for others that stand beside it."""
    return max(0, 2 - math.floor(math.log10(abs(of)))) if of != 0.0 else 0


def p_value(p: float) -> str:
    """Two digits that count; what is smaller than the tests can tell is not written out."""
    return "<0.0001" if p < 1e-4 else f"{p:.2g}"


def named(name: str) -> str:
    """`reef_area` as people write it."""
    return name.replace("_", " ")


def typeset(figure: str) -> str:
    """As in print: with a minus sign, and a space before percent that does not break."""
    return figure.replace("-", "−").replace(" %", "%").replace("%", "\N{NO-BREAK SPACE}%")
