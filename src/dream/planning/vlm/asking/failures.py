"""How it is told that there is no answer: the kinds, the reason in a line, and what to look at."""

from __future__ import annotations

from urllib.parse import urlsplit

from dream.planning.vlm.asking.refusals import (
    TOO_MANY,
    NoReplyError,
    Refusal,
    TooLongError,
    refusal_in,
)
from dream.planning.vlm.asking.scrubbing import KEY
from dream.planning.vlm.asking.server_words import ADDRESS, CONTEXT, MODEL, never

DENIED = "denied"
"""How the reason begins where a model cannot be asked at all."""
UNREACHED = "connection: nothing answers"
"""How it begins where nobody listens at the model's address."""
QUOTA = "quota"
"""How it begins where nothing is left to spend."""
REJECTED = "rejected"
"""How it begins where the server takes no such request."""
INVALID = "invalid"
"""How it begins where no reply fits."""
REFUSED = "refused"
"""How it begins where the model declined."""
TRUNCATED = "truncated"
"""How it begins where the reply broke off."""
BUDGET = "budget"
"""How it begins where the limits of this project allow no further call."""
GONE = (DENIED, UNREACHED, QUOTA)
"""How it begins where the next question will have no answer either."""


def reason(error: Exception, timeout: float, statuses: list[int], messages: int) -> str:
    """Why there is no answer. Of what a server wrote only what it finds wrong with a request is in it.

    Args:
        error: What ended the conversation.
        timeout: Seconds that there were for it.
        statuses: Of HTTP, of the replies that came, in their order.
        messages: That were exchanged.
    """
    import httpx2
    from pydantic_ai import exceptions

    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, TooLongError):
            return f"too large: {cause}"
        if isinstance(cause, httpx2.ConnectError | httpx2.ConnectTimeout):
            return f"{UNREACHED} at {cause.request.url.netloc.decode()}"
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, TimeoutError | exceptions.ModelTimeoutError):
        if statuses[-1:] == [TOO_MANY]:
            return f"rate limit: the server asks to wait, and {timeout:g} s were over first"
        return f"timeout: no answer within {timeout:g} s"
    if isinstance(error, exceptions.UsageLimitExceeded):
        return f"{BUDGET}: no call is left to ask again"
    if isinstance(error, exceptions.ModelQuotaExceededError):
        return f"{QUOTA}: nothing is left to spend there"
    if isinstance(error, exceptions.ModelRateLimitError):
        return "rate limit: the server asks to wait"
    if (refused := refusal_in(error)) is not None:
        return _told(refused)
    if isinstance(error, NoReplyError):
        return str(error)
    if isinstance(error, exceptions.ModelConnectionError | OSError):
        return "connection: it broke"
    if isinstance(error, exceptions.ContentFilterError):
        return f"{REFUSED}: the model declined to answer"
    if isinstance(error, exceptions.OutputTokenLimitExceeded):
        return f"{TRUNCATED}: the reply broke off"
    # A request, its reply, and the same once more.
    if isinstance(error, exceptions.UnexpectedModelBehavior) and messages >= 4:
        return INVALID
    return "server: what it sent is no reply"


def _told(refusal: Refusal) -> str:
    """What a server said instead of an answer."""
    status = f"HTTP {refusal.status}"
    if refusal.within:
        status = "HTTP 200 with an error" + ("" if refusal.status == 200 else f" {refusal.status}")
    told = f"{status}: {refusal.words}" if refusal.words else status
    if refusal.status in (401, 403):  # Such words tend to hold what was sent as a key.
        return f"{DENIED}: {status}"
    if refusal.status == 402:
        return f"{QUOTA}: nothing is left to spend there"
    if refusal.status == TOO_MANY:
        return "rate limit: the server asks to wait"
    if refusal.status == 404 or refusal.about in (MODEL, ADDRESS):
        return f"{DENIED}: {told}"
    return f"{REJECTED if refusal.lasting else 'server'}: {told}"


def advice(fallback: str, model: str) -> str:
    """What to look at where the model cannot be asked, for that reason.

    Args:
        fallback: As `reason` gives it.
        model: See `Asking.model`.
    """
    if fallback.startswith(QUOTA):
        return "Is there a plan with something left, or another key?"
    about = never(fallback)
    if fallback.startswith(REJECTED):
        if about == CONTEXT:
            return "Does its context hold the question, its pictures and an answer?"
        return "Does the model take pictures, as many and as large as these?"
    if "://" not in model:
        network = fallback.startswith(UNREACHED)
        return "Is there a network?" if network else "Is its name right, and its key in the environment?"
    if fallback.startswith(UNREACHED):
        return "Is the server running, and its address right?"
    if "HTTP 404" not in fallback and about not in (ADDRESS, MODEL):
        return f"Is its name right, and its key in the environment, as {KEY}?"
    if about == MODEL or urlsplit(model).path.rstrip("/").endswith("/v1"):
        return "Does the server have a model of that name?"
    return f"Is the address whole? Most end in /v1: {model.rstrip('/')}/v1"
