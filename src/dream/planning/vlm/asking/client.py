"""The client: it asks one question after another, in the strictest form that the server takes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel
from pydantic_ai import Agent, BinaryContent, NativeOutput, PromptedOutput, capture_run_messages
from pydantic_ai.settings import ModelSettings

from dream.planning.vlm.asking import responses, transport
from dream.planning.vlm.asking.failures import reason
from dream.planning.vlm.asking.models import MeteredModel, RequestForm
from dream.planning.vlm.asking.question import Question, RawAnswer
from dream.planning.vlm.asking.refusals import BOUNDS, LIMITS, other_bound, refusal_in
from dream.planning.vlm.asking.server_words import FORMAT

R = TypeVar("R", bound=BaseModel)

MOST_TRIES = 3
"""Requests for one message, where the server is busy or the connection breaks."""


@dataclass(slots=True, eq=False)
class Client:
    """Asks a model, and remembers in which form its server takes a request."""

    forms: tuple[RequestForm, ...]
    """How a reply can be asked for, the strictest first."""
    timeout: float
    """Seconds for an answer, all tries included."""
    temperature: float | None
    """None is the model's own."""
    count: Callable[[], None]
    """Called before each request; it raises where no more may be sent."""
    _form: int = 0
    """The strictest of the forms that the server took."""
    _bound: int = 0
    """Of `BOUNDS`, what the server took."""

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """Where it has to be asked."""
        return transport.loop()

    @property
    def has_price(self) -> bool:
        """Is the model's price known before it answers?"""
        return responses.has_price(self.forms[0].model)

    async def ask(self, question: Question[R]) -> RawAnswer:
        """What came of a question, whatever goes wrong."""
        messages: list[Any] = []
        fallback = ""
        statuses: list[int] = []
        transport.statuses.set(statuses)
        try:
            async with asyncio.timeout(self.timeout):
                await self._in_some_form(question, messages)
        except Exception as error:  # noqa: BLE001 - whatever a server sends, the mission goes on.
            fallback = reason(error, self.timeout, statuses, len(messages))
        return responses.raw_answer(messages, fallback)

    async def _in_some_form(self, question: Question[R], messages: list[Any]) -> None:
        """Ask; where the server turns the form away, in a looser one. What was said joins the messages."""
        form, bound = self._form, self._bound
        while True:
            try:
                await self._run(question, messages, self.forms[form], BOUNDS[bound])
            except Exception as error:
                refused = refusal_in(error)
                if refused is None or not refused.lasting:
                    raise
                if bound + 1 < len(BOUNDS) and (renamed := other_bound(refused.words, bound)):
                    bound = renamed
                    continue
                looser = form + 1
                # Without their limits the same schemas may do; else those who take none would be asked twice.
                if self.forms[form].limits and not LIMITS.search(refused.words):
                    looser += 1
                if looser >= len(self.forms) or refused.about not in ("", FORMAT):
                    raise
                form = looser
            else:
                self._form, self._bound = max(self._form, form), max(self._bound, bound)
                return

    async def _run(self, question: Question[R], messages: list[Any], form: RequestForm, bound: str) -> None:
        parts: list[Any] = []
        for name, png in question.pictures.items():
            parts += [f"[{name}]", BinaryContent(png, media_type="image/png")]
        settings = ModelSettings(max_retries=MOST_TRIES - 1, timeout=self.timeout)
        if bound == BOUNDS[0]:  # The client calls it as known models do.
            settings["max_tokens"] = question.most_tokens
        elif bound:
            settings["extra_body"] = {bound: question.most_tokens}
        if self.temperature is not None:
            settings["temperature"] = self.temperature
        with capture_run_messages() as exchanged:
            try:
                await self._agent(question, form).run([*parts, question.text], model_settings=settings)
            finally:
                messages += exchanged

    def _agent(self, question: Question[R], form: RequestForm) -> Agent[None, R]:
        reply = question.reply
        wanted = NativeOutput(reply, strict=True) if form.schema else PromptedOutput(reply)
        model = MeteredModel(form.model, self.count, reply)
        return Agent(model, output_type=wanted, instructions=question.instructions, retries=1)
