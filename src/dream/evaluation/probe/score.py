"""How well a model answered, and what that means in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dream.evaluation.probe.questions import KINDS, MapQuestion
from dream.evaluation.statistics import Interval, share_interval
from dream.types import Exchange

READS = 0.8
"""The map is read where the lower end of the interval of all questions is above this share."""
READS_KIND = 0.6
"""A kind is read where that of its own questions is above this: from 20 of 25 on."""
LEAST_ASKED = 10
"""Questions of a kind without which nothing is said about it."""

READ, IN_PART, BLIND = "reads it", "in part", "no better than chance"
MOST_REASONS = 5
"""Reasons for no answer that are told in full."""
SILENT, TOO_FEW = "no answer", "too few to tell"


@dataclass(frozen=True, slots=True, eq=False)
class Reply:
    """What a model said to a question."""

    question: MapQuestion
    given: str | None
    """Its answer; None where the exchange says why there is none."""
    reason: str
    """In the words of the model."""
    exchange: Exchange

    @property
    def right(self) -> bool:
        """No answer is a wrong one."""
        return self.given == self.question.answer

    @property
    def asked(self) -> bool:
        """Was the model asked at all, or did the budget end before?"""
        return self.exchange.requests > 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        question, exchange = self.question, self.exchange
        return {
            "number": question.number,
            "kind": question.kind,
            "map": question.scene,
            "text": question.text,
            "choices": list(question.choices),
            "right_answer": question.answer,
            "given_answer": self.given,
            "right": self.right,
            "reason": self.reason,
            "no_answer": exchange.fallback,
            "replies": list(exchange.replies),
            "lacks": list(exchange.lacks),
            "seconds": exchange.seconds,
        }


@dataclass(frozen=True, slots=True)
class Tally:
    """Right answers among some questions."""

    asked: int
    right: int
    unanswered: int
    """Of those asked; they count as wrong."""
    chance: float
    """Share that is right where answers are drawn blindly."""

    @staticmethod
    def of(replies: Sequence[Reply]) -> Tally:
        """Of those that were asked."""
        asked = [reply for reply in replies if reply.asked]
        return Tally(
            len(asked),
            sum(reply.right for reply in asked),
            sum(reply.given is None for reply in asked),
            float(np.mean([reply.question.chance for reply in asked])) if asked else 0.0,
        )

    @property
    def interval(self) -> Interval:
        """The share that is right, with Wilson's 95 % interval."""
        return share_interval(self.right, self.asked)

    @property
    def above_chance(self) -> bool:
        """Is the whole interval above what blind answers would give?"""
        return self.asked > 0 and self.interval.low > self.chance

    @property
    def verdict(self) -> str:
        """Of one kind, in words."""
        if self.asked < LEAST_ASKED:
            return TOO_FEW
        if self.unanswered == self.asked:
            return SILENT
        if not self.above_chance:
            return BLIND
        return READ if self.interval.low > READS_KIND else IN_PART

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        known = self.asked > 0
        return {
            "asked": self.asked,
            "right": self.right,
            "unanswered": self.unanswered,
            "share": self.interval.value if known else None,
            "low": self.interval.low if known else None,
            "high": self.interval.high if known else None,
            "chance": self.chance if known else None,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """What a model answered to all questions."""

    replies: tuple[Reply, ...]
    """In the order of their numbers."""
    questions: int
    """How many were to be asked."""

    @property
    def whole(self) -> Tally:
        """Over all kinds."""
        return Tally.of(self.replies)

    @property
    def kinds(self) -> dict[str, Tally]:
        """By kind, of those that were to be asked."""
        found = {kind: [reply for reply in self.replies if reply.question.kind == kind] for kind in KINDS}
        return {kind: Tally.of(replies) for kind, replies in found.items() if replies}

    @property
    def complete(self) -> bool:
        """Was every question asked?"""
        return self.whole.asked == self.questions

    @property
    def reads(self) -> str:
        """Does the model read the map? `yes`, `in part`, `no`, or `unknown` where it was not asked enough."""
        verdicts = [tally.verdict for tally in self.kinds.values()]
        if {BLIND, SILENT} & set(verdicts):
            return "no"
        if len(verdicts) < len(KINDS) or TOO_FEW in verdicts:
            return "unknown"
        return "yes" if self.whole.interval.low > READS else "in part"

    @property
    def silent(self) -> bool:
        """Was it asked, and no answer counted?"""
        return 0 < self.whole.asked == self.whole.unanswered

    @property
    def verdict(self) -> str:
        """In words."""
        kinds = self.kinds.items()
        if self.silent:
            return "gave no answer at all"
        blind = [KINDS[kind].title for kind, tally in kinds if tally.verdict in (BLIND, SILENT)]
        weak = [KINDS[kind].title for kind, tally in kinds if tally.verdict != READ]
        return {
            "no": f"do not trust it with a map: no better than chance at {_listed(blind)}",
            "unknown": f"too few questions to tell: {LEAST_ASKED} of every kind are the least",
            "yes": f"reads the map: surely more than {READS:.0%} right, and every kind above chance",
            "in part": f"reads the map in part: not surely more than {READS:.0%} right"
            + (f"; weak at {_listed(weak)}" if weak else ""),
        }[self.reads]

    @property
    def failures(self) -> dict[str, int]:
        """Why there was no answer, the most frequent reason first; rare ones in a word."""
        missing = [reply.exchange.fallback for reply in self.replies if reply.given is None and reply.asked]
        whole = Counter(missing)
        often = {reason for reason, _ in whole.most_common(MOST_REASONS)}
        told = Counter(reason if reason in often else reason.partition(":")[0] for reason in missing)
        return dict(told.most_common())

    @property
    def spent(self) -> str:
        """Time, tokens and money, in words."""
        record = self.as_dict()
        if not self.whole.asked:
            return "nothing was asked"
        cost = "cost unknown" if record["cost_usd"] is None else f"{record['cost_usd']:.2f} USD"
        latency = record["latency_s"]
        return (
            f"{duration(latency['p50'])} an answer, 99 of 100 within {duration(latency['p99'])}; "
            f"{record['tokens_in']} tokens in, {record['tokens_out']} out, {cost}"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        asked = [reply.exchange for reply in self.replies if reply.asked]
        costs = [exchange.cost_usd for exchange in asked]
        seconds = [exchange.seconds for exchange in asked]
        return {
            "questions": self.questions,
            **self.whole.as_dict(),
            "reads": self.reads,
            "verdict": self.verdict,
            "kinds": {
                kind: tally.as_dict() | {"verdict": tally.verdict} for kind, tally in self.kinds.items()
            },
            "no_answer": self.failures,
            "latency_s": {f"p{q}": float(np.percentile(seconds, q)) if seconds else None for q in (50, 99)},
            "calls": sum(exchange.requests for exchange in asked),
            "tokens_in": sum(exchange.tokens_in for exchange in asked),
            "tokens_out": sum(exchange.tokens_out for exchange in asked),
            "cost_usd": None if None in costs else sum(cost for cost in costs if cost is not None),
        }


def duration(seconds: float) -> str:
    """In words."""
    return f"{seconds:.1f} s" if seconds >= 1.0 else f"{1000.0 * seconds:.0f} ms"


def _listed(names: Sequence[str]) -> str:
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} and {names[-1]}"
