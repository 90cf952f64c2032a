"""What the wide worlds come to: individuals, relief, water, and what of them cannot be inspected.

    python perf/habitats.py table                  the table of docs/habitats.md: 25 seeds a family, 5 minutes
    python perf/habitats.py table --inspected 4    with the share that cannot be inspected, by the first four
                                                   seeds of each: 20 minutes more
    python perf/habitats.py table --only tiny two  some of the families
    python perf/habitats.py frames                 milliseconds to make the widest world, and to draw a view
    python perf/habitats.py picture docs/habitats.png    a chart and a view of each family

Where the environment names a folder `DREAM_REAL_DATA` with a scanned reef (reef_dem/horseshoe_8m_1cm.npz),
the table ends with its relief, at the spacing of the worlds.
"""

from __future__ import annotations

import argparse
import io
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

from dream.geometry import SE3, camera_mount
from dream.protocol import DREAM_V2
from dream.sim.chart import INK, PAPER, chart
from dream.sim.habitats import HABITATS
from dream.sim.inspection import Inspection
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.validity import problems
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Label

SEEDS = range(1, 26)
ON_REEF = 0.5
"""Metres from an individual within which the bed is that of a reef."""
SHOWN = (
    ("mound", 2), ("ledge", 2), ("carpet", 2), ("tiny", 1), ("dense", 2), ("rocks", 5),
    ("rocks", 3), ("holes", 5), ("border", 1), ("walls", 4), ("two", 3), ("wide", 3),
)  # fmt: skip
"""What the picture shows, by family and seed."""
VIEW_DISTANCE, VIEW_HEIGHT = 2.8, 1.5
"""Metres from what a view looks at, and over the bed there."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Of a seabed on a grid of squares."""

    steep: float
    """Degrees: the slope that 95 % of it do not reach."""
    rugosity: float
    """Its surface over what that covers on a map."""


def relief_of(heights: npt.NDArray[np.float64], spacing: float, where: npt.NDArray[np.bool_]) -> Relief:
    """The relief of some points of a grid, heights (N, M)."""
    slope = np.hypot(*np.gradient(heights, spacing))[where]
    return Relief(
        math.degrees(math.atan(float(np.percentile(slope, 95.0)))), float(np.sqrt(1.0 + slope**2).mean())
    )


def seabed_relief(world: World) -> tuple[Relief, Relief]:
    """Of the whole arena, and of the bed about its individuals."""
    ground, box = world.terrain, world.bounds
    rows, cols = ground.heights.shape
    x, y = np.meshgrid(
        ground.x0 + np.arange(cols) * ground.spacing, ground.y0 + np.arange(rows) * ground.spacing
    )
    inside = box.covers(x, y)
    away, _ = cKDTree(world.targets.position[:, :2]).query(np.stack([x, y], axis=-1).reshape(-1, 2))
    heights = ground.heights.astype(np.float64)
    near = inside & (np.asarray(away).reshape(x.shape) <= ON_REEF)
    return relief_of(heights, ground.spacing, inside), relief_of(heights, ground.spacing, near)


def spread(values: list[float], digits: int = 0) -> str:
    """The median, and the least and greatest."""
    low, middle, high = np.percentile(values, [0.0, 50.0, 100.0])
    return f"{middle:,.{digits}f} ({low:,.{digits}f} to {high:,.{digits}f})"


def table(families: list[str], inspected: int) -> None:
    """Print it, a line a family as soon as it is known."""
    print(
        "| family | individuals | groups | area, m² | visibility, m | steep, ° | on the reef, ° | rugosity |",
        end="",
    )
    print(" not inspectable, % |" if inspected else "")
    print("|---|---|---|---|---|---|---|---|" + "---|" * bool(inspected))
    for name in (name for name in HABITATS if name.removeprefix("reef/") in families):
        worlds = [make_world(name, seed) for seed in SEEDS]
        amiss = [text for world in worlds for text in problems(world)]
        assert not amiss, amiss
        reliefs = [seabed_relief(world) for world in worlds]
        line = [
            name.removeprefix("reef/"),
            spread([len(world.targets) for world in worlds]),
            spread([int(world.targets.group.max()) + 1 for world in worlds]),
            spread([world.bounds.area for world in worlds]),
            spread([world.water.visibility for world in worlds], 1),
            spread([everywhere.steep for everywhere, _ in reliefs]),
            spread([near.steep for _, near in reliefs]),
            spread([near.rugosity for _, near in reliefs], 2),
        ]
        if inspected:
            dropped = [Inspection(world, DREAM_V2).dropped for world in worlds[:inspected]]
            line.append(f"{100.0 * np.mean(dropped):.1f} (up to {100.0 * max(dropped):.1f})")
        print("| " + " | ".join(line) + " |", flush=True)
    real = os.environ.get("DREAM_REAL_DATA")
    if real:
        fine = np.load(Path(real) / "reef_dem" / "horseshoe_8m_1cm.npz", allow_pickle=False)["z"]
        each = 25
        rows, cols = (side // each for side in fine.shape)
        coarse = fine[: rows * each, : cols * each].reshape(rows, each, cols, each).mean(axis=(1, 3))
        found = relief_of(coarse, 0.01 * each, np.ones(coarse.shape, np.bool_))
        print(
            f"| scanned coral reef, 8 m by 8 m | | | 64 | | {found.steep:.0f} | {found.steep:.0f} | "
            f"{found.rugosity:.2f} |"
        )


def frames() -> None:
    """Print what the widest world of some seeds of all families costs."""
    every = [make_world(name, seed) for name in HABITATS for seed in SEEDS[:6]]
    for widest in (
        max(every, key=lambda world: world.bounds.area),
        max(every, key=lambda world: len(world.targets) + 8 * len(world.obstacles)),
    ):
        begun = time.perf_counter()
        make_world(widest.name, widest.seed)
        made = time.perf_counter() - begun
        begun = time.perf_counter()
        renderer = Renderer(widest)
        poses = [
            SE3.level(s.x, s.y, float(widest.terrain.height(s.x, s.y)) + 2.0, s.yaw + turn)
            for s in widest.starts
            for turn in np.arange(6) * math.pi / 3.0
        ]
        mount = camera_mount(DREAM_V2.camera_pitch)
        renderer.render(DREAM_V2.camera, poses[0] @ mount)
        ready = time.perf_counter() - begun
        begun = time.perf_counter()
        for pose in poses:
            renderer.render(DREAM_V2.camera, pose @ mount)
        each = (time.perf_counter() - begun) / len(poses)
        box = widest.bounds
        print(
            f"{widest.name} {widest.seed}, {box.width:g} x {box.depth:g} m, "
            f"{len(widest.targets):,} individuals, {len(widest.obstacles)} obstacles: "
            f"made in {made:.1f} s, ready to draw in {ready:.1f} s, {1000.0 * each:.0f} ms a view"
        )


def view(world: World) -> Image.Image:
    """What the camera sees of individuals, from the side that shows most of them.

    It looks at the middle of the largest group; where walls cut the reef, at what grows nearest to the first.
    """
    renderer, solids = Renderer(world), Solids(world)
    places = world.targets.position.astype(np.float64)
    if world.name == "reef/walls":
        wall = world.obstacles.position[:1, :2]
        middle = places[np.hypot(*(places[:, :2] - wall).T).argmin()]
    else:
        middle = places[world.targets.group == np.bincount(world.targets.group).argmax()].mean(axis=0)
    mount = camera_mount(math.radians(20.0))
    shown = []
    for yaw in np.arange(12) * math.pi / 6.0:
        x, y = middle[0] - VIEW_DISTANCE * math.cos(yaw), middle[1] - VIEW_DISTANCE * math.sin(yaw)
        if world.bounds.contains(x, y, 1.0):
            z = max(float(world.terrain.height(x, y)), middle[2] - 0.8) + VIEW_HEIGHT
            above, _ = solids.ranges((x, y, z), [(0.0, 0.0, 1.0)], limit=5.0)
            # Neither touching anything nor inside a wall.
            if np.isfinite(above).any() or not solids.free_at([(x, y, z)], DREAM_V2).all():
                continue
            frame = renderer.render(DREAM_V2.camera, SE3.level(x, y, z, yaw) @ mount)
            solid = float((frame.labels == Label.OBSTACLE).mean()) if world.name == "reef/walls" else 0.0
            shown.append((min(round(solid, 1), 0.2), len(np.unique(frame.ids)), frame.rgb))
    return Image.fromarray(max(shown, key=lambda each: each[:2])[2])


def _side_by_side(pictures: list[Image.Image]) -> Image.Image:
    """All of them in one."""
    one = Image.new(
        "RGB", (sum(each.width for each in pictures), max(each.height for each in pictures)), PAPER
    )
    left = 0
    for each in pictures:
        one.paste(each, (left, 0))
        left += each.width
    return one


def picture(path: Path) -> None:
    """A chart and, under it, a view of each, four abreast."""
    wide, high, words, gap = 330, 248, 20, 8
    font = ImageFont.load_default(15)
    rows = -(-len(SHOWN) // 4)
    cell = words + 2 * high + gap
    sheet = Image.new("RGB", (4 * (wide + gap) + gap, rows * (cell + gap) + gap), PAPER)
    draw = ImageDraw.Draw(sheet)
    maps, views = list[Image.Image](), list[Image.Image]()
    for number, (family, seed) in enumerate(SHOWN):
        world = make_world(f"reef/{family}", seed)
        left, top = gap + number % 4 * (wide + gap), gap + number // 4 * (cell + gap)
        box = world.bounds
        said = f"{world.name} {seed}: {box.width:g} x {box.depth:g} m, {world.water.visibility:.1f} m clear"
        draw.text((left + 2, top + 1), said, fill=INK, font=font)
        # The chart's map without its legend, as large as its longer side allows.
        side = round(wide * 1.04)
        whole = chart(world, pixels=2 * side).crop((0, 0, 2 * side, 2 * side))
        scale = 2 * side / (1.08 * max(box.width, box.depth))
        pad = 0.02 * max(box.width, box.depth) * scale
        across, along = box.width * scale, box.depth * scale
        edge = 0.04 * max(box.width, box.depth) * scale
        map_ = whole.crop(
            (int(edge - pad), int(edge - pad), int(edge + across + pad), int(edge + along + pad))
        )
        map_.thumbnail((wide, high), Image.Resampling.LANCZOS)
        sheet.paste(map_, (left + (wide - map_.width) // 2, top + words + (high - map_.height) // 2))
        shown = view(world).resize((wide, high), Image.Resampling.LANCZOS)
        sheet.paste(shown, (left, top + words + high + 4))
        maps.append(map_)
        views.append(shown)
    buffer = io.BytesIO()
    # A palette of both kinds of picture, so that the few red pixels of a chart's starts stay red.
    colors = [
        np.array(kind.quantize(count, method=method).getpalette("RGB")).reshape(-1, 3)[:count]
        for kind, count, method in (
            (_side_by_side(maps), 96, Image.Quantize.MAXCOVERAGE),
            (_side_by_side(maps), 40, Image.Quantize.MEDIANCUT),
            (_side_by_side(views), 120, Image.Quantize.MEDIANCUT),
        )
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.concatenate(colors).astype(np.uint8).tobytes(), "RGB")
    sheet.quantize(palette=palette, dither=Image.Dither.NONE).save(buffer, "png", optimize=True)
    path.write_bytes(buffer.getvalue())
    print(f"{path}: {len(buffer.getvalue()) // 1000} kB")


def main() -> None:
    """Print the table or the cost, or draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("table", "frames", "picture"))
    parser.add_argument(
        "path", nargs="?", type=Path, default=Path("docs/habitats.png"), help="of the picture"
    )
    parser.add_argument("--inspected", type=int, default=0, metavar="N", help="seeds of which it is told")
    every = [name.removeprefix("reef/") for name in HABITATS]
    parser.add_argument("--only", nargs="+", choices=every, default=every, help="families of the table")
    options = parser.parse_args()
    if options.what == "table":
        table(options.only, options.inspected)
    elif options.what == "frames":
        frames()
    else:
        picture(options.path)


if __name__ == "__main__":
    main()
