"""From a mission to what a monitor of reefs needs: measures with intervals, maps, change over time."""

from dream.survey.survey import (
    DecisionPoint,
    Individuals,
    Layers,
    Measure,
    Patch,
    Survey,
    Track,
)

__all__ = ["DecisionPoint", "Individuals", "Layers", "Measure", "Patch", "Survey", "Track"]
