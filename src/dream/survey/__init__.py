"""From a mission to what a monitor of reefs needs: measures with intervals, maps, change over time."""

from dream.survey.measuring import About, measure, measure_observations
from dream.survey.survey import (
    Cells,
    DecisionPoint,
    Individuals,
    Layers,
    Measure,
    Patch,
    Picture,
    StructureSide,
    Survey,
    SurveyedStructure,
    Track,
)

__all__ = [
    "About",
    "Cells",
    "DecisionPoint",
    "Individuals",
    "Layers",
    "Measure",
    "Patch",
    "Picture",
    "StructureSide",
    "Survey",
    "SurveyedStructure",
    "Track",
    "measure",
    "measure_observations",
]
