"""`dream probe`: can this model read our map?"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from dream.commands.console import (
    check_writable,
    print_json,
    tell_lost,
    told_without_answer,
)
from dream.commands.progress import with_progress
from dream.errors import MissionAborted
from dream.options import First
from dream.planning.vlm.asking import Asking
from dream.telling import rich_console

if TYPE_CHECKING:
    from dream.evaluation.probe import MapQuestion, Reply, Score
    from dream.planning.vlm.asking import Answer, Line, Pending
    from dream.planning.vlm.reply import ChosenAnswer


@dataclass(frozen=True, slots=True)
class Questioned(Asking):
    """Options of the model that is asked."""

    timeout: float = 60.0
    """Seconds for an answer, all tries included. A question without an answer counts as answered wrong."""
    max_calls: First[int | None] = None
    """Requests at most. After them no question is asked."""
    max_usd: First[float | None] = None
    """US dollars at most, for models whose price is known. After them no question is asked."""
    latency: tyro.conf.Suppress[tyro.conf.Fixed[float | None]] = None
    """Nothing waits for an answer here."""
    record: First[str | None] = None
    """Folder that keeps every question and answer. A question that was answered there is not asked again."""


@dataclass(frozen=True, slots=True)
class Probe:
    """Ask a vision-language model questions about maps whose answers are known. Can it read a map?

    There are eight kinds of multiple-choice questions about maps, drawn as the planners draw them: which mark
    is the nearest, what is unexplored, where a target region is open, what blocks the way, where the robot
    heads and more. Of each kind the share of right answers is told, with its 95 % interval. A kind whose
    interval reaches down to chance is not read. The map is read where every kind is better than chance and
    the interval of all questions lies above 80 %. A missing answer is a wrong one, and is counted apart too.

    With `--record`, an interrupted probe goes on: what is kept there is not asked again.

    Examples:
        dream probe --model wire --questions 80
        dream probe --model openai:NAME --record replies --out probe
    """

    asking: Questioned = field(default_factory=Questioned)
    """Which model is asked, and how."""
    questions: First[int] = 200
    """How many questions. Fewer than 80, ten of each kind, tell nothing."""
    at_once: int = 8
    """Questions that wait for an answer at a time."""
    limit: float = 1800.0
    """Seconds after which no question is asked."""
    out: First[Path | None] = None
    """Folder for a page with every question and answer, and for the same as JSON."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0 where all questions were asked and an answer counted, whatever it was; else 1.

        A MissionAborted where it was interrupted.
        """
        from dream.evaluation.probe import QUESTIONS, Score, make_questions, write_page

        if not 1 <= self.questions <= QUESTIONS:
            raise ValueError(f"--questions: expected 1 to {QUESTIONS}, got {self.questions}")
        if not 1 <= self.at_once <= 64:
            raise ValueError(f"--at-once: expected 1 to 64, got {self.at_once}")
        if not 0.0 < self.limit <= 1e6:
            raise ValueError(f"--limit: expected above 0 to 1000000 seconds, got {self.limit:g}")
        line = self.asking.line()
        if self.out is not None:
            check_writable(self.out)
        questions = make_questions(self.questions, line.prompts)
        first = next(questions)
        began = time.perf_counter()
        replies: list[Reply] = []
        interrupted = False
        try:
            replies.extend(
                with_progress(
                    self._ask(line, chain([first], questions)),
                    f"asking {self.asking.label}",
                    self.questions,
                    "questions",
                )
            )
        except KeyboardInterrupt:
            interrupted = True  # What was answered until then is told all the same.
        tell_lost(self.asking.record)
        score = Score(tuple(sorted(replies, key=lambda reply: reply.question.number)), self.questions)
        summary = {
            "model": self.asking.label,
            "prompt": first.prompt,
            **score.as_dict(),
            "wall_s": round(time.perf_counter() - began, 3),
        }
        page = None if self.out is None else write_page(self.out, score, summary)
        if self.json:
            print_json(summary)
        else:
            _print(score, summary, page)
            if score.failures and self.asking.record is not None:
                print("  the same command asks those without an answer again")
        if interrupted:
            answered = sum(reply.given is not None for reply in replies)
            kept = self.asking.record
            raise MissionAborted(
                f"interrupted: {answered} of {self.questions} questions are answered; "
                + (f"they are kept in {kept}, and the same command goes on" if kept else "none are kept")
                + ("" if kept else ". With --record DIR they would be, and the same command would go on")
            )
        if score.complete and score.silent:
            return told_without_answer(
                f"no answer of {self.asking.label} counted in {score.whole.asked} questions, so that nothing "
                f"here shows how it reads the map. Most had none because of {next(iter(score.failures))}"
            )
        return 0 if score.complete else 1

    def _ask(self, line: Line, questions: Iterator[MapQuestion]) -> Iterator[Reply]:
        """Replies as they come, some questions at a time.

        A map is drawn when its question is due: what refuses the first tells so before the last is drawn.
        """
        kept = _kept(self.asking)
        ends = time.monotonic() + self.limit
        waiting: dict[int, tuple[MapQuestion, Pending[ChosenAnswer]]] = {}
        while True:
            # What a question costs shows with the first.
            unpriced = self.asking.max_usd is not None and line.budget.spent.calls == 0
            room = len(waiting) < (1 if unpriced else self.at_once) and time.monotonic() < ends
            question = next(questions, None) if room else None
            if question is not None:
                answer = None if kept is None else _answer_of(kept, question)
                if answer is None:
                    waiting[question.number] = (question, line.ask(question.asked))
                else:
                    yield _reply(question, answer)
            elif waiting:
                wait([pending.outcome for _, pending in waiting.values()], return_when=FIRST_COMPLETED)
            else:
                return
            for number in [number for number, (_, pending) in waiting.items() if pending.done()]:
                asked, pending = waiting.pop(number)
                yield _reply(asked, line.insist(pending.answer()))


def _kept(asking: Asking) -> Line | None:
    """A line that answers from what was recorded before; None where nothing is."""
    if asking.record is None or asking.replay_replies is not None:
        return None
    return replace(asking, record=None, replay_replies=asking.record).line()


def _answer_of(kept: Line, question: MapQuestion) -> Answer[ChosenAnswer] | None:
    """The answer that was kept; None where the question was not asked, or not answered."""
    try:
        answer = kept.ask(question.asked).answer()
    except FileNotFoundError:
        return None
    return None if answer.reply is None else answer


def _reply(question: MapQuestion, answer: Answer[ChosenAnswer]) -> Reply:
    from dream.evaluation.probe import Reply

    given, reason = (None, "") if answer.reply is None else (answer.reply.answer, answer.reply.reason)
    return Reply(question, given, reason, answer.exchange)


def _print(score: Score, summary: Mapping[str, Any], page: Path | None) -> None:
    from rich.table import Table

    from dream.evaluation.probe import KINDS

    table = Table(title=f"{summary['model']}: {score.whole.right} of {score.whole.asked} right")
    for heading in ("kind", "right", "95 % interval", "chance", "no answer", "verdict"):
        table.add_column(heading, justify="left" if heading in ("kind", "verdict") else "right")
    rows = {KINDS[kind].title: (tally, tally.verdict) for kind, tally in score.kinds.items()}
    for title, (tally, verdict) in (rows | {"all": (score.whole, "")}).items():
        interval = tally.interval
        table.add_row(
            title,
            f"{tally.right}/{tally.asked}",
            f"{interval.low:.0%} to {interval.high:.0%}" if tally.asked else "–",
            f"{tally.chance:.0%}" if tally.asked else "–",
            str(tally.unanswered) if tally.unanswered else "",
            verdict,
            end_section=title == list(rows)[-1],
        )
    rich_console(width=None if sys.stdout.isatty() else 120).print(table)
    print(f"verdict: {score.verdict}")
    if missing := score.questions - score.whole.asked:
        print(f"  {missing} of {score.questions} questions were not asked")
    for why, count in score.failures.items():
        print(f"  {count} without an answer: {why}")
    print(f"  {score.spent}")
    if page is not None:
        print(f"  page: {page}")
