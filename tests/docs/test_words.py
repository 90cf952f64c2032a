"""One word for one thing, and no history, in all that people read: pages, help, reports, the terminal."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from dream.cli import COMMANDS, run_command
from dream.planning import PLANNERS
from tests.docs.reading import (
    ROOT,
    markdown,
    named,
    prose_of_html,
    prose_of_markdown,
    prose_of_script,
    sentences,
)

WORDS = {
    r"(?<!for )\binstances?\b": "individual",
    r"\bclumps?\b": "individual; a clump only where it is said what an individual is",
    r"(?<!Ray )\bclusters?\b": "patch",
    r"\bgroups? of (?:targets?|individuals|shells|clumps|oysters)\b|\btarget groups?\b": "patch",
    r"\b(?:miss|find|see)\w* (?:a|the|no|small\w*) groups?\b": "patch",
    r"\bcollisions?\b|\bcollided?s?\b": "contact, touch",
}
"""What is not said, and what is said in its place."""

CLUMP = re.compile(r"\bclumps?\b", re.IGNORECASE)

HISTORY = (
    r"\bversions? (?:before|of before|of then)\b|\bbefore it, the version\b",
    r"\b(?:was|were) tried\b|\bwhat else was looked at\b",
    r"\bhad (?:learnt|learned)\b|\bwhen .{1,40} learnt\b",
    r"\bflown (?:once, and )?anew\b|\bonce, and anew\b|\banew when\b",
    r"\b(?:flown|timed|measured) (?:before|while|when)\b",
    r"\bbefore (?:the planner|the map|belief|`|it) ?(?:took|had|learnt|looked)\b",
    r"\bused to (?:be|have|do|take|cost|need|say|stand)\b",
    r"\bno longer\b(?! (?:than|there)\b)",
    r"\buntil now\b|\bnowadays\b|\bformerly\b|\bin former\b",
    r"\bthe earlier (?:rule|version|way|planner|map)\b|\bthe old (?:rule|version|way)\b",
)
"""How a figure or a rule came to be: that stands in CHANGELOG.md, or nowhere."""

ADVICE = r"pip install [\"']?dream-auv"
"""The name is on no index."""

HISTORIES = {"CHANGELOG.md"}
SCRIPTS = ("report_page/*.js", "live/page/*.js", "teaching/page/*.js")
TEMPLATES = (
    "report_page/*.html",
    "live/page/*.html",
    "teaching/page/*.html",
    "survey/products/*.html",
    "evaluation/*_page/*.html",
)
SPEAKING = ("commands/**/*.py", "evaluation/**/*.py", "survey/**/*.py", "planning/sentences.py")
"""Modules whose strings people read in the terminal, in tables and in reports."""
OTHERS_WORDS = {"darwin_core.py"}
"""In its standard an individual is one organism."""
PROMPTED = ("To stop now would miss a group",)
"""What models are told stays as it is, so that their answers can be compared."""
HELP = [
    [],
    *([command] for command in COMMANDS if command not in ("survey", "seal")),
    *(["run", planner] for planner in PLANNERS),
    *(["survey", one] for one in ("add", "list", "show", "remove", "compare", "export")),
    *(["seal", one] for one in ("new", "show", "open", "check")),
]


def against_words(prose: str) -> list[str]:
    found = []
    for sentence in sentences(prose):
        if sentence.startswith(PROMPTED):
            continue
        if re.search(r"\b(?:frontier|unknown|cells)\b", sentence, re.IGNORECASE):
            # Cells of a frontier that touch are a cluster in the literature, and here.
            sentence = re.sub(r"\bclusters?\b", "", sentence, flags=re.IGNORECASE)
        # The one place for a clump is where it is told that it is the individual.
        told = (
            CLUMP.sub("", sentence) if re.search(r"\bindividuals?\b", sentence, re.IGNORECASE) else sentence
        )
        for pattern, instead in WORDS.items():
            if hit := re.search(pattern, told, re.IGNORECASE):
                found.append(f"{hit[0]!r} (say {instead}): {sentence[:140]}")
    return found


def against_history(prose: str) -> list[str]:
    return [
        f"{hit[0]!r} (tells how it came to be): {sentence[max(0, hit.start() - 60) : hit.end() + 60]}"
        for sentence in sentences(prose)
        for pattern in HISTORY
        if (hit := re.search(pattern, sentence, re.IGNORECASE))
    ]


def found_in_page(path: Path) -> list[str]:
    """All that a page should not say."""
    text = path.read_text(encoding="utf-8")
    advice = [f"{hit} (see docs/install.md)" for hit in re.findall(ADVICE, text)]
    prose = prose_of_markdown(text)
    return against_words(prose) + advice + ([] if path.name in HISTORIES else against_history(prose))


@pytest.mark.parametrize("path", markdown(), ids=named)
def test_a_page_has_one_word_for_one_thing_and_no_history(path: Path) -> None:
    assert found_in_page(path) == []


def shown() -> list[Path]:
    inside = ROOT / "src" / "dream"
    return sorted(path for pattern in (*SCRIPTS, *TEMPLATES) for path in inside.glob(pattern))


def found_in_template(path: Path) -> list[str]:
    """What a page that the program writes should not say."""
    text = path.read_text(encoding="utf-8")
    prose = prose_of_html(text) if path.suffix == ".html" else prose_of_script(text)
    return against_words(prose) + against_history(prose)


@pytest.mark.parametrize("path", shown(), ids=named)
def test_a_report_has_one_word_for_one_thing(path: Path) -> None:
    assert found_in_template(path) == []


def test_every_kind_of_report_is_read() -> None:
    assert {path.parent.name for path in shown()} >= {"report_page", "page", "products", "bench_page"}


def found_in_help(printed: str) -> list[str]:
    """What the help of a command should not say."""
    plain = re.sub(r"[│─╭╮╰╯]|--[a-z][a-z-]*|\{[^}]*\}", " ", printed)
    return against_words(plain) + against_history(plain)


@pytest.mark.parametrize("words", HELP, ids=lambda words: " ".join(["dream", *words]))
def test_help_has_one_word_for_one_thing(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    assert run_command([*words, "--help-all" if words else "--help"]) == 0
    assert found_in_help(capsys.readouterr().out) == []


def said_by(path: Path) -> str:
    """The strings of a module that hold a blank, docstrings and the names of fields aside."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return "\n\n".join(
        re.sub(r"^(?:[a-z_]+: )+(?=expected)", "", node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and " " in node.value.strip()
        and id(node) not in docstrings
    )


def speaking() -> list[Path]:
    inside = ROOT / "src" / "dream"
    return sorted(
        path for pattern in SPEAKING for path in inside.glob(pattern) if path.name not in OTHERS_WORDS
    )


def test_what_commands_say_has_one_word_for_one_thing() -> None:
    found = {named(path): against_words(said_by(path)) for path in speaking()}
    assert {name: hits for name, hits in found.items() if hits} == {}


@pytest.mark.parametrize(
    ("said", "hits"),
    [
        ("It sees each instance of the reef.", 1),
        ("Take the wreck, for instance.", 0),
        ("An individual of a simulated reef is a clump of shells.", 0),
        ("Half of the clumps are wider.", 1),
        ("The key `clusters` stays as it is.", 0),
        ("It flies on a Ray cluster.", 0),
        ("No group of targets is smaller.", 1),
        ("Success: no collision.", 1),
        ("A frontier and its clusters are kept.", 0),
        ("What was tried did not help.", 1),
        ("They were flown anew when the map had learnt to see decks.", 2),
        ("A step no longer than 2 m.", 0),
    ],
)
def test_what_is_found_is_what_is_meant(said: str, hits: int) -> None:
    prose = prose_of_markdown(said)
    assert len(against_words(prose) + against_history(prose)) == hits


def test_the_glossary_is_in_order_and_has_the_words_of_tables_and_reports() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    names = [entry.lower() for entry in re.findall(r"^\*\*(.+?)\*\* – ", text, re.MULTILINE)]
    assert names == sorted(names, key=lambda name: re.sub(r"[^a-z0-9 ]", "", name))
    told = {word for name in names for word in re.split(r", | and ", name)}
    assert told >= {
        *("individual", "patch", "seen", "reach", "look-around", "step", "lattice", "cap", "success", "risk"),
        *("hint", "frontier", "t90", "t98", "t_stop", "spl", "iqm", "bound", "best tour", "guard", "cell"),
        *(
            "label",
            "survey",
            "archive",
            "registration",
            "quadrat",
            "capture model",
            "dvl",
            "heading",
            "compass",
        ),
        *("planner", "run", "mission", "world", "suite", "contact", "kaplan–meier", "auc", "p(better)"),
    }
