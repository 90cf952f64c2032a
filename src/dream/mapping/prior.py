"""What an earlier survey holds of the ground that a mission is to map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dream import arrays
from dream.geometry import Bounds
from dream.types import BoolArray, Float32Array

MOST_YEARS = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """An earlier survey on the cells of a map: `cells[row, col]`, row grows with y, col with x.

    It is a report of how things were, not of how they are: what it says was empty was not seen now.
    """

    bounds: Bounds
    """Those of the map."""
    cell: float
    """Metres."""
    target: Float32Array
    """(rows, cols) probability that the cell was target; NaN where the survey saw nothing."""
    solid: BoolArray
    """(rows, cols) something stood there."""
    sigma: float = 0.0
    """Metres by which its positions may err against those of the mission, one standard deviation."""
    years: float = 1.0
    """Its age."""
    source: str = "an earlier survey"
    """What it is called in a sentence."""

    def __post_init__(self) -> None:
        shape = round(self.bounds.depth / self.cell), round(self.bounds.width / self.cell)
        for name in ("target", "solid"):
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"prior: {name}: expected {shape}, a cell for each {self.cell:g} m of the bounds, "
                    f"got {getattr(self, name).shape}"
                )
        known = self.target[~np.isnan(self.target)]
        if known.size and not (known.min() >= 0.0 and known.max() <= 1.0):
            raise ValueError("prior: target: expected probabilities from 0 to 1 or NaN, got others")
        if not (math.isfinite(self.sigma) and self.sigma >= 0.0):
            raise ValueError(f"prior: sigma: expected 0 m or more, got {self.sigma}")
        if not 0.0 <= self.years <= MOST_YEARS:
            raise ValueError(f"prior: years: expected 0 to {MOST_YEARS:g}, got {self.years}")

    @property
    def seen(self) -> BoolArray:
        """(rows, cols) cells of which the survey knows anything."""
        known: BoolArray = ~np.isnan(self.target)
        return known

    def check_fits(self, bounds: Bounds, cell: float) -> None:
        """Raise a ValueError unless it is on the cells of a map with those bounds."""
        if self.bounds != bounds or self.cell != cell:
            raise ValueError(
                f"prior: expected the map's {bounds} in cells of {cell:g} m, got {self.bounds} "
                f"in cells of {self.cell:g} m. Was it made for another area?"
            )

    def as_dict(self) -> dict[str, Any]:
        """What is recorded of it beside its cells."""
        area = self.cell**2 * float(np.count_nonzero(self.seen))
        return {"source": self.source, "years": self.years, "sigma": self.sigma, "seen_m2": round(area, 2)}

    def save(self, path: Path) -> None:
        """Write its cells to an .npz file."""
        with path.open("wb") as file:
            np.savez_compressed(file, target=self.target, solid=self.solid)

    @staticmethod
    def load(path: Path, about: dict[str, Any], bounds: Bounds, cell: float) -> Prior:
        """Read what `save` wrote, with what `as_dict` told.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is damaged, or of another map.
        """
        shape = round(bounds.depth / cell), round(bounds.width / cell)
        with arrays.opened(path, "what a mission was told of an earlier survey") as cells:
            for name, kinds in (("target", "f"), ("solid", "biu")):
                header = cells.headers.get(name)
                if header is None or header.shape != shape or header.dtype.kind not in kinds:
                    raise ValueError(f"{name}: expected {shape} cells, got {header and header[:2]}")
            target, solid = cells["target"].astype(np.float32), cells["solid"].astype(np.bool_)
            try:
                sigma, years, source = float(about["sigma"]), float(about["years"]), str(about["source"])
            except (KeyError, TypeError, OverflowError) as error:
                raise ValueError(f"what is recorded of it lacks {error}") from error
            return Prior(bounds, cell, target, solid, sigma, years, source)
