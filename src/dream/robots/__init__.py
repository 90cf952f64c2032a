"""What observes and goes: simulated, replayed and real."""

from dream.robots.simulated import Motion, Simulated
from dream.robots.teleport import Teleport

__all__ = ["Motion", "Simulated", "Teleport"]
