"""State, world → velocity over ground by four beams."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3
from dream.measurements import Dvl
from dream.sim.sampling import uniform
from dream.sim.sensors import _kernels
from dream.sim.solids import Solids
from dream.sim.vehicle import State

Float64Array = npt.NDArray[np.float64]

RANGE_MODES = ((0.6, 15.0), (3.0, 10.0), (14.0, 5.0), (36.0, 7.0), (50.0, 2.0))
"""Greatest altitude in metres and least update rate in hertz of the range modes 0 to 4 of the A50
(docs.waterlinked.com, range mode). Where they overlap, the lower one pings."""


@dataclass(frozen=True, slots=True, eq=False)
class Ping:
    """What came of one ping."""

    dvl: Dvl
    arrives: float
    """When it can be used: after the echo, its reckoning and the network. Seconds, as `dvl.time`."""
    ranges: Float64Array
    """(4,) metres along the beams; NaN for a lost one."""


@dataclass(frozen=True, slots=True)
class DopplerLog:
    """A Doppler velocity log of four beams in Janus configuration.

    What it does: casts each beam's middle ray at the world's terrain, obstacles and hulls. What comes back
    gives the velocity along the beam with white noise; three or more give the velocity by least squares, and
    its covariance. A scale error, drawn once a mission, stands for the speed of sound and the transducers. A
    beam is lost beyond the least and the greatest altitude; and at random, the more often the fainter (by
    altitude) and the more slanting (by incidence) the echo is: it survives with probability
    (1 − dropout)(1 − (h / h_max)⁴)(1 − (i / i_max)⁴).
    Reference: Water Linked DVL A50, docs.waterlinked.com (overview, axes, range mode) and data sheet.
    Assumes: 22.5° beams without width (the A50's are 4.4° wide at half power), towards the four corners; no
    error of mounting; the law of loss above, which no data sheet gives.
    """

    scale_error: float = 0.01
    """Greatest share by which velocities are long or short in a mission, evenly between."""
    position: tuple[float, float, float] = (-0.15, 0.0, -0.1)
    """Metres in `base`: its origin, where the axes of the beams meet, 28 mm above the A50's back plate.
    Assumption: under the frame, behind the middle."""
    yaw: float = 0.0
    """Radians by which its own forward axis points to the left of the vehicle's."""
    beam_angle: float = math.radians(22.5)
    """Radians between a beam and its axis."""
    min_altitude: float = 0.05
    """Metres."""
    max_altitude: float = 50.0
    """Metres, under ideal conditions."""
    max_incidence: float = math.radians(75.0)
    """Radians between beam and normal of the ground at which every echo is lost. Assumption."""
    max_speed: float = 3.75
    """m/s; what is faster is not valid."""
    dropout: float = 0.005
    """Probability that a beam is lost for no reason. Assumption."""
    beam_noise: float = 0.003
    """m/s along a beam: 5.5 mm/s ahead and 1.6 mm/s up with four beams. The figures of merit of an A50 are
    millimetres to centimetres a second."""
    latency: float = 0.004
    """Mean seconds between the echo and the report: measured at 4 ms, deviation 2 ms."""
    latency_spread: float = 0.002
    """Its standard deviation, seconds."""
    sound_speed: float = 1500.0
    """m/s."""

    def __post_init__(self) -> None:
        for name in ("min_altitude", "max_speed", "sound_speed"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"dvl.{name}: expected a number above 0, got {getattr(self, name)}")
        if not self.min_altitude < self.max_altitude < math.inf:
            raise ValueError(
                f"dvl.max_altitude: expected more than {self.min_altitude} m, got {self.max_altitude}"
            )
        for name in ("beam_angle", "max_incidence"):
            if not 0.0 < getattr(self, name) < 0.5 * math.pi:
                raise ValueError(
                    f"dvl.{name}: expected an angle between 0 and π/2, got {getattr(self, name)}"
                )
        for name in ("scale_error", "beam_noise", "latency", "latency_spread"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"dvl.{name}: expected 0 or more, got {getattr(self, name)}")
        if not 0.0 <= self.dropout <= 1.0:
            raise ValueError(f"dvl.dropout: expected a probability, got {self.dropout}")

    @property
    def T_base_dvl(self) -> SE3:
        """Where it sits; its own frame is forward-left-up."""
        return SE3.level(*self.position, self.yaw)

    @property
    def beams(self) -> Float64Array:
        """(4, 3) unit vectors in its own frame: front left, rear left, rear right, front right, all down."""
        corner = math.radians(45.0) + math.radians(90.0) * np.arange(4)
        out = math.sin(self.beam_angle)
        down = np.full(4, -math.cos(self.beam_angle))
        return np.stack([out * np.cos(corner), out * np.sin(corner), down], axis=1)

    @property
    def constants(self) -> _kernels.Acoustic:
        """As the kernels take it; a whole number among them would have the kernels compiled once more."""
        return _kernels.Acoustic(
            position=np.array(self.position, np.float64),
            mounting=np.ascontiguousarray(self.T_base_dvl.rotation, np.float64),
            beams=self.beams,
            min_altitude=float(self.min_altitude),
            max_altitude=float(self.max_altitude),
            max_incidence=float(self.max_incidence),
            max_speed=float(self.max_speed),
            dropout=float(self.dropout),
            beam_noise=float(self.beam_noise),
            latency=float(self.latency),
            latency_spread=float(self.latency_spread),
            sound_speed=float(self.sound_speed),
        )

    def begin(self, rng: np.random.Generator) -> float:
        """The share by which all velocities of a mission are long."""
        return uniform(rng, -self.scale_error, self.scale_error)

    def rate(self, altitude: float) -> float:
        """Pings a second at an altitude in metres; that of the farthest range mode where it is NaN."""
        tops, rates = np.array(RANGE_MODES, np.float64).T.copy()
        return float(_kernels.ping_rate(tops, rates, altitude))

    def ping(self, time: float, state: State, solids: Solids, scale: float, rng: np.random.Generator) -> Ping:
        """One ping.

        Args:
            time: When.
            state: Of the vehicle then.
            solids: Of the world that the beams meet.
            scale: From `begin`.
            rng: Of the mission.

        Returns:
            Velocity and covariance are NaN where it is not valid, the altitude where no beam came back.
        """
        velocity, covariance, ranges = np.empty(3), np.empty((3, 3)), np.empty(4)
        altitude, delay, valid = _kernels.ping(
            self.constants,
            solids.index,
            State.of(state.vector).vector,
            scale,
            rng,
            velocity,
            covariance,
            ranges,
        )
        return Ping(Dvl(time, velocity, covariance, altitude, valid), time + delay, ranges)


DVL_A50 = DopplerLog()
"""Water Linked A50, standard: long-term accuracy ±1 %."""
DVL_A50_PERFORMANCE = replace(DVL_A50, scale_error=0.001)
"""Water Linked A50, performance: long-term accuracy ±0.1 %."""
