"""Decision → Setpoint → BodyVelocity (`Pd`), or thruster commands (`autopilot`)."""

from dream.control.guard import guard
from dream.control.pd import Pd
from dream.control.setpoints import setpoint

__all__ = ["Pd", "guard", "setpoint"]
