"""A tour over what is left to look at: how much it yields, and how long it takes."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.planning._kernels.views import is_in

NEGLIGIBLE = 1e-6
"""Weight of an element for which a tour goes nowhere."""
DETOUR = 0.3
"""Steps that an area costs a tour beside the way there and the looking."""


@njit(cache=True, nogil=True)
def _time(x, y, x_to, y_to, service, pace, standoff):
    """Steps to an area and to look at all of it."""
    return max(math.hypot(x_to - x, y_to - y) - standoff, 0.0) / pace + service


@njit(cache=True, nogil=True)
def rates_between(mass, x, y, service, which, pace, standoff):
    """(n, n) mass of the second area for its time from the first, of some areas; see `tour`.

    Args:
        mass: See `tour`.
        x: See `tour`.
        y: See `tour`.
        service: See `tour`.
        which: (n,) bool, the areas to work it out for; of others, and where nothing is, it is not written.
        pace: See `tour`.
        standoff: See `tour`.
    """
    rates = np.empty((len(mass), len(mass)))
    some = np.flatnonzero(which & (mass > 0.0))
    for k in some:
        for m in some:
            rates[k, m] = mass[m] / _time(x[k], y[k], x[m], y[m], service[m], pace, standoff)
    return rates


@njit(cache=True, nogil=True)
def tour(mass, x_of, y_of, service, x, y, pace, standoff, discount, keep, rates, rated, left):
    """The yield of a tour over areas, and its steps: always on to the one of most mass for its time.

    Args:
        mass: (n,) what is left in each area.
        x_of: (n,) metres.
        y_of: (n,) metres.
        service: (n,) steps to look at all of it.
        x: Where the tour begins.
        y: Likewise.
        pace: Metres a step.
        standoff: Metres from which an area is looked at.
        discount: What a step later is worth.
        keep: Mass that may be left.
        rates: What `rates_between` gives for some areas.
        rated: (n,) bool, those areas.
        left: (n,) int64 scratch.

    Returns:
        The yield with its discount, and the steps.
    """
    n, remains = 0, 0.0
    for k in range(len(mass)):
        if mass[k] > 0.0:
            left[n] = k
            n += 1
            remains += mass[k]
    worth, steps, here = 0.0, 0.0, -1
    while remains > keep and n > 0:
        best, best_rate = 0, -1.0
        known = here >= 0 and rated[here]
        for i in range(n):
            k = left[i]
            if known and rated[k]:
                rate = rates[here, k]
            elif mass[k] / service[k] <= best_rate:  # Not even if it were here.
                continue
            else:
                rate = mass[k] / _time(x, y, x_of[k], y_of[k], service[k], pace, standoff)
            if rate > best_rate:
                best, best_rate = i, rate
        here = k = left[best]
        steps += _time(x, y, x_of[k], y_of[k], service[k], pace, standoff)
        worth += mass[k] * discount**steps
        remains -= mass[k]
        x, y = x_of[k], y_of[k]
        n -= 1
        left[best] = left[n]
    return worth, steps


@njit(cache=True, nogil=True)
def add_up(weights, elements, seen, x_of, y_of, area_of, service, which, mass, x, y, rest):
    """Write what is left in some areas: its weight, its middle, and the steps to look at all of it.

    Args:
        weights: See `tours`.
        elements: (n,) all those of these areas that count.
        seen: (words,) those that are not left.
        x_of: See `tours`.
        y_of: See `tours`.
        area_of: See `tours`.
        service: See `tours`.
        which: (areas,) bool.
        mass: (areas,) to write.
        x: Likewise.
        y: Likewise.
        rest: Likewise.
    """
    for k in np.flatnonzero(which):
        mass[k], x[k], y[k], rest[k] = 0.0, 0.0, 0.0, DETOUR
    for element in elements:
        if not is_in(seen, element):
            k, weight = area_of[element], weights[element]
            mass[k] += weight
            rest[k] += 1.0 / service
            x[k] += weight * x_of[element]
            y[k] += weight * y_of[element]
    for k in np.flatnonzero(which & (mass > 0.0)):
        x[k] /= mass[k]
        y[k] /= mass[k]


@njit(cache=True, nogil=True)
def tours(weights, seen, begins, x_of, y_of, area_of, areas, service, pace, standoff, discount, keep):
    """The tour over what is left after each of some sequences; see `tour`.

    Args:
        weights: (elements,) float32.
        seen: (n, words) what each sequence has seen.
        begins: (n, 2) metres east and north of node 0, where it ends.
        x_of: (elements,) float32 metres east of node 0.
        y_of: (elements,) float32 metres north of it.
        area_of: (elements,) int32 the area of each element.
        areas: How many there are.
        service: Elements that a step shows.
        pace: See `tour`.
        standoff: See `tour`.
        discount: See `tour`.
        keep: See `tour`.

    Returns:
        worth: (n,) with its discount from where the tour begins.
        steps: (n,)
    """
    n = len(begins)
    worth, steps = np.zeros(n), np.zeros(n)
    left = np.empty(areas, np.int64)
    counted = np.flatnonzero(weights > NEGLIGIBLE)
    # Most areas are left alike by all sequences.
    by_any = np.zeros_like(seen[0])
    for s in range(n):
        by_any |= seen[s]
    differs = np.zeros(areas, np.bool_)
    for element in counted:
        differs[area_of[element]] |= is_in(by_any, element)
    mass, x, y, rest = np.zeros(areas), np.zeros(areas), np.zeros(areas), np.zeros(areas)
    add_up(weights, counted, by_any, x_of, y_of, area_of, service, np.ones_like(differs), mass, x, y, rest)
    alike = ~differs
    rates = rates_between(mass, x, y, rest, alike, pace, standoff)
    counted = counted[differs[area_of[counted]]]
    for s in range(n):
        add_up(weights, counted, seen[s], x_of, y_of, area_of, service, differs, mass, x, y, rest)
        worth[s], steps[s] = tour(
            mass, x, y, rest, begins[s, 0], begins[s, 1], pace, standoff, discount, keep, rates, alike, left
        )
    return worth, steps
