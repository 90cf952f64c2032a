"""Coverage against the share of a model's answers that are wrong: draws what `perf/advice.py` has flown.

    python perf/errors.py                  results/wire → docs/wrong-answers.svg

The model is the stand-in, with a share of its answers replaced by random ones. That shows what wrong
answers do, never what a model can do.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from dream.evaluation.figures import Picture, Theme, look
from dream.protocol import DREAM_V1

PLANNERS = ("belief", "dream", "ranked")
ALONE = -1.0
"""In place of a share: `belief`, which asks nobody."""
MARKS = {"t98": "steps to 98.26 %", "stop": "steps to the own stop", "seen": "seen at the end, %"}


def curves(path: Path) -> dict[float, dict[str, npt.NDArray[np.float64]]]:
    """Missions in a file of `perf/advice.py`, by the share of wrong answers."""
    missions = [json.loads(line) for line in path.read_text().splitlines()]
    found: dict[float, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for mission in missions:
        adviser = mission["adviser"]
        share = ALONE if adviser == "belief" else float(adviser.partition("error:")[2] or 0.0)
        for mark in MARKS:
            value = 100.0 * mission[mark] if mark == "seen" else mission[mark]
            found[share][mark].append(value)
    return {
        share: {mark: np.array(values) for mark, values in marks.items()} for share, marks in found.items()
    }


def draw(flown: dict[str, dict[float, dict[str, npt.NDArray[np.float64]]]], theme: Theme) -> Figure:
    """A panel for each mark: the mean over the worlds, and every world as a dot."""
    figure = Figure(figsize=(9.6, 3.5), layout="constrained", facecolor=theme.ground)
    for axes, (mark, title) in zip(figure.subplots(1, len(MARKS)), MARKS.items(), strict=True):
        for offset, (planner, shares) in zip((-0.012, 0.012), flown.items(), strict=True):
            style = look(theme, PLANNERS, planner)
            at = sorted(share for share in shares if share >= 0.0)
            worlds = len(shares[at[0]][mark])
            for share in at:
                values = shares[share][mark]
                axes.plot(
                    np.full(len(values), share + offset), values, ".", color=style["color"], alpha=0.35, ms=5
                )
            means = [shares[share][mark].mean() for share in at]
            axes.plot(at, means, **style, marker="o", ms=4, label=f"{planner}, {worlds} reefs")
            alone = shares[ALONE][mark].mean()
            axes.plot([0.0, 1.0], [alone, alone], color=style["color"], linewidth=0.9, linestyle=(0, (2, 3)))
        axes.set_title(title)
        axes.set_xlabel("share of wrong answers")
        axes.set_ylim(0.0, 105.0 if mark == "seen" else 1.05 * DREAM_V1.cap)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def main() -> int:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--flown", type=Path, default=Path("results/wire"), help="ranked.jsonl and dream.jsonl"
    )
    parser.add_argument("--out", type=Path, default=Path("docs/wrong-answers.svg"))
    options = parser.parse_args()
    flown = {planner: curves(options.flown / f"{planner}.jsonl") for planner in ("ranked", "dream")}
    picture = Picture("wrong-answers", "Wrong answers", "", lambda theme: draw(flown, theme))
    options.out.write_bytes(picture.svg())
    print(f"written: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
