"""Reasons to look somewhere: the planner `belief` is a list of them."""

from dream.planning.sources.beside import TargetsBeside
from dream.planning.sources.hidden import Certificate, HiddenGroups
from dream.planning.sources.hints import Hints
from dream.planning.sources.hull import HullSurface
from dream.planning.sources.source import Expected, Scene, Source, Way, Words, Worth
from dream.planning.sources.survey import Survey
from dream.planning.sources.traversal import Traversal

__all__ = [
    "Certificate",
    "Expected",
    "HiddenGroups",
    "Hints",
    "HullSurface",
    "Scene",
    "Source",
    "Survey",
    "TargetsBeside",
    "Traversal",
    "Way",
    "Words",
    "Worth",
]
