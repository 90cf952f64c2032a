"""Pixels → Observation."""

from dream.perception.depth import Account, DepthModel, Perceived, Perception, Segmenter
from dream.perception.flat_floor import FlatFloor
from dream.perception.learned import LearnedDepth, LearnedLabels
from dream.perception.parallax import Parallax
from dream.perception.points import (
    PointSets,
    free_points,
    obstacle_points,
    partition,
    target_points,
    valid_depth,
    valid_points,
)
from dream.perception.shells import Shells
from dream.perception.sidecar import Sidecar, read_sidecar
from dream.perception.sight import Sight
from dream.perception.view import View, beam_ends

__all__ = [
    "Account",
    "DepthModel",
    "FlatFloor",
    "LearnedDepth",
    "LearnedLabels",
    "Parallax",
    "Perceived",
    "Perception",
    "PointSets",
    "Segmenter",
    "Shells",
    "Sidecar",
    "Sight",
    "View",
    "beam_ends",
    "free_points",
    "obstacle_points",
    "partition",
    "read_sidecar",
    "target_points",
    "valid_depth",
    "valid_points",
]
