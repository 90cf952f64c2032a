"""What `dream oracle` tells of a mission in space, and its picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dream.commands.console import save_picture

if TYPE_CHECKING:
    from dream.evaluation.oracle.space_bounds import SpaceBounds
    from dream.protocol import SurveyProtocol
    from dream.sim.world import World


def ends(bounds: SpaceBounds) -> str:
    """Between which numbers of steps it lies."""
    return f"98.26 % in {bounds.lower_bound or '?'} to {bounds.best_tour or '?'} steps"


def print_one(bounds: SpaceBounds, picture: Path | None) -> None:
    """Tell both ends."""
    print(f"{bounds.world} {bounds.seed} · start {bounds.start} · {bounds.protocol}")
    if bounds.status == "optimal":
        print(f"  98.26 %  {bounds.best_tour} steps, and no fewer: optimal")
    else:
        best = "no tour known" if bounds.best_tour is None else f"best tour {bounds.best_tour} steps"
        least = bounds.lower_bound
        print(
            f"  98.26 %  {best}, " + ("lower bound: not known" if least is None else f"no fewer than {least}")
        )
    print(
        f"  {bounds.countable} individuals count; {bounds.cpu_s:.1f} s of processor time, those of earlier "
        "searches and for what each pose shows among them"
    )
    if picture is not None:
        print(f"  picture: {picture}")


def draw(bounds: SpaceBounds, world: World, protocol: SurveyProtocol, path: Path) -> None:
    """Save the chart with the best tour: a line coloured by height, and at every step where it looks."""
    import matplotlib
    import numpy as np
    from PIL import ImageDraw

    from dream.evaluation.oracle.space_bounds import tour_poses
    from dream.sim.chart import INK, PAPER, chart, chart_sheet

    page = chart(world)
    pen = ImageDraw.Draw(page)
    sheet = chart_sheet(world)
    x, y, z, yaw, _ = tour_poses(bounds, world, protocol).T
    across, down = sheet.at(x, y)
    track = list(zip(across.tolist(), down.tolist(), strict=True))
    shades = matplotlib.colormaps["viridis"]((z - z.min()) / max(float(np.ptp(z)), 1e-9))
    colors = [(int(r), int(g), int(b)) for r, g, b in np.round(255 * shades[:, :3])]
    pen.line(track, fill=PAPER, width=7, joint="curve")
    for begin, end, color in zip(track, track[1:], colors[1:], strict=False):
        pen.line([begin, end], fill=color, width=4)
    looks = zip(track, (across + 14 * np.cos(yaw)).tolist(), (down - 14 * np.sin(yaw)).tolist(), strict=True)
    for ((u, v), to_u, to_v), color in zip(looks, colors, strict=True):
        pen.line([(u, v), (to_u, to_v)], fill=INK, width=2)
        pen.ellipse([u - 4, v - 4, u + 4, v + 4], fill=color, outline=INK)
    for k, height in enumerate(np.linspace(z.min(), z.max(), 6)):
        shade = matplotlib.colormaps["viridis"](k / 5)
        color = (round(255 * shade[0]), round(255 * shade[1]), round(255 * shade[2]))
        left, top = 14, 14 + 18 * (5 - k)
        pen.rectangle([left, top, left + 14, top + 18], fill=color)
        pen.text((left + 20, top + 3), f"{height:.1f} m", fill=INK)
    save_picture(page, path, "--picture")
