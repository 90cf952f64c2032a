"""A line to a model during one mission."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from dream.planning.vlm.asking import cassette, provider
from dream.planning.vlm.asking.budget import AskingBudget
from dream.planning.vlm.asking.failures import GONE, INVALID, REJECTED
from dream.planning.vlm.asking.finding import answer_in, lacking
from dream.planning.vlm.asking.names import is_server
from dream.planning.vlm.asking.question import Answer, Question, RawAnswer
from dream.planning.vlm.prompts import Own
from dream.types import UNASKED, Asked, Exchange

if TYPE_CHECKING:
    from dream.planning.vlm.asking.client import Client
    from dream.planning.vlm.asking.options import Asking

logger = logging.getLogger(__name__)

R = TypeVar("R", bound=BaseModel)


@dataclass(slots=True, eq=False)
class Pending(Generic[R]):
    """A question that is being answered."""

    line: Line
    question: Question[R]
    outcome: Future[RawAnswer]
    sent: bool = False
    """A model was asked, not a budget or what was kept."""
    _answer: Answer[R] | None = None

    def done(self) -> bool:
        """Would `answer` return at once?"""
        return self.outcome.done()

    def answer(self) -> Answer[R]:
        """Wait for the answer, no longer than the line's limit."""
        if self._answer is None:
            outcome = self.outcome.result()
            self.line.budget.under_way -= self.sent
            self._answer = self.line.receive(self.question, outcome)
        return self._answer


@dataclass(slots=True, eq=False)
class Line:
    """A line to a model during one mission: it keeps to the limits and counts what was spent.

    It answers every question, with a reply that is valid or with the reason why there is none.
    """

    asking: Asking
    earlier: Asked = UNASKED
    """What earlier legs of the mission spent."""
    prompts: Own = field(default_factory=dict)
    """One's own, by name: as they were when the line was opened."""
    budget: AskingBudget = field(init=False)
    _client: Client | None = field(init=False, default=None)
    """None where kept replies alone answer."""
    _answered: bool = False
    """It answered once, or an earlier leg of the orders went on after its first question."""
    _asked: Counter[str] = field(default_factory=Counter)
    """How often each question was asked."""

    def __post_init__(self) -> None:
        asking = self.asking
        self._answered = self.earlier.calls > 0
        self.budget = AskingBudget(asking.max_calls, asking.max_usd, asking.label, self.earlier)
        if asking.only_replays:
            return
        forms = provider.connect(asking.model, asking.model_name)
        # The libraries that it needs are known to be there by now.
        from dream.planning.vlm.asking.client import Client

        self._client = Client(forms, asking.timeout, asking.temperature, self.budget.count_request)
        # Which price list a known model stands in shows only with its first reply.
        if asking.max_usd is not None and is_server(asking.model) and not self._client.has_price:
            raise ValueError(
                f"max_usd: expected a model whose price is known, got {asking.label}. "
                "Limit it with --max-calls"
            )

    def ask(self, question: Question[R]) -> Pending[R]:
        """Send a question; its answer comes later."""
        known: Future[RawAnswer] = Future()
        if limit := self.budget.exhausted():
            known.set_result(RawAnswer(fallback=limit))
            return Pending(self, question, known)
        self.budget.under_way += 1
        kept, record = self.asking.replay_replies, self.asking.record
        key = self._key(question) if kept is not None or record is not None else ""
        if kept is not None and (record is None or cassette.holds(Path(kept), key)):
            try:
                outcome = cassette.play(Path(kept), key, question.prompt)
            except (OSError, ValueError) as error:
                # Told when the answer is taken: a question that was never answered was not kept.
                known.set_exception(error)
                return Pending(self, question, known, sent=True)
            # Where a model can be asked, that it could not be is no answer.
            if record is None or not outcome.fallback.startswith(GONE):
                known.set_result(outcome)
                self.budget.count_played(outcome.requests)
                return Pending(self, question, known, sent=True)
        assert self._client is not None
        coming = asyncio.run_coroutine_threadsafe(self._converse(question, key), self._client.loop)
        return Pending(self, question, coming, sent=True)

    def _key(self, question: Question[R]) -> str:
        """Under which a question is kept: the same one that is asked again has another."""
        temperature = self.asking.temperature
        warm = "" if temperature is None else f", temperature {temperature:g}"
        same = question.key(self.asking.label + warm)
        self._asked[same] += 1
        return f"{same}-{self._asked[same] - 1}"

    async def _converse(self, question: Question[R], key: str) -> RawAnswer:
        """Ask the model, and keep the exchange where it is to be kept."""
        assert self._client is not None
        if self.asking.record is not None:
            cassette.forget(Path(self.asking.record), key)
        began = time.perf_counter()
        outcome = await self._client.ask(question)
        outcome = outcome.lasting(time.perf_counter() - began)
        if self.asking.record is not None:
            folder = Path(self.asking.record)
            try:
                cassette.keep(folder, key, outcome, question.prompt, question.sent, question.pictures)
            except OSError as error:
                # The answer is paid for and counts all the same.
                cassette.lost[folder] += 1
                if cassette.lost[folder] == 1:
                    told = "%s: this exchange is not kept (%s). Is the disk full? Others are only counted"
                    logger.warning(told, folder, error)
        return outcome

    def receive(self, question: Question[R], outcome: RawAnswer) -> Answer[R]:
        """Check what came, and count it."""
        reply, fallback = None, outcome.fallback
        lacks = tuple(lacking(text, question.reply) for text in outcome.replies)
        if not fallback:
            try:
                reply = question.reply.model_validate_json(answer_in(outcome.replies[-1], question.reply))
                self._answered = True
            except (ValidationError, IndexError):
                fallback = INVALID
        if fallback.startswith(INVALID) and lacks and lacks[-1]:
            fallback = f"{INVALID}: {lacks[-1]}" + (", asked twice" if len(lacks) > 1 else "")
        exchange = Exchange(
            prompt=question.prompt,
            model=self.asking.label,
            question=question.sent,
            pictures=question.pictures,
            replies=outcome.replies,
            fallback=fallback,
            requests=outcome.requests,
            tokens_in=outcome.tokens_in,
            tokens_out=outcome.tokens_out,
            cost_usd=outcome.cost_usd,
            seconds=outcome.seconds,
            answered_by=outcome.answered_by,
            lacks=lacks,
            expected=question.reply.model_json_schema(),
        )
        self.budget.book(exchange)
        return Answer(reply, exchange)

    def insist(self, answer: Answer[R]) -> Answer[R]:
        """The answer, where the model can be asked at all.

        Raises:
            ValueError: It never answered, and denies to, is not there or takes no such question: its address,
                its name, its key or its plan is wrong, or it is no model for this.
        """
        fallback = answer.exchange.fallback
        if not self._answered and fallback.startswith((*GONE, REJECTED)):
            raise self.asking.gone(fallback)
        return answer

    def took(self, exchange: Exchange) -> float:
        """Seconds from a question to its answer, on the mission's clock."""
        latency = self.asking.latency
        return exchange.seconds if latency is None else latency * exchange.requests
