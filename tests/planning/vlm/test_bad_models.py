"""Missions over the wire with the stand-in, and with every way in which it can err: they go on, unharmed."""

from __future__ import annotations

import pytest

from dream.evaluation.runner import simulate
from dream.planning import PLANNERS, Asking, Ranked
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import LOOK_AROUND, Step

UNANSWERED = {
    "malformed": "invalid",
    "truncated": "truncated",
    "refusing": "refused",
    "slow:5": "timeout",
    "trickle:0.05": "timeout",
    "429": "rate limit",
    "500": "server",
    "dropping": "connection",
    "huge": "too large",
    "injected": "invalid",
}
"""Faults that leave no answer that counts, and what the fallback is called."""
WRONG = ("random", "first", "mirrored", "worst", "wall", "stale:3", "error:0.5")


def fly(name: str, model: str, world: World, steps: int, timeout: float = 60.0) -> list[Step]:
    often = Ranked(margin=20.0, weight=50.0, allowance=10.0) if name == "ranked" else PLANNERS[name]
    planner = Asking(model=model, timeout=timeout, latency=0.0).given_to(often)
    return list(simulate(world, planner, DREAM_V1, max_steps=LOOK_AROUND + steps))[1 + LOOK_AROUND :]


def fallbacks(steps: list[Step]) -> list[str]:
    return [exchange.fallback for step in steps for exchange in step.decision.exchanges]


@pytest.mark.rare
@pytest.mark.parametrize("name", ["dream", "vanilla", "ranked"])
def test_the_stand_in_reads_every_picture_that_it_is_sent(name: str, string_reef: World) -> None:
    steps = fly(name, "wire", string_reef, 6 if name != "ranked" else 12)
    assert set(fallbacks(steps)) == {""}
    assert not any(step.arrival.collided for step in steps)
    assert sum(step.arrival.distance for step in steps) > 5.0


@pytest.mark.few(3)
@pytest.mark.parametrize("fault", UNANSWERED)
def test_a_model_that_gives_no_answer_is_flown_without(fault: str, string_reef: World) -> None:
    timeout = 1.0 if UNANSWERED[fault] == "timeout" else 60.0
    steps = fly("dream", f"wire:{fault}", string_reef, 1, timeout)
    (reason,) = fallbacks(steps)
    assert reason.startswith(f"{UNANSWERED[fault]}:")
    assert not any(step.guarded.note or step.arrival.collided for step in steps)


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("name", "fault"), [("dream", fault) for fault in WRONG[::3]] + [("ranked", fault) for fault in WRONG]
)
def test_a_model_that_is_wrong_does_no_harm(name: str, fault: str, string_reef: World) -> None:
    steps = fly(name, f"wire:{fault}", string_reef, 4 if name == "dream" else 8)
    # An answer to what was asked before may name a place that is no more.
    reasons = {reason.partition(":")[0] for reason in fallbacks(steps)}
    assert reasons == {""} or (name == "ranked" and fault.startswith("stale") and "invalid" in reasons)
    assert not any(step.arrival.collided for step in steps)
    if name == "ranked":
        assert not any(step.guarded.note for step in steps)
