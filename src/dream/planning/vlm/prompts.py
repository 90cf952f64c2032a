"""The prompts: versioned files in `planning/prompts`, filled in for a mission."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from string import Template
from typing import TYPE_CHECKING

from dream.planning.travel import careful_standoff
from dream.planning.vlm.pictures import FAR, scale_of
from dream.types import Mission

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


@dataclass(frozen=True, slots=True)
class Prompt:
    """A file of `planning/prompts`: heads such as `version: 1`, an empty line, the text."""

    name: str
    heads: Mapping[str, str]
    text: str

    @property
    def label(self) -> str:
        """Name and version."""
        return f"{self.name} {self.heads['version']}"


@cache
def load(name: str) -> Prompt:
    """The prompt of that name."""
    file = resources.files("dream").joinpath("planning", "prompts", f"{name}.md")
    top, _, text = file.read_text(encoding="utf-8").partition("\n\n")
    heads = dict(line.split(": ", 1) for line in top.splitlines())
    if not heads.get("version", "").isdigit():
        raise ValueError(f"prompt {name}: expected a first line such as version: 1, got {top[:40]!r}")
    return Prompt(name, heads, text.strip())


def instructions(name: str, mission: Mission, occupancy: OccupancyMap, **further: str) -> tuple[str, str]:
    """The prompt of that name for a mission; and what it is made of, with versions.

    Args:
        name: Of the file.
        mission: What is looked for, and by which rules.
        occupancy: The map that is shown.
        further: What else the prompt names.
    """
    from dream.mapping.drawing import grid_spacing

    prompt, knowledge, legend = load(name), load(mission.target.value), load("legend")
    protocol = mission.protocol
    drawn = {
        "grid": f"{grid_spacing(occupancy.bounds):g}",
        "pixels": f"{scale_of(occupancy) / occupancy.protocol.cell:g}",
        "far": f"{FAR:g}",
    }
    parts = [prompt, legend, *([knowledge] if "$knowledge" in prompt.text else [])]
    told = filled(legend, drawn)
    if protocol.traversal is not None:
        parts.append(load("traversal"))
        told += "\n\n" + filled(parts[-1], {"traversal": f"{protocol.traversal:g}"})
    values = {
        "mission": knowledge.heads["mission"],
        "knowledge": knowledge.text,
        "legend": told,
        "group": f"{2.0 * protocol.group_radius:g}",
        "fov": f"{math.degrees(protocol.camera.horizontal_fov):.0f}",
        "reach": f"{protocol.reach:g}",
        "blind": f"{protocol.blind:.1f}",
        "standoff": f"{careful_standoff(protocol):.1f}",
        **further,
    }
    return filled(prompt, values), ", ".join(part.label for part in parts)


def filled(prompt: Prompt, values: Mapping[str, str]) -> str:
    """Its text with the values in their places.

    Raises:
        ValueError: There are other places in it.
    """
    template = Template(prompt.text)
    unknown = sorted(set(template.get_identifiers()) - set(values))
    if unknown or not template.is_valid():
        got = ", ".join(f"${name}" for name in unknown) or "a lone $, which is written $$"
        known = ", ".join(f"${name}" for name in values)
        raise ValueError(f"planning/prompts/{prompt.name}.md: expected none but {known}, got {got}")
    return template.substitute(values)


def area(occupancy: OccupancyMap) -> list[str]:
    """What a model is told of the area that has to be seen; nothing where that is everything."""
    box = occupancy.area
    if box is None:
        return []
    return [
        f"Only the area from x = {box.x_min:g} to {box.x_max:g} m and from y = {box.y_min:g} to "
        f"{box.y_max:g} m, inside the magenta line on the map, has to be explored. What is white outside "
        "of it does not matter."
    ]
