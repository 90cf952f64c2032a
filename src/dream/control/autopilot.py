"""Setpoint and estimate → thruster commands, at a fixed rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace

import numpy as np
import numpy.typing as npt

from dream.control import _kernels
from dream.geometry import SE3
from dream.vehicle import Hull, Thrusters

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Autopilot:
    """Follows a reference to the goal, by a velocity loop on a model of the vehicle.

    What it does: a reference goes straight to the goal, within limits of speed and acceleration. The paper's
    law (Eq. 9 to 11, `_kernels.track`) turns what the position lacks of that reference into a velocity, and
    takes off the velocity that is there (K_d = k_r = 1). A second loop turns the rest into a wrench, adds
    what acceleration and drag of the reference need by the model, and takes off what pushes the vehicle by
    its own account: all that the velocities fell short of until now. That push is held in the world, where a
    current stays when the vehicle turns, and drag is that of the way through such a current; what they fell
    short of on the way, along the model's drag, also corrects how much of that drag there is. Neither is
    learnt while a thruster saturates. Where the frame can, roll and pitch are brought back to level.

    Reference: Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control* (2011), chapters 10
    (reference models) and 12 (model-based PID, allocation); Slotine and Li, *Applied Nonlinear Control*
    (1991), chapter 8 (parameters that are learnt along the reference); DREAM (arXiv 2509.13666) for the outer
    loop.

    Assumes: an estimate at every beat, at 50 Hz or more.
    Fails when: thrusters lag by much more than a tenth of a second: the velocity loop then rings.
    """

    position: float = 2.5
    """1/s: m/s for a metre, K_p of the paper's law."""
    velocity: float = 6.0
    """1/s: m/s² for a m/s. Half of what a thruster's lag of 0.08 s would bear."""
    disturbance: float = 2.0
    """1/s²: how fast a push is learnt."""
    yaw: float = 4.0
    """1/s: rad/s for a radian, k_ψ of the paper's law."""
    yaw_rate: float = 8.0
    """1/s: rad/s² for a rad/s."""
    yaw_disturbance: float = 4.0
    """1/s²: as `disturbance`."""
    level: float = 16.0
    """1/s²: rad/s² for a radian of roll or pitch."""
    level_rate: float = 6.0
    """1/s: rad/s² for a rad/s."""
    drag_share: float = 0.5
    """Share of the model's drag that is fed forward. Published drags differ sevenfold: half of the largest is
    wrong by a factor of two or three either way, all of it by seven one way. The share is where it begins."""
    drag_learning: float = 16.0
    """How many times as fast as a push that share is learnt, at top speed. 0 keeps it."""
    speed: float = 0.5
    """m/s of the reference; less where the frame cannot pitch (`upright`)."""
    acceleration: float = 0.2
    """m/s²."""
    turn_rate: float = 1.0
    """rad/s."""
    turn_acceleration: float = 1.0
    """rad/s²."""
    ascent: float = 0.3
    """m/s straight up, where it has to surface."""

    def __post_init__(self) -> None:
        for gain in fields(self):
            if not 0.0 <= getattr(self, gain.name) < math.inf:
                raise ValueError(f"{gain.name}: expected 0 or more, got {getattr(self, gain.name)}")
        for name in ("speed", "acceleration", "turn_rate", "turn_acceleration", "ascent"):
            if getattr(self, name) == 0.0:
                raise ValueError(f"{name}: expected a limit above 0, got 0: it would never arrive")

    @property
    def gains(self) -> _kernels.Gains:
        """As the kernels take them."""
        return _kernels.Gains(*(float(getattr(self, gain.name)) for gain in fields(self)))

    def upright(self, hull: Hull, thrusters: Thrusters) -> Autopilot:
        """The same, but no faster than a vehicle bears that cannot pitch.

        That is half the speed at which it turns over: the other half is left for a current, and the moment
        of the water is a quarter of what rights it.
        """
        pitch = np.eye(6)[4]
        allocation = thrusters.allocation
        if np.allclose(allocation @ np.linalg.pinv(allocation) @ pitch, pitch, atol=1e-6):
            return self
        return replace(self, speed=min(self.speed, 0.5 * hull.overturning))

    def begin(self, hull: Hull, thrusters: Thrusters, T_world_base: SE3) -> Helm:
        """At the helm of a vehicle that rests there, `upright`.

        Args:
            hull: With the most drag that it may have: a share of that is learnt.
            thrusters: Of the vehicle.
            T_world_base: Where.
        """
        memory = _kernels.begin(
            T_world_base.translation.astype(np.float64), T_world_base.yaw, self.drag_share
        )
        return Helm(
            self.upright(hull, thrusters).gains, nominal(hull, thrusters), memory, np.zeros(thrusters.count)
        )


@dataclass(slots=True, eq=False)
class Helm:
    """`Autopilot` during one mission: what it remembers lives here."""

    gains: _kernels.Gains
    nominal: _kernels.Nominal
    memory: Float64Array
    """(14,) see the kernels."""
    commands: Float64Array
    """(n,) in [−1, 1], the last ones."""
    share: float = field(default=1.0)
    """Of the wrench, that the thrusters could give."""
    _error: Float64Array = field(default_factory=lambda: np.zeros(4))
    _power: tuple[float, float] = (0.0, 0.0)

    def steer(
        self,
        T_world_base: SE3,
        velocity: Float64Array,
        angular_velocity: Float64Array,
        goal: tuple[float, float, float, float],
        dt: float,
        *,
        pace: float = 1.0,
    ) -> Float64Array:
        """(n,) thruster commands in [−1, 1], for dt seconds.

        Args:
            T_world_base: Where it is, by the estimate.
            velocity: (3,) m/s over ground in the world, by the estimate.
            angular_velocity: (3,) rad/s in `base`.
            goal: x, y, z and yaw: metres in the world and radians.
            dt: Seconds since the last beat.
            pace: Share of its speeds that it may use.

        Raises:
            ValueError: Something is not finite. The commands stay what they were.
        """
        wrench = self.demand(T_world_base, velocity, angular_velocity, goal, dt, pace=pace)
        self.learn(_kernels.allocate(wrench, self.nominal, self.commands), dt)
        return self.commands.copy()

    def demand(
        self,
        T_world_base: SE3,
        velocity: Float64Array,
        angular_velocity: Float64Array,
        goal: tuple[float, float, float, float],
        dt: float,
        *,
        pace: float = 1.0,
    ) -> Float64Array:
        """(6,) N and N m in `base` that carry it along the reference, for whoever allocates them.

        Takes and refuses what `steer` does. `learn` has to follow, with what the thrusters could give of it.
        """
        target = np.array(goal, np.float64)
        for name, values in (
            ("goal", target),
            ("velocity", velocity),
            ("angular_velocity", angular_velocity),
        ):
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: expected finite numbers, got {values}. Is the estimate alive?")
        if not 0.0 < dt < 1.0:
            raise ValueError(f"dt: expected seconds above 0 and below 1, got {dt}. Is the loop alive?")
        acceleration = _kernels.guide(self.memory, target, self.gains, pace, dt)
        wrench, self._error, self._power = _kernels.wrench(
            self.memory,
            acceleration,
            np.ascontiguousarray(T_world_base.rotation, np.float64),
            np.ascontiguousarray(T_world_base.translation, np.float64),
            np.ascontiguousarray(velocity, np.float64),
            np.ascontiguousarray(angular_velocity, np.float64),
            self.gains,
            self.nominal,
        )
        return np.asarray(wrench, np.float64)

    def learn(self, share: float, dt: float) -> None:
        """Take what the velocities lacked at the last `demand` for a push, or for drag.

        Args:
            share: Of that wrench, what the thrusters can give. Of less than all of it nothing is learnt.
            dt: Seconds since the beat before.
        """
        self.share = share
        if share == 1.0:
            _kernels.blame(self.memory, self._error, self._power, self.gains, self.nominal, dt)

    @property
    def reference(self) -> tuple[float, float, float, float]:
        """x, y, z and yaw that it follows just now: metres in the world and radians."""
        x, y, z, yaw = self.memory[:4].tolist()
        return x, y, z, yaw

    @property
    def push(self) -> Float64Array:
        """(4,) what pushes the vehicle, by its account: N in the world, and N m about the vertical."""
        return self.memory[8:12].copy()

    @property
    def drag_share(self) -> tuple[float, float]:
        """How much of the model's drag the vehicle has, by its account: along its way, and in yaw."""
        return float(self.memory[12]), float(self.memory[13])


def nominal(hull: Hull, thrusters: Thrusters) -> _kernels.Nominal:
    """A vehicle as the kernels take it."""
    commands, roots = thrusters.points
    return _kernels.Nominal(
        np.array([hull.mass] * 3 + list(hull.moments), np.float64) + np.array(hull.added, np.float64),
        np.array(hull.linear, np.float64),
        np.array(hull.quadratic, np.float64),
        float(hull.net_buoyancy),
        np.ascontiguousarray(np.linalg.pinv(thrusters.allocation)),
        commands,
        roots,
        least=np.full(thrusters.count, -roots[0] * roots[0]),
        most=np.full(thrusters.count, roots[-1] * roots[-1]),
        held=np.zeros(thrusters.count),
    )
