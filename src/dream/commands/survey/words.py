"""How commands of `dream survey` write figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dream.telling import one_line

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from dream.survey import Measure


def slim_table(title: str | Text | None = None) -> Table:
    """A table without columns yet, whose lines leave its figures the width of a small terminal."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))


def measure_row(measure: Measure) -> tuple[str, str, str, str]:
    """Name, value, interval and note of a measure, in words."""
    from dream.survey.numbers import UNITS, named, number
    from dream.survey.sizes import size_bin

    ends = size_bin(measure.name)
    name = named(measure.name) if ends is None else f"{ends[0]} to {ends[1]} cm wide"
    unit = UNITS.get(measure.unit, measure.unit)
    if measure.value is None:
        return name, "not measured", "", one_line(measure.note)
    interval = ""
    if measure.low is not None and measure.high is not None:
        interval = f"{number(measure.low)} to {number(measure.high)}"
    return name, f"{number(measure.value)} {unit}".strip(), interval, one_line(measure.note)
