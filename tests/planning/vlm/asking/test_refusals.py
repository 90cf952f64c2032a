"""What a server sends instead of an answer is tried again only where it may pass."""

from __future__ import annotations

import pytest

from tests.model_server import SECRET, error, serving
from tests.planning.vlm.asking.counting import BLIND, GOOD, ask, line

NEVER = {
    "llama.cpp": (500, BLIND, "rejected", "Does the model take pictures"),
    "Ollama": (500, "this model is missing data required for image input", "rejected", "take pictures"),
    "a router": (503, "No endpoints found: vision is not supported by this model", "rejected", "pictures"),
    "switched off": (500, "Image input is disabled", "rejected", "take pictures"),
    "not switched on": (500, "vision was not enabled when this server started", "rejected", "take pictures"),
    "a part": (500, "unsupported content[].type", "rejected", "take pictures"),
    "a count": (500, "At most 0 image(s) may be provided in one prompt", "rejected", "take pictures"),
    "not yet": (500, "Multimodal input is not supported yet", "rejected", "take pictures"),
    "a context": (
        500,
        "the request exceeds the available context size (4096)",
        "rejected",
        "Does its context",
    ),
    "a prompt": (502, "prompt is too long", "rejected", "Does its context hold"),
    "a model": (
        500,
        "model 'scripted' not found, try pulling it first",
        "denied",
        "have a model of that name",
    ),
}


@pytest.mark.parametrize(("status", "words", "kind", "advice"), NEVER.values(), ids=NEVER)
def test_what_will_never_be_taken_ends_at_the_first_answer_whatever_its_status(
    status: int, words: str, kind: str, advice: str
) -> None:
    with serving(error(status, words)) as server:
        on = line(server)
        answer = ask(on)
        tried = len(server.asked)
        assert answer.exchange.fallback.startswith(f"{kind}: HTTP {status}: {words}")
        assert SECRET not in answer.exchange.fallback
        with pytest.raises(ValueError, match=advice):
            on.insist(answer)
    # What a context has no room for may be the bound on the reply alone.
    assert tried == (2 if "context" in advice else 1)


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (500, "Something went wrong"),
        (503, "Loading model"),
        (500, "The image could not be decoded in time, try again: the vision encoder is not available"),
        (502, "<html>model not found: no images</html>"),
        (529, "The model is overloaded"),
        (503, "Vision is currently not available for this model"),
        (500, "CUDA error: unable to allocate buffer for image embedding"),
        (500, "vision encoder crashed (cannot allocate memory)"),
        (500, "image could not be fetched, cannot connect"),
        (500, "image slice failed: not found in cache"),
        (500, "context size exceeded while other requests are running"),
        (503, "no model loaded yet"),
        (500, "cannot process image: unknown error"),
        (500, "failed to encode the picture, unable to go on"),
        (502, "vision worker not found"),
        (500, "image decoder: too many open files"),
        (500, "a tensor of the multimodal projector is missing"),
        (500, "the model does not exist: the connection to the store was reset"),
    ],
)
def test_what_may_pass_is_tried_again(status: int, words: str) -> None:
    with serving(error(status, words, retry_after_ms="1"), GOOD) as server:
        assert ask(line(server)).reply is not None
        first, second = server.asked
    assert first.body == second.body
