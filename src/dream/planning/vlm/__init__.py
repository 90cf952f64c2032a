"""A vision-language model, asked over the wire, decides or advises."""

from dream.planning.vlm.paper import Dream, Vanilla

__all__ = ["Dream", "Vanilla"]
