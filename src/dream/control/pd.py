"""Eq. 9 to 11 of the paper, corrected: where it is and where it should be → body velocity."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from dream.control import _kernels
from dream.geometry import SE2, wrap_angle
from dream.types import BodyVelocity, Setpoint


@dataclass(frozen=True, slots=True)
class Pd:
    """The paper's tracking law in the plane.

    What it does: turns the error of the position from the world into the body by the heading that is
    estimated, and asks for velocities in proportion to it, less some of those it has:
    e_p = R(ψ̂)ᵀ (p* − p̂), [u, v] = K_p e_p − K_d [û, v̂], r = k_ψ ψ̃ − k_r r̂, with ψ̃ = ψ* − ψ̂ wrapped.
    Heave belongs to the depth hold. `Autopilot` follows its moving reference by the same kernel.

    Reference: DREAM (arXiv 2509.13666). It prints R(ψ̃), the heading error, in place of R(ψ̂): then a vehicle
    that has turned to where it should look is driven as if it headed east, and away from its goal wherever
    it heads west.

    Assumes: whatever carries the command out regulates velocity over ground. Where the command acts as a
    force, a current pushes the vehicle off by drag over gain; see `Autopilot`.
    Fails when: the gain is large for the lag of what carries it out.
    """

    K_p: float = 0.8
    """1/s: metres a second for a metre of error."""
    K_d: float = 0.2
    """Share of the velocity that is taken off."""
    k_psi: float = 1.0
    """1/s: radians a second for a radian of error."""
    k_r: float = 0.2
    """Share of the yaw rate that is taken off."""

    def __post_init__(self) -> None:
        for gain in fields(self):
            if not 0.0 <= getattr(self, gain.name) < math.inf:
                raise ValueError(f"{gain.name}: expected a gain of 0 or more, got {getattr(self, gain.name)}")

    def track(self, pose: SE2, velocity: BodyVelocity, setpoint: Setpoint) -> BodyVelocity:
        """What to do now.

        Args:
            pose: Where it is, by the estimate.
            velocity: What it does over ground, by the estimate.
            setpoint: Where it should be.
        """
        e_x, e_y = _kernels.into_body(pose.yaw, setpoint.x - pose.x, setpoint.y - pose.y)  # Eq. 9
        turn = wrap_angle(setpoint.yaw - pose.yaw)
        return BodyVelocity(
            surge=_kernels.track(e_x, velocity.surge, 0.0, self.K_p, self.K_d),  # Eq. 10
            sway=_kernels.track(e_y, velocity.sway, 0.0, self.K_p, self.K_d),
            heave=0.0,
            yaw_rate=_kernels.track(turn, velocity.yaw_rate, 0.0, self.k_psi, self.k_r),  # Eq. 11
        )
