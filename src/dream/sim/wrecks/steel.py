"""Three steel ships: a coaster that sank upright, one that broke in two, and a tug."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dream.sim.sampling import exponential, length, steady
from dream.sim.wrecks.debris import debris_field, drum, girder, pipe, plate, scattered
from dream.sim.wrecks.fittings import (
    bitts,
    collapsed,
    dented,
    funnel,
    glazed,
    hatch,
    holed,
    house,
    mast,
    spar,
    tyre,
    without,
    without_islands,
)
from dream.sim.wrecks.hull import Bays, HullForm
from dream.sim.wrecks.paint import BLACK_HULL, GREEN_HULL, GREY_HULL, INSIDE, OCHRE, RUST, WHITE_HOUSE, waves
from dream.sim.wrecks.shapes import FloatArray, Part, beam, box, rounded, squared, turn


def _varied(rng: np.random.Generator, low: float, high: float) -> float:
    """A length between two, to the centimetre."""
    return round(low + (high - low) * float(rng.random()), 2)


def _bays(form: HullForm, count: int, prefix: str) -> Bays:
    edges = np.linspace(-form.length / 2, form.length / 2, count + 1)[1:-1]
    return Bays(tuple(edges.tolist()), prefix)


def _settled(parts: list[Part], *, heel: float, trim: float, sunk: float) -> list[Part]:
    """The parts heeled to port, down by the head and sunk into the seabed."""
    return [part.moved(turn("x", -heel)).moved(turn("y", trim), (0.0, 0.0, -sunk)) for part in parts]


def _forecastle(form: HullForm, start: float, region: str) -> list[Part]:
    """The raised deck at the bow, at the height of the bulwark, and the wall below its after end."""
    h = 1 + form.bulwark / form.depth
    stem, _ = form.ends(h)
    return [
        form.deck(region, RUST, h=h, between=(start, stem), two_sided=True),
        form.bulkhead(start, region, BLACK_HULL, low=1.0, high=h),
    ]


def coaster(rng: np.random.Generator) -> list[Part]:
    """A small coaster on an even keel: hold forward, bridge and funnel aft."""
    form = HullForm(
        length=_varied(rng, 19.5, 21.5),
        beam=_varied(rng, 5.4, 6.0),
        depth=_varied(rng, 3.5, 3.8),
        sheer_fore=0.7,
        sheer_aft=0.35,
        bulwark=0.7,
        entrance=6.5,
        run=3.2,
        rake=0.4,
        overhang=0.3,
    )
    heel = math.radians(_varied(rng, 4, 5.5)) * (1 if rng.random() < 0.5 else -1)
    bow, stern, deck = form.length / 2, -form.length / 2, form.depth
    fore = round(0.27 * form.length, 2)
    hold_low, hold_high = (-2.0, -1.35, deck - 0.1), (fore - 1.6, 1.35, deck + 0.6)
    ports = form.bulwarks("side", BLACK_HULL)
    middles = ports.quad_middles
    freeing = (np.abs(middles[:, 2] - form.deck_edge(middles[:, 0]) - 0.2) < 0.2) & (
        (middles[:, 0] + 20) % 3.0 < 0.6
    )
    ports = holed(ports.kept(~(freeing & (middles[:, 0] < fore))), rng, 0.05)
    ports = collapsed(ports, rng, 1 if heel > 0 else -1)
    planking = form.deck("deck", RUST)
    planking = without(planking, (hold_low[0] + 0.25, -1.1, 0), (hold_high[0] - 0.25, 1.1, 9))
    sides = _bays(form, 4, "side")
    parts = [
        *form.hull("side", BLACK_HULL).divided(sides),
        *ports.divided(sides),
        *planking.divided(replace(sides, prefix="deck", sides=False)),
        *_forecastle(form, fore, "forecastle"),
        hatch(hold_low, hold_high, "hatch"),
    ]
    aft = round(stern + 2.2, 2)
    low, high = (aft, -1.75, deck - 0.2), (aft + 4.5, 1.75, deck + 1.55)
    walls = house(low, high, "house", WHITE_HOUSE)
    walls = without(walls, (aft + 1.4, -9, 0), (aft + 2.2, -1.5, deck + 1.35))
    walls = glazed(walls, low, high, deck + 0.65, deck + 1.1)
    # The roof of the bridge is gone, and most of its walls.
    bridge_low, bridge_high = (aft + 2.0, -1.5, high[2]), (aft + 4.5, 1.5, high[2] + 1.25)
    bridge = box(bridge_low, bridge_high, "house", WHITE_HOUSE, faces="XxYy", two_sided=True)
    bridge = glazed(bridge, bridge_low, bridge_high, high[2] + 0.45, high[2] + 1.0)
    step = (fore - 0.8, 0.0, deck)
    parts += [
        walls,
        holed(bridge, rng, 0.2, size=1.6),
        *funnel((aft + 1.0, 0.0, high[2] - 0.1), 1.5, 0.5, "house"),
        mast(step, 3.8, 0.16, "hatch", lean=0.03),
        spar((fore - 1.1, 0.0, deck + 0.8), (fore - 5.4, 0.9, deck + 2.0), 0.1, "hatch"),
        box((fore + 0.8, -0.7, deck + 1.0), (fore + 1.6, 0.7, deck + 1.9), "forecastle", RUST),
        *(
            part
            for y in (-1.0, 1.0)
            for part in bitts((bow - 2.6, y * 0.6, deck + 1.3), 0.5, 0.7, "forecastle")
        ),
    ]
    parts = dented(parts, rng, 0.03, 3.0)
    parts = _settled(parts, heel=heel, trim=math.radians(1.0), sunk=deck - 2.15)
    return parts + scattered(rng, (plate, pipe, girder, drum), 46, form.length / 2, form.beam / 2)


def _torn(parts: list[Part], rng: np.random.Generator, at: float, side: int, *, splay: float) -> list[Part]:
    """What lies on one side (±1 in x) of a ragged break, its edges bent out."""
    ragged, coarse = waves(rng, 0.7), waves(rng, 2.4)
    outward = waves(rng, 1.6)

    def bent(points: FloatArray) -> FloatArray:
        near = exponential(-np.clip(side * (points[:, 0] - at), 0, None) / 0.7)
        push = splay * near * (0.5 + outward(points))
        return np.stack([np.zeros(len(points)), np.clip(points[:, 1], -1, 1) * push, -0.5 * push], axis=1)

    pieces = []
    for part in parts:
        across = part.centroids * (0, 1, 1)
        # Decks give way before the sides do.
        edge = at + side * (0.9 if part.region.startswith("deck") else 0.0)
        keep = steady(side * (part.centroids[:, 0] - edge) - 0.4 * coarse(across) - 0.25 * ragged(across)) > 0
        piece = part.kept(keep)
        if len(piece.faces):
            torn = without_islands(piece).warped(bent)
            corners = torn.vertices[torn.faces]
            longest = length(corners - np.roll(corners, 1, axis=1)).max(axis=1)
            # Steel that is drawn out this far has parted.
            pieces.append(torn.kept(steady(longest) < 0.8))
    return pieces


def broken(rng: np.random.Generator) -> list[Part]:
    """A ship in two: the bow has fallen over and away, the stern still stands; wreckage between."""
    form = HullForm(
        length=_varied(rng, 17.5, 19.0),
        beam=_varied(rng, 5.2, 5.7),
        depth=_varied(rng, 3.8, 4.2),
        sheer_fore=0.6,
        sheer_aft=0.35,
        bulwark=0.65,
        entrance=5.5,
        run=3.5,
        rake=0.4,
        overhang=0.3,
    )
    at, deck = 0.4, form.depth
    stern = -form.length / 2
    fore = round(0.28 * form.length, 2)
    shell = form.hull("side", GREY_HULL, two_sided=True)
    rail = form.bulwarks("side", GREY_HULL)
    planks = form.deck("deck", RUST, two_sided=True)
    low, high = (stern + 2.0, -1.6, deck - 0.2), (stern + 6.0, 1.6, deck + 1.5)
    walls = glazed(house(low, high, "aft house", WHITE_HOUSE), low, high, deck + 0.6, deck + 1.1)
    stern_parts = [
        *holed(shell, rng, 0.03).divided(Bays((-form.length / 4,), "aft side")),
        *holed(rail, rng, 0.12).divided(Bays((-form.length / 4,), "aft side")),
        *holed(planks, rng, 0.05).divided(Bays((-form.length / 4,), "deck aft", sides=False)),
        form.bulkhead(at - 2.0, "deck aft wall", INSIDE, low=0.2),
        holed(walls, rng, 0.1),
        *funnel((stern + 3.2, 0.0, deck + 1.4), 1.3, 0.5, "aft house", paint=BLACK_HULL),
    ]
    bow_parts = [
        *holed(shell, rng, 0.03).divided(Bays((form.length / 4,), "fore side")),
        *holed(rail, rng, 0.1).divided(Bays((form.length / 4,), "fore side")),
        *holed(planks, rng, 0.06).divided(Bays((form.length / 4,), "deck fore", sides=False)),
        form.bulkhead(at + 2.2, "deck fore wall", INSIDE, low=0.2),
        *_forecastle(form, fore, "forecastle"),
        mast((fore - 0.7, 0.0, deck - 0.1), 2.2, 0.17, "forecastle"),
        box((fore + 0.7, -0.6, deck + 0.9), (fore + 1.5, 0.6, deck + 1.7), "forecastle", RUST),
    ]
    aft = _settled(
        dented(_torn(stern_parts, rng, at, -1, splay=0.25), rng, 0.05, 2.5),
        heel=math.radians(_varied(rng, -7, -4)),
        trim=math.radians(2.0),
        sunk=deck - 2.2,
    )
    heel = math.radians(_varied(rng, 7, 8.5))
    bow = _settled(
        dented(_torn(bow_parts, rng, at, 1, splay=0.3), rng, 0.05, 2.5),
        heel=heel,
        trim=math.radians(-2.5),
        sunk=deck - 2.05,
    )
    swing = turn("z", math.radians(_varied(rng, 20, 30)))
    shift = (_varied(rng, 3.7, 4.2), _varied(rng, -1.6, -1.0), 0.0)
    parts = aft + [part.moved(swing, shift) for part in bow]
    parts += scattered(rng, (plate, plate, girder, pipe), 26, 1.2, 0.2, middle=(at + 2.0, 0.0))
    fallen = np.array([(-5.0, 4.4, 0.25), (1.2, 5.6, 0.12)])
    parts.append(beam(fallen, 0.17 * rounded(8), debris_field(-2.0, 5.0), RUST, around=1))
    return parts + scattered(rng, (plate, pipe, girder), 40, form.length / 2 + 1, form.beam / 2 + 0.8)


def tug(rng: np.random.Generator) -> list[Part]:
    """A harbour tug with a list: high wheelhouse, big funnel, towing bitts, tyres along the sides."""
    form = HullForm(
        length=_varied(rng, 13.5, 15.0),
        beam=_varied(rng, 4.8, 5.3),
        depth=_varied(rng, 3.3, 3.5),
        sheer_fore=0.75,
        sheer_aft=0.2,
        bulwark=0.75,
        entrance=4.6,
        run=3.2,
        rake=0.35,
        overhang=0.3,
    )
    deck = form.depth
    sides = _bays(form, 4, "side")
    low, high = (-1.6, -1.4, deck - 0.2), (4.4, 1.4, deck + 1.5)
    walls = without(house(low, high, "house", WHITE_HOUSE), (-1.1, -9, 0), (-0.3, -1.2, deck + 1.3))
    walls = glazed(walls, low, high, deck + 0.65, deck + 1.1)
    top = high[2]
    bridge_low, bridge_high = (1.7, -1.1, top), (3.9, 1.1, top + 1.4)
    bridge = glazed(
        house(bridge_low, bridge_high, "wheelhouse", OCHRE), bridge_low, bridge_high, top + 0.6, top + 1.2
    )
    tow = np.linspace(-1, 1, 33)
    arch = np.stack([np.full_like(tow, -4.4), 2.2 * tow, deck + 1.25 - 0.55 * np.square(tow * tow)], axis=1)
    tyres = []
    for x in np.linspace(-form.length * 0.32, form.length * 0.3, 6).tolist():
        breadth = float(form.half_breadth(np.array([x]), 1.0)[0])
        ahead = float(form.half_breadth(np.array([x + 0.1]), 1.0)[0])
        for side in (-1, 1):
            outward = (-(ahead - breadth) / 0.1, float(side), 0.0)
            edge = float(form.deck_edge(np.array([x]))[0])
            tyres.append(
                tyre(
                    (x, side * (breadth + 0.05), edge - 0.1),
                    outward,
                    f"side {int(np.searchsorted(sides.edges, x))} {'port' if side > 0 else 'starboard'}",
                )
            )
    parts = [
        *form.hull("side", GREEN_HULL).divided(sides),
        *collapsed(form.bulwarks("side", GREEN_HULL), rng, 1).divided(sides),
        *form.deck("deck", RUST).divided(Bays((-form.length / 6, form.length / 6), "deck", sides=False)),
        walls,
        bridge,
        box((1.45, -1.35, top + 1.4), (4.2, 1.35, top + 1.5), "wheelhouse", WHITE_HOUSE),
        *funnel((0.1, 0.0, top - 0.1), 1.6, 0.58, "funnel", paint=BLACK_HULL),
        mast((1.2, 0.0, top - 0.1), 2.6, 0.12, "funnel", lean=0.05),
        *bitts((-2.9, 0.0, deck - 0.1), 0.9, 1.2, "towing gear"),
        *bitts((form.length / 2 - 1.7, 0.0, deck + 0.6), 0.6, 0.9, "foredeck"),
        beam(arch, squared(0.18, 0.18), "towing gear", RUST, across=(1, 0, 0), around=1),
        box((-4.0, -0.7, deck - 0.1), (-3.3, 0.7, deck + 0.35), "towing gear", RUST),
        *tyres,
    ]
    parts = dented(parts, rng, 0.025, 3.0)
    heel, trim = math.radians(_varied(rng, 3.5, 5)), math.radians(_varied(rng, -1.5, 0.5))
    parts = _settled(parts, heel=heel, trim=trim, sunk=deck - 2.15)
    return parts + scattered(rng, (plate, pipe, girder, drum), 44, form.length / 2, form.beam / 2 + 0.4)
