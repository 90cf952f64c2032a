"""Observation → Map."""

from dream.mapping.completion import (
    Completion,
    Region,
    check_completion,
    could_hide,
    hiding_places,
    that_would_show,
    to_traverse,
    traversal_margin,
)
from dream.mapping.drawing import draw_map
from dream.mapping.frontiers import Frontier, frontiers
from dream.mapping.gain import gain, visible_weight
from dream.mapping.lattice import free_moves, reachable
from dream.mapping.layers import Evidence, Layers
from dream.mapping.nearness import within
from dream.mapping.occupancy import OccupancyMap
from dream.mapping.visibility import view

__all__ = [
    "Completion",
    "Evidence",
    "Frontier",
    "Layers",
    "OccupancyMap",
    "Region",
    "check_completion",
    "could_hide",
    "draw_map",
    "free_moves",
    "frontiers",
    "gain",
    "hiding_places",
    "reachable",
    "that_would_show",
    "to_traverse",
    "traversal_margin",
    "view",
    "visible_weight",
    "within",
]
