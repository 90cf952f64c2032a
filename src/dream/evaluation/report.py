"""Benchmark folder → one self-contained HTML page and its tables in Markdown.

Whatever stands in the folder is treated as text from a stranger: it is escaped, and the page's policy
forbids it to run or to load anything. The page has no script.
"""

from __future__ import annotations

import base64
import html
import io
import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image

from dream.evaluation import figures, tables
from dream.evaluation.cells import NONE, Table, about_rows, escape_markdown, number, with_interval
from dream.evaluation.comparison import (
    FAMILIES,
    Comparison,
    best_baseline,
    compare,
    contradictions,
    coverage_at_end,
    difference,
    groups,
    is_number,
    is_wire_test,
    label,
    what_is_missing,
)
from dream.evaluation.figures import DARK, LIGHT, Picture, Scene
from dream.evaluation.paper_tables import paper_tables, published_tables
from dream.evaluation.results import Results, read_results
from dream.evaluation.sealed import blocks_told
from dream.evaluation.suites import LISTED
from dream.files import write_whole
from dream.homeward import read_budget
from dream.planning import HUMAN, LABELLED, PLANNERS, Asking
from dream.planning.vlm import WIRE_TEST
from dream.report import digest, fill

JPEG_QUALITY = 72
MANY = 10
"""Worlds from which on the page compares with the paper and draws curves of shares of missions."""
SHOWN = 3
"""Planners whose ways the page shows before anyone asks for more."""
SHORT = {
    "results": "Results",
    "families": "Families",
    "baselines": "Baselines",
    "papers-planner": "The paper's steps",
    "models": "Models",
    "bounds": "Bounds",
    "paper": "The paper",
    "ways": "Trajectories",
    "worlds": "Worlds",
    "details": "All measures",
    "run": "What was run",
}
"""Names of the parts in the bar of contents."""
LEFT_OUT = (
    f" Curves of how many missions were done by when, and the tables beside the paper's, are shown from "
    f"{MANY} worlds on: fewer say little of a share."
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a report: the same for the page, for `tables.md` and for the documentation."""

    name: str
    title: str
    lead: str
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    aside: tuple[Table, ...] = ()
    """Set apart from the other tables, since they are not ours."""


def write_report(folder: Path) -> Path:
    """Make `report.html` and `tables.md` in a benchmark folder, from what lies in that folder alone.

    An unfinished benchmark is shown as far as it went, and says how much is missing.

    Returns:
        The path of the page.

    Raises:
        FileNotFoundError: It is no benchmark folder.
        ValueError: One of its files is damaged; the message names it.
    """
    results = read_results(folder)
    comparison = compare(results)
    write_whole(folder / "tables.md", markdown(results, comparison).encode())
    page = folder / "report.html"
    write_whole(page, _page(results, comparison).encode())
    return page


def sections(results: Results, comparison: Comparison) -> list[Section]:
    """What there is to say about a benchmark, the most important first."""
    pictures = {picture.name: picture for picture in figures.pictures(results, comparison)}
    many = len({(case.world, case.seed) for case in comparison.cases}) >= MANY
    curves = tuple(
        picture
        for name, picture in pictures.items()
        if name.startswith("coverage") or (many and name != "profile")
    )
    profile = tuple(picture for name, picture in pictures.items() if many and name == "profile")
    found = groups(comparison)
    whole = next(iter(found))
    against = tables.against_the_best_baseline(comparison)
    every = [
        Section(
            "results",
            "Results",
            _verdict(comparison) + ("" if many else LEFT_OUT),
            (tables.headline(comparison, found[whole], whole),),
            curves,
        )
    ]
    if len(found) > 1:
        every.append(
            Section(
                "families",
                "By family of worlds",
                "The same planners, family by family. The number of missions of each stands in the heading.",
                tuple(tables.by_family(comparison)),
            )
        )
    if against.rows:
        every.append(
            Section(
                "baselines",
                "Against the best baseline",
                (
                    "Planners are compared world by world, over the cases that both of two have flown."
                    if comparison.missing
                    else "Every planner flew the same worlds from the same starts, so that planners are "
                    "compared world by world."
                ),
                (against,),
            )
        )
    papers = tables.against_the_papers_planner(comparison)
    if papers.rows:
        every.append(
            Section(
                "papers-planner",
                "Against the paper's steps",
                f"The same against {tables.PAPERS}, which is no baseline.",
                (papers,),
            )
        )
    between = tables.between_models(comparison)
    if between.rows:
        every.append(
            Section("models", "Between models", "Every two that asked one, world by world.", (between,))
        )
    every.append(
        Section(
            "bounds",
            "Against one who knows the world",
            "How near a planner came to the fewest steps that any mission could take: between the best "
            "tour that is known and a lower bound that is certified.",
            (tables.efficiency(comparison, whole, found[whole]), tables.bounds_table(comparison)),
            profile,
        )
    )
    if many:
        every.append(
            Section(
                "paper",
                "The paper's tables",
                "In the paper's own form, measured in our simulator. What others published stands apart "
                "below.",
                tuple(paper_tables(comparison)),
                aside=tuple(published_tables()),
            )
        )
    every.append(
        Section(
            "worlds",
            "World by world",
            "One world a line.",
            (
                tables.world_table(comparison),
                *([tables.failure_table(comparison)] if comparison.failures else []),
            ),
        )
    )
    return every


def details(comparison: Comparison) -> dict[str, list[Table]]:
    """All measures, group by group."""
    return {
        title: tables.detail_tables(comparison, title, cases) for title, cases in groups(comparison).items()
    }


def run_table(results: Results, comparison: Comparison) -> Table:
    """What was flown, by which code, on which machine."""
    manifest = results.manifest
    libraries = [
        f"{name} {manifest[name]}" for name in ("python", "numpy", "numba", "scipy") if name in manifest
    ]
    protocol = manifest["protocol"]
    known = [
        f"{name} {protocol[name]:g} m"
        for name in ("reach", "cell", "lattice")
        if is_number(protocol.get(name))
    ]
    rows = [
        ("worlds", f"{manifest['suite']}: {len(comparison.cases)} cases"),
        *_sealing(manifest),
        ("protocol", ", ".join([comparison.protocol, *known, f"{comparison.horizon} steps at most"])),
        (
            "missions",
            what_is_missing(comparison) if comparison.missing else f"all {len(comparison.rows)}",
        ),
        *(
            (
                f"planner {name}",
                ", ".join(f"{key} {value}" for key, value in parameters.items()) or "no parameters",
            )
            for name, parameters in manifest["planners"].items()
        ),
        ("version", f"{manifest['version']}, commit {manifest['commit'] or 'unknown'}"),
        ("source", str(manifest["source"])),
        ("libraries", ", ".join(libraries) or NONE),
        ("engine", str(manifest["engine"])),
        ("machine", _machine(manifest["machine"])),
        *(
            ("later also", f"{later.get('engine')} on {_machine(later.get('machine'))}")
            for later in manifest.get("later", [])
        ),
        ("started", str(manifest["started"])),
        ("finished", str(manifest["finished"] or "not yet")),
        ("flying took", f"{float(manifest['wall_s']):.0f} s"),
        *([("repeat with", command)] if (command := repeating_command(manifest)) else []),
        *([("other planners", scripts)] if (scripts := flown_by_scripts(manifest)) else []),
    ]
    return Table("run", "What was run", ("", ""), tuple(rows), labels=2)


def _sealing(manifest: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Lines on a sealed test: the name of its key, and what was published of each block."""
    told = manifest.get("sealed")
    if told is None:
        return []
    return [
        ("key", str(told["key"])),
        *((f"block {number}", commitment) for number, commitment in told["blocks"].items()),
    ]


def _machine(machine: Any) -> str:
    known = machine.items() if isinstance(machine, dict) else ()
    return ", ".join(f"{key} {value}" for key, value in known if value is not None) or NONE


def repeating_command(manifest: Mapping[str, Any]) -> str:
    """The command line, or lines, that fly the benchmark again; empty where no planner of it is a command's.

    Planners that ask a model are flown by a line of their own where they were asked differently.
    """
    known = {name: given for name, given in manifest["planners"].items() if _is_known(name)}
    found = []
    sealing = manifest.get("sealed")
    for suite in str(manifest["suite"]).split(", ") if known else ():
        naming = _naming(suite) if sealing is None else _naming_sealed(sealing)
        for asking, planners in _asked_alike(known).items():
            words = ["dream", "bench", *naming]
            words += ["--planners", *planners, "--protocol", str(manifest["protocol"]["name"])]
            if manifest["max_steps"] is not None:
                words += ["--max-steps", str(manifest["max_steps"])]
            if manifest.get("budget"):
                words += read_budget(manifest["budget"]).options
            found.append(shlex.join([*words, *asking]))
    return " && ".join(found)


def _naming(suite: str) -> list[str]:
    """The words that name the worlds: a suite or a list, the folder of one, or a name and its seeds."""
    if suite.endswith(LISTED):
        return [suite]
    if suite.endswith("/"):
        return ["--world", suite]
    world, _, seeds = suite.partition(" ")
    return ["--world", world, "--seeds", seeds] if seeds else [world]


def _naming_sealed(sealing: Mapping[str, Any]) -> list[str]:
    """The words that name the worlds of a sealed test; where its key lies is nobody's business."""
    numbers = list(map(int, sealing["blocks"]))
    return ["sealed", "--key", "FILE", "--blocks", blocks_told(numbers)]


def flown_by_scripts(manifest: Mapping[str, Any]) -> str:
    """Which planners no command flies by itself, and who does, in words; empty where there are none."""
    others = [name for name in manifest["planners"] if not _is_known(name)]
    persons = [name for name in others if name.partition(LABELLED)[0] == HUMAN]
    scripts = [name for name in others if name not in persons]
    told = []
    if persons:
        how = "is a person" if len(persons) == 1 else "are persons"
        told.append(f"{_listed(persons)} {how} (dream fly)")
    if scripts:
        how = "is flown by a script of its own" if len(scripts) == 1 else "are flown by scripts of their own"
        told.append(f"{_listed(scripts)} {how}")
    return "; ".join(told)


def _is_known(planner: str) -> bool:
    return planner.partition(LABELLED)[0] in PLANNERS


def _asked_alike(planners: Mapping[str, Mapping[str, Any]]) -> dict[tuple[str, ...], list[str]]:
    """Planners by the options with which they ask a model; those that ask none join the first of these."""
    defaults = asdict(Asking())
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, parameters in planners.items():
        if "model" in parameters:
            options = tuple(
                word
                for option, default in defaults.items()
                if option in parameters and parameters[option] != default
                for word in ("--" + option.replace("_", "-"), str(parameters[option]))
            )
            alike.setdefault(options, []).append(name)
    others = [name for name, parameters in planners.items() if "model" not in parameters]
    first = next(iter(alike), ())
    together = [*others, *alike.pop(first, [])]
    return {first: [name for name in planners if name in together], **alike}


def warnings(comparison: Comparison) -> list[str]:
    """What a reader must know before reading a number."""
    found = []
    if comparison.missing:
        shared = len(comparison.shared(comparison.planners, comparison.cases))
        order = (
            f"Planners stand in order of the {shared} cases that all of them have flown"
            if shared
            else "No case was flown by all planners, so that they stand in no order"
        )
        found.append(
            f"Unfinished: {what_is_missing(comparison)}. Means of different planners are over "
            f"different worlds and cannot be compared. {order}; a paired comparison is over the cases that "
            "both have flown."
        )
        if comparison.sealed:
            found.append(
                "Means and intervals of a sealed test are over the worlds before the first that is missing."
            )
    found += about_rows(comparison)
    broken = contradictions(comparison)
    if broken:
        found.append(
            f"A certified bound is contradicted, so one of the two is wrong: {'; '.join(broken[:5])}."
        )
    unknown = sum(case not in comparison.bounds for case in comparison.cases)
    if unknown:
        found.append(
            f"No certified bound is known for {unknown} of {len(comparison.cases)} cases; ratios leave "
            "them out."
        )
    limits = [comparison.limit(case, "t98") for case in comparison.cases]
    tourless = sum(limit is not None and limit.best_tour is None for limit in limits)
    if tourless:
        found.append(
            f"No tour to 98.26 % is known for {tourless} of {len(comparison.cases)} cases that have a bound; "
            "ratios leave them out."
        )
    return found


def _verdict(comparison: Comparison) -> str:
    """The result in a few sentences, with what speaks against it."""
    if comparison.missing:
        return (
            f"No verdict: {what_is_missing(comparison)}, and planners can only be ranked by what all "
            "of them have flown."
        )
    unfit = (*comparison.wire_tests, *comparison.by_belief)
    judged = [name for name in comparison.planners if name not in unfit]
    if not judged:
        return " ".join(["No verdict.", *about_rows(comparison)])
    standing = comparison.standing(judged, comparison.cases)
    if not standing:
        return "No verdict: nothing was to be flown."
    if not any(comparison.reached(name, comparison.cases, "t98")[0] for name in standing):
        return _verdict_by_coverage(comparison, standing)
    best, (time, unseen) = next(iter(standing.items()))
    equal = [name for name, (other, _) in standing.items() if other == time]
    if len(equal) == 1:
        flown = comparison.flown(best, comparison.cases)
        reached, count = comparison.reached(best, comparison.cases, "t98")
        what = f"{best} is the fastest here: it" if len(standing) > 1 else f"{best}, the only planner here,"
        text = (
            f"{what} reached 98.26 % of the individuals in {reached} of {count} missions, after "
            f"{_time(comparison, best)} steps on average where never counts as {comparison.unreached}, and "
            f"succeeded in {sum(row.success for _, row in flown)}."
        )
    else:
        text = (
            f"{_listed(equal)} are equally fast here: {number(time)} steps to 98.26 % of the individuals on "
            f"average where never counts as {comparison.unreached}. {_tie(standing, equal, unseen)}"
        )
    reference = best_baseline(comparison, comparison.cases)
    if reference is not None and reference not in equal:
        later = difference(comparison, best, reference, comparison.cases)
        text += (
            f" The best baseline, {reference}, takes {_time(comparison, reference)}; paired by world the "
            f"difference is {with_interval(later)} over {later.count} worlds."
        )
    return text + _of_each_kind(comparison, [best, *([] if reference in (None, best) else [reference])])


def _of_each_kind(comparison: Comparison, planners: Sequence[str]) -> str:
    """Reefs and wrecks apart, where there are both: how many there are of each decides a mean over all."""
    found = groups(comparison)
    kinds = [title for title in ("Reefs together", FAMILIES["wreck"]) if title in found]
    if len(kinds) < 2:
        return ""
    told = []
    for title in kinds:
        cases = found[title]
        takes = [
            f"{name} {number(comparison.estimate(name, cases, comparison.time('t98')).value)}"
            for name in planners
        ]
        told.append(f"on the {len(cases)} {title.split()[0].lower()} {' and '.join(takes)}")
    return f" Steps to 98.26 % {', '.join(told)}: means over all depend on how many there are of each."


def _tie(standing: Mapping[str, tuple[float, float]], equal: Sequence[str], unseen: float) -> str:
    """How those that are equally fast are told apart."""
    first = [name for name in equal if standing[name][1] == unseen]
    if len(first) < len(equal):
        saw = f"{number(1.0 - unseen, 2, scale=100)} % of the individuals"
        also = ", in the order of the benchmark" if len(first) > 1 else ""
        stand = "stands" if len(first) == 1 else "stand"
        return f"Of these, {_listed(first)} saw the most by the end, {saw}, and so {stand} first{also}."
    return "They saw equally much by the end, so that they stand in the order of the benchmark."


def _verdict_by_coverage(comparison: Comparison, standing: Mapping[str, tuple[float, float]]) -> str:
    """The result where nobody reached the mark: how much was seen at the end instead."""
    cases = comparison.cases
    text = (
        "None reached 98.26 % of the individuals in any mission, so that none is the fastest. Judged by "
        "coverage at the end instead, "
    )
    best, (_, unseen) = next(iter(standing.items()))
    first = [name for name, (_, other) in standing.items() if other == unseen]
    saw = f"{_coverage(comparison, best)} % of the individuals on average"
    if len(standing) == 1:
        text += f"{best}, the only planner here, saw {saw}."
    elif len(first) == 1:
        text += f"{best} is the best here: it saw {saw}."
    else:
        text += f"{_listed(first)} are equal: each saw {saw}. They stand in the order of the benchmark."
    reference = best_baseline(comparison, cases)
    if reference is not None and reference not in first:
        found = difference(comparison, best, reference, cases, measure=coverage_at_end, most=1.0)
        text += (
            f" The best baseline, {reference}, saw {_coverage(comparison, reference)} %; paired by world the "
            f"difference is {with_interval(found, 2, scale=100)} points over {found.count} worlds."
        )
    return text


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _time(comparison: Comparison, planner: str) -> str:
    t98, limits = comparison.time("t98"), comparison.time_limits
    return with_interval(comparison.estimate(planner, comparison.cases, t98, limits=limits))


def _coverage(comparison: Comparison, planner: str) -> str:
    found = comparison.estimate(planner, comparison.cases, coverage_at_end, limits=(0.0, 1.0))
    return with_interval(found, 2, scale=100)


# ---- Markdown ----


def markdown(results: Results, comparison: Comparison) -> str:
    """All tables of a benchmark as one Markdown page."""
    escape = escape_markdown
    parts = [f"# Benchmark {escape(str(results.manifest['suite']))}\n"]
    parts += [f"> {escape(text)}\n" for text in warnings(comparison)]
    for section in sections(results, comparison):
        parts.append(f"## {section.title}\n\n{escape(section.lead)}\n")
        parts += [table.markdown() for table in (*section.tables, *section.aside)]
    parts.append("## All measures\n")
    for title, every in details(comparison).items():
        parts.append(f"### {title}\n")
        parts += [table.markdown() for table in every]
    parts.append(run_table(results, comparison).markdown())
    return "\n".join(parts)


# ---- HTML ----


def _page(results: Results, comparison: Comparison) -> str:
    style = _part("dream", "report_page/page.css") + _part("dream.evaluation", "bench_page/page.css")
    style += _colours(comparison)
    every = sections(results, comparison)
    scenes = [figures.scene(results, comparison, case) for case in figures.shown_cases(comparison)]
    blocks = {section.name: (section.title, _section(section, comparison)) for section in every}
    ordered = {}
    for name, block in blocks.items():
        if name == "worlds":
            ordered["ways"] = ("Trajectories", _ways(scenes, comparison))
        ordered[name] = block
    ordered["details"] = ("All measures", _details(comparison))
    run = run_table(results, comparison)
    ordered["run"] = ("What was run", f'<div class="run">{_table(run, comparison)}</div>')
    collisions = sum(row.collisions for row in comparison.rows.values())
    worlds = {(case.world, case.seed) for case in comparison.cases}
    shown = (
        ("planners", len(comparison.planners)),
        ("worlds", len(worlds)),
        ("missions", len(comparison.rows)),
        ("contacts", collisions),
    )
    suite = str(results.manifest["suite"])
    return fill(
        _part("dream.evaluation", "bench_page/page.html"),
        {
            "policy": f"default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; style-src "
            f"{digest(style)}",
            "title": html.escape(f"{comparison.protocol} · {suite} · DREAM benchmark"),
            "style": style,
            "heading": html.escape(f"{comparison.protocol} · {suite}"),
            "how": html.escape(
                f"protocol {comparison.protocol}, {comparison.horizon} steps at most, version "
                f"{results.manifest['version']}, "
                f"{str(results.manifest['finished'] or results.manifest['started'])[:10]}"
            ),
            "figures": "".join(f"<div><dt>{name}</dt><dd>{count}</dd></div>" for name, count in shown),
            "notices": "".join(f'<p class="notice">{html.escape(text)}</p>' for text in warnings(comparison)),
            "contents": "".join(f'<a href="#{name}">{SHORT[name]}</a>' for name in ordered),
            "sections": "\n".join(
                f'<section class="panel" id="{name}"><h2>{html.escape(title)}</h2>{body}</section>'
                for name, (title, body) in ordered.items()
            ),
            "repeating": _repeating(results.manifest),
        },
    )


def _repeating(manifest: Mapping[str, Any]) -> str:
    command, scripts = repeating_command(manifest), flown_by_scripts(manifest)
    told = [f"Repeat it with <code>{html.escape(command)}</code>"] if command else []
    return "; ".join([*told, html.escape(scripts)] if scripts else told)


def _colours(comparison: Comparison) -> str:
    """Rules for the planners' colours, and for hiding a planner's way over the worlds."""
    rules, dark = [], []
    for k, planner in enumerate(comparison.planners):
        rules.append(f".c{k} {{ background: {_color(figures.LIGHT, comparison, planner)}; }}")
        dark.append(f".c{k} {{ background: {_color(figures.DARK, comparison, planner)}; }}")
        rules.append(f"main:has(#show{k}:not(:checked)) .w{k} {{ display: none; }}")
    rules.append("main:has(#show-tour:not(:checked)) .tour { display: none; }")
    return "\n".join([*rules, "@media (prefers-color-scheme: dark) {", *dark, "}"])


def _color(theme: figures.Theme, comparison: Comparison, planner: str) -> str:
    return str(figures.look(theme, comparison.planners, planner)["color"])


def _section(section: Section, comparison: Comparison) -> str:
    parts = [f'<p class="lead">{html.escape(section.lead)}</p>']
    drawn = (
        f'<div class="pictures">{"".join(map(_picture, section.pictures))}</div>' if section.pictures else ""
    )
    first, *others = [_table(table, comparison) for table in section.tables] or [""]
    if section.name == "paper":
        parts.append(f'<div class="pairs">{"".join(f"<div>{each}</div>" for each in (first, *others))}</div>')
    else:
        parts += [first, drawn, *others]
    if section.aside:
        apart = "".join(f"<div>{_table(table, comparison)}</div>" for table in section.aside)
        parts.append(f'<div class="aside pairs">{apart}</div>')
    return "".join(parts)


def _table(table: Table, comparison: Comparison) -> str:
    head = "".join(
        f'<th scope="col"{_name(k, table)}>{html.escape(heading)}</th>'
        for k, heading in enumerate(table.headings)
    )
    head = f"<thead><tr>{head}</tr></thead>" if any(table.headings) else ""
    rows = "".join(f"<tr>{_cells(row, table, comparison)}</tr>" for row in table.rows)
    notes = "".join(f'<p class="note">{html.escape(note)}</p>' for note in table.notes)
    # The one table of its section needs no title of its own.
    title = f"<h3>{html.escape(table.title)}</h3>" if any(table.headings) else ""
    return (
        f"{title}"
        f'<p class="more" aria-hidden="true">The table goes on to the right →</p>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{html.escape(table.title)}">'
        f"<table>{head}<tbody>{rows}</tbody></table></div>{notes}"
    )


def _cells(row: Sequence[str], table: Table, comparison: Comparison) -> str:
    cells = []
    for k, cell in enumerate(row):
        if k < table.labels:
            dot = ""
            if table.headings[k] in ("planner", "method") and cell in comparison.planners:
                dot = f'<i class="dot c{comparison.planners.index(cell)}"></i>'
            tag = "th" if k == 0 else "td"
            scope = ' scope="row"' if k == 0 else ""
            cells.append(f'<{tag}{scope} class="name">{dot}{html.escape(cell)}</{tag}>')
        else:
            cells.append(f"<td>{_quiet(cell)}</td>")
    return "".join(cells)


def _quiet(cell: str) -> str:
    """A cell whose interval and count stand back behind its number."""
    value, between, rest = re.fullmatch(r"(.*?)(?:( \(| · )(.*))?", cell, re.DOTALL).groups()  # type: ignore[union-attr]
    if rest is None:
        return html.escape(value)
    return f"{html.escape(value)} <small>{html.escape(between.strip(' ·') + rest)}</small>"


def _name(k: int, table: Table) -> str:
    return ' class="name"' if k < table.labels else ""


def _picture(picture: Picture) -> str:
    light, dark = (_url("svg+xml", picture.svg(theme)) for theme in (LIGHT, DARK))
    return (
        f'<figure><picture><source media="(prefers-color-scheme: dark)" srcset="{dark}">'
        f'<img src="{light}" alt="{html.escape(picture.title)}"></picture>'
        f"<figcaption><span>{html.escape(picture.says)}</span></figcaption></figure>"
    )


def _details(comparison: Comparison) -> str:
    parts = []
    for title, every in details(comparison).items():
        body = "".join(_table(table, comparison) for table in every)
        parts.append(f"<details><summary>{html.escape(title)}</summary>{body}</details>")
    return f'<div class="details">{"".join(parts)}</div>'


def _ways(scenes: Sequence[Scene], comparison: Comparison) -> str:
    """The ways of all planners over the worlds; each can be switched off, without a script."""
    names = [name for name in comparison.planners if any(name in scene.tracks for scene in scenes)]
    switches, first = [], comparison.ranked[:SHOWN]
    for name in names:
        k = comparison.planners.index(name)
        switches.append(_switch(f"show{k}", _stroke(comparison, name), name, on=name in first))
    if any(scene.tour is not None for scene in scenes):
        switches.append(
            _switch("show-tour", ' stroke="currentColor" stroke-dasharray="5 4"', figures.TOUR, on=True)
        )
    cases = sum(any((case, name) in comparison.rows for name in names) for case in comparison.cases)
    some = f" {len(scenes)} of the {cases} cases, spread over the families." if len(scenes) < cases else ""
    some += (
        " Names switch planners on and off; at first the best ranked are shown." if len(names) > SHOWN else ""
    )
    return (
        '<p class="lead">Where the planners went, seen from above: north is up, targets are coloured by '
        "patch, obstacles grey. A ring where the mission began, a dot where it ended, a red cross where it "
        f"touched something.{some}</p>"
        f'<div class="switches">{"".join(switches)}</div>'
        f'<div class="maps">{"".join(_map(scene, comparison) for scene in scenes)}</div>'
    )


def _switch(name: str, stroke: str, text: str, *, on: bool) -> str:
    return (
        f'<label><input type="checkbox" id="{name}"{" checked" if on else ""}><svg viewBox="0 0 26 10">'
        f'<line x1="1" y1="5" x2="25" y2="5" stroke-width="3"{stroke}/></svg>{html.escape(text)}</label>'
    )


def _map(scene: Scene, comparison: Comparison) -> str:
    size = scene.pixels
    parts = []
    if scene.chart is not None:
        parts.append(f'<image width="{size}" height="{size}" href="{_url("jpeg", _jpeg(scene.chart))}"/>')
    if scene.tour is not None:
        parts.append(f'<path class="tour" stroke="#0c2431" stroke-dasharray="9 7" d="{_path(scene.tour)}"/>')
    start = next(iter(scene.tracks.values()))[0]
    for name, track in scene.tracks.items():
        color = _color(LIGHT, comparison, name)
        x, y = track[-1]
        crosses = "".join(f"M{u - 7:.0f} {v - 7:.0f}l14 14m0-14l-14 14" for u, v in scene.contacts[name])
        touched = f'<path stroke="#b3261e" d="{crosses}"/>' if crosses else ""
        parts.append(
            f'<g class="w{comparison.planners.index(name)}"><path{_stroke(comparison, name)} '
            f'd="{_path(track)}"/><circle cx="{x:.1f}" cy="{y:.1f}" r="6.5" fill="{color}" stroke="#fff" '
            f'stroke-width="2"/>{touched}</g>'
        )
    parts.append(
        f'<circle cx="{start[0]:.1f}" cy="{start[1]:.1f}" r="9" fill="none" stroke="#0c2431" '
        'stroke-width="3"/>'
    )
    times = {name: comparison.rows[scene.case, name].t98 for name in scene.tracks}
    least = min((time for time in times.values() if time is not None), default=None)
    fastest = [name for name, time in times.items() if time == least]
    who = ", ".join(fastest) if len(fastest) <= 2 else f"{len(fastest)} planners"
    outcome = "98.26 % never" if least is None else f"{who} {least}"
    name = html.escape(label(scene.case))
    return (
        f'<figure><svg viewBox="0 0 {size} {size}" role="img" aria-label="Trajectories in '
        f'{name}">{"".join(parts)}</svg>'
        f"<figcaption><span>{name}</span><span>{html.escape(outcome)}</span></figcaption></figure>"
    )


def _stroke(comparison: Comparison, planner: str) -> str:
    style = figures.look(LIGHT, comparison.planners, planner)
    dashes = (
        ""
        if isinstance(style["linestyle"], str)
        else " ".join(f"{4 * length:g}" for length in style["linestyle"][1])
    )
    return f' stroke="{style["color"]}"' + (f' stroke-dasharray="{dashes}"' if dashes else "")


def _path(points: Any) -> str:
    """Path data; places where the vehicle only turned are left out."""
    kept = [f"{x:.1f} {y:.1f}" for x, y in points]
    return "M" + "L".join(point for k, point in enumerate(kept) if k == 0 or point != kept[k - 1])


def _jpeg(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "jpeg", quality=JPEG_QUALITY)
    return buffer.getvalue()


def _url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _part(package: str, name: str) -> str:
    return resources.files(package).joinpath(*name.split("/")).read_text(encoding="utf-8")


# ---- the documentation ----


def write_results(
    folders: Sequence[Path],
    page: Path,
    pictures: Path,
    *,
    watched: Callable[[Sequence[Path]], Iterable[Path]] = iter,
) -> list[Path]:
    """Write the documentation's page of results, and its pictures as files; returns the paths of these.

    A folder that holds benchmark folders of several reaches is shown as a sweep. What was flown with the
    stand-in for a model is left out, and the page says so.

    Args:
        folders: Of benchmarks, or of sweeps.
        page: The file to write.
        pictures: Folder for its pictures.
        watched: Passes the folders on, and may show how far it is.

    Raises:
        FileNotFoundError: A folder is neither a benchmark nor a sweep.
        ValueError: A file is damaged, or nothing was flown but with the stand-in.
    """
    parts = [_INTRODUCTION]
    files: dict[Path, bytes] = {}
    taken: set[str] = set()
    for folder in watched(folders):
        name = _slug(folder.resolve().name, taken)
        drawn: list[tuple[Picture, str]]
        if (folder / "manifest.json").is_file():
            text, drawn = _chapter(*_without_wire_tests(folder), name)
        else:
            text, drawn = _sweep_chapter(folder, name)
        for picture, kind in drawn:
            path = pictures / f"{name}-{picture.name}.{kind}"
            files[path] = picture.svg() if kind == "svg" else picture.png()
            link = Path(os.path.relpath(path, page.parent)).as_posix()
            text = text.replace(_place(picture), f"![{picture.title}]({quote(link)})\n\n*{picture.says}*\n")
        parts.append(text)
    parts.append("## As published elsewhere\n")
    parts += [table.markdown() for table in published_tables()]
    for path, content in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_whole(page, "\n".join(parts).encode())
    return list(files)


_INTRODUCTION = """\
# Results

This page is written by `dream results` from the files of benchmarks and says nothing that is not in them;
the same files give the same page, byte for byte. Numbers are only comparable within one protocol. What other
papers published, in other simulators, stands apart at the end. Each folder was flown with the code of the
commit that stands under *What was run*: with that checked out, `dream bench` goes on with it.
"""


def _place(picture: Picture) -> str:
    """Where a picture goes in the text: a mark that no escaped text can hold."""
    return f"<picture {picture.name}>"


def _without_wire_tests(folder: Path) -> tuple[Results, list[str]]:
    """A benchmark without what was flown with the stand-in, and what there is to say of that."""
    results = read_results(folder)
    planners = results.manifest["planners"]
    others = {name: given for name, given in planners.items() if not is_wire_test(given)}
    tested = [name for name in planners if name not in others]
    if not tested:
        return results, []
    if not others:
        raise ValueError(
            f"{folder}: expected something to publish, got only what {', '.join(tested)} flew with the "
            f"stand-in for a model, {WIRE_TEST}"
        )
    manifest = {
        **results.manifest,
        "planners": others,
        "failed": [entry for entry in results.manifest["failed"] if entry["planner"] in others],
    }
    rows = tuple(row for row in results.rows if row.planner in others)
    traces = {row.key: results.traces[row.key] for row in rows}
    said = f"Left out: what {', '.join(tested)} flew with the stand-in for a model, {WIRE_TEST}."
    return Results(manifest, rows, traces), [said]


def _chapter(results: Results, left_out: Sequence[str], name: str) -> tuple[str, list[tuple[Picture, str]]]:
    """A benchmark in Markdown, with the place of each picture, and these with the kind of file of each."""
    comparison = compare(results)
    escape = escape_markdown
    every = sections(results, comparison)
    drawn = [(picture, "svg") for section in every for picture in section.pictures]
    shown = figures.shown_cases(comparison)
    parts = [
        f"## {comparison.protocol} · {escape(str(results.manifest['suite']))}\n",
        *(f"> {escape(each)}\n" for each in (*left_out, *warnings(comparison))),
    ]
    for section in every:
        parts.append(f"### {section.title}\n\n{escape(section.lead)}\n")
        first, *others = [table.markdown() for table in section.tables] or [""]
        parts += [first, *map(_place, section.pictures), *others]
    if shown:
        ways = figures.trajectories(
            comparison,
            comparison.ranked[:SHOWN],
            [figures.scene(results, comparison, case) for case in shown],
        )
        drawn.append((ways, "png"))
        thinned = len(shown) < len(comparison.cases)
        some = f" {len(shown)} of {len(comparison.cases)} cases, spread over the families." if thinned else ""
        parts.append(
            f"### {ways.title}\n\n{ways.title} over the worlds, seen from above.{some}\n\n{_place(ways)}"
        )
    parts.append(f"### What was run\n\n{run_table(results, comparison).markdown()}")
    return "\n".join(parts), drawn


def _sweep_chapter(folder: Path, name: str) -> tuple[str, list[tuple[Picture, str]]]:
    """A sweep in Markdown: one picture and one table over all reaches."""
    found: dict[float, tuple[Results, Comparison]] = {}
    left_out: dict[str, None] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if (path / "manifest.json").is_file():
            results, said = _without_wire_tests(path)
            left_out |= dict.fromkeys(said)
            reach = results.manifest["protocol"].get("reach")
            if not is_number(reach) or reach in found:
                raise ValueError(f"{path}: expected a benchmark with a reach of its own, got {reach}")
            found[float(reach)] = results, compare(results)
    if not found:
        raise FileNotFoundError(f"{folder}: expected a folder of dream bench or dream sweep, got neither")
    comparisons = {reach: found[reach][1] for reach in sorted(found)}
    picture = figures.sweep(comparisons)
    first = found[min(found)][0]
    parts = [
        f"## Sweep over the reach: {escape_markdown(str(first.manifest['suite']))}\n",
        *(f"> {escape_markdown(each)}\n" for each in left_out),
        _place(picture),
    ]
    parts.append(tables.sweep_table(comparisons).markdown())
    parts += [run_table(*found[reach]).markdown() for reach in comparisons]
    return "\n".join(parts), [(picture, "svg")]


def _slug(name: str, taken: set[str]) -> str:
    """A file name from a folder's, different from those already taken."""
    slug = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip(".-") or "bench"
    count = sum(
        other == slug or re.fullmatch(re.escape(slug) + r"-\d+", other) is not None for other in taken
    )
    taken.add(slug if not count else f"{slug}-{count + 1}")
    return slug if not count else f"{slug}-{count + 1}"
