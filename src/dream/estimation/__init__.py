"""Imu, Dvl, Depth, Heading → NavState."""

from dream.estimation.cipg import Cipg, CipgState
from dream.estimation.dead_reckoning import DeadReckoning, DeadReckoningState
from dream.estimation.ekf import Ekf, EkfState
from dream.estimation.inekf import InEkf, InEkfState
from dream.estimation.instruments import Gap, InertialErrors, Mounting, Start, Trust
from dream.estimation.intake import Outcome, Source, Verdict
from dream.estimation.timeline import Timeline

__all__ = [
    "Cipg",
    "CipgState",
    "DeadReckoning",
    "DeadReckoningState",
    "Ekf",
    "EkfState",
    "Gap",
    "InEkf",
    "InEkfState",
    "InertialErrors",
    "Mounting",
    "Outcome",
    "Source",
    "Start",
    "Timeline",
    "Trust",
    "Verdict",
]
