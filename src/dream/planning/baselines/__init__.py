"""Planners to compare with."""

from dream.planning.baselines.lawnmower import Lawnmower
from dream.planning.baselines.random_walk import RandomWalk

__all__ = ["Lawnmower", "RandomWalk"]
