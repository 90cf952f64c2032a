"""How commands of `dream survey` write figures."""

from __future__ import annotations

from dream.survey import Measure
from dream.survey.numbers import UNITS, named, number


def plain(text: str) -> str:
    """Words that came from a file, as a terminal may print them: on one line, and no commands to it."""
    from rich.markup import escape

    return escape("".join(letter if letter.isprintable() else " " for letter in text))


def measure_row(measure: Measure) -> tuple[str, str, str, str]:
    """Name, value, interval and note of a measure, in words."""
    unit = UNITS.get(measure.unit, measure.unit)
    if measure.value is None:
        return named(measure.name), "not measured", "", plain(measure.note)
    interval = ""
    if measure.low is not None and measure.high is not None:
        interval = f"{number(measure.low)} to {number(measure.high)}"
    return named(measure.name), f"{number(measure.value)} {unit}".strip(), interval, plain(measure.note)
