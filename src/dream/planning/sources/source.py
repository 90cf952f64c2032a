"""What a source of belief is given, what it adds to, and what it may be asked."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.mapping.completion import Completion
from dream.planning.distribution import OBSERVED, Calibration, Groups, TargetEvidence
from dream.planning.failed_views import FailedViews
from dream.planning.lookahead import Plan, Prospect
from dream.planning.pose_views import Listed, PoseViews
from dream.planning.travel import Travel, careful_standoff, careful_travel, travel_from
from dream.types import BoolArray, Float32Array, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]

LEAVE = 0.015
"""Share of the targets, seen and foretold or hinted at, that may be left."""
MOST_VISITS = 3
"""Of a pose without anything new: then what it headed for is given up; after twice as many, leftovers too."""


@dataclass(eq=False)
class Situation:
    """What one step has to go by. What is worked out of it is kept."""

    observation: Observation
    occupancy: OccupancyMap
    here: Pose
    """Where the vehicle is, on the lattice."""
    pose_views: PoseViews
    """What each pose shows."""
    failed: FailedViews
    foretold: BoolArray | None = None
    """(rows, cols) what is held to be solid beside what the map knows; a source may set it."""
    away_from_hull: FloatArray | None = None
    """(rows, cols) metres to the nearest target that stands up; None where a source knows of no hull."""

    @cached_property
    def travel(self) -> Travel:
        """Ways over known free ground. Beside a hull every place counts that the guard allows."""
        search = careful_travel if self.away_from_hull is None else travel_from
        return search(self.observation.pose, self.occupancy)

    @cached_property
    def moves(self) -> npt.NDArray[np.uint8]:
        """See `PoseViews.moves`."""
        standoff = careful_standoff(self.occupancy.protocol)
        return self.pose_views.moves(self.travel.free, self.occupancy, standoff, self.foretold)

    @cached_property
    def completion(self) -> Completion:
        """By the rule that judges every planner."""
        from dream.mapping import check_completion

        return check_completion(self.occupancy, self.observation.pose)

    @cached_property
    def places(self) -> BoolArray:
        """(rows, cols) cells that the vehicle might get to, for all that is known."""
        from scipy.ndimage import label

        occupancy, protocol, pose = self.occupancy, self.occupancy.protocol, self.observation.pose
        room = occupancy.distance_to_solid >= protocol.body_radius + 0.5 * protocol.cell
        row, col = occupancy.cell_of(pose.x, pose.y)
        room[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = True
        parts, _ = label(room, np.ones((3, 3)))
        return np.asarray(parts == parts[row, col])

    @cached_property
    def near_places(self) -> BoolArray:
        """(rows, cols) cells within reach of such a place."""
        from dream.mapping import within

        return within(self.places, self.occupancy.protocol.reach, self.occupancy.protocol.cell)

    @cached_property
    def near_unseen_places(self) -> BoolArray:
        """(rows, cols) cells within reach of such a place that was not observed itself."""
        from dream.mapping import within

        unseen, protocol = self.places & ~self.occupancy.observed, self.occupancy.protocol
        return within(unseen, protocol.reach, protocol.cell)

    def hopeful(self, middles: BoolArray, radius: float) -> BoolArray:
        """(rows, cols) those of some middles, of groups so many metres wide, that may yet come into view.

        Where the mission may end, what no known place can see is left out: behind a wall, say. Places that
        the vehicle might yet get to may see more than that; only elsewhere it is asked.
        """
        from dream.mapping import that_would_show

        if not self.completion.seen:
            return middles
        hopeful = self.near_unseen_places
        asked = middles & ~hopeful
        return middles & (hopeful | that_would_show(self.occupancy, self.observation.pose, radius, asked))


@dataclass(slots=True, eq=False)
class Expected:
    """What is believed, over the cells of the map; each source adds to it in turn."""

    evidence: TargetEvidence
    """What beliefs about targets rest on."""
    beside: Float32Array
    """(rows, cols) probability of a target beside known ones."""
    likely: Float32Array
    """(rows, cols) the same, by which views are chosen: an earlier survey may tell more."""
    hiding: BoolArray
    """(rows, cols) middles of groups that would not have been noticed."""
    unnoticed: Float32Array
    """(rows, cols) probability that a group there would not have been noticed."""
    groups: Groups
    """How many there are."""
    accepted: float
    """Risk at which the mission may end."""
    hinted: float = 0.0
    """Square metres of targets, where some were hinted at beyond the reach and nothing was observed yet."""
    hidden: float = 0.0
    """Square metres on which the middle of a group could lie."""
    probability: float = 0.0
    """That there is such a group, as the model has it."""
    calibration: Calibration = OBSERVED
    """How often that comes true."""
    rarity: float = 1.0
    """How many times as many groups are to be expected where an earlier survey saw none."""
    hull: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(n,) patches to be expected in each element of the hull."""
    hull_left: float = 0.0
    """Share of the hull that is still unseen."""
    looked_over: bool = True
    """No more of a hull is unseen than may be."""

    @property
    def risk(self) -> float:
        """Probability that there is a group that would not have been noticed, by how often that came true."""
        return self.calibration.calibrated(self.probability)

    @property
    def searched(self) -> bool:
        """The risk is accepted."""
        return self.risk <= self.accepted

    @property
    def to_come(self) -> float:
        """Groups to be expected in ground that was not searched."""
        return self.groups.intensity * self.hidden


@dataclass(slots=True, eq=False)
class Worth:
    """What seeing something is worth, in square metres of targets; some count more than once."""

    ground: FloatArray
    """(rows, cols) of each cell."""
    search: float
    """Of each square metre where the middle of a group could lie, ..."""
    share: FloatArray
    """(rows, cols) ... times this."""
    listed: Listed | None = None
    """Elements beside the ground."""


@dataclass(frozen=True, slots=True)
class Words:
    """What a source adds to the first three steps of the reasoning."""

    distribution: str = ""
    target_area: str = ""
    """In the place of what would be said."""
    completion: str = ""


@dataclass(frozen=True, slots=True)
class Way:
    """Where to go, and why; without a plan, why the mission should end."""

    travel: Travel
    plan: Plan | None
    why: str


class BeliefSource:
    """One reason to look somewhere. What a source does not say, it has no part in.

    A planner hands a situation to each source in turn (`take`), asks each what it expects, then for words,
    and where to go: for an errand, for weights, and for a tour.
    """

    def take(self, situation: Situation) -> None:
        """Learn from what is new. Only `observation`, `occupancy`, `here` and `pose_views` are there yet."""

    def expect(self, expected: Expected, situation: Situation) -> None:
        """Add what it believes, after the sources before it."""

    def certainty(self, expected: Expected, situation: Situation) -> tuple[str, str] | None:
        """How certain it is that all was seen, and the same as models are told it.

        Of several sources the last one has the word.
        """
        return None

    def words(self, expected: Expected, situation: Situation) -> Words:
        """What it adds to the reasoning."""
        return Words()

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        """Add what there is to see by it."""

    def errand(
        self, situation: Situation, travel: Travel, moves: npt.NDArray[np.uint8], visits: int
    ) -> Way | None:
        """What has to be done before anything else is looked for.

        Args:
            situation: Of this step.
            travel: Known ways.
            moves: See `PoseViews.moves`; of these ways.
            visits: How often the vehicle has been here since anything was new.
        """
        return None

    def tour(self, expected: Expected, situation: Situation, prospect: Prospect) -> Way | None:
        """The way round all that is left, where it is known what that is."""
        return None

    def enough(self, expected: Expected, situation: Situation) -> bool:
        """Nothing more has to be searched for, though ground is left to search."""
        return False

    def found(self) -> int:
        """A number that grows when anything of its own was new."""
        return 0

    def give_up(self, pose: Pose) -> None:
        """Hope for nothing more from a pose."""

    def try_again(self) -> bool:
        """A `done` was refused: look again at what was given up; is there any?"""
        return False
