"""Under which protocols a planner flies."""

from __future__ import annotations

from dream.protocol import SurveyProtocol

AT_HAND = {
    True: "belief, greedy, sixsteps, lawnmower, spiral, frontier, nbv, sweep-and-graze, mutual-information, "
    "orbits, tiers, cover-tour, space-nbv, fuel, dream, vanilla, ranked",
    False: "belief, sixsteps, lawnmower",
}
"""Planners that fly in space, and some that do not."""


def flies(planner: object, *, in_space: bool) -> bool:
    """Whether a planner flies under protocols that move in space, or under planar ones.

    Its class says so by `spatial` and `planar`; one that says neither is planar.
    """
    return bool(getattr(planner, "spatial", False) if in_space else getattr(planner, "planar", True))


def check_flies(planner: object, protocol: SurveyProtocol) -> None:
    """Raise a ValueError that names some that can, where a planner does not fly under a protocol."""
    in_space = protocol.space is not None
    if not flies(planner, in_space=in_space):
        how = "in space" if in_space else "at one altitude"
        raise ValueError(
            f"planner: expected one that flies {how}, as {protocol.name} does, such as {AT_HAND[in_space]}; "
            f"got {type(planner).__name__}" + (". Say --protocol dream-v1" if in_space else "")
        )
