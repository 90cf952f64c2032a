"""A survey as one HTML page that a manager can read."""

from __future__ import annotations

import html
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dream.survey.products import areas, figures, sheet, side_by_side, web, words
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.mosaic import small
from dream.survey.survey import Measure, Survey
from dream.types import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAME = "report.html"


def write(
    survey: Survey,
    path: Path,
    files: Sequence[tuple[str, str]] = (),
    mosaic: Path | None = None,
    surveys: Sequence[Survey] = (),
) -> None:
    """Write the page.

    Args:
        survey: With or without an origin.
        path: Of the file.
        files: (name, what it is) of what lies beside it.
        mosaic: The GeoTIFF of the sea floor, which is shown smaller.
        surveys: All of the site, by time; what went on is told of two or more.

    Raises:
        OSError: It cannot be written.
    """
    main = web.filled(
        "survey.html",
        {
            "summary": "".join(f"<p>{html.escape(line)}</p>" for line in words.summary(survey)),
            "map": _picture(survey, figures.habitat_map, 7.4, 6.6, "Map of what was found"),
            "sea_floor": _sea_floor(survey, mosaic) if mosaic is not None else "",
            "measures": _measures(words.listed(survey)),
            "areas": _areas(survey),
            "structures": side_by_side.sections(survey),
            "series": _series(surveys) if len(surveys) > 1 else "",
            "patches": _patches(survey),
            "sizes": _sizes(survey),
            "relief": _picture(survey, figures.relief_map, 6.2, 5.0, "Map of the relief"),
            "times": _picture(
                survey, figures.times_seen_map, 6.2, 5.0, "Map of how often each place was seen"
            ),
            "probability": _picture(
                survey, figures.probability_map, 6.2, 5.0, "Map of the probability of target"
            ),
            "limits": web.lines(words.limits(survey)),
            "facts": web.terms(words.facts(survey)),
            "files": web.files(files),
        },
    )
    masthead = web.Masthead(
        kind="survey report",
        place=words.place(survey),
        date=words.day(survey).replace(" ", "\N{NO-BREAK SPACE}"),
        how=_how(survey),
        simulated=words.simulated(survey),
        headlines=_headlines(survey),
    )
    style = side_by_side.style(survey.structures)
    text = web.page(masthead, main, str(survey.made_by.get("version", "")), style)
    path.write_text(text, encoding="utf-8")


def _how(survey: Survey) -> str:
    steps = max(0, len(survey.track.time) - 1)
    found = words.found(survey)
    article = "an" if found[0] in "aeiou" else "a"
    return (
        f"Survey of {article} {found} by an autonomous underwater vehicle: "
        f"{steps} steps, {words.travelled(survey):.0f} m"
    )


def _headlines(survey: Survey) -> list[tuple[str, str, str]]:
    of = {measure.name: measure for measure in survey.measures}
    first = words.HEADLINES_IN_SPACE if survey.structures else words.HEADLINES
    shown = [of[name] for name in first if name in of][:4]
    return [(words.meaning(m.name).title, words.value_text(m), words.interval_text(m)) for m in shown]


def _measures(measures: Sequence[Measure]) -> str:
    rows = "".join(
        f"<tr><th scope='row'>{html.escape(words.meaning(m.name).title)}</th>"
        f"<td class='value'>{html.escape(words.value_text(m))}</td>"
        f"<td class='interval'{_is_interval(m)}>{html.escape(words.interval_text(m))}</td>"
        f"<td class='meaning'>{html.escape(words.explained(m))}</td></tr>"
        for m in measures
    )
    head = web.head(("Measure", "Value", "95 % interval", "What it says"))
    return f"<div class='wide'><table>{head}<tbody>{rows}</tbody></table></div>"


def _is_interval(measure: Measure) -> str:
    """What names the interval where a row is a block; nothing of a value that has none."""
    return "" if measure.value is not None and measure.low is None else " data-is='95 %:'"


def _areas(survey: Survey) -> str:
    told = [(f"{area.title}, {area.value}", area.says) for area in areas.areas(survey)]
    return f"<dl class='about areas'>{web.terms(told)}</dl>" if told else ""


def _patches(survey: Survey) -> str:
    if not survey.patches:
        return ""
    names = list(dict.fromkeys(m.name for patch in survey.patches for m in patch.measures))
    head = web.head(("No.", *(words.meaning(name).title for name in names)))
    rows = []
    for number, patch in enumerate(survey.patches, start=1):
        of = {m.name: m for m in patch.measures}
        cells = "".join(
            f"<td>{html.escape(words.value_text(of[name]))}<small>{html.escape(words.interval_text(of[name]))}</small></td>"
            if name in of
            else "<td>–</td>"
            for name in names
        )
        rows.append(f"<tr><th scope='row'>{number}</th>{cells}</tr>")
    title = "Hull and pieces" if survey.target is Target.WRECK else "Patch by patch"
    return (
        f"<section class='panel'><h2>{title} "
        "<small>numbers as on the map; 95 % intervals below each value</small></h2>"
        f"<div class='wide'><table class='patches'>{head}<tbody>{''.join(rows)}</tbody></table></div>"
        "</section>"
    )


def _series(surveys: Sequence[Survey]) -> str:
    with sheet.settings():
        picture = web.picture(
            sheet.svg(figures.series_figure(surveys)), "svg+xml", "How the main measures went"
        )
    lines = "".join(f"<p>{html.escape(line)}</p>" for line in words.trend_limits(surveys[-1].target))
    return (
        "<section class='panel series'><h2>Over time <small>all surveys of this site; every measure is in "
        f"series.csv</small></h2>{picture}{lines}</section>"
    )


def _sizes(survey: Survey) -> str:
    if not figures.tells_sizes(survey):
        return ""
    picture = _picture(survey, figures.size_figure, 6.2, 5.0, "How many individuals there are of each size")
    count = "of all individuals, told by those that stand clear of others"
    return f"<section class='panel'><h2>Sizes <small>{count}</small></h2>{picture}</section>"


def _picture(
    survey: Survey, draw: Callable[[Axes, Survey], None], width: float, height: float, what: str
) -> str:
    with sheet.settings():
        figure, axes = sheet.new_figure(width, height)
        draw(axes, survey)
        return web.picture(sheet.svg(figure), "svg+xml", what)


def _sea_floor(survey: Survey, path: Path) -> str:
    picture, extent = small(path, Ground(site_of(survey)))
    with sheet.settings():
        figure, axes = sheet.new_figure(9.0, 7.0)
        figures.sea_floor(axes, picture, extent)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="jpeg", dpi=150, pil_kwargs={"quality": 82})
    return (
        "<section class='panel'><h2>The sea floor from above <small>put together from the frames; colours as "
        "the camera saw them</small></h2>"
        f"{web.picture(buffer.getvalue(), 'jpeg', 'Mosaic of the sea floor')}</section>"
    )
