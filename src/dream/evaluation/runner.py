"""Missions in the simulator: one, or many side by side."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any

from dream.evaluation.metrics import Scorer
from dream.mapping import OccupancyMap
from dream.mission import Planner, explore
from dream.protocol import SurveyProtocol, protocol_named
from dream.robots import Teleport
from dream.sim.files import world_hash
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Step


def simulate(
    world: World, planner: Planner, protocol: SurveyProtocol, *, start: int = 0, max_steps: int | None = None
) -> Iterator[Step]:
    """One mission of a planner in a world; see `mission.explore`.

    Args:
        world: Where.
        planner: Who decides; it never sees the world.
        protocol: By which rules.
        start: Which of the world's start poses.
        max_steps: Decisions at most; the protocol's cap unless given.
    """
    if not 0 <= start < len(world.starts):
        raise ValueError(f"start: expected 0 to {len(world.starts) - 1} for {world.name}, got {start}")
    home = protocol_named(world.protocol)
    if (protocol.lattice, protocol.altitude) != (home.lattice, home.altitude):
        raise ValueError(
            f"protocol: {world.name} is made for {home.name}, got {protocol.name}, whose lattice of "
            f"{protocol.lattice} m and altitude of {protocol.altitude} m do not fit it"
        )
    robot = Teleport(world, protocol, world.starts[start])
    return explore(robot, planner, OccupancyMap(world.bounds, protocol), max_steps=max_steps)


@dataclass(frozen=True, slots=True)
class Flight:
    """One mission of a suite: enough to fly it in another process."""

    world: str
    seed: int
    planner_name: str
    planner: Planner
    protocol: str
    start: int = 0
    max_steps: int | None = None


def fly(flight: Flight) -> dict[str, Any]:
    """Fly one mission without recording it, and score it. The dictionary of `summary.json`."""
    began = time.perf_counter()
    world = make_world(flight.world, flight.seed)
    protocol = protocol_named(flight.protocol)
    scorer = Scorer(world, protocol)
    for step in simulate(world, flight.planner, protocol, start=flight.start, max_steps=flight.max_steps):
        scorer.add(step)
    return summarize(world, flight.planner_name, protocol, scorer, time.perf_counter() - began)


def summarize(
    world: World, planner_name: str, protocol: SurveyProtocol, scorer: Scorer, wall_s: float
) -> dict[str, Any]:
    """The object that `--json` prints and `summary.json` holds."""
    return {
        "protocol": protocol.name,
        "world": world.name,
        "seed": world.seed,
        "world_hash": world_hash(world),
        "planner": planner_name,
        **scorer.summary(),
        "wall_s": round(wall_s, 3),
    }


def fly_all(flights: list[Flight], workers: int | None = None) -> Iterator[tuple[Flight, dict[str, Any]]]:
    """Fly many missions side by side, yielding each as it ends."""
    workers = workers or os.cpu_count() or 1
    # Spawned, not forked: forking a process that holds numba's threads is not safe.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(flights)), mp_context=context) as pool:
        running = {pool.submit(fly, flight): flight for flight in flights}
        try:
            for future in as_completed(running):
                yield running[future], future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
