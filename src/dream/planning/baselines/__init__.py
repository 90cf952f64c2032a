"""Planners to compare with."""

from dream.planning.baselines.frontier import NearestFrontier
from dream.planning.baselines.graze import SweepAndGraze
from dream.planning.baselines.lawnmower import Lawnmower
from dream.planning.baselines.mutual_information import MutualInformation
from dream.planning.baselines.nbv import NextBestView
from dream.planning.baselines.random_walk import RandomWalk
from dream.planning.baselines.spiral import Spiral
from dream.planning.baselines.uivnav import UivNav

__all__ = [
    "Lawnmower",
    "MutualInformation",
    "NearestFrontier",
    "NextBestView",
    "RandomWalk",
    "Spiral",
    "SweepAndGraze",
    "UivNav",
]
