"""How figures and maps are drawn: one style, north up where that is known, with a scale and a north arrow."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.survey.site import Site

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float64Array = npt.NDArray[np.float64]

INK, SOFT, GRID = "#0c2431", "#4d6573", "#d5e0e5"


@contextmanager
def settings() -> Iterator[None]:
    """How all figures are drawn, whatever the user's matplotlibrc says."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(
            {
                "svg.hashsalt": "dream",
                "svg.fonttype": "path",
                "pdf.fonttype": 42,
                "font.size": 9.0,
                "axes.edgecolor": SOFT,
                "axes.labelcolor": SOFT,
                "axes.linewidth": 0.6,
                "axes.titlesize": 10.0,
                "axes.titlelocation": "left",
                "axes.titleweight": "bold",
                "axes.titlecolor": INK,
                "text.color": INK,
                "text.parse_math": False,
                "xtick.color": SOFT,
                "ytick.color": SOFT,
                "xtick.major.width": 0.6,
                "ytick.major.width": 0.6,
                "legend.frameon": False,
                "image.composite_image": False,
            }
        )
        yield


def svg(figure: Figure) -> bytes:
    """A figure as a picture that a page can hold."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=200, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def png(figure: Figure) -> bytes:
    """A figure as a file of its own."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=200, metadata={"Software": None})
    return buffer.getvalue()


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    """Inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    return figure, figure.add_subplot()


def east_north(site: Site | None, points: Float64Array) -> Float64Array:
    """(N, 2) metres east and north of the origin; the world's own where there is none."""
    if site is None:
        return points
    return np.column_stack(site.east_north(points[:, 0], points[:, 1]))


def show_map(
    axes: Axes,
    site: Site | None,
    box: Bounds,
    picture: npt.NDArray[Any],
    around: Float64Array,
    **options: Any,
) -> Any:
    """Draw a map, turned to the north, with its scale and arrow.

    Args:
        axes: That are drawn on.
        site: Where the world's frame lies; without one nothing is turned.
        box: What the picture shows, in that frame.
        picture: (rows, cols), the first row at the smallest y; or (rows, cols, 3) RGB.
        around: (N, 2) points of that frame that the sheet has to hold.
        options: Of matplotlib's `imshow`.
    """
    from matplotlib.transforms import Affine2D

    image = axes.imshow(
        picture,
        extent=(box.x_min, box.x_max, box.y_min, box.y_max),
        origin="lower",
        interpolation="nearest",
        zorder=1,
        **options,
    )
    heading = 0.0 if site is None else site.heading_deg
    # The world's y axis bears `heading` clockwise from north.
    image.set_transform(Affine2D().rotate_deg(-heading) + axes.transData)
    corners = east_north(site, around)
    (west, south), (east, north) = corners.min(axis=0), corners.max(axis=0)
    pad = 0.03 * max(east - west, north - south)
    axes.set_xlim(west - pad, east + pad)
    axes.set_ylim(south - pad, north + pad)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7.5, length=2.5)
    if site is None:
        axes.set_xlabel("x, metres", fontsize=8)
        axes.set_ylabel("y, metres", fontsize=8)
    else:
        axes.set_xlabel("metres east of the origin", fontsize=8)
        axes.set_ylabel("metres north of the origin", fontsize=8)
        north_arrow(axes)
    scale_bar(axes, east - west)
    return image


def corners_of(box: Bounds) -> Float64Array:
    """(4, 2) of a box."""
    return np.array(
        [
            (box.x_min, box.y_min),
            (box.x_max, box.y_min),
            (box.x_max, box.y_max),
            (box.x_min, box.y_max),
        ]
    )


def north_arrow(axes: Axes) -> None:
    """In the corner at the top right, of a sheet whose top is north."""
    axes.annotate(
        "N",
        xy=(0.965, 0.975),
        xytext=(0.965, 0.865),
        xycoords="axes fraction",
        ha="center",
        va="center",
        fontsize=9,
        weight="bold",
        arrowprops={"arrowstyle": "-|>,head_width=0.28,head_length=0.55", "color": INK, "linewidth": 1.2},
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
        zorder=8,
    )


def scale_bar(axes: Axes, width: float) -> None:
    """A bar of a round length, about a fifth of the map."""
    length = scale_length(width)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = left + 0.035 * (right - left), bottom + 0.035 * (top - bottom)
    thick = 0.010 * (top - bottom)
    axes.add_patch(
        _rectangle(x - 0.4 * thick, y - 0.4 * thick, length + 0.8 * thick, 5.2 * thick, "white", 0.75, 7.0)
    )
    axes.add_patch(_rectangle(x, y, length / 2.0, thick, INK, 1.0, 8.0))
    axes.add_patch(_rectangle(x + length / 2.0, y, length / 2.0, thick, "white", 1.0, 8.0))
    axes.text(
        x + length / 2.0, y + 1.6 * thick, f"{length:g} m", ha="center", va="bottom", fontsize=8, zorder=8
    )


def _rectangle(
    x: float, y: float, width: float, height: float, color: str, alpha: float, order: float
) -> Any:
    from matplotlib.patches import Rectangle

    edge = INK if alpha == 1.0 else "none"
    return Rectangle(
        (x, y), width, height, facecolor=color, edgecolor=edge, linewidth=0.6, alpha=alpha, zorder=order
    )


def scale_length(width: float) -> float:
    """1, 2 or 5 times a power of ten, at most a fifth of `width`."""
    most = width / 5.0
    power = 10.0 ** math.floor(math.log10(most))
    return next(power * step for step in (5.0, 2.0, 1.0) if power * step <= most * (1.0 + 1e-9))
