"""What observes and goes: simulated, replayed and real."""

from dream.robots.teleport import Teleport

__all__ = ["Teleport"]
