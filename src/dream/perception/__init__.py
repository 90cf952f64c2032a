"""Pixels → Observation."""

from dream.perception.depth import Account, DepthModel, Perceived, Perception, Segmenter
from dream.perception.flat_floor import FlatFloor
from dream.perception.learned import LearnedDepth, LearnedLabels
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

__all__ = [
    "Account",
    "DepthModel",
    "FlatFloor",
    "LearnedDepth",
    "LearnedLabels",
    "Perceived",
    "Perception",
    "PointSets",
    "Segmenter",
    "Shells",
    "Sidecar",
    "free_points",
    "obstacle_points",
    "partition",
    "read_sidecar",
    "target_points",
    "valid_depth",
    "valid_points",
]
