"""What may be spent on asking during one mission, and what was."""

from __future__ import annotations

from dataclasses import dataclass

from dream.planning.vlm.asking.failures import BUDGET
from dream.types import UNASKED, Asked, Exchange


@dataclass(slots=True, eq=False)
class AskingBudget:
    """Calls and dollars of one mission. Questions may be on their way side by side."""

    max_calls: int | None = None
    """Requests at most; None is no limit."""
    max_usd: float | None = None
    """US dollars at most; None is no limit."""
    label: str = ""
    """What the model is called in results."""
    spent: Asked = UNASKED
    """By answers that were received, those of earlier legs of the mission included."""
    under_way: int = 0
    """Questions whose answer was not received yet; each is at least a call."""
    _sent: int = 0
    """Requests, counted before they are sent."""
    _played: int = 0
    """Requests of kept exchanges that answered."""
    _dearest: float = 0.0
    """US dollars that a question cost at most."""

    def __post_init__(self) -> None:
        self._sent = self.spent.calls

    def exhausted(self) -> str:
        """Why nothing more may be asked; empty where it may."""
        spent = self.spent
        if self.max_calls is not None and spent.calls + self.under_way >= self.max_calls:
            return f"{BUDGET}: all {self.max_calls} calls are made"
        if self.max_usd is not None and spent.cost_usd is None:
            return f"unpriced: the price of {self.label} is not known; limit it with --max-calls"
        if self.max_usd is not None and spent.cost_usd is not None:
            # Those on their way may cost as much as any did.
            due = spent.cost_usd + self.under_way * self._dearest
            if due >= self.max_usd:
                return f"{BUDGET}: all {self.max_usd:g} USD are spent"
        return ""

    def count_request(self) -> None:
        """Count a request that is about to be sent.

        Raises:
            UsageLimitExceeded: None is left; the client's own error, which ends its conversation.
        """
        from pydantic_ai.exceptions import UsageLimitExceeded

        if self.max_calls is not None and self._sent + self._played >= self.max_calls:
            raise UsageLimitExceeded("no call is left")
        self._sent += 1

    def count_played(self, requests: int) -> None:
        """Count the requests of a kept exchange that answers: they were paid for when it was kept."""
        self._played += requests

    def book(self, exchange: Exchange) -> None:
        """Count what an exchange took that was received."""
        self.spent += exchange
        self._dearest = max(self._dearest, exchange.cost_usd or 0.0)
