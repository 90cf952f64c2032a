"""A comparison of two surveys as one HTML page that a manager can read."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence

from dream import __version__
from dream.survey import change_words
from dream.survey.comparison import Comparison, Difference, PatchChange, Verdict, doubts
from dream.survey.numbers import number, p_value, typeset
from dream.survey.products import web, words
from dream.survey.survey import Measure
from dream.types import Target

SHARPNESS = 2
"""Pixels of the picture for each one of the page."""


def change_page(
    comparison: Comparison,
    picture: bytes,
    colours: Mapping[Verdict, str],
    files: Sequence[tuple[str, str]] = (),
) -> str:
    """The page.

    Args:
        comparison: That is told of.
        picture: PNG of its map.
        colours: Of verdicts on that map.
        files: (name, what it is) of what lies beside the page.
    """
    a, b = comparison.a, comparison.b
    notes = [*doubts(a, b), *filter(None, (comparison.registration.note,))]
    main = web.filled(
        "change.html",
        {
            "first": _first(comparison),
            "notices": "".join(f'<p class="notice">{html.escape(_sentence(note))}</p>' for note in notes),
            "summary": "".join(f"<p>{html.escape(line)}</p>" for line in change_words.summary(comparison)),
            "map": web.sharp_map(picture, "Map of what changed", SHARPNESS),
            "surveys": _surveys(comparison),
            "laid": web.terms(_laid(comparison)),
            "ground": web.terms(_ground(comparison)),
            "individuals": _individuals(comparison),
            "patches": _patches(comparison),
            "figures": _figures(() if comparison.withheld else comparison.differences, comparison.years),
            "measures": _figures(comparison.measures, comparison.years),
            "limits": web.lines(change_words.limits(comparison)),
            "files": web.files(files),
        },
    )
    days = dict.fromkeys(map(words.day, (a, b)))
    worlds = dict.fromkeys(one.removeprefix("Simulated: ") for one in map(words.simulated, (a, b)) if one)
    masthead = web.Masthead(
        kind="change report",
        place=f"{words.place(a)}: {change_words.later(comparison.years)}",
        date=" to ".join(one.replace(" ", "\N{NO-BREAK SPACE}") for one in days),
        how="What changed between two surveys, where both of them looked",
        simulated=f"Simulated: {'; '.join(worlds)}" if worlds else "",
        headlines=(),
    )
    rules = "".join(
        f".{_rule(verdict)}::before {{ background: {colour}; }}\n" for verdict, colour in colours.items()
    )
    return web.page(masthead, main, __version__, rules)


def _first(comparison: Comparison) -> str:
    """The figures that stand first: before, after, by how much they changed, and what the interval says."""
    of = [{one.name: one for one in survey.measures} for survey in (comparison.a, comparison.b)]
    told = []
    for one in change_words.headlines(comparison):
        value, change, interval = map(typeset, change_words.difference_cells(one))
        was, became = (_interval(measures[one.name]) if one.name in measures else "" for measures in of)
        share = change.partition("(")[2].removesuffix(")") or change
        direction = change_words.direction(one)
        told.append(
            f"<div><dt>{html.escape(words.meaning(one.name).title)}</dt><dd>{html.escape(value)}"
            f"<small>{html.escape(was)} → {html.escape(became)}</small>"
            f"<strong class='{direction.split()[0]}'>{html.escape(share)}: {direction}</strong>"
            f"<small>change: {html.escape(interval)}</small></dd></div>"
        )
    return f"<dl class='first'>{''.join(told)}</dl>" if told else ""


def _interval(measure: Measure) -> str:
    """Without its unit, which stands beside the value."""
    unit = words.UNITS.get(measure.unit, measure.unit)
    return typeset(words.interval_text(measure).removesuffix(unit).strip())


def _surveys(comparison: Comparison) -> str:
    before, after = (dict(words.facts(one)) for one in (comparison.a, comparison.b))
    rows = "".join(
        f"<tr><th scope='row'>{html.escape(what)}</th><td>{_broken(before.get(what, '–'))}</td>"
        f"<td>{_broken(after.get(what, '–'))}</td></tr>"
        for what in dict.fromkeys((*before, *after))
    )
    return f"<table>{web.head(('', 'Before', 'After'))}<tbody>{rows}</tbody></table>"


def _broken(text: str) -> str:
    """Escaped, and with places where a name of a run may go on in the next line: between its words."""
    return html.escape(text).replace("_", "_<wbr>").replace("-", "-<wbr>")


def _laid(comparison: Comparison) -> list[tuple[str, str]]:
    laid = comparison.registration
    by = {
        "individuals": f"{laid.pairs} individuals that both found",
        "map": "their maps of target and relief",
        "poses": "the positions of the vehicle alone",
    }
    told = [
        ("Laid by", by.get(laid.by, laid.by)),
        ("To within", "not known" if comparison.withheld else f"{100.0 * laid.sigma:.1f} cm (one sigma)"),
    ]
    if laid.pairs:
        told.append(
            ("Pairs lie", f"{100.0 * laid.residual:.1f} cm from each other (root mean square along an axis)")
        )
    moved, turned = math.hypot(laid.moved.x, laid.moved.y), abs(math.degrees(laid.moved.yaw))
    told.append(("Moved by", f"{moved:.2f} m and {turned:.1f}° from where positions put it"))
    return told


def _ground(comparison: Comparison) -> list[tuple[str, str]]:
    if comparison.withheld:
        return [("Compared", "none: nothing shows how the two surveys lie on each other")]
    of = comparison.as_dict()["ground_m2"]
    edge = (
        ", in both or at an edge that no survey draws the same twice, so that kept and gained are more than "
        "the area after"
    )
    names = (
        ("comparable", "Seen by both", ""),
        ("only_before", "Only before", ""),
        ("only_after", "Only after", ""),
        ("kept", "Target kept", edge),
        ("gain", "Target gained", ""),
        ("loss", "Target lost", ""),
    )
    return [(title, f"{number(of[name])} m²{more}") for name, title, more in names]


def _individuals(comparison: Comparison) -> str:
    if comparison.a.target is Target.WRECK or comparison.withheld:
        return ""
    of = comparison.as_dict()["individuals"]
    told = [
        ("There in both", str(of["there"])),
        ("Only before", str(of["lost"])),
        ("Only after", str(of["new"])),
        (
            "Not found again",
            f"{of['hidden_before']} before and {of['hidden_after']} after, on ground that is covered still",
        ),
        ("Not comparable", f"{of['not_comparable']}, on ground that one of the surveys did not see"),
    ]
    return (
        "<section class='panel'><h2>Individuals <small>those that were found, which are not all</small></h2>"
        f"<dl class='about'>{web.terms(told)}</dl></section>"
    )


def _patches(comparison: Comparison) -> str:
    if not comparison.patches or comparison.withheld:
        return ""
    told = [
        {name: (cells, p) for name, cells, p in change_words.patch_rows(one)} for one in comparison.patches
    ]
    names = list(dict.fromkeys(name for figures in told for name in figures))
    rows = []
    for k, (patch, figures) in enumerate(zip(comparison.patches, told, strict=True), start=1):
        cells = "".join(_cell(*figures[name]) if name in figures else "<td>–</td>" for name in names)
        new = "<small>new</small>" if patch.before is None else ""
        rows.append(
            f"<tr><th scope='row'>{k}{new}</th>{_verdict(patch)}"
            f"<td>{typeset(f'{patch.seen:.0%}')}</td>{cells}</tr>"
        )
    head = web.head(("No.", "Verdict", "Seen by both", *(words.meaning(name).title for name in names)))
    title = "Hull and pieces" if comparison.a.target is Target.WRECK else "Patch by patch"
    meanings = [words.meaning(name) for name in ("gone", "come") if name in names]
    legend = [(one.title, one.says) for one in meanings]
    if any(patch.q is not None for patch in comparison.patches):
        share = "where it is called changed, with all that are surer, at most this share of them is false"
        legend += [
            ("p", "how often two surveys of ground that has not changed differ by as much"),
            ("q", share),
        ]
    return (
        f"<section class='panel'><h2>{title} <small>numbers as on the map; below each value its change, the "
        "95 % interval of that, and p</small></h2>"
        f"<div class='wide'><table class='patches'>{head}<tbody>{''.join(rows)}</tbody></table></div>"
        + (f"<dl class='about legend'>{web.terms(legend)}</dl>" if legend else "")
        + "</section>"
    )


def _verdict(patch: PatchChange) -> str:
    tests = [(name, p) for name, p in (("p", patch.p), ("q", patch.q)) if p is not None]
    told = "".join(f"<small>{name} {html.escape(p_value(p))}</small>" for name, p in tests)
    return f"<td class='called {_rule(patch.verdict)}'>{patch.verdict}{told}</td>"


def _cell(cells: tuple[str, str, str], p: float) -> str:
    value, *below = (html.escape(typeset(text)) for text in (*cells, f"p {p_value(p)}"))
    return f"<td>{value}{''.join(f'<small>{text}</small>' for text in below)}</td>"


def _figures(differences: Sequence[Difference], years: float) -> str:
    if not differences:
        return "<p>There is nothing to hold against each other.</p>"
    rows = []
    rates = [typeset(change_words.a_year(one, years)) for one in differences]
    for one, rate in zip(differences, rates, strict=True):
        value, change, interval = map(typeset, change_words.difference_cells(one))
        rows.append(
            f"<tr><th scope='row'>{html.escape(words.meaning(one.name).title)}</th>"
            f"<td class='value'>{html.escape(value)}</td><td class='interval'>{html.escape(change)}</td>"
            f"<td class='interval' data-is='95 %:'>{html.escape(interval)}</td>"
            + (f"<td class='interval' data-is='a year:'>{html.escape(rate)}</td>" if any(rates) else "")
            + f"<td class='interval' data-is='p'>{html.escape(p_value(one.p))}</td>"
            f"<td class='meaning'>{html.escape(words.meaning(one.name).says)}</td></tr>"
        )
    year = ("A year",) if any(rates) else ()
    head = web.head(("Figure", "Before → after", "Change", "95 % interval", *year, "p", "What it is"))
    return f"<div class='wide'><table>{head}<tbody>{''.join(rows)}</tbody></table></div>"


def _rule(verdict: Verdict) -> str:
    """Name of what gives a verdict its colour."""
    return f"called-{verdict.replace(' ', '-')}"


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text[:1].upper()}{text[1:]}."
