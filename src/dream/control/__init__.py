"""Decision → Setpoint → BodyVelocity."""

from dream.control.guard import guard
from dream.control.setpoints import setpoint

__all__ = ["guard", "setpoint"]
