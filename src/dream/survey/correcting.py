"""What a run says wrongly of itself, put right by somebody who knows better: where it was, and when.

A survey that was put right keeps what its run said, in `made_by["corrected"]`.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import datetime
from typing import Any

from dream.survey.globe import apart
from dream.survey.site import Site
from dream.survey.survey import Survey


def located(survey: Survey, site: Site) -> Survey:
    """The survey with its origin there."""
    if survey.site in (None, site):
        return replace(survey, site=site)
    return replace(survey, site=site, made_by=_keeping(survey, site=asdict(survey.site)))


def dated(survey: Survey, began: datetime) -> Survey:
    """The survey of a run that began then."""
    by = survey.made_by.get("began_by", "")
    made_by = _keeping(survey, began=survey.began.isoformat(), began_by=by)
    return replace(survey, began=began, made_by={**made_by, "began_by": "who added it"})


def corrections(before: Survey, after: Survey) -> tuple[str, ...]:
    """How far another origin, or another date, of a survey is from what it was, in words."""
    told = []
    if before.site is not None and after.site is not None and before.site != after.site:
        metres = apart(before.site, after.site)
        far = f"{metres:.1f} m" if metres < 1000.0 else f"{metres / 1000.0:.1f} km"
        turn = (after.site.heading_deg - before.site.heading_deg + 180.0) % 360.0 - 180.0
        told.append(
            f"its origin moves by {far} and turns by {turn:.1f}°, from {_said(before.site)} to "
            f"{_said(after.site)}"
        )
    if before.began != after.began:
        told.append(
            f"it began at {after.began:%Y-%m-%d %H:%M:%S %Z}, and not at {before.began:%Y-%m-%d %H:%M:%S %Z}"
        )
    return tuple(told)


def _keeping(survey: Survey, **said: Any) -> dict[str, Any]:
    """`made_by` with what the run said; what is there already was said before."""
    before = survey.made_by.get("corrected")
    before = before if isinstance(before, dict) else {}
    return {**survey.made_by, "corrected": {**said, **before}}


def _said(site: Site) -> str:
    return f"{site.name} ({site.latitude:.6f}, {site.longitude:.6f}, heading {site.heading_deg:g}°)"
