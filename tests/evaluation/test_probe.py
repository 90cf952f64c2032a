"""The questions of `dream probe`: the same each time, balanced, right by a margin; and what answers mean."""

from __future__ import annotations

import io
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image
from pydantic import ValidationError
from scipy.spatial import cKDTree

from dream.cli import run_command
from dream.evaluation.probe import KINDS, QUESTIONS, MapQuestion, Reply, Score, make_questions
from dream.evaluation.probe.reading import (
    BLACK,
    COMPASS,
    DARK_GREEN,
    GRAY,
    GREEN,
    WHITE,
    Ground,
    Regions,
    band,
    heading,
    nearest,
    open_ended,
    shut_off,
    thing,
    whitest,
)
from dream.evaluation.probe.scenes import WORLDS
from dream.evaluation.suites import SUITES
from dream.geometry import SE2
from dream.mapping import drawing
from dream.planning.vlm.asking import Line
from dream.planning.vlm.prompts import Own
from dream.planning.vlm.reply import choice_reply
from dream.types import Exchange
from tests.model_server import NAME, Request, Response, error, says, serving

COLORS = {
    drawing.UNKNOWN: WHITE,
    drawing.EXPLORED: GRAY,
    drawing.TARGET: GREEN,
    drawing.SOLID: BLACK,
    drawing.SOLID_TARGET: DARK_GREEN,
}
PLACES = "nearest", "unexplored", "boundary", "blocked"


@pytest.fixture(scope="module")
def questions() -> list[MapQuestion]:
    return list(make_questions())


def of_kind(questions: list[MapQuestion], kind: str) -> list[MapQuestion]:
    return [question for question in questions if question.kind == kind]


# ------------------------------------------------------------------------------------------ as a whole


@pytest.mark.rare
def test_there_are_200_questions_25_of_each_kind(questions: list[MapQuestion]) -> None:
    assert [question.number for question in questions] == list(range(1, QUESTIONS + 1))
    assert Counter(question.kind for question in questions) == dict.fromkeys(KINDS, 25)
    assert len({(question.text, question.picture) for question in questions}) == QUESTIONS


@pytest.mark.rare
def test_the_questions_are_the_same_each_time_and_the_first_few_the_same_few(
    questions: list[MapQuestion],
) -> None:
    again = list(make_questions(8))
    for question, first in zip(again, questions, strict=False):
        assert (question.text, question.answer, question.asked.sent) == (
            first.text,
            first.answer,
            first.asked.sent,
        )
        assert question.picture == first.picture
    with pytest.raises(ValueError, match="questions: expected 1 to 200, got 201"):
        next(make_questions(201))


@pytest.mark.rare
def test_no_answer_is_right_more_often_than_another(questions: list[MapQuestion]) -> None:
    chance = sum(question.chance for question in questions)
    for place in range(5):
        right = sum(question.choices[place : place + 1] == (question.answer,) for question in questions)
        offered = sum(question.chance for question in questions if len(question.choices) > place)
        assert abs(right - offered) <= 5, place
    first = sum(question.choices[0] == question.answer for question in questions)
    assert abs(first - chance) <= 4
    for kind, asked in KINDS.items():
        counts = Counter(question.answer for question in of_kind(questions, kind))
        if asked.choices:
            assert set(counts) == set(asked.choices)
            assert max(counts.values()) - min(counts.values()) <= 1
    marks = Counter(len(question.marks) for question in questions)
    assert marks == dict.fromkeys(range(5, 10), QUESTIONS // 5)


@pytest.mark.rare
def test_every_kind_is_asked_about_many_maps(questions: list[MapQuestion]) -> None:
    assert not set(WORLDS) & {(case.world, case.seed) for suite in SUITES.values() for case in suite}
    for kind in KINDS:
        maps = Counter(question.scene for question in of_kind(questions, kind))
        assert len(maps) >= 8, kind
        assert max(maps.values()) <= 5, kind


@pytest.mark.rare
def test_what_is_offered_is_in_the_text_in_the_schema_and_on_the_map(questions: list[MapQuestion]) -> None:
    for question in questions:
        asked = question.asked
        assert asked.text == f"{question.text}\nAnswer with one of: {', '.join(question.choices)}."
        schema = asked.reply.model_json_schema()
        assert list(schema["properties"]) == ["reason", "answer"]
        assert schema["properties"]["answer"]["enum"] == list(question.choices)
        assert question.answer in question.choices
        if question.kind in PLACES:
            assert question.choices == tuple(map(str, question.marks))
        assert "$" not in asked.instructions


@pytest.mark.rare
def test_the_sentences_are_regular(questions: list[MapQuestion]) -> None:
    number = r"(-?\d+(?:\.5)?)"
    patterns = {
        "nearest": r"Which mark is nearest to the robot, in a straight line\?",
        "unexplored": r"Which mark has the most white ground within 3 m of it\?",
        "boundary": r"Which mark has a place within 2 m of it where green touches white\?",
        "blocked": r"To which mark is the straight line from the robot blocked by black or dark green\?",
        "heading": r"Towards which point of the compass does the robot head\?",
        "enclosed": r"Is the target region nearest to mark \d fully enclosed, so that none of its green "
        r"touches white\? Green with gaps of less than 2 m is one region\.",
        "point": rf"What is at the point x = {number} m, y = {number} m of the map\?",
        "explored": r"How much of the whole area is explored, that is, not white\?",
    }
    for question in questions:
        assert re.fullmatch(patterns[question.kind], question.text)


@pytest.mark.rare
def test_marks_lie_apart_on_ground_that_is_known(questions: list[MapQuestion]) -> None:
    for question in questions:
        places = [*question.marks.values(), (question.pose.x, question.pose.y)]
        for k, place in enumerate(places):
            assert all(math.dist(place, other) >= 2.5 - 1e-9 for other in places[:k])
        ground = question.ground
        for place in question.marks.values():
            assert ground.cells[ground.index(place)][0] not in (BLACK, DARK_GREEN)


@pytest.mark.rare
def test_the_cells_are_those_of_the_picture(questions: list[MapQuestion]) -> None:
    for question in questions[::20]:
        picture = np.asarray(Image.open(io.BytesIO(question.picture)))
        rows, cols = question.ground.cells.shape
        scale = round(800 / max(rows, cols))
        letter = max(11, round(min(rows, cols) * scale / 55))
        inner = picture[letter : letter + rows * scale, 3 * letter : 3 * letter + cols * scale]
        seen = inner[scale // 2 :: scale, scale // 2 :: scale][::-1]
        same, clean = 0, 0
        for color, code in COLORS.items():
            painted = (seen == color).all(axis=-1)
            clean += int(painted.sum())
            same += int((question.ground.cells[painted] == code).sum())
        assert same >= clean - 5  # The robot's edge is white, too.
        assert clean > 0.75 * rows * cols


# ------------------------------------------------------------------------------- right, by brute force


def cells_of(question: MapQuestion, *codes: int) -> npt.NDArray[np.float64]:
    """(n, 2) middles of the cells of these colours."""
    return _cells_of(question.ground, codes)


@cache
def _cells_of(ground: Ground, codes: tuple[int, ...]) -> npt.NDArray[np.float64]:
    row, col = np.nonzero(np.isin(ground.cells, codes))
    x = ground.bounds.x_min + (col + 0.5) * ground.cell
    return np.stack([x, ground.bounds.y_min + (row + 0.5) * ground.cell], axis=-1)


def away(points: npt.NDArray[np.float64], place: tuple[float, float]) -> npt.NDArray[np.float64]:
    return np.hypot(points[:, 0] - place[0], points[:, 1] - place[1])


def touching(question: MapQuestion, *codes: int) -> npt.NDArray[np.float64]:
    """(n, 2) middles of the cells of these colours that share a side with a white one."""
    return _touching(question.ground, codes)


@cache
def _touching(ground: Ground, codes: tuple[int, ...]) -> npt.NDArray[np.float64]:
    some = _cells_of(ground, codes)
    # Cells that share a corner alone are 1.4 cells apart.
    return some[cKDTree(_cells_of(ground, (WHITE,))).query(some)[0] < 1.2 * ground.cell]


@pytest.mark.rare
def test_the_nearest_mark_is_nearer_by_a_margin(questions: list[MapQuestion]) -> None:
    for question in of_kind(questions, "nearest"):
        ways = sorted(
            (math.dist(place, (question.pose.x, question.pose.y)), str(number))
            for number, place in question.marks.items()
        )
        assert ways[0][1] == question.answer
        assert ways[1][0] - ways[0][0] >= 1.5


@pytest.mark.rare
def test_most_white_ground_lies_around_the_mark(questions: list[MapQuestion]) -> None:
    for question in of_kind(questions, "unexplored"):
        white = cells_of(question, WHITE)
        areas = sorted(
            (0.0625 * np.count_nonzero(away(white, place) <= 3.0), str(number))
            for number, place in question.marks.items()
        )
        assert areas[-1][1] == question.answer
        assert areas[-1][0] - areas[-2][0] >= 4.0


@pytest.mark.rare
def test_one_mark_alone_has_green_that_touches_white_beside_it(questions: list[MapQuestion]) -> None:
    for question in of_kind(questions, "boundary"):
        green, edge = touching(question, GREEN), touching(question, GREEN, DARK_GREEN)
        for number, place in question.marks.items():
            if str(number) == question.answer:
                assert np.count_nonzero((away(green, place) > 0.6) & (away(green, place) <= 1.6)) >= 5
            else:
                assert np.count_nonzero(away(edge, place) <= 3.5) == 0


@pytest.mark.rare
def test_one_way_alone_leads_through_something_solid(questions: list[MapQuestion]) -> None:
    for question in of_kind(questions, "blocked"):
        solid = cells_of(question, BLACK, DARK_GREEN)
        start = np.array([question.pose.x, question.pose.y])
        for number, place in question.marks.items():
            steps = math.ceil(math.dist(place, start.tolist()) / 0.02)
            line = start + np.linspace(0.0, 1.0, steps)[:, None] * (np.array(place) - start)
            off = np.abs(line[:, None, :] - solid[None, :, :]).max(axis=2).min(axis=1)
            if str(number) == question.answer:
                assert 0.02 * np.count_nonzero(off <= 0.125) >= 0.4
            else:
                assert off.min() > 0.2


@pytest.mark.rare
def test_the_robot_heads_where_it_is_said(questions: list[MapQuestion]) -> None:
    for question in of_kind(questions, "heading"):
        east, north = math.cos(question.pose.yaw), math.sin(question.pose.yaw)
        words = question.answer
        across = ("east" in words) - ("west" in words)
        up = ("north" in words) - ("south" in words)
        along = (east * across + north * up) / math.hypot(across, up)
        assert along >= math.cos(math.radians(10.1))


@pytest.mark.rare
def test_regions_that_are_called_enclosed_are(questions: list[MapQuestion]) -> None:
    for question in of_kind(questions, "enclosed"):
        found = re.search(r"mark (\d)", question.text)
        assert found is not None
        place = question.marks[int(found[1])]
        targets, white = cells_of(question, GREEN, DARK_GREEN), cells_of(question, WHITE)
        left = set(range(len(targets)))
        region = {int(away(targets, place).argmin())}
        new = set(region)
        while new:  # All that hangs together by gaps of less than 2 m.
            left -= new
            rest = np.array(sorted(left), np.intp)
            near = [rest[away(targets[rest], tuple(targets[k])) < 2.0] for k in new] if len(rest) else []
            new = set(np.concatenate(near).tolist()) if near else set()
            region |= new
        mine = {tuple(targets[k]) for k in region}
        if question.answer == "no":
            assert sum(tuple(cell) in mine for cell in touching(question, GREEN).tolist()) >= 10
        else:
            assert min(away(white, cell).min() for cell in mine) > 0.75


@pytest.mark.rare
def test_all_around_a_point_is_what_it_is(questions: list[MapQuestion]) -> None:
    codes = {"target": GREEN, "explored": GRAY, "unexplored": WHITE, "solid": BLACK}
    for question in of_kind(questions, "point"):
        x, y = map(float, re.findall(r"= (\S+) m", question.text))
        others = cells_of(question, *(set(range(5)) - {codes[question.answer]}))
        assert away(others, (x, y)).min() > 0.6
        assert min(math.dist(place, (x, y)) for place in question.marks.values()) >= 1.2


@pytest.mark.rare
def test_the_share_explored_lies_well_inside_its_band(questions: list[MapQuestion]) -> None:
    ends = {"less than 20 %": (-1.0, 0.2), "20 to 40 %": (0.2, 0.4), "40 to 60 %": (0.4, 0.6)}
    for question in of_kind(questions, "explored"):
        white = len(cells_of(question, WHITE))
        share = 1.0 - white / question.ground.cells.size
        low, high = ends.get(question.answer, (0.6, 2.0))
        assert low + 0.04 <= share <= high - 0.04


# ------------------------------------------------------------------------------------- the mirror's law


@pytest.mark.rare
def test_in_the_mirror_only_east_and_west_change_places(questions: list[MapQuestion]) -> None:
    for question in questions[:80]:
        ground, pose = question.ground, question.pose
        bounds = ground.bounds
        assert (bounds.x_min, bounds.y_min) == (-bounds.x_max, -bounds.y_max)
        mirrored = Ground(ground.cells[:, ::-1], bounds, ground.cell)
        turned = SE2(-pose.x, pose.y, math.remainder(math.pi - pose.yaw, 2.0 * math.pi))
        marks = np.array(list(question.marks.values())) * (-1.0, 1.0)
        right: str | None
        if question.kind in PLACES:
            measure = dict(zip(PLACES, (nearest, whitest, open_ended, shut_off), strict=True))[question.kind]
            winner = measure(mirrored, turned, marks).winner()
            right = None if winner is None else str(winner + 1)
        elif question.kind == "heading":
            name = heading(turned.yaw)
            assert name in COMPASS
            right = re.sub("east|west", lambda word: "west" if word[0] == "east" else "east", str(name))
        elif question.kind == "enclosed":
            number = int(re.findall(r"mark (\d)", question.text)[0])
            right = Regions.of(mirrored).nearest_enclosed(marks[number - 1 : number])[0]
        elif question.kind == "point":
            x, y = map(float, re.findall(r"= (\S+) m", question.text))
            right = thing(mirrored, -x, y)
        else:
            right = band(mirrored)
        assert right == question.answer, question.text


# ------------------------------------------------------------------------------------------- the reply


def test_a_choice_is_one_of_those_that_are_offered() -> None:
    offered = choice_reply(("1", "2", "12"))
    assert offered.model_validate_json('{"reason": "so", "answer": "12"}').answer == "12"
    assert offered.model_validate_json('{"reason": "so", "answer": 2}').answer == "2"
    for wrong in ('"3"', "3", "true", "1.0", "null", '["1"]', '"mark 1"'):
        with pytest.raises(ValidationError):
            offered.model_validate_json(f'{{"reason": "so", "answer": {wrong}}}')


# ------------------------------------------------------------------------------------------ the scores


def replied(questions: list[MapQuestion], given: Sequence[str | None]) -> Score:
    exchange = Exchange("probe 1", "told", "", {}, (), "", 1, 100, 10, 0.01, 0.5)
    silent = replace(exchange, fallback="timeout: no answer within 60 s")
    return Score(
        tuple(
            Reply(question, answer, "", silent if answer is None else exchange)
            for question, answer in zip(questions, given, strict=True)
        ),
        len(questions),
    )


@pytest.mark.rare
def test_all_right_reads_the_map(questions: list[MapQuestion]) -> None:
    score = replied(questions, [question.answer for question in questions])
    assert (score.whole.right, score.whole.asked, score.complete, score.reads) == (200, 200, True, "yes")
    assert score.verdict.startswith("reads the map: ")
    assert {tally.verdict for tally in score.kinds.values()} == {"reads it"}
    assert score.as_dict()["cost_usd"] == pytest.approx(2.0)


@pytest.mark.rare
def test_who_always_gives_the_first_answer_is_not_trusted(questions: list[MapQuestion]) -> None:
    score = replied(questions, [question.choices[0] for question in questions])
    low, high = score.whole.interval.low, score.whole.interval.high
    assert low < score.whole.chance < high
    assert {tally.verdict for tally in score.kinds.values()} == {"no better than chance"}
    assert score.reads == "no"
    assert score.verdict.startswith("do not trust it")


@pytest.mark.rare
def test_no_answer_is_wrong_and_told_apart(questions: list[MapQuestion]) -> None:
    given = [None if question.number % 4 == 0 else question.answer for question in questions]
    score = replied(questions, given)
    assert (score.whole.right, score.whole.asked, score.whole.unanswered) == (150, 200, 50)
    assert score.failures == {"timeout: no answer within 60 s": 50}
    assert score.kinds["blocked"].verdict == "no answer"
    assert score.verdict.endswith("no better than chance at blocked way and share explored")


@pytest.mark.rare
def test_a_weak_kind_is_named_and_few_questions_tell_nothing(questions: list[MapQuestion]) -> None:
    blind = [q.choices[0] if q.kind == "point" else q.answer for q in questions]
    assert replied(questions, blind).verdict.endswith("no better than chance at what is at a point")
    most = ["none" if q.number // 8 % 4 == 0 else q.answer for q in questions]
    assert replied(questions, most).reads == "in part"
    half = [q.answer if q.kind != "point" or q.number % 16 > 8 else "none" for q in questions]
    assert replied(questions, half).kinds["point"].verdict == "in part"
    few = replied(questions[:8], [question.answer for question in questions[:8]])
    assert few.reads == "unknown"
    assert few.verdict.startswith("too few questions to tell")


# ------------------------------------------------------------------------------------- over the wire


def probe(address: str, *options: str) -> list[str]:
    return ["probe", "--model", address, "--model-name", NAME, "--json", *options]


def choice(answer: str) -> Response:
    return says(json.dumps({"reason": "The map shows it.", "answer": answer}))


def first_choice(request: Request) -> Response:
    return choice(request.schema["properties"]["answer"]["enum"][0])


@pytest.mark.rare
def test_a_server_that_knows_all_has_200_of_200(
    questions: list[MapQuestion],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("dream.evaluation.probe.make_questions", lambda count, own: iter(questions[:count]))
    key = {(question.picture, question.asked.text): question.answer for question in questions}
    record = ["--record", str(tmp_path / "kept")]
    with serving(lambda request: choice(key[request.pictures[0], request.question])) as server:
        assert run_command(probe(server.address, *record)) == 0
        assert len(server.asked) == 200
        assert run_command(probe(server.address, *record)) == 0
        assert len(server.asked) == 200  # What is kept is not asked again.
    first, again = map(json.loads, capsys.readouterr().out.splitlines())
    for summary in (first, again):
        assert (summary["right"], summary["asked"], summary["unanswered"]) == (200, 200, 0)
        assert summary["reads"] == "yes"
        assert summary["tokens_in"] == 20000
        assert set(summary["kinds"]) == set(KINDS)
    assert again["latency_s"] == first["latency_s"]
    replay = ["--replay-replies", str(tmp_path / "kept"), "--questions", "16"]
    assert run_command(probe(server.address, *replay)) == 0
    assert json.loads(capsys.readouterr().out)["right"] == 16


@pytest.mark.rare
def test_garbage_is_no_answer_and_is_told(
    questions: list[MapQuestion],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("dream.evaluation.probe.make_questions", lambda count, own: iter(questions[:count]))
    with serving(says("<b>hm</b>")) as server:
        assert run_command(probe(server.address, "--questions", "24", "--out", str(tmp_path / "out"))) == 1
    printed = capsys.readouterr()
    (told,) = printed.err.splitlines()
    assert told.startswith(f"dream: no answer of scripted at {server.address} counted in 24 questions")
    assert told.endswith("because of invalid: no JSON object, asked twice")
    summary = json.loads(printed.out)
    assert (summary["right"], summary["asked"], summary["unanswered"]) == (0, 24, 24)
    assert sum(summary["no_answer"].values()) == 24
    assert summary["verdict"] == "gave no answer at all"
    kept = json.loads((tmp_path / "out" / "probe.json").read_text())
    assert [reply["given_answer"] for reply in kept["replies"]] == [None] * 24
    page = (tmp_path / "out" / "probe.html").read_text()
    assert page.count("<article") == 24
    assert "<b>hm</b>" not in page
    assert "://" not in page.replace("http://127.0.0.1", "")


@pytest.mark.rare
def test_the_first_answer_is_seen_through_and_the_table_says_so(
    questions: list[MapQuestion], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.probe.make_questions", lambda count, own: iter(questions[:count]))
    with serving(first_choice) as server:
        arguments = [word for word in probe(server.address, "--questions", "80") if word != "--json"]
        assert run_command(arguments) == 0
    printed = capsys.readouterr().out
    assert "verdict: do not trust it with a map" in printed
    assert all(kind.title in printed for kind in KINDS.values())


@pytest.mark.rare
def test_a_server_that_refuses_ends_the_probe_with_one_line_before_the_last_map_is_drawn(
    questions: list[MapQuestion], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    def draw(count: int, own: Own) -> Iterator[MapQuestion]:
        for question in questions[:count]:
            drawn.append(question.number)
            yield question

    monkeypatch.setattr("dream.evaluation.probe.make_questions", draw)
    with serving(error(403)) as server:
        assert run_command(probe(server.address, "--questions", "8", "--at-once", "2")) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "HTTP 403" in printed.err
    assert len(drawn) <= 2


@pytest.mark.rare
def test_nobody_at_the_address_ends_the_probe_with_one_line(
    questions: list[MapQuestion], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.probe.make_questions", lambda count, own: iter(questions[:count]))
    with serving() as server:
        address = server.address
    assert run_command(probe(address, "--questions", "8")) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "connection: nothing answers at 127.0.0.1:" in printed.err


@pytest.mark.rare
def test_questions_that_the_budget_does_not_pay_for_are_not_asked(
    questions: list[MapQuestion], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.probe.make_questions", lambda count, own: iter(questions[:count]))
    with serving(first_choice) as server:
        options = ["--questions", "16", "--max-calls", "5", "--at-once", "1"]
        assert run_command(probe(server.address, *options)) == 1
        assert len(server.asked) == 5
        assert run_command(probe(server.address, "--questions", "16", "--limit", "1e-9")) == 1
        assert len(server.asked) == 5
    budget, late = map(json.loads, capsys.readouterr().out.splitlines())
    assert (budget["asked"], budget["questions"], budget["unanswered"]) == (5, 16, 0)
    assert (late["asked"], late["questions"], late["share"]) == (0, 16, None)


@pytest.mark.parametrize("recorded", [True, False])
def test_an_interrupted_probe_tells_what_was_answered_and_how_to_go_on(
    recorded: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    receive, received = Line.receive, itertools.count(1)

    def interrupted(*arguments: Any) -> Any:
        if next(received) == 6:
            raise KeyboardInterrupt
        return receive(*arguments)

    monkeypatch.setattr(Line, "receive", interrupted)
    record = ["--record", str(tmp_path / "kept")] if recorded else []
    with serving(first_choice) as server:
        options = ["--questions", "8", "--at-once", "1", *record, "--out", str(tmp_path / "out")]
        assert run_command(probe(server.address, *options)) == 1
        printed = capsys.readouterr()
        assert json.loads(printed.out)["asked"] == 5
        if recorded:
            told = f"they are kept in {tmp_path / 'kept'}, and the same command goes on"
        else:
            told = "none are kept. With --record DIR they would be, and the same command would go on"
        assert printed.err == f"dream: interrupted: 5 of 8 questions are answered; {told}\n"
        assert "5 of 8 asked" in (tmp_path / "out" / "probe.html").read_text()
        asked = len(server.asked)
        assert run_command(probe(server.address, *options)) == 0
        # The answer to the sixth came, and was kept, before it could be counted.
        assert len(server.asked) - asked == (2 if recorded else 8)
    assert "of 8 asked" not in (tmp_path / "out" / "probe.html").read_text()
