"""What the client's messages hold: text, the answer in it, tokens, a price."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pydantic import BaseModel
from pydantic_ai.messages import (
    ModelMessage,
    ModelRequest,
    ModelResponse,
    TextPart,
    ThinkingPart,
    ToolCallPart,
)
from pydantic_ai.models import Model
from pydantic_ai.usage import RequestUsage

from dream.planning.vlm.asking.failures import BUDGET
from dream.planning.vlm.asking.finding import answer_in, fits
from dream.planning.vlm.asking.question import RawAnswer
from dream.planning.vlm.asking.scrubbing import plain, plain_line
from dream.planning.vlm.asking.server_words import MOST_SAID

WHOLE = "whole"
"""Where a reply is kept as it came, beside its answer."""
CUT, WITHHELD = "length", "content_filter"
"""How the client calls it where a reply broke off, or was withheld."""


def raw_answer(messages: Sequence[ModelMessage], fallback: str) -> RawAnswer:
    """What came of a question.

    Args:
        messages: All that went to the model and came from it.
        fallback: Why there is no answer; empty where there is one.
    """
    responses = [message for message in messages if isinstance(message, ModelResponse)]
    requests = sum(isinstance(message, ModelRequest) for message in messages)
    # The last one was never sent where no call was left for it.
    requests -= fallback.startswith(BUDGET) and requests > len(responses)
    costs = [cost_usd(response) for response in responses]
    # What was sent and not answered may cost all the same.
    costs += [None] * (requests - len(responses))
    return RawAnswer(
        replies=tuple(plain(_written(response)) for response in responses),
        fallback=fallback,
        requests=requests,
        tokens_in=sum(response.usage.input_tokens for response in responses),
        tokens_out=sum(response.usage.output_tokens for response in responses),
        cost_usd=None if None in costs else float(sum(cost for cost in costs if cost is not None)),
        answered_by=plain_line(responses[-1].model_name or "", MOST_SAID) if responses else "",
    )


def with_its_answer(response: ModelResponse, reply: type[BaseModel]) -> ModelResponse:
    """A reply with its answer alone, so that it is checked, and kept as it came beside it.

    Args:
        response: As it came.
        reply: What an answer must be.
    """
    whole = _written(response)
    answer = answer_in(whole, reply, cut=response.finish_reason == CUT)
    # Without any text the client tells that it is so; else it asks again, which ends in the same way.
    ended = response.finish_reason in (CUT, WITHHELD) and not fits(answer, reply)
    if answer == response.text and not ended:
        return response
    parts = [TextPart(answer)] if answer and not ended else []
    return replace(response, parts=parts, metadata={**(response.metadata or {}), WHOLE: whole})


def cost_usd(response: ModelResponse) -> float | None:
    """US dollars; None where the price of the model is not known."""
    try:
        return float(response.cost().total_price)
    except Exception:  # noqa: BLE001 - a server may say anything of its model and its tokens.
        return None


def has_price(model: Model) -> bool:
    """Is there a price for what it would answer?"""
    answer = ModelResponse(
        parts=[],
        usage=RequestUsage(input_tokens=1, output_tokens=1),
        model_name=model.model_name,
        provider_name=model.system,
        provider_url=model.base_url,
    )
    return cost_usd(answer) is not None


def _written(response: ModelResponse) -> str:
    """What a model wrote for others to read; where that is nothing, what it thought or called a tool with."""
    if response.metadata and isinstance(whole := response.metadata.get(WHOLE), str):
        return whole
    if (text := response.text or "").strip() or response.finish_reason == CUT:
        return str(text)
    thought = [part.content for part in response.parts if isinstance(part, ThinkingPart)]
    called = [part.args for part in response.parts if isinstance(part, ToolCallPart)]
    return "\n".join([*thought, *(args for args in called if isinstance(args, str))]) or str(text)
