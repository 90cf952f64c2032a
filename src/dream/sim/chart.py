"""A world drawn from above: what a person sees who is allowed to know everything."""

from __future__ import annotations

import colorsys
import math
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from dream.sim.sampling import rotated
from dream.sim.world import Instances, World

INK = (22, 32, 38)
START = (214, 40, 57)
PAPER = (246, 244, 238)

_Coordinate = TypeVar("_Coordinate", float, npt.NDArray[np.float64])


class ChartSheet(NamedTuple):
    """How metres of the world lie on the picture."""

    west: float
    north: float
    scale: float
    """Pixels per metre."""

    def at(self, x: _Coordinate, y: _Coordinate) -> tuple[_Coordinate, _Coordinate]:
        """The pixel of a place, or of an array of them."""
        return (x - self.west) * self.scale, (self.north - y) * self.scale


def chart(world: World, *, pixels: int = 900) -> Image.Image:
    """A north-up chart: shaded seabed, targets coloured by group, obstacles by height, starts, scale, north.

    Args:
        world: What to draw.
        pixels: Side of the square map; a margin with the legend comes on top.
    """
    bounds, sheet = world.bounds, chart_sheet(world, pixels=pixels)
    image = _seabed(world, sheet, pixels)
    draw = ImageDraw.Draw(image)
    groups = np.unique(world.targets.group)
    colors = {int(group): _color(k, len(groups)) for k, group in enumerate(groups)}
    _triangles(draw, world, world.targets.chosen(world.hull), sheet, colors)
    _triangles(draw, world, world.obstacles, sheet, {})
    # On top, since they grow on rocks as well.
    _dots(draw, world.targets.chosen(~world.hull), sheet, colors)
    draw.rectangle(
        [*sheet.at(bounds.x_min, bounds.y_max), *sheet.at(bounds.x_max, bounds.y_min)], outline=INK, width=2
    )
    for number, start in reversed(list(enumerate(world.starts))):
        _arrow(
            draw,
            sheet.at(start.x, start.y),
            start.yaw,
            0.022 * pixels if number == 0 else 0.014 * pixels,
            number == 0,
        )
    page = Image.new("RGB", (pixels, pixels + 46), PAPER)
    page.paste(image, (0, 0))
    _legend(ImageDraw.Draw(page), world, sheet.scale, pixels)
    return page


def chart_sheet(world: World, *, pixels: int = 900) -> ChartSheet:
    """How `chart` lays out a world."""
    bounds = world.bounds
    pad = 0.04 * max(bounds.width, bounds.depth)
    scale = pixels / (max(bounds.width, bounds.depth) + 2.0 * pad)
    return ChartSheet(bounds.x_min - pad, bounds.y_max + pad, scale)


def _seabed(world: World, sheet: ChartSheet, pixels: int) -> Image.Image:
    """Sand lit from the north-west, darker where it is deeper; slopes are exaggerated."""
    line = (np.arange(pixels) + 0.5) / sheet.scale
    x, y = np.meshgrid(sheet.west + line, sheet.north - line)
    z = world.terrain.height(x, y)
    down, right = np.gradient(z, 1.0 / sheet.scale)
    light = np.clip(0.5 + 1.6 * (right * 0.7 + down * 0.7), 0.0, 1.0)
    depth = np.clip(0.5 + (z - np.median(z)) / 1.6, 0.0, 1.0)
    deep, sand = np.array([150.0, 168.0, 170.0]), np.array([226.0, 216.0, 190.0])
    color = (deep + (sand - deep) * depth[..., None]) * (0.82 + 0.3 * light[..., None])
    ground = world.terrain
    rows, cols = ground.heights.shape
    beyond = (x < ground.x0) | (x > ground.x0 + (cols - 1) * ground.spacing)
    color[beyond | (y < ground.y0) | (y > ground.y0 + (rows - 1) * ground.spacing)] = PAPER
    return Image.fromarray(np.clip(color, 0, 255).astype(np.uint8))


def _dots(
    draw: ImageDraw.ImageDraw,
    targets: Instances,
    sheet: ChartSheet,
    colors: dict[int, tuple[int, int, int]],
) -> None:
    """Individuals too small to draw by their triangles: a dot each, as wide as they are, upper ones last."""
    for k in np.argsort(targets.position[:, 2], kind="stable"):
        x, y = sheet.at(float(targets.position[k, 0]), float(targets.position[k, 1]))
        radius = max(0.5 * sheet.scale * float(targets.scale[k, :2].mean()), 1.0)
        light = 0.65 + 0.35 * float(targets.tint[k].mean())
        color = colors[int(targets.group[k])]
        draw.ellipse(
            [x - radius, y - radius, x + radius, y + radius], fill=tuple(round(light * c) for c in color)
        )


def _triangles(
    draw: ImageDraw.ImageDraw,
    world: World,
    instances: Instances,
    sheet: ChartSheet,
    colors: dict[int, tuple[int, int, int]],
) -> None:
    """All triangles from above, lowest first, lit from the north-west; high ones are lighter."""
    corners: list[npt.NDArray[np.float64]] = []
    owners: list[npt.NDArray[np.intp]] = []
    for k in range(len(instances)):
        mesh = world.meshes[instances.mesh[k]]
        points = rotated(instances.wxyz[k], mesh.vertices * instances.scale[k]) + instances.position[k]
        corners.append(points[mesh.faces])
        owners.append(np.full(len(mesh.faces), k))
    if not corners:
        return
    triangles, owner = np.concatenate(corners), np.concatenate(owners)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0)
    light = 0.45 + 0.55 * np.clip(normal @ np.array([-0.48, 0.48, 0.73]), 0.0, 1.0)
    middle = triangles.mean(axis=1)
    rise = middle[:, 2] - world.terrain.height(middle[:, 0], middle[:, 1])
    if colors:
        base = np.array([colors[int(group)] for group in instances.group[owner]])
    else:
        grey = 60.0 + 150.0 * np.clip(rise / 3.2, 0.0, 1.0)
        base = grey[:, None] * np.array([1.0, 0.96, 0.9])
    fills = np.clip(base * light[:, None], 0.0, 255.0).astype(np.uint8)
    lines = np.stack(sheet.at(triangles[..., 0], triangles[..., 1]), axis=-1).reshape(len(triangles), -1)
    order = np.argsort(middle[:, 2], kind="stable")
    for line, fill in zip(lines[order].tolist(), fills[order].tolist(), strict=True):
        draw.polygon(line, fill=tuple(fill))


def _arrow(
    draw: ImageDraw.ImageDraw, centre: tuple[float, float], yaw: float, size: float, main: bool
) -> None:
    x, y = centre
    corners = []
    for length, turn in ((1.5, 0.0), (1.0, 2.5), (0.35, math.pi), (1.0, -2.5)):
        corners.append((x + size * length * math.cos(yaw + turn), y - size * length * math.sin(yaw + turn)))
    draw.polygon(corners, fill=START if main else PAPER, outline=INK)


def _legend(draw: ImageDraw.ImageDraw, world: World, scale: float, pixels: int) -> None:
    font = ImageFont.load_default(15)
    kinds = ((world.hull, "pieces of hull", "parts"), (~world.hull, "individuals", "patches"))
    inside = " and ".join(
        f"{np.count_nonzero(of):,} {pieces} in {len(np.unique(world.targets.group[of]))} {groups}"
        for of, pieces, groups in kinds
        if of.any()
    )
    inside = inside or "no individuals"
    said, starts = f"{world.name}  seed {world.seed}   {inside}", "red: start 0, white: other starts"
    if draw.textlength(f"{said}; {starts}", font) < 0.72 * pixels:
        draw.text((12, pixels + 13), f"{said}; {starts}", fill=INK, font=font)
    else:
        draw.text((12, pixels + 3), said, fill=INK, font=font)
        draw.text((12, pixels + 23), starts, fill=INK, font=font)
    length = 10.0 if world.bounds.width > 15.0 else 1.0
    right, y = pixels - 56.0, pixels + 31.0
    draw.line([(right - length * scale, y), (right, y)], fill=INK, width=3)
    draw.text((right - 0.5 * length * scale, y - 5), f"{length:g} m", fill=INK, font=font, anchor="ms")
    draw.polygon(
        [(pixels - 22, pixels + 8), (pixels - 15, pixels + 24), (pixels - 29, pixels + 24)], fill=INK
    )
    draw.text((pixels - 22, pixels + 40), "N", fill=INK, font=font, anchor="ms")


def _color(k: int, count: int) -> tuple[int, int, int]:
    """Neighbouring numbers get colours far apart."""
    red, green, blue = colorsys.hsv_to_rgb((0.33 + 0.381966 * k) % 1.0, 0.62, 0.82)
    return round(255 * red), round(255 * green), round(255 * blue)
