"""Commands and motion → which thruster fails, and how."""

from dream.control.diagnosis.diagnosis import (
    Diagnosis,
    NamedFault,
    controllable,
    failing,
    found,
    learnt_before,
)

__all__ = ["Diagnosis", "NamedFault", "controllable", "failing", "found", "learnt_before"]
