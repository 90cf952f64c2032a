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
    if before.site is not None and after.site is not None:
        moves = _moves(before.site, after.site)
        told += moves
        for name, words in _UNMOVED.items():
            then, now = getattr(before.site, name), getattr(after.site, name)
            # Which site it was is said where it moves.
            if then != now and not (moves and name == "name"):
                told.append(f"the {words} of its site is {_said(now)}, and not {_said(then)}")
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


_UNMOVED = {
    "name": "name",
    "datum": "datum",
    "datum_offset": "datum offset",
    "uncertainty": "uncertainty",
}
"""Fields of a site that do not say where it is, in words."""


def _moves(before: Site, after: Site) -> list[str]:
    metres = apart(before, after)
    turn = (after.heading_deg - before.heading_deg + 180.0) % 360.0 - 180.0
    if metres == turn == 0.0:
        return []
    far = f"{metres:.1f} m" if metres < 1000.0 else f"{metres / 1000.0:.1f} km"
    return [f"its origin moves by {far} and turns by {turn:.1f}°, from {_place(before)} to {_place(after)}"]


def _said(value: str | float | None) -> str:
    return "unknown" if value is None else value if isinstance(value, str) else f"{value:g} m"


def _place(site: Site) -> str:
    return f"{site.name} ({site.latitude:.6f}, {site.longitude:.6f}, heading {site.heading_deg:g}°)"
