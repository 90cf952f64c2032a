"""Names of models: makers' and the stand-in's, and what a name that is none may have meant."""

from __future__ import annotations

import difflib
import re

MAKERS = {"gpt": "openai", "o3": "openai", "o4": "openai", "claude": "anthropic", "gemini": "google"}
"""Who makes the models whose names begin so."""
WIRE = "wire"
"""Name of the stand-in that comes with the package; `wire:FAULT` is one that errs."""
WIRE_TEST = "which shows that the wire works, never what a model can do"
"""What is to be said of everything that was flown with the stand-in."""


def stands_in(model: str) -> bool:
    """Is it the stand-in? See `WIRE_TEST`."""
    return model.partition(":")[0] == WIRE


def is_server(model: str) -> bool:
    """Is it asked at an address, not at its maker's? So is the stand-in."""
    return "://" in model or stands_in(model)


def meant(model: str) -> str:
    """What a name may have meant that is none, as a question; empty where nothing is like it."""
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
