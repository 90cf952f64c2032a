"""Is a thruster that fails named in time, and does the mission come home with the others?

    python perf/thrusters.py                             80 missions of the Heavy, hours; goes on where it was
    python perf/thrusters.py --vehicle bluerov2 --missions 40
    python perf/thrusters.py --healthy 10                missions without a fault: is one named all the same?

Each mission swims in a world of `dev`, reefs and wrecks, with a current from a direction that is drawn. One
of its thrusters fails, one kind after the other, at a second that is drawn. Seconds until it is named count
from when it first gives another force than it was commanded. Nothing is tuned on `test`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from dream.errors import MissionAborted
from dream.evaluation.statistics import share_interval
from dream.evaluation.suites import Case, family_of, suite_named
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning import PLANNERS
from dream.robots import Anchored, Motion, Simulated, _kernels
from dream.sim.ordered import protocol_in
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY
from dream.vehicle import FaultKind, ThrusterFault

VEHICLES = {"heavy": BLUEROV2_HEAVY, "bluerov2": BLUEROV2}
SOON = 3.0
"""Seconds within which a fault should be named."""
DRAWN = (5.0, 60.0)
"""Seconds of the mission within which a thruster fails."""
SEED = 900_047


@dataclass(frozen=True, slots=True)
class Swum:
    """One mission."""

    vehicle: str
    protocol: str
    planner: str
    number: int
    world: str
    seed: int
    kind: str
    """Empty where nothing fails."""
    thruster: int
    at_s: float | None
    shown_s: float | None
    """When it first gave another force than it was commanded; None where it never did."""
    named_s: float | None
    named: str
    rightly: bool
    ended: str
    why: str
    steps: int
    seconds: float
    """On the mission's clock."""
    contacts_before: int
    contacts_after: int
    """Since it showed."""


def case_of(number: int) -> Case:
    """Reefs and wrecks of `dev` in turn, kinds mixed."""
    every = suite_named("dev")
    wrecks = [case for case in every if family_of(case.world).startswith("wreck")]
    some = wrecks if number % 2 else [case for case in every if case not in wrecks]
    return some[7 * (number // 2) % len(some)]


def swim(number: int, vehicle: str, name: str, planner: str, max_steps: int | None, *, healthy: bool) -> Swum:
    """The mission of that number."""
    case = case_of(number)
    world, body = case.open(), VEHICLES[vehicle]
    protocol = protocol_in(world, name)
    rng = np.random.default_rng((SEED, number))
    kind = list(FaultKind)[number % len(FaultKind)]
    thruster = 1 + number // len(FaultKind) % body.thrusters.count
    at = round(float(rng.uniform(*DRAWN)), 2)
    fault = None if healthy else ThrusterFault(thruster, kind, at)
    robot = Simulated(world, protocol, world.starts[case.start], motion=Motion(vehicle=body, fault=fault))
    steps = explore(
        Anchored(robot, protocol),
        PLANNERS[planner],
        OccupancyMap(world.bounds, protocol),
        max_steps=max_steps,
    )
    clock = robot._voyage.clock
    ended, why, made, before, after = "", "", 0, 0, 0
    try:
        for step in steps:
            made, ended = step.index, step.ended
            failed = clock[_kernels.FAILED] <= clock[_kernels.TIME]
            before += step.arrival.collided and not failed
            after += step.arrival.collided and failed
    except MissionAborted as error:
        ended, why = "aborted", str(error)
    shown, found = float(clock[_kernels.FAILED]), robot.finding
    return Swum(
        vehicle=vehicle,
        protocol=name,
        planner=planner,
        number=number,
        world=case.world,
        seed=case.seed,
        kind="" if fault is None else kind.value,
        thruster=thruster,
        at_s=None if fault is None else at,
        shown_s=shown if math.isfinite(shown) else None,
        named_s=None if found is None else found.time,
        named="" if found is None else str(found),
        rightly=found is not None and fault is not None and (found.thruster, found.kind) == (thruster, kind),
        ended=ended,
        why=why,
        steps=made,
        seconds=float(clock[_kernels.TIME]),
        contacts_before=before,
        contacts_after=after,
    )


def share(of: Sequence[bool]) -> str:
    """How many, and their share with Wilson's interval."""
    told = share_interval(sum(of), len(of))
    return f"{sum(of)}/{len(of)} ({told.low:.2f} to {told.high:.2f})"


def told(swum: list[Swum]) -> str:
    """A table by kind of fault, and what healthy swimming came to."""
    heads = ("kind", "missions", f"named in {SOON:g} s", "wrongly", "never", "contacts", "home", "surfaced")
    lines = ["{:>8} {:>8} {:>22} {:>8} {:>6} {:>9} {:>22} {:>8}".format(*heads)]
    for kind in (*(one.value for one in FaultKind), "all"):
        some = [one for one in swum if one.shown_s is not None and kind in (one.kind, "all")]
        delays = [
            one.named_s - one.shown_s if one.named_s is not None and one.shown_s is not None else math.inf
            for one in some
        ]
        soon = [one.rightly and 0.0 <= delay <= SOON for one, delay in zip(some, delays, strict=True)]
        lines.append(
            f"{kind:>8} {len(some):8} {share(soon):>22} "
            f"{sum(bool(one.named) and not one.rightly for one in some):8} "
            f"{sum(not one.named for one in some):6} "
            f"{sum(one.contacts_after for one in some):9} "
            f"{share([one.ended in ('done', 'returned') for one in some]):>22} "
            f"{sum('the vehicle surfaced' in one.why for one in some):8}"
        )
    healthy = sum(one.seconds if one.shown_s is None else one.shown_s for one in swum) / 3600.0
    early = [
        one for one in swum if one.named_s is not None and (one.shown_s is None or one.named_s < one.shown_s)
    ]
    lines.append(
        f"{len(early)} named in {healthy:.2f} h of healthy swimming, "
        f"with {sum(one.contacts_before for one in swum)} contacts"
    )
    return "\n".join(lines)


def main() -> int:
    """Swim what is missing, and print the table of all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicle", choices=VEHICLES, default="heavy")
    parser.add_argument("--missions", type=int, default=80)
    parser.add_argument("--healthy", type=int, default=0, help="so many missions without a fault instead")
    parser.add_argument("--protocol", default="dream-v2-nav")
    parser.add_argument("--planner", choices=PLANNERS, default="belief")
    parser.add_argument("--max-steps", type=int, default=None, help="the protocol's cap unless given")
    parser.add_argument("--out", type=Path, default=Path("thrusters.jsonl"), help="where missions are kept")
    given = parser.parse_args()
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    kept = [Swum(**json.loads(line)) for line in lines]
    like = (given.vehicle, given.protocol, given.planner)
    there = {(one.vehicle, one.protocol, one.planner, one.number, not one.kind) for one in kept}
    healthy = given.healthy > 0
    with given.out.open("a") as file:
        for number in range(given.healthy or given.missions):
            if (*like, number, healthy) in there:
                continue
            one = swim(number, *like, given.max_steps, healthy=healthy)
            kept.append(one)
            file.write(f"{json.dumps(asdict(one))}\n")
            file.flush()
            late = (
                "" if one.named_s is None or one.shown_s is None else f"{one.named_s - one.shown_s:.2f} s, "
            )
            print(
                f"{number}: {one.world} {one.seed}, {one.thruster} {one.kind or 'healthy'}: {late}"
                f"{one.named or 'nothing named'}, {one.ended} {one.why} after {one.steps} steps, "
                f"{one.contacts_before} and {one.contacts_after} contacts",
                flush=True,
            )
    print(told([one for one in kept if (one.vehicle, one.protocol, one.planner) == like]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
