"""Observation, Map → Decision."""

from dream.planning.baselines import (
    Lawnmower,
    NearestFrontier,
    NextBestView,
    RandomWalk,
    Spiral,
    SweepAndGraze,
)
from dream.planning.belief import Belief
from dream.planning.sixsteps import SixSteps
from dream.planning.vlm import Asking, Dream, Ranked, Vanilla

AnyPlanner = (
    Belief
    | SixSteps
    | Lawnmower
    | Spiral
    | NearestFrontier
    | NextBestView
    | SweepAndGraze
    | RandomWalk
    | Dream
    | Vanilla
    | Ranked
)

PLANNERS: dict[str, AnyPlanner] = {
    "belief": Belief(),
    "sixsteps": SixSteps(),
    "lawnmower": Lawnmower(),
    "spiral": Spiral(),
    "frontier": NearestFrontier(),
    "nbv": NextBestView(),
    "sweep-and-graze": SweepAndGraze(),
    "random": RandomWalk(),
    "dream": Dream(),
    "vanilla": Vanilla(),
    "ranked": Ranked(),
}
"""Every planner by its name on the command line, with its default parameters. The first is the default."""

OFFLINE: tuple[str, ...] = tuple(
    name for name, planner in PLANNERS.items() if not isinstance(planner, Asking)
)
"""Names of those that ask no model and need nothing but this machine."""

__all__ = [
    "OFFLINE",
    "PLANNERS",
    "AnyPlanner",
    "Asking",
    "Belief",
    "Dream",
    "Lawnmower",
    "NearestFrontier",
    "NextBestView",
    "RandomWalk",
    "Ranked",
    "SixSteps",
    "Spiral",
    "SweepAndGraze",
    "Vanilla",
]
