"""What the sensors of motion report: turn rates and forces, velocity over ground, height, heading.

Frames are those of `dream.geometry`: `base` is forward-left-up, `world` east-north-up with z = 0 at the
surface. The inertial unit sits at the origin of `base` and is aligned with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Imu:
    """Turn rates and specific force, the mean over the sample that ends at `time`."""

    time: float
    """Seconds since the mission started."""
    angular_velocity: Float64Array
    """(3,) rad/s, in `base`."""
    specific_force: Float64Array
    """(3,) m/s², in `base`: acceleration less gravity, so that at rest it points up."""


@dataclass(frozen=True, slots=True, eq=False)
class Dvl:
    """Velocity over ground by bottom track."""

    time: float
    """When it was true; it may come in later than that."""
    velocity: Float64Array
    """(3,) m/s of the DVL's origin over ground, in its own frame."""
    covariance: Float64Array
    """(3, 3) m²/s²."""
    altitude: float
    """Metres above the seabed; NaN where no beam came back."""
    valid: bool
    """Without bottom lock the velocity means nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Depth:
    """Height of the pressure sensor."""

    time: float
    z: float
    """Metres in the world, negative below the surface."""
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class Heading:
    """Yaw from a compass, or from an attitude and heading reference."""

    time: float
    yaw: float
    """Radians, 0 = east, counter-clockwise."""
    sigma: float


Measurement = Dvl | Depth | Heading
"""What corrects a state; `Imu` carries it forward."""
