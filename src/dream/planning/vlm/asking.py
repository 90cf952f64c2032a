"""Which model is asked, and how: options, limits, and an open line to it."""

from __future__ import annotations

import asyncio
import contextlib
import difflib
import ipaddress
import json
import logging
import os
import re
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import Future
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, replace
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar, cast
from urllib.parse import urlsplit

from pydantic import BaseModel, ValidationError

from dream import extras
from dream.options import First
from dream.planning.parameters import check_count, check_range
from dream.planning.vlm import cassette
from dream.planning.vlm.cassette import Outcome
from dream.planning.vlm.finding import answer_in, fits, lacking
from dream.planning.vlm.prompts import Own, own_prompts
from dream.planning.vlm.refusals import (
    BOUNDS,
    DENIED,
    LIMITS,
    QUOTA,
    REJECTED,
    ErrorInReplyError,
    NoReplyError,
    other_bound,
    refusal_in,
)
from dream.planning.vlm.server_words import (
    ADDRESS,
    CONTEXT,
    FORMAT,
    MODEL,
    MOST_SAID,
    NO_SUCH_REQUEST,
    TOO_MANY,
    never,
    plain,
    said,
)
from dream.telling import one_line
from dream.types import UNASKED, Asked, Exchange

if TYPE_CHECKING:
    import httpx2
    from openai.types.chat import ChatCompletion
    from pydantic_ai import Agent
    from pydantic_ai.models import Model

logger = logging.getLogger(__name__)

R = TypeVar("R", bound=BaseModel)
P = TypeVar("P")
T = TypeVar("T")
A = ParamSpec("A")

OFFLINE = "DREAM_OFFLINE"
"""Environment variable: while it is set, to ask a model that is not on this machine is an error."""
WIRE = "wire"
"""Name of the stand-in that comes with the package; `wire:FAULT` is one that errs."""
WIRE_TEST = "which shows that the wire works, never what a model can do"
"""What is to be said of everything that was flown with the stand-in."""
MOST_REPLY_BYTES = 1 << 20
"""A longer reply is not read to its end."""
MOST_TOKENS = 1_000_000_000
"""Of a reply or what it answers; a server that counts more is not believed."""
MOST_TRIES = 3
"""Requests for one message, where the server is busy or the connection breaks."""
KEY = "DREAM_API_KEY"
"""Environment variable with the key for a server that is given by its address. No other key is sent there."""
UNREACHED = "connection: nothing answers"
"""How it begins where nobody listens at the model's address."""
WHOLE = "whole"
"""Where a reply is kept as it came, beside its answer."""
CUT, WITHHELD = "length", "content_filter"
"""How the client calls it where a reply broke off, or was withheld."""
INVALID = "invalid"
"""How it begins where no reply fits."""
BUDGET = "budget"
"""How it begins where the limits of this project allow no further call."""
GONE = (DENIED, UNREACHED, QUOTA)
"""How it begins where the next question will have no answer either."""
WHERE_KEPT = ("record", "replay_replies")
"""Options that say where exchanges are kept, on which no answer depends."""
THINKING = 16_384
"""Tokens that a model may think before it answers. Of more than 21 000 in all, Anthropic's client asks to be
streamed."""
BESIDE = 1024
"""Tokens of an answer beside its sentences: names of fields, numbers, braces."""
TOKEN = 2
"""Characters of a sentence that make a token at least, in languages that models know well."""
PASSED_ON = frozenset(
    ("accept", "accept-encoding", "authorization", "connection", "content-length", "content-type", "host")
)
"""Headers that a server given by its address gets, beside the client's own name and version."""
MAKERS = {"gpt": "openai", "o3": "openai", "o4": "openai", "claude": "anthropic", "gemini": "google"}
"""Who makes the models whose names begin so."""
ELSEWHERE = {
    "openai": "OPENAI_BASE_URL",
    "anthropic": "ANTHROPIC_BASE_URL",
    "google": "GOOGLE_GEMINI_BASE_URL",
}
"""Environment variables that their clients take another address from."""
_statuses: ContextVar[list[int]] = ContextVar("statuses")
"""HTTP statuses of the replies to a question; the requests may be sent by tasks below its own."""


@dataclass(frozen=True, slots=True)
class Asking:
    """Options of every planner that asks a model."""

    model: First[str] = ""
    """Which model: `openai:NAME`, `anthropic:NAME`, `google:NAME`, the address of a server that speaks
    OpenAI's interface, such as http://localhost:8000/v1, or `wire`, a stand-in that answers by rules."""
    model_name: First[str] = ""
    """What the server at that address calls the model."""
    timeout: float = 60.0
    """Seconds for an answer, all tries included. Without an answer in time, belief decides that step."""
    max_calls: int | None = None
    # Tries again of a request that a busy server turned away, or that broke off, do not count.
    """Requests at most in a mission. After them belief decides."""
    max_usd: First[float | None] = None
    """US dollars at most in a mission, for models whose price is known. After them belief decides."""
    latency: float | None = 12.0
    """Seconds that a request takes on the clock of a simulated mission; the paper's model takes about 12.
    None counts as long as it really takes, as on a vehicle in the water."""
    temperature: float | None = None
    """How freely the model chooses its words: 0 takes the likeliest each time. Unless given, the model's own
    default; some models take no other."""
    prompts: str | None = None
    """Folder of prompts of your own. A file in it, such as `ranked.md`, takes the place of the package's file
    of that name; the others stay."""
    record: First[str | None] = None
    """Folder in which every question and answer is kept."""
    replay_replies: str | None = None
    """Folder of kept answers: they are used, and no model is asked. With --record of the same folder, a
    question that has no kept answer is asked; so an interrupted mission goes on."""

    def __post_init__(self) -> None:
        for name in ("model", "model_name"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"{name}: expected a name, got {getattr(self, name)}")
        for name in (*WHERE_KEPT, "prompts"):
            if not isinstance(getattr(self, name), str | None):
                raise ValueError(f"{name}: expected a folder, got {getattr(self, name)}")
        if "://" in self.model and set("@?#") & set(self.model):
            raise ValueError(
                "model: expected a plain address, since it is written into results, got one with a user or a "
                f"query. A key belongs into the environment, as {KEY}"
            )
        check_range("timeout", self.timeout, 0.1, 3600.0)
        if self.latency is not None:
            check_range("latency", self.latency, 0.0, 3600.0)
        if self.temperature is not None:
            check_range("temperature", self.temperature, 0.0, 2.0)
        if self.max_calls is not None:
            check_count("max_calls", self.max_calls, 0, 1_000_000)
        if self.max_usd is not None:
            check_range("max_usd", self.max_usd, 0.0, 1e6)

    @property
    def only_replays(self) -> bool:
        """Whether kept replies alone answer, so that no model is asked."""
        return self.replay_replies is not None and self.record is None

    def check_installed(self) -> None:
        """Raise a ValueError where what asks a model is not installed."""
        if not self.only_replays:
            extras.check_installed("vlm", f"--model {self.model}".rstrip(), "pydantic_ai")

    def line(self, asked: Asked = UNASKED) -> Line:
        """An open line to the model, for one mission.

        Args:
            asked: What of its budget is spent already.

        Raises:
            ValueError: There is no such model, its key is not in the environment, asking it is forbidden, its
                price is not known while dollars are limited, there are no kept replies, or one's own prompts
                are none.
            OSError: The folder to keep exchanges in cannot be made.
        """
        if self.record is not None:
            cassette.prepare(Path(self.record))
        if self.replay_replies is not None and not Path(self.replay_replies).is_dir():
            raise ValueError(f"replay_replies: expected a folder of kept replies, got {self.replay_replies}")
        if self.replay_replies is not None and not self.model:
            raise ValueError(
                "model: expected the one whose replies were kept, as they are found by its name, got none. "
                "Say the --model that they were recorded with"
            )
        return Line(self, asked, own_prompts(self.prompts))

    def given_to(self, planner: P) -> P:
        """The planner with these options where it is one that asks; as it is where it is none."""
        if not isinstance(planner, Asking):
            return planner
        return replace(planner, **{option.name: getattr(self, option.name) for option in fields(Asking)})

    @property
    def label(self) -> str:
        """What the model is called in results."""
        # Without a fault behind the colon, it is the stand-in that does not err.
        model = WIRE if self.model == f"{WIRE}:" else self.model
        return f"{self.model_name} at {model}" if self.model_name else model

    def gone(self, fallback: str) -> ValueError:
        """What is to be said where the model cannot be asked, for that reason."""
        said = fallback.rstrip(".… ")
        return ValueError(f"model: expected {self.label} to answer, got {said}. {self._advice(fallback)}")

    def _advice(self, fallback: str) -> str:
        """What to look at."""
        if fallback.startswith(QUOTA):
            return "Is there a plan with something left, or another key?"
        about = never(fallback)
        if fallback.startswith(REJECTED):
            if about == CONTEXT:
                return "Does its context hold the question, its pictures and an answer?"
            return "Does the model take pictures, as many and as large as these?"
        if "://" not in self.model:
            network = fallback.startswith(UNREACHED)
            return "Is there a network?" if network else "Is its name right, and its key in the environment?"
        if fallback.startswith(UNREACHED):
            return "Is the server running, and its address right?"
        if "HTTP 404" not in fallback and about not in (ADDRESS, MODEL):
            return f"Is its name right, and its key in the environment, as {KEY}?"
        if about == MODEL or urlsplit(self.model).path.rstrip("/").endswith("/v1"):
            return "Does the server have a model of that name?"
        return f"Is the address whole? Most end in /v1: {self.model.rstrip('/')}/v1"


@dataclass(frozen=True, slots=True, eq=False)
class Question(Generic[R]):
    """What is asked."""

    prompt: str
    """Name and version of the prompt."""
    instructions: str
    text: str
    pictures: Mapping[str, bytes]
    """PNG files by name, in the order in which they are shown."""
    reply: type[R]
    """What an answer must be."""

    @property
    def sent(self) -> str:
        """All that is sent as text."""
        shown = "".join(f"[{name}]\n" for name in self.pictures)
        return f"{self.instructions}\n\n{shown}\n{self.text}"

    @property
    def most_tokens(self) -> int:
        """Tokens of a reply at most: enough to think, and to fill every field."""
        sentences = re.findall(r'"maxLength": (\d+)', json.dumps(self.reply.model_json_schema()))
        return THINKING + BESIDE + sum(map(int, sentences)) // TOKEN

    def key(self, model: str) -> str:
        """Hash of all that an answer may depend on."""
        schema = self.reply.model_json_schema()
        return cassette.key_of([model, self.instructions, self.text, schema], self.pictures)


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Generic[R]):
    """What came of a question."""

    reply: R | None
    """None where the exchange says why there is none."""
    exchange: Exchange


@dataclass(slots=True, eq=False)
class Pending(Generic[R]):
    """A question that is being answered."""

    line: Line
    question: Question[R]
    outcome: Future[Outcome]
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
            self.line.under_way -= self.sent
            self._answer = self.line.receive(self.question, outcome)
        return self._answer


@dataclass(slots=True, eq=False)
class Line:
    """A line to a model during one mission: it keeps to the limits and counts what was spent.

    It answers every question, with a reply that is valid or with the reason why there is none.
    """

    asking: Asking
    spent: Asked = UNASKED
    prompts: Own = field(default_factory=dict)
    """One's own, by name: as they were when the line was opened."""
    under_way: int = 0
    """Questions whose answer was not received yet; each is at least a call."""
    _forms: tuple[_Form, ...] = ()
    """How a reply can be asked for, the strictest first."""
    _form: int = 0
    """The strictest that the server took."""
    _bound: int = 0
    """Of `BOUNDS`, what the server took."""
    _sent: int = 0
    """Requests, counted before they are sent."""
    _played: int = 0
    """Requests of kept exchanges that answered."""
    _dearest: float = 0.0
    """US dollars that a question cost at most."""
    _answered: bool = False
    """It answered once, or an earlier leg of the orders went on after its first question."""
    _asked: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._answered, self._sent = self.spent.calls > 0, self.spent.calls
        if not self.asking.only_replays:
            model = _connect(self.asking.model, self.asking.model_name)
            given = "://" in self.asking.model or stands_in(self.asking.model)
            self._forms = (_Form(model, schema=False),)
            if model.profile.get("supports_json_schema_output"):
                self._forms = (_Form(model, schema=True), *self._forms)
            if given:
                # Some servers know no limits in schemas, and some take no format at all.
                limited = _connect(self.asking.model, self.asking.model_name, limits=True)
                wordy = _connect(self.asking.model, self.asking.model_name, formats=False)
                self._forms = (
                    _Form(limited, schema=True, limits=True),
                    *self._forms,
                    _Form(wordy, schema=False),
                )
            # Which price list a known model stands in shows only with its first reply.
            if self.asking.max_usd is not None and given and not _has_price(model):
                raise ValueError(
                    f"max_usd: expected a model whose price is known, got {self.asking.label}. "
                    "Limit it with --max-calls"
                )

    def ask(self, question: Question[R]) -> Pending[R]:
        """Send a question; its answer comes later."""
        known: Future[Outcome] = Future()
        if limit := self._exhausted():
            known.set_result(Outcome(fallback=limit))
            return Pending(self, question, known)
        self.under_way += 1
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
                self._played += outcome.requests
                return Pending(self, question, known, sent=True)
        coming = asyncio.run_coroutine_threadsafe(self._converse(question, key), _loop())
        return Pending(self, question, coming, sent=True)

    def _key(self, question: Question[R]) -> str:
        """Under which a question is kept: the same one that is asked again has another."""
        temperature = self.asking.temperature
        warm = "" if temperature is None else f", temperature {temperature:g}"
        same = question.key(self.asking.label + warm)
        self._asked[same] += 1
        return f"{same}-{self._asked[same] - 1}"

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

    def receive(self, question: Question[R], outcome: Outcome) -> Answer[R]:
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
        self.spent += exchange
        self._dearest = max(self._dearest, exchange.cost_usd or 0.0)
        return Answer(reply, exchange)

    def took(self, exchange: Exchange) -> float:
        """Seconds from a question to its answer, on the mission's clock."""
        latency = self.asking.latency
        return exchange.seconds if latency is None else latency * exchange.requests

    def _exhausted(self) -> str:
        """Why nothing more may be spent; empty where it may."""
        asking, spent = self.asking, self.spent
        if asking.max_calls is not None and spent.calls + self.under_way >= asking.max_calls:
            return f"{BUDGET}: all {asking.max_calls} calls are made"
        if asking.max_usd is not None and spent.cost_usd is None:
            return f"unpriced: the price of {asking.label} is not known; limit it with --max-calls"
        if asking.max_usd is not None and spent.cost_usd is not None:
            # Those on their way may cost as much as any did.
            due = spent.cost_usd + self.under_way * self._dearest
            if due >= asking.max_usd:
                return f"{BUDGET}: all {asking.max_usd:g} USD are spent"
        return ""

    # ------------------------------------------------------------------------------------- conversation

    async def _converse(self, question: Question[R], key: str) -> Outcome:
        if self.asking.record is not None:
            cassette.forget(Path(self.asking.record), key)
        began = time.perf_counter()
        outcome = await self._exchange(question)
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

    async def _exchange(self, question: Question[R]) -> Outcome:
        messages: list[Any] = []
        fallback = ""
        _statuses.set([])
        try:
            async with asyncio.timeout(self.asking.timeout):
                await self._in_some_form(question, messages)
        except Exception as error:  # noqa: BLE001 - whatever a server sends, the mission goes on.
            fallback = _reason(error, self.asking.timeout, len(messages))
        return _outcome(messages, fallback)

    async def _in_some_form(self, question: Question[R], messages: list[Any]) -> None:
        """Ask; where the server turns the form away, in a looser one. What was said joins the messages."""
        form, bound = self._form, self._bound
        while True:
            try:
                await self._run(question, messages, self._forms[form], BOUNDS[bound])
            except Exception as error:
                refused = refusal_in(error)
                if refused is None or not refused.lasting:
                    raise
                if bound + 1 < len(BOUNDS) and (renamed := other_bound(refused.words, bound)):
                    bound = renamed
                    continue
                looser = form + 1
                # Without their limits the same schemas may do; else those who take none would be asked twice.
                if self._forms[form].limits and not LIMITS.search(refused.words):
                    looser += 1
                if looser >= len(self._forms) or refused.about not in ("", FORMAT):
                    raise
                form = looser
            else:
                self._form, self._bound = max(self._form, form), max(self._bound, bound)
                return

    async def _run(self, question: Question[R], messages: list[Any], form: _Form, bound: str) -> None:
        from pydantic_ai import BinaryContent, capture_run_messages
        from pydantic_ai.settings import ModelSettings

        parts: list[Any] = []
        for name, png in question.pictures.items():
            parts += [f"[{name}]", BinaryContent(png, media_type="image/png")]
        settings = ModelSettings(max_retries=MOST_TRIES - 1, timeout=self.asking.timeout)
        if bound == BOUNDS[0]:  # The client calls it as known models do.
            settings["max_tokens"] = question.most_tokens
        elif bound:
            settings["extra_body"] = {bound: question.most_tokens}
        if self.asking.temperature is not None:
            settings["temperature"] = self.asking.temperature
        with capture_run_messages() as exchanged:
            try:
                await self._agent(question, form).run([*parts, question.text], model_settings=settings)
            finally:
                messages += exchanged

    def _agent(self, question: Question[R], form: _Form) -> Agent[None, R]:
        from pydantic_ai import Agent, NativeOutput, PromptedOutput

        reply = question.reply
        wanted = NativeOutput(reply, strict=True) if form.schema else PromptedOutput(reply)
        model = _metered(form.model, self._count, reply)
        return Agent(model, output_type=wanted, instructions=question.instructions, retries=1)

    def _count(self) -> None:
        """Count a request that is about to be sent, where one more may be."""
        from pydantic_ai.exceptions import UsageLimitExceeded

        if self.asking.max_calls is not None and self._sent + self._played >= self.asking.max_calls:
            raise UsageLimitExceeded("no call is left")
        self._sent += 1


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """How a reply is asked for."""

    model: Model
    schema: bool
    """By the schema itself, which the server holds the model to; in words where not."""
    limits: bool = False
    """The schema holds the limits on lengths too, which OpenAI's strict ones may not."""


def stands_in(model: str) -> bool:
    """Is it the stand-in? See `WIRE_TEST`."""
    return model.partition(":")[0] == WIRE


def _reason(error: Exception, timeout: float, messages: int) -> str:
    """Why there is no answer. Of what a server wrote only what it finds wrong with a request is in it."""
    import httpx2
    from pydantic_ai import exceptions

    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, _TooLongError):
            return f"too large: {cause}"
        if isinstance(cause, httpx2.ConnectError | httpx2.ConnectTimeout):
            return f"{UNREACHED} at {cause.request.url.netloc.decode()}"
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, TimeoutError | exceptions.ModelTimeoutError):
        if _statuses.get([])[-1:] == [TOO_MANY]:
            return f"rate limit: the server asks to wait, and {timeout:g} s were over first"
        return f"timeout: no answer within {timeout:g} s"
    if isinstance(error, exceptions.UsageLimitExceeded):
        return f"{BUDGET}: no call is left to ask again"
    if isinstance(error, exceptions.ModelQuotaExceededError):
        return f"{QUOTA}: nothing is left to spend there"
    if isinstance(error, exceptions.ModelRateLimitError):
        return "rate limit: the server asks to wait"
    if (refused := refusal_in(error)) is not None:
        return refused.reason
    if isinstance(error, NoReplyError):
        return str(error)
    if isinstance(error, exceptions.ModelConnectionError | OSError):
        return "connection: it broke"
    if isinstance(error, exceptions.ContentFilterError):
        return "refused: the model declined to answer"
    if isinstance(error, exceptions.OutputTokenLimitExceeded):
        return "truncated: the reply broke off"
    # A request, its reply, and the same once more.
    if isinstance(error, exceptions.UnexpectedModelBehavior) and messages >= 4:
        return INVALID
    return "server: what it sent is no reply"


def _outcome(messages: list[Any], fallback: str) -> Outcome:
    from pydantic_ai.messages import ModelRequest, ModelResponse

    responses = [message for message in messages if isinstance(message, ModelResponse)]
    requests = sum(isinstance(message, ModelRequest) for message in messages)
    # The last one was never sent where no call was left for it.
    requests -= fallback.startswith(BUDGET) and requests > len(responses)
    costs = [_cost(response) for response in responses]
    # What was sent and not answered may cost all the same.
    costs += [None] * (requests - len(responses))
    return Outcome(
        replies=tuple(plain(_written(response)) for response in responses),
        fallback=fallback,
        requests=requests,
        tokens_in=sum(response.usage.input_tokens for response in responses),
        tokens_out=sum(response.usage.output_tokens for response in responses),
        cost_usd=None if None in costs else float(sum(cost for cost in costs if cost is not None)),
        answered_by=one_line(plain(responses[-1].model_name or ""))[:MOST_SAID] if responses else "",
    )


def _written(response: Any) -> str:
    """What a model wrote for others to read; where that is nothing, what it thought or called a tool with."""
    from pydantic_ai.messages import ThinkingPart, ToolCallPart

    if response.metadata and isinstance(whole := response.metadata.get(WHOLE), str):
        return whole
    if (text := response.text or "").strip() or response.finish_reason == CUT:
        return str(text)
    thought = [part.content for part in response.parts if isinstance(part, ThinkingPart)]
    called = [part.args for part in response.parts if isinstance(part, ToolCallPart)]
    return "\n".join([*thought, *(args for args in called if isinstance(args, str))]) or str(text)


def _answering(response: Any, reply: type[BaseModel]) -> Any:
    """The reply with its answer alone, so that it is checked, and kept as it came beside it."""
    from pydantic_ai.messages import TextPart

    whole = _written(response)
    answer = answer_in(whole, reply, cut=response.finish_reason == CUT)
    # Without any text the client tells that it is so; else it asks again, which ends in the same way.
    ended = response.finish_reason in (CUT, WITHHELD) and not fits(answer, reply)
    if answer == response.text and not ended:
        return response
    parts = [TextPart(answer)] if answer and not ended else []
    return replace(response, parts=parts, metadata={**(response.metadata or {}), WHOLE: whole})


def _cost(response: Any) -> float | None:
    """US dollars; None where the price of the model is not known."""
    try:
        return float(response.cost().total_price)
    except Exception:  # noqa: BLE001 - a server may say anything of its model and its tokens.
        return None


def _has_price(model: Model) -> bool:
    """Is there a price for what it would answer?"""
    from pydantic_ai.messages import ModelResponse
    from pydantic_ai.usage import RequestUsage

    answer = ModelResponse(
        parts=[],
        usage=RequestUsage(input_tokens=1, output_tokens=1),
        model_name=model.model_name,
        provider_name=model.system,
        provider_url=model.base_url,
    )
    return _cost(answer) is not None


# ------------------------------------------------------------------------------------------- the way there


def _once(make: Callable[A, T]) -> Callable[A, T]:
    """Makes the same thing once, also for threads that come at the same time."""
    lock, made = threading.Lock(), cache(make)

    @wraps(make)
    def one(*args: A.args, **options: A.kwargs) -> T:
        with lock:
            return made(*args, **cast(Any, options))

    return one


@_once
def _loop() -> asyncio.AbstractEventLoop:
    """Where all conversations of this process go on."""
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, name="models", daemon=True).start()
    return loop


class _TooLongError(ValueError):
    """A reply that is not read to its end."""


@_once
def _http(*, address: bool, near: bool) -> httpx2.AsyncClient:
    """The client of this process for known models, or for servers that are given by their address.

    To those nothing is sent that the environment holds for others. Before one on this machine is no proxy.
    """
    import httpx2
    from pydantic_ai.models import get_user_agent

    class Bounded(httpx2.AsyncByteStream):
        def __init__(self, stream: httpx2.AsyncByteStream) -> None:
            self.stream = stream

        async def __aiter__(self) -> AsyncIterator[bytes]:
            length = 0
            async for chunk in self.stream:
                length += len(chunk)
                if length > MOST_REPLY_BYTES:
                    raise _TooLongError(f"a reply of more than {MOST_REPLY_BYTES} bytes")
                yield chunk

        async def aclose(self) -> None:
            await self.stream.aclose()

    async def bound(response: httpx2.Response) -> None:
        if (statuses := _statuses.get(None)) is not None:
            statuses.append(response.status_code)
        if response.headers.get("content-encoding", "identity") != "identity":
            raise _TooLongError("a reply that is packed, of unknown length")
        assert isinstance(response.stream, httpx2.AsyncByteStream)
        response.stream = Bounded(response.stream)
        # The clients try again whatever is said with 500, also what will never be taken.
        if response.status_code >= 500:
            await response.aread()
            body: object = response.text
            with contextlib.suppress(ValueError, RecursionError):
                body = json.loads(response.content)
            if response.status_code in NO_SUCH_REQUEST or never(said(body)):
                response.headers["x-should-retry"] = "false"

    async def only_its_own(request: httpx2.Request) -> None:
        for name in [name for name in request.headers if name.lower() not in PASSED_ON]:
            if not name.lower().startswith(("x-stainless-", "user-agent")):
                del request.headers[name]

    return httpx2.AsyncClient(
        timeout=httpx2.Timeout(600.0, connect=5.0),
        headers={"User-Agent": get_user_agent(), "Accept-Encoding": "identity"},
        event_hooks={"request": [only_its_own] if address else [], "response": [bound]},
        trust_env=not near,
    )


def _metered(model: Model, count: Callable[[], None], reply: type[BaseModel]) -> Model:
    """The model, with every request counted before it is sent, and every reply searched for its answer."""
    from pydantic_ai.models.wrapper import WrapperModel

    class Metered(WrapperModel):
        async def request(self, *arguments: Any, **options: Any) -> Any:
            count()
            return _answering(await super().request(*arguments, **options), reply)

    return Metered(model)


def _connect(model: str, name: str, *, formats: bool = True, limits: bool = False) -> Model:
    """The model, ready to be asked.

    Args:
        model: See `Asking.model`.
        name: See `Asking.model_name`.
        formats: Whether a server that is given by its address may be asked for a format.
        limits: Whether it gets limits on lengths in a schema. Servers that hold a model to a grammar keep to
            them; OpenAI's own refuses some, and so the client makes words of them unless told otherwise.
    """
    try:
        import pydantic_ai
        import pydantic_ai.exceptions
        from pydantic_ai.models import infer_model
        from pydantic_ai.models.openai import OpenAIChatModel
        from pydantic_ai.providers import infer_provider_class
        from pydantic_ai.providers.openai_compatible import OpenAICompatibleProvider
    except ImportError as error:
        raise ValueError(extras.missing("vlm", error.name or "pydantic_ai", "--model")) from error
    # Its advertisement would come in the middle of a mission's progress.
    pydantic_ai.BANNER_ENABLED = False
    if not model:
        raise ValueError(
            "model: expected which model to ask, got none. Say --model openai:NAME, anthropic:NAME, "
            "google:NAME or the address of a server such as http://localhost:8000/v1. Without any model, "
            "--model wire answers by rule"
        )
    if stands_in(model):
        from dream.standin import address

        model, name = address(model.partition(":")[2]), name or WIRE
    if ":" not in model:
        raise ValueError(f"model: expected PROVIDER:NAME, an address or wire, got {model}{_meant(model)}")

    class Lenient(OpenAIChatModel):
        """Takes tokens that no model counts for none that were counted: they must not cost a good answer.

        An error in a reply of status 200, where OpenRouter, LM Studio and others put it, is one.
        """

        def _process_response(self, response: Any, **options: Any) -> Any:
            if error := _error_in(response):
                raise ErrorInReplyError(error)
            if not getattr(response, "choices", None):
                raise NoReplyError("server: what it sent holds no reply")
            return super()._process_response(response, **options)

        def _validate_completion(self, response: ChatCompletion) -> Any:
            if not _counted(response.usage):
                response.usage = None
            return super()._validate_completion(response)

    if "://" in model:
        near = _is_near(model)
        _check_allowed(model, near=near)
        if not name:
            raise ValueError(
                f"model_name: expected what {model} calls the model, got none. Say --model-name NAME"
            )
        server = OpenAICompatibleProvider(
            "server", base_url=model, api_key=_key(), http_client=_http(address=True, near=near)
        )
        profile: Any = {
            "supports_json_schema_output": formats,
            "supports_json_object_output": formats,
            "openai_chat_supports_max_completion_tokens": False,
        }
        if limits:
            profile["json_schema_transformer"] = None
        return Lenient(name, provider=server, profile=profile)
    if name:
        raise ValueError(f"model_name: expected only beside an address, got {name} with {model}")
    _check_allowed(model, near=False)

    def provider(called: str) -> Any:
        maker: Any = infer_provider_class(called)
        return maker(http_client=_http(address=False, near=False))

    # Results would bear the maker's name, and the key would go to whom the address belongs.
    if os.environ.get(elsewhere := ELSEWHERE.get(model.partition(":")[0], "")):
        raise ValueError(
            f"model: expected {model} to be asked at its maker's, got {elsewhere} in the environment, "
            f"which leads elsewhere. Say --model ADDRESS --model-name NAME with the key as {KEY}, or "
            f"unset {elsewhere}"
        )
    try:
        return infer_model(model, provider)
    except ImportError as error:
        raise ValueError(
            f"model: expected one of openai, anthropic, google or a server's address, got {model}, whose "
            "client is not installed"
        ) from error
    except (pydantic_ai.exceptions.UserError, TypeError, ValueError) as error:
        # The client's own advice is for those who write programs with it.
        if key := re.search(r"`(\w+_KEY)` environment variable", str(error)):
            raise ValueError(
                f"model: expected a key in {key[1]}, got none. Say export {key[1]}=..., or try --model wire"
            ) from error
        raise ValueError(
            f"model: expected one that can be asked, got {model}: {error}{_meant(model)}"
        ) from error


def _meant(model: str) -> str:
    """What a name may have meant that is none."""
    provider, _, rest = model.partition(":")
    known = next((maker for start, maker in MAKERS.items() if provider.lower().startswith(start)), None)
    near = difflib.get_close_matches(provider, [WIRE, *dict.fromkeys(MAKERS.values())], n=1)
    guess = ""
    if known and not rest:
        guess = f"{known}:{model}"
    elif re.match(r"\d+(/|$)", rest):
        guess = f"http://{model}"
    elif near:
        guess = near[0] + (f":{rest}" if rest else "")
    return f". Did you mean {guess}?" if guess not in ("", model) else ""


def _error_in(response: Any) -> object:
    """The error in a reply that holds no answer; None where there is none."""
    choices = getattr(response, "choices", None)
    first: Any = choices[0] if isinstance(choices, list) and choices else None
    if getattr(getattr(first, "message", None), "content", None):
        return None
    for place in (response, first):
        if error := getattr(place, "error", None):
            return error
    # An older way of vLLM and others.
    return response.model_dump(warnings=False) if getattr(response, "object", "") == "error" else None


def _counted(usage: Any) -> bool:
    """Are these counts of tokens? Servers send null, words and less than nothing, too."""
    from openai.types import CompletionUsage

    try:
        counts = CompletionUsage.model_validate(usage.model_dump(warnings=False))
    except (AttributeError, ValidationError):
        return False
    parts = [counts.prompt_tokens_details, counts.completion_tokens_details]
    # What a server adds of its own, such as times in nanoseconds, is no count of tokens.
    numbers = [getattr(part, name) for part in (counts, *parts) if part for name in type(part).model_fields]
    return all(0 <= number <= MOST_TOKENS for number in numbers if isinstance(number, int))


def _key() -> str:
    """For a server that is given by its address."""
    key = os.environ.get(KEY, "").strip() or "none"
    if not (key.isascii() and key.isprintable()):
        raise ValueError(f"{KEY}: expected plain characters, got others. Was a whole file put into it?")
    return key


def _is_near(address: str) -> bool:
    """Is the server on this machine?"""
    try:
        host = urlsplit(address).hostname or ""
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _check_allowed(model: str, *, near: bool) -> None:
    if os.environ.get(OFFLINE) and not near:
        raise ValueError(f"model: expected one on this machine while {OFFLINE} is set, got {model}")
