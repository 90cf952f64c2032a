"""A whole dive on a rig: the list before it, the mission, the way home, all that it leaves behind."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from dream.commands.dive import Dive
from dream.commands.dive.flight import Flight
from dream.commands.dive.options import Sight
from dream.commands.dive.predive import predive_list
from dream.commands.dive.ready import Ready
from dream.commands.dive.terminal import Terminal
from dream.geometry import SE3
from dream.perception import FlatFloor, Perception, Shells
from dream.planning import PLANNERS, planner_name
from dream.robots.bluerov2.check import Finding
from dream.robots.bluerov2.standin.rig import Rig
from dream.sim.world import World


@dataclass
class Aboard:
    """What a dive asks of its simulated tank."""

    rig: Rig
    world: World = field(init=False)
    running: Any = field(init=False)

    def __post_init__(self) -> None:
        self.world = self.rig.world
        self.running = SimpleNamespace(truth=lambda: SimpleNamespace(behind=0.0))

    def truth(self) -> tuple[SE3, int]:
        return self.rig.truth()


@dataclass
class Dived:
    """What came of it."""

    folder: Path
    found: list[Finding]
    error: BaseException | None = None


def prepared(rig: Rig, folder: Path, **options: Any) -> Ready:
    """A dive whose devices are those of a rig."""
    options = {"planner": PLANNERS["belief"], "stand_in": True, "unattended": True, "json": True, **options}
    told = Dive(**options, drive="guided" if rig.guided else "alt-hold")
    site = told.ground.where()
    known = told.ground.known(site, told.planner, rig.world.bounds, rig.protocol, rig.world)
    return Ready(
        told,
        rig.protocol,
        rig.devices,
        rig.limits,
        rig.start,
        folder,
        Aboard(rig),  # type: ignore[arg-type]
        Sight(None, Perception(Shells(), FlatFloor())),
        known,
    )


def dive(rig: Rig, folder: Path, *, settle: float = 0.0, **options: Any) -> Dived:
    """Go through the list and, where all is well, fly."""
    ready = prepared(rig, folder, **options)
    rig.clock.sleep(settle)
    rig.devices.connect(30.0)
    rig.link.correct(rig.link.check_parameters())
    dived = Dived(folder, predive_list(ready))
    if all(finding.ok for finding in dived.found):
        try:
            Flight(ready, planner_name(ready.told.planner)).fly(lambda: None, Terminal())
        except Exception as error:  # noqa: BLE001 - it is what the test asks for.
            dived.error = error
    rig.link.restore()
    return dived


def truth_at(rig: Rig) -> list[tuple[float, SE3]]:
    """Filled with when the vehicle truly is where, twenty times a second."""
    way: list[tuple[float, SE3]] = []
    rig.standin.watchers.append(
        lambda standin: way.append((rig.now(), standin.T_world_base)) if standin.tank.beats % 5 == 0 else None
    )
    return way
