"""Which model is asked, and how: options, limits, and an open line to it."""

from __future__ import annotations

import asyncio
import difflib
import ipaddress
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

from dream.planning.parameters import check_count, check_range
from dream.planning.vlm import cassette
from dream.planning.vlm.cassette import Outcome
from dream.planning.vlm.prompts import Own, own_prompts
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
LEAST_KEY = 8
"""Characters of a key that is looked for in what a model writes."""
DENIED = "denied"
"""How the reason begins where a model cannot be asked at all."""
UNREACHED = "connection: nothing answers"
"""How it begins where nobody listens at the model's address."""
QUOTA = "quota"
"""How it begins where nothing is left to spend."""
REJECTED = "rejected"
"""How it begins where the server takes no such request."""
BUDGET = "budget"
"""How it begins where the limits of this project allow no further call."""
GONE = (DENIED, UNREACHED, QUOTA)
"""How it begins where the next question will have no answer either."""
WHERE_KEPT = ("record", "replay_replies")
"""Options that say where exchanges are kept, on which no answer depends."""
NO_SUCH_REQUEST = (400, 413, 422)
"""HTTP statuses of a request that the server does not take, whoever sends it and whenever."""
TOO_MANY = 429
"""HTTP status of a request that comes too soon; the client waits as long as it is told, and asks again."""
LONG_WORD = 16
"""Characters of a word with digits in it that may be part of a key."""
MOST_SAID = 200
"""Characters of what a server says is wrong with a request."""
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
EXTRA = 'needs pydantic-ai: pip install "dream-auv[vlm]"'


@dataclass(frozen=True, slots=True)
class Asking:
    """Options of every planner that asks a model."""

    model: str = ""
    """Which model: `openai:NAME`, `anthropic:NAME`, `google:NAME`, `wire`, which answers by rule, or the
    address of a server that speaks OpenAI's interface, such as http://localhost:8000/v1."""
    model_name: str = ""
    """What the server at that address calls the model; said with an address, and with nothing else."""
    timeout: float = 60.0
    """Seconds for an answer, all tries included; then the offline planner decides that step."""
    max_calls: int | None = None
    # Tries again of a request that a busy server turned away, or that broke off, do not count.
    """Requests at most in a mission; then the offline planner decides."""
    max_usd: float | None = None
    """US dollars at most in a mission, likewise; for models whose price is known."""
    latency: float | None = 12.0
    """Seconds that a request takes on the clock of a simulated mission; the paper's model took about 12. None
    is as long as it really takes, as on a vehicle in the water."""
    temperature: float | None = None
    """Of the model's choice of words: 0 is the likeliest each time. None leaves it to the model; some take no
    other."""
    prompts: str | None = None
    """Folder of your own prompts: a `ranked.md` in it, say, takes the place of the package's; what is not in
    it stays as it is. docs/prompts.md shows them all."""
    record: str | None = None
    """Folder in which to keep every exchange; one kept there of the same question is replaced."""
    replay_replies: str | None = None
    """Folder of kept exchanges to answer from: no model is asked. With --record, also of the same folder,
    a question that is not kept there is asked, and kept: so an interrupted mission goes on."""

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
        return f"{self.model_name} at {self.model}" if self.model_name else self.model

    def gone(self, fallback: str) -> ValueError:
        """What is to be said where the model cannot be asked, for that reason."""
        return ValueError(f"model: expected {self.label} to answer, got {fallback}. {self._advice(fallback)}")

    def _advice(self, fallback: str) -> str:
        """What to look at."""
        if fallback.startswith(QUOTA):
            return "Is there a plan with something left, or another key?"
        if fallback.startswith(REJECTED):
            return "Does the model take pictures, as many and as large as these?"
        if "://" not in self.model:
            network = fallback.startswith(UNREACHED)
            return "Is there a network?" if network else "Is its name right, and its key in the environment?"
        if fallback.startswith(UNREACHED):
            return "Is the server running, and its address right?"
        if not fallback.endswith("404"):
            return f"Is its name right, and its key in the environment, as {KEY}?"
        if urlsplit(self.model).path.rstrip("/").endswith("/v1"):
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
        if self.asking.replay_replies is None or self.asking.record is not None:
            model = _connect(self.asking.model, self.asking.model_name)
            given = "://" in self.asking.model or stands_in(self.asking.model)
            self._forms = (_Form(model, schema=False),)
            if model.profile.get("supports_json_schema_output"):
                self._forms = (_Form(model, schema=True), *self._forms)
            if given:
                # Some servers take no format at all.
                plain = _connect(self.asking.model, self.asking.model_name, formats=False)
                self._forms += (_Form(plain, schema=False),)
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
        if not fallback:
            try:
                reply = question.reply.model_validate_json(_unfenced(outcome.replies[-1]))
                self._answered = True
            except ValidationError as error:
                fallback = f"invalid: {_first(error)}"
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
        from pydantic_ai.exceptions import ModelHTTPError

        for form in range(self._form, len(self._forms)):
            try:
                await self._run(question, messages, self._forms[form])
            except ModelHTTPError as error:
                if error.status_code not in NO_SUCH_REQUEST or form + 1 == len(self._forms):
                    raise
            else:
                self._form = max(self._form, form)
                return

    async def _run(self, question: Question[R], messages: list[Any], form: _Form) -> None:
        from pydantic_ai import BinaryContent, capture_run_messages
        from pydantic_ai.settings import ModelSettings

        parts: list[Any] = []
        for name, png in question.pictures.items():
            parts += [f"[{name}]", BinaryContent(png, media_type="image/png")]
        settings = ModelSettings(max_retries=MOST_TRIES - 1, timeout=self.asking.timeout)
        if self.asking.temperature is not None:
            settings["temperature"] = self.asking.temperature
        with capture_run_messages() as said:
            try:
                await self._agent(question, form).run([*parts, question.text], model_settings=settings)
            finally:
                messages += said

    def _agent(self, question: Question[R], form: _Form) -> Agent[None, R]:
        from pydantic_ai import Agent, NativeOutput, PromptedOutput

        reply = question.reply
        wanted = NativeOutput(reply, strict=True) if form.schema else PromptedOutput(reply)
        model = _metered(form.model, self._count)
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


def stands_in(model: str) -> bool:
    """Is it the stand-in? See `WIRE_TEST`."""
    return model.partition(":")[0] == WIRE


def _unfenced(text: str) -> str:
    """A reply without the fence that some models put around JSON, and the words that they put around that."""
    if text.lstrip().startswith("{"):
        return text
    fenced = re.search(r"```\w*\s*(\{.*?\})\s*(?:```|\Z)", text, re.DOTALL)
    return fenced[1] if fenced else text


def _first(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'the whole'}: {first['msg']}"


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
    if isinstance(error, exceptions.ModelHTTPError):
        if error.status_code in NO_SUCH_REQUEST:
            return f"{REJECTED}: HTTP {error.status_code}{_said(error.body)}"
        kind = DENIED if error.status_code in (401, 403, 404) else "server"
        return f"{kind}: HTTP {error.status_code}"
    if isinstance(error, exceptions.ModelConnectionError | OSError):
        return "connection: it broke"
    if isinstance(error, exceptions.ContentFilterError):
        return "refused: the model declined to answer"
    if isinstance(error, exceptions.OutputTokenLimitExceeded):
        return "truncated: the reply broke off"
    # A request, its reply, and the same once more.
    if isinstance(error, exceptions.UnexpectedModelBehavior) and messages >= 4:
        return "invalid: no reply that fits, asked twice"
    return "server: what it sent is no reply"


def _said(body: object) -> str:
    """What a server says is wrong with a request: one short line, without what may be part of a key."""
    told = body
    for name in ("error", "message", "detail"):
        if isinstance(told, Mapping) and told.get(name):
            told = told[name]
    if not isinstance(told, str):
        return ""
    words = _one_line(told).split()
    line = " ".join("..." if len(word) >= LONG_WORD and re.search(r"\d", word) else word for word in words)
    return f": {line[:MOST_SAID]}" if line else ""


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
        replies=tuple(_plain(response.text or "") for response in responses),
        fallback=fallback,
        requests=requests,
        tokens_in=sum(response.usage.input_tokens for response in responses),
        tokens_out=sum(response.usage.output_tokens for response in responses),
        cost_usd=None if None in costs else float(sum(cost for cost in costs if cost is not None)),
        answered_by=_one_line(responses[-1].model_name or "")[:MOST_SAID] if responses else "",
    )


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


def _plain(text: str) -> str:
    """What a model wrote, without keys, and without halves of surrogate pairs, which no file could hold."""
    for name, value in os.environ.items():
        if name.endswith("_KEY") and len(value.strip()) >= LEAST_KEY:
            text = _spelt(value.strip()).sub("[key]", text)
    return text.encode(errors="replace").decode()


def _one_line(text: str) -> str:
    """The same without what cannot be printed."""
    return "".join(c if c.isprintable() else " " for c in _plain(text))


@cache
def _spelt(key: str) -> re.Pattern[str]:
    """A key in all the ways in which JSON may spell it."""
    ways = (rf"(?:\\?{re.escape(c)}|\\u(?i:{ord(c):04x}))" for c in key)
    return re.compile("".join(ways))


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


def _metered(model: Model, count: Callable[[], None]) -> Model:
    """The model, with every request counted before it is sent."""
    from pydantic_ai.models.wrapper import WrapperModel

    class Metered(WrapperModel):
        async def request(self, *arguments: Any, **options: Any) -> Any:
            count()
            return await super().request(*arguments, **options)

    return Metered(model)


def _connect(model: str, name: str, *, formats: bool = True) -> Model:
    """The model, ready to be asked.

    Args:
        model: See `Asking.model`.
        name: See `Asking.model_name`.
        formats: Whether a server that is given by its address may be asked for a format.
    """
    try:
        import pydantic_ai
        import pydantic_ai.exceptions
        from pydantic_ai.models import infer_model
        from pydantic_ai.models.openai import OpenAIChatModel
        from pydantic_ai.providers import infer_provider_class
        from pydantic_ai.providers.openai_compatible import OpenAICompatibleProvider
    except ImportError as error:
        raise ValueError(f"a planner that asks a model {EXTRA}") from error
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
        """Takes tokens that no model counts for none that were counted: they must not cost a good answer."""

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
        profile: Any = {"supports_json_schema_output": formats, "supports_json_object_output": formats}
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
