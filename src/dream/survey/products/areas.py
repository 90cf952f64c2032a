"""The three areas of a reef that the products tell, and why they differ.

Each answers another question, and none is wrong: how many cells of the map hold target, how much ground is
reef, how much of it is shell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.survey.products.styles import SOLID_TARGET, TARGET
from dream.survey.products.words import value_text
from dream.survey.reef import SURE
from dream.survey.survey import Measure, Survey
from dream.types import Target

WHY = (
    "Target cells are whole cells of the map in which target was seen. Reef area is ground that is reef: "
    "shell, and the bare ground between shells that is less than a metre across. Shell cover is shell alone, "
    "seen from straight above."
)
"""Of all three, in few words."""
STEPS = 200.0
"""Of `Picture.share` in a whole."""
NOT_SEEN = 255


@dataclass(frozen=True, slots=True)
class Area:
    """One of the three."""

    title: str
    value: str
    """Such as "61.3 m²"."""
    says: str
    """What it is, and where it is told."""


def areas(survey: Survey) -> tuple[Area, ...]:
    """Those of a survey of a reef, as far as it tells them; none of a wreck."""
    if survey.target is Target.WRECK:
        return ()
    cell = survey.layers.cell
    cells = int(np.isin(survey.layers.state, (TARGET, SOLID_TARGET)).sum())
    told = [
        Area(
            "Target cells",
            _square_metres(cells * cell**2),
            f"whole cells of {cell:g} m of the mission's own map in which target was seen: habitat.tif and "
            "survey.nc show them. A cell counts whole, and a gap as wide as a cell is left out",
        )
    ]
    if reef := next((m for m in survey.measures if m.name == "reef_area" and m.value is not None), None):
        told.append(
            Area(
                "Reef area",
                value_text(reef),
                "ground that is reef: shell, and the bare ground between shells that is less than a metre "
                "across. The measure reef_area, and the outlines of the patches",
            )
        )
    if picture := survey.picture:
        shell = (picture.share != NOT_SEEN) & (picture.share >= SURE * STEPS)
        told.append(
            Area(
                "Shell cover",
                _square_metres(float(shell.sum()) * picture.cell**2),
                f"shell alone, seen from straight above in cells of {100.0 * picture.cell:g} cm; all bare "
                "ground is left out",
            )
        )
    return tuple(told)


def _square_metres(value: float) -> str:
    return value_text(Measure("", value, 0.95 * value, 1.05 * value, "m2"))
