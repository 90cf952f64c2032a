"""Where on earth a run took place."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from dream.files import whole_or_nothing
from dream.names import look_up

Float64Array = npt.NDArray[np.float64]

MOST_BYTES = 1 << 16
"""A larger site file is refused."""
FARTHEST = 10_000.0
"""Metres: places that are less certain are none."""


@dataclass(frozen=True, slots=True)
class Site:
    """The origin of a run's `world` on the globe, its heading and its depth datum."""

    name: str
    latitude: float
    """Degrees north, WGS 84, of the local origin."""
    longitude: float
    """Degrees east."""
    heading_deg: float = 0.0
    """True bearing of the local y axis, clockwise from north: 0 where y is north and x is east."""
    datum: str = "local sea surface"
    """What depths are below: a chart datum such as MLLW."""
    datum_offset: float = 0.0
    """Metres from the datum up to the local z = 0."""
    uncertainty: float | None = None
    """Metres that hold 95 % of how far places lie from where these say, by the origin and the heading; None
    where nobody said."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise ValueError("site: expected a name, got none")
        limits = {"latitude": 90.0, "longitude": 180.0, "heading_deg": 360.0, "datum_offset": 12_000.0}
        for field, limit in limits.items():
            value = getattr(self, field)
            if not (math.isfinite(value) and abs(value) <= limit):
                raise ValueError(
                    f"site: {field}: expected a number within ±{limit:g}, got {value}{self._hint(field)}"
                )
        if self.uncertainty is not None and not 0.0 <= self.uncertainty <= FARTHEST:
            raise ValueError(f"site: uncertainty: expected 0 to {FARTHEST:g} metres, got {self.uncertainty}")

    def is_called(self, name: str) -> bool:
        """Is that its name, however it is written?"""
        return self.name.strip().casefold() == name.strip().casefold()

    def _hint(self, field: str) -> str:
        """What somebody may have meant by a number that is out of range."""
        if field == "latitude" and 90.0 < abs(self.latitude) <= 180.0 and abs(self.longitude) <= 90.0:
            return ". Are latitude and longitude swapped?"
        if field == "longitude" and 180.0 < self.longitude <= 360.0:
            return f". West of Greenwich it is negative: {self.longitude - 360.0:.9g}"
        return ""

    def east_north(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Metres true east and north of the origin for points of the world."""
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        bearing = math.radians(self.heading_deg)
        c, s = math.cos(bearing), math.sin(bearing)
        return c * x + s * y, -s * x + c * y


def _no_truth(value: object) -> object:
    """Refuse what pydantic takes for 1 or 0."""
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return value


_Number = Annotated[float, BeforeValidator(_no_truth)]


class _File(BaseModel):
    """`site.json`, as an operator writes it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Annotated[str, Field(min_length=1, max_length=200)]
    latitude: _Number
    longitude: _Number
    heading_deg: _Number = 0.0
    datum: Annotated[str, Field(max_length=200)] = "local sea surface"
    datum_offset: _Number = 0.0
    uncertainty: _Number | None = None


def write_site(site: Site, path: Path) -> None:
    """Write a site file, as `read_site` reads it: whole or not at all.

    Raises:
        OSError: It could not be written.
    """
    with whole_or_nothing(path) as partial:
        partial.write_text(json.dumps(asdict(site), indent=2) + "\n", encoding="utf-8")


def read_site(path: Path) -> Site:
    """A site from a JSON file with the fields of `Site`.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It does not say a site; the message names what is wrong.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f'{path}: expected a site file such as {{"name": "Inner reef", "latitude": 54.9, "longitude": '
            "8.3}, got no file"
        )
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got {path.stat().st_size}")
    try:
        return Site(**_fields(path.read_bytes()).model_dump())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


_EXPECTED = {
    "name": 'a name such as "Inner reef"',
    "latitude": "decimal degrees north such as 38.97",
    "longitude": "decimal degrees east such as 8.31, which are negative west of Greenwich",
    "heading_deg": "decimal degrees clockwise from north such as 20.5",
    "datum": "a chart datum such as MLLW",
    "datum_offset": "metres such as 0.5",
    "uncertainty": "metres such as 5",
}
_COMMA = r"(-?\d+)\s*,\s*(\d+)"


def _fields(content: bytes) -> _File:
    """What a site file says. Raises a ValueError: what was expected, what it says, what it may have meant."""
    try:
        return _File.model_validate_json(content)
    except ValidationError as error:
        wrong = error.errors(include_url=False)
    # Of a field under another name the right one is missing, too.
    first = min(wrong, key=lambda one: one["type"] != "extra_forbidden")
    field = ".".join(map(str, first["loc"]))
    if first["type"] == "extra_forbidden":
        look_up(_File.model_fields, field, "field")
    text = content.decode("utf-8", "replace")
    if first["type"] == "json_invalid" and (comma := re.search(rf'"(\w+)"\s*:\s*{_COMMA}', text)):
        field, whole, rest = comma.groups()
        raise ValueError(f"{field}: expected a decimal point, got {whole},{rest}. Write {whole}.{rest}")
    got = str(first["input"])[:80] if field else text[:80]
    if field not in _EXPECTED or first["type"] == "string_too_long":
        raise ValueError(f"{field or 'the whole'}: {first['msg']}, got {got!r}")
    if first["type"] == "missing":
        raise ValueError(f"{field}: expected {_EXPECTED[field]}, got none")
    hint = f". Write {comma[1]}.{comma[2]}" if (comma := re.fullmatch(rf"\s*{_COMMA}\s*", got)) else ""
    raise ValueError(f"{field}: expected {_EXPECTED[field]}, got {got!r}{hint}")
