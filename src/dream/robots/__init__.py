"""What observes and goes: simulated, replayed and real."""

from dream.robots.anchored import Anchored, Anchoring
from dream.robots.simulated import Motion, Simulated
from dream.robots.swimming import Swimming
from dream.robots.teleport import Teleport

__all__ = ["Anchored", "Anchoring", "Motion", "Simulated", "Swimming", "Teleport"]
