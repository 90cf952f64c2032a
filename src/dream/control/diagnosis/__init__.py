"""Commands and motion → which thruster fails, and how."""

from dream.control.diagnosis.diagnosis import Diagnosis, Finding, controllable, failing, found, learnt_before

__all__ = ["Diagnosis", "Finding", "controllable", "failing", "found", "learnt_before"]
