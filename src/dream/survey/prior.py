"""Survey → what a mission is told of the ground before it starts."""

from __future__ import annotations

import math
from datetime import datetime

import numpy as np

from dream.geometry import SE2, Bounds
from dream.mapping.prior import MOST_YEARS, Prior
from dream.survey.globe import apart, between
from dream.survey.registration import SAME_PLACE
from dream.survey.site import Site
from dream.survey.survey import Survey
from dream.types import Target

SOLID = (3, 4)
"""States of what stood up, hull or not."""
YEAR = 365.25 * 86_400.0


def prior_of(
    survey: Survey,
    bounds: Bounds,
    cell: float,
    *,
    target: Target = Target.ANY,
    site: Site | None = None,
    now: datetime | None = None,
) -> Prior:
    """What a survey holds of the cells of a map.

    Each cell of the map takes what the survey's cell under its middle held. Where both have a site, the
    survey is shifted and turned from its frame to that of the mission; else the frames are taken as equal.

    Args:
        survey: The earlier one.
        bounds: Of the map.
        cell: Its cells, metres.
        target: What the mission looks for.
        site: Where on earth the mission is.
        now: When it is flown; a year after the survey where None.

    Raises:
        ValueError: The survey is of another kind of target, of another place, or from after the mission.
    """
    if Target.ANY not in (target, survey.target) and target != survey.target:
        raise ValueError(f"--from-survey: expected a survey of {target}, got one of {survey.target}")
    years = 1.0 if now is None else (now - survey.began).total_seconds() / YEAR
    if not 0.0 <= years <= MOST_YEARS:
        raise ValueError(
            f"--from-survey: expected a survey from before the mission, got one from {survey.began}"
        )
    T_survey_mission = SE2(0.0, 0.0, 0.0)
    if site is not None and survey.site is not None:
        if not survey.site.is_called(site.name):
            raise ValueError(
                f"--from-survey: expected a survey of {site.name!r}, where the mission is, got one of "
                f"{survey.site.name!r} ({survey.name}). Is it the same place under another name?"
            )
        if (away := apart(survey.site, site)) > SAME_PLACE:
            raise ValueError(
                "--from-survey: expected a survey of this place, got one whose origin is "
                f"{away / 1000.0:.1f} km away. Is one of the two site files wrong?"
            )
        T_survey_mission = between(survey.site, site)
    rows, cols = round(bounds.depth / cell), round(bounds.width / cell)
    y, x = np.mgrid[:rows, :cols]
    x, y = bounds.x_min + (x + 0.5) * cell, bounds.y_min + (y + 0.5) * cell
    c, s = math.cos(T_survey_mission.yaw), math.sin(T_survey_mission.yaw)
    layers = survey.layers
    east = T_survey_mission.x + c * x - s * y - layers.bounds.x_min
    north = T_survey_mission.y + s * x + c * y - layers.bounds.y_min
    # Far below a cell, so that its edge is the same whatever the last digits say.
    row, col = (np.floor(k / layers.cell + 1e-6).astype(np.int64) for k in (north, east))
    inside = (row >= 0) & (row < layers.state.shape[0]) & (col >= 0) & (col < layers.state.shape[1])
    told = np.full((rows, cols), np.nan, np.float32)
    solid = np.zeros((rows, cols), np.bool_)
    told[inside] = layers.target_probability[row[inside], col[inside]]
    solid[inside] = np.isin(layers.state[row[inside], col[inside]], SOLID)
    if np.isnan(told).all():
        raise ValueError(
            f"--from-survey: expected a survey of this area, got {survey.name}, which saw nothing of it. "
            "Are the sites right?"
        )
    sigma = float(np.median(survey.track.sigma)) if len(survey.track.sigma) else 0.0
    return Prior(bounds, cell, told, solid, sigma, years, survey.name)


def frames_told(survey: Survey, site: Site | None) -> str:
    """How the frames of a survey and of a mission were brought together, in a sentence."""
    if site is None or survey.site is None:
        say = "neither says" if site is survey.site else "one of the two does not say"
        return (
            f"the frames of {survey.name} and of the mission are taken as equal: {say} where on earth it is"
        )
    shift = between(survey.site, site)
    return (
        f"{survey.name} is shifted by {math.hypot(shift.x, shift.y):.1f} m and turned by "
        f"{math.degrees(abs(shift.yaw)):.1f}° to where the mission is"
    )
