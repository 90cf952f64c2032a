"""The page of a change and its map: what stands first, what it is called, and what can be told apart."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest
from matplotlib.collections import PathCollection

from dream.survey.change_layers import GROUND, VERDICTS
from dream.survey.change_map import HATCHES, MARKS, _around, draw_on
from dream.survey.change_page import change_page
from dream.survey.change_words import direction, later
from dream.survey.comparison import Change, Comparing, Comparison
from dream.survey.fates import Fate
from dream.survey.products.sheet import east_north, new_figure
from dream.survey.survey import Measure
from tests.survey.browsing import Seen
from tests.survey.repeated import reef, survey, without


def measures(share: float) -> tuple[Measure, ...]:
    """Those that stand first: of fewer individuals the count is less, and the area as it was."""
    return (
        Measure("reef_area", 66.2, 64.3, 68.2, "m2"),
        Measure("density", 16.9 * share, 16.0 * share, 17.8 * share, "1/m2"),
        Measure("count", 1118.0 * share, 1050.0 * share, 1190.0 * share, ""),
        Measure("median_size", 0.2, 0.18, 0.22, "m"),
        Measure("reef_height", 0.116, 0.110, 0.122, "m"),
    )


@pytest.fixture(scope="module")
def change() -> Comparison:
    """A third of a patch died within a simulated year."""
    rng = np.random.default_rng(12)
    before = reef(rng)
    a, b = survey(before, rng, name="a_run-1"), survey(without(before, 1, 0.33, rng), rng, name="a_run-2")
    a, b = replace(a, measures=measures(1.0)), replace(b, measures=measures(0.7))
    made_by = {**b.made_by, "world": "reef/K+1y1", "seed": 1, "years_on": 1.0}
    b = replace(b, began=a.began + timedelta(days=365.25), made_by=made_by)
    return Comparing().compare(a, b)


@pytest.mark.parametrize(
    "years, words",
    [
        (1.0, "one year later"),
        (1.03, "one year later"),
        (1.97, "two years later"),
        (2.5, "2.5 years later"),
        (1.5, "18 months later"),
        (0.5, "6 months later"),
        (10.0 / 365.25, "10 days later"),
        (5.0 / 24.0 / 365.25, "5 hours later"),
        (3.0 / 1440.0 / 365.25, "3 minutes later"),
        (0.0, "at the same time"),
        (-1.0, "one year earlier"),
    ],
)
def test_how_much_later_is_told_in_words(years: float, words: str) -> None:
    assert later(years) == words


def test_five_figures_stand_first_each_with_what_its_interval_says(change: Comparison) -> None:
    page = change_page(change, b"", VERDICTS)
    title = re.search("<h1>(.*?) <span", page)
    assert title is not None
    assert title[1] == "Test reef: one year later"
    first = page.partition("<dl class='first'>")[2].partition("</dl>")[0]
    titles = re.findall("<dt>(.*?)</dt>", first)
    assert titles == ["Reef area", "Individuals", "Density", "Reef height", "Median size"]
    verdicts = re.findall("<strong .*?>.*?: (.*?)</strong>", first)
    assert verdicts == ["no change shown", "less", "less", "no change shown", "no change shown"]
    assert "1118 → 783" in first
    assert "1,050 to 1,190 → 735 to 833" in first
    sentence = (
        "of patches that stayed as they were, at most 5\N{NO-BREAK SPACE}% are called changed by mistake"
    )
    assert sentence in Seen(page).text
    assert "a_<wbr>run-<wbr>1" in page, "names break between their words"


def test_what_a_figure_says_is_its_interval(change: Comparison) -> None:
    one = change.measures[0]
    ends = (1.0, 2.0), (-1.0, 2.0), (-2.0, -1.0)
    said = [direction(replace(one, low=low, high=high)) for low, high in ends]
    assert said == ["more", "no change shown", "less"]


def test_gain_and_loss_differ_by_shape_size_and_lightness(change: Comparison) -> None:
    shapes = {fate: mark for fate, (mark, _, _) in MARKS.items()}
    assert len(set(shapes.values())) == 3
    # A mark of s square points is as wide as their root; the picture has 200 pixels an inch, the page half.
    for fate in (Fate.LOST, Fate.NEW):
        assert MARKS[fate][1] ** 0.5 / 72.0 * 200.0 / 2.0 >= 7.0
    assert HATCHES[Change.GAIN] != HATCHES[Change.LOSS]
    light = {}
    for kind in (Change.GAIN, Change.LOSS, Change.KEPT, Change.BARE):
        red, green, blue = (int(GROUND[kind][k : k + 2], 16) for k in (1, 3, 5))
        light[kind] = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    assert abs(light[Change.GAIN] - light[Change.BARE]) > 50.0
    assert abs(light[Change.LOSS] - light[Change.BARE]) > 50.0
    _, axes = new_figure(6.0, 6.0)
    draw_on(axes, change, _around(change))
    dots = {dots.get_label(): dots for dots in axes.collections if isinstance(dots, PathCollection)}
    assert {words for _, _, words in MARKS.values()} <= set(dots)


def test_the_reef_fills_its_map(change: Comparison) -> None:
    _, axes = new_figure(6.0, 6.0)
    draw_on(axes, change, _around(change))
    cells = np.argwhere(np.isin(change.change, (Change.KEPT, Change.GAIN, Change.LOSS)))
    corner = (change.bounds.x_min, change.bounds.y_min)
    places = east_north(change.a.site, (change.cell * (cells[:, ::-1] + 0.5) + corner).astype(np.float64))
    for ends, found in ((axes.get_xlim(), places[:, 0]), (axes.get_ylim(), places[:, 1])):
        assert ends[0] < found.min()
        assert found.max() < ends[1]
        assert np.ptp(found) > 0.6 * (ends[1] - ends[0])
