"""A vision-language model, asked over the wire, decides or advises."""

from dream.planning.vlm.paper import Dream, Vanilla
from dream.planning.vlm.ranked import Ranked

__all__ = ["Dream", "Ranked", "Vanilla"]
