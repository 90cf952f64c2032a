"""The rules of a mission in a world: a protocol, and what an operator knows of a site beforehand."""

from __future__ import annotations

from dream.protocol import SurveyProtocol, protocol_for
from dream.sim.visual_range import visual_range
from dream.sim.world import World


def ordered_in(world: World, protocol: SurveyProtocol) -> SurveyProtocol:
    """The protocol as it is ordered in a world: for its area, its water and the least group looked for.

    Whoever sends a vehicle somewhere knows that much: from a chart, from a Secchi disc, and by what the
    survey is for. Once ordered, a protocol stays what it is. A planar one is the same everywhere.
    """
    if protocol.space is None:
        return protocol
    labels = visual_range(world.water, protocol.space, protocol.max_depth).labels
    return protocol.ordered(world.bounds.area, labels, world.group_radius)


def protocol_in(world: World, name: str | None = None) -> SurveyProtocol:
    """The protocol of a name, or without one that of `protocol_for`, as it is ordered there."""
    return ordered_in(world, protocol_for(world.protocol, name))
