"""What is known of a vehicle's instruments, whichever estimator reads them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels.groups import so3_exp
from dream.estimation._kernels.sensors import Parameters
from dream.estimation.intake import plain
from dream.geometry import SE3

Float64Array = npt.NDArray[np.float64]

ALIGNED = SE3(np.eye(3), np.zeros(3))
"""T_base_sensor of a sensor that sits where the inertial unit sits, and looks along its axes."""


@dataclass(frozen=True, slots=True)
class InertialErrors:
    """How an inertial unit errs. The defaults are those of a BlueROV2's ICM-20602."""

    gyro_noise: float = 7.0e-5
    """rad/s/√Hz: 4 mdps/√Hz (TDK DS-000176)."""
    accelerometer_noise: float = 9.8e-4
    """m/s²/√Hz: 100 µg/√Hz (the same)."""
    gyro_walk: float = 1e-5
    """rad/s²/√Hz by which the bias wanders: 0.004°/s in a minute. Ours; the data sheet gives none."""
    accelerometer_walk: float = 1e-4
    """m/s³/√Hz. Ours."""
    gyro_range: float = math.radians(2000.0)
    """rad/s at which an axis clips (TDK DS-000176)."""
    accelerometer_range: float = 157.0
    """m/s² at which an axis clips: 16 g (the same)."""
    clipped: float = 0.25
    """Share of the range by which a clipped sample may err, one sigma. Ours."""
    rate: float = 100.0
    """Hz of its samples, which with the density gives the noise of one."""
    gravity: float = 9.81
    """m/s² that it reads at rest."""


@dataclass(frozen=True, slots=True)
class Gap:
    """What a vehicle may do while its inertial samples are missing, beside the mean of those around the gap.

    What it does: a rate and a force of these sizes, each alike for as long as `alike` says, add up to no more
    than white noise of the density √(2 σ² T) does, however long it lasts; a filter is told of that noise.
    Reference: measured in the simulated tank. A BlueROV2 Heavy that goes to and fro with turns strays from
    the mean of both ends by 0.05 to 0.09 rad and 0.05 to 0.14 m/s an axis, rms, within 0.7 s, and by 0.07 to
    0.11 rad and 0.08 to 0.21 m/s within 1 s. These densities make it 0.11 rad and 0.19 m/s, and 0.13 rad and
    0.22 m/s.
    Assumes: nothing pulls at it: its thrusters alone could push it by 6 m/s².
    Fails when: the gap is short. Within 0.1 s it strays by some thousandths, and is told of hundredths.
    """

    turn_rate: float = 0.3
    """rad/s of each axis, one sigma."""
    force: float = 0.5
    """m/s² of each axis, likewise."""
    alike: float = 0.1
    """Seconds: a swing of roll lasts for about 0.7."""

    def __post_init__(self) -> None:
        for name in ("turn_rate", "force", "alike"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"gap.{name}: expected a number above 0, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Mounting:
    """Where the other instruments are; the inertial unit is the origin of `base`, and aligned with it."""

    T_base_dvl: SE3 = ALIGNED
    """The DVL's origin is where the axes of its beams meet."""
    pressure_sensor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Metres, in `base`."""


@dataclass(frozen=True, slots=True)
class Start:
    """How certain a filter is when it begins: one sigma of errors in the frame of the vehicle."""

    tilt: float = math.radians(5.0)
    """Radians, of roll and of pitch."""
    yaw: float = math.radians(5.0)
    """Radians."""
    velocity: float = 0.1
    """m/s."""
    position: float = 0.01
    """Metres: the map's origin is where the mission starts."""
    gyro_bias: float = math.radians(0.5)
    """rad/s."""
    accelerometer_bias: float = 0.1
    """m/s²: a hundredth of g."""

    def draw(self, T_world_base: SE3, rng: np.random.Generator) -> tuple[SE3, Float64Array]:
        """A pose, and a velocity (3,) in the world, that err by so much about a vehicle at rest there."""
        attitude, velocity, position = rng.standard_normal((3, 3))
        off = so3_exp(np.array([self.tilt, self.tilt, self.yaw]) * attitude)
        error = SE3(off, self.position * position)
        return T_world_base @ error, T_world_base.rotation @ (self.velocity * velocity)


@dataclass(frozen=True, slots=True)
class Trust:
    """Which measurements a filter believes."""

    gate: float = 0.999
    """Share of the innovations of a consistent filter that are taken."""
    patience: float = 2.0
    """Seconds after which a DVL or a depth that is refused every time is believed over the state: a filter
    that is too sure of itself would shut it out for good. Headings are not, as iron can turn a compass for
    long. Ours."""
    settling: float = 5.0
    """Seconds from the start for which the gates are ten times as wide: an attitude that is far off makes
    greater innovations than a filter foresees, and those are what corrects it. Ours."""
    dvl_floor: float = 0.005
    """m/s: no axis of the DVL is believed to be better."""
    rest: float = 0.05
    """m/s, to which a vehicle that was told to stop stands still. Weak, as a current drifts it."""


def start_sigmas(start: Start) -> list[float]:
    """(15) of attitude, velocity, position and both biases, axis by axis."""
    last = [start.velocity, start.position, start.gyro_bias, start.accelerometer_bias]
    return [start.tilt, start.tilt, start.yaw, *(sigma for sigma in last for _ in range(3))]


def parameters(imu: InertialErrors, mounting: Mounting, trust: Trust) -> Parameters:
    """All of it, as the compiled filters take it."""
    from scipy.special import chdtri

    return Parameters(
        gyro_noise=imu.gyro_noise,
        accelerometer_noise=imu.accelerometer_noise,
        gyro_walk=imu.gyro_walk,
        accelerometer_walk=imu.accelerometer_walk,
        gyro_range=imu.gyro_range,
        accelerometer_range=imu.accelerometer_range,
        clipped=imu.clipped,
        rate=imu.rate,
        gravity=imu.gravity,
        dvl_rotation=plain(mounting.T_base_dvl.rotation),
        dvl_position=plain(mounting.T_base_dvl.translation),
        pressure_position=plain(mounting.pressure_sensor),
        dvl_floor=trust.dvl_floor,
        rest_sigma=trust.rest,
        gate_of_one=float(chdtri(1, 1.0 - trust.gate)),
        gate_of_three=float(chdtri(3, 1.0 - trust.gate)),
        patience=trust.patience,
        settling=trust.settling,
    )


def unsensed(known: Parameters, gap: Gap) -> Parameters:
    """The same for a stretch without samples: instead of how they err, what the vehicle may do."""
    root = math.sqrt(2.0 * gap.alike)
    # Of the rate itself, which the DVL's lever arm reads, σ² is the density's square times this rate.
    return known._replace(
        gyro_noise=root * gap.turn_rate, accelerometer_noise=root * gap.force, rate=0.5 / gap.alike
    )
