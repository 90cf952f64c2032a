"""A vision-language model, asked over the wire, decides or advises."""

from dream.planning.vlm.asking import WIRE_TEST, Asking, stands_in
from dream.planning.vlm.paper import Dream, Vanilla
from dream.planning.vlm.ranked import Ranked

__all__ = ["WIRE_TEST", "Asking", "Dream", "Ranked", "Vanilla", "stands_in"]
