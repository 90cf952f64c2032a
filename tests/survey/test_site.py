"""Site files: what is wrong in one is said with what was expected and what may have been meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from dream.survey.site import Site, read_site

FIELDS = "name, latitude, longitude, heading_deg, datum, datum_offset, uncertainty"


def test_a_site_file_says_where_a_run_was(tmp_path: Path) -> None:
    path = tmp_path / "site.json"
    path.write_text('{"name": "Inner reef", "latitude": 54.9, "longitude": -8.3, "datum": "MLLW"}')
    assert read_site(path) == Site("Inner reef", 54.9, -8.3, datum="MLLW")
    path.write_text('{"name": "Inner reef", "latitude": 54.9, "longitude": -8.3, "uncertainty": 2.5}')
    assert read_site(path) == Site("Inner reef", 54.9, -8.3, uncertainty=2.5)


@pytest.mark.parametrize(
    ("where", "complaint"),
    [
        (
            '"latitude": "38,97", "longitude": 8',
            "latitude: expected decimal degrees north such as 38.97, got '38,97'. Write 38.97",
        ),
        (
            '"latitude": 38,97, "longitude": 8',
            "latitude: expected a decimal point, got 38,97. Write 38.97",
        ),
        (
            '"latitude": 5.0, "longitude": -8,31',
            "longitude: expected a decimal point, got -8,31. Write -8.31",
        ),
        (
            '"latitude": "38°58\' N", "longitude": 8',
            'latitude: expected decimal degrees north such as 38.97, got "38°58\' N"',
        ),
        ('"lat": 38.97, "lon": 8', f'no field "lat". Did you mean "latitude"? There are: {FIELDS}'),
        ('"latitude": 38.97, "lon": 8', f'no field "lon". Did you mean "longitude"? There are: {FIELDS}'),
        ('"latitude": 38.97, "lng": 8', f'no field "lng". Did you mean "longitude"? There are: {FIELDS}'),
        ('"latitude": 1, "longitude": 8, "x": 3', f'no field "x". There are: {FIELDS}'),
        (
            '"latitude": 151.2, "longitude": -33.85',
            "site: latitude: expected a number within ±90, got 151.2. Are latitude and longitude swapped?",
        ),
        (
            '"latitude": 151.2, "longitude": 133.85',
            "site: latitude: expected a number within ±90, got 151.2",
        ),
        (
            '"latitude": 33.85, "longitude": 208.3',
            "site: longitude: expected a number within ±180, got 208.3. West of Greenwich it is negative: "
            "-151.7",
        ),
        (
            '"latitude": 54.9',
            "longitude: expected decimal degrees east such as 8.31, which are negative west of Greenwich, "
            "got none",
        ),
        (
            '"latitude": 1, "longitude": 2, "uncertainty": -1',
            "site: uncertainty: expected 0 to 10000 metres, got -1.0",
        ),
        (
            '"latitude": 1, "longitude": 2, "uncertainty": "2 m"',
            "uncertainty: expected metres such as 5, got '2 m'",
        ),
        # Which some libraries take for 1.
        (
            '"latitude": 1, "longitude": 2, "uncertainty": true',
            "uncertainty: expected metres such as 5, got 'True'",
        ),
        (
            '"latitude": true, "longitude": 2',
            "latitude: expected decimal degrees north such as 38.97, got 'True'",
        ),
        (
            '"latitude": 1, "longitude": 2, "heading_deg": null',
            "heading_deg: expected decimal degrees clockwise from north such as 20.5, got 'None'",
        ),
    ],
)
def test_what_is_wrong_in_a_site_file_is_said_with_what_was_meant(
    where: str, complaint: str, tmp_path: Path
) -> None:
    path = tmp_path / "site.json"
    path.write_text(f'{{"name": "Inner reef", {where}}}')
    with pytest.raises(ValueError) as caught:
        read_site(path)
    assert str(caught.value) == f"{path}: {complaint}"


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("[1]", "the whole: Input should be an object, got '[1]'"),
        ('{"name": ', "the whole: Invalid JSON"),
        (f'{{"name": "{"x" * 201}", "latitude": 1, "longitude": 2}}', "name: String should have at most 200"),
        (
            '{"name": "", "latitude": 1, "longitude": 2}',
            "name: expected a name such as \"Inner reef\", got ''",
        ),
    ],
)
def test_what_is_no_site_file_is_refused(content: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "site.json"
    path.write_text(content)
    with pytest.raises(ValueError) as caught:
        read_site(path)
    assert str(caught.value).startswith(f"{path}: {complaint}")
