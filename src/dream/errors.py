"""Our own exceptions: only where a caller handles one differently."""


class MissionAborted(Exception):  # noqa: N818 - it names what happened, as KeyboardInterrupt does.
    """A mission or a probe ended before its time, or came to nothing; the message says what of it is kept."""


class PlannerFailed(Exception):  # noqa: N818 - likewise.
    """A planner cannot be used, failed, or decided what the protocol forbids; names its file and line."""
