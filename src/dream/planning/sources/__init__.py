"""Reasons to look somewhere: the planner `belief` is a list of them."""

from dream.planning.sources.beside import TargetsBeside
from dream.planning.sources.hidden import AllGround, HiddenGroups
from dream.planning.sources.hints import HintedTargets
from dream.planning.sources.hull import HullSurface
from dream.planning.sources.source import BeliefSource, Expected, Situation, Way, Words, Worth
from dream.planning.sources.survey import ForetoldTargets
from dream.planning.sources.traversal import TargetsToTraverse

__all__ = [
    "AllGround",
    "BeliefSource",
    "Expected",
    "ForetoldTargets",
    "HiddenGroups",
    "HintedTargets",
    "HullSurface",
    "Situation",
    "TargetsBeside",
    "TargetsToTraverse",
    "Way",
    "Words",
    "Worth",
]
