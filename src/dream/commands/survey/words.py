"""How commands of `dream survey` write figures."""

from __future__ import annotations

from dream.survey import Measure

UNITS = {"m2": "m²", "1/m2": "/m²", "m": "m", "": ""}


def plain(text: str) -> str:
    """Words that came from a file, as a terminal may print them: on one line, and no commands to it."""
    from rich.markup import escape

    return escape("".join(letter if letter.isprintable() else " " for letter in text))


def number(value: float) -> str:
    """Three digits that count, and no more before the point than there are."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def named(name: str) -> str:
    """`reef_area` as people write it."""
    return name.replace("_", " ")


def measure_row(measure: Measure) -> tuple[str, str, str, str]:
    """Name, value, interval and note of a measure, in words."""
    unit = UNITS.get(measure.unit, measure.unit)
    if measure.value is None:
        return named(measure.name), "not measured", "", plain(measure.note)
    interval = ""
    if measure.low is not None and measure.high is not None:
        interval = f"{number(measure.low)} to {number(measure.high)}"
    return named(measure.name), f"{number(measure.value)} {unit}".strip(), interval, plain(measure.note)
