"""What the options of a dive say: where it is, what may be, what pictures are made into labels with."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from dream.geometry import SE2, Bounds
from dream.planning import PLANNERS
from dream.protocol import POOL_V1, protocol_named

if TYPE_CHECKING:
    from dream.commands.dive import Dive
    from dream.estimation import Mounting
    from dream.perception import Perception
    from dream.robots.bluerov2.devices import Addresses
    from dream.robots.bluerov2.lens import Lens
    from dream.robots.bluerov2.limits import Limits

LEARNED, SHELLS = "learned", "shells"
"""Words for how pictures become labels and depth."""
SLOWEST_SOUND, FASTEST_SOUND = 1400.0, 1600.0
"""m/s. Fresh water of 0 °C has 1402 (Del Grosso and Mader 1972), sea water of 30 °C 1545 (Mackenzie 1981)."""


@dataclass(frozen=True, slots=True)
class Sight:
    """What pictures are made labels and depth with."""

    lens: Lens | None
    """None where they come without distortion."""
    perception: Perception


def sight_told(told: Dive) -> Sight:
    """By the options; the files are read.

    Raises:
        ValueError: One is not what it should be.
    """
    from dream import perception
    from dream.perception import LearnedDepth, LearnedLabels, Perception
    from dream.robots.bluerov2.lens import Lens

    lens = None if told.calibration is None else Lens.read(told.calibration)
    labels: perception.Segmenter
    depth: perception.DepthModel
    if flat(told):
        labels, depth = perception.Shells(), perception.FlatFloor()
    else:
        labels = depth = perception.Sight(None if told.see in (None, LEARNED) else told.see)
    if told.labels is not None:
        labels = LearnedLabels(told.labels, under=labels)
    if told.depth is not None:
        depth = LearnedDepth(told.depth)
    check = None if isinstance(depth, perception.FlatFloor) else perception.Parallax()
    return Sight(lens, Perception(labels, depth, check))


def flat(told: Dive) -> bool:
    """Whether shells are found by their colour, on a floor that is taken for flat.

    By the rules of a tank they are, and in a simulated one; elsewhere only where somebody says so.
    """
    tank = told.stand_in or told.protocol == POOL_V1.name
    return told.see == SHELLS or (told.see is None and tank)


def check_options(told: Dive) -> None:
    """Refuse what could not be dived with.

    Raises:
        ValueError: An option is out of its range, or does not go with another.
    """
    from dream.mapping import OccupancyMap
    from dream.robots.bluerov2.navigation import DVL_AT, check_aboard

    places = {"--dvl-at": told.dvl_at, "--gauge-at": told.gauge_at, "--camera-at": told.camera_at}
    for name, place in places.items():
        if place is not None:
            check_aboard(name, place)
    if not -90.0 <= told.tilt <= 90.0:
        raise ValueError(f"--tilt: expected -90 to 90 degrees down, got {told.tilt:g}")
    protocol = protocol_named(told.protocol)
    if protocol.space is not None and abs(math.radians(told.tilt) - protocol.camera_pitch) > 1e-6:
        raise ValueError(
            f"--tilt: expected {math.degrees(protocol.camera_pitch):g}, where the camera looks at the launch "
            f"under {protocol.name}, got {told.tilt:g}"
        )
    sound = told.speed_of_sound
    if sound is not None and not SLOWEST_SOUND <= sound <= FASTEST_SOUND:
        raise ValueError(
            f"--speed-of-sound: expected {SLOWEST_SOUND:g} to {FASTEST_SOUND:g} m/s, got {sound:g}"
        )
    lowest = protocol.altitude if protocol.space is None else protocol.space.lowest
    swims = lowest + (told.dvl_at or DVL_AT)[2]
    if not told.min_altitude < swims:
        raise ValueError(
            f"--min-altitude: expected less than the {swims:g} m of the A50 above the floor under "
            f"{told.protocol}, got {told.min_altitude:g}"
        )
    if protocol.space is not None and told.depth is None and flat(told) and not told.stand_in:
        raise ValueError(
            f"--see: expected learned, or a network with --depth, under {protocol.name}, got shells: where "
            "the floor is taken for flat, what stands on it is not in the map, and the vehicle runs into it"
        )
    if told.lights is not None and not 0.0 <= told.lights <= 1.0:
        raise ValueError(f"--lights: expected a share from 0 to 1, got {told.lights:g}")
    if told.stand_in:
        own = ("area", "at", "vehicle", "dvl", "camera", "surface_pressure")
        for given in fields(told):
            if given.name in own and getattr(told, given.name) != given.default:
                option = "--" + given.name.replace("_", "-")
                raise ValueError(f"{option}: expected none with --stand-in, which has its own: see --world")
    if told.area is None:
        return
    x, y, _ = told.at
    try:
        OccupancyMap(Bounds(*told.area), protocol_named(told.protocol))
    except ValueError as error:
        raise ValueError(f"--area: {str(error).removeprefix('bounds: ')}") from error
    if not Bounds(*told.area).contains(x, y):
        area = " ".join(f"{side:g}" for side in told.area)
        raise ValueError(f"--at: expected a place inside --area {area}, got {x:g} {y:g}")


@dataclass(frozen=True, slots=True)
class Waters:
    """Where a dive is, and how its devices are reached there."""

    area: Bounds
    """What to survey, in the map."""
    start: SE2
    """Where the vehicle lies at the launch."""
    addresses: Addresses
    surface_pressure: float
    """hPa; NaN where it is measured."""


def waters_told(told: Dive) -> Waters:
    """Of a vehicle of one's own."""
    from dream.robots.bluerov2.devices import Addresses

    assert told.area is not None
    x, y, heading = told.at
    return Waters(
        Bounds(*told.area),
        SE2(x, y, math.radians(heading)),
        Addresses(told.vehicle, told.dvl, told.camera, told.pilot),
        math.nan if told.surface_pressure is None else told.surface_pressure,
    )


def limits_told(told: Dive, bounds: Bounds) -> Limits:
    """Where and how long the vehicle may be, by the options."""
    from dream.robots.bluerov2.limits import LastResort, Limits

    options = {
        "depth": "--max-depth",
        "minutes": "--minutes",
        "voltage": "--min-voltage",
        "altitude": "--min-altitude",
    }
    try:
        return Limits(
            area=bounds,
            depth=told.max_depth,
            minutes=told.minutes,
            voltage=told.min_voltage,
            last_resort=LastResort(told.last_resort),
            altitude=told.min_altitude,
        )
    except ValueError as error:
        name, _, wrong = str(error).partition(": ")
        raise ValueError(f"{options.get(name, name)}: {wrong}") from error


def mounting_told(told: Dive) -> Mounting:
    """Where the instruments sit, by the options."""
    from dream.robots.bluerov2.navigation import DVL_AT, GAUGE_AT, mounting_of

    return mounting_of(told.dvl_at or DVL_AT, told.gauge_at or GAUGE_AT)


_NOT_REPEATED = ("planner", "ground", "homing", "out", "json", "live")
"""Fields that are no option, or change nothing of the dive."""


def repeating_command(told: Dive, name: str) -> str:
    """The command line that dives so again; options at their defaults are left out."""
    words = ["dream", "dive", name]
    without = type(told)()
    for owner, default in ((told.planner, PLANNERS[name]), (told, without), (told.ground, without.ground)):
        for field in fields(owner):
            value = getattr(owner, field.name)
            if field.name in _NOT_REPEATED or value == getattr(default, field.name):
                continue
            if field.name == "archive" and "://" in value:
                continue  # It may hold a password.
            words.append("--" + field.name.replace("_", "-"))
            if value is not True:
                words += [f"{one:g}" for one in value] if isinstance(value, tuple) else [str(value)]
    budget = told.homing.budget()
    return shlex.join([*words, *([] if budget is None else budget.options)])
