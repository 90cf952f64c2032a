"""A barge on its side, its open hold like a gallery."""

from __future__ import annotations

import math

import numpy as np

from dream.sim.sampling import index, power, sine
from dream.sim.wrecks.debris import drum, girder, pipe, plate, scattered
from dream.sim.wrecks.fittings import bitts, dented, holed, without
from dream.sim.wrecks.hull import Bays
from dream.sim.wrecks.paint import INSIDE, RED_LEAD, RUST
from dream.sim.wrecks.shapes import FloatArray, Part, beam, box, inside_out, rectangle, squared, turn

_RISE = 2.75
"""Length of the raked ends."""


def barge(rng: np.random.Generator) -> list[Part]:
    """A dumb barge that rolled over: bottom to one side, deck and open hold to the other."""
    # Half metres, so that the edges of the hold fall on the grid of the deck.
    length = 16.0 + 0.5 * index(rng, 6)
    beam_width, depth = 4.0, 2.5 + 0.25 * index(rng, 2)
    half, side = length / 2, beam_width / 2
    hold, wing = half - 3.5, side - 0.75

    def displacement(points: FloatArray) -> FloatArray:
        share = np.clip((np.abs(points[:, 0]) - half + _RISE) / _RISE, 0, 1)
        lift = 0.7 * power(share, 1.3) * np.clip(depth - points[:, 2], 0, None)
        return np.stack([np.zeros_like(lift), np.zeros_like(lift), lift], axis=1)

    low, high = (-half, -side, 0.0), (half, side, depth)
    bays = tuple(np.linspace(-half, half, 5)[1:-1].tolist())
    bottom = holed(box(low, high, "bottom", RED_LEAD, faces="z", two_sided=True), rng, 0.04)
    deck = box(low, high, "deck", RUST, faces="Z", two_sided=True)
    deck = without(deck, (-hold, -wing, 0), (hold, wing, 9))
    upper = holed(box(low, high, "upper side", RED_LEAD, faces="y", two_sided=True), rng, 0.3, size=1.8)
    lower = box(low, high, "bottom", RED_LEAD, faces="Y", two_sided=True)
    ends = box(low, high, "deck", RED_LEAD, faces="Xx", two_sided=True)
    coaming = box(
        (-hold, -wing, depth), (hold, wing, depth + 0.5), "coaming", RUST, faces="XxYy", two_sided=True
    )
    inner = inside_out(
        box((-hold, -wing, 0.4), (hold, wing, depth), "hold", INSIDE, faces="XxYyz", two_sided=True)
    )
    bulkhead = rectangle(
        (0.25, -wing, 0.4), (0, 2 * wing, 0), (0, 0, depth - 0.6), "hold", INSIDE, two_sided=True
    )
    thirds = tuple(np.linspace(-half, half, 4)[1:-1].tolist())
    wings = Bays(thirds, "deck")
    parts = [
        *bottom.divided(Bays(bays, "bottom", sides=False)),
        *deck.divided(wings),
        *upper.divided(Bays(thirds, "upper side", sides=False)),
        *lower.divided(Bays(bays, "bottom", sides=False)),
        *ends.divided(wings),
        *holed(coaming, rng, 0.08).divided(wings),
        *inner.divided(Bays((0.25,), "hold", sides=False)),
        holed(bulkhead, rng, 0.12),
        *bitts((half - 1.2, -1.2, depth), 0.6, 0.6, "deck 2 starboard"),
        *bitts((-half + 1.2, 0.9, depth), 0.6, 0.6, "deck 0 port"),
    ]
    webs = np.arange(-hold + 1.25, hold - 0.5, 1.25)
    for x in webs[np.abs(webs - 0.25) > 0.3].tolist():
        web = np.array([(x, -wing, 0.45), (x, wing, 0.45)])
        parts.append(beam(web, squared(0.12, 0.3), f"hold {int(x > 0.25)}", RUST, around=1))
    for y in (-side, side):
        rail = np.array([(-half, y, depth - 0.2), (half, y, depth - 0.2)])
        rubbing = beam(rail, squared(0.24, 0.2), "deck", RUST, around=1)
        parts += rubbing.divided(wings)
    parts = [part.warped(displacement) for part in parts]
    parts = dented(parts, rng, 0.07, 2.6)
    roll = math.radians(-83 - 5 * float(rng.random()))
    lowest = side * abs(float(sine(roll)))
    parts = [
        part.moved(turn("x", roll)).moved(turn("y", math.radians(2.0)), (0.0, 0.0, lowest - 0.65))
        for part in parts
    ]
    spilled = scattered(rng, (drum, drum, plate, girder), 18, half * 0.6, 0.6, middle=(0.0, depth + 0.9))
    return parts + spilled + scattered(rng, (plate, plate, pipe, girder), 40, half, depth / 2 + 0.9)
