"""How well `dream teach` labels pictures that were not marked, from a simulated person's strokes on five.

    DREAM_REAL_DATA=FOLDER python perf/teach.py suim       FOLDER/suim_test holds pictures and masks of SUIM
    DREAM_REAL_DATA=FOLDER python perf/teach.py renders    forty objects of `perf/unseen`, seen by no training


The person draws a few strokes within each class of each marked picture. What that teaches labels the other
pictures, and IoU is of all their pixels. Beside it stands what the same strokes teach by colour alone: red,
green, blue, hue, saturation and value of each cell's mean. Differences are paired. Intervals are 95 %, by
resampling the pictures (suim) or the objects (renders).

Reference: SUIM, Islam et al., IROS 2020; its masks code a class in the three colours.
"""

from __future__ import annotations

import argparse
import itertools
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import ndimage

from dream.teaching.backbone import TEXTURE, open_backbone
from dream.teaching.fit import Example, HeadLesson, lacking
from dream.teaching.marks import OTHER, TARGET, MarkStroke
from dream.teaching.model import Extractor
from dream.teaching.pictures import Picture
from dream.types import BoolArray, Float32Array, Label, UInt8Array
from unseen.pictures import pictures

SUIM = ("BW", "HD", "PF", "WR", "RO", "RI", "FV", "SR")
"""By the bits of red, green, blue: water, divers, plants, wrecks, robots, reefs, fish, sea floor."""
MARKED = 5
STROKES = 3
"""On each class of a marked picture."""
WIDTH = 0.02
"""Of a stroke, as a share of the picture's width."""
LEAST_SHARE = 0.01
"""Of a picture that is of the class, for its IoU to count."""
OBJECTS, PER_OBJECT = 40, 14
"""Objects, and pictures of each; some show too little of it."""
RESAMPLED = 4000


@dataclass(frozen=True)
class Scene:
    """A picture and the truth of it."""

    rgb: UInt8Array
    kinds: npt.NDArray[np.uint8]
    """(H, W) number of the class."""


@dataclass(frozen=True)
class Case:
    """Pictures to mark, pictures to label, and which class is the target."""

    unit: str
    kind: int
    marked: tuple[int, ...]
    held: tuple[int, ...]


@dataclass(frozen=True)
class Row:
    """What came of a picture that was labelled: IoU by method."""

    case: Case
    picture: int
    iou: dict[str, float]
    seconds: float


def suim_scenes(folder: Path) -> list[Scene]:
    """Pictures with masks of SUIM."""
    found = []
    for path in sorted(folder.glob("*.bmp")):
        with Image.open(path) as image:
            bits = np.asarray(image.convert("RGB")) > 127
        kinds = (bits @ np.array([4, 2, 1])).astype(np.uint8)
        found.append(Scene(Picture(path.with_suffix(".jpg")).open(), kinds))
    return found


def render_scenes(seed: int, objects: int) -> dict[int, list[Scene]]:
    """Pictures that show enough of an object, object by object: what is the target of a scene."""
    found: dict[int, list[Scene]] = {n: [] for n in range(objects)}
    for one in track(pictures(seed, objects, PER_OBJECT), "renders", objects * PER_OBJECT):
        kinds = (one.labels == Label.TARGET).astype(np.uint8)
        if kinds.mean() >= LEAST_SHARE:
            found[one.scene].append(Scene(one.rgb, kinds))
    return found


def stroke_in(where: BoolArray, rng: np.random.Generator) -> list[tuple[float, float]]:
    """A line of about a fifth of the picture that stays within a region; empty where that is too small."""
    rows, cols = where.shape
    margin = max(1, round(WIDTH * cols / 2))
    inner = ndimage.binary_erosion(where, iterations=margin, border_value=1)
    inner = inner if inner.sum() >= 20 else where
    ys, xs = np.nonzero(inner)
    if len(ys) < 10:
        return []
    at = rng.integers(len(ys))
    point, heading, step = np.array([ys[at], xs[at]], float), rng.uniform(0.0, 2.0 * np.pi), 8.0
    line = [point]
    for _ in range(int(rng.uniform(0.1, 0.3) * cols / step)):
        for _ in range(8):
            ahead = point + step * np.array([np.sin(heading), np.cos(heading)])
            y, x = int(ahead[0]), int(ahead[1])
            if 0 <= y < rows and 0 <= x < cols and inner[y, x]:
                break
            heading += rng.normal() * 1.2
        else:
            break
        point = ahead
        line.append(point)
        heading += rng.normal() * 0.25
    return [(float((x + 0.5) / cols), float((y + 0.5) / rows)) for y, x in line]


def marked(scene: Scene, kind: int, rng: np.random.Generator) -> UInt8Array:
    """What the simulated person marks of a picture."""
    marks = np.zeros(scene.kinds.shape, np.uint8)
    shares = {int(k): float((scene.kinds == k).mean()) for k in np.unique(scene.kinds)}
    for each, share in shares.items():
        if share < 0.003:
            continue
        target = each == kind
        others = len(shares) - (kind in shares)
        for _ in range(STROKES if target or others == 1 else STROKES - 1):
            line = stroke_in(scene.kinds == each, rng)
            if line:
                mark: Literal["target", "other"] = "target" if target else "other"
                stroke = MarkStroke(picture=0, tool="brush", mark=mark, width=WIDTH, points=line)
                marks = stroke.drawn(marks)
    # A careful person stays within the lines.
    marks[(marks == TARGET) & (scene.kinds != kind)] = 0
    marks[(marks == OTHER) & (scene.kinds == kind)] = 0
    return marks


def colour(rgb: UInt8Array, size: tuple[int, int], grid: tuple[int, int]) -> Float32Array:
    """(7, h, w) of cells' means: red, green, blue, saturation along both axes of hue, saturation, value."""
    small = Image.fromarray(rgb).resize((size[1], size[0]), Image.Resampling.BILINEAR)
    mean = small.resize((grid[1], grid[0]), Image.Resampling.BOX)
    plain = np.asarray(mean, np.float32) / 255.0
    hue, saturation, value = np.moveaxis(np.asarray(mean.convert("HSV"), np.float32) / 255.0, 2, 0)
    angle = 2.0 * np.pi * hue
    turned = [saturation * np.cos(angle), saturation * np.sin(angle), saturation, value]
    return np.concatenate([np.moveaxis(plain, 2, 0), np.stack(turned)]).astype(np.float32)


def evaluated(
    scenes: Sequence[Scene],
    cases: Sequence[Case],
    methods: dict[str, Callable[[UInt8Array], Float32Array]],
    extractors: dict[str, Extractor],
    seed: int,
) -> Iterator[list[Row]]:
    """The rows of each case."""
    grids = {name: [features(scene.rgb) for scene in scenes] for name, features in methods.items()}
    for case in cases:
        drawn = {}
        for n in case.marked:
            drawn[n] = marked(scenes[n], case.kind, np.random.default_rng((seed, case.kind, n)))
        told: dict[str, dict[int, float]] = {}
        seconds = 0.0
        for name in methods:
            began = time.perf_counter()
            examples = [Example.of(str(n), grids[name][n], drawn[n]) for n in case.marked if drawn[n].any()]
            if lacking(examples):
                break
            channels = 0 if name == "colour" else extractors[name].backbone.channels
            taught = HeadLesson(examples, channels).measured(extractors[name])
            assert taught is not None
            seconds = max(seconds, time.perf_counter() - began)
            told[name] = {}
            for n in case.held:
                true = scenes[n].kinds == case.kind
                shape = (true.shape[0], true.shape[1])
                frame = extractors[name].frame(shape)
                found = extractors[name].target(taught.head.logits(grids[name][n]), frame, shape)
                told[name][n] = float((found & true).sum() / max(int((found | true).sum()), 1))
        else:
            yield [
                Row(case, n, {name: told[name][n] for name in methods}, seconds)
                for n in case.held
                if (scenes[n].kinds == case.kind).mean() >= LEAST_SHARE
            ]


def interval(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Of the mean of values (n,), by resampling them."""
    rng = np.random.default_rng(0)
    means = values[rng.integers(len(values), size=(RESAMPLED, len(values)))].mean(axis=1)
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def told(title: str, rows: Sequence[Row], unit: Callable[[Row], str], kinds: dict[int, str]) -> None:
    """Print a table: IoU by method, and each method's gain over colour alone."""
    names = list(rows[0].iou)
    table = Table(title=title)
    for heading in ("target", "units", *names, *(f"{name} − colour" for name in names if name != "colour")):
        table.add_column(heading, justify="left" if heading == "target" else "right")
    every: dict[str, dict[str, list[float]]] = {}
    for kind in [*kinds, None]:
        # A unit counts once, however often it was labelled and as however many classes.
        by_unit: dict[str, dict[str, list[float]]] = {}
        if kind is None:
            by_unit = every
        else:
            for row in rows:
                if row.case.kind == kind:
                    for name, value in row.iou.items():
                        by_unit.setdefault(unit(row), {}).setdefault(name, []).append(value)
            for key, values in by_unit.items():
                for name, found in values.items():
                    every.setdefault(key, {}).setdefault(name, []).append(float(np.mean(found)))
        if not by_unit:
            continue
        means = {
            name: np.array([float(np.mean(values[name])) for values in by_unit.values()]) for name in names
        }
        cells = ["all" if kind is None else kinds[kind], str(len(by_unit))]
        cells += [f"{means[name].mean():.3f}" for name in names]
        for name in names:
            if name != "colour":
                gain = means[name] - means["colour"]
                low, high = interval(gain)
                cells.append(f"{gain.mean():+.3f} [{low:+.3f}, {high:+.3f}]")
        table.add_row(*cells)
    Console(width=130).print(table)
    print(f"{max(row.seconds for row in rows):.1f} s at most to learn and measure")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("suim", "renders"))
    parser.add_argument("folder", nargs="?", type=Path, help="of suim; unless given, that in DREAM_REAL_DATA")
    parser.add_argument("--backbone", type=Path, nargs="*", default=[], help="more networks to compare")
    parser.add_argument(
        "--no-default", action="store_true", help="leave out the network that comes with DREAM"
    )
    parser.add_argument("--splits", type=int, default=None, help="of the pictures at most; all unless given")
    parser.add_argument("--seed", type=int, default=0, help="of the strokes, splits and renders")
    parser.add_argument("--objects", type=int, default=OBJECTS, help="of renders")
    told_to = parser.parse_args()

    extractors = {} if told_to.no_default else {"default": Extractor(open_backbone(None))}
    extractors[TEXTURE] = Extractor(open_backbone(Path(TEXTURE)))
    extractors |= {path.stem: Extractor(open_backbone(path)) for path in told_to.backbone}
    methods: dict[str, Callable[[UInt8Array], Float32Array]] = {
        name: extractor.cells for name, extractor in extractors.items()
    }
    extractors["colour"] = extractors[TEXTURE]
    plain = extractors[TEXTURE].backbone
    methods["colour"] = lambda rgb: colour(rgb, plain.size, plain.grid)

    if told_to.what == "suim":
        home = os.environ.get("DREAM_REAL_DATA")
        folder = told_to.folder or (Path(home) / "suim_test" if home else None)
        if folder is None:
            parser.error("expected DREAM_REAL_DATA, or a folder, got neither")
        scenes = suim_scenes(folder)
        if len(scenes) <= MARKED:
            parser.error(f"expected more than {MARKED} pictures with masks in {folder}, got {len(scenes)}")
        splits = list(itertools.combinations(range(len(scenes)), MARKED))
        if told_to.splits is not None and told_to.splits < len(splits):
            rng = np.random.default_rng(told_to.seed)
            splits = [splits[n] for n in rng.choice(len(splits), told_to.splits, replace=False)]
        kinds = {
            k: SUIM[k] for k in range(8) if sum((s.kinds == k).mean() >= LEAST_SHARE for s in scenes) >= 6
        }
        every = range(len(scenes))
        cases = [
            Case("", k, split, tuple(n for n in every if n not in split)) for k in kinds for split in splits
        ]
        work = evaluated(scenes, cases, methods, extractors, told_to.seed)
        rows = [row for some in track(work, "cases", len(cases)) for row in some]
        told(f"IoU on {len(scenes)} pictures of SUIM, {MARKED} marked", rows, lambda r: str(r.picture), kinds)
        return
    rows = []
    for name, scenes in track(render_scenes(told_to.seed, told_to.objects).items(), "objects"):
        if len(scenes) <= MARKED:
            print(f"object {name} is left out: {len(scenes)} pictures show it, none beside {MARKED} to label")
            continue
        case = Case(str(name), 1, tuple(range(MARKED)), tuple(range(MARKED, len(scenes))))
        for some in evaluated(scenes, [case], methods, extractors, told_to.seed):
            rows += some
    if not rows:
        parser.error(f"--objects: expected some that more than {MARKED} pictures show, got none")
    told(
        f"IoU on renders, {MARKED} pictures of each object marked", rows, lambda r: r.case.unit, {1: "object"}
    )


if __name__ == "__main__":
    main()
