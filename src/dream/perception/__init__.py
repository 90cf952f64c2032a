"""Pixels → Observation."""

from dream.perception.depth import DepthModel, Perception, Segmenter
from dream.perception.flat_floor import FlatFloor
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

__all__ = [
    "DepthModel",
    "FlatFloor",
    "Perception",
    "PointSets",
    "Segmenter",
    "Shells",
    "free_points",
    "obstacle_points",
    "partition",
    "target_points",
    "valid_depth",
    "valid_points",
]
