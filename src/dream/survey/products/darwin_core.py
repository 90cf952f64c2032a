"""Individuals as Darwin Core occurrences, as OBIS asks for what a machine saw and a machine named.

Rows are of those that were found and are likelier than not to be one. They are not all that there are, and
nothing is to be concluded from their number: that is an estimate, and stands among the measures.

Required by OBIS: occurrenceID, eventDate, decimalLongitude, decimalLatitude, scientificName,
scientificNameID, occurrenceStatus, basisOfRecord; for imagery MachineObservation, and PredictedByMachine as
the status of an identification that nobody has checked (manual.obis.org). What the species is, a person says:
nothing is looked up and nothing is guessed.

What is found are clumps of shells. `individualCount` counts single animals, which nobody did; so it is left
out, and `organismQuantity` tells of one clump (OBIS manual, "Abundance vs Count data").

`darwin-core.zip` is a Darwin Core Archive: occurrences as the core, sizes and confidences as OBIS's
measurements, `meta.xml` which says what the columns are, and `eml.xml` where it is known who made it and
under which licence. Measurements have the ids of the NERC vocabulary server where it has a term that says
what they are, and none where it has not; `measurementValueID` is of facts, and not of numbers.
"""

from __future__ import annotations

import csv
import io
import math
import re
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, timedelta
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from dream.survey.boxes import box, held
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.sheet import corners_of
from dream.survey.products.tables import harmless
from dream.survey.products.words import warning
from dream.survey.site import Site
from dream.survey.survey import Survey
from dream.types import Target

CSV, ARCHIVE = "occurrence.csv", "darwin-core.zip"
DWC = "http://rs.tdwg.org/dwc/terms/"
OBIS = "http://rs.iobis.org/obis/terms/"
TERMS = {
    "license": "http://purl.org/dc/terms/license",
    "measurementTypeID": f"{OBIS}measurementTypeID",
    "measurementUnitID": f"{OBIS}measurementUnitID",
}
"""Columns whose terms are not Darwin Core's own."""
SOFTWARE = "The DREAM developers: DREAM, an open implementation"
"""As CITATION.cff names it."""
METHOD = "docs/survey-measures.md"
"""Where it says how individuals are found."""
LENGTH = "http://vocab.nerc.ac.uk/collection/P01/current/OBSINDLX/"
""""Length of biological entity specified elsewhere", with which the OBIS manual tells lengths (examples)."""
METRES = "http://vocab.nerc.ac.uk/collection/P06/current/ULAA/"
""""Metres" (OBIS manual, measurementUnitID)."""
DIMENSIONLESS = "http://vocab.nerc.ac.uk/collection/P06/current/UUUU/"
""""Dimensionless"."""
LICENCES = {
    "CC0-1.0": "http://creativecommons.org/publicdomain/zero/1.0/legalcode",
    "CC-BY-4.0": "http://creativecommons.org/licenses/by/4.0/legalcode",
    "CC-BY-NC-4.0": "http://creativecommons.org/licenses/by-nc/4.0/legalcode",
}
"""Those that OBIS and GBIF take, by their SPDX names, and their addresses as GBIF writes them."""
WITHIN = 2.4477
"""Standard errors of a circle that holds 95 % of a normal scatter over the ground: √(−2 ln 0.05)."""
LIKELY = 0.5
"""Confidence from which an individual is told to be present: a presence that is none would be believed."""
NAMESPACE = uuid.uuid5(uuid.NAMESPACE_OID, "DREAM survey")
"""Of our identifiers: the same survey gives the same ones again."""


@dataclass(frozen=True, slots=True)
class Species:
    """What the individuals are, as a person says."""

    name: str
    """Such as "Ostrea edulis", with or without its author."""
    id: str
    """Of the name in a register: for OBIS its LSID in WoRMS, `urn:lsid:marinespecies.org:taxname:...`."""

    def __post_init__(self) -> None:
        if not re.search(r"\w", self.name) or "\n" in self.name:
            raise ValueError(f"species: expected a scientific name, got {self.name!r}")
        if not re.fullmatch(r"(urn:lsid:[\w.-]+:\w+:\S+|https?://\S+)", self.id):
            raise ValueError(
                f"species id: expected the LSID or the address of {self.name} in a register, such as "
                f"urn:lsid:marinespecies.org:taxname:NUMBER, got {self.id!r}"
            )


@dataclass(frozen=True, slots=True)
class Author:
    """Who answers for the data, and on what terms they may be used."""

    name: str
    licence: str
    """As the owner chose it: one of `LICENCES`, or the address of another."""
    email: str = ""

    def __post_init__(self) -> None:
        if self.licence not in LICENCES and not re.fullmatch(r"https?://\S+", self.licence):
            raise ValueError(
                f"licence: expected {', '.join(LICENCES)}, or the address of another, got {self.licence!r}"
            )

    @property
    def licence_address(self) -> str:
        """Where the licence can be read."""
        return LICENCES.get(self.licence, self.licence)


def write(survey: Survey, species: Species, folder: Path, author: Author | None = None) -> list[Path]:
    """Write `occurrence.csv` and `darwin-core.zip`.

    Args:
        survey: With an origin, of a reef.
        species: Of all individuals.
        folder: To write to.
        author: For `eml.xml`, which is left out where nobody is named.

    Raises:
        ValueError: The survey has no origin, or is of a wreck.
        OSError: They cannot be written.
    """
    if survey.target is Target.WRECK:
        raise ValueError(f"{survey.name}: expected a survey of organisms, got one of a wreck")
    rows = occurrences(survey, species, author)
    measured = _measurements(survey, [row["occurrenceID"] for row in rows])
    occurrence = _csv(COLUMNS, rows)
    path, archive = folder / CSV, folder / ARCHIVE
    path.write_text(occurrence, encoding="utf-8")
    files = {
        CSV: occurrence,
        "extendedmeasurementorfact.csv": _csv(_MEASURED, measured),
        "meta.xml": _meta(COLUMNS, described=author is not None),
    }
    if author is not None:
        files["eml.xml"] = _eml(survey, species, author)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        for name, text in files.items():
            # A fixed date, so that the same survey gives the same bytes.
            file.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), text.encode(), zipfile.ZIP_DEFLATED)
    archive.write_bytes(content.getvalue())
    return [path, archive]


def occurrences(survey: Survey, species: Species, author: Author | None = None) -> list[dict[str, str]]:
    """One occurrence for each of `likely`, by the names of Darwin Core terms."""
    ground = Ground(site_of(survey))
    found = survey.individuals
    longitude, latitude = ground.globe(found.position[:, 0], found.position[:, 1])
    depth = ground.depth(found.position[:, 2])
    began = survey.began.astimezone(UTC)
    ended = began + timedelta(seconds=float(survey.track.time[-1]) if len(survey.track.time) else 0.0)
    when = "/".join(moment.strftime("%Y-%m-%dT%H:%M:%SZ") for moment in (began, ended))
    event = _identifier(survey, "event")
    version = str(survey.made_by.get("version", ""))
    free = {
        "scientificName": species.name,
        "identifiedBy": f"DREAM {version}".strip(),
        "identificationReferences": f"{SOFTWARE}{f', version {version}' if version else ''}, {METHOD}",
        "samplingProtocol": f"autonomous visual survey, DREAM protocol {survey.protocol}",
        "locality": ground.site.name,
        "verticalDatum": ground.site.datum,
    }
    common = {
        "basisOfRecord": "MachineObservation",
        "occurrenceStatus": "present",
        "scientificNameID": species.id,
        "identificationVerificationStatus": "PredictedByMachine",
        "eventID": event,
        "eventDate": when,
        "sampleSizeValue": f"{float((survey.layers.state != 0).sum()) * survey.layers.cell**2:.1f}",
        "sampleSizeUnit": "square metre",
        "geodeticDatum": "EPSG:4326",
        "organismQuantity": "1",
        "organismQuantityType": "clumps",
        "license": "" if author is None else author.licence_address,
        **{name: harmless(text) for name, text in free.items()},
    }
    # Whoever takes a row out of the file has to see it there.
    made_up = f"{text}; " if (text := warning(survey)) else ""
    return [
        {
            "occurrenceID": _identifier(survey, f"individual {n + 1}"),
            **common,
            "decimalLongitude": f"{longitude[n]:.7f}",
            "decimalLatitude": f"{latitude[n]:.7f}",
            "coordinateUncertaintyInMeters": _uncertainty(ground.site, float(found.sigma[n])),
            "minimumDepthInMeters": f"{depth[n]:.2f}",
            "maximumDepthInMeters": f"{depth[n]:.2f}",
            "occurrenceRemarks": f"{made_up}a clump of shells, how many animals are in it is not known; "
            f"found in {found.hits[n]} of {found.looks[n]} frames",
        }
        for n in likely(survey)
    ]


def likely(survey: Survey) -> list[int]:
    """Which individuals are told to be present: likely ones that some frame labelled."""
    found = survey.individuals
    rows: list[int] = np.flatnonzero((found.confidence >= LIKELY) & (found.hits > 0)).tolist()
    return rows


COLUMNS = (
    *("occurrenceID", "basisOfRecord", "occurrenceStatus", "scientificName", "scientificNameID"),
    *("identificationVerificationStatus", "identifiedBy", "identificationReferences"),
    *("eventID", "eventDate", "samplingProtocol"),
    *("sampleSizeValue", "sampleSizeUnit", "decimalLongitude", "decimalLatitude", "geodeticDatum"),
    *("coordinateUncertaintyInMeters", "minimumDepthInMeters", "maximumDepthInMeters", "verticalDatum"),
    *("locality", "organismQuantity", "organismQuantityType", "license", "occurrenceRemarks"),
)
_MEASURED = (
    "occurrenceID",
    "measurementType",
    "measurementTypeID",
    "measurementValue",
    "measurementAccuracy",
    "measurementUnit",
    "measurementUnitID",
    "measurementMethod",
    "measurementRemarks",
)


def _measurements(survey: Survey, ids: Sequence[str]) -> list[dict[str, str]]:
    found = survey.individuals
    made_up = warning(survey)
    rows = []
    for n, occurrence in zip(likely(survey), ids, strict=True):
        if found.clear[n]:
            rows.append(
                {
                    "occurrenceID": occurrence,
                    "measurementType": "longest diameter of the clump seen from above",
                    "measurementTypeID": LENGTH,
                    "measurementValue": f"{found.size[n]:.3f}",
                    "measurementAccuracy": f"{found.size_sigma[n]:.3f}",
                    "measurementUnit": "m",
                    "measurementUnitID": METRES,
                    "measurementMethod": "from labelled images and depth; the accuracy is one standard error",
                    "measurementRemarks": made_up,
                }
            )
        rows.append(
            {
                "occurrenceID": occurrence,
                "measurementType": "probability that it is a clump",
                "measurementTypeID": "",
                "measurementValue": f"{np.clip(found.confidence[n], 0.0, 1.0):.3f}",
                "measurementAccuracy": "",
                "measurementUnit": "1",
                "measurementUnitID": DIMENSIONLESS,
                "measurementMethod": "from how often it was found and could have been",
                "measurementRemarks": made_up,
            }
        )
    return rows


def _uncertainty(site: Site, sigma: float) -> str:
    """Metres that hold 95 % of how far one may be off; as the term asks, empty where nobody knows."""
    if site.uncertainty is None:
        return ""
    # Seven digits of a degree are a centimetre; 0 is no value that the term allows.
    return f"{max(0.01, math.hypot(WITHIN * sigma, site.uncertainty)):.2f}"


def _identifier(survey: Survey, what: str) -> str:
    """The same for the same survey on every machine, and no other's."""
    site = site_of(survey)
    of = "|".join(
        (
            site.name,
            f"{site.latitude:.7f}",
            f"{site.longitude:.7f}",
            survey.began.isoformat(),
            survey.name,
            what,
        )
    )
    return f"urn:uuid:{uuid.uuid5(NAMESPACE, of)}"


def _csv(columns: Sequence[str], rows: Sequence[Mapping[str, str]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _meta(columns: Sequence[str], *, described: bool) -> str:
    """What the columns of the archive are (Darwin Core text guide)."""
    layout = (
        'encoding="UTF-8" fieldsTerminatedBy="," linesTerminatedBy="\\n" '
        'fieldsEnclosedBy="&quot;" ignoreHeaderLines="1"'
    )
    core, more = (
        "".join(
            f'<field index="{n}" term="{TERMS.get(name, DWC + name)}"/>'
            for n, name in enumerate(names)
            if name != joined
        )
        for names, joined in ((columns, ""), (_MEASURED, "occurrenceID"))
    )
    metadata = ' metadata="eml.xml"' if described else ""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<archive xmlns="http://rs.tdwg.org/dwc/text/"{metadata}>'
        f'<core {layout} rowType="{DWC}Occurrence"><files><location>{CSV}</location></files>'
        f'<id index="0"/>{core}</core>'
        f'<extension {layout} rowType="{OBIS}ExtendedMeasurementOrFact">'
        "<files><location>extendedmeasurementorfact.csv</location></files>"
        f'<coreid index="0"/>{more}</extension></archive>\n'
    )


def _eml(survey: Survey, species: Species, author: Author) -> str:
    """What the data set is (Ecological Metadata Language 2.2)."""
    ground = Ground(site_of(survey))
    # Of the area, of all that was found, and of the origin, which stands for the whole in a row.
    holds = held(corners_of(survey.area), survey.individuals.position, np.zeros((1, 2)))
    west, south, east, north = box(ground.globe, holds)
    day = survey.began.astimezone(UTC).strftime("%Y-%m-%d")
    email = f"<electronicMailAddress>{escape(author.email)}</electronicMailAddress>" if author.email else ""
    party = f"<individualName><surName>{escape(author.name)}</surName></individualName>{email}"
    edges = (
        f"<westBoundingCoordinate>{_down(west)}</westBoundingCoordinate>"
        f"<eastBoundingCoordinate>{_up(east)}</eastBoundingCoordinate>"
        f"<northBoundingCoordinate>{_up(north)}</northBoundingCoordinate>"
        f"<southBoundingCoordinate>{_down(south)}</southBoundingCoordinate>"
    )
    told = warning(survey)
    made_up = "SIMULATED: " if told else ""
    licence, address = escape(author.licence), author.licence_address
    title = f"{made_up}{species.name} at {ground.site.name}, {day}, seen by an autonomous underwater vehicle"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<eml:eml xmlns:eml="https://eml.ecoinformatics.org/eml-2.2.0" '
        f'packageId={quoteattr(_identifier(survey, "data set"))} system="DREAM"><dataset>'
        f"<title>{escape(title)}</title><creator>{party}</creator><pubDate>{day}</pubDate>"
        f"<language>eng</language><abstract><para>{escape(f'{told}. ' if told else '')}"
        "Clumps of shells that were found, located and sized across the "
        "frames of one mission, each once. Others hide under and beside them and have no record: the "
        "number of records is no count. Identified by a machine, not verified by a person.</para></abstract>"
        f"<intellectualRights><para>This work is licensed under <ulink url={quoteattr(address)}>"
        f"<citetitle>{licence}</citetitle></ulink>.</para></intellectualRights>"
        f"<licensed><licenseName>{licence}</licenseName><url>{escape(address)}</url></licensed>"
        f"<coverage><geographicCoverage><geographicDescription>{escape(ground.site.name)}</geographicDescription>"
        f"<boundingCoordinates>{edges}</boundingCoordinates></geographicCoverage>"
        f"<temporalCoverage><singleDateTime><calendarDate>{day}</calendarDate></singleDateTime></temporalCoverage>"
        f"</coverage><contact>{party}</contact></dataset></eml:eml>\n"
    )


def _down(degrees: float) -> str:
    """With as many digits as places have, and not above."""
    return f"{math.floor(degrees * 1e7) / 1e7:.7f}"


def _up(degrees: float) -> str:
    """The same, not below."""
    return f"{math.ceil(degrees * 1e7) / 1e7:.7f}"
