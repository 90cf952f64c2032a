"""A model that is none: a local server that reads the pictures it is sent and answers by rule."""

from __future__ import annotations


def address(fault: str = "") -> str:
    """Where the stand-in of this process listens; started when first asked for.

    Args:
        fault: How it errs, such as `random` or `slow:2`; see `faults`. Not at all where empty.

    Raises:
        ValueError: There is no such fault.
    """
    from dream.standin.server import server

    return server(fault).address
