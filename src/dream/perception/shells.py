"""Labels without a model: shells on a tank's floor, its wall, and pipes that stand in it.

Of a colour only a ratio is used, log(R/B): it does not change with light and shade, nor do the
bright lines of caustics show in it. Water takes the red, so everything is bluer the farther it is; what
counts is how much a pixel differs from what lies around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.perception.view import View
from dream.types import BoolArray, Float32Array, Label, UInt8Array

Line = tuple[float, float]
IntArray = npt.NDArray[np.signedinteger[Any]]
_LOG = np.log(np.arange(256) + 1.0).astype(np.float32)
STRIDE = 2
"""Columns to a step of the search for the floor's edge."""
STEEPEST = 7
"""Rows that the edge may rise or fall over a step, at most."""
BEND = 0.004
"""What each of these rows costs, in log brightness."""
COOL = 0.3
"""Quantile of log(R/B) over an image that is liner or wall, however many shells are in it."""
GLARE = 0.25
"""log(R/B) above that from which a pixel has no part in the search for the floor's edge."""
HALF = 0.5
"""Of a patch's greatest excess of log(R/B): where it ends, since a picture's colours are blurred."""
BLUR = 7
"""Pixels around, in which that excess is looked for."""
COLOUR_SPREAD = 0.08
"""log(R/B) from where a label changes within which it is often wrong; found on simulated pictures."""
EDGE_SPREAD = 0.6
"""Rows from the floor's edge within which labels are often wrong; likewise."""
STEP_SPREAD = 0.08
"""Step of log brightness at the floor's edge within which there may be none; likewise."""
PIPE_ABOVE = 12
"""Rows above the floor's edge in which a pipe is looked for."""
WIDEST = 0.4
"""Share of the image's width that no pipe takes up: one of 11 cm at the vehicle's nose takes 0.2."""
SMOOTH = 0.02
"""Mean change of log brightness from row to row that hardly any shell has."""
SMOOTH_ACROSS = 5
"""Pixels across that it is a mean over."""
SMOOTH_PIXELS = 40
"""Pixels of the smallest part of a pipe that is told by its smoothness."""


@dataclass(frozen=True, slots=True)
class Shells:
    """Shells, floor, wall and pipes by colour.

    What it does: finds the upper edge of the floor, the one line across the image with the greatest step
    of brightness (dynamic programming over columns). What lies above is wall. What is warmer than the floor
    below the edge is shell. A warm upright stripe that comes down over the edge is a pipe, as far as its
    foot; so is a smooth warm patch at the image's side, where only the lower part of a pipe is seen.

    Assumes: a tank, so that something solid is above the floor's edge; a liner and a wall of a bluish
    colour; shells and pipes that are warmer than both; a camera that is not rolled by more than some 20°.

    Fails when: floor and wall are of one colour and no shade marks their joint; a pipe is as blue as the
    wall. A view without an edge is called wall, with a confidence of a half: so it is before a wall that is
    near. It is not for open water, which it calls wall, and where it misses boulders and finds no shells.
    """

    warm: float = 0.2
    """log(R/B) by which a shell exceeds the floor around it."""
    pipe_warm: float = 0.2
    """log(R/B) by which a pipe exceeds the wall behind it."""
    edge: float = 0.15
    """Step of log brightness that the floor's edge has at least, on average."""
    highest: float = 0.15
    """Share of the image's height below its top where the horizon is at the highest: no floor is above. So
    the water's surface is not taken for the floor's edge."""
    smallest: int = 5
    """Pixels of the smallest patch that counts as shell."""

    def __post_init__(self) -> None:
        for name in ("warm", "pipe_warm", "edge"):
            if not 0.0 < getattr(self, name) < 5.0:
                raise ValueError(
                    f"{name}: expected a logarithm above 0 and below 5, got {getattr(self, name)}"
                )
        if not 0.0 <= self.highest < 1.0:
            raise ValueError(f"highest: expected a share of the image's height, got {self.highest}")

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        """See `Segmenter.segment`."""
        from scipy import ndimage

        red_blue, brightness = _features(rgb)
        cool = float(np.quantile(red_blue[::4, ::4], COOL))
        edge, sharp = self._floor_edge(brightness, red_blue > cool + GLARE)
        rows = np.arange(len(red_blue))[:, None]
        above = rows < edge
        wall = red_blue[::4][above[::4]]
        behind = float(np.median(wall)) if len(wall) else cool
        pipes = _pipes(red_blue - behind > self.pipe_warm, brightness, edge)
        excess = red_blue - _floor_colour(red_blue, above | pipes, cool)
        # A picture's colours are blurred: a patch ends where half of its excess is left.
        peak = ndimage.maximum_filter(np.where(above | pipes, 0.0, excess), BLUR)
        least = np.maximum(self.warm, HALF * peak)
        rim = ndimage.binary_dilation(pipes, np.ones((3, 3), np.bool_))
        shells = _cleaned((excess > least) & ~above & ~rim, self.smallest)
        labels = np.full(above.shape, Label.SEABED, np.uint8)
        labels[above | pipes] = Label.OBSTACLE
        labels[shells] = Label.TARGET
        colour = np.where(above | pipes, np.inf, np.abs(excess - least) / COLOUR_SPREAD)
        place = (np.abs(rows + 0.5 - edge) - 0.5) / EDGE_SPREAD
        seen = np.where(above & ~pipes, sharp / STEP_SPREAD, np.inf)
        doubt = np.exp(-colour) + np.exp(-place) + np.exp(-seen)
        return labels, np.maximum(1.0 - 0.5 * doubt, 0.5).astype(np.float32)

    def _floor_edge(self, brightness: Float32Array, warm: BoolArray) -> tuple[IntArray, Float32Array]:
        """First row of the floor in every column, H where there is none; and the step of brightness there.

        Args:
            brightness: (H, W) log.
            warm: (H, W) pixels of shells and pipes, whose outlines are no edge of the floor.
        """
        height, width = brightness.shape
        score = _step(brightness) - self.edge
        near = np.zeros((height + 1, width), np.bool_)
        near[:-1] = warm
        near[1:] |= warm
        for _ in range(2):
            near[1:] |= near[:-1]
            near[:-1] |= near[1:]
        score[near] = 0.0
        score[: max(3, round(self.highest * height))] = -self.edge
        score[-1] = 0.0
        score = score[:, ::STRIDE]
        cost = BEND * np.abs(np.arange(-STEEPEST, STEEPEST + 1, dtype=np.float32))
        best = np.ascontiguousarray(score.T)
        came = np.zeros(best.shape, np.int8)
        padded = np.full(height + 1 + 2 * STEEPEST, -np.inf, np.float32)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * STEEPEST + 1)
        at = np.arange(height + 1)
        for step in range(1, len(best)):
            padded[STEEPEST:-STEEPEST] = best[step - 1]
            moved = windows - cost
            choice = moved.argmax(axis=1)
            came[step] = choice
            best[step] += moved[at, choice]
        path = np.empty(len(best), np.intp)
        # Of equals the lowest: what nothing tells apart from wall is wall.
        path[-1] = height - best[-1][::-1].argmax()
        for step in range(len(best) - 1, 0, -1):
            path[step - 1] = path[step] + came[step, path[step]] - STEEPEST
        columns = np.arange(width)
        edge = np.rint(np.interp(columns, STRIDE * np.arange(len(path)), path)).astype(np.intp)
        shown = ~near[edge, columns] & (edge < height)
        steps = np.where(shown, score[edge, columns // STRIDE] + self.edge, np.float32(0.0))
        # Behind a pipe the edge is as sure as it is elsewhere; if it is hidden everywhere, there may be none.
        return edge, np.where(shown | (edge == height), steps, steps.mean(dtype=np.float32))


def _features(rgb: UInt8Array) -> tuple[Float32Array, Float32Array]:
    """log(R/B), a mean over 3 × 3 pixels, and log G; both (H, W)."""
    from scipy import ndimage

    red, green, blue = (_LOG[rgb[..., channel]] for channel in range(3))
    return ndimage.uniform_filter(red - blue, 3, mode="nearest"), green


def _step(image: Float32Array) -> Float32Array:
    """(H + 1, W): by how much the two rows above every boundary between rows differ from those below."""
    height = len(image)
    at = np.arange(height + 1)
    rows = [image[np.clip(at + shift, 0, height - 1)] for shift in (-2, -1, 0, 1)]
    step: Float32Array = np.abs(0.5 * (rows[2] + rows[3] - rows[0] - rows[1]))
    return step


def _floor_colour(red_blue: Float32Array, other: BoolArray, cool: float) -> Float32Array:
    """(H, 1): log(R/B) of the bare floor in every row: farther rows are bluer.

    Args:
        red_blue: (H, W).
        other: (H, W) what is not floor.
        cool: Where no row shows any floor.
    """
    thin = red_blue[:, ::2]
    floor = np.where(other[:, ::2], np.inf, thin)
    count = np.isfinite(floor).sum(axis=1)
    ordered = np.sort(floor, axis=1)
    colour = ordered[np.arange(len(floor)), (COOL * np.maximum(count - 1, 0)).astype(np.intp)]
    known = np.nonzero(count >= 8)[0]
    if len(known) == 0:
        return np.full((len(floor), 1), cool, np.float32)
    everywhere: Float32Array = np.interp(np.arange(len(floor)), known, colour[known]).astype(np.float32)
    return everywhere[:, None]


def _pipes(warm: BoolArray, brightness: Float32Array, edge: IntArray) -> BoolArray:
    """(H, W): warm upright stripes that come down from above the floor's edge, to their feet.

    A stripe of which the image shows only what is below the edge, at its side, is told by its smoothness.

    Args:
        warm: (H, W).
        brightness: (H, W) log.
        edge: (W,) first row of the floor.
    """
    from scipy import ndimage

    height, width = warm.shape
    above = np.arange(height)[:, None] < edge
    marks, _ = ndimage.label(warm & above)
    pipes = np.zeros_like(warm)
    for n, box in enumerate(ndimage.find_objects(marks), 1):
        # Where the edge is higher on one side of the stripe, only rows above all of it show both its sides.
        first, past = box[0].start, min(box[0].stop, int(edge[box[1]].min()))
        if past - first < PIPE_ABOVE:
            continue
        part = marks[first:past] == n
        if part.sum(axis=1).max() > WIDEST * width:
            continue
        pipes[box] |= marks[box] == n
        left, right = _sides(part, first)
        for row in range(past, height):
            a, b = (int(np.clip(round(side[0] * row + side[1]), 0, width)) for side in (left, right))
            if b <= a or warm[row, a:b].mean() < 0.5:
                break
            pipes[row, a:b] = True
    return pipes | _smooth(warm & ~above & ~pipes, brightness)


def _sides(part: BoolArray, first: int) -> tuple[Line, Line]:
    """The left and the right side of a stripe: slope and intercept of the column over the row.

    Args:
        part: (rows, W) the stripe; at least two rows of it.
        first: Row of the image that `part` begins with.
    """
    width = part.shape[1]
    rows = np.nonzero(part.any(axis=1))[0]
    left, right = part[rows].argmax(axis=1), width - part[rows, ::-1].argmax(axis=1)
    lines = []
    for side, border in ((left, 0), (right, width)):
        inside = side != border
        if inside.sum() < 4:
            lines.append((0.0, float(border)))
            continue
        slope, intercept = np.polyfit(rows[inside] + first, side[inside], 1)
        lines.append((float(slope), float(intercept)))
    return lines[0], lines[1]


def _smooth(warm: BoolArray, brightness: Float32Array) -> BoolArray:
    """The parts of patches at the left or right border of the image that are as smooth as a pipe."""
    from scipy import ndimage

    smooth = np.zeros_like(warm)
    marks, _ = ndimage.label(warm)
    for n, box in enumerate(ndimage.find_objects(marks), 1):
        at_left, at_right = box[1].start == 0, box[1].stop == warm.shape[1]
        patch = marks[box] == n
        if not (at_left or at_right) or patch.sum() < SMOOTH_PIXELS:
            continue
        change = np.abs(np.diff(brightness[box], axis=0, append=brightness[box][-1:]))
        calm = patch & (ndimage.uniform_filter(change, SMOOTH_ACROSS, mode="nearest") < SMOOTH)
        parts, _ = ndimage.label(ndimage.binary_opening(calm, np.ones((3, 3), np.bool_)))
        beside = ([parts[:, 0]] if at_left else []) + ([parts[:, -1]] if at_right else [])
        large = np.bincount(parts.ravel()) >= SMOOTH_PIXELS
        chosen = np.intersect1d(np.concatenate(beside), np.nonzero(large)[0])
        core = np.isin(parts, chosen[chosen > 0])
        if core.sum(axis=1).max() > WIDEST * warm.shape[1]:
            continue
        # At its rim a pipe's brightness changes too.
        smooth[box] |= patch & ndimage.binary_dilation(core, iterations=SMOOTH_ACROSS // 2 + 1)
    return smooth


def _cleaned(mask: BoolArray, smallest: int) -> BoolArray:
    """The mask without patches of fewer pixels."""
    from scipy import ndimage

    marks, _ = ndimage.label(mask, np.ones((3, 3)))
    large = np.bincount(marks.ravel()) >= smallest
    large[0] = False
    return large[marks]
