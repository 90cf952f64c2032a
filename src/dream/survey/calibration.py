"""What measuring gets wrong on average, found on simulated reefs of its own, and by how much that varies.

The reefs are `reef/fringing`, `string`, `patch` and `mixed` of seeds 60000 and up, which no suite flies, new
and one, two and four years on, as `belief` flew them; `python perf/survey.py --calibrate --worlds 3` finds
the numbers again. Every correction stands for something that the method is known to do, and every spread is
part of an interval.
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

    capture: tuple[float, float, float, float]
    """Logarithm of the individuals that a peak stands for: constant, per share of cover above a half, per
    metre of depth above 3 m, and per logarithm of the size that makes up the reef's cover over 0.24 m. Those
    hidden under and hard beside others are what it adds: the larger they are, the fewer hide in the same
    cover."""
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
    extent: tuple[tuple[float, float, float], ...]
    """What the logarithm of extent over size is of individuals that show as standing clear: a mixture of
    normal distributions, each with its share, mean and standard deviation. The second holds those that are
    two or more and show as one."""
    rank_spread: float
    """Standard deviation of the share of a reef's individuals that is smaller than the median told."""
    share_spread: float
    """Standard deviation of the share of a bin of sizes, over the root of share × (1 − share) + 0.01."""
    relief: float
    """Times the measured height: shells' tops are seen, what lies between them often is not."""
    relief_spread: float
    """Metres, of a reef."""
    rugosity: float
    """Times what the chain ratio exceeds 1 by."""
    rugosity_spread: float
    """Standard deviation of the logarithm of that."""


SHARP = Calibration(
    capture=(1.130, 1.991, -0.039, -0.563),
    capture_spread=0.043,
    edge=-0.0042,
    edge_spread=0.0072,
    edge_wander=0.076,
    extent=((0.634, 0.009, 0.072), (0.366, 0.122, 0.251)),
    rank_spread=0.076,
    share_spread=0.183,
    relief=1.045,
    relief_spread=0.0022,
    rugosity=1.154,
    rugosity_spread=0.094,
)
"""For depths that hardly scatter, as in `dream-v1`: 48 missions."""

SCATTERED = Calibration(
    capture=(1.104, 2.046, -0.122, -0.564),
    capture_spread=0.045,
    edge=-0.0544,
    edge_spread=0.0142,
    edge_wander=0.145,
    extent=((0.276, 0.041, 0.093), (0.724, 0.247, 0.269)),
    rank_spread=0.087,
    share_spread=0.16,
    relief=1.013,
    relief_spread=0.0052,
    rugosity=1.179,
    rugosity_spread=0.155,
)
"""For depths that scatter by about 0.002 z², labels that miss one individual in ten in each frame, and false
targets, as in `dream-v1-noisy`: 48 missions."""

BETWEEN = 0.001
"""Per metre: depths that scatter more take the second."""


def calibration_for(scatter: float) -> Calibration:
    """The calibration for depths that scatter so, as `perception.scatter.scatter_of` finds it."""
    return SCATTERED if scatter > BETWEEN else SHARP
