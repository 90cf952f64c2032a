"""Pixels → Observation."""

from dream.perception.points import (
    PointSets,
    free_points,
    obstacle_points,
    partition,
    target_points,
    valid_depth,
    valid_points,
)

__all__ = [
    "PointSets",
    "free_points",
    "obstacle_points",
    "partition",
    "target_points",
    "valid_depth",
    "valid_points",
]
