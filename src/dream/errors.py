"""Our own exceptions: only where a caller handles one differently."""


class MissionAborted(Exception):  # noqa: N818 - it names what happened, as KeyboardInterrupt does.
    """A mission ended before its planner or its cap ended it; what was flown is on disk."""
