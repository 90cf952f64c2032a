"""How well depth and labels are told from colour alone, against the simulator, pose by pose and in a map.

    python perf/perception.py                       or: --world reef/patch --seeds 1 2 --poses 20

Pictures go through JPEG with its colour at half resolution, as that of H.264 is, unless told otherwise.
Poses are free positions of the protocol's altitude at any heading, rolled and pitched by up to --tilt.
Figures are within the protocol's reach over ground.
"""

from __future__ import annotations

import argparse
import io
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import ndimage

from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap
from dream.perception import FlatFloor, Perception, Shells, View
from dream.protocol import SurveyProtocol, protocol_named
from dream.sim.render import Frame, Renderer
from dream.sim.solids import Solids
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import BoolArray, Float32Array, Label, UInt8Array

CHEBYSHEV = np.ones((3, 3), np.bool_)
BINS = 5
ROOM = 0.02
"""Metres between the vehicle and anything solid."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What stands between the simulator's picture and what perception is given."""

    pictures: str
    """One of `PICTURES`."""
    noise: float
    """Standard deviation of a channel of the picture, of 255."""
    cast: float
    """Standard deviation of the logarithm of the gain of each channel, each frame anew."""
    tilt: float
    """Radians: roll and pitch are drawn from ± this; both are known."""
    altitude_error: float
    """Standard deviation of the altitude, as a share of it, each frame anew."""
    attitude_error: float
    """Radians: standard deviation of the roll and the pitch that are told."""


@dataclass(slots=True)
class Tally:
    """Sums over the frames of one world."""

    confusion: np.ndarray = field(default_factory=lambda: np.zeros((4, 4), np.int64))
    """Truth by said, within the reach."""
    floor_errors: list[np.ndarray] = field(default_factory=list)
    """Shares of the true depth, of pixels that are seabed or target."""
    obstacle_errors: list[np.ndarray] = field(default_factory=list)
    """Metres over ground, of pixels that are rightly called obstacle."""
    unknown: list[float] = field(default_factory=list)
    """Share of the obstacle pixels without a depth."""
    sure: np.ndarray = field(default_factory=lambda: np.zeros((BINS, 3)))
    """Pixels, sum of the confidence in the label, right ones; by bin of confidence."""
    both: np.ndarray = field(default_factory=lambda: np.zeros((BINS, 3)))
    """Likewise with the confidence in both; right is a right label and a depth within a tenth."""
    seconds: list[float] = field(default_factory=list)
    maps: list[tuple[float, ...]] = field(default_factory=list)
    """Free cells called solid and solid ones missed: as they are, and with a cell of tolerance. Target cells
    missed, and cells called target that are none, with a cell of tolerance too."""

    def add(self, other: Tally) -> None:
        """Take in another."""
        self.confusion += other.confusion
        self.sure += other.sure
        self.both += other.both
        for name in ("floor_errors", "obstacle_errors", "unknown", "seconds", "maps"):
            getattr(self, name).extend(getattr(other, name))


def tilted(x: float, y: float, z: float, yaw: float, pitch: float, roll: float) -> SE3:
    """`T_world_base`; pitch is nose down, roll to the right."""
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    level = SE3.level(x, y, z, yaw)
    return SE3(level.rotation @ about_y @ about_x, level.translation)


def jpeg(rgb: UInt8Array) -> UInt8Array:
    """A picture after JPEG of quality 75, with a colour for 2 × 2 pixels."""
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG", quality=75, subsampling=2)
    return np.asarray(Image.open(buffer))


def video(rgb: UInt8Array) -> UInt8Array:
    """A picture after lossless video, with a colour for 2 × 2 pixels."""
    import cv2

    return np.asarray(cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420), cv2.COLOR_YUV2RGB_I420))


PICTURES: dict[str, Callable[[UInt8Array], UInt8Array]] = {
    "drawn": lambda rgb: rgb,
    "video": video,
    "jpeg": jpeg,
}
"""What becomes of a picture on its way."""


def taken(rgb: UInt8Array, conditions: Conditions, rng: np.random.Generator) -> UInt8Array:
    """What perception is given of a picture."""
    if conditions.noise or conditions.cast:
        gain = np.exp(rng.normal(0.0, conditions.cast, 3))
        rough = gain * rgb + rng.normal(0.0, conditions.noise, rgb.shape)
        rgb = np.clip(np.rint(rough), 0, 255).astype(np.uint8)
    return PICTURES[conditions.pictures](rgb)


def places(world: World, protocol: SurveyProtocol, count: int, rng: np.random.Generator) -> list[SE2]:
    """Free poses at any heading, each with a straight free way to an earlier one or to a start."""
    solids, box, known = Solids(world), world.bounds, list(world.starts)
    while len(known) < count + len(world.starts):
        x, y, yaw = rng.uniform((box.x_min, box.y_min, -math.pi), (box.x_max, box.y_max, math.pi))
        place = SE2(x, y, yaw)
        if solids.clearance(x, y, protocol) > ROOM and any(
            not solids.sweep(other, place, protocol).contact for other in known
        ):
            known.append(place)
    return known[len(world.starts) :]


def views(
    world: World, protocol: SurveyProtocol, count: int, conditions: Conditions, rng: np.random.Generator
) -> Iterator[tuple[Frame, UInt8Array, SE3, SE3, float]]:
    """Frame, picture, true and told `T_world_base`, told altitude."""
    renderer = Renderer(world)
    for place in places(world, protocol, count, rng):
        x, y, yaw = place.x, place.y, place.yaw
        z = float(world.terrain.height(x, y)) + protocol.altitude
        pitch, roll = rng.uniform(-conditions.tilt, conditions.tilt, 2)
        truth = tilted(x, y, z, yaw, pitch, roll)
        frame = renderer.render(protocol.camera, truth @ protocol.T_base_camera)
        rgb = taken(frame.rgb, conditions, rng)
        wrong = rng.normal(0.0, conditions.attitude_error, 2) if conditions.attitude_error else (0.0, 0.0)
        told = tilted(x, y, z, yaw, pitch + wrong[0], roll + wrong[1])
        factor = 1.0 + (rng.normal(0.0, conditions.altitude_error) if conditions.altitude_error else 0.0)
        yield frame, rgb, truth, told, protocol.altitude * factor


def judge(
    world: World,
    protocol: SurveyProtocol,
    count: int,
    conditions: Conditions,
    perception: Perception,
    frames_a_map: int,
) -> Tally:
    """All figures of one world."""
    rng = np.random.default_rng(1000 + world.seed)
    tally, camera, mount = Tally(), protocol.camera, protocol.T_base_camera
    box = world.bounds
    wide = Bounds(
        *(math.floor(a) - 1.0 for a in (box.x_min, box.y_min)),
        *(math.ceil(a) + 1.0 for a in (box.x_max, box.y_max)),
    )
    told_map, true_map = OccupancyMap(wide, protocol), OccupancyMap(wide, protocol)
    for n, (frame, rgb, truth, told, altitude) in enumerate(
        views(world, protocol, count, conditions, rng), 1
    ):
        start = time.process_time()
        shows = perception.perceive(rgb, View(camera, told, mount, altitude))
        depth, labels, confidence = shows.depth, shows.labels, shows.confidence
        tally.seconds.append(time.process_time() - start)
        _, sure = perception.segmenter.segment(rgb)
        add_pixels(tally, frame, (depth, labels, sure, confidence), truth @ mount, protocol)
        told_map.integrate(depth, labels, camera, told @ mount, confidence)
        true_map.integrate(frame.depth, frame.labels, camera, truth @ mount)
        if n % frames_a_map == 0:
            tally.maps.append(compared(told_map, true_map))
            told_map, true_map = OccupancyMap(wide, protocol), OccupancyMap(wide, protocol)
    return tally


def add_pixels(
    tally: Tally,
    frame: Frame,
    said: tuple[Float32Array, UInt8Array, Float32Array, Float32Array],
    T_world_camera: SE3,
    protocol: SurveyProtocol,
) -> None:
    """One frame; what was said: depth, labels, confidence in these and in both."""
    depth, labels, sure, confidence = said
    points = protocol.camera.back_project(frame.depth, T_world_camera)
    away = np.hypot(*(points[..., i] - T_world_camera.translation[i] for i in (0, 1)))
    near = away <= protocol.reach
    truth = frame.labels
    tally.confusion += np.bincount(4 * truth[near].astype(np.intp) + labels[near], minlength=16).reshape(4, 4)
    ground = near & ((truth == Label.SEABED) | (truth == Label.TARGET)) & (labels != Label.OBSTACLE)
    tally.floor_errors.append((np.abs(depth - frame.depth) / frame.depth)[ground & np.isfinite(depth)][::7])
    solid = near & (truth == Label.OBSTACLE) & (labels == Label.OBSTACLE)
    if solid.any():
        tally.unknown.append(float(np.isnan(depth[solid]).mean()))
        tally.obstacle_errors.append(
            (np.abs(depth - frame.depth) * away / frame.depth)[solid & np.isfinite(depth)][::7]
        )
    hit = labels == truth
    with np.errstate(invalid="ignore"):
        close = hit & (np.abs(depth - frame.depth) <= 0.1 * frame.depth)
    for counts, scale, right in ((tally.sure, sure, hit), (tally.both, confidence, close)):
        bins = np.minimum((scale[near] * BINS).astype(np.intp), BINS - 1)
        for column, value in enumerate((np.ones(bins.size), scale[near], right[near])):
            counts[:, column] += np.bincount(bins, value, BINS)


def compared(told: OccupancyMap, true: OccupancyMap) -> tuple[float, ...]:
    """See `Tally.maps`."""
    free, solid = true.known & ~true.solid, true.solid
    false, missed = free & told.solid, solid & ~told.solid

    def share(part: BoolArray, whole: BoolArray) -> float:
        return float(part.sum() / max(whole.sum(), 1))

    return (
        share(false, free),
        share(missed, solid),
        share(false & ~ndimage.binary_dilation(solid, CHEBYSHEV), free),
        share(missed & ~ndimage.binary_dilation(told.solid, CHEBYSHEV), solid),
        share(true.target & ~ndimage.binary_dilation(told.target, CHEBYSHEV), true.target),
        share(told.target & ~ndimage.binary_dilation(true.target, CHEBYSHEV), told.target),
    )


def percent(value: float) -> str:
    """As text."""
    return f"{100.0 * value:.1f} %"


def figures(tally: Tally) -> list[tuple[str, str]]:
    """Name and value of every figure."""
    table = tally.confusion.astype(float)
    t, o = int(Label.TARGET), int(Label.OBSTACLE)

    def iou(k: int) -> float:
        return float(table[k, k] / max(table[k].sum() + table[:, k].sum() - table[k, k], 1.0))

    floor, obstacle = (
        np.concatenate(tally.floor_errors),
        np.concatenate(tally.obstacle_errors or [np.zeros(1)]),
    )
    maps = np.array(tally.maps).mean(axis=0) if tally.maps else np.full(6, math.nan)
    return [
        ("target IoU", percent(iou(t))),
        ("target recall", percent(table[t, t] / max(table[t].sum(), 1.0))),
        ("target precision", percent(table[t, t] / max(table[:, t].sum(), 1.0))),
        ("obstacle recall", percent(table[o, o] / max(table[o].sum(), 1.0))),
        ("obstacle precision", percent(table[o, o] / max(table[:, o].sum(), 1.0))),
        ("floor depth, median error", percent(float(np.median(floor)))),
        ("floor depth, 95 % of pixels within", percent(float(np.quantile(floor, 0.95)))),
        ("obstacle over ground, median error", f"{100.0 * np.median(obstacle):.1f} cm"),
        ("obstacle over ground, 95 % within", f"{100.0 * np.quantile(obstacle, 0.95):.1f} cm"),
        ("obstacle without depth", percent(float(np.mean(tally.unknown or [0.0])))),
        ("map: free cells called solid", percent(maps[0])),
        ("map: solid cells missed", percent(maps[1])),
        ("map: free called solid, >1 cell off", percent(maps[2])),
        ("map: solid missed, >1 cell off", percent(maps[3])),
        ("map: target missed, >1 cell off", percent(maps[4])),
        ("map: of target, none within a cell", percent(maps[5])),
        ("CPU a frame, median", f"{1e3 * float(np.median(tally.seconds)):.1f} ms"),
    ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="pool/arc")
    parser.add_argument("--tuned", type=int, nargs="*", default=[1, 2, 3], help="seeds it was tuned on")
    parser.add_argument("--seeds", type=int, nargs="*", default=[4, 5], help="seeds it was not tuned on")
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--frames", type=int, default=8, help="frames a map")
    parser.add_argument("--pictures", choices=PICTURES, default="jpeg")
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation of a channel, of 255")
    parser.add_argument("--cast", type=float, default=0.0, help="standard deviation of a channel's log gain")
    parser.add_argument("--altitude", type=float, default=None, help="other than the protocol's, metres")
    parser.add_argument("--tilt", type=float, default=0.0, help="most roll and pitch, degrees")
    parser.add_argument("--altitude-error", type=float, default=0.0, help="standard deviation, as a share")
    parser.add_argument("--attitude-error", type=float, default=0.0, help="standard deviation, degrees")
    arguments = parser.parse_args()
    conditions = Conditions(
        pictures=arguments.pictures,
        noise=arguments.noise,
        cast=arguments.cast,
        tilt=math.radians(arguments.tilt),
        altitude_error=arguments.altitude_error,
        attitude_error=math.radians(arguments.attitude_error),
    )
    console, perception = Console(), Perception(Shells(), FlatFloor())
    columns: list[tuple[str, Tally]] = []
    for title, seeds in (("tuned", arguments.tuned), ("not tuned", arguments.seeds)):
        together = Tally()
        for seed in track(seeds, description=f"{arguments.world}, {title}", console=console):
            world = make_world(arguments.world, seed)
            protocol = protocol_named(world.protocol)
            if arguments.altitude is not None:
                protocol = replace(protocol, altitude=arguments.altitude)
            tally = judge(world, protocol, arguments.poses, conditions, perception, arguments.frames)
            columns.append((f"seed {seed}", tally))
            together.add(tally)
        if seeds:
            columns.append((title, together))
    table = Table(title=f"{arguments.world}, {arguments.poses} poses each, {conditions}")
    table.add_column("")
    for name, _ in columns:
        table.add_column(name, justify="right")
    for row in zip(*(figures(tally) for _, tally in columns), strict=True):
        table.add_row(row[0][0], *(value for _, value in row))
    console.print(table)
    whole = [tally for name, tally in columns if not name.startswith("seed")]
    for title, bins in (
        ("Confidence in a label, and how often it is right", [tally.sure for tally in whole]),
        ("Confidence in label and depth, and how often both are right, to a tenth", [t.both for t in whole]),
    ):
        reliability = Table(title=title)
        for name in ("confidence", "mean", "right", "share of pixels"):
            reliability.add_column(name, justify="right")
        sums = np.sum(bins, axis=0)
        for n, (count, total, right) in enumerate(sums):
            if count:
                share = count / sums[:, 0].sum()
                reliability.add_row(
                    f"{n / BINS:.1f} to {(n + 1) / BINS:.1f}",
                    *map(percent, (total / count, right / count, share)),
                )
        console.print(reliability)


if __name__ == "__main__":
    main()
