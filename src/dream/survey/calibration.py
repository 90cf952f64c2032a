"""What measuring gets wrong on average, found on simulated reefs of its own, and by how much that varies.

The reefs are `reef/fringing`, `string`, `patch` and `mixed` of seeds 60000 and up, which no suite flies, as
`belief` flew them; `python perf/survey.py --calibrate --worlds 6` finds the numbers again. Every
correction stands for something that the method is known to do, and every spread is part of an interval.
"""

from __future__ import annotations

from dataclasses import dataclass

from dream.types import Target

PROTOCOLS = ("dream-v1", "dream-v1-noisy", "dream-v1-nav")
"""By whose camera, altitude and reach individuals were counted and sized here."""


def doubt(protocol: str, target: Target) -> str:
    """Why figures of individuals that were found by another protocol are doubtful; empty where none are."""
    if target is Target.WRECK or protocol in PROTOCOLS:
        return ""
    return (
        "Counts, densities and sizes are calibrated for the camera, altitude and reach of "
        f"{PROTOCOLS[0]}. This survey was made by {protocol}: they may be off by far more than their "
        "intervals say."
    )


@dataclass(frozen=True, slots=True)
class Calibration:
    """Corrections and spreads for one quality of depth."""

    capture: tuple[float, float, float]
    """Logarithm of the individuals that a peak stands for: constant, per share of cover above a half, and per
    metre of depth above 3 m. Those hidden under and hard beside others are what it adds."""
    capture_spread: float
    """Standard deviation of the logarithm of a reef's count."""
    edge: float
    """Metres that the true outline lies outside the measured one. Below 0: cells that are seen in part count
    whole, and depths that scatter take shells beyond where they end."""
    edge_spread: float
    """Metres, of a reef."""
    edge_wander: float
    """Square metres for each root of a metre of outline: what the area of one patch errs by on its own, false
    targets at its rim included."""
    size: float
    """Times the measured extent of a lone individual."""
    size_residual: float
    """Metres: standard deviation of one individual's."""
    size_spread: float
    """Standard deviation of the logarithm of a reef's median."""
    relief: float
    """Times the measured height: shells' tops are seen, what lies between them often is not."""
    relief_spread: float
    """Metres, of a reef."""
    rugosity: float
    """Times what the chain ratio exceeds 1 by."""
    rugosity_spread: float
    """Standard deviation of the logarithm of that."""


SHARP = Calibration(
    capture=(1.199, 2.185, -0.053),
    capture_spread=0.039,
    edge=-0.0049,
    edge_spread=0.007,
    edge_wander=0.061,
    size=0.956,
    size_residual=0.027,
    size_spread=0.033,
    relief=1.044,
    relief_spread=0.0022,
    rugosity=1.173,
    rugosity_spread=0.081,
)
"""For depths that hardly scatter, as in `dream-v1`: 24 missions."""

SCATTERED = Calibration(
    capture=(1.183, 2.211, -0.106),
    capture_spread=0.039,
    edge=-0.0544,
    edge_spread=0.0131,
    edge_wander=0.136,
    size=0.805,
    size_residual=0.056,
    size_spread=0.042,
    relief=1.016,
    relief_spread=0.0025,
    rugosity=1.212,
    rugosity_spread=0.163,
)
"""For depths that scatter by about 0.002 z², labels that miss one individual in ten in each frame, and false
targets, as in `dream-v1-noisy`: 24 missions."""

BETWEEN = 0.001
"""Per metre: depths that scatter more take the second."""


def calibration_for(scatter: float) -> Calibration:
    """The calibration for depths that scatter so, as `ground.scatter_of` finds it."""
    return SCATTERED if scatter > BETWEEN else SHARP
