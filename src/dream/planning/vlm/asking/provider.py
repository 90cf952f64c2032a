"""Who is asked: a maker's model by its name, a server by its address, or the stand-in."""

from __future__ import annotations

import ipaddress
import os
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from dream import extras
from dream.planning.vlm.asking.names import WIRE, meant, stands_in
from dream.planning.vlm.asking.scrubbing import KEY

if TYPE_CHECKING:
    from dream.planning.vlm.asking.models import RequestForm

OFFLINE = "DREAM_OFFLINE"
"""Environment variable: while it is set, to ask a model that is not on this machine is an error."""
ELSEWHERE = {
    "openai": "OPENAI_BASE_URL",
    "anthropic": "ANTHROPIC_BASE_URL",
    "google": "GOOGLE_GEMINI_BASE_URL",
}
"""Environment variables that makers' clients take another address from."""


def connect(model: str, name: str) -> tuple[RequestForm, ...]:
    """The model, ready to be asked.

    Args:
        model: See `Asking.model`.
        name: See `Asking.model_name`.

    Returns:
        How a reply can be asked for, the strictest form first.

    Raises:
        ValueError: There is no such model, its key is not in the environment, asking it is forbidden, or what
            asks it is not installed.
    """
    try:
        import pydantic_ai

        from dream.planning.vlm.asking import models
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
        raise ValueError(f"model: expected PROVIDER:NAME, an address or wire, got {model}{meant(model)}")
    if "://" in model:
        near = _is_near(model)
        _check_allowed(model, near=near)
        if not name:
            raise ValueError(
                f"model_name: expected what {model} calls the model, got none. Say --model-name NAME"
            )
        return models.forms_at_address(model, name, _key(), near=near)
    if name:
        raise ValueError(f"model_name: expected only beside an address, got {name} with {model}")
    _check_allowed(model, near=False)
    # Results would bear the maker's name, and the key would go to whom the address belongs.
    if os.environ.get(elsewhere := ELSEWHERE.get(model.partition(":")[0], "")):
        raise ValueError(
            f"model: expected {model} to be asked at its maker's, got {elsewhere} in the environment, "
            f"which leads elsewhere. Say --model ADDRESS --model-name NAME with the key as {KEY}, or "
            f"unset {elsewhere}"
        )
    return models.forms_of_maker(model)


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
