"""What of each structure was inspected, side by side, as a part of a page: drawn, and as a table."""

from __future__ import annotations

import html
from collections.abc import Sequence

from dream.survey.products import elevations, web, words
from dream.survey.survey import Survey, SurveyedStructure


def sections(survey: Survey) -> str:
    """A section for each structure; nothing where there is none."""
    return "".join(_section(survey, number) for number in range(len(survey.structures)))


def style(structures: Sequence[SurveyedStructure]) -> str:
    """Rules of the sections. Columns are as wide as what they show, which keeps all sides to one scale."""
    if not structures:
        return ""
    rules = [web.part("survey/products/structures.css")]
    for number, one in enumerate(structures, start=1):
        long, wide, _ = elevations.extents(one)
        rules.append(f".structure{number} .views {{ grid-template-columns: {long:g}fr {wide:g}fr; }}\n")
        rules.append(f".structure{number} .scale {{ width: {100.0 * _bar(long) / long:.4g}%; }}\n")
    for number, color in enumerate(elevations.LEGEND.values()):
        rules.append(f".key{number}::before {{ background: rgb({' '.join(map(str, color))}); }}\n")
    return "".join(rules)


def _section(survey: Survey, index: int) -> str:
    one = survey.structures[index]
    several = len(survey.structures) > 1
    title = f"Structure {index + 1}, side by side" if several else "What was inspected, side by side"
    long, wide, high = elevations.extents(one)
    size = f"{long:.0f} m long, {wide:.0f} m wide, {high:.0f} m high; all sides are drawn to one scale"
    key = "".join(
        f"<li class='key{number}'>{html.escape(name)}</li>" for number, name in enumerate(elevations.LEGEND)
    )
    return (
        f"<section class='panel standing structure{index + 1}'><h2>{title} <small>{size}</small></h2>"
        f"<p>{html.escape(words.structure(one))}</p>"
        f"<ul class='key'>{key}</ul><div class='views'>{''.join(_figures(survey, one))}"
        f"<p class='scale'>{_bar(long)} m</p></div>"
        f"<div class='wide'>{_table(survey, one)}</div></section>"
    )


def _bar(long: float) -> int:
    """Metres of the bar that tells the scale of what is so long."""
    return max(1, min(5, int(long)))


def _figures(survey: Survey, one: SurveyedStructure) -> list[str]:
    drawn = []
    for view in elevations.views(one):
        side = one.sides[view.index]
        share = next(m for m in side.measures if m.name == "inspected_share")
        says = [f"{words.value_text(share)} inspected"] if share.value is not None else []
        if side.bearing is None:
            says.append(f"{words.wind(view.right, survey.site)} is on the right")
        name, told = _title(survey, one, view.index), "; ".join(says)
        drawn.append(
            f"<figure class='view{view.index}'><figcaption>{html.escape(name)}"
            f"<small>{html.escape(told)}</small></figcaption>"
            f"{web.picture(view.png(), 'png', f'{name}: {told}')}</figure>"
        )
    return drawn


def _table(survey: Survey, one: SurveyedStructure) -> str:
    names = list(dict.fromkeys(measure.name for side in one.sides for measure in side.measures))
    rows = []
    for index, side in enumerate(one.sides):
        of = {measure.name: measure for measure in side.measures}
        if any(measure.value for measure in side.measures):
            cells = "".join(
                f"<td>{_held(words.value_text(of[name]))}"
                f"<small>{_held(words.interval_text(of[name]))}</small></td>"
                for name in names
            )
            title = html.escape(_title(survey, one, index))
            rows.append(f"<tr><th scope='row'>{title}</th>{cells}</tr>")
    head = web.head(("Side", *(words.meaning(name).title for name in names)))
    return f"<table class='sides'>{head}<tbody>{''.join(rows)}</tbody></table>"


def _held(text: str) -> str:
    """A unit stays on the line of its figure."""
    figure, space, unit = text.rpartition(" ")
    return html.escape(f"{figure}\N{NO-BREAK SPACE}{unit}" if space else text)


def _title(survey: Survey, one: SurveyedStructure, index: int) -> str:
    name = words.side_name(one.sides[index], survey.site)
    return name[:1].upper() + name[1:]
