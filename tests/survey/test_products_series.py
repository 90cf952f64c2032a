"""How the measures of a site went: a table for programs, a picture for people."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from dream.survey import Measure, Survey
from dream.survey.products import figures, page, pdf, series, sheet
from tests.survey.browsing import Seen
from tests.survey.scenes import reef, wreck

HEADLINES = ["reef_area", "density", "median_size", "reef_height"]


def surveys(*days: float) -> list[Survey]:
    """One each so many days after the first, whose reef grows by a square metre each time."""
    return [
        replace(
            reef(),
            name=f"number {n}",
            began=reef().began + timedelta(days=day),
            measures=(Measure("reef_area", 30.0 + n, 29.0, 33.0 + n, "m2"), *reef().measures[1:]),
        )
        for n, day in enumerate(days)
    ]


def test_a_row_for_each_measure_of_each_survey(tmp_path: Path) -> None:
    series.write(surveys(0, 365), tmp_path)
    rows = list(csv.DictReader((tmp_path / "series.csv").read_text().splitlines()))
    assert len(rows) == 2 * len(reef().measures)
    areas = [row for row in rows if row["measure"] == "reef_area"]
    assert areas[1] == {
        "survey": "number 1",
        "date": "2027-06-01T09:30:00Z",
        "measure": "reef_area",
        "value": "31",
        "low": "29",
        "high": "34",
        "unit": "m2",
        "simulated": "world made/by-hand, seed 1",
    }
    assert [row["value"] for row in rows if row["measure"] == "rugosity"] == ["", ""], "not measured"


def test_a_panel_for_each_main_measure_with_the_interval_of_each_survey() -> None:
    unsure = surveys(0, 365, 730)
    unsure[1] = replace(
        unsure[1],
        measures=tuple(
            replace(m, value=None, low=None, high=None) if m.name == "median_size" else m
            for m in unsure[1].measures
        ),
    )
    with sheet.settings():
        panels = figures.series_figure(unsure).axes
    assert [panel.get_title(loc="left") for panel in panels] == [
        "Reef area, m²",
        "Density, per m²",
        "Median size, m",
        "Reef height, m",
    ]
    area, size = panels[0], panels[2]
    assert np.asarray(area.lines[-1].get_ydata()).tolist() == [30.0, 31.0, 32.0]
    bars = [segment[:, 1].tolist() for segment in area.collections[0].get_segments()]  # type: ignore[attr-defined]
    assert bars == [[29.0, 33.0], [29.0, 34.0], [29.0, 35.0]]
    assert area.get_ylim()[0] == 0.0, "or a change looks larger than it is"
    assert [text.get_text() for text in area.get_xticklabels()] == ["1 Jun 2026", "1 Jun 2027", "31 May 2028"]
    assert np.isfinite(np.asarray(size.lines[-1].get_ydata(), float)).sum() == 2, (
        "what was not measured has no point"
    )


@pytest.mark.parametrize(
    ("days", "told"),
    [
        ((0, 10, 365, 730), ["1 Jun 2026", "", "1 Jun 2027", "31 May 2028"]),
        ((0, 0.1, 0.2), ["09:30:00", "11:54:00", "14:18:00"]),
        ((0, 0), ["09:30:00"]),
    ],
)
def test_dates_do_not_cover_each_other(days: tuple[float, ...], told: list[str]) -> None:
    panel = figures.series_figure(surveys(*days)).axes[0]
    assert [text.get_text() for text in panel.get_xticklabels()] == told


def test_a_picture_of_what_is_simulated_says_so() -> None:
    real = [replace(one, made_by={}) for one in surveys(0, 365)]
    for several, said in ((surveys(0, 365), True), ([real[0], surveys(0, 365)[1]], True), (real, False)):
        assert ("SIMULATED" in str(figures.series_figure(several).get_suptitle())) == said


def test_the_same_surveys_give_the_same_picture(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        series.write(surveys(0, 365), tmp_path / name)
    assert (tmp_path / "one/series.png").read_bytes() == (tmp_path / "two/series.png").read_bytes()


@pytest.mark.rare
def test_reports_show_the_series_where_there_is_one(tmp_path: Path) -> None:
    several = surveys(0, 365)
    for told in ([], several[:1], several):
        page.write(several[-1], tmp_path / "report.html", surveys=told)
        pdf.write(several[-1], tmp_path / "report.pdf", told)
        seen = Seen((tmp_path / "report.html").read_text())
        assert ("laid on no other" in seen.text) == (len(told) == 2)
        pages = len(re.findall(rb"/Type /Page\b", (tmp_path / "report.pdf").read_bytes()))
        assert pages == (4 if len(told) == 2 else 3)


@pytest.fixture
def printed(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The texts of each page of a PDF that is written."""
    from matplotlib.backends.backend_pdf import PdfPages

    told: list[list[str]] = []
    monkeypatch.setattr(
        PdfPages, "savefig", lambda _, page: told.append([text.get_text() for text in page.texts])
    )
    return told


def test_a_long_series_of_wrecks_goes_on_one_page(tmp_path: Path, printed: list[list[str]]) -> None:
    several = [replace(wreck(), name=str(n), began=wreck().began + timedelta(days=n)) for n in range(40)]
    pdf.write(several[-1], tmp_path / "report.pdf", several)
    assert len(printed) == 4
    names = [one.name for one in several]
    rows = [text for text in printed[-1] if text in names]
    assert 8 <= len(rows) < 40
    assert rows == names[-len(rows) :], "the last ones"
    assert f"and {40 - len(rows)} before: see series.csv" in printed[-1]
    assert figures.in_series(several) == ["outline_area", "hull_seen", "debris_extent", "highest_point"]


def test_every_page_of_a_simulated_survey_says_so(tmp_path: Path, printed: list[list[str]]) -> None:
    pdf.write(reef(), tmp_path / "report.pdf", surveys(0, 365))
    assert all(any("SIMULATED, nothing real was seen" in text for text in page) for page in printed)
    printed.clear()
    pdf.write(replace(reef(), made_by={}), tmp_path / "report.pdf")
    assert not any("SIMULATED" in text for page in printed for text in page)


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (reef(site=None), "a run without origin"),
        (wreck(site=reef().site), "expected a survey of oysters, got one of wreck"),
        (wreck(), "expected the site Inner reef, got Old trawler"),
    ],
)
def test_what_is_of_another_site_or_target_is_not_in_the_series(other: Survey, reason: str) -> None:
    among, reasons = series.of_one_site(reef(), [replace(other, name="other")])
    assert [one.name for one in among] == [reef().name]
    assert reasons == [f"other is not in the series: {reason}"]


def test_a_run_is_once_in_a_series_and_runs_that_are_called_alike_are_all_in_it() -> None:
    """Of some only the day is known, and names of folders are given more than once."""
    now = replace(reef(), made_by={"run": "one"})
    alike = replace(now, made_by={"run": "another"})
    copied = replace(now, name="copy")
    dated = replace(now, name="dated", began=now.began - timedelta(days=365))
    among, reasons = series.of_one_site(now, [now, alike, copied, dated])
    assert [one.run for one in among] == ["one", "another"]
    assert reasons == [
        f"dated is not in the series: expected a run once, got that of {now.name} with two dates, 2026-06-01 "
        "09:30 and 2025-06-01 09:30, of which the first is told. Where the second is right, export that "
        "survey"
    ]


def test_the_survey_itself_is_once_in_its_series() -> None:
    """The archive keeps it, too, and may have measured it by an older version."""
    again = replace(reef(), made_by={"version": "0.0.1"})
    among, reasons = series.of_one_site(reef(), [again, surveys(-365)[0]])
    assert [one.name for one in among] == ["number 0", reef().name]
    assert reasons == []
