"""State, commands → the state a moment later: a vehicle with six degrees of freedom in moving water.

The equations are Fossen's (*Handbook of Marine Craft Hydrodynamics and Motion Control*, 2011, chapters 3 and
6 to 8), in forward-left-up and east-north-up axes. `base` has its origin in the centre of gravity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3
from dream.sim.sampling import uniform
from dream.sim.vehicle import _kernels
from dream.sim.vehicle.disturbances import STILL, Current, Tether
from dream.vehicle import VECTORED, VECTORED_6DOF, Hull, Thrusters
from dream.vehicle.hull import Six

Float64Array = npt.NDArray[np.float64]

WATER_DENSITY = 1000.0
"""kg/m³, fresh water, which the parameter sets below were found in."""


class Diverged(ArithmeticError):  # noqa: N818 - it names what happened.
    """The motion is finite no more: the step is too long, or a parameter is wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where a vehicle is, how it moves, and what its thrusters give."""

    position: Float64Array
    """(3,) metres in the world."""
    wxyz: Float64Array
    """(4,) `R_world_base`, of length 1."""
    velocity: Float64Array
    """(3,) m/s over ground, in `base`."""
    angular_velocity: Float64Array
    """(3,) rad/s, in `base`."""
    thrust: Float64Array
    """(n,) N of each thruster."""

    @staticmethod
    def of(vector: npt.ArrayLike) -> State:
        """From the vector (13 + n,) that the kernels take."""
        x = np.array(vector, np.float64)
        if x.ndim != 1 or len(x) < _kernels.MOTION or not np.isfinite(x).all():
            raise ValueError(f"state: expected (13 + n,) finite numbers, got shape {x.shape}: {x}")
        return State(x[:3], x[3:7], x[7:10], x[10:13], x[13:])

    @property
    def vector(self) -> Float64Array:
        """(13 + n,) position, wxyz, velocity, angular velocity, thrust."""
        parts = (self.position, self.wxyz, self.velocity, self.angular_velocity, self.thrust)
        return np.concatenate([np.asarray(part, np.float64) for part in parts])

    @property
    def T_world_base(self) -> SE3:
        """The pose."""
        return SE3(np.array(_kernels.rotation(self.vector)).reshape(3, 3), self.position)

    @property
    def velocity_world(self) -> Float64Array:
        """(3,) m/s over ground, in the world."""
        return np.asarray(self.T_world_base.rotation @ self.velocity, np.float64)


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A hull that swims.

    What it does: one step of Runge and Kutta's fourth order over
    `M ν̇ = τ − C_RB(ν) ν − C_A(ν_r) ν_r − D(ν_r) ν_r − g(η) + M_A ν̇_c`, with ν over ground, ν_r through the
    water and ν_c the water itself, in `base`; in an even current this is Fossen's equation in ν_r.
    Assumes: added mass and drag without terms between axes; a static force for each thruster.
    Fails when: the step is long against lag and drag; 5 to 10 ms are fine, 100 ms are not.
    """

    hull: Hull
    thrusters: Thrusters
    tether: Tether | None = None
    damping: tuple[float, float] = (1.0, 1.0)
    """Least and greatest factor on all drag, linear and quadratic alike, that published sets leave open."""

    @property
    def slowest(self) -> Hull:
        """Its hull with the greatest drag that it may have, which is what an autopilot learns a share of."""
        return _dragging(self.hull, self.damping[1])

    @property
    def typical(self) -> Hull:
        """Its hull with drag in the middle of what it may have, in logarithms."""
        return _dragging(self.hull, math.sqrt(self.damping[0] * self.damping[1]))

    @property
    def body(self) -> _kernels.Body:
        """As the kernels take it."""
        hull, tether = self.hull, self.tether
        commands, roots = self.thrusters.points
        return _kernels.Body(
            mass=float(hull.mass),
            moments=np.array(hull.moments, np.float64),
            added=np.array(hull.added, np.float64),
            linear=np.array(hull.linear, np.float64),
            quadratic=np.array(hull.quadratic, np.float64),
            weight=hull.weight,
            buoyancy=hull.weight + hull.net_buoyancy,
            buoyancy_centre=np.array(hull.centre_of_buoyancy, np.float64),
            height=float(hull.height),
            allocation=self.thrusters.allocation,
            lag=float(self.thrusters.lag),
            commands=commands,
            roots=roots,
            line_drag=0.5 * WATER_DENSITY * tether.drag_coefficient * tether.diameter if tether else 0.0,
            line_at=np.array(tether.attachment if tether else (0.0, 0.0, 0.0), np.float64),
        )

    def at_rest(self, T_world_base: SE3) -> State:
        """Still over ground at that pose, thrusters off."""
        return State(
            np.array(T_world_base.translation, np.float64),
            _wxyz(T_world_base.rotation.astype(np.float64)),
            np.zeros(3),
            np.zeros(3),
            np.zeros(self.thrusters.count),
        )

    def step(
        self,
        state: State,
        commands: npt.ArrayLike,
        dt: float,
        current: Current = STILL,
        *,
        gust: npt.ArrayLike = (0.0, 0.0),
        pull: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> State:
        """The state dt seconds later.

        Args:
            state: Now.
            commands: (n,) to the thrusters, held for the step; beyond ±1 as ±1.
            dt: Seconds.
            current: The water.
            gust: (2,) m/s, east and north: what it is more than its mean (`Current.begin`, `stirred`).
            pull: (3,) N in the world, on the tether's attachment, or on the centre of gravity without one.

        Raises:
            ValueError: A shape is wrong or an input is not finite.
            Diverged: The new state is not finite.
        """
        if not 0.0 < dt < math.inf:
            raise ValueError(f"dt: expected seconds above 0, got {dt}")
        x = State.of(state.vector).vector
        count = self.thrusters.count
        if len(x) != _kernels.MOTION + count:
            raise ValueError(f"state.thrust: expected {count} thrusters, got {len(x) - _kernels.MOTION}")
        inputs = [_checked(commands, "commands", count), _checked(gust, "gust", 2), _checked(pull, "pull", 3)]
        if not _kernels.advance(self.body, current.flow, inputs[1], inputs[2], inputs[0], dt, x):
            raise Diverged(
                f"motion: expected a finite state after {dt} s, got {x.tolist()}. Is the step long?"
            )
        return State.of(x)


@dataclass(frozen=True, slots=True)
class Spread:
    """How far the vehicle in the water may be from its published parameters.

    The drag of the two published sets differs sevenfold at equal thrust: 129 N ahead make 0.91 m/s with that
    of von Benzon et al. and 2.55 m/s with that of Wu, while the maker states 1.5 m/s. A factor of unknown
    size has no scale to prefer, so it is drawn evenly on the logarithm: for the Heavy, which has the larger
    one, as often from 0.15 to 0.39 as from 0.39 to 1; for the set of Wu from 1 to 6.7.
    """

    damping: tuple[float, float] | None = None
    """Least and greatest factor on all drag, linear and quadratic alike; the vehicle's own unless given."""
    trim: float = 0.05
    """Radians: the deviation of roll and of pitch of a vehicle left alone. Assumption: hulls are trimmed by
    hand with weights of 100 to 200 g, to a few degrees."""
    net_buoyancy: tuple[float, float] = (0.2, 5.0)
    """N, evenly. Assumption, as above."""

    def __post_init__(self) -> None:
        if self.damping is not None and not 0.0 < self.damping[0] <= self.damping[1] < math.inf:
            raise ValueError(f"spread.damping: expected two factors above 0, rising, got {self.damping}")
        if not 0.0 <= self.trim < 0.5:
            raise ValueError(f"spread.trim: expected 0 to 0.5 rad, got {self.trim}")
        if not -math.inf < self.net_buoyancy[0] <= self.net_buoyancy[1] < math.inf:
            raise ValueError(f"spread.net_buoyancy: expected two forces, rising, got {self.net_buoyancy}")

    def draw(self, vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
        """One vehicle as it may be."""
        hull = vehicle.hull
        low, high = vehicle.damping if self.damping is None else self.damping
        factor = low * math.exp(uniform(rng, 0.0, math.log(high / low)))
        roll, pitch = self.trim * rng.standard_normal(2)
        x, y, z = hull.centre_of_buoyancy
        # At rest the centre of buoyancy is above that of gravity: pitched down by p, it lies z·tan p behind.
        drawn = replace(
            _dragging(hull, factor),
            net_buoyancy=uniform(rng, *self.net_buoyancy),
            centre_of_buoyancy=(x - z * math.tan(pitch), y + z * math.tan(roll) / math.cos(pitch), z),
        )
        return replace(vehicle, hull=drawn)


def _dragging(hull: Hull, factor: float) -> Hull:
    """A hull with so many times its drag."""
    return replace(hull, linear=_scaled(hull.linear, factor), quadratic=_scaled(hull.quadratic, factor))


def _scaled(values: Six, factor: float) -> Six:
    a, b, c, d, e, f = (factor * value for value in values)
    return a, b, c, d, e, f


def _checked(values: npt.ArrayLike, name: str, count: int) -> Float64Array:
    array = np.ascontiguousarray(values, np.float64)
    if array.shape != (count,):
        raise ValueError(f"{name}: expected ({count},), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    return array


def _wxyz(rotation: Float64Array) -> Float64Array:
    """The quaternion of a rotation matrix, by its greatest component (Shepperd, 1978)."""
    trace = float(np.trace(rotation))
    squares = np.array([trace, *np.diag(rotation)])
    k = int(np.argmax(squares))
    if k == 0:
        q = np.array(
            [
                1.0 + trace,
                rotation[2, 1] - rotation[1, 2],
                rotation[0, 2] - rotation[2, 0],
                rotation[1, 0] - rotation[0, 1],
            ]
        )
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q = np.empty(4)
        q[0] = rotation[m, j] - rotation[j, m]
        q[1 + i] = 1.0 + 2.0 * rotation[i, i] - trace
        q[1 + j] = rotation[j, i] + rotation[i, j]
        q[1 + m] = rotation[m, i] + rotation[i, m]
    return np.asarray(q / np.linalg.norm(q))


BLUEROV2 = Vehicle(
    Hull(
        name="BlueROV2",
        mass=11.5,
        moments=(0.16, 0.16, 0.16),
        added=(5.5, 12.7, 14.57, 0.12, 0.12, 0.12),
        linear=(4.03, 6.22, 5.18, 0.07, 0.07, 0.07),
        quadratic=(18.18, 21.66, 36.99, 1.55, 1.55, 1.55),
        net_buoyancy=1.0,
        centre_of_buoyancy=(0.0, 0.0, 0.01),
    ),
    VECTORED,
    damping=(1.0, 6.7),
)
"""The BlueROV2 with six thrusters. C.-J. Wu, *6-DoF Modelling and Control of a Remotely Operated Vehicle*,
Flinders University, 2018; net buoyancy is ours, since the thesis' volume of 0.01135 m³ would sink. Six
thrusters cannot pitch, and beyond 0.35 m/s the moment of the water on its nose (Munk's) outgrows what a
centimetre between the centres of weight and buoyancy gives back: there it turns over."""

BLUEROV2_HEAVY = Vehicle(
    Hull(
        name="BlueROV2 Heavy",
        mass=13.5,
        moments=(0.26, 0.23, 0.37),
        added=(6.36, 7.12, 18.68, 0.189, 0.135, 0.222),
        linear=(13.7, 0.0, 33.0, 0.0, 0.8, 0.0),
        quadratic=(141.0, 217.0, 190.0, 1.19, 0.47, 1.5),
        net_buoyancy=1.0,
        centre_of_buoyancy=(0.0, 0.0, 0.01),
    ),
    VECTORED_6DOF,
    damping=(0.15, 1.0),
)
"""The BlueROV2 Heavy with eight thrusters. M. von Benzon et al., *JMSE* 10(12):1898, 2022, with the signs of
added mass and drag that the paper's tables leave out; net buoyancy is ours, since its volume of 0.0134 m³
would sink by 1 N."""
