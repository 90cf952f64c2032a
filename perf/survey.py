"""How good the measures of a survey are: against the truth of simulated reefs and wrecks.

    python perf/survey.py                      # the tables of docs/survey-measures.md
    python perf/survey.py --calibrate --worlds 3   # the numbers of src/dream/survey/calibration.py
    python perf/survey.py --worlds 2 --wrecks 0 --swims 0
    python perf/survey.py --worlds 0 --swims 0   # wrecks alone
    python perf/survey.py --worlds 0 --swims 0 --wrecks 2 --first-wreck 7001   # that wreck.py is fitted to
    python perf/survey.py --wrecks 0 --swims 0 --years 5   # older than any that the calibration knows

Reefs of all four families, seeds 72000 and up, new and some years on, are flown by `belief` in dream-v1 and
dream-v1-noisy, some new ones in dream-v1-nav, and wrecks of seeds 7101 and up. Calibration uses reefs of
seeds 60000 and up, new and some years on, which no table does. Poses of missions and the truth of worlds are
kept in `--cache`, so that an interrupted call goes on where it was.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage, optimize
from scipy.spatial import cKDTree

from dream.commands.progress import with_progress
from dream.evaluation.runner import labelled_in
from dream.geometry import SE3, Camera
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.perception.scatter import scatter_of
from dream.planning import Belief
from dream.protocol import SurveyProtocol, protocol_named
from dream.robots import Teleport
from dream.robots.simulated import Simulated
from dream.sim.camera_noise import noise_generator, with_noise
from dream.sim.render import Frame, Renderer
from dream.sim.render.scene import rotation_matrices
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.survey import About, Measure, Survey, individuals, measure_observations, patches, reef, relief
from dream.survey.calibration import SHARP, Calibration
from dream.survey.comparison import Difference, held_against
from dream.survey.ground import Frame as Seen
from dream.survey.ground import fuse
from dream.survey.individuals import Peaks
from dream.survey.sizes import BIN, CLEAR, LEAST_ROOM, RARE, bin_name, size_bin, sizes_of
from dream.types import Label, Observation, Target

Float64Array = npt.NDArray[np.float64]

FAMILIES = ("reef/fringing", "reef/string", "reef/patch", "reef/mixed")
FIRST, FIRST_OF_CALIBRATION, FIRST_WRECK = 72_000, 60_000, 7101
YEARS_OF_CALIBRATION = (0, 1, 2, 4)
"""That have passed on the reefs: on a new one all clumps are of an age."""
TILE, ABOVE, PIXELS = 4.0, 15.0, 400
"""Metres along a tile of the view from straight above, metres of its camera above the ground, and pixels."""
BINS = 18
"""Of sizes, in the truth."""
TRUE_CELL = 0.02
"""Metres of the true picture of the ground."""
POST = 0.25
"""Metres: the cells that heights are means over, as those of the map of `dream-v1`."""
AT_PEAK = 0.15
"""Metres from a peak of the individuals that may show in its extent."""
HEADLINES = ("reef_area", "density", "median_size", "reef_height")
LIMITS = {"reef_area": "5 %", "density": "10 %", "median_size": "10 %", "reef_height": "5 cm"}


@dataclass(frozen=True, slots=True)
class Mission:
    """One mission of the validation."""

    protocol: str
    world: str
    seed: int

    @property
    def stem(self) -> str:
        """In the cache."""
        return f"{self.world.replace('/', '-')}-{self.seed}"


class Colourless:
    """A renderer that spares itself the colour, which neither `belief` nor a measure looks at."""

    def __init__(self, world: World) -> None:
        self._renderer = Renderer(world)

    def render(self, camera: Camera, T_world_camera: SE3) -> Frame:
        """Black."""
        seen = self._renderer.measure(camera, T_world_camera)
        return Frame(np.zeros((camera.height, camera.width, 3), np.uint8), *seen)


# ---------------------------------------------------------------------------------------------- missions


def flown(mission: Mission, world: World, cache: Path) -> dict[str, npt.NDArray[Any]]:
    """Poses of every frame, believed and true, from the cache or by flying it."""
    path = cache / mission.protocol / f"{mission.stem}.npz"
    if not path.exists():
        protocol = protocol_named(mission.protocol)
        kind = Simulated if protocol.swims else Teleport
        robot = kind(world, protocol, renderer=Colourless(world))  # type: ignore[arg-type]
        believed, truth, times, sigma = [], [], [], []
        for step in explore(robot, Belief(), OccupancyMap(world.bounds, protocol)):
            seen = step.observation
            really = step.arrival.truth or seen.T_world_base
            believed.append(_matrix(seen.T_world_base))
            truth.append(_matrix(really))
            times.append(seen.time)
            sigma.append(step.arrival.sigma)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, believed=believed, truth=truth, time=times, sigma=sigma)
        partial.replace(path)
    with np.load(path) as arrays:
        return {name: arrays[name] for name in arrays.files}


def seen_again(mission: Mission, world: World, cache: Path) -> tuple[list[Observation], list[float]]:
    """What the mission saw, drawn again without colour, and how far each pose may err."""
    protocol = protocol_named(mission.protocol)
    poses, renderer = flown(mission, world, cache), Colourless(world)
    start, camera = protocol.snap(world.starts[0]), protocol.camera
    observations = []
    for number, (believed, truth) in enumerate(zip(poses["believed"], poses["truth"], strict=True)):
        T_world_camera = _transform(truth) @ protocol.T_base_camera
        frame = renderer.render(camera, T_world_camera)
        if protocol.noise is not None:
            rng = noise_generator(world, start, number)
            frame = with_noise(frame, camera, T_world_camera, protocol.noise, rng, hull=world.hull)
        observations.append(
            Observation(
                float(poses["time"][number]),
                frame.rgb,
                frame.depth,
                frame.labels,
                camera,
                _transform(believed),
                protocol.T_base_camera,
            )
        )
    return observations, poses["sigma"].tolist()


def mapped(observations: list[Observation], world: World, protocol: SurveyProtocol) -> OccupancyMap:
    """The map that the mission made."""
    occupancy = OccupancyMap(world.bounds, protocol)
    occupancy.clear_launch(observations[0].pose.x, observations[0].pose.y)
    for seen in observations:
        occupancy.integrate(seen.depth, seen.labels, seen.camera, seen.T_world_camera)
    return occupancy


def _matrix(T: SE3) -> Float64Array:
    return np.column_stack([T.rotation, T.translation])


def _transform(matrix: Float64Array) -> SE3:
    return SE3(np.ascontiguousarray(matrix[:, :3]), np.ascontiguousarray(matrix[:, 3]))


# ------------------------------------------------------------------------------------------------- truth


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A world from straight above, in cells of `TRUE_CELL`."""

    top: Float64Array
    """(rows, cols) world z of what is on top, boulders left out; NaN where only they are."""
    cover: npt.NDArray[np.bool_]
    """(rows, cols) shell or hull."""


def plan(world: World) -> Plan:
    """Drawn by the renderer, tile by tile around the targets."""
    bounds, renderer = world.bounds, Renderer(world)
    shape = (round(bounds.depth / TRUE_CELL), round(bounds.width / TRUE_CELL))
    top, cover = np.full(shape, np.nan), np.zeros(shape, np.bool_)
    focal = PIXELS * ABOVE / TILE
    camera = Camera(PIXELS, PIXELS, focal, focal, 0.5 * PIXELS, 0.5 * PIXELS)
    # The camera's right is east and its down is south, so that it looks straight down.
    down = np.diag([1.0, -1.0, -1.0])
    targets = np.asarray(world.targets.position, np.float64)
    step = 0.9 * TILE
    xs = np.arange(bounds.x_min + 0.5 * step, bounds.x_max + 0.5 * step, step)
    ys = np.arange(bounds.y_min + 0.5 * step, bounds.y_max + 0.5 * step, step)
    tree = cKDTree(targets[:, :2])
    for x in xs:
        for y in ys:
            if tree.query((x, y))[0] > 0.75 * TILE + 2.5:
                continue
            z = float(world.terrain.height(x, y)) + ABOVE
            T_world_camera = SE3(down, np.array([x, y, z]))
            seen = renderer.measure(camera, T_world_camera)
            points = camera.back_project(seen.depth, T_world_camera)
            labels = np.asarray(seen.labels)
            valid = np.isfinite(points[..., 2]) & ((labels == Label.SEABED) | (labels == Label.TARGET))
            col = np.floor((points[..., 0] - bounds.x_min) / TRUE_CELL)
            row = np.floor((points[..., 1] - bounds.y_min) / TRUE_CELL)
            valid &= (row >= 0) & (col >= 0) & (row < shape[0]) & (col < shape[1])
            r, c = row[valid].astype(np.intp), col[valid].astype(np.intp)
            np.fmax.at(top, (r, c), points[..., 2][valid])
            shell = labels[valid] == Label.TARGET
            cover[r[shell], c[shell]] = True
    return Plan(top, cover)


def true_sizes(world: World) -> Float64Array:
    """(N,) the longest distance across each individual seen from above, what is in the ground left out."""
    targets = world.targets
    turns = rotation_matrices(targets.wxyz)
    sizes = np.zeros(len(targets))
    for number, (which, scale, position) in enumerate(
        zip(targets.mesh, targets.scale, targets.position, strict=True)
    ):
        corners = (world.meshes[which].vertices.astype(np.float64) * scale) @ turns[number].T + position
        corners = corners[corners[:, 2] > world.terrain.height(corners[:, 0], corners[:, 1])]
        if len(corners):
            sizes[number], _ = patches.calipers(corners[:, :2])
    return sizes


def truth_of(world: World) -> dict[str, Any]:
    """The measures of a reef as they are, by the definitions of docs/survey-measures.md."""
    drawn = plan(world)
    corner = (world.bounds.x_min, world.bounds.y_min)
    marks, count = patches.parts(patches.closed(drawn.cover, TRUE_CELL), TRUE_CELL)
    position, sizes = np.asarray(world.targets.position, np.float64), true_sizes(world)
    col, row = ((position[:, :2] - corner) / TRUE_CELL).astype(np.intp).T
    member = marks[np.clip(row, 0, marks.shape[0] - 1), np.clip(col, 0, marks.shape[1] - 1)]
    on_reef = marks >= 0
    area = float(on_reef.sum()) * TRUE_CELL**2
    above = heights(drawn, on_reef)
    links = round(relief.CHAIN / TRUE_CELL)
    level, _ = relief.averaged(drawn.top, np.isfinite(drawn.top), links)
    inside, _ = relief.averaged(on_reef.astype(float), np.ones_like(on_reef), links)
    counts = np.bincount(member[member >= 0], minlength=count)
    return {
        "reef_area": area,
        "patch_count": float(count),
        "count": float(counts.sum()),
        "density": float(counts.sum()) / area,
        "median_size": float(np.median(sizes[member >= 0])),
        **_size_shares(sizes[member >= 0]),
        "reef_height": float(np.nanmean(above)),
        "reef_height_max": float(np.nanquantile(above, 0.99)),
        "rugosity": relief.chain_ratio(level, inside > 0.5),
        "patches": [
            {
                "area": float((marks == number).sum()) * TRUE_CELL**2,
                "count": float(counts[number]),
                "middle": [
                    TRUE_CELL * 0.5 * float(at.min() + at.max() + 1) + low
                    for at, low in zip(np.nonzero(marks == number)[::-1], corner, strict=True)
                ],
            }
            for number in range(count)
        ],
    }


def _size_shares(sizes: Float64Array) -> dict[str, float]:
    """The size-frequency, under the names of a survey's measures."""
    number = np.bincount(np.floor(sizes / BIN).astype(np.intp), minlength=BINS) / len(sizes)
    return {bin_name(k): float(share) for k, share in enumerate(number)}


def heights(drawn: Plan, on_reef: npt.NDArray[np.bool_]) -> Float64Array:
    """Metres above the membrane that the bare seabed holds, of the posts that are reef."""
    # A post is no whole number of true cells: both are cut into squares of a centimetre.
    fine = round(TRUE_CELL / 0.01)
    times = round(POST / 0.01)
    top = np.repeat(np.repeat(drawn.top, fine, axis=0), fine, axis=1)
    mask = np.repeat(np.repeat(on_reef, fine, axis=0), fine, axis=1)
    level, _ = relief.averaged(top, np.isfinite(top), times)
    near = patches_grown(on_reef)
    under, _ = relief.averaged(
        np.repeat(np.repeat(near, fine, axis=0), fine, axis=1).astype(np.float32), np.ones_like(mask), times
    )
    share, _ = relief.averaged(mask.astype(np.float32), np.ones_like(mask), times)
    above = level - relief.spanned(level, under > 0.0)
    return above[(share > 0.5) & np.isfinite(above)]


def patches_grown(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The mask and `relief.RIM` around it."""
    grown: npt.NDArray[np.bool_] = ndimage.distance_transform_edt(~mask, TRUE_CELL) <= relief.RIM
    return grown


def truth_of_wreck(world: World, seen: npt.NDArray[np.bool_]) -> dict[str, Any]:
    """Outline, share of the hull seen, debris and highest point as they are."""
    drawn = plan(world)
    marks, count = patches.parts(patches.closed(drawn.cover, TRUE_CELL), TRUE_CELL, 0.25)
    marks[ndimage.binary_fill_holes(marks == 0)] = 0
    corner = (world.bounds.x_min, world.bounds.y_min)
    rings = [patches.rings(marks == number, corner, TRUE_CELL)[0] for number in range(count)]
    tops = [
        (world.meshes[mesh].vertices[:, 2] + position[2]).max()
        for mesh, position in zip(world.targets.mesh, world.targets.position, strict=True)
    ]
    ground = float(np.median(world.terrain.height(rings[0][:, 0], rings[0][:, 1])))
    return {
        "outline_area": float((marks == 0).sum()) * TRUE_CELL**2,
        "hull_seen": float(seen.mean()),
        "debris_extent": patches.calipers(np.concatenate(rings))[0],
        "debris_area": float((marks > 0).sum()) * TRUE_CELL**2,
        "highest_point": float(max(tops)) - ground,
    }


def known_truth(world: World, mission: Mission, cache: Path) -> dict[str, Any]:
    """Of a reef, from the cache where it was found before."""
    path = cache / "truth" / f"{mission.stem}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(truth_of(world)))
    found: dict[str, Any] = json.loads(path.read_text())
    return found


# -------------------------------------------------------------------------------------------- calibration


def calibrate(missions: list[Mission], cache: Path) -> Calibration:
    """The calibration of one protocol from missions of its own."""
    tiles: list[tuple[npt.NDArray[np.intp], Peaks, npt.NDArray[np.bool_], Float64Array, Float64Array]] = []
    own: list[tuple[float, float]] = []
    edges, clear, reliefs, rugosities = [], [], [], []
    for mission in with_progress(missions, "measuring", len(missions), "missions"):
        world = make_world(mission.world, mission.seed)
        protocol, truth = protocol_named(mission.protocol), known_truth(world, mission, cache)
        observations, _ = seen_again(mission, world, cache)
        frames = [Seen.of(seen) for seen in observations]
        ground = fuse(frames, world.bounds, protocol, scatter_of(frames))
        read = reef.read(ground, frames, protocol)
        peaks, on_reef = read.peaks, read.patch >= 0
        outline = sum(
            patches.perimeter(patches.rings(read.marks == number, read.corner, read.cell))
            for number in range(read.count)
        )
        measured = float(np.count_nonzero(read.reef)) * read.cell**2
        edges.append((truth["reef_area"] - measured) / outline)
        own.extend(_patches_apart(read, truth))
        position = np.asarray(world.targets.position, np.float64)[:, :2]
        # A patch may be missed as a whole, and some settle apart; the model is of what a patch holds.
        held = position[_on(read, position)]
        tile = [_tiles(at, world) for at in (peaks.position[on_reef, :2], held)]
        names = np.unique(np.concatenate(tile))
        there = np.bincount(np.searchsorted(names, tile[1]), minlength=len(names)).astype(np.float64)
        tiles.append((np.searchsorted(names, tile[0]), peaks, on_reef, read.sure, there))
        clear.append((peaks, read.sure, on_reef, _largest(peaks, position, true_sizes(world)), truth))
        reliefs.append((float(read.above.mean()), truth["reef_height"]))
        assert read.rugosity is not None
        rugosities.append((read.rugosity - 1.0, truth["rugosity"] - 1.0))
    extent, ranks, shares = _extents(clear)
    model = dataclasses.replace(SHARP, extent=extent)
    typical = [sizes_of(*one[:3], model).typical for one in clear]
    fitted = [
        (tile, individuals.features(peaks, size)[on_reef], sure[on_reef], there)
        for (tile, peaks, on_reef, sure, there), size in zip(tiles, typical, strict=True)
    ]
    capture = _capture(fitted)
    ratios = np.log(
        [
            float((sure * np.exp(features @ capture)).sum()) / truth["count"]
            for (_, features, sure, _), (*_, truth) in zip(fitted, clear, strict=True)
        ]
    )
    # Of a patch that is drawn too small, some that it holds are found outside.
    capture[0] -= ratios.mean()
    ratios -= ratios.mean()
    rise = np.array(reliefs)
    times = float((rise[:, 0] * rise[:, 1]).sum() / np.square(rise[:, 0]).sum())
    rough = np.log([true / mine for mine, true in rugosities])
    freedom = math.sqrt(len(missions) / max(len(missions) - 3, 1))
    found = Calibration(
        capture=tuple(round(weight, 3) for weight in capture.tolist()),
        capture_spread=freedom * _spread(ratios),
        edge=float(np.mean(edges)),
        edge_spread=freedom * _spread(edges - np.mean(edges)),
        edge_wander=float(np.sqrt(np.mean([(off - np.mean(edges) * long) ** 2 / long for off, long in own]))),
        extent=extent,
        rank_spread=freedom * _spread(ranks),
        share_spread=_spread(shares),
        relief=times,
        relief_spread=freedom * _spread(rise[:, 1] - times * rise[:, 0]),
        rugosity=float(np.exp(rough.mean())),
        rugosity_spread=freedom * _spread(rough - rough.mean()),
    )
    print("  of each: log count", np.round(ratios, 3), " edge", np.round(edges, 4))
    print("  size", np.round(ranks, 3), " relief", np.round(rise[:, 1] - times * rise[:, 0], 3))
    return found


def _largest(peaks: Peaks, position: Float64Array, sizes: Float64Array) -> Float64Array:
    """(N,) the size of the largest of the individuals that are nearest to each peak; 0 where none is near."""
    away, which = cKDTree(peaks.position[:, :2]).query(position)
    largest = np.zeros(len(peaks))
    near = away < AT_PEAK
    np.maximum.at(largest, np.asarray(which)[near], sizes[near])
    return largest


def _extents(
    clear: list[tuple[Peaks, Float64Array, npt.NDArray[np.bool_], Float64Array, dict[str, Any]]],
) -> tuple[tuple[tuple[float, float, float], ...], list[float], list[float]]:
    """How extents scatter about sizes, and what medians and shares still err by, as in `Calibration`."""
    logs = []
    for peaks, sure, on_reef, largest, _ in clear:
        shows = peaks.lone & (peaks.nearest <= CLEAR) & (sure > 0.5) & on_reef & (largest > 0.0)
        logs.append(np.log(peaks.across[shows] / largest[shows]))
    share, mean, sigma = np.array([0.8, 0.2]), np.array([0.0, 0.3]), np.array([0.1, 0.3])
    log = np.concatenate(logs)[:, None]
    for _ in range(500):
        likely = share / sigma * np.exp(-0.5 * np.square((log - mean) / sigma))
        likely /= likely.sum(axis=1, keepdims=True)
        share, total = likely.mean(axis=0), likely.sum(axis=0)
        mean = (likely * log).sum(axis=0) / total
        sigma = np.sqrt((likely * np.square(log - mean)).sum(axis=0) / total)
    for _ in range(5):
        extent = tuple(
            (round(s, 3), round(m, 3), round(d, 3))
            for s, m, d in zip(share.tolist(), mean.tolist(), sigma.tolist(), strict=True)
        )
        model = dataclasses.replace(SHARP, extent=extent)
        sizes = [sizes_of(*one[:3], model) for one in clear]
        off = [
            math.log(told.quantile(0.5) / truth["median_size"])
            for told, (*_, truth) in zip(sizes, clear, strict=True)
        ]
        # What one mission's sample shifts the median by on average belongs to the extents.
        mean = mean + float(np.mean(off))
    ranks, shares = [], []
    for told, (*_, truth) in zip(sizes, clear, strict=True):
        ranks.append(told.below(truth["median_size"]) - 0.5)
        for name, true in truth.items():
            if (bounds := size_bin(name)) is not None:
                shown = told.below(0.01 * bounds[1]) - told.below(0.01 * bounds[0])
                if max(shown, true) >= RARE:
                    shares.append((shown - true) / math.sqrt(shown * (1.0 - shown) + LEAST_ROOM))
    return extent, ranks, shares


def _spread(errors: npt.ArrayLike) -> float:
    """Standard deviation about 0, or that of a normal error as often beyond where the tails are heavier."""
    far = np.abs(np.asarray(errors, np.float64))
    return max(float(np.sqrt(np.mean(far**2))), float(np.quantile(far, 0.95)) / 1.96)


def _patches_apart(read: reef.Reading, truth: dict[str, Any]) -> Iterator[tuple[float, float]]:
    """Of every patch that is found and there: square metres that it has more in truth, and its outline."""
    for number in range(read.count):
        rings = patches.rings(read.marks == number, read.corner, read.cell)
        area = float(np.count_nonzero(read.marks == number)) * read.cell**2
        for true in truth["patches"]:
            if _same_patch(rings[0], area, true):
                yield true["area"] - area, patches.perimeter(rings)


def _same_patch(ring: Float64Array, area: float, true: dict[str, Any]) -> bool:
    middle = 0.5 * (ring.max(axis=0) + ring.min(axis=0))
    return math.dist(middle, true["middle"]) < 1.0 and abs(area / true["area"] - 1.0) < 0.4


def _on(read: reef.Reading, at: Float64Array) -> npt.NDArray[np.bool_]:
    """(N,) does a patch that was found hold each position?"""
    col, row = np.floor((at - read.corner) / read.cell).astype(np.intp).T
    rows, cols = read.marks.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    on: npt.NDArray[np.bool_] = inside & (
        read.marks[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)] >= 0
    )
    return on


def _tiles(at: Float64Array, world: World) -> npt.NDArray[np.int64]:
    """(N,) the square metre that each position lies in."""
    col, row = np.floor(at - (world.bounds.x_min, world.bounds.y_min)).astype(np.int64).T
    return np.asarray(row * 100_000 + col, np.int64)


def _capture(
    tiles: list[tuple[npt.NDArray[np.intp], Float64Array, Float64Array, Float64Array]],
) -> Float64Array:
    """Weights of the capture model: what makes the individuals of every square metre likeliest (Poisson)."""

    def loss(weights: Float64Array) -> tuple[float, Float64Array]:
        total, slope = 0.0, np.zeros(4)
        for tile, features, sure, there in tiles:
            worth = sure * np.exp(np.clip(features @ weights, -3.0, 3.0))
            expected = np.bincount(tile, weights=worth, minlength=len(there)) + 0.05
            total += float((expected - there * np.log(expected)).sum())
            slope += (((1.0 - there / expected)[tile] * worth)[:, None] * features).sum(axis=0)
        return total / 1e3, slope / 1e3

    best = optimize.minimize(loss, np.array([0.6, 0.0, 0.0, 0.0]), jac=True, method="BFGS")
    return np.asarray(best.x)


# --------------------------------------------------------------------------------------------- validation


def measured(mission: Mission, cache: Path) -> tuple[Survey, dict[str, Any]]:
    """The survey of a mission, and the truth."""
    world, protocol = make_world(mission.world, mission.seed), protocol_named(mission.protocol)
    observations, sigma = seen_again(mission, world, cache)
    occupancy = mapped(observations, world, protocol)
    target = labelled_in(world)
    about = About(mission.stem, datetime.now(UTC), target=target, sigma=tuple(sigma))
    survey = measure_observations(observations, occupancy, about)
    if target is not Target.WRECK:
        return survey, known_truth(world, mission, cache)
    been = [_transform(matrix).se2 for matrix in flown(mission, world, cache)["truth"]]
    poses = np.array([[pose.x, pose.y, pose.yaw] for pose in been])
    visibility = Visibility(world, protocol)
    seen = np.asarray(visibility.seen(poses).any(axis=0))
    return survey, truth_of_wreck(world, seen[visibility.countable])


def compared(survey: Survey, truth: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Every measure of the whole beside its truth."""
    for told in survey.measures:
        true = truth.get(told.name)
        if told.value is not None and true is not None:
            assert told.low is not None
            assert told.high is not None
            yield {
                "name": "size_share" if size_bin(told.name) else told.name,
                "value": told.value,
                "low": told.low,
                "high": told.high,
                "truth": true,
                "holds": bool(told.low <= true <= told.high),
            }
    for patch in survey.patches:
        told_of = {told.name: told for told in patch.measures}
        area = told_of["area"].value or 0.0
        known = truth.get("patches", ())
        if known and not any(_same_patch(patch.rings[0], area, true_patch) for true_patch in known):
            print(
                f"{survey.name}: a patch of {area:.0f} m2 is none of the true ones; left out", file=sys.stderr
            )
        for true_patch in known:
            near = _same_patch(patch.rings[0], area, true_patch)
            density = true_patch["count"] / true_patch["area"]
            for name, true in (("area", true_patch["area"]), ("density", density)) if near else ():
                told = told_of[name]
                if told.value is None or told.low is None or told.high is None:
                    continue
                yield {
                    "name": f"patch_{name}",
                    "value": told.value,
                    "low": told.low,
                    "high": told.high,
                    "truth": true,
                    "holds": bool(told.low <= true <= told.high),
                }


def by_age(rows: list[dict[str, Any]]) -> None:
    """Print mean errors and, in brackets, how often intervals held, by the years that have passed."""
    ages = sorted({(row["protocol"], row["years"]) for row in rows if row["protocol"] != "dream-v1-nav"})
    print("| measure | " + " | ".join(f"{protocol}, {years} a" for protocol, years in ages) + " |")
    print("|---|" + "--:|" * len(ages))
    for name in (*HEADLINES, "count", "size_share"):
        cells = []
        for age in ages:
            chosen = [row for row in rows if row["name"] == name and (row["protocol"], row["years"]) == age]
            value, true = (np.array([row[key] for row in chosen]) for key in ("value", "truth"))
            metres, share = name == "reef_height", name == "size_share"
            error = 100.0 * float(np.mean(value - true if metres or share else value / true - 1.0))
            held = sum(row["holds"] for row in chosen) / max(len(chosen), 1)
            unit = "cm" if metres else "points" if share else "%"
            cells.append(f"{error:+.1f} {unit} ({held:.0%})")
        print(f"| {name} | {' | '.join(cells)} |")


def changes(rows: list[dict[str, Any]]) -> None:
    """Print what two surveys of a reef, new and years on, say of its change, and whether it holds the truth.

    The rows carry the measures of single surveys; their intervals are put together as `dream survey compare`
    does.
    """
    of = {(row["protocol"], row["name"], row["reef"], row["years"]): row for row in rows}
    told: dict[tuple[str, int, str], list[tuple[Difference, float]]] = {}
    for (protocol, name, reef_, years), after in of.items():
        before = of.get((protocol, name, reef_, 0))
        if years and before is not None and name in (*HEADLINES, "count"):
            was, now = (Measure(name, row["value"], row["low"], row["high"], "") for row in (before, after))
            true = after["truth"] - before["truth"]
            if (one := held_against(was, now)) is not None:
                told.setdefault((protocol, years, name), []).append((one, true))
    print("| protocol | years | measure | reefs | told | true | in the interval | shown |")
    print("|---|--:|---|--:|--:|--:|--:|--:|")
    for (protocol, years, name), pairs in sorted(told.items()):
        change = 100.0 * float(np.mean([one.change / one.before for one, _ in pairs]))
        truth = 100.0 * float(np.mean([true / one.before for one, true in pairs]))
        held = sum(one.low <= true <= one.high for one, true in pairs) / len(pairs)
        shown = sum(one.p <= 0.05 for one, _ in pairs) / len(pairs)
        cells = (f"{change:+.0f} %", f"{truth:+.0f} %", f"{held:.0%}", f"{shown:.0%}")
        print(f"| {protocol} | {years} | {name} | {len(pairs)} | {' | '.join(cells)} |")


def table(rows: list[dict[str, Any]]) -> None:
    """Print what came of all missions."""
    print("| protocol | measure | missions | median error | 90 % below | mean error | in the interval |")
    print("|---|---|--:|--:|--:|--:|--:|")
    keys = sorted({(row["protocol"], row["name"]) for row in rows})
    for protocol, name in keys:
        chosen = [row for row in rows if (row["protocol"], row["name"]) == (protocol, name)]
        value, true = (np.array([row[key] for row in chosen]) for key in ("value", "truth"))
        metres = name in ("reef_height", "reef_height_max", "highest_point", "debris_extent")
        share = name in ("hull_seen", "patch_count", "rugosity", "debris_area", "size_share")
        error = value - true if metres or share else value / true - 1.0
        unit, times = ("cm", 100.0) if metres else ("", 1.0) if share else ("%", 100.0)
        shown = [np.median(np.abs(error)), np.quantile(np.abs(error), 0.9), error.mean()]
        digits = 3 if share else 2
        cells = [f"{times * number:.{digits}f} {unit}".strip() for number in shown]
        held = sum(row["holds"] for row in chosen)
        print(f"| {protocol} | {name} | {len(chosen)} | {' | '.join(cells)} | {held / len(chosen):.0%} |")


def aged(years: int) -> str:
    """What the name of a world that is as many years on ends in."""
    return f"+{years}y1" if years else ""


def main() -> int:
    """Validate, or calibrate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=5, help="reefs of each family and age")
    parser.add_argument("--swims", type=int, default=2, help="of each family in dream-v1-nav")
    parser.add_argument("--wrecks", type=int, default=2, help="wrecks of each kind")
    parser.add_argument("--first-wreck", type=int, default=FIRST_WRECK, help="seed")
    parser.add_argument(
        "--years", type=int, nargs="+", default=[0, 1, 3], help="that have passed on the reefs"
    )
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/dream-survey"))
    options = parser.parse_args()
    if options.calibrate:
        for protocol in ("dream-v1", "dream-v1-noisy"):
            seeds = range(FIRST_OF_CALIBRATION, FIRST_OF_CALIBRATION + options.worlds)
            missions = [
                Mission(protocol, family + aged(years), seed)
                for seed in seeds
                for years in YEARS_OF_CALIBRATION
                for family in FAMILIES
            ]
            print(protocol, json.dumps(dataclasses.asdict(calibrate(missions, options.cache)), indent=1))
        return 0
    seeds = range(FIRST, FIRST + options.worlds)
    missions = [
        Mission(protocol, family + aged(years), seed)
        for years in options.years
        for seed in seeds
        for family in FAMILIES
        for protocol in ("dream-v1", "dream-v1-noisy")
    ]
    missions += [
        Mission("dream-v1-nav", family, FIRST + k) for k in range(options.swims) for family in FAMILIES
    ]
    missions += [
        Mission(protocol, f"wreck/{kind}", options.first_wreck + k)
        for k in range(options.wrecks)
        for kind in range(1, 6)
        for protocol in ("dream-v1", "dream-v1-noisy")
    ]
    rows = []
    options.cache.mkdir(parents=True, exist_ok=True)
    with (options.cache / "rows.jsonl").open("w") as lines:
        for mission in with_progress(missions, "measuring", len(missions), "missions"):
            survey, truth = measured(mission, options.cache)
            for row in compared(survey, truth):
                family, _, later = mission.world.partition("+")
                years, which = int(later.partition("y")[0] or 0), f"{family} {mission.seed}"
                about = {"protocol": mission.protocol, "reef": which, "years": years}
                rows.append({**about, "mission": mission.stem, **row})
                lines.write(json.dumps(rows[-1]) + "\n")
                lines.flush()
    table(rows)
    print()
    reefs = [row for row in rows if not row["mission"].startswith("wreck")]
    by_age(reefs)
    print()
    changes(reefs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
