"""The prompts: files in `planning/prompts`, or one's own in their place, filled in for a mission."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from string import Template
from types import MappingProxyType
from typing import TYPE_CHECKING

from dream.geometry import SE2
from dream.planning.travel import careful_standoff
from dream.planning.vlm.pictures import AHEAD, BEHIND, FAR, bearing, scale_of
from dream.protocol import SurveyProtocol
from dream.types import Mission

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


OF_A_MISSION = ("mission", "knowledge", "legend", "group", "fov", "reach", "blind", "standoff")
"""Places that are filled in wherever a mission is told of."""
PLACES: Mapping[str, tuple[str, ...]] = {
    "vanilla": OF_A_MISSION,
    "dream": OF_A_MISSION,
    "ranked": (*OF_A_MISSION, "count"),
    "probe": OF_A_MISSION,
    "legend": ("grid", "pixels", "far"),
    "traversal": ("traversal",),
    "space": ("reach", "incidence", "lowest", "surface"),
    "steering": ("climbs", "tilts", "behind", "ahead", "body", "reach"),
    "oysters": (),
    "wreck": (),
    "any": (),
    "orders": ("x_min", "y_min", "x_max", "y_max", "labelled", "cap", "advance", "most"),
}
"""Every prompt by name, and the places that are filled in in its text."""
STEERS = ("dream", "vanilla")
"""Those whose answer is a move."""
KNOWLEDGE = ("oysters", "wreck", "any")
"""Those told of a kind of target, whose head `mission` says what is to be done."""
MOST_BYTES = 1 << 16
"""Of a prompt of one's own."""


@dataclass(frozen=True, slots=True)
class Prompt:
    """A prompt's file: heads such as `version: 1`, an empty line, the text."""

    name: str
    heads: Mapping[str, str]
    text: str
    own: str = ""
    """SHA-256 of the file where it is not the package's."""

    @property
    def label(self) -> str:
        """Name and version; and which file, where it is one's own."""
        return f"{self.name} {self.heads['version']}" + (f" (own, {self.own[:8]})" if self.own else "")


Own = Mapping[str, Prompt]
"""Prompts of one's own by name."""
PACKAGED: Own = MappingProxyType({})
"""None of one's own."""


@cache
def load(name: str) -> Prompt:
    """The package's prompt of that name."""
    file = resources.files("dream").joinpath("planning", "prompts", f"{name}.md")
    return _read(name, f"prompt {name}", file.read_text(encoding="utf-8"))


def chosen(name: str, own: Own) -> Prompt:
    """The prompt of that name: one's own where there is one, else the package's."""
    return own.get(name) or load(name)


def own_prompts(folder: str | None) -> dict[str, Prompt]:
    """All prompts in a folder of one's own, by name; none where there is no folder.

    Raises:
        ValueError: It is no folder, holds no prompt, or one that does not belong or cannot be used.
    """
    if folder is None:
        return {}
    known = ", ".join(f"{name}.md" for name in PLACES)
    if not Path(folder).is_dir():
        raise ValueError(f"prompts: expected a folder with some of {known}, got {folder}")
    found = sorted(Path(folder).glob("*.md"))
    strange = [path.name for path in found if path.stem not in PLACES]
    if strange or not found:
        raise ValueError(f"prompts: expected some of {known} in {folder}, got {', '.join(strange) or 'none'}")
    return {path.stem: _read_own(path) for path in found}


def _read_own(path: Path) -> Prompt:
    try:
        with path.open("rb") as file:
            written = file.read(MOST_BYTES + 1)
        text = written.decode("utf-8")
    except OSError as error:
        raise ValueError(f"{path}: expected a prompt, got none ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected text in UTF-8, got other bytes") from error
    if len(written) > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got more")
    return _read(path.stem, str(path), text, hashlib.sha256(written).hexdigest())


def _read(name: str, where: str, written: str, own: str = "") -> Prompt:
    top, _, text = written.replace("\r\n", "\n").partition("\n\n")
    heads = dict(line.split(": ", 1) for line in top.splitlines() if ": " in line)
    if not heads.get("version", "").isdigit():
        raise ValueError(
            f"{where}: expected a first line such as version: 1 and an empty one after the heads, "
            f"got {top[:40]!r}"
        )
    if name in KNOWLEDGE and not heads.get("mission"):
        raise ValueError(f"{where}: expected a head such as mission: Its mission is to ..., got none")
    if not text.strip():
        raise ValueError(f"{where}: expected a text after its heads and an empty line, got none")
    template, known = Template(text), PLACES[name]
    unknown = sorted(set(template.get_identifiers()) - set(known))
    # What is known of a kind of target is told as it stands, whatever is in it.
    if name not in KNOWLEDGE and (unknown or not template.is_valid()):
        got = ", ".join(f"${place}" for place in unknown) or "a lone $, which is written $$"
        expected = ", ".join(f"${place}" for place in known)
        raise ValueError(f"{where}: expected no places but {expected}, got {got}")
    return Prompt(name, heads, text.strip(), own)


def instructions(
    name: str, mission: Mission, occupancy: OccupancyMap, own: Own, **further: str
) -> tuple[str, str]:
    """The prompt of that name for a mission; and what it is made of, with versions.

    Args:
        name: Of the file.
        mission: What is looked for, and by which rules.
        occupancy: The map that is shown.
        own: Prompts to take in the place of the package's, by name.
        further: What else the prompt names.
    """
    from dream.mapping.drawing import grid_spacing

    prompt, knowledge, legend = (chosen(part, own) for part in (name, mission.target.value, "legend"))
    protocol = mission.protocol
    drawn = {
        "grid": f"{grid_spacing(occupancy.bounds):g}",
        "pixels": f"{scale_of(occupancy) / occupancy.protocol.cell:g}",
        "far": f"{FAR:g}",
    }
    parts = [prompt, legend, *([knowledge] if "$knowledge" in prompt.text else [])]
    told = filled(legend, drawn)
    if protocol.traversal is not None:
        parts.append(chosen("traversal", own))
        told += "\n\n" + filled(parts[-1], {"traversal": f"{protocol.traversal:g}"})
    if protocol.space is not None:
        for part in ("space", *(["steering"] if name in STEERS else [])):
            parts.append(chosen(part, own))
            told += "\n\n" + filled(parts[-1], in_space(protocol))
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


def in_space(protocol: SurveyProtocol) -> dict[str, str]:
    """What a protocol that moves in space says of heights and tilts, for the prompts that are about them."""
    space = protocol.space
    assert space is not None
    return {
        "reach": f"{protocol.reach:g}",
        "incidence": f"{math.degrees(space.incidence):.0f}",
        "lowest": f"{space.lowest:g}",
        "surface": f"{space.surface:g}",
        "climbs": ", ".join(f"{climb:g}" for climb in protocol.climbs),
        "tilts": ", ".join(f"{math.degrees(tilt):.3g}" for tilt in sorted(protocol.tilts)),
        "behind": f"{BEHIND:g}",
        "ahead": f"{AHEAD:g}",
        "body": f"{2.0 * protocol.body_radius:g}",
    }


def filled(prompt: Prompt, values: Mapping[str, str]) -> str:
    """Its text with the values in their places; see `PLACES`."""
    return Template(prompt.text).substitute(values)


def progress(mission: Mission, pose: SE2, decisions: int) -> list[str]:
    """Where the vehicle is, and how many steps are done and left.

    Args:
        mission: How many there are in all, and how many were flown before the first decision.
        pose: Of the vehicle.
        decisions: That were made before this one.
    """
    # Every mission begins with a look around, which nobody decides.
    steps = mission.flown + decisions
    return [
        f"The robot is at x = {pose.x:g} m, y = {pose.y:g} m and heads towards {bearing(pose)}.",
        f"{steps} steps are done; {mission.max_steps - steps} are left at most.",
    ]


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
