"""An answer is found where models put it; what lacks one is told. Text is searched, and never evaluated."""

from __future__ import annotations

import json
import random
import string
import time

import pytest

from dream.planning.vlm.asking import finding
from dream.planning.vlm.asking.finding import answer_in, fits, lacking
from dream.planning.vlm.reply import dream_reply
from dream.protocol import DREAM_V1
from tests.planning.vlm.asking.counting import SO, Number

DRAFT = '{"why": "draft", "number": 9}'

PLACED = {
    "alone": f"\n {SO} ",
    "a lone closing tag": f"Let me think. Perhaps {DRAFT}.\n</think>\n\n{SO}",
    "a tag of another name": f"[THINK]perhaps {DRAFT}[/THINK]{SO}",
    "a tag of one more name": f"◁think▷perhaps {DRAFT}◁/think▷{SO}",
    "thinking that never closes": f"<think>It is three: {SO}",
    "nothing after the closing tag": f"It is three: {SO}</think>\n",
    "channels": f"<|channel|>analysis<|message|>Perhaps {DRAFT}<|end|><|start|>assistant<|channel|>final"
    f"<|message|>{SO}<|return|>",
    "a constrained channel": f"<|channel|>final <|constrain|>JSON<|message|>{SO}<|return|>",
    "channels without their tokens": f"analysisPerhaps {DRAFT}assistantfinal{SO}",
    "a box": f"<|begin_of_box|>{SO}<|end_of_box|>",
    "a fence": f"Here you are:\n```json\n{SO}\n```\nThat is {{all}}.",
    "a fence that never closes": f"```\n{SO}",
    "prose with braces and quotes": f'The set {{1, 2}} and "{{" do not matter. {SO} I am sure.',
    "the second of two": f"First {DRAFT}, no: {SO}",
    "before what does not fit": f'{SO}\nor shorter: {{"number": 3}}',
    "an end that repeats itself": SO + "\n\nassistant" * 50,
}


@pytest.mark.parametrize("text", PLACED.values(), ids=PLACED)
def test_the_answer_is_found(text: str) -> None:
    assert answer_in(text, Number) == SO
    assert lacking(text, Number) == ""


NONE = {
    "a draft, and then no answer": (f"Perhaps {DRAFT}</think>I cannot say.", "no JSON object"),
    "an answer inside of something else": (
        f'{{"steps": [1], "answer": {SO}}}',
        "why: Field required; number: Field required; steps: Extra inputs are not permitted; "
        "answer: Extra inputs are not permitted",
    ),
    "what only Python would read": ("{'why': 'so', 'number': 3}", "the whole: Invalid JSON: key must be"),
    "an expression": ('{"why": "so", "number": __import__("os").getpid()}', "the whole: Invalid JSON: exp"),
    "one field less": ('{"why": "so"}', "number: Field required"),
    "one field too long": (f'{{"why": "{21 * "x"}", "number": 3}}', "why: String should have at most 20"),
    "half of it": (SO[:-5], "the whole: Invalid JSON: EOF while parsing"),
    "words": ("I would rather not.", "no JSON object"),
    "nothing": ("", "nothing was written"),
}


@pytest.mark.parametrize(("text", "lacks"), NONE.values(), ids=NONE)
def test_what_a_reply_without_an_answer_lacks_is_told(text: str, lacks: str) -> None:
    assert not fits(answer_in(text, Number), Number)
    assert lacking(text, Number).startswith(lacks)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"{SO}\n\nassistant\n\nassis", True),
        (f"```json\n{SO}\n```\nThis is because the", True),
        (f"thought</think>{SO}  and so", True),
        (f"Perhaps {DRAFT}, but then the", False),
        (f"<think>First {SO} comes to mind, but", False),
        (SO[:-3], False),
    ],
)
def test_of_a_reply_that_broke_off_only_what_it_began_with_counts(text: str, *, found: bool) -> None:
    assert fits(answer_in(text, Number, cut=True), Number) == found


def test_what_is_lacking_is_one_short_line_without_what_a_terminal_would_obey() -> None:
    hostile = {f"\x1b[31m{k}\n" + 500 * "y": k for k in range(100)}
    told = lacking(json.dumps(hostile), Number)
    assert told.isprintable()
    assert len(told) <= finding.MOST_LACKING
    assert told.startswith("why: Field required; number: Field required")


def test_a_field_that_may_not_be_named_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "secret-words")
    told = lacking('{"why": "so", "number": 3, "secret-words": 1}', Number)
    assert told == "[key]: Extra inputs are not permitted"


@pytest.mark.parametrize(
    "text",
    [
        '{"a":' * 300_000,
        "{" * 1_000_000,
        '{"' * 500_000,
        '{"a":[1,1,1,1,1,1,1,1,' * 40_000,
        "<think>" * 100_000 + "</think>" * 100_000,
        "assistantfinal" * 70_000,
        '{"why": "' + "\\" * 900_000,
        "[" * 900_000,
    ],
    ids=lambda text: text[:12],
)
def test_what_is_searched_is_bounded(text: str) -> None:
    began = time.process_time()
    assert not fits(answer_in(text, Number), Number)
    assert time.process_time() - began < 1.0


def test_an_answer_that_stands_behind_a_long_thought_is_found() -> None:
    assert answer_in("so it goes { " * 50_000 + f"</think>{SO}", Number) == SO


PIECES = (
    SO,
    DRAFT,
    SO[:-4],
    "</think>",
    "<think>",
    "<|channel|>final<|message|>",
    "```json\n",
    "```",
    "assistantfinal",
    '{"why": {"why": ',
    "\x1b[2J",
    "\ud800",
    "NaN",
    "\\u0000",
    '"',
    "{",
    "}",
)


def test_no_reply_that_chance_makes_is_more_than_an_answer_or_none() -> None:
    """Fuzz: any text gives an object of the model's own that fits, or one line on what it lacks."""
    dice = random.Random(39)
    kinds = (Number, dream_reply(DREAM_V1))
    whole = json.dumps(
        dict.fromkeys(kinds[1].model_fields, "x")
        | {"direction": "left", "turn_deg": 45, "step_m": 1}
        | {"done": False}
    )
    found = 0
    for _ in range(1500):
        pieces = [dice.choice((*PIECES, whole)) for _ in range(dice.randint(1, 8))]
        for _ in range(dice.randint(0, 3)):
            k = dice.randrange(len(pieces))
            cut = dice.randrange(len(pieces[k]) + 1)
            pieces[k] = pieces[k][:cut] + dice.choice(string.printable) + pieces[k][cut:]
        text, kind = "".join(pieces), dice.choice(kinds)
        answer, told = answer_in(text, kind, cut=dice.random() < 0.2), lacking(text, kind)
        assert answer in text
        assert told.isprintable()
        assert len(told) <= finding.MOST_LACKING
        assert (told == "") == fits(answer_in(text, kind), kind)
        found += told == ""
    assert 100 < found < 1400


def test_an_answer_is_looked_for_as_far_back_as_several_would_reach_and_no_farther() -> None:
    talk = "so it goes. "
    assert answer_in(SO + talk * 4_000, Number) == SO
    assert not fits(answer_in(SO + talk * 40_000, Number), Number)
