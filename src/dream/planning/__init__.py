"""Observation, Map → Decision."""

from dream.planning.baselines import Lawnmower, RandomWalk
from dream.planning.sixsteps import SixSteps

AnyPlanner = SixSteps | Lawnmower | RandomWalk

PLANNERS: dict[str, AnyPlanner] = {
    "sixsteps": SixSteps(),
    "lawnmower": Lawnmower(),
    "random": RandomWalk(),
}
"""Every planner by its name on the command line, with its default parameters. The first is the default."""

__all__ = ["PLANNERS", "AnyPlanner", "Lawnmower", "RandomWalk", "SixSteps"]
