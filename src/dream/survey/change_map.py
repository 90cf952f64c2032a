"""A comparison as files: a page to read, a picture of the change, its layers as a GeoPackage, its figures as
JSON."""

from __future__ import annotations

import errno
import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.survey.change_layers import GROUND, GROUND_WORDS, INDIVIDUALS, VERDICTS, write_change_layers
from dream.survey.change_page import change_page
from dream.survey.change_words import CHANGED
from dream.survey.comparison import Change, Comparison, PatchChange
from dream.survey.fates import Fate
from dream.survey.products.sheet import INK, corners_of, east_north, new_figure, png, settings, show_map
from dream.survey.products.words import place

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Float64Array = npt.NDArray[np.float64]

WIDTH = 6.4
"""Inches of the picture, at most."""
LEAST_WIDTH, MOST_HEIGHT = 4.2, 9.0
"""Inches: its key needs the one, and a page has room for the other."""
BESIDE, BELOW = 0.9, 1.6
"""Inches around the map itself: for its axis, and for its title and key."""
MARGIN = 1.0
"""Metres of ground around the target of both surveys that the picture shows, at least."""
MARK = 30.0
"""Square points of the mark of an individual that is gone or has come: 7 pixels or more on the page."""
MARKS: Mapping[Fate, tuple[str, float, str]] = {
    Fate.THERE: (".", 3.0, "individual there in both"),
    Fate.LOST: ("x", MARK, "only before"),
    Fate.NEW: ("^", MARK, "only after"),
}
"""Shape, size and words: what is gone and what has come differ by more than their colour."""
HATCHES: Mapping[Change, str] = {Change.GAIN: "....", Change.LOSS: "////"}
MOST_BYTES = 1 << 26
"""Of a change.json that is looked into."""
PAGE = "change.html"
FILES: Mapping[str, str] = {
    "change.png": "map of the change",
    "change.gpkg": "ground, patches with verdicts, individuals with what became of them; QGIS opens it so "
    "coloured",
    "change.json": "all figures of this page, and more, for programs",
    PAGE: "the page to read",
}
"""What is written. The page comes last, as it shows and names the others."""


def write_change(comparison: Comparison, folder: Path) -> tuple[Path, ...]:
    """Write a comparison into a folder, as `FILES` has it: each file whole or not at all.

    Raises:
        FileExistsError: The folder holds that of other surveys.
        OSError: They could not be written; then none of them is new.
    """
    told = comparison.as_dict()
    _check_other(told, folder / "change.json")
    partial = Path(tempfile.mkdtemp(prefix=".partial.", dir=folder))
    try:
        picture = partial / "change.png"
        draw(comparison, picture)
        write_change_layers(comparison, partial / "change.gpkg")
        text = json.dumps(told, allow_nan=False, indent=2) + "\n"
        (partial / "change.json").write_text(text, encoding="utf-8")
        others = [(name, what) for name, what in FILES.items() if name != PAGE]
        page = change_page(comparison, picture.read_bytes(), VERDICTS, others)
        (partial / PAGE).write_text(page, encoding="utf-8")
        for name in FILES:
            if (folder / name).is_dir():  # Before any other takes its place.
                raise IsADirectoryError(errno.EISDIR, f"{name} is a folder")
        for name in FILES:
            (partial / name).replace(folder / name)
    except OSError as error:
        raise OSError(
            f"could not write the change to {folder} ({error.strerror or error}). Nothing there was changed: "
            "make room, or name another folder with --out"
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return tuple(folder / name for name in FILES)


def _check_other(told: Mapping[str, Any], path: Path) -> None:
    """What is there may be written anew, but not lost for another."""
    try:
        held = json.loads(path.read_bytes()) if path.stat().st_size < MOST_BYTES else None
    except (OSError, ValueError):
        return
    if isinstance(held, dict) and any(held.get(which) != told[which] for which in ("before", "after")):
        raise FileExistsError(
            f"{path.parent} holds the change between other surveys, in {path.name}: name another folder with "
            "--out, or remove it"
        )


def draw(comparison: Comparison, path: Path) -> None:
    """A picture of the change on the earlier survey's ground, with a scale, north and the figures."""
    around = _around(comparison)
    corners = east_north(comparison.a.site, around)
    wide, high = np.ptp(corners, axis=0)
    with settings():
        across = np.clip((MOST_HEIGHT - BELOW) * wide / high + BESIDE, LEAST_WIDTH, WIDTH)
        tall = np.clip((across - BESIDE) * high / wide + BELOW, LEAST_WIDTH, MOST_HEIGHT)
        figure, axes = new_figure(float(across), float(tall))
        draw_on(axes, comparison, around)
        path.write_bytes(png(figure))


def _around(comparison: Comparison) -> Float64Array:
    """(N, 2) points that the picture has to hold: the target that either survey shows, with a margin.

    The corners of the cells that both saw where neither shows any, and of all ground where there are none.
    """
    box, cell = comparison.bounds, comparison.cell
    rings = [ring for patch in comparison.patches for ring in patch.rings]
    target = (Change.KEPT, Change.GAIN, Change.LOSS)
    for kinds, margin, more in ((target, round(MARGIN / cell), rings), ((Change.BARE,), 0, [])):
        row, col = np.nonzero(np.isin(comparison.change, kinds))
        if row.size:
            ends = [(-margin, 1 + margin)] * 2
            cells = np.concatenate([(col + x, row + y) for x in ends[0] for y in ends[1]], axis=1)
            corner = np.array([box.x_min, box.y_min])
            return np.concatenate([corner + cell * np.unique(cells, axis=1).T, *more])
    return corners_of(box)


def draw_on(axes: Axes, comparison: Comparison, around: Float64Array) -> None:
    """The map itself, on a sheet that holds what is `around`: (N, 2) points of the earlier survey's frame."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch as Key
    from matplotlib.transforms import Affine2D

    site = comparison.a.site
    show_map(
        axes,
        site,
        comparison.bounds,
        comparison.change,
        around,
        cmap=ListedColormap([GROUND[change] for change in Change]),
        vmin=-0.5,
        vmax=len(Change) - 0.5,
    )
    turned = Affine2D().rotate_deg(0.0 if site is None else -site.heading_deg) + axes.transData
    box, cell = comparison.bounds, comparison.cell
    x = box.x_min + cell * (np.arange(comparison.change.shape[1]) + 0.5)
    y = box.y_min + cell * (np.arange(comparison.change.shape[0]) + 0.5)
    for change, hatch in HATCHES.items():
        cells = comparison.change == change
        if cells.any() and min(cells.shape) > 1:
            axes.contourf(
                *(x, y, cells.astype(np.float32)),
                levels=[0.5, 1.5],
                colors="none",
                hatches=[hatch],
                transform=turned,
                zorder=2,
            )
    a = comparison.a.individuals.position[:, :2]
    places = {
        Fate.THERE: a[np.isin(comparison.fate_a, (Fate.THERE, Fate.HIDDEN))],
        Fate.LOST: a[comparison.fate_a == Fate.LOST],
        Fate.NEW: comparison.positions_b[comparison.fate_b == Fate.NEW],
    }
    marks: list[Any] = []
    for fate, points in places.items():
        mark, size, words = MARKS[fate]
        at = east_north(site, points)
        look: dict[str, Any] = {"marker": mark, "s": size, "linewidths": 1.1, "zorder": 4.0}
        look |= {"edgecolors": "white", "linewidths": 0.5} if mark == "^" else {}
        dots = axes.scatter(at[:, 0], at[:, 1], c=INDIVIDUALS[fate], label=words, **look)
        marks += [dots] if len(points) else []
    for number, patch in enumerate(comparison.patches, start=1):
        color = VERDICTS[patch.verdict]
        rings = [east_north(site, ring) for ring in patch.rings]
        for ring in rings:
            axes.plot(*ring.T, color=color, linewidth=1.6 if patch.verdict in CHANGED else 0.8, zorder=3)
        axes.annotate(
            f"{number} {patch.verdict}{_shares(patch)}",
            rings[0][np.argmax(rings[0][:, 1])],
            xytext=(0, 3),
            textcoords="offset points",
            color=color,
            fontsize=9,
            ha="center",
            bbox={"facecolor": "white", "alpha": 0.75, "linewidth": 0.0, "pad": 1.0},
            zorder=6,
        )
    axes.set_facecolor(GROUND[Change.NOT_COMPARABLE])
    axes.set_title(_title(comparison), fontsize=8.5, weight="normal")
    keys: list[Any] = [
        Key(facecolor=GROUND[change], edgecolor=INK, linewidth=0.4, hatch=HATCHES.get(change))
        for change in Change
    ]
    assert axes.figure is not None
    axes.figure.legend(
        keys + marks,
        [GROUND_WORDS[change] for change in Change] + [dots.get_label() for dots in marks],
        loc="outside lower center",
        ncols=3 if axes.get_window_extent().width < axes.get_window_extent().height else 4,
        fontsize=8.5,
        handlelength=1.4,
        columnspacing=1.2,
    )


def _shares(patch: PatchChange) -> str:
    """Of individuals that are gone and that have come; of what was found where pictures do not tell."""
    if patch.gone is not None and patch.come is not None:
        return f" −{patch.gone.share:.0%} +{patch.come.share:.0%}"
    count = next(iter(patch.differences), None)
    return "" if count is None or count.before <= 0.0 else f" {count.change / count.before:+.0%}"


def _title(comparison: Comparison) -> str:
    a, b, sigma = comparison.a, comparison.b, comparison.registration.sigma
    made_up = "SIMULATED · " if a.simulated or b.simulated else ""
    told = (
        "not laid on each other: nothing is compared"
        if comparison.withheld
        else f"{comparison.comparable:.0f} m² seen by both, laid on each other to {100.0 * sigma:.1f} cm"
    )
    return f"{made_up}{place(a)}, {a.began:%Y-%m-%d} to {b.began:%Y-%m-%d}\n{told}"
