"""A survey as one HTML page that a manager can read: it loads nothing, runs nothing, and opens anywhere.

It has the look of the report of a run. Text of the survey enters it escaped, pictures as data; its policy
forbids it everything else.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from dream.report import digest, fill
from dream.survey.products import figures, words
from dream.survey.products.ground import Ground, site_of
from dream.survey.products.mosaic import small
from dream.survey.survey import Measure, Survey
from dream.types import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAME = "report.html"


def write(
    survey: Survey, path: Path, files: Sequence[tuple[str, str]] = (), mosaic: Path | None = None
) -> None:
    """Write the page.

    Args:
        survey: With or without an origin.
        path: Of the file.
        files: (name, what it is) of what lies beside it.
        mosaic: The GeoTIFF of the sea floor, which is shown smaller.

    Raises:
        OSError: It cannot be written.
    """
    style = _part("report_page/page.css") + _part("survey/products/page.css")
    place = survey.site.name if survey.site is not None else survey.name
    text = fill(
        _part("survey/products/page.html"),
        {
            "policy": "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
            f"style-src {digest(style)}",
            "style": style,
            "title": html.escape(f"{place}, {survey.began:%d %B %Y} · DREAM survey"),
            "place": html.escape(place),
            "date": html.escape(f"{survey.began:%d %B %Y}".lstrip("0")),
            "how": html.escape(_how(survey)),
            "simulated": _simulated(survey),
            "headlines": _headlines(survey),
            "summary": "".join(f"<p>{html.escape(line)}</p>" for line in words.summary(survey)),
            "map": _picture(survey, figures.habitat_map, 7.4, 6.6, "Map of what was found"),
            "sea_floor": _sea_floor(survey, mosaic) if mosaic is not None else "",
            "measures": _measures(words.listed(survey)),
            "patches": _patches(survey),
            "sizes": _sizes(survey),
            "relief": _picture(survey, figures.relief_map, 6.2, 5.0, "Map of the relief"),
            "times": _picture(
                survey, figures.times_seen_map, 6.2, 5.0, "Map of how often each place was seen"
            ),
            "probability": _picture(
                survey, figures.probability_map, 6.2, 5.0, "Map of the probability of target"
            ),
            "limits": "".join(f"<li>{html.escape(line)}</li>" for line in words.limits(survey)),
            "facts": "".join(
                f"<dt>{html.escape(what)}</dt><dd>{html.escape(value)}</dd>"
                for what, value in words.facts(survey)
            ),
            "files": _files(files),
            "version": html.escape(str(survey.made_by.get("version", ""))),
        },
    )
    path.write_text(text, encoding="utf-8")


def _how(survey: Survey) -> str:
    steps = max(0, len(survey.track.time) - 1)
    found = words.found(survey)
    article = "an" if found[0] in "aeiou" else "a"
    return (
        f"Survey of {article} {found} by an autonomous underwater vehicle: "
        f"{steps} steps, {words.travelled(survey):.0f} m"
    )


def _simulated(survey: Survey) -> str:
    told = html.escape(words.simulated(survey))
    return f'<p class="outcome"><strong class="badge warn">{told}</strong></p>' if told else ""


def _headlines(survey: Survey) -> str:
    of = {measure.name: measure for measure in survey.measures}
    shown = [of[name] for name in words.HEADLINES if name in of][:4]
    return "".join(
        f"<div><dt>{html.escape(words.meaning(m.name).title)}</dt><dd>{html.escape(words.value_text(m))}"
        f"<small>{html.escape(words.interval_text(m)) or '&nbsp;'}</small></dd></div>"
        for m in shown
    )


def _measures(measures: Sequence[Measure]) -> str:
    rows = "".join(
        f"<tr><th scope='row'>{html.escape(words.meaning(m.name).title)}</th>"
        f"<td class='value'>{html.escape(words.value_text(m))}</td>"
        f"<td class='interval'>{html.escape(words.interval_text(m))}</td>"
        f"<td class='meaning'>{html.escape(words.explained(m))}</td></tr>"
        for m in measures
    )
    return (
        "<div class='wide'><table><thead><tr><th scope='col'>Measure</th><th scope='col'>Value</th>"
        "<th scope='col'>95 % interval</th>"
        f"<th scope='col'>What it says</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _patches(survey: Survey) -> str:
    if not survey.patches:
        return ""
    names = list(dict.fromkeys(m.name for patch in survey.patches for m in patch.measures))
    head = "".join(f"<th scope='col'>{html.escape(words.meaning(name).title)}</th>" for name in names)
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
        f"<div class='wide'><table class='patches'><thead><tr><th scope='col'>No.</th>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div></section>"
    )


def _sizes(survey: Survey) -> str:
    if not len(survey.individuals):
        return ""
    picture = _picture(survey, figures.size_figure, 6.2, 5.0, "How many individuals there are of each size")
    count = "of the individuals that stand clear of others"
    return f"<section class='panel'><h2>Sizes <small>{count}</small></h2>{picture}</section>"


def _picture(
    survey: Survey, draw: Callable[[Axes, Survey], None], width: float, height: float, what: str
) -> str:
    with figures.settings():
        figure, axes = figures.new_figure(width, height)
        draw(axes, survey)
        data = base64.b64encode(figures.svg(figure)).decode()
    return f'<img class="figure" alt="{html.escape(what)}" src="data:image/svg+xml;base64,{data}">'


def _sea_floor(survey: Survey, path: Path) -> str:
    picture, extent = small(path, Ground(site_of(survey)))
    with figures.settings():
        figure, axes = figures.new_figure(9.0, 7.0)
        figures.sea_floor(axes, picture, extent)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="jpeg", dpi=150, pil_kwargs={"quality": 82})
    data = base64.b64encode(buffer.getvalue()).decode()
    return (
        "<section class='panel'><h2>The sea floor from above <small>put together from the frames; colours as "
        "the camera saw them</small></h2><img class='figure' alt='Mosaic of the sea floor' "
        f"src='data:image/jpeg;base64,{data}'></section>"
    )


def _files(files: Sequence[tuple[str, str]]) -> str:
    if not files:
        return ""
    rows = "".join(
        f"<li><code>{html.escape(name)}</code> <span>{html.escape(what)}</span></li>" for name, what in files
    )
    return f"<section class='panel'><h2>Files beside this page</h2><ul class='files'>{rows}</ul></section>"


def _part(name: str) -> str:
    return resources.files("dream").joinpath(name).read_text(encoding="utf-8")
