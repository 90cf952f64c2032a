"""A vehicle that swims, launched into a world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from dream.geometry import SE2
from dream.protocol import SurveyProtocol
from dream.robots.anchored import Anchored, Anchoring
from dream.robots.simulated import Motion, Simulated
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.world import World


@dataclass(frozen=True, slots=True)
class Swimming:
    """How a mission swims, under a protocol by which it has to."""

    motion: Motion = field(default_factory=Motion)
    anchoring: Anchoring | None = field(default_factory=Anchoring)
    """None for a robot that believes in its own pose, whatever it sees."""

    def launch(
        self,
        world: World,
        protocol: SurveyProtocol,
        start: SE2,
        *,
        renderer: Renderer | None = None,
        solids: Solids | None = None,
        fineness: int = 1,
    ) -> Simulated | Anchored:
        """The robot at its start; see `Simulated`."""
        robot = Simulated(
            world,
            protocol,
            start,
            motion=self.motion,
            renderer=renderer,
            solids=solids,
            fineness=fineness,
        )
        return robot if self.anchoring is None else Anchored(robot, protocol, self.anchoring)


def read_swimming(values: Mapping[str, Any]) -> Swimming:
    """What `config.json` or `manifest.json` says of it.

    Raises:
        ValueError: A field is missing, or is not what it should be.
    """
    try:
        return TypeAdapter(Swimming).validate_python(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"swimming: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
