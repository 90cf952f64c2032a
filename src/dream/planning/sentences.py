"""The six reasoning steps in words: plain sentences that are true of the map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.planning.travel import Travel

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Completion, Region
    from dream.planning.lookahead import Choice, Plan
    from dream.planning.prior_survey import PriorSurvey

COMPASS = ("east", "northeast", "north", "northwest")
WALK = "What was found is traversed before anything else is looked for."
"""Why it goes there: a walk over targets."""
ROUND = "It is the shortest way found round all that the survey makes worth looking at."
"""Why it goes there: a way round all that is foretold."""
LEFTOVER = "Of all views it shows most of what is left, for each step there."
"""Why it goes there: to what only the map's own view still promises."""


def distribution(occupancy: OccupancyMap, completion: Completion) -> str:
    """Step 1: where targets are."""
    share = f"{float(occupancy.explored.mean()):.0%} of the area is explored"
    if not completion.regions:
        return f"No target has been seen yet; {share}."
    area = float(occupancy.target.sum()) * occupancy.protocol.cell**2
    largest = max(completion.regions, key=lambda region: len(region.cells))
    length, direction = _extent(largest, occupancy)
    shape = f"{length:.0f} m {direction} around {_place(largest.centroid)}"
    if len(completion.regions) == 1:
        return f"Targets cover {area:.1f} m² in one region, {shape}; {share}."
    return f"Targets cover {area:.1f} m² in {len(completion.regions)} regions, the largest {shape}; {share}."


def expectations(beside: npt.NDArray[np.floating[Any]], groups: float, occupancy: OccupancyMap) -> str:
    """Step 1 in figures: what is to be expected beside targets and away from them."""
    area = float(beside.sum()) * occupancy.protocol.cell**2
    further = "no further patch" if groups < 0.005 else f"{groups:.2f} patches on average"
    return (
        f" Still expected: {area:.1f} m² of targets beside those seen or glimpsed, "
        f"and {further} in ground not searched."
    )


def expectations_for_models(
    beside: npt.NDArray[np.floating[Any]], groups: float, occupancy: OccupancyMap
) -> str:
    """The same as models are told it; these words stay, since a recorded answer is one to its question."""
    area = float(beside.sum()) * occupancy.protocol.cell**2
    return (
        f" Beside targets seen or glimpsed {area:.1f} m² more are to be expected, "
        f"and {groups:.2f} groups in ground not searched."
    )


def hinted(area: float, precision: float) -> str:
    """Step 1: how many square metres of that are hints from beyond the reach, and how far believed."""
    if area < 0.05:
        return ""
    return (
        f" Of that {area:.1f} m² lie where targets were glimpsed beyond the reach; "
        f"such hints are taken to come true to {precision:.0%}."
    )


def foretold(survey: PriorSurvey, occupancy: OccupancyMap) -> str:
    """Step 1: what an earlier survey foretells, how far it is believed, and what is other than it was."""
    left, new, gone = (n * occupancy.protocol.cell**2 for n in survey.told(occupancy))
    prior = survey.prior
    moved = ""
    if survey.shift != (0, 0):
        north, east = (k * prior.cell for k in survey.shift)
        sides = "west" if east < 0.0 else "east", "south" if north < 0.0 else "north"
        moved = (
            f" It is taken to lie {abs(east):.2f} m {sides[0]} and {abs(north):.2f} m {sides[1]} of where it "
            f"was told, give or take {survey.spread:.1f} m."
        )
    return (
        f" The survey {prior.source}, {prior.years:.1f} years old, is believed to {survey.believed:.0%}: "
        f"{left:.1f} m² where it foretells targets are still to be seen; {new:.1f} m² of targets are new, "
        f"{gone:.1f} m² are gone.{moved}"
    )


def target_area(area: Region | None, completion: Completion) -> str:
    """Step 2: the nearest region that is open."""
    if area is None:
        return "None: " + (
            "every known region is enclosed." if completion.regions else "nothing to work on yet."
        )
    cells = f"{len(area.open_cells)} unknown cell{'s' if len(area.open_cells) != 1 else ''}"
    return f"The nearest open region, around {_place(area.centroid)}, with {cells} at its edge or inside."


def completeness(completion: Completion, hidden: npt.NDArray[np.bool_], group_radius: float) -> str:
    """Step 3: what is still open."""
    regions = _closed(completion)
    if not hidden.any():
        return f"{regions}, and nowhere could a patch of {group_radius:g} m radius still hide."
    return f"{regions}; a patch of {group_radius:g} m radius could still hide in ground not explored."


def certainty(completion: Completion, risk: float, accepted: float) -> str:
    """Step 3, with the risk of stopping now."""
    return (
        f"{_closed(completion)}. If it stopped now, it would miss a whole patch with a probability "
        f"{'below 0.01%' if risk < 1e-4 else f'of {risk:.2%}'}; up to {accepted:.2%} is accepted."
    )


def certainty_for_models(completion: Completion, risk: float, accepted: float) -> str:
    """The same as models are told it; see `expectations_for_models`."""
    return (
        f"{_enclosed(completion)}. "
        f"To stop now would miss a group with a probability of {risk:.2%}; {accepted:.2%} is accepted."
    )


def not_counted(given_up: float) -> str:
    """Step 3: ground that was given up, in square metres; the risk takes it for searched."""
    if not given_up:
        return ""
    return f" {_area(given_up)} m² that never came into view were given up and are not counted."


def enough(given_up: float) -> str:
    """Why the mission ends: all that it promised was seen, but for some square metres that were given up."""
    but = f", but for {_area(given_up)} m² that were given up" if given_up else ""
    return f"Every region is enclosed and little can have been missed{but}: done."


def nothing_left(given_up: float) -> str:
    """Why the mission ends: nothing can be looked at; of that some square metres were given up."""
    but = f"; {_area(given_up)} m² that never came into view were given up" if given_up else ""
    return f"Nothing is left that any known way leads to a view of{but}: done."


def hints_left(area: float) -> str:
    """Step 3: square metres of hints that are still to be looked at."""
    return f" Hints of {area:.1f} m² of targets are still to be looked at." if area >= 0.05 else ""


def hull(area: float, share: float, accepted: float) -> str:
    """Step 3 of a hull: what is still to be expected of it, in square metres and as a share."""
    return (
        f" Of the hull {area:.1f} m² more are to be expected, {share:.1%} of it; {accepted:.1%} is accepted."
    )


def certificate(completion: Completion, unseen: float) -> str:
    """Step 3, where all must be seen."""
    return f"{_enclosed(completion)}. {unseen:.1f} m² that can be seen were not yet, and all must be."


def traversal(occupancy: OccupancyMap, completion: Completion) -> str:
    """Step 3, where targets must be traversed."""
    targets = occupancy.target & occupancy.to_see
    done, total = np.count_nonzero(targets & occupancy.traversed), np.count_nonzero(targets)
    left = len(completion.untraversed) or "none"
    return f" {done} of {total} target cells were traversed; {left} of the rest can be by known ways."


def left_to_traverse(occupancy: OccupancyMap, completion: Completion) -> str:
    """Step 2, where targets must be traversed and some were not."""
    middle = np.mean(np.stack(occupancy.center_of(*completion.untraversed.T), axis=-1), axis=0)
    return f"What is left to traverse: {len(completion.untraversed)} target cells around {_place(middle)}."


def plan(ahead: Plan, travel: Travel) -> str:
    """Step 4: where the next actions lead, and what they are expected to show."""
    end = travel.lattice.world(ahead.path[-1])
    steps = len(ahead.path) - 1
    towards = bearing(end.yaw)
    lead = "The next step leads" if steps == 1 else f"The next {steps} steps lead"
    shown = []
    if ahead.targets >= 0.05:
        shown.append(f"{ahead.targets:.1f} m² of targets")
    if ahead.patches >= 0.05:
        shown.append(f"{ahead.patches:.1f} pieces of hull")
    if ahead.cleared >= 0.5:
        shown.append(f"{ahead.cleared:.0f} m² on which the middle of a patch could lie")
    if ahead.cells:
        shown.append(f"{ahead.cells:.0f} of the cells that are still to be seen")
    what = f", and may show {' and '.join(shown)}" if shown else ""
    if ahead.passed:
        what = f", and traverse {ahead.passed} target cell{'s' if ahead.passed != 1 else ''}"
    later = f" What is left then takes about {ahead.later:.0f} more." if ahead.later >= 0.5 else ""
    return f"{lead} to {_place((end.x, end.y))}, looking towards {towards}{what}.{later}"


def choice(between: Choice) -> str:
    """Step 4: why it goes there, by what the look-ahead compared."""
    rate, view, share = _weight(between.rate), _weight(between.view), f"{between.jump:.0%}"
    if between.straight:
        best = f"It is the best single view for its distance, {view} weighted m² of targets a step"
        if between.rate == 0.0:
            return f"{best}; no sequence of the next actions shows anything."
        return f"{best}; the best sequence of actions gives {rate} at most, less than {share} of that."
    best = (
        f"It is worth most of {between.sequences} sequences of actions, {_weight(between.shown)} weighted m² "
        f"of targets on its way and {_weight(between.after)} by the tour after it"
    )
    if between.view == 0.0:
        return f"{best}; there is no single view to go to instead."
    return f"{best}; its best stretch gives {rate} a step, at least {share} of the best single view's {view}."


def next_target(
    travel: Travel,
    pose: Pose,
    expected: npt.NDArray[np.floating[Any]],
    occupancy: OccupancyMap,
) -> str:
    """Step 4: the frontier to go to next, and where to look at it from."""
    from dream.mapping import frontiers, gain

    lattice = travel.lattice
    position, heading, yaw = lattice.position(pose), lattice.heading_of(pose), lattice.world(pose).yaw
    steps = int(travel.steps[pose])
    cells = float(gain(occupancy, position[None], np.asarray(expected, np.float32))[0, heading])
    ahead = position + 0.5 * travel.protocol.reach * np.array([math.cos(yaw), math.sin(yaw)])
    edges = frontiers(occupancy)
    where = ""
    if edges:
        edge = min(edges, key=lambda f: math.hypot(f.centroid[0] - ahead[0], f.centroid[1] - ahead[1]))
        where = f"The frontier around {_place(edge.centroid)}, one of {len(edges)}: "
    count = "1 step" if steps == 1 else f"{steps} steps"
    view = f"the view from {_place(position)} towards {bearing(yaw)}, {count} away"
    sentence = f"{where}{view}, is expected to show {cells:.1f} more target cells."
    return sentence[0].upper() + sentence[1:]


def safety(occupancy: OccupancyMap, travel: Travel, path: list[Pose]) -> str:
    """Step 5: what the body keeps clear of on a way."""
    protocol = travel.protocol
    nodes = travel.lattice.position(path)
    samples = max(2, math.ceil(4.0 * max(protocol.advances) / protocol.cell))
    along = np.linspace(0.0, 1.0, samples)[:, None, None]
    points = (nodes[:-1] + along * (nodes[1:] - nodes[:-1])).reshape(-1, 2)
    distance = float(occupancy.distance_to_solid[occupancy.cell_of(*points.T)].min())
    free = f"The {'next move' if len(path) == 2 else 'way'} crosses only ground known to be free"
    if not math.isfinite(distance):
        return f"{free}; nothing solid has been seen."
    # Between the middles of two cells; their corners may be half a diagonal nearer each.
    clear = math.floor(10.0 * (distance - math.sqrt(2.0) * protocol.cell - protocol.body_radius)) / 10.0
    if clear <= 0.0:
        return f"{free}, close by something solid."
    return f"{free} and keeps the body {clear:.1f} m or more from solids."


def action(turn: float, advance: float) -> str:
    """Step 6: the move."""
    parts = []
    if turn:
        side = "round" if abs(abs(turn) - math.pi) < 1e-6 else "left" if turn > 0 else "right"
        parts.append("turn round" if side == "round" else f"turn {side} by {abs(math.degrees(turn)):.0f}°")
    if advance:
        parts.append(f"advance {advance:g} m")
    return (", ".join(parts) or "hold and look again").capitalize() + "."


def bearing(yaw: float) -> str:
    """A heading as a compass counts it: degrees clockwise from up on the map, its north.

    Args:
        yaw: Radians, counter-clockwise from the map's x.
    """
    return f"{round(90.0 - math.degrees(yaw)) % 360}°"


def _closed(completion: Completion) -> str:
    """How many of the regions of targets that are known have explored ground all round."""
    count = len(completion.regions)
    closed = sum(region.enclosed for region in completion.regions)
    if count == 0:
        return "No region of targets is known"
    if count == 1:
        return f"The one region of targets is {'' if closed else 'not yet '}enclosed by explored ground"
    all_of = "All" if closed == count else f"{closed} of"
    return f"{all_of} {count} regions of targets are enclosed by explored ground"


def _enclosed(completion: Completion) -> str:
    closed = sum(region.enclosed for region in completion.regions)
    return f"{closed} of {len(completion.regions)} regions are enclosed by explored ground"


def _place(point: npt.ArrayLike) -> str:
    x, y = np.asarray(point, dtype=np.float64)
    return f"({x:.1f}, {y:.1f})"


def _area(square_metres: float) -> str:
    return f"{square_metres:.1f}" if square_metres >= 0.05 else f"{square_metres:.1g}"


def _weight(weight: float) -> str:
    if abs(weight) < 1e-4:
        return "almost 0"
    return f"{weight:.3g}" if abs(weight) < 99.5 else f"{weight:.0f}"


def _extent(region: Region, occupancy: OccupancyMap) -> tuple[float, str]:
    """Length along the region's main axis in metres, and that axis by compass."""
    rows, cols = region.cells.T
    points: npt.NDArray[Any] = np.stack(occupancy.center_of(rows, cols), axis=-1)
    centred = points - points.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    along = centred @ axis
    sector = round(math.atan2(axis[1], axis[0]) / (math.pi / 4.0)) % 4
    return float(np.ptp(along)) + occupancy.protocol.cell, f"long towards {COMPASS[sector]}"
