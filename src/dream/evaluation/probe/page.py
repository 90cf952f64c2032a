"""The page of a probe: every question with its picture, what was right, and what was answered."""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from dream.evaluation.probe.questions import KINDS
from dream.evaluation.probe.score import BLIND, READ, READS, READS_KIND, SILENT, Reply, Score, Tally, duration
from dream.files import write_whole
from dream.report import digest, fill

MOODS = {READ: "good", BLIND: "bad", SILENT: "bad"}
"""Of verdicts; others are a warning."""
BAR = 220
"""Pixels from 0 to 100 %."""


def write_page(folder: Path, score: Score, summary: Mapping[str, Any]) -> Path:
    """Make `probe.html` and `probe.json` in a folder.

    Args:
        folder: There is one.
        score: What was answered.
        summary: What the command prints.

    Returns:
        The path of the page.
    """
    record = {**summary, "replies": [reply.as_dict() for reply in score.replies]}
    write_whole(folder / "probe.json", (json.dumps(record, allow_nan=False, indent=1) + "\n").encode())
    page = folder / "probe.html"
    write_whole(page, _page(score, str(summary["model"]), str(summary["prompt"])).encode())
    return page


def _page(score: Score, model: str, prompt: str) -> str:
    kinds = list(score.kinds)
    style = "\n".join(
        [
            _part("dream", "report_page/page.css"),
            _part("dream.evaluation", "probe_page/page.css"),
            *map(_hiding, kinds),
            "main:has(#only-mistakes:checked) .card.right { display: none; }",
        ]
    )
    whole, record = score.whole, score.as_dict()
    latency = record["latency_s"]["p50"]
    cost = "–" if record["cost_usd"] is None else f"{record['cost_usd']:.2f} USD"
    figures = {
        "right": f"{whole.right} <small>of {whole.asked}</small>",
        "by chance": f"{whole.chance * whole.asked:.0f}",
        "an answer takes": "–" if latency is None else duration(latency),
        "cost": cost,
    }
    wrong = sum(not reply.right for reply in score.replies)
    shown = f"{len(score.replies)}{'' if score.complete else f' of {score.questions}'} asked"
    return fill(
        _part("dream.evaluation", "probe_page/page.html"),
        {
            "policy": f"default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; style-src "
            f"{digest(style)}",
            "title": html.escape(f"{model} · DREAM map-reading probe"),
            "style": style,
            "heading": html.escape(model),
            "mood": {"yes": "good", "no": "bad"}.get(score.reads, "warn"),
            "badge": score.reads,
            "verdict": html.escape(score.verdict),
            "figures": "".join(
                f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in figures.items()
            ),
            "table": _table(score),
            "note": html.escape(
                f"Bars: the share of right answers and its 95 % interval (Wilson); dashed: chance. A kind is "
                f"read where the interval lies above {READS_KIND:.0%}, the map where that of all questions "
                f"lies above {READS:.0%} and every kind is above chance. No answer counts as wrong. "
                f"Asked with {prompt}; "
                f"{score.spent}."
            ),
            "shown": html.escape(f"{shown}, {wrong} not right"),
            "switches": _switches(kinds),
            "cards": "\n".join(map(_card, score.replies)),
        },
    )


def _hiding(kind: str) -> str:
    """The rule that hides the other kinds where this one is chosen."""
    return f"main:has(#only-{kind}:checked) .card:not(.{kind}) {{ display: none; }}"


def _switches(kinds: list[str]) -> str:
    names = {"all": "all", "mistakes": "not right", **{kind: KINDS[kind].title for kind in kinds}}
    return "".join(
        f'<label><input type="radio" name="only" id="only-{name}"{" checked" if name == "all" else ""}>'
        f"{html.escape(title)}</label>"
        for name, title in names.items()
    )


def _table(score: Score) -> str:
    headings = ("kind", "right", "", "95 % interval", "chance", "no answer", "verdict")
    rows = [
        "<thead><tr>" + "".join(f'<th scope="col">{heading}</th>' for heading in headings) + "</tr></thead>"
    ]
    for kind, tally in score.kinds.items():
        mood = MOODS.get(tally.verdict, "warn")
        rows.append(_row(KINDS[kind].title, tally, f'<td class="verdict {mood}">{tally.verdict}</td>', ""))
    rows.append(_row("all", score.whole, "<td></td>", ' class="whole"'))
    return f"<table>{''.join(rows)}</table>"


def _row(title: str, tally: Tally, verdict: str, attributes: str) -> str:
    interval = tally.interval
    cells = [f"{tally.right} of {tally.asked}", "", "–", "–", str(tally.unanswered or "")]
    if tally.asked:
        cells[1] = _bar(tally)
        cells[2] = f"{interval.low:.0%} to {interval.high:.0%}"
        cells[3] = f"{tally.chance:.0%}"
    return (
        f'<tr{attributes}><th scope="row">{html.escape(title)}</th>'
        + "".join(f"<td>{cell}</td>" for cell in cells)
        + f"{verdict}</tr>"
    )


def _bar(tally: Tally) -> str:
    low, share, high, chance = (
        round(BAR * value, 1)
        for value in (tally.interval.low, tally.interval.value, tally.interval.high, tally.chance)
    )
    return (
        f'<svg viewBox="0 0 {BAR} 18" aria-hidden="true"><rect class="track" y="5" width="{BAR}" height="8" '
        f'rx="4"/><rect class="range" x="{low}" y="5" width="{high - low:.1f}" height="8" rx="4"/>'
        f'<circle class="share" cx="{share}" cy="9" r="5"/>'
        f'<line class="chance" x1="{chance}" x2="{chance}" y1="1" y2="17"/></svg>'
    )


def _card(reply: Reply) -> str:
    question = reply.question
    state = "right" if reply.right else "missing" if reply.given is None else "wrong"
    answers = []
    for choice in question.choices:
        marks = [
            name
            for name, holds in (("right", choice == question.answer), ("given", choice == reply.given))
            if holds
        ]
        answers.append(f'<li class="{" ".join(marks)}">{html.escape(choice)}</li>')
    said = reply.reason or (f"no answer – {reply.exchange.fallback}" if reply.given is None else "")
    picture = f"data:image/webp;base64,{base64.b64encode(_webp(question.picture)).decode()}"
    return (
        f'<article class="card {state} {question.kind}"><img src="{picture}" loading="lazy" '
        f'alt="The map of question {question.number}"><div>'
        f'<p class="label"><span>{question.number} · {html.escape(KINDS[question.kind].title)}</span>'
        f"<span>{html.escape(question.scene)}</span></p>"
        f'<p class="ask">{html.escape(question.text)}</p><ul>{"".join(answers)}</ul>'
        f'<p class="said">{html.escape(said)}</p></div></article>'
    )


def _webp(png: bytes) -> bytes:
    """The same picture to the last bit, in a third of the space."""
    from PIL import Image

    file = io.BytesIO()
    Image.open(io.BytesIO(png)).save(file, "webp", lossless=True, method=2)
    return file.getvalue()


def _part(package: str, name: str) -> str:
    return resources.files(package).joinpath(*name.split("/")).read_text(encoding="utf-8")
