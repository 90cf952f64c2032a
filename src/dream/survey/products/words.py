"""How a survey is put into words, the same in every report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from dream.survey.calibration import doubt
from dream.survey.numbers import named
from dream.survey.site import Site
from dream.survey.sizes import size_bin
from dream.survey.survey import Measure, StructureSide, Survey, SurveyedStructure
from dream.types import Target

UNITS = {"m2": "m²", "1/m2": "per m²", "m": "m", "": ""}


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a measure is called, and what it says."""

    title: str
    says: str
    share: bool = False
    """Told in percent."""


MEANINGS = {
    "reef_area": Meaning("Reef area", "ground that reef covers, seen or right beside it"),
    "area": Meaning("Area", "ground that it covers"),
    "patch_count": Meaning("Patches", "separate pieces of reef that were seen"),
    "patches": Meaning("Patches", "separate pieces of reef"),
    "density": Meaning("Density", "individuals on each square metre of reef"),
    "count": Meaning("Individuals", "estimate of all of them, with those that hide beside others"),
    "individuals": Meaning("Individuals", "estimate of all of them, with those that hide beside others"),
    "median_size": Meaning("Median size", "half of the individuals are wider than this"),
    "mean_size": Meaning("Mean size", "mean of the longest diameters of the individuals"),
    "reef_height": Meaning("Reef height", "how high the reef stands above the bare seabed"),
    "reef_height_max": Meaning("Highest reef", "its highest parts above the bare seabed"),
    "mean_height": Meaning("Mean height", "of the reef above the bare seabed"),
    "max_height": Meaning("Highest reef", "its highest point above the bare seabed"),
    "height": Meaning("Height", "above the bare seabed"),
    "rugosity": Meaning("Rugosity", "length along the surface over length on the plan; 1 is flat"),
    "length": Meaning("Length", "longest extent"),
    "width": Meaning("Width", "extent across its length"),
    "seen_share": Meaning("Area looked at", "how much of the ground was looked at", share=True),
    "outline_area": Meaning("Outline of the wreck", "ground that the hull covers"),
    "hull_seen": Meaning("Hull seen", "share of the outer surface that was looked at", share=True),
    "debris_extent": Meaning("Debris field", "extent of hull and pieces together"),
    "debris_area": Meaning("Debris", "ground that pieces of the wreck cover"),
    "highest_point": Meaning("Highest point", "of the wreck"),
    "known_surface": Meaning("Known surface", "of what stands, as far as the map shows it"),
    "inspected_share": Meaning(
        "Inspected", "share of that surface that was looked at from near and at a useful angle", share=True
    ),
    "open_area": Meaning("May go on", "where that surface ends in what no look has shown"),
    "looked_from": Meaning("Looked at from", "distance of the nearest look"),
    # Of comparisons.
    "found": Meaning(
        "Found",
        "individuals that were found, each weighed by how likely it is one and is found; "
        "not the estimate of all there are",
    ),
    "found_density": Meaning("Found density", "those that were found over the target area"),
    "target_area": Meaning("Target area", "that ground's map cells which are target, gaps left out"),
    "covered": Meaning(
        "Covered ground", "of the outlines, what is not bare in blurred pictures: more than the shell itself"
    ),
    "gone": Meaning(
        "Gone",
        "of the earlier survey's individuals that were found in two frames or more, those in whose place the "
        "later one shows bare ground; the share is that beyond what surveys of unchanged ground miss",
    ),
    "come": Meaning("Come", "of the later one's, those in whose place the earlier one shows bare ground"),
}


HEADLINES = (
    *("reef_area", "density", "median_size", "reef_height"),
    *("outline_area", "hull_seen", "inspected_share", "known_surface", "debris_extent", "highest_point"),
)
"""Measures that stand first in every report, as far as a survey has them."""

HEADLINES_IN_SPACE = ("highest_point", "inspected_share", "known_surface", "open_area")
"""The same of a survey that tells of structures."""

FIRST = (
    *("reef_area", "count", "density", "reef_height", "median_size"),
    *("outline_area", "hull_seen", "inspected_share", "known_surface", "open_area"),
    *("debris_extent", "debris_area", "highest_point"),
)
"""What is told first of a reef, and of a wreck: how large, how many, how dense, how high, of which size."""


def meaning(name: str) -> Meaning:
    """What a measure means; one that is not known here keeps its name."""
    if (ends := size_bin(name)) is not None:
        return Meaning(f"{ends[0]} to {ends[1]} cm wide", "share of the individuals", share=True)
    plain = named(name)
    return MEANINGS.get(
        name, Meaning(plain[:1].upper() + plain[1:], "", share=name.endswith(("_share", "_seen")))
    )


def long_name(name: str) -> str:
    """A measure in one line, for the files of programs, such as "density: individuals on each ..."."""
    told = meaning(name)
    title = told.title[:1].lower() + told.title[1:]
    return f"{title}: {told.says}" if told.says else title


def explained(measure: Measure) -> str:
    """What it says, and how it was got."""
    sentences = (meaning(measure.name).says, measure.note)
    return ". ".join(text[:1].upper() + text[1:] for text in sentences if text)


def listed(survey: Survey) -> list[Measure]:
    """The measures that a table tells: all but the shares of sizes, which a figure shows."""
    return [measure for measure in survey.measures if size_bin(measure.name) is None]


def value_text(measure: Measure) -> str:
    """Such as "34.8 m²"; "not measured" where it was not."""
    if measure.value is None:
        return "not measured"
    return _with_unit(measure, _number(measure.value, measure))


def interval_text(measure: Measure) -> str:
    """Such as "33.1 to 36.6 m²"; empty where there is none."""
    if measure.value is None or measure.low is None or measure.high is None:
        return ""
    return _with_unit(measure, f"{_number(measure.low, measure)} to {_number(measure.high, measure)}")


def _with_unit(measure: Measure, text: str) -> str:
    if meaning(measure.name).share:
        return f"{text} %"
    unit = UNITS.get(measure.unit, measure.unit)
    return f"{text} {unit}" if unit else text


def _number(value: float, measure: Measure) -> str:
    """With as many digits as its interval is worth: two of its width, at most three after the point."""
    scale = 100.0 if meaning(measure.name).share else 1.0
    width = abs(scale * value)
    if measure.low is not None and measure.high is not None:
        width = max(scale * (measure.high - measure.low), 1e-3 * width)
    digits = 0 if width <= 0.0 else min(3, max(0, 1 - math.floor(math.log10(width))))
    whole = measure.name in ("count", "patch_count", "patches", "individuals")
    return f"{scale * value:,.{0 if whole else digits}f}"


def simulated(survey: Survey) -> str:
    """Said of what no camera has seen, and of a date that is simulated; empty of a dive in real water."""
    if not (made_up := world(survey)):
        return ""
    later = f", {years(survey.years_on)} after {_first_world(survey)}" if survey.years_on else ""
    return f"Simulated: {made_up}{later}"


def _first_world(survey: Survey) -> str:
    """That over which the years of a simulated survey went."""
    return str(survey.made_by["world"]).partition("+")[0]


def years(number: float) -> str:
    """Such as "one year", "two years" or "1.5 years"."""
    if number == 1.0:
        return "one year"
    few = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
    told = few[round(number) - 2] if number.is_integer() and 2.0 <= number <= 10.0 else f"{number:g}"
    return f"{told} years"


def warning(survey: Survey) -> str:
    """The same for a file, whose reader may see nothing else of the survey; empty of real water."""
    return f"SIMULATED, nothing real was seen ({made_up})" if (made_up := world(survey)) else ""


WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def side_name(side: StructureSide, site: Site | None) -> str:
    """Such as "north-east side", "south end" or "top".

    Where nobody said how the map lies, its y axis is taken for north.
    """
    return side.kind if side.bearing is None else f"{wind(side.bearing, site)} {side.kind}"


def wind(bearing: float, site: Site | None) -> str:
    """The nearest of eight that lies in a world bearing, radians."""
    clockwise = 90.0 - math.degrees(bearing) + (0.0 if site is None else site.heading_deg)
    return WINDS[round(clockwise / 45.0) % 8]


def structure(one: SurveyedStructure) -> str:
    """How high a structure stands, and what of it was inspected, in two sentences."""
    of = {measure.name: measure for measure in one.measures if measure.value is not None}
    told = f"It stands {_between(of['height'])} above the ground around it. " if "height" in of else ""
    share, surface = of.get("inspected_share"), of.get("known_surface")
    if share is not None and surface is not None:
        told += f"Of {_between(surface)} of surface that the map knows, {_between(share)} was inspected"
        more = of.get("open_area")
        if more is not None and more.value:
            told += f"; over {value_text(more)} it ends in what no look has shown, and may go on"
        told += "."
    return told


def of_structures(survey: Survey) -> list[tuple[int, str, tuple[Measure, ...]]]:
    """Number, side and measures of each structure, and of each of its sides of which something is known.

    The side of a whole structure is empty.
    """
    told = []
    for number, one in enumerate(survey.structures, start=1):
        told.append((number, "", one.measures))
        told += [
            (number, side_name(side, survey.site), side.measures)
            for side in one.sides
            if any(m.value for m in side.measures)
        ]
    return told


def world(survey: Survey) -> str:
    """Which one was simulated, such as "world reef/string, seed 1"; empty of real water."""
    if not survey.simulated:
        return ""
    name, seed = survey.made_by["world"], survey.made_by.get("seed")
    return f"world {name}" + (f", seed {seed}" if seed is not None else "")


def place(survey: Survey) -> str:
    """Where it was: its own name where nobody said."""
    return survey.site.name if survey.site is not None else survey.name


def day(survey: Survey) -> str:
    """When it began, such as "1 June 2026"."""
    return f"{survey.began:%d %B %Y}".lstrip("0")


def found(survey: Survey) -> str:
    """What was looked for."""
    return {Target.OYSTERS: "oyster reef", Target.WRECK: "wreck"}.get(survey.target, "target")


def summary(survey: Survey) -> list[str]:
    """What was found, in a few sentences for whoever reads nothing else."""
    of = {measure.name: measure for measure in survey.measures if measure.value is not None}
    mapped = float((survey.layers.state != 0).mean())
    lines = [line] if (line := doubt(survey.protocol, survey.target)) else []
    if survey.target is Target.WRECK:
        if area := of.get("outline_area"):
            lines.append(f"The wreck covers {_between(area)} of the seabed.")
        if high := of.get("highest_point"):
            lines.append(f"Its highest point stands {_between(high)} above the bare seabed around it.")
        if seen := of.get("hull_seen"):
            lines.append(f"{value_text(seen)} of its outer surface was looked at.")
        share, more = of.get("inspected_share"), of.get("open_area")
        if share:
            lines.append(f"{_between(share)} of its surface that the map knows was inspected.")
        if more and more.value:
            lines.append(f"Over {value_text(more)} that surface ends in what no look has shown.")
    else:
        if area := of.get("reef_area"):
            count = len(survey.patches)
            patches = f" in {count} {'patch' if count == 1 else 'patches'}" if count else ""
            # Unseen ground farther off may hold a reef of its own, which no frame says anything about.
            where = ", where it was looked at and right beside" if mapped < 1.0 else ""
            lines.append(f"Reef covers {_between(area)}{patches}{where}.")
        if density := of.get("density"):
            lines.append(
                f"On each square metre of it there are {_between(density, unit=False)} individuals. "
                f"{NOT_OYSTERS}."
            )
        if size := of.get("median_size"):
            lines.append(f"Half of the individuals are wider than {_between(size)}.")
        if height := of.get("reef_height"):
            lines.append(f"The reef stands {_between(height)} above the bare seabed.")
    # The map may reach beyond the area to be seen: its own share only where a survey tells no other.
    told = of.get("seen_share")
    looked = (
        f"{value_text(told)} of the area that was to be seen"
        if told
        else f"{100.0 * mapped:.0f} % of the map"
    )
    lines.append(f"{looked} was looked at; of the rest nothing is known.")
    return lines


def _between(measure: Measure, *, unit: bool = True) -> str:
    """Such as "34.8 m² (33.1 to 36.6)"."""
    assert measure.value is not None  # `summary` takes no others.
    value = value_text(measure) if unit else _number(measure.value, measure)
    if measure.low is None or measure.high is None:
        return value
    return f"{value} ({_number(measure.low, measure)} to {_number(measure.high, measure)})"


NOT_OYSTERS = "An individual is a clump of shells, not one oyster"
CLUMPS = (
    f"{NOT_OYSTERS}: an individual is a clump of shells that grows from one base. How many oysters live in "
    "it is not known."
)
"""What an individual of a reef is."""


def trend_limits(target: Target) -> list[str]:
    """What a series does not say. Stands with every picture of one."""
    lines = [
        "Each point is one survey of what it saw, laid on no other. Whether two of them differ is told by "
        "dream survey compare, which holds only ground against each other that both saw."
    ]
    if target is not Target.WRECK:
        lines.append(
            "Counts and sizes were calibrated on simulated reefs, new and up to four years on. On a reef "
            "that grows in another way they may be off, and alike so in all surveys of it."
        )
    return lines


def limits(survey: Survey) -> list[str]:
    """What the figures do not say. Stands in every report."""
    worst = float(survey.track.sigma.max(initial=0.0))
    lines = [
        "Every interval is a 95 % interval: in one case of twenty the true figure lies outside of it. "
        + _calibrated(survey),
        "A camera and a program made these figures. Nobody has checked what it found one by one, and none "
        "was touched: whether one is alive, and what grows below the surface of the reef, is not known.",
    ]
    if survey.target is not Target.WRECK:
        lines.append(
            f"{CLUMPS} The size of one is its longest diameter as seen from above. Where individuals grow "
            "into each other, their number is corrected, and the interval is wider."
        )
        lines.append(
            f"Lists and maps show the {len(survey.individuals)} individuals that were found one by one. They "
            "are not all: how many there are is an estimate, which stands among the measures."
        )
    lines.append(
        "Ground that no frame saw counts as bare, but for what is likely right beside reef, which is added "
        "and told with the area. What lies farther into it is in no figure and in no interval. The map of "
        "how often each place was looked at shows where the figures rest on few frames."
    )
    if survey.structures:
        lines += [
            "Surface is that of the cubes of the map: a thin plate counts once, an edge more than once. An "
            "inspected share is of the surface that the map knows; what no look has shown is in no share, "
            "and of how much there may be only its edge is told.",
            "What hangs together above the ground is the wreck or not as a whole, by most of its labels. A "
            "boulder that is labelled wrongly from everywhere is told as a structure.",
        ]
    if worst > 0.0:
        errs = f"along the way they may err by up to {max(worst, 0.01):.2f} m (one sigma)"
    else:
        errs = "by its own account without error"
    lines.append(
        f"Positions are those that the vehicle believed, {errs}; all of them share the error of the origin, "
        "which is not included."
    )
    if survey.site is None:
        lines.append(
            "The survey has no origin: positions are metres from where the run began, and north is not known."
        )
    if text := simulated(survey):
        lines.append(f"{text}. No real place was surveyed.")
    return lines


def _calibrated(survey: Survey) -> str:
    """What the intervals rest on."""
    if survey.target is Target.WRECK:
        return "So it is meant: they were set on a few simulated wrecks, and not calibrated."
    if doubtful := doubt(survey.protocol, survey.target):
        return f"Not so here. {doubtful}"
    return (
        "So it is on simulated reefs, on which the method was calibrated. Where shells grow in another way, "
        "or the water is worse, counts, densities and sizes err by more until they are checked there against "
        "quadrats."
    )


def facts(survey: Survey) -> list[tuple[str, str]]:
    """When, where and how, as (what, value)."""
    told = [
        ("Survey", survey.name),
        ("Began", survey.began.strftime("%d %B %Y, %H:%M %Z").lstrip("0") + _simulated_date(survey)),
        ("Looked for", found(survey)),
    ]
    if survey.site is not None:
        site = survey.site
        north, east = "N" if site.latitude >= 0 else "S", "E" if site.longitude >= 0 else "W"
        origin = f"{abs(site.latitude):.5f}° {north}, {abs(site.longitude):.5f}° {east} (WGS 84)"
        told += [("Origin", origin), ("Depths below", site.datum)]
        if site.uncertainty is not None:
            told.append(("Origin sure to", f"{site.uncertainty:g} m (95 %)"))
    steps = len(survey.track.time) - 1
    minutes = (float(survey.track.time[-1]) if len(survey.track.time) else 0.0) / 60.0
    told += [
        ("Mission", f"{max(0, steps)} steps, {travelled(survey):.0f} m in {minutes:.0f} min"),
        ("Box", f"{survey.area.width:g} × {survey.area.depth:g} m"),
        ("Protocol", survey.protocol),
    ]
    if planner := survey.made_by.get("planner"):
        told.append(("Planner", str(planner)))
    if text := simulated(survey):
        told.append(("Simulated", text.removeprefix("Simulated: ")))
    return told


def _simulated_date(survey: Survey) -> str:
    return f" (simulated: {years(survey.years_on)} after it was flown)" if survey.years_on else ""


def travelled(survey: Survey) -> float:
    """Metres over ground."""
    track = survey.track.position[:, :2]
    return float(sum(math.dist(a, b) for a, b in pairwise(track)))
