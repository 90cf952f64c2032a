"""What one survey found: measures, individuals, patches, maps, and the way they were got.

A `Survey` holds all that products, the archive and comparisons need; the run folder is not looked at again,
except for an orthomosaic. Positions are in the run's own `world` (east-north-up, metres) until a `Site` says
where on earth that is.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.survey.site import Site
from dream.types import BoolArray, Reasoning, Target

Float64Array = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]

DAYS_A_YEAR = 365.25
DIVE = "dive"
"""The `world` in `made_by` of older surveys of dives in real water; newer ones have none."""


@dataclass(frozen=True, slots=True)
class Measure:
    """One figure with its 95 % interval."""

    name: str
    """Such as `reef_area`, `density`, `median_size`, `reef_height`."""
    value: float | None
    """None where it could not be measured; `note` says why."""
    low: float | None
    high: float | None
    unit: str
    """Such as `m2`, `1/m2`, `m`; empty for a share."""
    note: str = ""
    """How it was got, or why it was not."""


@dataclass(frozen=True, slots=True, eq=False)
class Individuals:
    """N individuals that were found, each once. Arrays share their first axis.

    They are fewer than there are: one that lies under or hard beside another has no row. How many there
    are is the measure `count`, an estimate.
    """

    position: Float64Array
    """(N, 3) metres in the world, the middle of each at its highest."""
    sigma: Float64Array
    """(N,) metres, standard error of the position over ground, pose errors included."""
    size: Float64Array
    """(N,) metres across, the longest diameter; the mean of those that stand clear where one does not."""
    size_sigma: Float64Array
    """(N,) metres, standard error."""
    hits: npt.NDArray[np.int32]
    """(N,) frames in which it was found."""
    looks: npt.NDArray[np.int32]
    """(N,) frames in which it could have been."""
    confidence: Float64Array
    """(N,) probability that it is one."""
    patch: npt.NDArray[np.int32]
    """(N,) index into `Survey.patches`; −1 for none."""
    clear: BoolArray
    """(N,) its size was measured: it stands clear of others, was seen near enough, and is likelier one than
    not."""

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """One patch of reef, or the outline of a wreck or of a piece of its debris."""

    rings: tuple[Float64Array, ...]
    """(K, 2) each, metres in the world, closed (first point = last); the first is the outline,
    counter-clockwise, the others its holes, clockwise."""
    measures: tuple[Measure, ...]
    """Of it: `area`, `length`, `width`, `height`, `rugosity`, `density`, `count`, as far as they apply."""


OPEN, SEEN = 0, 1
"""Values of `Cells.state`: unknown, where the surface may go on; known and not inspected. Each side that a
cell was inspected from adds one to `SEEN`."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The surface of a structure, cube by cube, and where it may go on. Arrays share their first axis."""

    position: Float64Array
    """(n, 3) middles, metres in the world."""
    side: npt.NDArray[np.uint8]
    """(n,) index into `SurveyedStructure.sides`."""
    state: npt.NDArray[np.uint8]
    """(n,) `OPEN`, `SEEN`, or from how many sides it was inspected, and one."""


@dataclass(frozen=True, slots=True)
class StructureSide:
    """One side of a structure."""

    kind: str
    """`side` along its long axis, `end` of that, `top` or `underside`."""
    bearing: float | None
    """That it looks in, radians in the world; None of top and underside."""
    measures: tuple[Measure, ...]
    """Of it: `known_surface`, `inspected_share`, `open_area`, `looked_from`."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedStructure:
    """What stands on the ground, of a mission that moved in three dimensions."""

    axis: float
    """Direction of its long axis, radians in (−π/2, π/2]."""
    measures: tuple[Measure, ...]
    """Of it: `height`, `known_surface`, `inspected_share`, `open_area`."""
    sides: tuple[StructureSide, ...]
    cells: Cells
    cell: float
    """Metres a side."""


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Maps on one grid: `cells[row, col]`, row grows with y, col with x, the first cell at the lower left."""

    bounds: Bounds
    """Whole numbers of cells."""
    cell: float
    """Metres."""
    state: npt.NDArray[np.uint8]
    """(rows, cols) 0 unknown, 1 explored, 2 target, 3 solid, 4 solid target (a wreck)."""
    target_probability: Float32Array
    """(rows, cols) NaN where nothing was seen."""
    relief: Float32Array
    """(rows, cols) metres above the bare seabed around it; NaN where nothing was seen."""
    times_seen: npt.NDArray[np.uint16]
    """(rows, cols) frames that saw it within reach."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What covers the ground, fine enough to show an individual: on a grid as that of `Layers`."""

    bounds: Bounds
    """Whole numbers of cells; what is far from any target is left out."""
    cell: float
    """Metres."""
    share: npt.NDArray[np.uint8]
    """(rows, cols) share of the views that took it for target, in steps of 1/200; 255 where not seen."""


def under(points: Float64Array, cells: npt.NDArray[Any], bounds: Bounds, cell: float, beyond: Any) -> Any:
    """(N,) values of the cells under points.

    Args:
        points: (N, 2) x and y in the grid's world.
        cells: (rows, cols) on a grid as that of `Layers`.
        bounds: Of the grid.
        cell: Metres.
        beyond: Value outside the grid.
    """
    col = np.floor((points[:, 0] - bounds.x_min) / cell).astype(np.intp)
    row = np.floor((points[:, 1] - bounds.y_min) / cell).astype(np.intp)
    rows, cols = cells.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    found = np.full(len(points), beyond, cells.dtype)
    found[inside] = cells[row[inside], col[inside]]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where the vehicle was, one row a step."""

    time: Float64Array
    """(S,) seconds since the mission started."""
    position: Float64Array
    """(S, 3) metres in the world."""
    yaw: Float64Array
    """(S,) radians."""
    sigma: Float64Array
    """(S,) metres by which the position may err."""


@dataclass(frozen=True, slots=True)
class DecisionPoint:
    """What was decided at a step, where it led, and why."""

    step: int
    time: float
    x: float
    y: float
    yaw: float
    """Where the step ended, metres and radians."""
    turn: float
    advance: float
    reasoning: Reasoning
    note: str = ""
    """What the guard changed or what was wrong on the way."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """One mission as a monitor reads it."""

    name: str
    """That of the run folder."""
    began: datetime
    """With its time zone. In a simulated world that is some years on, as much later than it was flown."""
    site: Site | None
    """None where the run had no origin: measures hold all the same, products on the globe do not."""
    target: Target
    protocol: str
    area: Bounds
    """The operator's box."""
    measures: tuple[Measure, ...]
    individuals: Individuals
    patches: tuple[Patch, ...]
    layers: Layers
    track: Track
    decisions: tuple[DecisionPoint, ...]
    made_by: dict[str, Any]
    """Version, commit, planner, world and seed where simulated, and by how many years that world is on; the
    parameters of the measuring, by what is known when it `began`, and what the run said of that and its site
    where somebody `corrected` it."""
    picture: Picture | None = None
    """None of a survey without, which can be compared less sharply."""
    structures: tuple[SurveyedStructure, ...] = ()
    """The largest first; none of a mission in the plane."""

    @property
    def simulated(self) -> bool:
        """No camera has seen it."""
        return self.made_by.get("world") not in (None, "", DIVE)

    @property
    def years_on(self) -> float:
        """Simulated years by which it `began` later than it was flown; 0 of all others."""
        years = self.made_by.get("years_on")
        return float(years) if isinstance(years, int | float) and self.simulated else 0.0

    @property
    def calibration(self) -> Any:
        """By which its individuals were counted and sized; None in files of older versions."""
        measuring = self.made_by.get("measuring")
        return measuring.get("calibration") if isinstance(measuring, dict) else None

    @property
    def tells_clear(self) -> bool:
        """Does it say whose sizes were measured? Files of version 1 told sizes, but not whose."""
        sized = any(one.name == "median_size" and one.value is not None for one in self.measures)
        return not sized or bool(self.individuals.clear.any())

    @property
    def run(self) -> str | None:
        """SHA-256 of the run's steps, which its copies share; None in files of older versions."""
        digest = self.made_by.get("run")
        return digest if isinstance(digest, str) else None
