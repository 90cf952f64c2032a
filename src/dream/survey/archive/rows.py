"""Survey → the rows of an archive's tables, geometries as well-known binary."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.survey import files, globe
from dream.survey.archive import wkb
from dream.survey.archive.schema import FROM_NOWHERE
from dream.survey.boxes import held, outline
from dream.survey.site import Site
from dream.survey.survey import Measure, Survey

Row = dict[str, Any]


def rows(survey: Survey) -> tuple[Row, dict[str, list[Row]]]:
    """The row of `surveys`, and those of the other tables, which lack its id yet.

    Raises:
        ValueError: The survey is inconsistent, or its run had no origin.
    """
    site = survey.site
    if site is None:
        raise ValueError(f"{survey.name}: {FROM_NOWHERE}")
    body = files.dumped(survey)
    box = survey.area
    # Of all that the other tables have places of, beside the area.
    holds = held(
        np.array([(box.x_min, box.y_min), (box.x_max, box.y_max)]),
        survey.individuals.position,
        survey.track.position,
        np.array([(one.x, one.y) for one in survey.decisions]).reshape(-1, 2),
        *(ring for patch in survey.patches for ring in patch.rings),
    )
    head = {
        "digest": digest(body),
        "name": _text(survey.name),
        "site": _text(site.name),
        "began": time(survey.began),
        "target": str(survey.target),
        "protocol": _text(survey.protocol),
        "steps": len(survey.decisions),
        "patches": len(survey.patches),
        "individuals": len(survey.individuals),
        "latitude": site.latitude,
        "longitude": site.longitude,
        "heading_deg": site.heading_deg,
        "datum": _text(site.datum),
        "datum_offset_m": site.datum_offset,
        "geom": wkb.polygon([outline(partial(globe.degrees, site), holds)]),
        "uncertainty_m": site.uncertainty,
        "run": None if survey.run is None else _text(survey.run),
    }
    measures = [_measure(one, None) for one in survey.measures]
    patches = []
    for number, patch in enumerate(survey.patches, start=1):
        patches.append(
            {"patch": number, "geom": wkb.multipolygon([_places(site, ring) for ring in patch.rings])}
        )
        measures += [_measure(one, number) for one in patch.measures]
    track = survey.track.position
    return head, {
        "documents": [{"body": body}],
        "measures": measures,
        "patches": patches,
        "individuals": list(_individuals(survey, site)),
        # A line has two ends at least.
        "tracks": [{"geom": wkb.line(_places(site, track))}] if len(track) > 1 else [],
        "decisions": list(_decisions(survey, site)),
    }


def digest(body: bytes) -> str:
    """By which it is known what a survey's file holds."""
    return hashlib.sha256(body).hexdigest()


def time(moment: datetime) -> str:
    """As tables hold a time: ISO 8601 in UTC, to the millisecond."""
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _measure(measure: Measure, patch: int | None) -> Row:
    return {
        "patch": patch,
        "name": _text(measure.name),
        "value": measure.value,
        "low": measure.low,
        "high": measure.high,
        "unit": _text(measure.unit),
        "note": _text(measure.note),
    }


def _individuals(survey: Survey, site: Site) -> Iterator[Row]:
    them = survey.individuals
    longitude, latitude = globe.degrees(site, them.position[:, 0], them.position[:, 1])
    tells_clear = survey.tells_clear
    for k in range(len(them)):
        yield {
            "patch": int(them.patch[k]) + 1 if them.patch[k] >= 0 else None,
            "z_m": float(them.position[k, 2]),
            "sigma_m": float(them.sigma[k]),
            "size_m": float(them.size[k]),
            "size_sigma_m": float(them.size_sigma[k]),
            "hits": int(them.hits[k]),
            "looks": int(them.looks[k]),
            "confidence": float(them.confidence[k]),
            "clear": int(them.clear[k]) if tells_clear else None,
            "geom": wkb.point(longitude[k], latitude[k]),
        }


def _decisions(survey: Survey, site: Site) -> Iterator[Row]:
    for one in survey.decisions:
        longitude, latitude = globe.degrees(site, one.x, one.y)
        why = one.reasoning
        yield {
            "step": one.step,
            "time_s": one.time,
            "turn_deg": math.degrees(one.turn),
            "advance_m": one.advance,
            "distribution": _text(why.distribution),
            "target_area": _text(why.target_area),
            "completion": _text(why.completion),
            "next_target": _text(why.next_target),
            "safety": _text(why.safety),
            "action": _text(why.action),
            "note": _text(one.note),
            "geom": wkb.point(float(longitude), float(latitude)),
        }


def _text(words: str) -> str:
    """As a database takes it: a model may say what has no place in one."""
    return words.replace("\x00", "\ufffd").encode("utf-8", "replace").decode()


def _places(site: Site, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.column_stack(globe.degrees(site, points[:, 0], points[:, 1]))
