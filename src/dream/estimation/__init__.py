"""Imu, Dvl, Depth, Heading → NavState."""

from dream.estimation.inekf import InEkf, InEkfState
from dream.estimation.intake import Outcome, Source, Verdict

__all__ = ["InEkf", "InEkfState", "Outcome", "Source", "Verdict"]
