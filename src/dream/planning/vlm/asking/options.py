"""What can be chosen of the asking: which model, which limits, what is kept."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

from dream import extras
from dream.options import First
from dream.planning.parameters import check_count, check_range
from dream.planning.vlm.asking import cassette
from dream.planning.vlm.asking.failures import advice
from dream.planning.vlm.asking.line import Line
from dream.planning.vlm.asking.names import WIRE
from dream.planning.vlm.asking.scrubbing import KEY
from dream.planning.vlm.prompts import own_prompts
from dream.types import UNASKED, Asked

P = TypeVar("P")

WHERE_KEPT = ("record", "replay_replies")
"""Options that say where exchanges are kept, on which no answer depends."""


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
        advised = advice(fallback, self.model)
        return ValueError(f"model: expected {self.label} to answer, got {said}. {advised}")
