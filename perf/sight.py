"""How well the network `sight` tells labels and depth: on pictures unlike those it learned from, and real.

    python perf/sight.py --out marks                   the network that comes with DREAM, on 60 scenes of 5
    python perf/sight.py try/sight.onnx --scenes 12    another, on fewer pictures
    python perf/sight.py --scenes 0 --depths FOLDER    real pictures only

Pictures are those of perf/unseen. Where the environment names a folder `DREAM_REAL_DATA`, its scans are among
the shapes, and its suim_test are the real pictures, unless --suim names another folder. --depths is a folder
of pictures with depth, as data/example_dataset of github.com/ebnerluca/uw_depth; --boxes one of pictures with
boxes, as github.com/beaverauv/robosub_transdec_dataset.

Beside it stand `Shells` with `FlatFloor`, and `FlatFloor` with all called seabed. Labels are marked within
two attenuation lengths, and of water. It writes sight.json, and pictures of the best and the worst.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import track
from rich.table import Table

from dream.evaluation.statistics import Interval
from dream.geometry import FloatArray
from dream.perception import FlatFloor, Shells, Sight, View
from dream.perception.depth import DepthModel, Segmenter
from dream.types import Float32Array, Label, UInt8Array
from unseen import real
from unseen.marks import (
    BINS,
    CLOSE,
    DEEPEST,
    LEAST_SHARE,
    Figure,
    Tally,
    Told,
    confused,
    figures,
    gaps,
    interval,
    mean_overlap,
    overlap,
)
from unseen.pictures import Picture, pictures

COLOURS = np.array([[24, 66, 150], [214, 193, 128], [222, 62, 58], [70, 190, 90], [60, 60, 60]], np.uint8)
"""Of the labels, and of what is not marked."""
SHOWN = 10
"""Best and worst pictures."""
TILE = 192, 144
HIT = 0.25
"""Share of the middle of a box that is structure where the object is found."""
FEWEST = 20
"""Objects of one name that are marked."""


@dataclass(frozen=True, slots=True)
class AllSeabed:
    """Calls everything seabed."""

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        """See `Segmenter.segment`."""
        return np.full(rgb.shape[:2], Label.SEABED, np.uint8), np.ones(rgb.shape[:2], np.float32)


@dataclass(frozen=True, slots=True)
class Teller:
    """What tells labels and depth, under a name."""

    name: str
    segmenter: Segmenter
    depth: DepthModel

    def tell(self, rgb: UInt8Array, view: View) -> Told:
        """All of a picture."""
        labels, sure = self.segmenter.segment(rgb, view)
        depth, near = self.depth.estimate(rgb, labels, view)
        return Told(labels, sure, depth, near)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A picture with what was said of it, and how much of that is right."""

    score: float
    tiles: tuple[UInt8Array, ...]


def tellers(model: Path | None) -> tuple[Teller, ...]:
    """The network, and what stands beside it."""
    sight = Sight(model)
    return (
        Teller("sight", sight, sight),
        Teller("shells, flat floor", Shells(), FlatFloor()),
        Teller("all seabed, flat floor", AllSeabed(), FlatFloor()),
    )


# Pictures that are made up


def judged(picture: Picture, told: Told) -> Tally:
    """The sums of one picture."""
    tally, straight = Tally(), picture.straight
    with np.errstate(invalid="ignore"):
        water = picture.labels == Label.WATER
        within = straight <= picture.label_range
        tally.add_labels(picture.labels, told, within | water, picture.depth <= CLOSE)
        tally.add_depth(picture.depth, told, within & ~water & (picture.depth <= DEEPEST))
    return tally


def unseen(
    all_tellers: Sequence[Teller], seed: int, scenes: int, per_scene: int, console: Console
) -> tuple[dict[str, list[Tally]], list[Shown], float]:
    """Tallies by teller, one a scene; what the first said; its median milliseconds a picture."""
    tallies = {teller.name: [Tally() for _ in range(scenes)] for teller in all_tellers}
    shown, spent = [], []
    drawn = track(pictures(seed, scenes, per_scene), "unseen", scenes * per_scene, console=console)
    for picture in drawn:
        for n, teller in enumerate(all_tellers):
            begun = time.perf_counter()
            told = teller.tell(picture.rgb, picture.view)
            took = time.perf_counter() - begun
            tally = judged(picture, told)
            tallies[teller.name][picture.scene].add(tally)
            if n == 0:
                spent.append(1000.0 * took)
                shown.append(_shown(picture, told, tally))
    return tallies, shown, float(np.median(spent))


def _shown(picture: Picture, told: Told, tally: Tally) -> Shown:
    with np.errstate(invalid="ignore"):
        unmarked = (picture.straight > picture.label_range) & (picture.labels != Label.WATER)
    truth = np.where(unmarked, np.uint8(len(Label)), picture.labels)
    tiles = (picture.rgb, COLOURS[truth], COLOURS[told.labels], coloured(picture.depth), coloured(told.depth))
    return Shown(float(mean_overlap(tally.confusion)), tuple(_tile(tile) for tile in tiles))


def coloured(depth: Float32Array) -> UInt8Array:
    """(H, W, 3): near is bright, `DEEPEST` and farther is dark, unknown is black."""
    shades = matplotlib.colormaps["magma_r"](np.clip(np.nan_to_num(depth) / DEEPEST, 0.0, 0.95))[..., :3]
    return np.where(np.isfinite(depth)[..., None], np.rint(255.0 * shades), 0.0).astype(np.uint8)


def _tile(image: UInt8Array) -> UInt8Array:
    return np.asarray(Image.fromarray(image).resize(TILE, Image.Resampling.BOX))


def _sheet(strips: Sequence[Sequence[UInt8Array]], across: int, path: Path) -> None:
    """Strips of tiles as a picture, some side by side."""
    wide = [np.concatenate(strip, axis=1) for strip in strips]
    wide += [np.zeros_like(wide[0])] * (-len(wide) % across)
    rows = [np.concatenate(wide[n : n + across], axis=1) for n in range(0, len(wide), across)]
    Image.fromarray(np.concatenate(rows)).save(path, optimize=True)


def best_and_worst(shown: Sequence[Shown], path: Path) -> None:
    """The best on the left, the worst on the right: picture, truth, answer, true depth, told depth."""
    order = sorted((one for one in shown if np.isfinite(one.score)), key=lambda one: -one.score)
    half = min(SHOWN, len(order) // 2)
    if half:
        pairs = zip(order[:half], reversed(order[-half:]), strict=True)
        _sheet([one.tiles for pair in pairs for one in pair], 2, path)


# Real pictures


def masked(all_tellers: Sequence[Teller], folder: Path, out: Path) -> dict[str, dict[str, Interval]]:
    """Water, floor and structure of SUIM, with intervals over pictures; no view is known."""
    sums: dict[str, list[FloatArray]] = {teller.name: [] for teller in all_tellers}
    rows = []
    for picture in real.masked(folder):
        marked = picture.kinds != real.LEFT_OUT
        for n, teller in enumerate(all_tellers):
            labels, _ = teller.segmenter.segment(picture.rgb, None)
            kinds = real.kinds_of(labels)
            sums[teller.name].append(confused(picture.kinds[marked], kinds[marked], 3).ravel())
            if n == 0:
                truth = np.where(marked, picture.kinds, np.uint8(len(Label)))
                rows.append([_tile(t) for t in (picture.rgb, COLOURS[truth], COLOURS[labels])])
    if not rows:
        return {}
    _sheet(rows, 2, out)

    def mean(flat: FloatArray) -> FloatArray:
        return mean_overlap(flat.reshape(*flat.shape[:-1], 3, 3))

    def solid(flat: FloatArray) -> FloatArray:
        whole = flat.reshape(*flat.shape[:-1], 3, 3)
        either = whole.sum(axis=(-2, -1)) - whole[..., 0, 0]
        return np.asarray(whole[..., 1:, 1:].sum(axis=(-2, -1)) / either)

    def of(kind: int) -> Figure:
        return lambda flat: overlap(flat.reshape(*flat.shape[:-1], 3, 3), kind)

    found = {}
    for name, each in sums.items():
        table = np.stack(each)
        found[name] = {f"{kind} IoU": interval(table, of(k)) for k, kind in enumerate(real.KINDS)}
        found[name]["mean IoU"] = interval(table, mean)
        found[name]["not water IoU"] = interval(table, solid)
    return found


def measured(all_tellers: Sequence[Teller], folder: Path, out: Path) -> dict[str, dict[str, Interval]]:
    """Depth of FLSea, with intervals over pictures; as it is, and with the median brought to the true one."""
    sums: dict[str, list[FloatArray]] = {teller.name: [] for teller in all_tellers}
    rows = []
    for picture in real.measured(folder):
        with np.errstate(invalid="ignore"):
            marked = picture.depth <= DEEPEST
        for n, teller in enumerate(all_tellers):
            told = teller.tell(picture.rgb, picture.view)
            tally, scaled = Tally(), Tally()
            tally.add_depth(picture.depth, told, marked)
            both = marked & np.isfinite(told.depth)
            factor = np.median(picture.depth[both] / told.depth[both]) if both.any() else np.nan
            fitted = Told(told.labels, told.sure, (told.depth * factor).astype(np.float32), told.near)
            scaled.add_depth(picture.depth, fitted, marked)
            sums[teller.name].append(np.concatenate([tally.depth, scaled.depth]))
            if n == 0:
                tiles = (picture.rgb, COLOURS[told.labels], coloured(picture.depth), coloured(told.depth))
                rows.append([_tile(tile) for tile in tiles])
    if not rows:
        return {}
    _sheet(rows, 2, out)
    return {
        name: {
            "AbsRel": interval(np.stack(each), lambda flat: flat[..., 2] / flat[..., 1], most=math.inf),
            "delta1": interval(np.stack(each), lambda flat: flat[..., 3] / flat[..., 0]),
            "not told": interval(np.stack(each), lambda flat: 1.0 - flat[..., 1] / flat[..., 0]),
            "AbsRel, scaled": interval(
                np.stack(each), lambda flat: flat[..., 6] / flat[..., 5], most=math.inf
            ),
            "delta1, scaled": interval(np.stack(each), lambda flat: flat[..., 7] / flat[..., 4]),
        }
        for name, each in sums.items()
    }


def boxed(all_tellers: Sequence[Teller], folder: Path, out: Path) -> dict[str, dict[str, Interval]]:
    """Objects of RoboSub that are found, by name, and structure where no object is; over pictures."""
    sums: dict[str, list[FloatArray]] = {teller.name: [] for teller in all_tellers}
    rows, every = [], list(real.boxed(folder))
    counted = Counter(box[0] for picture in every for box in picture.boxes)
    names = [name for name, count in counted.most_common() if count >= FEWEST]
    for picture in every:
        outside = np.ones(picture.rgb.shape[:2], np.bool_)
        for _, a, b, c, d in picture.boxes:
            outside[b:d, a:c] = False
        for n, teller in enumerate(all_tellers):
            labels, _ = teller.segmenter.segment(picture.rgb, None)
            structure = real.kinds_of(labels) == real.STRUCTURE
            counts = np.zeros((1 + len(names), 2))
            counts[0] = outside.sum(), structure[outside].sum()
            for name, a, b, c, d in picture.boxes:
                if name in names:
                    across, along = (c - a) // 4, (d - b) // 4
                    middle = structure[b + along : d - along, a + across : c - across]
                    counts[1 + names.index(name)] += (1, middle.mean() >= HIT)
            sums[teller.name].append(counts.ravel())
            if n == 0:
                rows.append([_tile(picture.rgb), _tile(COLOURS[labels])])
    if not rows:
        return {}
    _sheet(rows[:: max(1, len(rows) // 30)], 5, out)

    def share(k: int) -> Figure:
        return lambda flat: flat[..., 2 * k + 1] / flat[..., 2 * k]

    told = ["structure elsewhere", *(f"{name} found" for name in names)]
    return {
        name: {title: interval(np.stack(each), share(k)) for k, title in enumerate(told)}
        for name, each in sums.items()
    }


# Tables


def percent(value: float) -> str:
    """As text."""
    return f"{100.0 * value:.1f}"


def table(title: str, found: dict[str, dict[str, Interval]], console: Console) -> None:
    """A column a teller: the figure in %, and its interval."""
    shown = Table(title=title)
    shown.add_column("%")
    for name in found:
        shown.add_column(name, justify="right")
    for figure in next(iter(found.values())):
        values = [marks[figure] for marks in found.values()]
        shown.add_row(
            figure, *(f"{percent(v.value)} ({percent(v.low)} to {percent(v.high)})" for v in values)
        )
    console.print(shown)


def reliability(title: str, bins: FloatArray, console: Console) -> None:
    """How often what is believed to some degree is right; bins with few pixels are marked."""
    shown = Table(title=title)
    for name in ("confidence", "mean", "right", "gap", "share of pixels"):
        shown.add_column(name, justify="right")
    gap, total = gaps(bins), max(float(bins[:, 0].sum()), 1.0)
    for n, (pixels, confidence, right) in enumerate(bins):
        if pixels:
            few = " (few)" if pixels / total < LEAST_SHARE else ""
            values = (confidence / pixels, right / pixels, gap[n])
            shown.add_row(
                f"{n / BINS:.1f} to {(n + 1) / BINS:.1f}",
                *map(percent, values),
                percent(pixels / total) + few,
            )
    console.print(shown)


def written(found: dict[str, dict[str, Interval]]) -> dict[str, Any]:
    """For JSON: NaN as null."""
    return {
        name: {
            figure: {key: value if value == value else None for key, value in asdict(mark).items()}
            for figure, mark in marks.items()
        }
        for name, marks in found.items()
    }


def main() -> None:
    """Print the tables, write figures and pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path, nargs="?", help="the network that comes with DREAM unless given")
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--per-scene", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("marks"))
    parser.add_argument("--suim", type=Path, help="folder of pictures with masks")
    parser.add_argument("--depths", type=Path, help="folder of pictures with depth")
    parser.add_argument("--boxes", type=Path, help="folder of pictures with boxes")
    given = parser.parse_args()
    console, all_tellers = Console(), tellers(given.model)
    given.out.mkdir(parents=True, exist_ok=True)
    scans = os.environ.get("DREAM_REAL_DATA")
    result: dict[str, Any] = {"model": str(given.model or "shipped"), "scans": scans is not None}
    if given.scenes:
        tallies, shown, spent = unseen(all_tellers, given.seed, given.scenes, given.per_scene, console)
        found = {name: figures(each) for name, each in tallies.items()}
        table(
            f"Unseen: {given.scenes} scenes of {given.per_scene} pictures, seed {given.seed}", found, console
        )
        together = Tally()
        for tally in tallies[all_tellers[0].name]:
            together.add(tally)
        reliability("Confidence in a label, and how often it is right, %", together.sure, console)
        reliability("Confidence in a depth, and how often it is right to a tenth, %", together.near, console)
        console.print(f"{spent:.0f} ms a picture, median.")
        best_and_worst(shown, given.out / "unseen.png")
        result["unseen"] = {
            "seed": given.seed,
            "scenes": given.scenes,
            "per_scene": given.per_scene,
            "milliseconds": spent,
            "figures": written(found),
            "confusion": together.confusion.tolist(),
            "label_bins": together.sure.tolist(),
            "depth_bins": together.near.tolist(),
        }
    suim = given.suim or (Path(scans) / "suim_test" if scans else None)
    for name, title, folder, mark in (
        ("suim", "SUIM, real, without a view", suim, masked),
        (
            "depths",
            f"FLSea, real, depth within {DEEPEST:g} m, view from the true depth",
            given.depths,
            measured,
        ),
        ("boxes", "RoboSub, real, without a view", given.boxes, boxed),
    ):
        if folder is None:
            continue
        marks = mark(all_tellers, folder, given.out / f"{name}.png")
        if marks:
            table(title, marks, console)
            result[name] = written(marks)
        else:
            console.print(f"{folder}: no pictures of {name}.")
    (given.out / "sight.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    console.print(f"Written to {given.out}.")


if __name__ == "__main__":
    main()
