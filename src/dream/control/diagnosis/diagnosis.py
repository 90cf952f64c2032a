"""How the fault of a thruster is found, and what the vehicle is to the autopilot from then on."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from dream.control._kernels import Nominal
from dream.control.diagnosis import _kernels
from dream.vehicle import GRAVITY, FaultKind, Hull, Thrusters
from dream.vehicle._kernels import WEAK_SHARE
from dream.vehicle.faults import CODES

Float64Array = npt.NDArray[np.float64]

LEVEL_FIRST = 1e4
"""How much more a newton metre counts than a newton where a jammed thruster cannot be made up for wholly."""
LEAN = math.radians(15.0)
"""By which a vehicle may lean that no thruster rights, on its way up."""
KINDS = {code: kind for kind, code in CODES.items()}


@dataclass(frozen=True, slots=True)
class NamedFault:
    """The fault of a thruster, as the autopilot knows it."""

    thruster: int
    """Counted from 1."""
    kind: FaultKind
    force: float
    """N that a jammed one does; of no meaning else."""
    time: float
    """Seconds on the mission's clock at which it was named."""

    def __str__(self) -> str:
        return f"thruster {self.thruster} {self.kind.told}"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Finds the fault of one thruster from what was commanded and how the vehicle moved.

    What it does: every tenth of a second, mass times acceleration less all forces of the model is what the
    model lacks, a wrench of six. A Kalman filter explains that by what is not known of a healthy vehicle:
    how much drag it has, the current, trim and buoyancy, and what accelerometers read wrong. Over windows of
    0.3 to 3 s, the likelihood of each fault of each thruster is set against that of none, both with what
    is not known estimated along (a generalized likelihood ratio). A fault is named that is certain, clearly
    likelier than all others, the likeliest three times running, and leaves nothing unexplained.

    Reference: Willsky and Jones, *IEEE Trans. Automatic Control* 21 (1976); Basseville and Nikiforov,
    *Detection of Abrupt Changes* (1993), chapter 7.

    Assumes: the allocation, the curve and the lag of the thrusters, within the errors below; a velocity over
    ground: what moves without one is not judged.
    Fails when: a thruster gives too little to be missed; two fail at once; something else pushes along the
    column of a thruster just as it is commanded.
    """

    force_noise: float = 0.3
    """N, standard deviation in a tenth of a second."""
    moment_noise: float = 0.02
    """N m."""
    inertia_error: float = 0.15
    """Share of the added mass and inertia that the model may lack."""
    thrust_error: float = 0.03
    """Share of a thruster's force."""
    lag_error: float = 0.2
    """Share of what a thruster's force changes by in a tenth of a second."""
    gust: float = 0.05
    """m/s by which the current may change within some seconds."""
    jam: float = 6.0
    """N, the least that a jammed thruster does: one that does less is taken for dead."""
    certain: float = 30.0
    """Logarithm of the likelihood ratio."""
    margin: float = 8.0
    """By which it must be above that of all other faults."""
    pace: float = 0.5
    """Share of the autopilot's speeds and accelerations that are left with a fault."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0.0 < getattr(self, field.name) < math.inf:
                raise ValueError(
                    f"diagnosis.{field.name}: expected a number above 0, got {getattr(self, field.name)}"
                )

    def plant(self, hull: Hull, thrusters: Thrusters) -> _kernels.Plant:
        """A vehicle as the kernels take it.

        Args:
            hull: With the most drag that it may have.
            thrusters: Of the vehicle, at most eight.
        """
        if thrusters.count > _kernels.MOST_THRUSTERS:
            raise ValueError(
                f"diagnosis: expected at most {_kernels.MOST_THRUSTERS} thrusters, got {thrusters.count}"
            )
        commands, roots = thrusters.points
        walk = np.array([0.01, 0.01, 0.016, 0.016, 0.05, 3e-5, 3e-5, 0.1, 0.1])
        return _kernels.Plant(
            mass=float(hull.mass),
            moments=np.array(hull.moments, np.float64),
            added=np.array(hull.added, np.float64),
            linear=np.array(hull.linear, np.float64),
            quadratic=np.array(hull.quadratic, np.float64),
            weight=hull.weight,
            righting=float(hull.centre_of_buoyancy[2]),
            gravity=GRAVITY,
            allocation=thrusters.allocation,
            commands=commands,
            roots=roots,
            lag=float(thrusters.lag),
            walk=walk,
            floor=np.array([self.force_noise] * 3 + [self.moment_noise] * 3),
            inertia_error=float(self.inertia_error),
            thrust_error=float(self.thrust_error),
            lag_error=float(self.lag_error),
            gust=float(self.gust),
            jam=float(self.jam),
            certain=float(self.certain),
            margin=float(self.margin),
        )

    def begin(self, hull: Hull, thrusters: Thrusters) -> _kernels.Memory:
        """Of a vehicle at rest whose thrusters are off."""
        n, unknown, bins = thrusters.count, _kernels.UNKNOWN, _kernels.BINS
        clock = np.zeros(_kernels.CLOCK)
        clock[[_kernels.NAMED, _kernels.LIKELIEST]] = -1.0
        return _kernels.Memory(
            clock=clock,
            force=np.zeros(n),
            before=np.zeros(n),
            gyro=np.full(3, math.nan),
            sums=np.zeros(_kernels.SUMS + n),
            mean=np.array([0.5, 0.5, 0.0, 0.0, hull.net_buoyancy, *hull.centre_of_buoyancy[:2], 0.0, 0.0]),
            covariance=np.diag(np.square([0.3, 0.3, 0.2, 0.2, 3.0, 1e-3, 1e-3, 2.0, 2.0])),
            bins=np.zeros((bins, _kernels.WIDTH)),
            means=np.zeros((bins, unknown)),
            covariances=np.zeros((bins, unknown, unknown)),
            pushes=np.zeros((bins, 6)),
        )


def found(memory: _kernels.Memory, time: float) -> NamedFault | None:
    """What the kernels have named, if anything.

    Args:
        memory: Of the kernels.
        time: Seconds on the mission's clock.
    """
    thruster, kind, force = memory.clock[[_kernels.NAMED, _kernels.KIND, _kernels.FORCE]]
    if thruster < 0.0:
        return None
    return NamedFault(int(thruster) + 1, KINDS[int(kind)], float(force), time)


def learnt_before(memory: _kernels.Memory) -> Float64Array:
    """(6,) what the autopilot had learnt of pushes and drag before the windows of the kernels."""
    count = int(memory.clock[_kernels.COUNT])
    return np.array(memory.pushes[max(count - _kernels.BINS, 0) % _kernels.BINS])


def controllable(thrusters: Thrusters, finding: NamedFault) -> bool:
    """Can the others make every wrench that all of them can?"""
    kept = _kept(thrusters, finding)
    return bool(np.linalg.matrix_rank(kept, 1e-6) == np.linalg.matrix_rank(thrusters.allocation, 1e-6))


def failing(nominal: Nominal, hull: Hull, thrusters: Thrusters, finding: NamedFault) -> Nominal:
    """The vehicle as the autopilot takes it from the finding on.

    A dead thruster is left out of the allocation, and so is a jammed one, whose force the others make up
    for; a weak one is asked for the more. Where the others cannot make every wrench, moments go first for
    what makes up for a jammed one; and none is asked for more than what a lean of `LEAN` rights by itself.

    Args:
        nominal: The healthy vehicle.
        hull: Its hull.
        thrusters: Its thrusters.
        finding: What fails.
    """
    allocation, kept = thrusters.allocation, _kept(thrusters, finding)
    least, most = nominal.least.copy(), nominal.most.copy()
    held = np.zeros(thrusters.count)
    if finding.kind is FaultKind.JAMMED:
        weights = np.array([1.0] * 3 + [LEVEL_FIRST] * 3)
        sharing = np.linalg.pinv(weights[:, None] * kept, rcond=1e-6)
        held = -sharing @ (weights * allocation[:, finding.thruster - 1]) * finding.force
        held = np.clip(held, least, most)
    if not controllable(thrusters, finding):
        righting = hull.weight * hull.centre_of_buoyancy[2] * math.sin(LEAN)
        arms = np.hypot(allocation[3], allocation[4])
        bound = np.where(arms > 1e-9, righting / np.maximum(arms, 1e-9), math.inf)
        least, most = np.maximum(least, held - bound), np.minimum(most, held + bound)
    return nominal._replace(
        sharing=np.ascontiguousarray(np.linalg.pinv(kept, rcond=1e-6)), least=least, most=most, held=held
    )


def _kept(thrusters: Thrusters, finding: NamedFault) -> Float64Array:
    """(6, n) the allocation with what the thruster still gives of what it is asked for."""
    kept = thrusters.allocation.copy()
    kept[:, finding.thruster - 1] *= WEAK_SHARE if finding.kind is FaultKind.WEAK else 0.0
    return kept
