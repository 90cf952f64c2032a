"""Survey → one file, and back.

The file is a ZIP of `header.json` and of NumPy arrays (`.npy`, no pickle), so that any program that reads
`.npz` finds the arrays in it. The same survey gives the same bytes. Everything is checked when it is written
and when it is read: a file that was read holds a survey that can be worked with.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from dream import arrays as reading
from dream.files import whole_or_nothing
from dream.geometry import Bounds
from dream.survey.patches import signed_area
from dream.survey.site import Site
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
from dream.types import Reasoning, Target

SUFFIX = ".survey.npz"
"""How files of surveys are called."""
MOST_BYTES = 256 << 20
"""A larger file is refused."""
MOST_HEADER = 64 << 20
"""Bytes of a header; most of it is the reasoning."""
MOST_ROWS = 2_000_000
"""Individuals, steps, points of rings: more are refused."""
MOST_SIDE = 8192
"""Cells along a side of the maps."""
FAR = 1e5
"""Metres: nothing of a survey is farther from its origin."""
LONG = 1e9
"""Seconds: no mission takes as long."""
YEARS = (1900, 9000)
"""Between which a survey began: clocks and calendars of other programs hold no others."""

Array = npt.NDArray[Any]
Arrays = Mapping[str, Array]

_INDIVIDUALS = {
    "position": "<f8",
    "sigma": "<f8",
    "size": "<f8",
    "size_sigma": "<f8",
    "hits": "<i4",
    "looks": "<i4",
    "confidence": "<f8",
    "patch": "<i4",
    "clear": "|b1",
}
_LAYERS = {"state": "|u1", "target_probability": "<f4", "relief": "<f4", "times_seen": "<u2"}
_TRACK = {"time": "<f8", "position": "<f8", "yaw": "<f8", "sigma": "<f8"}
_CELLS = {"position": "<f8", "side": "|u1", "state": "|u1"}
_TYPES = {
    **{f"individuals.{name}": kind for name, kind in _INDIVIDUALS.items()},
    **{f"layers.{name}": kind for name, kind in _LAYERS.items()},
    **{f"track.{name}": kind for name, kind in _TRACK.items()},
    "rings": "<f8",
    "picture.share": "|u1",
    **{f"cells.{name}": kind for name, kind in _CELLS.items()},
}
"""Of every array in the file; of a survey without a picture, that has no cells."""
VERSION: Final = 3
"""The newest of the files that are written; those of all versions before are read."""
_IN_THE_PLANE: Final = 2
"""Of the files of surveys without structures."""
_SINCE = {"individuals.clear": 2, **dict.fromkeys((f"cells.{name}" for name in _CELLS), 3)}
"""The version from which on files hold an array, where it is not the first."""
_HEADER = "header.json"

Text = Annotated[str, Field(max_length=20_000)]
Word = Annotated[str, Field(max_length=200)]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Site(_Part):
    name: Name
    latitude: float
    longitude: float
    heading_deg: float
    datum: Word
    datum_offset: float
    uncertainty: float | None = None


class _Measure(_Part):
    name: Name
    value: float | None
    low: float | None
    high: float | None
    unit: Word
    note: Text


class _Patch(_Part):
    rings: Annotated[list[Annotated[int, Field(ge=4, le=MOST_ROWS)]], Field(min_length=1, max_length=100_000)]
    """Points of each ring, in the order of the array `rings`."""
    measures: Annotated[list[_Measure], Field(max_length=1000)]


class _Side(_Part):
    kind: Literal["side", "end", "top", "underside"]
    bearing: float | None
    measures: Annotated[list[_Measure], Field(max_length=1000)]


class _Structure(_Part):
    axis: float
    measures: Annotated[list[_Measure], Field(max_length=1000)]
    sides: Annotated[list[_Side], Field(min_length=1, max_length=100)]
    cells: Annotated[int, Field(ge=0, le=MOST_ROWS)]
    """How many of the arrays `cells` are its own, in their order."""
    cell: Annotated[float, Field(gt=0.0, le=1000.0)]


class _Reasoning(_Part):
    distribution: Text
    target_area: Text
    completion: Text
    next_target: Text
    safety: Text
    action: Text


class _Decision(_Part):
    step: Annotated[int, Field(ge=0, le=MOST_ROWS)]
    time: float
    x: float
    y: float
    yaw: float
    turn: float
    advance: float
    reasoning: _Reasoning
    note: Text


class _Bounds(_Part):
    x_min: float
    y_min: float
    x_max: float
    y_max: float


class _Picture(_Part):
    bounds: _Bounds
    cell: Annotated[float, Field(gt=0.0, le=1000.0)]


class _Header(_Part):
    format: Literal["dream-survey"]
    version: Literal[1, 2, 3]
    name: Name
    began: AwareDatetime
    site: _Site | None
    target: Target
    protocol: Word
    area: _Bounds
    measures: Annotated[list[_Measure], Field(max_length=1000)]
    patches: Annotated[list[_Patch], Field(max_length=100_000)]
    layers: _Bounds
    cell: Annotated[float, Field(gt=0.0, le=1000.0)]
    picture: _Picture | None
    structures: Annotated[list[_Structure], Field(max_length=100_000)] = []
    decisions: Annotated[list[_Decision], Field(max_length=MOST_ROWS)]
    made_by: dict[str, Any]


def write(survey: Survey, path: Path) -> None:
    """Write a survey to a file: whole or not at all.

    Raises:
        ValueError: The survey is inconsistent; the message names the field.
        OSError: The file could not be written.
    """
    with appearing(survey, path):
        pass


@contextlib.contextmanager
def appearing(survey: Survey, path: Path) -> Iterator[None]:
    """Write a survey to a file that appears once the block is done; if that fails, nothing changes.

    Raises:
        ValueError: The survey is inconsistent; the message names the field.
        OSError: The file could not be written. All that takes room is written before the block.
    """
    data = dumped(survey)
    if path.is_dir():
        raise OSError(f"could not write {path} (it is a folder)")
    with whole_or_nothing(path) as partial:
        partial.write_bytes(data)
        yield


def read(path: Path) -> Survey:
    """The survey in a file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is too large, damaged, or holds no survey; the message names file and field.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected the file of a survey, got no file. They are made by dream survey"
        )
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got {path.stat().st_size}")
    return loaded(path.read_bytes(), str(path))


def dumped(survey: Survey) -> bytes:
    """What the file of a survey holds. The same survey gives the same bytes.

    Raises:
        ValueError: The survey is inconsistent.
    """
    text, arrays = _checked(survey)
    if len(text) > MOST_HEADER:
        raise ValueError(f"survey: expected a header of at most {MOST_HEADER} bytes, got {len(text)}")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        _put(file, _HEADER, text)
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, array, version=(1, 0), allow_pickle=False)
            _put(file, f"{name}.npy", content.getvalue())
    if buffer.tell() > MOST_BYTES:
        raise ValueError(f"survey: expected at most {MOST_BYTES} bytes, got {buffer.tell()}")
    return buffer.getvalue()


def check(survey: Survey) -> None:
    """Raise a ValueError where the parts of a survey do not fit each other; the message names the field."""
    _checked(survey)


def _checked(survey: Survey) -> tuple[bytes, Arrays]:
    """What a file of it would hold: the header and the arrays."""
    arrays = _arrays(survey)
    try:
        header = _header(survey)
        text = header.model_dump_json(exclude=None if survey.structures else {"structures"}).encode()
    except ValueError as error:  # pydantic's errors are some.
        raise ValueError(f"survey: {_first(error)}") from error
    _check(header, arrays, "survey")
    return text, arrays


def loaded(data: bytes, where: str) -> Survey:
    """The survey that such bytes hold.

    Args:
        data: As `dumped` gives them; at most `MOST_BYTES`.
        where: What errors call them.

    Raises:
        ValueError: They are damaged or hold no survey.
    """
    try:
        header, arrays = _unpacked(data)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    if "individuals.clear" not in arrays:
        # It does not say whose sizes are their own.
        arrays["individuals.clear"] = np.zeros(len(arrays["individuals.sigma"]), np.bool_)
    _check(header, arrays, where)
    return _survey(header, arrays, where)


def _put(file: zipfile.ZipFile, name: str, content: bytes) -> None:
    # Without the time of day, which would make other bytes each time.
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    file.writestr(entry, content, compress_type=zipfile.ZIP_DEFLATED, compresslevel=6)


def _unpacked(data: bytes) -> tuple[_Header, dict[str, Array]]:
    """Header and arrays of a file; whether they fit each other is not looked at."""
    with reading.opened(data, "the file of a survey", 4 * MOST_BYTES) as file:
        # Of the version that it is most like.
        wrong = min((_entries(k) ^ file.entries for k in range(VERSION, 0, -1)), key=len)
        if wrong:
            raise ValueError(f"entries that are missing or foreign: {', '.join(sorted(wrong))[:200]}")
        content = file.content(_HEADER, MOST_HEADER)
        try:
            header = _Header.model_validate_json(content)
        except ValueError as error:
            raise ValueError(_first(error)) from error
        if file.entries != _entries(header.version):
            raise ValueError(f"version: expected the arrays of {header.version}, got those of another")
        arrays = {}
        for name in file:
            kind, (shape, found, fortran, _) = np.dtype(_TYPES[name]), file.headers[name]
            if fortran or found != kind:
                raise ValueError(f"{name}: expected an array of {kind}, got {found} {shape}")
            arrays[name] = file[name]
        return header, arrays


def _entries(version: int) -> set[str]:
    """Of a file of such a version."""
    return {_HEADER, *(f"{name}.npy" for name in _TYPES if _SINCE.get(name, 1) <= version)}


def _first(error: ValueError) -> str:
    """The first of what is wrong, in one line."""
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors(include_url=False)[0]
    where = ".".join(map(str, first["loc"])) or "the header"
    return f"{where}: {first['msg']}, got {str(first['input'])[:80]!r}"


def _arrays(survey: Survey) -> dict[str, Array]:
    rings = [ring for patch in survey.patches for ring in patch.rings]
    found = {
        **{f"individuals.{name}": getattr(survey.individuals, name) for name in _INDIVIDUALS},
        **{f"layers.{name}": getattr(survey.layers, name) for name in _LAYERS},
        **{f"track.{name}": getattr(survey.track, name) for name in _TRACK},
        "picture.share": np.zeros((0, 0), np.uint8) if survey.picture is None else survey.picture.share,
        "rings": np.concatenate([np.asarray(ring, np.float64).reshape(-1, 2) for ring in rings])
        if rings
        else np.zeros((0, 2)),
    }
    if parts := [part.cells for part in survey.structures]:
        found |= {f"cells.{name}": np.concatenate([getattr(one, name) for one in parts]) for name in _CELLS}
    arrays = {}
    for name, value in found.items():
        array, kind = np.asarray(value), np.dtype(_TYPES[name])
        if not np.can_cast(array.dtype, kind, "same_kind") or (
            kind.kind in "iu" and array.size and not _fits(array, kind)
        ):
            raise ValueError(f"survey: {name}: expected values of {kind}, got {array.dtype}")
        arrays[name] = np.ascontiguousarray(array, kind)
    return arrays


def _fits(array: Array, kind: np.dtype[Any]) -> bool:
    limits = np.iinfo(kind)
    return bool(array.min() >= limits.min and array.max() <= limits.max)


def _header(survey: Survey) -> _Header:
    site, layers = survey.site, survey.layers
    return _Header(
        format="dream-survey",
        version=VERSION if survey.structures else _IN_THE_PLANE,
        name=survey.name,
        began=survey.began,
        site=None
        if site is None
        else _Site(
            name=site.name,
            latitude=site.latitude,
            longitude=site.longitude,
            heading_deg=site.heading_deg,
            datum=site.datum,
            datum_offset=site.datum_offset,
            uncertainty=site.uncertainty,
        ),
        target=survey.target,
        protocol=survey.protocol,
        area=_box(survey.area),
        measures=_measures(survey.measures),
        patches=[
            _Patch(rings=[len(ring) for ring in patch.rings], measures=_measures(patch.measures))
            for patch in survey.patches
        ],
        layers=_box(layers.bounds),
        cell=layers.cell,
        picture=None
        if survey.picture is None
        else _Picture(bounds=_box(survey.picture.bounds), cell=survey.picture.cell),
        structures=[
            _Structure(
                axis=one.axis,
                measures=_measures(one.measures),
                sides=[
                    _Side.model_validate(
                        {"kind": side.kind, "bearing": side.bearing, "measures": _measures(side.measures)}
                    )
                    for side in one.sides
                ],
                cells=len(one.cells.side),
                cell=one.cell,
            )
            for one in survey.structures
        ],
        decisions=[
            _Decision(
                step=one.step,
                time=one.time,
                x=one.x,
                y=one.y,
                yaw=one.yaw,
                turn=one.turn,
                advance=one.advance,
                reasoning=_Reasoning(**{name: getattr(one.reasoning, name) for name in _REASONING}),
                note=one.note,
            )
            for one in survey.decisions
        ],
        # As JSON holds it, so that what is written is what is read.
        made_by=json.loads(json.dumps(survey.made_by, allow_nan=False, sort_keys=True)),
    )


_REASONING = tuple(_Reasoning.model_fields)


def _box(bounds: Bounds) -> _Bounds:
    return _Bounds(x_min=bounds.x_min, y_min=bounds.y_min, x_max=bounds.x_max, y_max=bounds.y_max)


def _measures(measures: tuple[Measure, ...]) -> list[_Measure]:
    return [
        _Measure(name=m.name, value=m.value, low=m.low, high=m.high, unit=m.unit, note=m.note)
        for m in measures
    ]


def _survey(header: _Header, arrays: Arrays, where: str) -> Survey:
    def part(prefix: str) -> dict[str, Any]:
        return {name.split(".")[1]: array for name, array in arrays.items() if name.startswith(prefix)}

    def measures(found: list[_Measure]) -> tuple[Measure, ...]:
        return tuple(Measure(**one.model_dump()) for one in found)

    patches, start = [], 0
    for patch in header.patches:
        ends = start + np.cumsum(patch.rings)
        rings = np.split(arrays["rings"][start : ends[-1]], ends[:-1] - start)
        patches.append(Patch(tuple(rings), measures(patch.measures)))
        start = int(ends[-1])
    structures, start = [], 0
    for one in header.structures:
        own = {name: array[start : start + one.cells] for name, array in part("cells.").items()}
        sides = tuple(StructureSide(side.kind, side.bearing, measures(side.measures)) for side in one.sides)
        structures.append(SurveyedStructure(one.axis, measures(one.measures), sides, Cells(**own), one.cell))
        start += one.cells
    try:
        return Survey(
            name=header.name,
            began=header.began,
            site=None if header.site is None else Site(**header.site.model_dump()),
            target=header.target,
            protocol=header.protocol,
            area=Bounds(**header.area.model_dump()),
            measures=measures(header.measures),
            individuals=Individuals(**part("individuals.")),
            patches=tuple(patches),
            layers=Layers(bounds=Bounds(**header.layers.model_dump()), cell=header.cell, **part("layers.")),
            track=Track(**part("track.")),
            decisions=tuple(
                DecisionPoint(
                    **{name: getattr(one, name) for name in _PLAIN},
                    reasoning=Reasoning(**one.reasoning.model_dump()),
                )
                for one in header.decisions
            ),
            made_by=header.made_by,
            picture=None
            if header.picture is None
            else Picture(
                Bounds(**header.picture.bounds.model_dump()), header.picture.cell, arrays["picture.share"]
            ),
            structures=tuple(structures),
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


_PLAIN = tuple(name for name in _Decision.model_fields if name != "reasoning")


def _check(header: _Header, arrays: Arrays, where: str) -> None:
    """Raise a ValueError where the parts of a survey do not fit each other."""

    def expect(holds: Any, name: str, expected: str, got: Any) -> None:
        if not holds:
            raise ValueError(f"{where}: {name}: expected {expected}, got {got}")

    def cells(box: _Bounds, cell: float, name: str) -> tuple[int, ...]:
        sides = ((box.y_max - box.y_min) / cell, (box.x_max - box.x_min) / cell)
        whole = tuple(round(side) if math.isfinite(side) and side < 2 * MOST_SIDE else 0 for side in sides)
        expect(
            all(
                1 <= n <= MOST_SIDE and abs(n - side) < 1e-6 * n for n, side in zip(whole, sides, strict=True)
            ),
            f"{name}.bounds",
            f"1 to {MOST_SIDE} whole cells of {cell:g} m a side",
            f"{sides[0]:g} x {sides[1]:g}",
        )
        return whole

    if bool(header.structures) != (header.version == VERSION):
        raise ValueError(f"{where}: structures: expected some in version {VERSION} alone, got others")
    whole = cells(header.layers, header.cell, "layers")
    fine = (0, 0) if header.picture is None else cells(header.picture.bounds, header.picture.cell, "picture")
    people, steps, points = len(arrays["individuals.sigma"]), len(arrays["track.time"]), len(arrays["rings"])
    expect(
        max(people, steps, points) <= MOST_ROWS, "rows", f"at most {MOST_ROWS}", max(people, steps, points)
    )
    for name, array in arrays.items():
        shape: tuple[int, ...] = (people,)
        if name == "individuals.position":
            shape = (people, 3)
        elif name.startswith("layers."):
            shape = whole
        elif name.startswith("track."):
            shape = (steps, 3) if name == "track.position" else (steps,)
        elif name == "picture.share":
            shape = fine
        elif name.startswith("cells."):
            known = sum(one.cells for one in header.structures)
            shape = (known, 3) if name == "cells.position" else (known,)
        elif name == "rings":
            shape = (sum(sum(patch.rings) for patch in header.patches), 2)
        expect(array.shape == shape, name, f"shape {shape}", array.shape)
        if array.dtype.kind == "f" and not name.startswith("layers."):
            expect(np.isfinite(array).all(), name, "finite numbers", "NaN or infinity")
    for name in ("individuals.position", "track.position", "rings", "cells.position"):
        if name not in arrays:
            continue
        expect(not (np.abs(arrays[name]) > FAR).any(), name, f"metres within ±{FAR:g}", "more")
    expect(not (np.abs(arrays["track.time"]) > LONG).any(), "track.time", f"seconds within ±{LONG:g}", "more")
    expect(YEARS[0] <= header.began.year <= YEARS[1], "began", "a year from 1900 to 9000", header.began.year)
    boxes = {"area": header.area, "layers.bounds": header.layers}
    boxes |= {} if header.picture is None else {"picture.bounds": header.picture.bounds}
    for name, box in boxes.items():
        far = max(map(abs, (box.x_min, box.y_min, box.x_max, box.y_max)))
        expect(far <= FAR, name, f"metres within ±{FAR:g}", f"{far:g}")
    for one in header.decisions:
        near = max(abs(one.x), abs(one.y)) <= FAR and abs(one.time) <= LONG
        expect(near, "decisions", f"metres within ±{FAR:g} and seconds within ±{LONG:g}", f"step {one.step}")
    for name in ("individuals.sigma", "individuals.size", "individuals.size_sigma", "track.sigma"):
        expect(not (arrays[name] < 0.0).any(), name, "0 or more", "less")
    hits, looks = arrays["individuals.hits"], arrays["individuals.looks"]
    expect(not ((hits < 0) | (hits > looks)).any(), "individuals.hits", "0 to as many as the looks", "others")
    sure = arrays["individuals.confidence"]
    expect(not ((sure < 0.0) | (sure > 1.0)).any(), "individuals.confidence", "0 to 1", "others")
    # Of a byte that is neither NumPy makes what it likes.
    clear = arrays["individuals.clear"].view(np.uint8)
    expect(not (clear > 1).any(), "individuals.clear", "yes or no", "other bytes")
    patch = arrays["individuals.patch"]
    count = len(header.patches)
    expect(
        not ((patch < -1) | (patch >= count)).any(),
        "individuals.patch",
        f"−1 to {count - 1}",
        "other indices",
    )
    expect(not (arrays["layers.state"] > 4).any(), "layers.state", "values of 0 to 4", "others")
    share = arrays["layers.target_probability"]
    expect(not ((share < 0.0) | (share > 1.0)).any(), "layers.target_probability", "0 to 1 or NaN", "others")
    share = arrays["picture.share"]
    expect(not ((share > 200) & (share < 255)).any(), "picture.share", "0 to 200 or 255", "others")
    expect(not np.isinf(arrays["layers.relief"]).any(), "layers.relief", "metres or NaN", "infinity")
    _check_measures(header, where)
    first = 0
    for number, structure in enumerate(header.structures):
        sides = arrays["cells.side"][first : first + structure.cells]
        first += structure.cells
        least = len(structure.sides)
        expect(not (sides >= least).any(), f"structures.{number}.cells.side", f"0 to {least - 1}", "others")
    start = 0
    for number, part in enumerate(header.patches):
        for hole, length in enumerate(part.rings):
            ring = arrays["rings"][start : start + length]
            start += length
            name = f"patches.{number}.rings.{hole}"
            expect((ring[0] == ring[-1]).all(), name, "a last point that is the first", ring[-1].tolist())
            if hole == 0:
                turn = signed_area(ring)
                expect(turn > 0.0, name, "an outline counter-clockwise, with an area", f"{turn:g} m2")


def _check_measures(header: _Header, where: str) -> None:
    of_parts = [part.measures for part in header.patches]
    for structure in header.structures:
        of_parts += [structure.measures, *(side.measures for side in structure.sides)]
    for measure in (*header.measures, *(one for measures in of_parts for one in measures)):
        low, high = measure.low, measure.high
        if (low is None) != (high is None) or (low is not None and high is not None and low > high):
            raise ValueError(
                f"{where}: {measure.name}: expected an interval from low to high, got {low} to {high}"
            )
