"""What is simulated for a dive: the tank of the stand-in, and the mission that is flown before it."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, Self

import numpy as np

from dream.commands.dive.options import Waters
from dream.geometry import SE3
from dream.protocol import DREAM_V1, SurveyProtocol

if TYPE_CHECKING:
    from dream.mapping.prior import Prior
    from dream.robots.bluerov2.standin.process import StandInProcess
    from dream.sim.world import World

REHEARSED = 12
"""Steps of a simulated mission before the dive."""


class Tank:
    """A simulated tank, in a process of its own once it is entered."""

    def __init__(self, world: str, seed: int, drive: str) -> None:
        from dream.sim.worlds import make_world

        self.world: World = make_world(world, seed)
        self._seed = seed
        self._options = ("--position",) if drive == "guided" else ()
        self.ports: tuple[int, int] | None = None
        """Of the vehicle and of its video, once it is entered."""
        self.process: StandInProcess | None = None

    def __enter__(self) -> Self:
        from dream.robots.bluerov2.standin.process import StandInProcess

        loopback = "127.0.0.1"
        # Asked for as late as can be, lest somebody else takes them meanwhile.
        vehicle, video = self.ports = _free_port(), _free_port()
        self.process = StandInProcess(
            self.world.name,
            self._seed,
            ground=(loopback, vehicle),
            video=(loopback, video),
            options=self._options,
        )
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self.process.close()

    @property
    def running(self) -> StandInProcess:
        """Its programs, once it is entered."""
        assert self.process is not None
        return self.process

    def waters(self, protocol: SurveyProtocol, pilot: str | None) -> Waters:
        """Where it is, and how its programs are reached; a pilot may come to `pilot`."""
        from dream.robots.bluerov2.devices import Addresses

        assert self.ports is not None
        (host, port), (vehicle, video) = self.running.a50, self.ports
        return Waters(
            self.world.bounds,
            protocol.snap(self.world.starts[0]),
            Addresses(f"udpin:127.0.0.1:{vehicle}", f"{host}:{port}", f"rtp:127.0.0.1:{video}", pilot),
            self.running.surface_pressure,
        )

    def truth(self) -> tuple[SE3, int]:
        """`T_world_base` as it is, and how often the vehicle ran into something."""
        told = self.running.truth()
        return told.T_world_base, told.collisions


def _free_port() -> int:
    """A UDP port of this computer that nobody uses just now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def rehearse_mission(protocol: SurveyProtocol, estimator: str) -> None:
    """Explore a simulated place for some steps, and steer: what is compiled now stops nothing under water."""
    from dream.robots.bluerov2.drives import rehearse
    from dream.sim.worlds import make_world

    _explore(make_world("pool/arc" if protocol.traversal is not None else "reef/patch", 1), protocol)
    rehearse(estimator)


def rehearse_return() -> None:
    """Explore a simulated reef of which a survey tells: what is called on only then is compiled, too.

    Always by `DREAM_V1`: in a tank there is so much to traverse that a short mission plans no way round what
    was foretold.
    """
    from dream.mapping.prior import Prior
    from dream.sim.worlds import make_world

    world, cell = make_world("reef/patch", 1), DREAM_V1.cell
    bounds, (x, y) = world.bounds, world.targets.position[:, :2].T
    shape = round(bounds.depth / cell), round(bounds.width / cell)
    was = np.zeros(shape, np.float32)
    was[((y - bounds.y_min) / cell).astype(int), ((x - bounds.x_min) / cell).astype(int)] = 1.0
    _explore(world, DREAM_V1, Prior(bounds, cell, was, np.zeros(shape, np.bool_)))


def _explore(world: World, protocol: SurveyProtocol, prior: Prior | None = None) -> None:
    from dream.evaluation.runner import simulate
    from dream.planning.belief import Belief

    for _ in simulate(world, Belief(), protocol, max_steps=REHEARSED, prior=prior):
        pass
