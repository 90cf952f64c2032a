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

AnyPlanner = (
    Belief | SixSteps | Lawnmower | Spiral | NearestFrontier | NextBestView | SweepAndGraze | RandomWalk
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
}
"""Every planner by its name on the command line, with its default parameters. The first is the default."""

__all__ = [
    "PLANNERS",
    "AnyPlanner",
    "Belief",
    "Lawnmower",
    "NearestFrontier",
    "NextBestView",
    "RandomWalk",
    "SixSteps",
    "Spiral",
    "SweepAndGraze",
]
