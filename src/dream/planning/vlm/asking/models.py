"""The client's models, of makers and of servers that speak OpenAI's interface, in each form of a request."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pydantic_ai.exceptions
from openai.types import CompletionUsage
from openai.types.chat import ChatCompletion
from pydantic import BaseModel, ValidationError
from pydantic_ai.models import Model, infer_model
from pydantic_ai.models.openai import OpenAIChatModel
from pydantic_ai.models.wrapper import WrapperModel
from pydantic_ai.providers import infer_provider_class
from pydantic_ai.providers.openai_compatible import OpenAICompatibleProvider

from dream.planning.vlm.asking.names import meant
from dream.planning.vlm.asking.refusals import ErrorInReplyError, NoReplyError
from dream.planning.vlm.asking.responses import with_its_answer
from dream.planning.vlm.asking.transport import http_client

MOST_TOKENS = 1_000_000_000
"""Of a reply or what it answers; a server that counts more is not believed."""


@dataclass(frozen=True, slots=True, eq=False)
class RequestForm:
    """How a reply is asked for."""

    model: Model
    schema: bool
    """By the schema itself, which the server holds the model to; in words where not."""
    limits: bool = False
    """The schema holds the limits on lengths too, which OpenAI's strict ones may not."""


def forms_of_maker(model: str) -> tuple[RequestForm, ...]:
    """How a maker's model can be asked, the strictest form first.

    Args:
        model: PROVIDER:NAME.

    Raises:
        ValueError: There is no such provider, its client is not installed, or its key is not in the
            environment.
    """

    def provider(called: str) -> Any:
        maker: Any = infer_provider_class(called)
        return maker(http_client=http_client(address=False, near=False))

    try:
        known = infer_model(model, provider)
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
            f"model: expected one that can be asked, got {model}: {error}{meant(model)}"
        ) from error
    in_words = RequestForm(known, schema=False)
    if known.profile.get("supports_json_schema_output"):
        return (RequestForm(known, schema=True), in_words)
    return (in_words,)


def forms_at_address(address: str, name: str, key: str, *, near: bool) -> tuple[RequestForm, ...]:
    """How a server's model can be asked, the strictest form first.

    Args:
        address: Of the server.
        name: What it calls the model.
        key: What it is sent as a key.
        near: Whether it is on this machine.
    """

    def model(*, formats: bool = True, **profile: Any) -> Model:
        server = OpenAICompatibleProvider(
            "server", base_url=address, api_key=key, http_client=http_client(address=True, near=near)
        )
        known: Any = {
            "supports_json_schema_output": formats,
            "supports_json_object_output": formats,
            "openai_chat_supports_max_completion_tokens": False,
            **profile,
        }
        return ServerModel(name, provider=server, profile=known)

    # Some servers know no limits in schemas, and some take no format at all. Those that hold a model to a
    # grammar keep to the limits; OpenAI's own refuses some, and so the client makes words of them unless
    # told otherwise.
    known = model()
    return (
        RequestForm(model(json_schema_transformer=None), schema=True, limits=True),
        RequestForm(known, schema=True),
        RequestForm(known, schema=False),
        RequestForm(model(formats=False), schema=False),
    )


class ServerModel(OpenAIChatModel):
    """A model at an address. An error in a reply of status 200, as OpenRouter and LM Studio send it, is one.

    Tokens that no model counts are taken for none that were counted: they must not cost a good answer.
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


class MeteredModel(WrapperModel):
    """A model with every request counted before it is sent, and every reply searched for its answer."""

    def __init__(self, model: Model, count: Callable[[], None], reply: type[BaseModel]) -> None:
        """Meter a model.

        Args:
            model: What is asked.
            count: Called before each request; it raises where no more may be sent.
            reply: What an answer must be.
        """
        super().__init__(model)
        self._count = count
        self._reply = reply

    async def request(self, *arguments: Any, **options: Any) -> Any:
        """See `Model.request`."""
        self._count()
        return with_its_answer(await super().request(*arguments, **options), self._reply)


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
    try:
        counts = CompletionUsage.model_validate(usage.model_dump(warnings=False))
    except (AttributeError, ValidationError):
        return False
    parts = [counts.prompt_tokens_details, counts.completion_tokens_details]
    # What a server adds of its own, such as times in nanoseconds, is no count of tokens.
    numbers = [getattr(part, name) for part in (counts, *parts) if part for name in type(part).model_fields]
    return all(0 <= number <= MOST_TOKENS for number in numbers if isinstance(number, int))
