"""The six reasoning steps of a vehicle that moves in three dimensions, in words that are true of the map."""

from __future__ import annotations

import math

from dream.mapping.structures import Structure
from dream.planning import sentences


def distribution(area: float, inspected: float, known: list[Structure]) -> str:
    """Step 1: how much target surface is known, how much of it is inspected, and how high it stands."""
    if area == 0.0:
        return "No target has been seen yet."
    share = f"{area:.0f} m² of target surface are known, {inspected / area:.0%} of it inspected"
    if not known:
        return f"{share}; nothing stands up."
    height = max(one.top - one.ground for one in known)
    what = "one structure stands" if len(known) == 1 else f"{len(known)} structures stand"
    return f"{share}; {what} up, {height:.1f} m above the ground at most."


def surface(known: float, inspected: float) -> str:
    """Step 1: the surface of what stands up, in square metres."""
    if known == 0.0:
        return "Nothing that stands up is known to be a target."
    return (
        f"{known:.0f} m² of what stands up are known to be target, {inspected / known:.0%} of it inspected."
    )


def remains(left: float, unknown: float, given_up: float, hidden: float) -> str:
    """Step 3: what is left of that, in square metres, and as a share."""
    lost = f"; {given_up:.1f} m² did not show where they should have and are given up" if given_up else ""
    return (
        f"{left:.1f} m² are still to be inspected, and {unknown:.1f} m² are expected where unknown water "
        f"touches it: {hidden:.1%} of all{lost}."
    )


def look(
    position: tuple[float, float, float], yaw: float, tilt: float, steps: int, target: float, unknown: float
) -> str:
    """Step 4: where to look from, how, and what it is to show, in square metres."""
    return (
        f"{_look_from(position, yaw, tilt, steps)} is expected to show {target:.1f} m² that are left and to "
        f"look into unknown water that may hide {unknown:.1f} m²."
    )


def ended(hidden: float, given_up: float, missed: tuple[float, float, float]) -> str:
    """Step 6: why the mission ends, and what such missions missed in simulation: the mean, least and most."""
    lost = f", {given_up:.1f} m² of it since no look showed them" if given_up else ""
    mean, least, most = missed
    return (
        f"Done: {hidden:.1%} of the surface of structures may be left, which no look shows well enough{lost}."
        f" Simulated missions that ended so missed {mean:.1%} of what can be inspected at all, eight of ten "
        f"{least:.1%} to {most:.1%}."
    )


SAFE = "The body stays in water known to be free all the way."
"""Step 5."""


def target_area(x: float, y: float, height: float, area: float) -> str:
    """Step 2: the nearest part of what is left to inspect."""
    where = f"around ({x:.1f}, {y:.1f}), {height:.1f} m above the ground"
    return f"The nearest part that is left, {where}, {area:.1f} m²."


def completion(left: float, edge: float, ground: float) -> str:
    """Step 3: what is still open, in square metres."""
    return (
        f"{left:.1f} m² of target were seen and not yet inspected, unknown water touches target on "
        f"{edge:.1f} m², and from {ground:.0f} m² of ground nothing returned within reach."
    )


def next_target(
    position: tuple[float, float, float], yaw: float, tilt: float, steps: int, target: float, ground: float
) -> str:
    """Step 4: where to look from, how, and what it is to show, in square metres."""
    return (
        f"{_look_from(position, yaw, tilt, steps)} is expected to show {target:.1f} m² of target that are "
        f"left and {ground:.0f} m² of ground."
    )


def _look_from(position: tuple[float, float, float], yaw: float, tilt: float, steps: int) -> str:
    """The beginning of both sentences."""
    x, y, z = position
    count = "1 step" if steps == 1 else f"{steps} steps"
    return (
        f"The look from ({x:.1f}, {y:.1f}), {-z:.1f} m deep, towards {sentences.bearing(yaw)}, the camera "
        f"{tilted(tilt)}, {count} away,"
    )


def safety(height: float, above: float, surface: float) -> str:
    """Step 5: the room on the next move.

    Args:
        height: Metres above what lies below at its end; inf where nothing is known there.
        above: Metres to something solid above; inf where none is known.
        surface: Metres to the surface of the water.
    """
    over = f", {height:.1f} m above what lies below" if math.isfinite(height) else ""
    up = (
        f"something solid {above:.1f} m above"
        if above < surface
        else f"only water above, {surface:.1f} m of it"
    )
    return f"The body stays in water known to be free{over}; {up}."


def action(turn: float, advance: float, climb: float, tilt: float | None) -> str:
    """Step 6: the move."""
    parts = []
    if turn or advance:
        parts.append(sentences.action(turn, advance).rstrip("."))
    if climb:
        parts.append(f"{'climb' if climb > 0.0 else 'descend'} {abs(climb):g} m")
    if tilt is not None:
        parts.append(f"turn the camera {tilted(tilt)}")
    words = ", ".join(parts) or "hold and look again"
    return f"{words[0].upper()}{words[1:]}."


def tilted(tilt: float) -> str:
    """A tilt of the camera."""
    degrees = round(math.degrees(tilt))
    return "level" if degrees == 0 else f"{abs(degrees)}° {'down' if degrees > 0 else 'up'}"
