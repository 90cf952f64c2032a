"""A model that is none: a local server that reads the pictures it is sent and answers by rule.

It knows nothing of the map, the planner or the world. So a mission that it flies shows that the whole wire
works, from the drawing of a mark to the reading of a reply; it shows nothing of what a model can do.
"""

from dream.standin.server import serve


def address(fault: str = "") -> str:
    """Where the stand-in of this process listens, or one that errs; started when first asked for."""
    return serve(fault).address


__all__ = ["address", "serve"]
