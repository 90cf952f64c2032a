"""Exchanges with a model on disk, by the hash of what was asked: kept, and answered from.

A folder may hold those of many missions, and be recorded into again: an exchange takes the place of the
one that was kept of the same question, and all others stay.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dream.files import whole_or_nothing
from dream.planning.vlm.asking.question import RawAnswer

FORMAT = "dream-exchange-1"
MOST_BYTES = 16 << 20
"""A larger file is refused."""

lost: Counter[Path] = Counter()
"""Exchanges that this process could not keep, by folder."""


class _KeptExchange(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    format: str = Field(pattern=f"^{FORMAT}$")
    prompt: str
    question: str
    pictures: dict[str, str]
    """SHA-256 of each by name; the files lie in `pictures`."""
    replies: tuple[str, ...]
    fallback: str
    requests: int = Field(ge=0)
    tokens_in: int = Field(ge=0)
    tokens_out: int = Field(ge=0)
    cost_usd: float | None
    seconds: float = Field(ge=0.0)
    answered_by: str = ""


def prepare(folder: Path) -> None:
    """Make the folder to keep exchanges in.

    Raises:
        OSError: It cannot be made.
    """
    try:
        (folder / "pictures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            f"--record: expected a folder that can be written, got {folder} ({error.strerror})"
        ) from error


def forget(folder: Path, key: str) -> None:
    """Remove what was kept of an exchange that begins again: if the new one is lost, no old one answers."""
    with contextlib.suppress(OSError):  # Then it cannot be replaced either, which is told when it is kept.
        (folder / f"{key}.json").unlink(missing_ok=True)


def keep(
    folder: Path, key: str, outcome: RawAnswer, prompt: str, question: str, pictures: Mapping[str, bytes]
) -> None:
    """Write an exchange, whole or not at all. The key of a model is in none of what is written."""
    for png in pictures.values():
        path = folder / "pictures" / f"{_sha(png)}.png"
        if not path.exists():
            _replace(path, png)
    kept = _KeptExchange(
        format=FORMAT,
        prompt=prompt,
        question=question,
        pictures={name: _sha(png) for name, png in pictures.items()},
        replies=outcome.replies,
        fallback=outcome.fallback,
        requests=outcome.requests,
        tokens_in=outcome.tokens_in,
        tokens_out=outcome.tokens_out,
        cost_usd=outcome.cost_usd,
        seconds=outcome.seconds,
        answered_by=outcome.answered_by,
    )
    _replace(folder / f"{key}.json", (kept.model_dump_json(indent=1) + "\n").encode())


def holds(folder: Path, key: str) -> bool:
    """Is an exchange of that key kept there?"""
    return (folder / f"{key}.json").is_file()


def play(folder: Path, key: str, prompt: str) -> RawAnswer:
    """An exchange that was kept.

    Raises:
        FileNotFoundError: There is none of that key.
        ValueError: It is damaged.
    """
    path = folder / f"{key}.json"
    if not holds(folder, key):
        raise FileNotFoundError(
            f"{folder}: expected a kept reply to this question of the prompt {prompt}, got no {path.name}. "
            "Its world, seed, start, planner and options, --model, --model-name, --max-steps, --protocol, "
            "--mission and code must be those that it was recorded with. Else record again with --record"
        )
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got more")
    try:
        kept = _KeptExchange.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise ValueError(f"{path}: expected a kept exchange, got {error.errors()[0]['msg']}") from error
    return RawAnswer(
        kept.replies,
        kept.fallback,
        kept.requests,
        kept.tokens_in,
        kept.tokens_out,
        kept.cost_usd,
        kept.seconds,
        kept.answered_by,
    )


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _replace(path: Path, content: bytes) -> None:
    with whole_or_nothing(path) as partial:
        partial.write_bytes(content)
